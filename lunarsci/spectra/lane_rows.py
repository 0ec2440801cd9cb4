"""Spectra in the lanes of vector instructions: how they get there, and code that only borrows its arrays."""

from collections.abc import Callable
from typing import Any

from lunarsci.arrays import FloatArray
from lunarsci.compiled import in_lanes
from lunarsci.compiled.formulas import LANES


def uncounted(function: Callable[..., Any]) -> Any:
    """`in_lanes` without counts of who uses an array, which cost more than a short loop; such code can make none."""
    return in_lanes(function, _nrt=False)


@uncounted
def take_eight(rows: FloatArray, begin: int, t: Any, first: int) -> None:
    """Rows of (m, n) into the lanes of a table, from its row `first` on; the last one again where there are no more."""
    for lane in range(LANES):
        row = min(begin + lane, len(rows) - 1)
        for j in range(rows.shape[1]):
            t[first + j, lane] = rows[row, j]
