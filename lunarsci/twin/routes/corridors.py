"""Which courses are different ways: by the side on which each obstacle is passed, or by the ground that they sweep."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.twin.plans.path import arc_end
from lunarsci.twin.routes.arc_search import ArcProblem

PLACES = 48
"""At which courses are compared, and turns about obstacles counted."""
LOOKED_AT = 3000
"""Courses of a number of arcs that are compared, the cheapest ones."""


def course_places(start: FloatArray, arcs: FloatArray) -> FloatArray:
    """x, y at equal shares of the length of courses (n, k, 2) from one pose. (n, PLACES, 2) [m]"""
    count, number = arcs.shape[:2]
    distance = np.linspace(0.0, 1.0, PLACES) * arcs[..., 0].sum(axis=1)[:, None]
    pose = [np.full((count, PLACES), start[axis]) for axis in range(3)]
    for arc in range(number):
        length, curvature = arcs[:, arc, :1], arcs[:, arc, 1:]
        last = arc == number - 1
        piece = distance if last else np.minimum(distance, length)
        pose = list(arc_end(pose[0], pose[1], pose[2], piece, np.broadcast_to(curvature, piece.shape)))
        distance = distance - piece
    return np.stack(pose[:2], axis=-1)


def obstacle_places(problem: ArcProblem) -> FloatArray:
    """A place in each obstacle that a rover's centre can be driven round on either side. (m, 2) [m]

    Obstacles are parts of the ground, apart from each other, from which the centre of the rover must keep away. Those
    at the frame of what is looked at have one side only.
    """
    from scipy.ndimage import label, minimum_position

    window = problem.window
    distance = window.values[..., 0]
    parts, count = label(distance < problem.need_m, structure=np.ones((3, 3)))
    at_frame = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    own = np.setdiff1d(np.arange(1, count + 1), at_frame)
    if not own.size:
        return np.empty((0, 2))
    rows, columns = np.array(minimum_position(distance, parts, own)).T
    return np.column_stack([window.x0 + window.spacing * columns, window.y0 + window.spacing * rows])


def sides(places_m: FloatArray, obstacles_m: FloatArray) -> IntArray:
    """On which side courses with the same ends pass each obstacle: turns about it, next to the straight way. (n, m)

    Places (n, k, 2), obstacles (m, 2) [m]. Courses of one homology class have the same numbers (Bhattacharya et al.
    2012, Auton. Robots 33, 273, 10.1007/s10514-012-9304-1): the angle swept about a point differs by whole turns.
    """
    if not len(obstacles_m):
        return np.zeros((len(places_m), 0), dtype=np.int64)
    off = places_m[:, :, None] - obstacles_m
    angle = np.arctan2(off[..., 1], off[..., 0])
    swept = _wrapped(np.diff(angle, axis=1)).sum(axis=1)
    straight = _wrapped(angle[:, -1] - angle[:, 0])
    return np.asarray(np.rint((swept - straight) / (2.0 * math.pi)).astype(np.int64))


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class DistinctWays:
    """Picks the cheapest course of each way.

    Attributes
    ----------
    problem : of the courses.
    obstacles_m : from `obstacle_places`. (m, 2) [m]
    apart_m : courses that pass all obstacles alike are two ways where they are so far apart somewhere. [m]
    most : courses picked.
    """

    problem: ArcProblem
    obstacles_m: FloatArray
    apart_m: float
    most: int

    def __call__(self, arcs: FloatArray, cost: FloatArray) -> Sequence[int]:
        """Numbers of the picked courses (n, k, 2), the cheapest first; a `Pick` of `lattice_courses`."""
        order = np.argsort(cost, kind="stable")
        order = order[np.isfinite(cost[order])][:LOOKED_AT]
        if not order.size:
            return []
        return [int(order[k]) for k in self.of_places(course_places(self.problem.start, arcs[order]))]

    def of_places(self, places_m: FloatArray) -> list[int]:
        """The same for courses by their places, the cheapest first: first all classes, then what is far apart."""
        passed = sides(places_m, self.obstacles_m)
        _, first = np.unique(passed, axis=0, return_index=True)
        picked = sorted(int(number) for number in first)[: self.most]
        left = np.setdiff1d(np.arange(len(places_m)), picked)
        for number in picked:
            left = left[self._apart(places_m, passed, left, number)]
        while left.size and len(picked) < self.most:
            picked.append(int(left[0]))
            left = left[self._apart(places_m, passed, left, picked[-1])]
        return picked

    def _apart(self, places_m: FloatArray, passed: IntArray, others: IntArray, one: int) -> FloatArray:
        far = np.hypot(*np.moveaxis(places_m[others] - places_m[one], -1, 0)).max(axis=1) > self.apart_m
        return np.asarray(far | (passed[others] != passed[one]).any(axis=1))
