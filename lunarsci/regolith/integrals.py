"""Wheel-soil forces and moments by integrating the stresses over the contact (Eqs 1-17), with what goes beyond them.

Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8; the second integral of Eq. 1 is taken up to
theta_1. The closed form of `forces` puts a triangle in the place of these stresses. Choices: `contact`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import WheelForces, check_states, closed_form_forces, mobilised, motion_ratios, slip_ratio
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import ContactModel, ShearSign, Wheel

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
"""On either side of the angle of maximum stress; doubling them moves forces by up to 1.3e-3 of the load."""
SLOWEST, FORWARD = 1e-12, 1e-6
"""A wheel turns at least at this share of its speed, so that a locked one has no infinite displacement, and then moves
forward at this one, so that a locked wheel that slides sideways is the limit of those that skid."""


@compiled
def _normal_stress(depth: float, stiffness: float, exponent: float, model: Any) -> float:
    """Bearing stress at a depth below the wheel's own ground (Eq. 6); in a rut, by reloading up to the old stress."""
    if depth <= 0.0:
        return 0.0
    rut, slope = model[6], model[7] + model[8] * model[6]
    if rut <= 0.0:
        return float(stiffness * depth**exponent)
    old = stiffness * rut**exponent
    if slope * depth < old:
        return float(slope * depth)
    return float(stiffness * (max(rut - old / slope, 0.0) + depth) ** exponent)


@compiled
def _side_pressure(cohesion: float, tan_phi: float, model: Any) -> tuple[float, float]:
    """Force of the soil per length of a vertical face that moves against it: its factors of depth and depth squared.
    [N m^-2, N m^-3]"""
    if model[2] == 0.0:
        return 0.0, 0.0
    phi = math.atan(tan_phi)
    if model[2] == 1.0:
        angle = math.pi / 4 - phi / 2
        cot = 1.0 / math.tan(angle)
        d_1 = cot + math.tan(angle + phi)
        d_2 = cot + cot * cot * tan_phi
        return float(d_1 * cohesion), float(0.5 * d_1 * d_2 * model[3])
    cot = math.tan(math.pi / 4 + phi / 2)
    return float(2 * cohesion * cot), float(0.5 * model[3] * cot * cot * (1 + 0.5 * cot * tan_phi))


@compiled
def _shares(j_x: float, j_y: float, sliding: Any, soil: Any, model: Any, slip: float, slip_j: float) -> Any:
    """Shares of the strengths mobilised along and across the wheel, with their signs. [-]"""
    k_x, k_y = soil[5], soil[7]
    if model[1] > 0.0:
        length = math.hypot(j_x / k_x, j_y / k_y)
        share = -math.expm1(-length)
        along, across = j_x / k_x, j_y / k_y
        if model[1] == 1.0:
            along, across, length = sliding[0], sliding[1], math.hypot(sliding[0], sliding[1])
        return (share * along / length, share * across / length) if length > 0.0 else (0.0, 0.0)
    along = mobilised(j_x, k_x)
    if model[0] == 1.0:
        along = -math.expm1(-j_x / k_x) * (1.0 if slip >= 0.0 else -1.0)
    elif model[0] == 2.0:
        along = mobilised(slip_j, k_x)
    return along, mobilised(j_y, k_y)


