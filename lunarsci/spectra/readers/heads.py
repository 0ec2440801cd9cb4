"""What stands around a table in a file of text: lines of `key: value`, names, units, and lines below the numbers.

Spectrometers export so: SED of PSR and PSM, SIG of SVC, ASD's ViewSpec, ECOSTRESS and ASTER libraries, RELAB. pandas
reads a table only where somebody says how many lines are before it, and which of them has the names.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from lunarsci.errors import DataError
from lunarsci.spectra.readers.columns import is_wavelength
from lunarsci.spectra.readers.table import length_unit, only_percent
from lunarsci.spectra.rows import UNITS, number, separator_of, split_fields

Lines = Sequence[tuple[int, str]]
FEWEST_ROWS = 3
"""Lines of numbers, one after the other, that begin a table; assumed."""
_SEPARATOR = re.compile(r'^"?sep=(.)"?$', re.IGNORECASE)
_CELLS = re.compile(r"[\t;]\s*|\s+|,\s*")
_OF_NUMBERS = "0123456789.+-"
_AXIS = re.compile(r"^\W*([xy])\W?\s*units?\s*(?:[:=]|\t)\s*(\S.*)$", re.IGNORECASE)
_COLUMN = re.compile(r"^\W*col(?:umn|\.)?\s*(\d+)\s*[:=]\s*(\S.*?)(?:~~\d+)?$", re.IGNORECASE)
_KEY = re.compile(r"^([^:=]{1,60}?)\s*[:=]\s*(.*)$")
_SVC = re.compile(r"spectra vista|^\W*SIG data", re.IGNORECASE)
SVC_COLUMNS = ("Wavelength (nm)", "Reference radiance", "Target radiance", "Reflectance (%)")
"""The columns of a SIG file, which have no names there: Spectra Vista Corporation, SVC HR-1024i user manual."""
_UNITS = {*UNITS, "-", "--", "fraction", "reflectance", "å", "angstrom", "cm-1", "w/m^2/nm/sr", "dn", "unitless", ""}


@dataclass(frozen=True, slots=True)
class TableInText:
    """A table in a text.

    Attributes
    ----------
    lines : numbered lines of the table: names, where `named`, and numbers.
    separator : between its columns.
    names : of the columns, where they are not in the first line.
    about : lines above and below it.
    """

    lines: Lines
    separator: str
    names: list[str] | None = None
    about: tuple[str, ...] = ()

    @property
    def keys(self) -> dict[str, str]:
        """What lines of `key: value` say."""
        found = (_KEY.match(line) for line in self.about)
        return {one[1].strip(): one[2].strip() for one in found if one}


def text_table(lines: Lines, file: str) -> TableInText:
    """The table in lines that are no comments. Raises DataError where there is nothing but a separator."""
    separator = None
    if stated := _SEPARATOR.match(lines[0][1]):
        lines, separator = lines[1:], stated[1]
        if not lines:
            raise DataError(f"{file}: holds no lines but the separator; check how it was made")
    begin = _begin(lines)
    body, below = _without_tail(lines, begin)
    separator = separator or separator_of(body[max(begin - 1, 0) :])
    table = TableInText(body, separator, about=tuple(line for _, line in below))
    return table if begin < 2 else _with_head(table, _first_row(body, begin, separator, file), file)


def tables_in(lines: Lines) -> list[Lines]:
    """Tables one after another that have one and the same line above their numbers; the lines as they are, if not."""
    begin = _begin(lines)
    if all(line[:1] in _OF_NUMBERS for _, line in lines[begin + 1 :]):  # most tables, soon told
        return [lines]
    numeric = [is_numeric(line) for _, line in lines]
    heads = [k for k in range(1, len(lines) - FEWEST_ROWS) if not numeric[k - 1] and all(numeric[k : k + FEWEST_ROWS])]
    names = {lines[k - 1][1] for k in heads}
    if len(heads) < 2 or len(names) > 1:
        return [lines]
    ends = [max(k for k in range(head) if numeric[k]) + 1 for head in heads[1:]]
    return [lines[low:high] for low, high in pairwise([0, *ends, len(lines)])]


def is_numeric(line: str) -> bool:
    """Whether a line begins with two numbers, or a number and nothing after a separator."""
    cells = _CELLS.split(line.strip(), 2)
    values = [number(cell.replace(",", ".")) for cell in cells[:2]]
    return len(cells) > 1 and number(cells[0]) is not None and cells[0] != "" and values[1] is not None


def _begin(lines: Lines) -> int:
    """Place of the first of some lines of numbers; 0 where there are none."""
    row = 0
    for place, (_, line) in enumerate(lines):
        row = row + 1 if is_numeric(line) else 0
        if row == FEWEST_ROWS:
            return place + 1 - FEWEST_ROWS
    return 0


def _without_tail(lines: Lines, begin: int) -> tuple[Lines, Lines]:
    """Lines up to the last one of numbers, and lines of text below: other in width, or with a key."""
    end = len(lines)
    while end > begin + FEWEST_ROWS and not is_numeric(lines[end - 1][1]):
        end -= 1
    tail = lines[end:]
    if not tail:
        return lines, ()
    separator = separator_of(lines[begin:end])
    by = None if separator == " " else separator
    width, words = len(lines[begin][1].split(by)), [line for _, line in tail]
    # A first line as wide as the table, or one that begins with a digit, is a row that is spoilt.
    spoilt = len(words[0].split(by)) == width or any(
        line[:1].isdigit() or (any(map(str.isdigit, line)) and not any(map(str.isalpha, line))) for line in words
    )
    return (lines, ()) if spoilt else (lines[:end], tail)


def _first_row(lines: Lines, begin: int, separator: str, file: str) -> int:
    """Place of the first row: `begin`, or above it that of one that is spoilt, a word among numbers below the names."""
    width, named = len(split_fields(lines[begin][1], separator, file)), False
    for place, (line, text) in enumerate(lines[:begin]):
        cells = split_fields(text, separator, f"{file}: line {line}")
        values = [number(cell.replace(",", ".")) is not None and any(map(str.isdigit, cell)) for cell in cells]
        decimal = any("." in cell for cell, is_one in zip(cells, values, strict=True) if is_one)
        if named and len(cells) == width and (values[0] or decimal):
            return place
        named = named or (len(cells) == width and is_wavelength(cells[0]))
    return begin


def _with_head(table: TableInText, begin: int, file: str) -> TableInText:
    """A table with several lines above its numbers; names are those of the lowest line as wide as it, with units."""
    head, body = table.lines[:begin], table.lines[begin:]
    width = len(split_fields(body[0][1], table.separator, file))
    about = (*(line for _, line in head), *table.about)
    names, units, rows = list[str](), list[str](), list[list[str]]()
    for line, text in reversed(head):
        cells = list(split_fields(text, table.separator, f"{file}: line {line}"))
        if table.separator == " " and len(cells) != width:
            cells = [cell.strip() for cell in re.split(r"\s{2,}|\t|,\s*", text)]
        if len(cells) != width or "=" in text or ":" in cells[0] or _is_prose(cells):
            continue
        if not units and not rows and {cell.strip("()[] ").casefold() for cell in cells} <= _UNITS:
            units = [cell.strip("()[] ") for cell in cells]
            continue
        rows.append(cells)
    if rows:
        spectral = [k for k, cells in enumerate(rows) if is_wavelength(cells[0])]
        at = spectral[0] if spectral else 0
        names = _named_above(rows[at], rows[at + 1 :])
    if names and units:
        names = [f"{name} [{unit}]" if unit.strip("-") else name for name, unit in zip(names, units, strict=True)]
    found = _by_keys(about, width) or names or units
    return replace(table, lines=body, names=found or None, about=about)


def _is_prose(cells: Sequence[str]) -> bool:
    """Whether cells are words of a sentence: one cuts brackets apart."""
    return any(cell.count("(") != cell.count(")") for cell in cells)


def _named_above(names: list[str], above: Sequence[list[str]]) -> list[str]:
    """Names of columns of which some are alike, with what a line above them says of each, or of each pair."""
    if len({*names}) == len(names):
        return names
    for cells in above:
        groups = [k for k, name in enumerate(names) if name == names[0]]
        pairs = len(groups) > 1 and [bool(cell) for cell in cells] == [k in groups for k in range(len(cells))]
        if len({*cells}) == len(cells) or pairs:
            titles = [cells[k - 1] if pairs and k - 1 in groups else cell for k, cell in enumerate(cells)]
            titles = [f"{cell} [%]" if only_percent(low) else cell for cell, low in zip(titles, names, strict=True)]
            return [name if k == 0 or (pairs and k in groups) else titles[k] for k, name in enumerate(names)]
    return names


def _by_keys(about: Sequence[str], width: int) -> list[str]:
    """Names of columns by lines of the head: of each by its number, units of x and y, or the layout of SVC."""
    if width == len(SVC_COLUMNS) and any(map(_SVC.search, about)):
        return list(SVC_COLUMNS)
    numbered = {int(match[1]): match[2] for match in map(_COLUMN.match, about) if match}
    if {*numbered} == {*range(1, width + 1)}:
        return [numbered[k + 1] for k in range(width)]
    for one, other in pairwise(about):
        if width == 2 and length_unit(one) and only_percent(other):
            return [one, other]
    axes = {match[1].casefold(): match[2].strip() for match in map(_AXIS.match, about) if match}
    return [axes["x"], axes["y"]] if width == 2 and {"x", "y"} <= {*axes} else []
