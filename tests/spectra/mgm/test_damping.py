"""Damping mode against the restated path of the program, least squares of its own, and what it says."""

import pathlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from lunarsci.errors import ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.mgm.damping import fit_damping
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.fit_file import FitBand, FitFile, fit_file_of, model_of
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum
from tests.spectra.mgm.restated import Path, Restated

GRID = np.arange(450.0, 2396.0, 5.0)
TRUTH = np.array([0.5, -1e-5, 650.0, 150.0, -0.2, 950.0, 200.0, -0.5, 1950.0, 500.0, -0.3])
START = FitFile(
    folder="",
    spectrum="made.asc",
    plot_axis=(-170.0, 25.0, 10.0),
    wavelength_axis=(450.0, 2400.0, 1.0),
    rms_limit=2e-3,
    improvement_limit=1e-6,
    continuum="T",
    coefficients=(0.55, -1e-5, 0.0, 0.0),
    coefficients_95=(10.0, 1e-3, 0.0, 0.0),
    bands=(
        FitBand(630.0, 170.0, -0.1, 200.0, 400.0, 10.0),
        FitBand(970.0, 250.0, -0.3, 200.0, 400.0, 10.0),
        FitBand(2000.0, 400.0, -0.2, 300.0, 400.0, 10.0),
    ),
)
TO_THE_END = {"rms_limit": 0.0, "improvement_limit": 0.0}


def ln_reflectance(p: np.ndarray) -> np.ndarray:
    """The model as published, in the units of the file: c0 + c1 v in cm^-1, bands in nm."""
    total = np.log(p[0] + p[1] * 1e7 / GRID)
    for centre, fwhm, strength in p[2:].reshape(-1, 3):
        total = total + strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    return total


def made(truth: np.ndarray = TRUTH, noise: float = 0.004, seed: int = 1) -> Spectrum:
    reflectance = np.exp(ln_reflectance(truth) + np.random.default_rng(seed).normal(scale=noise, size=GRID.size))
    return Spectrum("made", GRID, reflectance, 0.004 * reflectance)


def fitted(spectrum: Spectrum, model: MgmModel, **options: object) -> MgmFit:
    [fit] = fit_damping([spectrum], model, **options)
    assert isinstance(fit, MgmFit)
    return fit


def from_file(spectrum: Spectrum, file: FitFile, **options: object) -> MgmFit:
    """As `--start` does, by the file's own limits."""
    limits = {"rms_limit": file.rms_limit, "improvement_limit": file.improvement_limit}
    return fitted(spectrum, model_of(file), file=file, **(limits | options))


def restated(spectrum: Spectrum, file: FitFile) -> Restated:
    values, errors = (np.array(rows) for rows in zip(*((b.values, b.uncertainties) for b in file.bands), strict=True))
    arguments = (file.continuum, file.coefficients, file.coefficients_95, values, errors)
    return Path(spectrum.wavelength_nm, spectrum.reflectance, *arguments).follow(file.rms_limit, file.improvement_limit)


def in_units_of_the_file(file: FitFile) -> tuple[np.ndarray, np.ndarray]:
    values = [*file.coefficients[:2], *(value for band in file.bands for value in band.values)]
    errors = [*file.coefficients_95[:2], *(value for band in file.bands for value in band.uncertainties)]
    return np.array(values), np.array(errors)


