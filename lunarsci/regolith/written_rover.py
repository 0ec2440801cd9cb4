"""The rover in a table of wheel states: whose wheels they were, so that nobody reads them for others.

The column `rover` of tables that lunarsci writes has the name in the rover's file and the size of its wheels, in every
row, so that it stays where rows are taken out or tables are put together.
"""

import re
import warnings
from functools import cache
from typing import TYPE_CHECKING, Literal

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.rovers import known_rovers, known_wheels, read_rover
from lunarsci.tables import read_csv_table

if TYPE_CHECKING:
    import pandas as pd

COLUMN = "rover"
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
    return _asked_for().get(name) or " ".join(re.sub(r'[,;"]', " ", name).split())


@cache
def _asked_for() -> dict[str, str]:
    """Names in the files of lunarsci's rovers, and how they are asked for."""
    return {read_rover(name).name: name for name in known_rovers()}


def size_of(wheel: Wheel) -> str:
    """Radius and width, for `written_for`."""
    return f"wheels {1e3 * wheel.radius_m:.6g} x {1e3 * wheel.width_m:.6g} mm"


def rover_written(file: str, table: "pd.DataFrame") -> str:
    """The one rover that a table names; '' where it has no such column, or blanks. Raises DataError for several."""
    cells = table[COLUMN].dropna().unique() if COLUMN in table else ()
    found = sorted({" ".join(str(cell).split()) for cell in cells} - {""})
    if len(found) > 1:
        raise DataError(f"{file}: rows of several rovers: {found[0]}, and {found[1]}; keep those of one")
    return found[0] if found else ""


def rover_of_states(source: InputFile, rover: str | None, default: str) -> tuple[str, NamedBy]:
    """The rover or wheel of a table, and what named it: the one asked for, that of its column, or the default.

    Raises DataError where the table was written for a rover that lunarsci does not have, and none is asked for.
    """
    if rover:
        return rover, "option"
    written = rover_written(source.name, read_csv_table(source))
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
    written = rover_written(file, table)
    name, _, size = written.rpartition("; ")
    if written and size != size_of(wheel):
        raise DataError(
            f"{file}: was written for '{written}', and is read for {size_of(wheel)}{f' of {rover}' if rover else ''}: "
            "name its rover with `rover`, or drop the column rover if that is wrong"
        )
    if written and rover and name != short_name(rover):
        text = f"{file}: was written for '{name}', and is read for {short_name(rover)}; name its rover with `rover`"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
