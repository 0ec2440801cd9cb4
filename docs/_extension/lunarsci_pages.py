"""Sphinx directives that make reference pages of the code itself: options, keys, fields of files, sources.

Each directive writes Markdown and has MyST read it; `*_text` functions below make that text and know nothing of Sphinx.
"""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from docutils import nodes
from pages_of_code import (
    fields_text,
    functions_text,
    plan_text,
    requests_text,
    rover_text,
    soils_text,
    telemetry_text,
    wheels_text,
)
from pages_of_commands import command_text, commands_text, keys_text, options_text, units_text
from pages_of_sources import constants_text, sources_text
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

SECTIONS = ("Parameters", "Other Parameters", "Attributes", "Returns", "Raises", "References", "Notes", "Examples")


def directive(make: Callable[..., str], most: int = 0) -> type[SphinxDirective]:
    """A directive that shows what `make` writes of its argument."""

    class Page(SphinxDirective):
        optional_arguments = most
        final_argument_whitespace = True

        def run(self) -> list[nodes.Node]:
            for module in list(sys.modules):
                if module.startswith("lunarsci") and (path := getattr(sys.modules[module], "__file__", None)):
                    self.env.note_dependency(path)
            return self.parse_text_to_nodes(make(*self.arguments), allow_section_headings=True)

    return Page


def root_text(name: str) -> str:
    """A file of the project's root without its title, its links as from a page in `project`."""
    text = (Path(__file__).parents[2] / name).read_text("utf-8").partition("\n")[2]
    return re.sub(r"\]\((?:docs/([^)]+)|(SECURITY|CHANGELOG)\.md)\)",
                  lambda m: f"](../{m[1]})" if m[1] else f"]({m[2].lower()}.md)", text)  # fmt: skip


def docstring(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Sections of our docstrings (`name : meaning. [unit]`) as lists, in place."""
    made: list[str] = []
    section = False
    for number, line in enumerate(lines):
        underline = lines[number + 1] if number + 1 < len(lines) else ""
        if line.strip() in SECTIONS and set(underline.strip()) == {"-"}:
            made += ["", f".. rubric:: {line.strip()}", ""]
            section = line.strip() in ("Parameters", "Other Parameters", "Attributes")
        elif line.strip() and set(line.strip()) == {"-"} and number and lines[number - 1].strip() in SECTIONS:
            continue
        elif section and line and not line[0].isspace() and " : " in line:
            names, _, meaning = line.partition(" : ")
            made += ["- " + ", ".join(f"``{one.strip()}``" for one in names.split(",")) + ": " + meaning]
        elif section and line and line[0].isspace():
            made.append("  " + line.strip())
        else:
            section = section and not line
            made.append(line)
    lines[:] = [re.sub(r"(?<![`:])`([^`]+)`(?!`)", r"``\1``\\ ", line) for line in made]


def add_options(app: Sphinx, name: str, source: list[str]) -> None:
    """The options of commands, at the end of their page."""
    folder, _, page = name.rpartition("/")
    if folder == "reference/commands":
        source[0] += options_text(page)


def setup(app: Sphinx) -> dict[str, bool]:
    for name, make, arguments in (
        ("command", command_text, 1),
        ("root-file", root_text, 1),
        ("commands", commands_text, 0),
        ("json-keys", keys_text, 0),
        ("units", units_text, 0),
        ("fields", fields_text, 1),
        ("functions", functions_text, 1),
        ("requests", requests_text, 0),
        ("rover-file", rover_text, 1),
        ("wheels", wheels_text, 0),
        ("soils", soils_text, 0),
        ("plan-file", plan_text, 0),
        ("telemetry-columns", telemetry_text, 0),
        ("sources", sources_text, 0),
        ("constants", constants_text, 0),
    ):
        app.add_directive(name, directive(make, arguments))
    app.connect("autodoc-process-docstring", docstring)
    app.connect("source-read", add_options)
    return {"parallel_read_safe": True}
