"""Centre, depth, area and asymmetry of one absorption band in eight spectra at once, with standard errors.

The centre is the minimum of a fourth-order polynomial through the deepest part of the band, of two: a wide one, which
scatters little and is biased where the band is asymmetric, and a narrow one, which is neither. They are joined with the
weights of least variance, the bias of the wide one as part of its variance: so the window widens with the noise of the
channels, not with what this noise happened to be, and its bias is in the error. Channels count by a weight that rises
smoothly with the depth of the smoothed band, so that everything from the reflectance to the result has derivatives, the
choice of the window included, and the noise of each channel is carried through to first order, smoothing and continuum
included. Only that the tie points of the continuum are chosen on noisy data is not in the errors. Errors assume noise
independent between channels.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, highest, load, logarithm, lowest, root, spread, store
from lunarsci.spectra.continuum import CONTINUA, TERMS, TIE_ROWS, Indices, Ties
from lunarsci.spectra.noise import uncounted_rows

ORDER = 4
SIZE = ORDER + 1
"""Degree of the polynomials, and their number of coefficients."""
SEARCH = np.linspace(-1.0, 1.0, 161)
"""Points x of a window, -1 and 1 at its ends, among which minima are looked for before Newton's steps."""
STEP = float(SEARCH[1] - SEARCH[0])
NEWTON_STEPS = 6
LEAST_PIVOT = 1e-15
"""Share of its moment that a pivot must keep, or the channels do not determine the polynomial."""
(
    VALUES, NOISE, IN, X, SHARE, HEFT, HEFT_SLOPE, RESIDUAL, OF_RATIO, OF_CURVE, ONTO, WIDE_NM, WIDE_DEPTH,
    NARROW_NM, NARROW_DEPTH, SPARE, AREA, ASYMMETRY, CHOSEN_NODE, CHOSEN_WEIGHT
) = range(TIE_ROWS, TIE_ROWS + 20)  # fmt: skip
RATIO = CHOSEN_WEIGHT + TERMS
CHOSEN = len(CONTINUA)
"""Place behind the continua: of the one that each spectrum is measured under."""
CURVE, PER_LEVEL, ROWS = (RATIO + k * (CHOSEN + 1) for k in (1, 2, 3))
"""Rows, n of each, of the table (ROWS n, 8) that eight spectra of n channels are worked on in, behind those of their
continua (`lunarsci.spectra.continuum`).

* `VALUES`, `NOISE`: reflectance, and one standard deviation of it.
* `IN`, `X`, `SHARE`, `HEFT`, `HEFT_SLOPE`, `RESIDUAL`, of a window's channels: 1 for those in it; wavelength, -1 to 1
  over the window; depth over the deepest; weight, and its derivative to that share; ratio less polynomial.
* `OF_RATIO`, `OF_CURVE`, `ONTO`: derivatives of some quantity to the ratio, to the smoothed ratio, and to the smoothed
  reflectance.
* `WIDE_NM`, `WIDE_DEPTH`, `NARROW_NM`, `NARROW_DEPTH`, `SPARE`, `AREA`, `ASYMMETRY`: derivatives to each reflectance of
  centre and depth in the two windows, of what is needed for a moment, of area and asymmetry.
* `CHOSEN_NODE`, `CHOSEN_WEIGHT`: nodes, and weights of the three terms, of the continuum that a spectrum is measured
  under.
* `RATIO`, `CURVE`, `PER_LEVEL`, of each continuum and, as the fourth, of the chosen one: reflectance and smoothed
  reflectance over the level, and 1 over the level (or 1 where it is not above 0).
"""
RIGHT, COEFFICIENTS, FACTOR = 0, SIZE, 2 * SIZE
(
    DETERMINED, LOWEST, SECOND, HAS_MINIMUM, RIVALLED, DEPTH_HERE, PLACE, FIRST, LAST, MIDDLE_NM, HALF_NM, INNER
) = range(FACTOR + SIZE * SIZE, FACTOR + SIZE * SIZE + 12)  # fmt: skip
OF_TERM = INNER + 1
OF_SHAPE = OF_TERM + TERMS
"""Rows of the second table, `BandWork.scalars`.

* `RIGHT`, `COEFFICIENTS`, `FACTOR`: right side, coefficients and factor of the normal equations; `DETERMINED`, above 0
  where they determine a polynomial.
* `LOWEST`, `SECOND`: x of its lowest and second lowest minimum; `HAS_MINIMUM`, `RIVALLED`: above 0 where there is one.
* `DEPTH_HERE`, `PLACE`: greatest depth in a window, and at which channel; `FIRST`, `LAST`: its first and last channel;
  `MIDDLE_NM`, `HALF_NM`: its middle and half its width. [nm]
* `INNER`: above 0 where the deepest channel lies within the range it is looked for in, not at its edge, and there are
  enough of them.
* `OF_TERM`: derivatives of some quantity to the level at the tie point of each term.
"""


