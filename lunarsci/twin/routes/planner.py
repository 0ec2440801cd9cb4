"""Plan a path of a few arcs from a pose to a place, within the limits of a rover and clear of hazards; paths as tables
and GeoJSON.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.heights.projections import MapProjection, name_of, projection_or_none
from lunarsci.io.documents import geojson_feature
from lunarsci.result import Progress
from lunarsci.twin.ground.hazards import RoverFootprint, Traversability, nearest_node, rover_footprint, swept_nodes
from lunarsci.twin.plans.path import TURN_DEG, planned_pose, poses_along
from lunarsci.twin.plans.plan import Leg, Limit, Plan
from lunarsci.twin.routes.arc_search import (
    COARSEST_M,
    FINEST_M,
    ArcProblem,
    Course,
    SearchGround,
    clearance,
    find_courses,
    pose_after,
    search_ground,
)
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd


Place: TypeAlias = Sequence[float] | FloatArray
"""x and y in m, and what may follow."""
ARRIVAL_M = 0.01
"""A path ends at least this near to its target, as the search reckons it; assumed. [m]"""
MARGIN_SHARE, MARGIN_M, FAR_MARGIN_M = 0.5, 3.0, 50.0
"""The search looks this share of the distance, and so far, beyond start and target; farther on long ways; assumed. [-,
m, m]"""
PATH_STEP_M = 0.02


PATH_NUMBERS = (
    "miss_m",
    "cost_m",
    "min_hazard_distance_m",
    "max_slope_deg",
    "max_slope_on_path_deg",
    "max_step_m",
    "max_roughness_m",
    "max_curvature_per_m",
)
LINE_STEP_M, SHOWN_MARGIN_M = 0.5, 10.0
LOCAL = "local frame of the terrain, x and y in m"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedPath:
    """A path within the limits.

    Attributes
    ----------
    plan : start, arcs and speed.
    target_m : x, y that was asked for. [m]
    cost_m : length in metres of flat, clear ground; NaN of a drive that was not chosen by it. [m]
    min_hazard_distance_m : least distance of the footprint from a node that is a hazard or unknown, or from the edge of
        the map; infinite where none is near. [m]
    max_slope_deg, max_roughness_m, max_step_m : largest over the nodes that the footprint sweeps. [deg, m, m]
    max_slope_on_path_deg : largest slope at the path of the rover's origin. [deg]
    max_curvature_per_m : largest magnitude. [1/m]
    footprint : what was swept along it.
    swept : nodes that the footprint covers. (ny, nx)
    """

    plan: Plan
    target_m: tuple[float, float]
    cost_m: float
    min_hazard_distance_m: float
    max_slope_deg: float
    max_roughness_m: float
    max_step_m: float
    max_slope_on_path_deg: float
    max_curvature_per_m: float
    footprint: RoverFootprint
    swept: BoolArray

    @property
    def end(self) -> FloatArray:
        """Pose at the end of the plan. (3,) [m, m, rad]"""
        return np.asarray(planned_pose(self.plan, [self.plan.length_m])[0])

    @property
    def miss_m(self) -> float:
        """Distance of the end of the plan from the target. [m]"""
        return float(np.hypot(*(self.end[:2] - self.target_m)))

    def to_dict(self) -> dict[str, Any]:
        """For a result."""
        plan, end = self.plan, self.end
        return {
            "arcs": [_leg_record(leg) for leg in plan.legs],
            "start": {"x_m": plan.x_m, "y_m": plan.y_m, "heading_deg": plan.heading_deg},
            "target": {"x_m": self.target_m[0], "y_m": self.target_m[1]},
            "end": {"x_m": end[0], "y_m": end[1], "heading_deg": float(np.degrees(end[2]))},
            "length_m": plan.length_m,
            "speed_m_s": plan.speed_m_s,
            **{name: getattr(self, name) for name in PATH_NUMBERS},
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RouteSearch:
    """From where to where a path is searched for, and on what ground.

    Attributes
    ----------
    surface, ground : where the rover may drive, and the part of it that is looked at.
    rover, footprint : what drives.
    start, goal : poses [m, m, rad]; the heading of the goal is NaN where any will do.
    """

    surface: Traversability
    ground: SearchGround
    rover: Rover
    footprint: RoverFootprint
    start: FloatArray
    goal: FloatArray

    @classmethod
    def of(
        cls,
        surface: Traversability,
        rover: Rover,
        start: tuple[float, float, float],
        target: tuple[float, float],
        final_heading_deg: float | None,
    ) -> "RouteSearch":
        """Raises ParameterError for a start or target that is outside the map, on a hazard or too near to one."""
        goal = (*target, math.nan if final_heading_deg is None else math.radians(final_heading_deg))
        pose = np.array([start[0], start[1], math.radians(start[2])])
        footprint = rover_footprint(rover)
        check_place(surface, "start", start, footprint.reach_m)
        place = (*target, 0.0 if final_heading_deg is None else final_heading_deg)
        check_place(surface, "target", place, footprint.reach_m, start)
        distance = math.dist(start[:2], target)
        if distance < ARRIVAL_M:
            raise ParameterError("the target is where the rover stands; give another target")
        ends = np.array([start[:2], target])
        ground = search_ground(surface, ends, search_margin_m(footprint, distance))
        search = cls(surface=surface, ground=ground, rover=rover, footprint=footprint, start=pose, goal=np.array(goal))
        search._check_room("start", pose[None])
        headings = np.radians(np.arange(0.0, 360.0, 5.0)) if final_heading_deg is None else [goal[2]]
        search._check_room("target", np.array([(*target, heading) for heading in headings]))
        return search

    def problem(self, footprint: RoverFootprint, start: FloatArray, goal: FloatArray) -> ArcProblem:
        """The search of arcs for a footprint that travels along its x."""
        spacing = self.surface.terrain.spacing_m
        return ArcProblem(
            window=self.ground.window,
            start=start,
            goal=goal,
            tightest_per_m=min(1.0 / self.surface.mobility.min_turning_radius_m, self.rover.tightest_curvature_per_m),
            step_m=min(max(FINEST_M, spacing, 0.01 * math.dist(start[:2], goal[:2])), max(COARSEST_M, spacing)),
            **clearance(self.surface, footprint),
        )

    def clear_m(self, poses: FloatArray) -> tuple[float, int]:
        """Least distance of the footprint at some poses (n, 3) from an obstacle, and which node that is. [m]"""
        distance, point, _ = nearest_node(self.footprint, poses, *self._obstacle_places())
        return distance, point

    def has_room_to_turn(self, turn_deg: float) -> bool:
        """Whether the footprint keeps its distance while the rover turns on the spot where it starts."""
        headings = np.radians(np.linspace(0.0, turn_deg, math.ceil(abs(turn_deg) / TURN_DEG) + 1))
        poses = self.start + headings[:, None] * np.array([0.0, 0.0, 1.0])
        return bool(self.clear_m(poses)[0] >= self.surface.mobility.hazard_distance_m)

    def obstacle(self, point: int) -> str:
        """What makes a node of the border an obstacle, in words."""
        row, column = (int(number) for number in self.ground.border[point])
        ny, nx = self.surface.demand.shape
        if not (0 <= row < ny and 0 <= column < nx):
            return "the map ends"
        return self.surface.reason(row, column)

    def why_not(self, nearest: Course) -> str:
        """What is in the way of the course that came nearest, and what to try."""
        end = pose_after(self.start, nearest.arcs)
        left = math.dist(end[:2], self.goal[:2])
        text = f"no path within the limits was found; the nearest place reached is x {end[0]:.2f} m, y {end[1]:.2f} m"
        text += f", {left:.2f} m from the target"
        clear, point = self.clear_m(end[None])
        if math.isfinite(clear) and len(self.ground.border):
            text += f", {max(clear, 0.0):.2g} m from where {self.obstacle(point)}"
        options = "`max_slope`, `max_step`, `hazard_distance` and `turning_radius`, alone or together"
        other = "a nearer target first" if len(nearest.arcs) else self._instead("start", self.start)
        return f"{text}; try other limits by {options}, or {other}"

    def _obstacle_places(self) -> tuple[FloatArray, FloatArray]:
        terrain = self.surface.terrain
        row, column = self.ground.border.T.astype(np.float64)
        return terrain.x0_m + terrain.spacing_m * column, terrain.y0_m + terrain.spacing_m * row

    def _check_room(self, name: str, poses: FloatArray) -> None:
        """Some of the poses must keep their distance from hazards."""
        least = self.surface.mobility.hazard_distance_m
        distance, point = max(self.clear_m(pose[None]) for pose in poses)
        if distance < least:
            raise ParameterError(
                f"at the {name} the footprint is {distance:.2f} m from an obstacle and {least:g} m are to be kept: "
                f"{self.obstacle(point)}; {self._instead(name, poses[0])}, or a smaller `hazard_distance`"
            )

    def _instead(self, name: str, pose: FloatArray) -> str:
        return instead(self.surface, name, pose, self.footprint.reach_m, None if name == "start" else self.start)


def search_margin_m(footprint: RoverFootprint, distance_m: float) -> float:
    """How far beyond start and target the search looks. [m]"""
    return MARGIN_SHARE * distance_m + MARGIN_M + footprint.reach_m


def _leg_record(leg: Leg) -> dict[str, Any]:
    """For a result; how a leg is driven where that is not an arc ahead."""
    names = ("crab_deg", "turn_deg", "slip_ratio")
    other: dict[str, Any] = {name: getattr(leg, name) for name in names if getattr(leg, name)}
    if leg.wheel_test is not None:
        other["wheel_test"] = asdict(leg.wheel_test)
    return {"length_m": leg.length_m, "curvature_per_m": leg.curvature_per_m, **other}


def plan_path(
    surface: Traversability,
    rover: Rover,
    start: tuple[float, float, float],
    target: tuple[float, float],
    *,
    final_heading_deg: float | None = None,
    speed_m_s: float | None = None,
    limits: tuple[Limit, ...] = (),
    name: str = "planned path",
    progress: Progress | None = None,
) -> PlannedPath:
    """The cheapest path of one to four arcs that was found.

    Parameters
    ----------
    surface : where the rover may drive, and its limits.
    rover : its footprint is swept along the path.
    start : x, y, heading of its origin. [m, m, deg]
    target : x, y that its origin shall reach. [m, m]
    final_heading_deg : heading at the target; any when None. [deg]
    speed_m_s, limits, name : of the plan; the speed is the rover's highest when None.
    progress : called with (stages done, stages).

    The footprint keeps `hazard_distance_m` from every node that exceeds a limit or has no known height, and from the
    edge of the map; the slope at the rover's origin must be known; the radius of the arcs is at least
    `min_turning_radius_m` and one that the rover can steer. The search is deterministic; it tries a lattice of arcs,
    which does not prove that there is no path where it finds none. Slope and roughness already look half a footprint
    ahead, so that hazards of these count twice as wide as they are. Raises ParameterError where it finds none, with
    what is in the way, and for a start or target that is outside the map, on a hazard or too near to one.
    """
    search = RouteSearch.of(surface, rover, start, target, final_heading_deg)
    speed = commanded_speed(rover, speed_m_s)
    problem = search.problem(search.footprint, search.start, search.goal)
    courses, nearest = find_courses(problem, progress)
    for course in courses:
        plan = Plan(
            name=name,
            legs=tuple(Leg(float(length), float(curvature)) for length, curvature in course.arcs),
            speed_m_s=speed,
            x_m=start[0],
            y_m=start[1],
            heading_deg=start[2],
            limits=limits,
        )
        path = measured_path(search, plan, course.cost_m)
        if path.min_hazard_distance_m >= surface.mobility.hazard_distance_m and path.miss_m <= ARRIVAL_M:
            return path
    raise ParameterError(search.why_not(nearest))


def commanded_speed(rover: Rover, speed_m_s: float | None) -> float:
    """The speed of a plan, the rover's highest where it is None. Raises ParameterError for one that it cannot drive."""
    speed = rover.max_speed_m_s if speed_m_s is None else speed_m_s
    if not 0 < speed <= rover.max_speed_m_s:
        raise ParameterError(f"speed_m_s is {speed}; {rover.name} drives at most {rover.max_speed_m_s:g} m/s")
    return speed


