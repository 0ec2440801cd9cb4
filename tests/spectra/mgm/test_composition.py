"""Compositions from centres, against the posterior computed in full on a joint model, and what is withheld."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lunarsci
from lunarsci.pages.quantities import quantities
from lunarsci.spectra.jobs.verdicts import fit_verdict
from lunarsci.spectra.mgm.batch import compositions
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)


def olivine(fo: float, depth: float = 1.0) -> Spectrum:
    """Three bands on the trends of the table, written out: 905.9 - 0.696 Fo, 1068.1 - 0.401 Fo, 1307.0 - 1.133 Fo."""
    ln = np.log(0.3) + np.zeros(GRID.size)
    bands = ((905.9 - 0.696 * fo, 212, 0.2), (1068.1 - 0.401 * fo, 176, 0.25), (1307.0 - 1.133 * fo, 445, 0.4))
    for centre, fwhm, strength in bands:
        ln = ln - depth * strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    return Spectrum("ol", GRID, np.exp(ln), 0.001 * np.exp(ln))


def fitted(spectrum: Spectrum, name: str = "OL", **options: object) -> MgmFit:
    [fit] = fit_spectra([spectrum], mgm_model(name, **options), model_error=0.002)  # type: ignore[arg-type]
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
    fit = fitted(Spectrum("flat", GRID, np.full(GRID.size, 0.2), np.full(GRID.size, 1e-3)))
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
