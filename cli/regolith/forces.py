"""`lunarsci regolith forces`: forces of the soil on one wheel."""

from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..shared.command import command
from ..shared.report import Report
from .options import Reading, Rover

if TYPE_CHECKING:
    from .forces_report import ForcesRequest

__all__ = ["add_to"]

SOIL, EXACT = "Soil", "Exact integrals"


def _soil(text: str) -> Any:
    return typer.Option(help=text, rich_help_panel=SOIL)


def _exact(text: str, *names: str) -> Any:
    return typer.Option(*names, help=text, rich_help_panel=EXACT)


Sinkage = Annotated[float | None, typer.Option(help="Sinkage in m, above 0, below the wheel radius.")]
Load = Annotated[float | None, typer.Option(help="Wheel load in N; the sinkage under it is solved for.")]
Slip = Annotated[float, typer.Option(help="Slip ratio, -1 (locked) to 1 (no travel); negative is skid.")]
SideSlip = Annotated[float, typer.Option(help="Side slip angle in deg, within ±90.")]
SoilName = Annotated[str, _soil("Soil: a name or a TOML file.")]
Stiffness = Annotated[float | None, _soil("K_s in kPa m^-N.")]
Exponent = Annotated[float | None, _soil("Sinkage exponent N.")]
Cohesion = Annotated[float | None, _soil("Cohesion c in Pa.")]
FrictionAngle = Annotated[float | None, _soil("φ in deg.")]
ShearModulus = Annotated[float | None, _soil("K_x in mm.")]
ExternalFrictionAngle = Annotated[float | None, _soil("φ_y in deg.")]
LateralModulus = Annotated[float | None, _soil("K_y in mm.")]
Exact = Annotated[bool, _exact("Integrate the stresses (Eqs 1-17) instead of Eqs 21-24.", "--exact")]
Shear = Annotated[
    Literal["separate", "combined", "ellipse"],
    _exact("Strength along and across: each its own, or one shared along the velocity or the displacement."),
]
Bulldozing = Annotated[
    Literal["none", "hegedus", "wong"], _exact("Soil against the side face, by Hegedus or by passive pressure.")
]
Density = Annotated[float, _exact("Soil density in kg/m³, for --bulldozing and Reece's moduli.")]
Gravity = Annotated[float, _exact("Gravity in m/s², for --bulldozing and Reece's moduli.")]
Rebound = Annotated[float | None, _exact("Share of the sinkage that springs back behind the wheel, 0-1.")]
Rut = Annotated[float, _exact("Depth in m to which a wheel before has pressed the soil; needs --reload.")]
Reload = Annotated[float, _exact("Slope of loading in a rut in N/m³, k_0 of Wong's reloading line.")]
SlipSinkage = Annotated[
    Literal["none", "lyasko", "linear"],
    typer.Option(help="With --load: how slip deepens the sinkage of a wheel that does not slip."),
]
ReeceCohesive = Annotated[float | None, _soil("Reece's k_c'; K_s then follows density and gravity.")]
ReeceFrictional = Annotated[float | None, _soil("Reece's k_φ', with k_c'.")]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "forces")(forces)


def forces(
    sinkage: Sinkage = None,
    load: Load = None,
    slip: Slip = 0.0,
    side_slip: SideSlip = 0.0,
    rover: Rover = "yutu2",
    soil: SoilName = "lunar-typical",
    stiffness: Stiffness = None,
    exponent: Exponent = None,
    cohesion: Cohesion = None,
    friction_angle: FrictionAngle = None,
    shear_modulus: ShearModulus = None,
    external_friction_angle: ExternalFrictionAngle = None,
    lateral_modulus: LateralModulus = None,
    reading: Reading = "signed",
    exact: Exact = False,
    shear: Shear = "separate",
    bulldozing: Bulldozing = "none",
    density: Density = 1500.0,
    gravity: Gravity = 1.622,
    rebound: Rebound = None,
    rut: Rut = 0.0,
    reload: Reload = 0.0,
    slip_sinkage: SlipSinkage = "none",
    reece_cohesive: ReeceCohesive = None,
    reece_frictional: ReeceFrictional = None,
) -> Report:
    """Forces of the soil on one wheel, from its sinkage or its load.

    Slip beyond ±0.6 is said to be outside what was compared with wheels. At a slip of -1, where the wheel is locked,
    and at a side slip of 90 deg, forces are the limits of the equations. Where cohesion alone would pull more than the
    wheel presses, as at next to no sinkage, the exit code is 3. A sinkage of the wheel's radius or more is refused.
    """
    from lunarsci.regolith.contact import ContactModel
    from lunarsci.regolith.wheel import read_wheel

    from .forces_report import forces_report, soil_of

    changes = {
        "stiffness_kpa_m_n": stiffness,
        "sinkage_exponent": exponent,
        "cohesion_pa": cohesion,
        "friction_angle_deg": friction_angle,
        "shear_modulus_mm": shear_modulus,
        "external_friction_angle_deg": external_friction_angle,
        "lateral_modulus_mm": lateral_modulus,
    }
    beyond = shear != "separate" or bulldozing != "none" or rebound is not None or rut > 0 or reload > 0
    if beyond and not exact:
        raise typer.BadParameter("--shear, --bulldozing, --rebound, --rut and --reload belong to --exact; add it")
    if reece_cohesive is not None and stiffness is not None:
        raise typer.BadParameter("K_s comes from --stiffness or from Reece's moduli; give one")
    model = ContactModel(
        reading=reading,
        shear=shear,
        bulldozing=bulldozing,
        density_kg_m3=density,
        gravity_m_s2=gravity,
        rebound=rebound,
        rut_m=rut,
        reload_n_m3=reload,
    )
    asked = _asked(sinkage, load, slip, side_slip, slip_sinkage)
    given = soil_of(soil, changes, read_wheel(rover).width_m, _pair(reece_cohesive, reece_frictional), density, gravity)
    return forces_report(rover, soil, given, asked, reading, model if exact else None)


def _asked(
    sinkage: float | None,
    load: float | None,
    slip: float,
    side_slip: float,
    slip_sinkage: Literal["none", "lyasko", "linear"],
) -> "ForcesRequest":
    from .forces_report import ForcesRequest

    if (sinkage is None) == (load is None):
        raise typer.BadParameter("give either --sinkage or --load")
    if slip_sinkage == "none":
        return ForcesRequest(sinkage, load, slip, side_slip)
    if load is None or slip < 0:
        raise typer.BadParameter("--slip-sinkage needs --load, and a slip of 0 or more; skid has no such law")
    return ForcesRequest(sinkage, load, slip, side_slip, slip_sinkage)


def _pair(cohesive: float | None, frictional: float | None) -> tuple[float, float] | None:
    if cohesive is None and frictional is None:
        return None
    if cohesive is None or frictional is None:
        raise typer.BadParameter("--reece-cohesive and --reece-frictional go together; give both")
    return cohesive, frictional
