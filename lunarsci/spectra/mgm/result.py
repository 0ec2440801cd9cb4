"""What a fit of the Modified Gaussian Model gives: bands with errors, and their ratios."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.assemblages import BandPrior
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.mgm.model import MgmModel

UNLIKE_RMS = 0.2
"""A fit that misses ln R by more than this, root mean square, describes something else; assumed."""
UNDETERMINED = 0.5
"""The largest standard deviation of a number within 0 and 1: a ratio with this error says nothing and is not given."""
REACH_NM = {"um1": (900.0, 1050.0), "um2": (1800.0, 2250.0)}
"""What a spectrum must reach over for both pyroxene bands of a region to be measured; assumed."""


ERROR_COVERS = ("noise", "model error", "prior")
"""What standard errors hold where the prior is part of the objective."""


def in_doubt(status: str) -> str:
    """That a fit of a status is in doubt, and why; '' where it is not.

    >>> in_doubt("converged; strained: NBSR at 1 and 2 µm contradict each other"), in_doubt("converged")
    ('the fit is in doubt, strained: NBSR at 1 and 2 µm contradict each other', '')
    """
    return "" if status == "converged" else f"the fit is in doubt, {status.partition('; ')[2] or status}"


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedBand:
    """One band of a fit.

    Attributes
    ----------
    name, mineral, region : as in the table of bands.
    center_nm, fwhm_nm, strength : strength in ln reflectance, 0 or below. [nm, nm, -]
    center_sigma_nm, fwhm_sigma_nm, strength_sigma : their standard errors. [nm, nm, -]
    center_calibration_nm, fwhm_calibration_nm, strength_calibration : standard deviation from the errors that all
        channels share (`Spectrum.systematic`), by linear response of the fit; None where none is known, and where by
        `damping` the errors of the band span the spectrum, so that no linear response tells it. [nm, nm, -]
    center_continuum_nm, fwhm_continuum_nm, strength_continuum : how far the value goes, at most, under any other of the
        continua that were tried; None where only one was. [nm, nm, -]
    shrinkage : by parameter, 1 - (posterior sigma / prior sigma)^2: 1 where the data decide, 0 where the prior does.
    at_bound : names of the parameters that ended on a bound; their error is the root mean square distance from it.
    """

    name: str
    mineral: str
    region: str
    center_nm: float
    center_sigma_nm: float
    fwhm_nm: float
    fwhm_sigma_nm: float
    strength: float
    strength_sigma: float
    center_calibration_nm: float | None
    fwhm_calibration_nm: float | None
    strength_calibration: float | None
    shrinkage: dict[str, float]
    at_bound: tuple[str, ...]
    center_continuum_nm: float | None = None
    fwhm_continuum_nm: float | None = None
    strength_continuum: float | None = None

    @classmethod
    def from_kernel(
        cls,
        prior: BandPrior,
        value: FloatArray,
        sigma: FloatArray,
        calibration: FloatArray,
        shrinkage: FloatArray,
        at_bound: Sequence[bool],
    ) -> "FittedBand":
        """From the kernel's centre [um], FWHM [um], strength; `calibration` is NaN where unknown."""
        unit = np.array([1e3, 1e3, 1.0])
        center, fwhm, strength = (value * unit).tolist()
        center_sigma, fwhm_sigma, strength_sigma = (sigma * unit).tolist()
        shared = [None if shift != shift else shift for shift in (calibration * unit).tolist()]
        names = ("center", "fwhm", "strength")
        return cls(
            name=prior.name,
            mineral=prior.mineral,
            region=prior.region,
            center_nm=center,
            center_sigma_nm=center_sigma,
            fwhm_nm=fwhm,
            fwhm_sigma_nm=fwhm_sigma,
            strength=strength,
            strength_sigma=strength_sigma,
            center_calibration_nm=shared[0],
            fwhm_calibration_nm=shared[1],
            strength_calibration=shared[2],
            shrinkage=dict(zip(names, shrinkage.tolist(), strict=True)),
            at_bound=tuple(name for name, held in zip(names, at_bound, strict=True) if held),
        )

    def curve(self, wavelength_nm: FloatArray) -> FloatArray:
        """The band alone, in ln reflectance, on wavelengths in nm; shape as given."""
        x = (wavelength_nm - self.center_nm) * FWHM_OVER_SIGMA / self.fwhm_nm
        return self.strength * np.exp(-0.5 * x**2)

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class StrengthRatio:
    """Normalised band strength ratio of orthopyroxene, s_OPX / (s_OPX + s_CPX), of clinopyroxene, and their sigma. [-]

    The sigma is that of the strengths, not of a mineral fraction; what fraction a ratio means depends on end members.
    `calibration` is the standard deviation from errors that all channels share, None where none is known or it is not
    determined (see `FittedBand`). `continuum`
    is how far the ratio of orthopyroxene goes, at most, under any other of the continua that were tried, from
    `continuum_low` to `continuum_high`; None where only one was. Where some leave the ratio undetermined, these are 0
    and 1.

    Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025.
    """

    opx: float
    cpx: float
    sigma: float
    calibration: float | None
    continuum: float | None = None
    continuum_low: float | None = None
    continuum_high: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MgmFit:
    """A fit of one spectrum.

    Attributes
    ----------
    prior : `map`, where the prior is part of the objective, or `damping`, where it only shortens the steps.
    converged, status : whether the minimum was reached, and a sentence about it.
    rms_ln : root mean square of ln R - model. [-]
    reduced_chi2 : chi-square, with channel noise and model error, over channels less the number of parameters that the
        data determine (continuum coefficients and the shrinkage of the others). [-]
    bic : Bayesian information criterion, chi-square + p ln n; lower is better. [-]
    continuum_coefficients : of the polynomial in the mapped variable of `continuum_basis`. [-]
    nbsr : `um1` and `um2`, None where the spectrum does not reach over both bands, where their strengths together are
        so small that the ratio's standard error reaches 0.5 (by `damping`, whose errors know no prior, it is given
        with whatever error it has), or where they are not in the assemblage.
    model, data : what was fitted to what.
    parameters, covariance : (p,) and (p, p) in the order and units of `MgmModel`: continuum coefficients, then centre
        [um], FWHM [um], strength per band.
    objective : chi-square with the prior's share. [-]
    iterations : how many the reference program takes along the same path; None where `prior` is `map`.
    """

    id: str
    assemblage: str
    continuum: str
    prior: str
    converged: bool
    status: str
    rms_ln: float
    reduced_chi2: float
    bic: float
    continuum_coefficients: tuple[float, ...]
    bands: tuple[FittedBand, ...]
    nbsr: dict[str, StrengthRatio | None]
    model: MgmModel
    data: MgmData
    parameters: FloatArray
    covariance: FloatArray
    objective: float
    iterations: int | None = None

    @property
    def wavelength_nm(self) -> FloatArray:
        """The fitted channels, shape (n,). [nm]"""
        return self.data.wavelength_nm

    @property
    def reflectance(self) -> FloatArray:
        """What was fitted, shape (n,). [-]"""
        return self.data.reflectance

    @property
    def continuum_reflectance(self) -> FloatArray:
        """The continuum C on the fitted channels, shape (n,). [-]"""
        level = self.model.basis(self.wavelength_nm) @ self.parameters[: self.model.degrees]
        return np.exp(level) if self.model.logarithmic else level

    def ln_model(self) -> FloatArray:
        """ln R of the model on the fitted channels, shape (n,). [-]"""
        return np.log(self.continuum_reflectance) + sum(band.curve(self.wavelength_nm) for band in self.bands)

    @property
    def error_covers(self) -> tuple[str, ...]:
        """What the standard errors (`NAME_sigma`) hold; what shared errors and other continua do stands beside them."""
        if self.prior == "damping":
            return ("residuals",)
        return ERROR_COVERS

    def to_dict(self) -> dict[str, Any]:
        """The keys of `lunarsci spectra fit --json`."""
        record = {name: getattr(self, name) for name in _SCALARS}
        ratios = {key: ratio.to_dict() if ratio else None for key, ratio in self.nbsr.items()}
        return record | {
            "iterations": self.iterations,
            "model_error": self.data.model_error,
            "error_covers": list(self.error_covers),
            "continuum_coefficients": list(self.continuum_coefficients),
            "bands": [band.to_dict() for band in self.bands],
            "nbsr": ratios,
        }


