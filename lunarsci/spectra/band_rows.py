"""The 1 um and 2 um bands of many spectra on the same channels: under which continuum, and whether there is a band."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import each_in_threads
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import aligned, choose, highest, load, root, spread, store
from lunarsci.spectra.band_choice import CHOICES, OTHER_NM, TRIED, Places, go_on, judge, own_continuum, record, verdict
from lunarsci.spectra.band_polynomial import (
    AREA,
    COEFFICIENTS,
    CURVE,
    FOUND,
    HALF_NM,
    HEFT,
    INNER,
    LOWEST,
    MIDDLE_NM,
    NOISE,
    ONTO,
    PER_LEVEL,
    RATIO,
    ROWS,
    SIZE,
    SPARE,
    VALUES,
    WIDE_DEPTH,
    WIDE_NM,
    BandWork,
    X,
    fit,
    minima,
)
from lunarsci.spectra.band_shape import (
    AREA_VARIANCE,
    ASYMMETRY_VARIANCE,
    CENTER_VARIANCE,
    DEPTH_VARIANCE,
    GAUSSIAN_NM,
    SHAPE_AREA,
    SHAPE_ASYMMETRY,
    SHAPE_DEPTH,
    SHAPE_NM,
    WIDE_CENTER_NM,
    shape,
)
from lunarsci.spectra.band_slopes import BandGrid, Smoother, smooth
from lunarsci.spectra.band_status import (
    ABSENT_NM,
    AREA_CALIBRATION,
    AREA_NM,
    AREA_SIGMA,
    ASYMMETRY_SHARE,
    ASYMMETRY_SIGMA,
    BANDS,
    CENTER,
    CENTER_CALIBRATION,
    CENTER_SIGMA,
    CODES,
    CONTINUUM,
    DEPTH,
    DEPTH_CALIBRATION,
    DEPTH_SIGMA,
    GAUSSIAN,
    METHOD,
    NO_BAND,
    NO_TIES,
    NOT_COVERED,
    NOTE,
    OK,
    QUANTITIES,
    SPARSE,
    STATUS,
    SYSTEMATIC,
    UNUSABLE,
    Band,
    Codes,
    short_by,
)
from lunarsci.spectra.band_window import NARROW, WIDE, window_of
from lunarsci.spectra.continuum import CONTINUA, HULL, LEVEL, LINEAR, SMOOTHED, tables_of, tie_down, ties_of
from lunarsci.spectra.lane_rows import take_eight, uncounted
from lunarsci.spectra.noise import WINDOW, running_medians
from lunarsci.spectra.spectrum import reaches_over, smoothing_operator

FEWEST_IN_WINDOW = 14


CHUNK = 512
"""Spectra that a thread takes at a time; a multiple of `LANES`."""


SAME_NM = 1e-6
"""Centres closer than this are those of the same tie points."""


DRAWN = 161
"""Points of a curve that is drawn."""


LEAST_SIGNAL = 0.01
"""Share of the brightest channel that stands for a darker one where noise is that of photons; assumed."""


def grid_of(wavelength_nm: FloatArray, width_nm: float, order: int) -> BandGrid:
    """What spectra on these ascending channels share, smoothed over so many nm with a polynomial of this order."""
    operator = smoothing_operator(wavelength_nm, width_nm, order)
    steps = np.gradient(wavelength_nm)
    return BandGrid(wavelength_nm, steps, _banded(operator), _banded(operator.T), ties_of(wavelength_nm))


def _banded(operator: FloatArray) -> Smoother:
    used = operator != 0
    first, size = np.argmax(used, axis=1), len(operator)
    width = int((size - np.argmax(used[:, ::-1], axis=1) - first).max())
    first = np.minimum(first, size - width)
    weights = np.take_along_axis(operator, first[:, None] + np.arange(width), axis=1)
    return Smoother(first, np.ascontiguousarray(weights))


def places_of(grid: BandGrid, wanted: int) -> Places:
    """Where the bands lie among these channels, and the continua to try, the wanted one first."""
    wavelength = grid.wavelength_nm
    bands = [[*_range(wavelength, band.window_nm), *_range(wavelength, band.centre_nm)] for band in BANDS]
    missing = [_missing(wavelength[low:high], band) for (low, high, _, _), band in zip(bands, BANDS, strict=True)]
    order = [c for c in dict.fromkeys((wanted, HULL, LINEAR)) if grid.ties.available[c]]
    order += [-1] * (len(CONTINUA) - len(order))
    limits = np.array([band.centre_nm for band in BANDS])
    bias, least = np.array([(band.bias, band.least) for band in BANDS]).T.copy()
    codes = np.array(missing, np.int64), np.array(order, np.int64)
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return Places(np.array(bands, np.int64), limits, bias, least, wanted, *codes, low, high)


def _range(wavelength_nm: FloatArray, limits_nm: tuple[float, float]) -> tuple[int, int]:
    low, high = limits_nm
    return int(np.searchsorted(wavelength_nm, low)), int(np.searchsorted(wavelength_nm, high, side="right"))


def _missing(inside_nm: FloatArray, band: Band) -> int:
    if inside_nm.size < FEWEST_IN_WINDOW:
        return SPARSE
    return OK if reaches_over(inside_nm, *band.reach_nm) else NOT_COVERED


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
    `QUANTITIES`, (m, 2, 18), NaN where there is none, and `CODES`, (m, 2, 3).
    """
    count, places = len(reflectance), places_of(grid, wanted)
    numbers, codes = nothing_of(count)

    def work(chunk: int) -> None:
        rows = slice(chunk * CHUNK, min((chunk + 1) * CHUNK, count))
        own = np.ascontiguousarray(reflectance[rows], float)
        given = np.empty((0, own.shape[1])) if sigma is None else sigma[rows] if sigma.ndim > 1 else sigma
        noise = given if sigma is None else np.ascontiguousarray(np.broadcast_to(given, own.shape), float)
        _measure(grid, places, own, noise, np.ascontiguousarray(shifts[rows]), _work(grid), numbers[rows], codes[rows])
        if grid.wavelength_nm[-1] < ABSENT_NM:
            two = codes[rows, -1, STATUS]
            two[np.isin(two, NO_BAND)] = NOT_COVERED
        found = numbers[rows, -1]
        found[:, METHOD] = np.fmax(found[:, METHOD], short_by(found[:, CENTER], float(grid.wavelength_nm[-1])))

    each_in_threads(work, -(-count // CHUNK), progress)
    return numbers, codes


def _work(grid: BandGrid) -> BandWork:
    t, tie, nodes, own = tables_of(grid.ties, ROWS)
    return BandWork(t, aligned(CHOICES), np.concatenate([tie, tie[:1]]), nodes, own)


def curve_of_centre(
    grid: BandGrid, reflectance: FloatArray, continuum_name: str, band: Band, center_nm: float
) -> tuple[FloatArray, FloatArray]:
    """The curve whose minimum is the centre of a band of one spectrum: both polynomials, joined as their centres were.

    Returns
    -------
    Wavelengths of the narrow window, or the wide one where that alone counts, and reflectance over continuum. [nm, -]
    """
    work, c, count = _work(grid), CONTINUA.index(continuum_name), grid.wavelength_nm.size
    t, own = (
        work.t,
        np.array([*_range(grid.wavelength_nm, band.window_nm), *_range(grid.wavelength_nm, band.centre_nm)]),
    )
    take_eight(np.ascontiguousarray(reflectance[None], float), 0, t, VALUES * count)
    smooth(grid.smoother, t, VALUES * count, SMOOTHED * count)
    tie_down(c, grid.ties, t, work.tie[c], work.nodes, work.own)
    _remove(t, c, own[0], own[1], count)
    wide, narrow = (_polynomial(grid, work, c, own, shares) for shares in (WIDE, NARROW))
    if not narrow.found or abs(wide.center_nm - narrow.center_nm) < SAME_NM:
        return wide.nm, wide.value(wide.nm)
    part = float(np.clip((center_nm - narrow.center_nm) / (wide.center_nm - narrow.center_nm), 0.0, 1.0))
    nm = wide.nm if part == 1.0 else narrow.nm
    return nm, part * wide.value(nm) + (1 - part) * narrow.value(nm)


class _Polynomial(NamedTuple):
    """A polynomial in a window: where its channels count half or more, its minimum, whether there is one. [nm]"""

    nm: FloatArray
    center_nm: float
    found: bool
    middle_nm: float
    half_nm: float
    coefficients: FloatArray

    def value(self, nm: FloatArray) -> FloatArray:
        return np.asarray(np.polynomial.polynomial.polyval((nm - self.middle_nm) / self.half_nm, self.coefficients))


def _polynomial(grid: BandGrid, work: BandWork, c: int, own: Any, shares: tuple[float, float]) -> _Polynomial:
    t, k, count = work.t, work.k, grid.wavelength_nm.size
    first, behind = window_of(grid, work, c, own, *shares, shares == WIDE)
    fit(t, k, RATIO + c, first, behind, count)
    minima(k)
    middle, half = float(k[MIDDLE_NM, 0]), float(k[HALF_NM, 0])
    counting = grid.wavelength_nm[first:behind][t[HEFT * count + first : HEFT * count + behind, 0] >= 0.5]
    found = bool(k[INNER, 0] > 0 and k[FOUND, 0] > 0)
    coefficients = k[COEFFICIENTS : COEFFICIENTS + SIZE, 0].copy()
    nm = np.linspace(counting[0], counting[-1], DRAWN)
    return _Polynomial(nm, middle + half * float(k[LOWEST, 0]), found, middle, half, coefficients)


def nothing_of(count: int) -> tuple[FloatArray, Codes]:
    """What `measure_rows` gives of so many spectra that cannot be measured."""
    codes = np.zeros((count, len(BANDS), len(CODES)), np.int8)
    codes[..., CONTINUUM], codes[..., STATUS] = -1, UNUSABLE
    return np.full((count, len(BANDS), len(QUANTITIES)), np.nan), codes


@uncounted
def _measure(
    g: BandGrid, places: Places, values: FloatArray, noise: FloatArray, shifts: FloatArray, work: BandWork,
    found: FloatArray, codes: Codes,
) -> None:  # fmt: skip
    """`measure_rows` of some rows, into `found` and `codes`; noise of no rows is found from the scatter."""
    t, count, low, high = work.t, g.wavelength_nm.size, places.low, places.high
    for begin in range(0, len(values), LANES):
        take_eight(values, begin, t, VALUES * count)
        smooth(g.smoother, t, VALUES * count, SMOOTHED * count)
        if len(noise) > 0:
            take_eight(noise, begin, t, NOISE * count)
        else:
            _noise(t, count)
        for c in range(len(CONTINUA)):
            if g.ties.available[c]:
                tie_down(c, g.ties, t, work.tie[c], work.nodes, work.own)
                _remove(t, c, low, high, count)
        for b in range(len(places.bands)):
            _measure_band(
                g, places, work, b, shifts[begin:], found[begin : begin + LANES], codes[begin : begin + LANES]
            )


@uncounted
def _noise(t: Any, count: int) -> None:
    """Scatter of the channels, taken to follow the root of the signal as that of photons does."""
    brightest = load(t, VALUES * count)
    for j in range(1, count):
        brightest = highest(brightest, load(t, VALUES * count + j))
    for j in range(count):
        signal = root(highest(load(t, SMOOTHED * count + j), brightest * LEAST_SIGNAL))
        store(t, SPARE * count + j, signal)
        store(t, X * count + j, load(t, VALUES * count + j) / signal)
    running_medians(t, X * count, NOISE * count, count, WINDOW, t[ONTO * count :], t[WIDE_NM * count :])
    for j in range(count):
        store(t, NOISE * count + j, load(t, NOISE * count + j) * load(t, SPARE * count + j))


@uncounted
def _remove(t: Any, c: int, low: int, high: int, count: int) -> None:
    """Both ratios to a continuum at some channels."""
    for j in range(low, high):
        level = load(t, (LEVEL + c) * count + j)
        per_level = choose(level, 1.0 / level, spread(1.0))
        store(t, (PER_LEVEL + c) * count + j, per_level)
        store(t, (RATIO + c) * count + j, load(t, VALUES * count + j) * per_level)
        store(t, (CURVE + c) * count + j, load(t, SMOOTHED * count + j) * per_level)


@uncounted
def _measure_band(
    g: BandGrid, places: Places, work: BandWork, b: int, shifts: FloatArray, found: FloatArray, codes: Codes
) -> None:
    """One band of eight spectra, each under the wanted continuum or the first that is fit for use."""
    k, open_ = work.k, places.missing[b] == OK
    for c in range(len(CONTINUA)):
        if open_ and g.ties.available[c]:
            judge(g, places, work, b, c)
    waiting = False
    for lane in range(LANES):
        k[TRIED, lane] = -1.0
        if lane < len(found):
            own = codes[lane, b]
            own[CONTINUUM], own[STATUS], own[NOTE] = -1, places.missing[b], OK
            if open_:
                own[NOTE] = NO_TIES if places.order[0] != places.wanted else OK
                waiting = go_on(places, k, lane, found[lane, b], own) or waiting
    while waiting:
        waiting = False
        own_continuum(g, places, work)
        shape(g, work, places.bands[b], places.bias[b], places.least[b])
        for lane in range(len(found)):
            tried = int(k[TRIED, lane])
            if tried >= 0:
                c, code = places.order[tried], verdict(places.limits_nm[b], k, lane)
                record(places, k, lane, c, code, found[lane, b], codes[lane, b])
                if code == OK:
                    _fill(g, work, lane, c, shifts[lane], found[lane, b])
                    k[TRIED, lane] = -2.0
                else:
                    waiting = go_on(places, k, lane, found[lane, b], codes[lane, b]) or waiting


@uncounted
def _fill(g: BandGrid, work: BandWork, lane: int, c: int, shifts: FloatArray, found: FloatArray) -> None:
    """The numbers of a band that is there, with what other continua and another definition of the centre differ by."""
    k = work.k
    found[CENTER], found[DEPTH] = k[SHAPE_NM, lane], k[SHAPE_DEPTH, lane]
    found[AREA_NM], found[ASYMMETRY_SHARE] = k[SHAPE_AREA, lane], k[SHAPE_ASYMMETRY, lane]
    found[CENTER_SIGMA], found[DEPTH_SIGMA] = math.sqrt(k[CENTER_VARIANCE, lane]), math.sqrt(k[DEPTH_VARIANCE, lane])
    found[AREA_SIGMA], found[ASYMMETRY_SIGMA] = (
        math.sqrt(k[AREA_VARIANCE, lane]),
        math.sqrt(k[ASYMMETRY_VARIANCE, lane]),
    )
    if shifts.shape[0] > 0:
        found[CENTER_CALIBRATION] = _shared(work.t, WIDE_NM, lane, shifts)
        found[DEPTH_CALIBRATION] = _shared(work.t, WIDE_DEPTH, lane, shifts)
        found[AREA_CALIBRATION] = _shared(work.t, AREA, lane, shifts)
    least = most = k[WIDE_CENTER_NM, lane]
    for other in range(len(CONTINUA)):
        there = k[OTHER_NM + other, lane]
        if other != c and g.ties.available[other] and not math.isnan(there):
            least, most = min(least, there), max(most, there)
    if most - least > SAME_NM:
        found[SYSTEMATIC] = (most - least) / 2.0
    found[GAUSSIAN] = abs(k[GAUSSIAN_NM, lane] - k[SHAPE_NM, lane]) / 2.0
    found[METHOD] = np.fmax(found[SYSTEMATIC], found[GAUSSIAN])


@uncounted
def _shared(t: Any, row: int, lane: int, shifts: FloatArray) -> float:
    """Standard deviation of a quantity, its derivatives in rows, from errors that shift all channels, (k, n)."""
    total = 0.0
    for error in range(shifts.shape[0]):
        moved = 0.0
        for j in range(shifts.shape[1]):
            moved += t[row * shifts.shape[1] + j, lane] * shifts[error, j]
        total += moved * moved
    return math.sqrt(total)
