"""Wheel states: what a rover measures or simulates of one wheel at one moment, and how well it is known.

All tables of wheel states are read and checked here, whatever they are for.

What to ask of wheel states: loads, pulls, slips and sinkages that would be likely in another unit or definition.
"""

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import check_columns, numbers_of, read_csv_table, without_repeats
from lunarsci.ranges import NOT_NEGATIVE, check_each
from lunarsci.regolith.columns import (
    FORCES,
    LENGTHS,
    OPTION,
    OVER_LOAD,
    SHARES,
    TRAVEL,
    NamedColumns,
    by_rim,
    by_travel,
    check_written_for,
    named_columns,
    unit_of_size,
)
from lunarsci.regolith.prior import LOAD_PRESSURE_PA, Law, Question, question
from lunarsci.regolith.prior import SLIPS as SLIPS_OF_UNITS
from lunarsci.regolith.wheel import MAX_VALID_SLIP, Wheel

if TYPE_CHECKING:
    import pandas as pd

LOAD_UNITS, UNSEEN_UNITS = ("N", "kN", "mN"), ("kgf", "lbf")
"""Of forces; a kilogram and a pound make loads that other wheels of that size have."""
PULL_OVER_LOAD, PULLING = Law("ln", 0.25, 0.7, "Wong 2008, ISBN 978-0-470-17038-0; width assumed"), 0.2
"""Largest drawbar pull of a wheel test, as a share of the load: 0.1 to 0.5 from such a slip on. [-]"""
SINKAGE = Law("ln", 0.12, 0.8, "5 to 40 % of wheels' radii; assumed")
"""Prior of a median sinkage over the radius. [-]"""
SLIPS: Mapping[str, Law] = {
    "%": Law("ln", 25.0, 1.0, "wheel tests go from 5 to 80 %; assumed"),
    TRAVEL: Law("ln", 0.4, 1.0, "the same as r w / v - 1; assumed"),
}
"""Priors of the median of slips that are no ratios from -1 to 1, as they are written, by unit or definition."""
USUAL_SLIP = 0.3
"""Slip ratio in the middle of what wheel tests try; assumed. [-]"""
ROUND, OFF, SURELY_ROUND = 0.05, 0.02, 1e4
"""Step of the slips that wheel tests are set to, how far off one a round number is at most, in steps, and the odds from
which they are taken for set ones; assumed."""
REQUIRED = ("sinkage_m", "normal_force_n", "drawbar_pull_n")
"""Columns that a state needs to be solved for its stresses."""
COLUMNS = ("sinkage_m", "slip_ratio", "side_slip_deg", "normal_force_n", "drawbar_pull_n", "lateral_force_n")
"""What is measured of a state, in the order of `WheelStates.values`: inputs of the wheel-soil laws, then forces."""
IDENTIFIERS = (
    *("id", "member", "wheel", "distance_m", "time_s", "x_m", "y_m", "resistance_torque_nm", "valid", "slip_basis"),
    *("x_m_sigma", "y_m_sigma", "resistance_torque_nm_sigma", "synthetic", "forces_from", "yaw_deg"),
    *("rim_m_s", "slip_ratio_shared", "doubt", "rover", "ground"),
)
"""Further columns of the tables that lunarsci writes: what tells states apart, and where they are from."""
EVERY_COLUMN = (*COLUMNS, *(f"{name}_sigma" for name in COLUMNS), *IDENTIFIERS)
"""All columns that have a meaning; of others those are refused that are nearly one of them."""
FROM_MOTION = "motion"
"""In the column `forces_from`: forces that were computed of a motion with drawn soils, not measured."""
LEAST_SINKAGE_M = 1e-6
"""Below it a wheel hardly touches the ground, and its state determines no soil; assumed. [m]"""
YES, NO = ("true", "1", "1.0", "yes"), ("false", "0", "0.0", "no")
"""Cells of the column `valid`, in lower case."""


def likely_sinkage_unit(median: float, wheel: Wheel) -> tuple[str, Question | None]:
    """The unit of a median sinkage as it is written, and what to ask where another one is nearly as likely."""
    low = {unit: SINKAGE.ln_density(median * LENGTHS[unit] / wheel.radius_m) for unit in ("m", "cm", "mm")}
    likely, other = sorted(low, key=lambda unit: -low[unit])[:2]
    if low[likely] + math.log(SLIPS_OF_UNITS) > low[other]:
        return likely, None
    usual = SINKAGE.median * wheel.radius_m / LENGTHS[likely]
    return likely, Question("median sinkage", median, usual, likely, f"{OPTION} sinkage_m={likely}", unitless=True)


