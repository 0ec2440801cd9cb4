"""Maps of slope, roughness and steps against planes, waves, walls and least squares by hand."""

import dataclasses
import math

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import TILE, Mobility, assess, ground_maps, map_scales, read_mobility, travel_cost
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.rover import Rover, build_rover

SPACING = 0.05
LIMITS = Mobility(max_slope_deg=20.0, max_step_m=0.2, min_turning_radius_m=1.5, hazard_distance_m=0.2)


def ground(height: np.ndarray, soil: Soil, spacing: float = SPACING) -> Terrain:
    return build_terrain("test", 0.0, 0.0, spacing, height, soil)


def axes(ny: int, nx: int) -> tuple[np.ndarray, np.ndarray]:
    return SPACING * np.arange(nx)[None, :], SPACING * np.arange(ny)[:, None]


def fitted(height: np.ndarray, row: int, column: int, half: int) -> tuple[float, float]:
    """Slope [deg] and rms residual of the plane through a window, by numpy's least squares."""
    window = height[row - half : row + half + 1, column - half : column + half + 1]
    i, j = np.meshgrid(*2 * [SPACING * np.arange(-half, half + 1)])
    matrix = np.column_stack([i.ravel(), j.ravel(), np.ones(i.size)])
    fit = np.linalg.lstsq(matrix, window.ravel(), rcond=None)[0]
    residual = window.ravel() - matrix @ fit
    return math.degrees(math.atan(math.hypot(fit[0], fit[1]))), math.sqrt(float(np.mean(residual**2)))


def step_by_hand(height: np.ndarray, row: int, column: int, half: int, wheel: int) -> float:
    """Range within the wheel's window, less the gentler slope of the half footprints on either side."""
    window = height[row - half : row + half + 1, column - half : column + half + 1]
    rise = []
    for table in (window.mean(axis=1), window.mean(axis=0)):
        before, behind = (np.polyfit(np.arange(half + 1), part, 1)[0] for part in (table[: half + 1], table[half:]))
        rise.append(min(before, behind, key=abs) if before * behind > 0 else 0.0)
    i, j = np.meshgrid(*2 * [np.arange(-wheel, wheel + 1)], indexing="ij")
    near = height[row - wheel : row + wheel + 1, column - wheel : column + wheel + 1]
    return float(np.ptp(near - rise[0] * i - rise[1] * j))


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.3, 0.0), (-0.1, 0.25), (1.0, -1.0)])
def test_a_plane_has_its_slope_no_roughness_and_no_step(longji_soil: Soil, a: float, b: float) -> None:
    x, y = axes(60, 90)
    maps = ground_maps(ground(a * x + b * y - 1737.0e3, longji_soil), 1.0, 0.3)
    inner = maps.slope_deg[10:-10, 10:-10]
    assert inner == pytest.approx(math.degrees(math.atan(math.hypot(a, b))), abs=1e-5)
    assert np.nanmax(maps.roughness_m) < 1e-6
    assert np.nanmax(maps.step_m) < 1e-6


def test_windows_that_reach_over_the_edge_are_unknown(longji_soil: Soil) -> None:
    maps = ground_maps(ground(np.zeros((60, 90)), longji_soil), 1.0, 0.3)
    for values, half in ((maps.slope_deg, 10), (maps.roughness_m, 10), (maps.step_m, 10)):
        known = np.zeros((60, 90), dtype=bool)
        known[half:-half, half:-half] = True
        assert np.array_equal(~np.isnan(values), known)


@pytest.mark.parametrize("half", [5, 10])
def test_a_wave_as_long_as_the_window_has_the_residual_of_algebra(longji_soil: Soil, half: int) -> None:
    """Over one period the mean is 0 and the mean square A^2 / 2; what the plane takes away follows from sum(i h)."""
    side, amplitude = 2 * half + 1, 0.02
    phase = 2.0 * math.pi * np.arange(90) / side
    maps = ground_maps(ground(np.tile(amplitude * np.sin(phase), (60, 1)), longji_soil), 2 * half * SPACING, 0.3)
    i = np.arange(-half, half + 1)
    slope = amplitude * np.cos(phase) * (i @ np.sin(2.0 * math.pi * i / side)) / (i @ i)
    residual = np.sqrt(amplitude**2 / 2 - slope**2 * (i @ i) / side)
    inner = slice(half, -half)
    wanted = np.degrees(np.arctan(np.abs(slope) / SPACING))[inner]
    assert maps.slope_deg[30, inner] == pytest.approx(wanted, abs=1e-5)
    assert maps.roughness_m[30, inner] == pytest.approx(residual[inner], rel=1e-5)


