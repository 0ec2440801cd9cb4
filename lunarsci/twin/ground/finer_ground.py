"""Ground between the nodes of a coarse map: roughness drawn by the scale law of the Moon, and patches of finer nodes.

A map from orbit shows no ground between its nodes, and a rover meets it. Differences of lunar heights over a distance l
have the variance c l^(2 H), and medians of slope and exponent are known for maria and highlands down to 17 m. That the
law goes on to the size of a wheel is assumed. How rough the ground is beside the law the map's own heights tell, as far
as a map that may be smoothed can. What a smooth surface through nodes of that spacing does not show of such ground is
laid on nodes as close as a wheel is large; how rough it is changes from place to place by what is not known of it.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from lunarsci.arrays import NORMAL_MAD, FloatArray, IntArray
from lunarsci.errors import DataError
from lunarsci.ranges import refuse
from lunarsci.regolith.prior import Law, Question, question
from lunarsci.regolith.wheel import Wheel
from lunarsci.twin.ground.hazards import RoverFootprint, Traversability
from lunarsci.twin.ground.height_errors import GRAIN_NODES, HeightErrors, Relief, fractal_power, mean_over
from lunarsci.twin.ground.terrain import Terrain

BASELINE_M = 17.0
"""Shortest distance over which slopes were measured from orbit: Rosenburg et al. (2011), 10.1029/2010JE003716. [m]"""
MARIA, HIGHLANDS = (2.0, 0.76), (7.5, 0.95)
"""Median slope of the ground over 17 m [deg], and median Hurst exponent [-]: Rosenburg et al. (2011), as above."""
WITHIN_KIND = 0.45
"""Standard deviation of ln of the size of differences within maria or highlands; assumed."""
MAP_SD, MAP_DEGREES = 0.5, 4.0
"""How well a map tells it: standard deviation of a Student law with so many degrees of freedom. Maps are smoothed, and
one that is level throughout tells little; assumed."""
LAGS = (2, 4)
"""Nodes over which a map's second differences are looked at: over one node matching and resampling smooth; assumed."""
ALIKE_M = 10.0
"""Distance over which the ground stays about as rough; assumed. [m]"""
MARGIN_M, MARGIN_SHARE = 10.0, 0.2
"""About a plan, and of its length, on which finer nodes are laid: drives stray less. Assumed."""
MOST_DRAWN_NODES = 4_000_000
"""Of the finer grid; beyond them nodes lie wider apart."""
SLOPE_SD = 1.0
"""Standard deviation of the logarithm of median slopes of maps about that of the law: assumed, flat maria to crater
walls."""
HEIGHT_UNITS = {"km": 1e3, "cm": 1e-2, "mm": 1e-3}
"""In metres, by definition; feet and decimetres make slopes that the Moon has, too."""
MAPS = ("slope_deg", "roughness_m", "step_m")
MOST_NODES = 2_000_000
"""A patch that would have more gets wider nodes, each with the worst of what lies in its cell."""


def relief_of_kind(slope_deg: float, hurst: float) -> Relief:
    """The law of differences of heights for a median slope over 17 m and an exponent."""
    # Slopes along x and y are normal, so that the ground's slope has Rayleigh's law, of median sqrt(2 ln 2).
    rms_m = BASELINE_M * math.tan(math.radians(slope_deg)) / math.sqrt(2.0 * math.log(2.0))
    return Relief(rms_m**2 * BASELINE_M ** (-2.0 * hurst), hurst)


def lunar_relief() -> tuple[Relief, float]:
    """The law half-way between maria and highlands, in logarithms, and how far each is from it. [ln of a height]"""
    one, other = relief_of_kind(*MARIA), relief_of_kind(*HIGHLANDS)
    apart = 0.25 * math.log(other.at_one_m / one.at_one_m)
    return Relief(math.sqrt(one.at_one_m * other.at_one_m), 0.5 * (one.hurst + other.hurst)), apart


def terrain_questions(terrain: Terrain) -> list[Question]:
    """Whether its median slope is one of the Moon at its spacing, or would be in another unit of heights."""
    height = terrain.height_m
    slope = np.hypot(np.diff(height, axis=0)[:, :-1], np.diff(height, axis=1)[:-1]) / terrain.spacing_m
    finite = slope[np.isfinite(slope)]
    if not finite.size:
        return []
    relief, _ = lunar_relief()
    usual = math.sqrt(relief.at_one_m * 2.0 * math.log(2.0)) * terrain.spacing_m ** (relief.hurst - 1.0)
    law, median = Law("ln", usual, SLOPE_SD), float(np.median(finite))
    asked = question("median slope of the terrain [m/m]", median, law, HEIGHT_UNITS)
    # Ground may be as level as it will: only another unit makes it doubtful.
    if asked is None or not asked.likely_unit:
        return []
    return [replace(asked, option=f"--height-unit {asked.likely_unit}, or m if it is m")]


