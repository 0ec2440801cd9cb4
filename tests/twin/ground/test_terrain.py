"""Terrain: exact interpolation, files good and hostile, and the synthetic stand-in against the published numbers.

Elevation models of other programs: the same ground from every format, and files that cannot be.

Heights that are likely of another unit, or without data and not named so.
"""

import dataclasses
import io
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.heights import HeightUnit
from lunarsci.images.elevation import read_elevation
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import assess, ground_maps, maps_bytes, maps_geotiff, read_mobility
from lunarsci.twin.ground.synthetic import CRATERS, crater_height, synthetic_longji
from lunarsci.twin.ground.terrain import (
    Grid,
    Terrain,
    build_terrain,
    lay_soil,
    read_ground,
    read_terrain,
    soil_override,
    terrain_bytes,
)
from lunarsci.twin.jobs.drive_inputs import read_drive_inputs
from lunarsci.twin.jobs.plan import plan as find_path
from lunarsci.twin.jobs.terrain import terrain
from lunarsci.twin.lanes import FINISHED, GROUP, HOLE, LEFT, WHEEL, new_work
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.rover import build_rover

NOTHING = np.full(8, np.nan)


def read_node(grid: Grid, x: float, y: float, override: np.ndarray, node: np.ndarray) -> int:
    """Height, gradient and soil (11) at a point, as every lane sees them, and what became of the rover there."""
    work = new_work(1)
    rows, every = work.wheels[0].reshape(-1, GROUP), np.tile(override, (GROUP, 1))
    center, ground = WHEEL.first["center"], WHEEL.first["ground"]
    rows[center], rows[center + 1] = x, y
    lay_soil(grid, every, work.wheels[0])
    read_ground(grid, every, work.wheels[0], work.code)
    assert (work.code == work.code[0]).all()
    assert (rows[ground : ground + 11] == rows[ground : ground + 11, :1]).all()
    node[:] = rows[ground : ground + 11, 0]
    return int(work.code[0])


def plane(soil: Soil, a: float = 0.1, b: float = -0.2, c: float = 3.0) -> Terrain:
    x, y = 1.0 + 0.25 * np.arange(9), -2.0 + 0.25 * np.arange(13)
    return build_terrain("plane", 1.0, -2.0, 0.25, a * x[None, :] + b * y[:, None] + c, soil)


def test_a_plane_is_interpolated_exactly(longji_soil: Soil) -> None:
    grid, node = plane(longji_soil).grid(), np.zeros(11)
    random = np.random.default_rng(1)
    for x, y in zip(1.0 + 2.0 * random.random(50), -2.0 + 3.0 * random.random(50), strict=True):
        assert read_node(grid, x, y, NOTHING, node) == FINISHED
        assert node[:3] == pytest.approx([0.1 * x - 0.2 * y + 3.0, 0.1, -0.2], abs=1e-12)
        assert node[3:] == pytest.approx(longji_soil.vector(), rel=1e-14)


def test_the_corners_belong_to_the_map_and_beyond_it_is_nothing(longji_soil: Soil) -> None:
    grid, node = plane(longji_soil).grid(), np.zeros(11)
    for x, y in ((1.0, -2.0), (3.0, 1.0)):
        assert read_node(grid, x, y, NOTHING, node) == FINISHED
        assert node[0] == pytest.approx(0.1 * x - 0.2 * y + 3.0)
    for x, y in ((0.999, 0.0), (3.001, 0.0), (2.0, -2.001), (2.0, 1.001), (math.nan, 0.0), (math.inf, 0.0)):
        assert read_node(grid, x, y, NOTHING, node) == LEFT


@pytest.mark.parametrize("interpolation", ["smooth", "triangles"])
def test_a_plane_is_a_plane_to_its_edges(longji_soil: Soil, interpolation: str) -> None:
    ground = dataclasses.replace(plane(longji_soil), interpolation=interpolation)
    x, y = np.meshgrid(np.linspace(1.0, 3.0, 41), np.linspace(-2.0, 1.0, 47))
    surface = ground.surface_at(x, y)
    assert np.allclose(surface, np.stack([0.1 * x - 0.2 * y + 3.0, 0.1 + 0 * x, -0.2 + 0 * y], axis=-1), atol=1e-12)
    assert np.isnan(ground.height_at([0.9, 2.0], [0.0, 1.1])).all()


