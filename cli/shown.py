"""A result as its command would show it: for `print` in Python, and for a notebook."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

from lunarsci.printable import printable

from .shared.table import TextTable, render, terminal_width

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


def as_text(result: Result) -> str:
    """What the command prints, with what it says on stderr; the plain table where there is no such command."""
    tables = _tables(result)
    text = str(result.to_table()) + "\n" if tables is None else render(tables, terminal_width())
    return "\n".join([text, *result.failures, *filter(None, (result.untrusted,))]).rstrip("\n")


def as_html(result: Result) -> str:
    """The same tables for a notebook, what should be known first."""
    tables = _tables(result)
    untrusted = [f"<b>{_cell(result.untrusted)}</b>"] if result.untrusted else []
    lines = "".join(f"<p>{line}</p>" for line in (*untrusted, *map(_cell, result.failures)))
    if tables is None:
        shown: str = result.to_table()._repr_html_()
        return lines + shown
    return lines + "".join(map(_html_of, tables))


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
    notes = "<br>".join(map(_cell, (*table.left_out, *table.notes)))
    return grid + (f"<p><small>{notes}</small></p>" if notes else "")


def _cell(text: str) -> str:
    return escape(printable(text))
