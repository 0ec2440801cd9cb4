"""Shadows beside those of geometry, and of a slow search along every ray."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, gaussian_filter, map_coordinates

from lunarsci.errors import ParameterError
from lunarsci.twin.ground.illumination import SunDirection, parse_sun, sun_over, sunlit
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain

SPACING = 0.05


def ground(height_of, soil, half_m: float = 5.0) -> Terrain:  # type: ignore[no-untyped-def]
    axis = np.arange(-half_m, half_m + 1e-9, SPACING)
    height = height_of(*np.meshgrid(axis, axis))
    return build_terrain("test", -half_m, -half_m, SPACING, height, soil, synthetic=True)


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 45.0, 90.0, 141.0, 180.0, 233.0, 270.0, -60.0])
@pytest.mark.parametrize("elevation", [8.0, 25.0])
def test_a_wall_has_a_shadow_as_long_as_its_height_over_the_tangent(longji_soil, azimuth, elevation) -> None:  # type: ignore[no-untyped-def]
    """A wall square to the Sun, 0.4 m high, 0.2 m wide, from edge to edge."""
    away = -SunDirection(azimuth, 0.0).vector[:2]

    def past(x, y):  # type: ignore[no-untyped-def]
        return away[0] * x + away[1] * y

    terrain = ground(lambda x, y: np.where(np.abs(past(x, y)) <= 0.1, 0.4, 0.0), longji_soil)
    x, y = np.meshgrid(terrain.x_m, terrain.y_m)
    behind, across = past(x, y) - 0.1, np.abs(away[0] * y - away[1] * x)
    end = 0.4 / math.tan(math.radians(elevation))
    seen = sunlit(terrain, azimuth, elevation)[across < 1.5]
    behind = behind[across < 1.5]
    margin = 2.0 * SPACING
    assert not seen[(behind > margin) & (behind < end - margin)].any()
    assert seen[(behind > end + margin) | (behind < -0.2 - margin)].all()


@pytest.mark.parametrize("azimuth", [15.0, 100.0, 205.0, 320.0])
def test_the_shadow_of_a_cone_is_between_the_tangents_from_that_of_its_tip(longji_soil, azimuth) -> None:  # type: ignore[no-untyped-def]
    """Height 0.8 m, radius 1 m, the Sun 12 deg high: a ray grazes the cone where its normal is square to the Sun."""
    tall, radius, elevation = 0.8, 1.0, 12.0
    terrain = ground(lambda x, y: np.maximum(0.0, tall * (1.0 - np.hypot(x, y) / radius)), longji_soil)
    x, y = np.meshgrid(terrain.x_m, terrain.y_m)
    away = -SunDirection(azimuth, 0.0).vector[:2]
    along, across = away[0] * x + away[1] * y, away[0] * y - away[1] * x
    tip = tall / math.tan(math.radians(elevation))
    # Tangents from (tip, 0) to the circle touch it at the angle whose cosine is radius / tip.
    touch = math.acos(radius / tip)
    inside = math.cos(touch) * along + math.sin(touch) * np.abs(across)
    level = np.hypot(x, y) > radius + 2 * SPACING
    dark = level & (inside < radius - 2 * SPACING) & (along > radius * math.cos(touch))
    lit = level & ((inside > radius + 2 * SPACING) | (along < radius * math.cos(touch) - 2 * SPACING))
    found = sunlit(terrain, azimuth, elevation)
    assert dark.sum() > 300 and not found[dark].any()
    assert lit.sum() > 3000 and found[lit].all()
    # On the cone itself: lit where the surface faces the Sun.
    slope, cos = tall / radius, along / np.maximum(np.hypot(x, y), 1e-9)
    facing = math.sin(math.radians(elevation)) - slope * cos * math.cos(math.radians(elevation))
    own = (np.hypot(x, y) < radius - 2 * SPACING) & (np.hypot(x, y) > 6 * SPACING)
    assert found[own & (facing > 0.1)].all() and not found[own & (facing < -0.1)].any()


@pytest.mark.parametrize("azimuth", [0.0, 30.0, 77.0, 198.0])
def test_a_plane_is_lit_where_the_sun_stands_over_it_and_dark_where_below(longji_soil, azimuth) -> None:  # type: ignore[no-untyped-def]
    """Tilted by 10 deg away from the Sun."""
    tilt, sun = math.tan(math.radians(10.0)), SunDirection(azimuth, 0.0).vector
    plane = ground(lambda x, y: tilt * (sun[0] * x + sun[1] * y), longji_soil, 2.0)
    assert sunlit(plane, azimuth, 10.5).all()
    # The first rows have no ground before them that could hide the Sun.
    dark = sunlit(plane, azimuth, 9.5)
    assert not dark[2:-2, 2:-2].any()


def test_random_ground_is_as_a_search_along_every_ray_has_it(longji_soil) -> None:  # type: ignore[no-untyped-def]
    """The reference walks from each node in steps of a quarter of a spacing over bilinear heights."""
    rng = np.random.default_rng(5)
    rough = gaussian_filter(rng.normal(size=(81, 81)), 3.0)
    terrain = dataclasses.replace(
        ground(lambda x, y: 0.0 * x, longji_soil, 2.0), height_m=(rough - rough.mean()) / rough.std() * 0.1
    )
    rows, columns = np.mgrid[:81, :81].astype(float)
    for azimuth, elevation in ((20.0, 12.0), (118.0, 20.0), (260.0, 6.0)):
        east, north, _ = SunDirection(azimuth, 0.0).vector
        fall, hidden = math.tan(math.radians(elevation)), np.zeros((81, 81), dtype=bool)
        for way in np.arange(0.25, 120.0, 0.25):
            at = [rows + way * north, columns + way * east]
            over = map_coordinates(terrain.height_m, at, order=1, mode="constant", cval=-np.inf)
            hidden |= over > terrain.height_m + way * SPACING * fall
        found = sunlit(terrain, azimuth, elevation)
        edge = binary_dilation(hidden, np.ones((3, 3))) & binary_dilation(~hidden, np.ones((3, 3)))
        assert 0.1 < hidden.mean() < 0.9
        assert (found == ~hidden).mean() > 0.97
        assert (found == ~hidden)[~edge].mean() > 0.999


def test_holes_are_dark_and_cast_no_shadow_and_nothing_is_lit_by_night(longji_soil) -> None:  # type: ignore[no-untyped-def]
    height = np.zeros((41, 41))
    height[:, 20] = np.nan
    terrain = dataclasses.replace(ground(lambda x, y: 0.0 * x, longji_soil, 1.0), height_m=height)
    assert (sunlit(terrain, 0.0, 5.0) == ~np.isnan(height)).all()
    for elevation in (0.0, -10.0):
        assert not sunlit(terrain, 0.0, elevation).any()
    assert (sunlit(terrain, 123.0, 90.0) == ~np.isnan(height)).all()


def test_directions_that_are_none_are_refused() -> None:
    terrain = synthetic_longji(rms_m=0.0)
    with pytest.raises(ParameterError, match=r"elevation_deg is 95; give -90 to 90"):
        sunlit(terrain, 0.0, 95.0)
    with pytest.raises(ParameterError, match="azimuth_deg is nan"):
        sunlit(terrain, math.nan, 10.0)
    assert parse_sun("30, 12") == SunDirection(30.0, 12.0)
    for text in ("30", "30,12,5", "north,12", ""):
        with pytest.raises(ParameterError, match="not AZIMUTH,ELEVATION"):
            parse_sun(text)


@pytest.mark.parametrize(
    ("time", "place", "altitude", "east_of_north"),
    [
        ("1969-07-20T20:17:39", (23.4333, 0.6875), 10.65, 88.81),
        ("1969-07-21T02:39:33", (23.4333, 0.6875), 13.84, 88.84),
        ("1969-07-21T17:54:00", (23.4333, 0.6875), 21.65, 88.91),
        ("1969-11-19T06:54:36", (-23.3856, -3.1975), 5.19, 91.16),
        ("1969-11-20T14:25:47", (-23.3856, -3.1975), 21.11, 90.33),
    ],
)
def test_the_sun_stands_where_it_stood_over_apollo(time, place, altitude, east_of_north) -> None:  # type: ignore[no-untyped-def]
    """Apollo Lunar Surface Journal, altitudes and azimuths of the Sun (Scotti, 2009), in part checked with Horizons."""
    sun = sun_over(time, *place)
    assert sun.elevation_deg == pytest.approx(altitude, abs=0.1)
    assert 90.0 - sun.azimuth_deg == pytest.approx(east_of_north, abs=0.1)
    assert parse_sun(f"{time}@{place[0]},{place[1]}") == sun


def test_by_night_the_sun_is_below_the_horizon_and_times_that_are_none_are_refused() -> None:
    """A full moon (2019-01-21) has its night on the far side."""
    assert sun_over("2019-01-21T05:16:00", 180.0, 0.0).elevation_deg < -85.0
    assert sun_over("2019-01-21T05:16:00", 0.0, 0.0).elevation_deg > 85.0
    for text, words in (
        ("noon@1,2", "is no time"),
        ("2019-01-03T02:26:00@177.6", "or TIME@LONGITUDE,LATITUDE"),
        ("2019-01-03T02:26:00@177.6,-95", "latitude is -95; give -90 to 90"),
    ):
        with pytest.raises(ParameterError, match=words):
            parse_sun(text)
