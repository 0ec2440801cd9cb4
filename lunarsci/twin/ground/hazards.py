"""Where a rover may drive: slope, roughness and step height of a terrain, circles to keep out of, layers of costs.

The ground that the rover covers.
"""

import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.compiled import compiled, each_in_threads
from lunarsci.errors import DataError, ParameterError, within_file
from lunarsci.heights.grid import HeightGrid
from lunarsci.heights.grids import geotiff_bytes, read_grid
from lunarsci.heights.projections import MapProjection, projection_of
from lunarsci.io.documents import check_keys, number_of
from lunarsci.io.inputs import InputFile, read_json
from lunarsci.ranges import FINITE, NOT_NEGATIVE, POSITIVE, check_range, check_ranges
from lunarsci.rovers import RoverDescription
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.rover import Rover

OVERHANG = 1.05
"""The discs that cover the rectangle are at most so many half widths in radius: nearer 1 there are more of them;
assumed."""
ROUND = 0.6
"""Share of the circle about a polygon that it must fill to be taken for that circle; assumed."""
FINEST = 64
"""Squares along the longer side of a polygon, at most, that circles stand for."""
STRAY_M = 3.0
"""Drives are not looked for farther from their plans, beside half a rover, than this; assumed. [m]"""
FARTHEST_M = 1.1e7
"""Once round the Moon, of 1737.4 km radius (Archinal et al. 2018, 10.1007/s10569-017-9805-5). [m]"""
FORBIDDEN = "forbidden"
"""Stands for a cost where nothing may drive."""
SAME_CLASS = 1e-6
# Where a rover file has no [limits]: assumed, cautious for a rocker-bogie.
FALLBACK_STEP_IN_RADII = 1.0
FALLBACK_TURN_IN_TRACKS = 1.5
FALLBACK_DISTANCE_IN_TRACKS = 0.2
TILE = 512
WIDEST_STEP = 2.0
"""A square this many times as wide as a wheel is high no longer shows what the wheel climbs; assumed."""
COST_CAP = 100.0
"""Of a node that is no obstacle; assumed, so that no ground counts as much as an obstacle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverFootprint:
    """A rectangle in the rover's frame, x forward, y left, symmetric about x.

    Attributes
    ----------
    rear_m, front_m : x of its ends. [m]
    half_width_m : half its width. [m]
    """

    rear_m: float
    front_m: float
    half_width_m: float

    @property
    def reach_m(self) -> float:
        """Distance of its furthest corner from the rover's origin. [m]"""
        return math.hypot(max(self.front_m, -self.rear_m), self.half_width_m)

    def discs(self) -> tuple[FloatArray, float]:
        """Places along x of equal discs that cover the rectangle, and their radius. [m]"""
        length = self.front_m - self.rear_m
        count = max(1, math.ceil(length / (2.0 * self.half_width_m * math.sqrt(OVERHANG**2 - 1.0))))
        piece = length / count
        return self.rear_m + piece * (np.arange(count, dtype=np.float64) + 0.5), math.hypot(
            0.5 * piece, self.half_width_m
        )

    def distance_m(self, pose: FloatArray, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Distance of points from the rectangle of a rover at x, y, heading; 0 within it. [m]

        Poses (..., 3) [m, m, rad]; their leading axes and those of the points broadcast together.
        """
        u, v = self._in_frame(pose, x_m, y_m)
        beside = np.maximum(np.abs(v) - self.half_width_m, 0.0)
        return np.asarray(np.hypot(np.maximum(np.maximum(self.rear_m - u, u - self.front_m), 0.0), beside))

    def corners_m(self, pose: FloatArray) -> FloatArray:
        """Corners of the rectangle of a rover at x, y, heading, in order round it. (4, 2) [m]"""
        u = np.array([self.front_m, self.front_m, self.rear_m, self.rear_m])
        v = self.half_width_m * np.array([1.0, -1.0, -1.0, 1.0])
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        return np.column_stack([pose[0] + cos * u - sin * v, pose[1] + sin * u + cos * v])

    @staticmethod
    def _in_frame(pose: FloatArray, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        dx, dy = np.asarray(x_m) - pose[..., 0], np.asarray(y_m) - pose[..., 1]
        return cos * dx + sin * dy, cos * dy - sin * dx


def rover_footprint(rover: Rover) -> RoverFootprint:
    """The rectangle about the wheels as they stand when nothing is steered: what needs ground to drive on."""
    wheels, wheel = rover.wheel_positions_m, rover.wheel
    return RoverFootprint(
        rear_m=float(wheels[:, 0].min()) - wheel.radius_m,
        front_m=float(wheels[:, 0].max()) + wheel.radius_m,
        half_width_m=float(np.abs(wheels[:, 1]).max()) + 0.5 * wheel.width_m,
    )


def rover_outline(rover: Rover) -> RoverFootprint:
    """The rectangle about the wheels with their lugs, as they stand when nothing is steered, and the body."""
    wheels, lug = rover_footprint(rover), rover.wheel.grouser_height_m
    rear, front, side = wheels.rear_m - lug, wheels.front_m + lug, wheels.half_width_m
    if rover.body is not None:
        center, half = rover.body.center_x_m, 0.5 * rover.body.length_m
        rear, front, side = min(rear, center - half), max(front, center + half), max(side, 0.5 * rover.body.width_m)
    return RoverFootprint(rear_m=rear, front_m=front, half_width_m=side)


def swept_nodes(footprint: RoverFootprint, terrain: Terrain, poses: FloatArray) -> BoolArray:
    """Nodes of a terrain that lie within the footprint at some of the poses (n, 3) [m, m, rad]. (ny, nx)"""
    swept = np.zeros(terrain.height_m.shape, dtype=bool)
    x, y = terrain.x_m, terrain.y_m
    for pose in poses:
        rows, columns = terrain.window(footprint.corners_m(pose))
        swept[rows, columns] |= footprint.distance_m(pose, x[None, columns], y[rows, None]) == 0
    return swept


def nearest_node(
    footprint: RoverFootprint, poses: FloatArray, x_m: FloatArray, y_m: FloatArray
) -> tuple[float, int, int]:
    """Least distance of points (m,) from the footprint along the poses (n, 3), the point and the pose. [m]

    Without any point the distance is infinite and both numbers are 0.
    """
    best = (math.inf, 0, 0)
    for number, pose in enumerate(poses if x_m.size else ()):
        distance = footprint.distance_m(pose, x_m, y_m)
        point = int(distance.argmin())
        if distance[point] < best[0]:
            best = (float(distance[point]), point, number)
    return best


@dataclass(frozen=True, slots=True)
class ExclusionZone:
    """A circle that no part of the rover may enter.

    Attributes
    ----------
    name : what is there.
    x_m, y_m : its centre. [m]
    radius_m : its radius, > 0. [m]

    Raises ParameterError.
    """

    name: str
    x_m: float
    y_m: float
    radius_m: float

    def __post_init__(self) -> None:
        check_ranges(self, {FINITE: "x_m y_m", POSITIVE: "radius_m"}, f"keep_out '{self.name}'")


Zones = tuple[ExclusionZone, ...]
"""Circles to keep out of, in the order in which they were given."""


def read_keep_outs(source: InputFile, crs: str = "", climbs_m: float = 0.0) -> Zones:
    """Circles of a GeoJSON file, in the coordinates of the terrain, in m, but those of what wheels climb.

    Coordinates are those of the terrain. Where this has a coordinate system (`crs`, well-known text) they are longitude
    and latitude on its body, as RFC 7946 has them, unless the file has a member `crs`.

    A feature with `x_m`, `y_m` and `keepout_m`, as `images rocks` writes it, is that circle; a point needs
    `keepout_m` or `radius_m`. Where its `height_m` and twice `height_m_sigma` together are at most `climbs_m` it does
    not count: that is ground. A round polygon is the circle about it, another one is covered with circles. Raises
    DataError.
    """
    return read_json(
        source, "a GeoJSON file of ground to keep out of", lambda document: _zones(document, crs, climbs_m)
    )


def _zones(document: Any, crs: str, climbs_m: float) -> Zones:
    features = document.get("features") if isinstance(document, Mapping) else None
    if not isinstance(features, Sequence) or isinstance(features, str):
        raise ParameterError("no FeatureCollection; `lunarsci images rocks -o rocks.geojson` writes one")
    projection = MapProjection(crs) if crs and "crs" not in document else None
    return tuple(
        zone for number, feature in enumerate(features, 1) for zone in _zones_of(feature, number, projection, climbs_m)
    )


def highest_m(properties: Mapping[str, Any]) -> float:
    """What stands there is not higher than this; NaN where nothing is said. [m]"""
    return float(properties.get("height_m", math.nan)) + 2.0 * float(properties.get("height_m_sigma", math.nan))


def _on_map(coordinates: Any, projection: MapProjection | None) -> FloatArray:
    """Places (n, 2) in m, from such or from longitude and latitude."""
    places = np.array(coordinates, dtype=float).reshape(-1, np.shape(coordinates)[-1])[:, :2]
    try:
        return places if projection is None else projection.metres(*places.T)
    except ParameterError as error:
        raise ParameterError(f"{error}; or say with a member 'crs' that coordinates are m of the map") from error


def _zones_of(feature: Any, number: int, projection: MapProjection | None, climbs_m: float) -> Iterator[ExclusionZone]:
    if not isinstance(feature, Mapping) or not isinstance(feature.get("geometry"), Mapping):
        raise ParameterError(f"feature {number} has no geometry")
    properties, shape = feature.get("properties") or {}, feature["geometry"]
    name = str(properties.get("name", f"rock {properties['id']}" if "id" in properties else f"keep-out {number}"))
    try:
        if highest_m(properties) <= climbs_m:
            return
        if {"x_m", "y_m", "keepout_m"} <= set(properties):
            yield ExclusionZone(name, *(float(properties[key]) for key in ("x_m", "y_m", "keepout_m")))
        elif shape["type"] == "Point":
            x, y = _on_map([shape["coordinates"]], projection)[0]
            yield ExclusionZone(
                name,
                float(x),
                float(y),
                float(properties["keepout_m"] if "keepout_m" in properties else properties["radius_m"]),
            )
        elif shape["type"] in ("Polygon", "MultiPolygon"):
            for part in [shape["coordinates"]] if shape["type"] == "Polygon" else shape["coordinates"]:
                yield from _covering(name, _on_map(part[0], projection))
        else:
            raise ParameterError(f"feature {number} is a {shape['type']}; give points with keepout_m, or polygons")
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"feature {number} ('{name}'): {error}") from error


def _covering(name: str, ring: FloatArray) -> Iterator[ExclusionZone]:
    """Circles that together hold a polygon (n, 2). [m]"""
    from matplotlib.path import Path as Polygon

    corners = ring[:-1] if len(ring) > 1 and (ring[0] == ring[-1]).all() else ring
    if len(corners) < 3 or not np.isfinite(corners).all():
        raise ParameterError("a polygon needs three corners or more, in m")
    if np.abs(corners).max() > FARTHEST_M:
        raise ParameterError(f"a polygon has a corner at {np.abs(corners).max():g} m, farther than the Moon goes round")
    x, y = corners.T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = 0.5 * (low + high)
    reach = float(np.hypot(*(corners - middle).T).max())
    if area > ROUND * math.pi * reach**2:
        yield ExclusionZone(name, float(middle[0]), float(middle[1]), reach)
        return
    side = max(math.sqrt(area) / 8, float((high - low).max()) / FINEST)
    counts = np.ceil((high - low) / side).astype(int) + 1
    places = low + side * np.stack(np.meshgrid(*(np.arange(n) for n in counts)), axis=-1).reshape(-1, 2)
    # A square with a point of the polygon has its middle inside, or within half a diagonal of an edge.
    near = Polygon(corners).contains_points(places) | (_off_edges(places, corners) <= side / math.sqrt(2))
    for place in places[near]:
        yield ExclusionZone(name, float(place[0]), float(place[1]), side / math.sqrt(2))


def _off_edges(places: FloatArray, corners: FloatArray) -> FloatArray:
    distance = np.full(len(places), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        way = b - a
        share = np.clip((places - a) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(places - a - share[:, None] * way, axis=1))
    return distance


def within(zones: Zones, terrain: Terrain) -> BoolArray:
    """Nodes of a terrain that lie in a circle. (ny, nx)"""
    inside = np.zeros(terrain.height_m.shape, dtype=bool)
    x, y = terrain.x_m, terrain.y_m
    for zone in zones:
        rows, columns = terrain.window(np.array([[zone.x_m, zone.y_m]]), zone.radius_m)
        inside[rows, columns] |= np.hypot(x[None, columns] - zone.x_m, y[rows, None] - zone.y_m) <= zone.radius_m
    return inside


def near_way(zones: Zones, places_m: FloatArray) -> Zones:
    """The circles that a rover may come near to whose origin passes places (n, 2). [m]"""
    return tuple(
        zone for zone in zones if np.hypot(*(places_m - (zone.x_m, zone.y_m)).T).min() <= STRAY_M + zone.radius_m
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CostLayer:
    """How much a metre of some ground costs, in metres of other ground with the same slopes.

    Attributes
    ----------
    name : what it is, for messages.
    factor : above 0, infinite where no part of the rover may be; 1 where the layer says nothing. (ny, nx) [-]
    covered_share : share of the terrain's nodes of which it says something. [-]

    Raises ParameterError for factors of 0 and below.
    """

    name: str
    factor: npt.NDArray[np.float32]
    covered_share: float = 1.0

    def __post_init__(self) -> None:
        if not (self.factor > 0).all():
            raise ParameterError(
                f"layer '{self.name}' has costs of 0 or below; give factors above 0 (1 changes nothing), or classes"
            )

    @property
    def forbidden(self) -> BoolArray:
        """Nodes that no part of the rover may enter. (ny, nx)"""
        return np.isinf(self.factor)


def parse_cost(text: str) -> float:
    """A factor above 0, or infinity for `forbidden`. Raises ParameterError."""
    try:
        cost = math.inf if text.strip() == FORBIDDEN else float(text)
    except ValueError:
        cost = math.nan
    if not cost > 0 or (math.isinf(cost) and text.strip() != FORBIDDEN):
        raise ParameterError(f"'{text}' is no cost; give a factor above 0, such as 2, or {FORBIDDEN}")
    return cost


def parse_classes(texts: Sequence[str]) -> dict[float, float]:
    """Costs by class, from `VALUE=COST` each, COST a factor or `forbidden`. Raises ParameterError."""
    costs: dict[float, float] = {}
    for text in texts:
        value, sign, cost = text.partition("=")
        try:
            number = float(value) if sign else math.nan
        except ValueError:
            number = math.nan
        if math.isnan(number):
            raise ParameterError(f"class '{text}' is not VALUE=COST, for example 3=forbidden or 2=1.5")
        costs[number] = parse_cost(cost)
    return costs


def read_cost_layer(path: str, terrain: Terrain, classes: Mapping[float, float]) -> CostLayer:
    """A raster on any grid, as `heights.grids.read_grid` reads heights, of costs; or of classes where some are given.

    A node of the terrain has the value of the raster's nearest node; beyond it, where it has no data, and of a class
    without a cost, the factor is 1. Rasters of another coordinate system are looked up by longitude and latitude.
    Raises DataError.
    """
    grid = read_grid(path, values=True)
    values = _values_at(grid, terrain, path)
    covered = ~np.isnan(values)
    if not covered.any():
        raise DataError(f"{path}: covers no node of the terrain; is it of the same place and coordinate system?")
    factor = np.where(covered, values, 1.0)
    if classes:
        factor = np.ones(values.shape)
        for value, cost in classes.items():
            factor[np.abs(values - value) < SAME_CLASS] = cost
    with within_file(path):
        return CostLayer(name=Path(path).name, factor=factor.astype(np.float32), covered_share=float(covered.mean()))


def _values_at(grid: HeightGrid, terrain: Terrain, path: str) -> npt.NDArray[np.float64]:
    """Values of a raster at the nodes of a terrain, NaN where it has none. (ny, nx)"""
    x, y = terrain.x_m[None, :], terrain.y_m[:, None]
    if grid.crs and terrain.crs and grid.crs != terrain.crs:
        lonlat = projection_of(terrain.crs, terrain.name).lonlat(*(axis.ravel() for axis in np.broadcast_arrays(x, y)))
        places = projection_of(grid.crs, path).metres(*lonlat.T).reshape(*terrain.height_m.shape, 2)
        x, y = places[..., 0], places[..., 1]
    column, row = (np.rint((at - first) / grid.spacing_m) for at, first in ((x, grid.x0_m), (y, grid.y0_m)))
    ny, nx = grid.height_m.shape
    row, column = np.broadcast_arrays(row, column)
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    values = np.full(terrain.height_m.shape, np.nan)
    values[inside] = grid.height_m[row[inside].astype(int), column[inside].astype(int)]
    return values


def shadow_layer(lit: BoolArray, cost: float) -> CostLayer:
    """What a metre in shadow costs; infinite forbids it."""
    return CostLayer(name="shadow", factor=np.where(lit, 1.0, cost).astype(np.float32))


@dataclass(frozen=True, slots=True, kw_only=True)
class Mobility:
    """Limits of the ground and of the path of a rover.

    Attributes
    ----------
    max_slope_deg : steepest ground, as the tilt of a plane through the rover's footprint; 0 to 90, exclusive. [deg]
    max_step_m : highest step a wheel climbs, > 0. [m]
    max_roughness_m : largest rms residual about that plane, > 0; None where it is not limited. [m]
    min_turning_radius_m : of the path of the rover's origin, > 0. [m]
    hazard_distance_m : distance to keep between the footprint and what exceeds a limit or is unknown, >= 0. [m]
    assumed : names of the limits that are guesses.

    Raises ParameterError outside these ranges.
    """

    max_slope_deg: float
    max_step_m: float
    min_turning_radius_m: float
    hazard_distance_m: float
    max_roughness_m: float | None = None
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        lengths = {POSITIVE: "max_step_m min_turning_radius_m max_roughness_m", NOT_NEGATIVE: "hazard_distance_m"}
        check_ranges(self, lengths | {"(0, 90)": "max_slope_deg"}, "[limits]")

    def with_limits(self, **limits: float | None) -> "Mobility":
        """The same with some limits replaced where they are not None; these are no longer assumed."""
        stated = {name: value for name, value in limits.items() if value is not None}
        assumed = tuple(name for name in self.assumed if name not in stated)
        return replace(self, **stated, assumed=assumed)


def read_mobility(description: RoverDescription, rover: Rover) -> Mobility:
    """The [limits] table of a rover file; what it lacks is assumed from the size of the rover.

    Assumed are then a slope of 15 deg, a step of one wheel radius, a turning radius of 1.5 tracks and a distance from
    hazards of 0.2 tracks; roughness is not limited. Raises DataError.
    """
    table = description.tables.get("limits", {})
    names = [field.name for field in fields(Mobility) if field.name != "assumed"]
    track = 2.0 * rover.rocker_pivot_y_m
    values: dict[str, float | None] = {
        "max_slope_deg": rover.max_slope_deg,
        "max_step_m": FALLBACK_STEP_IN_RADII * rover.wheel.radius_m,
        "min_turning_radius_m": FALLBACK_TURN_IN_TRACKS * track,
        "hazard_distance_m": FALLBACK_DISTANCE_IN_TRACKS * track,
    }
    assumed = {name for name in values if name not in table}
    assumed |= {key.removeprefix("limits.") for key in description.assumed if key.startswith("limits.")}
    with within_file(description.origin):
        check_keys(table, names, "[limits]")
        values |= {name: number_of(value, f"[limits] {name}") for name, value in table.items()}
        return Mobility(**values, assumed=tuple(sorted(assumed)))  # type: ignore[arg-type]


FloatMap = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundMaps:
    """What the ground asks of a rover, at every node; NaN where a hole or the edge lies within the window.

    Attributes
    ----------
    slope_deg : tilt of the plane fitted by least squares to the square footprint about the node. (ny, nx) [deg]
    roughness_m : rms of the residual about that plane. (ny, nx) [m]
    step_m : largest difference of heights, less the slope of the ground, in a square as wide as a wheel is high; NaN
        everywhere on a grid too coarse to show a step. (ny, nx) [m]
    baseline_m : side of the footprint on this grid, the nearest even number of spacings. [m]
    wheel_window_m : side of the square of the step. [m]
    shows_steps : whether that square is at most twice as wide as it was asked for.
    """

    slope_deg: FloatMap
    roughness_m: FloatMap
    step_m: FloatMap
    baseline_m: float
    wheel_window_m: float
    shows_steps: bool

    def spreads(self) -> dict[str, dict[str, float | None]]:
        """p5, p50, p95 and largest of each map over the nodes where it is known; None where it is nowhere."""
        return {name: _spread(getattr(self, name)) for name in ("slope_deg", "roughness_m", "step_m")}


def _spread(values: FloatMap) -> dict[str, float | None]:
    finite = values[~np.isnan(values)]
    names = ("p5", "p50", "p95", "max")
    if not finite.size:
        return dict.fromkeys(names)
    return dict(zip(names, np.percentile(finite, (5, 50, 95, 100)).tolist(), strict=True))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traversability:
    """Where a rover may drive.

    Attributes
    ----------
    terrain, maps, mobility : what was compared with what.
    demand : largest share of a limit that slope, step or roughness take up, above 1 in hazards, infinite in ground to
        keep out of; NaN unknown. (ny, nx)
    keep_outs : that ground.
    layers : what else a metre costs, and where nothing may be.
    sunlit : nodes that the Sun reaches, where its direction is given. (ny, nx)
    """

    terrain: Terrain
    maps: GroundMaps
    mobility: Mobility
    demand: FloatMap
    keep_outs: Zones = ()
    layers: tuple[CostLayer, ...] = ()
    sunlit: BoolArray | None = None

    def travel_cost(self, rows: slice, columns: slice) -> FloatMap:
        """Cost of a metre in a part of the map: `travel_cost` of the demand times the factors of all layers."""
        cost = travel_cost(self.demand[rows, columns])
        for layer in self.layers:
            cost = cost * layer.factor[rows, columns]
        return np.minimum(cost, np.float32(COST_CAP))

    @property
    def hazard(self) -> BoolArray:
        """Some limit is exceeded. (ny, nx)"""
        return np.asarray(self.demand > 1)

    @property
    def unknown(self) -> BoolArray:
        """A hole or the edge of the map is too near to say. (ny, nx)"""
        return np.isnan(self.demand)

    def reason(self, row: int, column: int) -> str:
        """What keeps a rover off a node, in words; empty where nothing does."""
        at = f"at x {self.terrain.x_m[column]:.2f} m, y {self.terrain.y_m[row]:.2f} m"
        if math.isnan(self.terrain.height_m[row, column]):
            return f"the height is unknown {at}"
        x, y = self.terrain.x_m[column], self.terrain.y_m[row]
        reasons = [
            f"'{zone.name}' is to be kept out of {at}"
            for zone in self.keep_outs
            if math.hypot(x - zone.x_m, y - zone.y_m) <= zone.radius_m
        ]
        reasons += [f"layer '{layer.name}' forbids it {at}" for layer in self.layers if layer.forbidden[row, column]]
        for name, value, limit, unit in self._limited():
            if value[row, column] > limit:
                reasons.append(f"the {name} is {value[row, column]:.4g} {unit}, above {limit:g} {unit}, {at}")
        if not reasons and self.unknown[row, column]:
            return f"a hole or the edge of the map is too near {at}"
        return "; ".join(reasons)

    def _limited(self) -> list[tuple[str, FloatMap, float, str]]:
        rows = [
            ("slope", self.maps.slope_deg, self.mobility.max_slope_deg, "deg"),
            ("step", self.maps.step_m, self.mobility.max_step_m, "m"),
        ]
        if self.mobility.max_roughness_m is not None:
            rows.append(("roughness", self.maps.roughness_m, self.mobility.max_roughness_m, "m"))
        return rows


def map_scales(rover: Rover) -> tuple[float, float]:
    """Side of the footprint, the larger of wheelbase and track, and diameter of the wheels. [m, m]"""
    wheels = rover.wheel_positions_m
    return float(np.ptp(wheels[:, :2], axis=0).max()), 2.0 * rover.wheel.radius_m


def ground_maps(
    terrain: Terrain,
    baseline_m: float,
    wheel_window_m: float,
    progress: Callable[[int, int], None] | None = None,
) -> GroundMaps:
    """Slope, roughness and step height at every node.

    Parameters
    ----------
    terrain : heights on a grid.
    baseline_m : side of the square footprint through which the plane is laid, > 0. [m]
    wheel_window_m : side of the square of the step, > 0. [m]
    progress : called with (tiles done, tiles).

    On a square of (2 m + 1)^2 nodes the coordinates i, j are orthogonal to each other and to a constant, so the normal
    equations of the plane are solved by dx = sum(i h) / sum(i^2), dy = sum(j h) / sum(j^2), and the residual is
    sum(h^2) - n mean^2 - (dx^2 + dy^2) sum(i^2). Each sum is separable. Windows have at least 3 x 3 nodes, so on a
    grid coarser than the rover the footprint is larger than asked for; `baseline_m` of the result tells. Tiles are
    reduced to their own middle height, which keeps roughness true to about 1e-7 of a tile's relief.

    The slope that a step is counted from is, along x and y each, the gentler one of the two halves of the footprint
    before and behind the node, and none where one of them rises and the other falls: a plane has no step, a wall keeps
    nine tenths of its height at least, and by more than the rise of the slope nothing is overstated. Raises
    ParameterError.
    """
    check_range("baseline_m", baseline_m, POSITIVE)
    check_range("wheel_window_m", wheel_window_m, POSITIVE)
    spacing, shape = terrain.spacing_m, terrain.height_m.shape
    plane, wheel = (_half_width(value, spacing, shape) for value in (baseline_m, wheel_window_m))
    layers = np.full((3, *shape), np.nan, dtype=np.float32)
    shows_steps = 2 * wheel * spacing <= WIDEST_STEP * wheel_window_m
    corners = [(row, column) for row in range(0, shape[0], TILE) for column in range(0, shape[1], TILE)]

    def fill(number: int) -> None:
        row, column = corners[number]
        _fill_tile(terrain, row, column, plane, wheel, layers)

    each_in_threads(fill, len(corners), progress)
    _blank_edges(layers[:2], plane)
    _blank_edges(layers[2:], max(plane, wheel))
    if not shows_steps:
        layers[2] = np.nan
    slope, roughness, step = layers
    return GroundMaps(
        slope_deg=slope,
        roughness_m=roughness,
        step_m=step,
        baseline_m=2 * plane * spacing,
        wheel_window_m=2 * wheel * spacing,
        shows_steps=shows_steps,
    )


def assess(
    terrain: Terrain, maps: GroundMaps, mobility: Mobility, keep_outs: Zones = (), layers: tuple[CostLayer, ...] = ()
) -> Traversability:
    """Compare the maps with a rover's limits: demand = max(slope/limit, step/limit, roughness/limit).

    In ground to keep out of, and where a layer forbids it, it is infinite.

    The worst of several measures decides, as in GESTALT (Goldberg, Maimone & Matthies 2002, IEEE Aerospace,
    10.1109/AERO.2002.1035370), which also looks at a plane through a patch as large as the rover, its residual and
    steps; the shares of the limits instead of its scale of goodness are this program's choice.
    """
    demand = maps.slope_deg / np.float32(mobility.max_slope_deg)
    if maps.shows_steps:
        np.maximum(demand, maps.step_m / np.float32(mobility.max_step_m), out=demand)
    if mobility.max_roughness_m is not None:
        np.maximum(demand, maps.roughness_m / np.float32(mobility.max_roughness_m), out=demand)
    for closed in (within(keep_outs, terrain), *(layer.forbidden for layer in layers)):
        demand[closed] = np.inf
    return Traversability(
        terrain=terrain, maps=maps, mobility=mobility, demand=demand, keep_outs=keep_outs, layers=layers
    )


def travel_cost(demand: npt.NDArray[np.floating]) -> FloatMap:
    """Cost of a metre, in metres of flat ground: 1 / (1 - demand^2), at most 100; also 100 for the unknown.

    1.33 at half of a limit, 5.3 at nine tenths of it: an assumed form that grows without bound towards the limit.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = 1.0 / (1.0 - np.minimum(np.asarray(demand, dtype=np.float32), 1.0) ** 2)
    return np.asarray(np.nan_to_num(np.minimum(cost, COST_CAP), nan=COST_CAP), dtype=np.float32)


def _half_width(side_m: float, spacing_m: float, shape: tuple[int, ...]) -> int:
    # Halves go up: a step is never looked for in less than a wheel.
    half = max(1, math.floor(0.5 * side_m / spacing_m + 0.5 + 1e-6))
    if 2 * half + 1 > min(shape):
        raise ParameterError(
            f"the terrain of {shape[1]} x {shape[0]} nodes is smaller than a window of {2 * half * spacing_m:g} m; "
            "give a larger terrain or a shorter baseline"
        )
    return half


def _fill_tile(terrain: Terrain, row: int, column: int, plane: int, wheel: int, layers: FloatMap) -> None:
    """Maps of the nodes of one tile, from the heights of the tile and a margin about it."""
    ny, nx = terrain.height_m.shape
    margin = max(plane, wheel)
    top, left = max(row - margin, 0), max(column - margin, 0)
    bottom, right = min(row + TILE + margin, ny), min(column + TILE + margin, nx)
    height = terrain.height_m[top:bottom, left:right]
    hole = np.isnan(height)
    if hole.all():
        return
    height = np.where(hole, 0.0, height - np.median(height[~hole]))
    rows, columns = slice(row, min(row + TILE, ny)), slice(column, min(column + TILE, nx))
    inner = slice(row - top, rows.stop - top), slice(column - left, columns.stop - left)
    slope, roughness = _plane_maps(height, plane, terrain.spacing_m)
    unknown = _near(hole, plane)
    for layer, values in ((0, slope), (1, roughness)):
        layers[layer, rows, columns] = np.where(unknown, np.nan, values)[inner]
    step = _step(height, plane, wheel)
    layers[2, rows, columns] = np.where(_near(hole, margin), np.nan, step)[inner]


def _plane_maps(height: FloatArray, half: int, spacing: float) -> tuple[FloatArray, FloatArray]:
    from scipy.ndimage import correlate1d, uniform_filter, uniform_filter1d

    side = 2 * half + 1
    ramp = np.arange(-half, half + 1, dtype=float)
    spread = float(ramp @ ramp)
    along = correlate1d(uniform_filter1d(height, side, axis=0), ramp / spread, axis=1)
    across = correlate1d(uniform_filter1d(height, side, axis=1), ramp / spread, axis=0)
    gradient = along**2 + across**2
    residual = uniform_filter(height**2, side) - uniform_filter(height, side) ** 2 - gradient * spread / side
    slope = np.degrees(np.arctan(np.sqrt(gradient) / spacing))
    return slope, np.sqrt(np.maximum(residual, 0.0))


def _step(height: FloatArray, plane: int, wheel: int) -> FloatArray:
    """Range of the heights within `wheel` nodes, less the slope of the half footprints about each node."""
    from scipy.ndimage import correlate1d, uniform_filter1d

    ramp = np.where(np.arange(-plane, plane + 1) <= 0, np.arange(-plane, plane + 1) + 0.5 * plane, 0.0)
    ramp /= ramp @ ramp
    gradients = []
    for axis in (1, 0):
        mean = uniform_filter1d(height, 2 * plane + 1, axis=1 - axis)
        before, behind = correlate1d(mean, ramp, axis=axis), correlate1d(mean, -ramp[::-1], axis=axis)
        gentler = np.where(np.abs(before) < np.abs(behind), before, behind)
        gradients.append(np.where(before * behind > 0, gentler, 0.0))
    step = np.full(height.shape, np.nan)
    _ranges(height, gradients[0], gradients[1], wheel, step)
    return step


@compiled
def _ranges(height: Any, along: Any, across: Any, half: int, ranges: Any) -> None:
    """Range of height less a slope, in (2 half + 1)^2 nodes about each node that has them all. (ny, nx)"""
    ny, nx = height.shape
    for row in range(half, ny - half):
        for column in range(half, nx - half):
            low, high = np.inf, -np.inf
            for i in range(-half, half + 1):
                for j in range(-half, half + 1):
                    value = height[row + i, column + j] - i * across[row, column] - j * along[row, column]
                    low, high = min(low, value), max(high, value)
            ranges[row, column] = high - low


def _near(hole: BoolArray, half: int) -> BoolArray:
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(hole, 2 * half + 1)) if hole.any() else hole


