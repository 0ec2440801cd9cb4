"""Draws from the posterior of a fit, for hard cases: several minima, strengths at 0, curved valleys."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled import each_in_threads
from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.model import MgmModel, unit_of
from lunarsci.spectra.mgm.profile import Interval, Intervals, profile_intervals, ratios_of
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.mgm.sampler import run_population

DEFAULT_DRAWS = 4000
DEFAULT_PARTICLES = 256
LEAST_DRAWS, LEAST_PARTICLES = 100, 128
GROUPS = 8
"""Into which the families of particles are put for R-hat."""
LEAST_FAMILIES = 4
COARSE_UM = 0.015
"""Width of the channels that steer trajectories; a quarter of the sigma of the narrowest band."""
CONTINUUM_SPREAD = 0.5
"""Standard deviation of the continuum coefficients at the start, in units of the continuum."""
MOST_R_HAT, LEAST_EFFECTIVE, LEAST_ACCEPTANCE = 1.1, 100.0, 0.3
"""Beyond which draws are doubted; R-hat as of Gelman & Rubin (1992), Stat. Sci. 7, 457, 10.1214/ss/1177011136; the
others assumed."""
LOWER_BY = 1.0
"""By how much an objective below the fit's says that the fit is not the minimum; assumed."""
MISFIT = 1.5
"""Reduced chi-square above which errors are too small for a posterior; assumed."""
PROBABILITIES = (0.5, 0.15865, 0.84135, 0.025, 0.975)


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
    draws : how many, 100 or more; they are those of all particles after each of the last trajectories.
    seed : 0 or above.
    particles : 128 or more; more find rarer minima and weigh them better, in proportion to the time.

    Raises
    ------
    ParameterError for numbers below these.

    References
    ----------
    Del Moral, Doucet & Jasra (2006), J. R. Stat. Soc. B 68, 411, 10.1111/j.1467-9868.2006.00553.x; Lee & Whiteley
    (2018), Biometrika 105, 609, 10.1093/biomet/asy028 (error from families); Vehtari et al. (2021), Bayesian Anal. 16,
    667, 10.1214/20-BA1221 (R-hat).
    """
    for what, value, least in (("draws", draws, LEAST_DRAWS), ("particles", particles, LEAST_PARTICLES)):
        if value < least:
            raise ParameterError(f"{value} {what}; give {least} or more")
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
    found: dict[int, FitPosterior] = {}

    def one(index: int) -> None:
        found[index] = sample_posterior(fits[index], draws=draws, seed=seed, particles=particles)

    each_in_threads(one, len(fits), progress)
    return [found[index] for index in range(len(fits))]


def posterior_intervals(posterior: FitPosterior) -> Intervals:
    """Median, central 68.27 % and central 95 % of every parameter, and of the band strength ratios of the pyroxenes."""
    model = posterior.model
    columns = {name: posterior.draws[:, k] * unit_of(name) for k, name in enumerate(model.names)}
    columns |= ratios_of(posterior.draws, model, posterior.wavelength_nm)
    intervals = (Interval(name, *map(float, np.quantile(v, PROBABILITIES))) for name, v in columns.items())
    return Intervals("sample", tuple(intervals), () if posterior.status == "sampled" else (posterior.status,))


def _continuum_start(fit: MgmFit) -> FloatArray:
    """(2, m): centre and inverse variance of the law that the continuum coefficients begin with."""
    coefficients = fit.parameters[: fit.model.degrees]
    level = 1.0 if fit.model.logarithmic else float(np.mean(fit.continuum_reflectance))
    return np.array([coefficients, np.full(coefficients.size, (CONTINUUM_SPREAD * level) ** -2.0)])


def _target(fit: MgmFit, start: FloatArray) -> tuple[Any, ...]:
    """What `run_population` calls `target`, and `groups`."""
    model, weight, wavelength = fit.model, fit.data.weight, fit.wavelength_nm / 1e3
    columns = np.ascontiguousarray(model.basis(fit.wavelength_nm).T)
    bins = np.floor((wavelength - wavelength[0]) / COARSE_UM)
    groups = np.unique(bins, return_inverse=True)[1].astype(np.int64)
    total = np.bincount(groups, weight)
    rows = [np.bincount(groups, weight * row) / total for row in (wavelength, *columns)]
    fine = wavelength, columns, np.log(fit.reflectance), np.sqrt(weight)
    coarse = rows[0], np.array(rows[1:]).reshape(len(columns), total.size), np.zeros(total.size), np.sqrt(total)
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
    found = {}
    for done, (index, item) in enumerate(fits.items(), start=1):
        found[index] = profile_intervals(item)
        if progress:
            progress(done, len(fits))
    return found
