"""Values that stand for none where a file does not say which they are: heights, and the law of all such marks."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray

MARKERS = (
    *(-9999.0, -99999.0, -999999.0, 9999.0, 99999.0, 999999.0),
    *(-32768.0, -32767.0, -32766.0, 32767.0, 65535.0, -2147483648.0, 2147483647.0),
)
"""Numbers that stand for no height: those of ESRI's grids, and the ends of integers of 16 and 32 bits; assumed."""
USUALLY = "are without data, as such numbers are usually"
BEYOND = 1e19
"""No height is larger: -3.4e38, 1e20, 1.7e38 and -1e32 stand for none. [m]"""


def without_markers(heights: FloatArray) -> tuple[FloatArray, str]:
    """Heights with NaN for what stands for none, and what was taken for that, '' where nothing was.

    A marker is a usual one, the lowest or highest number of all, and farther from the next one than that is from the
    others: a gap that is wider than all of the ground is high.
    """
    found = np.where(np.isinf(heights) | (np.abs(heights) > BEYOND), np.nan, heights)
    said = [f"{_of(value)}" for value in np.unique(heights[~np.isnan(heights) & np.isnan(found)])[:1]]
    while (marker := _marker(found)) is not None:
        said.append(_of(marker))
        found = np.where(found == marker, np.nan, found)
    lost = int(np.isnan(found).sum() - np.isnan(heights).sum())
    return found, f"{lost} nodes of {' and '.join(said)} {USUALLY}" if said else ""


def _of(value: float) -> str:
    return f"{value:g}" if math.isfinite(value) else "infinity"


def _marker(heights: FloatArray) -> float | None:
    """A height has no natural 0, so that only usual marks are looked for."""
    ends = far_ends(heights.reshape(1, -1), times=1.0, from_zero=False)
    return next((one.value for one in ends if one.value in MARKERS), None)


class FarEnd(NamedTuple):
    """The lowest or highest number of a row, how often it is there, and how many others are."""

    value: float
    repeats: int
    others: int


def far_ends(rows: FloatArray, times: float, *, from_zero: bool) -> Iterator[FarEnd]:
    """Ends of rows (n, c) that are farther from the next number than `times` the range of all others; NaN is none.

    The range is that of the others and of 0 where numbers are measured `from_zero`, as reflectances are.
    """
    for end in (np.fmin, np.fmax):
        edge = end.reduce(rows, axis=1)[:, None]
        at = rows == edge
        others = np.where(at, np.nan, rows)
        count = np.isfinite(others).sum(axis=1)
        low, high = np.fmin.reduce(others, axis=1), np.fmax.reduce(others, axis=1)
        if from_zero:
            low, high = np.fmin(low, 0.0), np.fmax(high, 0.0)
        with np.errstate(invalid="ignore"):
            gap = (low - edge[:, 0]) if end is np.fmin else (edge[:, 0] - high)
            far = (gap > times * (high - low)) & (count > 0)
        for row in np.flatnonzero(far).tolist():
            yield FarEnd(float(edge[row, 0]), int(at[row].sum()), int(count[row]))