def share_on(nodes: BoolArray, path: PlannedPath, surface: Traversability) -> float:
    """Share of a path's length over some of the nodes (ny, nx), looked at every 2 cm. [-]"""
    length = path.plan.length_m
    poses = planned_pose(path.plan, np.linspace(0.0, length, max(2, math.ceil(length / PATH_STEP_M) + 1)))
    return float(nodes[surface.terrain.nodes(poses)].mean())


def path_table(path: PlannedPath, surface: Traversability, every_m: float = 0.1) -> "pd.DataFrame":
    """Along the path: distance_m, x_m, y_m, heading_deg, height_m, and slope_deg, roughness_m, step_m at the origin."""
    import pandas as pd

    distance = np.linspace(0.0, path.plan.length_m, max(2, math.ceil(path.plan.length_m / every_m) + 1))
    poses = planned_pose(path.plan, distance)
    row, column = surface.terrain.nodes(poses)
    maps = surface.maps
    return pd.DataFrame(
        {
            "distance_m": distance,
            "x_m": poses[:, 0],
            "y_m": poses[:, 1],
            "heading_deg": np.degrees(poses[:, 2]),
            "height_m": surface.terrain.height_at(poses[:, 0], poses[:, 1]),
            "slope_deg": maps.slope_deg[row, column],
            "roughness_m": maps.roughness_m[row, column],
            "step_m": maps.step_m[row, column],
        }
    )