def starts() -> dict[str, FitFile]:
    """Every letter, degrees by coefficients of 0, a published start, uncertainties from nearly none to no limit."""
    wide = (FitBand(333.0, 400.0, -20.0, 1e4, 1e4, 100.0), *START.bands[1:])
    tight = tuple(replace(b, center_95_nm=30.0, fwhm_95_nm=0.5, strength_95=0.2) for b in START.bands)
    polynomial = replace(START, continuum="Q", coefficients_95=(10.0, 1e-3, 1e-7, 1e-10))
    level = FitBand(340.0, 2500.0, -0.5, 100.0, 1000.0, 1.0)
    return {
        "straight": START,
        "published": replace(polynomial, coefficients=(0.85, -1e-6, 0.0, 0.0), bands=wide),
        "four by T": replace(polynomial, continuum="T", coefficients=(0.55, -1e-5, 1e-11, 1e-16)),
        "quadratic": replace(polynomial, coefficients=(0.55, -1e-5, 1e-11, 0.0)),
        "c2 held": replace(polynomial, coefficients=(0.55, -1e-5, 0.0, 1e-16)),
        "wavelength": replace(START, continuum="S", coefficients=(0.3, 1e-5, 0.0, 0.0)),
        "cubic": replace(polynomial, continuum="P", coefficients=(0.3, 1e-5, 1e-9, 1e-13)),
        "none": replace(START, continuum="N", bands=(level, *START.bands)),
        "tight": replace(START, bands=tight, improvement_limit=1e-7),
        "at its centre": replace(START, bands=tuple(replace(b, center_95_nm=b.center_nm) for b in START.bands)),
        "early": replace(START, rms_limit=0.01),
        "within its limit": replace(START, rms_limit=10.0),
        "a width through 0": replace(START, bands=(*START.bands, FitBand(650.0, 400.0, 0.1, 200.0, 1e5, 10.0))),
    }


@pytest.mark.parametrize("name", starts())
def test_it_takes_the_path_of_the_program(name: str) -> None:
    """Iterations equal, centres to a millionth of a nanometre, errors as it writes them, against the restated path."""
    found, expected = both_ends(made(), starts()[name])
    assert found == expected
    if name == "none":
        assert found["iterations"] > 50


def both_ends(spectrum: Spectrum, file: FitFile) -> tuple[dict[str, Any], dict[str, Any]]:
    """Where a fit from a file ends, and where the restated path does, by name; these hold within their tolerances."""
    fit, path = from_file(spectrum, file), restated(spectrum, file)
    result, free = fit_file_of(fit, file), path.coefficients != 0
    values, errors = (np.array(rows) for rows in zip(*((b.values, b.uncertainties) for b in result.bands), strict=True))
    found = {
        "converged": fit.converged,
        "iterations": fit.iterations,
        "rms": fit.rms_ln,
        "bands": values,
        "errors of the bands": errors,
        "coefficients": np.array(result.coefficients)[free],
        "errors of the coefficients": np.array(result.coefficients_95)[free],
    }
    expected = {
        "converged": True,
        "iterations": path.iterations,
        "rms": pytest.approx(path.rms, rel=1e-9),
        "bands": pytest.approx(path.bands, abs=1e-6),
        "errors of the bands": pytest.approx(path.band_errors, rel=1e-6),
        "coefficients": pytest.approx(path.coefficients[free], rel=1e-6),
        "errors of the coefficients": pytest.approx(path.coefficient_errors[free], rel=1e-6),
    }
    return found, expected


@pytest.mark.reference
@pytest.mark.parametrize(
    ("spectrum", "letter", "values"),
    [("PE-CMP-030", "T", (0.7, -5e-6, 0.0, 0.0)), ("AG-TJM-030", "P", (0.5, 5e-5, 1e-9, 0.0))],
)
def test_it_takes_the_path_of_the_program_on_measured_spectra(
    reference_data: pathlib.Path, spectrum: str, letter: str, values: tuple[float, ...]
) -> None:
    """Eight bands of two pyroxenes over a polynomial: some hundred iterations each."""
    spectra = read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))
    [measured] = [s for s in spectra if s.id == spectrum]
    places = ((330, 250, -0.5), (480, 150, -0.1), (640, 175, -0.1), (905, 200, -0.3), (1020, 200, -0.2))
    places += ((1180, 250, -0.1), (1835, 550, -0.3), (2300, 600, -0.2))
    pyroxenes = replace(START, bands=tuple(FitBand(*place, 50.0, 80.0, 1.0) for place in places))
    errors = (1.0, 1e-3, 1e-6, 0.0)
    file = replace(pyroxenes, continuum=letter, coefficients=values, coefficients_95=errors)
    found, expected = both_ends(measured, file)
    assert found == expected


