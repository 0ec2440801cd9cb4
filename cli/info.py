"""`lunarsci info`: what a file is, and what can be done with it."""

import dataclasses
import re
from typing import TYPE_CHECKING, Annotated

import typer

from .shared.command import command
from .shared.emit import Report
from .shared.options import Output, flag_of
from .shared.table import TextTable, significant
from .spectra.options import UNITS

if TYPE_CHECKING:
    from lunarsci.guide.info import FileInfo

File = Annotated[
    str, typer.Argument(metavar="FILE", help="Any file, the folder of a result, or a name of lunarsci; - is stdin.")
]
EXAMPLES = (
    "lunarsci info belief.json",
    "lunarsci info lunarsci-demo/rock.ecsv",
    "lunarsci info longji",
)


@command("info", EXAMPLES)
def info(file: File, output: Output) -> Report:
    """What a file is, what is in it, and which commands take it.

    Known are spectra, image cubes, pictures, terrains, plans, missions, rovers, soils, beliefs, telemetry, wheel
    states, catalogues and results. Exit code 3: the commands would refuse this file; the reason is printed.

    Names of lunarsci are those of rovers (husky, rosey, small-four, yutu2), wheels (cmu-smooth, cmu-grouser,
    hit-smooth, hit-grouser, kls1-smooth, kls1-grouser, rashid-1, ishigami, lrv) and soils (longji, lunar-typical,
    and priors, what is believed before any drive).

    --field result.KEY… or provenance.KEY… prints a value of a stored result. Exit code 3: there is no value, or it is
    not to be used. In a batch of fits only the spectrum of that value counts.
    """
    from lunarsci.guide.info import info

    described = info(file)
    remarks = [_typed(text) for text in described.remarks]
    described = dataclasses.replace(described, remarks=remarks, trouble=_typed(described.trouble))
    return Report(described, [_contents(described, output.verbose), _commands(described)], stored=described.stored)


def _typed(text: str) -> str:
    """A text with what the commands of spectra must be given as it is typed there."""
    return re.sub(r"`(\w+)`", lambda name: flag_of(name[1]) if name[1] in UNITS else name[0], text)


def _contents(described: "FileInfo", verbose: bool) -> TextTable:
    rows = [[name, _text(value, verbose)] for name, value in described.contents.items() if value is not None]
    notes = [*described.remarks, *([described.trouble] if described.trouble else [])]
    return TextTable(["what", "value"] if rows else [], rows, title=f"{described.file}: {described.title}", notes=notes)


def _text(value: object, verbose: bool) -> str:
    """As a table has it; of many names all where that is asked for."""
    whole = getattr(value, "whole", value)
    if whole != value:
        return str(whole) if verbose else f"{value}: --verbose"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return significant(value, 4) if isinstance(value, float) else str(value)


def _commands(file: "FileInfo") -> TextTable:
    lines = [f"  {line}" for line in file.commands] or ["  none as it is" if file.trouble else "  none that is known"]
    return TextTable([], [], title="Commands that take it", notes=lines)
