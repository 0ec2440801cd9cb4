"""From the forces on a wheel back to what makes them: the stresses under it, and soil parameters.

Bearing, longitudinal shear and lateral shear (Eqs 18-24 solved for their soil) each tie a pair of parameters together,
(K_s, N), (c, phi), (K_y, phi_y): one state gives a curve, and a point only once one of the pair is assumed.

Source: Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.names import checked_name
from lunarsci.ranges import NOT_NEGATIVE, POSITIVE, check_each
from lunarsci.regolith.forces import contact_angles, longitudinal_mobilisation, stress_moments, travel_ratio
from lunarsci.regolith.wheel import SLIP_SINKAGE_LAWS, SlipSinkageLaw

STEEPEST_DEG = 85.0
"""No soil has a friction angle near this; a larger one means that the forces do not fit the model. Assumed."""


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
    moduli = {"k_c": k_c, "k_phi": k_phi, "cohesion": cohesion_pa}
    sizes = {"exponent": exponent, "width": width_m, "density": density_kg_m3, "gravity": gravity_m_s2}
    check_each("", moduli, dict.fromkeys(moduli, NOT_NEGATIVE))
    check_each("", sizes | {"sum of the moduli": k_c + k_phi}, dict.fromkeys((*sizes, "sum of the moduli"), POSITIVE))
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
    given = {"static sinkage": static.min(), "slip ratio": slip.min(), "largest slip ratio": slip.max(), "rate": rate}
    check_each("", given, dict.fromkeys(given, NOT_NEGATIVE) | {"largest slip ratio": "(-inf, 1)"})
    if checked_name(law, SLIP_SINKAGE_LAWS, "a law of slip and sinkage") == "lyasko":
        return np.asarray(static * (1 + slip) / (1 - slip / 2))
    return np.asarray(static * (1 + rate * slip))


@compiled
def invert_states(states: Any, wheel: Any, shear_modulus: float, code: int) -> Any:
    """Stresses and geometry of many states.

    Parameters
    ----------
    states : (n, 6) sinkage [m], slip ratio, side slip [deg], F_N, F_DP, F_L [N]; NaN where not measured.
    wheel : `Wheel.vector()`.
    shear_modulus : K_x. [m]
    code : reading of the shear law.

    Returns
    -------
    (n, 6): sigma_m [Pa], tau_xm with its sign [Pa], tau_ym [Pa], r (cos theta_m - cos theta_1) [m], the mobilised share
    of the longitudinal shear strength [-], and the lateral shear displacement j_y [m]. NaN for an impossible state, and
    where the forces would need the ground to pull.
    """
    solved = np.full((len(states), 6), np.nan)
    r, b, _, r_s, _, _, _ = wheel
    for i in range(len(states)):
        z, slip, beta, f_n, f_dp, f_l = states[i]
        geometry_slip = slip if math.isfinite(slip) else 0.0
        if not (0.0 < z < r and -1.0 < geometry_slip < 1.0):
            continue
        theta_1, theta_1e, theta_2, theta_m = contact_angles(z, geometry_slip, wheel)
        a, b_moment, c_moment = stress_moments(theta_1, theta_2, theta_m)
        square = a * a + b_moment * b_moment
        sigma_m = (a * f_n - b_moment * f_dp) / (square * r * b)
        if not sigma_m > 0.0:
            continue
        solved[i, 0] = sigma_m
        solved[i, 1] = (a * f_dp + b_moment * f_n) / (square * r_s * b)
        solved[i, 2] = f_l / (r_s * b * c_moment)
        solved[i, 3] = r * (math.cos(theta_m) - math.cos(theta_1))
        if math.isfinite(slip):
            travel = travel_ratio(slip)
            solved[i, 4] = longitudinal_mobilisation(travel, theta_1e, theta_m, r_s, shear_modulus, code)
            solved[i, 5] = r * travel * math.tan(math.radians(beta)) * (theta_1e - theta_m)
    return solved


def stiffness(sigma_m: Any, depth: Any, exponent: Any) -> Any:
    """K_s = sigma_m / depth^N, Eq. 18. [kPa m^-N] from [Pa], r (cos theta_m - cos theta_1) [m] and N [-]."""
    return sigma_m / 1e3 / depth**exponent


def sinkage_exponent(sigma_m: Any, depth: Any, stiffness_kpa: Any) -> Any:
    """N = ln(sigma_m / K_s) / ln(depth), Eq. 18; NaN where it is not above 0. [-] from [Pa], [m], [kPa m^-N]."""
    exponent = np.log(sigma_m / (1e3 * stiffness_kpa)) / np.log(depth)
    return np.where(exponent > 0, exponent, np.nan)


def friction_angle(sigma_m: Any, tau: Any, mobilised: Any, cohesion_pa: Any) -> Any:
    """phi from tau = (c + sigma_m tan phi) x mobilised share, Eq. 19; NaN where none of 0-85 deg does. [deg]"""
    angle = np.degrees(np.arctan((tau / mobilised - cohesion_pa) / sigma_m))
    return np.where((angle >= 0) & (angle <= STEEPEST_DEG), angle, np.nan)


def cohesion(sigma_m: Any, tau: Any, mobilised: Any, friction_angle_deg: Any) -> Any:
    """c from Eq. 19; NaN where it would be negative. [Pa]"""
    value = tau / mobilised - sigma_m * np.tan(np.radians(friction_angle_deg))
    return np.where(value >= 0, value, np.nan)


def external_friction_angle(sigma_m: Any, tau: Any, displacement: Any, modulus_mm: Any, cohesion_pa: Any) -> Any:
    """phi_y from tau_ym = (c + sigma_m tan phi_y) (1 - exp(-j_y/K_y)), Eq. 20; NaN where none does. [deg]

    `displacement` is j_y [m], `modulus_mm` K_y [mm]; a lateral force that points with the side slip has no solution.
    """
    mobilised = -np.expm1(-np.abs(displacement) / (modulus_mm * 1e-3)) * np.sign(displacement)
    return friction_angle(sigma_m, tau, mobilised, cohesion_pa)


def lateral_modulus(
    sigma_m: Any, tau: Any, displacement: Any, external_friction_angle_deg: Any, cohesion_pa: Any
) -> Any:
    """K_y from Eq. 20; NaN where the shear stress exceeds the strength or points the wrong way. [mm]"""
    share = tau * np.sign(displacement) / (cohesion_pa + sigma_m * np.tan(np.radians(external_friction_angle_deg)))
    possible = (share > 0) & (share < 1)
    modulus = -np.abs(displacement) / np.log1p(-np.where(possible, share, 0.5))
    return np.where(possible, modulus * 1e3, np.nan)