def test_it_ends_in_the_least_squares_minimum_with_the_errors_of_the_program() -> None:
    """scipy's minimum of the unweighted residuals; 1.96 sqrt(diag((G'G)^-1 rms^2)) from its numerical derivatives."""
    spectrum = made()
    fit = fitted(spectrum, model_of(START), **TO_THE_END)
    assert fit.converged
    data = np.log(spectrum.reflectance)
    scale = np.abs(TRUTH)
    best = least_squares(
        lambda q: data - ln_reflectance(q * scale),
        np.sign(TRUTH),
        jac="3-point",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    rms = np.sqrt(np.mean(best.fun**2))
    expected = 1.96 * np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)) * rms**2) * scale
    wavenumber = 1e7 / (best.x * scale)[2::3]
    around = expected[2::3] * wavenumber**2 / 1e7
    expected[2::3] = 1e7 / (wavenumber - around) - 1e7 / (wavenumber + around)
    values, errors = in_units_of_the_file(fit_file_of(fit))
    assert fit.rms_ln == pytest.approx(rms, rel=1e-9)
    assert np.all(np.abs(values - best.x * scale) < 1e-4 * expected)
    assert errors == pytest.approx(expected, rel=1e-4)
    assert np.all(np.abs(values - TRUTH) < 2 * errors)


def test_the_prior_damps_and_does_not_pull() -> None:
    shifted = replace(START, bands=tuple(replace(b, center_nm=b.center_nm + 60, strength=-0.6) for b in START.bands))
    tight = [
        model_of(replace(file, bands=tuple(replace(b, center_95_nm=20.0) for b in file.bands)))
        for file in (START, shifted)
    ]
    spectrum = made()
    first, second = (fitted(spectrum, model, start=tight[0].prior, **TO_THE_END) for model in tight)
    sigma = np.sqrt(np.diag(first.covariance))
    assert np.all(np.abs(first.parameters - second.parameters) < 1e-3 * sigma)
    one, other = (fit_spectra([spectrum], model, model_error=0.02)[0] for model in tight)
    assert np.abs((one.parameters - other.parameters) / sigma).max() > 3


def test_each_rule_that_ends_a_fit_is_named() -> None:
    model, spectrum = model_of(START), made()
    soon = fitted(spectrum, model, rms_limit=0.005)
    assert soon.status == f"converged after {soon.iterations} iterations: the rms is at most 0.005"
    loosely = fitted(spectrum, model)
    assert loosely.status == f"converged after {loosely.iterations} iterations: the rms fell by at most 1e-06"
    once = fitted(spectrum, model, improvement_limit=1e9)
    assert once.status == "converged after 1 iteration: the rms fell by at most 1e+09"
    assert loosely.rms_ln > fitted(spectrum, model, **TO_THE_END).rms_ln
    exact = fitted(made(noise=0.0), model, **TO_THE_END)
    assert exact.status.endswith(" iterations: no part of a step lowers the rms")
    assert exact.rms_ln < 1e-12


def test_no_end_in_sight_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.spectra.mgm.damping.MAX_ITERATIONS", 3)
    fit = fitted(made(), model_of(START), **TO_THE_END)
    assert not fit.converged
    assert fit.status.startswith("not converged after 3 iterations; ")


def test_steps_that_all_leave_the_range_of_the_model_are_said() -> None:
    """Two widths are free and tied, of no band and of one of a millionth on data that have a positive one there: the
    linear step makes them narrower by a million widths, and even 2^-15 of that is below zero."""
    locked = [replace(b, center_95_nm=0.0, fwhm_95_nm=0.0, strength_95=0.0) for b in START.bands]
    locked[1] = replace(locked[1], strength=-1e-6, fwhm_95_nm=1e12)
    locked[0] = replace(locked[0], strength=0.0, fwhm_95_nm=1e12)
    file = replace(START, coefficients_95=(0.0, 0.0, 0.0, 0.0), bands=tuple(locked))
    truth = np.array([*START.coefficients[:2], *(value for band in START.bands for value in band.values)])
    truth[[4, 7]] = 0.0, 0.3
    fit = fitted(made(truth), model_of(file).tied("band_1_fwhm_nm", 0.68, "band_2_fwhm_nm", 0.0), file=file)
    assert not fit.converged
    assert fit.status.startswith("not converged: continuum or width fell to zero")
    assert [band.fwhm_nm for band in fit.bands] == pytest.approx([170.0, 250.0, 400.0])


