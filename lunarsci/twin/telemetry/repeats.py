"""Readings that repeat the one before to the last digit: of a sensor that hangs, or is asked more often than it reads.

Such a reading tells nothing new. A sound sensor repeats by chance, which its noise and its last digit tell, and where
nothing changes; a run of repeats is held where that is much less probable.
"""

import math

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray

LN_HELD = math.log(1e-4)
"""Odds beforehand that a run is held, not chance; assumed."""
FOLLOWS = 0.2
"""Share by which a change may differ from the one that is expected; assumed."""


def held(values: FloatArray, chance: float, expected: FloatArray, sigma: float) -> BoolArray:
    """Which readings only repeat the one before. (n,)

    Parameters
    ----------
    values : readings, of one or more numbers each. (n,) or (n, m)
    chance : probability that a sound reading repeats the one before while nothing changes.
    expected : what the reading should have changed by since the start. (n,)
    sigma : standard error of that change beside the share `FOLLOWS`, in its unit.
    """
    flat = values.reshape(len(values), -1)
    begins = np.flatnonzero(np.append(True, (np.diff(flat, axis=0) != 0).any(axis=1)))
    repeats = np.diff(np.append(begins, len(values))) - 1
    change = np.maximum.reduceat(expected, begins) - np.minimum.reduceat(expected, begins)
    ln_odds = LN_HELD - repeats * math.log(chance) + 0.5 * change**2 / (sigma**2 + (FOLLOWS * change) ** 2)
    result = np.repeat((ln_odds > 0) & (repeats > 0), repeats + 1)
    result[begins] = False
    return np.asarray(result)


def digit_of(values: FloatArray) -> float:
    """The finest change between successive readings but for those of floating point; infinite where there is none."""
    changes = np.abs(np.diff(values, axis=0))
    known = changes[np.isfinite(changes)]
    return float(np.min(known, where=known > 1e-6 * np.max(known, initial=0.0), initial=np.inf))


def chance_by_noise(values: FloatArray, sigma: float) -> float:
    """Probability that a reading with an error of `sigma` repeats the one before, by its last digit.

    The difference of two is normal, of standard deviation sqrt 2 sigma, and rounded to the finest change there is.
    """
    return min(1.0, digit_of(values) / (2.0 * math.sqrt(math.pi) * sigma))
