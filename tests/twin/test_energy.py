"""Work of the wheels' motors beside what lifting, rolling and turning need."""

import dataclasses
import math

import numpy as np
import pytest

from lunarsci.regolith.forces import closed_form_forces
from lunarsci.twin.judgement.energy import energy_record, energy_use
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

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
