"""Telemetry of any length: what a rover at rest sends is left out, and moves no state. All of it is synthetic."""

import io
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile, InputStream, open_input
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.jobs.states import states as measured_states
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import predict
from lunarsci.twin.telemetry import rests
from lunarsci.twin.telemetry.reading import Findings, Telemetry, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, simulate_telemetry
from lunarsci.twin.telemetry.states import DriveStates, motion_table, states_of, wheel_table

GROUND = synthetic_longji()
PLAN = Plan(name="two", legs=(Leg(2.0, 0.15), Leg(stop_s=20.0), Leg(2.0, -0.13)), speed_m_s=0.05)
STOOD = 4000


def csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False).encode()


def read(data: bytes, rover: Rover, name: str = "sent.csv", **options: object) -> Telemetry:
    return read_telemetry(InputFile(name, data), rover, Findings(name), **options)  # type: ignore[arg-type]


def found(data: bytes, rover: Rover, name: str = "sent.csv", **options: object) -> DriveStates:
    return states_of(read(data, rover, name, **options), rover, GROUND, Findings(name))


@pytest.fixture(scope="module")
def drive(yutu2: Rover) -> pd.DataFrame:
    """Two drives with a halt between them."""
    prediction = predict(yutu2, GROUND, PLAN, sweep=(), time_step_s=0.05, sample_m=0.05)
    return simulate_telemetry(prediction, SensorErrors(), 3).telemetry


def halted_row(drive: pd.DataFrame) -> int:
    """A row amid the halt."""
    still = np.flatnonzero((drive[[name for name in drive if name.startswith("speed_")]] == 0).all(axis=1))
    inner = still[(still > 5) & (still < len(drive) - 5)]
    return int(inner[len(inner) // 2])


def stood(drive: pd.DataFrame, rows: int, fixes: int = 0) -> pd.DataFrame:
    """The same with so many rows of a rover at rest amid its halt, as noisy as the others, some with a position."""
    rng, at = np.random.default_rng(5), halted_row(drive)
    rest = pd.concat([drive.iloc[[at]]] * rows, ignore_index=True)
    step = float(np.median(np.diff(drive["time_s"])))
    rest["time_s"] = drive["time_s"][at] + step * np.arange(1, rows + 1)
    for name in rest:
        if name.startswith(("angle_", "rate_", "yaw_deg", "roll", "pitch", "steered")) and name != "yaw_deg_sigma":
            rest[name] += 0.1 * rng.standard_normal(rows)
    place = drive.loc[drive["x_m"].notna() & (drive.index < at)].iloc[-1]
    for row in np.linspace(0, rows - 1, fixes + 2)[1:-1].astype(int):
        for name in ("x_m", "y_m"):
            rest.loc[row, name] = place[name] + 0.005 * rng.standard_normal()
        for name in ("xx_m2", "xy_m2", "yy_m2"):
            rest.loc[row, name] = place[name]
    after = drive.iloc[at + 1 :].assign(time_s=drive["time_s"] + step * rows)
    return pd.concat([drive.iloc[: at + 1], rest, after], ignore_index=True)
