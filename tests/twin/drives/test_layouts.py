"""Public drives as they are laid out: made files of the same layout (synthetic), whose slip and grade are known."""

from pathlib import Path

import numpy as np
import pytest
from made_trials import EASTING_M, HUSKY, NORTHING_M, ROSEY, made_drive, write_captured, write_run

from lunarsci.errors import BatchError, DataError, RequestError
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.drives.layouts import read_public_drive, trials_in
from lunarsci.twin.drives.replay import (
    QuantityScore,
    TrialScore,
    WheelTurns,
    replayed,
    rigid_twist,
    summary_of,
    wheels_alone,
)
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.jobs.compare_trials import compare_trials
from lunarsci.twin.jobs.states import states
from lunarsci.twin.plans.path import Commands, all_commands, make_schedule
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import predict

SHORT = {"speed_m_s": 0.08, "seconds": 18.0, "rate_hz": 5.0}


def slope_deg(terrain: object) -> tuple[float, float]:
    """Along x and y."""
    height, step = terrain.height_m, terrain.spacing_m  # type: ignore[attr-defined]
    grades = (height[0, 1] - height[0, 0]) / step, (height[1, 0] - height[0, 0]) / step
    return tuple(np.degrees(np.arctan(grades)))  # type: ignore[return-value]


def test_a_captured_trial_becomes_telemetry(tmp_path: Path) -> None:
    drive = made_drive(**SHORT, **ROSEY, turn_rad_s=0.05, grade_deg=10.0)
    folder = write_captured(tmp_path / "5.0_160.0_Left_10.0/Trial_1", drive)
    for given in (folder, folder / "Processed_Data.csv"):
        found = read_public_drive(given)
        assert found is not None and (found.rover, found.gravity) == ("rosey", "earth")
    table = found.table
    assert table["angle_RL_deg"].to_numpy() == pytest.approx(np.degrees(drive.angle_rad[:, 2]), abs=1e-6)
    assert table["angle_FR_deg"].to_numpy() == pytest.approx(np.degrees(drive.angle_rad[:, 1]), abs=1e-6)
    assert (table["steered_FL_deg"] == 0).all() and table["synthetic"].all()
    assert table["yaw_deg"].iloc[-1] == pytest.approx(np.degrees(drive.yaw_rad[-1]), abs=0.5)
    # Nose up on a rise is a negative pitch.
    assert table["pitch_deg"].iloc[0] == pytest.approx(-10.0, abs=1e-6)
    grade, across = slope_deg(found.plane())
    assert grade == pytest.approx(10.0, abs=0.3) and across == pytest.approx(0.0, abs=0.3)


def test_encoders_alone_are_in_turns(tmp_path: Path) -> None:
    drive = made_drive(**SHORT, **ROSEY)
    whole, alone = (read_public_drive(write_captured(tmp_path / str(turns), drive, turns=turns)) for turns in (0, 1))
    assert whole is not None and alone is not None
    assert alone.table["angle_FL_deg"].to_numpy() == pytest.approx(whole.table["angle_FL_deg"].to_numpy(), abs=1e-6)
    assert "in rad" in whole.read_as[0] and "in turns" in alone.read_as[0]


def test_a_straight_trial_across_a_slope_knows_it_by_its_roll(tmp_path: Path) -> None:
    drive = made_drive(**SHORT, **ROSEY, grade_deg=8.0)
    found = read_public_drive(write_captured(tmp_path / "along", drive))
    assert found is not None
    place, attitude = found.place_m[:, [1, 0, 2]].copy(), found.attitude_deg.copy()
    place[:, 2] = 0.26
    attitude[:, 0], attitude[:, 1], attitude[:, 2] = 90.0, -8.0, 0.0
    # Heading along y with the left side, which is at smaller x, 8 deg lower: the ground rises along x.
    plane = type(found)(
        name="across", rover="rosey", table=found.table, place_m=place, attitude_deg=attitude, inputs={}, read_as=()
    ).plane()
    grade, across = slope_deg(plane)
    assert grade == pytest.approx(8.0, abs=0.8) and across == pytest.approx(0.0, abs=0.3)


