"""Wheel-soil forces in closed form: triangular stress between entrance and exit angle (Eqs 4, 7-11, 14-24).

Eqs 14 and 17 have a slip and a skid branch. Both are one expression in the travel ratio v_x / (r_s omega), which is
1 - s in slip and 1/(1 + s) in skid; the compiled formulas take that ratio and so pass smoothly through s = 0.

How the sign of the longitudinal shear stress is read. (Eq. 12 multiplies sgn(s) by a shear deformation that is signed
itself, which makes the drawbar pull jump at s = 0.)

* `signed` (default): the stress follows the sign of the shear deformation j. Agrees with measured skid and slip.
* `printed`: sgn(s) (1 - exp(-j/K_x)) with signed j, letter by letter. For reproduction only.
* `slip-branch`: the slip expression evaluated at |s|, positive. For reproduction only.

Source: Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8.
"""

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled, in_lanes
from lunarsci.compiled.formulas import formula
from lunarsci.compiled.lanes import (
    arcsin,
    choose,
    cosine,
    exp_minus_one,
    exponential,
    highest,
    logarithm,
    lowest,
    root,
    signed,
    sine,
)
from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.names import checked_name
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import SHEAR_SIGNS, ShearSign, Wheel

MOST_COHESION = 1.0
"""Share of the normal force that cohesion alone may pull; beyond, forces are those of a wheel hardly in touch. Wheels
that were compared with the model pull up to 0.44 of their load, as measured (`tests/benchmarks/wheels.py`)."""
LEAST_SINKAGE_M = 1e-7
"""Below this the contact angles round to nothing. [m]"""


@formula
def travel_ratio(slip: Any) -> Any:
    """v_x / (r_s omega) from the slip ratio of Eq. 8, s > -1: 1 - s in slip, 1/(1 + s) in skid. [-]"""
    return choose(slip >= 0.0, 1.0 - slip, 1.0 / (1.0 + slip))


@formula
def slip_ratio(travel: Any) -> Any:
    """Slip ratio of Eq. 8 from v_x / (r_s omega); the inverse of `travel_ratio`. [-]"""
    return choose(travel <= 1.0, 1.0 - travel, 1.0 / travel - 1.0)


@compiled
def contact_angles(sinkage: float, slip: float, wheel: Any) -> tuple[float, float, float, float]:
    """Entrance angle, the same for the grouser tips, exit angle, angle of maximum stress (Eqs 9, 15, 10, 11). [rad]"""
    r, _, h, _, c1, c2, c3 = wheel
    theta_1 = math.acos((r - sinkage) / r)
    theta_1e = math.acos((r - sinkage) / (r + h))
    return theta_1, theta_1e, c3 * theta_1, (c1 + c2 * slip) * theta_1


@compiled
def stress_moments(theta_1: float, theta_2: float, theta_m: float) -> tuple[float, float, float]:
    """A, B, C of Eqs 21-24: cos, sin and 1 integrated against a triangle of height 1 that peaks at theta_m. [rad]"""
    front, rear = theta_1 - theta_m, theta_m - theta_2
    a = (math.cos(theta_m) - math.cos(theta_2)) / rear + (math.cos(theta_m) - math.cos(theta_1)) / front
    b = (math.sin(theta_m) - math.sin(theta_2)) / rear + (math.sin(theta_m) - math.sin(theta_1)) / front
    return a, b, (theta_1 - theta_2) / 2.0


@formula
def signed_share(j: Any, travel: Any, modulus: Any, code: Any) -> Any:
    """Share of the shear strength that a displacement mobilises, with its sign -1 to 1; code 1 reads it as printed. [-]

    Janosi & Hanamoto (1961), as in Eqs 12 and 16.
    """
    sign = choose(code == 1, choose(travel <= 1.0, 1.0, -1.0), signed(1.0, j))
    return -sign * exp_minus_one(choose(code == 1, -j, -abs(j)) / modulus)