def nearest_room(
    surface: Traversability, place: Place, reach_m: float, start: Place | None = None
) -> tuple[float, float] | None:
    """The place next to another where a rover that reaches so far may stand, whatever its heading; None for none.

    Such places hang together with the one next to `start`, if that is given.
    """
    from scipy.ndimage import distance_transform_edt, label

    terrain = surface.terrain
    closed = np.pad(surface.hazard | surface.unknown, 1, constant_values=True)
    room = distance_transform_edt(~closed)[1:-1, 1:-1] * terrain.spacing_m
    # A path is looked for between nodes: what is closed reaches half a spacing further, and so does the rover.
    wide = room > reach_m + surface.mobility.hazard_distance_m + terrain.spacing_m
    if not wide.any():
        return None

    def nearest(place: Place, among: BoolArray) -> tuple[int, int]:
        rows, columns = np.nonzero(among)
        number = np.hypot(terrain.x_m[columns] - place[0], terrain.y_m[rows] - place[1]).argmin()
        return int(rows[number]), int(columns[number])

    if start is not None:
        parts = label(wide, np.ones((3, 3)))[0]
        wide = parts == parts[nearest(start, wide)]
    row, column = nearest(place, wide)
    return float(terrain.x_m[column]), float(terrain.y_m[row])


