"""From telemetry to the states of the wheels: slip, side slip and sinkage, each with its error, and tables of them."""

import dataclasses
import itertools
import math
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.lanes import CLIFF, HOLE, LEFT, OVERTURNED
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads, prescribed_loads
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import Schedule, commanded_ratios, make_schedule
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact_frame import VALID_SLIP
from lunarsci.twin.telemetry.checks import (
    WheelPace,
    check_pace,
    check_slips,
    check_stands,
    ordered,
    steering_angles,
    time_gaps,
)
from lunarsci.twin.telemetry.findings_of_drive import (
    Lag,
    counted_positions,
    left_out_of,
    say_constants,
    say_left_out,
    say_scatter,
    shifted,
)
from lunarsci.twin.telemetry.motion_nodes import LAG, LINEAR_S, Nodes, lag_of_turns
from lunarsci.twin.telemetry.nodes import (
    Rows,
    denser,
    mean_speed,
    motion_at,
    nodes_of,
    on_ground,
    put_back,
    slips_of,
    turn_effect,
    wheel_velocities,
    within,
)
from lunarsci.twin.telemetry.nuisances import LATE_S, Priors
from lunarsci.twin.telemetry.odometry import body_twist, of_one_motion
from lunarsci.twin.telemetry.plan_checks import by_the_plan, check_ends
from lunarsci.twin.telemetry.positions import check_attitude, sway_m, usable_headings, usable_positions
from lunarsci.twin.telemetry.reading import Findings, Positions, Telemetry
from lunarsci.twin.telemetry.readings import as_meant
from lunarsci.twin.telemetry.slip_process import SlipProcess
from lunarsci.twin.telemetry.smoother import Smoothed, smooth
from lunarsci.twin.telemetry.wheel_motion import STILL_SHARE, WheelMotion, wheel_motion
from lunarsci.twin.telemetry.wheel_readings import in_units

MOST_LAGS = 3
"""Times that a lag is put back and looked for again."""
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveStates:
    """What a drive's telemetry says of its wheels.

    Attributes
    ----------
    rover, telemetry : what it was computed from; the telemetry as used, mended.
    nodes, smoothed, motion, held : the motion at its nodes, and the rover along it on the terrain.
    rows : states of the wheels.
    gaps : begin and end of the gaps in time. (g, 2) [s]
    positions : those that count, of the rover's origin and by the clock of its wheels, with the errors they came with.
    left_out : those that hardly count, as they fit no motion: time, x, y. (o, 3) [s, m, m]
    findings : what was found wrong.
    lag : how much later the rover moves than its wheels say.
    pace : how fast the wheels turned beside the plan; None where there is no plan, or nothing measured.
    """

    rover: Rover
    telemetry: Telemetry
    nodes: Nodes
    smoothed: Smoothed
    motion: Motion
    held: PrescribedLoads
    rows: StateRows
    gaps: FloatArray
    positions: Positions
    left_out: FloatArray
    findings: Findings
    lag: Lag
    pace: WheelPace | None = None

    @property
    def driven_m(self) -> float:
        """Length of the estimated way of the rover's origin; that of its wheels is longer by their slip. [m]"""
        return float(np.hypot(np.diff(self.motion.x_m), np.diff(self.motion.y_m)).sum())


