"""`lunarsci twin history`: what a belief rests on, and the way back."""

import csv
import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
from lunarsci.cli.twin.history import discrepancy_table

from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief, with_drive
from lunarsci.regolith.physics_discrepancy import FIRST, VarianceLaw


def update(before: SoilBelief, states: str, shift: float, refused: str = "") -> SoilBelief:
    """A made-up update that moves every parameter by `shift` standard deviations."""
    sd = np.sqrt(np.diag(before.covariance))
    after = before if refused else SoilBelief(before.laws, before.mean + shift * sd, 0.5 * before.covariance)
    drive = {"states": states, "sha256": "a" * 64, "plan": "out", "values": 100, "outliers": 2, "chi_square": 90.0}
    drive |= {"ground": "crater, east; heights 12345678"}
    return with_drive(after, before, {**drive, "surprise": abs(shift), "refused": refused}, parent_sha256="b" * 64)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A belief of three drives, the second of which taught nothing, and another that shares the first."""
    one = update(first_belief(), "1.csv", 0.5)
    two = update(update(one, "2.csv", 0.0, refused="no soil explains it"), "3.csv", -0.25)
    paths = tmp_path / "belief.json", tmp_path / "other.json"
    for path, belief in zip(paths, (two, update(one, "4.csv", 1.0)), strict=True):
        path.write_text(belief.to_json())
    return paths


def test_the_drives_and_what_each_moved(run, files: tuple[Path, Path], tmp_path: Path) -> None:
    picture = tmp_path / "history.png"
    done = run("twin", "history", files[0], "--json", "--plot", picture)
    assert done.code == 0, done.err
    assert picture.stat().st_size > 20_000
    document = json.loads(done.out)
    assert document["schema"] == "lunarsci/twin-history/1"
    drives = document["result"]["drives"]
    assert [d["states"] for d in drives] == ["1.csv", "2.csv", "3.csv"]
    assert [d["reduced_chi_square"] for d in drives] == [0.9] * 3 and drives[0]["parent_sha256"] == "b" * 64
    assert [d["moved_sd"]["cohesion_pa"] for d in drives] == pytest.approx([0.5, 0.0, -0.25])
    assert drives[1]["refused"] == "no soil explains it" and drives[0]["refused"] is None
    assert document["result"]["against"] is None and document["result"]["rolled_back"] is None
    text = run("twin", "history", files[0]).out
    assert "driven on crater east" in text and "12345678" not in text
    assert "rests on 2 drives" in text and "drive 2 taught nothing: no soil explains it" in text
    rows = list(csv.DictReader(io.StringIO(run("twin", "history", files[0], "--csv").out)))
    assert len(rows) == 4 * 8 and rows[8]["drive"] == "1" and rows[0]["states"] == ""


def test_a_warning_of_a_drive_stays_with_the_belief(run, short_plan: Path, tmp_path: Path) -> None:
    """In the history, in predictions and on the page, with exit code 0, until all is forgotten."""
    said = "one soil explains the positions only with 2.3 times their errors"
    entry = {"states": "1.csv", "sha256": "a" * 64, "plan": "out", "values": 9, "outliers": 0, "chi_square": 9.0}
    entry |= {"surprise": 0.1, "refused": "", "doubt": ""}
    warned = with_drive(first_belief(), first_belief(), entry | {"caution": said})
    later = with_drive(warned, warned, entry, forgotten=0.5)
    assert said in later.caution and with_drive(later, later, entry, forgotten=1.0).caution == ""
    belief, folder = tmp_path / "belief.json", tmp_path / "predicted"
    belief.write_text(later.to_json())
    done = run("twin", "history", belief)
    assert done.code == 0 and f"drive 1 was learned with a warning: {said}" in done.out
    used = ("twin", "predict", short_plan, "--soil", belief, "--members", "4", "--time-step", "0.2", "-o", folder)
    done = run(*used)
    assert done.code == 0 and said in " ".join(done.out.split()), done.err
    sections = json.loads(run("report", belief, folder, "--json").out)["result"]["sections"]
    assert [said in one["trust"] and "warns" in one["trust"] for one in sections] == [True, True]
    assert [one["tone"] for one in sections] == ["plain", "go"]


def test_what_the_physics_is_off_by_and_what_taught_it(run, files: tuple[Path, Path]) -> None:
    belief = read_belief(read_input(str(files[0])))
    law = FIRST.after_end(np.array([0.3, 0.0]), 1e-4 * np.eye(2), np.diag([1.0, 0.0]))
    law = law.with_source(states="back.csv", sha256="c" * 64, how="comparison")
    files[0].write_text(dataclasses.replace(belief, discrepancy=law).to_json())
    done = run("twin", "history", files[0], "--json")
    found = json.loads(done.out)["result"]
    assert found["discrepancy"]["along"]["scale"] == pytest.approx(law.along.scale)
    own = found["parameters"]["cohesion_pa"]
    assert own["ground_low_95"] < own["ground_low_68"] < own["low"] and own["ground_high_68"] > own["high"]
    text = run("twin", "history", files[0]).out
    assert "Error of the twin's physics" in text and "taught by back.csv (comparison)" in text
    assert "effective value" in text and "ground's own" in text


def test_another_belief_beside_it(run, files: tuple[Path, Path]) -> None:
    done = run("twin", "history", files[0], "--against", files[1], "--json")
    found = json.loads(done.out)["result"]["against"]
    assert found["shared_drives"] == 1 and found["bhattacharyya"] > 0
    # From the state after the first drive: up by one of its sd against down by a quarter, variances halved each.
    assert found["parameters"]["cohesion_pa"]["difference_sd"] == pytest.approx(1.25)
    text = run("twin", "history", files[0], "--against", files[1]).out
    assert "the same first drive, and are not independent" in text


def test_the_way_back(run, files: tuple[Path, Path], tmp_path: Path) -> None:
    back = tmp_path / "back.json"
    done = run("twin", "history", files[0], "--rollback", "1", "--save", back)
    assert done.code == 0 and "after 1 drive" in done.out, done.err
    found, first = read_belief(read_input(str(back))), first_belief()
    assert found.mean == pytest.approx(first.mean + 0.5 * np.sqrt(np.diag(first.covariance)))
    assert len(found.history) == 1 and found.population is None
    assert run("twin", "history", files[0], "--rollback", "0", "--save", tmp_path / "zero.json").code == 0
    assert np.array_equal(read_belief(read_input(str(tmp_path / "zero.json"))).mean, first.mean)
    for wrong, code in ((("--rollback", "1"), 2), (("--save", tmp_path / "x.json"), 2), (("--rollback", "-1"), 2)):
        assert run("twin", "history", files[0], *wrong).code == code
    beyond = run("twin", "history", files[0], "--rollback", "7", "--save", tmp_path / "x.json")
    assert beyond.code == 1 and "rests on 3" in beyond.err[0] and not (tmp_path / "x.json").exists()
    assert run("twin", "history", files[0], "--rollback", "1", "--save", back).code == 2  # it exists


def test_what_is_beyond_all_is_not_a_percentage() -> None:
    """A way of 150 % less is none: the table says that nothing is left of what the twin says."""
    wide = dataclasses.replace(FIRST, along=VarianceLaw(3.0, 0.9))
    rows = discrepancy_table(wide, FIRST).rows
    assert rows[0][1:3] == ["± 100 % or more"] * 2 and rows[0][4] == "± 2.1 %" and rows[1][1] == "± 1.3 %"


def test_older_and_broken_files(run, files: tuple[Path, Path], tmp_path: Path) -> None:
    document = json.loads(files[0].read_text())
    document["history"] = [{"states": "old.csv"}, {"states": "older.csv"}]
    files[0].write_text(json.dumps(document))
    done = run("twin", "history", files[0])
    assert done.code == 0 and "no way back" in done.out and "old.csv" in done.out
    files[0].write_text("{}")
    wrong = run("twin", "history", files[0])
    assert (wrong.code, wrong.out) == (1, "") and "schema" in wrong.err[0]
    files[0].write_text(first_belief().to_json())
    assert "rests on no drive" in run("twin", "history", files[0]).out
