"""The motion of a rover as a linear state-space model with unknown constants, for several assumptions at once.

The rover moves as its wheels say, but for a deviation of each of its three velocities, a share of the mean rim speed:
a stationary process along the way, Matern 3/2 (Rasmussen & Williams 2006, ch. 4; as a state-space model Hartikainen &
Sarkka 2010, 10.1109/MLSP.2010.5589113), and what unknown constants (`CONSTANTS`) do to it. Positions and headings
observe the motion, and the constants too: where the localised point is on the rover, how the heading drifts, how late
the clock is. The filter carries the state as a linear function of the constants (de Jong 1991,
10.1214/aos/1176348140), so that their posterior, and the marginal likelihood of any prior of theirs, need no second
pass. The smoother is that of Rauch, Tung & Striebel (1965, 10.2514/3.3166).

`Nodes` are the moments at which the motion is estimated, with what is measured there.
"""

import math
from dataclasses import dataclass, replace
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
"""Of a rover whose place is not known yet, in position and heading: so wide that ten times as much moves no slip, as
measured by `tests/benchmarks/telemetry_constants.py`."""
LOOSE_M = 1.0
"""Lever by which an error of the way over a gap becomes one of the heading. Half or twice as much moves slips by 0.05
of their errors at most, as measured. [m]"""
POSITION_M_PER_STEP = 2e-4
"""What each step may be off by whatever the wheels do; half or twice as much moves no slip, as measured. [m]"""
TURN_PER_STEP = 0.03
"""Share that the turn of a step may be off by, as by the shape of the ground below a turn on the spot. Half or twice as
much moves slips by 0.04 of their errors at most, as measured."""
BEND_M = 5.0
"""Radius of the turn in which slip makes the turn deviate as much again as on a straight way. Half or twice as much
moves slips by 0.16 of their errors at most, as measured. [m]"""
LINEAR_S = 0.5
"""Lag up to which the motion is linear in one; a longer one is put back, and what is left found anew. Half or twice as
much moves no slip, as measured. [s]"""
MOST_PARTS = 8
"""Of a halt with positions, in which the rover may slide each; more are taken together."""
STRETCH = 256
"""Steps whose matrices are held at a time: those of all steps of a long drive would fill the memory."""


class ErrorChain(NamedTuple):
    """Errors of positions from node to node: each is so much of the one before, and noise of its own.

    Attributes
    ----------
    follows : matrix that the error at the node before is multiplied by. (n, 2, 2) [-]
    noise_m2 : covariance of what is added. (n, 2, 2) [m2]
    """

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
    gap_sigma_m : additional standard error of the way between nodes, as over a gap. (n - 1,) [m]
    restarts : steps over which deviations keep nothing, as at a halt. (n - 1,)
    fix_m, fix_covariance_m2 : positions, NaN where there is none. (n, 2), (n, 2, 2)
    yaw_rad, yaw_sigma_rad : headings, NaN where there is none. (n,)
    effect : deviations ahead, left and turn for coefficients of 1; None where nothing is known. (n, 3, 5)
    chain : of the errors of positions; None where they are independent.
    jumps : first and last node of ways on which positions may shift whatever the wheels do.
    """

    time_s: FloatArray
    twist: FloatArray
    way_m: FloatArray
    gap_sigma_m: FloatArray
    restarts: BoolArray
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
        still = np.concatenate([[False], (self.way_m == 0.0) & (self.gap_sigma_m == 0.0), [False]])
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
    def turn_gain(self) -> FloatArray:
        """How much more the turn deviates than on a straight way: slip changes a turn the more, the more it turns.

        (n - 1,)
        """
        turned = np.abs(self.twist[:, 2]) * np.diff(self.time_s)
        return np.hypot(1.0, BEND_M * np.divide(turned, self.way_m, out=np.zeros_like(turned), where=self.way_m > 0))

    @property
    def direction(self) -> FloatArray:
        """Speed ahead as a share of the rims': 1 forwards, -1 backwards, 0 where it turns on the spot. (n - 1,)"""
        moved = self.twist[:, 0] * np.diff(self.time_s)
        return np.asarray(np.clip(np.divide(moved, self.way_m, out=np.zeros_like(moved), where=self.way_m > 0), -1, 1))

    @property
    def constants(self) -> int:
        """How many unknown constants there are."""
        return len(CONSTANTS) + 2 * len(self.slides)


def onto_map(yaw_rad: FloatArray, ahead: FloatArray | float, left: FloatArray | float) -> FloatArray:
    """A way ahead and to the left in x and y. (n, 2)"""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([cos * ahead - sin * left, sin * ahead + cos * left])


