"""What a Spectrum accepts."""

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import Spectrum

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
        ([np.nan, 500], [0.1, 0.1], None, "missing"),
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
