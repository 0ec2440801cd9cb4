"""How deep a wheel sinks under a load."""

from lunarsci.errors import ParameterError
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.forces import LEAST_SINKAGE_M, Reading
from lunarsci.regolith.integrals import forces_by
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import Wheel

__all__ = ["sinkage_under_load", "stiffness_under_load"]

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
    slip_ratio : s, -1 to 1. [-]
    side_slip_deg : beta, -90 to 90; it only matters to a model with combined shear. [deg]
    model : exact integrals with these choices; None for the closed form.

    Raises
    ------
    ParameterError when the load is not above 0 or the soil cannot carry it at any depth.
    """
    from scipy.optimize import brentq

    if not load_n > 0:
        raise ParameterError(f"load is {load_n:g} N; give a load above 0 N")

    def excess(sinkage_m: float) -> float:
        return _normal_force(wheel, soil, sinkage_m, slip_ratio, side_slip_deg, reading, model) - load_n

    shallow, deep = LEAST_SINKAGE_M, DEEPEST * wheel.radius_m
    if excess(shallow) > 0:
        raise ParameterError(f"{load_n:g} N does not press the wheel in at all on this soil; check load and soil")
    if excess(deep) < 0:
        raise ParameterError(f"the soil carries less than {load_n:g} N at {deep:.3f} m sinkage; check load and soil")
    return float(brentq(excess, shallow, deep, xtol=1e-12))


def stiffness_under_load(
    wheel: Wheel,
    soil: Soil,
    load_n: float,
    sinkage_m: float,
    slip_ratio: float = 0.0,
    side_slip_deg: float = 0.0,
    *,
    reading: Reading = "signed",
    model: ContactModel | None = None,
) -> float:
    """Stiffness K_s at which the soil carries the load at a measured sinkage; F_N is linear in it. [kPa m^-N]

    Parameters as in `sinkage_under_load`, and sinkage_m, above 1e-7 and below the radius [m]. In a rut, where F_N is
    not linear, it is good to the first order.

    Raises
    ------
    ParameterError where no stiffness above 0 does, as cohesion carries the load alone.
    """
    one, two = (
        _normal_force(wheel, soil.replace(stiffness_kpa_m_n=k * soil.stiffness_kpa_m_n), sinkage_m, slip_ratio,
                      side_slip_deg, reading, model)
        for k in (1, 2)
    )  # fmt: skip
    times = 1 + (load_n - one) / (two - one)
    if not times > 0:
        raise ParameterError(f"cohesion alone carries {load_n:g} N at {sinkage_m:.4f} m; check load, sinkage and soil")
    return times * soil.stiffness_kpa_m_n


def _normal_force(
    wheel: Wheel,
    soil: Soil,
    sinkage_m: float,
    slip_ratio: float,
    side_slip_deg: float,
    reading: Reading,
    model: ContactModel | None,
) -> float:
    found = forces_by(model, wheel, soil, sinkage_m, slip_ratio, side_slip_deg, reading)
    return float(found.normal_force_n)
