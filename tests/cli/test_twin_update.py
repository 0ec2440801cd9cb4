"""`lunarsci twin update`: from a drive to a belief, and from a belief to the next drive."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from lunarsci.io.inputs import read_input
from lunarsci.provenance import sha256
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief, with_drive
from lunarsci.twin.telemetry.sinkage import read_track


@pytest.mark.slow
def test_a_belief_goes_from_drive_to_drive(run, short_plan: Path, short_states: Path, tmp_path: Path) -> None:
    belief, again = tmp_path / "belief.json", tmp_path / "again.json"
    update = ("twin", "update", short_states, "--plan", short_plan, "--particles", "32")
    done = run(*update, "--save", belief, "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)["result"]
    assert result["refused"] is None and result["drives"] == 1 and result["outliers"] == 0
    assert result["parameters"]["stiffness_kpa_m_n"]["left_of_prior"] < 0.9
    # On the same seed the same belief, to the byte.
    assert run(*update, "--save", again, "-q").code == 0
    assert belief.read_bytes() == again.read_bytes()
    predicted = run("twin", "predict", short_plan, "--soil", belief, "--members", "16", "--field", "members")
    assert predicted.code == 0 and predicted.out == "16\n"
    assert result["ruts"] is False
    # The next update begins where this one ended, and refuses telemetry that no soil explains.
    table = pd.read_csv(short_states)
    table.loc[table["wheel"] == "FL", "sinkage_m"] += 0.05
    table.to_csv(tmp_path / "wrong.csv", index=False)
    wrong = run(
        *("twin", "update", tmp_path / "wrong.csv", "--plan", short_plan, "--particles", "32"),
        *("--soil", belief, "--forget", "0.1", "--save", tmp_path / "same.json"),
    )
    assert wrong.code == 3 and "nothing was learned" in wrong.err[-1]
    kept = json.loads((tmp_path / "same.json").read_text())
    assert len(kept["history"]) == 2 and kept["history"][1]["refused"]
    # The history holds where each belief came from, and the way back to it.
    assert [entry["parent_sha256"] for entry in kept["history"]] == [None, sha256(belief.read_bytes())]
    assert [entry["forgotten"] for entry in kept["history"]] == [0.0, 0.1]
    assert run("twin", "history", tmp_path / "same.json", "--rollback", "1", "--save", tmp_path / "back.json").code == 0
    back, first = (json.loads(path.read_text()) for path in (tmp_path / "back.json", belief))
    assert all(back[key] == first[key] for key in ("mean", "covariance", "history", "laws"))


@pytest.mark.slow
def test_other_ground_than_the_believed_is_warned_of(run, short_plan: Path, short_states: Path, tmp_path: Path) -> None:
    """A belief as sure as after many drives, of another soil: the exit code stays 0, and the belief keeps it."""
    first = first_belief()
    away = first.mean + 2.5 * np.sqrt(np.diag(first.covariance))
    other, new = tmp_path / "other.json", tmp_path / "new.json"
    other.write_text(SoilBelief(first.laws, away, 0.02 * first.covariance).to_json())
    update = ("twin", "update", short_states, "--plan", short_plan, "--particles", "32", "--save", new, "--force")
    done = run(*update, "--soil", other, "--json")
    assert done.code == 0 and any("is it the same ground" in line for line in done.err), done.err
    said = json.loads(done.out)["result"]
    assert said["surprise"] > 2 and "begin without --soil, or with --forget" in said["caution"], done.err
    assert "is it the same ground" in read_belief(read_input(str(new))).caution
    assert run(*update, "--soil", other, "--forget", "1", "-q").code == 0
    assert read_belief(read_input(str(new))).caution == ""


def test_the_doubt_of_a_drive_stays_with_the_belief_to_the_report(run, tmp_path: Path) -> None:
    """Wheels 7 % faster than the plan that is named, no sinkage, positions alone: picture, belief, and its doubt."""
    driven, plan = tmp_path / "driven.toml", tmp_path / "plan.toml"
    for path, speed in ((driven, 0.05), (plan, 0.05 / 1.07)):
        path.write_text(f"[drive]\nspeed_m_s = {speed:.6f}\n[[leg]]\nlength_m = 2.0\n")
    sent, found, belief = (tmp_path / name for name in ("sent", "found", "belief.json"))
    assert run("twin", "simulate", driven, "--fix-distance", "0.2", "-o", sent, "-q").code == 0
    assert run("twin", "states", sent / "telemetry.csv", driven, "-o", found, "-q").code in (0, 3)
    update = ("twin", "update", found / "states.csv", "--positions", found / "positions.csv", "--particles", "32")
    done = run(*update, "--plan", plan, "--save", belief, "--plot", tmp_path / "b.png", "--json", "-q")
    said = json.loads(done.out)["result"]
    assert done.code == 3 and "times as fast as the plan's speed_m_s" in said["doubt"] and said["pace"]["off"], done.err
    assert said["slip_ratio"]["measured"] > said["slip_ratio"]["simulated"] + 0.03
    assert said["slip_ratio"]["off"] and "predictions slip less than the rover does" in said["doubt"]
    assert (tmp_path / "b.png").stat().st_size > 5000 and json.loads(belief.read_text())["history"][0]["doubt"]
    used = ("--soil", belief, "--members", "4", "-q")
    pred, chosen = tmp_path / "pred", tmp_path / "chosen"
    choose = ("--target", "1.5,0", "--candidates", "2", "--members", "4", "--risk", "0.4", "--soil", belief, "-q")
    chain = [
        run("twin", "predict", driven, *used, "-o", pred),
        run("twin", "forces", driven, *used),
        run("twin", "sweep", driven, *used, "--vary", "wheel.radius_m=0.14:0.15:2"),
        run("twin", "plan", *choose, "-o", chosen),
        run("twin", "history", belief),
        run("twin", "compare", pred, found / "states.csv", "--plan", driven),
        run("twin", "loads", "--motion", found / "motion.csv", "--belief", belief, "--draws", "16", "-q"),
    ]
    for number, each in enumerate(chain):
        assert each.code == 3 and "states.csv: the wheels turned" in " ".join(each.err), (number, each.out, each.err)
    assert "doubtful" in chain[0].out.splitlines()[0] and "doubtful" in chain[3].out.splitlines()[0]
    assert "drive 1 is doubtful" in chain[4].out
    sections = json.loads(run("report", pred, chosen, "--json").out)["result"]["sections"]
    assert all("the wheels turned" in one["trust"] and one["tone"] in ("doubt", "no-go") for one in sections)
    assert [one["tone"] for one in sections].count("doubt") >= 1
    # A belief is told on a page by itself, with its doubt, its picture, and what the ground is like.
    page = tmp_path / "page.html"
    told = json.loads(run("report", belief, "--json").out)["result"]["sections"][0]
    assert told["tone"] == "doubt" and "the wheels turned" in told["trust"] and told["schema"] == "twin-history/1"
    assert "The soil for predictions, median and 68 %: " in told["answer"] and "synthetic" in told["answer"]
    assert run("report", belief, "-o", page).code == 0 and "the soil before any drive and now" in page.read_text()
    # The same drive held against a prediction for the plan that was named: the pace of the wheels is said there, too.
    swept = ("--sweep", "friction_angle_deg=36:44:4", "-o", tmp_path / "other", "-q")
    other = run("twin", "predict", plan, *swept)
    assert other.code == 0, other.err
    held = run("twin", "compare", tmp_path / "other", found / "states.csv", "--json")
    verdict = json.loads(held.out)["result"]
    assert held.code == 3 and "another drive than the predicted one: the wheels turned" in held.err[-1]
    assert verdict["pace"]["off"] and verdict["verdict"] != "trusted"
    # Only what is forgotten altogether takes the doubt along.
    forgotten = read_belief(read_input(str(belief)))
    assert forgotten.doubt
    later = with_drive(forgotten, forgotten, {"states": "b.csv", "doubt": ""}, forgotten=0.5)
    assert later.doubt == forgotten.doubt
    assert with_drive(later, later, {"states": "c.csv", "doubt": ""}, forgotten=1.0).doubt == ""


def test_ruts_are_driven_as_options_and_belief_say(run, short_plan: Path, tmp_path: Path) -> None:
    """Asked for, met by the belief's last drive, or left by a plan that was driven before."""
    quick = ("--time-step", "0.2", "--json")
    met, none, half = (tmp_path / name for name in ("met.json", "none.json", "half.json"))
    first = first_belief()
    for path, ruts in ((met, 1.0), (none, 0.0), (half, 0.5)):
        entry = {"states": "a.csv", "sha256": "0" * 64, "plan": "a", "values": 9, "outliers": 0, "chi_square": 9.0}
        path.write_text(
            with_drive(
                first, first, entry | {"surprise": 0.1, "refused": "", "ruts": ruts > 0.5, "ruts_probability": ruts}
            ).to_json()
        )

    def driven(*more: object) -> tuple[Any, Any, float]:
        done = run("twin", "predict", short_plan, *quick, *more)
        assert done.code in (0, 3), done.err
        result = json.loads(done.out)["result"]
        return (
            result["ruts"],
            result["before"],
            max(row["p50"] for row in result["limits"] if "sinkage" in row["quantity"]),
        )

    plain, ruts, back = driven(), driven("--ruts"), driven("--before", short_plan)
    assert plain[:2] == (False, None) and ruts[:2] == (True, None)
    assert back[0] is True and back[1] is not None
    assert plain[2] < ruts[2] < back[2]
    assert [driven("--soil", path, "--members", "4")[0] for path in (met, none)] == [True, False]
    assert driven("--soil", met, "--members", "4", "--no-ruts")[0] is False
    both = run("twin", "predict", short_plan, "--soil", half, "--members", "12", "--field", "ruts_share", "-q")
    assert float(both.out) == 0.5
    idle = run("twin", "predict", short_plan, "--before", short_plan, "--no-ruts")
    assert idle.code == 2 and "--ruts are left out" in idle.err[0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("wheel,sinkage_m\nFL,0.01\n", "no column time_s"),
        ("time_s,wheel,sinkage_m\n1,FL,deep\n", "deep"),
    ],
)
def test_bad_states_are_one_line_that_says_what_is_wrong(
    run, short_plan: Path, tmp_path: Path, text: str, says: str
) -> None:
    path = tmp_path / "states.csv"
    path.write_text(text)
    done = run("twin", "update", path, "--plan", short_plan, "--rover", "yutu2")
    assert done.code == 1 and says in done.err[-1] and done.out == ""


