"""Parameters by name, priors that follow composition, and what can be fixed, bounded or tied."""

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.assemblages import FAMILIES
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import MGM_CONTINUA, MgmModel, constrained, mgm_model, parse_compositions, unit_of
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)


def two_pyroxenes(seed: int = 0) -> Spectrum:
    """Bands at 925, 1030, 1920 and 2260 nm on a straight continuum."""
    ln = np.log(0.2 + 4e-5 * GRID)
    for centre, fwhm, strength in ((925, 190, -0.3), (1030, 210, -0.25), (1920, 500, -0.2), (2260, 540, -0.2)):
        ln = ln + strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    noise = np.random.default_rng(seed).normal(scale=0.003, size=GRID.size)
    reflectance = np.exp(ln + noise)
    return Spectrum("px", GRID, reflectance, 0.003 * reflectance)


def fitted(model: MgmModel) -> MgmFit:
    [fit] = fit_spectra([two_pyroxenes()], model, model_error=0.003)
    assert fit.converged
    return fit


def value(fit: MgmFit, name: str) -> float:
    return float(fit.parameters[fit.model.index(name)] * unit_of(name))


def test_every_family_has_a_model_under_every_continuum() -> None:
    assert len(FAMILIES) == 15
    for family in FAMILIES:
        for continuum in MGM_CONTINUA:
            model = mgm_model(family, continuum)
            assert len(model.names) == model.prior.size == model.degrees + 3 * len(model.assemblage.bands)
            bands = model.precision[model.degrees :, model.degrees :]
            assert np.linalg.eigvalsh(bands)[0] > 0
            assert np.all(model.lower <= model.upper)


def test_centres_of_one_mineral_move_together_with_its_composition() -> None:
    """The prior's covariance of two centres is slope x slope x variance of the composition, all from the table."""
    model = mgm_model("OL")
    bands = {band.name: band for band in model.assemblage.bands}
    [olivine] = model.assemblage.compositions
    covariance = np.linalg.inv(model.precision[model.degrees :, model.degrees :])
    first, second = (model.index(name) - model.degrees for name in ("ol_m1_1_center_nm", "ol_m1_2_center_nm"))
    expected = bands["OL M1-1"].center_slope_nm * bands["OL M1-2"].center_slope_nm * olivine.sigma**2 / 1e6
    assert covariance[first, second] == pytest.approx(expected)
    own = bands["OL M1-1"]
    assert covariance[first, first] == pytest.approx(
        (own.center_sigma_nm**2 + (own.center_slope_nm * olivine.sigma) ** 2) / 1e6
    )


def test_a_stated_composition_moves_the_starting_centres_along_the_trend() -> None:
    table, stated = mgm_model("OL"), mgm_model("OL", compositions={"fo": (50, 2)})
    [olivine] = table.assemblage.compositions
    slope = next(band.center_slope_nm for band in table.assemblage.bands if band.name == "OL M2")
    k = table.index("ol_m2_center_nm")
    assert 1e3 * (stated.prior[k] - table.prior[k]) == pytest.approx(slope * (50 - olivine.mean))
    assert stated.sigma[k] < table.sigma[k]


def test_a_fixed_parameter_does_not_move_and_has_no_error() -> None:
    fit = fitted(constrained(mgm_model("OPX-CPX"), fixed=["opx_1_center_nm=925"]))
    assert value(fit, "opx_1_center_nm") == pytest.approx(925, abs=1e-9)
    band = next(band for band in fit.bands if band.name == "OPX 1")
    assert band.center_sigma_nm == 0
    assert band.fwhm_sigma_nm > 0


def test_a_bound_is_kept() -> None:
    free = value(fitted(mgm_model("OPX-CPX")), "cpx_1_fwhm_nm")
    fit = fitted(constrained(mgm_model("OPX-CPX"), bounds=[f"cpx_1_fwhm_nm=100:{free - 5}"]))
    assert value(fit, "cpx_1_fwhm_nm") <= free - 5 + 1e-9


def test_a_tie_is_kept_and_the_minimum_is_that_of_lmfit_with_the_same_expression() -> None:
    import lmfit

    from lunarsci.spectra.mgm.forward import model_and_jacobian

    free = mgm_model("OPX-CPX")
    model = constrained(free, ties=["cpx_1_fwhm_nm = 0.9*opx_1_fwhm_nm + 40"])
    fit = fitted(model)
    assert value(fit, "cpx_1_fwhm_nm") == pytest.approx(0.9 * value(fit, "opx_1_fwhm_nm") + 40, abs=0.01)
    parameters = lmfit.Parameters()
    for k, name in enumerate(free.names):
        parameters.add(name, value=fit.parameters[k], min=free.lower[k], max=free.upper[k])
    parameters["cpx_1_fwhm_nm"].expr = "0.9*opx_1_fwhm_nm + 0.040"
    root = np.linalg.cholesky(free.precision[free.degrees :, free.degrees :])

    def residual(current: lmfit.Parameters) -> np.ndarray:
        point = np.array([current[name].value for name in free.names])
        found = model_and_jacobian(point, GRID / 1e3, free.basis(GRID), free.logarithmic)
        data = np.sqrt(fit.data.weight) * (np.log(fit.reflectance) - found[0])
        return np.concatenate([data, root.T @ (point - free.prior)[free.degrees :]])

    best = lmfit.minimize(residual, parameters, scale_covar=False)
    ours = float((residual(fit_parameters(parameters, fit)) ** 2).sum())
    assert ours == pytest.approx(best.chisqr, abs=0.01)


