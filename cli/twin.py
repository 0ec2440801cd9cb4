"""`lunarsci twin`: whether the next drive is safe."""

from pathlib import Path
from typing import Annotated

import typer

from . import twin_terrain
from .command import command
from .options import Output
from .progress import progress
from .report import Report

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="Whether the next drive is safe: a rover simulated on deformable ground.")


twin_terrain.add_to(app)


@app.callback()
def twin() -> None:
    """Whether the next drive is safe: a rover simulated on deformable ground."""


@command(app, "predict", folder=True)
def predict(
    output: Output,
    plan: Annotated[
        str | None, typer.Argument(help="Plan of the drive (TOML); the embedded one of Yutu-2 to the rock if left out.")
    ] = None,
    rover: Annotated[str, typer.Option(help="Rover: a name (yutu2, small-four) or a TOML file.")] = "yutu2",
    terrain: Annotated[
        str, typer.Option(help="Terrain: synthetic-longji, or a file (.npz, GeoTIFF, ESRI ASCII .asc, CSV of nodes).")
    ] = "synthetic-longji",
    soil: Annotated[str, typer.Option(help="Soil where the terrain has none: a name or a TOML file.")] = "longji",
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH:N", help="Uncertain soil parameter, repeatable; replaces the plan's sweeps."
        ),
    ] = None,
    members: Annotated[
        int | None, typer.Option(min=1, help="Latin-hypercube samples of the ranges instead of the grid of all values.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the samples.")] = 0,
    time_step: Annotated[float, typer.Option(help="Longest time step [s].")] = 0.1,
    sample: Annotated[float, typer.Option(help="Distance between recorded states [m].")] = 0.1,
    animate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The drive as a film: .gif, or .mp4 where ffmpeg is installed.")
    ] = None,
) -> Report:
    """Drive a plan over many soils and say whether it stays within the limits: go, or no-go with exit code 3.

    With -o DIR the wheel states and forces go to states.csv, the paths to paths.csv, the ends to endpoints.csv, the
    spread of all quantities against distance to profiles.csv.
    """
    if animate is not None:
        from lunarsci.twin.animation import FORMATS, check_format

        output.check_picture("--animate", animate, FORMATS)
        check_format(animate)
    from lunarsci.twin.ensemble import predict as predict_drive
    from lunarsci.twin.plan import parse_sweep

    from .twin_report import predict_report, read_scene

    scene = read_scene(plan, rover, terrain, soil)
    with progress("driving", quiet=output.quiet) as update:
        prediction = predict_drive(
            scene.rover,
            scene.terrain,
            scene.plan,
            sweep=None if sweep is None else tuple(parse_sweep(text) for text in sweep),
            members=members,
            seed=seed,
            time_step_s=time_step,
            sample_m=sample,
            progress=update,
        )
    return predict_report(scene, prediction, film=animate, quiet=output.quiet)
