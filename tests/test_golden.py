"""What is true whatever the program: published numbers, each with its source, that no other test holds.

Others are where their subject is: K_s and N of the paper in `regolith/test_identify.py`, reflectance factors and
photometry in `spectra/vnis` and `spectra/test_photometry.py`, distances of the Sun in `spectra/test_solar.py`.
"""

import math
from datetime import UTC, datetime, timedelta

import erfa
import numpy as np
import pytest

from lunarsci.constants import LUNAR_GRAVITY, MOON_RADIUS_KM
from lunarsci.regolith.forces import signed_share
from lunarsci.sun import lunar_axes, sun_in_moon_frame

J2000_JD = 2451545.0
NUTATION_DAYS = 6798.38
"""In which the node of the Moon's orbit goes round once: 18.61 years."""


def test_gravity_is_that_of_the_moons_mass_and_radius() -> None:
    """GM = 4902.800 km3 s-2 of GRAIL (Konopliv et al. 2013, J. Geophys. Res. Planets 118, 1415, 10.1002/jgre.20097).

    From the highest to the lowest ground, +10.8 to -9.1 km (LOLA; Smith et al. 2017, 10.1016/j.icarus.2016.06.006), it
    goes with the distance from the centre.
    """
    middle, high, low = (4902.800e3 / (MOON_RADIUS_KM + height) ** 2 for height in (0.0, 10.8, -9.1))
    assert LUNAR_GRAVITY.value == pytest.approx(middle, abs=0.003)
    assert (
        LUNAR_GRAVITY.value - LUNAR_GRAVITY.uncertainty < high < low < LUNAR_GRAVITY.value + LUNAR_GRAVITY.uncertainty
    )


def test_the_mean_radius_is_that_of_the_altimeter() -> None:
    """1737.15 km, LOLA (Smith et al. 2017, Icarus 283, 70, 10.1016/j.icarus.2016.06.006); 1737.4 km by convention."""
    assert pytest.approx(1737.15, abs=0.3) == MOON_RADIUS_KM


def test_the_pole_leans_as_cassini_found() -> None:
    """1 deg 32 min 32.7 s from the pole of the ecliptic, on average (Seidelmann 1992, Explanatory Supplement to the
    Astronomical Almanac).

    It turns with the node of the orbit, so that its mean over 18.61 years is the pole of the ecliptic itself.
    """
    obliquity = math.radians(84381.406 / 3600)  # IAU 2006
    ecliptic = np.array([0.0, -math.sin(obliquity), math.cos(obliquity)])
    poles = np.array([lunar_axes(day)[2] for day in np.linspace(0.0, NUTATION_DAYS, 400, endpoint=False)])
    assert np.degrees(np.arccos(poles @ ecliptic)).mean() == pytest.approx(1.5424, abs=0.01)
    middle = poles.mean(axis=0)
    assert math.degrees(math.acos(middle @ ecliptic / np.linalg.norm(middle))) < 0.1


def test_the_moon_turns_once_in_a_sidereal_month() -> None:
    """27.321661 days (Explanatory Supplement to the Astronomical Almanac, 1992), over 55.8 years of them."""
    months = 3 * NUTATION_DAYS // 27.321661
    before, after = lunar_axes(0.0)[0], lunar_axes(months * 27.321661)[0]
    assert math.degrees(math.acos(before @ after)) < 0.1  # the last digit given is good to 0.005 deg; librations: 0.05


def test_the_near_side_looks_at_the_earth() -> None:
    """Librations are 0 on average, in longitude with the equation of the centre, in latitude with orbit and pole.

    6.2888 deg at the anomalistic month of 27.55455 days; 5.1281 + 1.5424 deg at the draconic one of 27.21222 days: the
    largest terms of the Moon's longitude and latitude (Meeus 1998, Astronomical Algorithms, tables 47.A, 47.B), and the
    lean of the pole. The Moon's place is that of ERFA, which knows nothing of how the Moon turns.
    """
    days = np.linspace(0.0, NUTATION_DAYS, 4001, endpoint=False)
    moons = erfa.moon98(J2000_JD, days)["p"]
    seen = np.array([lunar_axes(day) @ -moon / np.linalg.norm(moon) for day, moon in zip(days, moons, strict=True)])
    longitude, latitude = np.degrees(np.arctan2(seen[:, 1], seen[:, 0])), np.degrees(np.arcsin(seen[:, 2]))
    assert abs(longitude.mean()) < 0.05 and abs(latitude.mean()) < 0.05
    for angle, month, amplitude in ((longitude, 27.55455, 6.2888), (latitude, 27.21222, 5.1281 + 1.5424)):
        assert 2 * abs(np.mean(angle * np.exp(2j * np.pi * days / month))) == pytest.approx(amplitude, abs=0.02)


def test_the_sun_goes_round_in_a_synodic_month_and_stays_near_the_equator() -> None:
    """29.530589 days (Explanatory Supplement to the Astronomical Almanac, 1992).

    The Sun is in the ecliptic, from which the Moon's equator leans 1.54 deg, and
    as seen from the Moon never 0.01 deg off.
    """
    start = datetime(2000, 1, 1, tzinfo=UTC)
    days = np.arange(0.0, 19 * 365.2425, 4.0)
    suns = np.array([sun_in_moon_frame(start + timedelta(days=float(day))) for day in days])
    west = -np.unwrap(np.arctan2(suns[:, 1], suns[:, 0]))
    assert 2 * np.pi / np.polyfit(days, west, 1)[0] == pytest.approx(29.530589, abs=5e-4)
    assert np.degrees(np.abs(np.arcsin(suns[:, 2]))).max() == pytest.approx(1.5424, abs=0.05)


@pytest.mark.parametrize(("moduli", "share"), [(1.0, 0.632121), (2.302585, 0.9), (0.01, 0.00995017)])
def test_shear_strength_is_mobilised_as_by_janosi_and_hanamoto(moduli: float, share: float) -> None:
    """1 - exp(-j / K): 63.2 % at j = K, 90 % at K ln 10 (Wong 2008, Theory of Ground Vehicles, ch. 2), and odd in j."""
    assert signed_share(moduli * 0.0178, 0.9, 0.0178, 0) == pytest.approx(share, rel=1e-6)
    assert signed_share(-moduli * 0.0178, 0.9, 0.0178, 0) == pytest.approx(-share, rel=1e-6)
