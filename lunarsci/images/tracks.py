"""How deep a wheel's track is below the undisturbed ground beside it, in an elevation model.

The line of a track is read from text or GeoJSON. At each place along it a plane is laid through the ground left and
right, and the mean depth of the track's floor below it is taken. Random errors come from the nodes, and from the same
measurement on ground without a track; what does not average is stated apart.

The ground that was there before a wheel came: how alike ground is nearby, and its height between known places.
"""

import contextlib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, IndexArray, robust_fit, robust_scatter
from lunarsci.errors import ParameterError
from lunarsci.images.elevation import Change, ElevationModel, change_of
from lunarsci.io.inputs import read_input, read_json

FLOOR_SHARE = 0.6
"""Share of the wheel's width, about the middle, that is taken as floor: walls slide in at the sides. Measured as
`COVERED`: of 0.4, 0.6 and 0.8 rms errors of depths are 5.7, 5.3 and 7.2 mm."""
COVERED = 0.5, 0.3
"""Share of the nodes of the floor, and of the ground at each side, that must be known. Measured
(`tests/benchmarks/image_numbers.py`, 30 November 2026, tracks of two rendered scenes): of half as much, as much and
half as much again 27, 21 and 13 depths are determined, with rms errors of 9.0, 5.3 and 5.8 mm."""
RESOLUTION_OFF = 0.3
"""Relative error of the resolution. Measured as `COVERED`: half and twice as much leave errors over stated ones as they
are, to a thousandth."""
CELL_SHARE = 0.5 * FLOOR_SHARE
"""Side of cells whose mean heights stand for the ground, over the wheel's width: half a floor, as `FLOOR_SHARE`."""
PRIOR_SHAMS = 4.0
"""Weight of the stated error beside shams (depths measured where no track is), as so many of them. Measured as
`COVERED`: of 2, 4 and 8 errors are 0.60, 0.62 and 0.65 of the stated ones."""
FEWEST_SHAMS = 2 * PRIOR_SHAMS
"""Shams below which nothing is concluded: so many count twice as much as the stated error, as `PRIOR_SHAMS`."""


class Unrolled(NamedTuple):
    """Nodes about a line, in the order of their way along it. (n,) each

    Attributes
    ----------
    along : way along the line; below 0 and beyond its length where a node lies before or behind it. [m]
    across : distance to the left of the line, negative to the right. [m]
    height : of the node. [m]
    sigma : its random error, NaN where it is not known. [m]
    """

    along: FloatArray
    across: FloatArray
    height: FloatArray
    sigma: FloatArray

    def between(self, low_m: float, high_m: float) -> "Unrolled":
        """Nodes from one way along the line to below another."""
        return self.only(slice(*np.searchsorted(self.along, (low_m, high_m))))

    def only(self, part: slice | BoolArray | IndexArray) -> "Unrolled":
        """Some of the nodes."""
        return Unrolled(*(values[part] for values in self))

    def with_sigma(self) -> "Unrolled":
        """Unknown errors as the median of the known ones, 0 where none is known."""
        valid = np.isfinite(self.sigma)
        middle = float(np.median(self.sigma[valid])) if valid.any() else 0.0
        return self._replace(sigma=np.where(valid, self.sigma, middle))


def read_line(given: str) -> FloatArray:
    """Corners of a line: x1,y1,x2,y2,... as text, or a GeoJSON file with a LineString. (n, 2) [m]

    Raises ParameterError for what is no line, DataError for a file that cannot be read.
    """
    is_file = given.lower().endswith((".json", ".geojson"))
    lines: Iterable[Any] = (
        _line_strings(read_json(read_input(given), "a GeoJSON line", lambda content: content)) if is_file else ()
    )
    none = points = np.empty((0, 2))
    with contextlib.suppress(TypeError, ValueError):
        if is_file:
            points = np.asarray([corner[:2] for corner in next(iter(lines), [])], dtype=np.float64)
        else:
            points = np.array([float(part) for part in given.split(",")]).reshape(-1, 2)
    points = points if points.shape[1:] == (2,) else none
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    if len(points) < 2 or not (np.isfinite(points).all() and (steps > 0).all()):
        raise ParameterError(
            f"'{given}' is no line; give x1,y1,x2,y2,... in m, or a GeoJSON file with a LineString: two corners or "
            "more, each in another place than the one before"
        )
    return points


def _line_strings(content: Any) -> Iterator[Any]:
    """Coordinates of each LineString in parsed GeoJSON, at any depth."""
    if isinstance(content, dict):
        if content.get("type") == "LineString":
            yield content.get("coordinates", [])
        for key in ("geometry", "features", "geometries"):
            yield from _line_strings(content.get(key))
    elif isinstance(content, list):
        for part in content:
            yield from _line_strings(part)


def places_on(line: FloatArray, along: FloatArray, left: FloatArray) -> FloatArray:
    """Points (n, 2) by their way along a line of corners (k, 2) and their distance to the left of it, (n,) each. [m]"""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    segment = np.clip(np.searchsorted(way, along, side="right") - 1, 0, len(line) - 2)
    direction = np.diff(line, axis=0)[segment] / np.diff(way)[segment, None]
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    return np.asarray(line[segment] + (along - way[segment])[:, None] * direction + left[:, None] * normal)


def unrolled(model: ElevationModel, line: FloatArray, reach_m: float) -> Unrolled:
    """Known nodes within `reach_m` of a line, each by its nearest segment."""
    x, y = np.meshgrid(model.x_m, model.y_m)
    low, high = line.min(axis=0) - reach_m, line.max(axis=0) + reach_m
    near = np.isfinite(model.height_m) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    _, along, across = _beside(np.column_stack([x[near], y[near]]), line)
    inside = np.flatnonzero(np.abs(across) <= reach_m)
    nodes = Unrolled(along, across, model.height_m[near], model.layer("height_m_sigma")[near])
    return nodes.only(inside[np.argsort(along[inside], kind="stable")])


