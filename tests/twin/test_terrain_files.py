"""Elevation models of other programs: the same ground from every format, and files that cannot be."""

from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.terrain_files import read_terrain

HEIGHT = np.arange(20.0).reshape(4, 5) ** 1.5 / 10
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


def test_rasters_that_do_not_fit_are_refused_with_a_way_out(tmp_path: Path, longji_soil: Soil) -> None:
    rasterio = pytest.importorskip("rasterio")
    oblong = rasterio.transform.from_origin(0.0, 0.0, 0.5, 0.7)
    turned = rasterio.transform.Affine(0.5, 0.1, 0.0, 0.1, -0.5, 0.0)
    for changes, hint in (
        ({"crs": "EPSG:4326"}, "project it to m"),
        ({"crs": "EPSG:2263"}, "project it to m"),
        ({"transform": oblong}, "resample"),
        ({"transform": turned}, "rotated"),
    ):
        with pytest.raises(DataError, match=hint):
            read_terrain(geotiff(tmp_path / "t.tif", **changes), longji_soil)


@pytest.mark.parametrize(
    ("name", "content", "hint"),
    [
        ("t.tif", b"II*\0 cut short", "not a GeoTIFF"),
        ("t.asc", b"ncols 3\nnrows 3\ncellsize 1\n1 2 3\n4 5 6\n", "cut short"),
        ("t.asc", b"1 2 3\n4 5 6\n", "begins with ncols"),
        ("t.asc", b"ncols 3\nnrows 1\ncellsize 1\n1 two 3\n", "two"),
        ("t.asc", b"\xff\xfe\x00\x01", "decode"),
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
