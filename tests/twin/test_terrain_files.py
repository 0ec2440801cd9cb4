"""Elevation models of other programs: the same ground from every format, and files that cannot be."""

from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.heights.units import HeightUnit
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import assess, ground_maps, maps_bytes, maps_geotiff, read_mobility
from lunarsci.twin.ground.terrain import read_terrain, write_terrain
from lunarsci.twin.jobs.drive_inputs import read_drive_inputs
from lunarsci.twin.jobs.plan import plan as find_path
from lunarsci.twin.jobs.terrain import terrain
from lunarsci.twin.rover import build_rover

HEIGHT = np.arange(20.0).reshape(4, 5) ** 1.5 / 100
"""Row 0 is the southernmost."""


def geotiff(path: Path, height: np.ndarray = HEIGHT, **changes: object) -> Path:
    rasterio = pytest.importorskip("rasterio")
    north_up = rasterio.transform.from_origin(100.0, 52.0, 0.5, 0.5)
    settings = {
        "driver": "GTiff", "height": height.shape[0], "width": height.shape[1], "count": 1, "dtype": "float32",
        "transform": north_up, "nodata": -32768.0,
    } | changes  # fmt: skip
    with rasterio.open(path, "w", **settings) as raster:
        raster.write(np.where(np.isnan(height), -32768.0, height)[::-1].astype("float32"), 1)
    return path


def ascii_grid(path: Path, height: np.ndarray = HEIGHT, corner: str = "corner") -> Path:
    x0, y0 = (100.0, 50.0) if corner == "corner" else (100.25, 50.25)
    rows = "\n".join(" ".join("-9999" if np.isnan(h) else f"{h:.9g}" for h in row) for row in height[::-1])
    header = f"NCOLS {height.shape[1]}\nNROWS {height.shape[0]}\nXLL{corner} {x0}\nYLL{corner} {y0}\n"
    path.write_text(header + "CELLSIZE 0.5\nNODATA_value -9999\n" + rows + "\n")
    return path


def table(path: Path, height: np.ndarray = HEIGHT, **columns: float) -> Path:
    lines = [",".join(["x_m", "y_m", "height_m", *columns])]
    for (i, j), h in np.ndenumerate(height):
        if not np.isnan(h):
            values = [100.25 + 0.5 * j, 50.25 + 0.5 * i, h, *columns.values()]
            lines.append(",".join(f"{value:.9g}" for value in values))
    path.write_text("\n".join(lines) + "\n")
    return path


WRITERS = {"t.tif": geotiff, "t.asc": ascii_grid, "t.csv": table}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_ground_north_up(tmp_path: Path, longji_soil: Soil, name: str) -> None:
    ground = read_terrain(WRITERS[name](tmp_path / name), longji_soil)
    assert (ground.x0_m, ground.y0_m, ground.spacing_m) == pytest.approx((100.25, 50.25, 0.5))
    assert ground.height_m == pytest.approx(HEIGHT, rel=1e-6)
    assert ground.soil.shape == (1, 1, 8)
    assert not ground.synthetic


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_not_known_is_a_hole(tmp_path: Path, longji_soil: Soil, name: str) -> None:
    holed = HEIGHT.copy()
    holed[2, 3] = np.nan
    ground = read_terrain(WRITERS[name](tmp_path / name, holed), longji_soil)
    assert np.array_equal(np.isnan(ground.height_m), np.isnan(holed))


def test_a_grid_by_its_first_centre_is_the_one_by_its_corner(tmp_path: Path, longji_soil: Soil) -> None:
    ground = read_terrain(ascii_grid(tmp_path / "t.asc", corner="center"), longji_soil)
    assert (ground.x0_m, ground.y0_m) == pytest.approx((100.25, 50.25))


def test_a_table_brings_its_soil(tmp_path: Path, longji_soil: Soil) -> None:
    ground = read_terrain(table(tmp_path / "t.csv", cohesion_pa=170.0, lateral_modulus_mm=13.0), longji_soil)
    assert ground.soil[2, 2, 3] == pytest.approx(170.0)
    assert ground.soil[2, 2, 7] == pytest.approx(0.013)


