"""What a table states of the modes of mixtures: shares that are known, minerals that are absent."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.columns import rows_by_id
from lunarsci.spectra.readers.library import mineral_named
from lunarsci.spectra.rows import number, quoted

PREFIX = "vol_"
"""May stand before a mineral's name in the header."""


@dataclass(frozen=True, slots=True)
class KnownModes:
    """By id of the spectrum.

    Attributes
    ----------
    known : shares by volume of all minerals, where every one is stated. [-]
    absent : minerals stated as 0 where others are sought.
    """

    known: Mapping[str, Mapping[str, float]]
    absent: Mapping[str, Sequence[str]]


def read_modes(source: InputFile) -> KnownModes:
    """Read a table with the column `id` and one per mineral, named as in `MINERALS` or `vol_ol` and the like.

    A row of numbers is a mixture whose modes are known; an empty cell is sought, and a 0 beside it says that a mineral
    is absent. Other columns are ignored.

    Raises DataError for a table without ids or minerals, a cell that is no share from 0 to 1, and a row that states
    some shares above 0 but not all.
    """
    rows = rows_by_id(source)
    minerals = _minerals(next(iter(rows.values()))[1], source.name)
    known: dict[str, dict[str, float]] = {}
    absent: dict[str, list[str]] = {}
    for id, (line, row) in rows.items():
        place = f"{source.name}: line {line}"
        shares = {
            mineral: _share(row[column], f"{place}, column {column}")
            for column, mineral in minerals.items()
            if row[column]
        }
        if len(shares) == len(minerals):
            known[id] = shares
        elif any(shares.values()):
            raise DataError(f"{place}: some shares are stated, others are not; state all, or leave those sought empty")
        else:
            absent[id] = list(shares)
    return KnownModes(known, absent)


def _minerals(row: Mapping[str, str], file: str) -> dict[str, str]:
    """Mineral by column."""
    found: dict[str, str] = {}
    for column in row:
        try:
            mineral = mineral_named(column.removeprefix(PREFIX))
        except DataError:
            continue
        if mineral in found.values():
            raise DataError(f"{file}: {mineral} has two columns; keep one")
        if mineral:
            found[column] = mineral
    if not found:
        raise DataError(f"{file}: has no column named after a mineral, such as olivine or vol_ol; add one")
    return found


def _share(cell: str, place: str) -> float:
    value = number(cell)
    if value is None or not 0 <= value <= 1:
        raise DataError(f"{place}: {quoted(cell)} is no share; give 0 to 1, or leave it empty where it is sought")
    return value
