"""`lunarsci images track`: how deep a track is, and the sinkage that follows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.images.jobs.requests import TrackRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.images.jobs.track import TrackSinkage

TRACK, ERRORS = "Track and wheel", "Errors (assumed)"
OPTIONS = {
    "line": option(metavar="LINE", panel=TRACK),
    "before": option(metavar="DEM", panel=TRACK),
    "rover": option(panel=TRACK),
    "width": option(panel=TRACK),
    "window": option(panel=TRACK),
    "step": option(panel=TRACK),
    "search": option(panel=TRACK),
    "disparity_bias": option(panel=ERRORS),
    "rebound": option(panel=ERRORS),
}
Elevation = Annotated[
    str,
    typer.Argument(
        help="Heights with their errors as layers: .npz, GeoTIFF, ESRI ASCII .asc, or CSV of nodes.", metavar="DEM"
    ),
]
EXAMPLES = (
    "lunarsci images track ground/terrain.npz --line 0,1,2.5,1.2",
    "lunarsci images track ground/terrain.npz --line 0,1,2.5,1.2 --step 0.5",
)


@command("track", EXAMPLES, OPTIONS)
def track(output: Output, dem: Elevation, request: TrackRequest) -> Report:
    """Depth of a track along a line, and the sinkage that follows, with random and systematic errors apart.

    The depth is that of the floor below the ground that was there before. That ground is interpolated from both sides,
    or taken from --before. Random errors are measured on ground without a track. Where floor or ground are not covered,
    nothing is determined, and the reason is named. `lunarsci twin states --track` reads the CSV.
    """
    from lunarsci.images.jobs.track import track

    result = track(dem, request, progress=output.progress("measuring the track"))
    return Report(result, result_tables(result))


def result_tables(result: TrackSinkage) -> list[TextTable]:
    record = result.to_dict()
    rut, sinkage = record["rut_m"], record["sinkage_m"]
    rows = [
        [
            f"{row['distance_m']:.2f}",
            f"{row['x_m']:.3f}",
            f"{row['y_m']:.3f}",
            *(_mm(row[name]) for name in ("rut_m", "rut_m_random", "rut_m_systematic", "sinkage_m")),
            row["status"],
        ]
        for row in record["track"]
    ]
    headers = ["along [m]", "x [m]", "y [m]", "depth [mm]", "random", "systematic", "sinkage [mm]", "status"]
    causes = ", ".join(f"{name} {_mm(value)}" for name, value in record["systematic_m"].items())
    notes = [
        f"mean: depth {_mm(rut['mean'])} ± {_mm(rut['sigma'])} mm (random {_mm(rut['random'])}, systematic "
        f"{_mm(rut['systematic'])}), sinkage {_mm(sinkage['mean'])} ± {_mm(sinkage['sigma'])} mm",
        f"systematic, by cause in mm: {causes}",
        f"depths overlap; {record['determined']} of {record['places']} are determined",
        *record["notes"],
    ]
    return [TextTable(headers, rows, title=f"Track on {record['terrain']['name']}", notes=notes)]


def _mm(value: float | None) -> str:
    return "-" if value is None or value != value else f"{1e3 * value:.2f}"
