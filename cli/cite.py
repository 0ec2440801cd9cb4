"""`lunarsci cite`: what to cite for results."""

from typing import Annotated

import typer

from .shared.command import command
from .shared.emit import Report
from .shared.table import TextTable

Results = Annotated[list[str], typer.Argument(metavar="RESULT…", help="Files of --json, or folders of -o.")]
EXAMPLES = (
    "lunarsci cite fit.json",
    "lunarsci cite fit.json predicted > references.bib",
)


@command("cite", EXAMPLES)
def cite(results: Results) -> Report:
    """What to cite for results, as BibTeX: lunarsci, the sources that they name, and the data behind their tables.

    Data are laboratory spectra, catalogues of craters, and sources of priors. An entry whose authors or title lunarsci
    does not know has its DOI. --csv and --json give the sources as a table, -o FILE.bib writes the entries.
    """
    from lunarsci.guide.cite import cite

    cited = cite(results)
    rows = [[key, one.text] for key, one in cited.keyed.items()]
    return Report(cited, [TextTable(["key", "source"], rows)], raw=cited.bibtex)
