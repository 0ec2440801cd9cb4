"""From telemetry to the states of the wheels: slip, side slip and sinkage, each with its error."""

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.ensemble import STATE_COLUMNS
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.held import HeldForces, forces_along
from lunarsci.twin.plans.commands import CREEP_M_S
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import VALID_SLIP
from lunarsci.twin.telemetry.attitude import check_attitude, sway_m
from lunarsci.twin.telemetry.clock import ordered, time_gaps
from lunarsci.twin.telemetry.commands_check import check_against_plan
from lunarsci.twin.telemetry.findings import Findings
from lunarsci.twin.telemetry.odometry import body_twist, wheel_rows
from lunarsci.twin.telemetry.outliers import check_glide, check_scatter, without_outliers
from lunarsci.twin.telemetry.positions import check_frame, usable_headings, usable_positions
from lunarsci.twin.telemetry.record import Telemetry
from lunarsci.twin.telemetry.smoother import AHEAD, MEANS, Nodes, Smoothed, smooth
from lunarsci.twin.telemetry.steering import steering_angles
from lunarsci.twin.telemetry.wheel_motion import STILL_SHARE, WheelMotion, wheel_motion

__all__ = ["DriveStates", "StateRows", "states_of"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]
NODE_M = 0.1
"""Way between the moments at which the motion is found. [m]"""
LEAST_ROW_M = 0.3
"""Way between rows of states where positions are denser, assumed: a rover's slip does not change faster. [m]"""
GAP_SHARE = 0.2
"""Error of the way over a gap, as a share of it; assumed."""
SLIP_FLOOR, SIDE_SLIP_FLOOR_DEG = 0.001, 0.08
"""What is left where all sensors are all but perfect: 0.0005 to 0.0009 and 0.04 to 0.06 deg on six made-up drives over
ground of 0 to 5 mm roughness; the steering's own error of 0.1 deg, of which a few rows are averaged, adds 0.06 deg."""
UNEVEN = 0.2
"""Change of speed, in ln, about a node from which on it is a start or a stop, without a state; assumed."""
DISAGREE = 0.03
"""Median share of the usual rim speed by which wheels may differ from one motion; assumed."""
ON_THE_SPOT = 0.1
"""Speed of the rover as a share of that of its rims below which it turns on the spot; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateRows:
    """States at some nodes, of every wheel.

    Attributes
    ----------
    node : which node each row is. (m,)
    distance_m : way of the rover as its wheels say. (m,) [m]
    place_m : wheel centres. (m, wheels, 2) [m]
    slip_ratio, slip_ratio_sigma, side_slip_deg, side_slip_deg_sigma : (m, wheels)
    sinkage_m, sinkage_m_sigma : NaN where the track does not say it. (m, wheels) [m]
    valid : False at halts, beyond the range of the wheel model, and for wheels without readings. (m, wheels)
    """

    node: IntArray
    distance_m: FloatArray
    place_m: FloatArray
    slip_ratio: FloatArray
    slip_ratio_sigma: FloatArray
    side_slip_deg: FloatArray
    side_slip_deg_sigma: FloatArray
    sinkage_m: FloatArray
    sinkage_m_sigma: FloatArray
    valid: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveStates:
    """What a drive's telemetry says of its wheels.

    Attributes
    ----------
    rover, telemetry : what it was computed from; the telemetry as used, mended.
    nodes, smoothed, motion, held : the motion at its nodes, and the rover along it on the terrain.
    rows : states of the wheels.
    gaps : begin and end of the gaps in time. (g, 2) [s]
    left_out : positions that fit no motion: time, x, y. (o, 3) [s, m, m]
    findings : what was found wrong.
    """

    rover: Rover
    telemetry: Telemetry
    nodes: Nodes
    smoothed: Smoothed
    motion: Motion
    held: HeldForces
    rows: StateRows
    gaps: FloatArray
    left_out: FloatArray
    findings: Findings


def states_of(
    telemetry: Telemetry, rover: Rover, terrain: Terrain, findings: Findings, plan: Plan | None = None
) -> DriveStates:
    """Slip and side slip of every wheel, at most once between two positions.

    The motion is found by `smooth`; the twin, held to it on the terrain, gives the velocity of each wheel in its
    contact plane, whatever the suspension does. Errors are those of the smoothed velocities; they do not hold errors
    that all positions or headings share, such as a heading that is off throughout.

    Parameters
    ----------
    telemetry : in the order of its file.
    terrain : the ground before the drive; its soil only says how the rover stands, not how it slips.
    findings : takes what is found wrong.
    plan : what was to be driven; None does not compare.

    Raises DataError for telemetry that cannot be used, or that is not in the frame or the units it should be.
    """
    telemetry = ordered(telemetry, findings)
    gaps = time_gaps(telemetry, findings)
    wheels = wheel_motion(telemetry, rover, gaps, findings, planned=plan is not None)
    angle, known = steering_angles(telemetry, rover, findings)
    wheels = dataclasses.replace(wheels, trusted=wheels.trusted & known[1:] & known[:-1])
    steering = np.radians(angle)
    twist, off = body_twist(rover, wheels.rim_m_s, 0.5 * (steering[1:] + steering[:-1]))
    _check_wheels_agree(wheels, off, findings)
    steps = np.diff(telemetry.time_s)
    way = np.append(0.0, np.cumsum(_mean_speed(wheels.rim_m_s) * steps))
    turned = np.degrees(np.append(0.0, np.cumsum(twist[:, 2] * steps)))
    telemetry = usable_positions(telemetry, way, findings)
    telemetry = usable_headings(telemetry, turned, findings)
    check_frame(telemetry, twist, findings)
    if plan is not None:
        check_against_plan(telemetry, rover, plan, findings)
    nodes, rows = _nodes(telemetry, wheels, twist, way, gaps)
    smoothed, nodes, left_out = without_outliers(nodes, findings)
    still = np.zeros((len(rows), 2))
    first = forces_along(rover, terrain, _motion(telemetry, nodes, smoothed, wheels, steering, rows, still))
    sway = sway_m(rover, first.paths)
    nodes = dataclasses.replace(nodes, fix_m=nodes.fix_m - sway)
    smoothed = smooth(nodes, (smoothed.amplitude, smoothed.length_m))
    motion = _motion(telemetry, nodes, smoothed, wheels, steering, rows, sway)
    held = forces_along(rover, terrain, motion)
    check_scatter(smoothed, nodes, findings)
    check_glide(smoothed, findings)
    check_attitude(telemetry, held, rows, findings)
    times = telemetry.time_s
    return DriveStates(
        rover=rover,
        telemetry=telemetry,
        nodes=nodes,
        smoothed=smoothed,
        motion=motion,
        held=held,
        rows=_state_rows(telemetry, rover, wheels, nodes, smoothed, motion, held, rows, gaps, findings),
        gaps=np.column_stack([times[:-1][gaps], times[1:][gaps]]),
        left_out=left_out,
        findings=findings,
    )


def _check_wheels_agree(wheels: WheelMotion, off_m_s: FloatArray, findings: Findings) -> None:
    """The wheels of one rigid rover must tell of one motion."""
    share = off_m_s[wheels.moving] / wheels.usual_m_s
    if share.size and float(np.median(share)) > DISAGREE:
        what = f"rims and steering of the wheels differ by {100 * float(np.median(share)):.2g} % from any one motion"
        done = "their best fit is taken; are the wheels named as they should be?"
        findings.add("wheels disagree", what, done, doubt=True)


def _mean_speed(rim_m_s: FloatArray) -> FloatArray:
    """Root mean square of the known rims. (n,)"""
    known = np.isfinite(rim_m_s)
    squares = np.where(known, np.nan_to_num(rim_m_s) ** 2, 0.0).sum(axis=1)
    return np.asarray(np.sqrt(squares / np.maximum(known.sum(axis=1), 1)))


def _drives(wheels: WheelMotion, twist: FloatArray) -> BoolArray:
    """Between which rows the rover drives: not at a halt, nor turning on the spot. (n - 1,)"""
    speed = np.hypot(twist[:, 0], twist[:, 1])
    return np.asarray(
        wheels.moving & (speed > 0.1 * _mean_speed(wheels.rim_m_s)) & (speed > STILL_SHARE * wheels.usual_m_s)
    )


def _nodes(
    telemetry: Telemetry, wheels: WheelMotion, twist: FloatArray, way_m: FloatArray, gaps: BoolArray
) -> tuple[Nodes, IntArray]:
    """Nodes and the rows they are."""
    drives = _drives(wheels, twist)
    stage = np.floor(way_m / NODE_M)
    chosen = telemetry.fixed | np.append(True, np.diff(stage) > 0)
    chosen[:-1] |= np.append(False, drives[1:] != drives[:-1]) | gaps
    chosen[1:] |= gaps
    chosen[-1] = True
    rows = np.flatnonzero(chosen)
    times = telemetry.time_s
    steps = np.diff(times)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, rows[:-1], axis=0))

    length = np.diff(times[rows])
    blind = total((gaps * steps * np.nan_to_num(_mean_speed(wheels.rim_m_s))).astype(float))
    kinds = drives[rows[:-1]]
    return (
        Nodes(
            time_s=times[rows],
            twist=total(twist * steps[:, None]) / length[:, None],
            way_m=np.diff(way_m[rows]),
            loose=GAP_SHARE * blind,
            apart=np.append(False, kinds[1:] != kinds[:-1]),
            fix_m=telemetry.fix_m[rows],
            fix_covariance_m2=telemetry.fix_covariance_m2[rows],
            yaw_rad=np.radians(telemetry.yaw_deg[rows]),
            yaw_sigma_rad=np.radians(telemetry.yaw_deg_sigma[rows]),
        ),
        rows,
    )


def _motion(
    telemetry: Telemetry,
    nodes: Nodes,
    smoothed: Smoothed,
    wheels: WheelMotion,
    steering_rad: FloatArray,
    rows: IntArray,
    sway_m: FloatArray,
) -> Motion:
    """The smoothed motion of the rover's origin, with the wheels as they were measured."""
    rim = _at_nodes(telemetry.time_s, wheels.rim_m_s, rows)
    sign = np.where(rim < 0, -1.0, 1.0)
    rim = sign * np.maximum(np.abs(np.nan_to_num(rim)), CREEP_M_S)
    steered = np.column_stack([_mean_about(column, rows) for column in np.degrees(steering_rad).T])
    return Motion(
        time_s=nodes.time_s,
        x_m=smoothed.state[:, 0] + sway_m[:, 0],
        y_m=smoothed.state[:, 1] + sway_m[:, 1],
        yaw_deg=np.degrees(smoothed.state[:, 2]),
        steering_deg=np.clip(steered, -90.0, 90.0),
        speed_m_s=rim,
    )


