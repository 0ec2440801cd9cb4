"""From telemetry to the states of the wheels: slip, side slip and sinkage, each with its error, and tables of them.

What the smoothed motion says of its telemetry: which hypotheses hold, and which positions fit no motion.
"""

import dataclasses
import math
import warnings
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import LunarSciWarning
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads, prescribed_loads
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import Schedule, commanded_ratios, make_schedule
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.checks import (
    WheelPace,
    check_pace,
    ordered,
    steering_angles,
    time_gaps,
)
from lunarsci.twin.telemetry.filter import linearised
from lunarsci.twin.telemetry.motion_nodes import DRIFT, LAG, LEVER, LINEAR_S, SCALE, SLIDES, Nodes, lag_of_turns
from lunarsci.twin.telemetry.nodes import (
    Rows,
    denser,
    motion_at,
    nodes_of,
    on_ground,
    put_back,
    turn_effect,
    within,
)
from lunarsci.twin.telemetry.nuisances import LATE_S, Hypothesis, Posterior, Priors
from lunarsci.twin.telemetry.odometry import body_twist, mean_speed, of_one_motion
from lunarsci.twin.telemetry.plan_checks import by_the_plan, check_ends
from lunarsci.twin.telemetry.positions import check_attitude, sway_m, usable_headings, usable_positions
from lunarsci.twin.telemetry.reading import Findings, Positions, Telemetry
from lunarsci.twin.telemetry.readings import as_meant
from lunarsci.twin.telemetry.slip_process import SlipProcess
from lunarsci.twin.telemetry.smoother import MEDIAN_OF_TWO, Smoothed, smooth
from lunarsci.twin.telemetry.state_rows import StateRows, state_rows
from lunarsci.twin.telemetry.wheel_motion import WheelMotion, wheel_motion
from lunarsci.twin.telemetry.wheel_readings import in_units

HELD = 0.5
"""Probability from which on a hypothesis is said: it is more probable than not."""
SURE = 3.0
"""Standard errors by which a rover must go too far for it to be sure; assumed."""
HARDLY = 0.25
"""Weight below which, beside the best one, a position or a heading is said to be left out; assumed. By Student's law it
is then 4.5 standard errors off."""
MOST_JUMPS = 8
"""Ways on which positions may shift; where more are odd, positions are bad altogether; assumed."""
MOST_LEFT_OUT = 0.2
"""Share of the positions left out beyond which the result is in doubt; assumed."""
WORST_SCATTER = 4.0
"""Median square of what positions are off by over that of their errors beyond which it is said; assumed."""
LEAST_SCATTER, FINEST_M = 0.05, 5e-4
"""The same, and a standard error [m], below which errors of positions are not believed; assumed."""


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
    def found(self) -> bool:
        """Whether a lag is more probable than none."""
        return self.probable > HELD

    def to_dict(self) -> dict[str, float | bool]:
        """For a result."""
        return {"lag_s": self.lag_s, "sigma_s": self.sigma_s, "found": self.found}


