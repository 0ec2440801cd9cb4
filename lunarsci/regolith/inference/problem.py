"""What the joint inference compares: states, their forces and errors, and the model at any soil.

How far the model itself misses the forces, as shares of the load, from what a fit leaves over; and how it misses them
as a smooth function of slip and side slip, a Gaussian process. A law of wheel and soil is wrong by what it leaves out,
and wrong in the same way at like slips and side slips. What is left over in the states that taught it is a part that
changes smoothly and a part of its own in each state (Kennedy & O'Hagan 2001, 10.1111/1467-9868.00294). How large and
how smooth the first is, is weighed by its marginal likelihood (Rasmussen & Williams 2006, ch. 5). Away from the states
that taught it the mean goes to 0 and the error to that of a law that nothing taught there.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import gammaln

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.compiled import each_in_threads, in_lanes
from lunarsci.regolith.forces import motion_ratios, wheel_forces_kernel
from lunarsci.regolith.integrals import forces_on_soils, velocities
from lunarsci.regolith.prior import CONTACT, PARAMETERS, STRANGE, Law, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import ContactModel, Wheel

FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")
"""F_N, F_DP, F_L as columns of wheel states have them; not the units of `lunarsci.regolith.columns.FORCES`."""
STEP = 1e-3
"""Of numerical derivatives, in standard deviations of the prior or the input."""
HUBER = STRANGE
"""Standard errors beyond which squares of residuals count linearly (Huber 1964, Ann. Math. Stat. 35, 73,
10.1214/aoms/1177703732), where single bad states must not lead."""
CHUNK = 32
"""Points evaluated at once, so that they stay in the cache."""


@in_lanes
def _closed(soils: Any, sinkage: Any, travel: Any, lateral: Any, wheel: Any) -> Any:
    """F_N, F_DP, F_L of the closed form, (d, 3, n). [N]

    soils : (d, 8), each as `Soil.vector()`.
    sinkage : on each soil. (d, n) [m]
    travel, lateral : v_x and v_y over r_s omega, as of `motion_ratios`. (n,) each [-]
    wheel : `Wheel.vector()`.
    """
    forces = np.empty((len(soils), 3, len(travel)))
    for d in range(len(soils)):
        s = soils[d]
        soil = (s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7])
        for i in range(len(travel)):
            f_n, f_dp, f_l, _ = wheel_forces_kernel(sinkage[d, i], travel[i], lateral[i], wheel, soil, 0)
            forces[d, 0, i], forces[d, 1, i], forces[d, 2, i] = f_n, f_dp, f_l
    return forces


def tempered(rows: FloatArray, huber: float = HUBER) -> FloatArray:
    """Whitened residuals, of any shape, whose squares grow linearly beyond `huber` standard errors."""
    size = np.abs(rows)
    return np.where(size > huber, np.sign(rows) * np.sqrt(huber * (2 * np.maximum(size, huber) - huber)), rows)


def forces_of_many(
    values: FloatArray,
    inputs: FloatArray,
    wheel: Wheel,
    model: ContactModel | None,
    sinkage: FloatArray | None = None,
) -> FloatArray:
    """F_N, F_DP, F_L, (d, 3, n), of d soils at n states; NaN for a sinkage no wheel can have. [N]

    Parameters
    ----------
    values : (d, 8) in the order and units of `PARAMETERS`, or (d, 12) with those of `CONTACT`, which then take the
        place of the model's and the wheel's; these need a model.
    inputs : (n, 3) sinkage [m], slip ratio and side slip [deg], which end at -1 and 1, -90 and 90.
    model : choices of the exact integrals, None for the closed form.
    sinkage : (d, n) on each soil, in place of that of the states. [m]
    """
    soils = np.array(values[:, :8], dtype=np.float64)
    soils[:, 0] *= 1e3
    soils[:, [4, 6]] = np.tan(np.radians(soils[:, [4, 6]]))
    soils[:, [5, 7]] *= 1e-3
    z = np.broadcast_to(inputs[:, 0], (len(soils), len(inputs))) if sinkage is None else sinkage
    slip, side = np.clip(inputs[:, 1], -1.0, 1.0), np.clip(inputs[:, 2], -90.0, 90.0)
    z = np.where((z > 0) & (z < wheel.radius_m), z, np.nan)
    if model is None:
        return np.asarray(_closed(soils, z, *motion_ratios(slip, side), wheel.vector()))
    contacts = values[:, 8:] if values.shape[1] > 8 else None
    return forces_on_soils(z, velocities(slip, side), soils, wheel, model, contacts)[:, :3]


def forces_at(values: FloatArray, inputs: FloatArray, wheel: Wheel, model: ContactModel | None) -> FloatArray:
    """The same of one soil, `values` (8,) or (12,), by state: (n, 3). [N]"""
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

    Of each state c is the lower triangle of its covariance, l that of its Cholesky factor, w = l^-1 residual.
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


@dataclass(frozen=True, slots=True, eq=False)
class JointProblem:
    """n states, their forces and errors, and how the model is evaluated. Points are transformed parameters, (d, p).

    Attributes
    ----------
    inputs, input_sigma : sinkage, slip ratio, side slip, and their standard errors. (n, 3) [m, -, deg]
        A side slip that was not measured is 0, exactly.
    forces, force_sigma : measured F_N, F_DP, F_L, NaN where not measured, and their standard errors. (n, 3) [N]
    wheel : of all states.
    model : choices of the exact integrals, None for the closed form.
    prior : law of each parameter, by name.
    model_error : share of the load by which the model misses F_N, F_DP, F_L. (3,) [-]
    contact : whether the parameters of `CONTACT` are unknown too; p is 12 then, else 8.
    huber : standard errors beyond which squares of residuals count linearly, infinite for never.
    alike : of how many states the errors are so much alike that they count as one, 1 or more.
    """

    inputs: FloatArray
    input_sigma: FloatArray
    forces: FloatArray
    force_sigma: FloatArray
    wheel: Wheel
    model: ContactModel | None
    prior: Mapping[str, Law]
    model_error: tuple[float, float, float]
    contact: bool = False
    huber: float = np.inf
    alike: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, in their order."""
        return (*PARAMETERS, *CONTACT) if self.contact else PARAMETERS

    @property
    def center(self) -> FloatArray:
        """Transforms of the medians of the prior. (p,)"""
        return np.array([self.prior[name].center for name in self.names])

    @property
    def width(self) -> FloatArray:
        """Standard deviations of the prior, of the transforms. (p,)"""
        return np.array([self.prior[name].width for name in self.names])

    def at(self, point: FloatArray) -> FloatArray:
        """Forces of all states, (n, 3), at transformed parameters (p,). [N]"""
        return forces_at(values_of(self.prior, point), self.inputs, self.wheel, self.model)

    def residuals_and_slopes(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured less model (d, 3, n), and by how much each force (axis 2) changes with one standard deviation of
        each input (axis 1), (d, 3, 3, n), at transformed parameters (d, p)."""
        values = values_of(self.prior, points)
        count, step = len(self.inputs), STEP * np.maximum(self.input_sigma, 1e-9)
        moved, used = [self.inputs], [k for k in range(3) if (self.input_sigma[:, k] > 0).any()]
        for k in used:
            moved.append(self.inputs.copy())
            moved[-1][:, k] -= np.where(self.inputs[:, k] > 0, 1, -1) * step[:, k]
        forces = forces_of_many(values, np.concatenate(moved), self.wheel, self.model)
        parts = forces.reshape(len(points), 3, len(moved), count).transpose(0, 2, 1, 3)
        slopes = np.zeros((len(points), 3, 3, count))
        share = (np.where(self.inputs > 0, 1, -1) * self.input_sigma / step).T[:, None]
        slopes[:, used] = (parts[:, :1] - parts[:, 1:]) * share[used]
        return self.forces.T - parts[:, 0], slopes

    def white(self, points: FloatArray) -> FloatArray:
        """Residuals over their errors, (d, n, 3), 0 for forces not measured.

        At transformed parameters (d, p). Errors of the inputs reach the forces through the model's derivatives at each
        point. NaN where a point is beyond any soil.
        """
        residual, slopes = self.residuals_and_slopes(points)
        variance = self.force_sigma**2 + (np.array(self.model_error) * np.abs(self.forces[:, :1])) ** 2
        missing = ~np.isfinite(self.forces)
        white = whitened(residual, slopes, np.where(missing, 0.0, variance).T.copy(), missing.T.astype(float))
        rows = np.asarray(white.transpose(0, 2, 1) / np.sqrt(self.alike))
        return rows if np.isinf(self.huber) else tempered(rows, self.huber)

    def objective(self, point: FloatArray) -> float:
        """-2 ln of the posterior at a point (p,), up to a constant."""
        away = (point - self.center) / self.width
        return float(np.sum(self.white(point[None]) ** 2) + np.sum(away**2))

    def ln_likelihood(self, points: FloatArray) -> FloatArray:
        """Of transformed parameters (d, p), up to a constant, in as many threads as there are cores.

        Without the determinant of the errors: the true inputs are unknowns of their own here, and with it K_s and N of
        simulated soils are off by more than their standard deviation.
        """
        result = np.empty(len(points))
        chunks = [slice(k, k + CHUNK) for k in range(0, len(points), CHUNK)]

        def fill(number: int) -> None:
            result[chunks[number]] = -0.5 * np.sum(self.white(points[chunks[number]]) ** 2, axis=(1, 2))

        each_in_threads(fill, len(chunks))
        return result


def problem_of(
    states: WheelStates,
    usable: BoolArray,
    wheel: Wheel,
    prior: Mapping[str, Law],
    model: ContactModel | None,
    model_error: tuple[float, float, float],
    contact: bool = False,
) -> JointProblem:
    """The problem of the `usable` states (m,) of all; other arguments as of `JointProblem`.

    Where a side slip was not measured it is taken as 0, and the lateral force of the state is not used.
    """
    values, sigmas = states.values[usable], states.sigmas[usable]
    inputs, spread = values[:, :3].copy(), sigmas[:, :3].copy()
    no_side = ~np.isfinite(inputs[:, 2])
    inputs[no_side, 2], spread[no_side, 2] = 0.0, 0.0
    forces = values[:, 3:].copy()
    forces[no_side, 2] = np.nan
    return JointProblem(inputs, spread, forces, np.nan_to_num(sigmas[:, 3:]), wheel, model, prior, model_error, contact)


def part_of(problem: JointProblem, rows: BoolArray | IndexArray) -> JointProblem:
    """The problem of some of its states."""
    parts = {name: getattr(problem, name)[rows] for name in ("inputs", "input_sigma", "forces", "force_sigma")}
    return replace(problem, **parts)


TYPICAL, WIDTH = 0.03, 1.0
"""Median share of the load by which a wheel-soil model misses a force, and standard deviation of its logarithm, before
any residual has been looked at; measured: 0.02 to 0.28 of normal forces, 0.04 to 0.08 of pulls of five wheels
(`tests/benchmarks/wheels.py`). With n residuals its weight is 1 in 2 n + 1: a median twice as high changes the share
found from 18 forces by 2 %, and `--model-error` gives it instead."""
LEAST_SHARE = 1e-3
"""Where the search for a share ends, 3.4 of the `WIDTH` below `TYPICAL`."""
GROUPS = 2**3
"""Parts that states are split into at most: halves by each of the three inputs."""
MOST_STATES = 200
"""States that laws are compared on, and that teach what a law misses: of more so many, so that it takes seconds, and a
quarter of them for readings of columns, each of which is a fit; assumed."""
GRADIENT = 1e-7
"""Slope of the logarithm of the posterior at which the search for shares ends; last digits, which differ between
processors, would else move what is reported by per cents."""
TAIL_RATE = 0.1
"""Of the law gamma(2, 0.1) of a Student law's degrees of freedom (Juárez & Steel 2010, 10.1198/jbes.2009.07145)."""


def error_covariance(problem: JointProblem, slopes: FloatArray, shares: FloatArray) -> FloatArray:
    """Of the forces of each state: measurement, what input errors make of it, and the model's. (n, 3, 3) [N^2]

    `slopes` (3 inputs, 3 forces, n) are those of one standard deviation [N], `shares` (3,) the model's errors as shares
    of the load; forces not measured get a variance of 1.
    """
    covariance = np.asarray(np.einsum("kan,kbn->nab", slopes, slopes), dtype=np.float64)
    variance = problem.force_sigma**2 + (shares * np.abs(problem.forces[:, :1])) ** 2
    missing = ~np.isfinite(problem.forces)
    covariance[missing] = 0.0
    covariance.transpose(0, 2, 1)[missing] = 0.0
    for k in range(3):
        covariance[:, k, k] = np.where(missing[:, k], 1.0, covariance[:, k, k] + variance[:, k])
    return covariance


def _fitted(problem: JointProblem, point: FloatArray, freedom: float, count: int) -> FloatArray:
    """Likeliest shares of the load by which the model misses F_N, F_DP, F_L at a point (p,). (3,) [-]

    freedom : number of parameters that the fit has used up.
    count : of unknown shares: 3, or 1 for one share of all forces.
    """
    from scipy.optimize import minimize

    missed, slopes = problem.residuals_and_slopes(point[None])
    measured = np.isfinite(problem.forces)
    number = int(measured.sum())
    # What a fit of so many free parameters has taken off the residuals.
    residual = np.where(measured, missed[0].T, 0.0) * np.sqrt(number / max(number - freedom, 0.25 * number))
    others = error_covariance(problem, slopes[0], np.zeros(3))
    load = np.where(measured, problem.forces[:, :1], 0.0)

    def cost(ln_share: FloatArray) -> tuple[float, FloatArray]:
        """- ln posterior, and its slope."""
        variance = (np.exp(ln_share) * load) ** 2
        covariance = others + variance[:, :, None] * np.eye(3)
        weight = np.linalg.inv(covariance)
        away = np.einsum("nab,nb->na", weight, residual)
        slope = (variance * (np.diagonal(weight, axis1=1, axis2=2) - away**2)).sum(axis=0)
        before = (ln_share - np.log(TYPICAL)) / WIDTH
        value = 0.5 * (float(before @ before) + float((residual * away).sum()) + np.linalg.slogdet(covariance)[1].sum())
        return value, before / WIDTH + slope.reshape(count, -1).sum(axis=1)

    start, bounds = np.log(np.full(count, 0.05)), [(math.log(LEAST_SHARE), None)] * count
    best = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 0.0, "gtol": GRADIENT}).x
    return np.asarray(np.exp(np.broadcast_to(best, (3,))), dtype=np.float64)


