"""Cameras, and how they stand to each other, from pictures of a flat target: least squares over all of them at once.

Which points of the board are seen where, and which pictures of two cameras are of the same moment. Zhang (2000),
10.1109/34.888718, for the idea; OpenCV begins, projects and differentiates, and scipy adjusts. Errors and what the
pictures do not determine are here. Every picture has a pose of the board of its own.
"""

import math
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, robust_scatter
from lunarsci.errors import DataError, LunarSciWarning, NoFilesError, ParameterError, RequestError
from lunarsci.images.camera import INTRINSICS, Camera, rotation_of, vector_of
from lunarsci.images.pictures import Picture, cv2
from lunarsci.io.inputs import InputFile, expand_inputs
from lunarsci.names import some_of
from lunarsci.ranges import refuse

Kind = Literal["chessboard", "circles", "asymmetric-circles", "charuco"]
FEWEST_POINTS = 5
"""Points of a board that a picture must show: four give a homography (Zhang 2000), a fifth tests it."""
SOUGHT_PX = 640 * 480
"""Pixels of the picture in which a chessboard is looked for, as by ROS's camera_calibration; measured: all boards of
254 public pictures of 270 x 180 to 1280 x 720 px are seen."""
FEWEST_VIEWS = 4
"""Pictures below which nothing is calibrated: three determine a planar problem (Zhang 2000), a fourth tests it."""
FEWEST_TILT_DEG = 10.0
"""Angle between the farthest normals of the board below which focal length and distance are the same: of calibrations
with planes that are turned by 5 deg about random axes, whose normals differ by less, 40 % fail (Zhang 2000, 4.1)."""
ROUNDS = 3
"""Adjustments, each of which leaves out the outliers of the one before."""
RIM = 24
"""Places on the rim of a circle from which the middle of its picture is computed: their polygon misses the ellipse
alike on all sides."""
Shown: TypeAlias = str | Path | InputFile
"""A picture, by its name or read; it is handed on as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardTarget:
    """A flat board of points.

    Attributes
    ----------
    kind : what it shows.
    columns, rows : of inner corners (chessboard), circles, or squares (charuco).
    square_m : side of a square, or distance of circles; of asymmetric ones half the distance within a row. [m]
    marker_m : side of the markers of a charuco board. [m]
    circle_m : diameter of circles; 0 leaves the centres of their pictures as they are. [m]
    dictionary : of the markers, as OpenCV calls it.

    Raises ParameterError for what no board can be.
    """

    kind: Kind = "chessboard"
    columns: int = 9
    rows: int = 6
    square_m: float = 0.025
    marker_m: float = 0.0
    circle_m: float = 0.0
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if not (3 <= min(self.columns, self.rows) <= max(self.columns, self.rows) <= 100
                and 0 <= self.circle_m < 2 * self.square_m):  # fmt: skip
            raise ParameterError(
                f"a board of {self.columns} x {self.rows}, circles of {self.circle_m:g} m {self.square_m:g} m apart; "
                "give 3 to 100 each way, and circles that fit between their centres"
            )

    @property
    def points_m(self) -> FloatArray:
        """All points of the board, row by row. (n, 3) [m]"""
        if self.kind == "charuco":
            return np.asarray(self.charuco().getChessboardCorners(), dtype=float).reshape(-1, 3)
        row, column = np.mgrid[: self.rows, : self.columns].astype(float)
        across = 2 * column + row % 2 if self.kind == "asymmetric-circles" else column
        return self.square_m * np.stack([across, row, np.zeros_like(row)], axis=-1).reshape(-1, 3)

    def charuco(self) -> Any:
        """OpenCV's board. Raises ParameterError for a dictionary that it does not know."""
        markers = cv2.aruco
        if not hasattr(markers, self.dictionary):
            raise ParameterError(f"'{self.dictionary}' is no dictionary of markers; one is DICT_4X4_50")
        words = markers.getPredefinedDictionary(getattr(markers, self.dictionary))
        return markers.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, words)


class Sighting(NamedTuple):
    """Points of a target in a picture.

    Attributes
    ----------
    numbers : their places in `BoardTarget.points_m`. (n,)
    pixels : u and v. (n, 2) [px]
    """

    numbers: npt.NDArray[np.int64]
    pixels: FloatArray


BoardView: TypeAlias = tuple[Sighting | None, ...]
"""What each camera sees of the board at one moment; None where it does not."""


