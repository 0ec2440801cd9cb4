"""Solar spectra: the tables against the standards, channel averages against quadrature, and what users' files hold."""

import csv
import itertools
import os
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid
from scipy.stats import norm

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.spectra.solar import (
    SOLAR_SPECTRA,
    SolarSpectrum,
    in_band_irradiance,
    solar_spectrum,
    sun_moon_distance_au,
    table_name,
)

TABLES = Path(__file__).parents[2] / "spectra_data"
FWHM_PER_SIGMA = 2.3548200450309493
PLANCK_NM = np.arange(400.0, 2601.0, 2.0)


def planck(wavelength_nm: np.ndarray) -> np.ndarray:
    """Blackbody of the Sun's radius at 1 AU: a smooth Sun. [W m-2 nm-1]

    Its 5860 K are more than the effective 5772 K: what the Sun lacks below 400 nm it has beyond.
    """
    metres = wavelength_nm * 1e-9
    radiance = 2 * 6.62607015e-34 * 299792458.0**2 / metres**5
    radiance /= np.expm1(6.62607015e-34 * 299792458.0 / (metres * 1.380649e-23 * 5860.0))
    return np.pi * radiance * (6.957e8 / 1.495978707e11) ** 2 * 1e-9


def solar(wavelength: np.ndarray, irradiance: np.ndarray) -> SolarSpectrum:
    return SolarSpectrum("made", wavelength, irradiance, "made up")


