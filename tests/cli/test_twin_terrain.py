"""`lunarsci twin terrain` and `plan`."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.jobs.chosen_drive import places_of
from lunarsci.twin.jobs.requests import PlanRequest
from lunarsci.twin.plans.plan import read_plan

TERRAIN, PLAN = ("twin", "terrain"), ("twin", "plan")
COARSE = ("--spacing", "0.1")
TARGET = ("--target", "9.369,1.957", "--max-slope", "11")


def test_a_terrain_is_described(run) -> None:
    done = run(*TERRAIN, "--json", "--no-time")
    assert (done.code, done.err) == (0, [])
    document = json.loads(done.out)
    result = document["result"]
    assert document["schema"] == "lunarsci/twin-terrain/1"
    height = synthetic_longji().height_m
    assert result["terrain"]["nodes"] == [341, 321] and result["terrain"]["spacing_m"] == 0.05
    assert result["terrain"]["height_m"] == pytest.approx([height.min(), height.max()])
    assert result["path"] is None and result["terrain"]["hole_share"] == 0.0
    shares = [result[f"{name}_share"] for name in ("traversable", "hazard", "unknown")]
    assert sum(shares) == pytest.approx(1.0)
    assert shares[2] == pytest.approx(1.0 - 321 * 301 / (341 * 321)), "half a footprint along each edge"
    assert result["limits"]["max_slope_deg"] == {"value": 20.0, "assumed": False}
    assert result["limits"]["hazard_distance_m"]["assumed"]
    assert list(result["maps"]["slope_deg"]) == ["max", "p5", "p50", "p95"]
    assert any("synthetic" in note for note in result["notes"])
    assert any("smaller than two spacings" in note for note in result["notes"])


def test_table_and_csv_show_the_same_maps(run) -> None:
    rows = list(csv.DictReader(io.StringIO(run(*TERRAIN, *COARSE, "--csv").out)))
    assert [row["quantity"] for row in rows] == ["slope_deg", "roughness_m", "step_m"]
    table = run(*TERRAIN, *COARSE).out
    for row in rows:
        assert f"{float(row['p95']):.4g}" in table


@pytest.mark.slow
def test_a_planned_path_can_be_driven(run, tmp_path: Path) -> None:
    folder, picture = tmp_path / "site", tmp_path / "site.png"
    done = run(*PLAN, *COARSE, *TARGET, "-o", folder, "--plot", picture, "--geotiff", "--json")
    assert done.code == 0, done.err
    path = json.loads(done.out)["result"]["path"]
    assert path["miss_m"] < 0.01 and path["min_hazard_distance_m"] >= 0.2 and path["max_slope_deg"] <= 11.0
    assert np.hypot(path["end"]["x_m"] - 9.369, path["end"]["y_m"] - 1.957) < 0.01
    names = {"terrain.npz", "maps.npz", "maps.tif", "plan.toml", "path.csv", "path.geojson", "result.json"}
    assert {file.name for file in folder.iterdir()} == names
    assert picture.read_bytes().startswith(b"\x89PNG")
    plan = read_plan(folder / "plan.toml")
    assert [arc.length_m for arc in plan.legs] == [arc["length_m"] for arc in path["arcs"]]
    driven = run(
        "twin", "predict", folder / "plan.toml", "--terrain", folder / "terrain.npz", "--field", "verdict", "-q"
    )
    assert (driven.code, driven.out) == (0, "go\n")


def test_a_soil_that_nobody_named_is_drawn_from_the_priors(run, tmp_path: Path) -> None:
    plan, ground = tmp_path / "plan.toml", tmp_path / "flat.csv"
    plan.write_text('name = "short"\n[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.3\n')
    nodes = ((0.25 * x, 0.25 * y) for x in range(-8, 13) for y in range(-8, 9))
    ground.write_text("x_m,y_m,height_m\n" + "".join(f"{x},{y},0\n" for x, y in nodes))
    said = "soil: 64 drawn from the priors (before any drive)"
    for more, is_drawn in (((), True), (("--soil", "longji"), False)):
        shown = run("twin", "predict", plan, "--terrain", ground, "--exact-terrain", *more)
        assert (said in " ".join(shown.out.split())) == is_drawn and shown.code == 0, shown
        assert f"{64 if is_drawn else 1} drive" in shown.out and "of yutu2" in shown.out
    forces = run("twin", "forces", plan, "--terrain", ground)
    assert "soil: that of longji, assumed: none is given" in " ".join(forces.out.split())


def test_the_maps_are_in_both_files(run, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    assert run(*TERRAIN, *COARSE, "-o", tmp_path / "d", "--geotiff", "-q").code == 0
    with np.load(tmp_path / "d" / "maps.npz") as maps, rasterio.open(tmp_path / "d" / "maps.tif") as raster:
        assert raster.descriptions == ("slope_deg", "roughness_m", "step_m", "demand")
        for band, name in enumerate(raster.descriptions, start=1):
            assert np.array_equal(raster.read(band)[::-1], maps[name], equal_nan=True)
        row, column = raster.index(maps["x_m"][30], maps["y_m"][50])
        assert raster.read(1)[row, column] == maps["slope_deg"][50, 30]


def test_a_file_is_read_and_its_hash_kept(run, tmp_path: Path) -> None:
    assert run(*TERRAIN, *COARSE, "--rocks", "0.01", "-o", tmp_path / "d", "-q").code == 0
    file = tmp_path / "d" / "terrain.npz"
    one, two = (json.loads(run(*TERRAIN, *given, "--json").out) for given in ([file], [*COARSE, "--rocks", "0.01"]))
    for key, spread in two["result"]["maps"].items():
        assert one["result"]["maps"][key] == pytest.approx(spread, rel=1e-6)
    assert [used["path"] for used in one["provenance"]["inputs"]] == [str(file)]
    assert any("Golombek" in source for source in two["provenance"]["sources"])


def test_synthetic_ground_has_its_options(run) -> None:
    options = ("--extent", "8", "--spacing", "0.1", "--ground-slope", "12", "--crater-count", "0", "--roughness", "0")
    assert float(run(*TERRAIN, "synthetic", *options, "--field", "maps.slope_deg.p50").out) == pytest.approx(
        12.0, abs=1e-3
    )
    for group in (["--max-slope", "11"], ["--max-roughness", "0.001"], ["--max-step", "0.01"]):
        strict = run(*TERRAIN, "synthetic", *options, "--seed", "3", *group, "--field", "hazard_share")
        assert (float(strict.out) > 0) == (group[0] == "--max-slope")  # a plane is neither rough nor has steps


@pytest.mark.parametrize(
    "arguments",
    [
        ["--target", "1"],
        ["--target", "a,b"],
        ["--target", "1,2,3,4"],
        ["--start", "0", "--target", "1,1"],
        ["--target", "9,2", "--turning-radius", "0.49"],
        ["--target", "9,2", "--turning-radius", "0"],
        ["--target", "9,2", "--turning-radius", "nan"],
        ["--extent", "10"],
        ["file.npz", "--rocks", "0.01"],
    ],
)
def test_wrong_usage_is_one_line(run, arguments: list[str]) -> None:
    wrong = run(*(PLAN if arguments[0] in ("--target", "--start") else TERRAIN), *arguments)
    assert (wrong.code, wrong.out, len(wrong.err)) == (2, "", 1), wrong
    assert "--turning-radius" not in arguments or "give 0.5 m or more" in wrong.err[0]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--target", "90,0"], "outside the map"),
        (["--target", "nan,0"], "finite"),
        (["--target", "9,2", "--max-slope", "3"], "slope"),
        (["--target", "9,2", "--hazard-distance", "-1"], "hazard_distance_m"),
        (["--target", "9,2", "--speed", "1"], "at most 0.055"),
        (["--rocks", "3"], "rocks"),
        (["--baseline", "100"], "baseline"),
        (["missing.npz"], "no such file"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_nothing_is_written(
    run, tmp_path: Path, arguments: list[str], says: str
) -> None:
    ground = [] if arguments[0].endswith(".npz") else COARSE
    failed = run(*(PLAN if arguments[0] == "--target" else TERRAIN), *ground, *arguments, "-o", tmp_path / "d", "-q")
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1), failed
    assert says in failed.err[0]
    assert not (tmp_path / "d").exists()


def test_a_plan_starts_where_the_last_drive_ended(run, tmp_path: Path) -> None:
    """The last row by time of a measured drive; of a prediction the middle of the ends: 179 and -177 deg give 181."""
    folder = tmp_path / "states"
    folder.mkdir()
    motion = folder / "motion.csv"
    motion.write_text("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n20,0.5,0.25,10\n10,0.2,0.1,5\n30,,,\n")
    for given in (folder, motion):
        done = run("twin", "plan", "--target", "3,0.5", "--start", given, "--json")
        assert done.code == 0, done.err
        found = json.loads(done.out)
        assert found["result"]["path"]["length_m"] == pytest.approx(2.5125, abs=0.1)
        assert str(motion) in [one["path"] for one in found["provenance"]["inputs"]]
    assert places_of(PlanRequest(target="3,0", start=str(folder)))[0] == (0.5, 0.25, pytest.approx(10.0))
    assert places_of(PlanRequest(target="4,4", start="1,1"))[0] == (1.0, 1.0, pytest.approx(45.0))
    motion.unlink()
    empty = run("twin", "plan", "--target", "3,0", "--start", folder)
    assert empty.code == 2 and "no motion.csv or paths.csv in it" in empty.err[0]
    paths = folder / "paths.csv"
    paths.write_text("member,time_s,x_m,y_m,yaw_deg\n0,0,0,0,0\n0,9,1,0,179\n1,0,0,0,0\n1,9,2,0.2,-177\n")
    assert places_of(PlanRequest(target="3,0", start=str(folder)))[0] == pytest.approx((1.5, 0.1, -179.0))
    paths.write_text("time_s,x_m,y_m\n0,0,0\n")
    bad = run("twin", "plan", "--target", "3,0", "--start", paths)
    assert bad.code == 1 and "no column yaw_deg" in bad.err[0]
    assert run("twin", "plan", "--target", "3,0", "--start", folder, "--lonlat").code == 2
