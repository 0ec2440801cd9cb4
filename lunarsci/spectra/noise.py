"""What the channels of many spectra say of their noise, and how deep they absorb, compiled."""

from typing import Any

import numpy as np

from lunarsci.arrays import NORMAL_MAD, FloatArray
from lunarsci.compiled import compiled

SECOND_DIFFERENCE = np.sqrt(6.0)
"""Standard deviation of x[i-1] - 2 x[i] + x[i+1] over that of x."""


def scatter_noise_rows(values: FloatArray, window: int = 61) -> FloatArray:
    """`scatter_noise` of `lunarsci.spectra.spectrum` of every row, (rows, n). [unit of `values`]"""
    if values.shape[1] < 5:
        return np.repeat(np.std(values, axis=1)[:, None], values.shape[1], axis=1)
    noise = np.empty(values.shape)
    _running_medians(np.ascontiguousarray(values, dtype=np.float64), window, noise)
    return noise


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _running_medians(values: Any, window: int, noise: Any) -> None:
    """Robust standard deviations from the medians of absolute second differences in windows of an odd length."""
    rows, channels = values.shape
    half = (min(window, channels - 2) - 1) // 2
    second, ordered = np.empty(channels - 2), np.empty(2 * half + 1)
    for row in range(rows):
        own, largest = values[row], 0.0
        for i in range(channels):
            largest = max(largest, abs(own[i]))
        floor = 2.220446049250313e-16 * largest
        for i in range(channels - 2):
            second[i] = abs((own[i + 2] - own[i + 1]) - (own[i + 1] - own[i]))
        ordered[:] = np.sort(second[: 2 * half + 1])
        first, last = half + 1, channels - 2 - half
        for i in range(channels):
            if first < i <= last:
                _replace(ordered, second[i - half - 2], second[i + half - 1])
            noise[row, i] = max(ordered[half] * NORMAL_MAD / SECOND_DIFFERENCE, floor)


@compiled
def _replace(ordered: Any, old: float, new: float) -> None:
    """Take one number out of an ordered array and put another in."""
    at, last = np.searchsorted(ordered, old), ordered.size - 1
    while at < last and ordered[at + 1] < new:
        ordered[at] = ordered[at + 1]
        at += 1
    while at > 0 and ordered[at - 1] > new:
        ordered[at] = ordered[at - 1]
        at -= 1
    ordered[at] = new


def deepest_below_hull(x: FloatArray, values: FloatArray) -> FloatArray:
    """How far the lowest point of every row, (rows, n) over ascending x (n,), lies below the row's upper hull, (rows,).

    Andrew (1979), 10.1016/0020-0190(79)90072-3 (hull).
    """
    deepest = np.zeros(len(values))
    _below_hulls(np.ascontiguousarray(x), np.ascontiguousarray(values), deepest)
    return deepest


@compiled(nogil=True)  # type: ignore[untyped-decorator]
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
