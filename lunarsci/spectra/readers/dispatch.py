"""Which reader a file needs, and the rules on rows, order, units and missing values that hold for every format."""

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias, get_args

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError, warn
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.registry import FORMATS
from lunarsci.spectra.collection import SpectrumRows
from lunarsci.spectra.readers.columns import (
    RIGHT_TABLE,
    as_reflectance,
    is_wavelength,
    only_spectra,
    spectrum_ids,
    with_absolute_errors,
)
from lunarsci.spectra.readers.detectors import joined
from lunarsci.spectra.readers.likely import markers_of, without_deleted, without_markers
from lunarsci.spectra.readers.pds import label_of_table
from lunarsci.spectra.readers.table import (
    SCALES,
    ReflectanceChoice,
    ReflectanceUnit,
    SpectrumTable,
    StatedUnits,
    WavelengthUnit,
    check_alike,
    medians_above_0,
    reflectance_unit,
    uncertainty_scale,
    unit_by_size,
    wavelength_nm,
)
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.label import product_name
from lunarsci.spectra.vnis.observation import read_observation

_OTHERS = {b"\x89HDF": "an HDF5 or netCDF-4 file", b"CDF": "a netCDF file", b"%PDF": "a PDF", b"\x89PNG": "a picture"}
_FOREIGN = {magic: f"{kind}, not a table of spectra; save them as CSV or ECSV" for magic, kind in _OTHERS.items()}
_FOREIGN |= {b"PK\x03\x04": "compressed (zip); unpack it first"}
_FITS_SUFFIXES = {".fits", ".fit", ".fts"}


def read_spectra(
    input: InputFile | str,
    *,
    wavelength_unit: WavelengthUnit | None = None,
    reflectance_unit: ReflectanceUnit | None = None,
    format: str | None = None,
) -> SpectrumRows:
    """Read every spectrum of a file: wavelengths in nm, ascending; reflectance as a fraction of 1.

    A file of a VNIS product stands for its observation, whose other files lie beside it; one of the two files of an
    ENVI library stands for both; the wavelengths of a USGS splib07 spectrum are looked for beside it and one folder up.

    Parameters
    ----------
    input : a file already read, or a path, or '-' for standard input.
    wavelength_unit, reflectance_unit : used where the file states no unit, or one that its values contradict.
    format : one of `lunarsci.registry.FORMATS`; told from content and suffix if left out.

    Raises
    ------
    DataError, one line with file, place and remedy, when the file cannot be used; ParameterError for an unknown unit
    or format. Whatever the reader should know about a result that stands is a LunarSciWarning; `metadata` records it.
    """
    _check("wavelength unit", wavelength_unit, get_args(WavelengthUnit))
    _check("reflectance unit", reflectance_unit, get_args(ReflectanceUnit))
    _check("format", format, tuple(FORMATS))
    source = read_input(input) if isinstance(input, str) else input
    if product_name(source.name) is not None:
        return SpectrumRows.of(_calibrated(source.name))
    if format is None and (label := label_of_table(source)) is not None:
        source = label
    table: SpectrumTable = _function(FORMATS[format or format_of(source)].read)(source)
    return spectra_of(table, StatedUnits(wavelength_unit, reflectance_unit))


def _calibrated(path: str) -> Spectrum:
    """A VNIS product is calibrated on the way, as `lunarsci spectra calibrate` does it without options.

    Raises DataError for one that is in doubt: only that command shows it.
    """
    result = calibrate(read_observation(path))
    if result.doubts:
        raise DataError(
            f"{path}: {result.doubts[0]}; look at it with `lunarsci spectra calibrate`, use its -o .ecsv if right"
        )
    return result.to_spectrum()


def _check(what: str, value: str | None, allowed: tuple[str, ...]) -> None:
    if value is not None and value not in allowed:
        raise ParameterError(f"{what} '{value}' is not known; use one of {', '.join(allowed)}")


