"""What the search of a path looks up at a point: distance from the nearest obstacle, and cost of a metre."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.compiled import compiled
from lunarsci.twin.ground.hazards import Traversability

BoolMap = BoolArray


class Window(NamedTuple):
    """What `drive_arc` reads: origin and spacing [m], and at each node (ny, nx, 2) distance [m] and cost of a metre."""

    x0: float
    y0: float
    spacing: float
    values: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchGround:
    """A rectangle of the map about start and target.

    Attributes
    ----------
    window : distance from the nearest obstacle, negative inside one, and cost of a metre.
    rows, columns : which part of the map it is.
    border : nodes of obstacles next to free ones, as rows and columns of the whole map. (n, 2)
    """

    window: Window
    rows: slice
    columns: slice
    border: IntArray


def search_ground(surface: Traversability, points_m: FloatArray, margin_m: float) -> SearchGround:
    """Distances and costs in a box about some points (n, 2) [m] and a margin about them.

    Obstacles are nodes whose height is unknown or where a limit is exceeded; beyond the edge of the map all is unknown.
    """
    from scipy.ndimage import binary_erosion, distance_transform_edt

    terrain = surface.terrain
    rows, columns = (
        slice(*np.searchsorted(axis, (ends.min() - margin_m, ends.max() + margin_m)))
        for axis, ends in ((terrain.y_m, points_m[:, 1]), (terrain.x_m, points_m[:, 0]))
    )
    blocked = surface.hazard[rows, columns] | np.isnan(terrain.height_m[rows, columns])
    # The frame of the box is a wall, so that nothing beyond it can come near the path.
    walled = np.pad(blocked, 1, constant_values=True)
    free, inside = (distance_transform_edt(mask, terrain.spacing_m)[1:-1, 1:-1] for mask in (~walled, walled))
    values = np.empty((*blocked.shape, 2), dtype=np.float32)
    values[..., 0] = np.where(blocked, -inside, free)
    values[..., 1] = np.where(surface.unknown[rows, columns], np.inf, surface.travel_cost(rows, columns))
    border = np.argwhere(walled & ~binary_erosion(walled, border_value=1))
    border += np.array([rows.start - 1, columns.start - 1])
    return SearchGround(
        window=Window(float(terrain.x_m[columns.start]), float(terrain.y_m[rows.start]), terrain.spacing_m, values),
        rows=rows,
        columns=columns,
        border=border[_real(border, surface.demand.shape, rows, columns)],
    )


def _real(border: IntArray, whole: tuple[int, ...], rows: slice, columns: slice) -> BoolMap:
    """Which border nodes are obstacles or lie beyond the map, and not just beyond the box."""
    row, column = border.T
    in_box = (row >= rows.start) & (row < rows.stop) & (column >= columns.start) & (column < columns.stop)
    in_map = (row >= 0) & (row < whole[0]) & (column >= 0) & (column < whole[1])
    return np.asarray(in_box | ~in_map)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def drive_arc(
    window: Any, discs: Any, pose: Any, length: float, curvature: float, step: float, need: float, wanted: float,
    stop: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Cost of an arc, how far it falls short of the clearance, and how far it could be driven.

    Parameters
    ----------
    window : a `Window`.
    discs : places of the covering discs along the rover's x (n,). [m]
    pose : x, y, heading at its start. [m, m, rad]
    length, curvature, step : of the arc, and the distance of the places looked at. [m, 1/m, m]
    need, wanted : least distance of the disc centres from obstacles, and the one below which cost rises. [m]
    stop : leave at the first place that is too near.

    Cost is the integral of the cost of a metre times 1 + ((wanted - distance) / (wanted - need))^2 where the distance
    is below `wanted`; shortfall is the integral of need - distance where that is positive, and of 1 m where the origin
    is on unknown ground. Maps are bilinear; beyond them all is an obstacle. Returns (cost [m], shortfall [m2], length
    driven [m]).
    """
    ny, nx = window.values.shape[:2]
    pieces = max(int(np.ceil(length / step)), 1)
    ds = length / pieces
    cost, shortfall = 0.0, 0.0
    for number in range(pieces):
        s = (number + 1) * ds
        half = 0.5 * s * curvature
        chord = s if abs(half) < 1e-9 else s * np.sin(half) / half
        x = pose[0] + chord * np.cos(pose[2] + half)
        y = pose[1] + chord * np.sin(pose[2] + half)
        heading = pose[2] + 2.0 * half
        ahead, aside = np.cos(heading), np.sin(heading)
        nearest, metre = 1e9, 0.0
        for place in range(-1, len(discs)):
            along = 0.0 if place < 0 else discs[place]
            column = (x + along * ahead - window.x0) / window.spacing
            row = (y + along * aside - window.y0) / window.spacing
            if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
                nearest, metre = -1.0, np.inf
                continue
            j, i = min(int(column), nx - 2), min(int(row), ny - 2)
            a, b = column - j, row - i
            layer = 1 if place < 0 else 0
            low = (1.0 - a) * window.values[i, j, layer] + a * window.values[i, j + 1, layer]
            high = (1.0 - a) * window.values[i + 1, j, layer] + a * window.values[i + 1, j + 1, layer]
            value = (1.0 - b) * low + b * high
            if place >= 0:
                nearest = min(nearest, value)
            elif value < np.inf:
                metre = value
            else:
                nearest, metre = need - 1.0, 100.0
        metre = min(metre, 100.0)
        if nearest < wanted:
            metre *= 1.0 + ((wanted - nearest) / (wanted - need)) ** 2
        cost += metre * ds
        if nearest < need:
            if stop:
                return cost, np.inf, number * ds
            shortfall += (need - nearest) * ds
    return cost, shortfall, length


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def drive_arcs(
    window: Any, discs: Any, poses: Any, lengths: Any, curvatures: Any, step: float, need: float, wanted: float
) -> Any:
    """`drive_arc` with `stop` from each of the poses (n, 3): cost, infinite when stopped, and length driven. (n, 2)"""
    result = np.empty((len(lengths), 2))
    for n in range(len(lengths)):
        cost, shortfall, driven = drive_arc(
            window, discs, poses[n], lengths[n], curvatures[n], step, need, wanted, True
        )
        result[n, 0] = cost + shortfall
        result[n, 1] = driven
    return result


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def drive_course(
    window: Any, discs: Any, start: Any, arcs: Any, step: float, need: float, wanted: float
) -> tuple[float, float]:
    """Cost [m] and shortfall [m2], as in `drive_arc`, of arcs (n, 2) of length and curvature one after the other."""
    pose = start.copy()
    cost, shortfall = 0.0, 0.0
    for n in range(len(arcs)):
        length, curvature = arcs[n, 0], arcs[n, 1]
        more, short, _ = drive_arc(window, discs, pose, length, curvature, step, need, wanted, False)
        cost += more
        shortfall += short
        half = 0.5 * length * curvature
        chord = length if abs(half) < 1e-9 else length * np.sin(half) / half
        pose[0] += chord * np.cos(pose[2] + half)
        pose[1] += chord * np.sin(pose[2] + half)
        pose[2] += 2.0 * half
    return cost, shortfall
