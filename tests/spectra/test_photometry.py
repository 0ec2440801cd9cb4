"""Angles, phase functions, disk functions, the correction to the standard geometry, and its spread between models."""

import csv
import math
import re
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.photometry import (
    DISKS,
    MCEWEN_PHASE_DEG,
    PHASE_FUNCTIONS,
    STANDARD,
    Geometry,
    SelenePhase,
    akimov,
    correction_factor,
    disk_function,
    henyey_greenstein,
    lommel_seeliger,
    mcewen,
    mcewen_weight,
    model_spread,
    outside,
    phase_function,
    read_phase_function,
    remarks,
    selene_phase,
)


@pytest.mark.parametrize("phase", [14.6, 105.4])
def test_half_a_degree_of_rounding_is_let_pass(phase: float) -> None:
    assert Geometry(60, 45, phase).phase_deg == phase


@pytest.mark.parametrize("phase", [14.4, 105.6])
def test_what_is_no_triangle_says_which_phases_are(phase: float) -> None:
    with pytest.raises(ParameterError, match=rf"phase angle {phase} deg .* incidence 60 and emission 45 .*15 to 105"):
        Geometry(60, 45, phase)


@pytest.mark.parametrize(
    ("angles", "message"),
    [
        ((90, 0, 90), "incidence angle 90 deg.*not lit"),
        ((-1, 0, 1), "incidence angle -1"),
        ((30, 90, 80), "emission angle 90"),
        ((30, 0, -0.2), "phase angle -0.2"),
        ((89, 89, 180), "phase angle 180"),
        ((math.nan, 0, 30), "incidence angle nan"),
        ((30, math.inf, 30), "emission angle inf"),
        ((30, 0, math.nan), "phase angle nan"),
    ],
)
def test_an_angle_out_of_range_is_named(angles: tuple[float, float, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Geometry(*angles)


def test_cosines() -> None:
    geometry = Geometry(60, 45, 90)
    assert geometry.cos_incidence == pytest.approx(0.5)
    assert geometry.cos_emission == pytest.approx(math.sqrt(0.5))


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


ANGLE = st.floats(0, 80)
SEEN = Geometry(60, 45, 90)


def seen_at(incidence: float, emission: float, azimuth: float) -> Geometry:
    """Geometry by the law of cosines; azimuth 0 is the observer on the Sun's side."""
    i, e = math.radians(incidence), math.radians(emission)
    cosine = math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(math.radians(azimuth))
    return Geometry(incidence, emission, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))))


def test_values_at_the_standard_geometry() -> None:
    # 0.866025 / 1.866025; cos 15 cos(180/150 * 15 = 18 deg); L = 1 - 0.57 + 0.2178 - 0.03942 = 0.60838
    assert lommel_seeliger(STANDARD) == pytest.approx(0.464102, abs=1e-6)
    assert akimov(STANDARD) == pytest.approx(0.91865, abs=1e-6)
    assert mcewen_weight(30) == pytest.approx(0.60838)
    assert mcewen(STANDARD) == pytest.approx(0.90385, abs=5e-6)


def test_values_at_60_45_90_by_hand() -> None:
    assert lommel_seeliger(SEEN) == pytest.approx(0.5 / (0.5 + 0.707107), abs=1e-6)
    # tan gamma = cos 60 / cos 45 = 1/sqrt 2; pi/(pi - g) = 2: cos(2 gamma - 90 deg) = sin 2 gamma = sqrt 2 / 1.5
    # = 0.942809; cos beta / cos gamma = mu (1 + tan^2 gamma) = 1.060660; times cos 45: D = 0.707107
    assert akimov(SEEN) == pytest.approx(math.sqrt(0.5), abs=1e-9)
    # L = 1 - 1.71 + 1.9602 - 1.06434 = 0.18586; 2 L 0.414214 + 0.81414 * 0.5 = 0.561041
    assert mcewen(SEEN) == pytest.approx(0.561041, abs=1e-6)


