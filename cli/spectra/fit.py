"""`lunarsci spectra fit`: the Modified Gaussian Model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from lunarsci.spectra.jobs.requests import FitRequest
from lunarsci.spectra.mgm import PERCENT_OF, with_trend

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import BLOCKS, Output, RequestOption, option
from ..shared.table import SHOWN, UNKNOWN, TextTable, plus_minus, verdict_table
from .options import ONLY, UNITS, Files

if TYPE_CHECKING:
    from lunarsci.spectra.abundance.result import Abundance
    from lunarsci.spectra.jobs.fit import MgmFits
    from lunarsci.spectra.mgm.result import FittedBand, MgmFit


MODEL, LIMITS, ANSWER = "Model", "Constraints", "Errors"
MODEL_OPTIONS: dict[str, RequestOption] = {
    "assemblage": option(panel=MODEL),
    "continuum": option(panel=MODEL),
    "composition": option(panel=MODEL, metavar="KEY=MEAN:ERROR,…"),
    "start": option("--start-file", panel=MODEL, metavar="FILE.fit"),
    "band_minerals": option(panel=MODEL, metavar="NUMBER=OPX,…"),
    "prior": option(panel=MODEL),
    "model_error": option(panel=MODEL),
    "starts": option(panel=MODEL, min=0, max=100),
    "fix": option(panel=LIMITS, metavar="NAME[=VALUE]"),
    "bound": option(panel=LIMITS, metavar="NAME=LOW:HIGH"),
    "tie": option(panel=LIMITS, metavar="NAME=K*OTHER+C"),
}
OPTIONS = MODEL_OPTIONS | {
    "errors": option(panel=ANSWER),
    "continuum_spread": option(panel=ANSWER),
    "seed": option(panel=ANSWER, min=0),
    **UNITS,
    **ONLY,
}
WAVELENGTHS_NM, STRENGTHS = (0.0, 3000.0), (-5.0, 5.0)
"""Between these lie bands; an error as wide says that nothing is known."""
EXAMPLES = (
    "lunarsci spectra fit lunarsci-demo/rock.ecsv",
    "lunarsci spectra fit lunarsci-demo/rock.ecsv --assemblage OPX-CPX -o fit.json",
)


@command("fit", EXAMPLES, OPTIONS, batch=True, blocks=BLOCKS)
def fit_spectra(files: Files, request: FitRequest, output: Output) -> Report:
    """Modified Gaussian Model: absorption bands of olivine, pyroxenes and plagioclase, with errors and NBSR.

    -o FILE.fit writes a result file of the RELAB MGM program (one spectrum).
    """
    from lunarsci.spectra.jobs.fit import fit

    to_file = output.path is not None and output.path.suffix.lower() == ".fit"
    fits = fit(files, replace(request, to_fit_file=to_file), progress=output.progress("fitting"))
    return Report(fits, lambda: result_tables(fits), formats={".fit": lambda _: fits.fit_file().encode()})


def result_tables(fits: MgmFits) -> list[TextTable]:
    """The fits, and what they say."""
    from lunarsci.spectra.jobs.verdicts import fit_verdict, fits_counted

    return [*fit_tables(fits), *verdict_table(fits.records, fit_verdict, fits_counted)]


def fit_tables(fits: MgmFits) -> list[TextTable]:
    """An overview, and of one spectrum alone its bands, intervals, choice and shares."""
    alone = len(fits.records) == 1 and bool(fits.good)
    record = fits.records[0]
    overview = TextTable(
        ["spectrum", "assemblage", "rms ln R [%]", "NBSR 1 µm OPX", "NBSR 2 µm OPX", "status"],
        [_overview_row(record) for record in fits.records[:SHOWN]],
        total=len(fits.records),
        notes=_notes(record, fits.good[0]) if alone else _not_shown(fits),
    )
    if not alone:
        return [overview]
    tables = [_bands_table(fits.good[0], overview), overview]
    tables += [_intervals_table(record["intervals"])] if record["intervals"] else []
    tables += [_choice_table(record["choice"]), _minerals_table(record["choice"])] if record["choice"] else []
    tables += [_abundance_table(fits.abundances[0])] if fits.abundances.get(0) else []
    return tables


def _not_shown(fits: MgmFits) -> list[str]:
    there = bool(fits.intervals)
    notes = ["bands and intervals of several spectra: --csv or --json"] if there else ["bands: --csv or --json"]
    assumed = not (fits.choices or fits.request.start)
    return notes + (["the assemblage was assumed; --assemblage auto compares all"] if assumed else [])


def _notes(record: Mapping[str, Any], fit: MgmFit) -> list[str]:
    if fit.prior == "damping":
        error = "errors include the residuals"
    else:
        error = f"errors include noise, a model error of {100 * record['model_error']:.1f} % of R, and the priors"
    shared = _shared_in_ratios(record, with_shared=len(fit.data.shifts) > 0)
    missing = None in (record["nbsr"] or {None: None}).values()
    why = "NBSR -: a pyroxene is not in the assemblage, its band not in the spectrum, or the ratio left open"
    lines = [f"{error}; not other minima and other continua (--continuum-spread)", *([why] if missing else []), *shared]
    return [*lines, *_composition_notes(fit)]


def _shared_in_ratios(record: Mapping[str, Any], *, with_shared: bool) -> list[str]:
    notes = []
    ratios = {name: (record["nbsr"] or {}).get(region) for region, name in (("um1", "1 µm"), ("um2", "2 µm"))}
    given = {name: ratio for name, ratio in ratios.items() if ratio}
    parts = [
        f"± {r['calibration']:.2g} at {name}" if r["calibration"] < 1 else f"more than they can be at {name}"
        for name, r in given.items()
        if r["calibration"] is not None
    ]
    notes += [f"calibration errors, which all channels share, add to the ratios {', '.join(parts)}"] if parts else []
    lost = [name for name, r in given.items() if r["calibration"] is None] if with_shared else []
    notes += [f"what calibration errors add to the ratios is not determined at {', '.join(lost)}"] if lost else []
    ends = [
        f"{r['continuum_low']:.2f} to {r['continuum_high']:.2f} at {name}"
        for name, r in given.items()
        if r["continuum_low"] is not None
    ]
    return notes + ([f"other continua give ratios of OPX from {', '.join(ends)}"] if ends else [])


def _composition_notes(fit: MgmFit) -> list[str]:
    from lunarsci.spectra.mgm.batch import compositions

    notes = []
    for item in compositions(fit):
        if item.mean is not None:
            doubt = (
                f", {item.doubt}{'' if item.in_range else ': do not use'}"
                if item.doubt
                else f", if {item.domain}"
                if item.domain
                else ""
            )
            value = plus_minus(item.mean, item.sigma, within=(0.0, 100.0)) if item.in_range else plus_minus(item.mean)
            value = with_trend(value, item.trend_sigma) if item.in_range and item.determined else value
            notes.append(f"{PERCENT_OF[item.key]} from the band centres: {value} mol %{doubt}")
    return notes


def _overview_row(record: Mapping[str, Any]) -> list[str]:
    ratios, choice = record["nbsr"] or {}, record["choice"]
    cells = [
        plus_minus(r["opx"], r["sigma"], digits=2, within=(0.0, 1.0)) if r else "-"
        for r in (ratios.get("um1"), ratios.get("um2"))
    ]
    rms = None if record["rms_ln"] is None else 100 * record["rms_ln"]
    margin = "" if not choice or choice["strong"] else " (weak evidence)"
    return [record["id"], record["assemblage"] + margin, plus_minus(rms, digits=2), *cells, record["status"]]


def _bands_table(fit: MgmFit, overview: TextTable) -> TextTable:
    """The bands; what `overview` has of the fit stands below, where a screen takes no second table."""
    spread = any(band.center_continuum_nm is not None for band in fit.bands)
    headers = ["band", "mineral", "centre [nm]", "FWHM [nm]", "strength [ln R]", "strength/σ"]
    headers += ["shrinkage of centre", "shrinkage of FWHM"]
    headers += ["continua: centre [nm]", "continua: strength"] if spread else []
    rows = [_band_row(band, spread) for band in fit.bands]
    rms, *ratios, status = overview.rows[0][2:]
    shown = [
        f"{ratio} at {place}"
        for ratio, place in zip(ratios, ("1 µm", "2 µm"), strict=True)
        if ratio not in ("-", UNKNOWN)
    ]
    ratio_text = f"; NBSR of OPX {', '.join(shown)}" if shown else ""
    notes = [f"{status}, rms of ln R {rms} %{ratio_text}"]
    notes += ["shrinkage: 1 where the data decide on centre or FWHM, 0 where the prior does"]
    if any(cell.endswith("?") for row in rows for cell in row):
        notes.append(
            "± ?: not determined, the error is wider than where bands can be; the value is where the fit ended"
        )
    notes += ["continua: largest distance under any of them, for the choice of one is a choice"] if spread else []
    return TextTable(headers, rows, notes=notes)


def _band_row(band: FittedBand, spread: bool) -> list[str]:
    certain = band.strength_sigma > 0
    row = [
        band.name,
        band.mineral if band.mineral != "any" else "-",
        _or_held(band.center_nm, band.center_sigma_nm, 1, WAVELENGTHS_NM),
        _or_held(band.fwhm_nm, band.fwhm_sigma_nm, 1, WAVELENGTHS_NM),
        _or_held(band.strength, band.strength_sigma, 3, STRENGTHS),
        f"{abs(band.strength) / band.strength_sigma:.1f}" if certain else "-",
        f"{band.shrinkage['center']:.2f}",
        f"{band.shrinkage['fwhm']:.2f}",
    ]
    if spread:
        row += [plus_minus(band.center_continuum_nm), plus_minus(band.strength_continuum, digits=3)]
    return row


def _or_held(value: float, sigma: float, digits: int, within: tuple[float, float]) -> str:
    """A parameter of a band; one without an error was held, one with `± ?` has an error wider than bands can lie."""
    if sigma == 0:
        return f"{value:.{digits}f}, held"
    shown = plus_minus(value, sigma, digits=digits, within=within)
    return f"{value:.{digits}f} ± ?" if shown == UNKNOWN else shown


def _intervals_table(intervals: Mapping[str, Any]) -> TextTable:
    rows = []
    for item in intervals["intervals"]:
        digits = 1 if item["name"].endswith("_nm") else 3
        value, *ends = (f"{item[key]:.{digits}f}" for key in ("value", "low68", "high68", "low95", "high95"))
        rows.append([item["name"], value, f"{ends[0]} to {ends[1]}", f"{ends[2]} to {ends[3]}"])
    headers = ["parameter", "best" if intervals["method"] == "profile" else "median", "68 %", "95 %"]
    return TextTable(headers, rows, title=f"intervals by {intervals['method']}", notes=intervals["remarks"])


def _choice_table(choice: Mapping[str, Any]) -> TextTable:
    shown = [item for item in choice["candidates"] if item["probability"] >= 0.005]
    rows = [[one["assemblage"], f"{100 * one['probability']:.1f}", f"{one['ln_evidence']:.1f}"] for one in shown]
    together = sum(item["probability"] for item in choice["candidates"] if item["assemblage"] in choice["family"])
    headers = ["assemblage", "recalibrated probability [%]", "ln evidence"]
    notes = [
        f"not distinguished: {', '.join(choice['family'])}, which together have {100 * together:.1f} % of all",
        "a further mineral lowers the probability unless the evidence grows; by how much was learned from laboratory "
        "spectra",
    ]
    if left := len(choice["candidates"]) - len(rows):
        notes.append(f"{left} others, each below half a per cent: --json")
    return TextTable(headers, rows, title="assemblages, the most probable first", notes=notes)


def _minerals_table(choice: Mapping[str, Any]) -> TextTable:
    """What the fit needs beside what `spectra unmix` sees, by mineral."""
    there = {name: "-" if share is None else f"{100 * share:.0f}" for name, share in choice["present"].items()}
    rows = [[name, f"{100 * need:.0f}", there[name]] for name, need in choice["mineral_probability"].items()]
    headers = ["mineral", "the fit needs it [%]", "more than 5 % of it, by `unmix` [%]"]
    notes = ["what a fit needs was learned from powders of one or two minerals; `unmix` allows four"]
    notes += ["the spectrum looks weathered, and `unmix` was not tested on such ones"] if "-" in there.values() else []
    return TextTable(headers, rows, title="probabilities of minerals", notes=notes)


def _abundance_table(abundances: Sequence[Abundance]) -> TextTable:
    rows = [
        [
            modes.method,
            share.mineral,
            UNKNOWN if share.fraction != share.fraction else plus_minus(100 * share.fraction, digits=0),
            f"{100 * share.low:.0f} to {100 * share.high:.0f}",
            f"{100 * share.low95:.0f} to {100 * share.high95:.0f}",
        ]
        for modes in abundances
        for share in modes.fractions
    ]
    notes = [f"{modes.method}: {modes.status}" for modes in abundances] + not_weighed(abundances)
    return TextTable(["method", "mineral", "share [%]", "68 %", "95 %"], rows, title="mineral shares", notes=notes)


def not_weighed(abundances: Sequence[Abundance]) -> list[str]:
    """That shares are of the minerals named alone, by method, where any share is told."""
    shown = [modes for modes in abundances if modes.determined and modes.not_weighed]
    beside = {modes.method: ", ".join(modes.not_weighed) for modes in shown}
    return [f"{method}: of these minerals alone; {names} not weighed, may be much" for method, names in beside.items()]
