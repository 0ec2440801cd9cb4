"""Wheel states: what a rover measures or simulates of one wheel at one moment, and how well it is known.

All tables of wheel states are read and checked here, whatever they are for.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import check_columns, numbers_of, read_csv_table, without_repeats
from lunarsci.regolith.questions import Question
from lunarsci.regolith.state_questions import (
    SINKAGE,
    another_unit,
    converted_slip,
    force_questions,
    likely_sinkage_unit,
    likely_slip,
    questions_by_name,
    slip_question,
)
from lunarsci.regolith.wheel import MAX_VALID_SLIP, Wheel
from lunarsci.regolith.written_columns import LENGTHS, OPTION, NamedColumns, named_columns
from lunarsci.regolith.written_names import check_written_for

if TYPE_CHECKING:
    import pandas as pd


REQUIRED = ("sinkage_m", "normal_force_n", "drawbar_pull_n")
COLUMNS = ("sinkage_m", "slip_ratio", "side_slip_deg", "normal_force_n", "drawbar_pull_n", "lateral_force_n")
IDENTIFIERS = (
    *("id", "member", "wheel", "distance_m", "time_s", "x_m", "y_m", "resistance_torque_nm", "valid", "slip_basis"),
    *("x_m_sigma", "y_m_sigma", "resistance_torque_nm_sigma", "synthetic", "forces_from", "yaw_deg"),
    *("rim_m_s", "slip_ratio_shared", "doubt", "rover", "ground"),
)
KNOWN = (*COLUMNS, *(f"{name}_sigma" for name in COLUMNS), *IDENTIFIERS)
FROM_MOTION = "motion"
"""In the column `forces_from`: forces that were computed of a motion with drawn soils, not measured."""
LEAST_SINKAGE_M = 1e-6
YES, NO = ("true", "1", "1.0", "yes"), ("false", "0", "0.0", "no")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasurementErrors:
    """Standard deviations used where a file gives none; 0 means exact.

    Defaults are the errors of Ding et al. (2024), 10.1038/s41467-024-46233-8, read as three standard deviations: 1 mm
    of sinkage, 10 % of the forces, 4 % of the travelled distance, from which the slip ratio s follows with an error of
    that share of 1 - |s|, and 4 % of the side slip.
    """

    sinkage_m: float = 0.00033
    force_relative: float = 0.10 / 3
    travel_relative: float = 0.04 / 3
    side_slip_relative: float = 0.04 / 3

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"error of {name} is {getattr(self, name)}; give 0 or more")

    def of(self, column: str, values: FloatArray) -> FloatArray:
        """Standard deviation of a column, in the column's unit; shape of `values`."""
        if column == "sinkage_m":
            return np.full(values.shape, self.sinkage_m)
        if column == "slip_ratio":
            return (1 - np.abs(values)) * self.travel_relative
        return np.abs(values) * (self.side_slip_relative if column == "side_slip_deg" else self.force_relative)


@dataclass(frozen=True, slots=True, eq=False)
class WheelStates:
    """n wheel states.

    Attributes
    ----------
    id : n names.
    values, sigmas : shape (n, 6), columns in the order of `COLUMNS` [m, -, deg, N, N, N]; NaN in `values` where a
        slip, side slip or lateral force was not measured.
    stated : whether the errors of the forces come from the file, not from `MeasurementErrors`.
    alike : whether they are alike in all states, as those of forces that were computed of a motion with drawn soils.
    wheels : names of the wheels, each once; none where the file has no column `wheel`.
    unstated : columns whose errors are those of `MeasurementErrors` although the file has the errors of a force.
    read_as : how columns were read that have other names or units.
    questions : what to ask of them.
    """

    id: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    stated: bool = False
    alike: bool = False
    wheels: tuple[str, ...] = ()
    unstated: tuple[str, ...] = ()
    read_as: tuple[str, ...] = ()
    questions: tuple[Question, ...] = ()

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True, eq=False)
class StateTable:
    """A table of n wheel states, checked.

    Attributes
    ----------
    file : where it comes from.
    table : its cells as text, each row once.
    values, sigmas : shape (n, 6), columns in the order of `COLUMNS` [m, -, deg, N, N, N]; NaN in `values` where blank.
    valid : rows not marked otherwise. (n,)
    unused : columns that nobody knows.
    named : how columns were read that have other names or units.
    """

    file: str
    table: "pd.DataFrame"
    values: FloatArray
    sigmas: FloatArray
    valid: BoolArray
    unused: tuple[str, ...]
    named: NamedColumns

    def numbers(self, name: str) -> FloatArray:
        """A column as numbers, NaN where blank or missing. (n,) Raises DataError for text."""
        return _numbers(self.file, self.table, name)

    def questions(self, wheel: Wheel) -> tuple[Question, ...]:
        """What to ask of its forces: loads and pulls that would be likely in another unit."""
        return questions_by_name(self.values[self.valid], wheel, self.named.unitless)

    @property
    def wheels(self) -> tuple[str, ...]:
        """Name of the wheel of each row."""
        return tuple(self.table["wheel"].fillna("").str.strip())

    def kept(self, rows: BoolArray) -> "StateTable":
        """Some of the rows."""
        table = self.table[rows].reset_index(drop=True)
        return replace(self, table=table, values=self.values[rows], sigmas=self.sigmas[rows], valid=self.valid[rows])


