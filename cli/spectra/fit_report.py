"""The report of `lunarsci spectra fit`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import chain
from typing import Any

from lunarsci.result import flat
from lunarsci.spectra.abundance.end_members import FAMILY_OF, OPAQUE
from lunarsci.spectra.abundance.end_members import TABLE as END_MEMBERS
from lunarsci.spectra.abundance.hapke import IRON_TABLE as IRON
from lunarsci.spectra.abundance.nbsr import TABLE as CALIBRATIONS
from lunarsci.spectra.mgm.assemblages import TABLES
from lunarsci.spectra.mgm.composition import compositions
from lunarsci.spectra.mgm.result import FittedBand, MgmFit
from lunarsci.spectra.readers.batch import SpectraBatch
from lunarsci.tables import table_hashes

from ..shared.report import Report
from ..shared.table import TextTable, plus_minus
from .fit_run import FitRequest, FitRun

__all__ = ["fit_report"]

MGM = "Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955"
NBSR = "Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025"
HAPKE = "Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039"
ABSORBANCE = "Clark & Roush (1984), J. Geophys. Res. 89, 6329, 10.1029/JB089iB07p06329"
WEATHERING = "Hapke (2001), J. Geophys. Res. 106, 10039, 10.1029/2000JE001338"
UNMIXING = {"hapke": (HAPKE,), "absorbance": (ABSORBANCE,), "unmix": (HAPKE, ABSORBANCE)}
UNLIKE_RMS = 0.2
"""A fit that misses ln R by more than this, root mean square, describes something else; assumed."""
UNMOVED = 0.9
"""Share of the prior's standard deviation above which a composition is the prior's; assumed."""
PERCENT_OF = {
    "fo": "Fo of olivine",
    "fs": "Fs of orthopyroxene",
    "wo": "Wo of clinopyroxene",
    "fs_cpx": "Fs of clinopyroxene",
}


def fit_report(batch: SpectraBatch, run: FitRun, request: FitRequest) -> Report:
    """The report of `spectra fit`."""
    records = [_record(run, index, origin) for index, origin in enumerate(batch.origins)]
    good = [item for item in run.results if isinstance(item, MgmFit)]
    failures = batch.failures_among(run.results, MgmFit)
    unmixed = [
        found[0] for found in run.abundances.values() if found and found[0].method == request.abundance != "nbsr"
    ]
    start = {file.name: file.sha256 for file in (run.start_file, run.library_file, run.known_file) if file}

    def figures() -> Any:
        from lunarsci.spectra.abundance.figure import share_pages
        from lunarsci.spectra.mgm.figure import fit_pages

        return chain(fit_pages(good), share_pages(unmixed))

    return Report(
        schema="spectra-fit/1",
        result={"spectra": records},
        tables=_tables(good, records),
        rows=[row for record in records for row in _band_rows(record)],
        figures=figures,
        formats={".fit": lambda _: _fit_file(good[0], run)},
        inputs=batch.inputs | start,
        data_tables=batch.tables | table_hashes(*TABLES, *_abundance_tables(request)),
        sources=[MGM, NBSR, *UNMIXING.get(request.abundance, ()), *([WEATHERING] if request.iron else [])],
        seed=request.seed if request.errors == "sample" else None,
        untrusted=_untrusted(good),
        failures=failures,
    )


def _abundance_tables(request: FitRequest) -> tuple[str, ...]:
    iron = (IRON,) if request.iron else ()
    return (CALIBRATIONS,) if request.abundance == "nbsr" else (CALIBRATIONS, END_MEMBERS, *iron)


def _untrusted(good: Sequence[MgmFit]) -> str:
    unsettled = [item.id for item in good if not item.converged]
    unlike = [item.id for item in good if item.rms_ln > UNLIKE_RMS]
    doubts = [f"no convergence for {', '.join(unsettled)}"] if unsettled else []
    doubts += [f"the model does not describe {', '.join(unlike)}"] if unlike else []
    return f"not to be trusted: {'; '.join(doubts)}" if doubts else ""


def _fit_file(fit: MgmFit, run: FitRun) -> bytes:
    from lunarsci.spectra.mgm.fitfile import fit_file_text, read_fit_file
    from lunarsci.spectra.mgm.fitfile_model import fit_file_of

    header = read_fit_file(run.start_file) if run.start_file else None
    return fit_file_text(fit_file_of(fit, header)).encode()


def _record(run: FitRun, index: int, origin: str) -> dict[str, Any]:
    """The keys of one spectrum in `--json`."""
    item = run.results[index]
    choice, intervals = run.choices.get(index), run.intervals.get(index)
    found_modes = [modes.to_dict() for modes in run.abundances.get(index, [])]
    found = compositions(item) if isinstance(item, MgmFit) else ()
    return item.to_dict() | {
        "source": origin,
        "compositions": {one.key: asdict(one) for one in found},
        "choice": choice.to_dict() if choice else None,
        "intervals": intervals.to_dict() if intervals else None,
        "abundance": found_modes[0] if found_modes else None,
        "abundances": {modes["method"]: modes for modes in found_modes},
    }


def _tables(good: Sequence[MgmFit], records: Sequence[Mapping[str, Any]]) -> list[TextTable]:
    alone = len(records) == 1 and bool(good)
    overview = TextTable(
        ["spectrum", "assemblage", "rms ln R [%]", "NBSR 1 µm OPX", "NBSR 2 µm OPX", "status"],
        [_overview_row(record) for record in records],
        notes=[*_shared_in_ratios(records[0]), *_composition_notes(records[0])] if alone else _not_shown(records),
    )
    if not alone:
        return [overview]
    tables = [_bands_table(good[0]), overview]
    tables += [_intervals_table(records[0]["intervals"])] if records[0]["intervals"] else []
    tables += [_choice_table(records[0]["choice"])] if records[0]["choice"] else []
    tables += [_abundance_table(records[0]["abundances"])] if records[0]["abundances"] else []
    return tables


def _not_shown(records: Sequence[Mapping[str, Any]]) -> list[str]:
    there = any(record["intervals"] for record in records)
    return ["bands and intervals of several spectra: --csv or --json"] if there else ["bands: --csv or --json"]


def _shared_in_ratios(record: Mapping[str, Any]) -> list[str]:
    notes = []
    for key, text in (
        ("calibration", "calibration errors, which all channels share, add to the ratios"),
        ("continuum", "the choice of the continuum moves the ratios by"),
    ):
        ratios = {name: (record["nbsr"] or {}).get(region) for region, name in (("um1", "1 µm"), ("um2", "2 µm"))}
        parts = [f"± {r[key]:.3f} at {name}" for name, r in ratios.items() if r and r[key] is not None]
        notes += [f"{text} {', '.join(parts)}"] if parts else []
    return notes


def _composition_notes(record: Mapping[str, Any]) -> list[str]:
    return [
        f"{PERCENT_OF[key]} from the band centres: {plus_minus(item['mean'], item['sigma'])} mol %{_doubt(item)}"
        for key, item in record["compositions"].items()
        if item["mean"] is not None
    ]


def _doubt(item: Mapping[str, Any]) -> str:
    if not item["in_range"]:
        return f", beyond the {item['lowest']:g}-{item['highest']:g} of the trend: do not use"
    told = item["sigma"] <= UNMOVED * item["prior_sigma"]
    return "" if told else ", the prior's: the spectrum says nothing"


def _overview_row(record: Mapping[str, Any]) -> list[str]:
    ratios = record["nbsr"] or {}
    cells = [plus_minus(r["opx"], r["sigma"], digits=2) if r else "-" for r in (ratios.get("um1"), ratios.get("um2"))]
    rms = None if record["rms_ln"] is None else 100 * record["rms_ln"]
    margin = _margin(record["choice"])
    return [record["id"], record["assemblage"] + margin, plus_minus(rms, digits=2), *cells, record["status"]]


def _margin(choice: Mapping[str, Any] | None) -> str:
    return "" if not choice or choice["strong"] else " (weak evidence)"


def _bands_table(fit: MgmFit) -> TextTable:
    spread = any(band.center_continuum_nm is not None for band in fit.bands)
    headers = ["band", "mineral", "centre [nm]", "FWHM [nm]", "strength [ln R]", "strength/σ"]
    headers += ["shrinkage centre", "FWHM", *(["continua: centre [nm]", "strength"] if spread else [])]
    notes = ["shrinkage: 1 where the data decide on centre or FWHM, 0 where the prior does"]
    notes += ["continua: standard deviation over all of them, for the choice of one is a choice"] if spread else []
    return TextTable(headers, [_band_row(band, spread) for band in fit.bands], notes=notes)


def _band_row(band: FittedBand, spread: bool) -> list[str]:
    certain = band.strength_sigma > 0
    row = [
        band.name,
        band.mineral if band.mineral != "any" else "-",
        plus_minus(band.center_nm, band.center_sigma_nm),
        plus_minus(band.fwhm_nm, band.fwhm_sigma_nm),
        plus_minus(band.strength, band.strength_sigma, digits=3),
        f"{abs(band.strength) / band.strength_sigma:.1f}" if certain else "-",
        f"{band.shrinkage['center']:.2f}",
        f"{band.shrinkage['fwhm']:.2f}",
    ]
    if spread:
        row += [plus_minus(band.center_continuum_nm), plus_minus(band.strength_continuum, digits=3)]
    return row


def _intervals_table(intervals: Mapping[str, Any]) -> TextTable:
    rows = []
    for item in intervals["intervals"]:
        digits = 1 if item["name"].endswith("_nm") else 3
        value, *ends = (f"{item[key]:.{digits}f}" for key in ("value", "low68", "high68", "low95", "high95"))
        rows.append([item["name"], value, f"{ends[0]} to {ends[1]}", f"{ends[2]} to {ends[3]}"])
    headers = ["parameter", "best" if intervals["method"] == "profile" else "median", "68 %", "95 %"]
    return TextTable(headers, rows, title=f"intervals by {intervals['method']}", notes=intervals["remarks"])


def _choice_table(choice: Mapping[str, Any]) -> TextTable:
    rows = [
        [item["assemblage"], f"{item['score']:.1f}", f"{item['ln_evidence']:.1f}", f"{item['bic']:.1f}"]
        for item in choice["candidates"]
    ]
    headers = ["assemblage", "score", "ln evidence", "BIC"]
    return TextTable(headers, rows, title="all assemblages, the most evidence first", notes=[choice["status"]])


def _abundance_table(abundances: Mapping[str, Mapping[str, Any]]) -> TextTable:
    rows, notes = [], []
    for method, modes in abundances.items():
        for mineral in (*FAMILY_OF, OPAQUE):
            if share := modes.get(mineral):
                ends = [
                    f"{100 * share[low]:.0f} to {100 * share[high]:.0f}"
                    for low, high in (("low", "high"), ("low95", "high95"))
                ]
                rows.append([method, mineral, f"{100 * share['fraction']:.0f}", *ends])
        notes.append(f"{method}: {modes['status']}")
    return TextTable(["method", "mineral", "share [%]", "68 %", "95 %"], rows, title="mineral shares", notes=notes)


def _abundance_columns(abundances: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """`unmix_olivine`, `unmix_olivine_low` and the like, and whether the method applies."""
    found: dict[str, Any] = {}
    for method, modes in abundances.items():
        found[f"{method}_in_domain"] = modes["in_domain"]
        for mineral in (*FAMILY_OF, OPAQUE):
            if share := modes.get(mineral):
                found[f"{method}_{mineral}"] = share["fraction"]
                found |= {f"{method}_{mineral}_{end}": share[end] for end in ("low", "high")}
    return found


def _band_rows(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One row per band; a spectrum without a fit has one row with its status."""
    common = {key: record[key] for key in ("source", "id", "assemblage", "continuum", "converged", "status", "rms_ln")}
    for region in ("um1", "um2"):
        ratio = (record["nbsr"] or {}).get(region) or {}
        for key in ("opx", "sigma", "calibration", "continuum"):
            common[f"nbsr_{region}_{key}"] = ratio.get(key)
    for key, item in record["compositions"].items():
        common |= {f"{key}_mean": item["mean"], f"{key}_sigma": item["sigma"], f"{key}_in_range": item["in_range"]}
    common |= _abundance_columns(record["abundances"])
    if record["choice"]:
        common |= {f"choice_{key}": record["choice"][key] for key in ("margin", "strong")}
    ends = {item["name"]: item for item in record["intervals"]["intervals"]} if record["intervals"] else {}
    common |= _interval_columns({name: name for name in ("nbsr_um1_opx", "nbsr_um2_opx") if name in ends}, ends)
    return [common | flat(band) | _interval_columns(_of_band(band), ends) for band in record["bands"]] or [common]


def _of_band(band: Mapping[str, Any]) -> dict[str, str]:
    """Columns of a band by the name of its parameter."""
    key = band["name"].lower().replace(" ", "_").replace("-", "_")
    return {f"{key}_{kind}": kind for kind in ("center_nm", "fwhm_nm", "strength")}


def _interval_columns(columns: Mapping[str, str], ends: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """`center_low68_nm` and the like."""
    found: dict[str, Any] = {}
    for name, column in columns.items():
        stem, unit = (column[:-3], "_nm") if column.endswith("_nm") else (column, "")
        if name in ends:
            found |= {f"{stem}_{end}{unit}": ends[name][end] for end in ("low68", "high68", "low95", "high95")}
    return found