class BandWork(NamedTuple):
    """What eight spectra of n channels are worked on in; all of it is overwritten by the next eight.

    Attributes
    ----------
    table : (ROWS n, 8) what has a number at each channel: row `VALUES` n + j is the reflectance at channel j.
    scalars : (rows, 8) what has one number for each spectrum, at rows such as `SHAPE_NM`; `lunarsci.spectra.bands`
        has more rows behind those named here.
    tie : (4, 3, 8) channel of each term of the three continua, and of the chosen one.
    nodes, room : (n,) channels of the hull, and values, of one spectrum at a time (`tables_of`).
    """

    table: FloatArray
    scalars: FloatArray
    tie: Indices
    nodes: Indices
    room: FloatArray


@formula
def polynomial(x: Any, c0: Any, c1: Any, c2: Any, c3: Any, c4: Any) -> Any:
    """c0 + c1 x + … + c4 x^4."""
    return c0 + x * (c1 + x * (c2 + x * (c3 + x * c4)))


@uncounted_rows
def fit(table: Any, scalars: Any, ratio: int, first: int, behind: int, count: int) -> None:
    """Weighted least-squares polynomial of a ratio: factor of its normal matrix, coefficients, residuals.

    `ratio` is the row of the ratio, of `count` channels; those from `first` to before `behind` are fitted. m_i are the
    sums of weight x^i, r_i those of weight x^i ratio.
    """
    m0, m1, m2, m3, m4 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    m5, m6, m7, m8 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    r0, r1, r2, r3, r4 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(first, behind):
        x, power, value = load(table, X * count + j), load(table, HEFT * count + j), load(table, ratio * count + j)
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
    _factored(scalars, m0, m1, m2, m3, m4, m5, m6, m7, m8)
    c0, c1, c2, c3, c4 = solved(scalars, r0, r1, r2, r3, r4)
    store(scalars, COEFFICIENTS, c0)
    store(scalars, COEFFICIENTS + 1, c1)
    store(scalars, COEFFICIENTS + 2, c2)
    store(scalars, COEFFICIENTS + 3, c3)
    store(scalars, COEFFICIENTS + 4, c4)
    for j in range(first, behind):
        fitted = polynomial(load(table, X * count + j), c0, c1, c2, c3, c4)
        store(table, RESIDUAL * count + j, load(table, ratio * count + j) - fitted)


@formula
def _factored(scalars: Any, m0: Any, m1: Any, m2: Any, m3: Any, m4: Any, m5: Any, m6: Any, m7: Any, m8: Any) -> None:
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
                store(scalars, FACTOR + i * SIZE + i, 1.0 / total)
            else:
                below[i, j] = total * load(scalars, FACTOR + j * SIZE + j)
                store(scalars, FACTOR + i * SIZE + j, below[i, j])
    store(scalars, DETERMINED, choose(regular, 1.0, 0.0))


@formula
def solved(scalars: Any, r0: Any, r1: Any, r2: Any, r3: Any, r4: Any) -> Any:
    """What the normal matrix makes a right side of."""
    out = [r0, r1, r2, r3, r4]
    for i in range(SIZE):
        for j in range(i):
            out[i] = out[i] - load(scalars, FACTOR + i * SIZE + j) * out[j]
    for i in range(ORDER, -1, -1):
        out[i] = out[i] * load(scalars, FACTOR + i * SIZE + i)
        for j in range(i + 1, SIZE):
            out[i] = out[i] - load(scalars, FACTOR + j * SIZE + i) * out[j]
    return tuple(out)


@formula
def value_at(scalars: Any, x: Any) -> Any:
    """The fitted polynomial at x."""
    return polynomial(x, *(load(scalars, COEFFICIENTS + power) for power in range(SIZE)))


@formula
def curvature_at(scalars: Any, x: Any) -> Any:
    """Second derivative of the fitted polynomial at x."""
    c2, c3, c4 = (load(scalars, COEFFICIENTS + power) for power in (2, 3, 4))
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


@uncounted_rows
def minima(scalars: Any) -> None:
    """x of the lowest and the second lowest minimum within the window, -1 to 1, and whether there are such."""
    first, second, least, next_least = spread(0.0), spread(0.0), spread(np.inf), spread(np.inf)
    before, here = value_at(scalars, spread(SEARCH[0])), value_at(scalars, spread(SEARCH[1]))
    for place in range(1, SEARCH.size - 1):
        behind = value_at(scalars, spread(SEARCH[place + 1]))
        first, second, least, next_least = _sorted_in(
            before, here, behind, SEARCH[place], first, second, least, next_least
        )
        before, here = here, behind
    store(scalars, LOWEST, _polished(scalars, first))
    store(scalars, SECOND, _polished(scalars, second))
    store(scalars, HAS_MINIMUM, choose(np.inf - least, load(scalars, DETERMINED), spread(0.0)))
    store(scalars, RIVALLED, choose(np.inf - next_least, load(scalars, HAS_MINIMUM), spread(0.0)))


