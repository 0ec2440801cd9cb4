"""What the wheels are told: steering angles and rim speeds that make the rover move as a rigid body."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.rover import Rover

__all__ = ["CREEP", "CREEP_M_S", "Commands", "plain", "reach_m", "wheel_commands"]

FloatArray = npt.NDArray[np.float64]


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