def test_a_run_with_gps_is_moved_to_the_base(tmp_path: Path) -> None:
    drive = made_drive(speed_m_s=0.4, turn_rad_s=0.2, seconds=30.0, **HUSKY)
    found = read_public_drive(write_run(tmp_path / "run1", drive))
    assert found is not None and found.rover == "husky" and "gps-utm18t.txt" in found.read_as[0]
    table = found.table
    fixed = table["x_m"].notna()
    # Rows begin with the first pose, 31 ms after the first reading of an encoder.
    time = table["time_s"].to_numpy() + 0.031
    for k, (name, origin) in enumerate((("x_m", EASTING_M), ("y_m", NORTHING_M))):
        true = origin + np.interp(time[fixed], drive.time_s, drive.place_m[:, k])
        assert np.sqrt(((table[name][fixed] - true) ** 2).mean()) < 0.03
    assert (table["sigma_m"].notna() == fixed).all() and 50 < fixed.sum() < 70
    assert np.isfinite(table[["angle_FL_deg", "yaw_deg"]].to_numpy()).all()
    alone = read_public_drive(write_run(tmp_path / "run2", drive, gps=False))
    assert alone is not None and alone.table["x_m"].notna().sum() > 250


def test_what_is_wrong_with_a_run_is_said(tmp_path: Path) -> None:
    drive = made_drive(speed_m_s=0.4, seconds=10.0, **HUSKY)
    folder = write_run(tmp_path / "run1", drive)
    (folder / "wheel-encoder.txt").write_text("# time [s]\n1.0,2.0\n2.0,3.0\n")
    with pytest.raises(DataError, match="rows of 9 numbers"):
        read_public_drive(folder)
    write_run(folder, drive)
    (folder / "global-pose-utm.txt").write_text("".join(f"{t},0,0,0,0,0,0,1\n" for t in range(3)))
    with pytest.raises(DataError, match="no time in common"):
        read_public_drive(folder)
    (folder / "global-pose-utm.txt").unlink()
    with pytest.raises(DataError, match=r"global-pose-utm\.txt"):
        read_public_drive(folder)
    trial = write_captured(tmp_path / "Trial_1", made_drive(**SHORT, **ROSEY))
    (trial / "Processed_Data.csv").write_text("time_s,pos_x\n0,0\n")
    with pytest.raises(DataError, match="no column pos_y"):
        read_public_drive(trial)
    (tmp_path / "other.csv").write_text("time_s,x_m\n0,0\n")
    assert read_public_drive(tmp_path / "other.csv") is None and read_public_drive(tmp_path) is None


def test_trials_are_found_below_a_folder(tmp_path: Path) -> None:
    drive = made_drive(**SHORT, **ROSEY)
    for name in ("Trial_Data/5.0_Straight_0.0/Trial_1", "Trial_Data/5.0_Straight_0.0/Trial_2", "Off_Nominal_Data/a"):
        write_captured(tmp_path / name, drive)
    write_run(tmp_path / "run1", made_drive(speed_m_s=0.4, seconds=5.0, **HUSKY))
    below = trials_in(str(tmp_path))
    assert [Path(one).name for one in below] == ["Trial_1", "Trial_2", "run1"]
    assert trials_in(below[0]) == [below[0]] and trials_in(str(tmp_path / "*/*/Trial_2")) == [below[1]]
    assert trials_in(str(tmp_path / "Off_Nominal_Data/a")) == [str(tmp_path / "Off_Nominal_Data/a")]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="no drive in it"):
        trials_in(str(tmp_path / "empty"))


def test_states_of_a_trial_are_those_that_were_made(tmp_path: Path) -> None:
    drive = made_drive(**SHORT, **ROSEY, slip=0.15, grade_deg=5.0)
    found = states(write_captured(tmp_path / "Trial_1", drive))
    result = found.to_dict()
    assert result["gravity_m_s2"] == pytest.approx(9.80665) and result["rover"].startswith("RoSEy")
    assert result["synthetic"] and "Rover Mobility" in result["read_as"][0]
    assert result["terrain"]["name"] == "plane below Trial_1"
    true = float(np.median(drive.slip))
    for wheel in result["wheels"].values():
        assert wheel["slip_ratio"]["median"] == pytest.approx(true, abs=0.02)
        assert wheel["side_slip_deg"]["median"] == pytest.approx(0.0, abs=0.5)
    assert str(tmp_path / "Trial_1/Processed_Data.csv") in found.inputs.inputs
    moon = states(tmp_path / "Trial_1", gravity="moon").to_dict()
    assert moon["gravity_m_s2"] == pytest.approx(1.622, abs=0.01)


