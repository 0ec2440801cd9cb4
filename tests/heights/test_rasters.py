"""Heights as their file says: units, scale and offset, labels, and maps that are not in metres. Tilted planes by hand.

A plane rises by `NORTH` to the north and `EAST` to the east: 18.435 deg at 71.565 deg from north, or as given.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.heights.grid import HeightGrid, metres_in
from lunarsci.heights.grids import read_grid
from lunarsci.twin.jobs.terrain import terrain

rasterio = pytest.importorskip("rasterio")
MOON_M = 1_737_400.0
NORTH, EAST = 0.1, 0.3
SLOPE = math.hypot(NORTH, EAST)
POLAR = f"+proj=stere +lat_0=-90 +lon_0=0 +R={MOON_M} +units=m"
EQUATOR = f"+proj=eqc +lat_ts=0 +lon_0=0 +R={MOON_M} +units=m"
DEGREES = f"+proj=longlat +R={MOON_M}"


def written(path: Path, rows: np.ndarray, transform: Any, unit: str = "", **more: Any) -> Path:
    """A raster, the northern row first; scale and offset are of GDAL."""
    scale, offset = more.pop("scale", 1.0), more.pop("offset", 0.0)
    shape = {"driver": "GTiff", "count": 1, "dtype": "float64", "height": rows.shape[0], "width": rows.shape[1]}
    with rasterio.open(path, "w", transform=transform, **(shape | more)) as raster:
        raster.write(rows.astype(raster.dtypes[0]), 1)
        raster.scales, raster.offsets, raster.units = (scale,), (offset,), (unit,)
    return path


def plane(size: int = 30) -> np.ndarray:
    """Heights on nodes every metre, the northern row first. [m]"""
    axis = np.arange(size, dtype=float)
    return EAST * axis[None, :] + NORTH * axis[::-1, None]


def up(x: float = 0.0, y: float = 0.0, size: float = 1.0) -> Any:
    return rasterio.transform.from_origin(x, y, size, size)


def slopes(grid: HeightGrid) -> tuple[float, float]:
    """Medians of the rise along x and along y. [-]"""
    along_y, along_x = np.gradient(grid.height_m, grid.spacing_m)
    return float(np.nanmedian(along_x)), float(np.nanmedian(along_y))


@pytest.mark.parametrize(
    ("unit", "metres"),
    [
        ("km", 1000.0), ("KILOMETER", 1000.0), ("kilometres", 1000.0), ("m", 1.0), ("<METERS>", 1.0), ("metre", 1.0),
        ("cm", 0.01), ("millimeters", 0.001), ("feet", 0.3048), ("ft", 0.3048), ("foot (International)", 0.3048),
        ("US survey foot", 1200.0 / 3937.0), ("US_survey_feet", 1200.0 / 3937.0), ("U.S. Survey Feet", 1200 / 3937),
        ("ftUS", 1200.0 / 3937.0), ("us-ft", 1200.0 / 3937.0),
    ],
)  # fmt: skip
def test_heights_in_the_unit_of_their_band(unit: str, metres: float, tmp_path: Path) -> None:
    grid = read_grid(written(tmp_path / "t.tif", plane() / metres, up(), unit))
    assert slopes(grid) == pytest.approx((EAST, NORTH), rel=1e-9)
    assert any(unit in text for text in grid.read_as) == (metres != 1.0)


def test_counts_in_feet_with_scale_and_offset(tmp_path: Path) -> None:
    counts = np.arange(36).reshape(6, 6)
    counts[2, 3] = -32768
    file = written(tmp_path / "t.tif", counts, up(), "ft", dtype="int16", nodata=-32768, scale=0.5, offset=10.0)
    height = read_grid(file).height_m[::-1]
    assert np.isnan(height[2, 3]) and np.isnan(height).sum() == 1
    assert height[5, 5] == pytest.approx((10.0 + 0.5 * 35) * 0.3048, rel=1e-12)


def test_the_vertical_system_says_the_unit(tmp_path: Path) -> None:
    """NAVD88 in US survey feet over UTM; a unit of the band itself goes first."""
    file = written(tmp_path / "t.tif", plane(), up(500_000.0, 5e6), crs="EPSG:32633+6360")
    assert slopes(read_grid(file)) == pytest.approx((EAST * 1200 / 3937, NORTH * 1200 / 3937))
    file = written(tmp_path / "b.tif", plane() / 1e3, up(500_000.0, 5e6), "km", crs="EPSG:32633+6360")
    assert slopes(read_grid(file)) == pytest.approx((EAST, NORTH))


def test_no_unit_is_metres_and_the_option_decides(tmp_path: Path) -> None:
    for unit in ("", "N/A"):
        bare = read_grid(written(tmp_path / "t.tif", plane(), up(), unit))
        assert slopes(bare) == pytest.approx((EAST, NORTH))
        assert "in m, as the file states no unit (--height-unit)" in bare.read_as[0]
    file = written(tmp_path / "km.tif", plane(), up(), "km")
    asked = read_grid(file, unit="ft")
    assert slopes(asked) == pytest.approx((0.3048 * EAST, 0.3048 * NORTH)) and "ft, as asked" in asked.read_as[0]
    named = tmp_path / "named.npz"
    np.savez(named, x_m=np.arange(6.0), y_m=np.arange(6.0), height_m=np.ones((6, 6)))
    assert read_grid(named).read_as == ()


def test_an_unknown_unit_is_named_with_the_option(tmp_path: Path) -> None:
    file = written(tmp_path / "t.tif", plane(), up(), "furlong")
    with pytest.raises(DataError, match=r"t\.tif: .*'furlong'.*`height_unit`"):
        read_grid(file)
    assert slopes(read_grid(file, unit="cm")) == pytest.approx((0.01 * EAST, 0.01 * NORTH))
    assert metres_in("unknown") is None


def tilted(lon: np.ndarray, lat: np.ndarray, middle: tuple[float, float]) -> np.ndarray:
    """Heights over the ground by lengths of arcs about a place on the Moon: R cos(lat) dlon to the east, R dlat. [m]"""
    east = np.radians(lon - middle[0]) * np.cos(np.radians(lat)) * MOON_M
    return np.asarray(EAST * east + NORTH * np.radians(lat - middle[1]) * MOON_M)


def in_degrees(path: Path, lon: float, lat: float, size: int = 120, **more: Any) -> Path:
    """A tilted plane on degrees about a place, cells of 0.001 deg: 30.3 m to the north, cos(lat) of it to the east."""
    steps = 0.001 * (np.arange(size) - 0.5 * (size - 1))
    rows = tilted(lon + steps[None, :], lat - steps[:, None], (lon, lat)) / more.get("scale", 1.0)
    return written(path, rows, up(lon - 0.0005 * size, lat + 0.0005 * size, 0.001), crs=DEGREES, **more)


@pytest.mark.parametrize(("lon", "lat"), [(20.0, 0.0), (20.0, -80.0), (179.99, 60.0), (180.01, -45.0), (359.99, -85.0)])
def test_degrees_become_square_metres_about_their_middle(lon: float, lat: float, tmp_path: Path) -> None:
    """Where a degree of longitude is 0.09 to 1 of one of latitude; on a sphere meridians meet, by 0.1 % here."""
    grid = read_grid(in_degrees(tmp_path / "d.tif", lon, lat))
    assert grid.spacing_m == pytest.approx(math.radians(0.001) * MOON_M, rel=1e-3)
    assert slopes(grid) == pytest.approx((EAST, NORTH), abs=2e-3)
    assert f"{(lon + 180) % 360 - 180:.4f}, {lat:.4f} deg" in grid.read_as[1] and "degrees" in grid.read_as[1]
    across = np.isfinite(grid.height_m).any(axis=0).sum() * grid.spacing_m
    assert across == pytest.approx(0.12 * math.cos(math.radians(lat)) * math.radians(1) * MOON_M, abs=3 * 30.3)
    ny, nx = (size // 2 for size in grid.height_m.shape)
    x, y = grid.x0_m + nx * grid.spacing_m, grid.y0_m + ny * grid.spacing_m
    assert max(abs(x), abs(y)) < 35.0, "x = y = 0 is the middle"
    assert grid.height_m[ny, nx] == pytest.approx(EAST * x + NORTH * y, abs=0.05)


def test_equirectangular_far_from_its_parallel_keeps_scale_and_unit(tmp_path: Path) -> None:
    """At 60 deg a metre of the map to the east is half of one on the ground: the file's rise of 0.15 is 0.3."""
    y = math.radians(60.0) * MOON_M
    rows = 0.5 * EAST * 20.0 * np.arange(200)[None, :] + NORTH * 20.0 * np.arange(100)[::-1, None]
    counts: dict[str, Any] = {"dtype": "int16", "nodata": -32768, "scale": 0.0005, "crs": EQUATOR}
    grid = read_grid(written(tmp_path / "e.tif", np.rint(rows / 0.5), up(1e5, y + 1000.0, 20.0), "km", **counts))
    assert slopes(grid) == pytest.approx((EAST, NORTH), rel=0.02) and grid.spacing_m == pytest.approx(20.0, rel=1e-3)
    assert "differ by up to 50%" in grid.read_as[1]
    straight = read_grid(written(tmp_path / "s.tif", rows, up(1e5, 1000.0, 20.0), crs=EQUATOR))
    assert straight.crs == straight.crs_of_file and straight.height_m.shape == (100, 200), "at the equator it stays"


