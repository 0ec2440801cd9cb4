"""Jumps of a spectrum where the acousto-optic filter changes its sub-band."""

from dataclasses import dataclass

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.channels import SUB_BAND_STEP_NM

__all__ = ["SWIR_STEP", "VNIR_STEPS", "Step", "StepSite", "find_step"]

_LEAST_CHANNELS = 5


@dataclass(frozen=True, slots=True)
class StepSite:
    """A place where a step is looked for.

    Attributes
    ----------
    at_nm : between the two channels. channels : on either side that tell the step.
    model_error : root mean square of the step found on 172 laboratory spectra (RELAB), which have none. [-]
    typical : root mean square of the step found on 88 Chang'E-4 spectra: its error where it is left as it is. [-]
    """

    at_nm: float
    channels: int
    model_error: float
    typical: float


SWIR_STEP = StepSite(SUB_BAND_STEP_NM, 12, 0.0021, 0.015)
"""With 16 channels on either side the model error is 0.0033; with 8 the noise of the step is a quarter larger."""
VNIR_STEPS = (StepSite(632.5, 8, 0.0015, 0.065), StepSite(757.5, 8, 0.0030, 0.050))
"""Sub-bands of the imager. What is found depends on the window (at 632.5 nm 5.5 % with 8 channels on either side, 3.3 %
with 12): the spectra are disturbed over some tens of nanometres there, not only displaced."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step found: `factor` on all channels below `at_nm` removes it, `sigma` is its relative standard error."""

    at_nm: float
    factor: float
    sigma: float


def find_step(site: StepSite, wavelength_nm: FloatArray, reflectance: FloatArray, sigma: FloatArray) -> Step:
    """The jump in a fit of ln R by a parabola with a jump, over the site's channels on either side.

    Parameters
    ----------
    wavelength_nm, reflectance, sigma : shape (n,); NaN where a channel is not used. [nm, -, -]

    Raises DataError when fewer than five channels on one side can be used.
    """
    with np.errstate(invalid="ignore"):
        good = (np.abs(wavelength_nm - site.at_nm) < 5 * site.channels) & (reflectance > 0) & (sigma > 0)
    before = good & (wavelength_nm < site.at_nm)
    if min(before.sum(), (good & ~before).sum()) < _LEAST_CHANNELS:
        low, high = site.at_nm - 5 * site.channels, site.at_nm + 5 * site.channels
        raise DataError(f"too few valid channels from {low:g} to {high:g} nm to find the step at {site.at_nm:g} nm")
    x = (wavelength_nm[good] - site.at_nm) / 100
    relative = sigma[good] / reflectance[good]
    design = np.stack([np.ones_like(x), x, x**2, before[good].astype(float)], axis=1) / relative[:, None]
    solution, *_ = np.linalg.lstsq(design, np.log(reflectance[good]) / relative, rcond=None)
    covariance = np.linalg.inv(design.T @ design)
    error = np.hypot(np.sqrt(covariance[3, 3]), site.model_error)
    return Step(site.at_nm, float(np.exp(-solution[3])), float(error))