def states_of(
    telemetry: Telemetry,
    rover: Rover,
    terrain: Terrain,
    findings: Findings,
    plan: Plan | None = None,
    lag_s: float = 0.0,
) -> DriveStates:
    """Slip and side slip of every wheel, at most once between two positions.

    They are those of the moment of a row, not means about it. The motion is found by `smooth`; the twin, held to it on
    the terrain, gives the velocity of each wheel in its contact plane, whatever the suspension does, and how slopes and
    loads make the rover slip, in proportions that the data tell. Errors are those of the smoothed velocities, averaged
    over how fast slip may change and over what `nuisances` lists; they do not hold those of the terrain.

    Parameters
    ----------
    telemetry : in the order of its file.
    terrain : the ground before the drive; its soil only says how the rover stands, not how it slips.
    findings : takes what is found wrong.
    plan : what was to be driven; None does not compare.
    lag_s : how much later positions, headings and attitude are known to be than the columns of the wheels; what is left
        of a lag is found. [s]

    Raises DataError for telemetry that cannot be used, or that is not in the frame or the units it should be.
    """
    telemetry, schedule = in_units(ordered(telemetry, findings), rover, findings), None
    as_planned, longer_s, pace = False, 0.0, None
    if plan is not None:
        schedule = make_schedule(plan, rover)
        telemetry, as_planned, longer_s = by_the_plan(telemetry, rover, schedule, findings)
    sent = _turned(telemetry, rover, findings, planned=plan is not None)
    twist, way = _way(rover, sent, schedule)
    turned = np.degrees(np.append(0.0, np.cumsum(twist[:, 2] * np.diff(telemetry.time_s))))
    telemetry = usable_headings(usable_positions(telemetry, way, findings), turned, findings)
    skids = not rover.steered_mask.any()
    meant = as_meant(telemetry, twist, findings, skids=skids, as_planned=as_planned)
    if (meant.turned_deg != telemetry.turned_deg).any() or (meant.angle_deg != telemetry.angle_deg).any():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LunarSciWarning)
            sent = _turned(meant, rover, Findings(meant.file), planned=plan is not None)
    sent = sent._replace(telemetry=meant)
    if plan is not None and schedule is not None:
        check_ends(meant, schedule, longer_s, findings)
        pace = check_pace(sent.wheels.rim_m_s, sent.wheels.measured, meant, rover, plan, findings)
    found = _along_the_ground(sent, rover, terrain, schedule, lag_s, findings)
    return dataclasses.replace(found, pace=pace)


def _turned(telemetry: Telemetry, rover: Rover, findings: Findings, *, planned: bool) -> Rows:
    """How the wheels turned and were steered."""
    gaps = time_gaps(telemetry, findings)
    wheels = wheel_motion(telemetry, rover, gaps, findings, planned=planned)
    angle, known = steering_angles(telemetry, rover, findings)
    wheels, steering = dataclasses.replace(wheels, trusted=wheels.trusted & known[1:] & known[:-1]), np.radians(angle)
    return Rows(telemetry, of_one_motion(wheels, rover, 0.5 * (steering[1:] + steering[:-1]), findings), steering, gaps)


def _along_the_ground(
    sent: Rows,
    rover: Rover,
    terrain: Terrain,
    schedule: Schedule | None,
    lag_s: float,
    findings: Findings,
) -> DriveStates:
    """Find the motion, and how wheels that carry the rover along it over the ground slip; `findings` takes doubts."""
    times = sent.telemetry.time_s
    between = np.column_stack([times[:-1][sent.gaps], times[1:][sent.gaps]])
    found = _first_motion(sent, rover, schedule, lag_s)
    if far_s := lag_of_turns(found.nodes):
        # Of two lags, none and the one that turns tell, the more probable one is taken, by what both can use.
        common = within(sent, far_s)
        late, none = (_first_motion(common, rover, schedule, lag_s + one) for one in (far_s, 0.0))
        gain = late.smoothed.posterior.ln_likelihood - none.smoothed.posterior.ln_likelihood
        if gain > 0.5 * (far_s / LATE_S) ** 2:
            found = _first_motion(sent, rover, schedule, lag_s + far_s)
    for _ in range(MOST_LAGS):
        if abs(left := float(found.smoothed.posterior.mean[LAG])) < LINEAR_S:
            break
        found = _first_motion(sent, rover, schedule, found.lag_s + left)
    bare, rows, first, priors = found.nodes, found.rows, found.smoothed, found.priors
    dense, wheels, steering, gaps = found.sent
    if (tried := shifted(first, bare)).jumps:
        bare, priors = tried, _priors_of(tried, rover, wheels)
        first = smooth(bare, SlipProcess.coarse(), priors, first.reference.widened(bare))
    motion = motion_at(rover, dense, bare, first, wheels, steering, rows, np.zeros((1, 2)))
    stood = prescribed_loads(rover, terrain, motion)
    sway = sway_m(rover, stood.paths)
    nodes = on_ground(rover, bare, stood, sway, priors, first.reference)
    smoothed = smooth(nodes, None, priors, first.reference)
    motion = motion_at(rover, dense, nodes, smoothed, wheels, steering, rows, sway)
    held = prescribed_loads(rover, terrain, motion)
    lag = Lag.of(smoothed.posterior, priors, found.lag_s - lag_s)
    say_constants(smoothed, nodes, priors, lag, findings)
    say_left_out(smoothed, nodes, findings)
    say_scatter(smoothed, nodes, findings)
    check_attitude(dense, held, rows, findings)
    left_out = left_out_of(smoothed, bare)
    return DriveStates(
        rover=rover,
        telemetry=sent.telemetry,
        nodes=nodes,
        smoothed=smoothed,
        motion=motion,
        held=held,
        rows=_state_rows(dense, rover, wheels, nodes, smoothed, motion, held, rows, gaps, findings),
        gaps=between,
        positions=counted_positions(dense, rows, nodes, smoothed, left_out),
        left_out=left_out,
        findings=findings,
        lag=lag,
    )


