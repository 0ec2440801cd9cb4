"""Reference of the command line, as Markdown, from the commands themselves and from what they answered."""

import json
import re
import signal
import sys
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, get_args

import typer
from lunarsci.cli import command_line
from pages_of_code import attribute_beside, unit_and_meaning

from lunarsci.minerals import WITH_BANDS
from lunarsci.units import UNITS, unit_of

ROOT = Path(__file__).parents[2]
COMMAND_PAGES = ROOT / "docs/reference/commands"
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


def page_of(path: str) -> str:
    """The page of the reference that is named after a command or its group; the index has all others."""
    words = path.split()
    names = ["-".join(words[:number]) for number in range(len(words), 0, -1)]
    return next((name for name in names if (COMMAND_PAGES / f"{name}.md").exists()), "index")


def commands_of_page(page: str) -> list[str]:
    return [path for path, _ in every_command() if page_of(path) == page]


def options_text(page: str) -> str:
    """The sections that end a page of the reference: each of its commands with its options."""
    paths = commands_of_page(page)
    heads = [f"`lunarsci {path}`" if page == "index" else f"Options of `{path.rpartition(' ')[2]}`" for path in paths]
    heads = heads if len(paths) > 1 else ["Options"]
    return "".join(f"\n## {head}\n\n```{{command}} {path}\n```\n" for head, path in zip(heads, paths, strict=True))


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


