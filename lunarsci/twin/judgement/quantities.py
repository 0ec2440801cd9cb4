"""Quantities of a drive against distance: clearance, distance from exclusion zones, those of chassis and wheels."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import each_in_threads, in_lanes
from lunarsci.errors import ParameterError
from lunarsci.twin.ground.footprint import rover_outline
from lunarsci.twin.ground.keep_out import ExclusionZone
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.rover import Body
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction

MOST_POINTS = 1000
"""Of the grid on the belly; a finer terrain is met at wider points."""
BLOCK = 4096
BELLY_REACH_M = 3.0
"""No point of a rover is farther from its origin; assumed. [m]"""


def belly_points(body: Body, spacing_m: float) -> FloatArray:
    """Grid of points on the underside, edges included, at most `spacing_m` apart while 1000 points do. (n, 3) [m]"""
    spacing = max(spacing_m, math.sqrt(body.length_m * body.width_m / MOST_POINTS))
    along, across = (
        np.linspace(-0.5 * side, 0.5 * side, max(2, math.ceil(side / spacing - 1e-9) + 1))
        for side in (body.length_m, body.width_m)
    )
    x, y = np.meshgrid(body.center_x_m + along, across, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, body.belly_z_m)])


@in_lanes
def least_above(height: Any, x0: float, y0: float, spacing: float, points: Any, poses: Any, out: Any) -> None:
    """Least height of the points above the ground for each pose (n, 6: x, y, z, roll, pitch, yaw [rad]), into `out`.

    `out` (n, 2) takes that height, NaN where no ground is known below, and the share of points without known ground.
    """
    ny, nx = height.shape
    for k in range(len(poses)):
        cr, sr = math.cos(poses[k, 3]), math.sin(poses[k, 3])
        cp, sp = math.cos(poses[k, 4]), math.sin(poses[k, 4])
        cy, sy = math.cos(poses[k, 5]) / spacing, math.sin(poses[k, 5]) / spacing
        least, unknown = np.inf, 0
        # Turned by roll about x, then by pitch about y, then by yaw about z: columns of that rotation.
        column_x, column_y, column_z = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
        row_x, row_y, row_z = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
        up_x, up_y, up_z = -sp, cp * sr, cp * cr
        column_0, row_0 = (poses[k, 0] - x0) / spacing, (poses[k, 1] - y0) / spacing
        for n in range(len(points)):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            column = column_0 + column_x * x + column_y * y + column_z * z
            row = row_0 + row_x * x + row_y * y + row_z * z
            if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
                unknown += 1
                continue
            j, i = min(np.int64(column), nx - 2), min(np.int64(row), ny - 2)
            a, b = column - j, row - i
            low = height[i, j] + a * (height[i, j + 1] - height[i, j])
            high = height[i + 1, j] + a * (height[i + 1, j + 1] - height[i + 1, j])
            above = poses[k, 2] + up_x * x + up_y * y + up_z * z - (low + b * (high - low))
            if np.isnan(above):
                unknown += 1
            elif above < least:
                least = above
        out[k, 0] = least if least < np.inf else np.nan
        out[k, 1] = unknown / len(points)


def clearance_of_poses(prediction: Prediction, body: Body, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Clearance [m] and share of the belly over unknown ground [-] for poses with `PATH_COLUMNS`.

    Poses are (members, ..., 6), the results (members, ...). Every member is over its own ground.
    """
    terrain = prediction.terrain
    points = belly_points(body, terrain.spacing_m)
    shape, draws = poses.shape[:-1], prediction.draws
    flat = np.ascontiguousarray(poses.reshape(-1, 6))
    flat = np.concatenate([flat[:, :3], np.radians(flat[:, 3:])], axis=1)
    out = np.empty((len(flat), 2))
    size = BLOCK if draws is None else len(flat) // len(draws)

    def block(number: int) -> None:
        own = slice(number * size, (number + 1) * size)
        ground = _ground_below(terrain, flat[own], None if draws is None else draws[number])
        least_above(*ground, float(terrain.spacing_m), points, flat[own], out[own])

    each_in_threads(block, math.ceil(len(flat) / size))
    return out[:, 0].reshape(shape), out[:, 1].reshape(shape)


def _ground_below(terrain: Terrain, poses: FloatArray, draw: FloatArray | None) -> tuple[FloatArray, float, float]:
    """Heights that poses may be over, and x and y of their first node: all of them, or those drawn about the poses."""
    if draw is None:
        return np.ascontiguousarray(terrain.height_m, dtype=float), float(terrain.x0_m), float(terrain.y0_m)
    parts = []
    for axis, places in ((terrain.y_m, poses[:, 1]), (terrain.x_m, poses[:, 0])):
        first, last = np.searchsorted(axis, (places.min() - BELLY_REACH_M, places.max() + BELLY_REACH_M))
        parts.append(slice(min(first, len(axis) - 2), max(last, 2)))
    rows, columns = parts
    heights = terrain.drawn_heights(draw, rows, columns)
    return heights, float(terrain.x_m[columns.start]), float(terrain.y_m[rows.start])


