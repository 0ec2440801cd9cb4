"""The same spectrum under several continua, and what their spread says."""

from dataclasses import replace

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.mgm.fit import (
    SPREAD_CONTINUA,
    check_continuum_removed,
    fit_continua,
    fit_spectra,
    with_continuum_spread,
)
from lunarsci.spectra.mgm.model import MGM_CONTINUA, mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)


def made(seed: int = 0) -> Spectrum:
    """Two pyroxenes over a bent continuum."""
    ln = np.log(0.12 + 9e-5 * GRID - 2e-8 * (GRID - 1500) ** 2)
    for centre, fwhm, strength in ((920, 190, -0.2), (1030, 210, -0.2), (1890, 500, -0.15), (2280, 540, -0.2)):
        ln = ln + strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    reflectance = np.exp(ln + np.random.default_rng(seed).normal(scale=0.004, size=GRID.size))
    return Spectrum("bent", GRID, reflectance, 0.004 * reflectance)


def test_the_spread_covers_all_separate_fits() -> None:
    spectra, calls = [made(0), Spectrum("short", GRID[:20], made().reflectance[:20]), made(1)], []
    found = fit_continua(
        spectra, lambda name: mgm_model("OPX-CPX", name), progress=lambda done, total: calls.append((done, total))
    )
    assert calls[-1] == (21, 21)
    assert [isinstance(fit, MgmFailure) for fit in found[1].values()] == [True] * 7
    separate = [fit_spectra([spectra[2]], mgm_model("OPX-CPX", name))[0] for name in SPREAD_CONTINUA]
    centres = [next(b.center_nm for b in fit.bands if b.name == "OPX 2") for fit in separate]  # type: ignore[union-attr]
    ratios = [fit.nbsr["um2"].opx for fit in separate]  # type: ignore[union-attr]
    own = found[2]["wavelength-quadratic"]
    assert isinstance(own, MgmFit)
    spread = with_continuum_spread(own, found[2])
    band = next(b for b in spread.bands if b.name == "OPX 2")
    assert band.center_continuum_nm == pytest.approx(np.max(np.abs(np.array(centres) - band.center_nm)), rel=1e-9)
    ratio = spread.nbsr["um2"]
    assert ratio is not None and ratio.continuum is not None
    assert (ratio.continuum_low, ratio.continuum_high) == pytest.approx((min(ratios), max(ratios)))
    assert all(abs(other - ratio.opx) <= ratio.continuum + 1e-12 for other in ratios)
    assert band.center_nm == next(b for b in own.bands if b.name == "OPX 2").center_nm
    assert spread.to_dict()["nbsr"]["um2"]["continuum"] == ratio.continuum


def test_a_continuum_that_leaves_the_ratio_open_opens_the_range() -> None:
    [fit] = fit_spectra([made()], mgm_model("OPX-CPX"))
    assert isinstance(fit, MgmFit)
    silent = replace(fit, continuum="wavelength", nbsr=fit.nbsr | {"um2": None})
    ratio = with_continuum_spread(fit, {"wavelength-quadratic": fit, "wavelength": silent}).nbsr["um2"]
    assert ratio is not None
    assert (ratio.continuum_low, ratio.continuum_high) == (0.0, 1.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_spread_of_a_band_is_the_largest_distance_to_either_side(sign: float) -> None:
    """Other continua 7 nm to one side and 4 nm to the other, and so on; one that did not converge says nothing."""
    [fit] = fit_spectra([made()], mgm_model("OPX-CPX"))
    assert isinstance(fit, MgmFit)
    ratio = fit.nbsr["um2"]
    assert ratio is not None

    def off(share: float) -> MgmFit:
        far = sign * share
        bands = tuple(
            replace(
                band,
                center_nm=band.center_nm + 7.0 * far,
                fwhm_nm=band.fwhm_nm - 20.0 * far,
                strength=band.strength + 0.03 * far,
            )
            for band in fit.bands
        )
        return replace(
            fit, continuum="wavelength", bands=bands, nbsr={"um2": replace(ratio, opx=ratio.opx + 0.05 * far)}
        )

    others = {"wavelength-quadratic": fit, "wavelength": off(1.0), "wavenumber": off(-4 / 7)}
    lost = replace(off(9.0), converged=False)
    found = with_continuum_spread(fit, others | {"log-quadratic": lost, "wavelength-cubic": off(0.2)})
    for band in found.bands:
        assert (band.center_continuum_nm, band.fwhm_continuum_nm) == pytest.approx((7.0, 20.0))
        assert band.strength_continuum == pytest.approx(0.03)
    spread = found.nbsr["um2"]
    assert spread is not None and spread.continuum == pytest.approx(0.05)
    ends = sorted((ratio.opx + 0.05 * sign, ratio.opx - 0.05 * sign * 4 / 7))
    assert (spread.continuum_low, spread.continuum_high) == pytest.approx(tuple(ends))


def test_a_spectrum_with_its_continuum_is_not_fitted_without_one() -> None:
    with pytest.raises(DataError, match="divided by their continuum"):
        check_continuum_removed([made()])
    check_continuum_removed([Spectrum("divided", GRID, made().reflectance / made().reflectance.max())])


def test_one_continuum_alone_has_no_spread() -> None:
    [fit] = fit_spectra([made()], mgm_model("OPX-CPX"))
    assert isinstance(fit, MgmFit)
    assert with_continuum_spread(fit, {"wavelength-quadratic": fit}).bands[0].center_continuum_nm is None


def test_a_spectrum_without_its_continuum_is_fitted_with_none() -> None:
    """Divided by the continuum that made it: strengths come back without a polynomial."""
    spectrum = made()
    ratio = spectrum.reflectance / (0.12 + 9e-5 * GRID - 2e-8 * (GRID - 1500) ** 2)
    [fit] = fit_spectra([Spectrum("ratio", GRID, ratio, 0.004 * ratio)], mgm_model("OPX-CPX", "none"), model_error=1e-3)
    assert isinstance(fit, MgmFit)
    assert fit.continuum_coefficients == ()
    strengths = {band.name: band for band in fit.bands}
    for name, truth in (("OPX 2", -0.15), ("CPX 2", -0.2)):
        assert abs(strengths[name].strength - truth) < 3 * strengths[name].strength_sigma
    assert np.allclose(fit.continuum_reflectance, 1.0)


def test_no_continuum_is_no_part_of_the_spread() -> None:
    assert set(MGM_CONTINUA) - set(SPREAD_CONTINUA) == {"none"}
