"""Maps of slope, roughness and steps against planes, waves, walls and least squares by hand.

Ground to keep out of: files, maps, plans and predictions.

Layers of costs and classes, shadow on the way, and what comes and goes as GeoJSON, beside plain geometry.

Circles that the rover must not enter.
"""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import (
    TILE,
    ExclusionZone,
    Mobility,
    assess,
    ground_maps,
    map_scales,
    near_way,
    parse_classes,
    read_cost_layer,
    read_keep_outs,
    read_mobility,
    rover_outline,
    travel_cost,
)
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain, terrain_bytes
from lunarsci.twin.jobs.plan import plan
from lunarsci.twin.jobs.terrain import terrain
from lunarsci.twin.judgement.quantities import exclusion_distance
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.plans.plan import Leg, Limit, Plan, parse_plan, plan_text, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction

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


PLAN = Plan(name="ahead", legs=(Leg(2.0, 0.0),), speed_m_s=0.05)


def geojson(*features: dict[str, object]) -> InputFile:
    return InputFile("rocks.geojson", json.dumps({"type": "FeatureCollection", "features": list(features)}).encode())


def polygon(ring: list[list[float]], **own: object) -> dict[str, object]:
    return {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [ring]}, "properties": own}


def test_rocks_points_and_polygons_are_read() -> None:
    turns = np.linspace(0, 2 * math.pi, 25)
    ring = [[3 + 0.5 * math.cos(t), 1 + 0.5 * math.sin(t)] for t in turns]
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {"radius_m": 0.3}}
    rock = polygon(ring, id=7, x_m=3.0, y_m=1.0, keepout_m=0.49)
    found = read_keep_outs(geojson(rock, polygon(ring, name="crater"), point))
    assert found[0] == ExclusionZone("rock 7", 3.0, 1.0, 0.49)
    assert found[1].name == "crater" and found[1].radius_m == pytest.approx(0.5)
    assert found[2] == ExclusionZone("keep-out 3", 1.0, 2.0, 0.3)


def test_a_rock_that_wheels_climb_in_all_likelihood_is_ground() -> None:
    """Of 5 cm, of 10 cm give or take 6, of 25 cm, and one of which no height is stated."""
    heights = ({"height_m": h, "height_m_sigma": s} for h, s in ((0.05, 0.01), (0.1, 0.06), (0.25, 0.01)))
    rocks = [
        polygon([[0, 0]], id=k, x_m=float(k), y_m=0.0, keepout_m=0.2, **height)
        for k, height in enumerate((*heights, {}), 1)
    ]
    every, high = (read_keep_outs(geojson(*rocks), climbs_m=climbs) for climbs in (0.0, 0.2))
    assert len(every) == 4 and [zone.name for zone in high] == ["rock 2", "rock 3", "rock 4"]


def test_what_is_not_round_is_covered_by_circles_that_hold_it() -> None:
    """An L of two arms of 4 m x 0.4 m: every point of it lies in a circle, and no circle reaches far beyond."""
    ring = [[0.0, 0.0], [4.0, 0.0], [4.0, 0.4], [0.4, 0.4], [0.4, 4.0], [0.0, 4.0], [0.0, 0.0]]
    zones = read_keep_outs(geojson(polygon(ring)))
    x, y = np.meshgrid(np.linspace(0, 4, 161), np.linspace(0, 4, 161))
    away = np.min([np.hypot(x - z.x_m, y - z.y_m) - z.radius_m for z in zones], axis=0)
    inside = (y <= 0.4) | (x <= 0.4)
    assert (away[inside] <= 1e-9).all()
    assert (away[(y > 1.0) & (x > 1.0)] > 0).all() and 10 < len(zones) < 500


def test_files_that_are_none_are_refused_with_the_feature_named() -> None:
    line = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[0, 0], [1, 1]]}, "properties": {}}
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {}}
    for file, says in (
        (InputFile("a.geojson", b"[]"), "FeatureCollection"),
        (InputFile("a.geojson", b"nonsense"), "a.geojson"),
        (geojson(line), "feature 1.*LineString"),
        (geojson(point), "feature 1"),
        (geojson({"type": "Feature"}), "no geometry"),
        (geojson(polygon([[0, 0], [1, 1]])), "three corners"),
    ):
        with pytest.raises(DataError, match=says):
            read_keep_outs(file)


