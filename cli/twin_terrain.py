"""`lunarsci twin terrain`: look at a terrain and plan a path on it."""

from typing import Annotated

import typer

from .command import command
from .options import Output
from .progress import progress
from .report import Report

__all__ = ["add_to"]

GROUND, LIMITS, PATH = "Synthetic ground", "Limits, instead of those of the rover file", "Path"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "terrain", folder=True)(terrain)


def terrain(
    output: Output,
    terrain: Annotated[
        str,
        typer.Argument(
            help="synthetic-longji, synthetic, or a file (.npz, GeoTIFF, ESRI ASCII .asc, CSV of nodes).",
            metavar="TERRAIN",
        ),
    ] = "synthetic-longji",
    rover: Annotated[str, typer.Option(help="Rover: a name (yutu2, small-four) or a TOML file.")] = "yutu2",
    soil: Annotated[str, typer.Option(help="Soil where the terrain has none: a name or a TOML file.")] = "longji",
    baseline: Annotated[
        float | None, typer.Option(help="Side in m of the square whose slope is measured; the rover's by default.")
    ] = None,
    start: Annotated[
        str, typer.Option(help="Pose of the rover, in m and deg.", rich_help_panel=PATH, metavar="X,Y,HEADING")
    ] = "0,0,0",
    target: Annotated[
        str | None,
        typer.Option(
            help="Where to plan a path to, in m; with the heading there, in deg.",
            rich_help_panel=PATH,
            metavar="X,Y[,HEADING]",
        ),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Speed in m/s; the rover's highest if left out.", rich_help_panel=PATH)
    ] = None,
    max_slope: Annotated[float | None, typer.Option(help="Steepest slope, in deg.", rich_help_panel=LIMITS)] = None,
    max_step: Annotated[float | None, typer.Option(help="Highest step, in m.", rich_help_panel=LIMITS)] = None,
    max_roughness: Annotated[
        float | None, typer.Option(help="Largest roughness, in m.", rich_help_panel=LIMITS)
    ] = None,
    turning_radius: Annotated[
        float | None, typer.Option(help="Smallest radius of an arc, in m.", rich_help_panel=LIMITS)
    ] = None,
    clearance: Annotated[
        float | None, typer.Option(help="Distance to keep from hazards and holes, in m.", rich_help_panel=LIMITS)
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed.", rich_help_panel=GROUND)] = None,
    spacing: Annotated[float | None, typer.Option(help="Grid spacing, in m.", rich_help_panel=GROUND)] = None,
    rocks: Annotated[
        float | None, typer.Option(help="Share of ground under rocks; 0.0021 at Chang'E-4.", rich_help_panel=GROUND)
    ] = None,
    roughness: Annotated[
        float | None, typer.Option(help="Rms height of waves of 0.4 to 4 m, in m.", rich_help_panel=GROUND)
    ] = None,
    extent: Annotated[
        float | None, typer.Option(help="Side of the square in m; not of Longji.", rich_help_panel=GROUND)
    ] = None,
    ground_slope: Annotated[
        float | None, typer.Option(help="Slope along x in deg; not of Longji.", rich_help_panel=GROUND)
    ] = None,
    craters: Annotated[
        int | None, typer.Option(help="Number of craters; not of Longji.", rich_help_panel=GROUND)
    ] = None,
    geotiff: Annotated[bool, typer.Option("--geotiff", help="With -o, the maps also as maps.tif.")] = False,
) -> Report:
    """Maps of slope, roughness and step height of a terrain, and where a rover may drive; with --target, a path.

    With -o DIR the terrain goes to terrain.npz, the maps to maps.npz, and a path to plan.toml and path.csv:
    `lunarsci twin predict DIR/plan.toml --terrain DIR/terrain.npz` drives it.
    """
    from .twin_terrain_report import Asked, read_site, terrain_report

    ground = {
        "seed": seed,
        "spacing_m": spacing,
        "rock_share": rocks,
        "rms_m": roughness,
        "extent_m": extent,
        "slope_deg": ground_slope,
        "craters": craters,
    }
    limits = {
        "max_slope_deg": max_slope,
        "max_step_m": max_step,
        "max_roughness_m": max_roughness,
        "min_turning_radius_m": turning_radius,
        "clearance_m": clearance,
    }
    asked = Asked.parse(start, target, speed)
    site = read_site(terrain, rover, soil, ground, limits)
    with progress("looking at the ground", quiet=output.quiet) as update:
        surface = site.surface(baseline, update)
    with progress("planning", quiet=output.quiet) as update:
        path = asked.plan(site, surface, update)
    return terrain_report(site, surface, path, geotiff=geotiff)
