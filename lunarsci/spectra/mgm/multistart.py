"""The search of the minima of some spectra: which is lowest, and how close comes the next.

Descents on coarse spectra are cheap and find the candidates; only one that may be the lowest is finished on all
channels. Hops from the lowest find what random starts rarely do, the minimum in which a neighbouring band does the
work.

Covariances of many fits: the inverse curvatures, eight at a time.

Neighbouring channels put together: bands are tens of channels wide, so a coarse spectrum leads near the minimum at a
fraction of the cost.
"""

import math
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import choose, load, spread, store
from lunarsci.spectra.mgm.levenberg_marquardt import (
    NOT_FINITE,
    Channels,
    DescentOptions,
    FitProblem,
    Workspace,
    channels_of,
    descend,
    fill_lane,
    workspace_for,
)
from lunarsci.spectra.mgm.moments import evaluate, update
from lunarsci.spectra.mgm.normal_equations import damped, factorise, invert, matrix_side, solve_step

COARSE_CHANNELS = 128
"""On simulated spectra 48 find the minima as often and 10 % faster; on rover spectra, whose misfit is not noise, the
order of their many minima is then too often another than on all channels."""


def coarse_size(channels: int) -> int:
    """How many channels are put together so that about `COARSE_CHANNELS` remain."""
    return max(1, round(channels / COARSE_CHANNELS))