def instead(surface: Traversability, name: str, place: Place, reach_m: float, start: Place | None = None) -> str:
    """What to give in place of a start, or of a target from a start, for a rover that reaches so far."""
    near = nearest_room(surface, place, reach_m, start)
    return f"give another `{name}`" + (
        "" if near is None else f", the nearest with room being {near[0]:.6g},{near[1]:.6g}"
    )


def check_place(
    surface: Traversability, name: str, place: Place, reach_m: float = 0.0, start: Place | None = None
) -> None:
    """Raises ParameterError for what is no place for a rover: outside the map, or with the reason and the nearest place
    for one that reaches so far, from `start` on if it is given.
    """
    if not all(map(math.isfinite, place)):
        raise ParameterError(f"the {name} is {place}; give finite numbers")
    terrain, (x, y) = surface.terrain, place[:2]
    if not (terrain.x_m[0] <= x <= terrain.x_m[-1] and terrain.y_m[0] <= y <= terrain.y_m[-1]):
        of = f" of '{name_of(terrain.crs)}'" if terrain.crs else ""
        raise ParameterError(
            f"the {name} x {x:g} m, y {y:g} m lies outside the map, which goes from x {terrain.x_m[0]:g} to "
            f"{terrain.x_m[-1]:g} m and from y {terrain.y_m[0]:g} to {terrain.y_m[-1]:g} m{of}; "
            f"{instead(surface, name, place, reach_m, start)}"
        )
    row, column = map(int, terrain.nodes(np.array([x, y])))
    if reason := surface.reason(row, column):
        steep = float(surface.maps.slope_deg[row, column])
        limit = f", such as --max-slope {math.ceil(steep)}" if steep > surface.mobility.max_slope_deg else ""
        other = f"a limit that lets it {'leave' if name == 'start' else 'come'}{limit}"
        other = "heights that reach there" if surface.unknown[row, column] else other
        raise ParameterError(
            f"the rover cannot be at the {name}: {reason}; {instead(surface, name, place, reach_m, start)}; "
            f"or give {other}"
        )


def measured_path(search: RouteSearch, plan: Plan, cost_m: float = math.nan) -> PlannedPath:
    """The path of a plan with its extremes, looked at every 2 cm."""
    poses = poses_along(plan, PATH_STEP_M)
    surface = search.surface
    terrain, maps = surface.terrain, surface.maps
    swept = swept_nodes(search.footprint, terrain, poses)
    row, column = surface.terrain.nodes(poses)
    return PlannedPath(
        plan=plan,
        target_m=(float(search.goal[0]), float(search.goal[1])),
        cost_m=cost_m,
        min_hazard_distance_m=search.clear_m(poses)[0],
        max_slope_deg=_largest(maps.slope_deg[swept]),
        max_roughness_m=_largest(maps.roughness_m[swept]),
        max_step_m=_largest(maps.step_m[swept]),
        max_slope_on_path_deg=_largest(maps.slope_deg[row, column]),
        max_curvature_per_m=max(abs(leg.curvature_per_m) for leg in plan.legs),
        footprint=search.footprint,
        swept=swept,
    )


