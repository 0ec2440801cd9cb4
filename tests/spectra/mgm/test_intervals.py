"""Draws from the posterior against laws known in closed form or by brute force, and their reproducibility.

Profile intervals: exact limits worked out with linear algebra, and lmfit's own search on a curved case.

Intervals hold the truth as often as they say. The full table is `tests/benchmarks/bench_coverage.py`.
"""

from collections.abc import Callable
from dataclasses import replace
from statistics import NormalDist
from types import ModuleType

import lmfit
import numpy as np
import pytest
from scipy.stats import truncnorm

from lunarsci.compiled import set_threads
from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import fit_data
from lunarsci.spectra.mgm.forward import force_of, model_and_jacobian
from lunarsci.spectra.mgm.intervals import (
    FitPosterior,
    correct_coarse,
    posterior_intervals,
    profile_intervals,
    sample_batch,
    sample_posterior,
)
from lunarsci.spectra.mgm.lmfit_interop import to_lmfit, to_minimizer
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFit

GRID = np.arange(450.0, 2396.0, 5.0)
NOISE = 0.005
UV, OPX = "uv", "opx_1"


def shape(centre_nm: np.ndarray | float, fwhm_nm: float) -> np.ndarray:
    return np.exp(-0.5 * ((GRID - np.asarray(centre_nm)[..., None]) * 2.354820045 / fwhm_nm) ** 2)


def only(model: MgmModel, *free: str) -> MgmModel:
    """All bands fixed at their priors and at strength 0, except the named parameters."""
    for name in model.names[model.degrees :]:
        if name not in free:
            value = 0.0 if name.endswith("strength") else model.prior[model.index(name)] * 1e3
            model = model.bounded(name, value, value)
    return model


def fitted(model: MgmModel, ln: np.ndarray, noise: float = NOISE) -> MgmFit:
    data = MgmData("made", GRID, np.exp(ln), np.full(GRID.size, noise**-2), np.zeros((0, GRID.size)), 0.0)
    return fit_data([data], model, 8)[0]


def noisy(ln: np.ndarray, seed: int = 1) -> np.ndarray:
    return ln + np.random.default_rng(seed).normal(scale=NOISE, size=GRID.size)


@pytest.fixture(scope="module")
def curved() -> tuple[MgmFit, FitPosterior]:
    """Orthopyroxene with everything free."""
    model = mgm_model("OPX")
    ln = np.log(0.15 + 5e-5 * GRID)
    for band in model.assemblage.bands:
        ln = ln - 0.2 * shape(band.center_nm, band.fwhm_nm)
    fit = fitted(model, noisy(ln))
    return fit, sample_posterior(fit, particles=512)


@pytest.fixture(scope="module")
def quick() -> MgmFit:
    """One strength free, for what does not depend on the model."""
    return fitted(only(mgm_model("OPX", "none"), f"{OPX}_strength"), noisy(np.zeros(GRID.size)))


def test_a_normal_posterior_has_its_mean_and_its_covariance() -> None:
    """Centres and widths fixed and strengths far from 0: least squares in the continuum of ln C and the strengths."""
    model = mgm_model("OPX-CPX", "log-quadratic")
    bands = model.assemblage.bands
    for band in bands:
        for kind in ("center_nm", "fwhm_nm"):
            value = model.prior[model.index(f"{band.key}_{kind}")] * 1e3
            model = model.bounded(f"{band.key}_{kind}", value, value)
    shapes = np.array([shape(band.center_nm, band.fwhm_nm) for band in bands])
    fit = fitted(model, noisy(-1.5 - 0.5 * shapes.sum(axis=0)))
    design = np.vstack([np.vander((GRID - 1500) / 1100, 3, increasing=True).T, shapes]) / NOISE
    precision = design @ design.T + np.diag([0] * 3 + [band.strength_sigma**-2 for band in bands])
    covariance = np.linalg.inv(precision)
    mean = covariance @ design @ (np.log(fit.reflectance) / NOISE)
    assert np.all(mean[3:] + 5 * np.sqrt(np.diag(covariance)[3:]) < 0)
    posterior = sample_posterior(fit, draws=8000)
    assert posterior.trusted, posterior.status
    free = [0, 1, 2, *range(5, model.prior.size, 3)]
    draws = posterior.draws[:, free]
    sigma = np.sqrt(np.diag(covariance))
    effective = np.minimum(posterior.effective_size[free], 8000)
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 4.5 * sigma / np.sqrt(effective))
    correlation = covariance / np.outer(sigma, sigma)
    assert np.allclose(draws.std(axis=0), sigma, rtol=0.1)
    assert np.allclose(np.corrcoef(draws.T), correlation, atol=0.1)
    assert np.isnan(posterior.effective_size[~np.isin(np.arange(model.prior.size), free)]).all()


