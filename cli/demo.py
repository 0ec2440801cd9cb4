"""`lunarsci demo`: the whole chain on embedded synthetic data."""

from typing import Annotated

import typer

from .shared.command import command
from .shared.options import Output
from .shared.report import Report
from .shared.talk import say

__all__ = ["add_to"]

FOLDER = "lunarsci-demo"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "demo", folder=True, default_path=FOLDER)(demo)


def demo(
    output: Output,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise and the draws.")] = 0,
) -> Report:
    """Run the whole chain on embedded synthetic data: rock, drive, ground. Under a minute on two cores.

    Inputs, tables and pictures go to the folder lunarsci-demo, or to -o DIR; try the other commands on them.
    """
    from .demo_report import demo_report, drive, ground
    from .demo_rock import rock

    say("1/3 a synthetic rock: calibration, bands and Modified Gaussian Model", quiet=output.quiet)
    the_rock = rock(seed)
    say("2/3 a drive of 9.8 m on synthetic terrain, over 81 soils", quiet=output.quiet)
    the_drive = drive(seed)
    say("3/3 the soil that the wheels of that drive reveal", quiet=output.quiet)
    return demo_report(the_rock, the_drive, ground(the_drive, seed), seed, output.path)
