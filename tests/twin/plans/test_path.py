"""Legs in time, and the commands that make wheels roll without scrubbing.

One wheel that slips on purpose: its commands, and how it then slips.
"""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
import quasi_static

from lunarsci.errors import DataError, ParameterError
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.soil import Soil
from lunarsci.twin.lanes import BODY, new_work
from lunarsci.twin.plans.path import (
    CREEP,
    EASE_S,
    STEERING_RAD_S,
    _poses,
    all_commands,
    commanded_ratios,
    make_schedule,
    run_commands,
    start_motion,
    wheel_commands,
)
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, WheelTest, check_plan, parse_plan, plan_text
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict


def plan_of(*legs: Leg, **changes: object) -> Plan:
    return Plan(name="test", legs=legs, **({"speed_m_s": 0.05} | changes))  # type: ignore[arg-type]


MOTIONS = {
    "arc": (1.0, 0.0, 0.154),
    "right": (1.0, 0.0, -0.5),
    "straight": (1.0, 0.0, 1e-9),
    "back": (-1.0, 0.0, 0.2),
    "spot turn": (0.0, 0.0, 1.4),
    "spot turn to the right": (0.0, 0.0, -1.4),
}


@pytest.mark.parametrize("offset", [0.0, 0.06])
@pytest.mark.parametrize("motion", MOTIONS)
def test_steered_wheels_roll_without_scrubbing(yutu2: Rover, motion: str, offset: float) -> None:
    """Each wheel centre moves as a point of a rigid body: velocity = speed (ahead - turn y, left + turn x)."""
    rover = dataclasses.replace(yutu2, steering_offset_m=offset)
    ahead, left, turn = MOTIONS[motion]
    commands = wheel_commands(rover, ahead, left, turn, 0.05)
    angle = commands.steering_rad
    inward = np.where(rover.steered_mask, offset, 0.0) * [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]
    x = rover.wheel_positions_m[:, 0] - inward * np.sin(angle)
    y = rover.wheel_positions_m[:, 1] + inward * (np.cos(angle) - 1.0)
    velocity = 0.05 * np.column_stack([ahead - turn * y, left + turn * x])
    heading = np.column_stack([np.cos(angle), np.sin(angle)])
    assert velocity == pytest.approx(commands.speed_m_s[:, None] * heading, abs=1e-12)
    assert np.abs(angle).max() <= 0.5 * math.pi


def test_a_four_wheeler_can_crab() -> None:
    commands = wheel_commands(build_rover("small-four"), math.cos(0.6), math.sin(0.6), 0.0, 0.04)
    assert commands.steering_rad == pytest.approx(np.full(4, 0.6))
    assert commands.speed_m_s == pytest.approx(np.full(4, 0.04))


def test_arcs_of_one_direction_are_driven_without_a_halt(yutu2: Rover) -> None:
    schedule = make_schedule(plan_of(Leg(1.0, 0.1), Leg(2.0, -0.1)), yutu2)
    assert len(schedule.runs) == 1 and schedule.duration_s == pytest.approx(60.0)
    assert schedule.distance_at([0.0, 30.0, 60.0]) == pytest.approx([0.0, 1.5, 3.0])


def test_a_leg_that_makes_up_for_slip_takes_longer_to_the_same_end(yutu2: Rover) -> None:
    plain = plan_of(Leg(1.0, 0.1), Leg(2.0, -0.1))
    made_up = plan_of(Leg(1.0, 0.1, slip_ratio=0.5), Leg(2.0, -0.1))
    schedule = make_schedule(made_up, yutu2)
    assert schedule.duration_s == pytest.approx(80.0) and made_up.commanded_m == pytest.approx(4.0)
    assert schedule.distance_at([20.0, 40.0, 60.0]) == pytest.approx([0.5, 1.0, 2.0])
    assert schedule.pose_at(80.0) == pytest.approx(make_schedule(plain, yutu2).pose_at(60.0))
    rolled = all_commands(yutu2, schedule, np.linspace(0.0, 80.0, 801)).speed_m_s.mean()
    assert rolled == pytest.approx(0.05, rel=0.01)
    assert parse_plan(plan_text(made_up), "made_up").legs == made_up.legs
    with pytest.raises(ParameterError, match="slip_ratio"):
        Leg(turn_deg=90.0, slip_ratio=0.2)