@pytest.mark.parametrize("name", DISKS)
@given(incidence=ANGLE, emission=ANGLE, azimuth=st.floats(0, 180))
def test_light_may_go_both_ways(name: str, incidence: float, emission: float, azimuth: float) -> None:
    there = seen_at(incidence, emission, azimuth)
    back = Geometry(emission, incidence, there.phase_deg)
    one, other = DISKS[name](there) / there.cos_incidence, DISKS[name](back) / back.cos_incidence
    assert one == pytest.approx(other, rel=1e-4)  # rounding of small phase angles


@pytest.mark.parametrize("name", DISKS)
@given(incidence=ANGLE, emission=ANGLE, azimuth=st.floats(0, 179))
def test_disks_are_positive_and_continuous(name: str, incidence: float, emission: float, azimuth: float) -> None:
    here, near = (DISKS[name](seen_at(incidence, emission, azimuth + step)) for step in (0, 1e-3))
    assert 0 < here < 2
    assert here == pytest.approx(near, rel=1e-3)


@pytest.mark.parametrize("angle", [0, 20, 45, 60, 80, 89])
def test_a_full_moon_is_equally_bright_everywhere(angle: float) -> None:
    assert akimov(Geometry(angle, angle, 0)) == 1
    assert mcewen(Geometry(angle, angle, 0)) == pytest.approx(1)
    assert lommel_seeliger(Geometry(angle, angle, 0)) == pytest.approx(0.5)


@pytest.mark.parametrize("phase", [0, 1e-12, 1e-6, 0.01])
def test_akimov_has_no_gap_at_small_phase(phase: float) -> None:
    assert akimov(Geometry(50, 50, phase)) == pytest.approx(1, abs=1e-3)
    assert akimov(Geometry(50, 50.3, phase)) == pytest.approx(akimov(Geometry(50, 50.3, 0.3)))


def test_akimov_on_the_photometric_equator() -> None:
    # beta = 0 and gamma = e in the plane of Sun and observer: cos(g/2) cos[pi/(pi - g) (e - g/2)] / cos e
    found = akimov(Geometry(50, 20, 70))
    stretch = 180 / 110 * (20 - 35)
    expected = math.cos(math.radians(35)) * math.cos(math.radians(stretch)) / math.cos(math.radians(20))
    assert found == pytest.approx(expected)


def test_lunar_lambert_is_lommel_seeliger_at_0_and_lambert_beyond_104_deg() -> None:
    assert mcewen(Geometry(30, 30, 0)) == pytest.approx(2 * lommel_seeliger(Geometry(30, 30, 0)))
    geometry = Geometry(70, 45, 110)
    assert mcewen(geometry) == pytest.approx(geometry.cos_incidence)


def test_where_the_polynomial_of_mcewen_goes_through_zero() -> None:
    # 1 - 0.019 * 103.9 + 2.42e-4 * 10795.21 - 1.46e-6 * 1121622.3 = 1 - 1.9741 + 2.61244 - 1.63757 = 0.0008
    assert mcewen_weight(MCEWEN_PHASE_DEG) == pytest.approx(0.0008, abs=1e-4)
    assert mcewen_weight(103.95) == 0
    assert all(mcewen_weight(a) > mcewen_weight(a + 1) >= 0 for a in range(103))


@pytest.mark.parametrize(
    ("name", "angles", "says"),
    [
        ("lommel-seeliger", (66, 45, 90), "6-7 %"),
        ("mcewen", (60, 45, 104.5), "103.9"),
        ("akimov", (60, 81, 90), "80 deg"),
        ("akimov", (81, 45, 90), "80 deg"),
    ],
)
def test_use_beyond_the_range_is_said(name: str, angles: tuple[float, float, float], says: str) -> None:
    assert says in outside(name, Geometry(*angles))


@pytest.mark.parametrize("name", DISKS)
def test_nothing_is_said_within(name: str) -> None:
    assert outside(name, SEEN) == ""


def test_unknown_disk_lists_the_known_ones() -> None:
    with pytest.raises(ParameterError, match=r"'lambert'.*lommel-seeliger, akimov, mcewen"):
        disk_function("lambert")
    with pytest.raises(ParameterError):
        outside("lambert", SEEN)


