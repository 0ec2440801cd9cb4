"""Telemetry that is wrong in one way each: it is found, said, and moves no state unsaid. All of it is synthetic."""

import dataclasses
import re
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.twin.assimilation.residuals import read_record
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.jobs.states import states as measured_states
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict
from lunarsci.twin.telemetry.checks import WheelPace, check_attitude, usable_headings
from lunarsci.twin.telemetry.hypotheses import in_units
from lunarsci.twin.telemetry.reading import Findings, Telemetry, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive, simulate_telemetry
from lunarsci.twin.telemetry.states import DriveStates, motion_table, position_table, states_of, wheel_table
from lunarsci.twin.telemetry.wheel_motion import wheel_motion

Spoil = Callable[[pd.DataFrame], pd.DataFrame]
PLAN = Plan(name="test", legs=(Leg(3.0, 0.15), Leg(2.0, -0.13)), speed_m_s=0.05)
GROUND = synthetic_longji()
WHEELS = ("FL", "FR", "ML", "MR", "RL", "RR")


@pytest.fixture(scope="module")
def drive(yutu2: Rover) -> SyntheticDrive:
    prediction = predict(yutu2, GROUND, PLAN, sweep=(), time_step_s=0.05, sample_m=0.05)
    return simulate_telemetry(prediction, SensorErrors(), 3)


def states(data: bytes, rover: Rover, plan: Plan | None = PLAN) -> DriveStates:
    findings = Findings("sent.csv")
    return states_of(read_telemetry(InputFile("sent.csv", data), rover, findings), rover, GROUND, findings, plan)


def csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False).encode()


def worst(found: DriveStates, drive: SyntheticDrive) -> float:
    """Largest error of a valid slip or side slip in standard errors."""
    rows, prediction = found.rows, drive.prediction
    times = found.nodes.time_s[rows.node]
    largest = 0.0
    for name in ("slip_ratio", "side_slip_deg"):
        column = STATE_COLUMNS.index(name)
        true = np.column_stack(
            [np.interp(times, prediction.time_s, prediction.states[0, :, w, column]) for w in range(6)]
        )
        error = np.abs(getattr(rows, name) - true) / getattr(rows, f"{name}_sigma")
        largest = max(largest, float(error[rows.valid].max()))
    return largest


@pytest.mark.parametrize("errors", [SensorErrors(), SensorErrors(wheel_angle_deg=0.5, wheel_rate_deg_s=1.0)])
def test_wheels_that_turn_as_planned_raise_no_alarm_under_the_noise(
    yutu2: Rover, drive: SyntheticDrive, errors: SensorErrors
) -> None:
    """Of 12 drives none is alarming, at the stated noise and at several times that; a planted 3 % always is."""
    shares = []
    for seed in range(12):
        sent = simulate_telemetry(drive.prediction, errors, seed).telemetry
        findings = Findings("sent.csv")
        told = read_telemetry(InputFile("sent.csv", csv(sent)), yutu2, findings)
        wheels = wheel_motion(told, yutu2, np.zeros(len(told.time_s) - 1, dtype=bool), findings)
        faster = dataclasses.replace(PLAN, speed_m_s=PLAN.speed_m_s / 1.03)
        middles = 0.5 * (told.time_s[1:] + told.time_s[:-1])
        same, other = (WheelPace.of(wheels.rim_m_s, middles, yutu2, plan) for plan in (PLAN, faster))
        assert same is not None and other is not None and not same.off and other.off
        shares.append((same.ratio - 1.0) / same.sigma)
    assert np.abs(shares).max() < 4.0 and 0.2 < float(np.std(shares)) < 1.5


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize("factor", [0.93, 1.07])
def test_encoders_that_differ_from_their_commands_are_no_doubt(
    factor: float, drive: SyntheticDrive, yutu2: Rover
) -> None:
    """Encoders may count wrongly, or motors not obey: slips hold both."""
    other = drive.telemetry.copy()
    for name in columns("angle_{}_deg", "rate_{}_deg_s"):
        other[name] *= factor
    found = states(csv(other), yutu2, None)
    assert found.pace is None and not found.findings.doubt
    assert worst(found, drive) < 3.0


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_a_radius_that_is_5_percent_off_lies_within_the_errors(
    factor: float, drive: SyntheticDrive, yutu2: Rover
) -> None:
    other = drive.telemetry.copy()
    for name in columns("angle_{}_deg", "rate_{}_deg_s", "speed_{}_m_s"):
        other[name] *= factor
    found = states(csv(other), yutu2, None)
    assert not found.findings.doubt and worst(found, drive) < 2.6
    own = np.sqrt(found.rows.slip_ratio_sigma**2 - found.rows.slip_ratio_shared**2)
    assert np.median(found.rows.slip_ratio_shared) > 2.0 * np.median(own[found.rows.valid])


def fix(table: pd.DataFrame, number: int) -> int:
    """Row of a localised position."""
    return int(table.index[table["x_m"].notna()][number])


def test_a_wheel_with_a_column_less_is_known_by_the_others(drive: SyntheticDrive, yutu2: Rover) -> None:
    found = states(csv(drive.telemetry.drop(columns="angle_RR_deg")), yutu2)
    assert found.findings.entries == [] and worst(found, drive) < 3.5


def columns(*forms: str) -> list[str]:
    return [form.format(wheel) for wheel in WHEELS for form in forms]


def set_to(rows: object, names: object, change: Callable[[pd.DataFrame], object]) -> Spoil:
    """A spoiler that changes some cells of a copy."""

    def spoil(table: pd.DataFrame) -> pd.DataFrame:
        table = table.copy()
        table.loc[rows, names] = change(table.loc[rows, names])  # type: ignore[index]
        return table

    return spoil


def at_fix(number: int, names: list[str], change: Callable[[pd.DataFrame], object], stays: bool = False) -> Spoil:
    def spoil(table: pd.DataFrame) -> pd.DataFrame:
        first = fix(table, number)
        return set_to(slice(first, None if stays else first), names, change)(table)

    return spoil


def repeated_fix(table: pd.DataFrame) -> pd.DataFrame:
    table = table.copy()
    for number in (5, 6):
        table.loc[fix(table, number), ["x_m", "y_m"]] = table.loc[fix(table, 4), ["x_m", "y_m"]]
    return table