def test_a_start_without_a_continuum_gives_a_reason() -> None:
    [result] = fit_damping([made()], model_of(replace(START, coefficients=(0.1, -1e-5, 0.0, 0.0))))
    assert isinstance(result, MgmFailure)
    assert result.status.startswith("no result: the continuum of the start is not above 0")


def test_a_positive_strength_is_allowed_and_said() -> None:
    truth = TRUTH.copy()
    truth[7] = 0.3
    fit = fitted(made(truth), model_of(START), **TO_THE_END)
    assert fit.bands[1].strength == pytest.approx(0.3, abs=0.01)
    assert fit.status.endswith("; positive strength, which is no absorption: band 2")


def test_fixed_values_stay_and_ties_hold() -> None:
    """A width tied to half another less 40 nm, and a centre fixed away from its prior's mean."""
    model = model_of(START).bounded("band_3_center_nm", 1960, 1960).tied("band_2_fwhm_nm", 0.5, "band_3_fwhm_nm", -40.0)
    fit = fitted(made(), model, **TO_THE_END)
    assert fit.converged
    second, third = fit.bands[1:]
    assert third.center_nm == 1960.0
    assert third.center_sigma_nm == 0.0
    assert second.fwhm_nm == pytest.approx(0.5 * third.fwhm_nm - 40.0, abs=1e-6)
    assert second.fwhm_sigma_nm == pytest.approx(0.5 * third.fwhm_sigma_nm, rel=1e-6)
    free = fitted(made(), model_of(START), **TO_THE_END)
    assert fit.rms_ln > free.rms_ln
    assert (free.bic - free.objective) / np.log(GRID.size) == pytest.approx(11)
    assert (fit.bic - fit.objective) / np.log(GRID.size) == pytest.approx(9)
    held = model_of(START).tied("band_2_center_nm", 0.5, "band_3_center_nm", 0.0)
    fit = fitted(made(), held.bounded("band_3_center_nm", 1940, 1940), **TO_THE_END)
    assert [band.center_nm for band in fit.bands[1:]] == pytest.approx([970.0, 1940.0], abs=1e-6)


def test_nothing_free_is_a_fit_of_nothing() -> None:
    bands = tuple(replace(b, center_95_nm=0.0, fwhm_95_nm=0.0, strength_95=0.0) for b in START.bands)
    fit = fitted(made(), model_of(replace(START, bands=bands, coefficients_95=(0.0, 0.0, 0.0, 0.0))))
    assert fit.parameters == pytest.approx(fit.model.prior)
    assert not fit.covariance.any()


def test_a_centre_below_zero_is_said_and_survives_a_file() -> None:
    """Only the wing of a band is seen: nothing keeps its centre among the wavelengths."""
    bands = (replace(START.bands[0], center_nm=-200.0, fwhm_nm=900.0, center_95_nm=0.0), *START.bands[1:])
    fit = fitted(made(), model_of(replace(START, bands=bands)))
    assert "centre not above 0 nm, the wing of something else: band 1" in fit.status
    assert model_of(fit_file_of(fit)).prior == pytest.approx(fit.parameters)


def test_what_the_data_do_not_determine_has_no_errors() -> None:
    """Two bands in one place: only the sum of their strengths matters."""
    twice = (START.bands[0], START.bands[1], START.bands[1])
    fit = fitted(made(), model_of(replace(START, bands=twice)))
    assert "no errors: the data leave a parameter undetermined" in fit.status
    assert np.isnan(fit.bands[2].strength_sigma)
    with pytest.raises(ParameterError, match="no errors"):
        fit_file_of(fit)


