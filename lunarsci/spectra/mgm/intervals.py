"""Intervals of fitted parameters, and of ratios: by profile, or by draws from the posterior.

A profile says how far a parameter can go, all others following, before the objective has risen too much. Draws are for
hard cases, several minima, strengths at 0, curved valleys: a population is carried from the prior to the data
(`tempering`), in which particles move by Hamiltonian trajectories that bounce off the bounds. All that the prior allows
is there at the start, so separate minima keep their weights.

Neal (2011), Handbook of Markov Chain Monte Carlo, ch. 5, 10.1201/b10905 (Hamiltonian trajectories, bounds); Buchholz,
Chopin & Jacob (2021), Bayesian Anal. 16, 745, 10.1214/20-BA1222 (their tuning inside such a population).
"""

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled import VECTORS, compiled, each_in_threads
from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.spectra.mgm.batch import channels_of, problem_of
from lunarsci.spectra.mgm.data import MgmRows
from lunarsci.spectra.mgm.fit import MAX_ITERATIONS, NO_HOPS, TOLERANCE, fit_batch
from lunarsci.spectra.mgm.forward import energies_of, force_of, model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel, unit_of
from lunarsci.spectra.mgm.result import REACH_NM, MgmFit, pyroxene_pair
from lunarsci.spectra.spectrum import reaches_over
from lunarsci.tempering import Moves, carry, mutate

WANTED_ACCEPTANCE, TUNING = 0.75, 1.0
"""Share of trajectories that should be accepted, and how fast the step's length follows it."""
FIRST_STEP, LEAST_STEP, MOST_STEP = 0.3, 1e-3, 0.7
"""Length of a step of a trajectory, at first and at the ends of its range, in standard deviations."""
SHORTEST, LONGEST = 0.5, 3.5
"""Lengths of trajectories in standard deviations, uniformly at random: a normal law is forgotten after pi / 2 and back,
mirrored, after pi; the curved valleys of this model are longer."""
MOST_LEAPS, MOST_BOUNCES = 400, 200
"""Steps of a trajectory, and bounces in one of them."""
AT_A_STEP, SETTLING = Moves(1, 30, 0.8, mirrored=True), Moves(24, 64, 0.12, mirrored=True)
"""Trajectories of each particle at a step of beta, and before draws are kept."""
FIRST_MOVES, FRESH = 10, 8
"""Trajectories before the first step, which tune their length, and with one metric while the population settles."""
RIDGE = 1e-10
"""Added to the diagonal of a matrix, relatively, before it is factorised."""
PARTED = 0.01
"""Particles are labelled when beta passes this; the moves have forgotten by then where they came from."""


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _velocity(factor: Any, momentum: Any, velocity: Any) -> None:
    """Fill `velocity`, (f,), with L p: `factor` L is (f, f), lower, `momentum` p (f,), of the f free parameters."""
    for k in range(momentum.size):
        total, row = 0.0, factor[k]
        for i in range(k + 1):
            total += row[i] * momentum[i]
        velocity[k] = total


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _push(factor: Any, free: Any, gradient: Any, step: float, momentum: Any) -> None:
    """Add L' times the force on the free parameters times `step` to `momentum`; `gradient`, (p,), is the force."""
    for k in range(momentum.size):
        push, row = step * gradient[free[k]], factor[k]
        for i in range(k + 1):
            momentum[i] += push * row[i]


@compiled
def _drift(target: Any, factor: Any, point: Any, momentum: Any, velocity: Any, time: float) -> bool:
    """Move `point`, (p,), for `time`, bouncing off the bounds; False where that takes too many bounces.

    `target` and `factor` are those of `run_population`; `momentum` and `velocity`, (f,), turn round at a bound.
    """
    lower, upper, free = target[6:9]
    for _ in range(MOST_BOUNCES):
        first, wall = time, -1
        for k in range(free.size):
            p = free[k]
            if velocity[k] > 0.0 and point[p] + velocity[k] * first > upper[p]:
                first, wall = max(0.0, (upper[p] - point[p]) / velocity[k]), k
            elif velocity[k] < 0.0 and point[p] + velocity[k] * first < lower[p]:
                first, wall = max(0.0, (lower[p] - point[p]) / velocity[k]), k
        for k in range(free.size):
            p = free[k]
            point[p] = min(max(point[p] + velocity[k] * first, lower[p]), upper[p])
        if wall < 0:
            return True
        time -= first
        row, norm = factor[wall], 0.0
        for i in range(wall + 1):
            norm += row[i] * row[i]
        for i in range(wall + 1):
            momentum[i] -= 2.0 * velocity[wall] / norm * row[i]
        _velocity(factor, momentum, velocity)
    return False


