"""`lunarsci reproduce`: the published numbers beside ours."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunarsci.reproduce.requests import ReproduceRequest

from .shared.command import command
from .shared.emit import Report
from .shared.options import SPREAD, Output, option
from .shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.reproduce.job import Reproduction
    from lunarsci.reproduce.numbers import Number

OPTIONS = {
    "part": option(),
    "rocks": option("--boulders", metavar="FILE"),
    "rover": option(show_default="yutu2"),
}
TITLES = {"spectra": "The rock", "soil": "The soil", "drive": "The drive"}
EXAMPLES = (
    "lunarsci reproduce --part soil",
    "lunarsci reproduce --part soil -v",
)


@command("reproduce", EXAMPLES, OPTIONS, blocks=SPREAD)
def reproduce(request: ReproduceRequest, output: Output) -> Report:
    """Numbers of Ding et al. (2024) beside what follows from what they publish, with a verdict on each.

    -v prints the reading and the evidence of each number, --plot FILE.pdf draws the paper's figures. The measured
    spectra and the terrain of the paper are not public; --boulders takes spectra of boulders for more numbers of the
    rock.
    """
    from lunarsci.reproduce.job import reproduce

    reproduction = reproduce(request, progress=output.progress("reproducing"))
    return Report(reproduction, [_table(reproduction, output.verbose)])


def _table(reproduction: Reproduction, verbose: bool) -> TextTable:
    """One line a number, by part."""
    rows, numbers = [], reproduction.numbers
    for part in reproduction.parts:
        rows.append([TITLES[part], *[""] * 6])
        rows += [_row(number) for number in numbers if number.part == part]
    headers = ["number", "quantity", "published", "ours", "range", "unit", "verdict"]
    for column in (2, 3, 4):
        width = max(len(headers[column]), *(len(row[column]) for row in rows))
        headers[column] = headers[column].rjust(width)
        rows = [[*row[:column], row[column].rjust(width), *row[column + 1 :]] for row in rows]
    return TextTable(headers, rows, notes=_notes(reproduction, verbose))


def _row(number: Number) -> list[str]:
    cells = [f"{number.published:g}", _ours(number), _range(number), number.unit, number.verdict]
    return [f"  {number.id}", number.quantity, *cells]


def _ours(number: Number) -> str:
    if number.ours is None:
        return "-"
    return f"({number.ours:.4g})" if number.is_open else f"{number.ours:.4g}"


def _range(number: Number) -> str:
    return "-" if number.low is None or number.high is None else f"{number.low:.4g} to {number.high:.4g}"


def _evidence(number: Number) -> list[str]:
    reading = [f"    reading: {number.reading}"] if number.reading else []
    return [f"  {number.id}", *reading, f"    {number.reason}"]


def _notes(made: Reproduction, verbose: bool) -> list[str]:
    numbers, counts = (
        made.numbers,
        "; ".join(f"{count} {verdict}" for verdict, count in made.verdicts.items()),
    )
    notes = [f"{len(numbers)} numbers: {counts}"]
    if any(number.is_open and number.ours is not None for number in numbers):
        notes.append("in brackets: an example under an assumption that nothing published supports or rules out")
    if verbose:
        return [*notes, "readings and evidence", *(line for number in numbers for line in _evidence(number))]
    return [*notes, "readings and evidence: -v, or --json"]