@pytest.mark.parametrize("peak", [0.3, 0.0, -0.3, -3.0])
def test_a_strength_at_its_bound_follows_the_truncated_normal_law(peak: float) -> None:
    """`peak` is where the law would have its maximum without the bound, in standard deviations; beyond 0 or before."""
    model = only(mgm_model("OPX", "none"), f"{OPX}_strength")
    [band] = [band for band in model.assemblage.bands if band.key == OPX]
    gaussian, own = shape(band.center_nm, band.fwhm_nm), model.index(f"{OPX}_strength")
    precision = (gaussian**2).sum() / NOISE**2 + model.precision[own, own]
    fit = fitted(model, gaussian * peak * precision**0.5 / ((gaussian**2).sum() / NOISE**2))
    law = truncnorm(-np.inf, -peak, loc=peak * precision**-0.5, scale=precision**-0.5)
    posterior = sample_posterior(fit, draws=16000)
    draws = posterior.draws[:, model.index(f"{OPX}_strength")]
    assert draws.max() <= 0
    shares = [np.mean(draws <= law.ppf(p)) for p in (0.05, 0.16, 0.5, 0.84, 0.95)]
    assert shares == pytest.approx([0.05, 0.16, 0.5, 0.84, 0.95], abs=0.03)
    interval = posterior_intervals(posterior)[f"{OPX}_strength"]
    ends = [interval.low95, interval.low68, interval.value, interval.high68, interval.high95]
    assert ends == pytest.approx(law.ppf([0.025, 0.15865, 0.5, 0.84135, 0.975]), abs=0.08 * law.std())


@pytest.mark.slow
@pytest.mark.parametrize("second", [0.0042])
def test_two_minima_keep_their_weights(second: float) -> None:
    """One band, two absorptions: the posterior of centre and strength by a fine grid of both."""
    model = only(mgm_model("OPX", "none"), f"{OPX}_center_nm", f"{OPX}_strength")
    model = model.bounded(f"{OPX}_center_nm", 700, 1900)
    k = model.index(f"{OPX}_center_nm")
    precision = model.precision.copy()
    precision[k, :] = precision[:, k] = 0.0
    precision[k, k] = 0.5**-2
    model = replace(model, precision=precision, prior=np.where(np.arange(model.prior.size) == k, 1.3, model.prior))
    fwhm = model.prior[k + 1] * 1e3
    data = -0.004 * shape(1000, fwhm) - second * shape(1600, fwhm)
    fit = fitted(model, data)
    centres, strengths = np.linspace(700, 1900, 1201), np.linspace(-0.012, 0, 601)
    shapes = shape(centres, fwhm)
    cross, own = shapes @ data / NOISE**2, (shapes**2).sum(axis=1) / NOISE**2
    [band] = [band for band in model.assemblage.bands if band.key == OPX]
    log_density = (
        strengths[:, None] * cross
        - 0.5 * strengths[:, None] ** 2 * (own + band.strength_sigma**-2)
        - 0.5 * ((centres - 1300) / 500) ** 2
    )
    density = np.exp(log_density - log_density.max()).sum(axis=0)
    weight = density[centres > 1300].sum() / density.sum()
    assert 0.1 < weight < 0.9
    drawn = [sample_posterior(fit, particles=512, seed=seed).draws[:, k] * 1e3 for seed in range(3)]
    assert np.mean([(draws > 1300).mean() for draws in drawn]) == pytest.approx(weight, abs=0.08)
    spread = np.sqrt((density * (centres - 1600) ** 2)[centres > 1300].sum() / density[centres > 1300].sum())
    above = np.concatenate(drawn)
    assert np.sqrt(((above[above > 1300] - 1600) ** 2).mean()) == pytest.approx(spread, rel=0.1)