def test_a_wide_polar_map_stays_and_says_what_its_edge_is_off_by(tmp_path: Path) -> None:
    """1 / cos^2 of half of 15.1 deg is 1.018 at the edges' middles, 1.035 at corners: no projection is truer."""
    half = 2.0 * MOON_M * math.tan(math.radians(7.55))
    file = written(tmp_path / "p.tif", np.zeros((100, 100)), up(-half, half, half / 50.0), "m", crs=POLAR)
    grid = read_grid(file)
    assert grid.crs == grid.crs_of_file and "up to 3%" in grid.read_as[0]


def test_the_whole_moon_is_no_map(tmp_path: Path) -> None:
    file = written(tmp_path / "g.tif", np.zeros((180, 360)), up(-180.0, 90.0, 1.0), "m", crs=DEGREES)
    with pytest.raises(DataError, match=r"g\.tif: .*cut out the part around the drive"):
        read_grid(file)


def test_feet_on_the_ground_and_turned_and_oblong_cells(tmp_path: Path) -> None:
    feet = written(tmp_path / "f.tif", plane(), up(9.8e5, 2e5), "ft", crs="EPSG:2263")
    assert np.hypot(*slopes(read_grid(feet))) == pytest.approx(SLOPE, rel=1e-3)
    turned = up() @ rasterio.transform.Affine.rotation(30.0)
    axis = np.arange(80) + 0.5
    x, y = turned @ tuple(np.meshgrid(axis, axis))
    grid = read_grid(written(tmp_path / "r.tif", EAST * x + NORTH * y, turned, "m"))
    assert slopes(grid) == pytest.approx((EAST, NORTH), rel=1e-6) and grid.spacing_m == pytest.approx(1.0, rel=1e-3)
    assert grid.height_m[40, 40] == pytest.approx(
        EAST * (grid.x0_m + 40 * grid.spacing_m) + NORTH * (grid.y0_m + 40 * grid.spacing_m), rel=1e-6
    )


