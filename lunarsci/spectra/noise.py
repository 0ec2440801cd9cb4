"""What the channels of many spectra say of their noise, and how deep they absorb, compiled."""

from functools import partial
from typing import Any

import numpy as np

from lunarsci.arrays import NORMAL_MAD, FloatArray
from lunarsci.compiled import LANE_OPTIONS, compiled, uncounted
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import aligned, choose, highest, load, lowest, spread, store

uncounted_rows = partial(uncounted, fastmath=LANE_OPTIONS["fastmath"])
"""`uncounted` with products fused, as in `in_lanes`."""


@uncounted_rows
def take_eight(rows: FloatArray, begin: int, table: Any, first: int) -> None:
    """Rows of (m, n) into the lanes of a table, from its row `first` on; the last one again where there are no more."""
    for lane in range(LANES):
        row = min(begin + lane, len(rows) - 1)
        for j in range(rows.shape[1]):
            table[first + j, lane] = rows[row, j]


SECOND_DIFFERENCE = float(np.sqrt(6.0))
"""Standard deviation of x[i-1] - 2 x[i] + x[i+1] over that of x."""
WINDOW = 61
"""Channels of a running window."""
EPSILON = float(np.finfo(float).eps)


def scatter_noise_rows(values: FloatArray, window: int = WINDOW) -> FloatArray:
    """`scatter_noise` of `lunarsci.spectra.spectrum` of every row, (rows, n). [unit of `values`]"""
    channels = values.shape[1]
    if channels < 5:
        return np.repeat(np.std(values, axis=1)[:, None], channels, axis=1)
    noise, work = np.empty(values.shape), aligned(3 * channels + window)
    _noise_of_rows(np.ascontiguousarray(values, dtype=np.float64), window, work, noise)
    return noise


@uncounted_rows
def _noise_of_rows(values: FloatArray, window: int, work: Any, noise: FloatArray) -> None:
    """`scatter_noise_rows` into `noise` (rows, n), with a workspace of (3 n + `window`, 8)."""
    channels = values.shape[1]
    for begin in range(0, len(values), LANES):
        take_eight(values, begin, work, 0)
        running_medians(work, 0, channels, channels, window, work[2 * channels :], work[3 * channels :])
        for lane in range(min(LANES, len(values) - begin)):
            for j in range(channels):
                noise[begin + lane, j] = work[channels + j, lane]


@uncounted_rows
def running_medians(table: Any, source: int, out: int, channels: int, window: int, second: Any, ordered: Any) -> None:
    """Robust standard deviations of eight spectra, from the medians of absolute second differences in windows.

    They lie in rows of `table` from `source` on; the result goes to those from `out` on. `window` is an odd number of
    channels, 5 at least; `second` and `ordered` are room for so many rows as there are channels, and in a window.
    """
    half = (min(window, channels - 2) - 1) // 2
    size, largest = 2 * half + 1, spread(0.0)
    for j in range(channels):
        largest = highest(largest, _size(load(table, source + j)))
    for j in range(channels - 2):
        middle = load(table, source + j + 1)
        store(second, j, _size((load(table, source + j + 2) - middle) - (middle - load(table, source + j))))
    for j in range(size):
        _insert(ordered, j, load(second, j))
    first, last = half + 1, channels - 2 - half
    for j in range(channels):
        if first < j <= last:
            _replace(ordered, size, load(second, j - half - 2), load(second, j + half - 1))
        scatter = load(ordered, half) * NORMAL_MAD / SECOND_DIFFERENCE
        store(table, out + j, highest(scatter, largest * EPSILON))


@formula
def _size(value: Any) -> Any:
    """Absolute value."""
    return abs(value)


@formula
def _apart(one: Any, other: Any) -> Any:
    """The lower and the higher of two."""
    return lowest(one, other), highest(one, other)


@uncounted_rows
def _insert(ordered: Any, count: int, new: Any) -> None:
    """Put a number into the first `count` rows, which ascend."""
    for place in range(count):
        least, new = _apart(load(ordered, place), new)
        store(ordered, place, least)
    store(ordered, count, new)


@formula
def _without(here: Any, behind: Any, old: Any) -> Any:
    """A row of ascending ones once `old` is out: itself below `old`, from there on the one behind it."""
    return choose(here < old, here, behind)


@uncounted_rows
def _replace(ordered: Any, size: int, old: Any, new: Any) -> None:
    """Take one number out of so many rows, which ascend, and put another in."""
    here = load(ordered, 0)
    for place in range(size - 1):
        behind = load(ordered, place + 1)
        least, new = _apart(_without(here, behind, old), new)
        store(ordered, place, least)
        here = behind
    store(ordered, size - 1, new)


def deepest_below_hull(x: FloatArray, values: FloatArray) -> FloatArray:
    """How far the lowest point of every row, (rows, n) over ascending x (n,), lies below the row's upper hull, (rows,).

    Andrew (1979), 10.1016/0020-0190(79)90072-3 (hull).
    """
    deepest = np.zeros(len(values))
    _below_hulls(np.ascontiguousarray(x), np.ascontiguousarray(values), deepest)
    return deepest


@compiled
def _below_hulls(x: Any, values: Any, deepest: Any) -> None:
    rows, channels = values.shape
    hull = np.empty(channels, dtype=np.int64)
    for row in range(rows):
        y, size = values[row], 0
        for c in range(channels):
            while size > 1:
                a, b = hull[size - 2], hull[size - 1]
                if (y[b] - y[a]) * (x[c] - x[a]) > (y[c] - y[a]) * (x[b] - x[a]):
                    break
                size -= 1
            hull[size] = c
            size += 1
        for tie in range(size - 1):
            a, b = hull[tie], hull[tie + 1]
            slope = (y[b] - y[a]) / (x[b] - x[a])
            for c in range(a + 1, b):
                deepest[row] = max(deepest[row], slope * (x[c] - x[a]) + y[a] - y[c])
