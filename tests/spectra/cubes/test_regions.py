"""Boxes, polygons, masks and every n-th pixel."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError, RequestError
from lunarsci.spectra.cubes.rasters import open_cube
from lunarsci.spectra.cubes.regions import region_of
from lunarsci.spectra.jobs.requests import MapRequest

from .conftest import spectra
from .test_rasters import backplane, m3, tiff

pytest.importorskip("rasterio")
CUBE = spectra(40, 30, np.linspace(500, 2500, 6)).astype("f4")
NAMES = [f"{w:g} nm" for w in np.linspace(500, 2500, 6)]


def geojson(path: Path, *rings: Any, kind: str = "Polygon") -> str:
    geometry = {"type": kind, "coordinates": list(rings) if kind == "Polygon" else [[ring] for ring in rings]}
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": geometry}]}))
    return str(path)


def upright(folder: Path) -> Any:
    from rasterio.transform import from_origin

    return open_cube(str(tiff(folder / "up.tif", CUBE, names=NAMES, transform=from_origin(10, 20, 0.1, 0.1))))


def kept(cube: Any, region: Any) -> Any:
    return region.wanted(cube, range(region.shape[0]))


def test_boxes(envi: Any) -> None:
    cube = open_cube(str(envi(CUBE)))
    for text, lines, samples in (
        ("3:9,10:20", (10, 20), (3, 9)),
        (":9,10:", (10, 40), (0, 9)),
        (" 0:30 , 0:40 ", (0, 40), (0, 30)),
    ):
        region = region_of(cube, text)
        assert (region.lines, region.samples) == (lines, samples)
    for wrong in ("9:3,0:5", "0:31,0:5", "0:5", "a:b,c:d", "nowhere.json"):
        with pytest.raises(RequestError, match="`roi`"):
            region_of(cube, wrong)
    with pytest.raises(RequestError, match="`every`"):
        MapRequest(every=0)


def test_every_nth_pixel_keeps_its_place(tmp_path: Path) -> None:
    cube = upright(tmp_path)
    region = region_of(cube, "2:29,3:40", every=7)
    assert region.shape == (6, 4)
    frame = cube.frame.part(region.lines[0], region.samples[0], 7)
    x, y = frame.middles(np.arange(6.0)[:, None], np.arange(4.0)[None])
    np.testing.assert_allclose(x[0], 10 + 0.1 * (2 + 7 * np.arange(4) + 0.5))
    np.testing.assert_allclose(y[:, 0], 20 - 0.1 * (3 + 7 * np.arange(6) + 0.5))
    assert region.part(range(1, 3)) == (slice(10, 18), slice(2, 29))


def test_a_polygon_keeps_the_pixels_whose_middle_is_inside(tmp_path: Path) -> None:
    cube = upright(tmp_path)
    file = geojson(
        tmp_path / "box.json", [[10.52, 19.03], [11.48, 19.03], [11.48, 17.97], [10.52, 17.97], [10.52, 19.03]]
    )
    region = region_of(cube, file)
    assert (region.lines, region.samples) == ((9, 21), (5, 15))
    inside = kept(cube, region)
    longitude, latitude = cube.frame.part(9, 5).middles(np.arange(12.0)[:, None], np.arange(10.0)[None])
    wanted = (longitude > 10.52) & (longitude < 11.48) & (latitude > 17.97) & (latitude < 19.03)
    np.testing.assert_array_equal(inside, wanted)


def test_holes_several_polygons_and_the_other_count_of_longitude(tmp_path: Path) -> None:
    cube = upright(tmp_path)
    outer = [[10, 20], [13, 20], [13, 16], [10, 16], [10, 20]]
    hole = [[11, 19], [12, 19], [12, 18], [11, 18], [11, 19]]
    assert (~kept(cube, region_of(cube, geojson(tmp_path / "a.json", outer, hole)))).sum() == 100
    one = [[10, 20], [11, 20], [11, 19], [10, 19], [10, 20]]
    other = [[-348, 17], [-347, 17], [-347, 16], [-348, 16], [-348, 17]]
    assert kept(cube, region_of(cube, geojson(tmp_path / "b.json", one, other, kind="MultiPolygon"))).sum() == 200


def test_a_polygon_on_a_projected_cube_and_on_a_swath(tmp_path: Path) -> None:
    from rasterio.transform import from_origin

    radius = 1737400.0
    metres = np.pi / 180 * radius
    crs = "+proj=eqc +R=1737400 +lon_0=180 +units=m"
    transform = from_origin((10 - 180) * metres, 20 * metres, 0.1 * metres, 0.1 * metres)
    flat = open_cube(str(tiff(tmp_path / "flat.tif", CUBE, names=NAMES, crs=crs, transform=transform)))
    box = geojson(tmp_path / "box.json", [[10.52, 19.03], [11.48, 19.03], [11.48, 17.97], [10.52, 17.97]])
    wanted = kept(upright(tmp_path), region_of(upright(tmp_path), box))
    region = region_of(flat, box)
    assert (region.lines, region.samples) == ((9, 21), (5, 15))
    np.testing.assert_array_equal(kept(flat, region), wanted)

    path = m3(tmp_path, spectra(40, 30).astype("f4"))
    lines, samples = np.mgrid[:40, :30]
    places = np.stack([10 + 0.1 * (samples + 0.5), 20 - 0.1 * (lines + 0.5), 0 * lines], axis=2)
    backplane(tmp_path, "LOC", places, "<f8")
    swath = open_cube(str(path))
    found = region_of(swath, box)
    assert kept(swath, found).sum() == wanted.sum()
    assert kept(swath, found).shape == (10, 10)


@pytest.mark.parametrize("middle", [0.0, 90.0, -270.0, 180.0, -180.0, 359.5, -0.1, -359.0])
def test_a_polygon_on_a_swath_may_lie_over_any_meridian(tmp_path: Path, middle: float) -> None:
    """Longitudes of the swath count from 0 to 360 deg, those of the polygon from there or from a turn before."""
    path = m3(tmp_path, spectra(20, 30).astype("f4"))
    lines, samples = np.mgrid[:20, :30]
    east = 0.1 * (samples - 14.5)
    backplane(tmp_path, "LOC", np.stack([(middle + east) % 360, 1 - 0.1 * lines, 0 * lines], axis=2), "<f8")
    swath = open_cube(str(path))
    west, far = middle - 0.77, middle + 0.5
    found = region_of(swath, geojson(tmp_path / "box.json", [[west, 0.95], [far, 0.95], [far, 0.05], [west, 0.05]]))
    # Middles of pixels from -0.75 to 0.45 deg beside it, and from 0.9 down to 0.1 deg north.
    assert (found.lines, found.samples) == ((1, 10), (7, 20))
    assert kept(swath, found).all()


@pytest.mark.parametrize("west", [-180.0, 0.0])
@pytest.mark.parametrize(
    ("first", "last"), [(170, 180), (-180, -170), (170, 190), (-10, 10), (350, 360), (0, 10), (-180, 180), (0, 360)]
)
def test_a_polygon_on_a_map_of_all_longitudes_may_end_at_its_edge_or_reach_over_it(
    tmp_path: Path, west: float, first: int, last: int
) -> None:
    """Pixels of 1 degree, six lines of them: six for each degree, wherever these are on the map."""
    from rasterio.transform import from_origin

    whole = np.ones((12, 360, 6), "f4")
    transform = from_origin(west, 6, 1, 1)
    cube = open_cube(str(tiff(tmp_path / "all.tif", whole, names=NAMES, transform=transform)))
    region = region_of(cube, geojson(tmp_path / "box.json", [[first, 3], [last, 3], [last, -3], [first, -3]]))
    found = np.zeros(360, int)
    found[slice(*region.samples)] = kept(cube, region).sum(axis=0)
    wanted = (np.arange(first, last) - int(west)) % 360
    assert region.lines == (3, 9)
    assert found[wanted].tolist() == [6] * (last - first) and found.sum() == 6 * (last - first)


def test_a_polygon_over_the_edge_of_a_projection_is_refused(tmp_path: Path) -> None:
    from rasterio.transform import from_origin

    degree = np.pi / 180 * 1737400.0
    crs, transform = "+proj=eqc +R=1737400 +lon_0=180 +units=m", from_origin(-180 * degree, 6 * degree, degree, degree)
    whole = np.ones((12, 360, 6), "f4")
    cube = open_cube(str(tiff(tmp_path / "all.tif", whole, names=NAMES, crs=crs, transform=transform)))
    inside = region_of(cube, geojson(tmp_path / "in.json", [[1, 3], [350, 3], [350, -3], [1, -3]]))
    assert (inside.lines, inside.samples) == ((3, 9), (1, 350)) and kept(cube, inside).all()
    with pytest.raises(DataError, match="reaches over the edge"):
        region_of(cube, geojson(tmp_path / "over.json", [[-10, 3], [10, 3], [10, -3], [-10, -3]]))


def test_polygons_that_cannot_be_meant(tmp_path: Path, envi: Any) -> None:
    cube = upright(tmp_path)
    box = [[10, 20], [13, 20], [13, 16], [10, 16]]
    broken = tmp_path / "broken.json"
    broken.write_text('{"type": "Polygon"}')
    for file, said in (
        (str(broken), "is no GeoJSON"),
        (geojson(tmp_path / "away.json", [[50, 20], [53, 20], [53, 16]]), "lies beside the cube"),
        (geojson(tmp_path / "metres.json", [[1e5, 2e5], [2e5, 2e5], [2e5, 3e5]]), "has no polygon in degrees"),
        (geojson(tmp_path / "line.json", box[:2]), "has no polygon"),
    ):
        with pytest.raises(DataError, match=said):
            region_of(cube, file)
    with pytest.raises(DataError, match="has no place on the Moon"):
        region_of(open_cube(str(envi(CUBE))), geojson(tmp_path / "good.json", box))


def test_masks_of_every_kind(tmp_path: Path, envi: Any) -> None:
    import rasterio

    cube = open_cube(str(envi(CUBE, "cube.img")))
    mask = np.zeros((40, 30), "f4")
    mask[5:9, 3:20] = 1
    mask[6, 6] = np.nan
    wanted = np.isfinite(mask) & (mask != 0)
    np.save(tmp_path / "mask.npy", mask)
    with rasterio.open(
        tmp_path / "mask.tif", "w", driver="GTiff", width=30, height=40, count=1, dtype="float32"
    ) as file:
        file.write(mask, 1)
    envi(mask[..., None], "flat.img", wavelength=None, wavelength_units=None)
    for name in ("mask.npy", "mask.tif", "flat.img"):
        np.testing.assert_array_equal(kept(cube, region_of(cube, None, str(tmp_path / name))), wanted)
    np.save(tmp_path / "small.npy", mask[1:])
    with pytest.raises(DataError, match="a mask is of its size"):
        region_of(cube, None, str(tmp_path / "small.npy"))
    with pytest.raises(DataError, match="is no image of one band"):
        region_of(cube, None, str(tmp_path / "cube.img"))
