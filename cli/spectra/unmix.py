"""`lunarsci spectra unmix`: shares of minerals."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import typer

from lunarsci.spectra.jobs.unmix import UnmixedSpectra, UnmixRequest, unmix
from lunarsci.spectra.jobs.verdicts import fits_counted, shares_verdict

from ..shared.command import command
from ..shared.options import Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import UNKNOWN, TextTable, counted, plus_minus, verdict_table
from .fit import MODEL_OPTIONS, fit_tables, not_weighed
from .options import ONLY, UNITS, Files

if TYPE_CHECKING:
    from lunarsci.spectra.abundance.result import Abundance, DarkPart, MineralFraction

MIXTURE = "Mixture"
SHORT = {
    "powder-mixture": "powders",
    "dark-rock-powder": "dark rock",
    "weathered-soil": "soil",
    "solid-rock": "rock",
}
"""Kinds of target as headers of columns."""
NORMATIVE = {"plagioclase_wt": "normative plagioclase", "feo_wt": "FeO", "tio2_wt": "TiO2"}
OPTIONS = {
    "kind": option(
        "What is looked at. auto finds it for each spectrum: powder-mixture, minerals ground and mixed; "
        "dark-rock-powder, a rock with opaques, ground; weathered-soil, which is not unmixed; solid-rock, which must "
        "be stated, since a rock looks like the soil beside it. Kinds that look alike are left open.",
        panel=MIXTURE,
        metavar="KIND",
    ),
    "method": option(
        "Mixing law: hapke, of the albedo of single scattering; absorbance, of -ln R; both, by evidence; auto: hapke "
        "for single spectra, both with --together.",
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
        "Table of id and one column per mineral, in shares of 1, of mixtures whose shares are known; an empty cell is "
        "solved for, 0 means that the mineral is absent. Implies --together.",
        panel=MIXTURE,
        metavar="FILE",
    ),
    "opaque": option(
        "There surely is an opaque phase, such as ilmenite. Without this opaque phases, metal and troilite, glass and "
        "none are weighed by their evidence; with --together there is none.",
        panel=MIXTURE,
    ),
    "iron": option(
        "There surely is nanophase iron on all grains: space weathering. Without this nanophase iron, larger iron and "
        "none are weighed; with --together there is none.",
        panel=MIXTURE,
    ),
    **MODEL_OPTIONS,
    **UNITS,
    **ONLY,
}


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "unmix", batch=True, request=UnmixRequest, options=OPTIONS)(unmix_spectra)


def unmix_spectra(files: Files, request: UnmixRequest, output: Output) -> Report:
    """Shares of the minerals of an assemblage by volume, from mixtures of end members, with intervals.

    The assemblage is fitted first (`spectra fit`); its bands and NBSR are in the result as well. What is dark is
    weighed and reported beside the shares. Shares of which a spectrum says too little are not determined: they have an
    interval and no value. Intervals and `in_domain` come from the errors of sample series of the same kind of target.

    A surface that space has weathered is not unmixed (exit code 3): normative plagioclase, FeO and TiO2 are given
    instead, by regression.
    """
    with progress("unmixing", quiet=output.quiet) as update:
        found = unmix(files, request, progress=update)
    return Report.of(found, result_tables(found))


def result_tables(found: UnmixedSpectra) -> list[TextTable]:
    """The fits, the shares, the kinds of target and what depends on them."""
    told = verdict_table(found.records, shares_verdict, fits_counted)
    return [*fit_tables(found), *mixture_tables(found), kind_table(found), *normative_table(found), *told]


def mixture_tables(found: UnmixedSpectra) -> list[TextTable]:
    """Shares of several spectra, what is dark beside them, and ratios of solid rocks."""
    from lunarsci.spectra.abundance.result import BOULDERS, ROCKS_UNCALIBRATED

    alone = len(found.records) == 1
    shown = [found.abundances[index][0] for index in found.abundances if found.abundances[index]]
    unmixed = [item for item in shown if item.method != "nbsr"]
    tables = [] if alone or not unmixed else [_shares_table(unmixed)]
    dark = [[item.id, *_dark_row(item.dark)] for item in unmixed if item.dark]
    headers = ["spectrum", "share of cross-section [%]", "phases [%]", "submicroscopic iron [%]"]
    title = "what is dark beside the minerals, with probabilities"
    tables += [TextTable(headers, dark, title=title)] if dark else []
    ratios = [[item.id, ratio.mineral.replace("_", " "), *_percent(ratio)] for item in unmixed for ratio in item.ratios]
    headers = ["spectrum", "ratio", "[%]", "68 %", "95 %"]
    return tables + (
        [TextTable(headers, ratios, title="ratios of mafic minerals", notes=[ROCKS_UNCALIBRATED, BOULDERS])]
        if ratios
        else []
    )


def _shares_table(found: "Sequence[Abundance]") -> TextTable:
    minerals = list(dict.fromkeys(share.mineral for item in found for share in item.fractions))
    rows = []
    for item in found:
        shares = {share.mineral: _percent(share) for share in item.fractions}
        cells = [f"{shares[name][0]} ({shares[name][1]})" if name in shares else "-" for name in minerals]
        rows.append([item.id, *cells, item.status])
    headers = ["spectrum", *(f"{name} [%]" for name in minerals), "status"]
    return TextTable(headers, rows, title="mineral shares, with 68 % intervals", notes=not_weighed(found))


def _percent(share: "MineralFraction") -> list[str]:
    ends = ((share.low, share.high), (share.low95, share.high95))
    return [
        UNKNOWN if share.fraction != share.fraction else plus_minus(100 * share.fraction, digits=0),
        *(f"{100 * low:.0f} to {100 * high:.0f}" for low, high in ends),
    ]


def _dark_row(dark: "DarkPart") -> list[str]:
    share = f"{100 * dark.share:.0f} ({100 * dark.low:.0f} to {100 * dark.high:.0f})"
    weighed = (
        ", ".join(f"{name} {100 * value:.0f}" for name, value in part.items()) for part in (dark.phases, dark.iron)
    )
    return [share, *weighed]


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
    names = [record["id"] for record in records]
    notes = counted([record["normative"]["status"] for record in records], len(records), "spectra", names)
    title = "composition by regression; no shares of minerals"
    headers = ["spectrum", *(f"{text} [wt %]" for text in NORMATIVE.values())]
    return [TextTable(headers, rows, title=title, notes=notes)] if rows else []


def _ranged(item: Mapping[str, float] | None) -> str:
    if item is None:
        return "-"
    ends = f"68 %: {item['low']:.0f} to {item['high']:.0f}; 95 %: {item['low95']:.0f} to {item['high95']:.0f}"
    return f"{item['value']:.0f} ({ends})"
