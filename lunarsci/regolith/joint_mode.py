"""The most probable soil, the states that contradict it, and the limits of its parameters by profile."""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.stats import chi2, norm

from lunarsci.errors import ParameterError
from lunarsci.regolith.joint_problem import STEP, Problem, part_of
from lunarsci.regolith.prior import values_of

__all__ = ["mode_without_outliers", "profile_limits"]

FloatArray = npt.NDArray[np.float64]
STEPS, HIGHEST_DAMPING, CONVERGED = 100, 1e10, 1e-4
LONGEST = 2.0
"""Step, in standard deviations of the prior."""
OUTLIER = 1e-3
"""Chance that the largest residual of all good states is called an outlier."""
MOST_OUTLIERS = 0.2
RISES = (1.0, float(norm.isf(0.025)) ** 2)
"""Of -2 ln posterior at the 68 and 95 % limits of a normal law."""
FARTHEST, PROFILE_TOLERANCE = 8.0, 0.01
"""How far limits are looked for, in standard deviations of the prior; to what share of the posterior's."""


def mode_without_outliers(problem: Problem) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """Which states are kept, the mode and its covariance."""
    kept = np.ones(len(problem.inputs), dtype=bool)
    point = problem.center
    while True:
        part = part_of(problem, kept)
        point, covariance = find_mode(part, point)
        white = problem.white(point[None])[0]
        measured = np.isfinite(problem.forces).sum(axis=1)
        limit = chi2.isf(OUTLIER / len(kept), np.maximum(measured, 1))
        excess = np.where(kept, np.sum(white**2, axis=1) / limit, 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 1 or (~kept).sum() + 1 > MOST_OUTLIERS * len(kept):
            return kept, point, covariance
        kept[worst] = False


def profile_limits(
    problem: Problem, mode: FloatArray, covariance: FloatArray, progress: Callable[[int, int], None] | None = None
) -> FloatArray:
    """Low and high 68 %, low and high 95 % limits of every parameter in its unit, (4, 8).

    A limit is where the best of all other parameters costs as much as a normal law does there.
    """
    limits = np.empty((4, len(mode)))
    for k in range(len(mode)):
        for row, (rise, side) in enumerate((rise, side) for rise in RISES for side in (-1, 1)):
            limits[row, k] = _limit(problem, mode, k, side, rise, math.sqrt(covariance[k, k]))
        if progress is not None:
            progress(k + 1, len(mode))
    return values_of(problem.prior, limits)


def _limit(problem: Problem, mode: FloatArray, k: int, side: int, rise: float, sd: float) -> float:
    """Of parameter k, transformed; at most FARTHEST away."""
    fixed, lowest, start = np.arange(len(mode)) == k, problem.objective(mode), mode.copy()

    def excess(away: float) -> float:
        start[k] = mode[k] + side * away
        start[:] = find_mode(problem, start, fixed)[0]
        return problem.objective(start) - lowest - rise

    far, farthest = sd * math.sqrt(rise), FARTHEST * float(problem.width[k])
    while excess(far) < 0:
        if far >= farthest:
            return float(mode[k] + side * farthest)
        far = min(1.5 * far, farthest)
    start[:] = mode
    return float(mode[k] + side * brentq(excess, 0.0, far, xtol=PROFILE_TOLERANCE * sd))


def find_mode(
    problem: Problem, start: FloatArray, fixed: npt.NDArray[np.bool_] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Levenberg-Marquardt on whitened residuals, whose errors of the inputs follow the parameters.

    Parameters marked as fixed stay where they start.
    Minimising them with weights held fixed would flatten the dependence on sinkage, itself measured with error.
    """
    width, center = problem.width, problem.center

    def white(at: FloatArray) -> FloatArray:
        return np.concatenate([problem.white(at[None])[0].ravel(), (at - center) / width])

    point, damping = start.copy(), 1e-3
    rows = white(point)
    if not np.isfinite(rows).all():
        raise ParameterError("the model has no finite forces at the centre of the priors; check states and priors")
    curvature, held = np.diag(width**-2), np.diag(np.zeros(len(start)) if fixed is None else 1.0 * fixed)
    for _ in range(STEPS):
        columns = [(white(point + step) - white(point - step)) / (2 * STEP) for step in np.diag(STEP * width)]
        scaled = np.stack(columns, axis=-1) / width
        if fixed is not None:
            scaled[:, fixed] = 0.0
        curvature = scaled.T @ scaled + held
        slope = -scaled.T @ rows
        before = float(rows @ rows)
        while damping < HIGHEST_DAMPING:
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope)
            trial = white(point + np.clip(step, -LONGEST * width, LONGEST * width))
            if float(trial @ trial) < before:
                break
            damping *= 10
        else:
            break
        point, rows = point + np.clip(step, -LONGEST * width, LONGEST * width), trial
        damping = max(damping / 5, 1e-12)
        if before - float(rows @ rows) < CONVERGED:
            break
    return point, np.asarray(np.linalg.inv(curvature), dtype=np.float64)
