"""Forces along a given motion, against the drive that the motion comes from and against levers and weights."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads, _velocities, prescribed_loads
from lunarsci.twin.plans.motion import Motion, read_motion
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

PLAN = Plan(name="test", legs=(Leg(2.0, 0.15), Leg(2.0, -0.1)), speed_m_s=0.05)


def motion_of(result: Prediction) -> Motion:
    """The path of a prediction, with the commands it was driven by."""
    commands = commands_at(result.rover, make_schedule(result.plan, result.rover), result.time_s)
    x, y, yaw = (result.paths[0, :, k] for k in (0, 1, 5))
    return Motion(
        time_s=result.time_s,
        x_m=x,
        y_m=y,
        yaw_deg=yaw,
        steering_deg=np.degrees(commands.steering_rad),
        speed_m_s=commands.speed_m_s,
    )


def column(states: np.ndarray, name: str) -> np.ndarray:
    return states[..., STATE_COLUMNS.index(name)]


@pytest.fixture(scope="module")
def driven(yutu2: Rover) -> tuple[Prediction, PrescribedLoads]:
    terrain = synthetic_longji(rms_m=0.002)
    result = predict(yutu2, terrain, PLAN, sweep=(), sample_m=0.05, time_step_s=0.05, ruts=False)
    return result, prescribed_loads(yutu2, terrain, motion_of(result))


def test_a_drive_is_explained_by_its_own_motion(driven: tuple[Prediction, PrescribedLoads]) -> None:
    """All but the ends, where differences are one-sided and the drive still finds its speed."""
    result, found = driven
    inner = slice(10, -2)
    assert (found.outcome == 0).all()
    for name, off in (
        ("normal_force_n", 1.0),
        ("drawbar_pull_n", 1.0),
        ("lateral_force_n", 1.0),
        ("sinkage_m", 2e-4),
        ("slip_ratio", 0.01),
        ("side_slip_deg", 0.5),
    ):
        ours, theirs = column(found.states, name)[inner], column(result.states[0], name)[inner]
        assert np.abs(ours - theirs).max() < off, name
        assert np.median(np.abs(ours - theirs)) < 0.2 * off, name
    assert np.abs(found.paths[inner, 2] - result.paths[0, inner, 2]).max() < 1e-3
    assert np.abs(found.paths[inner, 3:5] - result.paths[0, inner, 3:5]).max() < 0.1
    assert np.abs(found.residual_n[inner]).max() < 3.0
    assert found.residual_share < 0.02


def test_on_a_slope_what_is_missing_is_the_weight_that_the_wheels_do_not_hold(yutu2: Rover, longji_soil, slope) -> None:  # type: ignore[no-untyped-def]
    """A rover said to roll with neither slip nor side slip across a slope needs to be held by someone."""
    ground = slope(0.0, 0.1)
    time = np.arange(0.0, 40.0, 2.0)
    zeros = np.zeros((len(time), 6))
    motion = Motion(
        time_s=time, x_m=0.05 * time, y_m=0 * time, yaw_deg=0 * time, steering_deg=zeros, speed_m_s=zeros + 0.05
    )
    found = prescribed_loads(yutu2, ground, motion)
    weight = yutu2.mass_kg * yutu2.gravity_m_s2
    lateral = column(found.states, "lateral_force_n")
    assert np.abs(lateral).max() < 1e-3
    # In the plane's own frame: the component of the weight along the slope, held by a horizontal force.
    assert found.residual_n[5, 1] == pytest.approx(weight * 0.1, rel=1e-3)
    assert abs(found.residual_nm[5]) < 0.5


def test_a_rover_towed_up_a_slope_needs_what_weight_and_soil_take(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """It rolls without slip, so its wheels only resist; a horizontal force H ahead holds it. Newton along the slope and
    across it: H cos a + sum F_DP = W sin a, sum F_N = W cos a + H sin a."""
    gradient = 0.2
    angle = math.atan(gradient)
    time = np.arange(0.0, 40.0, 2.0)
    zeros = np.zeros((len(time), 6))
    rims = zeros + 0.05 / math.cos(angle)
    motion = Motion(time_s=time, x_m=0.05 * time, y_m=0 * time, yaw_deg=0 * time, steering_deg=zeros, speed_m_s=rims)
    found = prescribed_loads(yutu2, slope(gradient), motion)
    weight = yutu2.mass_kg * yutu2.gravity_m_s2
    assert np.abs(column(found.states, "slip_ratio")[1:-1]).max() < 1e-6
    load, pull = (column(found.states, name)[5].sum() for name in ("normal_force_n", "drawbar_pull_n"))
    ahead, aside = found.residual_n[5]
    assert pull < 0.0 < ahead and aside == pytest.approx(0.0, abs=1e-6)
    assert ahead * math.cos(angle) + pull == pytest.approx(weight * math.sin(angle), rel=1e-6)
    assert load == pytest.approx(weight * math.cos(angle) + ahead * math.sin(angle), rel=1e-6)


def test_weight_moves_to_the_rear_wheels_on_a_climb(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """Moments about the line of wheel centres, where F_DP acts: the weight above it, and the soil's torques M_R."""
    gradient = 0.15
    result = predict(yutu2, slope(gradient), Plan(name="up", legs=(Leg(3.0),), speed_m_s=0.05), sweep=(), ruts=False)
    found = prescribed_loads(yutu2, slope(gradient), motion_of(result))
    load = column(found.states, "normal_force_n")[-5]
    angle = math.atan(gradient)
    weight = yutu2.mass_kg * yutu2.gravity_m_s2
    assert load.sum() == pytest.approx(weight * math.cos(angle), rel=2e-3)
    x = yutu2.wheel_positions_m[:, 0]
    body = yutu2.body_kg * yutu2.gravity_m_s2 * math.sin(angle)
    torque = column(found.states, "resistance_torque_nm")[-5].sum()
    # The pivots stand 0.1 m above the wheel centres, the chassis' centre of mass above the pivots.
    assert -(load @ x) == pytest.approx(body * (0.1 + yutu2.body_center_m[2]) + torque, rel=0.01)


