"""Forces along a given motion, against the drive that the motion comes from and against levers and weights.

Forces along a measured motion with uncertain soil: against weights and slopes by hand, and against simulated drives
on a soil that is hidden. All drives are synthetic.

Forces and soil in turn on a simulated drive with a hidden soil, and the inference from totals alone (synthetic).
"""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.inference.totals import BalancedStates, infer_from_totals
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.traction import sinkage_under_load
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.judgement.tables import force_table
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.motion import Motion, correlation_of, drawn_motions, read_motion
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.simulation.prescribed_motion import (
    FORCE_COLUMNS,
    AlternatingEstimate,
    LoadEnsemble,
    PoseStates,
    PrescribedLoads,
    Round,
    _velocities,
    alternate,
    contact_jacobian,
    draw_loads,
    prescribed_loads,
    read_pose_states,
    residual_wrench,
    verdict_of,
)

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


SENT_PLAN = Plan(name="test", legs=(Leg(2.5, 0.15), Leg(2.5, -0.1)), speed_m_s=0.05)
SIGMAS = (0.005, 0.005, 0.3)
INNER = slice(3, -3)
"""The ends have one-sided differences, and the simulated drive still finds its speed."""


def middle_of(belief: SoilBelief) -> dict[str, float]:
    return {name: value for name, (value, _, _) in belief.intervals().items()}


def rolling(steps: int, gradient: float = 0.0, slip: float = 0.0) -> Motion:
    """Straight ahead at 0.05 m/s over ground, 6 wheels."""
    time = 2.0 * np.arange(steps)
    zeros = np.zeros((steps, 6))
    rims = zeros + 0.05 / math.cos(math.atan(gradient)) / (1.0 - slip)
    return Motion(time_s=time, x_m=0.05 * time, y_m=0 * time, yaw_deg=0 * time, steering_deg=zeros, speed_m_s=rims)


@pytest.fixture(scope="module")
def hidden_soil() -> SoilBelief:
    """A soil about one standard deviation off the priors, as a belief that knows it."""
    first = first_belief()
    off = np.array([0.7, -0.5, 0.6, -0.8, 0.9, -0.7, 0.8, -0.6])
    sd = np.sqrt(np.diag(first.covariance))
    return dataclasses.replace(first, mean=first.mean + off * sd, covariance=1e-12 * first.covariance)


@pytest.fixture(scope="module")
def sent_drive(yutu2: Rover, hidden_soil: SoilBelief) -> tuple[Prediction, Motion]:
    """A drive on the hidden soil, and its motion as localisation might have it: off by 5 mm and 0.3 deg."""
    soil = {name: np.array([value]) for name, value in middle_of(hidden_soil).items()}
    result = predict(yutu2, synthetic_longji(), SENT_PLAN, samples=soil, time_step_s=0.05)
    assert result.finished.all()
    commands = commands_at(yutu2, make_schedule(SENT_PLAN, yutu2), result.time_s)
    exact = Motion(
        time_s=result.time_s,
        x_m=result.paths[0, :, 0],
        y_m=result.paths[0, :, 1],
        yaw_deg=result.paths[0, :, 5],
        steering_deg=np.degrees(commands.steering_rad),
        speed_m_s=commands.speed_m_s,
        sigmas=np.tile(SIGMAS, (len(result.time_s), 1)),
    )
    return result, next(drawn_motions(exact, 1, 0.5, np.random.default_rng(5)))


@pytest.fixture(scope="module")
def found(yutu2: Rover, sent_drive: tuple[Prediction, Motion]) -> LoadEnsemble:
    """Forces with soils of the priors, whose middle is wrong."""
    first = first_belief()
    soils, middle = first.draws(64, 1), middle_of(first)
    return draw_loads(yutu2, synthetic_longji(), sent_drive[1], soils, middle, correlation_m=0.5, seed=1)


