"""Where the Sun stands over a place on the Moon, and how far away; no file is read and no connection is opened."""

import math
import warnings
from datetime import UTC, datetime

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError

_FIRST = datetime(1950, 1, 1, tzinfo=UTC)
_END = datetime(2100, 1, 1, tzinfo=UTC)
_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
_J2000_JD = 2451545.0
_SECONDS_PER_DAY = 86400.0

# Argument and rate of E1 to E13 [deg, deg/day], then their terms [deg] in right ascension (sin) and declination (cos)
# of the pole and in the angle of the prime meridian (sin): Archinal et al. (2018), 10.1007/s10569-017-9805-5, Table 2.
_LUNAR_TERMS = np.array(
    [
        (125.045, -0.0529921, -3.8787, 1.5419, 3.5610),
        (250.089, -0.1059842, -0.1204, 0.0239, 0.1208),
        (260.008, 13.0120009, 0.0700, -0.0278, -0.0642),
        (176.625, 13.3407154, -0.0172, 0.0068, 0.0158),
        (357.529, 0.9856003, 0.0, 0.0, 0.0252),
        (311.589, 26.4057084, 0.0072, -0.0029, -0.0066),
        (134.963, 13.0649930, 0.0, 0.0009, -0.0047),
        (276.617, 0.3287146, 0.0, 0.0, -0.0046),
        (34.226, 1.7484877, 0.0, 0.0, 0.0028),
        (15.134, -0.1589763, -0.0052, 0.0008, 0.0052),
        (119.743, 0.0036096, 0.0, 0.0, 0.0040),
        (239.961, 0.1643573, 0.0, 0.0, 0.0019),
        (25.053, 12.9590088, 0.0043, -0.0009, -0.0044),
    ]
)


def lunar_axes(days: float) -> FloatArray:
    """Axes of the Moon in the frame of the sky (ICRF), rows x (mean Earth), y, z (pole). (3, 3) [-]

    `days` are those of TDB since J2000. Within a few arc minutes of an ephemeris: Archinal et al. (2018),
    10.1007/s10569-017-9805-5.
    """
    start, rate, ascension, declination, meridian = _LUNAR_TERMS.T
    argument = np.radians(start + rate * days)
    sines, cosines = np.sin(argument), np.cos(argument)
    centuries = days / 36525.0
    pole = math.radians(269.9949 + 0.0031 * centuries + float(ascension @ sines))
    height = math.radians(66.5392 + 0.0130 * centuries + float(declination @ cosines))
    spin = math.radians(38.3213 + 13.17635815 * days - 1.4e-12 * days**2 + float(meridian @ sines))
    z = np.array([math.cos(height) * math.cos(pole), math.cos(height) * math.sin(pole), math.sin(height)])
    node = np.array([-math.sin(pole), math.cos(pole), 0.0])
    x = math.cos(spin) * node + math.sin(spin) * np.cross(z, node)
    return np.array([x, np.cross(z, x), z])


def _terrestrial_time(time: datetime) -> tuple[float, float]:
    """TT as a Julian date in two parts.

    Raises ParameterError for a time without time zone, or outside 1950-2099, where the Moon's series was tested.
    """
    if time.utcoffset() is None:
        raise ParameterError(f"time {time.isoformat()} has no time zone; state that it is UTC")
    if not _FIRST <= time < _END:
        raise ParameterError(
            f"time {time.isoformat()} is outside 1950-2099, where the distance is known; check the year"
        )
    import erfa  # type: ignore[import-untyped]

    with warnings.catch_warnings():
        # Years beyond ERFA's table of leap seconds are "dubious" to it.
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        utc = (_J2000_JD, (time - _J2000).total_seconds() / _SECONDS_PER_DAY)
        jd, day = erfa.taitt(*erfa.utctai(*utc))
    return float(jd), float(day)


def sun_from_moon_au(time: datetime, light_time_s: float = 0.0) -> FloatArray:
    """From the Moon's centre at `time` to where the Sun's centre was `light_time_s` earlier, in the ICRF. (3,) [AU]

    Raises ParameterError for a time without time zone or outside 1950-2099.
    Source: Earth, Moisson & Bretagnon (2001), Celest. Mech. Dyn. Astron. 80, 205; Moon, Meeus (1998), Astronomical
    Algorithms, 2nd ed., p. 337; both as in ERFA (epv00, moon98), which comes with astropy.
    """
    # astropy's own Time and coordinates give the same numbers, and take 0.4 s to import where this takes 0.01 s.
    import erfa

    jd, day = _terrestrial_time(time)
    _, earth = erfa.epv00(jd, day)
    earth_from_sun_then, earth_then = erfa.epv00(jd, day - light_time_s / _SECONDS_PER_DAY)
    moon = earth["p"] + erfa.moon98(jd, day)["p"]
    sun_au: FloatArray = earth_then["p"] - earth_from_sun_then["p"] - moon
    return sun_au


def sun_in_moon_frame(time: datetime) -> FloatArray:
    """Unit vector from the Moon's centre to the Sun in the mean-Earth frame. (3,) [-]

    Aberration (20 arc seconds) is left out. Raises ParameterError as `sun_from_moon_au`.
    """
    toward, (jd, day) = sun_from_moon_au(time), _terrestrial_time(time)
    sun: FloatArray = lunar_axes(jd - _J2000_JD + day) @ (toward / np.linalg.norm(toward))
    return sun


def upward(longitude_deg: float, latitude_deg: float) -> FloatArray:
    """Unit vector away from the Moon's centre at a place, in the mean-Earth frame; so of any angle from x towards y and
    angle above this plane. (3,) [-]"""
    lon, lat = math.radians(longitude_deg), math.radians(latitude_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


def sun_incidence_deg(time: datetime, longitude_deg: float, latitude_deg: float) -> float:
    """Angle between the Sun and the vertical of a place on a spherical Moon; 0 to 180. [deg]

    Parameters
    ----------
    time : aware of its time zone. longitude_deg, latitude_deg : east, mean-Earth frame. [deg]

    Raises ParameterError as `sun_from_moon_au`.
    """
    cosine = float(upward(longitude_deg, latitude_deg) @ sun_in_moon_frame(time))
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
