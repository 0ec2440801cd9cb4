"""Made-up drives and their telemetry, and the states found again from it. All of it is synthetic."""

import dataclasses
import io
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bench_states import of_other_radius

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile, InputStream
from lunarsci.io.tables import parquet_tables
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.assimilation.residuals import read_record
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.motion import read_motion
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, WheelTest, read_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.telemetry.checks import with_positions
from lunarsci.twin.telemetry.filter import ErrorChain, Nodes
from lunarsci.twin.telemetry.nodes import slips_of
from lunarsci.twin.telemetry.reading import Findings, Positions, read_positions, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive, simulate_telemetry
from lunarsci.twin.telemetry.sinkage import RutPoints, deepest_wheel, read_track, rut_points, with_sinkage
from lunarsci.twin.telemetry.smoother import SlipProcess, smooth
from lunarsci.twin.telemetry.states import DriveStates, motion_table, position_table, states_of, wheel_table
from lunarsci.twin.telemetry.wheel_motion import body_twist

PLAN = Plan(name="test", legs=(Leg(3.0, 0.15), Leg(2.0, -0.13)), speed_m_s=0.05)
HALTING = Plan(
    name="halting",
    legs=(Leg(2.0, 0.15), Leg(turn_deg=30.0), Leg(stop_s=20.0), Leg(2.0, -0.13)),
    speed_m_s=0.05,
)


def file(table: pd.DataFrame, name: str = "made-up.csv") -> InputFile:
    return InputFile(name, table.to_csv(index=False).encode())


def found(drive: SyntheticDrive, terrain: Terrain, *, track: bool = False) -> DriveStates:
    findings = Findings("made-up.csv")
    prediction = drive.prediction
    telemetry = read_telemetry(file(drive.telemetry), prediction.rover, findings)
    states = states_of(telemetry, prediction.rover, terrain, findings, prediction.plan)
    return with_sinkage(states, read_track(file(drive.track)), terrain) if track else states


def truth(states: DriveStates, prediction: Prediction, name: str) -> np.ndarray:
    """The simulator's own state of every wheel at the rows' times."""
    column = STATE_COLUMNS.index(name)
    times = states.nodes.time_s[states.rows.node]
    wheels = range(prediction.states.shape[2])
    return np.column_stack([np.interp(times, prediction.time_s, prediction.states[0, :, w, column]) for w in wheels])


def off(states: DriveStates, prediction: Prediction, name: str) -> np.ndarray:
    """Errors of the valid states in standard errors."""
    value, sigma = getattr(states.rows, name), getattr(states.rows, f"{name}_sigma")
    error = (value - truth(states, prediction, name)) / sigma
    return np.asarray(error[states.rows.valid & np.isfinite(error)])


def own_sigma(states: DriveStates) -> np.ndarray:
    """Errors of slip that are not those of the radius, which all share."""
    rows = states.rows
    return np.asarray(np.sqrt(rows.slip_ratio_sigma**2 - rows.slip_ratio_shared**2)[rows.valid])


def made_up(rover: Rover, seed: int, plan: Plan, errors: SensorErrors | None = None) -> tuple[SyntheticDrive, Terrain]:
    """A drive on a soil that the estimate does not know, on ground of one of three roughnesses."""
    random = np.random.default_rng(seed)
    terrain = synthetic_longji(rms_m=(0.0, 0.002, 0.005)[seed % 3])
    soil = terrain.with_soil(
        friction_angle_deg=float(random.uniform(25, 50)),
        lateral_modulus_mm=float(random.uniform(15, 45)),
        stiffness_kpa_m_n=float(random.uniform(500, 1500)),
    )
    drive = predict(rover, soil, plan, sweep=(), time_step_s=0.05, sample_m=0.05)
    return simulate_telemetry(drive, errors or SensorErrors(), seed), terrain


@pytest.fixture(scope="module")
def drive(yutu2: Rover) -> SyntheticDrive:
    return made_up(yutu2, 1, PLAN)[0]


@pytest.fixture(scope="module")
def states(drive: SyntheticDrive) -> DriveStates:
    return found(drive, synthetic_longji(rms_m=0.002), track=True)