@compiled
def _trajectory(
    target: Any, beta: float, factor: Any, step: float, generator: Any, point: Any, energy: Any, space: Any
) -> float:
    """One Hamiltonian trajectory of `point`, (p,), accepted or not, in steps of `step` standard deviations; its
    `energy`, (3,), follows. 1 where accepted."""
    trial, momentum, velocity, gradient, ending = space[2]
    free, change = target[8], 0.0
    step *= generator.uniform(0.8, 1.2)
    for k in range(momentum.size):
        momentum[k] = generator.standard_normal()
        change -= 0.5 * momentum[k] ** 2
    trial[:] = point
    leaps = min(MOST_LEAPS, math.ceil(generator.uniform(SHORTEST, LONGEST) / step))
    if not force_of(target, beta, trial, space, gradient):
        return 0.0
    for leap in range(leaps):
        _push(factor, free, gradient, 0.5 * step if leap == 0 else step, momentum)
        _velocity(factor, momentum, velocity)
        if not _drift(target, factor, trial, momentum, velocity, step):
            return 0.0
        if not force_of(target, beta, trial, space, gradient):
            return 0.0
    _push(factor, free, gradient, 0.5 * step, momentum)
    for k in range(momentum.size):
        change += 0.5 * momentum[k] ** 2
    energies_of(target, trial, space, ending)
    change += beta * (ending[0] - energy[0]) + ending[1] - energy[1] + (1.0 - beta) * (ending[2] - energy[2])
    if not math.log(generator.random()) < -change:
        return 0.0
    point[:], energy[:] = trial, ending
    return 1.0


@compiled
def _move_all(
    target: Any, beta: float, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any, space: Any
) -> None:
    """One trajectory of every particle; `tuning` is the step's length, to be adapted, and the acceptance."""
    accepted = 0.0
    for i in range(particles.shape[0]):
        accepted += _trajectory(target, beta, factor, tuning[0], generator, particles[i], energies[i], space)
    tuning[1] = accepted / particles.shape[0]
    tuning[0] *= math.exp(TUNING * (tuning[1] - WANTED_ACCEPTANCE))
    tuning[0] = min(max(tuning[0], LEAST_STEP), MOST_STEP)


def correct_coarse(target: Any, groups: IntArray, best: FloatArray) -> None:
    """Set the coarse data so that residuals and slope at `best`, (p,), are those of all channels.

    `target` and `groups` are those of `run_population`.
    Means of the residuals alone leave out how noise and slopes go together within a coarse channel.
    """
    channels, coarse, logarithmic, _, precision = target[:5]
    fine, rough = (model_and_jacobian(best, wavelength, basis.T, logarithmic) for wavelength, basis, *_ in target[:2])
    if fine is None or rough is None:
        return
    all_residuals, all_slopes = (channels[2] - fine[0]) * channels[3], fine[1] * channels[3]
    root = coarse[3]
    minus_model, slopes = -rough[0] * root, rough[1] * root
    wanted = np.bincount(groups, channels[3] * all_residuals, root.size) / root
    matrix = slopes @ slopes.T + precision
    matrix[np.diag_indices_from(matrix)] *= 1.0 + RIDGE
    with suppress(np.linalg.LinAlgError):
        np.linalg.cholesky(matrix)
        wanted += np.linalg.solve(matrix, all_slopes @ all_residuals - slopes @ wanted) @ slopes
    coarse[2][:] = (wanted - minus_model) / root


@dataclass(slots=True, eq=False)
class _Particles:
    """A population of `tempering`; `run_population` has `target`, `groups`, `factor`, `ancestors` and `space`.

    `all_points` are the n particles, (n, p) in the order and units of `MgmModel`; `energies` (n, 3) those of
    `energies_of`; `tuning` (2,) has the step's length and the acceptance of the last moves. Once `settling`, the metric
    is the population's own, renewed after every `FRESH` moves, of which there were `settled`.
    """

    target: Any
    groups: Any
    factor: Any
    generator: np.random.Generator
    all_points: FloatArray
    ancestors: IntArray
    energies: FloatArray
    space: Any
    tuning: FloatArray
    settling: bool = False
    settled: int = 0

    @property
    def points(self) -> FloatArray:
        """The free parameters of the particles, (n, f)."""
        return self.all_points[:, self.target[8]]

    @property
    def ln_likelihood(self) -> FloatArray:
        """What beta brings in, (n,): the data, less the law that fades as they come."""
        return self.energies[:, 2] - self.energies[:, 0]

    def resample(self, beta: float, weight: FloatArray, chosen: IntArray) -> None:
        """Take particles `chosen`, (n,), in place of all, whose weights, (n,), sum to 1."""
        self._take_metric(0.5 * (weight + 1.0 / weight.size))
        for rows in (self.all_points, self.energies, self.ancestors):
            rows[:] = rows[chosen]
        best = self.all_points[np.argmin(self.energies[:, 0] + self.energies[:, 1])]
        correct_coarse(self.target, self.groups, best)

    def move(self, beta: float) -> None:
        """One trajectory of every particle."""
        if self.settling:
            if self.settled % FRESH == 0:
                self._take_metric(np.full(len(self.energies), 1.0 / len(self.energies)))
            self.settled += 1
        _move_all(
            self.target, beta, self.factor, self.tuning, self.generator, self.all_points, self.energies, self.space
        )

    def _take_metric(self, weight: FloatArray) -> None:
        """The factor of the weighted covariance, where it has one."""
        covariance = np.cov(self.points.T, ddof=0, aweights=weight).reshape(self.factor.shape)
        covariance[np.diag_indices_from(covariance)] *= 1.0 + RIDGE
        with suppress(np.linalg.LinAlgError):
            self.factor[:] = np.linalg.cholesky(covariance)


