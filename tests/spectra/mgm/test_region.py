"""Fits of images in which neighbours help: beside fits of every pixel alone, and whatever the image is cut into."""

import numba
import numpy as np
import pytest
import strips

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.batch import NOT_FITTED, FitBatch, channels_of, problem_of
from lunarsci.spectra.mgm.data import prepare_rows
from lunarsci.spectra.mgm.fit import fit_arrays, starting_points
from lunarsci.spectra.mgm.levenberg_marquardt import CONVERGED, GIVEN_UP, DescentOptions, descend, workspace_for
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.region import CONTEST, NEIGHBOUR, NOWHERE, SINGLE, TILE, RegionFits, fit_region

MODEL = mgm_model("OPX-CPX")
EQUAL = 0.01
"""Of chi-square: a tenth of a standard error."""


def pixels(strip: strips.Strip) -> tuple[np.ndarray, np.ndarray]:
    """Reflectances and places of all pixels."""
    shape = strip.reflectance.shape[:2]
    return np.maximum(strip.reflectance, 1e-5).reshape(-1, strip.wavelength_nm.size), np.argwhere(np.ones(shape))


def fitted(strip: strips.Strip, **options: int) -> RegionFits:
    return fit_region(strip.wavelength_nm, *pixels(strip), MODEL, **options)


@pytest.fixture(scope="module")
def ground() -> strips.Strip:
    """SYNTHETIC: three tiles of mixtures, one of them cut off."""
    return strips.mixtures(strips.EIGHTY_FIVE_NM, (TILE, 2 * TILE + 8), seed=21)


@pytest.fixture(scope="module")
def found(ground: strips.Strip) -> RegionFits:
    return fitted(ground)


@pytest.fixture(scope="module")
def alone(ground: strips.Strip) -> FitBatch:
    return fit_arrays(ground.wavelength_nm, pixels(ground)[0], MODEL)


def test_hardly_any_minimum_is_higher_than_that_of_the_pixel_alone(found: RegionFits, alone: FitBatch) -> None:
    above = found.batch.objective - alone.objective
    assert (above > EQUAL).mean() < 0.005
    assert found.batch.converged.all()
    assert np.isin(found.origin, (SINGLE, NEIGHBOUR, CONTEST)).all() and (found.origin == NEIGHBOUR).any()


def test_where_minima_agree_so_does_everything_else(found: RegionFits, alone: FitBatch) -> None:
    same = np.abs(found.batch.objective - alone.objective) < 1e-3
    assert same.mean() > 0.95
    off = np.abs(found.batch.values - alone.values)[same] / np.where(alone.sigma > 0, alone.sigma, 1.0)[same]
    assert np.quantile(off, 0.99) < 0.02
    assert np.allclose(found.batch.rms_ln[same], alone.rms_ln[same], rtol=0.01)
    of_errors = np.abs(
        np.log(found.batch.sigma[same, MODEL.degrees + 2 :: 3] / alone.sigma[same, MODEL.degrees + 2 :: 3])
    )
    assert np.quantile(of_errors, 0.99) < 0.01


def test_with_contests_everywhere_no_minimum_is_higher() -> None:
    """On the worst image: no pixel is like those beside it."""
    strip = strips.checkerboard(strips.EIGHTY_FIVE_NM, (16, 16), seed=5)
    alone = fit_arrays(strip.wavelength_nm, pixels(strip)[0], MODEL)
    found = fitted(strip, contest_every=1)
    assert (found.batch.objective <= alone.objective + 1e-9).all()
    assert (found.batch.objective < alone.objective - EQUAL).any()


def test_tiles_know_nothing_of_each_other(ground: strips.Strip, found: RegionFits) -> None:
    """Neither blocks, nor threads, nor the order of pixels change a bit."""
    reflectance, places = pixels(ground)
    rng, threads = np.random.default_rng(0), numba.get_num_threads()
    part = rng.permutation(np.flatnonzero(places[:, 1] // TILE != 1))
    numba.set_num_threads(1)
    try:
        again = fit_region(ground.wavelength_nm, reflectance[part], places[part], MODEL)
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(again.batch.values, found.batch.values[part])
    assert np.array_equal(again.batch.sigma, found.batch.sigma[part])
    assert np.array_equal(again.origin, found.origin[part])


def test_pixels_without_channels_are_left_out_and_others_fitted(ground: strips.Strip) -> None:
    reflectance, places = pixels(ground)
    keep = (places < 12).all(axis=1)
    reflectance, places = reflectance[keep].copy(), places[keep]
    reflectance[:30] = np.nan
    reflectance[40:60, 7] = -1.0
    found = fit_region(ground.wavelength_nm, reflectance, places, MODEL)
    assert (found.origin[:30] == NOWHERE).all() and (found.batch.status[:30] == NOT_FITTED).all()
    assert np.isnan(found.batch.values[:30]).all() and np.isfinite(found.batch.values[30:]).all()
    alone = fit_arrays(ground.wavelength_nm, reflectance[30:60], MODEL)
    assert (found.batch.objective[30:60] < alone.objective + EQUAL).mean() > 0.8
    nothing = fit_region(ground.wavelength_nm, reflectance[:30], places[:30], MODEL)
    assert (nothing.origin == NOWHERE).all()


@pytest.mark.parametrize("every", [0, 33])
def test_contests_are_not_everywhere_twice_nor_nowhere(ground: strips.Strip, every: int) -> None:
    with pytest.raises(ParameterError, match="1 to 32"):
        fitted(ground, contest_every=every)


def test_a_descent_that_will_stay_above_its_bar_is_given_up(ground: strips.Strip) -> None:
    """One that gets below is the same as without bars, to the last bit."""
    rows = prepare_rows(ground.wavelength_nm, pixels(ground)[0][:64])
    ln_reflectance = np.log(rows.reflectance)
    spectra, size, channels = channels_of(rows, MODEL, ln_reflectance), MODEL.prior.size, float(rows.wavelength_nm.size)
    starts = starting_points(MODEL, ln_reflectance, 1)[0]

    def outcomes(bars: np.ndarray) -> np.ndarray:
        found = np.empty((64, 4))
        descend(
            spectra, np.full(64, channels), problem_of(MODEL), DescentOptions(False, 1e-3, 1e-4, 1000), np.arange(64),
            starts.copy(), found, workspace_for(size, MODEL.degrees, int(channels)), np.empty((0, size, size)), bars,
        )  # fmt: skip
        return found

    free = outcomes(np.empty(0))
    assert (free[:, 3] == CONVERGED).all()
    assert np.array_equal(outcomes(free[:, 1] + 1e6), free)
    barred = outcomes(free[:, 1] - 0.5)
    assert (barred[:, 3] == GIVEN_UP).mean() > 0.9
    assert barred[:, 2].sum() < 0.8 * free[:, 2].sum()
