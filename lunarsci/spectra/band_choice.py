"""Under which continuum each of eight spectra shows a band, if any: what is against one, and the next to be tried."""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, highest, load, lowest, spread, store
from lunarsci.spectra.band_polynomial import (
    CURVE,
    FOUND,
    HALF_NM,
    INNER,
    LOWEST,
    MIDDLE_NM,
    OWN,
    OWN_NODE,
    OWN_WEIGHT,
    PER_LEVEL,
    RATIO,
    BandWork,
    fit,
    minima,
)
from lunarsci.spectra.band_shape import CENTER_VARIANCE, DEPTH_VARIANCE, HAS_SHAPE, OF_CHOICE, SHAPE_DEPTH, SHAPE_NM
from lunarsci.spectra.band_slopes import BandGrid
from lunarsci.spectra.band_status import (
    AWAY,
    BELOW,
    CONTINUUM,
    CROSSING_SHARE,
    DEEPEST,
    ELSEWHERE,
    END_CHANNELS,
    FALLS,
    FEW,
    MAX_CENTER_SIGMA_NM,
    MIN_SIGNIFICANCE,
    NO_MINIMUM,
    NOTE,
    NOTE_DEEPEST,
    OK,
    RUNAWAY_SHARE,
    SHALLOW,
    STATUS,
    UNCERTAIN,
    Codes,
)
from lunarsci.spectra.band_window import LEAST_DEPTH, WIDE, deepest_of, window_of
from lunarsci.spectra.continuum import CONIC, HULL, LEVEL, NODE, TERMS, WEIGHT
from lunarsci.spectra.lane_rows import uncounted

(TRIED, IS_CONIC, IS_HULL, CODE, DEEPEST_NM, OTHER_NM, CHOICES) = (OF_CHOICE + k for k in (0, 1, 2, 3, 6, 9, 12))
"""Rows, behind those of `band_shape`: place in the order of the continuum that is tried, below 0 for none; which one
that is; by continuum what is against it, where the band is deepest and its centre in the wide window. [nm]"""


class Places(NamedTuple):
    """Where the bands lie among the channels.

    Attributes
    ----------
    bands : of each, its first channel and the one behind its last, and the same of where its deepest may lie, (2, 4).
    limits_nm, bias, least : where its centre may lie, (2, 2); see `Band`, (2,), (2,). [nm, -, -]
    wanted : place of the wanted continuum in `CONTINUA`.
    missing : a code of `STATUSES` where the channels cannot show it, else 0, (2,).
    order : continua in the order in which they are tried, (3,), -1 for none.
    low, high : first channel of all bands, and the one behind the last.
    """

    bands: IntArray
    limits_nm: FloatArray
    bias: FloatArray
    least: FloatArray
    wanted: int
    missing: IntArray
    order: IntArray
    low: int
    high: int


@formula
def _code(least_level: Any, highest: Any, depth: Any, end: Any, inner: Any, nm: Any, low_nm: Any, high_nm: Any) -> Any:
    """Why a continuum is not fit for use over a band, or why there is no band under it; 0 for neither.

    Where the spectrum lies nowhere below the continuum it is deepest where both touch, which rounding decides.
    """
    nowhere = choose(highest - 1.0 > LEAST_DEPTH, BELOW, SHALLOW)
    above, between = least_level > 0.0, (nm > low_nm) & (nm < high_nm)
    crossing = choose(highest - 1.0 > depth * CROSSING_SHARE, BELOW, choose(end > depth * RUNAWAY_SHARE, AWAY, OK))
    found = choose(inner > 0.0, crossing, choose(between, FEW, ELSEWHERE))
    return choose(above, choose(depth < LEAST_DEPTH, nowhere, found), FALLS)


