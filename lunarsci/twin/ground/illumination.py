"""Which ground the Sun reaches: the shadows that a terrain casts on itself."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.ranges import FINITE, check_range, check_ranges
from lunarsci.sun import sun_in_moon_frame, upward
from lunarsci.twin.ground.terrain import Terrain

GRAZING_M = 1e-9
"""Ground this far below the shadow's edge is still lit: rounding must not darken a plane that the Sun grazes. [m]"""


@dataclass(frozen=True, slots=True)
class SunDirection:
    """Where the Sun stands in the frame of a terrain.

    Attributes
    ----------
    azimuth_deg : from x towards y, as headings are counted. [deg]
    elevation_deg : over a level horizon, -90 to 90. [deg]

    Raises ParameterError for a direction that is none.
    """

    azimuth_deg: float
    elevation_deg: float

    def __post_init__(self) -> None:
        check_ranges(self, {FINITE: "azimuth_deg", "[-90, 90]": "elevation_deg"}, "the Sun's")

    @property
    def vector(self) -> FloatArray:
        """Unit vector towards the Sun. (3,) [-]"""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def sun_over(time: str, longitude_deg: float, latitude_deg: float) -> SunDirection:
    """Where the Sun stands over a place on the Moon, in a frame with x to the east and y to the north.

    Parameters
    ----------
    time : UTC, as `2019-01-03T02:26:00`.
    longitude_deg, latitude_deg : east, mean-Earth frame; -180 to 360, -90 to 90. [deg]

    On a sphere. Within 0.1 deg of what was published for two Apollo sites.
    Raises ParameterError for a time or a place that is none.
    """
    check_range("longitude", longitude_deg, "[-180, 360]")
    check_range("latitude", latitude_deg, "[-90, 90]")
    try:
        moment = datetime.fromisoformat(time)
    except ValueError as error:
        raise ParameterError(f"'{time}' is no time; give UTC, for example 2019-01-03T02:26:00") from error
    body = sun_in_moon_frame(moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment)
    lon = math.radians(longitude_deg)
    east, up = np.array([-math.sin(lon), math.cos(lon), 0.0]), upward(longitude_deg, latitude_deg)
    seen = [float(axis @ body) for axis in (east, np.cross(up, east), up)]
    elevation = math.asin(max(-1.0, min(1.0, seen[2])))
    return SunDirection(math.degrees(math.atan2(seen[1], seen[0])), math.degrees(elevation))


def parse_sun(text: str) -> SunDirection:
    """Read `AZIMUTH,ELEVATION` in degrees, for example `30,12`, or `TIME@LONGITUDE,LATITUDE` as `sun_over` takes them.

    Raises ParameterError.
    """
    time, at, place = text.rpartition("@")
    try:
        one, other = map(float, place.split(","))
    except ValueError as error:
        raise ParameterError(
            f"sun '{text}' is not AZIMUTH,ELEVATION in degrees, for example 30,12, or TIME@LONGITUDE,LATITUDE, for "
            "example 2019-01-03T02:26:00@177.6,-45.5"
        ) from error
    return sun_over(time, one, other) if at else SunDirection(one, other)


def sunlit(terrain: Terrain, azimuth_deg: float, elevation_deg: float) -> BoolArray:
    """Nodes from which the middle of the Sun is seen over all other ground of the map.

    Parameters
    ----------
    terrain : heights; what lies beyond its edges and in holes casts no shadow.
    azimuth_deg : direction of the Sun from x towards y, as headings are counted. [deg]
    elevation_deg : over a level horizon; at 0 and below nothing is lit. [deg]

    Returns
    -------
    True where lit; False in shadow and where the height is unknown. (ny, nx)

    Notes
    -----
    A node is lit if no ground towards the Sun stands higher than the ray that leaves there: with s the way from the
    Sun, h + s tan(elevation) is nowhere before larger than at the node. Rays go from row to row of the grid (from
    column to column where the Sun is nearer to x), heights are linear between two nodes of a row, and between two rays;
    so the edge of a shadow is known to about a spacing. The Sun is a point, and the Moon is flat: half a degree of
    penumbra, and 0.3 m of fall within a kilometre, are left out.

    Raises ParameterError for a direction that is none.
    """
    SunDirection(azimuth_deg, elevation_deg)
    height = np.asarray(terrain.height_m, dtype=float)
    if elevation_deg <= 0:
        return np.zeros(height.shape, dtype=bool)
    azimuth = math.radians(azimuth_deg)
    x, y, fall = math.cos(azimuth), math.sin(azimuth), math.tan(math.radians(min(elevation_deg, 89.999)))
    if abs(x) > abs(y):
        return np.asarray(_lit_rows(height.T, x, y, fall * terrain.spacing_m).T)
    return _lit_rows(height, y, x, fall * terrain.spacing_m)


def _lit_rows(height: FloatArray, towards: float, aside: float, fall: float) -> BoolArray:
    """Lit nodes where the Sun stands across the rows: `towards` it along them down the grid, `aside` within a row.

    `fall` is how much a ray falls over a spacing. Rows are taken from the Sun's side on; each ray keeps the largest
    h + s tan(elevation) that it has met.
    """
    rows, columns = height.shape
    order = np.arange(rows)[::-1] if towards > 0 else np.arange(rows)
    shift, fall = -aside / abs(towards), fall / abs(towards)
    # Rays by where they cross the first row, so many that they cover all others.
    spread = math.ceil(abs(shift) * (rows - 1))
    first = -spread if shift > 0 else 0
    start = np.arange(first, columns + (spread if shift < 0 else 0), dtype=float)
    met = np.full(len(start), -np.inf)
    lit = np.zeros(height.shape, dtype=bool)
    for k, row in enumerate(order):
        crossing = start + k * shift
        nodes = np.arange(columns) - k * shift - first
        level = height[row] + k * fall
        with np.errstate(invalid="ignore"):
            lit[row] = level >= _between(met, nodes) - GRAZING_M
            met = np.fmax(met, _between(level, crossing) if k == 0 or shift else level)
    return lit


def _between(values: FloatArray, places: FloatArray) -> FloatArray:
    """Linear between two neighbours; NaN where one of them is, and beyond the ends."""
    low = np.floor(places)
    share = places - low
    near = low.astype(np.int64)
    left, right = _at(values, near), _at(values, near + 1)
    mixed = (1.0 - share) * left + share * right
    return np.where(share < 1e-9, left, np.where(share > 1 - 1e-9, right, mixed))


def _at(values: FloatArray, index: npt.NDArray[np.int64]) -> FloatArray:
    inside = (index >= 0) & (index < len(values))
    return np.where(inside, values[np.clip(index, 0, len(values) - 1)], np.nan)
