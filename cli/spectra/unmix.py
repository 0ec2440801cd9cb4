"""`lunarsci spectra unmix`: shares of minerals."""

from collections.abc import Mapping

import typer

from lunarsci.spectra.jobs.unmix import UnmixedSpectra, UnmixRequest, unmix

from ..shared.command import command
from ..shared.options import Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable, counted
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
NORMATIVE = {"plagioclase_wt": "plagioclase of the norm", "feo_wt": "FeO", "tio2_wt": "TiO2"}
OPTIONS = {
    "kind": option(
        "What is looked at. auto finds it for each spectrum: powder-mixture, minerals ground and mixed; "
        "dark-rock-powder, a rock with opaques, ground; weathered-soil, which is not unmixed; solid-rock, which must "
        "be stated, since a rock looks like the soil beside it. Kinds that look alike are left open.",
        panel=MIXTURE,
        metavar="KIND",
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

    A surface that space has weathered is not unmixed (exit code 3): plagioclase of its norm, FeO and TiO2 are given instead, by regression.
    """
    with progress("unmixing", quiet=output.quiet) as update:
        found = unmix(files, request, progress=update)
    return Report.of(found, [*fit_tables(found), kind_table(found), *normative_table(found)])


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


def normative_table(found: UnmixedSpectra) -> list[TextTable]:
    """Composition of weathered soils, where there are any."""
    records = [record for record in found.records if record["normative"]]
    rows = [[record["id"], *(_ranged(record["normative"][name]) for name in NORMATIVE)] for record in records]
    notes = counted([record["normative"]["status"] for record in records], len(records), "spectra")
    title = "composition by regression, with 68 and 95 % intervals; no modes of minerals"
    headers = ["spectrum", *(f"{text} [wt %]" for text in NORMATIVE.values())]
    return [TextTable(headers, rows, title=title, notes=notes)] if rows else []


def _ranged(item: Mapping[str, float] | None) -> str:
    if item is None:
        return "-"
    wide = f"{item['low95']:.0f} to {item['high95']:.0f}"
    return f"{item['value']:.0f}, {item['low']:.0f} to {item['high']:.0f}, {wide}"
