"""The 1 um and 2 um absorption bands of spectra: their numbers, for one spectrum and for many.

What is measured, and what is in its errors, is in `lunarsci.spectra.band_shape`; here is under which continuum, and
whether there is a band at all.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled import each_in_threads
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import aligned, choose, highest, load, lowest, root, spread, store
from lunarsci.errors import DataError
from lunarsci.io import records
from lunarsci.parallel.blocks import arrays_in_blocks, rows_in_memory, saved_rows
from lunarsci.spectra import band_shape as ROW
from lunarsci.spectra.band_shape import (
    LEAST_DEPTH,
    NARROW,
    SIZE,
    WIDE,
    BandGrid,
    BandWork,
    Smoother,
    deepest_of,
    fit,
    minima,
    shape,
    smooth,
    window_of,
)
from lunarsci.spectra.band_status import (
    ABSENT_NM,
    BANDS,
    CODE,
    CROSSING_SHARE,
    DEPENDS,
    END_CHANNELS,
    JSON_KEYS,
    MAX_CENTER_SIGMA_NM,
    MEASURED,
    MIN_SIGNIFICANCE,
    NO_BAND,
    NO_PYROXENE,
    NUMBER,
    RUNAWAY_SHARE,
    STATUS,
    Band,
    BandArrays,
    BandColumns,
    BandResult,
    Codes,
    Places,
    channels_within,
    judge_width,
    narrow_text,
    nothing_of,
    places_of,
    sentence,
    short_by,
)
from lunarsci.spectra.collection import AlikeSpectra, SpectrumCollection, alike_channels
from lunarsci.spectra.continuum import (
    CONIC,
    CONTINUA,
    HULL,
    LEVEL,
    NODE,
    SMOOTHED,
    TERMS,
    WEIGHT,
    ContinuumName,
    continuum,
    tables_of,
    tie_down,
    ties_of,
)
from lunarsci.spectra.noise import WINDOW, running_medians, take_eight, uncounted_rows
from lunarsci.spectra.spectrum import Smoothing, Spectrum, smoothing_operator

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
    """An operator, (n, n), without the zeros on either side of its diagonal."""
    used = operator != 0
    first, size = np.argmax(used, axis=1), len(operator)
    width = int((size - np.argmax(used[:, ::-1], axis=1) - first).max())
    first = np.minimum(first, size - width)
    weights = np.take_along_axis(operator, first[:, None] + np.arange(width), axis=1)
    return Smoother(first, np.ascontiguousarray(weights))


(TRIED, IS_CONIC, IS_HULL, AGAINST, DEEPEST_NM, OTHER_NM, CHOICES) = (ROW.OF_CHOICE + k for k in (0, 1, 2, 3, 6, 9, 12))
"""Rows of `BandWork.scalars` behind those of `band_shape`, `CHOICES` in all.

* `TRIED`: place in `Places.order` of the continuum that is tried, -1 before the first, -2 when there is nothing to try.
* `IS_CONIC`, `IS_HULL`: 1 where it is that one, else 0.
* `AGAINST`, `DEEPEST_NM`, `OTHER_NM`, a row for each continuum: the code of what is against it, where the band is
  deepest under it, and the centre in the wide window. [-, nm, nm]