@compiled
def contact_kernel(sinkage: float, velocity: Any, wheel: Any, soil: Any, model: Any, nodes: Any, weights: Any) -> Any:
    """F_N, F_DP, F_L, M_R, M_S, M_O of one wheel. [N, N, N, N m, N m, N m]

    Parameters
    ----------
    sinkage : z, 0 < z < r. [m]
    velocity : v_x, v_y, and r_s omega >= 0, of any common unit; not all 0.
    wheel, soil, model : `Wheel.vector()`, `Soil.vector()`, `ContactModel.vector()`.
    nodes, weights : of the Gauss-Legendre rule on -1 to 1.
    """
    r, b, h, r_s, c1, c2, c3 = wheel
    stiffness, n0, n1, cohesion, tan_phi, _, tan_phi_y, _ = soil
    v_x, v_y, rim = velocity
    speed = math.hypot(v_x, v_y)
    if rim < SLOWEST * speed:
        rim, v_x = SLOWEST * speed, max(v_x, FORWARD * speed)
    travel, lateral = v_x / rim, v_y / rim
    slip = slip_ratio(travel)
    exponent = n0 + n1 * slip if slip >= 0.0 or math.isnan(model[4]) else n0 - model[4] * slip
    theta_1 = math.acos((r - sinkage) / r)
    theta_1e = math.acos((r - sinkage) / (r + h))
    theta_2 = c3 * theta_1 if model[5] < 0.0 else -math.acos(1.0 - model[5] * sinkage / r)
    theta_m = min(max((c1 + c2 * slip) * theta_1, theta_2 + 1e-3 * theta_1), 0.999 * theta_1)
    slip_travel = 1.0 / travel if travel > 1.0 else travel
    side = v_y / speed if speed > 0.0 else 0.0
    by_depth, by_square = _side_pressure(cohesion, tan_phi, model)
    sums = np.zeros(6)
    for part in range(2):
        start, stop = (theta_2, theta_m) if part == 0 else (theta_m, theta_1)
        half = 0.5 * (stop - start)
        for k in range(len(nodes)):
            theta = start + half * (1.0 + nodes[k])
            mirrored = theta
            if part == 0:
                mirrored = theta_1 - (theta - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)
            sigma = _normal_stress(r * (math.cos(mirrored) - math.cos(theta_1)), stiffness, exponent, model)
            ahead, rise = theta_1e - theta, math.sin(theta_1e) - math.sin(theta)
            sliding = (1.0 - travel * math.cos(theta), lateral)
            along, across = _shares(
                r_s * (ahead - travel * rise), r * lateral * ahead, sliding, soil, model, slip,
                r_s * (ahead - slip_travel * rise),
            )  # fmt: skip
            tau_x, tau_y = (cohesion + sigma * tan_phi) * along, (cohesion + sigma * tan_phi_y) * across
            depth = r * (math.cos(theta) - math.cos(theta_1))
            cos, sin = math.cos(theta), math.sin(theta)
            wall = depth * (by_depth + by_square * depth) if depth > 0.0 else 0.0
            bulldozed = wall * (r - depth * cos) * side
            step = weights[k] * half
            sideways = r_s * b * tau_y + bulldozed
            sums[0] += step * b * (r * sigma * cos + r_s * tau_x * sin)
            sums[1] += step * b * (r_s * tau_x * cos - r * sigma * sin)
            sums[2] += step * sideways
            sums[3] += step * b * r_s * r_s * tau_x
            sums[4] -= step * r_s * sideways * sin
            sums[5] -= step * r_s * sideways * cos
    return sums


@compiled
def _each(sinkage: Any, velocity: Any, wheel: Any, soil: Any, model: Any, nodes: Any, weights: Any) -> Any:
    forces = np.empty((len(sinkage), 6))
    for i in range(len(sinkage)):
        moving = (velocity[i, 0], velocity[i, 1], velocity[i, 2])
        forces[i] = contact_kernel(sinkage[i], moving, wheel, soil, model, nodes, weights)
    return forces


@dataclass(frozen=True, slots=True)
class ContactForces:
    """Forces and moments of the soil on a wheel, one value per state.

    Attributes
    ----------
    normal_force_n, drawbar_pull_n, lateral_force_n, resistance_torque_nm : F_N, F_DP, F_L, M_R as in `WheelForces`.
    steering_moment_nm : M_S about the vertical through the axle. [N m]
    overturning_moment_nm : M_O about the heading. [N m]
    """

    normal_force_n: FloatArray
    drawbar_pull_n: FloatArray
    lateral_force_n: FloatArray
    resistance_torque_nm: FloatArray
    steering_moment_nm: FloatArray
    overturning_moment_nm: FloatArray


