"""`lunarsci twin update`: what a drive says of the soil, for the next prediction."""

from pathlib import Path
from typing import Annotated

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report
from . import options

__all__ = ["add_to"]

Ruts = Annotated[
    bool | None,
    typer.Option(
        "--ruts/--no-ruts", help="Whether wheels met the ruts of others; as explains the drive better, if left out."
    ),
]

Particles = Annotated[int, typer.Option(min=32, help="Soils that carry the belief.")]


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
        str | None, typer.Option(metavar="FILE", help="What was believed before (JSON); the priors if left out.")
    ] = None,
    forget: Annotated[
        float, typer.Option(min=0, max=1, help="Share of the way back to the first priors, for ground further on.")
    ] = 0.0,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The new belief (JSON): for --belief, and `twin predict --soil`."),
    ] = None,
    map_before: Annotated[
        str | None,
        typer.Option("--map", metavar="FILE", help="Soil map before the drive (JSON), instead of --belief."),
    ] = None,
    save_map: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The soil map after it (JSON): each stretch of the way with its own soil."),
    ] = None,
    save_terrain: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The terrain with the median soil at every node, and what is known (.npz)."),
    ] = None,
    correlation: Annotated[
        float | None,
        typer.Option(min=0.1, help="Distance in m over which soils are alike; the map's, or 5, if left out."),
    ] = None,
    rover: options.RoverName = None,
    terrain: options.TerrainName = "synthetic-longji",
    interpolation: options.Interpolation = "smooth",
    particles: Particles = 128,
    ruts: Ruts = None,
    seed: options.Seed = 0,
) -> Report:
    """Rectify what is believed of the soil by a drive that happened: the twin drives it on many soils.

    Soils are kept as they meet the measured states and positions. Where no soil explains them, nothing is learned, it
    is said why, and the exit code is 3. It is said, too, where along the way the soil changes; with a map each stretch
    between changes is learned on its own, and far from all that was driven the map returns to the first priors.

    Values are effective ones, with which the twin's law drives as the rover did; the ground's own have wider intervals.
    What no soil explains teaches how far the twin's physics is off, which predictions from the belief then carry.
    """
    from .update_map import MapFiles
    from .update_report import UpdateInputs, update_report

    if belief is not None and (map_before is not None or save_map is not None or save_terrain is not None):
        raise typer.BadParameter("--belief is of one soil everywhere; give --map, or leave the map's options out")
    if correlation is not None and map_before is None and save_map is None and save_terrain is None:
        raise typer.BadParameter("--correlation is of a soil map; give --map, --save-map or --save-terrain")
    if forget and belief is None and map_before is None:
        raise typer.BadParameter("--forget has nothing to forget, as the priors are believed; give --belief or --map")
    output.check_extra("--save", save, (".json",))
    output.check_extra("--save-map", save_map, (".json",))
    output.check_extra("--save-terrain", save_terrain, (".npz",))
    files_of_map = MapFiles(map_before, save_map, save_terrain, correlation)
    known = UpdateInputs.read(states, positions, belief, forget, plan, rover, terrain, interpolation, files_of_map)
    with progress("driving on many soils", quiet=output.quiet) as advance:
        learned = known.learned(particles, seed, ruts, advance)
    return update_report(known, learned, seed, save, files_of_map)