@formula
def _polished(scalars: Any, start: Any) -> Any:
    """Newton's steps to the zero of the derivative, no farther than the next point of the search."""
    c1, c2, c3, c4 = (load(scalars, COEFFICIENTS + power) for power in (1, 2, 3, 4))
    x = start
    for _ in range(NEWTON_STEPS):
        curvature = curvature_at(scalars, x)
        slope = c1 + x * (c2 * 2.0 + x * (c3 * 3.0 + x * c4 * 4.0))
        moved = lowest(highest(x - slope / curvature, start - STEP), start + STEP)
        x = choose(curvature, moved, x)
    return x


class Smoother(NamedTuple):
    """A linear operator of spectra on the same n channels, each of which takes few others.

    Attributes
    ----------
    first, weights : the first channel that it takes at each channel, and the weights from there, (n,), (n, w).
    """

    first: Indices
    weights: FloatArray


class BandGrid(NamedTuple):
    """What spectra on the same n channels share.

    Attributes
    ----------
    wavelength_nm, steps_nm : channels and their gradient, (n,). [nm]
    smoother, adjoint : the smoothing, and its transpose.
    ties : of the continua.
    """

    wavelength_nm: FloatArray
    steps_nm: FloatArray
    smoother: Smoother
    adjoint: Smoother
    ties: Ties


@uncounted_rows
def smooth(smoother: Smoother, table: Any, source: int, out: int) -> None:
    """Rows from `out` on take what the operator makes of those from `source` on."""
    firsts, weights = smoother
    for j in range(firsts.size):
        first, total = source + firsts[j], spread(0.0)
        for m in range(weights.shape[1]):
            total += load(table, first + m) * weights[j, m]
        store(table, out + j, total)


@formula
def _along(along: Any, residual: Any, slope: Any, heft: Any, share: Any, per_depth: Any, total: Any) -> Any:
    """Derivatives to the ratio and the smoothed ratio at one channel, and the sum of those to the deepest depth."""
    of_share = along * residual * slope * per_depth
    return along * heft, -of_share, total + of_share * share


@uncounted_rows
def slopes(grid: BandGrid, work: BandWork, first: int, behind: int, out: int) -> Any:
    """Derivatives to each reflectance, into rows, of a quantity whose derivatives to the coefficients are in RIGHT; its
    variance."""
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    s0, s1, s2, s3, s4 = solved(
        scalars,
        load(scalars, RIGHT),
        load(scalars, RIGHT + 1),
        load(scalars, RIGHT + 2),
        load(scalars, RIGHT + 3),
        load(scalars, RIGHT + 4),
    )
    per_depth, total = 1.0 / load(scalars, DEPTH_HERE), spread(0.0)
    for j in range(first, behind):
        of_ratio, of_curve, total = _along(
            polynomial(load(table, X * count + j), s0, s1, s2, s3, s4), load(table, RESIDUAL * count + j),
            load(table, HEFT_SLOPE * count + j), load(table, HEFT * count + j), load(table, SHARE * count + j),
            per_depth, total,
        )  # fmt: skip
        store(table, OF_RATIO * count + j, of_ratio)
        store(table, OF_CURVE * count + j, of_curve)
    return per_channel(grid, work, first, behind, out, total)


@uncounted_rows
def per_channel(grid: BandGrid, work: BandWork, first: int, behind: int, out: int, of_deepest: Any) -> Any:
    """Derivatives to both ratios, OF_RATIO and OF_CURVE, into derivatives to the reflectance; the variance.

    `of_deepest` is a derivative to the smoothed ratio at the deepest channel, besides.
    """
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    place, one, two, three = load(scalars, PLACE), spread(0.0), spread(0.0), spread(0.0)
    for j in range(first, behind):
        onto, of_level, direct = _parts(
            load(table, OF_RATIO * count + j), load(table, OF_CURVE * count + j),
            load(table, (RATIO + CHOSEN) * count + j), load(table, (CURVE + CHOSEN) * count + j),
            load(table, (PER_LEVEL + CHOSEN) * count + j), of_deepest, place, float(j),
        )  # fmt: skip
        node = load(table, CHOSEN_NODE * count + j)
        two += of_level * load(table, (CHOSEN_WEIGHT + 1) * count + j)
        three += of_level * load(table, (CHOSEN_WEIGHT + 2) * count + j)
        store(table, out * count + j, direct)
        store(table, OF_RATIO * count + j, of_level)
        store(table, ONTO * count + j, onto + node * two)
        two = choose(node, spread(0.0), two)
    for j in range(behind, count):
        node = load(table, CHOSEN_NODE * count + j)
        store(table, out * count + j, spread(0.0))
        store(table, ONTO * count + j, node * two)
        two = choose(node, spread(0.0), two)
    for j in range(behind - 1, first - 1, -1):
        node = load(table, CHOSEN_NODE * count + j)
        one += load(table, OF_RATIO * count + j) * load(table, CHOSEN_WEIGHT * count + j)
        store(table, ONTO * count + j, load(table, ONTO * count + j) + node * one)
        one = choose(node, spread(0.0), one)
    for j in range(first - 1, -1, -1):
        node = load(table, CHOSEN_NODE * count + j)
        store(table, out * count + j, spread(0.0))
        store(table, ONTO * count + j, node * one)
        one = choose(node, spread(0.0), one)
    _to_ties(work, one, two, three, count)
    return _smoothed_back(grid.adjoint, table, out)


