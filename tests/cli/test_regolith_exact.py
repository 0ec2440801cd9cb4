"""`lunarsci regolith forces --exact` and `infer`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import RequestError
from lunarsci.regolith.integrals import integrated_forces
from lunarsci.regolith.jobs.infer import infer
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.wheel import read_wheel

FORCES = ("regolith", "forces", "--sinkage", "0.012", "--slip", "0.2", "--side-slip", "5")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Synthetic: exact forces of lunar-typical soil at 24 states, without errors."""
    rng = np.random.default_rng(0)
    z, slip, side = rng.uniform(0.006, 0.018, 24), rng.uniform(-0.2, 0.4, 24), rng.uniform(1, 8, 24)
    found = integrated_forces(read_wheel("yutu2"), read_soil("lunar-typical"), z, slip, side)
    columns = (z, slip, side, found.normal_force_n, found.drawbar_pull_n, found.lateral_force_n)
    path = tmp_path / "drive.csv"
    rows = [",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True)]
    header = "sinkage_m,slip_ratio,side_slip_deg,normal_force_n,drawbar_pull_n,lateral_force_n"
    path.write_text(header + "\n" + "\n".join(rows) + "\n")
    return path


def result(run, *arguments: object) -> dict[str, Any]:
    done = run(*arguments, "--json")
    assert done.code == 0, done.err
    found: dict[str, Any] = json.loads(done.out)["result"]
    return found


def test_exact_forces_lie_above_the_closed_form_and_have_moments(run) -> None:
    closed, exact = result(run, *FORCES), result(run, *FORCES, "--exact")
    assert 1.04 <= exact["normal_force_n"] / closed["normal_force_n"] <= 1.18
    assert "steering_moment_nm" not in closed
    assert exact["overturning_moment_nm"] < 0
    assert closed["model"] is None
    assert exact["model"]["shear"] == "separate"
    assert "overturning moment" in run(*FORCES, "--exact").out


def test_choices_of_the_integrals_imply_them(run) -> None:
    for choice in (("--bulldozing", "wong"), ("--rebound", "0.3"), ("--shear", "ellipse")):
        assert result(run, *FORCES, *choice) == result(run, *FORCES, *choice, "--exact")


def test_the_joint_posterior_holds_the_soil_that_made_the_states(run, drive: Path) -> None:
    joint = result(run, "regolith", "infer", drive, "--exact")["joint"]
    soil = read_soil("lunar-typical")
    assert joint["order"] == list(PARAMETERS)
    assert set(joint["parameters"]) == set(PARAMETERS)
    for name, found in joint["parameters"].items():
        assert found["low95"] <= found["low"] <= found["median"] <= found["high"] <= found["high95"]
        if found["determined"]:
            assert found["low95"] <= getattr(soil, name) <= found["high95"], name
    assert joint["parameters"]["shear_modulus_mm"]["determined"]
    assert joint["outliers"] == []
    assert len(joint["correlation"]) == len(PARAMETERS)
    shown = run("regolith", "infer", drive)
    assert "The soil of all " in shown.out
    assert "known to" in shown.out


def test_priors_of_the_user_are_used_and_named(run, drive: Path, tmp_path: Path) -> None:
    prior = tmp_path / "prior.toml"
    prior.write_text("[cohesion_pa]\nmedian = 520\nsd = 0.01\n")
    done = run("regolith", "infer", drive, "--prior-file", prior, "--law", "given", "--draw-posterior", "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    found = document["result"]["joint"]
    assert found["parameters"]["cohesion_pa"]["median"] == pytest.approx(520, rel=0.02)
    assert found["persistence"] < 0.25
    assert str(prior) in [item["path"] for item in document["provenance"]["inputs"]]
    assert "joint" not in result(run, "regolith", "identify", drive)


def test_the_joint_posterior_has_one_reading(run, drive: Path) -> None:
    assert run("regolith", "infer", drive, "--reading", "printed").code == 2
    with pytest.raises(RequestError, match="`reading` printed only reproduces numbers"):
        infer(drive, reading="printed")


def test_slip_beyond_the_range_of_the_model_is_said(run) -> None:
    done = run("regolith", "forces", "--sinkage", "0.012", "--slip", "0.7")
    assert done.code == 0
    assert any("beyond 0.6" in line for line in done.err)


def test_moduli_of_reece_make_the_moon_softer_than_the_earth(run) -> None:
    options = ("regolith", "forces", "--load", "36", "--reece-cohesive", "0", "--reece-frictional", "677")
    moon, earth = (result(run, *options, "--gravity", g) for g in ("1.622", "9.81"))
    assert moon["soil"]["stiffness_kpa_m_n"] / earth["soil"]["stiffness_kpa_m_n"] == pytest.approx(1.622 / 9.81)
    assert moon["sinkage_m"] > earth["sinkage_m"]


def test_a_rut_carries_more(run) -> None:
    plain = result(run, *FORCES, "--exact")
    rut = result(run, *FORCES, "--exact", "--rut", "0.02", "--reload", "5e6")
    assert rut["normal_force_n"] > plain["normal_force_n"]


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (("--sinkage", "0.01", "--slip", "0.1", "--slip-sinkage", "linear"), "needs --load"),
        (("--load", "36", "--slip", "-0.1", "--slip-sinkage", "linear"), "skid has no such law"),
        (("--load", "36", "--reece-cohesive", "1"), "go together"),
        (("--load", "36", "--reece-cohesive", "1", "--reece-frictional", "1", "--stiffness", "800"), "give one"),
        (("--load", "36", "--rut", "0.01"), "a rut needs"),
        (("--load", "36", "--slip", "-1.1"), "within -1 to 1"),
        (("--load", "36", "--slip", "1", "--side-slip", "90"), "leaves it open"),
        (
            (
                "--sinkage",
                "0.16",
            ),
            "below the wheel radius",
        ),
    ],
)
def test_states_and_options_that_make_no_sense_are_refused(run, options: tuple[str, ...], hint: str) -> None:
    done = run("regolith", "forces", *options)
    assert done.code in (1, 2)
    assert hint in done.err[-1]
    assert done.out == ""