def _blank_edges(layers: FloatMap, half: int) -> None:
    layers[:, :half] = layers[:, -half:] = np.nan
    layers[:, :, :half] = layers[:, :, -half:] = np.nan


def map_layers(surface: Traversability) -> dict[str, npt.NDArray[np.float32]]:
    """Maps of the ground, NaN where unknown; sunlit where the Sun's direction is given. (ny, nx)"""
    maps = surface.maps
    return {
        "slope_deg": maps.slope_deg,
        "roughness_m": maps.roughness_m,
        "step_m": maps.step_m,
        "demand": surface.demand,
        **({} if surface.sunlit is None else {"sunlit": surface.sunlit.astype(np.float32)}),
    }


def maps_bytes(surface: Traversability) -> bytes:
    """NumPy archive: x_m (nx,), y_m (ny,), and slope_deg, roughness_m, step_m, demand (ny, nx), NaN where unknown.

    `sunlit` is 1 where the Sun reaches the ground, where its direction is given; `crs` the coordinate system as
    well-known text, where the terrain has one.
    """
    archive = io.BytesIO()
    terrain = surface.terrain
    place = {"x_m": terrain.x_m, "y_m": terrain.y_m} | ({"crs": np.array(terrain.crs)} if terrain.crs else {})
    np.savez_compressed(archive, **place, **map_layers(surface))  # type: ignore[arg-type]
    return archive.getvalue()


def maps_geotiff(surface: Traversability) -> bytes:
    """GeoTIFF with the bands slope_deg, roughness_m, step_m and demand, in the coordinate system of the terrain.

    Raises ParameterError without rasterio.
    """
    terrain = surface.terrain
    return geotiff_bytes(map_layers(surface), (terrain.x0_m, terrain.y0_m, terrain.spacing_m), crs=terrain.crs)
