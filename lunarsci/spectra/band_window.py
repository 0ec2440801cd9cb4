"""The channels about the deepest one of an absorption band, of eight spectra at once, and how much each counts."""

from typing import Any

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, highest, load, lowest, spread, store
from lunarsci.spectra.band_polynomial import (
    CURVE,
    DEPTH_HERE,
    FIRST,
    HALF_NM,
    HEFT,
    HEFT_SLOPE,
    IN,
    INNER,
    LAST,
    MIDDLE_NM,
    PLACE,
    SHARE,
    BandWork,
    X,
)
from lunarsci.spectra.band_slopes import BandGrid
from lunarsci.spectra.lane_rows import uncounted

WIDE, NARROW = (0.6, 0.9), (0.85, 1.0)
"""Channels less deep than the first share of the band do not count, those deeper than the second count fully; assumed.
Polynomials through about the deepest third are usual for asteroids: Moskovitz et al. (2010), Icarus 208, 773,
10.1016/j.icarus.2010.03.002."""


HALF = 0.5
"""Share of the depth from which a Gaussian is fitted; assumed."""


FEWEST_CHANNELS = 8.0
"""Where fewer are in the wide window, shares half as large are used, and the narrow one not at all: coarse channels.
Assumed."""


LEAST_DEPTH = 1e-6


@formula
def _deeper(value: Any, j: Any, least: Any, place: Any) -> Any:
    below = value < least
    return choose(below, value, least), choose(below, j, place)


@uncounted
def deepest_of(t: Any, curve: int, low: int, high: int, count: int) -> Any:
    """The lowest value of a curve, and its channel, the first where there are several."""
    least, place = load(t, curve * count + low), spread(float(low))
    for j in range(low + 1, high):
        least, place = _deeper(load(t, curve * count + j), float(j), least, place)
    return least, place


@formula
def _goes_on(value: Any, j: Any, place: Any, below: Any, alive: Any) -> Any:
    """1 at the deepest channel and at those that are connected with it, from the one before on."""
    here = (value < below) & (alive > 0.0)
    return choose(abs(place - j) < 0.5, 1.0, choose(here, 1.0, 0.0))


@uncounted
def _connected(t: Any, k: Any, curve: int, band: IntArray, below: Any, count: int) -> Any:
    """Which channels are connected with the deepest one, below a level; how many they are."""
    place = load(k, PLACE)
    alive, number, end = spread(0.0), spread(0.0), spread(0.0)
    for j in range(band[0], band[1]):
        alive = _goes_on(load(t, curve * count + j), float(j), place, below, alive)
        end = choose(alive, spread(float(j)), end)
        store(t, IN * count + j, alive)
    store(k, LAST, end)
    alive = spread(0.0)
    for j in range(band[1] - 1, band[0] - 1, -1):
        alive = _goes_on(load(t, curve * count + j), float(j), place, below, alive)
        end = choose(alive, spread(float(j)), end)
        inside = highest(alive, load(t, IN * count + j))
        number += inside
        store(t, IN * count + j, inside)
    store(k, FIRST, end)
    return number


@uncounted
def has_any(k: Any, row: int) -> bool:
    found = False
    for lane in range(LANES):
        found = found or k[row, lane] > 0.0
    return found


@uncounted
def window_of(g: BandGrid, work: BandWork, own: int, band: IntArray, low: float, high: float, wide: bool) -> Any:
    """The channels that are connected with the deepest one and deep enough; their weights into HEFT.

    SHARE takes the depth over the deepest, X the scaled wavelength, HEFT_SLOPE the derivative of the weight
    to the share. Returns the first channel that any of the eight has, and the one behind the last.
    """
    t, k, wavelength_nm, count = work.t, work.k, g.wavelength_nm, g.wavelength_nm.size
    curve = CURVE + own
    least, place = deepest_of(t, curve, band[2], band[3], count)
    most = highest(1.0 - least, spread(LEAST_DEPTH))
    store(k, PLACE, place)
    store(k, DEPTH_HERE, most)
    part = spread(1.0)
    number = _connected(t, k, curve, band, 1.0 - most * (part * low), count)
    if wide:
        part = choose(FEWEST_CHANNELS - number, spread(0.5), part)
        store(k, INNER, 0.75 - part)
        if has_any(k, INNER):
            number = _connected(t, k, curve, band, 1.0 - most * (part * low), count)
    within = choose(place - float(band[2]), choose(float(band[3] - 1) - place, spread(1.0), spread(0.0)), spread(0.0))
    store(k, INNER, choose(number - (FEWEST_CHANNELS - 0.5), within, spread(0.0)))
    first, behind = count, 0
    for lane in range(LANES):
        one, other = int(k[FIRST, lane]), int(k[LAST, lane])
        first, behind = min(first, one), max(behind, other + 1)
        k[MIDDLE_NM, lane] = (wavelength_nm[one] + wavelength_nm[other]) / 2
        k[HALF_NM, lane] = max((wavelength_nm[other] - wavelength_nm[one]) / 2, 1.0)
    _weigh(wavelength_nm, t, k, curve, low * part, 1.0 / ((high - low) * part), first, behind)
    return first, behind


@formula
def _weights(value: Any, inside: Any, per_depth: Any, low: Any, per_share: Any) -> Any:
    share = (1.0 - value) * per_depth
    s = lowest(highest((share - low) * per_share, 0.0), 1.0)
    return share, inside * (s * s * (3.0 - s * 2.0)), inside * (s * (1.0 - s) * per_share * 6.0)


@uncounted
def _weigh(
    wavelength_nm: FloatArray, t: Any, k: Any, curve: int, low: Any, per_share: Any, first: int, behind: int
) -> None:
    count = wavelength_nm.size
    per_depth, middle, per_half = 1.0 / load(k, DEPTH_HERE), load(k, MIDDLE_NM), 1.0 / load(k, HALF_NM)
    for j in range(first, behind):
        share, heft, slope = _weights(load(t, curve * count + j), load(t, IN * count + j), per_depth, low, per_share)
        store(t, SHARE * count + j, share)
        store(t, HEFT * count + j, heft)
        store(t, HEFT_SLOPE * count + j, slope)
        store(t, X * count + j, (wavelength_nm[j] - middle) * per_half)