def _largest(values: npt.NDArray[np.float32]) -> float:
    finite = values[~np.isnan(values)]
    return float(finite.max()) if finite.size else math.nan


def path_geojson(path: PlannedPath, surface: Traversability) -> bytes:
    """A FeatureCollection: path, start, target, what is kept out of, and the hazards near the path as polygons.

    Coordinates are longitude and latitude, as RFC 7946 has them, where the terrain has a coordinate system (and
    rasterio is there); these are on the body that the member `body` names, not on WGS 84. Elsewhere they are m, and a
    member `crs` says so. Each feature also has `x_m` and `y_m` of its first place.
    """
    plan = path.plan
    projection = projection_or_none(plan.crs)
    count = max(2, math.ceil(plan.length_m / LINE_STEP_M) + 1)
    places = planned_pose(plan, np.linspace(0.0, plan.length_m, count))[:, :2]
    line = {"name": plan.name, "length_m": plan.length_m, "speed_m_s": plan.speed_m_s, "arcs": len(plan.legs)}
    line |= {"max_slope_deg": path.max_slope_deg, "cost_m": path.cost_m}
    features = [
        _feature("LineString", places, {"role": "path"} | line, projection),
        _feature("Point", places[:1], {"role": "start", "heading_deg": plan.heading_deg}, projection),
        _feature("Point", np.array([path.target_m]), {"role": "target"}, projection),
        *(
            _feature("Point", np.array([(zone.x_m, zone.y_m)]),
                     {"role": "keep_out", "name": zone.name, "radius_m": zone.radius_m}, projection)
            for zone in plan.exclusion_zones
        ),
    ]  # fmt: skip
    if rings := hazard_rings(path, surface):
        shown = [[_shown(ring, projection).tolist()] for ring in rings]
        features.append(geojson_feature("MultiPolygon", shown, {"role": "hazards"}))
    where: dict[str, Any] = {"crs": {"type": "name", "properties": {"name": LOCAL}}}
    if projection is not None:
        radius, flattening = projection.ellipsoid
        where = {"body": {"equatorial_radius_m": radius, "flattening": flattening, "map": projection.name}}
    document = {"type": "FeatureCollection", "features": features} | where
    return (json.dumps(document, sort_keys=True, allow_nan=False) + "\n").encode()


def hazard_rings(path: PlannedPath, surface: Traversability) -> list[FloatArray]:
    """Rectangles that hold the hazards within 10 m of the box about a path: one for each run of nodes in a row. [m]

    Each node stands for its square; rings are closed and go to the left. (5, 2)
    """
    terrain, plan = surface.terrain, path.plan
    places = planned_pose(plan, np.linspace(0.0, plan.length_m, 1000))[:, :2]
    rows, columns = terrain.window(places, SHOWN_MARGIN_M)
    hazard, half = surface.hazard[rows, columns].astype(np.int8), 0.5 * terrain.spacing_m
    steps = np.diff(hazard, axis=1, prepend=0, append=0)
    (row, first), (_, last) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    south = terrain.y_m[rows][row] - half
    west, east = (terrain.x_m[columns.start] - half + terrain.spacing_m * column for column in (first, last))
    north = south + terrain.spacing_m
    corners = ((west, south), (east, south), (east, north), (west, north), (west, south))
    return list(np.stack([np.stack(pair, axis=-1) for pair in corners], axis=1))


def _shown(places_m: FloatArray, projection: MapProjection | None) -> FloatArray:
    return places_m if projection is None else projection.lonlat(*places_m.T)


def _feature(
    kind: str, places_m: FloatArray, properties: Mapping[str, Any], projection: MapProjection | None
) -> dict[str, Any]:
    shown = _shown(places_m, projection)
    coordinates = shown.tolist() if kind == "LineString" else shown[0].tolist()
    place = {"x_m": float(places_m[0, 0]), "y_m": float(places_m[0, 1])}
    return geojson_feature(kind, coordinates, {**properties, **place})
