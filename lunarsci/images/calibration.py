"""Cameras, and how they stand to each other, from pictures of a flat target: least squares over all of them at once.

Zhang (2000), 10.1109/34.888718, for the idea and where it begins (OpenCV); the adjustment, its errors and what the
pictures do not determine are here. Every picture has a pose of the board of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.images.camera import INTRINSICS, Camera, rotation_of, vector_of
from lunarsci.images.pictures import open_cv
from lunarsci.images.targets import BoardTarget, Sighting

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