def _beside(points: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distance of points (n, 2) from a line of corners (k, 2), their way along it, and how far they are to its left, by
    the nearest segment. (n,) each [m]

    Beyond the ends of the line points keep their way along it, so that windows there are whole.
    """
    best, along, across = (np.full(len(points), value) for value in (np.inf, np.nan, np.nan))
    way = 0.0
    for start, end in itertools.pairwise(line):
        length = float(np.linalg.norm(end - start))
        direction = (end - start) / length
        offset = points - start
        forward, left = offset @ direction, offset @ np.array([-direction[1], direction[0]])
        distance = np.hypot(np.maximum(np.maximum(-forward, forward - length), 0.0), left)
        nearer = distance < best
        best[nearer], along[nearer], across[nearer] = distance[nearer], way + forward[nearer], left[nearer]
        way += length
    return best, along, across


@dataclass(frozen=True, slots=True)
class GroundShape:
    """How alike ground is: half the mean squared difference of two heights is `amplitude_m2` (d / 1 m)^(2 `exponent`).

    A power law, as of fractal ground (Shepard et al. 2001, 10.1029/2000JE001429).

    Attributes
    ----------
    amplitude_m2 : of heights a metre apart. [m2]
    exponent : Hurst's, 0.4 to 0.95. [-]
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
        lags, halves = [], []
        for k in range(max(1, math.ceil(1.2 * resolution_m / cell_m)), max(2, round(0.4 / cell_m)) + 1):
            differences = np.concatenate([(table[k:] - table[:-k]).ravel(), (table[:, k:] - table[:, :-k]).ravel()])
            differences = differences[np.isfinite(differences)]
            if len(differences) > 20:
                lags.append(math.log(k * cell_m))
                halves.append(math.log(max(0.5 * robust_scatter(differences, 0.0) ** 2 - noise, 1e-10)))
        if not lags:
            return cls(1e-6, 0.75)
        slope = np.polyfit(lags, halves, 1)[0] if len(lags) > 2 else 1.5
        exponent = float(np.clip(0.5 * slope, 0.4, 0.95))
        return cls(math.exp(np.mean(halves) - 2 * exponent * np.mean(lags)), exponent)


def _raster(nodes: Unrolled, cell_m: float) -> tuple[FloatArray, float]:
    """Heights of cells (along, across) less the plane through the nodes, NaN where empty [m], and median variance of a
    node's random error [m2]."""
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


class Cells(NamedTuple):
    """Means of the nodes in n cells.

    Attributes
    ----------
    place : way along the line and distance to the left of it. (n, 2) [m]
    height : of the ground. (n,) [m]
    sigma : standard error of this mean. (n,) [m]
    nodes : how many are in the cell. (n,)
    """

    place: FloatArray
    height: FloatArray
    sigma: FloatArray
    nodes: FloatArray


def cells_of(nodes: Unrolled, chosen: BoolArray, cell_m: float, alike: float) -> Cells:
    """Means of the chosen nodes over cells of `cell_m` along and across; `alike` nodes have one error in common."""
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
    alike nearby. The noise of cells within the resolution is correlated. `order` is that of the polynomial across.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackProfile:
    """Where across the track what is looked for.

    Attributes
    ----------
    width_m : of the wheel, > 0. [m]
    gap_m : between the wheel's edge and the ground that is taken as undisturbed: walls and berms. [m]
    strip_m : width of that ground at each side. [m]
    floor_share : share of the wheel's width that is floor. [-]
    order : of the polynomial across the ground: 1 is a plane, 2 bends.
    """

    width_m: float
    gap_m: float
    strip_m: float
    floor_share: float
    order: int = 1

    @classmethod
    def of_wheel(cls, width_m: float, resolution_m: float) -> "TrackProfile":
        """Gap of half the wheel's width and half the matching window, and strips as wide as the wheel; assumed."""
        gap = 0.5 * (width_m + resolution_m)
        return cls(width_m=width_m, gap_m=gap, strip_m=width_m, floor_share=FLOOR_SHARE)

    @property
    def floor_m(self) -> float:
        """Half the width of the floor. [m]"""
        return 0.5 * self.floor_share * self.width_m

    @property
    def ground_m(self) -> tuple[float, float]:
        """From and to which distance of the middle the ground is taken. [m]"""
        inner = 0.5 * self.width_m + self.gap_m
        return inner, inner + self.strip_m

    def gain(self, resolution_m: float) -> float:
        """Share of the depth that is left in the mean of the floor, where heights are means over a window. [-]"""
        across = np.linspace(-self.floor_m, self.floor_m, 201)
        half, window = 0.5 * self.width_m, max(resolution_m, 1e-9)
        overlap = np.minimum(across + 0.5 * window, half) - np.maximum(across - 0.5 * window, -half)
        return float(np.clip(overlap / window, 0.0, 1.0).mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackDepths:
    """Depth of a track along its line; NaN where it is not determined.

    Attributes
    ----------
    distance_m, x_m, y_m : way along the line, and places on the middle of the track. (n,) [m]
    rut_m : mean depth of the floor below the undisturbed ground. (n,) [m]
    rut_m_random : what averages: nodes, and the ground's own shape under the track. (n,) [m]
    systematic_m : by cause, what places share, one standard error; None where nothing is known of it. (n,) [m]
        Causes are `ground`, `floor`, `resolution` and `disparity`; the last alone where nothing is determined.
    reason : why nothing is determined, empty where it is. (n,)
    offset_m : of the track's middle to the left of the line. (n,) [m]
    mean_m, mean_random_m : mean of the depths that are determined, and its random error. [m]
    ground_scatter_m : robust scatter about 0 of the same measurement on ground without a track; None where there is
        too little such ground. [m]
    """

    distance_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    rut_m: FloatArray
    rut_m_random: FloatArray
    systematic_m: dict[str, FloatArray | None]
    reason: tuple[str, ...]
    offset_m: FloatArray
    mean_m: float
    mean_random_m: float
    ground_scatter_m: float | None

    @property
    def rut_m_systematic(self) -> FloatArray:
        """Root sum of squares of all causes. (n,) [m]"""
        parts = [values for values in self.systematic_m.values() if values is not None]
        return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0))) if parts else np.zeros_like(self.rut_m)

    @property
    def determined(self) -> BoolArray:
        """Places with a depth. (n,)"""
        return np.asarray(np.isfinite(self.rut_m))


