"""Columns of wheel tests as others name and measure them: forces in kN, kgf and lbf, pulls over the load, two slips.

A column that names its quantity and its unit is converted. One without a unit is taken in newtons, metres, degrees and
shares of the rim's speed; what the numbers say of that is asked by `lunarsci.regolith.states`.

The column `rover` of tables that lunarsci writes has the name in the rover's file and the size of its wheels, `ground`
the terrain's name and a mark of its heights, in every row, so that they stay where rows are taken out or tables are put
together, and nobody reads them for others. Older tables and those of other programs may lack them.

Slip is 1 - v / (r w) in terramechanics (Wong 2008, Theory of Ground Vehicles, ISBN 978-0-470-17038-0; travel reduction
in ANSI/ASAE S296), `rim` here, and r w / v - 1 for tyres (SAE J670), `travel` here; lunarsci's is the first one while a
wheel drives, and the second one while it skids (Ding et al. 2024, 10.1038/s41467-024-46233-8).
"""

import hashlib
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning, RequestError
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.names import one_of
from lunarsci.regolith.prior import Question
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.rovers import read_rover, rover_names, wheel_names

if TYPE_CHECKING:
    import pandas as pd

FORCES: Mapping[str, float] = {
    **{"n": 1.0, "kn": 1e3, "mn": 1e-3, "kgf": 9.80665, "kg": 9.80665, "kp": 9.80665},
    **{"lbf": 4.4482216152605, "lb": 4.4482216152605, "lbs": 4.4482216152605},
}
"""Newtons of a unit, exact by definition (Thompson & Taylor 2008, NIST Special Publication 811)."""
LENGTHS: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "inch": 0.0254}
"""Metres of a unit, exact by definition (as above)."""
ANGLES: Mapping[str, float] = {"deg": 1.0, "rad": float(np.degrees(1.0)), "degrees": 1.0, "radians": np.degrees(1.0)}
"""Degrees of a unit, by definition."""
SHARES: Mapping[str, float] = {"share": 1.0, "ratio": 1.0, "%": 0.01, "pct": 0.01, "percent": 0.01}
"""Ratios of a unit, by definition. [-]"""
TORQUES: Mapping[str, float] = {
    **{"nm": 1.0, "ncm": 0.01, "nmm": 1e-3, "knm": 1e3, "mnm": 1e-3, "kgfm": 9.80665, "kgfcm": 0.0980665},
    **{"lbfft": 1.3558179483314004, "lbfin": 0.1129848290276167, "ftlbf": 1.3558179483314004},
}
"""Newton metres of a unit, its words put together, exact by definition (as above)."""
OF_RUNS = ("meas", "measured", "avg", "average", "mean")
"""Words that say how a number came about, not what it is of."""
OF_ERRORS = ("sigma", "std", "sd", "stdev", "stddev", "err", "error", "uncertainty")
"""Words that say that a column has the errors of a quantity."""
RIM, TRAVEL, OVER_LOAD = "rim", "travel", "load"
"""In the place of a unit: which of two slips, and that a pull is a share of the load."""
OPTION = "--units"
"""Option by which users answer questions of columns."""
HOW = {"": "", OVER_LOAD: ", a share of the load", TRAVEL: ", r w / v - 1", RIM: ", 1 - v / (r w)"}
"""Units that are no units, in words."""


class StateColumn(NamedTuple):
    """A column of wheel states.

    Attributes
    ----------
    column : its name here.
    units : units that it may be in, in lower case, with their size in that of the name.
    names : what others call it: words in lower case with _ between them.
    """

    column: str
    units: Mapping[str, float]
    names: tuple[str, ...]


