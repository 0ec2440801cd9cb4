"""`lunarsci twin sweep`: table, CSV, JSON, pages, and what it refuses."""

import csv
import io
import json
from pathlib import Path

import pytest

PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.0\n"


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def test_a_trade_as_table_csv_json_and_pages(run, plan: Path, tmp_path: Path) -> None:
    """Two radii, of which the second does not fit, and two masses; the lighter rover needs less work."""
    vary = ["--vary", "wheel.radius_m=0.15:0.3:2", "--vary", "mass.body_kg=90:120:2", "--sample", "0.25"]
    pages = tmp_path / "trade.pdf"
    done = run("twin", "sweep", plan, *vary, "--plot", pages)
    assert done.code == 0, done.err
    assert "Impossible designs" in done.out and "do not fit 0.5 m" in done.out and "100 %" in done.out
    assert pages.read_bytes().count(b"/Type /Page ") == 2
    rows = list(csv.DictReader(io.StringIO(run("twin", "sweep", plan, *vary, "--csv").out)))
    assert [row["mass.body_kg"] for row in rows] == ["90.0", "120.0", "90.0", "120.0"]
    assert [bool(row["impossible"]) for row in rows] == [False, False, True, True]
    result = json.loads(run("twin", "sweep", plan, *vary, "--json").out)["result"]
    light, heavy = result["designs"][:2]
    assert light["energy_p50_j"] < heavy["energy_p50_j"] and result["front"] == [0]
    assert result["designs"][2]["energy_p50_j"] is None
    assert run("twin", "sweep", plan, *vary, "--field", "designs.0.kept_share").out.strip() == "1.0"


def test_samples_of_the_ranges_and_several_plans(run, plan: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(PLAN.replace("1.0", "0.5"))
    arguments = ["--vary", "wheel.width_m=0.1:0.2:2", "--designs", "3", "--seed", "7", "--json", "--no-time"]
    one = run("twin", "sweep", plan, other, *arguments)
    found = json.loads(one.out)["result"]
    assert len(found["designs"]) == 3 and found["plans"] == [str(plan), str(other)]
    assert one.out == run("twin", "sweep", plan, other, *arguments).out
    assert found["designs"][0]["duration_s"] == pytest.approx(1.5 / 0.05)


def test_members_without_a_soil_are_drawn_from_the_priors_as_those_of_a_prediction_are(run, plan: Path) -> None:
    sweep = ("twin", "sweep", plan, "--vary", "wheel.radius_m=0.14:0.16:2", "--members", "3", "-q")
    assert "soil: 3 drawn from the priors (before any drive)" in run(*sweep).out
    done = run(*sweep, "--json")
    result = json.loads(done.out)["result"]
    assert done.code == 0 and result["soil"]["of"] == "priors" and result["designs"][0]["kept_share"] == 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--vary"),
        (["--vary", "mass.body_kg=1:2:2", "--vary", "mass.body_kg=1:2:2"], "varied twice"),
        (["--vary", "mass.body_kg=90:120:50", "--vary", "mass.wheel_kg=1:2:50"], "designs is 2500"),
        (["--vary", "mass.body_kg=90:120:2", "--designs", "0"], "designs"),
    ],
)
def test_what_is_impossible_is_wrong_usage_in_one_line(run, plan: Path, arguments: list[str], words: str) -> None:
    done = run("twin", "sweep", plan, *arguments)
    assert (done.code, done.out) == (2, "") and words in " ".join(done.err), done.err


def test_a_mission_on_which_every_design_is_impossible_leaves_with_3(run, plan: Path) -> None:
    done = run("twin", "sweep", plan, "--vary", "wheel.radius_m=0.3:0.4:2")
    assert done.code == 3 and "no design is possible" in " ".join(done.err) and "do not fit" in done.out
    missing = run("twin", "sweep", plan.with_name("none.toml"), "--vary", "wheel.radius_m=0.1:0.2:2")
    assert (missing.code, missing.out) == (1, "")


def test_a_battery_counts_where_its_charge_is_given(run, tmp_path: Path) -> None:
    """66 W and the work of the wheels for 60 s: 1.2 Wh and more, out of 1 or 2 Wh."""
    plan = tmp_path / "plan.toml"
    plan.write_text("[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 3.0\n")
    asked = ("twin", "sweep", plan, "--vary", "power.battery_wh=1:2:2", "--soil", "longji", "-q", "--charge", "1")
    rows = json.loads(run(*asked, "--json").out)["result"]["designs"]
    assert [row["kept_share"] for row in rows] == [0.0, 1.0]
    taken = 66.0 * 60.0 + rows[1]["energy_p50_j"] / 0.4
    left = [1.0 - taken / 3600.0, 1.0 - taken / 7200.0]
    assert [row["least_charge"] for row in rows] == pytest.approx(left, rel=1e-6)
    assert "the battery runs empty" in rows[0]["reasons"] and "battery left" in run(*asked).out
