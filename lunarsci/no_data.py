"""Values that stand for none where a file does not say which they are."""

import math

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
    known = heights[~np.isnan(heights)]
    if not known.size:
        return None
    for value in (float(known.min()), float(known.max())):
        others = known[known != value] if value in MARKERS else np.empty(0)
        if others.size and np.abs(others - value).min() > np.ptp(others):
            return value
    return None
