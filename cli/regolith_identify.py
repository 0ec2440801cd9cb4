"""`lunarsci regolith identify`: the soil that wheel states reveal."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .command import command
from .options import Output
from .progress import progress
from .regolith_options import Reading, Rover
from .report import Report

if TYPE_CHECKING:
    from lunarsci.regolith.states import MeasurementErrors

    from .regolith_report import Intervals

__all__ = ["add_to"]

ERRORS, JOINT = "Errors (where the file gives none)", "All states together"


def _error(text: str, *names: str) -> Any:
    return typer.Option(*names, help=text, rich_help_panel=ERRORS)


def _joint(text: str, *names: str, metavar: str | None = None) -> Any:
    return typer.Option(*names, help=text, metavar=metavar, rich_help_panel=JOINT)


States = Annotated[
    str,
    typer.Argument(
        help="CSV of wheel states: sinkage_m, normal_force_n, drawbar_pull_n, and where known slip_ratio, "
        "side_slip_deg, lateral_force_n; NAME_sigma is the error of NAME; - is stdin."
    ),
]
Exponent = Annotated[float | None, typer.Option(help="Assume N and solve K_s; 1.0 if neither is given.")]
Stiffness = Annotated[float | None, typer.Option(help="Assume K_s in kPa m^-N and solve N.")]
Cohesion = Annotated[float | None, typer.Option(help="Assume c in Pa and solve φ; 520 if neither is given.")]
FrictionAngle = Annotated[float | None, typer.Option(help="Assume φ in deg and solve c.")]
ShearModulus = Annotated[float, typer.Option(help="Assumed K_x in mm.")]
LateralModulus = Annotated[
    str | None, typer.Option(help="Assume K_y in mm, one or several by commas, and solve φ_y; 13,40 if not given.")
]
ExternalFrictionAngle = Annotated[float | None, typer.Option(help="Assume φ_y in deg and solve K_y.")]
Draws = Annotated[int, typer.Option(min=2, max=1_000_000, help="Monte Carlo draws per state.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]
SinkageError = Annotated[float, _error("1σ of the sinkage, in m.")]
ForceError = Annotated[float, _error("1σ of the forces, relative.")]
TravelError = Annotated[float, _error("1σ of the travelled distance, relative; slip errs by it times 1 - |s|.")]
SideSlipError = Annotated[float, _error("1σ of the side slip, relative.")]
Sensitivity = Annotated[bool, _error("How much of each variance comes from each measured quantity.", "--sensitivity")]
Joint = Annotated[bool, _joint("All parameters from all states at once, as a posterior.", "--joint")]
Prior = Annotated[str | None, _joint("Priors of --joint, in place of the lunar ones.", metavar="FILE.toml")]
Exact = Annotated[bool, _joint("Integrate the stresses in --joint instead of Eqs 21-24.", "--exact")]
Sample = Annotated[bool, _joint("Draw from the posterior of --joint itself, not a normal law.", "--sample")]
Profile = Annotated[bool, _joint("Intervals of --joint by profile: the best of all else at each value.", "--profile")]
ModelError = Annotated[float, _joint("Share of the load by which the model of --joint may miss a force.")]

Posterior = Annotated[
    Path | None, _joint("Draws from the posterior of --joint as CSV, for `twin predict --samples`.", "--posterior")
]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "identify")(identify)


def identify(
    states: States,
    output: Output,
    rover: Rover = "yutu2",
    exponent: Exponent = None,
    stiffness: Stiffness = None,
    cohesion: Cohesion = None,
    friction_angle: FrictionAngle = None,
    shear_modulus: ShearModulus = 17.8,
    lateral_modulus: LateralModulus = None,
    external_friction_angle: ExternalFrictionAngle = None,
    reading: Reading = "signed",
    draws: Draws = 1024,
    seed: Seed = 0,
    sinkage_error: SinkageError = 0.00033,
    force_error: ForceError = 0.1 / 3,
    travel_error: TravelError = 0.04 / 3,
    side_slip_error: SideSlipError = 0.04 / 3,
    sensitivity: Sensitivity = False,
    joint: Joint = False,
    prior: Prior = None,
    exact: Exact = False,
    sample: Sample = False,
    profile: Profile = False,
    model_error: ModelError = 0.02,
    posterior: Posterior = None,
) -> Report:
    """Soil parameters in three aspects (bearing, longitudinal and lateral shear) from wheel states, with errors.

    Of each pair (K_s, N), (c, φ), (K_y, φ_y) what is assumed is given and the other is solved for; with both given,
    each is solved at the other's value.
    """
    from lunarsci.regolith.identify import Assumptions
    from lunarsci.regolith.identify import identify as identify_soil
    from lunarsci.regolith.sensitivity import sensitivities

    from .regolith_report import identify_report, infer, numbers, read_inputs

    _check_posterior(output, posterior, joint)
    intervals = _intervals(joint, reading, prior, exact, sample, profile)
    known = Assumptions(
        exponent=exponent,
        stiffness_kpa_m_n=stiffness,
        cohesion_pa=cohesion,
        friction_angle_deg=friction_angle,
        shear_modulus_mm=shear_modulus,
        lateral_modulus_mm=numbers(lateral_modulus, "--lateral-modulus"),
        external_friction_angle_deg=external_friction_angle,
    )
    given = read_inputs(states, rover, _errors(sinkage_error, force_error, travel_error, side_slip_error))
    with progress("identifying", quiet=output.quiet) as update:
        found = identify_soil(
            given.states, given.wheel, known, reading=reading, draws=draws, seed=seed, progress=update
        )
    together = None
    if joint:
        with progress("the joint posterior", quiet=output.quiet) as update:
            together = infer(given, prior, exact, intervals, model_error, seed, update)
    shares = sensitivities(given.states, given.wheel, known, reading=reading, seed=seed) if sensitivity else None
    return identify_report(given, found, seed, together, shares, posterior)


def _errors(sinkage_m: float, force: float, travel: float, side_slip: float) -> "MeasurementErrors":
    from lunarsci.regolith.states import MeasurementErrors

    return MeasurementErrors(
        sinkage_m=sinkage_m, force_relative=force, travel_relative=travel, side_slip_relative=side_slip
    )


def _check_posterior(output: Output, path: Path | None, joint: bool) -> None:
    if path is not None and not joint:
        raise typer.BadParameter("--posterior belongs to --joint; add it")
    output.check_extra("--posterior", path, (".csv",))


def _intervals(joint: bool, reading: str, prior: str | None, exact: bool, sample: bool, profile: bool) -> "Intervals":
    from .regolith_report import Intervals

    if not joint and (prior or exact or sample or profile):
        raise typer.BadParameter("--prior, --exact, --sample and --profile belong to --joint; add it")
    if sample and profile:
        raise typer.BadParameter("--sample and --profile are two ways to the intervals; give one")
    if joint and reading != "signed":
        raise typer.BadParameter(f"--reading {reading} only reproduces numbers; --joint needs --reading signed")
    return Intervals(sample, profile)
