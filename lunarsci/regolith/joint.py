"""All soil parameters from many wheel states at once: the posterior, what the data determine, and outliers.

F_N, F_DP and F_L of every state are compared with the model at the measured sinkage, slip and side slip. The errors of
those three reach the forces through the model's derivatives and make the residuals of one state correlated. The
posterior is normal around the mode in transformed parameters (Laplace), sampled, or profiled.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.joint_mode import mode_without_outliers, profile_limits
from lunarsci.regolith.joint_problem import part_of, problem_of
from lunarsci.regolith.joint_sampler import carry_population
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel

__all__ = ["SoilPosterior", "infer_soil"]

FloatArray = npt.NDArray[np.float64]

MODEL_ERROR = 0.02
"""Share of the load by which the model may miss each force; assumed."""
LEAST_SINKAGE_M, DEEPEST, LARGEST_SLIP = 1e-5, 0.95, 0.99
"""States beyond are left out: sinkage, as a share of the radius the deepest, and slip ratio."""
DETERMINED = 0.5
"""A parameter counts as determined where its standard deviation is below this share of the prior's."""
PARTICLES = 1000
"""Of the sampler, at most."""
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
    persistence : of sampled draws, the largest correlation left with where they were before their last moves; None for
        the normal approximation.
    profiled : (4, 8) 68 % and 95 % limits by profile, None where they were not asked for.
    """

    mode: FloatArray
    covariance: FloatArray
    draws: FloatArray = field(repr=False)
    prior: Mapping[str, Law]
    outliers: tuple[str, ...]
    residuals: FloatArray = field(repr=False)
    chi_square: float
    degrees: int
    persistence: float | None = None
    profiled: FloatArray | None = field(default=None, repr=False)

    @property
    def how(self) -> str:
        """Where the intervals come from: `normal`, `sample` or `profile`."""
        if self.profiled is not None:
            return "profile"
        return "normal" if self.persistence is None else "sample"

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
        """Median (of a profile the mode), 68 % and 95 % limits of each parameter, in its unit."""
        if self.profiled is not None:
            ends = np.vstack([values_of(self.prior, self.mode), self.profiled])
        else:
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


def infer_soil(
    states: WheelStates,
    wheel: Wheel,
    prior: Mapping[str, Law] | None = None,
    *,
    model: ContactModel | None = None,
    model_error: float = MODEL_ERROR,
    draws: int = 4000,
    sample: bool = False,
    profile: bool = False,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> SoilPosterior:
    """Posterior of the soil that all states share.

    Parameters
    ----------
    states, wheel : what was measured, and with which wheel. States need a slip ratio.
    prior : law of every parameter in `PARAMETERS`; `default_prior()`.
    model : the exact integrals with these choices; None for the closed form.
    model_error : share of the load added to the error of each force, 0 or more. [-]
    draws : from the posterior, 100 or more.
    sample : draw from the posterior itself, by a population carried from the prior to the data, instead of from the
        normal approximation; up to 1000 draws.
    profile : intervals where the best of all other parameters costs as much as one and 1.96 standard deviations of a
        normal law.
    seed : of the random numbers.
    progress : of sampling or profiles, called with (done, total).

    Raises
    ------
    ParameterError for too few draws or states, a missing prior, or a model error out of range.

    References
    ----------
    Ding et al. (2024), 10.1038/s41467-024-46233-8 (model, errors); Gelman et al. (2013), Bayesian Data Analysis, 3rd
    ed., ch. 13 (normal approximation).
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
    problem = problem_of(states, usable, wheel, laws, model, model_error)
    names = [name for name, good in zip(states.id, usable, strict=True) if good]
    kept, point, covariance = mode_without_outliers(problem)
    residual = problem.forces - problem.at(point)
    white = problem.white(point[None])[0]
    part = part_of(problem, kept)
    profiled = profile_limits(part, point, covariance, progress) if profile else None
    rng, persistence = np.random.default_rng(seed), None
    if sample:
        drawn, persistence = carry_population(
            part.ln_likelihood, problem.center, problem.width, min(draws, PARTICLES), rng, progress
        )
    else:
        drawn = point + rng.standard_normal((draws, len(point))) @ np.linalg.cholesky(covariance).T
    return SoilPosterior(
        point,
        covariance,
        values_of(laws, drawn),
        laws,
        tuple(name for name, good in zip(names, kept, strict=True) if not good),
        residual,
        float(np.sum(white[kept] ** 2)),
        int(np.isfinite(problem.forces[kept]).sum()),
        persistence,
        profiled,
    )


def _check(prior: Mapping[str, Law], model_error: float, draws: int) -> None:
    missing = [name for name in PARAMETERS if name not in prior]
    if missing:
        raise ParameterError(f"no prior for {', '.join(missing)}; give every parameter one")
    if not 0 <= model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a share from 0 to below 1")
    if draws < 100:
        raise ParameterError(f"{draws} draws; give 100 or more")
