"""Ejecta laws against the thicknesses and speeds computed for the Chang'E-4 site in the project's notes."""

import math

import pytest

from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.catalogue import distance_km, embedded_catalogue
from lunarsci.spectra.origin.prior import (
    CHANG_E_4,
    LAWS,
    ejecta_thickness_m,
    launch_speed_m_s,
    local_to_ejecta_ratio,
    transient_radius_km,
)

TABLE = {
    "Zhinyu": (214, 0.0078, 0.0049, 0.016),
    "Finsen": (417, 9.3, 2.7, 19),
    "Von Kármán L": (297, 3.4, 1.2, 7.0),
    "Alder": (417, 11, 3.2, 22),
    "Maksutov": (674, 1.09, 0.31, 2.2),
    "Davisson": (612, 2.5, 0.7, 5.2),
    "Antoniadi": (968, 0.57, 0.14, 1.2),
    "Leibnitz": (470, 128, 29, 257),
}
"""Launch speed [m/s] and thickness [m] at the site after Pike, McGetchin, Xie, computed from the transient radius."""
CRATERS = {crater.name: crater for crater in embedded_catalogue()}


@pytest.mark.parametrize("name", TABLE)
def test_thickness_and_speed_at_the_site(name: str) -> None:
    crater = CRATERS[name]
    distance = distance_km(CHANG_E_4, crater.center)
    speed, *thickness = TABLE[name]
    for law, expected in zip(("pike", "mcgetchin", "xie"), thickness, strict=True):
        assert ejecta_thickness_m(law, crater.diameter_km, distance) == pytest.approx(expected, rel=0.05), law
    assert launch_speed_m_s(crater.diameter_km, distance) == pytest.approx(speed, rel=0.01)


def test_mass_alone_prefers_finsen_twelve_hundred_times() -> None:
    zhinyu, finsen = (
        ejecta_thickness_m("pike", CRATERS[n].diameter_km, distance_km(CHANG_E_4, CRATERS[n].center))
        for n in ("Zhinyu", "Finsen")
    )
    assert finsen / zhinyu == pytest.approx(1200, rel=0.03)


def test_housen_by_hand() -> None:
    """A crater whose transient radius is 10 km, seen from 100 km: 0.0078 x 10000 x 10^-2.61."""
    diameter = (20 / 18.7**0.15) ** (1 / 0.85)
    assert transient_radius_km(diameter) == pytest.approx(10)
    assert ejecta_thickness_m("housen", diameter, 100) == pytest.approx(78 * 10**-2.61)


def test_transient_craters() -> None:
    assert transient_radius_km(10) == pytest.approx(4.2)
    assert transient_radius_km(18.7) == pytest.approx(18.7 / 2)
    assert transient_radius_km(73) == pytest.approx(29.75, abs=0.02)


@pytest.mark.parametrize("law", LAWS)
def test_there_is_no_blanket_within_the_rim_and_less_farther_out(law: str) -> None:
    assert ejecta_thickness_m(law, 73, 36) is None
    assert launch_speed_m_s(73, 36) is None
    steps = [ejecta_thickness_m(law, 73, km) for km in (37, 80, 200, 1000, math.pi * MOON_RADIUS_KM)]
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] > 0


def test_speed_on_a_flat_moon_and_to_the_antipode() -> None:
    """Near: v^2 = g x range at 45 deg; the farthest point takes the escape speed, 2374 m/s with g 1.622."""
    assert launch_speed_m_s(0.001, 1.0) == pytest.approx(math.sqrt(1.622 * 1000), rel=1e-3)
    escape = math.sqrt(2 * 1.622 * 1737400)
    assert launch_speed_m_s(0.001, math.pi * MOON_RADIUS_KM) == pytest.approx(escape, rel=1e-4)


def test_stirred_ground_grows_with_distance() -> None:
    assert local_to_ejecta_ratio(1.0) == pytest.approx(0.0183)
    assert local_to_ejecta_ratio(100.0) / local_to_ejecta_ratio(10.0) == pytest.approx(10**0.87)


@pytest.mark.parametrize("diameter", [0, -3, float("nan"), float("inf")])
def test_impossible_diameters_are_refused(diameter: float) -> None:
    with pytest.raises(ParameterError, match="above 0"):
        transient_radius_km(diameter)


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(ParameterError, match="there are mcgetchin, pike, housen, xie"):
        ejecta_thickness_m("sharpton", 10, 100)  # type: ignore[arg-type]
