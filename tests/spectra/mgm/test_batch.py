"""Fits as arrays: the same as fits one by one, in any company, as objects, as JSON and as a table.

Compositions from centres, against the posterior computed in full on a joint model, and what is withheld.

The move of a minimum under an error that all channels share: derivatives, and a minimum found by scipy.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import lunarsci
from lunarsci.arrays import FloatArray
from lunarsci.pages.parts import quantities
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.jobs.fit import MgmFits
from lunarsci.spectra.jobs.verdicts import fit_verdict
from lunarsci.spectra.mgm.batch import NOT_FITTED, compositions, follow_shifts, misfit_curvature
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import fit_arrays, fit_data, fit_spectra
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 10.0)
MODEL = mgm_model("OL-OPX-CPX")


def made(count: int) -> np.ndarray:
    """SYNTHETIC reflectance of known bands, with noise."""
    rng, found = np.random.default_rng(3), np.empty((count, GRID.size))
    for row in found:
        point = MODEL.prior.copy()
        point[:3] = rng.uniform(0.15, 0.3), rng.uniform(0.0, 0.05), 0.0
        point[5::3] = -rng.uniform(0.0, 0.4, size=point[5::3].size)
        ln = model_and_jacobian(point, GRID / 1e3, MODEL.basis(GRID), MODEL.logarithmic)
        row[:] = np.exp(ln[0] + rng.normal(scale=0.004, size=GRID.size))
    return found


@pytest.fixture(scope="module")
def reflectance() -> np.ndarray:
    """Eleven rows: one has lost channels, one all of them."""
    rows = made(11)
    rows[4, 30:35], rows[7] = np.nan, np.nan
    return rows


@pytest.fixture(scope="module")
def fits(reflectance: np.ndarray) -> MgmFits:
    spectra = [Spectrum(f"made {k}", GRID, row) for k, row in enumerate(reflectance)]
    return lunarsci.fit(spectra, starts=1)


def test_a_row_is_the_same_in_any_company(reflectance: np.ndarray) -> None:
    """To the bit: what a lane does depends on its own spectrum alone."""
    together = fit_arrays(GRID, reflectance, MODEL, starts=1)
    backwards = fit_arrays(GRID, reflectance[::-1], MODEL, starts=1).part(slice(None, None, -1))
    alone = fit_arrays(GRID, reflectance[4:5], MODEL, starts=1)
    for name in ("values", "sigma", "compositions", "rms_ln", "reduced_chi2", "um1", "um2", "status"):
        assert np.array_equal(getattr(together, name), getattr(backwards, name), equal_nan=True), name
        assert np.array_equal(getattr(together, name)[4:5], getattr(alone, name), equal_nan=True), name


def test_rows_without_channels_have_no_fit(reflectance: np.ndarray) -> None:
    found = fit_arrays(GRID, reflectance, MODEL, starts=1)
    assert np.flatnonzero(found.status == NOT_FITTED).tolist() == [7]
    assert np.isnan(found.values[7]).all()
    assert np.isfinite(np.delete(found.values, 7, axis=0)).all()


def test_a_descent_from_the_minimum_stays_there(reflectance: np.ndarray) -> None:
    rows = np.delete(reflectance, 7, axis=0)
    first = fit_arrays(GRID, rows, MODEL, starts=1)
    again = fit_arrays(GRID, rows, MODEL, starts=first.values)
    assert again.converged.all()
    assert np.all(again.objective <= first.objective + 1e-3)
    assert np.all(np.abs(again.values - first.values) <= 0.05 * first.sigma + 1e-9)


def same(found: object, expected: object) -> None:
    """Equal but for the last digits."""
    if isinstance(expected, dict):
        assert isinstance(found, dict) and found.keys() == expected.keys()
        for key in expected:
            same(found[key], expected[key])
    elif isinstance(expected, Sequence) and not isinstance(expected, str):
        assert isinstance(found, Sequence) and len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            same(one, other)
    else:
        assert found == (pytest.approx(expected, rel=1e-12) if isinstance(expected, float) else expected)


def test_records_are_those_of_the_fits_one_by_one(fits: MgmFits) -> None:
    document = json.loads(fits.to_json(time=False))["result"]["spectra"]
    for index, (record, fit) in enumerate(zip(document, fits.fits, strict=True)):
        shares = nbsr_abundance(fit) if index != 7 else None
        same(record, json.loads(json.dumps(lunarsci.provenance.plain(fits._record(index, fits.batch.origins[index])))))
        same(record["abundance"], lunarsci.provenance.plain(shares.to_dict()) if shares else None)


def test_rows_are_those_of_the_fits_one_by_one(fits: MgmFits) -> None:
    rows = list(fits.rows())
    assert len(rows) == 10 * len(MODEL.assemblage.bands) + 1
    assert [row["id"] for row in rows if row["name"] is None] == ["made 7"]
    for row in rows:
        fit = fits.fits[int(row["id"].split()[1])]
        band = next((band for band in fit.bands if band.name == row["name"]), None) if row["name"] else None
        if band is not None:
            assert row["center_nm"] == pytest.approx(band.center_nm, rel=1e-12)
            assert row["strength_sigma"] == pytest.approx(band.strength_sigma, rel=1e-12)
            assert row["shrinkage"]["fwhm"] == pytest.approx(band.shrinkage["fwhm"], rel=1e-9, abs=1e-12)
            assert row["at_bound"] == list(band.at_bound)


FINE = np.arange(450.0, 2396.0, 5.0)


def olivine(fo: float, depth: float = 1.0) -> Spectrum:
    """Three bands on the trends of the table, written out: 905.9 - 0.696 Fo, 1068.1 - 0.401 Fo, 1307.0 - 1.133 Fo."""
    ln = np.log(0.3) + np.zeros(FINE.size)
    bands = ((905.9 - 0.696 * fo, 212, 0.2), (1068.1 - 0.401 * fo, 176, 0.25), (1307.0 - 1.133 * fo, 445, 0.4))
    for centre, fwhm, strength in bands:
        ln = ln - depth * strength * np.exp(-4 * np.log(2) * ((FINE - centre) / fwhm) ** 2)
    return Spectrum("ol", FINE, np.exp(ln), 0.001 * np.exp(ln))


def fitted(spectrum: Spectrum, name: str = "OL", **options: object) -> MgmFit:
    [fit] = fit_spectra([spectrum], mgm_model(name, **options), model_error=0.002)
    assert isinstance(fit, MgmFit)
    return fit


@pytest.mark.parametrize("fo", [20.0, 50.0, 90.0])
def test_forsterite_of_bands_on_the_trend_comes_back(fo: float) -> None:
    [found] = compositions(fitted(olivine(fo)))
    assert found.key == "fo"
    assert found.mean == pytest.approx(fo, abs=3)
    assert found.sigma is not None
    assert found.sigma < 15 < found.prior_sigma
    assert found.in_range


def test_it_is_the_posterior_of_the_joint_model() -> None:
    """Centres and Fo together: prior rows (centre - trend(Fo)) / scatter and (Fo - mean) / sigma, and the data's rows
    on the centres, solved as one least-squares problem. The data's information is what the fit has beyond its prior."""
    fit = fitted(olivine(60.0))
    m = fit.model.degrees
    [item] = fit.model.assemblage.compositions
    precision = fit.model.precision[m:, m:]
    data = np.linalg.inv(fit.covariance[m:, m:]) - precision
    pull = np.linalg.inv(fit.covariance[m:, m:]) @ fit.parameters[m:] - precision @ fit.model.prior[m:]
    size = data.shape[0]
    scatter = np.linalg.inv(precision)
    slope = np.zeros(size)
    slope[::3] = [band.center_slope_nm / 1e3 for band in fit.model.assemblage.bands]
    own = np.linalg.inv(scatter - item.sigma**2 * np.outer(slope, slope))
    joint = np.zeros((size + 1, size + 1))
    joint[:size, :size] = own + data
    joint[:size, size] = joint[size, :size] = -own @ slope
    joint[size, size] = slope @ own @ slope + item.sigma**-2
    base = fit.model.prior[m:] - slope * item.mean
    right = np.append(own @ base + pull, -slope @ own @ base + item.mean / item.sigma**2)
    [found] = compositions(fit)
    assert found.mean == pytest.approx(np.linalg.solve(joint, right)[size], abs=1e-3)
    assert found.sigma == pytest.approx(np.sqrt(np.linalg.inv(joint)[size, size]), rel=1e-4)


