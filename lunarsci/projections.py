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

NO_RASTERIO = "GeoTIFF and coordinate systems need rasterio; pip install 'lunarsci[cubes]'"
LARGEST_STRETCH = 0.02
"""A map metre may differ by this share from one on the ground; assumed: less than slip does."""
STEP_M = 10.0


@dataclass(frozen=True, slots=True)
class MapProjection:
    """A coordinate system in m of a map of some body.

    Attributes
    ----------
    wkt : the system as well-known text (OGC 01-009).

    Raises ParameterError for text that is none, and for a system in degrees or in another unit than m.
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
        if system.is_geographic:
            raise ParameterError("its coordinates are degrees of longitude and latitude")
        if system.linear_units_factor[1] != 1.0:
            raise ParameterError(f"its projection counts in {system.linear_units_factor[0]}; project it to m")
        radius, flattening = self.ellipsoid
        globe = f"+a={radius!r} +f={flattening!r}" if flattening else f"+R={radius!r}"
        object.__setattr__(self, "_system", system)
        object.__setattr__(self, "_degrees", CRS.from_user_input(f"+proj=longlat {globe} +no_defs"))

    @property
    def name(self) -> str:
        """As its text calls it."""
        found = re.match(r'\s*\w+\["([^"]*)"', self.wkt)
        return found.group(1) if found else "unnamed"

    @property
    def ellipsoid(self) -> tuple[float, float]:
        """Equatorial radius and flattening of the body. [m, -]"""
        return ellipsoid_of(self.wkt)

    def lonlat(self, x_m: Any, y_m: Any) -> FloatArray:
        """Longitude to the east and latitude of places. (n, 2) [deg]"""
        return self._moved(self._system, self._degrees, x_m, y_m)

    def metres(self, longitude_deg: Any, latitude_deg: Any) -> FloatArray:
        """x and y on the map. (n, 2) [m] Raises ParameterError for what is no place of the map."""
        lon, lat = (np.atleast_1d(np.asarray(values, dtype=float)) for values in (longitude_deg, latitude_deg))
        if not ((np.abs(lon) <= 360.0).all() and (np.abs(lat) <= 90.0).all()):
            raise ParameterError("longitudes lie between -360 and 360 deg to the east, latitudes between -90 and 90")
        places = self._moved(self._degrees, self._system, lon, lat)
        if not np.isfinite(places).all():
            raise ParameterError(f"the map's projection ({self.name}) has no such place")
        return places

    def ground(self, x_m: float, y_m: float) -> FloatArray:
        """What a metre of the map along x and along y is on the ground: to the east and to the north. (2, 2) [m]

        By differences over 20 m on the ellipsoid, of radii a / w to the east and a (1 - e^2) / w^3 to the north with
        w^2 = 1 - e^2 sin^2(latitude).
        """
        step = STEP_M * np.array([1.0, -1.0, 0.0, 0.0])
        places = self.lonlat(x_m + step, y_m + step[[2, 3, 0, 1]])
        lon, lat = np.radians(places).T
        radius, flattening = self.ellipsoid
        eccentric = flattening * (2.0 - flattening)
        middle = float(np.radians(self.lonlat(x_m, y_m)[0, 1]))
        w = math.sqrt(1.0 - eccentric * math.sin(middle) ** 2)
        turned = np.arctan2(np.sin(lon[::2] - lon[1::2]), np.cos(lon[::2] - lon[1::2]))
        east = radius / w * math.cos(middle) * turned
        north = radius * (1.0 - eccentric) / w**3 * (lat[::2] - lat[1::2])
        return np.column_stack([east, north]) / (2.0 * STEP_M)

    def north_deg(self, x_m: float, y_m: float) -> float:
        """Direction of true north at a place, counted from the map's y to the right. [deg]"""
        across, along = np.linalg.solve(self.ground(x_m, y_m).T, [0.0, 1.0])
        return math.degrees(math.atan2(across, along))

    def stretch(self, x_m: float, y_m: float) -> float:
        """Largest share by which a metre of the map differs from one on the ground at a place. [-]"""
        return float(np.abs(np.linalg.norm(self.ground(x_m, y_m), axis=1) - 1.0).max())

    def _moved(self, start: Any, end: Any, first: Any, second: Any) -> FloatArray:
        from rasterio.warp import transform

        x, y = (np.atleast_1d(np.asarray(values, dtype=float)).ravel() for values in (first, second))
        return np.column_stack(transform(start, end, x, y)[:2]).astype(float)


def ellipsoid_of(wkt: str) -> tuple[float, float]:
    """Equatorial radius and flattening that a well-known text names. [m, -] Raises ParameterError."""
    found = re.search(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([\d.eE+]+),\s*([\d.eE+]+)', wkt)
    if found is None or not float(found.group(1)) > 0:
        raise ParameterError("its coordinate system names no body (SPHEROID)")
    inverse = float(found.group(2))
    return float(found.group(1)), 1.0 / inverse if inverse else 0.0


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


def check_scale(wkt: str, what: str, middle_m: Sequence[float], spacing_m: float) -> None:
    """Raises DataError where metres of the map are not those of the ground at its middle, with what to do."""
    try:
        projection = MapProjection(wkt)
    except ParameterError as error:
        raise DataError(f"{what}: {error}") from error
    x, y = middle_m
    if (stretch := projection.stretch(x, y)) <= LARGEST_STRETCH:
        return
    lon, lat = projection.lonlat(x, y)[0]
    raise DataError(
        f"{what}: a metre of the map differs by {stretch:.0%} from one on the ground at its middle; "
        f"{remedy(wkt, lon, lat, spacing_m)}"
    )


def remedy(wkt: str, longitude_deg: float, latitude_deg: float, spacing_m: float) -> str:
    """The command that projects a GeoTIFF to metres about a place, for a message."""
    radius, flattening = ellipsoid_of(wkt)
    globe = f"+a={radius:.10g} +f={flattening:.10g}" if flattening else f"+R={radius:.10g}"
    local = f"+proj=stere +lat_0={latitude_deg:.4f} +lon_0={longitude_deg:.4f} {globe}"
    return (
        f"project it to metres about its middle: rio warp IN.tif OUT.tif --dst-crs '{local}' --res {spacing_m:.3g} "
        "--resampling bilinear (nearest where it has classes of ground)"
    )


def known_projection(crs: str) -> MapProjection | None:
    """The system of a well-known text; None for an empty one, and where rasterio is not installed."""
    return MapProjection(crs) if crs and find_spec("rasterio") is not None else None


def lonlat_of(crs: str, place_m: Sequence[float]) -> dict[str, float]:
    """`longitude_deg` and `latitude_deg` of a place, for a result; nothing where the map has no coordinate system."""
    projection = known_projection(crs)
    if projection is None:
        return {}
    longitude, latitude = projection.lonlat(*place_m)[0]
    return {"longitude_deg": float(longitude), "latitude_deg": float(latitude)}