@uncounted
def judge(g: BandGrid, places: Places, work: BandWork, b: int, c: int) -> None:
    """What is against a continuum over a band, where the band is deepest under it, and its centre."""
    t, k, count, band = work.t, work.k, g.wavelength_nm.size, places.bands[b]
    least_level, above = load(t, (LEVEL + c) * count + band[0]), load(t, (CURVE + c) * count + band[0])
    for j in range(band[0] + 1, band[1]):
        least_level = lowest(least_level, load(t, (LEVEL + c) * count + j))
        above = highest(above, load(t, (CURVE + c) * count + j))
    least, place = deepest_of(t, CURVE + c, band[0], band[1], count)
    end = spread(-np.inf)
    if c == CONIC and band[1] == count:
        end = spread(0.0)
        for j in range(count - END_CHANNELS, count):
            end += (1.0 - load(t, (CURVE + c) * count + j)) * (1.0 / END_CHANNELS)
    store(k, DEEPEST_NM + c, place)
    for lane in range(LANES):
        k[DEEPEST_NM + c, lane] = g.wavelength_nm[int(k[DEEPEST_NM + c, lane])]
    first, behind = window_of(g, work, c, band, WIDE[0], WIDE[1], True)
    low, high = places.limits_nm[b]
    code = _code(least_level, above, 1.0 - least, end, load(k, INNER), load(k, DEEPEST_NM + c), low, high)
    store(k, CODE + c, code)
    store(k, OTHER_NM + c, centre(work, c, first, behind, count))


@uncounted
def centre(work: BandWork, own: int, first: int, behind: int, count: int) -> Any:
    """Centre in a window, NaN where there is none. [nm]"""
    k = work.k
    fit(work.t, k, RATIO + own, first, behind, count)
    minima(k)
    there = choose(load(k, INNER), load(k, FOUND), spread(0.0))
    return choose(there, load(k, MIDDLE_NM) + load(k, HALF_NM) * load(k, LOWEST), spread(np.nan))


@uncounted
def go_on(places: Places, k: Any, lane: int, found: FloatArray, codes: Codes) -> bool:
    """Turn to the next continuum that nothing is against, and say of the others what is; whether there is one."""
    for tried in range(int(k[TRIED, lane]) + 1, places.order.size):
        c = places.order[tried]
        if c < 0:
            break
        code = int(k[CODE + c, lane])
        if code == OK:
            k[TRIED, lane] = float(tried)
            return True
        record(places, k, lane, c, code, found, codes)
    k[TRIED, lane] = -2.0
    return False


@uncounted
def record(places: Places, k: Any, lane: int, c: int, code: int, found: FloatArray, codes: Codes) -> None:
    deepest = k[DEEPEST_NM + c, lane]
    if code == OK or c == HULL:
        codes[CONTINUUM], codes[STATUS], found[DEEPEST] = c, code, deepest
    if code != OK and c == places.wanted:
        codes[NOTE], found[NOTE_DEEPEST] = code, deepest


@formula
def _picked(conic: Any, hull: Any, first: Any, second: Any, third: Any) -> Any:
    return choose(conic, first, choose(hull, second, third))


@uncounted
def own_continuum(g: BandGrid, places: Places, work: BandWork) -> None:
    """Put what belongs to the continuum that each spectrum is tried under where `shape` looks for it."""
    t, k, count = work.t, work.k, g.wavelength_nm.size
    for lane in range(LANES):
        tried = int(k[TRIED, lane])
        c = places.order[tried] if tried >= 0 else HULL
        for term in range(TERMS):
            work.tie[OWN, term, lane] = work.tie[c, term, lane]
        k[IS_CONIC, lane], k[IS_HULL, lane] = 1.0 if c == CONIC else 0.0, 1.0 if c == HULL else 0.0
    conic, hull = load(k, IS_CONIC), load(k, IS_HULL)
    for j in range(count):
        store(t, OWN_NODE * count + j, load(t, NODE * count + j) * hull)
    for j in range(places.low, places.high):
        for row in (RATIO, CURVE, PER_LEVEL):
            at = row * count + j
            own = _picked(conic, hull, load(t, at), load(t, at + count), load(t, at + 2 * count))
            store(t, at + OWN * count, own)
        for term in range(TERMS):
            at = (WEIGHT + term) * count + j
            own = _picked(conic, hull, load(t, at), load(t, at + TERMS * count), load(t, at + 2 * TERMS * count))
            store(t, (OWN_WEIGHT + term) * count + j, own)


@uncounted
def verdict(limits_nm: FloatArray, k: Any, lane: int) -> int:
    """A code of the band that was measured."""
    center_nm, depth = k[SHAPE_NM, lane], k[SHAPE_DEPTH, lane]
    if not (k[HAS_SHAPE, lane] > 0.0 and limits_nm[0] <= center_nm <= limits_nm[1]):
        return NO_MINIMUM
    if depth < max(MIN_SIGNIFICANCE * math.sqrt(k[DEPTH_VARIANCE, lane]), LEAST_DEPTH):
        return SHALLOW
    return UNCERTAIN if math.sqrt(k[CENTER_VARIANCE, lane]) > MAX_CENTER_SIGMA_NM else OK
