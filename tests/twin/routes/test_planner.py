"""Paths planned on made-up obstacles: where they end, what they pass, and why there is none."""

import math
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Polygon

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import (
    Traversability,
    assess,
    ground_maps,
    map_scales,
    read_mobility,
    rover_footprint,
    swept_nodes,
)
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.path import arc_end, planned_pose
from lunarsci.twin.plans.plan import Leg, Plan, check_plan, parse_sweep, plan_text, read_plan
from lunarsci.twin.routes.arc_search import close_on_point, close_on_pose
from lunarsci.twin.routes.planner import PlannedPath, path_table, plan_path, share_on
from lunarsci.twin.rover import Rover, build_rover

SPACING = 0.1
X, Y = np.arange(-3.0, 13.01, SPACING), np.arange(-6.0, 6.01, SPACING)
FLAT = np.zeros((Y.size, X.size))
YUTU2 = build_rover("yutu2")
MOBILITY = read_mobility(read_rover("yutu2"), YUTU2)
START = (0.0, 0.0, 0.0)


def seen(height: np.ndarray, **limits: float) -> Traversability:
    return compared(build_terrain("test", X[0], Y[0], SPACING, height, read_soil("longji")), **limits)


def compared(terrain: Terrain, **limits: float) -> Traversability:
    return assess(terrain, ground_maps(terrain, *map_scales(YUTU2)), MOBILITY.with_limits(**limits))


def wall(*gaps: tuple[float, float]) -> np.ndarray:
    """A wall 1 m high at x = 5 m across the map, with gaps of a middle and a width."""
    height = FLAT.copy()
    blocked = np.ones(Y.size, dtype=bool)
    for middle, width in gaps:
        blocked &= np.abs(Y - middle) > 0.5 * width
    height[np.ix_(blocked, np.abs(X - 5.0) < 0.16)] = 1.0
    return height


def clearance_by_polygons(surface: Traversability, path: PlannedPath, extra_m: float) -> bool:
    """Whether the footprint, wider by `extra_m` all round, stays off every hazard and hole: polygons of matplotlib."""
    shape, footprint = surface.terrain, rover_footprint(YUTU2)
    bad = surface.hazard | np.isnan(shape.height_m)
    rows, columns = np.nonzero(bad)
    points = np.column_stack([shape.x_m[columns], shape.y_m[rows]])
    u = np.array([footprint.front_m + extra_m, footprint.rear_m - extra_m])[[0, 0, 1, 1]]
    v = (footprint.half_width_m + extra_m) * np.array([1, -1, -1, 1])
    for x, y, heading in planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 300)):
        corners = np.column_stack(
            [x + math.cos(heading) * u - math.sin(heading) * v, y + math.sin(heading) * u + math.cos(heading) * v]
        )
        if Polygon(corners).contains_points(points).any():
            return False
    return True


def check(surface: Traversability, path: PlannedPath, target: tuple[float, float]) -> None:
    """The end, the limits and the clearance, each found apart from the planner."""
    end = planned_pose(path.plan, [path.plan.length_m])[0]
    assert math.dist(end[:2], target) < 0.01
    assert 1 <= len(path.plan.legs) <= 4
    assert max(abs(arc.curvature_per_m) for arc in path.plan.legs) <= 1.0 / surface.mobility.min_turning_radius_m
    check_plan(path.plan, YUTU2)
    assert path.min_hazard_distance_m >= surface.mobility.hazard_distance_m
    assert clearance_by_polygons(surface, path, 0.999 * surface.mobility.hazard_distance_m / math.sqrt(2.0))
    assert path.max_slope_deg <= surface.mobility.max_slope_deg and path.max_step_m <= surface.mobility.max_step_m


def test_flat_ground_gives_a_straight_line() -> None:
    path = plan_path(seen(FLAT), YUTU2, START, (9.0, 0.0))
    assert len(path.plan.legs) == 1
    assert path.plan.length_m == pytest.approx(9.0) and path.max_curvature_per_m < 1e-9
    assert path.cost_m == pytest.approx(9.0 + 0.1)


