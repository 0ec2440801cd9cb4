"""The search of the lowest minimum of a fit, from many starts.

It descends on coarse spectra, neighbouring channels put together, in numbers of single precision: bands are tens of
channels wide, so they lead near the minima at a fraction of the cost. Only a minimum that may be the lowest is
finished, on all channels in double precision. Hops from the lowest find what random starts rarely do, the minimum in
which a neighbouring band does the work.
"""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.spectra.mgm.levenberg_marquardt import (
    FIRST_DAMPING,
    LATER_DAMPING,
    NOT_FINITE,
    Channels,
    DescentOptions,
    FitProblem,
    Linearised,
    Workspace,
    descend,
    inverses,
    linearised,
    workspace_for,
)

COARSE_CHANNELS = 128
"""On simulated spectra 48 find the minima as often and 10 % faster; on rover spectra, whose misfit is not noise, the
order of their many minima is then too often another than on all channels."""


def coarse_size(channels: int) -> int:
    """How many channels are put together so that about `COARSE_CHANNELS` remain."""
    return max(1, round(channels / COARSE_CHANNELS))


def added(values: FloatArray, together: int) -> FloatArray:
    """Sums of `together` neighbouring channels, the last axis, in their order."""
    cells = -(-values.shape[-1] // together)
    room = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, cells * together - values.shape[-1])])
    return np.asarray(sum((room[..., i::together] for i in range(1, together)), start=room[..., ::together].copy()))


def coarsened(fine: Channels, together: int) -> Channels:
    """Spectra with `together` neighbouring channels as one, their weighted means; those without weight do not count."""
    weight = fine.root_weight**2
    total = added(weight, together)
    empty = np.repeat(total == 0.0, together, axis=1)[:, : weight.shape[1]]
    counted = np.where(empty, 1.0, weight)
    share = counted / np.repeat(added(counted, together), together, axis=1)[:, : weight.shape[1]]
    wavelength, basis = added(share * fine.wavelength, together), added(share[:, None] * fine.basis, together)
    return Channels(wavelength, basis, added(share * fine.data, together), np.sqrt(total))


def correct(
    fine: Channels, coarse: Channels, together: int, problem: FitProblem, points: FloatArray,
    spaces: tuple[Workspace, Workspace],
) -> None:  # fmt: skip
    """Shift the coarse data so that at the points, (rows, p), coarse residuals are the means of the fine ones and the
    slope of the coarse objective is that of the fine one; `spaces` of both are of doubles.

    What the model and the noise do within a coarse channel is then accounted for, and minima near the points are the
    same. The correction of full approximation storage: Brandt (1977), Math. Comp. 31, 333,
    10.1090/S0025-5718-1977-0431719-X; here it is put on the data, which keeps the objective a sum of squares.
    """
    unbounded = np.full(problem.prior.size, np.inf)
    free = problem._replace(lower=-unbounded, upper=unbounded)
    wanted = linearised(fine, problem, points, spaces[0])
    weight = np.where(coarse.root_weight > 0, coarse.root_weight, np.inf)
    sums = added(fine.root_weight * wanted.residuals, together)
    coarse.data[:] += np.nan_to_num(sums / weight - linearised(coarse, free, points, spaces[1]).residuals) / weight
    here = linearised(coarse, free, points, spaces[1], curved=True)
    covariance = np.nan_to_num(inverses(here.curvatures, problem, spaces[0]))
    gap = wanted.slopes - here.slopes
    gap[np.isnan(sums).any(axis=1)] = 0.0  # the continuum is not above 0 in some fine channel
    step = np.einsum("rpq,rq->rp", covariance, gap)
    there = linearised(coarse, free, points + step, spaces[1])
    coarse.data[:] += np.nan_to_num(here.residuals - there.residuals) / weight


