"""`lunarsci images locate`: where stations were, from their pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.images.jobs.requests import LocateRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus

if TYPE_CHECKING:
    from lunarsci.images.jobs.locate import LocatedStations

ERRORS = "Errors before the pictures (assumed)"
OPTIONS = {
    "rig": option(metavar="RIG"),
    "mast": option(kind=str | None, metavar="X,Y,Z"),
    "drift": option(panel=ERRORS),
    "heading_error": option(panel=ERRORS),
    "tilt_error": option(panel=ERRORS),
}
Folders = Annotated[
    list[str],
    typer.Argument(
        metavar="STATION...",
        help="Two or more folders in the order of the drive, each with left.png, right.png and pose.toml.",
    ),
]
HEADERS = ["station", "x [m]", "y [m]", "z [m]", "camera's heading [deg]", "from dead reckoning [m]", "tied"]
EXAMPLES = (
    "lunarsci images locate lunarsci-demo station-2 --rig lunarsci-demo/rig.toml",
    "lunarsci images locate lunarsci-demo station-2 --rig lunarsci-demo/rig.toml \\\n  --drift 0.1 --csv",
)


@command("locate", EXAMPLES, OPTIONS, folder=True)
def locate(output: Output, stations: Folders, request: LocateRequest) -> Report:
    """Where stations were, with errors, from ground that their pictures share. It begins with dead reckoning.

    The view of the nearer of two stations is projected into the other one's by its stereo points, and tied to it (extra
    `images`). Then all poses and the rig are adjusted within their errors. A station that cannot be tied stays where
    dead reckoning puts it, and the exit code is 3.

    --csv gives positions for `twin states` and `twin update` (--positions). -o DIR writes them to positions.csv, each
    pose to STATION.toml for `images dem --pose`, and the errors of elevation models to shifts.csv for `images merge
    --positions`. --plot shows the ties.
    """
    from lunarsci.images.jobs.locate import locate

    result = locate(stations, request, progress=output.progress("locating"))
    return Report(result, result_tables(result), files=result.files())


def pose_rows(record: Mapping[str, Any]) -> list[list[str]]:
    """Where stations were, one a row under `HEADERS`."""
    return [
        [
            row["station"],
            *(plus_minus(row[f"{a}_m"], row[f"{a}{a}_m2"] ** 0.5, digits=4) for a in "xyz"),
            plus_minus(row["camera_heading_deg"], row["camera_heading_deg_sigma"], digits=2),
            f"{row['from_dead_reckoning_m']:.3f}",
            "yes" if row["tied"] else "no",
        ]
        for row in record["stations"]
    ]


def result_tables(result: LocatedStations) -> list[TextTable]:
    record = result.to_dict()
    pairs = [
        [
            f"{pair['first']}, {pair['second']}",
            f"{pair['overlap']:.1%}",
            f"{pair['inliers']} of {pair['features']}",
            str(pair["ties"]),
            "" if pair["correlation"] is None else f"{pair['correlation']:.2f}",
            pair["failure"],
        ]
        for pair in record["pairs"]
    ]
    ties = TextTable(["stations", "overlap", "of one motion", "ties", "correlation", "failed"], pairs, title="Pairs")
    return [
        TextTable(HEADERS, pose_rows(record), title=record["positions_of"].capitalize(), notes=record["notes"]),
        ties,
    ]
