"""Measured wheel states, ordered by pose and wheel, and what goes with them of forces along the motion."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.csv_table import numbers_of, read_csv_table
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.regolith.states import MeasurementErrors, marked_valid
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["MEASURED", "PoseStates", "at_times", "read_pose_states"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
MEASURED = ("sinkage_m", "slip_ratio", "side_slip_deg")


@dataclass(frozen=True, slots=True, eq=False)
class PoseStates:
    """Measured states.

    Attributes
    ----------
    table : as read, a row for each state.
    time_s, wheel : of each row; the wheel by its place in the rover. (r,)
    values, sigmas : columns `MEASURED`, NaN where not measured. (r, 3) [m, -, deg]
    valid : rows not marked otherwise. (r,)
    """

    table: "pd.DataFrame"
    time_s: FloatArray
    wheel: npt.NDArray[np.int64]
    values: FloatArray
    sigmas: FloatArray
    valid: BoolArray

    def by_pose(self, wheels: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (p,), values and sigmas (p, wheels, 3) of all states that are valid; NaN where there is none."""
        times, place = np.unique(self.time_s, return_inverse=True)
        found = np.full((2, len(times), wheels, 3), np.nan)
        rows = np.flatnonzero(self.valid)
        found[0, place[rows], self.wheel[rows]] = self.values[rows]
        found[1, place[rows], self.wheel[rows]] = self.sigmas[rows]
        return times, found[0], found[1]


def read_pose_states(source: InputFile, rover: Rover) -> PoseStates:
    """Read states from CSV: `time_s`, `wheel`, any of `MEASURED` with `NAME_sigma`, `valid`; others are only kept.

    Where no sigma is given it is that of `MeasurementErrors`. Raises DataError.
    """
    table = read_csv_table(source)
    for name in ("time_s", "wheel"):
        if name not in table:
            raise DataError(f"{source.name}: no column {name}; there are: {', '.join(map(str, table.columns))}")
    if not any(name in table for name in MEASURED):
        raise DataError(f"{source.name}: no measured column; there can be {', '.join(MEASURED)}")
    time = numbers_of(source.name, "time_s", table["time_s"])
    if len(strange := np.flatnonzero(~np.isfinite(time))):
        raise DataError(f"{source.name}, row {strange[0] + 1}, time_s: is blank; every state needs a time")
    names = table["wheel"].fillna("").str.strip()
    unknown = sorted(set(names) - set(rover.wheels))
    if unknown:
        raise DataError(f"{source.name}: '{unknown[0]}' is no wheel of {rover.name}; it has {', '.join(rover.wheels)}")
    wheel = np.array([rover.wheels.index(name) for name in names], dtype=np.int64)
    twice = table.assign(time_s=time, wheel=wheel).duplicated(["time_s", "wheel"])
    if twice.any():
        raise DataError(f"{source.name}, row {int(np.argmax(twice)) + 1}: a second state of this wheel at this time")
    blank, errors = np.full(len(table), np.nan), MeasurementErrors()

    def numbers(name: str) -> FloatArray:
        return numbers_of(source.name, name, table[name]) if name in table else blank

    values = np.column_stack([numbers(name) for name in MEASURED])
    given = np.column_stack([numbers(f"{name}_sigma") for name in MEASURED])
    own = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(MEASURED)])
    if len(wrong := np.argwhere(given < 0)):
        raise DataError(f"{source.name}, row {wrong[0][0] + 1}, {MEASURED[wrong[0][1]]}_sigma: give 0 or more")
    valid = marked_valid(source.name, table["valid"]) if "valid" in table else np.ones(len(table), dtype=bool)
    return PoseStates(table, time, wheel, values, np.where(np.isfinite(given), given, own), valid)


def at_times(time_s: FloatArray, poses_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values at poses (n, ...) by straight lines between them: (t, ...); NaN outside, and beside poses that are NaN."""
    place = np.clip(np.searchsorted(poses_s, time_s, side="right") - 1, 0, len(poses_s) - 2)
    share = (time_s - poses_s[place]) / (poses_s[place + 1] - poses_s[place])
    share = share.reshape(-1, *([1] * (values.ndim - 1)))
    low, high = values[place], values[place + 1]
    between = np.where(share == 0, low, np.where(share == 1, high, (1 - share) * low + share * high))
    return np.where((share < 0) | (share > 1), np.nan, between)
