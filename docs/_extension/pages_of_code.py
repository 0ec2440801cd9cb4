"""Reference of files and their keys, as Markdown, from the classes that read them and our own files."""

import ast
import dataclasses
import importlib
import inspect
import re
import tomllib
from collections.abc import Iterator, Set
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from lunarsci.registry import functions_of
from lunarsci.rovers import read_rover, rover_names, wheel_names
from lunarsci.twin.telemetry import reading

PARTS = {
    "wheel": "lunarsci.regolith.wheel.Wheel",
    "mass": "lunarsci.twin.rover.Rover",
    "suspension": "lunarsci.twin.rover.Rover",
    "steering": "lunarsci.twin.rover.Rover",
    "drive": "lunarsci.twin.rover.Rover",
    "motors": "lunarsci.twin.rover.Motors",
    "power": "lunarsci.twin.rover.PowerSupply",
    "body": "lunarsci.twin.rover.Body",
}
"""Table of a rover file to the class that takes its keys."""
ALIKE = {"steered_wheels": "steered", "offset_m": "steering_offset_m"}
"""Keys of a rover file whose attribute has another name."""


def _class(path: str) -> Any:
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def attributes(kind: Any) -> dict[str, str]:
    """Attribute to what its class says of it."""
    return attributes_in(kind.__doc__ or "")


def attributes_in(docstring: str) -> dict[str, str]:
    """Attribute to what a docstring says of it."""
    text = docstring.partition("Attributes")[2]
    found: dict[str, str] = {}
    names: list[str] = []
    for line in text.splitlines()[2:]:
        entry = re.match(r"    ([\w, ]+?) : (.+)", line)
        if entry:
            names = [name.strip() for name in entry[1].split(",")]
            found.update(dict.fromkeys(names, entry[2]))
        elif line.startswith("        ") and names:
            found.update({name: f"{found[name]} {line.strip()}" for name in names})
        elif names:
            break
    return found


@cache
def described(area: str) -> list[dict[str, tuple[str, str]]]:
    """Of each public class of `lunarsci/AREA`, those of jobs first: attribute to unit and meaning, as JSON has it."""
    folder = Path(__file__).parents[2] / "lunarsci" / area
    classes = []
    for path in sorted(folder.rglob("*.py"), key=lambda path: (path.parent.name != "jobs", path)):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                said = attributes_in(ast.get_docstring(node, clean=False) or "")
                classes.append({name: unit_and_meaning(re.sub(r"\b(None|NaN)\b", "null", text))
                                for name, text in said.items()})  # fmt: skip
    return classes


def attribute_beside(name: str, beside: Set[str], area: str) -> tuple[str, str]:
    """Unit and meaning of a key of a result: of the class that describes most of the keys beside it.

    Nothing where no class describes it and another of these keys, for the name alone does not say whose it is.
    """
    classes = [said for said in described(area) if name in said]
    best = max(classes, key=lambda said: len(said.keys() & beside), default={})
    return best[name] if len(best.keys() & beside) >= min(2, len(beside)) and best else ("", "")


def unit_and_meaning(text: str) -> tuple[str, str]:
    found = re.search(r"\s*\[([^\]]+)\]\s*(?:\([^)]*\))?\s*$", text)
    return (found[1], text[: found.start()]) if found else ("", text)


def _cell(text: object) -> str:
    return str(text).replace("|", "/").replace("\n", " ")


def fields_text(path: str) -> str:
    """Fields of a dataclass: unit, default, meaning."""
    kind = _class(path)
    said = attributes(kind)
    rows = []
    for field in dataclasses.fields(kind):
        unit, meaning = unit_and_meaning(said.get(field.name, ""))
        needed = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        default = "needed" if needed else "" if field.default in (None, dataclasses.MISSING) else f"`{field.default}`"
        rows.append(f"| `{field.name}` | {_cell(unit)} | {default} | {_cell(meaning)} |")
    return "\n".join(["| key | unit | default | meaning |", "| --- | --- | --- | --- |", *rows])


def _entries(document: dict[str, Any]) -> Iterator[tuple[str, str, Any, str]]:
    """Table, key, value, and source of each number of a rover file."""
    for table, keys in document.items():
        for key, entry in keys.items() if isinstance(keys, dict) else ():
            source = entry.get("source", "") if isinstance(entry, dict) else ""
            assumed = isinstance(entry, dict) and entry.get("assumed")
            yield (
                table,
                key,
                entry["value"] if isinstance(entry, dict) else entry,
                ("assumed: " if assumed else "") + source,
            )


def rover_text(name: str) -> str:
    """Keys of a rover file with their meanings, and what one of ours says."""
    rows = []
    for table, key, value, source in _entries(tomllib.loads(read_rover(name).text)):
        said = attributes(_class(PARTS[table])) if table in PARTS else {}
        meaning = unit_and_meaning(said.get(ALIKE.get(key, key), ""))
        rows.append(
            f"| `[{table}]` `{key}` | {_cell(meaning[0])} | {_cell(value)} | {_cell(meaning[1])} | {_cell(source)} |"
        )
    head = f"| key | unit | `{name}` | meaning | source of the number |\n| --- | --- | --- | --- | --- |\n"
    return head + "\n".join(rows)


