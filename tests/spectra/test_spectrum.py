"""What a Spectrum accepts, its gaps and noise, and smoothing on spectra whose answer is known."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.spectrum import (
    WIDEST_GAP_NM,
    Smoothing,
    Spectrum,
    channel_noise,
    reaches_over,
    savitzky_golay_operator,
    scatter_noise,
    smoothing_operator,
    wide_gap,
)

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


NM = np.arange(450.0, 2396.0, 5.0)


@pytest.mark.parametrize(("points", "order"), [(41, 3), (11, 2), (5, 4)])
def test_equal_steps_give_scipys_savitzky_golay(points: int, order: int) -> None:
    values = np.random.default_rng(1).normal(size=NM.size).cumsum()
    ours = savitzky_golay_operator(NM, points, order) @ values
    assert np.allclose(ours, savgol_filter(values, points, order, mode="interp"), atol=1e-9)


def test_unequal_steps_keep_a_cubic() -> None:
    wavelength = np.sort(np.random.default_rng(2).uniform(450, 2400, 200))
    cubic = 1e-9 * (wavelength - 1200) ** 3 + 0.2
    assert np.allclose(savitzky_golay_operator(wavelength, 21, 3) @ cubic, cubic, atol=1e-10)


def test_zero_points_is_no_smoothing() -> None:
    assert np.array_equal(savitzky_golay_operator(NM, 0), np.eye(NM.size))


@pytest.mark.parametrize("points", [40, 3, -5])
def test_impossible_windows_are_refused(points: int) -> None:
    with pytest.raises(ParameterError, match="odd number"):
        savitzky_golay_operator(NM, points, 3)


def test_a_window_in_nm_is_scipys_filter_on_equal_steps_and_as_wide_on_others() -> None:
    values = np.random.default_rng(1).normal(size=NM.size).cumsum()
    assert np.allclose(smoothing_operator(NM, 205, 3) @ values, savgol_filter(values, 41, 3), atol=1e-9)
    coarse = NM[::4]
    window = (smoothing_operator(coarse, 205, 3) != 0).sum(axis=1)
    assert set(window) <= {10, 11}
    assert np.array_equal(smoothing_operator(NM[::20], 205, 3), np.eye(NM[::20].size))
    wavelength = np.sort(np.random.default_rng(2).uniform(450, 2400, 200))
    cubic = 1e-9 * (wavelength - 1200) ** 3 + 0.2
    assert np.allclose(smoothing_operator(wavelength, 205, 3) @ cubic, cubic, atol=1e-10)


def test_smoothing_wider_than_half_of_a_band_is_refused() -> None:
    assert Smoothing(channels=41).width_nm(NM) == 205
    assert Smoothing(channels=0).width_nm(NM) == 0
    with pytest.raises(DataError, match="41 channels, here 820 nm, is wider than half of a band"):
        Smoothing(channels=41).width_nm(NM[::4])
    with pytest.raises(ParameterError, match="400 nm is wider than half of a band"):
        Smoothing(window_nm=400)
    with pytest.raises(ParameterError, match="odd number above 3"):
        Smoothing(channels=40)


def test_scatter_noise_finds_the_noise_that_was_added() -> None:
    rng = np.random.default_rng(3)
    sigma = np.where(NM < 1300, 0.001, 0.004)
    found = scatter_noise(0.2 + 1e-5 * NM + rng.normal(scale=sigma))
    assert np.median(found[NM < 1000]) == pytest.approx(0.001, rel=0.15)
    assert np.median(found[NM > 1600]) == pytest.approx(0.004, rel=0.15)


def test_a_given_uncertainty_goes_before_the_scatter() -> None:
    spectrum = Spectrum(
        "s",
        NM,
        np.full(NM.size, 0.1),
        np.full(NM.size, 0.003),
    )
    assert np.all(channel_noise(spectrum) == 0.003)