QUANTITIES = (
    StateColumn(
        "normal_force_n",
        FORCES,
        ("normal_force", "load", "normal_load", "vertical_load", "vertical_force", "wheel_load", "weight",
         "dynamic_load",
         "w", "fz", "f_z",
         "fn", "f_n"),
    ),
    StateColumn(
        "drawbar_pull_n",
        FORCES,
        ("drawbar_pull", "drawbar", "dp", "pull", "fx", "f_x", "f_dp", "fdp", "drawbar_force", "drawbar_pull_force",
         "dbp", "net_traction", "net_pull"),
    ),
    StateColumn("lateral_force_n", FORCES, ("lateral_force", "side_force", "fy", "f_y", "fl", "f_l")),
    StateColumn("sinkage_m", LENGTHS, ("sinkage", "wheel_sinkage", "sink", "sinkage_depth", "z", "h")),
    StateColumn(
        "slip_ratio",
        SHARES,
        ("slip_ratio", "slip", "wheel_slip", "s", "i", "travel_reduction", "travel_reduction_ratio",
         "slip_rim", "slip_travel", "slip_v", "slip_over_v", "slip_sae"),
    ),
    StateColumn("side_slip_deg", ANGLES, ("side_slip", "sideslip", "slip_angle", "side_slip_angle", "beta")),
    StateColumn(
        "resistance_torque_nm", TORQUES, ("resistance_torque", "torque", "wheel_torque", "driving_torque", "t")
    ),
)  # fmt: skip
WITH_UNIT = ("t", "h")
"""Symbols that are times and heights, too: they count where a unit says so."""
BY_TRAVEL = ("slip_travel", "slip_v", "slip_over_v", "slip_sae")
"""Names of a slip that is r w / v - 1."""
SHARE_OF_LOAD = (
    *("dp_over_w", "dp_w", "dpw", "dp_over_load", "dp_load", "pull_over_load", "pull_load", "pull_over_weight", "p_w"),
    *("drawbar_pull_over_load", "drawbar_pull_over_weight", "drawbar_pull_load", "drawbar_pull_weight", "pull_weight"),
    *("net_traction_ratio", "ntr", "net_traction_coefficient", "dynamic_traction_ratio", "pull_ratio", "pull_number"),
    *("drawbar_pull_coefficient", "drawbar_coefficient", "pull_coefficient", "traction_coefficient", "dp_ratio"),
)
"""Names of a drawbar pull over the load."""


@dataclass(frozen=True, slots=True)
class ColumnMeaning:
    """What a column is.

    Attributes
    ----------
    column : name of its quantity here.
    unit : as the header has it, in lower case, or `rim`, `travel`, `load`; '' where none is named.
    sigma : whether it is the standard error of the quantity.
    scale : by which its numbers are multiplied beside the unit: 0.01 for per cent of a share. [-]
    """

    column: str
    unit: str
    sigma: bool
    scale: float = field(default=1.0, repr=False)

    @property
    def target(self) -> str:
        """The name that lunarsci has for it."""
        return f"{self.column}_sigma" if self.sigma else self.column


def of_name(name: str) -> ColumnMeaning | None:
    """What a column's name says; None for one that names no quantity of a wheel.

    >>> of_name("Normal load [kN]"), of_name("DP/W").unit, of_name("slip_travel").unit, of_name("colour")
    (ColumnMeaning(column='normal_force_n', unit='kn', sigma=False), 'load', 'travel', None)
    """
    words = [word.lower() for word in re.findall(r"[A-Za-z]+|%", name)]
    sigma = not {*words}.isdisjoint(OF_ERRORS)
    words = [word for word in words if word not in (*OF_ERRORS, *OF_RUNS)]
    if len(words) > 2 and words[-2] == "in":
        words = [*words[:-2], words[-1]]
    whole, scale = "_".join(words), 1.0
    if words[-1:] and words[-1] in ("%", "percent") and "_".join(words[:-1]) in (*BY_TRAVEL, *SHARE_OF_LOAD):
        whole, scale = "_".join(words[:-1]), 0.01
    if whole in SHARE_OF_LOAD:
        return ColumnMeaning("drawbar_pull_n", OVER_LOAD, sigma, scale)
    for quantity in QUANTITIES:
        if whole in quantity.names and whole not in WITH_UNIT:
            return ColumnMeaning(quantity.column, TRAVEL if whole in BY_TRAVEL else "", sigma, scale)
    for quantity in QUANTITIES:
        for count in (1, 2, 0):
            stem, unit = words[: len(words) - count], "".join(words[len(words) - count :])
            # A name may have its symbol behind it: 'Normal load W [N]'.
            plain = "_".join(stem)
            rest = [plain[len(name) :] for name in quantity.names if plain.startswith(name)]
            named = any(not end or (end[0] == "_" and end[1:] in quantity.names) for end in rest)
            if named and (unit in quantity.units or not count):
                return ColumnMeaning(quantity.column, unit, sigma)
    return None


