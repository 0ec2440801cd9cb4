"""Phase functions against limits, an independent slow formula, and published or separately fitted values."""

import csv
import math
import re
from importlib.resources import files

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.photometry import (
    PHASE_FUNCTIONS,
    SelenePhase,
    henyey_greenstein,
    phase_function,
    read_phase_function,
    selene_phase,
)

ROWS = list(csv.DictReader((files("lunarsci.spectra_data") / "selene_sp_phase.csv").read_text().splitlines()))
GROUPS = ("low", "mid", "high")
GRID = np.arange(450.0, 2396.0, 5.0)
# ln f(g)/f(30) of single channels of the middle group: c1 u + c2 u^2 + c3 u^3, u = (g - 30)/60, fitted once for
# 20-110 deg by other means, good to 0.007.
CUBICS = {
    512.6: (-0.7547, 0.2033, 0.1027),
    602.5: (-0.7199, 0.1884, 0.0864),
    698.6: (-0.6783, 0.1565, 0.0777),
    752.8: (-0.6620, 0.1463, 0.0777),
    902.7: (-0.6496, 0.1324, 0.1068),
    1003.6: (-0.6269, 0.1221, 0.0945),
    1252.0: (-0.5548, 0.0613, 0.0828),
    1499.8: (-0.5053, 0.0457, 0.0748),
    1644.2: (-0.4856, 0.0612, 0.0667),
    1797.6: (-0.4791, 0.1018, 0.0380),
    2053.3: (-0.4280, 0.1079, 0.0215),
}


def parameters(group: str, wavelength_nm: float) -> tuple[float, float, float, float]:
    [row] = [r for r in ROWS if r["group"] == group and float(r["wavelength_nm"]) == wavelength_nm]
    return float(row["b0"]), float(row["h"]), float(row["c"]), float(row["g"])


def slow_phase(phase_deg: float, b0: float, h: float, c: float, asymmetry: float) -> float:
    angle = math.radians(phase_deg)
    both = 0.0
    for lobe, weight in ((asymmetry, (1 - c) / 2), (-asymmetry, (1 + c) / 2)):
        both += weight * (1 - lobe**2) / (1 + lobe**2 - 2 * lobe * math.cos(angle)) ** 1.5
    return (1 + b0 / (1 + math.tan(angle / 2) / h)) * both


def slow_ratio(phase_deg: float, group: str, wavelength_nm: float) -> float:
    values = parameters(group, wavelength_nm)
    return math.log(slow_phase(phase_deg, *values) / slow_phase(30, *values))


def ratio(name: str, phase_deg: float, wavelength_nm: float) -> float:
    return float(phase_function(name).log_ratio(phase_deg, np.array([wavelength_nm]))[0])


def table(text: str) -> InputFile:
    return InputFile("mine.csv", text.encode())


def test_henyey_greenstein_limits() -> None:
    x = np.array([0.0, 0.3, -0.3])
    assert henyey_greenstein(0, x) == pytest.approx((1 + x) / (1 - x) ** 2)
    assert henyey_greenstein(180, x) == pytest.approx((1 - x) / (1 + x) ** 2)
    assert henyey_greenstein(90, x) == pytest.approx((1 - x**2) / (1 + x**2) ** 1.5)


@pytest.mark.parametrize("asymmetry", [0.0, 0.25, -0.6])
def test_henyey_greenstein_averages_to_1_over_the_sphere(asymmetry: float) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(60)
    values = [henyey_greenstein(math.degrees(math.acos(x)), np.array([asymmetry]))[0] for x in nodes]
    assert float(np.dot(weights, values)) / 2 == pytest.approx(1)


def test_without_lobes_and_surge_the_phase_function_is_1() -> None:
    one = np.ones(1)
    assert selene_phase(70, 0 * one, 0.05 * one, 0.3 * one, 0 * one) == pytest.approx(1)
    assert selene_phase(0, 1.2 * one, 0.05 * one, 0.3 * one, 0 * one) == pytest.approx(2.2)
    # at tan(g/2) = h the surge has half its height
    assert selene_phase(math.degrees(2 * math.atan(0.05)), 1.2 * one, 0.05 * one, one, 0 * one) == pytest.approx(1.6)


def test_the_table_is_whole() -> None:
    for group in GROUPS:
        wavelength = [float(row["wavelength_nm"]) for row in ROWS if row["group"] == group]
        assert len(wavelength) == 204
        assert (wavelength[0], wavelength[-1]) == (512.6, 2053.3)
        assert wavelength == sorted(set(wavelength))
    assert len(ROWS) == 612


@pytest.mark.parametrize(
    ("group", "wavelength_nm", "values"),
    [
        ("mid", 512.6, (1.723, 0.0351, 0.036, 0.254)),
        ("mid", 752.8, (1.211, 0.0596, -0.101, 0.217)),
        ("mid", 944.6, (1.124, 0.0433, 0.003, 0.238)),
        ("mid", 1051.7, (1.036, 0.0528, -0.066, 0.222)),
        ("mid", 1252.0, (0.877, 0.058, -0.221, 0.198)),
        ("mid", 1499.8, (0.742, 0.0657, -0.251, 0.185)),
        ("high", 752.8, (0.997, 0.0892, -0.253, 0.199)),
        ("high", 1499.8, (0.714, 0.1238, -0.308, 0.164)),
    ],
)
def test_rows_of_the_table(group: str, wavelength_nm: float, values: tuple[float, ...]) -> None:
    assert parameters(group, wavelength_nm) == values


