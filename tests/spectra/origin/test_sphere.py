"""Distances and directions on the Moon, against geometry that needs no formula and the published table of the site."""

import numpy as np
import pytest

from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.catalogue import azimuth_deg, checked_point, destination, distance_km

SITE = (-45.44, 177.56)
HALF = np.pi * MOON_RADIUS_KM


@pytest.mark.parametrize(
    ("start", "end", "arc"),
    [
        ((0, 0), (0, 90), 0.5),
        ((90, 12), (-90, -77), 1.0),
        ((0, 10), (0, 10 + 180), 1.0),
        ((30, -170), (30, 190), 0.0),
        ((-45.44, 177.56), (45.44, -2.44), 1.0),
        ((60, 0), (0, 0), 1 / 3),
        ((0, 0), (0, 1e-7 / 1e3), 1e-10 / 180),
    ],
)
def test_arcs_that_are_known_without_a_formula(start: tuple, end: tuple, arc: float) -> None:
    assert distance_km(start, end) == pytest.approx(arc * HALF, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("crater", "km", "azimuth"),
    [
        ((-45.34, 176.15), 30.2, 275),
        ((-42.29, 182.28), 140.6, 49),
        ((-47.7, 177.9), 68.9, 174),
        ((-40.73, 191.39), 337, 70),
        ((-48.6, 182.6), 141.5, 134),
        ((-37.93, 185.03), 283, 39),
        ((-38.24, 179.49), 223, 12),
    ],
)
def test_craters_around_the_site(crater: tuple, km: float, azimuth: float) -> None:
    """Research notes on the site, computed independently."""
    assert distance_km(SITE, crater) == pytest.approx(km, abs=0.5)
    assert azimuth_deg(SITE, crater) == pytest.approx(azimuth, abs=0.6)


def test_azimuth_has_no_direction_at_the_same_point_and_the_antipode() -> None:
    assert azimuth_deg(SITE, SITE) is None
    assert azimuth_deg(SITE, (45.44, -2.44)) is None
    assert azimuth_deg((0, 0), (0, 1)) == pytest.approx(90)
    assert azimuth_deg((0, 0), (0, -1)) == pytest.approx(270)
    assert azimuth_deg((10, 350), (50, -10)) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("start", [SITE, (89.9, 10), (-90, 0), (0, 0)])
def test_going_somewhere_and_measuring_back(start: tuple) -> None:
    azimuth = np.linspace(5, 355, 15)
    for km in (0.5, 150.0, 3000.0):
        latitude, longitude = destination(start, azimuth, np.full(azimuth.shape, km))
        back = [distance_km(start, point) for point in zip(latitude, longitude, strict=True)]
        assert back == pytest.approx(np.full(azimuth.shape, km), rel=1e-6)
    if abs(start[0]) < 89:
        seen = [azimuth_deg(start, p) for p in zip(*destination(start, azimuth, 150.0), strict=True)]
        assert seen == pytest.approx(azimuth, abs=1e-5)


@pytest.mark.parametrize("point", [(95, 0), (-90.01, 0), (0, 361), (0, -181), (float("nan"), 0), (0, float("inf"))])
def test_points_off_the_moon_are_refused(point: tuple) -> None:
    with pytest.raises(ParameterError, match="it must be"):
        checked_point(*point)
