"""Fits of images in which neighbours help: beside fits of every pixel alone, and whatever the image is cut into.

Kinds of solutions: models of some bands beside the whole one, and who tries whose solution beside plain loops.

The benchmark of images measures what it says.
"""

from functools import cache
from typing import Any

import numpy as np
import pytest
import strips

from lunarsci.arrays import FloatArray
from lunarsci.compiled import set_threads
from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.batch import NOT_FITTED, FitBatch, channels_of, problem_of
from lunarsci.spectra.mgm.data import prepare_rows
from lunarsci.spectra.mgm.fit import fit_arrays, scaled, starting_points
from lunarsci.spectra.mgm.levenberg_marquardt import (
    CONVERGED,
    GIVEN_UP,
    Channels,
    DescentOptions,
    FitProblem,
    Linearised,
    descend,
    workspace_for,
)
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.region import (
    CONTEST,
    NEIGHBOUR,
    NOWHERE,
    SINGLE,
    TILE,
    PartModel,
    RegionFits,
    askers,
    fit_region,
    kinds_of,
    likest_of,
)

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
    rng = np.random.default_rng(0)
    part = rng.permutation(np.flatnonzero(places[:, 1] // TILE != 1))
    set_threads(1)
    try:
        again = fit_region(ground.wavelength_nm, reflectance[part], places[part], MODEL)
    finally:
        set_threads(0)
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
            starts.copy(), found, workspace_for(size, MODEL.degrees, int(channels)), Linearised.of(size), bars,
        )  # fmt: skip
        return found

    free = outcomes(np.empty(0))
    assert (free[:, 3] == CONVERGED).all()
    assert np.array_equal(outcomes(free[:, 1] + 1e6), free)
    barred = outcomes(free[:, 1] - 0.5)
    assert (barred[:, 3] == GIVEN_UP).mean() > 0.9
    assert barred[:, 2].sum() < 0.8 * free[:, 2].sum()


@cache
def strip_rows() -> FloatArray:
    """Spectra of a made-up strip, (36, channels)."""
    return strips.mixtures(strips.EIGHTY_FIVE_NM, (6, 6), seed=77).reflectance.reshape(36, -1)


def prepared() -> tuple[Channels, FloatArray]:
    """Spectra as the kernel takes them, less their mean, and these."""
    rows = prepare_rows(strips.EIGHTY_FIVE_NM, strip_rows())
    ln_reflectance = np.log(rows.reflectance)
    level = ln_reflectance.mean(axis=1)
    return channels_of(rows, MODEL, ln_reflectance - level[:, None]), level


def descended(problem: FitProblem, spectra: Channels, starts: FloatArray, options: DescentOptions) -> FloatArray:
    """Points moved, and the outcomes beside them, (n, k + 4)."""
    points, outcomes, size = np.array(starts), np.empty((len(starts), 4)), starts.shape[1]
    descend(
        spectra, np.full(len(starts), 85.0), problem, options, np.arange(len(starts)), points, outcomes,
        workspace_for(size, problem.degrees, 85), Linearised.of(size), np.empty(0),
    )  # fmt: skip
    assert (outcomes[:, 3] == CONVERGED).all()
    return np.column_stack([points, outcomes])


@pytest.mark.parametrize("kind", [0b101101001, 0b000101000, 0b111111110])
def test_the_model_of_some_bands_is_the_whole_one_with_the_others_held_at_nothing(kind: int) -> None:
    spectra, level = prepared()
    part, held = PartModel.of(MODEL, kind), MODEL
    for number, band in enumerate(MODEL.assemblage.bands):
        if not (kind >> number) & 1:
            held = held.bounded(f"{band.key}_strength", 0.0, 0.0)
    starts = starting_points(MODEL, spectra.data, 1)[0]
    found = descended(part.problem, spectra, starts[:, part.index], DescentOptions(False, 1e-3, 1e-9, 1000))
    points, size = part.whole(found[:, :-4]), part.index.size
    free = np.where(held.upper == held.lower, 0, starts)
    oracle = fit_arrays(strips.EIGHTY_FIVE_NM, strip_rows(), held, starts=scaled(MODEL, free, level))
    same = np.abs(found[:, size + 1] - oracle.objective) < 1e-3
    assert same.mean() > 0.9  # where both came to one minimum
    off = np.abs(scaled(MODEL, points, level) - oracle.values)[same, MODEL.degrees :]
    free = oracle.sigma[same, MODEL.degrees :] > 0
    assert (off[~free] == 0).all() and (off[free] / oracle.sigma[same, MODEL.degrees :][free]).max() < 0.05
    assert not (kinds_of(points, MODEL) & ~kind).any()


def test_a_step_ahead_of_the_end_is_nearer_to_the_minimum() -> None:
    spectra, _ = prepared()
    starts = starting_points(MODEL, spectra.data, 1)[0]
    end, loose, ahead = (
        descended(problem_of(MODEL), spectra, starts, DescentOptions(False, 1e-3, tolerance, 1000, goes))
        for tolerance, goes in ((1e-9, False), (1e-2, False), (1e-2, True))
    )
    same = np.abs(loose[:, -3] - end[:, -3]) < 0.02
    assert same.mean() > 0.9
    left, expected = (loose - end)[same, -3], (ahead - end)[same, -3]
    assert np.abs(expected).mean() < 0.5 * left.mean()
    assert np.array_equal(loose[:, -2], ahead[:, -2])
    away = [np.abs(found - end)[same, :-4].mean() for found in (loose, ahead)]
    assert away[1] < 0.6 * away[0]


def test_pixels_try_the_likest_of_each_kind_near_them() -> None:
    rng = np.random.default_rng(5)
    grid = np.full((1, 32, 32), -1)
    place = np.argwhere(rng.random((9, 11)) < 0.8)
    count = len(place)
    grid[0, place[:, 0], place[:, 1]] = np.arange(count)
    tile, keys, changed = np.zeros(count, dtype=np.intp), rng.integers(0, 8, count), rng.random(count) < 0.6
    summary = rng.normal(size=(count, 3))
    expected = []
    for own in range(count):
        best: dict[int, tuple[float, int]] = {}
        for other in np.flatnonzero(changed & (np.abs(place - place[own]).max(axis=1) <= 2)).tolist():
            lacking, apart = int(keys[own] & ~keys[other]), int(keys[own] ^ keys[other])
            if apart and not (lacking == apart and apart.bit_count() > 1):
                unlike = float(((summary[other] - summary[own]) ** 2).sum())
                best[int(keys[other])] = min(best.get(int(keys[other]), (np.inf, -1)), (unlike, other))
        expected += [(own, other) for _, other in sorted(best.values())[:2]]
    found = askers(grid, tile, place, keys, summary, changed, 2, 2)
    assert list(zip(*(part.tolist() for part in found), strict=True)) == expected


def test_the_likest_of_the_nearest_is_taken() -> None:
    rng = np.random.default_rng(6)
    place, tile = rng.integers(0, 32, (60, 2)), np.repeat([0, 1], 30)
    data, root = rng.normal(size=(60, 5)), rng.uniform(1, 2, (60, 5))
    root[rng.random((60, 5)) < 0.1] = 0.0
    rows, solved = np.array([3, 40, 59]), np.arange(0, 60, 2)
    for own, got in zip(rows, likest_of(rows, solved, tile, place, data, root, 4), strict=True):
        others = solved[tile[solved] == tile[own]]
        near = others[np.argsort(((place[others] - place[own]) ** 2).sum(axis=1), kind="stable")[:4]]
        unlike = (((data[near] - data[own]) * root[own] * (root[near] > 0)) ** 2).sum(axis=1)
        assert got == near[unlike.argmin()]


def test_an_image_with_a_contest_at_every_pixel_is_nowhere_higher(load_benchmark, capsys: Any) -> None:
    """As its line says it."""
    bench = load_benchmark("bench_map")
    strip = bench.mixtures(bench.EIGHTY_FIVE_NM, (6, 6), seed=2)
    bench.compare(strip, mgm_model("OPX-CPX"), 1)
    name, alone, found, higher, by_one, *_ = capsys.readouterr().out.split()
    assert name == strip.name
    assert float(alone) > 0 and float(found) > 0
    assert (float(higher), float(by_one)) == (0.0, 0.0)