def _workspace(size: int, channels: int) -> Any:
    """Room for one spectrum, as `_subtract` of `forward` takes it."""
    return np.empty((size, channels)), np.empty(channels), np.empty(channels)


@compiled
def _energies_of_all(target: Any, particles: Any, space: Any, energies: Any) -> None:
    """`energies_of` of every particle, (n, 3)."""
    for i in range(particles.shape[0]):
        energies_of(target, particles[i], space, energies[i])


def run_population(
    target: Any, groups: Any, factor: Any, generator: Any, particles: Any, ancestors: Any, draws: Any,
    objective: Any, report: Any,
) -> None:  # fmt: skip
    """Carry `particles` (n, p), draws from the prior, to the posterior; fill `draws` (rounds, n, p) with it, and
    `objective` (rounds, n) with their chi-square and prior share together.

    Parameters
    ----------
    target : (channels, coarse channels, logarithmic, prior, precision, `start`, lower, upper, indices of the free
        parameters). Channels are wavelength [um], basis (m, n), ln R, root of the weight; `start` (2, m) holds centre
        and inverse variance of a normal law of the continuum coefficients that fades as the data come in, so that flat
        priors have somewhere to begin.
    groups : (n,) to which coarse channel each channel belongs; the coarse data are overwritten.
    factor : (f, f) Cholesky factor of the prior's covariance, with that law in it; overwritten.
    ancestors : (n,) becomes from which particle at beta = `PARTED` each descends.
    report : becomes steps of beta, trajectories per particle, mean acceptance and step length at the end.
    """
    free, (count, size) = target[8], particles.shape
    points = (np.empty(size), np.empty(free.size), np.empty(free.size), np.empty(size), np.empty(3))
    space = (_workspace(size, target[0][0].size), _workspace(size, target[1][0].size), points)
    energies, tuning = np.empty((count, 3)), np.array([FIRST_STEP, 0.0])
    _energies_of_all(target, particles, space, energies)
    population = _Particles(target, groups, factor, generator, particles, ancestors, energies, space, tuning)
    for _ in range(FIRST_MOVES):
        population.move(0.0)
    report[:], ancestors[:] = 0.0, np.arange(count)
    for step in carry(population, generator, AT_A_STEP):
        report[:2] += 1, step.moves
        if step.beta < PARTED:
            ancestors[:] = np.arange(count)
    population.settling = True
    report[1] += mutate(population, 1.0, SETTLING)[0]
    population.settling = False
    for r in range(draws.shape[0]):
        population.move(1.0)
        report[2] += tuning[1] / draws.shape[0]
        draws[r], objective[r] = particles, 2.0 * (energies[:, 0] + energies[:, 1])
    report[3] = tuning[0]


