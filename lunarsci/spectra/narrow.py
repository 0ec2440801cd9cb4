"""Narrow absorptions of water, hydroxyl and carbonates in the region of the 2 um band, which no pyroxene makes."""

import math

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.band_status import (
    CENTER,
    CONTINUUM,
    DEEPEST,
    DEPTH,
    NARROW_NM,
    NARROW_WIDTH,
    STATUS,
    TOO_NARROW,
    Codes,
)

CENTRES_NM, WIDTHS_NM = (
    np.concatenate([np.arange(1850.0, 1995.0, 10.0), np.arange(2140.0, 2405.0, 10.0)]),
    np.array([40.0, 60.0, 80.0, 105.0, 135.0, 170.0, 205.0]),
)
"""Where they are sought, and full widths at half maximum that are tried. Water absorbs at 1900-1950 nm, hydroxyl and
carbonates at 2200-2350 nm (Hunt 1977, 10.1190/1.1440721); bands of pyroxenes at 2 um are 570 nm wide and more
(`mgm_bands.csv`). [nm]"""
WINDOW_NM, SHORTEST_NM, DEGREE, FEWEST = 220.0, 70.0, 3, 10
"""A Gaussian on a cubic in ln R so far to both sides, or so far at least, and channels that it takes; assumed. A cubic
follows the floor of a band 500 nm wide to 2 % of its depth. [nm]"""
WIDEST_NM = 135.0
"""Wider ones are not called narrow: what a cubic leaves of a wide band looks like a Gaussian of 170 nm and more;
assumed, on spectra of pyroxenes (RELAB). [nm]"""
EXPLAINED = 0.5
"""Least share of what the cubic leaves, sum of squares, that the Gaussian takes away; assumed. It takes 0.3 at
most in 57 Chang'E-4 spectra with a 2 um band, whose scatter makes sharp dips."""
SIGNIFICANT = 6.0
"""Least strength of the Gaussian over its standard error, which decides where channels are few; assumed, as the most of
several hundred that are tried counts."""
NEAR_NM = 80.0
"""How far from the centre of a band it may lie; assumed: smoothing over 205 nm moves the centre of a sharp one."""
OWN_SHARE, BESIDE_SHARE = 0.5, 0.15
"""Shares of the depth of a band, in ln R, from which it makes the band, and from which it is said to be beside it.

Half is where it is more of the band than anything else. Looked at on every second sample series of RELAB, counted on
the others (`tests/spectra/test_narrow.py`): of 25 such bands of olivines and plagioclases without pyroxene it makes 15,
of 80 bands with 10 vol % of pyroxene or more 1. 0.15 is assumed."""


def narrow_absorptions(
    wavelength_nm: FloatArray, reflectance: FloatArray, center_nm: FloatArray, depth: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The narrow absorption nearest in shape to a Gaussian in ln R beside the centre of each 2 um band.

    Parameters
    ----------
    wavelength_nm, reflectance : (n,) ascending, and (m, n) above 0. [nm, -]
    center_nm, depth : of the 2 um bands, (m,). [nm, -]

    Returns
    -------
    Its centre and full width at half maximum, NaN where there is none, and its share of the depth of the band, (m,).
    [nm, nm, -]
    """
    ln, whole = np.log(reflectance), -np.log1p(-np.clip(depth, 0.0, 0.999))
    place, width, share, best = (np.full(len(ln), value) for value in (np.nan, np.nan, 0.0, EXPLAINED))
    widths = WIDTHS_NM[2.0 * np.median(np.diff(wavelength_nm)) <= WIDTHS_NM]
    for centre in CENTRES_NM:
        rows = np.flatnonzero(np.abs(center_nm - centre) <= NEAR_NM)
        inside = np.abs(wavelength_nm - centre) <= WINDOW_NM
        x = wavelength_nm[inside] - centre
        if not rows.size or not widths.size or x.size < FEWEST or x[0] > -SHORTEST_NM or x[-1] < SHORTEST_NM:
            continue
        cubic, _ = np.linalg.qr(np.vander(x / WINDOW_NM, DEGREE + 1))
        left = ln[np.ix_(rows, inside)]
        left -= (left @ cubic) @ cubic.T
        shapes = np.exp(-4.0 * math.log(2.0) * (x / widths[:, None]) ** 2)
        shapes -= (shapes @ cubic) @ cubic.T
        size = (shapes**2).sum(axis=1)
        strength = -(left @ shapes.T) / size
        explained = np.where(strength > 0, strength**2 * size, 0.0) / np.maximum((left**2).sum(axis=1), 1e-300)[:, None]
        k = explained.argmax(axis=1)
        own = explained[np.arange(rows.size), k]
        free = x.size - DEGREE - 2
        better = own > np.maximum(best[rows], SIGNIFICANT**2 / (SIGNIFICANT**2 + free))
        to, k, at = rows[better], k[better], np.flatnonzero(better)
        best[to], place[to], width[to], share[to] = own[at], centre, widths[k], strength[at, k] / whole[to]
    narrow = (width <= WIDEST_NM) & (share >= BESIDE_SHARE)
    return np.where(narrow, place, np.nan), np.where(narrow, width, np.nan), np.where(narrow, share, 0.0)


def judge_width(wavelength_nm: FloatArray, reflectance: FloatArray, numbers: FloatArray, codes: Codes) -> None:
    """Take away each 2 um band that a narrow absorption makes, and note the narrow ones within others.

    Parameters
    ----------
    wavelength_nm, reflectance : (n,) and (m, n). [nm, -]
    numbers, codes : of the 2 um bands, `QUANTITIES` (m, 18) and `CODES` (m, 3), which change.
    """
    seen = np.flatnonzero(codes[:, CONTINUUM] >= 0)
    if not seen.size:
        return
    values = np.asarray(reflectance[seen], float)
    at, width, share = narrow_absorptions(wavelength_nm, values, numbers[seen, CENTER], numbers[seen, DEPTH])
    numbers[seen, NARROW_NM], numbers[seen, NARROW_WIDTH] = at, width
    gone = seen[share >= OWN_SHARE]
    numbers[gone, :DEEPEST], codes[gone, CONTINUUM], codes[gone, STATUS] = np.nan, -1, TOO_NARROW
