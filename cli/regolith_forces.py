"""`lunarsci regolith forces`: forces of the soil on one wheel."""

from typing import Annotated, Any, Literal

import typer

from .command import command
from .regolith_options import Reading, Rover
from .report import Report

__all__ = ["add_to"]

SOIL, EXACT = "Soil", "Exact integrals"


def _soil(text: str) -> Any:
    return typer.Option(help=text, rich_help_panel=SOIL)


def _exact(text: str, *names: str) -> Any:
    return typer.Option(*names, help=text, rich_help_panel=EXACT)


Sinkage = Annotated[float | None, typer.Option(help="Sinkage [m], above 0, below the wheel radius.")]
Load = Annotated[float | None, typer.Option(help="Wheel load [N]; the sinkage under it is solved for.")]
Slip = Annotated[float, typer.Option(help="Slip ratio [-], above -1, below 1; negative is skid.")]
SideSlip = Annotated[float, typer.Option(help="Side slip angle [deg], within ±90.")]
SoilName = Annotated[str, _soil("Soil: a name or a TOML file.")]
Stiffness = Annotated[float | None, _soil("K_s [kPa m^-N].")]
Exponent = Annotated[float | None, _soil("Sinkage exponent N.")]
Cohesion = Annotated[float | None, _soil("Cohesion c [Pa].")]
FrictionAngle = Annotated[float | None, _soil("φ [deg].")]
ShearModulus = Annotated[float | None, _soil("K_x [mm].")]
ExternalFrictionAngle = Annotated[float | None, _soil("φ_y [deg].")]
LateralModulus = Annotated[float | None, _soil("K_y [mm].")]
Exact = Annotated[bool, _exact("Integrate the stresses (Eqs 1-17) instead of Eqs 21-24.", "--exact")]
Shear = Annotated[
    Literal["separate", "combined", "ellipse"],
    _exact("Strength along and across: each its own, or one shared along the velocity or the displacement."),
]
Bulldozing = Annotated[
    Literal["none", "hegedus", "wong"], _exact("Soil against the side face, by Hegedus or by passive pressure.")
]
Density = Annotated[float, _exact("Soil density [kg/m³], for --bulldozing.")]
Gravity = Annotated[float, _exact("Gravity [m/s²], for --bulldozing.")]
Rebound = Annotated[float | None, _exact("Share of the sinkage that springs back behind the wheel, 0-1.")]


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
    if not exact and (shear != "separate" or bulldozing != "none" or rebound is not None):
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
