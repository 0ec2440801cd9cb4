"""What was measured of a drive: states of the wheels at times, and positions from localisation.

Whether a table of measured states or positions can be one drive: members, repeated rows, misspelt columns, signs.

Simulated drives at the times of a measured one.
"""

import difflib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.csv_table import numbers_of, read_csv_table
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.regolith.states import COLUMNS, IDENTIFIERS, MeasurementErrors, marked_valid
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "OBSERVED",
    "DriveRecord",
    "check_clock",
    "check_columns",
    "check_sinkage",
    "check_wheels",
    "one_member",
    "read_record",
    "samples_about",
    "states_at",
    "values_at",
    "wheel_numbers",
    "without_repeats",
]

ALIKE = 0.72
"""Likeness of two names (difflib's ratio) from which one is taken for a slip of the pen of the other; assumed."""


def check_columns(file: str, table: "pd.DataFrame", known: tuple[str, ...]) -> None:
    """Refuse a column that is nearly a known one, such as `sinkage_mm`: it would be left out without a word."""
    for name in table.columns:
        near = difflib.get_close_matches(str(name).lower(), known, n=1, cutoff=ALIKE)
        if name in known or str(name).removesuffix("_sigma") in known or not near or near[0] in table:
            continue
        raise DataError(f"{file}: column '{name}' is unknown; if it is '{near[0]}', rename it and mind the unit")


def one_member(file: str, table: "pd.DataFrame") -> None:
    """Refuse a table of several drives, as `twin predict` writes."""
    if "member" in table and table["member"].nunique() > 1:
        raise DataError(f"{file}: {table['member'].nunique()} drives (column member); keep the rows of one")


def without_repeats(file: str, table: "pd.DataFrame", keys: list[str]) -> "pd.DataFrame":
    """Rows that are there twice count once, with a warning; DataError where rows of one key contradict each other."""
    kept = table.drop_duplicates()
    if len(kept) < len(table):
        text = f"{file}: {len(table) - len(kept)} of {len(table)} rows are there twice; each counts once"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
    again = kept.duplicated(keys)
    if again.any():
        row = kept[again].iloc[0]
        said = ", ".join(f"{key} {row[key]}" for key in keys)
        raise DataError(f"{file}: two rows of {said} contradict each other; keep the right one")
    return kept.reset_index(drop=True)


def check_sinkage(file: str, sinkage_m: np.ndarray, radius_m: float) -> None:
    """Refuse sinkages that are mostly negative, or deeper than the wheel: a wrong sign or unit."""
    known = sinkage_m[np.isfinite(sinkage_m)]
    if known.size and not 0 < np.median(known) < radius_m:
        raise DataError(
            f"{file}: sinkage_m has a median of {np.median(known):.3g}; it is in metres, down is positive, and the "
            f"wheel's radius is {radius_m:g} m"
        )


FloatArray = npt.NDArray[np.float64]
OBSERVED = COLUMNS
"""Columns of the measured values: sinkage, slip ratio, side slip, normal force, drawbar pull, lateral force."""
KNOWN = (*OBSERVED, *IDENTIFIERS, "yaw_deg")
KNOWN_PLACES = ("time_s", "x_m", "y_m", "z_m", "yaw_deg", "sigma_m", "xx_m2", "xy_m2", "yy_m2", "synthetic")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveRecord:
    """Measured states and positions.

    Attributes
    ----------
    time_s, wheel : when, since the start of the plan, and of which wheel each state is. (n,) [s]
    values, sigmas : columns `OBSERVED`, NaN where not measured. (n, 6) [m, -, deg, N, N, N]
    fix_time_s, fix_m, fix_covariance_m2 : positions of the rover's origin, and their errors. (f,), (f, 2), (f, 2, 2)

    Raises ParameterError for shapes that do not fit, times that are no numbers or negative, and sigmas below 0.
    """

    time_s: FloatArray
    wheel: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    fix_time_s: FloatArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray

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
    def whitening(self) -> FloatArray:
        """Matrix that makes the error of each position a unit one. (f, 2, 2) [1/m]"""
        return np.linalg.inv(np.linalg.cholesky(self.fix_covariance_m2)) if len(self.fix_m) else np.zeros((0, 2, 2))


