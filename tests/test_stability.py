"""What version 1.0 promised to scripts (`docs/reference/stability.md`) is still there: names are added, none goes.

`python tests/test_stability.py --write` adds new names to `tests/frozen.json`; others go by hand, in a major version.
Columns of CSV and files in folders are compared where commands run: `tests/benchmarks/former.py`.
"""

import dataclasses
import importlib
import inspect
import json
import pickle
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast, get_args, get_type_hints

import pytest
import typer

sys.path.append(str(Path(__file__).with_name("benchmarks")))  # where pytest looks, too

from former import FROZEN, ROOT, files_of, former_answers, frozen, unfolded
from lunarsci.cli import command_line
from lunarsci.cli.shared.emit import _listed

import lunarsci
from lunarsci import errors
from lunarsci.errors import Failure
from lunarsci.options import choices_of
from lunarsci.result import Result
from lunarsci.spectra.abundance.kinds import KINDS, NOT_DETERMINED
from lunarsci.twin.comparison.verdict import DriveComparison
from lunarsci.twin.ground.driven_soil import Origin
from lunarsci.twin.judgement.safety import Verdict, headword
from lunarsci.twin.mission.mission import Fate
from lunarsci.twin.telemetry import reading

FILES = ("lunarsci.twin.rover.Rover", "lunarsci.twin.rover.Motors", "lunarsci.twin.rover.PowerSupply",
         "lunarsci.twin.rover.Body", "lunarsci.regolith.wheel.Wheel")  # fmt: skip
"""Classes whose fields are keys of rover files; those of other files stand on the page of files."""


def ends(names: Iterable[str]) -> dict[str, Any]:
    """Names with nothing below them."""
    return {name: {} for name in names}


