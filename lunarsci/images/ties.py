"""Points that two stations of a rover both see, where one sees the ground from afar and the other from near.

What the nearer station sees is laid into the view of the farther one by its stereo points, where both are alike but for
the light. Features (SIFT, Lowe 2004, 10.1023/B:VISI.0000029664.99615.94) with a rigid motion that most of them
share (MSAC, Torr and Zisserman 2000, 10.1006/cviu.1999.0832) bring them within some pixels, templates to parts of one.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.images.camera import Pose, StereoRig
from lunarsci.images.matching import Rectified, StereoMatches
from lunarsci.images.pictures import open_cv

FARTHEST_M = 25.0
"""Points beyond are not laid into another view; assumed. [m]"""
HIDDEN = 0.02
"""Points are hidden that lie behind the nearest one of a pixel by more than this share of its depth; assumed."""
TEMPLATE_PX = (41, 17)
"""Width and height of what is compared: ground seen from afar is foreshortened; assumed. [px]"""
STEP_PX = (20, 8)
"""Between templates, as wide as half of one so that they share little light; assumed. [px]"""
WIDE_PX, WIDE_STEP_PX = (81, 25), (30, 12)
"""The same where the pose is not known better than by dead reckoning; assumed. [px]"""
OVERLAPPING = TEMPLATE_PX[0] * TEMPLATE_PX[1] / (STEP_PX[0] * STEP_PX[1])
"""How many templates see each pixel: by this the variance of one is larger, since their errors hang together."""
LEAST_CORRELATION = 0.6
"""Templates that agree less are no ties; assumed."""
LOOSE_CORRELATION = 0.45
"""The same where many are searched for one motion, which chance does not share, or where there are few; assumed."""
LIKE = 0.85
"""Largest ratio of the best to the second best distance of features; assumed, Lowe (2004), Int. J. Comput. Vis. 60, 91,
10.1023/B:VISI.0000029664.99615.94, takes 0.8."""
INLIER_PX = 4.0
"""Features that are off by more, on foreshortened ground, do not follow a motion; assumed. [px]"""
LEAST_REACH_PX = 12.0
"""Ties are sought at least so far about their places, however well the pose is known; assumed. [px]"""
TRIALS = 1000
"""Motions of three ties that are tried; assumed. Three of three are inliers with 0.999 where 19 % of the ties are."""
FARTHEST_OFF_M = 1.5
"""Motions that are farther from dead reckoning are not believed; assumed. [m]"""
FEWEST, ENOUGH, FEWEST_OF_ONE_MOTION = 8, 16, 7
"""Fewest templates that a pose is believed of, how many are not sought among loose ones, and fewest ties of a motion
that is tried on them; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Station:
    """A stereo pair, matched, and where dead reckoning puts its left camera.

    Attributes
    ----------
    name : what it is called.
    matches : of its pair.
    pose : of its left camera.
    covariance : of its direction about x, y, z of the world [rad], and of the step from the station before [m]. (6, 6)
    time_s : of the pair; None where it is not known. [s]
    rover : the rover's frame (x ahead, y left, z up) in that of the left camera; None where it is not known.
    """

    name: str
    matches: StereoMatches
    pose: Pose
    covariance: FloatArray
    time_s: float | None = None
    rover: Pose | None = None


class TiePoints(NamedTuple):
    """Points that two stations see.

    near_px, far_px : (u, v) in the left pictures. (n, 2) [px]
    near_disparity, far_disparity : u of the right picture less that of the left one; NaN where unknown. (n,) [px]
    near_sigma, far_sigma : their random errors. (n,) [px]
    covariance : of `far_px`, as the templates say. (n, 2, 2) [px^2]
    correlation : of the templates. (n,)
    """

    near_px: FloatArray
    near_disparity: FloatArray
    near_sigma: FloatArray
    far_px: FloatArray
    far_disparity: FloatArray
    far_sigma: FloatArray
    covariance: FloatArray
    correlation: FloatArray

    def kept(self, rows: BoolArray) -> "TiePoints":
        """Those of some rows."""
        return TiePoints(*(values[rows] for values in self))


class Transferred(NamedTuple):
    """One station's picture in the rectified frame of another.

    light (h, w); seen (h, w); place : rectified (u, v) of the station that it is from, a whole pixel, and apart : how
    far that falls from the middle of the pixel here. (h, w, 2) [px]
    """

    light: npt.NDArray[np.float32]
    seen: BoolArray
    place: FloatArray
    apart: FloatArray


