"""Coordinate systems of maps: longitude and latitude of places on them, their scale, and where north is."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.ranges import check_range, refuse

NO_RASTERIO = "GeoTIFF and coordinate systems need rasterio; pip install 'lunarsci[cubes]'"
LARGEST_STRETCH = 0.02
"""A map metre may differ by this share from one on the ground; assumed: less than slip does."""
STEP_M = 10.0
"""Step to either side of a place over which the stretch of a map is taken. [m]"""


@dataclass(frozen=True, slots=True)
class MapProjection:
    """A coordinate system in m of a map of some body.

    Attributes
    ----------
    wkt : the system as well-known text (OGC 01-009).

    Raises ParameterError for text that is none, and for a system in degrees or in another unit than m. `_system` is
    rasterio's object of it, `_degrees` that of the longitudes and latitudes it belongs to.
    """

    wkt: str
    _system: Any = field(init=False, repr=False, compare=False)
    _degrees: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        try:
            from rasterio.crs import CRS
            from rasterio.errors import CRSError
        except ImportError as error:
            raise ParameterError(NO_RASTERIO) from error
        try:
            system = CRS.from_user_input(self.wkt)
        except CRSError as error:
            raise ParameterError(f"not a coordinate system: {error}") from error
        unit, metres = ("", 1.0) if system.is_geographic else system.linear_units_factor
        reasons = {
            "its coordinates are degrees of longitude and latitude": system.is_geographic,
            f"its projection counts in {unit}; project it to m": metres != 1.0,
        }
        refuse(reasons)
        object.__setattr__(self, "_system", system)
        object.__setattr__(self, "_degrees", CRS.from_user_input(degrees_of(self.wkt)))

    @property
    def name(self) -> str:
        """As its text calls it."""
        return name_of(self.wkt)

    @property
    def ellipsoid(self) -> tuple[float, float]:
        """Equatorial radius and flattening of the body. [m, -]"""
        return ellipsoid_of(self.wkt)

    def lonlat(self, x_m: Any, y_m: Any) -> FloatArray:
        """Longitude to the east and latitude of places. (n, 2) [deg]"""
        return moved(self._system, self._degrees, x_m, y_m)

    def metres(self, longitude_deg: Any, latitude_deg: Any) -> FloatArray:
        """x and y on the map. (n, 2) [m] Raises ParameterError for what is no place of the map."""
        lon, lat = (np.atleast_1d(np.asarray(values, dtype=float)) for values in (longitude_deg, latitude_deg))
        check_range("a longitude", float(np.abs(lon).max()), "[0, 360]", "in deg to the east or west")
        check_range("a latitude", float(np.abs(lat).max()), "[0, 90]", "in deg to the north or south")
        return moved(self._degrees, self._system, lon, lat)

    def ground(self, x_m: float, y_m: float) -> FloatArray:
        """What a metre of the map along x and along y is on the ground: to the east and to the north. (2, 2) [m]

        By differences over 20 m in space, of places a / w (cos lat cos lon, cos lat sin lon, (1 - e^2) sin lat) with
        w^2 = 1 - e^2 sin^2(lat) on the ellipsoid; so also at a pole.
        """
        step = STEP_M * np.array([0.0, 1.0, -1.0, 0.0, 0.0])
        lon, lat = np.radians(self.lonlat(x_m + step, y_m + step[[0, 3, 4, 1, 2]])).T
        radius, flattening = self.ellipsoid
        squeezed = (1.0 - flattening) ** 2
        up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        places = radius / np.sqrt(1.0 - (1.0 - squeezed) * up[2] ** 2) * up * np.array([[1.0], [1.0], [squeezed]])
        east = np.array([-math.sin(lon[0]), math.cos(lon[0]), 0.0])
        north = np.cross(up[:, 0], east)
        steps = (places[:, 1::2] - places[:, 2::2]).T / (2.0 * STEP_M)
        return np.column_stack([steps @ east, steps @ north])

    def north_deg(self, x_m: float, y_m: float) -> float:
        """Direction of true north at a place, counted from the map's y to the right. [deg]"""
        across, along = np.linalg.solve(self.ground(x_m, y_m).T, [0.0, 1.0])
        return math.degrees(math.atan2(across, along))

    def stretch(self, x_m: float, y_m: float) -> float:
        """Largest share by which a metre of the map differs from one on the ground at a place. [-]"""
        return float(np.abs(np.linalg.norm(self.ground(x_m, y_m), axis=1) - 1.0).max())

    def worst_stretch(self, x_m: Any, y_m: Any) -> float:
        """The largest `stretch` of several places. [-]"""
        return max(self.stretch(x, y) for x, y in zip(x_m, y_m, strict=True))


def moved(start: Any, end: Any, first: Any, second: Any) -> FloatArray:
    """Places of one system in another, both as text that rasterio takes. (n, 2)

    Within one system, which may be none (''), they stay as they are, and rasterio is not needed. Raises ParameterError
    for what is no place of both.
    """
    x, y = (np.atleast_1d(np.asarray(values, dtype=float)).ravel() for values in (first, second))
    if start == end:
        return np.column_stack([x, y])
    from rasterio.crs import CRS
    from rasterio.warp import transform

    try:
        places = transform(CRS.from_user_input(start), CRS.from_user_input(end), x, y)[:2]
        return np.asarray_chkfinite(np.column_stack(places), dtype=float)
    except Exception as error:  # whatever GDAL says of a place that is none: its errors have no public class
        raise ParameterError(f"the map's projection has no such place ({error})") from error