def typed(command: Any, words: str = "") -> Iterator[tuple[str, Any]]:
    """Words and command of each command, groups left out."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
    for name, one in (inner or {}).items():
        yield from typed(one, f"{words} {name}".strip())


def choices(parameter: Any) -> tuple[str, ...]:
    """Values that an option is limited to, as any typer has them."""
    hint = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
    given = getattr(getattr(parameter, "type", None), "choices", None) or choices_of(hint)
    return tuple(one for one in given if isinstance(one, str))


def commands() -> dict[str, Any]:
    """Command, option, choice."""
    return {
        words: {
            option: ends(choices(one))
            for one in command.params
            for option in ([*one.opts, *one.secondary_opts] if one.param_type_name == "option" else ())
        }
        for words, command in typed(typer.main.get_command(command_line()))
    }


def fields(path: str) -> dict[str, Any]:
    """Fields of a dataclass."""
    module, _, name = path.rpartition(".")
    return ends(one.name for one in dataclasses.fields(getattr(importlib.import_module(module), name)))


def parameters(name: str) -> dict[str, Any]:
    """Inputs of a function with their places, and options, which are those of its request."""
    function = getattr(lunarsci, name)
    given = inspect.signature(function).parameters
    taken = [one for one in given if one not in ("request", "options")]
    names = [f"{k} {one}" if given[one].kind is inspect.Parameter.POSITIONAL_OR_KEYWORD else one
             for k, one in enumerate(taken)]  # fmt: skip
    request = re.search(r"\w+Request", str(given["request"].annotation)) if "request" in given else None
    options = fields(f"{function.__module__}.{request[0]}") if request else {}
    return ends(names) | options


def python() -> dict[str, Any]:
    """Function, parameter; names of results and errors."""
    functions = {name: parameters(name) for name in lunarsci.__all__ if name != "__version__"}
    public = ends(name for name in dir(Result) if re.match("to_|(rows|plot|doubt|untrusted|failures)$", name))
    kinds = (one for one in vars(errors).values() if inspect.isclass(one) and issubclass(one, Exception | Warning))
    return functions | {"Result": public, "errors": ends(one.__name__ for one in kinds)}


def files() -> dict[str, Any]:
    """Kind of file, key or column."""
    page = (ROOT / "docs/reference/files.md").read_text("utf-8")
    named = [*re.findall(r"\{fields\} ([\w.]+)", page), *FILES]
    columns = (*reading.POSITION_COLUMNS, *reading.POSE_COLUMNS, *reading.WHEEL_COLUMNS.values())
    return {path.rpartition(".")[2]: fields(path) for path in named} | {"telemetry": ends(columns)}


def keys_of(value: Any) -> dict[str, Any]:
    """Keys of JSON, those of all entries of a list together; long lists are recorded as their first entry.

    A document within, with a schema of its own, is a file that lunarsci reads.
    """
    if isinstance(value, list):
        merged: dict[str, Any] = {}
        for one in value:
            merged = together(merged, keys_of(one))
        return merged
    if not isinstance(value, dict) or "schema" in value:
        return {}
    if {"first", "last", "length"} <= value.keys():
        return keys_of(value["first"])
    return {key: keys_of(below) for key, below in value.items()}


def json_keys() -> dict[str, Any]:
    """Schema, key, key below it: of recorded answers, which other tests hold beside those of today."""
    found: dict[str, Any] = {}
    for answer in former_answers().values():
        if "schema" in answer:
            found = together(found, {answer["schema"]: keys_of(answer["result"])})
    return found


VALUES: dict[str, dict[str, Any]] = {
    "lunarsci/twin-predict/1": {"verdict": Verdict, "soil.of": Origin},
    "lunarsci/twin-compare/1": {"verdict": DriveComparison},
    "lunarsci/twin-mission/1": {"mission.targets.fate": Fate},
    "lunarsci/spectra-unmix/1": {"spectra.kind.name": (*KINDS, NOT_DETERMINED)},
    "lunarsci/spectra-bands/1": {"spectra.band1000_status": ("ok",), "spectra.band2000_status": ("ok",)},
}
"""Keys of results whose values scripts compare with, and what has them: a `Literal`, or a class with one so called."""


def values() -> dict[str, Any]:
    """Schema, key, value."""

    def of(key: str, has: Any) -> dict[str, Any]:
        hint = get_type_hints(has)[key] if inspect.isclass(has) else has
        return ends(has if isinstance(has, tuple) else get_args(hint))

    return {schema: {key: of(key, has) for key, has in keys.items()} for schema, keys in VALUES.items()}


PARTS = {"commands": commands, "python": python, "files": files, "json": json_keys, "values": values}


def together(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """All names of two trees."""
    return one | {name: together(one.get(name, {}), below) for name, below in other.items()}


def gone(former: dict[str, Any], now: dict[str, Any], above: str = "") -> list[str]:
    """Names of one tree that another does not have."""
    found = []
    for name, below in former.items():
        found += gone(below, now[name], f"{above}{name} > ") if name in now else [f"{above}{name}"]
    return found


def folded(tree: dict[str, Any]) -> dict[str, Any]:
    """Names with the same below them as one, with `|` between."""
    alike: dict[str, list[str]] = {}
    for name in sorted(tree):
        alike.setdefault(json.dumps(folded(tree[name]), sort_keys=True), []).append(name)
    return {"|".join(names): json.loads(below) for below, names in alike.items()}


@pytest.mark.parametrize("part", PARTS)
def test_what_scripts_rely_on_is_still_there(part: str) -> None:
    assert gone(frozen(part), PARTS[part]()) == []


def test_recorded_answers_have_values_that_are_promised() -> None:
    """So the table of values is of these keys, and of no others."""
    seen: set[tuple[str, str]] = set()
    for answer in former_answers().values():
        for key, has in values().get(answer.get("schema", ""), {}).items():
            found = at(answer["result"], key.split("."))
            assert key.endswith("_status") or {*found} <= has.keys(), (key, found)
            seen |= {(answer["schema"], key)} if {*found} & has.keys() else set()
    assert seen == {(schema, key) for schema, keys in VALUES.items() for key in keys}


def at(value: Any, steps: list[str]) -> list[Any]:
    """Values at a path, of all entries of lists."""
    if isinstance(value, list):
        return [one for entry in value for one in at(entry, steps)]
    if steps and isinstance(value, dict) and {"first", "last", "length"} <= value.keys():
        return at(value["first"], steps)
    return at(value[steps[0]], steps[1:]) if steps else [value]


def test_a_list_of_failures_is_laid_out_as_promised() -> None:
    """Name, reason, spectrum, with tabs between."""
    failures = [Failure.of("a.csv", "no\tspectrum"), Failure.of("b.csv", "too few channels", "s2")]
    assert _listed(failures) == b"a.csv\tno\\x09spectrum\t\nb.csv\ttoo few channels\ts2\n"


def test_the_text_of_a_drive_begins_with_its_verdict() -> None:
    verdicts = frozen("values")["lunarsci/twin-predict/1"]["verdict"]
    heads = {value: headword(cast(Verdict, SimpleNamespace(verdict=value))) for value in verdicts}
    assert heads == {"go": "GO", "no-go": "NO-GO", "not-determined": "NOT DETERMINED"}


def test_a_name_that_is_gone_is_seen() -> None:
    """Of each depth, and what comes is no fault."""
    former = {"fit": {"--errors": {"laplace": {}, "profile": {}}, "--json": {}}, "bands": {}}
    assert unfolded(folded(former)) == former
    now = {"fit": {"--errors": {"laplace": {}, "sample": {}}, "--new": {}}}
    assert gone(former, now) == ["fit > --errors > profile", "fit > --json", "bands"]
    assert gone(former, together(former, now)) == []


if __name__ == "__main__" and "--write" in sys.argv:
    record = json.loads(FROZEN.read_text("utf-8")) if FROZEN.exists() else {}
    now = {part: make() for part, make in PARTS.items()}
    for run in sys.argv[2:]:  # folders of `former.run_once`, for columns
        columns = pickle.loads(Path(run, "now.pickle").read_bytes())[2]
        now = together(now, {"columns": {name: ends(names) for name, names in columns.items()}})
        folders = {name: ends(inside) for name in columns if (inside := files_of(Path(run), name))}
        now = together(now, {"folders": folders})
    kept = {
        part: together(unfolded(record.get(part, {})), now.get(part, {})) for part in (*PARTS, "columns", "folders")
    }
    record = {part: folded(tree) for part, tree in kept.items()}
    FROZEN.write_text(json.dumps(record, indent=0, sort_keys=True, ensure_ascii=False) + "\n", "utf-8")