def test_symmetrical_ground_gives_a_straight_line() -> None:
    path = plan_path(seen(wall((0.0, 3.5))), YUTU2, START, (9.0, 0.0))
    assert path.max_curvature_per_m == pytest.approx(0.0, abs=1e-3)
    assert path.plan.length_m == pytest.approx(9.0, abs=1e-3)


@pytest.mark.parametrize("middle", [2.0, -2.5, 3.5])
@pytest.mark.parametrize("width", [3.0, 2.2])
def test_a_wall_is_passed_through_its_gap(middle: float, width: float) -> None:
    surface = seen(wall((middle, width)))
    path = plan_path(surface, YUTU2, START, (9.5, 0.0))
    check(surface, path, (9.5, 0.0))
    poses = planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 1000))
    at_wall = poses[np.abs(poses[:, 0] - 5.0) < 0.2, 1]
    assert at_wall.size and (np.abs(at_wall - middle) < 0.5 * width - 0.2).all()


def test_the_nearer_of_two_gaps_is_taken() -> None:
    path = plan_path(seen(wall((1.5, 3.0), (-4.0, 3.0))), YUTU2, START, (9.5, 1.0))
    poses = planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 500))
    assert poses[np.abs(poses[:, 0] - 5.0) < 0.2, 1].min() > 0


def test_a_wall_without_a_gap_or_with_one_too_narrow_is_not_passed() -> None:
    for height in (wall(), wall((1.0, 1.3))):
        with pytest.raises(ParameterError, match=r"no path .* nearest place reached .* above 20 deg, at x 4\.[345]"):
            plan_path(seen(height), YUTU2, START, (9.5, 0.0))


def test_on_open_ground_no_obstacle_is_blamed() -> None:
    with pytest.raises(ParameterError, match=r"m from where the map ends; try .*`turning_radius`"):
        plan_path(seen(FLAT), YUTU2, START, (START[0] + 0.5, START[1] + 0.5))


def test_a_low_wall_is_driven_over_and_a_stricter_limit_forbids_it() -> None:
    height = 0.1 * wall()
    assert plan_path(seen(height), YUTU2, START, (9.5, 0.0)).max_step_m == pytest.approx(0.1)
    with pytest.raises(ParameterError, match="step"):
        plan_path(seen(height, max_step_m=0.05), YUTU2, START, (9.5, 0.0))


def test_a_hole_is_kept_clear_of() -> None:
    height = FLAT.copy()
    height[np.ix_(np.abs(Y) < 0.6, np.abs(X - 5.0) < 0.6)] = np.nan
    surface = seen(height, hazard_distance_m=0.5)
    path = plan_path(surface, YUTU2, START, (10.0, 0.0))
    check(surface, path, (10.0, 0.0))
    assert not np.isnan(surface.maps.slope_deg[_nodes(path)]).any()


def _nodes(path: PlannedPath) -> tuple[np.ndarray, np.ndarray]:
    poses = planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 300))
    return np.rint((poses[:, 1] - Y[0]) / SPACING).astype(int), np.rint((poses[:, 0] - X[0]) / SPACING).astype(int)


def test_a_steep_hill_is_gone_round_and_the_cost_prefers_gentle_ground() -> None:
    hill = np.exp(-((X[None, :] - 5.0) ** 2 + (Y[:, None] - 0.3) ** 2) / 2.0)
    steep, gentle = (seen(scale * hill) for scale in (1.2, 0.3))
    over, straight = (plan_path(surface, YUTU2, START, (10.0, 0.0)) for surface in (steep, gentle))
    check(steep, over, (10.0, 0.0))
    assert over.max_slope_deg < 20.0 < np.nanmax(steep.maps.slope_deg)
    assert over.plan.length_m > straight.plan.length_m
    ahead = planned_pose(over.plan, np.linspace(0.0, over.plan.length_m, 100))
    assert ahead[:, 1].min() < -0.5, "the hill lies to the left"


