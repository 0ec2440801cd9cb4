"""The moments at which the motion of a rover is found, what is measured there, and which constants are unknown."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray

SIZE = 11
"""State: x, y, heading; deviation and its derivative along the way of ahead, left and turn; error of positions in x
and y where they follow each other."""
AHEAD = (3, 5, 7)
OFF = slice(9, 11)
CONSTANTS = (
    "slip", "glide", "turn", "slip_on_slope", "side_slip_on_slope", "turn_share", "left_of_turn", "ahead_of_turn",
    "rim_scale", "lever_ahead_m", "lever_left_m", "heading_offset_rad", "heading_drift_rad", "lag_s",
)  # fmt: skip
"""Deviations that stay the same: in the direction of the drive and to the left as shares, turn in 1/m; coefficients of
`Nodes.effect`; ln of the true over the measured rim speed; the localised point on the rover, ahead and to the left of
its origin; error of headings at the begin, and its growth until the end; how much later positions and headings are than
their times say. Two more for each of `Nodes.slides`: how far the rover or its positions move there [m]."""
MEANS, EFFECTS = (11, 12, 13), (14, 15, 16, 17, 18)
"""Places of the first ones behind the state."""
SCALE, LEVER, OFFSET, DRIFT, LAG, SLIDES = 8, slice(9, 11), 11, 12, 13, 14
"""Places of the others among the constants."""
START_M, START_RAD = 10.0, 1.0
"""Of a rover whose place is not known yet, in position and heading; assumed wide."""
LOOSE_M = 1.0
"""Lever by which an error of the way over a gap becomes one of the heading; assumed. [m]"""
POSITION_M_PER_STEP = 2e-4
"""What each step may be off by whatever the wheels do; assumed. [m]"""
TURN_PER_STEP = 0.03
"""Share that the turn of a step may be off by, as by the shape of the ground below a turn on the spot; assumed."""
BEND_M = 5.0
"""Radius of the turn in which slip makes the turn deviate as much again as on a straight way; assumed. [m]"""
LINEAR_S = 0.5
"""Lag up to which the motion is linear in one; a longer one is put back, and what is left found anew; assumed. [s]"""
MOST_PARTS = 8
"""Of a halt with positions, in which the rover may slide each; more are taken together."""
FARTHEST_S = 60.0
"""How far the motion is taken to go on before and behind the drive, at the speeds of its ends; assumed. [s]"""


class ErrorChain(NamedTuple):
    """Errors of positions: at each node `follows` times the error before, and noise. (n, 2, 2) [-], [m2]"""

    follows: FloatArray
    noise_m2: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nodes:
    """The moments at which the motion is found.

    Attributes
    ----------
    time_s : (n,) [s]
    twist : mean velocity between nodes if nothing slips: ahead, left [m/s], turn [rad/s]. (n - 1, 3)
    way_m : mean way of the rims between nodes. (n - 1,) [m]
    loose : additional standard error of the way between nodes, as over a gap. (n - 1,) [m]
    apart : steps over which deviations keep nothing, as at a halt. (n - 1,)
    fix_m, fix_covariance_m2 : positions, NaN where there is none. (n, 2), (n, 2, 2)
    yaw_rad, yaw_sigma_rad : headings, NaN where there is none. (n,)
    effect : deviations ahead, left and turn for coefficients of 1; None where nothing is known. (n, 3, 5)
    chain : of the errors of positions; None where they are independent.
    jumps : first and last node of ways on which positions may shift whatever the wheels do.
    """

    time_s: FloatArray
    twist: FloatArray
    way_m: FloatArray
    loose: FloatArray
    apart: BoolArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray
    yaw_rad: FloatArray
    yaw_sigma_rad: FloatArray
    effect: FloatArray | None = None
    chain: ErrorChain | None = None
    jumps: tuple[tuple[int, int], ...] = ()

    @property
    def fixed(self) -> BoolArray:
        """Nodes with a position. (n,)"""
        return np.asarray(np.isfinite(self.fix_m).all(axis=1))

    @property
    def effects(self) -> FloatArray:
        """`effect`, 0 where nothing is known. (n, 3, 5)"""
        return np.zeros((len(self.time_s), 3, len(EFFECTS))) if self.effect is None else self.effect

    @property
    def halts(self) -> list[tuple[int, int]]:
        """First and last node of each halt: the wheels stand, and the rover drives before and behind. (h,)

        One with positions is several, from one to the next of them, `MOST_PARTS` at most.
        """
        still = np.concatenate([[False], (self.way_m == 0.0) & (self.loose == 0.0), [False]])
        firsts, lasts = np.flatnonzero(still[1:] & ~still[:-1]), np.flatnonzero(still[:-1] & ~still[1:])
        end, result = len(self.time_s) - 1, list[tuple[int, int]]()
        for first, last in zip(firsts, lasts, strict=True):
            if first > 0 and last < end:
                inside = first + 1 + np.flatnonzero(self.fixed[first + 1 : last])
                inside = inside[:: len(inside) // MOST_PARTS + 1]
                result += pairwise([int(first), *map(int, inside), int(last)])
        return result

    @property
    def slides(self) -> list[tuple[int, int]]:
        """First and last node of each way on which the rover, or its positions, may move aside: halts and jumps."""
        return [*self.halts, *self.jumps]

    @property
    def bend(self) -> FloatArray:
        """How much more the turn deviates than on a straight way: slip changes a turn the more, the more it turns.

        (n - 1,)
        """
        turned = np.abs(self.twist[:, 2]) * np.diff(self.time_s)
        return np.hypot(1.0, BEND_M * np.divide(turned, self.way_m, out=np.zeros_like(turned), where=self.way_m > 0))

    @property
    def heads(self) -> FloatArray:
        """Speed ahead as a share of the rims': 1 forwards, -1 backwards, 0 where it turns on the spot. (n - 1,)"""
        moved = self.twist[:, 0] * np.diff(self.time_s)
        return np.asarray(np.clip(np.divide(moved, self.way_m, out=np.zeros_like(moved), where=self.way_m > 0), -1, 1))

    @property
    def constants(self) -> int:
        """How many unknown constants there are."""
        return len(CONSTANTS) + 2 * len(self.slides)