def find_target(picture: Picture, target: BoardTarget, *, patient: bool = True) -> Sighting | None:
    """Where a picture shows the points of a target; None where it does not. `patient` looks for seconds."""
    eight, size = eight_bits(picture), (target.columns, target.rows)
    if target.kind == "charuco":
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(target.charuco()).detectBoard(eight)
        if numbers is None or len(numbers) < FEWEST_POINTS:
            return None
        return Sighting(np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2))
    pixels = _chessboard(eight, size, patient) if target.kind == "chessboard" else _circles(eight, size, target.kind)
    return None if pixels is None else Sighting(np.arange(len(pixels)), pixels)


def eight_bits(picture: Picture) -> npt.NDArray[np.uint8]:
    """A picture from black to its brightest in 8 bits. (h, w)"""
    low, high = np.percentile(picture.values, [0.5, 99.5])
    return np.asarray(np.clip(255 * (picture.values - low) / max(high - low, 1e-9), 0, 255), dtype=np.uint8)


def _chessboard(eight: npt.NDArray[np.uint8], size: tuple[int, int], patient: bool) -> FloatArray | None:
    """Inner corners of a board of `size` (columns, rows), row by row; None for none. (n, 2) [px]

    They are looked for by quadrangles, then by the sectors about corners (Duda & Frese 2018, Br. Mach. Vis. Conf.), in
    a picture of `SOUGHT_PX`, and at the end in the whole one. Their places are from the gradients about them
    (Foerstner & Guelch 1987, ISPRS Intercomm. Conf. Fast Process. Photogramm. Data), which are three times as precise
    on tilted boards, and without bias.
    """
    share = min(1.0, math.sqrt(SOUGHT_PX / eight.size))
    small = eight if share == 1 else cv2.resize(eight, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    sectors = cv2.findChessboardCornersSB
    ways = [(cv2.findChessboardCorners, cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE, small)]
    ways += [(sectors, flags, small) for flags in (0, cv2.CALIB_CB_NORMALIZE_IMAGE)]
    ways += [(sectors, cv2.CALIB_CB_EXHAUSTIVE, small), (sectors, 0, eight)] if patient else []
    for find, flags, seen in ways:
        detected, corners = find(seen, size, flags=flags)
        if detected:
            break
    else:
        return None
    scale = eight.shape[0] / seen.shape[0]
    start = (scale * (np.asarray(corners, float) + 0.5) - 0.5).astype(np.float32).reshape(size[1], size[0], 2)
    apart = min(float(np.linalg.norm(np.diff(start, axis=axis), axis=-1).min()) for axis in (0, 1))
    # A window about a corner ends a pixel before the middle between it and the next.
    half = (max(2, int(0.5 * apart) - 1),) * 2
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    return np.asarray(cv2.cornerSubPix(eight, start.reshape(-1, 1, 2), half, (-1, -1), stop), float).reshape(-1, 2)


def _circles(eight: npt.NDArray[np.uint8], size: tuple[int, int], kind: Kind) -> FloatArray | None:
    """Middles of the circles of a board of `size` (columns, rows), row by row; None for none. (n, 2) [px]"""
    large = cv2.SimpleBlobDetector_Params()
    large.maxArea = float(eight.size)
    grid = cv2.CALIB_CB_SYMMETRIC_GRID if kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
    for wanted, way in product((cv2.SimpleBlobDetector_Params(), large), (0, cv2.CALIB_CB_CLUSTERING)):
        blobs = cv2.SimpleBlobDetector_create(wanted)
        detected, centers = cv2.findCirclesGrid(eight, size, flags=grid | way, blobDetector=blobs)
        if detected:
            return np.asarray(centers, dtype=float).reshape(-1, 2)
    return None


def alike_turned(left: Sighting, right: Sighting, target: BoardTarget) -> Sighting:
    """The right picture's sighting of a whole board numbered as the left one's: one that looks alike may be turned."""
    grid = np.arange(len(right.numbers)).reshape(target.rows, target.columns)
    turns = [turn.ravel() for k in range(4) if (turn := np.rot90(grid, k)).shape == grid.shape]
    ways = left.pixels - left.pixels.mean(axis=0)
    return Sighting(right.numbers, right.pixels[max(turns, key=lambda turn: float((ways * right.pixels[turn]).sum()))])


def check_board(pictures: Sequence[Picture], sightings: Sequence[Sighting | None], target: BoardTarget) -> None:
    """Raise DataError where most pictures do not show the chessboard that was stated, and one shows another one."""
    without = [p for p, s in zip(pictures, sightings, strict=True) if s is None]
    if target.kind != "chessboard" or len(without) < 0.5 * len(pictures):
        return
    size = target.columns, target.rows
    near = [(size[0] + a, size[1] + b) for a, b in product((2, 1, 0, -1, -2), repeat=2) if a or b]
    near = sorted((other for other in near if min(other) >= 3), key=math.prod, reverse=True)
    for picture in without[:2]:
        eight = eight_bits(picture)
        for other in near:
            if _chessboard(eight, other, False) is not None:
                raise DataError(
                    f"{picture.source.name}: shows a chessboard of {other[0]} x {other[1]}, not {size[0]} x {size[1]}; "
                    "a chessboard's size is that of its inner corners, squares less one each way"
                )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCalibration:
    """Cameras that were calibrated together.

    Attributes
    ----------
    cameras : one, or the left and the right one.
    rotation, translation_m : X_right = rotation X_left + translation_m. (3, 3), (3,) [m]
    covariance : of the intrinsics of each camera, and of the small rotation after `rotation` and the translation;
        scaled by the residuals and by how they differ between pictures; the squares' size is not in it. (n, n)
    residual_px : standard deviation of a coordinate. [px]
    between_pictures : errors by leaving pictures out over those by residuals alone; above 1 the covariance has it. [-]
    residuals : by camera, rows of picture, u, v, du, dv [px]; without those left out.
    left_out : points that were left out as outliers.
    poses : of the board in the left camera's frame, by picture: rotation vector and translation. (m, 6) [rad, m]
    tilt_deg : angle between the farthest normals of the board.
    """

    cameras: tuple[Camera, ...]
    rotation: FloatArray
    translation_m: FloatArray
    covariance: FloatArray
    residual_px: float
    between_pictures: float
    residuals: tuple[FloatArray, ...]
    left_out: int
    poses: FloatArray
    tilt_deg: float

    @property
    def baseline_m(self) -> float:
        """Distance of both cameras, 0 of one. [m]"""
        return float(np.linalg.norm(self.translation_m))

    def uncertainty_px(self, index: int, pixels: FloatArray) -> FloatArray:
        """By how much intrinsics leave directions uncertain at pixels (n, 2), what a turn mends apart. (n,) [px]

        NaN where the distortion leaves a pixel without a direction.
        """
        camera, block = self.cameras[index], slice(9 * index, 9 * index + 9)
        rays = camera.rays(pixels)
        seen = np.isfinite(rays).all(axis=1)
        slopes = camera.project_with_derivatives(rays[seen])
        turned, change = slopes.by_pose[..., :3].reshape(-1, 3), slopes.by_intrinsics.reshape(-1, len(INTRINSICS))
        change = change - turned @ np.linalg.lstsq(turned, change, rcond=None)[0]
        variance = np.einsum("ni,ij,nj->n", change, self.covariance[block, block], change)
        error = np.full(len(pixels), np.nan)
        error[seen] = np.sqrt(variance.reshape(-1, 2).sum(axis=1))
        return error


class _Placed(NamedTuple):
    """A sighting with its camera and the board's pose before it.

    Attributes
    ----------
    moment : number of the moment in the views, from 0.
    side : number of the camera, 0 the left or only one, 1 the right one.
    sighting, camera : what that camera sees, and the camera with the intrinsics of this step.
    turn, way : rotation vector and translation of the board in this camera's frame. (3,) [rad], (3,) [m]
    by_poses : derivatives of both by the board's pose before the left camera, then by the pose of the right camera
        beside it, rotation first each. (6, 12)
    """

    moment: int
    side: int
    sighting: Sighting
    camera: Camera
    turn: FloatArray
    way: FloatArray
    by_poses: FloatArray


class _Adjustment(NamedTuple):
    """The adjustment of one camera or two.

    Parameters `x` are the free intrinsics of each camera, of two the rotation vector [rad] and translation [m] between
    them, and for each moment rotation vector and translation of the board before the left camera.

    Attributes
    ----------
    plain : the cameras with which it began, left one first.
    free : places in `INTRINSICS` of those that are adjusted.
    points : of the board. (n, 3) [m]
    views : by moment, what each camera sees of them.
    """

    plain: tuple[Camera, ...]
    free: tuple[int, ...]
    points: FloatArray
    views: tuple[BoardView, ...]

    @property
    def lenses(self) -> int:
        """Count of free intrinsics."""
        return len(self.plain) * len(self.free)

    @property
    def shared(self) -> int:
        """Count of the parameters that all pictures share."""
        return self.lenses + (6 if len(self.plain) > 1 else 0)

    def cameras(self, x: FloatArray) -> list[Camera]:
        """The cameras with the intrinsics of `x`."""
        vectors = np.array([camera.vector() for camera in self.plain])
        vectors[:, self.free] = x[: self.lenses].reshape(len(self.plain), -1)
        return [camera.with_vector(vector) for camera, vector in zip(self.plain, vectors, strict=True)]

    def relative(self, x: FloatArray) -> FloatArray:
        """Rotation vector and translation from the left to the right camera, zeros of one alone. (6,)"""
        return x[self.lenses : self.shared] if len(self.plain) > 1 else np.zeros(6)

    def poses(self, x: FloatArray) -> FloatArray:
        """Rotation vector and translation of the board before the left camera, by moment. (moments, 6) [rad, m]"""
        return x[self.shared :].reshape(-1, 6)

    def placed(self, x: FloatArray) -> Iterator[_Placed]:
        """Every sighting, moment by moment, the left camera's first."""
        cameras, relative = self.cameras(x), self.relative(x)
        for k, (view, pose) in enumerate(zip(self.views, self.poses(x), strict=True)):
            for index, sighting in enumerate(view):
                if sighting is None:
                    continue
                turn, way, by = pose[:3], pose[3:], np.eye(6, 12)
                if index:
                    turn, way, *parts = cv2.composeRT(*np.split(pose, 2), *np.split(relative, 2))
                    by = np.block([parts[:4], parts[4:]])
                yield _Placed(k, index, sighting, cameras[index], turn, way, by)

    def misses(self, x: FloatArray) -> list[FloatArray]:
        """Computed less seen places of the points of each sighting. (n, 2) each [px]"""
        return [
            one.camera.project_with_derivatives(self.points[one.sighting.numbers], one.turn, one.way).pixels
            - one.sighting.pixels
            for one in self.placed(x)
        ]

    def slopes(self, x: FloatArray, inliers: Sequence[BoolArray]) -> FloatArray:
        """Derivatives of the residuals of inliers. (n, parameters)"""
        count, blocks = len(self.free), []
        for one, good in zip(self.placed(x), inliers, strict=True):
            seen = one.camera.project_with_derivatives(self.points[one.sighting.numbers[good]], one.turn, one.way)
            block, first = np.zeros((*seen.pixels.shape, len(x))), self.shared + 6 * one.moment
            block[..., one.side * count : (one.side + 1) * count] = seen.by_intrinsics[..., self.free]
            by_poses = seen.by_pose @ one.by_poses
            block[..., first : first + 6] = by_poses[..., :6]
            if one.side:
                block[..., self.lenses : self.shared] = by_poses[..., 6:]
            blocks.append(block.reshape(-1, len(x)))
        return np.concatenate(blocks)

    def adjusted(self, x: FloatArray, inliers: Sequence[BoolArray]) -> FloatArray:
        """Least squares over all inliers, by Levenberg and Marquardt."""
        from scipy.optimize import least_squares

        def misses(values: FloatArray) -> FloatArray:
            try:
                return _inlying(self.misses(values), inliers).ravel()
            except ParameterError:  # no camera has such intrinsics
                return np.full(2 * sum(int(good.sum()) for good in inliers), 1e4)

        def slopes(values: FloatArray) -> FloatArray:
            return self.slopes(values, inliers)

        return np.asarray(least_squares(misses, x, slopes, method="lm", x_scale="jac", xtol=1e-12).x)


def _inlying(parts: Sequence[FloatArray], inliers: Sequence[BoolArray]) -> FloatArray:
    """Rows of all sightings that are inliers, one after the other."""
    return np.concatenate([part[good] for part, good in zip(parts, inliers, strict=True)])


def calibrate(
    views: Sequence[BoardView], target: BoardTarget, sizes: Sequence[tuple[int, int]], *, distortion: int = 5
) -> CameraCalibration:
    """Cameras of sizes (width, height) [px] from what they see of a target; one size, or left and right.

    `distortion` is how many terms are free: 0, 1 (k1), 2 (k2), 4 (p1, p2) or 5 (k3); others are held at 0. Raises
    DataError where the pictures are too few, or show the board from one side.
    """
    _check_count(views, len(sizes))
    terms = {0: (), 1: (4,), 2: (4, 5), 4: (4, 5, 7, 8), 5: (4, 5, 6, 7, 8)}[distortion]
    problem, x = _begun(views, target, sizes, (0, 1, 2, 3, *terms))
    if (tilt := _tilt_deg(problem.poses(x))) < FEWEST_TILT_DEG:
        raise DataError(
            f"all pictures show the board from one side: its normals lie within {tilt:.0f} deg, which leaves focal "
            f"length and distance undetermined; tilt it by 30 deg and more each way"
        )
    inliers: list[BoolArray] = [np.ones(len(s.numbers), dtype=bool) for view in views for s in view if s is not None]
    # So large that normal errors lose any point in one of a hundred calibrations (Bonferroni); the chi-square of two.
    gate = math.sqrt(2 * math.log(sum(map(len, inliers)) / SIGNIFICANCE))
    for _ in range(ROUNDS):
        if target.circle_m:
            problem = problem._replace(views=_centred(problem, x, views, target.circle_m))
        x = problem.adjusted(x, inliers)
        off = problem.misses(x)
        scale = robust_scatter(_inlying(off, inliers), 0.0) + 1e-9
        now: list[BoolArray] = [np.asarray(np.linalg.norm(part, axis=1) < gate * scale) for part in off]
        same = all((a == b).all() for a, b in zip(now, inliers, strict=True))
        inliers = now
        if same and not target.circle_m:
            break
    else:
        x = problem.adjusted(x, inliers)
    return _finished(problem, x, inliers)


def _check_count(views: Sequence[BoardView], cameras: int) -> None:
    sides = ("left ", "right ") if cameras > 1 else ("",)
    counts = {f"{side}pictures": sum(v[k] is not None for v in views) for k, side in enumerate(sides)}
    counts["moments of both cameras"] = sum(None not in view for view in views)
    few = (f"{count} {what}; {FEWEST_VIEWS} or more" for what, count in counts.items() if count < FEWEST_VIEWS)
    hint = "better 12; a chessboard's size is that of its inner corners, squares less one each way"
    refuse((f"the board was found in {one} are needed, {hint}" for one in few), "", DataError)


def _tilt_deg(poses: FloatArray) -> float:
    """Angle between the farthest normals of the board at poses (m, 6)."""
    normals = rotation_of(poses[:, :3])[..., 2]
    return math.degrees(math.acos(float(np.clip((normals @ normals.T).min(), -1, 1))))


def _begun(
    views: Sequence[BoardView], target: BoardTarget, sizes: Sequence[tuple[int, int]], free: tuple[int, ...]
) -> tuple[_Adjustment, FloatArray]:
    """Where the adjustment begins: each camera alone, by OpenCV; how they stand to each other by the median."""
    names = ("left camera", "right camera") if len(sizes) > 1 else ("camera",)
    alone = [_alone(views, k, target, size, names[k], free) for k, size in enumerate(sizes)]
    cameras, poses = tuple(camera for camera, _ in alone), alone[0][1]
    relative = []
    if len(sizes) > 1:
        others = alone[1][1]
        both = sorted(poses.keys() & others.keys())
        first, second = (np.array([side[k] for k in both]) for side in (poses, others))
        turns = rotation_of(second[:, :3]) @ rotation_of(first[:, :3]).swapaxes(1, 2)
        apart = [np.linalg.norm(vector_of(turns.swapaxes(1, 2) @ turn), axis=1).sum() for turn in turns]
        turn = turns[int(np.argmin(apart))]
        way = np.median(second[:, 3:] - first[:, 3:] @ turn.T, axis=0)
        relative = [vector_of(turn), way]
        alone_right = {k: np.append(vector_of(turn.T @ rotation_of(one[:3])), turn.T @ (one[3:] - way))
                       for k, one in others.items()}  # fmt: skip
        poses = alone_right | poses
    problem = _Adjustment(cameras, free, target.points_m, tuple(views))
    lenses = [camera.vector()[list(free)] for camera in cameras]
    return problem, np.concatenate([*lenses, *relative, *(poses[k] for k in range(len(views)))])


def _alone(
    views: Sequence[BoardView], index: int, target: BoardTarget, size: tuple[int, int], name: str, free: tuple[int, ...]
) -> tuple[Camera, dict[int, FloatArray]]:
    """One camera by OpenCV, and the board's pose in its frame by moment."""
    sightings = {k: sighting for k, view in enumerate(views) if (sighting := view[index]) is not None}
    points = [target.points_m[s.numbers].astype(np.float32) for s in sightings.values()]
    pixels = [s.pixels.astype(np.float32) for s in sightings.values()]
    flags = cv2.CALIB_FIX_K3 | (0 if 5 in free else cv2.CALIB_FIX_K2) | (0 if 4 in free else cv2.CALIB_FIX_K1)
    flags |= 0 if 7 in free else cv2.CALIB_ZERO_TANGENT_DIST
    _, matrix, terms, turns, places = cv2.calibrateCamera(points, pixels, size, None, None, flags=flags)
    k1, k2, p1, p2 = np.ravel(terms)[:4]
    vector = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], k1, k2, 0.0, p1, p2]
    camera = Camera(name=name, width_px=size[0], height_px=size[1], fx_px=1, fy_px=1, cx_px=0, cy_px=0)
    poses = np.concatenate([np.array(turns), np.array(places)], axis=1)[..., 0]
    return camera.with_vector(vector), dict(zip(sightings, poses, strict=True))


