"""From files to spectra, and from spectral results to a `Report`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lunarsci.errors import DataError, LunarSciError
from lunarsci.inputs import expand_inputs, read_input
from lunarsci.spectra.bands import BandFailure, SpectrumBands
from lunarsci.spectra.mgm.assemblages import TABLES
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.name import product_name
from lunarsci.spectra.vnis.observation import one_per_observation
from lunarsci.spectra.vnis.settings import default_settings
from lunarsci.tables import table_hashes

from .report import Report, together
from .table import TextTable, counted, plus_minus

__all__ = ["Batch", "bands_report", "fit_report", "read_batch"]

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
MGM = "Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955"
NBSR = "Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025"
UNLIKE_RMS = 0.2
"""A fit that misses ln R by more than this, root mean square, describes something else; assumed."""
SMOOTHING = "Savitzky & Golay (1964), Anal. Chem. 36, 1627, 10.1021/ac60214a047"


@dataclass(frozen=True, slots=True)
class Batch:
    """The spectra of all inputs, the inputs' hashes, and what could not be read."""

    spectra: list[Spectrum]
    origins: list[str]
    inputs: dict[str, str]
    failures: list[str]


def read_batch(files: Sequence[str], wavelength_unit: Any, reflectance_unit: Any) -> Batch:
    """Read every input; one that cannot be read is remembered. Raises DataError when none can."""
    batch = Batch([], [], {}, [])
    for name in one_per_observation(_expanded(files, batch.failures)):
        try:
            source = read_input(name)
            found = read_spectra(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
            batch.spectra.extend(found)
            batch.origins.extend([source.name] * len(found))
            batch.inputs[source.name] = source.sha256
            for spectrum in found:
                batch.inputs.update(spectrum.metadata.get("inputs", {}))
        except LunarSciError as error:
            batch.failures.append(str(error) if name in str(error) else f"{name}: {error}")
    if not batch.spectra:
        raise DataError(together(batch.failures))
    return batch


def _expanded(files: Sequence[str], failures: list[str]) -> list[str]:
    """The inputs with folders and patterns expanded, each once; one that matches nothing is remembered."""
    names: list[str] = []
    for file in files:
        try:
            found = expand_inputs([file])
            if found != [file] and any(product_name(name) for name in found):
                found = [name for name in found if not name.endswith(".json")]
            names += found
        except DataError as error:
            failures.append(str(error))
    return list(dict.fromkeys(names))


def _tables(batch: Batch) -> dict[str, str]:
    """Tables of the calibration, where a spectrum was calibrated on the way."""
    calibrated = any("footprint" in spectrum.metadata for spectrum in batch.spectra)
    return table_hashes(*default_settings().tables) if calibrated else {}


def bands_report(batch: Batch, measured: Sequence[SpectrumBands | BandFailure]) -> Report:
    """The report of `spectra bands`."""
    records = [item.to_dict() | {"source": origin} for item, origin in zip(measured, batch.origins, strict=True)]
    good = [item for item in measured if isinstance(item, SpectrumBands)]
    failures = _failures(batch, measured, bool(good))

    def figures() -> Any:
        from lunarsci.spectra.figure import band_pages

        return band_pages(good)

    return Report(
        schema="spectra-bands/1",
        result={"spectra": records},
        tables=[_bands_table(records)],
        rows=[_flat(record) for record in records],
        figures=figures,
        inputs=batch.inputs,
        data_tables=_tables(batch),
        sources=[PAPER, SMOOTHING],
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


def fit_report(batch: Batch, fits: Sequence[MgmFit | MgmFailure]) -> Report:
    """The report of `spectra fit`."""
    records = [item.to_dict() | {"source": origin} for item, origin in zip(fits, batch.origins, strict=True)]
    good = [item for item in fits if isinstance(item, MgmFit)]
    failures = _failures(batch, fits, bool(good))
    unsettled = [item.id for item in good if not item.converged]
    unlike = [item.id for item in good if item.rms_ln > UNLIKE_RMS]
    doubts = [f"no convergence for {', '.join(unsettled)}"] if unsettled else []
    doubts += [f"the model does not describe {', '.join(unlike)}"] if unlike else []

    def figures() -> Any:
        from lunarsci.spectra.figure import fit_pages

        return fit_pages(good)

    return Report(
        schema="spectra-fit/1",
        result={"spectra": records},
        tables=_fit_tables(good, records),
        rows=[row for record in records for row in _band_rows(record)],
        figures=figures,
        inputs=batch.inputs,
        data_tables=_tables(batch) | table_hashes(*TABLES),
        sources=[MGM, NBSR],
        untrusted=f"not to be trusted: {'; '.join(doubts)}" if doubts else "",
        failures=failures,
    )


def _fit_tables(good: Sequence[MgmFit], records: Sequence[Mapping[str, Any]]) -> list[TextTable]:
    overview = TextTable(
        ["spectrum", "rms ln R [%]", "NBSR 1 µm OPX", "NBSR 2 µm OPX", "status"],
        [_fit_row(record) for record in records],
        notes=_shared_in_ratios(records[0]) if len(records) == 1 else [],
    )
    return [_one_fit_table(good[0]), overview] if len(records) == 1 and good else [overview]


def _shared_in_ratios(record: Mapping[str, Any]) -> list[str]:
    ratios = {name: (record["nbsr"] or {}).get(key) for key, name in (("um1", "1 µm"), ("um2", "2 µm"))}
    parts = [f"± {r['calibration']:.3f} at {name}" for name, r in ratios.items() if r and r["calibration"] is not None]
    return [f"calibration errors, which all channels share, add to the ratios {', '.join(parts)}"] if parts else []


def _fit_row(record: Mapping[str, Any]) -> list[str]:
    ratios = record["nbsr"] or {}
    cells = [plus_minus(r["opx"], r["sigma"], digits=2) if r else "-" for r in (ratios.get("um1"), ratios.get("um2"))]
    rms = None if record["rms_ln"] is None else 100 * record["rms_ln"]
    return [record["id"], plus_minus(rms, digits=2), *cells, record["status"]]


def _one_fit_table(fit: MgmFit) -> TextTable:
    rows = [
        [
            band.name,
            band.mineral if band.mineral != "any" else "-",
            plus_minus(band.center_nm, band.center_sigma_nm),
            plus_minus(band.fwhm_nm, band.fwhm_sigma_nm),
            plus_minus(band.strength, band.strength_sigma, digits=3),
            f"{-band.strength / band.strength_sigma:.1f}",
            f"{band.shrinkage['center']:.2f}",
            f"{band.shrinkage['fwhm']:.2f}",
        ]
        for band in fit.bands
    ]
    note = "shrinkage: 1 where the data decide on centre or FWHM, 0 where the prior does"
    headers = [
        "band", "mineral", "centre [nm]", "FWHM [nm]", "strength [ln R]", "strength/σ", "shrinkage centre", "FWHM",
    ]  # fmt: skip
    return TextTable(headers, rows, notes=[note])


def _band_rows(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One row per band; a spectrum without a fit has one row with its status."""
    common = {key: record[key] for key in ("source", "id", "assemblage", "continuum", "converged", "status", "rms_ln")}
    for region in ("um1", "um2"):
        ratio = (record["nbsr"] or {}).get(region)
        common |= {
            f"nbsr_{region}_opx": ratio["opx"] if ratio else None,
            f"nbsr_{region}_sigma": ratio["sigma"] if ratio else None,
        }
    return [common | _flat(band) for band in record["bands"]] or [common]


def _flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values under joined names; tuples and lists as text."""
    row: dict[str, Any] = {}
    for key, value in record.items():
        if isinstance(value, Mapping):
            row |= {f"{key}_{inner}": item for inner, item in value.items()}
        else:
            row[key] = " ".join(map(str, value)) if isinstance(value, list | tuple) else value
    return row


def _failures(batch: Batch, items: Sequence[Any], any_good: bool) -> list[str]:
    reasons = [
        f"{origin}: {item.id}: {item.status}"
        for item, origin in zip(items, batch.origins, strict=True)
        if isinstance(item, BandFailure | MgmFailure)
    ]
    failures = [*batch.failures, *reasons]
    if not any_good:
        raise DataError(together(failures))
    return failures