def test_positions_without_errors_have_2_cm(run, short_plan: Path, short_states: Path, tmp_path: Path) -> None:
    (tmp_path / "fixes.csv").write_text("time_s,x_m,y_m\n1,0,0\n")
    update = ("twin", "update", short_states, "--plan", short_plan, "--particles", "32", "--json")
    bare = run(*update, "--positions", tmp_path / "fixes.csv")
    assert any("0.02 m assumed, add sigma_m" in line for line in bare.err)
    (tmp_path / "fixes.csv").write_text("time_s,x_m,y_m,sigma_m\n1,0,0,0.02\n")
    stated = run(*update, "--positions", tmp_path / "fixes.csv")
    assert json.loads(bare.out)["result"] == json.loads(stated.out)["result"]


def test_states_and_beliefs_are_not_taken_for_another_rover(run, short_plan: Path, tmp_path: Path) -> None:
    """Four wheels of six, and nobody says whose they are; and a belief that another rover learned."""
    four = "".join(f"{t},{name},0.01\n" for t in range(1, 9) for name in ("FL", "FR", "RL", "RR"))
    path, belief = tmp_path / "states.csv", tmp_path / "b.json"
    path.write_text(f"time_s,wheel,sinkage_m\n{four}")
    update = ("twin", "update", path, "--plan", short_plan, "--particles", "32")
    refused = run(*update)
    assert refused.code == 1
    assert "no rover is named, so yutu2 is taken, and there are no states of its ML, MR" in refused.err[0]
    assert run(*update, "--rover", "small-four", "--save", belief).code in (0, 3)
    predict = ("twin", "predict", short_plan, "--soil", belief, "--members", "4")
    all_six = four + "".join(f"{t},{name},0.01\n" for t in range(1, 9) for name in ("ML", "MR"))
    (tmp_path / "six.csv").write_text(f"time_s,wheel,sinkage_m\n{all_six}")
    for command in (predict, ("twin", "update", tmp_path / "six.csv", "--plan", short_plan, "--soil", belief)):
        refused = run(*command)
        assert refused.code == 2, refused.err
        assert "was learned with 'small-four; wheels" in refused.err[0] and "--rover yutu2 to drive" in refused.err[0]
    same, other = (run(*predict, "--rover", name) for name in ("small-four", "yutu2"))
    assert not any("was learned with" in line for line in same.err) and "4 drives of small-four on" in same.out
    assert any("was learned with 'small-four; wheels" in line for line in other.err)
    assert any("this is on the synthetic stand-in" in line for line in same.err)
    real = json.loads(belief.read_text("utf-8"))
    del real["history"][-1]["synthetic"]
    belief.write_text(json.dumps(real), "utf-8")
    elsewhere = run(*predict, "--rover", "small-four")
    assert elsewhere.code == 2 and "was learned on measured ground" in elsewhere.err[-1]


