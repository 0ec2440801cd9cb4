"""`lunarsci spectra indices`: spectral indices of the Moon."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lunarsci.spectra.jobs.requests import IndicesRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import option
from ..shared.table import SHOWN, TextTable, plus_minus
from .options import ONLY, UNITS, Files

if TYPE_CHECKING:
    from lunarsci.spectra.jobs.indices import MeasuredIndices

OPTIONS = {
    "index": option(metavar="NAME"),
    "smooth_nm": option(min=0),
    **UNITS,
    **ONLY,
}
WHY_NOT = {
    "no_channels": "no channels where the formula needs them",
    "undefined": "the formula has no value for such reflectances",
    "beyond_range": "beyond what it was made for: see --json",
}
EXAMPLES = (
    "lunarsci spectra indices lunarsci-demo/rock.ecsv",
    "lunarsci spectra indices lunarsci-demo/rock.ecsv --index ibd1000 --csv",
)


@command("indices", EXAMPLES, OPTIONS, batch=True)
def indices(files: Files, request: IndicesRequest) -> Report:
    """Spectral indices: IBD1000, IBD2000, R540, R1580, slopes, olivine, spinel, OMAT, FeO and TiO2.

    Expects reflectance factors at 30, 0, 30 deg; centre, depth, area and asymmetry of bands: spectra bands.
    """
    from lunarsci.spectra.jobs.indices import indices

    result = indices(files, request)
    return Report(result, result_tables(result))


def result_tables(result: MeasuredIndices) -> list[TextTable]:
    """One spectrum in full, of several a line each."""
    return [_one(result) if len(result.batch.spectra) == 1 else _many(result)]


def _one(result: MeasuredIndices) -> TextTable:
    from lunarsci.spectra.indices import INDICES

    record = result.records()[0]
    rows = [
        [_title(INDICES[name]), _cell(record[name]), _remark(INDICES[name], record[name])] for name in result.columns
    ]
    return TextTable(["index", "value", ""], rows, title=record["id"], notes=_notes())


def _many(result: MeasuredIndices) -> TextTable:
    from lunarsci.spectra.indices import INDICES, NO_CHANNELS

    records = result.records()
    shown = [name for name, column in result.columns.items() if (column.status != NO_CHANNELS).any()]
    rows = [[record["id"], *(_cell(record[name]) for name in shown)] for record in records[:SHOWN]]
    missing = [INDICES[name].title for name in result.columns if name not in shown]
    notes = [f"no channels for {', '.join(missing)}"] if missing else []
    headers = ["spectrum", *(_title(INDICES[name]) for name in shown)]
    return TextTable(headers, rows, total=len(records), notes=[*notes, *_notes()])


def _notes() -> list[str]:
    return [
        "errors: noise of the channels, interpolation between them and, of abundances, what the formula missed of 11 "
        "soils; formulas and sources: --json",
        "OMAT and Clementine: origins of Clementine's reflectances",
    ]


def _title(index: Any) -> str:
    return index.title if index.unit == "-" else f"{index.title} [{index.unit}]"


def _remark(index: Any, record: dict[str, Any]) -> str:
    if record["status"] == "ok" and index.missed_by:
        low, most = index.missed_by
        return f"noise alone {record['sigma']:.2g}; 11 soils missed by {low:g} in the median, {most:g} at most"
    return WHY_NOT.get(record["status"], "")


def _cell(record: dict[str, Any]) -> str:
    """`0.1234 ± 0.0012`, with two digits of the error."""
    if record["value"] is None or record["status"] != "ok":
        return "-"
    return plus_minus(record["value"], record["error"] or None, digits=4)
