"""`lunarsci twin states`: from telemetry to slip, side slip and sinkage of every wheel."""

from typing import Annotated

import typer

from ..shared.command import command
from ..shared.report import Report
from . import options

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "states", folder=True)(states)


def states(
    telemetry: Annotated[
        str,
        typer.Argument(
            help="Telemetry: .csv, .ecsv or .parquet, - for CSV from stdin. time_s, x_m, y_m, sigma_m, yaw_deg, and of "
            "each wheel such as FL: angle_FL_deg, rate_FL_deg_s or speed_FL_m_s, and steered_FL_deg or steering_FL_deg."
        ),
    ],
    plan: Annotated[
        str | None, typer.Argument(help="Plan that was driven (TOML), to compare clock and commands with.")
    ] = None,
    rover: options.RoverName = None,
    terrain: options.TerrainName = "synthetic-longji",
    interpolation: options.Interpolation = "smooth",
    track: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Depth of the track: CSV with x_m, y_m, rut_m, or the terrain after the drive. No sinkage without it.",
        ),
    ] = None,
) -> Report:
    """Slip, side slip and sinkage of every wheel, with their errors, from the telemetry of a drive.

    Slip and side slip follow from positions, headings and wheels, and from the slopes of the terrain, one state between
    two positions at most; they are those at its time. How fast they change beside the slopes is found from the data and
    stated; where positions are too few or too coarse to tell, a finding says so. Sinkage follows from the track, for
    the deepest wheel that passed; the others stay blank. What is wrong with the telemetry is listed with what was done
    about it; where the result should not be trusted for it the exit code is 3.

    With -o DIR the states go to states.csv, the positions to positions.csv, and the smoothed motion to motion.csv: what
    `lunarsci twin update` and `lunarsci twin forces` read.
    """
    from .states_report import Sent, states_report

    return states_report(Sent.read(telemetry, plan, rover, terrain, interpolation, track))
