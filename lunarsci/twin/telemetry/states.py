"""From telemetry to the states of the wheels: slip, side slip and sinkage, each with its error, and tables of them."""

import dataclasses
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
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
    motion_at,
    nodes_of,
    on_ground,
    put_back,
    turn_effect,
    within,
)
from lunarsci.twin.telemetry.nuisances import LATE_S, Priors
from lunarsci.twin.telemetry.odometry import body_twist, mean_speed, of_one_motion
from lunarsci.twin.telemetry.plan_checks import by_the_plan, check_ends
from lunarsci.twin.telemetry.positions import check_attitude, sway_m, usable_headings, usable_positions
from lunarsci.twin.telemetry.reading import Findings, Positions, Telemetry
from lunarsci.twin.telemetry.readings import as_meant
from lunarsci.twin.telemetry.slip_process import SlipProcess
from lunarsci.twin.telemetry.smoother import Smoothed, smooth
from lunarsci.twin.telemetry.state_rows import StateRows, state_rows
from lunarsci.twin.telemetry.wheel_motion import WheelMotion, wheel_motion
from lunarsci.twin.telemetry.wheel_readings import in_units

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
