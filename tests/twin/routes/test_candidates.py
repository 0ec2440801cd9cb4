"""Drives to compare: round both sides of an obstacle, in other manners, all of them clear of it and at the target."""

import math

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import Traversability, assess, ground_maps, map_scales, read_mobility, rover_footprint
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.plans.path import leg_end, planned_pose, poses_along
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, check_plan
from lunarsci.twin.routes.candidates import PLACES, candidate_plans, course_places, manners, sides
from lunarsci.twin.rover import Rover, build_rover

SPACING = 0.1
X, Y = np.arange(-3.0, 13.01, SPACING), np.arange(-6.0, 6.01, SPACING)
YUTU2 = build_rover("yutu2")
START = (0.0, 0.0, 0.0)


def blocks(*places: tuple[float, float, float]) -> np.ndarray:
    """Level ground with square blocks 1 m high: x, y and half side. [m]"""
    height = np.zeros((Y.size, X.size))
    for x, y, half in places:
        height[np.ix_(np.abs(Y - y) <= half, np.abs(X - x) <= half)] = 1.0
    return height


def seen(height: np.ndarray, rover: str = "yutu2") -> Traversability:
    terrain, built = build_terrain("test", X[0], Y[0], SPACING, height, read_soil("longji")), build_rover(rover)
    mobility = read_mobility(read_rover(rover), built)
    return assess(terrain, ground_maps(terrain, *map_scales(built)), mobility)


def least_distance_m(surface: Traversability, rover: Rover, plan: Plan) -> float:
    """Of the footprint from hazards and the edge of the map along a plan, every centimetre, node by node."""
    footprint, terrain = rover_footprint(rover), surface.terrain
    rows, columns = np.nonzero(surface.hazard | np.isnan(terrain.height_m))
    poses = poses_along(plan, 0.01)
    return min(
        float(footprint.distance_m(pose, terrain.x_m[columns], terrain.y_m[rows]).min(initial=math.inf))
        for pose in poses
    )


def crossing(plan: Plan, x_m: float) -> float:
    """y where a plan first comes to an x. [m]"""
    poses = poses_along(plan, 0.02)
    return float(poses[np.argmax(poses[:, 0] >= x_m), 1])


def test_one_block_is_passed_on_both_sides_and_never_touched() -> None:
    surface = seen(blocks((5.0, 0.0, 0.5)))
    plans = candidate_plans(surface, YUTU2, START, (10.0, 0.0), most=20).plans
    ahead = [plan for plan in plans if {leg.crab_deg for leg in plan.legs} == {0.0} and not plan.legs[0].turn_deg]
    where = [crossing(plan, 5.0) for plan in ahead]
    assert max(where) > 1.0 and min(where) < -1.0
    for plan in plans:
        check_plan(plan, YUTU2)
        assert least_distance_m(surface, YUTU2, plan) >= surface.mobility.hazard_distance_m
        assert math.dist(poses_along(plan, 0.1)[-1, :2], (10.0, 0.0)) < 0.01


def test_two_blocks_in_a_row_have_ways_between_them() -> None:
    """Two blocks beside each other, 3.4 m apart: left of both, between, right of both."""
    surface = seen(blocks((5.0, 2.2, 0.5), (5.0, -2.2, 0.5)))
    plans = candidate_plans(surface, YUTU2, START, (10.0, 0.0), most=40).plans
    where = np.array([crossing(plan, 5.0) for plan in plans if plan.legs[0].crab_deg == 0 and plan.legs[0].length_m])
    assert (where > 2.7).any() and (where < -2.7).any() and (np.abs(where) < 1.7).any()


def test_sides_of_half_circles_differ_by_a_turn() -> None:
    angle = np.linspace(math.pi, 0.0, 40)
    above = np.column_stack([np.cos(angle), np.sin(angle)])
    below = above * (1.0, -1.0)
    once_round = np.concatenate([above, below[::-1], above])
    found = sides(np.array([above, below]), np.array([[0.0, 0.0], [0.0, 3.0], [0.0, -3.0]]))
    assert (np.abs(found[0] - found[1]) == (1, 0, 0)).all()
    (turns,) = sides(once_round[None], np.array([[0.0, 0.1], [0.0, 3.0]]))
    assert abs(turns[0] - sides(above[None], np.array([[0.0, 0.1]]))[0, 0]) == 1 and turns[1] == 0


def test_places_of_courses_lie_at_equal_shares_of_their_lengths() -> None:
    """Against the integral of the heading, in steps of 1/20000 of the way; curvature changes from arc to arc."""
    start = np.array([0.4, -1.2, 2.0])
    arcs = np.array([[[2.0, 0.3], [1.0, -0.5], [3.0, 0.1]], [[0.5, 0.0], [4.0, 0.2], [0.7, -0.4]]])
    for places, arc in zip(course_places(start, arcs), arcs, strict=True):
        ends = np.cumsum(arc[:, 0])
        way, step = np.linspace(0.0, ends[-1], 20001, retstep=True)
        middle = way[:-1] + 0.5 * step
        turned = step * np.cumsum(arc[np.searchsorted(ends, middle), 1])
        heading = start[2] + turned - 0.5 * step * arc[np.searchsorted(ends, middle), 1]
        x, y = (np.append(0.0, step * np.cumsum(of(heading))) for of in (np.cos, np.sin))
        at = np.linspace(0.0, ends[-1], PLACES)
        expected = np.column_stack([start[0] + np.interp(at, way, x), start[1] + np.interp(at, way, y)])
        assert places == pytest.approx(expected, abs=1e-3)