def test_telemetry_is_the_drive_with_the_errors_it_says(drive: SyntheticDrive) -> None:
    table, prediction = drive.telemetry, drive.prediction
    assert (table["synthetic"] == "true").all() and (drive.track["synthetic"] == "true").all()
    fixed = table["x_m"].notna()
    assert np.diff(prediction.distance_m[fixed]) == pytest.approx(0.5, abs=0.06)
    # Of 20 drives: 440 coordinates scatter by 3.4 %, 2,000 headings by 1.6 %.
    sent = [simulate_telemetry(prediction, drive.errors, seed).telemetry for seed in range(20)]
    off_m = np.concatenate([one.loc[fixed, ["x_m", "y_m"]] - prediction.paths[0][fixed][:, :2] for one in sent])
    assert np.sqrt((off_m**2).mean()) == pytest.approx(0.04 / 3 * 0.5, rel=0.1)
    off_deg = np.concatenate([one["yaw_deg"] - prediction.paths[0, :, 5] for one in sent])
    assert np.sqrt((off_deg**2).mean()) == pytest.approx(0.1, rel=0.05)
    # The wheels turn as far as the commands add up to: r_s omega is the way of a wheel that does not slip.
    rover = prediction.rover
    turned = np.radians(table["angle_ML_deg"].iloc[-1] - table["angle_ML_deg"].iloc[0]) * rover.wheel.shearing_radius_m
    speed = commands_at(rover, make_schedule(PLAN, rover), np.arange(0.0, prediction.time_s[-1], 0.1)).speed_m_s[:, 2]
    assert turned == pytest.approx(0.1 * speed.sum(), rel=2e-3)


def test_the_same_seed_gives_the_same_bytes(drive: SyntheticDrive) -> None:
    again = simulate_telemetry(drive.prediction, drive.errors, drive.seed)
    other = simulate_telemetry(drive.prediction, drive.errors, drive.seed + 1)
    assert again.telemetry.equals(drive.telemetry) and again.track.equals(drive.track)
    assert not other.telemetry["yaw_deg"].equals(drive.telemetry["yaw_deg"])


def test_a_rut_is_as_deep_as_the_deepest_wheel_that_passed(drive: SyntheticDrive) -> None:
    """Straight on, all wheels of a side run in one rut, but for the last metre, where only the front ones came."""
    rover = drive.prediction.rover
    straight = Plan(name="straight", legs=(Leg(3.0),), speed_m_s=0.05)
    level = build_terrain("level", -2.0, -3.0, 0.25, np.zeros((25, 40)), read_soil("longji"), synthetic=True)
    prediction = predict(rover, level, straight, sweep=(), sample_m=0.05)
    track = simulate_telemetry(prediction, SensorErrors(track_m=0.0)).track
    z = prediction.states[0, 5:, :, STATE_COLUMNS.index("sinkage_m")].mean(axis=0)
    left = track[track["y_m"] > 0]
    shared = left[(left["x_m"] > 0.6) & (left["x_m"] < 2.4)]
    assert shared["rut_m"].to_numpy() == pytest.approx(z[[0, 2, 4]].max(), abs=1e-4)
    alone = left[left["x_m"] > 3.1]
    assert len(alone) and alone["rut_m"].to_numpy() == pytest.approx(z[0], abs=1e-4)


def test_what_cannot_be_simulated_is_refused(drive: SyntheticDrive, yutu2: Rover) -> None:
    prediction = drive.prediction
    both = dataclasses.replace(prediction, outcome=np.zeros(2, dtype=np.int64))
    with pytest.raises(ParameterError, match="give one soil"):
        simulate_telemetry(both, drive.errors)
    for wrong, says in (
        ({"fix_distance_m": 0.0}, "above 0"),
        ({"yaw_deg": -1.0}, "0 or more"),
        ({"fix_sigma_m": 0.0}, "above 0"),
    ):
        with pytest.raises(ParameterError, match=says):
            SensorErrors(**wrong)