def test_the_levers_of_all_forces_and_what_is_missing_are_newton_s_law(yutu2: Rover, sent_drive) -> None:  # type: ignore[no-untyped-def]
    """Weights have no horizontal part, so that all forces on the wheels and what is missing add up to nothing; of the
    moment about the vertical the torques M_R of tilted wheels remain, under 1 N m on these slopes."""
    held = prescribed_loads(yutu2, synthetic_longji(), sent_drive[1])
    total = np.einsum("ntwf,nwf->nt", contact_jacobian(held), held.states[..., FORCE_COLUMNS]) + residual_wrench(held)
    assert np.abs(residual_wrench(held)[:, :2]).max() > 1.0, "something is missing, or nothing is shown"
    assert np.abs(total[:, :2]).max() < 0.01
    assert np.abs(total[:, 2]).max() < 1.0


def test_on_a_slope_all_wheels_together_pull_the_weight_whatever_the_soil(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """Newton along the slope: sum F_DP = W sin a (F_DP has the resistance in it). Slips of 10 % on the soils of the
    priors pull anything else; the balance puts it right, and says how well: 0.5 % of the weight."""
    gradient = 0.1
    weight = yutu2.mass_kg * yutu2.gravity_m_s2
    wanted = weight * math.sin(math.atan(gradient))
    first = first_belief()
    result = draw_loads(
        yutu2, slope(gradient), rolling(12, gradient, 0.1), first.draws(64), middle_of(first), correlation_m=0.5
    )
    before, after = (part[6, :, 1].sum() for part in (result.before, result.after))
    assert abs(before - wanted) > 5.0
    assert after == pytest.approx(wanted, abs=2 * 0.005 * weight)
    assert result.after[6, :, 0].sum() == pytest.approx(weight * math.cos(math.atan(gradient)), rel=2e-3)
    assert result.total_before[6, 0] > 10.0
    assert result.total_after[6, 0] == pytest.approx(0.005 * weight, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(6, marks=pytest.mark.study)])
def test_the_balance_moves_forces_from_a_wrong_soil_to_the_true_ones(yutu2: Rover, sent_drive, count: int) -> None:  # type: ignore[no-untyped-def]
    """Drives each on another soil drawn from the priors: the error of a drive is that of one soil, alike at all
    its poses, so that a single drive says nothing of how often intervals hold the truth."""
    first, ground, exact = first_belief(), synthetic_longji(), sent_drive[1]
    drives = predict(yutu2, ground, SENT_PLAN, samples=first.draws(count, 7), time_step_s=0.05)
    assert drives.finished.all()
    off, sigma = {"before": [], "after": []}, {"before": [], "after": []}
    for m in range(count):
        x, y, yaw = (drives.paths[m, :, k] for k in (0, 1, 5))
        motion = dataclasses.replace(exact, x_m=x, y_m=y, yaw_deg=yaw)
        motion = next(drawn_motions(motion, 1, 0.5, np.random.default_rng(m)))
        soils = first.draws(48, 1)
        found = draw_loads(yutu2, ground, motion, soils, middle_of(first), correlation_m=0.5, seed=1)
        for when in off:
            off[when].append((getattr(found, when) - drives.states[m][..., FORCE_COLUMNS])[INNER])
            sigma[when].append(getattr(found, f"{when}_sigma")[INNER])
    rms = {when: np.sqrt((np.array(each) ** 2).mean(axis=(0, 1, 2))) for when, each in off.items()}
    assert (rms["after"] < (0.8, 0.4, 0.4) * rms["before"]).all(), "loads, single drawbar pulls, single lateral forces"
    pulled = {when: np.sqrt((np.array(each)[..., 1].sum(axis=-1) ** 2).mean()) for when, each in off.items()}
    assert pulled["after"] < 0.05 * pulled["before"] and pulled["after"] < 0.5
    inside = np.abs(off["after"]) < np.array(sigma["after"])
    assert (inside.mean(axis=(0, 1, 2)) > 0.68).all()