def test_nothing_is_taken_from_the_wrong_ground(run, short_plan: Path, tmp_path: Path) -> None:
    """States, plan, start and belief of one terrain, and nobody, or somebody, names the ground."""
    for name, seed in (("here", 1), ("there", 2)):
        grid = ("--extent", "8", "--spacing", "0.1", "--seed", seed, "--crater-count", "0")
        where = ("--target", "1.5,0", "-o", tmp_path / name)
        assert run("twin", "plan", "synthetic", *grid, *where, "-q").code == 0
    here, there = (tmp_path / name / "terrain.npz" for name in ("here", "there"))
    plan, sent, found = tmp_path / "here" / "plan.toml", tmp_path / "sent", tmp_path / "found"
    on = ("--terrain", here)
    assert run("twin", "simulate", plan, *on, "--fix-distance", "0.3", "-o", sent, "-q").code == 0
    assert run("twin", "states", sent / "telemetry.csv", plan, *on, "-o", found, "-q").code in (0, 3)
    states, motion = found / "states.csv", found / "motion.csv"
    tables = [pd.read_csv(path) for path in (states, motion)]
    (ground,) = {name for table in tables for name in table["ground"]}
    assert ground.startswith("synthetic ground seed 1; heights ") and f'ground = "{ground}"' in plan.read_text()

    # Nobody names the ground: refused. The same terrain is taken without a word, another one is said.
    update, belief = ("twin", "update", states, "--plan", plan, "--particles", "32"), tmp_path / "b.json"
    elsewhere = [*update], ["twin", "loads", "--motion", motion], ["twin", "plan", "--target", "3,0", "--start", motion]
    for command in elsewhere:
        refused = run(*command)
        assert refused.code == 2 and "was made on 'synthetic ground seed 1', and no" in refused.err[-1], refused.err
        assert re.search("give its file as (--)?terrain", refused.err[-1])
        assert len(refused.err[-1]) < 300 + len(str(tmp_path))
    same = run(*update, *on, "--save", belief)
    assert same.code in (0, 3) and not any("made on" in line or "no ground" in line for line in same.err), same.err
    assert json.loads(belief.read_text())["history"][0]["ground"] == ground
    loads = run("twin", "loads", "--motion", motion, "--terrain", there)
    assert loads.code in (0, 3), loads.err
    assert any("made on 'synthetic ground seed 1', and this is on 'synthetic ground, seed 2'" in s for s in loads.err)

    # A plan and a belief are driven there, and it is said.
    drive = ("twin", "predict", plan, "--soil", belief, "--members", "4")
    for more, told in ((("--terrain", there), 2), (on, 0)):
        done = run(*drive, *more)
        assert done.code in (0, 3), done.err
        assert sum("synthetic ground seed 1', and this is" in line for line in done.err) == told, done.err
    # Made by hand, states name neither rover nor ground; of a map of the same name the heights are other ones.
    tables[0].drop(columns=["rover", "ground"]).to_csv(tmp_path / "bare.csv", index=False)
    bare = run("twin", "update", tmp_path / "bare.csv", "--plan", short_plan, "--particles", "32")
    assert any("no ground is named, so the synthetic stand-in" in line for line in bare.err), bare.err
    changed = tables[1].assign(ground=tables[1]["ground"].str[:-8] + "0" * 8)
    changed.to_csv(tmp_path / "m.csv", index=False)
    done = run("twin", "loads", "--motion", tmp_path / "m.csv", *on)
    assert any("with other heights than here" in line for line in done.err), done.err