@pytest.fixture(scope="module")
def halting(yutu2: Rover) -> SyntheticDrive:
    """Across a slope, with halts after 2 and 4 m at which the rover errs by some 20 cm in its place."""
    legs = (Leg(2.0), Leg(2.0), Leg(2.0))
    plan = Plan(name="halts", legs=legs, speed_m_s=0.05, fixes=Fixes(0.2, 0.0))
    ground = np.tan(np.radians(3.0)) * np.linspace(-3.0, 3.0, 25)[:, None] + np.zeros((25, 48))
    slope = build_terrain("slope", -2.0, -3.0, 0.25, ground, read_soil("longji"), synthetic=True)
    drive = predict(yutu2, slope, plan, sweep=(), seed=4, time_step_s=0.05, sample_m=0.05)
    return simulate_telemetry(drive, SensorErrors(wheel_angle_deg=0.0), 4)


def test_a_rover_that_halts_sends_where_it_believes_to_be_and_steers_from_there(halting: SyntheticDrive) -> None:
    """The next leg leads from the place sent to the planned end, as an arc along the heading at the halt."""
    table, drive = halting.telemetry, halting.prediction
    rover = drive.rover
    assert len(halting.halts) == 2 and set(table["halted"]) == {"true", "false"}
    turned = np.radians(table[[f"angle_{wheel}_deg" for wheel in ("ML", "MR")]].to_numpy()).mean(axis=1)
    way = turned * rover.wheel.shearing_radius_m
    for row, goal in zip(halting.halts, ((4.0, 0.0), (6.0, 0.0)), strict=True):
        sent = table.loc[row, ["x_m", "y_m"]].to_numpy(dtype=float)
        off = sent - drive.paths[0, row, :2]
        assert 0.02 < np.hypot(*off) < 0.7 and table.loc[row, "xx_m2"] == pytest.approx(0.04)
        assert table.loc[row, "halted"] == "true" and abs(table.loc[row, "speed_ML_m_s"]) < 0.005
        chord = np.subtract(goal, sent)
        half = math.atan2(chord[1], chord[0]) - math.radians(drive.paths[0, row, 5])
        arc = float(np.hypot(*chord)) / np.sinc(half / math.pi)
        end = len(way) - 1 if goal[0] == 6.0 else int(halting.halts[1])
        assert way[end] - way[row] == pytest.approx(arc, rel=0.01)


def test_states_of_a_drive_with_halts_are_its_truth(halting: SyntheticDrive) -> None:
    ground = halting.prediction.terrain
    states = found(halting, ground, track=True)
    for name in ("slip_ratio", "side_slip_deg"):
        error = off(states, halting.prediction, name)
        assert error.size > 20 and np.sqrt((error**2).mean()) < 2.0


def test_wheels_that_do_not_slip_give_back_the_motion(yutu2: Rover) -> None:
    """Dead reckoning inverts the commands, also where the steering axes are offset."""
    for rover in (yutu2, dataclasses.replace(yutu2, steering_offset_m=0.05)):
        plan = Plan(name="arc", legs=(Leg(3.0, 0.3),), speed_m_s=0.05)
        commands = commands_at(rover, make_schedule(plan, rover), np.array([10.0]))
        twist, apart = body_twist(rover, commands.speed_m_s, commands.steering_rad)
        assert twist[0] == pytest.approx([0.05, 0.0, 0.05 * 0.3], abs=1e-12)
        assert apart == pytest.approx(0.0, abs=1e-12)
        blind = commands.speed_m_s.copy()
        blind[0, 1] = np.nan
        assert body_twist(rover, blind, commands.steering_rad)[0] == pytest.approx(twist, abs=1e-12)


