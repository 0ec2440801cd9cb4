"""All soil parameters from many wheel states at once: the posterior, what the data determine, and outliers.

F_N, F_DP and F_L of every state are compared with the model at the measured sinkage, slip and side slip. The errors of
those three reach the forces through the model's derivatives and make the residuals of one state correlated. The
posterior is normal around the mode in transformed parameters (Laplace), and sampled by importance on request.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from lunarsci.errors import ParameterError
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.joint_model import forces_at, forces_of_many
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel

__all__ = ["SoilPosterior", "infer_soil"]

FloatArray = npt.NDArray[np.float64]

MODEL_ERROR = 0.02
"""Share of the load by which the model may miss each force; assumed."""
STEPS, ROUNDS, CONVERGED = 100, 4, 1e-4
STEP = 1e-3
"""Of numerical derivatives, in standard deviations of the prior or the input."""
OUTLIER = 1e-3
"""Chance that the largest residual of all good states is called an outlier."""
MOST_OUTLIERS = 0.2
DETERMINED = 0.5
"""A parameter counts as determined where its standard deviation is below this share of the prior's."""
HEAVY_TAIL, LEAST_EFFECTIVE = 5, 200
LEVELS = (0.15865, 0.84135, 0.025, 0.975)


@dataclass(frozen=True, slots=True, eq=False)
class SoilPosterior:
    """What the states say of the soil.

    Attributes
    ----------
    mode, sd : (8,) of the transformed parameters, in the order of `PARAMETERS`.
    covariance : (8, 8) of these.
    draws : (d, 8) parameters in their units, from the posterior.
    shrinkage : by parameter, 1 - posterior over prior standard deviation: 0 learned nothing, 1 everything. [-]
    outliers : ids of states left out.
    residuals : (n, 3) measured less model, F_N, F_DP, F_L, NaN where not measured. [N]
    chi_square, degrees : of the states kept, and their number of forces.
    effective : effective number of importance draws, None for the normal approximation.
    """

    mode: FloatArray
    covariance: FloatArray
    draws: FloatArray = field(repr=False)
    prior: Mapping[str, Law]
    outliers: tuple[str, ...]
    residuals: FloatArray = field(repr=False)
    chi_square: float
    degrees: int
    effective: float | None = None

    @property
    def sd(self) -> FloatArray:
        """Standard deviations of the transformed parameters."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shrinkage(self) -> dict[str, float]:
        """See the class."""
        widths = [self.prior[name].width for name in PARAMETERS]
        return {name: float(1 - sd / width) for name, sd, width in zip(PARAMETERS, self.sd, widths, strict=True)}

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters whose standard deviation fell below half that of the prior."""
        return tuple(name for name, value in self.shrinkage.items() if value > 1 - DETERMINED)

    def intervals(self) -> dict[str, tuple[float, float, float, float, float]]:
        """Median, 68 % and 95 % limits of each parameter, in its unit."""
        ends = np.quantile(self.draws, (0.5, *LEVELS), axis=0)
        return {name: tuple(map(float, ends[:, k])) for k, name in enumerate(PARAMETERS)}  # type: ignore[misc]

    def combinations(self) -> list[tuple[float, dict[str, float]]]:
        """Directions in prior-scaled parameters and the share of the prior deviation left in each, best known first."""
        widths = np.array([self.prior[name].width for name in PARAMETERS])
        sizes, directions = np.linalg.eigh(self.covariance / np.outer(widths, widths))
        return [
            (float(np.sqrt(max(size, 0.0))), dict(zip(PARAMETERS, map(float, column), strict=True)))
            for size, column in zip(sizes, directions.T, strict=True)
        ]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """States, their forces and errors, and how the model is evaluated."""

    inputs: FloatArray
    input_sigma: FloatArray
    forces: FloatArray
    force_sigma: FloatArray
    wheel: Wheel
    model: ContactModel | None
    prior: Mapping[str, Law]
    model_error: float

    @property
    def center(self) -> FloatArray:
        return np.array([self.prior[name].center for name in PARAMETERS])

    @property
    def width(self) -> FloatArray:
        return np.array([self.prior[name].width for name in PARAMETERS])

    def at(self, point: FloatArray) -> FloatArray:
        """Forces of all states, (n, 3), at transformed parameters."""
        return forces_at(values_of(self.prior, point), self.inputs, self.wheel, self.model)

    def jacobian(self, point: FloatArray) -> FloatArray:
        """(n, 3, 8)."""
        columns = []
        for k in range(len(PARAMETERS)):
            step = np.zeros_like(point)
            step[k] = STEP * self.width[k]
            columns.append((self.at(point + step) - self.at(point - step)) / (2 * step[k]))
        return np.stack(columns, axis=-1)

    def whitening(self, point: FloatArray) -> FloatArray:
        """(n, 3, 3) inverse roots of the residuals' covariance; rows of forces that were not measured are 0."""
        values = values_of(self.prior, point)
        covariance = np.zeros((len(self.inputs), 3, 3))
        error = self.model_error * np.abs(self.forces[:, :1])
        covariance[:, range(3), range(3)] = self.force_sigma**2 + error**2
        for k in range(3):
            step = np.zeros_like(self.inputs)
            step[:, k] = STEP * np.maximum(self.input_sigma[:, k], 1e-9)
            ends = [forces_at(values, self.inputs + sign * step, self.wheel, self.model) for sign in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * step[:, k, None]) * self.input_sigma[:, k, None]
            slope = np.where(np.isfinite(slope), slope, 0.0)
            covariance += slope[:, :, None] * slope[:, None, :]
        missing = ~np.isfinite(self.forces)
        covariance[missing[:, :, None] | missing[:, None, :]] = 0.0
        covariance[:, range(3), range(3)] += missing
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        return np.where(missing[:, None, :] | missing[:, :, None], 0.0, root)


