"""`lunarsci twin plan --mission`: for people, for scripts, and what is no mission."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import build_terrain, terrain_bytes
from lunarsci.twin.plans.plan import read_plan

EXAMPLE = Path(__file__).parents[2] / "examples" / "mission.toml"
QUICK = ("twin", "plan", "-q", "--no-time", "--members", "8")


def test_a_mission_is_planned_with_all_its_files(run, belief: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mission"
    done = run(*QUICK, "--mission", EXAMPLE, "--soil", belief, "--risk", "0.3", "--json", "-o", folder)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    mission = document["result"]["mission"]
    assert document["schema"] == "lunarsci/twin-mission/1"
    assert [one["fate"] for one in mission["targets"]] == ["reached", "reached"] and mission["last_target"] == "rock"
    assert EXAMPLE.name in json.dumps(document["provenance"]["inputs"])
    legs = mission["legs"]
    # Between the windows, from 1800 to 5400 s, nothing is driven, and the stay of 900 s at the rim comes first.
    assert all(leg["begin_s"] + leg["drive_s"] + 600 <= 1800 or leg["begin_s"] >= 5400 for leg in legs)
    assert mission["waited_s"] > 0
    for one, after in pairwise(legs):
        assert (after["x_m"], after["y_m"]) == (one["end_x_m"], one["end_y_m"])
        assert after["begin_s"] >= one["begin_s"] + one["drive_s"] + 600
    plans = [read_plan(str(folder / f"leg-{leg['leg']:03d}.toml")) for leg in legs]
    assert [plan.length_m for plan in plans] == pytest.approx([leg["length_m"] for leg in legs])
    features = json.loads((folder / "mission.geojson").read_text())["features"]
    kinds = [one["properties"]["kind"] for one in features]
    assert kinds == ["leg"] * len(legs) + ["target", "target", "keep-out"]
    end = features[len(legs) - 1]["geometry"]["coordinates"][-1]
    assert np.hypot(end[0] - 9.0, end[1] - 1.0) < 0.5
    driven = run(
        "twin", "predict", folder / "leg-001.toml", "--terrain", folder / "terrain.npz", "--soil", belief, "-q"
    )
    assert driven.code in (0, 3), driven.err


def test_the_battery_lasts_for_some_of_the_targets(run, belief: Path) -> None:
    """Some 90 min at 60 W and 120 Wh: a full battery reaches the rock, one of 60 % only the rim; the Sun helps."""
    asked = (*QUICK, "--mission", EXAMPLE, "--soil", belief, "--risk", "0.3", "--json")
    fates = {}
    for charge, sun in (("1", ()), ("0.6", ()), ("0.6", ("--sun", "0,60"))):
        done = run(*asked, "--charge", charge, *sun)
        mission = json.loads(done.out)["result"]["mission"]
        fates[charge, bool(sun)] = [one["fate"] for one in mission["targets"]]
        left = [leg["charge_p05"] for leg in mission["legs"]]
        assert done.code == (0 if fates[charge, bool(sun)][-1] == "reached" else 3)
        assert sun or all(before > after for before, after in pairwise(left))
    assert fates["1", False] == ["reached", "reached"] and fates["0.6", False] == ["reached", "no drive"]
    assert fates["0.6", True] == ["reached", "reached"]
    table = run(*asked[:-1], "--charge", "1").out
    assert "left [%]" in table


def test_what_does_not_fit_ends_with_code_3(run, belief: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.toml"
    short.write_text(EXAMPLE.read_text().replace("time_budget_s = 14400", "time_budget_s = 2400"))
    done = run(*QUICK, "--mission", short, "--soil", belief, "--plot", tmp_path / "m.pdf")
    assert done.code == 3
    assert "1 of 2 targets reached" in done.out and "target 'rock' is not reached, no time" in " ".join(done.err)
    rows = [line for line in done.out.splitlines() if line[:3].strip().isdigit()]
    assert rows and max(map(len, rows)) <= 80
    assert (tmp_path / "m.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("old", "new", "code", "said"),
    [
        ("x_m = 9.0", "x_m = 900.0", 2, "lies outside the map"),
        ("x_m = 3.0\ny_m = -1.5", "x_m = 9.0\ny_m = 1.0", 2, "is to be kept out of"),
        ("[[target]]", "[[window]]", 1, "not a key of"),
    ],
)
def test_impossible_missions_are_one_line(run, tmp_path: Path, old: str, new: str, code: int, said: str) -> None:
    file = tmp_path / "mission.toml"
    file.write_text(EXAMPLE.read_text().replace(old, new, 1))
    done = run(*QUICK, "--mission", file)
    assert done.code == code and said in " ".join(done.err)
    assert not done.out and len(done.err) <= 4


def test_options_that_a_mission_has_in_its_file_are_refused(run, tmp_path: Path) -> None:
    for option in (("--target", "3,1"), ("--start", "1,0,0"), ("--fixes", "0.1,1"), ("--candidates", "3")):
        done = run(*QUICK, "--mission", EXAMPLE, *option)
        assert done.code == 2 and "go together" in " ".join(done.err)
    assert run(*QUICK, "--mission", tmp_path / "none.toml").code == 1


FAR = """
leg_m = 15.0
[start]
x_m = -18
y_m = 0
[fixes]
position_sigma_m = 0.1
heading_sigma_deg = 0.2
[[target]]
name = "far"
x_m = 18
y_m = 2
"""


def test_a_way_beyond_the_reach_of_a_few_arcs_is_driven_by_legs(run, belief: Path, tmp_path: Path) -> None:
    file = tmp_path / "far.toml"
    file.write_text(FAR)
    made = ("synthetic", "--extent", "50", "--spacing", "0.25", "--crater-count", "3", "--seed", "1")
    done = run(
        "twin", "plan", *made, "--mission", file, "--members", "4", "--soil", belief, "-q", "--no-time", "--json"
    )
    assert done.code in (0, 3), done.err
    mission = json.loads(done.out)["result"]["mission"]
    assert mission["targets"][0]["fate"] == "reached"
    assert len(mission["legs"]) >= 3 and max(leg["length_m"] for leg in mission["legs"]) <= 1.3 * 15.0


def test_plans_of_legs_carry_the_coordinate_system_of_the_terrain(run, belief: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    crs = rasterio.crs.CRS.from_user_input("+proj=stere +lat_0=-85 +lon_0=0 +R=1737400").to_wkt()
    flat = build_terrain("flat", -5.0, -5.0, 0.1, np.zeros((101, 101)), read_soil("longji"), crs=crs)
    (tmp_path / "flat.npz").write_bytes(terrain_bytes(flat))
    mission = tmp_path / "short.toml"
    mission.write_text(
        FAR.replace("x_m = -18", "x_m = -2").replace("x_m = 18", "x_m = 1").replace("y_m = 2", "y_m = 0")
    )
    folder = tmp_path / "out"
    done = run(*QUICK, tmp_path / "flat.npz", "--mission", mission, "--soil", belief, "-o", folder)
    assert done.code in (0, 3), done.err
    assert read_plan(str(folder / "leg-001.toml")).crs == crs