@pytest.mark.parametrize("apart_um", [0.0, 0.01])
def test_coarse_channels_have_the_residuals_and_the_slope_of_all(apart_um: float) -> None:
    """Groups of three channels of unlike weights: where these lie at one wavelength their mean is all that they say;
    where they do not, the slope of half of chi-square is still that of all, at the point at which it was asked."""
    rng, model = np.random.default_rng(4), mgm_model("OPX", "wavelength")
    middle = np.linspace(0.42, 2.4, 60)
    fine, groups = (middle[:, None] + apart_um * np.array([-1.0, 0.0, 1.0])).ravel(), np.repeat(np.arange(60), 3)
    point = model.prior.copy()
    point[:2], point[model.degrees + 2 :: 3] = (0.2, 0.05), -0.1
    data, weight = rng.normal(-1.5, 0.1, 180), rng.uniform(0.5, 2.0, 180) / NOISE**2
    coarse_weight = np.bincount(groups, weight)
    channels, coarse = (
        (w, np.ascontiguousarray(model.basis(1e3 * w).T), values, np.sqrt(weights))
        for w, values, weights in ((fine, data, weight), (middle, np.full(60, np.nan), coarse_weight))
    )
    flat, start = np.zeros((point.size, point.size)), np.zeros((2, model.degrees))
    target = (channels, coarse, False, model.prior, flat, start, model.lower, model.upper, np.arange(point.size))
    space = tuple((np.empty((point.size, n)), np.empty(n), np.empty(n)) for n in (180, 60))
    correct_coarse(target, groups, point)
    if apart_um == 0.0:
        assert coarse[2] == pytest.approx(np.bincount(groups, weight * data) / coarse_weight)
    expected = model_and_jacobian(point, fine, model.basis(1e3 * fine), False)
    force = np.empty(point.size)
    assert expected is not None and force_of(target, 1.0, point, space, force)
    assert force == pytest.approx(expected[1] @ (weight * (data - expected[0])), rel=1e-6)


def test_a_hard_case_is_sampled_about_its_minimum(curved: tuple[MgmFit, FitPosterior]) -> None:
    fit, posterior = curved
    assert posterior.trusted, posterior.status
    assert posterior.draws.shape == (4000, fit.model.prior.size)
    assert np.all((posterior.draws >= fit.model.lower) & (posterior.draws <= fit.model.upper))
    assert np.nanmax(posterior.r_hat) < 1.1
    above = posterior.objective - fit.objective
    assert above.min() > -0.1
    free = (~fit.model.fixed).sum()
    assert 0.5 * free < above.mean() < 1.5 * free, "half the objective is about a chi-square law's"


def test_objectives_are_those_of_the_draws(curved: tuple[MgmFit, FitPosterior]) -> None:
    """Chi-square and prior written out for some draws."""
    fit, posterior = curved
    m = fit.model.degrees
    for draw, objective in zip(posterior.draws[::500], posterior.objective[::500], strict=True):
        ln = np.log(np.vander((GRID - 1500) / 1100, 3, increasing=True) @ draw[:m])
        for centre, fwhm, strength in draw[m:].reshape(-1, 3):
            ln = ln + strength * shape(centre * 1e3, fwhm * 1e3)
        away = draw - fit.model.prior
        expected = ((np.log(fit.reflectance) - ln) ** 2).sum() / NOISE**2 + away @ fit.model.precision @ away
        assert objective == pytest.approx(expected, rel=1e-9)


