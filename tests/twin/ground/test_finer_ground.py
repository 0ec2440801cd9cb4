"""Finer terrains in a way over a coarse one: what only they show is gone round, and what they do not cover stays.

Ground between the nodes of a coarse map, and verdicts that hang on it.
"""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import lunarsci
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.regolith.columns import ground_name
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.regolith.wheel import read_wheel
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.finer_ground import (
    driven_ground,
    lunar_relief,
    patch,
    relief_of_kind,
    roughness_of_map,
    unresolved_grain,
    with_unresolved,
)
from lunarsci.twin.ground.hazards import assess, ground_maps, map_scales, read_mobility, rover_footprint
from lunarsci.twin.ground.height_errors import fractal_power
from lunarsci.twin.ground.terrain import Terrain, build_terrain, terrain_bytes
from lunarsci.twin.jobs.predict import predict
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.plans.plan import Leg, Limit, Plan
from lunarsci.twin.rover import build_rover

COARSE_M, FINE_M = 2.0, 0.1
ROCK, RADIUS_M = (50.9, 20.9), 0.5
"""Between four nodes of the coarse grid, and on the straight way."""
WAY: dict[str, Any] = {"start": (10.0, 20.9, 0.0), "target": (90.0, 20.9)}


def ground(
    path: Path, west: float, south: float, size: tuple[int, int], spacing: float, crs: str = "", rocks: Any = (ROCK,)
) -> str:
    """SYNTHETIC flat ground with rocks 0.4 m high, sampled at the nodes."""
    x, y = west + spacing * np.arange(size[0]), south + spacing * np.arange(size[1])
    rock = np.zeros((y.size, x.size), dtype=bool)
    for place in rocks:
        rock |= np.hypot(x[None, :] - place[0], y[:, None] - place[1]) < RADIUS_M
    terrain = build_terrain(path.stem, west, south, spacing, 0.4 * rock, read_soil("longji"), crs=crs)
    path.write_bytes(terrain_bytes(terrain))
    return str(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    folder = tmp_path_factory.mktemp("ground")
    coarse = ground(folder / "orbit.npz", 0.0, 0.0, (51, 21), COARSE_M)
    return coarse, ground(folder / "mast.npz", 40.0, 10.9, (211, 201), FINE_M)


@pytest.fixture(scope="module")
def ways(files: tuple[str, str]) -> tuple[Any, Any]:
    return lunarsci.plan(files[0], **WAY), lunarsci.plan(files[0], local=(files[1],), **WAY)


def room(path: Any, rocks: Any = (ROCK,)) -> float:
    """Least distance of the rover's rectangle from the middles of rocks, 0 over one. [m]"""
    x, y, heading = planned_pose(path.plan, np.arange(0.0, path.plan.length_m, 0.02)).T[:, :, None]
    dx, dy = np.array(rocks)[:, 0] - x, np.array(rocks)[:, 1] - y
    ahead, aside = dx * np.cos(heading) + dy * np.sin(heading), dy * np.cos(heading) - dx * np.sin(heading)
    shape = path.footprint
    beyond = np.maximum(np.maximum(ahead - shape.front_m, shape.rear_m - ahead), 0.0)
    return float(np.hypot(beyond, np.maximum(np.abs(aside) - shape.half_width_m, 0.0)).min())


def test_a_rock_that_only_the_finer_ground_shows_is_gone_round(ways: tuple[Any, Any]) -> None:
    over, round_it = (survey.path for survey in ways)
    assert room(over) == 0.0 and math.isnan(over.max_step_m)
    # The outermost node of the rock lies at most one spacing within its rim.
    assert room(round_it) > RADIUS_M - FINE_M + ways[1].site.mobility.hazard_distance_m
    assert round_it.miss_m < 0.01 and round_it.plan.length_m < 1.1 * over.plan.length_m
    assert round_it.max_step_m <= ways[1].site.mobility.max_step_m
    assert round_it.swept.shape == over.swept.shape


def test_none_of_many_rocks_is_driven_over_also_where_two_grounds_meet(tmp_path: Path) -> None:
    rocks = np.random.default_rng(5).uniform((36.0, 8.0), (66.0, 34.0), (16, 2))
    rocks = np.vstack([rocks, [(40.4, 20.9), (60.7, 21.2)]])
    coarse = ground(tmp_path / "orbit.npz", 0.0, 0.0, (51, 21), COARSE_M, rocks=())
    # Two that overlap, of other spacings; what lies outside both is not known.
    west = ground(tmp_path / "west.npz", 34.0, 5.0, (151, 321), FINE_M, rocks=rocks)
    east = ground(tmp_path / "east.npz", 47.0, 5.0, (132, 214), 0.15, rocks=rocks)
    found = lunarsci.plan(coarse, local=(west, east), **WAY)
    known = rocks[(rocks[:, 0] < 65.0) & (rocks[:, 1] > 7.0)]
    assert room(found.path, known) > RADIUS_M - 0.15 + found.site.mobility.hazard_distance_m
    assert [one["terrain"] for one in found.to_dict()["path"]["checked"]] == ["orbit", "east", "west"]


def test_it_is_said_what_was_looked_at_on_which_ground(ways: tuple[Any, Any]) -> None:
    without, found = (survey.to_dict()["path"] for survey in ways)
    assert "checked" not in without
    orbit, mast = found["checked"]
    assert (orbit["terrain"], orbit["spacing_m"]) == ("orbit", COARSE_M)
    assert (mast["terrain"], mast["spacing_m"]) == ("mast", FINE_M)
    assert orbit["length_m"] + mast["length_m"] == pytest.approx(found["length_m"])
    # 21 m of it are covered, less half a baseline of maps and half a rover at each end; detours add a little.
    half = 0.5 * ways[1].surface.maps.baseline_m / COARSE_M + ways[1].path.footprint.reach_m
    assert 21.0 - 2.0 * half - 1.0 < mast["length_m"] < 21.0
    assert len(ways[1].made_from.inputs) == 2


def test_ground_that_is_far_from_the_way_changes_nothing(files: tuple[str, str], tmp_path: Path) -> None:
    way = WAY | {"start": (10.0, 8.0, 0.0), "target": (85.0, 8.0)}
    local = ground(tmp_path / "far.npz", 90.0, 35.0, (40, 40), FINE_M)
    assert lunarsci.plan(files[0], local=(local,), **way).path.plan == lunarsci.plan(files[0], **way).path.plan


def test_near_targets_and_starts_are_looked_at_on_the_finer_ground(files: tuple[str, str]) -> None:
    near = WAY | {"start": (44.0, 20.9, 0.0), "target": (58.0, 20.9)}
    assert room(lunarsci.plan(files[0], **near).path) == 0.0
    assert room(lunarsci.plan(files[0], local=(files[1],), **near).path) > RADIUS_M
    rim = (ROCK[0] + RADIUS_M, ROCK[1])
    for wrong in (WAY | {"target": rim}, near | {"target": rim}):
        with pytest.raises(ParameterError, match=r"cannot be at the target: .* at x 5"):
            lunarsci.plan(files[0], local=(files[1],), **wrong)


def test_a_patch_is_the_box_about_its_points_on_the_finer_nodes() -> None:
    """Points far apart in x and near in y; the finer ground begins beside the nodes of the coarse one."""
    rover = build_rover("yutu2")
    coarse, fine = (
        assess(ground, ground_maps(ground, *map_scales(rover)), read_mobility(read_rover("yutu2"), rover))
        for ground in (
            build_terrain("orbit", 0.0, 0.0, 2.0, np.zeros((21, 51)), read_soil("longji")),
            build_terrain("mast", 30.05, 1.05, 0.5, np.full((70, 110), 0.1), read_soil("longji")),
        )
    )
    box = patch(coarse, [fine], np.array([[45.0, 15.0], [75.0, 18.0]]), 4.0).terrain
    assert (box.spacing_m, box.x_m[[0, -1]], box.y_m[[0, -1]]) == (
        0.5, pytest.approx([41.05, 78.55]), pytest.approx([11.05, 21.55])
    )  # fmt: skip


def test_local_ground_that_does_not_fit_is_refused(files: tuple[str, str], tmp_path: Path) -> None:
    off = ground(tmp_path / "off.npz", 500.0, 0.0, (40, 40), FINE_M)
    as_coarse = ground(tmp_path / "coarse.npz", 0.0, 0.0, (20, 20), COARSE_M)
    for local, says in ((off, "covers no part of orbit"), (as_coarse, "must be finer")):
        with pytest.raises(DataError, match=says) as failed:
            lunarsci.plan(files[0], local=(local,), **WAY)
        assert "\n" not in str(failed.value)


def test_driven_ground_is_the_finer_one_and_has_no_step_at_its_rim() -> None:
    """A plane off by 5 cm, with a rock on it, in coarse ground: the rock is there, and the 5 cm come over a spacing."""
    x, y = 40.0 + 0.1 * np.arange(201), 10.0 + 0.1 * np.arange(201)
    rise = 0.1 * np.arange(51)[None, :] + np.zeros((21, 1))
    coarse = build_terrain("orbit", 0.0, 0.0, 2.0, 2.0 * rise, read_soil("longji"))
    fine = 0.1 * x[None, :] + 0.05 + 0.4 * (np.hypot(x[None, :] - 50.0, y[:, None] - 20.0) < 0.5)
    fine[:30, :30] = np.nan
    local = build_terrain("mast", 40.0, 10.0, 0.1, fine, read_soil("longji"))
    found = driven_ground(coarse, [local], np.array([[45.0, 15.0], [56.0, 22.0]]), 9.0)
    assert (found.spacing_m, found.x0_m, found.y0_m) == (0.1, 36.0, 6.0)
    assert found.height_at(50.0, 20.0) == pytest.approx(5.45) and found.height_at(55.0, 20.0) == pytest.approx(5.55)
    assert found.height_at(38.0, 20.0) == pytest.approx(3.8) and found.height_at(41.0, 11.0) == pytest.approx(4.1)
    away = np.hypot(found.x_m[None, :] - 50.0, found.y_m[:, None] - 20.0) > 1.0
    off = found.height_m - 0.1 * found.x_m[None, :]
    assert off[away].min() > -1e-9 and off[away].max() < 0.05 + 1e-9
    steps = [np.abs(np.diff(off, axis=axis)) for axis in (0, 1)]
    assert max(steps[0][away[1:] & away[:-1]].max(), steps[1][away[:, 1:] & away[:, :-1]].max()) < 0.005
    far = driven_ground(coarse, [local], np.array([[5.0, 15.0], [6.0, 22.0]]), 3.0)
    assert far.spacing_m == 2.0 and (far.height_m == coarse.height_m).all()


SOILS: dict[str, Any] = {"sweep": ("friction_angle_deg=35:40:2",), "members": 4}


def test_drives_are_chosen_and_driven_on_the_finer_ground(files: tuple[str, str], tmp_path: Path) -> None:
    """Over the rock on the orbit's ground, which knows nothing of it; round it, and driven over it, on the mast's."""
    near = WAY | {"start": (46.0, 20.9, 0.0), "target": (56.0, 20.9)} | SOILS | {"risk": 0.5, "candidates": 1}
    over, round_it = lunarsci.plan(files[0], **near), lunarsci.plan(files[0], local=(files[1],), **near)
    assert room(over.path) == 0.0 and over.ground is None
    assert room(round_it.path) > RADIUS_M and round_it.choice.feasible
    assert round_it.ground.height_at(*ROCK) == pytest.approx(0.4) and round_it.ground.spacing_m == FINE_M
    assert round_it.choice.best.prediction.terrain is round_it.ground
    assert [one["terrain"] for one in round_it.to_dict()["path"]["checked"]] == ["orbit", "mast"]
    assert round_it.path.swept.shape == round_it.surface.demand.shape
    (driven := tmp_path / "driven-terrain.npz").write_bytes(round_it.files()["driven-terrain.npz"]())
    again = lunarsci.predict(round_it.path.plan, terrain=str(driven), **SOILS)
    assert again.prediction.terrain.written == round_it.path.plan.made_for.ground == round_it.ground.written
    with pytest.warns(LunarSciWarning, match="was made on"):
        lunarsci.predict(round_it.path.plan, terrain=files[0], **SOILS)


MISSION = """
leg_m = 6.0
[start]
x_m = 46.0
y_m = 20.9
[fixes]
position_sigma_m = 0.02
heading_sigma_deg = 0.1
[[target]]
name = "beyond the rock"
x_m = 56.0
y_m = 20.9
"""


def test_a_mission_goes_by_the_finer_ground(files: tuple[str, str], tmp_path: Path) -> None:
    (tmp_path / "mission.toml").write_text(MISSION)
    found = lunarsci.plan(files[0], local=(files[1],), mission=str(tmp_path / "mission.toml"), **SOILS)
    legs, footprint = found.driven.legs, rover_footprint(found.site.rover)
    assert found.driven.reached == 1 and len(legs) == 2
    ways = [SimpleNamespace(plan=leg.plan, footprint=footprint) for leg in legs]
    assert min(map(room, ways)) > RADIUS_M
    grounds = [leg.plan.made_for.ground for leg in legs if leg.plan.made_for]
    names = found.site.terrain.name, Path(files[1]).stem
    assert [ground_name(one) for one in grounds] == [" with ".join(names)] * 2
    assert all(one != found.site.terrain.written for one in grounds)


def test_local_ground_of_another_projection_is_refused(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    moon, other = (
        rasterio.crs.CRS.from_user_input(f"+proj=stere +lat_0=-{latitude} +lon_0=0 +R=1737400").to_wkt()
        for latitude in (85, 86)
    )
    first = ground(tmp_path / "a.npz", 0.0, 0.0, (51, 21), COARSE_M, moon)
    second = ground(tmp_path / "b.npz", 40.0, 11.0, (100, 100), FINE_M, other)
    with pytest.raises(DataError, match="its coordinate system is not that of a"):
        lunarsci.plan(first, local=(second,), **WAY)


WHEEL = read_wheel("yutu2")
PLACES = np.array([[0.0, 0.0], [6.0, 0.0]])


def coarse(spacing_m: float, slope_deg: float, soil: Soil | None = None) -> Terrain:
    """A plane that rises along y, 80 m x 80 m."""
    axis = np.arange(-40.0, 40.0 + 1e-9, spacing_m)
    height = math.tan(math.radians(slope_deg)) * axis[:, None] + 0.0 * axis[None, :]
    return build_terrain("coarse", -40.0, -40.0, spacing_m, height, soil or read_soil("longji"))


def test_slopes_over_17_m_have_the_published_median() -> None:
    """Slopes along x and y are normal: the median slope of 200,000 grounds is what was put in."""
    random = np.random.default_rng(4)
    for slope, hurst in ((2.0, 0.76), (7.5, 0.95)):
        relief = relief_of_kind(slope, hurst)
        rms = math.sqrt(relief.at_one_m * 17.0 ** (2.0 * hurst))
        steep = np.hypot(*random.normal(scale=rms / 17.0, size=(2, 200_000)))
        assert math.degrees(math.atan(np.median(steep))) == pytest.approx(slope, rel=0.01)
    middle, apart = lunar_relief()
    assert middle.hurst == pytest.approx(0.855)
    for sign, kind in ((-1, (2.0, 0.76)), (1, (7.5, 0.95))):
        assert math.sqrt(middle.at_one_m) * math.exp(sign * apart) == pytest.approx(
            math.sqrt(relief_of_kind(*kind).at_one_m)
        )


def spline_weights(place: tuple[float, float]) -> np.ndarray:
    """Weights of 16 x 16 nodes in a cubic spline at a place in the middle of them, by splines of unit vectors."""
    along, across = (CubicSpline(np.arange(16.0), np.eye(16), bc_type="not-a-knot")(7.0 + part) for part in place)
    return np.outer(along, across)


def squared_difference(factor: int, lag: int, place: tuple[int, int]) -> float:
    """Mean square of the difference of what nodes do not show at two places, for differences c l^(2 H) of the ground.

    Of weights w that sum to zero the variance is minus half the sum of w_i w_j c |x_i - x_j|^(2 H) (Matheron 1973).
    """
    relief, _ = lunar_relief()
    ends = np.array([place, (place[0] + lag, place[1])]) / factor
    nodes = np.argwhere(np.ones((16, 16))) - 7.0
    shown = spline_weights(tuple(ends[1])) - spline_weights(tuple(ends[0]))
    places = np.concatenate([ends, nodes])
    weights = np.concatenate([[-1.0, 1.0], -shown.ravel()])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) * factor
    return float(-0.5 * weights @ (relief.at_one_m * apart ** (2.0 * relief.hurst)) @ weights)


def test_what_nodes_show_is_left_out_and_the_rest_is_as_rough_as_the_law_says() -> None:
    """Nodes 16 m apart, in steps of 1 m: differences over 4 and 8 m, and nothing at the nodes.

    Roughness that changes from place to place by a normal logarithm of spread s has a mean square of exp(2 s^2).
    """
    apart = 0.4
    found = np.zeros((2, 16, 16))
    for seed in range(24):
        grain = unresolved_grain(16, 1.0, seed, (0.0, apart)).astype(float)
        assert np.abs(grain[::16, ::16]).max() < 1e-5
        for number, lag in enumerate((4, 8)):
            squares = (np.roll(grain, -lag, 0) - grain) ** 2
            found[number] += squares.reshape(32, 16, 32, 16).mean(axis=(0, 2)) / 24
    for number, lag in enumerate((4, 8)):
        for place in ((2, 8), (6, 0), (8, 8)):
            law = squared_difference(16, lag, place) * math.exp(2.0 * apart**2)
            assert found[number][place] == pytest.approx(law, rel=0.12), (lag, place)


def test_nodes_are_as_close_as_a_wheel_is_large_and_the_map_stays_as_it_is() -> None:
    soft, hard = read_soil("longji"), dataclasses.replace(read_soil("longji"), cohesion_pa=3000.0)
    rough = coarse(5.0, 4.0)
    laid = np.broadcast_to(soft.vector(), (*rough.height_m.shape, 8)).copy()
    laid[:, 9:] = hard.vector()
    rough = dataclasses.replace(rough, soil=laid)
    rough.height_m[0, 0] = np.nan
    finer, told = with_unresolved(rough, PLACES, WHEEL)
    assert told is not None and told.spacing_m == 5.0 and finer.spacing_m == 5.0 / 64 and finer.errors is not None
    x, y = np.array([-1.3, 0.0, 4.7, 7.2]), np.array([0.4, -2.0, 3.3, 0.0])
    assert finer.height_at(x, y) == pytest.approx(math.tan(math.radians(4.0)) * y, abs=1e-9)
    row = finer.soil[finer.height_m.shape[0] // 2]
    at = np.searchsorted(finer.x_m, 2.5)
    assert row[np.searchsorted(finer.x_m, -1.0), 3] == soft.cohesion_pa
    assert row[np.searchsorted(finer.x_m, 6.0), 3] == pytest.approx(3000.0)
    assert row[at, 3] == pytest.approx(0.5 * (soft.cohesion_pa + 3000.0), rel=0.02)
    near = coarse(0.9, 4.0)
    as_it_is, nothing = with_unresolved(near, PLACES, dataclasses.replace(WHEEL, radius_m=0.9))
    assert as_it_is is near and nothing is None
    # Nodes as near as the advice says have nothing drawn between them.
    assert with_unresolved(coarse(told.deciding_m, 4.0), PLACES[:1], WHEEL)[1] is None


def test_a_map_tells_how_rough_its_ground_is() -> None:
    """Fractal ground by the law, and twice or a third of it: the mean of the logarithm moves half-way and more there.

    A normal prior of variance p and one reading of variance r meet at p / (p + r) of the way; the Student law that
    stands for the reading pulls less, the farther it is off. A level map tells nothing.
    """
    relief, apart = lunar_relief()
    prior = apart**2 + 0.45**2
    random, shape = np.random.default_rng(6), (256, 256)
    waves = np.fft.fft2(random.standard_normal(shape)) * np.sqrt(fractal_power(shape, 2.0, relief))
    ground = np.fft.ifft2(waves).real
    means = []
    for factor in (1.0 / 3.0, 1.0, 2.0):
        laid = build_terrain("law", 0.0, 0.0, 2.0, factor * ground, read_soil("longji"))
        mean, sd = roughness_of_map(laid)
        means.append(mean)
        assert 0.25 < sd < math.sqrt(prior)
        assert mean == pytest.approx(prior / (prior + 0.25) * math.log(factor), abs=0.25)
    assert means[0] < means[1] < means[2]
    assert roughness_of_map(coarse(5.0, 4.0))[0] == pytest.approx(0.0, abs=1e-9)
    assert roughness_of_map(coarse(5.0, 4.0))[1] == pytest.approx(math.sqrt(prior), rel=0.01)


def verdict_on(tmp_path: Path, slope_deg: float, tilt_deg: float):  # type: ignore[no-untyped-def]
    """5 m along a slope on nodes 5 m apart, where only the tilt can stand in the way."""
    (tmp_path / "coarse.npz").write_bytes(terrain_bytes(coarse(5.0, slope_deg)))
    given = {"slip_ratio": 1.0, "side_slip_deg": 90.0, "sinkage_m": 0.15, "clearance_m": 0.001, "tilt_deg": tilt_deg}
    limits = tuple(Limit(name, "", value, "test", False) for name, value in given.items())
    plan = Plan(name="along", legs=(Leg(5.0),), speed_m_s=0.05, limits=limits)
    return predict(plan, terrain=str(tmp_path / "coarse.npz"), rover="yutu2", time_step=0.2)


def test_a_verdict_that_hangs_on_ground_nobody_saw_is_not_determined(tmp_path: Path) -> None:
    """Over 1 m the ground between the nodes has slopes of 3.4 deg rms; tilts of a drive reach two or three of these."""
    gentle = verdict_on(tmp_path, 0.0, 25.0)
    assert gentle.verdict.verdict == "go" and gentle.prediction.members == 64 and not gentle.untrusted
    steep = verdict_on(tmp_path, 12.0, 10.0)
    assert steep.verdict.verdict == "no-go"
    close = verdict_on(tmp_path, 4.0, 10.0)
    assert close.verdict.verdict == "not-determined" and "nodes 5 m apart decides" in close.untrusted
    why = close.verdict.reasons[0]
    assert "nodes 5 m apart" in why and f"every {close.unresolved.deciding_m:.2g} m" in why
    assert 0.05 < close.verdict.failed / 64 < 0.75