"""


@formula
def _code(least_level: Any, highest: Any, depth: Any, end: Any, inner: Any, nm: Any, low_nm: Any, high_nm: Any) -> Any:
    """Why a continuum is not fit for use over a band, or why there is no band under it; 0 for neither.

    `least_level` is its least level over the window, `highest` the greatest smoothed ratio to it there, `depth` the
    greatest depth, `end` the mean depth of the last channels (-inf where that does not count), `inner` as `INNER`, `nm`
    where it is deepest, which is to lie between `low_nm` and `high_nm`.

    Where the spectrum lies nowhere below the continuum it is deepest where both touch, which rounding decides.
    """
    nowhere = choose(highest - 1.0 > LEAST_DEPTH, STATUS.continuum_below_spectrum, STATUS.depth_within_noise)
    above, between = least_level > 0.0, (nm > low_nm) & (nm < high_nm)
    crossing = choose(
        highest - 1.0 > depth * CROSSING_SHARE,
        STATUS.continuum_below_spectrum,
        choose(end > depth * RUNAWAY_SHARE, STATUS.continuum_runs_away, STATUS.ok),
    )
    result = choose(inner > 0.0, crossing, choose(between, STATUS.too_few_deep_channels, STATUS.deepest_elsewhere))
    return choose(above, choose(depth < LEAST_DEPTH, nowhere, result), STATUS.continuum_falls_to_zero)


@uncounted_rows
def judge(grid: BandGrid, places: Places, work: BandWork, number: int, which: int) -> None:
    """What is against a continuum over a band, where the band is deepest under it, and its centre.

    `which` is the continuum's place in `CONTINUA`, `number` the band's in `BANDS`; into `AGAINST` and the rows
    behind it.
    """
    table, scalars, count, band = work.table, work.scalars, grid.wavelength_nm.size, places.bands[number]
    least_level, above = (
        load(table, (LEVEL + which) * count + band[0]),
        load(table, (ROW.CURVE + which) * count + band[0]),
    )
    for j in range(band[0] + 1, band[1]):
        least_level = lowest(least_level, load(table, (LEVEL + which) * count + j))
        above = highest(above, load(table, (ROW.CURVE + which) * count + j))
    least, place = deepest_of(table, ROW.CURVE + which, band[0], band[1], count)
    end = spread(-np.inf)
    if which == CONIC and band[1] == count:
        end = spread(0.0)
        for j in range(count - END_CHANNELS, count):
            end += (1.0 - load(table, (ROW.CURVE + which) * count + j)) * (1.0 / END_CHANNELS)
    store(scalars, DEEPEST_NM + which, place)
    for lane in range(LANES):
        scalars[DEEPEST_NM + which, lane] = grid.wavelength_nm[int(scalars[DEEPEST_NM + which, lane])]
    first, behind = window_of(grid, work, which, band, WIDE[0], WIDE[1], True)
    low, high = places.limits_nm[number]
    code = _code(
        least_level, above, 1.0 - least, end, load(scalars, ROW.INNER), load(scalars, DEEPEST_NM + which), low, high
    )
    store(scalars, AGAINST + which, code)
    store(scalars, OTHER_NM + which, centre(work, which, first, behind, count))


@uncounted_rows
def centre(work: BandWork, which: int, first: int, behind: int, count: int) -> Any:
    """Centre in the window of channels `first` to before `behind` of `count`, NaN where there is none. [nm]"""
    scalars = work.scalars
    fit(work.table, scalars, ROW.RATIO + which, first, behind, count)
    minima(scalars)
    there = choose(load(scalars, ROW.INNER), load(scalars, ROW.HAS_MINIMUM), spread(0.0))
    return choose(
        there, load(scalars, ROW.MIDDLE_NM) + load(scalars, ROW.HALF_NM) * load(scalars, ROW.LOWEST), spread(np.nan)
    )


@uncounted_rows
def go_on(places: Places, scalars: Any, lane: int, numbers: FloatArray, codes: Codes) -> bool:
    """Turn to the next continuum that nothing is against, and record of the others what is; whether there is one.

    `numbers`, (18,), and `codes`, (3,), are those of one band of the spectrum in a lane.
    """
    for tried in range(int(scalars[TRIED, lane]) + 1, places.order.size):
        which = places.order[tried]
        if which < 0:
            break
        code = int(scalars[AGAINST + which, lane])
        if code == STATUS.ok:
            scalars[TRIED, lane] = float(tried)
            return True
        record(places, scalars, lane, which, code, numbers, codes)
    scalars[TRIED, lane] = -2.0
    return False


@uncounted_rows
def record(places: Places, scalars: Any, lane: int, which: int, code: int, numbers: FloatArray, codes: Codes) -> None:
    """Write a code of a continuum as status where it is the answer, as note where another was wanted.

    The hull, which every spectrum has, answers where none is fit for use.
    """
    deepest = scalars[DEEPEST_NM + which, lane]
    if code == STATUS.ok or which == HULL:
        codes[CODE.continuum], codes[CODE.status], numbers[NUMBER.deepest_nm] = which, code, deepest
    if code != STATUS.ok and which == places.wanted:
        codes[CODE.note], numbers[NUMBER.note_deepest_nm] = code, deepest


@formula
def _picked(conic: Any, hull: Any, first: Any, second: Any, third: Any) -> Any:
    """The first value in lanes measured under the conic, the second under the hull, else the third."""
    return choose(conic, first, choose(hull, second, third))


@uncounted_rows
def chosen_continuum(grid: BandGrid, places: Places, work: BandWork) -> None:
    """Put what belongs to the continuum that each spectrum is tried under where `shape` looks for it."""
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    for lane in range(LANES):
        tried = int(scalars[TRIED, lane])
        which = places.order[tried] if tried >= 0 else HULL
        for term in range(TERMS):
            work.tie[ROW.CHOSEN, term, lane] = work.tie[which, term, lane]
        scalars[IS_CONIC, lane], scalars[IS_HULL, lane] = 1.0 if which == CONIC else 0.0, 1.0 if which == HULL else 0.0
    conic, hull = load(scalars, IS_CONIC), load(scalars, IS_HULL)
    for j in range(count):
        store(table, ROW.CHOSEN_NODE * count + j, load(table, NODE * count + j) * hull)
    for j in range(places.low, places.high):
        for row in (ROW.RATIO, ROW.CURVE, ROW.PER_LEVEL):
            at = row * count + j
            value = _picked(conic, hull, load(table, at), load(table, at + count), load(table, at + 2 * count))
            store(table, at + ROW.CHOSEN * count, value)
        for term in range(TERMS):
            at = (WEIGHT + term) * count + j
            value = _picked(
                conic, hull, load(table, at), load(table, at + TERMS * count), load(table, at + 2 * TERMS * count)
            )
            store(table, (ROW.CHOSEN_WEIGHT + term) * count + j, value)


@uncounted_rows
def verdict(limits_nm: FloatArray, scalars: Any, lane: int) -> int:
    """Code of the band measured in a lane, whose centre is to lie within limits. [nm]"""
    center_nm, depth = scalars[ROW.SHAPE_NM, lane], scalars[ROW.SHAPE_DEPTH, lane]
    if not (scalars[ROW.HAS_SHAPE, lane] > 0.0 and limits_nm[0] <= center_nm <= limits_nm[1]):
        return STATUS.no_minimum
    if depth < max(MIN_SIGNIFICANCE * math.sqrt(scalars[ROW.DEPTH_VARIANCE, lane]), LEAST_DEPTH):
        return STATUS.depth_within_noise
    return STATUS.center_uncertain if math.sqrt(scalars[ROW.CENTER_VARIANCE, lane]) > MAX_CENTER_SIGMA_NM else STATUS.ok


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
    grid : of the n channels, as `grid_of` makes it.
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
        part = np.ascontiguousarray(reflectance[rows], float)
        given = np.empty((0, part.shape[1])) if sigma is None else sigma[rows] if sigma.ndim > 1 else sigma
        noise = given if sigma is None else np.array(np.broadcast_to(given, part.shape), float, order="C")
        _measure(grid, places, part, noise, np.ascontiguousarray(shifts[rows]), _work(grid), numbers[rows], codes[rows])
        if grid.wavelength_nm[-1] < ABSENT_NM:
            two = codes[rows, -1, CODE.status]
            two[np.isin(two, NO_BAND)] = STATUS.window_not_covered
        second = numbers[rows, -1]
        second[:, NUMBER.center_method_nm] = np.fmax(
            second[:, NUMBER.center_method_nm], short_by(second[:, NUMBER.center_nm], float(grid.wavelength_nm[-1]))
        )

    each_in_threads(work, -(-count // CHUNK), progress)
    return numbers, codes


def _work(grid: BandGrid) -> BandWork:
    """Room for eight spectra."""
    table, tie, nodes, room = tables_of(grid.ties, ROW.ROWS)
    return BandWork(table, aligned(CHOICES), np.concatenate([tie, tie[:1]]), nodes, room)


def curve_of_centre(
    grid: BandGrid, reflectance: FloatArray, continuum_name: str, band: Band, center_nm: float
) -> tuple[FloatArray, FloatArray]:
    """The curve whose minimum is the centre of a band of one spectrum: both polynomials, joined as their centres were.

    Returns
    -------
    Wavelengths of the narrow window, or the wide one where that alone counts, and reflectance over continuum. [nm, -]
    """
    work, which, count = _work(grid), CONTINUA.index(continuum_name), grid.wavelength_nm.size
    table, inside = (
        work.table,
        [
            *channels_within(grid.wavelength_nm, band.window_nm),
            *channels_within(grid.wavelength_nm, band.center_range_nm),
        ],
    )
    take_eight(np.ascontiguousarray(reflectance[None], float), 0, table, ROW.VALUES * count)
    smooth(grid.smoother, table, ROW.VALUES * count, SMOOTHED * count)
    tie_down(which, grid.ties, table, work.tie[which], work.nodes, work.room)
    _remove(table, which, inside[0], inside[1], count)
    wide_nm, wide_center, _, wide = _polynomial(grid, work, which, np.array(inside), WIDE)
    nm, narrow_center, there, narrow = _polynomial(grid, work, which, np.array(inside), NARROW)
    if not there or abs(wide_center - narrow_center) < SAME_NM:
        return wide_nm, wide(wide_nm)
    part = float(np.clip((center_nm - narrow_center) / (wide_center - narrow_center), 0.0, 1.0))
    nm = wide_nm if part == 1.0 else nm
    return nm, part * wide(nm) + (1 - part) * narrow(nm)


def _polynomial(
    grid: BandGrid, work: BandWork, which: int, inside: IntArray, shares: tuple[float, float]
) -> tuple[FloatArray, float, bool, Any]:
    """Of a window where its channels count half or more, its minimum, whether there is one, and its polynomial. [nm]"""
    table, scalars, count = work.table, work.scalars, grid.wavelength_nm.size
    first, behind = window_of(grid, work, which, inside, *shares, shares == WIDE)
    fit(table, scalars, ROW.RATIO + which, first, behind, count)
    minima(scalars)
    middle, half = float(scalars[ROW.MIDDLE_NM, 0]), float(scalars[ROW.HALF_NM, 0])
    counting = grid.wavelength_nm[first:behind][table[ROW.HEFT * count + first : ROW.HEFT * count + behind, 0] >= 0.5]
    coefficients = scalars[ROW.COEFFICIENTS : ROW.COEFFICIENTS + SIZE, 0].copy()
    curve = np.polynomial.Polynomial(coefficients, (middle - half, middle + half), (-1.0, 1.0))
    there = bool(scalars[ROW.INNER, 0] > 0 and scalars[ROW.HAS_MINIMUM, 0] > 0)
    return np.linspace(counting[0], counting[-1], DRAWN), middle + half * float(scalars[ROW.LOWEST, 0]), there, curve


@uncounted_rows
def _measure(
    grid: BandGrid, places: Places, values: FloatArray, noise: FloatArray, shifts: FloatArray, work: BandWork,
    numbers: FloatArray, codes: Codes,
) -> None:  # fmt: skip
    """`measure_rows` of some rows, (m, n), into `numbers`, (m, 2, 18), and `codes`, (m, 2, 3).

    `noise` is one standard deviation, (m, n), or (0, n) to find it from the scatter; `shifts` are (m, k, n).
    """
    table, count, low, high = work.table, grid.wavelength_nm.size, places.low, places.high
    for begin in range(0, len(values), LANES):
        take_eight(values, begin, table, ROW.VALUES * count)
        smooth(grid.smoother, table, ROW.VALUES * count, SMOOTHED * count)
        if len(noise) > 0:
            take_eight(noise, begin, table, ROW.NOISE * count)
        else:
            _noise(table, count)
        for which in range(len(CONTINUA)):
            if grid.ties.available[which]:
                tie_down(which, grid.ties, table, work.tie[which], work.nodes, work.room)
                _remove(table, which, low, high, count)
        for number in range(len(places.bands)):
            _measure_band(
                grid, places, work, number, shifts[begin:], numbers[begin : begin + LANES], codes[begin : begin + LANES]
            )


@uncounted_rows
def _noise(table: Any, count: int) -> None:
    """Scatter of the channels, taken to follow the root of the signal as that of photons does."""
    brightest = load(table, ROW.VALUES * count)
    for j in range(1, count):
        brightest = highest(brightest, load(table, ROW.VALUES * count + j))
    for j in range(count):
        signal = root(highest(load(table, SMOOTHED * count + j), brightest * LEAST_SIGNAL))
        store(table, ROW.SPARE * count + j, signal)
        store(table, ROW.X * count + j, load(table, ROW.VALUES * count + j) / signal)
    running_medians(
        table, ROW.X * count, ROW.NOISE * count, count, WINDOW, table[ROW.ONTO * count :], table[ROW.WIDE_NM * count :]
    )
    for j in range(count):
        store(table, ROW.NOISE * count + j, load(table, ROW.NOISE * count + j) * load(table, ROW.SPARE * count + j))


@uncounted_rows
def _remove(table: Any, which: int, low: int, high: int, count: int) -> None:
    """Reflectance and smoothed reflectance over a continuum's level at channels `low` to before `high`."""
    for j in range(low, high):
        level = load(table, (LEVEL + which) * count + j)
        per_level = choose(level, 1.0 / level, spread(1.0))
        store(table, (ROW.PER_LEVEL + which) * count + j, per_level)
        store(table, (ROW.RATIO + which) * count + j, load(table, ROW.VALUES * count + j) * per_level)
        store(table, (ROW.CURVE + which) * count + j, load(table, SMOOTHED * count + j) * per_level)


