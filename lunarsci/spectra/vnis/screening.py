"""What of an observation is used, and what the reader should know: pixels, channels, levels, factors of the joining.

Channels that cannot be radiances of lit ground: too bright, too dark, or far from their neighbours.
"""

import warnings

import numpy as np

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.spectra.photometry import remarks
from lunarsci.spectra.spectrum import BoolArray, FloatArray
from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM, Detector
from lunarsci.spectra.vnis.detector import DetectorSpectrum, Settings, measure
from lunarsci.spectra.vnis.footprint import SHADOW_BAND_NM, Footprint, average_footprint
from lunarsci.spectra.vnis.label import Label
from lunarsci.spectra.vnis.observation import Observation
from lunarsci.spectra.vnis.splice import GAIN_LIMIT, STEP_LIMIT, Splice, find_splice

__all__ = [
    "Notes",
    "bad_swir",
    "bad_vnir",
    "check_jumps",
    "closing_remarks",
    "lit_footprint",
    "measured",
    "outlying",
    "spliced",
]

_RANGE = (0.001, 2.0)
"""Reflectance factors that lit lunar ground may have; assumed. [-]"""
_NEIGHBOURS = 11
_FAR = 0.3
"""ln R this far from the median of eleven channels is no rock: the steepest of 172 laboratory spectra (RELAB, 5 nm)
deviates by less than 0.1. [-]"""
_SIDE = 5


def outlying(reflectance: FloatArray) -> BoolArray:
    """True for channels outside 0.001-2 or more than a third off the median of their neighbours; shape (n,)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        absurd = np.isfinite(reflectance) & ~((reflectance >= _RANGE[0]) & (reflectance <= _RANGE[1]))
        ln = np.log(np.where(absurd | ~(reflectance > 0), np.nan, reflectance))
    known = np.flatnonzero(np.isfinite(ln))
    if known.size < _NEIGHBOURS:
        return absurd
    padded = np.pad(ln[known], _NEIGHBOURS // 2, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS), axis=1)
    far = np.zeros_like(absurd)
    far[known] = np.abs(ln[known] - middle) > _FAR
    return np.asarray(absurd | far, dtype=np.bool_)


def check_jumps(id: str, name: str, wavelength_nm: FloatArray, reflectance: FloatArray) -> None:
    """Raise DataError where five channels and the next five differ by more than a third: blocks of another scale."""
    known = np.flatnonzero(np.isfinite(reflectance))
    if known.size < 2 * _SIDE:
        return
    middle = np.median(np.lib.stride_tricks.sliding_window_view(np.log(reflectance[known]), _SIDE), axis=1)
    jump = np.abs(middle[_SIDE:] - middle[:-_SIDE])
    worst = int(jump.argmax())
    if jump[worst] > _FAR:
        place = wavelength_nm[known[worst + _SIDE]]
        share = 100 * (np.exp(jump[worst]) - 1)
        raise DataError(
            f"{id}: {name} jumps by {share:.0f} % near {place:g} nm, which no rock does; fetch its data file again"
        )


# What is too little, too dark or too bright to go on with: assumed, each far from what the public spectra have.
_LEAST_LIT = 0.01
_MUCH_SHADOW, _MOST_SHADOW = 0.3, 0.9
_DARK = 0.01
_BRIGHT = 2.0
_SWIR_PLATEAU = 3
_GRAZING_DEG = 80.0
_NOTED_STEP_SIGMAS = 3.0
_FLAT = 0.04
"""Sunlight on the Moon varies by some 15 % (standard deviation) from 450 to 945 nm; assumed."""
_GAINS, _STEPS = (0.6, 1.6), (0.7, 1.4)
"""Factors beyond which two spectra are not of one target with one instrument; assumed."""


class Notes:
    """Remarks on one observation, one sentence each."""

    def __init__(self, id: str) -> None:
        self.id = id
        self.lines: list[str] = []

    def add(self, text: str) -> None:
        """Worth knowing."""
        self.lines.append(text)

    def warn(self, text: str) -> None:
        """Worth a second look: also a LunarSciWarning."""
        self.add(text)
        warnings.warn(f"{self.id}: {text}", LunarSciWarning, stacklevel=3)


def lit_footprint(observation: Observation, settings: Settings, limit: float, notes: Notes) -> Footprint:
    """Average the lit pixels, and say what was left out."""
    footprint = average_footprint(observation.cube, limit)
    inside, lit = int(footprint.inside.sum()), int(footprint.lit.sum())
    if lit < _LEAST_LIT * inside:
        raise DataError(
            f"{observation.id}: {lit} of {inside} pixels of the footprint are lit and valid (reflectance at "
            f"{SHADOW_BAND_NM:g} nm from {settings.shadow_limit:g} on); nothing to average, see --shadow"
        )
    shadowed = int(footprint.shadowed.sum())
    if shadowed > _MOST_SHADOW * inside:
        raise DataError(
            f"{observation.id}: {100 * shadowed / inside:.0f} % of the footprint is in shadow; what is left of it says "
            "little, leave the observation out"
        )
    if shadowed > _MUCH_SHADOW * inside:
        notes.warn(f"{100 * shadowed / inside:.0f} % of the footprint is in shadow")
    if not 0 < footprint.dilution <= 1.5:
        raise DataError(
            f"{observation.id}: no usable image from 900 nm on to tell how shadows dilute SWIR; fetch the cube again"
        )
    if np.nanstd(footprint.mean) < _FLAT * np.nanmean(footprint.mean):
        raise DataError(
            f"{observation.id}: all images are equally bright, which sunlit ground is not; the axes of the cube are "
            "not band, line, sample, fetch it again"
        )
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


def bad_vnir(observation: Observation, footprint: Footprint, notes: Notes) -> BoolArray:
    """Channels of the image not to be used: without enough valid pixels, flagged, or without any contrast."""
    flagged = np.zeros(VNIR_NM.size, dtype=bool)
    if observation.cube_flags is None:
        notes.add("no auxiliary table with quality codes of the images beside them")
    else:
        flagged = observation.cube_flags
    flat = footprint.constant if not footprint.constant.all() else np.zeros(VNIR_NM.size, dtype=bool)
    for bad, what in (
        (flagged, "are flagged by their quality code"),
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


def bad_swir(observation: Observation, notes: Notes) -> BoolArray:
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


def measured(
    detector: Detector,
    observation: Observation,
    radiance: FloatArray,
    mean_error: FloatArray,
    settings: Settings,
    notes: Notes,
) -> DetectorSpectrum:
    """One detector's spectrum with outlying channels masked. Raises DataError, with the id, for an absurd one."""
    label, id = (observation.cube_label if detector == "vnir" else observation.table_label), observation.id
    try:
        item = measure(detector, label, radiance, mean_error, settings)
        _check_level(item, label, id)
        outliers = outlying(item.observed)
        if outliers.any():
            count, name = int(outliers.sum()), detector.upper()
            notes.add(f"{count} {name} channels are no radiance of lit ground or far from their neighbours: masked")
            item = measure(detector, label, np.where(outliers, np.nan, radiance), mean_error, settings)
    except ParameterError as error:
        raise DataError(f"{id}: {error}") from error
    check_jumps(id, detector.upper(), item.wavelength_nm, item.observed)
    return item


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