def read_state_table(
    source: InputFile,
    wheel: Wheel,
    *,
    needed: Sequence[str] = (),
    measured: Sequence[str] = COLUMNS,
    wheels: Sequence[str] = (),
    rover: str = "",
    errors: MeasurementErrors | None = None,
    every: bool = False,
    any_wheel: bool = False,
    units: str = "",
) -> StateTable:
    """Read a table of wheel states from CSV.

    Columns: those of `COLUMNS`, `NAME_sigma` for the standard deviation of NAME (else that of `errors`), `valid`, and
    what tells states apart (`IDENTIFIERS`); or the same by other names and in other units, as
    `lunarsci.regolith.written_columns` says, and by `units`, with a warning. Any other one that is nearly one of them
    is refused: a slip of the pen. Rows that are there twice count once, with a warning, where `time_s` and `wheel`
    tell.

    Parameters
    ----------
    needed : columns that must be there.
    measured : columns of which one must be there.
    wheels, rover : of one drive of a rover: names of its wheels, one of which each state belongs to, at a time.
    every : whether the caller checks the range of every value; else that of the medians is checked.
    any_wheel : whether `wheel` is only for ranges, and the states may be those of another.

    Raises
    ------
    DataError for a missing or misspelt column, text among numbers, a blank time, rows that contradict each other,
    several drives where one is read, values that are mostly of a wrong sign or unit, and a column `rover` of another
    wheel.
    """
    file, named = source.name, _named(source, wheel, units)
    table = named.table
    if named.read_as and not every:
        warnings.warn(f"{file}: read as: {'; '.join(named.read_as)}", LunarSciWarning, stacklevel=2)
    columns = [str(name) for name in table.columns]
    if "normal_force_n" in needed and "normal_force_n" not in columns and {"wheel", "slip_ratio"} <= {*columns}:
        raise DataError(
            f"{file}: no column normal_force_n: states of a drive without forces; `lunarsci twin update` learns the "
            "soil from them, `lunarsci twin loads --motion motion.csv --states states.csv` adds forces"
        )
    unused = check_columns(file, columns, KNOWN, (*(("time_s", "wheel") if wheels else ()), *needed))
    if not any(name in columns for name in measured):
        raise DataError(f"{file}: no measured column; there can be {', '.join(measured)}")
    if not any_wheel:
        check_written_for(file, table, wheel, rover)
    if wheels:
        _check_drive(file, table, wheels, rover)
    if "time_s" in columns and "wheel" in columns:
        table = without_repeats(file, table, ["time_s", "wheel", *(["member"] if "member" in columns else [])])
    valid = _valid(file, table["valid"]) if "valid" in table else np.ones(len(table), dtype=bool)
    values = np.column_stack([_numbers(file, table, name) for name in COLUMNS])
    if not every:
        _check_scale(file, values[valid], wheel.radius_m)
    sigmas = _sigmas(file, table, values, errors or MeasurementErrors())
    return StateTable(file, table, values, sigmas, valid, tuple(unused), named)


def _named(source: InputFile, wheel: Wheel, units: str) -> NamedColumns:
    """The columns under their own names; a sinkage without a unit in the one that makes it likely under this wheel."""
    table = read_csv_table(source)
    named = named_columns(source.name, table, KNOWN, units)
    if "sinkage_m" not in named.unitless:
        return named
    written = _numbers(source.name, named.table, "sinkage_m")
    unit, asked = likely_sinkage_unit(float(np.median(written[np.isfinite(written)])), wheel)
    again = named_columns(source.name, table, KNOWN, ",".join(filter(None, (units, f"sinkage_m={unit}"))))
    return replace(again, questions=() if asked is None else (asked,))


