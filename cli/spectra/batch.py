"""From files to spectra, and from spectral results to a `Report`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lunarsci.errors import DataError, LunarSciError
from lunarsci.inputs import expand_inputs, read_input
from lunarsci.spectra.bands import BandFailure
from lunarsci.spectra.mgm.result import MgmFailure
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.readers.envi import without_headers
from lunarsci.spectra.readers.splib import without_wavelength_files
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.detector import default_settings
from lunarsci.spectra.vnis.name import product_name
from lunarsci.spectra.vnis.observation import one_per_observation
from lunarsci.tables import table_hashes

from ..shared.report import together

__all__ = ["Batch", "expanded", "failures_of", "flat", "read_batch", "tables_of"]

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
    for name in one_per_observation(expanded(files, batch.failures)):
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


def expanded(files: Sequence[str], failures: list[str]) -> list[str]:
    """The inputs with folders and patterns expanded, each once; one that matches nothing is remembered."""
    names: list[str] = []
    for file in files:
        try:
            found = expand_inputs([file])
            if found != [file] and any(product_name(name) for name in found):
                found = [name for name in found if not name.endswith(".json")]
            names += without_wavelength_files(found)
        except DataError as error:
            failures.append(str(error))
    return without_headers(list(dict.fromkeys(names)))


def tables_of(batch: Batch) -> dict[str, str]:
    """Tables of the calibration, where a spectrum was calibrated on the way."""
    calibrated = any("footprint" in spectrum.metadata for spectrum in batch.spectra)
    return table_hashes(*default_settings().tables) if calibrated else {}


def flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values under joined names; tuples and lists as text."""
    row: dict[str, Any] = {}
    for key, value in record.items():
        if isinstance(value, Mapping):
            row |= {f"{key}_{inner}": item for inner, item in value.items()}
        else:
            row[key] = " ".join(map(str, value)) if isinstance(value, list | tuple) else value
    return row


def failures_of(batch: Batch, items: Sequence[Any], any_good: bool) -> list[str]:
    reasons = [
        f"{origin}: {item.id}: {item.status}"
        for item, origin in zip(items, batch.origins, strict=True)
        if isinstance(item, BandFailure | MgmFailure)
    ]
    failures = [*batch.failures, *reasons]
    if not any_good:
        raise DataError(together(failures))
    return failures
