"""Spectra in tables that a label of the Planetary Data System describes, as those of RELAB and CRISM.

Why no library does it is said in `pds_label`; numpy reads tables of bytes, and text is split at the label's places.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.spectra.readers.astropy_tables import spectrum_table
from lunarsci.spectra.readers.columns import is_wavelength
from lunarsci.spectra.readers.pds_label import LabelField, TableObject, data_file, read_pds_label
from lunarsci.spectra.readers.table import SpectrumTable, length_unit
from lunarsci.spectra.rows import number

_RADIANCE = ("W/", "W /", "RADIANCE", "MICROWATT", "WATT", "uW", "µW", "DN")
_NO_UNIT = ("N/A", "NONE", "UNITLESS", "I/F", "I_OVER_F", "DIMENSIONLESS", "UNK", "")
"""What labels have where no unit is named."""


def read_pds(source: InputFile) -> SpectrumTable:
    """The spectra of a label's first table with a wavelength by name or unit, else with two columns of numbers.

    Raises DataError where there is none, and for a label of an image.
    """
    label = read_pds_label(source)
    spectral = [one for one in label.tables if any(_is_spectral(column) for column in one.fields)]
    if not spectral and label.images:
        image = max(label.images, key=lambda one: (radiance(one.unit), one.bands))
        what = f"an image of {image.lines} lines, {image.samples} samples and {image.bands} bands"
        unit = f" in {image.unit}: radiance, no reflectance" if radiance(image.unit) else ""
        raise DataError(f"{source.name}: is the label of {what}{unit}; `lunarsci spectra map` takes images of spectra")
    for table in spectral or label.tables:
        data = read_input(data_file(source.name, table.file))
        found = _columns(data, table)
        if sum(np.asarray(column).dtype.kind == "f" for column in found.values()) > 1:
            read = spectrum_table(_as_table(found, table), source, "pds")
            about = {**read.metadata, "inputs": {source.name: source.sha256, data.name: data.sha256}}
            return replace(read, metadata=about)
    raise DataError(f"{source.name}: no table with two columns of numbers; give the label of spectra")


def _is_spectral(column: LabelField) -> bool:
    return is_wavelength(column.name) or length_unit(_unit(column)) is not None


def _unit(column: LabelField) -> str:
    """As PDS3 writes it: NANOMETER <nm>."""
    return column.unit.split("<")[0].strip()


def radiance(unit: str) -> bool:
    """Whether a unit says radiance or numbers of a detector."""
    return any(word.lower() in unit.lower() for word in _RADIANCE)


def _columns(data: InputFile, table: TableObject) -> dict[str, Any]:
    """By name, numbers of each field with NaN for what is marked, or its text."""
    if any(one.dtype for one in table.fields):
        return _binary(data, table)
    if table.delimiter:
        lines = text(InputFile(data.name, data.data[table.offset :])).splitlines()[: table.rows or None]
        rows = [line.split(table.delimiter) for line in lines if line.strip()]
    else:
        size = table.row_bytes
        lines = _records(data, table)
        rows = [[line[one.start : one.start + one.length] for one in table.fields] for line in lines]
        if table.rows and size and len(rows) != table.rows:
            raise DataError(f"{data.name}: {len(rows)} rows, its label says {table.rows} (truncated?); fetch it again")
    found: dict[str, Any] = {}
    for k, one in enumerate(table.fields):
        cells = [row[k].strip().strip('"') if k < len(row) else "" for row in rows]
        values = [number(cell) for cell in cells]
        name = one.name if one.name not in found else f"{one.name}_{k + 1}"
        found[name] = cells if None in values else _unmarked(np.array(values, dtype=float), one.missing)
    return found


def _records(data: InputFile, table: TableObject) -> list[str]:
    """Lines of a table of fixed columns; where its bytes hold line ends elsewhere than the label says, as they are."""
    body = text(InputFile(data.name, data.data[table.offset :]))
    lines = [line for line in body.splitlines() if line.strip()]
    width = max(one.start + one.length for one in table.fields)
    if len(lines) == 1 and table.row_bytes >= width:
        lines = [body[k : k + table.row_bytes] for k in range(0, len(body), table.row_bytes)]
    return lines[: table.rows or None]


def _binary(data: InputFile, table: TableObject) -> dict[str, Any]:
    formats = [np.dtype(one.dtype or f"S{max(one.length, 1)}") for one in table.fields]
    ends = [one.start + kind.itemsize for one, kind in zip(table.fields, formats, strict=True)]
    if min(one.start for one in table.fields) < 0 or max(ends) > table.row_bytes:
        raise DataError(f"{data.name}: its label has fields beyond rows of {table.row_bytes} bytes; fetch it again")
    if len(data.data) < table.offset + table.rows * table.row_bytes or not table.rows:
        raise DataError(f"{data.name}: {len(data.data)} bytes, its label says more (truncated?); fetch it again")
    names = [f"f{k}" for k in range(len(formats))]
    layout: Any = {"names": names, "formats": formats, "offsets": [one.start for one in table.fields]}
    layout["itemsize"] = table.row_bytes
    values: Any = np.frombuffer(data.data, np.dtype(layout), table.rows, table.offset)
    return {
        one.name: _unmarked(values[key].astype(float), one.missing)
        if one.dtype
        else [cell.decode("latin-1") for cell in values[key].tolist()]
        for key, one in zip(names, table.fields, strict=True)
    }


def _unmarked(values: Any, missing: tuple[float, ...]) -> Any:
    values[np.isin(values, missing)] = np.nan
    return values


def _as_table(columns: dict[str, Any], table: TableObject) -> Any:
    from astropy.table import Table

    found = Table(columns)
    for name, one in zip(found.colnames, table.fields, strict=True):
        if np.asarray(found[name]).dtype.kind == "f" and _unit(one).upper() not in _NO_UNIT:
            found[name].unit = _unit(one)
    return found
