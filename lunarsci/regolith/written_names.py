"""Rover and ground in a table of wheel states: whose wheels were where, so that nobody reads them for others.

The column `rover` of tables that lunarsci writes has the name in the rover's file and the size of its wheels, `ground`
the terrain's name and a mark of its heights, in every row, so that they stay where rows are taken out or tables are put
together. Older tables and those of other programs may lack them.
"""

import hashlib
import re
import warnings
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import read_csv_table
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.rovers import known_rovers, known_wheels, read_rover

if TYPE_CHECKING:
    import pandas as pd

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


def ground_kinship(written: str, own: str) -> Literal["same", "changed", "other"]:
    """Whether a ground has the heights of another, whatever their names are, or only its name.

    >>> ground_kinship("a; heights 1", "b; heights 1"), ground_kinship("a; heights 1", "a; heights 2")
    ('same', 'changed')
    """
    (name, _, mark), (own_name, _, own_mark) = written.rpartition("; "), own.rpartition("; ")
    if mark == own_mark:
        return "same"
    return "changed" if name == own_name else "other"


@cache
def _asked_for() -> dict[str, str]:
    """Names in the files of lunarsci's rovers, and how they are asked for."""
    return {read_rover(name).name: name for name in known_rovers()}


def size_of(wheel: Wheel) -> str:
    """Radius and width, for `written_for`."""
    return f"wheels {1e3 * wheel.radius_m:.6g} x {1e3 * wheel.width_m:.6g} mm"


def written_in(file: str, table: "pd.DataFrame", column: str = COLUMN) -> str:
    """The one rover or ground that a table names; '' without such a column, or blank. Raises DataError for several."""
    cells = table[column].dropna().unique() if column in table else ()
    found = sorted({" ".join(str(cell).split()) for cell in cells} - {""})
    if len(found) > 1:
        raise DataError(f"{file}: rows of several {column}s: {found[0]}, and {found[1]}; keep those of one")
    return found[0] if found else ""


def rover_of_states(source: InputFile, rover: str | None, default: str) -> tuple[str, NamedBy]:
    """The rover or wheel of a table, and what named it: the one asked for, that of its column, or the default.

    Raises DataError where the table was written for a rover that lunarsci does not have, and none is asked for.
    """
    if rover:
        return rover, "option"
    written = written_in(source.name, read_csv_table(source))
    return (_known_as(source.name, written), "table") if written else (default, "default")


def _known_as(file: str, written: str) -> str:
    """The rover or wheel of lunarsci that a table was written for. Raises DataError where it was for another."""
    for name in (*known_rovers(), *known_wheels()):
        description = read_rover(name)
        if written == written_for(description.name, read_wheel(description)):
            return name
    raise DataError(
        f"{file}: was written for '{written}', which lunarsci does not have; give the file of that rover with `rover`"
    )


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