@dataclass(frozen=True, slots=True)
class Unresolved:
    """What a grid does not show.

    Attributes
    ----------
    spacing_m : of its nodes. [m]
    rms_m : what lies between them, in the median over the ground that may be there. [m]
    deciding_m : spacing from which on nothing is drawn: the radius of a wheel. [m]
    """

    spacing_m: float
    rms_m: float
    deciding_m: float


def with_unresolved(
    terrain: Terrain, places_m: FloatArray, wheel: Wheel, seed: int = 0
) -> tuple[Terrain, Unresolved | None]:
    """A terrain about planned places (n, 2) on nodes no wider than a wheel's radius, with what it does not show.

    As it is, and None, where its own nodes are as close.
    """
    factor = 2 ** max(0, math.ceil(math.log2(terrain.spacing_m / wheel.radius_m) - 1e-9))
    rows, columns = _about(terrain, places_m)
    while factor > 1 and (rows.stop - rows.start) * (columns.stop - columns.start) * factor**2 > MOST_DRAWN_NODES:
        factor //= 2
    if factor == 1:
        return terrain, None
    finer = _finer(terrain, rows, columns, factor)
    rougher = roughness_of_map(terrain)
    grain = unresolved_grain(factor, finer.spacing_m, seed, rougher, wheel.width_m)
    errors = HeightErrors(
        common=np.zeros((*finer.height_m.shape, 0), np.float32),
        level=np.zeros(finer.height_m.shape, np.float32),
        grain=np.stack([grain, grain], axis=-1),
    )
    unresolved = Unresolved(terrain.spacing_m, NORMAL_MAD * float(np.median(np.abs(grain))), wheel.radius_m)
    return replace(finer, errors=errors), unresolved


