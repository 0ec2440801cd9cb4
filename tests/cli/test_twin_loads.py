"""`lunarsci twin loads` with uncertain motion and soil, and what it hands on (synthetic drives)."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.5\ncurvature_per_m = 0.1\n"
FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Plan, motion and states of a predicted drive, with errors said; not to be written into."""
    tmp_path = tmp_path_factory.mktemp("drive")
    paths = {name: tmp_path / f"{name}.csv" for name in ("motion", "states")} | {"plan": tmp_path / "plan.toml"}
    paths["plan"].write_text(PLAN)
    assert main(["twin", "predict", str(paths["plan"]), "--soil", "longji", "-q", "-o", str(tmp_path / "drive")]) == 0
    motion = pd.read_csv(tmp_path / "drive" / "paths.csv")
    motion = motion.assign(x_m_sigma=0.004, y_m_sigma=0.004, yaw_deg_sigma=0.2)
    motion.to_csv(paths["motion"], index=False)
    states = pd.read_csv(tmp_path / "drive" / "states.csv").drop(columns=[*FORCES, "resistance_torque_nm", "member"])
    states = states.assign(sinkage_m_sigma=0.0005, slip_ratio_sigma=0.01, side_slip_deg_sigma=0.6)
    states.loc[:5, "valid"] = False
    states.to_csv(paths["states"], index=False)
    return paths


@pytest.fixture(scope="module")
def soil(files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the soil after rounds of forces and soil in turn, `soil.json`, and their `result.json`."""
    folder = tmp_path_factory.mktemp("soil")
    on = [str(part) for part in (files["plan"], "--motion", files["motion"], "--states", files["states"])]
    to = ["--save", str(folder / "soil.json"), "-o", str(folder / "result.json")]
    assert main(["twin", "loads", *on, "--draws", "16", "--iterate", "8", "-q", *to]) == 0
    return folder


def test_telemetry_becomes_forces_with_sigmas_and_a_soil(run, files: dict[str, Path], tmp_path: Path) -> None:
    folder, picture = tmp_path / "out", tmp_path / "forces.png"
    start = ("twin", "loads", files["plan"], "--motion", files["motion"], "--states", files["states"])
    done = run(*start, "--draws", 32, "-o", folder, "--plot", picture, "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)["result"]
    assert result["of"] == "uncertain motion" and result["draws"] == 32 and result["iteration"] is None
    assert result["motion_errors"] == {"correlation_m": pytest.approx(0.4), "basis": "slip errors"}
    before, after = (result["shares"]["drawbar_pull_n"][key] for key in ("before", "after"))
    assert before["soil"] > 0.7 and after["of_force"] < before["of_force"]
    assert result["totals"]["ahead"]["sigma_after"] < 0.2 * result["totals"]["ahead"]["sigma_before"]
    assert picture.stat().st_size > 30_000 and json.loads((folder / "result.json").read_text())["result"] == result
    table = pd.read_csv(folder / "forces.csv")
    assert len(table) == 6 * 16 and table["valid"].sum() > 60
    assert set(table["rover"]) == {"yutu2; wheels 150 x 150 mm"}
    assert not table["valid"][:6].any() and table["normal_force_n"][:6].notna().all()
    for name in FORCES:
        assert (table.loc[table["valid"], f"{name}_sigma"] > 0).all()
    identified = run("regolith", "infer", folder / "forces.csv")
    assert identified.code == 0, identified.err


def test_forces_and_soil_in_turn_leave_a_belief(run, files: dict[str, Path], soil: Path) -> None:
    start = ("twin", "loads", files["plan"], "--motion", files["motion"], "--states", files["states"], "--draws", 16)
    saved = soil / "soil.json"
    turned = json.loads((soil / "result.json").read_text())["result"]["iteration"]
    assert turned["converged"] and turned["verdict"] == "converged" and 1 < len(turned["rounds"]) <= 8
    assert turned["parameters"]["stiffness_kpa_m_n"]["left_of_prior"] < 0.8
    history = json.loads(saved.read_text())["history"]
    assert history[-1]["states"] == "states.csv" and history[-1]["verdict"] == "converged"
    again = run("twin", "loads", files["plan"], "--motion", files["motion"], "--belief", saved, "--draws", 16, "--json")
    shares = json.loads(again.out)["result"]["shares"]["drawbar_pull_n"]["before"]
    assert again.code == 0 and shares["soil"] < 0.9
    once = run(*start, "--iterate", 1)
    assert once.code == 3 and "does not converge within 1 round" in once.err[-1]
    assert "Forces and soil in turn: does not converge" in once.out


def test_a_motion_elsewhere_is_beyond_all_soils(run, files: dict[str, Path], soil: Path, tmp_path: Path) -> None:
    """A belief that knows the soil, and poses shifted to another slope."""
    start = ("twin", "loads", files["plan"], "--draws", 16)
    table = pd.read_csv(files["motion"])
    table["x_m"] += 5.5
    table.to_csv(tmp_path / "moved.csv", index=False)
    moved = run(*start, "--motion", tmp_path / "moved.csv", "--belief", soil / "soil.json", "--balance-error", 0.002)
    assert moved.code == 3 and "beyond the drawn soils" in moved.err[-1]


@pytest.mark.parametrize(
    "options",
    [
        ("--seed", "4"),
        ("--draws", "32", "--soil", "longji"),
        ("--draws", "32", "--iterate", "3"),
        ("--states", "s.csv", "--save", "b.json"),
    ],
)
def test_options_that_would_do_nothing_are_refused(run, options: tuple[str, ...]) -> None:
    done = run("twin", "loads", "--motion", "m.csv", *options)
    assert done.code == 2 and done.out == "" and options[-2] in " ".join(done.err)


def test_a_correlation_without_errors_and_a_plan_beside_commands_are_refused(
    run, files: dict[str, Path], tmp_path: Path
) -> None:
    table = pd.read_csv(files["motion"])
    bare = tmp_path / "bare.csv"
    table.drop(columns=["x_m_sigma", "y_m_sigma", "yaw_deg_sigma"]).to_csv(bare, index=False)
    done = run("twin", "loads", files["plan"], "--motion", bare, "--draws", 16, "--correlation", 0.5)
    assert done.code == 2 and done.out == ""
    exact = run("twin", "loads", files["plan"], "--motion", bare, "--draws", 16)
    assert exact.code == 0 and "it counts as exact" in exact.out
    for wheel in ("FL", "FR", "ML", "MR", "RL", "RR"):
        table[f"steering_{wheel}_deg"], table[f"speed_{wheel}_m_s"] = 0.0, np.full(len(table), 0.05)
    table.to_csv(bare, index=False)
    assert "leave out the plan" in run("twin", "loads", files["plan"], "--motion", bare, "--draws", 16).err[-1]
    bare.write_text("time_s,x_m,y_m,yaw_deg\n0,0,0,0\n1,0.05,0,0\n2,0.1,0,0\n")
    assert "leave it out" in run("twin", "loads", files["plan"], "--motion", bare, "--member", 0).err[-1]