@compiled
def longitudinal_mobilisation(
    travel: float, theta_1e: float, theta_m: float, shearing_radius: float, modulus: float, code: int
) -> Any:
    """Signed factor that turns the strength c + sigma_m tan(phi) into sgn(s) tau_xm (Eqs 12-14, 19). [-]

    `code` is the reading: 0 `signed`, 1 `printed`, 2 `slip-branch`.
    """
    ratio = 1.0 / travel if code == 2 and travel > 1.0 else travel
    j = shearing_radius * ((theta_1e - theta_m) - ratio * (math.sin(theta_1e) - math.sin(theta_m)))
    return signed_share(j, travel, modulus, code)


@formula
def contact_forces(
    sinkage: Any, slip: Any, travel: Any, lateral: Any, before: Any, rut: Any, wheel: Any, soil: Any, code: Any
) -> Any:
    """F_N, F_DP, F_L, M_R of one wheel (Eqs 18-24), how they change with its motion, and what the soil can hold.

    Parameters
    ----------
    sinkage : z below the ground that the wheel meets, 0 < z < r. [m]
    slip : slip ratio that exponent of sinkage and angle of maximum stress follow, -1 to 1. [-]
    travel : v_x / (r_s omega). [-]
    lateral : v_y / (r_s omega); F_L has its sign and acts against it. [-]
    before : the travel ratio whose shear stress helps to carry the wheel; in steady motion it is `travel`. [-]
    rut : how deep a wheel before pressed the ground, and how deep it is still, both below the undisturbed one; zeros
        where none was there. Between the two the soil is loaded again along a line (Wong 2008, ch. 2). [m]
    wheel, soil : `Wheel.vector()`, `Soil.vector()`.
    code : reading, see `longitudinal_mobilisation`.

    Returns
    -------
    The four forces; their derivatives: F_N, F_DP and M_R by the travel ratio, F_L by the lateral one, as far as they
    come from the shear displacement at a fixed stress (exact where c2 and n1 are 0), for reading 0; the largest shear
    force along the wheel, the resistance of the ground in front of it, the largest lateral force, and F_DP at the
    travel ratio `before`. [N, N m]
    """
    r, b, h, r_s, c1, c2, c3 = wheel
    stiffness, n0, n1, cohesion, tan_phi, k_x, tan_phi_y, k_y = soil
    # Half-angle forms: 1 - cos(theta_1) = z / r, for grouser tips (z + h) / (r + h).
    q, q_e = sinkage * (0.5 / r), (sinkage + h) * (0.5 / (r + h))
    half, half_e = root(q), root(q_e)
    theta_1, theta_1e, cos_1 = 2.0 * arcsin(half), 2.0 * arcsin(half_e), 1.0 - 2.0 * q
    # The roots of arcsin again.
    sin_1, sin_1e = 2.0 * half * root(1.0 - half * half), 2.0 * half_e * root(1.0 - half_e * half_e)
    # As in the integrals, the largest stress stays within the contact at any slip.
    theta_2, theta_m = c3 * theta_1, lowest(highest(c1 + c2 * slip, c3 + 1e-3), 0.999) * theta_1
    cos_2, sin_2, cos_m, sin_m = cosine(theta_2), sine(theta_2), cosine(theta_m), sine(theta_m)
    per_front, per_rear = 1.0 / (theta_1 - theta_m), 1.0 / (theta_m - theta_2)
    per_x, per_y = 1.0 / k_x, 1.0 / k_y
    a = (cos_m - cos_2) * per_rear + (cos_m - cos_1) * per_front
    b_moment = (sin_m - sin_2) * per_rear + (sin_m - sin_1) * per_front
    c_moment = (theta_1 - theta_2) * 0.5
    depth = r * (cos_m - cos_1)
    pressed, left = rut
    again = choose(pressed > left, lowest(1.0, depth / choose(pressed > left, pressed - left, 1.0)), 1.0)
    below = highest(pressed, left + depth)
    sigma_m = again * stiffness * exponential((n0 + n1 * slip) * logarithm(below))
    sigma_m = choose(depth > 0.0, sigma_m, math.nan)
    ratio = choose((code == 2) & (travel > 1.0), 1.0 / travel, travel)
    j_x = r_s * ((theta_1e - theta_m) - ratio * (sin_1e - sin_m))
    share_x = signed_share(j_x * per_x, travel, 1.0, code)
    strength_x, strength_y = cohesion + sigma_m * tan_phi, cohesion + sigma_m * tan_phi_y
    tau_x = strength_x * share_x
    j_before = r_s * ((theta_1e - theta_m) - before * (sin_1e - sin_m))
    share_before = -signed(1.0, j_before) * exp_minus_one(-abs(j_before) * per_x)
    tau_before = choose(code == 0, strength_x * share_before, tau_x)
    j_y = r * lateral * (theta_1e - theta_m)
    share_y = signed(1.0, j_y) * (0.0 - exp_minus_one(-abs(j_y) * per_y))
    tau_y = strength_y * share_y
    slope_x = -strength_x * (1.0 - abs(share_x)) * per_x * r_s * (sin_1e - sin_m)
    slope_y = strength_y * (1.0 - abs(share_y)) * per_y * r * (theta_1e - theta_m)
    forces = (
        b * (r * sigma_m * a + r_s * tau_before * b_moment),
        b * (r_s * tau_x * a - r * sigma_m * b_moment),
        r_s * b * tau_y * c_moment,
        r_s * r_s * b * tau_x * c_moment,
    )
    slopes = (
        b * r_s * slope_x * b_moment,
        b * r_s * slope_x * a,
        r_s * b * slope_y * c_moment,
        r_s * r_s * b * slope_x * c_moment,
    )
    pull_before = b * (r_s * tau_before * a - r * sigma_m * b_moment)
    reach = (b * r_s * strength_x * a, b * r * sigma_m * b_moment, r_s * b * strength_y * c_moment, pull_before)
    return forces, slopes, reach


