"""How much wider than measured the errors must be for the twin's physics to explain a drive."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.drive_record import OBSERVED
from lunarsci.twin.inference.misfit import HUBER, POSITION, Misfit

__all__ = ["inflation_of", "wheel_errors"]

FloatArray = npt.NDArray[np.float64]
BATCH = 8
"""Values of one wheel that are averaged; assumed longer than what sensors remember, shorter than a drive."""
CHANCE = 0.01
"""That a variance as large as found comes from the errors alone; below it, errors are widened."""
MEDIAN_VARIANCE = np.pi / 2
"""Of the median of n normal values, times n over theirs."""


def wheel_errors(misfit: Misfit, residuals: FloatArray) -> dict[str, float]:
    """Standard deviation of an error that each wheel has of its own, by quantity, in the errors of its values.

    From whitened residuals of the best soil, such errors not removed (n, 6): the wheels' medians scatter more about
    their mean than noise would let them, as where rear wheels follow in ruts and the twin's do not (DerSimonian & Laird
    1986, 10.1016/0197-2456(86)90046-2).
    """
    from scipy.stats import chi2

    result = {}
    for k, name in enumerate(OBSERVED):
        parts = _by_wheel(misfit, residuals[:, k], k)
        if len(parts) < 2:
            continue
        medians = np.array([np.median(part) for part in parts])
        noise = np.array([MEDIAN_VARIANCE / part.size for part in parts])
        weight = 1.0 / noise
        excess = (weight * (medians - np.average(medians, weights=weight)) ** 2).sum() - (len(parts) - 1)
        if excess + len(parts) - 1 > chi2.isf(CHANCE, len(parts) - 1):
            result[name] = float(np.sqrt(excess / (weight.sum() - (weight**2).sum() / weight.sum())))
    return result


def inflation_of(misfit: Misfit, residuals: FloatArray, places: FloatArray) -> dict[str, float]:
    """Factor of the errors of each quantity, and of positions, above 1, from whitened residuals of the best soil.

    Those are of states (n, 6), and of positions (2 f,), x and y in turn.

    Independent residuals as large as their errors have means over batches of m values whose variance is 1/m. What the
    physics misses is alike along a stretch, and these means scatter more: their variance times m is the variance that
    errors need to have for as many values to count as independent (batch means; Flegal & Jones 2010,
    10.1214/09-AOS735). What a wheel has of its own throughout is left to `wheel_errors`. Residuals count as at most
    `HUBER`, so that outliers remain outliers, but those of positions, which are few.
    """
    from scipy.stats import chi2

    series = {POSITION: [part for part in (places[::2], places[1::2]) if part.size]}
    for k, name in enumerate(OBSERVED):
        parts = [part - np.median(part) for part in _by_wheel(misfit, residuals[:, k], k)]
        series[name] = [np.clip(part, -HUBER, HUBER) for part in parts]
    result = {}
    for name, parts in series.items():
        means = _batch_means(parts)
        if means.size < 2:
            continue
        variance = float((means**2).mean())
        if variance > chi2.isf(CHANCE, means.size) / means.size:
            result[name] = float(np.sqrt(variance))
    return result


def _by_wheel(misfit: Misfit, values: FloatArray, k: int) -> list[FloatArray]:
    known, wheels = misfit.known[:, k], np.array(misfit.record.wheel)
    parts = [values[known & (wheels == name)] for name in dict.fromkeys(misfit.record.wheel)]
    return [part for part in parts if part.size]


def _batch_means(parts: list[FloatArray]) -> FloatArray:
    """Sums over batches, over the root of their size: unit variance where values are independent."""
    batches = [batch for part in parts for batch in np.array_split(part, max(1, round(len(part) / BATCH)))]
    return np.array([batch.sum() / np.sqrt(batch.size) for batch in batches])