def test_where_the_mineral_is_not_there_nothing_is_said() -> None:
    fit = fitted(Spectrum("flat", FINE, np.full(FINE.size, 0.2), np.full(FINE.size, 1e-3)))
    [found] = compositions(fit)
    assert (found.mean, found.sigma, found.in_range) == (None, None, False)


def test_what_the_trend_misses_stands_beside_the_error() -> None:
    """In the record, in the row and in the sentence; `sigma` is the fit's alone."""
    made = lunarsci.fit(olivine(60.0), assemblage="OL", model_error=0.002)
    [record], [row, *_] = made.to_dict()["spectra"], made.rows()
    found = record["compositions"]["fo"]
    assert found["trend_sigma"] == row["fo_trend_sigma"] == 10.0
    assert row["fo_sigma"] == found["sigma"]
    told = f"Fo of olivine {found['mean']:.0f} ± {found['sigma']:.0f} (fit) ± 10 (trend) mol %"
    assert told in fit_verdict(record)
    [shown] = [one for one in quantities({"compositions": record["compositions"]}) if "Fo" in one.name]
    assert shown.text.endswith("(fit) ± 10 (trend)")
    assert f"{found['mean']:.1f} ± {found['sigma']:.1f} (fit) ± 10 (trend) mol %" in str(made)


