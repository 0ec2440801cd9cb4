"""How much wider than measured the errors must be for the twin's physics to explain a drive."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.drive_record import OBSERVED
from lunarsci.twin.inference.misfit import HUBER, Misfit

__all__ = ["inflation_of"]

FloatArray = npt.NDArray[np.float64]
BATCH = 8
"""Values of one wheel that are averaged; assumed longer than what sensors remember, shorter than a drive."""
CHANCE = 0.01
"""That a variance as large as found comes from the errors alone; below it, errors are widened."""


def inflation_of(misfit: Misfit, residuals: FloatArray) -> dict[str, float]:
    """Factor of the errors of each quantity, 1 or more, from whitened residuals of the best soil. (n, 6)

    Independent residuals as large as their errors have means over batches of m values whose variance is 1/m. What the
    physics misses is alike along a stretch or for a wheel, and these means scatter more: their variance times m is the
    variance that errors need to have for as many values to count as independent (batch means; Flegal & Jones 2010,
    10.1214/09-AOS735). Residuals count as at most `HUBER`, so that outliers remain outliers.
    """
    from scipy.stats import chi2

    result = {}
    for k, name in enumerate(OBSERVED):
        known = misfit.known[:, k]
        means = _batch_means(np.clip(residuals[:, k], -HUBER, HUBER), known, misfit.record.wheel)
        if means.size < 2:
            continue
        variance = float((means**2).mean())
        if variance > chi2.isf(CHANCE, means.size) / means.size:
            result[name] = float(np.sqrt(variance))
    return result


def _batch_means(values: FloatArray, known: npt.NDArray[np.bool_], wheels: tuple[str, ...]) -> FloatArray:
    """Sums over batches of each wheel, over the root of their size: unit variance where values are independent."""
    names, found = np.array(wheels), []
    for name in dict.fromkeys(wheels):
        own = values[known & (names == name)]
        for part in np.array_split(own, max(1, round(len(own) / BATCH))) if own.size else []:
            found.append(part.sum() / np.sqrt(part.size))
    return np.array(found)
