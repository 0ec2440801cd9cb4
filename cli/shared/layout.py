"""Tables that fit the terminal: which columns stay where there is no room for all, and where sentences go."""

import dataclasses
import shutil
import textwrap
from collections.abc import Mapping, Sequence

from lunarsci.printable import printable

from .table import TextTable, bare

GAP = 2
"""Blanks between columns."""
SENTENCE = 24
"""Characters from which a cell of several words is a sentence; assumed."""
LEAST = 8
"""Characters that a shortened cell keeps at least."""
RANKS: Mapping[str, int] = {
    header: rank
    for rank, headers in {
        1: "strength, FWHM, BC1000, BC2000, BD1000, BD2000, posterior, prior, ln BF, i, e, g, limit, unit, verdict, "
        "95 % of drives, kept, *, bias, wheel, in 90 % bands, median, 68 %, value, status, mineral, share, F_N, F_DP, "
        "slip, sinkage, F_N balanced, F_DP balanced, F_L balanced, determined, states",
        3: "area1000, area2000, spread at 1 µm, spread at 2 µm, rms ln R, shrinkage of centre, margin, p50, channels, "
        "range, ejecta, main route, Sun, step, gain, F_N assumed, F_DP assumed, F_L assumed, rms, plan, surprise, "
        "ground's own 68 %, F_N from p05 to p95, F_DP from p05 to p95, F_L from p05 to p95, M_R from p05 to p95, "
        "sinkage from p05 to p95, slip from p05 to p95, side slip from p05 to p95, picture, truth, x, y",
        4: "shrinkage of FWHM, continuum at 1 µm, continuum at 2 µm, azimuth, limit from, worth, n, CRPS, "
        "source, quantity, forgotten before, what, remark, rms sd",
    }.items()
    for header in headers.split(", ")
}
"""Columns that go later (1) or sooner (3, 4) than others (2) where there is no room; of equals the right one goes
first. Those of 4 go before sentences become footnotes. The first column of a table always stays."""
DISPENSABLE = 4


def terminal_width() -> int:
    """Columns of the terminal, or of the variable COLUMNS; 0 where neither says, as for a pipe: then nothing is cut."""
    return shutil.get_terminal_size(fallback=(0, 0)).columns


def fitted(table: TextTable, width: int, *, keep: bool = False) -> TextTable:
    """The table with lines of at most `width` characters; 0: as it is. With `keep` all columns stay, shortened.

    In turn, as far as needed: sentences become footnotes, one row is turned to a list, columns are left out and named,
    cells are shortened.
    """
    if width <= 0:
        return table
    made = table
    footnotes: dict[str, str] = {}
    if _width(made) > width and len(made.rows) == 1 and len(made.headers) > 2:
        made = _upright(made)
    elif _width(made) > width:
        made = made if keep else _narrowed(made, width, DISPENSABLE)
        if _width(made) > width:
            made, footnotes = _with_letters(made)
        made = made if keep else _narrowed(made, width)
        gone = [header for header in table.headers if header not in made.headers]
        made = _noted(made, [*_explained(made, footnotes), *_left_out(gone)])
    made = _shortened(made, width)
    return _wrapped(_narrowed(made, width) if _width(made) > width else made, width)


def _noted(table: TextTable, notes: Sequence[str]) -> TextTable:
    return dataclasses.replace(table, notes=[*notes, *table.notes])


def _width(table: TextTable) -> int:
    return sum(widths := _widths(table)) + GAP * (len(widths) - 1) if table.headers else 0


def _widths(table: TextTable) -> list[int]:
    from rich.cells import cell_len

    shown = [table.headers, *table.shown]
    return [max(1, *(cell_len(printable(row[k])) for row in shown)) for k in range(len(table.headers))]


def _is_sentence(cell: str) -> bool:
    return len(cell) > SENTENCE and sum(len(word) > 1 and word.strip(",;:.'").isalpha() for word in cell.split()) > 2


