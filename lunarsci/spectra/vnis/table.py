"""The tables of VNIS: short-wave radiances (300 rows), and the auxiliary rows of the image cube (100 bands)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from lunarsci import inputs
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.spectrum import BoolArray, FloatArray
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM
from lunarsci.spectra.vnis.label import Label

__all__ = ["SwirTable", "read_swir_table", "read_vnir_flags"]

_SWIR_COLUMNS = ("time", "band", "integration time", "solar elevation", "radiance", "quality")
_VNIR_COLUMNS = ("time", "band", "integration time", "solar elevation", "quality")
_CLOCK_SLACK = timedelta(minutes=10)
"""The first row of a scan may precede the time its label states; assumed."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d{1,3})?", re.ASCII)
_NO_NUMBER = {"NAN", "+NAN", "-NAN", "INF", "+INF", "-INF"}
_CODE = re.compile(r"(0[xX])?[0-9a-fA-F]{1,8}", re.ASCII)


@dataclass(frozen=True, slots=True)
class SwirTable:
    """Radiance of the 300 short-wave channels, as the file has it, NaN where it has no number; [W m-2 sr-1 nm-1].

    `flagged` is True where the quality code is not zero.
    """

    radiance: FloatArray
    flagged: BoolArray


def read_swir_table(source: InputFile, label: Label) -> SwirTable:
    """Read the table of an SD product: six columns between blanks, one row per channel, wavelengths ascending.

    Raises DataError, with the line, for other counts, repeated or missing channels, or times outside the label's.
    """
    rows = _rows(source, SWIR_NM.size, _SWIR_COLUMNS)
    stated = [file.records for file in label.files if file.fields]
    if stated and stated[0] not in (None, SWIR_NM.size):
        raise DataError(f"{label.file}: states {stated[0]} rows, the table has {SWIR_NM.size}; fetch it again")
    _check_times(rows, source.name, label)
    radiance = np.array([_radiance(row[4], line, source.name) for line, row in enumerate(rows, 1)])
    return SwirTable(radiance, _flags(rows, source.name))


def read_vnir_flags(source: InputFile, label: Label) -> BoolArray:
    """True for the bands of the cube whose quality code is not zero, from its AUX table; shape (100,).

    Raises DataError as `read_swir_table` does.
    """
    rows = _rows(source, VNIR_NM.size, _VNIR_COLUMNS)
    _check_times(rows, source.name, label)
    return _flags(rows, source.name)


def _rows(source: InputFile, count: int, columns: Sequence[str]) -> list[list[str]]:
    lines = [line for line in inputs.text(source).splitlines() if line.strip()]
    rows = [line.split() for line in lines]
    for number, row in enumerate(rows, 1):
        if len(row) != len(columns):
            what = f"{len(row)} columns, expected {len(columns)} ({', '.join(columns)})"
            end = "; truncated? fetch it again" if number == len(rows) else "; correct it or fetch it again"
            raise DataError(f"{source.name}: row {number} has {what}{end}")
    if len(rows) != count:
        raise DataError(f"{source.name}: {len(rows)} rows, one per channel makes {count}; truncated? fetch it again")
    _check_channels([_index(row[1], number, source.name) for number, row in enumerate(rows, 1)], source.name)
    return rows


def _check_channels(found: list[int], file: str) -> None:
    """The identifiers count up by one, from 0 as the labels say; a table that counts from 1 is taken too."""
    expected = range(found[0], found[0] + len(found))
    if found[0] not in (0, 1) or found != list(expected):
        first = next((k for k, (a, b) in enumerate(zip(found, expected, strict=True), 1) if a != b), 1)
        raise DataError(f"{file}: row {first} has the channel {found[first - 1]} out of order; fetch it again")


def _index(text: str, line: int, file: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise DataError(f"{file}: row {line}: the channel {text[:20]!r} is no number; correct it or fetch it again")
    return int(text)


def _radiance(text: str, line: int, file: str) -> float:
    if text.upper() in _NO_NUMBER:
        return float("nan")
    if not _NUMBER.fullmatch(text):
        raise DataError(f"{file}: row {line}: the radiance {text[:20]!r} is no number; fetch it again")
    value = float(text.upper().replace("D", "E"))
    return value if np.isfinite(value) else float("nan")


def _flags(rows: Sequence[Sequence[str]], file: str) -> BoolArray:
    codes: list[int] = []
    for line, row in enumerate(rows, 1):
        if not _CODE.fullmatch(row[-1]):
            what = f"the quality code {row[-1][:20]!r} is not hexadecimal"
            raise DataError(f"{file}: row {line}: {what}; correct it or fetch it again")
        codes.append(int(row[-1], 16))
    flagged: BoolArray = np.array(codes) != 0
    return flagged


def _check_times(rows: Sequence[Sequence[str]], file: str, label: Label) -> None:
    for line, row in enumerate(rows, 1):
        try:
            moment = datetime.fromisoformat(row[0] if row[0][-1:] in "Zz" else row[0] + "Z")
        except ValueError as error:
            raise DataError(f"{file}: row {line}: {row[0][:40]!r} is no time; correct it or fetch it again") from error
        if not label.start - _CLOCK_SLACK <= moment <= label.stop + _CLOCK_SLACK:
            raise DataError(
                f"{file}: row {line} was measured at {row[0][:24]}, its label states {label.start:%Y-%m-%dT%H:%M} to "
                f"{label.stop:%H:%M}; table and label do not belong together"
            )
