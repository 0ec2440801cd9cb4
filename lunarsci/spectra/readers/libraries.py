"""Spectra in the text formats of RELAB and the USGS, and those for exchange: JCAMP-DX, JSON, VOTable, tables of AAS.

RELAB (`.asc`, `.tab`): the number of channels, then wavelength, reflectance and standard deviation, and below them
name, sample and remarks. USGS splib07 text: a header line, then one reflectance a line; wavelengths are in another file
(Kokaly et al. 2017, USGS Spectral Library Version 7, U.S. Geological Survey Data Series 1035, 10.3133/ds1035). No
library reads either. JCAMP-DX: McDonald & Wilks (1988), Appl. Spectrosc. 42, 151, 10.1366/0003702884428734; the package
`jcamp` reads it, but neither counts points nor compares the check values. VOTable: Ochsenbein et al. (2019),
10.5479/ADS/bib/2019ivoa.spec.1021O. Tables of the AAS: https://journals.aas.org/mrt-overview.
"""

import io
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.tables import MOST_CELLS
from lunarsci.spectra.readers.arrangements import on_one_grid
from lunarsci.spectra.readers.astropy_tables import one_line, spectrum_table
from lunarsci.spectra.readers.columns import assign_roles
from lunarsci.spectra.readers.table import Column, SpectrumTable, only_percent
from lunarsci.spectra.rows import Row, check_widths, number, numbers, quoted, split_lines

_COUNT = re.compile(r"[0-9]+")
_SUFFIXES = {".tab", ".asc"}
_SPLIB_HEADER = re.compile(r"\s*(splib0[67]\w*|s0[67]\w*)\s+Record=(\d+):\s*(\S.*?)\s*$", re.IGNORECASE)
_OTHER_FILE = re.compile(r"wavelengths?|bandpass", re.IGNORECASE)
_FILE_NAME = re.compile(r"(splib0[67]|s0[67])\w*_(wavelengths|bandpass)", re.IGNORECASE)
_SPECTROMETERS = ("ASD", "BECK", "NIC4", "AVIRIS")
_MICROMETRES = "um"


def is_relab(source: InputFile, start: str) -> bool:
    """Whether the first line is a whole number alone, and the next has two or three numbers between blanks.

    The first line is enough for a file that is named so.
    """
    named_so = Path(source.name).suffix.lower() in _SUFFIXES
    lines = [line for _, line in split_lines(start[:2000])[0][:2]]
    if not lines or not _COUNT.fullmatch(lines[0]):
        return False
    fields = lines[1].split() if len(lines) > 1 else []
    return named_so or (len(fields) in (2, 3) and all(number(f) is not None for f in fields))


def read_relab(source: InputFile) -> SpectrumTable:
    """Read one RELAB spectrum; standard deviations that are all 0 mean that they are unknown.

    Raises DataError when the rows are not as many as the first line says, or are not two or three numbers each.
    """
    lines, comments = split_lines(inputs.text(source))
    first = lines[0][1] if lines else "nothing"
    count = int(first[:18]) if _COUNT.fullmatch(first) else -1
    rows, below = _rows_and_below(lines[1:], count)
    width = check_widths(rows, source.name) if rows else 0
    if count != len(rows) or width not in (2, 3):
        raise DataError(
            f"{source.name}: begins with {quoted(first)} and has {len(rows)} rows of {width} numbers (truncated?); a "
            "RELAB file begins with the number of its rows of wavelength, reflectance and standard deviation"
        )
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
    """One file of the library: its set (`splib07a`), its title, its values, (n,), as written, and the line of each."""

    set: str
    title: str
    values: FloatArray
    places: tuple[str, ...]

    @property
    def family(self) -> str | None:
        """Spectrometer that the title names, None where it names none that is known."""
        words = self.title.upper().split()
        return next((family for word in words for family in _SPECTROMETERS if word.startswith(family)), None)


def is_splib(source: InputFile, start: str) -> bool:
    """Whether the first line is a header of the library: 'splib07a Record=5932: Kaolinite CM5  BECKb AREF'."""
    return _SPLIB_HEADER.match(start.lstrip("\n\r").split("\n", 1)[0]) is not None


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
    """A file of the library. Raises DataError for one without its header or values."""
    lines, _ = split_lines(inputs.text(source))
    match = _SPLIB_HEADER.match(lines[0][1]) if lines else None
    rows = [Row(n, (line,)) for n, line in lines[1:]]
    if match is None or not rows:
        raise DataError(f"{source.name}: no 'splib07... Record=...' with values below (truncated?); fetch it again")
    values = numbers(rows, 0, "reflectance", source.name)
    return _Record(match[1].lower(), match[3], values, tuple(f"line {row.line}" for row in rows))


