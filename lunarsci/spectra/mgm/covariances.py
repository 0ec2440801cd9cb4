"""Covariances of many fits: the inverse curvatures, eight at a time."""

from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.cholesky import factorise, invert, matrix_side
from lunarsci.spectra.mgm.descent import Room, Task
from lunarsci.spectra.mgm.lanes import LANES, spread, store
from lunarsci.spectra.mgm.normal import damped
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["inverses"]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _invert_all(curvatures: Any, task: Any, room: Any, covariances: Any) -> None:
    jobs, size, state = curvatures.shape[0], curvatures.shape[1], room.state
    one, side = spread(1.0), matrix_side(room.matrix)
    for first in range(0, jobs, LANES):
        for p in range(size):
            store(room.free, p, one)
            for q in range(p, size):
                for lane in range(LANES):
                    room.curvature[p * size + q, lane] = curvatures[min(first + lane, jobs - 1), p, q]
        damped(room.curvature, task.precision, one, one, room.free, size, side, room.matrix)
        store(state, 0, factorise(room.matrix, side))
        invert(room.matrix, size, side, room.curvature)
        for lane in range(min(LANES, jobs - first)):
            regular = state[0, lane] > 0.0
            for p in range(size):
                for q in range(p, size):
                    value = room.curvature[p * size + q, lane] if regular else np.nan
                    covariances[first + lane, p, q] = value
                    covariances[first + lane, q, p] = value


def inverses(curvatures: FloatArray, task: Task, room: Room) -> FloatArray:
    """(J J' + precision)^-1 from the upper triangles of J J', (jobs, p, p); NaN where there is none."""
    covariances = np.empty_like(curvatures)
    _invert_all(curvatures, task, room, covariances)
    return covariances
