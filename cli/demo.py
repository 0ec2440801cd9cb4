"""`lunarsci demo`: the whole chain on embedded synthetic data."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from .shared.command import command
from .shared.emit import Report
from .shared.options import Output
from .shared.table import TextTable, plus_minus
from .shared.talk import say

FOLDER = "lunarsci-demo"
NO_PAGE = "left out: a page of all of it needs jinja2; pip install 'lunarsci[report]'"
EXAMPLES = (
    "lunarsci demo",
    "lunarsci demo --seed 1 -o other-demo",
)


@command("demo", EXAMPLES, folder=True, default_path=FOLDER)
def demo(
    output: Output,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise and the draws.")] = 0,
) -> Report:
    """Run the whole chain on embedded synthetic data: pictures, rock, drive, ground. Under a minute on two cores.

    Inputs, tables and pictures go to the folder lunarsci-demo, or to -o DIR; try the other commands on them.
    """
    from lunarsci.reproduce.demo import demo

    result = demo(seed, say=partial(say, quiet=output.quiet))
    page = "report.html" in result.files
    say(f"all of it on one page: open {output.path}/report.html in a browser" if page else NO_PAGE, quiet=output.quiet)
    return Report(result, [_table(result.rows(), output.path)], files=result.files)


def _table(findings: Sequence[Mapping[str, Any]], folder: Path | None) -> TextTable:
    rows = [
        [
            f["quantity"],
            plus_minus(f["value"], f["sigma"], digits=_digits(f["value"])),
            plus_minus(f["truth"], digits=_digits(f["value"])),
            f["unit"],
            f["picture"],
        ]
        for f in findings
    ]
    notes = [
        "Everything here is synthetic: a rock that exists nowhere on ground that was made up.",
        f"Pictures and tables are in {folder}. Try the commands on them, for example:",
        f"  lunarsci spectra fit {folder}/rock.ecsv",
        f"  lunarsci regolith identify {folder}/wheel_states.csv --lateral-modulus 20",
    ]
    return TextTable(["what was found", "value", "truth", "unit", "picture"], rows, notes=notes)


def _digits(value: float) -> int:
    return 1 if abs(value) >= 10 else 3
