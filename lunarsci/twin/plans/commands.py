"""What the wheels are told: steering angles and rim speeds that make the rover move as a rigid body.

Position fixes: where the rover believes to be at a halt, and the leg that takes it from there to its planned end.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.plans.path import leg_end
from lunarsci.twin.plans.schedule import Schedule
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.lanes import LANES, POSE

__all__ = ["CREEP", "CREEP_M_S", "Commands", "fix_errors", "legs_from", "plain", "reach_m", "wheel_commands"]

FloatArray = npt.NDArray[np.float64]


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
    errors : of the fixes. (LANES, 3) [m, m, rad]

    Returns
    -------
    Length [m], curvature [1/m] and turn [rad]. (LANES, 3)
    """
    leg = schedule.runs[number].legs[0]
    goal = leg_end(schedule.poses[number], leg)
    x, y, heading = (_poses(work) + errors).T
    if leg.length_m == 0:
        planned = math.radians(leg.turn_deg)
        off = np.remainder(goal[2] - heading - planned + math.pi, 2 * math.pi) - math.pi
        return np.stack([np.zeros(LANES), np.zeros(LANES), planned + off], axis=-1)
    travel = heading + math.radians(leg.crab_deg)
    ahead = np.cos(travel) * (goal[0] - x) + np.sin(travel) * (goal[1] - y)
    aside = np.cos(travel) * (goal[1] - y) - np.sin(travel) * (goal[0] - x)
    # The leg has its planned time: what lies further than twice its length, or behind, is left to the next one.
    chord = np.where(ahead > 0.0, np.hypot(ahead, aside), 0.0)
    half = np.where(ahead > 0.0, np.arctan2(aside, ahead), 0.0)
    tightest = rover.tightest_curvature_per_m
    curvature = np.clip(2.0 * np.sin(half) / np.maximum(chord, 1e-9), -tightest, tightest)
    length = np.minimum(chord / np.sinc(half / math.pi), 2.0 * leg.length_m)
    return np.stack([length, curvature, np.zeros(LANES)], axis=-1)


def _poses(work: Any) -> FloatArray:
    """True x, y, heading. (LANES, 3) [m, m, rad]"""
    rows = work.body.reshape(-1, LANES)[POSE : POSE + 7]
    x, y, _, w, i, j, k = rows
    return np.stack([x, y, np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))], axis=-1)


SLOWEST_RIM = 0.02
"""Share of the rover's speed below which no rim falls while it drives: at zero the slip ratio has no meaning."""
CREEP = 2e-2
"""Share of the plan's speed from which a start speeds up, and to which a stop slows down."""
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
