"""Channels of VNIS: wavelengths, width of the response, noise, and where the SWIR detector looks in the VNIR image."""

from typing import Literal

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_rows

Detector = Literal["vnir", "swir"]

VNIR_NM: FloatArray = np.arange(450.0, 946.0, 5.0)
"""The 100 channels of the CMOS imager: Li et al. (2019), Rev. Sci. Instrum. 90, 10.1063/1.5089737, and the product
labels. [nm]"""
SWIR_NM: FloatArray = np.arange(900.0, 2396.0, 5.0)
"""The 300 channels of the single-pixel detector: Li et al. (2019), 10.1063/1.5089737, and the product labels. [nm]"""
JOIN_NM = 900.0
"""First channel that the spliced spectrum takes from the SWIR detector; assumed. [nm]"""
SPLICED_NM: FloatArray = np.arange(450.0, 2396.0, 5.0)
"""The 390 channels of a spliced spectrum: 90 of the imager, 300 of the SWIR detector; see `JOIN_NM`. [nm]"""
SUB_BAND_STEP_NM = 1377.5
"""Between 1375 and 1380 nm the SWIR filter changes its sub-band, as its channels' times in the labels (CNSA 2020) and
`vnis_fwhm.csv` show. [nm]"""
VNIR_SUB_BANDS_NM = (632.5, 757.5)
"""So does that of VNIR, twice: measured, as steps of the 88 public spectra. [nm]"""
CUBE_SHAPE = (100, 256, 256)
"""Bands, lines, samples of the image cube."""
FOOTPRINT = (127.0, 97.0, 53.8)
"""Line and sample (from 0) of the centre and radius of the SWIR field of view in the VNIR image, as the product labels
state it (CNSA 2020, Lunar and Planetary Data Release System; line 128, sample 98, counted from 1). [px]"""

TABLES = ("vnis_fwhm.csv", "vnis_noise.csv")
_FWHM, _NOISE = TABLES


def fwhm_nm(wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Full width at half maximum of the channels of one detector. [nm]

    Parameters
    ----------
    wavelength_nm : shape (n,), within 450-945 nm (vnir) or 900-2395 nm (swir).

    Raises ParameterError outside these ranges. Source: `vnis-fwhm` in `sources.toml`.
    """
    names = ("cubic_nm_per_um3", "quadratic_nm_per_um2", "linear_nm_per_um", "constant_nm")
    a, b, c, d = _by_channel(_FWHM, wavelength_nm, detector, names)
    x = np.asarray(wavelength_nm, dtype=float) / 1000
    return ((a * x + b) * x + c) * x + d


def random_noise(wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Relative standard deviation of a footprint mean from one observation to the next; same rules as `fwhm_nm`. [-]"""
    return _by_channel(_NOISE, wavelength_nm, detector, ("random_relative",))[0]


def fixed_pattern(wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Relative standard deviation of what all spectra share, channel by channel; same rules as `fwhm_nm`. [-]"""
    return _by_channel(_NOISE, wavelength_nm, detector, ("fixed_pattern_relative",))[0]


def footprint_mask() -> BoolArray:
    """Pixels of the VNIR image that the SWIR detector sees; shape (256, 256), 9085 of them True."""
    line, sample, radius = FOOTPRINT
    lines, samples = np.ogrid[: CUBE_SHAPE[1], : CUBE_SHAPE[2]]
    mask: BoolArray = (lines - line) ** 2 + (samples - sample) ** 2 <= radius**2
    return mask


def _by_channel(table: str, wavelength_nm: FloatArray, detector: Detector, names: tuple[str, ...]) -> list[FloatArray]:
    wavelength = np.asarray(wavelength_nm, dtype=float)
    rows = [row for row in table_rows(table) if row["detector"] == detector]
    starts = np.array([float(row["from_nm"]) for row in rows])
    last = float(rows[-1]["to_nm"])
    if not ((wavelength >= starts[0]) & (wavelength <= last)).all():
        raise ParameterError(f"the {detector.upper()} detector has channels from {starts[0]:g} to {last:g} nm only")
    place = np.searchsorted(starts, wavelength, side="right") - 1
    return [np.array([float(row[name]) for row in rows])[place] for name in names]
