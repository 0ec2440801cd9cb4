"""Which soil is driven on: what was given as the soil of drives, what the terrain has, and samples for each drive."""

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import DataError, RequestError, within_file
from lunarsci.io.documents import toml_document
from lunarsci.io.inputs import InputFile, Source, read_input
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.names import one_of
from lunarsci.regolith.belief import FitVerdict, SoilBelief, first_belief, read_belief, read_verdict
from lunarsci.regolith.prior import PARAMETERS, read_prior
from lunarsci.regolith.soil import Soil, soil_tables
from lunarsci.twin.ground.soil_map import SCHEMA as MAP_SCHEMA
from lunarsci.twin.ground.soil_map import SoilMap, read_soil_map
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, TerrainFile, from_si, soil_override

if TYPE_CHECKING:
    import pandas as pd

Origin = Literal["option", "default", "terrain", "belief", "priors", "samples", "map"]
"""Where the soil of drives comes from: one soil that was asked for (`option`) or assumed, as nothing names one
(`default`); the terrain's file; a belief's file; the laws before any drive (`priors`); a CSV file with a row for each
member (`samples`); a soil map (`map`)."""
PRIORS = "priors"
"""Name of what is believed of the soil before any drive."""
OF_A_BELIEF = 64
"""Drives on soils of a belief, on draws of the ground, or on rows of a fit's draws, where their number is not given."""
DEFAULT_SOIL = "longji"
"""Where none is given; it also lies under a belief, where it is nowhere used: this replaces every parameter."""


