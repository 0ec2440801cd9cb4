"""Telemetry of a drive as numbers: read from CSV, ECSV and Parquet by the columns' names, and what is wrong."""

import io
import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile, InputStream, open_input
from lunarsci.io.tables import (
    check_columns,
    csv_tables,
    line_pieces,
    numbers_of,
    parquet_tables,
    read_csv_table,
    without_repeats,
)
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.columns import (
    ERRORS,
    NEEDED,
    UNIT,
    UNITS,
    check_telemetry_columns,
    in_own_words,
    named_columns,
)
from lunarsci.twin.telemetry.rests import RowsKept

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that is wrong with telemetry.

    Attributes
    ----------
    kind : a word for it, such as `gap`.
    count : how many rows, positions or wheels it concerns.
    time_s : when it is first seen, None where it has no time. [s]
    what, done : what was found, and what was done about it.
    doubt : whether the result should not be trusted for it.
    """

    kind: str
    count: int
    time_s: float | None
    what: str
    done: str
    doubt: bool = False


@dataclass(slots=True)
class Findings:
    """The findings of one file, each said once as a warning when it is added."""

    file: str
    entries: list[Finding] = field(default_factory=list)

    def add(
        self, kind: str, what: str, done: str, *, count: int = 1, time_s: float | None = None, doubt: bool = False
    ) -> None:
        """Note and say one finding."""
        self.entries.append(Finding(kind=kind, count=count, time_s=time_s, what=what, done=done, doubt=doubt))
        when = "" if time_s is None else f" at time_s {time_s:.6g}"
        warnings.warn(f"{self.file}: {kind}{when}: {what}; {done}", LunarSciWarning, stacklevel=3)

    @property
    def doubt(self) -> str:
        """Why the result should not be trusted, empty if it may be."""
        return "; ".join(f"{entry.kind}: {entry.what}" for entry in self.entries if entry.doubt)


SPELLED = {"deg_s": "deg/s", "rpm": "cycle/min", "turns": "cycle", "m2": "m2", "cm2": "cm2", "mm2": "mm2"}
"""Units that astropy spells otherwise than names of columns do."""
POSE_COLUMNS = ("yaw_deg", "yaw_deg_sigma", "roll_deg", "pitch_deg")
WHEEL_COLUMNS = {
    "speed_m_s": "speed_{}_m_s",
    "steering_deg": "steering_{}_deg",
    "angle_deg": "angle_{}_deg",
    "rate_deg_s": "rate_{}_deg_s",
    "steered_deg": "steered_{}_deg",
}
"""Commanded rim speed and steering; measured angle since some start, rate and steering. Name to column of a wheel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Telemetry:
    """Rows of telemetry, in the order of time; NaN where a row lacks a value.

    Attributes
    ----------
    file : where it comes from.
    time_s : since the start of the plan, ascending. (n,) [s]
    fix_m, fix_covariance_m2 : localised positions of the rover's origin and their errors. (n, 2), (n, 2, 2)
    fix_shared_m2 : covariance of each position's error with that of the one before; None where none is known of.
        (n, 2, 2)
    yaw_deg, yaw_deg_sigma : heading from x to the left and its error. (n,) [deg]
    roll_deg, pitch_deg : attitude, pitch positive nose down. (n,) [deg]
    speed_m_s, steering_deg : commanded rim speed r_s omega and steering of each wheel. (n, wheels) [m/s, deg]
    angle_deg, rate_deg_s, steered_deg : measured angle, rate and steering of each wheel. (n, wheels)
    synthetic : whether the file says that it is made up.
    rests_s : begin and end of rests within which rows are left out (see `rests`). [s]
    rows : how many the file has.
    start_s : what the file's `time_s` is at the start of the plan. [s]
    """

    file: str
    time_s: FloatArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray
    yaw_deg: FloatArray
    yaw_deg_sigma: FloatArray
    roll_deg: FloatArray
    pitch_deg: FloatArray
    speed_m_s: FloatArray
    steering_deg: FloatArray
    angle_deg: FloatArray
    rate_deg_s: FloatArray
    steered_deg: FloatArray
    synthetic: bool
    fix_shared_m2: FloatArray | None = None
    rests_s: tuple[tuple[float, float], ...] = ()
    rows: int = 0
    start_s: float = 0.0

    @property
    def rested(self) -> BoolArray:
        """Steps between rows within `rests_s`. (n - 1,)"""
        if not self.rests_s:
            return np.zeros(len(self.time_s) - 1, dtype=bool)
        begin, end = np.array(self.rests_s).T
        rest = np.searchsorted(begin, self.time_s[:-1], side="right") - 1
        return np.asarray((rest >= 0) & (self.time_s[1:] <= end[rest]))

    @property
    def fixed(self) -> BoolArray:
        """Rows with a localised position. (n,)"""
        return np.asarray(np.isfinite(self.fix_m).all(axis=1))

    @property
    def turned_deg(self) -> FloatArray:
        """Steering as measured, else as commanded. (n, wheels) [deg]"""
        return np.where(np.isfinite(self.steered_deg), self.steered_deg, self.steering_deg)


