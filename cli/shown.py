"""A result as its command would show it: for `print` in Python, and for a notebook."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from html import escape
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

from lunarsci.options import in_python
from lunarsci.printable import printable
from lunarsci.provenance import plain

from .shared.emit import answers_of, beyond
from .shared.table import NOTES, TextTable, first_screen, render, terminal_width

if TYPE_CHECKING:
    from lunarsci.result import Result

SHOWN_BY = {
    "PlannedMission": "twin.plan",
    "TerrainSurvey": "twin.plan",
    "InferredSoil": "regolith.infer",
    "MotionLoads": "twin.loads",
    "UncertainLoads": "twin.loads",
}
"""Results whose `result_tables` are not those of the command that their schema names."""

ROWS = 12
"""Rows of a table that a notebook shows before it is unfolded."""


def as_text(result: Result) -> str:
    """What the command shows on a terminal at first, with what it says on stderr; the plain table without such one."""
    tables = _tables(result)
    if tables is None:
        return _with_doubts(result, f"{result.to_table()}\n")
    answers, _ = answers_of(result, result.content(), tables, result.provenance().to_dict(time=False))
    return _with_doubts(result, first_screen(answers, tables, terminal_width()), answers)


def as_whole_text(result: Result) -> str:
    """What the command prints with `--verbose`."""
    return _with_doubts(result, render(_tables(result) or [_rows_of(result)], terminal_width()))


def _with_doubts(result: Result, text: str, answers: Sequence[str] = ()) -> str:
    return in_python("\n".join([text, *result.failures, beyond(answers, result.untrusted)]).rstrip("\n"))


def as_html(result: Result) -> str:
    """What a notebook shows: the answer, why it is in doubt, the first table, the picture, and all tables folded."""
    tables = _tables(result) or [_rows_of(result)]
    content, record = result.content(), result.provenance().to_dict(time=False)
    answers, _ = answers_of(result, content, tables, record)
    unsaid = beyond(answers, result.untrusted)
    doubts = [f"<b>{_cell(text)}</b>" for text in (unsaid, *map(str, result.failures[:NOTES])) if text]
    lines = "".join(f"<p>{line}</p>" for line in (*map(_cell, answers), *doubts))
    main = next((table for table in tables if table.headers), None)
    if main is None:
        return lines + "".join(map(_html_of, tables)) + _picture_of(result)
    first = dataclasses.replace(main, rows=main.rows[:ROWS], notes=main.notes[:NOTES], total=main.count)
    whole = len(tables) == 1 and main.count <= ROWS and len(main.notes) <= NOTES
    rest = "" if whole else f"<details><summary>{_more(main)}</summary>{''.join(map(_html_of, tables))}</details>"
    return lines + _html_of(first) + _picture_of(result) + rest


def _more(main: TextTable) -> str:
    """What is to be seen where a reader unfolds it."""
    return f"more of {main.count:,} rows, and all notes" if main.count > ROWS else "all tables and notes"


def _picture_of(result: Result) -> str:
    """The first page of `--plot`; where it cannot be drawn, why."""
    from lunarsci.figure import inline_picture

    try:
        source = inline_picture(result.figures())
    except Exception as error:  # a picture that fails is no reason to show nothing
        return f"<p><small>no picture: {_cell(str(error) or type(error).__name__)}</small></p>"
    return (
        f'<img src="{source}" alt="{_cell(result.page_title or result.schema)}" style="max-width: 100%">'
        if source
        else ""
    )


def _rows_of(result: Result) -> TextTable:
    """The first rows of a result without tables of its own."""
    rows = [plain(row) for row in result.answers()[:ROWS]]
    names = list(dict.fromkeys(name for row in rows for name in row))
    cells = [["-" if (value := row.get(name)) is None else _short(value) for name in names] for row in rows]
    return TextTable(names, cells, total=len(result.answers()))


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _tables(result: Result) -> Sequence[TextTable] | None:
    kinds = (kind.__name__ for kind in type(result).__mro__)
    named = result.schema.partition("/")[0].replace("-", ".", 1)
    command = next((SHOWN_BY[kind] for kind in kinds if kind in SHOWN_BY), named)
    if find_spec(f"{__package__}.{command}") is None:
        return None
    tables: Callable[[Result], Sequence[TextTable]] | None
    tables = getattr(import_module(f"{__package__}.{command}"), "result_tables", None)
    return None if tables is None else tables(result)


def _html_of(table: TextTable) -> str:
    title = f"<caption><b>{_cell(table.title)}</b></caption>" if table.title else ""
    head = "".join(f"<th>{_cell(header)}</th>" for header in table.headers)
    rows = "".join(f"<tr>{''.join(f'<td>{_cell(cell)}</td>' for cell in row)}</tr>" for row in table.shown)
    grid = f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>" if table.headers else title
    more = [f"… and {more:,} more rows: to_pandas() has all"] if (more := table.count - len(table.shown)) > 0 else []
    notes = "<br>".join(map(_cell, (*more, *table.notes)))
    return grid + (f"<p><small>{notes}</small></p>" if notes else "")


def _cell(text: str) -> str:
    return escape(printable(in_python(text)))
