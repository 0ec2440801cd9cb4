"""Smoothing against scipy's filter, noise against known noise."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.spectrum import (
    Smoothing,
    Spectrum,
    channel_noise,
    savitzky_golay_operator,
    scatter_noise,
    smoothing_operator,
)

GRID = np.arange(450.0, 2396.0, 5.0)


@pytest.mark.parametrize(("points", "order"), [(41, 3), (11, 2), (5, 4)])
def test_equal_steps_give_scipys_savitzky_golay(points: int, order: int) -> None:
    values = np.random.default_rng(1).normal(size=GRID.size).cumsum()
    ours = savitzky_golay_operator(GRID, points, order) @ values
    assert np.allclose(ours, savgol_filter(values, points, order, mode="interp"), atol=1e-9)


def test_unequal_steps_keep_a_cubic() -> None:
    wavelength = np.sort(np.random.default_rng(2).uniform(450, 2400, 200))
    cubic = 1e-9 * (wavelength - 1200) ** 3 + 0.2
    assert np.allclose(savitzky_golay_operator(wavelength, 21, 3) @ cubic, cubic, atol=1e-10)


def test_zero_points_is_no_smoothing() -> None:
    assert np.array_equal(savitzky_golay_operator(GRID, 0), np.eye(GRID.size))


@pytest.mark.parametrize("points", [40, 3, -5])
def test_impossible_windows_are_refused(points: int) -> None:
    with pytest.raises(ParameterError, match="odd number"):
        savitzky_golay_operator(GRID, points, 3)


def test_a_window_in_nm_is_scipys_filter_on_equal_steps_and_as_wide_on_others() -> None:
    values = np.random.default_rng(1).normal(size=GRID.size).cumsum()
    assert np.allclose(smoothing_operator(GRID, 205, 3) @ values, savgol_filter(values, 41, 3), atol=1e-9)
    coarse = GRID[::4]
    window = (smoothing_operator(coarse, 205, 3) != 0).sum(axis=1)
    assert set(window) <= {10, 11}
    assert np.array_equal(smoothing_operator(GRID[::20], 205, 3), np.eye(GRID[::20].size))
    wavelength = np.sort(np.random.default_rng(2).uniform(450, 2400, 200))
    cubic = 1e-9 * (wavelength - 1200) ** 3 + 0.2
    assert np.allclose(smoothing_operator(wavelength, 205, 3) @ cubic, cubic, atol=1e-10)


def test_smoothing_wider_than_half_of_a_band_is_refused() -> None:
    assert Smoothing(channels=41).width_nm(GRID) == 205
    assert Smoothing(channels=0).width_nm(GRID) == 0
    with pytest.raises(DataError, match="41 channels, here 820 nm, is wider than half of a band"):
        Smoothing(channels=41).width_nm(GRID[::4])
    with pytest.raises(ParameterError, match="400 nm is wider than half of a band"):
        Smoothing(window_nm=400)
    with pytest.raises(ParameterError, match="odd number above 3"):
        Smoothing(channels=40)


def test_scatter_noise_finds_the_noise_that_was_added() -> None:
    rng = np.random.default_rng(3)
    sigma = np.where(GRID < 1300, 0.001, 0.004)
    found = scatter_noise(0.2 + 1e-5 * GRID + rng.normal(scale=sigma))
    assert np.median(found[GRID < 1000]) == pytest.approx(0.001, rel=0.15)
    assert np.median(found[GRID > 1600]) == pytest.approx(0.004, rel=0.15)


def test_a_given_uncertainty_goes_before_the_scatter() -> None:
    spectrum = Spectrum("s", GRID, np.full(GRID.size, 0.1), np.full(GRID.size, 0.003))
    assert np.all(channel_noise(spectrum) == 0.003)