OF_PLACES = ("x_m", "y_m", "sigma_m", *ERRORS)
DATE = re.compile(r"\s*\d{4}-\d\d?-\d\d?|\s*\d\d?:\d\d|\s*\d\d?[./]\d\d?[./]\d{2,4}")
SYNTHETIC = ("true", "1", "1.0")
YAW_SIGMA_DEG, POSITION_SIGMA_M = 0.3, 0.02
"""Error of a heading, and of a position, whose error is not given; assumed. [deg, m]"""

SHARED = ("xx_before_m2", "xy_before_m2", "yx_before_m2", "yy_before_m2")
"""Covariance of x and y of a position with x and y of the one in the row before."""
KNOWN_PLACES = ("time_s", "x_m", "y_m", "z_m", "yaw_deg", "sigma_m", *ERRORS, *SHARED, "synthetic")


class Positions(NamedTuple):
    """Positions of the rover's origin from localisation, and their errors. (n,) [s], (n, 2) [m], (n, 2, 2) [m2]

    `shared_m2` is the covariance of each error with that of the position before; None where errors are independent.
    """

    time_s: FloatArray
    place_m: FloatArray
    covariance_m2: FloatArray
    shared_m2: FloatArray | None = None

    @classmethod
    def none(cls) -> "Positions":
        """Not one."""
        return cls(np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)))


def read_positions(source: InputFile) -> Positions:
    """Read positions from CSV: `time_s`, `x_m`, `y_m`, `sigma_m` or `xx_m2`, `xy_m2`, `yy_m2`, and optionally `SHARED`.

    Rows without a time, as of stations that are not on the drive, are left out. Raises DataError, also for rows of one
    time that contradict each other.
    """
    file = source.name
    table = in_own_words(file, read_csv_table(source))
    check_columns(file, table.columns, KNOWN_PLACES, ("time_s", "x_m", "y_m"))
    timed = table["time_s"].fillna("").str.strip() != ""
    if not timed.any():
        raise DataError(f"{file}: no position has a time; add time_s, in s from the start of the drive")
    for name in {*SHARED} & {*table}:
        table.loc[~timed.shift(fill_value=False), name] = "0"
    table = table[timed].reset_index(drop=True)
    table = without_repeats(file, table, ["time_s"])
    values = {
        name: numbers_of(file, name, table[name])
        for name in ("time_s", "x_m", "y_m", "sigma_m", *ERRORS, *SHARED)
        if name in table
    }
    if "sigma_m" not in values and not all(name in values for name in ERRORS):
        raise DataError(f"{file}: no errors of the positions; add sigma_m, or xx_m2, xy_m2 and yy_m2")
    place, covariance = np.column_stack([values["x_m"], values["y_m"]]), _covariance(file, values)
    shared = None
    if any(name in values for name in SHARED):
        if missing := [name for name in (*ERRORS, *SHARED) if name not in values]:
            raise DataError(f"{file}: no column {missing[0]}; covariances with the row before need all of them")
        shared = np.nan_to_num(np.column_stack([values[name] for name in SHARED])).reshape(-1, 2, 2)
        try:
            np.linalg.cholesky(joint_m2(covariance, shared))
        except np.linalg.LinAlgError:
            text = f"{file}: {', '.join(SHARED)} with xx_m2, xy_m2, yy_m2 are no covariance of all positions"
            raise DataError(text) from None
    return Positions(values["time_s"], place, covariance, shared)


def joint_m2(covariance_m2: FloatArray, shared_m2: FloatArray | None) -> FloatArray:
    """Covariance of the errors of all positions (2 n, 2 n), each of which follows the one before (a Markov chain).

    With C of each and S with the one before, S C^-1 of the one before carries its covariances on.
    """
    count = len(covariance_m2)
    joint = np.zeros((count, 2, count, 2))
    for k, own in enumerate(covariance_m2):
        joint[k, :, k] = own
        if k and shared_m2 is not None and shared_m2[k].any():
            carried = shared_m2[k] @ np.linalg.inv(covariance_m2[k - 1])
            joint[k, :, :k] = np.einsum("ij,jlm->ilm", carried, joint[k - 1, :, :k])
            joint[:k, :, k] = np.moveaxis(joint[k, :, :k], 0, -1)
    return np.asarray(joint.reshape(2 * count, 2 * count))