def _wavelengths(source: InputFile, record: _Record) -> tuple[InputFile, _Record]:
    """The wavelength file that belongs to a spectrum, by set, number of channels and spectrometer."""
    family = record.family or "its spectrometer"
    wanted = f"{record.set}_Wavelengths_*.txt of {family} with {record.values.size} values"
    there = [] if source.name == "<stdin>" else _candidates(source)
    result = [pair for pair in there if _fits(pair[1], record)]
    if len({pair[1].values.tobytes() for pair in result}) != 1:
        names = " and ".join(Path(file.name).name for file, _ in result[:2])
        what = f"{names} would both fit as its wavelengths; keep the right one" if result else (
            "has no wavelengths and no folder to look for them; give the file's name" if source.name == "<stdin>" else
            f"holds reflectance only; put {wanted} beside it or in the folder above")  # fmt: skip
        raise DataError(f"{source.name}: {what}")
    return result[0]


def _candidates(source: InputFile) -> list[tuple[InputFile, _Record]]:
    folder = Path(source.name).parent
    pairs = []
    for path in sorted([*folder.glob("*_[Ww]avelengths_*.txt"), *(folder / "..").glob("*_[Ww]avelengths_*.txt")]):
        file = read_input(str(path))
        if is_splib(file, file.data[:500].decode("latin-1")):
            pairs.append((file, _record(file)))
    return pairs


def _fits(wavelengths: _Record, record: _Record) -> bool:
    if wavelengths.set != record.set or wavelengths.values.size != record.values.size:
        return False
    if not bool(np.all(wavelengths.values > 0)):
        return False
    return wavelengths.family is None or record.family is None or wavelengths.family == record.family


_RECORD = re.compile(r"^##\s*([^=]*?)\s*=\s*(.*)$")
_FORM = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[Ee][+-]?\d+)?|[@A-Ia-i%J-Rj-rS-Zs]\d*|\?")
_SQUEEZED, _DIFFERENCE, _DUPLICATE = "@ABCDEFGHIabcdefghi", "%JKLMNOPQRjklmnopqr", "STUVWXYZs"
"""Letters for the first digit 0 to 9, then -1 to -9; of duplicates 1 to 9."""
_TABULAR = ("XYDATA", "XYPOINTS")


def is_jcamp(source: InputFile, start: str) -> bool:
    return re.match(r"##\s*(TITLE|JCAMP)", start, re.IGNORECASE) is not None


def is_json(source: InputFile, start: str) -> bool:
    return start.startswith(("{", "["))


def is_votable(source: InputFile, start: str) -> bool:
    return start.startswith("<") and re.search(r"<(\w+:)?VOTABLE\b", start[:2000]) is not None


def is_mrt(source: InputFile, start: str) -> bool:
    return "Byte-by-byte Description of file" in start[:20_000]


def read_jcamp(source: InputFile) -> SpectrumTable:
    """Read each block with `XYDATA` or `XYPOINTS`. Raises DataError for one with other points than it announces."""
    groups, keys = list[list[Column]](), dict[str, str]()
    for block in _blocks(inputs.text(source)):
        keys |= {key: value.split("\n")[0] for key, value in block.items() if key not in _TABULAR}
        if any(one in block for one in _TABULAR):
            try:
                groups.append(_spectrum(block, source.name, len(groups)))
            except DataError:
                raise
            except (KeyError, ValueError, OverflowError) as error:
                raise DataError(f"{source.name}: broken JCAMP-DX ({str(error)[:80]}); fetch it again") from error
    if not groups:
        raise DataError(f"{source.name}: JCAMP-DX without XYDATA or XYPOINTS; export the spectrum as one of them")
    if len(groups) == 1:
        groups[0][1] = Column(keys.get("YUNITS", ""), groups[0][1].values, 2)
    return on_one_grid(groups, source, {"keys": keys}, f"{len(groups)} spectra of JCAMP-DX", "jcamp")


def _blocks(text: str) -> Iterator[dict[str, str]]:
    """The labelled records of each block of a JCAMP-DX file, by key; first what stands before the first block."""
    block, key = dict[str, str](), ""
    for line in text.splitlines():
        line = line.split("$$")[0].rstrip()
        if result := _RECORD.match(line):
            key = re.sub(r"[\s/_-]", "", result[1]).upper()
            if key == "TITLE":
                yield block
                block = {}
            block[key] = result[2]
        elif key:
            block[key] += f"\n{line}"
    yield block


