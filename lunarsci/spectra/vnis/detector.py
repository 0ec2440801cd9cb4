"""One detector's way from radiance to reflectance factor at the standard geometry, with its random errors."""

from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.noise import scatter_noise
from lunarsci.spectra.photometry import Geometry, correction_factor
from lunarsci.spectra.solar import SolarSpectrum, in_band_irradiance
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.sun import sun_moon_distance_au
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM, Detector, fixed_pattern, fwhm_nm, random_noise
from lunarsci.spectra.vnis.label import Label
from lunarsci.spectra.vnis.reflectance import reflectance_factor
from lunarsci.spectra.vnis.settings import Settings

__all__ = ["DetectorSpectrum", "irradiance_at", "measure"]

_NOISY = 1.5
"""Channels that scatter more than so many times the instrument's figures enlarge the errors; assumed."""

WAVELENGTHS: dict[Detector, FloatArray] = {"vnir": VNIR_NM, "swir": SWIR_NM}


@dataclass(frozen=True, slots=True, eq=False)
class DetectorSpectrum:
    """What one detector measured; arrays have one value per channel, NaN where it is not used.

    Attributes
    ----------
    detector : vnir or swir. wavelength_nm : its channels.
    geometry : incidence, emission, phase of this product. distance_au : Sun to Moon at its time.
    radiance : multiplied by the channel factors, where they apply. [W m-2 sr-1 nm-1]
    irradiance : in the channel, at 1 AU. [W m-2 nm-1]
    observed : reflectance factor at the angles of measurement. [-]
    correction : photometric factor to the standard geometry, 1 without correction. [-]
    relative_sigma : error independent between channels, over the reflectance: noise, fixed pattern and, for the image,
        the standard error of the mean over the pixels. [-]
    excess : scatter between neighbouring channels over what the instrument's figures make of it; `relative_sigma` is
        enlarged by it where it is above 1.5.
    """

    detector: Detector
    wavelength_nm: FloatArray
    geometry: Geometry
    distance_au: float
    radiance: FloatArray
    irradiance: FloatArray
    observed: FloatArray
    correction: FloatArray
    relative_sigma: FloatArray
    excess: float

    @property
    def corrected(self) -> FloatArray:
        """Reflectance factor after the photometric correction. [-]"""
        return self.observed * self.correction


def irradiance_at(detector: Detector, solar: SolarSpectrum) -> FloatArray:
    """Irradiance in the channels of one detector at 1 AU. [W m-2 nm-1]"""
    wavelength = WAVELENGTHS[detector]
    return in_band_irradiance(solar, wavelength, fwhm_nm(wavelength, detector))


def measure(
    detector: Detector, label: Label, radiance: FloatArray, mean_error: FloatArray, settings: Settings
) -> DetectorSpectrum:
    """Reflectance factor and its random error from radiance, NaN where a channel is not used.

    `mean_error` is the relative standard error of the mean over pixels, 0 for a single pixel.
    """
    wavelength = WAVELENGTHS[detector]
    middle = label.start + (label.stop - label.start) / 2
    distance = sun_moon_distance_au(middle)
    irradiance = irradiance_at(detector, settings.solar)
    observed = reflectance_factor(radiance, irradiance, label.geometry.incidence_deg, distance)
    correction = np.ones_like(wavelength)
    if settings.disk is not None:
        correction = correction_factor(label.geometry, wavelength, settings.disk, settings.phase)
    figures = np.hypot(random_noise(wavelength, detector), fixed_pattern(wavelength, detector))
    excess = _excess(observed, figures)
    sigma = np.hypot(figures * (excess if excess > _NOISY else 1.0), mean_error)
    return DetectorSpectrum(
        detector,
        wavelength,
        label.geometry,
        distance,
        radiance,
        irradiance,
        observed,
        correction,
        np.where(np.isfinite(observed), sigma, np.nan),
        excess,
    )


def _excess(observed: FloatArray, figures: FloatArray) -> float:
    """Median ratio of the scatter between neighbouring channels to the instrument's figures; NaN for a few channels."""
    good = np.isfinite(observed)
    if good.sum() < 10:
        return float("nan")
    return float(np.median(scatter_noise(np.log(observed[good])) / figures[good]))