def test_a_mirrored_ground_gives_the_mirrored_path() -> None:
    left, right = (
        plan_path(seen(height), YUTU2, START, (9.5, 0.0)) for height in (wall((2.0, 3.0)), wall((2.0, 3.0))[::-1])
    )
    assert [arc.length_m for arc in left.plan.legs] == pytest.approx([a.length_m for a in right.plan.legs], rel=0.02)
    assert left.cost_m == pytest.approx(right.cost_m, rel=0.005)


@pytest.mark.parametrize("heading", [0.0, 45.0, -90.0])
def test_a_final_heading_is_kept(heading: float) -> None:
    surface = seen(FLAT)
    path = plan_path(surface, YUTU2, (0.0, 0.0, 20.0), (7.0, 2.0), final_heading_deg=heading)
    check(surface, path, (7.0, 2.0))
    assert math.degrees(path.end[2]) == pytest.approx(heading, abs=0.01)


def test_equal_runs_give_equal_paths() -> None:
    first, second = (plan_path(seen(wall((2.0, 2.4))), YUTU2, START, (9.5, 0.0)) for _ in range(2))
    assert first.plan == second.plan


STEEP = math.tan(math.radians(25.0)) * np.maximum(X[None, :] - 6.0, 0.0) + 0.0 * Y[:, None]
HOLED = FLAT.copy()
HOLED[60, 120] = np.nan


@pytest.mark.parametrize(
    ("height", "start", "target", "says"),
    [
        (FLAT, START, (40.0, 0.0), "target x 40 m, y 0 m lies outside the map, which goes from x -3 to 13 m"),
        (FLAT, (0.0, 7.0, 0.0), (5.0, 0.0), "start x 0 m, y 7 m lies outside"),
        (FLAT, START, (math.nan, 0.0), "finite"),
        (FLAT, (0.0, math.inf, 0.0), (5.0, 0.0), "finite"),
        (FLAT, (0.0, 0.0, math.nan), (5.0, 0.0), "finite"),
        (FLAT, START, (0.0, 0.0), "another target"),
        (FLAT, START, (12.9, 0.0), "the edge of the map is too near"),
        (FLAT, START, (12.4, 0.0), "at the target the footprint is .* the map ends"),
        (
            HOLED,
            START,
            (9.0, 0.0),
            "at the target: the height is unknown at x 9.00 m, y 0.00 m.* heights that reach there$",
        ),
        (
            STEEP,
            START,
            (10.0, 0.0),
            r"target: the slope is 25 deg, above 20 deg.*with room being [5-8]\.?\d*,0;",
        ),
        (
            STEEP,
            (10.0, 0.0, 180.0),
            (0.0, 0.0),
            r"cannot be at the start: the slope is 25 deg, above 20 deg.* --max-slope 25$",
        ),
        (wall(), (4.2, 0.0, 0.0), (0.0, 0.0), r"at the start the footprint is 0\.00 m from an obstacle and 0\.2 m are"),
    ],
)
def test_what_cannot_be_planned_says_why(
    height: np.ndarray, start: tuple[float, float, float], target: tuple[float, float], says: str
) -> None:
    with pytest.raises(ParameterError, match=says) as caught:
        plan_path(seen(height), YUTU2, start, target)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("start", [(-3.5, 0.0, 0.0), (-2.3, 0.0, 0.0), (4.2, 0.0, 180.0)])
def test_the_start_that_an_error_names_is_one(start: tuple[float, float, float]) -> None:
    """Outside the map, at its edge, and at a wall."""
    surface = seen(wall((0.0, 6.0)) if start[0] < 0 else wall())
    target = (9.0, 0.0) if start[0] < 0 else (0.0, 0.0)
    with pytest.raises(ParameterError, match="another `start`, the nearest with room being") as caught:
        plan_path(surface, YUTU2, start, target)
    x, y = (float(part) for part in str(caught.value).split("room being ")[1].split(" ")[0].rstrip(",;").split(","))
    assert plan_path(surface, YUTU2, (x, y, start[2]), target).plan.length_m > 1.0


