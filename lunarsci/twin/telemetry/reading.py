"""Telemetry of a drive as numbers: read from CSV, ECSV and Parquet by the columns' names, and what is wrong.

A week at 10 Hz is 6 million rows, of which a rover drives through some ten thousand. Rows are taken in blocks. A block
rests where no wheel is told to turn, reads a rate or gets any further, and time goes on evenly; of a block that rests
between two others that rest only rows with a new position are kept. What is left out says nothing of the motion: the
wheels stand, and headings are used at positions and beside drives alone.
"""

import difflib
import io
import itertools
import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, LunarSciWarning, warn
from lunarsci.io.inputs import InputFile, InputStream, open_input
from lunarsci.io.tables import (
    check_columns,
    csv_tables,
    in_units,
    line_pieces,
    numbers_of,
    parquet_tables,
    read_csv_table,
    without_repeats,
)
from lunarsci.twin.plans.motion import GAP
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.log_names import ERRORS, as_meant, columns_meant, from_ros
from lunarsci.units import SIZES, UNIT_ENDING, columns_by_unit

if TYPE_CHECKING:
    import pandas as pd

NEEDED = ("time_s", "x_m", "y_m", "yaw_deg")
"""Columns without which a file is no telemetry."""
WHEEL = re.compile(r"(?:speed|steering|angle|rate|steered)_([A-Za-z0-9]+)_(?:m_s|deg|deg_s)")
PLACES = ("x_m", "y_m", *ERRORS, "sigma_m")
OF_A_WHEEL = (("angle_{}_deg", "rate_{}_deg_s", "speed_{}_m_s"), ("steered_{}_deg", "steering_{}_deg"))
"""Of each of these every wheel needs one: how it turned, and how it was steered."""
OBEYED = 0.2
"""Standard error of a turn, an angle or a way that commands or other columns say, as a share of it; assumed."""
BLOCK = 256
"""Rows of a block: half a minute at 10 Hz. States are those of all rows."""
STILL = 0.05
"""Share of the usual or the highest rim speed below which a wheel stands; assumed."""
SURE = 3.0
"""Standard errors from which on a difference is none of chance, which reaches them once in 370. [-]"""
MOST_ROWS = 500_000
"""That are kept: 14 hours at 10 Hz of a rover that does not rest. `tests/benchmarks/load.py` tells their memory."""
Columns = dict[str, FloatArray]
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
DATE = re.compile(r"\s*\d{4}-\d\d?-\d\d?|\s*\d\d?:\d\d|\s*\d\d?[./]\d\d?[./]\d{2,4}")
SYNTHETIC = ("true", "1", "1.0")
YAW_SIGMA_DEG, POSITION_SIGMA_M = 0.3, 0.02
"""Error of a heading, and of a position, whose error is not given; assumed. [deg, m]"""
SHARED = ("xx_before_m2", "xy_before_m2", "yx_before_m2", "yy_before_m2")
"""Covariance of x and y of a position with x and y of the one in the row before."""
POSITION_COLUMNS = ("time_s", "x_m", "y_m", "z_m", "yaw_deg", "sigma_m", *ERRORS, *SHARED, "synthetic")
SIGMA_DEG, RATE_SHARE = 1.0, 0.1
"""Standard errors of turns between rows, of all [deg] and of rates as a share; of commands it is `OBEYED`. Half or
twice as much moves no slip, as measured; where readings fail they weigh which ones do."""
TURNED_DEG = 3.0 * SIGMA_DEG
"""Turn of a wheel up to which it stands: three times as `SIGMA_DEG`, 8 mm of way. [deg]"""
UNDER_WAY = 0.3
"""Share of the highest speed from which a wheel counts as under way. Half or twice as much moves slips by 0.05 of their
errors at most, as measured."""
LEAST_ROW_M = 0.3
"""Way between rows of states where positions are denser, and within which standstills are one halt, assumed: a rover's
slip does not change faster. [m]"""


