"""`lunarsci twin predict`: files, pages, films and the JSON that scripts read."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

PLAN = """
[drive]
speed_m_s = 0.05
[[leg]]
length_m = 1.0
curvature_per_m = 0.0
[sweep]
friction_angle_deg = "30:45:4"
"""
CIRCLE = '[[keep_out]]\nname = "rock"\nx_m = 1.0\ny_m = {y}\nradius_m = 0.3\n'


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def test_a_folder_a_film_and_pages(run, plan: Path, tmp_path: Path) -> None:
    folder, film, pages = tmp_path / "drive", tmp_path / "drive.gif", tmp_path / "drive.pdf"
    done = run("twin", "predict", plan, "-o", folder, "--animate", film, "--plot", pages)
    assert done.code == 0, done.err
    assert {path.name for path in folder.iterdir()} == {
        *("states.csv", "paths.csv", "endpoints.csv", "profiles.csv", "prediction.json", "result.json")
    }
    assert film.read_bytes().startswith(b"GIF89a") and not any("first page" in line for line in done.err)
    assert pages.read_bytes().count(b"/Type /Page ") == 3
    profiles = pd.read_csv(folder / "profiles.csv")
    assert set(profiles.loc[profiles["quantity"] == "slip_ratio", "wheel"]) == {
        *("all", "FL", "FR", "ML", "MR", "RL", "RR")
    }
    result = json.loads((folder / "result.json").read_text())["result"]
    assert {"semi_major_m", "semi_minor_m", "azimuth_deg", "factor_95"} <= result["endpoint"]["ellipse"].keys()
    limits = {limit["quantity"]: limit for limit in result["limits"]}
    assert {name: limit["sense"] for name, limit in limits.items() if limit["sense"] == "at least"} == {
        "clearance_m": "at least"
    }
    assert result["worst"].keys() == {"member", "parameters", "why"}
    assert result["validity"]["invalid_share"] == result["invalid_share"] == 0.0
    again = run("twin", "predict", plan, "--animate", film)
    assert (again.code, again.out, len(again.err)) == (2, "", 1) and "--force" in again.err[0]


@pytest.mark.parametrize(("y", "code"), [(0.7, 3), (1.1, 0)])
def test_a_circle_in_the_way_is_a_no_go(run, plan: Path, y: float, code: int) -> None:
    """The wheels reach 0.525 m to the left, the circle from y - 0.3 m on; the drive strays by less than 0.1 m."""
    plan.write_text(PLAN + CIRCLE.format(y=y))
    done = run("twin", "predict", plan, "--json")
    assert done.code == code
    [limit] = [x for x in json.loads(done.out)["result"]["limits"] if x["quantity"] == "keep_out_m"]
    assert limit["min"] == pytest.approx(y - 0.3 - 0.525, abs=0.1) and limit["ok"] == (code == 0)


def test_a_start_beside_the_terrain_is_said_and_no_soil_is_blamed(run, tmp_path: Path) -> None:
    beside = tmp_path / "beside.toml"
    beside.write_text("[start]\nx_m = -500.0\n" + PLAN)
    done = run("twin", "predict", beside)
    advice = next(line for line in done.out.splitlines() if line.startswith("what may help: "))
    assert done.code == 3 and "the plan starts at x -500 m, y 0 m" in advice and "twin update" not in advice
    assert "a plan and heights of the same place" in advice
    for name, code in (("limits.slip_ratio.margin", 3), ("limits.slip_rato.margin", 2)):
        assert run("twin", "predict", beside, "--field", f"result.{name}").code == code


def test_a_start_in_a_hole_is_said_to_need_heights(run, tmp_path: Path) -> None:
    ground, plan = tmp_path / "holed.npz", tmp_path / "plan.toml"
    x = np.arange(-3.0, 3.01, 0.1)
    np.savez(ground, x_m=x, y_m=x, height_m=np.where(np.hypot(x, x[:, None]) < 1.0, np.nan, 0.0))
    plan.write_text(PLAN)
    done = run("twin", "predict", plan, "--terrain", ground, "--soil", "longji")
    advice = next(line for line in done.out.splitlines() if line.startswith("what may help: "))
    assert done.code == 3 and "heights without holes along the way" in advice and "same place" not in advice


def test_advice_is_not_what_was_done_already(run, plan: Path, tmp_path: Path) -> None:
    """One soil of the priors asks for more of them; a drive off the map from within for a larger map, and halts."""
    assert "one soil; --members 64 drives" in run("twin", "predict", plan, "--soil", "priors", "--members", "1").out
    ground, leaving = tmp_path / "flat.npz", tmp_path / "leaving.toml"
    x = np.arange(-3.0, 3.01, 0.1)
    np.savez(ground, x_m=x, y_m=x, height_m=np.zeros((x.size, x.size)))
    leaving.write_text("[start]\nx_m = 2.2\n" + PLAN)
    done = run("twin", "predict", leaving, "--terrain", ground)
    advice = next(line for line in done.out.splitlines() if line.startswith("what may help: "))
    assert done.code == 3 and "heights that reach farther" in advice
    weak = ("twin", "predict", "--sweep", "friction_angle_deg=8:9:2")
    for more, halts in (((), True), (("--fixes", "0.05,0.5"), False)):
        assert ("halts to be localised" in run(*weak, *more).out) == halts


@pytest.mark.parametrize("name", ["drive.bmp", "drive"])
def test_a_film_of_another_kind_is_wrong_usage(run, plan: Path, tmp_path: Path, name: str) -> None:
    wrong = run("twin", "predict", plan, "--animate", tmp_path / name)
    assert (wrong.code, wrong.out, len(wrong.err)) == (2, "", 1) and ".gif, .mp4" in wrong.err[0]


def test_the_sun_and_an_empty_battery(run, plan: Path) -> None:
    """60 W of electronics for 20 s are 0.33 Wh; a battery without charge and Sun is empty, and that is exit code 3."""
    done = run("twin", "predict", plan, "--sun", "0,30", "--json")
    power = json.loads(done.out)["result"]["power"]
    assert done.code == 0 and power["drawn"]["p50_wh"] > 0.33 and power["panels"]["lit_share"] == 1.0
    empty = run("twin", "predict", plan, "--charge", "0")
    assert empty.code == 3 and "battery runs empty in 4 of 4 drives" in " ".join(empty.err)
    assert "no Sun given" in empty.out and "empty in 4 of 4" in empty.out
    for option in (("--sun", "30"), ("--sun", "0,95"), ("--charge", "1.5"), ("--sun", "noon@1,2")):
        wrong = run("twin", "predict", plan, *option)
        assert (wrong.code, wrong.out, len(wrong.err)) == (2, "", 1) and option[0] in wrong.err[0]