def say_constants(smoothed: Smoothed, nodes: Nodes, priors: Priors, lag: Lag, findings: Findings) -> None:
    """Say each hypothesis that is more probable than not, with what was found; the motion holds it."""
    mean, sigma = smoothed.posterior.mean, np.sqrt(np.diag(smoothed.posterior.covariance))

    def value(k: int, unit: str, factor: float = 1.0) -> str:
        return f"{factor * mean[k]:.3g} +- {factor * sigma[k]:.2g} {unit}"

    ahead, left = LEVER.start, LEVER.start + 1
    text = {
        "lever arm": (
            f"positions are those of a point {value(ahead, 'm')} ahead and {value(left, 'm')} to the left of the "
            "rover's origin",
            "the motion is that of the origin; give positions of the origin",
        ),
        "heading drift": (
            f"headings drift by {value(DRIFT, 'deg', math.degrees(1.0))} until the end",
            "the motion is without the drift",
        ),
        "lag": (
            f"the rover moves {abs(lag.lag_s):.3g} +- {lag.sigma_s:.2g} s "
            f"{'later' if lag.lag_s > 0 else 'earlier'} than its wheels say",
            f"positions and headings are put back, as --lag {lag.lag_s:.2f} does",
        ),
        "constant side slip": (
            f"the rover glides by {value(1, 'deg', math.degrees(1.0))} all the way, positive to the left",
            "kept; a heading that is off throughout looks the same",
        ),
        "encoder scale": (
            f"the rims turn {math.exp(mean[SCALE]):.3f} +- {sigma[SCALE]:.3f} times as far as their encoders say",
            "slip is of the rims",
        ),
    }
    for one, probable in zip(priors.hypotheses, smoothed.posterior.probable, strict=True):
        probable = lag.probable if one.name == "lag" else probable
        if probable <= HELD or not one.said:
            continue
        if one.slide < 0:
            what, done = text[one.name]
            findings.add(one.name, what, f"{done} (probability {probable:.3g})")
            continue
        times = nodes.time_s[list(nodes.slides[one.slide])]
        ways = [SLIDES + 2 * one.slide + step for step in (0, 1)]
        halted = one.slide < len(nodes.halts)
        what = (
            f"the rover moves {value(ways[0], 'm')} ahead and {value(ways[1], 'm')} to the left between {times[0]:.6g} "
            f"and {times[1]:.6g} s "
            + ("while its wheels stand: it slid" if halted else "beside what its wheels roll: it slipped suddenly")
            + ", or positions are of another frame from then on"
        )
        done = "the motion holds it, and slips are found on either side"
        findings.add(one.name, what, done, time_s=float(times[0]), doubt=not halted and _too_far(smoothed, nodes, one))


def _too_far(smoothed: Smoothed, nodes: Nodes, one: Hypothesis) -> bool:
    """Whether the rover goes farther on the way of a shift than its wheels roll, which no slip makes of it."""
    first, last = nodes.slides[one.slide]
    moved = float(np.hypot(*(smoothed.state[last, :2] - smoothed.state[first, :2])))
    ways = list(one.members)
    sigma = math.sqrt(np.diag(smoothed.posterior.covariance)[ways].sum())
    return moved - float(nodes.way_m[first:last].sum()) > SURE * sigma


def _left_out(smoothed: Smoothed, nodes: Nodes) -> BoolArray:
    return np.asarray(nodes.fixed & (smoothed.fix_weight < HARDLY * smoothed.fix_weight[nodes.fixed].max()))


def shifted(smoothed: Smoothed, nodes: Nodes) -> Nodes:
    """Nodes whose positions may shift just before or behind those that hardly count."""
    fixes, out = np.flatnonzero(nodes.fixed), _left_out(smoothed, nodes)[nodes.fixed]
    # A shift beside the first or the last position is that position's own.
    inner = list(zip(pairwise(fixes), out[1:] | out[:-1], strict=True))[1:-1]
    ways = [pair for pair, odd in inner if odd]
    moved = (nodes.way_m[first:last].any() for first, last in ways)
    jumps = tuple((int(a), int(b)) for (a, b), rolls in zip(ways, moved, strict=True) if rolls)
    return replace(nodes, jumps=jumps[:MOST_JUMPS])


def left_out_of(smoothed: Smoothed, nodes: Nodes) -> FloatArray:
    """Positions that hardly count: time, x, y. (o, 3) [s, m, m]"""
    rows = _left_out(smoothed, nodes)
    return np.column_stack([nodes.time_s[rows], nodes.fix_m[rows]])