def test_a_drive_into_a_rock_is_named_with_place_and_margin(tmp_path: Path) -> None:
    """A rock of 10 cm that the left wheels roll over, whose edge is 0.475 m from the middle of the rover."""
    path = tmp_path / "rocks.geojson"
    rocks = [
        polygon([[0, 0]], id=k, x_m=x, y_m=y, keepout_m=0.1) for k, x, y in ((1, 1.5, 0.4), (2, 1.5, -2.0), (3, 30, 0))
    ]
    path.write_bytes(geojson(*rocks).data)
    found = lunarsci.predict(PLAN, soil=("longji",), sweep=("friction_angle_deg=35:39:2",), keep_out=(str(path),))
    half, verdict = 0.525, found.verdict
    assert len(found.prediction.plan.exclusion_zones) == 2 and verdict.verdict == "no-go"
    entered, other = verdict.keep_outs
    assert (entered.name, entered.entered_by) == ("rock 1", 2) and other.margin_m == pytest.approx(
        2 - half - 0.1, abs=0.02
    )
    # The rock's middle is below the rover then.
    assert entered.margin_m == pytest.approx(-0.1, abs=1e-6) and 0.3 < entered.distance_m <= 2.0
    assert any("'rock 1' at x 1.50 m, y 0.40 m is entered by 2 of 2 drives" in reason for reason in verdict.reasons)
    assert found.to_dict()["keep_outs"][0]["name"] == "rock 1"
    assert str(path) in found.made_from.inputs


def test_a_path_goes_around_and_its_plan_keeps_the_circles(tmp_path: Path) -> None:
    path = tmp_path / "rocks.geojson"
    path.write_bytes(geojson(polygon([[0, 0]], id=1, x_m=2.5, y_m=0.0, keepout_m=0.2)).data)
    asked = {"extent": 10.0, "craters": 0, "roughness": 0.0, "rocks": 0.0}
    survey = terrain("synthetic", **asked, keep_out=(str(path),))
    ground = survey.surface.terrain
    row, column = (round((at - low) / ground.spacing_m) for at, low in ((0.0, ground.y0_m), (2.5, ground.x0_m)))
    assert survey.surface.hazard[row, column] and "rock 1" in survey.surface.reason(row, column)
    free, around = (
        plan("synthetic", target=(4.0, 0.0), start=(0.0, 0.0, 0.0), **asked, keep_out=files).path
        for files in ((), (str(path),))
    )
    assert free is not None and around is not None
    assert not free.plan.exclusion_zones and around.plan.length_m > free.plan.length_m + 0.02
    assert around.plan.exclusion_zones == (ExclusionZone("rock 1", 2.5, 0.0, 0.2),)
    assert parse_plan(plan_text(around.plan), "again").exclusion_zones == around.plan.exclusion_zones
    (ground_file := tmp_path / "ground.npz").write_bytes(survey.site.content())
    assert lunarsci.predict(
        around.plan, terrain=str(ground_file), sweep=("friction_angle_deg=36:37:2",)
    ).verdict.keep_outs
    with pytest.raises(ParameterError, match="rock 1"):
        plan("synthetic", target=(2.5, 0.0), start=(0.0, 0.0, 0.0), **asked, keep_out=(str(path),))


def test_circles_far_from_the_way_are_left_out() -> None:
    zones = (ExclusionZone("a", 0.0, 2.0, 0.1), ExclusionZone("b", 0.0, 9.0, 0.1))
    assert near_way(zones, np.zeros((1, 2))) == zones[:1]


AXIS = np.arange(-10.0, 10.05, 0.1)
MOON_M = 1_737_400.0
MOON = f"+proj=eqc +lat_ts=0 +lon_0=0 +R={MOON_M} +units=m"


def layered_ground(folder: Path, height: np.ndarray | None = None) -> str:
    shape = (AXIS.size, AXIS.size)
    flat = np.zeros(shape) if height is None else height
    terrain = build_terrain("flat", -10.0, -10.0, 0.1, flat, read_soil("longji"))
    (folder / "flat.npz").write_bytes(terrain_bytes(terrain))
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
    terrain = layered_ground(tmp_path)
    layer = raster(tmp_path / "cost.asc", np.full((41, 41), 2.5))
    plain, dear = (planned(terrain, **more).path for more in ({}, {"layer": (layer,)}))
    # Flat ground costs a metre each metre, and each arc 0.1 m.
    assert plain.cost_m == pytest.approx(16.0 + 0.1) and dear.cost_m == pytest.approx(2.5 * 16.0 + 0.1)