@pytest.mark.parametrize("follows", [0.0, 0.9])
def test_the_smoother_is_the_generalised_least_squares_of_its_model(follows: float) -> None:
    """A straight way of ten steps, against a dense solution of the same Gaussian model.

    Errors of positions are independent, or follow each other as e = 0.9 e + noise.
    """
    count, way, sigma = 11, 0.1, 0.005
    random = np.random.default_rng(0)
    errors = sigma**2 * follows ** np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    x = 0.1 * np.arange(count) * 0.97 + np.linalg.cholesky(errors) @ random.normal(size=count)
    share = np.append(0.0, np.full(count - 1, follows))[:, None, None] * np.eye(2)
    chain = ErrorChain(share, sigma**2 * (np.eye(2) - share**2)) if follows else None
    nodes = Nodes(
        time_s=np.arange(count) * 2.0,
        twist=np.tile([0.05, 0.0, 0.0], (count - 1, 1)),
        way_m=np.full(count - 1, way),
        gap_sigma_m=np.zeros(count - 1),
        restarts=np.zeros(count - 1, dtype=bool),
        fix_m=np.column_stack([x, np.zeros(count)]),
        fix_covariance_m2=np.tile(sigma**2 * np.eye(2), (count, 1, 1)),
        yaw_rad=np.zeros(count),
        yaw_sigma_rad=np.full(count, 1e-6),
        chain=chain,
    )
    amplitude, length = 0.03, 1.0
    result = smooth(nodes, SlipProcess.fixed(np.array([amplitude, 1e-6, 1e-6]), np.full(3, length)))
    # x_k = x_0 + sum of 0.1 (1 + d_j + m), d a Matern 3/2 process at the middles of the steps, m a constant.
    places = way * np.arange(count)
    middles = places[:-1] + 0.5 * way
    apart = math.sqrt(3.0) * np.abs(middles[:, None] - middles[None]) / length
    process = amplitude**2 * (1 + apart) * np.exp(-apart) + 0.3**2
    lower = np.vstack([np.zeros(count - 1), np.tri(count - 1)]) * way
    prior = lower @ process @ lower.T + 10.0**2 + 2e-4**2 * np.minimum.outer(np.arange(count), np.arange(count))
    gain = prior @ np.linalg.inv(prior + errors)
    mean = places + (x[0] - places[0]) + gain @ (x - places - x[0])
    assert result.state[:, 0] == pytest.approx(mean, abs=1e-4)
    # The same as prior - gain prior, without the difference of two variances of 100 m2.
    error = np.sqrt(np.diag(errors - errors @ np.linalg.solve(prior + errors, errors)))
    assert np.sqrt(result.covariance[:, 0, 0]) == pytest.approx(error, rel=0.02)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize(
    ("name", "low", "high"), [("slip_ratio", 0.7, 1.1), ("side_slip_deg", 0.6, 1.2), ("sinkage_m", 0.77, 1.02)]
)
def test_true_states_lie_within_their_errors(
    covered: dict[str, np.ndarray], name: str, low: float, high: float
) -> None:
    """The root mean square of errors over their sigmas scatters by 5 % between sets of twelve drives, 10 % sideways.

    Sigmas hold what these drives have none of, too: headings that drift, positions that walk.
    """
    assert low < np.sqrt((covered[name] ** 2).mean()) < high
    assert 0.65 < (np.abs(covered[name]) < 1).mean() < 0.92
    assert (np.abs(covered[name]) < 3).mean() > 0.98
    assert abs(covered[name].mean()) < 0.25


@pytest.fixture(scope="module")
def covered(yutu2: Rover) -> dict[str, np.ndarray]:
    """Errors in standard errors of twelve drives over the embedded plan, each on another soil, of another radius."""
    names = ("slip_ratio", "side_slip_deg", "sinkage_m")
    errors: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for seed in range(12):
        drive, terrain = made_up(yutu2, seed, read_plan())
        other, same = found(of_other_radius(drive, seed), terrain), found(drive, terrain, track=True)
        for name, states in zip(names, (other, other, same), strict=True):
            errors[name].append(off(states, drive.prediction, name))
    return {name: np.concatenate(parts) for name, parts in errors.items()}


def test_one_state_between_two_positions(states: DriveStates, drive: SyntheticDrive) -> None:
    fixes = int(drive.telemetry["x_m"].notna().sum())
    assert 0.7 * (fixes - 1) <= len(states.rows.node) <= fixes - 1
    between = np.searchsorted(position_table(states)["time_s"], states.nodes.time_s[states.rows.node])
    assert len(set(between)) == len(between)
    assert states.rows.valid.all() and states.findings.entries == []