def integrated_forces(
    wheel: Wheel,
    soil: Soil,
    sinkage_m: npt.ArrayLike,
    slip_ratio: npt.ArrayLike,
    side_slip_deg: npt.ArrayLike = 0.0,
    model: ContactModel | None = None,
) -> ContactForces:
    """Forces and moments at given states, by integration.

    Parameters
    ----------
    wheel, soil : the two sides of the contact.
    sinkage_m : z, above 1e-7 and below r. [m]
    slip_ratio : s of Eq. 8, -1 (locked) to 1 (no travel); the model is accurate for |s| up to 0.6. [-]
    side_slip_deg : beta, -90 to 90, not 90 at a slip of 1. [deg]
    model : `ContactModel()` by default, the stresses of Ding et al. (2024).

    The three states broadcast against each other.

    Raises
    ------
    ParameterError for a state outside these ranges.
    """
    parts = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (sinkage_m, slip_ratio, side_slip_deg)))
    z, s, beta = (part.ravel() for part in parts)
    check_states(z, s, beta, wheel.radius_m)
    return _forces(wheel, soil, z, velocities(s, beta), model or ContactModel(), parts[0].shape)


def velocities(slip_ratio: FloatArray, side_slip_deg: FloatArray) -> FloatArray:
    """v_x, v_y, r_s omega of n states in a common unit, (n, 3), as `contact_kernel` takes them, limits included."""
    travel, lateral = motion_ratios(np.minimum(slip_ratio, 1 - FORWARD), side_slip_deg)
    angle, locked = np.radians(side_slip_deg), np.isinf(travel)
    x = np.where(locked, np.cos(angle), travel)
    y = np.where(locked, np.sin(angle), np.where(np.isinf(lateral), np.sign(lateral) / FORWARD, lateral))
    return np.column_stack([x, y, np.where(locked, 0.0, 1.0)])


def forces_by(
    model: ContactModel | None,
    wheel: Wheel,
    soil: Soil,
    sinkage_m: npt.ArrayLike,
    slip_ratio: npt.ArrayLike,
    side_slip_deg: npt.ArrayLike = 0.0,
    reading: ShearSign = "signed",
) -> WheelForces | ContactForces:
    """`integrated_forces` with a model, `closed_form_forces` with a reading where it is None; arguments as theirs."""
    if model is None:
        return closed_form_forces(wheel, soil, sinkage_m, slip_ratio, side_slip_deg, reading=reading)
    return integrated_forces(wheel, soil, sinkage_m, slip_ratio, side_slip_deg, model)


def integrated_forces_in_motion(
    wheel: Wheel,
    soil: Soil,
    sinkage_m: npt.ArrayLike,
    velocity: npt.ArrayLike,
    model: ContactModel | None = None,
) -> ContactForces:
    """Forces and moments of wheels given by their velocities, locked ones and side slip of 90 deg included.

    Parameters
    ----------
    sinkage_m : (n,) z, above 1e-7 and below r. [m]
    velocity : (n, 3) forward v_x >= 0, sideways v_y, and rim speed r_s omega >= 0, not all 0. [m/s]

    Raises
    ------
    ParameterError for a sinkage or velocity out of range.
    """
    z, moving = np.atleast_1d(np.asarray(sinkage_m, dtype=float)), np.atleast_2d(np.asarray(velocity, dtype=float))
    check_states(z, np.zeros_like(z), np.zeros_like(z), wheel.radius_m)
    good = np.isfinite(moving).all(axis=1) & (moving[:, [0, 2]] >= 0).all(axis=1) & (np.abs(moving).sum(axis=1) > 0)
    if moving.shape != (len(z), 3) or not good.all():
        raise ParameterError("velocities are v_x >= 0, v_y and r_s omega >= 0 of each state, not all 0")
    return _forces(wheel, soil, z, moving, model or ContactModel(), z.shape)


def _forces(
    wheel: Wheel, soil: Soil, z: FloatArray, velocity: FloatArray, model: ContactModel, shape: tuple[int, ...]
) -> ContactForces:
    forces = _each(z, velocity, wheel.vector(), soil.vector(), model.vector(), NODES, WEIGHTS)
    if not np.isfinite(forces).all():
        raise ParameterError("the forces are beyond any number; check sinkage and soil parameters")
    return ContactForces(*(forces[:, k].reshape(shape) for k in range(6)))