def keys_and_values(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and "schema" not in value:  # a document of its own is a file
        long_list = {"first", "last", "length"} <= set(value)  # how the record keeps long lists
        for key, inner in value.items():
            if not long_list:
                yield from keys_and_values(inner, f"{path}.{key}" if path else key)
            elif key == "first":
                yield from keys_and_values(inner, f"{path}[]")
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for entry in value:
            yield from keys_and_values(entry, f"{path}[]")
    else:
        yield path, value


ENDINGS = {
    "_sigma": "standard deviation of it",
    "_low": "lower end of 68 %",
    "_high": "upper end of 68 %",
    "_low95": "lower end of 95 %",
    "_high95": "upper end of 95 %",
    "_calibration": "what errors that all channels share add",
}
PARTS = {
    "value": "the value",
    "sigma": "its standard deviation",
    "sd": "its standard deviation",
    "low": "lower end of its 68 % interval",
    "high": "upper end of its 68 % interval",
    "low68": "lower end of its 68 % interval",
    "high68": "upper end of its 68 % interval",
    "low90": "lower end of its 90 % interval",
    "high90": "upper end of its 90 % interval",
    "low95": "lower end of its 95 % interval",
    "high95": "upper end of its 95 % interval",
    "ground_median": "median of the ground's own value, wider known than the effective one",
    "ground_low_68": "lower end of 68 % of the ground's own value",
    "ground_high_68": "upper end of 68 % of the ground's own value",
    "ground_low_95": "lower end of 95 % of the ground's own value",
    "ground_high_95": "upper end of 95 % of the ground's own value",
    "low_68": "lower end of its 68 % interval",
    "high_68": "upper end of its 68 % interval",
    "low_95": "lower end of its 95 % interval",
    "high_95": "upper end of its 95 % interval",
    "range_low": "lower end of the range in which it was made",
    "range_high": "upper end of the range in which it was made",
    "mean": "mean",
    "median": "median",
    "min": "smallest",
    "max": "largest",
    "p5": "value that 5 % do not exceed",
    "p05": "value that 5 % do not exceed",
    "p50": "median: value that 50 % do not exceed",
    "p95": "value that 95 % do not exceed",
    "count": "how many",
    "degrees": "degrees of freedom",
    "correlation": "correlation matrix, in the order of the keys beside it",
    "unit": "its unit",
    "name": "its name",
    "title": "its name in words",
    "id": "name of the spectrum, state or row",
    "status": "`ok`, or what is wrong or not determined, in a sentence",
    "reason": "why a value is missing, or empty",
    "reasons": "why, each in a sentence",
    "notes": "remarks, each in a sentence",
    "caution": "what was warned of and is no doubt, in a sentence",
    "caveat": "what the error does not include",
    "assumed": "whether no source gives it; or what was assumed, by name",
    "assumed_of_rover": "numbers of the rover that no source gives",
    "source": "publication, or input file",
    "solved": "whether it was found from the data, not given",
    "synthetic": "whether it is made up",
    "published": "value in the literature",
    "remarks": "remarks, each in a sentence",
    "why": "why, in a sentence",
    "sha256": "SHA-256 of the file",
    "probability": "its probability",
    "opx": "share of orthopyroxene in both pyroxenes",
    "cpx": "share of clinopyroxene in both pyroxenes",
    **{mineral: f"of {mineral}" for mineral in WITH_BANDS},
    "none": "probability that there is none",
    "opaque": "probability of an opaque phase",
    "metal-troilite": "probability of metal and troilite",
    "glass": "probability of glass",
    "nanophase": "probability of iron below 50 nm",
    "larger": "probability of larger iron",
    "drawn": "how many were drawn",
    "replaces_of_terrain": "soil parameters of the terrain that it takes the place of",
    "quantity": "which quantity the row is about",
    "mineral": "mineral that it belongs to",
    "method": "how it was found",
    "domain": "kind of target that it holds for",
    "wavelengths_nm": "wavelengths that it is made of",
    "interpolation": "what another interpolation would change",
    "calibration": "what errors that all channels share add",
    "rover": "rover, by name or file",
    "terrain": "terrain, by name or file",
    "plan": "plan, by name or file",
    "soil": "soil, by name or file",
    "drives": "how many drives it rests on",
    "determined": "whether the data determine it",
    "soils_missed_by_median": "median error on soils of known composition",
    "soils_missed_by_most": "largest error on soils of known composition",
    "of_soils": "how many soils of known composition were tried",
}
"""Keys that mean the same wherever they stand, of what their parent key names."""
SINGLE_STATES = ("bearing", "shear", "lateral", "observations")
"""Parts of `regolith identify` and `infer` whose `low` and `high` end intervals of 95 %, of what one state may give."""
NUMBER = re.compile(r"value|published|sigma|sd|mean|median|min|max|p\d+|(ground|range|soils)_.*|(low|high)_?\d*")
"""Those of them that have the unit of their parent."""


@cache
def written(table: str) -> dict[str, tuple[str, str]]:
    """End of a key's path to unit and meaning, of those that `key_meanings.toml` has for a command or an area."""
    tables = tomllib.loads((ROOT / "docs/_extension/key_meanings.toml").read_text("utf-8"))
    return {end: unit_and_meaning(text) for end, text in tables.get(table, {}).items()}


def written_end(key: str, command: str) -> tuple[str, str]:
    """The longest end of a key's path that is written of, with its table, the command's before its area's."""
    parts = key.replace("[]", "").split(".")
    for first in range(len(parts)):
        for table in (command, command.split()[0]):
            for end in written(table):
                names = end.split(".")
                if len(names) == len(parts) - first and all(
                    name in ("*", part) for name, part in zip(names, parts[first:], strict=True)
                ):
                    return table, end
    return "", ""


def meaning_of(key: str, known: dict[str, tuple[str, str]], command: str, beside: set[str]) -> tuple[str, str]:
    """Unit and meaning of a key: written of it, of the glossary, of its ending, of the code, or of its part."""
    parts = [part.removesuffix("[]") for part in key.split(".")]
    name, area = parts[-1], command.split()[0]
    table, end = written_end(key, command)
    if end:
        unit, meaning = written(table)[end]
        return unit or unit_of(name), meaning
    if name in known:
        return known[name]
    for ending, text in ENDINGS.items():
        for bare in (name.removesuffix(ending), name.replace(ending + "_", "_", 1)):
            said = attribute_beside(bare, {bare, *beside}, area)
            if bare != name and (result := known.get(bare) or (said if said[1] else written(area).get(bare))):
                return result[0], f"{text}: {result[1]}"
    above = next((one for one in reversed(parts[:-1]) if one in known or unit_of(one)), "")
    name = name if name in PARTS else re.sub(r"^(p5|p05|p50|p95)_\w+$", r"\1", name)
    if name in PARTS:
        unit = unit_of(parts[-1]) or (unit_of(above) if NUMBER.fullmatch(name) else "")
        single = area == "regolith" and parts[0] in SINGLE_STATES
        meaning = PARTS[name].replace("68 %", "95 %") if single else PARTS[name]
        return unit, f"{meaning} (of `{above}`)" if above else meaning
    unit, meaning = attribute_beside(name, beside, area)
    return unit_of(name) or unit, meaning


def _beside(keys: Iterable[str]) -> dict[str, set[str]]:
    """Path of a part of a result to the names of the keys in it, those that have parts of their own too."""
    names: dict[str, set[str]] = {}
    for key in keys:
        parts = key.replace("[]", "").split(".")
        for count, name in enumerate(parts):
            names.setdefault(".".join(parts[:count]), set()).add(name)
    return names


def recorded() -> Iterator[tuple[str, Any]]:
    """Command and result of every recorded answer."""
    answers = json.loads((ROOT / "tests/former_results.json").read_text("utf-8"))["answers"]
    texts = [file.read_text("utf-8") for file in (ROOT / "tests/cli").glob("test_*.py")]
    texts = [text for text in texts if "\nRECORDED = {" in text]
    texts.append((ROOT / "tests/benchmarks/former.py").read_text("utf-8"))
    lines = {name: line for text in texts for name, line in re.findall(r'^    "([^"]+)": f?"(.+)', text, re.M)}
    paths = sorted((path for path, _ in every_command()), key=len, reverse=True)
    for name, answer in answers.items():
        line = lines.get(name, "")
        if path := next((path for path in paths if line.startswith(path)), ""):
            yield path, answer["result"]


def keys_text(command: str = "") -> str:
    """Keys of `--json` of a command, or of all, as recorded answers have them, with units and meanings."""
    known, found = meanings(), dict[str, dict[str, None]]()
    for path, result in recorded():
        if path.startswith(command):
            found.setdefault(path, {}).update(dict.fromkeys(key for key, _ in keys_and_values(result)))
    parts = []
    for path in sorted(found):
        rows, beside = [], _beside(found[path])
        for key in sorted(found[path]):
            above = key.replace("[]", "").rpartition(".")[0]
            unit, meaning = meaning_of(key, known, path, beside[above])
            rows.append(f"| `{key}` | {unit} | {meaning} |".replace("|s|", r"\|s\|"))
        parts.append(
            f"## `lunarsci {path}`\n\n| key of `result` | unit | meaning |\n| --- | --- | --- |\n" + "\n".join(rows)
        )
    return "\n\n".join(parts)


def units_text() -> str:
    """The endings of keys and columns that say the unit."""
    rows = [f"| `_{ending}` | {unit or 'kPa m⁻ᴺ'} |" for ending, unit in UNITS.items()]
    return "\n".join(["| ending | unit |", "| --- | --- |", *rows])


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    sys.stdout.write(f"{keys_text(' '.join(sys.argv[1:]))}\n")
