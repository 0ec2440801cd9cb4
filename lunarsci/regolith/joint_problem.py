"""What the joint inference compares: states, their forces and errors, and the model at any soil.

How far the model itself misses the forces, as shares of the load, from what a fit leaves over.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.stats import t as student

from lunarsci.compiled import each_in_threads
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.joint_model import forces_at, forces_of_many, whitened
from lunarsci.regolith.prior import CONTACT, PARAMETERS, Law, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel

__all__ = [
    "STEP",
    "JointProblem",
    "common_share",
    "error_covariance",
    "neighbours",
    "part_of",
    "problem_of",
    "shares_of",
    "states_alike",
    "tail_of",
]

FloatArray = npt.NDArray[np.float64]
STEP = 1e-3
"""Of numerical derivatives, in standard deviations of the prior or the input."""
CHUNK = 32
"""Points evaluated at once, so that they stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class JointProblem:
    """States, their forces and errors, and how the model is evaluated.

    `model_error` is a share of the load for each of F_N, F_DP, F_L. With `contact` the parameters of `CONTACT` are
    unknown too. Residuals beyond `huber` standard errors count linearly. Errors of so many states are `alike` that they
    count as one.
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
        return np.array([self.prior[name].center for name in self.names])

    @property
    def width(self) -> FloatArray:
        return np.array([self.prior[name].width for name in self.names])

    def at(self, point: FloatArray) -> FloatArray:
        """Forces of all states, (n, 3), at transformed parameters."""
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
        rows = white.transpose(0, 2, 1) / np.sqrt(self.alike)
        size = np.abs(rows)
        if np.isinf(self.huber):
            return np.asarray(rows)
        linear = np.sign(rows) * np.sqrt(self.huber * (2 * np.maximum(size, self.huber) - self.huber))
        return np.asarray(np.where(size > self.huber, linear, rows))

    def objective(self, point: FloatArray) -> float:
        """-2 ln of the posterior at a point, up to a constant."""
        away = (point - self.center) / self.width
        return float(np.sum(self.white(point[None]) ** 2) + np.sum(away**2))

    def ln_likelihood(self, points: FloatArray) -> FloatArray:
        """Of transformed parameters (d, p), up to a constant, in as many threads as there are cores.

        Without the determinant of the errors: the true inputs are unknowns of their own here, and with it K_s and N of
        simulated soils are off by more than their standard deviation.
        """
        found = np.empty(len(points))
        chunks = [slice(k, k + CHUNK) for k in range(0, len(points), CHUNK)]

        def fill(number: int) -> None:
            found[chunks[number]] = -0.5 * np.sum(self.white(points[chunks[number]]) ** 2, axis=(1, 2))

        each_in_threads(fill, len(chunks))
        return found


def problem_of(
    states: WheelStates,
    usable: npt.NDArray[np.bool_],
    wheel: Wheel,
    prior: Mapping[str, Law],
    model: ContactModel | None,
    model_error: tuple[float, float, float],
    contact: bool = False,
) -> JointProblem:
    values, sigmas = states.values[usable], states.sigmas[usable]
    inputs, spread = values[:, :3].copy(), sigmas[:, :3].copy()
    no_side = ~np.isfinite(inputs[:, 2])
    inputs[no_side, 2], spread[no_side, 2] = 0.0, 0.0
    forces = values[:, 3:].copy()
    forces[no_side, 2] = np.nan
    return JointProblem(inputs, spread, forces, np.nan_to_num(sigmas[:, 3:]), wheel, model, prior, model_error, contact)


def part_of(problem: JointProblem, kept: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> JointProblem:
    parts = {name: getattr(problem, name)[kept] for name in ("inputs", "input_sigma", "forces", "force_sigma")}
    return replace(problem, **parts)


TYPICAL, WIDTH = 0.03, 1.0
"""Median share of the load by which a wheel-soil model misses a force, and standard deviation of its logarithm, before
any residual has been looked at; assumed."""
LEAST_SHARE, GROUPS = 1e-3, 8
TAILS = (3.0, 4.0, 6.0, 10.0, 30.0)
"""Degrees of freedom of the Student law that residuals are compared with."""


def error_covariance(problem: JointProblem, slopes: FloatArray, shares: FloatArray) -> FloatArray:
    """Of the forces of each state: measurement, what input errors make of it, and the model's. (n, 3, 3) [N^2]

    `slopes` (3 inputs, 3 forces, n) are those of one standard deviation; forces not measured get a variance of 1.
    """
    covariance = np.asarray(np.einsum("kan,kbn->nab", slopes, slopes), dtype=np.float64)
    own = problem.force_sigma**2 + (shares * np.abs(problem.forces[:, :1])) ** 2
    missing = ~np.isfinite(problem.forces)
    covariance[missing] = 0.0
    covariance.transpose(0, 2, 1)[missing] = 0.0
    for k in range(3):
        covariance[:, k, k] = np.where(missing[:, k], 1.0, covariance[:, k, k] + own[:, k])
    return covariance


def _ln_likelihood(problem: JointProblem, residual: FloatArray, slopes: FloatArray, shares: FloatArray) -> float:
    root = np.linalg.cholesky(error_covariance(problem, slopes, shares))
    white = np.linalg.solve(root, residual[:, :, None])[:, :, 0]
    return float(-0.5 * (white**2).sum() - np.log(np.diagonal(root, axis1=1, axis2=2)).sum())


def _fitted(problem: JointProblem, point: FloatArray, freedom: float, common: bool) -> FloatArray:
    found, slopes = problem.residuals_and_slopes(point[None])
    measured = np.isfinite(problem.forces)
    count = int(measured.sum())
    # What a fit of so many free parameters has taken off the residuals.
    residual = np.where(measured, found[0].T, 0.0) * np.sqrt(count / max(count - freedom, 0.25 * count))

    def cost(ln_share: FloatArray) -> float:
        shares = np.maximum(np.exp(np.broadcast_to(ln_share, (3,))), LEAST_SHARE)
        law = 0.5 * float(np.sum((ln_share - np.log(TYPICAL)) ** 2)) / WIDTH**2
        return law - _ln_likelihood(problem, residual, slopes[0], shares)

    start = np.log(np.full(1 if common else 3, 0.05))
    best = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3}).x
    return np.asarray(np.maximum(np.exp(np.broadcast_to(best, (3,))), LEAST_SHARE), dtype=np.float64)


def common_share(problem: JointProblem, point: FloatArray, freedom: float) -> float:
    """One share for all forces, with which the residuals at a point are as large as their errors say.

    The likeliest one under a wide law around 0.03; `freedom` is the number of parameters that the fit has used up.
    """
    return float(_fitted(problem, point, freedom, True)[0])


def shares_of(problem: JointProblem, point: FloatArray, freedom: float) -> tuple[float, float, float]:
    """A share for each of F_N, F_DP, F_L; otherwise as `common_share`."""
    found = _fitted(problem, point, freedom, False)
    return (float(found[0]), float(found[1]), float(found[2]))


def neighbours(values: FloatArray, radius: float) -> npt.NDArray[np.intp]:
    """Number of each state's group of neighbours in sinkage, slip and side slip, at most 8. (n,)

    All are halved along their longest side until there are enough; sinkage counts in radii, side slip in 90 deg.
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
    found = [
        white[groups == g, k].sum() ** 2 / count
        for g in range(groups.max() + 1)
        for k in range(3)
        if (count := int(measured[groups == g, k].sum())) > 1
    ]
    return max(1.0, float(np.mean(found))) if found else 1.0


def tail_of(white: FloatArray) -> float:
    """Degrees of freedom, of `TAILS`, of the Student law of unit variance that whitened residuals follow best."""
    scores = [float(student.logpdf(white, freedom, scale=np.sqrt((freedom - 2) / freedom)).sum()) for freedom in TAILS]
    return TAILS[int(np.argmax(scores))]