@dataclass(frozen=True, slots=True)
class MgmFailure:
    """A spectrum that could not be fitted, and why."""

    id: str
    assemblage: str
    continuum: str
    status: str

    def to_dict(self) -> dict[str, Any]:
        """The same keys as a fit, without values."""
        empty = dict.fromkeys((*_SCALARS, "iterations", "model_error", "error_covers", *_NESTED))
        named = {"id": self.id, "assemblage": self.assemblage, "continuum": self.continuum, "status": self.status}
        return empty | named | {"converged": False, "bands": []}


_SCALARS = ("id", "assemblage", "continuum", "prior", "converged", "status", "rms_ln", "reduced_chi2", "bic")
_NESTED = ("nbsr", "continuum_coefficients")
"""Keys of JSON that are plain values of a fit, and that hold several."""


def pyroxene_pair(bands: Sequence[BandPrior | FittedBand], region: str) -> tuple[int, int] | None:
    """Positions of the bands of orthopyroxene and clinopyroxene whose strengths a ratio compares; None without both.

    The first of each in the region: what follows at 1 um is the weak band of the M1 site near 1.2 um.
    """
    first: dict[str, int] = {}
    for position, band in enumerate(bands):
        if band.region == region:
            first.setdefault(band.mineral, position)
    both = (first.get("orthopyroxene"), first.get("clinopyroxene"))
    return None if both[0] is None or both[1] is None else (both[0], both[1])