def test_the_smooth_surface_is_a_catmull_rom_spline_with_its_own_gradient(longji_soil: Soil) -> None:
    """Against scipy's cubic Hermite spline through central differences, and against differences of the heights."""
    random = np.random.default_rng(5)
    height = random.normal(size=(8, 9))
    ground = build_terrain("rough", 0.0, 0.0, 0.5, height, longji_soil)
    x = np.linspace(0.5, 3.5, 61)
    row = CubicHermiteSpline(ground.x_m, height[3], np.gradient(height[3], 0.5))
    assert ground.height_at(x, 1.5) == pytest.approx(row(x), abs=1e-12)
    assert ground.surface_at(x, 1.5)[:, 1] == pytest.approx(row(x, 1), abs=1e-12)
    px, py = 4.0 * random.random(200), 3.5 * random.random(200)
    h = 1e-6
    inside = (px > h) & (px < 4.0 - h) & (py > h) & (py < 3.5 - h)
    px, py = px[inside], py[inside]
    surface = ground.surface_at(px, py)
    along = (ground.height_at(px + h, py) - ground.height_at(px - h, py)) / (2 * h)
    across = (ground.height_at(px, py + h) - ground.height_at(px, py - h)) / (2 * h)
    assert surface[:, 1] == pytest.approx(along, abs=1e-6)
    assert surface[:, 2] == pytest.approx(across, abs=1e-6)
    # The gradient does not jump where cells meet.
    for k in range(1, 8):
        left, right = ground.surface_at([0.5 * k - 1e-9, 0.5 * k + 1e-9], [1.23, 1.23])
        assert left == pytest.approx(right, abs=1e-6)


def test_triangles_are_planes_through_three_nodes(longji_soil: Soil) -> None:
    """By hand: the raised node is the upper right corner of the cell, so both planes of the cell end in it."""
    height = np.zeros((5, 5))
    height[2, 2] = 8.0
    ground = dataclasses.replace(build_terrain("peak", 0.0, 0.0, 1.0, height, longji_soil), interpolation="triangles")
    assert ground.surface_at(1.75, 1.25) == pytest.approx([8.0 * 0.25, 0.0, 8.0])
    assert ground.surface_at(1.25, 1.75) == pytest.approx([8.0 * 0.25, 8.0, 0.0])
    with pytest.raises(ParameterError, match="smooth, triangles"):
        dataclasses.replace(ground, interpolation="bilinear")


def test_holes_are_holes(longji_soil: Soil) -> None:
    height = np.zeros((9, 9))
    height[4, 4] = np.nan
    grid, node = build_terrain("hole", 0.0, 0.0, 1.0, height, longji_soil).grid(), np.zeros(11)
    assert read_node(grid, 3.5, 3.5, NOTHING, node) == HOLE
    assert read_node(grid, 1.5, 1.5, NOTHING, node) == FINISHED


def test_soil_can_be_changed_at_every_node_at_some_or_for_a_member(longji_soil: Soil) -> None:
    ground = plane(longji_soil)
    phi = np.full(ground.height_m.shape, 30.0)
    phi[:, 5:] = 40.0
    node = np.zeros(11)
    read_node(ground.with_soil(friction_angle_deg=phi).grid(), 1.1, 0.0, NOTHING, node)
    assert node[7] == pytest.approx(math.tan(math.radians(30.0)))
    read_node(ground.with_soil(lateral_modulus_mm=13.0).grid(), 1.1, 0.0, NOTHING, node)
    assert node[10] == pytest.approx(0.013)
    read_node(ground.grid(), 1.1, 0.0, soil_override({"stiffness_kpa_m_n": 556.7}), node)
    assert node[3] == pytest.approx(556.7e3) and node[10] == pytest.approx(longji_soil.lateral_modulus_mm * 1e-3)
    for values, text in (({"fiction_deg": 1.0}, "friction_angle_deg"), ({"cohesion_pa": -1.0}, "cohesion_pa")):
        with pytest.raises(ParameterError, match=text):
            ground.with_soil(**values)