def _one_depth(survey: "_Survey", nodes: Unrolled, middle: float, profile: TrackProfile) -> tuple[float, float, str]:
    """Depth of one window of the track, its random error, and why there is none. [m], [m]

    nodes : those of the window, with errors.
    middle : distance of the track's middle to the left of the line. [m]
    """
    left = nodes.across - middle
    inner, outer = profile.ground_m
    floor = np.abs(left) <= profile.floor_m
    sides = [(sign * left >= inner) & (sign * left <= outer) for sign in (-1.0, 1.0)]
    nodes_per_m = survey.window_m / survey.model.spacing_m**2
    if floor.sum() < COVERED[0] * nodes_per_m * 2 * profile.floor_m:
        return np.nan, np.nan, "floor not covered"
    for side, name in zip(sides, ("right", "left"), strict=True):
        if side.sum() < COVERED[1] * nodes_per_m * profile.strip_m:
            return np.nan, np.nan, f"ground to the {name} not covered"
    alike = max(1.0, (survey.resolution_m / survey.model.spacing_m) ** 2)
    cells = cells_of(nodes, sides[0] | sides[1], survey.cell_m, alike)
    origin = cells.place.mean(axis=0)
    design = np.column_stack([np.ones(len(cells.height)), cells.place - origin])
    plane, weight = robust_fit(design, cells.height)
    flat = Cells(*(values[weight > 0] for values in cells._replace(height=cells.height - design @ plane)))
    # The wheel is as wide as it is, and rigid: its floor lies below the mean of all the ground that was there.
    ahead = np.linspace(-0.5, 0.5, 9) * survey.window_m * 8 / 9 + 0.5 * (nodes.along[0] + nodes.along[-1])
    under = np.meshgrid(ahead, middle + np.linspace(-0.4, 0.4, 5) * profile.width_m)
    ground, variance = kriged(
        flat,
        np.column_stack([part.ravel() for part in under]),
        survey.shape,
        survey.resolution_m,
        profile.order,
    )
    places = np.column_stack([np.ones(int(floor.sum())), nodes.along[floor], nodes.across[floor]])
    places[:, 1:] -= origin
    rest = nodes.height[floor] - places @ plane
    bottom, share = robust_fit(np.ones((len(rest), 1)), rest)
    noise = nodes.sigma[floor] ** 2
    variance += float((share**2 * noise).sum() / share.sum() ** 2) * min(alike, len(rest))
    return ground - float(bottom[0]), math.sqrt(variance), ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Survey:
    """An elevation model along a line, and how windows are laid.

    Attributes
    ----------
    model : the heights.
    nodes : those about the line, with errors.
    centers : way along the line of the windows' middles, evenly spaced. (n,) [m]
    window_m : length of a window along the line. [m]
    resolution_m : median along the line of the width over which matching averages heights. [m]
    cell_m : side of the cells whose means stand for the ground. [m]
    shape : how alike the ground beside the track is.
    """

    model: ElevationModel
    nodes: Unrolled
    centers: FloatArray
    window_m: float
    resolution_m: float
    cell_m: float
    shape: GroundShape

    @property
    def step_m(self) -> float:
        """Distance of the windows' middles; a window where there is one. [m]"""
        return float(self.centers[1] - self.centers[0]) if len(self.centers) > 1 else self.window_m

    def depths(self, middles: FloatArray, profile: TrackProfile) -> tuple[FloatArray, FloatArray, list[str]]:
        """Depths, their random errors, and reasons, with the track's middle so far to the left of the line.

        `middles` (n,), as the windows; depths and errors are NaN where there is a reason. (n,) each [m], [m]
        """
        half = 0.5 * self.window_m
        depth, error, reason = zip(
            *(
                _one_depth(self, self.nodes.between(center - half, center + half), middle, profile)
                for center, middle in zip(self.centers, middles, strict=True)
            ),
            strict=True,
        )
        return np.array(depth), np.array(error), list(reason)


