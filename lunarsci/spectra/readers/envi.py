"""ENVI spectral libraries, and headers of ENVI files: `key = value` lines that say how the file beside is laid out.

`spectral` reads them too, but leaves values that the header ignores as they are, scaled, and stops with an error of
Python at a file of another size; GDAL reads no libraries, and is an extra (`docs/validation/files.md`). The numbers
are read by numpy.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.spectra.readers.table import (
    MAX_PERCENT,
    USUAL_SCALE,
    Column,
    SpectrumTable,
    length_unit,
    name_tokens,
    spectral_unit,
)
from lunarsci.spectra.rows import number, quoted

SUFFIX = ".hdr"
NUMBERS = {"1": "u1", "2": "i2", "3": "i4", "4": "f4", "5": "f8", "12": "u2", "13": "u4", "14": "i8", "15": "u8"}
"""Codes of `data type`, as NV5's manual of ENVI header files lists them, without the complex ones (6 and 9)."""
_ORDERS = {"0": "<", "1": ">"}
_UNKNOWN_UNITS = {"", "unknown", "unspecified", "none", "index", "n/a"}
"""What headers have in place of a unit; SPy writes `<unspecified>`."""


@dataclass(frozen=True, slots=True)
class EnviHeader:
    """Keys, in lower case, and values, without braces and line breaks, of the header `file`."""

    file: str
    fields: Mapping[str, str] = field(repr=False)

    @classmethod
    def of(cls, header: InputFile) -> "EnviHeader":
        """Raises DataError for what is no header, or whose braces are never closed."""
        return cls(header.name, _fields(header))

    def whole(self, key: str, default: str | None = None) -> int:
        """A whole number. Raises DataError where it is none, or missing without a default."""
        text = self.fields.get(key, default)
        if text is None or not re.fullmatch(r"[0-9]{1,12}", text):
            what = "missing" if text is None else f"{quoted(text)}, no whole number"
            raise DataError(f"{self.file}: '{key}' is {what}; correct the header or fetch it again")
        return int(text)

    def number(self, key: str) -> float | None:
        """A number, None where there is no such key. Raises DataError for another text."""
        result = self.numbers(key, 1, "one")
        return None if result is None else float(result[0])

    def numbers(self, key: str, count: int, of: str) -> FloatArray | None:
        """As many numbers as `of` says, (count,), None where there is no such key. Raises DataError for others."""
        cells = self.cells(key) if key in self.fields else []
        values = [number(cell) for cell in cells]
        if key in self.fields and (None in values or len(values) != count):
            odd = f"{quoted(cells[values.index(None)])} in '{key}' is no number" if None in values else ""
            what = odd or f"{len(cells)} '{key}' for {of} = {count}"
            raise DataError(f"{self.file}: {what}; correct the header")
        return np.array(values, dtype=float) if key in self.fields else None

    def cells(self, key: str) -> list[str]:
        """What commas part; one at the end parts nothing."""
        cells = [cell.strip() for cell in self.fields[key].split(",")]
        return cells[:-1] if cells and not cells[-1] else cells

    def dtype(self) -> np.dtype[np.generic]:
        """Type and byte order of the numbers. Raises DataError for others than `NUMBERS`."""
        kind, order = self.fields.get("data type", ""), self.fields.get("byte order", "0")
        if kind not in NUMBERS or order not in _ORDERS:
            rule = f"real numbers are {', '.join(NUMBERS)}, the order is 0 (little-endian) or 1 (big-endian)"
            raise DataError(f"{self.file}: 'data type' is {quoted(kind)} and 'byte order' {quoted(order)}; {rule}")
        return np.dtype(_ORDERS[order] + NUMBERS[kind])

    def wavelength_unit(self) -> str | None:
        """Unit of the wavelengths, None where the header has none. Raises DataError for another that is not read."""
        text = self.fields.get("wavelength units", "").strip().strip("<>")
        unit = length_unit(text) or spectral_unit(name_tokens(text))
        if unit is None and text.lower() not in _UNKNOWN_UNITS:
            raise DataError(f"{self.file}: 'wavelength units' is {quoted(text)}; convert to Nanometers or Micrometers")
        return unit

    def scale(self) -> float | None:
        """What values are divided by to be reflectances, None where the header has none. Raises DataError below 0."""
        scale = self.number("reflectance scale factor")
        if scale is not None and not 0 < scale < np.inf:
            raise DataError(f"{self.file}: 'reflectance scale factor' is {scale:g}; it must be above 0")
        return scale


