"""`lunarsci twin terrain`: look at a terrain and plan a path on it."""

from collections.abc import Iterable
from typing import Annotated

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report
from . import terrain_options as options

__all__ = ["add_to"]


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
    soil: options.SoilName = None,
    baseline: options.Baseline = None,
    start: options.Start = None,
    target: options.Target = None,
    speed: options.Speed = None,
    max_slope: options.MaxSlope = None,
    max_step: options.MaxStep = None,
    max_roughness: options.MaxRoughness = None,
    turning_radius: options.TurningRadius = None,
    hazard_distance: options.HazardDistance = None,
    seed: options.Seed = None,
    spacing: options.Spacing = None,
    rocks: options.Rocks = None,
    roughness: options.Roughness = None,
    extent: options.Extent = None,
    ground_slope: options.GroundSlope = None,
    craters: options.Craters = None,
    geotiff: Annotated[bool, typer.Option("--geotiff", help="With -o, the maps also as maps.tif.")] = False,
) -> Report:
    """Maps of slope, roughness and step height of a terrain, and where a rover may drive; with --target, a path.

    With -o DIR the terrain goes to terrain.npz, the maps to maps.npz, and a path to plan.toml and path.csv:
    `lunarsci twin predict DIR/plan.toml --terrain DIR/terrain.npz` drives it. Plan and terrain keep the rover and the
    limits that they were made for.
    """
    from .terrain_report import PathRequest, read_site, terrain_report

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
        "hazard_distance_m": hazard_distance,
    }
    of_a_path = (("--start", start), ("--speed", speed), ("--turning-radius", turning_radius))
    if target is None:
        _refuse((*of_a_path, ("--hazard-distance", hazard_distance)), "is of a path; give --target, or leave it out")
    if output.path is None:
        _refuse((("--soil", soil), ("--geotiff", geotiff or None)), "goes into a file; give -o DIR, or leave it out")
    asked = PathRequest.parse(start or "0,0,0", target, speed)
    site = read_site(terrain, rover, soil, ground, limits)
    with progress("looking at the ground", quiet=output.quiet) as update:
        surface = site.surface(baseline, update)
    with progress("planning", quiet=output.quiet) as update:
        path = asked.plan(site, surface, update)
    return terrain_report(site, surface, path, geotiff=geotiff)


def _refuse(given: Iterable[tuple[str, object]], why: str) -> None:
    """Options that would do nothing are a mistake to be said."""
    for name, value in given:
        if value is not None:
            raise typer.BadParameter(f"{name} {why}")
