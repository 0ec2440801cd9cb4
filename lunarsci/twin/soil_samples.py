"""Soils to drive on, one for each member, from a table: draws from a posterior, or any others."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, soil_override

__all__ = ["read_soil_samples"]

FloatArray = npt.NDArray[np.float64]


def read_soil_samples(path: str | Path, members: int | None = None, seed: int = 0) -> dict[str, FloatArray]:
    """Read soils from CSV: a column for each parameter, by the names of `Soil`, and a row for each member.

    With fewer `members` than rows, that many rows are drawn without repetition, by `seed`. Parameters that have no
    column stay those of the terrain. Raises DataError for other columns, for values outside the range of a parameter,
    and for fewer rows than members.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path, comment="#")
        unknown = [str(name) for name in table if name not in SOIL_COLUMNS]
        if unknown:
            raise DataError(f"'{unknown[0]}' is not a soil parameter; these are: {', '.join(SOIL_COLUMNS)}")
        if table.empty:
            raise DataError("no soils; a row for each is wanted")
        values = {str(name): np.asarray(pd.to_numeric(column), dtype=float) for name, column in table.items()}
        for name, column in values.items():
            for extreme in (column.min(), column.max()):
                soil_override({name: float(extreme)})
        return {name: column[_rows(len(table), members, seed)] for name, column in values.items()}
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def _rows(count: int, members: int | None, seed: int) -> npt.NDArray[np.int64]:
    if members is None or members == count:
        return np.arange(count)
    if members > count:
        raise DataError(f"{count} soils for {members} members; give at most {count}")
    return np.sort(np.random.default_rng(seed).choice(count, members, replace=False))
