"""Errors that all channels share: each is one shift of both detectors, carried through the joining.

The absolute calibration and the irradiance were established before the flight or by others, the photometric model is a
choice among several: repeating the measurement does not make these errors smaller, and they do not scatter.
"""

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.photometry import Geometry, model_spread
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.detector import DetectorSpectrum, irradiance_at
from lunarsci.spectra.vnis.settings import Settings
from lunarsci.spectra.vnis.splice import Splice, find_splice

__all__ = ["CALIBRATION", "IRRADIANCE_SCALE", "shared_errors"]

CALIBRATION = {"vnir": 0.05, "swir": 0.07}
"""Relative error of the absolute radiometric calibration of the detectors, He et al. (2019), Sensors 19, 2806,
10.3390/s19122806. [-]"""
IRRADIANCE_SCALE = 0.006
"""Relative error of the level of the solar spectra: what the standards G173 and E490 differ by. [-]"""
_NEGLIGIBLE = 1e-5


def shared_errors(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, splice: Splice, spliced: FloatArray, settings: Settings
) -> dict[str, FloatArray]:
    """Name of each error to the shift of the spliced spectrum by one standard deviation of it, shape (390,). [-]

    `calibration_vnir`, `calibration_swir` : level of each detector; the first vanishes where VNIR is scaled to SWIR.
    `irradiance_level`, `irradiance_shape` : level, and difference between two documented solar spectra.
    `photometry_1`, `photometry_2` : spread over disk and phase functions; absent without correction.
    `splice_gain`, `splice_step` : statistical errors of the joining factors.
    """
    shifts = _detector_shifts(vnir, swir, settings)
    modes = {name: _respliced(vnir, swir, shift) - spliced for name, shift in shifts.items()} | splice.modes(spliced)
    filled = {name: np.where(np.isfinite(mode), mode, 0.0) for name, mode in modes.items()}
    size = np.nanmedian(spliced)
    return {name: mode for name, mode in filled.items() if np.abs(mode).max() > _NEGLIGIBLE * size}


def _detector_shifts(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, settings: Settings
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Relative shifts of ln R of the two detectors."""
    ones = np.ones_like(vnir.wavelength_nm), np.ones_like(swir.wavelength_nm)
    shape = tuple(np.log(d.irradiance / irradiance_at(d.detector, settings.other_solar)) for d in (vnir, swir))
    shifts = {
        "calibration_vnir": (CALIBRATION["vnir"] * ones[0], 0 * ones[1]),
        "calibration_swir": (0 * ones[0], CALIBRATION["swir"] * ones[1]),
        "irradiance_level": (IRRADIANCE_SCALE * ones[0], IRRADIANCE_SCALE * ones[1]),
        "irradiance_shape": (shape[0], shape[1]),
    }
    if settings.disk is not None:
        both = np.concatenate([vnir.wavelength_nm, swir.wavelength_nm])
        for number, mode in enumerate(model_spread(_between(vnir, swir), both, settings.disk, settings.phase), 1):
            shifts[f"photometry_{number}"] = (mode[: ones[0].size], mode[ones[0].size :])
    return shifts


def _between(vnir: DetectorSpectrum, swir: DetectorSpectrum) -> Geometry:
    """The mean geometry of both: they differ by hundredths of a degree."""
    a, b = vnir.geometry, swir.geometry
    return Geometry(
        (a.incidence_deg + b.incidence_deg) / 2, (a.emission_deg + b.emission_deg) / 2, (a.phase_deg + b.phase_deg) / 2
    )


def _respliced(vnir: DetectorSpectrum, swir: DetectorSpectrum, shift: tuple[FloatArray, FloatArray]) -> FloatArray:
    first, second = (d.corrected * np.exp(s) for d, s in zip((vnir, swir), shift, strict=True))
    try:
        splice = find_splice(first, second, first * vnir.relative_sigma, second * swir.relative_sigma)
    except DataError:  # the unshifted spectra were spliced: a shift of some percent changes nothing about that
        return np.full(first.size - 10 + second.size, np.nan)
    return splice.join(first, second)