@formula
def _parts(
    of_ratio: Any, of_curve: Any, ratio: Any, curve: Any, per_level: Any, of_deepest: Any, place: Any, j: Any
) -> Any:
    """Derivatives to smoothed reflectance, level and reflectance at channel j from those to the two ratios there."""
    of_curve = of_curve + choose(abs(place - j) < 0.5, of_deepest, 0.0)
    return of_curve * per_level, -(of_ratio * ratio + of_curve * curve) * per_level, of_ratio * per_level


@uncounted_rows
def _to_ties(work: BandWork, one: Any, two: Any, three: Any, count: int) -> None:
    """What derivatives to the level give to the channels of the continuum's terms; the hull's nodes have theirs."""
    table, scalars, tie = work.table, work.scalars, work.tie[CHOSEN]
    store(scalars, OF_TERM, one)
    store(scalars, OF_TERM + 1, two)
    store(scalars, OF_TERM + 2, three)
    for term in range(TERMS):
        for lane in range(LANES):
            table[ONTO * count + tie[term, lane], lane] += scalars[OF_TERM + term, lane]


@uncounted_rows
def _smoothed_back(smoother: Smoother, table: Any, out: int) -> Any:
    """Add what the smoothed reflectance of other channels takes from each; the variance."""
    firsts, weights = smoother
    count, variance = firsts.size, spread(0.0)
    for j in range(count):
        first, total = ONTO * count + firsts[j], load(table, out * count + j)
        for m in range(weights.shape[1]):
            total += load(table, first + m) * weights[j, m]
        store(table, out * count + j, total)
        off = total * load(table, NOISE * count + j)
        variance += off * off
    return variance


WIDE, NARROW = (0.6, 0.9), (0.85, 1.0)
"""Channels less deep than the first share of the band do not count, those deeper than the second count fully; assumed.
Polynomials through about the deepest third are usual for asteroids: Moskovitz et al. (2010), Icarus 208, 773,
10.1016/j.icarus.2010.03.002."""
HALF = 0.5
"""Share of the depth from which a Gaussian is fitted: its half maximum."""
FEWEST_CHANNELS = 8.0
"""Where fewer are in the wide window, shares half as large are used, and the narrow one not at all: coarse channels.
Assumed."""
LEAST_DEPTH = 1e-6
"""Depth below which there is none, so that nothing is divided by 0; assumed."""


@formula
def _deeper(value: Any, j: Any, least: Any, place: Any) -> Any:
    """Least value so far, and its channel, with channel j taken in."""
    below = value < least
    return choose(below, value, least), choose(below, j, place)


@uncounted_rows
def deepest_of(table: Any, curve: int, low: int, high: int, count: int) -> Any:
    """The lowest value of a curve, and its channel, the first where there are several."""
    least, place = load(table, curve * count + low), spread(float(low))
    for j in range(low + 1, high):
        least, place = _deeper(load(table, curve * count + j), float(j), least, place)
    return least, place


@formula
def _goes_on(value: Any, j: Any, place: Any, below: Any, alive: Any) -> Any:
    """1 at the deepest channel and at those that are connected with it, from the one before on."""
    here = (value < below) & (alive > 0.0)
    return choose(abs(place - j) < 0.5, 1.0, choose(here, 1.0, 0.0))


@uncounted_rows
def _connected(table: Any, scalars: Any, curve: int, band: IntArray, below: Any, count: int) -> Any:
    """Which channels are connected with the deepest one, below a level; how many they are."""
    place = load(scalars, PLACE)
    alive, number, end = spread(0.0), spread(0.0), spread(0.0)
    for j in range(band[0], band[1]):
        alive = _goes_on(load(table, curve * count + j), float(j), place, below, alive)
        end = choose(alive, spread(float(j)), end)
        store(table, IN * count + j, alive)
    store(scalars, LAST, end)
    alive = spread(0.0)
    for j in range(band[1] - 1, band[0] - 1, -1):
        alive = _goes_on(load(table, curve * count + j), float(j), place, below, alive)
        end = choose(alive, spread(float(j)), end)
        inside = highest(alive, load(table, IN * count + j))
        number += inside
        store(table, IN * count + j, inside)
    store(scalars, FIRST, end)
    return number