def track_middles(survey: _Survey, profile: TrackProfile, search_m: float, length_m: float) -> FloatArray:
    """Offset of the track to the left of the line at each place: straight along it, from stretches of 1 m. (n,) [m]

    In each stretch it is where a floor between walls fits the mean profile across best. Zero where the track does not
    stand out.
    """
    from scipy.stats import theilslopes

    edges = np.linspace(0.0, length_m, max(1, round(length_m)) + 1)
    steps = np.arange(-search_m, search_m + 1e-9, 0.5 * survey.model.spacing_m)
    offsets = [_stretch_middle(survey.nodes.between(*ends), profile, steps) for ends in itertools.pairwise(edges)]
    middles, clear = 0.5 * (edges[:-1] + edges[1:]), np.isfinite(offsets)
    offset = np.array(offsets)[clear]
    if len(offset) < 3:
        return np.full_like(survey.centers, np.median(offset) if len(offset) else 0.0)
    line = theilslopes(offset, middles[clear])
    return np.asarray(np.clip(line.intercept + line.slope * survey.centers, -search_m, search_m))


def _stretch_middle(part: Unrolled, profile: TrackProfile, steps: FloatArray) -> float:
    """Where a box of the wheel's width explains most of the profile, NaN where it does not stand out. [m]

    `part` are the nodes of a stretch, `steps` (k,) the tried distances to the left of the line, evenly spaced. [m]
    """
    searched = float(np.abs(steps).max())
    part = part.only(np.abs(part.across) <= profile.ground_m[1] + searched)
    outside = np.abs(part.across) > 0.5 * profile.width_m + searched
    if len(part.along) < 20 or outside.sum() < 10:
        return math.nan
    along, across, height = part.along, part.across, part.height
    trend = np.column_stack([np.ones_like(along), along - along.mean(), across, across**2])
    plane, _ = robust_fit(trend[outside], height[outside])
    rest = height - trend @ plane
    costs, depths = zip(*(_misfit(across - step, rest, profile.width_m) for step in steps), strict=True)
    best = int(np.argmin(costs))
    scatter = robust_scatter(rest[outside])
    # So clear that it is by chance in `SIGNIFICANCE` of places where so many steps are tried.
    clear = NormalDist().inv_cdf(1.0 - SIGNIFICANCE / len(steps))
    if not depths[best] > clear * scatter / math.sqrt(10.0) or best in (0, len(steps) - 1):
        return math.nan
    before, here, after = costs[best - 1 : best + 2]
    bend = before - 2 * here + after
    return float(steps[best] + (0.5 * (before - after) / bend if bend > 0 else 0.0) * (steps[1] - steps[0]))


def _misfit(left: FloatArray, rest: FloatArray, width_m: float) -> tuple[float, float]:
    """Mean square that a straight floor of the wheel's width in flat ground leaves, and its depth. [m2], [m]

    `left` is the distance of nodes to the left of the floor's middle, `rest` their height over the ground. (n,) [m]

    The floor may be tilted: on a slope its two sides are not equally deep, which is no reason to shift it.
    """
    inside, beside = np.abs(left) <= 0.5 * width_m, (np.abs(left) > 0.5 * width_m) & (np.abs(left) <= width_m)
    if inside.sum() < 5 or beside.sum() < 5:
        return math.inf, math.nan
    design = np.column_stack([np.ones(int(inside.sum())), left[inside]])
    floor = np.linalg.lstsq(design, rest[inside], rcond=None)[0]
    squares = float(((rest[inside] - design @ floor) ** 2).sum() + (rest[beside] ** 2).sum())
    return squares / float(inside.sum() + beside.sum()), -float(floor[0])


