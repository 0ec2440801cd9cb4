"""All soil parameters from many wheel states at once: the posterior, what the data determine, and outliers.

F_N, F_DP and F_L of every state are compared with the model at the measured sinkage, slip and side slip. The errors of
those three reach the forces through the model's derivatives and make the residuals of one state correlated. The
posterior is normal around the mode in transformed parameters (Laplace), profiled, or sampled without an approximation:
a population is carried from the prior to the data (`tempering`), moved by random walks as wide as itself.

How far the model itself misses the forces is found from what the fit leaves over, unless it is given, and a verdict
says whether a soil of the model explains the states at all.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.regolith.belief import CLOSED, CONTACT_ANGLES, FitVerdict, SoilBelief, verdict_line
from lunarsci.regolith.inference.misfit import Lesson
from lunarsci.regolith.inference.mode import (
    Mode,
    find_mode,
    mode_with_errors,
    mode_without_outliers,
    profile_limits,
)
from lunarsci.regolith.inference.problem import part_of, problem_of, tail_of
from lunarsci.regolith.inference.verdict import judge
from lunarsci.regolith.prior import CONTACT, DETERMINED, PARAMETERS, UNITS, Law, contact_prior, default_prior, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import ContactModel, Wheel
from lunarsci.tempering import ACCEPTED, WALK, Moves, carry

LEAST_SINKAGE_M, DEEPEST = 1e-5, 0.95
"""States beyond are left out: sinkage, as a share of the radius the deepest. Assumed."""
LEVELS = (0.15865, 0.84135, 0.025, 0.975)
"""Of the 68 % and the 95 % interval."""
PARTICLES = 1000
"""Points of a population, at most."""
AT_A_STEP, AT_THE_LAST = Moves(3, 20, 0.8), Moves(3, 60, 0.2)
"""When points have moved enough; assumed."""
TUNING = 1.0
"""How much the logarithm of a walk's width follows the share of accepted steps, at each; assumed."""
SMALLEST = 1e-6
"""Width of a walk where the population has none, in widths of the prior."""


