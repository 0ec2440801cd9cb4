"""Join the two detectors: remove the step between the SWIR sub-bands, then scale VNIR to SWIR where they overlap.

The scale of the whole spectrum becomes that of the SWIR channels from 1380 nm on.

Errors that all channels share: each is one shift of both detectors, carried through the joining. The absolute
calibration and the irradiance were established before the flight or by others, the photometric model is a choice among
several: repeating the measurement does not make these errors smaller, and they do not scatter.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from lunarsci.arrays import SIGNIFICANCE, FloatArray, robust_scatter
from lunarsci.errors import DataError
from lunarsci.io.tables import table_rows
from lunarsci.spectra.photometry import Geometry, model_spread
from lunarsci.spectra.solar import M3_TABLE, solar_spectrum
from lunarsci.spectra.vnis.channels import JOIN_NM, SPLICED_NM, SUB_BAND_STEP_NM, SWIR_NM, VNIR_NM, VNIR_SUB_BANDS_NM
from lunarsci.spectra.vnis.detector import DetectorSpectrum, Settings, irradiance_at

_LEAST_CHANNELS = 5
"""On either side of a step, or in the overlap, without which nothing is joined."""

CALIBRATION = {"vnir": 0.05, "swir": 0.07}
"""Relative error of the level of each detector, as quoted for the instrument; assumed, the source could not be read.
The error of the Sun's level, 0.6 %, is small beside it. [-]"""
GAIN_LIMIT = 2 * math.hypot(*CALIBRATION.values())
"""A gain further from 1 than this is worth a warning: twice the errors of both levels together, 0.17."""
OVERLAP_ERROR = 0.01
"""What the overlap does not tell about the rest of VNIR, measured: on 88 Chang'E-4 spectra scaled to SWIR at 900 nm the
jump that remains at 897.5 nm is 1.45 % in the median. [-]"""
_FEWEST_GAINS = 5
_OVERLAP_NM: FloatArray = np.intersect1d(VNIR_NM, SWIR_NM)
_VNIR_OVERLAP, _SWIR_OVERLAP = np.isin(VNIR_NM, _OVERLAP_NM), np.isin(SWIR_NM, _OVERLAP_NM)
_BELOW_JOIN = VNIR_NM < JOIN_NM
"""Channels that both detectors have, which these are of each, and those of VNIR that the joined spectrum takes."""
_SMOOTH_CHANNELS = 21
"""Over so many channels a difference of two solar spectra is broad, not detail; assumed."""
_NEGLIGIBLE = 1e-5
Shift = tuple[FloatArray, FloatArray]
"""Shifts of ln R of VNIR, shape (100,), and of SWIR, shape (300,)."""


@dataclass(frozen=True, slots=True)
class StepSite:
    """A place where a step is looked for.

    Attributes
    ----------
    at_nm : between the two channels. channels : on either side that tell the step.
    model_error : root mean square of the step found on 172 laboratory spectra (RELAB), which have none. [-]
    typical : root mean square of the step found on 88 Chang'E-4 spectra: its error where it is left as it is. [-]
    """

    at_nm: float
    channels: int
    model_error: float
    typical: float


SWIR_STEP = StepSite(SUB_BAND_STEP_NM, 12, 0.0021, 0.015)
"""Measured on the 88 public spectra: with 16 channels on either side the model error is 0.0033; with 8 the noise of the
step is a quarter larger."""
VNIR_STEPS = tuple(
    StepSite(at, 8, *errors) for at, errors in zip(VNIR_SUB_BANDS_NM, ((0.0015, 0.065), (0.0030, 0.050)), strict=True)
)
"""Sub-bands of the imager, measured alike. What is found depends on the window (at 632.5 nm 5.5 % with 8 channels on
either side, 3.3 % with 12): the spectra are disturbed over some tens of nanometres there, not only displaced."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step found: `factor` on all channels below `at_nm` removes it, `sigma` is its relative standard error."""

    at_nm: float
    factor: float
    sigma: float