def check_telemetry_columns(file: str, names: list[str], rover: Rover, *, placed: bool) -> None:
    """Raises DataError for wheels of another rover, and for columns that are missing, with what may be meant.

    Positions are needed where they do not come from elsewhere (`placed`).
    """
    wheels = sorted({match[1] for name in names if (match := WHEEL.fullmatch(name))})
    others = [wheel for wheel in wheels if wheel not in rover.wheels]
    missing = [
        f"{name}{_guess(name, names)}" for name in NEEDED if name not in names and (placed or name not in PLACES)
    ]
    places = tuple(missing)
    steered = [wheel for wheel, steers in zip(rover.wheels, rover.steered_mask, strict=True) if steers]
    for forms, usual, needed in zip(OF_A_WHEEL, (1, 0), ([*rover.wheels], steered), strict=True):
        without = [wheel for wheel in needed if not any(form.format(wheel) in names for form in forms)]
        if without:
            which, guess = f"W = {', '.join(without)}, as the file has the wheels {', '.join(wheels)}", ""
            if without == needed:
                which, guess = "each wheel W", _guess(forms[usual].format(without[0]), names)
            missing.append(f"{' or '.join(form.format('W') for form in forms)} of {which}{guess}")
    if others or missing:
        wheel = f"'{', '.join(others[:1])}' is no wheel of {rover.name}, which has {', '.join(rover.wheels)}"
        straight = "; steered_W_deg is 0 for wheels that stay straight" if len(missing) > len(places) else ""
        columns = f"columns are missing: {', '.join(missing)}{straight}"
        hint = "give the `rover` that has these wheels; " if others else ""
        raise DataError(
            f"{file}: {wheel if others else columns}; {hint}`lunarsci template telemetry --rover FILE` has all"
        )


def _guess(needed: str, names: list[str]) -> str:
    bare, names = (
        UNIT_ENDING.sub("", needed),
        [n for n in names if n not in (*NEEDED, *ERRORS) and not n.endswith("_sigma")],
    )
    other = [name for name in names if UNIT_ENDING.sub("", name) == bare] or difflib.get_close_matches(
        needed, names, 1, 0.75
    )
    other = other or [name for name in names if bare in {UNIT_ENDING.sub("", one) for one in columns_meant(name, ())}]
    return f" ({other[0]}?)" if other else ""