def _at_nodes(time_s: FloatArray, between: FloatArray, rows: IntArray) -> FloatArray:
    """Means between the nodes before and after each node, from means between rows. (nodes, wheels)"""
    steps = np.diff(time_s)[:, None]
    known = np.isfinite(between)
    total = np.vstack([np.zeros(between.shape[1]), np.cumsum(np.where(known, between, 0.0) * steps, axis=0)])
    spent = np.vstack([np.zeros(between.shape[1]), np.cumsum(known * steps, axis=0)])
    low, high = rows[np.maximum(np.arange(len(rows)) - 1, 0)], rows[np.minimum(np.arange(len(rows)) + 1, len(rows) - 1)]
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (total[high] - total[low]) / np.where(spent[high] > spent[low], spent[high] - spent[low], np.nan)
        )


def _mean_about(values: FloatArray, rows: IntArray) -> FloatArray:
    """Mean of a column over the rows nearer to each node than to others, both ways alike."""
    result = np.empty(len(rows))
    for k, row in enumerate(rows):
        reach = min(row - rows[k - 1] if k else 0, rows[k + 1] - row if k + 1 < len(rows) else 0) // 2
        result[k] = values[row - reach : row + reach + 1].mean()
    return result


def _state_rows(
    telemetry: Telemetry,
    rover: Rover,
    wheels: WheelMotion,
    nodes: Nodes,
    smoothed: Smoothed,
    motion: Motion,
    held: HeldForces,
    rows: IntArray,
    gaps: BoolArray,
    findings: Findings,
) -> StateRows:
    speed = np.hypot(nodes.twist[:, 0], nodes.twist[:, 1])
    steps = np.diff(nodes.time_s)
    drives = (speed > ON_THE_SPOT * nodes.way_m / steps) & (speed > STILL_SHARE * wheels.usual_m_s)
    distance = np.append(0.0, np.cumsum(np.where(drives, speed * steps, 0.0)))
    gap_nodes = np.add.reduceat(gaps.astype(int), rows[:-1]) > 0
    chosen, halted = _chosen(nodes, drives, distance, gap_nodes, telemetry.file)
    columns = {name: k for k, name in enumerate(STATE_COLUMNS)}
    slip, side = (held.states[chosen][..., columns[name]].copy() for name in ("slip_ratio", "side_slip_deg"))
    slip_sigma, side_sigma = _sigmas(rover, nodes, smoothed, motion, chosen, slip)
    low, high = rows[np.maximum(chosen - 1, 0)], rows[np.minimum(chosen + 1, len(rows) - 1)]
    trusted = np.array([wheels.trusted[a:b].all(axis=0) for a, b in zip(low, high, strict=True)])
    sound = held.outcome[chosen] == 0
    if not sound.all():
        findings.add(
            "off the terrain",
            "the rover does not stand on the terrain there",
            "states there are left blank, not valid",
            count=int((~sound).sum()),
            time_s=float(nodes.time_s[chosen[int(np.argmin(sound))]]),
            doubt=True,
        )
    fast = np.abs(slip) > VALID_SLIP
    slip[halted], side[halted] = 0.0, 0.0
    blank = np.full(slip.shape, np.nan)
    return StateRows(
        node=chosen,
        distance_m=distance[chosen],
        place_m=held.states[chosen][..., :2],
        slip_ratio=slip,
        slip_ratio_sigma=slip_sigma,
        side_slip_deg=side,
        side_slip_deg_sigma=side_sigma,
        sinkage_m=blank,
        sinkage_m_sigma=blank.copy(),
        valid=trusted & sound[:, None] & ~fast & ~halted[:, None],
    )