def change_along(
    model: ElevationModel, before: ElevationModel, line: FloatArray, width_m: float, search_m: float
) -> Change:
    """What changed since an earlier model, which is laid on this one where no wheel of `width_m` on the line went."""
    profile = TrackProfile.of_wheel(width_m, float(np.nanmedian(model.layer("resolution_m"))))
    x, y = np.meshgrid(model.x_m, model.y_m)
    away = _beside(np.column_stack([x.ravel(), y.ravel()]), line)[0].reshape(x.shape)
    inner, outer = profile.ground_m
    return change_of(model, before, (away >= inner + search_m) & (away <= 4.0 * outer))


def track_depths(
    model: ElevationModel,
    line: FloatArray,
    width_m: float,
    *,
    window_m: float = 0.5,
    step_m: float = 0.1,
    search_m: float = 0.05,
    disparity_bias_px: float = 0.1,
    progress: Callable[[int, int], None] | None = None,
) -> TrackDepths:
    """Depth of the track of a wheel along a line (n, 2), every `step_m`, each from a window of `window_m` along it.

    `search_m` is how far to either side of the line its middle may lie; `disparity_bias_px` the relative bias of the
    disparity between floor and ground, which are of other shape and texture: rms 0.12 on eight floors of `scenes.py`,
    pressed, against dense truth. Raises ParameterError for a line off the model.
    """
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    about = model.at("resolution_m", *places_on(line, np.linspace(0.0, length, 50), np.zeros(50)).T)
    resolution = float(np.nanmedian(about)) if np.isfinite(about).any() else 0.0
    profile = TrackProfile.of_wheel(width_m, resolution)
    nodes = unrolled(model, line, 4.0 * profile.ground_m[1] + search_m)
    count = max(1, int((length - min(window_m, length)) / step_m + 1e-9) + 1)
    centers = np.asarray(0.5 * (length - (count - 1) * step_m) + step_m * np.arange(count, dtype=float))
    if len(nodes.along) < 10:
        raise ParameterError(f"the line lies off the heights of {model.name}: x, y {line[0][0]:g}, {line[0][1]:g} m")
    cell = max(model.spacing_m, CELL_SHARE * width_m)
    beside = nodes.only(np.abs(nodes.across) >= profile.ground_m[0] + search_m)
    survey = _Survey(
        model=model,
        nodes=nodes.with_sigma(),
        centers=centers,
        window_m=min(window_m, length),
        resolution_m=resolution,
        cell_m=cell,
        shape=GroundShape.of(beside if len(beside.along) > 10 else nodes, cell, resolution),
    )
    return _measured(survey, profile, line, search_m, disparity_bias_px, progress or (lambda *_: None))


def _measured(
    survey: _Survey,
    profile: TrackProfile,
    line: FloatArray,
    search_m: float,
    disparity_bias_px: float,
    progress: Callable[[int, int], None],
) -> TrackDepths:
    """Depths with all their errors; the last four arguments as of `track_depths`."""
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    middles = track_middles(survey, profile, search_m, length) if search_m > 0 else np.zeros_like(survey.centers)
    gain = profile.gain(survey.resolution_m)
    depth, error, reason = survey.depths(middles, profile)
    depth, error = depth / gain, error / gain
    if survey.resolution_m > profile.width_m:
        depth[:] = error[:] = np.nan
        reason = [f"matching blurs over {survey.resolution_m:.3g} m, too wide for this wheel"] * len(reason)
    progress(1, 3)
    shams, sham_errors = _shams(survey, profile, middles)
    scatter, factor = _as_shams(survey, shams, sham_errors)
    random = error * factor
    progress(2, 3)
    places = places_on(line, survey.centers, middles)
    by_disparity = np.abs(survey.model.at("height_by_disparity_m_px", *places.T)) * disparity_bias_px
    valid = np.isfinite(by_disparity)
    by_disparity[~valid] = np.median(by_disparity[valid]) if valid.any() else np.nan
    causes = _systematic(survey, profile, middles, depth) if np.isfinite(depth).any() else {}
    progress(3, 3)
    determined = np.isfinite(depth)
    return TrackDepths(
        distance_m=survey.centers,
        x_m=places[:, 0],
        y_m=places[:, 1],
        rut_m=depth,
        rut_m_random=random,
        systematic_m={**causes, "disparity": by_disparity if np.isfinite(by_disparity[determined]).any() else None},
        reason=tuple(reason),
        offset_m=middles,
        mean_m=float(np.nanmean(depth)) if determined.any() else np.nan,
        mean_random_m=_mean_error(survey, random[determined], shams),
        ground_scatter_m=scatter,
    )


