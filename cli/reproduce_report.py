"""From the options of `lunarsci reproduce` to the numbers, their tables and figures."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from lunarsci.inputs import expand_inputs, read_input
from lunarsci.provenance import sha256
from lunarsci.regolith.compare import reference_hash
from lunarsci.regolith.prior import prior_hash
from lunarsci.regolith.soil import soil_hash
from lunarsci.regolith.wheel import read_wheel
from lunarsci.reproduce.drive import SOIL, Drives, drive_numbers, predicted_drives
from lunarsci.reproduce.numbers import OPEN, PARTS, VERDICTS, Number, published_hash
from lunarsci.reproduce.soil import soil_numbers
from lunarsci.reproduce.spectra import TABLES, Rocks, boulders, fit_rocks, spectra_numbers
from lunarsci.rovers.description import RoverDescription, read_rover
from lunarsci.spectra.readers import read_spectra
from lunarsci.tables import table_hashes
from lunarsci.twin.rover import build_rover

from .shared.progress import progress
from .shared.report import Report
from .shared.table import TextTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Found", "found_numbers", "reproduce_report"]

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
TITLES = {"spectra": "The rock", "soil": "The soil", "drive": "The drive"}
Update = Callable[[int, int], None]
WORK = {"spectra": 5, "soil": 4, "drive": 2}
"""Rough share of the time, for the progress bar."""


@dataclass(slots=True)
class Found:
    """The numbers, and what they and the figures are made from."""

    description: RoverDescription
    numbers: list[Number] = field(default_factory=list)
    rocks: Rocks | None = None
    drives: Drives | None = None
    inputs: dict[str, str] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)


def found_numbers(part: str, rocks: Sequence[str], rover: str, *, quiet: bool = False) -> Found:
    """Compute the numbers of a part, or of all."""
    description = read_rover(rover)
    found = Found(description, tables=published_hash())
    parts = PARTS if part == "all" else (part,)
    if parts != ("spectra",):
        found.tables[f"{rover} (rover)"] = sha256(description.text.encode())
    make: dict[str, Callable[[Update], None]] = {
        "spectra": lambda update: _spectra(found, rocks, update),
        "soil": lambda _: _soil(found),
        "drive": lambda update: _drive(found, update),
    }
    with progress("reproducing", quiet=quiet) as update:
        total, before = sum(WORK[name] for name in parts), 0
        for name in parts:
            make[name](_within(update, before, WORK[name], total))
            before += WORK[name]
            update(100 * before, 100 * total)
    return found


def _within(update: Update, before: int, share: int, total: int) -> Update:
    """Progress of one part as progress of all."""
    return lambda done, of: update(round(100 * (before + share * done / max(of, 1))), 100 * total)


def _spectra(found: Found, rocks: Sequence[str], update: Update) -> None:
    sources = [read_input(path) for path in expand_inputs(rocks)]
    found.inputs |= {source.name: source.sha256 for source in sources}
    found.tables |= table_hashes(*TABLES)
    spectra = [spectrum for source in sources for spectrum in read_spectra(source)]
    if sources:
        found.rocks = fit_rocks(boulders(spectra), update)
    found.numbers += spectra_numbers(found.rocks)


def _soil(found: Found) -> None:
    found.tables |= reference_hash() | prior_hash()
    found.numbers += soil_numbers(read_wheel(found.description))


def _drive(found: Found, update: Update) -> None:
    found.drives = predicted_drives(build_rover(found.description), update)
    found.tables |= soil_hash(SOIL)[1]
    found.numbers += drive_numbers(found.drives)


def reproduce_report(found: Found, *, verbose: bool) -> Report:
    """The report of `reproduce`; `verbose` adds the evidence to the tables."""
    records = [number.to_dict() for number in found.numbers]
    parts = [part for part in PARTS if any(number.part == part for number in found.numbers)]
    return Report(
        schema="reproduce/1",
        result={"numbers": records, "verdicts": _verdicts(found.numbers)},
        tables=[_table(found.numbers, parts, verbose)],
        rows=records,
        figures=lambda: _pages(found, parts),
        inputs=found.inputs,
        data_tables=found.tables,
        sources=[PAPER],
        options={} if parts == ["spectra"] else {"rover": found.description.origin},
    )


def _verdicts(numbers: Sequence[Number]) -> dict[str, int]:
    counts = Counter(number.verdict for number in numbers)
    return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}


def _table(numbers: Sequence[Number], parts: Sequence[str], verbose: bool) -> TextTable:
    """One line a number, by part."""
    rows = []
    for part in parts:
        rows.append([TITLES[part], *[""] * 6])
        rows += [_row(number) for number in numbers if number.part == part]
    headers = ["number", "quantity", "published", "ours", "range", "unit", "verdict"]
    for column in (2, 3, 4):
        width = max(len(headers[column]), *(len(row[column]) for row in rows))
        headers[column] = headers[column].rjust(width)
        rows = [[*row[:column], row[column].rjust(width), *row[column + 1 :]] for row in rows]
    return TextTable(headers, rows, notes=_notes(numbers, verbose))


def _row(number: Number) -> list[str]:
    own = [f"{number.published:g}", _ours(number), _range(number), number.unit, number.verdict]
    return [f"  {number.id}", number.quantity, *own]


def _ours(number: Number) -> str:
    if number.ours is None:
        return "-"
    return f"({number.ours:.4g})" if number.verdict == OPEN else f"{number.ours:.4g}"


def _range(number: Number) -> str:
    return "-" if number.low is None or number.high is None else f"{number.low:.4g} to {number.high:.4g}"


def _evidence(number: Number) -> list[str]:
    reading = [f"    reading: {number.reading}"] if number.reading else []
    return [f"  {number.id}", *reading, f"    {number.reason}"]


def _notes(numbers: Sequence[Number], verbose: bool) -> list[str]:
    counts = "; ".join(f"{count} {verdict}" for verdict, count in _verdicts(numbers).items())
    notes = [f"{len(numbers)} numbers: {counts}"]
    if any(number.verdict == OPEN and number.ours is not None for number in numbers):
        notes.append("in brackets: an example under an assumption that nothing published supports or rules out")
    if verbose:
        return [*notes, "readings and evidence", *(line for number in numbers for line in _evidence(number))]
    return [*notes, "readings and evidence: -v, or --json"]


def _pages(found: Found, parts: Sequence[str]) -> "Iterator[Figure]":
    from lunarsci.reproduce.figure_drive import drive_pages
    from lunarsci.reproduce.figure_soil import soil_pages
    from lunarsci.reproduce.spectra import spectra_pages

    pages: dict[str, Callable[[], Any]] = {
        "spectra": lambda: spectra_pages(found.rocks),
        "soil": lambda: soil_pages(read_wheel(found.description)),
        "drive": lambda: drive_pages(found.drives) if found.drives else iter(()),
    }
    for part in parts:
        yield from pages[part]()
