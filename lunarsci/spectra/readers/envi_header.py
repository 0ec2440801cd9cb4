"""Headers of ENVI files: `key = value` lines that say how the flat file beside them is laid out.

`spectral` reads them too, but leaves values that the header ignores as they are, scaled, and stops with an error of
Python at a file of another size; GDAL reads no libraries (`docs/validation/files.md`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.table import length_unit, name_tokens, spectral_unit
from lunarsci.spectra.rows import number, quoted

SUFFIX = ".hdr"
FLOATS = {"4": "f4", "5": "f8"}
NUMBERS = {"1": "u1", "2": "i2", "3": "i4", **FLOATS, "12": "u2", "13": "u4", "14": "i8", "15": "u8"}
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
        if text is None:
            raise DataError(f"{self.file}: has no '{key}'; complete the header or fetch it again")
        if not re.fullmatch(r"[0-9]{1,12}", text):
            raise DataError(f"{self.file}: '{key}' is {quoted(text)}, no whole number; correct the header")
        return int(text)

    def number(self, key: str) -> float | None:
        """A number, None where there is no such key. Raises DataError for another text."""
        text = self.fields.get(key)
        if text is None:
            return None
        value = number(text)
        if value is None:
            raise DataError(f"{self.file}: '{key}' is {quoted(text)}, no number; correct the header")
        return value

    def numbers(self, key: str, count: int, of: str) -> FloatArray | None:
        """As many numbers as `of` says, (count,), None where there is no such key. Raises DataError for others."""
        if key not in self.fields:
            return None
        cells = self.cells(key)
        values = [number(cell) for cell in cells]
        wrong = next((cell for cell, value in zip(cells, values, strict=True) if value is None), None)
        if wrong is not None:
            raise DataError(f"{self.file}: {quoted(wrong)} in '{key}' is no number; correct the header")
        self.count(values, count, key, of)
        return np.array(values, dtype=float)

    def cells(self, key: str) -> list[str]:
        """What commas part; one at the end parts nothing."""
        cells = [cell.strip() for cell in self.fields[key].split(",")]
        return cells[:-1] if cells and not cells[-1] else cells

    def count(self, found: Sequence[object], wanted: int, what: str, of: str) -> None:
        """Raises DataError where there are more or fewer of something than the header says elsewhere."""
        if len(found) != wanted:
            why = " (a comma in a name?)" if what == "spectra names" else ""
            raise DataError(f"{self.file}: {len(found)} '{what}' for {of} = {wanted}{why}; correct the header")

    def dtype(self, types: Mapping[str, str], remedy: str) -> np.dtype[np.generic]:
        """Type and byte order of the numbers, one of `types`. Raises DataError for another."""
        kind, order = self.fields.get("data type", ""), self.fields.get("byte order", "0")
        if kind not in types:
            raise DataError(f"{self.file}: 'data type' is {quoted(kind)}; {remedy}")
        if order not in _ORDERS:
            raise DataError(
                f"{self.file}: 'byte order' is {quoted(order)}; it must be 0 (little-endian) or 1 (big-endian)"
            )
        return np.dtype(_ORDERS[order] + types[kind])

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
    found = next((candidate for candidate in candidates if Path(candidate).is_file()), None)
    if found is None:
        looked = " or ".join(dict.fromkeys(Path(candidate).name.lower() for candidate in candidates))
        raise DataError(f"{name}: its {what} is missing; put {looked} beside it")
    return found


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