def unresolved_grain(
    factor: int, spacing_m: float, seed: int, rougher: tuple[float, float], footprint_m: float = 0.0
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Fractal ground less the cubic spline through every so many nodes of it, on a torus. (512, 512) [m]

    It is as much `rougher` than the law, in the logarithm, as that mean and standard deviation say, alike over 10 m.
    What a wheel meets of it is the mean over a square of its width, `footprint_m`.
    """
    random = np.random.default_rng([seed, 31])
    relief, _ = lunar_relief()
    shape = (GRAIN_NODES, GRAIN_NODES)
    waves = np.fft.fft2(random.standard_normal(shape)) * np.sqrt(fractal_power(shape, spacing_m, relief))
    ground = np.fft.ifft2(waves).real
    kind = gaussian_filter(random.standard_normal(shape), min(ALIKE_M / spacing_m, GRAIN_NODES / 8), mode="wrap")
    nodes = np.mgrid[:GRAIN_NODES, :GRAIN_NODES] / factor
    shown = map_coordinates(ground[::factor, ::factor], nodes, order=3, mode="grid-wrap")
    size = np.exp(rougher[0] + rougher[1] * (kind - kind.mean()) / kind.std())
    met = np.fft.ifft2(np.fft.fft2(size * (ground - shown)) * mean_over(footprint_m, spacing_m, shape)).real
    return np.asarray(met, dtype=np.float32)


def roughness_of_map(terrain: Terrain) -> tuple[float, float]:
    """How much rougher than the law the ground is, by the map's second differences: mean and sd of the logarithm.

    Those of fractal ground over a distance l have the variance c l^(2 H) (4 - 2^(2 H)). Their median counts, so that
    craters and rocks do not stand for the ground. Beforehand it is as rough as the law says, give or take the two kinds
    and what differs within them.
    """
    relief, apart = lunar_relief()
    away = np.linspace(-5.0, 5.0, 1001)
    density = -0.5 * away**2 / (apart**2 + WITHIN_KIND**2)
    sizes = [size for lag in LAGS if (size := _second_differences(terrain, lag, relief)) > 0]
    if sizes:
        off = (away - float(np.mean(np.log(sizes)))) / MAP_SD
        density -= 0.5 * (MAP_DEGREES + 1.0) * np.log1p(off**2 / MAP_DEGREES)
    weight = np.exp(density - density.max())
    mean = float(weight @ away / weight.sum())
    return mean, math.sqrt(float(weight @ (away - mean) ** 2 / weight.sum()))


def _second_differences(terrain: Terrain, lag: int, relief: Relief) -> float:
    """Their size in that of the law; 0 where there are too few, or where the map is level."""
    height, parts = terrain.height_m, []
    for one in (height, height.T):
        if len(one) > 2 * lag:
            bent = one[2 * lag :] - 2.0 * one[lag:-lag] + one[: -2 * lag]
            parts.append(bent[np.isfinite(bent)])
    together = np.concatenate(parts) if parts else np.empty(0)
    if together.size < 10:
        return 0.0
    law = relief.at_one_m * (lag * terrain.spacing_m) ** (2.0 * relief.hurst) * (4.0 - 2.0 ** (2.0 * relief.hurst))
    return NORMAL_MAD * float(np.median(np.abs(together))) / math.sqrt(law)


def _about(terrain: Terrain, places_m: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of the nodes about a plan, at least four of each where there are so many."""
    length = float(np.hypot(*np.diff(places_m, axis=0).T).sum())
    reach = MARGIN_M + MARGIN_SHARE * length + 2.0 * terrain.spacing_m
    parts = []
    for axis, places in ((terrain.y_m, places_m[:, 1]), (terrain.x_m, places_m[:, 0])):
        first, last = np.searchsorted(axis, (places.min() - reach, places.max() + reach))
        parts.append(slice(max(0, min(int(first), len(axis) - 4)), min(len(axis), max(int(last), 4))))
    return parts[0], parts[1]


def _finer(terrain: Terrain, rows: slice, columns: slice, factor: int) -> Terrain:
    """The same surface on nodes a `factor` closer, between some rows and columns."""
    from scipy.interpolate import RegularGridInterpolator

    x, y = terrain.x_m[columns], terrain.y_m[rows]
    spacing = terrain.spacing_m / factor
    finer_x, finer_y = (axis[0] + spacing * np.arange(factor * (len(axis) - 1) + 1) for axis in (x, y))
    soil = terrain.soil
    if soil.shape[0] > 1:
        places = np.stack(np.meshgrid(finer_y, finer_x, indexing="ij"), axis=-1)
        laid = RegularGridInterpolator((y, x), soil[rows, columns], bounds_error=False, fill_value=None)
        soil = laid(places)
    return replace(
        terrain,
        x0_m=float(x[0]),
        y0_m=float(y[0]),
        spacing_m=spacing,
        height_m=terrain.height_at(finer_x[None, :], finer_y[:, None]),
        soil=soil,
        ground=terrain.written,
    )


Values = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Along one axis: nodes of one grid, and those of another one in the cell about each.

    Attributes
    ----------
    nodes : numbers of nodes of the one grid. (k,)
    first : number of the first node of a finer grid in the cell about each, or of the nearest node of a wider one. (k,)
    end : number behind the last node of the other grid in these cells. The first and last cell may be covered in part.
    """

    nodes: IntArray
    first: IntArray
    end: int

    @classmethod
    def of(cls, axis: FloatArray, over: FloatArray) -> "_Cells":
        spacing, coarse = over[1] - over[0], axis[1] - axis[0]
        if spacing < coarse:
            cell = np.rint((over - axis[0]) / coarse).astype(np.int64)
            inside = np.flatnonzero((cell >= 0) & (cell < len(axis)))
            nodes, first = np.unique(cell[inside], return_index=True)
            return cls(nodes, inside[first], int(inside[-1]) + 1 if inside.size else 0)
        nearest = np.rint((axis - over[0]) / spacing).astype(np.int64)
        nodes = np.flatnonzero((nearest >= 0) & (nearest < len(over)))
        return cls(nodes, nearest[nodes], int(nearest[nodes[-1]]) + 1 if nodes.size else 0)


def check_finer(path: str, finer: Terrain, terrain: Terrain) -> None:
    """Raises DataError for a terrain that cannot stand in place of a part of another one."""
    refuse(_unfit(finer, terrain), path, DataError)


def _unfit(finer: Terrain, terrain: Terrain) -> Iterator[str]:
    if finer.crs and terrain.crs and finer.crs != terrain.crs:
        yield (f"its coordinate system is not that of {terrain.name}; warp it to that one, as with rio warp IN.tif "
               "OUT.tif --like OTHER.tif --res METRES")  # fmt: skip
    if finer.spacing_m >= terrain.spacing_m:
        yield (f"its nodes lie {finer.spacing_m:g} m apart and those of {terrain.name} {terrain.spacing_m:g} m; a "
               "local terrain must be finer; give the finer one as local, or leave it out")  # fmt: skip
    x, y = finer.x_m, finer.y_m
    if not _overlaps(terrain, np.array([x[0], y[0]]), np.array([x[-1], y[-1]])):
        yield (f"covers no part of {terrain.name}: x {x[0]:g} to {x[-1]:g} m, y {y[0]:g} to {y[-1]:g} m; is it in "
               "metres of the same origin?")  # fmt: skip


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
        finer_height = one.height_at(x[None, :], y[:, None])
        share = _evenly(~np.isnan(finer_height), below / spacing)
        height = np.where(
            np.isnan(finer_height),
            height,
            np.where(np.isnan(height), finer_height, height + share * (finer_height - height)),
        )
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


def _evenly(covered: npt.NDArray[np.bool_], nodes: float) -> FloatArray:
    """0 at the rim of what is known, 1 so many nodes within it."""
    return np.asarray(np.clip((distance_transform_edt(covered) - 1.0) / nodes, 0.0, 1.0))


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
        row, column = terrain.nodes(places)
        ny, nx = one.demand.shape
        covered = terrain.has(row, column) & ~one.unknown[np.clip(row, 0, ny - 1), np.clip(column, 0, nx - 1)]
        here = left & covered.all(axis=1)
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
