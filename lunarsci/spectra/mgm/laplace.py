"""Laplace's covariance of many fits, bounds taken into account, eight at a time, compiled.

A parameter that the data press against a bound has a one-sided density, exp(-g t - h t^2 / 2) in the distance t from
the bound, g the slope there and h the curvature with the free ones following; its variance is the mean of t^2, and the
free ones follow it. Fixed ones have variance 0.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import uncounted
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import aligned, choose, highest, load, spread, store
from lunarsci.spectra.mgm.forward import (
    damped,
    factorise,
    invert,
    matrix_side,
    prior_pull,
)
from lunarsci.spectra.mgm.levenberg_marquardt import Channels, FitProblem, linearised, workspace_for

USED, WIDE, PIVOT, VARIANCE, BEND, CHI2 = range(6)
"""Rows of a workspace's `state` here: parameters that the data determine, then reduced chi-square; weight of the data
with their errors widened; least pivot of the curvature; variance and curvature of a parameter on its bound; chi-square.
"""
TAIL = 30.0
"""From here on the one-sided law is an exponential one with a first correction, to 1e-4, and the error function runs
out."""


class LaplaceErrors(NamedTuple):
    """Of n fits of p parameters, row by row; in the units of `MgmModel`.

    Attributes
    ----------
    rms_ln, reduced_chi2 : (n,) root mean square of data - model, and chi-square over channels less the number of
        parameters that the data determine.
    covariance : (n, p, p), the errors of the data widened to a reduced chi-square of 1 where it is above.
    """

    rms_ln: FloatArray
    reduced_chi2: FloatArray
    covariance: FloatArray


def _rooms(size: int) -> tuple[FloatArray, FloatArray]:
    """For an inverse, both triangles, and the upper triangle of a covariance; (p p, 8) each."""
    return aligned(size * size), aligned(size * size)


def laplace_errors(spectra: Channels, problem: FitProblem, points: FloatArray, chi2: FloatArray) -> LaplaceErrors:
    """Errors at the minima `points`, (n, p), of `spectra`, (n, c), whose chi-square is `chi2`, (n,).

    NaN where the continuum is not above 0 or a curvature has no inverse.
    """
    rows, size = points.shape
    space = workspace_for(size, problem.degrees, spectra.data.shape[1])
    ends = linearised(spectra, problem, points, space, curved=True)
    rms_ln = np.sqrt(np.mean((ends.residuals / spectra.root_weight) ** 2, axis=1))
    freedom = (chi2, float(spectra.data.shape[1]))
    result = LaplaceErrors(rms_ln, np.where(np.isfinite(rms_ln), 1.0, np.nan), np.empty((rows, size, size)))
    _describe(ends, problem, np.ascontiguousarray(points), freedom, space, _rooms(size), result)
    return result


@uncounted
def _describe(ends: Any, problem: Any, points: Any, freedom: Any, space: Any, rooms: Any, result: Any) -> None:
    """Reduced chi-square and covariance of `laplace_errors` into `result`, eight rows at a time.

    `freedom` : chi-square, (n,), and how many channels there are.
    """
    (rows, size), state, (chi2, channels) = points.shape, space.state, freedom
    for first in range(0, rows, LANES):
        for lane in range(LANES):
            row = min(first + lane, rows - 1)
            state[CHI2, lane] = chi2[row]
            for p in range(size):
                space.point[p, lane], space.slope[p, lane] = points[row, p], ends.slopes[row, p]
                for q in range(p, size):
                    space.curvature[p * size + q, lane] = ends.curvatures[row, p, q]
        prior_pull(space.point, problem.prior, problem.precision, space.pull)
        _determined(problem, space, rooms[0])
        reduced = load(state, CHI2) / highest(spread(channels) - load(state, USED), spread(1.0))
        store(state, WIDE, spread(1.0) / highest(reduced, spread(1.0)))
        _widen(problem, space)
        _bounded(problem, space, rooms)
        store(state, USED, reduced)
        for lane in range(min(LANES, rows - first)):
            result.reduced_chi2[first + lane] *= state[USED, lane]
            if math.isnan(result.reduced_chi2[first + lane]):
                state[PIVOT, lane] = 0.0
        _hand_over(space, rooms[1], first, result.covariance)


@uncounted
def _determined(problem: Any, space: Any, inverse: Any) -> None:
    """Trace of (J J' + precision)^-1 J J' of the parameters that are not fixed, into `USED`; without an inverse, their
    number."""
    size, side, free = problem.prior.size, matrix_side(space.matrix), 0.0
    for p in range(size):
        is_free = 0.0 if problem.lower[p] == problem.upper[p] else 1.0
        store(space.free, p, spread(is_free))
        free += is_free
    one = spread(1.0)
    damped(space.curvature, problem.precision, one, one, space.free, size, side, space.matrix)
    pivot = factorise(space.matrix, side)
    invert(space.matrix, size, side, inverse)
    total = spread(0.0)
    for p in range(size):
        one = load(space.free, p)
        total += load(inverse, p * size + p) * load(space.curvature, p * size + p) * one
        for q in range(p + 1, size):
            both = load(inverse, p * size + q) * load(space.curvature, p * size + q) * 2.0
            total += both * one * load(space.free, q)
    store(space.state, USED, choose(pivot, total, spread(free)))


@uncounted
def _widen(problem: Any, space: Any) -> None:
    """Curvature and descent of half the objective with the data's errors widened, in place of the data's own."""
    size, share = problem.prior.size, load(space.state, WIDE)
    for p in range(size):
        store(space.slope, p, load(space.slope, p) * share - load(space.pull, p))
        for q in range(p, size):
            bend = load(space.curvature, p * size + q) * share
            store(space.curvature, p * size + q, bend + problem.precision[p, q])


@uncounted
def _bounded(problem: Any, space: Any, rooms: Any) -> None:
    """Upper triangle of the covariance, from that of the curvature; state `PIVOT` is above 0 where there is one."""
    inverse, covariance = rooms
    size, side = problem.prior.size, matrix_side(space.matrix)
    _free_within(problem, space)
    _free_part(space, size, side)
    store(space.state, PIVOT, factorise(space.matrix, side))
    invert(space.matrix, size, side, inverse)
    for p in range(size):
        is_free = load(space.free, p)
        for q in range(p, size):
            value = load(inverse, p * size + q) * is_free * load(space.free, q)
            store(inverse, p * size + q, value)
            store(inverse, q * size + p, value)
            store(covariance, p * size + q, value)
    for k in range(size):
        if _any_held(problem, space, k):
            _add_held(space, inverse, covariance, size, k)


@uncounted
def _free_within(problem: Any, space: Any) -> None:
    """Free what is not fixed and not on a bound."""
    for p in range(problem.prior.size):
        for lane in range(LANES):
            here, low, high = space.point[p, lane], problem.lower[p], problem.upper[p]
            space.free[p, lane] = 1.0 if low < here < high else 0.0


@uncounted
def _any_held(problem: Any, space: Any, k: int) -> bool:
    """Whether parameter k is on a bound in some lane, and not fixed."""
    held = problem.lower[k] < problem.upper[k]
    total = 0.0
    for lane in range(LANES):
        total += space.free[k, lane]
    return held and total < LANES


@uncounted
def _free_part(space: Any, size: int, side: int) -> None:
    """The curvature of the free parameters as a matrix to be factorised; rows and columns of others are those of 1."""
    for p in range(size):
        is_free = load(space.free, p)
        for q in range(p + 1, size):
            store(space.matrix, p * side + q, load(space.curvature, p * size + q) * is_free * load(space.free, q))
        store(space.matrix, p * side + p, choose(is_free, load(space.curvature, p * size + p), spread(1.0)))


@uncounted
def _add_held(space: Any, inverse: Any, covariance: Any, size: int, k: int) -> None:
    """What parameter k, on its bound, adds: its variance, and the free ones that follow it."""
    bend = load(space.curvature, k * size + k)
    for p in range(size):
        move = spread(0.0)
        for q in range(size):
            move -= load(inverse, p * size + q) * load(space.curvature, min(k, q) * size + max(k, q))
        store(space.step, p, move)
        bend += move * load(space.curvature, min(k, p) * size + max(k, p))
    store(space.step, k, spread(1.0))
    store(space.state, BEND, bend)
    for lane in range(LANES):
        held = space.free[k, lane] == 0.0
        variance = _one_sided(abs(space.slope[k, lane]), space.state[BEND, lane]) if held else 0.0
        space.state[VARIANCE, lane] = variance
    share = load(space.state, VARIANCE)
    for p in range(size):
        for q in range(p, size):
            more = share * load(space.step, p) * load(space.step, q)
            store(covariance, p * size + q, load(covariance, p * size + q) + more)


@uncounted
def _one_sided(slope: float, bend: float) -> float:
    """Mean of t^2 under exp(-slope t - bend t^2 / 2), t >= 0: normal law truncated at 0."""
    if not bend > 0:
        return math.nan
    scale = math.sqrt(bend)
    a = slope / scale
    if a > TAIL:
        return 2.0 / slope**2 * (1.0 - 5.0 / a**2)
    ratio = math.exp(-0.5 * a * a) * math.sqrt(2.0 / math.pi) / math.erfc(a / math.sqrt(2.0))
    return (1.0 + a * a - a * ratio) / bend


@uncounted
def _hand_over(space: Any, covariance: Any, first: int, result: Any) -> None:
    """Write the covariances of the lanes to rows from `first` on."""
    rows, size = result.shape[0], result.shape[1]
    for lane in range(min(LANES, rows - first)):
        regular = space.state[PIVOT, lane] > 0.0
        for p in range(size):
            for q in range(p, size):
                value = covariance[p * size + q, lane] if regular else math.nan
                result[first + lane, p, q] = value
                result[first + lane, q, p] = value
