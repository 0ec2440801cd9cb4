"""Stiffness of a soil under other gravity, and sinkage that slip adds."""

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError

__all__ = ["SLIP_SINKAGE_LAWS", "SlipSinkageLaw", "reece_stiffness", "slip_sinkage"]

FloatArray = npt.NDArray[np.float64]
SlipSinkageLaw = Literal["lyasko", "linear"]
SLIP_SINKAGE_LAWS: tuple[str, ...] = get_args(SlipSinkageLaw)


def reece_stiffness(
    k_c: float,
    k_phi: float,
    exponent: float,
    width_m: float,
    *,
    cohesion_pa: float,
    density_kg_m3: float,
    gravity_m_s2: float,
) -> float:
    """K_s of Bekker's law from Reece's dimensionless moduli, p = (c k_c' + rho g b k_phi') (z / b)^n. [kPa m^-n]

    The frictional part goes with gravity: a soil carries less on the Moon than its cohesion-free parameters from Earth
    would say.

    Parameters
    ----------
    k_c, k_phi : k_c', k_phi', 0 or more, not both 0. [-]
    exponent : n > 0. [-]
    width_m : b of the wheel or plate, > 0. [m]
    cohesion_pa : c, 0 or more. [Pa]
    density_kg_m3, gravity_m_s2 : rho and g, > 0.

    Raises
    ------
    ParameterError for a value out of range.

    References
    ----------
    Reece (1965), Proc. Inst. Mech. Eng. 180, 45, 10.1243/PIME_PROC_1965_180_009_02.
    """
    positive = {"exponent": exponent, "width": width_m, "density": density_kg_m3, "gravity": gravity_m_s2}
    for name, value in positive.items():
        if not 0 < value < np.inf:
            raise ParameterError(f"{name} is {value:g}; give a number above 0")
    if min(k_c, k_phi, cohesion_pa) < 0 or k_c + k_phi == 0:
        raise ParameterError("k_c, k_phi and the cohesion must be 0 or more, and one of the moduli above 0")
    pressure = cohesion_pa * k_c + density_kg_m3 * gravity_m_s2 * width_m * k_phi
    return float(pressure / width_m**exponent / 1e3)


def slip_sinkage(
    static_m: npt.ArrayLike, slip_ratio: npt.ArrayLike, law: SlipSinkageLaw = "lyasko", *, rate: float = 1.0
) -> FloatArray:
    """Sinkage of a slipping wheel from that of one that does not slip. [m]

    Parameters
    ----------
    static_m : z_0, 0 or more. [m]
    slip_ratio : s, 0 to below 1; skid has no such law. [-]
    law : `lyasko`, z = z_0 (1 + s) / (1 - s / 2); `linear`, z = z_0 (1 + rate s).
    rate : of `linear`, 0 or more. [-]

    Raises
    ------
    ParameterError for an unknown law or a value out of range.

    References
    ----------
    Lyasko (2010), J. Terramechanics 47, 21, 10.1016/j.jterra.2009.08.005.
    """
    static, slip = np.broadcast_arrays(np.asarray(static_m, dtype=float), np.asarray(slip_ratio, dtype=float))
    if law not in SLIP_SINKAGE_LAWS:
        raise ParameterError(f"law '{law}' is unknown; choose one of: {', '.join(SLIP_SINKAGE_LAWS)}")
    if not ((static >= 0).all() and ((slip >= 0) & (slip < 1)).all() and 0 <= rate < np.inf):
        raise ParameterError("static sinkage and rate must be 0 or more, the slip ratio 0 to below 1")
    if law == "lyasko":
        return np.asarray(static * (1 + slip) / (1 - slip / 2))
    return np.asarray(static * (1 + rate * slip))