def test_a_start_in_doubt_and_a_plan_that_was_not_found(run, tmp_path: Path) -> None:
    folder, way = tmp_path / "found", tmp_path / "way"
    folder.mkdir()
    (folder / "motion.csv").write_text(
        "time_s,x_m,y_m,yaw_deg,doubt\n0,0,0,0,wheels disagree\n9,0.2,0,0,wheels disagree\n"
    )
    plan = ("twin", "plan", "--start", folder, "--target", "2,0")
    started = run(*plan)
    said = [line for line in started.err if "the start is of a drive in doubt" in line]
    assert started.code == 0 and len(said) == 1 and said[0].endswith("wheels disagree"), started.err
    risky = ("--risk", "0.01", "--members", "500", "--candidates", "1", "--tolerance", "0.0001")
    assert run(*plan, *risky, "-o", way, "-q").code == 3
    missing = run("twin", "predict", way / "plan.toml")
    assert missing.code == 1 and "found no drive that keeps its risk, and wrote none" in missing.err[-1]
    assert "plan-01.toml" in missing.err[-1] and "--risk" in missing.err[-1]
    assert "no such file" in run("twin", "predict", way / "other.toml").err[-1]


def test_plan_refuses_a_belief_of_another_rover_as_predict_does(run, tmp_path: Path) -> None:
    first, belief = first_belief(), tmp_path / "b.json"
    entry = {"states": "a.csv", "rover": "small-four; wheels 75 x 60 mm", "synthetic": True, "refused": ""}
    belief.write_text(with_drive(first, first, entry).to_json())
    plan = (
        "twin",
        "plan",
        "--target",
        "1,0",
        "--risk",
        "0.3",
        "--members",
        "16",
        "--candidates",
        "1",
        "--soil",
        belief,
    )
    refused = run(*plan)
    assert refused.code == 2 and "was learned with 'small-four" in refused.err[-1]
    asked = run(*plan, "--rover", "yutu2")
    assert asked.code in (0, 3) and any("was learned with 'small-four" in line for line in asked.err)