def read_telemetry(
    source: InputFile | InputStream,
    rover: Rover,
    findings: Findings,
    *,
    placed: bool = True,
    span_s: tuple[float, float] = (-math.inf, math.inf),
    start_s: float | None = None,
) -> Telemetry:
    """Read telemetry, by the ending of its file: .ecsv, .parquet, else CSV, a piece at a time.

    Columns `time_s`, `x_m`, `y_m` (blank where there is no position), `sigma_m` or `xx_m2`, `xy_m2`, `yy_m2`,
    `yaw_deg`; optionally `yaw_deg_sigma`, `roll_deg`, `pitch_deg`, `synthetic`; and of each wheel FL, FR, ...
    `speed_FL_m_s`, `steering_FL_deg` (commanded), `angle_FL_deg`, `rate_FL_deg_s`, `steered_FL_deg` (measured). What a
    wheel did must be there for all of them: angle or rate or speed, and steered or steering.

    Rows stay in the order of the file, without those of a rover that rests (see `rests`), and without those whose time
    is not within `span_s`; with `start_s`, the file's time of the start of the plan, times count from there, and rows
    before are left out. Where positions come from elsewhere (`placed` False) none are read here. Raises DataError for
    columns that are missing, in another unit, or of another rover's wheels, for text among numbers, and for more rows
    of a rover that does not rest than there is memory for.
    """
    kept, infinite, synthetic = RowsKept(source.name, rover), dict[str, int](), False
    begin = -math.inf if start_s is None else start_s
    with open_input(source) as stream:
        for table in tables_of(stream, findings):
            values = _numbers(source.name, table, rover, placed=placed)
            names = list(values)
            _count_infinities(values, infinite)
            outside = (values["time_s"] < max(span_s[0], begin)) | (values["time_s"] > span_s[1])
            values["time_s"] = values["time_s"] - (start_s or 0.0)
            kept.add({name: column[~outside] for name, column in values.items()})
            if "synthetic" in table:
                synthetic = synthetic or bool(table["synthetic"].astype(str).str.lower().isin(SYNTHETIC).any())
    for name, count in infinite.items():
        findings.add("infinite values", f"{name} is infinite", "taken as blank", count=count)
    if not kept.read:
        first, last = max(span_s[0], begin), span_s[1]
        raise DataError(f"{source.name}: no rows between time_s {first:.12g} and {last:.12g}; give others")
    found = _telemetry(source.name, kept, names, rover, findings, synthetic=synthetic)
    return replace(found, start_s=start_s or 0.0)


def _numbers(file: str, table: "pd.DataFrame", rover: Rover, *, placed: bool) -> dict[str, FloatArray]:
    """The columns that count, of a piece."""
    columns = named_columns([str(name) for name in table.columns])
    names = list(columns)
    check_telemetry_columns(file, names, rover, placed=placed)
    known = [name for name in _known(names, rover) if placed or name not in OF_PLACES]
    first = str(next(iter(table[columns["time_s"][0]].dropna()), ""))
    if DATE.match(first):
        table = table.assign(**{columns["time_s"][0]: _since_1970_s(file, table[columns["time_s"][0]])})
    return {name: columns[name][1] * numbers_of(file, columns[name][0], table[columns[name][0]]) for name in known}


def _since_1970_s(file: str, dates: "pd.Series") -> "pd.Series":
    """Dates as seconds since 1970, in UTC where they do not say. Raises DataError for what is none."""
    import pandas as pd

    try:
        parsed = pd.to_datetime(dates, utc=True, format="ISO8601")
    except ValueError as error:
        text = "give dates as 2026-11-24T10:00:00Z, or seconds"
        raise DataError(f"{file}, time_s: '{dates.iloc[0]}' is no date that can be read; {text}") from error
    return (parsed - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)


