"""The chain: from an observation's radiances to one reflectance spectrum with its errors.

Errors that all channels share: each is one shift of both detectors, carried through the joining.

The absolute calibration and the irradiance were established before the flight or by others, the photometric model is a
choice among several: repeating the measurement does not make these errors smaller, and they do not scatter.

"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lunarsci.errors import DataError, LunarSciError
from lunarsci.spectra.photometry import Geometry, model_spread
from lunarsci.spectra.solar import (
    M3_TABLE,
    solar_spectrum,
    sun_moon_distance_au,
)
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.calibration import Calibration, CalibrationFailure
from lunarsci.spectra.vnis.channels import SPLICED_NM, SWIR_NM, VNIR_NM
from lunarsci.spectra.vnis.detector import (
    IN_FLIGHT_VERSION,
    RADIANCE_UNITS,
    DetectorSpectrum,
    Settings,
    default_settings,
    irradiance_at,
    reflectance_factor,
)
from lunarsci.spectra.vnis.footprint import SHADOW_BAND_NM, registration_error, shadow_limit_shift
from lunarsci.spectra.vnis.label import Label
from lunarsci.spectra.vnis.observation import Observation, read_observation
from lunarsci.spectra.vnis.screening import (
    Notes,
    bad_swir,
    bad_vnir,
    closing_remarks,
    lit_footprint,
    measured,
    spliced,
)
from lunarsci.spectra.vnis.splice import Splice, find_splice
from lunarsci.tables import table_rows

__all__ = [
    "CALIBRATION",
    "Shift",
    "calibrate",
    "calibrate_files",
    "shared_errors",
]


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


_IMAGE_NM = 750.0


def calibrate_files(
    paths: Sequence[str],
    settings: Settings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Calibration | CalibrationFailure]:
    """Calibrate the observation of every path, one after the other; a bad one becomes a `CalibrationFailure`."""
    chosen = settings or default_settings()
    results: list[Calibration | CalibrationFailure] = []
    for done, path in enumerate(paths):
        if progress:
            progress(done, len(paths))
        try:
            results.append(calibrate(read_observation(path), chosen))
        except LunarSciError as error:
            results.append(CalibrationFailure(path, str(error)))
        except Exception as error:  # a fault of ours with one product must not cost the others
            results.append(CalibrationFailure(path, f"{path}: unexpected {type(error).__name__}: {error}"))
    if progress:
        progress(len(paths), len(paths))
    return results


def calibrate(observation: Observation, settings: Settings | None = None) -> Calibration:
    """Reflectance factor of the footprint on 390 channels, with independent and shared errors.

    The lit pixels of the SWIR field of view are averaged, and the radiance of SWIR is freed of the shadows it averages
    over. Both detectors become reflectance factors, each with its own angles, time and irradiance, and are brought to
    the standard geometry. The sub-bands of SWIR are joined, then VNIR is scaled to SWIR.

    Raises DataError when nothing is lit, a detector is dark, radiances have another unit, or there is no overlap.
    Whatever is worth a second look is a LunarSciWarning and stands in `notes`.
    """
    chosen = settings or default_settings()
    notes = Notes(observation.id)
    scale = RADIANCE_UNITS[chosen.radiance_unit]
    vnir_factors, swir_factors = _channel_factors(observation, chosen, notes)
    limit = _shadow_radiance(observation.cube_label, chosen, scale, vnir_factors)
    footprint = lit_footprint(observation, chosen, limit, notes)
    vnir_shift, dilution_shift = shadow_limit_shift(observation.cube, footprint, limit)
    seen: dict[str, Shift] = {
        "shadow_limit": (vnir_shift, np.full(SWIR_NM.size, -dilution_shift)),
        "registration": (0 * VNIR_NM, np.full(SWIR_NM.size, registration_error(observation.cube, footprint))),
    }
    vnir_bad = bad_vnir(observation, footprint, notes)
    swir_bad = bad_swir(observation, notes)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_error = footprint.scatter / footprint.mean / np.sqrt(np.maximum(footprint.count, 1))
    vnir_radiance = np.where(vnir_bad, np.nan, footprint.mean * scale * vnir_factors)
    swir_radiance = np.where(swir_bad, np.nan, observation.table.radiance * scale * swir_factors / footprint.dilution)
    vnir = measured("vnir", observation, vnir_radiance, mean_error, chosen, notes)
    swir = measured("swir", observation, swir_radiance, 0 * SWIR_NM, chosen, notes)
    splice = spliced(vnir, swir, observation.id, notes, remove_vnir_steps=chosen.remove_vnir_steps)
    reflectance = splice.join(vnir.corrected, swir.corrected)
    closing_remarks(vnir, swir, observation, chosen, notes)
    return Calibration(
        id=observation.id,
        synthetic=observation.synthetic,
        time_utc=observation.table_label.start.isoformat(timespec="seconds"),
        latitude_deg=observation.table_label.latitude_deg,
        longitude_deg=observation.table_label.longitude_deg,
        reflectance=reflectance,
        sigma=splice.join(vnir.corrected * vnir.relative_sigma, swir.corrected * swir.relative_sigma),
        systematic=shared_errors(vnir, swir, splice, reflectance, chosen, seen),
        vnir=vnir,
        swir=swir,
        splice=splice,
        footprint=footprint,
        image=np.array(observation.cube[int(np.flatnonzero(VNIR_NM == _IMAGE_NM)[0])]),
        disk=chosen.disk or "none",
        phase=chosen.phase.name if chosen.disk else "none",
        solar=chosen.solar.name,
        notes=tuple(notes.lines),
        inputs=observation.inputs | dict(chosen.inputs),
    )


def _channel_factors(observation: Observation, settings: Settings, notes: Notes) -> tuple[FloatArray, FloatArray]:
    """Factors for radiances that precede the in-flight calibration, ones for all others."""
    before = [label for label in (observation.cube_label, observation.table_label) if _is_early(label)]
    ones = np.ones(VNIR_NM.size), np.ones(SWIR_NM.size)
    if not before:
        if settings.factors is not None:
            notes.add("channel factors not applied: the radiance is from after the in-flight calibration")
        return ones
    if settings.factors is None:
        message = "radiance from before the in-flight calibration (version 1); give channel factors by --calibration"
        notes.warn(message)
        return ones
    notes.add(f"channel factors of {settings.factors.source} applied")
    return (
        settings.factors.vnir if _is_early(observation.cube_label) else ones[0],
        settings.factors.swir if _is_early(observation.table_label) else ones[1],
    )


def _is_early(label: Label) -> bool:
    return label.calibration_version < IN_FLIGHT_VERSION


def _shadow_radiance(label: Label, settings: Settings, scale: float, factors: FloatArray) -> float:
    """The limit of shadows in the unit of the file at 465 nm."""
    band = int(np.flatnonzero(VNIR_NM == SHADOW_BAND_NM)[0])
    distance = sun_moon_distance_au(label.start)
    irradiance = irradiance_at("vnir", settings.solar)[band : band + 1]
    one = reflectance_factor(np.array([scale * factors[band]]), irradiance, label.geometry.incidence_deg, distance)
    return settings.shadow_limit / float(one[0])
