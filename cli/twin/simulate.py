"""`lunarsci twin simulate`: a made-up drive and the telemetry it would send."""

from typing import Annotated

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report
from . import options

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "simulate", folder=True)(simulate)


def simulate(
    output: Output,
    plan: options.PlanFile = None,
    rover: options.RoverName = None,
    terrain: options.TerrainName = "synthetic-longji",
    interpolation: options.Interpolation = "smooth",
    soil: Annotated[
        str | None,
        typer.Option(
            help="The true soil, in place of the terrain's: a name or a TOML file.",
            show_default="the terrain's, or longji",
        ),
    ] = None,
    ruts: options.Ruts = None,
    before: options.Before = None,
    fix_distance: Annotated[float, typer.Option(help="Way between localised positions in m.")] = 0.5,
    fix_sigma: Annotated[
        float | None,
        typer.Option(
            help="Their standard error in m, in x and in y; a third of 4 % of the way between them by default."
        ),
    ] = None,
    yaw_sigma: Annotated[float, typer.Option(help="Standard error of the heading in degrees; assumed.")] = 0.1,
    track_sigma: Annotated[float, typer.Option(help="Standard error of the track's depth in m.")] = 0.00033,
    seed: options.Seed = 0,
    time_step: options.TimeStep = 0.05,
    sample: Annotated[float, typer.Option(help="Way between rows of telemetry in m.")] = 0.05,
) -> Report:
    """Drive a plan once on one soil and write the telemetry that such a drive would send, sensor errors included.

    With -o DIR the telemetry goes to telemetry.csv, the depth of the track to track.csv, and the truth behind both to
    truth.csv. All of it is made up and says so. `lunarsci twin states` reads the first two.
    """
    from lunarsci.twin.jobs.drive_inputs import read_drive_inputs
    from lunarsci.twin.telemetry.simulated import SensorErrors

    from .simulate_report import simulate_report, simulated

    errors = SensorErrors(fix_distance_m=fix_distance, fix_sigma_m=fix_sigma, yaw_deg=yaw_sigma, track_m=track_sigma)
    scene = read_drive_inputs(plan, rover, terrain, interpolation, soil=soil, ruts=ruts, before=before)
    if not scene.given.one_soil:
        raise typer.BadParameter(f"--soil {soil} is a belief, and the truth is one soil; give a name or a TOML file")
    with progress("driving", quiet=output.quiet) as update:
        drive = simulated(scene, errors, seed, time_step, sample, update)
    return simulate_report(scene, drive)
