"""`lunarsci template`: files to begin with."""

from pathlib import Path
from typing import Annotated

import typer

from .shared.command import command
from .shared.emit import Report
from .shared.table import TextTable

Kind = Annotated[
    str,
    typer.Argument(
        metavar="KIND",
        help="What to begin: rover (Yutu-2's numbers), small-four (a rover of four wheels), soil, prior, plan, "
        "mission, craters, telemetry, states of wheels, rig (stereo cameras), or pose of its left camera.",
    ),
]
Wheels = Annotated[
    str | None,
    typer.Option("--rover", metavar="ROVER", help="Whose wheels telemetry and states are of: yutu2, small-four, FILE."),
]
EXAMPLES = (
    "lunarsci template plan > plan.toml",
    "lunarsci template rover > rover.toml",
    "lunarsci template telemetry --rover small-four",
)


@command("template", EXAMPLES)
def template(kind: Kind, rover: Wheels = None) -> Report:
    """A file to begin with: every key has its meaning, its unit and a value. Commands take it as it is.

    Keys after a # may be left out. Change the numbers to yours; `lunarsci info FILE` says whether the file is still
    right.
    """
    from lunarsci.guide.template import template

    made = template(kind, rover)
    by_suffix = {Path(made.name).suffix: lambda _: made.text.encode()}
    return Report(made, [TextTable([], [], title=made.name)], raw=lambda: made.text, formats=by_suffix)
