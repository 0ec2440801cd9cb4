"""From radiance to reflectance factor, and the factors that products before the in-flight calibration need."""

import csv
import re
from dataclasses import dataclass

import numpy as np

from lunarsci import inputs
from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM, Detector

__all__ = ["IN_FLIGHT_VERSION", "ChannelFactors", "read_channel_factors", "reflectance_factor"]

IN_FLIGHT_VERSION = 2.0
"""`version_id` of products whose radiance rests on the calibration target seen in flight (since 2019-07-09)."""

_CHANNELS: dict[Detector, FloatArray] = {"vnir": VNIR_NM, "swir": SWIR_NM}
_FACTOR_RANGE = (0.2, 5.0)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)


def reflectance_factor(
    radiance: FloatArray, irradiance: FloatArray, incidence_deg: float, distance_au: float
) -> FloatArray:
    """REFF = pi L d^2 / (E0 cos i): radiance over that of a perfectly diffuse surface lit the same way. [-]

    Parameters
    ----------
    radiance : L, any shape that broadcasts with `irradiance`. [W m-2 sr-1 nm-1]
    irradiance : E0 in the channel at 1 AU, above 0. [W m-2 nm-1]
    incidence_deg : i, 0 up to below 90. [deg]
    distance_au : d, Sun to Moon, above 0. [AU]

    Raises ParameterError outside these ranges.

    Hapke (2012), Theory of Reflectance and Emittance Spectroscopy, 10.1017/CBO9781139025683; Ding et al. (2024),
    10.1038/s41467-024-46233-8 (their equation 29).
    """
    if not 0 <= incidence_deg < 90:
        raise ParameterError(f"incidence is {incidence_deg:g} deg; it must be from 0 to below 90")
    if not (distance_au > 0 and (np.asarray(irradiance) > 0).all()):
        raise ParameterError("distance and irradiance must be above 0")
    factor: FloatArray = np.pi * radiance * distance_au**2 / (irradiance * np.cos(np.radians(incidence_deg)))
    return factor


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFactors:
    """What radiances of version 1 are multiplied with, channel by channel. [-]"""

    source: str
    vnir: FloatArray
    swir: FloatArray


def read_channel_factors(source: InputFile) -> ChannelFactors:
    """Read a CSV file with the columns `detector` (vnir or swir), `wavelength_nm` and `factor`, one row per channel.

    Raises DataError for other columns, missing or repeated channels, and factors outside 0.2 to 5.
    """
    try:
        reader = csv.DictReader(line for line in inputs.text(source).splitlines() if not line.startswith("#"))
        rows, names = list(reader), list(reader.fieldnames or ())
    except csv.Error as error:
        raise DataError(f"{source.name}: no CSV table ({error}); see `lunarsci spectra calibrate --help`") from error
    if len(set(names)) < len(names):
        raise DataError(f"{source.name}: two columns have one name; give each its own")
    lacking = {"detector", "wavelength_nm", "factor"} - set(names)
    if lacking:
        raise DataError(
            f"{source.name}: no column {', '.join(sorted(lacking))}; see `lunarsci spectra calibrate --help`"
        )
    found: dict[Detector, dict[float, float]] = {"vnir": {}, "swir": {}}
    for line, row in enumerate(rows, 2):
        detector = (row["detector"] or "").strip().lower()
        if detector not in ("vnir", "swir"):
            raise DataError(f"{source.name}: row {line}: the detector is {detector[:20]!r}; use vnir or swir")
        wavelength, factor = (_number(row[key], key, line, source.name) for key in ("wavelength_nm", "factor"))
        if not _FACTOR_RANGE[0] <= factor <= _FACTOR_RANGE[1]:
            raise DataError(f"{source.name}: row {line}: the factor {factor:g} is outside 0.2 to 5; correct it")
        if wavelength in found[detector]:  # type: ignore[index]
            raise DataError(f"{source.name}: row {line}: {wavelength:g} nm of {detector} appears twice; keep one")
        found[detector][wavelength] = factor  # type: ignore[index]
    return ChannelFactors(source.name, *(_all_channels(found[key], key, source.name) for key in ("vnir", "swir")))


def _number(text: str | None, key: str, line: int, file: str) -> float:
    stripped = (text or "").strip()
    if not _NUMBER.fullmatch(stripped):
        raise DataError(f"{file}: row {line}: {key} is {stripped[:20]!r}, not a number; correct it")
    return float(stripped)


def _all_channels(found: dict[float, float], detector: Detector, file: str) -> FloatArray:
    missing = [w for w in _CHANNELS[detector] if w not in found]
    if missing or len(found) != _CHANNELS[detector].size:
        what = f"{missing[0]:g} nm is missing" if missing else "there are other wavelengths"
        count = _CHANNELS[detector].size
        raise DataError(
            f"{file}: {detector} has {count} channels, {len(found)} are given and {what}; complete the file"
        )
    return np.array([found[w] for w in _CHANNELS[detector]])
