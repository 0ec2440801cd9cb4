"""`lunarsci reproduce`: the published numbers beside ours."""

from typing import Annotated, Literal

import typer

from .shared.command import command
from .shared.options import Output
from .shared.report import Report

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "reproduce")(reproduce)


def reproduce(
    output: Output,
    part: Annotated[
        Literal["all", "spectra", "rock", "soil", "drive"],
        typer.Option(help="Which of the numbers, and of the pages of --plot; rock is another name of spectra."),
    ] = "all",
    rocks: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE",
            help="Measured spectra of boulders of Chang'E-4, in any form that `spectra fit` reads; of files with other "
            "targets too, those with 'rock' in their name. May be repeated.",
        ),
    ] = None,
    rover: Annotated[
        str | None,
        typer.Option(help="Rover that drives, and whose wheel is taken: a name or a TOML file.", show_default="yutu2"),
    ] = None,
) -> Report:
    """Numbers of Ding et al. (2024) beside what lunarsci makes of what they publish, with a verdict on each.

    -v prints the reading and the evidence of each number, --plot FILE.pdf draws the paper's figures. The paper comes
    without its measured spectra and its terrain; with --rocks more of the numbers of the rock can be looked at.
    """
    from .reproduce_report import found_numbers, reproduce_report

    of_the_rock = part in ("spectra", "rock")
    if of_the_rock and rover is not None:
        raise typer.BadParameter(f"--rover has no use with --part {part}, where nothing drives; leave it out")
    if rocks and part in ("soil", "drive"):
        raise typer.BadParameter(f"--rocks has no use with --part {part}; give --part spectra, or leave it out")
    found = found_numbers("spectra" if of_the_rock else part, rocks or [], rover or "yutu2", quiet=output.quiet)
    return reproduce_report(found, verbose=output.verbose)
