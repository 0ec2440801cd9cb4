"""The ground that wheels leave behind, and what the next wheel meets in it, for a group of rovers.

Every rover presses its own ruts into a grid of nodes: how deep below the undisturbed ground a wheel has been. When the
wheel has gone the soil springs back, and a wheel that follows loads it again along a line that meets the first loading
where that ended (Wong 2008, Theory of Ground Vehicles, 4th ed., ch. 2):

    p = p_u - (k_0 + A_u z_u) (z_u - z),   k_0 = p_u / z_u.

A rut changes height and bearing of the ground, not its shear strength. Beside a track a wheel meets the share of it
that both widths have in common, so that one that is partly on the wall is carried partly by the undisturbed ground.
That the wall also pushes against the side of a wheel is left out.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.compiled.lanes import exponential, logarithm
from lunarsci.errors import ParameterError
from lunarsci.twin.lanes import FINISHED, GROUP, WHEEL, Work
from lunarsci.twin.simulation.contact_frame import SHALLOWEST

RISE_N_M4 = 503e6
"""A_u of a dry sand (LETE sand, Wong 2008, table 2.4, not checked against the book), assumed for regolith, of which
none is published. [N m^-4]"""
SPACING_M = 0.0353
"""Of the nodes, assumed: a quarter of a wheel's width, and no whole part of anything on a rover."""
BEHIND = 3.0
"""How far behind the axle a rut is left, in spacings: its strip reaches 2 ahead, and a wheel meets nodes 1 off.
Assumed."""
MOST_NODES = 2e7
"""Of one rover's grid; memory is taken only where a wheel rolls."""


AXLE, CENTER, GROUND, RIM, RUT, SINKAGE, SOIL = (
    WHEEL.first[name] for name in ("axle", "center", "ground", "rim", "rut", "sinkage", "soil")
)


class RutGrid(NamedTuple):
    """Where ruts are kept: nodes (rows, columns), and `Work.frame`."""

    shape: tuple[int, int]
    frame: FloatArray


def rut_grid(start: FloatArray, places: FloatArray, margin_m: float) -> RutGrid:
    """The nodes about a way.

    Parameters
    ----------
    start : x, y, heading, along which the grid lies. (3,) [m, m, rad]
    places : x, y that the rover's origin is to pass. (n, 2) [m]
    margin_m : how far from these it is covered; beyond there are no ruts. [m]

    Raises ParameterError for more than 20 million nodes.
    """
    c, s = math.cos(start[2]), math.sin(start[2])
    off = places - start[:2]
    along, aside = c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0]
    # Alike on both sides of the start, so that a mirrored drive has mirrored nodes.
    wide = math.ceil((float(np.abs(aside).max()) + margin_m) / SPACING_M)
    back = math.ceil((margin_m - float(along.min())) / SPACING_M)
    ahead = math.ceil((margin_m + float(along.max())) / SPACING_M)
    shape = (2 * wide + 1, back + ahead + 1)
    if shape[0] * shape[1] > MOST_NODES:
        raise ParameterError("the plan is too long for ruts; leave them out, or drive it in parts")
    return RutGrid(shape, np.array([start[0], start[1], c / SPACING_M, s / SPACING_M, back, wide, 1.0]))