def test_the_target_that_an_error_names_can_be_reached() -> None:
    """Behind a wall there is more room, and nearer to a target on a rock there; the rover comes as far as the wall."""
    height = wall()
    height[np.ix_(np.abs(Y) < 0.3, np.abs(X - 9.0) < 0.3)] = 1.0
    with pytest.raises(ParameterError, match="another `target`, the nearest with room being") as caught:
        plan_path(seen(height), YUTU2, START, (9.0, 0.0))
    x, y = (float(part) for part in re.findall(r"-?\d+\.?\d*", str(caught.value).split("room being ")[1])[:2])
    assert 2.0 < x < 5.0
    assert plan_path(seen(height), YUTU2, START, (x, y)).plan.length_m > 1.0


def test_the_passage_of_the_stand_in_is_found() -> None:
    """With the walls of the craters forbidden, the path to the end of the plan of Ding et al. (2024) is that plan's."""
    plan = read_plan()
    published = planned_pose(plan, np.linspace(0.0, plan.length_m, 200))
    end = published[-1]
    surface = compared(synthetic_longji(), max_slope_deg=11.0)
    for heading in (math.degrees(end[2]), None):
        path = plan_path(surface, YUTU2, START, (end[0], end[1]), final_heading_deg=heading)
        check(surface, path, (end[0], end[1]))
        poses = planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 200))
        assert np.hypot(*(poses - published)[:, :2].T).max() < 0.25
        assert path.plan.length_m == pytest.approx(plan.length_m, rel=0.02)
    table = path_table(path, surface)
    assert table["distance_m"].iloc[-1] == pytest.approx(path.plan.length_m)
    assert table["slope_deg"].max() <= path.max_slope_on_path_deg + 1e-6


def test_the_table_of_a_path_has_a_row_every_tenth_of_a_metre_or_nearer() -> None:
    """1.05 m on a circle of 2 m take 11 steps of 95 mm; heights are those of a plane, maps those of the next node."""
    x, y = np.arange(-1.0, 3.01, 0.25), np.arange(-1.0, 2.01, 0.25)
    ground = build_terrain("plane", -1.0, -1.0, 0.25, 0.1 * x + 0.05 * y[:, None], read_soil("longji"))
    number = np.arange(x.size * y.size).reshape(y.size, x.size)
    maps = SimpleNamespace(slope_deg=number, roughness_m=1000 + number, step_m=2000 + number)
    plan = Plan(name="arc", x_m=0.2, y_m=-0.1, heading_deg=30.0, legs=(Leg(1.05, 0.5),), speed_m_s=0.05)
    arc: Any = SimpleNamespace(plan=plan)
    surface: Any = SimpleNamespace(terrain=ground, maps=maps)
    table = path_table(arc, surface)
    distance = np.linspace(0.0, 1.05, 12)
    heading = np.radians(30.0) + 0.5 * distance
    at_x, at_y = 0.2 + 2.0 * (np.sin(heading) - 0.5), -0.1 - 2.0 * (np.cos(heading) - np.sqrt(0.75))
    assert table["distance_m"].to_numpy() == pytest.approx(distance)
    assert table["heading_deg"].to_numpy() == pytest.approx(np.degrees(heading))
    assert table[["x_m", "y_m"]].to_numpy() == pytest.approx(np.column_stack([at_x, at_y]))
    assert table["height_m"].to_numpy() == pytest.approx(0.1 * at_x + 0.05 * at_y)
    nearest = [number[np.abs(y - b).argmin(), np.abs(x - a).argmin()] for a, b in zip(at_x, at_y, strict=True)]
    for name, more in (("slope_deg", 0), ("roughness_m", 1000), ("step_m", 2000)):
        assert (table[name].to_numpy() - more).tolist() == nearest
    assert len(path_table(arc, surface, 0.5)) == 4 and len(path_table(arc, surface, 2.0)) == 2
    # Light is looked at every 2 cm, at 54 places: beyond x = 0.625 m, midway between two nodes, they lie in the dark.
    lit = np.tile(x <= 0.51, (y.size, 1))
    many = np.radians(30.0) + 0.5 * np.linspace(0.0, 1.05, 54)
    assert share_on(lit, arc, surface) == pytest.approx((0.2 + 2.0 * (np.sin(many) - 0.5) < 0.625).mean())