def likely_slip(slip: FloatArray) -> str:
    """The definition, or unit, of slips (n,) that are no ratios from -1 to 1; '' where they are."""
    slip = slip[np.isfinite(slip)]
    if (np.abs(slip) <= 1).all():
        return TRAVEL if _set_by_travel(slip) else ""
    if slip.max() <= 1:
        return "rim"
    middle = float(np.median(slip[slip > 0]))
    return max(SLIPS, key=lambda unit: SLIPS[unit].ln_density(middle))


def _set_by_travel(slip: FloatArray) -> bool:
    """Whether slips within 1 were set to round numbers of 1 - v / (r w), and are written as r w / v - 1.

    By the odds of round numbers: one that nobody set is round by chance in a share of 2 `OFF` of cases.
    """
    each = np.unique(slip[slip > 0])
    steps = (each / ROUND, each / (1 + each) / ROUND)
    written, turned = (int((np.abs(one - np.rint(one)) < OFF).sum()) for one in steps)
    return (turned - written) * -math.log(2 * OFF) > math.log(SURELY_ROUND)


def force_questions(
    values: FloatArray,
    wheel: Wheel,
    unitless: Collection[str] = (),
    answered: Collection[str] = (),
    sizes: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Question, ...]:
    """What to ask of loads by what wheels of that size carry, and of pulls by the balance with the loads.

    `values` (n, 6) are in the order of `COLUMNS` of wheel states; `unitless` are columns that name no unit, `answered`
    those whose unit the user has said, `sizes` those of the units that the others were read in: what is asked is the
    unit of the numbers as they are written.
    """
    slip, load, pull = values[:, 1], values[:, 3], values[:, 4]
    carried = load[np.isfinite(load) & (load > 0)]
    if not carried.size:
        return ()
    middle = float(np.median(carried))
    law = replace(LOAD_PRESSURE_PA, median=LOAD_PRESSURE_PA.median * wheel.radius_m * wheel.width_m)
    query = None if "normal_force_n" in answered else _of_load(middle, law, unitless, sizes)
    off = _others("normal_force_n", (query.likely_unit,), sizes) if query and query.likely_unit else {}
    change, pulls = sum(off.values()) or 1.0, None
    if "drawbar_pull_n" not in answered and (pulls := _of_pull(slip, pull, change * middle, sizes)) and change != 1.0:
        unit = unit_of_size("drawbar_pull_n", change * sizes.get("drawbar_pull_n", 1.0))
        if query and unit and _of_pull(slip, pull, middle, sizes) is None:
            # The balance holds as it is written, so that the units of both are off by as much.
            query, pulls = replace(query, option=f"{query.option},drawbar_pull_n={unit}"), None
    return tuple(one for one in (query, pulls) if one is not None)


def _others(column: str, units: Sequence[str], sizes: Mapping[str, float]) -> dict[str, float]:
    """Units that a column of forces may be in, but for that it was read in, each with its size in that."""
    shares = {unit: FORCES[unit.lower()] / sizes.get(column, 1.0) for unit in units}
    return {unit: share for unit, share in shares.items() if not math.isclose(share, 1.0)}


def questions_by_name(
    values: FloatArray, wheel: Wheel, unitless: Collection[str], sizes: Mapping[str, float]
) -> tuple[Question, ...]:
    """The same where no option has units, so that names of columns answer."""
    return tuple(
        replace(one, option=f"name columns {', '.join(map(_name_of, one.option.removeprefix(OPTION).split(',')))}")
        for one in force_questions(values, wheel, unitless, sizes=sizes)
    )


def _name_of(answer: str) -> str:
    """The name of a column that says the unit of an answer of the option.

    >>> _name_of("normal_force_n=kN"), _name_of(" drawbar_pull_n=load")
    ('normal_force_kN', 'drawbar_pull_over_load')
    """
    column, _, unit = answer.strip().partition("=")
    return f"{column.rpartition('_')[0]}_{'over_load' if unit == OVER_LOAD else unit}"