def test_it_says_why_there_are_no_more_drives() -> None:
    """Of a rover of one length in a lane as wide as it is, that cannot turn there."""
    lane = np.where(np.abs(Y)[:, None] > 1.3, 1.0, 0.0) + 0.0 * X
    found = candidate_plans(seen(lane), YUTU2, START, (10.0, 0.0), most=40)
    assert 0 < len(found.plans) < 40
    assert "'turn +180° back'; " in found.why_no_more
    assert f"{found.alike} ways left out" in found.why_no_more


def test_manners_are_those_that_the_place_of_the_target_asks_for() -> None:
    surface = seen(blocks())
    behind = candidate_plans(surface, YUTU2, (6.0, 0.0, 0.0), (2.0, 0.0), most=10).plans
    assert behind[0].legs[0].crab_deg == 180.0 and behind[0].length_m == pytest.approx(4.0)
    beside = candidate_plans(surface, YUTU2, START, (3.0, 4.0), most=10).plans
    turned = [plan for plan in beside if plan.legs[0].turn_deg]
    assert {round(plan.legs[0].turn_deg) for plan in turned} == {53, -127}
    assert min(plan.length_m for plan in turned) == pytest.approx(5.0)


def test_crab_is_small_where_wheels_would_be_dragged_and_wide_where_all_steer() -> None:
    most = {}
    for rover in ("yutu2", "small-four"):
        plans = candidate_plans(seen(blocks(), rover), build_rover(rover), START, (4.0, 3.0), most=30).plans
        crabs = {abs(leg.crab_deg) for plan in plans for leg in plan.legs if leg.length_m} - {0.0, 180.0}
        most[rover] = max(crabs)
    assert most["yutu2"] == 5.0
    steered = build_rover("small-four").steered_mask.all()
    assert most["small-four"] == pytest.approx(math.degrees(math.atan2(3.0, 4.0)), abs=0.1) if steered else 5.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_manners_on_the_left_are_those_on_the_right(side: float) -> None:
    """A target 40 deg to the side, from a rover that heads 20 deg: crab and turn go to it, or to its opposite."""
    rover = build_rover("small-four")
    assert rover.steered_mask.all()
    heading = math.radians(20.0)
    at = heading + side * math.radians(40.0)
    goal = np.array([1.0 + 5.0 * math.cos(at), 2.0 + 5.0 * math.sin(at), 0.0])
    found = [(one.turn_deg, one.crab_deg) for one in manners(rover, np.array([1.0, 2.0, heading]), goal)]
    assert found == [(0.0, 0.0), (0.0, 180.0), (0.0, 40.0 * side), (40.0 * side, 0.0), (-140.0 * side, 180.0)]


def test_localisation_updates_cut_the_way_into_shorter_legs_of_the_same_course() -> None:
    surface, fixes = seen(blocks()), Fixes(0.05, 0.5)
    plans = candidate_plans(surface, YUTU2, START, (10.0, 0.0), fixes=fixes, most=12).plans
    free, halting = ([plan for plan in plans if (plan.fixes is None) == none] for none in (True, False))
    assert free and halting and len(plans) == 12
    straight = [plan for plan in halting if all(leg.curvature_per_m == 0 and leg.crab_deg == 0 for leg in plan.legs)]
    assert [len(plan.legs) for plan in straight] == [2, 4]
    for plan in halting:
        assert plan.fixes == fixes and max(leg.length_m for leg in plan.legs) < 1.25 * 5.0 + 1e-9


def test_a_wall_without_a_gap_is_said_to_be_in_the_way() -> None:
    wall = np.zeros((Y.size, X.size))
    wall[:, np.abs(X - 5.0) < 0.16] = 1.0
    with pytest.raises(ParameterError, match="no path within the limits was found"):
        candidate_plans(seen(wall), YUTU2, START, (10.0, 0.0))


def test_poses_of_a_plan_with_a_turn_are_those_of_its_legs() -> None:
    plan = Plan(name="test", legs=(Leg(2.0), Leg(turn_deg=90.0), Leg(3.0, crab_deg=180.0)), speed_m_s=0.05)
    poses = poses_along(plan, 0.1)
    end = np.array([0.0, 0.0, 0.0])
    for leg in plan.legs:
        end = leg_end(end, leg)
    assert poses[-1] == pytest.approx(end) and poses[-1] == pytest.approx([2.0, -3.0, math.pi / 2])
    assert planned_pose(plan, plan.length_m) == pytest.approx(end)
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() <= 0.1 + 1e-9
