"""From disparities to heights on a grid, with the errors that nodes have alone and those that they share."""

import math
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag
from scipy.ndimage import distance_transform_edt, map_coordinates, median

from lunarsci.arrays import SIGNIFICANCE, FloatArray
from lunarsci.compiled import compiled
from lunarsci.errors import DataError
from lunarsci.images.adjustment import crossed, triangulated
from lunarsci.images.camera import Pose, StereoRig
from lunarsci.images.elevation import ElevationModel, mean_about
from lunarsci.images.localisation import original_px
from lunarsci.images.matching import StereoMatches

COMMON_NODES = 4
"""Distance of the nodes at which the rig's errors are computed; they change slowly between these."""
OUTLYING = NormalDist().inv_cdf(1 - SIGNIFICANCE / 2)
"""Heights that lie farther from their cell's median, in standard deviations beside its slope, are left out:
as `SIGNIFICANCE` of sound ones are."""
STEEPEST = 1.5
"""Slope that a cell may have. Measured (`tests/benchmarks/image_numbers.py`, 30 November 2026, two rendered pairs):
from 1 to 2.25 heights stay as good, and their errors within 0.1 %. [-]"""
GRAZING_DEG = 3.0
"""What is seen flatter than that is no surface: something may hide between its pixels. Measured as `STEEPEST`: of 1.5,
3 and 6 deg 102, 100 and 85 % of the nodes have a height, with rms errors of 9.9, 9.0 and 6.8 mm. [deg]"""
PARTS = 3
"""A cell's height is the mean over so many places along x and y on the triangles between pixels."""
COVERED = 0.5
"""Share of these places that must lie on triangles. Measured as `STEEPEST`: of 0.25, 0.5 and 0.75 104, 100 and 96 % of
the nodes have a height, with rms errors of 9.4, 9.0 and 8.7 mm."""
ALIKE = 4 / 7
"""Distance of pixels whose errors are independent, as a share of their windows: as `matching.CORRELATED`."""
HIDDEN = 0.8
"""Error of what no pixel shows of a cell, over that relief: as `matching.CORRELATED`."""
SMOOTH_M = 0.06
"""Width over which the slope of the ground is taken for the errors. Measured as `STEEPEST`: of 3, 6 and 12 cm errors
are 1.37, 1.25 and 1.14 of the stated ones: wider is rougher. [m]"""
LEVEL = 0.01
"""Share of the weights' variance that holds a plane level where too few nodes say how it lies. Measured as `STEEPEST`:
a tenth and ten times as much change errors by 0.6 % at most."""


class Cloud(NamedTuple):
    """Points of n matched pixels.

    Attributes
    ----------
    points : in the world. (n, 3) [m]
    pixels : row and column of each in the rectified left picture. (n, 2)
    disparity : u in the left picture less u in the right one. (n,) [px]
    sigma_px : its random error. (n,) [px]
    window_px : width over which it is a mean, and its error one. (n,) [px]
    """

    points: FloatArray
    pixels: npt.NDArray[np.int64]
    disparity: FloatArray
    sigma_px: FloatArray
    window_px: FloatArray


def cloud_of(
    matches: StereoMatches, pose: Pose, farthest_m: float, rigs: tuple[StereoRig, StereoRig] | None = None
) -> Cloud:
    """The points of a pair up to a range, of the second one of `rigs` where it was rectified by the first one. Raises
    DataError where there are none."""
    valid = np.isfinite(matches.disparity) & (matches.disparity > 0)
    place = np.argwhere(valid)
    frame, d = matches.rectified, matches.disparity[valid]
    local = frame.points(matches.disparity)[valid]
    if rigs is not None:
        places = place[:, ::-1].astype(float)
        left = original_px(frame, rigs[0], places)
        right = original_px(frame, rigs[0], places - np.stack([d, 0 * d], axis=-1), right=True)
        local = triangulated(rigs[1], left, right[:, 0] - left[:, 0])
    near = np.linalg.norm(local, axis=1) <= farthest_m
    if near.sum() < 100:
        raise DataError(f"no ground within {farthest_m:g} m was matched; give a larger `farthest`")
    layers = matches.sigma_px[valid][near], matches.window_px[valid][near]
    return Cloud(pose.to_world(local[near]), place[near], d[near], *layers)