def test_poses_in_a_hole_and_beside_it_say_so(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    ground = slope()
    ground.height_m[:, 20:22] = np.nan  # x = 3.0 to 3.25 m
    time = np.arange(0.0, 60.0, 2.0)
    zeros = np.zeros((len(time), 6))
    motion = Motion(
        time_s=time, x_m=0.05 * time, y_m=0 * time, yaw_deg=0 * time, steering_deg=zeros, speed_m_s=zeros + 0.05
    )
    found = prescribed_loads(yutu2, ground, motion)
    assert found.outcome[0] == 0 and np.isfinite(found.states[0]).all()
    assert OUTCOMES[found.outcome[-1]].startswith("hole") and np.isnan(found.states[-1]).all()
    assert np.isfinite(found.states[found.outcome == 0]).all()


def test_a_pose_keeps_its_own_reason_beside_one_with_another(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    ground = slope()
    ground.height_m[:, 20:22] = np.nan
    x, zeros = np.array([0.0, 0.5, 3.1, 100.0, 100.5]), np.zeros((5, 6))
    time = np.arange(5.0)
    motion = Motion(time_s=time, x_m=x, y_m=0 * x, yaw_deg=0 * x, steering_deg=zeros, speed_m_s=zeros + 0.05)
    found = prescribed_loads(yutu2, ground, motion)
    reasons = [OUTCOMES[code].split(":")[0] for code in found.outcome]
    assert reasons[2:] == ["hole in the terrain", "left the terrain", "left the terrain"]
    assert reasons[0] == "finished"


def test_a_motion_comes_from_the_tables_of_a_prediction(tmp_path: Path, yutu2: Rover, driven) -> None:  # type: ignore[no-untyped-def]
    from lunarsci.twin.judgement.tables import path_table

    result, _ = driven
    path = tmp_path / "paths.csv"
    path_table(result).to_csv(path, index=False)
    motion, direct = read_motion(path, yutu2, PLAN), motion_of(result)
    assert motion.x_m == pytest.approx(direct.x_m) and motion.time_s == pytest.approx(result.time_s)
    assert motion.steering_deg == pytest.approx(direct.steering_deg)
    table = path_table(result)
    for k, wheel in enumerate(yutu2.wheels):
        table[f"steering_{wheel}_deg"], table[f"speed_{wheel}_m_s"] = direct.steering_deg[:, k], direct.speed_m_s[:, k]
    table.to_csv(path, index=False)
    assert read_motion(path, yutu2).speed_m_s == pytest.approx(direct.speed_m_s)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("time_s,x_m,y_m\n0,0,0\n", "no column yaw_deg"),
        ("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n1,0,0,0\n", "at least 3"),
        ("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n2,0,0,0\n1,0,0,0\n", "does not ascend after pose 1"),
        ("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n1,nan,0,0\n2,0,0,0\n", "x_m is not finite at pose 1"),
        ("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n1,east,0,0\n2,0,0,0\n", "east"),
        ("member,time_s,x_m,y_m,yaw_deg\n0,0,0,0,0\n1,1,0,0,0\n", "`member`"),
        ("time_s,x_m,y_m,yaw_deg,speed_FL_m_s\n0,0,0,0,1\n", "no column steering_FL_deg"),
        ("time_s,x_m,y_m,yaw_deg\n0,0,0,0,7\n1,0,0,0,7\n2,0,0,0,7\n", "line 2: 5 fields"),
        ("time_s,x_m,y_m,yaw_deg\n1e9,0,0,0\n1000000001,0,0,0\n1000000002,0,0,0\n", "from the start of the drive"),
        ("", "is empty"),
    ],
)
def test_a_bad_motion_is_one_line_that_names_the_file(tmp_path: Path, yutu2: Rover, rows: str, says: str) -> None:
    path = tmp_path / "motion.csv"
    path.write_text(rows)
    with pytest.raises(DataError) as caught:
        read_motion(path, yutu2, PLAN)
    assert says in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("times", "says"),
    [((0, 1, 2, 30, 31, 32), "no pose for 28 s after time_s 2"), ((0, 40, 80, 120), "1 of 4 poses lie outside")],
)
def test_gaps_and_times_beyond_the_plan_are_said(
    tmp_path: Path, yutu2: Rover, times: tuple[int, ...], says: str
) -> None:
    path = tmp_path / "motion.csv"
    path.write_text("time_s,x_m,y_m,yaw_deg\n" + "".join(f"{t},{0.05 * t},0,0\n" for t in times))
    with pytest.warns(LunarSciWarning, match=says):
        read_motion(path, yutu2, PLAN)


def test_commands_must_fit_the_rover(yutu2: Rover, slope, driven) -> None:  # type: ignore[no-untyped-def]
    motion = motion_of(driven[0])
    for changes, says in (
        ({"speed_m_s": motion.speed_m_s[:, :4]}, "is wanted"),
        ({"speed_m_s": 0 * motion.speed_m_s}, "is 0"),
        ({"steering_deg": motion.steering_deg + 100.0}, "beyond 90 deg"),
    ):
        with pytest.raises(ParameterError, match=says):
            prescribed_loads(yutu2, slope(), dataclasses.replace(motion, **changes))


def test_a_turn_at_uneven_times_has_the_spin_of_its_heading() -> None:
    random = np.random.default_rng(4)
    times, yaw = np.cumsum(random.uniform(0.5, 3.0, 12)), np.cumsum(random.uniform(-0.2, 0.3, 12))
    poses = np.zeros((12, 10))
    poses[:, 3], poses[:, 6] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    spin = _velocities(times, poses)[:, 3:6]
    assert spin == pytest.approx(np.column_stack([0.0 * yaw, 0.0 * yaw, np.gradient(yaw, times)]), abs=1e-12)
