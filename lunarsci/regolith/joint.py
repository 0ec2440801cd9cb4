"""All soil parameters from many wheel states at once: the posterior, what the data determine, and outliers.

F_N, F_DP and F_L of every state are compared with the model at the measured sinkage, slip and side slip. The errors of
those three reach the forces through the model's derivatives and make the residuals of one state correlated. The
posterior is normal around the mode in transformed parameters (Laplace), and sampled by importance on request.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.joint_model import forces_at, forces_of_many
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel

__all__ = ["SoilPosterior", "infer_soil"]

FloatArray = npt.NDArray[np.float64]

MODEL_ERROR = 0.02
"""Share of the load by which the model may miss each force; assumed."""
STEPS, HIGHEST_DAMPING, CONVERGED = 100, 1e10, 1e-4
LEAST_SINKAGE_M, DEEPEST, LARGEST_SLIP = 1e-5, 0.95, 0.99
"""States beyond are left out: sinkage, as a share of the radius the deepest, and slip ratio."""
LONGEST = 2.0
"""Step, in standard deviations of the prior."""
STEP = 1e-3
"""Of numerical derivatives, in standard deviations of the prior or the input."""
OUTLIER = 1e-3
"""Chance that the largest residual of all good states is called an outlier."""
MOST_OUTLIERS = 0.2
DETERMINED = 0.5
"""A parameter counts as determined where its standard deviation is below this share of the prior's."""
HEAVY_TAIL, PROPOSED, LEAST_EFFECTIVE, CHUNK = 5, 3, 200, 200
"""Degrees of freedom, proposals per draw, and effective draws below which there is no answer; draws at once."""
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

    def white(self, points: FloatArray) -> FloatArray:
        """Whitened residuals of all states, (d, n, 3), at transformed parameters (d, 8); 0 for forces not measured.

        Errors of the inputs reach the forces through the model's derivatives at each point. NaN where a point is beyond
        any soil.
        """
        values = values_of(self.prior, points)
        error = self.model_error * np.abs(self.forces[:, :1])
        variance = self.force_sigma**2 + error**2
        covariance = np.zeros((len(points), *self.forces.shape, 3))
        covariance[..., range(3), range(3)] = variance
        for k in range(3):
            step = np.zeros_like(self.inputs)
            step[:, k] = STEP * np.maximum(self.input_sigma[:, k], 1e-9)
            ends = [forces_of_many(values, self.inputs + sign * step, self.wheel, self.model) for sign in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * step[:, k, None]) * self.input_sigma[:, k, None]
            covariance += slope[..., :, None] * slope[..., None, :]
        residual = self.forces - forces_of_many(values, self.inputs, self.wheel, self.model)
        missing = ~np.isfinite(self.forces)
        covariance[:, missing[:, :, None] | missing[:, None, :]] = 0.0
        covariance[..., range(3), range(3)] += missing
        good = np.isfinite(covariance).all(axis=(1, 2, 3))
        covariance[~good] = np.eye(3)
        white = np.linalg.solve(np.linalg.cholesky(covariance), np.where(missing, 0.0, residual)[..., None])[..., 0]
        white[~good] = np.nan
        return np.asarray(white)


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
    inside = (states.values[:, 0] > LEAST_SINKAGE_M) & (states.values[:, 0] < wheel.radius_m * DEEPEST)
    inside &= np.abs(states.values[:, 1]) < LARGEST_SLIP
    usable = np.asarray(known[:, :2].all(axis=1) & known[:, 3:].any(axis=1) & inside, dtype=np.bool_)
    if not usable.any():
        raise ParameterError("no state has a sinkage, a slip ratio and a force in range; the joint inference needs all")
    if not usable.all():
        text = (
            f"{(~usable).sum()} of {len(usable)} states lack a sinkage, slip ratio or force in range and are left out"
        )
        warnings.warn(text, LunarSciWarning, stacklevel=2)
    problem = _problem(states, usable, wheel, laws, model, model_error)
    names = [name for name, good in zip(states.id, usable, strict=True) if good]
    kept, point, covariance = _without_outliers(problem)
    residual = problem.forces - problem.at(point)
    white = problem.white(point[None])[0]
    drawn, effective = _drawn(_of(problem, kept), point, covariance, draws, np.random.default_rng(seed), sample)
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