def find_step(site: StepSite, wavelength_nm: FloatArray, reflectance: FloatArray, sigma: FloatArray) -> Step:
    """The jump in a fit of ln R by a parabola with a jump, over the site's channels on either side.

    Parameters
    ----------
    wavelength_nm, reflectance, sigma : shape (n,); NaN where a channel is not used. [nm, -, -]

    Raises DataError when fewer than five channels on one side can be used.
    """
    with np.errstate(invalid="ignore"):
        good = (np.abs(wavelength_nm - site.at_nm) < 5 * site.channels) & (reflectance > 0) & (sigma > 0)
    before = good & (wavelength_nm < site.at_nm)
    if min(before.sum(), (good & ~before).sum()) < _LEAST_CHANNELS:
        low, high = site.at_nm - 5 * site.channels, site.at_nm + 5 * site.channels
        raise DataError(f"too few valid channels from {low:g} to {high:g} nm to find the step at {site.at_nm:g} nm")
    x = (wavelength_nm[good] - site.at_nm) / 100
    relative = sigma[good] / reflectance[good]
    design = np.stack([np.ones_like(x), x, x**2, before[good].astype(float)], axis=1) / relative[:, None]
    solution, *_ = np.linalg.lstsq(design, np.log(reflectance[good]) / relative, rcond=None)
    covariance = np.linalg.inv(design.T @ design)
    error = np.hypot(np.sqrt(covariance[3, 3]), site.model_error)
    return Step(site.at_nm, float(np.exp(-solution[3])), float(error))


STEP_LIMIT = NormalDist().inv_cdf(1 - SIGNIFICANCE / 2) * SWIR_STEP.typical
"""So is a step between the sub-bands of SWIR that `SIGNIFICANCE` of them exceed, 0.039."""


def usual_gains(gains: Sequence[float]) -> list[float | None]:
    """Of each observation the median gain of all, where its own is unlike theirs; None where it is not. [-]

    Both detectors see the same ground in the same minutes, so that their ratio is the instrument's, but for the step
    and the overlap. Unlike is further off than one in a hundred batches has any by these errors, or by the scatter of
    the gains where it is larger. Fewer than five observations do not tell.
    """
    if len(gains) < _FEWEST_GAINS:
        return [None] * len(gains)
    middle = float(np.median(gains))
    scatter = max(math.hypot(OVERLAP_ERROR, SWIR_STEP.typical) * middle, robust_scatter(np.array(gains)))
    limit = NormalDist().inv_cdf(1 - SIGNIFICANCE / 2 / len(gains)) * scatter
    return [middle if abs(gain - middle) > limit else None for gain in gains]


@dataclass(frozen=True, slots=True)
class Splice:
    """Factors of the joining.

    Attributes
    ----------
    step : between the SWIR sub-bands; its factor is applied to SWIR below 1377.5 nm.
    vnir_steps : between the sub-bands of VNIR, those that could be measured.
    vnir_steps_removed : whether their factors are applied.
    gain, gain_sigma : factor on VNIR, and its relative standard error, that of the step apart, enlarged where the two
        detectors differ by more than their noise in the overlap.
    overlap_rms : root mean square of what remains between the detectors in their overlap, relative. [-]
    """

    step: Step
    vnir_steps: Sequence[Step]
    vnir_steps_removed: bool
    gain: float
    gain_sigma: float
    overlap_rms: float

    def join(self, vnir: FloatArray, swir: FloatArray) -> FloatArray:
        """The 390 channels from 100 of VNIR and 300 of SWIR."""
        first = self.gain * (_below(VNIR_NM, self.vnir_steps) if self.vnir_steps_removed else 1.0) * vnir
        return np.concatenate([first[_BELOW_JOIN], _below(SWIR_NM, [self.step]) * swir])

    def modes(self, spliced: FloatArray) -> dict[str, FloatArray]:
        """What one standard error of each factor shifts, shape (390,) each; correlated over all channels.

        VNIR steps that are not removed stand in with what is usual for them.
        """
        vnir = SPLICED_NM < JOIN_NM
        shifts = {
            "splice_gain": np.where(vnir, self.gain_sigma * spliced, 0.0),
            "splice_overlap": np.where(vnir, OVERLAP_ERROR * spliced, 0.0),
            "splice_step": np.where(self.step.at_nm > SPLICED_NM, self.step.sigma * spliced, 0.0),
        }
        measured = {step.at_nm: step.sigma for step in self.vnir_steps} if self.vnir_steps_removed else {}
        for site in VNIR_STEPS:
            size = measured.get(site.at_nm, site.typical)
            shifts[f"vnir_step_{site.at_nm:.0f}"] = np.where(site.at_nm > SPLICED_NM, size * spliced, 0.0)
        return shifts


