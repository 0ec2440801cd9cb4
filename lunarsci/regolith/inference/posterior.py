"""All soil parameters from many wheel states at once: the posterior, what the data determine, and outliers.

F_N, F_DP and F_L of every state are compared with the model at the measured sinkage, slip and side slip. The errors of
those three reach the forces through the model's derivatives and make the residuals of one state correlated. The
posterior is normal around the mode in transformed parameters (Laplace), profiled, or sampled without an approximation:
a population is carried from the prior to the data (`tempering`), moved by random walks as wide as itself.

How far the model itself misses the forces is found from what the fit leaves over, unless it is given, and a verdict
says whether a soil of the model explains the states at all.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtri

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError, warn
from lunarsci.ranges import check_each, refuse
from lunarsci.regolith.belief import CLOSED, CONTACT_ANGLES, FitVerdict, SoilBelief, verdict_line
from lunarsci.regolith.columns import FORCES
from lunarsci.regolith.inference.mode import (
    GROSS_ERRORS,
    ROUGH,
    Mode,
    find_mode,
    mode_with_errors,
    mode_without_outliers,
    profile_limits,
)
from lunarsci.regolith.inference.problem import (
    HUBER,
    LEAST_SHARE,
    MOST_STATES,
    TYPICAL,
    JointProblem,
    Lesson,
    error_covariance,
    part_of,
    problem_of,
    tail_of,
)
from lunarsci.regolith.prior import (
    CONTACT,
    DETERMINED,
    PARAMETERS,
    SIGNIFICANCE,
    UNITS,
    Law,
    contact_prior,
    default_prior,
    strange,
    values_of,
)
from lunarsci.regolith.states import COLUMNS, LEAST_SINKAGE_M, WheelStates
from lunarsci.regolith.traction import DEEPEST
from lunarsci.regolith.wheel import ContactModel, Wheel
from lunarsci.tempering import ACCEPTED, WALK, Moves, carry

RANGES = {
    "model_error": "[0, 1)",
    "draws": "[100, inf)",
}
"""Of what `infer_soil` may be given."""
LEVELS = (0.15865, 0.84135, 0.025, 0.975)
"""Of the 68 % and the 95 % interval."""
PARTICLES = 1000
"""Points of a population, at most."""
AT_A_STEP, AT_THE_LAST = Moves(3, 20, 0.8), Moves(3, 60, 0.2)
"""When points have moved enough; what correlation is left is reported with the answer; assumed."""
SMALLEST = 1e-6
"""Width of a walk where the population has none, in widths of the prior."""


@dataclass(frozen=True, slots=True, eq=False)
class SoilPosterior:
    """What the states say of the soil.

    Attributes
    ----------
    mode : (p,) of the transformed parameters, in the order of `names`: those of `PARAMETERS`, and of `CONTACT` where
        the contact was unknown too.
    covariance : (p, p) of these: of the draws where they are sampled, else of the normal approximation.
    draws : (d, p) parameters in their units, from the posterior.
    prior : law of each parameter, by name.
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
        """By parameter, 1 - posterior over prior standard deviation: 0 learned nothing, 1 everything. [-]

        Of a profile half the width of the 68 % interval stands for the posterior's deviation.
        """
        spread = self.sd
        if self.profiled is not None:
            low, high = (
                np.array([float(self.prior[name].transformed(end[k])) for k, name in enumerate(self.names)])
                for end in self.profiled[:2]
            )
            spread = 0.5 * (high - low)
        widths = [self.prior[name].width for name in self.names]
        return {name: float(1 - sd / width) for name, sd, width in zip(self.names, spread, widths, strict=True)}

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters whose standard deviation fell below half that of the prior, and that no other law disputes."""
        gained = self.shrinkage.items()
        return tuple(name for name, share in gained if share > 1 - DETERMINED and name not in self.disputed)

    def intervals(self) -> dict[str, tuple[float, float, float, float, float]]:
        """Median (of a profile the mode), 68 % and 95 % limits of each parameter, in its unit."""
        if self.profiled is not None:
            ends = np.vstack([values_of(self.prior, self.mode), self.profiled])
        else:
            ends = np.quantile(self.draws, (0.5, *LEVELS), axis=0)
        return {name: tuple(map(float, ends[:, k])) for k, name in enumerate(self.names)}  # type: ignore[misc]

    def rows(self) -> list[dict[str, Any]]:
        """One row a parameter, in its unit: median, 68 % and 95 % intervals, the prior's, what the states add."""
        keys = ("median", "low68", "high68", "low95", "high95")
        before = np.array([0.0, *map(float, ndtri(LEVELS))])
        rows = []
        for name, ends in self.intervals().items():
            law = self.prior[name]
            prior = map(float, law.back(law.center + law.width * before))
            rows.append(
                {"parameter": name, "unit": UNITS[name]}
                | dict(zip(keys, ends, strict=True))
                | {f"prior_{key}": value for key, value in zip(keys, prior, strict=True)}
                | {"shrinkage": self.shrinkage[name], "determined": name in self.determined}
            )
        return rows

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
        center = self.mode[:size]
        if self.how == "sample":
            center = np.array([laws[name].transformed(self.draws[:, k]).mean() for k, name in enumerate(PARAMETERS)])
        return SoilBelief(laws, center, 0.5 * (covariance + covariance.T), verdict=self.verdict)


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
    contact : the parameters of `CONTACT` are unknown too, by the exact integrals where no model is given.
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
    refuse(f"no prior for {name}; give every parameter one" for name in PARAMETERS if name not in laws)
    check_each("", {"model_error": model_error, "draws": draws}, RANGES)
    model = ContactModel() if contact and model is None else model
    usable = usable_states(states, wheel)
    best = fit_soil(states, usable, wheel, laws, model, contact, model_error)
    fitted, point = best.fitted, best.point
    part = part_of(fitted, best.inliers)
    profiled = None
    if profile:
        start = point if best.alike == 1 else find_mode(part, point)[0]
        profiled = profile_limits(part, start, best.covariance, progress)
    rng, autocorrelation, covariance = np.random.default_rng(seed), None, best.covariance
    if sample:
        drawn, autocorrelation = carry_population(
            part.ln_likelihood, fitted.center, fitted.width, min(draws, PARTICLES), rng, progress
        )
        covariance = np.cov(drawn.T)
    else:
        drawn = point + rng.standard_normal((draws, len(point))) @ np.linalg.cholesky(best.covariance).T
    white = best.problem.white(point[None])[0][best.inliers]
    measured = np.isfinite(fitted.forces[best.inliers])
    return SoilPosterior(
        point,
        covariance,
        values_of(laws, drawn),
        laws,
        tuple(np.array(states.id)[usable][~best.inliers].tolist()),
        fitted.forces - fitted.at(point),
        float(np.sum(white**2)),
        int(measured.sum()),
        model,
        judge(best, law_name(model, contact), model_error is not None, states, float(np.mean(~usable))),
        tail_of(white[measured]),
        autocorrelation,
        profiled,
        lesson=Lesson(wheel, best.problem.inputs[best.inliers], fitted.forces[best.inliers]),
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
    measured, depth = np.isfinite(states.values), states.values[:, 0]
    inside = (depth > LEAST_SINKAGE_M) & (depth < wheel.radius_m * DEEPEST)
    inside &= ~((states.values[:, 1] == 1) & (np.abs(states.values[:, 2]) == 90))
    usable = np.asarray(measured[:, :2].all(axis=1) & measured[:, 3:].any(axis=1) & inside, dtype=np.bool_)
    needed = "no state has a sinkage, a slip ratio and a force in range; the joint inference needs all"
    refuse({needed: not usable.any()})
    if not usable.all():
        lost = f"{(~usable).sum()} of {len(usable)}"
        warn(f"{lost} states lack a sinkage, slip ratio or force in range and are left out")
    return usable


def law_name(model: ContactModel | None, contact: bool) -> str:
    """How a wheel-soil law is called: `closed`, or the shear law of the integrals and what goes beyond it."""
    if model is None:
        return CLOSED
    more = [] if model.bulldozing == "none" else [f"bulldozing {model.bulldozing}"]
    return " + ".join([model.shear, *more, *([CONTACT_ANGLES] if contact else [])])


class _Walkers:
    """A population of `tempering` under a normal prior of independent coordinates.

    `points` (particles, p) and their `ln_likelihood` (particles,), minus infinite where a point is impossible, are what
    `carry` reads; arguments as of `carry_population`.
    """

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
        """Take the `chosen` points (particles,), and the covariance of all by their weights (particles,) for walks."""
        covariance = np.cov(self.points.T, aweights=weight, ddof=0)
        covariance += np.diag((SMALLEST * self._width) ** 2)
        self._factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        self.points, self.ln_likelihood = self.points[chosen], self.ln_likelihood[chosen]

    def move(self, beta: float) -> None:
        """One Metropolis step of each point, towards prior x likelihood^beta; walks widen as more are accepted."""
        trial = self.points + self._scale * self._random.standard_normal(self.points.shape) @ self._factor.T
        there = self._possible(trial)
        gain = beta * (there - self.ln_likelihood) + self._ln_prior(trial) - self._ln_prior(self.points)
        accepted = np.log(self._random.random(len(trial))) < gain
        self.points = np.where(accepted[:, None], trial, self.points)
        self.ln_likelihood = np.where(accepted, there, self.ln_likelihood)
        self._scale *= np.exp(accepted.mean() - ACCEPTED)

    def _possible(self, points: FloatArray) -> FloatArray:
        """ln likelihood of points, minus infinite for impossible ones. (particles,)"""
        return np.nan_to_num(self._of(points), nan=-np.inf)

    def _ln_prior(self, points: FloatArray) -> FloatArray:
        """ln of the prior at points, up to a constant. (particles,)"""
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


CEILINGS = (0.35, 0.15, 0.15)
"""Share of the load by which the law may miss F_N, F_DP, F_L before no soil of it counts as an explanation. Measured:
up to 0.28 of normal forces and 0.08 of pulls of five wheels (`tests/benchmarks/wheels.py`). A pull that errs by 0.15 is
a slope of 8.5 deg; a normal force at a measured sinkage errs most, as it goes with a power of it: 0.35 of the load is a
fifth of the sinkage."""
REDUCED = (0.5, 2.0)
"""Range of a reduced chi-square that agrees with the errors stated; few forces scatter more widely than that by chance.
Assumed."""
DECISIVE = -2.0 * math.log(SIGNIFICANCE)
"""By how much -2 ln posterior must be better for another reading of a column to count."""
SHIFTS = (-0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2)
"""Where the search for another zero of the sinkage begins, as shares of the wheel's radius."""
NEVER = 1e12
"""Stands for -2 ln posterior of what cannot be; any larger number does as well."""
FORCE_WORDS = ("normal force", "drawbar pull", "lateral force")
"""F_N, F_DP, F_L in words."""
OTHER_SIGNS: tuple[tuple[str, float, str], ...] = (
    ("slip_ratio", -1.0, "its sign turned (--units slip_ratio=-1): positive is a rim faster than the wheel travels"),
    ("drawbar_pull_n", -1.0, "its sign turned (--units drawbar_pull_n=-1): a pull forward is positive"),
    ("lateral_force_n", -1.0, "its sign, or that of side_slip_deg, turned (--units lateral_force_n=-1)"),
    ("side_slip_deg", math.degrees(1.0), "degrees in place of radians"),
)
"""Other readings of a column: its name, the factor to its values, and how it is read then, in words."""
OTHER_UNITS: tuple[tuple[str, float, str], ...] = (
    *((name, factor, f"newtons in place of {unit}") for name in COLUMNS[3:] for factor, unit in (
        (FORCES["kgf"], "kilograms"), (FORCES["lbf"], "pounds"), (1e-3, "millinewtons"))),
    ("slip_ratio", 0.01, "a share in place of per cent"),
)  # fmt: skip
"""The same of other units, tried where the law misses the states by more than it may."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A column that would explain the states better if read otherwise.

    Attributes
    ----------
    column : its name.
    how : it is read then, in words.
    gain : by which -2 ln posterior is lower then.
    """

    column: str
    how: str
    gain: float


def suspects(mode: Mode, units: bool = False) -> list[Suspect]:
    """Columns whose sign, or with `units` unit, the states contradict, worst first.

    All states, or 50 of them spread evenly, are fitted anew as they are and with each column read otherwise, with the
    same errors; residuals beyond `HUBER` count linearly, so that no few states decide. With `units`, as of states that
    the law misses by more than it may, the other reading must bring that to an end.
    """
    plain = _some(mode)
    before = _best(plain, mode.point)
    suspected: list[Suspect] = []
    for column, factor, how in (*OTHER_SIGNS, *(OTHER_UNITS if units else ())):
        other = _read_otherwise(plain, column, factor)
        if other is None:
            continue
        gain = before - _best(other, plain.center) + _stretch(plain, column, factor)
        if gain > DECISIVE and not (units and _above(mode_with_errors(replace(other, huber=np.inf)))):
            suspected.append(Suspect(column, how, gain))
    return sorted(suspected, key=lambda suspect: -suspect.gain)


def _some(mode: Mode) -> JointProblem:
    """All states, or as many of them as are tried with other readings."""
    some = np.unique(np.linspace(0, len(mode.inliers) - 1, MOST_STATES // 4).astype(int))
    return replace(part_of(mode.problem, some), huber=HUBER)


def other_zero(mode: Mode) -> list[Suspect]:
    """The zero of the sinkage that explains the states better, if one does, as `suspects` compares."""
    from scipy.optimize import minimize_scalar

    plain, radius = _some(mode), mode.problem.wheel.radius_m

    def worse(share: float) -> float:
        inputs = plain.inputs + np.array([share * radius, 0.0, 0.0])
        possible = ((inputs[:, 0] > 0) & (inputs[:, 0] < radius)).all()
        return min(_best(replace(plain, inputs=inputs), plain.center), NEVER) if possible else NEVER

    before, (worst, first) = _best(plain, mode.point), min((worse(share), share) for share in SHIFTS)
    if not before - worst > DECISIVE:
        return []
    span = 0.5 * abs(first)
    least = minimize_scalar(worse, bounds=(first - span, first + span), method="bounded", options={"maxiter": 12})
    bent = worse(least.x + span / 2) + worse(least.x - span / 2) - 2 * least.fun
    by, sigma = least.x * radius, radius * span * math.sqrt(0.5 / max(bent, 0.5))
    where = f"{abs(1e3 * by):.2g} ± {1e3 * sigma:.1g} mm {'higher' if by > 0 else 'lower'}"
    return [Suspect("sinkage_m", f"its zero {where} (--units sinkage_m={by:+.4f})", before - float(least.fun))]


def _best(problem: JointProblem, start: FloatArray) -> float:
    """-2 ln posterior at its mode, from a start, with the determinant of the errors; infinite where there is none."""
    try:
        best = find_mode(problem, start, tolerance=ROUGH)[0]
        slopes = problem.residuals_and_slopes(best[None])[1][0]
        covariance = error_covariance(problem, slopes, np.array(problem.model_error))
        return problem.objective(best) + float(np.linalg.slogdet(covariance)[1].sum())
    except (ParameterError, np.linalg.LinAlgError):
        return math.inf


def _stretch(problem: JointProblem, column: str, factor: float) -> float:
    """What -2 ln of a density of measured forces owes to their unit, where a column is multiplied by a factor."""
    measured = int(np.isfinite(problem.forces[:, COLUMNS.index(column) % 3]).sum())
    return 2 * measured * math.log(abs(factor)) if column in COLUMNS[3:] else 0.0


def _read_otherwise(problem: JointProblem, column: str, factor: float) -> JointProblem | None:
    """The problem with a column times a factor; None where no wheel could have such states, or nothing changes."""
    k = COLUMNS.index(column)
    name, errors = ("inputs", "input_sigma") if k < 3 else ("forces", "force_sigma")
    values, sigmas = getattr(problem, name).copy(), getattr(problem, errors).copy()
    values[:, k % 3] *= factor
    sigmas[:, k % 3] *= abs(factor)
    if not np.nan_to_num(values[:, k % 3]).any():
        return None
    if k < 3 and not (
        (np.abs(values[:, 1]) <= 1).all()
        and (np.abs(values[:, 2]) <= 90).all()
        and (values[:, 0] < problem.wheel.radius_m).all()
    ):
        return None
    return replace(problem, **{name: values, errors: sigmas})


def chi_square(mode: Mode, problem: JointProblem) -> tuple[float, float]:
    """Chi-square of the inliers, and their forces less what the fit used up."""
    white = problem.white(mode.point[None])[0][mode.inliers]
    return float(np.sum(white**2)), float(np.isfinite(problem.forces[mode.inliers]).sum() - mode.freedom)


def judge(mode: Mode, model: str, given: bool, states: WheelStates, unusable: float) -> FitVerdict:
    """The verdict of a fit.

    Parameters
    ----------
    model : the law's name.
    given : whether the model error was given, not found from the residuals.
    states : those that were fitted.
    unusable : share of all states that could not be used at all.
    """
    shares, (total, left) = mode.problem.model_error, chi_square(mode, mode.problem)
    reduced = total / left if left >= 1 else None
    reasons = [*map(str, states.questions), *_misfit(mode, reduced, left, given, states)]
    if not given and (missed := _above(mode)):
        listed = ", ".join(f"the {FORCE_WORDS[k]} by {shares[k]:.2f} (at most {CEILINGS[k]:g})" for k in missed)
        reasons.append(f"no soil of the model explains the states: it misses, as a share of the load, {listed}")
    if (outliers := float(np.mean(~mode.inliers))) > GROSS_ERRORS:
        reasons.append(f"{100 * outliers:.0f} % of the states are outliers")
    if unusable > 0.5:
        reasons.append(f"{100 * unusable:.0f} % of the states cannot be used")
    laws = {name: mode.problem.prior[name] for name in mode.problem.names}
    reasons += strange(laws, mode.point, np.sqrt(np.diag(mode.covariance)))
    likely = left < 1 or total <= max(float(chdtri(left, SIGNIFICANCE)), left)
    good = max(shares) <= TYPICAL and likely
    # A law that fits as well as laws do leaves nothing for another reading of a column to explain.
    explained = bool(states.questions) or (good and not outliers and not reasons)
    turned = [] if explained else suspects(mode, units=bool(reasons))
    zero = [] if explained or states.alike else other_zero(mode)
    # Five published tests of real wheels agree better with another zero, too: alone it makes no doubt.
    turned = sorted([*turned, *(zero if reasons else ())], key=lambda suspect: -suspect.gain)
    if turned:
        first = turned[0]
        reasons.insert(0, f"column {first.column} agrees with the others only with {first.how}")
    elif reasons:
        reasons.append("look at the signs and units of slip_ratio, side_slip_deg, drawbar_pull_n and lateral_force_n, "
                       "at the wheel (`rover`) and at the law of wheel and soil (`law`)")  # fmt: skip
    text = "the zero of {} as it is written, where the forces would agree better with {}"
    return FitVerdict(
        trusted=not reasons,
        reason="; ".join(reasons),
        model=model,
        model_error=shares,
        model_error_from="given" if given else "residuals",
        reduced_chi_square=reduced,
        assumed=(*_assumed(mode, given, states, total, left), *(text.format(one.column, one.how) for one in zero)),
    )


def _misfit(mode: Mode, reduced: float | None, left: float, given: bool, states: WheelStates) -> list[str]:
    """Why the scatter of the forces is that of other errors.

    Neither errors taken because the file has none nor a model error that was found are the user's to answer for.
    """
    unstated, problem = [COLUMNS.index(name) for name in states.unstated], mode.problem
    errors, forces = problem.input_sigma.copy(), problem.forces.copy()
    errors[:, [k for k in unstated if k < 3]] = 0.0
    forces[:, [k - 3 for k in unstated if k > 2]] = np.nan
    shares = problem.model_error if given else (LEAST_SHARE,) * 3
    total, degrees = chi_square(mode, replace(problem, input_sigma=errors, forces=forces, model_error=shares))
    if states.stated and not states.alike and degrees >= 1 and total < (low := least_chi_square(degrees)):
        return [
            f"reduced chi-square {total / degrees:.2g} of the stated errors alone is below {low / degrees:.2g}: "
            "they are too large for these states"
        ]
    if reduced is None or reduced <= max(REDUCED[1], float(chdtri(left, SIGNIFICANCE)) / left):
        return []
    after = "model error " + ", ".join(f"{share:.3g}" for share in dict.fromkeys(problem.model_error))
    return [f"no soil of the model explains the states: reduced chi-square {reduced:.3g} after a {after} of the load"]


def least_chi_square(left: float) -> float:
    """Below which errors are too large for what so many degrees of freedom are left over."""
    return min(REDUCED[0] * left, float(chdtri(left, 1 - SIGNIFICANCE)))


def _above(mode: Mode) -> list[int]:
    """Which of the forces that were measured the law misses by more than it may."""
    measured, shares = np.isfinite(mode.problem.forces), mode.problem.model_error
    return [k for k in range(3) if shares[k] > CEILINGS[k] and measured[:, k].any()]


def _assumed(mode: Mode, given: bool, states: WheelStates, total: float, left: float) -> list[str]:
    """What the fit had to assume, in sentences."""
    plain, problem = left >= 1, mode.problem
    model = problem.model or ContactModel()
    texts = {
        "priors that come with lunarsci where none are given": True,
        "errors of measurement as Ding et al. (2024) state them, where the file gives none": not states.stated,
        f"normal errors of the model, a share of the load; {mode.alike:.1f} neighbouring states "
        "count as one independent state": not given,
        f"errors that the states do not show (reduced chi-square {total / max(left, 1.0):.2g}), "
        "so intervals are wide": plain and total < least_chi_square(left),
        "contact angles of the wheel as known: where they are others, K_s, N and K_x are, too": not problem.contact,
        "that the law holds: there are no more forces than parameters to test it": not plain,
        f"soil of {model.density_kg_m3:g} kg/m3 under {model.gravity_m_s2:g} m/s2 beside the wheel":
            model.bulldozing != "none",
        "nothing of lateral forces, which were not measured": not np.isfinite(problem.forces[:, 2]).any(),
    }  # fmt: skip
    return [text for text, holds in texts.items() if holds]
