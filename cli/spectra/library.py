"""`lunarsci spectra library`: end-member spectra with what is known of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.errors import ParameterError
from lunarsci.spectra.jobs.requests import ImportRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus
from .options import UNITS, Files

if TYPE_CHECKING:
    from lunarsci.spectra.jobs.library import CheckedLibrary, Library

GROUP = "Libraries of end-member spectra: make one from laboratory files, list, draw and check it."
"""Help of the group that these commands are."""

PICTURES = (".png", ".svg", ".pdf")
Libraries = Annotated[
    list[str], typer.Argument(help="Libraries (.ecsv of `library import`), or other files of spectra; - is stdin.")
]
OPTIONS = {
    "mineral": option(),
    "metadata": option(kind=str | None, metavar="FILE.csv"),
    "source": option(metavar="TEXT"),
    **UNITS,
}


@command(
    "import",
    examples=(
        "lunarsci spectra library import lunarsci-demo/rock.ecsv --mineral other \\\n  -o library.ecsv",
        "lunarsci spectra library import lunarsci-demo/rock.ecsv --source here --csv",
    ),
    batch=True,
    options=OPTIONS,
)
def import_(files: Files, request: ImportRequest, output: Output) -> Report:
    """Make a library from RELAB, USGS splib07, ENVI .sli, CSV, ECSV or FITS files: -o LIBRARY.ecsv writes it.

    Libraries among the files are merged.
    """
    from lunarsci.spectra.jobs.library import import_library

    library = import_library(files, request)
    if output.path is not None and output.path.suffix.lower() not in (".ecsv", ".json"):
        raise ParameterError(f"{output.path}: a library is written as .ecsv, its list as .json; give such a name")
    return Report(library, [_listing(library)], formats={".ecsv": library.to_ecsv})


@command(
    "list",
    examples=(
        "lunarsci spectra library list library.ecsv",
        "lunarsci spectra library list library.ecsv --columns id,mineral",
    ),
    batch=True,
)
def list_(files: Libraries) -> Report:
    """The end members of a library."""
    return _list(files)


@command(
    "check",
    examples=(
        "lunarsci spectra library check library.ecsv",
        "lunarsci spectra library check library.ecsv --json",
    ),
    batch=True,
)
def check(files: Libraries) -> Report:
    """What must be mended before a library is used; exit code 3 where something must."""
    from lunarsci.spectra.jobs.library import check_library

    checked = check_library(files)
    return Report(checked, [_findings(checked)])


@command(
    "plot",
    examples=(
        "lunarsci spectra library plot library.ecsv -o library.png",
        "lunarsci spectra library plot library.ecsv -o library.pdf",
    ),
    batch=True,
)
def plot(files: Libraries, output: Output) -> Report:
    """Draw a library, one panel for each mineral: -o FILE.png, .svg or .pdf."""
    if output.plot is None and (output.path is None or output.path.suffix.lower() not in PICTURES):
        raise typer.BadParameter("name the picture: -o FILE.png, .svg or .pdf")
    return _list(files)


def _list(files: list[str]) -> Report:
    from lunarsci.spectra.jobs.library import open_library

    library = open_library(files)
    return Report(library, [_listing(library)], formats={name: partial(_picture, library, name) for name in PICTURES})


def _picture(library: Library, suffix: str, _: Mapping[str, Any]) -> bytes:
    from lunarsci.figure import picture_bytes

    return picture_bytes(library.figures(), Path(f"library{suffix}"))


HEADERS = ("spectrum", "mineral", "Fo", "Fs", "En", "Wo", "An", "grains [µm]", "channels", "range [nm]", "source")


def _listing(library: Library) -> TextTable:
    return TextTable(HEADERS, [_row(record) for record in library.rows()])


def _row(record: Mapping[str, Any]) -> list[str]:
    low, high = record["min_um"], record["max_um"]
    grains = "-" if high is None else f"< {high:g}" if not low else f"{low:g}-{high:g}"
    return [
        record["id"],
        record["mineral"] or "?",
        *(plus_minus(record[key], digits=2) for key in ("fo", "fs", "en", "wo", "an")),
        grains,
        str(record["channels"]),
        f"{record['from_nm']:g}-{record['to_nm']:g}",
        record["source"] or "-",
    ]


def _findings(checked: CheckedLibrary) -> TextTable:
    rows = [[row["id"], "mend" if row["must_mend"] else "know", row["finding"]] for row in checked.rows()]
    total, rest = len(checked.findings), sum(not finding for finding in checked.findings)
    minerals = ", ".join(f"{count} of {name or '?'}" for name, count in checked.library.minerals.items())
    if not rows:
        return TextTable(["library"], [[f"all {total} end members are fit for use: {minerals}"]])
    notes = [f"end members: {minerals}", *([f"{rest} of {total} without a finding"] if rest else [])]
    return TextTable(["spectrum", "", "finding"], rows, notes=notes)