def test_holes_are_not_filled_and_no_height_is_made_up(tmp_path: Path) -> None:
    rows = plane(60)
    rows[20:30, 20:30] = np.nan
    turned = up(0.0, 60.0) @ rasterio.transform.Affine.rotation(30.0)
    grid = read_grid(written(tmp_path / "r.tif", np.where(np.isnan(rows), np.nan, 5.0), turned, "m"))
    known = np.isfinite(grid.height_m)
    assert np.ptp(grid.height_m[known]) == pytest.approx(0.0, abs=1e-9)
    inside = known.sum() / (59.0**2 - 11.0**2)
    assert inside == pytest.approx(1.0, abs=0.04), "nodes between known ones: the square less its hole, a cell wider"


def test_classes_are_taken_and_not_mixed(tmp_path: Path) -> None:
    classes = np.where(np.arange(120)[None, :] < 60, 1.0, 7.0) * np.ones((120, 1))
    file = written(tmp_path / "c.tif", classes, up(20.0, -80.0, 0.001), "class of ground", crs=DEGREES)
    found = read_grid(file, values=True).height_m
    assert set(np.unique(found[np.isfinite(found)])) == {1.0, 7.0}


def test_a_raster_goes_onto_the_system_of_another(tmp_path: Path) -> None:
    """Onto the polar map, where north at 30 deg east points away from the pole, 30 deg to the right of y."""
    crs = rasterio.crs.CRS.from_user_input(POLAR).to_wkt()
    grid = read_grid(in_degrees(tmp_path / "d.tif", 30.0, -85.0), onto=crs)
    turn = math.radians(30.0)
    along_x = NORTH * math.sin(turn) + EAST * math.cos(turn)
    along_y = NORTH * math.cos(turn) - EAST * math.sin(turn)
    assert grid.crs == crs and slopes(grid) == pytest.approx((along_x, along_y), abs=2e-3)


