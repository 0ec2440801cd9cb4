"""`lunarsci reproduce`: the published numbers beside ours."""

from collections import Counter
from typing import Annotated, Any

import typer

from .command import command
from .report import Report
from .table import TextTable

__all__ = ["add_to"]

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "reproduce")(reproduce)


def reproduce(
    rover: Annotated[str, typer.Option(help="Rover whose wheel is taken: a name or a TOML file.")] = "yutu2",
) -> Report:
    """Soil numbers of Ding et al. (2024) beside what lunarsci makes of what they publish, with a verdict on each.

    Spectra and drive are not part of it yet.
    """
    from lunarsci.provenance import sha256
    from lunarsci.regolith.compare import reference_hash
    from lunarsci.regolith.wheel import read_wheel
    from lunarsci.reproduce.numbers import published_hash
    from lunarsci.reproduce.soil import soil_numbers
    from lunarsci.rovers.description import read_rover

    description = read_rover(rover)
    found = soil_numbers(read_wheel(description))
    records = [number.to_dict() for number in found]
    return Report(
        schema="reproduce/1",
        result={"numbers": records, "verdicts": dict(Counter(number.verdict for number in found))},
        tables=[_table(found), _evidence(found)],
        rows=records,
        data_tables={f"{rover} (rover)": sha256(description.text.encode())} | published_hash() | reference_hash(),
        sources=[PAPER],
    )


def _table(found: Any) -> TextTable:
    rows = [
        [number.id, number.quantity, f"{number.published:g}", _ours(number.ours), number.unit, number.verdict]
        for number in found
    ]
    return TextTable(
        ["number", "quantity", "published", "ours", "unit", "verdict"], rows, title="The numbers of the soil"
    )


def _ours(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _evidence(found: Any) -> TextTable:
    rows = [[number.id, "; ".join(part for part in (number.reading, number.reason) if part)] for number in found]
    return TextTable(["number", "reading and evidence"], rows)
