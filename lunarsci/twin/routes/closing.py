"""Arcs that end a path exactly where it shall end."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.plans.path import arc_end

__all__ = ["close_on_point", "close_on_pose"]

FloatArray = npt.NDArray[np.float64]
LARGEST_TURN = 0.75 * np.pi
"""No closing arc turns further than this. [rad]"""


def close_on_point(poses: FloatArray, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The one arc from each pose to a point: length and curvature, NaN where it would turn by more than 135 deg.

    Poses (n, 3) [m, m, rad], point (2,) or (n, 2) [m]; results (n, 1) [m, 1/m]. A chord of length d at the angle a from
    the heading belongs to the curvature 2 sin(a) / d and turns by 2 a.
    """
    difference = point_m - poses[:, :2]
    distance = np.hypot(*difference.T)
    angle = np.arctan2(difference[:, 1], difference[:, 0]) - poses[:, 2]
    angle = (angle + np.pi) % (2.0 * np.pi) - np.pi
    near = (np.abs(2.0 * angle) <= LARGEST_TURN) & (distance > 0)
    length = distance / np.where(near, np.sinc(angle / np.pi), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(near, 2.0 * np.sin(angle) / distance, np.nan)
    return length[:, None], curvature[:, None]


def close_on_pose(poses: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two arcs from each pose to another pose (3,), with one tangent at their joint: lengths and curvatures. (n, 2)

    Of the family of such biarcs the one whose joint lies as far from both ends along their tangents: with the tangents
    t1, t2 and the chord v this distance d solves 2 (1 - t1 t2) d^2 + 2 v (t1 + t2) d - v^2 = 0 (Bolton 1975,
    Computer-Aided Design 7, 293, 10.1016/0010-4485(75)90086-X). NaN where an arc would turn by more than 135 deg.
    """
    first = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    last = np.array([np.cos(goal[2]), np.sin(goal[2])])
    chord = goal[:2] - poses[:, :2]
    half_a, b, square = 1.0 - first @ last, (chord * (first + last)).sum(axis=1), (chord**2).sum(axis=1)
    # This form of the root has no difference of nearly equal terms when the tangents are parallel.
    root = np.sqrt(b**2 + 2.0 * half_a * square)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = np.where(b > 0, square / (b + root), (root - b) / (2.0 * half_a))[:, None]
    joint = 0.5 * (poses[:, :2] + goal[:2] + tangent * (first - last))
    length_1, curvature_1 = close_on_point(poses, joint)
    x, y, heading = arc_end(poses[:, 0], poses[:, 1], poses[:, 2], length_1[:, 0], curvature_1[:, 0])
    length_2, curvature_2 = close_on_point(np.column_stack([x, y, heading]), goal[:2])
    return np.hstack([length_1, length_2]), np.hstack([curvature_1, curvature_2])
