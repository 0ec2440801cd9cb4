"""Quantities of a drive against distance: clearance, distance from exclusion zones, those of chassis and wheels."""

import math
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled, each_in_threads, in_lanes
from lunarsci.errors import ParameterError
from lunarsci.twin.ground.hazards import ExclusionZone, rover_outline
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.rover import Body
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction

BLOCK = 4096
"""Poses that a thread looks at together."""
_CLEARANCES: WeakKeyDictionary[Prediction, tuple[FloatArray, FloatArray]] = WeakKeyDictionary()
"""What `clearance` has found, as long as the predictions are there."""


@compiled
def belly_plane(pose: Any, belly: float, x0: float, y0: float, spacing: float) -> Any:
    """Column, row [nodes] and height [m] of a point (x, y) of the belly plane: each a x + b y + c, as (a, b, c).

    `pose` is x, y, z, roll, pitch, yaw [m, rad], `belly` the plane's height in the rover's frame; the grid has its
    first node at x0, y0. [m]
    """
    cr, sr, cp, sp = math.cos(pose[3]), math.sin(pose[3]), math.cos(pose[4]), math.sin(pose[4])
    cy, sy = math.cos(pose[5]) / spacing, math.sin(pose[5]) / spacing
    # Turned by roll about x, then by pitch about y, then by yaw about z.
    column = (cy * cp, cy * sp * sr - sy * cr, (pose[0] - x0) / spacing + (cy * sp * cr + sy * sr) * belly)
    row = (sy * cp, sy * sp * sr + cy * cr, (pose[1] - y0) / spacing + (sy * sp * cr - cy * sr) * belly)
    return column, row, (-sp, cp * sr, pose[2] + cp * cr * belly)


@compiled
def above_edges(height: Any, body: Any, plane: Any, parts: Any) -> Any:
    """Least height of the belly's edges above the ground [m], places without known ground, and places.

    `height` (ny, nx) [m] and `body` as in `least_above`, `plane` as of `belly_plane`; each edge along x and along y is
    looked at in as many places as `parts` (2,) says. The height is infinite where no ground is known.
    """
    (column_x, column_y, column_0), (row_x, row_y, row_0), (up_x, up_y, up_0) = plane
    ny, nx = height.shape
    least, unknown = np.inf, 0
    sides = (body[1] - body[0], body[3] - body[2], body[0] - body[1], body[2] - body[3])
    for side in range(4):
        x, y = body[1 if side in (1, 2) else 0], body[3 if side in (2, 3) else 2]
        count = parts[side % 2]
        dx, dy = (0.0, sides[side] / count) if side % 2 else (sides[side] / count, 0.0)
        column, row = column_0 + column_x * x + column_y * y, row_0 + row_x * x + row_y * y
        up = up_0 + up_x * x + up_y * y
        right, ahead, rise = column_x * dx + column_y * dy, row_x * dx + row_y * dy, up_x * dx + up_y * dy
        for n in range(count):
            at_column, at_row = column + n * right, row + n * ahead
            if not (0.0 <= at_column <= nx - 1 and 0.0 <= at_row <= ny - 1):
                unknown += 1
                continue
            j, i = min(np.int64(at_column), nx - 2), min(np.int64(at_row), ny - 2)
            a, b = at_column - j, at_row - i
            low = height[i, j] + a * (height[i, j + 1] - height[i, j])
            high = height[i + 1, j] + a * (height[i + 1, j + 1] - height[i + 1, j])
            above = up + n * rise - (low + b * (high - low))
            if np.isnan(above):
                unknown += 1
            elif above < least:
                least = above
    return least, unknown, 2 * (parts[0] + parts[1])


@compiled(error_model="numpy")  # type: ignore[untyped-decorator]
def between(start: float, step: float, low: float, high: float) -> Any:
    """The first and the last number j for which start + step j lies from `low` to `high`; none where first > last."""
    if step == 0.0:
        return (-np.inf, np.inf) if low <= start <= high else (np.inf, -np.inf)
    one, other = (low - start) / step, (high - start) / step
    return min(one, other), max(one, other)