def _of_pull(slip: FloatArray, pull: FloatArray, load: float, sizes: Mapping[str, float]) -> Question | None:
    """What to ask of pulls (n,) [N] at slips (n,) by their balance with a median load [N]; None for nothing."""
    most, share = float(np.nanmax(np.abs(pull), initial=0.0)), "a share of the load"
    if np.nanmax(np.abs(slip), initial=0.0) < PULLING:
        return None
    loads = _others("normal_force_n", ("N", "kN", *UNSEEN_UNITS), sizes)
    of_load, read = {f"{unit} (the load)": 1.0 / size for unit, size in loads.items()}, sizes.get("drawbar_pull_n", 1.0)
    units = _others("drawbar_pull_n", LOAD_UNITS, sizes) | {share: load / read} | of_load
    query = question("largest drawbar_pull_n over the load", most / load, PULL_OVER_LOAD, units)
    if query is None:
        return None
    column = "normal_force_n" if query.likely_unit in of_load else "drawbar_pull_n"
    unit = query.likely_unit.partition(" ")[0] or unit_of_size(column, read)
    unit = OVER_LOAD if query.likely_unit == share else unit
    return replace(query, option=f"{OPTION} {column}={unit}")


def _of_load(middle: float, law: Law, unitless: Collection[str], sizes: Mapping[str, float]) -> Question | None:
    """What to ask of a median load [N] by the law of those that wheels of that size carry; None for nothing."""
    named = "normal_force_n" not in unitless
    units = _others("normal_force_n", LOAD_UNITS if named else (*LOAD_UNITS, *UNSEEN_UNITS), sizes)
    query = question("median normal_force_n", middle, law, units)
    if query is None and not named:
        query = Question("median normal_force_n", middle, law.median, "N", OPTION, unitless=True)
    as_read = unit_of_size("normal_force_n", sizes.get("normal_force_n", 1.0))
    return query and replace(query, option=f"{OPTION} normal_force_n={query.likely_unit or as_read}")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasurementErrors:
    """Standard deviations used where a file gives none; 0 means exact.

    Defaults are the errors of Ding et al. (2024), 10.1038/s41467-024-46233-8, read as three standard deviations: 1 mm
    of sinkage, 10 % of the forces, 4 % of the travelled distance, from which the slip ratio s follows with an error of
    that share of 1 - |s|, and 4 % of the side slip.

    sinkage_m : of the sinkage. [m]
    force_relative, side_slip_relative : of each force and of the side slip, as shares of their sizes. [-]
    travel_relative : of the travelled distance, as a share of it. [-]
    """

    sinkage_m: float = 0.00033
    force_relative: float = 0.10 / 3
    travel_relative: float = 0.04 / 3
    side_slip_relative: float = 0.04 / 3

    def __post_init__(self) -> None:
        check_each("error of", self, dict.fromkeys(self.__slots__, NOT_NEGATIVE))

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
        return questions_by_name(self.values[self.valid], wheel, self.named.unitless, self.named.sizes)

    @property
    def wheels(self) -> tuple[str, ...]:
        """Name of the wheel of each row."""
        return tuple(self.table["wheel"].fillna("").str.strip())

    def subset(self, rows: BoolArray) -> "StateTable":
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
    `lunarsci.regolith.columns` says, and by `units`, with a warning. Any other one that is nearly one of them
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
    if wheels and "time_s" in columns and "wheel" not in columns:
        raise DataError(f"{file}: no column wheel; of telemetry, `lunarsci twin states` makes the states of each wheel")
    needs = (*(("time_s", "wheel") if wheels else ()), *needed)
    unused = check_columns(file, columns, EVERY_COLUMN, needs, named.written)
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
    named = named_columns(source.name, table, EVERY_COLUMN, units)
    if "sinkage_m" not in named.unitless:
        return named
    written = _numbers(source.name, named.table, "sinkage_m")
    unit, query = likely_sinkage_unit(float(np.median(written[np.isfinite(written)])), wheel)
    again = named_columns(source.name, table, EVERY_COLUMN, ",".join(filter(None, (units, f"sinkage_m={unit}"))))
    return replace(again, questions=() if query is None else (query,))


