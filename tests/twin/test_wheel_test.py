"""One wheel that slips on purpose: its commands, and how it then slips."""

from dataclasses import replace

import numpy as np
import pytest
import quasi_static

from lunarsci.errors import DataError, ParameterError
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.soil import Soil
from lunarsci.twin.plans.path import all_commands, commanded_ratios, make_schedule, run_commands
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, WheelTest, check_plan, parse_plan, plan_text
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict

FASTER, SLOWER = WheelTest("ML", 1.3), WheelTest("FR", 0.7)
SLIP = STATE_COLUMNS.index("slip_ratio")


def plan_of(*legs: Leg) -> Plan:
    return Plan(name="test", legs=legs, speed_m_s=0.05)


TESTED = plan_of(Leg(1.0, 0.1, wheel_test=FASTER), Leg(1.0, 0.1), Leg(1.0, 0.1, wheel_test=SLOWER))


def test_one_wheel_turns_at_another_rate_and_the_others_as_before(yutu2: Rover) -> None:
    """Over to it within the blend of 0.2 m, without a halt, and in no more time."""
    plain = plan_of(*(replace(leg, wheel_test=None) for leg in TESTED.legs))
    schedule = make_schedule(TESTED, yutu2)
    assert len(schedule.runs) == 1 and schedule.duration_s == make_schedule(plain, yutu2).duration_s
    times = np.linspace(0.0, schedule.duration_s, 601)
    tested, usual = (all_commands(yutu2, make_schedule(plan, yutu2), times) for plan in (TESTED, plain))
    assert np.array_equal(tested.steering_rad, usual.steering_rad)
    ratios = (tested.speed_m_s / usual.speed_m_s)[0]
    way = schedule.distance_at(times[1:])
    expected = np.ones(ratios.shape)
    expected[:, yutu2.wheels.index("ML")] = np.interp(way, [0.9, 1.1], [1.3, 1.0])
    expected[:, yutu2.wheels.index("FR")] = np.interp(way, [1.9, 2.1], [1.0, 0.7])
    assert ratios == pytest.approx(expected, abs=1e-9)
    assert commanded_ratios(yutu2, schedule, times[1:]) == pytest.approx(expected, abs=1e-9)


def test_legs_that_are_steered_anew_keep_their_test(yutu2: Rover) -> None:
    """After a position fix each rover has an arc of its own."""
    schedule = make_schedule(replace(TESTED, fixes=Fixes(0.01, 0.1)), yutu2)
    run = schedule.runs[2]
    times = np.linspace(run.begin_s + run.steer_s, run.end_s, 50)
    own = np.array([[1.0, 0.1, 0.0], [0.9, 0.3, 0.0]])
    tested = run_commands(yutu2, schedule, 2, times, None, own).speed_m_s
    plain = replace(schedule.plan, legs=tuple(replace(leg, wheel_test=None) for leg in TESTED.legs))
    usual = run_commands(yutu2, make_schedule(plain, yutu2), 2, times, None, own).speed_m_s
    expected = [0.7 if wheel == "FR" else 1.0 for wheel in yutu2.wheels]
    assert tested / usual == pytest.approx(np.broadcast_to(expected, tested.shape))


def test_the_wheel_slips_by_what_it_is_told_beyond_the_others(yutu2: Rover, slope, longji_soil: Soil) -> None:  # type: ignore[no-untyped-def]
    """Straight on the level all wheels go v; so 1 - s is v over the rim's speed, by ratio, in either physics."""
    plan = plan_of(Leg(1.0, wheel_test=FASTER))
    twin = predict(yutu2, slope(), plan)
    values = {name: float(getattr(longji_soil, name)) for name in PARAMETERS}
    other = quasi_static.drive(yutu2, slope(), plan, values, quasi_static.PAPER, sample_m=0.25)
    assert twin.finished.all() and other.finished
    own = yutu2.wheels.index("ML")
    for slip in (twin.states[0, 3:, :, SLIP], other.states[1:, :, SLIP]):
        others = np.delete(slip, own, axis=1)
        v = 1.0 - others[:, [0, 2, 3]].mean()
        assert slip[:, own].mean() == pytest.approx(1.0 - v / 1.3, abs=0.03) and slip[:, own].mean() > 0.2
        # Pushed by the wheel that pulls, the others slip less than on the level without it, where drag asks for some.
        assert others.mean() < 0.05


def test_plans_with_tests_are_written_and_read_back() -> None:
    assert parse_plan(plan_text(TESTED), "t.toml").legs == TESTED.legs


WRONG = {
    'wheel = "FL", rate_ratio = -1': "0.2 to 3",
    'wheel = "FL", rate_ratio = "x"': "give a number",
    'wheel = "FL"': "has no rate_ratio",
    "rate_ratio = 0.5": "has no wheel",
    'wheel = "FL", rate = 0.5': "not a key",
}


@pytest.mark.parametrize("table", WRONG)
def test_wrong_tests_are_refused_with_the_leg(table: str) -> None:
    text = f"[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1\nwheel_test = {{ {table} }}\n"
    with pytest.raises(DataError, match=f"leg 1: .*{WRONG[table]}"):
        parse_plan(text, "t.toml")


def test_tests_that_the_rover_cannot_do_are_refused(yutu2: Rover) -> None:
    with pytest.raises(ParameterError, match=r"leg 1: wheel_test wheel is '3'.*FL, FR, ML"):
        check_plan(plan_of(Leg(1.0, wheel_test=WheelTest("3", 0.5))), yutu2)
    with pytest.raises(ParameterError, match=r"reach 0\.11"):
        check_plan(plan_of(Leg(1.0, wheel_test=WheelTest("FL", 3.0))), yutu2)
    with pytest.raises(ParameterError, match="FL, FR, RL, RR"):
        check_plan(plan_of(Leg(1.0, wheel_test=WheelTest("ML", 0.5))), build_rover("small-four"))
    with pytest.raises(ParameterError, match="belong to a leg with length_m"):
        Leg(turn_deg=90.0, wheel_test=FASTER)
