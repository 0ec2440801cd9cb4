"""Drives that try the ground on purpose: a turn on the spot and back before the way, or one wheel that slips on it."""

from dataclasses import replace

from lunarsci.errors import ParameterError
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.plans.wheel_test import WheelTest, check_wheel_test
from lunarsci.twin.routes.planner import RouteSearch
from lunarsci.twin.rover import Rover

TURN_DEG = 90.0
"""Turned on the spot, and back; assumed."""
RATE_RATIOS = (1.25, 0.7)
"""Of the wheel that slips: near a slip ratio of 0.2 and of -0.3, within what limits of slip allow; assumed."""
TEST_M = 1.0
"""Way with such a wheel, where the first arc is as long; assumed."""


def with_tests(
    plans: tuple[Plan, ...], surface: Traversability, rover: Rover, target: tuple[float, float], most: int
) -> tuple[Plan, ...]:
    """Plans to a target, at most so many, the last of them the shortest that begins with an arc, with tests before it.

    Tests are left out where they would leave no room for other plans. Raises ParameterError as `RouteSearch.of` does.
    """
    shortest = min(plans, key=lambda plan: (plan.legs[0].length_m == 0, plan.length_m))
    tests = soil_tests(shortest, RouteSearch.of(surface, rover, _start(shortest), target, None))
    return plans[:most] if len(tests) >= most else (*plans[: most - len(tests)], *tests)


def soil_tests(plan: Plan, search: RouteSearch) -> tuple[Plan, ...]:
    """The plan with a test of the ground at its begin: those for which there is room, and that the wheels can do.

    They end where the plan does. A plan that begins with no arc is tested by the turn alone.
    """
    rover, found = search.rover, [_turned(plan)] if _room_to_turn(plan, search) else []
    first = plan.legs[0]
    for ratio in RATE_RATIOS if first.length_m and first.wheel_test is None else ():
        test = WheelTest(rover.wheels[0], ratio)
        try:
            check_wheel_test(test, plan.speed_m_s, rover, "")
        except ParameterError:
            continue
        found.append(_slipping(plan, test))
    return tuple(found)


def _turned(plan: Plan) -> Plan:
    legs = (Leg(turn_deg=TURN_DEG), Leg(turn_deg=-TURN_DEG), *plan.legs)
    return replace(plan, name=f"test: turn {TURN_DEG:g}° and back", legs=legs)


def _slipping(plan: Plan, test: WheelTest) -> Plan:
    first, *rest = plan.legs
    length = min(TEST_M, first.length_m)
    tested = [replace(first, length_m=length, wheel_test=test)]
    if first.length_m > length:
        tested.append(replace(first, length_m=first.length_m - length))
    return replace(plan, name=f"test: wheel {test.wheel} at {test.rate_ratio:g}", legs=(*tested, *rest))


def _start(plan: Plan) -> tuple[float, float, float]:
    return plan.x_m, plan.y_m, plan.heading_deg


def _room_to_turn(plan: Plan, search: RouteSearch) -> bool:
    poses = poses_along(replace(plan, legs=(Leg(turn_deg=TURN_DEG),)), 1.0)
    return bool(search.clear_m(poses)[0] >= search.surface.mobility.hazard_distance_m)
