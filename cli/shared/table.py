"""Tables for people: ready-made cells under headers, and numbers whose digits follow their errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lunarsci.names import some_of
from lunarsci.provenance import plain

SHOWN = 100
"""Rows that a table for people has at most."""
UNKNOWN = "not determined"
MOST_NAMED = 3
"""Things that a note names of those it holds for."""
MOST_VERDICTS = 6
"""Spectra whose verdicts are shown."""
SAYS = "What this says"


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
