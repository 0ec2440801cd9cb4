"""Detectors of one spectrum that overlap, or repeat wavelengths: told apart, brought to one level, and joined.

As the detectors of VNIS are spliced: the one at shorter wavelengths is scaled to the other where they overlap, by the
median ratio there, and they are joined in the middle. The grid and the level tell detectors apart; no library does.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.spectra.readers.likely import LEAST_STEP, MOST_DETECTORS, STEP_CHANNELS, STEP_SURE, scatter_of
from lunarsci.spectra.readers.table import SpectrumTable

EVEN = 0.25
"""Share by which steps of one detector differ from the one before, at most; assumed."""


def joined(table: SpectrumTable, wavelength_nm: FloatArray) -> tuple[SpectrumTable, FloatArray, list[str]]:
    """A table with one row for each channel where detectors overlap, its wavelengths, and what to say. [nm]

    The same where they do not. The reflectances are those of `table.block`.
    """
    steps = np.diff(wavelength_nm)
    sorted_rows = (steps >= 0).all() or (steps <= 0).all()
    ways = (_interleaved, _runs) if sorted_rows else (_runs, _interleaved)
    parts = ways[0](table, wavelength_nm) or ways[1](table, wavelength_nm)
    if not parts:
        return _without_copies(table, wavelength_nm)
    gain, keep, notes = np.ones(table.reflectances.shape), np.zeros(wavelength_nm.size, bool), list[str]()
    keep[parts[-1]] = True
    for low, high in reversed(list(pairwise(parts))):
        first, last = wavelength_nm[high[0]], wavelength_nm[low[-1]]
        middle = 0.5 * (first + last)
        keep[low], keep[high] = wavelength_nm[low] < middle, keep[high] & (wavelength_nm[high] >= middle)
        ratio = np.array([_ratio(wavelength_nm, one, low, high) for one in table.reflectances * gain])
        gain[:, low] *= ratio[:, None]
        notes.append(
            f"two detectors overlap at {first:.5g}-{last:.5g} nm: read as one spectrum, the first scaled by "
            f"{float(np.median(ratio)):.4g} to the second and joined at {middle:.5g} nm; give each by itself to keep "
            "them apart"
        )
    chosen = np.concatenate([part[keep[part]] for part in parts])
    return table.taken(chosen, gain), wavelength_nm[chosen], notes


def _without_copies(table: SpectrumTable, wavelength_nm: FloatArray) -> tuple[SpectrumTable, FloatArray, list[str]]:
    """A table without rows that repeat another one, wavelength and all."""
    if np.unique(wavelength_nm).size == wavelength_nm.size:
        return table, wavelength_nm, []
    rows = np.vstack([wavelength_nm, np.nan_to_num(table.reflectances, nan=-1.0)])
    chosen = np.sort(np.unique(rows, axis=1, return_index=True)[1])
    if chosen.size == wavelength_nm.size:
        return table, wavelength_nm, []
    notes = [f"{wavelength_nm.size - chosen.size} rows that repeat another one are left out"]
    return table.taken(chosen), wavelength_nm[chosen], notes


def _runs(table: SpectrumTable, wavelength_nm: FloatArray) -> list[IntArray]:
    """Rows of each detector, ascending, where the file has one after the other and they overlap; else none."""
    rows = np.arange(len(table.places))
    if rows.size > 1 and np.median(np.diff(wavelength_nm)) < 0:
        rows = rows[::-1]
    parts = np.split(rows, np.flatnonzero(np.diff(wavelength_nm[rows]) <= 0) + 1)
    parts.sort(key=lambda part: float(wavelength_nm[part[0]]))
    return parts if _overlap(wavelength_nm, parts) else []


def _overlap(wavelength_nm: FloatArray, parts: Sequence[IntArray]) -> bool:
    """Whether each of a few detectors begins within the one before it, and ends beyond it."""
    if not 2 <= len(parts) <= MOST_DETECTORS or min(map(len, parts)) < STEP_CHANNELS:
        return False
    ends = [(wavelength_nm[part[0]], wavelength_nm[part[-1]]) for part in parts]
    return all(a < c <= b < d for (a, b), (c, d) in pairwise(ends))


def _interleaved(table: SpectrumTable, wavelength_nm: FloatArray, left: int = MOST_DETECTORS - 2) -> list[IntArray]:
    """The same where rows are sorted by wavelength: two even grids, one in the other, on two levels."""
    order = np.argsort(wavelength_nm, kind="stable")
    parts = _two_grids(wavelength_nm[order], table.reflectances[0][order])
    if not parts:
        return []
    low, high = (order[part] for part in parts)
    if not _overlap(wavelength_nm, [low, high]):
        return []
    repeated = bool((np.diff(wavelength_nm[order]) == 0).any())
    if not repeated and not any(_level_sure(wavelength_nm, one, low, high) for one in table.reflectances):
        return []
    beyond = table.reflectances[:, high]
    rest = _interleaved(replace(table, block=beyond), wavelength_nm[high], left - 1) if left > 0 else []
    return [low, *(high[part] for part in rest)] if rest else [low, high]


def _two_grids(ascending: FloatArray, values: FloatArray) -> list[IntArray]:
    """Places of channels that follow each other evenly from the first on, and of the others; none where these are few.

    Where two could follow, the one nearer in value does. What follows evenly beyond the last of the others is theirs.
    """
    steps = np.diff(ascending)
    if ascending.size < 4 * STEP_CHANNELS or (steps[1:] >= (1 - EVEN) * steps[:-1]).all():
        return []
    one = _even(ascending, values)
    other = np.setdiff1d(np.arange(ascending.size), one)
    if not other.size:
        return []
    end = min(one[-1], other[-1])
    low, high = one[one <= end], np.sort(np.concatenate([other, one[one > end]]))
    while low.size > 1 and high.size > 1 and _is_missed(ascending[low[-1]], ascending[high]):
        low, high = low[:-1], np.sort(np.append(high, low[-1]))
    if low.size < STEP_CHANNELS or high.size < STEP_CHANNELS or low[-1] < high[0]:
        return []
    beside = np.diff(ascending[high[: np.searchsorted(high, low[-1]) + 2]])
    return [low, high] if beside.max() <= (1 + EVEN) * beside.min() else []


def _is_missed(at: float, grid: FloatArray) -> bool:
    """Whether a grid has a gap of two steps at a wavelength: it belongs there."""
    place = int(np.searchsorted(grid, at))
    return 0 < place < grid.size and bool(grid[place] - grid[place - 1] > 1.5 * np.median(np.diff(grid)))


def _even(ascending: FloatArray, values: FloatArray) -> IntArray:
    """Places of channels from the first on, each a step from the one before that is as long as the last, or nearly."""
    one, step = [0], ascending[1] - ascending[0]
    while True:
        expected = ascending[one[-1]] + step
        first, last = np.searchsorted(ascending, [expected - EVEN * step, expected + EVEN * step * (1 + 1e-9)])
        if (first := max(first, one[-1] + 1)) >= last:
            return np.array(one)
        off = np.abs(values[first:last] - values[one[-1]])
        chosen = int(first + (np.nanargmin(off) if np.isfinite(off).any() else 0))
        step = ascending[chosen] - ascending[one[-1]]
        one.append(chosen)


def _differences(wavelength_nm: FloatArray, values: FloatArray, low: IntArray, high: IntArray) -> FloatArray:
    """ln of the second detector, by a cubic spline, over the first in their common channels; those above 0."""
    from scipy.interpolate import CubicSpline, interp1d

    with np.errstate(invalid="ignore"):
        low, high = (part[values[part] > 0] for part in (low, high))
    if not low.size or not high.size:
        return np.empty(0)
    x = wavelength_nm[high]
    within = low[(wavelength_nm[low] >= x[0]) & (wavelength_nm[low] <= x[-1])]
    if not within.size:
        return np.empty(0)
    level = np.log(values[high])
    spline = CubicSpline(x, level) if x.size > STEP_CHANNELS else interp1d(x, level)
    return np.asarray(spline(wavelength_nm[within]) - np.log(values[within]))


def _ratio(wavelength_nm: FloatArray, values: FloatArray, low: IntArray, high: IntArray) -> float:
    """Of the second detector to the first, by the median where both measured; 1 where nothing tells."""
    result = _differences(wavelength_nm, values, low, high)
    return float(np.exp(np.median(result))) if result.size else 1.0


def _level_sure(wavelength_nm: FloatArray, values: FloatArray, low: IntArray, high: IntArray) -> bool:
    """Whether the levels of two grids differ by more than their common channels, and all of each, scatter."""
    result = _differences(wavelength_nm, values, low, high)
    if not result.size:
        return False
    levels = [np.log(values[part][values[part] > 0]) for part in (low, high)]
    scatter = max(scatter_of(level) if level.size > 2 else np.inf for level in levels)
    error = max(scatter, float(result.std(ddof=1)) if result.size > 1 else 0.0) / result.size**0.5
    return bool(abs(float(result.mean())) > max(LEAST_STEP, STEP_SURE * error))
