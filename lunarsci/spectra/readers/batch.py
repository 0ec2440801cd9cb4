"""Many inputs at once: files, patterns, tables and arrays become spectra; what cannot be read is remembered."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import chain, product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import BatchError, DataError, Failure, LunarSciError, NoFilesError, ParameterError, warn
from lunarsci.io.inputs import NAMED_LEFT, InputFile, Source, expand_inputs, is_result, read_input
from lunarsci.io.tables import table_hashes
from lunarsci.names import meant, some_of
from lunarsci.provenance import sha256
from lunarsci.spectra.collection import SpectrumCollection, SpectrumRows, averaged
from lunarsci.spectra.readers.arrangements import header_channels
from lunarsci.spectra.readers.columns import is_plain, is_spectral_axis, is_wavelength
from lunarsci.spectra.readers.dispatch import read_spectra, spectra_of
from lunarsci.spectra.readers.envi import without_headers
from lunarsci.spectra.readers.libraries import without_wavelength_files
from lunarsci.spectra.readers.likely import REMARKS, cleaned, unlikely, without_steps
from lunarsci.spectra.readers.table import (
    SURELY,
    Column,
    ReflectanceUnit,
    SpectrumTable,
    StatedUnits,
    WavelengthUnit,
    length_unit,
    name_tokens,
    spectral_unit,
    to_nm,
)
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.detector import default_settings
from lunarsci.spectra.vnis.label import product_name
from lunarsci.spectra.vnis.observation import one_per_observation

OneSource: TypeAlias = (
    "Source | Spectrum | tuple[npt.ArrayLike, npt.ArrayLike] | tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]"
)
SpectraSource: TypeAlias = "OneSource | Sequence[OneSource]"
"""Paths, patterns, - for standard input, open files, tables, spectra, or arrays (wavelength_nm, reflectance) or
(wavelength_nm, reflectance, sigma), of which all but the first may hold a spectrum in each row or column; one or a
list."""
NAMED = 5
"""Spectra that are named where another is asked for."""
ARRAYS = "give (wavelength_nm, reflectance), or a third array of standard deviations"


@dataclass(frozen=True, slots=True)
class SpectraByPlace:
    """Arrays (wavelength (n,), reflectance (k, n)[, sigma]), and what each of the k spectra is called by its place."""

    arrays: tuple[Any, ...]
    ids: Sequence[str]


@dataclass(frozen=True, slots=True)
class SpectraBatch:
    """The spectra of all inputs.

    Attributes
    ----------
    spectra : in the order of the inputs, files before what is in memory.
    origins : name of the input of each.
    inputs : name of each input to its SHA-256.
    failures : what could not be read, one sentence each.
    read_as : how files were read where there was a choice, one sentence each.
    """

    spectra: SpectrumCollection = field(default_factory=lambda: SpectrumCollection([]))
    origins: list[str] = field(default_factory=list)
    inputs: dict[str, str] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    read_as: list[str] = field(default_factory=list)

    @property
    def remarks(self) -> dict[str, list[str]]:
        """For a result: `read_as`, where there was a choice in how files were read."""
        return {"read_as": list(self.read_as)} if self.read_as else {}

    @property
    def tables(self) -> dict[str, str]:
        """Tables of the calibration with their hashes, where a spectrum was calibrated on the way."""
        calibrated = any("footprint" in about for about in self.spectra.firsts())
        return table_hashes(*default_settings().tables) if calibrated else {}

    def failures_among(self, reasons: Mapping[int, str]) -> list[Failure]:
        """What could not be read, and the reason of each spectrum, by position, that has no result.

        Raises DataError when none has one.
        """
        spectra = self.spectra
        each = Counter(self.origins)
        named = ((k, self.origins[k]) for k in sorted(reasons))
        none = (Failure.of(name, reasons[k], spectra[k].id, only=each[name] == 1) for k, name in named)
        failures = [*self.failures, *none]
        if len(reasons) == len(spectra):
            raise BatchError.of(failures)
        return failures


def read_batch(
    source: SpectraSource,
    wavelength_unit: WavelengthUnit | None = None,
    reflectance_unit: ReflectanceUnit | None = None,
    only: Sequence[str] = (),
) -> SpectraBatch:
    """Read every input, folders and patterns expanded, one file for each observation of VNIS; some spectra by `only`.

    One that cannot be read is remembered. Raises DataError when none can, and for a name that no spectrum has.
    """
    batch, parts = SpectraBatch(), list[SpectrumRows]()
    items = _listed(source)
    paths = [str(item) for item in items if isinstance(item, str | Path)]
    items = [_by_place(_as_arrays(item)) for item in items]
    for item in [
        *one_per_observation(expanded(paths, batch.failures)),
        *(item for item in items if not isinstance(item, str | Path)),
    ]:
        if isinstance(item, Spectrum | SpectraByPlace | tuple | np.ndarray):
            parts += _from_memory(batch, item, wavelength_unit, reflectance_unit)
        else:
            parts += _from_file(batch, item, wavelength_unit, reflectance_unit)
    if not parts:
        if batch.failures:
            raise BatchError.of(batch.failures)
        raise DataError("no spectra were given; name files or tables")
    clean, notes = cleaned(parts)
    for line in notes:
        warn(line)
    result = replace(batch, spectra=SpectrumCollection(clean))
    return _those(result, only) if only else result


def _those(batch: SpectraBatch, only: Sequence[str]) -> SpectraBatch:
    """The spectra of some names or patterns, in the order of these."""
    places = places_of(batch.spectra.ids, only)
    return replace(batch, spectra=batch.spectra.taken(np.array(places)), origins=[batch.origins[k] for k in places])


def places_of(ids: Sequence[str], only: Sequence[str]) -> list[int]:
    """Places of what some names or patterns name, in their order. Raises DataError for a name that nothing has."""
    each = {name: [k for k, one in enumerate(ids) if one == name or fnmatchcase(one, name)] for name in only}
    if missing := next((name for name, rows in each.items() if not rows), None):
        result = some_of(ids, NAMED)
        raise DataError(f"no spectrum is called '{missing}'; {meant(missing, ids)}there are {len(ids)}: {result}")
    return list(dict.fromkeys(chain.from_iterable(each.values())))


def _listed(source: Any) -> list[Any]:
    """The inputs one by one; two or three arrays or lists in a tuple are one input."""
    several = isinstance(source, tuple) and len(source) in (2, 3) and not _is_input(source[0])
    if several and not any(_is_input(item) and not hasattr(item, "to_numpy") for item in source):
        return [source]
    return list(source) if isinstance(source, list | tuple | SpectrumRows | SpectrumCollection) else [source]


def _is_input(item: Any) -> bool:
    named = hasattr(item, "colnames") or hasattr(item, "columns") or hasattr(item, "read")
    return named or isinstance(item, str | Path | InputFile | Spectrum | tuple)


def _as_arrays(item: Any) -> Any:
    """A spectrum of specutils, a Series by wavelength, columns of pandas beside wavelengths, or an array of xarray with
    a coordinate of wavelengths, as arrays with names; others unchanged.
    """
    if hasattr(item, "to_frame") and hasattr(item, "index") and _has_wavelengths(item.index):
        item = (item.index.to_numpy(), item)
    if isinstance(item, tuple) and len(item) in (2, 3):
        return _named_arrays(item)
    if hasattr(item, "spectral_axis") and hasattr(item, "flux"):
        error = getattr(item, "uncertainty", None)
        return (item.spectral_axis, item.flux) if error is None else (item.spectral_axis, item.flux, _sd(error))
    if not (hasattr(item, "coords") and hasattr(item, "dims") and hasattr(item, "transpose")):
        return item
    named = [name for name in item.dims if name in item.coords]
    axis = next((name for name in named if is_wavelength(str(name))), None)
    axis = axis or next((name for name in named if is_spectral_axis(str(name), item.coords[name].values)), None)
    if hasattr(item, "data_vars"):
        several = [one for one in item.data_vars.values() if axis in one.dims and one.ndim > 1]
        return _as_arrays(several[0]) if axis is not None and len(several) == 1 else item
    if axis is None:
        return item
    wavelength = np.asarray(item.coords[axis].values, float)
    words = str(item.coords[axis].attrs.get("units", ""))
    unit = spectral_unit(name_tokens(words)) or length_unit(words)
    in_nm = wavelength if unit is None else to_nm(wavelength, unit)
    others = [name for name in item.dims if name != axis]
    labels = [item[name].values if name in item.coords else range(item.sizes[name]) for name in others]
    values = np.asarray(item.transpose(..., axis).values, float)
    return SpectraByPlace((in_nm, values.reshape(-1, wavelength.size)), _places(list(map(str, others)), labels))


def _has_wavelengths(index: Any) -> bool:
    """Whether the index of a Series is its wavelengths, though it has no name: numbers above 0 in order."""
    values = index.to_numpy()
    if index.name is not None or values.dtype.kind not in "iuf" or len(values) < 2 or not values.min() > 0:
        return False
    steps = np.diff(values)
    return bool((steps > 0).all() or (steps < 0).all())


def _named_arrays(given: tuple[Any, ...]) -> Any:
    """Wavelengths and columns of pandas as arrays with the names of these; others unchanged."""
    values = [part.to_numpy() if hasattr(part, "to_numpy") else part for part in given]
    if hasattr(given[1], "columns"):
        down = len(given[1]) == np.size(_plain_values(given[0]))
        frames = [one.T if down and np.ndim(one) == 2 else one for one in values[1:]]
        return SpectraByPlace((values[0], *frames), [*map(str, given[1].columns if down else given[1].index)])
    name = getattr(given[1], "name", None)
    if not isinstance(name, str) or np.ndim(_plain_values(given[1])) != 1 or is_plain(name):
        return given
    return SpectraByPlace(given, [name])


def _places(axes: Sequence[str], labels: Sequence[Any]) -> list[str]:
    """What is called by where it is on some axes, such as `y 3 x 7`; '' where there is no axis, or one of places."""
    if not axes:
        return [""]
    return [" ".join(f"{a} {one}" for a, one in zip(axes, place, strict=True)) for place in product(*labels)]


def _by_place(item: Any) -> Any:
    """Arrays with lines and samples as spectra with their places; others unchanged."""
    if not isinstance(item, tuple) or len(item) not in (2, 3) or np.ndim(_plain_values(item[1])) != 3:
        return item
    wavelength, *parts = item
    values = [np.asarray(_plain_values(part)) for part in parts]
    channels = np.size(_plain_values(wavelength))
    if any(one.ndim == 3 and one.shape[-1] != channels for one in values):
        raise ParameterError(f"spectra of shape {values[0].shape} beside {channels} wavelengths; give these last")
    rows = [one.reshape(-1, channels) if one.ndim == 3 else one for one in values]
    names = _places(("line", "sample"), [range(size) for size in values[0].shape[:2]])
    return SpectraByPlace((wavelength, *rows), names)


def _plain_values(given: Any) -> Any:
    return getattr(given, "value", given)


def _sd(error: Any) -> Any:
    """One standard deviation of an uncertainty of astropy's NDData."""
    from astropy.nddata import StdDevUncertainty

    deviation = error.represent_as(StdDevUncertainty) if hasattr(error, "represent_as") else error
    return deviation.quantity if hasattr(deviation, "quantity") else deviation.array


