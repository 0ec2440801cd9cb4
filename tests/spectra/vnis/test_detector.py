"""Reflectance factor against numbers worked by hand, and limits; the file of channel factors and ways to spoil it."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.vnis.detector import read_channel_factors, reflectance_factor

VNIR = [str(450 + 5 * k) for k in range(100)]
SWIR = [str(900 + 5 * k) for k in range(300)]


# -- Reflectance factor -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("incidence", [0.0, 30.0, 64.412, 89.9])
@pytest.mark.parametrize("distance", [0.9806, 1.0, 1.0203])
def test_a_white_diffuse_surface_has_a_reflectance_factor_of_1(incidence: float, distance: float) -> None:
    irradiance = np.linspace(2.1, 0.05, 300)
    radiance = irradiance * math.cos(math.radians(incidence)) / (math.pi * distance**2)
    assert reflectance_factor(radiance, irradiance, incidence, distance) == pytest.approx(np.ones(300), rel=1e-12)


@pytest.mark.reference
def test_observation_136_of_chang_e_4_worked_by_hand(reference_data: Path) -> None:
    """Short-wave channel at 900 nm, 2020-07-16: L = 8.61323e-3, i = 64.445082 deg, d = 1.014822 AU, E0 = 0.889708.

    pi L = 0.02705926; d^2 = 1.02986369, product 0.02786735; cos i = 0.43137603, times E0 0.38379870;
    0.02786735 / 0.38379870 = 0.07260929. (With ASTM E490 in the channel, E0 = 0.915526, it is 0.0705617.)
    """
    with (reference_data / "vnis" / "vnis_swir_wl_fwhm_solar.csv").open() as file:
        first = next(csv.DictReader(file))
    assert float(first["wavelength_nm"]) == 900
    irradiance = np.array([float(first["solar_irradiance_W_m-2_nm-1_1AU"])])
    found = reflectance_factor(np.array([8.61323e-3]), irradiance, 64.445082, 1.014822)
    assert found[0] == pytest.approx(0.07260929, rel=1e-7)


def test_round_numbers() -> None:
    """pi 0.1 2^2 / (pi cos 60) = 0.8."""
    assert reflectance_factor(np.array([0.1]), np.array([math.pi]), 60.0, 2.0)[0] == pytest.approx(0.8, rel=1e-15)


def test_it_follows_radiance_distance_irradiance_and_incidence() -> None:
    one = reflectance_factor(np.array([0.02]), np.array([1.0]), 60.0, 1.0)[0]
    assert reflectance_factor(np.array([0.04]), np.array([1.0]), 60.0, 1.0)[0] == pytest.approx(2 * one)
    assert reflectance_factor(np.array([0.02]), np.array([2.0]), 60.0, 1.0)[0] == pytest.approx(one / 2)
    assert reflectance_factor(np.array([0.02]), np.array([1.0]), 60.0, 1.1)[0] == pytest.approx(1.21 * one)
    assert reflectance_factor(np.array([0.02]), np.array([1.0]), 0.0, 1.0)[0] == pytest.approx(one / 2)


def test_limits_of_radiance() -> None:
    """No light is 0, a missing number stays missing, and towards the horizon the factor grows as 1 / cos i."""
    radiance = np.array([0.0, np.nan, -0.01, 0.02])
    found = reflectance_factor(radiance, np.ones(4), 45.0, 1.0)
    assert found[0] == 0
    assert np.isnan(found[1])
    assert found[2] == pytest.approx(-found[3] / 2)
    low = reflectance_factor(np.array([1.0]), np.array([1.0]), 89.999, 1.0)[0]
    assert low == pytest.approx(math.pi / math.radians(0.001), rel=1e-6)


def test_shapes_broadcast() -> None:
    radiance = np.full((4, 5, 3), 0.1)
    assert reflectance_factor(radiance, np.array([1.0, 2.0, 4.0]), 0.0, 1.0).shape == (4, 5, 3)


@pytest.mark.parametrize("incidence", [-0.1, 90.0, 120.0, math.nan])
def test_a_sun_that_does_not_shine_is_refused(incidence: float) -> None:
    with pytest.raises(ParameterError, match=r"incidence is .*; give 0 or more, below 90"):
        reflectance_factor(np.array([0.1]), np.array([1.0]), incidence, 1.0)


@pytest.mark.parametrize(
    ("irradiance", "distance"), [(0.0, 1.0), (-1.0, 1.0), (math.nan, 1.0), (1.0, 0.0), (1.0, -1.0), (1.0, math.nan)]
)
def test_no_irradiance_or_distance_is_refused(irradiance: float, distance: float) -> None:
    with pytest.raises(ParameterError, match="give a number above 0"):
        reflectance_factor(np.array([0.1]), np.array([irradiance]), 30.0, distance)


# -- Channel factors --------------------------------------------------------------------------------------------------

Rows = list[list[str]]


def table() -> Rows:
    """Header, then factor 0.9 + 0.001 k of VNIR and 1.1 - 0.0005 k of SWIR channel k."""
    rows = [["detector", "wavelength_nm", "factor"]]
    rows += [["vnir", wavelength, f"{0.9 + 0.001 * k:.4f}"] for k, wavelength in enumerate(VNIR)]
    return rows + [["swir", wavelength, f"{1.1 - 0.0005 * k:.4f}"] for k, wavelength in enumerate(SWIR)]


def source(rows: Rows) -> InputFile:
    return InputFile("factors.csv", "".join(",".join(row) + "\n" for row in rows).encode())


def test_factors_are_read_in_the_order_of_the_channels() -> None:
    rows = table()
    shuffled = [rows[0], *sorted(rows[1:], key=lambda row: row[2])]
    for made in (rows, shuffled):
        factors = read_channel_factors(source(made))
        assert factors.source == "factors.csv"
        assert factors.vnir == pytest.approx(0.9 + 0.001 * np.arange(100))
        assert factors.swir == pytest.approx(1.1 - 0.0005 * np.arange(300), abs=5.1e-5)


def test_comments_capitals_blanks_and_more_columns_do_no_harm() -> None:
    rows = [[row[0].upper() if k else row[0], f" {row[1]}" if k else row[1], row[2]] for k, row in enumerate(table())]
    rows = [[*row, "note"] for row in rows]
    made = source([["# from the calibration of lunar day 6"], *rows])
    assert read_channel_factors(made).swir[0] == pytest.approx(1.1)


@pytest.mark.reference
def test_the_published_factors_are_taken(reference_data: Path) -> None:
    rows = [["detector", "wavelength_nm", "factor"]]
    for name, detector in (("cmos", "vnir"), ("swir", "swir")):
        with (reference_data / "vnis" / f"vnis_{name}_wl_fwhm_solar.csv").open() as file:
            rows += [[detector, r["wavelength_nm"], r["cal_factor_before_lunar_day7"]] for r in csv.DictReader(file)]
    factors = read_channel_factors(source(rows))
    assert (factors.vnir[0], factors.swir[0]) == (0.944689, 0.871318)
    assert min(factors.vnir.min(), factors.swir.min()) > 0.8


def put(line: int, column: int, text: str) -> Callable[[Rows], Rows]:
    """`line` as an editor counts them, the header being line 1."""
    return lambda rows: [
        [text if (n, c) == (line, column) else cell for c, cell in enumerate(row)] for n, row in enumerate(rows, 1)
    ]


SPOILED: dict[str, tuple[Callable[[Rows], Rows], str]] = {
    "no factor": (lambda rows: [row[:2] for row in rows], "no column 'factor'"),
    "no wavelength": (put(1, 1, "wave"), "no column 'wavelength_nm'"),
    "nothing but a header": (lambda rows: rows[:1], "0 rows below the header"),
    "another detector": (put(7, 0, "cmos"), "line 7, column 'detector': 'cmos'; the detector is vnir or swir"),
    "no detector": (put(7, 0, ""), "line 7, column 'detector': ''"),
    "a word": (put(9, 2, "one"), "line 9, column 'factor': 'one' is not a number"),
    "a wavelength in words": (put(9, 1, "red"), "line 9, column 'wavelength_nm': 'red' is not a number"),
    "a short row": (
        lambda rows: [row[:2] if n == 8 else row for n, row in enumerate(rows)],
        "line 9 has 2 fields",
    ),
    "a factor of 0": (put(4, 2, "0"), r"line 4, column 'factor': '0'; factors are numbers above 0"),
    "not a number": (put(4, 2, "nan"), "line 4, column 'factor': 'nan'; factors are numbers"),
    "twice": (put(5, 1, "460"), "vnir has 100 channels, 100 are given and 465 nm is missing"),
    "a channel left out": (lambda rows: rows[:50] + rows[51:], "vnir has 100 channels, 99 are given and 695 nm is m"),
    "swir left out": (lambda rows: rows[:101], "swir has 300 channels, 0 are given and 900 nm is missing"),
    "a channel too many": (
        lambda rows: [*rows, ["vnir", "950", "1.0"]],
        "vnir has 100 channels, 101 are given and there are others",
    ),
}


@pytest.mark.parametrize("case", SPOILED)
def test_spoiled_factors_are_refused_with_their_own_line(case: str) -> None:
    spoil, message = SPOILED[case]
    with pytest.raises(DataError, match=message) as caught:
        read_channel_factors(source(spoil(table())))
    text = str(caught.value)
    assert text.startswith("factors.csv: ")
    assert "\n" not in text


def test_binary_factors_are_refused() -> None:
    with pytest.raises(DataError, match="binary file"):
        read_channel_factors(InputFile("factors.csv", bytes(range(256)) * 20))