def _telemetry(
    file: str, kept: RowsKept, names: list[str], rover: Rover, findings: Findings, *, synthetic: bool
) -> Telemetry:
    values = kept.joined()
    count = len(values["time_s"])
    blank = np.full(count, np.nan)
    if "x_m" not in names:
        values |= dict.fromkeys(("x_m", "y_m", "sigma_m", *ERRORS), blank)
    if "sigma_m" not in values and not all(name in values for name in ERRORS):
        done = f"{POSITION_SIGMA_M:g} m assumed, or as much as they scatter by; add a column sigma_m"
        findings.add("no position error", "no errors of x_m and y_m", done, count=kept.read)
        values["sigma_m"] = np.full(count, POSITION_SIGMA_M)
    yaw_sigma = values.get("yaw_deg_sigma", blank)
    if not np.isfinite(yaw_sigma).any():
        done = f"{YAW_SIGMA_DEG:g} deg assumed; add a column yaw_deg_sigma"
        findings.add("no heading error", "no errors of yaw_deg", done, count=kept.read)
        yaw_sigma = np.full(count, YAW_SIGMA_DEG)
    columns: dict[str, Any] = {
        key: np.column_stack([values.get(form.format(wheel), blank) for wheel in rover.wheels])
        for key, form in WHEEL_COLUMNS.items()
    }
    columns |= {name: values.get(name, blank) for name in POSE_COLUMNS if name != "yaw_deg_sigma"}
    return Telemetry(
        file=file,
        time_s=values["time_s"],
        fix_m=np.column_stack([values["x_m"], values["y_m"]]),
        fix_covariance_m2=_covariance(file, values),
        yaw_deg_sigma=yaw_sigma,
        **columns,
        synthetic=synthetic,
        rests_s=tuple(kept.rests_s),
        rows=kept.read,
    )


def _count_infinities(values: dict[str, FloatArray], infinite: dict[str, int]) -> None:
    """Blank what is infinite, and count it by column."""
    for name, column in values.items():
        if (wrong := np.isinf(column)).any():
            infinite[name] = infinite.get(name, 0) + int(wrong.sum())
            values[name] = np.where(wrong, np.nan, column)


def _known(names: list[str], rover: Rover) -> list[str]:
    known = {*NEEDED, *POSE_COLUMNS, *ERRORS, "sigma_m"}
    known |= {form.format(wheel) for form in WHEEL_COLUMNS.values() for wheel in rover.wheels}
    return [name for name in names if name in known]


def _covariance(file: str, values: dict[str, FloatArray]) -> FloatArray:
    if all(name in values for name in ERRORS):
        xx, xy, yy = (values[name] for name in ERRORS)
    else:
        # A negative standard error would turn positive in the square.
        xx = yy = np.copysign(values["sigma_m"] ** 2, values["sigma_m"])
        xy = 0.0 * xx
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)


def tables_of(stream: InputStream, findings: Findings) -> "Iterator[pd.DataFrame]":
    """The rows of a table in pieces, by the ending of its file, numbered through. Raises DataError, also for no row."""

    def without_cut(cut: bytes, number: int) -> bytes:
        what = f"line {number} has no end ('{cut[-20:].decode(errors='replace')}'): the file may be cut there"
        findings.add("truncated", what, "the line is left out; end it with a new line if it is whole")
        return b""

    suffix, rows = Path(stream.name).suffix.lower(), 0
    tables: Iterator[pd.DataFrame]
    if suffix == ".parquet":
        tables = (_flat(stream.name, table) for table in parquet_tables(stream))
    elif suffix == ".ecsv":
        tables = (_read_ecsv(piece) for piece, _ in line_pieces(stream, lambda cut, _: cut))
    else:
        tables = csv_tables(stream, without_cut)
    for table in (in_own_words(stream.name, one) for one in tables):
        yield table.set_axis(range(rows, rows + len(table)))
        rows += len(table)
    if not rows:
        raise DataError(f"{stream.name}: no rows; check how it was made or downloaded")


def _read_ecsv(source: InputFile) -> "pd.DataFrame":
    from astropy.table import Table

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Table.read(io.BytesIO(source.data), format="ascii.ecsv")
            units = {name: str(table[name].unit) for name in table.colnames if table[name].unit is not None}
            frame = _flat(source.name, table.to_pandas())
    except Exception as error:
        raise DataError(f"{source.name}: not an ECSV table that can be read ({_line(error)})") from error
    return frame.rename(columns={name: _in_unit(source.name, name, unit) for name, unit in units.items()})


def _in_unit(file: str, name: str, unit: str) -> str:
    """The name of a column that ends in the unit the file says, where that is another one than its name has."""
    from astropy import units as u

    match, said = UNIT.search(name), u.Unit(unit)
    if match is None:
        return name
    for own, others in UNITS.items():
        for end in (own, *others):
            if said == u.Unit(SPELLED.get(end, end.replace("_", "/"))):
                return f"{name[: match.start()]}_{end}{name[match.end() :]}"
    raise DataError(f"{file}: {name} is in {unit}; give it in {' or '.join(UNITS)}")


def _flat(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    import pandas as pd

    names = [str(name).strip() for name in table.columns]
    if twice := next((name for name, times in Counter(names).items() if times > 1), None):
        raise DataError(f"{file}: two columns are called '{twice}'; keep one of them")
    return table.set_axis(pd.Index(names), axis=1)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:120]
