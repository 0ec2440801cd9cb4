"""A fit handed to lmfit and back: the same objective, ties, bounds and refusals."""

from collections.abc import Iterator

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm import fit as fit_module
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.lmfit_interop import refit, to_lmfit, to_minimizer
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)
NOISE = 0.005


def spectrum(model: MgmModel, seed: int = 1, strength: float = -0.3) -> Spectrum:
    """Every band 10 nm beside its prior centre, over a straight continuum."""
    ln = np.log(0.15 + 5e-5 * GRID)
    for band in model.assemblage.bands:
        ln = ln + strength * np.exp(-0.5 * ((GRID - band.center_nm - 10) * 2.354820 / band.fwhm_nm) ** 2)
    reflectance = np.exp(ln + np.random.default_rng(seed).normal(scale=NOISE, size=GRID.size))
    return Spectrum("made", GRID, reflectance, NOISE * reflectance)


@pytest.fixture(autouse=True)
def converged_to_the_last_digit() -> Iterator[None]:
    """Fits end within a ten-thousandth of chi-square of their minimum; comparisons here are finer than that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_module, "TOLERANCE", 1e-11)
        yield


def fitted(model: MgmModel) -> MgmFit:
    [fit] = fit_spectra([spectrum(model)], model, model_error=1e-4)
    assert isinstance(fit, MgmFit)
    return fit


def same(first: MgmFit, second: MgmFit, sigmas: float = 1e-3) -> None:
    errors = np.sqrt(np.diag(first.covariance))
    assert second.objective == pytest.approx(first.objective, rel=1e-6)
    assert np.all(np.abs(second.parameters - first.parameters) <= sigmas * errors + 1e-9)


def test_values_bounds_errors_and_correlations_are_those_of_the_fit() -> None:
    model = mgm_model("OPX").bounded("opx_1_fwhm_nm", 190, 190)
    fit = fitted(model)
    parameters = to_lmfit(fit)
    by_name = {band.name: band for band in fit.bands}
    assert tuple(parameters) == model.names
    opx = by_name["OPX 1"]
    assert parameters["opx_1_center_nm"].value == pytest.approx(opx.center_nm)
    assert parameters["opx_1_center_nm"].stderr == pytest.approx(opx.center_sigma_nm)
    assert parameters["opx_1_strength"].stderr == pytest.approx(opx.strength_sigma)
    assert parameters["opx_1_strength"].max == 0
    assert not parameters["opx_1_fwhm_nm"].vary
    assert parameters["opx_1_fwhm_nm"].value == pytest.approx(190)
    a, b = model.index("opx_1_strength"), model.index("opx_2_strength")
    expected = fit.covariance[a, b] / np.sqrt(fit.covariance[a, a] * fit.covariance[b, b])
    assert parameters["opx_1_strength"].correl["opx_2_strength"] == pytest.approx(expected)


def test_an_unchanged_fit_comes_back_the_same() -> None:
    fit = fitted(mgm_model("OPX-CPX"))
    again = refit(fit, to_lmfit(fit))
    assert again.converged
    same(fit, again)
    assert np.allclose(again.covariance, fit.covariance, rtol=1e-3, atol=1e-12)
    assert again.nbsr["um2"].opx == pytest.approx(fit.nbsr["um2"].opx, abs=1e-5)


def test_derivatives_agree_with_differences() -> None:
    fit = fitted(mgm_model("OPX"))
    minimizer = to_minimizer(fit)
    parameters = to_lmfit(fit)
    analytic = minimizer.kws["Dfun"](parameters)
    for column, name in enumerate(n for n in fit.model.names if parameters[n].vary):
        ends = []
        for step in (-1e-4, 1e-4):
            moved = to_lmfit(fit)
            moved[name].set(value=moved[name].value + step, min=-np.inf, max=np.inf)
            ends.append(minimizer.userfcn(moved))
        difference = (ends[1] - ends[0]) / 2e-4
        assert np.allclose(analytic[:, column], difference, rtol=1e-5, atol=1e-6 * np.abs(difference).max()), name


def test_other_values_lead_back_to_the_same_minimum() -> None:
    fit = fitted(mgm_model("OPX"))
    parameters = to_lmfit(fit)
    parameters["opx_1_center_nm"].value += 5
    parameters["opx_2_strength"].value *= 1.3
    again = refit(fit, parameters)
    assert again.converged
    same(fit, again)


def test_bounds_and_fixed_values_are_those_of_a_bounded_model() -> None:
    model = mgm_model("OPX")
    fit = fitted(model)
    parameters = to_lmfit(fit)
    parameters["opx_1_center_nm"].set(value=920, vary=False)
    parameters["opx_2_strength"].set(value=-0.2, min=-0.25)
    changed = model.bounded("opx_1_center_nm", 920, 920).bounded("opx_2_strength", -0.25, 0)
    other = refit(fit, parameters)
    same(fitted(changed), other, sigmas=2e-3)
    assert other.model.fixed[model.index("opx_1_center_nm")]
    assert "strength" in {band.name: band for band in other.bands}["OPX 2"].at_bound


def test_a_linear_expression_is_the_tie_of_the_model() -> None:
    model = mgm_model("OPX")
    fit = fitted(model)
    parameters = to_lmfit(fit)
    parameters["opx_2_strength"].expr = "1.5 * opx_1_strength - 0.01"
    other = refit(fit, parameters)
    tied = fitted(model.tied("opx_2_strength", 1.5, "opx_1_strength", -0.01))
    assert np.all(np.abs(other.parameters - tied.parameters) < 1e-2 * np.sqrt(np.diag(tied.covariance)) + 1e-5)
    by_name = {band.name: band for band in other.bands}
    assert by_name["OPX 2"].strength == pytest.approx(1.5 * by_name["OPX 1"].strength - 0.01, abs=1e-8)
    assert by_name["OPX 2"].strength_sigma == pytest.approx(1.5 * by_name["OPX 1"].strength_sigma, rel=1e-3)
    assert other.objective > fit.objective


def test_errors_of_a_curved_expression_are_those_that_lmfit_propagates() -> None:
    fit = fitted(mgm_model("OPX"))
    parameters = to_lmfit(fit)
    parameters["opx_2_fwhm_nm"].expr = "opx_1_fwhm_nm ** 2 / 75 + 30"
    other = refit(fit, parameters)
    assert other.reduced_chi2 < 1, "else the errors are widened by it, and lmfit's are not"
    result = to_minimizer(fit, parameters).minimize(method="least_squares")
    theirs = result.params["opx_2_fwhm_nm"]
    by_name = {band.name: band for band in other.bands}
    assert by_name["OPX 2"].fwhm_nm == pytest.approx(theirs.value, abs=0.02 * theirs.stderr)
    assert by_name["OPX 2"].fwhm_sigma_nm == pytest.approx(theirs.stderr, rel=0.02)
    slope = 2 * by_name["OPX 1"].fwhm_nm / 75
    assert by_name["OPX 2"].fwhm_sigma_nm == pytest.approx(slope * by_name["OPX 1"].fwhm_sigma_nm, rel=1e-3)


def test_what_cannot_be_taken_back_is_refused() -> None:
    fit = fitted(mgm_model("OPX"))
    lacking = to_lmfit(fit)
    del lacking["c0"]
    with pytest.raises(ParameterError, match="lack c0"):
        refit(fit, lacking)
    unknown = to_lmfit(fit)
    unknown.add("slope", value=1.0)
    with pytest.raises(ParameterError, match="slope vary beside"):
        refit(fit, unknown)
    emission = to_lmfit(fit)
    emission["opx_1_strength"].max = 0.1
    with pytest.raises(ParameterError, match="bands absorb"):
        refit(fit, emission)
    mixed = to_lmfit(fit)
    mixed["opx_1_strength"].expr = "-c0"
    with pytest.raises(ParameterError, match="continuum coefficient"):
        refit(fit, mixed)