def test_errors_that_positions_share_shift_the_whole_way_and_no_slip(yutu2: Rover) -> None:
    """All positions off by one and the same 20 mm, but for 1 mm: as certain of the slip as with 1 mm, of the place with
    20 mm; taken as independent they may walk as well, and know less of the place and little of the slip."""
    drive, terrain = made_up(yutu2, 0, PLAN, SensorErrors(fix_sigma_m=0.001, fix_distance_m=1.0))
    fixed = np.flatnonzero(drive.telemetry["x_m"].notna())
    places = drive.telemetry[["x_m", "y_m"]].to_numpy()[fixed] + 0.02
    own = np.tile((0.02**2 + 0.001**2) * np.eye(2), (len(fixed), 1, 1))
    found_by = []
    for shared in (own - 0.001**2 * np.eye(2), None):
        findings = Findings("made-up.csv")
        sent = read_telemetry(file(drive.telemetry), yutu2, findings, placed=False)
        times = drive.telemetry["time_s"].to_numpy()[fixed]
        sent = with_positions(sent, Positions(times, places, own, shared), "positions.csv", findings)
        found_by.append(states_of(sent, yutu2, terrain, findings, PLAN))
    chained, alone = found_by
    place, alone_place = (np.sqrt(states.smoothed.covariance[:, 0, 0]) for states in found_by)
    assert place.min() > 0.019 and alone_place.max() > 1.5 * place.max()
    slip, alone_slip = (np.median(own_sigma(states)) for states in found_by)
    assert slip < 0.5 * alone_slip
    assert np.abs(off(chained, drive.prediction, "slip_ratio")).max() < 4
    again = read_positions(file(position_table(chained)))
    assert again.shared_m2 is not None and "xx_before_m2" not in position_table(alone)
    np.testing.assert_allclose(again.shared_m2[1:], (own - 0.001**2 * np.eye(2))[1:])


def test_a_track_tells_of_sinkages_between_positions_that_lie_far_apart(yutu2: Rover) -> None:
    """Two positions have one slip between them; the track is measured all along."""
    drive, terrain = made_up(yutu2, 1, PLAN, SensorErrors(fix_sigma_m=0.007, fix_distance_m=100.0))
    states = found(drive, terrain, track=True)
    slips, depths = (np.isfinite(v).any(axis=1) for v in (states.rows.slip_ratio, states.rows.sinkage_m))
    assert slips.sum() == 1 and depths.sum() > 8
    assert np.diff(states.rows.distance_m).min() >= 0.3 - 1e-9 and (np.diff(states.rows.node) > 0).all()
    sinkage = np.abs(off(states, drive.prediction, "sinkage_m"))
    assert np.mean(sinkage < 1) > 0.5 and sinkage.max() < 4


def test_halts_have_no_slip_and_are_not_valid(yutu2: Rover) -> None:
    drive, terrain = made_up(yutu2, 0, HALTING)
    states = found(drive, terrain)
    halts = ~states.rows.valid.any(axis=1)
    assert halts.sum() >= 1
    assert (states.rows.slip_ratio[halts] == 0).all() and (states.rows.side_slip_deg[halts] == 0).all()
    assert states.rows.valid[~halts].all()
    assert np.abs(off(states, drive.prediction, "slip_ratio")).max() < 4.0
    assert np.abs(off(states, drive.prediction, "side_slip_deg")).max() < 4.0
    assert states.findings.entries == []