def original_px(frame: Rectified, rig: StereoRig, places: FloatArray, *, right: bool = False) -> FloatArray:
    """Pixels in the picture as it was taken of rectified ones. (..., 2)"""
    flat = (places - np.array(frame.center_px)) / frame.focal_px
    rays = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1) @ frame.turn
    return rig.right.project(rays @ rig.rotation.T) if right else rig.left.project(rays)


def transfer(near: Station, pose: Pose, far: Station, far_pose: Pose) -> Transferred:
    """Lay what the nearer station sees into the view of the farther one: the mean of what falls into a pixel."""
    frame = far.matches.rectified
    known = np.argwhere(np.isfinite(near.matches.disparity) & (near.matches.disparity > 0))
    points = near.matches.rectified.points(near.matches.disparity)[known[:, 0], known[:, 1]]
    good = np.linalg.norm(points, axis=1) < FARTHEST_M
    known, local = known[good], far_pose.to_camera(pose.to_world(points[good])) @ frame.turn.T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = (frame.focal_px * local[:, k] / local[:, 2] + frame.center_px[k] for k in (0, 1))
    height, width = frame.shape
    inside = (local[:, 2] > 0.5) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    known, depth = known[inside], local[inside, 2]
    cell = np.rint(v[inside]).astype(np.int64) * width + np.rint(u[inside]).astype(np.int64)
    nearest = np.full(height * width, np.inf)
    np.minimum.at(nearest, cell, depth)
    front = depth <= (1 + HIDDEN) * nearest[cell]
    return _laid(known[front], cell[front], u[inside][front], v[inside][front], near.matches.left, (height, width))


