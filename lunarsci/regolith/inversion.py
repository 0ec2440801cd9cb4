"""From the forces on a wheel back to the stresses under it and to soil parameters (Eqs 18-24 solved for their soil).

Bearing, longitudinal shear and lateral shear each tie a pair of parameters together, (K_s, N), (c, phi), (K_y, phi_y):
one state gives a curve, and a point only once one of the pair is assumed.

Source: Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.regolith.forces import (
    contact_angles,
    longitudinal_mobilisation,
    stress_moments,
    travel_ratio,
)

__all__ = [
    "cohesion",
    "external_friction_angle",
    "friction_angle",
    "invert_states",
    "lateral_modulus",
    "sinkage_exponent",
    "stiffness",
]

STEEPEST_DEG = 85.0
"""No soil has a friction angle near this; a larger one means that the forces do not fit the model. Assumed."""


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
