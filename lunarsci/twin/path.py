"""Geometry of the planned path and the commands that follow it."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lunarsci.twin.plan import Arc, Plan
from lunarsci.twin.rover import Rover

__all__ = ["Commands", "arc_end", "curvature_at", "planned_pose", "wheel_commands"]

FloatArray = npt.NDArray[np.float64]


def arc_end(
    x: FloatArray, y: FloatArray, heading: FloatArray, length: FloatArray, curvature: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pose after an arc of constant curvature, exact for any curvature including 0. [m, m, rad]

    The chord is length sinc(half the turn), along the heading at half the turn.
    """
    half = 0.5 * length * curvature
    chord = length * np.sinc(half / math.pi)
    return x + chord * np.cos(heading + half), y + chord * np.sin(heading + half), heading + 2.0 * half


def planned_pose(plan: Plan, distance_m: npt.ArrayLike) -> FloatArray:
    """Planned x, y, heading at distances along the path. (n, 3) [m, m, rad]

    The blends of the commanded curvature are not in it: they shift the path by curvature step x blend^2 / 24, half a
    millimetre for the embedded plan.
    """
    distance = np.asarray(distance_m, dtype=float)
    pose = np.array([plan.x_m, plan.y_m, math.radians(plan.heading_deg)])
    x, y, heading = (np.full(distance.shape, value) for value in pose)
    left = distance.copy()
    for number, arc in enumerate(plan.arcs):
        # The last arc goes on beyond its end, so that rounding never loses the end of the path.
        piece = left if number == len(plan.arcs) - 1 else np.minimum(left, arc.length_m)
        x, y, heading = arc_end(x, y, heading, piece, np.full(distance.shape, arc.curvature_per_m))
        left = left - piece
    return np.stack([x, y, heading], axis=-1)


def curvature_at(arcs: tuple[Arc, ...], distance_m: npt.ArrayLike, blend_m: float) -> FloatArray:
    """Commanded curvature: that of the arc, going over linearly within `blend_m` about each joint. [1/m]

    A blend is never longer than the shorter of its two arcs.
    """
    distance = np.asarray(distance_m, dtype=float)
    curvature = np.full(distance.shape, arcs[0].curvature_per_m)
    joint = 0.0
    for before, after in pairwise(arcs):
        joint += before.length_m
        width = max(min(blend_m, before.length_m, after.length_m), 1e-9)
        share = np.clip((distance - joint) / width + 0.5, 0.0, 1.0)
        curvature = curvature + share * (after.curvature_per_m - before.curvature_per_m)
    return curvature


@dataclass(frozen=True, slots=True)
class Commands:
    """Steering angle [rad] and ground speed of the rim r_s omega [m/s] of each wheel. (n, 6)"""

    steering_rad: FloatArray
    speed_m_s: FloatArray


def wheel_commands(rover: Rover, curvature_per_m: npt.ArrayLike, speed_m_s: float) -> Commands:
    """Ackermann steering about a turning centre beside the wheels that do not steer, for each curvature.

    The wheels turn as fast as their centres move when nothing slips: r_s omega is the speed over ground, so slip ratio
    0 is the commanded drive. An unsteered wheel rolls at the forward part of its speed. With a steering offset the
    steering axis points at the turning centre and the wheel runs outside or inside of it. The point that follows the
    path lies midway between those that do not steer, or below the origin where all do.
    """
    curvature = np.asarray(curvature_per_m, dtype=float)[:, None]
    position, side = rover.wheel_positions_m, np.tile([1.0, -1.0], len(rover.pairs))
    offset = np.where(rover.steered_mask, rover.steering_offset_m * side, 0.0)
    x = position[:, 0] - rover.turning_x_m
    forward = 1.0 - curvature * (position[:, 1] - offset)
    across = curvature * x
    steering = np.where(rover.steered_mask, np.arctan2(across, forward), 0.0)
    speed = np.where(rover.steered_mask, np.hypot(forward, across) - curvature * offset, forward)
    return Commands(steering, np.maximum(speed, 0.02) * speed_m_s)
