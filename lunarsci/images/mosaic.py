"""One elevation model of several pairs, whose poses and rigs were adjusted together.

Each pair is gridded where the adjustment puts it. What poses and rigs are still off by, with the covariance that they
have together, changes its heights in a few smooth ways: its modes. Heights of overlapping pairs differ by their modes
and by random errors, so that generalised least squares (Aitken 1936, 10.1017/S0370164600014346) with the covariance of
all modes as the prior both corrects them and says what is left. Before that, the plane through each difference is held
against what the covariance allows: a chi-square of three.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from lunarsci.arrays import FloatArray, robust_fit
from lunarsci.images.adjustment import root_of
from lunarsci.images.elevation import (
    ElevationModel,
    MergedMap,
    Stack,
    alike_of,
    blocks_of,
    map_of,
    reconciled,
)
from lunarsci.images.gridding import Cloud, HeightModes, cloud_of, grid_of, height_modes
from lunarsci.images.localisation import Localised

MODES = 8
"""Ways in which a pair's heights may be off together. Measured: what others make of heights is 0.1 mm (rms) in rendered
pairs of a NavCam, of 24 mm."""

BIASED_PX = 0.02
"""Error that all disparities of a pair share. Measured: their medians were off by 0.00 to 0.02 px in five rendered
pairs. [px]"""


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
    modes : what its heights may be off by, by poses and rigs, and last by their disparities.
    merged : the map; its corrections are those of the modes.
    steps : between pairs that overlap, before heights were corrected.
    """

    localised: Localised
    farthest_m: Sequence[float]
    models: tuple[ElevationModel, ...]
    modes: tuple[HeightModes, ...]
    merged: MergedMap
    steps: tuple[Seam, ...]

    def raised(self, number: int) -> FloatArray:
        """By how much the heights of a pair were too large, as the others tell. (ny, nx) [m]"""
        return np.asarray(self.modes[number].by @ self.merged.corrections[number])

    def median_raised(self, number: int) -> float:
        """The median of that where the pair has heights. [m]"""
        return float(np.median(self.raised(number)[np.isfinite(self.models[number].height_m)]))

    def cloud(self, number: int) -> Cloud:
        """Points of a pair where the map has them."""
        fitted, station, model = self.localised.adjusted, self.localised.stations[number], self.models[number]
        rigs = station.rig, fitted.rigs[number]
        cloud = cloud_of(station.matches, fitted.poses[number], self.farthest_m[number], rigs)
        columns, rows = np.rint((cloud.points[:, :2] - (model.x0_m, model.y0_m)) / model.spacing_m).astype(int).T
        raised = np.nan_to_num(self.raised(number)[rows, columns])
        return cloud._replace(points=cloud.points - np.outer(raised, [0.0, 0.0, 1.0]))


def mosaic(localised: Localised, *, spacing_m: float, farthest_m: Sequence[float], synthetic: bool = False) -> Mosaic:
    """Lay pairs together, each up to its range `farthest_m`, on nodes every `spacing_m`."""
    fitted = localised.adjusted
    models, modes = [], []
    for k, station in enumerate(localised.stations):
        covariance = fitted.of_pair(k, k)
        model = grid_of(
            station.matches,
            station.rig,
            fitted.poses[k],
            name=station.name,
            spacing_m=spacing_m,
            farthest_m=farthest_m[k],
            synthetic=synthetic,
            moved=fitted.rigs[k],
            covariance=covariance,
        )
        models.append(model)
        mode = height_modes(model, fitted.rigs[k], fitted.poses[k], root_of(covariance), MODES)
        biased = BIASED_PX * model.layer("height_by_disparity_m_px")[..., None]
        modes.append(mode._replace(by=np.concatenate([mode.by, biased], axis=-1)))
    stack, grid = _stacked(localised, models, modes)
    steps = [step for step in (_seam(stack, pair, grid) for pair in combinations(range(len(models)), 2)) if step]
    corrections, covariance, weight = reconciled(stack)
    return Mosaic(
        localised=localised,
        farthest_m=farthest_m,
        models=tuple(models),
        modes=tuple(modes),
        merged=map_of(models, stack, weight, corrections, covariance, grid),
        steps=tuple(steps),
    )


def _stacked(
    localised: Localised, models: Sequence[ElevationModel], modes: Sequence[HeightModes]
) -> tuple[Stack, tuple[FloatArray, FloatArray, float]]:
    """Models with their modes on one grid, and its x, y and step: nodes of models are among its nodes."""
    step = models[0].spacing_m
    first = np.array([[round(model.y0_m / step), round(model.x0_m / step)] for model in models])
    low = first.min(axis=0)
    shape = (first + [model.height_m.shape for model in models]).max(axis=0) - low
    count = modes[0].by.shape[2]
    of = [np.pad(mode.of, ((0, count - len(mode.of)), (0, 0))) for mode in modes]
    height, variance = np.full((2, len(models), *shape), np.nan)
    by = np.zeros((len(models), *shape, count), dtype=np.float32)
    for k, (model, mode, start) in enumerate(zip(models, modes, first - low, strict=True)):
        place = tuple(slice(a, a + n) for a, n in zip(start, model.height_m.shape, strict=True))
        sigma = model.layer("height_m_sigma")
        height[k][place] = np.where(sigma > 0, model.height_m, np.nan)
        variance[k][place] = sigma**2
        by[k][place] = np.nan_to_num(mode.by)
    numbers = range(len(models))
    prior = np.block([[of[i] @ localised.adjusted.of_pair(i, j) @ of[j].T for j in numbers] for i in numbers])
    y, x = (step * (low[axis] + np.arange(shape[axis])) for axis in (0, 1))
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