def infer_soil(
    states: WheelStates,
    wheel: Wheel,
    prior: Mapping[str, Law] | None = None,
    *,
    model: ContactModel | None = None,
    model_error: float = MODEL_ERROR,
    draws: int = 4000,
    sample: bool = False,
    seed: int = 0,
) -> SoilPosterior:
    """Posterior of the soil that all states share.

    Parameters
    ----------
    states, wheel : what was measured, and with which wheel. States need a slip ratio.
    prior : law of every parameter in `PARAMETERS`; `default_prior()`.
    model : the exact integrals with these choices; None for the closed form.
    model_error : share of the load added to the error of each force, 0 or more. [-]
    draws : from the posterior, 100 or more.
    sample : weight draws from a heavy-tailed law by the exact posterior, instead of the normal approximation.
    seed : of the random numbers.

    Raises
    ------
    ParameterError for too few draws or states, a missing prior, or a model error out of range.

    References
    ----------
    Ding et al. (2024), 10.1038/s41467-024-46233-8 (model, errors); Gelman et al. (2013), Bayesian Data Analysis, 3rd
    ed., ch. 13 (normal approximation), 10 (importance resampling).
    """
    laws = dict(prior or default_prior())
    _check(laws, model_error, draws)
    known = np.isfinite(states.values)
    usable = np.asarray(known[:, :2].all(axis=1) & known[:, 3:].any(axis=1), dtype=np.bool_)
    if not usable.any():
        raise ParameterError("no state has a sinkage, a slip ratio and a force; the joint inference needs all three")
    problem = _problem(states, usable, wheel, laws, model, model_error)
    names = [name for name, good in zip(states.id, usable, strict=True) if good]
    kept, point, covariance, root = _without_outliers(problem)
    residual = problem.forces - problem.at(point)
    white = _whitened(root, residual)
    chosen = np.random.default_rng(seed)
    drawn, effective = _drawn(_of(problem, kept), point, covariance, root[kept], draws, chosen, sample)
    return SoilPosterior(
        point,
        covariance,
        values_of(laws, drawn),
        laws,
        tuple(name for name, good in zip(names, kept, strict=True) if not good),
        residual,
        float(np.sum(white[kept] ** 2)),
        int(np.isfinite(problem.forces[kept]).sum()),
        effective,
    )


def _check(prior: Mapping[str, Law], model_error: float, draws: int) -> None:
    missing = [name for name in PARAMETERS if name not in prior]
    if missing:
        raise ParameterError(f"no prior for {', '.join(missing)}; give every parameter one")
    if not 0 <= model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a share from 0 to below 1")
    if draws < 100:
        raise ParameterError(f"{draws} draws; give 100 or more")


def _problem(
    states: WheelStates,
    usable: npt.NDArray[np.bool_],
    wheel: Wheel,
    prior: Mapping[str, Law],
    model: ContactModel | None,
    model_error: float,
) -> _Problem:
    values, sigmas = states.values[usable], states.sigmas[usable]
    inputs, spread = values[:, :3].copy(), sigmas[:, :3].copy()
    no_side = ~np.isfinite(inputs[:, 2])
    inputs[no_side, 2], spread[no_side, 2] = 0.0, 0.0
    forces = values[:, 3:].copy()
    forces[no_side, 2] = np.nan
    return _Problem(inputs, spread, forces, np.nan_to_num(sigmas[:, 3:]), wheel, model, prior, model_error)


