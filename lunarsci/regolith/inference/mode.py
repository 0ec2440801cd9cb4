"""The most probable soil, the states that contradict it, and the limits of its parameters by profile.

Groups of neighbouring states predicted from all others, without fitting anew.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.inference.problem import (
    STEP,
    JointProblem,
    common_share,
    error_covariance,
    part_of,
    shares_of,
    states_alike,
)
from lunarsci.regolith.prior import SIGNIFICANCE, values_of

STEPS, HIGHEST_DAMPING = 100, 1e10
"""Of Levenberg-Marquardt: steps at most, and the damping beyond which no step is tried."""
FINE, CONVERGED, ROUGH = 1e-9, 1e-4, 0.1
"""Tolerances of -2 ln posterior: of the soil that is reported, of limits and totals, and while model errors are sought.
"""
LONGEST = 2.0
"""Longest step of a parameter, in standard deviations of the prior."""
GROSS_ERRORS = 0.1
"""Most gross errors of routine data, from 1 % on (Hampel, Ronchetti, Rousseeuw & Stahel 1986, Robust Statistics,
10.1002/9781118186435, ch. 1.2): a fit with more outliers is doubted, and twice as many are left out at most. [-]"""
FIRST_SHARE, ROUNDS, SETTLED = 0.2, 8, 0.05
"""Model error that the search for it begins with, large so that the way is smooth; fits at most; change of its
logarithm that ends it."""
RISES = (1.0, 3.841458820694127)
"""Of -2 ln posterior at the 68 and 95 % limits of a normal law."""
FARTHEST, PROFILE_TOLERANCE = 8.0, 0.01
"""How far limits are looked for, in standard deviations of the prior; to what share of the posterior's."""


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """The most probable soil. Errors that are alike in neighbouring states widen the covariance; they do not draw the
    mode nearer to the prior.

    Attributes
    ----------
    inliers : which of the n states are no outliers. (n,)
    point : the most probable transformed parameters. (p,)
    covariance : of these. (p, p)
    problem : all states, with a model error for each force.
    fitted : the same with the one share of the load that weighs all forces alike in the fit.
    """

    inliers: BoolArray
    point: FloatArray
    covariance: FloatArray
    problem: JointProblem
    fitted: JointProblem

    @property
    def alike(self) -> float:
        """How many states count as one, as their errors are alike. [-]"""
        return self.fitted.alike

    @property
    def freedom(self) -> float:
        """How many parameters the states have determined, in all. [-]"""
        return float(np.sum(1 - np.diag(self.covariance) / self.problem.width**2))


def mode_with_errors(problem: JointProblem, start: FloatArray | None = None) -> Mode:
    """The mode, with the model's errors found from what it leaves over; states beyond them are left out.

    In the fit all forces have the same share, as a share of its own would let it give up the force that fits worst.
    """
    inliers, share = np.ones(len(problem.inputs), dtype=bool), FIRST_SHARE
    point = problem.center if start is None else start

    def fit(tolerance: float) -> tuple[JointProblem, FloatArray, FloatArray, float, JointProblem]:
        """The inliers, their mode with its covariance, how many parameters they determined, and all states with a model
        error for each force."""
        part = part_of(replace(problem, model_error=(share,) * 3), inliers)
        at, covariance = find_mode(part, point, tolerance=tolerance)
        freedom = float(np.sum(1 - np.diag(covariance) / problem.width**2))
        return part, at, covariance, freedom, replace(problem, model_error=shares_of(part, at, freedom))

    for _ in range(ROUNDS):
        before = share, inliers
        part, point, _, freedom, each = fit(ROUGH)
        share, excess = common_share(part, point, freedom), _excess(each, point)
        # Of too many outliers only the worst are left out.
        inliers = excess <= max(1.0, float(np.sort(excess)[::-1][int(2 * GROSS_ERRORS * len(excess))]))
        if abs(math.log(share / before[0])) < SETTLED and (inliers == before[1]).all():
            break
    part, point, covariance, _, each = fit(FINE)
    alike, precision = states_alike(part_of(each, inliers), point), np.diag(problem.width**-2)
    wide = np.linalg.inv(precision + (np.linalg.inv(covariance) - precision) / alike)
    fitted = replace(problem, model_error=(share,) * 3, alike=alike)
    return Mode(inliers, point, np.asarray(0.5 * (wide + wide.T), dtype=np.float64), each, fitted)


def _excess(problem: JointProblem, point: FloatArray) -> FloatArray:
    """Squared residuals of each state over what the worst of as many good ones may have. (n,)"""
    white = problem.white(point[None])[0]
    measured = np.isfinite(problem.forces).sum(axis=1)
    limit = chdtri(np.maximum(measured, 1), SIGNIFICANCE / len(white))
    return np.asarray(np.sum(white**2, axis=1) / limit)


