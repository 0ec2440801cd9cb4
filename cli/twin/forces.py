"""`lunarsci twin forces`: what the wheels carry and pull along a drive."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report
from . import options

__all__ = ["add_to"]

MEASURED = "With --motion: uncertain motion and soil"
PREDICTED = ("--sweep", "--members", "--samples", "--fixes", "--time-step", "--sample")
UNCERTAIN = ("--states", "--belief", "--draws", "--correlation", "--balance-error", "--iterate", "--save")


StatesFile = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Measured wheel states (CSV: time_s, wheel, sinkage_m, slip_ratio, ...) that get the forces.",
        rich_help_panel=MEASURED,
    ),
]
BeliefFile = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="What is believed of the soil (JSON of `twin update`); the priors if left out.",
        rich_help_panel=MEASURED,
    ),
]
Draws = Annotated[
    int | None,
    typer.Option(min=16, max=4096, help="Soils and motions to draw; 64 if left out.", rich_help_panel=MEASURED),
]
Correlation = Annotated[
    float | None,
    typer.Option(
        help="Distance in m over which the motion's errors stay alike; from the slips' errors, or 0.5, if left out.",
        rich_help_panel=MEASURED,
    ),
]
BalanceError = Annotated[
    float | None,
    typer.Option(
        help="Error of the balance of forces as a share of the weight; 0.005 if left out.", rich_help_panel=MEASURED
    ),
]
Rounds = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=50,
        help="Rounds, at most, of forces and soil in turn: needs --states with sinkages.",
        rich_help_panel=MEASURED,
    ),
]
SavedBelief = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The soil after --iterate as a belief (JSON), for `twin predict --soil`.",
        rich_help_panel=MEASURED,
    ),
]


MotionFile = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="A motion that was measured, instead of a predicted one: CSV with time_s, x_m, y_m, yaw_deg.",
    ),
]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "forces", folder=None)(forces)


def forces(
    output: Output,
    plan: options.PlanFile = None,
    motion: MotionFile = None,
    member: Annotated[
        int | None, typer.Option(min=0, help="Which member of the motion's file, where it has several.")
    ] = None,
    states: StatesFile = None,
    belief: BeliefFile = None,
    draws: Draws = None,
    correlation: Correlation = None,
    balance_error: BalanceError = None,
    iterate: Rounds = None,
    save: SavedBelief = None,
    rover: options.RoverName = None,
    terrain: options.TerrainName = "synthetic-longji",
    interpolation: options.Interpolation = "smooth",
    soil: options.SoilName = None,
    sweep: options.Sweeps = None,
    members: options.Members = None,
    samples: options.Samples = None,
    fixes: options.Fixes = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random; 0 if left out.")] = None,
    time_step: Annotated[float | None, typer.Option(help="Longest time step in s; 0.1 if left out.")] = None,
    sample: Annotated[
        float | None, typer.Option(help="Distance between recorded states in m; 0.1 if left out.")
    ] = None,
) -> Report:
    """Load, drawbar pull, lateral force and torque of every wheel along a predicted drive, or along a measured motion.

    A predicted drive has the soil of the terrain unless --sweep, --samples or a belief as --soil name others. A
    measured motion takes the wheels' commands from columns such as steering_FL_deg and speed_FL_m_s, or else from the
    plan at the same times; what its wheels do not supply of the force that the motion needs is said.

    With --states, --belief or --draws the motion is as uncertain as its columns x_m_sigma, y_m_sigma and yaw_deg_sigma
    say, and the soil as the belief. Forces are then computed on many soils and motions and made to balance: all wheels
    together have to carry weight and slope. It is said how much of each force comes from the assumed soil. What the
    wheels supply together is then well known; how it shares out among them stays assumed. --iterate looks for the soil
    with these forces: forces that came from a soil cannot prove it, so only sinkages under the loads, and slips against
    what all wheels together pull, speak of it. Exit code 3 where the rounds do not converge.
    """
    given = {
        "--member": member, "--states": states, "--belief": belief, "--draws": draws, "--correlation": correlation,
        "--balance-error": balance_error, "--iterate": iterate, "--save": save, "--soil": soil, "--sweep": sweep,
        "--members": members, "--samples": samples, "--fixes": fixes, "--seed": seed, "--time-step": time_step,
        "--sample": sample,
    }  # fmt: skip
    used = {name for name, value in given.items() if value is not None}
    if save is not None:
        output.check_extra("--save", save, (".json",))
    if motion is None:
        refuse(used, ("--member", *UNCERTAIN), "belongs to --motion; give that, or leave it out")
        return _predicted(output, given, used, (plan, rover, terrain, interpolation))
    refuse(used, PREDICTED, "has no use with --motion, which is measured and not driven; leave it out")
    from lunarsci.twin.jobs.drive_inputs import read_drive_inputs

    drawn = bool(used & set(UNCERTAIN))
    scene = read_drive_inputs(plan, rover, terrain, interpolation, soil=soil, soil_counts=not drawn)
    if not scene.given.one_soil:
        raise typer.BadParameter("--motion is held on one soil; give the belief as --belief")
    if not drawn:
        from .forces_report import held_report

        refuse(used, ("--seed",), "draws nothing here; give --draws or --belief, or leave it out")
        return held_report(scene, motion, member, planned=plan is not None)
    refuse(used, ("--soil",), "has no use beside soils that are drawn from --belief or the priors; leave it out")
    from .motion_report import Told, motion_report

    told = Told(motion, member, states, belief, draws, correlation, balance_error, iterate, save, seed or 0)
    told.check()
    with progress("holding the rover to its motion", quiet=output.quiet) as update:
        return motion_report(scene, told, update, planned=plan is not None)


def refuse(used: set[str], names: tuple[str, ...], why: str) -> None:
    """Options that would do nothing are a mistake to be said."""
    for name in names:
        if name in used:
            raise typer.BadParameter(f"{name} {why}")


def _predicted(output: Output, given: dict[str, Any], used: set[str], scenery: tuple[Any, ...]) -> Report:
    from lunarsci.twin.jobs.drive_inputs import read_drive_inputs
    from lunarsci.twin.jobs.predict import predict_drives
    from lunarsci.twin.jobs.soils import Soils

    from .forces_report import predicted_report

    sweep, members = given["--sweep"], given["--members"]
    plan, rover, terrain, interpolation = scenery
    soil = [name for name in (given["--soil"], given["--samples"]) if name is not None]
    scene = read_drive_inputs(plan, rover, terrain, interpolation, soil=soil, fixes=given["--fixes"])
    alone = sweep is None and members is None and scene.given.one_soil
    soils = Soils.of(scene, [] if alone else sweep, members, given["--seed"] or 0)
    if soils.drawn_by is None:
        refuse(used, ("--seed",), "has nothing to draw; give --members, --soil or --fixes, or leave it out")
    with progress("driving", quiet=output.quiet) as update:
        prediction = predict_drives(soils, given["--time-step"] or 0.1, given["--sample"] or 0.1, update)
        return predicted_report(soils.inputs, prediction, soils.record(), soils.drawn_by)
