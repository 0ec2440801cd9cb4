"""`lunarsci twin predict`: whether the next drive is safe."""

from pathlib import Path
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
    command(app, "predict", folder=True)(predict)


def predict(
    output: Output,
    plan: options.PlanFile = None,
    rover: options.RoverName = None,
    terrain: options.TerrainName = "synthetic-longji",
    interpolation: options.Interpolation = "smooth",
    soil: options.SoilName = None,
    sweep: options.Sweeps = None,
    members: options.Members = None,
    samples: options.Samples = None,
    soil_map: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Soils drawn by place from a map of `twin update --save-map` (JSON)."),
    ] = None,
    fixes: options.Fixes = None,
    ruts: options.Ruts = None,
    before: options.Before = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random.", show_default="0")] = None,
    time_step: options.TimeStep = 0.1,
    sample: options.Sample = 0.1,
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
    from lunarsci.twin.jobs.drive_inputs import read_drive_inputs
    from lunarsci.twin.jobs.soils import Soils

    from .predict_report import predict_report
    from .soils import drive, with_physics, with_verdict

    given = [name for name in (soil, samples, soil_map) if name is not None]
    scene = read_drive_inputs(
        plan, rover, terrain, interpolation, soil=given, fixes=fixes, judged=True, ruts=ruts, before=before
    )
    soils = Soils.of(scene, sweep, members, seed or 0)
    soils.warn_of_seed(seed)
    with progress("driving", quiet=output.quiet) as update:
        prediction = with_physics(soils, drive(soils, time_step, sample, update))
    ground = soils.record()
    report = predict_report(
        soils.inputs, prediction, soils.kind, ground, seed=soils.drawn_by, film=animate, quiet=output.quiet
    )
    return with_verdict(report, soils.verdict)