def _numbers(file: str, table: "pd.DataFrame", name: str) -> FloatArray:
    return numbers_of(file, name, table[name]) if name in table else np.full(len(table), np.nan)


def _check_drive(file: str, table: "pd.DataFrame", wheels: Sequence[str], rover: str) -> None:
    """Refuse several drives in one, as `twin predict` writes, blank times, and wheels that the rover has not."""
    if "member" in table and table["member"].nunique() > 1:
        raise DataError(f"{file}: {table['member'].nunique()} drives (column member); keep the rows of one")
    if len(blank := np.flatnonzero(~np.isfinite(_numbers(file, table, "time_s")))):
        raise DataError(f"{file}, row {blank[0] + 1}, time_s: is blank; every state needs a time")
    if strange := sorted(set(table["wheel"].fillna("").str.strip()) - set(wheels)):
        raise DataError(f"{file}: '{strange[0]}' is no wheel of {rover}; it has {', '.join(wheels)}")


def _valid(file: str, cells: Any) -> BoolArray:
    """Which cells of a column `valid`, as text, say yes; blank is no. Raises DataError for other words."""
    words = cells.fillna("").str.strip().str.lower()
    unknown = ~words.isin([*YES, *NO])
    if unknown.any():
        row = int(np.argmax(unknown))
        raise DataError(f"{file}, row {row + 1}, valid: '{cells.iloc[row]}' is neither true nor false")
    return np.asarray(words.isin(YES), dtype=bool)


def _check_scale(file: str, values: FloatArray, radius_m: float) -> None:
    """Refuse values that are mostly of a wrong sign or unit."""
    for column, low, high, said in (
        ("sinkage_m", 0.0, radius_m, f"it is in metres, down is positive, and the wheel's radius is {radius_m:g} m"),
        ("slip_ratio", -1.0, 1.0, "it is a ratio from -1 to 1, no percentage"),
        ("side_slip_deg", -90.0, 90.0, "it lies within -90 to 90 deg"),
        ("normal_force_n", 0.0, np.inf, "the ground presses upwards, which is positive"),
    ):
        known = values[np.isfinite(values[:, COLUMNS.index(column)]), COLUMNS.index(column)]
        middle = float(np.median(known)) if known.size else np.nan
        if middle < low or middle > high or (column == "sinkage_m" and middle in (low, high)):
            raise DataError(f"{file}: {column} has a median of {middle:.3g}; {said}")


def _sigmas(file: str, table: "pd.DataFrame", values: FloatArray, errors: MeasurementErrors) -> FloatArray:
    columns = []
    for k, name in enumerate(COLUMNS):
        given = _numbers(file, table, f"{name}_sigma")
        if (wrong := (given < 0) | np.isinf(given)).any():
            raise DataError(f"{file}, row {int(np.argmax(wrong)) + 1}, {name}_sigma: give 0 or more, or leave it blank")
        columns.append(np.where(np.isfinite(given), given, errors.of(name, np.nan_to_num(values[:, k]))))
    return np.column_stack(columns)


def read_states(
    source: InputFile, wheel: Wheel, errors: MeasurementErrors | None = None, units: str = ""
) -> WheelStates:
    """Read wheel states from CSV, as `read_state_table` does; what would be likely in another unit is asked about.

    Lateral forces have the sign of the side slip they act against.

    Columns `sinkage_m`, `normal_force_n` and `drawbar_pull_n` are required; `forces_from` is `motion` where forces were
    computed of a motion. Rows marked `valid = false` and rows without a required value are left out with a warning,
    columns of no use are named by one.

    Raises
    ------
    DataError for what `read_state_table` refuses, a value no wheel can have, or nothing to use.
    """
    import pandas as pd

    found = read_state_table(source, wheel, needed=REQUIRED, errors=errors, every=True, units=units)
    found, questions = _with_slip(found)
    found, asked = _with_sinkage(found, wheel)
    questions += asked
    if found.unused:
        # An error under another name than NAME_sigma would go unread.
        stems = [name.rpartition("_")[0] for name in found.unused if name.endswith(("_sd", "_std", "_err", "_error"))]
        hint = "; did you mean " + ", ".join(f"{stem}_sigma" for stem in stems) + "?" if stems else ""
        warnings.warn(f"{found.file}: columns not used: {', '.join(found.unused)}{hint}", LunarSciWarning, stacklevel=2)
    keep, frame = _kept_rows(found), found.table
    values = found.values[keep]
    _check_values(found.file, values, np.flatnonzero(keep), wheel)
    numbered = pd.Series([str(n) for n in range(1, len(frame) + 1)])
    ids = frame["id"].fillna(numbered) if "id" in frame else numbered
    stated = any(f"{name}_sigma" in frame for name in COLUMNS[3:])
    alike = "forces_from" in frame and bool((frame["forces_from"][keep] == FROM_MOTION).all())
    sigmas = np.where(np.isfinite(values), found.sigmas[keep], 0.0)
    wheels = tuple(sorted(set(found.wheels))) if "wheel" in frame else ()
    unstated = tuple(name for name in COLUMNS if stated and f"{name}_sigma" not in frame)
    questions += found.named.questions + force_questions(values, wheel, found.named.unitless, found.named.answered)
    told = found.named.read_as
    return WheelStates(tuple(ids[keep].astype(str)), values, sigmas, stated, alike, wheels, unstated, told, questions)


