"""`lunarsci twin compare`: what was predicted beside what happened."""

from pathlib import Path
from typing import Annotated

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.report import Report
from . import options

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
    belief: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Belief (JSON) whose discrepancy of the twin's physics learns from the miss, for --save.",
        ),
    ] = None,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Takes the belief of --belief with what was learned (JSON).")
    ] = None,
    rover: options.RoverName = "yutu2",
    seed: options.Seed = 0,
) -> Report:
    """Was the prediction to be trusted: where the drive ended, its path and its wheel states beside what was predicted.

    The drive is held against the predicted drives, each with the errors of measurement that the real one has. If the
    prediction is right, the real drive is one more of them; where it is farther off than all but 1 in 100 would be, the
    prediction was not to be trusted, it is said why, and the exit code is 3. Times count from the start of the plan.
    What was not measured is named and not judged.

    With --belief and --save, how far the drive missed teaches a belief how far the twin's physics is off, beside its
    soil: regions of later predictions grow or shrink with it. Compare first, then `twin update` the saved belief.
    """
    from .compare_report import compare_report, learn, read_meeting

    if (belief is None) != (save is None):
        raise typer.BadParameter("--belief FILE and --save FILE belong together; give both, or neither")
    output.check_extra("--save", save, (".json",))
    met = read_meeting(predicted, states, positions, plan, rover or "yutu2")
    return compare_report(met, seed, None if belief is None or save is None else learn(met, belief, save))