def test_shares_add_up_and_follow_what_is_uncertain(yutu2: Rover, sent_drive, found, hidden_soil) -> None:  # type: ignore[no-untyped-def]
    for k in range(3):
        for balanced in (False, True):
            share = found.shares(k, balanced=balanced)
            assert share.soil + share.motion + share.balance + share.together == pytest.approx(1.0)
    assert found.shares(1, balanced=False).soil > max(0.8, found.shares(1, balanced=True).soil)
    assert found.shares(0, balanced=True).of_force < 0.1 < found.shares(1, balanced=False).of_force
    exact = dataclasses.replace(sent_drive[1], sigmas=None)
    first, ground = first_belief(), synthetic_longji()
    only_soil = draw_loads(yutu2, ground, exact, first.draws(16), middle_of(first), correlation_m=0.5)
    assert only_soil.shares(1, balanced=False).soil == pytest.approx(1.0)
    known = draw_loads(yutu2, ground, sent_drive[1], hidden_soil.draws(16), middle_of(hidden_soil), correlation_m=0.5)
    assert known.shares(1, balanced=False).soil < 1e-6 and known.shares(1, balanced=False).motion > 0.9


def test_errors_of_a_motion_are_smooth_and_as_large_as_said() -> None:
    """Correlation exp(-1/2) over one length, and speeds off by sigma / l of the speed, as differentiation says."""
    length, motion = 0.4, rolling(41)
    motion = dataclasses.replace(motion, sigmas=np.tile((0.004, 0.008, 0.5), (41, 1)))
    drawn = list(drawn_motions(motion, 4000, length, np.random.default_rng(0)))
    error = np.array([each.x_m - motion.x_m for each in drawn])
    assert motion.rolled_m[4] == pytest.approx(length)
    assert error.std() == pytest.approx(0.004, rel=0.03) and abs(error.mean()) < 2e-4
    alike = (error[:, 4:] * error[:, :-4]).mean() / (error**2).mean()
    assert alike == pytest.approx(math.exp(-0.5), abs=0.03)
    speed = np.diff(error, axis=1) / np.diff(motion.rolled_m)
    assert speed.std() == pytest.approx(0.004 / length, rel=0.05)
    assert np.std([each.yaw_deg for each in drawn]) == pytest.approx(0.5, rel=0.03)
    slips = np.full(9, 0.004 / length)
    same = dataclasses.replace(motion, sigmas=np.tile((0.004, 0.004, 0.5), (41, 1)))
    assert correlation_of(same, 0 * slips, slips) == pytest.approx(length)
    assert correlation_of(rolling(5), 0 * slips, slips) is None