@uncounted_rows
def has_any(scalars: Any, row: int) -> bool:
    """Whether a row is above 0 in any lane."""
    there = False
    for lane in range(LANES):
        there = there or scalars[row, lane] > 0.0
    return there


@uncounted_rows
def window_of(grid: BandGrid, work: BandWork, which: int, band: IntArray, low: float, high: float, wide: bool) -> Any:
    """The channels that are connected with the deepest one and deep enough; their weights into HEFT.

    `which` is the ratio's place among the continua, or CHOSEN; `band` a row of `Places.bands`; a channel's weight rises
    from 0 at `low` of the greatest depth to 1 at `high`. SHARE takes the depth over the deepest, X the scaled
    wavelength, HEFT_SLOPE the derivative of the weight to the share. Returns the first channel that any of the eight
    has, and the one behind the last.
    """
    table, scalars, wavelength_nm, count = work.table, work.scalars, grid.wavelength_nm, grid.wavelength_nm.size
    curve = CURVE + which
    least, place = deepest_of(table, curve, band[2], band[3], count)
    most = highest(1.0 - least, spread(LEAST_DEPTH))
    store(scalars, PLACE, place)
    store(scalars, DEPTH_HERE, most)
    part = spread(1.0)
    number = _connected(table, scalars, curve, band, 1.0 - most * (part * low), count)
    if wide:
        part = choose(FEWEST_CHANNELS - number, spread(0.5), part)
        store(scalars, INNER, 0.75 - part)
        if has_any(scalars, INNER):
            number = _connected(table, scalars, curve, band, 1.0 - most * (part * low), count)
    within = choose(place - float(band[2]), choose(float(band[3] - 1) - place, spread(1.0), spread(0.0)), spread(0.0))
    store(scalars, INNER, choose(number - (FEWEST_CHANNELS - 0.5), within, spread(0.0)))
    first, behind = count, 0
    for lane in range(LANES):
        one, other = int(scalars[FIRST, lane]), int(scalars[LAST, lane])
        first, behind = min(first, one), max(behind, other + 1)
        scalars[MIDDLE_NM, lane] = (wavelength_nm[one] + wavelength_nm[other]) / 2
        scalars[HALF_NM, lane] = max((wavelength_nm[other] - wavelength_nm[one]) / 2, 1.0)
    _weigh(wavelength_nm, table, scalars, curve, low * part, 1.0 / ((high - low) * part), first, behind)
    return first, behind


@formula
def _weights(value: Any, inside: Any, per_depth: Any, low: Any, per_share: Any) -> Any:
    """Depth over the deepest at one channel, its weight 3 s^2 - 2 s^3, and the weight's derivative to that share."""
    share = (1.0 - value) * per_depth
    s = lowest(highest((share - low) * per_share, 0.0), 1.0)
    return share, inside * (s * s * (3.0 - s * 2.0)), inside * (s * (1.0 - s) * per_share * 6.0)


@uncounted_rows
def _weigh(
    wavelength_nm: FloatArray, table: Any, scalars: Any, curve: int, low: Any, per_share: Any, first: int, behind: int
) -> None:
    """Fill SHARE, HEFT, HEFT_SLOPE and X of channels `first` to before `behind`, from a smoothed ratio in row `curve`.

    Weights rise from 0 at the share `low` to 1 at `low` + 1 / `per_share`.
    """
    count = wavelength_nm.size
    per_depth, middle, per_half = (
        1.0 / load(scalars, DEPTH_HERE),
        load(scalars, MIDDLE_NM),
        1.0 / load(scalars, HALF_NM),
    )
    for j in range(first, behind):
        share, heft, slope = _weights(
            load(table, curve * count + j), load(table, IN * count + j), per_depth, low, per_share
        )
        store(table, SHARE * count + j, share)
        store(table, HEFT * count + j, heft)
        store(table, HEFT_SLOPE * count + j, slope)
        store(table, X * count + j, (wavelength_nm[j] - middle) * per_half)