def with_ruts(work: Work, grid: RutGrid) -> Work:
    """`work` with undisturbed ground for ruts."""
    return work._replace(ruts=np.zeros((GROUP, *grid.shape, 2)), frame=grid.frame.copy())


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def depth_at(ruts: Any, lane: int, column: float, row: float) -> tuple[float, float]:
    """How deep the ground was pressed at a place between nodes, and how deep it is still; 0 beyond them. [m]"""
    ny, nx = ruts.shape[1], ruts.shape[2]
    if not (0.0 <= column < nx - 1 and 0.0 <= row < ny - 1):
        return 0.0, 0.0
    j, i = int(column), int(row)
    a, b = column - j, row - i
    w_0, w_1, w_2, w_3 = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    k, m = i + 1, j + 1
    return (
        w_0 * ruts[lane, i, j, 0] + w_1 * ruts[lane, i, m, 0] + w_2 * ruts[lane, k, j, 0] + w_3 * ruts[lane, k, m, 0],
        w_0 * ruts[lane, i, j, 1] + w_1 * ruts[lane, i, m, 1] + w_2 * ruts[lane, k, j, 1] + w_3 * ruts[lane, k, m, 1],
    )


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def still_deep(pressed: float, stiffness: float, exponent: float) -> float:
    """Depth of a rut when the wheel has gone. [m]"""
    if not pressed > SHALLOWEST:
        return 0.0
    load = stiffness * exponential(exponent * logarithm(pressed))
    return float(pressed - pressed * load / (load + RISE_N_M4 * pressed * pressed))


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def read_ruts(work: Any, w: int) -> None:
    """Lower the ground of wheel `w` by what is left of the ruts below it, looked up anew where `frame` says so."""
    frame, wheel = work.frame, work.wheels[w]
    for lane in range(GROUP):
        if work.code[lane] != FINISHED:
            continue
        if frame[6] > 0.0:
            x, y = wheel[CENTER * GROUP + lane] - frame[0], wheel[(CENTER + 1) * GROUP + lane] - frame[1]
            column, row = frame[2] * x + frame[3] * y + frame[4], frame[2] * y - frame[3] * x + frame[5]
            found = depth_at(work.ruts, lane, column, row)
            wheel[RUT * GROUP + lane], wheel[(RUT + 1) * GROUP + lane] = found
        left = wheel[(RUT + 1) * GROUP + lane]
        if left > 0.0:
            slope_x, slope_y = wheel[(GROUND + 1) * GROUP + lane], wheel[(GROUND + 2) * GROUP + lane]
            # Sinkage counts along the normal.
            wheel[GROUND * GROUP + lane] -= left * math.sqrt(1.0 + slope_x**2 + slope_y**2)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def press_ruts(work: Any, width: float) -> None:
    """Leave the ruts of all wheels that roll, two spacings long, with ends that run out over another."""
    frame = work.frame
    wide = width * math.sqrt(frame[2] ** 2 + frame[3] ** 2)
    for w in range(len(work.wheels)):
        wheel = work.wheels[w]
        for lane in range(GROUP):
            sinkage = wheel[SINKAGE * GROUP + lane]
            if work.code[lane] != FINISHED or not sinkage > 0.0 or wheel[RIM * GROUP + lane] == 0.0:
                continue
            axle_x, axle_y = wheel[AXLE * GROUP + lane], wheel[(AXLE + 1) * GROUP + lane]
            across, up = frame[2] * axle_x + frame[3] * axle_y, frame[2] * axle_y - frame[3] * axle_x
            scale = 1.0 / math.sqrt(across * across + up * up + 1e-300)
            across, up = scale * across, scale * up
            x, y = wheel[CENTER * GROUP + lane] - frame[0], wheel[(CENTER + 1) * GROUP + lane] - frame[1]
            # Ahead is a quarter turn from the axle to the right.
            column = frame[2] * x + frame[3] * y + frame[4] - BEHIND * up
            row = frame[2] * y - frame[3] * x + frame[5] + BEHIND * across
            depth = sinkage + wheel[(RUT + 1) * GROUP + lane]
            still = still_deep(depth, wheel[SOIL * GROUP + lane], wheel[(SOIL + 1) * GROUP + lane])
            press(work.ruts, lane, column, row, across, up, wide, depth, still)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def press(
    ruts: Any, lane: int, column: float, row: float, across: float, up: float, wide: float, depth: float, still: float
) -> None:
    """Press a strip about a place, in spacings: for a wheel as `wide` along (across, up), 1 ahead and behind.

    To the side the share falls to 0 where a wheel of that width has nothing in common with it. Where it becomes
    deepest, `depth` is how deep it is pressed, and `still` how deep it stays. [m]
    """
    ny, nx = ruts.shape[1], ruts.shape[2]
    reach_x, reach_y = wide * abs(across) + 2.0 * abs(up), wide * abs(up) + 2.0 * abs(across)
    for i in range(max(0, math.ceil(row - reach_y)), min(ny - 1, math.floor(row + reach_y)) + 1):
        for j in range(max(0, math.ceil(column - reach_x)), min(nx - 1, math.floor(column + reach_x)) + 1):
            a, b = j - column, i - row
            out = min(1.0 - abs(a * across + b * up) / wide, 2.0 - abs(a * up - b * across), 1.0)
            if out * depth > ruts[lane, i, j, 0]:
                ruts[lane, i, j, 0], ruts[lane, i, j, 1] = out * depth, out * still
