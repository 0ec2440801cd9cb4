"""Tables for people (aligned text) and for programs (CSV)."""

import csv
import io
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lunarsci.printable import cell, printable
from lunarsci.provenance import plain

_NEVER_CUT = 100_000
SHOWN = 100
"""Rows that a table for people has at most."""


@dataclass(frozen=True, slots=True)
class TextTable:
    """A titled table of ready-made cells; `notes` are lines below it.

    Of more rows than `SHOWN` the first are shown; then it is enough to make these, and to say how many there are.
    """

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    notes: Sequence[str] = ()
    total: int = 0

    @property
    def left_out(self) -> list[str]:
        """A line on the rows that are not shown, if there are any."""
        more = max(self.total, len(self.rows)) - SHOWN
        return [f"… and {more:,} more rows: --csv or --json"] if more > 0 else []


def counted(notes: Sequence[str], total: int, things: str) -> list[str]:
    """Each note once, with the number of `total` things it holds for where there are several."""
    return [note if total == 1 else f"{note} ({count} of {total} {things})" for note, count in Counter(notes).items()]


def render(tables: Sequence[TextTable]) -> str:
    """The tables as aligned text, never cut at the width of a terminal."""
    return "\n".join(_render_one(table) for table in tables)


def _render_one(table: TextTable) -> str:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, highlight=False)
    rows = table.rows[:SHOWN]
    for number, header in enumerate(table.headers):
        grid.add_column(printable(header), justify="right" if _numeric(rows, number) else "left", no_wrap=True)
    for row in rows:
        grid.add_row(*map(printable, row))
    text = io.StringIO()
    Console(file=text, width=_NEVER_CUT, color_system=None, markup=False, emoji=False).print(grid)
    lines = [line.rstrip() for line in text.getvalue().splitlines()]
    said = [printable(part) for text in (*table.left_out, *table.notes) for part in text.split("\n")]
    return "\n".join([*([printable(table.title)] if table.title else []), *lines, *said, ""])


def _numeric(rows: Sequence[Sequence[str]], column: int) -> bool:
    return all(row[column][:1] in "-+0123456789" for row in rows) and any(row[column] != "-" for row in rows)


def plus_minus(value: float | None, sigma: float | None = None, *, digits: int = 1) -> str:
    """`12.3 ± 0.4`, or `-` where there is no value."""
    if plain(value) is None:
        return "-"
    error = "" if plain(sigma) is None else f" ± {sigma:.{digits}f}"
    return f"{value:.{digits}f}{error}"


def to_csv(rows: Sequence[Mapping[str, Any]]) -> Iterator[bytes]:
    """CSV with full precision in pieces; missing values are empty cells."""
    from lunarsci.record_blocks import RecordsInBlocks
    from lunarsci.records import Records

    text = io.StringIO()
    if isinstance(rows, Records | RecordsInBlocks):
        csv.writer(text, lineterminator="\n").writerow(rows.names)
        yield text.getvalue().encode()
        yield from rows.csv_chunks()
        return
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    yield text.getvalue().encode()


def _cell(value: Any) -> Any:
    bare = plain(value)
    if isinstance(bare, bool):
        return str(bare).lower()
    return "" if bare is None else cell(bare) if isinstance(bare, str) else bare