def test_the_track_of_a_narrow_wheel_is_read_back(run, tmp_path: Path) -> None:
    """Wheels of 60 mm, recorded every 0.2 m: the track has points between, for every state."""
    plan, sent, found = tmp_path / "plan.toml", tmp_path / "sent", tmp_path / "found"
    plan.write_text("[drive]\nspeed_m_s = 0.03\n[[leg]]\nlength_m = 2.0\n")
    assert run("twin", "simulate", plan, "--rover", "small-four", "--sample", "0.2", "-o", sent, "-q").code == 0
    track = read_track(read_input(str(sent / "track.csv")))
    assert 0.7 * 0.06 <= track.apart_m <= 0.06
    read = ("twin", "states", sent / "telemetry.csv", plan, "--rover", "small-four", "--track", sent / "track.csv")
    done = run(*read, "-o", found)
    assert not any("the track meets" in line for line in done.err), done.err
    table = pd.read_csv(found / "states.csv")
    assert table["sinkage_m"][table["wheel"].isin(["RL", "RR"]) & table["valid"]].notna().all()


def test_a_first_drive_is_predicted_on_the_priors(run, short_plan: Path, tmp_path: Path) -> None:
    """By name, and from a file of them; a path alone is looked for on one soil."""
    prior = tmp_path / "prior.toml"
    assert run("template", "prior", "-o", prior).code == 0
    predict = ("twin", "predict", short_plan, "--rover", "small-four", "--members", "4", "--soil")
    named, of_file = (run(*predict, soil) for soil in ("priors", prior))
    assert named.code in (0, 3) and "soil: 4 drawn from the priors (before any drive)" in " ".join(named.out.split())
    shown = [done.out[: done.out.index("soil: 4 drawn")] for done in (named, of_file)]
    assert shown[0] == shown[1]
    where = ("--start", "0,0,0", "--target", "3,0", "-o", tmp_path / "way")
    alone = run("twin", "plan", "synthetic-longji", "--soil", "priors", *where)
    assert alone.code == 2 and "priors has many soils" in alone.err[0] and "give --risk" in alone.err[0]