def _of(problem: _Problem, kept: npt.NDArray[np.bool_]) -> _Problem:
    parts = {name: getattr(problem, name)[kept] for name in ("inputs", "input_sigma", "forces", "force_sigma")}
    return replace(problem, **parts)


def _whitened(root: FloatArray, residual: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", root, np.nan_to_num(residual)))


def _without_outliers(problem: _Problem) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray, FloatArray]:
    """Which states are kept, the mode, its covariance, and the whitening of all states there."""
    kept = np.ones(len(problem.inputs), dtype=bool)
    point = problem.center
    while True:
        part = _of(problem, kept)
        point, covariance = _mode(part, point)
        root = problem.whitening(point)
        white = _whitened(root, problem.forces - problem.at(point))
        measured = np.isfinite(problem.forces).sum(axis=1)
        limit = chi2.isf(OUTLIER / len(kept), np.maximum(measured, 1))
        excess = np.where(kept, np.sum(white**2, axis=1) / limit, 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 1 or (~kept).sum() + 1 > MOST_OUTLIERS * len(kept):
            return kept, point, covariance, root
        kept[worst] = False


def _mode(problem: _Problem, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Levenberg-Marquardt with the errors of the inputs carried over at each round's point."""
    point, width = start.copy(), problem.width
    curvature = np.diag(width**-2)
    for _ in range(ROUNDS):
        root = problem.whitening(point)
        before = point
        point, curvature = _descend(problem, point, root)
        if np.all(np.abs(point - before) < 1e-3 * width):
            break
    return point, np.asarray(np.linalg.inv(curvature), dtype=np.float64)


def _descend(problem: _Problem, point: FloatArray, root: FloatArray) -> tuple[FloatArray, FloatArray]:
    width, center = problem.width, problem.center

    def value(at: FloatArray) -> tuple[float, FloatArray]:
        white = _whitened(root, problem.forces - problem.at(at))
        total = float(np.sum(white**2) + np.sum(((at - center) / width) ** 2))
        return (total if np.isfinite(total) else np.inf), white

    damping = 1e-3
    best, white = value(point)
    curvature = np.diag(width**-2)
    for _ in range(STEPS):
        scaled = np.einsum("nij,njk->nik", root, problem.jacobian(point)).reshape(-1, len(point))
        curvature = scaled.T @ scaled + np.diag(width**-2)
        slope = scaled.T @ white.ravel() - (point - center) / width**2
        while damping < 1e10:
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope)
            trial, trial_white = value(point + step)
            if trial < best:
                break
            damping *= 10
        else:
            return point, curvature
        gained, best, white, point, damping = best - trial, trial, trial_white, point + step, max(damping / 5, 1e-12)
        if gained < CONVERGED:
            return point, curvature
    return point, curvature


def _drawn(
    problem: _Problem,
    point: FloatArray,
    covariance: FloatArray,
    root: FloatArray,
    draws: int,
    rng: np.random.Generator,
    sample: bool,
) -> tuple[FloatArray, float | None]:
    """Transformed parameters, (draws, 8), and the effective number of those weighted."""
    factor = np.linalg.cholesky(covariance)
    if not sample:
        return point + rng.standard_normal((draws, len(point))) @ factor.T, None
    proposed = rng.standard_normal((4 * draws, len(point)))
    scale = np.sqrt(HEAVY_TAIL / rng.chisquare(HEAVY_TAIL, len(proposed)))
    standard = proposed * scale[:, None]
    points = point + standard @ factor.T
    ln_proposal = -0.5 * (HEAVY_TAIL + len(point)) * np.log1p(np.sum(standard**2, axis=1) / HEAVY_TAIL)
    forces = forces_of_many(values_of(problem.prior, points), problem.inputs, problem.wheel, problem.model)
    white = np.einsum("nij,dnj->dni", root, np.nan_to_num(problem.forces - forces))
    ln_posterior = -0.5 * np.sum(white**2, axis=(1, 2))
    ln_posterior -= 0.5 * np.sum(((points - problem.center) / problem.width) ** 2, axis=1)
    weight = np.exp(ln_posterior - ln_proposal - np.max(ln_posterior - ln_proposal))
    weight /= weight.sum()
    effective = float(1 / np.sum(weight**2))
    if effective < LEAST_EFFECTIVE:
        raise ParameterError(
            f"only {effective:.0f} of {len(points)} draws count; the posterior is far from normal: state more, or give "
            "narrower priors"
        )
    return points[rng.choice(len(points), draws, p=weight)], effective
