"""`lunarsci twin`: whether the next drive is safe."""

from pathlib import Path
from typing import Annotated

import typer

from . import (
    twin_compare,
    twin_forces,
    twin_history,
    twin_options,
    twin_simulate,
    twin_states,
    twin_terrain,
    twin_update,
)
from .command import command
from .options import Output
from .progress import progress
from .report import Report

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="Whether the next drive is safe: a rover simulated on deformable ground.")


for part in (
    twin_terrain,
    twin_simulate,
    twin_states,
    twin_forces,
    twin_update,
    twin_compare,
    twin_history,
):
    part.add_to(app)


@app.callback()
def twin() -> None:
    """Whether the next drive is safe: a rover simulated on deformable ground."""


@command(app, "predict", folder=True)
def predict(
    output: Output,
    plan: twin_options.PlanFile = None,
    rover: twin_options.RoverName = None,
    terrain: twin_options.TerrainName = "synthetic-longji",
    interpolation: twin_options.Interpolation = "smooth",
    soil: twin_options.SoilName = None,
    sweep: twin_options.Sweeps = None,
    members: twin_options.Members = None,
    samples: twin_options.Samples = None,
    soil_map: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Soils drawn by place from a map of `twin update --save-map` (JSON)."),
    ] = None,
    fixes: twin_options.Fixes = None,
    ruts: twin_options.Ruts = None,
    before: twin_options.Before = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random.", show_default="0")] = None,
    time_step: twin_options.TimeStep = 0.1,
    sample: twin_options.Sample = 0.1,
    animate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The drive as a film: .gif, or .mp4 where ffmpeg is installed.")
    ] = None,
) -> Report:
    """Drive a plan over many soils and say whether it stays within the limits: go, or no-go with exit code 3.

    With -o DIR the wheel states and forces go to states.csv, the paths to paths.csv, the ends to endpoints.csv, the
    spread of all quantities against distance to profiles.csv; with prediction.json `twin compare` sets them beside the
    drive that follows. A plan of `twin terrain` is driven by the rover that it was made for, unless --rover says
    otherwise.

    On soils of a belief every drive also carries a draw of what the twin's physics is off by, in its place, slip, side
    slip, sinkage and forces; the result says how much of the ends' variance that is.
    """
    if animate is not None:
        from lunarsci.twin.figures.animation import FORMATS, check_format

        output.check_extra("--animate", animate, FORMATS)
        check_format(animate)
    from .twin_drive import Soils, drive, with_physics, with_verdict
    from .twin_report import predict_report, read_scene

    scene = read_scene(plan, rover, terrain, soil, interpolation, fixes, judged=True, ruts=ruts, before=before)
    soils = Soils.of(sweep, members, samples, seed or 0, scene.soil, soil_map)
    soils.check(scene, seed_given=seed is not None)
    with progress("driving", quiet=output.quiet) as update:
        prediction = with_physics(scene, soils, drive(scene, soils, time_step, sample, update))
    ground = soils.record(scene)
    seed = soils.drawn_by(scene)
    kind = soils.kind(scene)
    report = predict_report(scene, prediction, kind, ground, seed=seed, film=animate, quiet=output.quiet)
    return with_verdict(report, soils.verdict)
