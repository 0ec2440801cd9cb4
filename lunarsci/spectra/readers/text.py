"""Spectra in tables of text.

CSV, TSV, semicolons with decimal commas, or blanks between the columns; a spectrum in a column or in a row; lines of
keys, names and units above, text below. orjson reads the numbers where there are many; which lines and columns of a
table are what, it does not tell.
"""

import io
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import MOST_CELLS
from lunarsci.spectra.readers.arrangements import (
    Lines,
    is_numeric,
    on_one_grid,
    one_below_another,
    spectra_in_rows,
    tables_in,
    text_table,
    unnamed,
    wavelength_groups,
)
from lunarsci.spectra.readers.columns import assign_roles, is_wavelength
from lunarsci.spectra.readers.table import Column, SpectrumTable, stated_unit
from lunarsci.spectra.rows import (
    DECIMAL_COMMA,
    Row,
    check_widths,
    is_missing,
    number,
    numbers,
    numbers_at_once,
    quoted,
    split_fields,
    split_lines,
)

_NAME = re.compile(r'"([^"]*)"|([^\s(\[{]+(?:\s*[(\[{][^)\]}]*[)\]}])?)')
OPUS = ".dpt"
"""Data point tables of Bruker's OPUS: wavenumbers and ordinates without a head."""
_MOST_COMMENTS = 100
_COMMENT_LENGTH = 200
_DIGIT = re.compile(r"[0-9]")
MOST_UNPACKED = 8 * MOST_CELLS
"""Bytes of an Excel workbook when it is unpacked, as many as of numbers."""


def is_excel(source: InputFile, start: str) -> bool:
    return source.data.startswith(b"PK\x03\x04") and (b"xl/" in source.data or source.name.lower().endswith(".xlsx"))


def read_excel(source: InputFile) -> SpectrumTable:
    """Read the first sheet of an Excel workbook that has more than one row and column, as a table of text.

    Raises DataError without openpyxl, for a workbook that cannot be read or has no such sheet, and as `read_text` does.
    """
    import pandas as pd

    try:
        with ZipFile(io.BytesIO(source.data)) as packed:
            size = sum(one.file_size for one in packed.infolist())
        if size > MOST_UNPACKED:
            raise ValueError(f"{size} bytes when unpacked")
        sheets = pd.read_excel(io.BytesIO(source.data), sheet_name=None, header=None, dtype=object, engine="openpyxl")
    except ImportError as error:
        raise DataError(
            f"{source.name}: Excel needs openpyxl; pip install 'lunarsci[excel]', or save the sheet as CSV"
        ) from error
    except Exception as error:  # whatever openpyxl and zipfile raise of a damaged file
        raise DataError(f"{source.name}: not an Excel workbook that can be read; save its sheet as CSV") from error
    filled = {name: sheet.dropna(how="all").dropna(how="all", axis=1) for name, sheet in sheets.items()}
    chosen = next((str(name) for name, sheet in filled.items() if min(sheet.shape) > 1), None)
    if chosen is None:
        raise DataError(f"{source.name}: no sheet with more than one row and column; save the spectra as CSV")
    content = filled[chosen].to_csv(index=False, header=False).encode()
    result = read_text(InputFile(source.name, content))
    notes = [f"sheet '{chosen}' of {len(sheets)}; save another as CSV"] if len(sheets) > 1 else []
    about = {**result.metadata, "read_as": [*notes, *result.metadata.get("read_as", ())]}
    return replace(result, source=source, format="excel", metadata=about if about["read_as"] else result.metadata)


def read_text(source: InputFile) -> SpectrumTable:
    """Read a table of one wavelength column and one or more spectra, with or without a header line.

    Lines that begin with '#', '%' or '!' are comments; the one above the data may be the header. Raises DataError
    naming line and column for anything that is not such a table.
    """
    lines, comments = split_lines(inputs.text(source))
    if not lines:
        raise DataError(f"{source.name}: holds only comments; check how it was made or downloaded")
    if len(parts := tables_in(lines)) > 1:
        return _one_after_another(parts, source)
    table = text_table(lines, source.name)
    separator = table.separator
    notes = (*(comment for _, comment in comments), *table.about)
    about: dict[str, Any] = {"comments": [one[:_COMMENT_LENGTH] for one in notes[:_MOST_COMMENTS] if one]}
    if keys := table.keys:
        about["keys"] = keys
    if in_rows := spectra_in_rows(table, source, about):
        return in_rows
    names: list[str] | None
    if table.names:
        names, body = table.names, table.lines
    else:
        names, body = header_and_body(table.lines, comments, separator, source.name)
    values = numbers_at_once(body, separator)
    rows: list[Row] = []
    if values is None or len(values) < 2 or np.isnan(values[-1]).all() or len(names or values) != len(values):
        values = None
        names, rows = _rows(names, body, separator, source.name)
    if names and rows:
        names, rows = _percent_cells(names, rows)
    width = len(rows[0].fields) if values is None else len(values)
    _warn_of_commented_rows(body, comments, separator, source.name)
    titles = names or [""] * width

    def column(k: int) -> Column:
        if values is not None:
            return Column(titles[k], values[k], k + 1)
        label = quoted(titles[k]) if titles[k] else str(k + 1)
        return Column(titles[k], numbers(rows, k, label, source.name, separator in DECIMAL_COMMA), k + 1)

    places = tuple(f"line {line}" for line, _ in body)
    if names is None:
        first = replace(column(0), unit="cm-1" if Path(source.name).suffix.lower() == OPUS else None)
        return unnamed([first, *(column(k) for k in range(1, width))], source, places, about)
    if groups := wavelength_groups(names):
        return on_one_grid([[column(k) for k in group] for group in groups], source, about)
    if stacked := one_below_another(names, rows, separator, source.name):
        return on_one_grid(stacked, source, about, f"{len(stacked)} spectra one below another, by their names")
    texts = _texts(rows) if any(map(is_wavelength, names)) else []
    texts += [k for k, name in enumerate(names) if not name and np.isnan(column(k).values).all()]
    roles = assign_roles(names, source, left_out=texts)
    block = None if values is None else _block(values, [r for r, _ in roles.spectra])
    return roles.table(source, "text", column, places, about, block)