@uncounted_rows
def _measure_band(
    grid: BandGrid, places: Places, work: BandWork, number: int, shifts: FloatArray, numbers: FloatArray, codes: Codes
) -> None:
    """One band of eight spectra, each under the wanted continuum or the first that is fit for use.

    `shifts`, `numbers` and `codes` begin with the rows of these eight; at the end there may be fewer.
    """
    scalars, open_ = work.scalars, places.missing[number] == STATUS.ok
    for which in range(len(CONTINUA)):
        if open_ and grid.ties.available[which]:
            judge(grid, places, work, number, which)
    waiting = False
    for lane in range(LANES):
        scalars[TRIED, lane] = -1.0
        if lane < len(numbers):
            code_row = codes[lane, number]
            code_row[CODE.continuum], code_row[CODE.status], code_row[CODE.note] = -1, places.missing[number], STATUS.ok
            if open_:
                code_row[CODE.note] = STATUS.no_tie_points if places.order[0] != places.wanted else STATUS.ok
                waiting = go_on(places, scalars, lane, numbers[lane, number], code_row) or waiting
    while waiting:
        waiting = False
        chosen_continuum(grid, places, work)
        shape(grid, work, places.bands[number], places.bias[number], places.least[number])
        for lane in range(len(numbers)):
            tried = int(scalars[TRIED, lane])
            if tried >= 0:
                which, code = places.order[tried], verdict(places.limits_nm[number], scalars, lane)
                record(places, scalars, lane, which, code, numbers[lane, number], codes[lane, number])
                if code == STATUS.ok:
                    _fill(grid, work, lane, which, shifts[lane], numbers[lane, number])
                    scalars[TRIED, lane] = -2.0
                else:
                    waiting = go_on(places, scalars, lane, numbers[lane, number], codes[lane, number]) or waiting


