"""How deep a wheel sinks under a load."""

from lunarsci.errors import ParameterError
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.forces import Reading, wheel_forces
from lunarsci.regolith.integrals import contact_forces
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import Wheel

__all__ = ["sinkage_under_load"]

DEEPEST = 0.95
"""Deepest sinkage looked at, as a share of the wheel radius."""


def sinkage_under_load(
    wheel: Wheel,
    soil: Soil,
    load_n: float,
    slip_ratio: float = 0.0,
    side_slip_deg: float = 0.0,
    *,
    reading: Reading = "signed",
    model: ContactModel | None = None,
) -> float:
    """Sinkage z at which F_N equals the load (Eq. 21), 0 < z < 0.95 r. [m]

    Parameters
    ----------
    load_n : wheel load W > 0. [N]
    slip_ratio : s, above -1 and below 1. [-]
    side_slip_deg : beta, within -90 to 90; it only matters to a model with combined shear. [deg]
    model : exact integrals with these choices; None for the closed form.

    Raises
    ------
    ParameterError when the load is not above 0 or the soil cannot carry it at any depth.
    """
    from scipy.optimize import brentq

    if not load_n > 0:
        raise ParameterError(f"load is {load_n:g} N; give a load above 0 N")

    def excess(sinkage_m: float) -> float:
        if model is not None:
            return (
                float(contact_forces(wheel, soil, sinkage_m, slip_ratio, side_slip_deg, model).normal_force_n) - load_n
            )
        return float(wheel_forces(wheel, soil, sinkage_m, slip_ratio, reading=reading).normal_force_n) - load_n

    shallow, deep = 1e-6 * wheel.radius_m, DEEPEST * wheel.radius_m
    if excess(shallow) > 0:
        raise ParameterError(f"{load_n:g} N does not press the wheel in at all on this soil; check load and soil")
    if excess(deep) < 0:
        raise ParameterError(f"the soil carries less than {load_n:g} N at {deep:.3f} m sinkage; check load and soil")
    return float(brentq(excess, shallow, deep, xtol=1e-12))