def with_row_of_units(table: "pd.DataFrame") -> "pd.DataFrame":
    """A table whose first row has units, each in the name of its column."""
    words = [*map(str, table.iloc[0].fillna("").str.strip())] if len(table) > 1 else []
    every = {unit for quantity in QUANTITIES for unit in quantity.units}
    plain = ["".join(re.findall(r"[A-Za-z]+|%", word)).lower() for word in words]
    if not any(plain) or not all(word in ("", "-") or unit in every for word, unit in zip(words, plain, strict=True)):
        return table
    named = {name: f"{name} [{unit}]" for name, unit in zip(table.columns, words, strict=True) if unit not in ("", "-")}
    return table.rename(columns=named).iloc[1:].reset_index(drop=True)


@dataclass(frozen=True, slots=True)
class NamedColumns:
    """A table with the columns of wheel states under their own names and in their units.

    Attributes
    ----------
    table : of text.
    read_as : what was converted, and by what.
    unitless : columns that name no unit.
    answered : columns whose unit the option has said.
    sizes : sizes of the units that columns were read in, in those of the names here; 1 where missing.
    questions : what to ask of a column that names no unit.
    written : names in the file of columns that were renamed, by their own.
    """

    table: "pd.DataFrame"
    read_as: tuple[str, ...] = ()
    unitless: tuple[str, ...] = ()
    answered: tuple[str, ...] = ()
    questions: tuple[Question, ...] = ()
    written: Mapping[str, str] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)


class ColumnAnswer(NamedTuple):
    """How the option says that a column is read; each part changes what the column's name says of that part alone.

    Attributes
    ----------
    unit : in lower case, or `rim`, `travel`, `load`; '' for that of the name.
    sign : by which its numbers are multiplied. [-]
    shift : what is added to them then, in the unit of the name here.
    """

    unit: str = ""
    sign: float = 1.0
    shift: float = 0.0

    def and_(self, other: "ColumnAnswer") -> "ColumnAnswer":
        """Both answers of one column."""
        return ColumnAnswer(other.unit or self.unit, self.sign * other.sign, self.shift + other.shift)


ANSWER = re.compile(r"(-1?(?![\d.]|e-?\d))?([a-z%]*)([+-](?:\d+\.?\d*|\.\d+)(?:e-?\d+)?)?")
"""Of a column: its sign turned, its unit, and what is added in the unit of its name here."""


def asked_units(units: str) -> dict[str, ColumnAnswer]:
    """Answers by column, of `COLUMN=UNIT` with commas between: `sinkage_m=+0.004` adds metres, `=-1` turns a sign.

    Several of one column count together.

    >>> asked_units("slip_ratio=travel, sinkage_m=mm, sinkage_m=-0.01, drawbar_pull_n=-1")["sinkage_m"]
    ColumnAnswer(unit='mm', sign=1.0, shift=-0.01)

    Raises RequestError.
    """
    result: dict[str, ColumnAnswer] = {}
    units_of = {quantity.column: [*quantity.units] for quantity in QUANTITIES}
    units_of["drawbar_pull_n"] += [OVER_LOAD]
    units_of["slip_ratio"] += [RIM, TRAVEL]
    for part in filter(None, (one.strip() for one in units.split(","))):
        column, _, answer = (word.strip() for word in part.partition("="))
        parts = ANSWER.fullmatch(answer.lower())
        if column not in units_of:
            raise RequestError(f"`units` '{part}': {one_of(column, units_of)}, = and its unit")
        if not answer or not parts or parts[2] not in ("", *units_of[column]):
            raise RequestError(f"`units` '{part}': {one_of(answer, units_of[column])}")
        new = ColumnAnswer(parts[2], -1.0 if parts[1] else 1.0, float(parts[3] or 0.0))
        result[column] = result.get(column, ColumnAnswer()).and_(new)
    return result


