"""`lunarsci twin plan --risk`: the drive to take, for people, for scripts, and where there is none."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.twin.jobs.plan import plan
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.plans.risk import AcceptedRisk

BASE = ("twin", "plan", "--target", "3,0.5", "--candidates", "6", "--members", "16", "-q", "--no-time")


def test_the_best_comes_first_and_its_plan_can_be_predicted(run, belief: Path, tmp_path: Path) -> None:
    folder = tmp_path / "chosen"
    done = run(*BASE, "--risk", "0.2", "--soil", belief, "--json", "-o", folder)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    choice = document["result"]["choice"]
    assert document["schema"] == "lunarsci/twin-plan/1" and choice["feasible"]
    first = choice["candidates"][0]
    assert first["number"] == choice["best"] and first["promised"]["risk"] <= 0.2 and first["promised"]["drives"] == 32
    risks = [one["promised"] or one["screened"] for one in choice["candidates"]]
    assert all(one["risk_low"] <= one["risk"] <= one["risk_high"] for one in risks)
    assert {f"plan-{number:02d}.toml" for number in choice["front"]} <= {path.name for path in folder.iterdir()}
    plan = read_plan(str(folder / "plan.toml"))
    assert plan.length_m == pytest.approx(first["length_m"]) and plan.made_for is not None
    table = pd.read_csv(folder / "candidates.csv")
    assert len(table) == len(choice["candidates"]) and table["number"][0] == first["number"]
    driven = run("twin", "predict", folder / "plan.toml", "--terrain", folder / "terrain.npz", "--soil", belief, "-q")
    assert driven.code == 0, driven.out + driven.stderr


def test_what_is_accepted_of_a_risk_is_accepted_by_the_prediction(run, belief: Path, tmp_path: Path) -> None:
    """A drive that misses its end on some soils: go at the risk that the plan took, else no-go."""
    chosen, plan = tmp_path / "chosen", tmp_path / "chosen" / "plan.toml"
    on = ("--terrain", chosen / "terrain.npz", "--soil", belief, "--members", "32", "--seed", "3", "-q")
    taken = run(*BASE, "--risk", "0.2", "--soil", belief, "-o", chosen)
    assert taken.code == 0 and "states the accepted risk, 20 %" in taken.out
    assert read_plan(str(plan)).accepted_risk == AcceptedRisk(0.2)
    # A tolerance that a tenth of the drives miss.
    run("twin", "predict", plan, *on, "-o", tmp_path / "once")
    ends = pd.read_csv(tmp_path / "once" / "endpoints.csv")
    tight = float(np.quantile(ends["miss_m"], 0.9))
    text = plan.read_text()
    line = next(one for one in text.splitlines() if one.startswith("endpoint_miss_m"))
    plan.write_text(text.replace(line, f"endpoint_miss_m = {tight:.6f}"))
    failed = int((ends["miss_m"] > round(tight, 6)).sum())
    risk = (failed + 0.5) / 33.0

    accepted, strict = run("twin", "predict", plan, *on, "--json"), run("twin", "predict", plan, *on, "--risk", "0.05")
    result = json.loads(accepted.out)["result"]
    assert accepted.code == 0 and result["verdict"] == "go" and result["accepted_risk"] == 0.2
    assert result["chance"]["failed"] == failed >= 3 and result["chance"]["risk"] == pytest.approx(risk)
    assert next(one for one in result["limits"] if one["quantity"] == "endpoint_miss_m")["share"] == 0.8
    assert (
        strict.code == 3 and f"{failed} of 32 drives break a limit" in strict.out and "5.0 % is accepted" in strict.out
    )
    # The rule of a plan that says nothing, and of drives that are too few to promise a risk.
    plan.write_text(plan.read_text().replace("accepted_risk = 0.2\n", ""))
    alone = run("twin", "predict", plan, *on)
    assert alone.code == 3 and "endpoint_miss_m: 4 of 32 drives break" in alone.out and "95 % of drives" in alone.out


def test_the_table_can_be_read_aloud(run, belief: Path) -> None:
    done = run(*BASE, "--risk", "0.2", "--soil", belief, "--fixes", "0.05,0.5")
    lines = done.out.splitlines()
    assert done.code == 0 and lines[0].startswith("take drive ")
    rows = lines[3 : next(number for number, line in enumerate(lines) if line.startswith("drive "))]
    assert 6 <= len(rows) <= 12 and max(map(len, rows)) <= 80


def test_a_limit_that_no_soil_keeps_ends_with_code_3_and_the_reason(run, belief: Path, tmp_path: Path) -> None:
    folder = tmp_path / "none"
    done = run(*BASE, "--risk", "0.05", "--soil", belief, "--tolerance", "0.001", "-o", folder)
    assert done.code == 3 and "no drive keeps a risk of 5 %" in " ".join(done.err)
    assert "endpoint_miss_m" in " ".join(done.err) and done.out.startswith("NO-GO")
    assert "limit 0.001 m (" in " ".join(done.err) and "so there is no plan.toml" in " ".join(done.err)
    (front,) = {f"{one.name}" for one in folder.glob("plan-*.toml")} & set(re.findall(r"as (plan-\d+\.toml)", done.out))
    assert "--fixes, a nearer target or a wider --tolerance, or a higher --risk" in done.out and front
    assert not (folder / "plan.toml").exists() and (folder / "candidates.csv").exists()


def test_no_path_at_all_ends_with_code_1(run) -> None:
    done = run(*BASE, "--risk", "0.05", "--max-slope", "1")
    assert done.code == 1 and done.out == "" and len(done.err) == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--risk", "1.5"), "--risk"),
        (("--risk", "nan"), "--risk"),
        (("--risk", "0.001"), "takes 499 --members or more"),
        (("--risk", "0.1", "--tolerance", "0"), "--tolerance"),
        (("--risk", "0.1", "--candidates", "0"), "--candidates"),
        (("--risk", "0.1", "--fixes", "a"), "--fixes"),
        (("--risk", "0.1", "--soil", "longji"), "--sweep"),
        (("--risk", "0.1", "--prefer", "beauty"), "beauty"),
        (("--risk", "0.1", "--target", "40,0"), "compares drives of up to 30 m"),
        (("--fixes", "0.1,1"), "give --risk, too"),
    ],
)
def test_impossible_options_are_wrong_usage(run, options: tuple[str, ...], said: str) -> None:
    done = run(*BASE, *options)
    assert done.code == 2 and said in " ".join(" ".join(done.err).replace("│", " ").split()) and done.out == ""


def test_limits_of_a_mission_are_counted_and_written(run, belief: Path, tmp_path: Path) -> None:
    """Against a miss that most drives have, more fail than against the metre that is assumed."""
    limits, folder = tmp_path / "limits.toml", tmp_path / "chosen"
    limits.write_text('[limits]\nendpoint_miss_m = 0.03\ntilt_deg = { value = 19.0, source = "rule 7" }\n')
    lax, strict = (
        json.loads(run(*BASE, "--risk", "0.9", "--soil", belief, "--json", "-o", folder, *more).out)["result"]["choice"]
        for more in ((), ("--limits", limits, "--force"))
    )
    risks = [choice["candidates"][0]["promised"]["risk"] for choice in (lax, strict)]
    assert risks[0] < 0.1 and risks[1] > 0.3
    said = {one.quantity: one for one in read_plan(str(folder / "plan.toml")).limits}
    assert (said["endpoint_miss_m"].limit, said["endpoint_miss_m"].assumed) == (0.03, False)
    assert (said["tilt_deg"].limit, said["tilt_deg"].source) == (19.0, "rule 7")
    assert said["slip_ratio"].limit == 0.3 and said["slip_ratio"].assumed
    done = run(*BASE, "--risk", "0.9", "--soil", belief, "--limits", folder / "plan.toml", "--tolerance", "0.5")
    assert done.code == 2 and "--tolerance and endpoint_miss_m of" in done.err[0]
    limits.write_text("tilt_deg = 3.0\n")
    done = run(*BASE, "--risk", "0.9", "--soil", belief, "--limits", limits)
    assert done.code == 1 and "no [limits] in it" in done.err[0]


def test_all_that_takes_long_tells_how_far_it_is(belief: Path) -> None:
    """Maps, the search, how candidates slip, and their drives (also those on fresh soils), none with a step back."""
    heard: list[tuple[int, int]] = []
    asked = {"target": "3,0.5", "risk": 0.2, "candidates": 3, "members": 16, "soil": (str(belief),)}
    found = plan(progress=lambda done, total: heard.append((done, total)), **asked)
    totals = list(dict.fromkeys(total for _, total in heard))
    maps, search, slips, drives = ([done for done, of in heard if of == total] for total in totals)
    assert maps[-1] == totals[0] == 1  # tile
    assert search == [*range(totals[1] + 1)] and totals[1] >= 3  # manners of driving
    assert slips == sorted(slips) and slips[-1] == totals[2] == 3  # candidates, driven to see how far they slip
    assert drives == sorted(drives) and drives[0] == 0 and totals[3] >= 3 * 16 + 3 * 32
    driven = sum(one["screened"]["drives"] for one in found.to_dict()["choice"]["candidates"])
    assert driven >= 48 and drives[-1] == totals[3] and 48 in drives


def test_a_battery_that_does_not_reach_is_what_stands_in_the_way(run, belief: Path) -> None:
    """At 60 W of electronics a drive of 60 s takes 1 Wh of 120 Wh: with 0.5 % of the battery none gets there."""
    done = run(*BASE, "--risk", "0.2", "--soil", belief, "--charge", "0.005", "--json")
    assert done.code == 3 and "battery_charge" in " ".join(done.err)
    choice = json.loads(done.out)["result"]["choice"]
    assert all(one["worst"]["quantity"] == "battery_charge" for one in choice["candidates"])
    full = run(*BASE, "--risk", "0.2", "--soil", belief, "--charge", "1", "--json")
    assert full.code == 0, full.err
    best = json.loads(full.out)["result"]["choice"]["candidates"][0]
    assert 1.0 - best["least_charge"] == pytest.approx(best["duration_s"] * 67.0 / 3600.0 / 120.0, rel=0.15)
    assert run(*BASE, "--risk", "0.2", "--charge", "2").code == 2 and run(*BASE, "--charge", "1").code == 2
