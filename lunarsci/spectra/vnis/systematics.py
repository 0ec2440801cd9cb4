"""Errors that all channels share: each is one shift of both detectors, carried through the joining.

The absolute calibration and the irradiance were established before the flight or by others, the photometric model is a
choice among several: repeating the measurement does not make these errors smaller, and they do not scatter.
"""

from collections.abc import Mapping

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.photometry import Geometry, model_spread
from lunarsci.spectra.solar import M3_TABLE, solar_spectrum
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.detector import DetectorSpectrum, irradiance_at
from lunarsci.spectra.vnis.settings import Settings
from lunarsci.spectra.vnis.splice import Splice, find_splice
from lunarsci.tables import table_rows

__all__ = ["CALIBRATION", "Shift", "shared_errors"]

CALIBRATION = {"vnir": 0.05, "swir": 0.07}
"""Relative error of the level of each detector, as quoted for the instrument; assumed, the source could not be read.
The error of the Sun's level, 0.6 %, is small beside it. [-]"""
_SMOOTH_CHANNELS = 21
"""Over so many channels a difference of two solar spectra is broad, not detail; assumed."""
_NEGLIGIBLE = 1e-5


Shift = tuple[FloatArray, FloatArray]
"""Shifts of ln R of VNIR, shape (100,), and of SWIR, shape (300,)."""


def shared_errors(
    vnir: DetectorSpectrum,
    swir: DetectorSpectrum,
    splice: Splice,
    spliced: FloatArray,
    settings: Settings,
    seen: Mapping[str, Shift],
) -> dict[str, FloatArray]:
    """Name of each error to the shift of the spliced spectrum by one standard deviation of it, shape (390,). [-]

    `calibration_vnir`, `calibration_swir` : level of each detector; the first vanishes where VNIR is scaled to SWIR.
    `irradiance_shape`, `irradiance_detail` : broad difference to the solar spectrum of M3, difference to a standard.
    `photometry_1`, `photometry_2`, `phase_edge` : spread over disk and phase functions, and holding the phase function
        at the end of its wavelengths or not; absent without correction.
    `shadow_limit`, `registration` : what is shadow, and where the field of view lies to a pixel; given as `seen`.
    `splice_gain`, `splice_overlap`, `splice_step`, `vnir_step_632`, `vnir_step_758` : errors of the joining factors.
    """
    shifts = _detector_shifts(vnir, swir, settings) | dict(seen)
    modes = {name: _carried(vnir, swir, shift, settings) for name, shift in shifts.items()} | splice.modes(spliced)
    filled = {name: np.where(np.isfinite(mode), mode, 0.0) for name, mode in modes.items()}
    size = np.nanmedian(spliced)
    return {name: mode for name, mode in filled.items() if np.abs(mode).max() > _NEGLIGIBLE * size}


def _detector_shifts(vnir: DetectorSpectrum, swir: DetectorSpectrum, settings: Settings) -> dict[str, Shift]:
    """Relative shifts of ln R of the two detectors."""
    ones = np.ones_like(vnir.wavelength_nm), np.ones_like(swir.wavelength_nm)
    detail = [np.log(d.irradiance / irradiance_at(d.detector, settings.other_solar)) for d in (vnir, swir)]
    shifts: dict[str, Shift] = {
        "calibration_vnir": (CALIBRATION["vnir"] * ones[0], 0 * ones[1]),
        "calibration_swir": (0 * ones[0], CALIBRATION["swir"] * ones[1]),
        "irradiance_shape": (_to_m3(vnir), _to_m3(swir)),
        "irradiance_detail": (detail[0], detail[1]),
    }
    if settings.disk is not None:
        both, geometry = np.concatenate([vnir.wavelength_nm, swir.wavelength_nm]), _between(vnir, swir)
        for number, mode in enumerate(model_spread(geometry, both, settings.disk, settings.phase), 1):
            shifts[f"photometry_{number}"] = (mode[: ones[0].size], mode[ones[0].size :])
        edges = [settings.phase.edge_shift(geometry.phase_deg, d.wavelength_nm) for d in (vnir, swir)]
        shifts["phase_edge"] = (edges[0], edges[1])
    return shifts


def _to_m3(item: DetectorSpectrum) -> FloatArray:
    """ln of the irradiance used over that of M3, broad features only. [-]"""
    rows = table_rows(M3_TABLE)
    nodes, ln_ratio = (np.array([float(row[name]) for row in rows]) for name in ("wavelength_nm", "ln_ratio"))
    to_standard = np.log(item.irradiance / irradiance_at(item.detector, solar_spectrum("e490")))
    half = _SMOOTH_CHANNELS // 2
    padded = np.pad(to_standard, half, mode="edge")
    smooth = np.convolve(padded, np.full(_SMOOTH_CHANNELS, 1 / _SMOOTH_CHANNELS), mode="valid")
    return np.asarray(smooth - np.interp(item.wavelength_nm, nodes, ln_ratio), dtype=np.float64)


def _between(vnir: DetectorSpectrum, swir: DetectorSpectrum) -> Geometry:
    """The mean geometry of both: they differ by hundredths of a degree."""
    a, b = vnir.geometry, swir.geometry
    return Geometry(
        (a.incidence_deg + b.incidence_deg) / 2, (a.emission_deg + b.emission_deg) / 2, (a.phase_deg + b.phase_deg) / 2
    )


def _carried(vnir: DetectorSpectrum, swir: DetectorSpectrum, shift: Shift, settings: Settings) -> FloatArray:
    """Half the way between the joined spectra with the error of either sign: 7 % of ln R are 7 %, not e^0.07 - 1."""
    up, down = (_respliced(vnir, swir, (sign * shift[0], sign * shift[1]), settings) for sign in (1.0, -1.0))
    return (up - down) / 2


def _respliced(vnir: DetectorSpectrum, swir: DetectorSpectrum, shift: Shift, settings: Settings) -> FloatArray:
    first, second = (d.corrected * np.exp(s) for d, s in zip((vnir, swir), shift, strict=True))
    try:
        splice = find_splice(
            first,
            second,
            first * vnir.relative_sigma,
            second * swir.relative_sigma,
            remove_vnir_steps=settings.remove_vnir_steps,
        )
    except DataError:  # the unshifted spectra were spliced: a shift of some percent changes nothing about that
        return np.full(SPLICED_NM.size, np.nan)
    return splice.join(first, second)