def test_the_extension_of_the_middle_group_is_the_mean_of_the_others() -> None:
    beyond = sorted({float(row["wavelength_nm"]) for row in ROWS if float(row["wavelength_nm"]) > 1700})
    assert len(beyond) == 44
    for wavelength in beyond:
        low, mid, high = (parameters(group, wavelength) for group in GROUPS)
        assert mid[0] == pytest.approx((low[0] + high[0]) / 2, abs=1e-9)
        assert mid[3] == pytest.approx((low[3] + high[3]) / 2, abs=1e-9)


@pytest.mark.parametrize("wavelength_nm", CUBICS)
@pytest.mark.parametrize(("phase_deg", "tolerance"), [(20, 0.011), (45, 0.008), (60, 0.008), (75, 0.008), (90, 0.015)])
def test_middle_group_against_separate_fits(wavelength_nm: float, phase_deg: float, tolerance: float) -> None:
    u = (phase_deg - 30) / 60
    expected = sum(c * u**k for k, c in enumerate(CUBICS[wavelength_nm], 1))
    assert slow_ratio(phase_deg, "mid", wavelength_nm) == pytest.approx(expected, abs=0.0075)
    assert ratio("sp-mid", phase_deg, wavelength_nm) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize(("phase_deg", "rms"), [(10, 0.006), (60, 0.005), (85, 0.011), (110, 0.030)])
def test_smoothing_keeps_to_the_channels(group: str, phase_deg: float, rms: float) -> None:
    wavelength = np.array([float(row["wavelength_nm"]) for row in ROWS if row["group"] == group])
    exact = np.array([slow_ratio(phase_deg, group, w) for w in wavelength])
    smooth = phase_function(f"sp-{group}").log_ratio(phase_deg, wavelength)
    assert abs(np.mean(smooth - exact)) < 1e-9
    assert np.std(smooth - exact) < rms


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("phase_deg", [10, 60, 90, 110])
def test_nothing_of_the_channels_scatter_is_left(group: str, phase_deg: float) -> None:
    inner = GRID[(GRID > 513) & (GRID < 2053)]
    bend = np.diff(phase_function(f"sp-{group}").log_ratio(phase_deg, inner), 2)
    raw = [slow_ratio(phase_deg, group, float(row["wavelength_nm"])) for row in ROWS if row["group"] == group]
    assert np.all(bend * bend[0] >= -1e-20), "an inflection could pass for an absorption band"
    assert np.abs(bend).max() < 0.01 * np.std(np.diff(raw, 2))


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_the_ratio_is_0_at_30_deg_and_falls(name: str) -> None:
    found = phase_function(name)
    assert found.name == name
    assert found.log_ratio(30, GRID) == pytest.approx(0, abs=1e-12)
    steps = np.diff([found.log_ratio(angle, GRID) for angle in range(0, 80)], axis=0)
    assert np.all(steps < 0) or name == "flat"


@pytest.mark.parametrize("name", ["sp-low", "sp-mid", "sp-high"])
def test_phase_reddening(name: str) -> None:
    assert ratio(name, 60, 1500) > ratio(name, 60, 750) > ratio(name, 60, 550)


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_no_gap_at_zero_phase_and_none_at_the_far_end(name: str) -> None:
    found = phase_function(name)
    assert found.log_ratio(0, GRID) == pytest.approx(found.log_ratio(1e-9, GRID), abs=1e-6)
    assert np.all(np.isfinite(found.log_ratio(179.9, GRID)))


def test_the_edge_is_held_and_said() -> None:
    found = phase_function("sp-mid")
    outer = found.log_ratio(60, np.array([450.0, 512.6, 2053.3, 2395.0]))
    assert outer[0] == outer[1]
    assert outer[2] == outer[3]
    assert found.remark(60, GRID).endswith(
        "82 of 390 channels lie outside its 512.6-2053.3 nm, where the edge value is held"
    )
    assert "1 of 1 channel lies" in found.remark(60, np.array([450.0]))
    assert found.remark(60, np.array([600.0])) == ""


@pytest.mark.parametrize(("phase_deg", "says"), [(4.9, "extrapolates"), (86, "5-85 deg"), (113, "nothing checks it")])
def test_extrapolation_in_phase_is_said(phase_deg: float, says: str) -> None:
    assert says in phase_function("sp-high").remark(phase_deg, np.array([750.0]))


def test_flat_says_what_it_leaves() -> None:
    flat = phase_function("flat")
    assert flat.remark(30, GRID) == ""
    assert "60.0 deg" in flat.remark(60, GRID)


