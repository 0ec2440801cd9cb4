"""The chain: from an observation's radiances to one reflectance spectrum with its errors."""

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from lunarsci.errors import DataError, LunarSciError, LunarSciWarning
from lunarsci.spectra.photometry import remarks
from lunarsci.spectra.spectrum import BoolArray, FloatArray
from lunarsci.spectra.sun import sun_moon_distance_au
from lunarsci.spectra.vnis.calibration import Calibration, CalibrationFailure
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM
from lunarsci.spectra.vnis.detector import DetectorSpectrum, irradiance_at, measure
from lunarsci.spectra.vnis.footprint import SHADOW_BAND_NM, Footprint, average_footprint, shadow_limit_shift
from lunarsci.spectra.vnis.label import Label
from lunarsci.spectra.vnis.observation import Observation, read_observation
from lunarsci.spectra.vnis.reflectance import IN_FLIGHT_VERSION, reflectance_factor
from lunarsci.spectra.vnis.settings import RADIANCE_UNITS, Settings, default_settings
from lunarsci.spectra.vnis.splice import GAIN_LIMIT, STEP_LIMIT, Splice, find_splice
from lunarsci.spectra.vnis.systematics import shared_errors

__all__ = ["calibrate", "calibrate_files"]

_IMAGE_NM = 750.0
_LEAST_LIT = 0.01
_MUCH_SHADOW = 0.3
_DARK = 0.01
_BRIGHT = 2.0
_SWIR_PLATEAU = 3
_GRAZING_DEG = 80.0
_NOTED_STEP_SIGMAS = 3.0


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
    notes: list[str] = []
    scale = RADIANCE_UNITS[chosen.radiance_unit]
    vnir_factors, swir_factors = _channel_factors(observation, chosen, notes)
    limit = _shadow_radiance(observation.cube_label, chosen, scale, vnir_factors)
    footprint = _footprint(observation, chosen, limit, notes)
    vnir_shift, dilution_shift = shadow_limit_shift(observation.cube, footprint, limit)
    shadow_shift = (vnir_shift, np.full(SWIR_NM.size, -dilution_shift))
    vnir_bad = ~(footprint.mean > 0) | (False if observation.cube_flags is None else observation.cube_flags)
    swir_bad = _bad_swir(observation, notes)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_error = footprint.scatter / footprint.mean / np.sqrt(np.maximum(footprint.count, 1))
    vnir_radiance = np.where(vnir_bad, np.nan, footprint.mean * scale * vnir_factors)
    swir_radiance = np.where(swir_bad, np.nan, observation.table.radiance * scale * swir_factors / footprint.dilution)
    vnir = measure("vnir", observation.cube_label, vnir_radiance, mean_error, chosen)
    swir = measure("swir", observation.table_label, swir_radiance, np.zeros(SWIR_NM.size), chosen)
    for item, label in ((vnir, observation.cube_label), (swir, observation.table_label)):
        _check_level(item, label, observation.id)
    splice = _splice(vnir, swir, observation.id, notes, remove_vnir_steps=chosen.remove_vnir_steps)
    reflectance = splice.join(vnir.corrected, swir.corrected)
    _remark(vnir, swir, observation, chosen, notes)
    return Calibration(
        id=observation.id,
        synthetic=observation.synthetic,
        time_utc=observation.table_label.start.isoformat(timespec="seconds"),
        latitude_deg=observation.table_label.latitude_deg,
        longitude_deg=observation.table_label.longitude_deg,
        reflectance=reflectance,
        sigma=splice.join(vnir.corrected * vnir.relative_sigma, swir.corrected * swir.relative_sigma),
        systematic=shared_errors(vnir, swir, splice, reflectance, chosen, shadow_shift),
        vnir=vnir,
        swir=swir,
        splice=splice,
        footprint=footprint,
        image=np.array(observation.cube[int(np.flatnonzero(VNIR_NM == _IMAGE_NM)[0])]),
        disk=chosen.disk or "none",
        phase=chosen.phase.name if chosen.disk else "none",
        solar=chosen.solar.name,
        notes=tuple(notes),
        inputs=observation.inputs | dict(chosen.inputs),
    )


def _channel_factors(observation: Observation, settings: Settings, notes: list[str]) -> tuple[FloatArray, FloatArray]:
    """Factors for radiances that precede the in-flight calibration, ones for all others."""
    before = [label for label in (observation.cube_label, observation.table_label) if _is_early(label)]
    ones = np.ones(VNIR_NM.size), np.ones(SWIR_NM.size)
    if not before:
        if settings.factors is not None:
            notes.append("channel factors not applied: the radiance is from after the in-flight calibration")
        return ones
    if settings.factors is None:
        message = "radiance from before the in-flight calibration (version 1); give channel factors by --calibration"
        _warn(observation.id, message, notes)
        return ones
    notes.append(f"channel factors of {settings.factors.source} applied")
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