def _chosen(
    nodes: Nodes, drives: BoolArray, distance_m: FloatArray, gap: BoolArray, file: str
) -> tuple[IntArray, BoolArray]:
    """Nodes midway between positions, no closer than `LEAST_ROW_M` and out of gaps, and one for each halt.

    Nodes and whether each is a halt.
    """
    fixes = np.flatnonzero(np.isfinite(nodes.fix_m).all(axis=1))
    pace = nodes.way_m / np.diff(nodes.time_s)
    even = np.abs(np.log(np.maximum(pace[1:], 1e-12) / np.maximum(pace[:-1], 1e-12))) < UNEVEN
    calm = np.append(False, drives[1:] & drives[:-1] & even)
    calm = np.append(calm, False)[: len(nodes.time_s)]
    calm[:-1] &= ~gap
    calm[1:] &= ~gap
    result: list[int] = []
    last = -math.inf
    for a, b in itertools.pairwise(fixes):
        inside = np.arange(a, b + 1)[calm[a : b + 1]]
        middle = 0.5 * (distance_m[a] + distance_m[b])
        if not inside.size or gap[a:b].any() or distance_m[b] == distance_m[a]:
            continue
        node = int(inside[np.argmin(np.abs(distance_m[inside] - middle))])
        if distance_m[node] - last >= LEAST_ROW_M:
            result.append(node)
            last = float(distance_m[node])
    still = np.flatnonzero(np.append(~drives, False))
    groups = np.split(still, np.flatnonzero(np.diff(still) > 1) + 1) if still.size else []
    halts = [int(group[len(group) // 2]) for group in groups if group.size]
    if not result:
        raise DataError(f"{file}: no two positions with a drive between them that has neither gap nor halt; no slip")
    nodes_found = np.array(sorted({*result, *halts}), dtype=np.intp)
    return nodes_found, np.isin(nodes_found, halts)


def _sigmas(
    rover: Rover, nodes: Nodes, smoothed: Smoothed, motion: Motion, chosen: IntArray, slip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Standard errors of slip and side slip, from those of the rover's velocities. (m, wheels) [-, deg]"""
    pick = np.zeros((3, smoothed.state.shape[1]))
    for row, (k, mean) in enumerate(zip(AHEAD, MEANS, strict=True)):
        pick[row, k] = pick[row, mean] = 1.0
    before, after = np.maximum(chosen - 1, 0), np.minimum(chosen, len(nodes.way_m) - 1)
    span = np.diff(nodes.time_s)
    pace = 0.5 * (nodes.way_m[before] / span[before] + nodes.way_m[after] / span[after])
    twist = 0.5 * (nodes.twist[before] + nodes.twist[after]) + pace[:, None] * smoothed.deviation[chosen]
    covariance = pick @ smoothed.covariance[chosen] @ pick.T * pace[:, None, None] ** 2
    along, across = wheel_rows(rover, np.radians(motion.steering_deg[chosen]))
    v_x, v_y = (np.einsum("mwi,mi->mw", part, twist) for part in (along, across))
    rim = np.abs(motion.speed_m_s[chosen])
    travel_sigma = np.sqrt(np.einsum("mwi,mij,mwj->mw", along, covariance, along)) / rim
    steep = np.where(slip >= 0, 1.0, (1.0 + np.minimum(slip, 0.0)) ** 2)
    squared = v_x**2 + v_y**2
    weights = (across * np.abs(v_x)[..., None] - along * (np.sign(v_x) * v_y)[..., None]) / squared[..., None]
    side_sigma = np.degrees(np.sqrt(np.einsum("mwi,mij,mwj->mw", weights, covariance, weights)))
    return np.hypot(steep * travel_sigma, SLIP_FLOOR), np.hypot(side_sigma, SIDE_SLIP_FLOOR_DEG)
