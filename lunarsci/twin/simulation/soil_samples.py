"""Soils to drive on, one for each member, from a table: draws from a posterior, or any others."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.csv_table import numbers_of, read_csv_table
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile, read_input
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, soil_override

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["read_soil_samples"]

FloatArray = npt.NDArray[np.float64]


def read_soil_samples(
    source: InputFile | str | Path, members: int | None = None, seed: int = 0
) -> dict[str, FloatArray]:
    """Read soils from CSV: a column for each parameter, by the names of `Soil`, and a row for each member.

    With fewer `members` than rows, that many rows are drawn without repetition, by `seed`. Parameters that have no
    column stay those of the terrain. Raises DataError for other columns, for values outside the range of a parameter,
    and for fewer rows than members.
    """
    file = source if isinstance(source, InputFile) else read_input(str(source))
    table = read_csv_table(file)
    try:
        unknown = [str(name) for name in table if name not in SOIL_COLUMNS]
        if unknown:
            raise DataError(f"'{unknown[0]}' is not a soil parameter; these are: {', '.join(SOIL_COLUMNS)}")
        if table.empty:
            raise DataError("no soils; a row for each is wanted")
        rows = _rows(len(table), members, seed)
    except ValueError as error:
        raise DataError(f"{file.name}: {error}") from error
    return {str(name): _column(file.name, str(name), cells)[rows] for name, cells in table.items()}


def _column(file: str, name: str, cells: "pd.Series") -> FloatArray:
    values = numbers_of(file, name, cells)
    strange = np.flatnonzero(~np.isfinite(values))
    suspects = strange[:1] if strange.size else (np.argmin(values), np.argmax(values))
    for row in suspects:
        try:
            soil_override({name: float(values[row])})
        except ValueError as error:
            raise DataError(f"{file}, row {row + 1}: {error}") from error
    return values


def _rows(count: int, members: int | None, seed: int) -> npt.NDArray[np.int64]:
    if members is None or members == count:
        return np.arange(count)
    if members > count:
        raise DataError(f"{count} soils for {members} members; give at most {count}")
    return np.sort(np.random.default_rng(seed).choice(count, members, replace=False))