def _from_file(batch: SpectraBatch, item: Any, wavelength_unit: Any, reflectance_unit: Any) -> Iterator[SpectrumRows]:
    """The spectra of a file, or none, and why."""
    name = item if isinstance(item, str) else str(getattr(item, "name", None) or "<table>")
    try:
        source = read_input(_with_wavelengths(item, wavelength_unit))
        result = read_spectra(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
        notes = unlikely(result, source.name)
    except LunarSciError as error:
        batch.failures.append(Failure.of(name, error))
        return
    result = _levelled(batch, result, notes)
    for line in notes:
        warn(line)
    batch.origins.extend([source.name] * len(result))
    batch.inputs[source.name] = source.sha256
    batch.inputs.update(result.about(0).get("inputs", {}))
    batch.read_as.extend(result.about(0).get("read_as", ()))
    yield _averaged(batch, result, source.name)


def _levelled(batch: SpectraBatch, rows: SpectrumRows, notes: Sequence[str]) -> SpectrumRows:
    """The spectra without the steps that were told of."""
    steps = [line for line in notes if REMARKS["step"] in line]
    batch.read_as.extend(steps)
    return without_steps(rows) if steps else rows


def _averaged(batch: SpectraBatch, rows: SpectrumRows, name: str) -> SpectrumRows:
    """The spectra with as many channels as are measured; said where some were averaged."""
    result, each = averaged(rows)
    if each > 1:
        batch.read_as.append(f"{name}: {rows.wavelength_nm.size} channels, every {each} averaged")
        warn(batch.read_as[-1])
    return result


def _with_wavelengths(item: Any, unit: WavelengthUnit | None = None) -> Any:
    """A table of pandas whose index holds the wavelengths has them as its first column; in nm as arrays are."""
    if not hasattr(item, "to_csv"):
        return item
    item = item.to_frame() if hasattr(item, "to_frame") else item
    if item.index.dtype.kind not in "iuf" and header_channels([*map(str, item.columns)]):
        return item.copy().rename_axis(index="id").reset_index()
    if any(map(is_wavelength, map(str, item.columns))):
        return item
    name = "" if item.index.name is None else str(item.index.name)
    values = item.index.to_numpy()
    unnamed = not name and values.dtype.kind == "f" and len(values) > 1 and bool((np.diff(values) > 0).all())
    if not (unnamed or is_wavelength(name)):
        return item
    name = name or ("wavelength" if unit or _are_um(values) else "wavelength_nm")
    return item.copy().rename_axis(index=name).reset_index()  # a copy is in one piece


def _from_memory(
    batch: SpectraBatch, item: Any, wavelength_unit: WavelengthUnit | None, reflectance_unit: ReflectanceUnit | None
) -> Iterator[SpectrumRows]:
    """The spectra of one item that is no file, into `batch` as well; a failure there where they cannot be used."""
    before, notes = len(batch.origins) + len(batch.failures), list[str]()
    if isinstance(item, SpectraByPlace) and any(f"<{one}>" in batch.inputs for one in item.ids):
        item = item.arrays  # of which spectra are numbered
    name = f"spectrum {before + 1}"
    try:
        if isinstance(item, Spectrum):
            rows = SpectrumRows.of(item)
        else:
            rows = _of_arrays(before, item, wavelength_unit, reflectance_unit)
            # What is computed scatters by nothing.
            notes = [line for line in unlikely(rows, f"<{name}>") if REMARKS["smooth"] not in line]
    except (DataError, ParameterError) as error:
        batch.failures.append(Failure.of(name, str(error).replace(f"<{name}>", name)))
        return
    batch.read_as.extend(rows.about(0).get("read_as", ()) if not isinstance(item, Spectrum) else ())
    rows = _levelled(batch, rows, notes)
    for line in notes:
        warn(line)
    for k, id in enumerate(rows.ids):
        sigma = None if rows.uncertainty is None or not rows.has_sigma[k] else rows.uncertainty[k]
        content = (rows.wavelength_nm, rows.reflectance[k], sigma)
        batch.origins.append(str(item.metadata.get("source", f"<{id}>")) if isinstance(item, Spectrum) else f"<{id}>")
        batch.inputs[f"<{id}>"] = sha256(b"".join(part.tobytes() for part in content if part is not None))
    yield _averaged(batch, rows, f"<{rows.ids[0]}>")


def _of_arrays(
    before: int, given: Any, wavelength_unit: WavelengthUnit | None, reflectance_unit: ReflectanceUnit | None
) -> SpectrumRows:
    """Spectra of arrays, numbered from those `before` on, read as a table. Raises DataError, ParameterError."""
    name = f"spectrum {before + 1}"
    ids = given.ids if isinstance(given, SpectraByPlace) else ()
    given = given.arrays if isinstance(given, SpectraByPlace) else given
    if not isinstance(given, tuple) or len(given) not in (2, 3):
        raise ParameterError(f"{name}: {len(given)} arrays, or one alone, are no spectrum; {ARRAYS}")
    given = _in_order(name, given)
    wavelength = np.asarray(given[0] if (quantity := _wavelengths(name, given[0])) is None else quantity, float)
    rows = [_rows_of(name, _plain(name, part), wavelength.size).copy() for part in given[1:]]
    units = ["fraction" if _quantity(part) is not None else None for part in given[1:]]
    if wavelength.ndim != 1 or len(rows[-1]) not in (1, len(rows[0])):
        shapes = f"wavelengths of shape {wavelength.shape}, {len(rows[0])} spectra and {len(rows[-1])} rows of errors"
        raise ParameterError(f"{name}: {shapes}; {ARRAYS}")
    columns = tuple(
        (
            Column((ids[k] if ids else "") or f"spectrum {before + k + 1}", values, k + 2, units[0]),
            Column("", rows[1][min(k, len(rows[1]) - 1)], k + 2, units[1]) if len(rows) == 2 else None,
        )
        for k, values in enumerate(rows[0])
    )
    places = tuple(f"channel {k + 1}" for k in range(wavelength.size))
    axis = Column("wavelength", wavelength, 1)
    table = SpectrumTable(InputFile(f"<{name}>", b""), "arrays", axis, columns, places, block=rows[0])
    unit = "nm" if quantity is not None else wavelength_unit or _by_range(name, wavelength)
    return spectra_of(table, StatedUnits(unit, None if units[0] else reflectance_unit))


def _in_order(name: str, given: tuple[Any, ...]) -> tuple[Any, ...]:
    """Wavelengths first: reflectance alone goes up and down, and such arrays are taken as swapped, which is said."""
    if any(_quantity(one) is not None or np.ndim(one) != 1 or np.size(one) < 3 for one in given[:2]):
        return given
    if np.size(given[0]) != np.size(given[1]):
        return given
    one_way = [abs(np.sign(np.diff(np.asarray(one, float))).sum()) == np.size(one) - 1 for one in given[:2]]
    if one_way != [False, True]:
        return given
    warn(f"<{name}>: the second array ascends, the first does not: read as (reflectance, wavelength)")
    return given[1], given[0], *given[2:]


def _wavelengths(name: str, given: Any) -> Any:
    """Wavelengths of a quantity, None for plain numbers. [nm]"""
    if np.any(_mask(given)):
        raise ParameterError(f"{name}: some wavelengths are masked; mask the reflectances of these channels")
    if (quantity := _quantity(given)) is None:
        return None
    from astropy.units import spectral

    return quantity.to_value("nm", spectral())


def _by_range(name: str, values: FloatArray) -> WavelengthUnit:
    """The unit of wavelengths by their values, as in a file without one; nm where these tell nothing."""
    if not _are_um(values):
        return "nm"
    notes = f"<{name}>: wavelengths {values.min():g}-{values.max():g} read as µm"
    warn(f"{notes}; give nm, or wavelength_unit='um'")
    return "um"


def _are_um(values: FloatArray) -> bool:
    low, high = SURELY["um"]
    return bool(values.size and low <= values.min() and values.max() <= high)


def _mask(given: Any) -> Any:
    """The mask of an array of numpy or astropy; `mask` of pandas is a method."""
    mask = getattr(given, "mask", False)
    return False if callable(mask) else mask


def _quantity(given: Any) -> Any:
    """The quantity of astropy, without its mask, that something is, or a column with a unit; None for plain numbers."""
    if hasattr(given, "quantity"):
        return None if given.unit is None else given.quantity
    return getattr(given, "unmasked", given) if hasattr(given, "to_value") else None


def _plain(name: str, given: Any) -> Any:
    """Numbers, fractions of what has a unit, NaN where they are masked. Raises ParameterError for another unit."""
    mask, quantity = _mask(given), _quantity(given)
    if quantity is not None and not quantity.unit.is_equivalent(""):
        raise ParameterError(f"{name}: in {quantity.unit}; reflectances are fractions or percent")
    values = given if quantity is None else quantity.to_value("")
    return np.where(mask, np.nan, np.asarray(values, float)) if np.any(mask) else values


def _rows_of(name: str, given: Any, channels: int) -> FloatArray:
    """(n, channels) of one spectrum, or of some in rows or columns."""
    values = np.asarray(given, float)
    if values.ndim == 2 and values.shape[0] == channels != values.shape[1]:
        return values.T
    if values.ndim not in (1, 2) or values.shape[-1] != channels or values.shape == (channels, channels):
        raise ParameterError(f"{name}: an array of shape {values.shape} beside {channels} wavelengths; {ARRAYS}")
    return np.atleast_2d(values)


def expanded(files: Iterable[str], failures: list[Failure]) -> list[str]:
    """The inputs with folders and patterns expanded, each once; one that matches nothing is remembered."""
    names: list[str] = []
    for file in files:
        try:
            result = expand_inputs([file])
            if result != [file] and any(product_name(name) for name in result):
                result = [name for name in result if not name.endswith(".json")]
            elif Path(file).is_dir():
                result = _without_results(file, result)
            names += without_wavelength_files(result)
        except DataError as error:
            failures.append(Failure.of(file, error))
    return without_headers(list(dict.fromkeys(names)))


def _without_results(folder: str, names: Sequence[str]) -> list[str]:
    """The files of a folder but lunarsci's own results, with a warning. Raises NoFilesError for none else."""
    left = [name for name in names if is_result(name)]
    if not left:
        return list(names)
    listed = some_of([Path(name).name for name in left], NAMED_LEFT)
    count = f"{len(left)} result{'s' if len(left) > 1 else ''}"
    warn(f"{folder}: left out, {count} of lunarsci: {listed}")
    if len(left) == len(names):
        raise NoFilesError(f"{folder}: holds nothing but results of lunarsci; name the files of spectra, or a pattern")
    return [name for name in names if name not in left]