TINY = float(np.finfo(float).tiny)
"""Least divisor, in place of 0."""
(
    MINIMUM_NM, MINIMUM_DEPTH, MINIMUM_VARIANCE, MINIMUM_RIVAL, HAS_SHAPE, WIDE_CENTER_NM, UNSAID, SHAPE_NM,
    CENTER_VARIANCE, SHAPE_DEPTH, DEPTH_VARIANCE, SHAPE_AREA, AREA_VARIANCE, SHAPE_ASYMMETRY, ASYMMETRY_VARIANCE,
    GAUSSIAN_NM
) = range(OF_SHAPE, OF_SHAPE + 16)  # fmt: skip
OF_CHOICE = GAUSSIAN_NM + 1
"""Rows of `BandWork.scalars` behind those.

* `MINIMUM_NM`, `MINIMUM_DEPTH`, `MINIMUM_VARIANCE`: of a minimum in a window its wavelength, depth, and the variance of
  the wavelength. [nm, -, nm2]
* `MINIMUM_RIVAL`: what is not of first order in that variance: that a second minimum may be the lower one, and that the
  curvature is uncertain (three times the square of its relative error). [nm2]
* `HAS_SHAPE`: above 0 where there is a band; `WIDE_CENTER_NM`: its centre in the wide window. [nm]
* `UNSAID`: variance of the centre that is not of first order. [nm2]
* `SHAPE_NM`, `SHAPE_DEPTH`, `SHAPE_AREA`, `SHAPE_ASYMMETRY`, each with its variance: the result. [nm, -, nm, -]
* `GAUSSIAN_NM`: centre of a Gaussian. [nm]
"""


def _right_side(scalars: Any, x: Any, derivative: int, factor: Any) -> None:
    """Derivative of 1, x, …, x^4 at x, times a factor, into RIGHT."""
    power = x * 0.0 + factor
    for n in range(SIZE):
        times = n * (n - 1) if derivative == 2 else n if derivative == 1 else 1
        store(scalars, RIGHT + n, power * float(times) if n >= derivative else x * 0.0)
        power = power * x if n >= derivative else power


@formula
def _ask_curvature(scalars: Any, x: Any) -> None:
    """Derivatives of the curvature at x by the coefficients, into RIGHT."""
    _right_side(scalars, x, 2, 1.0)


@formula
def _ask_depth(scalars: Any, x: Any) -> None:
    """Derivatives of the depth at x by the coefficients, into RIGHT."""
    _right_side(scalars, x, 0, -1.0)


@formula
def _ask_centre(scalars: Any, x: Any, per_slope: Any) -> None:
    """Derivatives of the minimum's wavelength by the coefficients, into RIGHT; `per_slope`: nm per unit of slope."""
    _right_side(scalars, x, 1, -per_slope)


@formula
def _difference(scalars: Any, x: Any, other: Any) -> None:
    """What two points of the polynomial differ by, into RIGHT."""
    one, two = x * 0.0 + 1.0, x * 0.0 + 1.0
    for n in range(SIZE):
        store(scalars, RIGHT + n, two - one)
        one, two = one * x, two * other


@uncounted_rows
def _minimum(grid: BandGrid, work: BandWork, first: int, behind: int, row: int) -> None:
    """The minimum in a window; derivatives of wavelength and depth into rows from `row` on."""
    table, scalars = work.table, work.scalars
    fit(table, scalars, RATIO + CHOSEN, first, behind, grid.wavelength_nm.size)
    minima(scalars)
    x, curvature, per_x = load(scalars, LOWEST), curvature_at(scalars, load(scalars, LOWEST)), load(scalars, HALF_NM)
    _ask_curvature(scalars, x)
    flat = root(slopes(grid, work, first, behind, SPARE)) / highest(curvature, spread(TINY))
    _ask_depth(scalars, x)
    slopes(grid, work, first, behind, row + 1)
    _ask_centre(scalars, x, per_x / curvature)
    variance = slopes(grid, work, first, behind, row)
    store(scalars, MINIMUM_NM, load(scalars, MIDDLE_NM) + per_x * x)
    store(scalars, MINIMUM_DEPTH, 1.0 - value_at(scalars, x))
    store(scalars, MINIMUM_VARIANCE, variance)
    store(scalars, MINIMUM_RIVAL, flat * flat * variance * 3.0)
    if has_any(scalars, RIVALLED):
        _add_rival(grid, work, first, behind)


@uncounted_rows
def _add_rival(grid: BandGrid, work: BandWork, first: int, behind: int) -> None:
    """What it adds to the variance of the centre that the second minimum may truly be the lower one. [nm2]

    The probability of that, from the difference of their depths and its error, times the square of their distance.
    """
    scalars = work.scalars
    x, second = load(scalars, LOWEST), load(scalars, SECOND)
    _difference(scalars, x, second)
    sigma = highest(root(slopes(grid, work, first, behind, SPARE)), spread(TINY))
    store(scalars, OF_TERM, (value_at(scalars, second) - value_at(scalars, x)) / sigma)
    for lane in range(LANES):
        if scalars[RIVALLED, lane] > 0.0:
            apart = scalars[HALF_NM, lane] * (scalars[SECOND, lane] - scalars[LOWEST, lane])
            scalars[MINIMUM_RIVAL, lane] += 0.5 * math.erfc(scalars[OF_TERM, lane] / math.sqrt(2.0)) * apart * apart