def test_a_file_comes_back_as_it_was_written(tmp_path: Path, longji_soil: Soil) -> None:
    ground = synthetic_longji(spacing_m=0.2)
    ground.height_m[3:5, 6:9] = np.nan
    ground = ground.with_soil(
        friction_angle_deg=np.linspace(20, 50, ground.height_m.size).reshape(ground.height_m.shape)
    )
    (tmp_path / "t.npz").write_bytes(terrain_bytes(ground))
    back = read_terrain(tmp_path / "t.npz", longji_soil)
    assert back.synthetic and back.name == ground.name and back.spacing_m == pytest.approx(0.2)
    assert np.array_equal(back.height_m, ground.height_m, equal_nan=True)
    assert np.allclose(back.soil, ground.soil, rtol=1e-12)
    (tmp_path / "uniform.npz").write_bytes(terrain_bytes(synthetic_longji(spacing_m=0.2)))
    assert read_terrain(tmp_path / "uniform.npz", longji_soil).soil.shape == (1, 1, 8)


def test_a_file_without_soil_takes_the_soil_given(tmp_path: Path, longji_soil: Soil) -> None:
    np.savez(tmp_path / "t.npz", x_m=np.arange(4.0), y_m=np.arange(3.0), height_m=np.zeros((3, 4)), cohesion_pa=170.0)
    ground = read_terrain(tmp_path / "t.npz", longji_soil)
    assert ground.soil[0, 0] == pytest.approx(longji_soil.replace(cohesion_pa=170.0).vector())
    assert not ground.synthetic


GOOD = {"x_m": np.arange(4.0), "y_m": np.arange(3.0), "height_m": np.zeros((3, 4))}
HOSTILE = {
    "no height": {"x_m": GOOD["x_m"], "y_m": GOOD["y_m"]},
    "shape": GOOD | {"height_m": np.zeros((4, 3))},
    "descending": GOOD | {"x_m": -np.arange(4.0)},
    "uneven": GOOD | {"x_m": np.array([0.0, 1.0, 2.5, 3.0])},
    "two spacings": GOOD | {"y_m": 2 * np.arange(3.0)},
    "nan axis": GOOD | {"x_m": np.full(4, np.nan)},
    "infinite": GOOD | {"height_m": np.full((3, 4), np.inf)},
    "nothing known": GOOD | {"height_m": np.full((3, 4), np.nan)},
    "text": GOOD | {"height_m": np.full((3, 4), "high")},
    "complex": GOOD | {"name": np.zeros(0), "cohesion_pa": np.zeros((2, 2))},
    "soil": GOOD | {"friction_angle_deg": 95.0},
    "soil nan": GOOD | {"cohesion_pa": np.full((3, 4), np.nan)},
    "typo": GOOD | {"heigth_m": np.zeros((3, 4))},
    "pickle": GOOD | {"name": np.array([{"a": 1}], dtype=object)},
    "tiny": {"x_m": np.arange(2.0), "y_m": np.arange(2.0), "height_m": np.zeros((2, 2))},
    "empty": {"x_m": np.zeros(0), "y_m": np.zeros(0), "height_m": np.zeros((0, 0))},
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_file_is_one_line_that_names_it(tmp_path: Path, longji_soil: Soil, case: str) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, **HOSTILE[case])
    with pytest.raises(DataError) as caught:
        read_terrain(path, longji_soil)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_what_is_no_archive_is_refused(tmp_path: Path, longji_soil: Soil) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, **GOOD)
    single = io.BytesIO()
    np.save(single, np.zeros(3))
    for content in (b"", b"hello", buffer.getvalue()[:200], single.getvalue(), b"PK\x03\x04" + bytes(50)):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(DataError, match=r"bad\.npz"):
            read_terrain(tmp_path / "bad.npz", longji_soil)
    for path in (tmp_path / "none.npz", tmp_path):
        with pytest.raises(DataError):
            read_terrain(path, longji_soil)


