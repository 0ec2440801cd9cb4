"""Which soil is driven on: what was asked for, the terrain's, a common one, or one for each member from a table."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.names import one_of
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, from_si, soil_override
from lunarsci.twin.ground.terrain_files import TerrainFile

if TYPE_CHECKING:
    import pandas as pd


Origin = Literal["option", "default", "terrain", "belief", "priors", "samples", "map"]


@dataclass(frozen=True, slots=True)
class DrivenSoil:
    """Where the soil of a terrain comes from.

    Attributes
    ----------
    name : of the soil, or the file that has it.
    of : `option` where it was asked for, `terrain` where the terrain's file carries it, `default` otherwise.
    carried : parameters that the terrain's file has.
    rest : soil of the parameters that it lacks; empty where it lacks none, or where its own soil is not driven on.
    """

    name: str
    of: Origin
    carried: tuple[str, ...] = ()
    rest: str = ""

    @property
    def replaced(self) -> tuple[str, ...]:
        """Parameters of the terrain's file that are not driven on."""
        return self.carried if self.of == "option" else ()


def lay_soil_on(file: TerrainFile, path: str, soil: Soil, name: str, *, asked: bool) -> tuple[Terrain, DrivenSoil]:
    """The terrain of a file with the soil that is driven on, and where this comes from.

    `soil` is what the file was read with and `name` says which; one that was `asked` for lies everywhere, whatever the
    file carries, and another only fills in what the file lacks.
    """
    if asked:
        everywhere = np.array(soil.vector()).reshape(1, 1, 8)
        return replace(file.terrain, soil=everywhere), DrivenSoil(name, "option", file.carries)
    if not file.carries:
        return file.terrain, DrivenSoil(name, "default")
    rest = name if len(file.carries) < len(SOIL_COLUMNS) else ""
    return file.terrain, DrivenSoil(path, "terrain", file.carries, rest)


def soil_record(driven: DrivenSoil, terrain: Terrain, drawn: Iterable[str] = ()) -> dict[str, Any]:
    """The soil for a result: name, origin, its parameters but those that each drive draws for itself, and `drawn`.

    A parameter that changes from place to place has its lowest and highest value.
    """
    taken = sorted(drawn)
    values = {
        name: _range(from_si(name, terrain.soil[..., k])) for name, k in SOIL_COLUMNS.items() if name not in taken
    }
    return {
        "name": driven.name,
        "of": driven.of,
        "rest_of": driven.rest or None,
        "replaces_of_terrain": list(driven.replaced),
        "parameters": values,
        "drawn": taken,
    }


def _range(values: Any) -> float | dict[str, float]:
    low, high = (float(f"{value:.12g}") for value in (values.min(), values.max()))
    return low if low == high else {"low": low, "high": high}


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
            raise DataError(f"'{unknown[0]}' is not a soil parameter; {one_of(unknown[0], SOIL_COLUMNS)}")
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


def _rows(count: int, members: int | None, seed: int) -> IntArray:
    if members is None or members == count:
        return np.arange(count)
    if members > count:
        raise DataError(f"{count} soils for {members} members; give at most {count}")
    return np.sort(np.random.default_rng(seed).choice(count, members, replace=False))