def _numbers(file: str, table: "pd.DataFrame", name: str) -> FloatArray:
    """A column as numbers, NaN where blank or missing. (n,) Raises DataError for text."""
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
    for column, low, high, rule in (
        ("sinkage_m", 0.0, radius_m, f"it is in metres, down is positive, and the wheel's radius is {radius_m:g} m"),
        ("slip_ratio", -1.0, 1.0, "it is a ratio from -1 to 1, no percentage"),
        ("side_slip_deg", -90.0, 90.0, "it lies within -90 to 90 deg"),
        ("normal_force_n", 0.0, np.inf, "the ground presses upwards, which is positive"),
    ):
        measured = values[np.isfinite(values[:, COLUMNS.index(column)]), COLUMNS.index(column)]
        middle = float(np.median(measured)) if measured.size else np.nan
        if middle < low or middle > high or (column == "sinkage_m" and middle in (low, high)):
            raise DataError(f"{file}: {column} has a median of {middle:.3g}; {rule}")


def _sigmas(file: str, table: "pd.DataFrame", values: FloatArray, errors: MeasurementErrors) -> FloatArray:
    """Standard errors of values (n, 6): those of the file, else those of `errors`. (n, 6) Raises DataError."""
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

    read = read_state_table(source, wheel, needed=REQUIRED, errors=errors, every=True, units=units)
    read, slip_queries = _with_slip(read)
    read, query = _with_sinkage(read, wheel)
    frame, named, rows = read.table, read.named, _complete_rows(read)
    if read.unused:
        # An error under another name than NAME_sigma would go unread.
        stems = [name.rpartition("_")[0] for name in read.unused if name.endswith(("_sd", "_std", "_err", "_error"))]
        hint = "; did you mean " + ", ".join(f"{stem}_sigma" for stem in stems) + "?" if stems else ""
        warnings.warn(f"{read.file}: columns not used: {', '.join(read.unused)}{hint}", LunarSciWarning, stacklevel=2)
    rows[rows] = _possible(read.file, read.values[rows], np.flatnonzero(rows), wheel)
    values = read.values[rows]
    if fast := int((np.abs(values[:, 1]) > MAX_VALID_SLIP).sum()):
        warnings.warn(
            f"{read.file}: |slip_ratio| above {MAX_VALID_SLIP} in {fast} rows, where the model is no longer accurate",
            LunarSciWarning,
            stacklevel=2,
        )
    numbered = pd.Series([str(n) for n in range(1, len(frame) + 1)])
    ids = frame["id"].fillna(numbered) if "id" in frame else numbered
    stated = any(f"{name}_sigma" in frame for name in COLUMNS[3:])
    return WheelStates(
        tuple(ids[rows].astype(str)),
        values,
        np.where(np.isfinite(values), read.sigmas[rows], 0.0),
        stated=stated,
        alike="forces_from" in frame and bool((frame["forces_from"][rows] == FROM_MOTION).all()),
        wheels=tuple(sorted(set(read.wheels))) if "wheel" in frame else (),
        unstated=tuple(name for name in COLUMNS if stated and f"{name}_sigma" not in frame),
        read_as=named.read_as,
        questions=(
            *(*slip_queries, *query, *named.questions),
            *force_questions(values, wheel, named.unitless, named.answered, named.sizes),
        ),
    )


def _with_sinkage(read: StateTable, wheel: Wheel) -> tuple[StateTable, tuple[Question, ...]]:
    """A table with sinkages of wheels that are not above their heads, and what to ask where they were."""
    measured = read.values[read.valid & np.isfinite(read.values[:, 0]), 0]
    if not measured.size or (middle := float(np.median(measured))) < wheel.radius_m:
        return read, ()
    size = read.named.sizes.get("sinkage_m", 1.0)
    unit, _ = likely_sinkage_unit(middle / size, wheel)
    scale = LENGTHS[unit] / size
    as_read, other = (SINKAGE.ln_density(middle * one / wheel.radius_m) for one in (1.0, scale))
    if not (middle * scale < wheel.radius_m and other + math.log(SLIPS_OF_UNITS) > as_read):
        return read, ()
    values, sigmas = read.values.copy(), read.sigmas.copy()
    values[:, 0] *= scale
    sigmas[:, 0] *= scale if "sinkage_m_sigma" in read.table else 1.0
    usual = SINKAGE.median * wheel.radius_m
    query = Question("median sinkage_m", middle, usual, unit, f"{OPTION} sinkage_m={unit}")
    return replace(read, values=values, sigmas=sigmas), (query,)


