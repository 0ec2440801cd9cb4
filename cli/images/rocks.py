"""`lunarsci images rocks`: rocks in an elevation model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunarsci.images.jobs.requests import RocksRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus
from .track import Elevation

if TYPE_CHECKING:
    from lunarsci.images.jobs.rocks import RockList

OPTIONS = {
    "largest": option(),
    "false_share": option(),
    "sizes": option(),
    "margin": option(),
    "seed": option(),
}
SHOWN = 20
"""Rocks in the table for people."""
EXAMPLES = (
    "lunarsci images rocks ground/terrain.npz",
    "lunarsci images rocks ground/terrain.npz -o rocks.geojson",
)


@command("rocks", EXAMPLES, OPTIONS)
def rocks(output: Output, dem: Elevation, request: RocksRequest) -> Report:
    """Rocks that stand out of an elevation model: place, size, height, with errors, and how many are missed.

    The same search in the model upside down tells how many finds are false; rocks of known size put into the model
    tell how many are missed. With -o FILE.geojson the rocks are circles to keep out of.
    """
    from lunarsci.images.jobs.rocks import rocks

    result = rocks(dem, request, progress=output.progress("looking for rocks"))

    return Report(result, result_tables(result), formats={".geojson": lambda _: result.geojson()})


def result_tables(result: RockList) -> list[TextTable]:
    record = result.to_dict()
    rows = [
        [
            str(row["id"]),
            f"{row['x_m']:.3f}",
            f"{row['y_m']:.3f}",
            plus_minus(row["diameter_m"], row["diameter_m_sigma"], digits=3),
            plus_minus(row["height_m"], row["height_m_sigma"], digits=3),
            f"{row['significance']:.1f}",
            f"{row['keepout_m']:.3f}",
        ]
        for row in record["rocks"][:SHOWN]
    ]
    more = len(record["rocks"]) - len(rows)
    headers = ["rock", "x [m]", "y [m]", "diameter [m]", "height [m]", "sigmas", "keep out [m]"]
    notes = [*([f"and {more} more: --csv has all"] if more > 0 else []), *record["notes"]]
    title = f"{len(record['rocks'])} rocks on {record['terrain']['name']}; {record['expected_false_share']:.1%} false"
    shares = [
        [
            f"{row['diameter_m']:g}",
            "-"
            if row["sigma_to_m"] != row["sigma_to_m"]
            else f"{1e3 * row['sigma_from_m']:.2f} to {1e3 * row['sigma_to_m']:.2f}",
            str(row["trials"]),
            f"{row['share']:.0%} ({row['share_low']:.0%} to {row['share_high']:.0%})",
        ]
        for row in record["completeness"]
    ]
    tried = TextTable(["diameter [m]", "error of nodes [mm]", "put in", "found (68 %)"], shares, title="Completeness")
    return [TextTable(headers, rows, title=title, notes=notes), tried]
