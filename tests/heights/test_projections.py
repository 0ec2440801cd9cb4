"""Coordinate systems of maps, beside Snyder's formulas (1987, USGS Professional Paper 1395) worked out here."""

import math

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError

pytest.importorskip("rasterio")

from lunarsci.heights.projections import MapProjection, carried, local_projection, projection_of

MOON_M = 1_737_400.0
SOUTH = f"+proj=stere +lat_0=-90 +lon_0=0 +R={MOON_M} +units=m"
EQUATOR = f"+proj=eqc +lat_ts=0 +lon_0=0 +R={MOON_M} +units=m"


def wkt(text: str) -> str:
    from rasterio.crs import CRS

    return str(CRS.from_user_input(text).to_wkt())


@pytest.mark.parametrize(("lon", "lat"), [(0.0, -89.0), (30.0, -85.0), (-120.0, -80.5)])
def test_polar_stereographic_is_that_of_the_sphere(lon: float, lat: float) -> None:
    map_of = MapProjection(wkt(SOUTH))
    reach = 2.0 * MOON_M * math.tan(0.5 * math.radians(90.0 + lat))
    place = (reach * math.sin(math.radians(lon)), reach * math.cos(math.radians(lon)))
    assert map_of.metres(lon, lat)[0] == pytest.approx(place, abs=1e-3)
    assert map_of.lonlat(*place)[0] == pytest.approx((lon, lat), abs=1e-9)
    # At the south pole north points away from the middle; scale is 1 / cos^2 of half the distance from the pole.
    assert map_of.north_deg(*place) == pytest.approx(lon, abs=1e-4)
    scale = 1.0 / math.cos(0.5 * math.radians(90.0 + lat)) ** 2
    assert map_of.stretch(*place) == pytest.approx(1.0 - 1.0 / scale, rel=1e-3)


def test_equirectangular_is_radius_times_angle() -> None:
    map_of = MapProjection(wkt(EQUATOR))
    assert map_of.metres(23.473, 0.674)[0] == pytest.approx(MOON_M * np.radians([23.473, 0.674]), abs=1e-3)
    assert map_of.stretch(0.0, MOON_M * math.radians(60.0)) == pytest.approx(0.5, rel=1e-4)
    assert map_of.ellipsoid == (MOON_M, 0.0) and map_of.north_deg(1e5, 1e5) == pytest.approx(0.0, abs=1e-6)


def test_a_map_of_the_earth_has_its_ellipsoid_and_its_convergence() -> None:
    """UTM: scale 0.9996 on the middle meridian; convergence from tan g = tan(dlon) sin(lat), spherical, to 1 %."""
    map_of = MapProjection(wkt("EPSG:32633"))
    x, y = map_of.metres(15.0, 48.0)[0]
    assert (x, map_of.stretch(x, y)) == pytest.approx((500_000.0, 0.0004), rel=1e-3)
    x, y = map_of.metres(16.0, 48.0)[0]
    turned = -math.degrees(math.atan(math.tan(math.radians(1.0)) * math.sin(math.radians(48.0))))
    assert map_of.north_deg(x, y) == pytest.approx(turned, rel=0.01)


def test_a_pose_on_another_map_looks_the_same_way() -> None:
    """Seen from the south pole north is outwards, at 30 deg east 60 deg from x; east is 90 deg to the right of that."""
    x, y = MOON_M * np.radians([30.0, -85.0])
    reach = 2.0 * MOON_M * math.tan(math.radians(2.5))
    place = (reach * math.sin(math.radians(30.0)), reach * math.cos(math.radians(30.0)))
    for heading, there in ((90.0, 60.0), (0.0, -30.0)):
        found = carried(wkt(EQUATOR), wkt(SOUTH), x, y, heading)
        assert found == pytest.approx((*place, there), abs=1e-3)
        assert carried(wkt(SOUTH), wkt(EQUATOR), *found) == pytest.approx((x, y, heading), abs=1e-3)
    with pytest.raises(ParameterError, match="two bodies"):
        carried(wkt("EPSG:32633"), wkt(SOUTH), 5e5, 5e6, 0.0)


def test_a_local_map_is_about_the_middle_of_its_places() -> None:
    """Also across the longitude where counting begins anew; scale is 1 / cos^2 of half the distance."""
    local = local_projection(wkt(EQUATOR), MOON_M * np.radians([179.0, 181.0]), MOON_M * np.radians([40.0, 40.0]))
    assert np.abs(local.lonlat(0.0, 0.0)[0]) == pytest.approx((180.0, 40.0), abs=0.01)
    away = 2.0 * MOON_M * math.tan(math.radians(8.0))
    assert local.stretch(0.0, away) == pytest.approx(1.0 - math.cos(math.radians(8.0)) ** 2, rel=1e-3)
    assert local.north_deg(0.0, 0.0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "says"),
    [("+proj=longlat +R=1737400", "degrees"), ("EPSG:2263", "counts in"), ("none", "not a coord")],
)
def test_what_is_no_system_in_metres_is_refused(text: str, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        MapProjection(text)


def test_places_that_are_none_and_maps_without_a_system() -> None:
    for lon, lat in ((0.0, 91.0), (math.nan, 0.0), (400.0, 0.0)):
        with pytest.raises(ParameterError, match=r"a (longitude|latitude) is"):
            MapProjection(wkt(EQUATOR)).metres(lon, lat)
    with pytest.raises(ParameterError, match="no such place"):
        MapProjection(wkt("+proj=ortho +R=1737400 +units=m")).lonlat(2e6, 0.0)
    with pytest.raises(DataError, match=r"a\.npz names no coordinate system"):
        projection_of("", "a.npz")
