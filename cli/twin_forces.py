"""`lunarsci twin forces`: what the wheels carry and pull along a drive."""

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
    command(app, "forces")(forces)


def forces(
    output: Output,
    plan: twin_options.PlanFile = None,
    motion: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="A motion that was measured, instead of a predicted one: CSV with time_s, x_m, y_m, yaw_deg.",
        ),
    ] = None,
    member: Annotated[
        int | None, typer.Option(min=0, help="Which member of the motion's file, where it has several.")
    ] = None,
    rover: twin_options.RoverName = "yutu2",
    terrain: twin_options.TerrainName = "synthetic-longji",
    interpolation: twin_options.Interpolation = "smooth",
    soil: twin_options.SoilName = "longji",
    sweep: twin_options.Sweeps = None,
    members: twin_options.Members = None,
    samples: twin_options.Samples = None,
    fixes: twin_options.Fixes = None,
    seed: twin_options.Seed = 0,
    time_step: twin_options.TimeStep = 0.1,
    sample: twin_options.Sample = 0.1,
) -> Report:
    """Load, drawbar pull, lateral force and torque of every wheel along a predicted drive, or along a given motion.

    A predicted drive has the soil of the terrain unless --sweep, --samples or a belief as --soil name others. A given
    motion takes the wheels' commands from columns such as steering_FL_deg and speed_FL_m_s, or else from the plan at
    the same times; what its wheels do not supply of the force that the motion needs is said.
    """
    from .twin_drive import Soils, drive
    from .twin_forces_report import held_report, predicted_report
    from .twin_report import read_scene

    scene = read_scene(plan, rover, terrain, soil, interpolation, fixes)
    if motion is not None:
        if sweep is not None or members is not None or samples is not None or scene.soil is not None:
            raise typer.BadParameter(
                "--motion is held on one soil; leave out --sweep, --members, --samples and a belief as --soil"
            )
        return held_report(scene, motion, member, planned=plan is not None)
    if member is not None:
        raise typer.BadParameter("--member chooses from the file of --motion; give that, or leave it out")
    alone = sweep is None and members is None and samples is None and scene.soil is None
    soils = Soils.of([] if alone else sweep, members, samples, seed, scene.soil)
    with progress("driving", quiet=output.quiet) as update:
        return predicted_report(scene, drive(scene, soils, time_step, sample, update))
