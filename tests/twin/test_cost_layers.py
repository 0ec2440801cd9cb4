"""Layers of costs and classes, shadow on the way, and what comes and goes as GeoJSON, beside plain geometry."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.hazards import parse_classes, read_cost_layer, read_keep_outs
from lunarsci.twin.ground.terrain import build_terrain, write_terrain
from lunarsci.twin.plans.path import planned_pose

AXIS = np.arange(-10.0, 10.05, 0.1)
MOON_M = 1_737_400.0
MOON = f"+proj=eqc +lat_ts=0 +lon_0=0 +R={MOON_M} +units=m"


def ground(folder: Path, height: np.ndarray | None = None) -> str:
    shape = (AXIS.size, AXIS.size)
    flat = np.zeros(shape) if height is None else height
    write_terrain(build_terrain("flat", -10.0, -10.0, 0.1, flat, read_soil("longji")), folder / "flat.npz")
    return str(folder / "flat.npz")


def raster(
    path: Path, values: np.ndarray, west_south: tuple[float, float] = (-10.25, -10.25), cell: float = 0.5
) -> str:
    """An ESRI ASCII grid, its first row the northernmost; -9999 has no data."""
    rows = "\n".join(" ".join(f"{v:g}" for v in row) for row in values[::-1])
    header = f"ncols {values.shape[1]}\nnrows {values.shape[0]}\nxllcorner {west_south[0]}\nyllcorner {west_south[1]}\n"
    path.write_text(f"{header}cellsize {cell}\n{rows}\n")
    return str(path)


CELLS = np.arange(-10.0, 10.25, 0.5)


def planned(terrain: str, **options: object) -> Any:
    return lunarsci.plan(terrain, start=(-8.0, 0.0, 0.0), target=(8.0, 0.0), **options)


def test_a_factor_multiplies_the_cost_of_flat_ground(tmp_path: Path) -> None:
    terrain = ground(tmp_path)
    layer = raster(tmp_path / "cost.asc", np.full((41, 41), 2.5))
    plain, dear = (planned(terrain, **more).path for more in ({}, {"layer": (layer,)}))
    # Flat ground costs a metre each metre, and each arc 0.1 m.
    assert plain.cost_m == pytest.approx(16.0 + 0.1) and dear.cost_m == pytest.approx(2.5 * 16.0 + 0.1)


def test_a_forbidden_class_is_gone_round_and_named(tmp_path: Path) -> None:
    terrain, classes = ground(tmp_path), np.ones((41, 41))
    classes[np.ix_(CELLS < 2.6, np.abs(CELLS) < 1.1)] = 7.0
    layer = raster(tmp_path / "classes.asc", classes)
    found = planned(terrain, layer=(layer,), classes=("7=forbidden", "1=1"))
    poses = planned_pose(found.path.plan, np.linspace(0.0, found.path.plan.length_m, 500))
    # A wheel is 0.9 m or more beside the origin, and the class reaches to y = 2.75 m.
    assert (poses[np.abs(poses[:, 0]) < 1.0, 1] > 2.75 + 0.7).all()
    assert any("classes.asc: 100.0% of the terrain" in note for note in found.notes())
    with pytest.raises(ParameterError, match=r"layer 'classes.asc' forbids it at x 0"):
        lunarsci.plan(terrain, target=(0.0, 1.0), start=(-8.0, 0.0, 0.0), layer=(layer,), classes=("7=forbidden",))


def test_of_two_ways_the_one_of_cheap_ground_is_taken(tmp_path: Path) -> None:
    terrain, costs = ground(tmp_path), np.ones((41, 41))
    costs[np.ix_(np.abs(CELLS) < 1.6, np.abs(CELLS) < 1.6)] = np.inf
    costs[CELLS > 0.1] = np.where(np.isinf(costs[CELLS > 0.1]), np.inf, 4.0)
    costs[np.isinf(costs)] = 50.0
    path = planned(terrain, layer=(raster(tmp_path / "c.asc", costs),)).path
    poses = planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 500))
    assert poses[np.abs(poses[:, 0]) < 1.0, 1].max() < -1.0


def test_a_layer_has_its_own_grid_and_holes(tmp_path: Path) -> None:
    terrain = build_terrain("t", -10.0, -10.0, 0.1, np.zeros((201, 201)), read_soil("longji"))
    values = np.arange(1.0, 10.0).reshape(3, 3)
    values[2, 2] = -9999.0
    layer = read_cost_layer(raster(tmp_path / "c.asc", values, (-3.0, -3.0), 2.0), terrain, {})
    at = {(-2.0, -2.0): 1.0, (0.0, -2.0): 2.0, (-2.0, 2.0): 7.0, (2.0, 2.0): 1.0, (-9.0, 0.0): 1.0, (0.9, 0.9): 5.0}
    for (x, y), factor in at.items():
        assert layer.factor[round(10 * (y + 10)), round(10 * (x + 10))] == factor, (x, y)
    # Eight of nine cells of 2 m on a map of 20 m: 32 m2 of 404 m2.
    assert layer.covered_share == pytest.approx(32.0 / 20.1**2, rel=0.05)
    with pytest.raises(DataError, match="covers no node"):
        read_cost_layer(raster(tmp_path / "far.asc", values, (500.0, 500.0)), terrain, {})
    with pytest.raises(DataError, match="costs of 0 or below"):
        read_cost_layer(raster(tmp_path / "zero.asc", np.zeros((41, 41))), terrain, {})


def test_a_layer_of_another_projection_lies_where_it_belongs(tmp_path: Path) -> None:
    """A raster in polar stereographic metres whose values are 100 plus the longitude, on a map in equirectangular."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.crs import CRS

    stereo = f"+proj=stere +lat_0=-90 +lon_0=0 +R={MOON_M} +units=m"
    east = np.arange(30_000.0, 60_000.0, 50.0)
    north = np.arange(60_000.0, 30_000.0, -50.0)
    values = 100.0 + np.degrees(np.arctan2(east[None, :], north[:, None]))
    where = {"transform": rasterio.transform.from_origin(29_975.0, 60_025.0, 50.0, 50.0), "crs": stereo}
    shape = {"driver": "GTiff", "height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": "float32"}
    with rasterio.open(tmp_path / "polar.tif", "w", **shape, **where) as file:
        file.write(values.astype("float32"), 1)
    local = f"+proj=stere +lat_0=-88 +lon_0=45 +R={MOON_M} +units=m"
    terrain = build_terrain(
        "t", -500.0, -500.0, 50.0, np.zeros((21, 21)), read_soil("longji"), crs=CRS.from_user_input(local).to_wkt()
    )
    factor = read_cost_layer(str(tmp_path / "polar.tif"), terrain, {}).factor
    assert factor[10, 10] == pytest.approx(145.0, abs=0.1)
    # 500 m to the east at 88 deg S are 500 / (R cos 88 deg) of longitude.
    turned = math.degrees(500.0 / (MOON_M * math.cos(math.radians(88.0))))
    assert factor[10, 20] == pytest.approx(145.0 + turned, abs=0.1)


