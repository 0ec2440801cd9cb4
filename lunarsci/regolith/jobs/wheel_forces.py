"""Forces of the soil on one wheel, from its sinkage or its load."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.errors import LunarSciWarning
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.regolith.columns import written_for
from lunarsci.regolith.forces import MOST_COHESION, WheelForces, cohesion_share, warn_of_shear_sign
from lunarsci.regolith.integrals import ContactForces, forces_by
from lunarsci.regolith.inversion import reece_stiffness
from lunarsci.regolith.jobs.requests import WheelForcesRequest
from lunarsci.regolith.soil import Soil, read_soil, soil_hash, warn_of_unusual
from lunarsci.regolith.traction import LoadedState, LoadedWheel, Traction, traction
from lunarsci.regolith.wheel import MAX_VALID_SLIP, PAPER, ContactModel, Wheel, read_wheel
from lunarsci.result import NOT_TO_BE_TRUSTED, Doubt, MadeFrom, Result, job
from lunarsci.rovers import read_rover

if TYPE_CHECKING:
    from matplotlib.figure import Figure


WONG = "Wong (2008), Theory of Ground Vehicles, 4th ed., ch. 2: tractive efficiency"
FREITAG = "Freitag, Green & Melzer (1970), Waterways Experiment Station TR M-70-2: wheels compared at 20 % slip"

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


def contact_model(request: WheelForcesRequest) -> ContactModel | None:
    """Choices of the integrals; None for the closed form."""
    plain = ContactModel(reading=request.reading, density_kg_m3=request.density, gravity_m_s2=float(request.gravity))
    model = replace(
        plain,
        shear=request.shear,
        bulldozing=request.bulldozing,
        rebound=request.rebound,
        rut_m=request.rut,
        reload_n_m3=request.reload,
    )
    return model if request.exact or model != plain else None


def changed_soil(request: WheelForcesRequest, soil: Soil, width_m: float) -> Soil:
    """The soil with what was asked for in its place; with Reece's moduli its stiffness under this gravity."""
    changes = {name: getattr(request, option) for option, name in SOIL.items() if getattr(request, option) is not None}
    soil = soil.replace(**changes)
    if request.reece_cohesive is None or request.reece_frictional is None:
        return soil

    stiffness = reece_stiffness(
        request.reece_cohesive,
        request.reece_frictional,
        soil.sinkage_exponent,
        width_m,
        cohesion_pa=soil.cohesion_pa,
        density_kg_m3=request.density,
        gravity_m_s2=float(request.gravity),
    )
    return soil.replace(stiffness_kpa_m_n=stiffness)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForcesOnWheel(Result):
    """The forces of the soil on a wheel.

    Attributes
    ----------
    request : what was asked.
    wheel, soil : that were taken.
    states : at each slip the sinkage, the forces [N, N m], and the soil, which slip that deepens the sinkage softens.
    model : choices of the integrals, None for the closed form.
    cohesion_share : what cohesion alone could pull, as a share of the normal force, at its largest. [-]
    traction : figures of the loaded wheel; None for a single slip, and for a sinkage.
    assumed : keys of the rover's file that are guesses.
    called : its name in its file.
    origin : files, tables and sources that it was made from.
    """

    schema: ClassVar[str] = "regolith-forces/1"
    request: WheelForcesRequest
    wheel: Wheel
    soil: Soil
    states: Sequence[LoadedState]
    model: ContactModel | None
    cohesion_share: float
    traction: Traction | None
    assumed: Sequence[str]
    called: str
    origin: MadeFrom

    @property
    def sinkage_m(self) -> float:
        """Of the first slip. [m]"""
        return self.states[0].sinkage_m

    @property
    def forces(self) -> WheelForces | ContactForces:
        """F_N, F_DP, F_L, M_R at the first slip, by integration also two moments. [N, N m]"""
        return self.states[0].forces

    @property
    def made_from(self) -> MadeFrom:
        return self.origin

    @property
    def doubt(self) -> Doubt:
        if 0 <= self.cohesion_share <= MOST_COHESION:
            return Doubt()
        return Doubt.of(
            f"cohesion alone would pull {self.cohesion_share:.3g} times what presses the wheel, as the contact is "
            "nearly without load; give a deeper sinkage, or less cohesion",
            verdict=NOT_TO_BE_TRUSTED,
        )

    def to_dict(self) -> dict[str, Any]:
        rows = [self._row(state) for state in self.states]
        return {
            **(rows[0] if len(rows) == 1 else {"states": rows}),
            "traction": None if self.traction is None else self.traction._asdict(),
            "soil": asdict(self.states[0].soil if len(rows) == 1 else self.soil),
            "reading": self.request.reading,
            "assumed_of_rover": list(self.assumed),
            "model": asdict(self.model) if self.model else None,
            "cohesion_share": self.cohesion_share,
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a slip, with the rover, so that `infer` reads them for its wheel."""
        return [self._row(state) | {"rover": written_for(self.called, self.wheel)} for state in self.states]

    def _row(self, state: LoadedState) -> dict[str, Any]:
        there = {"sinkage_m": state.sinkage_m, "slip_ratio": state.slip, "side_slip_deg": self.request.side_slip}
        forces: dict[str, Any] = {name: float(getattr(state.forces, name)) for name in state.forces.__slots__}
        if self.traction is not None and self.request.load is not None:
            forces["pull_per_weight"] = forces["drawbar_pull_n"] / self.request.load
            forces["tractive_efficiency"] = state.efficiency(self.wheel)
        return there | forces

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import forces_over_slip, traction_over_slip

        asked, first = self.request, self.states[0]
        if self.traction is not None:
            yield traction_over_slip(self.rows(), self.traction, asked.load or 0.0)
            return
        state = (first.sinkage_m, [one.slip for one in self.states], asked.side_slip)
        yield forces_over_slip(self.wheel, first.soil, *state, asked.reading, self.model)


@job
def wheel_forces(request: WheelForcesRequest | None = None, **options: Any) -> ForcesOnWheel:
    """Forces of the soil on one wheel, at one slip or over several; `options` replace those of the request.

    Slip beyond 0.6 either way, and readings that only reproduce numbers, are said by a LunarSciWarning. Raises
    RequestError, ParameterError for a state or a soil out of range, DataError for a file that cannot be used.

    Examples
    --------
    >>> forces = lunarsci.wheel_forces(load=36.5, slip="0:0.6:13").to_table()
    """
    asked = request_of(WheelForcesRequest, request, options)
    description, slips = read_rover(asked.rover), asked.slips()
    wheel = read_wheel(description)
    given = read_soil(asked.soil)
    soil = changed_soil(asked, given, wheel.width_m)
    if soil != given:
        warn_of_unusual(soil, "the soil")
    warn_of_shear_sign(asked.reading)
    if (farthest := max(slips, key=abs)) and abs(farthest) > MAX_VALID_SLIP:
        text = f"slip ratio {farthest:g} is beyond {MAX_VALID_SLIP:g}, up to which the model was compared with wheels"
        warnings.warn(text, LunarSciWarning, stacklevel=2)
    states, loaded = _states(asked, wheel, soil, slips)
    shares = [
        cohesion_share(wheel, state.soil, np.array(state.sinkage_m), np.asarray(state.forces.normal_force_n))
        for state in states
    ]
    inputs, tables = soil_hash(asked.soil)
    return ForcesOnWheel(
        request=asked,
        wheel=wheel,
        soil=soil,
        states=states,
        model=contact_model(asked),
        cohesion_share=float(max(shares, key=lambda share: share if share >= 0 else np.inf)),
        traction=None if loaded is None or len(slips) == 1 else traction(loaded, states),
        assumed=description.assumed,
        called=description.name,
        origin=MadeFrom(
            inputs=inputs,
            tables={f"{asked.rover} (rover)": sha256(description.text.encode())} | tables,
            sources=[PAPER] if len(slips) == 1 else [PAPER, WONG, FREITAG],
        ),
    )


def _states(
    asked: WheelForcesRequest, wheel: Wheel, soil: Soil, slips: Sequence[float]
) -> tuple[list[LoadedState], LoadedWheel | None]:
    """The wheel at each slip, under its load or at its sinkage; and the loaded wheel."""
    model = contact_model(asked)
    if asked.load is None:
        sinkage = float(asked.sinkage or 0.0)
        results = [forces_by(model, wheel, soil, sinkage, slip, asked.side_slip, asked.reading) for slip in slips]
        return [LoadedState(slip, sinkage, soil, forces) for slip, forces in zip(slips, results, strict=True)], None
    loaded = LoadedWheel(
        wheel=wheel,
        soil=soil,
        load_n=asked.load,
        side_slip_deg=asked.side_slip,
        law=asked.law,
        reading=asked.reading,
        model=model,
    )
    return loaded.over(slips), loaded
