"""Cameras, and how they stand to each other, from pictures of a flat target: least squares over all of them at once.

Which points of the board are seen where, and which pictures of two cameras are of the same moment. Zhang (2000),
10.1109/34.888718, for the idea and where it begins (OpenCV); the adjustment, its errors and what the pictures do not
determine are here. Every picture has a pose of the board of its own.
"""

import math
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, LunarSciWarning, NoFilesError, ParameterError, RequestError
from lunarsci.images.camera import INTRINSICS, Camera, rotation_of, vector_of
from lunarsci.images.pictures import Picture, open_cv
from lunarsci.io.inputs import InputFile, expand_inputs
from lunarsci.names import one_of, some_of

Kind = Literal["chessboard", "circles", "asymmetric-circles", "charuco"]
GOES_ON = 0.75
"""Contrast of squares beyond a board, over that within, from which it is larger than stated; the outer edge of the
outer squares has half of it. Assumed."""
NEAR = 0.4
"""Half width of the window about a corner, as a share of the distance to the next; assumed."""
FEWEST_POINTS = 6
"""Points of a board that a picture must show; assumed."""


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
        if self.kind not in get_args(Kind):
            raise ParameterError(f"'{self.kind}' is no kind of target; {one_of(self.kind, get_args(Kind))}")
        if min(self.columns, self.rows) < 3 or max(self.columns, self.rows) > 100:
            raise ParameterError(f"a board of {self.columns} x {self.rows}; give 3 to 100 each way")
        if not 0 < self.square_m < 100:
            raise ParameterError(f"squares of {self.square_m:g} m; give a number above 0")
        if self.kind == "charuco" and not 0 < self.marker_m < self.square_m:
            raise ParameterError("markers of a charuco board are smaller than its squares; give their side in m")
        if not 0 <= self.circle_m < 2 * self.square_m:
            raise ParameterError(f"circles of {self.circle_m:g} m do not fit between centres {self.square_m:g} m apart")

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
        markers = open_cv().aruco
        if not hasattr(markers, self.dictionary):
            raise ParameterError(f"'{self.dictionary}' is no dictionary of markers; one is DICT_4X4_50")
        words = markers.getPredefinedDictionary(getattr(markers, self.dictionary))
        return markers.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, words)

    def __str__(self) -> str:
        return f"{self.kind} of {self.columns} x {self.rows}"


class Sighting(NamedTuple):
    """Points of a target in a picture: their places in `BoardTarget.points_m` (n,), and where they are (n, 2) [px]."""

    numbers: npt.NDArray[np.int64]
    pixels: FloatArray


def find_target(picture: Picture, target: BoardTarget, *, patient: bool = True) -> Sighting | None:
    """Where a picture shows the points of a target; None where it does not. `patient` looks for seconds."""
    eight = eight_bits(picture)
    if target.kind == "charuco":
        return _charuco(eight, target)
    size = target.columns, target.rows
    pixels = _chessboard(eight, size, patient) if target.kind == "chessboard" else _circles(eight, target)
    if pixels is None:
        return None
    return Sighting(np.arange(len(pixels)), pixels)


def eight_bits(picture: Picture) -> npt.NDArray[np.uint8]:
    """A picture from black to its brightest in 8 bits. (h, w)"""
    low, high = np.percentile(picture.values, [0.5, 99.5])
    return np.asarray(np.clip(255 * (picture.values - low) / max(high - low, 1e-9), 0, 255), dtype=np.uint8)


def _chessboard(eight: npt.NDArray[np.uint8], size: tuple[int, int], patient: bool) -> FloatArray | None:
    """Corners by the sectors about them (Duda & Frese 2018, Br. Mach. Vis. Conf.), then by the gradients there.

    Gradients (Foerstner & Guelch 1987, ISPRS Intercomm. Conf. Fast Process. Photogramm. Data) are three times as
    precise on tilted boards, and without bias.
    """
    cv2 = open_cv()
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    flags |= cv2.CALIB_CB_EXHAUSTIVE if patient else 0
    found, corners = cv2.findChessboardCornersSB(eight, size, flags=flags)
    if not found:
        return None
    start = np.asarray(corners, dtype=np.float32).reshape(size[1], size[0], 2)
    apart = min(float(np.linalg.norm(np.diff(start, axis=axis), axis=-1).min()) for axis in (0, 1))
    half = (max(2, int(NEAR * apart)),) * 2
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    return np.asarray(cv2.cornerSubPix(eight, start.reshape(-1, 1, 2), half, (-1, -1), stop), float).reshape(-1, 2)