def is_header(source: InputFile) -> bool:
    """Whether the first line is that of an ENVI header."""
    return source.data[:16].split(b"\n")[0].strip() == b"ENVI"


def header_names(data: str) -> list[str]:
    """Where the header of a data file may lie: x.sli.hdr, x.hdr, in either case."""
    plain = str(Path(data).with_suffix(""))
    return [stem + suffix for stem in (data, plain) for suffix in (SUFFIX, SUFFIX.upper())]


def data_names(header: str, suffixes: Sequence[str]) -> list[str]:
    """Where the data file of a header may lie: x.sli or x beside x.hdr, x.sli beside x.sli.hdr."""
    plain = str(Path(header).with_suffix(""))
    return [*(plain + suffix for low in suffixes for suffix in (low, low.upper())), plain]


def partner(name: str, candidates: Sequence[str], what: str) -> str:
    """The first candidate that is a file. Raises DataError where none is."""
    result = next((candidate for candidate in candidates if Path(candidate).is_file()), None)
    if result is None and name == "<stdin>":
        raise DataError(f"{name}: is one of two files, data and header (.hdr); give the name of one of them")
    if result is None:
        looked = " or ".join(dict.fromkeys(Path(candidate).name.lower() for candidate in candidates))
        raise DataError(f"{name}: its {what} is missing; put {looked} beside it")
    return result


def _fields(header: InputFile) -> dict[str, str]:
    """Key to value, keys in lower case, braces and line breaks removed."""
    lines = inputs.text(header).replace("\r\n", "\n").replace("\r", "\n").split("\n")
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
    if open_key or lines[0].strip() != "ENVI":
        what = f"line {open_line}: the braces of '{open_key[:40]}' are never closed (truncated download?)"
        what = what if open_key else "is no ENVI header: its first line is not 'ENVI'"
        raise DataError(f"{header.name}: {what}; fetch it again")
    return fields


DATA_SUFFIXES = (".sli", ".slb")
_LIBRARY = "envi spectral library"
_NOT_SPECTRA = re.compile(r"(wavelengths?|bandpass|resolution|fwhm)\b", re.IGNORECASE)
"""Records that the libraries of the USGS carry among their spectra."""
_MOST_VALUES = 1_000_000_000


def is_envi(source: InputFile, start: str) -> bool:
    """Whether a file is one of the two of an ENVI library: by its suffix, or as a header by its first line."""
    return Path(source.name).suffix.lower() in DATA_SUFFIXES or is_header(source)


def without_headers(names: Sequence[str]) -> list[str]:
    """File names less the headers whose data file is among them."""
    data = {name for name in names if Path(name).suffix.lower() in DATA_SUFFIXES}
    taken = {candidate for name in data for candidate in header_names(name)}
    return [name for name in names if name not in taken]


