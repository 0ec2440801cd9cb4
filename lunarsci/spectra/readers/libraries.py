"""Spectra in the text formats of RELAB and of the USGS spectral library.

RELAB (`.asc`, `.tab`): the number of channels, then wavelength, reflectance and standard deviation, and below them
name, sample and remarks. USGS splib07 text: a header line, then one reflectance a line; wavelengths are in another file
(Kokaly et al. 2017, USGS Spectral Library Version 7, U.S. Geological Survey Data Series 1035, 10.3133/ds1035). No
library reads either.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.spectra.readers.table import Column, SpectrumTable
from lunarsci.spectra.rows import Row, check_widths, number, numbers, quoted, split_lines

_COUNT = re.compile(r"[0-9]+")
_SPLIB_HEADER = re.compile(r"\s*(splib0[67]\w*|s0[67]\w*)\s+Record=(\d+):\s*(\S.*?)\s*$", re.IGNORECASE)
_OTHER_FILE = re.compile(r"wavelengths?|bandpass", re.IGNORECASE)
_FILE_NAME = re.compile(r"(splib0[67]|s0[67])\w*_(wavelengths|bandpass)", re.IGNORECASE)
_SPECTROMETERS = ("ASD", "BECK", "NIC4", "AVIRIS")
_MICROMETRES = "um"


def looks_like_relab(text: str, *, named_so: bool) -> bool:
    """Whether the first line is a whole number alone, and the next has two or three numbers between blanks.

    The first line is enough for a file that is `named_so`.
    """
    lines = [line for _, line in split_lines(text[:2000])[0][:2]]
    if not lines or not _COUNT.fullmatch(lines[0]):
        return False
    fields = lines[1].split() if len(lines) > 1 else []
    return named_so or (len(fields) in (2, 3) and all(number(f) is not None for f in fields))


def read_relab(source: InputFile) -> SpectrumTable:
    """Read one RELAB spectrum; standard deviations that are all 0 mean that they are unknown.

    Raises DataError when the rows are not as many as the first line says, or are not two or three numbers each.
    """
    lines, comments = split_lines(inputs.text(source))
    if not lines or not _COUNT.fullmatch(lines[0][1]):
        first = quoted(lines[0][1]) if lines else "nothing"
        raise DataError(
            f"{source.name}: no RELAB file: it begins with {first}, not the number of channels; use --format text"
        )
    count = int(lines[0][1][:18])
    rows, below = _rows_and_below(lines[1:], count)
    if count != len(rows) or not rows:
        raise DataError(
            f"{source.name}: line {lines[0][0]} announces {count} channels and {len(rows)} rows follow (truncated "
            "download?); fetch the file again"
        )
    width = check_widths(rows, source.name)
    if width not in (2, 3):
        raise DataError(f"{source.name}: {width} columns; RELAB has wavelength, reflectance and standard deviation")
    return _relab_table(source, rows, width, [*(comment for _, comment in comments if comment), *below])


def _rows_and_below(lines: Sequence[tuple[int, str]], count: int) -> tuple[list[Row], list[str]]:
    """The rows of a file of so many channels, and the lines of text below them; all are rows where these are none."""
    rows = [Row(n, tuple(line.split())) for n, line in lines]
    below = rows[count:]
    text = [line for _, line in lines[count:]]
    spoilt = any(all(number(cell) is not None for cell in row.fields) for row in below)
    return (rows, []) if spoilt or not any(any(map(str.isalpha, line)) for line in text) else (rows[:count], text)


def _relab_table(source: InputFile, rows: list[Row], width: int, comments: list[str]) -> SpectrumTable:
    titles = ("wavelength", "reflectance", "standard deviation")[:width]
    wavelength, reflectance, *sigma = (
        Column(title, numbers(rows, k, repr(title), source.name), k + 1) for k, title in enumerate(titles)
    )
    places = tuple(f"line {row.line}" for row in rows)
    spectra = ((reflectance, sigma[0] if sigma else None),)
    return SpectrumTable(source, "relab", wavelength, spectra, places, {"comments": comments})


@dataclass(frozen=True, slots=True)
class _Record:
    """One file of the library: its set (`splib07a`), its title, and its values with their lines."""

    set: str
    title: str
    values: FloatArray
    places: tuple[str, ...]

    @property
    def family(self) -> str | None:
        """Spectrometer that the title names, None where it names none that is known."""
        words = self.title.upper().split()
        return next((family for word in words for family in _SPECTROMETERS if word.startswith(family)), None)


def looks_like_splib(text: str) -> bool:
    """Whether the first line is a header of the library: 'splib07a Record=5932: Kaolinite CM5  BECKb AREF'."""
    return _SPLIB_HEADER.match(text.lstrip("\n\r").split("\n", 1)[0]) is not None


def without_wavelength_files(names: Sequence[str]) -> list[str]:
    """File names less those of the library's wavelengths and bandpasses, unless there is nothing else."""
    rest = [name for name in names if not _FILE_NAME.match(Path(name).name)]
    return rest or list(names)