def test_a_sound_drive_has_no_findings(drive: SyntheticDrive, yutu2: Rover) -> None:
    found = states(csv(drive.telemetry), yutu2)
    assert found.findings.entries == [] and found.findings.doubt == ""
    assert worst(found, drive) < 3.5


ALL, POSITION = slice(None), ["x_m", "y_m"]
SAID: dict[str, tuple[Spoil, str, bool]] = {
    "gap": (lambda t: t[(t.time_s < 30) | (t.time_s > 55)], "gap", False),
    "the same row twice": (lambda t: pd.concat([t.iloc[:20], t.iloc[19:]]), "repeated rows", False),
    "two contents of one time": (
        lambda t: pd.concat([t.iloc[:20], t.iloc[19:20].assign(yaw_deg=9.0), t.iloc[20:]]), "rows of one time", False,
    ),
    "rows out of order": (
        lambda t: t.iloc[[*range(20), 21, 20, *range(22, 50), 52, 50, 51, *range(53, len(t))]], "rows out of order",
        False,
    ),
    "no time": (set_to(slice(30, 33), "time_s", lambda v: np.nan), "no time", False),
    "late": (lambda t: t.iloc[20:], "late begin", False),
    "cut short": (lambda t: t.iloc[:60], "early end", False),
    "before the plan": (set_to(ALL, "time_s", lambda v: v - 5.0), "clock offset", False),
    "dates": (
        lambda t: t.assign(time_s=pd.Timestamp("2026-11-24T10:00:00Z") + pd.to_timedelta(t.time_s, unit="s")),
        "clock offset", False,
    ),
    "rates in rad": (set_to(ALL, columns("rate_{}_deg_s"), np.radians), "read as: rate_W_deg_s looks like rad", False),
    "angles in rad": (set_to(ALL, columns("angle_{}_deg"), np.radians), "read as: angle_W_deg looks like rad", False),
    "turns in rad, nothing else": (
        lambda t: set_to(ALL, columns("angle_{}_deg"), np.radians)(
            t.drop(columns=columns("rate_{}_deg_s", "speed_{}_m_s"))
        ),
        "read as: the turns of the wheels look like rad", False,
    ),
    "speeds in cm": (set_to(ALL, columns("speed_{}_m_s"), lambda v: 100.0 * v), "read as: speed_W_m_s .* cm/s", False),
    "speeds in rad/s": (
        set_to(ALL, columns("speed_{}_m_s"), lambda v: v / 0.15), "read as: speed_W_m_s .* rad/s", False,
    ),
    "speeds backwards": (
        set_to(ALL, columns("speed_{}_m_s"), lambda v: -v), "read as: speed_W_m_s looks like m/s, positive backwards",
        False,
    ),
    "measured steering in rad": (set_to(ALL, columns("steered_{}_deg"), np.radians), "read as: steered_W_deg", False),
    "commanded steering to the right": (
        set_to(ALL, columns("steering_{}_deg"), lambda v: -v), "read as: steering_W_deg .* positive to the right",
        False,
    ),
    "dead rates": (
        set_to(ALL, columns("rate_{}_deg_s"), lambda v: 1e-4 * v), "read as: rate_W_deg_s goes with no other", True,
    ),
    "z down": (lambda t: t.assign(y_m=-t.y_m, yaw_deg=-t.yaw_deg), "read as: .* frame with z down", False),
    "no position errors": (lambda t: t.drop(columns=["xx_m2", "xy_m2", "yy_m2"]), "no position error", False),
    "clock slow": (set_to(ALL, "time_s", lambda v: v * 1.1), "wheels against plan", False),
    "clock jumps": (set_to(slice(50, None), "time_s", lambda v: v + 3.0), "clock step", True),
    "encoder reset": (set_to(slice(40, None), "angle_FL_deg", lambda v: v - v.iloc[0]), "encoder reset", False),
    "encoder wraps": (set_to(ALL, columns("angle_{}_deg"), lambda v: v % 360.0), "encoder wrap", False),
    "encoder wraps, nothing else": (
        lambda t: t.drop(columns=columns("rate_{}_deg_s", "speed_{}_m_s")).assign(
            **{name: t[name] % 360.0 for name in columns("angle_{}_deg")}
        ),
        "encoder wrap", False,
    ),
    "stuck encoder": (set_to(slice(30, 60), "angle_ML_deg", lambda v: v.iloc[0]), "stuck", False),
    "stuck rate": (set_to(slice(30, 60), "rate_ML_deg_s", lambda v: 3.0 * v.iloc[0]), "odd rate", False),
    "stuck steering": (set_to(ALL, "steered_FL_deg", lambda v: 3.0), "stuck", False),
    "spike of steering": (set_to(44, "steered_FL_deg", lambda v: 60.0), "odd steering", False),
    "stuck heading": (set_to(slice(30, 60), "yaw_deg", lambda v: v.iloc[0]), "repeated heading", False),
    "stuck position": (repeated_fix, "repeated position", False),
    "blank wheel": (
        set_to(slice(30, 60), ["angle_ML_deg", "rate_ML_deg_s"], lambda v: np.nan), "missing readings", False,
    ),
    "blank heading": (set_to(slice(30, 60), "yaw_deg", lambda v: np.nan), "missing headings", False),
    "blank steering": (
        set_to(slice(30, 60), columns("steering_{}_deg", "steered_{}_deg"), lambda v: np.nan),
        "missing steering", False,
    ),
    "infinite": (at_fix(4, ["x_m"], lambda v: np.inf), "infinite values", False),
    "no encoders": (lambda t: t.drop(columns=columns("angle_{}_deg", "rate_{}_deg_s")), "no encoders", False),
    "no heading errors": (lambda t: t.drop(columns="yaw_deg_sigma"), "no heading error", False),
    "position jumps": (at_fix(5, ["x_m"], lambda v: v + 0.3), "position jump", False),
    "positions shift": (at_fix(5, ["x_m"], lambda v: v + 0.5, stays=True), "position shift", True),
    "no positions for long": (
        lambda t: t.assign(x_m=t.x_m.where(~t.time_s.between(25, 85)), y_m=t.y_m.where(~t.time_s.between(25, 85))),
        "far positions", False,
    ),
    "no covariance": (at_fix(5, ["xy_m2"], lambda v: 1.0), "bad covariance", False),
    "errors in another unit": (set_to(ALL, ["xx_m2", "yy_m2"], lambda v: v * 1e6), "read as", False),
    "errors far too small": (set_to(ALL, ["xx_m2", "yy_m2"], lambda v: v * 1e-4), "errors too small", True),
    "frame turned": (
        lambda t: t.assign(x_m=-t.y_m, y_m=t.x_m, yaw_deg=t.yaw_deg + 90.0), "attitude against terrain", True,
    ),
    "pitch nose up": (set_to(ALL, "pitch_deg", lambda v: -v), "attitude against terrain", True),
    "heading off": (set_to(ALL, "yaw_deg", lambda v: v + 5.0), "constant side slip", False),
    "wheels of another size": (
        set_to(ALL, columns("angle_{}_deg", "rate_{}_deg_s"), lambda v: v * 0.93), "wheels against plan", False,
    ),
    "heading in rad": (set_to(ALL, "yaw_deg", np.radians), "read as: yaw_deg looks like rad", False),
    "positions in mm": (set_to(ALL, POSITION, lambda v: 1000.0 * v), "read as: x_m and y_m look like mm", False),
    "x and y exchanged": (lambda t: t.assign(x_m=t.y_m, y_m=t.x_m), "read as: x_m and y_m are exchanged", False),
    "y to the right": (set_to(ALL, "y_m", lambda v: -v), "read as: y_m points to the right", False),
    "heading to the right": (set_to(ALL, "yaw_deg", lambda v: -v), "read as: yaw_deg grows to the right", False),
    "compass": (set_to(ALL, "yaw_deg", lambda v: 90.0 - v), r"read as: .* from y \(north\) clockwise", False),
    "backwards": (set_to(ALL, "yaw_deg", lambda v: v + 180.0), "read as: yaw_deg points backwards", False),
}  # fmt: skip
# What a finding says has moved: a heading that is off is side slip, and the truth is of other wheels.
MOVED = ("heading off", "wheels of another size", "no encoders")


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize("name", list(SAID))
def test_what_is_wrong_is_said_and_does_no_harm(name: str, drive: SyntheticDrive, yutu2: Rover) -> None:
    spoil, kind, doubt = SAID[name]
    spoiled = spoil(drive.telemetry)
    with pytest.warns(LunarSciWarning, match=kind):
        found = states(csv(spoiled), yutu2)
    entries = [entry for entry in found.findings.entries if entry.kind == kind.partition(":")[0]]
    assert entries and entries[0].what and entries[0].done and entries[0].count >= 1
    assert any(entry.doubt for entry in entries) is doubt
    assert bool(found.findings.doubt) is doubt
    if not doubt and name not in MOVED:
        assert worst(found, drive) < 3.8


