"""Candidate craters: where they are on the Moon (a sphere), how large and old, and what their ejecta are made of."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import DataError, ParameterError, warn
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import check_columns, table_rows
from lunarsci.minerals import WITH_BANDS
from lunarsci.ranges import check_range
from lunarsci.spectra.origin.composition import BANDS, Composition
from lunarsci.spectra.readers.columns import rows_by_id
from lunarsci.spectra.rows import number

Point = tuple[float, float]
"""Latitude and longitude, east positive. [deg]"""


def checked_point(latitude_deg: float, longitude_deg: float) -> Point:
    """Latitude -90 to 90 and longitude east -180 to 360 of a point; else ParameterError. [deg]"""
    check_range("latitude", latitude_deg, "[-90, 90]")
    check_range("longitude", longitude_deg, "[-180, 360]", "degrees east")
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
PAIRS = {"age_low_ma": "age_high_ma"} | {
    name: f"{name.removesuffix('_nm')}_sigma{'_nm' if name in BANDS else ''}" for name in (*WITH_BANDS, *BANDS)
}
"""Columns that go together."""
COLUMNS = (*REQUIRED, *(column for pair in PAIRS.items() for column in pair), *SOURCES)
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
        youngest, oldest = self.age_ma
        check_range("diameter_km", self.diameter_km, f"(0, {LARGEST_KM}]")
        check_range("youngest age", youngest, f"(0, {OLDEST_MA}]")
        check_range("oldest age", oldest, f"[{youngest}, {OLDEST_MA}]")

    @property
    def center(self) -> Point:
        """Latitude and longitude. [deg]"""
        return self.latitude_deg, self.longitude_deg


def embedded_catalogue() -> tuple[Crater, ...]:
    """The craters around the Chang'E-4 site that come with lunarsci."""
    return tuple(_crater(row) for row in table_rows(TABLE))


def read_catalogue(source: InputFile) -> tuple[Crater, ...]:
    """Read candidate craters from a CSV table with the columns of `COLUMNS`.

    Lines that begin with # are remarks; empty cells are unknown. Raises DataError with file, line and what to do for
    missing or unknown columns, values that are no numbers or out of range, an age or error without its partner,
    doubled names, and a table without craters. Warns with LunarSciWarning where positions may be in radians.
    """
    rows = rows_by_id(source, "name")
    header = next(iter(rows.values()))[1]
    if unknown := check_columns(source.name, header, COLUMNS, REQUIRED):
        raise DataError(f"{source.name}: column '{unknown[0]}' is unknown; there may be {', '.join(COLUMNS)}")
    craters = []
    for line, row in rows.values():
        try:
            craters.append(_crater(row))
        except ParameterError as error:
            raise DataError(f"{source.name}: line {line}: {error}") from error
    if _in_radians(craters):
        warn(
            f"{source.name}: no latitude beyond {math.pi / 2:.3g} deg and no longitude beyond {2 * math.pi:.3g} deg; "
            "are they in radians?"
        )
    return tuple(craters)


def _in_radians(craters: Sequence[Crater]) -> bool:
    """Whether positions might be: three craters or more, all within 1.6 deg of latitude and 6.3 deg of longitude."""
    small = (abs(c.latitude_deg) < math.pi / 2 and abs(c.longitude_deg) < 2 * math.pi for c in craters)
    return len(craters) >= FEWEST_TO_DOUBT and all(small)


def _crater(row: Mapping[str, str]) -> Crater:
    cells = {column: cell.strip() for column, cell in row.items() if cell.strip()}
    values = {column: _number(column, cell) for column, cell in cells.items() if column not in (*SOURCES, "name")}
    pairs = {one: (values[one], values[other]) for one, other in PAIRS.items() if values.keys() >= {one, other}}
    torn = [f"{one} and {other} go together" for one, other in PAIRS.items() if (one in values) != (other in values)]
    if lacking := [f"{column} is empty" for column in REQUIRED if column not in cells] + torn:
        raise ParameterError(f"{lacking[0]}; complete the line")
    modes, bands = ({name: pairs[name] for name in some if name in pairs} for some in (WITH_BANDS, BANDS))
    return Crater(
        name=cells["name"],
        **{column: values[column] for column in REQUIRED[1:]},
        age_ma=pairs.get("age_low_ma", UNKNOWN_AGE_MA),
        composition=Composition(modes, bands),
        sources={column.removesuffix("_source"): cells[column] for column in SOURCES if column in cells},
    )


def _number(column: str, cell: str) -> float:
    value = number(cell)
    if value is None or not math.isfinite(value):
        raise ParameterError(f"{column} is '{cell}', not a number; correct it, or leave it empty if unknown")
    return value