def _circles(eight: npt.NDArray[np.uint8], target: BoardTarget) -> FloatArray | None:
    cv2 = open_cv()
    wanted = cv2.SimpleBlobDetector_Params()
    wanted.minArea, wanted.maxArea, wanted.minThreshold, wanted.thresholdStep = 12.0, 0.05 * eight.size, 20.0, 5.0
    blobs = cv2.SimpleBlobDetector_create(wanted)
    grid = cv2.CALIB_CB_SYMMETRIC_GRID if target.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
    found, centers = cv2.findCirclesGrid(eight, (target.columns, target.rows), flags=grid, blobDetector=blobs)
    return np.asarray(centers, dtype=float).reshape(-1, 2) if found else None


def _charuco(eight: npt.NDArray[np.uint8], target: BoardTarget) -> Sighting | None:
    cv2 = open_cv()
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(target.charuco()).detectBoard(eight)
    if numbers is None or len(numbers) < FEWEST_POINTS:
        return None
    return Sighting(np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2))


def alike_turned(left: Sighting, right: Sighting) -> Sighting:
    """The right picture's sighting numbered as the left one's: a board that looks alike upside down may be turned."""
    ways = [s.pixels[-1] - s.pixels[0] for s in (left, right)]
    return right if float(ways[0] @ ways[1]) >= 0 else Sighting(right.numbers, right.pixels[::-1])


def check_board(pictures: Sequence[Picture], seen: Sequence[Sighting | None], target: BoardTarget) -> None:
    """Raise DataError where the board of some pictures is not as large as stated, as far as that can be told."""
    if target.kind != "chessboard":
        return
    size = target.columns, target.rows
    known = [(eight_bits(p), s.pixels) for p, s in zip(pictures, seen, strict=True) if s is not None]
    beyond = Counter(side for eight, pixels in known for side in _goes_on(eight, pixels, size))
    often = [side for side, count in beyond.items() if count > 0.5 * len(known)]
    if often:
        raise DataError(f"the chessboard goes on {' and '.join(often)} beyond {size[0]} x {size[1]}; {INNER}")
    if len(known) > 0.5 * len(pictures):
        return
    without = [p for p, s in zip(pictures, seen, strict=True) if s is None]
    for picture in without[:2]:
        if other := _other_size(picture, size):
            raise DataError(
                f"{picture.source.name}: shows a chessboard of {other[0]} x {other[1]}, "
                f"not {size[0]} x {size[1]}; {INNER}"
            )


INNER = "a chessboard's size is that of its inner corners, squares less one each way"


def _goes_on(eight: npt.NDArray[np.uint8], pixels: FloatArray, size: tuple[int, int]) -> list[str]:
    """Sides at which squares alternate beyond the corners that were found."""
    cv2 = open_cv()
    columns, rows = size
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    plane = cv2.findHomography(np.stack([column.ravel(), row.ravel()], axis=-1), pixels.astype(np.float32))[0]

    def contrast(columns_at: FloatArray, rows_at: FloatArray) -> FloatArray:
        at = np.stack([columns_at + 0.0, rows_at + 0.0], axis=-1)[:, None] + 0.25 * np.array(
            [[1, 1], [-1, 1], [-1, -1], [1, -1]]
        )
        there = cv2.perspectiveTransform(at.reshape(1, -1, 2).astype(np.float32), plane).reshape(-1, 2)
        light = cv2.remap(eight.astype(np.float32), there[:, 0], there[:, 1], cv2.INTER_LINEAR, borderValue=np.nan)
        signs = np.where((columns_at + rows_at) % 2 == 0, 1.0, -1.0)
        return np.asarray(signs * (light.reshape(-1, 4) @ np.array([1.0, -1.0, 1.0, -1.0])))

    within = float(np.median(contrast(column.ravel().astype(float), row.ravel().astype(float))))
    across, down = np.arange(columns, dtype=float), np.arange(rows, dtype=float)
    sides = {
        "left of it": (np.full(rows, -1.0), down),
        "right of it": (np.full(rows, float(columns)), down),
        "above it": (across, np.full(columns, -1.0)),
        "below it": (across, np.full(columns, float(rows))),
    }
    means = {side: float(np.median(contrast(*places))) for side, places in sides.items()}
    return [side for side, mean in means.items() if math.isfinite(mean) and mean / within > GOES_ON]