@compiled(error_model="numpy")  # type: ignore[untyped-decorator]
def above_nodes(height: Any, body: Any, plane: Any) -> Any:
    """Least height of the belly above the nodes below it [m], nodes without known height, and nodes.

    Arguments as in `above_edges`. The height is infinite where no node has one.
    """
    (column_x, column_y, column_0), (row_x, row_y, row_0), (up_x, up_y, up) = plane
    ny, nx = height.shape
    row = row_0 + row_x * 0.5 * (body[0] + body[1]) + row_y * 0.5 * (body[2] + body[3])
    high = abs(row_x) * 0.5 * (body[1] - body[0]) + abs(row_y) * 0.5 * (body[3] - body[2])
    turned = column_x * row_y - column_y * row_x
    step_x, step_y = row_y / turned, -row_x / turned
    least, unknown, places = np.inf, 0, 0
    for i in range(max(0, math.ceil(row - high)), min(ny - 1, math.floor(row + high)) + 1):
        x, y = -column_y / turned * (i - row_0) - step_x * column_0, column_x / turned * (i - row_0) - step_y * column_0
        ends_x, ends_y = between(x, step_x, body[0], body[1]), between(y, step_y, body[2], body[3])
        left, right = max(ends_x[0], ends_y[0], 0.0), min(ends_x[1], ends_y[1], nx - 1.0)
        if left <= right:
            above, step = up + up_x * x + up_y * y, up_x * step_x + up_y * step_y
            for j in range(math.ceil(left), math.floor(right) + 1):
                if above + step * j - height[i, j] < least:
                    least = above + step * j - height[i, j]
                unknown += np.isnan(height[i, j])
                places += 1
    return least, unknown, places


@in_lanes
def least_above(height: Any, x0: float, y0: float, spacing: float, body: Any, poses: Any, out: Any) -> None:
    """Least height of a belly above the ground for each pose (n, 6: x, y, z, roll, pitch, yaw [rad]), into `out`.

    `height` (ny, nx) is the ground, with its first node at x0, y0 and this `spacing`; `body` (5,) the belly's rear,
    front, right and left edge and its height in the rover's frame. [m] The ground is bilinear, so that
    what is highest below the belly is a node, or lies below an edge. `out` (n, 2) takes that height, NaN where no
    ground is known below, and the share of these places without known ground.
    """
    parts = (4 + math.ceil((body[1] - body[0]) / spacing), 4 + math.ceil((body[3] - body[2]) / spacing))
    for k in range(len(poses)):
        plane = belly_plane(poses[k], body[4], x0, y0, spacing)
        edge, unknown, places = above_edges(height, body, plane, parts)
        node, unknown_nodes, nodes = above_nodes(height, body, plane)
        least = min(edge, node)
        out[k, 0] = least if least < np.inf else np.nan
        out[k, 1] = (unknown + unknown_nodes) / (places + nodes)


def with_middles(height_m: FloatArray, interpolation: str) -> FloatArray:
    """Heights of nodes and of the places half-way between them, as the wheels meet them. (2 ny - 1, 2 nx - 1) [m]

    A smooth ground is highest at a node or near one of these places. On triangles the middle of a cell lies on the
    edge between the two.
    """
    if interpolation == "triangles":
        height = np.empty([2 * n - 1 for n in height_m.shape])
        height[::2, ::2] = height_m
        height[::2, 1::2] = 0.5 * (height_m[:, :-1] + height_m[:, 1:])
        height[1::2, ::2] = 0.5 * (height_m[:-1] + height_m[1:])
        height[1::2, 1::2] = 0.5 * (height_m[:-1, :-1] + height_m[1:, 1:])
        return height
    return _smooth_middles(_smooth_middles(height_m).T).T


def _smooth_middles(height: FloatArray) -> FloatArray:
    """Rows (n, m) with one between each two (2 n - 1, m), by cubic convolution at a half (Keys 1981).

    In line with the last two beyond an edge.
    """
    whole = np.concatenate([2 * height[:1] - height[1:2], height, 2 * height[-1:] - height[-2:-1]])
    result = np.empty((2 * len(height) - 1, height.shape[1]))
    result[::2] = height
    result[1::2] = (9 * (whole[1:-2] + whole[2:-1]) - whole[:-3] - whole[3:]) / 16
    return result


