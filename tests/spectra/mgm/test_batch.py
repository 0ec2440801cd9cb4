"""Fits as arrays: the same as fits one by one, in any company, as objects, as JSON and as a table."""

import json
from collections.abc import Sequence

import numpy as np
import pytest

import lunarsci
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.jobs.fit import MgmFits
from lunarsci.spectra.mgm.batch import NOT_FITTED
from lunarsci.spectra.mgm.fit import fit_arrays
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import mgm_model
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
        assert ln is not None
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