@pytest.mark.parametrize(("wheel", "ratio"), [("ML", 0.5), ("ML", 1.3), ("FL", 0.6)])
def test_a_wheel_that_slips_on_purpose_is_no_encoder_in_another_scale(yutu2: Rover, wheel: str, ratio: float) -> None:
    plan = Plan(name="test", legs=(Leg(6.0, wheel_test=WheelTest(wheel, ratio)),), speed_m_s=0.05)
    drive, terrain = made_up(yutu2, 0, plan)
    states = found(drive, terrain)
    of_wheel = yutu2.wheels.index(wheel)
    valid = states.rows.valid[:, of_wheel]
    assert valid.sum() > 2 and not {"encoder scale", "read as"} & {one.kind for one in states.findings.entries}
    wanted = truth(states, drive.prediction, "slip_ratio")[valid, of_wheel]
    assert np.abs(wanted).min() > 0.1
    assert np.median(states.rows.slip_ratio[valid, of_wheel]) == pytest.approx(np.median(wanted), abs=0.03)


def test_two_positions_that_a_lag_takes_off_the_rows_are_too_few(yutu2: Rover) -> None:
    drive, terrain = made_up(yutu2, 1, PLAN, SensorErrors(fix_sigma_m=0.007, fix_distance_m=100.0))
    findings = Findings("made-up.csv")
    sent = read_telemetry(file(drive.telemetry), yutu2, findings)
    with pytest.raises(DataError, match="fewer than two usable positions"):
        states_of(sent, yutu2, terrain, findings, PLAN, lag_s=-5.0)


def test_a_wheel_that_turns_backwards_slips_alike(yutu2: Rover) -> None:
    """Telemetry of a drive that is played in reverse: wheels, way and all; what slipped ahead slips behind."""
    drive, terrain = made_up(yutu2, 0, Plan(name="straight", legs=(Leg(4.0),), speed_m_s=0.05))
    ahead = found(drive, terrain)
    table = drive.telemetry.iloc[::-1].reset_index(drop=True)
    table["time_s"] = table["time_s"].iloc[0] - table["time_s"]
    for wheel in yutu2.wheels:
        for name in (f"speed_{wheel}_m_s", f"rate_{wheel}_deg_s"):
            table[name] *= -1
    findings = Findings("back.csv")
    back = states_of(read_telemetry(file(table), yutu2, findings), yutu2, terrain, findings)
    middle = float(np.median(ahead.rows.slip_ratio))
    assert float(np.median(back.rows.slip_ratio)) == pytest.approx(middle, abs=0.004)
    assert findings.entries == []


def test_tables_are_what_the_next_steps_read(states: DriveStates, yutu2: Rover) -> None:
    motion = read_motion(file(motion_table(states)), yutu2)
    assert motion.time_s == pytest.approx(states.nodes.time_s)
    table, positions = wheel_table(states), position_table(states)
    assert (table["slip_basis"] == "positions").all()
    alone = read_record(file(table), yutu2)
    assert np.isfinite(alone.values[:, 1]).all() and np.isfinite(alone.values[:, 0]).any()
    with pytest.warns(LunarSciWarning, match="slip and side slip of .* derive from positions"):
        both = read_record(file(table), yutu2, positions=file(positions))
    assert np.isnan(both.values[:, 1:3]).all()
    assert (np.isfinite(both.values[:, 0]) == np.isfinite(alone.values[:, 0])).all()
    assert len(both.fix_m) == len(positions)
    another = read_record(file(table.assign(slip_basis="imu")), yutu2, positions=file(positions))
    assert np.isfinite(another.values[:, 1]).all()


