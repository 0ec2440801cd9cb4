"""`lunarsci reproduce`."""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs/validation/paper.md"
KEYS = {
    "id", "part", "quantity", "unit", "passage", "published", "within", "ours", "low", "high", "reading", "reason",
    "verdict",
}  # fmt: skip
ROVERS = ("yutu2", "small-four")
VERDICTS = (
    "reproduced",
    "reproduced under a named reading",
    "consistent with one free force",
    "differs",
    "not determined by what is published",
)


def test_the_table_and_its_json_say_the_same(run: Callable[..., Any]) -> None:
    table = run("reproduce")
    assert table.code == 0
    found = json.loads(run("reproduce", "--json", "--no-time").out)
    assert found["schema"] == "lunarsci/reproduce/1"
    numbers = found["result"]["numbers"]
    assert sum(found["result"]["verdicts"].values()) == len(numbers)
    assert [n["part"] for n in numbers] == sorted((n["part"] for n in numbers), key=["spectra", "soil", "drive"].index)
    lines = [line.split() for line in table.out.splitlines()]
    for number in numbers:
        assert set(number) == KEYS
        assert number["verdict"] in VERDICTS
        [line] = [line for line in lines if line and line[0] == number["id"]]
        assert " ".join(line).endswith(f"{number['unit']} {number['verdict']}")
        shown = "-" if number["ours"] is None else f"{number['ours']:.4g}"
        assert (shown in line) or (f"({shown})" in line)
    assert "published.csv" in json.dumps(found["provenance"])
    counts = Counter(number["verdict"] for number in numbers)
    assert found["result"]["verdicts"] == counts
    same, named, free, differ, unknown = (counts[verdict] for verdict in VERDICTS)
    told = (
        f"Of all {len(numbers)}, {same} are reproduced, {named} under a named reading, {free} are consistent with one "
        f"free force, {differ} differ, and {unknown}"
    )
    assert told in " ".join(PAGE.read_text("utf-8").split())


def test_examples_that_are_not_judged_stand_in_brackets(run: Callable[..., Any]) -> None:
    table = run("reproduce", "--part", "drive")
    open_ = [line for line in table.out.splitlines() if line.endswith("not determined by what is published")]
    judged = [line for line in table.out.splitlines() if line.endswith(("reproduced", "reading", "differs"))]
    assert any("(" in line for line in open_)
    assert len(judged) == 3
    assert not any("(" in line for line in judged)
    assert "in brackets" in table.out


def test_evidence_is_one_flag_away(run: Callable[..., Any]) -> None:
    evidence = "b and F_N cannot be told apart"
    assert evidence not in run("reproduce", "--part", "soil").out
    assert evidence in run("reproduce", "--part", "soil", "-v").out


def test_spectra_of_a_boulder_are_looked_at(run: Callable[..., Any], rock: Path) -> None:
    found = json.loads(run("reproduce", "--part", "spectra", "--boulders", rock, "--json", "--no-time").out)
    numbers = {number["id"]: number for number in found["result"]["numbers"]}
    assert numbers["mgm-rms"]["ours"] > 0
    assert numbers["opx-share"]["verdict"] in VERDICTS
    assert str(rock) in json.dumps(found["provenance"])


def test_what_is_no_spectrum_is_refused_in_one_line(run: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "notes.csv"
    path.write_text("nothing to see\n")
    failed = run("reproduce", "--part", "spectra", "--boulders", path)
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1)
    assert "notes.csv" in failed.err[0]


def test_another_rover_drives_otherwise(run: Callable[..., Any]) -> None:
    field = "numbers.9.ours"
    ours, other = (run("reproduce", "--part", "drive", "--rover", name, "--field", field).out for name in ROVERS)
    assert float(other) > float(ours) > 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--part", "rock", "--rover", "yutu2"), "nothing drives"),
        (("--part", "soil", "--boulders", "rock.csv"), "give --part spectra"),
        (("--part", "stones"), "'spectra', 'rock', 'soil', 'drive'"),
    ],
)
def test_options_that_would_do_nothing_are_refused(
    run: Callable[..., Any], arguments: tuple[str, ...], says: str
) -> None:
    done = run("reproduce", *arguments)
    assert (done.code, done.out, len(done.err)) == (2, "", 1) and says in done.err[0]
