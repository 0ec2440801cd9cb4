"""Candidate craters: where they are on the Moon (a sphere), how large and old, and what their ejecta are made of."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import table_rows
from lunarsci.names import meant
from lunarsci.spectra.origin.composition import BANDS, MINERALS, Composition, Value

Point = tuple[float, float]
"""Latitude and longitude, east positive. [deg]"""


def checked_point(latitude_deg: float, longitude_deg: float) -> Point:
    """Latitude -90 to 90 and longitude east -180 to 360 of a point; else ParameterError. [deg]"""
    if not -90 <= latitude_deg <= 90:
        raise ParameterError(f"latitude is {latitude_deg:g} deg; it must be -90 to 90")
    if not -180 <= longitude_deg <= 360:
        raise ParameterError(f"longitude is {longitude_deg:g} deg; it must be -180 to 360, east positive")
    return float(latitude_deg), float(longitude_deg)


def distance_km(start: Point, end: Point) -> float:
    """Great-circle distance between two points (latitude, longitude in deg), exact from 0 to the antipode. [km]

    R atan2(|a x b|, a . b) with a, b the unit vectors: no loss of digits at 0 or 180 deg, as haversine has.
    """
    a, b = _unit(start), _unit(end)
    return float(MOON_RADIUS_KM * np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def azimuth_deg(start: Point, end: Point) -> float | None:
    """Direction at `start` towards `end`, clockwise from north, 0 to 360; None at the same point and the antipode."""
    latitude, longitude = np.radians(start)
    to = _unit(end)
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    north = np.array([-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude), np.cos(latitude)])
    if np.hypot(to @ east, to @ north) < 1e-12:
        return None
    return float(np.degrees(np.arctan2(to @ east, to @ north)) % 360)


def destination(start: Point, azimuth: npt.ArrayLike, distance: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes (-180 to 180) at azimuths [deg] and great-circle distances [km] from a point. [deg]"""
    latitude, longitude = np.radians(start)
    heading, arc = np.radians(np.asarray(azimuth, float)), np.asarray(distance, float) / MOON_RADIUS_KM
    sine = np.sin(latitude) * np.cos(arc) + np.cos(latitude) * np.sin(arc) * np.cos(heading)
    end = np.arcsin(np.clip(sine, -1, 1))
    turn = np.arctan2(np.sin(heading) * np.sin(arc) * np.cos(latitude), np.cos(arc) - np.sin(latitude) * np.sin(end))
    return np.degrees(end), (np.degrees(longitude + turn) + 180) % 360 - 180


def _unit(point: Point) -> FloatArray:
    latitude, longitude = np.radians(point)
    return np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])


TABLE = "source_craters.csv"
UNKNOWN_AGE_MA = (1.0, 4200.0)
"""Age of a crater of which nothing is known; assumed. [Ma]"""
OLDEST_MA = 4560.0
"""Nothing on the Moon is older than the solar system: 4567.3 Ma, Connelly et al. (2012), Science 338, 651,
10.1126/science.1226919, rounded down. [Ma]"""
LARGEST_KM = 2600.0
"""Larger than the South Pole-Aitken basin, 2400 by 2050 km (Garrick-Bethell & Zuber 2009, Icarus 204, 399,
10.1016/j.icarus.2009.05.032). [km]"""
FEWEST_TO_DOUBT = 3
"""Craters whose positions, all small enough to be radians, are doubted. One point of the Moon in 1000 is so small."""
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
    doubled names, and a table without craters. Warns with LunarSciWarning where positions may be in radians.
    """
    lines = [(n, line) for n, line in enumerate(inputs.text(source).splitlines(), 1) if _counts(line)]
    if not lines:
        raise DataError(f"{source.name}: holds no craters; the first line must be {','.join(REQUIRED)}")
    names = [name.strip() for name in next(inputs.csv_rows(source.name, [lines[0][1]]))]
    _check_header(names, source.name)
    rows = []
    for number, line in lines[1:]:
        cells = next(inputs.csv_rows(f"{source.name}: line {number}", [line]))
        if len(cells) != len(names):
            raise DataError(
                f"{source.name}: line {number}: has {len(cells)} cells, the header {len(names)}; correct it"
            )
        rows.append((f"line {number}", dict(zip(names, cells, strict=True))))
    if not rows:
        raise DataError(f"{source.name}: holds no craters below its header; add one line per crater")
    craters = _craters(rows, source.name)
    if _in_radians(craters):
        warnings.warn(
            f"{source.name}: no latitude beyond {math.pi / 2:.3g} deg and no longitude beyond {2 * math.pi:.3g} deg; "
            "are they in radians?",
            LunarSciWarning,
            stacklevel=2,
        )
    return craters


def _in_radians(craters: Sequence[Crater]) -> bool:
    """Whether positions might be: three craters or more, all within 1.6 deg of latitude and 6.3 deg of longitude."""
    small = (abs(c.latitude_deg) < math.pi / 2 and abs(c.longitude_deg) < 2 * math.pi for c in craters)
    return len(craters) >= FEWEST_TO_DOUBT and all(small)


def _counts(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _check_header(names: Sequence[str], file: str) -> None:
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise DataError(f"{file}: has no column {', '.join(missing)}; a catalogue needs {', '.join(REQUIRED)}")
    unknown = [name for name in names if name not in COLUMNS]
    if unknown:
        near = meant(unknown[0], COLUMNS)
        raise DataError(f"{file}: column '{unknown[0]}' is unknown; {near}there may be {', '.join(COLUMNS)}")
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