def spliced(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, id: str, notes: Notes, *, remove_vnir_steps: bool
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
    for factor, (low, high), what in (
        (splice.gain, _GAINS, "VNIR to SWIR"),
        (splice.step.factor, _STEPS, "the SWIR step"),
    ):
        if not low <= factor <= high:
            raise DataError(
                f"{id}: cannot be spliced: {what} would take a factor of {factor:.3g}; the products do not belong "
                "together or one is damaged, fetch both again"
            )
    for factor, limit, what in (
        (splice.gain, GAIN_LIMIT, "VNIR to SWIR differs by"),
        (splice.step.factor, STEP_LIMIT, "the step at 1375/1380 nm is"),
    ):
        if abs(factor - 1) > limit:
            notes.warn(f"{what} {100 * (factor - 1):+.1f} %, more than the {100 * limit:.0f} % that are usual")
    for step in splice.vnir_steps:
        if abs(step.factor - 1) > _NOTED_STEP_SIGMAS * step.sigma:
            done = "removed" if remove_vnir_steps else "kept, see --vnir-steps"
            notes.add(
                f"VNIR changes by {100 * (step.factor - 1):+.1f} % at {step.at_nm:g} nm, a sub-band's end: {done}"
            )
    return splice


def closing_remarks(
    vnir: DetectorSpectrum, swir: DetectorSpectrum, observation: Observation, settings: Settings, notes: Notes
) -> None:
    for item in (vnir, swir):
        if item.enlarged:
            worst = f"up to {item.excess.max():.1f} times"
            notes.add(
                f"channels of {item.detector.upper()} scatter {worst} as much as usual; their errors are enlarged"
            )
    incidence = max(vnir.geometry.incidence_deg, swir.geometry.incidence_deg)
    if incidence > _GRAZING_DEG:
        notes.warn(f"the Sun stands {90 - incidence:.1f} deg high: small slopes change the result much")
    if settings.disk is None:
        notes.add("no photometric correction: reflectance factor at the angles of measurement")
        return
    wavelength = np.concatenate([VNIR_NM, SWIR_NM])
    for remark in remarks(swir.geometry, wavelength, settings.disk, settings.phase):
        notes.add(remark)
