"""`lunarsci spectra unmix`: shares of minerals."""

import typer

from lunarsci.spectra.jobs.unmix import UnmixedSpectra, UnmixRequest, unmix

from ..shared.command import command
from ..shared.options import Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable
from .fit import MODEL_OPTIONS, fit_tables
from .options import UNITS, Files

MIXTURE = "Mixture"
SHORT = {
    "powder-mixture": "powders",
    "dark-rock-powder": "dark rock",
    "weathered-soil": "soil",
    "solid-rock": "rock",
}
"""Kinds of target as headers of columns."""
OPTIONS = {
    "kind": option(
        "What is looked at. auto finds it for each spectrum: powder-mixture, minerals ground and mixed; "
        "dark-rock-powder, a rock with opaques, ground; weathered-soil, which is not unmixed; solid-rock, which must "
        "be stated, since a rock looks like the soil beside it. Kinds that look alike are left open.",
        panel=MIXTURE,
    ),
    "method": option(
        "Mixing law: hapke, of the albedo of single scattering; absorbance, of -ln R; both, weighted by evidence.",
        panel=MIXTURE,
    ),
    "library": option(
        "End members instead of the embedded ones; see `spectra library`.", panel=MIXTURE, metavar="FILE"
    ),
    "together": option(
        "Take all spectra as mixtures of the same powders, which are then found far better than one by one.",
        panel=MIXTURE,
    ),
    "known": option(
        "Table of id and one column per mineral, in shares of 1, of mixtures whose modes are known; empty cells are "
        "sought, a 0 beside them is absent. Implies --together.",
        panel=MIXTURE,
        metavar="FILE",
    ),
    "opaque": option("Allow a dark, flat powder beside the minerals.", panel=MIXTURE),
    "iron": option("Allow submicroscopic iron on all grains: space weathering.", panel=MIXTURE),
    **MODEL_OPTIONS,
    **UNITS,
}


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "unmix", request=UnmixRequest, options=OPTIONS)(unmix_spectra)


def unmix_spectra(files: Files, request: UnmixRequest, output: Output) -> Report:
    """Shares of the minerals of an assemblage by volume, from mixtures of end members, with intervals.

    The assemblage is fitted first (`spectra fit`); its bands and NBSR are in the result as well.
    """
    with progress("unmixing", quiet=output.quiet) as update:
        found = unmix(files, request, progress=update)
    return Report.of(found, [*fit_tables(found), kind_table(found)])


def kind_table(found: UnmixedSpectra) -> TextTable:
    """The kind of each target, how likely each kind is, and why."""
    rows = [
        [
            record["id"],
            kind["name"] + (" (stated)" if kind["stated"] else ""),
            *(f"{100 * kind['probabilities'][name]:.0f}" for name in SHORT),
            "; ".join(kind["reasons"]) or "-",
        ]
        for record in found.records
        if (kind := record["kind"])
    ]
    return TextTable(
        ["spectrum", "kind", *(f"{text} [%]" for text in SHORT.values()), "remark"], rows, title="kinds of target"
    )
