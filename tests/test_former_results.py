"""The table of former answers has every command and every job, and a difference from it is seen."""

import json
from pathlib import Path

import former
import pytest
import typer
from lunarsci.cli import command_line

import lunarsci


def commands_of(group: typer.Typer, above: str = "") -> set[str]:
    own = {f"{above} {command.name}".strip() for command in group.registered_commands}
    return own.union(*(commands_of(inner.typer_instance, f"{above} {inner.name}") for inner in group.registered_groups))


def test_every_command_has_an_answer_in_the_table() -> None:
    """But for those that answer with a picture, a file, a list of names, maps, or what they find on a machine."""
    others = {
        "demo",
        "report",
        "info",
        "template",
        "cite",
        "doctor",
        "spectra library plot",
        "spectra library list",
        "spectra map",
        "images merge",
        "images dem",
        "images locate",
        "images rocks",
        "images render",
        "images calibrate",
    }
    tried = {
        name
        for name in commands_of(command_line())
        for line in former.COMMANDS.values()
        if f"{line} ".startswith(f"{name} ".strip() + " ")
    }
    assert commands_of(command_line()) - tried == others


def test_every_job_of_the_package_is_tried() -> None:
    used = {former.job_of(former.COMMANDS[name]) for name in former.notebook_names()}
    used |= {"calibrate_cameras", "dem", "locate", "merge", "render", "rocks"}  # of pictures: `tests/images` tries them
    used |= {"map_cube"}  # `tests/spectra/cubes` tries it
    assert all(callable(getattr(lunarsci, job)) for job in lunarsci.JOBS["images"])
    assert {job for jobs in lunarsci.JOBS.values() for job in jobs} <= used


def test_a_difference_is_seen() -> None:
    """Six digits of each number, up to ten places after the point, and every key."""
    before = {"a": [1.0, {"b": "x"}], "c": None, "d": 2, "e": 2e-7}
    assert former.differences(before, before | {"new": 1}, "") == [".new: new"]
    assert former.differences(before, before | {"d": 3}, "") == [".d: 2 was, 3 is"]
    assert former.differences(before, before | {"e": 2.01e-7}, "") == [".e: 2e-07 was, 2.01e-07 is"]
    assert former.differences(before, before | {"a": [1.0 + 1e-8, {"b": "x"}]}, "") == []
    assert sorted(former.differences(before, {"a": [1.0, {}], "c": 0, "d": 2, "e": 2e-7}, "")) == [
        ".a.1.b: gone",
        ".c: None was, 0 is",
    ]


def test_what_is_recorded_is_kept_with_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Answers that are not named stay."""
    table = tmp_path / "table.json"
    table.write_text(json.dumps({"answers": {"one": {"x": 1.0}, "other": {"x": 1.0}}, "why": {"other": "new"}}))
    monkeypatch.setattr(former, "TABLE", table)
    former.record(["one"], "a better soil", {"one": {"x": 2.0}, "other": {"x": 2.0}})
    assert former.former_answers() == {"one": {"x": 2.0}, "other": {"x": 1.0}}
    assert json.loads(table.read_text())["why"] == {"one": "a better soil", "other": "new"}
