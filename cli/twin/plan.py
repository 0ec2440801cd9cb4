"""`lunarsci twin plan`: a path to a target."""

from typing import TYPE_CHECKING

import typer

from lunarsci.twin.jobs.plan import PlanRequest

from ..shared.command import command
from ..shared.options import Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable
from .terrain import LIMITS, GeoTiff, TerrainFile, check_files, ground_table
from .terrain import OPTIONS as OF_TERRAIN

if TYPE_CHECKING:
    from lunarsci.twin.ground.hazards import Mobility
    from lunarsci.twin.routes.planner import PlannedPath


PATH = "Path"
OPTIONS = {
    "target": option(
        "Where to plan a path to, in m; with the heading there, in deg.",
        panel=PATH,
        metavar="X,Y[,HEADING]",
        kind=str,
        show_default=False,
    ),
    "start": option("Pose of the rover, in m and deg.", panel=PATH, metavar="X,Y,HEADING", kind=str),
    "speed": option("Speed in m/s; the rover's highest if left out.", panel=PATH),
    "turning_radius": option("Smallest radius of an arc, in m.", panel=LIMITS),
    "hazard_distance": option("Distance to keep from hazards and holes, in m.", panel=LIMITS),
    **OF_TERRAIN,
}


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "plan", folder=True, request=PlanRequest, options=OPTIONS)(plan)


def plan(
    output: Output, request: PlanRequest, terrain: TerrainFile = "synthetic-longji", geotiff: GeoTiff = False
) -> Report:
    """A path to a target that keeps the limits of a rover, on the maps of `twin terrain`.

    With -o DIR the path goes to plan.toml and path.csv, the terrain to terrain.npz, the maps to maps.npz:
    `lunarsci twin predict DIR/plan.toml --terrain DIR/terrain.npz` drives it. Plan and terrain keep the rover and the
    limits that they were made for.
    """
    from lunarsci.twin.jobs import plan as job

    check_files(output, request, geotiff)
    with progress("planning", quiet=output.quiet) as update:
        found = job.plan(terrain, request, progress=update)
    tables = [ground_table(found), *([] if found.path is None else [_path_table(found.path, found.site.mobility)])]
    return Report.of(found, tables, files=found.files(geotiff=geotiff))


def _path_table(path: "PlannedPath", limits: "Mobility") -> TextTable:
    import numpy as np

    rows = [
        [str(number), f"{arc.length_m:.3f}", f"{arc.curvature_per_m:.4f}", _radius(arc.curvature_per_m)]
        for number, arc in enumerate(path.plan.legs, start=1)
    ]
    end = path.end
    notes = [
        f"{path.plan.length_m:.3f} m long, ends at x {end[0]:.3f} m, y {end[1]:.3f} m, "
        f"heading {np.degrees(end[2]):.1f} deg, {1e3 * path.miss_m:.1f} mm from the target",
        f"under the footprint: slope {path.max_slope_deg:.2f} of {limits.max_slope_deg:g} deg, step "
        f"{path.max_step_m:.3f} of {limits.max_step_m:g} m; nearest hazard {path.min_hazard_distance_m:.2f} m, "
        f"{limits.hazard_distance_m:g} m to be kept",
    ]
    return TextTable(["arc", "length [m]", "curvature [1/m]", "radius [m]"], rows, title=path.plan.name, notes=notes)


def _radius(curvature_per_m: float) -> str:
    return f"{1.0 / abs(curvature_per_m):.2f}" if abs(curvature_per_m) > 1e-4 else "-"
