"""Join the two detectors: remove the step between the SWIR sub-bands, then scale VNIR to SWIR where they overlap.

The scale of the whole spectrum becomes that of the SWIR channels from 1380 nm on.

Jumps of a spectrum where the acousto-optic filter changes its sub-band.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.channels import JOIN_NM, SPLICED_NM, SUB_BAND_STEP_NM, SWIR_NM, VNIR_NM

__all__ = [
    "GAIN_LIMIT",
    "STEP_LIMIT",
    "SWIR_STEP",
    "VNIR_STEPS",
    "Splice",
    "Step",
    "StepSite",
    "find_splice",
    "find_step",
]

_LEAST_CHANNELS = 5


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
"""With 16 channels on either side the model error is 0.0033; with 8 the noise of the step is a quarter larger."""
VNIR_STEPS = (StepSite(632.5, 8, 0.0015, 0.065), StepSite(757.5, 8, 0.0030, 0.050))
"""Sub-bands of the imager. What is found depends on the window (at 632.5 nm 5.5 % with 8 channels on either side, 3.3 %
with 12): the spectra are disturbed over some tens of nanometres there, not only displaced."""


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


GAIN_LIMIT = 0.17
"""A gain further from 1 than this is worth a warning: twice the calibration errors of 5 % and 7 % together."""
STEP_LIMIT = 0.05
"""So is a larger step between the sub-bands of SWIR; assumed."""
OVERLAP_ERROR = 0.01
"""What the overlap does not tell about the rest of VNIR: on 88 Chang'E-4 spectra scaled to SWIR at 900 nm the jump that
remains at 897.5 nm is 1.45 % in the median. [-]"""

_OVERLAP_NM: FloatArray = np.intersect1d(VNIR_NM, SWIR_NM)
_VNIR_OVERLAP, _SWIR_OVERLAP = np.isin(VNIR_NM, _OVERLAP_NM), np.isin(SWIR_NM, _OVERLAP_NM)
_KEPT = VNIR_NM < JOIN_NM


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
        return np.concatenate([first[_KEPT], _below(SWIR_NM, [self.step]) * swir])

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
    found = []
    for site in VNIR_STEPS:
        try:
            found.append(find_step(site, VNIR_NM, vnir, sigma))
        except DataError:  # masked channels: this one stays as it is, and the modes say so
            continue
    return tuple(found)