def test_the_way_of_skid_steered_wheels_is_that_of_a_differential_drive() -> None:
    rover = build_rover("rosey")
    left, right, track = 0.04, 0.06, 2 * rover.rocker_pivot_y_m
    speed = np.tile([left, right], 2)
    twist = rigid_twist(rover, Commands(np.zeros((1, 1, 4)), speed[None, None]))[0]
    assert twist == pytest.approx([0.05, 0.0, (right - left) / track], abs=1e-5)
    time = np.linspace(0.0, 40.0, 401)
    turns = WheelTurns(time, time[:, None] * speed, np.zeros((401, 4)))
    end = wheels_alone(rover, turns, (1.0, 2.0, 90.0), time)[-1]
    turn = 40.0 * (right - left) / track
    radius = 0.05 * 40.0 / turn
    expected = (1.0 - radius * (1 - np.cos(turn)), 2.0 + radius * np.sin(turn), np.pi / 2 + turn)
    assert end == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("name", ["yutu2", "small-four"])
def test_wheels_that_turn_as_planned_drive_as_predicted(name: str) -> None:
    rover = build_rover(name)
    plan = Plan(name="arc", legs=(Leg(length_m=1.0, curvature_per_m=0.3),), speed_m_s=0.05, heading_deg=20.0)
    flat = build_terrain("flat", -5.0, -5.0, 0.5, np.zeros((21, 21)), read_soil("longji"))
    soils = {"friction_angle_deg": np.array([30.0, 45.0])}
    planned = predict(rover, flat, plan, samples=soils)
    schedule = make_schedule(plan, rover)
    times = np.linspace(0.0, schedule.duration_s, 201)
    commands = all_commands(rover, schedule, times)
    rolled = np.vstack([np.zeros(len(rover.wheels)), np.cumsum(commands.speed_m_s[0] * 0.1, axis=0)])
    steered = np.vstack([commands.steering_rad[0, :1], commands.steering_rad[0]])
    turns = WheelTurns(times, rolled, steered)
    found = replayed(rover, flat, turns, (0.0, 0.0, 20.0), soils)
    assert found.finished.all()
    assert found.paths[:, -1, :2] == pytest.approx(planned.paths[:, -1, :2], abs=2e-3)
    assert found.paths[:, -1, 5] == pytest.approx(planned.paths[:, -1, 5], abs=0.2)
    assert found.planned[-1, :2] == pytest.approx(planned.planned[-1, :2], abs=2e-3)


def test_the_summary_counts_values_and_ends() -> None:
    def trial(off: list[float], alone: list[float], held: float | None) -> TrialScore:
        one = QuantityScore(measured=0.1, predicted=0.1, off=np.array(off), off_alone=np.array(alone), in_90=held)
        return TrialScore(trial="t", about={}, scores={"slip_ratio": one}, end_radius_m=None)

    rows = summary_of([trial([0.3, -0.4], [1.0, 1.0], 0.5), trial([0.0], [1.0], 1.0), trial([0.0], [3.0], None)])
    assert len(rows) == 1 and (rows[0]["trials"], rows[0]["values"]) == (3, 4)
    assert rows[0]["rms"] == pytest.approx(0.25) and rows[0]["median_error"] == pytest.approx(0.15)
    assert rows[0]["in_90"] == pytest.approx(2 / 3)
    assert rows[0]["rms_wheels_alone"] == pytest.approx(np.sqrt(3.0))


def test_what_trials_cannot_be_scored_with_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="`plan` belongs to a prediction"):
        compare_trials(str(tmp_path), plan="plan.toml")
    with pytest.raises(RequestError, match="`members` of one soil"):
        compare_trials(str(tmp_path), soil=("longji",), members=5)
    with pytest.raises(BatchError, match="no drive in it"):
        compare_trials(str(tmp_path))


def test_a_bad_trial_is_told_and_progress_counts_it(tmp_path: Path) -> None:
    good = write_captured(tmp_path / "a/Trial_1", made_drive(**SHORT, **ROSEY))
    bad = write_captured(tmp_path / "b/Trial_1", made_drive(**SHORT, **ROSEY))
    (bad / "Processed_Data.csv").write_text("time_s\n0\n")
    heard: list[tuple[int, int]] = []
    found = compare_trials(
        [str(bad), str(good)], soil=("longji",), progress=lambda done, total: heard.append((done, total))
    )
    assert [trial.trial for trial in found.trials] == [str(good)] and heard == [(1, 2), (2, 2)]
    assert len(found.failures) == 1 and found.failures[0].startswith(str(bad))