def test_equal_seeds_give_equal_draws_in_any_number_of_threads(quick: MgmFit) -> None:
    alone = sample_posterior(quick, draws=300, seed=7, particles=128)
    batches = []
    for count in (1, 0):
        set_threads(count)
        batches.append(sample_batch([quick] * 4, draws=300, seed=7, particles=128))
    for batch in batches:
        assert all(np.array_equal(posterior.draws, alone.draws) for posterior in batch)
    other = sample_posterior(quick, draws=300, seed=8, particles=128)
    assert not np.array_equal(other.draws, alone.draws)


def test_too_few_draws_are_not_trusted(curved: tuple[MgmFit, FitPosterior]) -> None:
    """100 draws of the fewest particles are good enough now and then: two of the first twenty are not."""
    doubted: list[FitPosterior] = []
    for seed in range(20):
        posterior = sample_posterior(curved[0], draws=100, particles=128, seed=seed)
        doubted += [] if posterior.trusted else [posterior]
        if len(doubted) == 2:
            break
    assert len(doubted) == 2
    for posterior in doubted:
        assert posterior.status.startswith("do not trust these draws: ")
        assert posterior_intervals(posterior).remarks == (posterior.status,)


def test_a_fit_above_its_minimum_is_said(curved: tuple[MgmFit, FitPosterior]) -> None:
    worse = replace(curved[0], objective=curved[0].objective + 100)
    assert "below the objective of the fit" in sample_posterior(worse, draws=128, particles=128).status


def test_progress_and_order(quick: MgmFit) -> None:
    told: list[tuple[int, int]] = []
    sample_batch([quick] * 2, draws=128, particles=128, progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 2), (2, 2)]


Z68, Z95 = 1.0, 1.959964


def held(model: MgmModel) -> MgmModel:
    """Centres and widths fixed: with a continuum of ln C the model is linear in all that is left."""
    for name in model.names:
        if name.endswith("_nm"):
            value = model.prior[model.index(name)] * 1e3
            model = model.bounded(name, value, value)
    return model


def fit_of(model: MgmModel, strengths: dict[str, float], seed: int = 1, noise: float = NOISE) -> MgmFit:
    ln = np.log(0.15 + 5e-5 * GRID)
    for band in model.assemblage.bands:
        depth = strengths.get(band.name, -0.3)
        ln = ln + depth * np.exp(-0.5 * ((GRID - band.center_nm) * 2.354820 / band.fwhm_nm) ** 2)
    ln = ln + np.random.default_rng(seed).normal(scale=noise, size=GRID.size)
    data = MgmData("made", GRID, np.exp(ln), np.full(GRID.size, NOISE**-2), np.zeros((0, GRID.size)), 0.0)
    return fit_data([data], model, 8)[0]


def linear_problem(fit: MgmFit) -> tuple[np.ndarray, np.ndarray]:
    """Design, (rows, free), and target of the least squares that a fit with fixed shapes is, prior rows included."""
    model, u = fit.model, (GRID - 1500) / 1100
    columns = [np.vander(u, 3, increasing=True)]
    sigmas = []
    for band in model.assemblage.bands:
        columns.append(np.exp(-0.5 * ((GRID - band.center_nm) * 2.354820 / band.fwhm_nm) ** 2)[:, None])
        sigmas.append(band.strength_sigma)
    prior = np.hstack([np.zeros((len(sigmas), 3)), np.diag(1 / np.array(sigmas))])
    design = np.vstack([np.hstack(columns) / NOISE, prior])
    return design, np.concatenate([np.log(fit.reflectance) / NOISE, np.zeros(len(sigmas))])


def test_a_linear_model_has_symmetric_intervals_of_its_standard_errors() -> None:
    model = held(mgm_model("OPX-CPX", "log-quadratic"))
    fit = fit_of(model, {})
    design, target = linear_problem(fit)
    best = np.linalg.lstsq(design, target, rcond=None)[0]
    sigma = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    bands = model.assemblage.bands
    names = [f"{band.key}_strength" for band in bands]
    found = profile_intervals(fit, ["c0", "c2", *names])
    for name, k in [("c0", 0), ("c2", 2), *zip(names, range(3, 3 + len(bands)), strict=True)]:
        interval = found[name]
        ends = [interval.low95, interval.low68, interval.high68, interval.high95]
        assert interval.value == pytest.approx(best[k], abs=0.02 * sigma[k])
        assert ends == pytest.approx(best[k] + sigma[k] * np.array([-Z95, -Z68, Z68, Z95]), abs=0.03 * sigma[k]), name