LABEL = """PDS_VERSION_ID = "PDS3"
RECORD_TYPE = FIXED_LENGTH
FILE_RECORDS = 40
RECORD_BYTES = 96
^IMAGE = "{image}"
OBJECT = IMAGE
  LINES = 40
  LINE_SAMPLES = 48
  SAMPLE_TYPE = LSB_INTEGER
  SAMPLE_BITS = 16
  UNIT = {unit}
  SCALING_FACTOR = 0.0005
  OFFSET = 1737.4
  MISSING_CONSTANT = -32768
END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "POLAR STEREOGRAPHIC"
  A_AXIS_RADIUS = 1737.4 <km>
  B_AXIS_RADIUS = 1737.4 <km>
  C_AXIS_RADIUS = 1737.4 <km>
  POSITIVE_LONGITUDE_DIRECTION = "EAST"
  CENTER_LATITUDE = -90. <deg>
  CENTER_LONGITUDE = 0. <deg>
  MAP_SCALE = 20. <m/pix>
  LINE_PROJECTION_OFFSET = 19.5 <pix>
  SAMPLE_PROJECTION_OFFSET = 23.5 <pix>
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""


def counts_beside(folder: Path) -> np.ndarray:
    counts = (2.0 * NORTH * 20.0 * np.arange(40)[::-1, None] + np.zeros((40, 48))).astype("<i2")
    counts[3, 4] = -32768
    counts.tofile(folder / "ldem.img")
    return counts


def test_labels_of_pds3_have_unit_scale_offset_and_missing(tmp_path: Path) -> None:
    """Half metres as kilometres, over the radius, as the orbiter's laser has them."""
    counts = counts_beside(tmp_path)
    (tmp_path / "ldem.lbl").write_text(LABEL.format(image="ldem.img", unit="KILOMETER").replace("\n", "\r\n"))
    for name in ("ldem.lbl", "ldem.img"):
        grid = read_grid(tmp_path / name)
        assert (grid.x0_m, grid.y0_m, grid.spacing_m) == pytest.approx((-470.0, -390.0, 20.0))
        assert grid.height_m[0, 0] == pytest.approx(1_737_400.0 + 0.5 * counts[-1, 0], abs=1e-6)
        assert np.isnan(grid.height_m[-4, 4]) and np.isnan(grid.height_m).sum() == 1
        assert len(grid.beside) == 1
    (tmp_path / "ldem.lbl").write_text(LABEL.format(image="ldem.img", unit="FURLONG"))
    with pytest.raises(DataError, match="FURLONG"):
        read_grid(tmp_path / "ldem.lbl")


def test_a_label_names_files_of_its_own_folder_alone(tmp_path: Path) -> None:
    counts_beside(tmp_path)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "l.lbl").write_text(LABEL.format(image="../ldem.img", unit="METER"))
    with pytest.raises(DataError, match="not in its folder"):
        read_grid(tmp_path / "in" / "l.lbl")


def test_labels_of_pds4_and_cubes_of_isis(tmp_path: Path) -> None:
    counts = np.arange(36).reshape(6, 6)
    of: dict[str, Any] = {"dtype": "int16", "nodata": -32768, "crs": POLAR}
    label = written(tmp_path / "t.xml", counts, up(0.0, 0.0, 20.0), "cm", driver="PDS4", scale=0.5, offset=3.0, **of)
    grid = read_grid(label)
    assert grid.height_m[0, 5] == pytest.approx(0.01 * (3.0 + 0.5 * 35.0))
    assert (grid.x0_m, grid.y0_m) == pytest.approx((10.0, -110.0))
    cube = written(tmp_path / "t.cub", counts, up(0.0, 0.0, 20.0), driver="ISIS3", **of)
    cube.write_bytes(cube.read_bytes().replace(b"Multiplier = 1.0", b"Multiplier = 0.5"))
    assert read_grid(cube).height_m[0, 5] == pytest.approx(0.5 * 35.0)


CASES = Path("cases/rover")


@pytest.mark.reference
def test_made_up_files_that_were_misread(reference_data: Path) -> None:
    wall = read_grid(reference_data / CASES / "km_heights_unit_km.tif")
    steepest = np.degrees(np.arctan(np.hypot(*np.gradient(wall.height_m, wall.spacing_m)))).max()
    assert steepest == pytest.approx(45.6, abs=0.05)
    hills = terrain(str(reference_data / CASES / "equirect_scale0.5.tif")).to_dict()
    found = hills["maps"]["slope_deg"]
    assert (found["p50"], found["p95"]) == pytest.approx((8.64, 17.67), abs=0.06)
    assert "reprojected from 'SimpleCylindrical Moon'" in hills["read_as"][1]
    assert read_grid(reference_data / CASES / "dxdy.asc").spacing_m == 1.0