def _below(wavelength_nm: FloatArray, steps: Sequence[Step]) -> FloatArray:
    """Factor of each channel: the product of those of the steps above it."""
    factor = np.ones_like(wavelength_nm)
    for step in steps:
        factor = np.where(wavelength_nm < step.at_nm, step.factor * factor, factor)
    return factor


def find_splice(
    vnir: FloatArray,
    swir: FloatArray,
    vnir_sigma: FloatArray,
    swir_sigma: FloatArray,
    *,
    remove_vnir_steps: bool = False,
) -> Splice:
    """Find steps and gain from reflectance factors and their errors, NaN where a channel is not used.

    The gain is the slope of a regression through the origin of SWIR on VNIR in the overlap 900-945 nm, weighted by the
    errors of both: ten channels over 45 nm do not tell a slope from an offset.

    Parameters
    ----------
    vnir, vnir_sigma : shape (100,). [-]
    swir, swir_sigma : shape (300,). [-]
    remove_vnir_steps : also remove the steps between the sub-bands of VNIR that can be measured.

    Raises DataError when fewer than five channels of the overlap, or on one side of the SWIR step, can be used.
    """
    step = find_step(SWIR_STEP, SWIR_NM, swir, swir_sigma)
    x, y = vnir[_VNIR_OVERLAP], step.factor * swir[_SWIR_OVERLAP]
    sx, sy = vnir_sigma[_VNIR_OVERLAP], step.factor * swir_sigma[_SWIR_OVERLAP]
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    if good.sum() < _LEAST_CHANNELS:
        raise DataError(f"only {good.sum()} of {good.size} channels from 900 to 945 nm are valid in both detectors")
    x, y, sx, sy = x[good], y[good], sx[good], sy[good]
    variance = y**2 * ((sy / y) ** 2 + (sx / x) ** 2)
    gain = float((x * y / variance).sum() / (x**2 / variance).sum())
    reduced = float(((y - gain * x) ** 2 / variance).sum() / (x.size - 1))
    gain_sigma = float(np.sqrt(max(1.0, reduced) / (x**2 / variance).sum()) / gain)
    return Splice(
        step,
        _vnir_steps(vnir, vnir_sigma),
        remove_vnir_steps,
        gain,
        gain_sigma,
        float(np.sqrt(np.mean((y / (gain * x) - 1) ** 2))),
    )


def _vnir_steps(vnir: FloatArray, sigma: FloatArray) -> tuple[Step, ...]:
    result = []
    for site in VNIR_STEPS:
        try:
            result.append(find_step(site, VNIR_NM, vnir, sigma))
        except DataError:  # masked channels: this one stays as it is, and the modes say so
            continue
    return tuple(result)


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
    if settings.photometry != "none":
        both, geometry = np.concatenate([vnir.wavelength_nm, swir.wavelength_nm]), _between(vnir, swir)
        for number, mode in enumerate(model_spread(geometry, both, settings.photometry, settings.phase), 1):
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
    """The joined spectrum, (390,), with ln R of both detectors shifted; NaN where it cannot be joined any more."""
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