SELENE = ("sp-low", "sp-mid", "sp-high")
# f(90)/f(30) = exp(-0.3848) of the channel at 1499.8 nm of the middle group (B0 0.742, h 0.0657, c -0.251, G 0.185):
#   tan 45 = 1       : 1 + 0.742 / (1 + 15.2207) = 1.04574; lobes 0.965775 / 1.034225^1.5 = 0.918234
#   tan 15 = 0.267949: 1 + 0.742 / (1 + 4.07837) = 1.14611; lobes 0.965775 / 0.713796^1.5 = 1.601457
#                      and 0.965775 / 1.354654^1.5 = 0.612538, 0.6255 of the first and 0.3745 of the second = 1.231107
ONE_CHANNEL = 1.14611 * 1.231107 / (1.04574 * 0.918234)


@pytest.mark.parametrize("disk", DISKS)
@pytest.mark.parametrize("phase", PHASE_FUNCTIONS)
def test_the_standard_geometry_is_left_as_it_is(disk: str, phase: str) -> None:
    assert correction_factor(STANDARD, GRID, disk, phase_function(phase)) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("disk", "level", "published"),
    [
        ("lommel-seeliger", (0.5 + 0.707107) / (0.866025 + 1), 0.951),
        ("akimov", 0.5 / 0.866025 * 0.918650 / 0.707107, 1.102),
        ("mcewen", 0.5 / 0.866025 * 0.903853 / 0.561041, 1.367),
    ],
)
def test_factors_at_60_45_90_and_1500_nm_by_hand(disk: str, level: float, published: float) -> None:
    [flat] = correction_factor(SEEN, np.array([1500.0]), disk, phase_function("flat"))
    assert flat == pytest.approx(level, rel=1e-5)
    one = read_phase_function(InputFile("one.csv", f"phase_deg,f\n30,{ONE_CHANNEL:.6f}\n90,1\n".encode()))
    [exact] = correction_factor(SEEN, np.array([1500.0]), disk, one)
    assert exact == pytest.approx(published, abs=1e-3)
    [smoothed] = correction_factor(SEEN, np.array([1500.0]), disk, phase_function("sp-mid"))
    assert smoothed == pytest.approx(published, rel=0.012), "the channel lies 1.1 % off its neighbours' parabola"


def test_lommel_seeliger_for_reff_has_no_ratio_of_cosines_of_incidence() -> None:
    geometry = Geometry(75, 20, 80)
    expected = (math.cos(math.radians(75)) + math.cos(math.radians(20))) / (math.cos(math.radians(30)) + 1)
    assert correction_factor(geometry, GRID, "lommel-seeliger", phase_function("flat")) == pytest.approx(expected)


def test_a_lambertian_surface_is_left_as_it_is_where_mcewen_is_lambert() -> None:
    # REFF of Lambert's law is the same everywhere; above 104 deg McEwen's D is cos i, and at the standard 0.90385
    factor = correction_factor(Geometry(70, 45, 110), GRID, "mcewen", phase_function("flat"))
    assert factor == pytest.approx(0.903853 / 0.866025, rel=1e-5)


@pytest.mark.parametrize("disk", DISKS)
@settings(max_examples=40)
@given(
    incidence=st.floats(0, 85),
    emission=st.floats(0, 85),
    azimuth=st.floats(0, 180),
    phase=st.sampled_from(PHASE_FUNCTIONS),
)
def test_factors_are_positive_and_finite(
    disk: str, incidence: float, emission: float, azimuth: float, phase: str
) -> None:
    i, e = math.radians(incidence), math.radians(emission)
    cosine = math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(math.radians(azimuth))
    geometry = Geometry(incidence, emission, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))))
    factor = correction_factor(geometry, GRID[::30], disk, phase_function(phase))
    assert np.all(np.isfinite(factor)) and np.all(factor > 0)


