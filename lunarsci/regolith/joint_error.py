"""How far the model itself misses the forces, as shares of the load, from what a fit leaves over."""

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.stats import t as student

from lunarsci.regolith.joint_problem import Problem

__all__ = ["common_share", "error_covariance", "neighbours", "shares_of", "states_alike", "tail_of"]

FloatArray = npt.NDArray[np.float64]
TYPICAL, WIDTH = 0.03, 1.0
"""Median share of the load by which a wheel-soil model misses a force, and standard deviation of its logarithm, before
any residual has been looked at; assumed."""
LEAST_SHARE, GROUPS = 1e-3, 8
TAILS = (3.0, 4.0, 6.0, 10.0, 30.0)
"""Degrees of freedom of the Student law that residuals are compared with."""


def error_covariance(problem: Problem, slopes: FloatArray, shares: FloatArray) -> FloatArray:
    """Of the forces of each state: measurement, what input errors make of it, and the model's. (n, 3, 3) [N^2]

    `slopes` (3 inputs, 3 forces, n) are those of one standard deviation; forces not measured get a variance of 1.
    """
    covariance = np.asarray(np.einsum("kan,kbn->nab", slopes, slopes), dtype=np.float64)
    own = problem.force_sigma**2 + (shares * np.abs(problem.forces[:, :1])) ** 2
    missing = ~np.isfinite(problem.forces)
    covariance[missing] = 0.0
    covariance.transpose(0, 2, 1)[missing] = 0.0
    for k in range(3):
        covariance[:, k, k] = np.where(missing[:, k], 1.0, covariance[:, k, k] + own[:, k])
    return covariance


def _ln_likelihood(problem: Problem, residual: FloatArray, slopes: FloatArray, shares: FloatArray) -> float:
    root = np.linalg.cholesky(error_covariance(problem, slopes, shares))
    white = np.linalg.solve(root, residual[:, :, None])[:, :, 0]
    return float(-0.5 * (white**2).sum() - np.log(np.diagonal(root, axis1=1, axis2=2)).sum())


def _fitted(problem: Problem, point: FloatArray, freedom: float, common: bool) -> FloatArray:
    found, slopes = problem.residuals_and_slopes(point[None])
    measured = np.isfinite(problem.forces)
    count = int(measured.sum())
    # What a fit of so many free parameters has taken off the residuals.
    residual = np.where(measured, found[0].T, 0.0) * np.sqrt(count / max(count - freedom, 0.25 * count))

    def cost(ln_share: FloatArray) -> float:
        shares = np.maximum(np.exp(np.broadcast_to(ln_share, (3,))), LEAST_SHARE)
        law = 0.5 * float(np.sum((ln_share - np.log(TYPICAL)) ** 2)) / WIDTH**2
        return law - _ln_likelihood(problem, residual, slopes[0], shares)

    start = np.log(np.full(1 if common else 3, 0.05))
    best = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3}).x
    return np.asarray(np.maximum(np.exp(np.broadcast_to(best, (3,))), LEAST_SHARE), dtype=np.float64)


def common_share(problem: Problem, point: FloatArray, freedom: float) -> float:
    """One share for all forces, with which the residuals at a point are as large as their errors say.

    The likeliest one under a wide law around 0.03; `freedom` is the number of parameters that the fit has used up.
    """
    return float(_fitted(problem, point, freedom, True)[0])


def shares_of(problem: Problem, point: FloatArray, freedom: float) -> tuple[float, float, float]:
    """A share for each of F_N, F_DP, F_L; otherwise as `common_share`."""
    found = _fitted(problem, point, freedom, False)
    return (float(found[0]), float(found[1]), float(found[2]))


def neighbours(values: FloatArray, radius: float) -> npt.NDArray[np.intp]:
    """Number of each state's group of neighbours in sinkage, slip and side slip, at most 8. (n,)

    All are halved along their longest side until there are enough; sinkage counts in radii, side slip in 90 deg.
    """
    scaled = np.column_stack([values[:, 0] / radius, values[:, 1], np.nan_to_num(values[:, 2]) / 90])
    parts = [np.arange(len(scaled))]
    while len(parts) < GROUPS and max(map(len, parts)) > 1:
        parts.sort(key=len)
        largest = parts.pop()
        longest = int(np.argmax(np.ptp(scaled[largest], axis=0)))
        ordered = largest[np.argsort(scaled[largest, longest], kind="stable")]
        parts += [ordered[: len(ordered) // 2], ordered[len(ordered) // 2 :]]
    numbers = np.empty(len(scaled), dtype=np.intp)
    for number, part in enumerate(parts):
        numbers[part] = number
    return numbers


def states_alike(problem: Problem, point: FloatArray) -> float:
    """Of how many states the errors are so much alike that they count as one, 1 or more.

    The variance of sums of whitened residuals over groups of neighbours, over what it would be if each were on its own
    (the design effect of a cluster sample: Kish 1965, Survey Sampling, ch. 5).
    """
    white = problem.white(point[None])[0]
    groups = neighbours(problem.inputs, problem.wheel.radius_m)
    measured = np.isfinite(problem.forces)
    found = [
        white[groups == g, k].sum() ** 2 / count
        for g in range(groups.max() + 1)
        for k in range(3)
        if (count := int(measured[groups == g, k].sum())) > 1
    ]
    return max(1.0, float(np.mean(found))) if found else 1.0


def tail_of(white: FloatArray) -> float:
    """Degrees of freedom, of `TAILS`, of the Student law of unit variance that whitened residuals follow best."""
    scores = [float(student.logpdf(white, freedom, scale=np.sqrt((freedom - 2) / freedom)).sum()) for freedom in TAILS]
    return TAILS[int(np.argmax(scores))]
