"""`lunarsci twin update`: what a drive says of the soil, for the next prediction."""

from pathlib import Path
from typing import Annotated

import typer

from . import twin_options
from .command import command
from .options import Output
from .progress import progress
from .report import Report

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "update")(update)


def update(
    states: Annotated[
        str,
        typer.Argument(help="Measured wheel states (CSV): time_s, wheel, sinkage_m, slip_ratio, ..., NAME_sigma."),
    ],
    output: Output,
    plan: Annotated[str | None, typer.Option(help="Plan that was driven (TOML); the embedded one if left out.")] = None,
    positions: Annotated[
        str | None, typer.Option(metavar="FILE", help="Positions from localisation (CSV): time_s, x_m, y_m, sigma_m.")
    ] = None,
    belief: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="What was believed before (JSON); the priors if left out."),
    ] = None,
    forget: Annotated[
        float, typer.Option(min=0, max=1, help="Share of the way back to the first priors, for ground further on.")
    ] = 0.0,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The new belief (JSON): for --belief, and `twin predict --soil`."),
    ] = None,
    rover: twin_options.RoverName = "yutu2",
    terrain: twin_options.TerrainName = "synthetic-longji",
    interpolation: twin_options.Interpolation = "smooth",
    particles: Annotated[int, typer.Option(min=32, help="Soils that carry the belief.")] = 128,
    seed: twin_options.Seed = 0,
) -> Report:
    """Rectify what is believed of the soil by a drive that happened: the twin drives it on many soils.

    Soils are kept as they meet the measured states and positions. Where no soil explains them, nothing is learned, it
    is said why, and the exit code is 3.
    """
    from .twin_update_report import Known, update_report

    if save is not None:
        output.check_extra("--save", save, (".json",))
    known = Known.read(states, positions, belief, forget, plan, rover, terrain, interpolation)
    with progress("driving on many soils", quiet=output.quiet) as advance:
        found = known.rectified(particles, seed, advance)
    return update_report(known, found, seed, save)
