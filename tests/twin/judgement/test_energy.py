"""Work of the wheels' motors beside what lifting, rolling and turning need.

Electrical power, panels, shadow and battery beside sums done by hand.
"""

import dataclasses
import math

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.illumination import SunDirection
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.judgement.choice import verdicts
from lunarsci.twin.judgement.designs import mission_outcome
from lunarsci.twin.judgement.energy import energy_record, energy_use, power_record, power_use
from lunarsci.twin.judgement.keeping import extremes, keeps_limits, limited, limits_judged
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.plan import Leg, Limit, Plan, check_plan, parse_sweep
from lunarsci.twin.rover import Motors, PowerSupply, Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, PowerState, Prediction, predict

WEIGHT = 135.0 * 1.622
SPEED = 0.05


def way_m(drive: Prediction) -> float:
    return float(np.linalg.norm(np.diff(drive.paths[0, :, :3], axis=0), axis=1).sum())


@pytest.mark.parametrize("gradient", [0.05, 0.1, 0.2])
def test_a_climb_takes_at_least_the_energy_of_its_height(yutu2: Rover, slope, straight, gradient: float) -> None:  # type: ignore[no-untyped-def]
    """Energy is conserved: what lifts the rover comes from the motors, with what soil and slip take."""
    drive = predict(yutu2, slope(gradient), straight(4.0), sweep=())
    lifted = WEIGHT * (drive.paths[0, -1, 2] - drive.paths[0, 0, 2])
    level = energy_use(predict(yutu2, slope(), straight(4.0), sweep=())).total_j[0]
    work = energy_use(drive).total_j[0]
    assert lifted > 30.0
    assert work > lifted
    # Rolling on the level for the same way, and slip, which is less than 0.4 of the work here, are the rest.
    assert lifted + 0.5 * level < work < (lifted + level) / 0.6


