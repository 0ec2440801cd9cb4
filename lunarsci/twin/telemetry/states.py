"""From telemetry to the states of the wheels: slip, side slip and sinkage, each with its error, and tables of them.

The smoothed motion also tells which hypotheses about its telemetry hold, and which positions fit no motion.
"""

import dataclasses
import itertools
import math
import warnings
from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.lanes import CLIFF, HOLE, LEFT, OVERTURNED
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.plans.path import Schedule, commanded_ratios, make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import VALID_SLIP
from lunarsci.twin.simulation.ensemble import MOST_BEYOND
from lunarsci.twin.simulation.prescribed_motion import PrescribedLoads, prescribed_loads
from lunarsci.twin.telemetry.checks import (
    FAST,
    HALT,
    WheelPace,
    aligned_with_plan,
    check_attitude,
    check_ends,
    check_pace,
    check_slips,
    ordered,
    steering_angles,
    time_gaps,
    usable_headings,
    usable_positions,
    with_wheels,
)
from lunarsci.twin.telemetry.filter import LAG, LEVER, LINEAR_S, MOST_PARTS, SCALE, Nodes, lag_of_turns, linearised
from lunarsci.twin.telemetry.hypotheses import (
    FINEST_M,
    FREEDOM,
    MOTION,
    REPORTED,
    Posterior,
    Priors,
    as_meant,
    in_units,
)
from lunarsci.twin.telemetry.nodes import (
    Rows,
    densified,
    motion_at,
    nodes_of,
    overlapping,
    shifted_back,
    slips_of,
    turn_effect,
    wheel_velocities,
    with_ground_effects,
)
from lunarsci.twin.telemetry.reading import LEAST_ROW_M, OBEYED, SHARED, STILL, SURE, Findings, Positions, Telemetry
from lunarsci.twin.telemetry.smoother import FAR, SlipProcess, Smoothed, smooth
from lunarsci.twin.telemetry.wheel_motion import (
    ON_THE_SPOT,
    WheelMotion,
    body_twist,
    mean_speed,
    of_one_motion,
    sway_m,
    wheel_motion,
)

if TYPE_CHECKING:
    import pandas as pd

HARDLY = (FREEDOM + 2.0) / (FREEDOM + FAR)
"""Weight below which, beside the best one, a position or a heading is said to be left out: that of `FAR`."""
MOST_LEFT_OUT = 0.2
"""Share of the positions left out beyond which the result is in doubt; assumed."""
LATE = next(one for one in MOTION if one.name == "lag")
MOST_LAGS = 3
"""Times that a lag is put back and looked for again."""
BASIS = "positions"
"""What slip and side slip rest on: the positions of `position_table`."""


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
    drives = (speed > ON_THE_SPOT * nodes.way_m / steps) & (speed > STILL * wheels.usual_m_s)
    distance = np.append(0.0, np.cumsum(np.where(drives, speed * steps, 0.0)))
    gap_nodes = np.add.reduceat(gaps.astype(int), rows[:-1]) > 0
    chosen, halted = _state_nodes(nodes, drives, distance, gap_nodes, findings)
    velocities = wheel_velocities(rover, nodes, smoothed, held)
    slip, side, slip_sigma, side_sigma, shared = (part[chosen] for part in slips_of(velocities, motion))
    low, high = (rows[np.clip(chosen + step, 0, len(rows) - 1)] for step in (-1, 1))
    trusted = np.array([wheels.trusted[a:b].all(axis=0) for a, b in zip(low, high, strict=True)])
    sound = ~np.isin(held.outcome[chosen], (LEFT, HOLE, OVERTURNED, CLIFF))
    what, done = "the rover does not stand on the terrain there", "states there are left blank, not valid"
    findings.of_rows("off the terrain", what, done, ~sound, nodes.time_s[chosen], doubt=True)
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


