"""Geometry of a planned drive: where its legs lead."""

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lunarsci.twin.plans.plan import Leg, Plan

__all__ = ["along_legs", "arc_end", "curvature_at", "leg_end", "planned_pose"]

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
    """Pose at distances along legs that have a length, from x, y, heading at their start. (..., 3) [m, m, rad]"""
    left = np.asarray(distance_m, dtype=float)
    pose = np.broadcast_to(start, (*left.shape, 3))
    for number, leg in enumerate(legs):
        # The last arc goes on beyond its end, so that rounding never loses the end of the path.
        piece = left if number == len(legs) - 1 else np.minimum(left, leg.length_m)
        pose, left = leg_end(pose, leg, piece / leg.length_m), left - piece
    return np.asarray(pose)


def planned_pose(plan: Plan, distance_m: npt.ArrayLike) -> FloatArray:
    """Planned x, y, heading at distances along a plan of arcs. (..., 3) [m, m, rad]

    The blends of the commanded curvature are not in it: they shift the path by curvature step x blend^2 / 24, half a
    millimetre for the embedded plan. `Schedule.pose_at` has turns and stops too.
    """
    start = np.array([plan.x_m, plan.y_m, math.radians(plan.heading_deg)])
    return along_legs(start, plan.legs, distance_m)


def curvature_at(legs: tuple[Leg, ...], distance_m: npt.ArrayLike, blend_m: float) -> FloatArray:
    """Commanded curvature: that of the arc, going over linearly within `blend_m` about each joint. [1/m]

    A blend is never longer than the shorter of its two arcs.
    """
    distance = np.asarray(distance_m, dtype=float)
    curvature = np.full(distance.shape, legs[0].curvature_per_m)
    joint = 0.0
    for before, after in pairwise(legs):
        joint += before.length_m
        width = max(min(blend_m, before.length_m, after.length_m), 1e-9)
        share = np.clip((distance - joint) / width + 0.5, 0.0, 1.0)
        curvature = curvature + share * (after.curvature_per_m - before.curvature_per_m)
    return curvature
