"""From a `.fit` file to a model of ours, and from a fit of ours to a `.fit` file.

The file's polynomial is written in wavenumber [cm^-1] or wavelength [nm], ours in that variable mapped to -1 to 1; one
is a linear map of the other, and so are their priors.
"""

import dataclasses
import math

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.assemblages import Assemblage, BandPrior
from lunarsci.spectra.mgm.continuum import RANGE_NM, MgmContinuum, continuum_basis
from lunarsci.spectra.mgm.fitfile import FitBand, FitFile
from lunarsci.spectra.mgm.model import KINDS, NM_PER_UM, TIE_SIGMA, MgmModel
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import BoolArray, FloatArray, Spectrum

__all__ = ["LIMITS", "NORMAL_95", "fit_file_of", "model_of", "spectrum_within"]

NORMAL_95 = 1.96
"""Standard deviations in an uncertainty of the file: 95 % of a normal law."""
LIMITS = (2e-3, 1e-6)
"""Rms of ln R, and improvement of it, at which a fit stops in the files that have been published."""
PLOT_AXIS = (-170.0, 25.0, 10.0)
NARROWEST_UM = 1e-3
FLATTEST = 1e9
"""Standard deviation, um or ln R, beyond which a wider one changes nothing but rounding."""
ASSEMBLAGE = "fit file"
REGIONS = (("uv", 400.0), ("visible", 750.0), ("um1", 1500.0), ("um2", math.inf))
"""Regions and their upper ends. [nm]"""
CONTINUA: dict[str, tuple[MgmContinuum, ...]] = {
    "Q": ("wavenumber", "wavenumber-quadratic", "wavenumber-cubic"),
    "T": ("wavenumber",),
    "P": ("wavelength", "wavelength-quadratic", "wavelength-cubic"),
    "S": ("wavelength",),
    "N": ("none",),
}
"""By letter: what it may become, by degree."""


def model_of(file: FitFile) -> MgmModel:
    """The model of a `.fit` file: its values as prior means, its uncertainties over 1.96 as standard deviations.

    An uncertainty of 0, or one that cannot move ln R by a millionth or a centre or width by a thousandth of a
    nanometre, fixes the value; a polynomial whose highest coefficients are fixed at 0 becomes one of lower degree.
    Other continuum coefficients that are fixed tie ours to each other. Strengths may be of either sign, and no value
    has other bounds than widths above 1 nm. Bands are called `band 1`, `band 2`, ...
    """
    continuum, mean, precision, fixed = _continuum_prior(file)
    bands = tuple(_band_prior(number, band) for number, band in enumerate(file.bands, start=1))
    unit = np.array([NM_PER_UM, NM_PER_UM, 1.0])
    values = np.array([band.values for band in file.bands]) / unit
    sigma = np.minimum(np.array([band.uncertainties for band in file.bands]) / unit / NORMAL_95, FLATTEST)
    locked = np.concatenate([fixed, (sigma < TIE_SIGMA).ravel()])
    prior = np.concatenate([mean, values.ravel()])
    m = mean.size
    whole = np.zeros((prior.size, prior.size))
    whole[:m, :m] = precision
    whole[m:, m:] = np.diag(np.where(sigma < TIE_SIGMA, TIE_SIGMA, sigma).ravel() ** -2)
    lower, upper = np.full(prior.size, -np.inf), np.full(prior.size, np.inf)
    lower[m + 1 :: 3] = np.minimum(NARROWEST_UM, prior[m + 1 :: 3])
    names = tuple(f"c{k}" for k in range(m)) + tuple(f"{band.key}_{kind}" for band in bands for kind in KINDS)
    lower, upper = np.where(locked, prior, lower), np.where(locked, prior, upper)
    return MgmModel(Assemblage(ASSEMBLAGE, bands, ()), continuum, names, prior, whole, lower, upper)


def _band_prior(number: int, band: FitBand) -> BandPrior:
    region = next(name for name, end in REGIONS if band.center_nm < end)
    errors = [value / NORMAL_95 for value in band.uncertainties]
    return BandPrior(
        f"band {number}", "any", region, "", band.center_nm, 0.0, errors[0], band.fwhm_nm, errors[1], errors[2],
        ASSEMBLAGE,
    )  # fmt: skip