@pytest.mark.parametrize(
    ("name", "content", "hint"),
    [
        ("t.tif", b"II*\0 cut short", "not a GeoTIFF"),
        ("t.asc", b"ncols 3\nnrows 3\ncellsize 1\n1 2 3\n4 5 6\n", "cut short"),
        ("t.asc", b"1 2 3\n4 5 6\n", "begins with ncols"),
        ("t.asc", b"ncols 3\nnrows 1\ncellsize 1\n1 two 3\n", "two"),
        ("t.asc", b"\xff\xfe\x00\x01", "ncols"),
        ("t.csv", b"x_m,y_m\n1,2\n", "no column height_m"),
        ("t.csv", b"x_m,y_m,height_m,slope\n1,2,3,4\n", "'slope' is no column"),
        ("t.csv", b"x_m,y_m,height_m\n0,0,1\n1,0,1\n2.5,0,1\n0,1,1\n", "at least 3|even steps"),
        ("t.csv", b"x_m,y_m,height_m\n0,0,high\n", "high"),
        ("t.asc", b"ncols 1e400\nnrows 3\ncellsize 1\n1 2 3\n", "give counts"),
        ("t.csv", b"x_m,y_m,height_m\n0,0,1,9\n", "line 2: 4 fields"),
        ("t.csv", b"x_m,y_m,height_m\n0,0,1\n,0,1\n", "row 2: x_m or y_m is missing"),
        ("t.csv", b"", "is empty"),
    ],
)
def test_broken_files_are_named(tmp_path: Path, longji_soil: Soil, name: str, content: bytes, hint: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=hint) as caught:
        read_terrain(path, longji_soil)
    assert name in str(caught.value)


def test_a_node_twice_is_no_node(tmp_path: Path, longji_soil: Soil) -> None:
    path = table(tmp_path / "t.csv")
    path.write_text(path.read_text() + "100.25,50.25,1.0\n")
    with pytest.raises(DataError, match="two rows"):
        read_terrain(path, longji_soil)


def test_a_missing_file_says_so(tmp_path: Path, longji_soil: Soil) -> None:
    for name in ("t.asc", "t.csv", "t.npz", "t.tif"):
        with pytest.raises(DataError, match=name):
            read_terrain(tmp_path / name, longji_soil)


MOON = "+proj=eqc +lat_ts=0 +lon_0=0 +R=1737400 +units=m"


def test_the_coordinate_system_is_kept(tmp_path: Path, longji_soil: Soil) -> None:
    rasterio = pytest.importorskip("rasterio")
    file = geotiff(tmp_path / "t.tif", np.tile(HEIGHT, (5, 5)), crs=MOON)
    ground = read_terrain(file, longji_soil)
    with rasterio.open(file) as raster:
        assert ground.crs == raster.crs.to_wkt() != ""
    write_terrain(ground, tmp_path / "t.npz")
    assert read_terrain(tmp_path / "t.npz", longji_soil).crs == ground.crs
    rover = build_rover("yutu2")
    surface = assess(ground, ground_maps(ground, 1.5, 1.0), read_mobility(read_rover("yutu2"), rover))
    (tmp_path / "maps.tif").write_bytes(maps_geotiff(surface))
    with rasterio.open(file) as heights, rasterio.open(tmp_path / "maps.tif") as maps:
        assert (maps.crs, maps.transform, maps.shape) == (heights.crs, heights.transform, heights.shape)
    (tmp_path / "maps.npz").write_bytes(maps_bytes(surface))
    with np.load(tmp_path / "maps.npz") as archive:
        assert str(archive["crs"]) == ground.crs


def test_counts_of_an_orbital_grid_become_metres(tmp_path: Path, longji_soil: Soil) -> None:
    """As LOLA's grids: 16-bit counts of half a metre, here about 1000 m; -32768 has no data."""
    rasterio = pytest.importorskip("rasterio")
    counts = np.arange(30, dtype="int16").reshape(5, 6)
    counts[0, 0] = -32768
    where = {"transform": rasterio.transform.from_origin(0.0, 50.0, 10.0, 10.0), "crs": MOON, "nodata": -32768}
    with rasterio.open(
        tmp_path / "l.tif", "w", driver="GTiff", height=5, width=6, count=1, dtype="int16", **where
    ) as raster:
        raster.write(counts, 1)
        raster.scales, raster.offsets = (0.5,), (1000.0,)
    height = read_terrain(tmp_path / "l.tif", longji_soil).height_m
    assert np.isnan(height[-1, 0]) and np.isnan(height).sum() == 1
    assert height[-1, 1:] == pytest.approx(1000.0 + 0.5 * np.arange(1, 6))


PLAN = """{crs}
[start]
x_m = {x}
y_m = {y}
heading_deg = {heading}
[drive]
speed_m_s = 0.05
[[leg]]
length_m = 3.0
[[keep_out]]
name = "rock"
x_m = {x}
y_m = {zone}
radius_m = 1.0
"""