class RowsWithoutRests:
    """Rows of telemetry by column, without most of those of a rover that rests, put together from pieces.

    Attributes
    ----------
    read : rows that were added.
    rests_s : begin and end of the rests within which rows are left out. [s]
    """

    def __init__(self, file: str, rover: Rover) -> None:
        self.file, self.read = file, 0
        self.rests_s: list[tuple[float, float]] = []
        self._rover, self._count = rover, 0
        self._retained: list[Columns] = []
        self._left: Columns = {}
        self._before: tuple[Columns, bool] | None = None
        self._held: tuple[Columns, bool] | None = None
        self._anchor = np.full(len(rover.wheels), np.nan)
        self._place = np.full(len(PLACES), np.nan)

    def add(self, columns: Columns) -> None:
        """The next rows, of the same columns each time. Raises DataError for more than there is to be memory for."""
        self.read += len(columns["time_s"])
        rows = {name: np.append(self._left.get(name, ()), column) for name, column in columns.items()}
        whole = len(rows["time_s"]) // BLOCK * BLOCK
        for first in range(0, whole, BLOCK):
            self._take({name: column[first : first + BLOCK] for name, column in rows.items()})
        self._left = {name: column[whole:] for name, column in rows.items()}

    def joined(self) -> Columns:
        """The columns of the rows that are kept, in their order, when all have been added."""
        if self._held is not None:
            self._retain(self._held[0])
        self._retain(self._left)
        return {name: np.concatenate([part[name] for part in self._retained]) for name in self._left}

    def _take(self, block: Columns) -> None:
        """Keep the block before this one, or leave it out, now that both its neighbours are read."""
        rests, before, middle = self._rests(block), self._before, self._held
        if middle is not None:
            if before is not None and before[1] and middle[1] and rests:
                self._leave_out(before[0], middle[0], block)
            else:
                self._retain(middle[0])
        self._before, self._held = middle, (block, rests)

    def _retain(self, rows: Columns) -> None:
        self._retained.append(rows)
        self._count += len(rows["time_s"])
        if self._count > MOST_ROWS:
            raise DataError(
                f"{self.file}: more than {MOST_ROWS:,} rows of a rover that does not stand for long, to "
                f"time_s {rows['time_s'][-1]:.6g}; take a part of it with `since` and `until`, or fewer rows a second"
            )
        places = _columns(rows, PLACES)
        if len(placed := np.flatnonzero(np.isfinite(places[:, :2]).any(axis=1))):
            self._place = places[placed[-1]]

    def _leave_out(self, before: Columns, rows: Columns, after: Columns) -> None:
        """Keep only positions that do not repeat the one before to the last digit."""
        begin, end = float(before["time_s"][0]), float(after["time_s"][-1])
        if self.rests_s and self.rests_s[-1][1] == rows["time_s"][-1]:
            begin = self.rests_s.pop()[0]
        self.rests_s.append((begin, end))
        places = np.vstack([self._place, _columns(rows, PLACES)])
        placed = np.flatnonzero(np.isfinite(places[:, :2]).any(axis=1) | (np.arange(len(places)) == 0))
        texts = np.nan_to_num(places[placed], nan=np.inf)
        new = placed[1:][(texts[1:] != texts[:-1]).any(axis=1)] - 1
        if len(new):
            self._retain({name: column[new] for name, column in rows.items()})

    def _rests(self, rows: Columns) -> bool:
        """Whether no wheel turns, and time goes on evenly, also from the block before."""
        wheels, first = self._rover.wheels, self._held is None
        times = rows["time_s"] if self._held is None else np.append(self._held[0]["time_s"][-1], rows["time_s"])
        steps = np.diff(times)
        commanded, rate, angles = (
            _columns(rows, [WHEEL_COLUMNS[key].format(wheel) for wheel in wheels])
            for key in ("speed_m_s", "rate_deg_s", "angle_deg")
        )
        given, every = np.isfinite(angles), np.arange(angles.shape[1])
        first_deg, last_deg = angles[given.argmax(axis=0), every], angles[-1 - given[::-1].argmax(axis=0), every]
        off = np.abs(angles - np.where(np.isfinite(self._anchor), self._anchor, first_deg))
        rim = np.radians(np.abs(rate)) * self._rover.wheel.shearing_radius_m
        turns = (commanded != 0) & np.isfinite(commanded) | (rim > STILL * self._rover.max_speed_m_s)
        observed = np.isfinite(commanded) | np.isfinite(rim) | np.isfinite(angles)
        rests = bool(
            not first
            and (steps > 0).all()
            and steps.max() <= GAP * np.median(steps)
            and observed.any(axis=0).all()
            and not (turns | (off > TURNED_DEG)).any()
        )
        if not rests:
            self._anchor = np.where(np.isfinite(last_deg), last_deg, self._anchor)
        return rests