def at_nodes(between: FloatArray) -> FloatArray:
    """Means at nodes of what is known between them. (n - 1, ...) to (n, ...)"""
    return np.asarray(0.5 * (np.concatenate([between[:1], between]) + np.concatenate([between, between[-1:]])))


def dead_reckoned(nodes: Nodes) -> FloatArray:
    """Poses along headings, or where there are none turned as the wheels say, through the first position. (n, 11)"""
    count = len(nodes.time_s)
    steps = np.diff(nodes.time_s)
    turned = np.append(0.0, np.cumsum(nodes.twist[:, 2] * steps))
    known = np.isfinite(nodes.yaw_rad)
    off = np.interp(nodes.time_s, nodes.time_s[known], (nodes.yaw_rad - turned)[known]) if known.any() else 0.0
    yaw = turned + off
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    ahead, left = nodes.twist[:, 0] * steps, nodes.twist[:, 1] * steps
    state = np.zeros((count, SIZE))
    state[1:, 0] = np.cumsum(np.cos(middle) * ahead - np.sin(middle) * left)
    state[1:, 1] = np.cumsum(np.sin(middle) * ahead + np.cos(middle) * left)
    state[:, 2] = yaw
    first = int(np.argmax(nodes.fixed))
    state[:, :2] += nodes.fix_m[first] - state[first, :2]
    return state


def lag_of_turns(nodes: Nodes) -> float:
    """The lag at which wheels turn as headings do. [s]

    0 where it is so short that the motion is linear in it, or where turns hardly tell.
    """
    steps = np.diff(nodes.time_s)
    known, turned = np.isfinite(nodes.yaw_rad), np.append(0.0, np.cumsum(nodes.twist[:, 2] * steps))
    times, yaw = nodes.time_s[known], nodes.yaw_rad[known]
    farthest = min(0.5 * FARTHEST_S, 0.25 * float(times[-1] - times[0]))
    inside = (times >= times[0] + farthest) & (times <= times[-1] - farthest)
    if inside.sum() < 3 or np.ptp(turned) == 0.0:
        return 0.0
    lags = np.arange(-farthest, farthest, 0.5 * LINEAR_S)
    left = [float(np.var(yaw[inside] - np.interp(times[inside] - lag, nodes.time_s, turned))) for lag in lags]
    lag, least = float(lags[int(np.argmin(left))]), min(left)
    return lag if abs(lag) > LINEAR_S and least < 0.5 * left[len(lags) // 2] else 0.0