def mode_without_outliers(problem: JointProblem) -> Mode:
    """The mode at the model errors that the problem has, without states that they do not explain."""
    inliers, point = np.ones(len(problem.inputs), dtype=bool), problem.center
    while True:
        point, covariance = find_mode(part_of(problem, inliers), point)
        excess = np.where(inliers, _excess(problem, point), 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 1 or (~inliers).sum() + 1 > 2 * GROSS_ERRORS * len(inliers):
            return Mode(inliers, point, covariance, problem, problem)
        inliers[worst] = False


def profile_limits(
    problem: JointProblem, mode: FloatArray, covariance: FloatArray, progress: Callable[[int, int], None] | None = None
) -> FloatArray:
    """Low and high 68 %, low and high 95 % limits of every parameter in its unit, (4, 8).

    A limit is where the best of all other parameters costs as much as a normal law does there. `mode` (p,) and
    `covariance` (p, p) are of the transforms.
    """
    limits = np.empty((4, len(mode)))
    for k in range(len(mode)):
        for row, (rise, side) in enumerate((rise, side) for rise in RISES for side in (-1, 1)):
            limits[row, k] = _limit(problem, mode, k, side, rise, math.sqrt(covariance[k, k]))
        if progress is not None:
            progress(k + 1, len(mode))
    return values_of(problem.prior, limits)


def _limit(problem: JointProblem, mode: FloatArray, k: int, side: int, rise: float, sd: float) -> float:
    """Where -2 ln posterior is higher by `rise`, below (-1) or above (1) the mode: of parameter k, transformed.

    At most `FARTHEST` away; `sd` is its standard deviation.
    """
    from scipy.optimize import brentq

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
    problem: Any, start: FloatArray, fixed: BoolArray | None = None, tolerance: float = CONVERGED
) -> tuple[FloatArray, FloatArray]:
    """Levenberg-Marquardt on whitened residuals, whose errors of the inputs follow the parameters.

    `problem` has `white(points)`, the (d, ...) residuals at points (d, p), and `center` and `width` of normal priors.

    Parameters marked as fixed stay where they start. It ends where a step lowers -2 ln posterior by less than the
    tolerance, and an undamped one was to do so, too: in a narrow valley damped steps are short.
    Minimising them with weights held fixed would flatten the dependence on sinkage, itself measured with error.
    """
    width, center = problem.width, problem.center

    def white(at: FloatArray) -> FloatArray:
        return np.concatenate([problem.white(at).reshape(len(at), -1), (at - center) / width], axis=1)

    point, damping, nudges = start.copy(), 1e-3, np.diag(STEP * width)
    rows = white(point[None])[0]
    if not np.isfinite(rows).all():
        raise ParameterError("the model has no finite forces at the centre of the priors; check states and priors")
    curvature, held = np.diag(width**-2), np.diag(np.zeros(len(start)) if fixed is None else 1.0 * fixed)
    for _ in range(STEPS):
        ahead, behind = np.split(white(np.concatenate([point + nudges, point - nudges])), 2)
        scaled = np.ascontiguousarray((ahead - behind).T / (2 * STEP)) / width
        if fixed is not None:
            scaled[:, fixed] = 0.0
        curvature = scaled.T @ scaled + held
        slope = -scaled.T @ rows
        before, expected = float(rows @ rows), float(slope @ np.linalg.solve(curvature, slope))
        while damping < HIGHEST_DAMPING:
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope)
            trial = white((point + np.clip(step, -LONGEST * width, LONGEST * width))[None])[0]
            if float(trial @ trial) < before:
                break
            damping *= 10
        else:
            break
        point, rows = point + np.clip(step, -LONGEST * width, LONGEST * width), trial
        damping = max(damping / 5, 1e-12)
        if max(before - float(rows @ rows), expected) < tolerance:
            break
    return point, np.asarray(np.linalg.inv(curvature), dtype=np.float64)


def predictive_densities(mode: Mode, groups: IndexArray) -> FloatArray:
    """Logarithm of the density of each group of states predicted from the others, in a linear step from the mode.

    `groups` has the number of each state's group, from 0. (n,) With rows w of whitened residuals of a group, J their
    derivatives, H the curvature of all others and a states alike, the residuals of a fit without it are
    (1 + J H^-1 J' / a) w, and their covariance is 1 + J H^-1 J'. (groups,)
    """
    problem, width = mode.problem, mode.problem.width
    rows = problem.white(mode.point[None])[0]
    moved = problem.white(mode.point + np.diag(STEP * width))
    slopes = (moved - rows).transpose(1, 2, 0) / (STEP * width)
    inliers = slopes[mode.inliers].reshape(-1, len(width))
    curvature = np.diag(width**-2) + inliers.T @ inliers / mode.alike
    by_input = problem.residuals_and_slopes(mode.point[None])[1][0]
    sizes = 0.5 * np.linalg.slogdet(error_covariance(problem, by_input, np.array(problem.model_error)))[1]
    densities = []
    for number in range(groups.max() + 1):
        group = np.asarray(groups == number, dtype=np.bool_)
        inside = slopes[group & mode.inliers].reshape(-1, len(width))
        rest = np.linalg.inv(curvature - inside.T @ inside / mode.alike)
        j, w = slopes[group].reshape(-1, len(width)), rows[group].ravel()
        unknown = j @ rest @ j.T
        away, spread = w + unknown @ w / mode.alike, np.eye(len(w)) + unknown
        weighed = float(away @ np.linalg.solve(spread, away)) + float(np.linalg.slogdet(spread)[1])
        densities.append(-0.5 * weighed - sizes[group].sum())
    return np.array(densities)
