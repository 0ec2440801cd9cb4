"""What was measured of a drive: states of the wheels at times, and positions from localisation.

Whether a table of measured states or positions can be one drive: members, repeated rows, misspelt columns, signs.

Simulated drives at the times of a measured one.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import FloatArray, IntArray, samples_about
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, StateTable, read_state_table
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import VALID_SLIP
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.telemetry.checks import WheelPace
from lunarsci.twin.telemetry.reading import Positions, joint_m2, read_positions

if TYPE_CHECKING:
    import pandas as pd


OBSERVED = COLUMNS
"""Columns of the measured values: sinkage, slip ratio, side slip, normal force, drawbar pull, lateral force."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveRecord:
    """Measured states and positions.

    Attributes
    ----------
    time_s, wheel : when, since the start of the plan, and of which wheel each state is. (n,) [s]
    values, sigmas : columns `OBSERVED`, NaN where not measured. (n, 6) [m, -, deg, N, N, N]
    fix_time_s, fix_m, fix_covariance_m2 : positions of the rover's origin, and their errors. (f,), (f, 2), (f, 2, 2)
    fix_shared_m2 : covariance of each position's error with that of the one before; None where they are independent.
        (f, 2, 2)
    rim_m_s : measured speed of each state's rim, NaN where it is not, None where no state has it. (n,) [m/s]
    doubt : why the states are doubtful, as `twin states` says in their column of that name; empty where they are not.

    Raises ParameterError for shapes that do not fit, times that are no numbers or negative, and sigmas below 0.
    """

    time_s: FloatArray
    wheel: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    fix_time_s: FloatArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray
    fix_shared_m2: FloatArray | None = None
    rim_m_s: FloatArray | None = None
    doubt: str = ""

    def __post_init__(self) -> None:
        n, f = len(self.time_s), len(self.fix_time_s)
        shapes = (self.values.shape, self.sigmas.shape, self.fix_m.shape, self.fix_covariance_m2.shape)
        if shapes != ((n, 6), (n, 6), (f, 2), (f, 2, 2)) or len(self.wheel) != n:
            raise ParameterError(f"a record's states and positions have shapes {shapes}; they do not fit its times")
        for name, times in (("time_s", self.time_s), ("fix_time_s", self.fix_time_s)):
            if not (np.isfinite(times).all() and (times >= 0).all()):
                raise ParameterError(f"a record's {name} must be 0 or more: it counts from the start of the plan")
        known = np.isfinite(self.values)
        if not (np.isfinite(self.sigmas[known]).all() and (self.sigmas[known] >= 0).all()):
            raise ParameterError("a record's sigmas must be 0 or more wherever a value is measured")
        if not np.isfinite(self.fix_m).all() or not all(np.linalg.eigvalsh(c)[0] > 0 for c in self.fix_covariance_m2):
            raise ParameterError("a record's positions need finite places and positive definite covariances")

    @property
    def fix_joint_m2(self) -> FloatArray:
        """Covariance of all positions. (2 f, 2 f)"""
        return joint_m2(self.fix_covariance_m2, self.fix_shared_m2)


def read_drive_states(states: InputFile, rover: Rover, errors: MeasurementErrors | None = None) -> StateTable:
    """The wheel states of one drive of a rover, as `read_record` takes them. Raises DataError."""
    return read_state_table(states, rover.wheel, wheels=rover.wheels, rover=rover.name, errors=errors)