def _shams(survey: _Survey, profile: TrackProfile, middles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same measurement beside the track, where neither floor nor ground touch it, and its errors. (k, n) each [m]

    Depths of a track that is not there are sham depths: what they scatter by is error.
    """
    inner, outer = profile.ground_m
    first = inner + outer
    aside = [sign * (first + more) for more in (0.0, profile.width_m) for sign in (-1.0, 1.0)]
    depths, errors, _ = zip(*(survey.depths(middles + away, profile) for away in aside), strict=True)
    return np.array(depths), np.array(errors)


def _as_shams(survey: _Survey, shams: FloatArray, errors: FloatArray) -> tuple[float | None, float]:
    """Robust scatter of sham depths (k, n) about 0 [m], None where they are few, and the factor by which the stated
    errors become those that shams show [-]."""
    valid = np.isfinite(shams)
    if valid.sum() < FEWEST_SHAMS:
        return None, 1.0
    independent = valid.sum() * min(1.0, survey.step_m / survey.window_m)
    squared = float(np.median((shams[valid] / errors[valid]) ** 2)) / 0.4549
    factor = (independent * squared + PRIOR_SHAMS) / (independent + PRIOR_SHAMS)
    return robust_scatter(shams[valid], 0.0), math.sqrt(factor)


def _mean_error(survey: _Survey, random: FloatArray, shams: FloatArray) -> float:
    """Random error of the mean over the line: windows overlap, and the ground is alike from one to the next. [m]

    `random` are the errors of the depths that are determined (n,) [m], `shams` sham depths (k, n) [m].
    """
    count = len(random)
    if not count or not np.isfinite(random).any():
        return math.nan
    lags = np.arange(1, count)
    alike = np.maximum(0.0, 1.0 - lags * survey.step_m / survey.window_m)
    if np.isfinite(shams).sum() >= FEWEST_SHAMS:
        variance = np.nanmean(shams**2)
        with np.errstate(invalid="ignore"):
            pairs = [shams[:, lag:] * shams[:, :-lag] for lag in lags]
        seen = np.array([np.mean(p[np.isfinite(p)]) / variance if np.isfinite(p).sum() > 3 else 0.0 for p in pairs])
        alike = np.maximum(alike, seen)
    return float(np.sqrt(np.nanmean(random**2) / count * (1.0 + 2.0 * float(((1.0 - lags / count) * alike).sum()))))


def _systematic(
    survey: _Survey, profile: TrackProfile, middles: FloatArray, depth: FloatArray
) -> dict[str, FloatArray | None]:
    """What places share: which ground, how much of the floor, and how far matching blurs. By cause, (n,) [m]"""
    choices = {
        "ground": [
            replace(profile, gap_m=profile.gap_m + 0.5 * profile.strip_m),
            replace(profile, strip_m=2.0 * profile.strip_m),
            replace(profile, order=2),
        ],
        "floor": [replace(profile, floor_share=share * profile.floor_share) for share in (0.6, 1.3)],
    }
    shared: dict[str, FloatArray | None] = {}
    for cause, others in choices.items():
        off = []
        for other in others:
            there = survey.depths(middles, other)[0] / other.gain(survey.resolution_m)
            both = np.isfinite(there) & np.isfinite(depth)
            if both.any():
                off.append(float(np.mean(there[both] - depth[both])))
        shared[cause] = np.full_like(depth, np.sqrt(np.mean(np.square(off)))) if off else None
    gains = [profile.gain((1.0 + sign * RESOLUTION_OFF) * survey.resolution_m) for sign in (-1.0, 1.0)]
    shared["resolution"] = np.abs(depth) * (gains[0] - gains[1]) / (2.0 * profile.gain(survey.resolution_m))
    return shared