@uncounted_rows
def _fill(grid: BandGrid, work: BandWork, lane: int, which: int, shifts: FloatArray, numbers: FloatArray) -> None:
    """The numbers, (18,), of a band that is there, with what other continua and another definition of the centre differ
    by. `shifts` are those of its spectrum, (k, n)."""
    scalars = work.scalars
    numbers[NUMBER.center_nm], numbers[NUMBER.depth] = scalars[ROW.SHAPE_NM, lane], scalars[ROW.SHAPE_DEPTH, lane]
    numbers[NUMBER.area_nm], numbers[NUMBER.asymmetry] = (
        scalars[ROW.SHAPE_AREA, lane],
        scalars[ROW.SHAPE_ASYMMETRY, lane],
    )
    numbers[NUMBER.center_sigma_nm] = math.sqrt(scalars[ROW.CENTER_VARIANCE, lane])
    numbers[NUMBER.depth_sigma] = math.sqrt(scalars[ROW.DEPTH_VARIANCE, lane])
    numbers[NUMBER.area_sigma_nm] = math.sqrt(scalars[ROW.AREA_VARIANCE, lane])
    numbers[NUMBER.asymmetry_sigma] = math.sqrt(scalars[ROW.ASYMMETRY_VARIANCE, lane])
    if shifts.shape[0] > 0:
        numbers[NUMBER.center_calibration_nm] = _shared(work.table, ROW.WIDE_NM, lane, shifts)
        numbers[NUMBER.depth_calibration] = _shared(work.table, ROW.WIDE_DEPTH, lane, shifts)
        numbers[NUMBER.area_calibration_nm] = _shared(work.table, ROW.AREA, lane, shifts)
    least = most = scalars[ROW.WIDE_CENTER_NM, lane]
    for other in range(len(CONTINUA)):
        there = scalars[OTHER_NM + other, lane]
        if other != which and grid.ties.available[other] and not math.isnan(there):
            least, most = min(least, there), max(most, there)
    if most - least > SAME_NM:
        numbers[NUMBER.center_systematic_nm] = (most - least) / 2.0
    numbers[NUMBER.center_gaussian_nm] = abs(scalars[ROW.GAUSSIAN_NM, lane] - scalars[ROW.SHAPE_NM, lane]) / 2.0
    numbers[NUMBER.center_method_nm] = np.fmax(numbers[NUMBER.center_systematic_nm], numbers[NUMBER.center_gaussian_nm])