def _with_letters(table: TextTable) -> tuple[TextTable, dict[str, str]]:
    """A letter in place of each sentence, and the sentences by their letters."""
    spoken = range(1, len(table.headers))
    texts = dict.fromkeys(row[k] for row in table.shown for k in spoken if _is_sentence(row[k]))
    letters = {text: _letter(number) for number, text in enumerate(texts)}
    rows = [[row[0], *(letters.get(cell, cell) for cell in row[1:])] for row in table.shown]
    made = dataclasses.replace(table, rows=rows, total=table.count)
    return made, {letter: text for text, letter in letters.items()}


def _explained(table: TextTable, footnotes: Mapping[str, str]) -> list[str]:
    """Notes of the letters that are in the table."""
    seen = {cell for row in table.rows for cell in row}
    return [f"{letter}: {text}" for letter, text in footnotes.items() if letter in seen]


def _letter(number: int) -> str:
    """a to z, then aa, ab and so on."""
    before, last = divmod(number, 26)
    return (_letter(before - 1) if before else "") + "abcdefghijklmnopqrstuvwxyz"[last]


def _upright(table: TextTable) -> TextTable:
    """A table of one row as a list of its columns; sentences go below."""
    pairs = list(zip(table.headers, table.rows[0], strict=True))
    rows = [[header, cell] for header, cell in pairs[1:] if not _is_sentence(cell)]
    notes = [f"{header}: {cell}" if header else cell for header, cell in pairs[1:] if _is_sentence(cell)]
    return _noted(dataclasses.replace(table, headers=pairs[0], rows=rows), notes)


def _narrowed(table: TextTable, width: int, dispensable: int = 0) -> TextTable:
    """The table without the columns that matter least, of such a rank or a later one, until the others fit."""
    widths = _widths(table)
    ranks = [RANKS.get(bare(header), 2) for header in table.headers]
    left = list(range(len(widths)))
    order = sorted((k for k in left[1:] if ranks[k] >= dispensable), key=lambda k: (ranks[k], k))
    while order and sum(widths[k] for k in left) + GAP * (len(left) - 1) > width and len(left) > 2:
        left.remove(order.pop())
    rows = [[row[k] for k in left] for row in table.rows]
    return dataclasses.replace(table, headers=[table.headers[k] for k in left], rows=rows)


def _left_out(gone: Sequence[str]) -> list[str]:
    """A note that names the columns left out, if there are any."""
    more = "1 more column" if len(gone) == 1 else f"{len(gone)} more columns"
    return [f"{more} ({', '.join(map(bare, gone))}): --csv, or a wider terminal"] if gone else []


def _shortened(table: TextTable, width: int) -> TextTable:
    """The table with its widest cells cut in their middle, where it is too wide still."""
    if (over := _width(table) - width) <= 0:
        return table
    widths = _widths(table)
    while over > 0 and max(widths) > LEAST:
        k = widths.index(max(widths))
        widths[k] -= 1
        over -= 1
    rows = [[_cut(cell, most) for cell, most in zip(row, widths, strict=True)] for row in table.shown]
    headers = [_cut(header, most) for header, most in zip(table.headers, widths, strict=True)]
    note = "… stands for what is left out of a cell: --csv, or a wider terminal"
    return _noted(dataclasses.replace(table, headers=headers, rows=rows, total=table.count), [note])


def _cut(cell: str, most: int) -> str:
    end = (most - 1) // 2
    return cell if len(cell) <= most else f"{cell[: most - 1 - end]}…{cell[len(cell) - end :]}"


def _wrapped(table: TextTable, width: int) -> TextTable:
    """Title and notes broken between words."""
    notes = [line for note in (*table.left_out, *table.notes) for line in wrapped(note, width)]
    title = "\n".join(wrapped(table.title, width)) if table.title else ""
    return dataclasses.replace(table, title=title, rows=table.shown, notes=notes, total=0)


def wrapped(text: str, width: int) -> list[str]:
    """Lines of at most `width` characters; what follows the first is set in by two more blanks."""
    lines = []
    for line in text.split("\n"):
        blanks = " " * (len(line) - len(line.lstrip()))
        words = printable(line.strip())
        lines += textwrap.wrap(
            words, width, initial_indent=blanks, subsequent_indent=f"{blanks}  ", break_on_hyphens=False
        ) or [""]
    return lines