def read_record(
    states: InputFile | StateTable,
    rover: Rover,
    *,
    positions: InputFile | None = None,
    errors: MeasurementErrors | None = None,
) -> DriveRecord:
    """Read a record from CSV, or take a table of `read_drive_states`.

    States have `time_s`, `wheel`, and any of the columns `OBSERVED` with their `NAME_sigma`; positions are those of
    `read_positions`. Where no sigma is given it is that of `errors`. States with `valid` false are left out with a
    warning. With positions, slip and side slip of states whose `slip_basis` is `positions` are left out with a warning:
    they would count what the positions say a second time. Rows that are there twice count once, with a warning. Raises
    DataError, also for rows that contradict each other, several members, columns that are nearly known ones, and
    sinkages of a wrong sign or unit.

    Errors of slip are without the part that all states share (`slip_ratio_shared`): it is that of the wheels' radius,
    which an update finds.
    """
    found = _valid_rows(read_drive_states(states, rover, errors) if isinstance(states, InputFile) else states)
    values, sigmas = found.values.copy(), _without_shared(found)
    if positions is not None:
        _forget_slips(found.file, found.table, values)
    fixes = Positions.none() if positions is None else read_positions(positions)
    try:
        return DriveRecord(
            time_s=found.numbers("time_s"),
            wheel=found.wheels,
            values=values,
            sigmas=sigmas,
            fix_time_s=fixes.time_s,
            fix_m=fixes.place_m,
            fix_covariance_m2=fixes.covariance_m2,
            fix_shared_m2=fixes.shared_m2,
            rim_m_s=found.numbers("rim_m_s") if "rim_m_s" in found.table else None,
            doubt="; ".join(found.table["doubt"].dropna().unique()) if "doubt" in found.table else "",
        )
    except ParameterError as error:
        raise DataError(f"{found.file}: {error}") from error


def _without_shared(found: StateTable) -> FloatArray:
    """Errors of the values, that of slip without what all states share. (n, 6)"""
    sigmas = found.sigmas.copy()
    if "slip_ratio_shared" in found.table:
        shared, k = np.nan_to_num(found.numbers("slip_ratio_shared")), OBSERVED.index("slip_ratio")
        sigmas[:, k] = np.sqrt(np.maximum(sigmas[:, k] ** 2 - shared**2, 0.0))
    return sigmas


def _valid_rows(found: StateTable) -> StateTable:
    if found.valid.all():
        return found
    out = ~found.valid
    text = f"{found.file}: {int(out.sum())} of {len(out)} states left out, marked not valid"
    if fast := int((np.abs(found.values[out, OBSERVED.index("slip_ratio")]) > VALID_SLIP).sum()):
        text += f": {fast} slip by more than {VALID_SLIP:g}, beyond what the wheel model holds for"
    warnings.warn(text, LunarSciWarning, stacklevel=3)
    return found.kept(found.valid)


def _forget_slips(file: str, table: "pd.DataFrame", values: FloatArray) -> None:
    """Blank slip and side slip that were derived from the positions which are given too."""
    if "slip_basis" not in table:
        return
    derived = np.asarray(table["slip_basis"].fillna("").str.strip().str.lower() == "positions")
    columns = np.array([OBSERVED.index(name) for name in ("slip_ratio", "side_slip_deg")])
    used = int((np.isfinite(values[:, columns]) & derived[:, None]).any(axis=1).sum())
    if used:
        text = f"{file}: slip and side slip of {used} states derive from positions, which are given too; left out"
        warnings.warn(f"{text}, so that nothing counts twice", LunarSciWarning, stacklevel=3)
        values[np.ix_(derived, columns)] = np.nan


LATE = 0.05
"""Share of states or positions after the end of a drive beyond which the clock is not its own; assumed."""


def pace_of(record: DriveRecord, rover: Rover, plan: Plan) -> WheelPace | None:
    """How fast the wheels of a record turned beside a plan; None where it does not say."""
    if record.rim_m_s is None or not len(record.time_s):
        return None
    times, row = np.unique(record.time_s, return_inverse=True)
    rims = np.full((len(times), len(rover.wheels)), np.nan)
    rims[row, wheel_numbers(record, rover.wheels)] = record.rim_m_s
    return WheelPace.of(rims, times, rover, plan)


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


def states_at(record: DriveRecord, times_s: FloatArray, states: FloatArray, wheels: Sequence[str]) -> FloatArray:
    """Columns `OBSERVED` of states (members, samples, wheels, 10) at times and wheels of a record. (members, n, 6)"""
    columns, wheel = [STATE_COLUMNS.index(name) for name in OBSERVED], wheel_numbers(record, wheels)
    low, share = samples_about(times_s, record.time_s)
    before, after = states[:, low, wheel][..., columns], states[:, low + 1, wheel][..., columns]
    return np.asarray((1.0 - share[:, None]) * before + share[:, None] * after)