def test_the_mean_beside_a_tie_is_that_of_a_normal_law_told_so() -> None:
    """In exact fractions, as m + C r (t - r'm) / r'C r; and to the same digits wherever it is computed."""
    from fractions import Fraction

    free = mgm_model("OPX-CPX")
    model = constrained(free, ties=["cpx_1_fwhm_nm = 0.9*opx_1_fwhm_nm + 40"])
    own, other = (free.index(f"{name}_1_fwhm_nm") for name in ("cpx", "opx"))
    block = np.ix_([own, other], [own, other])
    assert np.count_nonzero(free.precision[[own, other]]) == 2, "the widths are independent a priori"
    variance = [1 / Fraction(value) for value in np.diag(free.precision[block])]
    mean, row = [Fraction(free.prior[k]) for k in (own, other)], (Fraction(1), Fraction(-9, 10))
    through = [v * r for v, r in zip(variance, row, strict=True)]
    miss = Fraction(4, 100) - sum(r * m for r, m in zip(row, mean, strict=True))
    share = miss / (sum(r * t for r, t in zip(row, through, strict=True)))
    expected = [float(m + t * share) for m, t in zip(mean, through, strict=True)]
    assert model.prior[[own, other]] == pytest.approx(expected, rel=1e-9)
    assert np.array_equal(np.delete(model.prior, [own, other]), np.delete(free.prior, [own, other]))


def fit_parameters(parameters: object, fit: MgmFit) -> object:
    """lmfit parameters at the point of a fit."""
    import copy

    at = copy.deepcopy(parameters)
    for k, name in enumerate(fit.model.names):
        if at[name].expr is None:
            at[name].value = fit.parameters[k]
    return at


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fixed": ["opx_9_center_nm=900"]}, "there is no parameter 'opx_9_center_nm'"),
        ({"fixed": ["opx_1_center_nm=nan"]}, "write NAME or NAME=VALUE"),
        ({"fixed": ["opx_1_fwhm_nm=0"]}, "must stay above 0 nm"),
        ({"fixed": ["opx_1_strength=0.1"]}, "0 or below"),
        ({"bounds": ["opx_1_center_nm=950:900"]}, "from 950 to 900: bounds must rise"),
        ({"bounds": ["opx_1_center_nm=900"]}, "NAME=LOW:HIGH"),
        ({"ties": ["opx_1_center_nm=opx_1_center_nm"]}, "none to itself"),
        ({"ties": ["opx_1_center_nm=c0"]}, "coefficient to a band"),
        ({"ties": ["opx_1_center_nm=sin(opx_2_center_nm)"]}, "NAME=FACTOR"),
        ({"fixed": ["opx_1_center_nm=900"], "bounds": ["opx_1_center_nm=890:910"]}, "each name once"),
        ({"fixed": ["opx_1_center_nm=900", "opx_1_center_nm=910"]}, "each name once"),
        ({"fixed": ["c0"]}, "write c0=VALUE"),
        ({"fixed": ["opx_1_center_nm="]}, "write NAME or NAME=VALUE"),
        ({"ties": ["cpx_1_fwhm_nm=opx_1_fwhm_nm+400"]}, "cannot hold"),
        ({"ties": ["cpx_1_fwhm_nm=opx_1_fwhm_nm", "opx_1_fwhm_nm=cpx_1_fwhm_nm"]}, "circle"),
        ({"fixed": ["opx_1_center_nm=900"], "ties": ["cpx_1_center_nm=opx_1_center_nm"]}, "cannot hold"),
        ({"ties": ["opx_1_strength=1e300*cpx_1_strength"]}, "cannot hold"),
    ],
)
def test_impossible_constraints_say_why(options: dict[str, list[str]], said: str) -> None:
    with pytest.raises(ParameterError, match=said.replace("(", r"\(")):
        constrained(mgm_model("OPX-CPX"), **options)


def test_compositions_are_read_as_written() -> None:
    assert parse_compositions("Fo=70:5, fs=30:10") == {"fo": (70, 5), "fs": (30, 10)}
    for text in ("fo=70", "fo", "fo=a:5", "fo=70:5,fo=20:5", ""):
        with pytest.raises(ParameterError):
            parse_compositions(text)
    for stated in ({"fs": (30.0, 5.0)}, {"fo": (120.0, 5.0)}, {"fo": (50.0, 0.0)}):
        with pytest.raises(ParameterError):
            mgm_model("OL", compositions=stated)


def test_a_constant_factor_of_a_spectrum_with_a_held_continuum_is_not_ignored() -> None:
    """With c0 fixed the level of the spectrum matters; it is fitted as it is, not as a multiple."""
    free = fitted(mgm_model("OPX-CPX"))
    held = constrained(mgm_model("OPX-CPX"), fixed=[f"c0={free.continuum_coefficients[0]}"])
    again = fitted(held)
    sigma = np.sqrt(np.diag(free.covariance))[:3]
    assert np.all(np.abs(again.parameters[:3] - free.parameters[:3]) < 0.05 * sigma)
