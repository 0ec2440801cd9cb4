"""A soil from sinkages under known loads, and from what the wheels' pulls and lateral forces add up to.

The load of each wheel follows from the levers of a suspension, and the sum of all drawbar pulls and lateral forces from
weight and slope; neither needs a soil. How the sum shares out among the wheels does, so it is not used here: forces
that came from a soil cannot prove it.

Each soil puts every wheel as deep as its load asks for. That depth is compared with the measured one, and what the
wheels pull there, at their measured slips, with the totals. Taking the pulls at the measured depths instead would make
the errors of these, which are not small beside them, errors of the soil.
"""

from dataclasses import dataclass, replace

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.inference.mode import find_mode
from lunarsci.regolith.inference.problem import forces_of_many, tempered
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.traction import DEEPEST
from lunarsci.regolith.wheel import Wheel

STEP = 1e-3
"""Of numerical derivatives by the inputs, in their standard errors."""
MODEL_ERROR = 0.02
"""Share of the load by which the model may miss each force; assumed."""
NEWTON, FIRST_SINKAGE, SHALLOWEST, LEAST_POWER = 8, 0.05, 1e-6, 0.2
"""Steps to the sinkage under a load, where they begin and the least one in radii, and the least power of F_N in it."""
ROUGH = 5.0
"""Times the error of sinkages in a fit that only finds the way."""
FREEZES = 2
"""Fits before the last one: in the first the model's errors follow the soil, which finds the way from far off; in the
others they are those of the soil before."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BalancedStates:
    """States of all m wheels of a rover at p poses, their loads, and what their other forces add up to.

    Attributes
    ----------
    inputs, input_sigma : sinkage, slip ratio, side slip, NaN where not measured. (p, m, 3) [m, -, deg]
    load, load_sigma : normal forces. (p, m) [N]
    levers : what a newton of drawbar pull and of lateral force of each wheel adds to the totals. (p, 3, m, 2) [-, -, m]
    totals, totals_sigma : force ahead, force to the left, moment about the vertical. (p, 3) [N, N, N m]

    alike : number of neighbouring poses whose errors of slip, side slip and totals are alike, 1 or more: so many count
        as one.

    Errors of sinkage are the wheels' own. Those of slip and side slip come from the rover's motion, so that at a pose
    they are taken as common to all wheels.
    """

    inputs: FloatArray
    input_sigma: FloatArray
    load: FloatArray
    load_sigma: FloatArray
    levers: FloatArray
    totals: FloatArray
    totals_sigma: FloatArray
    alike: float = 1.0

    def __post_init__(self) -> None:
        p, m = self.load.shape
        wanted = {"inputs": (p, m, 3), "levers": (p, 3, m, 2), "totals": (p, 3), "totals_sigma": (p, 3)}
        wrong = [name for name, shape in wanted.items() if getattr(self, name).shape != shape]
        if wrong or not (self.usable.any() and (self.totals_sigma > 0).all()):
            text = "no wheel has a sinkage, a slip ratio and a load, so that nothing can be learned"
            raise ParameterError(f"{', '.join(wrong)}: shapes must be {wanted}" if wrong else text)

    @property
    def usable(self) -> BoolArray:
        """Wheels with a sinkage, a slip ratio and a load. (p, m)"""
        return np.asarray(
            np.isfinite(self.inputs[..., :2]).all(axis=2) & (self.load > 0) & (np.abs(self.inputs[..., 1]) < 1),
            dtype=np.bool_,
        )

    @property
    def whole(self) -> BoolArray:
        """Poses whose wheels are all known, with side slips, so that their forces can be added up. (p,)"""
        sided = np.isfinite(self.inputs[..., 2]).all(axis=1)
        return np.asarray(self.usable.all(axis=1) & sided & np.isfinite(self.totals).all(axis=1), dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class TotalsPosterior:
    """What the states teach.

    Attributes
    ----------
    belief : of the soil after them.
    chi_square : of sinkages, and of totals.
    values : how many of each there were.
    """

    belief: SoilBelief
    chi_square: tuple[float, float]
    values: tuple[int, int]

    @property
    def reduced(self) -> tuple[float, float]:
        """Chi-squares over the number of values."""
        sinkages, totals = (c / max(n, 1) for c, n in zip(self.chi_square, self.values, strict=True))
        return sinkages, totals


@dataclass(frozen=True, slots=True)
class _Problem:
    """As `find_mode` reads it: points (d, 8) are the belief's transforms, whitened: mean + root point.

    Attributes
    ----------
    states : m wheels at p poses.
    wheel : of all states.
    belief : of the soil before.
    root : Cholesky factor of its covariance. (8, 8)
    model_error : share of the load by which the model may miss each force. [-]
    frozen : sinkage for each newton of load at the soil of an earlier fit; None for that of each point. (p, m) [m/N]

    Errors of the inputs follow the soil through the model's slopes, as the true inputs are unknowns of their own. What
    the model itself misses does not: `frozen` is its sinkage for each newton at the soil of an earlier fit. Otherwise
    soils that make sinkages vague would be preferred.
    """

    states: BalancedStates
    wheel: Wheel
    belief: SoilBelief
    root: FloatArray
    model_error: float
    frozen: FloatArray | None

    @property
    def center(self) -> FloatArray:
        """Of the prior, in whitened parameters: the belief's mean. (8,)"""
        return np.zeros(len(self.root))

    @property
    def width(self) -> FloatArray:
        """Standard deviations of the prior, in whitened parameters: 1. (8,)"""
        return np.ones(len(self.root))

    def white(self, points: FloatArray) -> FloatArray:
        """Residuals over their errors, tempered where they are outliers. (d, p, m + 3)"""
        return tempered(self.residuals(points))

    def objective(self, point: FloatArray) -> float:
        """-2 ln of the posterior at a point (8,), up to a constant."""
        return float(np.sum(self.white(point[None]) ** 2) + point @ point)

    def residuals(self, points: FloatArray) -> FloatArray:
        """Whitened residuals of sinkages, then of totals. (d, p, m + 3)"""
        states = self.states
        sinkage, force, slopes = self._under_load(points)
        d, (p, m) = len(points), states.load.shape
        compared = np.concatenate([states.usable, np.repeat(states.whole[:, None], 3, axis=1)], axis=1)
        supplied = np.einsum("ptmf,dpmf->dpt", states.levers, force[..., 1:])
        off = np.concatenate([states.inputs[..., 0] - sinkage, states.totals - supplied], axis=2)
        # What the model is off by is the same at every pose, so that all of them count as one.
        misses = self.model_error * np.sqrt(max(1, states.usable.any(axis=1).sum())) * states.load
        by_input = np.zeros((d, p, m + 3, m + 2))  # own loads, then the common slip and side slip
        index = np.arange(m)
        deeper = 1.0 / slopes[..., 0, 0]
        by_input[..., index, index] = deeper * states.load_sigma
        by_input[..., :m, m:] = -deeper[..., None] * slopes[..., 1:, 0]
        at_load = slopes[..., 1:, 1:] - (deeper[..., None] * slopes[..., 1:, 0])[..., None] * slopes[..., :1, 1:]
        by_load = slopes[..., 0, 1:] * by_input[..., index, index][..., None]
        by_input[..., m:, :m] = np.einsum("ptmf,dpmf->dptm", states.levers, by_load)
        by_input[..., m:, m:] = np.einsum("ptmf,dpmkf->dptk", states.levers, at_load)
        spread = np.einsum("ptmf,pm->pt", states.levers**2, misses**2)
        by_input[..., m:] *= np.sqrt(states.alike)
        missed = misses * (deeper if self.frozen is None else self.frozen)
        variance = np.empty((d, p, m + 3))
        variance[..., :m] = states.input_sigma[..., 0] ** 2 + missed**2
        variance[..., m:] = states.alike * states.totals_sigma**2 + spread
        by_input = np.where(compared[..., None], by_input, 0.0)
        covariance = by_input @ by_input.swapaxes(2, 3)
        diagonal = np.arange(m + 3)
        covariance[..., diagonal, diagonal] += np.where(compared, variance, 1.0)
        factor = np.linalg.cholesky(covariance)
        return np.asarray(np.linalg.solve(factor, np.where(compared, off, 0.0)[..., None])[..., 0])

    def deeper(self, point: FloatArray) -> FloatArray:
        """Sinkage for each newton of load. (p, m) [m/N]"""
        return np.asarray(1.0 / self._under_load(point[None])[2][0, ..., 0, 0])

    def _under_load(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sinkage at which each wheel carries its load (d, p, m), the forces there (d, p, m, 3), and their slopes.

        Slopes (d, p, m, 3 inputs, 3 forces): by sinkage for each metre, by slip and side slip for each standard error.
        Newton's method in logarithms, as F_N goes nearly with a power of the sinkage.
        """
        states, radius = self.states, self.wheel.radius_m
        soils = values_of(self.belief.laws, self.belief.mean + points @ self.root.T)
        slip = np.nan_to_num(states.inputs[..., 1:]).reshape(-1, 2)
        load = np.where(states.usable, states.load, 1.0).ravel()
        sigma = np.nan_to_num(states.input_sigma[..., 1:]).reshape(-1, 2)
        z, twice = np.full((len(soils), len(load)), FIRST_SINKAGE * radius), np.concatenate([slip, slip])
        for _ in range(NEWTON):
            here, beside = np.split(
                self._at(soils, np.concatenate([z, (1 + STEP) * z], axis=1), twice)[:, 0], 2, axis=1
            )
            power = np.maximum(np.log(beside / here) / np.log1p(STEP), LEAST_POWER)
            z = np.clip(z * np.exp(np.log(load / here) / power), SHALLOWEST * radius, DEEPEST * radius)
        step = STEP * np.maximum(sigma, 1e-9)
        moved = [slip] * 3 + [slip + sign * step * (np.arange(2) == k) for k in range(2) for sign in (1.0, -1.0)]
        depths = np.concatenate([z, (1 + STEP) * z, (1 - STEP) * z, *([z] * 4)], axis=1)
        force = self._at(soils, depths, np.concatenate(moved)).reshape(len(soils), 3, 7, len(load))
        slopes = force[:, :, 1::2] - force[:, :, 2::2]  # (d, 3 forces, 3 inputs, n)
        slopes[:, :, 0] /= 2 * STEP * z[:, None]
        slopes[:, :, 1:] *= (sigma / (2 * step)).T
        shape = (len(soils), *states.load.shape)
        slopes = slopes.transpose(0, 3, 2, 1).reshape(*shape, 3, 3)
        return z.reshape(shape), force[:, :, 0].transpose(0, 2, 1).reshape(*shape, 3), slopes

    def _at(self, soils: FloatArray, sinkage: FloatArray, slip: FloatArray) -> FloatArray:
        """Forces (d, 3, n) [N] on soils (d, 8) at sinkages (d, n) [m], slips and side slips (n, 2) [-, deg]."""
        inputs = np.column_stack([np.zeros(len(slip)), slip])
        return forces_of_many(soils, inputs, self.wheel, None, sinkage=sinkage)


def _way_in(problem: _Problem, start: FloatArray) -> FloatArray:
    """The best of several modes: from the belief's mean, and by way of fits that take errors as less alike, or loads
    and sinkages as known less well. Soils far from the belief lead a single fit into a side valley."""
    states, modes = problem.states, [start]
    rough = states.input_sigma * [ROUGH, 1.0, 1.0]
    for way in (states, replace(states, alike=1.0), replace(states, input_sigma=rough)):
        first, _ = find_mode(replace(problem, states=way), start)
        modes.append(find_mode(problem, first)[0])
    return min(modes, key=problem.objective)


def infer_from_totals(
    states: BalancedStates, wheel: Wheel, belief: SoilBelief, *, model_error: float = MODEL_ERROR
) -> TotalsPosterior:
    """The soil that all states share, from their loads and the totals alone.

    Parameters
    ----------
    states : of whole poses; where a wheel or a side slip is missing, the totals of that pose are not used.
    wheel : the wheel of all states.
    belief : what is held of the soil before.
    model_error : share of the load by which the model misses each force, 0 or more. [-]

    Raises ParameterError where the model has no finite forces. The posterior is normal around its mode (Laplace).
    """
    root = np.asarray(np.linalg.cholesky(belief.covariance), dtype=np.float64)
    start = np.zeros(len(PARAMETERS))
    problem = _Problem(states, wheel, belief, root, model_error, None)
    start = _way_in(problem, start)
    for _ in range(FREEZES):
        start, _ = find_mode(problem, start)
        problem = replace(problem, frozen=problem.deeper(start))
    start, covariance = find_mode(problem, start)
    covariance = root @ covariance @ root.T
    rows = problem.residuals(start[None])[0]
    wheels = states.load.shape[1]
    return TotalsPosterior(
        replace(belief, mean=belief.mean + root @ start, covariance=0.5 * (covariance + covariance.T), population=None),
        (float((rows[:, :wheels] ** 2).sum()), float((rows[:, wheels:] ** 2).sum())),
        (int(states.usable.sum()), 3 * int(states.whole.sum())),
    )