def read_splib(source: InputFile) -> SpectrumTable:
    """Read one spectrum; its wavelengths come from the file of the same set beside it or in the folder above.

    Raises DataError when that file is missing or several would fit, or a line is no number.
    """
    record = _record(source)
    if _OTHER_FILE.search(record.title):
        raise DataError(f"{source.name}: holds {quoted(record.title)}, not a spectrum; give the files of spectra")
    file, wavelengths = _wavelengths(source, record)
    return SpectrumTable(
        source,
        "splib",
        Column("wavelength", wavelengths.values, 1, _MICROMETRES),
        ((Column("", record.values, 1), None),),
        record.places,
        {"title": record.title, "inputs": {source.name: source.sha256, file.name: file.sha256}},
    )


def _record(source: InputFile) -> _Record:
    lines, _ = split_lines(inputs.text(source))
    match = _SPLIB_HEADER.match(lines[0][1]) if lines else None
    if match is None:
        first = quoted(lines[0][1]) if lines else "nothing"
        raise DataError(f"{source.name}: begins with {first}, not with 'splib07... Record=...'; use --format text")
    rows = [Row(n, (line,)) for n, line in lines[1:]]
    if not rows:
        raise DataError(f"{source.name}: holds a header and no values (truncated download?); fetch it again")
    values = numbers(rows, 0, "reflectance", source.name)
    return _Record(match[1].lower(), match[3], values, tuple(f"line {row.line}" for row in rows))


def _wavelengths(source: InputFile, record: _Record) -> tuple[InputFile, _Record]:
    """The wavelength file that belongs to a spectrum, by set, number of channels and spectrometer."""
    family = record.family or "its spectrometer"
    wanted = f"{record.set}_Wavelengths_*.txt of {family} with {record.values.size} values"
    if source.name == "<stdin>":
        raise DataError(f"{source.name}: has no wavelengths and no folder to look for them; give the file's name")
    found = [pair for pair in _candidates(source) if _fits(pair[1], record)]
    if not found:
        raise DataError(f"{source.name}: holds reflectance only; put {wanted} beside it or in the folder above")
    distinct = {pair[1].values.tobytes() for pair in found}
    if len(distinct) > 1:
        names = " and ".join(Path(file.name).name for file, _ in found[:2])
        raise DataError(f"{source.name}: {names} would both fit as its wavelengths; keep the right one")
    return found[0]


def _candidates(source: InputFile) -> list[tuple[InputFile, _Record]]:
    folder = Path(source.name).parent
    pairs = []
    for path in sorted([*folder.glob("*_[Ww]avelengths_*.txt"), *(folder / "..").glob("*_[Ww]avelengths_*.txt")]):
        file = read_input(str(path))
        if looks_like_splib(file.data[:500].decode("latin-1")):
            pairs.append((file, _record(file)))
    return pairs


def _fits(wavelengths: _Record, record: _Record) -> bool:
    if wavelengths.set != record.set or wavelengths.values.size != record.values.size:
        return False
    if not bool(np.all(wavelengths.values > 0)):
        return False
    return wavelengths.family is None or record.family is None or wavelengths.family == record.family
