"""The most probable soils after a drive: damped Gauss-Newton from many starts at once."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.twin.inference.misfit import HUBER

if TYPE_CHECKING:
    from lunarsci.twin.inference.posterior import Posterior

__all__ = ["Mode", "find_mode"]

FloatArray = npt.NDArray[np.float64]
STARTS, DESCENTS, STEPS = 64, 4, 16
"""Soils looked at first, how many of them are followed down, and for how many steps at most."""
DAMPINGS = (1e-3, 1e-1, 1.0, 10.0, 100.0)
WIDTH = 0.03
"""Of finite differences, in widths of the prior: above the noise of interpolated states, below curvature."""
LONGEST = 1.0
"""Step, in widths of the prior."""
CONVERGED, BEHIND = 0.1, 60.0
"""Fall of the cost that counts as none; how far behind the best a descent is given up after a few steps."""
PATIENCE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """The most probable point, its cost, and the inverse of the curvature there. (8,), (8, 8)"""

    point: FloatArray
    cost: float
    covariance: FloatArray


def find_mode(posterior: "Posterior", random: np.random.Generator, starts: FloatArray | None = None) -> Mode | None:
    """The lowest cost that any descent reached; None where no soil of the belief carries the rover to the end.

    Descents begin at `starts` (k, 8), or at draws from the belief.
    """
    starts = posterior.draw_prior(STARTS, random) if starts is None else starts
    costs = posterior.cost(starts)
    chosen = np.argsort(costs)[:DESCENTS]
    points, costs = starts[chosen], costs[chosen]
    points, costs = points[np.isfinite(costs)], costs[np.isfinite(costs)]
    if not costs.size:
        return None
    width = _width(posterior, points[0])
    for step in range(STEPS):
        curvature, slope = _local(posterior, points, width)
        trial, found = _best_trials(posterior, points, curvature, slope, width)
        falls = np.where(found < costs, costs - found, 0.0)
        points = np.where(falls[:, None] > 0, trial, points)
        costs = costs - falls
        best = int(np.argmin(costs))
        if falls[best] < CONVERGED and step >= PATIENCE:
            break
        if step >= PATIENCE:
            kept = costs < costs[best] + BEHIND
            points, costs = points[kept], costs[kept]
    best = int(np.argmin(costs))
    curvature, _ = _local(posterior, points[best : best + 1], width)
    return Mode(points[best], float(costs[best]), np.asarray(np.linalg.inv(curvature[0])))


def _width(posterior: "Posterior", point: FloatArray) -> FloatArray:
    """Of the prior along each coordinate, others held. (8,)"""
    transforms = posterior.straight.transforms(point)
    spread = np.sqrt(np.diag(posterior.misfit.belief.covariance))
    moved = posterior.straight.straightened(transforms + np.diag(spread))
    return np.asarray(np.abs(np.diag(moved - point)))


def _local(posterior: "Posterior", points: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Curvature (k, 8, 8) and slope (k, 8) of half the cost at points (k, 8), from central differences.

    Where one neighbour carries no rover the difference is one-sided; where neither does it is 0, and the
    curvature that of the prior.
    """
    count, size = points.shape
    steps = np.vstack([np.zeros(size), np.diag(WIDTH * width), -np.diag(WIDTH * width)])
    drive, prior = posterior.residuals((points[:, None] + steps[None]).reshape(-1, size))
    rows = np.concatenate([drive, prior], axis=1).reshape(count, len(steps), -1)
    curvature, slope = np.zeros((count, size, size)), np.zeros((count, size))
    for k in range(count):
        here, up, down = rows[k, 0], rows[k, 1 : size + 1], rows[k, size + 1 :]
        columns = _differences(here, up, down) / (WIDTH * width)[:, None]
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(here), HUBER))
        weight[-size:] = 1.0
        curvature[k] = (columns * weight) @ columns.T
        slope[k] = (columns * weight) @ here
        idle = np.diag(curvature[k]) == 0.0
        curvature[k][idle, idle] = width[idle] ** -2
    return curvature, slope


def _differences(here: FloatArray, up: FloatArray, down: FloatArray) -> FloatArray:
    """Of residuals (8, r) for one step along each coordinate."""
    above, below = np.isfinite(up).all(axis=1), np.isfinite(down).all(axis=1)
    result = np.zeros(up.shape)
    both = above & below
    result[both] = 0.5 * (up[both] - down[both])
    result[above & ~below] = up[above & ~below] - here
    result[below & ~above] = here - down[below & ~above]
    return result


def _best_trials(
    posterior: "Posterior", points: FloatArray, curvature: FloatArray, slope: FloatArray, width: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The best of several damped steps from each point, and its cost. (k, 8), (k,)"""
    trials = np.empty((len(points), len(DAMPINGS), points.shape[1]))
    for k, (matrix, side) in enumerate(zip(curvature, slope, strict=True)):
        scale = np.diag(np.maximum(np.diag(matrix), width**-2))
        for m, damping in enumerate(DAMPINGS):
            step = -np.linalg.solve(matrix + damping * scale, side)
            trials[k, m] = points[k] + np.clip(step, -LONGEST * width, LONGEST * width)
    found = posterior.cost(trials.reshape(-1, points.shape[1])).reshape(len(points), -1)
    best = np.argmin(found, axis=1)
    own = np.arange(len(points))
    return trials[own, best], found[own, best]
