"""Forces that a soil, learned from one wheel, predicts for any wheel, with its uncertainty and the model's error."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.regolith.joint import SoilPosterior
from lunarsci.regolith.joint_model import forces_of_many
from lunarsci.regolith.prior import values_of
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.regolith.wheel import Wheel

__all__ = ["PredictedForces", "predict_forces"]

FloatArray = npt.NDArray[np.float64]
DRAWS = 200
STEPS, SHALLOWEST, DEEPEST = 24, 1e-4, 0.95
"""Halvings to the sinkage under a load; its range as a share of the radius."""
LEAST_CARRIED = 0.05
"""Share of its load that a wheel carries at least where the model misses the normal force."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedForces:
    """F_N, F_DP, F_L of n states.

    Attributes
    ----------
    value : (n, 3) of the most probable soil. [N]
    draws : (d, n, 3) of the predictive distribution of measured forces. [N]
    sinkage_m : (d, n) at which they hold. [m]
    """

    value: FloatArray
    draws: FloatArray
    sinkage_m: FloatArray

    def interval(self, share: float = 0.9) -> tuple[FloatArray, FloatArray]:
        """Limits that hold measured forces with that probability, (n, 3) each. [N]"""
        low, high = np.nanquantile(self.draws, (0.5 - share / 2, 0.5 + share / 2), axis=0)
        return np.asarray(low), np.asarray(high)

    def holds(self, measured: FloatArray, share: float = 0.9) -> npt.NDArray[np.bool_]:
        """Whether measured forces (n, 3) lie in the interval of that share."""
        low, high = self.interval(share)
        return np.asarray((low <= measured) & (measured <= high))


def predict_forces(
    posterior: SoilPosterior,
    wheel: Wheel,
    slip_ratio: npt.ArrayLike,
    side_slip_deg: npt.ArrayLike,
    load_n: npt.ArrayLike,
    sinkage_m: npt.ArrayLike | None = None,
    *,
    errors: MeasurementErrors | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> PredictedForces:
    """What a wheel meets on the soil of a posterior.

    Parameters
    ----------
    wheel : any, by its own radius, width and grousers; contact angles are the posterior's where it inferred them.
    slip_ratio, side_slip_deg : (n,) s from -1 to 1, beta from -90 to 90. [-, deg]
    load_n : (n,) above 0; the model's error is a share of it. [N]
    sinkage_m : (n,) where it is known; else that under the load, of each draw. [m]
    errors : of the states given and of the forces that will be measured; all zero for the forces themselves.

    Returns
    -------
    Draws of the soil, of its contact, of the errors of measurement, and of the model's: a Student law with the tails of
    the residuals, for each force and state its own; all as many times wider as states left out ask for. Where the
    sinkage follows from the load, F_N is the load.

    Raises ParameterError for loads out of range.
    """
    states = np.column_stack(np.broadcast_arrays(slip_ratio, side_slip_deg, load_n)).astype(float)
    load, random = states[:, 2], np.random.default_rng(seed)
    if not (load > 0).all():
        raise ParameterError("a load is not above 0 N; forces are predicted as shares of it")
    said = errors or MeasurementErrors()
    best = values_of(posterior.prior, posterior.mode)
    soils = posterior.draws[random.choice(len(posterior.draws), draws, replace=len(posterior.draws) < draws)]
    share, depth, forces = np.array(posterior.verdict.model_error), np.empty((draws, len(load))), []
    given = None if sinkage_m is None else np.broadcast_to(np.asarray(sinkage_m, dtype=float), load.shape)
    for k, soil in enumerate(soils):
        moved = states[:, :2] + random.standard_normal((len(load), 2)) * _spread(said, states)
        if given is None:
            carried = load * np.maximum(1 + share[0] * random.standard_normal(load.shape), LEAST_CARRIED)
            depth[k] = _under(soil, moved, carried, wheel, posterior)
        else:
            deep = given + said.sinkage_m * random.standard_normal(load.shape)
            depth[k] = np.clip(deep, SHALLOWEST * wheel.radius_m, DEEPEST * wheel.radius_m)
        forces.append(_forces(soil, depth[k], moved, wheel, posterior))
    all_forces = np.stack(forces)
    here = _under(best, states[:, :2], load, wheel, posterior) if given is None else given
    value = _forces(best, here, states[:, :2], wheel, posterior)
    scale = np.sqrt((posterior.tail - 2) / posterior.tail)
    noise = scale * random.standard_t(posterior.tail, all_forces.shape) * share * load[:, None]
    noise += said.force_relative * np.abs(value) * random.standard_normal(all_forces.shape)
    if given is None:
        noise[..., 0], all_forces[..., 0], value[:, 0] = 0.0, load, load
    return PredictedForces(value, value + np.array(posterior.stretch) * (all_forces + noise - value), depth)


def _spread(errors: MeasurementErrors, states: FloatArray) -> FloatArray:
    """Standard deviations of slip and side slip, (n, 2)."""
    return np.column_stack([errors.of("slip_ratio", states[:, 0]), errors.of("side_slip_deg", states[:, 1])])


def _forces(soil: FloatArray, z: FloatArray, motion: FloatArray, wheel: Wheel, posterior: SoilPosterior) -> FloatArray:
    found = forces_of_many(soil[None], np.column_stack([z, motion]), wheel, posterior.model)[0]
    return np.array(found.T, dtype=np.float64)


def _under(
    soil: FloatArray, motion: FloatArray, load: FloatArray, wheel: Wheel, posterior: SoilPosterior
) -> FloatArray:
    """Sinkage under loads; the deepest one where the soil carries less. (n,)"""
    low, high = np.full(load.shape, SHALLOWEST * wheel.radius_m), np.full(load.shape, DEEPEST * wheel.radius_m)
    for _ in range(STEPS):
        middle = np.sqrt(low * high)
        light = _forces(soil, middle, motion, wheel, posterior)[:, 0] < load
        low, high = np.where(light, middle, low), np.where(light, high, middle)
    return np.asarray(low)
