"""Finer terrains in a way over a coarse one: what only they show is gone round, and what they do not cover stays."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.written_names import ground_name
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.finer_ground import driven_ground, patch
from lunarsci.twin.ground.footprint import rover_footprint
from lunarsci.twin.ground.hazards import assess, ground_maps, map_scales, read_mobility
from lunarsci.twin.ground.terrain import build_terrain, write_terrain
from lunarsci.twin.plans.path import planned_pose
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
    write_terrain(terrain, path)
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