def _centred(
    problem: _Adjustment, x: FloatArray, views: Sequence[BoardView], diameter_m: float
) -> tuple[BoardView, ...]:
    """Sightings of circles moved from the middles of their pictures to the pictures of their middles.

    A circle's picture is an ellipse whose middle is not that of the circle (Heikkila 2000, 10.1109/34.879788).
    """
    turns = np.linspace(0, 2 * np.pi, RIM, endpoint=False)
    ring = 0.5 * diameter_m * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(RIM)])
    moved = [list(view) for view in views]
    for one in problem.placed(x):
        places = problem.points[one.sighting.numbers]
        both = np.concatenate([places[:, None] + ring, places[:, None]], axis=1)
        seen = one.camera.project_with_derivatives(both.reshape(-1, 3), one.turn, one.way)
        pixels = seen.pixels.reshape(len(places), -1, 2)
        given = views[one.moment][one.side]
        shift = _middle(pixels[:, :-1]) - pixels[:, -1]
        moved[one.moment][one.side] = given and Sighting(given.numbers, given.pixels - shift)
    return tuple(map(tuple, moved))


def _middle(rims: FloatArray) -> FloatArray:
    """Centres of area of closed lines. (n, rim, 2) to (n, 2)"""
    start = rims[:, :1]
    (x, y), (p, q) = np.moveaxis(rims - start, -1, 0), np.moveaxis(np.roll(rims, -1, axis=1) - start, -1, 0)
    area = x * q - p * y
    sums = [((x + p) * area).sum(axis=1), ((y + q) * area).sum(axis=1)]
    return np.asarray(start[:, 0] + np.stack(sums, axis=-1) / (3 * area.sum(axis=1))[:, None])