@pytest.mark.parametrize("text", ["3", "a=2", "3=", "3=0", "3=-1", "3=inf", "3=nan", "=forbidden"])
def test_what_is_no_class_is_refused(text: str) -> None:
    with pytest.raises(ParameterError, match=r"VALUE=COST|is no cost"):
        parse_classes([text])


def test_shadow_on_the_way_is_as_long_as_the_sun_is_low(tmp_path: Path) -> None:
    """A wall 2 m high at x = 8 m and the Sun behind it at 1:3 over the horizon: shadow from x = 2 m to 8 m."""
    height = np.zeros((AXIS.size, AXIS.size))
    height[:, AXIS >= 7.99] = 2.0
    terrain, sun = ground(tmp_path, height), f"0,{math.degrees(math.atan(1.0 / 3.0))}"
    asked = {"start": (-8.0, 0.0, 0.0), "target": (5.0, 0.0)}
    found = lunarsci.plan(terrain, sun=sun, **asked).to_dict()
    assert found["sun"]["path_shadow_share"] == pytest.approx(3.0 / 13.0, abs=0.01)
    assert found["sun"]["shadow_share"] == pytest.approx(6.0 / 20.1, abs=0.01)
    dear = lunarsci.plan(terrain, sun=sun, shadow_cost="4", **asked).path
    assert dear.cost_m == pytest.approx(10.0 + 4.0 * 3.0 + 0.1, rel=0.02)
    with pytest.raises(ParameterError, match="cannot be at the target: layer 'shadow' forbids it"):
        lunarsci.plan(terrain, sun=sun, shadow_cost="forbidden", **asked)
    for wrong in ({"sun": "1"}, {"shadow_cost": "2"}, {"sun": sun, "shadow_cost": "0"}, {"classes": ("1=2",)}):
        with pytest.raises(RequestError):
            lunarsci.plan(terrain, **wrong, **asked)