def test_halts_and_what_is_beside_them_have_no_forces(tmp_path: Path, yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    motion = rolling(12)
    table = pd.DataFrame({"time_s": motion.time_s, "x_m": motion.x_m, "y_m": 0.0, "yaw_deg": 0.0})
    for wheel in yutu2.wheels:
        table[f"steering_{wheel}_deg"], table[f"speed_{wheel}_m_s"] = 0.0, np.where(np.arange(12) == 6, 0.0, 0.05)
    table.loc[7:, "x_m"] -= 0.1  # it stood still from 5 to 7
    table.loc[6, "x_m"] = table.loc[5, "x_m"]
    path = tmp_path / "motion.csv"
    table.to_csv(path, index=False)
    read = read_motion(path, yutu2)
    assert read.no_speed.nonzero()[0].tolist() == [5, 6, 7]
    found = prescribed_loads(yutu2, slope(), read)
    assert np.isnan(found.states[5:8]).all() and np.isfinite(found.states[[4, 8]]).all()
    first = first_belief()
    result = draw_loads(yutu2, slope(), read, first.draws(16), middle_of(first), correlation_m=0.5)
    valid = force_table(result)["valid"].to_numpy().reshape(12, 6)
    assert not valid[5:8].any() and valid[[4, 8]].all()


def test_a_table_keeps_measured_states_and_gets_forces_of_their_times(tmp_path: Path, yutu2: Rover, found) -> None:  # type: ignore[no-untyped-def]
    time = found.held.motion.time_s
    between = 0.5 * (time[10] + time[11])
    rows = ["time_s,wheel,sinkage_m,slip_ratio,side_slip_deg,valid,remark,drawbar_pull_n"]
    rows += [f"{time[10]:.9f},FL,0.01,0.1,0,true,a,99", f"{between:.9f},RR,0.02,0.1,0,true,b,99"]
    rows += [f"{time[-1] + 1:.9f},FL,0.02,0.1,0,true,c,99", f"{time[10]:.9f},MR,0.02,0.1,0,false,d,99"]
    path = tmp_path / "states.csv"
    path.write_text("\n".join(rows) + "\n")
    table = force_table(found, read_pose_states(read_input(str(path)), yutu2))
    assert table["remark"].tolist() == ["a", "b", "c", "d"] and table["sinkage_m"].tolist()[0] == "0.01"
    assert table["valid"].tolist() == [True, True, False, False]
    assert table["drawbar_pull_n"][0] == pytest.approx(found.after[10, 0, 1], rel=1e-6)
    assert table["normal_force_n"][1] == pytest.approx(found.after[10:12, 5, 0].mean(), rel=1e-6)
    assert table["lateral_force_n_sigma"][0] == pytest.approx(found.after_sigma[10, 0, 2], rel=1e-6)
    assert math.isnan(table["drawbar_pull_n"][2])


def test_forces_on_a_given_soil_are_those_of_a_terrain_of_that_soil(yutu2: Rover, slope, longji_soil) -> None:  # type: ignore[no-untyped-def]
    from lunarsci.twin.ground.terrain import soil_overrides

    other = longji_soil.replace(stiffness_kpa_m_n=700.0, cohesion_pa=900.0)
    row = soil_overrides({name: np.array([getattr(other, name)]) for name in PARAMETERS}, 1)[0]
    one, two = (
        prescribed_loads(yutu2, slope(0.1), rolling(5), row),
        prescribed_loads(yutu2, slope(0.1, soil=other), rolling(5)),
    )
    assert one.states == pytest.approx(two.states, rel=1e-9, abs=1e-12)
    depth = STATE_COLUMNS.index("sinkage_m")
    assert (one.states[..., depth] > prescribed_loads(yutu2, slope(0.1), rolling(5)).states[..., depth]).all()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"x_m_sigma": 0.1}, "no column y_m_sigma"),
        ({"x_m_sigma": 0.1, "y_m_sigma": 0.1, "yaw_deg_sigma": -1.0}, "yaw_deg_sigma is -1 at pose 0"),
        ({"x_m_sigma": "", "y_m_sigma": 0.1, "yaw_deg_sigma": 1.0}, "x_m_sigma is nan at pose 0"),
    ],
)
def test_bad_errors_of_a_motion_are_one_line(tmp_path: Path, yutu2: Rover, changes, says: str) -> None:  # type: ignore[no-untyped-def]
    table = pd.DataFrame({"time_s": [0, 1, 2], "x_m": [0, 0.05, 0.1], "y_m": 0, "yaw_deg": 0}).assign(**changes)
    path = tmp_path / "motion.csv"
    table.to_csv(path, index=False)
    with pytest.raises(DataError, match=says):
        read_motion(path, yutu2, SENT_PLAN)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,sinkage_m\n0,0.01\n", "no column wheel"),
        ("time_s,wheel\n0,FL\n", "no measured column"),
        ("time_s,wheel,sinkage_m\n0,XX,0.01\n", "no wheel of"),
        ("time_s,wheel,sinkage_m\n,FL,0.01\n", "row 1, time_s: is blank"),
        ("time_s,wheel,sinkage_m\n0,FL,0.01\n0,FL,0.02\n", "wheel FL contradict each other"),
        ("time_s,wheel,sinkage_m,sinkage_m_sigma\n0,FL,0.01,-1\n", "row 1, sinkage_m_sigma"),
    ],
)
def test_bad_states_are_one_line_that_names_the_file(tmp_path: Path, yutu2: Rover, text: str, says: str) -> None:
    path = tmp_path / "states.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=says) as caught:
        read_pose_states(read_input(str(path)), yutu2)
    assert str(path) in str(caught.value)