def test_the_closing_arc_ends_at_its_point_and_the_closing_pair_at_its_pose() -> None:
    random = np.random.default_rng(5)
    poses = np.column_stack([4.0 * random.random((200, 2)), random.uniform(-0.6, 0.6, 200)])
    goal = np.array([9.0, 3.0, 0.4])
    length, curvature = close_on_point(poses, goal[:2])
    x, y, _ = arc_end(poses[:, 0], poses[:, 1], poses[:, 2], length[:, 0], curvature[:, 0])
    assert np.isfinite(length).all()
    assert np.column_stack([x, y]) == pytest.approx(np.tile(goal[:2], (200, 1)))
    lengths, curvatures = close_on_pose(poses, goal)
    state = (poses[:, 0], poses[:, 1], poses[:, 2])
    for number in range(2):
        state = arc_end(*state, lengths[:, number], curvatures[:, number])
    assert np.column_stack(state) == pytest.approx(np.tile(goal, (200, 1)))
    behind = close_on_point(np.array([[0.0, 0.0, math.pi]]), np.array([1.0, 0.0]))
    assert np.isnan(behind[0]).all()
    straight = close_on_pose(np.array([[0.0, 0.0, 0.0]]), np.array([4.0, 0.0, 0.0]))
    assert straight[0].sum() == pytest.approx(4.0) and straight[1] == pytest.approx(np.zeros((1, 2)))


def test_the_footprint_covers_the_wheels_and_the_discs_cover_the_footprint(yutu2: Rover) -> None:
    """Wheels 0.3 m high and 0.15 m wide on a base of 1.0 m by 0.9 m."""
    footprint = rover_footprint(yutu2)
    assert (footprint.rear_m, footprint.front_m, footprint.half_width_m) == pytest.approx((-0.65, 0.65, 0.525))
    places, radius = footprint.discs()
    u, v = np.meshgrid(np.linspace(-0.65, 0.65, 131), np.linspace(-0.525, 0.525, 106))
    assert np.hypot(u[..., None] - places, v[..., None]).min(axis=-1).max() <= radius + 1e-12
    assert radius <= 1.05 * 0.525
    pose = np.array([1.0, 2.0, math.radians(90.0)])
    away = footprint.distance_m(pose, np.array([1.0, 1.0, 1.0 + 0.525 + 0.3]), np.array([2.0, 2.75, 2.65 + 0.4]))
    assert away == pytest.approx([0.0, 0.1, 0.5])
    terrain = seen(FLAT).terrain
    swept = swept_nodes(footprint, terrain, np.array([[1.0, 2.0, 0.0]]))
    assert swept.sum() * SPACING**2 == pytest.approx(1.3 * 1.05, rel=0.12)


def test_a_plan_reads_back_as_it_was_written(tmp_path: Path) -> None:
    import dataclasses

    plan = dataclasses.replace(
        plan_path(seen(wall((2.0, 3.0))), YUTU2, START, (9.5, 0.0)).plan,
        name='a "name"\\ with \t, \n, \x7f and é',
        limits=read_plan().limits,
        sweep=(parse_sweep("friction_angle_deg=25:55:9"), parse_sweep("cohesion_pa=520.25:520.25:1")),
    )
    for written in (plan, dataclasses.replace(plan, limits=(), sweep=()), read_plan()):
        path = tmp_path / "plan.toml"
        path.write_text(plan_text(written), "utf-8")
        assert dataclasses.replace(read_plan(path), origin=written.origin) == written
        assert tomllib.loads(plan_text(written))["name"] == written.name
