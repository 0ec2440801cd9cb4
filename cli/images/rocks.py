"""`lunarsci images rocks`: rocks in a pair of pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunarsci.images.jobs.requests import RocksRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus
from .dem import Left, Right

if TYPE_CHECKING:
    from lunarsci.images.jobs.rocks import RockList

CAMERA = "Camera and light"
OPTIONS = {
    "rig": option(metavar="RIG", panel=CAMERA),
    "pose": option(metavar="FILE", panel=CAMERA, show_default="ground near the rover taken as level"),
    "sun": option(panel=CAMERA, show_default="found from the light of the ground"),
    "largest": option(),
    "false_share": option(),
    "sizes": option(),
    "margin": option(),
    "seed": option(),
}
SHOWN = 20
"""Rocks in the table for people."""
PAIR = (
    "lunarsci images rocks lunarsci-demo/left.png lunarsci-demo/right.png \\\n"
    "  --rig lunarsci-demo/rig.toml --pose lunarsci-demo/pose.toml"
)
EXAMPLES = (PAIR, PAIR + " \\\n  --sizes 0.2 -o rocks.geojson")


@command("rocks", EXAMPLES, OPTIONS)
def rocks(left: Left, right: Right, output: Output, request: RocksRequest) -> Report:
    """Rocks in a stereo pair: place, size, height, with errors, how sure each is, and how many are missed.

    A small network, taught on SYNTHETIC scenes, looks for them. Stones rendered into the pictures show how many are
    missed. With -o FILE.geojson the rocks are circles to keep out of, and `twin predict` says what may have been missed
    on the way.
    """
    from lunarsci.images.jobs.rocks import rocks

    result = rocks(left, right, request, progress=output.progress("looking for rocks"))

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
            f"{row['probability']:.2f}",
            f"{row['keepout_m']:.3f}",
        ]
        for row in record["rocks"][:SHOWN]
    ]
    more = len(record["rocks"]) - len(rows)
    headers = ["rock", "x [m]", "y [m]", "diameter [m]", "height [m]", "sure", "keep out [m]"]
    notes = [*([f"and {more} more: --csv has all"] if more > 0 else []), *record["notes"]]
    title = f"{len(record['rocks'])} rocks on {record['terrain']['name']}; {record['expected_false_share']:.1%} false"
    shares = [
        [
            f"{row['diameter_m']:g}",
            f"{row['range_from_m']:g} to {row['range_to_m']:g}",
            str(row["trials"]),
            f"{row['share']:.0%} ({row['share_low']:.0%} to {row['share_high']:.0%})",
        ]
        for row in record["completeness"]
    ]
    tried = TextTable(["diameter [m]", "range [m]", "put in", "found (68 %)"], shares, title="Completeness")
    return [TextTable(headers, rows, title=title, notes=notes), tried]