def format_of(source: InputFile) -> str:
    """The format of a file, one of `lunarsci.registry.FORMATS`. Raises DataError for one that is no spectra at all."""
    start = ""
    # The reader decodes the text again and says what there is to say about it.
    with warnings.catch_warnings(), contextlib.suppress(DataError):
        warnings.simplefilter("ignore", LunarSciWarning)
        start = inputs.beginning(source).lstrip()
    if name := recognised(source, start):
        return name
    _refuse_others(source, start)
    if not start:
        inputs.beginning(source)  # says why this is no text
    return next(name for name, one in FORMATS.items() if not one.recognises)


def recognised(source: InputFile, start: str) -> str:
    """The first of `FORMATS` that files with such a beginning have; '' where it is none but text."""
    formats = ((name, one.recognises) for name, one in FORMATS.items() if one.recognises)
    return next((name for name, place in formats if _function(place)(source, start)), "")


def _refuse_others(source: InputFile, start: str) -> None:
    suffix = Path(source.name).suffix.lower()
    foreign = next((kind for magic, kind in _FOREIGN.items() if source.data.startswith(magic)), "")
    if foreign or suffix in _FITS_SUFFIXES:
        raise DataError(f"{source.name}: is {foreign or 'named FITS but does not begin with SIMPLE; fetch it again'}")
    if start.startswith("<"):
        raise DataError(f"{source.name}: is an HTML or XML page, not a table (an error page saved?); fetch it again")


@cache
def _function(place: str) -> Callable[..., Any]:
    module, _, name = place.partition(":")
    function: Callable[..., Any] = getattr(import_module(f"lunarsci.spectra.readers.{module}"), name)
    return function


_REMARKS = {
    "channels_unit_overruled": "values read in the reflectance unit that the file states, not in the one you stated",
    "channels_unit_unlikely": "values read in the reflectance unit you stated, which their size makes unlikely",
    "channels_deleted": "values that mark deleted channels (at or below -1e30), taken as missing",
    "channels_not_positive": "values not above 0, masked",
    "channels_without_uncertainty": "values whose uncertainty is missing or not above 0, masked",
    "uncertainties_unknown": "values with only missing or zero uncertainties, which are taken as unknown",
}


def spectra_of(table: SpectrumTable, stated: StatedUnits) -> SpectrumRows:
    """Check a table and make its spectra, in file order; everything noteworthy is a LunarSciWarning.

    Raises DataError when rows, units or values do not make sense, or a single spectrum has no usable channel.
    """
    file = table.source.name
    used, left_out = _rows_with_wavelength(table)
    used, deleted, notes = without_markers(used)
    used, deleted = only_spectra(used, deleted)
    used, converted = as_reflectance(used)
    used, relative = with_absolute_errors(used)
    try:
        values, record = wavelength_nm(used.wavelength, stated.wavelength, file)
    except DataError as error:
        raise error if is_wavelength(used.wavelength.name) else DataError(f"{error}; {RIGHT_TABLE}") from error
    used, values, spliced = joined(used, values)
    order, order_name = _ascending(values, used)
    units, sized = _units(used, values, stated.reflectance)
    lines = (*table.metadata.get("read_as", ()), *notes, *converted, *relative, *spliced, *sized)
    read_as = [f"{file}: {line}" for line in lines]
    for line in read_as:
        warn(line)
    if record["wavelength_unit_from"] == "values":
        read_as.insert(0, f"{file}: wavelengths read as {record['wavelength_unit']} by their range (`wavelength_unit`)")
    common = {
        "source": file,
        "sha256": table.source.sha256,
        "format": table.format,
        **record,
        "order": order_name,
        "rows_left_out": left_out,
        **table.metadata,
        **({"read_as": read_as} if read_as else {}),
    }
    result, counts = _assembled(used, values[order], order, units, common, deleted)
    _report(result, counts, file)
    return result


def _rows_with_wavelength(table: SpectrumTable) -> tuple[SpectrumTable, int]:
    """The table without rows that lack a wavelength, and how many these are. Raises DataError for too many."""
    file, wavelength = table.source.name, table.wavelength.values
    with np.errstate(invalid="ignore"):
        keep = np.isfinite(wavelength) & (wavelength > 0)
    bad = np.flatnonzero(~keep)
    if bad.size == 0 < wavelength.size:
        return table, 0
    first = f", first {table.places[bad[0]]}" if bad.size else ""
    what = f"rows without a wavelength above 0: {bad.size} of {keep.size}{first}"
    if bad.size > keep.size / 2 or not wavelength.size:
        raise DataError(f"{file}: {what}; check that column {table.wavelength.label} is the wavelength")
    warn(f"{file}: left out {what}")
    return table.taken(keep), bad.size