def test_units_of_an_ecsv_and_of_names_are_taken_as_they_say(drive: SyntheticDrive, yutu2: Rover) -> None:
    from astropy import units as u
    from astropy.table import Table

    plain = read_telemetry(file(drive.telemetry), yutu2, Findings("a.csv"))
    other = {"yaw_deg": (u.rad, "yaw_rad"), "x_m": (u.mm, "x_mm"), "xx_m2": (u.mm**2, "xx_mm2"),
             "rate_FL_deg_s": (u.rad / u.s, "rate_FL_rad_s"), "speed_MR_m_s": (u.km / u.h, "speed_MR_km_h"),
             "time_s": (u.ms, "time_ms"), "yaw_deg_sigma": (u.rad, "yaw_rad_sigma")}  # fmt: skip
    table, named = Table.from_pandas(drive.telemetry), drive.telemetry.copy()
    for name, (unit, meant) in other.items():
        own = {"yaw_deg": u.deg, "x_m": u.m, "xx_m2": u.m**2, "rate_FL_deg_s": u.deg / u.s, "speed_MR_m_s": u.m / u.s,
               "time_s": u.s, "yaw_deg_sigma": u.deg}[name]  # fmt: skip
        table[name] = own.to(unit, np.asarray(table[name], dtype=float)) * unit
        named = named.rename(columns={name: meant}).assign(**{meant: own.to(unit, named[name].to_numpy())})
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    for found in (
        read_telemetry(InputFile("a.ecsv", text.getvalue().encode()), yutu2, Findings("a.ecsv")),
        read_telemetry(file(named), yutu2, Findings("a.csv")),
    ):
        for name in ("time_s", "fix_m", "fix_covariance_m2", "yaw_deg", "yaw_deg_sigma", "rate_deg_s", "speed_m_s"):
            np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=1e-9)
    table["yaw_deg"].unit = u.kg
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    with pytest.raises(DataError, match="yaw_deg is in kg"):
        read_telemetry(InputFile("a.ecsv", text.getvalue().encode()), yutu2, Findings("a.ecsv"))


@pytest.mark.parametrize("name", ["a.parquet", "a.ecsv"])
def test_a_broken_file_is_a_data_error(yutu2: Rover, name: str) -> None:
    with pytest.raises(DataError, match="can be read"):
        read_telemetry(InputFile(name, b"nonsense,,,\n\x00"), yutu2, Findings(name))


def test_the_depth_of_a_rut_goes_to_the_deepest_wheel() -> None:
    """Three wheels behind each other; of equally deep ones the last counts, and their spread is an error."""
    x = np.column_stack([np.linspace(a, a + 2.0, 21) for a in (1.0, 0.5, 0.0)])
    y, time, place = np.zeros_like(x), np.linspace(0.0, 40.0, 21), np.array([[1.2, 0.0]] * 3)
    wheel = np.arange(3)

    def owners(*depths: float) -> tuple[list[bool], list[float]]:
        own, spread = deepest_wheel(place, wheel, (x, y), np.tile(depths, (21, 1)), time, 0.075)
        return own.tolist(), spread.tolist()

    assert owners(0.010, 0.008, 0.0084) == ([True, False, False], pytest.approx([0.0] * 3))
    # Ground that is loaded again sinks further: who was deepest is open then.
    assert owners(0.010, 0.008, 0.009) == ([False, False, False], pytest.approx([0.0] * 3))
    assert owners(0.010, 0.008, 0.0098) == ([False, False, True], pytest.approx([0.0002] * 3))
    ahead = deepest_wheel(
        np.array([[2.8, 0.0]]), np.array([0]), (x, y), np.tile([0.005, 0.01, 0.01], (21, 1)), time, 0.075
    )
    assert ahead[0].tolist() == [True]
    aside = deepest_wheel(
        np.array([[1.2, 0.2]]), np.array([0]), (x, y), np.tile([0.01, 0.01, 0.01], (21, 1)), time, 0.075
    )
    assert aside[0].tolist() == [False]


def test_two_terrains_give_the_depth_between_them() -> None:
    x = np.arange(0.0, 3.01, 0.05)
    soil = read_soil("longji")
    before = build_terrain("before", 0.0, 0.0, 0.05, 0.1 * x[None, :] + 0 * x[:, None], soil)
    after = dataclasses.replace(before, height_m=before.height_m - 0.009)
    points = rut_points(before, after, np.array([[1.0, 1.0], [2.0, 1.5]]), 0.075)
    depth, sigma = points.depth_at(np.array([[1.0, 1.0], [0.2, 0.2]]), 0.075)
    assert depth[0] == pytest.approx(0.009) and np.isnan(depth[1])
    assert sigma[0] == pytest.approx(0.00033, rel=1e-3)
    with pytest.raises(DataError, match="no height below any wheel"):
        rut_points(before, after, np.array([[9.0, 9.0]]), 0.075)
    # Scatter within a footprint is an error, too.
    scattered = RutPoints(
        place_m=np.zeros((4, 2)), rut_m=np.array([0.008, 0.010, 0.008, 0.010]), sigma_m=np.full(4, 0.0003)
    )
    depth, sigma = scattered.depth_at(np.zeros((1, 2)), 0.05)
    assert depth[0] == pytest.approx(0.009)
    assert sigma[0] == pytest.approx(math.hypot(0.0003, 0.001 * math.sqrt(4 / 3) / 2), rel=1e-6)


