"""The ground that was there before a wheel came: how alike ground is nearby, and its height between known places."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, robust_scatter
from lunarsci.images.lines import Unrolled

BIWEIGHT = 4.685
"""Tukey's biweight, 95 % efficient for normal errors (Holland & Welsch 1977, 10.1080/03610927708827533)."""


@dataclass(frozen=True, slots=True)
class GroundShape:
    """How alike ground is: half the mean squared difference of two heights is `amplitude_m2` (d / 1 m)^(2 `exponent`).

    A power law, as of fractal ground (Shepard et al. 2001, 10.1029/2000JE001429).
    """

    amplitude_m2: float
    exponent: float

    def variogram(self, squared_m2: FloatArray) -> FloatArray:
        """Half the mean squared difference at squared distances. [m2]"""
        return np.asarray(self.amplitude_m2 * squared_m2**self.exponent)

    @classmethod
    def of(cls, nodes: Unrolled, cell_m: float, resolution_m: float) -> "GroundShape":
        """From medians of differences at lags from the resolution to 0.4 m along and across, without the noise's."""
        table, noise = _raster(nodes, cell_m)
        lags, found = [], []
        for k in range(max(1, math.ceil(1.2 * resolution_m / cell_m)), max(2, round(0.4 / cell_m)) + 1):
            differences = np.concatenate([(table[k:] - table[:-k]).ravel(), (table[:, k:] - table[:, :-k]).ravel()])
            differences = differences[np.isfinite(differences)]
            if len(differences) > 20:
                half = 0.5 * robust_scatter(differences, 0.0) ** 2 - noise
                lags.append(k * cell_m)
                found.append(max(half, 1e-10))
        if not found:
            return cls(1e-6, 0.75)
        slope = np.polyfit(np.log(lags), np.log(found), 1)[0] if len(found) > 2 else 1.5
        exponent = float(np.clip(0.5 * slope, 0.4, 0.95))
        return cls(float(np.exp(np.mean(np.log(found) - 2 * exponent * np.log(lags)))), exponent)


def _raster(nodes: Unrolled, cell_m: float) -> tuple[FloatArray, float]:
    """Cells by way and distance to the left less their plane, NaN where empty, and the variance of their noise."""
    rows, columns = (np.floor((v - v.min()) / cell_m).astype(int) for v in (nodes.along, nodes.across))
    shape = int(rows.max()) + 1, int(columns.max()) + 1
    key = rows * shape[1] + columns
    design = np.column_stack([np.ones_like(nodes.along), nodes.along, nodes.across])
    rest = nodes.height - design @ np.linalg.lstsq(design, nodes.height, rcond=None)[0]
    count = np.bincount(key, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        table = (np.bincount(key, rest, minlength=len(count)) / np.where(count > 0, count, np.nan)).reshape(shape)
    noise = float(np.nanmedian(nodes.sigma**2)) if np.isfinite(nodes.sigma).any() else 0.0
    return table, noise


def robust_fit(design: FloatArray, height: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients and weights from 0 to 1, by iterated weights of Tukey's biweight."""
    weight = np.ones(len(height))
    for _ in range(6):
        root = np.sqrt(weight) / sigma
        coefficients = np.linalg.lstsq(design * root[:, None], height * root, rcond=None)[0]
        residual = (height - design @ coefficients) / sigma
        scale = max(robust_scatter(residual), 1e-12)
        weight = np.clip(1.0 - (residual / (BIWEIGHT * scale)) ** 2, 0.0, None) ** 2
    return np.asarray(coefficients), np.asarray(weight)


class Cells(NamedTuple):
    """Means of nodes by cell: (n, 2) places along and across, heights, standard errors, nodes in each. (n,)"""

    place: FloatArray
    height: FloatArray
    sigma: FloatArray
    nodes: FloatArray


def cells_of(nodes: Unrolled, chosen: BoolArray, cell_m: float, alike: float) -> Cells:
    along, across = nodes.along[chosen], nodes.across[chosen]
    key = np.floor(along / cell_m).astype(int) * 100_003 + np.floor(across / cell_m).astype(int)
    _, group = np.unique(key, return_inverse=True)
    count = np.bincount(group).astype(float)
    means = [np.bincount(group, values[chosen]) / count for values in (nodes.along, nodes.across, nodes.height)]
    sigma = np.sqrt(np.bincount(group, nodes.sigma[chosen] ** 2) / count * np.minimum(1.0, alike / count))
    return Cells(np.column_stack(means[:2]), means[2], sigma, count)


def kriged(
    cells: Cells, wanted: FloatArray, shape: GroundShape, resolution_m: float, order: int = 1
) -> tuple[float, float]:
    """Mean height of the undisturbed ground over places (m, 2) from cells beside them, and its variance. [m], [m2]

    Universal kriging (Matheron 1969; Cressie 1993, 10.1002/9781119115151): a plane, or a bent one, and ground that is
    alike nearby. The noise of cells within the resolution hangs together.
    """
    place, size = cells.place, len(cells.height)
    shift = place[:, None] - place
    tent = np.prod(np.clip(1.0 - np.abs(shift) / max(resolution_m, 1e-9), 0.0, None), axis=-1)
    ground = shape.variogram((shift**2).sum(axis=-1))
    inner = shape.variogram(((wanted[:, None] - wanted) ** 2).sum(axis=-1)).mean()
    between = shape.variogram(((place[:, None] - wanted) ** 2).sum(axis=-1)).mean(axis=1)
    noise = np.outer(cells.sigma, cells.sigma) * tent
    middle = wanted.mean(axis=0)

    def drift(points: FloatArray) -> FloatArray:
        ahead, left = (points - middle).T
        return np.column_stack([np.ones(len(points)), ahead, *(left**k for k in range(1, order + 1))])

    trend = drift(place)
    columns = trend.shape[1]
    scale = max(float(ground.max()), 1e-12)
    system = np.zeros((size + columns, size + columns))
    system[:size, :size] = (noise - ground) / scale + 1e-9 * np.eye(size)
    system[:size, size:], system[size:, :size] = trend, trend.T
    target = np.append(-between / scale, drift(wanted).mean(axis=0))
    weights = np.linalg.solve(system, target)[:size]
    variance = 2 * weights @ between - weights @ ground @ weights - inner + weights @ noise @ weights
    return float(weights @ cells.height), max(float(variance), 0.0)
