"""`lunarsci twin forces` along predictions, `twin loads` along given motions, and what passes between commands."""

import json
from pathlib import Path

import pandas as pd
import pytest

from lunarsci.regolith.belief import first_belief

PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.5\ncurvature_per_m = 0.1\n"
WEIGHT = 135.0 * 1.622


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def test_forces_of_a_predicted_drive(run, plan: Path, tmp_path: Path) -> None:
    picture = tmp_path / "f.png"
    done = run("twin", "forces", plan, "--json", "--plot", picture)
    assert done.code == 0 and picture.stat().st_size > 20_000
    result = json.loads(done.out)["result"]
    assert result["of"] == "prediction" and result["missing"] is None
    assert [wheel["wheel"] for wheel in result["wheels"]] == ["FL", "FR", "ML", "MR", "RL", "RR"]
    mean = sum(wheel["normal_force_n"]["mean"] for wheel in result["wheels"])
    assert mean == pytest.approx(WEIGHT, rel=0.01) and result["weight_n"] == pytest.approx(WEIGHT, rel=1e-3)
    csv = run("twin", "forces", plan, "--csv").out.splitlines()
    assert csv[0].startswith("member,distance_m,time_s,wheel") and len(csv) == 1 + 6 * 16


def test_forces_of_several_soils_count_alike(run, plan: Path) -> None:
    done = run("twin", "forces", plan, "--sweep", "friction_angle_deg=30:50:3", "--field", "members")
    assert done.code == 0 and done.out == "3\n"
    assert run("twin", "forces", plan, "--seed", "4").code == 2, "one drive has nothing to draw"


def test_a_motion_is_explained_by_its_soil_and_not_by_another(run, plan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    predicted = run("twin", "predict", plan, "--soil", "longji", "-o", folder)
    assert predicted.code == 0 and "the verdict is about this one soil" in predicted.out
    assert "95 % of drives" not in predicted.out and "p50" not in predicted.out, predicted.out
    motion = ("twin", "loads", plan, "--motion", folder / "paths.csv")
    done = run(*motion, "--json")
    assert done.code == 0, done.err
    missing = json.loads(done.out)["result"]["missing"]
    assert missing["rms_share_of_weight"] < 0.01
    # Poses of another place: on this slope the wheels would have to pull as they did not.
    table = pd.read_csv(folder / "paths.csv")
    table["x_m"] += 5.5
    table.to_csv(tmp_path / "moved.csv", index=False)
    moved = run("twin", "loads", plan, "--motion", tmp_path / "moved.csv")
    assert moved.code == 3 and "unexplained" in moved.err[-1]
    rows = run(*motion, "--csv").out.splitlines()
    assert rows[0].endswith("missing_ahead_n,missing_left_n,missing_moment_nm,rover,ground")


def test_a_motion_without_commands_asks_for_them(run, plan: Path, tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    path.write_text("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n1,0.05,0,0\n2,0.1,0,0\n")
    done = run("twin", "loads", "--motion", path)
    assert done.code == 1 and "give the plan" in done.err[0] and done.out == ""
    assert run("twin", "loads").code == 2


def test_a_posterior_passes_from_forces_to_the_next_prediction(run, plan: Path, tmp_path: Path) -> None:
    states, soils = tmp_path / "states.csv", tmp_path / "soils.csv"
    assert run("twin", "forces", plan, "-o", states).code == 0
    identified = run("regolith", "infer", states, "--posterior", soils)
    assert identified.code == 0, identified.err
    draws = pd.read_csv(soils, comment="#")
    assert len(draws) == 4000 and draws["stiffness_kpa_m_n"].quantile(0.025) < 1443.0 < draws[
        "stiffness_kpa_m_n"
    ].quantile(0.975)
    done = run("twin", "predict", plan, "--soil", soils, "--members", "20", "--json")
    result = json.loads(done.out)
    assert done.code == 3 and "inferred by the law" in result["result"]["doubt"]
    assert run("twin", "predict", plan, "--soil", soils, "--members", "20").out.count("inferred by the law") == 1
    assert result["result"]["members"] == 20 and str(soils) in {file["path"] for file in result["provenance"]["inputs"]}
    assert run("twin", "predict", plan, "--soil", soils, "--sweep", "cohesion_pa=1:2:2").code == 2
    assert run("regolith", "identify", states, "--posterior", tmp_path / "x.csv").code == 2
    assert run("regolith", "infer", states, "--posterior", soils).code == 2  # it exists


def test_states_at_a_halt_are_not_valid(run, tmp_path: Path) -> None:
    """Steering in place pulls at wheels without slip: taken as a soil's, such states put its friction at 89 deg."""
    path, states = tmp_path / "plan.toml", tmp_path / "states.csv"
    path.write_text(PLAN + "[[leg]]\nturn_deg = -30\n[[leg]]\nlength_m = 1.0\ncrab_deg = 180\n")
    assert run("twin", "forces", path, "-o", states).code == 0
    table = pd.read_csv(states)
    assert 0 < (~table["valid"]).sum() < 0.6 * len(table)
    assert (table.loc[~table["valid"], "slip_ratio"] == 0).all()
    done = run("regolith", "infer", states, "--json")
    friction = json.loads(done.out)["result"]["joint"]["parameters"]["friction_angle_deg"]
    assert friction["low95"] < 42.0 < friction["high95"] < 60.0


def test_fixes_and_interpolation_are_options(run, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN + "[[leg]]\nturn_deg = 30\n[[leg]]\nlength_m = 0.5\n")
    done = run(
        "twin", "predict", path, "--soil", "longji", "--fixes", "0.05,0.5", "--interpolation", "triangles", "--json"
    )
    assert done.code == 0, done.err
    assert json.loads(done.out)["result"]["path_length_m"] == 2.0
    for wrong, code in ((("--fixes", "0.05"), 2), (("--fixes", "-1,1"), 2), (("--interpolation", "cubic"), 1)):
        assert run("twin", "predict", path, *wrong).code == code


def test_a_belief_may_be_the_soil(run, plan: Path, tmp_path: Path) -> None:
    """Of `predict` and `forces`; broken beliefs are one line, other soils beside it wrong usage."""
    belief = tmp_path / "belief.json"
    belief.write_text(first_belief().to_json())
    for command in ("predict", "forces"):
        done = run("twin", command, plan, "--soil", belief, "--members", "8", "--json")
        assert done.code == 0, done.err
        document = json.loads(done.out)
        assert document["result"]["members"] == 8
        soil = document["result"]["soil"]
        assert soil.items() >= {"belief": str(belief), "drives": 0, "learned_from": 0, "of": "belief"}.items()
        assert soil["parameters"] == {} and len(soil["drawn"]) == 8 and document["provenance"]["options"]["soil"]
        assert str(belief) in {file["path"] for file in document["provenance"]["inputs"]}
        assert "(before any drive)" in run("twin", command, plan, "--soil", belief, "--members", "8").out
        for other in (("--sweep", "cohesion_pa=1:2:2"), ("--soil", belief)):
            wrong = run("twin", command, plan, "--soil", belief, *other)
            assert wrong.code == 2 and "give one" in wrong.err[0]
    for text, says in (("{}", "schema"), (belief.read_text()[:200], "is the file complete"), ("[]", "schema")):
        belief.write_text(text)
        done = run("twin", "predict", plan, "--soil", belief)
        assert done.code == 1 and says in done.err[0] and str(belief) in done.err[0] and done.out == ""