@uncounted_rows
def shape(grid: BandGrid, work: BandWork, band: IntArray, bias: float, least: float) -> None:
    """Measure a band under the continuum chosen for each spectrum; the result is in the rows from `HAS_SHAPE` on.

    `band` is a row of `Places.bands`, `bias` and `least` are those of `Band`. The derivatives of centre, depth, area
    and asymmetry stay in rows: WIDE_NM, WIDE_DEPTH, AREA, ASYMMETRY.
    """
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    first, behind = window_of(grid, work, CHOSEN, band, WIDE[0], WIDE[1], True)
    _minimum(grid, work, first, behind, WIDE_NM)
    store(scalars, HAS_SHAPE, load(scalars, HAS_MINIMUM))
    half = load(scalars, HALF_NM) * bias
    _remember_wide(scalars, half * half)
    first, behind = window_of(grid, work, CHOSEN, band, NARROW[0], NARROW[1], False)
    _minimum(grid, work, first, behind, NARROW_NM)
    _join(table, scalars, count)
    hidden = _areas(grid, work, band)
    unsaid = load(scalars, UNSAID)
    of_depth = _variance(table, WIDE_DEPTH, count)
    store(
        scalars,
        CENTER_VARIANCE,
        highest(_variance(table, WIDE_NM, count) + unsaid, _least_variance(scalars, of_depth, least)),
    )
    store(scalars, DEPTH_VARIANCE, of_depth)
    store(scalars, ASYMMETRY_VARIANCE, load(scalars, ASYMMETRY_VARIANCE) + hidden * hidden * unsaid)
    store(scalars, GAUSSIAN_NM, _gaussian_centre(grid, work, band))


@formula
def _remember_wide(scalars: Any, bias2: Any) -> None:
    """Keep the minimum of the wide window, the square of its bias with what is not of first order. [nm2]"""
    store(scalars, SHAPE_NM, load(scalars, MINIMUM_NM))
    store(scalars, WIDE_CENTER_NM, load(scalars, MINIMUM_NM))
    store(scalars, SHAPE_DEPTH, load(scalars, MINIMUM_DEPTH))
    store(scalars, CENTER_VARIANCE, load(scalars, MINIMUM_VARIANCE))
    store(scalars, UNSAID, load(scalars, MINIMUM_RIVAL) + bias2)


@uncounted_rows
def _variance(table: Any, row: int, count: int) -> Any:
    """Variance of a quantity whose derivatives to each reflectance are in rows."""
    total = spread(0.0)
    for j in range(count):
        off = load(table, row * count + j) * load(table, NOISE * count + j)
        total += off * off
    return total


@formula
def _least_variance(scalars: Any, of_depth: Any, factor: float) -> Any:
    """Of a centre: see `Band.least`. [nm2]"""
    depth = load(scalars, SHAPE_DEPTH)
    width = load(scalars, SHAPE_AREA) * (factor / math.sqrt(2.0 * math.pi))
    variance = width * width * of_depth / highest(depth * depth * depth * depth, TINY)
    return choose(depth > 0.0, variance, 0.0)


@formula
def _part_of_wide(scalars: Any, common: Any) -> Any:
    """Weight of the wide window for the least variance, 1 where the narrow one has no minimum."""
    of_wide = load(scalars, CENTER_VARIANCE) + load(scalars, UNSAID)
    of_narrow = load(scalars, MINIMUM_VARIANCE) + load(scalars, MINIMUM_RIVAL)
    share = (of_narrow - common) / highest(of_wide + of_narrow - common * 2.0, TINY)
    there = (load(scalars, INNER) > 0.0) & (load(scalars, HAS_MINIMUM) > 0.0)
    return choose(there, lowest(highest(share, 0.0), 1.0), 1.0)


@formula
def _blend(part: Any, wide: Any, narrow: Any) -> Any:
    """`part` of the wide window's value and the rest of the narrow one's, which has no meaning where `part` is 1."""
    return choose(part < 1.0, part * wide + (1.0 - part) * narrow, wide)


@uncounted_rows
def _join(table: Any, scalars: Any, count: int) -> None:
    """Centre, depth, and the centre's variance that is not of first order, of the wide and the narrow window together.

    Their weights are those of the least variance. The derivatives take the place of those of the wide window.
    """
    common = spread(0.0)
    for j in range(count):
        noise = load(table, NOISE * count + j)
        common += load(table, WIDE_NM * count + j) * load(table, NARROW_NM * count + j) * noise * noise
    part = _part_of_wide(scalars, common)
    for j in range(2 * count):
        at = WIDE_NM * count + j
        store(table, at, _blend(part, load(table, at), load(table, NARROW_NM * count + j)))
    store(scalars, SHAPE_NM, _blend(part, load(scalars, SHAPE_NM), load(scalars, MINIMUM_NM)))
    store(scalars, SHAPE_DEPTH, _blend(part, load(scalars, SHAPE_DEPTH), load(scalars, MINIMUM_DEPTH)))
    rest = 1.0 - part
    store(scalars, UNSAID, _blend(part, part * load(scalars, UNSAID), rest * load(scalars, MINIMUM_RIVAL)))


