"""Forces along a measured motion with uncertain soil: against weights and slopes by hand, and against simulated drives
on a soil that is hidden. All drives are synthetic."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.judgement.load_check import force_table
from lunarsci.twin.loads.load_ensemble import LoadEnsemble, draw_loads
from lunarsci.twin.loads.prescribed_motion import (
    FORCE_COLUMNS,
    contact_jacobian,
    prescribed_loads,
    read_pose_states,
    residual_wrench,
)
from lunarsci.twin.plans.motion import Motion, correlation_of, drawn_motions, read_motion
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

PLAN = Plan(name="test", legs=(Leg(2.5, 0.15), Leg(2.5, -0.1)), speed_m_s=0.05)
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
def hidden() -> SoilBelief:
    """A soil about one standard deviation off the priors, as a belief that knows it."""
    first = first_belief()
    off = np.array([0.7, -0.5, 0.6, -0.8, 0.9, -0.7, 0.8, -0.6])
    sd = np.sqrt(np.diag(first.covariance))
    return dataclasses.replace(first, mean=first.mean + off * sd, covariance=1e-12 * first.covariance)


@pytest.fixture(scope="module")
def driven(yutu2: Rover, hidden: SoilBelief) -> tuple[Prediction, Motion]:
    """A drive on the hidden soil, and its motion as localisation might have it: off by 5 mm and 0.3 deg."""
    soil = {name: np.array([value]) for name, value in middle_of(hidden).items()}
    result = predict(yutu2, synthetic_longji(), PLAN, samples=soil, time_step_s=0.05)
    assert result.finished.all()
    commands = commands_at(yutu2, make_schedule(PLAN, yutu2), result.time_s)
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
def found(yutu2: Rover, driven: tuple[Prediction, Motion]) -> LoadEnsemble:
    """Forces with soils of the priors, whose middle is wrong."""
    first = first_belief()
    soils, middle = first.draws(64, 1), middle_of(first)
    return draw_loads(yutu2, synthetic_longji(), driven[1], soils, middle, correlation_m=0.5, seed=1)


def test_the_levers_of_all_forces_and_what_is_missing_are_newton_s_law(yutu2: Rover, driven) -> None:  # type: ignore[no-untyped-def]
    """Weights have no horizontal part, so that all forces on the wheels and what is missing add up to nothing; of the
    moment about the vertical the torques M_R of tilted wheels remain, under 1 N m on these slopes."""
    held = prescribed_loads(yutu2, synthetic_longji(), driven[1])
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
def test_the_balance_moves_forces_from_a_wrong_soil_to_the_true_ones(yutu2: Rover, driven, count: int) -> None:  # type: ignore[no-untyped-def]
    """Drives each on another soil drawn from the priors: the error of a drive is that of one soil, alike at all
    its poses, so that a single drive says nothing of how often intervals hold the truth."""
    first, ground, exact = first_belief(), synthetic_longji(), driven[1]
    drives = predict(yutu2, ground, PLAN, samples=first.draws(count, 7), time_step_s=0.05)
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


def test_shares_add_up_and_follow_what_is_uncertain(yutu2: Rover, driven, found, hidden) -> None:  # type: ignore[no-untyped-def]
    for k in range(3):
        for balanced in (False, True):
            share = found.shares(k, balanced=balanced)
            assert share.soil + share.motion + share.balance + share.together == pytest.approx(1.0)
    assert found.shares(1, balanced=False).soil > max(0.8, found.shares(1, balanced=True).soil)
    assert found.shares(0, balanced=True).of_force < 0.1 < found.shares(1, balanced=False).of_force
    exact = dataclasses.replace(driven[1], sigmas=None)
    first, ground = first_belief(), synthetic_longji()
    only_soil = draw_loads(yutu2, ground, exact, first.draws(16), middle_of(first), correlation_m=0.5)
    assert only_soil.shares(1, balanced=False).soil == pytest.approx(1.0)
    known = draw_loads(yutu2, ground, driven[1], hidden.draws(16), middle_of(hidden), correlation_m=0.5)
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
        read_motion(path, yutu2, PLAN)


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
    with pytest.raises(ParameterError, match="too few"):
        draw_loads(*known, first.draws(8), middle_of(first), correlation_m=0.5)
    with pytest.raises(ParameterError, match="error of the balance"):
        draw_loads(*known, first.draws(16), middle_of(first), correlation_m=0.5, balance_error=0.0)
    with pytest.raises(ParameterError, match="correlation length"):
        draw_loads(*known, first.draws(16), middle_of(first), correlation_m=0.0)
