"""A spectrum as the Modified Gaussian Model sees it: ln R on its usable channels, with weights."""

from dataclasses import dataclass

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.noise import channel_noise
from lunarsci.spectra.spectrum import FloatArray, Spectrum

__all__ = ["FIT_RANGE_NM", "MgmData", "prepare"]

FIT_RANGE_NM = (400.0, 2600.0)
REQUIRED_NM = (800.0, 1300.0)
"""Without the 1 um region there is nothing that tells the three minerals apart."""
MIN_CHANNELS = 40


@dataclass(frozen=True, slots=True, eq=False)
class MgmData:
    """One spectrum in ln R with its weights.

    Attributes
    ----------
    wavelength_nm, reflectance : (n,), ascending, all usable. [nm, -]
    weight : (n,) 1 / variance of ln R, of noise and model error together. [-]
    shifts : (k, n) changes of ln R by one standard deviation of errors that all channels share. [-]
    """

    id: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    weight: FloatArray
    shifts: FloatArray


def prepare(spectrum: Spectrum, model_error: float) -> MgmData:
    """The usable channels within 400-2600 nm, their noise and `model_error` (of ln R) added in quadrature.

    Raises DataError with fewer than 40 channels, or where they do not reach over 800-1300 nm.
    """
    low, high = FIT_RANGE_NM
    wavelength = spectrum.wavelength_nm
    keep = spectrum.usable & (wavelength >= low) & (wavelength <= high)
    if keep.sum() < MIN_CHANNELS:
        raise DataError(f"{keep.sum()} usable channels between {low:g} and {high:g} nm; {MIN_CHANNELS} are needed")
    if wavelength[keep][0] > REQUIRED_NM[0] or wavelength[keep][-1] < REQUIRED_NM[1]:
        raise DataError(f"the channels do not reach over {REQUIRED_NM[0]:g}-{REQUIRED_NM[1]:g} nm")
    reflectance = spectrum.reflectance[keep]
    relative = channel_noise(spectrum)[keep] / reflectance
    shifts = np.array([shift[keep] / reflectance for shift in spectrum.systematic.values()])
    weight = 1 / (relative**2 + model_error**2)
    return MgmData(spectrum.id, wavelength[keep], reflectance, weight, shifts.reshape(-1, reflectance.size))
