"""Wheel-soil forces and moments by integrating the stresses over the contact (Eqs 1-17), with what goes beyond them.

Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8; the second integral of Eq. 1 is taken up to
theta_1. The closed form of `forces` puts a triangle in the place of these stresses. Choices: `ContactModel`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled, in_lanes, joined
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import (
    arcsin,
    choose,
    cosine,
    exp_minus_one,
    exponential,
    highest,
    load,
    logarithm,
    lowest,
    root,
    sine,
    store,
)
from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import (
    WheelForces,
    check_states,
    closed_form_forces,
    finite,
    motion_ratios,
    signed_share,
    slip_ratio,
)
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import ContactModel, ShearSign, Wheel

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
"""On either side of the angle of maximum stress; doubling them moves forces by up to 1.3e-3 of the load."""
SLOWEST, FORWARD = 1e-12, 1e-6
"""A wheel turns at least at this share of its speed, so that a locked one has no infinite displacement, and then moves
forward at this one, so that a locked wheel that slides sideways is the limit of those that skid."""


@compiled
def side_pressure(cohesion: float, tan_phi: float, model: Any) -> tuple[float, float]:
    """Force of the soil per length of a vertical face that moves against it: its factors of depth and depth squared.
    [N m^-2, N m^-3]

    cohesion : c. [Pa]
    tan_phi : of the internal friction angle. [-]
    model : `ContactModel.vector()`.
    """
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


@formula
def contact_place(sinkage: Any, velocity: Any, wheel: Any, soil: Any, model: Any) -> Any:
    """What a contact is besides its stresses, as `contact_sums` takes it.

    Parameters
    ----------
    sinkage : z, 0 < z < r. [m]
    velocity : v_x, v_y, and r_s omega >= 0, of any common unit; not all 0.
    wheel, soil, model : `Wheel.vector()`, `Soil.vector()`, `ContactModel.vector()`.

    Returns
    -------
    theta_1, the entrance angle of the grouser tips and its sine, theta_2, theta_m [rad]; the sinkage exponent N [-];
    v_x and v_y over r_s omega, v_y over the speed [-]; of a rut the old stress [Pa], the slope of reloading [Pa/m], and
    the depth below the undisturbed ground at which it begins [m].
    """
    r, _, h, _, c1, c2, c3 = wheel
    v_x, v_y, rim = velocity
    speed = root(v_x * v_x + v_y * v_y)
    locked = rim < SLOWEST * speed
    rim, v_x = choose(locked, SLOWEST * speed, rim), choose(locked, highest(v_x, FORWARD * speed), v_x)
    travel, lateral, side = v_x / rim, v_y / rim, choose(speed > 0.0, v_y / speed, 0.0)
    slip, given = slip_ratio(travel), model[4] == model[4]
    exponent = choose((slip < 0.0) & given, soil[1] - model[4] * slip, soil[1] + soil[2] * slip)
    # Half-angle forms, as in the closed form.
    q, q_e = sinkage / (2.0 * r), (sinkage + h) / (2.0 * (r + h))
    theta_1, half_e = 2.0 * arcsin(root(q)), root(q_e)
    theta_1e, sin_1e = 2.0 * arcsin(half_e), 2.0 * half_e * root(1.0 - q_e)
    rebound = highest(model[5], 0.0)
    theta_2 = choose(model[5] < 0.0, c3 * theta_1, -2.0 * arcsin(root(rebound * q)))
    theta_m = lowest(highest((c1 + c2 * slip) * theta_1, theta_2 + 1e-3 * theta_1), 0.999 * theta_1)
    # In a rut the ground is loaded again along a line, up to the old stress.
    rut, rise = model[6], model[7] + model[8] * model[6]
    old = choose(rut > 0.0, soil[0] * exponential(exponent * logarithm(rut)), 0.0)
    below = choose(rut > 0.0, highest(rut - old / choose(rise > 0.0, rise, 1.0), 0.0), 0.0)
    return theta_1, theta_1e, sin_1e, theta_2, theta_m, exponent, travel, lateral, side, (old, rise, below)


@formula
def contact_sums(
    sums: Any, place: Any, node: Any, weight: Any, wheel: Any, soil: Any, model: Any, face: Any, law: Any
) -> Any:
    """F_N, F_DP, F_L, M_R, M_S, M_O with what one node adds to them, on both sides of the angle of maximum stress.

    Parameters
    ----------
    sums : of the nodes before. [N, N, N, N m, N m, N m]
    place : `contact_place`.
    node, weight : of a symmetric Gauss-Legendre rule on -1 to 1.
    face : `side_pressure`.
    law : 0 for separate shear along and across, else both share one strength; a plain number.
    """
    theta_1, theta_1e, sin_1e, theta_2, theta_m, exponent, travel, lateral, side, (old, rise, below) = place
    r, b, _, r_s, *_ = wheel
    stiffness, _, _, cohesion, tan_phi, k_x, tan_phi_y, k_y = soil
    per_x, per_y = 1.0 / k_x, 1.0 / k_y
    front, back, cos_1 = 0.5 * (theta_1 - theta_m), 0.5 * (theta_m - theta_2), cosine(theta_1)
    # The stress behind is that of the mirror image ahead, which the same node has.
    depth = r * (cosine(theta_1 - front * (1.0 - node)) - cos_1)
    sigma = stiffness * exponential(exponent * logarithm(below + depth))
    sigma = choose(depth > 0.0, choose(rise * depth < old, rise * depth, sigma), 0.0)
    for theta, half in ((theta_1 - front * (1.0 - node), front), (theta_2 + back * (1.0 - node), back)):
        cos, sin = cosine(theta), sine(theta)
        ahead, risen = theta_1e - theta, sin_1e - sin
        j_x, j_y = r_s * (ahead - travel * risen), r * lateral * ahead
        if law == 0:
            by_slip = choose((model[0] == 2.0) & (travel > 1.0), 1.0 / highest(travel, 1.0), travel)
            j_slip = r_s * (ahead - by_slip * risen)
            along = signed_share(j_slip * per_x, travel, 1.0, model[0])
            across = signed_share(j_y * per_y, travel, 1.0, 0)
        else:
            x, y = j_x * per_x, j_y * per_y
            share = -exp_minus_one(-root(x * x + y * y))
            x, y = choose(model[1] == 1.0, 1.0 - travel * cos, x), choose(model[1] == 1.0, lateral, y)
            length = root(x * x + y * y)
            share = choose(length > 0.0, share / length, 0.0)
            along, across = share * x, share * y
        tau_x, tau_y = (cohesion + sigma * tan_phi) * along, (cohesion + sigma * tan_phi_y) * across
        deep = highest(r * (cos - cos_1), 0.0)
        sideways = r_s * b * tau_y + deep * (face[0] + face[1] * deep) * (r - deep * cos) * side
        step = weight * half
        parts = (
            b * (r * sigma * cos + r_s * tau_x * sin), b * (r_s * tau_x * cos - r * sigma * sin), sideways,
            b * r_s * r_s * tau_x, -r_s * sideways * sin, -r_s * sideways * cos,
        )  # fmt: skip
        sums = tuple(total + step * part for total, part in zip(sums, parts, strict=True))
    return sums


@joined
def contact_kernel(sinkage: Any, velocity: Any, wheel: Any, soil: Any, model: Any, rule: Any) -> Any:
    """F_N, F_DP, F_L, M_R, M_S, M_O of one wheel, or of eight. [N, N, N, N m, N m, N m]

    Arguments as of `contact_place`; `rule` are nodes and weights (k,) as of `contact_sums`.
    """
    place, face = contact_place(sinkage, velocity, wheel, soil, model), side_pressure(soil[3], soil[4], model)
    (nodes, weights), zero = rule, 0.0 * sinkage
    sums = (zero, zero, zero, zero, zero, zero)
    for k in range(len(nodes)):
        if model[1] == 0.0:
            sums = contact_sums(sums, place, nodes[k], weights[k], wheel, soil, model, face, 0)
        else:
            sums = contact_sums(sums, place, nodes[k], weights[k], wheel, soil, model, face, 1)
    return sums


@in_lanes
def _eight_by_eight(sinkage: Any, velocity: Any, soils: Any, contacts: Any, wheel: Any, model: Any, rule: Any) -> Any:
    """Forces and moments of n states on each of d soils, (6 d n / 8, 8): soil after soil F_N of all states, F_DP, ...

    Parameters
    ----------
    sinkage : soil after soil. (d n / 8, 8) [m]
    velocity : v_x of all states, v_y, r_s omega. (3 n / 8, 8)
    soils, contacts : as `forces_on_soils` takes them. (d, 8), (d, 4)
    wheel : r, b, h, r_s. [m]
    model : `ContactModel.vector()`, whose n2 is that of `contacts`.
    rule : nodes and weights. (k,), (k,)
    """
    blocks = len(velocity) // 3
    forces = np.empty((6 * len(sinkage), LANES))
    r, b, h, r_s = wheel
    for d in range(len(soils)):
        s, c = soils[d], contacts[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        geometry = (r, b, h, r_s, c[1], c[2], c[3])
        choices = (model[0], model[1], model[2], model[3], c[0], model[5], model[6], model[7], model[8])
        for i in range(blocks):
            moving = (load(velocity, i), load(velocity, blocks + i), load(velocity, 2 * blocks + i))
            sums = contact_kernel(load(sinkage, d * blocks + i), moving, geometry, soil, choices, rule)
            for k in range(6):
                store(forces, (6 * d + k) * blocks + i, sums[k])
    return forces


def forces_on_soils(
    sinkage: FloatArray,
    velocity: FloatArray,
    soils: FloatArray,
    wheel: Wheel,
    model: ContactModel,
    contacts: FloatArray | None = None,
) -> FloatArray:
    """F_N, F_DP, F_L, M_R, M_S, M_O, (d, 6, n), of n states on each of d soils. [N, N, N, N m, N m, N m]

    Parameters
    ----------
    sinkage : (d, n); NaN gives NaN. [m]
    velocity : (n, 3), see `contact_place`.
    soils : (d, 8), each as `Soil.vector()`.
    contacts : (d, 4) n2, c1, c2, c3, which take the place of the model's and the wheel's.
    """
    if contacts is None:
        contacts = np.tile([model.vector()[4], *wheel.vector()[4:]], (len(soils), 1))
    count = sinkage.shape[1]
    more = -count % LANES
    deep, moving = (
        np.ascontiguousarray(np.pad(one, ((0, 0), (0, more)), mode="edge")).reshape(-1, LANES)
        for one in (sinkage, velocity.T)
    )
    geometry, rule = wheel.vector()[:4], (NODES, WEIGHTS)
    forces = _eight_by_eight(deep, moving, soils, np.ascontiguousarray(contacts), geometry, model.vector(), rule)
    return np.asarray(forces.reshape(len(soils), 6, -1)[:, :, :count])


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
    """v_x, v_y, r_s omega of n states in a common unit, (n, 3), as `contact_place` takes them, limits included."""
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
    """Forces at sinkages z (n,) [m] and velocities (n, 3), each put into a shape of n numbers."""
    forces = forces_on_soils(z[None], velocity, np.array([soil.vector()]), wheel, model)[0]
    return ContactForces(*(force.reshape(shape) for force in finite(forces)))
