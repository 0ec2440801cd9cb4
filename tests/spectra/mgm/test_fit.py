"""Fits of spectra made from known bands, invariances, hostile spectra, and real measurements.

The same spectrum under several continua, and what their spread says.

A fit is the same in other units, in any order of channels, times a constant, alone or in a batch: to 1e-9.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.spectra.mgm import MgmContinuum
from lunarsci.spectra.mgm.assemblages import assemblage
from lunarsci.spectra.mgm.fit import (
    SPREAD_CONTINUA,
    check_continuum_removed,
    fit_continua,
    fit_spectra,
    starting_points,
    with_continuum_spread,
)
from lunarsci.spectra.mgm.intervals import ratios_of
from lunarsci.spectra.mgm.model import MGM_CONTINUA, mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)
MODEL = mgm_model()
ALL = MODEL.assemblage
STRENGTHS = {
    "uv": -0.5,
    "visible 1": -0.1,
    "visible 2": -0.08,
    "OL M1-1": -0.08,
    "OL M2": -0.15,
    "OL M1-2": -0.1,
    "OPX 1": -0.3,
    "OPX M1": -0.03,
    "OPX 2": -0.25,
    "CPX 1": -0.2,
    "CPX M1": -0.03,
    "CPX 2": -0.15,
}


def made(strengths: dict[str, float], seed: int | None = None, noise: float = 0.005, name: str = "made") -> Spectrum:
    """A spectrum with every band at its prior centre and width, over a straight continuum."""
    ln = np.log(0.15 + 5e-5 * GRID)
    for band in ALL.bands:
        sigma = band.fwhm_nm / 2.354820
        ln = ln + strengths[band.name] * np.exp(-0.5 * ((GRID - band.center_nm) / sigma) ** 2)
    error = np.zeros(GRID.size) if seed is None else np.random.default_rng(seed).normal(scale=noise, size=GRID.size)
    reflectance = np.exp(ln + error)
    return Spectrum(name, GRID, reflectance, noise * reflectance)


def fitted(spectrum: Spectrum, **options: object) -> MgmFit:
    [result] = fit_spectra([spectrum], MODEL, **options)
    assert isinstance(result, MgmFit)
    return result


def test_known_bands_come_back() -> None:
    fit = fitted(made(STRENGTHS), model_error=0.001)
    assert fit.converged
    assert fit.rms_ln < 1e-3
    for band in fit.bands:
        assert band.strength == pytest.approx(STRENGTHS[band.name], abs=3 * band.strength_sigma)
        assert band.strength <= 0
    ratio = fit.nbsr["um2"]
    assert ratio.opx == pytest.approx(0.25 / 0.40, abs=0.03)
    assert ratio.opx + ratio.cpx == pytest.approx(1)


def test_the_ratio_at_1_um_is_that_of_the_bands_near_0_9_and_1_um() -> None:
    """Kanner, Mustard & Gendrin (2007), 10.1016/j.icarus.2006.10.025; not of the M1 bands near 1.2 um."""
    fit = fitted(made(STRENGTHS), model_error=0.001)
    strengths = {band.name: band.strength for band in fit.bands}
    ratio = fit.nbsr["um1"]
    assert ratio.opx == pytest.approx(strengths["OPX 1"] / (strengths["OPX 1"] + strengths["CPX 1"]))
    assert ratio.opx == pytest.approx(
        STRENGTHS["OPX 1"] / (STRENGTHS["OPX 1"] + STRENGTHS["CPX 1"]), abs=3 * ratio.sigma
    )
    name = "nbsr_um1_opx"
    assert ratios_of(fit.parameters[None], fit.model, fit.wavelength_nm)[name] == pytest.approx(ratio.opx)


@pytest.mark.slow
def test_errors_cover_the_truth_about_as_often_as_they_say() -> None:
    """Truth drawn from the prior itself, 200 spectra; Laplace errors under-cover a little, so the bounds are wide."""
    rng, m = np.random.default_rng(3), MODEL.degrees
    root = np.linalg.cholesky(np.linalg.inv(MODEL.precision[m:, m:]))
    spectra, truths = [], []
    for number in range(200):
        drawn = (MODEL.prior[m:] + root @ rng.normal(size=root.shape[0])).reshape(-1, 3)
        ln, truth = np.log(0.15 + 5e-5 * GRID), []
        for centre_um, fwhm_um, _ in drawn:
            centre, fwhm, strength = 1e3 * centre_um, 1e3 * fwhm_um, -abs(rng.normal(0.3, 0.05))
            truth.append((centre, fwhm, strength))
            ln = ln + strength * np.exp(-0.5 * ((GRID - centre) * 2.354820 / fwhm) ** 2)
        reflectance = np.exp(ln + rng.normal(scale=0.01, size=GRID.size))
        spectra.append(Spectrum(str(number), GRID, reflectance, 0.01 * reflectance))
        truths.append(truth)
    fits = fit_spectra(spectra, MODEL, model_error=1e-4)
    inside = [
        [
            abs(band.center_nm - centre) < band.center_sigma_nm,
            abs(band.fwhm_nm - fwhm) < band.fwhm_sigma_nm,
            abs(band.strength - strength) < band.strength_sigma,
        ]
        for fit, truth in zip(fits, truths, strict=True)
        if isinstance(fit, MgmFit)
        for band, (centre, fwhm, strength) in zip(fit.bands, truth, strict=True)
    ]
    coverage = np.mean(inside, axis=0)
    assert np.all((coverage > 0.58) & (coverage < 0.76)), coverage


def test_shrinkage_tells_data_from_prior() -> None:
    """Without channels beyond 1.4 um the 2 um bands are what the prior and the 1 um bands of the same mineral say."""
    spectrum = made(STRENGTHS, seed=1)
    short = GRID < 1400
    cut = Spectrum("cut", GRID[short], spectrum.reflectance[short], spectrum.uncertainty[short])
    by_name, whole = ({band.name: band for band in fitted(one).bands} for one in (cut, spectrum))
    assert by_name["CPX 2"].shrinkage["center"] < 0.1
    assert by_name["CPX 2"].strength_sigma > 3 * whole["CPX 2"].strength_sigma
    assert by_name["OPX 1"].shrinkage["strength"] > 0.8


def test_a_ratio_that_the_data_do_not_tell_is_not_given() -> None:
    spectrum = made(STRENGTHS, seed=1)
    short = GRID < 1400
    cut = Spectrum("cut", GRID[short], spectrum.reflectance[short], spectrum.uncertainty[short])
    assert fitted(cut).nbsr["um2"] is None
    flat = Spectrum("flat", GRID, 0.2 + 0.002 * np.random.default_rng(1).standard_normal(GRID.size))
    assert fitted(flat).nbsr == {"um1": None, "um2": None}


def test_a_band_far_from_its_prior_is_said() -> None:
    """An absorption at 1.7 um, where none of these minerals has one."""
    ln = np.log(0.3) - 0.4 * np.exp(-0.5 * ((GRID - 1680) / 100) ** 2)
    assert "strained: " in fitted(Spectrum("odd", GRID, np.exp(ln), 0.002 * np.exp(ln)), model_error=0.002).status


def test_spectra_that_cannot_be_fitted_say_why() -> None:
    good = made(STRENGTHS, seed=5)
    few = Spectrum("few", GRID[:30], good.reflectance[:30])
    infrared = Spectrum("infrared", GRID[200:], good.reflectance[200:])
    dark = Spectrum("dark", GRID, np.zeros(GRID.size))
    results = fit_spectra([few, good, infrared, dark], MODEL)
    assert [isinstance(result, MgmFailure) for result in results] == [True, False, True, True]
    assert [result.id for result in results] == ["few", "made", "infrared", "dark"]
    assert "30 usable channels" in results[0].status
    assert "800-1300 nm" in results[2].status
    assert "0 usable channels" in results[3].status
    assert results[0].to_dict().keys() == results[1].to_dict().keys()


@pytest.mark.parametrize(("first", "last"), [(735, 2140), (800, 1000), (1000, 1100)])
def test_a_fit_needs_channels_without_a_wide_gap(first: float, last: float) -> None:
    [result] = fit_spectra([replace(made(STRENGTHS, seed=5), mask=(first < GRID) & (last > GRID))], MODEL)
    assert isinstance(result, MgmFailure) == (last - first > 100)
    assert (f"no usable channel from {first} to {last} nm" in result.status) == (last - first > 100)


def test_a_subset_of_minerals_has_their_bands_only() -> None:
    assert assemblage("orthopyroxene, olivine") == assemblage("OL-OPX")
    [fit] = fit_spectra([made(STRENGTHS)], mgm_model("ol-opx"))
    assert fit.assemblage == "OL-OPX"
    assert {band.mineral for band in fit.bands} == {"any", "olivine", "orthopyroxene"}
    assert fit.nbsr == {"um1": None, "um2": None}


@pytest.mark.parametrize("name", ["OL-OL", "GARNET", "", "OL OPX"])
def test_unknown_assemblages_list_the_known_minerals(name: str) -> None:
    with pytest.raises(ParameterError, match="OL, OPX, CPX"):
        assemblage(name)


@pytest.mark.parametrize("options", [{"model_error": 0.0}, {"model_error": np.nan}, {"starts": -1}])
def test_impossible_options_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        fit_spectra([made(STRENGTHS)], MODEL, **options)


@pytest.mark.reference
@pytest.mark.slow
def test_every_measured_spectrum_gets_a_result(reference_data: Path) -> None:
    for file, count in (("ce4/reflectance_factor.csv", 88), ("relab/reflectance.csv", 172)):
        spectra = read_spectra(read_input(str(reference_data / "spectra" / file)))
        results = fit_spectra(spectra, MODEL)
        assert len(results) == count
        for result in results:
            assert isinstance(result, MgmFit) or result.status.startswith("no result: ")
            values = [v for band in result.to_dict()["bands"] for v in band.values() if isinstance(v, float)]
            assert np.isfinite(values).all()


@pytest.mark.reference
def test_nbsr_at_2_um_ranks_the_orthopyroxene_clinopyroxene_mixtures(reference_data: Path) -> None:
    """The nine mixtures finer than 45 um; true fractions from the manifest of the reference data."""
    import pandas as pd

    manifest = pd.read_csv(reference_data / "spectra/relab/manifest.csv").set_index("id")
    series = manifest[manifest.index.str.match(r"(XP|PE|PP)-CMP-") & (manifest["max_um"] <= 45)]
    assert len(series) == 9
    spectra = read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))
    fits = {fit.id: fit for fit in fit_spectra([s for s in spectra if s.id in series.index], MODEL)}
    ratios = [fits[name].nbsr["um2"].opx for name in series.index]
    assert spearmanr(ratios, series["vol_opx"]).statistic == pytest.approx(1.0)


@pytest.mark.parametrize("continuum", ["wavelength", "log-quadratic"])
def test_starts_are_level_in_the_brightest_and_within_two_sigma_and_the_bounds(continuum: MgmContinuum) -> None:
    """ln R in 101 equal steps has its 95th percentile at the 95th step; bands start 10 % deep in ln R."""
    ln_reflectance = np.linspace([-1.0, -3.0], [0.0, -1.0], 101, axis=1)
    level = np.array([-0.05, -1.1]) if continuum == "log-quadratic" else np.exp([-0.05, -1.1])
    model = mgm_model(continuum=continuum).bounded("opx_1_center_nm", 910.0, 925.0)
    starts = starting_points(model, ln_reflectance, 40)
    m = model.degrees
    assert starts.shape == (40, 2, model.prior.size)
    assert starts[:, :, 0] == pytest.approx(np.tile(level, (40, 1))) and not starts[:, :, 1:m].any()
    assert (starts[:, :, m + 2 :: 3] == -0.1).all()
    assert starts[0, :, m::3] == pytest.approx(np.tile(np.clip(model.prior, model.lower, model.upper)[m::3], (2, 1)))
    for kind in (m, m + 1):
        moved = (starts[1:, 0] - model.prior)[:, kind::3] / model.sigma[kind::3]
        assert -2.0 - 1e-9 < moved.min() < -1.8 and 1.8 < moved.max() < 2.0 + 1e-9
    centers = 1e3 * starts[:, :, model.index("opx_1_center_nm")]
    assert (centers >= 910.0 - 1e-9).all() and (centers <= 925.0 + 1e-9).all() and np.ptp(centers) > 10.0
    lowest, highest = level.mean(), 9.0
    kept = starting_points(model.bounded("c0", lowest, highest), ln_reflectance, 2)[:, :, 0]
    assert kept == pytest.approx(np.tile(np.maximum(level, lowest), (2, 1)))
    kept = starting_points(model.bounded("c0", -9.0, lowest), ln_reflectance, 2)[:, :, 0]
    assert kept == pytest.approx(np.tile(np.minimum(level, lowest), (2, 1)))


def bent(seed: int = 0) -> Spectrum:
    """Two pyroxenes over a bent continuum."""
    ln = np.log(0.12 + 9e-5 * GRID - 2e-8 * (GRID - 1500) ** 2)
    for centre, fwhm, strength in ((920, 190, -0.2), (1030, 210, -0.2), (1890, 500, -0.15), (2280, 540, -0.2)):
        ln = ln + strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    reflectance = np.exp(ln + np.random.default_rng(seed).normal(scale=0.004, size=GRID.size))
    return Spectrum("bent", GRID, reflectance, 0.004 * reflectance)


def test_the_spread_covers_all_separate_fits() -> None:
    spectra, calls = (
        [bent(0), Spectrum("short", GRID[:20], bent().reflectance[:20]), bent(1)],
        [],
    )
    found = fit_continua(
        spectra, lambda name: mgm_model("OPX-CPX", name), progress=lambda done, total: calls.append((done, total))
    )
    assert calls[-1] == (21, 21)
    assert [isinstance(fit, MgmFailure) for fit in found[1].values()] == [True] * 7
    separate = [fit_spectra([spectra[2]], mgm_model("OPX-CPX", name))[0] for name in SPREAD_CONTINUA]
    centres = [next(b.center_nm for b in fit.bands if b.name == "OPX 2") for fit in separate]
    ratios = [fit.nbsr["um2"].opx for fit in separate]
    own = found[2]["wavelength-quadratic"]
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
    [fit] = fit_spectra([bent()], mgm_model("OPX-CPX"))
    silent = replace(fit, continuum="wavelength", nbsr=fit.nbsr | {"um2": None})
    ratio = with_continuum_spread(fit, {"wavelength-quadratic": fit, "wavelength": silent}).nbsr["um2"]
    assert (ratio.continuum_low, ratio.continuum_high) == (0.0, 1.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_spread_of_a_band_is_the_largest_distance_to_either_side(sign: float) -> None:
    """Other continua 7 nm to one side and 4 nm to the other, and so on; one that did not converge says nothing."""
    [fit] = fit_spectra([bent()], mgm_model("OPX-CPX"))
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
        check_continuum_removed([bent()])
    check_continuum_removed([Spectrum("divided", GRID, bent().reflectance / bent().reflectance.max())])


def test_one_continuum_alone_has_no_spread() -> None:
    [fit] = fit_spectra([bent()], mgm_model("OPX-CPX"))
    assert isinstance(fit, MgmFit)
    assert with_continuum_spread(fit, {"wavelength-quadratic": fit}).bands[0].center_continuum_nm is None


def test_a_spectrum_without_its_continuum_is_fitted_with_none() -> None:
    """Divided by the continuum that made it: strengths come back without a polynomial."""
    spectrum = bent()
    ratio = spectrum.reflectance / (0.12 + 9e-5 * GRID - 2e-8 * (GRID - 1500) ** 2)
    [fit] = fit_spectra([Spectrum("ratio", GRID, ratio, 0.004 * ratio)], mgm_model("OPX-CPX", "none"), model_error=1e-3)
    assert fit.continuum_coefficients == ()
    strengths = {band.name: band for band in fit.bands}
    for name, truth in (("OPX 2", -0.15), ("CPX 2", -0.2)):
        assert abs(strengths[name].strength - truth) < 3 * strengths[name].strength_sigma
    assert np.allclose(fit.continuum_reflectance, 1.0)


def test_no_continuum_is_no_part_of_the_spread() -> None:
    assert set(MGM_CONTINUA) - set(SPREAD_CONTINUA) == {"none"}


def pyroxenes(seed: int) -> np.ndarray:
    """Reflectance with bands at 925, 1040, 1900 and 2270 nm and 0.4 % noise."""
    rng = np.random.default_rng(seed)
    ln = np.log(0.15 + 6e-5 * GRID)
    for centre, fwhm, strength in ((925, 190, -0.2), (1040, 210, -0.25), (1900, 500, -0.15), (2270, 540, -0.2)):
        ln = ln + strength * rng.uniform(0.5, 1.5) * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    return np.asarray(np.exp(ln + rng.normal(scale=0.004, size=GRID.size)))


def fit_of(spectrum: Spectrum, **options: object) -> MgmFit:
    [fit] = fit_spectra([spectrum], mgm_model(**options))
    assert isinstance(fit, MgmFit)
    return fit


def numbers(fit: MgmFit) -> np.ndarray:
    """Bands and their errors, without the continuum."""
    m = fit.model.degrees
    return np.concatenate([fit.parameters[m:], np.sqrt(np.diag(fit.covariance))[m:]])


def from_file(folder: Path, wavelength: np.ndarray, reflectance: np.ndarray, header: str) -> Spectrum:
    path = folder / "spectrum.csv"
    rows = [f"{w!r},{r!r}" for w, r in zip(wavelength.tolist(), reflectance.tolist(), strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    [spectrum] = read_spectra(read_input(str(path)))
    return spectrum


@pytest.mark.parametrize(
    ("header", "change"),
    [
        ("wavelength_um,reflectance", lambda w, r: (w / 1e3, r)),
        ("wavelength_nm,reflectance_percent", lambda w, r: (w, 100 * r)),
        ("wavelength_nm,reflectance", lambda w, r: (w[::-1], r[::-1])),
        ("wavelength_um,reflectance", lambda w, r: (w[::-1] / 1e3, r[::-1])),
    ],
    ids=["um", "percent", "descending", "descending um"],
)
def test_units_and_order_of_channels_do_not_matter(
    tmp_path: Path, header: str, change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
) -> None:
    reflectance = pyroxenes(1)
    plain = fit_of(from_file(tmp_path, GRID, reflectance, "wavelength_nm,reflectance"))
    other = fit_of(from_file(tmp_path, *change(GRID, reflectance), header))
    assert np.allclose(numbers(other), numbers(plain), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("continuum", [name for name in MGM_CONTINUA if name != "none"])
@pytest.mark.parametrize("factor", [1e-3, 0.37, 2.5])
def test_a_constant_factor_changes_the_continuum_only(continuum: str, factor: float) -> None:
    reflectance = pyroxenes(2)
    plain = fit_of(Spectrum("a", GRID, reflectance, 0.004 * reflectance), continuum=continuum)
    scaled = fit_of(Spectrum("a", GRID, factor * reflectance, factor * 0.004 * reflectance), continuum=continuum)
    assert np.allclose(numbers(scaled), numbers(plain), rtol=1e-9, atol=1e-12)
    assert np.allclose(scaled.continuum_reflectance, factor * plain.continuum_reflectance, rtol=1e-9)
    assert scaled.rms_ln == pytest.approx(plain.rms_ln, rel=1e-9)


def test_alone_or_in_a_batch_is_the_same() -> None:
    spectra = [Spectrum(str(seed), GRID, pyroxenes(seed)) for seed in range(11)]
    spectra[3] = dataclasses.replace(spectra[3], mask=GRID < 500)
    together = fit_spectra(spectra, MODEL)
    backwards = fit_spectra(spectra[::-1], MODEL)[::-1]
    for spectrum, first, second in zip(spectra, together, backwards, strict=True):
        alone = fit_of(spectrum)
        assert np.allclose(numbers(first), numbers(alone), rtol=1e-9, atol=1e-12)
        assert np.allclose(numbers(second), numbers(alone), rtol=1e-9, atol=1e-12)
        assert first.status == second.status == alone.status


def test_a_quick_look_ends_in_the_lowest_minimum_of_most() -> None:
    spectra = [Spectrum(str(seed), GRID, pyroxenes(seed)) for seed in range(40)]
    quick, found = (
        np.array([fit.objective for fit in fit_spectra(spectra, MODEL, starts=starts)]) for starts in (0, 4)
    )
    assert (quick > found - 0.01).all()
    assert np.mean(quick < found + 0.01) > 0.9


def test_masked_channels_are_as_if_they_were_not_there() -> None:
    reflectance = pyroxenes(4)
    error = 0.004 * reflectance
    out = (GRID > 1340) & (GRID < 1460)
    spoiled = np.where(out, np.nan, reflectance)
    masked = fit_of(Spectrum("a", GRID, spoiled, error))
    removed = fit_of(Spectrum("a", GRID[~out], reflectance[~out], error[~out]))
    assert np.allclose(numbers(masked), numbers(removed), rtol=1e-9, atol=1e-12)
