"""Forces of many wheel states for one soil or many, as the joint inference needs them."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import compiled, in_lanes
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.forces import wheel_forces_kernel
from lunarsci.regolith.integrals import NODES, WEIGHTS, contact_kernel
from lunarsci.regolith.wheel import Wheel

__all__ = ["FORCES", "forces_at", "forces_of_many"]

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


@compiled
def _integrated(soils: Any, sinkage: Any, travel: Any, lateral: Any, wheel: Any, model: Any, rule: Any) -> Any:
    forces = np.full((len(soils), 3, len(sinkage)), np.nan)
    nodes, weights = rule
    for d in range(len(soils)):
        s = soils[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        for i in range(len(sinkage)):
            if math.isfinite(sinkage[i]):
                moving = (travel[i], lateral[i], 1.0)
                found = contact_kernel(sinkage[i], moving, wheel, soil, model, nodes, weights)
                forces[d, 0, i], forces[d, 1, i], forces[d, 2, i] = found[0], found[1], found[2]
    return forces


def forces_of_many(values: FloatArray, inputs: FloatArray, wheel: Wheel, model: ContactModel | None) -> FloatArray:
    """F_N, F_DP, F_L, (d, n, 3), of d soils at n states; NaN for a state no wheel can have. [N]

    Parameters
    ----------
    values : (d, 8) in the order and units of `PARAMETERS`.
    inputs : (n, 3) sinkage [m], slip ratio, side slip [deg].
    model : choices of the exact integrals, None for the closed form.
    """
    soils = np.array(values, dtype=np.float64)
    soils[:, 0] *= 1e3
    soils[:, [4, 6]] = np.tan(np.radians(soils[:, [4, 6]]))
    soils[:, [5, 7]] *= 1e-3
    z, slip = inputs[:, 0], inputs[:, 1]
    possible = (z > 0) & (z < wheel.radius_m) & (slip > -1) & (slip < 1)
    slip = np.where(possible, slip, 0.0)
    travel = np.where(slip >= 0, 1 - slip, 1 / (1 + slip))
    states = (np.where(possible, z, np.nan), travel, travel * np.tan(np.radians(inputs[:, 2])), wheel.vector())
    if model is None:
        return np.asarray(_closed(soils, *states).transpose(0, 2, 1))
    return np.asarray(_integrated(soils, *states, model.vector(), (NODES, WEIGHTS)).transpose(0, 2, 1))


def forces_at(values: FloatArray, inputs: FloatArray, wheel: Wheel, model: ContactModel | None) -> FloatArray:
    """The same of one soil, (n, 3)."""
    return np.asarray(forces_of_many(values[None], inputs, wheel, model)[0])