def test_a_path_goes_out_as_geojson_in_metres(tmp_path: Path) -> None:
    found = planned(ground(tmp_path))
    document = json.loads(found.files()["path.geojson"]())
    assert "m" in document["crs"]["properties"]["name"]
    line, start, target = document["features"]
    assert line["geometry"]["coordinates"][0] == pytest.approx([-8.0, 0.0])
    assert line["geometry"]["coordinates"][-1] == pytest.approx([8.0, 0.0])
    assert [one["properties"]["role"] for one in (start, target)] == ["start", "target"]


def test_hazards_near_the_path_are_polygons_of_their_area(tmp_path: Path) -> None:
    height = np.zeros((AXIS.size, AXIS.size))
    height[np.ix_(AXIS > 4.0, np.abs(AXIS) < 1.0)] = 1.0
    found = planned(ground(tmp_path, height))
    shape = json.loads(found.files()["path.geojson"]())["features"][-1]["geometry"]
    area = 0.0
    for (ring,) in shape["coordinates"]:
        x, y = np.array(ring).T
        area += 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])
    within = np.abs(found.surface.terrain.y_m) <= 10.0 + np.abs(found.path.end[1]) + 1.0
    assert area == pytest.approx(0.01 * found.surface.hazard[within].sum(), rel=0.02) and area > 5.0


def test_longitude_and_latitude_come_and_go(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    where = {"transform": rasterio.transform.from_origin(711_000.0, 20_030.0, 0.5, 0.5), "crs": MOON}
    with rasterio.open(
        tmp_path / "t.tif", "w", driver="GTiff", height=60, width=60, count=1, dtype="float32", **where
    ) as file:
        file.write(np.zeros((60, 60), dtype="float32"), 1)
    start, target = ((711_005.0, 20_015.0), (711_025.0, 20_015.0))
    degrees = [np.degrees(np.array(place) / MOON_M).tolist() for place in (start, target)]
    found = lunarsci.plan(str(tmp_path / "t.tif"), lonlat=True, start=(*degrees[0], 0.0), target=tuple(degrees[1]))
    path = found.to_dict()["path"]
    assert (path["start"]["x_m"], path["start"]["y_m"]) == pytest.approx(start, abs=1e-3)
    assert (path["end"]["longitude_deg"], path["end"]["latitude_deg"]) == pytest.approx(degrees[1], abs=1e-7)
    document = json.loads(found.files()["path.geojson"]())
    assert document["body"]["equatorial_radius_m"] == MOON_M and "crs" not in document
    assert document["features"][0]["geometry"]["coordinates"][-1] == pytest.approx(degrees[1], abs=1e-7)

    def zones(**members: object) -> object:
        shape = {"type": "Point", "coordinates": degrees[1] if not members else list(target)}
        feature = {"type": "Feature", "geometry": shape, "properties": {"radius_m": 2.0}}
        content = {"type": "FeatureCollection", "features": [feature]} | members
        return read_keep_outs(InputFile("k.geojson", json.dumps(content).encode()), found.site.terrain.crs)

    for read in (zones(), zones(crs={"type": "name"})):
        assert [(zone.x_m, zone.y_m) for zone in read] == [pytest.approx(target, abs=1e-3)]
    with pytest.raises(DataError, match=r"longitudes lie between .* member 'crs'"):
        bad = {"type": "Point", "coordinates": list(target)}
        feature = {"type": "Feature", "geometry": bad, "properties": {"radius_m": 2.0}}
        content = json.dumps({"type": "FeatureCollection", "features": [feature]}).encode()
        read_keep_outs(InputFile("k.geojson", content), found.site.terrain.crs)
    with pytest.raises(DataError, match="names no coordinate system"):
        planned(ground(tmp_path), lonlat=True)
