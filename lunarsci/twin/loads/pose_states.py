"""Measured wheel states, ordered by pose and wheel, and what goes with them of forces along the motion."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.inputs import InputFile
from lunarsci.regolith.states import COLUMNS, read_state_table
from lunarsci.twin.plans.motion import CORRELATION_M, Motion, correlation_of
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd


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
    wheel: IntArray
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
    found = read_state_table(source, rover.wheel, measured=MEASURED, wheels=rover.wheels, rover=rover.name)
    wheel = np.array([rover.wheels.index(name) for name in found.wheels], dtype=np.int64)
    columns = [COLUMNS.index(name) for name in MEASURED]
    time = found.numbers("time_s")
    return PoseStates(found.table, time, wheel, found.values[:, columns], found.sigmas[:, columns], found.valid)


def correlation_length(motion: Motion, states: PoseStates | None) -> tuple[float, str]:
    """Distance over which the motion's errors stay alike [m], and what it rests on: `slip errors`, or `assumed`."""
    if states is None:
        return CORRELATION_M, "assumed"
    shown = states.valid & np.isin(states.time_s, motion.time_s[~motion.no_speed])
    found = correlation_of(motion, states.values[shown, 1], states.sigmas[shown, 1])
    return (CORRELATION_M, "assumed") if found is None else (found, "slip errors")