def test_chi_square_has_the_weights_of_the_other_mode() -> None:
    """Noise of 0.004 and model error of 0.003 make 0.005 together; 390 channels, 11 parameters."""
    fit = fitted(made(), model_of(START), model_error=0.003)
    assert fit.objective == pytest.approx(390 * fit.rms_ln**2 / 0.005**2)
    assert fit.reduced_chi2 == pytest.approx(fit.objective / 379)
    assert fit.bic == pytest.approx(fit.objective + 11 * np.log(390))
    assert (fit.prior, fit.bands[0].shrinkage, fit.bands[0].at_bound) == (
        "damping",
        {"center": 0.0, "fwhm": 0.0, "strength": 0.0},
        (),
    )


def test_errors_that_all_channels_share_move_the_fit_as_they_do_the_data() -> None:
    """A slope of 1 % across the spectrum: twice fitted, against the linear response."""
    base = made()
    slope = 0.01 * np.linspace(-1, 1, GRID.size) * base.reflectance
    known = replace(base, systematic={"slope": slope})
    moved = Spectrum("moved", GRID, base.reflectance + slope, base.uncertainty)
    one, other = (fitted(s, model_of(START), **TO_THE_END) for s in (known, moved))
    shifts = [abs(b.strength - a.strength) for a, b in zip(one.bands, other.bands, strict=True)]
    assert [band.strength_calibration for band in one.bands] == pytest.approx(shifts, rel=0.1, abs=1e-4)
    assert other.bands[0].strength_calibration is None


def test_where_a_band_is_undetermined_no_first_order_tells_what_calibration_does_to_it() -> None:
    """Two bands 10 nm apart where one is: they may grow against each other without end, and the third stays known."""
    one, two = START.bands[0], START.bands[1]
    base = made()
    known = replace(base, systematic={"slope": 0.01 * np.linspace(-1, 1, GRID.size) * base.reflectance})
    fit = fitted(known, model_of(replace(START, bands=(one, two, replace(two, center_nm=two.center_nm + 10)))))
    loose = [band for band in fit.bands if max(band.center_sigma_nm, band.fwhm_sigma_nm) > 2000]
    assert 0 < len(loose) < 3 and "undetermined" in fit.status
    for band in fit.bands:
        calibration = (band.center_calibration_nm, band.fwhm_calibration_nm, band.strength_calibration)
        assert (calibration == (None, None, None)) == (band in loose)
        assert all(value is None or value < 2000 for value in calibration)
    assert "what calibration errors do to undetermined bands is not determined either" in fit.status


@pytest.mark.parametrize("continuum", ["wavelength", "wavenumber-cubic", "log-quadratic", "none"])
def test_models_of_assemblages_are_fitted_and_their_pyroxene_ratio_given(continuum: str) -> None:
    """NBSR is s_OPX / (s_OPX + s_CPX): Kanner et al. (2007), 10.1016/j.icarus.2006.10.025."""
    model = mgm_model("OPX-CPX", continuum)
    ln = np.zeros(GRID.size) if continuum == "none" else np.full(GRID.size, np.log(0.3))
    strengths = {"OPX 1": -0.5, "CPX 1": -0.2, "OPX 2": -0.45, "CPX 2": -0.15}
    for band in model.assemblage.bands:
        x = (GRID - band.center_nm) / band.fwhm_nm
        ln = ln + strengths.get(band.name, -0.08) * np.exp(-4 * np.log(2) * x**2)
    fit = fitted(Spectrum("pyroxenes", GRID, np.exp(ln), 1e-3 * np.exp(ln)), model, rms_limit=1e-4)
    assert fit.converged
    opx, cpx = (k for k, band in enumerate(fit.bands) if band.name in ("OPX 2", "CPX 2"))
    a, b = fit.bands[opx].strength, fit.bands[cpx].strength
    assert a / (a + b) == pytest.approx(0.75, abs=0.03)
    rows = [fit.model.index(f"{model.assemblage.bands[k].key}_strength") for k in (opx, cpx)]
    slope = np.array([b, -a]) / (a + b) ** 2
    error = float(np.sqrt(slope @ fit.covariance[np.ix_(rows, rows)] @ slope))
    ratio = fit.nbsr["um2"]
    assert (ratio.opx, ratio.sigma) == pytest.approx((a / (a + b), error))
    assert nbsr_abundance(fit) is None