def _with_slip(read: StateTable) -> tuple[StateTable, tuple[Question, ...]]:
    """A table with slips as ratios from -1 to 1, and what to ask where they were none."""
    slip = read.values[:, 1]
    if "slip_ratio" in read.named.answered or not (unit := likely_slip(slip[read.valid])):
        return read, ()
    values = read.values.copy()
    values[:, 1] = by_travel(slip) if unit == TRAVEL else by_rim(slip) if unit == "rim" else SHARES[unit] * slip
    worst = float(slip[read.valid][np.nanargmax(np.abs(slip[read.valid]))])
    meaning = {"%": "%", TRAVEL: "r w / v - 1", "rim": "1 - v / (r w), in skid too"}[unit]
    query = Question("largest slip_ratio", worst, USUAL_SLIP, meaning, f"{OPTION} slip_ratio={unit}")
    return replace(read, values=values), (query,)


def _complete_rows(read: StateTable) -> BoolArray:
    rows = np.isfinite(read.values[:, [COLUMNS.index(name) for name in REQUIRED]]).all(axis=1) & read.valid
    if not rows.any():
        raise DataError(f"{read.file}: no row has all of {', '.join(REQUIRED)}; fill them in")
    if not rows.all():
        warnings.warn(
            f"{read.file}: {(~rows).sum()} of {rows.size} rows left out (a required value missing, or marked not "
            "valid)",
            LunarSciWarning,
            stacklevel=3,
        )
    return rows


def _doubt_of_sinkage(sinkage_m: FloatArray) -> str:
    """What could be wrong with sinkages that no wheel has, and the option that says so."""
    if np.nanmax(sinkage_m, initial=-np.inf) <= 0:
        return f"is its sign turned ({OPTION} sinkage_m=-1)?"
    if not (least := float(np.nanmin(sinkage_m, initial=np.inf))) < LEAST_SINKAGE_M:
        return f"is it in another unit ({OPTION} sinkage_m=mm)?"
    return f"is its zero off ({OPTION} sinkage_m={math.ceil(1e3 * (1e-3 - least)) / 1e3:+.3g})?"


def _possible(file: str, values: FloatArray, rows: IndexArray, wheel: Wheel) -> BoolArray:
    """Rows that a wheel can have; others are left out with a warning. (n,)

    Raises DataError where most are others, or wheels float: then the zero of the sinkage is wrong in all rows.
    """
    bad, text = impossible(file, values, rows, wheel, REQUIRED)
    if 2 * bad.sum() > bad.size or (values[:, 0] < LEAST_SINKAGE_M).any():
        raise DataError(text)
    if bad.any():
        first = text.partition(";")[0]
        warnings.warn(f"{bad.sum()} of {bad.size} rows left out, the first: {first}", LunarSciWarning, stacklevel=3)
    return ~bad


def impossible(
    file: str, values: FloatArray, rows: IndexArray, wheel: Wheel, required: Collection[str]
) -> tuple[BoolArray, str]:
    """Rows with a value in the order of `COLUMNS` that no wheel can have, or a blank that is required (n,), and the
    first of them in words."""
    depth, under = values[:, 0], f"above 1e-6 and below the wheel radius of {wheel.radius_m:g} m"
    rules = (
        ((depth >= LEAST_SINKAGE_M) & (depth < wheel.radius_m), f"{under}; {_doubt_of_sinkage(depth)}"),
        (np.abs(values[:, 1]) <= 1, "within -1 to 1"),
        (np.abs(values[:, 2]) <= 90, "within -90 to 90 deg"),
        (values[:, 3] > 0, "above 0 N"),
    )
    every, first_text = np.zeros(len(values), dtype=bool), ""
    for k, (good, rule) in enumerate(rules):
        bad = ~good & (np.isfinite(values[:, k]) | (COLUMNS[k] in required))
        if bad.any() and not first_text:
            first = int(np.argmax(bad))
            text = f"{values[first, k]:g} is impossible; it must lie {rule}"
            first_text = f"{file}, row {rows[first] + 1}, {COLUMNS[k]}: {text}"
        every |= bad
    return every, first_text