def test_a_forbidden_class_is_gone_round_and_named(tmp_path: Path) -> None:
    terrain, classes = layered_ground(tmp_path), np.ones((41, 41))
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
    terrain, costs = layered_ground(tmp_path), np.ones((41, 41))
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
    terrain, sun = layered_ground(tmp_path, height), f"0,{math.degrees(math.atan(1.0 / 3.0))}"
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
    found = planned(layered_ground(tmp_path))
    document = json.loads(found.files()["path.geojson"]())
    assert "m" in document["crs"]["properties"]["name"]
    line, start, target = document["features"]
    assert line["geometry"]["coordinates"][0] == pytest.approx([-8.0, 0.0])
    assert line["geometry"]["coordinates"][-1] == pytest.approx([8.0, 0.0])
    assert [one["properties"]["role"] for one in (start, target)] == ["start", "target"]


def test_hazards_near_the_path_are_polygons_of_their_area(tmp_path: Path) -> None:
    height = np.zeros((AXIS.size, AXIS.size))
    height[np.ix_(AXIS > 4.0, np.abs(AXIS) < 1.0)] = 1.0
    found = planned(layered_ground(tmp_path, height))
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
    with pytest.raises(DataError, match=r"longitude is 711025; .* member 'crs'"):
        bad = {"type": "Point", "coordinates": list(target)}
        feature = {"type": "Feature", "geometry": bad, "properties": {"radius_m": 2.0}}
        content = json.dumps({"type": "FeatureCollection", "features": [feature]}).encode()
        read_keep_outs(InputFile("k.geojson", content), found.site.terrain.crs)
    with pytest.raises(DataError, match="names no coordinate system"):
        planned(layered_ground(tmp_path), lonlat=True)


def at(prediction: Prediction, x: float, y: float, yaw_deg: float) -> Prediction:
    paths = prediction.paths.copy()
    paths[..., :2], paths[..., 5] = (x, y), yaw_deg
    return dataclasses.replace(prediction, paths=paths)


def sides(rover: Rover) -> tuple[float, float, float]:
    outline = rover_outline(rover)
    return outline.rear_m, outline.front_m, outline.half_width_m


def with_circles(prediction: Prediction, *circles: ExclusionZone, limits: tuple[Limit, ...] = ()) -> Prediction:
    return dataclasses.replace(
        prediction, plan=dataclasses.replace(prediction.plan, exclusion_zones=circles, limits=limits)
    )


def test_the_outline_is_that_of_wheels_and_body(yutu2: Rover) -> None:
    """Wheels at x = +-0.5 m, y = +-0.45 m, radius 0.15 m with grousers of 8 mm, width 0.15 m; they enclose the body."""
    assert sides(yutu2) == pytest.approx((-0.658, 0.658, 0.525))
    long = dataclasses.replace(yutu2, body=dataclasses.replace(yutu2.body, length_m=2.0, width_m=1.2))
    assert sides(long) == pytest.approx((-1.0, 1.0, 0.6))


@pytest.mark.parametrize("yaw", [0.0, 37.0, -120.0])
@pytest.mark.parametrize(
    ("ahead", "left", "radius", "distance"),
    [
        (0.2, 0.525 + 0.4, 0.4, 0.0),
        (0.0, -0.525 - 0.5, 0.4, 0.1),
        (-0.658 - 0.7, 0.1, 0.4, 0.3),
        (0.658 + 0.3, 0.525 + 0.4, 0.2, 0.3),
        (0.658 + 0.3, -0.525 - 0.4, 0.5, 0.0),
        (0.1, 0.1, 0.3, -0.3),
        (0.2, 0.525 + 0.1, 0.4, -0.3),
    ],
)
def test_distances_of_known_figures(
    driven: Prediction, yaw: float, ahead: float, left: float, radius: float, distance: float
) -> None:
    turn = np.radians(yaw)
    x, y = 3.0 + np.cos(turn) * ahead - np.sin(turn) * left, 1.0 + np.sin(turn) * ahead + np.cos(turn) * left
    posed = at(driven, 3.0, 1.0, yaw)
    assert exclusion_distance(posed, (ExclusionZone("rock", x, y, radius),)) == pytest.approx(distance, abs=1e-12)


