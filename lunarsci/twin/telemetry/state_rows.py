"""States of the wheels at some moments of a smoothed motion: slip and side slip, each with its error."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.lanes import CLIFF, HOLE, LEFT, OVERTURNED
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact_frame import VALID_SLIP
from lunarsci.twin.telemetry.checks import check_slips, check_stands
from lunarsci.twin.telemetry.motion_nodes import Nodes
from lunarsci.twin.telemetry.nodes import slips_of, wheel_velocities
from lunarsci.twin.telemetry.reading import Findings
from lunarsci.twin.telemetry.smoother import Smoothed
from lunarsci.twin.telemetry.wheel_motion import STILL_SHARE, WheelMotion

LEAST_ROW_M = 0.3
"""Way between rows of states where positions are denser, assumed: a rover's slip does not change faster. [m]"""
UNEVEN = 0.2
"""Change of speed, in ln, about a node from which on it is a start or a stop, without a state; assumed."""
ON_THE_SPOT = 0.1
"""Speed of the rover as a share of that of its rims below which it turns on the spot; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateRows:
    """States at some nodes, of every wheel.

    Attributes
    ----------
    node : which node each row is. (m,)
    distance_m : way that the wheels rolled, of their middle; longer than the rover's by slip. (m,) [m]
    place_m : wheel centres. (m, wheels, 2) [m]
    slip_ratio, slip_ratio_sigma, side_slip_deg, side_slip_deg_sigma : (m, wheels)
    slip_ratio_shared : part of the error of slip that all states share, of the scale of the rims. (m, wheels)
    sinkage_m, sinkage_m_sigma : NaN where the track does not say it. (m, wheels) [m]
    rim_m_s : measured speed of the rims r_s omega about the node, NaN where it is not. (m, wheels) [m/s]
    measured : False at halts, and for wheels without readings or off the terrain. (m, wheels)
    """

    node: IndexArray
    distance_m: FloatArray
    place_m: FloatArray
    slip_ratio: FloatArray
    slip_ratio_sigma: FloatArray
    slip_ratio_shared: FloatArray
    side_slip_deg: FloatArray
    side_slip_deg_sigma: FloatArray
    sinkage_m: FloatArray
    sinkage_m_sigma: FloatArray
    rim_m_s: FloatArray
    measured: BoolArray

    @property
    def fast(self) -> BoolArray:
        """Measured, but with a slip beyond the range of the wheel model. (m, wheels)"""
        return np.asarray(self.measured & (np.abs(self.slip_ratio) > VALID_SLIP))

    @property
    def valid(self) -> BoolArray:
        """Measured and not fast: what a soil is learned from. (m, wheels)"""
        return np.asarray(self.measured & ~self.fast)


def state_rows(
    rover: Rover,
    wheels: WheelMotion,
    nodes: Nodes,
    smoothed: Smoothed,
    motion: Motion,
    held: PrescribedLoads,
    rows: IndexArray,
    gaps: BoolArray,
    findings: Findings,
) -> StateRows:
    """States of every wheel at nodes where the rover drives, at most once between two positions, and at halts."""
    speed = np.hypot(nodes.twist[:, 0], nodes.twist[:, 1])
    steps = np.diff(nodes.time_s)
    drives = (speed > ON_THE_SPOT * nodes.way_m / steps) & (speed > STILL_SHARE * wheels.usual_m_s)
    distance = np.append(0.0, np.cumsum(np.where(drives, speed * steps, 0.0)))
    gap_nodes = np.add.reduceat(gaps.astype(int), rows[:-1]) > 0
    chosen, halted = _chosen(nodes, drives, distance, gap_nodes, findings)
    velocities = wheel_velocities(rover, nodes, smoothed, held)
    slip, side, slip_sigma, side_sigma, shared = (part[chosen] for part in slips_of(velocities, motion))
    low, high = (rows[np.clip(chosen + step, 0, len(rows) - 1)] for step in (-1, 1))
    trusted = np.array([wheels.trusted[a:b].all(axis=0) for a, b in zip(low, high, strict=True)])
    sound = ~np.isin(held.outcome[chosen], (LEFT, HOLE, OVERTURNED, CLIFF))
    check_stands(sound, nodes.time_s[chosen], findings)
    slip[halted], side[halted] = 0.0, 0.0
    result = StateRows(
        node=chosen,
        distance_m=distance[chosen],
        place_m=_places(rover, motion, held)[chosen],
        slip_ratio=slip,
        slip_ratio_sigma=slip_sigma,
        slip_ratio_shared=shared,
        side_slip_deg=side,
        side_slip_deg_sigma=side_sigma,
        sinkage_m=np.full(slip.shape, np.nan),
        sinkage_m_sigma=np.full(slip.shape, np.nan),
        rim_m_s=_rims(wheels, low, high),
        measured=trusted & sound[:, None] & ~halted[:, None],
    )
    check_slips(result.slip_ratio, result.measured, nodes.time_s[chosen], findings)
    return result


def _places(rover: Rover, motion: Motion, held: PrescribedLoads) -> FloatArray:
    """Wheel centres, as of a level rover where it does not come to rest. (n, wheels, 2) [m]"""
    yaw, wheel = np.radians(motion.yaw_deg)[:, None], rover.wheel_positions_m
    level = np.stack(
        [
            motion.x_m[:, None] + np.cos(yaw) * wheel[:, 0] - np.sin(yaw) * wheel[:, 1],
            motion.y_m[:, None] + np.sin(yaw) * wheel[:, 0] + np.cos(yaw) * wheel[:, 1],
        ],
        axis=-1,
    )
    return np.where(np.isfinite(held.states[..., :2]), held.states[..., :2], level)


def _rims(wheels: WheelMotion, low: IndexArray, high: IndexArray) -> FloatArray:
    """Mean of the measured rim speeds over steps between rows, NaN where none is. (m, wheels) [m/s]"""
    measured = np.where(wheels.measured, wheels.rim_m_s, 0.0)
    sums, counts = (np.vstack([np.zeros(one.shape[1]), one.cumsum(axis=0)]) for one in (measured, wheels.measured))
    with np.errstate(invalid="ignore"):
        return np.asarray((sums[high] - sums[low]) / (counts[high] - counts[low]))


def _chosen(
    nodes: Nodes, drives: BoolArray, distance_m: FloatArray, gap: BoolArray, findings: Findings
) -> tuple[IndexArray, BoolArray]:
    """Nodes midway between positions, no closer than `LEAST_ROW_M`, and one for each halt.

    Nodes and whether each is a halt. They are out of gaps, and where the rover keeps its speed, if there are such.
    """
    fixes = np.flatnonzero(nodes.fixed)
    pace = nodes.way_m / np.diff(nodes.time_s)
    even = np.abs(np.log(np.maximum(pace[1:], 1e-12) / np.maximum(pace[:-1], 1e-12))) < UNEVEN
    driven, dark = (np.pad(one, 1) for one in (drives[1:] & drives[:-1], gap[1:] | gap[:-1]))
    dark[[0, -1]] = gap[[0, -1]]
    lost = np.append(0, np.cumsum(gap))
    result: list[int] = []
    for calm, blind in ((driven & ~dark & np.pad(even, 1), False), (driven & ~dark, False), (driven, True)):
        last = -math.inf
        for a, b in itertools.pairwise(fixes):
            inside = np.arange(a, b + 1)[calm[a : b + 1]]
            middle = 0.5 * (distance_m[a] + distance_m[b])
            if not inside.size or (lost[b] > lost[a] and not blind) or distance_m[b] == distance_m[a]:
                continue
            node = int(inside[np.argmin(np.abs(distance_m[inside] - middle))])
            if distance_m[node] - last >= LEAST_ROW_M:
                result.append(node)
                last = float(distance_m[node])
        if result:
            break
    still = np.flatnonzero(np.append(~drives, False))
    groups = np.split(still, np.flatnonzero(np.diff(still) > 1) + 1) if still.size else []
    halts = [int(group[len(group) // 2]) for group in groups if group.size]
    if not result and not halts:
        raise DataError(f"{findings.file}: no two positions with a drive between them; slip needs two")
    if not result:
        what = "the rover does not drive between positions; it stands, or turns on the spot"
        findings.add("no slip", what, "there are no states; its motion is given")
    nodes_found = np.array(sorted({*result, *halts}), dtype=np.intp)
    return nodes_found, np.isin(nodes_found, halts)