@dataclass(frozen=True, slots=True, eq=False)
class SoilPosterior:
    """What the states say of the soil.

    Attributes
    ----------
    mode : (p,) of the transformed parameters, in the order of `names`: those of `PARAMETERS`, and of `CONTACT` where
        the contact was unknown too.
    covariance : (p, p) of these.
    draws : (d, p) parameters in their units, from the posterior.
    outliers : ids of states left out.
    residuals : (n, 3) measured less model, F_N, F_DP, F_L, NaN where not measured. [N]
    chi_square, degrees : of the states kept, and their number of forces.
    model : choices of the exact integrals; None for the closed form.
    verdict : whether a soil of the model explains the states, and the model's error.
    tail : degrees of freedom of the Student law that the residuals follow.
    autocorrelation : of sampled draws, the largest correlation left with where they were before their last moves; None
        for the normal approximation.
    profiled : (4, p) 68 % and 95 % limits by profile, None where they were not asked for.
    disputed : parameters of which another law that predicts as well finds another value.
    lesson : the states kept; None where they are not known.
    """

    mode: FloatArray
    covariance: FloatArray
    draws: FloatArray = field(repr=False)
    prior: Mapping[str, Law]
    outliers: tuple[str, ...]
    residuals: FloatArray = field(repr=False)
    chi_square: float
    degrees: int
    model: ContactModel | None
    verdict: FitVerdict
    tail: float
    autocorrelation: float | None = None
    profiled: FloatArray | None = field(default=None, repr=False)
    disputed: tuple[str, ...] = ()
    lesson: Lesson | None = field(default=None, repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, in their order."""
        return (*PARAMETERS, *CONTACT)[: len(self.mode)]

    @property
    def how(self) -> str:
        """Where the intervals come from: `normal`, `sample` or `profile`."""
        if self.profiled is not None:
            return "profile"
        return "normal" if self.autocorrelation is None else "sample"

    @property
    def sd(self) -> FloatArray:
        """Standard deviations of the transformed parameters."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shrinkage(self) -> dict[str, float]:
        """By parameter, 1 - posterior over prior standard deviation: 0 learned nothing, 1 everything. [-]"""
        widths = [self.prior[name].width for name in self.names]
        return {name: float(1 - sd / width) for name, sd, width in zip(self.names, self.sd, widths, strict=True)}

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters whose standard deviation fell below half that of the prior, and that no other law disputes."""
        found = self.shrinkage.items()
        return tuple(name for name, value in found if value > 1 - DETERMINED and name not in self.disputed)

    def intervals(self) -> dict[str, tuple[float, float, float, float, float]]:
        """Median (of a profile the mode), 68 % and 95 % limits of each parameter, in its unit."""
        if self.profiled is not None:
            ends = np.vstack([values_of(self.prior, self.mode), self.profiled])
        else:
            ends = np.quantile(self.draws, (0.5, *LEVELS), axis=0)
        return {name: tuple(map(float, ends[:, k])) for k, name in enumerate(self.names)}  # type: ignore[misc]

    def rows(self) -> list[dict[str, Any]]:
        """One row a parameter, in its unit: median, 68 % and 95 % intervals, the prior's, what the states add."""
        from scipy.special import ndtri

        keys = ("median", "low68", "high68", "low95", "high95")
        before = np.array([0.0, *map(float, ndtri(LEVELS))])
        found = []
        for name, ends in self.intervals().items():
            law = self.prior[name]
            prior = map(float, law.back(law.center + law.width * before))
            found.append(
                {"parameter": name, "unit": UNITS[name]}
                | dict(zip(keys, ends, strict=True))
                | {f"prior_{key}": value for key, value in zip(keys, prior, strict=True)}
                | {"shrinkage": self.shrinkage[name], "determined": name in self.determined}
            )
        return found

    def combinations(self) -> list[tuple[float, dict[str, float]]]:
        """Directions in prior-scaled parameters and the share of the prior deviation left in each, best known first."""
        widths = np.array([self.prior[name].width for name in self.names])
        sizes, directions = np.linalg.eigh(self.covariance / np.outer(widths, widths))
        return [
            (float(np.sqrt(max(size, 0.0))), dict(zip(self.names, map(float, column), strict=True)))
            for size, column in zip(sizes, directions.T, strict=True)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain values: parameters with their intervals, correlation, combinations, how well the law fits."""
        ends, correlation = self.intervals(), self.covariance / self.sd[:, None] / self.sd
        records = {
            name: dict(zip(("median", "low", "high", "low95", "high95"), ends[name], strict=True))
            | {
                "prior": {"of": self.prior[name].of, "median": self.prior[name].median, "sd": self.prior[name].sd},
                "shrinkage": self.shrinkage[name],
                "determined": name in self.determined,
            }
            for name in self.names
        }
        return {
            "parameters": {name: records[name] for name in PARAMETERS},
            "contact": {name: records[name] for name in CONTACT} if len(records) > len(PARAMETERS) else None,
            "order": list(self.names),
            "correlation": correlation.tolist(),
            "combinations": [{"left_of_prior": left, "weights": weights} for left, weights in self.combinations()],
            "disputed": list(self.disputed),
            "outliers": list(self.outliers),
            "chi_square": self.chi_square,
            "degrees": self.degrees,
            "persistence": self.autocorrelation,
            "intervals": self.how,
            "verdict": self.verdict.to_dict(),
            "tail": self.tail,
        }

    def draws_csv(self) -> str:
        """Draws of the soil's parameters as CSV, with the verdict in the first line."""
        lines = [",".join(map(repr, map(float, row[: len(PARAMETERS)]))) for row in self.draws]
        return verdict_line(self.verdict) + "\n".join([",".join(PARAMETERS), *lines]) + "\n"

    def belief(self) -> SoilBelief:
        """What is believed of the soil after its states, with the verdict; of an unknown contact nothing is kept."""
        size = len(PARAMETERS)
        covariance = self.covariance[:size, :size]
        laws = {name: self.prior[name] for name in PARAMETERS}
        return SoilBelief(laws, self.mode[:size], 0.5 * (covariance + covariance.T), verdict=self.verdict)


def infer_soil(
    states: WheelStates,
    wheel: Wheel,
    prior: Mapping[str, Law] | None = None,
    *,
    model: ContactModel | None = None,
    contact: bool = False,
    model_error: float | None = None,
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
    prior : law of every parameter in `PARAMETERS`; `default_prior()`. Of `CONTACT` too, else `contact_prior()`.
    model : the exact integrals with these choices; None for the closed form.
    contact : the parameters of `CONTACT` are unknown too; needs a model.
    model_error : share of the load by which the model misses each force, 0 or more; None finds it, for each of the
        forces, from what the fit leaves over. [-]
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
    laws = {**(contact_prior() if contact else {}), **(prior or default_prior())}
    _check(laws, model_error, draws, contact and model is None)
    usable = usable_states(states, wheel)
    found = fit_soil(states, usable, wheel, laws, model, contact, model_error)
    fitted, point = found.fitted, found.point
    part = part_of(fitted, found.kept)
    profiled = None
    if profile:
        start = point if found.alike == 1 else find_mode(part, point)[0]
        profiled = profile_limits(part, start, found.covariance, progress)
    rng, autocorrelation = np.random.default_rng(seed), None
    if sample:
        drawn, autocorrelation = carry_population(
            part.ln_likelihood, fitted.center, fitted.width, min(draws, PARTICLES), rng, progress
        )
    else:
        drawn = point + rng.standard_normal((draws, len(point))) @ np.linalg.cholesky(found.covariance).T
    names = [name for name, good in zip(states.id, usable, strict=True) if good]
    white = found.problem.white(point[None])[0][found.kept]
    measured = np.isfinite(fitted.forces[found.kept])
    return SoilPosterior(
        point,
        found.covariance,
        values_of(laws, drawn),
        laws,
        tuple(name for name, good in zip(names, found.kept, strict=True) if not good),
        fitted.forces - fitted.at(point),
        float(np.sum(white**2)),
        int(measured.sum()),
        model,
        judge(found, law_name(model, contact), model_error is not None, states, float(np.mean(~usable))),
        tail_of(white[measured]),
        autocorrelation,
        profiled,
        lesson=Lesson(wheel, found.problem.inputs[found.kept], fitted.forces[found.kept]),
    )


def fit_soil(
    states: WheelStates,
    usable: BoolArray,
    wheel: Wheel,
    laws: Mapping[str, Law],
    model: ContactModel | None,
    contact: bool,
    model_error: float | None,
) -> Mode:
    """The mode of the posterior, with the model's errors; arguments as of `infer_soil`."""
    problem = problem_of(states, usable, wheel, laws, model, (model_error or 0.0,) * 3, contact)
    return mode_with_errors(problem) if model_error is None else mode_without_outliers(problem)


def usable_states(states: WheelStates, wheel: Wheel) -> BoolArray:
    """States with a slip and a force whose sinkage the model can describe. (n,) Warns where some are not.

    Raises ParameterError where none is.
    """
    known = np.isfinite(states.values)
    inside = (states.values[:, 0] > LEAST_SINKAGE_M) & (states.values[:, 0] < wheel.radius_m * DEEPEST)
    inside &= ~((states.values[:, 1] == 1) & (np.abs(states.values[:, 2]) == 90))
    usable = np.asarray(known[:, :2].all(axis=1) & known[:, 3:].any(axis=1) & inside, dtype=np.bool_)
    if not usable.any():
        raise ParameterError("no state has a sinkage, a slip ratio and a force in range; the joint inference needs all")
    if not usable.all():
        text = (
            f"{(~usable).sum()} of {len(usable)} states lack a sinkage, slip ratio or force in range and are left out"
        )
        warnings.warn(text, LunarSciWarning, stacklevel=3)
    return usable


def law_name(model: ContactModel | None, contact: bool) -> str:
    """How a wheel-soil law is called: `closed`, or the shear law of the integrals and what goes beyond it."""
    if model is None:
        return CLOSED
    more = [] if model.bulldozing == "none" else [f"bulldozing {model.bulldozing}"]
    return " + ".join([model.shear, *more, *([CONTACT_ANGLES] if contact else [])])


def _check(prior: Mapping[str, Law], model_error: float | None, draws: int, contact_without_model: bool) -> None:
    missing = [name for name in PARAMETERS if name not in prior]
    if missing:
        raise ParameterError(f"no prior for {', '.join(missing)}; give every parameter one")
    if model_error is not None and not 0 <= model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a share from 0 to below 1")
    if draws < 100:
        raise ParameterError(f"{draws} draws; give 100 or more")
    if contact_without_model:
        raise ParameterError("contact angles are unknown to the exact integrals only; give a model")


class _Walkers:
    """A population of `tempering` under a normal prior of independent coordinates."""

    def __init__(
        self,
        ln_likelihood: Callable[[FloatArray], FloatArray],
        center: FloatArray,
        width: FloatArray,
        particles: int,
        random: np.random.Generator,
    ) -> None:
        self._of, self._center, self._width, self._random = ln_likelihood, center, width, random
        self.points = center + width * random.standard_normal((particles, len(center)))
        self.ln_likelihood = self._possible(self.points)
        self._factor: FloatArray = np.diag(width)
        self._scale = WALK / np.sqrt(len(center))

    def resample(self, beta: float, weight: FloatArray, chosen: IntArray) -> None:
        covariance = np.cov(self.points.T, aweights=weight, ddof=0)
        covariance += np.diag((SMALLEST * self._width) ** 2)
        self._factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        self.points, self.ln_likelihood = self.points[chosen], self.ln_likelihood[chosen]

    def move(self, beta: float) -> None:
        trial = self.points + self._scale * self._random.standard_normal(self.points.shape) @ self._factor.T
        found = self._possible(trial)
        gain = beta * (found - self.ln_likelihood) + self._ln_prior(trial) - self._ln_prior(self.points)
        accepted = np.log(self._random.random(len(trial))) < gain
        self.points = np.where(accepted[:, None], trial, self.points)
        self.ln_likelihood = np.where(accepted, found, self.ln_likelihood)
        self._scale *= np.exp(TUNING * (accepted.mean() - ACCEPTED))

    def _possible(self, points: FloatArray) -> FloatArray:
        return np.nan_to_num(self._of(points), nan=-np.inf)

    def _ln_prior(self, points: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * np.sum(((points - self._center) / self._width) ** 2, axis=1))


def carry_population(
    ln_likelihood: Callable[[FloatArray], FloatArray],
    center: FloatArray,
    width: FloatArray,
    particles: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, float]:
    """Draws from a posterior with a normal prior.

    Parameters
    ----------
    ln_likelihood : of points (d, p), up to a constant; NaN or -inf where a point is impossible.
    center, width : (p,) of the prior.
    particles : how many.
    random : source of random numbers.
    progress : called with (done, total).

    Returns
    -------
    (particles, p), and the largest correlation left with where they were before the last moves. [-]
    """
    population, left = _Walkers(ln_likelihood, center, width, particles, random), 1.0
    for step in carry(population, random, AT_A_STEP, AT_THE_LAST):
        left = step.left
        if progress is not None:
            progress(round(100 * min(1.0, 1 + np.log10(max(step.beta, 1e-9)) / 9)), 100)
    return population.points, left