def vnis_channels(folder: Path, detector: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wavelength, FWHM and the in-band irradiance of another reduction. [nm, nm, W m-2 nm-1]"""
    with (folder / f"vnis/vnis_{detector}_wl_fwhm_solar.csv").open() as file:
        rows = list(csv.reader(file))[1:]
    wavelength, fwhm, irradiance, _ = np.array(rows, dtype=float).T
    return wavelength, fwhm, irradiance


def test_g173_is_the_table_of_pvlib() -> None:
    pvlib = pytest.importorskip("pvlib")
    theirs = pvlib.spectrum.get_reference_spectra()["extraterrestrial"]
    assert trapezoid(theirs, theirs.index) == pytest.approx(1347.93, abs=0.005)
    ours = solar_spectrum("g173")
    cut = theirs[(theirs.index >= 400) & (theirs.index <= 2600)]
    assert np.array_equal(ours.wavelength_nm, cut.index)
    assert np.array_equal(ours.irradiance, cut)


def test_e490_has_the_values_of_the_standard() -> None:
    spectrum = solar_spectrum("e490")
    # In the standard: um and W m-2 um-1.
    for wavelength, published in ((400.5, 1682), (409.5, 1715), (2382, 60.98), (2400, 59.44), (2500, 51.55)):
        at = np.flatnonzero(spectrum.wavelength_nm == wavelength)
        assert spectrum.irradiance[at] == pytest.approx([published / 1000], rel=1e-9)


def test_the_standards_differ_by_what_the_literature_says() -> None:
    channels = np.arange(450.0, 2396.0, 5.0)
    ratio = in_band_irradiance(solar_spectrum("g173"), channels, 5.0) / in_band_irradiance(
        solar_spectrum("e490"), channels, 5.0
    )
    assert ratio.mean() == pytest.approx(0.9976, abs=1e-4)
    assert ratio.std() == pytest.approx(0.006, abs=5e-4)
    assert np.abs(ratio - 1).max() < 0.04


@pytest.mark.parametrize("ask", [solar_spectrum, table_name])
def test_an_unknown_standard_lists_the_known(ask: Callable[[str], object]) -> None:
    with pytest.raises(ParameterError, match="choose one of g173, e490"):
        ask("kurucz")


@pytest.mark.parametrize(
    ("wavelength", "irradiance", "what"),
    [
        ([500.0], [1.0], "fewer than two"),
        ([500.0, 501.0], [1.0], "shapes"),
        ([500.0, np.nan], [1.0, 1.0], "not finite"),
        ([500.0, 501.0], [1.0, 0.0], "an irradiance is missing or not above 0"),
        ([500.0, 500.0], [1.0, 1.0], "ascending"),
        ([501.0, 500.0], [1.0, 1.0], "ascending"),
    ],
)
def test_a_spectrum_is_checked(wavelength: list[float], irradiance: list[float], what: str) -> None:
    with pytest.raises(DataError, match=f"^made: .*{what}"):
        solar(np.array(wavelength), np.array(irradiance))


def test_a_flat_spectrum_is_itself_and_a_linear_one_its_value_at_the_centre() -> None:
    grid = np.array([400.0, 401.0, 407.5, 420.0, 433.0, 470.0, 500.0])
    centers, widths = np.array([430.0, 441.3, 450.0]), np.array([2.4, 5.0, 9.6])
    with pytest.warns(LunarSciWarning, match="step"):
        assert in_band_irradiance(solar(grid, np.full(grid.size, 1.7)), centers, widths) == pytest.approx(
            1.7, rel=1e-12
        )
    with pytest.warns(LunarSciWarning, match="step"):
        found = in_band_irradiance(solar(grid, 0.3 + 0.002 * grid), centers, widths)
    assert found == pytest.approx(0.3 + 0.002 * centers, rel=1e-12)


@pytest.mark.parametrize("offset", [-4.0, -1.3, 0.0, 2.7])
def test_a_narrow_line_weighs_as_the_response_there(offset: float) -> None:
    fwhm, half_base = 5.0, 1e-3
    line = 700 + offset
    grid = np.unique(np.concatenate([np.arange(650.0, 751.0), [line - half_base, line, line + half_base]]))
    spectrum = solar(grid, 1.0 + np.where(grid == line, 1000.0, 0.0))
    # The triangle's area, 1000 * 1e-3, times the density of the response at the line.
    expected = 1 + norm.pdf(offset, scale=fwhm / FWHM_PER_SIGMA)
    assert in_band_irradiance(spectrum, 700.0, fwhm) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", SOLAR_SPECTRA)
@pytest.mark.parametrize(
    ("center", "fwhm"), [(450.0, 2.42), (850.0, 4.98), (1375.0, 8.31), (1875.0, 7.19), (2395.0, 9.6)]
)
def test_it_is_the_quadrature_over_the_broken_line(name: str, center: float, fwhm: float) -> None:
    spectrum = solar_spectrum(name)
    low, high = center - 3 * fwhm, center + 3 * fwhm
    inside = spectrum.wavelength_nm[(spectrum.wavelength_nm > low) & (spectrum.wavelength_nm < high)]

    def response(x: float) -> float:
        return 2.0 ** (-(((x - center) / (fwhm / 2)) ** 2))

    def weighted(x: float) -> float:
        return response(x) * float(np.interp(x, spectrum.wavelength_nm, spectrum.irradiance))

    pieces = list(itertools.pairwise([low, *inside, high]))
    above, below = (sum(quad(f, a, b)[0] for a, b in pieces) for f in (weighted, response))
    assert in_band_irradiance(spectrum, center, fwhm) == pytest.approx(above / below, rel=1e-9)


def test_shapes_broadcast() -> None:
    spectrum = solar_spectrum("g173")
    assert in_band_irradiance(spectrum, 700.0, 5.0).shape == ()
    assert in_band_irradiance(spectrum, [700.0, 800.0], 5.0).shape == (2,)
    both = in_band_irradiance(spectrum, [[700.0], [800.0]], [4.0, 5.0, 6.0])
    assert both.shape == (2, 3)
    assert both[1, 2] == in_band_irradiance(spectrum, 800.0, 6.0)
    assert in_band_irradiance(spectrum, [], []).shape == (0,)


@pytest.mark.parametrize(("center", "fwhm"), [(np.nan, 5.0), (700.0, 0.0), (700.0, -1.0), (np.inf, 5.0), (0.0, 5.0)])
def test_channels_that_are_none_are_refused(center: float, fwhm: float) -> None:
    with pytest.raises(ParameterError, match="finite and above 0"):
        in_band_irradiance(solar_spectrum("g173"), center, fwhm)


@pytest.mark.parametrize(("center", "needs"), [(410.0, "395-425"), (2590.0, "2575-2605")])
def test_a_response_beyond_the_table_is_refused(center: float, needs: str) -> None:
    with pytest.raises(ParameterError, match=f"covers 400-2600 nm, the channel at {center:g} nm needs {needs} nm"):
        in_band_irradiance(solar_spectrum("g173"), [700.0, center], 5.0)


def test_a_response_may_end_where_the_table_ends() -> None:
    spectrum = solar(np.arange(485.0, 516.0), np.full(31, 2.0))
    assert in_band_irradiance(spectrum, 500.0, 5.0) == pytest.approx(2.0)


def test_a_table_too_coarse_says_where() -> None:
    spectrum = solar(np.arange(400.0, 2601.0, 10.0), planck(np.arange(400.0, 2601.0, 10.0)))
    with pytest.warns(LunarSciWarning, match=r"step of 10 nm at 452 nm exceeds the channel's FWHM of 2.5 nm"):
        in_band_irradiance(spectrum, [700.0, 452.0, 900.0], [5.0, 2.5, 20.0])


@pytest.mark.reference
@pytest.mark.parametrize(
    ("name", "detector", "spread"),
    [("g173", "cmos", 0.0155), ("g173", "swir", 0.0106), ("e490", "cmos", 0.0172), ("e490", "swir", 0.0126)],
)
def test_vnis_channels_agree_with_another_reduction(
    reference_data: Path, name: str, detector: str, spread: float
) -> None:
    wavelength, fwhm, theirs = vnis_channels(reference_data, detector)
    ratio = theirs / in_band_irradiance(solar_spectrum(name), wavelength, fwhm)
    assert np.median(ratio) == pytest.approx(1, abs=0.01)
    assert ratio.std() == pytest.approx(spread, abs=2e-4)


@pytest.mark.reference
@pytest.mark.parametrize(("detector", "worst"), [("cmos", 0.071), ("swir", 0.051)])
def test_interpolation_is_no_substitute(reference_data: Path, detector: str, worst: float) -> None:
    wavelength, fwhm, _ = vnis_channels(reference_data, detector)
    spectrum = solar_spectrum("g173")
    naive = np.interp(wavelength, spectrum.wavelength_nm, spectrum.irradiance)
    off = np.abs(naive / in_band_irradiance(spectrum, wavelength, fwhm) - 1)
    assert off.max() == pytest.approx(worst, abs=1e-3)


def test_importing_it_loads_nothing_heavy() -> None:
    import subprocess
    import sys

    code = "import sys, lunarsci.spectra.solar; sys.exit(bool({'scipy', 'astropy', 'pandas'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


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