MIXED = (Leg(1.0, 0.1), Leg(turn_deg=90.0), Leg(0.5), Leg(stop_s=20.0), Leg(0.5, 0.0, 180.0))


def test_a_drive_with_halts_covers_its_legs_and_nothing_else(yutu2: Rover) -> None:
    schedule = make_schedule(plan_of(*MIXED), yutu2)
    assert [run.moves for run in schedule.runs] == [True, True, True, False, True]
    distance = schedule.distance_at([run.end_s for run in schedule.runs])
    assert distance == pytest.approx([1.0, 1.0, 1.5, 1.5, 2.0], abs=1e-12)
    time = np.linspace(0.0, schedule.duration_s, 20001)
    rate = np.diff(schedule.distance_at(time)) / time[1]
    assert rate.max() < 0.05 * (1 + 1e-9) and rate.min() >= 0.0
    # The turn takes the farthest wheel along a quarter circle of 0.673 m at 0.05 m/s; then the ramps of its two halts.
    quarter = 0.5 * math.pi * math.hypot(0.5, 0.45) / 0.05
    assert schedule.runs[1].cruise_s == pytest.approx(quarter - 2 * EASE_S * (1 - CREEP))
    # The pace is the rate of what is done, and nothing at the stop.
    middle = 0.5 * (time[1:] + time[:-1])
    turning = (middle > schedule.runs[1].begin_s) & (middle < schedule.runs[1].end_s)
    assert rate[~turning] / 0.05 == pytest.approx(schedule.pace_at(middle)[~turning], abs=0.02)
    assert schedule.pace_at(schedule.runs[3].begin_s + 10.0) == 0.0
    x, y, heading = schedule.pose_at(schedule.duration_s)
    # Backwards takes back what the last straight leg gained.
    assert (x, y) == pytest.approx((math.sin(0.1) / 0.1, (1 - math.cos(0.1)) / 0.1))
    assert heading == pytest.approx(0.1 + 0.5 * math.pi)


def test_commanded_speeds_add_up_to_the_leg_at_any_step(yutu2: Rover) -> None:
    schedule = make_schedule(plan_of(*MIXED), yutu2)
    run = schedule.runs[2]
    for steps in (40, 171):
        times = np.linspace(run.begin_s, run.end_s, steps + 1)
        before = run_commands(yutu2, schedule, 1, np.linspace(schedule.runs[1].begin_s, run.begin_s, 99), None, None)
        commands = run_commands(yutu2, schedule, 2, times, before, None)
        driven = float(commands.speed_m_s[0, :, 2].sum() * (times[1] - times[0]))
        assert driven == pytest.approx(0.5, abs=2 * CREEP * 0.05 * (run.steer_s + 1.0))
        assert commands.steering_rad[0, 0] == pytest.approx(before.steering_rad[0, -1], abs=0.2)
        assert commands.steering_rad[0, -1] == pytest.approx(np.zeros(6))


def grip(soil):  # type: ignore[no-untyped-def]
    """Firm ground, on which wheels without lugs hardly slip."""
    return soil.replace(
        stiffness_kpa_m_n=1e4, shear_modulus_mm=1.0, lateral_modulus_mm=1.0, external_friction_angle_deg=42.0
    )


def smooth(rover: Rover) -> Rover:
    """Without lugs."""
    return dataclasses.replace(rover, wheel=dataclasses.replace(rover.wheel, grouser_height_m=0.0))


