"""Lines, fields and numbers of text tables as people and instruments write them, for the readers of spectra.

A separator is recognised, numbers may have decimal commas, cells may be missing, and what is wrong is named with its
line and column. Tables whose form lunarsci lays down (its own, states, trials, lists of pictures) are CSV with a header
and are read by `lunarsci.io.tables`.

orjson reads plain numbers where they are many; a wrong cell with its line and column, decimal commas beside points and
missing cells of spreadsheets in one table it does not tell.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile, csv_rows

MOST_LETTERS = 3
"""Letters of a number that is misspelt, at most; a first cell with more is a name."""
UNITS = ("nm", "um", "µm", "μm", "micron", "microns", "%", "percent", "nanometer", "micrometer")
"""Cells of a row of units below the header."""
DECIMAL_COMMA = ";\t"
"""Separators beside which a comma within a number is its decimal point."""
_LONGEST_SHOWN = 40
"""Characters of a cell in a message, at most."""
_COMMENT = ("#", "%", "!")
"""A line that begins with one of these is a comment."""
_ORDINATES = ("%R", "%T", "%r", "%t")
"""Lines of heads of spectrometers that name what is measured."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]++\.?+[0-9]*+|\.[0-9]++)(?:[eEdD][+-]?[0-9]+)?|[+-]?inf(?:inity)?", re.IGNORECASE)
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*|(?:[ '\u2019\u00a0\u202f]\d{3})+(?:[.,]\d*)?)")
"""A number with signs between its thousands, where which is the decimal sign is sure."""
_MISSING = {
    *("", "-", "--", "na", "nan", "n/a", "null", "none", "missing", "."),
    *("n.d.", "nd", "n/d", "n.a.", "bdl", "no data", "*", "**", "***", "****", "*****", "******"),
    *("#n/a", "#na", "#div/0!", "#value!", "#num!", "1.#qnan", "-1.#ind", "1.#inf", "-nan", "-nan(ind)"),
}
"""Cells without a number; those of spreadsheets and of C on Windows among them."""
_LINES_LOOKED_AT = 50
"""Lines from which the separator is taken."""
_PLAIN = b"0123456789+-.eE \t\n"
"""Bytes of plain numbers and what may stand around them, which libraries read as we do."""
_MANY = 20_000
"""Characters from which fields are made numbers a line at a time, without a look at each; measured."""


@dataclass(frozen=True, slots=True)
class Row:
    """The fields of one line; `line` counts from 1."""

    line: int
    fields: tuple[str, ...]


def split_lines(text: str) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Numbered data lines and numbered comment lines (less their mark); blank lines are in neither."""
    # str.splitlines also breaks at form feeds and the like, and the line numbers would not be those of an editor.
    stripped = (line.strip().strip("\x1a") for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))
    numbered = [(n, line) for n, line in enumerate(stripped, 1) if line]
    data = [(n, line) for n, line in numbered if not line.startswith(_COMMENT) or line in _ORDINATES]
    comments = [
        (n, line.lstrip("#%! \t")) for n, line in numbered if line.startswith(_COMMENT) and line not in _ORDINATES
    ]
    return data, comments


def separator_of(lines: Sequence[tuple[int, str]]) -> str:
    """Tab, semicolon or comma if most data lines have it, in this order; else ' ', which stands for any blanks."""
    # The first line may be a header, where a name such as "65315,153 <45 um" may hold any of them.
    looked_at = [line for _, line in lines[1 : _LINES_LOOKED_AT + 1] or lines]
    for separator in ("\t", ";", ","):
        if 2 * sum(separator in line for line in looked_at) > len(looked_at):
            return separator
    return " "


def split_fields(line: str, separator: str, place: str) -> tuple[str, ...]:
    """Fields of one line, stripped; quotes are honoured. Raises DataError naming `place` for broken quotes."""
    if separator == " ":
        return tuple(cell.strip('"') for cell in line.split())
    fields = csv_rows(place, [line], delimiter=separator, skipinitialspace=True, strict='"' in line)
    return tuple(f.strip() for f in next(fields, ()))


def check_widths(rows: Sequence[Row], file: str, header_width: int | None = None) -> int:
    """Number of fields of every row; `header_width` is that of the header, None without one.

    Raises DataError naming the line that differs.
    """
    widths = Counter(len(row.fields) for row in rows)
    expected = header_width if header_width is not None and header_width in widths else widths.most_common(1)[0][0]
    for row in rows:
        if len(row.fields) != expected:
            raise DataError(
                f"{file}: line {row.line} has {len(row.fields)} fields, the others {expected} (truncated download, or "
                "another separator?); fetch the file again or correct the line"
            )
    if header_width is not None and header_width != expected:
        raise DataError(
            f"{file}: the header has {header_width} names and the rows {expected} fields; give each column one name "
            "(in quotes if it has blanks)"
        )
    return expected


def is_missing(cell: str) -> bool:
    """Whether a cell stands for no measurement."""
    return cell.casefold() in _MISSING


def number(cell: str, decimal_comma: bool = False) -> float | None:
    """Value of a cell, NaN for a missing one, None for anything that is no number."""
    if decimal_comma and "." not in cell:
        cell = cell.replace(",", ".", 1)
    if not _NUMBER.fullmatch(cell) and _GROUPED.fullmatch(cell):
        decimal = max(cell.rfind("."), cell.rfind(","))
        whole, rest = (cell, "") if decimal < 0 else (cell[:decimal], cell[decimal + 1 :])
        cell = f"{re.sub(r'[^0-9+-]', '', whole)}.{rest}"
    if _NUMBER.fullmatch(cell):
        return float(cell.replace("d", "e").replace("D", "e"))
    return float("nan") if is_missing(cell) else None


def numbers(rows: Sequence[Row], column: int, label: str, file: str, decimal_comma: bool = False) -> FloatArray:
    """One column (from 0) as floats, shape (rows,). Raises DataError with line, column and text of a bad cell."""
    values = np.empty(len(rows))
    for k, row in enumerate(rows):
        value = number(row.fields[column], decimal_comma)
        if value is None:
            raise DataError(_bad_cell(row, column, label, file, decimal_comma))
        values[k] = value
    return values


def numbers_at_once(lines: Sequence[tuple[int, str]], separator: str) -> FloatArray | None:
    """Fields of many lines as floats, (fields, lines), NaN where one is empty, the same that `numbers` gives.

    None where fields must be looked at one by one: they are few, not all plain numbers, or not as many in each line.
    """
    width, size = lines[0][1].count(separator) + 1, sum(len(line) for _, line in lines)
    if separator == " " or size < _MANY or any(line.count(separator) != width - 1 for _, line in lines):
        return None
    values = np.empty((len(lines), width))
    try:
        for row, (_, line) in zip(values, lines, strict=True):
            row[:] = plain_numbers(line, separator)
    except ValueError:
        return None
    return np.ascontiguousarray(values.T)


def plain_numbers(line: str, separator: str) -> Any:
    """All fields of a line, None or NaN for an empty one. Raises ValueError where one is no plain number."""
    if line.encode().translate(None, _PLAIN + separator.encode()):
        raise ValueError(line)
    fields = f",{line.replace(separator, ',')},"
    while ",," in fields:
        fields = fields.replace(",,", ",null,")
    try:
        return orjson.loads(f"[{fields[1:-1]}]")
    except orjson.JSONDecodeError:  # such as +1, .5 or 1.
        return np.array([cell.strip() or "nan" for cell in line.split(separator)], float)


def _bad_cell(row: Row, column: int, label: str, file: str, decimal_comma: bool) -> str:
    """The message on a cell that is no number, with what is likely to mend it."""
    cell = row.fields[column]
    comma = "," in cell and not decimal_comma
    mend = "; correct it, leave it blank if unknown, or take out a column that is no spectrum"
    if cell.strip().casefold() in UNITS:
        mend = "; write units into the header, as in 'wavelength [nm]' and 'rock [%]', and take their row out"
    hint = "; a decimal comma needs ';' or tabs between the columns" if comma else mend
    wrong = (
        "; or is the file no table of spectra?" if column == 0 and sum(map(str.isalpha, cell)) > MOST_LETTERS else ""
    )
    return f"{file}: line {row.line}, column {label}: {quoted(cell)} is not a number{hint}{wrong}"


def quoted(text: str) -> str:
    """Text of a file as a message shows it: on one line, and not too long."""
    return repr(text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "...")


@dataclass(frozen=True, slots=True)
class NamedTable:
    """A table of text below the names of its columns, made by `named_table`.

    `names` are in lower case, none of them twice; every one of `rows` has as many fields. With `decimal_comma` a comma
    may stand for the point of a number.
    """

    file: str
    names: tuple[str, ...]
    rows: tuple[Row, ...]
    decimal_comma: bool

    def cells(self, name: str) -> list[str]:
        """The texts of a column."""
        return [row.fields[self.names.index(name)] for row in self.rows]

    def numbers(self, name: str) -> FloatArray:
        """A column as floats, (rows,), NaN where it is blank. Raises DataError for a cell that is none."""
        return numbers(self.rows, self.names.index(name), quoted(name), self.file, self.decimal_comma)

    def refuse(self, wrong: BoolArray, name: str, rule: str) -> None:
        """Raise DataError where a cell of a column is wrong, (rows,): with its line, its text, and the rule."""
        if (places := np.flatnonzero(wrong)).size:
            row = self.rows[places[0]]
            cell = row.fields[self.names.index(name)]
            raise DataError(f"{self.file}: line {row.line}, column {quoted(name)}: {quoted(cell)}; {rule}")


def named_table(source: InputFile, *needed: str, least: int = 1) -> NamedTable:
    """Read a table. Raises DataError for one without a needed column, with two of one name, or with too few rows."""
    lines, _ = split_lines(inputs.text(source))
    if not lines:
        raise DataError(f"{source.name}: holds only comments; check how it was made or downloaded")
    separator = separator_of(lines)
    header, *rows = (Row(n, split_fields(line, separator, f"{source.name}: line {n}")) for n, line in lines)
    names = tuple(name.casefold() for name in header.fields)
    missing = next((name for name in needed if name not in names), None)
    if missing or len(rows) < least or len({*names}) < len(names):
        why = f"no column {quoted(missing)}" if missing else f"{len(rows)} rows below the header"
        why = why if missing or len(rows) < least else "two columns of one name"
        listed = ", ".join(map(quoted, header.fields[:5]))
        raise DataError(f"{source.name}: {why} ({listed}); a table has one of each name and {least} rows or more")
    check_widths(rows, source.name, len(names))
    return NamedTable(source.name, names, tuple(rows), separator in DECIMAL_COMMA)