class _FirstMotion(NamedTuple):
    """The motion where the ground is not known yet, with a lag put back."""

    sent: Rows
    nodes: Nodes
    rows: IndexArray
    smoothed: Smoothed
    priors: Priors
    lag_s: float


def _first_motion(sent: Rows, rover: Rover, schedule: Schedule | None, lag_s: float) -> _FirstMotion:
    sent = denser(put_back(sent, lag_s))
    twist, way = _way(rover, sent, schedule)
    nodes, rows = nodes_of(sent, twist, way)
    nodes = dataclasses.replace(nodes, effect=turn_effect(nodes))
    priors = _priors_of(nodes, rover, sent.wheels)
    return _FirstMotion(sent, nodes, rows, smooth(nodes, SlipProcess.coarse(), priors), priors, lag_s)


def _priors_of(nodes: Nodes, rover: Rover, wheels: WheelMotion) -> Priors:
    return Priors.of_drive(nodes, skids=not rover.steered_mask.any(), told_share=wheels.told_share)


def _way(rover: Rover, sent: Rows, schedule: Schedule | None) -> tuple[FloatArray, FloatArray]:
    """Twist that wheels without slip say between rows, and the way of the rims.

    A wheel that slips on purpose counts as fast as it would turn without.
    """
    times, rims, steering = sent.telemetry.time_s, sent.wheels.rim_m_s, sent.steering_rad
    if schedule is not None:
        rims = rims / commanded_ratios(rover, schedule, 0.5 * (times[1:] + times[:-1]))
    twist, _ = body_twist(rover, rims, 0.5 * (steering[1:] + steering[:-1]))
    way = np.append(0.0, np.cumsum(mean_speed(rims) * np.diff(times)))
    return twist, way


def _state_rows(
    telemetry: Telemetry,
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
    speed = np.hypot(nodes.twist[:, 0], nodes.twist[:, 1])
    steps = np.diff(nodes.time_s)
    drives = (speed > ON_THE_SPOT * nodes.way_m / steps) & (speed > STILL_SHARE * wheels.usual_m_s)
    distance = np.append(0.0, np.cumsum(np.where(drives, speed * steps, 0.0)))
    gap_nodes = np.add.reduceat(gaps.astype(int), rows[:-1]) > 0
    chosen, halted = _chosen(nodes, drives, distance, gap_nodes, telemetry.file)
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
    nodes: Nodes, drives: BoolArray, distance_m: FloatArray, gap: BoolArray, file: str
) -> tuple[IndexArray, BoolArray]:
    """Nodes midway between positions, no closer than `LEAST_ROW_M` and out of gaps, and one for each halt.

    Nodes and whether each is a halt.
    """
    fixes = np.flatnonzero(nodes.fixed)
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