def test_the_rover_turns_on_the_spot_stops_and_drives_back(yutu2: Rover, longji_soil, slope) -> None:  # type: ignore[no-untyped-def]
    rover = smooth(yutu2)
    result = predict(rover, slope(soil=grip(longji_soil)), plan_of(*MIXED), sweep=())
    assert result.outcome_text(0) == "finished"
    planned = result.planned[-1]
    assert result.endpoints_m[0] == pytest.approx(planned[:2], abs=0.02)
    assert result.paths[0, -1, 5] == pytest.approx(math.degrees(planned[2]), abs=2.0)
    # It stands while it stops.
    schedule = make_schedule(result.plan, rover)
    still = (result.time_s > schedule.runs[3].begin_s) & (result.time_s < schedule.runs[3].end_s)
    assert np.ptp(result.paths[0, still, :2], axis=0).max() < 1.5e-3
    assert np.ptp(result.paths[0, still, 5]) < 0.1


def test_a_four_wheeler_crabs_and_keeps_its_heading(longji_soil, slope) -> None:  # type: ignore[no-untyped-def]
    rover = smooth(build_rover("small-four"))
    plan = plan_of(Leg(1.5, 0.0, 40.0), speed_m_s=0.04)
    result = predict(rover, slope(soil=grip(longji_soil)), plan, sweep=())
    assert result.endpoints_m[0] == pytest.approx(1.5 * np.array([np.cos(0.698132), np.sin(0.698132)]), abs=0.02)
    assert abs(result.paths[0, -1, 5]) < 1.0


def test_a_rover_whose_middle_wheels_do_not_steer_drags_them_when_it_crabs(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(), plan_of(Leg(1.0, 0.0, 30.0)), sweep=())
    side = np.abs(result.states[0, -1, :, STATE_COLUMNS.index("side_slip_deg")])
    assert side[2:4].min() > 15.0 > 8.0 > side[[0, 1, 4, 5]].max()


def test_a_halt_on_a_slope_holds(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(-0.1, 0.05), plan_of(Leg(0.5), Leg(stop_s=60.0)), sweep=())
    schedule = make_schedule(result.plan, yutu2)
    still = result.time_s > schedule.runs[1].begin_s + 2.0
    assert np.ptp(result.paths[0, still, :2], axis=0).max() < 0.01
    assert np.isfinite(result.states).all()


def test_position_fixes_take_the_rover_back_to_its_plan(yutu2: Rover, longji_soil, slope) -> None:  # type: ignore[no-untyped-def]
    """A side slope pushes the open loop off; with exact fixes only the last leg's part of the push remains."""
    legs = (Leg(2.0), Leg(2.0), Leg(2.0), Leg(1.0))
    ground = slope(0.0, 0.05)
    soils = {"sweep": (), "time_step_s": 0.2}
    open_loop = predict(yutu2, ground, plan_of(*legs), **soils)
    fixed = predict(yutu2, ground, plan_of(*legs, fixes=Fixes(0.0, 0.0)), **soils)
    assert fixed.outcome_text(0) == "finished"
    assert fixed.miss_m[0] < 0.35 * open_loop.miss_m[0]


