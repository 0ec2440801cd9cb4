"""Numbers that mark no data, channels and steps that no rock makes, and spectra unlikely to be what they should be.

No library finds the marks of a file that does not name them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from lunarsci.arrays import NORMAL_MAD, SIGNIFICANCE, BoolArray, FloatArray, IndexArray, IntArray, spans
from lunarsci.errors import DataError
from lunarsci.heights.grid import far_ends
from lunarsci.spectra.collection import SpectrumRows, alike_channels
from lunarsci.spectra.noise import SECOND_DIFFERENCE
from lunarsci.spectra.readers.table import MAX_PERCENT, SpectrumTable
from lunarsci.spectra.spectrum import NARROW_NM

DELETED_BELOW = -1e30
"""ENVI and USGS write -1.23e34 for a deleted channel (Kokaly et al. 2017, 10.3133/ds1035); no reflectance is near."""
FAR = 9.0
"""Times the largest of the others by which a number that is none of them lies beyond it; assumed."""
FEWEST = 8
"""Channels of a spectrum that is judged, or is a row of a table, and numbers beside one that repeats before that marks
no data though it could be a reflectance; assumed."""
_AT_ONCE = 256


def without_deleted(values: FloatArray) -> IntArray:
    """Make deleted and infinite values NaN; the number of deleted ones in each row."""
    with np.errstate(invalid="ignore"):
        deleted = values <= DELETED_BELOW
    values[deleted | ~np.isfinite(values)] = np.nan
    return np.asarray(deleted.sum(axis=-1))


def markers_of(values: FloatArray) -> list[float]:
    """Numbers of rows (n, c) that mark channels without data, e.g. 65535, -999 or 1e30; NaN is none.

    An end of a row is one where it is far from all others, and repeats beside `FEWEST` of them or could be no
    reflectance in percent. Then the next, with the first left out.
    """
    result, left = list[float](), values
    while True:
        parts = (left[block.start : block.stop] for block in spans(len(left), _AT_ONCE))
        new = {
            one.value for part in parts for one in far_ends(part, FAR, from_zero=True)
            if abs(one.value) > MAX_PERCENT or (one.repeats > 1 and one.others >= FEWEST)
        }  # fmt: skip
        if not new:
            return result
        result += sorted(new)
        left = np.where(np.isin(left, result), np.nan, left)


def unnamed_markers(parts: Sequence[npt.NDArray[Any]], stated: Sequence[float]) -> list[float]:
    """Numbers of parts of a cube that mark no data, beside those that are known: far from all others of all parts."""
    seen = np.concatenate([np.empty(0), *(part.ravel() for part in parts)])[None]
    seen[np.isin(seen, stated) | ~np.isfinite(seen) | (seen <= DELETED_BELOW)] = np.nan
    return [] if np.isnan(seen).all() else markers_of(seen)


def without_markers(table: SpectrumTable) -> tuple[SpectrumTable, IntArray, list[str]]:
    """A table with NaN for numbers that mark no data, in its `block`; how many were deleted, or marked, (n, 2)."""
    values = table.reflectances
    deleted = without_deleted(values)
    count = np.stack([deleted, np.zeros_like(deleted)], axis=1)
    notes = list[str]()
    if result := markers_of(values):
        marked = np.isin(values, result)
        values[marked] = np.nan
        count[:, 1] = marked.sum(axis=1)
        listed = ", ".join(f"{one:g}" for one in result)
        notes = [f"{listed} read as the mark of no data: {int(marked.sum())} values left out"]
    return replace(table, block=values), count, notes


BRIGHTEST = 1.0
"""Median reflectance factor; that of a perfectly white, diffuse surface, by definition. [-]"""
LONE_STEP = 0.5
"""How far ln R of a single channel lies from both its neighbours, to the same side: a factor of 1.65. Assumed; no
channel of 560 measured spectra of the Moon, of meteorites and minerals does. [-]"""
TOO_SMOOTH = 5.0
"""Times the scatter from channel to channel that errors are, in the median, before it is said that they cannot be
independent; measured: 1.2 of calibrated spectra of VNIS, 12 to 95 of means of samples with their standard deviation."""
STEP_CHANNELS, STEP_SURE, LEAST_STEP = 5, 10.0, 0.01
"""Channels on either side of a step, errors by which straight lines through them miss each other, and the least ratio
by which they do, in ln R. Assumed: none of 471 spectra of laboratories has one (7.9 at most), and steps of 3 % at
1000 nm and -3 % at 1400 nm put into them are found in 67 and 76 %, nine in ten where channels are 5 nm apart."""
MOST_DETECTORS = 3
"""Of a field spectrometer: Hueni & Bialek (2017), 10.1109/JSTARS.2016.2625043."""
REMARKS = {
    "smooth": "spectra whose errors are 5 times the scatter from channel to channel, or more; are they in percent? "
    "They are taken as independent; errors that channels share, as those of samples, belong into a column "
    "NAME_systematic_samples",
    "bright": "spectra with a median reflectance above 1; are they in percent, or no reflectance?",
    "step": "spectra with a step between two channels, as where detectors meet, read with the channels below it scaled "
    "to those above",
}


def unlikely(rows: SpectrumRows, file: str) -> list[str]:
    """A line for each kind of what is unlikely, with how many spectra and the first of them.

    Raises DataError where every spectrum of the file is constant.
    """
    result: dict[str, list[int]] = {name: [] for name in REMARKS}
    where, constant = "", True
    for block in spans(len(rows), _AT_ONCE):
        block_rows = slice(block.start, block.stop)
        usable, values = ~rows.mask[block_rows], rows.reflectance[block_rows]
        sigma = None if rows.uncertainty is None else rows.uncertainty[block_rows]
        for name, odd in _odd(values, usable, sigma).items():
            result[name] += (block.start + np.flatnonzero(odd)).tolist()
        span = np.where(usable, values, -np.inf).max(axis=1) - np.where(usable, values, np.inf).min(axis=1)
        constant = constant and bool(((usable.sum(axis=1) >= FEWEST) & (span == 0)).all())
        for row, step, place in _steps(rows.wavelength_nm, values, usable):
            where = where or f" by {step:+.1%} at {place:.0f} nm"
            result["step"].append(block.start + row)
    if constant:
        raise DataError(f"{file}: the same value in all channels; give measured reflectances")
    return [
        f"{file}: {REMARKS[name]}: {len(k)}, first '{rows.ids[k[0]]}'{where if name == 'step' else ''}"
        for name, k in result.items()
        if k
    ]


def _odd(values: FloatArray, usable: BoolArray, sigma: FloatArray | None) -> dict[str, BoolArray]:
    """By kind, which of n spectra are so. (n,)"""
    count = usable.sum(axis=1)
    enough = count >= FEWEST
    odd = {"bright": enough & (2 * (usable & (values > BRIGHTEST)).sum(axis=1) > count)}
    if sigma is not None:
        odd["smooth"] = np.zeros(len(values), bool)
        for channels, rows in _judged(usable, FEWEST):
            alike = np.ix_(rows, channels)
            scatter = TOO_SMOOTH * scatter_of(values[alike])
            odd["smooth"][rows] = (scatter > 0) & (scatter < np.median(sigma[alike], axis=1))
    return odd


def cleaned(parts: Sequence[SpectrumRows]) -> tuple[list[SpectrumRows], list[str]]:
    """The spectra without single channels far off their neighbours, and what to say of it."""
    retained, odd = list[SpectrumRows](), list[str]()
    for rows in parts:
        clean, which = without_lone(rows)
        retained.append(clean)
        odd += [rows.ids[row] for row in which]
    lone = "spectra with single channels a factor of 1.65 and more off both neighbours, which are left out"
    return retained, [f"{lone}: {len(odd)}, first '{odd[0]}'"] if odd else []


def without_steps(rows: SpectrumRows) -> SpectrumRows:
    """The spectra with what lies below a step scaled to what lies above, as detectors are spliced.

    The largest step of each, then the next, of as many as `MOST_DETECTORS` have.
    """
    values, scaled = rows.reflectance.copy(), dict[int, FloatArray]()
    for block in spans(len(rows), _AT_ONCE):
        block_rows = slice(block.start, block.stop)
        for _ in range(MOST_DETECTORS - 1):
            for row, step, place in _steps(rows.wavelength_nm, values[block_rows], ~rows.mask[block_rows]):
                gain = np.where(rows.wavelength_nm < place, 1.0 + step, 1.0)
                values[block.start + row] *= gain
                scaled[block.start + row] = scaled.get(block.start + row, 1.0) * gain
    sigma = None if rows.uncertainty is None else rows.uncertainty.copy()
    systematic = dict(rows.systematic)
    for row, gain in scaled.items():
        if sigma is not None:
            sigma[row] *= gain
        if row in systematic:
            systematic[row] = {name: one * gain for name, one in systematic[row].items()}
    return replace(rows, reflectance=values, uncertainty=sigma, systematic=systematic)


def without_lone(rows: SpectrumRows) -> tuple[SpectrumRows, list[int]]:
    """The spectra with single channels masked that lie far from both their neighbours, and which spectra had some.

    One such channel moves a band centre by ten times its error, if it lies in the band.
    """
    mask, odd = rows.mask.copy(), list[int]()
    gate = math.sqrt(2.0 * math.log(mask.size / SIGNIFICANCE))
    for block in spans(len(rows), _AT_ONCE):
        values = rows.reflectance[block.start : block.stop]
        for channels, alike in _judged(~rows.mask[block.start : block.stop], FEWEST):
            row, channel = np.nonzero(_lone(np.log(values[np.ix_(alike, channels)]), gate))
            mask[block.start + alike[row], np.flatnonzero(channels)[channel]] = True
            odd += (block.start + np.unique(alike[row])).tolist()
    return (replace(rows, mask=mask) if odd else rows), sorted(odd)


def _judged(usable: BoolArray, least: int) -> list[tuple[BoolArray, IndexArray]]:
    """Channels (c,) that spectra share, so many at least, and the rows of `usable` (n, c) that have just these."""
    return [(channels, rows) for channels, rows in alike_channels(usable) if channels.sum() >= least]


def _lone(level: FloatArray, gate: float) -> BoolArray:
    """Which channels of ln R (n, c) lie far from both neighbours, to the same side, by more than `gate` noises."""
    step = np.diff(level, axis=1)
    least = np.minimum(np.abs(step[:, :-1]), np.abs(step[:, 1:]))
    far = (least > LONE_STEP) & (step[:, :-1] * step[:, 1:] < 0)
    rows = np.flatnonzero(far.any(axis=1))
    far[rows] &= least[rows] > gate * math.sqrt(2.0) * scatter_of(level[rows])[:, None]
    return np.pad(far, ((0, 0), (1, 1)))


def _steps(wavelength_nm: FloatArray, values: FloatArray, usable: BoolArray) -> list[tuple[int, float, float]]:
    """Of spectra (n, c) those with a step: which row, the largest step as a share of the value, and where. [nm]"""
    result = []
    for channels, alike in _judged(usable & (values > 0), 4 * STEP_CHANNELS):
        place = wavelength_nm[channels]
        sure, step = _step_at(place, np.log(values[np.ix_(alike, channels)]))
        at = sure.argmax(axis=1)
        for row in np.flatnonzero(sure.max(axis=1) > STEP_SURE).tolist():
            edge = int(at[row]) + STEP_CHANNELS - 1
            size = float(np.expm1(step[row, at[row]]))
            result.append((int(alike[row]), size, float(place[edge : edge + 2].mean())))
    return sorted(result)


def _step_at(place_nm: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How sure there is a step between two channels, in its errors, 0 where there is none, and the step. (n, gaps)

    `level` is ln R, (n, c). Straight lines through the channels on either side are compared in the middle.
    """
    size = STEP_CHANNELS
    x = sliding_window_view(place_nm, size)
    middle = x.mean(axis=1)
    away = x - middle[:, None]
    spread = (away**2).sum(axis=1)
    parts = [level[:, k : k + len(x)] for k in range(size)]
    mean = np.asarray(sum(parts) / size)
    slope = np.asarray(sum(part * away[:, k] for k, part in enumerate(parts)) / spread)
    low = np.arange(len(place_nm) - 2 * size + 1)
    high, edge = low + size, low + size - 1
    at = 0.5 * (place_nm[edge] + place_nm[edge + 1])
    step = mean[:, high] + slope[:, high] * (at - middle[high])
    step = step - mean[:, low] - slope[:, low] * (at - middle[low])
    share = 2.0 / size + (at - middle[low]) ** 2 / spread[low] + (at - middle[high]) ** 2 / spread[high]

    def variance(row: IntArray, gap: IntArray) -> FloatArray:
        squares = (
            (level[row, line + k] - mean[row, line] - slope[row, line] * away[line, k]) ** 2
            for line in (gap, gap + size) for k in range(size)
        )  # fmt: skip
        return np.asarray(sum(squares) / (2 * size - 4))

    good = (np.abs(step) > LEAST_STEP) & (np.diff(place_nm)[edge] < NARROW_NM)
    row, gap = good.nonzero()
    # The usual variance, which takes a median, can only make them less sure.
    rows = np.unique(row[step[row, gap] ** 2 > STEP_SURE**2 * variance(row, gap) * share[gap]])
    sure, left_over = np.zeros_like(step), variance(rows[:, None], low)
    usual = np.median(left_over, axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        result = np.abs(step[rows]) / np.sqrt(np.maximum(left_over, usual) * share)
    sure[rows] = np.where(good[rows], result, 0.0)
    return sure, step


def scatter_of(values: FloatArray) -> Any:
    """Of three channels or more, about straight lines between their neighbours: 6 variances of one. (..., c) to (...)

    In the unit of the values.
    """
    return np.median(np.abs(np.diff(values, 2)), axis=-1) * NORMAL_MAD / SECOND_DIFFERENCE
