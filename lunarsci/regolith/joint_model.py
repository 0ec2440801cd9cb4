"""Forces of many wheel states for one soil or many, as the joint inference needs them."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import compiled, in_lanes
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.forces import motion_ratios, wheel_forces_kernel
from lunarsci.regolith.integrals import NODES, WEIGHTS, contact_kernel, velocities
from lunarsci.regolith.wheel import Wheel

__all__ = ["FORCES", "forces_at", "forces_of_many", "whitened"]

FloatArray = npt.NDArray[np.float64]
FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")


@in_lanes
def _closed(soils: Any, sinkage: Any, travel: Any, lateral: Any, wheel: Any) -> Any:
    forces = np.empty((len(soils), 3, len(sinkage)))
    for d in range(len(soils)):
        s = soils[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        for i in range(len(sinkage)):
            f_n, f_dp, f_l, _ = wheel_forces_kernel(sinkage[i], travel[i], lateral[i], wheel, soil, 0)
            forces[d, 0, i], forces[d, 1, i], forces[d, 2, i] = f_n, f_dp, f_l
    return forces


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _integrated(soils: Any, contacts: Any, sinkage: Any, velocity: Any, wheel: Any, model: Any, rule: Any) -> Any:
    forces = np.full((len(soils), 3, len(sinkage)), np.nan)
    nodes, weights = rule
    r, b, h, r_s = wheel
    for d in range(len(soils)):
        s, c = soils[d], contacts[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        own = (r, b, h, r_s, c[1], c[2], c[3])
        choices = (model[0], model[1], model[2], model[3], c[0], model[5], model[6], model[7], model[8])
        for i in range(len(sinkage)):
            if math.isfinite(sinkage[i]):
                moving = (velocity[i, 0], velocity[i, 1], velocity[i, 2])
                found = contact_kernel(sinkage[i], moving, own, soil, choices, nodes, weights)
                forces[d, 0, i], forces[d, 1, i], forces[d, 2, i] = found[0], found[1], found[2]
    return forces


def forces_of_many(values: FloatArray, inputs: FloatArray, wheel: Wheel, model: ContactModel | None) -> FloatArray:
    """F_N, F_DP, F_L, (d, 3, n), of d soils at n states; NaN for a sinkage no wheel can have. [N]

    Parameters
    ----------
    values : (d, 8) in the order and units of `PARAMETERS`, or (d, 12) with those of `CONTACT`, which then take the
        place of the model's and the wheel's; these need a model.
    inputs : (n, 3) sinkage [m], slip ratio and side slip [deg], which end at -1 and 1, -90 and 90.
    model : choices of the exact integrals, None for the closed form.
    """
    soils = np.array(values[:, :8], dtype=np.float64)
    soils[:, 0] *= 1e3
    soils[:, [4, 6]] = np.tan(np.radians(soils[:, [4, 6]]))
    soils[:, [5, 7]] *= 1e-3
    z, slip, side = inputs[:, 0], np.clip(inputs[:, 1], -1.0, 1.0), np.clip(inputs[:, 2], -90.0, 90.0)
    z = np.where((z > 0) & (z < wheel.radius_m), z, np.nan)
    if model is None:
        return np.asarray(_closed(soils, z, *motion_ratios(slip, side), wheel.vector()))
    own = np.array([model.vector()[4], *wheel.vector()[4:]])
    contacts = np.ascontiguousarray(values[:, 8:]) if values.shape[1] > 8 else np.tile(own, (len(values), 1))
    geometry, rule = wheel.vector()[:4], (NODES, WEIGHTS)
    return np.asarray(_integrated(soils, contacts, z, velocities(slip, side), geometry, model.vector(), rule))


def forces_at(values: FloatArray, inputs: FloatArray, wheel: Wheel, model: ContactModel | None) -> FloatArray:
    """The same of one soil, (n, 3)."""
    return np.asarray(forces_of_many(values[None], inputs, wheel, model)[0].T)


@in_lanes
def whitened(residual: Any, slopes: Any, variance: Any, missing: Any) -> Any:
    """Residuals of every state over their errors, (d, 3, n).

    Parameters
    ----------
    residual : (d, 3, n) measured less model; anything where not measured. [N]
    slopes : (d, 3, 3, n) change of each force (axis 2) by one standard deviation of each input (axis 1). [N]
    variance : (3, n) of the forces themselves. [N^2]
    missing : (3, n) 1 where a force was not measured, else 0.
    """
    white = np.empty_like(residual)
    for d in range(len(residual)):
        for i in range(residual.shape[2]):
            m_0, m_1, m_2 = 1.0 - missing[0, i], 1.0 - missing[1, i], 1.0 - missing[2, i]
            a, b, c = slopes[d, 0, 0, i], slopes[d, 1, 0, i], slopes[d, 2, 0, i]
            e, f, g = slopes[d, 0, 1, i], slopes[d, 1, 1, i], slopes[d, 2, 1, i]
            p, q, r = slopes[d, 0, 2, i], slopes[d, 1, 2, i], slopes[d, 2, 2, i]
            c_00 = (variance[0, i] + a * a + b * b + c * c) if m_0 > 0.0 else 1.0
            c_11 = (variance[1, i] + e * e + f * f + g * g) if m_1 > 0.0 else 1.0
            c_22 = (variance[2, i] + p * p + q * q + r * r) if m_2 > 0.0 else 1.0
            c_10 = (a * e + b * f + c * g) if m_0 * m_1 > 0.0 else 0.0
            c_20 = (a * p + b * q + c * r) if m_0 * m_2 > 0.0 else 0.0
            c_21 = (e * p + f * q + g * r) if m_1 * m_2 > 0.0 else 0.0
            l_00 = math.sqrt(c_00)
            l_10, l_20 = c_10 / l_00, c_20 / l_00
            l_11 = math.sqrt(c_11 - l_10 * l_10)
            l_21 = (c_21 - l_20 * l_10) / l_11
            l_22 = math.sqrt(c_22 - l_20 * l_20 - l_21 * l_21)
            w_0 = (residual[d, 0, i] if m_0 > 0.0 else 0.0) / l_00
            w_1 = ((residual[d, 1, i] if m_1 > 0.0 else 0.0) - l_10 * w_0) / l_11
            w_2 = ((residual[d, 2, i] if m_2 > 0.0 else 0.0) - l_20 * w_0 - l_21 * w_1) / l_22
            white[d, 0, i], white[d, 1, i], white[d, 2, i] = w_0, w_1, w_2
    return white