def named_columns(file: str, table: "pd.DataFrame", names: Sequence[str], units: str = "") -> NamedColumns:
    """The columns of a table of wheel states by the names and units that they have; `units` says it otherwise.

    `names` are those of lunarsci. Raises RequestError for units that are none, DataError for two columns of one
    quantity.
    """
    asked, source, sizes = asked_units(units), dict[str, str](), dict[str, float]()
    table = with_row_of_units(table)
    meanings = {str(name): of_name(str(name)) for name in table.columns if name not in names}
    columns = {name: what for name, what in meanings.items() if what and what.target not in table.columns}
    plain = (ColumnMeaning(name, "", sigma) for name in asked for sigma in (False, True))
    columns |= {one.target: one for one in plain if one.target in table}
    notes, done = list[str](), table.copy()
    answers = {name: asked.get(what.column, ColumnAnswer()) for name, what in columns.items()}
    for name, written in columns.items():
        what, answer = _read_as(written, answers[name].unit), answers[name]
        if other := source.get(what.target):
            raise DataError(f"{file}: columns '{other}' and '{name}' are both {what.target}; keep the right one")
        source[what.target] = name
        size = what.scale * _units_of(what).get(what.unit, 1.0)
        sizes |= {what.target: size} if what.unit in _units_of(what) else {}
        values = (1.0 if what.sigma else answer.sign) * numbers_of(file, name, table[name])
        done = done.rename(columns={name: what.target})
        done[what.target] = _cells(_converted(what, size * values))
        how = HOW.get(what.unit, f", from {SYMBOLS.get(what.unit, what.unit)}")
        how += ", its sign turned" if answer.sign < 0 else ""
        how += f", {answer.shift:+g}" if answer.shift else ""
        by_name = written.unit and answer == ColumnAnswer()
        notes.append(f"column '{name}' as {what.target}{how}{'' if by_name else f' ({OPTION})'}")
    for what in (one for name, one in columns.items() if (answers[name].unit or one.unit) == OVER_LOAD):
        if "normal_force_n" not in done:
            raise DataError(f"{file}: no column normal_force_n, of which '{source[what.target]}' is a share; add it")
        load, share = (numbers_of(file, name, done[name]) for name in ("normal_force_n", what.target))
        done[what.target] = _cells(load * share)
    for name, what in columns.items():
        if answers[name].shift and not what.sigma:
            done[what.target] = _cells(numbers_of(file, name, done[what.target]) + answers[name].shift)
    answered = tuple(column for column, answer in asked.items() if answer.unit)
    unitless = [one.column for name, one in columns.items() if not one.unit and not one.sigma and name != one.target]
    open_ones = tuple(one for one in unitless if one not in answered)
    return NamedColumns(done, tuple(notes), open_ones, answered, written=source, sizes=sizes)


def _units_of(what: ColumnMeaning) -> Mapping[str, float]:
    return next(one.units for one in QUANTITIES if one.column == what.column)


def _read_as(written: ColumnMeaning, unit: str) -> ColumnMeaning:
    """What a column is where the option says its unit; a slip's definition leaves it in per cent."""
    per_cent = unit in (TRAVEL, RIM) and written.unit in SHARES
    scale = written.scale * (SHARES[written.unit] if per_cent else 1.0)
    return replace(written, unit=unit or written.unit, scale=scale)


def _converted(what: ColumnMeaning, values: FloatArray) -> FloatArray:
    """Values (n,) by the definition here, of those by that of the column."""
    if what.sigma or what.unit not in (TRAVEL, RIM):
        return values
    return by_travel(values) if what.unit == TRAVEL else by_rim(values)


SYMBOLS = {"n": "N", "kn": "kN", "mn": "mN"}
"""Units as users write them, where names of columns in lower case have them otherwise."""


def unit_of_size(column: str, size: float) -> str:
    """The unit that a column may be in with a size in that of its name, as users write it; '' where none has it.

    >>> unit_of_size("normal_force_n", 1000.0), unit_of_size("sinkage_m", 1e3)
    ('kN', '')
    """
    units = next(one.units for one in QUANTITIES if one.column == column)
    name = next((name for name, one in units.items() if math.isclose(one, size, rel_tol=1e-6)), "")
    return SYMBOLS.get(name, name)


def by_travel(slip: FloatArray) -> FloatArray:
    """lunarsci's slip ratio from r w / v - 1.

    >>> by_travel(np.array([1.0, -0.5]))
    array([ 0.5, -0.5])
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(slip > 0, slip / (1 + slip), slip)


def by_rim(slip: FloatArray) -> FloatArray:
    """lunarsci's slip ratio from 1 - v / (r w).

    >>> by_rim(np.array([0.5, -1.0]))
    array([ 0.5, -0.5])
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(slip < 0, slip / (1 - slip), slip)


def _cells(values: FloatArray) -> list[str]:
    """Numbers as text with all digits, blank for NaN."""
    return ["" if np.isnan(value) else repr(float(value)) for value in values]


COLUMN, GROUND = "rover", "ground"
NamedBy = Literal["option", "table", "default"]
"""What named the rover or wheel: the option, the column `rover` of the states, or nobody."""


