"""A plan in space and time: its path, commands of the wheels, when it does what, and legs after position fixes."""

import dataclasses
import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.twin.lanes import BODY, GROUP
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover

TURN_DEG = 2.0
"""Between the poses of a spot turn that are looked at."""
CREEP = 2e-2
"""Share of the plan's speed from which a start speeds up, to which a stop slows down, and below which no rim falls
while the rover drives, as the slip ratio has no meaning at zero; assumed."""
UNDER_WAY = 0.95
"""Share of the full speed below which it is a halt, where slip, compared with the speed, does not count; assumed."""
CREEP_M_S = 5e-5
"""Rim speed that stands for none where a slip ratio is wanted all the same. [m/s]"""
STILL_M_S = 1e-9
"""A rim slower than this stands still. [m/s]"""
EASE_S = 0.6
"""Time constant of starting and stopping, assumed: long against the 12-18 ms in which shear follows a wheel."""
RAMP_S = EASE_S * math.log(1.0 / CREEP)
"""From a creep to full speed, exponentially."""
RAMP_COUNTS_S = EASE_S * (1.0 - CREEP)
"""What a ramp counts for in time at full speed."""
STEERING_RAD_S = math.radians(10.0)
"""Assumed rate of the steering motors; the wheels steer at a standstill between legs that need it."""


