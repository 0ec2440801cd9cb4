"""`lunarsci regolith`: what the ground is."""

from typing import Annotated, Any, Literal

import typer

from .command import command
from .options import Output
from .progress import progress
from .regolith_compare import add_to as add_compare
from .report import Report

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True, help="What the ground is: wheel-soil forces, and the soil that wheel states reveal."
)

SOIL_PANEL = "Soil"
EXACT = "Exact integrals"
JOINT = "All states together"
ERROR_PANEL = "Errors (where the file gives none)"


def _error(text: str) -> Any:
    return typer.Option(help=text, rich_help_panel=ERROR_PANEL)


Rover = Annotated[str, typer.Option(help="Rover whose wheel it is: a name (yutu2) or a TOML file.")]
Reading = Annotated[
    Literal["signed", "printed", "slip-branch"],
    typer.Option(help="Sign of the shear law: signed agrees with measured wheels; the others only reproduce numbers."),
]


@command(app, "forces")
def forces(
    sinkage: Annotated[float | None, typer.Option(help="Sinkage [m], above 0, below the wheel radius.")] = None,
    load: Annotated[float | None, typer.Option(help="Wheel load [N]; the sinkage under it is solved for.")] = None,
    slip: Annotated[float, typer.Option(help="Slip ratio [-], above -1, below 1; negative is skid.")] = 0.0,
    side_slip: Annotated[float, typer.Option(help="Side slip angle [deg], within ±90.")] = 0.0,
    rover: Rover = "yutu2",
    soil: Annotated[
        str, typer.Option(help="Soil: a name or a TOML file.", rich_help_panel=SOIL_PANEL)
    ] = "lunar-typical",
    stiffness: Annotated[float | None, typer.Option(help="K_s [kPa m^-N].", rich_help_panel=SOIL_PANEL)] = None,
    exponent: Annotated[float | None, typer.Option(help="Sinkage exponent N.", rich_help_panel=SOIL_PANEL)] = None,
    cohesion: Annotated[float | None, typer.Option(help="Cohesion c [Pa].", rich_help_panel=SOIL_PANEL)] = None,
    friction_angle: Annotated[float | None, typer.Option(help="φ [deg].", rich_help_panel=SOIL_PANEL)] = None,
    shear_modulus: Annotated[float | None, typer.Option(help="K_x [mm].", rich_help_panel=SOIL_PANEL)] = None,
    external_friction_angle: Annotated[
        float | None, typer.Option(help="φ_y [deg].", rich_help_panel=SOIL_PANEL)
    ] = None,
    lateral_modulus: Annotated[float | None, typer.Option(help="K_y [mm].", rich_help_panel=SOIL_PANEL)] = None,
    reading: Reading = "signed",
    exact: Annotated[
        bool,
        typer.Option("--exact", help="Integrate the stresses (Eqs 1-17) instead of Eqs 21-24.", rich_help_panel=EXACT),
    ] = False,
    shear: Annotated[
        Literal["separate", "combined"],
        typer.Option(help="Strength along and across: apart, or shared by the sliding.", rich_help_panel=EXACT),
    ] = "separate",
    bulldozing: Annotated[
        Literal["none", "hegedus", "wong"],
        typer.Option(help="Soil against the side face, by Hegedus or by passive pressure.", rich_help_panel=EXACT),
    ] = "none",
    density: Annotated[
        float, typer.Option(help="Soil density [kg/m³], for --bulldozing.", rich_help_panel=EXACT)
    ] = 1500.0,
    gravity: Annotated[float, typer.Option(help="Gravity [m/s²], for --bulldozing.", rich_help_panel=EXACT)] = 1.622,
    rebound: Annotated[
        float | None, typer.Option(help="Share of the sinkage that springs back behind, 0-1.", rich_help_panel=EXACT)
    ] = None,
) -> Report:
    """Forces of the soil on one wheel, from its sinkage or its load."""
    from lunarsci.regolith.contact import ContactModel

    from .regolith_report import forces_report

    changes = {
        "stiffness_kpa_m_n": stiffness,
        "sinkage_exponent": exponent,
        "cohesion_pa": cohesion,
        "friction_angle_deg": friction_angle,
        "shear_modulus_mm": shear_modulus,
        "external_friction_angle_deg": external_friction_angle,
        "lateral_modulus_mm": lateral_modulus,
    }
    if (sinkage is None) == (load is None):
        raise typer.BadParameter("give either --sinkage or --load")
    beyond = shear != "separate" or bulldozing != "none" or rebound is not None
    if beyond and not exact:
        raise typer.BadParameter("--shear, --bulldozing and --rebound belong to --exact; add it")
    model = ContactModel(
        reading=reading,
        shear=shear,
        bulldozing=bulldozing,
        density_kg_m3=density,
        gravity_m_s2=gravity,
        rebound=rebound,
    )
    return forces_report(rover, soil, changes, sinkage, load, slip, side_slip, reading, model if exact else None)


