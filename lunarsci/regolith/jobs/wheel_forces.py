"""Forces of the soil on one wheel, from its sinkage or its load."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import LunarSciWarning, RequestError
from lunarsci.regolith.wheel import (
    DENSITY_KG_M3,
    MAX_VALID_SLIP,
    PAPER,
    Bulldozing,
    ContactModel,
    ShearLaw,
    ShearSign,
)
from lunarsci.result import MadeFrom, Result, request_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.regolith.forces import WheelForces
    from lunarsci.regolith.integrals import ContactForces
    from lunarsci.regolith.soil import Soil
    from lunarsci.regolith.wheel import Wheel


SOIL = {
    "stiffness": "stiffness_kpa_m_n",
    "exponent": "sinkage_exponent",
    "cohesion": "cohesion_pa",
    "friction_angle": "friction_angle_deg",
    "shear_modulus": "shear_modulus_mm",
    "external_friction_angle": "external_friction_angle_deg",
    "lateral_modulus": "lateral_modulus_mm",
}
"""Option to parameter of the soil that it changes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelForcesRequest:
    """A wheel on a soil.

    Attributes
    ----------
    sinkage [m], load [N] : one of them; the sinkage under a load is solved for.
    slip, side_slip : slip ratio from -1 to 1, side slip within 90 deg. [-, deg]
    rover, soil : names, or TOML files.
    stiffness [kPa m^-N], exponent [-], cohesion [Pa], friction_angle [deg], shear_modulus [mm], external_friction_angle
        [deg], lateral_modulus [mm] : what is otherwise in the soil.
    reading : sign convention of the longitudinal shear stress.
    exact : integrate the stresses, see `ContactModel`; any choice that only the integrals know has the same effect.
    shear, bulldozing, density [kg m^-3], gravity [m s^-2], rebound [-], rut [m], reload [N m^-3] : these choices.
    slip_sinkage : how slip deepens the sinkage under a load of a wheel that does not slip.
    reece_cohesive, reece_frictional : Reece's k_c' and k_phi', which then give the stiffness. [-]

    Raises RequestError for options that exclude each other.
    """

    sinkage: float | None = None
    load: float | None = None
    slip: float = 0.0
    side_slip: float = 0.0
    rover: str = "yutu2"
    soil: str = "lunar-typical"
    stiffness: float | None = None
    exponent: float | None = None
    cohesion: float | None = None
    friction_angle: float | None = None
    shear_modulus: float | None = None
    external_friction_angle: float | None = None
    lateral_modulus: float | None = None
    reading: ShearSign = "signed"
    exact: bool = False
    shear: ShearLaw = "separate"
    bulldozing: Bulldozing = "none"
    density: float = DENSITY_KG_M3
    gravity: float = LUNAR_GRAVITY.value
    rebound: float | None = None
    rut: float = 0.0
    reload: float = 0.0
    slip_sinkage: Literal["none", "lyasko", "linear"] = "none"
    reece_cohesive: float | None = None
    reece_frictional: float | None = None

    def __post_init__(self) -> None:
        if (self.sinkage is None) == (self.load is None):
            raise RequestError("give either `sinkage` or `load`")
        if self.slip_sinkage != "none" and (self.load is None or self.slip < 0):
            raise RequestError("`slip_sinkage` needs `load`, and a slip of 0 or more; skid has no such law")
        if (self.reece_cohesive is None) != (self.reece_frictional is None):
            raise RequestError("`reece_cohesive` and `reece_frictional` go together; give both")
        if self.reece_cohesive is not None and self.stiffness is not None:
            raise RequestError("K_s comes from `stiffness` or from Reece's moduli; give one")

    @property
    def model(self) -> ContactModel | None:
        """Choices of the integrals; None for the closed form."""
        plain = ContactModel(reading=self.reading, density_kg_m3=self.density, gravity_m_s2=self.gravity)
        model = replace(
            plain,
            shear=self.shear,
            bulldozing=self.bulldozing,
            rebound=self.rebound,
            rut_m=self.rut,
            reload_n_m3=self.reload,
        )
        return model if self.exact or model != plain else None

    def changed(self, soil: "Soil", width_m: float) -> "Soil":
        """The soil with what was asked for in its place; with Reece's moduli its stiffness under this gravity."""
        changes = {name: getattr(self, option) for option, name in SOIL.items() if getattr(self, option) is not None}
        soil = soil.replace(**changes)
        if self.reece_cohesive is None or self.reece_frictional is None:
            return soil
        from lunarsci.regolith.inversion import reece_stiffness

        stiffness = reece_stiffness(
            self.reece_cohesive,
            self.reece_frictional,
            soil.sinkage_exponent,
            width_m,
            cohesion_pa=soil.cohesion_pa,
            density_kg_m3=self.density,
            gravity_m_s2=self.gravity,
        )
        return soil.replace(stiffness_kpa_m_n=stiffness)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForcesOnWheel(Result):
    """The forces of the soil on a wheel.

    Attributes
    ----------
    request : what was asked.
    wheel, soil : that were taken; a soil that slip has softened carries the load at the sinkage.
    sinkage_m : z, as given or under the load. [m]
    forces : F_N, F_DP, F_L, M_R, by integration also two moments. [N, N m]
    model : choices of the integrals, None for the closed form.
    cohesion_share : what cohesion alone could pull, as a share of the normal force. [-]
    assumed : keys of the rover's file that are guesses.
    """

    schema: ClassVar[str] = "regolith-forces/1"
    request: WheelForcesRequest
    wheel: "Wheel"
    soil: "Soil"
    sinkage_m: float
    forces: "WheelForces | ContactForces"
    model: ContactModel | None
    cohesion_share: float
    assumed: Sequence[str]
    origin: MadeFrom

    @property
    def made_from(self) -> MadeFrom:
        return self.origin

    @property
    def untrusted(self) -> str:
        from lunarsci.regolith.forces import MOST_COHESION

        if 0 <= self.cohesion_share <= MOST_COHESION:
            return ""
        return (
            f"not to be trusted: cohesion alone would pull {self.cohesion_share:.3g} times what presses the wheel, as "
            "the contact is nearly without load; give a deeper sinkage, or less cohesion"
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            **self.rows()[0],
            "soil": asdict(self.soil),
            "reading": self.request.reading,
            "assumed_of_rover": list(self.assumed),
            "model": asdict(self.model) if self.model else None,
            "cohesion_share": self.cohesion_share,
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        asked = self.request
        state = {"sinkage_m": self.sinkage_m, "slip_ratio": asked.slip, "side_slip_deg": asked.side_slip}
        return [state | {name: float(getattr(self.forces, name)) for name in self.forces.__slots__}]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import forces_over_slip

        asked = self.request
        state = (self.sinkage_m, asked.slip, asked.side_slip)
        yield forces_over_slip(self.wheel, self.soil, *state, asked.reading, self.model)


def wheel_forces(request: WheelForcesRequest | None = None, **options: Any) -> ForcesOnWheel:
    """Forces of the soil on one wheel; `options` replace those of the request.

    Slip beyond 0.6 either way, and readings that only reproduce numbers, are said by a LunarSciWarning. Raises
    RequestError, ParameterError for a state or a soil out of range, DataError for a file that cannot be used.
    """
    import numpy as np

    from lunarsci.provenance import sha256
    from lunarsci.regolith.forces import cohesion_share, warn_of_shear_sign
    from lunarsci.regolith.integrals import forces_by
    from lunarsci.regolith.inversion import settle_under_load
    from lunarsci.regolith.soil import read_soil, soil_hash
    from lunarsci.regolith.wheel import read_wheel
    from lunarsci.rovers import read_rover

    asked = request_of(WheelForcesRequest, request, options)
    description, model = read_rover(asked.rover), asked.model
    wheel = read_wheel(description)
    soil, state = asked.changed(read_soil(asked.soil), wheel.width_m), (asked.slip, asked.side_slip)
    warn_of_shear_sign(asked.reading)
    if abs(asked.slip) > MAX_VALID_SLIP:
        text = f"slip ratio {asked.slip:g} is beyond {MAX_VALID_SLIP:g}, up to which the model was compared with wheels"
        warnings.warn(text, LunarSciWarning, stacklevel=2)
    if asked.load is not None:
        law = None if asked.slip_sinkage == "none" else asked.slip_sinkage
        sinkage, soil = settle_under_load(wheel, soil, asked.load, *state, law, reading=asked.reading, model=model)
    else:
        sinkage = float(asked.sinkage or 0.0)
    found = forces_by(model, wheel, soil, sinkage, *state, asked.reading)
    inputs, tables = soil_hash(asked.soil)
    return ForcesOnWheel(
        request=asked,
        wheel=wheel,
        soil=soil,
        sinkage_m=sinkage,
        forces=found,
        model=model,
        cohesion_share=float(cohesion_share(wheel, soil, np.array(sinkage), np.asarray(found.normal_force_n))),
        assumed=description.assumed,
        origin=MadeFrom(
            inputs=inputs,
            tables={f"{asked.rover} (rover)": sha256(description.text.encode())} | tables,
            sources=[PAPER],
        ),
    )
