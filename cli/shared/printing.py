"""Tables as text for people, as Markdown, TeX and tab-separated values, and as CSV for programs."""

import csv
import dataclasses
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lunarsci.errors import ParameterError, RequestError
from lunarsci.names import checked_name
from lunarsci.printable import cell, printable
from lunarsci.provenance import plain

from .layout import fitted
from .table import TextTable, bare

if TYPE_CHECKING:
    from rich.box import Box

_NEVER_CUT = 100_000
TEX_SIGNS = {sign: f"\\{sign}" for sign in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$",
    "≤": r"$\le$", "≥": r"$\ge$", "²": "$^2$", "³": "$^3$", "°": r"$^\circ$", "µ": r"$\mu$", "φ": r"$\phi$",
    "σ": r"$\sigma$", "τ": r"$\tau$", "χ": r"$\chi$", "…": r"\dots{}", "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip
"""Signs that TeX takes for commands, or lacks outside of formulas, and how they are written."""


def render(tables: Sequence[TextTable], width: int = 0, *, keep: bool = False) -> str:
    """The tables as aligned text with lines of at most `width` characters; 0: never cut. `keep` keeps all columns."""
    from rich import box

    return "\n".join(_as_lines(fitted(table, width, keep=keep), box.SIMPLE_HEAD) for table in tables)


def _as_lines(table: TextTable, frame: "Box") -> str:
    notes = [printable(part) for text in (*table.left_out, *table.notes) for part in text.split("\n")]
    title = [printable(part) for part in table.title.split("\n")] if table.title else []
    return "\n".join([*title, *_grid(table, frame), *notes, ""])


def _grid(table: TextTable, frame: "Box", cells: Callable[[str], str] = printable) -> list[str]:
    from rich.console import Console
    from rich.table import Table

    if not table.headers:
        return []
    ruled = frame.ascii
    grid = Table(box=frame, show_edge=ruled, pad_edge=ruled, collapse_padding=not ruled, highlight=False)
    for number, header in enumerate(table.headers):
        grid.add_column(cells(header), justify="right" if _numeric(table.shown, number) else "left", no_wrap=True)
    for row in table.shown:
        grid.add_row(*map(cells, row))
    text = io.StringIO()
    Console(file=text, width=_NEVER_CUT, color_system=None, markup=False, emoji=False).print(grid)
    return [line.rstrip() for line in text.getvalue().splitlines()]


def _numeric(rows: Sequence[Sequence[str]], column: int) -> bool:
    return all(row[column][:1] in "-+0123456789" for row in rows) and any(row[column] != "-" for row in rows)


def to_markdown(tables: Sequence[TextTable]) -> str:
    """The tables in Markdown, titles in bold, notes below."""
    from rich import box

    made = []
    for table in tables:
        lines = _grid(table, box.MARKDOWN, lambda text: printable(text).replace("|", "\\|"))
        parts = [f"**{printable(table.title)}**"] if table.title else []
        parts += ["\n".join(filter(None, lines))] if lines else []
        made += [*parts, *(printable(note) for note in (*table.left_out, *table.notes))]
    return "\n\n".join(made) + "\n"


def to_tex(tables: Sequence[TextTable]) -> str:
    """The tables in LaTeX, each a `table` with caption; notes below it."""
    return "\n".join(map(_tex_of, tables))


def _tex_of(table: TextTable) -> str:
    notes = [_tex(note) for note in (*table.left_out, *table.notes)]
    caption = [f"\\caption{{{_tex(table.title)}}}"] if table.title else []
    grid = []
    if table.headers:
        columns = "".join("r" if _numeric(table.shown, k) else "l" for k in range(len(table.headers)))
        rows = [" & ".join(map(_tex, row)) + r" \\" for row in (table.headers, *table.shown)]
        grid = [
            f"\\begin{{tabular}}{{{columns}}}",
            r"\hline",
            rows[0],
            r"\hline",
            *rows[1:],
            r"\hline",
            r"\end{tabular}",
        ]
    ends = [r"\begin{table}", r"\centering"], [r"\end{table}"]
    return "\n".join([*ends[0], *caption, *grid, *(rf"\par {note}" for note in notes), *ends[1], ""])


def _tex(text: str) -> str:
    return "".join(TEX_SIGNS.get(sign, sign) for sign in printable(text))


def to_tsv(tables: Sequence[TextTable]) -> str:
    """The tables with tabs between cells; titles and notes are lines that begin with #."""
    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    for number, table in enumerate(tables):
        text.write("\n" if number else "")
        text.write(f"# {printable(table.title)}\n" if table.title else "")
        writer.writerows([[*map(cell, row)] for row in (table.headers, *table.shown)] if table.headers else [])
        text.writelines(f"# {printable(note)}\n" for note in (*table.left_out, *table.notes))
    return text.getvalue()


FORMATS: Mapping[str, Callable[[Sequence[TextTable]], str]] = {
    "text": render,
    "md": to_markdown,
    "tsv": to_tsv,
    "latex": to_tex,
}
"""What --format has beside json and csv, and what makes it."""


def names_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of the columns of that CSV."""
    from lunarsci.io.records import Records, RecordsInBlocks

    if isinstance(rows, Records | RecordsInBlocks):
        return rows.names
    return list(dict.fromkeys(name for row in rows for name in row))


def to_csv(rows: Sequence[Mapping[str, Any]]) -> Iterator[bytes]:
    """CSV with full precision in pieces; missing values are empty cells."""
    from lunarsci.io.records import Records, RecordsInBlocks

    text = io.StringIO()
    if isinstance(rows, Records | RecordsInBlocks):
        csv.writer(text, lineterminator="\n").writerow(names_of(rows))
        yield text.getvalue().encode()
        yield from rows.csv_chunks()
        return
    names = names_of(rows)
    writer = csv.DictWriter(text, names, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    yield text.getvalue().encode()


def chosen_csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Iterator[bytes]:
    """Some columns of that CSV, in their order. Raises RequestError for one that is not there."""
    reader = csv.reader(io.StringIO(b"".join(to_csv(rows)).decode()))
    names = next(reader)
    places = [names.index(_column(name, names, "a column of --csv")) for name in columns]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([row[k] for k in places] for row in (names, *reader))
    yield text.getvalue().encode()


def _column(name: str, columns: Sequence[str], what: str) -> str:
    """The name as it is known. Raises RequestError, wrong usage, that names the nearest, and all."""
    try:
        return checked_name(name, columns, what)
    except ParameterError as error:
        raise RequestError(f"--columns: {error}") from None


def _cell(value: Any) -> Any:
    bare = plain(value)
    if isinstance(bare, bool):
        return str(bare).lower()
    return "" if bare is None else cell(bare) if isinstance(bare, str) else bare


def chosen(
    tables: Sequence[TextTable], rows: Sequence[Mapping[str, Any]] | None, names: Sequence[str]
) -> list[TextTable]:
    """The columns of these names alone: of the tables, by header with or without unit, or else of the CSV.

    Raises RequestError for a name that is neither.
    """
    if picked := matched(tables, names):
        return picked
    if rows is None:
        headers = [bare(header) for table in tables for header in table.headers if bare(header)]
        _column(names[0], headers, "a column")
    cells = list(csv.reader(io.StringIO(b"".join(chosen_csv(rows or (), names)).decode())))
    return [TextTable(cells[0], [[_rounded(cell) for cell in row] for row in cells[1:]])]


def matched(tables: Sequence[TextTable], names: Sequence[str]) -> list[TextTable]:
    """Tables with these columns, in their order, without the others; none where a name is in no table."""
    picked, seen = [], set()
    for table in tables:
        columns: dict[str, int] = {}
        for k, header in enumerate(table.headers):
            columns.setdefault(header.casefold(), k)
            columns.setdefault(bare(header).casefold(), k)
        places = [columns[name.casefold()] for name in names if name.casefold() in columns]
        seen |= {name for name in names if name.casefold() in columns}
        if places:
            rows = [[row[k] for k in places] for row in table.rows]
            picked.append(dataclasses.replace(table, headers=[table.headers[k] for k in places], rows=rows))
    return picked if seen == set(names) else []


def _rounded(cell: str) -> str:
    """A number with six significant digits."""
    try:
        return f"{float(cell):.6g}" if "." in cell else cell or "-"
    except ValueError:
        return cell