@pytest.mark.skipif("LUNARSCI_REFERENCE_DATA" not in os.environ, reason="needs measured spectra")
def test_of_a_chondrite_the_truth_lies_within_two_errors() -> None:
    """Tuxtuac (LL5), Fs 24.8 by its manifest: 43.0 +- 4.3 by the fit alone was 4.2 errors off."""
    file = Path(os.environ["LUNARSCI_REFERENCE_DATA"]) / "spectra/meteorites/reflectance.csv"
    [record] = lunarsci.fit(file, assemblage="OL-OPX", id="DP-JNG-007").to_dict()["spectra"]
    found = record["compositions"]["fs"]
    assert abs(found["mean"] - 24.8) > 2 * found["sigma"]
    assert abs(found["mean"] - 24.8) < 2 * np.hypot(found["sigma"], found["trend_sigma"])


def test_a_stated_composition_is_the_prior() -> None:
    """With a strict statement the spectrum changes nothing, with none it does."""
    [strict] = compositions(fitted(olivine(20.0), compositions={"fo": (80.0, 0.1)}))
    assert strict.mean == pytest.approx(80, abs=0.2)
    assert strict.prior_sigma == 0.1


def test_beyond_the_range_is_said() -> None:
    fit = fitted(olivine(60.0))
    parameters = fit.parameters.copy()
    parameters[fit.model.degrees :: 3] -= 0.2
    [found] = compositions(replace(fit, parameters=parameters))
    assert found.mean is not None
    assert found.mean > 100
    assert not found.in_range


def test_an_assemblage_without_compositions_has_none() -> None:
    assert compositions(fitted(olivine(60.0), "PLG")) == ()


def test_clinopyroxene_beside_orthopyroxene_has_other_priors() -> None:
    alone, beside = mgm_model("CPX").assemblage, mgm_model("OPX-CPX").assemblage
    assert [item.key for item in alone.compositions] == ["wo", "fs_cpx"]
    assert [item.key for item in beside.compositions] == ["fs", "wo"]
    wo = {name: next(i for i in a.compositions if i.key == "wo") for name, a in (("alone", alone), ("beside", beside))}
    assert wo["beside"].mean > wo["alone"].mean
    assert wo["beside"].sigma < wo["alone"].sigma


def model_at(point: FloatArray, model: MgmModel) -> tuple[FloatArray, FloatArray]:
    found = model_and_jacobian(point, GRID / 1e3, model.basis(GRID), model.logarithmic)
    assert found is not None
    return found


