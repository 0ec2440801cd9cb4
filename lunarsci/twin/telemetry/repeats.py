"""Readings that repeat the one before to the last digit: of a sensor that hangs, or is asked more often than it reads.

Such a reading tells nothing new. A sound sensor repeats by chance, which its noise and its last digit tell, and where
nothing changes; a run of repeats is held where that is much less probable.
"""

import math

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray

LEAST_HELD, SURELY = 1e-4, 3.0
"""Least odds beforehand that a run is held; they are the share of repeats beyond so many times that by chance;
assumed."""
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
    # A channel that is sent more often than it is read repeats throughout.
    ln_held = math.log(max(LEAST_HELD, repeats.sum() / len(values) - SURELY * chance))
    ln_odds = ln_held - repeats * math.log(chance) + 0.5 * change**2 / (sigma**2 + (FOLLOWS * change) ** 2)
    result = np.repeat((ln_odds > 0) & (repeats > 0), repeats + 1)
    result[begins] = False
    return np.asarray(result)


def digit_of(values: FloatArray) -> float:
    """The last digit: the finest change of which all changes are multiples; a thousandth of it where they are none.

    Infinite where nothing changes.
    """
    changes = np.abs(np.diff(values, axis=0))
    known = changes[np.isfinite(changes)]
    known = known[known > 1e-6 * np.max(known, initial=0.0)]
    finest = float(np.min(known, initial=np.inf))
    return finest if (np.abs(known / finest - np.rint(known / finest)) < 0.01).all() else 1e-3 * finest


def chance_by_noise(values: FloatArray, sigma: float) -> float:
    """Probability that a reading with an error of `sigma` repeats the one before, by its last digit.

    The difference of two is normal, of standard deviation sqrt 2 sigma, and rounded to the finest change there is.
    """
    return min(1.0, digit_of(values) / (2.0 * math.sqrt(math.pi) * sigma))
