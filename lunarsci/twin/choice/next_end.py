"""How well the end of the next drive would be predicted once a drive was learned from, by drives of an ensemble alone.

Each member in turn is taken for the truth: its telemetry is what the drive would send, and what the others, of like
telemetry, say of the next end is the prediction. No soil is fitted, so nothing is taken for linear or normal.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from lunarsci.arrays import NORMAL_MAD, BoolArray, FloatArray

LENGTHS, NOISES = (2.0, 4.0, 8.0), (0.01, 0.1, 1.0)
"""Tried for the kernel: lengths over which telemetry counts as alike, in its spreads, and shares of the ends' variance
that it does not tell. The pair is taken that predicts members left out best."""
LEAST_M = 1e-3
"""Errors below count as this much where they are compared; assumed. [m]"""
CHANCE = 0.05
"""That any of the drives compared counts as a better teacher by the draws alone; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NextEnd:
    """Errors of the predicted end of a next drive, each member in turn being the truth.

    Attributes
    ----------
    errors_m : after the drive, NaN for members that did not finish. (members,) [m]
    before_m : median error without the drive. [m]
    floor_m : median error where the soil is known exactly: what the physics is off by on the next drive. [m]
    """

    errors_m: FloatArray = field(repr=False)
    before_m: float
    floor_m: float

    @property
    def after_m(self) -> float:
        """Median error after the drive. [m]"""
        return float(np.nanmedian(self.errors_m))

    def to_dict(self) -> dict[str, float]:
        """For a result. [m]"""
        return {"before": self.before_m, "after": self.after_m, "soil_known": self.floor_m}

    def surely_below(self, other: "NextEnd", compared: int) -> bool:
        """Whether its errors are smaller than another's of the same members beyond chance, one of so many compared."""
        from scipy.special import ndtri

        ratio = np.log(np.maximum(self.errors_m, LEAST_M) / np.maximum(other.errors_m, LEAST_M))
        ratio = ratio[np.isfinite(ratio)]
        if ratio.size < 2:
            return False
        error = float(ratio.std(ddof=1)) / math.sqrt(ratio.size)
        return bool(ratio.mean() < float(ndtri(CHANCE / max(compared, 1))) * error)


def next_end(telemetry: FloatArray, ends_m: FloatArray, unmoved_m: FloatArray, done: BoolArray) -> NextEnd:
    """Errors of next ends that are predicted from telemetry, by kernel ridge regression with each member left out.

    Parameters
    ----------
    telemetry : with its errors drawn. (members, k)
    ends_m : of the next drive, with what the physics is off by. (members, 2)
    unmoved_m : the same without. (members, 2)
    done : members that finished both drives. (members,)

    Residuals of members left out are those of the whole fit over 1 less the leverage (Rasmussen & Williams 2006,
    Gaussian Processes for Machine Learning, Eq. 5.10-5.12). Heavy tails of telemetry and ends are drawn in by asinh.
    """
    seen, ends = _drawn_in(telemetry[done]), ends_m[done]
    center, scale = np.median(ends, axis=0), max(float(_spread(ends).max()), LEAST_M)
    wanted = np.arcsinh((ends - center) / scale)
    squared = ((seen[:, None] - seen[None]) ** 2).sum(axis=-1)
    best, left = math.inf, wanted
    for length in LENGTHS:
        kernel = np.exp(-0.5 * squared / length**2)
        for noise in NOISES:
            inverse = np.linalg.inv(kernel + noise * np.eye(len(kernel)))
            found = (inverse @ wanted) / np.diag(inverse)[:, None]
            if (size := float(np.abs(found).mean())) < best:
                best, left = size, found
    predicted = center + scale * np.sinh(wanted - left)
    errors = np.full(len(done), np.nan)
    errors[done] = np.hypot(*(ends - predicted).T)
    return NextEnd(
        errors_m=errors,
        before_m=float(np.median(np.hypot(*(ends - center).T))),
        floor_m=float(np.median(np.hypot(*(ends - unmoved_m[done]).T))),
    )


def _spread(values: FloatArray) -> FloatArray:
    """Standard deviation of each column without regard to its tails."""
    return np.asarray(NORMAL_MAD * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def _drawn_in(values: FloatArray) -> FloatArray:
    """Columns about their medians in their spreads, tails drawn in; those that are all alike left out."""
    spread = _spread(values)
    varied = spread > 0
    return np.asarray(np.arcsinh((values - np.median(values, axis=0))[:, varied] / spread[varied]))
