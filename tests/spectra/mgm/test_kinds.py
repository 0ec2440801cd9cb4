"""Kinds of solutions: models of some bands beside the whole one, and who tries whose solution beside plain loops."""

from functools import cache

import numpy as np
import pytest
import strips

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.batch import channels_of, problem_of
from lunarsci.spectra.mgm.data import prepare_rows
from lunarsci.spectra.mgm.fit import fit_arrays, scaled, starting_points
from lunarsci.spectra.mgm.levenberg_marquardt import (
    CONVERGED,
    Channels,
    DescentOptions,
    FitProblem,
    descend,
    workspace_for,
)
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.region import PartModel, askers, kinds_of, likest_of

MODEL = mgm_model("OPX-CPX")


@cache
def ground() -> FloatArray:
    """Spectra of a made-up strip, (36, channels)."""
    return strips.mixtures(strips.EIGHTY_FIVE_NM, (6, 6), seed=77).reflectance.reshape(36, -1)


def prepared() -> tuple[Channels, FloatArray]:
    """Spectra as the kernel takes them, less their mean, and these."""
    rows = prepare_rows(strips.EIGHTY_FIVE_NM, ground())
    ln_reflectance = np.log(rows.reflectance)
    level = ln_reflectance.mean(axis=1)
    return channels_of(rows, MODEL, ln_reflectance - level[:, None]), level


def descended(problem: FitProblem, spectra: Channels, starts: FloatArray, options: DescentOptions) -> FloatArray:
    """Points moved, and the outcomes beside them, (n, k + 4)."""
    points, outcomes, size = np.array(starts), np.empty((len(starts), 4)), starts.shape[1]
    descend(
        spectra, np.full(len(starts), 85.0), problem, options, np.arange(len(starts)), points, outcomes,
        workspace_for(size, problem.degrees, 85), np.empty((0, size, size)), np.empty(0),
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
    oracle = fit_arrays(strips.EIGHTY_FIVE_NM, ground(), held, starts=scaled(MODEL, free, level))
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
