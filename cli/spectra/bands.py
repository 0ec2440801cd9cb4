"""`lunarsci spectra bands`: centres, depths and areas of the 1 and 2 µm bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.spectra.jobs.requests import BandsRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import BLOCKS, Output, option
from ..shared.table import SHOWN, TextTable, bare, counted, plus_minus, verdict_table
from .options import ONLY, UNITS, Files

if TYPE_CHECKING:
    from lunarsci.spectra.jobs.bands import MeasuredBands

OPTIONS = {
    "continuum": option(),
    "smooth_nm": option(min=0),
    "smooth": option(min=0),
    "smooth_order": option(min=0),
    **UNITS,
    **ONLY,
}
Plane = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Draw the 2 µm centre over the 1 µm centre among the pyroxenes (.png, …)."),
]
AT_A_GLANCE = ("fs_gaffey", "wo_gaffey", "en_gaffey", "fs_trend_bc2000", "fo_bc1000", "opx_cloutis")
"""Regressions that the table of many spectra has, by their keys."""
EXAMPLES = (
    "lunarsci spectra bands lunarsci-demo/rock.ecsv",
    "lunarsci spectra bands lunarsci-demo/rock.ecsv --continuum hull \\\n  --plot bands.png",
)


@command("bands", EXAMPLES, OPTIONS, batch=True, blocks=BLOCKS)
def bands(files: Files, request: BandsRequest, output: Output, plane: Plane = None) -> Report:
    """Centre, depth and area of the 1 and 2 µm absorption bands, with standard errors.

    Published regressions give the composition of pyroxene and olivine from them, each with its error and its range.
    """
    from lunarsci.spectra.jobs.bands import bands

    output.check_extra("--plane", plane)
    result = bands(files, request, progress=output.progress("measuring bands"))
    return Report(result, lambda: result_tables(result), pictures={plane: result.plane} if plane else {})


def result_tables(result: MeasuredBands) -> list[TextTable]:
    """Bands, what follows of compositions, and what both say."""
    from lunarsci.spectra.jobs.verdicts import bands_verdict

    records = result.content()["spectra"]
    return [_bands_table(result), *_chemistry_tables(result), *verdict_table(records, bands_verdict)]


def _bands_table(result: MeasuredBands) -> TextTable:
    headers = ["spectrum"]
    for name, band in (("1000", "1 µm"), ("2000", "2 µm")):
        headers += [f"BC{name} [nm]", f"spread {band} [nm]", f"BD{name}", f"area{name} [nm]"]
        headers.append(f"continuum at {band}")
    records = result.content()["spectra"]
    rows = [_bands_row(record) for record in records[:SHOWN]]
    return TextTable(headers, rows, notes=_band_notes(result, records), total=len(records))


def _bands_row(record: Mapping[str, Any]) -> list[str]:
    row = [record["id"]]
    for key in ("1000", "2000"):
        row += [
            *_centre_and_spread(record, key),
            plus_minus(record[f"bd{key}"], record[f"bd{key}_sigma"], digits=3),
            plus_minus(record[f"ba{key}_nm"], record[f"ba{key}_sigma_nm"]),
            record["continuum"][key],
        ]
    return row


def _centre_and_spread(record: Mapping[str, Any], key: str) -> list[str]:
    """The centre with the error of its noise, and what methods differ by."""
    from lunarsci.spectra.band_status import with_errors

    center, sigma = record[f"bc{key}_nm"], record[f"bc{key}_sigma_nm"]
    if center is None:
        return ["-", "-"]
    value, noise, *method = with_errors(center, sigma, record[f"bc{key}_method_nm"])
    return [f"{value} ± {noise}", *(method or ["-"])]


def _band_notes(result: MeasuredBands, records: Sequence[Mapping[str, Any]]) -> list[str]:
    names = {"1000": "1 µm", "2000": "2 µm"}
    remarks = sorted((f"{names[key]} band: {text}", place, owner) for place, owner, key, text in result.remarks())
    lines, owners = [line for line, _, _ in remarks], [owner for _, _, owner in remarks]
    return counted(lines, len(records), "spectra", owners) + (_shared_errors(records[0]) if len(records) == 1 else [])


def _shared_errors(record: Mapping[str, Any]) -> list[str]:
    """What the errors that all channels share add, for a spectrum that knows them."""
    parts = [
        f"± {record[f'bc{key}_calibration_nm']:.1f} nm to BC{key}, ± {record[f'bd{key}_calibration']:.3f} to BD{key}"
        for key in ("1000", "2000")
        if record[f"bc{key}_calibration_nm"] is not None
    ]
    return [f"calibration errors, which all channels share, add {'; '.join(parts)}"] if parts else []


def _chemistry_tables(result: MeasuredBands) -> list[TextTable]:
    records = result.content()["spectra"]
    if len(records) == 1:
        return [_one_chemistry(records[0])] if any(records[0]["chemistry"].values()) else []
    examples = result.examples(AT_A_GLANCE)
    return [_many_chemistries(records, examples)] if examples else []


def _one_chemistry(record: Mapping[str, Any]) -> TextTable:
    """What may be read of the bands; regressions that do not apply are counted."""
    from lunarsci.spectra.jobs.bands import SHORT, regression

    every = [item for item in record["chemistry"].items() if item[1]]
    rows = [
        [f"{SHORT[item['quantity']]}{_unit(item)}", regression(key), _usable(item), f"if {item['domain']}"]
        for key, item in every
        if not item["reason"]
    ]
    notes = ["errors are those of the regression on laboratory minerals, and of the band; temperature: --json, caveat"]
    if left := len(every) - len(rows):
        notes.append(f"{left} other regressions do not apply to it; why not: --json")
    return TextTable(["from the bands", "by", "value", "valid only"], rows, notes=notes)


def _many_chemistries(records: Sequence[Mapping[str, Any]], examples: Mapping[str, Mapping[str, Any]]) -> TextTable:
    """One column for each regression that some spectrum can use."""
    from lunarsci.spectra.jobs.bands import SHORT, regression

    headers = ["spectrum"] + [
        f"{SHORT[item['quantity']]}{_unit(item)} {regression(key)}" for key, item in examples.items()
    ]
    rows = [[record["id"], *(_usable(record["chemistry"][key]) for key in examples)] for record in records[:SHOWN]]
    notes = ["-: no band, or not to be used here; all regressions, and why not: --csv or --json"]
    notes += [
        f"{bare(header)}: only if {item['domain']}" for header, item in zip(headers[1:], examples.values(), strict=True)
    ]
    return TextTable(headers, rows, notes=notes, total=len(records))


def _unit(item: Mapping[str, Any]) -> str:
    return " [mol %]" if item["unit"] == "mol %" else ""


def _value(item: Mapping[str, Any]) -> str:
    percent = item["unit"] == "mol %"
    return plus_minus(
        item["value"], item["sigma"], digits=0 if percent else 2, within=(0.0, 100.0) if percent else (0.0, 1.0)
    )


def _usable(item: Mapping[str, Any] | None) -> str:
    return _value(item) if item and item["in_range"] else "-"
