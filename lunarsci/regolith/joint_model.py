"""Forces of many wheel states for one soil or many, as the joint inference needs them."""

from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import compiled
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.forces import travel_ratio, wheel_forces_kernel
from lunarsci.regolith.integrals import NODES, WEIGHTS, contact_kernel
from lunarsci.regolith.wheel import Wheel

__all__ = ["FORCES", "forces_at", "forces_of_many"]

FloatArray = npt.NDArray[np.float64]
FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")


@compiled
def _closed(soils: Any, inputs: Any, wheel: Any) -> Any:
    forces = np.full((len(soils), len(inputs), 3), np.nan)
    for d in range(len(soils)):
        s = soils[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        for i in range(len(inputs)):
            z, slip, beta = inputs[i]
            if 0.0 < z < wheel[0] and -1.0 < slip < 1.0:
                travel = travel_ratio(slip)
                found = wheel_forces_kernel(z, travel, travel * np.tan(beta), wheel, soil, 0)
                forces[d, i] = found[:3]
    return forces


@compiled
def _integrated(soils: Any, inputs: Any, wheel: Any, model: Any, nodes: Any, weights: Any) -> Any:
    forces = np.full((len(soils), len(inputs), 3), np.nan)
    for d in range(len(soils)):
        s = soils[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        for i in range(len(inputs)):
            z, slip, beta = inputs[i]
            if 0.0 < z < wheel[0] and -1.0 < slip < 1.0:
                travel = travel_ratio(slip)
                moving = (travel, travel * np.tan(beta), 1.0)
                found = contact_kernel(z, moving, wheel, soil, model, nodes, weights)
                forces[d, i, 0], forces[d, i, 1], forces[d, i, 2] = found[0], found[1], found[2]
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
    states = np.array(inputs, dtype=np.float64)
    states[:, 2] = np.radians(states[:, 2])
    if model is None:
        return np.asarray(_closed(soils, states, wheel.vector()))
    return np.asarray(_integrated(soils, states, wheel.vector(), model.vector(), NODES, WEIGHTS))


def forces_at(values: FloatArray, inputs: FloatArray, wheel: Wheel, model: ContactModel | None) -> FloatArray:
    """The same of one soil, (n, 3)."""
    return np.asarray(forces_of_many(values[None], inputs, wheel, model)[0])