@dataclass(frozen=True, slots=True)
class DrivenSoil:
    """Where the soil that is driven on comes from, for results and notes.

    Attributes
    ----------
    name : of the soil, or the file that has it.
    of : where it comes from, see `Origin`.
    carried : parameters that the terrain's file has.
    rest : name of the soil of the parameters that this file lacks; empty where it lacks none, or where its own soil is
        not driven on.
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
    """Lowest and highest of some values, or the one that all have; to 12 digits, as tangents and back cost the last."""
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
    with within_file(file.name, ValueError):
        unknown = [str(name) for name in table if name not in SOIL_COLUMNS]
        if unknown:
            raise DataError(f"'{unknown[0]}' is not a soil parameter; {one_of(unknown[0], SOIL_COLUMNS)}")
        if table.empty:
            raise DataError("no soils; a row for each is wanted")
        rows = _rows(len(table), members, seed)
    return {str(name): _column(file.name, str(name), cells)[rows] for name, cells in table.items()}


def _column(file: str, name: str, cells: "pd.Series") -> FloatArray:
    """Values of a soil parameter, in the unit of its name. Raises DataError for one outside of its range. (rows,)"""
    values = numbers_of(file, name, cells)
    strange = np.flatnonzero(~np.isfinite(values))
    suspects = strange[:1] if strange.size else (np.argmin(values), np.argmax(values))
    for row in suspects:
        with within_file(f"{file}, row {row + 1}", ValueError):
            soil_override({name: float(values[row])})
    return values


def _rows(count: int, members: int | None, seed: int) -> IntArray:
    """Which of `count` rows of a file the members have, ascending. (members,)"""
    if members is None or members == count:
        return np.arange(count)
    if members > count:
        raise DataError(f"{count} soils for {members} members; give at most {count}")
    return np.sort(np.random.default_rng(seed).choice(count, members, replace=False))


@dataclass(frozen=True, slots=True)
class GivenSoil:
    """What was given as the soil: a soil that lies everywhere, and a file that has one for each drive.

    Attributes
    ----------
    named : a soil's name, or its TOML file; None where none was given.
    file : the file with soils for the drives; None where there is none.
    of : what that file is: a `belief` or the laws of one, a `map` of beliefs, `samples` in rows, or `none`. It becomes
        the `Origin` of a `DrivenSoil` where such a file is given.
    belief, soil_map : what the file holds; None where it holds no such thing.
    """

    named: str | None = None
    file: InputFile | None = None
    of: Literal["none", "belief", "map", "samples"] = "none"
    belief: SoilBelief | None = None
    soil_map: SoilMap | None = None

    @classmethod
    def read(cls, soil: str | Sequence[str] | None) -> "GivenSoil":
        """Read names and files, each taken for what is in it.

        Raises RequestError where one of them leaves no room for another, DataError for a file that is no soil.
        """
        result = cls()
        for name in (soil,) if isinstance(soil, str) else soil or ():
            one = cls.of_source(name)
            taken = result.named if one.file is None else result.name
            if taken:
                what = "soil" if one.file is None else "soils"
                raise RequestError(f"{taken} and {name} as `soil` are two ways to name the {what}; give one")
            result = replace(result, named=name) if one.file is None else replace(one, named=result.named)
        if result.named is not None and result.of in ("belief", "map"):
            raise RequestError(no_use(result.named, result.name))
        return result

    @classmethod
    def of_source(cls, source: Source) -> "GivenSoil":
        """What one name or file is: priors, a soil by name or as TOML, laws of its parameters, JSON, or samples."""
        if isinstance(source, str) and source == PRIORS:
            file = InputFile(PRIORS, first_belief().to_json().encode())
            return cls(file=file, of="belief", belief=first_belief())
        if isinstance(source, str):
            like_a_file = source == "-" or Path(source).is_file() or source.lower().endswith((".json", ".csv"))
            if source in soil_tables() or not like_a_file:
                return cls(named=source)
        file = read_input(source)
        if file.data.lstrip().startswith(b"{") or file.name.lower().endswith(".json"):
            if MAP_SCHEMA.encode() in file.data:
                return cls(file=file, of="map", soil_map=read_soil_map(file))
            return cls(file=file, of="belief", belief=read_belief(file))
        if not _is_toml(file.data):
            return cls(file=file, of="samples")
        if _has_laws(file.data):
            return cls(file=file, of="belief", belief=first_belief(read_prior(file)))
        return cls(named=file.name)

    @property
    def name(self) -> str:
        """Of the file with soils for the drives; '' where there is none."""
        return "" if self.file is None else self.file.name

    @property
    def origin(self) -> Origin:
        """Where the soils that it names come from."""
        if self.file is None or self.of == "none":
            return "option"
        return "priors" if self.name == PRIORS or (self.of == "belief" and _has_laws(self.file.data)) else self.of

    @property
    def verdict(self) -> FitVerdict | None:
        """Of the fit that the soils come from, None where they come from none. Raises DataError."""
        if self.belief is not None:
            return self.belief.verdict
        return read_verdict(self.file) if self.file is not None and self.of == "samples" else None

    def members(self, asked: int | None) -> int | None:
        """How many drives: as asked, or of the rows that a fit drew from its posterior as many as of a belief.

        None for all rows of a file, or for what else decides. Raises DataError.
        """
        if asked or self.file is None or self.of != "samples" or self.verdict is None:
            return asked
        return OF_A_BELIEF if self.rows > OF_A_BELIEF else None

    @property
    def rows(self) -> int:
        """Of the table of soils; 0 where there is none."""
        return 0 if self.file is None or self.of != "samples" else len(read_csv_table(self.file))

    @property
    def one_soil(self) -> bool:
        """Whether all drives have one soil."""
        return self.file is None

    def to_dict(self) -> dict[str, Any]:
        """For the result: the drives that a belief rests on, and those of them that taught it something."""
        if self.belief is None:
            return {}
        return {"belief": self.name, "drives": len(self.belief.history), "learned_from": self.learned}

    @property
    def learned(self) -> int:
        """Drives that the belief rests on, without those from which nothing was learned."""
        return sum(not entry.get("refused") for entry in self.belief.history) if self.belief else 0


def doubt_of(name: str, belief: SoilBelief | None) -> str:
    """Why predictions from a belief of that name are doubtful; empty where they are not."""
    return f"the belief {name} is doubtful: {belief.doubt}" if belief is not None and belief.doubt else ""


def caution_of(name: str, belief: SoilBelief | None) -> str:
    """What to know of a belief of that name that is no doubt; empty where there is nothing."""
    return f"the belief {name} was learned with a warning: {belief.caution}" if belief and belief.caution else ""


def _has_laws(data: bytes) -> bool:
    """Whether a TOML file has laws of parameters, a table each, and not the numbers of a soil."""
    try:
        tables = toml_document(data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False
    return any(isinstance(tables.get(name), dict) for name in PARAMETERS)


def _is_toml(data: bytes) -> bool:
    """By the first line that is no comment: a key and its value, or a table's header."""
    lines = (line.strip() for line in data.decode("utf-8", "replace").splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return "=" in first or first.startswith("[")


def no_use(soil: str, other: str) -> str:
    """Why a soil that no drive meets is refused."""
    return f"`soil` {soil} has no use beside {other}, which has every parameter of the soil; leave it out"