def test_on_the_level_work_is_torque_times_the_angle_turned(yutu2: Rover, longji_soil, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """The torque by the wheel formulas alone, at the sinkage and slip of a steady drive; the rate as commanded."""
    drive = predict(yutu2, slope(), straight(5.0), sweep=())
    state = dict(zip(STATE_COLUMNS, drive.states[0, -1].T, strict=True))
    forces = closed_form_forces(
        yutu2.wheel, longji_soil, state["sinkage_m"], state["slip_ratio"], state["side_slip_deg"]
    )
    angle = 5.0 / yutu2.wheel.shearing_radius_m
    assert energy_use(drive).wheel_work_j[0] == pytest.approx(forces.resistance_torque_nm * angle, rel=0.02)
    assert energy_use(drive).duration_s[0] == pytest.approx(5.0 / SPEED)


def test_work_is_what_the_rover_pulls_and_what_slip_and_soil_take(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """Motors give at least the tractive power that the wheels pass on to the rover, drawbar pull times way."""
    drive = predict(yutu2, slope(0.15), straight(4.0), sweep=())
    pull = drive.states[0, :, :, STATE_COLUMNS.index("drawbar_pull_n")].sum(axis=1)
    tractive = float(np.trapezoid(pull, np.linspace(0.0, way_m(drive), len(pull))))
    work = energy_use(drive).total_j[0]
    assert 0.4 < tractive / work < 1.0


def test_downhill_beyond_the_rolling_resistance_motors_do_nothing_and_give_nothing_back(  # type: ignore[no-untyped-def]
    yutu2: Rover, slope, straight
) -> None:
    up, down = (energy_use(predict(yutu2, slope(tilt), straight(3.0), sweep=())).total_j[0] for tilt in (0.2, -0.2))
    assert 0.0 <= down < 0.02 * up


def test_spot_turns_take_work_and_stops_take_time_alone(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    def of(*legs: Leg) -> tuple[float, float]:
        use = energy_use(predict(yutu2, slope(), Plan(name="t", legs=legs, speed_m_s=SPEED), sweep=()))
        return float(use.total_j[0]), float(use.duration_s[0])

    turn, twice = of(Leg(turn_deg=45.0)), of(Leg(turn_deg=90.0))
    assert turn[0] > 1.0 and twice[0] == pytest.approx(2.0 * turn[0], rel=0.15)
    way, stopped = of(Leg(length_m=2.0)), of(Leg(length_m=1.0), Leg(stop_s=100.0), Leg(length_m=1.0))
    assert stopped[0] == pytest.approx(way[0], rel=0.1)
    assert stopped[1] > way[1] + 100.0


def test_a_drive_that_ended_early_counts_up_to_its_end(driven: Prediction) -> None:
    """11 samples of 2 s each; the rows after the last one reached repeat it."""
    recorded = driven.recorded.copy()
    recorded[3], recorded[4] = 6, 0
    short = energy_use(dataclasses.replace(driven, recorded=recorded))
    whole = energy_use(driven)
    assert short.duration_s[3] == pytest.approx(10.0) and short.duration_s[4] == 0.0
    assert short.total_j[4] == 0.0 and short.total_j[3] / whole.total_j[3] == pytest.approx(0.5, abs=0.05)
    assert (np.delete(short.total_j, (3, 4)) == np.delete(whole.total_j, (3, 4))).all()


def test_the_record_counts_drives_that_reach_the_end(driven: Prediction) -> None:
    work = np.sort(energy_use(driven).total_j)
    record = energy_record(driven)
    assert record is not None
    assert (record["p50_j"], record["p95_j"]) == (pytest.approx(np.median(work)), work[18])
    assert math.fsum(one["p50_j"] for one in record["wheels"].values()) == pytest.approx(record["p50_j"], rel=0.05)
    outcome = driven.outcome.copy()
    outcome[:] = 2
    assert energy_record(dataclasses.replace(driven, outcome=outcome)) is None


MOTORS = Motors(stall_torque_nm=20.0, continuous_torque_nm=8.0, no_load_rate_rad_s=1.0, efficiency=0.5, idle_w=0.0)
SUPPLY = PowerSupply(battery_wh=1.0, electronics_w=36.0, panel_area_m2=1.0, cell_efficiency=0.25)


def equipped(drive: Prediction, motors: Motors = MOTORS, power: PowerSupply = SUPPLY) -> Prediction:
    return dataclasses.replace(drive, rover=dataclasses.replace(drive.rover, motors=motors, power=power))


def lit_by(drive: Prediction, sun: SunDirection | None, charge: float | np.ndarray = 1.0) -> Prediction:
    return dataclasses.replace(drive, power=PowerState(charge=charge, sun=sun))


def posed(drive: Prediction, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Prediction:
    paths = drive.paths.copy()
    paths[..., 3:] = roll, pitch, yaw
    return dataclasses.replace(drive, paths=paths)


def test_motors_draw_their_work_over_their_efficiency_and_idle_while_they_turn(driven: Prediction) -> None:
    """A drive of 1 m in 20 s: work of the wheels, 36 W of electronics, 2 W for each of six motors."""
    work = energy_use(driven).total_j
    use = power_use(equipped(driven))
    assert use.drawn_wh * 3600.0 == pytest.approx(work / 0.5 + 36.0 * 20.0, rel=1e-9)
    idle = power_use(equipped(driven, dataclasses.replace(MOTORS, idle_w=2.0)))
    assert (idle.drawn_wh - use.drawn_wh) * 3600.0 == pytest.approx(np.full(20, 6 * 2.0 * 20.0), rel=1e-9)
    assert (use.panels_w == 0).all() and use.lit is None


def test_twice_the_draw_empties_the_battery_in_half_the_time(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    drive = predict(yutu2, slope(), straight(6.0), sweep=())
    strong = dataclasses.replace(MOTORS, efficiency=1.0)

    def empty_s(watts: float) -> float:
        supply = dataclasses.replace(SUPPLY, electronics_w=watts)
        # Nothing but electronics draws, so that the draw is constant.
        states = np.zeros_like(drive.states)
        use = power_use(equipped(dataclasses.replace(drive, states=states), strong, supply))
        left = use.battery_wh[0]
        assert (np.diff(left) <= 0).all() and left[-1] == 0.0
        last = int(np.argmax(left <= 0)) - 1
        rate = (left[last - 1] - left[last]) / (use.time_s[last] - use.time_s[last - 1])
        return float(use.time_s[last] + left[last] / rate)

    # 1 Wh at 60 W is a minute.
    assert empty_s(60.0) == pytest.approx(60.0, rel=1e-6)
    assert empty_s(120.0) == pytest.approx(30.0, rel=1e-6)


@pytest.mark.parametrize(
    ("attitude", "sun", "cosine"),
    [
        ((0.0, 0.0, 0.0), (77.0, 90.0), 1.0),
        ((0.0, 0.0, 50.0), (10.0, 30.0), 0.5),
        # Nose down by 20 deg towards a Sun ahead, 20 deg high: 40 deg over the panel. And away from it: 0 deg.
        ((0.0, 20.0, 0.0), (0.0, 20.0), math.sin(math.radians(40.0))),
        ((0.0, 20.0, 180.0), (0.0, 20.0), 0.0),
        ((0.0, 20.0, 90.0), (90.0, 20.0), math.sin(math.radians(40.0))),
        # Rolled to the right by 15 deg, the Sun on the right, at 30 deg; heading 90 deg has the right at azimuth 0.
        ((15.0, 0.0, 0.0), (-90.0, 30.0), math.sin(math.radians(45.0))),
        ((15.0, 0.0, 90.0), (0.0, 30.0), math.sin(math.radians(45.0))),
        ((0.0, 0.0, 0.0), (0.0, -5.0), 0.0),
    ],
)
def test_panels_give_by_the_angle_of_the_sun_from_their_normal(driven: Prediction, attitude, sun, cosine) -> None:  # type: ignore[no-untyped-def]
    use = power_use(lit_by(posed(equipped(driven), *attitude), SunDirection(*sun)))
    assert use.panels_w == pytest.approx(np.full((20, 10), 1360.8 * 1.0 * 0.25 * cosine), abs=1e-9)


def test_the_shadow_of_a_ridge_turns_the_panels_off_and_the_battery_does_not_overflow(  # type: ignore[no-untyped-def]
    yutu2: Rover, longji_soil: Soil, straight
) -> None:
    """A ridge 1 m high at x = -3 m; the Sun behind it, 20 deg high: shadow to x = -3 + 2.75 + half its width."""
    x = np.arange(-5.0, 8.01, 0.1)
    height = np.repeat(np.where(np.abs(x + 3.0) < 0.51, 1.0, 0.0)[None, :], 81, axis=0)
    terrain = build_terrain("ridge", -5.0, -4.0, 0.1, height, longji_soil, synthetic=True)
    drive = equipped(predict(yutu2, terrain, straight(4.0, x_m=-1.5), sweep=()))
    use = power_use(lit_by(drive, SunDirection(180.0, 20.0), charge=0.5))
    edge = -2.5 + 1.0 / math.tan(math.radians(20.0))
    assert use.lit is not None
    lit, place = use.lit[0], drive.paths[0, :, 0]
    assert not lit[place < edge - 0.2].any() and lit[place > edge + 0.2].all()
    assert 5 < lit.sum() < len(lit) - 5
    dark = use.battery_wh[0, ~lit]
    assert dark[0] == 0.5 and (np.diff(dark) < 0).all()
    # 1360.8 W/m2 x 1 m2 x 0.25 x sin 20 deg = 116 W, more than is drawn.
    assert use.panels_w[0, -1] == pytest.approx(1360.8 * 0.25 * math.sin(math.radians(20.0)), rel=0.02)
    longer = dataclasses.replace(SUPPLY, battery_wh=0.6)
    assert power_use(lit_by(equipped(drive, MOTORS, longer), SunDirection(0.0, 80.0))).battery_wh.max() == 0.6
    record = power_record(drive, use)
    assert record["empty_drives"] == 0 and 0.1 < record["panels"]["lit_share"] < 0.9


def test_a_motor_gives_what_its_line_allows_and_no_more_than_for_long() -> None:
    """20 N m (1 - w / 1 rad/s), cut at 8 N m from 0.6 rad/s down."""
    assert [MOTORS.torque_nm(rate) for rate in (0.0, 0.6, -0.6, 0.8, 1.0, 2.0)] == pytest.approx(
        [8.0, 8.0, 8.0, 4.0, 0.0, 0.0]
    )


def test_wheels_that_need_more_than_their_motors_give_are_no_go(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    drive = predict(yutu2, slope(0.2), straight(2.0), sweep=())
    most = float(extremes(drive, "motor_torque_nm")[0])
    # Six wheels that lift m g sin(slope) at r_s, and roll on.
    assert most > 135.0 * 1.622 * math.sin(math.atan(0.2)) * 0.1552 / 6
    weak = dataclasses.replace(MOTORS, continuous_torque_nm=0.9 * most)
    assert not keeps_limits(equipped(drive, weak)).any() and keeps_limits(equipped(drive)).all()
    assert "more torque than its motor gives" in judge(equipped(drive, weak)).reasons[-1]
    assert judge(equipped(drive)).reasons == judge(dataclasses.replace(drive, rover=bare(yutu2))).reasons
    plan = dataclasses.replace(drive.plan, limits=(Limit("motor_torque_nm", "N m", 0.9 * most, "test", False),))
    judged = {one.quantity: one for one in judge(equipped(drive), plan).limits}
    limit, load = judged["motor_torque_nm"], judged["motor_load"]
    assert load.ok
    assert not limit.ok and limit.max == pytest.approx(most)


def test_a_battery_is_a_limit_that_no_drive_may_break(driven: Prediction) -> None:
    """20 s at 36 W and the work of the wheels out of 1 Wh: left is what a sum by hand leaves."""
    drive = equipped(driven)
    taken = (energy_use(driven).total_j / 0.5 + 36.0 * 20.0) / 3600.0
    least = float((1.0 - taken).min())
    assert extremes(lit_by(drive, None), "battery_charge") == pytest.approx(1.0 - taken, rel=1e-9)
    for floor, ok in ((least - 1e-6, True), (least + 1e-6, False)):
        supply = dataclasses.replace(SUPPLY, least_charge=floor)
        found = judge(lit_by(equipped(driven, power=supply), None))
        [limit] = [one for one in found.limits if one.quantity == "battery_charge"]
        assert (found.verdict == "go", limit.ok, limit.exceeding) == (ok, ok, 0 if ok else limit.exceeding)
        assert limit.min == pytest.approx(least) and limit.judged == limit.min
        assert keeps_limits(lit_by(equipped(driven, power=supply), None)).all() == ok
    empty = judge(lit_by(drive, None, charge=0.5 * float(taken.min())))
    assert "the battery runs empty in 20 of 20 drives" in empty.reasons[-1]
    assert "battery_charge" not in [one.quantity for one in judge(drive).limits]
    own = Limit("battery_charge", "-", 0.5, "test", False)
    asked = dataclasses.replace(drive, plan=dataclasses.replace(drive.plan, limits=(own,)))
    assert any("battery_charge was not judged: no charge" in note for note in judge(asked).notes)
    assert own in limits_judged(lit_by(asked, None))


def test_one_rule_says_what_is_kept(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """A motor too weak for some soils fails the same drives wherever drives are counted."""
    sweep = (parse_sweep("friction_angle_deg=22:45:12"),)
    drive = predict(yutu2, slope(0.2), straight(2.0), sweep=sweep)
    plan = dataclasses.replace(drive.plan, limits=(Limit("slip_ratio", "-", 0.9, "test", False),))
    most = extremes(drive, "motor_torque_nm")
    weak = equipped(drive, dataclasses.replace(MOTORS, continuous_torque_nm=float(np.median(most))))
    weak = dataclasses.replace(weak, plan=plan)
    beyond = most > np.median(most)
    assert beyond.sum() == 6
    assert (keeps_limits(weak) == ~beyond).all() and (verdicts(weak).keeps == ~beyond).all()
    assert mission_outcome(weak.rover, [weak]).kept_share == 1.0 - beyond.mean()
    assert verdicts(weak).weakest.quantity == "motor_load"
    [limit] = [one for one in judge(weak).limits if one.quantity == "motor_load"]
    assert limit.exceeding == beyond.sum()


def test_a_wheel_outside_of_a_bend_turns_faster_and_its_motor_gives_less(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """At 0.05 m/s about a centre 1.5 m to the left, by the line of the motor: rates of wheels as their radii."""
    plan = Plan(name="bend", legs=(Leg(2.0, 1.0 / 1.5),), speed_m_s=0.05)
    drive = equipped(predict(yutu2, slope(), plan, sweep=()), dataclasses.replace(MOTORS, continuous_torque_nm=20.0))
    load = limited(drive, "motor_load")[0, 5]
    torque = np.abs(drive.states[0, 5, :, STATE_COLUMNS.index("resistance_torque_nm")])
    x, y = yutu2.wheel_positions_m[:, 0] - yutu2.turning_x_m, yutu2.wheel_positions_m[:, 1]
    # The middle wheels do not steer: they roll at the part of their speed that lies ahead.
    radius = np.where(yutu2.steered_mask, np.hypot(x, 1.5 - y), 1.5 - y)
    rate = 0.05 * radius / 1.5 / yutu2.wheel.shearing_radius_m
    assert load.max() == pytest.approx(float((torque / (20.0 * (1.0 - rate))).max()), rel=1e-6)


def bare(rover: Rover) -> Rover:
    return dataclasses.replace(rover, motors=None, power=None)


def test_what_cannot_be_is_refused(yutu2: Rover, driven: Prediction, straight, tmp_path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ParameterError, match=r"continuous_torque_nm is 30; .* at most 20"):
        dataclasses.replace(MOTORS, continuous_torque_nm=30.0)
    with pytest.raises(ParameterError, match=r"efficiency is 1\.2; give a number above 0, at most 1"):
        dataclasses.replace(MOTORS, efficiency=1.2)
    with pytest.raises(ParameterError, match="battery_wh is nan"):
        dataclasses.replace(SUPPLY, battery_wh=math.nan)
    with pytest.raises(ParameterError, match="charge is 2"):
        lit_by(equipped(driven), None, charge=2.0)
    with pytest.raises(ParameterError, match=r"no \[motors\] and \[power\].*add"):
        power_use(dataclasses.replace(driven, rover=bare(driven.rover)))
    slow = dataclasses.replace(yutu2, motors=dataclasses.replace(MOTORS, no_load_rate_rad_s=0.2))
    with pytest.raises(ParameterError, match=r"0\.322 rad/s of a wheel.*at most at 0\.2"):
        check_plan(straight(1.0), slow)
    file = tmp_path / "rover.toml"
    file.write_text(read_rover("yutu2").text.replace("idle_w", "idle_watts"))
    with pytest.raises(DataError, match=r"'idle_watts' is not a key of \[motors\]"):
        build_rover(str(file))
