"""Calibration of one VNIS observation: from its radiances to one reflectance spectrum with its errors.

Beside it stands what of the observation is used, and what the reader should know: pixels, channels, levels, and the
factors of the joining.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, LunarSciError, LunarSciWarning, ParameterError
from lunarsci.ranges import refuse
from lunarsci.spectra.photometry import correction_factor, remarks
from lunarsci.spectra.solar import sun_moon_distance_au
from lunarsci.spectra.vnis.calibration import Calibration, CalibrationFailure
from lunarsci.spectra.vnis.channels import IMAGE_NM, SWIR_NM, VNIR_NM, Detector, channel_doubts
from lunarsci.spectra.vnis.detector import (
    IN_FLIGHT_VERSION,
    RANGE,
    WAVELENGTHS,
    DetectorSpectrum,
    Settings,
    default_settings,
    irradiance_at,
    measure,
    outlying,
    reflectance_factor,
)
from lunarsci.spectra.vnis.footprint import (
    SHADOW_BAND_NM,
    Footprint,
    average_footprint,
    registration_error,
    shadow_limit_shift,
)
from lunarsci.spectra.vnis.label import Label
from lunarsci.spectra.vnis.observation import Observation, read_observation
from lunarsci.spectra.vnis.splice import GAIN_LIMIT, STEP_LIMIT, Shift, Splice, find_splice, shared_errors, usual_gains

# What is too little, too dark or too bright to go on with: assumed, each far from what the public spectra have.
_LEAST_LIT = 0.01
"""Share of the field of view that must be lit; assumed."""
_MUCH_SHADOW, _MOST_SHADOW = 0.3, 0.9
"""Shares of the field of view in shadow beyond which that is noted, and the observation refused; assumed."""
_SWIR_PLATEAU = 3
"""So many channels of exactly the largest radiance are clipped; assumed."""
_GRAZING_DEG = 80.0
"""Incidence from which small slopes change the result much; assumed."""
_NOTED_STEP_SIGMAS = 3.0
"""Standard errors of a step between sub-bands from which it is noted; assumed."""
_FLAT = 0.04
"""Sunlight on the Moon varies by some 15 % (standard deviation) from 450 to 945 nm; assumed."""


class _Notes:
    """Remarks on one observation, one sentence each."""

    def __init__(self, id: str) -> None:
        self.id = id
        self.lines: list[str] = []
        self.doubts: list[str] = []

    def add(self, text: str) -> None:
        """Worth knowing."""
        self.lines.append(text)

    def warn(self, text: str) -> None:
        """Worth a second look: also a LunarSciWarning."""
        self.add(text)
        warnings.warn(f"{self.id}: {text}", LunarSciWarning, stacklevel=3)

    def doubt(self, text: str) -> None:
        """A reason not to trust the result: also a LunarSciWarning."""
        self.warn(text)
        self.doubts.append(text)


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
    return _beside_each_other(results)


def _beside_each_other(
    results: list[Calibration | CalibrationFailure],
) -> list[Calibration | CalibrationFailure]:
    """The same, with a doubt where the two detectors differ as they do in no other observation."""
    good = [place for place, item in enumerate(results) if isinstance(item, Calibration)]
    gains = [item.splice.gain for item in results if isinstance(item, Calibration)]
    for place, usual in zip(good, usual_gains(gains), strict=True):
        item = results[place]
        if usual is not None and isinstance(item, Calibration):
            doubt = f"VNIR to SWIR differs by {100 * (item.splice.gain - 1):+.1f} %, "
            doubt += f"in the other observations by {100 * (usual - 1):+.1f} %"
            warnings.warn(f"{item.id}: {doubt}", LunarSciWarning, stacklevel=3)
            results[place] = replace(item, notes=(*item.notes, doubt), doubts=(*item.doubts, doubt))
    return results


def calibrate(observation: Observation, settings: Settings | None = None) -> Calibration:
    """Reflectance factor of the footprint on 390 channels, with independent and shared errors.

    The lit pixels of the SWIR field of view are averaged, and the radiance of SWIR is freed of the shadows it averages
    over. Both detectors become reflectance factors, each with its own angles, time and irradiance, and are brought to
    the standard geometry. The sub-bands of SWIR are joined, then VNIR is scaled to SWIR.

    Raises DataError when nothing is lit, a detector is dark, radiances have another unit, or there is no overlap.
    Whatever is worth a second look is a LunarSciWarning and stands in `notes`, what makes it doubtful also in `doubts`.
    """
    chosen = settings or default_settings()
    notes = _Notes(observation.id)
    for doubt in observation.doubts:
        notes.doubt(doubt)
    vnir_factors, swir_factors = _channel_factors(observation, chosen, notes)
    limit = _shadow_radiance(observation.cube_label, chosen, vnir_factors)
    footprint = _lit_footprint(observation, chosen, limit, notes)
    vnir_shift, dilution_shift = shadow_limit_shift(observation.cube, footprint, limit)
    seen: dict[str, Shift] = {
        "shadow_limit": (vnir_shift, np.full(SWIR_NM.size, -dilution_shift)),
        "registration": (0 * VNIR_NM, np.full(SWIR_NM.size, registration_error(observation.cube, footprint))),
    }
    vnir_bad = _bad_vnir(observation, footprint, notes)
    swir_bad = _bad_swir(observation, notes)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_error = footprint.scatter / footprint.mean / np.sqrt(np.maximum(footprint.count, 1))
    vnir_radiance = np.where(vnir_bad, np.nan, footprint.mean * vnir_factors)
    swir_radiance = np.where(swir_bad, np.nan, observation.table.radiance * swir_factors / footprint.dilution)
    vnir = _measured("vnir", observation, vnir_radiance, mean_error, chosen, notes)
    swir = _measured("swir", observation, swir_radiance, 0 * SWIR_NM, chosen, notes)
    splice = _spliced(vnir, swir, observation.id, notes, remove_vnir_steps=chosen.remove_vnir_steps)
    reflectance = splice.join(vnir.corrected, swir.corrected)
    _closing_remarks(vnir, swir, observation, chosen, notes)
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
        image=np.array(observation.cube[int(np.flatnonzero(VNIR_NM == IMAGE_NM)[0])]),
        photometry=chosen.photometry,
        phase=chosen.phase.name if chosen.photometry != "none" else "none",
        solar=chosen.solar.name,
        notes=tuple(notes.lines),
        doubts=tuple(notes.doubts),
        inputs=observation.inputs | dict(chosen.inputs),
    )


def _channel_factors(observation: Observation, settings: Settings, notes: _Notes) -> tuple[FloatArray, FloatArray]:
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


def _shadow_radiance(label: Label, settings: Settings, factors: FloatArray) -> float:
    """The limit of shadows in the unit of the file at 465 nm."""
    band = int(np.flatnonzero(VNIR_NM == SHADOW_BAND_NM)[0])
    distance = sun_moon_distance_au(label.start)
    irradiance = irradiance_at("vnir", settings.solar)[band : band + 1]
    one = reflectance_factor(np.array([factors[band]]), irradiance, label.geometry.incidence_deg, distance)
    return settings.shadow_limit / float(one[0])


def _lit_footprint(observation: Observation, settings: Settings, limit: float, notes: _Notes) -> Footprint:
    """Average the lit pixels, and say what was left out."""
    footprint = average_footprint(observation.cube, limit)
    inside, lit = int(footprint.inside.sum()), int(footprint.lit.sum())
    shadowed = int(footprint.shadowed.sum())
    share = f"{100 * shadowed / inside:.0f} % of the footprint is in shadow"
    flat = lit > 0 and np.nanstd(footprint.mean) < _FLAT * np.nanmean(footprint.mean)
    reasons = {
        f"{lit} of {inside} pixels of the footprint are lit and valid (reflectance at {SHADOW_BAND_NM:g} nm from "
        f"{settings.shadow_limit:g} on); nothing to average, see `shadow`": lit < _LEAST_LIT * inside,
        f"{share}; what is left of it says little, leave the observation out": shadowed > _MOST_SHADOW * inside,
        "no usable image from 900 nm on to tell how shadows dilute SWIR; fetch the cube again":
            not 0 < footprint.dilution <= 1.5,
        "all images are equally bright, which sunlit ground is not; the axes of the cube are not band, line, sample, "
        "fetch it again": flat,
    }  # fmt: skip
    refuse(reasons, observation.id, DataError)
    if shadowed > _MUCH_SHADOW * inside:
        notes.warn(share)
    if shadowed:
        notes.add(f"SWIR radiance divided by {footprint.dilution:.4f} for the shadows it averages over")
    for count, what in (
        (
            int(footprint.invalid.sum()),
            "pixels of the footprint are left out: no value at 465 nm, or saturated",
        ),
        (int((footprint.clipped > 0).sum()), "VNIR channels have saturated pixels"),
        (int((footprint.negative > 0).sum()), "VNIR channels have lit pixels with a radiance of 0 or below, left out"),
        (int(footprint.constant.sum()), "VNIR frames have the same value in every pixel"),
    ):
        if count:
            notes.add(f"{count} {what}")
    return footprint


def _bad_vnir(observation: Observation, footprint: Footprint, notes: _Notes) -> BoolArray:
    """Channels of the image not to be used: without enough valid pixels, flagged, or without any contrast."""
    flagged = np.zeros(VNIR_NM.size, dtype=bool)
    if observation.cube_flags is None:
        notes.add("no auxiliary table with quality codes of the images beside them")
    else:
        flagged = observation.cube_flags
    missing = ~(footprint.mean > 0) & (footprint.negative == 0) & ~flagged
    flat = footprint.constant if not footprint.constant.all() else np.zeros(VNIR_NM.size, dtype=bool)
    for bad, what in (
        (flagged, "are flagged by their quality code"),
        (missing, "have no number, or too many saturated pixels,"),
        (flat, "have one value in all pixels, unlike the others,"),
    ):
        if bad.any():
            notes.add(f"{int(bad.sum())} VNIR channels {what} and are masked")
    if flagged[VNIR_NM == SHADOW_BAND_NM].any():
        raise DataError(
            f"{observation.id}: the image at {SHADOW_BAND_NM:g} nm, which tells shadows, is flagged; leave the "
            "observation out, or the auxiliary table if you trust the image"
        )
    unusable: BoolArray = ~(footprint.mean > 0) | flagged | flat
    return unusable


def _bad_swir(observation: Observation, notes: _Notes) -> BoolArray:
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
            notes.add(f"{int(bad.sum())} SWIR channels {what} and are masked")
    unusable: BoolArray = flagged | missing | dark | clipped
    return unusable


def _measured(
    detector: Detector,
    observation: Observation,
    radiance: FloatArray,
    mean_error: FloatArray,
    settings: Settings,
    notes: _Notes,
) -> DetectorSpectrum:
    """One detector's spectrum with outlying channels masked. Raises DataError, with the id, for an absurd one."""
    label, id = (observation.cube_label if detector == "vnir" else observation.table_label), observation.id
    wavelength, irradiance = WAVELENGTHS[detector], irradiance_at(detector, settings.solar)
    try:
        correction = np.ones_like(wavelength)
        if settings.photometry != "none":
            correction = correction_factor(label.geometry, wavelength, settings.photometry, settings.phase)
        item = measure(detector, label, radiance, mean_error, irradiance, correction)
        _check_level(item, label, id)
        outliers = outlying(detector, item.observed)
        if outliers.any():
            count, name = int(outliers.sum()), detector.upper()
            notes.add(f"{count} {name} channels are no radiance of lit ground or far from their neighbours: masked")
            retained = np.where(outliers, np.nan, radiance)
            item = measure(detector, label, retained, mean_error, irradiance, correction)
    except ParameterError as error:
        raise DataError(f"{id}: {error}") from error
    for doubt in channel_doubts(detector, wavelength, item.radiance, irradiance, item.observed):
        notes.doubt(doubt)
    return item