@command(app, "identify")
def identify(
    states: Annotated[
        str,
        typer.Argument(
            help="CSV of wheel states: sinkage_m, normal_force_n, drawbar_pull_n, and where known slip_ratio, "
            "side_slip_deg, lateral_force_n; NAME_sigma is the error of NAME; - is stdin."
        ),
    ],
    output: Output,
    rover: Rover = "yutu2",
    exponent: Annotated[float | None, typer.Option(help="Assume N and solve K_s; 1.0 if neither is given.")] = None,
    stiffness: Annotated[float | None, typer.Option(help="Assume K_s [kPa m^-N] and solve N.")] = None,
    cohesion: Annotated[float | None, typer.Option(help="Assume c [Pa] and solve φ; 520 if neither is given.")] = None,
    friction_angle: Annotated[float | None, typer.Option(help="Assume φ [deg] and solve c.")] = None,
    shear_modulus: Annotated[float, typer.Option(help="Assumed K_x [mm].")] = 17.8,
    lateral_modulus: Annotated[
        str | None, typer.Option(help="Assume K_y [mm], one or several by commas, and solve φ_y; 13,40 if not given.")
    ] = None,
    external_friction_angle: Annotated[float | None, typer.Option(help="Assume φ_y [deg] and solve K_y.")] = None,
    reading: Reading = "signed",
    draws: Annotated[int, typer.Option(min=2, max=1_000_000, help="Monte Carlo draws per state.")] = 1024,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    sinkage_error: Annotated[float, _error("1σ of the sinkage [m].")] = 0.00033,
    force_error: Annotated[float, _error("1σ of the forces, relative.")] = 0.1 / 3,
    travel_error: Annotated[
        float, _error("1σ of the travelled distance, relative; slip errs by it times 1 - |s|.")
    ] = 0.04 / 3,
    side_slip_error: Annotated[float, _error("1σ of the side slip, relative.")] = 0.04 / 3,
    joint: Annotated[
        bool,
        typer.Option("--joint", help="All parameters from all states at once, as a posterior.", rich_help_panel=JOINT),
    ] = False,
    prior: Annotated[
        str | None,
        typer.Option(metavar="FILE.toml", help="Priors of --joint, in place of the lunar ones.", rich_help_panel=JOINT),
    ] = None,
    exact: Annotated[
        bool,
        typer.Option("--exact", help="Integrate the stresses in --joint instead of Eqs 21-24.", rich_help_panel=JOINT),
    ] = False,
    sample: Annotated[
        bool,
        typer.Option("--sample", help="Weight the draws of --joint by the exact posterior.", rich_help_panel=JOINT),
    ] = False,
    model_error: Annotated[
        float, typer.Option(help="Share of the load by which the model may miss a force.", rich_help_panel=JOINT)
    ] = 0.02,
) -> Report:
    """Soil parameters in three aspects (bearing, longitudinal and lateral shear) from wheel states, with errors.

    Of each pair (K_s, N), (c, φ), (K_y, φ_y) what is assumed is given and the other is solved for; with both given,
    each is solved at the other's value.
    """
    from lunarsci.regolith.identify import Assumptions
    from lunarsci.regolith.identify import identify as identify_soil
    from lunarsci.regolith.states import MeasurementErrors

    from .regolith_report import identify_report, infer, numbers, read_inputs

    if not joint and (prior or exact or sample):
        raise typer.BadParameter("--prior, --exact and --sample belong to --joint; add it")
    known = Assumptions(
        exponent=exponent,
        stiffness_kpa_m_n=stiffness,
        cohesion_pa=cohesion,
        friction_angle_deg=friction_angle,
        shear_modulus_mm=shear_modulus,
        lateral_modulus_mm=numbers(lateral_modulus, "--lateral-modulus"),
        external_friction_angle_deg=external_friction_angle,
    )
    errors = MeasurementErrors(
        sinkage_m=sinkage_error,
        force_relative=force_error,
        travel_relative=travel_error,
        side_slip_relative=side_slip_error,
    )
    given = read_inputs(states, rover, errors)
    with progress("identifying", quiet=output.quiet) as update:
        found = identify_soil(
            given.states, given.wheel, known, reading=reading, draws=draws, seed=seed, progress=update
        )
    together = infer(given, prior, exact, sample, model_error, seed) if joint else None
    return identify_report(given, found, seed, together)


add_compare(app)
