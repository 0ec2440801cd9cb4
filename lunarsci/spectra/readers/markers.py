"""Numbers that stand for no data: they lie far from everything measured, and are not among the measured ones.

No library does this for a file that does not name its marker.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray, IntArray, spans
from lunarsci.heights.grid import far_ends
from lunarsci.spectra.readers.table import MAX_PERCENT, SpectrumTable

DELETED_BELOW = -1e30
"""ENVI and USGS write -1.23e34 for a deleted channel (Kokaly et al. 2017, 10.3133/ds1035); no reflectance is near."""
FAR = 9.0
"""Times the largest of the others by which a number that is none of them lies beyond it; assumed."""
FEWEST_OTHERS = 10
"""Numbers beside one that repeats, and that could be a reflectance by its size, before it is a marker; assumed."""
MOST_MARKERS = 3
"""Different markers of a file; assumed."""
_AT_ONCE = 256


def without_deleted(values: FloatArray) -> IntArray:
    """Make deleted and infinite values NaN; the number of deleted ones in each row."""
    with np.errstate(invalid="ignore"):
        deleted = values <= DELETED_BELOW
    values[deleted | ~np.isfinite(values)] = np.nan
    return np.asarray(deleted.sum(axis=-1))


def markers_of(values: FloatArray) -> list[float]:
    """Numbers of rows (n, c) that mark channels without data, e.g. 65535, -999 or 1e30; NaN is none.

    An end of a row is one where it is far from all others, and repeats beside ten of them or could be no reflectance in
    percent. Then the next, with the first left out.
    """
    found, left = list[float](), values
    for _ in range(MOST_MARKERS):
        parts = (left[block.start : block.stop] for block in spans(len(left), _AT_ONCE))
        new = {
            one.value for part in parts for one in far_ends(part, FAR, from_zero=True)
            if abs(one.value) > MAX_PERCENT or (one.repeats > 1 and one.others >= FEWEST_OTHERS)
        }  # fmt: skip
        if not new:
            break
        found += sorted(new)
        left = np.where(np.isin(left, found), np.nan, left)
    return found


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
