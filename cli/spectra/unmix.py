"""`lunarsci spectra unmix`: shares of minerals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from lunarsci.minerals import ABBREVIATIONS
from lunarsci.spectra.jobs.requests import UnmixRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import UNKNOWN, TextTable, counted, plus_minus, verdict_table
from .options import ONLY, UNITS, Files

if TYPE_CHECKING:
    from lunarsci.spectra.abundance.result import MineralFraction
    from lunarsci.spectra.jobs.unmix import UnmixedSpectra

GIVEN, MIXTURE = "What is known", "End members"
NORMATIVE = {"plagioclase_wt": "normative plagioclase", "feo_wt": "FeO", "tio2_wt": "TiO2"}
OPTIONS = {
    "assemblage": option(panel=GIVEN, metavar="NAMES"),
    "kind": option(panel=GIVEN, metavar="KIND"),
    "prior": option(panel=GIVEN),
    "together": option(panel=GIVEN),
    "known": option(panel=GIVEN, metavar="FILE"),
    "library": option(panel=MIXTURE, metavar="FILE"),
    "method": option(panel=MIXTURE),
    "opaque": option(panel=MIXTURE),
    "iron": option(panel=MIXTURE),
    **UNITS,
    **ONLY,
}
EXAMPLES = (
    "lunarsci spectra unmix lunarsci-demo/rock.ecsv --kind solid-rock",
    "lunarsci spectra unmix lunarsci-demo/rock.ecsv --kind solid-rock \\\n  -o shares.json",
)


@command("unmix", EXAMPLES, OPTIONS, batch=True)
def unmix_spectra(files: Files, request: UnmixRequest, output: Output) -> Report:
    """Shares of olivine, orthopyroxene, clinopyroxene and plagioclase by volume, with intervals.

    Networks that learned from laboratory spectra answer for any sampling from 450 to 2450 nm. Where the minerals are
    named, mixtures of end members take part. `in_domain` says whether the shares may be quoted: where it was true, all
    shares were within 15 % of the truth for 95 % of laboratory spectra, and for 81 % of mixtures. Where it is false,
    quote the 95 % intervals.

    A weathered soil is not unmixed (exit code 3). A regression gives its normative plagioclase, FeO and TiO2 instead.
    A target that may be a weathered soil has both.
    """
    from lunarsci.spectra.jobs.unmix import unmix

    result = unmix(files, request, progress=output.progress("unmixing"))
    return Report(result, lambda: result_tables(result))


def result_tables(result: UnmixedSpectra) -> list[TextTable]:
    """The shares, the ratios of rocks, the composition of soils, and what they say."""
    from lunarsci.spectra.jobs.verdicts import shares_counted, shares_verdict

    verdicts = verdict_table(result.records, shares_verdict, shares_counted)
    return [*share_tables(result), *ratio_table(result), *chondrite_table(result), *normative_table(result), *verdicts]


def share_tables(result: UnmixedSpectra) -> list[TextTable]:
    """Of one spectrum a row each mineral, of several a row each spectrum; none where all are weathered."""
    shown = [one for one, kind in zip(result.shares, result.kinds, strict=True) if kind.kind != "weathered-soil"]
    if len(shown) == 1:
        rows = [[share.mineral, *_percent(share), f"{100 * share.present:.0f}"] for share in shown[0].fractions]
        headers = ["mineral", "share [%]", "68 %", "95 %", "probability of more than 5 % [%]"]
        title = f"{shown[0].id}: shares of minerals by volume"
        return [TextTable(headers, rows, title=title, notes=[shown[0].status])]
    minerals = list(dict.fromkeys(share.mineral for one in shown for share in one.fractions))
    rows = []
    for one in shown:
        cells = {share.mineral: "{} ({})".format(*_percent(share)[::2]).replace(" to ", "-") for share in one.fractions}
        rows.append([one.id, *(cells.get(name, "-") for name in minerals), "yes" if one.in_domain else "no"])
    headers = ["spectrum", *(f"{ABBREVIATIONS[name]} [%]" for name in minerals), "in domain"]
    title = f"shares of {', '.join(minerals)} by volume, with 95 % intervals"
    return [TextTable(headers, rows, title=title)] if rows else []


def _percent(share: MineralFraction) -> list[str]:
    ends = ((share.low, share.high), (share.low95, share.high95))
    return [
        UNKNOWN if share.fraction != share.fraction else plus_minus(100 * share.fraction, digits=0),
        *(f"{100 * low:.0f} to {100 * high:.0f}" for low, high in ends),
    ]


def ratio_table(mixed: UnmixedSpectra) -> list[TextTable]:
    """Ratios of the mafic minerals of solid rocks, beside published ones."""
    from lunarsci.spectra.abundance.result import BOULDERS

    rows = [[one.id, ratio.mineral.replace("_", " "), *_percent(ratio)] for one in mixed.shares for ratio in one.ratios]
    headers = ["spectrum", "ratio", "share [%]", "68 %", "95 %"]
    return [TextTable(headers, rows, title="ratios of mafic minerals", notes=[BOULDERS])] if rows else []


def chondrite_table(result: UnmixedSpectra) -> list[TextTable]:
    """Olivine and iron of those whose bands may be an ordinary chondrite's."""
    likely = [(one["id"], kind) for one in result.records if (kind := one["chondrite"]) and kind["in_domain"]]
    rows = [
        [id, *(_ranged(kind[name]) for name in ("fa", "fs")), _ranged(kind["olivine_in_mafic"], 100)]
        for id, kind in likely
    ]
    headers = ["spectrum", "Fa [mol %]", "Fs [mol %]", "olivine in mafic minerals [%]"]
    return [TextTable(headers, rows, title="from the bands, if an ordinary chondrite")] if rows else []


def normative_table(result: UnmixedSpectra) -> list[TextTable]:
    """Composition of weathered soils, where there are any."""
    records = [record for record in result.records if record["normative"]]
    rows = [[record["id"], *(_ranged(record["normative"][name]) for name in NORMATIVE)] for record in records]
    notes = _statuses(records)
    title = "composition by regression, if it is a weathered soil"
    headers = ["spectrum", *(f"{text} [wt %]" for text in NORMATIVE.values())]
    return [TextTable(headers, rows, title=title, notes=notes)] if rows else []


def _statuses(records: Sequence[Mapping[str, Mapping[str, str]]]) -> list[str]:
    names = [str(record["id"]) for record in records]
    return counted([record["normative"]["status"] for record in records], len(records), "spectra", names)


def _ranged(item: Mapping[str, float] | None, unit: float = 1.0) -> str:
    if item is None:
        return "-"
    value, low, high, low95, high95 = (unit * item[key] for key in ("value", "low", "high", "low95", "high95"))
    return f"{value:.0f} (68 %: {low:.0f} to {high:.0f}; 95 %: {low95:.0f} to {high95:.0f})"