def _other_size(picture: Picture, size: tuple[int, int]) -> tuple[int, int] | None:
    """The largest chessboard near a size that a picture shows."""
    eight = eight_bits(picture)
    tries = [(size[0] + a, size[1] + b) for a, b in product((2, 1, 0, -1, -2), repeat=2)]
    for other in sorted((t for t in tries if min(t) >= 3 and t != size), key=lambda t: -t[0] * t[1]):
        if _chessboard(eight, other, False) is not None:
            return other
    return None


FEWEST_VIEWS = 4
"""Pictures below which nothing is calibrated: three determine a planar problem (Zhang 2000), a fourth tests it."""
FEWEST_TILT_DEG = 10.0
"""Angle between the farthest normals of the board below which focal length and distance are the same; assumed."""
OUTLYING = 5.0
"""Points that are farther off, in robust standard deviations, are left out; assumed."""
ROUNDS = 3
"""How often outliers are left out and all is adjusted again, at most; assumed."""
RIM = 24
"""Places on the rim of a circle from which the middle of its picture is found; assumed."""


class BoardView(NamedTuple):
    """One moment: what each camera sees of the board; None where it does not."""

    sightings: tuple[Sighting | None, ...]


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
        """By how much intrinsics leave directions uncertain at pixels (n, 2), what a turn mends apart. (n,) [px]"""
        camera = self.cameras[index]
        first = index * len(INTRINSICS)
        own = self.covariance[first : first + len(INTRINSICS), first : first + len(INTRINSICS)]
        made = camera.project_with_derivatives(camera.rays(pixels))
        turned = (made.by_point @ _crossed(camera.rays(pixels))).reshape(-1, 3)
        change = made.by_intrinsics.reshape(-1, len(INTRINSICS))
        change = change - turned @ np.linalg.lstsq(turned, change, rcond=None)[0]
        variance = np.einsum("ni,ij,nj->n", change, own, change)
        return np.asarray(np.sqrt(variance.reshape(-1, 2).sum(axis=1)))


class _Adjustment(NamedTuple):
    """What is adjusted: free intrinsics, whether there are two cameras, points, and what each camera sees of them."""

    plain: tuple[Camera, ...]
    rotation: FloatArray
    free: tuple[int, ...]
    points: FloatArray
    views: tuple[BoardView, ...]

    @property
    def shared(self) -> int:
        return len(self.plain) * len(self.free) + (6 if len(self.plain) > 1 else 0)

    def unpacked(self, x: FloatArray) -> tuple[list[Camera], FloatArray, FloatArray, FloatArray]:
        """Cameras, rotation and translation between them, and poses (m, 6)."""
        count, cameras = len(self.free), []
        for k, camera in enumerate(self.plain):
            vector = camera.vector()
            vector[list(self.free)] = x[k * count : (k + 1) * count]
            cameras.append(camera.with_vector(vector))
        relative = x[len(self.plain) * count : self.shared] if len(self.plain) > 1 else np.zeros(6)
        return cameras, rotation_of(relative[:3]) @ self.rotation, relative[3:], x[self.shared :].reshape(-1, 6)