def say_left_out(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say positions and headings that hardly count."""
    known = np.isfinite(nodes.yaw_rad)
    odd = known & (smoothed.yaw_weight < HARDLY)
    if odd.any():
        many, first = odd.sum() > MOST_LEFT_OUT * known.sum(), float(nodes.time_s[int(np.argmax(odd))])
        what = f"{odd.sum()} of {known.sum()} headings fit no motion of the wheels"
        findings.add("odd heading", what, "they hardly count", count=int(odd.sum()), time_s=first, doubt=bool(many))
    left, fixes = np.flatnonzero(_left_out(smoothed, nodes)), np.flatnonzero(nodes.fixed)
    if not left.size:
        return
    what, done = f"{len(left)} of {len(fixes)} positions fit no motion of the wheels", "they hardly count"
    ends = [name for name, node in (("first", fixes[0]), ("last", fixes[-1])) if node in left]
    if ends:
        what += f", the {' and the '.join(ends)} one too"
        done += ": none beyond it tells whether it is wrong, or the rover went there and the motion is wrong"
    doubt = "last" in ends or len(left) > MOST_LEFT_OUT * len(fixes)
    findings.add("position jump", what, done, count=len(left), time_s=float(nodes.time_s[left[0]]), doubt=doubt)


def say_scatter(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say errors of positions that nobody can believe, and a scatter that they do not explain.

    What all positions are off by does not make them scatter: of errors that they share a small scatter is none.
    """
    fixed = nodes.fixed
    sigma = float(np.median(np.sqrt(np.trace(nodes.fix_covariance_m2[fixed], axis1=1, axis2=2) / 2.0)))
    scatter = float(np.nanmedian(smoothed.squared_distance)) / MEDIAN_OF_TWO
    if sigma < FINEST_M:
        what = f"positions claim errors of {1e3 * sigma:.2g} mm, which no localisation of a rover reaches"
        findings.add("errors too small", what, "kept; are they in another unit?", doubt=True)
    elif scatter < LEAST_SCATTER and nodes.chain is None and fixed.sum() > 5:
        what = f"positions scatter {scatter:.2g} times as much as their errors of {sigma:.3g} m say"
        findings.add("errors too large", what, "kept; are they in another unit?")
    if scatter > WORST_SCATTER:
        what = f"positions scatter about the motion with {math.sqrt(scatter):.1f} times the errors that they say"
        findings.add("positions scatter", what, "their errors are taken to be so much larger")


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


MOST_LAGS = 3
"""Times that a lag is put back and looked for again."""


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
    sent, schedule = _turned(in_units(ordered(telemetry, findings), rover, findings), rover, findings), None
    as_planned, longer_s, pace = False, 0.0, None
    if plan is not None:
        schedule = make_schedule(plan, rover)
        sent, as_planned, longer_s = by_the_plan(sent, rover, schedule, findings)
    twist, way = _way(rover, sent, schedule)
    telemetry = sent.telemetry
    turned = np.degrees(np.append(0.0, np.cumsum(twist[:, 2] * np.diff(telemetry.time_s))))
    telemetry = usable_headings(usable_positions(telemetry, way, findings), turned, findings)
    skids = not rover.steered_mask.any()
    meant = as_meant(telemetry, twist, findings, skids=skids, as_planned=as_planned)
    if meant is not telemetry:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LunarSciWarning)
            sent = _turned(meant, rover, Findings(meant.file))
    sent = sent._replace(telemetry=meant)
    if plan is not None and schedule is not None:
        check_ends(meant, schedule, longer_s, findings)
        pace = check_pace(sent.wheels.rim_m_s, sent.wheels.measured, meant, rover, plan, findings)
    found = _along_the_ground(sent, rover, terrain, schedule, lag_s, findings)
    return dataclasses.replace(found, pace=pace)


def _turned(telemetry: Telemetry, rover: Rover, findings: Findings) -> Rows:
    """How the wheels turned and were steered."""
    gaps = time_gaps(telemetry, findings)
    wheels = wheel_motion(telemetry, rover, gaps, findings)
    angle, known = steering_angles(telemetry, rover, findings)
    wheels, steering = dataclasses.replace(wheels, trusted=wheels.trusted & known[1:] & known[:-1]), np.radians(angle)
    middle, steps = 0.5 * (steering[1:] + steering[:-1]), np.diff(telemetry.time_s)
    return Rows(telemetry, of_one_motion(wheels, rover, middle, steps, findings), steering, gaps)


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
        rows=state_rows(rover, wheels, nodes, smoothed, motion, held, rows, gaps, findings),
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
