"""What a Spectrum accepts."""

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import WIDEST_GAP_NM, Spectrum, reaches_over, wide_gap

GRID = np.array([500.0, 600.0, 700.0, 800.0])


def test_channels_without_reflectance_are_masked() -> None:
    spectrum = Spectrum("s", GRID, np.array([0.1, np.nan, -0.2, 0.3]))
    assert spectrum.usable.tolist() == [True, False, False, True]


def test_arrays_cannot_be_changed_afterwards() -> None:
    spectrum = Spectrum("s", GRID, np.full(4, 0.1))
    with pytest.raises(ValueError, match="read-only"):
        spectrum.reflectance[0] = 1.0


@pytest.mark.parametrize(
    ("wavelength", "reflectance", "uncertainty", "message"),
    [
        ([], [], None, "no channels"),
        ([500, 400], [0.1, 0.1], None, "ascending"),
        ([500, 500], [0.1, 0.1], None, "ascending"),
        ([0, 500], [0.1, 0.1], None, "above 0"),
        ([np.nan, 500], [0.1, 0.1], None, "finite"),
        ([400, 500], [0.1], None, "shape"),
        ([400, 500], [0.1, 0.1], [0.01, 0.0], "uncertainty"),
        ([400, 500], [0.1, 0.1], [0.01], "shape"),
    ],
)
def test_broken_rules_are_named(wavelength: list, reflectance: list, uncertainty: list | None, message: str) -> None:
    with pytest.raises(DataError, match=message):
        Spectrum(
            "s", np.array(wavelength), np.array(reflectance), None if uncertainty is None else np.array(uncertainty)
        )


@pytest.mark.parametrize(
    ("channels", "gap"),
    [
        # From 0 to 4, in widest gaps that hide no band: the widest one that does, also over the ends.
        ([0.0, 1.0, 2.0, 3.0, 4.0], None),
        ([0.0, 1.0, 2.1, 3.0, 4.0], (1.0, 2.1)),
        ([0.0, 1.0, 2.1, 3.3, 4.0], (2.1, 3.3)),
        ([-0.2, 0.9, 1.8, 2.7, 3.6, 4.4], (-0.2, 0.9)),
        ([-0.2, 0.8, 1.8, 2.7, 3.6, 4.7], (3.6, 4.7)),
        ([-9.0, -0.2, 0.8, 1.8, 2.7, 3.6, 4.4, 9.0], None),
        ([1.1, 2.0, 2.9, 3.8, 4.2], (0.0, 1.1)),
        ([-0.1, 0.8, 1.7, 2.6], (2.6, 4.0)),
        ([-3.0, 7.0], (-3.0, 7.0)),
    ],
)
def test_the_widest_gap_of_a_range_by_hand(channels: list[float], gap: tuple[float, float] | None) -> None:
    wavelength, high = 1000.0 + WIDEST_GAP_NM * np.array(channels), 1000.0 + 4.0 * WIDEST_GAP_NM
    found = wide_gap(wavelength, 1000.0, high)
    assert (found is None) == (gap is None)
    if gap is not None:
        assert found == pytest.approx([1000.0 + WIDEST_GAP_NM * end for end in gap])
    over = gap is None and channels[0] <= 0.0 and channels[-1] >= 4.0
    assert reaches_over(wavelength, 1000.0, high) == over