def _laid(
    known: npt.NDArray[np.int64],
    cell: npt.NDArray[np.int64],
    u: FloatArray,
    v: FloatArray,
    light: FloatArray,
    shape: tuple[int, int],
) -> Transferred:
    """The mean of light, and of each pixel the place that falls nearest to its middle."""
    from scipy.ndimage import gaussian_filter

    def laid(values: FloatArray | None) -> FloatArray:
        total = np.bincount(cell, weights=values, minlength=shape[0] * shape[1])
        return np.asarray(gaussian_filter(total.reshape(shape), 0.7))

    count = laid(None)
    bright = laid(np.sqrt(np.maximum(light[known[:, 0], known[:, 1]], 0.0))) / np.maximum(count, 1e-9)
    off = np.stack([u - cell % shape[1], v - cell // shape[1]], axis=-1)
    # The last one written is the nearest to the middle.
    order = np.argsort(-(off**2).sum(axis=1), kind="stable")
    flat = np.full((shape[0] * shape[1], 4), np.nan)
    flat[cell[order], :2], flat[cell[order], 2:] = known[order, ::-1], off[order]
    place, apart = flat[:, :2].reshape(*shape, 2), flat[:, 2:].reshape(*shape, 2)
    seen = (count > 0.25) & np.isfinite(place[..., 0])
    return Transferred(np.where(seen, bright, 0.0).astype(np.float32), seen, place, apart)


def features(seen: Transferred, far: Station, reach_px: float) -> tuple[FloatArray, FloatArray]:
    """Features that both views have, (u, v) in the transferred and in the true one. (n, 2), (n, 2) [px]"""
    cv2 = open_cv()
    views = seen.light, np.sqrt(np.maximum(far.matches.left, 0.0)).astype(np.float32)
    mask = cv2.erode(seen.seen.astype(np.uint8), np.ones((9, 9), np.uint8))
    around = cv2.dilate(mask, np.ones((2 * int(reach_px) + 1,) * 2, np.uint8))
    sift = cv2.SIFT_create(nfeatures=6000, contrastThreshold=0.01)
    found = [sift.detectAndCompute(_eight(view, m > 0), m) for view, m in zip(views, (mask, around), strict=True)]
    if any(f[1] is None or len(f[1]) < 3 for f in found):
        return np.empty((0, 2)), np.empty((0, 2))
    places = [np.array([key.pt for key in keys]) for keys, _ in found]
    signs = [values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-9) for _, values in found]
    # Of features within reach alone, so that the light of other ground does not count as the second best.
    distance = np.sqrt(np.maximum(2 - 2 * signs[0] @ signs[1].T, 0.0))
    apart = places[0][:, None, :] - places[1][None, :, :]
    distance[(np.abs(apart[..., 0]) > reach_px) | (np.abs(apart[..., 1]) > max(0.4 * reach_px, 8.0))] = 9.0
    best = distance.argmin(axis=1)
    rows = np.arange(len(best))
    first = distance[rows, best]
    distance[rows, best] = 9.0
    good = (first < 9.0) & (first < LIKE * distance.min(axis=1))
    return places[0][good], places[1][best[good]]


def _eight(light: npt.NDArray[np.float32], used: BoolArray) -> npt.NDArray[np.uint8]:
    """Light over its surroundings', with contrast alike all over, in 8 bits."""
    cv2 = open_cv()
    weight = np.maximum(cv2.GaussianBlur(used.astype(np.float32), (0, 0), 12), 1e-3)
    mean = cv2.GaussianBlur(np.where(used, light, 0).astype(np.float32), (0, 0), 12) / weight
    rest = np.where(used, light - mean, 0).astype(np.float32)
    spread = np.sqrt(cv2.GaussianBlur(rest * rest, (0, 0), 12) / weight) + 1e-6
    return np.asarray(np.clip(128 + 45 * rest / spread, 0, 255), dtype=np.uint8)


class RigidMotion(NamedTuple):
    """A rigid motion from the nearer camera's frame into the farther one's, and which ties follow it. (n,)"""

    rotation: FloatArray
    translation_m: FloatArray
    inliers: BoolArray


def rigid_motion(points: FloatArray, rays: FloatArray, focal_px: float, guess: RigidMotion, seed: int) -> RigidMotion:
    """The motion (three ties each, MSAC) that carries most points (n, 3) onto rays (n, 3), z = 1, of the other camera.

    Motions that are farther from the guess than `INLIER_PX` allows by chance are kept out by the ties' own reach.
    """
    cv2 = open_cv()
    random = np.random.default_rng(seed)
    best, least = guess, _cost(points, rays, focal_px, guess)[0]
    for _ in range(TRIALS if len(points) >= 4 else 0):
        chosen = random.choice(len(points), 3, replace=False)
        goals = np.ascontiguousarray(rays[chosen, None, :2])
        starts = np.ascontiguousarray(points[chosen, None])
        _, turns, moves = cv2.solveP3P(starts, goals, np.eye(3), None, flags=cv2.SOLVEPNP_P3P)
        for turn, move in zip(turns, moves, strict=True):
            trial = RigidMotion(cv2.Rodrigues(turn)[0], np.ravel(move), guess.inliers)
            if np.linalg.norm(trial.translation_m - guess.translation_m) > FARTHEST_OFF_M:
                continue
            cost = _cost(points, rays, focal_px, trial)[0]
            if cost < least:
                best, least = trial, cost
    return best._replace(inliers=_cost(points, rays, focal_px, best)[1])


def _cost(points: FloatArray, rays: FloatArray, focal_px: float, motion: RigidMotion) -> tuple[float, BoolArray]:
    moved = points @ motion.rotation.T + motion.translation_m
    with np.errstate(divide="ignore", invalid="ignore"):
        off = focal_px * np.linalg.norm(moved[:, :2] / moved[:, 2:] - rays[:, :2], axis=1)
    off = np.where((moved[:, 2] > 0) & np.isfinite(off), off, np.inf)
    return float(np.minimum(off**2, INLIER_PX**2).sum()), off < INLIER_PX


def templates(
    seen: Transferred,
    near: Station,
    far: Station,
    rig: StereoRig,
    reach_px: tuple[int, int],
    *,
    size_px: tuple[int, int] = TEMPLATE_PX,
    step_px: tuple[int, int] = STEP_PX,
    least: float = LEAST_CORRELATION,
) -> TiePoints:
    """Ties on a grid of the transferred view: where templates of it agree best with the true one."""
    cv2 = open_cv()
    truth = np.sqrt(np.maximum(far.matches.left, 0.0)).astype(np.float32)
    width, height = (side // 2 for side in size_px)
    margin = width + reach_px[0] + 1, height + reach_px[1] + 1
    truth = cv2.copyMakeBorder(truth, margin[1], margin[1], margin[0], margin[0], cv2.BORDER_CONSTANT, value=0.0)
    whole = cv2.blur(seen.seen.astype(np.float32), size_px)
    rows = np.arange(height, whole.shape[0] - height, step_px[1])
    columns = np.arange(width, whole.shape[1] - width, step_px[0])
    found = []
    for v in rows:
        for u in columns:
            if whole[v, u] < 0.98 or not seen.seen[v, u]:
                continue
            patch = seen.light[v - height : v + height + 1, u - width : u + width + 1]
            field = truth[v : v + 2 * margin[1] + 1, u : u + 2 * margin[0] + 1]
            peak = _peak(np.asarray(cv2.matchTemplate(field, patch, cv2.TM_CCOEFF_NORMED)), patch.size, least)
            if peak is not None:
                found.append((u, v, u + peak[0] - margin[0] + width, v + peak[1] - margin[1] + height, *peak[2:]))
    table = np.array(found, dtype=float).reshape(-1, 8)
    return _ties(table, seen, near, far, rig)


def _peak(surface: FloatArray, size: int, least: float = LEAST_CORRELATION) -> tuple[float, ...] | None:
    """Place, correlation and covariance (uu, uv, vv) of a correlation's best place; None where it is none.

    With correlation r and its second derivatives H the covariance is that of least squares, 2 (1 - r) / n (-H)^-1;
    it is taken `OVERLAPPING` times as large.
    """
    v, u = np.unravel_index(int(surface.argmax()), surface.shape)
    if surface[v, u] < least or not (0 < v < surface.shape[0] - 1 and 0 < u < surface.shape[1] - 1):
        return None
    near = surface[v - 1 : v + 2, u - 1 : u + 2].astype(float)
    du, dv = 0.5 * (near[1, 2] - near[1, 0]), 0.5 * (near[2, 1] - near[0, 1])
    uu, vv = near[1, 2] + near[1, 0] - 2 * near[1, 1], near[2, 1] + near[0, 1] - 2 * near[1, 1]
    uv = 0.25 * (near[2, 2] - near[2, 0] - near[0, 2] + near[0, 0])
    area = uu * vv - uv * uv
    if uu >= 0 or area <= 0:
        return None
    step = -(vv * du - uv * dv) / area, -(uu * dv - uv * du) / area
    if max(map(abs, step)) > 1:
        return None
    scale = OVERLAPPING * 2 * (1 - near[1, 1]) / size / area
    return float(u + step[0]), float(v + step[1]), near[1, 1], -vv * scale, uv * scale, -uu * scale


def _ties(table: FloatArray, seen: Transferred, near: Station, far: Station, rig: StereoRig) -> TiePoints:
    start = table[:, :2].astype(int)
    sources = seen.place[start[:, 1], start[:, 0]]
    covariance = table[:, [5, 6, 6, 7]].reshape(-1, 2, 2)
    goals = table[:, 2:4] + seen.apart[start[:, 1], start[:, 0]]
    sides = [_side(station.matches, rig, at) for station, at in ((near, sources), (far, goals))]
    return TiePoints(*sides[0], *sides[1], covariance, table[:, 4]).kept(np.isfinite(sides[0][1]))


def _side(matches: StereoMatches, rig: StereoRig, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left pixels as taken, u of the right one less that of the left one, and its error, of rectified places."""
    from scipy.ndimage import map_coordinates

    at = [np.nan_to_num(places[:, k], nan=-9.0) for k in (1, 0)]
    disparity, sigma = (
        map_coordinates(values, at, order=1, mode="constant", cval=np.nan)
        for values in (matches.disparity, matches.sigma_px)
    )
    left = original_px(matches.rectified, rig, places)
    right = original_px(matches.rectified, rig, places - np.stack([disparity, 0 * disparity], -1), right=True)
    return left, right[:, 0] - left[:, 0], sigma


def reach_of(covariance: FloatArray, pose: Pose, points: FloatArray, focal_px: float) -> float:
    """How far an error of a pose may put points (n, 3 in the world) beside their places: 3.5 sigma, or more. [px]"""
    depth = float(np.median(np.linalg.norm(points - pose.center_m, axis=1)))
    turn, move = covariance[2, 2], 0.5 * (covariance[3, 3] + covariance[4, 4])
    return max(3.5 * focal_px * math.sqrt(turn + move / depth**2), LEAST_REACH_PX)