def calibrate(
    views: Sequence[BoardView], target: BoardTarget, sizes: Sequence[tuple[int, int]], *, distortion: int = 5
) -> CameraCalibration:
    """Cameras of sizes (width, height) [px] from what they see of a target; one size, or left and right.

    `distortion` is how many terms are found: 0, 1 (k1), 2 (k2), 4 (p1, p2) or 5 (k3); others are held at 0. Raises
    DataError where the pictures are too few, or show the board from one side.
    """
    _check_count(views, len(sizes))
    terms = {0: (), 1: (4,), 2: (4, 5), 4: (4, 5, 7, 8), 5: (4, 5, 6, 7, 8)}[distortion]
    problem, x = _begun(views, target, sizes, (0, 1, 2, 3, *terms))
    _check_tilt(problem.unpacked(x)[3])
    seen = [s for view in views for s in view.sightings if s is not None]
    kept: list[BoolArray] = [np.ones(len(s.numbers), dtype=bool) for s in seen]
    for _ in range(ROUNDS):
        if target.circle_m:
            problem = problem._replace(views=_centred(problem, x, views, target.circle_m))
        x = _adjusted(problem, x, kept)
        off = _misses(problem, x)
        scale = 1.4826 * float(np.median(np.abs(np.concatenate(off)[np.concatenate(kept)]))) + 1e-9
        now: list[BoolArray] = [np.asarray((np.abs(part) < OUTLYING * scale).all(axis=1)) for part in off]
        if all((a == b).all() for a, b in zip(now, kept, strict=True)) and not target.circle_m:
            break
        kept = now
    return _finished(problem, _adjusted(problem, x, kept), kept)


def _check_count(views: Sequence[BoardView], cameras: int) -> None:
    for index in range(cameras):
        count = sum(view.sightings[index] is not None for view in views)
        if count < FEWEST_VIEWS:
            side = ("left", "right")[index] + " " if cameras > 1 else ""
            raise DataError(
                f"the board was found in {count} {side}pictures; {FEWEST_VIEWS} or more are needed, better 12"
            )
    both = sum(all(s is not None for s in view.sightings) for view in views)
    if both < FEWEST_VIEWS:
        raise DataError(f"both cameras see the board at {both} moments; {FEWEST_VIEWS} or more are needed")


def _check_tilt(poses: FloatArray) -> None:
    if (tilt := _tilt_deg(poses)) < FEWEST_TILT_DEG:
        raise DataError(
            f"all pictures show the board from one side: its normals lie within {tilt:.0f} deg, which leaves focal "
            f"length and distance undetermined; tilt it by 30 deg and more each way"
        )


def _tilt_deg(poses: FloatArray) -> float:
    normals = np.array([rotation_of(pose[:3])[:, 2] for pose in poses])
    return math.degrees(math.acos(float(np.clip((normals @ normals.T).min(), -1, 1))))


def _begun(
    views: Sequence[BoardView], target: BoardTarget, sizes: Sequence[tuple[int, int]], free: tuple[int, ...]
) -> tuple[_Adjustment, FloatArray]:
    """Where the adjustment begins: each camera alone, by OpenCV; how they stand to each other by the median."""
    names = ("left camera", "right camera") if len(sizes) > 1 else ("camera",)
    alone = [_alone(views, k, target, size, names[k], free) for k, size in enumerate(sizes)]
    cameras = tuple(camera for camera, _ in alone)
    rotation, translation = np.eye(3), np.zeros(3)
    if len(sizes) > 1:
        pairs = [(alone[0][1][k], alone[1][1][k]) for k in alone[0][1].keys() & alone[1][1].keys()]
        turns = [rotation_of(b[:3]) @ rotation_of(a[:3]).T for a, b in pairs]
        rotation = _median_turn(turns)
        translation = np.median([b[3:] - rotation @ a[3:] for a, b in pairs], axis=0)
    poses = []
    for k in range(len(views)):
        if k in alone[0][1]:
            poses.append(alone[0][1][k])
        else:
            seen = alone[1][1][k]
            turn = rotation.T @ rotation_of(seen[:3])
            poses.append(np.concatenate([vector_of(turn), rotation.T @ (seen[3:] - translation)]))
    problem = _Adjustment(cameras, rotation, free, target.points_m, tuple(views))
    own = [camera.vector()[list(free)] for camera in cameras]
    relative = [np.concatenate([np.zeros(3), translation])] if len(sizes) > 1 else []
    return problem, np.concatenate([*own, *relative, np.ravel(poses)])


def _median_turn(turns: Sequence[FloatArray]) -> FloatArray:
    """The rotation that is nearest to all others."""
    apart = [sum(float(np.linalg.norm(vector_of(a.T @ b))) for b in turns) for a in turns]
    return turns[int(np.argmin(apart))]


