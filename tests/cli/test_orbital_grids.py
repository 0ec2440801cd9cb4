"""A kilometre over a grid as orbiters make them: planned, driven, and with its coordinates kept."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from lunarsci.twin.ground.synthetic import crater_height
from lunarsci.twin.plans.plan import read_plan

rasterio = pytest.importorskip("rasterio")
PLAN = ("twin", "plan")
SPACING, NODES = 2.0, 560
WEST, NORTH = 711_000.0, 21_200.0
"""Near 23.4 deg E, 0.68 deg N, where Apollo 11 landed."""
MOON = "+proj=eqc +lat_ts=0 +lon_0=0 +R=1737400 +units=m"
START, TARGET = (WEST + 100.0, NORTH - 1000.0), (WEST + 900.0, NORTH - 350.0)


@pytest.fixture(scope="session")
def dtm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """SYNTHETIC, in the format of elevation models of LROC's narrow-angle camera: float32, Moon 2000 equirectangular.

    Craters 20 m and more across, their number falling with the square of the diameter, 0.15 as deep as wide; a regional
    slope of one degree, and a corner without data.
    """
    random, axis = np.random.default_rng(3), SPACING * np.arange(NODES)
    height = np.broadcast_to(0.0175 * axis[None, :], (NODES, NODES)).copy()
    diameters = np.minimum(20.0 / np.sqrt(random.random(160)), 250.0)
    for (x, y), diameter in zip(SPACING * NODES * random.random((160, 2)), diameters, strict=True):
        distance = np.hypot(axis[None, :] - x, axis[:, None] - y)
        height += np.where(distance < 1.5 * diameter, crater_height(distance, diameter, 0.15), 0.0)
    height[:20, -30:] = np.nan
    path = tmp_path_factory.mktemp("dtm") / "NAC_DTM_SYNTHETIC.tif"
    shape = {"driver": "GTiff", "height": NODES, "width": NODES, "count": 1, "dtype": "float32", "nodata": -3.4e38}
    where = {"crs": MOON, "transform": rasterio.transform.from_origin(WEST, NORTH, SPACING, SPACING)}
    with rasterio.open(path, "w", **shape, **where) as raster:
        raster.write(np.nan_to_num(height, nan=-3.4e38).astype("float32"), 1)
        raster.update_tags(SYNTHETIC="true")
    return path


def places(start: tuple[float, float], target: tuple[float, float]) -> tuple[str, ...]:
    return ("--start", f"{start[0]},{start[1]},40", "--target", f"{target[0]},{target[1]}")


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.06, pytest.param(1.0, marks=pytest.mark.study)])
def test_a_kilometre_is_planned_and_driven(share: float, run, dtm: Path, tmp_path: Path) -> None:
    """Or a share of it."""
    site, careful = tmp_path / "site", ("--hazard-distance", "5", "--max-slope", "15")
    target = (START[0] + share * (TARGET[0] - START[0]), START[1] + share * (TARGET[1] - START[1]))
    done = run(*PLAN, dtm, *places(START, target), *careful, "-o", site, "--geotiff", "--json", "-q")
    assert done.code == 0, done.err
    path, straight = json.loads(done.out)["result"]["path"], math.dist(START, target)
    assert straight < path["length_m"] < 1.1 * straight and path["miss_m"] < 0.01
    assert path["max_slope_deg"] <= 15.0 and path["min_hazard_distance_m"] >= 5.0
    with rasterio.open(dtm) as heights, rasterio.open(site / "maps.tif") as maps:
        assert (maps.crs, maps.transform) == (heights.crs, heights.transform)
        assert read_plan(site / "plan.toml").crs == heights.crs.to_wkt()
    drive = ("--soil", "lunar-typical", "--fixes", "0.1,0.5", "--sample", "0.5", "--json", "-q")
    driven = run("twin", "predict", site / "plan.toml", "--terrain", site / "terrain.npz", *drive)
    said = json.loads(driven.out)["result"]
    assert said["unresolved"]["spacing_m"] == SPACING and said["members"] == 64
    assert said["outcomes"] == {"finished": 64}, driven.err
    # Localised to 0.1 m and 0.5 deg every 20 m, by physics that the planner does not know.
    assert math.dist((said["endpoint"]["x_m"], said["endpoint"]["y_m"]), target) < 3.0


def test_a_target_off_the_grid_is_one_line(run, dtm: Path) -> None:
    for target, says in (((WEST + 5000.0, NORTH), "outside the map"), ((WEST + 1090.0, NORTH - 10.0), "unknown")):
        failed = run(*PLAN, dtm, *places(START, target))
        assert (failed.code, failed.out, len(failed.err)) == (1, "", 1), failed
        assert says in failed.err[0]


def test_a_finer_grid_is_looked_at_where_it_lies(run, dtm: Path, tmp_path: Path) -> None:
    mast, target = tmp_path / "mast.tif", (START[0] + 36.0, START[1])
    shape = {"driver": "GTiff", "height": 160, "width": 160, "count": 1, "dtype": "float32"}
    where = {"crs": MOON, "transform": rasterio.transform.from_origin(START[0] + 8.0, START[1] + 10.0, 0.125, 0.125)}
    with rasterio.open(mast, "w", **shape, **where) as raster:
        raster.write(np.zeros((160, 160), dtype="float32"), 1)
    done = run(*PLAN, dtm, *places(START, target), "--local", mast, "-q")
    assert done.code == 0, done.err
    assert (
        "m looked at on NAC_DTM_SYNTHETIC, every 2 m" in done.out and "m looked at on mast, every 0.125 m" in done.out
    )
    failed = run(*PLAN, dtm, *places(START, target), "--local", dtm)
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1) and "must be finer" in failed.err[0]
    near, soils = (START[0] + 22.0, START[1]), ("--sweep", "friction_angle_deg=35:40:2", "--members", "4")
    chosen = ("--local", mast, "--risk", "0.5", "--candidates", "1", "-q", "-o", tmp_path / "chosen")
    done = run(*PLAN, dtm, *places((START[0] + 14.0, START[1]), near), *chosen, *soils)
    assert done.code == 0, done.err
    ground = tmp_path / "chosen" / "driven-terrain.npz"
    again = run("twin", "predict", tmp_path / "chosen" / "plan.toml", "--terrain", ground, *soils, "-q")
    assert again.code in (0, 3), again.err
