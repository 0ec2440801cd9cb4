"""Finer terrains over parts of a coarse one: the coarse nodes with what is under them, and patches of fine nodes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import DataError
from lunarsci.twin.ground.footprint import RoverFootprint
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.ground.terrain import Terrain

MAPS = ("slope_deg", "roughness_m", "step_m")
MOST_NODES = 2_000_000
"""A patch that would have more gets wider nodes, each with the worst of what lies in its cell."""
Values = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Along one axis: nodes of one grid, and the first node of a finer one in the cell about each.

    `end` is behind the last of them. The first and the last cell may be covered in part. Of a wider grid it is the
    node that lies nearest to each.
    """

    nodes: IntArray
    first: IntArray
    end: int

    @classmethod
    def of(cls, axis: FloatArray, over: FloatArray) -> "_Cells":
        spacing, own = over[1] - over[0], axis[1] - axis[0]
        if spacing < own:
            cell = np.rint((over - axis[0]) / own).astype(np.int64)
            inside = np.flatnonzero((cell >= 0) & (cell < len(axis)))
            nodes, first = np.unique(cell[inside], return_index=True)
            return cls(nodes, inside[first], int(inside[-1]) + 1 if inside.size else 0)
        nearest = np.rint((axis - over[0]) / spacing).astype(np.int64)
        nodes = np.flatnonzero((nearest >= 0) & (nearest < len(over)))
        return cls(nodes, nearest[nodes], int(nearest[nodes[-1]]) + 1 if nodes.size else 0)


def check_finer(path: str, finer: Terrain, terrain: Terrain) -> None:
    """Raises DataError for a terrain that cannot stand in place of a part of another one."""
    if finer.crs and terrain.crs and finer.crs != terrain.crs:
        raise DataError(
            f"{path}: its coordinate system is not that of {terrain.name}; warp it to that one, "
            "as with rio warp IN.tif OUT.tif --like OTHER.tif --res METRES"
        )
    if finer.spacing_m >= terrain.spacing_m:
        raise DataError(
            f"{path}: its nodes lie {finer.spacing_m:g} m apart and those of {terrain.name} {terrain.spacing_m:g} m; "
            "a local terrain must be finer; give the finer one as local, or leave it out"
        )
    if any(
        own[-1] < other[0] or own[0] > other[-1] for own, other in ((finer.x_m, terrain.x_m), (finer.y_m, terrain.y_m))
    ):
        raise DataError(
            f"{path}: covers no part of {terrain.name}: x {finer.x_m[0]:g} to {finer.x_m[-1]:g} m, y "
            f"{finer.y_m[0]:g} to {finer.y_m[-1]:g} m; is it in metres of the same origin?"
        )


def laid_over(base: Traversability, finer: Sequence[Traversability]) -> Traversability:
    """The nodes of a ground with what finer ones, the finest last, say of the cells about them.

    Slope, roughness and step are the worst in the cell. The demand is the worst where that is a hazard, and else the
    mean. In cells that are covered in part it is not less than the base's; where nothing finer is known it is that.
    Holes are filled. What layers of the base forbid stays forbidden.
    """
    maps = {name: getattr(base.maps, name).copy() for name in MAPS}
    demand, height = base.demand.copy(), base.terrain.height_m.copy()
    for one in finer:
        rows = _Cells.of(base.terrain.y_m, one.terrain.y_m)
        columns = _Cells.of(base.terrain.x_m, one.terrain.x_m)
        if not (rows.nodes.size and columns.nodes.size):
            continue
        under = np.ix_(rows.nodes, columns.nodes)
        for name in MAPS:
            maps[name][under] = _worst(maps[name][under], getattr(one.maps, name), rows, columns)
        worst = _worst(demand[under], one.demand, rows, columns)
        count = _reduced(np.add, np.ones_like(one.demand), rows, columns)
        mean = _reduced(np.add, one.demand, rows, columns) / count
        demand[under] = np.where((worst <= 1) & _whole(mean), mean, worst)
        filled = _reduced(np.maximum, one.terrain.height_m, rows, columns)
        height[under] = np.where(np.isnan(height[under]), filled, height[under])
    for layer in base.layers:
        demand[layer.forbidden] = np.inf
    terrain = replace(base.terrain, height_m=height)
    return replace(base, terrain=terrain, maps=replace(base.maps, **maps), demand=demand)


def patch(
    base: Traversability, finer: Sequence[Traversability], points_m: FloatArray, margin_m: float
) -> Traversability:
    """A box about some points (n, 2) of the base [m], on nodes of the finest ground in it; the base where none is.

    A node that no finer ground knows has the values of the nearest node of the base, which is returned, too, where a
    point lies outside it.
    """
    x, y = base.terrain.x_m, base.terrain.y_m
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    first, last = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
    near = [one for one in finer if _overlaps(one.terrain, low - margin_m, high + margin_m)]
    if not near or (low < first).any() or (high > last).any():
        return base
    low, high = np.maximum(low - margin_m, first), np.minimum(high + margin_m, last)
    finest = near[-1].terrain
    spacing = max(finest.spacing_m, math.sqrt(float(np.prod(high - low)) / MOST_NODES))
    origin = np.array([finest.x0_m, finest.y0_m])
    start, end = np.ceil((low - origin) / spacing - 1e-6), np.floor((high - origin) / spacing + 1e-6)
    columns, rows = (
        np.rint((origin[k] + spacing * np.arange(start[k], end[k] + 1) - first[k]) / base.terrain.spacing_m).astype(int)
        for k in (0, 1)
    )
    under = np.ix_(np.clip(rows, 0, len(y) - 1), np.clip(columns, 0, len(x) - 1))
    corner = origin + spacing * start
    terrain = replace(
        base.terrain, x0_m=float(corner[0]), y0_m=float(corner[1]), spacing_m=spacing, errors=None,
        height_m=base.terrain.height_m[under], soil=base.terrain.soil[:1, :1],
    )  # fmt: skip
    box = replace(
        base, terrain=terrain, demand=base.demand[under], sunlit=None,
        maps=replace(base.maps, **{name: getattr(base.maps, name)[under] for name in MAPS}),
        layers=tuple(replace(layer, factor=layer.factor[under]) for layer in base.layers),
    )  # fmt: skip
    return laid_over(box, near)


