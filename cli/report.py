"""`lunarsci report`: one page of several results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.pages.requests import ReportRequest

from .shared.command import command
from .shared.emit import Report
from .shared.options import option
from .shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.pages.job import ReportedResults

OPTIONS = {
    "title": option(),
    "terrain": option(metavar="FILE"),
}
Results = Annotated[
    list[str],
    typer.Argument(
        metavar="RESULT…", help="Files of --json, folders of -o, beliefs, soil maps, pictures (.png, .svg) of --plot."
    ),
]
EXAMPLES = (
    "lunarsci report fit.json predicted -o report.html",
    "lunarsci report soil.json",
)


@command("report", EXAMPLES, OPTIONS)
def report(results: Results, request: ReportRequest) -> Report:
    """Results of other commands as one HTML page that needs no network: -o PAGE.html.

    Each result is a section: its answer in a sentence, pictures, what is not known, what was assumed, its error budget,
    its numbers and their sources. The top of the page has all answers, its end what to cite. The ground and the drives
    on it can be turned. Without -o the answers are printed.
    """
    from lunarsci.pages.job import report

    made = report(results, request=request)
    # The provenance has no time_utc where --no-time was given, and the page is to have none then.
    html = {".html": lambda record: made.html(time="time_utc" in record)}
    return Report(made, lambda: _tables(made), formats=html)


def _tables(made: ReportedResults) -> list[TextTable]:
    lines = [
        line
        for row in made.rows()
        for line in (f"{row['title']} ({row['file']})", f"  {row['answer']}", f"  Trust: {row['trust']}")
    ]
    return [TextTable([], [], title=made.page.title, notes=lines)]