@formula
def wheel_forces_and_slopes(sinkage: Any, travel: Any, lateral: Any, wheel: Any, soil: Any, code: Any) -> Any:
    """Forces and derivatives of `contact_forces` on undisturbed ground, with the slip that the travel ratio stands for.

    `travel` is v_x / (r_s omega) >= 0. [-]
    """
    forces, slopes, _ = contact_forces(
        sinkage, slip_ratio(travel), travel, lateral, travel, (0.0, 0.0), wheel, soil, code
    )
    return forces, slopes


@formula
def wheel_forces_kernel(sinkage: Any, travel: Any, lateral: Any, wheel: Any, soil: Any, code: Any) -> Any:
    """The four forces of `wheel_forces_and_slopes` alone."""
    return wheel_forces_and_slopes(sinkage, travel, lateral, wheel, soil, code)[0]


@in_lanes
def _each_state(sinkage: Any, travel: Any, lateral: Any, wheel: Any, soil: Any, code: int) -> Any:
    """F_N, F_DP, F_L, M_R of n states, (4, n); arguments (n,) as of `contact_forces`. [N, N, N, N m]"""
    forces = np.empty((4, len(sinkage)))
    for i in range(len(sinkage)):
        forces[0, i], forces[1, i], forces[2, i], forces[3, i] = wheel_forces_kernel(
            sinkage[i], travel[i], lateral[i], wheel, soil, code
        )
    return forces


@dataclass(frozen=True, slots=True)
class WheelForces:
    """Forces of the soil on a wheel, one value per state.

    Attributes
    ----------
    normal_force_n : F_N along the normal of the interaction plane. [N]
    drawbar_pull_n : F_DP along the heading, positive forward. [N]
    lateral_force_n : F_L along the axle, with the sign of the side slip it acts against. [N]
    resistance_torque_nm : M_R about the axle. [N m]
    """

    normal_force_n: FloatArray
    drawbar_pull_n: FloatArray
    lateral_force_n: FloatArray
    resistance_torque_nm: FloatArray


def shear_sign_code(reading: str) -> int:
    """Number of a reading for the compiled formulas. Raises ParameterError for an unknown one."""
    return SHEAR_SIGNS.index(checked_name(reading, SHEAR_SIGNS, "a reading of the shear stress"))


def warn_of_shear_sign(reading: ShearSign) -> None:
    """Say by a LunarSciWarning that a reading is not to be relied on."""
    if reading != "signed":
        text = "is for reproducing published numbers only: its drawbar pull contradicts measured skidding wheels"
        warnings.warn(f"reading '{reading}' {text}", LunarSciWarning, stacklevel=3)