def driven_ground(terrain: Terrain, finer: Sequence[Terrain], points_m: FloatArray, margin_m: float) -> Terrain:
    """A box about some points (n, 2) [m] of a terrain to drive on, with the heights of finer ones where they are known.

    On nodes of the finest terrain in it, or wider ones where that were more than `MOST_NODES`; the terrain itself where
    none is. Within a spacing of the coarser ground about it, the height of a finer one goes over to that evenly, so
    that there is no step between them. Soils are those of the terrain, at its nearest nodes; heights are exact.
    """
    low, high = points_m.min(axis=0) - margin_m, points_m.max(axis=0) + margin_m
    near = [one for one in finer if _overlaps(one, low, high)]
    if not near:
        return replace(terrain, errors=None)
    low = np.maximum(low, [terrain.x_m[0], terrain.y_m[0]])
    high = np.minimum(high, [terrain.x_m[-1], terrain.y_m[-1]])
    spacing = max(near[-1].spacing_m, math.sqrt(float(np.prod(high - low)) / MOST_NODES))
    x, y = (low[k] + spacing * np.arange(math.floor((high[k] - low[k]) / spacing + 1e-9) + 1) for k in (0, 1))
    height, below = terrain.height_at(x[None, :], y[:, None]), terrain.spacing_m
    for one in near:
        own = one.height_at(x[None, :], y[:, None])
        share = _evenly(~np.isnan(own), below / spacing)
        height = np.where(np.isnan(own), height, np.where(np.isnan(height), own, height + share * (own - height)))
        below = one.spacing_m
    soil = terrain.soil
    if soil.shape[:2] != (1, 1):
        rows, columns = (
            np.rint((axis - first) / terrain.spacing_m).astype(int)
            for axis, first in ((y, terrain.y0_m), (x, terrain.x0_m))
        )
        soil = soil[np.ix_(rows, columns)]
    return replace(
        terrain, name=f"{terrain.name} with {', '.join(one.name for one in near)}", x0_m=float(x[0]), y0_m=float(y[0]),
        spacing_m=float(spacing), height_m=height, soil=soil, errors=None,
        synthetic=terrain.synthetic or any(one.synthetic for one in near),
    )  # fmt: skip


def _evenly(known: npt.NDArray[np.bool_], nodes: float) -> FloatArray:
    """0 at the rim of what is known, 1 so many nodes within it."""
    from scipy.ndimage import distance_transform_edt

    return np.asarray(np.clip((distance_transform_edt(known) - 1.0) / nodes, 0.0, 1.0))


def lengths_checked(
    poses: FloatArray, step_m: float, footprint: RoverFootprint, finer: Sequence[Traversability]
) -> list[float]:
    """Length of a way on which each finer ground, the finest last, is known under the whole rover. [m]

    The poses (n, 3) stand `step_m` apart; where several are known the finest counts.
    """
    places = np.stack([np.vstack([footprint.corners_m(pose), pose[None, :2]]) for pose in poses])
    left, lengths = np.ones(len(poses), dtype=bool), []
    for one in reversed(finer):
        terrain = one.terrain
        column, row = (
            np.rint((places[..., k] - origin) / terrain.spacing_m).astype(int)
            for k, origin in ((0, terrain.x0_m), (1, terrain.y0_m))
        )
        ny, nx = one.demand.shape
        inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
        known = inside & ~one.unknown[np.clip(row, 0, ny - 1), np.clip(column, 0, nx - 1)]
        here = left & known.all(axis=1)
        left &= ~here
        lengths.append(step_m * float(here.sum()))
    return lengths[::-1]


def _overlaps(terrain: Terrain, low: FloatArray, high: FloatArray) -> bool:
    first, last = np.array([terrain.x_m[0], terrain.y_m[0]]), np.array([terrain.x_m[-1], terrain.y_m[-1]])
    return bool((first <= high).all() and (last >= low).all())


def _worst(base: Values, finer: Values, rows: _Cells, columns: _Cells) -> Values:
    """Largest known value in each cell, not below the base's where the cell is not known as a whole."""
    worst = _reduced(np.fmax, finer, rows, columns)
    whole = _whole(_reduced(np.maximum, finer, rows, columns))
    return np.where(np.isnan(worst), base, np.where(whole, worst, np.maximum(base, worst)))


def _whole(values: Values) -> npt.NDArray[np.bool_]:
    """Cells without anything unknown, and not at the rim."""
    whole = ~np.isnan(values)
    whole[[0, -1]] = False
    whole[:, [0, -1]] = False
    return whole


def _reduced(ufunc: np.ufunc, values: Values, rows: _Cells, columns: _Cells) -> Values:
    """One number of each cell. (rows, columns)"""
    start = int(columns.first[0])
    along = ufunc.reduceat(values[: rows.end, start : columns.end], rows.first, axis=0)
    return np.asarray(ufunc.reduceat(along, columns.first - start, axis=1))