def coarsened(fine: Channels, together: int) -> Channels:
    """Weighted means of `together` channels each; channels without weight do not count."""
    rows, channels = fine.data.shape
    cells = -(-channels // together)
    coarse = Channels(
        np.empty((rows, cells)), np.empty((rows, fine.columns.shape[1], cells)), np.empty((rows, cells)),
        np.empty((rows, cells)),
    )  # fmt: skip
    _coarsen(fine, together, coarse)
    return coarse


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _coarsen(fine: Any, together: int, coarse: Any) -> None:
    rows, channels = fine.data.shape
    for row in range(rows):
        own = min(row, fine.wavelength.shape[0] - 1)
        for cell in range(coarse.data.shape[1]):
            first, last = cell * together, min((cell + 1) * together, channels)
            total = 0.0
            for i in range(first, last):
                total += fine.root_weight[row, i] ** 2
            place, value = 0.0, 0.0
            for m in range(fine.columns.shape[1]):
                coarse.columns[row, m, cell] = 0.0
            for i in range(first, last):
                share = fine.root_weight[row, i] ** 2 / total if total > 0.0 else 1.0 / (last - first)
                place += share * fine.wavelength[own, i]
                value += share * fine.data[row, i]
                for m in range(fine.columns.shape[1]):
                    coarse.columns[row, m, cell] += share * fine.columns[own, m, i]
            coarse.wavelength[row, cell], coarse.data[row, cell] = place, value
            coarse.root_weight[row, cell] = math.sqrt(total)


@compiled
def _slope(space: Any, problem: Any, curved: int) -> None:
    """Residuals, J r and, where `curved` is 1, J J' of a workspace's spectra at its trial points."""
    evaluate(
        channels_of(space),
        space.trial,
        problem.degrees,
        problem.logarithmic,
        curved,
        space.work,
        space.residuals,
        space.sums,
    )
    update(space.sums, space.trial, problem.degrees, spread(1.0), space.curvature, space.slope)


@compiled
def _shift_to_means(fine: Any, coarse: Any, together: int) -> None:
    """Shift the coarse data so that the coarse residuals are the means of the fine ones."""
    count = fine.residuals.shape[0]
    for cell in range(-(-count // together)):
        total = spread(0.0)
        for i in range(cell * together, min((cell + 1) * together, count)):
            total += load(fine.roots, i) * load(fine.residuals, i)
        own = load(coarse.roots, cell)
        weight = choose(own, own, spread(1.0))
        shift = (total / weight - load(coarse.residuals, cell)) / weight
        store(coarse.data, cell, load(coarse.data, cell) + choose(own, shift, spread(0.0)))


@compiled
def _shift_slope(fine: Any, coarse: Any, problem: Any) -> None:
    """Shift the coarse data by what the model changes along the step by which the two slopes differ."""
    size = coarse.point.shape[0]
    one, none = spread(1.0), spread(0.0)
    for p in range(size):
        store(coarse.slope, p, load(fine.slope, p) - load(coarse.slope, p))
        store(coarse.pull, p, none)
        store(coarse.free, p, one)
    least = solve_step(
        coarse.curvature, problem.precision, one, one, coarse.slope, coarse.pull, coarse.free, 0,
        coarse.matrix, coarse.step,
    )  # fmt: skip
    for p in range(size):
        store(coarse.trial, p, load(coarse.point, p) + choose(least, load(coarse.step, p), none))
    before = coarse.residuals.copy()
    _slope(coarse, problem, 0)
    for i in range(coarse.data.shape[0]):
        own = load(coarse.roots, i)
        shift = (load(before, i) - load(coarse.residuals, i)) / choose(own, own, one)
        store(coarse.data, i, load(coarse.data, i) + shift)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def correct(
    fine: Any, coarse: Any, together: int, problem: Any, points: Any, fine_space: Any, coarse_space: Any
) -> None:
    """Shift the coarse data so that at the points, (rows, p), coarse residuals are the means of the fine ones and the
    slope of the coarse objective is that of the fine one.

    What the model and the noise do within a coarse channel is then accounted for, and minima near the points are the
    same. The correction of full approximation storage: Brandt (1977), Math. Comp. 31, 333,
    10.1090/S0025-5718-1977-0431719-X; here it is put on the data, which keeps the objective a sum of squares.
    """
    rows = points.shape[0]
    for first in range(0, rows, LANES):
        for lane in range(LANES):
            row = min(first + lane, rows - 1)
            fill_lane(fine, row, fine_space, lane)
            fill_lane(coarse, row, coarse_space, lane)
            for p in range(points.shape[1]):
                fine_space.trial[p, lane] = points[row, p]
                coarse_space.trial[p, lane] = points[row, p]
                coarse_space.point[p, lane] = points[row, p]
        _slope(fine_space, problem, 0)
        _slope(coarse_space, problem, 0)
        _shift_to_means(fine_space, coarse_space, together)
        _slope(coarse_space, problem, 1)
        _shift_slope(fine_space, coarse_space, problem)
        for lane in range(min(LANES, rows - first)):
            for cell in range(coarse.data.shape[1]):
                coarse.data[first + lane, cell] = coarse_space.data[cell, lane]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _invert_all(curvatures: Any, problem: Any, space: Any, covariances: Any) -> None:
    jobs, size, state = curvatures.shape[0], curvatures.shape[1], space.state
    one, side = spread(1.0), matrix_side(space.matrix)
    for first in range(0, jobs, LANES):
        for p in range(size):
            store(space.free, p, one)
            for q in range(p, size):
                for lane in range(LANES):
                    space.curvature[p * size + q, lane] = curvatures[min(first + lane, jobs - 1), p, q]
        damped(space.curvature, problem.precision, one, one, space.free, size, side, space.matrix)
        store(state, 0, factorise(space.matrix, side))
        invert(space.matrix, size, side, space.curvature)
        for lane in range(min(LANES, jobs - first)):
            regular = state[0, lane] > 0.0
            for p in range(size):
                for q in range(p, size):
                    value = space.curvature[p * size + q, lane] if regular else np.nan
                    covariances[first + lane, p, q] = value
                    covariances[first + lane, q, p] = value


def inverses(curvatures: FloatArray, problem: FitProblem, space: Workspace) -> FloatArray:
    """(J J' + precision)^-1 from the upper triangles of J J', (jobs, p, p); NaN where there is none."""
    covariances = np.empty_like(curvatures)
    _invert_all(curvatures, problem, space, covariances)
    return covariances


COARSE_TOLERANCE, HOP_TOLERANCE = 1.0, 0.3
"""Decrease to be expected, in chi-square, at which a descent on the coarse spectrum ends: of starts, of hops."""
SAME_BASIN = 1.5
"""In one parabolic basin the square of the distance, in standard deviations, is at most the rise of the objective; a
point that is not farther than this factor allows is on its way back."""
COARSE_DOUBT = 3.0
"""By how much the order of two minima may differ between coarse and full spectrum."""
MAX_ROUNDS = 4
FIRST_DAMPING, LATER_DAMPING = 1e-3, 1e-6
COMPETING_CHI2 = 5.0
"""A minimum higher by this or more is no competing of the best; assumed."""
SAME_SIGMAS = 0.5
"""Minima within this of each other, in posterior standard deviations, are one; assumed."""


class Multistart:
    """Fits of spectra (n rows) that share their channels.

    Attributes
    ----------
    best, covariance, outcome : (n, p), (n, p, p) and (n, 4): chi-square, objective, iterations, status.
    competing, competing_sigmas : (n,) how much higher the next minimum is, and how far it lies.
    """

    def __init__(self, fine: Channels, problem: FitProblem, tolerance: float, max_iterations: int) -> None:
        rows, channels = fine.data.shape
        size = problem.prior.size
        self.problem, self.tolerance, self.max_iterations = problem, tolerance, max_iterations
        self.together = coarse_size(channels)
        self.fine = fine
        self.coarse = coarsened(fine, self.together)
        self.used = [np.count_nonzero(spectra.root_weight, axis=1).astype(float) for spectra in (fine, self.coarse)]
        self.spaces = tuple(
            workspace_for(size, problem.degrees, spectra.data.shape[1]) for spectra in (fine, self.coarse)
        )
        self.best, self.outcome = np.empty((rows, size)), np.tile([np.nan, np.inf, 0.0, NOT_FINITE], (rows, 1))
        self.covariance = np.full((rows, size, size), np.nan)
        self.floor = np.full(rows, np.inf)
        self.competing, self.competing_sigmas = np.full(rows, np.inf), np.zeros(rows)

    def start(self, starts: FloatArray) -> None:
        """Descend from every start, (s, n, p), and finish the lowest."""
        count, rows, size = starts.shape
        every = np.tile(np.arange(rows), count)
        points, outcomes = self._explore(every, starts.reshape(-1, size), COARSE_TOLERANCE)
        lowest = outcomes[:, 1].reshape(count, rows).argmin(axis=0) * rows + np.arange(rows)
        self.best[:] = points[lowest]
        alive = np.flatnonzero(np.isfinite(outcomes[lowest, 1]))
        self._settle(alive)
        floor = outcomes[lowest, 1][every]
        others = np.isfinite(self.floor[every]) & (outcomes[:, 1] < floor + COMPETING_CHI2)
        others[lowest] = False
        others &= self._apart(every, points) > SAME_SIGMAS
        self._challenge(every[others], points[others])

    def hop(self, hops: FloatArray) -> None:
        """Descend from every hop, (h, 2), away from the best; again from a better one where that finds it."""
        rows = np.flatnonzero(np.isfinite(self.covariance[:, 0, 0]) & np.isfinite(self.floor))
        for _ in range(MAX_ROUNDS):
            if not (len(hops) and rows.size):
                return
            every, points = self._displaced(rows, hops)
            points, outcomes = self._explore(every, points, HOP_TOLERANCE)
            higher, apart = outcomes[:, 1] - self.floor[every], self._apart(every, points)
            back = apart**2 < SAME_BASIN * (np.maximum(higher, 0.0) + HOP_TOLERANCE)
            keep = (higher < COMPETING_CHI2 + COARSE_TOLERANCE) & ~back
            rows = self._challenge(every[keep], points[keep])

    def _displaced(self, rows: IndexArray, hops: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Rows and points of all hops, the other parameters following their correlation."""
        index = hops[:, 0].astype(int)
        covariance = self.covariance[rows]
        variance = covariance[:, index, index]
        every, which = np.nonzero(variance > 0)
        step = hops[which, 1] / np.sqrt(variance[every, which])
        points = self.best[rows[every]] + step[:, None] * covariance[every, :, index[which]]
        return rows[every], points

    def _apart(self, rows: IndexArray, points: FloatArray) -> FloatArray:
        """Largest difference from the best of a parameter, in its standard deviations."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)[rows]
        with np.errstate(invalid="ignore"):
            sigma = np.where(variance > 0, np.sqrt(variance), np.inf)
        return np.asarray(np.max(np.abs(points - self.best[rows]) / sigma, axis=1, initial=0.0))

    def _explore(
        self, rows: IndexArray, points: FloatArray, tolerance: float, tempering: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        """Where points lead to on the coarse spectrum, and the outcomes."""
        found, outcomes = np.array(points), np.empty((len(rows), 4))
        options = DescentOptions(
            tempering, FIRST_DAMPING if tempering else LATER_DAMPING, tolerance, self.max_iterations
        )
        descend(
            self.coarse, self.used[1], self.problem, options, rows, found, outcomes, self.spaces[1],
            np.empty((0, 1, 1)), np.empty(0),
        )  # fmt: skip
        return found, outcomes

    def _finish(self, rows: IndexArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where points lead to on all channels, the outcomes and the covariances."""
        found, outcomes = np.array(points), np.empty((len(rows), 4))
        curvatures = np.empty((len(rows), found.shape[1], found.shape[1]))
        options = DescentOptions(False, LATER_DAMPING, self.tolerance, self.max_iterations)
        descend(
            self.fine, self.used[0], self.problem, options, rows, found, outcomes, self.spaces[0], curvatures,
            np.empty(0),
        )  # fmt: skip
        return found, outcomes, inverses(curvatures, self.problem, self.spaces[0])

    def _settle(self, rows: IndexArray) -> None:
        """Finish the lowest coarse minima, the coarse data corrected there."""
        if not rows.size:
            return
        points = self.best[rows]
        if self.together > 1:
            correct(self.fine, self.coarse, self.together, self.problem, self.best, *self.spaces)
        points, outcomes = self._explore(rows, points, self.tolerance, tempering=False)
        self.floor[rows] = outcomes[:, 1]
        self.best[rows], self.outcome[rows], self.covariance[rows] = self._finish(rows, points)

    def _challenge(self, rows: IndexArray, points: FloatArray) -> IndexArray:
        """Let minima of the coarse spectrum contend with the best; the rows in which one took the place."""
        if not rows.size:
            return rows
        points, outcomes = self._explore(rows, points, self.tolerance, tempering=False)
        higher, apart = outcomes[:, 1] - self.floor[rows], self._apart(rows, points)
        keep = (higher < COMPETING_CHI2) & (apart > SAME_SIGMAS)
        rows, points, higher, apart = rows[keep], points[keep], higher[keep], apart[keep]
        order = self._distinct(rows, points, higher)
        rows, points, higher, apart = rows[order], points[order], higher[order], apart[order]
        doubtful = higher <= COARSE_DOUBT
        self._note(rows[~doubtful], higher[~doubtful], apart[~doubtful])
        return self._decide(rows[doubtful], points[doubtful], higher[doubtful])

    def _distinct(self, rows: IndexArray, points: FloatArray, higher: FloatArray) -> IndexArray:
        """Contenders by row and rising objective, without those that have come to the same place as the one before."""
        order = np.lexsort((higher, rows))
        sigma = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)[rows[order]])
        moved = np.diff(points[order], axis=0, prepend=np.inf)
        with np.errstate(invalid="ignore", divide="ignore"):
            apart = np.nanmax(np.abs(moved) / sigma, axis=1, initial=0.0)
        return np.asarray(order[(apart > SAME_SIGMAS) | (np.diff(rows[order], prepend=-1) > 0)])

    def _decide(self, rows: IndexArray, points: FloatArray, higher: FloatArray) -> IndexArray:
        """Finish the contenders; the rows in which one took the place."""
        if not rows.size:
            return rows
        points, outcomes, covariance = self._finish(rows, points)
        difference, apart = outcomes[:, 1] - self.outcome[rows, 1], self._apart(rows, points)
        other = np.isfinite(difference) & (apart > SAME_SIGMAS)
        order = np.lexsort((difference, rows))
        order = order[other[order]]
        order = order[np.diff(rows[order], prepend=-1) > 0]
        better = order[difference[order] < 0]
        self._note(rows[order], difference[order], apart[order])
        won = rows[better]
        self.floor[won] += higher[better]
        self.best[won], self.outcome[won], self.covariance[won] = points[better], outcomes[better], covariance[better]
        self.competing[won], self.competing_sigmas[won] = -difference[better], apart[better]
        return np.asarray(won)

    def _note(self, rows: IndexArray, higher: FloatArray, apart: FloatArray) -> None:
        """Remember the lowest of other minima."""
        for row, value, sigmas in zip(rows, higher, apart, strict=True):
            if value < self.competing[row]:
                self.competing[row], self.competing_sigmas[row] = value, sigmas