def closed_form_forces(
    wheel: Wheel,
    soil: Soil,
    sinkage_m: npt.ArrayLike,
    slip_ratio: npt.ArrayLike,
    side_slip_deg: npt.ArrayLike = 0.0,
    *,
    reading: ShearSign = "signed",
) -> WheelForces:
    """Forces on a wheel at given states in closed form (Eqs 4, 7-11, 14-24).

    Parameters
    ----------
    wheel, soil : the two sides of the contact.
    sinkage_m : z, within 0 to r. [m]
    slip_ratio : s of Eq. 8, -1 (locked) to 1 (no travel); the model is accurate for |s| up to 0.6. [-]
    side_slip_deg : beta, -90 to 90, not 90 at a slip of 1. [deg]
    reading : how the sign of the shear stress is read, see the module's text.

    The three states broadcast against each other.

    Raises
    ------
    ParameterError for a state outside these ranges.

    Notes
    -----
    The triangle stands for the exact stress integrals; F_N comes out 4-15 % below them for sinkages of 5-25 mm, and M_R
    6-23 % below them in driving slip (in skid, where it passes through 0, by more).
    Side faces (bulldozing) are not included, as in the source.
    """
    parts = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (sinkage_m, slip_ratio, side_slip_deg)))
    z, s, beta = (part.ravel() for part in parts)
    check_states(z, s, beta, wheel.radius_m)
    forces = _each_state(z, *motion_ratios(s, beta), wheel.vector(), soil.vector(), shear_sign_code(reading))
    return WheelForces(*(force.reshape(parts[0].shape) for force in finite(forces)))


def finite(forces: FloatArray) -> FloatArray:
    """The same forces. Raises ParameterError where one is beyond any number."""
    if not np.isfinite(forces).all():
        raise ParameterError("the forces are beyond any number; check sinkage and soil parameters")
    return forces


def motion_ratios(slip_ratio: FloatArray, side_slip_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """v_x and v_y over r_s omega of states, each of their shape; infinite where the wheel is locked or beta is 90. [-]

    A locked wheel and one that slides sideways are limits of the formulas: of s to -1 and of beta to 90 deg.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        travel = np.where(slip_ratio >= 0, 1 - slip_ratio, 1 / (1 + slip_ratio))
        tangent = np.where(
            np.abs(side_slip_deg) < 90, np.tan(np.radians(side_slip_deg)), np.sign(side_slip_deg) * np.inf
        )
        return travel, np.where(tangent == 0, 0.0, travel * tangent)


def cohesion_share(wheel: Wheel, soil: Soil, sinkage_m: FloatArray, normal_force_n: FloatArray) -> FloatArray:
    """What cohesion alone can pull over the contact (b r_s c C of Eqs 19, 24), as a share of the normal force. [-]

    It goes with the contact's length, the normal force with a higher power of the sinkage, so that in the limit of no
    sinkage a wheel without load would pull.
    """
    theta_1 = np.arccos((wheel.radius_m - sinkage_m) / wheel.radius_m)
    span = (1 - wheel.exit_c3) * theta_1 / 2
    return np.asarray(wheel.width_m * wheel.shearing_radius_m * soil.cohesion_pa * span / normal_force_n)


def check_states(z: FloatArray, s: FloatArray, beta: FloatArray, radius: float) -> None:
    """Raise ParameterError where sinkage [m], slip ratio [-] or side slip [deg], (n,) each, is out of range."""
    for name, values, good, rule in (
        ("sinkage_m", z, (z >= LEAST_SINKAGE_M) & (z < radius), f"above 1e-7 and below the wheel radius of {radius} m"),
        ("slip_ratio", s, np.abs(s) <= 1, "within -1 to 1"),
        ("side_slip_deg", beta, np.abs(beta) <= 90, "within -90 to 90 deg"),
        ("side_slip_deg", beta, (s != 1) | (np.abs(beta) != 90), "below 90 deg at slip 1, which leaves it open how "
         "fast the wheel slides sideways beside its rim"),
    ):  # fmt: skip
        if not good.all():
            first = int(np.argmin(good))
            raise ParameterError(f"{name} is {values[first]:g} in state {first + 1}; it must lie {rule}")
