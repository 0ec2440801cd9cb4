"""Terrain: exact interpolation, files good and hostile, and the synthetic stand-in against the published numbers."""

import dataclasses
import io
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from lunarsci.errors import DataError, OutputError, ParameterError
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.synthetic import CRATERS, crater_height, synthetic_longji
from lunarsci.twin.ground.terrain import (
    Grid,
    Terrain,
    build_terrain,
    lay_soil,
    read_ground,
    read_terrain,
    soil_override,
    write_terrain,
)
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
    write_terrain(ground, tmp_path / "t.npz")
    back = read_terrain(tmp_path / "t.npz", longji_soil)
    assert back.synthetic and back.name == ground.name and back.spacing_m == pytest.approx(0.2)
    assert np.array_equal(back.height_m, ground.height_m, equal_nan=True)
    assert np.allclose(back.soil, ground.soil, rtol=1e-12)
    write_terrain(synthetic_longji(spacing_m=0.2), tmp_path / "uniform.npz")
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
    with pytest.raises(OutputError):
        write_terrain(plane(longji_soil), tmp_path / "no" / "t.npz")


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
