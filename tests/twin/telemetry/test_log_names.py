"""Logs of other software: their names, sensors that report in some rows only, and rovers that spin."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from lunarsci.io.inputs import InputFile
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.telemetry.checks import _without_full_turns
from lunarsci.twin.telemetry.log_names import names_meant
from lunarsci.twin.telemetry.reading import BLOCK, Findings, between_readings, read_telemetry
from lunarsci.twin.telemetry.states import states_of

SLIP = 0.2
WHEELS = ("FL", "FR", "RL", "RR")


@pytest.fixture(scope="module")
def skid() -> Rover:
    return replace(build_rover("small-four"), steered=())


def log(rover: Rover, seconds: float = 100.0) -> pd.DataFrame:
    """A made-up drive straight on at 5 cm/s of the rims: wheels by sides, positions once a second."""
    times = np.arange(0.0, seconds, 0.2)
    turned = 0.05 / rover.wheel.shearing_radius_m * times
    noise = np.random.default_rng(4).normal(0.0, 1e-3, (2, len(times)))
    placed = np.arange(len(times)) % 5 == 0
    return pd.DataFrame(
        {
            "timestamp": times,
            "wheel_left_rad": 4000.0 + turned,
            "wheel_right_rad": 4100.0 + turned,
            "vo_x": np.where(placed, 0.05 * (1.0 - SLIP) * times + noise[0], np.nan),
            "vo_y": np.where(placed, noise[1], np.nan),
            "heading_rad": 0.1 * noise[1],
        }
    )


def slips(table: pd.DataFrame, rover: Rover) -> tuple[np.ndarray, Findings]:
    findings = Findings("log.csv")
    file = InputFile("log.csv", table.to_csv(index=False).encode())
    telemetry = read_telemetry(file, rover, findings)
    drive = states_of(telemetry, rover, synthetic_longji(seed=1), findings)
    return drive.rows.slip_ratio[np.isfinite(drive.rows.slip_ratio)], findings


@pytest.mark.filterwarnings("ignore")
def test_a_log_is_read_by_its_own_names_also_where_sensors_report_in_some_rows(skid: Rover) -> None:
    table = log(skid)
    whole, findings = slips(table, skid)
    (read_as,) = (one.what for one in findings.entries if one.kind == "read as")
    assert "'wheel_left_rad' as angle_FL_rad and angle_RL_rad" in read_as
    assert "'heading_rad' as yaw_rad" in read_as
    assert "'timestamp' as time_s" in read_as
    seldom = table.copy()
    seldom.loc[np.arange(len(table)) % 3 != 1, ["wheel_left_rad", "wheel_right_rad"]] = np.nan
    some, findings = slips(seldom, skid)
    assert [one.count for one in findings.entries if one.kind == "missing readings"] == [1]  # before the first reading
    for found in (whole, some):
        assert np.median(found) == pytest.approx(SLIP, abs=0.02)


def test_two_columns_of_one_meaning_are_not_taken() -> None:
    meant = names_meant(["t", "vo_x", "odom_x", "x_m_sigma", "cmd_left_rad", "steer_FL_rad", "w_fl"], WHEELS)
    assert meant == {"t": ["time_s"], "steer_FL_rad": ["steered_FL_rad"], "w_fl": ["rate_FL_rad_s"]}
    assert names_meant(["time_s", "t", "yaw_rad", "heading_deg"], WHEELS) == {}


@pytest.mark.filterwarnings("ignore")
def test_stamps_are_in_the_unit_of_their_size(skid: Rover) -> None:
    table = log(skid)
    table["timestamp"] = (1.7e18 + 1e9 * table["timestamp"]).astype("int64")
    file = InputFile("log.csv", table.to_csv(index=False).encode())
    telemetry = read_telemetry(file, skid, findings := Findings("log.csv"))
    assert "'timestamp' as time_ns" in findings.entries[0].what
    assert np.ptp(telemetry.time_s) == pytest.approx(99.8, abs=1e-3)


@pytest.mark.filterwarnings("ignore")
def test_wheels_without_a_reading_at_the_end_of_a_block_do_not_rest(skid: Rover) -> None:
    table = log(skid, 0.2 * 5 * BLOCK)
    table.loc[np.arange(len(table)) % BLOCK == BLOCK - 1, ["wheel_left_rad", "wheel_right_rad"]] = np.nan
    file = InputFile("log.csv", table.to_csv(index=False).encode())
    telemetry = read_telemetry(file, skid, Findings("log.csv"))
    assert len(telemetry.time_s) == len(table)
    assert telemetry.rests_s == ()


def test_readings_hold_between_themselves_and_not_over_gaps() -> None:
    at, nan = np.arange(10.0), np.nan
    values = np.array([nan, 1.0, nan, 3.0, 4.0, 5.0, nan, nan, nan, nan])[:, None]
    assert np.array_equal(between_readings(at, values)[:, 0], [nan, 1, 2, 3, 4, 5, *[nan] * 4], equal_nan=True)
    assert between_readings(at, values, held=True)[2, 0] == 1.0
    far = at.copy()
    far[3:] += 30.0
    assert np.isnan(between_readings(far, values)[2, 0])


@pytest.mark.parametrize("gain", [0.5, -0.5, 1.0])
def test_a_rover_that_spins_by_more_than_half_a_turn_between_headings_is_followed(gain: float) -> None:
    wheels = np.concatenate([np.arange(0.0, 720.0, 20.0), 720.0 + np.array([0.0, 270.0 / abs(gain), 600.0])])
    yaw = gain * wheels
    wrapped = (yaw + 180.0) % 360.0 - 180.0
    assert _without_full_turns(wrapped, wheels) == pytest.approx(yaw)