def test_a_track_in_millimetres_is_read(drive: SyntheticDrive) -> None:
    names = {name: name.replace("_m", "_mm") for name in ("x_m", "y_m", "rut_m", "rut_m_sigma")}
    other = drive.track.assign(**{name: 1e3 * drive.track[name] for name in names if name in drive.track})
    plain, read = read_track(file(drive.track)), read_track(file(other.rename(columns=names)))
    np.testing.assert_allclose(read.place_m, plain.place_m)
    np.testing.assert_allclose((read.rut_m, read.sigma_m), (plain.rut_m, plain.sigma_m))


def test_a_track_elsewhere_or_absurd_is_said(drive: SyntheticDrive) -> None:
    terrain = synthetic_longji(rms_m=0.002)
    states = found(drive, terrain)
    far = drive.track.assign(x_m=drive.track["x_m"] + 5.0, y_m=drive.track["y_m"] - 3.0)
    with pytest.raises(DataError, match="no point within half a wheel"):
        with_sinkage(states, read_track(file(far)), terrain)
    with pytest.warns(LunarSciWarning, match="odd depth"):
        deep = with_sinkage(states, read_track(file(drive.track.assign(rut_m=drive.track["rut_m"] * 1000))), terrain)
    assert np.isnan(deep.rows.sinkage_m).all() and "odd depth" in deep.findings.doubt
    sparse = drive.track[::8]
    with pytest.warns(
        LunarSciWarning, match=r"sparse, its points lie [01]\.\d+ m apart; give them every 0\.075 m or closer"
    ):
        with_sinkage(found(drive, terrain), read_track(file(sparse)), terrain)
    few = drive.track[drive.track["x_m"] < 1.0]
    with pytest.warns(LunarSciWarning, match="track apart.* it is short, or not along this drive"):
        with_sinkage(found(drive, terrain), read_track(file(few)), terrain)
    with pytest.raises(DataError, match="rut_m_sigma"):
        read_track(file(drive.track.assign(rut_m_sigma=-1.0)))


def test_parquet_of_more_cells_than_there_is_memory_for_is_refused_before_it_is_read() -> None:
    """Some kB of file that hold a group of a quarter of a million empty rows in 201 columns."""
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table({f"c{k}_m": pyarrow.nulls(250_000) for k in range(201)}), buffer)
    buffer.seek(0)
    with pytest.raises(DataError, match="50 million cells in a group of rows, and at most 50 million are read"):
        list(parquet_tables(InputStream("wide.parquet", buffer)))


def test_a_wheel_that_slides_back_slips_by_1_at_most() -> None:
    """Rims roll 0.1 m/s; the rover goes at 0.08 m/s, stands, slides back, or drags them at 0.2 m/s."""
    v_x = np.array([[0.08], [0.0], [-0.5], [0.2]])
    along, across = (np.tile(part, (4, 1, 1)) for part in ([[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    covariance = np.tile(np.diag([0.2, 0.0, 0.0, 0.03]) ** 2, (4, 1, 1))
    velocities: Any = SimpleNamespace(v_x=v_x, v_y=0.0 * v_x, along=along, across=across, covariance=covariance)
    motion: Any = SimpleNamespace(speed_m_s=np.full((4, 1), 0.1))
    slips = slips_of(velocities, motion)
    assert slips.slip_ratio.ravel() == pytest.approx([0.2, 1.0, 1.0, -0.5])
    # An error of 2 is one of which only the range is known.
    assert slips.slip_ratio_sigma.ravel()[:3] == pytest.approx(3.0**-0.5)
    assert (slips.slip_ratio_shared <= slips.slip_ratio_sigma).all()
