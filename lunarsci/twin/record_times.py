"""Simulated drives at the times of a measured one."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS

__all__ = ["check_clock", "check_wheels", "samples_about", "states_at", "values_at", "wheel_numbers"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
LATE = 0.05
"""Share of states or positions after the end of a drive beyond which the clock is not its own; assumed."""


def check_clock(record: DriveRecord, end_s: float, spacing_s: float) -> None:
    """Raises ParameterError for a record that goes on more than a sample after the end of the drive."""
    for what, times in (("states", record.time_s), ("positions", record.fix_time_s)):
        late = int((times > end_s + spacing_s).sum())
        if late > LATE * len(times):
            raise ParameterError(
                f"{late} of {len(times)} {what} are later than the end of the drive at {end_s:.0f} s; is it the plan "
                "that was driven, and time_s in seconds from its start?"
            )


def check_wheels(record: DriveRecord, wheels: Sequence[str], rover: str) -> None:
    """Raises ParameterError for wheels that the rover has not."""
    if strange := set(record.wheel) - set(wheels):
        raise ParameterError(f"'{min(strange)}' is no wheel of {rover}; it has {', '.join(wheels)}")


def wheel_numbers(record: DriveRecord, wheels: Sequence[str]) -> IntArray:
    """Which of the wheels each state is of. (n,)"""
    return np.array([wheels.index(name) for name in record.wheel], dtype=np.int64)


def samples_about(times_s: FloatArray, wanted_s: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sample before each wanted time, and the share of the way to the next; beyond the ends it is the end. (n,)"""
    place = np.interp(wanted_s, times_s, np.arange(len(times_s)))
    low = np.minimum(place.astype(np.int64), len(times_s) - 2)
    return low, place - low


def values_at(times_s: FloatArray, wanted_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values of samples (members, samples, k) at wanted times, by straight lines. (members, n, k)"""
    low, share = samples_about(times_s, wanted_s)
    return np.asarray((1.0 - share[:, None]) * values[:, low] + share[:, None] * values[:, low + 1])


def states_at(record: DriveRecord, times_s: FloatArray, states: FloatArray, wheels: Sequence[str]) -> FloatArray:
    """Columns `OBSERVED` of states (members, samples, wheels, 10) at times and wheels of a record. (members, n, 6)"""
    columns, wheel = [STATE_COLUMNS.index(name) for name in OBSERVED], wheel_numbers(record, wheels)
    low, share = samples_about(times_s, record.time_s)
    before, after = states[:, low, wheel][..., columns], states[:, low + 1, wheel][..., columns]
    return np.asarray((1.0 - share[:, None]) * before + share[:, None] * after)