def slopes_along_the_plan(ground: Terrain) -> np.ndarray:
    """Tilt of the least-squares plane through 1 m x 1 m about each point of the planned path. [deg]"""
    plan, result = read_plan(), []
    schedule = make_schedule(plan, build_rover("yutu2"))
    for x, y, _ in schedule.pose_at(np.linspace(0.0, schedule.duration_s, 99)):
        rows, columns = np.abs(ground.y_m - y) <= 0.5, np.abs(ground.x_m - x) <= 0.5
        px, py = np.meshgrid(ground.x_m[columns] - x, ground.y_m[rows] - y)
        matrix = np.column_stack([px.ravel(), py.ravel(), np.ones(px.size)])
        fit = np.linalg.lstsq(matrix, ground.height_m[np.ix_(rows, columns)].ravel(), rcond=None)[0]
        result.append(math.degrees(math.atan(math.hypot(fit[0], fit[1]))))
    return np.array(result)


@pytest.mark.parametrize("seed", [41, 1, 2])
def test_the_stand_in_has_the_published_slopes_along_the_route(seed: int) -> None:
    """Ding et al. (2024): 8.86 deg at maximum, 5.38 deg at the end."""
    slope = slopes_along_the_plan(synthetic_longji(seed=seed))
    assert slope.max() == pytest.approx(8.86, abs=1.0)
    assert slope[-1] == pytest.approx(5.38, abs=0.6)


def test_the_stand_in_has_the_published_craters_and_says_it_is_synthetic() -> None:
    assert sorted(diameter for *_, diameter in CRATERS) == [6.1, 7.5, 11.2]
    radius = np.linspace(0.0, 20.0, 20001)
    for _, _, diameter in CRATERS:
        profile = crater_height(radius, diameter)
        assert 2 * radius[profile.argmax()] == pytest.approx(diameter, abs=0.01)
        assert (profile.max() - profile.min()) / diameter == pytest.approx(0.06, rel=1e-6)
    ground = synthetic_longji(spacing_m=0.2)
    assert ground.synthetic and "synthetic" in ground.name
    assert np.array_equal(ground.height_m, synthetic_longji(spacing_m=0.2).height_m)
    for bad in ({"spacing_m": 0.0}, {"rms_m": math.nan}, {"seed": -1}):
        with pytest.raises(ParameterError):
            synthetic_longji(**bad)


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
    (tmp_path / "t.npz").write_bytes(terrain_bytes(ground))
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


SPACING = 0.5
READERS: dict[str, Callable[[Path], Any]] = {
    "the twin": lambda path: read_terrain(path, read_soil("longji")),
    "pictures": read_elevation,
}
every_reader = pytest.mark.parametrize("read", READERS.values(), ids=list(READERS))


def asc(folder: Path, height: np.ndarray) -> Path:
    path = folder / "ground.asc"
    rows = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in height)
    ny, nx = height.shape
    path.write_text(f"ncols {nx}\nnrows {ny}\nxllcorner 0\nyllcorner 0\ncellsize {SPACING}\n{rows}\n")
    return path


@every_reader
@pytest.mark.parametrize(("slope_deg", "warned"), [(49.0, False), (51.0, True)])
def test_ground_steeper_than_any_soil_is_warned_of(
    read: Callable[[Path], Any], tmp_path: Path, slope_deg: float, warned: bool
) -> None:
    plane = np.tan(np.radians(slope_deg)) * SPACING * np.add.outer(0.6 * np.arange(12), 0.8 * np.arange(9))
    path = asc(tmp_path, plane)
    if not warned:
        read(path)
        return
    with pytest.warns(LunarSciWarning, match=r"median slope of 51 deg .* heights in another unit"):
        read(path)


@every_reader
@pytest.mark.parametrize(("spacings", "nodes"), [(9.9, 0), (10.1, 1), (100.1, 5)])
def test_steps_are_counted_by_their_nodes(
    read: Callable[[Path], Any], tmp_path: Path, spacings: float, nodes: int
) -> None:
    height = np.zeros((8, 9))
    height[3, 4] = spacings * SPACING
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read(asc(tmp_path, height))
    assert [f"off one: {nodes};" in str(item.message) for item in caught] == [True] * bool(nodes)


@every_reader
@pytest.mark.filterwarnings("error")
def test_a_wall_is_not_told(read: Callable[[Path], Any], tmp_path: Path) -> None:
    wall = np.where(np.arange(40) < 20, 0.0, 20.0 * SPACING) * np.ones((8, 1))
    assert read(asc(tmp_path, wall)).height_m.max() == 20.0 * SPACING
