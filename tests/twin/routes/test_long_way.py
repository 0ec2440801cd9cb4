"""Ways of hundreds of metres over a grid of orbit: their cost, what they pass, and why there is none."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Polygon

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import Traversability, assess, ground_maps, map_scales, read_mobility, rover_footprint
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.plans.plan import check_plan
from lunarsci.twin.routes.arc_search import Strip, search_ground
from lunarsci.twin.routes.long_way import _no_way, _strip, long_way, way_over_nodes
from lunarsci.twin.routes.planner import PlannedPath
from lunarsci.twin.rover import build_rover

SPACING = 2.0
X, Y = np.arange(0.0, 261.0, SPACING), np.arange(0.0, 201.0, SPACING)
FLAT = np.zeros((Y.size, X.size))
YUTU2 = build_rover("yutu2")
MOBILITY = read_mobility(read_rover("yutu2"), YUTU2)
START, TARGET = (20.0, 60.0, 90.0), (230.0, 80.0)


def seen(height: np.ndarray) -> Traversability:
    terrain = build_terrain("test", 0.0, 0.0, SPACING, height, read_soil("longji"))
    return assess(terrain, ground_maps(terrain, *map_scales(YUTU2)), MOBILITY)


def wall(gap: tuple[float, float] | None) -> np.ndarray:
    """A ridge 6 m high at x = 120 m across the map, with a gap between two y."""
    height = FLAT + 6.0 * np.maximum(1.0 - np.abs(X - 120.0) / 6.0, 0.0)
    if gap is not None:
        height[(gap[0] < Y) & (gap[1] > Y)] = 0.0
    return height


def strip_of(surface: Traversability) -> Strip:
    ends = np.array([START[:2], TARGET])
    ground = search_ground(surface, ends, 200.0)
    return Strip(window=ground.window, discs=np.zeros(1), step_m=SPACING, need_m=1.0, wanted_m=2.0)


def check(surface: Traversability, path: PlannedPath, heading_deg: float | None = None) -> None:
    """Ends, curvature, and by polygons of matplotlib that no hazard lies under the footprint and its margin."""
    places = np.arange(0.0, path.plan.length_m, 0.25)
    poses = planned_pose(path.plan, places)
    end = planned_pose(path.plan, [path.plan.length_m])[0]
    assert math.dist(end[:2], path.target_m) < 0.01
    assert poses[0] == pytest.approx([START[0], START[1], math.radians(START[2])])
    if heading_deg is not None:
        assert math.remainder(math.degrees(end[2]) - heading_deg, 360.0) == pytest.approx(0.0, abs=1e-6)
    check_plan(path.plan, YUTU2)
    assert path.max_curvature_per_m <= 1.0 / MOBILITY.min_turning_radius_m + 1e-9
    footprint, extra = rover_footprint(YUTU2), MOBILITY.hazard_distance_m / math.sqrt(2.0) * 0.999
    rows, columns = np.nonzero(surface.hazard)
    points = np.column_stack([X[columns], Y[rows]])
    u = np.array([footprint.front_m + extra, footprint.rear_m - extra])[[0, 0, 1, 1]]
    v = (footprint.half_width_m + extra) * np.array([1, -1, -1, 1])
    for x, y, heading in poses:
        cos, sin = math.cos(heading), math.sin(heading)
        assert (
            not Polygon(np.column_stack([x + cos * u - sin * v, y + sin * u + cos * v])).contains_points(points).any()
        )


def test_what_lies_beyond_the_nearest_place_is_looked_for_as_far_as_the_target() -> None:
    """Places every 2 m were reached as far as x = 2 m; straight from there to (8, 8) m a wall begins 2 m before it."""
    reason = np.full((21, 21), "", dtype=object)
    reason[13:, 13:] = "a wall"
    terrain = build_terrain("square", 0.0, 0.0, 0.5, np.zeros((21, 21)), read_soil("longji"))
    surface: Any = SimpleNamespace(
        terrain=terrain, demand=np.zeros((21, 21)), reason=lambda row, column: reason[row, column]
    )
    window: Any = SimpleNamespace(x0=-6.0, y0=2.0)
    cost = np.full((3, 8), np.inf)
    cost[0, :5] = 1.0
    said = _no_way(surface, window, cost, 2.0, np.array([8.0, 8.0]))
    assert "x 2.0 m, y 2.0 m, 8.5 m from the target; beyond it a wall" in said
    reason[:] = ""
    assert "8.5 m from the target; try" in _no_way(surface, window, cost, 2.0, np.array([8.0, 8.0]))


def test_discs_keep_a_hazard_at_its_distance_from_the_whole_rectangle() -> None:
    """On fine nodes, of which nothing is added for what lies between them."""
    terrain = build_terrain("fine", 0.0, 0.0, 0.1, np.zeros((81, 121)), read_soil("longji"))
    surface = assess(terrain, ground_maps(terrain, *map_scales(YUTU2)), MOBILITY)
    strip, shape = _strip(surface, YUTU2, np.array([[4.0, 4.0], [8.0, 4.0]])), rover_footprint(YUTU2)
    turn = np.radians(np.arange(0.0, 90.5, 0.5))
    beside = MOBILITY.hazard_distance_m * np.column_stack([np.cos(turn), np.sin(turn)])
    front = np.array([shape.front_m, shape.half_width_m]) + beside
    nearest = np.hypot(front[:, :1] - strip.discs, front[:, 1:]).min(axis=1)
    assert strip.need_m - 0.05 < nearest.max() <= strip.need_m


def test_over_flat_nodes_cost_is_that_of_steps_to_eight_neighbours() -> None:
    surface = seen(FLAT)
    way = way_over_nodes(surface, strip_of(surface), np.array([START[:2], TARGET]))
    across, along = abs(TARGET[1] - START[1]), abs(TARGET[0] - START[0])
    assert way.cost_m[-1] == pytest.approx(along - across + math.sqrt(2.0) * across, rel=1e-6)
    assert way.places_m[0] == pytest.approx(START[:2]) and way.places_m[-1] == pytest.approx(TARGET)


def test_on_flat_ground_the_way_is_nearly_straight_and_ends_with_the_heading() -> None:
    surface = seen(FLAT)
    path = long_way(surface, YUTU2, START, TARGET, final_heading_deg=-60.0)
    check(surface, path, -60.0)
    assert path.plan.length_m < 1.03 * math.dist(START[:2], TARGET)


@pytest.mark.parametrize("gap", [(140.0, 170.0), (20.0, 44.0)])
def test_a_ridge_is_passed_through_its_gap(gap: tuple[float, float]) -> None:
    surface = seen(wall(gap))
    assert surface.hazard.any()
    path = long_way(surface, YUTU2, START, TARGET)
    check(surface, path)
    poses = planned_pose(path.plan, np.arange(0.0, path.plan.length_m, 0.25))
    at_ridge = poses[np.abs(poses[:, 0] - 120.0) < 1.0, 1]
    assert at_ridge.size and ((at_ridge > gap[0]) & (at_ridge < gap[1])).all()
    # No way through the gap is shorter than the two straight lines by its nearest point.
    shortest = min(
        math.dist(START[:2], (120.0, y)) + math.dist((120.0, y), TARGET) for y in np.linspace(gap[0], gap[1], 50)
    )
    assert shortest <= path.plan.length_m < 1.12 * shortest


def test_without_a_gap_it_is_said_what_is_in_the_way() -> None:
    with pytest.raises(
        ParameterError, match=r"no way over the nodes .* beyond it the slope is .* above 20 deg, at x 1"
    ):
        long_way(seen(wall(None)), YUTU2, START, TARGET)


@pytest.mark.parametrize(
    ("start", "target", "says"),
    [
        (START, (2000.0, 80.0), "the target x 2000 m, y 80 m lies outside the map"),
        ((-50.0, 60.0, 0.0), TARGET, "the start x -50 m, y 60 m lies outside the map"),
        (START, (math.inf, 60.0), r"the target is .* give finite numbers"),
        (START, (116.0, 60.0), "cannot be at the target: the slope is 45 deg, above 20 deg"),
    ],
)
def test_ends_that_are_no_place_for_a_rover(
    start: tuple[float, float, float], target: tuple[float, float], says: str
) -> None:
    with pytest.raises(ParameterError, match=says):
        long_way(seen(wall(None)), YUTU2, start, target)


def test_a_hole_about_the_target_is_named() -> None:
    height = FLAT.copy()
    height[np.hypot(Y[:, None] - 80.0, X - 200.0) < 30.0] = np.nan
    with pytest.raises(ParameterError, match="cannot be at the target: the height is unknown at x 200"):
        long_way(seen(height), YUTU2, START, (200.0, 80.0))
