"""Fourth-order polynomials through the deepest part of an absorption band, and their minima, eight spectra at once."""

from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled.formulas import formula
from lunarsci.compiled.lanes import choose, highest, load, lowest, spread, store
from lunarsci.spectra.continuum import CONTINUA, TERMS, TIE_ROWS, Indices
from lunarsci.spectra.lane_rows import uncounted

ORDER = 4
SIZE = ORDER + 1
SEARCH = np.linspace(-1.0, 1.0, 161)
STEP = float(SEARCH[1] - SEARCH[0])
NEWTON_STEPS = 6
LEAST_PIVOT = 1e-15
"""Share of its moment that a pivot must keep, or the channels do not determine the polynomial."""

(
    VALUES, NOISE, IN, X, SHARE, HEFT, HEFT_SLOPE, RESIDUAL, OF_RATIO, OF_CURVE, ONTO, WIDE_NM, WIDE_DEPTH,
    NARROW_NM, NARROW_DEPTH, SPARE, AREA, ASYMMETRY, OWN_NODE, OWN_WEIGHT
) = range(TIE_ROWS, TIE_ROWS + 20)  # fmt: skip
RATIO = OWN_WEIGHT + TERMS
OWN = len(CONTINUA)
"""Place behind the continua: of the one that each spectrum is measured under."""
CURVE, PER_LEVEL, ROWS = (RATIO + k * (OWN + 1) for k in (1, 2, 3))
"""Rows, n of each, of the table (ROWS n, 8) that eight spectra of n channels are worked on in, behind those of their
continua.

Reflectance, one standard deviation; of a window's channels whether they are in it, x, depth over the deepest, weight
and its derivative to that, residual of the polynomial; derivatives to both ratios and to the
smoothed reflectance; derivatives to each reflectance of what their names say; nodes and weights of the spectrum's own
continuum; by continuum and for the own one reflectance and smoothed reflectance over the level, and one over it (or 1
where it is not above 0).
"""
MOMENTS, RIGHT, COEFFICIENTS, SOLVED, FACTOR = 0, 2 * SIZE, 3 * SIZE, 4 * SIZE, 5 * SIZE
(
    DETERMINED, LOWEST, SECOND, FOUND, RIVALLED, DEPTH_HERE, PLACE, FIRST, LAST, MIDDLE_NM, HALF_NM, INNER
) = range(FACTOR + SIZE * SIZE, FACTOR + SIZE * SIZE + 12)  # fmt: skip
OF_TERM = INNER + 1
OF_SHAPE = OF_TERM + TERMS
"""Rows of a second table (rows, 8): sums, right side, coefficients, solution and factor of the normal equations, and
whether they determine a polynomial; x of its lowest and second lowest minimum, and whether there are such; of a window
its greatest depth, and at which channel; its ends, its middle and half its width [nm]; whether the deepest channel lies
within the range it is looked for in, and not at its edge, and there are enough of them; sums over terms."""


class BandWork(NamedTuple):
    """What eight spectra are worked on in: both tables, the channels of terms, and room for one spectrum."""

    t: FloatArray
    k: FloatArray
    tie: Indices
    nodes: Indices
    own: FloatArray


@formula
def polynomial(x: Any, c0: Any, c1: Any, c2: Any, c3: Any, c4: Any) -> Any:
    return c0 + x * (c1 + x * (c2 + x * (c3 + x * c4)))


@uncounted
def fit(t: Any, k: Any, ratio: int, first: int, behind: int, count: int) -> None:
    """Weighted least-squares polynomial of a ratio: factor of its normal matrix, coefficients, residuals."""
    m0, m1, m2, m3, m4 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    m5, m6, m7, m8 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    r0, r1, r2, r3, r4 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(first, behind):
        x, power, value = load(t, X * count + j), load(t, HEFT * count + j), load(t, ratio * count + j)
        m0, r0 = m0 + power, r0 + power * value
        power = power * x
        m1, r1 = m1 + power, r1 + power * value
        power = power * x
        m2, r2 = m2 + power, r2 + power * value
        power = power * x
        m3, r3 = m3 + power, r3 + power * value
        power = power * x
        m4, r4 = m4 + power, r4 + power * value
        power = power * x
        m5 += power
        power = power * x
        m6 += power
        power = power * x
        m7 += power
        m8 += power * x
    _factored(k, m0, m1, m2, m3, m4, m5, m6, m7, m8)
    c0, c1, c2, c3, c4 = solved(k, r0, r1, r2, r3, r4)
    store(k, COEFFICIENTS, c0)
    store(k, COEFFICIENTS + 1, c1)
    store(k, COEFFICIENTS + 2, c2)
    store(k, COEFFICIENTS + 3, c3)
    store(k, COEFFICIENTS + 4, c4)
    for j in range(first, behind):
        fitted = polynomial(load(t, X * count + j), c0, c1, c2, c3, c4)
        store(t, RESIDUAL * count + j, load(t, ratio * count + j) - fitted)


