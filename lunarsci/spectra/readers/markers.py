"""Numbers that stand for no data: they lie far from everything measured, and are not among the measured ones.

No library does this for a file that does not name its marker.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.spectra.readers.table import MAX_PERCENT, SpectrumTable

DELETED_BELOW = -1e30
"""ENVI and USGS write -1.23e34 for a deleted channel (Kokaly et al. 2017, 10.3133/ds1035); no reflectance is near."""
FAR = 10.0
"""Times the largest of the others that a number is at least which is none of them; assumed."""
FEWEST_OTHERS = 10
"""Numbers beside one that repeats, and that could be a reflectance by its size, before it is a marker; assumed."""
MOST_MARKERS = 3
"""Different markers of a file; assumed."""


def without_deleted(values: FloatArray) -> IntArray:
    """Make deleted and infinite values NaN; the number of deleted ones in each row."""
    with np.errstate(invalid="ignore"):
        deleted = values <= DELETED_BELOW
    values[deleted | ~np.isfinite(values)] = np.nan
    return np.asarray(deleted.sum(axis=-1))


def markers_of(values: FloatArray) -> list[float]:
    """Numbers of rows (n, c) that mark channels without data, e.g. 65535, -999 or 1e30; NaN is none.

    The number farthest from 0 is one where all that is larger than a tenth of it is that same number, and where it
    repeats beside ten others or could be no reflectance in percent. Then the next, with the first left out.
    """
    size = np.abs(values)
    found = list[float]()
    for _ in range(MOST_MARKERS):
        top = np.fmax.reduce(size, axis=1)
        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(_far(size, top))
            new = {float(one) for row in rows.tolist() for one in np.unique(values[row][size[row] == top[row]])}
        new = {one for one in new if -one not in new}
        if not new:
            break
        found += sorted(new)
        size = np.where(np.isin(values, found), np.nan, size)
    return found


def _far(size: FloatArray, top: FloatArray) -> BoolArray:
    """Rows whose largest number is far from all others. (n,)"""
    same = (size == top[:, None]).sum(axis=1)
    near = (size > top[:, None] / FAR).sum(axis=1)
    others = ((size > 0) & (size <= top[:, None] / FAR)).sum(axis=1)
    impossible = (top > MAX_PERCENT) & (others > 0)
    return np.asarray((near == same) & (impossible | ((same > 1) & (others >= FEWEST_OTHERS))))


def unnamed_markers(parts: Sequence[npt.NDArray[Any]], known: Sequence[float]) -> list[float]:
    """Numbers of parts of a cube that mark no data, beside those that are known: far from all others of all parts."""
    seen = np.concatenate([np.empty(0), *(part.ravel() for part in parts)])[None]
    seen[np.isin(seen, known) | ~np.isfinite(seen) | (seen <= DELETED_BELOW)] = np.nan
    return [] if np.isnan(seen).all() else markers_of(seen)


def without_markers(table: SpectrumTable) -> tuple[SpectrumTable, IntArray, list[str]]:
    """A table with NaN for numbers that mark no data, in its `block`; how many were deleted, or marked, (n, 2)."""
    values = table.reflectances
    deleted = without_deleted(values)
    count = np.stack([deleted, np.zeros_like(deleted)], axis=1)
    said = list[str]()
    if found := markers_of(values):
        marked = np.isin(values, found)
        values[marked] = np.nan
        count[:, 1] = marked.sum(axis=1)
        listed = ", ".join(f"{one:g}" for one in found)
        said = [f"{listed} read as the mark of no data: {int(marked.sum())} values left out"]
    return replace(table, block=values), count, said
