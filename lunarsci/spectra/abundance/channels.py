"""The channels on which a spectrum is compared with mixtures: means over 20 nm."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import Spectrum

STEP_NM, LOWEST_NM, HIGHEST_NM = 20.0, 450.0, 2450.0
"""Channels that are compared: features of minerals are ten times as wide."""
NEEDED_NM = (750.0, 2300.0)
FARTHEST_NM = 5.0
"""How far means of one channel may lie apart where spectra are compared together."""


@dataclass(frozen=True, slots=True, eq=False)
class CommonChannels:
    """Spectra on channels common to all.

    Attributes
    ----------
    wavelength_nm : (n,) mean wavelengths. [nm]
    ln_reflectance, noise : (s, n) means of ln R, and their standard errors. [-]
    """

    wavelength_nm: FloatArray
    ln_reflectance: FloatArray
    noise: FloatArray


def on_common_channels(spectra: Sequence[Spectrum]) -> CommonChannels:
    """Means over channels of `STEP_NM`; a channel that one spectrum lacks is left out of all.

    Raises
    ------
    DataError for a spectrum that does not reach over `NEEDED_NM`, and spectra that have no channels in common.
    """
    binned = [_binned(spectrum) for spectrum in spectra]
    common = sorted(set.intersection(*(set(channels) for channels in binned)))
    table = np.array([[channels[index] for index in common] for channels in binned])
    wavelength = table[..., 0]
    apart = np.flatnonzero(np.ptp(wavelength, axis=0) <= FARTHEST_NM)
    if (
        not apart.size
        or common[apart[0]] * STEP_NM + LOWEST_NM > NEEDED_NM[0]
        or _end(common[apart[-1]]) < NEEDED_NM[1]
    ):
        raise DataError("the spectra have too few channels in common to be unmixed together; resample them alike")
    table = table[:, apart]
    return CommonChannels(table[..., 0].mean(axis=0), table[..., 1], table[..., 2])


def _end(index: float) -> float:
    return (index + 1) * STEP_NM + LOWEST_NM


def _binned(spectrum: Spectrum) -> dict[int, tuple[float, float, float]]:
    """Mean wavelength, mean ln R and its standard error by number of the channel."""
    usable = spectrum.usable
    wavelength, reflectance = spectrum.wavelength_nm[usable], spectrum.reflectance[usable]
    if not wavelength.size or wavelength[0] > NEEDED_NM[0] or wavelength[-1] < NEEDED_NM[1]:
        raise DataError(f"{spectrum.id}: unmixing needs {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm")
    noise = np.zeros_like(wavelength)
    if spectrum.uncertainty is not None:
        noise = spectrum.uncertainty[usable] / reflectance
    inside = np.flatnonzero((wavelength >= LOWEST_NM) & (wavelength < HIGHEST_NM))
    number, index = np.unique(np.floor((wavelength[inside] - LOWEST_NM) / STEP_NM), return_inverse=True)
    count = np.bincount(index)
    mean_nm, mean = (np.bincount(index, row[inside]) / count for row in (wavelength, np.log(reflectance)))
    error = np.sqrt(np.bincount(index, noise[inside] ** 2)) / count
    return {int(key): row for key, *row in zip(number, mean_nm, mean, error, strict=True)}  # type: ignore[misc]
