"""`lunarsci doctor`: whether lunarsci works here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .shared.command import command
from .shared.emit import Report
from .shared.options import Output
from .shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.guide.doctor import HealthReport
EXAMPLES = (
    "lunarsci doctor",
    "lunarsci doctor --field trouble",
)


@command("doctor", EXAMPLES)
def doctor(output: Output) -> Report:
    """Whether lunarsci works here: versions, extras, compiled code, threads, and a small test of each part.

    The tests use known answers: made-up bands, a published wheel load, the end of a short drive. They take a few
    seconds. The first run takes a minute, since it compiles what bands, fit, forces, identify and predict need. Exit
    code 3: a test failed.
    """
    from lunarsci.guide.doctor import doctor

    report = doctor(progress=output.progress("testing"))
    return Report(report, [_table(report)])


def _table(report: HealthReport) -> TextTable:
    lines = [f"{'ok ' if not one.trouble else 'OFF'}  {one.name}: {one.observed}" for one in report.checks]
    lines += [f"     {line}" for line in report.trouble]
    title = f"{len(report.trouble)} of {len(report.checks)} things are off" if report.trouble else "all is well"
    return TextTable([], [], title=title, notes=lines)
