"""The compiled model against lmfit's Gaussian, its Jacobian against differences, its minimum against lmfit's."""

import lmfit
import numpy as np
import pytest
from lmfit.lineshapes import gaussian

from lunarsci.spectra.mgm.continuum import MGM_CONTINUA, continuum_basis, is_logarithmic
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, model_and_jacobian
from lunarsci.spectra.mgm.kernel import fit_batch

GRID_NM = np.arange(450.0, 2396.0, 5.0)
GRID = GRID_NM / 1e3
BANDS = np.array([[0.92, 0.19, -0.35], [1.02, 0.22, -0.20], [1.86, 0.52, -0.25], [2.30, 0.55, -0.15]])
POINT = np.concatenate([[0.4, 0.1], BANDS.ravel()])


def evaluated(point: np.ndarray, basis: np.ndarray, logarithmic: bool = False) -> tuple[np.ndarray, np.ndarray]:
    found = model_and_jacobian(point, GRID, basis, logarithmic)
    assert found is not None
    return found


def written_out(point: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """The same model from lmfit's area-normalised Gaussian."""
    total = np.log(basis @ point[: basis.shape[1]])
    for centre, fwhm, strength in point[basis.shape[1] :].reshape(-1, 3):
        sigma = fwhm / FWHM_OVER_SIGMA
        total = total + gaussian(GRID, strength * sigma * np.sqrt(2 * np.pi), centre, sigma)
    return total


def test_fwhm_over_sigma() -> None:
    """2 sqrt(2 ln 2) = 2.354820 (any table of the normal law)."""
    assert pytest.approx(2.354820, abs=1e-6) == FWHM_OVER_SIGMA


def test_model_is_gaussians_in_wavelength_over_a_continuum_in_the_logarithm() -> None:
    basis = continuum_basis("wavelength", GRID_NM)
    assert np.allclose(evaluated(POINT, basis)[0], written_out(POINT, basis), atol=1e-12)


@pytest.mark.parametrize("name", MGM_CONTINUA)
def test_jacobian_agrees_with_central_differences(name: str) -> None:
    basis = continuum_basis(name, GRID_NM)  # type: ignore[arg-type]
    logarithmic = is_logarithmic(name)  # type: ignore[arg-type]
    point = np.concatenate([[0.4, 0.1, 0.05, 0.02][: basis.shape[1]], BANDS.ravel()])
    _, jacobian = evaluated(point, basis, logarithmic)
    for k in range(point.size):
        step = np.zeros(point.size)
        step[k] = 1e-6
        forward, backward = evaluated(point + step, basis, logarithmic), evaluated(point - step, basis, logarithmic)
        assert np.allclose(jacobian[k], (forward[0] - backward[0]) / 2e-6, atol=1e-7), k


@pytest.mark.parametrize("name", ["log-quadratic", "none"])
def test_logarithmic_continua_are_polynomials_of_ln_c(name: str) -> None:
    basis = continuum_basis(name, GRID_NM)  # type: ignore[arg-type]
    coefficients = np.array([-1.5, 0.2, -0.1])[: basis.shape[1]]
    u = (GRID_NM - 1500) / 1100
    by_hand = coefficients @ np.vander(u, coefficients.size, increasing=True).T if coefficients.size else 0.0
    flat = np.array([[1.0, 0.2, 0.0]])
    model, _ = evaluated(np.concatenate([coefficients, flat.ravel()]), basis, True)
    assert np.allclose(model, by_hand, atol=1e-12)


def test_a_continuum_that_falls_to_zero_is_refused() -> None:
    basis = continuum_basis("wavelength", GRID_NM)
    below = POINT.copy()
    below[1] = -2.0
    assert model_and_jacobian(below, GRID, basis, False) is None


def test_the_minimum_is_that_of_lmfit() -> None:
    """lmfit with numerical derivatives on the same residuals (data and prior rows), strengths bounded at 0."""
    rng = np.random.default_rng(11)
    basis, noise = continuum_basis("wavelength", GRID_NM), 0.005
    data = written_out(POINT, basis) + rng.normal(scale=noise, size=GRID.size)
    prior = np.concatenate([[0, 0], np.array([[0.91, 0.2, 0], [1.03, 0.2, 0], [1.9, 0.5, 0], [2.3, 0.6, 0]]).ravel()])
    sigma = np.concatenate([[np.inf, np.inf], np.tile([0.02, 0.04, 0.5], 4)])
    upper = np.concatenate([[np.inf, np.inf], np.tile([np.inf, np.inf, 0.0], 4)])
    start = prior.copy()
    start[0], start[4::3] = 0.4, -0.1
    weight = np.full((1, GRID.size), noise**-2)
    found = fit_batch(
        data[None], weight, GRID, basis, False, prior, np.diag(sigma**-2.0), np.full(prior.size, -np.inf), upper,
        start[None, None], np.empty((0, 2)), 1e-8, 200,
    )  # fmt: skip

    parameters = lmfit.Parameters()
    for k, value in enumerate(start):
        parameters.add(f"p{k}", value=value, max=upper[k])

    def residual(current: lmfit.Parameters) -> np.ndarray:
        point = np.array([current[f"p{k}"].value for k in range(start.size)])
        return np.concatenate([(data - written_out(point, basis)) / noise, ((point - prior) / sigma)[2:]])

    best = lmfit.minimize(residual, parameters, method="least_squares", scale_covar=False, xtol=1e-12, ftol=1e-12)
    assert found.objective[0] == pytest.approx(best.chisqr, rel=1e-6)
    theirs = np.array([best.params[f"p{k}"].value for k in range(start.size)])
    errors = np.sqrt(np.diag(found.covariance[0]))
    assert np.all(np.abs(found.parameters[0] - theirs) < 1e-3 * errors)
    stderr = np.array([best.params[f"p{k}"].stderr for k in range(start.size)])
    assert np.allclose(errors, stderr, rtol=0.02)