def wheels_text() -> str:
    """Wheels that come with lunarsci."""
    rows = []
    for name in wheel_names():
        wheel = tomllib.loads((files("lunarsci.rovers") / "wheels.toml").read_text("utf-8"))[name]
        numbers = ", ".join(f"`{key}` {entry['value']}" for key, entry in wheel.items())
        rows.append(f"| `{name}` | {numbers} | {_cell(next(iter(wheel.values()))['source'])} |")
    rovers = ", ".join(f"`{name}`" for name in rover_names())
    return f"Rovers: {rovers}.\n\n| wheel | numbers | source |\n| --- | --- | --- |\n" + "\n".join(rows)


def soils_text() -> str:
    """Soils that `--soil` knows by name."""
    soils = tomllib.loads((files("lunarsci.regolith") / "soils.toml").read_text("utf-8"))
    names = list(dict.fromkeys(key for soil in soils.values() for key in soil if key not in ("assumed", "source")))
    rows = [f"| `{key}` | " + " | ".join(
        f"{soil.get(key, '')}{' (assumed)' if key in soil['assumed'] else ''}" for soil in soils.values()) + " |"
        for key in names]  # fmt: skip
    head = "| key | " + " | ".join(f"`{name}`" for name in soils) + " |\n|" + " --- |" * (1 + len(soils)) + "\n"
    sources = "\n".join(f"- `{name}`: {soil['source']}" for name, soil in soils.items())
    return head + "\n".join(rows) + "\n\n" + sources


def plan_text() -> str:
    """The embedded plan, as a file to start from."""
    return "```toml\n" + (files("lunarsci.twin.plans") / "plan.toml").read_text("utf-8") + "```"


MEANT = {
    "time_s": "time since the start of the plan",
    "x_m": "where localisation put the rover's origin, blank between; x of the terrain",
    "y_m": "the same along y",
    "yaw_deg": "heading, from x towards y",
    "yaw_deg_sigma": f"its error; without it {reading.YAW_SIGMA_DEG} deg are assumed",
    "roll_deg": "attitude of the body",
    "pitch_deg": "attitude of the body, positive nose down",
    "sigma_m": "error of a position in x and in y",
    "xx_m2": "covariance of a position, instead of `sigma_m`",
    "xy_m2": "covariance of a position",
    "yy_m2": "covariance of a position",
    "z_m": "height, not used",
    "synthetic": "whether the rows are made up",
    "speed_{}_m_s": "commanded speed of the rim of wheel `{}`, such as `FL`",
    "steering_{}_deg": "commanded steering angle of wheel `{}`, positive to the left",
    "angle_{}_deg": "measured angle of the wheel since some start",
    "rate_{}_deg_s": "measured rate of the wheel",
    "steered_{}_deg": "measured steering angle",
    "xx_before_m2": "covariance of x with x of the position before, of `images locate`",
    "xy_before_m2": "the same of x with y before",
    "yx_before_m2": "the same of y with x before",
    "yy_before_m2": "the same of y with y before",
}


def telemetry_text() -> str:
    """Columns of telemetry, from the names that the reader knows."""
    from lunarsci.units import unit_of

    names = dict.fromkeys((*reading.POSITION_COLUMNS, *reading.POSE_COLUMNS, *reading.WHEEL_COLUMNS.values()))
    rows = [f"| `{name.replace('{}', 'WHEEL')}` | {unit_of(name.replace('_{}', ''))} | "
            f"{'needed' if name in reading.NEEDED else ''} | {MEANT[name].replace('`{}`', '`WHEEL`')} |"
            for name in names]  # fmt: skip
    return "\n".join(["| column | unit | | meaning |", "| --- | --- | --- | --- |", *rows])


def functions_text(part: str) -> str:
    """The functions of `import lunarsci` for a part, from their docstrings."""
    lines = [f".. autofunction:: lunarsci.{part}.jobs.{name}.{name}" for name in functions_of(part)]
    return "\n".join(["```{eval-rst}", *lines, "```"])


def requests_text() -> str:
    """The request of every function of `import lunarsci`, with its options."""
    import lunarsci

    parts = []
    for area, names in lunarsci.JOBS.items():
        for name in names:
            module = importlib.import_module(f"lunarsci.{area}.jobs.{name}")
            annotation = str(inspect.signature(getattr(module, name)).parameters["request"].annotation)
            kind = next(kind for kind in vars(module).values() if isinstance(kind, type)
                        and re.search(rf"\b{kind.__name__}\b", annotation))  # fmt: skip
            path = f"{kind.__module__}.{kind.__name__}"
            parts.append(f"### `{kind.__name__}`\n\nof `lunarsci.{name}`\n\n{fields_text(path)}")
    return "\n\n".join(parts)