def _without_outliers(problem: _Problem) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """Which states are kept, the mode and its covariance."""
    kept = np.ones(len(problem.inputs), dtype=bool)
    point = problem.center
    while True:
        part = _of(problem, kept)
        point, covariance = _mode(part, point)
        white = problem.white(point[None])[0]
        measured = np.isfinite(problem.forces).sum(axis=1)
        limit = chi2.isf(OUTLIER / len(kept), np.maximum(measured, 1))
        excess = np.where(kept, np.sum(white**2, axis=1) / limit, 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 1 or (~kept).sum() + 1 > MOST_OUTLIERS * len(kept):
            return kept, point, covariance
        kept[worst] = False


def _mode(problem: _Problem, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Levenberg-Marquardt on whitened residuals, whose errors of the inputs follow the parameters.

    Minimising them with weights held fixed would flatten the dependence on sinkage, itself measured with error.
    """
    width, center = problem.width, problem.center

    def white(at: FloatArray) -> FloatArray:
        return np.concatenate([problem.white(at[None])[0].ravel(), (at - center) / width])

    point, damping = start.copy(), 1e-3
    rows = white(point)
    if not np.isfinite(rows).all():
        raise ParameterError("the model has no finite forces at the centre of the priors; check states and priors")
    curvature = np.diag(width**-2)
    for _ in range(STEPS):
        columns = [(white(point + step) - white(point - step)) / (2 * STEP) for step in np.diag(STEP * width)]
        scaled = np.stack(columns, axis=-1) / width
        curvature = scaled.T @ scaled
        slope = -scaled.T @ rows
        before = float(rows @ rows)
        while damping < HIGHEST_DAMPING:
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope)
            trial = white(point + np.clip(step, -LONGEST * width, LONGEST * width))
            if float(trial @ trial) < before:
                break
            damping *= 10
        else:
            break
        point, rows = point + np.clip(step, -LONGEST * width, LONGEST * width), trial
        damping = max(damping / 5, 1e-12)
        if before - float(rows @ rows) < CONVERGED:
            break
    return point, np.asarray(np.linalg.inv(curvature), dtype=np.float64)


def _drawn(
    problem: _Problem,
    point: FloatArray,
    covariance: FloatArray,
    draws: int,
    rng: np.random.Generator,
    sample: bool,
) -> tuple[FloatArray, float | None]:
    """Transformed parameters, (draws, 8), and the effective number of those weighted."""
    factor = np.linalg.cholesky(covariance)
    if not sample:
        return point + rng.standard_normal((draws, len(point))) @ factor.T, None
    scale = np.sqrt(HEAVY_TAIL / rng.chisquare(HEAVY_TAIL, PROPOSED * draws))
    standard = rng.standard_normal((PROPOSED * draws, len(point))) * scale[:, None]
    points = point + standard @ factor.T
    ln_proposal = -0.5 * (HEAVY_TAIL + len(point)) * np.log1p(np.sum(standard**2, axis=1) / HEAVY_TAIL)
    misfit = np.concatenate(
        [np.sum(problem.white(points[k : k + CHUNK]) ** 2, axis=(1, 2)) for k in range(0, len(points), CHUNK)]
    )
    away = np.sum(((points - problem.center) / problem.width) ** 2, axis=1)
    ln_weight = np.where(np.isfinite(misfit), -0.5 * (misfit + away) - ln_proposal, -np.inf)
    weight = np.exp(ln_weight - ln_weight.max())
    weight /= weight.sum()
    effective = float(1 / np.sum(weight**2))
    if effective < LEAST_EFFECTIVE:
        raise ParameterError(
            f"only {effective:.0f} of {len(points)} draws count: the posterior is far from normal; use more states or "
            "narrower priors, or leave the sampling out"
        )
    return points[rng.choice(len(points), draws, p=weight)], effective