def test_a_strength_pressed_against_zero_has_one_end_there() -> None:
    """The rise of a quadratic objective in the distance t from the bound is 2 g t + h t^2; others follow freely."""
    model = held(mgm_model("OPX", "log-quadratic"))
    fit = fit_of(model, {"OPX 1": 0.002})
    k = 3 + [band.name for band in model.assemblage.bands].index("OPX 1")
    assert fit.bands[k - 3].strength == 0
    design, target = linear_problem(fit)
    others = np.delete(design, k, axis=1)
    rest = target - others @ np.linalg.lstsq(others, target, rcond=None)[0]
    column = design[:, k] - others @ np.linalg.lstsq(others, design[:, k], rcond=None)[0]
    h, g = column @ column, column @ rest
    expected = [-(-g + np.sqrt(g * g + h * z * z)) / h for z in (Z68, Z95)]
    assert g > 0, "the data want an emission band here"
    interval = profile_intervals(fit, ["opx_1_strength"])["opx_1_strength"]
    assert (interval.high68, interval.high95) == (0, 0)
    assert [interval.low68, interval.low95] == pytest.approx(expected, rel=0.03)


def test_a_curved_model_has_the_intervals_that_lmfit_finds() -> None:
    """lmfit.conf_interval searches the same objective with its own minimiser and its own brackets."""
    fit = fit_of(mgm_model("OPX"), {"visible 1": -0.05, "OPX 1": -0.1})
    minimizer = to_minimizer(fit)
    result = minimizer.minimize(method="leastsq")

    def probability(best: lmfit.minimizer.MinimizerResult, other: lmfit.minimizer.MinimizerResult) -> float:
        return 2 * NormalDist().cdf(np.sqrt(max(other.chisqr - best.chisqr, 0))) - 1

    names = ["opx_1_center_nm", "visible_1_strength", "opx_2_fwhm_nm"]
    theirs = lmfit.conf_interval(minimizer, result, p_names=names, sigmas=[0.6827, 0.95], prob_func=probability)
    ours = profile_intervals(fit, names)
    for name in names:
        low95, low68, _, high68, high95 = [value for _, value in theirs[name]]
        interval, width = ours[name], high68 - low68
        assert [interval.low68, interval.high68] == pytest.approx([low68, high68], abs=0.03 * width), name
        for own, other, bound in ((interval.low95, low95, to_lmfit(fit)[name].min), (interval.high95, high95, 0)):
            assert own == pytest.approx(bound if np.isinf(other) else other, abs=0.03 * width), name


def test_the_ratio_of_the_pyroxenes_has_the_interval_of_a_search_over_ratios() -> None:
    """Brute force: strengths (r, 1 - r) t with every other coefficient free, r on a fine grid."""
    model = held(mgm_model("OPX-CPX", "log-quadratic"))
    fit = fit_of(model, {"OPX 2": -0.03, "CPX 2": -0.06}, noise=3 * NOISE, seed=4)
    design, target = linear_problem(fit)
    names = [band.name for band in model.assemblage.bands]
    opx, cpx = 3 + names.index("OPX 2"), 3 + names.index("CPX 2")
    others = np.delete(design, [opx, cpx], axis=1)
    grid = np.linspace(0.001, 0.999, 999)
    rises = []
    for r in grid:
        columns = np.column_stack([others, r * design[:, opx] + (1 - r) * design[:, cpx]])
        solution = np.linalg.lstsq(columns, target, rcond=None)[0]
        rises.append(((target - columns @ solution) ** 2).sum())
    rises = np.array(rises) - np.min(rises)
    interval = profile_intervals(replace(fit, reduced_chi2=1.0), ["nbsr_um2_opx"])["nbsr_um2_opx"]
    for z, low, high in ((Z68, interval.low68, interval.high68), (Z95, interval.low95, interval.high95)):
        inside = grid[rises <= z * z]
        assert (low, high) == pytest.approx((inside[0], inside[-1]), abs=0.004)