def _one_after_another(parts: Sequence[Lines], source: InputFile) -> SpectrumTable:
    """Tables of one header that stand below each other, each with what stands above it as its name."""
    groups = list[list[Column]]()
    for part in parts:
        lines = [line for _, line in part]
        result = read_text(InputFile(source.name, "\n".join(lines).encode()))
        begin = next(k for k, line in enumerate(lines) if is_numeric(line))
        name = lines[begin - 2] if begin > 1 else f"table {len(groups) + 1}"
        columns = [result.wavelength]
        for k, (column, sigma) in enumerate(result.spectra):
            title = name if len(result.spectra) == 1 else f"{name} {column.name or k + 1}"
            unit = stated_unit(column)
            columns.append(Column(title, column.values, 1 + len(columns) + sum(map(len, groups)), unit))
            columns += [] if sigma is None else [Column(f"{title}_sigma", sigma.values, sigma.position, unit)]
        groups.append(columns)
    return on_one_grid(groups, source, {}, f"{len(parts)} tables one after another, each a spectrum or more")


def _percent_cells(names: list[str], rows: list[Row]) -> tuple[list[str], list[Row]]:
    """Names with the sign of percent where all cells of a column end in it, and the rows without it."""
    signed = [k for k in range(len(names)) if rows[0].fields[k].endswith("%")]
    signed = [k for k in signed if all(row.fields[k].endswith("%") or is_missing(row.fields[k]) for row in rows)]
    if not signed:
        return names, rows
    names = [f"{name} [%]" if k in signed and "%" not in name else name for k, name in enumerate(names)]
    return names, [Row(row.line, tuple(cell.rstrip("% ") for cell in row.fields)) for row in rows]


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
        warn(
            f"{file}: left out {len(lost)} lines among the data that begin as comments do, the first is line {lost[0]}",
        )


def _block(values: FloatArray, places: Sequence[int]) -> FloatArray:
    """Some rows of an array, as they lie there where they are next to each other."""
    side_by_side = places[-1] - places[0] == len(places) - 1
    return values[places[0] : places[-1] + 1] if side_by_side else values[places]


def header_and_body(
    lines: Sequence[tuple[int, str]], comments: Sequence[tuple[int, str]], separator: str, file: str
) -> tuple[list[str] | None, Sequence[tuple[int, str]]]:
    """Names of the columns, if there are any, and the lines of numbers."""
    first = _row(lines[0], separator, file)
    if not _is_header(first, separator in DECIMAL_COMMA):
        return _names_in_comment(comments, separator, first, file), lines
    if len(lines) == 1:
        raise DataError(f"{file}: holds a header and no data rows; check how it was made or downloaded")
    if _is_header(_row(lines[1], separator, file), separator in DECIMAL_COMMA):
        _check_one_header(lines, separator, first, file)
    width = len(_row(lines[1], separator, file).fields)
    return _names(lines[0][1], separator, width, f"{file}: line {first.line}"), lines[1:]


def _check_one_header(lines: Sequence[tuple[int, str]], separator: str, first: Row, file: str) -> None:
    """Raises DataError for lines of text before the table that are not as wide as it, or have other names."""
    above, begin = first, None
    for row in (_row(line, separator, file) for line in lines):
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


def _row(line: tuple[int, str], separator: str, file: str) -> Row:
    return Row(line[0], split_fields(line[1], separator, f"{file}: line {line[0]}"))


def _rows(
    names: list[str] | None, body: Sequence[tuple[int, str]], separator: str, file: str
) -> tuple[list[str] | None, list[Row]]:
    """Names and the fields of each line, one width everywhere."""
    names, rows = _without_last_empty(names, [_row(line, separator, file) for line in body])
    if names and all(len(row.fields) == len(names) + 1 for row in rows) and _are_row_names(rows):
        names = ["", *names]
    if check_widths(rows, file, None if names is None else len(names)) < 2:
        raise DataError(f"{file}: has one column; a spectrum needs a wavelength and a reflectance column")
    return names, rows


def _are_row_names(rows: Sequence[Row]) -> bool:
    """Whether the first cells number the rows, as R writes them without a name."""
    return all(row.fields[0] == str(k) for k, row in enumerate(rows, 1))


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
    """Names of columns in the last comment above the first row, where it has as many as that; else None."""
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