def tilted(model: MgmModel, shift: FloatArray) -> MgmFit:
    """Bands that the model can follow only in part."""
    point = model.prior.copy()
    point[: model.degrees] = 0.0
    point[0] = -1.5 if model.logarithmic else 0.2
    point[model.degrees + 2 :: 3] = -0.3
    ln = model_at(point, model)[0] + 0.1 * np.sin(GRID / 200)
    weight = np.linspace(0.5, 2, GRID.size) / 0.01**2
    data = MgmData("made", GRID, np.exp(ln), weight, shift[None], 0.0)
    return fit_data([data], model, 4)[0]


@pytest.mark.parametrize("continuum", ["wavelength", "log-quadratic"])
def test_second_derivatives_agree_with_differences_of_the_first(continuum: str) -> None:
    model = mgm_model("OPX-CPX", continuum)
    fit = tilted(model, np.zeros(GRID.size))
    pull = np.random.default_rng(0).normal(size=GRID.size)
    jacobian = model_at(fit.parameters, model)[1]
    found = misfit_curvature(fit.data, model, fit.parameters, jacobian, pull)
    for k, row in enumerate(found):
        step = np.zeros(fit.parameters.size)
        step[k] = 1e-5
        difference = [model_at(fit.parameters + sign * step, model)[1] @ pull for sign in (1, -1)]
        expected = (difference[0] - difference[1]) / 2e-5
        assert np.allclose(row, expected, rtol=1e-5, atol=1e-6 * np.abs(found).max()), model.names[k]


def check_shifts(data: MgmData, model: MgmModel, fit: MgmFit, free: np.ndarray, shift: FloatArray) -> FloatArray:
    """How the minimum is stated to move, held against scipy's for data a little up and a little down; the statement."""
    root = np.linalg.cholesky(model.precision + 1e-14 * np.eye(free.size)).T

    def rows(values: FloatArray, ln: FloatArray) -> FloatArray:
        point = fit.parameters.copy()
        point[free] = values
        residual = np.sqrt(data.weight) * (model_at(point, model)[0] - ln)
        return np.concatenate([residual, root @ (point - model.prior)])

    ends = []
    for share in (0.02, -0.02):
        ln = np.log(data.reflectance) + share * shift
        end = least_squares(rows, fit.parameters[free], args=(ln,), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        ends.append(end.x)
    ln_model, jacobian = model_at(fit.parameters, model)
    [stated] = follow_shifts(data, model, fit.parameters, ln_model, jacobian)
    effect = np.sqrt((jacobian[free] ** 2).sum(axis=1))
    found = (ends[0] - ends[1]) / 0.04 * effect
    assert np.allclose(stated[free] * effect, found, rtol=0.05, atol=0.02 * np.abs(found).max())
    return np.asarray(stated)


def test_the_minimum_moves_as_stated() -> None:
    """The misfit is several times the noise."""
    model, shift = mgm_model("OPX"), 0.05 * np.cos(GRID / 500)
    fit = tilted(model, shift)
    free = ~((fit.parameters <= model.lower) | (fit.parameters >= model.upper))
    check_shifts(fit.data, model, fit, free, shift)


def test_parameters_on_a_bound_stay_and_the_others_follow() -> None:
    """Bands that are not there end at strength 0, where the objective may bend down."""
    model = mgm_model("OL-OPX-CPX")
    point = model.prior.copy()
    point[:3], point[5::3] = (0.2, 0.0, 0.0), 0.0
    for name in ("uv_strength", "opx_1_strength", "opx_2_strength"):
        point[model.index(name)] = -0.4
    ln = model_at(point, model)[0] + 0.05 * np.sin(GRID / 200)
    shift = 0.05 * np.cos(GRID / 500)
    data = MgmData("made", GRID, np.exp(ln), np.full(GRID.size, 0.02**-2), shift[None], 0.02)
    [fit] = fit_data([data], model, 4)
    held = ((fit.parameters <= model.lower) | (fit.parameters >= model.upper)) & ~model.fixed
    assert held.any()
    assert not check_shifts(data, model, fit, ~held, shift)[held].any()


def test_without_such_errors_nothing_is_said() -> None:
    model = mgm_model("OPX")
    fit = tilted(model, np.zeros(GRID.size))
    data = replace(fit.data, shifts=np.zeros((0, GRID.size)))
    assert follow_shifts(data, model, fit.parameters, *model_at(fit.parameters, model)).shape == (
        0,
        fit.parameters.size,
    )