def _continuum_prior(file: FitFile) -> tuple[MgmContinuum, FloatArray, FloatArray, BoolArray]:
    """Kind of continuum, mean and precision of the mapped coefficients, and which of these are fixed."""
    choices = CONTINUA[file.continuum]
    most = continuum_basis(choices[-1], np.array(RANGE_NM)).shape[1]
    raw, sigma = np.array(file.coefficients[:most]), np.array(file.coefficients_95[:most]) / NORMAL_95
    largest = _raw_variable(choices[-1]).max() ** np.arange(most)
    tied = sigma * largest < TIE_SIGMA
    count = most
    while count > 2 and tied[count - 1] and raw[count - 1] == 0:
        count -= 1
    raw, sigma, tied = raw[:count], sigma[:count], tied[:count]
    continuum = choices[-1] if len(choices) == 1 else choices[count - 2]
    to_raw = _to_raw(continuum)
    mean = np.linalg.solve(to_raw, raw)
    precision = to_raw[~tied].T @ np.diag(sigma[~tied] ** -2.0) @ to_raw[~tied]
    directions = np.linalg.qr(to_raw[tied].T)[0]
    precision = precision + directions @ directions.T / TIE_SIGMA**2
    return continuum, mean, precision, np.full(count, bool(tied.all()))


def _raw_variable(continuum: MgmContinuum) -> FloatArray:
    """The file's variable at both ends of the interval that ours maps to -1 and 1. [cm^-1 or nm]"""
    ends = np.array(RANGE_NM)
    return 1e7 / ends if continuum.startswith("wavenumber") else ends


def _to_raw(continuum: MgmContinuum) -> FloatArray:
    """Matrix, (m, m), that takes coefficients of powers of the mapped variable u to those of the file's variable v.

    With u = a v + b, the coefficient of v^j is the sum over k of binomial(k, j) a^j b^(k - j) c_k.
    """
    basis = continuum_basis(continuum, np.array(RANGE_NM))
    m = basis.shape[1]
    if not m:
        return np.zeros((0, 0))
    v, u = _raw_variable(continuum), basis[:, 1]
    a = (u[1] - u[0]) / (v[1] - v[0])
    b = u[0] - a * v[0]
    return np.array([[math.comb(k, j) * a**j * b ** (k - j) if k >= j else 0.0 for k in range(m)] for j in range(m)])


def fit_file_of(fit: MgmFit, header: FitFile | None = None) -> FitFile:
    """A fit as a result file: values, and 1.96 standard deviations of each.

    Folder, spectrum, axes and limits are those of `header`, or else none, the spectrum's id, its channels and the
    limits of the published files. A quadratic continuum becomes a polynomial whose c3 is 0 and fixed.

    Raises ParameterError where the continuum is `log-quadratic`, which these files cannot express, and where an error
    is unknown.
    """
    m = fit.model.degrees
    sigma = NORMAL_95 * np.sqrt(np.diag(fit.covariance))
    if not np.isfinite(sigma).all():
        raise ParameterError(f"{fit.id}: the fit has no errors, and a .fit file needs them; fix or remove a band")
    letter = _letter(fit.model.continuum)
    to_raw = _to_raw(fit.model.continuum)
    raw, raw_error = np.zeros(4), np.zeros(4)
    raw[:m] = to_raw @ fit.parameters[:m]
    # A coefficient that is tied has a variance of 0, which rounding may take below it.
    raw_error[:m] = NORMAL_95 * np.sqrt(np.diag(to_raw @ fit.covariance[:m, :m] @ to_raw.T).clip(min=0.0))
    unit = np.array([NM_PER_UM, NM_PER_UM, 1.0])
    values, errors = fit.parameters[m:].reshape(-1, 3) * unit, sigma[m:].reshape(-1, 3) * unit
    rows = np.hstack([values, errors]).tolist()
    found = FitFile(
        folder="",
        spectrum=" ".join(fit.id.split()) or "spectrum",
        plot_axis=PLOT_AXIS,
        wavelength_axis=(float(fit.wavelength_nm[0]), float(fit.wavelength_nm[-1]), 1.0),
        rms_limit=LIMITS[0],
        improvement_limit=LIMITS[1],
        continuum=letter,
        coefficients=tuple(raw.tolist()),
        coefficients_95=tuple(raw_error.tolist()),
        bands=tuple(FitBand(*row) for row in rows),
    )
    if header is None:
        return found
    kept = ("folder", "spectrum", "plot_axis", "wavelength_axis", "rms_limit", "improvement_limit")
    return dataclasses.replace(found, **{name: getattr(header, name) for name in kept})


def _letter(continuum: MgmContinuum) -> str:
    """Letter of a continuum: of a straight line, the one for straight lines."""
    found = [letter for letter, choices in CONTINUA.items() if continuum in choices]
    if not found:
        known = ", ".join(choices[-1] for choices in CONTINUA.values())
        raise ParameterError(f"a .fit file has no letter for the continuum {continuum}; fit with one of: {known}")
    return found[-1]


def spectrum_within(spectrum: Spectrum, file: FitFile) -> Spectrum:
    """The spectrum with the channels outside the file's wavelength range masked."""
    low, high, _ = file.wavelength_axis
    outside = (spectrum.wavelength_nm < low) | (spectrum.wavelength_nm > high)
    return dataclasses.replace(spectrum, mask=~spectrum.usable | outside)
