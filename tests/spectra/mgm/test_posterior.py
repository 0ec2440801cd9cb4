"""Draws from the posterior against laws known in closed form or by brute force, and their reproducibility."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.stats import truncnorm

from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import fit_data
from lunarsci.spectra.mgm.forward import force_of, model_and_jacobian
from lunarsci.spectra.mgm.intervals import (
    FitPosterior,
    correct_coarse,
    posterior_intervals,
    sample_batch,
    sample_posterior,
)
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
    correct_coarse(target, groups, point, space)
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
    threads = numba.get_num_threads()
    batches = []
    for count in (1, threads):
        numba.set_num_threads(count)
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
