"""Neighbouring channels put together: bands are tens of channels wide, so a coarse spectrum leads near the minimum at a
fraction of the cost."""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.curvature import update
from lunarsci.spectra.mgm.descent import Channels, channels_of, fill_lane
from lunarsci.spectra.mgm.lanes import LANES, choose, load, spread, store
from lunarsci.spectra.mgm.moments import evaluate
from lunarsci.spectra.mgm.normal import solve_step

__all__ = ["COARSE_CHANNELS", "coarse_size", "coarsened", "correct"]

COARSE_CHANNELS = 128
"""On simulated spectra 48 find the minima as often and 10 % faster; on rover spectra, whose misfit is not noise, the
order of their many minima is then too often another than on all channels."""


def coarse_size(channels: int) -> int:
    """How many channels are put together so that about `COARSE_CHANNELS` remain."""
    return max(1, round(channels / COARSE_CHANNELS))


def coarsened(fine: Channels, together: int) -> Channels:
    """Weighted means of `together` channels each; channels without weight do not count."""
    rows, channels = fine.data.shape
    cells = -(-channels // together)
    coarse = Channels(
        np.empty((rows, cells)), np.empty((rows, fine.columns.shape[1], cells)), np.empty((rows, cells)),
        np.empty((rows, cells)),
    )  # fmt: skip
    _coarsen(fine, together, coarse)
    return coarse


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _coarsen(fine: Any, together: int, coarse: Any) -> None:
    rows, channels = fine.data.shape
    for row in range(rows):
        own = min(row, fine.wavelength.shape[0] - 1)
        for cell in range(coarse.data.shape[1]):
            first, last = cell * together, min((cell + 1) * together, channels)
            total = 0.0
            for i in range(first, last):
                total += fine.root_weight[row, i] ** 2
            place, value = 0.0, 0.0
            for m in range(fine.columns.shape[1]):
                coarse.columns[row, m, cell] = 0.0
            for i in range(first, last):
                share = fine.root_weight[row, i] ** 2 / total if total > 0.0 else 1.0 / (last - first)
                place += share * fine.wavelength[own, i]
                value += share * fine.data[row, i]
                for m in range(fine.columns.shape[1]):
                    coarse.columns[row, m, cell] += share * fine.columns[own, m, i]
            coarse.wavelength[row, cell], coarse.data[row, cell] = place, value
            coarse.root_weight[row, cell] = math.sqrt(total)


@compiled
def _slope(room: Any, task: Any, curved: int) -> None:
    """Residuals, J r and, where `curved` is 1, J J' of a room's spectra at its trial points."""
    evaluate(
        channels_of(room), room.trial, task.degrees, task.logarithmic, curved, room.work, room.residuals, room.sums
    )
    update(room.sums, room.trial, task.degrees, spread(1.0), room.curvature, room.slope)


@compiled
def _shift_to_means(fine: Any, coarse: Any, together: int) -> None:
    """Shift the coarse data so that the coarse residuals are the means of the fine ones."""
    count = fine.residuals.shape[0]
    for cell in range(-(-count // together)):
        total = spread(0.0)
        for i in range(cell * together, min((cell + 1) * together, count)):
            total += load(fine.roots, i) * load(fine.residuals, i)
        own = load(coarse.roots, cell)
        weight = choose(own, own, spread(1.0))
        shift = (total / weight - load(coarse.residuals, cell)) / weight
        store(coarse.data, cell, load(coarse.data, cell) + choose(own, shift, spread(0.0)))


@compiled
def _shift_slope(fine: Any, coarse: Any, task: Any) -> None:
    """Shift the coarse data by what the model changes along the step by which the two slopes differ."""
    size = coarse.point.shape[0]
    one, none = spread(1.0), spread(0.0)
    for p in range(size):
        store(coarse.slope, p, load(fine.slope, p) - load(coarse.slope, p))
        store(coarse.pull, p, none)
        store(coarse.free, p, one)
    least = solve_step(
        coarse.curvature, task.precision, one, one, coarse.slope, coarse.pull, coarse.free, 0,
        coarse.matrix, coarse.step,
    )  # fmt: skip
    for p in range(size):
        store(coarse.trial, p, load(coarse.point, p) + choose(least, load(coarse.step, p), none))
    before = coarse.residuals.copy()
    _slope(coarse, task, 0)
    for i in range(coarse.data.shape[0]):
        own = load(coarse.roots, i)
        shift = (load(before, i) - load(coarse.residuals, i)) / choose(own, own, one)
        store(coarse.data, i, load(coarse.data, i) + shift)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def correct(fine: Any, coarse: Any, together: int, task: Any, points: Any, fine_room: Any, coarse_room: Any) -> None:
    """Shift the coarse data so that at the points, (rows, p), coarse residuals are the means of the fine ones and the
    slope of the coarse objective is that of the fine one.

    What the model and the noise do within a coarse channel is then accounted for, and minima near the points are the
    same. The correction of full approximation storage: Brandt (1977), Math. Comp. 31, 333,
    10.1090/S0025-5718-1977-0431719-X; here it is put on the data, which keeps the objective a sum of squares.
    """
    rows = points.shape[0]
    for first in range(0, rows, LANES):
        for lane in range(LANES):
            row = min(first + lane, rows - 1)
            fill_lane(fine, row, fine_room, lane)
            fill_lane(coarse, row, coarse_room, lane)
            for p in range(points.shape[1]):
                fine_room.trial[p, lane] = points[row, p]
                coarse_room.trial[p, lane] = points[row, p]
                coarse_room.point[p, lane] = points[row, p]
        _slope(fine_room, task, 0)
        _slope(coarse_room, task, 0)
        _shift_to_means(fine_room, coarse_room, together)
        _slope(coarse_room, task, 1)
        _shift_slope(fine_room, coarse_room, task)
        for lane in range(min(LANES, rows - first)):
            for cell in range(coarse.data.shape[1]):
                coarse.data[first + lane, cell] = coarse_room.data[cell, lane]
