"""Many inputs at once: files, patterns, tables and arrays become spectra; what cannot be read is remembered."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError, LunarSciError, LunarSciWarning
from lunarsci.inputs import InputFile, Source, expand_inputs, read_input, together
from lunarsci.provenance import sha256
from lunarsci.spectra.collection import SpectrumCollection, SpectrumRows
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.envi import without_headers
from lunarsci.spectra.readers.likely import unlikely
from lunarsci.spectra.readers.table import ReflectanceUnit, WavelengthUnit
from lunarsci.spectra.readers.text import without_wavelength_files
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.detector import default_settings
from lunarsci.spectra.vnis.name import product_name
from lunarsci.spectra.vnis.observation import one_per_observation
from lunarsci.tables import table_hashes

OneSource: TypeAlias = "Source | Spectrum | tuple[npt.ArrayLike, npt.ArrayLike]"
SpectraSource: TypeAlias = "OneSource | Sequence[OneSource]"
"""Paths, patterns, - for standard input, open files, tables, spectra, (wavelength_nm, reflectance); one or a list."""


@dataclass(frozen=True, slots=True)
class SpectraBatch:
    """The spectra of all inputs.

    Attributes
    ----------
    spectra : in the order of the inputs, files before what is in memory.
    origins : name of the input of each.
    inputs : name of each input to its SHA-256.
    failures : what could not be read, one sentence each.
    """

    spectra: SpectrumCollection = field(default_factory=lambda: SpectrumCollection([]))
    origins: list[str] = field(default_factory=list)
    inputs: dict[str, str] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    @property
    def tables(self) -> dict[str, str]:
        """Tables of the calibration with their hashes, where a spectrum was calibrated on the way."""
        calibrated = any("footprint" in about for about in self.spectra.firsts())
        return table_hashes(*default_settings().tables) if calibrated else {}

    def failures_among(self, reasons: Mapping[int, str]) -> list[str]:
        """What could not be read, and the reason of each spectrum, by position, that has no result.

        Raises DataError when none has one.
        """
        spectra = self.spectra
        told = (f"{self.origins[k]}: {spectra[k].id}: {reasons[k]}" for k in sorted(reasons))
        failures = [*self.failures, *told]
        if len(reasons) == len(spectra):
            raise DataError(together(failures))
        return failures


def read_batch(
    source: SpectraSource,
    wavelength_unit: WavelengthUnit | None = None,
    reflectance_unit: ReflectanceUnit | None = None,
) -> SpectraBatch:
    """Read every input, folders and patterns expanded, one file for each observation of VNIS.

    One that cannot be read is remembered. Raises DataError when none can.
    """
    batch, parts = SpectraBatch(), list[SpectrumRows]()
    items = _listed(source)
    paths = [str(item) for item in items if isinstance(item, str | Path)]
    for item in [
        *one_per_observation(expanded(paths, batch.failures)),
        *(item for item in items if not isinstance(item, str | Path)),
    ]:
        if isinstance(item, Spectrum | tuple):
            parts += _from_memory(batch, item)
        else:
            parts += _from_file(batch, item, wavelength_unit, reflectance_unit)
    if not parts:
        raise DataError(together(batch.failures) if batch.failures else "no spectra were given; name files or tables")
    return replace(batch, spectra=SpectrumCollection(parts))


def _listed(source: Any) -> list[Any]:
    """The inputs one by one; a pair that holds arrays or lists is one spectrum."""
    if isinstance(source, tuple) and len(source) == 2 and not any(_is_input(item) for item in source):
        return [source]
    return list(source) if isinstance(source, list | tuple | SpectrumRows | SpectrumCollection) else [source]


def _is_input(item: Any) -> bool:
    named = hasattr(item, "colnames") or hasattr(item, "columns") or hasattr(item, "read")
    return named or isinstance(item, str | Path | InputFile | Spectrum | tuple)


def _from_file(batch: SpectraBatch, item: Any, wavelength_unit: Any, reflectance_unit: Any) -> Iterator[SpectrumRows]:
    """The spectra of a file, or none, and why."""
    name = item if isinstance(item, str) else getattr(item, "name", "<table>")
    try:
        source = read_input(item)
        found = read_spectra(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
        told = unlikely(found, source.name)
    except LunarSciError as error:
        batch.failures.append(str(error) if name in str(error) else f"{name}: {error}")
        return
    for line in told:
        warnings.warn(line, LunarSciWarning, stacklevel=2)
    batch.origins.extend([source.name] * len(found))
    batch.inputs[source.name] = source.sha256
    batch.inputs.update(found.about(0).get("inputs", {}))
    yield found


def _from_memory(batch: SpectraBatch, item: Any) -> Iterator[SpectrumRows]:
    try:
        spectrum = item if isinstance(item, Spectrum) else _of_arrays(f"spectrum {len(batch.origins) + 1}", *item)
    except DataError as error:
        batch.failures.append(str(error))
        return
    content = (spectrum.wavelength_nm, spectrum.reflectance, spectrum.uncertainty)
    batch.origins.append(str(spectrum.metadata.get("source", f"<{spectrum.id}>")))
    batch.inputs[f"<{spectrum.id}>"] = sha256(b"".join(part.tobytes() for part in content if part is not None))
    yield SpectrumRows.of(spectrum)


def _of_arrays(name: str, wavelength: Any, reflectance: Any) -> Spectrum:
    """A spectrum of two arrays; wavelengths without a unit are in nm."""
    if hasattr(wavelength, "to_value"):
        wavelength = wavelength.to_value("nm")
    return Spectrum(name, np.asarray(wavelength, float), np.asarray(reflectance, float))


def expanded(files: Iterable[str], failures: list[str]) -> list[str]:
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