def _with_sinkage(found: StateTable, wheel: Wheel) -> tuple[StateTable, tuple[Question, ...]]:
    """A table with sinkages of wheels that are not above their heads, and what to ask where they were."""
    known = found.values[found.valid & np.isfinite(found.values[:, 0]), 0]
    if not known.size or (middle := float(np.median(known))) < wheel.radius_m:
        return found, ()
    if not (unit := another_unit(middle, wheel)):
        return found, ()
    usual, size = SINKAGE.median * wheel.radius_m, LENGTHS[unit]
    values, sigmas = found.values.copy(), found.sigmas.copy()
    values[:, 0] *= size
    sigmas[:, 0] *= size if "sinkage_m_sigma" in found.table else 1.0
    asked = Question("median sinkage_m", middle, usual, unit, f"{OPTION} sinkage_m={unit}")
    return replace(found, values=values, sigmas=sigmas), (asked,)


def _with_slip(found: StateTable) -> tuple[StateTable, tuple[Question, ...]]:
    """A table with slips as ratios from -1 to 1, and what to ask where they were none."""
    slip = found.values[:, 1]
    if "slip_ratio" in found.named.answered or not (unit := likely_slip(slip[found.valid])):
        return found, ()
    values = found.values.copy()
    values[:, 1] = converted_slip(slip, unit)
    return replace(found, values=values), (slip_question(slip[found.valid], unit),)


def _kept_rows(found: StateTable) -> BoolArray:
    complete = np.isfinite(found.values[:, [COLUMNS.index(name) for name in REQUIRED]]).all(axis=1)
    keep = complete & found.valid
    if not keep.any():
        raise DataError(f"{found.file}: no row has all of {', '.join(REQUIRED)}; fill them in")
    if not keep.all():
        warnings.warn(
            f"{found.file}: {(~keep).sum()} of {keep.size} rows left out (a required value missing, or marked not "
            "valid)",
            LunarSciWarning,
            stacklevel=3,
        )
    return keep


def _doubt_of_sinkage(sinkage_m: FloatArray) -> str:
    """What could be wrong with sinkages that no wheel has, and the option that says so."""
    if (least := float(np.nanmin(sinkage_m))) >= LEAST_SINKAGE_M:
        return f"is it in another unit ({OPTION} sinkage_m=mm)?"
    return f"is its zero off ({OPTION} sinkage_m={math.ceil(1e3 * (1e-3 - least)) / 1e3:+.3g})?"


def _check_values(name: str, values: FloatArray, rows: IndexArray, wheel: Wheel) -> None:
    z, s, beta, load = values[:, 0], values[:, 1], values[:, 2], values[:, 3]
    for column, bad, rule in (
        (
            "sinkage_m",
            ~((z >= LEAST_SINKAGE_M) & (z < wheel.radius_m)),
            f"above 1e-6 and below the wheel radius of {wheel.radius_m:g} m; {_doubt_of_sinkage(z)}",
        ),
        ("slip_ratio", np.abs(s) > 1, "within -1 to 1"),
        ("side_slip_deg", np.abs(beta) > 90, "within -90 to 90 deg"),
        ("normal_force_n", ~(load > 0), "above 0 N"),
    ):
        if bad.any():
            first = int(np.argmax(bad))
            value = values[first, COLUMNS.index(column)]
            raise DataError(f"{name}, row {rows[first] + 1}, {column}: {value:g} is impossible; it must lie {rule}")
    fast = int((np.abs(s) > MAX_VALID_SLIP).sum())
    if fast:
        warnings.warn(
            f"{name}: |slip_ratio| above {MAX_VALID_SLIP} in {fast} rows, where the model is no longer accurate",
            LunarSciWarning,
            stacklevel=3,
        )