def _alone(
    views: Sequence[BoardView], index: int, target: BoardTarget, size: tuple[int, int], name: str, free: tuple[int, ...]
) -> tuple[Camera, dict[int, FloatArray]]:
    """One camera by OpenCV, and the board's pose in its frame by moment."""
    cv2 = open_cv()
    seen = {k: sighting for k, view in enumerate(views) if (sighting := view.sightings[index]) is not None}
    points = [target.points_m[s.numbers].astype(np.float32) for s in seen.values()]
    pixels = [s.pixels.astype(np.float32) for s in seen.values()]
    flags = cv2.CALIB_FIX_K3 | (0 if 5 in free else cv2.CALIB_FIX_K2) | (0 if 4 in free else cv2.CALIB_FIX_K1)
    flags |= 0 if 7 in free else cv2.CALIB_ZERO_TANGENT_DIST
    _, matrix, terms, turns, places = cv2.calibrateCamera(points, pixels, size, None, None, flags=flags)
    k1, k2, p1, p2 = (float(v) for v in np.ravel(terms)[:4])
    camera = Camera(
        name=name, width_px=size[0], height_px=size[1], fx_px=float(matrix[0, 0]), fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]), cy_px=float(matrix[1, 2]), k1=k1, k2=k2, p1=p1, p2=p2,
    )  # fmt: skip
    found = zip(seen, turns, places, strict=True)
    return camera, {k: np.concatenate([np.ravel(turn), np.ravel(place)]) for k, turn, place in found}


def _crossed(points: FloatArray) -> FloatArray:
    """Derivatives of points by a small rotation after them. (n, 3) to (n, 3, 3)"""
    x, y, z = np.moveaxis(points, -1, 0)
    zero = np.zeros_like(x)
    rows = (zero, z, -y), (-z, zero, x), (y, -x, zero)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _seen(problem: _Adjustment, x: FloatArray) -> "list[tuple[int, int, Sighting, Camera, FloatArray, FloatArray]]":
    """By sighting: moment, camera's index, sighting, camera, points in its frame, and points less the board's place."""
    cameras, rotation, translation, poses = problem.unpacked(x)
    found = []
    for k, view in enumerate(problem.views):
        turn = rotation_of(poses[k, :3])
        for index, sighting in enumerate(view.sightings):
            if sighting is None:
                continue
            turned = problem.points[sighting.numbers] @ turn.T
            there = turned + poses[k, 3:]
            own = there if index == 0 else there @ rotation.T + translation
            found.append((k, index, sighting, cameras[index], own, turned))
    return found


def _misses(problem: _Adjustment, x: FloatArray) -> list[FloatArray]:
    """What is left of each sighting. (n, 2) [px]"""
    return [camera.project(own) - s.pixels for _, _, s, camera, own, _ in _seen(problem, x)]


def _rows(problem: _Adjustment, x: FloatArray, kept: Sequence[BoolArray]) -> tuple[FloatArray, FloatArray, list[int]]:
    """Residuals (n,), their derivatives (n, parameters), and the moment of each row."""
    _, rotation, translation, _ = problem.unpacked(x)
    count, misses, slopes, moments = len(problem.free), [], [], []
    for (k, index, sighting, camera, own, turned), good in zip(_seen(problem, x), kept, strict=True):
        made = camera.project_with_derivatives(own)
        block = np.zeros((*made.pixels.shape, len(x)))
        block[..., index * count : (index + 1) * count] = made.by_intrinsics[..., problem.free]
        by_there = made.by_point if index == 0 else made.by_point @ rotation
        place = problem.shared + 6 * k
        block[..., place : place + 3] = by_there @ _crossed(turned)
        block[..., place + 3 : place + 6] = by_there
        if index:
            first = len(problem.plain) * count
            block[..., first : first + 3] = made.by_point @ _crossed(own - translation)
            block[..., first + 3 : first + 6] = made.by_point
        misses.append((made.pixels - sighting.pixels)[good].ravel())
        slopes.append(block[good].reshape(-1, len(x)))
        moments += [k] * (2 * int(good.sum()))
    return np.nan_to_num(np.concatenate(misses), nan=1e4), np.nan_to_num(np.concatenate(slopes)), moments