def test_where_a_disk_function_vanishes_nothing_is_corrected() -> None:
    with pytest.raises(ParameterError, match=r"akimov vanishes at incidence 89\.995"):
        correction_factor(Geometry(89.995, 89.995, 179.5), GRID, "akimov", phase_function("flat"))


def test_unknown_disk() -> None:
    with pytest.raises(ParameterError, match="choose one of"):
        correction_factor(SEEN, GRID, "lambert", phase_function("flat"))


def test_remarks_join_disk_and_phase() -> None:
    grazing = Geometry(70, 45, 100)
    found = remarks(grazing, GRID, "lommel-seeliger", phase_function("sp-mid"))
    assert len(found) == 2
    assert "Lommel-Seeliger" in found[0]
    assert "sp-mid" in found[1] and "extrapolates" in found[1]
    assert remarks(Geometry(60, 45, 80), np.array([750.0]), "akimov", phase_function("sp-mid")) == []


def directly(geometry: Geometry, wavelength_nm: np.ndarray, disk: str, phase: str) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the nine models about the one used, and its leading modes by eigh."""
    used = correction_factor(geometry, wavelength_nm, disk, phase_function(phase))
    total = np.zeros((wavelength_nm.size, wavelength_nm.size))
    for other_disk in ("lommel-seeliger", "akimov", "mcewen"):
        for other_phase in SELENE:
            other = correction_factor(geometry, wavelength_nm, other_disk, phase_function(other_phase))
            total += np.outer(np.log(other / used), np.log(other / used)) / 9
    values, vectors = np.linalg.eigh(total)
    return total, (vectors * np.sqrt(np.maximum(values, 0)))[:, ::-1][:, :2].T


@pytest.mark.parametrize(("disk", "phase"), [("lommel-seeliger", "sp-mid"), ("akimov", "sp-high"), ("mcewen", "flat")])
@pytest.mark.parametrize("geometry", [SEEN, Geometry(64.4, 45.6, 54.5), Geometry(35, 10, 40)])
def test_modes_are_the_leading_eigenvectors(geometry: Geometry, disk: str, phase: str) -> None:
    wavelength = GRID[::20]
    total, expected = directly(geometry, wavelength, disk, phase)
    modes = model_spread(geometry, wavelength, disk, phase_function(phase))
    assert modes.shape == expected.shape
    for mode, other in zip(modes, expected, strict=True):
        assert mode == pytest.approx(other * np.sign(other @ mode), abs=1e-9)
        assert mode[np.argmax(np.abs(mode))] > 0
    assert np.sum(modes**2) > 0.99 * np.trace(total)


def test_the_spread_at_60_45_90_is_a_quarter_in_level_and_two_percent_in_colour() -> None:
    level, colour = model_spread(SEEN, GRID, "lommel-seeliger", phase_function("sp-mid"))
    assert np.all((level > 0.21) & (level < 0.26))
    assert 0.015 < np.abs(colour).max() < 0.03
    assert colour.min() < 0 < colour.max()


def test_at_one_wavelength_the_spread_is_the_rms_distance() -> None:
    wavelength = np.array([1500.0])
    [used] = correction_factor(SEEN, wavelength, "lommel-seeliger", phase_function("sp-mid"))
    squares = [
        math.log(correction_factor(SEEN, wavelength, disk, phase_function(name))[0] / used) ** 2
        for disk in DISKS
        for name in SELENE
    ]
    [[mode]] = model_spread(SEEN, wavelength, "lommel-seeliger", phase_function("sp-mid"))
    assert mode == pytest.approx(math.sqrt(sum(squares) / 9))


def test_models_agree_at_the_standard_geometry() -> None:
    assert model_spread(STANDARD, GRID, "mcewen", phase_function("sp-low")).shape == (0, 390)


def test_spread_does_not_depend_on_the_sampling() -> None:
    fine = model_spread(SEEN, GRID, "akimov", phase_function("sp-mid"))
    coarse = model_spread(SEEN, GRID[::2], "akimov", phase_function("sp-mid"))
    assert fine[:, ::2] == pytest.approx(coarse, abs=2e-3)
