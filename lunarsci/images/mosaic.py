"""One elevation model of several pairs, whose poses and rigs were adjusted together.

Each pair is gridded where the adjustment puts it. What poses and rigs are still off by, with the covariance that they
have together, changes its heights in a few smooth ways: its modes. Where pairs overlap, a height is the mean that has
the least variance by their random errors and the covariance of all modes (Aitken 1936, 10.1017/S0370164600014346). The
plane through the difference of two pairs is held against what that covariance allows: a chi-square of three.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, robust_fit
from lunarsci.images.adjustment import root_of
from lunarsci.images.elevation import (
    AT_ONCE,
    ElevationModel,
    MergedMap,
    Stack,
    alike_of,
    blocks_of,
    map_of,
)
from lunarsci.images.gridding import Cloud, HeightModes, cloud_of, grid_of, height_modes, upwards
from lunarsci.images.localisation import Localised

MODES = 8
"""Ways in which a pair's heights may be off together. Measured: what others make of heights is 0.1 mm (rms) in rendered
pairs of a NavCam, of 24 mm."""
BIASED = 0.2
"""Share of their random errors by which all heights of a pair are off together. Measured: in three rendered scenes
heights from afar, where hollows are hidden, are higher than from near by 0.1 to 0.2 of that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seam:
    """How the heights of two pairs differ, over what their poses and rigs allow.

    Attributes
    ----------
    first, second : numbers of the pairs.
    height_m, height_m_sigma : of the second less the first in the middle of what both see, and its error. [m]
    tilt_deg, tilt_deg_sigma : by how much the second one leans against the first one, and that error. [deg]
    chi_square : of height and tilts together, of three if poses and rigs are as good as they say. [-]
    chance : of a chi-square that is larger. [-]
    """

    first: int
    second: int
    height_m: float
    height_m_sigma: float
    tilt_deg: float
    tilt_deg_sigma: float
    chi_square: float
    chance: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mosaic:
    """Several pairs as one map.

    Attributes
    ----------
    localised : poses and rigs.
    farthest_m : range of each pair up to which its points count. [m]
    models : heights of each pair where the adjustment puts it.
    modes : what its heights may be off by, by poses and rigs, and last by matching.
    merged : the map; nothing is corrected by heights.
    steps : between pairs that overlap.
    """

    localised: Localised
    farthest_m: Sequence[float]
    models: tuple[ElevationModel, ...]
    modes: tuple[HeightModes, ...]
    merged: MergedMap
    steps: tuple[Seam, ...]

    def cloud(self, number: int) -> Cloud:
        """Points of a pair where the adjustment puts them."""
        fitted, station = self.localised.adjusted, self.localised.stations[number]
        rigs = station.rig, fitted.rigs[number]
        return cloud_of(station.matches, fitted.poses[number], self.farthest_m[number], rigs)


def mosaic(localised: Localised, *, spacing_m: float, farthest_m: Sequence[float], synthetic: bool = False) -> Mosaic:
    """Lay pairs together, each up to its range `farthest_m`, on nodes every `spacing_m`."""
    fitted = localised.adjusted
    models = []
    for k, station in enumerate(localised.stations):
        model = grid_of(
            station.matches,
            station.rig,
            fitted.poses[k],
            name=station.name,
            spacing_m=spacing_m,
            farthest_m=farthest_m[k],
            synthetic=synthetic,
            moved=fitted.rigs[k],
            covariance=fitted.of_pair(k, k),
        )
        models.append(model)
    windows, _, shape = _windows(models)
    total, count = np.zeros((2, *shape))
    for model, window in zip(models, windows, strict=True):
        total[window] += np.nan_to_num(model.height_m)
        count[window] += np.isfinite(model.height_m)
    way = upwards(np.where(count > 0, total / np.maximum(count, 1), np.nan), spacing_m)
    modes = []
    for k, (model, window) in enumerate(zip(models, windows, strict=True)):
        root = root_of(fitted.of_pair(k, k))
        mode = height_modes(model, fitted.rigs[k], fitted.poses[k], root, MODES, way[window])
        biased = BIASED * model.layer("height_m_sigma")[..., None]
        modes.append(mode._replace(by=np.concatenate([mode.by, biased], axis=-1)))
    stack, grid = _stacked(localised, models, modes)
    steps = [step for step in (_seam(stack, pair, grid) for pair in combinations(range(len(models)), 2)) if step]
    corrections = np.zeros((len(models), stack.by.shape[2]))
    weight = _shares(stack) * np.nan_to_num(stack.variance)
    return Mosaic(
        localised=localised,
        farthest_m=farthest_m,
        models=tuple(models),
        modes=tuple(modes),
        merged=map_of(models, stack, weight, corrections, stack.prior, grid),
        steps=tuple(steps),
    )


def _windows(
    models: Sequence[ElevationModel],
) -> tuple[list[tuple[slice, ...]], tuple[int, int], tuple[int, int]]:
    """Where models lie on a grid for all, of whose nodes theirs are some; its first row and column, counted from the
    world's 0, and its shape."""
    step = models[0].spacing_m
    first = np.array([[round(model.y0_m / step), round(model.x0_m / step)] for model in models])
    size, low = np.array([model.height_m.shape for model in models]), first.min(axis=0)
    rows, columns = (first + size).max(axis=0) - low
    windows = [tuple(map(slice, start, start + n)) for start, n in zip(first - low, size, strict=True)]
    return windows, (int(low[0]), int(low[1])), (int(rows), int(columns))


