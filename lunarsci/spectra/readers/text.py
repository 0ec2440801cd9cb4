"""Text tables of spectra: CSV, TSV, semicolons with decimal commas, or blanks between the columns."""

import re
from collections.abc import Sequence

from lunarsci import inputs
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.columns import Roles, assign_roles, is_wavelength
from lunarsci.spectra.readers.table import Column, SpectrumTable
from lunarsci.spectra.rows import (
    Row,
    check_widths,
    is_missing,
    number,
    numbers,
    quoted,
    separator_of,
    split_fields,
    split_lines,
)

_NAME = re.compile(r'"([^"]*)"|([^\s(\[{]+(?:\s*[(\[{][^)\]}]*[)\]}])?)')
_COMMENTS_KEPT = 100
_COMMENT_LENGTH = 200


def read_text(source: InputFile) -> SpectrumTable:
    """Read a table of one wavelength column and one or more spectra, with or without a header line.

    Lines that begin with '#', '%' or '!' are comments; the one above the data may be the header. Raises DataError
    naming line and column for anything that is not such a table.
    """
    lines, comments = split_lines(inputs.text(source))
    if not lines:
        raise DataError(f"{source.name}: holds only comments; check how it was made or downloaded")
    separator = separator_of(lines)
    names, rows = _header_and_rows(lines, comments, separator, source.name)
    roles = _roles_without_names(len(rows[0].fields), source.name) if names is None else assign_roles(names, source)
    titles = names or [""] * len(rows[0].fields)

    def column(k: int) -> Column:
        label = quoted(titles[k]) if titles[k] else str(k + 1)
        return Column(titles[k], numbers(rows, k, label, source.name, separator == ";"), k + 1)

    return SpectrumTable(
        source,
        "text",
        column(roles.wavelength),
        tuple((column(r), None if s is None else column(s)) for r, s in roles.spectra),
        tuple(f"line {row.line}" for row in rows),
        {"comments": [c[:_COMMENT_LENGTH] for _, c in comments[:_COMMENTS_KEPT] if c]},
        roles.systematic_columns(column),
    )


def _header_and_rows(
    lines: Sequence[tuple[int, str]], comments: Sequence[tuple[int, str]], separator: str, file: str
) -> tuple[list[str] | None, list[Row]]:
    rows = [Row(n, split_fields(line, separator, f"{file}: line {n}")) for n, line in lines]
    first = rows[0]
    has_header = _is_header(first, separator == ";")
    body = rows[1:] if has_header else rows
    if not body:
        raise DataError(f"{file}: holds a header and no data rows; check how it was made or downloaded")
    names = (
        _names(lines[0][1], separator, len(body[0].fields), f"{file}: line {first.line}")
        if has_header
        else _names_in_comment(comments, separator, first, file)
    )
    names, body = _without_last_empty(names, body)
    if check_widths(body, file, None if names is None else len(names)) < 2:
        raise DataError(f"{file}: has one column; a spectrum needs a wavelength and a reflectance column")
    return names, body


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
