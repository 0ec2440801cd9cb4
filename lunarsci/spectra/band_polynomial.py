"""Fourth-order polynomials through the deepest part of an absorption band, and their minima; compiled."""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.continuum import CONTINUA, TERMS

ORDER = 4
SIZE = ORDER + 1
SEARCH = np.linspace(-1.0, 1.0, 161)
STEP = float(SEARCH[1] - SEARCH[0])
NEWTON_STEPS = 6

kernel = partial(compiled, nogil=True, error_model="numpy", fastmath=VECTORS)


(
    WAVELENGTH, STEPS, VALUES, SMOOTHED, NOISE, X, SHARE, HEFT, HEFT_SLOPE, RESIDUAL, OF_RATIO, OF_CURVE, ONTO, POWER,
    WIDE_NM, WIDE_DEPTH, NARROW_NM, NARROW_DEPTH, SPARE, AREA, ASYMMETRY, MOMENTS, RIGHT, COEFFICIENTS, SOLVED, FACTOR
) = range(26)  # fmt: skip
LEVEL = FACTOR + SIZE
PER_LEVEL, RATIO, CURVE, WEIGHT = (LEVEL + k * len(CONTINUA) for k in (1, 2, 3, 4))
ROWS = WEIGHT + TERMS * len(CONTINUA)
"""Rows of the table (ROWS, n) that one spectrum of n channels is worked on in.

Channels and their gradient [nm]; reflectance, smoothed, one standard deviation of each; of a window's channels x, depth
over the deepest, weight and its derivative to that, residual of the polynomial; derivatives to both ratios, to the
smoothed reflectance, and a spare; derivatives to each reflectance of what their names say; sums, right side,
coefficients, solution and factor of the normal equations; by continuum its level, one over it (or 1 where it is not
above 0), reflectance and smoothed reflectance times that, and the weights of its ties, whose channels are in a table
`tie` of their own, (9, n).
"""


class BandWindow(NamedTuple):
    """The channels that a centre is found from.

    Attributes
    ----------
    first, last, deepest : channels.
    depth : of the deepest. [-]
    middle_nm, half_nm : scale of x, which is -1 at the first channel and 1 at the last. [nm]
    inner : whether the deepest channel lies within the range it is looked for in, and not at its edge, and there are
        enough of them.
    """

    first: int
    last: int
    deepest: int
    depth: float
    middle_nm: float
    half_nm: float
    inner: bool


@kernel
def fit(s: FloatArray, c: int, w: BandWindow) -> bool:
    """Weighted least-squares polynomial of RATIO: factor of its normal matrix, coefficients, residuals.

    False where the channels do not determine it.
    """
    first, behind = w.first, w.last + 1
    for j in range(first, behind):
        s[POWER, j] = s[HEFT, j]
    for k in range(2 * ORDER + 1):
        total, right = 0.0, 0.0
        for j in range(first, behind):
            total += s[POWER, j]
            right += s[POWER, j] * s[RATIO + c, j]
            s[POWER, j] *= s[X, j]
        s[MOMENTS, k] = total
        if k <= ORDER:
            s[RIGHT, k] = right
    if not _factored(s):
        return False
    solve(s, RIGHT, COEFFICIENTS)
    for j in range(first, behind):
        x = s[X, j]
        s[RESIDUAL, j] = s[RATIO + c, j] - value_at(s, COEFFICIENTS, x)
    return True


@kernel
def _factored(s: FloatArray) -> bool:
    """The normal matrix as L D L^T into FACTOR, D on its diagonal; False where it is singular."""
    for i in range(SIZE):
        for k in range(i + 1):
            total = s[MOMENTS, i + k]
            for m in range(k):
                total -= s[FACTOR + i, m] * s[FACTOR + k, m] * s[FACTOR + m, m]
            s[FACTOR + i, k] = total if i == k else total / s[FACTOR + k, k]
        if not s[FACTOR + i, i] > 1e-15 * s[MOMENTS, 2 * i]:
            return False
    return True


@kernel
def solve(s: FloatArray, right: int, out: int) -> None:
    """What the normal matrix makes a row of right sides of, into another row."""
    for i in range(SIZE):
        total = s[right, i]
        for k in range(i):
            total -= s[FACTOR + i, k] * s[out, k]
        s[out, i] = total
    for i in range(ORDER, -1, -1):
        total = s[out, i] / s[FACTOR + i, i]
        for k in range(i + 1, SIZE):
            total -= s[FACTOR + k, i] * s[out, k]
        s[out, i] = total


@kernel
def value_at(s: FloatArray, row: int, x: float) -> float:
    """The polynomial whose coefficients are in a row, at x."""
    return float(s[row, 0] + x * (s[row, 1] + x * (s[row, 2] + x * (s[row, 3] + x * s[row, 4]))))


@kernel
def curvature_at(s: FloatArray, x: float) -> float:
    return float(2.0 * s[COEFFICIENTS, 2] + x * (6.0 * s[COEFFICIENTS, 3] + x * 12.0 * s[COEFFICIENTS, 4]))


@kernel
def minima(s: FloatArray) -> tuple[float, float]:
    """x of the lowest and the second lowest minimum within the window, -1 to 1; NaN where there is none."""
    lowest, second, least, next_least = -1, -1, math.inf, math.inf
    before, here = value_at(s, COEFFICIENTS, SEARCH[0]), value_at(s, COEFFICIENTS, SEARCH[1])
    for k in range(1, SEARCH.size - 1):
        behind = value_at(s, COEFFICIENTS, SEARCH[k + 1])
        if here < before and here <= behind:
            if here < least:
                lowest, second, least, next_least = k, lowest, here, least
            elif here < next_least:
                second, next_least = k, here
        before, here = here, behind
    return _polished(s, lowest), _polished(s, second)


@kernel
def _polished(s: FloatArray, place: int) -> float:
    """Newton's steps to the zero of the derivative, no farther than the next point of the search."""
    if place < 0:
        return math.nan
    x = start = SEARCH[place]
    b1, b2, b3, b4 = s[COEFFICIENTS, 1], s[COEFFICIENTS, 2], s[COEFFICIENTS, 3], s[COEFFICIENTS, 4]
    for _ in range(NEWTON_STEPS):
        curvature = curvature_at(s, x)
        if curvature > 0:
            slope = b1 + x * (2.0 * b2 + x * (3.0 * b3 + x * 4.0 * b4))
            x = min(max(x - slope / curvature, start - STEP), start + STEP)
    return float(x)


@kernel
def powers(s: FloatArray, x: float, derivative: int, factor: float) -> None:
    """Derivative of 1, x, …, x^4 at x, times a factor, into RIGHT."""
    power = factor
    for k in range(SIZE):
        s[RIGHT, k] = 0.0
    for k in range(derivative, SIZE):
        s[RIGHT, k] = power * (k * (k - 1) if derivative == 2 else k if derivative == 1 else 1)
        power *= x
