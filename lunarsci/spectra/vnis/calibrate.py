"""The chain: from an observation's radiances to one reflectance spectrum with its errors."""

from collections.abc import Callable, Sequence

import numpy as np

from lunarsci.errors import LunarSciError
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.sun import sun_moon_distance_au
from lunarsci.spectra.vnis.calibration import Calibration, CalibrationFailure
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM
from lunarsci.spectra.vnis.detector import irradiance_at
from lunarsci.spectra.vnis.footprint import SHADOW_BAND_NM, registration_error, shadow_limit_shift
from lunarsci.spectra.vnis.label import Label
from lunarsci.spectra.vnis.observation import Observation, read_observation
from lunarsci.spectra.vnis.reflectance import IN_FLIGHT_VERSION, reflectance_factor
from lunarsci.spectra.vnis.screening import (
    Notes,
    bad_swir,
    bad_vnir,
    closing_remarks,
    lit_footprint,
    measured,
    spliced,
)
from lunarsci.spectra.vnis.settings import RADIANCE_UNITS, Settings, default_settings
from lunarsci.spectra.vnis.systematics import Shift, shared_errors

__all__ = ["calibrate", "calibrate_files"]

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