def test_the_distance_is_that_to_the_nearest_point_of_the_outline(driven: Prediction) -> None:
    random = np.random.default_rng(4)
    edge = np.linspace(0.0, 1.0, 4001)[:, None]
    for x, y, yaw in random.uniform((0, 0, -180), (2, 2, 180), (20, 3)):
        corners = rover_outline(driven.rover).corners_m(np.array([x, y, np.radians(yaw)]))
        border = np.concatenate(
            [a + edge * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        )
        place = np.array([x, y]) + 2.0 * np.array([np.cos(5 * yaw), np.sin(5 * yaw)])
        truth = np.hypot(*(border - place).T).min() - 0.25
        circle = ExclusionZone("rock", float(place[0]), float(place[1]), 0.25)
        assert exclusion_distance(at(driven, x, y, yaw), (circle,))[0, 0] == pytest.approx(truth, abs=1e-6)


def test_the_nearest_circle_counts_and_none_is_infinitely_far(driven: Prediction) -> None:
    near, far = ExclusionZone("near", 0.0, 3.0, 0.4), ExclusionZone("far", 0.0, 9.0, 0.4)
    both = exclusion_distance(at(driven, 0.0, 0.0, 0.0), (far, near))
    assert both == pytest.approx(3.0 - 0.4 - 0.525) and np.isinf(exclusion_distance(driven)).all()


def test_a_single_drive_that_enters_is_a_no_go(driven: Prediction) -> None:
    paths = driven.paths.copy()
    paths[..., :2], paths[..., 5] = 0.0, 0.0
    paths[7, 5, 1] = 0.3
    posed = dataclasses.replace(driven, paths=paths)
    touched = judge(with_circles(posed, ExclusionZone("rock", 0.0, 1.2, 0.5)))
    limit = next(one for one in touched.limits if one.quantity == "keep_out_m")
    assert (limit.quantity, limit.sense, limit.limit, limit.exceeding, limit.worst_member) == (
        *("keep_out_m", "at least", 0.0, 1, 7),
    )
    assert limit.min == limit.judged == pytest.approx(1.2 - 0.5 - 0.525 - 0.3) and limit.p05 == pytest.approx(0.175)
    assert touched.verdict == "no-go" and "keep_out_m" in touched.reasons[0] and touched.worst.member == 7
    clear = judge(with_circles(posed, ExclusionZone("rock", 0.0, 1.4, 0.5)))
    assert clear.verdict == "go" and clear.keep_outs[0].margin_m == pytest.approx(0.075)
    wide = Limit("keep_out_m", "m", 0.1, "test", True)
    assert judge(with_circles(posed, ExclusionZone("rock", 0.0, 1.4, 0.5), limits=(wide,))).verdict == "no-go"


DRIVE = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.0\ncurvature_per_m = 0.0\n"
CIRCLE = "[[keep_out]]\nname = 'rock'\nx_m = 1\ny_m = 2.5\nradius_m = 0.5\n"


def test_a_plan_names_its_circles(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(DRIVE + CIRCLE + "[limits]\nkeep_out_m = 0\nclearance_m = 0.1\n")
    plan = read_plan(path)
    assert plan.exclusion_zones == (ExclusionZone("rock", 1.0, 2.5, 0.5),)
    assert [(limit.limit, limit.sense) for limit in plan.limits] == [(0.0, "at least"), (0.1, "at least")]
    for text, says in (
        (DRIVE + CIRCLE.replace("0.5", "0"), "radius_m is 0; give a number above 0"),
        (DRIVE + CIRCLE.replace("x_m = 1\n", ""), "no x_m"),
        (DRIVE + CIRCLE.replace("[[", "[").replace("]]", "]"), "double brackets"),
        (DRIVE + CIRCLE.replace("2.5", "nan"), "finite"),
        (DRIVE + "[limits]\nkeep_out_m = 0.1\n", r"\[\[keep_out\]\]"),
        (DRIVE + CIRCLE + "[limits]\nkeep_out_m = -0.1\n", "keep_out_m"),
    ):
        path.write_text(text)
        with pytest.raises(DataError, match=says):
            read_plan(path)
    with pytest.raises(ParameterError):
        ExclusionZone("rock", 0.0, 0.0, -1.0)