def name_of(wkt: str) -> str:
    """What a well-known text calls its system."""
    match = re.match(r'\s*\w+\["([^"]*)"', wkt)
    return match.group(1).strip() if match else "unnamed"


def carried(crs: str, onto: str, x_m: float, y_m: float, heading_deg: float) -> tuple[float, float, float]:
    """A pose on one map as a pose on another of the same body. [m, m, deg]

    Headings go from x towards y. Raises ParameterError where there is no such place.
    """
    start, end = MapProjection(crs), MapProjection(onto)
    if abs(start.ellipsoid[0] / end.ellipsoid[0] - 1.0) > LARGEST_STRETCH:
        raise ParameterError(f"'{start.name}' and '{end.name}' are of two bodies")
    x, y = end.metres(*start.lonlat(x_m, y_m)[0])[0]
    turned = math.radians(heading_deg)
    ahead = np.array([math.cos(turned), math.sin(turned)]) @ start.ground(x_m, y_m)
    along, across = np.linalg.solve(end.ground(x, y).T, ahead)
    return float(x), float(y), math.degrees(math.atan2(across, along))


def degrees_of(wkt: str) -> str:
    """Longitude and latitude on the body of a well-known text, as text that rasterio takes. Raises ParameterError."""
    return f"+proj=longlat {_globe(wkt)} +no_defs"


def _globe(wkt: str) -> str:
    radius, flattening = ellipsoid_of(wkt)
    return f"+a={radius!r} +f={flattening!r}" if flattening else f"+R={radius!r}"


def local_projection(wkt: str, x: Any, y: Any) -> MapProjection:
    """Stereographic about the middle of places, which may be of a system in degrees; on its body.

    It is true to angles, and its metres are those of the ground within 2 % for 16 deg about the middle (Snyder 1987,
    USGS Professional Paper 1395, p. 157: 1 / cos^2 of half the distance). Raises ParameterError.
    """
    from rasterio.crs import CRS

    lon, lat = np.radians(moved(wkt, degrees_of(wkt), x, y)).T
    directions = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east, north, up = directions.mean(axis=1)
    middle = math.atan2(north, east), math.atan2(up, math.hypot(east, north))
    lon_deg, lat_deg = (round(math.degrees(angle), 6) + 0.0 for angle in middle)  # 0.0 makes -0.0 0.0
    local = f"+proj=stere +lat_0={lat_deg:.6f} +lon_0={lon_deg:.6f} {_globe(wkt)} +units=m +no_defs"
    text = CRS.from_user_input(local).to_wkt()
    return MapProjection(text.replace(name_of(text), f"stereographic about {lon_deg:.4f}, {lat_deg:.4f} deg", 1))


def ellipsoid_of(wkt: str) -> tuple[float, float]:
    """Equatorial radius and flattening that a well-known text names. [m, -] Raises ParameterError."""
    match = re.search(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([\d.eE+]+),\s*([\d.eE+]+)', wkt)
    if match is None or not float(match.group(1)) > 0:
        raise ParameterError("its coordinate system names no body (SPHEROID)")
    inverse = float(match.group(2))
    return float(match.group(1)), 1.0 / inverse if inverse else 0.0


def projection_of(wkt: str, what: str) -> MapProjection:
    """The system of `what`, for longitude and latitude. Raises DataError where there is none."""
    if not wkt:
        raise DataError(
            f"{what} names no coordinate system, so longitude and latitude mean nothing on it; give x and y in m, or a "
            "GeoTIFF with its projection"
        )
    try:
        return MapProjection(wkt)
    except ParameterError as error:
        raise DataError(f"{what}: {error}") from error


def projection_or_none(crs: str) -> MapProjection | None:
    """The system of a well-known text; None for an empty one, and where rasterio is not installed."""
    return MapProjection(crs) if crs and find_spec("rasterio") is not None else None


def projection_notes(crs: str, x_m: FloatArray, y_m: FloatArray) -> tuple[str, ...]:
    """The system of a map and where north is in the middle of its columns and rows, for people; nothing without one."""
    projection = projection_or_none(crs)
    if projection is None:
        return ()
    north = projection.north_deg(float(x_m[x_m.size // 2]), float(y_m[y_m.size // 2]))
    return (f"x and y are of the projection '{projection.name}'; true north is {north:.2f} deg to the right of y",)


def lonlat_of(crs: str, place_m: Sequence[float]) -> dict[str, float]:
    """`longitude_deg` and `latitude_deg` of a place, for a result; nothing where the map has no coordinate system."""
    projection = projection_or_none(crs)
    if projection is None:
        return {}
    longitude, latitude = projection.lonlat(*place_m)[0]
    return {"longitude_deg": float(longitude), "latitude_deg": float(latitude)}