@dataclass(frozen=True, slots=True)
class Interval:
    """One parameter's 68.27 % and 95 % intervals, in the unit of its name: nm for centres and widths.

    `value` is the parameter at the minimum for a profile, the median for draws. An end that is a bound of the parameter
    is that bound; NaN where the interval could not be closed.
    """

    name: str
    value: float
    low68: float
    high68: float
    low95: float
    high95: float

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of one fit: `method` is `profile` or `sample`; `remarks` say what limits their use."""

    method: str
    intervals: tuple[Interval, ...]
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Interval:
        """The interval of a parameter; KeyError where it has none."""
        for interval in self.intervals:
            if interval.name == name:
                return interval
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {
            "method": self.method,
            "intervals": [interval.to_dict() for interval in self.intervals],
            "remarks": list(self.remarks),
        }


def ratio_rows(model: MgmModel, wavelength_nm: FloatArray) -> dict[str, tuple[int, int]]:
    """Positions of the strengths of orthopyroxene and clinopyroxene by region, `um1` and `um2`.

    Only where the assemblage has both and the channels, ascending, reach over both bands. [nm]
    """
    rows: dict[str, tuple[int, int]] = {}
    for region, (low, high) in REACH_NM.items():
        pair = pyroxene_pair(model.assemblage.bands, region)
        if pair and reaches_over(wavelength_nm, low, high):
            rows[region] = (model.degrees + 3 * pair[0] + 2, model.degrees + 3 * pair[1] + 2)
    return rows


def ratio_names(model: MgmModel, wavelength_nm: FloatArray) -> tuple[str, ...]:
    """`nbsr_um1_opx` and `nbsr_um2_opx`, as far as `ratio_rows` finds them."""
    return tuple(f"nbsr_{region}_opx" for region in ratio_rows(model, wavelength_nm))


def ratios_of(points: FloatArray, model: MgmModel, wavelength_nm: FloatArray) -> dict[str, FloatArray]:
    """s_OPX / (s_OPX + s_CPX) by name, shape (n,), of parameter vectors, shape (n, p); NaN where both are 0. [-]

    Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025.
    """
    result = {}
    for region, (opx, cpx) in ratio_rows(model, wavelength_nm).items():
        total = points[:, opx] + points[:, cpx]
        with np.errstate(invalid="ignore"):
            result[f"nbsr_{region}_opx"] = np.asarray(points[:, opx] / total, dtype=np.float64)
    return result


PROBABILITIES = (0.6827, 0.95)
KINDS = ("center_nm", "strength")
"""Parameters that have a profile where none is named."""
CLOSE = 0.01
"""Of the root of the rise of the objective, at which an end of an interval has been found."""
NARROW = 1e-3
"""Of the standard error: a bracket narrower than this holds a jump of the profile, from one valley to another."""
MOST_STEPS = 30
"""Values tried for one end of an interval."""
LOWER_BY = 0.1
"""By how much an objective below the fit's says that the fit is not the minimum: by 5 % of its density; assumed."""
MISFIT = 1.5
"""Reduced chi-square above which intervals are too narrow; assumed."""


def profile_intervals(fit: MgmFit, names: Sequence[str] | None = None) -> Intervals:
    """68.27 % and 95 % intervals of parameters from the profile of the objective.

    The ends are where min objective(parameter fixed) - min objective = z^2, z = 1 and 1.96, or the parameter's bound
    where that is nearer. The weights of the data are taken as they are: chi-square is known. The intervals are those of
    `lmfit.conf_interval` on `lmfit_interop.to_minimizer(fit)`, and come quicker.

    Parameters
    ----------
    fit : a result of `fit_spectra`.
    names : parameters of the model, or `nbsr_um1_opx`, `nbsr_um2_opx`; all centres, strengths and ratios by default.

    Raises
    ------
    ParameterError for an unknown name.

    References
    ----------
    Venzon & Moolgavkar (1988), Appl. Stat. 37, 87, 10.2307/2347496.
    """
    ratios = ratio_names(fit.model, fit.wavelength_nm)
    if names is None:
        names = (*(name for name in fit.model.names if name.endswith(KINDS)), *ratios)
    remarks: list[str] = []
    if fit.reduced_chi2 > MISFIT:
        remarks.append(f"reduced chi-square is {fit.reduced_chi2:.1f}: errors are larger than stated to the fit")
    intervals = []
    for name in names:
        if name not in ratios:
            fit.model.index(name)
        profile = _ratio_profile(fit, name) if name in ratios else _parameter_profile(fit, name)
        intervals.append(_interval(profile, remarks))
    for remark in remarks:
        warnings.warn(f"{fit.id}: {remark}", LunarSciWarning, stacklevel=2)
    return Intervals("profile", tuple(intervals), tuple(remarks))


@dataclass(slots=True)
class _Profile:
    """One profile, of a parameter in the unit of `MgmModel` [um for centres and widths] or of a ratio. [-]

    Attributes
    ----------
    name, fit, best, sigma : of what; the fit whose minimum it begins at; the value there and its standard error.
    low, high : bounds of the parameter.
    restricted : the model in which the parameter is held at a value.
    moved : a start, (p,), for that model, from a minimum, (p,), and the value.
    points : values tried, each with the root of the rise of the objective, and the minimum found, (p,).
    lowest : least rise; below 0 where a profile came to a lower minimum than the fit.
    """

    name: str
    fit: MgmFit
    best: float
    sigma: float
    low: float
    high: float
    restricted: Callable[[float], MgmModel]
    moved: Callable[[FloatArray, float], FloatArray]
    points: list[tuple[float, float, FloatArray]] = field(default_factory=list)
    lowest: float = 0.0

    def rise(self, value: float) -> float:
        """Root of the rise of the objective where the parameter is `value`; starts from the nearest known points."""
        nearest = sorted(self.points, key=lambda entry: abs(entry[0] - value))[:2]
        starts = [self.moved(point, value) for _, _, point in nearest]
        point, objective = _minimum(self.fit, self.restricted(value), starts)
        change = objective - self.fit.objective
        self.lowest = min(self.lowest, change)
        root = float(np.sqrt(max(change, 0.0))) if np.isfinite(change) else np.inf
        self.points.append((value, root, point))
        return root