def _adjusted(problem: _Adjustment, x: FloatArray, kept: Sequence[BoolArray]) -> FloatArray:
    """Levenberg-Marquardt; small rotations are laid onto the whole ones after each step."""
    damping, now = 1e-3, _rows(problem, x, kept)
    for _ in range(60):
        normal, side = now[1].T @ now[1], now[1].T @ now[0]
        step = np.asarray(-np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), side), float)
        other = _stepped(problem, x, step)
        try:
            then = _rows(problem, other, kept)
        except ValueError:
            then = (np.full(1, np.inf), now[1], now[2])
        gain = float(now[0] @ now[0] - then[0] @ then[0])
        if not gain >= 0:
            damping *= 10
            if damping > 1e8:
                break
            continue
        damping, x, small = max(0.1 * damping, 1e-12), other, gain <= 1e-12 * float(then[0] @ then[0]) + 1e-18
        now = then
        if small:
            break
    return x


def _stepped(problem: _Adjustment, x: FloatArray, step: FloatArray) -> FloatArray:
    """Parameters after a step; rotations are small ones applied after those that were there."""
    after = x + step
    first = len(problem.plain) * len(problem.free)
    places = [*([first] if len(problem.plain) > 1 else []), *range(problem.shared, len(x), 6)]
    for place in places:
        part = slice(place, place + 3)
        after[part] = vector_of(rotation_of(step[part]) @ rotation_of(x[part]))
    return after


def _centred(
    problem: _Adjustment, x: FloatArray, views: Sequence[BoardView], diameter_m: float
) -> tuple[BoardView, ...]:
    """Sightings of circles moved from the middles of their pictures to the pictures of their middles.

    A circle's picture is an ellipse whose middle is not that of the circle (Heikkila 2000, 10.1109/34.879788).
    """
    turns = np.linspace(0, 2 * np.pi, RIM, endpoint=False)
    ring = 0.5 * diameter_m * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(RIM)])
    cameras, rotation, translation, poses = problem.unpacked(x)
    moved = []
    for k, view in enumerate(views):
        turn = rotation_of(poses[k, :3])
        found: list[Sighting | None] = []
        for index, sighting in enumerate(view.sightings):
            if sighting is None:
                found.append(None)
                continue
            places = problem.points[sighting.numbers]
            rims = (places[:, None] + ring) @ turn.T + poses[k, 3:]
            both = np.concatenate([rims, (places @ turn.T + poses[k, 3:])[:, None]], axis=1)
            pixels = cameras[index].project(both if index == 0 else both @ rotation.T + translation)
            shift = _middle(pixels[:, :-1]) - pixels[:, -1]
            found.append(Sighting(sighting.numbers, sighting.pixels - shift))
        moved.append(BoardView(tuple(found)))
    return tuple(moved)


def _middle(rims: FloatArray) -> FloatArray:
    """Centres of area of closed lines. (n, rim, 2) to (n, 2)"""
    start = rims[:, :1]
    (x, y), (p, q) = np.moveaxis(rims - start, -1, 0), np.moveaxis(np.roll(rims, -1, axis=1) - start, -1, 0)
    area = x * q - p * y
    total = 3 * area.sum(axis=1)
    sums = [((x + p) * area).sum(axis=1), ((y + q) * area).sum(axis=1)]
    return np.asarray(start[:, 0] + np.stack(sums, axis=-1) / total[:, None])


def _finished(problem: _Adjustment, x: FloatArray, kept: Sequence[BoolArray]) -> CameraCalibration:
    misses, slopes, moments = _rows(problem, x, kept)
    freedom = max(len(misses) - len(x), 1)
    variance = float(misses @ misses) / freedom
    inverse = np.asarray(np.linalg.inv(slopes.T @ slopes)[: problem.shared, : problem.shared], float)
    between = _between_pictures(problem, misses, slopes, np.array(moments), variance)
    cameras, rotation, translation, poses = problem.unpacked(x)
    left = tuple(
        np.concatenate([
            np.column_stack([np.full(int(good.sum()), k), s.pixels[good], (camera.project(own) - s.pixels)[good]])
            for (k, at, s, camera, own, _), good in zip(_seen(problem, x), kept, strict=True) if at == index
        ]) for index in range(len(cameras))
    )  # fmt: skip
    return CameraCalibration(
        cameras=tuple(cameras),
        rotation=rotation,
        translation_m=translation,
        covariance=_spread_out(problem, inverse * variance * max(between, 1.0) ** 2),
        residual_px=math.sqrt(variance),
        between_pictures=between,
        residuals=left,
        left_out=int(sum((~good).sum() for good in kept)),
        poses=poses,
        tilt_deg=_tilt_deg(poses),
    )