@uncounted_rows
def _shared(table: Any, row: int, lane: int, shifts: FloatArray) -> float:
    """Standard deviation of a quantity from errors that channels share, (k, n); its derivatives are in `row`."""
    total = 0.0
    for error in range(shifts.shape[0]):
        moved = 0.0
        for j in range(shifts.shape[1]):
            moved += table[row * shifts.shape[1] + j, lane] * shifts[error, j]
        total += moved * moved
    return math.sqrt(total)


FEWEST_CHANNELS, MOST_CHANNELS = 20, 5000
"""Usable channels of a spectrum."""
BLOCK_ROWS = 2048
"""Spectra of a block, a tenth of a second of one core."""
_NOTHING, _NAMES = np.empty(0), (*CONTINUA, "none")
"""No channels; names of continua by their code, of which -1 is the last."""


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumBands:
    """Both bands of a spectrum, and its usable channels with the smoothing of the continua (for pictures).

    `wavelength_nm` and `reflectance` have the same shape (n,); `smooth_nm` and `smooth_order` are those of `Smoothing`.
    """

    id: str
    bands: dict[str, BandResult]
    wavelength_nm: FloatArray = field(default_factory=lambda: _NOTHING)
    reflectance: FloatArray = field(default_factory=lambda: _NOTHING)
    smooth_nm: float = 0.0
    smooth_order: int = 3

    @property
    def smoothed(self) -> FloatArray:
        """The smoothed reflectance, (n,). [-]"""
        return np.asarray(smoothing_operator(self.wavelength_nm, self.smooth_nm, self.smooth_order) @ self.reflectance)

    @property
    def continua(self) -> dict[str, FloatArray]:
        """The continua that its bands were measured under, (n,) each. [-]"""
        used = {band.continuum: None for band in self.bands.values() if band.continuum in CONTINUA}
        smoothed = self.smoothed[None]
        return {name: continuum(name, self.wavelength_nm, smoothed)[0] for name in used}

    def curves(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """By key of each band that is there: wavelengths about its centre, and the curve with this minimum."""
        grid = grid_of(self.wavelength_nm, self.smooth_nm, self.smooth_order)
        seen = [(band, one, at) for band in BANDS if (at := (one := self.bands[band.key]).center_nm) is not None]
        return {b.key: curve_of_centre(grid, self.reflectance, one.continuum, b, at) for b, one, at in seen}

    def to_dict(self) -> dict[str, Any]:
        """The keys of `lunarsci spectra bands --json`."""
        record: dict[str, Any] = {"id": self.id, "continuum": {key: band.continuum for key, band in self.bands.items()}}
        for key, band in self.bands.items():
            record |= {name.format(key): getattr(band, quantity) for quantity, name in JSON_KEYS.items()}
            record |= {f"band{key}_status": band.status, f"band{key}_note": band.note}
        return record


@dataclass(frozen=True, slots=True)
class BandFailure:
    """A spectrum whose bands could not be measured, and why."""

    id: str
    status: str

    def to_dict(self) -> dict[str, Any]:
        """The same keys as a measured spectrum, without values."""
        nothing = BandResult(continuum="none", status=self.status)
        return SpectrumBands(self.id, {band.key: nothing for band in BANDS}).to_dict()


def columns_of(measured: Sequence[SpectrumBands]) -> dict[str, BandColumns]:
    """The numbers of measured spectra as columns, by key of the band."""
    arrays = BandArrays(*nothing_of(len(measured)))
    for row, item in enumerate(measured):
        for place, one in enumerate(item.bands.values()):
            arrays.numbers[row, place, : len(MEASURED)] = np.array([getattr(one, name) for name in MEASURED], float)
            arrays.codes[row, place, CODE.continuum] = _NAMES.index(one.continuum) if one.center_nm else -1
    return arrays.bands


def band_arrays(
    wavelength_nm: FloatArray,
    reflectance: npt.ArrayLike,
    sigma: FloatArray | None = None,
    *,
    continuum_name: ContinuumName = "conic",
    smoothing: Smoothing | None = None,
) -> BandArrays:
    """Measure the 1 um and 2 um bands of many spectra on the same channels, such as the pixels of a cube.

    Each row is measured as `measure_bands` measures it alone, in its own usable channels: to the last bit the same in
    any company. A row with fewer than 20 of them has the status `spectrum_unusable`.

    Parameters
    ----------
    wavelength_nm : shape (n,), ascending, 5000 at most. [nm]
    reflectance : shape (m, n); not finite or not above 0 where it cannot be used. [-]
    sigma : one standard deviation, (m, n) or (n,), above 0; None to find it from the scatter of the channels. [-]

    Raises
    ------
    DataError when there are too many channels, or where smoothing flattens a band.
    """
    used = smoothing or Smoothing()
    values = np.asarray(reflectance)
    wavelength = np.asarray(wavelength_nm, float)
    if wavelength.size > MOST_CHANNELS:
        raise DataError(f"{wavelength.size} channels are more than {MOST_CHANNELS}; average some of them")
    result = BandArrays(*nothing_of(len(values)))
    for mask, rows in alike_channels(np.isfinite(values) & (values > 0)):
        if mask.sum() >= FEWEST_CHANNELS:
            part = values[np.ix_(rows, mask)] if not mask.all() or rows.size < len(values) else values
            errors = None if sigma is None else sigma[np.ix_(rows, mask)] if sigma.ndim > 1 else sigma[mask]
            given = AlikeSpectra(wavelength[mask], part, errors, np.zeros((rows.size, 0, part.shape[1])))
            measured = _measured(given, wanted=continuum_name, smoothing=used, narrow=False)
            result.numbers[rows], result.codes[rows] = measured["numbers"], measured["codes"]
    return result


class BandsOfSpectra(Sequence[SpectrumBands | BandFailure]):
    """The bands of spectra, made of `arrays` when asked for; `reasons` has why spectra have none, by their place."""

    def __init__(self, spectra: SpectrumCollection, wanted: ContinuumName, smoothing: Smoothing) -> None:
        self.spectra, self.wanted, self.smoothing = spectra, wanted, smoothing
        self.arrays = BandArrays(*nothing_of(len(spectra)))
        self.reasons: dict[int, str] = {}

    def __len__(self) -> int:
        return len(self.spectra)

    def part(self, block: range) -> "BandsOfSpectra":
        """Of some of the spectra, next to each other."""
        rows = slice(block.start, block.stop)
        result = BandsOfSpectra(self.spectra[rows], self.wanted, self.smoothing)
        result.arrays = BandArrays(self.arrays.numbers[rows], self.arrays.codes[rows])
        result.reasons = {place - block.start: why for place, why in self.reasons.items() if place in block}
        return result

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        place = range(len(self))[place]
        spectrum = self.spectra[place]
        if place in self.reasons:
            return BandFailure(spectrum.id, f"no result: {self.reasons[place]}")
        wavelength = spectrum.wavelength_nm[spectrum.usable]
        return SpectrumBands(
            spectrum.id,
            {band.key: self._band(number, place, wavelength) for number, band in enumerate(BANDS)},
            wavelength,
            spectrum.reflectance[spectrum.usable],
            self.smoothing.width_nm(wavelength),
            self.smoothing.order,
        )

    def _band(self, number: int, place: int, wavelength_nm: FloatArray) -> BandResult:
        numbers, code = (
            self.arrays.numbers[place, number].tolist(),
            int(self.arrays.codes[place, number, CODE.continuum]),
        )
        values = {name: value for name, value in zip(MEASURED, numbers, strict=False) if value == value}
        status, why = (self._sentence(number, place, which, wavelength_nm) for which in (CODE.status, CODE.note))
        depends = bool(self.arrays.depends[place, number])
        status = self._remark(number, place, depends) or status if code >= 0 else status
        return BandResult(**values, continuum=CONTINUA[code] if code >= 0 else "none", status=status, note=why)

    def _sentence(self, number: int, place: int, which: int, wavelength_nm: FloatArray) -> str:
        """The sentence of a status or a note."""
        code = self.arrays.codes[place, number, which]
        deepest = NUMBER.deepest_nm if which == CODE.status else NUMBER.note_deepest_nm
        if which == CODE.note and code == STATUS.ok:
            return ""
        if code == STATUS.too_narrow:
            at, width = self.arrays.numbers[place, number, [NUMBER.narrow_nm, NUMBER.narrow_width_nm]].tolist()
            return f"no band: {narrow_text(at, width)}, {NO_PYROXENE}"
        text = sentence(code, BANDS[number], self.arrays.numbers[place, number, deepest], wavelength_nm)
        if which == CODE.status:
            return text
        reason = text.removeprefix("no result: ").replace("no band: ", "it shows no band, ")
        return f"{self.wanted} not used, since {reason}"

    def _remark(self, number: int, place: int, depends: bool) -> str:
        """What is said of a band that is there: that its centre depends on the method, and what else lies in it."""
        at, width = self.arrays.numbers[place, number, [NUMBER.narrow_nm, NUMBER.narrow_width_nm]].tolist()
        parts = [DEPENDS] if depends else []
        return "; ".join([*parts, *([f"in it {narrow_text(at, width)}"] if at == at else [])])

    def texts(self, number: int, which: int) -> list[str]:
        """The status or the note of a band of all spectra."""
        codes = self.arrays.codes[:, number, which]
        texts = ["" if which == CODE.note else "ok"] * len(self)
        deepest = self.arrays.numbers[
            :, number, NUMBER.deepest_nm if which == CODE.status else NUMBER.note_deepest_nm
        ].tolist()
        sentences: dict[tuple[int, float], str] = {}
        for place in np.flatnonzero(codes != STATUS.ok).tolist():
            if codes[place] in (STATUS.window_not_covered, STATUS.too_narrow):
                spectrum = self.spectra[place]
                texts[place] = self._sentence(number, place, which, spectrum.wavelength_nm[spectrum.usable])
                continue
            key = int(codes[place]), deepest[place] if codes[place] == STATUS.deepest_elsewhere else 0.0
            if key not in sentences:
                sentences[key] = self._sentence(number, place, which, _NOTHING)
            texts[place] = sentences[key]
        seen = self.arrays.codes[:, number, CODE.continuum] >= 0
        depends = self.arrays.depends[:, number]
        odd = depends | seen & np.isfinite(self.arrays.numbers[:, number, NUMBER.narrow_nm])
        for place in np.flatnonzero(odd).tolist() if which == CODE.status else ():
            texts[place] = self._remark(number, place, bool(depends[place]))
        for place, reason in self.reasons.items() if which == CODE.status else ():
            texts[place] = f"no result: {reason}"
        return texts

    @property
    def uncovered(self) -> dict[int, str]:
        """By place, why spectra have none, those whose channels cannot show either band among them."""
        codes = self.arrays.codes[..., CODE.status]
        lacking = np.flatnonzero(
            np.isin(codes, (STATUS.too_few_channels_in_window, STATUS.window_not_covered)).all(axis=1)
        ).tolist()
        reach = " or ".join("{:.0f}-{:.0f} nm".format(*band.reach_nm) for band in BANDS)
        return dict.fromkeys(lacking, f"the channels do not reach over {reach}, close enough for a band") | self.reasons

    def columns(self) -> dict[str, Any]:
        """The keys of `lunarsci spectra bands --json` as columns of records."""
        codes = self.arrays.codes[..., CODE.continuum].astype(int) % len(_NAMES)
        used = {band.key: records.Codes(codes[:, place], _NAMES) for place, band in enumerate(BANDS)}
        columns: dict[str, Any] = {"id": self.spectra.ids, "continuum": used}
        for place, (key, band) in enumerate(self.arrays.bands.items()):
            columns |= {name.format(key): getattr(band, quantity) for quantity, name in JSON_KEYS.items()}
            columns[f"band{key}_status"] = records.coded(self.texts(place, CODE.status))
            columns[f"band{key}_note"] = records.coded(self.texts(place, CODE.note))
        return columns


def measure_bands(
    spectrum: Spectrum, *, continuum_name: ContinuumName = "conic", smoothing: Smoothing | None = None
) -> SpectrumBands:
    """Measure the 1 um and 2 um bands of a spectrum.

    Parameters
    ----------
    spectrum : at least 20 usable channels.
    continuum_name : wanted continuum; `conic` falls back to `hull` over a band where it crosses the spectrum or zero,
        or where the spectrum does not reach its tie points. The result says which was used.
    smoothing : the centre itself is fitted to the unsmoothed channels, since smoothing moves minima.

    Raises
    ------
    DataError when too few or too many channels can be used, or where smoothing flattens a band.
    """
    result: SpectrumBands | BandFailure
    (result,) = measure_batch([spectrum], continuum_name=continuum_name, smoothing=smoothing)
    if isinstance(result, BandFailure):
        raise DataError(f"{result.id}: {result.status.removeprefix('no result: ')}")
    return result


def measure_batch(
    spectra: Sequence[Spectrum],
    *,
    progress: Callable[[int, int], None] | None = None,
    continuum_name: ContinuumName = "conic",
    smoothing: Smoothing | None = None,
) -> BandsOfSpectra:
    """`measure_bands` for many spectra: one result or one stated reason each; `progress` takes (done, total)."""
    used = smoothing or Smoothing()
    batch = BandsOfSpectra(SpectrumCollection.of(spectra), continuum_name, used)
    done = 0
    for positions in batch.spectra.alike():
        alike = batch.spectra.taken(positions)
        channels = alike[0].wavelength_nm[alike[0].usable]
        if reason := _unusable(channels, used):
            batch.reasons |= dict.fromkeys(positions.tolist(), reason)
        else:
            result = arrays_in_blocks(
                partial(_measured, wanted=continuum_name, smoothing=used, narrow=True),
                len(alike),
                rows_in_memory(64.0 * channels.size, most=saved_rows(len(alike), BLOCK_ROWS)),
                stage="bands",
                about=lambda alike=alike: {
                    "spectra": alike.digest(),
                    "continuum": continuum_name,
                    "smoothing": repr(used),
                },
                fetch=lambda block, alike=alike: alike[block.start : block.stop].arrays(),
                progress=None if progress is None else lambda now, _, done=done: progress(done + now, len(spectra)),
            )
            batch.arrays.numbers[positions], batch.arrays.codes[positions] = result["numbers"], result["codes"]
        done += len(positions)
    return batch


def _unusable(wavelength_nm: FloatArray, smoothing: Smoothing) -> str:
    """Why bands cannot be measured in these channels, or nothing."""
    count = wavelength_nm.size
    if count < FEWEST_CHANNELS:
        return f"{count} usable channels; {FEWEST_CHANNELS} are needed to measure a band"
    if count > MOST_CHANNELS:
        return f"{count} channels are more than {MOST_CHANNELS}; average some of them"
    try:
        smoothing.width_nm(wavelength_nm)
    except DataError as error:
        return str(error)
    return ""


def _measured(given: AlikeSpectra, *, wanted: ContinuumName, smoothing: Smoothing, narrow: bool) -> dict[str, Any]:
    """Numbers and codes of spectra, less 2 um bands that a `narrow` absorption makes."""
    grid = grid_of(given.wavelength_nm, smoothing.width_nm(given.wavelength_nm), smoothing.order)
    numbers, codes = measure_rows(grid, CONTINUA.index(wanted), given.reflectance, given.sigma, given.shifts)
    if narrow:
        judge_width(given.wavelength_nm, given.reflectance, numbers[:, -1], codes[:, -1])
    return {"numbers": numbers, "codes": codes}
