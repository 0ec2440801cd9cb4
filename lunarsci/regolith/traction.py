"""A loaded wheel: how deep it sinks, what it pulls over slip, and the figures by which wheels are compared."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.ranges import POSITIVE, check_each, refuse
from lunarsci.regolith.forces import LEAST_SINKAGE_M, WheelForces
from lunarsci.regolith.integrals import ContactForces, forces_by
from lunarsci.regolith.inversion import slip_sinkage
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import ContactModel, ShearSign, SlipSinkageLaw, Wheel

DEEPEST = 0.95
"""Deepest sinkage looked at, as a share of the wheel radius."""
DESIGN_SLIP = 0.2
"""Slip at which wheels are compared, first of the Lunar Roving Vehicle: Freitag, Green & Melzer (1970), Waterways
Experiment Station TR M-70-2. [-]"""
STEEPEST_DEG = 45.0
"""No slope steeper than this is looked at: lunar ones are hardly steeper than 35 deg (Kreslavsky & Head 2016, Icarus
273, 329, 10.1016/j.icarus.2016.02.036)."""


def sinkage_under_load(
    wheel: Wheel,
    soil: Soil,
    load_n: float,
    slip_ratio: float = 0.0,
    side_slip_deg: float = 0.0,
    *,
    reading: ShearSign = "signed",
    model: ContactModel | None = None,
) -> float:
    """Sinkage z at which F_N equals the load (Eq. 21), 0 < z < 0.95 r. [m]

    Parameters
    ----------
    load_n : wheel load W > 0. [N]
    slip_ratio : s, -1 to 1. [-]
    side_slip_deg : beta, -90 to 90; it only matters to a model with combined shear. [deg]
    model : exact integrals with these choices; None for the closed form.

    Raises
    ------
    ParameterError when the load is not above 0 or the soil cannot carry it at any depth.
    """
    from scipy.optimize import brentq

    check_each("", {"load_n": load_n}, {"load_n": POSITIVE})

    def excess(sinkage_m: float) -> float:
        return (
            float(forces_by(model, wheel, soil, sinkage_m, slip_ratio, side_slip_deg, reading).normal_force_n) - load_n
        )

    shallow, deep = LEAST_SINKAGE_M, DEEPEST * wheel.radius_m
    faults = {
        f"{load_n:g} N does not press the wheel in at all on this soil; check load and soil": excess(shallow) > 0,
        f"the soil carries less than {load_n:g} N at {deep:.3f} m sinkage; check load and soil": excess(deep) < 0,
    }
    refuse(faults)
    return float(brentq(excess, shallow, deep, xtol=1e-12))


def stiffness_under_load(
    wheel: Wheel,
    soil: Soil,
    load_n: float,
    sinkage_m: float,
    slip_ratio: float = 0.0,
    side_slip_deg: float = 0.0,
    *,
    reading: ShearSign = "signed",
    model: ContactModel | None = None,
) -> float:
    """Stiffness K_s at which the soil carries the load at a measured sinkage; F_N is linear in it. [kPa m^-N]

    Parameters as in `sinkage_under_load`, and sinkage_m, above 1e-7 and below the radius [m]. In a rut, where F_N is
    not linear, it is good to the first order.

    Raises
    ------
    ParameterError where no stiffness above 0 does, as cohesion carries the load alone.
    """
    soils = [soil.replace(stiffness_kpa_m_n=k * soil.stiffness_kpa_m_n) for k in (1, 2)]
    forces = [forces_by(model, wheel, one, sinkage_m, slip_ratio, side_slip_deg, reading) for one in soils]
    one, two = (float(force.normal_force_n) for force in forces)
    times = 1 + (load_n - one) / (two - one)
    refuse({f"cohesion alone carries {load_n:g} N at {sinkage_m:.4f} m; check load, sinkage and soil": not times > 0})
    return times * soil.stiffness_kpa_m_n


class LoadedState(NamedTuple):
    """A wheel under its load.

    Attributes
    ----------
    slip : slip ratio. [-]
    sinkage_m : at which the soil carries the load. [m]
    soil : softened where slip deepens the sinkage by a law.
    forces : of the soil on the wheel. [N, N m]
    """

    slip: float
    sinkage_m: float
    soil: Soil
    forces: WheelForces | ContactForces

    def efficiency(self, wheel: Wheel) -> float | None:
        """Tractive efficiency: power of the pull over that of the axle, P (1 - s) r_s / M; None where either drives
        backwards. [-] (Wong 2008, Theory of Ground Vehicles, ch. 2)
        """
        pull, torque = float(self.forces.drawbar_pull_n), float(self.forces.resistance_torque_nm)
        if pull <= 0 or torque <= 0 or self.slip < 0:
            return None
        return pull * (1.0 - self.slip) * wheel.shearing_radius_m / torque


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedWheel:
    """A wheel on a soil under a load, at a side slip.

    Attributes
    ----------
    wheel, soil : the two sides of the contact.
    load_n : W > 0. [N]
    side_slip_deg : within 90. [deg]
    law : how slip deepens the sinkage; None for not at all, and in skid.
    reading, model : as in `forces_by`.
    """

    wheel: Wheel
    soil: Soil
    load_n: float
    side_slip_deg: float = 0.0
    law: SlipSinkageLaw | None = None
    reading: ShearSign = "signed"
    model: ContactModel | None = None

    def at(self, slip: float, load_n: float | None = None) -> LoadedState:
        """The wheel at a slip, under another load where one is given.

        Where slip deepens the sinkage by a law, it softens the soil, which carries no more than the load. Raises
        ParameterError as `sinkage_under_load`.
        """
        law, load = self.law if slip >= 0 else None, self.load_n if load_n is None else load_n
        soil, how = self.soil, dict[str, Any](reading=self.reading, model=self.model)
        still = slip if law is None else 0.0
        sinkage = sinkage_under_load(self.wheel, soil, load, still, self.side_slip_deg, **how)
        if law is not None:
            sinkage = float(slip_sinkage(sinkage, slip, law))
            soft = stiffness_under_load(self.wheel, soil, load, sinkage, slip, self.side_slip_deg, **how)
            soil = soil.replace(stiffness_kpa_m_n=soft)
        forces = forces_by(self.model, self.wheel, soil, sinkage, slip, self.side_slip_deg, self.reading)
        return LoadedState(slip, sinkage, soil, forces)

    def over(self, slips: FloatArray | Sequence[float]) -> list[LoadedState]:
        """The wheel at each slip (n,)."""
        return [self.at(float(slip)) for slip in slips]

    def slope_deg(self, slip: float = DESIGN_SLIP) -> float | None:
        """Slope that such wheels alone climb at a slip; None where they do not even pull on level ground. [deg]

        On a slope a each wheel carries W cos a and must pull W sin a; what the higher or lower wheels of a rover carry
        more or less is left out, and so is all that is not wheels on this soil.
        """
        from scipy.optimize import brentq

        def spare(angle: float) -> float:
            pull = float(self.at(slip, self.load_n * np.cos(angle)).forces.drawbar_pull_n)
            return pull - self.load_n * float(np.sin(angle))

        steepest = float(np.radians(STEEPEST_DEG))
        if spare(0.0) < 0:
            return None
        if spare(steepest) > 0:
            return STEEPEST_DEG
        return float(np.degrees(brentq(spare, 0.0, steepest, xtol=1e-6)))


class Traction(NamedTuple):
    """Figures of a loaded wheel; None where it pulls at no slip that was asked about.

    pull_at_20_n, pull_per_weight_at_20 : drawbar pull at 20 % slip, and the same over the load. [N], [-]
    efficiency_at_20, slope_at_20_deg : tractive efficiency, and slope that such wheels climb, at that slip. [-], [deg]
    self_propelled_slip : slip at which the pull is 0, the wheel just keeps itself going. [-]
    best_efficiency, best_efficiency_slip : largest tractive efficiency of the curve, and where. [-]
    """

    pull_at_20_n: float
    pull_per_weight_at_20: float
    efficiency_at_20: float | None
    slope_at_20_deg: float | None
    self_propelled_slip: float | None
    best_efficiency: float | None
    best_efficiency_slip: float | None


def traction(loaded: LoadedWheel, curve: Sequence[LoadedState]) -> Traction:
    """Figures of a loaded wheel from its curve over slip, in order of slip."""
    there = loaded.at(DESIGN_SLIP)
    pull = float(there.forces.drawbar_pull_n)
    good = [(value, state.slip) for state in curve if (value := state.efficiency(loaded.wheel)) is not None]
    best, at = max(good, default=(None, None))
    return Traction(
        pull_at_20_n=pull,
        pull_per_weight_at_20=pull / loaded.load_n,
        efficiency_at_20=there.efficiency(loaded.wheel),
        slope_at_20_deg=loaded.slope_deg(),
        self_propelled_slip=_without_pull(curve),
        best_efficiency=best,
        best_efficiency_slip=at,
    )


def _without_pull(curve: Sequence[LoadedState]) -> float | None:
    """First slip at which the pull passes from below 0 to above it, between the states by a straight line. [-]"""
    pulls = [float(state.forces.drawbar_pull_n) for state in curve]
    for before, after, low, high in zip(curve, curve[1:], pulls, pulls[1:], strict=False):
        if low <= 0 < high:
            return before.slip + (after.slip - before.slip) * low / (low - high)
    return None
