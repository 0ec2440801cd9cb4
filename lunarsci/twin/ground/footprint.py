"""The ground a rover covers: a rectangle about its wheels or all of it, and what that sweeps along a path."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.rover import Rover

BoolMap = BoolArray
OVERHANG = 1.05
"""The discs that cover the rectangle are at most so many half widths in radius; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverFootprint:
    """A rectangle in the rover's frame, x forward, y left, symmetric about x.

    Attributes
    ----------
    rear_m, front_m : x of its ends. [m]
    half_width_m : half its width. [m]
    """

    rear_m: float
    front_m: float
    half_width_m: float

    @property
    def reach_m(self) -> float:
        """Distance of its furthest corner from the rover's origin. [m]"""
        return math.hypot(max(self.front_m, -self.rear_m), self.half_width_m)

    def discs(self) -> tuple[FloatArray, float]:
        """Places along x of equal discs that cover the rectangle, and their radius. [m]"""
        length = self.front_m - self.rear_m
        count = max(1, math.ceil(length / (2.0 * self.half_width_m * math.sqrt(OVERHANG**2 - 1.0))))
        piece = length / count
        return self.rear_m + piece * (np.arange(count, dtype=np.float64) + 0.5), math.hypot(
            0.5 * piece, self.half_width_m
        )

    def distance_m(self, pose: FloatArray, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Distance of points from the rectangle of a rover at x, y, heading; 0 within it. [m]

        Poses (..., 3) [m, m, rad]; their leading axes and those of the points broadcast together.
        """
        u, v = self._in_frame(pose, x_m, y_m)
        beside = np.maximum(np.abs(v) - self.half_width_m, 0.0)
        return np.asarray(np.hypot(np.maximum(np.maximum(self.rear_m - u, u - self.front_m), 0.0), beside))

    def corners_m(self, pose: FloatArray) -> FloatArray:
        """Corners of the rectangle of a rover at x, y, heading, in order round it. (4, 2) [m]"""
        u = np.array([self.front_m, self.front_m, self.rear_m, self.rear_m])
        v = self.half_width_m * np.array([1.0, -1.0, -1.0, 1.0])
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        return np.column_stack([pose[0] + cos * u - sin * v, pose[1] + sin * u + cos * v])

    @staticmethod
    def _in_frame(pose: FloatArray, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        dx, dy = np.asarray(x_m) - pose[..., 0], np.asarray(y_m) - pose[..., 1]
        return cos * dx + sin * dy, cos * dy - sin * dx


def rover_footprint(rover: Rover) -> RoverFootprint:
    """The rectangle about the wheels as they stand when nothing is steered: what needs ground to drive on."""
    wheels, wheel = rover.wheel_positions_m, rover.wheel
    return RoverFootprint(
        rear_m=float(wheels[:, 0].min()) - wheel.radius_m,
        front_m=float(wheels[:, 0].max()) + wheel.radius_m,
        half_width_m=float(np.abs(wheels[:, 1]).max()) + 0.5 * wheel.width_m,
    )


def rover_outline(rover: Rover) -> RoverFootprint:
    """The rectangle about the wheels with their lugs, as they stand when nothing is steered, and the body."""
    wheels, lug = rover_footprint(rover), rover.wheel.grouser_height_m
    rear, front, side = wheels.rear_m - lug, wheels.front_m + lug, wheels.half_width_m
    if rover.body is not None:
        center, half = rover.body.center_x_m, 0.5 * rover.body.length_m
        rear, front, side = min(rear, center - half), max(front, center + half), max(side, 0.5 * rover.body.width_m)
    return RoverFootprint(rear_m=rear, front_m=front, half_width_m=side)


def swept_nodes(footprint: RoverFootprint, terrain: Terrain, poses: FloatArray) -> BoolMap:
    """Nodes of a terrain that lie within the footprint at some of the poses (n, 3) [m, m, rad]. (ny, nx)"""
    swept = np.zeros(terrain.height_m.shape, dtype=bool)
    x, y = terrain.x_m, terrain.y_m
    for pose in poses:
        rows, columns = terrain.window(footprint.corners_m(pose))
        swept[rows, columns] |= footprint.distance_m(pose, x[None, columns], y[rows, None]) == 0
    return swept


def nearest_node(
    footprint: RoverFootprint, poses: FloatArray, x_m: FloatArray, y_m: FloatArray
) -> tuple[float, int, int]:
    """Least distance of points (m,) from the footprint along the poses (n, 3), the point and the pose. [m]

    Without any point the distance is infinite and both numbers are 0.
    """
    best = (math.inf, 0, 0)
    for number, pose in enumerate(poses if x_m.size else ()):
        distance = footprint.distance_m(pose, x_m, y_m)
        point = int(distance.argmin())
        if distance[point] < best[0]:
            best = (float(distance[point]), point, number)
    return best
