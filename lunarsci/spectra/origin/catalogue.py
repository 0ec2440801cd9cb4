"""Candidate craters: where they are, how large and old, and what their ejecta are made of."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lunarsci import inputs
from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.spectra.origin.composition import BANDS, MINERALS, Composition, Value
from lunarsci.spectra.origin.sphere import Point, checked_point
from lunarsci.tables import table_rows

__all__ = ["COLUMNS", "TABLE", "UNKNOWN_AGE_MA", "Crater", "embedded_catalogue", "read_catalogue"]

TABLE = "source_craters.csv"
UNKNOWN_AGE_MA = (1.0, 4200.0)
"""Age of a crater of which nothing is known; assumed. [Ma]"""
OLDEST_MA = 4560.0
LARGEST_KM = 2600.0
REQUIRED = ("name", "latitude_deg", "longitude_deg", "diameter_km")
SOURCES = ("position_source", "age_source", "composition_source", "source")
COLUMNS = (
    *REQUIRED,
    "age_low_ma",
    "age_high_ma",
    *(column for name in MINERALS for column in (name, f"{name}_sigma")),
    *(column for name in BANDS for column in (name, name.replace("_nm", "_sigma_nm"))),
    *SOURCES,
)
"""Columns of a catalogue; all but name, position and diameter may be left out or empty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crater:
    """One candidate.

    Attributes
    ----------
    latitude_deg, longitude_deg : centre, east positive, -180 to 360. [deg]
    diameter_km : of the rim; above 0 to 2600. [km]
    age_ma : youngest and oldest; `UNKNOWN_AGE_MA` where nothing is known. [Ma]
    composition : of its ejecta: mean and the scatter of single rocks about it; empty where unknown.
    sources : where position, age and composition come from.

    Raises ParameterError for values out of range.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    diameter_km: float
    age_ma: tuple[float, float] = UNKNOWN_AGE_MA
    composition: Composition = field(default_factory=Composition)
    sources: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checked_point(self.latitude_deg, self.longitude_deg)
        if not 0 < self.diameter_km <= LARGEST_KM:
            raise ParameterError(f"diameter is {self.diameter_km:g} km; it must be above 0 to {LARGEST_KM:g}")
        low, high = self.age_ma
        if not 0 < low <= high <= OLDEST_MA:
            raise ParameterError(f"age is {low:g} to {high:g} Ma; it must rise, from above 0 to {OLDEST_MA:g}")

    @property
    def center(self) -> Point:
        """Latitude and longitude. [deg]"""
        return self.latitude_deg, self.longitude_deg


def embedded_catalogue() -> tuple[Crater, ...]:
    """The craters around the Chang'E-4 site that come with lunarsci."""
    rows = table_rows(TABLE)
    return _craters([(f"row {number}", row) for number, row in enumerate(rows, 2)], TABLE)


def read_catalogue(source: InputFile) -> tuple[Crater, ...]:
    """Read candidate craters from a CSV table with the columns of `COLUMNS`.

    Lines that begin with # are remarks; empty cells are unknown. Raises DataError with file, line and what to do for
    missing or unknown columns, values that are no numbers or out of range, an age or error without its partner,
    doubled names, and a table without craters.
    """
    lines = [(n, line) for n, line in enumerate(inputs.text(source).splitlines(), 1) if _counts(line)]
    if not lines:
        raise DataError(f"{source.name}: holds no craters; the first line must be {','.join(REQUIRED)}")
    names = [name.strip() for name in next(csv.reader(io.StringIO(lines[0][1])))]
    _check_header(names, source.name)
    rows = []
    for number, line in lines[1:]:
        cells = next(csv.reader(io.StringIO(line)))
        if len(cells) != len(names):
            raise DataError(
                f"{source.name}: line {number}: has {len(cells)} cells, the header {len(names)}; correct it"
            )
        rows.append((f"line {number}", dict(zip(names, cells, strict=True))))
    if not rows:
        raise DataError(f"{source.name}: holds no craters below its header; add one line per crater")
    return _craters(rows, source.name)


def _counts(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _check_header(names: Sequence[str], file: str) -> None:
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise DataError(f"{file}: has no column {', '.join(missing)}; a catalogue needs {', '.join(REQUIRED)}")
    unknown = [name for name in names if name not in COLUMNS]
    if unknown:
        raise DataError(f"{file}: column '{unknown[0]}' is unknown; there may be {', '.join(COLUMNS)}")
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise DataError(f"{file}: column {doubled[0]} is there twice; keep one")


def _craters(rows: Sequence[tuple[str, Mapping[str, str]]], file: str) -> tuple[Crater, ...]:
    craters: dict[str, Crater] = {}
    for place, row in rows:
        try:
            crater = _crater(row)
        except ParameterError as error:
            raise DataError(f"{file}: {place}: {error}") from error
        if crater.name.casefold() in craters:
            raise DataError(f"{file}: {place}: a second '{crater.name}'; give every crater its own name")
        craters[crater.name.casefold()] = crater
    return tuple(craters.values())


def _crater(row: Mapping[str, str]) -> Crater:
    name = row["name"].strip()
    if not name:
        raise ParameterError("the crater has no name; give it one")
    position = [_number(row, column) for column in REQUIRED[1:]]
    for column, value in zip(REQUIRED[1:], position, strict=True):
        if value is None:
            raise ParameterError(f"{column} is empty; every crater needs it")
    ages = [_number(row, column) for column in ("age_low_ma", "age_high_ma")]
    if (ages[0] is None) != (ages[1] is None):
        raise ParameterError("age_low_ma and age_high_ma go together; give both or none")
    return Crater(
        name=name,
        latitude_deg=position[0],  # type: ignore[arg-type]
        longitude_deg=position[1],  # type: ignore[arg-type]
        diameter_km=position[2],  # type: ignore[arg-type]
        age_ma=UNKNOWN_AGE_MA if ages[0] is None else (ages[0], ages[1]),  # type: ignore[arg-type]
        composition=Composition(
            _pairs(row, {name: f"{name}_sigma" for name in MINERALS}),
            _pairs(row, {name: name.replace("_nm", "_sigma_nm") for name in BANDS}),
        ),
        sources={column.removesuffix("_source"): row[column].strip() for column in SOURCES if row.get(column)},
    )


def _pairs(row: Mapping[str, str], columns: Mapping[str, str]) -> dict[str, Value]:
    """Values that are there, with their errors."""
    found = {}
    for name, error in columns.items():
        value, sigma = _number(row, name), _number(row, error)
        if (value is None) != (sigma is None):
            raise ParameterError(f"{name} and {error} go together; give both or none")
        if value is not None and sigma is not None:
            found[name] = (value, sigma)
    return found


def _number(row: Mapping[str, str], column: str) -> float | None:
    """The number of a cell; None where it is empty or not there."""
    cell = (row.get(column) or "").strip()
    if not cell:
        return None
    try:
        value = float(cell)
    except ValueError:
        raise ParameterError(f"{column} is '{cell}', not a number; correct it, or leave it empty") from None
    if not math.isfinite(value):
        raise ParameterError(f"{column} is '{cell}'; leave the cell empty where nothing is known")
    return value
