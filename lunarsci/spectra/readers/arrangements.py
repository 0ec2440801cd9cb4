"""Where in a text its table is, what stands around it, and how spectra lie in it.

Spectrometers write lines of `key: value`, names and units above and lines of text below the numbers: SED of PSR and
PSM, SIG of SVC, ASD's ViewSpec, ECOSTRESS and ASTER libraries, RELAB. Spectra lie in columns, in rows with wavelengths
in the header, as pandas and chemometricians write them, each with wavelengths of its own, or in columns without names.
pandas reads a table only where somebody says where it is; no library tells these apart.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.columns import ERROR_SHARE, LARGE_ERROR, assign_roles, is_wavelength, says_error
from lunarsci.spectra.readers.likely import FEWEST
from lunarsci.spectra.readers.table import SURELY, Column, SpectrumTable, length_unit, only_percent, stated_unit
from lunarsci.spectra.rows import (
    DECIMAL_COMMA,
    UNITS,
    Row,
    is_missing,
    number,
    numbers,
    quoted,
    separator_of,
    split_fields,
)

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
        result = (_KEY.match(line) for line in self.about)
        return {one[1].strip(): one[2].strip() for one in result if one}


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
    result = _by_keys(about, width) or names or units
    return replace(table, lines=body, names=result or None, about=about)


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


MOST_COMPARED, SAME = 6, 2e-4
"""Columns among which quotients are looked for, and relative difference that rounding makes; assumed."""
_BEGINS = re.compile(r"(wavelengths?|wave|wl|wvl|wav|lambda)[ _.-]", re.IGNORECASE)
_NUMBERED = re.compile(r"[ _.-]?\d+$")
_UNIT = r"nm|um|µm|μm|micron\w*|nanomet\w+|micromet\w+"
_CHANNEL = re.compile(
    rf"[A-Za-z_. ]{{0,12}}?(\d+(?:[.,]\d+)?)\s*({_UNIT})?|.*[\s(\[](\d+(?:[.,]\d+)?)\s*({_UNIT})\s*[)\]]?",
    re.IGNORECASE,
)
"""A number alone or after a short word; or after any words, as those of a band, where a unit follows."""


def spectra_in_rows(table: TableInText, source: InputFile, about: dict[str, Any]) -> SpectrumTable | None:
    """The spectra of a table whose header has wavelengths, one in each row; None for any other table."""
    header, *lines = table.lines
    if table.names or not lines:
        return None
    names = split_fields(header[1], table.separator, f"{source.name}: line {header[0]}")
    channels, wavelength, unit = header_channels(names) or ([], np.empty(0), None)
    if not channels:
        return None
    rows = [Row(n, split_fields(line, table.separator, f"{source.name}: line {n}")) for n, line in lines]
    decimal = table.separator in DECIMAL_COMMA
    texts = [k for k in range(len(names)) if k not in channels and any(_is_text(row, k, decimal) for row in rows)]
    if len({len(row.fields) for row in rows} | {len(names)}) > 1 or (not texts and _first_is_wavelength(names, rows)):
        return None
    label = texts[0] if texts else next((k for k in range(len(names)) if k not in channels), None)
    values = np.array([numbers(rows, k, quoted(names[k]), source.name, decimal) for k in channels]).T
    errors = {k: k - 1 for k, row in enumerate(rows) if k > 0 and any(says_error(row.fields[t]) for t in texts)}
    errors = {k: of for k, of in errors.items() if of not in errors}
    sigma = {of: Column("", values[k], k + 1) for k, of in errors.items()}
    used = [k for k in range(len(rows)) if k not in errors]
    rows, values = [rows[k] for k in used], values[used]
    ids = [row.fields[label] if label is not None else "" for row in rows]
    ids = ids if len({*ids}) == len(ids) else [""] * len(ids)
    if not texts:
        ids = [id and f"row {id}" for id in ids]
    notes = f"wavelengths in the header, {len(rows)} spectra in rows; give the table with spectra in columns otherwise"
    return SpectrumTable(
        source, "text", Column("wavelength", wavelength, 1, unit),
        tuple((Column(id, one, k + 1), sigma.get(k)) for k, id, one in zip(used, ids, values, strict=True)),
        tuple(f"column {k + 1}" for k in channels), {**about, "read_as": [notes]},
    )  # fmt: skip


def _is_text(row: Row, place: int, decimal: bool) -> bool:
    cell = row.fields[place] if place < len(row.fields) else ""
    return not is_missing(cell) and number(cell, decimal) is None


def header_channels(names: Sequence[str]) -> tuple[list[int], FloatArray, str | None] | None:
    """Places of names that are wavelengths, these and their unit; None where they are few or in no order."""
    result = [(k, match) for k, name in enumerate(names) if (match := _CHANNEL.fullmatch(name.strip()))]
    values = np.array([float((match[1] or match[3]).replace(",", ".")) for _, match in result])
    if values.size < FEWEST or abs(np.sign(np.diff(values)).sum()) != values.size - 1:
        return None
    if not any(low <= values.min() and values.max() <= high for low, high in SURELY.values()):
        return None
    units = {length_unit(match[2] or match[4]) for _, match in result if match[2] or match[4]}
    return [k for k, _ in result], values, units.pop() if len(units) == 1 else None


def _first_is_wavelength(names: Sequence[str], rows: Sequence[Row]) -> bool:
    """Whether the first column rather than the header has the wavelengths."""
    first = np.array([value for row in rows[:50] if (value := number(row.fields[0].replace(",", "."))) is not None])
    steps = np.sign(np.diff(first))
    one_way = first.size > 1 and abs(steps.sum()) == steps.size
    likely = one_way and any(low <= first.min() and first.max() <= high for low, high in SURELY.values())
    return is_wavelength(names[0]) or (likely and number(names[0]) is None and len(rows) >= FEWEST)


def wavelength_groups(names: Sequence[str]) -> list[list[int]]:
    """Places of the columns of each spectrum, its wavelengths first, where each has its own; none for another table."""
    starts = [k for k, name in enumerate(names) if is_wavelength(_NUMBERED.sub("", name))]
    if len(starts) < 2 and names[0]:
        same = [k for k, name in enumerate(names) if name == names[0]]
        first = [k for k, name in enumerate(names) if _BEGINS.match(name)]
        starts = max(same, first, key=len)
        starts = starts if len({*np.diff([*starts, len(names)]).tolist()}) == 1 else []
    if len(starts) < 2 or starts[0] > 0:
        return []
    groups = [list(range(low, high)) for low, high in zip(starts, [*starts[1:], len(names)], strict=True)]
    return groups if min(map(len, groups)) > 1 else []


def one_below_another(names: Sequence[str], rows: Sequence[Row], separator: str, file: str) -> list[list[Column]]:
    """The columns of each spectrum of a table with names of spectra in its rows and wavelengths that come again."""
    decimal = separator in DECIMAL_COMMA
    labels = [k for k in range(len(names)) if rows and all(_is_text(row, k, decimal) for row in rows)]
    place = next((k for k, name in enumerate(names) if is_wavelength(name)), None)
    if not labels or place is None:
        return []
    each = dict[str, list[Row]]()
    for row in rows:
        each.setdefault(row.fields[labels[0]], []).append(row)
    wavelengths = Counter(row.fields[place] for row in rows)
    if len(each) < 2 or len(each) * FEWEST > len(rows) or max(wavelengths.values()) < 2:
        return []
    others = [k for k in range(len(names)) if k != place and k not in labels]
    result = list[list[Column]]()
    for id, its_rows in each.items():
        titles = [id if len(others) == 1 or k == others[0] else f"{id} {names[k]}" for k in others]
        columns = [Column(names[place], numbers(its_rows, place, quoted(names[place]), file, decimal), place + 1)]
        for title, k in zip(titles, others, strict=True):
            columns.append(Column(title, numbers(its_rows, k, quoted(names[k]), file, decimal), k + 1))
        result.append(columns)
    return result


def on_one_grid(
    groups: Sequence[Sequence[Column]],
    source: InputFile,
    about: dict[str, Any],
    notes: str = "",
    format: str = "text",
) -> SpectrumTable:
    """Spectra with wavelengths of their own on the wavelengths of all, missing where they have none."""
    grids = [group[0].values for group in groups]
    every = np.unique(np.concatenate(grids))
    every = every[np.isfinite(every)]
    spectra = list[tuple[Column, Column | None]]()
    for wavelength, *others in groups:
        roles = assign_roles([wavelength.name, *(one.name for one in others)], source, wavelength=0)
        finite = np.isfinite(wavelength.values)
        place = np.searchsorted(every, wavelength.values[finite])
        if np.unique(place).size < place.size:
            raise DataError(f"{source.name}: column {wavelength.label} repeats a wavelength; keep one row of each")

        def spread(column: Column, finite: Any = finite, place: Any = place) -> Column:
            values = np.full(every.size, np.nan)
            values[place] = column.values[finite]
            return Column(column.name, values, column.position, column.unit)

        spectra += [(spread(others[r - 1]), None if s is None else spread(others[s - 1])) for r, s in roles.spectra]
    names = [one.name for one, _ in spectra]
    spectra = [(c if names.count(c.name) == 1 else _without_name(c), s) for c, s in spectra]
    notes = notes or f"{len(groups)} columns of wavelengths: each read as those of the columns up to the next"
    places = tuple(f"wavelength {value:g}" for value in every)
    first = groups[0][0]
    wavelength = Column(first.name, every, first.position, first.unit)
    about = {**about, "read_as": [notes]} if len(groups) > 1 else about
    return SpectrumTable(source, format, wavelength, tuple(spectra), places, about)


def _without_name(column: Column) -> Column:
    """A column that keeps the unit that its name states."""
    return Column("", column.values, column.position, stated_unit(column))


def unnamed(
    columns: Sequence[Column], source: InputFile, places: tuple[str, ...], about: dict[str, Any]
) -> SpectrumTable:
    """The table of columns without names: wavelength, then spectra; errors and counts are known by their numbers.

    Raises DataError for a third and last column that could be the errors of the second as well as a spectrum.
    """
    wavelength, *others = columns
    notes, counts = (
        list[str](),
        [k for k, one in enumerate(others) if k > 0 and _is_count(one.values, others[0].values)],
    )
    if counts:
        listed = ", ".join(str(others[k].position) for k in counts)
        notes.append(f"column {listed} without a name read as a count, left out; name the columns to decide otherwise")
    retained = [one for k, one in enumerate(others) if k not in counts]
    retained = _without_copies(retained, notes)
    spectra: list[tuple[Column, Column | None]] = [(one, None) for one in retained]
    shares = [_share(a.values, b.values) for a, b in zip(retained[::2], retained[1::2], strict=False)]
    if len(retained) == 2 * len(shares) > 0 and all(share <= ERROR_SHARE for share in shares):
        spectra = list(zip(retained[::2], retained[1::2], strict=True))
        each = ", ".join(f"{sigma.position} of {one.position}" for one, sigma in spectra[:3] if sigma)
        notes.append(f"columns without names read as errors: {each}; name the columns to decide otherwise")
    elif len(retained) == 2 and shares[0] < LARGE_ERROR:
        raise DataError(
            f"{source.name}: three columns without names: the third may be a spectrum or a standard deviation; add a "
            "header line such as wavelength_nm,reflectance,reflectance_sigma"
        )
    elif len(retained) > 1:
        notes.append(f"{len(retained)} columns without names read as spectra; name the columns to decide otherwise")
    about = {**about, "read_as": notes} if notes else about
    return SpectrumTable(source, "text", wavelength, tuple(spectra), places, about)


def _without_copies(columns: Sequence[Column], notes: list[str]) -> list[Column]:
    """Columns less those that repeat one before them; one that is the quotient of two others is said to be."""
    retained, copies = list[Column](), list[str]()
    for one in columns:
        same = next((other for other in retained if np.array_equal(one.values, other.values, equal_nan=True)), None)
        if same is None:
            retained.append(one)
        else:
            copies.append(f"{one.position} of {same.position}")
    if copies:
        notes.append(f"columns without names that repeat others left out: {', '.join(copies)}")
    for ratio, over, under in permutations(retained, 3) if len(retained) <= MOST_COMPARED else ():
        if over.position < under.position and _is_quotient(ratio.values, over.values, under.values):
            notes.append(f"column {ratio.position} is column {over.position} over {under.position}, a ratio of spectra")
    return retained


def _is_quotient(ratio: FloatArray, over: FloatArray, under: FloatArray) -> bool:
    """Whether one column is another over a third, to the digits that files have."""
    with np.errstate(all="ignore"):
        off = np.abs(ratio * under / over - 1.0)
    return bool(np.ptp(ratio) > 0 and np.median(off[np.isfinite(off)]) < SAME) if np.isfinite(off).any() else False


def _is_count(values: FloatArray, first: FloatArray) -> bool:
    """Whether all are whole numbers, from 0 on, beside a spectrum that has others."""
    finite = values[np.isfinite(values)]
    fractions = (first[np.isfinite(first)] % 1.0 != 0.0).any()
    return bool(finite.size > 1 and (finite % 1.0 == 0.0).all() and (finite >= 0).all() and 1 <= finite.max() < 1e4
                and (fractions or (finite == finite[0]).all()))  # fmt: skip


def _share(values: FloatArray, beside: FloatArray) -> float:
    """Median of one column over another, where both are above 0; infinite where they are nowhere."""
    with np.errstate(invalid="ignore"):
        both = (values > 0) & (beside > 0)
    return float(np.median(beside[both] / values[both])) if both.any() else np.inf
