"""The report of `lunarsci spectra bands`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lunarsci.result import flat
from lunarsci.spectra.bands import BandFailure, SpectrumBands
from lunarsci.spectra.chemistry import KEYS, chemistry
from lunarsci.spectra.chemistry.plane import PLANE_TABLE, TABLE
from lunarsci.spectra.citations import PAPER, SMOOTHING
from lunarsci.spectra.readers.batch import SpectraBatch
from lunarsci.tables import table_hashes

from ..shared.report import Report
from ..shared.table import TextTable, counted, plus_minus

__all__ = ["bands_report"]

CHEMISTRY = (
    "Gaffey et al. (2002), Asteroids III, 183 (Fs, Wo)",
    "Burbine et al. (2009), Meteorit. Planet. Sci. 44, 1331, 10.1111/j.1945-5100.2009.tb01225.x (Fs, Wo)",
    "Dunn et al. (2010), Icarus 208, 789, 10.1016/j.icarus.2010.02.016 (chondrites)",
    "Cloutis et al. (1986), J. Geophys. Res. 91, 11641, 10.1029/JB091iB11p11641 (area ratio)",
    "Sanchez et al. (2012), Icarus 220, 36, 10.1016/j.icarus.2012.04.008 (temperature)",
    "Adams (1974), J. Geophys. Res. 79, 4829, 10.1029/JB079i032p04829 (the plane of the centres)",
)
SHORT = {
    "fs": "Fs",
    "wo": "Wo",
    "en": "En",
    "fo": "Fo",
    "fa": "Fa",
    "ol_share": "olivine share",
    "opx_share": "opx share",
}
AT_A_GLANCE = ("fs_gaffey", "wo_gaffey", "en_gaffey", "fs_trend_bc2000", "fo_bc1000", "opx_cloutis")
METHODS = {
    "gaffey": "Gaffey 2002",
    "burbine": "Burbine 2009",
    "trend": "synthetic opx",
    "dunn": "Dunn 2010",
    "cloutis": "Cloutis 1986",
    "bc1000": "1 µm centre",
}


def bands_report(batch: SpectraBatch, measured: Sequence[SpectrumBands | BandFailure], plane: Path | None) -> Report:
    """The report of `spectra bands`."""
    records = [
        item.to_dict() | {"chemistry": _chemistry(item), "source": origin}
        for item, origin in zip(measured, batch.origins, strict=True)
    ]
    good = [item for item in measured if isinstance(item, SpectrumBands)]
    failures = batch.failures_among(measured, SpectrumBands)

    def figures() -> Any:
        from lunarsci.spectra.mgm.figure import band_pages

        return band_pages(good)

    def plane_figures() -> Any:
        from lunarsci.spectra.chemistry.bands import plane_pages

        return plane_pages(good)

    return Report(
        schema="spectra-bands/1",
        result={"spectra": records},
        tables=[_bands_table(records), *_chemistry_tables(records)],
        rows=[_row(record) for record in records],
        figures=figures,
        inputs=batch.inputs,
        pictures={plane: plane_figures} if plane else {},
        data_tables=batch.tables | table_hashes(TABLE, PLANE_TABLE),
        sources=[PAPER, SMOOTHING, *CHEMISTRY],
        failures=failures,
    )


def _bands_table(records: Sequence[Mapping[str, Any]]) -> TextTable:
    headers = ["spectrum"]
    for name in ("1000", "2000"):
        headers += [f"BC{name} [nm]", "spread [nm]", f"BD{name}", f"area{name} [nm]", "continuum"]
    return TextTable(headers, [_bands_row(record) for record in records], notes=_band_notes(records))


def _bands_row(record: Mapping[str, Any]) -> list[str]:
    row = [record["id"]]
    for key in ("1000", "2000"):
        row += [
            plus_minus(record[f"bc{key}_nm"], record[f"bc{key}_sigma_nm"]),
            plus_minus(record[f"bc{key}_systematic_nm"]),
            plus_minus(record[f"bd{key}"], record[f"bd{key}_sigma"], digits=3),
            plus_minus(record[f"ba{key}_nm"], record[f"ba{key}_sigma_nm"]),
            record["continuum"][key],
        ]
    return row


def _band_notes(records: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [
        f"{band} band: {text}"
        for record in records
        for key, band in (("1000", "1 µm"), ("2000", "2 µm"))
        for text in (record[f"band{key}_note"], record[f"band{key}_status"])
        if text not in ("", "ok")
    ]
    return counted(sorted(lines), len(records), "spectra") + (_shared_errors(records[0]) if len(records) == 1 else [])


def _shared_errors(record: Mapping[str, Any]) -> list[str]:
    """What the errors that all channels share add, for a spectrum that knows them."""
    parts = [
        f"± {record[f'bc{key}_calibration_nm']:.1f} nm to BC{key}, ± {record[f'bd{key}_calibration']:.3f} to BD{key}"
        for key in ("1000", "2000")
        if record[f"bc{key}_calibration_nm"] is not None
    ]
    return [f"calibration errors, which all channels share, add {'; '.join(parts)}"] if parts else []


def _chemistry(item: SpectrumBands | BandFailure) -> dict[str, Any]:
    """Every key of the chemistry; None where the bands for it are not there."""
    found = chemistry(item) if isinstance(item, SpectrumBands) else {}
    return {key: found[key].to_dict() if key in found else None for key in KEYS}


def _row(record: Mapping[str, Any]) -> dict[str, Any]:
    """The row of `--csv`: value, error and range of each regression in columns of their own."""
    row = flat({key: value for key, value in record.items() if key != "chemistry"})
    for key, item in record["chemistry"].items():
        known = item or {"value": None, "sigma": None, "in_range": None}
        row |= {key: known["value"], f"{key}_sigma": known["sigma"], f"{key}_in_range": known["in_range"]}
    return row


def _chemistry_tables(records: Sequence[Mapping[str, Any]]) -> list[TextTable]:
    if len(records) == 1:
        return [_one_chemistry(records[0])] if any(records[0]["chemistry"].values()) else []
    return [_many_chemistries(records)] if _examples(records) else []


def _one_chemistry(record: Mapping[str, Any]) -> TextTable:
    rows = [
        [
            f"{SHORT[item['quantity']]}{_unit(item)}",
            _method(key),
            _usable(item),
            item["reason"] or f"if {item['domain']}",
        ]
        for key, item in record["chemistry"].items()
        if item
    ]
    notes = ["errors: the regression's, on laboratory minerals, and the band's; temperature: --json, caveat"]
    return TextTable(["from the bands", "by", "value", "holds"], rows, notes=notes)


def _many_chemistries(records: Sequence[Mapping[str, Any]]) -> TextTable:
    headers = ["spectrum"] + [
        f"{SHORT[item['quantity']]}{_unit(item)} {_method(key)}" for key, item in _examples(records).items()
    ]
    rows = [[record["id"], *(_usable(record["chemistry"][key]) for key in _examples(records))] for record in records]
    return TextTable(
        headers, rows, notes=["-: no band, or not to be used here; all regressions, and why not: --csv or --json"]
    )


def _examples(records: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """For each column in which some spectrum has a value, one of its entries."""
    columns = {key: [record["chemistry"][key] for record in records] for key in AT_A_GLANCE}
    usable = {key: [item for item in items if item and item["in_range"]] for key, items in columns.items()}
    return {key: items[0] for key, items in usable.items() if items}


def _method(key: str) -> str:
    name = next(text for part, text in METHODS.items() if part in key)
    band = "" if name == METHODS["bc1000"] else ", 1 µm" if "bc1000" in key else ", 2 µm" if "bc2000" in key else ""
    return name + band


def _unit(item: Mapping[str, Any]) -> str:
    return " [mol %]" if item["unit"] == "mol %" else ""


def _value(item: Mapping[str, Any]) -> str:
    return plus_minus(item["value"], item["sigma"], digits=0 if item["unit"] == "mol %" else 2)


def _usable(item: Mapping[str, Any] | None) -> str:
    return _value(item) if item and item["in_range"] else "-"