def _finished(problem: _Adjustment, x: FloatArray, inliers: Sequence[BoolArray]) -> CameraCalibration:
    """The calibration with its errors, at adjusted parameters."""
    off, slopes, cameras = problem.misses(x), problem.slopes(x, inliers), problem.cameras(x)
    misses = _inlying(off, inliers).ravel()
    variance = float(misses @ misses) / max(len(misses) - len(x), 1)
    placed = list(problem.placed(x))
    moments = np.repeat([one.moment for one in placed], [2 * int(good.sum()) for good in inliers])
    between = _between_pictures(problem, misses, slopes, moments, variance)
    inverse = np.asarray(np.linalg.inv(slopes.T @ slopes)[: problem.shared, : problem.shared], dtype=float)
    residuals = [np.column_stack([np.full(int(good.sum()), one.moment), one.sighting.pixels[good], part[good]])
                 for one, part, good in zip(placed, off, inliers, strict=True)]  # fmt: skip
    relative = problem.relative(x)
    return CameraCalibration(
        cameras=tuple(cameras),
        rotation=rotation_of(relative[:3]),
        translation_m=relative[3:],
        covariance=_whole(problem, x, inverse * variance * max(between, 1.0) ** 2),
        residual_px=math.sqrt(variance),
        between_pictures=between,
        residuals=tuple(
            np.concatenate([rows for one, rows in zip(placed, residuals, strict=True) if one.side == index])
            for index in range(len(cameras))
        ),
        left_out=int(sum((~good).sum() for good in inliers)),
        poses=problem.poses(x),
        tilt_deg=_tilt_deg(problem.poses(x)),
    )


