"""Join the two detectors: remove the step between the SWIR sub-bands, then scale VNIR to SWIR where they overlap.

The scale of the whole spectrum becomes that of the SWIR channels from 1380 nm on.
"""

from dataclasses import dataclass

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.channels import JOIN_NM, SUB_BAND_STEP_NM, SWIR_NM, VNIR_NM

__all__ = ["GAIN_LIMIT", "STEP_LIMIT", "Splice", "find_splice"]

GAIN_LIMIT = 0.17
"""A gain further from 1 than this is worth a warning: twice the calibration errors of 5 % and 7 % together."""
STEP_LIMIT = 0.05
"""So is a larger step between the sub-bands of one detector; assumed."""
_STEP_CHANNELS = 12
"""Channels on either side of the step that tell it."""
_STEP_MODEL_ERROR = 0.002
"""Step that the parabola finds on spectra that have none: standard deviation over 172 laboratory spectra (RELAB); with
16 channels on either side it is 0.003, with 8 it is 0.0013 but the noise of the step a quarter larger. [-]"""
_LEAST_CHANNELS = 5

_BEFORE_STEP = SWIR_NM < SUB_BAND_STEP_NM
_NEAR_STEP = np.abs(SWIR_NM - SUB_BAND_STEP_NM) < 5 * _STEP_CHANNELS
_OVERLAP_NM: FloatArray = np.intersect1d(VNIR_NM, SWIR_NM)
_VNIR_OVERLAP, _SWIR_OVERLAP = np.isin(VNIR_NM, _OVERLAP_NM), np.isin(SWIR_NM, _OVERLAP_NM)
_KEPT = VNIR_NM < JOIN_NM


@dataclass(frozen=True, slots=True)
class Splice:
    """Factors of the joining.

    Attributes
    ----------
    step, step_sigma : factor on SWIR below 1377.5 nm, and its relative standard error.
    gain, gain_sigma : factor on VNIR, and its relative standard error, that of the step apart.
    overlap_rms : root mean square of what remains between the detectors in their overlap, relative. [-]
    """

    step: float
    step_sigma: float
    gain: float
    gain_sigma: float
    overlap_rms: float

    def join(self, vnir: FloatArray, swir: FloatArray) -> FloatArray:
        """The 390 channels from 100 of VNIR and 300 of SWIR."""
        return np.concatenate([self.gain * vnir[_KEPT], np.where(_BEFORE_STEP, self.step, 1.0) * swir])

    def modes(self, spliced: FloatArray) -> dict[str, FloatArray]:
        """What one standard error of gain and of step shifts, shape (390,) each; correlated over all channels."""
        vnir = np.arange(spliced.size) < _KEPT.sum()
        before = np.concatenate([np.ones(int(_KEPT.sum()), bool), _BEFORE_STEP])
        return {
            "splice_gain": np.where(vnir, self.gain_sigma * spliced, 0.0),
            "splice_step": np.where(before, self.step_sigma * spliced, 0.0),
        }


def find_splice(vnir: FloatArray, swir: FloatArray, vnir_sigma: FloatArray, swir_sigma: FloatArray) -> Splice:
    """Find step and gain from reflectance factors and their errors, NaN where a channel is not used.

    The step is the jump at 1377.5 nm in a fit of ln R by a parabola with a jump over 12 channels on either side. The
    gain is the slope of a regression through the origin of SWIR on VNIR in the overlap 900-945 nm, weighted by the
    errors of both: ten channels over 45 nm do not tell a slope from an offset.

    Parameters
    ----------
    vnir, vnir_sigma : shape (100,). [-]
    swir, swir_sigma : shape (300,). [-]

    Raises DataError when fewer than five channels of the overlap, or on one side of the step, can be used.
    """
    step, step_sigma = _step(swir, swir_sigma)
    x, y = vnir[_VNIR_OVERLAP], step * swir[_SWIR_OVERLAP]
    sx, sy = vnir_sigma[_VNIR_OVERLAP], step * swir_sigma[_SWIR_OVERLAP]
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    if good.sum() < _LEAST_CHANNELS:
        raise DataError(f"only {good.sum()} of {good.size} channels from 900 to 945 nm are valid in both detectors")
    x, y, sx, sy = x[good], y[good], sx[good], sy[good]
    weight = 1 / ((sy / y) ** 2 + (sx / x) ** 2) / y**2
    gain = float((weight * x * y).sum() / (weight * x**2).sum())
    gain_sigma = float(1 / np.sqrt((weight * x**2).sum()) / gain)
    return Splice(step, step_sigma, gain, gain_sigma, float(np.sqrt(np.mean((y / (gain * x) - 1) ** 2))))


def _step(swir: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    with np.errstate(invalid="ignore"):
        good = _NEAR_STEP & np.isfinite(swir) & (swir > 0) & (sigma > 0)
    before = good & _BEFORE_STEP
    if min(before.sum(), (good & ~before).sum()) < _LEAST_CHANNELS:
        raise DataError("too few valid channels from 1320 to 1435 nm to find the step at 1377.5 nm")
    x = (SWIR_NM[good] - SUB_BAND_STEP_NM) / 100
    relative = sigma[good] / swir[good]
    design = np.stack([np.ones_like(x), x, x**2, before[good].astype(float)], axis=1) / relative[:, None]
    solution, *_ = np.linalg.lstsq(design, np.log(swir[good]) / relative, rcond=None)
    covariance = np.linalg.inv(design.T @ design)
    return float(np.exp(-solution[3])), float(np.hypot(np.sqrt(covariance[3, 3]), _STEP_MODEL_ERROR))