def _columns(rows: Columns, names: Sequence[str]) -> FloatArray:
    """Some columns beside each other, NaN where there is none. (n, names)"""
    blank = np.full(len(rows["time_s"]), np.nan)
    return np.column_stack([rows.get(name, blank) for name in names])


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
    """The findings of one file, each of which is a warning once, when it is added.

    Attributes
    ----------
    file : its name.
    entries : in the order in which they were added.
    """

    file: str
    entries: list[Finding] = field(default_factory=list)

    def add(
        self, kind: str, what: str, done: str, *, count: int = 1, time_s: float | None = None, doubt: bool = False
    ) -> None:
        """Note and say one finding."""
        self.entries.append(Finding(kind=kind, count=count, time_s=time_s, what=what, done=done, doubt=doubt))
        when = "" if time_s is None else f" at time_s {time_s:.6g}"
        warnings.warn(f"{self.file}: {kind}{when}: {what}; {done}", LunarSciWarning, stacklevel=3)

    def of_rows(
        self, kind: str, what: str, done: str, rows: BoolArray, time_s: FloatArray, *, doubt: bool = False
    ) -> None:
        """Note and say one finding of some rows, with their number and the time of the first; nothing of none.

        `rows` are (n,) or (n, wheels).
        """
        if rows.any():
            first = float(time_s[int(np.argmax(rows.reshape(len(rows), -1).any(axis=1)))])
            self.add(kind, what, done, count=int(rows.sum()), time_s=first, doubt=doubt)

    @property
    def doubt(self) -> str:
        """Why the result should not be trusted, empty if it may be."""
        return "; ".join(f"{entry.kind}: {entry.what}" for entry in self.entries if entry.doubt)


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

    def of_wheels(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Commanded rim speeds, rates and angles in every row, as `between_readings` has them. (n, wheels) each"""
        held = between_readings(self.time_s, self.speed_m_s, held=True)
        return held, between_readings(self.time_s, self.rate_deg_s), between_readings(self.time_s, self.angle_deg)

    @property
    def turned_deg(self) -> FloatArray:
        """Steering as measured, else as commanded. (n, wheels) [deg]"""
        return np.where(np.isfinite(self.steered_deg), self.steered_deg, self.steering_deg)


class Positions(NamedTuple):
    """Positions of the rover's origin from localisation, and their errors.

    Attributes
    ----------
    time_s : since the start of the plan. (n,) [s]
    place_m : x and y. (n, 2) [m]
    covariance_m2 : of the error of each. (n, 2, 2) [m2]
    shared_m2 : covariance of each error with that of the position before; None where errors are independent. (n, 2, 2)
        [m2]
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

    Without errors `POSITION_SIGMA_M` is assumed, with a warning.

    Rows without a time, as of stations that are not on the drive, are left out. Raises DataError, also for rows of one
    time that contradict each other.
    """
    file = source.name
    table = in_units(file, from_ros(file, read_csv_table(source)))
    shares = bool({*SHARED} & {*table})
    errors = ERRORS if shares or {*ERRORS} & {*table} else ()
    check_columns(file, table.columns, POSITION_COLUMNS, ("time_s", "x_m", "y_m", *errors, *(SHARED if shares else ())))
    if not errors and "sigma_m" not in table:
        columns = "sigma_m, or xx_m2, xy_m2 and yy_m2"
        warn(f"{file}: no errors of the positions; {POSITION_SIGMA_M:g} m assumed, add {columns} where you have them")
        table["sigma_m"] = str(POSITION_SIGMA_M)
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
    place, covariance = np.column_stack([values["x_m"], values["y_m"]]), _covariance(values)
    shared = None
    if shares:
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
    for k, covariance in enumerate(covariance_m2):
        joint[k, :, k] = covariance
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
    rows, infinite, synthetic = RowsWithoutRests(source.name, rover), Counter[str](), False
    begin = -math.inf if start_s is None else start_s
    with open_input(source) as stream:
        for written in tables_of(stream, findings):
            table, read_as = as_meant(written, rover.wheels)
            values = _numbers(source.name, table, rover, placed=placed)
            if read_as and not rows.read:
                findings.add("read as", f"column {read_as}", "taken so; `lunarsci template telemetry` has all names")
            for name, column in values.items():
                infinite[name] += int(np.isinf(column).sum())
                values[name] = np.where(np.isinf(column), np.nan, column)
            inside = ~((values["time_s"] < max(span_s[0], begin)) | (values["time_s"] > span_s[1]))
            values["time_s"] = values["time_s"] - (start_s or 0.0)
            rows.add({name: column[inside] for name, column in values.items()})
            if "synthetic" in table:
                synthetic = synthetic or bool(table["synthetic"].astype(str).str.lower().isin(SYNTHETIC).any())
    for name, count in (+infinite).items():
        findings.add("infinite values", f"{name} is infinite", "taken as blank", count=count)
    if not rows.read:
        first, last = max(span_s[0], begin), span_s[1]
        where = f" between time_s {first:.12g} and {last:.12g}; give others" if math.isfinite(first) else ""
        raise DataError(f"{source.name}: no rows{where or '; check how it was made or downloaded'}")
    return _telemetry(source.name, rows, rover, findings, synthetic=synthetic, start_s=start_s or 0.0)


def _numbers(file: str, table: "pd.DataFrame", rover: Rover, *, placed: bool) -> dict[str, FloatArray]:
    """The columns that count, of a piece."""
    columns = columns_by_unit([str(name) for name in table.columns])
    check_telemetry_columns(file, list(columns), rover, placed=placed)
    used = {*NEEDED, *POSE_COLUMNS, *PLACES} - (set() if placed else {*PLACES})
    used |= {form.format(wheel) for form in WHEEL_COLUMNS.values() for wheel in rover.wheels}
    times = columns["time_s"][0]
    if DATE.match(str(next(iter(table[times].dropna()), ""))):
        table = table.assign(**{times: _since_1970_s(file, table[times])})
    return {
        name: factor * numbers_of(file, column, table[column])
        for name, (column, factor) in columns.items()
        if name in used
    }


def _since_1970_s(file: str, dates: "pd.Series") -> "pd.Series":
    """Dates as seconds since 1970, in UTC where they do not say, blank ones as they are. Raises DataError."""
    import pandas as pd

    parsed = pd.to_datetime(dates, utc=True, format="ISO8601", errors="coerce")
    if (bad := dates[parsed.isna() & dates.notna()]).size:
        text = "give dates as 2026-11-24T10:00:00Z, or seconds"
        raise DataError(f"{file}, time_s: '{bad.iloc[0]}' is no date that can be read; {text}")
    return (parsed - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)


def _telemetry(
    file: str, rows: RowsWithoutRests, rover: Rover, findings: Findings, *, synthetic: bool, start_s: float
) -> Telemetry:
    values = rows.joined()
    blank = np.full(len(values["time_s"]), np.nan)
    if "x_m" not in values:
        values |= dict.fromkeys(PLACES, blank)
    if "sigma_m" not in values and not {*ERRORS} <= {*values}:
        done = f"{POSITION_SIGMA_M:g} m assumed, or as much as they scatter by; add a column sigma_m"
        findings.add("no position error", "no errors of x_m and y_m", done, count=rows.read)
        values["sigma_m"] = np.full_like(blank, POSITION_SIGMA_M)
    if not np.isfinite(values.get("yaw_deg_sigma", blank)).any():
        done = f"{YAW_SIGMA_DEG:g} deg assumed; add a column yaw_deg_sigma"
        findings.add("no heading error", "no errors of yaw_deg", done, count=rows.read)
        values["yaw_deg_sigma"] = np.full_like(blank, YAW_SIGMA_DEG)
    columns: dict[str, Any] = {
        key: _columns(values, [form.format(wheel) for wheel in rover.wheels]) for key, form in WHEEL_COLUMNS.items()
    }
    steering = columns["steering_deg"]
    columns["steering_deg"] = np.where(rover.steered_mask | np.isfinite(steering), steering, 0.0)
    return Telemetry(
        file=file,
        time_s=values["time_s"],
        fix_m=np.column_stack([values["x_m"], values["y_m"]]),
        fix_covariance_m2=_covariance(values),
        **columns,
        **{name: values.get(name, blank) for name in POSE_COLUMNS},
        synthetic=synthetic,
        rests_s=tuple(rows.rests_s),
        rows=rows.read,
        start_s=start_s,
    )


def _covariance(values: dict[str, FloatArray]) -> FloatArray:
    if {*ERRORS} <= {*values}:
        xx, xy, yy = (values[name] for name in ERRORS)
    else:
        # A negative standard error would turn positive in the square.
        xx = yy = np.copysign(values["sigma_m"] ** 2, values["sigma_m"])
        xy = 0.0 * xx
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)


def tables_of(stream: InputStream, findings: Findings) -> "Iterator[pd.DataFrame]":
    """The rows of a table in pieces, by the ending of its file, numbered through. Raises DataError."""

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
    for table in (from_ros(stream.name, one) for one in tables):
        yield table.set_axis(range(rows, rows + len(table)))
        rows += len(table)


def _read_ecsv(source: InputFile) -> "pd.DataFrame":
    from astropy.table import Table

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Table.read(io.BytesIO(source.data), format="ascii.ecsv")
            units = {name: str(table[name].unit) for name in table.colnames if table[name].unit is not None}
            frame = _flat(source.name, table.to_pandas())
    except Exception as error:
        raise DataError(
            f"{source.name}: not an ECSV table that can be read ({' '.join(str(error).split())[:120]})"
        ) from error
    return frame.rename(columns={name: _in_unit(source.name, name, unit) for name, unit in units.items()})


def _in_unit(file: str, name: str, unit: str) -> str:
    """The name of a column that ends in the unit the file says, where that is another one than its name has."""
    from astropy import units as u

    match, stated = UNIT_ENDING.search(name), u.Unit(unit)
    if match is None:
        return name
    for end in itertools.chain.from_iterable((meant, *others) for meant, others in SIZES.items()):
        if stated == u.Unit(SPELLED.get(end, end.replace("_", "/"))):
            return f"{name[: match.start()]}_{end}{name[match.end() :]}"
    raise DataError(f"{file}: {name} is in {unit}; give it in {' or '.join(SIZES)}")


def _flat(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    import pandas as pd

    names = [str(name).strip() for name in table.columns]
    if twice := next((name for name, times in Counter(names).items() if times > 1), None):
        raise DataError(f"{file}: two columns are called '{twice}'; keep one of them")
    return table.set_axis(pd.Index(names), axis=1)


def filled(at: FloatArray, values: FloatArray) -> FloatArray:
    """Values with what is missing found from those beside it; 0 where there are none. (n,), (n,)"""
    given = np.isfinite(values)
    return np.interp(at, at[given], values[given]) if given.any() else 0.0 * at


def between_readings(at: FloatArray, values: FloatArray, *, held: bool = False) -> FloatArray:
    """Values of sensors that report in some rows only, also in those between; of commands, which hold, the last one.

    Between readings that are as far apart as a gap (`GAP`) it is as if nothing had been sent. (n,), (n, k)
    """
    result = values.copy()
    for column in result.T:
        given = np.flatnonzero(np.isfinite(column))
        if 1 < len(given) < len(column):
            steps = np.diff(at[given])
            next_one = np.clip(np.searchsorted(given, np.arange(len(at))), 1, len(given) - 1)
            near = (steps <= GAP * np.median(steps))[next_one - 1]
            near &= (np.arange(len(at)) > given[0]) & (np.arange(len(at)) < given[-1]) & np.isnan(column)
            column[near] = column[given[next_one - 1]][near] if held else np.interp(at[near], at[given], column[given])
    return result


def between(values: FloatArray) -> FloatArray:
    """Mean of successive rows, of one where only that one is known. (n - 1, wheels)"""
    before, after = values[:-1], values[1:]
    both = 0.5 * (before + after)
    return np.where(np.isfinite(both), both, np.where(np.isfinite(before), before, after))
