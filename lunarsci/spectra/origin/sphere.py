"""Distances and directions on the Moon, taken as a sphere."""

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["MOON_RADIUS_KM", "Point", "azimuth_deg", "checked_point", "destination", "distance_km"]

Point = tuple[float, float]
"""Latitude and longitude, east positive. [deg]"""
MOON_RADIUS_KM = 1737.4
"""Mean radius, Archinal et al. (2018), Celest. Mech. Dyn. Astron. 130, 22, 10.1007/s10569-017-9805-5. [km]"""


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