def _between_pictures(
    problem: _Adjustment, misses: FloatArray, slopes: FloatArray, moments: npt.NDArray[np.int64], variance: float
) -> float:
    """Errors of the shared parameters by leaving out one moment at a time, over those by the residuals.

    With g_k the gradient of a moment after its pose is eliminated, H_k its normal matrix and H their sum, the sum of
    g_k^T H^-1 g_k has the mean s^2 sum tr(A_k - A_k^2), A_k = H^-1 H_k, where points are independent: the jackknife of
    clusters (Bell & McCaffrey 2002, Surv. Methodol. 28, 169) to first order.
    """
    count = problem.shared
    gradients, normals = [], []
    for k in np.unique(moments):
        rows = moments == k
        basis = np.linalg.qr(slopes[rows][:, count + 6 * k : count + 6 * k + 6])[0]
        shared = slopes[rows][:, :count]
        shared = shared - basis @ (basis.T @ shared)
        gradients.append(shared.T @ misses[rows])
        normals.append(shared.T @ shared)
    inverse = np.linalg.inv(np.sum(normals, axis=0))
    shares = inverse @ np.array(normals)
    expected = variance * np.trace(shares - shares @ shares, axis1=1, axis2=2).sum()
    return math.sqrt(sum(float(g @ inverse @ g) for g in gradients) / max(float(expected), 1e-300))