def clearance(prediction: Prediction) -> tuple[FloatArray, FloatArray]:
    """Least vertical distance of the underside of the chassis from the ground along each drive.

    Returns it [m] and the share of the underside that is over ground of unknown height [-], (members, samples) both.
    The distance counts the known ground only, is NaN where none is known, and negative where the chassis would be in
    the ground; the drive itself goes on as if nothing had touched. Wheel tracks do not lower the ground. Heights are
    bilinear between the nodes, six times faster than the ground that the wheels meet and 0.1 mm from it on the embedded
    terrain, below points no wider apart than the nodes.

    Raises ParameterError for a rover without a body.
    """
    body = prediction.rover.body
    if body is None:
        raise ParameterError(f"{prediction.rover.name} has no [body]; add the table to the rover file as in yutu2's")
    return clearance_of_poses(prediction, body, prediction.paths)


def exclusion_distance(prediction: Prediction, circles: tuple[ExclusionZone, ...] | None = None) -> FloatArray:
    """Horizontal distance of the rover's outline from the nearest circle; negative inside. (members, samples) [m]

    The outline is the rectangle of `rover_outline`, turned with the rover; tilt is neglected, which errs on the safe
    side. `circles` are the plan's by default; infinite where there are none. From where the centre of a circle lies
    below the rover, the distance is minus its radius.
    """
    outline, paths = rover_outline(prediction.rover), prediction.paths
    poses = np.concatenate([prediction.places_m, np.radians(paths[..., 5:])], axis=-1)
    nearest = np.full(poses.shape[:-1], np.inf)
    for circle in prediction.plan.exclusion_zones if circles is None else circles:
        nearest = np.minimum(nearest, outline.distance_m(poses, circle.x_m, circle.y_m) - circle.radius_m)
    return nearest


@dataclass(frozen=True, slots=True)
class Encounter:
    """Where drives come nearest to a circle to keep out of, or deepest into it.

    Attributes
    ----------
    name, zone_x_m, zone_y_m, radius_m : the circle.
    margin_m : distance of the rover's outline from it, negative inside.
    x_m, y_m, distance_m, member : place of the rover's origin, how far the plan then is, and which drive it is.
    entered_by : drives that enter this circle.
    """

    name: str
    zone_x_m: float
    zone_y_m: float
    radius_m: float
    margin_m: float
    x_m: float
    y_m: float
    distance_m: float
    member: int
    entered_by: int


def encounters(prediction: Prediction, most: int = 5) -> list[Encounter]:
    """The circles of the plan that drives come nearest to, the worst first; no more than `most`, but all entered."""
    found = []
    for zone in prediction.plan.exclusion_zones:
        away = np.where(prediction.reached, exclusion_distance(prediction, (zone,)), np.inf)
        member, sample = np.unravel_index(int(away.argmin()), away.shape)
        x, y = prediction.places_m[member, sample]
        own = (zone.name, zone.x_m, zone.y_m, zone.radius_m, float(away[member, sample]))
        entered = int((away < 0).any(axis=1).sum())
        found.append(Encounter(*own, float(x), float(y), float(prediction.distance_m[sample]), int(member), entered))
    found.sort(key=lambda one: one.margin_m)
    return [one for k, one in enumerate(found) if k < most or one.margin_m < 0]


def tilt_deg(roll_deg: npt.ArrayLike, pitch_deg: npt.ArrayLike) -> FloatArray:
    """Angle between the chassis' z axis and the vertical, cos(tilt) = cos(roll) cos(pitch). [deg]"""
    return np.asarray(np.degrees(np.arccos(np.cos(np.radians(roll_deg)) * np.cos(np.radians(pitch_deg)))))


def along(prediction: Prediction, quantity: str) -> FloatArray:
    """A quantity at every sample, (members, samples), or (members, samples, wheels) for a column of the wheel states.

    `tilt_deg`, `miss_m` (distance of the rover's origin from where the plan has it by then), `clearance_m`,
    `keep_out_m`, `motor_torque_nm` (that of the ground, which a motor must hold), and the columns of `PATH_COLUMNS` and
    `STATE_COLUMNS`, of which x_m and y_m are the rover's. Rows beyond `Prediction.reached` repeat the last one. Raises
    ParameterError for another name.
    """
    if quantity == "tilt_deg":
        return tilt_deg(along(prediction, "roll_deg"), along(prediction, "pitch_deg"))
    if quantity == "miss_m":
        return np.asarray(np.hypot(*np.moveaxis(prediction.places_m - prediction.planned[:, :2], -1, 0)))
    if quantity == "clearance_m":
        return clearance(prediction)[0]
    if quantity == "keep_out_m":
        return exclusion_distance(prediction)
    if quantity == "motor_torque_nm":
        return along(prediction, "resistance_torque_nm")
    if quantity in PATH_COLUMNS:
        return prediction.paths[..., PATH_COLUMNS.index(quantity)]
    if quantity in STATE_COLUMNS:
        return prediction.states[..., STATE_COLUMNS.index(quantity)]
    raise ParameterError(f"'{quantity}' is no quantity of a drive")


def abscissa(prediction: Prediction) -> tuple[FloatArray, str]:
    """What to draw against, with its label: the commanded distance, or the time where the rover also turns or waits."""
    if (np.diff(prediction.distance_m) > 0).all():
        return prediction.distance_m, "commanded distance [m]"
    return prediction.time_s, "time [s]"