def _stacked(
    localised: Localised, models: Sequence[ElevationModel], modes: Sequence[HeightModes]
) -> tuple[Stack, tuple[FloatArray, FloatArray, float]]:
    """Models with their modes on one grid, and its x, y and step: nodes of models are among its nodes."""
    step = models[0].spacing_m
    windows, low, shape = _windows(models)
    count = modes[0].by.shape[2]
    of = [np.pad(mode.of, ((0, count - len(mode.of)), (0, 0))) for mode in modes]
    height, variance = np.full((2, len(models), *shape), np.nan)
    by: Any = np.zeros((len(models), *shape, count), dtype=np.float32)
    for k, (model, mode, place) in enumerate(zip(models, modes, windows, strict=True)):
        sigma = model.layer("height_m_sigma")
        height[k][place] = np.where(sigma > 0, model.height_m, np.nan)
        variance[k][place] = sigma**2
        by[k][place] = np.nan_to_num(mode.by)
    numbers = range(len(models))
    prior = np.block([[of[i] @ localised.adjusted.of_pair(i, j) @ of[j].T for j in numbers] for i in numbers])
    y, x = (np.asarray(step * (low[axis] + np.arange(shape[axis])), dtype=float) for axis in (0, 1))
    flat = len(models), int(shape[0] * shape[1])
    stack = Stack(
        height=height.reshape(flat),
        variance=variance.reshape(flat),
        by=by.reshape(*flat, count),
        prior=np.asarray(0.5 * (prior + prior.T)) + np.diag(np.tile(np.arange(count) == count - 1, len(models))),
        alike=alike_of(models, step),
        block=blocks_of(*shape),
    )
    return stack, (x, y, step)


def _shares(stack: Stack) -> FloatArray:
    """By how much each model counts at each node: the mean with the least variance, without negative weights.
    (k, n)"""
    count, nodes, columns = stack.by.shape
    prior = stack.prior.reshape(count, columns, count, columns)
    shares = stack.valid.astype(float)
    for rows in np.array_split(np.flatnonzero(stack.shared), 1 + nodes // AT_ONCE):
        by, valid = stack.by[:, rows], stack.valid[:, rows].T
        spread = np.empty((len(rows), count, count))
        for i in range(count):
            for j in range(count):
                spread[:, i, j] = ((by[i] @ prior[i, :, j]) * by[j]).sum(axis=1)
        # A model that does not know a node is as one that knows nothing.
        alone = np.where(valid, np.nan_to_num(stack.variance[:, rows].T), 1.0)
        spread = np.where(valid[:, :, None] & valid[:, None, :], spread, 0.0) + alone[..., None] * np.eye(count)
        shares[:, rows] = np.maximum(np.linalg.solve(spread, valid[..., None].astype(float))[..., 0], 0.0).T
    return shares


def _seam(stack: Stack, pair: tuple[int, int], grid: tuple[FloatArray, FloatArray, float]) -> Seam | None:
    """The plane through what two models differ by, and whether their modes allow it; None where they share too little
    for one."""
    from scipy.stats import chi2

    both = np.flatnonzero(stack.valid[list(pair)].all(axis=0))
    x, y = (place.ravel()[both] for place in np.meshgrid(*grid[:2]))
    if len(both) < 3 * stack.alike:
        return None
    sigma = np.sqrt(stack.variance[list(pair)][:, both].sum(axis=0))[:, None]
    design = np.column_stack([np.ones(len(both)), x - x.mean(), y - y.mean()]) / sigma
    off = (stack.height[pair[1], both] - stack.height[pair[0], both]) / sigma[:, 0]
    plane, weight = robust_fit(design, off)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    gradients = np.zeros((int(stack.block.max()) + 1, 3))
    np.add.at(gradients, stack.block[both], design * (weight * (off - design @ plane))[:, None])
    share, columns = inverse @ (design.T * weight), stack.by.shape[2]
    by = np.concatenate([sign * (share @ (stack.by[k, both] / sigma)) for sign, k in ((-1, pair[0]), (1, pair[1]))], 1)
    rows = np.concatenate([np.arange(columns) + columns * k for k in pair])
    covariance = inverse @ gradients.T @ gradients @ inverse + by @ stack.prior[np.ix_(rows, rows)] @ by.T
    square = float(plane @ np.linalg.solve(covariance, plane))
    lean = float(np.hypot(*plane[1:]))
    along = plane[1:] / max(lean, 1e-12)
    return Seam(
        first=pair[0],
        second=pair[1],
        height_m=float(plane[0]),
        height_m_sigma=math.sqrt(covariance[0, 0]),
        tilt_deg=math.degrees(lean),
        tilt_deg_sigma=math.degrees(math.sqrt(along @ covariance[1:, 1:] @ along)),
        chi_square=square,
        chance=float(chi2.sf(square, 3)),
    )