def _whole(problem: _Adjustment, x: FloatArray, covariance: FloatArray) -> FloatArray:
    """The covariance with zeros for what was held, its rotation a small one after the relative one."""
    width, cameras = len(INTRINSICS), len(problem.plain)
    places = [k * width + free for k in range(cameras) for free in problem.free]
    whole = np.zeros((cameras * width + (6 if cameras > 1 else 0),) * 2)
    if cameras > 1:
        places += range(cameras * width, len(whole))
        by_small = cv2.composeRT(problem.relative(x)[:3], np.zeros(3), np.zeros(3), np.zeros(3))[4]
        small = np.eye(len(covariance))
        small[problem.lenses : problem.lenses + 3, problem.lenses : problem.lenses + 3] = np.linalg.inv(by_small)
        covariance = small @ covariance @ small.T
    whole[np.ix_(places, places)] = covariance
    return whole


def pictures_matching(patterns: Sequence[str], what: str = "pictures") -> list[str]:
    """Files that patterns match, in the order of their names, and all files of folders. Raises RequestError."""
    try:
        return expand_inputs(patterns, all_files=True)
    except NoFilesError as error:
        raise RequestError(f"`{what}` {error}; put a pattern in quotes") from error


def of_moments(left: Sequence[Shown], right: Sequence[Shown]) -> tuple[list[Shown], list[Shown]]:
    """Pictures of both cameras with their partners.

    Where the last number in a name tells pictures of each side apart, and both sides have such a number in common, they
    belong together by it, and pictures without a partner are left out with a warning; else by their order. Raises
    RequestError where that leaves some over.
    """
    sides = [{_number(_name(one)): one for one in side} for side in (left, right)]
    common = [number for number in sides[0] if number and number in sides[1]]
    if common and [len(side) for side in sides] == [len(left), len(right)]:
        over = [_name(one) for side in sides for number, one in side.items() if number not in common]
        if over:
            note = f"no partner of the other camera, left out: {some_of(over, 4)}"
            warnings.warn(note, LunarSciWarning, stacklevel=3)
        return [sides[0][number] for number in common], [sides[1][number] for number in common]
    if len(left) != len(right):
        raise RequestError(f"{len(left)} pictures and {len(right)} of `right`; give one of each moment, in order")
    return list(left), list(right)


def _name(picture: Shown) -> str:
    return picture.name if isinstance(picture, InputFile) else str(picture)


def _number(name: str) -> str:
    """The last number in a name, without what counts cameras (cam0, cam1); '' where there is none.

    >>> _number("left07.png"), _number("cam1_0007.png"), _number("12_L.png")
    ('7', '7', '12')
    """
    stem = re.sub(r"(?i)cam(?:era)?[_-]?[01](?![0-9])", "", Path(name).stem)
    return next((digits.lstrip("0") or "0" for digits in reversed(re.findall(r"\d+", stem))), "")
