"""Disk functions against values worked by hand, reciprocity and limits."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry import (
    DISKS,
    MCEWEN_PHASE_DEG,
    STANDARD,
    Geometry,
    akimov,
    disk_function,
    lommel_seeliger,
    mcewen,
    mcewen_weight,
    outside,
)

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