def written_for(name: str, wheel: Wheel) -> str:
    """A rover as tables of its wheel states name it: how to ask for it, or the name in its file, and its wheels' size.

    >>> written_for("My rover, the second", Wheel(radius_m=0.11, width_m=0.09))
    'My rover the second; wheels 110 x 90 mm'
    """
    return f"{short_name(name)}; {size_of(wheel)}"


def short_name(name: str) -> str:
    """The name by which lunarsci knows a rover, else its own without what CSV has to quote."""
    return _asked_for().get(name) or _plain(name)


def _plain(name: str) -> str:
    return " ".join(re.sub(r'[,;"]', " ", name).split())


def ground_written(name: str, height_m: FloatArray, place: tuple[float, float, float]) -> str:
    """A terrain as tables and plans name it: by heights (ny, nx), and x and y of the first node and the spacing. [m]

    >>> ground_written("site, east", np.zeros((3, 3)), (0.0, 0.0, 0.1))
    'site east; heights 06387644'
    """
    height = np.nan_to_num(np.round(1e3 * height_m), nan=-(2.0**31)).astype(np.int64)
    where = f"{height_m.shape} " + " ".join(f"{number:.6f}" for number in place)
    return f"{_plain(name)}; heights {hashlib.sha256(where.encode() + height.tobytes()).hexdigest()[:8]}"


def ground_name(written: str) -> str:
    """Of a ground as it is written, its name; or of the plain name of a terrain, what is written of that."""
    return _plain(written.rpartition("; heights ")[0] or written)


def ground_kinship(written: str, ground: str) -> Literal["same", "changed", "other"]:
    """Whether a ground has the heights of another, whatever their names are, or only its name.

    >>> ground_kinship("a; heights 1", "b; heights 1"), ground_kinship("a; heights 1", "a; heights 2")
    ('same', 'changed')
    """
    (name, _, mark), (other_name, _, other_mark) = written.rpartition("; "), ground.rpartition("; ")
    if mark == other_mark:
        return "same"
    return "changed" if name == other_name else "other"


@cache
def _asked_for() -> dict[str, str]:
    """Names in the files of lunarsci's rovers, and how they are asked for."""
    return {read_rover(name).name: name for name in rover_names()}


def size_of(wheel: Wheel) -> str:
    """Radius and width, for `written_for`."""
    return f"wheels {1e3 * wheel.radius_m:.6g} x {1e3 * wheel.width_m:.6g} mm"


def written_in(file: str, table: "pd.DataFrame", column: str = COLUMN) -> str:
    """The one rover or ground that a table names; '' without such a column, or blank. Raises DataError for several."""
    cells = table[column].dropna().unique() if column in table else ()
    names = sorted({" ".join(str(cell).split()) for cell in cells} - {""})
    if len(names) > 1:
        raise DataError(f"{file}: rows of several {column}s: {names[0]}, and {names[1]}; keep those of one")
    return names[0] if names else ""


def rover_of_states(source: InputFile, rover: str | None, default: str) -> tuple[str, NamedBy]:
    """The rover or wheel of a table, and what named it: the one asked for, that of its column, or the default.

    Raises DataError where the table was written for a rover that lunarsci does not have, and none is asked for.
    """
    if rover:
        return rover, "option"
    written = written_in(source.name, read_csv_table(source))
    if not written:
        return default, "default"
    for name in (*rover_names(), *wheel_names()):
        description = read_rover(name)
        if written == written_for(description.name, read_wheel(description)):
            return name, "table"
    text = f"was written for '{written}', which lunarsci does not have; give the file of that rover with `rover`"
    raise DataError(f"{source.name}: {text}")


def check_written_for(file: str, table: "pd.DataFrame", wheel: Wheel, rover: str = "") -> None:
    """Compare the column `rover` of a table with the wheel that it is read for, and with the rover's name if given.

    Raises DataError for wheels of another size, warns of another name: the wheels are alike, the rest may not be.
    """
    written = written_in(file, table)
    name, _, size = written.rpartition("; ")
    if written and size != size_of(wheel):
        raise DataError(
            f"{file}: was written for '{written}', and is read for {size_of(wheel)}{f' of {rover}' if rover else ''}: "
            "name its rover with `rover`, or drop the column rover if that is wrong"
        )
    if written and rover and name != short_name(rover):
        text = f"{file}: was written for '{name}', and is read for {short_name(rover)}; name its rover with `rover`"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
