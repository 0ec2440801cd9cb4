"""`lunarsci twin terrain`: look at a terrain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.twin.jobs.requests import TerrainRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable
from .options import GRAVITY, KEEP_OUT

if TYPE_CHECKING:
    from lunarsci.twin.jobs.terrain import TerrainSurvey

LIMITS, GROUND = "Limits, instead of those of the rover file", "Synthetic ground"
LAYERS = "Layers and light"
OPTIONS = {
    "rover": option(show_default="yutu2"),
    "soil": option(show_default="the terrain's, or longji"),
    "gravity": GRAVITY,
    "height_unit": option(show_default="what the file states, or m"),
    "keep_out": KEEP_OUT,
    "layer": option(panel=LAYERS, metavar="FILE"),
    "classes": option("--class", panel=LAYERS, metavar="VALUE=forbidden|COST"),
    "sun": option(panel=LAYERS, metavar="AZIMUTH,ELEVATION"),
    "shadow_cost": option(panel=LAYERS, metavar="COST|forbidden"),
    "baseline": option(),
    "max_slope": option(panel=LIMITS),
    "max_step": option(panel=LIMITS),
    "max_roughness": option(panel=LIMITS),
    "seed": option(panel=GROUND),
    "spacing": option(panel=GROUND),
    "rocks": option(panel=GROUND),
    "roughness": option(panel=GROUND),
    "extent": option(panel=GROUND),
    "ground_slope": option(panel=GROUND),
    "craters": option("--crater-count", panel=GROUND),
}
TERRAIN = "synthetic-longji, synthetic, or a file (.npz, GeoTIFF, PDS3, PDS4, ISIS, ESRI ASCII .asc, CSV of nodes)."
TerrainFile = Annotated[str, typer.Argument(help=TERRAIN, metavar="TERRAIN")]
NamedTerrain = Annotated[str | None, typer.Argument(help=TERRAIN, metavar="TERRAIN", show_default="synthetic-longji")]
GeoTiff = Annotated[bool, typer.Option("--geotiff", help="With -o, the maps also as maps.tif.")]
EXAMPLES = (
    "lunarsci twin terrain",
    "lunarsci twin terrain synthetic --extent 4 --spacing 0.02 --rocks 0.03 \\\n  --seed 2 -o ground",
)


@command("terrain", EXAMPLES, OPTIONS, folder=True)
def terrain(
    output: Output, request: TerrainRequest, terrain: TerrainFile = "synthetic-longji", geotiff: GeoTiff = False
) -> Report:
    """Maps of slope, roughness and step height of a terrain, and where a rover may drive.

    -o DIR writes the terrain to terrain.npz and the maps to maps.npz. The terrain keeps the rover and the limits of
    these maps. `lunarsci twin plan` finds a path on it.
    """
    from lunarsci.twin.jobs import terrain as job

    check_files(output, soil=request.soil is not None, geotiff=geotiff)
    survey = job.terrain(terrain, request, progress=output.progress("looking at the ground"))
    return Report(survey, [ground_table(survey)], files=survey.files(geotiff=geotiff))


def check_files(output: Output, *, soil: bool, geotiff: bool) -> None:
    """Refuse options of files that are not written."""
    for name, given in (("--soil", soil), ("--geotiff", geotiff)):
        if given and output.path is None:
            raise typer.BadParameter(f"{name} goes into a file; give -o DIR, or leave it out")


def ground_table(survey: TerrainSurvey) -> TextTable:
    """The maps beside their limits, for people."""
    record, limits, maps = survey.to_dict(), survey.site.mobility, survey.surface.maps
    terrain = record["terrain"]
    unlimited = {"slope_deg": limits.max_slope_deg, "roughness_m": limits.max_roughness_m, "step_m": limits.max_step_m}
    rows = []
    for name, spread in record["maps"].items():
        limit = unlimited[name]
        cells = ["-" if value is None else f"{value:.4g}" for value in spread.values()]
        rows.append([name, *cells, "-" if limit is None else f"{limit:g}"])
    nx, ny = terrain["nodes"]
    title = (
        f"{terrain['name']}: x {terrain['x_m'][0]:g} to {terrain['x_m'][1]:g} m, y {terrain['y_m'][0]:g} to "
        f"{terrain['y_m'][1]:g} m, {nx} x {ny} nodes every {terrain['spacing_m']:g} m"
    )
    notes = [
        f"heights {terrain['height_m'][0]:.3f} to {terrain['height_m'][1]:.3f} m, holes {terrain['hole_share']:.1%}",
        f"may be driven on: {record['traversable_share']:.1%}; hazards {record['hazard_share']:.1%}; "
        f"unknown, near holes or the edge, {record['unknown_share']:.1%}",
        f"slope and roughness under {maps.baseline_m:g} m x {maps.baseline_m:g} m"
        + (f", step heights, slope removed, within {maps.wheel_window_m:g} m" if maps.shows_steps else ""),
        *([f"in shadow: {record['sun']['shadow_share']:.1%}"] if "sun" in record else []),
        *record["notes"],
    ]
    return TextTable(["map", "p5", "p50", "p95", "max", "limit"], rows, title=title, notes=notes)