COARSE_TOLERANCE, HOP_TOLERANCE, NEAR_TOLERANCE = 1.0, 0.3, 0.01
"""Decrease to be expected, in chi-square, at which a descent on the coarse spectrum ends: of starts, hops, and of what
they found."""
SAME_BASIN = 1.5
"""In one parabolic basin the square of the distance, in standard deviations, is at most the rise of the objective; a
point that is not farther than this factor allows is on its way back."""
COARSE_DOUBT = 3.0
"""By how much the order of two minima may differ between coarse and full spectrum."""
MAX_ROUNDS = 4
"""Rounds of hops, each from a better minimum than the one before."""
SIGNIFICANT = 2.0
"""Standard errors from which a difference counts, and a band: the level of 95 % of all tests of this model."""
COMPETING_CHI2 = SIGNIFICANT**2 + COARSE_TOLERANCE
"""A minimum higher by this or more on the coarse spectrum is no competitor of the best."""
PATTERN_CHI2 = 4 * COMPETING_CHI2
"""Chi-square that neighbouring channels have in common (`Multistart._patterned`) above which the misfit is no noise and
minima are many. Of 88 spectra of a rover three in four lie above it, of 1600 synthetic ones none."""
SAME_SIGMAS = 0.5
"""Minima within this of each other, in posterior standard deviations, are one; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class KernelFits:
    """What `fit_batch` gives, row by row.

    Attributes
    ----------
    parameters, covariance : (n, p) and (n, p, p), of the lowest minimum; the inverse curvature, bounds not considered.
    chi2, objective : (n,) of the data, and with the prior's share.
    iterations, status : (n,) of the last descent on all channels; `CONVERGED`, `ITERATION_LIMIT` or `NOT_FINITE`.
    competing, competing_sigmas : (n,) by how much the objective of the next minimum is higher, infinite if there is
        none within `COMPETING_CHI2`, and how far it lies, in posterior standard deviations of the parameter that
        differs most.
    """

    parameters: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    objective: FloatArray
    iterations: FloatArray
    status: FloatArray
    competing: FloatArray
    competing_sigmas: FloatArray


class Multistart:
    """Fits of spectra (n rows) that share their channels.

    Attributes
    ----------
    fine, coarse : the spectra on all channels, and with `together` of these as one, corrected at the minima found.
    counts : of both, number of channels with weight, (n,).
    fine_space, coarse_space : a workspace of doubles, and one of singles for the coarse spectra.
    coarse_problem : the problem in singles.
    floor : (n,) objective of the best minimum on the coarse spectrum, with which others are compared.
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
        self.counts = [np.count_nonzero(spectra.root_weight, axis=1).astype(float) for spectra in (fine, self.coarse)]
        self.fine_space = workspace_for(size, problem.degrees, channels)
        self.coarse_space = workspace_for(size, problem.degrees, self.coarse.data.shape[1], np.float32)
        self.coarse_problem = problem.in_singles()
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
        """Descend from hops, (h, 2), away from the best; again from a better one where that finds it.

        Where the fit is within the noise those of a strength go first, which find nearly all, and the others only
        where there is another minimum near the best.
        """
        deeper = (hops[:, 0] - self.problem.degrees) % 3 == 2
        rows = np.flatnonzero(np.isfinite(self.covariance[:, 0, 0]) & np.isfinite(self.floor))
        for _ in range(MAX_ROUNDS):
            if not (len(hops) and rows.size):
                return
            patterned = self._patterned(rows) > PATTERN_CHI2
            better = np.union1d(self._hopped(rows[patterned], hops), self._hopped(rows[~patterned], hops[deeper]))
            near = rows[~patterned & np.isfinite(self.competing[rows])]
            rows = np.union1d(better, self._hopped(near, hops[~deeper]))

    def _patterned(self, rows: IndexArray) -> FloatArray:
        """Chi-square of the best that neighbouring coarse channels have in common, (n,): near 0 where it is noise."""
        spectra = self.coarse.part(rows)
        residuals = linearised(spectra, self.coarse_problem, self.best[rows], self.coarse_space).residuals
        return np.asarray((residuals[:, 1:] * residuals[:, :-1]).sum(axis=1))

    def _hopped(self, rows: IndexArray, hops: FloatArray) -> IndexArray:
        """Descend from hops away from the best of some rows; the rows in which that finds a better one."""
        if not (len(hops) and rows.size):
            return rows[:0]
        every, points = self._displaced(rows, hops)
        points, outcomes = self._explore(every, points, HOP_TOLERANCE)
        higher, apart = outcomes[:, 1] - self.floor[every], self._apart(every, points)
        back = apart**2 < SAME_BASIN * (np.maximum(higher, 0.0) + HOP_TOLERANCE)
        keep = (higher < COMPETING_CHI2 + COARSE_TOLERANCE) & ~back
        return self._challenge(every[keep], points[keep])

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
        """Where points lead to on the coarse spectrum, in singles, and the outcomes."""
        damping = FIRST_DAMPING if tempering else LATER_DAMPING
        options = DescentOptions(tempering, damping, tolerance, self.max_iterations)
        ends, outcomes = np.array(points), np.empty((len(rows), 4))
        descend(
            self.coarse, self.counts[1], self.coarse_problem, options, rows, ends, outcomes, self.coarse_space,
            Linearised.of(points.shape[1]), np.empty(0),
        )  # fmt: skip
        return ends, outcomes

    def _finish(self, rows: IndexArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where points lead to on all channels, the outcomes and the covariances."""
        options = DescentOptions(False, LATER_DAMPING, self.tolerance, self.max_iterations)
        there, ends, outcomes = Linearised.of(points.shape[1], len(rows)), np.array(points), np.empty((len(rows), 4))
        descend(
            self.fine, self.counts[0], self.problem, options, rows, ends, outcomes, self.fine_space, there,
            np.empty(0),
        )  # fmt: skip
        return ends, outcomes, inverses(there.curvatures, self.problem, self.fine_space)

    def _settle(self, rows: IndexArray) -> None:
        """Finish the lowest coarse minima, the coarse data corrected there."""
        if not rows.size:
            return
        points = self.best[rows]
        if self.together > 1:
            spaces = self.fine_space, workspace_for(self.best.shape[1], self.problem.degrees, self.coarse.data.shape[1])
            correct(self.fine, self.coarse, self.together, self.problem, self.best, spaces)
        points, outcomes = self._explore(rows, points, NEAR_TOLERANCE, tempering=False)
        self.floor[rows] = outcomes[:, 1]
        self.best[rows], self.outcome[rows], self.covariance[rows] = self._finish(rows, points)

    def _challenge(self, rows: IndexArray, points: FloatArray) -> IndexArray:
        """Let minima of the coarse spectrum contend with the best; the rows in which one took the place."""
        if not rows.size:
            return rows
        points, outcomes = self._explore(rows, points, NEAR_TOLERANCE, tempering=False)
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
