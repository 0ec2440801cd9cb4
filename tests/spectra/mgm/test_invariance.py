"""A fit is the same in other units, in any order of channels, times a constant, alone or in a batch: to 1e-9."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lunarsci.io.inputs import read_input
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import MGM_CONTINUA, mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)
MODEL = mgm_model()


def made(seed: int) -> np.ndarray:
    """Reflectance with bands at 925, 1040, 1900 and 2270 nm and 0.4 % noise."""
    rng = np.random.default_rng(seed)
    ln = np.log(0.15 + 6e-5 * GRID)
    for centre, fwhm, strength in ((925, 190, -0.2), (1040, 210, -0.25), (1900, 500, -0.15), (2270, 540, -0.2)):
        ln = ln + strength * rng.uniform(0.5, 1.5) * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    return np.asarray(np.exp(ln + rng.normal(scale=0.004, size=GRID.size)))


def fitted(spectrum: Spectrum, **options: object) -> MgmFit:
    [fit] = fit_spectra([spectrum], mgm_model(**options))  # type: ignore[arg-type]
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
    reflectance = made(1)
    plain = fitted(from_file(tmp_path, GRID, reflectance, "wavelength_nm,reflectance"))
    other = fitted(from_file(tmp_path, *change(GRID, reflectance), header))
    assert np.allclose(numbers(other), numbers(plain), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("continuum", [name for name in MGM_CONTINUA if name != "none"])
@pytest.mark.parametrize("factor", [1e-3, 0.37, 2.5])
def test_a_constant_factor_changes_the_continuum_only(continuum: str, factor: float) -> None:
    reflectance = made(2)
    plain = fitted(Spectrum("a", GRID, reflectance, 0.004 * reflectance), continuum=continuum)
    scaled = fitted(Spectrum("a", GRID, factor * reflectance, factor * 0.004 * reflectance), continuum=continuum)
    assert np.allclose(numbers(scaled), numbers(plain), rtol=1e-9, atol=1e-12)
    assert np.allclose(scaled.continuum_reflectance, factor * plain.continuum_reflectance, rtol=1e-9)
    assert scaled.rms_ln == pytest.approx(plain.rms_ln, rel=1e-9)


def test_alone_or_in_a_batch_is_the_same() -> None:
    spectra = [Spectrum(str(seed), GRID, made(seed)) for seed in range(11)]
    spectra[3] = dataclasses.replace(spectra[3], mask=GRID < 500)
    together = fit_spectra(spectra, MODEL)
    backwards = fit_spectra(spectra[::-1], MODEL)[::-1]
    for spectrum, first, second in zip(spectra, together, backwards, strict=True):
        assert isinstance(first, MgmFit)
        assert isinstance(second, MgmFit)
        alone = fitted(spectrum)
        assert np.allclose(numbers(first), numbers(alone), rtol=1e-9, atol=1e-12)
        assert np.allclose(numbers(second), numbers(alone), rtol=1e-9, atol=1e-12)
        assert first.status == second.status == alone.status


def test_masked_channels_are_as_if_they_were_not_there() -> None:
    reflectance = made(4)
    error = 0.004 * reflectance
    out = (GRID > 1340) & (GRID < 1460)
    spoiled = np.where(out, np.nan, reflectance)
    masked = fitted(Spectrum("a", GRID, spoiled, error))
    removed = fitted(Spectrum("a", GRID[~out], reflectance[~out], error[~out]))
    assert np.allclose(numbers(masked), numbers(removed), rtol=1e-9, atol=1e-12)