def arc_end(
    x: FloatArray, y: FloatArray, heading: FloatArray, length: FloatArray, curvature: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pose after an arc of constant curvature, exact for any curvature including 0. [m, m, rad]

    The chord is length sinc(half the turn), along the heading at half the turn.
    """
    half = 0.5 * length * curvature
    chord = length * np.sinc(half / math.pi)
    return x + chord * np.cos(heading + half), y + chord * np.sin(heading + half), heading + 2.0 * half


def leg_end(pose: FloatArray, leg: Leg, share: npt.ArrayLike = 1.0) -> FloatArray:
    """Pose after a share of a leg, 0 to 1, from x, y, heading. (..., 3) [m, m, rad]"""
    part = np.asarray(share, dtype=float)
    x, y, heading = (np.broadcast_to(pose[..., k], part.shape) for k in range(3))
    if leg.length_m == 0:
        return np.stack([x, y, heading + math.radians(leg.turn_deg) * part], axis=-1)
    crab = math.radians(leg.crab_deg)
    x, y, travel = arc_end(x, y, heading + crab, leg.length_m * part, np.asarray(leg.curvature_per_m))
    return np.stack([x, y, travel - crab], axis=-1)


def along_legs(start: FloatArray, legs: tuple[Leg, ...], distance_m: npt.ArrayLike) -> FloatArray:
    """Pose at distances along legs, from x, y, heading at their start. (..., 3) [m, m, rad]

    Spot turns and stops have no length: where one begins it is done.
    """
    left = np.asarray(distance_m, dtype=float)
    pose = np.broadcast_to(start, (*left.shape, 3))
    for number, leg in enumerate(legs):
        # The last arc goes on beyond its end, so that rounding never loses the end of the path.
        piece = left if number == len(legs) - 1 else np.minimum(left, leg.length_m)
        pose, left = leg_end(pose, leg, piece / leg.length_m if leg.length_m else np.ones(left.shape)), left - piece
    return np.asarray(pose)


def planned_pose(plan: Plan, distance_m: npt.ArrayLike) -> FloatArray:
    """Planned x, y, heading at distances along a plan, spot turns done where they begin. (..., 3) [m, m, rad]

    The blends of the commanded curvature are not in it: they shift the path by curvature step x blend^2 / 24, half a
    millimetre for the embedded plan. `Schedule.pose_at` has turns and stops in time.
    """
    return along_legs(_start(plan), plan.legs, distance_m)


def poses_along(plan: Plan, every_m: float) -> FloatArray:
    """Planned x, y, heading so far apart, and every 2 deg of a spot turn. (n, 3) [m, m, rad]"""
    if not any(leg.turn_deg for leg in plan.legs):
        return planned_pose(plan, np.linspace(0.0, plan.length_m, max(2, math.ceil(plan.length_m / every_m) + 1)))
    pose, poses = _start(plan), []
    for leg in plan.legs:
        pieces = max(1, math.ceil(max(leg.length_m / every_m, abs(leg.turn_deg) / TURN_DEG)))
        poses.append(leg_end(pose, leg, np.linspace(0.0, 1.0, pieces + 1)))
        pose = poses[-1][-1]
    return np.concatenate(poses)


def turn_poses(plan: Plan) -> list[tuple[FloatArray, float, float]]:
    """Pose before each spot turn [m, m, rad], its angle [rad], and the way before it [m]."""
    pose, way, turns = _start(plan), 0.0, []
    for leg in plan.legs:
        if leg.turn_deg:
            turns.append((pose, math.radians(leg.turn_deg), way))
        pose, way = leg_end(pose, leg), way + leg.length_m
    return turns


def _start(plan: Plan) -> FloatArray:
    return np.array([plan.x_m, plan.y_m, math.radians(plan.heading_deg)])


def curvature_at(legs: tuple[Leg, ...], distance_m: npt.ArrayLike, blend_m: float) -> FloatArray:
    """Commanded curvature: that of the arc, blended about each joint. [1/m]"""
    return _blended(legs, [leg.curvature_per_m for leg in legs], distance_m, blend_m)


def rate_ratios(rover: Rover, legs: tuple[Leg, ...], distance_m: npt.ArrayLike, blend_m: float) -> FloatArray | None:
    """Rates of the wheels over those without slip, blended about each joint; None without wheel tests. (..., n) [-]"""
    if all(leg.wheel_test is None for leg in legs):
        return None
    tests = [leg.wheel_test for leg in legs]
    return np.stack(
        [
            _blended(legs, [test.rate_ratio if test and test.wheel == wheel else 1.0 for test in tests],
                     distance_m, blend_m)
            for wheel in rover.wheels
        ],
        axis=-1,
    )  # fmt: skip


def _blended(legs: tuple[Leg, ...], values: list[float], distance_m: npt.ArrayLike, blend_m: float) -> FloatArray:
    """A value of each arc along them, going over linearly within `blend_m` about each joint.

    A blend is never longer than the shorter of its two arcs.
    """
    distance = np.asarray(distance_m, dtype=float)
    result = np.full(distance.shape, values[0])
    joint = 0.0
    for (before, after), (old, new) in zip(pairwise(legs), pairwise(values), strict=True):
        joint += before.length_m
        width = max(min(blend_m, before.length_m, after.length_m), 1e-9)
        share = np.clip((distance - joint) / width + 0.5, 0.0, 1.0)
        result = result + share * (new - old)
    return result


@dataclass(frozen=True, slots=True)
class Commands:
    """What every wheel is to do.

    Attributes
    ----------
    steering_rad : steering angle, positive to the left. (..., wheels) [rad]
    speed_m_s : ground speed of the rim r_s omega, negative backwards. (..., wheels) [m/s]
    """

    steering_rad: FloatArray
    speed_m_s: FloatArray


def reach_m(rover: Rover) -> float:
    """Distance of the farthest wheel from the turning centre of a spot turn. [m]"""
    position = rover.wheel_positions_m
    return float(np.hypot(position[:, 0] - rover.turning_x_m, position[:, 1]).max())


def wheel_commands(
    rover: Rover,
    forward: npt.ArrayLike,
    left: npt.ArrayLike,
    turn_per_m: npt.ArrayLike,
    speed_m_s: npt.ArrayLike,
) -> Commands:
    """Steering and speeds with which no wheel slips, on the level.

    The wheels turn as fast as their centres move when nothing slips: r_s omega is the speed over ground, so slip ratio
    0 is the commanded drive. A steered wheel points along its velocity, or against it and turns backwards, whichever
    needs less than a quarter turn. An unsteered wheel rolls at the forward part of its speed. With a steering offset
    the wheel runs outside or inside of its steering axis. That it also rolls while it is being steered is left out here
    and in the ground contact: it is taken to keep pace with its steering.

    Parameters
    ----------
    forward, left, turn_per_m : motion of the path point, for each unit of speed: two components of the velocity [-],
        rate of turn [rad/m]. The path point lies midway between the wheels that do not steer, or below the origin
        where all do. Shapes that broadcast together.
    speed_m_s : the speed, >= 0. [m/s]
    """
    ahead, across, turn = (np.asarray(value, dtype=float)[..., None] for value in (forward, left, turn_per_m))
    position, side = rover.wheel_positions_m, np.tile([1.0, -1.0], len(rover.pairs))
    offset = np.where(rover.steered_mask, rover.steering_offset_m * side, 0.0)
    along = ahead - turn * (position[:, 1] - offset)
    aside = np.where(rover.steered_mask, across + turn * (position[:, 0] - rover.turning_x_m), 0.0)
    length = np.hypot(along, aside)
    sign = np.where(along < -1e-9 * length, -1.0, 1.0)
    steering = np.where(length > 0, np.arctan2(sign * aside, sign * along), 0.0)
    rim = sign * length - turn * offset
    rim = np.copysign(np.maximum(np.abs(rim), CREEP), np.where(rim == 0, sign, rim))
    return Commands(np.broadcast_to(steering, rim.shape), rim * np.asarray(speed_m_s, dtype=float)[..., None])


def plain(commands: Commands) -> Commands:
    """The commands as plain arrays, with rims that stand still at a zero that keeps the sign of their last motion.

    For each other layout of its arguments numba would compile the drive anew, in 10 s.
    """
    speed = np.array(commands.speed_m_s, order="C")
    still = np.abs(speed) < STILL_M_S
    return Commands(np.array(commands.steering_rad, order="C"), np.where(still, np.copysign(0.0, speed), speed))


@dataclass(frozen=True, slots=True)
class Run:
    """Legs that follow each other without a halt.

    Attributes
    ----------
    legs : blended arcs of one direction of travel, or a single turn or stop.
    begin_s : when it begins, with steering. [s]
    steer_s : time to steer before it moves. [s]
    cruise_s : time at full speed, without ramps. [s]
    starts, stops : whether it speeds up from a halt, and slows down to one.
    """

    legs: tuple[Leg, ...]
    begin_s: float
    steer_s: float
    cruise_s: float
    starts: bool
    stops: bool

    @property
    def length_m(self) -> float:
        """Length of its path. [m]"""
        return math.fsum(leg.length_m for leg in self.legs)

    @property
    def commanded_m(self) -> float:
        """How far its rims are commanded to roll. [m]"""
        return math.fsum(leg.commanded_m for leg in self.legs)

    def way_at(self, share: FloatArray) -> FloatArray:
        """Way along its path at shares of what its rims are commanded to roll. [m]"""
        if all(leg.slip_ratio == 0.0 for leg in self.legs):
            return share * self.length_m
        rolled = np.cumsum([0.0, *(leg.commanded_m for leg in self.legs)])
        way = np.cumsum([0.0, *(leg.length_m for leg in self.legs)])
        return np.asarray(np.interp(share * rolled[-1], rolled, way))

    @property
    def end_s(self) -> float:
        """When it ends. [s]"""
        return self.begin_s + self.steer_s + self.cruise_s + RAMP_S * (self.starts + self.stops)

    @property
    def moves(self) -> bool:
        """False for a stop."""
        return self.legs[0].stop_s == 0

    def share_at(self, time_s: npt.ArrayLike) -> FloatArray:
        """Share of its motion that is done, 0 before and 1 after it; 0 throughout for a stop."""
        t = np.asarray(time_s, dtype=float) - self.begin_s - self.steer_s
        if not self.moves:
            return np.zeros_like(t)
        done, whole = np.zeros_like(t), self.cruise_s
        if self.starts:
            done += EASE_S * (np.exp(np.clip(t - RAMP_S, -RAMP_S, 0.0) / EASE_S) - CREEP)
            t, whole = t - RAMP_S, whole + RAMP_COUNTS_S
        done += np.clip(t, 0.0, self.cruise_s)
        if self.stops:
            done += EASE_S * (1.0 - np.exp(-np.clip(t - self.cruise_s, 0.0, RAMP_S) / EASE_S))
            whole += RAMP_COUNTS_S
        return done / whole

    def pace_at(self, time_s: npt.ArrayLike) -> FloatArray:
        """Share of the full speed: 1 under way, less when starting and stopping, 0 before, after and in a stop."""
        t = np.asarray(time_s, dtype=float) - self.begin_s - self.steer_s
        length = self.end_s - self.begin_s - self.steer_s
        pace = np.where((t >= 0.0) & (t <= length) & self.moves, 1.0, 0.0)
        if self.starts:
            pace *= np.exp(np.clip(t - RAMP_S, -RAMP_S, 0.0) / EASE_S)
        if self.stops:
            pace *= np.exp(-np.clip(t - length + RAMP_S, 0.0, RAMP_S) / EASE_S)
        return np.asarray(pace)


@dataclass(frozen=True, slots=True)
class Schedule:
    """A plan in time, for one rover.

    Attributes
    ----------
    plan : what is driven.
    runs : in order.
    poses : nominal x, y, heading at the start of each run. [m, m, rad]
    """

    plan: Plan
    runs: tuple[Run, ...]
    poses: tuple[FloatArray, ...] = field(repr=False)

    @property
    def duration_s(self) -> float:
        """From the first motion to the last. [s]"""
        return self.runs[-1].end_s

    def distance_at(self, time_s: npt.ArrayLike) -> FloatArray:
        """Way along the plan; it stands still while the rover turns on the spot or stops. [m]"""
        return np.asarray(sum(run.way_at(run.share_at(time_s)) for run in self.runs))

    def pace_at(self, time_s: npt.ArrayLike) -> FloatArray:
        """Share of the full speed: 1 under way, 0 at a standstill."""
        time, pace = np.asarray(time_s, dtype=float), np.zeros(np.shape(time_s))
        number = np.searchsorted([run.begin_s for run in self.runs], time, side="right") - 1
        for k in np.unique(number[number >= 0]):
            on = number == k
            pace[on] = self.runs[k].pace_at(time[on])
        return pace

    def pose_at(self, time_s: npt.ArrayLike) -> FloatArray:
        """Planned x, y, heading. (..., 3) [m, m, rad]

        Without the blends of the commanded curvature, as `planned_pose`.
        """
        time = np.asarray(time_s, dtype=float)
        result = np.broadcast_to(self.poses[0], (*time.shape, 3)).copy()
        for run, start in zip(self.runs, self.poses, strict=True):
            on = time >= run.begin_s
            result[on] = _along(run, start, run.share_at(time[on]))
        return result


def make_schedule(plan: Plan, rover: Rover) -> Schedule:
    """Lay out the legs of a plan in time.

    Arcs of one direction of travel are blended, without a halt, unless the plan has fixes. Around every other joint
    the rover slows down, steers at a standstill, and speeds up; at the start and at the end of the plan it is under
    way.
    """
    groups = _without_halts(plan)
    runs: list[Run] = []
    poses = [np.array([plan.x_m, plan.y_m, math.radians(plan.heading_deg)])]
    steering = np.zeros(len(rover.wheels))
    for number, legs in enumerate(groups):
        first, last = number == 0, number == len(groups) - 1
        begin = runs[-1].end_s + (0.0 if plan.fixes is None else plan.fixes.halt_s) if runs else 0.0
        bare = Run(legs, begin, 0.0, 0.0, not first and legs[0].stop_s == 0, not last and legs[0].stop_s == 0)
        wanted = _steering(rover, legs[0]) if bare.moves else steering
        turned = 0.0 if first else float(np.abs(wanted - steering).max())
        cruise = max(_nominal_s(bare, plan, rover) - RAMP_COUNTS_S * (bare.starts + bare.stops), 0.0)
        runs.append(dataclasses.replace(bare, steer_s=turned / STEERING_RAD_S, cruise_s=cruise))
        steering = _steering(rover, legs[-1]) if bare.moves else steering
        poses.append(_along(bare, poses[-1], np.ones(1))[0])
    return Schedule(plan, tuple(runs), tuple(poses[:-1]))


def run_commands(
    rover: Rover, schedule: Schedule, number: int, times_s: FloatArray, before: Commands | None, legs: FloatArray | None
) -> Commands:
    """Commands of one run over successive steps, for each of several rovers.

    Parameters
    ----------
    number : which run.
    times_s : begin of the first step and end of each, all within the run. (steps + 1,) [s]
    before : the commands at the end of the run before, of each rover; None at the start of the drive.
    legs : length [m], curvature [1/m] and turn [rad] of the run's single leg for each rover; None as planned. (n, 3)

    The speed is the mean over a step, so that the distance driven is exact; the curvature is that of the step's end: a
    velocity that a step arrives at is that of its end, which leaves a tenth of the error in the step.
    """
    run = schedule.runs[number]
    if not run.moves:
        return _standing(rover, before, len(times_s) - 1)
    share = run.share_at(times_s)
    rates = np.diff(share) / np.diff(times_s)
    commands = plain(_motion(rover, schedule.plan, run, share[1:], rates, legs))
    if before is None or run.steer_s == 0:
        return commands
    turned = np.clip((times_s[1:] - run.begin_s) / run.steer_s, 0.0, 1.0)[:, None]
    old = before.steering_rad[:, -1:]
    return Commands(old + turned * (commands.steering_rad - old), commands.speed_m_s)


def all_commands(rover: Rover, schedule: Schedule, times_s: FloatArray, legs: FloatArray | None = None) -> Commands:
    """Commands of the whole drive over successive steps; arguments as in `run_commands`. (rovers, steps, n)

    As planned, the same for all, or with `legs` (rovers, runs, 3) as each rover steered after its position fixes; the
    first run is always as planned.
    """
    runs: list[Commands] = []
    for number, piece in enumerate(steps_of_runs(schedule, times_s)):
        times = times_s[piece.start : piece.stop + 1]
        steered = None if legs is None or number == 0 else legs[:, number]
        runs.append(run_commands(rover, schedule, number, times, runs[-1] if runs else None, steered))
    rows = max(len(run.speed_m_s) for run in runs)
    steering, speed = (
        np.concatenate([np.broadcast_to(part, (rows, *part.shape[1:])) for part in parts], axis=1)
        for parts in ([run.steering_rad for run in runs], [run.speed_m_s for run in runs])
    )
    return Commands(steering, speed)


def commands_at(rover: Rover, schedule: Schedule, time_s: FloatArray, legs: FloatArray | None = None) -> Commands:
    """Commands at some times, those of the step of 0.1 s or less that begins there. (n, wheels)

    As planned, or with `legs` (1, runs, 3) as one rover steered after its position fixes.
    """
    steps = max(1, math.ceil(schedule.duration_s / 0.1))
    times = np.linspace(0.0, schedule.duration_s, steps + 1)
    commands = all_commands(rover, schedule, times, legs)
    number = np.clip(np.searchsorted(times, time_s, side="right") - 1, 0, steps - 1)
    return Commands(commands.steering_rad[0, number], commands.speed_m_s[0, number])


def commanded_ratios(rover: Rover, schedule: Schedule, time_s: FloatArray) -> FloatArray:
    """Rates of the wheels over those without slip at some times: other than 1 in wheel tests. (n, wheels) [-]"""
    result = np.ones((len(time_s), len(rover.wheels)))
    for run in schedule.runs:
        ratios = rate_ratios(rover, run.legs, run.way_at(run.share_at(time_s)), schedule.plan.blend_m)
        if ratios is not None:
            on = (time_s >= run.begin_s) & (time_s <= run.end_s)
            result[on] = ratios[on]
    return result


def steps_of_runs(schedule: Schedule, times_s: FloatArray) -> list[slice]:
    """The steps of each run: a step belongs to the run in which its middle lies."""
    middles = 0.5 * (times_s[1:] + times_s[:-1])
    ends = np.searchsorted(middles, [run.end_s for run in schedule.runs])
    ends[-1] = len(middles)
    return [slice(int(a), int(b)) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def start_motion(schedule: Schedule, rover: Rover) -> tuple[float, float, float]:
    """Velocity of the rover's origin ahead and to the left [m/s], and rate of turn [rad/s], as the drive begins."""
    leg, speed = schedule.runs[0].legs[0], schedule.plan.speed_m_s
    if leg.stop_s:
        return 0.0, 0.0, 0.0
    ahead, left, turn = (float(speed * part) for part in _unit_motion(rover, leg))
    return ahead, left - turn * rover.turning_x_m, turn


def _unit_motion(rover: Rover, leg: Leg) -> FloatArray:
    """Ahead [-], left [-] and turn [rad/m] for each unit of speed; on the spot the farthest wheel has that speed."""
    if leg.turn_deg:
        return np.array([0.0, 0.0, math.copysign(1.0 / reach_m(rover), leg.turn_deg)])
    crab = math.radians(leg.crab_deg)
    return np.array([math.cos(crab), math.sin(crab), leg.curvature_per_m])


def _motion(
    rover: Rover, plan: Plan, run: Run, share: FloatArray, rates: FloatArray, legs: FloatArray | None
) -> Commands:
    """Commands at shares of the motion done, with rates of the share [1/s], one row for each rover."""
    leg = run.legs[0]
    ahead, left, turn = _unit_motion(rover, leg)
    if leg.turn_deg:
        angle = np.array([[math.radians(leg.turn_deg)]]) if legs is None else legs[:, 2:]
        turns = np.broadcast_to(abs(turn) * np.sign(angle), (len(angle), len(share)))
        return wheel_commands(rover, ahead, left, turns, np.abs(angle / turn) * rates)
    if legs is None:
        curvature = curvature_at(run.legs, run.way_at(share), plan.blend_m)[None, :]
        commands = wheel_commands(rover, ahead, left, curvature, run.commanded_m * rates[None, :])
    else:
        curvature = np.broadcast_to(legs[:, 1:2], (len(legs), len(share)))
        commands = wheel_commands(rover, ahead, left, curvature, legs[:, :1] / (1.0 - leg.slip_ratio) * rates)
    ratios = rate_ratios(rover, run.legs, run.way_at(share), plan.blend_m)
    return commands if ratios is None else Commands(commands.steering_rad, ratios * commands.speed_m_s)


def _standing(rover: Rover, before: Commands | None, steps: int) -> Commands:
    """A stop: steering as it was, straight at the start of a drive, rims at rest."""
    if before is None:
        still = np.zeros((1, steps, len(rover.wheels)))
        return plain(Commands(still, still))
    steering, speed = (np.repeat(part[:, -1:], steps, axis=1) for part in (before.steering_rad, before.speed_m_s))
    return plain(Commands(steering, 0.0 * speed))


def _steering(rover: Rover, leg: Leg) -> FloatArray:
    ahead, left, turn = _unit_motion(rover, leg)
    return wheel_commands(rover, ahead, left, turn, 1.0).steering_rad


def _nominal_s(run: Run, plan: Plan, rover: Rover) -> float:
    leg = run.legs[0]
    if leg.stop_s:
        return leg.stop_s
    return (abs(math.radians(leg.turn_deg)) * reach_m(rover) + run.commanded_m) / plan.speed_m_s


def _without_halts(plan: Plan) -> list[tuple[Leg, ...]]:
    """The legs in groups that are driven without a halt."""
    if plan.fixes is not None:
        return [(leg,) for leg in plan.legs]
    groups: list[tuple[Leg, ...]] = []
    for leg in plan.legs:
        if groups and leg.length_m and groups[-1][0].length_m and leg.crab_deg == groups[-1][0].crab_deg:
            groups[-1] = (*groups[-1], leg)
        else:
            groups.append((leg,))
    return groups


def _along(run: Run, start: FloatArray, share: FloatArray) -> FloatArray:
    """Pose after a share of a run."""
    if run.length_m == 0:
        return leg_end(start, run.legs[0], share if run.moves else 0.0 * share)
    return along_legs(start, run.legs, run.way_at(share))


def fix_errors(schedule: Schedule, members: int, seed: int) -> FloatArray:
    """Errors in x, y and heading of the fix before each run, zeros without fixes. (members, runs, 3) [m, m, rad]"""
    fixes = schedule.plan.fixes
    shape = (members, len(schedule.runs), 3)
    if fixes is None:
        return np.zeros(shape)
    sigma = (fixes.position_sigma_m, fixes.position_sigma_m, math.radians(fixes.heading_sigma_deg))
    return np.random.default_rng([seed, 1]).normal(size=shape) * sigma


def legs_from(schedule: Schedule, rover: Rover, number: int, work: Any, errors: FloatArray) -> FloatArray:
    """The leg of a run as each rover steers it, from its estimated pose to the planned end.

    An arc is the one that leaves in the leg's direction of travel and meets the planned end point, no tighter than the
    rover can drive and at most twice as long as planned; a goal already passed is not driven back to. A spot turn ends
    at the planned heading. Either takes the time of the planned leg, so the speed differs as the length does: the
    errors of the fixes should be small against the legs.

    Parameters
    ----------
    work : the scratch arrays with the true poses.
    errors : of the fixes. (GROUP, 3) [m, m, rad]

    Returns
    -------
    Length [m], curvature [1/m] and turn [rad]. (GROUP, 3)
    """
    leg = schedule.runs[number].legs[0]
    goal = leg_end(schedule.poses[number], leg)
    x, y, heading = (_poses(work) + errors).T
    if leg.length_m == 0:
        planned = math.radians(leg.turn_deg)
        off = np.remainder(goal[2] - heading - planned + math.pi, 2 * math.pi) - math.pi
        return np.stack([np.zeros(GROUP), np.zeros(GROUP), planned + off], axis=-1)
    travel = heading + math.radians(leg.crab_deg)
    ahead = np.cos(travel) * (goal[0] - x) + np.sin(travel) * (goal[1] - y)
    aside = np.cos(travel) * (goal[1] - y) - np.sin(travel) * (goal[0] - x)
    # The leg has its planned time: what lies further than twice its length, or behind, is left to the next one.
    chord = np.where(ahead > 0.0, np.hypot(ahead, aside), 0.0)
    half = np.where(ahead > 0.0, np.arctan2(aside, ahead), 0.0)
    tightest = rover.tightest_curvature_per_m
    curvature = np.clip(2.0 * np.sin(half) / np.maximum(chord, 1e-9), -tightest, tightest)
    length = np.minimum(chord / np.sinc(half / math.pi), 2.0 * leg.length_m)
    return np.stack([length, curvature, np.zeros(GROUP)], axis=-1)


def _poses(work: Any) -> FloatArray:
    """True x, y, heading. (GROUP, 3) [m, m, rad]"""
    (x, y, _), (w, i, j, k) = (BODY.view(work.body, name) for name in ("position", "quaternion"))
    return np.stack([x, y, np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))], axis=-1)
