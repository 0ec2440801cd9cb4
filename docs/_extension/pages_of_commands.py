"""Reference of the command line, as Markdown, from the commands themselves and from what they answered."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import typer
from lunarsci.cli import command_line

from lunarsci.result import UNITS, unit_of

ROOT = Path(__file__).parents[2]
SHARED = "Output"
"""Panel of the options that all commands share."""


def command_of(path: str) -> Any:
    found: Any = typer.main.get_command(command_line())
    for name in path.split():
        found = found.commands[name]
    return found


def every_command(group: Any = None, above: str = "") -> Iterator[tuple[str, Any]]:
    group = group or typer.main.get_command(command_line())
    for name, command in group.commands.items():
        path = f"{above} {name}".strip()
        if hasattr(command, "commands"):
            yield from every_command(command, path)
        else:
            yield path, command


def _choices(parameter: Any) -> str:
    kind = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
    given = getattr(getattr(parameter, "type", None), "choices", None) or get_args(kind)
    return ", ".join(f"`{choice}`" for choice in given if isinstance(choice, str))


def _limits(parameter: Any) -> str:
    low, high = (getattr(parameter, name, None) for name in ("min", "max"))
    if low is None and high is None:
        return ""
    return f"{low} to {high}" if None not in (low, high) else f"{low} or more" if high is None else f"at most {high}"


def _about(parameter: Any) -> str:
    """Choices, range and default of an option."""
    default = parameter.default
    known = default not in (None, False, (), []) and not callable(default)
    said = [
        _choices(parameter),
        _limits(parameter),
        f"default `{default}`" if known else "",
        "repeatable" if parameter.multiple else "",
        "needed" if parameter.required else "",
    ]
    return "; ".join(text for text in said if text)


def _entry(parameter: Any) -> str:
    metavar = "" if getattr(parameter, "is_flag", False) else f" {parameter.metavar}" if parameter.metavar else ""
    names = [name if name.startswith("-") else name.upper() for name in (*parameter.opts, *parameter.secondary_opts)]
    shown = ", ".join(f"`{name}{metavar if name == names[-1] else ''}`" for name in names)
    about = _about(parameter)
    return f"{shown}{' · ' + about if about else ''}\n: {(parameter.help or '').replace('|', '/')}\n"


def command_text(path: str) -> str:
    """Help of a command: what it does, its arguments, its options by panel."""
    command = command_of(path)
    panels: dict[str, list[str]] = {}
    for parameter in command.params:
        if getattr(parameter, "hidden", False) or parameter.name == "help":
            continue
        argument = not parameter.opts[0].startswith("-")
        panel = "Arguments" if argument else parameter.rich_help_panel or "Options"
        panels.setdefault(panel, []).append(_entry(parameter))
    shared = panels.pop(SHARED, [])
    said = "\n\n".join(" ".join(part.split()) for part in command.help.split("\n\n"))
    parts = [said, *(f"**{name}**\n\n" + "\n".join(entries) for name, entries in panels.items())]
    if shared:
        parts.append(f"**{SHARED}** (the same in all commands)\n\n" + "\n".join(shared))
    return "\n\n".join(parts)


def commands_text() -> str:
    """Every command with the first sentence of its help."""
    rows = [f"| `lunarsci {path}` | {command.help.splitlines()[0]} |" for path, command in every_command()]
    return "\n".join(["| command | what it does |", "| --- | --- |", *rows])


def meanings() -> dict[str, tuple[str, str]]:
    """Name to unit and meaning, of the glossary."""
    found = {}
    for line in (ROOT / "docs/glossary.md").read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if len(cells) == 5:
            for name in re.findall(r"`(\w+)`", cells[2]):
                found[name] = (cells[1], cells[3])
    return found


def _keys(value: Any, path: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        long_list = {"first", "last", "length"} <= set(value)  # how the record keeps long lists
        for key, inner in value.items():
            if not long_list:
                yield from _keys(inner, f"{path}.{key}" if path else key)
            elif key == "first":
                yield from _keys(inner, f"{path}[]")
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for entry in value:
            yield from _keys(entry, f"{path}[]")
    else:
        yield path


ENDINGS = {
    "_sigma": "standard deviation of it",
    "_low": "lower end of 68 %",
    "_high": "upper end of 68 %",
    "_low95": "lower end of 95 %",
    "_high95": "upper end of 95 %",
    "_calibration": "what errors that all channels share add",
}


def _meaning(key: str, known: dict[str, tuple[str, str]]) -> tuple[str, str]:
    name = key.rsplit(".", 1)[-1].removesuffix("[]")
    if name in known:
        unit, meaning = known[name]
        return unit, meaning
    for ending, text in ENDINGS.items():
        for bare in (name.removesuffix(ending), name.replace(ending + "_", "_", 1)):
            if bare != name and bare in known:
                return known[bare][0], f"{text}: {known[bare][1]}"
    return unit_of(name) or "", ""


def keys_text() -> str:
    """Keys of `--json` by command, as its recorded answers have them, with units and meanings."""
    known = meanings()
    answers = json.loads((ROOT / "tests/former_results.json").read_text("utf-8"))["answers"]
    lines = dict(
        re.findall(r'^    "([^"]+)": f?"(.+)', (ROOT / "tests/test_former_results.py").read_text("utf-8"), re.M)
    )
    paths = sorted((path for path, _ in every_command()), key=len, reverse=True)
    found: dict[str, dict[str, None]] = {}
    for name, answer in answers.items():
        line = lines.get(name, "")
        if path := next((path for path in paths if line.startswith(path)), None):
            found.setdefault(path, {}).update(dict.fromkeys(_keys(answer["result"])))
    parts = []
    for path in sorted(found):
        rows = []
        for key in sorted(found[path]):
            unit, meaning = _meaning(key, known)
            rows.append(f"| `{key}` | {unit} | {meaning} |")
        parts.append(
            f"## `lunarsci {path}`\n\n| key of `result` | unit | meaning |\n| --- | --- | --- |\n" + "\n".join(rows)
        )
    return "\n\n".join(parts)


def units_text() -> str:
    """The endings of keys and columns that say the unit."""
    rows = [f"| `_{ending}` | {unit or 'kPa m⁻ᴺ'} |" for ending, unit in UNITS.items()]
    return "\n".join(["| ending | unit |", "| --- | --- |", *rows])
