"""`lunarsci images merge`: elevation models of several stations, or their pairs of pictures, as one map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.images.jobs.requests import MergeRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus
from .locate import HEADERS, pose_rows

if TYPE_CHECKING:
    from lunarsci.images.jobs.merge import MergedStations

PAIRS = "Folders with pictures"
ERRORS = "Errors before the pictures (assumed)"
OPTIONS = {
    "positions": option(kind=str | None, metavar="FILE"),
    "spacing": option(show_default="that of the finest model; of pictures 0.02"),
    "rig": option(metavar="RIG", panel=PAIRS, show_default="rig.toml of each folder, or yutu2-navcam"),
    "farthest": option(panel=PAIRS, show_default="where its error is three cells"),
    "drift": option(panel=ERRORS),
    "heading_error": option(panel=ERRORS),
    "tilt_error": option(panel=ERRORS),
    "mast_error": option(panel=ERRORS),
}
Elevations = Annotated[
    list[str],
    typer.Argument(
        help="Two or more files of heights with errors (.npz, GeoTIFF, ASCII or CSV), or folders, each with left.png, "
        "right.png and pose.toml.",
        metavar="DEM...|STATION...",
    ),
]
Cloud = Annotated[
    Path | None,
    typer.Option(
        "--save-cloud", metavar="FILE", rich_help_panel=PAIRS, help="The points as .ply, with grey and errors."
    ),
]
EXAMPLES = (
    "lunarsci images merge dem.npz coarse.npz",
    "lunarsci images merge dem.npz coarse.npz --spacing 0.1 -o map.npz",
    "lunarsci images merge lunarsci-demo station-2 \\\n"
    "  --rig lunarsci-demo/rig.toml -o pairs.npz --save-cloud pairs.ply",
)


@command("merge", EXAMPLES, OPTIONS)
def merge(output: Output, dems: Elevations, request: MergeRequest, cloud: Cloud = None) -> Report:
    """Elevation models of several stations, or their pairs of pictures, as one map, with common errors kept.

    Models: random errors shrink where they overlap. Offsets and positions follow from the overlaps; what these leave
    open stays as common error.

    Folders: all pairs are tied by what they share, and all poses and rigs are adjusted at once. What stays unknown of
    them is the map's common error. Pairs with the same `station` in pose.toml share the rover's errors, not those of
    the mast. A pair that cannot be tied stays where telemetry puts it, with that error.

    -o FILE.npz or .tif writes the map with its errors. --plot shows where models disagree. Exit code 3: they disagree
    beyond their errors, or pictures place a station where telemetry's errors do not allow it.
    """
    from lunarsci.images.jobs.merge import merge

    output.check_extra("--save-cloud", cloud, (".ply",))
    merged = merge(dems, request, progress=output.progress("merging"))
    extras = {} if cloud is None else {cloud: merged.cloud_bytes}
    formats = {end: _writer(make) for end, make in merged.files().items()}
    return Report(merged, result_tables(merged), formats=formats, extras=extras)


def _writer(made: Callable[[], bytes]) -> Callable[[Mapping[str, Any]], bytes]:
    return lambda _: made()


def result_tables(result: MergedStations) -> list[TextTable]:
    record = result.to_dict()
    terrain = record["terrain"]
    title = f"{terrain['nodes'][0]} x {terrain['nodes'][1]} nodes every {terrain['spacing_m']:g} m"
    headers, rows = (HEADERS, pose_rows(record)) if "poses" in record else _models(record)
    pairs = [
        [
            f"{pair['first']}, {pair['second']}",
            str(pair["nodes"]),
            f"{1e3 * pair['mean_m']:.2f}",
            f"{pair['rms_z']:.2f}",
            f"{pair['odd_share']:.1%}",
        ]
        for pair in record["overlaps"]
    ]
    overlap = TextTable(["stations", "nodes", "median [mm]", "rms z", "beyond 3"], pairs, title="Overlaps, corrected")
    return [TextTable(headers, rows, title=title, notes=result.notes()), overlap]


def _models(record: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    rows = [
        [
            str(row["station"]),
            row["file"],
            plus_minus(row["offset_sigmas"], row["offset_sigmas_sigma"], digits=2),
            *(plus_minus(1e3 * row[key], 1e3 * row[f"{key}_sigma"]) for key in ("x_m", "y_m")),
        ]
        for row in record["stations"]
    ]
    return ["station", "file", "offset [common sigmas]", "x off [mm]", "y off [mm]"], rows
