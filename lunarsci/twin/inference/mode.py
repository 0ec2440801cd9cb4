"""The most probable soils after a drive: damped Gauss-Newton from many starts at once."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.inference.misfit import HUBER, cost_of

if TYPE_CHECKING:
    from lunarsci.twin.inference.posterior import DrivePosterior

__all__ = ["PosteriorMode", "find_mode"]

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
class PosteriorMode:
    """The most probable point, its cost, and the inverse of the curvature there. (8,), (8, 8)"""

    point: FloatArray
    cost: float
    covariance: FloatArray


def find_mode(
    posterior: "DrivePosterior", random: np.random.Generator, starts: FloatArray | None = None
) -> PosteriorMode | None:
    """The lowest cost that any descent reached; None where no soil of the belief carries the rover to the end.

    Descents begin at `starts` (k, 8), or at draws from the belief.
    """
    starts = posterior.draw_prior(STARTS, random) if starts is None else starts
    looked = _Looked.at(posterior, starts)
    best = looked.best_first()[:DESCENTS]
    here = looked.part(best[np.isfinite(looked.costs[best])])
    if not here.costs.size:
        return None
    width = _width(posterior, here.points[0])
    for step in range(STEPS):
        curvature, slope = _local(posterior, here, width)
        trials = _best_trials(posterior, here.points, curvature, slope, width)
        falls = here.costs - trials.costs
        here = here.replaced(trials, falls > 0.0)
        first = here.best_first()[0]
        if falls[first] < CONVERGED and step >= PATIENCE:
            break
        if step >= PATIENCE:
            here = here.part(here.costs < here.costs[first] + BEHIND)
    found = here.part(here.best_first()[:1])
    curvature, _ = _local(posterior, found, width)
    return PosteriorMode(found.points[0], float(found.costs[0]), np.asarray(np.linalg.inv(curvature[0])))


@dataclass(frozen=True, slots=True, eq=False)
class _Looked:
    """Points (k, 8), their whitened residuals of drive and prior (k, r + 8), and their costs (k,)."""

    points: FloatArray
    rows: FloatArray
    costs: FloatArray

    @classmethod
    def at(cls, posterior: "DrivePosterior", points: FloatArray) -> "_Looked":
        drive, prior = posterior.residuals(points)
        return cls(points, np.concatenate([drive, prior], axis=1), cost_of(drive, prior))

    def part(self, which: npt.NDArray[Any]) -> "_Looked":
        return _Looked(self.points[which], self.rows[which], self.costs[which])

    def best_first(self) -> npt.NDArray[np.intp]:
        return np.argsort(self.costs)

    def replaced(self, other: "_Looked", where: npt.NDArray[np.bool_]) -> "_Looked":
        points, rows = (
            np.where(where[:, None], a, b) for a, b in ((other.points, self.points), (other.rows, self.rows))
        )
        return _Looked(points, rows, np.where(where, other.costs, self.costs))


def _width(posterior: "DrivePosterior", point: FloatArray) -> FloatArray:
    """Of the prior along each coordinate, others held. (8,)"""
    transforms = posterior.straight.transforms(point)
    spread = np.sqrt(np.diag(posterior.misfit.belief.covariance))
    moved = posterior.straight.straightened(transforms + np.diag(spread))
    return np.asarray(np.abs(np.diag(moved - point)))


def _local(posterior: "DrivePosterior", at: _Looked, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Curvature (k, 8, 8) and slope (k, 8) of half the cost at points (k, 8), from central differences.

    Where one neighbour carries no rover the difference is one-sided; where neither does it is 0, and the
    curvature that of the prior.
    """
    count, size = at.points.shape
    steps = np.vstack([np.diag(WIDTH * width), -np.diag(WIDTH * width)])
    drive, prior = posterior.residuals((at.points[:, None] + steps[None]).reshape(-1, size))
    rows = np.concatenate([drive, prior], axis=1).reshape(count, len(steps), -1)
    curvature, slope = np.zeros((count, size, size)), np.zeros((count, size))
    for k in range(count):
        here, up, down = at.rows[k], rows[k, :size], rows[k, size:]
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
    posterior: "DrivePosterior", points: FloatArray, curvature: FloatArray, slope: FloatArray, width: FloatArray
) -> _Looked:
    """The best of several damped steps from each point."""
    trials = np.empty((len(points), len(DAMPINGS), points.shape[1]))
    for k, (matrix, side) in enumerate(zip(curvature, slope, strict=True)):
        scale = np.diag(np.maximum(np.diag(matrix), width**-2))
        for m, damping in enumerate(DAMPINGS):
            step = -np.linalg.solve(matrix + damping * scale, side)
            trials[k, m] = points[k] + np.clip(step, -LONGEST * width, LONGEST * width)
    looked = _Looked.at(posterior, trials.reshape(-1, points.shape[1]))
    best = np.argmin(looked.costs.reshape(len(points), -1), axis=1)
    return looked.part(len(DAMPINGS) * np.arange(len(points)) + best)
