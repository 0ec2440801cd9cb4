"""`lunarsci regolith identify`: the soil that wheel states reveal."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report
from .options import Reading, Rover

if TYPE_CHECKING:
    from lunarsci.regolith.states import MeasurementErrors

    from .joint import IntervalRequest

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
TheLaw = Annotated[
    Literal["given", "auto"],
    _joint("Wheel-soil law: as the options say, or the one that predicts states left out best; prints the scores."),
]
Shear = Annotated[Literal["separate", "combined", "ellipse"], _joint("With --exact: as in `regolith forces`.")]
Bulldozing = Annotated[Literal["none", "hegedus", "wong"], _joint("With --exact: as in `regolith forces`.")]
Density = Annotated[float, _joint("Soil density in kg/m³, for --bulldozing and --law auto.")]
Gravity = Annotated[float, _joint("Gravity in m/s², for --bulldozing and --law auto.")]
Contact = Annotated[
    bool, _joint("With --exact: contact angles c1-c3 and the exponent's slope in skid are unknown too.", "--contact")
]
Predict = Annotated[
    str | None,
    _joint("Wheel states whose forces the soil predicts: slip_ratio, side_slip_deg, normal_force_n, and where known "
           "sinkage_m.", metavar="FILE.csv"),
]  # fmt: skip
PredictRover = Annotated[str | None, _joint("Wheel of --predict; that of the states if not given.")]
Sample = Annotated[bool, _joint("Draw from the posterior of --joint itself, not a normal law.", "--sample")]
Profile = Annotated[bool, _joint("Intervals of --joint by profile: the best of all else at each value.", "--profile")]
ModelError = Annotated[
    float | None,
    _joint("Share of the load by which the model of --joint misses a force; found from the residuals if not given."),
]
Posterior = Annotated[
    Path | None,
    _joint(
        "Soils of --joint for `twin predict --soil`: draws as CSV, a belief as JSON; both carry the verdict.",
        "--posterior",
    ),
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
    law: TheLaw = "given",
    shear: Shear = "separate",
    bulldozing: Bulldozing = "none",
    density: Density = 1500.0,
    gravity: Gravity = 1.622,
    contact: Contact = False,
    sample: Sample = False,
    profile: Profile = False,
    model_error: ModelError = None,
    posterior: Posterior = None,
    predict: Predict = None,
    predict_rover: PredictRover = None,
) -> Report:
    """Soil parameters in three aspects (bearing, longitudinal and lateral shear) from wheel states, with errors.

    Of each pair (K_s, N), (c, φ), (K_y, φ_y) what is assumed is given and the other is solved for; with both given,
    each is solved at the other's value. --joint ends with exit code 3 where no soil of the law explains the states.
    """
    from lunarsci.regolith.identify import identify as identify_soil
    from lunarsci.regolith.sensitivity import sensitivities

    from .identify_report import assumptions, identify_report
    from .joint import JointRequest, infer, read_inputs

    _check_posterior(output, posterior, joint)
    intervals = _intervals(joint, reading, prior, exact or law == "auto" or predict is not None, sample, profile)
    asked = JointRequest(prior, law, exact, shear, bulldozing, density, gravity, contact, model_error, seed, intervals)
    pairs = (exponent, stiffness, cohesion, friction_angle, shear_modulus, external_friction_angle)
    known = assumptions(pairs, lateral_modulus)
    given = read_inputs(states, rover, _errors(sinkage_error, force_error, travel_error, side_slip_error))
    with progress("identifying", quiet=output.quiet) as update:
        found = identify_soil(
            given.states, given.wheel, known, reading=reading, draws=draws, seed=seed, progress=update
        )
    together = None
    if joint:
        with progress("the joint posterior", quiet=output.quiet) as update:
            together = infer(given, asked, predict, predict_rover, update)
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
    output.check_extra("--posterior", path, (".csv", ".json"))


def _intervals(
    joint: bool, reading: str, prior: str | None, exact: bool, sample: bool, profile: bool
) -> "IntervalRequest":
    from .joint import IntervalRequest

    if not joint and (prior or exact or sample or profile):
        raise typer.BadParameter("--prior, --exact, --law, --sample, --profile and --predict belong to --joint; add it")
    if sample and profile:
        raise typer.BadParameter("--sample and --profile are two ways to the intervals; give one")
    if joint and reading != "signed":
        raise typer.BadParameter(f"--reading {reading} only reproduces numbers; --joint needs --reading signed")
    return IntervalRequest(sample, profile)