def _parameter_profile(fit: MgmFit, name: str) -> _Profile:
    k, unit = fit.model.index(name), unit_of(name)
    variance = fit.covariance[k, k]
    follow = fit.covariance[k] / variance if variance > 0 else np.zeros(fit.parameters.size)

    def restricted(value: float) -> MgmModel:
        return fit.model.bounded(name, value * unit, value * unit)

    def moved(point: FloatArray, value: float) -> FloatArray:
        return np.asarray(point + (value - point[k]) * follow)

    best = float(fit.parameters[k])
    profile = _Profile(
        name,
        fit,
        best,
        float(np.sqrt(variance)),
        float(fit.model.lower[k]),
        float(fit.model.upper[k]),
        restricted,
        moved,
    )
    profile.points.append((best, 0.0, fit.parameters))
    return profile


def _ratio_profile(fit: MgmFit, name: str) -> _Profile:
    """Of s_OPX / (s_OPX + s_CPX), which a tie between the two strengths fixes."""
    region = name.split("_")[1]
    opx, cpx = ratio_rows(fit.model, fit.wavelength_nm)[region]
    names = fit.model.names

    def restricted(value: float) -> MgmModel:
        if value <= 0.5:
            return fit.model.tied(names[opx], value / (1 - value), names[cpx], 0.0)
        return fit.model.tied(names[cpx], (1 - value) / value, names[opx], 0.0)

    def moved(point: FloatArray, value: float) -> FloatArray:
        start = point.copy()
        start[opx], start[cpx] = np.array([value, 1 - value]) * (point[opx] + point[cpx])
        return start

    best = float(ratios_of(fit.parameters[None], fit.model, fit.wavelength_nm)[name][0])
    total = fit.parameters[opx] + fit.parameters[cpx]
    slope = np.array([fit.parameters[cpx], -fit.parameters[opx]]) / total**2 if total < 0 else np.zeros(2)
    block = fit.covariance[np.ix_([opx, cpx], [opx, cpx])]
    profile = _Profile(name, fit, best, float(np.sqrt(slope @ block @ slope)), 0.0, 1.0, restricted, moved)
    profile.points.append((best, 0.0, fit.parameters))
    return profile