@formula
def _factored(k: Any, m0: Any, m1: Any, m2: Any, m3: Any, m4: Any, m5: Any, m6: Any, m7: Any, m8: Any) -> None:
    """The normal matrix as L D L^T into FACTOR, 1/D on its diagonal, and whether it is regular."""
    moments = (m0, m1, m2, m3, m4, m5, m6, m7, m8)
    pivots: list[Any] = []
    below: dict[tuple[int, int], Any] = {}
    regular = m0 > 0.0
    for i in range(SIZE):
        for j in range(i + 1):
            total = moments[i + j]
            for m in range(j):
                total = total - below[i, m] * below[j, m] * pivots[m]
            if i == j:
                pivots.append(total)
                regular = regular & (total > moments[2 * i] * LEAST_PIVOT)
                store(k, FACTOR + i * SIZE + i, 1.0 / total)
            else:
                below[i, j] = total * load(k, FACTOR + j * SIZE + j)
                store(k, FACTOR + i * SIZE + j, below[i, j])
    store(k, DETERMINED, choose(regular, 1.0, 0.0))


@formula
def solved(k: Any, r0: Any, r1: Any, r2: Any, r3: Any, r4: Any) -> Any:
    """What the normal matrix makes a right side of."""
    out = [r0, r1, r2, r3, r4]
    for i in range(SIZE):
        for j in range(i):
            out[i] = out[i] - load(k, FACTOR + i * SIZE + j) * out[j]
    for i in range(ORDER, -1, -1):
        out[i] = out[i] * load(k, FACTOR + i * SIZE + i)
        for j in range(i + 1, SIZE):
            out[i] = out[i] - load(k, FACTOR + j * SIZE + i) * out[j]
    return tuple(out)


@formula
def value_at(k: Any, x: Any) -> Any:
    """The fitted polynomial at x."""
    return polynomial(x, *(load(k, COEFFICIENTS + power) for power in range(SIZE)))


@formula
def curvature_at(k: Any, x: Any) -> Any:
    c2, c3, c4 = (load(k, COEFFICIENTS + power) for power in (2, 3, 4))
    return c2 * 2.0 + x * (c3 * 6.0 + x * c4 * 12.0)


@formula
def _sorted_in(
    before: Any, here: Any, behind: Any, x: Any, first: Any, second: Any, least: Any, next_least: Any
) -> Any:
    """Take a point of the search among the lowest and the second lowest minimum if it is one."""
    there = (here < before) & (here <= behind)
    leads, follows = there & (here < least), there & (here < next_least)
    second = choose(leads, first, choose(follows, x, second))
    next_least = choose(leads, least, choose(follows, here, next_least))
    return choose(leads, x, first), second, choose(leads, here, least), next_least


@uncounted
def minima(k: Any) -> None:
    """x of the lowest and the second lowest minimum within the window, -1 to 1, and whether there are such."""
    first, second, least, next_least = spread(0.0), spread(0.0), spread(np.inf), spread(np.inf)
    before, here = value_at(k, spread(SEARCH[0])), value_at(k, spread(SEARCH[1]))
    for place in range(1, SEARCH.size - 1):
        behind = value_at(k, spread(SEARCH[place + 1]))
        first, second, least, next_least = _sorted_in(
            before, here, behind, SEARCH[place], first, second, least, next_least
        )
        before, here = here, behind
    store(k, LOWEST, _polished(k, first))
    store(k, SECOND, _polished(k, second))
    store(k, FOUND, choose(np.inf - least, load(k, DETERMINED), spread(0.0)))
    store(k, RIVALLED, choose(np.inf - next_least, load(k, FOUND), spread(0.0)))


@formula
def _polished(k: Any, start: Any) -> Any:
    """Newton's steps to the zero of the derivative, no farther than the next point of the search."""
    c1, c2, c3, c4 = (load(k, COEFFICIENTS + power) for power in (1, 2, 3, 4))
    x = start
    for _ in range(NEWTON_STEPS):
        curvature = curvature_at(k, x)
        slope = c1 + x * (c2 * 2.0 + x * (c3 * 3.0 + x * c4 * 4.0))
        moved = lowest(highest(x - slope / curvature, start - STEP), start + STEP)
        x = choose(curvature, moved, x)
    return x