def _state_nodes(
    nodes: Nodes, drives: BoolArray, distance_m: FloatArray, gap: BoolArray, findings: Findings
) -> tuple[IndexArray, BoolArray]:
    """Nodes midway between positions, no closer than `LEAST_ROW_M`, and one for each halt.

    Nodes and whether each is a halt. They are out of gaps, and where the rover keeps its speed, if there are such.
    """
    fixes = np.flatnonzero(nodes.fixed)
    pace = nodes.way_m / np.diff(nodes.time_s)
    even = np.abs(np.log(np.maximum(pace[1:], 1e-12) / np.maximum(pace[:-1], 1e-12))) < OBEYED
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
    chosen = np.array(sorted({*result, *halts}), dtype=np.intp)
    return chosen, np.isin(chosen, halts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """By how much positions and headings are later than the columns of the wheels.

    Attributes
    ----------
    lag_s, sigma_s : positive where the rover moves later than its wheels say. [s]
    probable : that there is more than clocks usually differ by.
    """

    lag_s: float
    sigma_s: float
    probable: float

    @classmethod
    def of(cls, posterior: Posterior, priors: Priors, put_back_s: float) -> "Lag":
        """From the constants of a drive in which so much was put back."""
        number = [one.name for one in priors.hypotheses].index("lag")
        sigma = math.sqrt(posterior.covariance[LAG, LAG])
        probable = 1.0 if put_back_s else float(posterior.probable[number])
        return cls(lag_s=put_back_s + float(posterior.mean[LAG]), sigma_s=sigma, probable=probable)

    @property
    def likely(self) -> bool:
        """Whether a lag is more probable than none."""
        return self.probable > REPORTED

    def to_dict(self) -> dict[str, float | bool]:
        """For a result."""
        return {"lag_s": self.lag_s, "sigma_s": self.sigma_s, "found": self.likely}


def report_hypotheses(smoothed: Smoothed, nodes: Nodes, priors: Priors, lag: Lag, findings: Findings) -> None:
    """Report each hypothesis that is more probable than not, with its constants; the motion contains it."""
    mean, sigma = smoothed.posterior.mean, np.sqrt(np.diag(smoothed.posterior.covariance))
    for one, probable in zip(priors.hypotheses, smoothed.posterior.probable, strict=True):
        late = one.name == "lag"
        probable = lag.probable if late else probable
        if probable <= REPORTED or not one.what:
            continue
        values: list[object] = [f"{one.factor * mean[k]:.3g} +- {one.factor * sigma[k]:.2g}" for k in one.members]
        doubt, time_s = False, None
        if late:
            values = [f"{abs(lag.lag_s):.3g} +- {lag.sigma_s:.2g} s {'later' if lag.lag_s > 0 else 'earlier'}"]
        elif one.members == (SCALE,):
            values = [f"{math.exp(mean[SCALE]):.3f} +- {sigma[SCALE]:.3f}"]
        elif one.slide >= 0:
            first, last = nodes.slides[one.slide]
            halted, time_s = one.slide < len(nodes.halts), float(nodes.time_s[first])
            how = "while its wheels stand: it slid" if halted else "more than its wheels roll: it slipped suddenly"
            values += [time_s, nodes.time_s[last], how]
            # Farther than its wheels roll no slip makes it go.
            moved = float(np.hypot(*(smoothed.state[last, :2] - smoothed.state[first, :2])))
            farther = moved - float(nodes.way_m[first:last].sum())
            doubt = not halted and farther > SURE * math.hypot(*sigma[list(one.members)])
        done = one.done.format(f"{lag.lag_s:.2f}") + (f" (probability {probable:.3g})" if one.slide < 0 else "")
        findings.add(one.name, one.what.format(*values), done, time_s=time_s, doubt=doubt)


def _outliers(smoothed: Smoothed, nodes: Nodes) -> BoolArray:
    return np.asarray(nodes.fixed & (smoothed.fix_weight < HARDLY * smoothed.fix_weight[nodes.fixed].max()))


def shifted(smoothed: Smoothed, nodes: Nodes) -> Nodes:
    """Nodes whose positions may shift just before or behind those that hardly count."""
    fixes, out = np.flatnonzero(nodes.fixed), _outliers(smoothed, nodes)[nodes.fixed]
    # A shift beside the first or the last position is that position's own.
    inner = list(zip(pairwise(fixes), out[1:] | out[:-1], strict=True))[1:-1]
    ways = [pair for pair, odd in inner if odd]
    moved = (nodes.way_m[first:last].any() for first, last in ways)
    jumps = tuple((int(a), int(b)) for (a, b), rolls in zip(ways, moved, strict=True) if rolls)
    return replace(nodes, jumps=jumps[:MOST_PARTS])


def left_out_of(smoothed: Smoothed, nodes: Nodes) -> FloatArray:
    """Positions that hardly count: time, x, y. (o, 3) [s, m, m]"""
    rows = _outliers(smoothed, nodes)
    return np.column_stack([nodes.time_s[rows], nodes.fix_m[rows]])


def report_outliers(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Report positions and headings that hardly count, and errors that nobody can believe."""
    given = np.isfinite(nodes.yaw_rad)
    odd = given & (smoothed.yaw_weight < HARDLY)
    many = bool(odd.sum() > MOST_LEFT_OUT * given.sum())
    what = f"{odd.sum()} of {given.sum()} headings fit no motion of the wheels"
    findings.of_rows("odd heading", what, "they hardly count", odd, nodes.time_s, doubt=many)
    sigma = float(np.median(np.sqrt(np.trace(nodes.fix_covariance_m2[nodes.fixed], axis1=1, axis2=2) / 2.0)))
    if sigma < 0.5 * FINEST_M:
        what = f"positions claim errors of {1e3 * sigma:.2g} mm, which no localisation of a rover reaches"
        findings.add("errors too small", what, "kept; are they in another unit?", doubt=True)
    left, fixes = np.flatnonzero(_outliers(smoothed, nodes)), np.flatnonzero(nodes.fixed)
    if not left.size:
        return
    what, done = f"{len(left)} of {len(fixes)} positions fit no motion of the wheels", "they hardly count"
    ends = [name for name, node in (("first", fixes[0]), ("last", fixes[-1])) if node in left]
    if ends:
        what += f", the {' and the '.join(ends)} one too"
        done += "; no position lies beyond it to say whether it or the motion is wrong"
    doubt = "last" in ends or len(left) > MOST_LEFT_OUT * len(fixes)
    findings.add("position jump", what, done, count=len(left), time_s=float(nodes.time_s[left[0]]), doubt=doubt)


def counted_positions(
    sent: Telemetry, rows: IndexArray, nodes: Nodes, smoothed: Smoothed, left_out: FloatArray
) -> Positions:
    """Those that count, without what the localised point's place on the rover and what is left of a lag add."""
    used = nodes.fixed & ~np.isin(nodes.time_s, left_out[:, 0])
    members = np.r_[LEVER, LAG]
    added = linearised(nodes, smoothed.reference).by[:, :2, members] @ smoothed.posterior.mean[members]
    shared = None
    if sent.fix_shared_m2 is not None:
        # The one before may have been left out; what the two share is then not known.
        after_used = np.append(False, used[nodes.fixed][:-1])[used[nodes.fixed]]
        shared = sent.fix_shared_m2[rows][used] * after_used[:, None, None]
    place, covariance = sent.fix_m[rows] - added, sent.fix_covariance_m2[rows]
    return Positions(nodes.time_s[used], place[used], covariance[used], shared)


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
    over how fast slip may change and over what `smoother` lists; they do not hold those of the terrain.

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
    legs = () if plan is None else plan.legs
    tested = {leg.wheel_test.wheel for leg in legs if leg.wheel_test is not None}
    named = in_units(with_wheels(ordered(telemetry, findings), findings), rover, findings)
    sent, schedule = _wheel_turns(named, rover, findings, tested), None
    as_planned, longer_s, pace = False, 0.0, None
    if plan is not None:
        schedule = make_schedule(plan, rover)
        sent, as_planned, longer_s = aligned_with_plan(sent, rover, schedule, findings)
    twist, way = _way(rover, sent, schedule)
    telemetry = sent.telemetry
    turned = np.degrees(np.append(0.0, np.cumsum(twist[:, 2] * np.diff(telemetry.time_s))))
    telemetry = usable_headings(usable_positions(telemetry, way, findings), turned, findings)
    skids = not rover.steered_mask.any()
    meant = as_meant(telemetry, twist, findings, skids=skids, as_planned=as_planned)
    if meant is not telemetry:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LunarSciWarning)
            sent = _wheel_turns(meant, rover, Findings(meant.file), tested)
    sent = sent._replace(telemetry=meant)
    if plan is not None and schedule is not None:
        check_ends(meant, schedule, longer_s, findings)
        pace = check_pace(sent.wheels.rim_m_s, sent.wheels.measured, meant, rover, plan, findings)
    return dataclasses.replace(_along_the_ground(sent, rover, terrain, schedule, lag_s, findings), pace=pace)


def _wheel_turns(telemetry: Telemetry, rover: Rover, findings: Findings, tested: Collection[str]) -> Rows:
    """How the wheels turned and were steered."""
    gaps = time_gaps(telemetry, findings)
    wheels = wheel_motion(telemetry, rover, gaps, findings)
    angle, steered = steering_angles(telemetry, rover, findings)
    wheels = replace(wheels, trusted=wheels.trusted & steered[1:] & steered[:-1])
    steering = np.radians(angle)
    middle, steps = 0.5 * (steering[1:] + steering[:-1]), np.diff(telemetry.time_s)
    return Rows(telemetry, of_one_motion(wheels, rover, middle, steps, findings, tested), steering, gaps)


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
    first_motion = _first_motion(sent, rover, schedule, lag_s)
    if far_s := lag_of_turns(first_motion.nodes, 10.0 * LATE.sigma):
        # Of two lags, none and the one that turns tell, the more probable one is taken, by what both can use.
        common = overlapping(sent, far_s)
        late, none = (_first_motion(common, rover, schedule, lag_s + one) for one in (far_s, 0.0))
        gain = late.smoothed.posterior.ln_likelihood - none.smoothed.posterior.ln_likelihood
        if gain > 0.5 * (far_s / LATE.sigma) ** 2:
            first_motion = _first_motion(sent, rover, schedule, lag_s + far_s)
    for _ in range(MOST_LAGS):
        if abs(left := float(first_motion.smoothed.posterior.mean[LAG])) < LINEAR_S:
            break
        first_motion = _first_motion(sent, rover, schedule, first_motion.lag_s + left)
    bare, rows, first, priors = first_motion.nodes, first_motion.rows, first_motion.smoothed, first_motion.priors
    dense, wheels, steering, gaps = first_motion.sent
    if (tried := shifted(first, bare)).jumps:
        bare, priors = tried, _priors_of(tried, rover, wheels)
        first = smooth(bare, SlipProcess.coarse(), priors, first.reference.widened(bare))
    motion = motion_at(rover, dense, bare, first, wheels, steering, rows, np.zeros((1, 2)))
    stood = prescribed_loads(rover, terrain, motion)
    sway = sway_m(rover, stood.paths)
    nodes = with_ground_effects(rover, bare, stood, sway, priors, first.reference)
    smoothed = smooth(nodes, None, priors, first.reference)
    motion = motion_at(rover, dense, nodes, smoothed, wheels, steering, rows, sway)
    held = prescribed_loads(rover, terrain, motion)
    lag = Lag.of(smoothed.posterior, priors, first_motion.lag_s - lag_s)
    report_hypotheses(smoothed, nodes, priors, lag, findings)
    report_outliers(smoothed, nodes, findings)
    check_attitude(dense, held, rows, findings)
    left_out = left_out_of(smoothed, bare)
    return DriveStates(
        rover=rover,
        telemetry=sent.telemetry,
        nodes=nodes,
        smoothed=smoothed,
        motion=motion,
        held=held,
        rows=state_rows(rover, wheels, nodes, smoothed, motion, held, rows, gaps, findings),
        gaps=between,
        positions=counted_positions(dense, rows, nodes, smoothed, left_out),
        left_out=left_out,
        findings=findings,
        lag=lag,
    )


class _FirstMotion(NamedTuple):
    """The motion where the ground is not known yet, with a lag put back.

    Attributes
    ----------
    sent : rows of telemetry, positions, headings and attitude at the time of the wheels that made them.
    nodes : the moments at which the motion is estimated.
    rows : numbers of the nodes that are rows of `sent`.
    smoothed : the motion at the nodes.
    priors : of the constants of the drive.
    lag_s : by which positions lag behind the commands. [s]
    """

    sent: Rows
    nodes: Nodes
    rows: IndexArray
    smoothed: Smoothed
    priors: Priors
    lag_s: float


def _first_motion(sent: Rows, rover: Rover, schedule: Schedule | None, lag_s: float) -> _FirstMotion:
    sent = densified(shifted_back(sent, lag_s))
    twist, way = _way(rover, sent, schedule)
    nodes, rows = nodes_of(sent, twist, way)
    nodes = dataclasses.replace(nodes, effect=turn_effect(nodes))
    priors = _priors_of(nodes, rover, sent.wheels)
    return _FirstMotion(sent, nodes, rows, smooth(nodes, SlipProcess.coarse(), priors), priors, lag_s)


def _priors_of(nodes: Nodes, rover: Rover, wheels: WheelMotion) -> Priors:
    return Priors.of_drive(nodes, skids=not rover.steered_mask.any(), obedience=wheels.obedience)


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


def wheel_table(drive: DriveStates) -> "pd.DataFrame":
    """A row for each time and wheel: what `lunarsci twin update` reads as states.

    Columns time_s, distance_m, wheel, x_m, y_m, sinkage_m, sinkage_m_sigma, slip_ratio, slip_ratio_sigma,
    side_slip_deg, side_slip_deg_sigma, slip_ratio_shared, valid, slip_basis, rim_m_s, rover, ground, and doubt where
    there is some.
    """
    import pandas as pd

    rows, names, each = drive.rows, drive.rover.wheels, len(drive.rover.wheels)
    columns = {
        "time_s": np.repeat(drive.nodes.time_s[rows.node], each),
        "distance_m": np.repeat(rows.distance_m, each),
        "wheel": np.tile(names, len(rows.node)),
        "x_m": rows.place_m[..., 0].ravel(),
        "y_m": rows.place_m[..., 1].ravel(),
    }
    for name in ("sinkage_m", "slip_ratio", "side_slip_deg"):
        columns[name] = getattr(rows, name).ravel()
        columns[f"{name}_sigma"] = getattr(rows, f"{name}_sigma").ravel()
    columns["slip_ratio_shared"] = rows.slip_ratio_shared.ravel()
    columns["valid"] = rows.valid.ravel()
    # What leaves the states right, and not a soil learned from them with the plan.
    kinds = (HALT, FAST) if rows.fast.sum() > MOST_BEYOND * rows.measured.sum() else (HALT,)
    return _named(pd.DataFrame(columns).assign(slip_basis=BASIS, rim_m_s=rows.rim_m_s.ravel()), drive, kinds)


def _named(table: "pd.DataFrame", drive: DriveStates, kinds: tuple[str, ...] = ()) -> "pd.DataFrame":
    """With the rover, its ground, and why the table is doubtful, by findings that are a doubt or of some kinds."""
    doubts = [
        f"{one.kind}: {one.what}" if one.doubt else f"{one.kind}: {one.what}; {one.done}"
        for one in drive.findings.entries
        if one.doubt or one.kind in kinds
    ]
    table = table.assign(rover=drive.rover.written, ground=drive.held.terrain.written)
    return table.assign(doubt="; ".join(doubts)) if doubts else table


def position_table(drive: DriveStates) -> "pd.DataFrame":
    """`DriveStates.positions`: time_s, x_m, y_m, xx_m2, xy_m2, yy_m2, and `SHARED` where it is known."""
    import pandas as pd

    used = drive.positions
    columns = {
        "time_s": used.time_s,
        "x_m": used.place_m[:, 0],
        "y_m": used.place_m[:, 1],
        "xx_m2": used.covariance_m2[:, 0, 0],
        "xy_m2": used.covariance_m2[:, 0, 1],
        "yy_m2": used.covariance_m2[:, 1, 1],
    }
    if used.shared_m2 is not None:
        columns |= dict(zip(SHARED, used.shared_m2.reshape(-1, 4).T, strict=True))
    return pd.DataFrame(columns)


def motion_table(drive: DriveStates) -> "pd.DataFrame":
    """The smoothed motion with the wheels' measured commands: what `lunarsci twin loads` reads.

    Columns time_s, x_m, y_m, yaw_deg, their NAME_sigma, steering_W_deg, speed_W_m_s of each wheel W, rover,
    ground, and doubt where there is some.
    """
    import pandas as pd

    motion, covariance = drive.motion, drive.smoothed.covariance
    columns = {name: getattr(motion, name) for name in ("time_s", "x_m", "y_m", "yaw_deg")}
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :3])
    columns |= {"x_m_sigma": errors[:, 0], "y_m_sigma": errors[:, 1], "yaw_deg_sigma": np.degrees(errors[:, 2])}
    for k, wheel in enumerate(drive.rover.wheels):
        columns[f"steering_{wheel}_deg"] = motion.steering_deg[:, k]
        columns[f"speed_{wheel}_m_s"] = motion.speed_m_s[:, k]
    return _named(pd.DataFrame(columns), drive)
