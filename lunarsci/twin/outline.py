"""The rover seen from above: how near it comes to the circles that it must keep out of."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.plan import KeepOut
from lunarsci.twin.rover import Rover

__all__ = ["Outline", "keep_out_distance", "outline_corners", "rover_outline"]

FloatArray = npt.NDArray[np.float64]
Outline = tuple[float, float, float, float]


def rover_outline(rover: Rover) -> Outline:
    """Smallest rectangle of the rover's frame about all wheels, straight and level, and the body: x, x, y, y. [m]"""
    wheels, wheel = rover.wheel_positions_m, rover.wheel
    reach = wheel.radius_m + wheel.grouser_height_m
    x = [float(wheels[:, 0].min()) - reach, float(wheels[:, 0].max()) + reach]
    side = float(np.abs(wheels[:, 1]).max()) + 0.5 * wheel.width_m
    if rover.body is not None:
        half = 0.5 * rover.body.length_m
        x = [min(x[0], rover.body.center_x_m - half), max(x[1], rover.body.center_x_m + half)]
        side = max(side, 0.5 * rover.body.width_m)
    return x[0], x[1], -side, side


def outline_corners(outline: Outline, x_m: float, y_m: float, yaw_deg: float) -> FloatArray:
    """Corners of the outline on the map, counter-clockwise from the rear right one. (4, 2) [m]"""
    rear, front, right, left = outline
    corners = np.array([[rear, right], [front, right], [front, left], [rear, left]])
    turn = np.radians(yaw_deg)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.asarray(corners @ rotation + (x_m, y_m))


def keep_out_distance(prediction: Prediction, circles: tuple[KeepOut, ...] | None = None) -> FloatArray:
    """Horizontal distance of the rover's outline from the nearest circle; negative inside. (members, samples) [m]

    The outline is the rectangle of `rover_outline`, turned with the rover; tilt is neglected, which errs on the safe
    side. `circles` are the plan's by default; infinite where there are none. From where the centre of a circle lies
    below the rover, the distance is minus its radius.
    """
    rear, front, right, left = rover_outline(prediction.rover)
    x, y, yaw = prediction.paths[..., 0], prediction.paths[..., 1], np.radians(prediction.paths[..., 5])
    nearest = np.full(x.shape, np.inf)
    for circle in prediction.plan.keep_out if circles is None else circles:
        east, north = circle.x_m - x, circle.y_m - y
        ahead, beside = np.cos(yaw) * east + np.sin(yaw) * north, np.cos(yaw) * north - np.sin(yaw) * east
        outside = np.hypot(ahead - np.clip(ahead, rear, front), beside - np.clip(beside, right, left))
        nearest = np.minimum(nearest, outside - circle.radius_m)
    return nearest
