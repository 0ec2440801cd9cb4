"""The 1 um and 2 um absorption bands of spectra: their numbers, for one spectrum and for many.

What is measured, and what is in its errors, is in `lunarsci.spectra.band_shape`; here is under which continuum, and
whether there is a band at all.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.compiled import each_in_threads
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import aligned, choose, highest, load, root, spread, store
from lunarsci.errors import DataError
from lunarsci.io import records
from lunarsci.parallel.blocks import arrays_in_blocks, rows_in_memory, saved_rows
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
    NARROW,
    NOISE,
    ONTO,
    PER_LEVEL,
    RATIO,
    ROWS,
    SIZE,
    SPARE,
    VALUES,
    WIDE,
    WIDE_DEPTH,
    WIDE_NM,
    BandGrid,
    BandWork,
    Smoother,
    X,
    fit,
    minima,
    smooth,
    window_of,
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
    CHOICES,
    CODES,
    CONTINUUM,
    DEEPEST,
    DEPENDS,
    DEPTH,
    DEPTH_CALIBRATION,
    DEPTH_SIGMA,
    ELSEWHERE,
    GAUSSIAN,
    JSON_KEYS,
    METHOD,
    NARROW_NM,
    NARROW_WIDTH,
    NO_BAND,
    NO_TIES,
    NOT_COVERED,
    NOTE,
    NOTE_DEEPEST,
    OK,
    OTHER_NM,
    QUANTITIES,
    SPARSE,
    STATUS,
    SYSTEMATIC,
    TOO_NARROW,
    TRIED,
    UNUSABLE,
    Band,
    BandResult,
    Codes,
    Places,
    depends_on_method,
    go_on,
    judge,
    narrow_said,
    own_continuum,
    record,
    sentence,
    short_by,
    verdict,
)
from lunarsci.spectra.collection import AlikeSpectra, SpectrumCollection, alike_channels
from lunarsci.spectra.continuum import (
    CONTINUA,
    HULL,
    LEVEL,
    LINEAR,
    SMOOTHED,
    ContinuumName,
    continuum,
    tables_of,
    tie_down,
    ties_of,
)
from lunarsci.spectra.lane_rows import take_eight, uncounted
from lunarsci.spectra.narrow import judge_width
from lunarsci.spectra.noise import WINDOW, running_medians
from lunarsci.spectra.spectrum import Smoothing, Spectrum, reaches_over, smoothing_operator

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


FEWEST_CHANNELS, MOST_CHANNELS = 20, 5000
BLOCK_ROWS = 2048
"""Spectra of a block, a tenth of a second of one core."""
MEASURED = QUANTITIES[:DEEPEST]
"""What is measured of a band: the numbers of a `BandResult`."""
_NOTHING, _NAMES = np.empty(0), (*CONTINUA, "none")


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
        seen = [(band, own, at) for band in BANDS if (at := (own := self.bands[band.key]).center_nm) is not None]
        return {b.key: curve_of_centre(grid, self.reflectance, own.continuum, b, at) for b, own, at in seen}

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


@dataclass(frozen=True, slots=True, eq=False)
class BandColumns:
    """One band of m spectra; each array is (m,), a number NaN where there is none.

    Attributes
    ----------
    center_nm, … : as in `BandResult`.
    deepest_nm, note_deepest_nm : where the band of the reported continuum, and of the wanted one, is deepest. [nm]
    narrow_nm, narrow_width_nm : centre and width of a narrow absorption in it, or that makes it. [nm]
    continuum : place in `CONTINUA` of the one used, -1 for none.
    status, note : places in `STATUSES`: whether there is a band, and why the wanted continuum was not used.
    """

    center_nm: FloatArray
    center_sigma_nm: FloatArray
    center_systematic_nm: FloatArray
    center_gaussian_nm: FloatArray
    center_method_nm: FloatArray
    depth: FloatArray
    depth_sigma: FloatArray
    area_nm: FloatArray
    area_sigma_nm: FloatArray
    asymmetry: FloatArray
    asymmetry_sigma: FloatArray
    center_calibration_nm: FloatArray
    depth_calibration: FloatArray
    area_calibration_nm: FloatArray
    deepest_nm: FloatArray
    note_deepest_nm: FloatArray
    narrow_nm: FloatArray
    narrow_width_nm: FloatArray
    continuum: Codes
    status: Codes
    note: Codes


@dataclass(frozen=True, slots=True, eq=False)
class BandArrays:
    """Both bands of m spectra: numbers (m, 2, 18) and codes (m, 2, 3), which `bands` has by name."""

    numbers: FloatArray
    codes: Codes

    @property
    def depends(self) -> BoolArray:
        """(m, 2) whether methods differ by much more than the noise does."""
        return depends_on_method(self.numbers[..., CENTER_SIGMA], self.numbers[..., METHOD])

    @property
    def bands(self) -> dict[str, BandColumns]:
        """By key of the band, its numbers and codes."""
        return {
            band.key: BandColumns(*self.numbers[:, place].T, *self.codes[:, place].T)
            for place, band in enumerate(BANDS)
        }


def columns_of(measured: Sequence[SpectrumBands]) -> dict[str, BandColumns]:
    """The numbers of measured spectra as columns, by key of the band."""
    arrays = BandArrays(*nothing_of(len(measured)))
    for row, item in enumerate(measured):
        for place, one in enumerate(item.bands.values()):
            arrays.numbers[row, place, : len(MEASURED)] = np.array([getattr(one, name) for name in MEASURED], float)
            arrays.codes[row, place, CONTINUUM] = _NAMES.index(one.continuum) if one.center_nm else -1
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
    found = BandArrays(*nothing_of(len(values)))
    for mask, rows in alike_channels(np.isfinite(values) & (values > 0)):
        if mask.sum() >= FEWEST_CHANNELS:
            part = values[np.ix_(rows, mask)] if not mask.all() or rows.size < len(values) else values
            errors = None if sigma is None else sigma[np.ix_(rows, mask)] if sigma.ndim > 1 else sigma[mask]
            given = AlikeSpectra(wavelength[mask], part, errors, np.zeros((rows.size, 0, part.shape[1])))
            own = _measured(given, wanted=continuum_name, smoothing=used)
            found.numbers[rows], found.codes[rows] = own["numbers"], own["codes"]
    return found


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
        own = slice(block.start, block.stop)
        found = BandsOfSpectra(self.spectra[own], self.wanted, self.smoothing)
        found.arrays = BandArrays(self.arrays.numbers[own], self.arrays.codes[own])
        found.reasons = {place - block.start: why for place, why in self.reasons.items() if place in block}
        return found

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
        numbers, code = self.arrays.numbers[place, number].tolist(), int(self.arrays.codes[place, number, CONTINUUM])
        known = {name: value for name, value in zip(MEASURED, numbers, strict=False) if value == value}
        status, why = (self._said(number, place, which, wavelength_nm) for which in (STATUS, NOTE))
        status = self._remark(number, place) or status if code >= 0 else status
        return BandResult(**known, continuum=CONTINUA[code] if code >= 0 else "none", status=status, note=why)

    def _said(self, number: int, place: int, which: int, wavelength_nm: FloatArray) -> str:
        """The sentence of a status or a note."""
        code, deepest = self.arrays.codes[place, number, which], DEEPEST if which == STATUS else NOTE_DEEPEST
        if which == NOTE and code == OK:
            return ""
        if code == TOO_NARROW:
            at, width = self.arrays.numbers[place, number, [NARROW_NM, NARROW_WIDTH]].tolist()
            return f"no band: {narrow_said(at, width)}, no pyroxene's"
        text = sentence(code, BANDS[number], self.arrays.numbers[place, number, deepest], wavelength_nm)
        return text if which == STATUS else f"{self.wanted} not used: {text}"

    def _remark(self, number: int, place: int) -> str:
        """What is said of a band that is there: that its centre depends on the method, and what else lies in it."""
        at, width = self.arrays.numbers[place, number, [NARROW_NM, NARROW_WIDTH]].tolist()
        parts = [DEPENDS] if self.arrays.depends[place, number] else []
        return "; ".join([*parts, *([f"in it {narrow_said(at, width)}"] if at == at else [])])

    def texts(self, number: int, which: int) -> list[str]:
        """The status or the note of a band of all spectra."""
        codes = self.arrays.codes[:, number, which]
        found = ["" if which == NOTE else "ok"] * len(self)
        deepest = self.arrays.numbers[:, number, DEEPEST if which == STATUS else NOTE_DEEPEST].tolist()
        known: dict[tuple[int, float], str] = {}
        for place in np.flatnonzero(codes != OK).tolist():
            if codes[place] in (NOT_COVERED, TOO_NARROW):
                spectrum = self.spectra[place]
                found[place] = self._said(number, place, which, spectrum.wavelength_nm[spectrum.usable])
                continue
            key = int(codes[place]), deepest[place] if codes[place] == ELSEWHERE else 0.0
            if key not in known:
                known[key] = self._said(number, place, which, _NOTHING)
            found[place] = known[key]
        seen = self.arrays.codes[:, number, CONTINUUM] >= 0
        odd = self.arrays.depends[:, number] | seen & np.isfinite(self.arrays.numbers[:, number, NARROW_NM])
        for place in np.flatnonzero(odd).tolist() if which == STATUS else ():
            found[place] = self._remark(number, place)
        for place, reason in self.reasons.items() if which == STATUS else ():
            found[place] = f"no result: {reason}"
        return found

    @property
    def uncovered(self) -> dict[int, str]:
        """By place, why spectra have none, those whose channels cannot show either band among them."""
        codes = self.arrays.codes[..., STATUS]
        lacking = np.flatnonzero(np.isin(codes, (SPARSE, NOT_COVERED)).all(axis=1)).tolist()
        reach = " or ".join("{:.0f}-{:.0f} nm".format(*band.reach_nm) for band in BANDS)
        return dict.fromkeys(lacking, f"the channels do not reach over {reach}, close enough for a band") | self.reasons

    def columns(self) -> dict[str, Any]:
        """The keys of `lunarsci spectra bands --json` as columns of records."""
        codes = self.arrays.codes[..., CONTINUUM].astype(int) % len(_NAMES)
        used = {band.key: records.Codes(codes[:, place], _NAMES) for place, band in enumerate(BANDS)}
        columns: dict[str, Any] = {"id": self.spectra.ids, "continuum": used}
        for place, (key, band) in enumerate(self.arrays.bands.items()):
            columns |= {name.format(key): getattr(band, quantity) for quantity, name in JSON_KEYS.items()}
            columns[f"band{key}_status"] = records.coded(self.texts(place, STATUS))
            columns[f"band{key}_note"] = records.coded(self.texts(place, NOTE))
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
    found: SpectrumBands | BandFailure
    (found,) = measure_batch([spectrum], continuum_name=continuum_name, smoothing=smoothing)
    if isinstance(found, BandFailure):
        raise DataError(f"{found.id}: {found.status.removeprefix('no result: ')}")
    return found


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
        own = batch.spectra.taken(positions)
        channels = own[0].wavelength_nm[own[0].usable]
        if reason := _unusable(channels, used):
            batch.reasons |= dict.fromkeys(positions.tolist(), reason)
        else:
            found = arrays_in_blocks(
                partial(_judged, wanted=continuum_name, smoothing=used),
                len(own),
                rows_in_memory(64.0 * channels.size, most=saved_rows(len(own), BLOCK_ROWS)),
                stage="bands",
                about=lambda own=own: {"spectra": own.digest(), "continuum": continuum_name, "smoothing": repr(used)},
                fetch=lambda block, own=own: own[block.start : block.stop].arrays(),
                progress=None if progress is None else lambda now, _, done=done: progress(done + now, len(spectra)),
            )
            batch.arrays.numbers[positions], batch.arrays.codes[positions] = found["numbers"], found["codes"]
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


def _judged(given: AlikeSpectra, *, wanted: ContinuumName, smoothing: Smoothing) -> dict[str, Any]:
    found = _measured(given, wanted=wanted, smoothing=smoothing)
    judge_width(given.wavelength_nm, given.reflectance, found["numbers"][:, -1], found["codes"][:, -1])
    return found


def _measured(given: AlikeSpectra, *, wanted: ContinuumName, smoothing: Smoothing) -> dict[str, Any]:
    grid = grid_of(given.wavelength_nm, smoothing.width_nm(given.wavelength_nm), smoothing.order)
    numbers, codes = measure_rows(grid, CONTINUA.index(wanted), given.reflectance, given.sigma, given.shifts)
    return {"numbers": numbers, "codes": codes}