def test_bands_of_a_file_have_a_ratio_where_their_minerals_are_named() -> None:
    """s_OPX / (s_OPX + s_CPX) of the named bands, whatever is fitted beside them; nothing changes but the ratio."""
    pair = (FitBand(1850.0, 450.0, -0.2, 50.0, 60.0, 10.0), FitBand(2250.0, 500.0, -0.1, 50.0, 60.0, 10.0))
    file = replace(START, bands=(*START.bands[:2], *pair))
    truth = np.array([*TRUTH[:8], 1830.0, 450.0, -0.3, 2280.0, 500.0, -0.15])
    limits = {"file": file, "rms_limit": 0.0042}
    named = fitted(made(truth), model_of(file, {3: "OPX", 4: "CPX"}), **limits)
    unnamed = fitted(made(truth), model_of(file), **limits)
    assert unnamed.nbsr == {"um1": None, "um2": None}
    assert named.parameters.tolist() == unnamed.parameters.tolist()
    ratio = named.nbsr["um2"]
    opx, cpx = (band.strength for band in named.bands[2:])
    assert ratio.opx == pytest.approx(opx / (opx + cpx))
    assert ratio.opx == pytest.approx(2 / 3, abs=0.1)
    assert named.nbsr["um1"] is None


def test_no_ratio_where_a_pyroxene_band_is_positive() -> None:
    model = mgm_model("OPX-CPX", "wavelength")
    ln = np.full(GRID.size, np.log(0.3))
    for band in model.assemblage.bands:
        strength = {"OPX 2": -0.5, "CPX 2": 0.2}.get(band.name, -0.1)
        ln = ln + strength * np.exp(-4 * np.log(2) * ((GRID - band.center_nm) / band.fwhm_nm) ** 2)
    start = model.prior.copy()
    start[0], start[4::3] = 0.3, -0.1
    fit = fitted(Spectrum("bump", GRID, np.exp(ln), 1e-3 * np.exp(ln)), model, start=start, rms_limit=1e-4)
    assert {band.name: band.strength for band in fit.bands}["CPX 2"] > 0
    assert fit.nbsr["um2"] is None


def test_spectra_that_cannot_be_fitted_say_why_in_their_place() -> None:
    good = made()
    few = Spectrum("few", GRID[:30], good.reflectance[:30])
    calls: list[tuple[int, int]] = []
    results = fit_damping([few, good], model_of(START), progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 2), (2, 2)]
    assert isinstance(results[0], MgmFailure)
    assert "30 usable channels" in results[0].status
    assert isinstance(results[1], MgmFit)


@pytest.mark.parametrize(
    "options",
    [
        {"rms_limit": -1.0},
        {"improvement_limit": np.nan},
        {"improvement_limit": np.inf},
        {"model_error": 0.0},
    ],
)
def test_impossible_options_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        fit_damping([made()], model_of(START), **options)


@pytest.mark.reference
def test_the_example_of_the_literature_on_measured_orthopyroxenes(reference_data: pathlib.Path) -> None:
    """Orthopyroxene bands lie at 0.90-0.935 and 1.80-1.95 um: Adams (1974), 10.1029/JB079i032p04829."""
    bands = (
        FitBand(333.0, 400.0, -20.0, 1e4, 1e4, 100.0),
        FitBand(1000.0, 250.0, -1.0, 200.0, 400.0, 10.0),
        FitBand(2000.0, 300.0, -1.0, 300.0, 400.0, 10.0),
    )
    example = replace(
        START,
        continuum="Q",
        coefficients=(0.85, -1e-6, 0.0, 0.0),
        coefficients_95=(10.0, 1e-4, 1e-7, 1e-7),
        bands=bands,
    )
    spectra = read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))
    for spectrum in (s for s in spectra if s.id in {"PE-CMP-030", "PE-CMP-031"}):
        fit = from_file(spectrum, example)
        assert fit.rms_ln < 0.03
        assert 900 <= fit.bands[1].center_nm <= 935
        assert 1800 <= fit.bands[2].center_nm <= 1950
        again = model_of(fit_file_of(fit, example))
        assert again.prior == pytest.approx(fit.parameters, rel=1e-6)
