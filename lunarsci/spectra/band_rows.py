"""The 1 um and 2 um bands of many spectra on the same channels: under which continuum, and whether there is a band."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.compiled import each_in_threads
from lunarsci.spectra.band_polynomial import (
    AREA,
    CURVE,
    LEVEL,
    NOISE,
    PER_LEVEL,
    RATIO,
    ROWS,
    SMOOTHED,
    STEPS,
    VALUES,
    WAVELENGTH,
    WEIGHT,
    WIDE_DEPTH,
    WIDE_NM,
    kernel,
)
from lunarsci.spectra.band_shape import (
    LEAST_DEPTH,
    NOTHING,
    WIDE,
    Shape,
    Smoother,
    centre,
    gaussian_centre,
    shape,
    smooth,
    window_of,
)
from lunarsci.spectra.band_status import (
    AREA_CALIBRATION,
    AREA_NM,
    AREA_SIGMA,
    ASYMMETRY_SHARE,
    ASYMMETRY_SIGMA,
    AWAY,
    BANDS,
    BELOW,
    CENTER,
    CENTER_CALIBRATION,
    CENTER_SIGMA,
    CODES,
    CONTINUUM,
    CROSSING_SHARE,
    DEEPEST,
    DEPTH,
    DEPTH_CALIBRATION,
    DEPTH_SIGMA,
    ELSEWHERE,
    END_CHANNELS,
    FALLS,
    FEW,
    MAX_CENTER_SIGMA_NM,
    METHOD,
    MIN_SIGNIFICANCE,
    NO_MINIMUM,
    NO_TIES,
    NOT_COVERED,
    NOTE,
    NOTE_DEEPEST,
    OK,
    QUANTITIES,
    RUNAWAY_SHARE,
    SHALLOW,
    SPARSE,
    STATUS,
    SYSTEMATIC,
    UNCERTAIN,
    UNUSABLE,
    Band,
    Codes,
)
from lunarsci.spectra.continuum import (
    CONIC,
    CONTINUA,
    HULL,
    LINEAR,
    TERMS,
    Indices,
    Ties,
    level_under,
    tie_down,
    ties_of,
)
from lunarsci.spectra.noise import scatter_noise_rows
from lunarsci.spectra.spectrum import smoothing_operator

FEWEST_IN_WINDOW = 14
CHUNK = 256
"""Spectra that a thread takes at a time."""
SAME_NM = 1e-6
"""Centres closer than this are those of the same tie points."""
LEAST_SIGNAL = 0.01
"""Share of the brightest channel that stands for a darker one where noise is that of photons; assumed."""


class Places(NamedTuple):
    """Where the bands lie among the channels.

    Attributes
    ----------
    bands : of each, its first channel and the one behind its last, and the same of where its deepest may lie, (2, 4).
    limits_nm, bias : where its centre may lie, (2, 2); see `Band`, (2,). [nm, -]
    wanted : place of the wanted continuum in `CONTINUA`.
    missing : a code of `STATUSES` where the channels cannot show it, else 0, (2,).
    order : continua in the order in which they are tried, (3,), -1 for none.
    """

    bands: IntArray
    limits_nm: FloatArray
    bias: FloatArray
    wanted: int
    missing: IntArray
    order: IntArray


class BandGrid(NamedTuple):
    """What spectra on the same n channels share: channels and their gradient, (n,) [nm], smoothing, and ties."""

    wavelength_nm: FloatArray
    steps_nm: FloatArray
    smoother: Smoother
    ties: Ties


def grid_of(wavelength_nm: FloatArray, width_nm: float, order: int) -> BandGrid:
    """What spectra on these ascending channels share, smoothed over so many nm with a polynomial of this order."""
    operator = smoothing_operator(wavelength_nm, width_nm, order)
    used = operator != 0
    first = np.argmax(used, axis=1)
    width = int((wavelength_nm.size - np.argmax(used[:, ::-1], axis=1) - first).max())
    first = np.minimum(first, wavelength_nm.size - width)
    weights = np.take_along_axis(operator, first[:, None] + np.arange(width), axis=1)
    return BandGrid(
        wavelength_nm,
        np.gradient(wavelength_nm),
        Smoother(first, np.ascontiguousarray(weights)),
        ties_of(wavelength_nm),
    )


def places_of(grid: BandGrid, wanted: int) -> Places:
    """Where the bands lie among these channels, and the continua to try, the wanted one first."""
    wavelength = grid.wavelength_nm
    bands = [[*_range(wavelength, band.window_nm), *_range(wavelength, band.centre_nm)] for band in BANDS]
    missing = [_missing(wavelength[low:high], band) for (low, high, _, _), band in zip(bands, BANDS, strict=True)]
    order = [c for c in dict.fromkeys((wanted, HULL, LINEAR)) if grid.ties.available[c]]
    order += [-1] * (len(CONTINUA) - len(order))
    limits = np.array([band.centre_nm for band in BANDS])
    bias = np.array([band.bias for band in BANDS])
    codes = np.array(missing, np.int64), np.array(order, np.int64)
    return Places(np.array(bands, np.int64), limits, bias, wanted, *codes)


def _range(wavelength_nm: FloatArray, limits_nm: tuple[float, float]) -> tuple[int, int]:
    low, high = limits_nm
    return int(np.searchsorted(wavelength_nm, low)), int(np.searchsorted(wavelength_nm, high, side="right"))


def _missing(inside_nm: FloatArray, band: Band) -> int:
    if inside_nm.size < FEWEST_IN_WINDOW:
        return SPARSE
    return NOT_COVERED if inside_nm[0] > band.reach_nm[0] or inside_nm[-1] < band.reach_nm[1] else OK


def measure_rows(
    grid: BandGrid,
    wanted: int,
    reflectance: Any,
    sigma: FloatArray | None,
    shifts: FloatArray,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, Codes]:
    """Measure both bands of spectra on the same channels.

    Parameters
    ----------
    wanted : place of the continuum in `CONTINUA`.
    reflectance : (m, n), above 0. [-]
    sigma : one standard deviation, (m, n) or (n,); None to find it from the scatter of the channels. [-]
    shifts : errors that all channels share, (m, k, n), k may be 0. [-]

    Returns
    -------
    `QUANTITIES`, (m, 2, 15), NaN where there is none, and `CODES`, (m, 2, 3).
    """
    count, places = len(reflectance), places_of(grid, wanted)
    numbers, codes = nothing_of(count)

    def work(chunk: int) -> None:
        rows = slice(chunk * CHUNK, min((chunk + 1) * CHUNK, count))
        own = np.ascontiguousarray(reflectance[rows], float)
        smoothed = np.empty_like(own)
        _smooth_rows(grid.smoother, own, smoothed)
        given = _noise(own, smoothed) if sigma is None else sigma[rows] if sigma.ndim > 1 else sigma
        noise = np.ascontiguousarray(np.broadcast_to(given, own.shape), float)
        tie, s = np.zeros((TERMS * len(CONTINUA) + 1, own.shape[1]), np.int64), np.zeros((ROWS, own.shape[1]))
        s[WAVELENGTH], s[STEPS] = grid.wavelength_nm, grid.steps_nm
        of = (own, smoothed, noise, np.ascontiguousarray(shifts[rows]))
        _measure(grid.smoother, grid.ties, places, *of, tie, s, numbers[rows], codes[rows])

    each_in_threads(work, -(-count // CHUNK), progress)
    return numbers, codes


def nothing_of(count: int) -> tuple[FloatArray, Codes]:
    """What `measure_rows` gives of so many spectra that cannot be measured."""
    codes = np.zeros((count, len(BANDS), len(CODES)), np.int8)
    codes[..., CONTINUUM], codes[..., STATUS] = -1, UNUSABLE
    return np.full((count, len(BANDS), len(QUANTITIES)), np.nan), codes


def _noise(values: FloatArray, smoothed: FloatArray) -> FloatArray:
    """Scatter of the channels, taken to follow the root of the signal as that of photons does, (m, n)."""
    root = np.sqrt(np.maximum(smoothed, LEAST_SIGNAL * values.max(axis=1, keepdims=True)))
    return np.asarray(scatter_noise_rows(values / root) * root)


@kernel
def _smooth_rows(g: Smoother, values: FloatArray, smoothed: FloatArray) -> None:
    for row in range(values.shape[0]):
        smooth(g, values[row], smoothed[row])


@kernel
def _measure(
    g: Smoother, ties: Ties, places: Places, values: FloatArray, smoothed: FloatArray, noise: FloatArray,
    shifts: FloatArray, tie: Indices, s: FloatArray, found: FloatArray, codes: Codes,
) -> None:  # fmt: skip
    """`measure_rows` of some rows, into `found` and `codes`."""
    for row in range(values.shape[0]):
        for j in range(values.shape[1]):
            s[VALUES, j], s[SMOOTHED, j], s[NOISE, j] = values[row, j], smoothed[row, j], noise[row, j]
        for c in range(len(CONTINUA)):
            if ties.available[c]:
                _remove(ties, tie, s, c)
        for b in range(places.bands.shape[0]):
            _measure_band(g, ties.available, places, tie, s, b, shifts[row], found[row, b], codes[row, b])


@kernel
def _remove(ties: Ties, tie: Indices, s: FloatArray, c: int) -> None:
    """A continuum of the spectrum, and both ratios."""
    own = slice(TERMS * c, TERMS * c + TERMS)
    tie_down(
        c, ties, s[SMOOTHED], tie[own], s[WEIGHT + TERMS * c : WEIGHT + TERMS * c + TERMS], tie[TERMS * len(CONTINUA)]
    )
    level_under(s[SMOOTHED], tie[own], s[WEIGHT + TERMS * c : WEIGHT + TERMS * c + TERMS], s[LEVEL + c])
    for j in range(s.shape[1]):
        per_level = 1.0 / s[LEVEL + c, j] if s[LEVEL + c, j] > 0.0 else 1.0
        s[PER_LEVEL + c, j] = per_level
        s[RATIO + c, j] = s[VALUES, j] * per_level
        s[CURVE + c, j] = s[SMOOTHED, j] * per_level


@kernel
def _measure_band(
    g: Smoother,
    available: BoolArray,
    places: Places,
    tie: Indices,
    s: FloatArray,
    b: int,
    shifts: FloatArray,
    found: FloatArray,
    codes: IntArray,
) -> None:
    """One band, under the wanted continuum or the first that is fit for use."""
    codes[CONTINUUM], codes[STATUS], codes[NOTE] = -1, places.missing[b], OK
    if places.missing[b] != OK:
        return
    codes[NOTE] = NO_TIES if places.order[0] != places.wanted else OK
    for c in places.order:
        if c < 0:
            break
        code, deepest, one = _judged(g, places, tie, s, b, c)
        if code == OK or c == HULL:
            codes[CONTINUUM], codes[STATUS], found[DEEPEST] = c, code, deepest
        if code == OK:
            _fill(g, available, places, tie, s, b, c, one, shifts, found)
            return
        if c == places.wanted:
            codes[NOTE], found[NOTE_DEEPEST] = code, deepest


@kernel
def _judged(g: Smoother, places: Places, tie: Indices, s: FloatArray, b: int, c: int) -> tuple[int, float, Shape]:
    """A band under a continuum: a code, where it is deepest [nm], and its shape, if the code is 0."""
    band = places.bands[b]
    objection, deepest = _objection(s, c, band)
    deepest_nm = s[WAVELENGTH, deepest]
    low, high = places.limits_nm[b]
    w = window_of(s, c, band, WIDE[0], WIDE[1], True)
    if objection != FALLS and not w.inner:
        return FEW if low < deepest_nm < high else ELSEWHERE, deepest_nm, Shape(False, *NOTHING)
    if objection != OK:
        return objection, deepest_nm, Shape(False, *NOTHING)
    one = shape(g, tie, s, c, band, places.bias[b], w)
    if not (one.found and low <= one.center_nm <= high):
        return NO_MINIMUM, deepest_nm, one
    if one.depth < max(MIN_SIGNIFICANCE * one.depth_sigma, LEAST_DEPTH):
        return SHALLOW, deepest_nm, one
    return UNCERTAIN if one.center_sigma_nm > MAX_CENTER_SIGMA_NM else OK, deepest_nm, one


@kernel
def _objection(s: FloatArray, c: int, band: IntArray) -> tuple[int, int]:
    """Why a continuum is not fit for use over a band, or 0; the channel where the smoothed ratio is lowest."""
    highest, deepest, above = -math.inf, band[0], True
    for j in range(band[0], band[1]):
        above = above and s[LEVEL + c, j] > 0.0
        highest = max(highest, s[CURVE + c, j])
        if s[CURVE + c, j] < s[CURVE + c, deepest]:
            deepest = j
    depth, end, size = 1.0 - s[CURVE + c, deepest], 0.0, s.shape[1]
    if not above:
        return FALLS, deepest
    if highest - 1.0 > CROSSING_SHARE * depth:
        return BELOW, deepest
    if c == CONIC and band[1] == size:
        for j in range(size - END_CHANNELS, size):
            end += (1.0 - s[CURVE + c, j]) / END_CHANNELS
        if end > RUNAWAY_SHARE * depth:
            return AWAY, deepest
    return OK, deepest


@kernel
def _fill(
    g: Smoother,
    available: BoolArray,
    places: Places,
    tie: Indices,
    s: FloatArray,
    b: int,
    c: int,
    one: Shape,
    shifts: FloatArray,
    found: FloatArray,
) -> None:
    """The numbers of a band that is there, with what other continua and another definition of the centre differ by."""
    found[CENTER], found[CENTER_SIGMA], found[DEPTH], found[DEPTH_SIGMA] = (
        one.center_nm, one.center_sigma_nm, one.depth, one.depth_sigma
    )  # fmt: skip
    found[AREA_NM], found[AREA_SIGMA], found[ASYMMETRY_SHARE], found[ASYMMETRY_SIGMA] = (
        one.area_nm, one.area_sigma_nm, one.asymmetry, one.asymmetry_sigma
    )  # fmt: skip
    if shifts.shape[0] > 0:
        found[CENTER_CALIBRATION] = _shared(s, WIDE_NM, shifts)
        found[DEPTH_CALIBRATION] = _shared(s, WIDE_DEPTH, shifts)
        found[AREA_CALIBRATION] = _shared(s, AREA, shifts)
    lowest = highest = one.wide_nm
    for other in range(len(CONTINUA)):
        if other != c and available[other]:
            there = centre(g, tie, s, other, places.bands[b])
            if not math.isnan(there):
                lowest, highest = min(lowest, there), max(highest, there)
    if highest - lowest > SAME_NM:
        found[SYSTEMATIC] = (highest - lowest) / 2.0
    found[METHOD] = abs(gaussian_centre(s, c, places.bands[b]) - one.center_nm) / 2.0


@kernel
def _shared(s: FloatArray, row: int, shifts: FloatArray) -> float:
    """Standard deviation of a quantity, its derivatives in a row, from errors that shift all channels, (k, n)."""
    total = 0.0
    for k in range(shifts.shape[0]):
        moved = 0.0
        for j in range(s.shape[1]):
            moved += s[row, j] * shifts[k, j]
        total += moved * moved
    return math.sqrt(total)