def read_record(
    states: InputFile, rover: Rover, *, positions: InputFile | None = None, errors: MeasurementErrors | None = None
) -> DriveRecord:
    """Read a record from CSV.

    States have `time_s`, `wheel`, and any of the columns `OBSERVED` with their `NAME_sigma`; positions have `time_s`,
    `x_m`, `y_m`, and `sigma_m` or `xx_m2`, `xy_m2`, `yy_m2`. Where no sigma is given it is that of `errors`. States
    with `valid` false are left out with a warning. With positions, slip and side slip of states whose `slip_basis` is
    `positions` are left out with a warning: they would count what the positions say a second time. Rows that are there
    twice count once, with a warning. Raises DataError, also for rows that contradict each other, several members,
    columns that are nearly known ones, and sinkages of a wrong sign or unit.
    """
    file = states.name
    table = _valid_rows(file, _read(states, ("time_s", "wheel"), KNOWN))
    names = [name for name in OBSERVED if name in table]
    if not names:
        raise DataError(f"{file}: no measured column; there can be {', '.join(OBSERVED)}")
    errors = errors or MeasurementErrors()
    values = np.column_stack([_numbers(file, table, name) for name in OBSERVED])
    check_sinkage(file, values[:, 0], rover.wheel.radius_m)
    if positions is not None:
        _forget_slips(file, table, values)
    given = np.column_stack([_numbers(file, table, f"{name}_sigma") for name in OBSERVED])
    own = np.column_stack([errors.of(name, np.nan_to_num(values[:, k])) for k, name in enumerate(OBSERVED)])
    places = _positions(positions)
    strange = sorted(set(table["wheel"].astype(str)) - set(rover.wheels))
    if strange:
        raise DataError(f"{file}: '{strange[0]}' is no wheel of {rover.name}; it has {', '.join(rover.wheels)}")
    try:
        return DriveRecord(
            time_s=_numbers(file, table, "time_s"),
            wheel=tuple(table["wheel"].astype(str)),
            values=values,
            sigmas=np.where(np.isfinite(given), given, own),
            **places,
        )
    except ParameterError as error:
        raise DataError(f"{file}: {error}") from error


def _valid_rows(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    if "valid" not in table:
        return table
    kept = marked_valid(file, table["valid"])
    if not kept.all():
        text = f"{file}: {int((~kept).sum())} of {len(kept)} states left out, marked not valid"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
    return table[kept].reset_index(drop=True)


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


def _read(source: InputFile, needed: tuple[str, ...], known: tuple[str, ...]) -> "pd.DataFrame":
    table = read_csv_table(source)
    for name in needed:
        if name not in table:
            raise DataError(f"{source.name}: no column {name}; there are: {', '.join(map(str, table.columns))}")
    one_member(source.name, table)
    check_columns(source.name, table, known)
    return without_repeats(source.name, table, [name for name in ("time_s", "wheel") if name in needed])


def _numbers(file: str, table: "pd.DataFrame", name: str) -> FloatArray:
    return numbers_of(file, name, table[name]) if name in table else np.full(len(table), np.nan)


def _positions(source: InputFile | None) -> dict[str, FloatArray]:
    if source is None:
        return {"fix_time_s": np.zeros(0), "fix_m": np.zeros((0, 2)), "fix_covariance_m2": np.zeros((0, 2, 2))}
    table, file = _read(source, ("time_s", "x_m", "y_m"), KNOWN_PLACES), source.name
    time, x, y = (_numbers(file, table, name) for name in ("time_s", "x_m", "y_m"))
    if "sigma_m" in table:
        sigma = _numbers(file, table, "sigma_m")
        parts = (sigma**2, 0 * sigma, sigma**2)
    elif all(name in table for name in ("xx_m2", "xy_m2", "yy_m2")):
        parts = tuple(_numbers(file, table, name) for name in ("xx_m2", "xy_m2", "yy_m2"))  # type: ignore[assignment]
    else:
        raise DataError(f"{file}: no errors of the positions; add sigma_m, or xx_m2, xy_m2 and yy_m2")
    covariance = np.stack([np.stack([parts[0], parts[1]], -1), np.stack([parts[1], parts[2]], -1)], -2)
    return {"fix_time_s": time, "fix_m": np.column_stack([x, y]), "fix_covariance_m2": covariance}


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