def _check_level(item: DetectorSpectrum, label: Label, id: str) -> None:
    """A spectrum must be as bright as lit lunar ground, whatever the correction."""
    level = float(np.nanmedian(item.observed)) if np.isfinite(item.observed).any() else np.nan
    name = item.detector.upper()
    reasons = {
        f"no {name} channel has a usable radiance; fetch the {label.name.kind} product again": not np.isfinite(level),
        f"{name} is dark (median reflectance {level:.2g}): shadow or no light; leave it out": level < RANGE[0],
        f"{name} is brighter than any rock (median reflectance {level:.3g}); radiance is not in W m-2 sr-1 nm-1, or "
        "the label's Sun is wrong; fetch the product again": level > RANGE[1],
    }
    refuse(reasons, id, DataError)


def _spliced(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, id: str, notes: _Notes, *, remove_vnir_steps: bool
) -> Splice:
    """How the detectors are joined; notes take what is unusual about that."""
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
            notes.doubt(f"{what} {100 * (factor - 1):+.1f} %, more than the {100 * limit:.0f} % that are usual")
    for step in splice.vnir_steps:
        if abs(step.factor - 1) > _NOTED_STEP_SIGMAS * step.sigma:
            done = "removed" if remove_vnir_steps else "kept, see --vnir-steps"
            notes.add(
                f"VNIR changes by {100 * (step.factor - 1):+.1f} % at {step.at_nm:g} nm, a sub-band's end: {done}"
            )
    return splice


def _closing_remarks(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, observation: Observation, settings: Settings, notes: _Notes
) -> None:
    """Notes on noise, a low Sun, photometry and the observation."""
    for item in (vnir, swir):
        if item.enlarged:
            worst = f"up to {item.excess.max():.1f} times"
            notes.add(
                f"channels of {item.detector.upper()} scatter {worst} as much as usual; their errors are enlarged"
            )
    incidence = max(vnir.geometry.incidence_deg, swir.geometry.incidence_deg)
    if incidence > _GRAZING_DEG:
        notes.warn(f"the Sun stands {90 - incidence:.1f} deg high: small slopes change the result much")
    if settings.photometry == "none":
        notes.add("no photometric correction: reflectance factor at the angles of measurement")
        return
    wavelength = np.concatenate([VNIR_NM, SWIR_NM])
    for remark in remarks(swir.geometry, wavelength, settings.photometry, settings.phase):
        notes.add(remark)
