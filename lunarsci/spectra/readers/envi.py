"""ENVI spectral libraries: a header of `key = value` lines (`.hdr`) beside a flat file of floats (`.sli`)."""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lunarsci import inputs
from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile, read_input
from lunarsci.spectra.readers.table import Column, SpectrumTable, length_unit
from lunarsci.spectra.rows import number, quoted

DATA_SUFFIXES = (".sli", ".slb")
_HEADER_SUFFIX = ".hdr"
_LIBRARY = "envi spectral library"
_TYPES = {"4": "f4", "5": "f8"}
_ORDERS = {"0": "<", "1": ">"}
_UNKNOWN_UNITS = {"", "unknown"}
_NOT_SPECTRA = re.compile(r"(wavelengths?|bandpass|resolution|fwhm)\b", re.IGNORECASE)
"""Records that the libraries of the USGS carry among their spectra."""
_MOST_VALUES = 1_000_000_000


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the header says: channels, spectra, the type of the values, the bytes before them, and what they are."""

    channels: int
    spectra: int
    dtype: np.dtype[np.floating]
    offset: int
    wavelength: FloatArray
    unit: str | None
    names: tuple[str, ...]
    scale: float | None
    ignored: float | None
    bad: FloatArray | None


def looks_like_envi(source: InputFile) -> bool:
    """Whether a file is one of the two of an ENVI library: by its suffix, or as a header by its first line."""
    return Path(source.name).suffix.lower() in DATA_SUFFIXES or source.data[:16].split(b"\n")[0].strip() == b"ENVI"


def without_headers(names: Sequence[str]) -> list[str]:
    """File names less the headers whose data file is among them."""
    data = {name for name in names if Path(name).suffix.lower() in DATA_SUFFIXES}
    taken = {candidate for name in data for candidate in _header_names(name)}
    return [name for name in names if name not in taken]


def read_envi(source: InputFile) -> SpectrumTable:
    """Read an ENVI spectral library from its data file or its header; the other one lies beside it.

    Raises DataError when one of them is missing, the header is no spectral library's or contradicts itself, or the
    data file has another size than the header says.
    """
    if source.data[:16].split(b"\n")[0].strip() == b"ENVI":
        header, data = source, _partner(source.name, _data_names(source.name), "data file (.sli)")
    else:
        header, data = _partner(source.name, _header_names(source.name), "header (.hdr)"), source
    layout = _layout(_fields(header), header.name)
    values = _values(data, layout, header.name)
    wavelength = Column("wavelength", layout.wavelength, 1, layout.unit)
    kept = [k for k, name in enumerate(layout.names) if not _NOT_SPECTRA.match(name)]
    if not kept:
        raise DataError(f"{header.name}: all {layout.spectra} records are wavelengths or widths; it has no spectra")
    if len(kept) < layout.spectra:
        message = f"{header.name}: left out {layout.spectra - len(kept)} records that are wavelengths or widths"
        warnings.warn(message, LunarSciWarning, stacklevel=2)
    unit = "fraction" if layout.scale is not None else None
    columns = [Column(layout.names[k], values[k], k + 1, unit) for k in kept]
    return SpectrumTable(
        source,
        "envi",
        wavelength,
        tuple((column, None) for column in columns),
        tuple(f"channel {k + 1}" for k in range(layout.channels)),
        {"inputs": {header.name: header.sha256, data.name: data.sha256}},
    )


def _header_names(data: str) -> list[str]:
    """Where the header of a data file may lie: x.sli.hdr, x.hdr, in either case."""
    plain = str(Path(data).with_suffix(""))
    return [stem + suffix for stem in (data, plain) for suffix in (_HEADER_SUFFIX, _HEADER_SUFFIX.upper())]


def _data_names(header: str) -> list[str]:
    """Where the data file of a header may lie: x.sli or x beside x.hdr, x.sli beside x.sli.hdr."""
    plain = str(Path(header).with_suffix(""))
    return [*(plain + suffix for low in DATA_SUFFIXES for suffix in (low, low.upper())), plain]


def _partner(name: str, candidates: Sequence[str], what: str) -> InputFile:
    if name == "<stdin>":
        raise DataError(f"{name}: an ENVI library is two files, .sli and .hdr; give the name of one of them")
    found = next((candidate for candidate in candidates if Path(candidate).is_file()), None)
    if found is None:
        looked = " or ".join(dict.fromkeys(Path(candidate).name.lower() for candidate in candidates))
        raise DataError(f"{name}: its {what} is missing; put {looked} beside it")
    return read_input(found)


def _fields(header: InputFile) -> dict[str, str]:
    """Key to value, keys in lower case, braces and line breaks removed."""
    lines = inputs.text(header).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if lines[0].strip() != "ENVI":
        raise DataError(f"{header.name}: is no ENVI header: its first line is not 'ENVI'; fetch it again")
    fields: dict[str, str] = {}
    open_key, open_line, parts = "", 0, list[str]()
    for n, line in enumerate(lines[1:], 2):
        if open_key:
            parts.append(line)
        elif "=" in line and not line.lstrip().startswith(";"):
            key, _, value = line.partition("=")
            key, value = " ".join(key.split()).lower(), value.strip()
            if not value.startswith("{"):
                fields[key] = value
                continue
            open_key, open_line, parts = key, n, [value[1:]]
        if open_key and "}" in parts[-1]:
            parts[-1] = parts[-1].partition("}")[0]
            fields[open_key], open_key = " ".join(parts), ""
    if open_key:
        what = f"{header.name}: line {open_line}: the braces of '{open_key[:40]}' are never closed"
        raise DataError(f"{what} (truncated download?); fetch the file again")
    return fields


def _layout(fields: Mapping[str, str], file: str) -> _Layout:
    kind = fields.get("file type", "")
    if " ".join(kind.split()).lower() != _LIBRARY:
        is_what = quoted(kind) if kind else "of no file type"
        raise DataError(f"{file}: is an ENVI header {is_what}, not of an 'ENVI Spectral Library'; give a library")
    channels, spectra = _whole(fields, "samples", file), _whole(fields, "lines", file)
    if _whole(fields, "bands", file, "1") != 1:
        raise DataError(f"{file}: has bands = {fields['bands']}; a spectral library has 1")
    if channels < 1 or spectra < 1 or channels * spectra > _MOST_VALUES:
        raise DataError(f"{file}: samples = {channels} and lines = {spectra} are no possible library; check the header")
    wavelength = _numbers(fields, "wavelength", channels, file)
    if wavelength is None:
        raise DataError(f"{file}: has no 'wavelength'; a library needs one for each of its {channels} samples")
    scale = _number(fields, "reflectance scale factor", file)
    if scale is not None and not 0 < scale < np.inf:
        raise DataError(f"{file}: 'reflectance scale factor' is {scale:g}; it must be above 0")
    return _Layout(
        channels, spectra, _dtype(fields, file), _whole(fields, "header offset", file, "0"), wavelength,
        _unit(fields, file), _names(fields, spectra, file), scale, _number(fields, "data ignore value", file),
        _numbers(fields, "bbl", channels, file),
    )  # fmt: skip


def _names(fields: Mapping[str, str], spectra: int, file: str) -> tuple[str, ...]:
    """Names of the spectra, empty where the header has none; a single one may hold commas."""
    text = " ".join(fields.get("spectra names", "").split())
    names = [name.strip() for name in text.split(",")] if spectra > 1 else [text]
    if not any(names):
        return ("",) * spectra
    names = names[:-1] if len(names) == spectra + 1 and not names[-1] else names
    _count(names, spectra, "spectra names", "lines", file)
    return tuple(names)


def _whole(fields: Mapping[str, str], key: str, file: str, default: str | None = None) -> int:
    text = fields.get(key, default)
    if text is None:
        raise DataError(f"{file}: has no '{key}'; complete the header or fetch it again")
    if not re.fullmatch(r"[0-9]{1,12}", text):
        raise DataError(f"{file}: '{key}' is {quoted(text)}, no whole number; correct the header")
    return int(text)


def _number(fields: Mapping[str, str], key: str, file: str) -> float | None:
    text = fields.get(key)
    if text is None:
        return None
    value = number(text)
    if value is None:
        raise DataError(f"{file}: '{key}' is {quoted(text)}, no number; correct the header")
    return value


def _numbers(fields: Mapping[str, str], key: str, count: int, file: str) -> FloatArray | None:
    if key not in fields:
        return None
    cells = [cell.strip() for cell in fields[key].split(",")]
    cells = cells[:-1] if cells and not cells[-1] else cells
    values = [number(cell) for cell in cells]
    wrong = next((cell for cell, value in zip(cells, values, strict=True) if value is None), None)
    if wrong is not None:
        raise DataError(f"{file}: {quoted(wrong)} in '{key}' is no number; correct the header")
    _count(values, count, key, "samples", file)
    return np.array(values, dtype=float)


def _count(found: Sequence[object], wanted: int, what: str, of: str, file: str) -> None:
    if len(found) != wanted:
        why = " (a comma in a name?)" if what == "spectra names" else ""
        raise DataError(f"{file}: {len(found)} '{what}' for {of} = {wanted}{why}; correct the header")


def _dtype(fields: Mapping[str, str], file: str) -> "np.dtype[np.floating]":
    kind, order = fields.get("data type", ""), fields.get("byte order", "0")
    if kind not in _TYPES:
        raise DataError(f"{file}: 'data type' is {quoted(kind)}; a library holds floats, 4 (32 bit) or 5 (64 bit)")
    if order not in _ORDERS:
        raise DataError(f"{file}: 'byte order' is {quoted(order)}; it must be 0 (little-endian) or 1 (big-endian)")
    return np.dtype(_ORDERS[order] + _TYPES[kind])


def _unit(fields: Mapping[str, str], file: str) -> str | None:
    text = fields.get("wavelength units", "").strip()
    unit = length_unit(text)
    if unit is None and text.lower() not in _UNKNOWN_UNITS:
        raise DataError(f"{file}: 'wavelength units' is {quoted(text)}; convert to Nanometers or Micrometers")
    return unit


def _values(data: InputFile, layout: _Layout, header: str) -> FloatArray:
    """Reflectance of every record, shape (spectra, channels), NaN where the header says that there is none."""
    wanted = layout.offset + layout.channels * layout.spectra * layout.dtype.itemsize
    if len(data.data) != wanted:
        raise DataError(
            f"{data.name}: has {len(data.data)} bytes, {Path(header).name} announces {wanted} "
            f"({layout.spectra} spectra of {layout.channels} channels); fetch both files again"
        )
    raw = np.frombuffer(data.data, layout.dtype, offset=layout.offset)
    values = raw.reshape(layout.spectra, layout.channels).astype(float)
    if layout.ignored is not None:
        values[values == np.dtype(layout.dtype).type(layout.ignored)] = np.nan
    if layout.bad is not None:
        values[:, layout.bad == 0] = np.nan
    # A deleted channel, -1.23e34, must stay recognisable: no scale factor is that large.
    return values if layout.scale is None else np.where(values < -1e30, values, values / layout.scale)
