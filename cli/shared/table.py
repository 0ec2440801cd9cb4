"""Tables for people: cells whose digits follow their errors, how they fit a terminal, and how each format has them."""

import csv
import dataclasses
import io
import shutil
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lunarsci.errors import ParameterError, RequestError
from lunarsci.names import checked_name, some_of
from lunarsci.printable import cell, printable
from lunarsci.provenance import plain

if TYPE_CHECKING:
    from rich.box import Box

SHOWN = 100
"""Rows that a table for people has at most."""
UNKNOWN = "not determined"
"""In the place of a value that has none."""
MOST_NAMED = 3
"""Things that a note names of those it holds for."""
MOST_VERDICTS = 6
"""Spectra whose verdicts are shown."""
SAYS = "What this says"
"""Title of verdicts."""


@dataclass(frozen=True, slots=True)
class TextTable:
    """A titled table of ready-made cells.

    Of more rows than `SHOWN` the first are shown; then it is enough to make these, and to say how many there are.

    Attributes
    ----------
    headers, rows : cells of the head, and of each row as many.
    title, notes : the line above, and lines below.
    total : how many rows there are; 0 where all were made.
    """

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    notes: Sequence[str] = ()
    total: int = 0

    @property
    def count(self) -> int:
        """Rows that there are."""
        return max(self.total, len(self.rows))

    @property
    def shown(self) -> Sequence[Sequence[str]]:
        """Rows that are shown."""
        return self.rows[:SHOWN]

    @property
    def left_out(self) -> list[str]:
        """A line on the rows that are not shown, if there are any."""
        more = self.count - SHOWN
        return [f"… and {more:,} more rows: --csv or --json"] if more > 0 else []


def bare(header: str) -> str:
    """A header without its unit.

    >>> bare("BC1000 [nm]"), bare("[%]")
    ('BC1000', '')
    """
    return header.partition("[")[0].strip()


def counted(notes: Sequence[str], total: int, things: str, names: Sequence[str] = ()) -> list[str]:
    """Each note once, with how many of `total` things it holds for where there are several, and the first of `names`.

    >>> counted(["dark", "dark", "red"], 3, "spectra", ["a", "b", "b"])
    ['dark (2 of 3 spectra: a, b)', 'red (1 of 3 spectra: b)']
    """
    if total == 1:
        return list(dict.fromkeys(notes))
    names_of: dict[str, list[str]] = {}
    for note, name in zip(notes, names or [""] * len(notes), strict=True):
        names_of.setdefault(note, []).append(name)
    return [f"{note} ({len(holders)} of {total} {things}{_first(holders)})" for note, holders in names_of.items()]


def _first(names: Sequence[str]) -> str:
    return f": {some_of(names, MOST_NAMED)}" if all(names) else ""


def verdict_table(
    records: Sequence[Mapping[str, Any]],
    verdict: Callable[[Mapping[str, Any]], str],
    together: Callable[[Sequence[Mapping[str, Any]]], list[str]] | None = None,
) -> list[TextTable]:
    """One sentence about each spectrum, where these are few; else what `together` counts."""
    if len(records) > MOST_VERDICTS:
        return [TextTable([], [], title=SAYS, notes=together(records))] if together else []
    return [TextTable([], [], title=SAYS, notes=[f"{item['id']}: {verdict(item)}" for item in records])]


def plus_minus(
    value: float | None, sigma: float | None = None, *, digits: int = 1, within: tuple[float, float] | None = None
) -> str:
    """A value and its error, which has two significant digits: `12.34 ± 0.42`; `digits` where it has no error.

    `-` where there is no value. `not determined` for an error of zero, and, with `within`, the lowest and the highest
    value that can be, for a value outside and for an error wider than these.

    >>> plus_minus(1234.5, 123.0), plus_minus(0.98123, 0.00996), plus_minus(0.7, 1.8, within=(0, 1))
    ('1230 ± 120', '0.981 ± 0.010', 'not determined')
    """
    bare_value, bare_sigma = plain(value), plain(sigma)
    if bare_value is None:
        return "-"
    low, high = within or (-float("inf"), float("inf"))
    if bare_sigma is None:
        return f"{bare_value:z.{digits}f}" if low <= bare_value <= high else UNKNOWN
    if bare_sigma <= 0 or not low <= bare_value <= high or bare_sigma > high - low:
        return UNKNOWN
    places = 1 - int(f"{bare_sigma:.1e}".partition("e")[2])
    return f"{rounded(bare_value, places)} ± {rounded(bare_sigma, places)}"


