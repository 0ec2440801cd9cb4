"""From radiance to reflectance factor, and the factors that products before the in-flight calibration need."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci import inputs
from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.spectra.rows import Row, check_widths, number, separator_of, split_fields, split_lines
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM, Detector

__all__ = ["IN_FLIGHT_VERSION", "ChannelFactors", "read_channel_factors", "reflectance_factor"]

IN_FLIGHT_VERSION = 2.0
"""`version_id` of products whose radiance rests on the calibration target seen in flight (since 2019-07-09)."""

_CHANNELS: dict[Detector, FloatArray] = {"vnir": VNIR_NM, "swir": SWIR_NM}
_FACTOR_RANGE = (0.2, 5.0)
"""A detector further off has failed; assumed."""


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
    lines, _ = split_lines(inputs.text(source))
    separator = separator_of(lines) if lines else ","
    table = [Row(n, split_fields(line, separator, f"{source.name}: line {n}")) for n, line in lines]
    names, rows = (table[0].fields, table[1:]) if table else ((), [])
    places = _places(names, source.name)
    if rows:
        check_widths(rows, source.name, len(names))
    found: dict[Detector, dict[float, float]] = {"vnir": {}, "swir": {}}
    for row in rows:
        name = row.fields[places["detector"]].lower()
        wavelength, factor = (_number(row, places[key], key, source.name) for key in ("wavelength_nm", "factor"))
        if name not in found:
            raise DataError(f"{source.name}: line {row.line}: the detector is {name[:20]!r}; use vnir or swir")
        if not _FACTOR_RANGE[0] <= factor <= _FACTOR_RANGE[1]:
            raise DataError(f"{source.name}: line {row.line}: the factor {factor:g} is outside 0.2 to 5; correct it")
        if wavelength in found[name]:
            raise DataError(f"{source.name}: line {row.line}: {wavelength:g} nm of {name} appears twice; keep one")
        found[name][wavelength] = factor
    return ChannelFactors(source.name, *(_all_channels(found[key], key, source.name) for key in ("vnir", "swir")))


def _places(names: Sequence[str], file: str) -> dict[str, int]:
    """Column name to place."""
    if len(set(names)) < len(names):
        raise DataError(f"{file}: two columns have one name; give each its own")
    lacking = {"detector", "wavelength_nm", "factor"} - set(names)
    if lacking:
        raise DataError(f"{file}: no column {', '.join(sorted(lacking))}; see `lunarsci spectra calibrate --help`")
    return {name: place for place, name in enumerate(names)}


def _number(row: Row, place: int, key: str, file: str) -> float:
    value = number(row.fields[place])
    if value is None or not np.isfinite(value):
        raise DataError(f"{file}: line {row.line}: {key} is {row.fields[place][:20]!r}, not a number; correct it")
    return value


def _all_channels(found: dict[float, float], detector: Detector, file: str) -> FloatArray:
    missing = [w for w in _CHANNELS[detector] if w not in found]
    if missing or len(found) != _CHANNELS[detector].size:
        what = f"{missing[0]:g} nm is missing" if missing else "there are other wavelengths"
        count = _CHANNELS[detector].size
        raise DataError(
            f"{file}: {detector} has {count} channels, {len(found)} are given and {what}; complete the file"
        )
    return np.array([found[w] for w in _CHANNELS[detector]])