def test_a_wave_far_longer_than_the_window_has_its_gradient(longji_soil: Soil) -> None:
    """Amplitude A, wave number k: tan(slope) = A k |cos(k x)|, less by (k b)^2 / 40 for a footprint of side b."""
    k, amplitude = 2.0 * math.pi / 20.0, 0.3
    x, _ = axes(60, 500)
    maps = ground_maps(ground(np.tile(amplitude * np.sin(k * x), (60, 1)), longji_soil), 1.0, 0.3)
    gradient = np.tan(np.radians(maps.slope_deg[30, 10:-10]))
    assert gradient == pytest.approx(amplitude * k * np.abs(np.cos(k * x[0, 10:-10])), abs=amplitude * k * 0.0035)
    assert gradient.max() < amplitude * k


@pytest.mark.parametrize("rise", [0.0, 0.3, -0.3])
def test_a_wall_is_a_step_of_its_height_within_half_a_wheel_also_on_a_slope(longji_soil: Soil, rise: float) -> None:
    x, y = axes(60, 90)
    height = rise * x + 0.1 * y
    height[:, 40:] += 0.37
    step = ground_maps(ground(height, longji_soil), 1.0, 0.3).step_m[30]
    assert step[37:43].min() > 0.9 * 0.37 and step[37:43].max() <= 0.37 + 0.3 * (abs(rise) + 0.1)
    beside = np.concatenate([step[10:37], step[43:-10]])
    assert beside.max() < 1e-6 + (0.0 if rise >= 0 else 0.3 * (abs(rise) + 0.1)) and beside[[0, -1]].max() < 1e-6


@pytest.mark.parametrize("turned", [0.0, 20.0, 45.0, 70.0])
def test_a_wall_and_a_rock_on_a_slope_stand_out_whichever_way_they_run(longji_soil: Soil, turned: float) -> None:
    """By no less than nine tenths of their height, and by no more than with what the slope rises in the window."""
    x, y = axes(60, 90)
    slope = 0.2 * x - 0.15 * y
    aside = math.cos(math.radians(turned)) * (x - 2.0) + math.sin(math.radians(turned)) * (y - 1.5)
    rock = np.hypot(x - 2.0, y - 1.5) < 0.12
    for height in (slope + 0.3 * (aside > 0.01), slope + 0.3 * rock):
        step = ground_maps(ground(height, longji_soil), 1.0, 0.3).step_m
        assert 0.27 < step[30, 40] < 0.3 + 0.35 * 0.3 + 1e-6


@pytest.mark.parametrize("spacing", [0.02, 0.1, 0.3, 1.0, 5.0])
def test_a_plane_is_drivable_as_far_as_its_slope_goes_at_any_spacing(longji_soil: Soil, spacing: float) -> None:
    nodes = spacing * np.arange(120)
    for slope, drivable in ((15.0, True), (19.0, True), (21.0, False)):
        height = math.tan(math.radians(slope)) * (0.8 * nodes[None, :] + 0.6 * nodes[:, None])
        terrain = ground(height, longji_soil, spacing)
        maps = ground_maps(terrain, 1.0, 0.3)
        surface = assess(terrain, maps, LIMITS)
        known = ~surface.unknown
        assert known.any() and (surface.hazard[known] != drivable).all()
        assert maps.shows_steps == (spacing <= 0.3) == (not np.isnan(maps.step_m).all())


def test_a_hole_is_unknown_as_far_as_the_windows_reach_and_no_further(longji_soil: Soil) -> None:
    x, y = axes(80, 90)
    height = 0.1 * x + 0.2 * y
    whole = ground_maps(ground(height, longji_soil), 1.0, 0.3)
    height[40, 50] = np.nan
    maps = ground_maps(ground(height, longji_soil), 1.0, 0.3)
    rows, columns = np.abs(np.arange(80) - 40)[:, None], np.abs(np.arange(90) - 50)[None, :]
    for name, half in (("slope_deg", 10), ("roughness_m", 10), ("step_m", 10)):
        before, after = getattr(whole, name), getattr(maps, name)
        near = np.maximum(rows, columns) <= half
        assert np.array_equal(np.isnan(after), np.isnan(before) | near)
        assert after[~near] == pytest.approx(before[~near], abs=1e-6, nan_ok=True)


def test_rough_ground_agrees_with_least_squares_also_across_tiles(longji_soil: Soil) -> None:
    random = np.random.default_rng(3)
    height = 0.03 * np.cumsum(random.standard_normal((50, 2 * TILE)), axis=1)
    maps = ground_maps(ground(height, longji_soil), 1.0, 0.3)
    for row, column in [(25, c) for c in (10, TILE - 11, TILE - 1, TILE, TILE + 9, 2 * TILE - 11)] + [(12, 300)]:
        slope, rms = fitted(height, row, column, 10)
        assert maps.slope_deg[row, column] == pytest.approx(slope, rel=1e-5)
        assert maps.roughness_m[row, column] == pytest.approx(rms, rel=1e-5)
        assert maps.step_m[row, column] == pytest.approx(step_by_hand(height, row, column, 10, 3), rel=1e-5)