def _between_pictures(
    problem: _Adjustment, misses: FloatArray, slopes: FloatArray, moments: Any, variance: float
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
        own = slopes[rows][:, count + 6 * k : count + 6 * k + 6]
        shared = slopes[rows][:, :count]
        basis = np.linalg.qr(own)[0]
        shared = shared - basis @ (basis.T @ shared)
        gradients.append(shared.T @ misses[rows])
        normals.append(shared.T @ shared)
    inverse = np.linalg.inv(np.sum(normals, axis=0))
    found = sum(float(g @ inverse @ g) for g in gradients)
    shares = [inverse @ normal for normal in normals]
    expected = variance * sum(float(np.trace(a) - np.trace(a @ a)) for a in shares)
    return math.sqrt(found / max(expected, 1e-300))


def _spread_out(problem: _Adjustment, covariance: FloatArray) -> FloatArray:
    """The covariance with zeros for what was held."""
    width, count = len(INTRINSICS), len(problem.free)
    places = [k * width + free for k in range(len(problem.plain)) for free in problem.free]
    places += [len(problem.plain) * width + k for k in range(problem.shared - len(problem.plain) * count)]
    whole = np.zeros((len(problem.plain) * width + (6 if len(problem.plain) > 1 else 0),) * 2)
    whole[np.ix_(places, places)] = covariance
    return whole


Shown: TypeAlias = str | Path | InputFile
"""A picture, by its name or read; it is handed on as it is."""
NAMED = 4
"""Pictures that a warning names."""


def pictures_matching(patterns: Sequence[str], what: str = "pictures") -> list[str]:
    """Files that patterns match, in the order of their names, and all files of folders. Raises RequestError."""
    try:
        return expand_inputs(patterns, all_files=True)
    except NoFilesError as error:
        raise RequestError(f"`{what}` {error}; put a pattern in quotes") from error


def files_of(pictures: str | Sequence[Shown], what: str = "pictures") -> list[Shown]:
    """The same of one pattern; files as they are."""
    return [*pictures_matching([pictures], what)] if isinstance(pictures, str) else list(pictures)


def of_moments(left: Sequence[Shown], right: Sequence[Shown]) -> tuple[list[Shown], list[Shown]]:
    """Pictures of both cameras with their partners.

    Where the last number in a name tells pictures of each side apart, and both sides have such a number in common, they
    belong together by it, and pictures without a partner are left out with a warning; else by their order. Raises
    RequestError where that leaves some over.
    """
    sides = [{_number(one): one for one in side} for side in (left, right)]
    common = [number for number in sides[0] if number and number in sides[1]]
    if common and [len(side) for side in sides] == [len(left), len(right)]:
        over = [_name(one) for side in sides for number, one in side.items() if number not in common]
        if over:
            told = f"no partner of the other camera, left out: {some_of(over, NAMED)}"
            warnings.warn(told, LunarSciWarning, stacklevel=3)
        return [sides[0][number] for number in common], [sides[1][number] for number in common]
    if len(left) != len(right):
        raise RequestError(f"{len(left)} pictures and {len(right)} of `right`; give one of each moment, in order")
    return list(left), list(right)


def _name(picture: Shown) -> str:
    return picture.name if isinstance(picture, InputFile) else str(picture)


def _number(picture: Shown) -> str:
    """The last number in a name, without what counts cameras (cam0, cam1); '' where there is none.

    >>> _number("left07.png"), _number("cam1_0007.png"), _number("12_L.png")
    ('7', '7', '12')
    """
    stem = re.sub(r"(?i)cam(?:era)?[_-]?[01](?![0-9])", "", Path(_name(picture)).stem)
    return next((digits.lstrip("0") or "0" for digits in reversed(re.findall(r"\d+", stem))), "")
