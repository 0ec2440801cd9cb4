"""The path of a plan, and how wheels steer and turn for it."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover


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


TURN_DEG = 2.0
"""Between the poses of a spot turn that are looked at."""


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
    pose, found = _start(plan), []
    for leg in plan.legs:
        pieces = max(1, math.ceil(max(leg.length_m / every_m, abs(leg.turn_deg) / TURN_DEG)))
        found.append(leg_end(pose, leg, np.linspace(0.0, 1.0, pieces + 1)))
        pose = found[-1][-1]
    return np.concatenate(found)


def turn_poses(plan: Plan) -> list[tuple[FloatArray, float, float]]:
    """Pose before each spot turn [m, m, rad], its angle [rad], and the way before it [m]."""
    pose, way, found = _start(plan), 0.0, []
    for leg in plan.legs:
        if leg.turn_deg:
            found.append((pose, math.radians(leg.turn_deg), way))
        pose, way = leg_end(pose, leg), way + leg.length_m
    return found


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


SLOWEST_RIM = 0.02
"""Share of the rover's speed below which no rim falls while it drives: at zero the slip ratio has no meaning.
Assumed."""
CREEP = 2e-2
"""Share of the plan's speed from which a start speeds up, and to which a stop slows down; assumed."""
CREEP_M_S = 5e-5
"""Rim speed that stands for none where a slip ratio is wanted all the same. [m/s]"""
STILL_M_S = 1e-9
"""A rim slower than this stands still. [m/s]"""


@dataclass(frozen=True, slots=True)
class Commands:
    """Steering angle [rad] and ground speed of the rim r_s omega, negative backwards [m/s], of each wheel. (..., n)"""

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
    rim = np.copysign(np.maximum(np.abs(rim), SLOWEST_RIM), np.where(rim == 0, sign, rim))
    return Commands(np.broadcast_to(steering, rim.shape), rim * np.asarray(speed_m_s, dtype=float)[..., None])


def plain(commands: Commands) -> Commands:
    """The commands as plain arrays, with rims that stand still at a zero that keeps the sign of their last motion.

    For each other layout of its arguments numba would compile the drive anew, in 10 s.
    """
    speed = np.array(commands.speed_m_s, order="C")
    still = np.abs(speed) < STILL_M_S
    return Commands(np.array(commands.steering_rad, order="C"), np.where(still, np.copysign(0.0, speed), speed))