def at_nodes(between: FloatArray) -> FloatArray:
    """Means at nodes of what is known between them. (n - 1, ...) to (n, ...)"""
    return np.asarray(0.5 * (np.concatenate([between[:1], between]) + np.concatenate([between, between[-1:]])))


def dead_reckoned(nodes: Nodes) -> FloatArray:
    """Poses along headings, or where there are none turned as the wheels say, through the first position. (n, 11)"""
    count = len(nodes.time_s)
    steps = np.diff(nodes.time_s)
    turned = np.append(0.0, np.cumsum(nodes.twist[:, 2] * steps))
    given = np.isfinite(nodes.yaw_rad)
    off = np.interp(nodes.time_s, nodes.time_s[given], (nodes.yaw_rad - turned)[given]) if given.any() else 0.0
    yaw = turned + off
    ways = onto_map(0.5 * (yaw[1:] + yaw[:-1]), *(nodes.twist[:, :2] * steps[:, None]).T)
    state = np.zeros((count, SIZE))
    state[1:, :2] = np.cumsum(ways, axis=0)
    state[:, 2] = yaw
    first = int(np.argmax(nodes.fixed))
    state[:, :2] += nodes.fix_m[first] - state[first, :2]
    return state


def lag_of_turns(nodes: Nodes, farthest_s: float) -> float:
    """The lag at which wheels turn as headings do, up to the farthest that is tried. [s]

    0 where it is so short that the motion is linear in it, or where turns hardly tell.
    """
    steps = np.diff(nodes.time_s)
    given, turned = np.isfinite(nodes.yaw_rad), np.append(0.0, np.cumsum(nodes.twist[:, 2] * steps))
    times, yaw = nodes.time_s[given], nodes.yaw_rad[given]
    farthest = min(farthest_s, 0.25 * float(times[-1] - times[0]))
    inside = (times >= times[0] + farthest) & (times <= times[-1] - farthest)
    if inside.sum() < 3 or np.ptp(turned) == 0.0:
        return 0.0
    lags = np.arange(-farthest, farthest, 0.5 * LINEAR_S)
    left = [float(np.var(yaw[inside] - np.interp(times[inside] - lag, nodes.time_s, turned))) for lag in lags]
    lag, least = float(lags[int(np.argmin(left))]), min(left)
    return lag if abs(lag) > LINEAR_S and least < 0.5 * left[len(lags) // 2] else 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProcessCandidates:
    """How deviations change and positions err, m at a time.

    Attributes
    ----------
    amplitude, length_m : of the deviations ahead [-], left [-] and turn [1/m]. (m, 3), (m, 3) [m]
    walk : growth of the error that positions share, by the root of the way. (m,) [m / sqrt(m)]
    """

    amplitude: FloatArray
    length_m: FloatArray
    walk: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceMotion:
    """What the model is linearised about, and how much each measurement counts.

    Attributes
    ----------
    state : of the rover at each node. (n, 11)
    constants : of the drive. (k,)
    fix_weight, yaw_weight : by which the covariances of positions and of headings are divided. (n,) [-]
    """

    state: FloatArray
    constants: FloatArray
    fix_weight: FloatArray
    yaw_weight: FloatArray

    def widened(self, nodes: Nodes) -> "ReferenceMotion":
        """The same for nodes with more constants."""
        more = nodes.constants - len(self.constants)
        return replace(self, constants=np.append(self.constants, np.zeros(more)))

    @classmethod
    def first(cls, nodes: Nodes) -> "ReferenceMotion":
        """Dead reckoning without any error."""
        one = np.ones(len(nodes.time_s))
        return cls(state=dead_reckoned(nodes), constants=np.zeros(nodes.constants), fix_weight=one, yaw_weight=one)


class Linear(NamedTuple):
    """The steps and measurements about a reference, of n nodes and k constants.

    Attributes
    ----------
    pose : from the state before a step to the pose after it. (n - 1, 3, 11)
    input : from the constants to that pose. (n - 1, 3, k)
    shift : the rest of that pose. (n - 1, 3)
    seen, by : from the state, and from the constants, to what is measured of x, y and heading. (n, 3, 11), (n, 3, k)
    value : that measurement. (n, 3)
    """

    pose: FloatArray
    input: FloatArray
    shift: FloatArray
    seen: FloatArray
    by: FloatArray
    value: FloatArray


def step_inputs(nodes: Nodes) -> FloatArray:
    """Way ahead and left, and turn, that constants of 1 add to each step. (n - 1, 3, k)"""
    steps, effects = np.diff(nodes.time_s), nodes.effects
    result = np.zeros((len(steps), 3, nodes.constants))
    result[:, [0, 1, 2], [0, 1, 2]] = nodes.way_m[:, None]
    result[:, 0, 0] *= nodes.direction
    result[:, :, 3:SCALE] = nodes.way_m[:, None, None] * 0.5 * (effects[1:] + effects[:-1])
    result[:, :, SCALE] = nodes.twist * steps[:, None]
    for number, (first, last) in enumerate(nodes.slides):
        share = steps[first:last] / steps[first:last].sum()
        for row in range(2):
            result[first:last, row, SLIDES + 2 * number + row] = share
    return result


def linearised(nodes: Nodes, reference: ReferenceMotion) -> Linear:
    """The model about a reference."""
    before, constants = reference.state[:-1], reference.constants
    parts = np.zeros((len(before), 3, SIZE))
    for row, k in enumerate(AHEAD):
        parts[:, row, k], parts[:, row, k + 1] = nodes.way_m, 0.5 * nodes.way_m**2
    parts[:, 2] *= nodes.turn_gain[:, None]
    added = step_inputs(nodes)
    plain = nodes.twist * np.diff(nodes.time_s)[:, None]
    full = plain + np.einsum("nij,nj->ni", parts, before) + added @ constants
    middle = before[:, 2] + 0.5 * full[:, 2]
    cos, sin = np.cos(middle), np.sin(middle)
    onto = np.zeros((len(before), 3, 3))
    onto[:, 0, 0] = onto[:, 1, 1] = cos
    onto[:, 0, 1], onto[:, 1, 0] = -sin, sin
    by_turn = np.einsum("nij,nj->ni", onto[:, :2, :2], np.column_stack([-full[:, 1], full[:, 0]]))
    onto[:, :2, 2] = 0.5 * by_turn
    onto[:, 2, 2] = 1.0
    pose = onto @ parts
    pose[:, [0, 1, 2], [0, 1, 2]] += 1.0
    pose[:, :2, 2] += by_turn
    moved = np.column_stack([onto_map(middle, full[:, 0], full[:, 1]), full[:, 2]])
    inputs = onto @ added
    shift = before[:, :3] + moved - np.einsum("nij,nj->ni", pose, before) - inputs @ constants
    return Linear(pose, inputs, shift, *_measured(nodes, reference, moved))


def _measured(nodes: Nodes, reference: ReferenceMotion, moved: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What positions and headings say of state and constants, about a reference: the last three of `Linear`.

    `moved` is how far each step goes in x, y and heading, by wheels and deviations. (n - 1, 3) [m, m, rad]
    """
    state, constants = reference.state, reference.constants
    back, rate = _shifted_back(nodes, moved, float(constants[LAG]))
    turned = state[:, 2] + back[:, 2]
    cos, sin = np.cos(turned), np.sin(turned)
    arm = onto_map(turned, *constants[LEVER])
    count = len(state)
    seen, by = np.zeros((count, 3, SIZE)), np.zeros((count, 3, nodes.constants))
    seen[:, [0, 1, 2], [0, 1, 2]] = 1.0
    seen[:, :2, OFF] = np.eye(2)
    apart = back[:, :2] + arm
    seen[:, 0, 2], seen[:, 1, 2] = -apart[:, 1], apart[:, 0]
    by[:, :2, LEVER] = np.moveaxis(np.array([[cos, -sin], [sin, cos]]), -1, 0)
    grown = (nodes.time_s - nodes.time_s[0]) / (nodes.time_s[-1] - nodes.time_s[0])
    by[:, 2, OFFSET], by[:, 2, DRIFT] = 1.0, grown
    by[:, :, LAG] = -rate
    by[:, :2, LAG] -= rate[:, 2:] * np.column_stack([-arm[:, 1], arm[:, 0]])
    expected = state[:, :3] + back
    expected[:, :2] += arm + state[:, OFF]
    expected[:, 2] += constants[OFFSET] + grown * constants[DRIFT]
    value = np.column_stack([nodes.fix_m, nodes.yaw_rad]) - expected
    value += np.einsum("nij,nj->ni", seen, state) + by @ constants
    return seen, by, value


def _shifted_back(nodes: Nodes, moved: FloatArray, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """How far behind the rover was a lag before each node, and its velocity there. (n, 3), (n, 3) [m, m, rad; a second]

    By the velocities of wheels and deviations, not as smoothed: errors of positions would be moved along.
    """
    steps = np.diff(nodes.time_s)[:, None]
    rate = moved / steps
    path = np.vstack([np.zeros(3), np.cumsum(moved, axis=0)])
    # Before and behind the drive it goes on at the speeds of its ends.
    whole_s = nodes.time_s[-1] - nodes.time_s[0]
    path = np.vstack([path[:1] - whole_s * rate[:1], path, path[-1:] + whole_s * rate[-1:]])
    times = np.concatenate([nodes.time_s[:1] - whole_s, nodes.time_s, nodes.time_s[-1:] + whole_s])
    at = nodes.time_s - lag_s

    def along(when: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(when, times, column) for column in path.T])

    half = 0.5 * float(np.median(steps))
    return along(at) - path[1:-1], (along(at + half) - along(at - half)) / (2.0 * half)


class FilterRun(NamedTuple):
    """A filter's results, at n nodes for m assumptions and k constants.

    Attributes
    ----------
    columns : the state is `columns[..., 0]` and `columns[..., 1:]` times the constants. (n, m, 11, 1 + k)
    covariance : of the state, given the constants. (n, m, 11, 11)
    squares : of innovations over their covariances; their quadratic form in (1, constants) is chi-square. (m, 1 + k,
        1 + k)
    ln_likelihood : the part that does not depend on the constants. (m,)
    """

    columns: FloatArray
    covariance: FloatArray
    squares: FloatArray
    ln_likelihood: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Nodes about a reference, for m assumptions.

    Attributes
    ----------
    nodes, reference : the moments, and what the model is linearised about.
    assumptions : how motion and slip may change from node to node, m of them.
    linear : the model about the reference.
    """

    nodes: Nodes
    reference: ReferenceMotion
    assumptions: ProcessCandidates
    linear: Linear

    @classmethod
    def about(cls, nodes: Nodes, reference: ReferenceMotion, assumptions: ProcessCandidates) -> "Model":
        """The model linearised about a reference."""
        return cls(nodes, reference, assumptions, linearised(nodes, reference))

    def stretches(self) -> list[tuple[int, int]]:
        """First step, and the one after the last, of each stretch."""
        count = len(self.nodes.way_m)
        return [(first, min(first + STRETCH, count)) for first in range(0, count, STRETCH)]

    def steps(self, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        """Matrix (k, m, 11, 11) and noise (k, m, 11, 11) of some steps."""
        nodes, assumed = self.nodes, self.assumptions
        way, apart, gap_sigma_m = (
            nodes.way_m[first:last, None],
            nodes.restarts[first:last],
            nodes.gap_sigma_m[first:last],
        )
        matrix = np.zeros((last - first, len(assumed.walk), SIZE, SIZE))
        noise = np.zeros_like(matrix)
        matrix[..., :3, :] = self.linear.pose[first:last, None]
        for channel, k in enumerate(AHEAD):
            rate = math.sqrt(3.0) / assumed.length_m[None, :, channel]
            decay = np.where(apart[:, None], 0.0, np.exp(-rate * way))
            block = np.empty((*decay.shape, 2, 2))
            block[..., 0, 0], block[..., 0, 1] = decay * (1 + rate * way), decay * way
            block[..., 1, 0], block[..., 1, 1] = -decay * rate**2 * way, decay * (1 - rate * way)
            still = self._stationary(channel)
            matrix[..., k : k + 2, k : k + 2] = block
            noise[..., k : k + 2, k : k + 2] = still - block @ still @ np.swapaxes(block, -1, -2)
        noise[..., 0, 0] = noise[..., 1, 1] = (POSITION_M_PER_STEP**2 + gap_sigma_m**2)[:, None]
        turn = nodes.twist[first:last, 2] * np.diff(nodes.time_s[first : last + 1])
        noise[..., 2, 2] = ((gap_sigma_m / LOOSE_M) ** 2 + (TURN_PER_STEP * turn) ** 2)[:, None]
        if nodes.chain is None:
            matrix[..., OFF, OFF] = np.eye(2)
            noise[..., OFF, OFF] = (assumed.walk**2 * way)[..., None, None] * np.eye(2)
        else:
            matrix[..., OFF, OFF] = nodes.chain.follows[first + 1 : last + 1, None]
            noise[..., OFF, OFF] = nodes.chain.noise_m2[first + 1 : last + 1, None]
        return matrix, noise

    def _stationary(self, channel: int) -> FloatArray:
        """Covariance of a deviation and its derivative. (m, 2, 2)"""
        rate = math.sqrt(3.0) / self.assumptions.length_m[:, channel]
        still = np.zeros((len(rate), 2, 2))
        still[:, 0, 0], still[:, 1, 1] = 1.0, rate**2
        return np.asarray(still * self.assumptions.amplitude[:, channel, None, None] ** 2)

    def start(self) -> tuple[FloatArray, FloatArray]:
        """Columns (m, 11, 1 + k) and covariance (m, 11, 11) before anything is measured."""
        nodes, many = self.nodes, len(self.assumptions.walk)
        columns = np.zeros((many, SIZE, 1 + nodes.constants))
        columns[:, :3, 0] = dead_reckoned(nodes)[0, :3]
        covariance = np.zeros((many, SIZE, SIZE))
        covariance[:, 0, 0] = covariance[:, 1, 1] = START_M**2
        covariance[:, 2, 2] = START_RAD**2
        for channel, k in enumerate(AHEAD):
            covariance[:, k : k + 2, k : k + 2] = self._stationary(channel)
        if nodes.chain is not None:
            covariance[:, OFF, OFF] = nodes.chain.noise_m2[0]
        return columns, covariance

    def observed(self, k: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """What is measured at a node: by the state, by the constants, values, and their covariance beside it."""
        nodes, linear = self.nodes, self.linear
        rows = np.flatnonzero(np.isfinite(linear.value[k]))
        errors = np.zeros((3, 3))
        share = 1.0 / self.reference.fix_weight[k] - (nodes.chain is not None)
        errors[:2, :2] = share * nodes.fix_covariance_m2[k]
        errors[2, 2] = nodes.yaw_sigma_rad[k] ** 2 / self.reference.yaw_weight[k]
        return linear.seen[k, rows], linear.by[k, rows], linear.value[k, rows], errors[rows][:, rows]


def filtered(model: Model, *, every_node: bool = True) -> FilterRun:
    """The filter for each of several assumptions.

    Without `every_node` columns and covariances are those of the last node alone, (1, m, ...).
    """
    nodes, linear = model.nodes, model.linear
    columns, covariance = model.start()
    count = len(nodes.time_s) if every_node else 1
    all_columns, covariances = np.empty((count, *columns.shape)), np.empty((count, *covariance.shape))
    squares, ln_likelihood = np.zeros((len(columns), columns.shape[2], columns.shape[2])), np.zeros(len(columns))

    def observe(k: int) -> None:
        nonlocal columns, covariance, squares, ln_likelihood
        seen, by, value, errors = model.observed(k)
        if len(value):
            off = -(seen @ columns)
            off[:, :, 0] += value
            off[:, :, 1:] -= by
            through = seen @ covariance
            within = through @ seen.T + errors
            inverse = np.linalg.inv(within)
            weighed = inverse @ off
            squares += np.swapaxes(off, 1, 2) @ weighed
            ln_likelihood -= 0.5 * np.linalg.slogdet(within)[1]
            columns = columns + np.swapaxes(through, 1, 2) @ weighed
            covariance = covariance - np.swapaxes(through, 1, 2) @ inverse @ through
            covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        all_columns[k if every_node else 0], covariances[k if every_node else 0] = columns, covariance

    observe(0)
    for first, last in model.stretches():
        for k, step, noise in zip(range(first, last), *model.steps(first, last), strict=True):
            columns = step @ columns
            columns[:, :3, 0] += linear.shift[k]
            columns[:, :3, 1:] += linear.input[k]
            covariance = step @ covariance @ np.swapaxes(step, 1, 2) + noise
            observe(k + 1)
    return FilterRun(all_columns, covariances, squares, ln_likelihood)


def smoothed_back(model: Model, run: FilterRun) -> FilterRun:
    """Columns and covariances that know what came later too, in the place of those of `filtered`."""
    columns, covariance, linear = run.columns, run.covariance, model.linear
    for first, last in reversed(model.stretches()):
        matrix, noise = model.steps(first, last)
        for k in range(last - 1, first - 1, -1):
            step = matrix[k - first]
            through = step @ covariance[k]
            ahead = through @ np.swapaxes(step, 1, 2) + noise[k - first]
            gain = np.swapaxes(np.linalg.solve(ahead + 1e-18 * np.eye(SIZE), through), 1, 2)
            off = columns[k + 1] - step @ columns[k]
            off[:, :3, 0] -= linear.shift[k]
            off[:, :3, 1:] -= linear.input[k]
            columns[k] += gain @ off
            covariance[k] += gain @ (covariance[k + 1] - ahead) @ np.swapaxes(gain, 1, 2)
            covariance[k] = 0.5 * (covariance[k] + np.swapaxes(covariance[k], 1, 2))
    return run