def test_rows_of_one_time_that_hold_parts_of_it_are_one_row(drive: SyntheticDrive, yutu2: Rover) -> None:
    """As where each message of a log is a row."""
    places = ["x_m", "y_m", "xx_m2", "xy_m2", "yy_m2", "yaw_deg", "yaw_deg_sigma"]
    wheels, poses = drive.telemetry.copy(), drive.telemetry.copy()
    wheels[places] = np.nan
    poses[[name for name in poses if name not in [*places, "time_s", "synthetic"]]] = np.nan
    mixed = pd.concat([wheels, poses]).sort_values("time_s", kind="stable")
    found = states(csv(mixed), yutu2)
    assert found.findings.entries == []
    assert found.rows.slip_ratio == pytest.approx(states(csv(drive.telemetry), yutu2).rows.slip_ratio, abs=1e-12)


STEERED = re.compile("steer")
REFUSED: dict[str, tuple[Spoil, str]] = {
    "clock reset": (set_to(slice(50, None), "time_s", lambda v: v - v.iloc[0]), "time runs backwards"),
    "speeds alone, in cm": (
        lambda t: set_to(ALL, columns("speed_{}_m_s"), lambda v: 100.0 * v)(
            t.drop(columns=columns("rate_{}_deg_s", "angle_{}_deg"))
        ),
        "speed_W_m_s looks like cm/s, or speed_W_m_s looks like mm/s",
    ),
    "no covariance at all": (set_to(ALL, ["xx_m2"], lambda v: -v), "11 have errors that are missing or wrong"),
    "one position": (lambda t: t.assign(x_m=t.x_m.where(t.index == 0)), "1 positions of use"),
    "wheels of another rover": (
        lambda t: t.rename(columns=lambda c: c.replace("_ML_", "_M1_").replace("_MR_", "_M2_")), "'M1' is no wheel",
    ),
    "too few wheels": (
        lambda t: t.drop(columns=[c for c in t if "_ML_" in c or "_MR_" in c]), "file has the wheels FL, FR, RL, RR",
    ),
    "several columns": (
        lambda t: t.drop(columns=["x_m", "yaw_deg", *filter(STEERED.match, t)]).assign(vo_x=0, odom_x=0),
        r"missing: x_m \(vo_x\?\), yaw_deg, steered_W_deg or steering_W_deg of each wheel W; .* template telemetry",
    ),
    "no dates": (lambda t: t.assign(time_s="2026-11-24Tx"), "is no date that can be read; give dates as 2026-11-24T10"),
    "text": (lambda t: t.assign(yaw_deg=["east", *t.yaw_deg[1:]]), "'east' is no number"),
    "too short": (lambda t: t.iloc[:4], "4 rows with a time"),
    "still": (
        set_to(ALL, columns("angle_{}_deg", "rate_{}_deg_s", "speed_{}_m_s"), lambda v: 0.0 * v), "no wheel turns",
    ),
    "no heading": (lambda t: t.assign(yaw_deg=np.nan), "0 headings of use"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_be_used_is_refused_with_a_reason(name: str, drive: SyntheticDrive, yutu2: Rover) -> None:
    spoil, says = REFUSED[name]
    with pytest.raises(DataError, match=says) as raised:
        states(csv(spoil(drive.telemetry)), yutu2)
    assert "sent.csv" in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_plan_at_another_speed_is_told_from_another_plan(drive: SyntheticDrive, yutu2: Rover) -> None:
    """By the way the commands are the same."""
    with pytest.warns(LunarSciWarning, match=r"turned 1.6\d+ ± \S+ times as fast .* write speed_m_s = 0.0[45]"):
        found = states(csv(drive.telemetry), yutu2, Plan(name="slower", legs=PLAN.legs, speed_m_s=0.03))
    assert not found.findings.doubt and worst(found, drive) < 3.5


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_telemetry_of_another_plan_is_in_doubt_and_has_states(drive: SyntheticDrive, yutu2: Rover) -> None:
    plan = Plan(name="other", legs=(Leg(3.0, -0.15), Leg(2.0, 0.13)), speed_m_s=0.05)
    found = states(csv(drive.telemetry), yutu2, plan)
    (said,) = [one for one in found.findings.entries if one.kind == "other commands"]
    assert said.doubt and "give the plan as it was driven, and its `rover`" in said.done
    assert re.search("first .* planned", said.what) and said.time_s is not None
    assert worst(found, drive) < 3.5


@pytest.mark.parametrize(
    ("plan", "first_s"),
    [
        (dataclasses.replace(PLAN, blend_m=1.0), 54.6),
        (dataclasses.replace(PLAN, legs=(Leg(1.0, 0.15), Leg(1.2), Leg(0.8, 0.15), Leg(2.0, -0.13))), 20.0),
        (dataclasses.replace(PLAN, legs=(Leg(2.9, 0.15), Leg(2.1, -0.13))), 57.4),
    ],
    ids=["blended otherwise", "another arc", "a join 0.1 m before"],
)
def test_commands_that_differ_are_said_with_their_time_and_wheel(
    plan: Plan, first_s: float, drive: SyntheticDrive, yutu2: Rover
) -> None:
    """Steering is off by 2 deg from 0.27 m before the join at 3 m, or from the middle of the first one at 1 m."""
    with pytest.warns(LunarSciWarning, match="other commands"):
        found = states(csv(drive.telemetry), yutu2, plan)
    entry = next(entry for entry in found.findings.entries if entry.kind == "other commands")
    assert entry.doubt and entry.time_s is not None
    assert abs(entry.time_s - first_s) < 1.5
    told = re.search(r"first steering of FL is (-?[\d.]+) deg, planned (-?[\d.]+)$", entry.what)
    assert told is not None and abs(float(told[1]) - float(told[2])) > 2.0
    column = np.interp(entry.time_s, drive.telemetry.time_s, drive.telemetry.steering_FL_deg)
    assert float(told[1]) == pytest.approx(column, abs=0.1)
    assert "`blend_m` is half before a join" in entry.done


def test_another_start_is_said(drive: SyntheticDrive, yutu2: Rover) -> None:
    import dataclasses

    with pytest.warns(LunarSciWarning, match="another start"):
        found = states(csv(drive.telemetry), yutu2, dataclasses.replace(PLAN, x_m=3.0))
    assert "plan's start" in found.findings.doubt


@pytest.mark.parametrize("spoil", [set_to(ALL, columns("steered_{}_deg", "steering_{}_deg"), lambda v: -v)])
def test_wheels_that_contradict_each_other_are_in_doubt_without_a_plan(
    spoil: Spoil, drive: SyntheticDrive, yutu2: Rover
) -> None:
    with pytest.warns(LunarSciWarning, match="wheels disagree"):
        found = states(csv(spoil(drive.telemetry)), yutu2, None)
    assert "wheels disagree" in found.findings.doubt


@pytest.mark.parametrize("letters", [3, 40, 300])
def test_a_last_line_that_is_cut_is_left_out(letters: int, drive: SyntheticDrive, yutu2: Rover) -> None:
    data = csv(drive.telemetry)
    with pytest.warns(LunarSciWarning, match="truncated"):
        found = states(data[:-letters], yutu2)
    assert len(found.telemetry.time_s) == len(drive.telemetry) - 1
    assert worst(found, drive) < 3.5


def test_a_line_cut_in_the_middle_of_a_file_is_refused(drive: SyntheticDrive, yutu2: Rover) -> None:
    lines = csv(drive.telemetry).splitlines(keepends=True)
    lines[40] = lines[40][:60] + b"\n"
    with pytest.raises(DataError, match=r"line 41: .* fields"):
        states(b"".join(lines), yutu2)


def test_there_are_no_states_within_a_gap(drive: SyntheticDrive, yutu2: Rover) -> None:
    table = drive.telemetry
    with pytest.warns(LunarSciWarning, match="gap"):
        found = states(csv(table[(table.time_s < 30) | (table.time_s > 55)]), yutu2)
    times = found.nodes.time_s[found.rows.node]
    assert not ((times > 29) & (times < 56)).any()
    assert found.gaps == pytest.approx(np.array([[29.0, 56.0]]), abs=1.01)


def test_wheels_at_rest_to_the_last_digit_after_a_drive_are_a_halt(drive: SyntheticDrive, yutu2: Rover) -> None:
    """Rows that go on after the drive, with rates of exactly 0: a curvature of 0 / 0 has no end."""
    table = drive.telemetry
    last = table.iloc[[-1] * 20].reset_index(drop=True)
    step = float(np.median(np.diff(table["time_s"])))
    last["time_s"] += step * np.arange(1, 21)
    last[[*columns("speed_{}_m_s", "rate_{}_deg_s")]] = 0.0
    last[["x_m", "y_m", "xx_m2", "xy_m2", "yy_m2"]] = np.nan
    with pytest.warns(LunarSciWarning):
        found = states(csv(pd.concat([table, last], ignore_index=True)), yutu2)
    assert found.rows.valid.sum() > 50 and np.isfinite(found.smoothed.state).all()
    assert worst(found, drive) < 4.5


def test_a_blank_sensor_makes_its_own_states_not_valid(drive: SyntheticDrive, yutu2: Rover) -> None:
    blank = set_to(slice(30, 60), ["angle_ML_deg", "rate_ML_deg_s"], lambda v: np.nan)
    with pytest.warns(LunarSciWarning, match="missing readings"):
        found = states(csv(blank(drive.telemetry)), yutu2)
    times = found.nodes.time_s[found.rows.node]
    inside = (times > 31) & (times < 59)
    assert inside.any() and not found.rows.valid[inside, 2].any()
    assert found.rows.valid[:, [0, 1, 3, 4, 5]].all()


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_slip_beyond_the_wheel_model_is_in_medians_and_in_doubt(drive: SyntheticDrive, yutu2: Rover) -> None:
    """From the middle of the drive on the rover comes 0.3 of the way that it came: medians left that out unsaid."""
    table = drive.telemetry.copy()
    fixed = np.flatnonzero(table["x_m"].notna())
    late = fixed[len(fixed) // 3 :]
    place = table.loc[late, ["x_m", "y_m"]].to_numpy()
    table.loc[late, ["x_m", "y_m"]] = place[0] + 0.3 * (place - place[0])
    found = measured_states(InputFile("sent.csv", csv(table)))
    rows, own = found.drive.rows, found.to_dict()["wheels"]["FL"]
    assert rows.fast.any() and not (rows.fast & rows.valid).any() and (rows.slip_ratio[rows.fast] > 0.6).all()
    assert own["slip_ratio"]["median"] > 0.65 and own["measured"] > 2 * own["valid"]
    (fast,) = [one for one in found.drive.findings.entries if one.kind == "fast slip"]
    assert fast.count == int(rows.fast.sum()) and not found.untrusted
    assert found.tables["states.csv"]["doubt"].str.startswith("fast slip").all()
    with pytest.warns(LunarSciWarning, match=rf"{fast.count} slip by more than 0.6"):
        read_record(InputFile("states.csv", csv(found.tables["states.csv"])), yutu2)


def test_a_rover_with_a_blank_sensor_still_stands_on_the_terrain(drive: SyntheticDrive, yutu2: Rover) -> None:
    blank = set_to(slice(40, None), ["angle_FR_deg", "rate_FR_deg_s", "speed_FR_m_s"], lambda v: np.nan)
    with pytest.warns(LunarSciWarning, match="missing readings"):
        found = states(csv(blank(drive.telemetry)), yutu2)
    assert {one.kind for one in found.findings.entries} == {"missing readings"} and not found.findings.doubt
    assert not found.rows.measured[-1, 1] and found.rows.measured[:, [0, 2, 3, 4, 5]].all()


def test_a_rover_that_steers_only_when_it_starts_is_no_doubt(drive: SyntheticDrive, yutu2: Rover) -> None:
    table, names = drive.telemetry.copy(), columns("steering_{}_deg", "steered_{}_deg")
    table.loc[:3, names] = 0.0
    with pytest.warns(LunarSciWarning, match="all of them at its start"):
        assert not states(csv(table), yutu2).findings.doubt
    later = drive.telemetry.copy()
    later.loc[20:24, names] = 0.0
    with pytest.warns(LunarSciWarning, match="other commands"):
        assert "other commands" in states(csv(later), yutu2).findings.doubt


@pytest.mark.parametrize(("off_m", "out"), [(0.02, 0), (0.5, 1)])
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_the_last_position_is_left_out_for_a_jump_alone(
    off_m: float, out: int, drive: SyntheticDrive, yutu2: Rover
) -> None:
    """Slip may change behind the last but one: 2 cm more or less of way are one of 0.05 to 0.1."""
    table = drive.telemetry.copy()
    last = np.flatnonzero(table["x_m"].notna())[-1]
    yaw = np.radians(table.loc[last, "yaw_deg"])
    table.loc[last, ["x_m", "y_m"]] -= off_m * np.array([np.cos(yaw), np.sin(yaw)])
    assert len(states(csv(table), yutu2).left_out) == out


def test_headings_that_pass_half_a_turn_are_the_same(drive: SyntheticDrive, yutu2: Rover) -> None:
    plain = states(csv(drive.telemetry), yutu2)
    table = drive.telemetry.copy()
    table["yaw_deg"] += 360.0 * (table.index % 2)
    wrapped = states(csv(table), yutu2)
    assert wrapped.rows.slip_ratio == pytest.approx(plain.rows.slip_ratio, abs=1e-9)


def test_another_rover_needs_its_own_wheels(drive: SyntheticDrive) -> None:
    with pytest.raises(DataError, match="'ML' is no wheel of"):
        states(csv(drive.telemetry), build_rover("small-four"), None)


@pytest.mark.parametrize("begins", [1_700_000_000.5, 3600.0])
def test_times_of_another_clock_are_said_with_their_start_and_taken_from_there(
    begins: float, drive: SyntheticDrive, yutu2: Rover
) -> None:
    late = csv(drive.telemetry.assign(time_s=drive.telemetry.time_s + begins))
    with pytest.warns(LunarSciWarning, match=r"clock is [\d.]+ s late; .* as `start_time` [\d.]+ has"):
        taken = states(late, yutu2)
    # By the turns of the wheels, whose encoders have errors: 0.05 s are 2.5 mm of way.
    assert taken.telemetry.start_s == pytest.approx(begins, abs=0.05) and not taken.findings.doubt
    assert taken.telemetry.time_s[-1] == pytest.approx(float(drive.telemetry.time_s.iloc[-1]), abs=0.05)
    findings = Findings("sent.csv")
    told = read_telemetry(InputFile("sent.csv", late), yutu2, findings, start_s=begins)
    found = states_of(told, yutu2, GROUND, findings, PLAN)
    assert found.findings.entries == []
    assert found.rows.slip_ratio == pytest.approx(states(csv(drive.telemetry), yutu2).rows.slip_ratio, abs=1e-5)


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_by_another_clock_telemetry_may_begin_after_its_plan(drive: SyntheticDrive, yutu2: Rover) -> None:
    """The place of its turn from one arc to the next tells when the plan began, to some centimetres of way."""
    found = states(csv(drive.telemetry.iloc[20:].assign(time_s=lambda rows: rows.time_s + 5000.0)), yutu2)
    assert found.telemetry.start_s == pytest.approx(5000.0, abs=1.0) and not found.findings.doubt
    assert {"clock offset", "late begin"} <= {one.kind for one in found.findings.entries}


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_by_another_clock_rests_gaps_and_halts_have_the_times_of_the_plan(drive: SyntheticDrive, yutu2: Rover) -> None:
    table = halted(drive.telemetry, 40, 60, rates=True)
    table = table[(table.time_s < 120) | (table.time_s > 135)].assign(time_s=lambda rows: rows.time_s + 5000.0)
    findings = Findings("sent.csv")
    told = read_telemetry(InputFile("sent.csv", csv(table)), yutu2, findings)
    told = dataclasses.replace(told, rests_s=((5050.0, 5090.0),))
    found = states_of(told, yutu2, GROUND, findings, PLAN)
    assert found.telemetry.start_s == pytest.approx(5000.0, abs=0.05)
    assert found.telemetry.rests_s[0] == pytest.approx((50.0, 90.0), abs=0.05) and found.telemetry.rested.sum() == 40
    times = {one.kind: one.time_s for one in findings.entries}
    begin = float(drive.telemetry.time_s[40])
    assert times["unplanned halt"] == pytest.approx(begin, abs=1.1)
    assert times["gap"] == pytest.approx(119.0, abs=1.1) == pytest.approx(found.gaps[0, 0], abs=1.1)


def halted(table: pd.DataFrame, row: int, seconds: int, *, rates: bool) -> pd.DataFrame:
    """The rover stands still after a row; its wheels tell angles alone where `rates` are not wanted."""
    begin, own = float(table.time_s[row]), np.random.default_rng(1)
    still = pd.concat([table.iloc[[row]]] * seconds, ignore_index=True).assign(x_m=np.nan, y_m=np.nan)
    still["time_s"] = begin + 1.0 + still.index
    still[columns("speed_{}_m_s", "rate_{}_deg_s")] = 0.0
    noisy = ["yaw_deg", "roll_deg", "pitch_deg", *columns("angle_{}_deg")]
    still[noisy] += own.normal(0.0, 0.1, (seconds, len(noisy)))
    after = table.iloc[row + 1 :].assign(time_s=lambda rest: rest.time_s + seconds)
    whole = pd.concat([table.iloc[: row + 1], still, after], ignore_index=True)
    return whole if rates else whole.drop(columns=columns("speed_{}_m_s", "rate_{}_deg_s"))


@pytest.mark.parametrize("rates", [True, False])
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_halt_that_the_plan_lacks_is_told_from_a_late_clock(rates: bool, drive: SyntheticDrive, yutu2: Rover) -> None:
    """And with the stop that is proposed the plan is that of the drive."""
    sent = csv(halted(drive.telemetry, 40, 60, rates=rates))
    found = states(sent, yutu2)
    (halt,) = [one for one in found.findings.entries if one.kind == "unplanned halt"]
    assert "from 4" in halt.what and "no halt there" in halt.what
    # The states are right; a soil learned with the plan, whose times are others, is not.
    assert not found.findings.doubt and wheel_table(found)["doubt"].str.contains("before `twin update` split").all()
    assert "doubt" not in motion_table(found)
    assert not {"clock offset", "other commands", "late end"} & {one.kind for one in found.findings.entries}
    way, stop = (float(part) for part in re.findall(r"([\d.]+)(?: m,| between)", halt.done))
    assert halt.time_s is not None and abs(halt.time_s - float(drive.telemetry.time_s[40])) < 1.5
    mended = dataclasses.replace(PLAN, legs=(Leg(way, 0.15), Leg(stop_s=stop), Leg(3.0 - way, 0.15), PLAN.legs[1]))
    assert not any(one.kind == "unplanned halt" for one in states(sent, yutu2, mended).findings.entries)
    short = dataclasses.replace(mended, legs=(mended.legs[0], Leg(stop_s=stop - 20.0), *mended.legs[2:]))
    (longer,) = [one for one in states(sent, yutu2, short).findings.entries if one.kind == "unplanned halt"]
    (again,) = re.findall(r"set stop_s = ([\d.]+) in leg 2", longer.done)
    assert float(again) == pytest.approx(stop, abs=1.0)


@pytest.mark.parametrize(
    ("alike", "turn_deg", "digit_deg", "sigma_deg", "left_out"),
    [
        (10, 0.0, 0.04, 0.1, 9),
        (4, 0.0, 0.001, 0.1, 3),
        (3, 0.0, 0.04, 0.1, 0),
        (10, 0.0, 0.3, 0.1, 0),
        (3, 4.0, 0.3, 0.1, 2),
        (3, 0.5, 0.3, 0.1, 0),
        (3, 4.0, 0.6, 2.0, 0),
        (2, 9.0, 0.3, 0.1, 1),
    ],
)
def test_a_heading_that_repeats_is_held_where_noise_or_a_turn_would_have_changed_it(
    alike: int, turn_deg: float, digit_deg: float, sigma_deg: float, left_out: int
) -> None:
    """A fine digit below the noise repeats by chance in few rows; a coarse one tells nothing, unless the wheels turned
    by many errors. The first of the rows that are alike stays."""
    number = np.arange(30.0)
    yaw = 40.0 + digit_deg * np.where(number < 8, number, np.maximum(8, number - alike + 1))
    turned = turn_deg * np.clip((number - 8) / (alike - 1), 0.0, 1.0)
    none, wheels = np.full(30, np.nan), np.full((30, 6), np.nan)
    sent = Telemetry(
        file="sent.csv", time_s=number, fix_m=wheels[:, :2], fix_covariance_m2=np.full((30, 2, 2), np.nan),
        yaw_deg=yaw, yaw_deg_sigma=np.full(30, sigma_deg), roll_deg=none, pitch_deg=none, speed_m_s=wheels,
        steering_deg=wheels, angle_deg=wheels, rate_deg_s=wheels, steered_deg=wheels, synthetic=True,
    )  # fmt: skip
    findings = Findings("sent.csv")
    with pytest.warns(LunarSciWarning, match="repeated heading at time_s 9") if left_out else nullcontext():
        kept = usable_headings(sent, turned, findings).yaw_deg
    expected = np.where((number > 8) & (number < 9 + left_out), np.nan, yaw)
    assert kept == pytest.approx(expected, nan_ok=True)
    assert [entry.count for entry in findings.entries] == [left_out][: min(left_out, 1)]


@pytest.mark.parametrize("name", ["roll_deg", "pitch_deg"])
@pytest.mark.parametrize(
    ("stood_deg", "measured_deg", "said"),
    [
        (0.5, 1.9, None),
        (0.5, -0.8, None),
        (0.5, 2.1, "1.6 deg in .* its sensor is turned by 1.6 deg"),
        (-2.0, -3.3, None),
        (-2.0, -0.4, "1.6 deg in .* its sensor is turned"),
        (10.0, 15.9, None),
        (10.0, 3.9, "6.1 deg in the median: it is of another"),
        (4.0, -4.0, "it has the other sign"),
        (20.0, 0.35, "it looks like rad"),
    ],
)
def test_attitude_differs_from_the_terrains_by_a_degree_and_a_half_or_60_percent_of_a_slope(
    name: str, stood_deg: float, measured_deg: float, said: str | None
) -> None:
    """Up to 3 deg, if all of it is alike, are no doubt. In the median: two rows of nine are wild, two have no value."""
    stood, measured = np.full(9, stood_deg), np.full(9, measured_deg)
    measured[[1, 2, 6, 7]] = 80.0, -90.0, np.nan, np.nan
    other = np.zeros(9)
    columns = {"roll_deg": other, "pitch_deg": other} | {name: np.append(measured, 70.0)}
    paths = np.column_stack([other] * 3 + ([stood, other] if name == "roll_deg" else [other, stood]) + [other])
    sent: Any = SimpleNamespace(**columns)
    held: Any = SimpleNamespace(paths=paths)
    findings = Findings("sent.csv")
    with nullcontext() if said is None else pytest.warns(LunarSciWarning, match=f"{name} differs .*{said}"):
        check_attitude(sent, held, np.arange(9), findings)
    assert len(findings.entries) == (said is not None)
    assert bool(findings.doubt) == (said is not None and "turned" not in said)


TURNING = Plan(
    name="turning", legs=(Leg(2.5, 0.2), Leg(turn_deg=40.0), Leg(stop_s=20.0), Leg(2.5, -0.2)), speed_m_s=0.05
)


@pytest.fixture(scope="module")
def turning(yutu2: Rover) -> SyntheticDrive:
    prediction = predict(yutu2, GROUND, TURNING, sweep=(), time_step_s=0.05, sample_m=0.05)
    return simulate_telemetry(prediction, SensorErrors(fix_sigma_m=0.01), 4)


def drifting(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(yaw_deg=table.yaw_deg + 6.0 * table.time_s / table.time_s.iloc[-1])


def of_a_mast(table: pd.DataFrame) -> pd.DataFrame:
    yaw = np.radians(table.yaw_deg)
    x, y = (0.3 * np.cos(yaw) + 0.2 * np.sin(yaw), 0.3 * np.sin(yaw) - 0.2 * np.cos(yaw))
    return table.assign(x_m=table.x_m + x, y_m=table.y_m + y)


SHARED: dict[str, tuple[Spoil, str]] = {
    "none": (lambda t: t, ""),
    "heading drifts by 6 deg": (drifting, r"headings drift by [3-8]\.\d+ \+-"),
    "mast ahead, to the right": (of_a_mast, r"a point 0\.\d+ \+- \S+ m ahead and -0\.\d+ \+- \S+ m to the left"),
    "one encoder": (set_to(ALL, ["angle_ML_deg", "rate_ML_deg_s"], lambda v: 0.88 * v), r"wheel ML turns 0\.88"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize("name", list(SHARED))
def test_what_a_whole_drive_shares_is_found_and_lies_within_the_errors(
    name: str, turning: SyntheticDrive, yutu2: Rover
) -> None:
    """Slips, and the pose at the end, from which the next drive is planned."""
    spoil, says = SHARED[name]
    found = states(csv(spoil(turning.telemetry)), yutu2, TURNING)
    assert not found.findings.doubt and len(
        [one for one in found.findings.entries if one.kind != "odd heading"]
    ) == len(says[:1])
    assert re.search(says, " ".join(entry.what for entry in found.findings.entries))
    assert worst(found, turning) < 4.0
    path, covariance = turning.prediction.paths[0, -1], found.smoothed.covariance[-1, :2, :2]
    off = np.array([found.motion.x_m[-1] - path[0], found.motion.y_m[-1] - path[1]])
    assert off @ np.linalg.solve(covariance, off) < 9.2 and np.hypot(*off) < 0.1
    # What the next update reads: of the origin, not of the mast.
    out, at = turning.prediction, found.positions.time_s
    true = np.column_stack([np.interp(at, out.time_s, out.paths[0, :, k]) for k in (0, 1)])
    assert np.median(np.hypot(*(found.positions.place_m - true).T)) < 0.06


def test_positions_that_repeat_the_way_of_the_wheels_teach_no_slip(drive: SyntheticDrive, yutu2: Rover) -> None:
    table, steps = drive.telemetry.copy(), np.diff(drive.telemetry.time_s)
    yaw, speed = np.radians(table.yaw_deg), table.speed_ML_m_s + table.speed_MR_m_s
    middle, ahead = 0.5 * (yaw[1:].to_numpy() + yaw[:-1].to_numpy()), 0.5 * speed[:-1].to_numpy() * steps
    for column, part in (("x_m", np.cos(middle)), ("y_m", np.sin(middle))):
        rolled = np.append(0.0, np.cumsum(part * ahead)) + 0.0005 * np.random.default_rng(1).normal(size=len(table))
        table[column] = np.where(table[column].notna(), rolled, np.nan)
    with pytest.warns(LunarSciWarning, match="positions are odometry"):
        found = states(csv(table), yutu2)
    assert "no slip can be learned" in found.findings.doubt


BENDS = Plan(name="more bends", legs=(Leg(1.5, 0.3), Leg(1.5, -0.3), Leg(2.5, 0.25)), speed_m_s=0.05)
STEERS = Plan(name="bends", legs=(Leg(1.5, 0.3), Leg(1.5, -0.3), Leg(1.5, 0.25)), speed_m_s=0.05)


def as_sent(yutu2: Rover, plan: Plan, later_s: float, seed: int = 5) -> SyntheticDrive:
    """Telemetry of a drive whose positions and headings are by a clock that is so much late."""
    out = predict(yutu2, GROUND, plan, sweep=(), time_step_s=0.05, sample_m=0.05)
    times, path = out.time_s, out.paths[0]
    begin, end = ((path[a] - path[b]) / (times[a] - times[b]) for a, b in ((1, 0), (-1, -2)))
    late = np.column_stack([np.interp(times - later_s, times, column) for column in path.T])
    late += np.minimum(times - later_s - times[0], 0.0)[:, None] * begin
    late += np.maximum(times - later_s - times[-1], 0.0)[:, None] * end
    return simulate_telemetry(dataclasses.replace(out, paths=late[None]), SensorErrors(), seed)


@pytest.mark.parametrize("later_s", [0.5, 1.0, -0.5])
def test_a_lag_is_said_with_its_number_and_put_back(later_s: float, yutu2: Rover) -> None:
    drive = as_sent(yutu2, STEERS, later_s)
    with pytest.warns(LunarSciWarning, match=rf"lag: the rover moves .* {'later' if later_s > 0 else 'earlier'} than"):
        found = states(csv(drive.telemetry), yutu2, STEERS)
    assert found.lag.likely and abs(found.lag.lag_s - later_s) < 3.0 * found.lag.sigma_s < 0.5
    assert not found.findings.doubt
    findings = Findings("sent.csv")
    sent = read_telemetry(InputFile("sent.csv", csv(drive.telemetry)), yutu2, findings)
    mended = states_of(sent, yutu2, GROUND, findings, STEERS, later_s)
    assert not mended.lag.likely and not mended.findings.doubt
    # Positions are at the time of their wheels.
    first = sent.time_s[sent.fixed][1]
    assert np.abs(mended.nodes.time_s[mended.nodes.fixed] - (first - later_s)).min() < 1e-9


def test_honest_clocks_have_no_lag_and_one_arc_does_not_tell(yutu2: Rover) -> None:
    honest = states(csv(as_sent(yutu2, STEERS, 0.0).telemetry), yutu2, STEERS)
    assert not honest.lag.likely and not honest.findings.entries and honest.lag.sigma_s < 0.2
    straight = dataclasses.replace(STEERS, legs=(Leg(3.0, 0.0),))
    one_arc = states(csv(as_sent(yutu2, straight, 1.0).telemetry), yutu2, straight)
    assert not one_arc.lag.likely


@pytest.mark.parametrize("later_s", [6.0, -8.0])
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_lag_of_many_seconds_is_found_by_turns(later_s: float, yutu2: Rover) -> None:
    found = states(csv(as_sent(yutu2, BENDS, later_s).telemetry), yutu2, BENDS)
    assert found.lag.likely and not found.findings.doubt and abs(found.lag.lag_s - later_s) < 0.3


def test_positions_are_by_the_clock_of_the_wheels_and_without_the_one_that_is_wrong(yutu2: Rover) -> None:
    drive = as_sent(yutu2, BENDS, 2.0)
    table = drive.telemetry.copy()
    fixes = np.flatnonzero(table.x_m.notna())
    wrong = fixes[len(fixes) // 2]
    table.loc[wrong, "x_m"] += 0.4
    with pytest.warns(LunarSciWarning) as said:
        found = states(csv(table), yutu2, BENDS)
    assert any("position" in str(one.message) and "no motion" in str(one.message) for one in said)
    sent_s = np.delete(table.time_s.to_numpy()[fixes], len(fixes) // 2)
    assert found.positions.time_s == pytest.approx(sent_s[sent_s >= 2.0] - found.lag.lag_s, abs=0.6)
    honest = predict(yutu2, GROUND, BENDS, sweep=(), time_step_s=0.05, sample_m=0.05)
    true = np.column_stack([np.interp(found.positions.time_s, honest.time_s, honest.paths[0, :, k]) for k in (0, 1)])
    assert np.sqrt(((found.positions.place_m - true) ** 2).mean()) < 2.0 * SensorErrors().position_m
    assert position_table(found)["time_s"].to_numpy() == pytest.approx(found.positions.time_s)


def test_a_wheel_that_stands_is_left_out_and_no_encoder_in_another_scale(drive: SyntheticDrive, yutu2: Rover) -> None:
    table = drive.telemetry.drop(columns=[f"speed_{wheel}_m_s" for wheel in WHEELS])
    table[["angle_MR_deg", "rate_MR_deg_s"]] = 0.0
    with pytest.warns(LunarSciWarning, match="wheel MR turns 0.000 times as far .* left out"):
        found = states(csv(table), yutu2, None)
    assert not found.findings.doubt and not found.rows.measured[:, WHEELS.index("MR")].any()
    others = found.rows.measured.copy()
    assert np.delete(others, WHEELS.index("MR"), axis=1).all()


def test_a_turn_on_the_spot_has_a_motion_and_no_slip(yutu2: Rover) -> None:
    plan = Plan(name="turn", legs=(Leg(turn_deg=70.0), Leg(stop_s=10.0)), speed_m_s=0.05)
    out = predict(yutu2, GROUND, plan, sweep=(), time_step_s=0.05, sample_m=0.05)
    sent = simulate_telemetry(out, SensorErrors(), 3)
    with pytest.warns(LunarSciWarning, match="no slip: the rover does not drive between positions"):
        found = measured_states(InputFile("turn.csv", csv(sent.telemetry)), plan=plan)
    assert not found.drive.rows.measured.any() and not found.untrusted
    assert found.drive.motion.yaw_deg[-1] == pytest.approx(out.paths[0, -1, 5], abs=0.5)
    assert np.isnan(found.to_dict()["wheels"]["FL"]["slip_ratio"]["median"])


def test_a_clock_in_ms_takes_rests_and_start_along(drive: SyntheticDrive, yutu2: Rover) -> None:
    sent = csv(drive.telemetry.assign(time_s=1000.0 * drive.telemetry.time_s))
    told = read_telemetry(InputFile("sent.csv", sent), yutu2, Findings("sent.csv"))
    told = dataclasses.replace(told, rests_s=((20_000.0, 40_000.0),), start_s=5_000.0)
    with pytest.warns(LunarSciWarning, match="time_s looks like ms"):
        found = in_units(told, yutu2, Findings("sent.csv"))
    assert found.time_s == pytest.approx(drive.telemetry.time_s.to_numpy())
    assert found.rests_s == ((20.0, 40.0),) and found.start_s == 5.0
    assert found.rested.sum() == 20