def test_selene_arrays_cannot_be_changed() -> None:
    found = phase_function("sp-mid")
    assert isinstance(found, SelenePhase)
    with pytest.raises(ValueError, match="read-only"):
        found.b0[0] = 1


def test_unknown_phase_function_lists_the_known_ones() -> None:
    with pytest.raises(ParameterError, match=r"'sp-medium'.*flat, sp-low, sp-mid, sp-high"):
        phase_function("sp-medium")


def test_a_table_for_all_wavelengths() -> None:
    found = read_phase_function(table("# mine\nphase_deg,f\n10,2.0\n30,1.0\n90,0.5\n"))
    assert (found.name, found.source) == ("mine", "mine.csv")
    assert found.log_ratio(90, GRID) == pytest.approx(math.log(0.5))
    assert found.log_ratio(60, GRID) == pytest.approx(math.log(0.5) / 2)  # linear in ln f
    assert found.log_ratio(30, GRID).shape == GRID.shape
    assert found.remark(60, GRID) == ""
    assert found.log_ratio(100, GRID) == pytest.approx(math.log(0.5))
    assert "10-90 deg; the edge value is held" in found.remark(100, GRID)


def test_the_scale_of_a_table_does_not_matter_and_30_deg_need_no_row() -> None:
    one = read_phase_function(table("phase_deg f\n20 4\n40 1\n90 0.5\n"))
    other = read_phase_function(table("phase_deg;f\n20;0,4\n40;0,1\n90;0,05\n"))
    assert one.log_ratio(70, GRID) == pytest.approx(other.log_ratio(70, GRID))
    assert one.log_ratio(30, GRID) == pytest.approx(0)
    assert one.log_ratio(40, GRID) == pytest.approx(-math.log(2))  # f(30) = sqrt(4 * 1)


def test_a_table_with_wavelengths() -> None:
    found = read_phase_function(table("phase_deg,750,1500\n30,1,2\n90,0.5,1.5\n"))
    expected = math.log(0.5), math.log(0.75)
    middle = sum(expected) / 2
    at = np.array([450, 750, 1125, 1500, 2000.0])
    assert found.log_ratio(90, at) == pytest.approx([expected[0], expected[0], middle, expected[1], expected[1]])
    assert "2 of 5 channels lie outside its 750-1500 nm" in found.remark(90, at)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("30,1\n60,0.5\n", "no column 'phase_deg' ('30', '1')"),
        ("angle,f\n30,1\n60,0.5\n", "no column 'phase_deg' ('angle', 'f')"),
        ("phase_deg,g\n30,1\n60,0.5\n", "columns (phase_deg, g) are no"),
        ("phase_deg,-5\n30,1\n60,0.5\n", "columns (phase_deg, -5) are no"),
        ("phase_deg,0.75,1.5\n30,1,1\n60,0.5,0.5\n", "columns (phase_deg, 0.75, 1.5) are no"),
        ("phase_deg,1500,750\n30,1,1\n60,0.5,0.5\n", "ascending wavelengths"),
        ("phase_deg,750,750\n30,1,1\n60,0.5,0.5\n", "two columns of one name"),
        ("phase_deg\n30\n60\n", "columns (phase_deg) are no"),
        ("phase_deg,f\n30,1\n", "1 rows below the header"),
        ("phase_deg,f\n", "0 rows below the header"),
        ("# nothing\n", "only comments"),
        ("phase_deg,f\n60,0.5\n30,1\n", "line 3, column 'phase_deg': '30'; phase angles ascend"),
        ("phase_deg,f\n30,1\n30,1\n60,1\n", "line 3, column 'phase_deg': '30'; phase angles ascend"),
        ("phase_deg,f\n40,1\n60,0.5\n", "runs from 40 to 60; it must contain 30"),
        ("phase_deg,f\n10,1\n20,0.5\n", "runs from 10 to 20; it must contain 30"),
        ("phase_deg,f\n30,1\n60,\n", "line 3, column 'f': "),
        ("phase_deg,f\n30,1\n60,nan\n", "line 3, column 'f': "),
        ("phase_deg,f\n30,1\n60,0\n", "line 3, column 'f': '0'; f is a number above 0"),
        ("phase_deg,f\n30,1\n60,-2\n", "'-2'; f is"),
        ("phase_deg,f\n30,1\n60,inf\n", "'inf'; f is"),
        ("phase_deg,f\n30,1\n60,half\n", "line 3, column 'f': 'half' is not a number"),
        ("phase_deg,f\n-1,1\n60,1\n", "line 2, column 'phase_deg': '-1'; phase angles lie"),
        ("phase_deg,f\n30,1\n180,1\n", "line 3, column 'phase_deg': '180'; phase"),
        ("phase_deg,f\n,1\n60,1\n", "line 2, column 'phase_deg': ''; phase"),
        ("phase_deg,f\n30,1\n60,1,2\n", "line 3 has 3 fields"),
    ],
)
def test_a_table_that_cannot_be_used(text: str, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)) as raised:
        read_phase_function(table(text))
    assert str(raised.value).startswith("mine.csv: ")
    assert "\n" not in str(raised.value)