def _footprint(observation: Observation, settings: Settings, limit: float, notes: list[str]) -> Footprint:
    """Average the lit pixels, and say what was left out."""
    footprint = average_footprint(observation.cube, limit)
    inside, lit = int(footprint.inside.sum()), int(footprint.lit.sum())
    if lit < _LEAST_LIT * inside:
        raise DataError(
            f"{observation.id}: {lit} of {inside} pixels of the footprint are lit and valid (reflectance at "
            f"{SHADOW_BAND_NM:g} nm from {settings.shadow_limit:g} on); nothing to average, see --shadow"
        )
    shadowed = int(footprint.shadowed.sum())
    if shadowed > _MUCH_SHADOW * inside:
        _warn(observation.id, f"{100 * shadowed / inside:.0f} % of the footprint is in shadow", notes)
    if not 0 < footprint.dilution <= 1.5:
        raise DataError(
            f"{observation.id}: no usable image from 900 nm on to tell how shadows dilute SWIR; fetch the cube again"
        )
    if shadowed:
        notes.append(f"SWIR radiance divided by {footprint.dilution:.4f} for the shadows it averages over")
    for count, what in (
        (
            int(footprint.invalid.sum()),
            "pixels of the footprint are left out: no value at 465 nm, or saturated",
        ),
        (int((footprint.clipped > 0).sum()), "VNIR channels have saturated pixels"),
        (int((footprint.negative > 0).sum()), "VNIR channels have lit pixels of negative radiance, which are left out"),
        (footprint.constant, "VNIR frames have the same value in every pixel"),
    ):
        if count:
            notes.append(f"{count} {what}")
    return footprint


def _bad_swir(observation: Observation, notes: list[str]) -> BoolArray:
    """Channels of the table not to be used: flagged, without a number, not above 0, or clipped."""
    radiance, flagged = observation.table.radiance, observation.table.flagged
    with np.errstate(invalid="ignore"):
        dark = radiance <= 0
    largest = np.nanmax(radiance) if np.isfinite(radiance).any() else np.nan
    clipped = radiance == largest
    clipped &= clipped.sum() >= _SWIR_PLATEAU
    clipped &= (radiance != largest).any()
    missing = ~np.isfinite(radiance)
    for bad, what in (
        (flagged, "are flagged by their quality code"),
        (missing, "have no number"),
        (dark, "have a radiance of 0 or below"),
        (clipped, "are saturated (one largest value)"),
    ):
        if bad.any():
            notes.append(f"{int(bad.sum())} SWIR channels {what} and are masked")
    if observation.cube_flags is not None and observation.cube_flags.any():
        notes.append(
            f"{int(observation.cube_flags.sum())} VNIR channels are flagged by their quality code and are masked"
        )
    unusable: BoolArray = flagged | missing | dark | clipped
    return unusable


def _check_level(item: DetectorSpectrum, label: Label, id: str) -> None:
    """A spectrum must be as bright as lit lunar ground, whatever the correction."""
    level = float(np.nanmedian(item.observed)) if np.isfinite(item.observed).any() else np.nan
    name = item.detector.upper()
    if not np.isfinite(level):
        raise DataError(f"{id}: no {name} channel has a usable radiance; fetch the {label.name.kind} product again")
    if level < _DARK:
        raise DataError(f"{id}: {name} is dark (median reflectance {level:.2g}): shadow or no light; leave it out")
    if level > _BRIGHT:
        raise DataError(
            f"{id}: {name} is brighter than any rock (median reflectance {level:.3g}); "
            "if radiance is per um use --radiance-per um, else the label's Sun is wrong"
        )


def _splice(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, id: str, notes: list[str], *, remove_vnir_steps: bool
) -> Splice:
    try:
        splice = find_splice(
            vnir.corrected,
            swir.corrected,
            vnir.corrected * vnir.relative_sigma,
            swir.corrected * swir.relative_sigma,
            remove_vnir_steps=remove_vnir_steps,
        )
    except DataError as error:
        raise DataError(f"{id}: cannot be spliced: {error}; fetch both products again") from error
    for factor, limit, what in (
        (splice.gain, GAIN_LIMIT, "VNIR to SWIR differs by"),
        (splice.step.factor, STEP_LIMIT, "the step at 1375/1380 nm is"),
    ):
        if abs(factor - 1) > limit:
            _warn(id, f"{what} {100 * (factor - 1):+.1f} %, more than the {100 * limit:.0f} % that are usual", notes)
    for step in splice.vnir_steps:
        if abs(step.factor - 1) > _NOTED_STEP_SIGMAS * step.sigma:
            done = "removed" if remove_vnir_steps else "kept, see --vnir-steps"
            notes.append(
                f"VNIR changes by {100 * (step.factor - 1):+.1f} % at {step.at_nm:g} nm, a sub-band's end: {done}"
            )
    return splice


def _remark(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, observation: Observation, settings: Settings, notes: list[str]
) -> None:
    for item in (vnir, swir):
        if item.enlarged:
            worst = f"up to {item.excess.max():.1f} times"
            notes.append(
                f"channels of {item.detector.upper()} scatter {worst} as much as usual; their errors are enlarged"
            )
    incidence = max(vnir.geometry.incidence_deg, swir.geometry.incidence_deg)
    if incidence > _GRAZING_DEG:
        _warn(
            observation.id, f"the Sun stands {90 - incidence:.1f} deg high: small slopes change the result much", notes
        )
    if settings.disk is None:
        notes.append("no photometric correction: reflectance factor at the angles of measurement")
        return
    wavelength = np.concatenate([VNIR_NM, SWIR_NM])
    notes.extend(remarks(swir.geometry, wavelength, settings.disk, settings.phase))


def _warn(id: str, message: str, notes: list[str]) -> None:
    notes.append(message)
    warnings.warn(f"{id}: {message}", LunarSciWarning, stacklevel=3)