def test_a_fixed_parameter_has_no_width() -> None:
    fit = fit_of(mgm_model("OPX").bounded("opx_1_center_nm", 920, 920), {})
    interval = profile_intervals(fit, ["opx_1_center_nm"])["opx_1_center_nm"]
    ends = [interval.low95, interval.low68, interval.value, interval.high68, interval.high95]
    assert ends == pytest.approx([920.0] * 5)


def test_centres_strengths_and_ratios_come_unasked() -> None:
    model = held(mgm_model("OPX-CPX", "log-quadratic"))
    found = profile_intervals(fit_of(model, {}))
    names = [interval.name for interval in found.intervals]
    expected = [name for name in model.names if name.endswith(("center_nm", "strength"))]
    assert names == [*expected, "nbsr_um1_opx", "nbsr_um2_opx"]
    assert found.to_dict()["method"] == "profile"


def test_an_unknown_name_is_refused_and_a_misfit_is_said() -> None:
    model = held(mgm_model("OPX", "log-quadratic"))
    fit = fit_of(model, {}, noise=3 * NOISE)
    with pytest.raises(ParameterError, match="no parameter 'slope'"):
        profile_intervals(fit, ["slope"])
    with pytest.warns(LunarSciWarning, match="reduced chi-square"):
        assert profile_intervals(fit, ["opx_1_strength"]).remarks


@pytest.fixture(scope="module")
def bench(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("bench_coverage")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "assemblage", "noise", "count", "errors"),
    [
        ("profile", "OPX", 0.005, 10, (0.1, 0.06)),
        ("sample", "OPX", 0.01, 5, (0.1, 0.06)),
        pytest.param("profile", "OPX-CPX", 0.005, 40, (0.035, 0.02), marks=pytest.mark.study),
        pytest.param("sample", "OPX", 0.01, 30, (0.035, 0.02), marks=pytest.mark.study),
    ],
)
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_shares_that_hold_the_truth(
    bench: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    method: str,
    assemblage: str,
    noise: float,
    count: int,
    errors: tuple[float, float],
) -> None:
    """Pyroxenes drawn from their prior; three standard errors of so few spectra are allowed.

    Every third channel with a noise less by the root of three says as much of bands of 100 nm and more as all of them.
    """
    monkeypatch.setattr(bench, "CHANNELS_NM", bench.CHANNELS_NM[::3])
    truth, _, ends, _ = bench.measure(mgm_model(assemblage), noise / np.sqrt(3), count, 1, [method])
    for hits, nominal, most in zip(bench.inside(truth, ends[method]), (0.6827, 0.95), errors, strict=True):
        found, error = bench.share(hits)
        assert error < most, "or the bounds below say nothing"
        assert abs(found - nominal) < 3 * error + 0.01, (method, nominal, found, error)
    assert np.all(np.diff(ends[method][:, :, [2, 0, 1, 3]], axis=2) >= 0), "68 % lies within 95 %"


def test_the_truth_of_the_simulation_follows_the_prior(bench: ModuleType) -> None:
    """Means and standard deviations of centres and widths; strengths half-normal: mean sigma (2 / pi)^1/2."""
    model = mgm_model("OPX")
    rng = np.random.default_rng(0)
    truth = np.array([bench.draw_truth(model, rng) for _ in range(4000)])
    sigma, m = model.sigma[model.degrees :], model.degrees
    assert np.allclose(truth.mean(axis=0)[::3], model.prior[m::3], atol=0.08 * sigma[::3].max())
    assert np.allclose(truth.std(axis=0)[::3], sigma[::3], rtol=0.06)
    assert np.allclose(truth.std(axis=0)[1::3], sigma[1::3], rtol=0.06)
    assert np.allclose(truth.mean(axis=0)[2::3], -sigma[2::3] * np.sqrt(2 / np.pi), rtol=0.06)
