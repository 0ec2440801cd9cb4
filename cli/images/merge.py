"""`lunarsci images merge`: elevation models of several stations as one map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.images.jobs.requests import MergeRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus

if TYPE_CHECKING:
    from lunarsci.images.jobs.merge import MergedStations

OPTIONS = {
    "positions": option(kind=str | None, metavar="FILE"),
    "spacing": option(),
}
Elevations = Annotated[
    list[str],
    typer.Argument(help="Two or more files of heights with errors: .npz, GeoTIFF, ASCII or CSV.", metavar="DEM..."),
]
EXAMPLES = (
    "lunarsci images merge dem.npz coarse.npz",
    "lunarsci images merge dem.npz coarse.npz --spacing 0.1 -o map.npz",
)


@command("merge", EXAMPLES, OPTIONS)
def merge(output: Output, dems: Elevations, request: MergeRequest) -> Report:
    """Elevation models of several stations as one map, by inverse variances, with common errors kept.

    Random errors shrink where models overlap. Offsets and positions follow from the overlaps; what these leave open
    stays as common error. -o FILE.npz or .tif writes the map with its errors. --plot shows where models disagree. Exit
    code 3: they disagree beyond their errors.
    """
    from lunarsci.images.jobs.merge import merge

    merged = merge(dems, request, progress=output.progress("merging"))
    return Report(merged, result_tables(merged), formats={end: _writer(make) for end, make in merged.files().items()})


def _writer(made: Callable[[], bytes]) -> Callable[[Mapping[str, Any]], bytes]:
    return lambda _: made()


def result_tables(result: MergedStations) -> list[TextTable]:
    record = result.to_dict()
    rows = [
        [
            str(row["station"]),
            row["file"],
            plus_minus(row["offset_sigmas"], row["offset_sigmas_sigma"], digits=2),
            *(plus_minus(1e3 * row[key], 1e3 * row[f"{key}_sigma"]) for key in ("x_m", "y_m")),
        ]
        for row in record["stations"]
    ]
    terrain = record["terrain"]
    title = f"{terrain['nodes'][0]} x {terrain['nodes'][1]} nodes every {terrain['spacing_m']:g} m"
    headers = ["station", "file", "offset [common sigmas]", "x off [mm]", "y off [mm]"]
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
    notes = ["the terrain is synthetic"] if terrain["synthetic"] else []
    overlap = TextTable(["stations", "nodes", "median [mm]", "rms z", "beyond 3"], pairs, title="Overlaps, corrected")
    return [TextTable(headers, rows, title=title, notes=notes), overlap]
