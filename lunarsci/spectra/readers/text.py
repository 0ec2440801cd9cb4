"""Spectra in files of text: plain tables, and the formats of RELAB and of the USGS spectral library.

Plain tables: CSV, TSV, semicolons with decimal commas, or blanks between the columns. RELAB (`.asc`, `.tab`): the
number of channels, then wavelength, reflectance and standard deviation. USGS splib07 text: a header line, then one
reflectance a line; wavelengths are in another file (Kokaly et al. 2017, USGS Spectral Library Version 7, U.S.
Geological Survey Data Series 1035, 10.3133/ds1035).
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lunarsci import inputs
from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile, read_input
from lunarsci.spectra.readers.columns import Roles, assign_roles, is_wavelength
from lunarsci.spectra.readers.table import Column, SpectrumTable
from lunarsci.spectra.rows import (
    DECIMAL_COMMA,
    Row,
    check_widths,
    is_missing,
    number,
    numbers,
    numbers_at_once,
    quoted,
    separator_of,
    split_fields,
    split_lines,
)

_NAME = re.compile(r'"([^"]*)"|([^\s(\[{]+(?:\s*[(\[{][^)\]}]*[)\]}])?)')
_COMMENTS_KEPT = 100
_COMMENT_LENGTH = 200
_COUNT = re.compile(r"[0-9]+")
_SPLIB_HEADER = re.compile(r"\s*(splib0[67]\w*|s0[67]\w*)\s+Record=(\d+):\s*(\S.*?)\s*$", re.IGNORECASE)
_DIGIT = re.compile(r"[0-9]")
_OTHER_FILE = re.compile(r"wavelengths?|bandpass", re.IGNORECASE)
_FILE_NAME = re.compile(r"(splib0[67]|s0[67])\w*_(wavelengths|bandpass)", re.IGNORECASE)
_SPECTROMETERS = ("ASD", "BECK", "NIC4", "AVIRIS")
_MICROMETRES = "um"


def read_text(source: InputFile) -> SpectrumTable:
    """Read a table of one wavelength column and one or more spectra, with or without a header line.

    Lines that begin with '#', '%' or '!' are comments; the one above the data may be the header. Raises DataError
    naming line and column for anything that is not such a table.
    """
    lines, comments = split_lines(inputs.text(source))
    if not lines:
        raise DataError(f"{source.name}: holds only comments; check how it was made or downloaded")
    separator = separator_of(lines)
    names, body = _header_and_body(lines, comments, separator, source.name)
    values = numbers_at_once(body, separator)
    rows: list[Row] = []
    if values is None or len(values) < 2 or np.isnan(values[-1]).all() or len(names or values) != len(values):
        values = None
        names, rows = _rows(names, body, separator, source.name)
    width = len(rows[0].fields) if values is None else len(values)
    texts = _texts(rows) if names and any(map(is_wavelength, names)) else []
    roles = _roles_without_names(width, source.name) if names is None else assign_roles(names, source, left_out=texts)
    _warn_of_commented_rows(body, comments, separator, source.name)
    titles = names or [""] * width

    def column(k: int) -> Column:
        if values is not None:
            return Column(titles[k], values[k], k + 1)
        label = quoted(titles[k]) if titles[k] else str(k + 1)
        return Column(titles[k], numbers(rows, k, label, source.name, separator in DECIMAL_COMMA), k + 1)

    return SpectrumTable(
        source,
        "text",
        column(roles.wavelength),
        tuple((column(r), None if s is None else column(s)) for r, s in roles.spectra),
        tuple(f"line {line}" for line, _ in body),
        {"comments": [c[:_COMMENT_LENGTH] for _, c in comments[:_COMMENTS_KEPT] if c]},
        roles.systematic_columns(column),
        None if values is None else _block(values, [r for r, _ in roles.spectra]),
    )


def _texts(rows: Sequence[Row]) -> list[int]:
    """Places of columns without a digit in any of their cells; none where fewer than two others are left."""
    texts = [k for k in range(len(rows[0].fields)) if rows[0].fields[k]] if rows else []
    for row in rows:
        texts = [k for k in texts if not _DIGIT.search(row.fields[k])]
    texts = [k for k in texts if not all(is_missing(row.fields[k]) for row in rows)]
    return texts if rows and len(rows[0].fields) - len(texts) > 1 else []


def _warn_of_commented_rows(
    body: Sequence[tuple[int, str]], comments: Sequence[tuple[int, str]], separator: str, file: str
) -> None:
    """Rows whose first cell begins with the sign of a comment, as errors of a spreadsheet do (#N/A), are left out."""
    fields = body[0][1].count(separator) if separator != " " else 0
    lost = [n for n, text in comments if body[0][0] < n < body[-1][0] and fields and text.count(separator) == fields]
    if lost:
        warnings.warn(
            f"{file}: left out {len(lost)} lines among the data that begin as comments do, the first is line {lost[0]}",
            LunarSciWarning,
            stacklevel=3,
        )


def _block(values: FloatArray, places: Sequence[int]) -> FloatArray:
    """Some rows of an array, as they lie there where they are next to each other."""
    side_by_side = places[-1] - places[0] == len(places) - 1
    return values[places[0] : places[-1] + 1] if side_by_side else values[places]


def _header_and_body(
    lines: Sequence[tuple[int, str]], comments: Sequence[tuple[int, str]], separator: str, file: str
) -> tuple[list[str] | None, Sequence[tuple[int, str]]]:
    """Names of the columns, if there are any, and the lines of numbers."""
    first = _row(lines[0], separator, file)
    if not _is_header(first, separator in DECIMAL_COMMA):
        return _names_in_comment(comments, separator, first, file), lines
    if len(lines) == 1:
        raise DataError(f"{file}: holds a header and no data rows; check how it was made or downloaded")
    if _is_header(_row(lines[1], separator, file), separator in DECIMAL_COMMA):
        rows = (_row(line, separator, file) for line in lines)
        above, begin = first, None
        for row in rows:
            if not _is_header(row, separator in DECIMAL_COMMA):
                begin = row
                break
            above = row
        named_later = above.line != first.line and any(map(is_wavelength, above.fields))
        if begin and (named_later or len(begin.fields) != len(first.fields)):
            raise DataError(
                f"{file}: lines of text before the table, whose numbers begin in line {begin.line}; keep only the line "
                "with the names of the columns, or begin the others with #"
            )
    width = len(_row(lines[1], separator, file).fields)
    return _names(lines[0][1], separator, width, f"{file}: line {first.line}"), lines[1:]


def _row(line: tuple[int, str], separator: str, file: str) -> Row:
    return Row(line[0], split_fields(line[1], separator, f"{file}: line {line[0]}"))


def _rows(
    names: list[str] | None, body: Sequence[tuple[int, str]], separator: str, file: str
) -> tuple[list[str] | None, list[Row]]:
    """Names and the fields of each line, one width everywhere."""
    names, rows = _without_last_empty(names, [_row(line, separator, file) for line in body])
    if check_widths(rows, file, None if names is None else len(names)) < 2:
        raise DataError(f"{file}: has one column; a spectrum needs a wavelength and a reflectance column")
    return names, rows


def _is_header(row: Row, decimal_comma: bool) -> bool:
    """A line is a header when its first field is a name, or blank with a name after it."""
    # Names of spectra may be numbers (1, 2, 3): the wavelength column's field decides.
    first, *others = row.fields
    if is_missing(first):
        return any(number(f, decimal_comma) is None for f in others)
    return number(first, decimal_comma) is None


def _names(line: str, separator: str, width: int, place: str) -> list[str]:
    """Names in a header line; between blanks, a unit in brackets belongs to the name before it."""
    if separator != " ":
        return list(split_fields(line, separator, place))
    together = [quoted_name or plain for quoted_name, plain in _NAME.findall(line)]
    spaced = re.split(r"\s{2,}|\t", line)
    return spaced if len(spaced) == width != len(together) else together


def _names_in_comment(comments: Sequence[tuple[int, str]], separator: str, first: Row, file: str) -> list[str] | None:
    above = [(n, comment) for n, comment in comments if n < first.line]
    if not above:
        return None
    n, comment = above[-1]
    if separator != " " and '"' in comment:
        return None
    names = _names(comment, separator, len(first.fields), f"{file}: line {n}")
    return names if len(names) == len(first.fields) and is_wavelength(names[0]) else None


def _without_last_empty(names: list[str] | None, rows: list[Row]) -> tuple[list[str] | None, list[Row]]:
    """Drop the empty column that a separator at the end of every line makes."""
    if any(row.fields[-1] for row in rows) or len(rows[0].fields) < 3:
        return names, rows
    if names is not None and names[-1] and len(names) == len(rows[0].fields):
        return names, rows
    if names is not None and not names[-1]:
        names = names[:-1]
    return names, [Row(row.line, row.fields[:-1]) for row in rows]


def _roles_without_names(width: int, file: str) -> Roles:
    if width == 3:
        raise DataError(
            f"{file}: three columns without names: the third may be a spectrum or a standard deviation; add a header "
            "line such as wavelength_nm,reflectance,reflectance_sigma"
        )
    return Roles(0, tuple((k, None) for k in range(1, width)))


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
    rows = [Row(n, tuple(line.split())) for n, line in lines[1:]]
    if not lines or not _COUNT.fullmatch(lines[0][1]):
        first = quoted(lines[0][1]) if lines else "nothing"
        raise DataError(
            f"{source.name}: no RELAB file: it begins with {first}, not the number of channels; use --format text"
        )
    count = int(lines[0][1][:18])
    if count != len(rows) or not rows:
        raise DataError(
            f"{source.name}: line {lines[0][0]} announces {count} channels and {len(rows)} rows follow (truncated "
            "download?); fetch the file again"
        )
    width = check_widths(rows, source.name)
    if width not in (2, 3):
        raise DataError(f"{source.name}: {width} columns; RELAB has wavelength, reflectance and standard deviation")
    return _relab_table(source, rows, width, [comment for _, comment in comments if comment])


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