def _spectrum(block: dict[str, str], file: str, before: int) -> list[Column]:
    """Wavelengths and ordinates of a block."""
    factor = [_real(block, key, file, 1.0) for key in ("XFACTOR", "YFACTOR")]
    title = f"spectrum of {quoted(block.get('TITLE', str(before + 1)))}"
    kind = next(one for one in _TABULAR if one in block)
    form, _, body = block[kind].partition("\n")
    if "++" in form:
        y = _ordinates(body, f"{file}: {title}") * factor[1]
        x = np.linspace(_real(block, "FIRSTX", file), _real(block, "LASTX", file), y.size)
    else:
        pairs = np.array([float(one) for one in re.findall(r"[+-]?[\d.]+(?:[Ee][+-]?\d+)?", body)])
        x, y = pairs[: pairs.size // 2 * 2].reshape(-1, 2).T * np.array(factor)[:, None]
    announced = int(_real(block, "NPOINTS", file, y.size))
    if announced != y.size:
        raise DataError(f"{file}: {title} has {y.size} points, NPOINTS says {announced} (truncated?); fetch it again")
    unit = block.get("YUNITS", "")
    name = f"{block.get('TITLE', '')} [%]" if only_percent(unit) else f"{block.get('TITLE', '')} {unit}"
    return [Column(block.get("XUNITS", ""), x, 1), Column(name.strip(), y, 2 + before)]


def _real(block: dict[str, str], key: str, file: str, other: float | None = None) -> float:
    try:
        return float(block[key]) if key in block or other is None else other
    except (KeyError, ValueError):
        raise DataError(f"{file}: JCAMP-DX without a number for {key}; export the spectrum again") from None


def _ordinates(body: str, what: str) -> FloatArray:
    """Numbers of lines of (X++(Y..Y)), plain or squeezed; a line after differences begins with a check of the last."""
    values, differences = list[float](), False
    for line in filter(str.strip, body.splitlines()):
        forms = _FORM.findall(line)[1:]
        if differences and forms:
            check = [*_number(forms.pop(0))]
            if check != values[-1:]:
                raise DataError(f"{what}: the check of a line is {check[0]:g}, not {values[-1]:g}; fetch it again")
        step, differences = 0.0, False
        for form in forms:
            if form[0] in _DUPLICATE:
                times = int(f"{_DUPLICATE.index(form[0]) + 1}{form[1:]}") - 1
                if len(values) + times > MOST_CELLS:
                    raise DataError(f"{what}: more than {MOST_CELLS} points; fetch it again")
                values += [values[-1] + step * (k + 1) for k in range(times)] if values else []
            elif form[0] in _DIFFERENCE:
                step, differences = _digits(form, _DIFFERENCE), True
                values.append((values or [0.0])[-1] + step)
            else:
                step, differences = 0.0, False
                values += _number(form)
    return np.array(values)


def _number(form: str) -> Iterator[float]:
    yield np.nan if form == "?" else _digits(form, _SQUEEZED) if form[0] in _SQUEEZED else float(form)


def _digits(form: str, letters: str) -> float:
    place = letters.index(form[0])
    return float(f"{place}{form[1:]}") if place < 10 else -float(f"{place - 9}{form[1:]}")


def read_json(source: InputFile) -> SpectrumTable:
    """Read lists by name, or a list of rows with names, as pandas writes them. Raises DataError for any other JSON."""
    result, why = None, "without two lists of numbers"
    try:
        result = json_document(inputs.text(source))
    except ValueError as error:
        why = f"that is broken ({str(error)[:80]})"
    if isinstance(result, list) and result and all(isinstance(row, dict) for row in result):
        result = {name: [row.get(name) for row in result] for name in result[0]}
    lists = dict[str, list[Any]]()
    for name, values in result.items() if isinstance(result, dict) else ():
        cells = list(values.values()) if isinstance(values, dict) else values
        if isinstance(cells, list) and cells and all(map(_is_number, cells)):
            lists[str(name)] = cells
    lists = {name: one for name, one in lists.items() if len(one) == max(map(len, lists.values()))}
    if len(lists) < 2:
        raise DataError(f"{source.name}: is JSON {why}; fetch it again, or save the spectra as CSV or ECSV")
    roles = assign_roles([*lists], source)

    def column(k: int) -> Column:
        name = [*lists][k]
        return Column(name, np.array([np.nan if one is None else one for one in lists[name]], float), k + 1)

    places = tuple(f"value {k + 1}" for k in range(len(next(iter(lists.values())))))
    return roles.table(source, "json", column, places, {})


def _is_number(cell: Any) -> bool:
    """Whether a value of JSON is a number that a float has, or none."""
    return cell is None or (type(cell) in (int, float) and abs(cell) < 1e308)


def read_with_astropy(source: InputFile, format: str) -> SpectrumTable:
    """Read a VOTable, or a machine-readable table of the AAS. Raises DataError where astropy cannot."""
    from astropy.table import Table

    given: Any = io.BytesIO(source.data) if format == "votable" else inputs.text(source)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Table.read(given, format="votable" if format == "votable" else "ascii.mrt")
    # astropy raises a dozen kinds of errors for a broken file, and documents none of them.
    except Exception as error:
        raise DataError(f"{source.name}: broken {format} ({one_line(error)}); fetch the file again") from error
    if format == "mrt":
        for name in [name for name in table.colnames if name.startswith("e_") and name[2:] in table.colnames]:
            table.rename_column(name, f"{name[2:]}_sigma")
    return spectrum_table(table, source, format)


read_votable = partial(read_with_astropy, format="votable")
read_mrt = partial(read_with_astropy, format="mrt")
