"""`lunarsci twin compare`: what was predicted beside what happened."""

from pathlib import Path
from typing import Annotated

import typer

from . import twin_options
from .command import command
from .options import Output
from .report import Report

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "compare")(compare)


def compare(
    predicted: Annotated[
        Path, typer.Argument(metavar="PREDICTED_DIR", help="Folder that `twin predict -o` wrote before the drive.")
    ],
    states: Annotated[
        str,
        typer.Argument(
            metavar="STATES.csv", help="Measured wheel states: time_s, wheel, sinkage_m, slip_ratio, ..., NAME_sigma."
        ),
    ],
    output: Output,
    positions: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="Measured positions (CSV): time_s, x_m, y_m, and sigma_m or xx_m2, xy_m2, yy_m2."
        ),
    ] = None,
    plan: Annotated[
        str | None, typer.Option(metavar="FILE", help="Plan that was driven (TOML): refused if another was predicted.")
    ] = None,
    rover: twin_options.RoverName = "yutu2",
    seed: twin_options.Seed = 0,
) -> Report:
    """Was the prediction to be trusted: where the drive ended, its path and its wheel states beside what was predicted.

    The drive is held against the predicted drives, each with the errors of measurement that the real one has. If the
    prediction is right, the real drive is one more of them; where it is farther off than all but 1 in 100 would be, the
    prediction was not to be trusted, it is said why, and the exit code is 3. Times count from the start of the plan.
    What was not measured is named and not judged.
    """
    from .twin_compare_report import compare_report, read_meeting

    return compare_report(read_meeting(predicted, states, positions, plan, rover or "yutu2"), seed)