def test_draws_and_errors_out_of_range_are_refused(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    first, motion = first_belief(), rolling(4)
    known = (yutu2, slope(), motion)
    with pytest.raises(ParameterError, match="draws is 8; give 16"):
        draw_loads(*known, first.draws(8), middle_of(first), correlation_m=0.5)
    with pytest.raises(ParameterError, match="balance_error is 0"):
        draw_loads(*known, first.draws(16), middle_of(first), correlation_m=0.5, balance_error=0.0)
    with pytest.raises(ParameterError, match="correlation length"):
        draw_loads(*known, first.draws(16), middle_of(first), correlation_m=0.0)


OFF = np.array([-0.9, 0.4, 0.6, -0.5, -0.7, 0.7, 0.8, -0.6])
"""The hidden soil, in standard deviations of the priors."""
POSES = 24
SINKAGE_SIGMA, SLIP_SIGMA, SIDE_SIGMA = 0.0005, 0.01, 0.7


@pytest.fixture(scope="module")
def hidden() -> np.ndarray:
    """Its transforms."""
    first = first_belief()
    return np.asarray(first.mean + OFF * np.sqrt(np.diag(first.covariance)))


def off_by(belief: SoilBelief, truth: np.ndarray) -> np.ndarray:
    """In standard deviations that remain."""
    return np.asarray((belief.mean - truth) / np.sqrt(np.diag(belief.covariance)))


@pytest.fixture(scope="module")
def exact(yutu2: Rover, hidden: np.ndarray) -> BalancedStates:
    """Poses whose sinkages and forces are found state by state, by other functions than the inference uses."""
    rng = np.random.default_rng(0)
    soil = Soil(**dict(zip(PARAMETERS, values_of(first_belief().laws, hidden), strict=True)))
    load, slip = rng.uniform(25.0, 50.0, (POSES, 6)), rng.uniform(-0.1, 0.4, (POSES, 1)) + np.zeros((1, 6))
    side = rng.uniform(-6.0, 6.0, (POSES, 6))
    depth = np.empty((POSES, 6))
    for p in range(POSES):
        for m in range(6):
            depth[p, m] = sinkage_under_load(yutu2.wheel, soil, load[p, m], slip[p, m], side[p, m])
    forces = closed_form_forces(yutu2.wheel, soil, depth, slip, side)
    levers = np.zeros((POSES, 3, 6, 2))
    levers[:, 0, :, 0], levers[:, 1, :, 1] = 1.0, -1.0
    levers[:, 2] = rng.uniform(-0.6, 0.6, (POSES, 6, 2))
    pulls = np.stack([forces.drawbar_pull_n, forces.lateral_force_n], axis=-1)
    return BalancedStates(
        inputs=np.stack([depth, slip, side], axis=-1),
        input_sigma=np.tile([1e-6, 1e-5, 1e-4], (POSES, 6, 1)),
        load=load,
        load_sigma=np.full((POSES, 6), 0.01),
        levers=levers,
        totals=np.einsum("ptmf,pmf->pt", levers, pulls),
        totals_sigma=np.full((POSES, 3), 0.01),
    )


def test_loads_and_totals_give_the_soil_back(yutu2: Rover, exact: BalancedStates, hidden: np.ndarray) -> None:
    found = infer_from_totals(exact, yutu2.wheel, first_belief(), model_error=1e-4)
    assert np.abs(off_by(found.belief, hidden)).max() < 1.0
    assert max(found.belief.sd_ratio.values()) < 0.1
    assert max(found.reduced) < 0.1 and found.values == (6 * POSES, 3 * POSES)


def test_intervals_hold_the_soil_as_often_as_they_say(yutu2: Rover, exact: BalancedStates, hidden: np.ndarray) -> None:
    """Errors as the inference takes them: sinkage of each wheel, slip and side slip common to a pose, totals."""
    rng, misses = np.random.default_rng(1), []
    sigma = np.array([0.0003, 0.002, 0.2])
    for _ in range(12):
        common = rng.standard_normal((POSES, 1, 3)) * sigma
        noise = np.where([True, False, False], rng.standard_normal((POSES, 6, 3)) * sigma, common)
        states = dataclasses.replace(
            exact,
            inputs=exact.inputs + noise,
            input_sigma=np.tile(sigma, (POSES, 6, 1)),
            totals=exact.totals + 0.5 * rng.standard_normal((POSES, 3)),
            totals_sigma=np.full((POSES, 3), 0.5),
        )
        misses.append(off_by(infer_from_totals(states, yutu2.wheel, first_belief(), model_error=1e-3).belief, hidden))
    inside = np.abs(misses) < 1.0
    assert 0.55 < inside.mean() < 0.85 and (np.abs(misses) < 1.96).mean() > 0.88


def test_totals_of_a_pose_are_not_used_where_a_wheel_is_missing(yutu2: Rover, exact: BalancedStates) -> None:
    inputs = exact.inputs.copy()
    inputs[:, 2, 0] = np.nan
    found = infer_from_totals(dataclasses.replace(exact, inputs=inputs), yutu2.wheel, first_belief())
    left = found.belief.sd_ratio
    assert found.values == (5 * POSES, 0)
    assert left["stiffness_kpa_m_n"] < 0.5 and left["friction_angle_deg"] > 0.8, "loads rest on shear only a little"
    assert left["lateral_modulus_mm"] == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(ParameterError, match="nothing can be learned"):
        dataclasses.replace(exact, inputs=np.full_like(inputs, np.nan))
    with pytest.raises(ParameterError, match="shapes must be"):
        dataclasses.replace(exact, totals=exact.totals[:, :2])


@pytest.fixture(scope="module")
def drive(yutu2: Rover, hidden: np.ndarray) -> tuple[np.ndarray, Motion, PoseStates]:
    """True forces, motion and states of a simulated drive, with errors."""
    plan = Plan(name="test", legs=(Leg(2.5, 0.15), Leg(2.5, -0.1)), speed_m_s=0.05)
    values = values_of(first_belief().laws, hidden)
    soil = {name: np.array([value]) for name, value in zip(PARAMETERS, values, strict=True)}
    result = predict(yutu2, synthetic_longji(), plan, samples=soil, time_step_s=0.05)
    commands, time = commands_at(yutu2, make_schedule(plan, yutu2), result.time_s), result.time_s
    exact = Motion(
        time_s=time,
        x_m=result.paths[0, :, 0],
        y_m=result.paths[0, :, 1],
        yaw_deg=result.paths[0, :, 5],
        steering_deg=np.degrees(commands.steering_rad),
        speed_m_s=commands.speed_m_s,
        sigmas=np.tile((0.005, 0.005, 0.3), (len(time), 1)),
        halted=result.halted,
    )
    rng = np.random.default_rng(3)
    motion = next(drawn_motions(exact, 1, 0.5, rng))
    from lunarsci.twin.ground.terrain import soil_overrides

    seen = prescribed_loads(
        yutu2, synthetic_longji(), motion, soil_overrides(soil, 1)[0]
    ).states  # slips of that motion
    true = result.states[0]
    depth = true[..., STATE_COLUMNS.index("sinkage_m")] + SINKAGE_SIGMA * rng.standard_normal(true.shape[:2])
    slip, side = (seen[..., STATE_COLUMNS.index(name)] for name in ("slip_ratio", "side_slip_deg"))
    states = PoseStates(
        pd.DataFrame({"time_s": np.repeat(time, 6)}),
        np.repeat(time, 6),
        np.tile(np.arange(6), len(time)),
        np.column_stack([depth.ravel(), slip.ravel(), side.ravel()]),
        np.tile([SINKAGE_SIGMA, SLIP_SIGMA, SIDE_SIGMA], (depth.size, 1)),
        np.isfinite(slip.ravel()),
    )
    return true[..., FORCE_COLUMNS], motion, states


@pytest.fixture(scope="module")
def turned(yutu2: Rover, drive: tuple[np.ndarray, Motion, PoseStates]) -> AlternatingEstimate:
    _, motion, states = drive
    options = {"draws": 16, "correlation_m": 0.5, "seed": 2}
    return alternate(yutu2, synthetic_longji(), motion, states, first_belief(), rounds=8, **options)  # type: ignore[arg-type]


@pytest.mark.slow
def test_forces_and_soil_in_turn_converge_and_hold_the_hidden_soil(
    turned: AlternatingEstimate, hidden: np.ndarray
) -> None:
    assert turned.converged and 1 < len(turned.rounds) < 8
    assert turned.rounds[-1].soil < 0.1 and turned.rounds[-1].forces < 0.01
    belief = turned.posterior.belief
    assert np.abs(off_by(belief, hidden)).max() < 3.0
    left = belief.sd_ratio
    assert left["stiffness_kpa_m_n"] < 0.5 and left["sinkage_exponent_slip"] < 0.7
    assert left["cohesion_pa"] > 0.7, "slips of a few per cent cannot tell cohesion from friction"
    assert max(turned.posterior.reduced) < 1.5


@pytest.mark.slow
def test_forces_on_the_soil_that_was_found_are_the_true_ones(turned: AlternatingEstimate, drive) -> None:  # type: ignore[no-untyped-def]
    known = turned.forces.with_forces.copy()
    known[:3] = known[-3:] = False
    off = (turned.forces.after - drive[0])[known]
    sigma = turned.forces.after_sigma[known]
    assert np.sqrt((off**2).mean(axis=(0, 1))).max() < 0.5
    assert (np.abs(off) < sigma).mean() > 0.6 and (np.abs(off) < 2 * sigma).mean() > 0.9


@pytest.mark.slow
def test_the_soil_does_not_follow_from_where_the_rounds_begin(yutu2: Rover, turned: AlternatingEstimate, drive) -> None:  # type: ignore[no-untyped-def]
    """Forces that came from a soil must not prove it: with other soils drawn for them the same soil is found."""
    _, motion, states = drive
    options = {"draws": 16, "correlation_m": 0.5, "seed": 77}
    other = alternate(yutu2, synthetic_longji(), motion, states, first_belief(), rounds=8, **options)  # type: ignore[arg-type]
    one, two = turned.posterior.belief, other.posterior.belief
    assert np.abs((one.mean - two.mean) / np.sqrt(np.diag(one.covariance))).max() < 0.3


def made_up(soil: float, forces: float, *step: float) -> Round:
    return Round(soil, forces, np.array(step), {}, 1.0, 1.0)


def test_rounds_converge_oscillate_or_neither() -> None:
    far, near = made_up(2.0, 0.2, 2.0, 0.0), made_up(0.05, 0.001, 0.05, 0.0)
    assert verdict_of([far, near]) == "converged"
    assert verdict_of([far]) == "does not converge"
    assert verdict_of([far, made_up(1.9, 0.2, -1.9, 0.1)]) == "oscillates"
    assert verdict_of([far, made_up(1.0, 0.1, -1.0, 0.1)]) == "does not converge"
    assert verdict_of([far, made_up(0.05, 0.2, 0.05, 0.0)]) == "does not converge"


def test_rounds_out_of_range_are_refused(yutu2: Rover, drive) -> None:  # type: ignore[no-untyped-def]
    _, motion, states = drive
    with pytest.raises(ParameterError, match="1 to 50"):
        alternate(yutu2, synthetic_longji(), motion, states, first_belief(), rounds=0, correlation_m=0.5)