def test_a_grid_coarser_than_the_rover_says_what_it_measures(longji_soil: Soil) -> None:
    x = np.arange(20.0)[None, :]
    maps = ground_maps(ground(np.tile(0.2 * x, (15, 1)), longji_soil, spacing=1.0), 1.0, 0.3)
    assert (maps.baseline_m, maps.wheel_window_m) == (2.0, 2.0)
    assert maps.slope_deg[7, 7] == pytest.approx(math.degrees(math.atan(0.2)))


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, 100.0])
def test_bad_windows_are_refused(longji_soil: Soil, bad: float) -> None:
    with pytest.raises(ParameterError):
        ground_maps(ground(np.zeros((30, 30)), longji_soil), bad, 0.3)


def test_the_scales_are_those_of_the_rover(yutu2: Rover) -> None:
    """Yutu-2 as in its file: axles 1.0 m apart, track 0.9 m, wheels 0.3 m high."""
    assert map_scales(yutu2) == pytest.approx((1.0, 0.3))


def test_the_worst_share_of_a_limit_decides(longji_soil: Soil) -> None:
    x, _ = axes(60, 90)
    height = np.tile(np.tan(np.radians(10.0)) * x, (60, 1))
    height[:, 60:] += 0.3
    terrain = ground(height, longji_soil)
    maps = ground_maps(terrain, 1.0, 0.3)
    surface = assess(terrain, maps, LIMITS)
    assert surface.demand[30, 20] == pytest.approx(0.5, rel=1e-5)
    assert surface.hazard[30, 60] and not surface.hazard[30, 20]
    assert surface.unknown[0, 0] and not surface.hazard[0, 0]
    assert "the step is" in surface.reason(30, 60) and surface.reason(30, 20) == ""
    assert "edge of the map" in surface.reason(0, 0)
    assert not assess(terrain, maps, LIMITS).hazard[30, 20]
    assert assess(terrain, maps, LIMITS.with_limits(max_slope_deg=9.9)).hazard[30, 20]
    rough = assess(terrain, maps, LIMITS.with_limits(max_step_m=5.0, max_slope_deg=80.0, max_roughness_m=0.05))
    assert rough.hazard[30, 60] and "roughness" in rough.reason(30, 60)


def test_the_cost_is_one_on_easy_ground_and_grows_without_bound_but_for_its_cap() -> None:
    demand = np.array([0.0, 0.5, 0.9, 1.0, 3.0, math.nan])
    assert travel_cost(demand) == pytest.approx([1.0, 4 / 3, 1 / 0.19, 100.0, 100.0, 100.0], rel=1e-5)
    assert (np.diff(travel_cost(np.linspace(0.0, 0.99, 100))) > 0).all()


def test_the_limits_of_yutu_2_are_the_published_ones() -> None:
    """Ding et al. (2024): slopes of 20 deg, obstacles of 200 mm."""
    description = read_rover("yutu2")
    mobility = read_mobility(description, build_rover(description))
    assert (mobility.max_slope_deg, mobility.max_step_m, mobility.max_roughness_m) == (20.0, 0.2, None)
    assert mobility.assumed == ("hazard_distance_m", "min_turning_radius_m")
    assert mobility.with_limits(hazard_distance_m=0.4, max_step_m=None).assumed == ("min_turning_radius_m",)


def test_a_rover_without_limits_gets_assumed_ones_and_a_wrong_one_is_refused() -> None:
    description = read_rover("yutu2")
    tables = {name: table for name, table in description.tables.items() if name != "limits"}
    bare = dataclasses.replace(description, tables=tables, assumed=())
    rover = build_rover(bare)
    mobility = read_mobility(bare, rover)
    assert mobility.assumed == ("hazard_distance_m", "max_slope_deg", "max_step_m", "min_turning_radius_m")
    assert (mobility.max_slope_deg, mobility.max_step_m) == (15.0, rover.wheel.radius_m)
    for entry in ({"max_slop_deg": 3.0}, {"max_slope_deg": "steep"}, {"max_slope_deg": -1.0}, {"max_step_m": [1]}):
        wrong = dataclasses.replace(bare, tables=tables | {"limits": entry})
        with pytest.raises(DataError, match=r"yutu2: .*\[limits\]"):
            read_mobility(wrong, rover)


@pytest.mark.parametrize(
    "limit", [{"max_slope_deg": 90.0}, {"max_step_m": 0.0}, {"max_roughness_m": math.nan}, {"hazard_distance_m": -0.1}]
)
def test_impossible_limits_are_refused(limit: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match=next(iter(limit))):
        LIMITS.with_limits(**limit)


def test_the_map_of_the_stand_in_is_that_of_least_squares(longji_soil: Soil) -> None:
    terrain = synthetic_longji(longji_soil)
    maps = ground_maps(terrain, 1.0, 0.3)
    for row, column in ((140, 60), (200, 247), (233, 154)):
        assert maps.slope_deg[row, column] == pytest.approx(fitted(terrain.height_m, row, column, 10)[0], rel=1e-5)