def _minimum(fit: MgmFit, model: MgmModel, starts: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """Point and objective of the lowest minimum under `model`, the objective with the fit's own prior."""
    spectra = channels_of(MgmRows.together([fit.data]), model)
    points = np.clip(np.array(starts), model.lower, model.upper)[:, None]
    solved = fit_batch(spectra, problem_of(model), points, NO_HOPS, TOLERANCE, MAX_ITERATIONS)
    point = solved.parameters[0]
    pull = point - fit.model.prior
    return point, float(solved.chi2[0] + pull @ fit.model.precision @ pull)


def _interval(profile: _Profile, remarks: list[str]) -> Interval:
    unit = unit_of(profile.name)
    if not (np.isfinite(profile.best) and np.isfinite(profile.sigma)):
        remarks.append(f"{profile.name} has no profile: it is undetermined at the minimum")
        ends = [[np.nan] * 2] * 2
    elif profile.low == profile.high:
        ends = [[profile.best] * 2] * 2
    else:
        ends = [list(_ends(profile, sign)) for sign in (-1, 1)]
        if np.isnan(ends).any():
            remarks.append(f"the interval of {profile.name} could not be closed")
        if profile.lowest < -LOWER_BY:
            remarks.append(
                f"the profile of {profile.name} found an objective {-profile.lowest:.1f} lower: fit with more starts"
            )
    (low68, low95), (high68, high95) = ends
    return Interval(profile.name, *(unit * end for end in (profile.best, low68, high68, low95, high95)))


def _ends(profile: _Profile, sign: int) -> Iterator[float]:
    """Ends to one side, the nearer first."""
    bound = profile.high if sign > 0 else profile.low
    inside = profile.best
    for probability in PROBABILITIES:
        wanted = NormalDist().inv_cdf(0.5 + probability / 2)
        inside = _end(profile, sign, bound, wanted, inside)
        yield inside
        if np.isnan(inside):
            inside = profile.best


def _end(profile: _Profile, sign: int, bound: float, wanted: float, start: float) -> float:
    """Where the root of the rise is `wanted`: outward in steps, then by the secant between the last two."""
    inner, inner_root = start, min(profile.points, key=lambda entry: abs(entry[0] - start))[1]
    step = max(profile.sigma, 1e-9) * max(wanted - inner_root, 0.1)
    outer, outer_root, narrow = np.nan, np.nan, NARROW * max(profile.sigma, 1e-9)
    for _ in range(MOST_STEPS):
        if np.isnan(outer):
            trial = inner + sign * step
            trial = min(trial, bound) if sign > 0 else max(trial, bound)
        else:
            share = (wanted - inner_root) / (outer_root - inner_root) if np.isfinite(outer_root) else 0.5
            trial = inner + (outer - inner) * min(max(share, 0.1), 0.9)
        root = profile.rise(trial)
        if abs(root - wanted) < CLOSE or (trial == bound and root <= wanted) or abs(outer - inner) < narrow:
            return trial
        if root > wanted:
            outer, outer_root = trial, root
        else:
            rise = (root - inner_root) / abs(trial - inner) if trial != inner else 0.0
            step = min(max((wanted - root) / rise if rise > 0 else 2 * step, 0.3 * step), 3 * step)
            inner, inner_root = trial, root
    return np.nan


DEFAULT_DRAWS = 4000
DEFAULT_PARTICLES = 256
GROUPS = 8
"""Into which the families of particles are put for R-hat."""
LEAST_FAMILIES = 4
"""Of particles, each from one at beta = `PARTED`; with fewer nothing says whether draws agree."""
COARSE_UM = 0.015
"""Width of the channels that steer trajectories; a quarter of the sigma of the narrowest band."""
CONTINUUM_SPREAD = 0.5
"""Standard deviation of the continuum coefficients at the start, in units of the continuum."""
MOST_R_HAT, LEAST_EFFECTIVE, LEAST_ACCEPTANCE = 1.1, 100.0, 0.3
"""Beyond which draws are doubted. R-hat as of Gelman & Rubin (1992), Stat. Sci. 7, 457, 10.1214/ss/1177011136; 100
independent draws have a mean within a tenth of its standard deviation; the acceptance is assumed, 0.75 is aimed at."""
SAMPLED_PROBABILITIES = (0.5, 0.15865, 0.84135, 0.025, 0.975)


@dataclass(frozen=True, slots=True, eq=False)
class FitPosterior:
    """Draws from exp(-objective / 2) within the bounds.

    Attributes
    ----------
    model, wavelength_nm : of the fit; wavelength_nm has shape (n_channels,). [nm]
    draws : (n, p) in the order and units of `MgmModel`, of equal weight.
    objective : (n,) chi-square with the prior's share. [-]
    effective_size : (p,) number of independent draws that would give the means as well. [-]
    r_hat : (p,) split R-hat between families of particles and between earlier and later draws; 1 is ideal. [-]
    acceptance : share of the trajectories that was accepted. [-]
    trusted, status : whether the draws may be used, and a sentence that says why not.
    """

    model: MgmModel
    wavelength_nm: FloatArray
    draws: FloatArray
    objective: FloatArray
    effective_size: FloatArray
    r_hat: FloatArray
    acceptance: float
    trusted: bool
    status: str


def sample_posterior(
    fit: MgmFit, *, draws: int = DEFAULT_DRAWS, seed: int = 0, particles: int = DEFAULT_PARTICLES
) -> FitPosterior:
    """Draw from the posterior of a fit: density exp(-objective / 2) within the bounds, flat where the prior is.

    Particles begin as draws from the prior and are carried to the posterior through powers of the likelihood
    (`sampler`), so that nothing depends on which minimum the fit found. Equal seeds give equal draws. The weights of
    the data are taken as they are: a fit whose reduced chi-square is far from 1 needs another model error first.

    Parameters
    ----------
    fit : a result of `fit_spectra`.
    draws : how many; they are those of all particles after each of the last trajectories.
    seed : 0 or above.
    particles : more find rarer minima and weigh them better, in proportion to the time.

    Raises
    ------
    ParameterError for a seed below 0.

    References
    ----------
    Del Moral, Doucet & Jasra (2006), J. R. Stat. Soc. B 68, 411, 10.1111/j.1467-9868.2006.00553.x; Lee & Whiteley
    (2018), Biometrika 105, 609, 10.1093/biomet/asy028 (error from families); Vehtari et al. (2021), Bayesian Anal. 16,
    667, 10.1214/20-BA1221 (R-hat).
    """
    if seed < 0:
        raise ParameterError(f"seed {seed}; give 0 or above")
    generator = np.random.default_rng(seed)
    start = _continuum_start(fit)
    target, groups = _target(fit, start)
    population, factor = _prior_draws(fit, start, particles, generator)
    families, report = np.zeros(particles, dtype=np.int64), np.empty(4)
    rounds = -(-draws // particles)
    drawn, objective = np.empty((rounds, *population.shape)), np.empty((rounds, particles))
    run_population(target, groups, factor, generator, population, families, drawn, objective, report)
    return _posterior(fit, drawn, objective, families, float(report[2]), draws)


def sample_batch(
    fits: Sequence[MgmFit],
    *,
    draws: int = DEFAULT_DRAWS,
    seed: int = 0,
    particles: int = DEFAULT_PARTICLES,
    progress: Callable[[int, int], None] | None = None,
) -> list[FitPosterior]:
    """`sample_posterior` of many fits in all threads, in the order given; each as if it were alone.

    `progress` is called with (done, total). Raises what `sample_posterior` raises.
    """
    result: dict[int, FitPosterior] = {}

    def one(index: int) -> None:
        result[index] = sample_posterior(fits[index], draws=draws, seed=seed, particles=particles)

    each_in_threads(one, len(fits), progress)
    return [result[index] for index in range(len(fits))]


def posterior_intervals(posterior: FitPosterior) -> Intervals:
    """Median, central 68.27 % and central 95 % of every parameter, and of the band strength ratios of the pyroxenes."""
    model = posterior.model
    columns = {name: posterior.draws[:, k] * unit_of(name) for k, name in enumerate(model.names)}
    columns |= ratios_of(posterior.draws, model, posterior.wavelength_nm)
    intervals = (Interval(name, *map(float, np.quantile(v, SAMPLED_PROBABILITIES))) for name, v in columns.items())
    return Intervals("sample", tuple(intervals), () if posterior.status == "sampled" else (posterior.status,))


def _continuum_start(fit: MgmFit) -> FloatArray:
    """(2, m): centre and inverse variance of the law that the continuum coefficients begin with."""
    coefficients = fit.parameters[: fit.model.degrees]
    level = 1.0 if fit.model.logarithmic else float(np.mean(fit.continuum_reflectance))
    return np.array([coefficients, np.full(coefficients.size, (CONTINUUM_SPREAD * level) ** -2.0)])


def _target(fit: MgmFit, start: FloatArray) -> tuple[Any, ...]:
    """What `run_population` calls `target`, and `groups`."""
    model, weight, wavelength = fit.model, fit.data.weight, fit.wavelength_nm / 1e3
    basis = np.ascontiguousarray(model.basis(fit.wavelength_nm).T)
    bins = np.floor((wavelength - wavelength[0]) / COARSE_UM)
    groups = np.unique(bins, return_inverse=True)[1].astype(np.int64)
    total = np.bincount(groups, weight)
    rows = [np.bincount(groups, weight * row) / total for row in (wavelength, *basis)]
    fine = wavelength, basis, np.log(fit.reflectance), np.sqrt(weight)
    coarse = rows[0], np.array(rows[1:]).reshape(len(basis), total.size), np.zeros(total.size), np.sqrt(total)
    free = np.flatnonzero(~model.fixed)
    target = (fine, coarse, model.logarithmic, model.prior, model.precision, start, model.lower, model.upper, free)
    return target, groups


def _prior_draws(
    fit: MgmFit, start: FloatArray, particles: int, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draws from the prior and the start of the continuum, folded at the bounds, and the factor of their covariance.

    Folding is right for strengths that are independent of the rest; the first trajectories put the others right.
    """
    model, m = fit.model, fit.model.degrees
    free, basis = ~model.fixed, model.basis(fit.wavelength_nm)
    precision = model.precision + np.diag(np.concatenate([start[1], np.zeros(model.prior.size - m)]))
    pull = model.precision @ model.prior
    pull[:m] += start[1] * start[0]
    pull = pull[free] - precision[np.ix_(free, ~free)] @ model.lower[~free]
    covariance = np.linalg.inv(precision[np.ix_(free, free)])
    factor, mean = np.linalg.cholesky(covariance), covariance @ pull
    points = np.tile(model.lower, (particles, 1))
    for point in points:
        while True:
            values = mean + factor @ generator.standard_normal(mean.size)
            low, high = model.lower[free], model.upper[free]
            values = np.where(values > high, 2 * high - values, values)
            point[free] = np.clip(np.where(values < low, 2 * low - values, values), low, high)
            if model.logarithmic or (basis @ point[:m]).min() > 0:
                break
    return points, factor


def _posterior(
    fit: MgmFit, drawn: FloatArray, objective: FloatArray, families: IntArray, acceptance: float, draws: int
) -> FitPosterior:
    effective, r_hat = _effective_size(drawn, families), _r_hat(drawn, families)
    effective, r_hat = np.where(fit.model.fixed, np.nan, effective), np.where(fit.model.fixed, np.nan, r_hat)
    doubts = _doubts(effective, r_hat, acceptance, len(np.unique(families)))
    remarks = _remarks(fit, float(objective.min()))
    status = "; ".join(([f"do not trust these draws: {', '.join(doubts)}"] if doubts else []) + remarks) or "sampled"
    return FitPosterior(
        fit.model, fit.wavelength_nm, drawn.reshape(-1, drawn.shape[2])[:draws], objective.ravel()[:draws],
        effective, r_hat, acceptance, not doubts, status,
    )  # fmt: skip


def _doubts(effective: FloatArray, r_hat: FloatArray, acceptance: float, families: int) -> list[str]:
    doubts = []
    if families < LEAST_FAMILIES:
        doubts.append(f"all descend from {families} particles at an early step")
    if not np.nanmax(r_hat) < MOST_R_HAT:
        doubts.append(f"R-hat reaches {np.nanmax(r_hat):.2f}, above {MOST_R_HAT:g}")
    if not np.nanmin(effective) > LEAST_EFFECTIVE:
        doubts.append(f"a parameter has {np.nanmin(effective):.0f} effective draws, fewer than {LEAST_EFFECTIVE:g}")
    if not acceptance > LEAST_ACCEPTANCE:
        doubts.append(f"only {acceptance:.0%} of the trajectories were accepted")
    if doubts:
        doubts[-1] += " (more particles help)"
    return doubts


def _remarks(fit: MgmFit, lowest: float) -> list[str]:
    remarks, above = [], lowest - fit.objective
    if above > fit.parameters.size:
        remarks.append(f"the minimum of the fit was not found again: no draw comes nearer than {above:.0f} to it")
    if above < -LOWER_BY:
        remarks.append(f"a draw lies {-above:.1f} below the objective of the fit: fit with more starts")
    if fit.reduced_chi2 > MISFIT:
        remarks.append(f"reduced chi-square is {fit.reduced_chi2:.1f}: errors are larger than stated to the fit")
    return remarks


def _effective_size(drawn: FloatArray, families: IntArray) -> FloatArray:
    """(p,) variance of the draws over that of their mean, which the sums over families tell."""
    rounds, count, _ = drawn.shape
    apart = drawn.mean(axis=0) - drawn.mean(axis=(0, 1))
    sums = np.array([apart[families == label].sum(axis=0) / count for label in np.unique(families)])
    of_mean = (sums**2).sum(axis=0) * count / (count - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.minimum(drawn.var(axis=(0, 1)) / of_mean, rounds * count), dtype=np.float64)


def _r_hat(drawn: FloatArray, families: IntArray) -> FloatArray:
    """(p,) root of total over within-group variance; groups are families of the first and of the second half."""
    half = max(1, len(drawn) // 2)
    parts = [part for part in (drawn[:half], drawn[half:]) if len(part)]
    labels = families % GROUPS
    groups = [part[:, labels == label].reshape(-1, part.shape[2]) for part in parts for label in np.unique(labels)]
    sizes = np.array([len(group) for group in groups], dtype=np.float64)[:, None]
    means = np.array([group.mean(axis=0) for group in groups])
    within = (sizes * np.array([group.var(axis=0) for group in groups])).sum(axis=0) / sizes.sum()
    between = (sizes * (means - (sizes * means).sum(axis=0) / sizes.sum()) ** 2).sum(axis=0) / sizes.sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(1 + between / within), dtype=np.float64)


def intervals_of(
    results: Sequence[Any], errors: str, seed: int, progress: Callable[[int, int], None] | None
) -> dict[int, Intervals]:
    """Intervals by position of fits that converged, by profile or sample; none for laplace."""
    if errors == "laplace":
        return {}
    fits = {index: item for index, item in enumerate(results) if isinstance(item, MgmFit) and item.converged}
    if errors == "sample":
        posteriors = sample_batch(list(fits.values()), seed=seed, progress=progress)
        return {index: posterior_intervals(posterior) for index, posterior in zip(fits, posteriors, strict=True)}
    result = {}
    for done, (index, item) in enumerate(fits.items(), start=1):
        result[index] = profile_intervals(item)
        if progress:
            progress(done, len(fits))
    return result