@pytest.mark.parametrize("exact", [(), ("--exact",)])
def test_a_pull_that_only_cohesion_gives_is_not_to_be_trusted(run, exact: tuple[str, ...]) -> None:
    done = run("regolith", "forces", "--sinkage", "2e-7", "--slip", "0.2", *exact, "--json")
    assert done.code == 3
    assert "cohesion alone would pull" in done.err[-1]
    assert json.loads(done.out)["result"]["cohesion_share"] > 10


def test_a_result_that_lacks_its_curves_is_refused_by_name(run, tmp_path: Path) -> None:
    path = tmp_path / "half.json"
    path.write_text('{"result": {"joint": {"parameters": {}}}}')
    done = run("regolith", "compare", path)
    assert done.code == 1
    assert "half.json" in done.err[-1]
    assert "regolith infer --json" in done.err[-1] and "give --stiffness" in done.err[-1]


def test_sensitivity_and_profile_are_in_the_result(run, drive: Path) -> None:
    found = result(run, "regolith", "infer", drive, "--sensitivity", "--profile")
    assert found["joint"]["intervals"] == "profile"
    assert {"parameter", "quantity", "alone", "saved"} == set(found["sensitivity"][0])
    done = run("regolith", "infer", drive, "--profile", "--draw-posterior")
    assert done.code == 2


@pytest.fixture
def turned(drive: Path, tmp_path: Path) -> Path:
    """The same states with the sign of the drawbar pull turned, and 5 % of scatter."""
    rng, lines = np.random.default_rng(2), drive.read_text().splitlines()
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    path = tmp_path / "turned.csv"
    body = [",".join(f"{v * (-1 if k == 4 else 1) * (1 + 0.05 * rng.standard_normal() * (k > 2)):.6f}"
                     for k, v in enumerate(row)) for row in rows]  # fmt: skip
    path.write_text("\n".join([lines[0], *body]) + "\n")
    return path


def test_a_fit_that_explains_nothing_is_said_kept_and_repeated_by_the_drive(run, turned: Path, tmp_path: Path) -> None:
    soils, belief = tmp_path / "soils.csv", tmp_path / "belief.json"
    for path in (soils, belief):
        done = run("regolith", "infer", turned, "--posterior", path, "--json")
        assert done.code == 3
        assert "drawbar_pull_n" in done.err[-1]
    verdict = json.loads(done.out)["result"]["joint"]["verdict"]
    assert not verdict["trusted"]
    assert json.loads(belief.read_text())["verdict"] == verdict
    plan = tmp_path / "plan.toml"
    plan.write_text("[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.2\n")
    for option in (("--soil", soils), ("--soil", belief)):
        done = run("twin", "predict", plan, *option, "--members", "1", "--json")
        assert done.code == 3
        assert json.loads(done.out)["result"]["soil_verdict"] == verdict
        assert any("fit that is not to be trusted" in line for line in done.err)


def test_straight_drives_are_trusted_together_though_single_states_leave_the_lateral_pair_open(
    run, drive: Path, tmp_path: Path
) -> None:
    lines = [line.split(",") for line in drive.read_text().splitlines()]
    straight = tmp_path / "straight.csv"
    rows = [[*line[:2], "0", *line[3:5], "0.01"] for line in lines[1:]]
    straight.write_text("\n".join(",".join(line) for line in (lines[0], *rows)) + "\n")
    assert run("regolith", "identify", straight).code == 3
    verdict = result(run, "regolith", "infer", straight)["joint"]["verdict"]
    assert verdict["trusted"]


def test_the_law_is_chosen_by_its_score_and_predicts_another_wheel(run, drive: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text("slip_ratio,normal_force_n\n0.2,20\n0.4,20\n")
    found = result(
        run,
        "regolith",
        "infer",
        drive,
        "--law",
        "auto",
        "--predict",
        other,
        "--predict-rover",
        "cmu-smooth",
    )["joint"]
    assert found["verdict"]["trusted"]
    assert {law["law"] for law in found["laws"]} >= {"closed", "separate", "combined + contact angles"}
    pulls = [state["drawbar_pull_n"] for state in found["predicted"]["states"]]
    assert all(pull["low90"] < pull["value"] < pull["high90"] for pull in pulls)
    assert pulls[0]["value"] < pulls[1]["value"]
    assert run("regolith", "infer", drive, "--law", "auto", "--exact").code == 2