def significant(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, and never with an exponent where it is large.

    >>> significant(1903.2), significant(0.030964)
    ('1903', '0.031')
    """
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def rounded(value: float, places: int) -> str:
    """A number to so many decimal places; negative ones are digits before the point.

    >>> rounded(1234.5, -1), rounded(1234.5, 0)
    ('1230', '1234')
    """
    return f"{value if places >= 0 else round(value, places):z.{max(places, 0)}f}"


GAP = 2
"""Blanks between columns."""
SENTENCE = 24
"""Characters from which a cell of several words is a sentence; assumed."""
LEAST = 8
"""Characters that a shortened cell keeps at least."""
RANKS: Mapping[str, int] = {
    header: rank
    for rank, headers in {
        0: "BC1000, BC2000, spread 1 µm, spread 2 µm",
        1: "strength, FWHM, BD1000, BD2000, posterior, prior, ln BF, i, e, g, limit, unit, verdict, "
        "95 % of drives, kept, *, bias, wheel, in 90 % bands, median, 68 %, value, status, mineral, share, F_N, F_DP, "
        "slip, sinkage, F_N balanced, F_DP balanced, F_L balanced, determined, states",
        3: "area1000, area2000, rms ln R, shrinkage of centre, margin, p50, channels, "
        "range, ejecta, main route, Sun, step, gain, F_N assumed, F_DP assumed, F_L assumed, rms, plan, surprise, "
        "ground's own 68 %, F_N from p05 to p95, F_DP from p05 to p95, F_L from p05 to p95, M_R from p05 to p95, "
        "sinkage from p05 to p95, slip from p05 to p95, side slip from p05 to p95, picture, truth, x, y",
        4: "shrinkage of FWHM, continuum at 1 µm, continuum at 2 µm, azimuth, limit from, worth, n, CRPS, "
        "source, quantity, forgotten before, what, remark, rms sd",
    }.items()
    for header in headers.split(", ")
}
"""Columns that go later (0, 1) or sooner (3, 4) than others (2) where there is no room; of equals the right one goes
first, so that an error goes right before its value. Those of 4 go before sentences become footnotes. The first column
of a table always stays."""
DISPENSABLE = 4
"""Rank of columns that go before sentences become footnotes."""


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
    """Lines of at most `width` characters, 0: never cut; what follows the first is set in by two more blanks."""
    lines = []
    for line in text.split("\n"):
        blanks = " " * (len(line) - len(line.lstrip()))
        words = printable(line.strip())
        lines += textwrap.wrap(
            words, width or _NEVER_CUT, initial_indent=blanks, subsequent_indent=f"{blanks}  ", break_on_hyphens=False
        ) or [""]
    return lines


_NEVER_CUT = 100_000
"""A width that no line has."""
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


SCREEN = 24
"""Lines of a terminal, as they have been since the VT100."""
NOTES = 3
"""Notes below the table of a first screen."""


def first_screen(answers: Sequence[str], tables: Sequence[TextTable], width: int) -> str:
    """What a terminal shows at first: the answer, the first table and its first notes; all where that fits `SCREEN`."""
    answer = [line for text in answers for line in wrapped(text, width)]
    answer += [""] if answer else []
    tables = [table for table in tables if table.title != SAYS]
    whole = render(tables, width).splitlines()
    if len(answer) + len(whole) <= SCREEN:
        return "\n".join([*answer, *whole, ""])
    main = next((table for table in tables if table.headers), TextTable([], []))

    def shown(rows: int, notes: int) -> list[str]:
        some = dataclasses.replace(main, rows=main.rows[:rows], notes=main.notes[:notes], total=0)
        return render([some], width).splitlines()

    rows = len(main.shown)
    if len(answers) > 1 and len(answer) + len(shown(rows, 0)) + 1 > SCREEN:
        return first_screen(answers[:-1], tables, width)  # of several things the rows, then as many sentences as fit
    fewer = (shown(rows, notes) for notes in range(NOTES, 0, -1))
    lines = next((some for some in fewer if len(answer) + len(some) < SCREEN), None) or shown(rows, 0)
    if len(answer) + len(lines) + 1 > SCREEN:
        rows = min(rows, SCREEN)
    while rows > 1 and len(answer) + len(lines) + 1 > SCREEN:
        rows -= 1  # a row takes several lines where its text is long
        lines = shown(rows, 0)
    cut = f"{main.count - rows} more rows, " if rows < main.count else ""
    last = f"{cut}{len(whole) - len(lines)} more lines: --verbose; every number: --json or --csv"
    return "\n".join([*answer, *lines, last, ""])


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


def chosen_csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> list[bytes]:
    """Some columns of that CSV, in their order. RequestError for one that is not there, before any is written."""
    reader = csv.reader(io.StringIO(b"".join(to_csv(rows)).decode()))
    names = next(reader)
    try:
        places = [names.index(checked_name(name, names, "a column of --csv")) for name in columns]
    except ParameterError as error:
        raise RequestError(f"--columns: {error}") from None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([row[k] for k in places] for row in (names, *reader))
    return [text.getvalue().encode()]


def _cell(value: Any) -> Any:
    bare = plain(value)
    if isinstance(bare, bool):
        return str(bare).lower()
    return "" if bare is None else cell(bare) if isinstance(bare, str) else bare


def chosen(tables: Sequence[TextTable], rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[TextTable]:
    """The columns of these names alone: of the tables, by header with or without unit, or else of the CSV.

    Raises RequestError for a name that is neither.
    """
    if picked := matched(tables, names):
        return picked
    cells = list(csv.reader(io.StringIO(b"".join(chosen_csv(rows, names)).decode())))
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