def _ascending(wavelength: FloatArray, table: SpectrumTable) -> tuple[Any, str]:
    """Order of the rows that makes wavelengths [nm] ascend, and its name. Raises DataError for duplicates."""
    file = table.source.name
    order = np.argsort(wavelength, kind="stable")
    same = np.flatnonzero(np.diff(wavelength[order]) == 0)
    if same.size:
        first, second = table.places[order[same[0]]], table.places[order[same[0] + 1]]
        value = wavelength[order[same[0]]]
        steps = np.sign(np.diff(wavelength))
        remedy = "keep one of them"
        if (steps > 0).any() and (steps < 0).any():
            remedy = f"{table.wavelength.label} is in no order: is it the wavelength? Name the one that is"
        raise DataError(f"{file}: {first} and {second} have the same wavelength, {value:.10g} nm; {remedy}")
    steps = np.diff(wavelength)
    if (steps > 0).all():
        return order, "ascending"
    if (steps < 0).all():
        return order, "descending"
    warn(f"{file}: wavelengths are in no order; the rows are sorted")
    return order, "unsorted"


@dataclass(frozen=True, slots=True)
class _About:
    """Makes the metadata of the spectrum in a row.

    Attributes
    ----------
    record : what is the same of all.
    names : of their columns, or the place of one without a name, from 1.
    units, which : ways in which columns were read, and the way of each row, a place among them, (n,).
    counts : by what is recorded, numbers of channels, (n,).
    """

    record: dict[str, Any]
    names: list[str | int]
    units: list[ReflectanceChoice]
    which: IntArray
    counts: dict[str, IntArray]

    def __call__(self, row: int) -> dict[str, Any]:
        unit = self.units[self.which[row]]
        unit_record = {
            "reflectance_unit": next(name for name, scale in SCALES.items() if scale == unit.scale),
            "reflectance_unit_from": unit.origin,
        }
        counts = {key: int(count[row]) for key, count in self.counts.items()}
        return {**self.record, "column": self.names[row], **unit_record, **counts}


def _assembled(
    table: SpectrumTable,
    wavelength: FloatArray,
    order: IntArray,
    ways: "_Ways",
    record: dict[str, Any],
    deleted: IntArray,
) -> tuple[SpectrumRows, dict[str, IntArray]]:
    """The spectra of a table, and the number of channels of each by what is recorded of them."""
    ids = spectrum_ids([column for column, _ in table.spectra], table.source)
    names = [column.name or column.position for column, _ in table.spectra]
    values = table.reflectances
    with np.errstate(invalid="ignore"):
        not_positive = (values <= 0).sum(axis=1)
    measured = np.isfinite(values).sum(axis=1)
    units, which, factors = ways
    scale, remarks = (np.array([getattr(unit, key) for unit in units])[which] for key in ("scale", "remark"))
    values *= scale[:, None]
    sigma, lacking, counts = _uncertainties(table, values > 0, factors)
    counts |= {
        "channels_unit_overruled": measured * (remarks == "overruled"),
        "channels_unit_unlikely": measured * (remarks == "unlikely"),
        "channels_missing": values.shape[1] - measured,
        "channels_deleted": deleted[:, 0],
        "channels_marked": deleted[:, 1],
        "channels_not_positive": not_positive,
    }
    with np.errstate(invalid="ignore"):
        mask = lacking | ~(values > 0)
    shifts = {k: {name: (c.values * scale[k])[order] for name, c in columns} for k, columns in table.systematic.items()}
    has_sigma = np.asarray(False if sigma is None else np.isfinite(sigma).any(axis=1))
    sigma = None if sigma is None else _sorted(sigma, order)
    result = SpectrumRows(
        ids,
        wavelength,
        _sorted(values, order),
        _sorted(mask, order),
        _About(record, names, units, which, counts),
        sigma,
        np.broadcast_to(has_sigma, len(ids)),
        shifts,
    )
    try:
        for row in {0, *shifts}:
            result[row]
    except DataError as error:
        raise DataError(f"{table.source.name}: {error}") from error
    return result, counts


