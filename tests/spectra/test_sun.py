"""The Sun-Moon distance against JPL Horizons, the geometry of the orbits, and a machine without network."""

import csv
import os
import subprocess
import sys
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.solar import sun_moon_distance_au

WITHOUT_NETWORK = """
import socket

def refuse(*arguments, **options):
    raise RuntimeError("a connection was asked for")

socket.socket = socket.create_connection = socket.getaddrinfo = refuse
from datetime import UTC, datetime
from lunarsci.spectra.solar import sun_moon_distance_au
for year in (1950, 2019, 2024, 2099):
    sun_moon_distance_au(datetime(year, 7, 1, tzinfo=UTC))
import sys
assert not {"astropy.time", "astropy.coordinates", "astropy.utils.iers"} & set(sys.modules)
"""


@pytest.mark.reference
def test_it_is_the_range_of_jpl_horizons(reference_data: Path) -> None:
    with (reference_data / "vnis/sun_moon_distance_daily_00h.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 2000
    times = [datetime.fromisoformat(row["date_utc"]).replace(tzinfo=UTC) for row in rows]
    expected = np.array([float(row["sun_moon_distance_au"]) for row in rows])
    found = np.array([sun_moon_distance_au(time) for time in times])
    assert np.max(np.abs(found - expected)) < 1.3e-7


@pytest.mark.parametrize(
    ("day", "horizons"),
    [((2019, 1, 4), 0.98086068), ((2019, 1, 6), 0.98062661), ((2024, 9, 30), 0.99918336), ((2024, 10, 1), 0.99867351)],
)
def test_some_days_of_jpl_horizons(day: tuple[int, int, int], horizons: float) -> None:
    assert sun_moon_distance_au(datetime(*day, tzinfo=UTC)) == pytest.approx(horizons, abs=1.3e-7)


def test_it_agrees_with_astropy_to_the_suns_motion_in_a_light_time() -> None:
    from astropy.coordinates import get_body_barycentric
    from astropy.time import Time

    for year in range(1975, 2025, 7):
        time = datetime(year, 5, 17, 6, 30, tzinfo=UTC)
        moon, sun = (get_body_barycentric(body, Time(time), ephemeris="builtin") for body in ("moon", "sun"))
        assert sun_moon_distance_au(time) == pytest.approx((moon - sun).norm().to_value("au"), abs=1e-7)


def test_it_stays_within_the_orbits_of_earth_and_moon() -> None:
    days = [datetime(1950, 1, 1, tzinfo=UTC) + timedelta(days=11.3 * k) for k in range(4840)]
    found = np.array([sun_moon_distance_au(day) for day in days])
    # The Earth's perihelion and aphelion, 0.9832 and 1.0167 AU, and the Moon's greatest distance, 406,700 km.
    assert 0.9832 - 0.00272 - 1e-4 < found.min() < 0.9832
    assert 1.0167 < found.max() < 1.0167 + 0.00272 + 1e-4


@pytest.mark.parametrize(
    ("time", "side"),
    [((2017, 8, 21, 18, 26), -1), ((2017, 8, 7, 18, 21), 1), ((2024, 4, 8, 18, 18), -1), ((2018, 7, 27, 20, 22), 1)],
    ids=["solar eclipse 2017", "lunar eclipse 2017", "solar eclipse 2024", "lunar eclipse 2018"],
)
def test_at_an_eclipse_the_moon_is_its_own_distance_off_the_earth(time: tuple[int, ...], side: int) -> None:
    moment = datetime(*time, tzinfo=UTC)  # type: ignore[misc]
    # Earth-Sun distance of the Astronomical Almanac's low-precision formulae, good to 1e-4 AU.
    days = (moment - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    anomaly = np.radians(357.528 + 0.9856003 * days)
    earth = 1.00014 - 0.01671 * np.cos(anomaly) - 0.00014 * np.cos(2 * anomaly)
    assert 0.0023 < side * (sun_moon_distance_au(moment) - earth) < 0.0028


def test_another_time_zone_gives_the_same_moment() -> None:
    beijing = datetime(2019, 1, 4, 8, tzinfo=timezone(timedelta(hours=8)))
    assert sun_moon_distance_au(beijing) == sun_moon_distance_au(datetime(2019, 1, 4, tzinfo=UTC))


def test_a_time_without_zone_is_refused() -> None:
    with pytest.raises(ParameterError, match="no time zone"):
        sun_moon_distance_au(datetime(2019, 1, 4))


@pytest.mark.parametrize(
    "time",
    [
        datetime(1949, 12, 31, 23, 59, tzinfo=UTC),
        datetime(2100, 1, 1, tzinfo=UTC),
        datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=14))),
        datetime(9999, 12, 31, 23, tzinfo=timezone(-timedelta(hours=12))),
    ],
    ids=str,
)
def test_years_out_of_range_are_refused(time: datetime) -> None:
    with pytest.raises(ParameterError, match="outside 1950-2099"):
        sun_moon_distance_au(time)


def test_it_needs_neither_network_nor_home(tmp_path: Path) -> None:
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", WITHOUT_NETWORK],
        env={**os.environ, **home},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []
