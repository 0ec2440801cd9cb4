"""Profile intervals: exact limits worked out with linear algebra, and lmfit's own search on a curved case."""

from dataclasses import replace
from statistics import NormalDist

import lmfit
import numpy as np
import pytest

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import fit_data
from lunarsci.spectra.mgm.intervals import profile_intervals
from lunarsci.spectra.mgm.lmfit_interop import to_lmfit, to_minimizer
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFit

GRID = np.arange(450.0, 2396.0, 5.0)
NOISE = 0.005
Z68, Z95 = 1.0, 1.959964


def held(model: MgmModel) -> MgmModel:
    """Centres and widths fixed: with a continuum of ln C the model is linear in all that is left."""
    for name in model.names:
        if name.endswith("_nm"):
            value = model.prior[model.index(name)] * 1e3
            model = model.bounded(name, value, value)
    return model


def fitted(model: MgmModel, strengths: dict[str, float], seed: int = 1, noise: float = NOISE) -> MgmFit:
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
    fit = fitted(model, {})
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
    fit = fitted(model, {"OPX 1": 0.002})
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
    fit = fitted(mgm_model("OPX"), {"visible 1": -0.05, "OPX 1": -0.1})
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
    fit = fitted(model, {"OPX 2": -0.03, "CPX 2": -0.06}, noise=3 * NOISE, seed=4)
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
    fit = fitted(mgm_model("OPX").bounded("opx_1_center_nm", 920, 920), {})
    interval = profile_intervals(fit, ["opx_1_center_nm"])["opx_1_center_nm"]
    ends = [interval.low95, interval.low68, interval.value, interval.high68, interval.high95]
    assert ends == pytest.approx([920.0] * 5)


def test_centres_strengths_and_ratios_come_unasked() -> None:
    model = held(mgm_model("OPX-CPX", "log-quadratic"))
    found = profile_intervals(fitted(model, {}))
    names = [interval.name for interval in found.intervals]
    expected = [name for name in model.names if name.endswith(("center_nm", "strength"))]
    assert names == [*expected, "nbsr_um1_opx", "nbsr_um2_opx"]
    assert found.to_dict()["method"] == "profile"


def test_an_unknown_name_is_refused_and_a_misfit_is_said() -> None:
    model = held(mgm_model("OPX", "log-quadratic"))
    fit = fitted(model, {}, noise=3 * NOISE)
    with pytest.raises(ParameterError, match="no parameter 'slope'"):
        profile_intervals(fit, ["slope"])
    with pytest.warns(LunarSciWarning, match="reduced chi-square"):
        assert profile_intervals(fit, ["opx_1_strength"]).remarks