_Ways: TypeAlias = tuple[list[ReflectanceChoice], IntArray, dict[int, float]]
"""Ways in which reflectances are read, which of them each is read in, and the factor of each uncertainty."""


def _units(table: SpectrumTable, wavelength: FloatArray, stated: ReflectanceUnit | None) -> tuple[_Ways, list[str]]:
    """How reflectances at wavelengths [nm] are read, and what to say of it."""
    columns, values, file = [column for column, _ in table.spectra], table.reflectances, table.source.name
    medians = medians_above_0(values)
    by_size, notes = (None, "") if stated else unit_by_size(columns, values, medians, wavelength)
    check_alike(columns, medians.tolist(), stated or by_size, file)
    units: dict[ReflectanceChoice, int] = {}
    which, factors = np.empty(len(columns), np.int64), {}
    for row, ((column, sigma), median) in enumerate(zip(table.spectra, medians.tolist(), strict=True)):
        unit = reflectance_unit(column, median, stated, file, by_size)
        which[row] = units.setdefault(unit, len(units))
        if sigma is not None:
            factors[row] = uncertainty_scale(sigma, column, unit.scale, file)
    return (list(units), which, factors), [notes] if notes else []


def _uncertainties(
    table: SpectrumTable, measured: BoolArray, factors: dict[int, float]
) -> tuple[FloatArray | None, BoolArray, dict[str, IntArray]]:
    """Uncertainties, NaN where unknown, the channels they rule out, (n, rows), and counts to record.

    Zeros mean unknown by convention in files of RELAB, of which nothing is said then.
    """
    nothing = np.zeros(len(measured), np.int64)
    if not factors:
        return (
            None,
            np.zeros_like(measured),
            {"channels_without_uncertainty": nothing, "uncertainties_unknown": nothing},
        )
    sigma, stated_rows = np.full(measured.shape, np.nan), np.array(sorted(factors))
    sigma[stated_rows] = [table.spectra[row][1].values for row in stated_rows]
    without_deleted(sigma)
    sigma[np.isin(sigma, markers_of(sigma))] = np.nan
    sigma[stated_rows] *= np.array([factors[row] for row in stated_rows])[:, None]
    with np.errstate(invalid="ignore"):
        lacking, negative = measured & ~(sigma > 0), (sigma < 0).any(axis=1)
    count, stated = lacking.sum(axis=1), np.isin(np.arange(len(measured)), stated_rows)
    unknown = count == measured.sum(axis=1)
    reported = stated & unknown & (negative | (table.format != "relab"))
    sigma[unknown], lacking[unknown | ~stated] = np.nan, False
    counts = {
        "channels_without_uncertainty": np.where(stated & ~unknown, count, 0),
        "uncertainties_unknown": np.where(reported, count, 0),
    }
    return sigma, lacking, counts


def _sorted(values: Any, order: IntArray) -> Any:
    """Columns in another order; the same array where they are in order."""
    return values if (np.diff(order) > 0).all() else values[:, order]


def _report(spectra: SpectrumRows, counts: dict[str, IntArray], file: str) -> None:
    """Warn of what was done to channels, by counts (n,), and of spectra without any. DataError for an only one."""
    for key, what in _REMARKS.items():
        touched = np.flatnonzero(counts[key])
        if touched.size:
            first = spectra.ids[touched[0]]
            where = f" in {touched.size} of {len(spectra)} spectra, first '{first}'" if len(spectra) > 1 else ""
            warn(f"{file}: {what}: {counts[key].sum()}{where}")
    unusable = [spectra.ids[row] for row in np.flatnonzero(spectra.mask.all(axis=1)).tolist()]
    if unusable and len(spectra) == 1:
        raise DataError(f"{file}: no reflectance above 0 in column {spectra.about(0)['column']!r}; check the file")
    if unusable:
        listed = ", ".join(f"'{i}'" for i in unusable[:5]) + (", ..." if len(unusable) > 5 else "")
        warn(f"{file}: {len(unusable)} of {len(spectra)} spectra have no usable channel: {listed}")