@pytest.mark.parametrize("named", [True, False], ids=["with its system", "without"])
def test_a_plan_in_the_file_s_own_x_and_y_is_taken_along(named: bool, tmp_path: Path, longji_soil: Soil) -> None:
    """At 60 deg a map metre to the east is half of one: north-east of the map, 45 deg, is atan(1 / 0.5) on the ground.

    A circle 10 m to the north of the start stays there.
    """
    rasterio = pytest.importorskip("rasterio")
    x, y = 100_000.0, np.radians(60.0) * 1_737_400.0
    where = rasterio.transform.from_origin(x - 250.0, y + 250.0, 5.0, 5.0)
    dem = geotiff(tmp_path / "e.tif", np.zeros((100, 100)), crs=MOON, transform=where)
    crs = f"crs = '{rasterio.crs.CRS.from_user_input(MOON).to_wkt()}'" if named else ""
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.format(crs=crs, x=x, y=y, heading=45.0, zone=y + 10.0))
    with pytest.warns(LunarSciWarning, match=r"x and y are of .* are taken to those of the terrain"):
        known = read_drive_inputs(plan, None, str(dem))
    ground, moved = known.terrain, known.plan
    assert read_drive_inputs(None, None, str(dem)).terrain.crs == ground.crs == moved.crs
    assert (moved.x_m, moved.y_m) == pytest.approx((0.0, 0.0), abs=0.05)
    assert moved.heading_deg == pytest.approx(np.degrees(np.arctan2(1.0, 0.5)), abs=0.01)
    assert moved.exclusion_zones[0].y_m - moved.y_m == pytest.approx(10.0, abs=1e-3)
    with pytest.raises(ParameterError, match=r"outside the map, .* of 'stereographic about .*, 60\.0000 deg'"):
        find_path(str(dem), start=(x, y, 45.0), target=(0.0, 0.0))
    plan.write_text(PLAN.format(crs="", x=5.0, y=5.0, heading=45.0, zone=15.0))
    assert read_drive_inputs(plan, None, str(dem)).plan.heading_deg == 45.0, "on the ground as it is: as written"
    earth = rasterio.crs.CRS.from_user_input("EPSG:32633").to_wkt()
    plan.write_text(PLAN.format(crs=f"crs = '{earth}'", x=500_000.0, y=5e6, heading=0.0, zone=5e6))
    with pytest.raises(RequestError, match="are of two bodies; plan on this terrain"):
        read_drive_inputs(plan, None, str(dem))


def test_the_unit_of_an_option_is_that_of_the_ground(tmp_path: Path, longji_soil: Soil) -> None:
    """A rise of 0.02 a node of 0.5 m, in ft: tan 0.04 x 0.3048."""
    rows = 0.02 * np.arange(40.0)[None, :] * np.ones((40, 1))
    dem = geotiff(tmp_path / "t.tif", rows)
    units: list[tuple[HeightUnit | None, float]] = [("ft", 0.3048), ("cm", 0.01), (None, 1.0)]
    for unit, metres in units:
        driven, seen = (
            read_drive_inputs(None, None, str(dem), height_unit=unit),
            terrain(str(dem), height_unit=unit),
        )
        ground = driven.terrain.height_m
        assert ground[0, 1] - ground[0, 0] == pytest.approx(0.02 * metres, rel=1e-5)
        steepest = np.degrees(np.arctan(0.04 * metres))
        assert seen.to_dict()["maps"]["slope_deg"]["max"] == pytest.approx(steepest, rel=1e-3)
        assert len(driven.about()["read_as"]) == len(seen.to_dict()["read_as"]) == 1
    with pytest.raises(RequestError, match="`height_unit` does not apply to synthetic-longji"):
        read_drive_inputs(None, None, None, height_unit="km")
    with pytest.raises(RequestError, match="`height_unit` does not apply to synthetic"):
        terrain("synthetic", height_unit="km")


def test_a_text_that_is_no_coordinate_system_is_named(tmp_path: Path, longji_soil: Soil) -> None:
    pytest.importorskip("rasterio")
    axis = 0.5 * np.arange(20)
    np.savez(tmp_path / "t.npz", x_m=axis, y_m=axis, height_m=np.zeros((20, 20)), crs="somewhere")
    with pytest.raises(DataError, match=r"t\.npz: not a coordinate system"):
        read_terrain(tmp_path / "t.npz", longji_soil)