def common_share(problem: JointProblem, point: FloatArray, freedom: float) -> float:
    """One share for all forces, with which the residuals at a point are as large as their errors say.

    The likeliest one under a wide law around 0.03; `freedom` is the number of parameters that the fit has used up.
    """
    return float(_fitted(problem, point, freedom, 1)[0])


def shares_of(problem: JointProblem, point: FloatArray, freedom: float) -> tuple[float, float, float]:
    """A share for each of F_N, F_DP, F_L; otherwise as `common_share`."""
    normal, pull, lateral = map(float, _fitted(problem, point, freedom, 3))
    return normal, pull, lateral


def neighbours(values: FloatArray, radius: float) -> IndexArray:
    """Number of each state's group of neighbours in sinkage, slip and side slip, at most 8. (n,)

    `values` begin with sinkage [m], slip ratio, side slip [deg] (n, 3 or more), `radius` is the wheel's [m]. Groups are
    halved along their longest side until there are enough; sinkage counts in radii, side slip in 90 deg.
    """
    scaled = np.column_stack([values[:, 0] / radius, values[:, 1], np.nan_to_num(values[:, 2]) / 90])
    parts = [np.arange(len(scaled))]
    while len(parts) < GROUPS and max(map(len, parts)) > 1:
        parts.sort(key=len)
        largest = parts.pop()
        longest = int(np.argmax(np.ptp(scaled[largest], axis=0)))
        ordered = largest[np.argsort(scaled[largest, longest], kind="stable")]
        parts += [ordered[: len(ordered) // 2], ordered[len(ordered) // 2 :]]
    numbers = np.empty(len(scaled), dtype=np.intp)
    for number, part in enumerate(parts):
        numbers[part] = number
    return numbers


def states_alike(problem: JointProblem, point: FloatArray) -> float:
    """Of how many states the errors are so much alike that they count as one, 1 or more.

    The variance of sums of whitened residuals over groups of neighbours, over what it would be if each were on its own
    (the design effect of a cluster sample: Kish 1965, Survey Sampling, ch. 5).
    """
    white = problem.white(point[None])[0]
    groups = neighbours(problem.inputs, problem.wheel.radius_m)
    measured = np.isfinite(problem.forces)
    sums = [
        white[groups == g, k].sum() ** 2 / count
        for g in range(groups.max() + 1)
        for k in range(3)
        if (count := int(measured[groups == g, k].sum())) > 1
    ]
    return max(1.0, float(np.mean(sums))) if sums else 1.0


def tail_of(white: FloatArray) -> float:
    """Most probable degrees of freedom, above 2, of the Student law that residuals (n,) follow, whatever their size."""
    from scipy.optimize import minimize_scalar

    white = white / max(float(np.sqrt(np.mean(white**2))), 1e-12)

    def cost(ln_above: float) -> float:
        above = math.exp(ln_above)
        freedom = 2.0 + above
        peak = gammaln(0.5 * (freedom + 1)) - gammaln(0.5 * freedom) - 0.5 * np.log(np.pi * above)
        ln_likely = float((peak - 0.5 * (freedom + 1) * np.log1p(white**2 / above)).sum())
        return TAIL_RATE * freedom - math.log(freedom) - ln_likely

    return 2.0 + math.exp(minimize_scalar(cost, bounds=(-5.0, 5.0), method="bounded").x)


SLIPS, ANGLES_DEG, SMOOTH = (0.15, 0.4, 1.0), (8.0, 20.0, 50.0), (0.0, 0.3, 0.6, 0.9)
"""Prior of the Gaussian process, even over these: differences of slip [-] and side slip [deg] over which what a law
misses changes, and the share of its variance that is smooth; assumed."""
ALIKE, LEAST_ELSEWHERE = (0.6, 30.0), (0.4, 0.1, 0.1)
"""How far off in slip [-] and side slip [deg] from the states that taught it a law is as wrong as it is elsewhere;
assumed, some steps between states of wheel tests. Share of the load by which a law misses F_N, F_DP, F_L where nothing
taught it, at least: 0.11 to 0.58 at side slips of 15 to 75 deg where straight runs taught it, and 0.09 to 0.10 of runs
that the best one has not seen (wheel of Pavlov & Johnson 2019, `tests/benchmarks/wheel_blocks.py`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """The states that taught a law.

    Attributes
    ----------
    wheel : that was measured.
    inputs : sinkage [m], slip ratio [-], side slip [deg]. (m, 3)
    forces : measured F_N, F_DP, F_L, NaN where they were not. (m, 3) [N]
    """

    wheel: Wheel
    inputs: FloatArray = field(repr=False)
    forces: FloatArray = field(repr=False)

    def missed(self, soil: FloatArray, model: ContactModel | None) -> FloatArray:
        """Measured less model on a soil, as shares of the load, NaN where it was not measured. (m, 3)"""
        modelled = forces_of_many(soil[None], self.inputs, self.wheel, model)[0].T
        return np.asarray((self.forces - modelled) / np.abs(self.forces[:, :1]))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """What a law misses at n states, from what it missed at those that taught it.

    Attributes
    ----------
    lesson : states that taught the law; None where they are not known, and then its mean is 0.
    model : choices of the exact integrals, None for the closed form.
    weights : of what was missed at each of the m states of the lesson, 0 where it was not measured. (3, n, m) [-]
    sigma : standard deviation about that mean, as a share of the load. (n, 3) [-]
    """

    lesson: Lesson | None
    model: ContactModel | None
    weights: FloatArray
    sigma: FloatArray

    def mean(self, soil: FloatArray) -> FloatArray:
        """Mean of measured less model where a soil is the right one, as a share of the load. (n, 3)"""
        if self.lesson is None:
            return np.zeros_like(self.sigma)
        missed = np.nan_to_num(self.lesson.missed(soil, self.model))
        return np.asarray(np.einsum("knm,mk->nk", self.weights, missed))


def misfit_at(
    model_error: tuple[float, ...],
    lesson: Lesson | None,
    best: FloatArray,
    model: ContactModel | None,
    motion: FloatArray,
) -> Misfit:
    """What a law misses at slips and side slips.

    Parameters
    ----------
    model_error : share of the load by which it misses F_N, F_DP, F_L.
    lesson : what taught it; None where it is not known.
    best : the most probable soil, in the order of `PARAMETERS` and `CONTACT`.
    motion : slips and side slips. (n, 2)
    """
    if lesson is None:
        return Misfit(None, model, np.zeros((3, len(motion), 0)), shares_at(model_error, np.empty((0, 2)), motion))
    some = slice(None, None, max(1, -(-len(lesson.inputs) // MOST_STATES)))
    few = Lesson(lesson.wheel, lesson.inputs[some], lesson.forces[some])
    share, missed = shares_at(model_error, lesson.inputs[:, 1:3], motion), few.missed(best, model)
    weights, left = np.zeros((3, len(motion), len(missed))), np.ones_like(share)
    for force in range(3):
        measured = np.isfinite(missed[:, force])
        if model_error[force] > 0 and measured.sum() > 1:
            values, places = missed[measured, force] / model_error[force], few.inputs[measured, 1:3]
            weights[force][:, measured], left[:, force] = _predicted(values, places, motion)
    return Misfit(few, model, weights, share * np.sqrt(left))


def shares_at(model_error: Sequence[float], taught: FloatArray, motion: FloatArray) -> FloatArray:
    """Share of the load by which the model misses F_N, F_DP, F_L at slips and side slips (n, 2 or more). (n, 3)

    Near states that taught it (m, 2) that is the model error found there. Far from them the largest of the three comes
    to it, as straight drives say nothing of how well the law knows lateral forces.
    """
    share = np.broadcast_to(np.array(model_error), (len(motion), 3))
    if not len(taught):
        return share
    nearest = (((motion[:, None, :2] - taught[None]) / ALIKE) ** 2).sum(axis=2).min(axis=1)
    elsewhere = np.maximum(share.max(), LEAST_ELSEWHERE)
    return np.asarray(np.sqrt(share**2 + (-np.expm1(-nearest))[:, None] * elsewhere**2))


def _predicted(values: FloatArray, taught: FloatArray, asked: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights of values of unit variance in the mean (n, m), and what is left of their variance (n,), averaged over how
    smooth they may be.

    `values` (m,) are those at the slips and side slips `taught` (m, 2), `asked` (n, 2) where they are predicted.
    """
    tried, roots, ln_likely = list(itertools.product(SLIPS, ANGLES_DEG, SMOOTH)), list[FloatArray](), list[float]()
    for slip, angle, smooth in tried:
        places = taught / [slip, angle]
        covariance = smooth * _alike(places, places) + (1.0 - smooth + 1e-9) * np.eye(len(values))
        roots.append(np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))
        white = np.linalg.solve(roots[-1], values)
        ln_likely.append(float(-0.5 * white @ white - np.log(np.diag(roots[-1])).sum()))
    likely = np.exp(np.array(ln_likely) - max(ln_likely))
    weights, squares = np.zeros((len(asked), len(values))), np.zeros(len(asked))
    for share, root, (slip, angle, smooth) in zip(likely / likely.sum(), roots, tried, strict=True):
        seen = np.linalg.solve(root, smooth * _alike(taught / [slip, angle], asked / [slip, angle]))
        row = np.linalg.solve(root.T, seen).T
        weights += share * row
        squares += share * (1.0 - (seen**2).sum(axis=0) + (row @ values) ** 2)
    return weights, squares - (weights @ values) ** 2


def _alike(one: FloatArray, other: FloatArray) -> FloatArray:
    """Matern 3/2: correlation of places (n, 2) with places (m, 2), in units of the length of correlation. (n, m)"""
    apart = np.sqrt(3.0 * ((one[:, None] - other) ** 2).sum(axis=2))
    return np.asarray((1.0 + apart) * np.exp(-apart))