def read_envi(source: InputFile) -> SpectrumTable:
    """Read an ENVI spectral library from its data file or its header; the other one lies beside it.

    Raises DataError when one of them is missing, the header is no spectral library's or contradicts itself, or the
    data file has another size than the header says.
    """
    if is_header(source):
        header, data = (
            source,
            read_input(partner(source.name, data_names(source.name, DATA_SUFFIXES), "data file (.sli)")),
        )
    else:
        header, data = read_input(partner(source.name, header_names(source.name), "header (.hdr)")), source
    head = EnviHeader.of(header)
    channels, spectra = _size(head)
    names, scale = _names(head, spectra), head.scale()
    wavelength = head.numbers("wavelength", channels, "samples")
    retained = [k for k, name in enumerate(names) if not _NOT_SPECTRA.match(name)]
    if wavelength is None or not retained:
        what = f"{spectra} records that are wavelengths or widths" if wavelength is not None else "no 'wavelength'"
        raise DataError(f"{header.name}: has {what}; a library has spectra, and a wavelength for each of its samples")
    values = _values(data, head, (spectra, channels))
    whole = values.dtype.kind in "iu"
    values = _reflectances(values, head, channels)
    if len(retained) < spectra:
        warn(f"{header.name}: left out {spectra - len(retained)} records that are wavelengths or widths")
    unit, notes = "fraction" if scale is not None else None, list[str]()
    if scale is None and whole and np.nanmax(np.abs(values[retained]), initial=0) > MAX_PERCENT:
        unit, values = "fraction", values / USUAL_SCALE
        notes.append(f"whole numbers without a scale read as reflectance times {USUAL_SCALE:g}; give the header "
                    "'reflectance scale factor' for another")  # fmt: skip
    values = values if len(retained) == spectra else values[retained]
    columns = [Column(names[k], row, k + 1, unit) for k, row in zip(retained, values, strict=True)]
    return SpectrumTable(
        source,
        "envi",
        Column("wavelength", wavelength, 1, head.wavelength_unit()),
        tuple((column, None) for column in columns),
        tuple(f"channel {k + 1}" for k in range(channels)),
        {"inputs": {header.name: header.sha256, data.name: data.sha256}, **({"read_as": notes} if notes else {})},
        block=values,
    )


def _size(header: EnviHeader) -> tuple[int, int]:
    """Channels and spectra. Raises DataError for a header of no library."""
    kind = header.fields.get("file type", "")
    channels, spectra, bands = header.whole("samples"), header.whole("lines"), header.whole("bands", "1")
    is_library = " ".join(kind.split()).lower() == _LIBRARY
    if not is_library or bands != 1 or not 0 < channels * spectra <= _MOST_VALUES:
        what = f"samples = {channels}, lines = {spectra} and bands = {bands} are no possible library; check the header"
        if not is_library:
            named = quoted(kind) if kind else "of no file type"
            remedy = "give a library; of an image, `lunarsci spectra map` makes maps and takes spectra out"
            what = f"is an ENVI header {named}, not of an 'ENVI Spectral Library'; {remedy}"
        raise DataError(f"{header.file}: {what}")
    return channels, spectra


def _names(header: EnviHeader, spectra: int) -> tuple[str, ...]:
    """Names of the spectra, empty where the header has none; a single one may hold commas."""
    text = " ".join(header.fields.get("spectra names", "").split())
    names = [name.strip() for name in text.split(",")] if spectra > 1 else [text]
    if not any(names):
        return ("",) * spectra
    names = names[:-1] if len(names) == spectra + 1 and not names[-1] else names
    if len(names) != spectra:
        what = f"{len(names)} 'spectra names' for lines = {spectra} (a comma in a name?)"
        raise DataError(f"{header.file}: {what}; correct the header")
    return tuple(names)


def _values(data: InputFile, header: EnviHeader, shape: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Numbers of every record as they are stored, (spectra, channels)."""
    dtype = header.dtype()
    offset = header.whole("header offset", "0")
    wanted = offset + shape[0] * shape[1] * dtype.itemsize
    if len(data.data) != wanted:
        raise DataError(
            f"{data.name}: has {len(data.data)} bytes, {Path(header.file).name} announces {wanted} "
            f"({shape[0]} spectra of {shape[1]} channels); fetch both files again"
        )
    return np.frombuffer(data.data, dtype, offset=offset).reshape(shape)


def _reflectances(stored: np.ndarray[Any, Any], header: EnviHeader, channels: int) -> FloatArray:
    """The numbers, scaled, NaN where the header says that there is none."""
    values = stored.astype(float)
    if (ignored := header.number("data ignore value")) is not None:
        values[stored == stored.dtype.type(ignored)] = np.nan
    if (good := header.numbers("bbl", channels, "samples")) is not None:
        values[:, good == 0] = np.nan
    scale = header.scale()
    # A deleted channel, -1.23e34, must stay recognisable: no scale factor is that large.
    return values if scale is None else np.where(values < -1e30, values, values / scale)