def cloud_ply(cloud: Cloud, light: FloatArray) -> bytes:
    """Points with their grey, 0 to 255 up to the brightest of `light` (n,), and random errors [px], as binary PLY (Turk
    1994). No library in use writes a table with a head like that."""
    grey = np.clip(255 * light / max(float(light.max()), 1e-9), 0, 255)
    names = ["x", "y", "z", "red", "green", "blue", "disparity_px", "sigma_px"]
    kinds = ["<f8"] * 3 + ["u1"] * 3 + ["<f4"] * 2
    columns = *cloud.points.T, grey, grey, grey, cloud.disparity, cloud.sigma_px
    table: Any = np.rec.fromarrays(columns, dtype=np.dtype(list(zip(names, kinds, strict=True))))
    words = {"<f8": "double", "u1": "uchar", "<f4": "float"}
    fields = [f"property {words[kind]} {name}" for name, kind in zip(names, kinds, strict=True)]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}", *fields, "end_header", ""]
    return "\n".join(head).encode() + bytes(table.tobytes())


def levelled(matches: StereoMatches, height_m: float) -> Pose:
    """A pose at `height_m` over the plane of what is near, which is taken as level: for pictures without one."""
    cloud = cloud_of(matches, Pose(rotation=np.eye(3), center_m=np.zeros(3)), 4 * height_m)
    middle = np.median(cloud.points, axis=0)
    normal = np.linalg.svd(cloud.points[:: max(1, len(cloud.points) // 20000)] - middle, full_matrices=False)[2][2]
    up = -normal * np.sign(normal @ middle)
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([ahead, np.cross(up, ahead), up])
    return Pose(rotation=rotation, center_m=np.array([0.0, 0.0, float(-(up @ middle))]))


def grid_of(
    matches: StereoMatches,
    rig: StereoRig,
    pose: Pose,
    *,
    name: str,
    spacing_m: float,
    farthest_m: float,
    synthetic: bool = False,
    moved: StereoRig | None = None,
    covariance: FloatArray | None = None,
) -> ElevationModel:
    """The mean height of each cell, and between pixels that lie farther apart than cells, up to a range `farthest_m`.

    The error of a height is that at its place: a point that is wrong along its ray is also beside itself, which a slope
    turns into height. What rig and pose do is common to all, also where it moves the whole map on uneven ground.
    Common errors are those of the `covariance` of the pose, as `Adjusted` has it, and the rig (30, 30); without it
    those of the rig alone. `moved` is the rig where it is not quite the one that rectified.
    """
    cloud = cloud_of(matches, pose, farthest_m, None if moved is None else (rig, moved))
    if covariance is None:
        covariance = block_diag(np.zeros((6, 6)), rig.covariance)
    low = np.floor(cloud.points[:, :2].min(axis=0) / spacing_m)
    size = np.ceil(cloud.points[:, :2].max(axis=0) / spacing_m) - low + 1
    shape = int(size[1]), int(size[0])
    x0, y0 = (float(v) for v in low * spacing_m)
    column, row = np.rint((cloud.points[:, :2] - (x0, y0)) / spacing_m).astype(np.int64).T
    cell = row * shape[1] + column
    first = _medians(cell, cloud.points[:, 2], shape)
    slopes, way = _slope(first, spacing_m), cloud.points - pose.center_m
    # By so much a disparity changes the height at a place, on ground as steep as about it. [m/px]
    slope_y, slope_x = (slope[row, column] for slope in slopes)
    gain = (slope_x * way[:, 0] + slope_y * way[:, 1] - way[:, 2]) / cloud.disparity
    aside = _unevenness(first, slopes, spacing_m)[row, column] * np.linalg.norm(way[:, :2], axis=1) / cloud.disparity
    sigma = np.hypot(gain, aside) * cloud.sigma_px
    window = cloud.window_px * np.linalg.norm(way, axis=1) / matches.rectified.focal_px
    near = np.abs(cloud.points[:, 2] - first.ravel()[cell]) <= OUTLYING * sigma + STEEPEST * spacing_m
    values = np.column_stack([cloud.points[:, 2], sigma**2, gain, window, ALIKE * cloud.window_px])
    layers, covered = _on_triangles(cloud, near, values, matches, (x0, y0, spacing_m), shape)
    height, variance, by_disparity, width, alike, between = np.moveaxis(layers, -1, 0)
    count = np.bincount(cell[near], minlength=shape[0] * shape[1]).reshape(shape)
    common, shift = _common_errors(moved or rig, pose, height, (x0, y0, spacing_m), covariance)
    # The error of a mean over n neighbouring pixels that are alike over w falls as w / (sqrt(n) + w - 1).
    alone = alike / (np.sqrt(np.maximum(count, 1)) + alike - 1) * np.sqrt(variance)
    hidden = HIDDEN * (1.0 - covered) * _relief(height, spacing_m)
    slopes = _slope(height, spacing_m)
    return ElevationModel(
        name=name,
        x0_m=x0,
        y0_m=y0,
        spacing_m=spacing_m,
        height_m=height,
        height_m_sigma=np.sqrt(alone**2 + hidden**2 + between),
        height_m_common_sigma=np.hypot(common, _unevenness(height, slopes, spacing_m) * shift),
        count=np.where(np.isfinite(height), np.maximum(count, 0.5), 0.0),
        height_by_disparity_m_px=by_disparity,
        resolution_m=np.nan_to_num(width),
        synthetic=synthetic,
    )


def _medians(cell: npt.NDArray[np.int64], z: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Median height of each cell, NaN where it has none; `cell` (n,) is that of each height z (n,). (ny, nx) [m]"""
    medians, places = np.full(shape[0] * shape[1], np.nan), np.unique(cell)
    medians[places] = median(z, cell, places)
    return medians.reshape(shape)


def _unevenness(height: FloatArray, slopes: tuple[FloatArray, FloatArray], spacing_m: float) -> FloatArray:
    """Rms of slopes from node to node about the smoothed ones of `_slope`; 0 where nothing is known. (ny, nx) [-]"""
    apart = [
        np.clip(np.gradient(height, spacing_m, axis=axis), -STEEPEST, STEEPEST) - smooth
        for axis, smooth in enumerate(slopes)
    ]
    mean = mean_about(0.5 * (apart[0] ** 2 + apart[1] ** 2), SMOOTH_M / spacing_m)
    return np.sqrt(np.nan_to_num(mean))


def _slope(height: FloatArray, spacing_m: float) -> tuple[FloatArray, FloatArray]:
    """Along y and x, of the plane that is nearest to what is known about each node, by Gaussian weights. (ny, nx) [-]

    Where everything is known that is the gradient of the smoothed heights (Stein 1981, 10.1214/aos/1176345632).
    """
    width, valid = SMOOTH_M / spacing_m, np.isfinite(height)

    def mean(values: FloatArray) -> FloatArray:
        return mean_about(np.where(valid, values, np.nan), width)

    y, x = np.indices(height.shape, dtype=float)
    my, mx, mz = mean(y), mean(x), mean(height)
    yy, xx = (mean(a * a) - m * m + LEVEL * width**2 for a, m in ((y, my), (x, mx)))
    xy, yz, xz = mean(x * y) - mx * my, mean(y * height) - my * mz, mean(x * height) - mx * mz
    both = (xx * yz - xy * xz, yy * xz - xy * yz)
    return tuple(np.clip(g / (xx * yy - xy * xy) / spacing_m, -STEEPEST, STEEPEST) for g in both)  # type: ignore[return-value]


def _relief(height: FloatArray, spacing_m: float) -> FloatArray:
    """Rms of heights about the smoothed ground. (ny, nx) [m]"""
    width = 2 * SMOOTH_M / 3 / spacing_m
    apart = (height - mean_about(height, width)) ** 2
    return np.sqrt(np.nan_to_num(mean_about(apart, width)))


def _common_errors(
    rig: StereoRig, pose: Pose, height: FloatArray, grid: tuple[float, float, float], covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What the covariance of pose and rig makes of heights at their places, and how far it shifts these away from the
    camera.

    With the covariance V of a point, ground whose slopes are p and q rises by (-p, -q, 1) V (-p, -q, 1)^T, squared.
    `grid` is x and y of the first node, and the spacing [m]. (ny, nx), (ny, nx) [m]
    """
    valid = np.isfinite(height)
    by = _by_errors(rig, pose, height, grid)
    spread = _between(by @ covariance @ by.swapaxes(-1, -2), height.shape)[valid]
    rows, columns = np.nonzero(valid)
    away = np.column_stack([columns, rows]) * grid[2] + np.array(grid[:2]) - pose.center_m[:2]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    ways = upwards(height, grid[2])[valid], np.pad(away, ((0, 0), (0, 1)))
    result = np.full((2, *height.shape), np.nan)
    for layer, way in zip(result, ways, strict=True):
        layer[valid] = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", way, spread, way), 0.0))
    return result[0], result[1]


def upwards(height: FloatArray, spacing_m: float) -> FloatArray:
    """By what a height changes where its ground is moved along x, y, z. (ny, nx, 3) [-]"""
    slope_y, slope_x = _slope(height, spacing_m)
    return np.stack([-slope_x, -slope_y, np.ones(height.shape)], axis=-1)


class HeightModes(NamedTuple):
    """The few ways in which errors of pose and rig change the heights of a model together.

    Attributes
    ----------
    by : change of each height by one standard deviation of each mode. (ny, nx, m) [m]
    of : what errors of the pose and the rig make of each mode. (m, 30)
    """

    by: FloatArray
    of: FloatArray


def height_modes(
    model: ElevationModel, rig: StereoRig, pose: Pose, root: FloatArray, count: int, way: FloatArray
) -> HeightModes:
    """The `count` modes with most of the variance, of errors whose covariance is root root^T (30, n).

    way : `upwards` of the ground, the same for all models that are compared: else the noise of their slopes seems to
        tell what they are all off by. (ny, nx, 3)
    """
    grid = model.x0_m, model.y0_m, model.spacing_m
    by, sample = _by_errors(rig, pose, model.height_m, grid) @ root, (slice(None, None, COMMON_NODES),) * 2
    there = np.einsum("yxi,yxim->yxm", way[sample], by[: way[sample].shape[0], : way[sample].shape[1]])
    there = there[np.isfinite(model.height_m[sample])]
    first = np.zeros((count, root.shape[1]))
    axes = np.linalg.svd(there, full_matrices=False)[2][:count]
    first[: len(axes)] = axes
    layers = np.einsum("yxi,yxim->yxm", way, _between(by @ first.T, model.height_m.shape))
    return HeightModes(layers, first @ np.linalg.pinv(root))


def _by_errors(rig: StereoRig, pose: Pose, height: FloatArray, grid: tuple[float, float, float]) -> FloatArray:
    """Derivatives of the place of what is seen by rotation and place of the camera [rad, m], and by the rig's
    `PARAMETERS`, at every `COMMON_NODES`th node; where no height is known it is the nearest one.
    (ny / 4 + 1, nx / 4 + 1, 3, 30)"""
    rows, columns = (np.arange(0, size + COMMON_NODES - 1, COMMON_NODES) for size in height.shape)
    filled = _nearest(height)[
        np.ix_(*(np.minimum(k, n - 1) for k, n in zip((rows, columns), height.shape, strict=True)))
    ]
    x, y = np.meshgrid(grid[0] + grid[2] * columns, grid[1] + grid[2] * rows)
    points = np.stack([x, y, filled], axis=-1)
    by_rig = pose.rotation @ rig.by_parameters(*rig.project(pose.to_camera(points)))
    by_turn = -crossed((points - pose.center_m).reshape(-1, 3)).reshape(*points.shape, 3)
    return np.concatenate([by_turn, np.broadcast_to(np.eye(3), by_turn.shape), by_rig], axis=-1)


def _between(sampled: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """What is known at every `COMMON_NODES`th node (.., .., ...) at all of `shape`: linear between them, and where it
    is not known that of the nearest one. (ny, nx, ...)"""
    places = np.stack(np.meshgrid(*(np.arange(size) / COMMON_NODES for size in shape), indexing="ij"))
    layers = np.moveaxis(sampled.reshape(*sampled.shape[:2], -1), -1, 0)
    made = [map_coordinates(_nearest(layer), places, order=1, mode="nearest") for layer in layers]
    return np.stack(made, axis=-1).reshape(*shape, *sampled.shape[2:])


def _nearest(values: FloatArray) -> FloatArray:
    """Values with those that are NaN taken from the nearest that is known. (ny, nx)"""
    place = distance_transform_edt(np.isnan(values), return_distances=False, return_indices=True)
    return np.asarray(values[tuple(place)])


def _on_triangles(
    cloud: Cloud,
    used: npt.NDArray[np.bool_],
    values: FloatArray,
    matches: StereoMatches,
    grid: tuple[float, float, float],
    shape: tuple[int, int],
) -> tuple[FloatArray, FloatArray]:
    """Means of values (n, m) over each cell, on triangles between neighbouring pixels, and how much of it these cover
    (ny, nx), 0 to 1; means are NaN where that is little. `used` (n,) are the pixels that count.

    The last layer of (ny, nx, m + 1) is the variance of a cell's mean by what no pixel shows: where the ground falls
    away from the camera by h from one row of pixels to the next, it lies anywhere down to h below the line of sight.
    """
    numbers = np.full(matches.disparity.shape, -1, dtype=np.int64)
    numbers[cloud.pixels[used, 0], cloud.pixels[used, 1]] = np.flatnonzero(used)
    place = (cloud.points[:, :2] - np.array(grid[:2])) / grid[2] * PARTS + 0.5 * (PARTS - 1)
    total = np.zeros((shape[0] * PARTS, shape[1] * PARTS, values.shape[1] + 1), dtype=np.float32)
    weight = np.zeros(total.shape[:2], dtype=np.float32)
    jump = 1.0 / (matches.rectified.focal_px * math.tan(math.radians(GRAZING_DEG)))
    _lay(numbers, np.ascontiguousarray(place), np.ascontiguousarray(values), cloud.disparity, jump, total, weight)
    part = weight > 0
    total[part] /= weight[part][:, None]
    blocks = (shape[0], PARTS, shape[1], PARTS)
    laid = part.reshape(blocks).sum(axis=(1, 3))
    with np.errstate(invalid="ignore"):
        means = total.reshape(*blocks, -1).sum(axis=(1, 3), dtype=float) / laid[..., None]
    means[laid < COVERED * PARTS**2] = np.nan
    return means, laid / PARTS**2


@compiled(error_model="numpy")
def _lay(numbers, place, values, disparity, jump, total, weight):  # type: ignore[no-untyped-def]
    """Lay both triangles of every four neighbouring pixels that are one surface.

    numbers : of each pixel of the picture among n points, -1 for none. (h, w)
    place, values, disparity : of the points: x and y in places of `total`, what is averaged, first of it the height,
        disparity [px]. (n, 2), (n, m), (n,)
    jump : share of the disparity by which it differs at most over one surface. [-]
    total, weight : sums of values, and how many triangles lie at a place; both are added to. (y, x, m + 1), (y, x)
    """
    for v in range(numbers.shape[0] - 1):
        for u in range(numbers.shape[1] - 1):
            a, b = numbers[v, u], numbers[v, u + 1]
            c, d = numbers[v + 1, u], numbers[v + 1, u + 1]
            if a < 0 or b < 0 or c < 0 or d < 0:
                continue
            near = max(max(disparity[a], disparity[b]), max(disparity[c], disparity[d]))
            far = min(min(disparity[a], disparity[b]), min(disparity[c], disparity[d]))
            if near - far > jump * near:
                continue
            _triangle(place, values, a, b, c, _fall(place, values, disparity, a, c), total, weight)
            _triangle(place, values, b, c, d, _fall(place, values, disparity, b, d), total, weight)


@compiled(error_model="numpy")
def _fall(place, values, disparity, a, c):  # type: ignore[no-untyped-def]
    """Variance that the ground between two pixels of neighbouring rows adds to the mean of a cell, of which it is at
    most all: a height anywhere between 0 and h has a mean square of h^2 / 3. [m2]"""
    fall = (values[c, 0] - values[a, 0]) * (1.0 if disparity[c] > disparity[a] else -1.0)
    share = math.hypot(place[a, 0] - place[c, 0], place[a, 1] - place[c, 1]) / PARTS
    return max(fall, 0.0) ** 2 / 3.0 * min(share, 1.0)


@compiled(error_model="numpy")
def _triangle(place, values, a, b, c, between, total, weight):  # type: ignore[no-untyped-def]
    """Lay the triangle of points a, b, c, values linear between them, and its variance `between`; arguments as of
    `_lay`."""
    ax, ay, bx, by, cx, cy = place[a, 0], place[a, 1], place[b, 0], place[b, 1], place[c, 0], place[c, 1]
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area == 0.0:
        return
    first, last = math.ceil(min(ax, min(bx, cx))), math.floor(max(ax, max(bx, cx)))
    low, high = math.ceil(min(ay, min(by, cy))), math.floor(max(ay, max(by, cy)))
    for y in range(max(low, 0), min(high, weight.shape[0] - 1) + 1):
        for x in range(max(first, 0), min(last, weight.shape[1] - 1) + 1):
            p = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
            q = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
            if p >= 0.0 and q >= 0.0 and p + q <= 1.0:
                total[y, x, values.shape[1]] += between
                for k in range(values.shape[1]):
                    total[y, x, k] += p * values[a, k] + q * values[b, k] + (1.0 - p - q) * values[c, k]
                weight[y, x] += 1.0