def clearance_of_poses(prediction: Prediction, body: Body, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Clearance [m] and share of the belly over unknown ground [-] for poses with `PATH_COLUMNS`.

    Poses are (members, ..., 6), the results (members, ...). Every member is over its own ground.
    """
    terrain, shape, draws = prediction.terrain, poses.shape[:-1], prediction.draws
    flat = np.ascontiguousarray(poses.reshape(-1, 6))
    flat = np.concatenate([flat[:, :3], np.radians(flat[:, 3:])], axis=1)
    half_x, half_y = 0.5 * body.length_m, 0.5 * body.width_m
    belly = np.array([body.center_x_m - half_x, body.center_x_m + half_x, -half_y, half_y, body.belly_z_m])
    reach, out = float(np.abs(belly).sum()), np.empty((len(flat), 2))
    common = None if draws is not None else _ground_below(terrain, flat, reach, None)
    size = BLOCK if draws is None else len(flat) // len(draws)

    def block(number: int) -> None:
        rows = slice(number * size, (number + 1) * size)
        ground = common or _ground_below(terrain, flat[rows], reach, None if draws is None else draws[number])
        least_above(*ground, 0.5 * terrain.spacing_m, belly, flat[rows], out[rows])

    each_in_threads(block, math.ceil(len(flat) / size))
    return out[:, 0].reshape(shape), out[:, 1].reshape(shape)


def _ground_below(
    terrain: Terrain, poses: FloatArray, belly_m: float, draw: FloatArray | None
) -> tuple[FloatArray, float, float]:
    """Heights about poses, as far as the belly reaches, half-way places too, and x and y of their first node. [m]"""
    parts, reach = [], belly_m + 3.0 * terrain.spacing_m
    for axis, places in ((terrain.y_m, poses[:, 1]), (terrain.x_m, poses[:, 0])):
        first, last = np.searchsorted(axis, (places.min() - reach, places.max() + reach))
        parts.append(slice(min(first, len(axis) - 2), max(last, 2)))
    rows, columns = parts
    heights = terrain.height_m[rows, columns] if draw is None else terrain.drawn_heights(draw, rows, columns)
    ground = with_middles(np.asarray(heights, dtype=float), terrain.interpolation)
    return ground, float(terrain.x_m[columns.start]), float(terrain.y_m[rows.start])


def clearance(prediction: Prediction) -> tuple[FloatArray, FloatArray]:
    """Least vertical distance of the underside of the chassis from the ground along each drive.

    Returns it [m] and the share of the underside that is over ground of unknown height [-], (members, samples) both.
    The distance counts the known ground only, is NaN where none is known, and negative where the chassis would be in
    the ground; the drive itself goes on as if nothing had touched. Wheel tracks do not lower the ground. The highest
    ground below the whole underside counts: every node, the places half-way between nodes, and below the edges. It is
    found once for a prediction.

    Raises ParameterError for a rover without a body.
    """
    body = prediction.rover.body
    if body is None:
        raise ParameterError(f"{prediction.rover.name} has no [body]; add the table to the rover file as in yutu2's")
    if prediction not in _CLEARANCES:
        _CLEARANCES[prediction] = clearance_of_poses(prediction, body, prediction.paths)
    return _CLEARANCES[prediction]


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
    nearest = []
    for zone in prediction.plan.exclusion_zones:
        away = np.where(prediction.reached, exclusion_distance(prediction, (zone,)), np.inf)
        # Drives that ended where they were to begin came near to nothing.
        if np.isinf(away).all():
            continue
        member, sample = np.unravel_index(int(away.argmin()), away.shape)
        x, y = prediction.places_m[member, sample]
        rows = (zone.name, zone.x_m, zone.y_m, zone.radius_m, float(away[member, sample]))
        entered = int((away < 0).any(axis=1).sum())
        nearest.append(Encounter(*rows, float(x), float(y), float(prediction.distance_m[sample]), int(member), entered))
    nearest.sort(key=lambda one: one.margin_m)
    return [one for k, one in enumerate(nearest) if k < most or one.margin_m < 0]


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


def most_of_95(values: FloatArray) -> float:
    """The smallest value that at least 95 % of the members do not exceed."""
    return float(np.quantile(values, 0.95, method="inverted_cdf"))


def least_of_95(values: FloatArray) -> float:
    """The largest value that at least 95 % of the members reach."""
    return -most_of_95(-values)
