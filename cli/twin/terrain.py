"""`lunarsci twin terrain`: look at a terrain."""

from typing import Annotated

import typer

from lunarsci.twin.jobs import terrain as job
from lunarsci.twin.jobs.terrain import TerrainRequest, TerrainSurvey

from ..shared.command import command
from ..shared.options import Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable
from .options import GRAVITY, KEEP_OUT

LIMITS, GROUND = "Limits, instead of those of the rover file", "Synthetic ground"
LAYERS = "Layers and light"
OPTIONS = {
    "rover": option("Rover: a name (yutu2, small-four) or a TOML file.", show_default="yutu2"),
    "soil": option(
        "With -o, soil of terrain.npz in place of the terrain's: a name or a TOML file.",
        show_default="the terrain's, or longji",
    ),
    "gravity": GRAVITY,
    "height_unit": option(
        "Unit of the terrain's heights, in place of what its file states.", show_default="what the file states, or m"
    ),
    "keep_out": KEEP_OUT,
    "layer": option(
        "Raster on any grid (GeoTIFF, .asc, .npz, .csv) of factors on the cost of a metre, or with --class of classes "
        "of ground; repeatable.",
        panel=LAYERS,
        metavar="FILE",
    ),
    "classes": option(
        "What a class of the layers costs: a factor, or forbidden; repeatable.",
        "--class",
        panel=LAYERS,
        metavar="VALUE=forbidden|COST",
    ),
    "sun": option(
        "Direction of the Sun in deg, from x towards y and over the horizon: shadows go to the maps.",
        panel=LAYERS,
        metavar="AZIMUTH,ELEVATION",
    ),
    "shadow_cost": option(
        "With --sun, factor on the cost of a metre in shadow, or forbidden.", panel=LAYERS, metavar="COST|forbidden"
    ),
    "baseline": option("Side in m of the square whose slope is measured; the rover's by default."),
    "max_slope": option("Steepest slope, in deg.", panel=LIMITS),
    "max_step": option("Highest step, in m.", panel=LIMITS),
    "max_roughness": option("Largest roughness, in m.", panel=LIMITS),
    "seed": option("Seed.", panel=GROUND),
    "spacing": option("Grid spacing, in m.", panel=GROUND),
    "rocks": option("Share of ground under rocks; 0.0021 at Chang'E-4.", panel=GROUND),
    "roughness": option("Rms height of waves of 0.4 to 4 m, in m.", panel=GROUND),
    "extent": option("Side of the square in m; not of Longji.", panel=GROUND),
    "ground_slope": option("Slope along x in deg; not of Longji.", panel=GROUND),
    "craters": option("Number of craters; not of Longji.", "--crater-count", panel=GROUND),
}
TERRAIN = "synthetic-longji, synthetic, or a file (.npz, GeoTIFF, PDS3, PDS4, ISIS, ESRI ASCII .asc, CSV of nodes)."
TerrainFile = Annotated[str, typer.Argument(help=TERRAIN, metavar="TERRAIN")]
NamedTerrain = Annotated[str | None, typer.Argument(help=TERRAIN, metavar="TERRAIN", show_default="synthetic-longji")]
GeoTiff = Annotated[bool, typer.Option("--geotiff", help="With -o, the maps also as maps.tif.")]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "terrain", folder=True, request=TerrainRequest, options=OPTIONS)(terrain)


def terrain(
    output: Output, request: TerrainRequest, terrain: TerrainFile = "synthetic-longji", geotiff: GeoTiff = False
) -> Report:
    """Maps of slope, roughness and step height of a terrain, and where a rover may drive.

    With -o DIR the terrain goes to terrain.npz and the maps to maps.npz. The terrain keeps the rover and the limits
    that it was looked at for. `lunarsci twin plan` finds a path on it.
    """

    check_files(output, soil=request.soil is not None, geotiff=geotiff)
    with progress("looking at the ground", quiet=output.quiet) as update:
        found = job.terrain(terrain, request, progress=update)
    return Report.of(found, [ground_table(found)], files=found.files(geotiff=geotiff))


def check_files(output: Output, *, soil: bool, geotiff: bool) -> None:
    """Options of files that are not written are a mistake to be said."""
    for name, given in (("--soil", soil), ("--geotiff", geotiff)):
        if given and output.path is None:
            raise typer.BadParameter(f"{name} goes into a file; give -o DIR, or leave it out")


def ground_table(found: TerrainSurvey) -> TextTable:
    """The maps beside their limits, for people."""
    result, limits, maps = found.to_dict(), found.site.mobility, found.surface.maps
    terrain = result["terrain"]
    unlimited = {"slope_deg": limits.max_slope_deg, "roughness_m": limits.max_roughness_m, "step_m": limits.max_step_m}
    rows = []
    for name, spread in result["maps"].items():
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
        f"may be driven on: {result['traversable_share']:.1%}; hazards {result['hazard_share']:.1%}; "
        f"unknown, near holes or the edge, {result['unknown_share']:.1%}",
        f"slope and roughness under {maps.baseline_m:g} m x {maps.baseline_m:g} m"
        + (f", step heights, slope removed, within {maps.wheel_window_m:g} m" if maps.shows_steps else ""),
        *([f"in shadow: {result['sun']['shadow_share']:.1%}"] if "sun" in result else []),
        *result["notes"],
    ]
    return TextTable(["map", "p5", "p50", "p95", "max", "limit"], rows, title=title, notes=notes)