def test_errors_of_the_fixes_scatter_the_ends_and_follow_the_seed(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    from lunarsci.twin.plans.plan import Sweep

    plan = plan_of(Leg(1.0), Leg(2.0), fixes=Fixes(0.1, 0.0), speed_m_s=0.055)
    sweep = (Sweep("cohesion_pa", 520.0, 520.001, 33),)
    one, two, other = (predict(yutu2, slope(), plan, sweep=sweep, seed=s, time_step_s=0.2) for s in (3, 3, 4))
    assert np.array_equal(one.paths, two.paths) and not np.array_equal(one.paths, other.paths)
    # A fix that is off by e puts the end off by -e, whatever the direction; 33 of them, each of sigma 0.1 m.
    off = one.endpoints_m - one.endpoints_m.mean(axis=0)
    assert off[:, 0].std() == pytest.approx(0.1, rel=0.35) and off[:, 1].std() == pytest.approx(0.1, rel=0.35)


def test_halts_for_fixes_take_the_time_they_are_given(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """Two halts of 30 s more: the drive is that much longer, stands meanwhile, and else is what it was."""
    plans = [plan_of(Leg(1.0), Leg(1.0), Leg(1.0), fixes=Fixes(0.0, 0.0, halt_s=halt)) for halt in (0.0, 30.0)]
    quick, slow = (make_schedule(plan, yutu2) for plan in plans)
    assert slow.duration_s == pytest.approx(quick.duration_s + 60.0)
    ground = slope(0.0, 0.05)
    short, long = (predict(yutu2, ground, plan, sweep=(), time_step_s=0.1) for plan in plans)
    assert long.endpoints_m[0] == pytest.approx(short.endpoints_m[0], abs=0.005)
    first = slow.runs[1]
    still = (long.time_s > first.begin_s - 28.0) & (long.time_s < first.begin_s - 1.0)
    assert still.sum() > 10 and long.halted[still].all()
    assert np.ptp(long.paths[0, still, :2], axis=0).max() < 0.003


def test_after_a_stop_at_the_start_the_wheels_take_their_time_to_steer(yutu2: Rover) -> None:
    schedule = make_schedule(plan_of(Leg(stop_s=5.0), Leg(turn_deg=90.0)), yutu2)
    times = np.linspace(0.0, schedule.duration_s, 4001)
    angle = all_commands(yutu2, schedule, times).steering_rad[0]
    assert np.abs(angle[-1]).max() > 0.5
    assert (np.abs(angle).max(axis=1) <= 1.0001 * STEERING_RAD_S * np.maximum(times[1:] - 5.0, 0.0)).all()


def test_a_drive_begins_with_the_wheels_that_do_not_steer_rolling_straight_on(yutu2: Rover) -> None:
    """The turning centre lies beside the middle wheels, here 0.1 m behind the origin: v_y = turn x there must be 0."""
    rover = dataclasses.replace(yutu2, middle_wheel_m=(0.15, 0.0, -0.08))
    ahead, left, turn = start_motion(make_schedule(plan_of(Leg(2.0, 0.4)), rover), rover)
    middle = rover.wheel_positions_m[2, 0]
    assert middle == pytest.approx(-0.1) and turn == pytest.approx(0.4 * 0.05)
    assert (ahead, left + turn * middle) == pytest.approx((0.05, 0.0), abs=1e-15)


@pytest.mark.parametrize("heading", [0.5, 2.0, -2.5])
def test_a_heading_is_that_of_the_quaternion(heading: float) -> None:
    """A turn by an angle about the vertical is (cos(h / 2), 0, 0, sin(h / 2))."""
    work = new_work(6)
    w, i, j, k = BODY.view(work.body, "quaternion")
    w[:], i[:], j[:], k[:] = math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)
    assert _poses(work)[:, 2] == pytest.approx(heading)


FASTER, SLOWER = WheelTest("ML", 1.3), WheelTest("FR", 0.7)
SLIP = STATE_COLUMNS.index("slip_ratio")


def plan_with_test(*legs: Leg) -> Plan:
    return Plan(name="test", legs=legs, speed_m_s=0.05)


TESTED = plan_with_test(Leg(1.0, 0.1, wheel_test=FASTER), Leg(1.0, 0.1), Leg(1.0, 0.1, wheel_test=SLOWER))


def test_one_wheel_turns_at_another_rate_and_the_others_as_before(yutu2: Rover) -> None:
    """Over to it within the blend of 0.2 m, without a halt, and in no more time."""
    plain = plan_with_test(*(replace(leg, wheel_test=None) for leg in TESTED.legs))
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
    plan = plan_with_test(Leg(1.0, wheel_test=FASTER))
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
    'wheel = "FL", rate_ratio = -1': "a number above 0",
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
        check_plan(plan_with_test(Leg(1.0, wheel_test=WheelTest("3", 0.5))), yutu2)
    with pytest.raises(ParameterError, match=r"reach 0\.11"):
        check_plan(plan_with_test(Leg(1.0, wheel_test=WheelTest("FL", 3.0))), yutu2)
    with pytest.raises(ParameterError, match="FL, FR, RL, RR"):
        check_plan(plan_with_test(Leg(1.0, wheel_test=WheelTest("ML", 0.5))), build_rover("small-four"))
    with pytest.raises(ParameterError, match="belong to a leg with length_m"):
        Leg(turn_deg=90.0, wheel_test=FASTER)