@formula
def _deep(wavelength_nm: Any, steps_nm: Any, center_nm: Any, ratio: Any) -> Any:
    """Side of the centre on which a channel lies, -1 to 1 across it, and the area that it adds. [-, nm]"""
    side = lowest(highest((wavelength_nm - center_nm) * 2.0 / steps_nm, -1.0), 1.0)
    return side, (1.0 - ratio) * steps_nm


@uncounted_rows
def _areas(grid: BandGrid, work: BandWork, band: IntArray) -> Any:
    """Area and asymmetry, and the derivatives of both to each reflectance; what 1 nm of centre does to the latter.

    It takes that from the right and gives it to the left.
    """
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    wavelength_nm, steps_nm = grid.wavelength_nm, grid.steps_nm
    center, across, area, excess = load(scalars, SHAPE_NM), load(scalars, SHAPE_DEPTH) * 2.0, spread(0.0), spread(0.0)
    for j in range(band[0], band[1]):
        side, deep = _deep(wavelength_nm[j], steps_nm[j], center, load(table, (RATIO + CHOSEN) * count + j))
        area += deep
        excess += deep * side
        store(table, OF_RATIO * count + j, side * -steps_nm[j])
        store(table, OF_CURVE * count + j, spread(0.0))
    per_channel(grid, work, band[0], band[1], ASYMMETRY, spread(0.0))
    for j in range(band[0], band[1]):
        store(table, OF_RATIO * count + j, spread(-steps_nm[j]))
    store(scalars, AREA_VARIANCE, per_channel(grid, work, band[0], band[1], AREA, spread(0.0)))
    per_area = choose(area * area, 1.0 / area, spread(0.0))
    asymmetry, variance = excess * per_area, spread(0.0)
    for j in range(count):
        of_excess = load(table, ASYMMETRY * count + j) - across * load(table, WIDE_NM * count + j)
        slope = (of_excess - asymmetry * load(table, AREA * count + j)) * per_area
        off = slope * load(table, NOISE * count + j)
        variance += off * off
    store(scalars, SHAPE_AREA, area)
    store(scalars, SHAPE_ASYMMETRY, asymmetry)
    store(scalars, ASYMMETRY_VARIANCE, variance)
    return across * per_area


@formula
def _gaussian_terms(curve: Any, heft: Any, x: Any) -> Any:
    """Weight w of one channel, w x and w ln depth."""
    deep = highest(1.0 - curve, LEAST_DEPTH)
    heft = choose(heft > 0.0, deep * deep, 0.0)
    return heft, heft * x, heft * logarithm(deep)


@uncounted_rows
def _gaussian_centre(grid: BandGrid, work: BandWork, band: IntArray) -> Any:
    """Centre of a Gaussian through the deeper half of the smoothed band; NaN where there is none. [nm]

    A parabola through ln depth, weighted with the depth squared: Guo (2011), 10.1109/MSP.2011.941846.
    """
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    first, behind = window_of(grid, work, CHOSEN, band, HALF, HALF + 1e-9, False)
    m0, m1, m2, m3, m4 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    r0, r1, r2 = spread(0.0), spread(0.0), spread(0.0)
    for j in range(first, behind):
        x = load(table, X * count + j)
        heft, power, right = _gaussian_terms(
            load(table, (CURVE + CHOSEN) * count + j), load(table, HEFT * count + j), x
        )
        m0, m1, r0, r1 = m0 + heft, m1 + power, r0 + right, r1 + right * x
        power = power * x
        m2, r2 = m2 + power, r2 + right * x * x
        m3, m4 = m3 + power * x, m4 + power * x * x
    return _parabola(scalars, m0, m1, m2, m3, m4, r0, r1, r2)


@formula
def _parabola(scalars: Any, m0: Any, m1: Any, m2: Any, m3: Any, m4: Any, r0: Any, r1: Any, r2: Any) -> Any:
    """Wavelength of the top of the parabola with these sums of w x^i and w x^i ln depth; NaN where it has none. [nm]"""
    d11, d12, d22 = m2 - m1 * m1 / m0, m3 - m1 * m2 / m0, m4 - m2 * m2 / m0
    e1, e2 = r1 - m1 * r0 / m0, r2 - m2 * r0 / m0
    bend = (e2 * d11 - e1 * d12) / (d11 * d22 - d12 * d12)
    x = (e1 - d12 * bend) / d11 / (bend * -2.0)
    enough = load(scalars, LAST) - load(scalars, FIRST) > 1.5
    there = enough & (bend < 0.0) & (abs(x) < 1.0)
    return choose(there, load(scalars, MIDDLE_NM) + load(scalars, HALF_NM) * x, math.nan)
