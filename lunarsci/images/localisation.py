"""Where a rover's stations were: points that pairs of them see, and all poses, points and the rig's own error at once.

What the nearer of two stations sees is laid into the view of the farther one by its stereo points, where both are alike
but for the light. Features (SIFT, Lowe 2004, 10.1023/B:VISI.0000029664.99615.94) with a rigid motion that most of them
share (MAGSAC++, Barath et al. 2020, 10.1109/CVPR42600.2020.00138) bring them within some pixels, templates to parts of
one, and `adjustment` finds the poses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.images.adjustment import (
    OVERLAPPING,
    Adjusted,
    PairTies,
    TiePoints,
    adjust,
    apart,
    by_steps,
    crossed,
    off_of,
    triangulated,
)
from lunarsci.images.camera import Pose, StereoRig, rotation_of
from lunarsci.images.matching import Rectified, StereoMatches
from lunarsci.images.pictures import cv2
from lunarsci.images.reliability import likest
from lunarsci.result import Progress

HIDDEN = 0.02
"""Points are hidden that lie behind the nearest one of a pixel by more than this share of its depth. Measured
(`tests/benchmarks/image_numbers.py`, 30 November 2026, one rendered scene of two stations): of 0.01, 0.02 and 0.04
places are off by 0.10, 0.13 and 0.14 % of the way, with NEES of 0.2, 0.5 and 0.6 of what is expected."""
TEMPLATE_PX, WIDE_PX = (41, 17), (81, 25)
"""Width and height of what is compared, on ground that is foreshortened from afar, and of what is compared where the
pose is not known better than by dead reckoning. Measured as `HIDDEN`: of 31 x 13, 41 x 17 and 61 x 25 px places are off
by 0.07, 0.13 and 0.05 % of the way, with NEES of 0.8, 0.5 and 1.2 of what is expected; the others change less. [px]"""
LEAST_CORRELATION, LOOSE_CORRELATION = 0.6, 0.45
"""Templates that agree less are no ties; the same where many are searched for one motion, which chance does not share,
or where there are few. Measured as `HIDDEN`: by 0.1 more and less places stay within 0.03 % of the way, NEES within
0.1 of what is expected."""
INLIER_PX = 4.0
"""Features that are off by more, on foreshortened ground, do not follow a motion, and the median template must be off
by less than half of it. Measured as `HIDDEN`: half and twice as much move places by 0.003 % of the way. [px]"""
REACHES_PX = ((12, 6), (6, 4))
"""Half sides of where templates are looked for, a round. Measured as `HIDDEN`: half and twice as much move places by
0.003 % of the way. [px]"""
FEWEST = 8
"""Fewest ties that a pose is believed of: four times the equations that its six unknowns need. Measured as `HIDDEN`:
half and twice as many leave places as they are."""
ODD_SIGMAS = 5.0
"""Dead reckoning that is off by more is doubted: it, or the ties, are wrong; assumed."""
LEAST_SHARED, MOST_CLOSED = 0.05, 4
"""Share of a station's ground that a much later one must see to be tied to it, and to how many at most; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Station:
    """A stereo pair, matched, and where dead reckoning puts its left camera.

    Attributes
    ----------
    name : what it is called.
    matches : of its pair.
    rig : that took it, the same object for all pairs of one rig.
    pose : of its left camera.
    covariance : of its direction about x, y, z of the world [rad], and of the step from the stand before [m]; the same
        for all pairs of a stand. (6, 6)
    time_s : of the pair; None where it is not known. [s]
    rover : the rover's frame (x ahead, y left, z up) in that of the left camera; None where it is not known.
    stand : name of the place where the rover did not move between pairs; they share the errors of `covariance`.
    mast : covariance of what the pair is off by beside its stand, since its mast was turned. (6, 6)
    """

    name: str
    matches: StereoMatches
    rig: StereoRig
    pose: Pose
    covariance: FloatArray
    time_s: float | None = None
    rover: Pose | None = None
    stand: str = ""
    mast: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))


def reckoned(stations: Sequence[Station]) -> FloatArray:
    """Covariance of what dead reckoning says of s poses: pairs of one stand are off alike, but for their masts.
    (6 s, 6 s)"""
    stands = [station.stand or station.name for station in stations]
    order = list(dict.fromkeys(stands))
    by_stand = np.kron([[float(stand == other) for other in order] for stand in stands], np.eye(6))
    steps = by_steps([stations[stands.index(stand)].covariance for stand in order])
    return np.asarray(by_stand @ steps @ by_stand.T + block_diag(*(station.mast for station in stations)))


class Transferred(NamedTuple):
    """One station's picture in the rectified frame of another.

    light, seen : root of its light, 0 where nothing is seen, and where something is. (h, w)
    place : rectified (u, v) in the picture that it is from, a whole pixel. (h, w, 2) [px]
    apart : (u, v) by which that pixel falls from the middle of the pixel here. (h, w, 2) [px]
    pixels : how many of its pixels are laid.
    """

    light: npt.NDArray[np.float32]
    seen: BoolArray
    place: FloatArray
    apart: FloatArray
    pixels: int


def transfer(near: Station, pose: Pose, far: Station, far_pose: Pose) -> Transferred:
    """Lay what the nearer station sees into the view of the farther one: the mean of what falls into a pixel, and the
    place that falls nearest to its middle."""
    frame, matches = far.matches.rectified, near.matches
    pixels = np.argwhere(np.isfinite(matches.disparity) & (matches.disparity > 0))
    points = matches.rectified.points(matches.disparity)[pixels[:, 0], pixels[:, 1]]
    local = far_pose.to_camera(pose.to_world(points)) @ frame.turn.T
    with np.errstate(divide="ignore", invalid="ignore"):
        places = frame.focal_px * local[:, :2] / local[:, 2:] + frame.center_px
    height, width = frame.shape
    inside = (local[:, 2] > 0) & (places > -0.5).all(axis=1) & (places < (width - 0.5, height - 0.5)).all(axis=1)
    pixels, places, depth = pixels[inside], places[inside], local[inside, 2]
    whole = np.rint(places).astype(np.int64)
    cell = whole[:, 1] * width + whole[:, 0]
    nearest = np.full(height * width, np.inf)
    np.minimum.at(nearest, cell, depth)
    front = depth <= (1 + HIDDEN) * nearest[cell]
    pixels, cell, off = pixels[front], cell[front], (places - whole)[front]

    def laid(values: FloatArray | None) -> FloatArray:
        total = np.bincount(cell, weights=values, minlength=height * width).astype(float)
        return np.asarray(gaussian_filter(total.reshape(height, width), 0.7))

    count = laid(None)
    light = laid(np.sqrt(np.maximum(matches.left[pixels[:, 0], pixels[:, 1]], 0.0))) / np.maximum(count, 1e-9)
    # The last one written is the nearest to the middle.
    order = np.argsort(-(off**2).sum(axis=1), kind="stable")
    flat = np.full((height * width, 4), np.nan)
    flat[cell[order]] = np.column_stack([pixels[order, ::-1], off[order]])
    # Between pixels that fall apart the nearest one stands for a place.
    rows, columns = distance_transform_edt(
        np.isnan(flat[:, 0].reshape(height, width)), return_distances=False, return_indices=True
    )
    place, apart = np.split(flat.reshape(height, width, 4)[rows, columns], 2, axis=2)
    apart = apart + np.stack([columns, rows], axis=-1) - np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    seen = (count > 0.25) & np.isfinite(place[..., 0])
    return Transferred(np.where(seen, light, 0.0).astype(np.float32), seen, place, apart, len(pixels))


def features(seen: Transferred, far: Station, reach_px: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Features that both views have, at most `reach_px` apart along u and v: (u, v) in the transferred and in the true
    one. (n, 2), (n, 2) [px]"""
    views = seen.light, np.sqrt(np.maximum(far.matches.left, 0.0)).astype(np.float32)
    mask = cv2.erode(seen.seen.astype(np.uint8), np.ones((9, 9), np.uint8))
    around = cv2.dilate(mask, np.ones((2 * reach_px[0] + 1,) * 2, np.uint8))
    sift = cv2.SIFT_create(nfeatures=6000, contrastThreshold=0.01)
    detected = [sift.detectAndCompute(_eight(view, m > 0), m) for view, m in zip(views, (mask, around), strict=True)]
    if any(len(keys) < 3 for keys, _ in detected):
        return np.empty((0, 2)), np.empty((0, 2))
    places = [np.asarray(cv2.KeyPoint_convert(keys), dtype=float) for keys, _ in detected]
    # Of features within reach alone, so that the light of other ground does not count as the second best.
    apart = np.abs(places[0][:, None] - places[1][None])
    within = (apart <= reach_px).all(axis=2).astype(np.uint8)
    return likest(places, [words for _, words in detected], within)


def _eight(light: npt.NDArray[np.float32], used: BoolArray) -> npt.NDArray[np.uint8]:
    """Light over its surroundings', with contrast alike all over, in 8 bits."""
    weight = np.maximum(cv2.GaussianBlur(used.astype(np.float32), (0, 0), 12), 1e-3)
    mean = cv2.GaussianBlur(np.where(used, light, 0).astype(np.float32), (0, 0), 12) / weight
    rest = np.where(used, light - mean, 0).astype(np.float32)
    contrast = np.sqrt(cv2.GaussianBlur(rest * rest, (0, 0), 12) / weight) + 1e-6
    return np.asarray(np.clip(128 + 45 * rest / contrast, 0, 255), dtype=np.uint8)


class RigidMotion(NamedTuple):
    """A rigid motion from the nearer camera's frame into the farther one's, X_far = rotation X_near + translation_m
    (3, 3), (3,) [m], and which ties follow it (n,)."""

    rotation: FloatArray
    translation_m: FloatArray
    inliers: BoolArray


def rigid_motion(points: FloatArray, rays: FloatArray, focal_px: float) -> RigidMotion:
    """The motion that carries most points (n, 3) onto rays (n, 3), z = 1, of the other camera; none of few points."""
    nothing = RigidMotion(np.eye(3), np.zeros(3), np.zeros(len(points), dtype=bool))
    if len(points) < FEWEST:
        return nothing
    works, turn, move, inliers = cv2.solvePnPRansac(
        points, focal_px * rays[:, :2], np.diag([focal_px, focal_px, 1.0]), None,
        iterationsCount=10_000, reprojectionError=INLIER_PX, confidence=0.999, flags=cv2.USAC_MAGSAC,
    )  # fmt: skip
    if not works or inliers is None:
        return nothing
    return RigidMotion(rotation_of(np.ravel(turn)), np.ravel(move), np.isin(np.arange(len(points)), inliers))


def templates(
    seen: Transferred,
    near: Station,
    far: Station,
    reach_px: tuple[int, int],
    *,
    size_px: tuple[int, int],
    least: float,
) -> TiePoints:
    """Ties on a grid of the transferred view: where templates of it, `size_px` wide and high, agree best with the true
    one, at most `reach_px` away along u and v, with a correlation of `least` or more."""
    width, height = (side // 2 for side in size_px)
    margin = width + reach_px[0] + 1, height + reach_px[1] + 1
    truth = np.sqrt(np.maximum(far.matches.left, 0.0)).astype(np.float32)
    truth = cv2.copyMakeBorder(truth, margin[1], margin[1], margin[0], margin[0], cv2.BORDER_CONSTANT, value=0.0)
    whole = (cv2.blur(seen.seen.astype(np.float32), size_px) >= 0.98) & seen.seen
    rows, columns = (np.arange(half, n - half, half) for half, n in zip((height, width), whole.shape, strict=True))
    table = []
    for v, u in ((v, u) for v in rows for u in columns if whole[v, u]):
        patch = seen.light[v - height : v + height + 1, u - width : u + width + 1]
        field = truth[v : v + 2 * margin[1] + 1, u : u + 2 * margin[0] + 1]
        peak = _peak(np.asarray(cv2.matchTemplate(field, patch, cv2.TM_CCOEFF_NORMED)), patch.size, least)
        if peak is not None:
            table.append((u, v, u + peak[0] - reach_px[0] - 1, v + peak[1] - reach_px[1] - 1, *peak[2:]))
    start, goal, correlation, errors = np.split(np.array(table, dtype=float).reshape(-1, 8), (2, 4, 5), axis=1)
    sources, apart = (_nearest(values, start) for values in (seen.place, seen.apart))
    sides = [_side(station.matches, station.rig, at) for station, at in ((near, sources), (far, goal + apart))]
    ties = TiePoints(*sides[0], *sides[1], errors[:, [0, 1, 1, 2]].reshape(-1, 2, 2), correlation[:, 0])
    return TiePoints(*(values[np.isfinite(ties.near_disparity + ties.near_sigma)] for values in ties))


def _peak(surface: FloatArray, size: int, least: float = LEAST_CORRELATION) -> tuple[float, ...] | None:
    """Place, correlation and covariance (uu, uv, vv) of a correlation's best place; None where it is none.

    With correlation r and its second derivatives H the covariance is that of least squares, 2 (1 - r) / n (-H)^-1;
    it is taken `OVERLAPPING` times as large. `surface` has the correlations by shift, `size` is n, the pixels of a
    template; the place is (u, v) in `surface`. [px], [-], [px^2]
    """
    v, u = np.unravel_index(int(surface.argmax()), surface.shape)
    if surface[v, u] < least or not (0 < v < surface.shape[0] - 1 and 0 < u < surface.shape[1] - 1):
        return None
    near = surface[v - 1 : v + 2, u - 1 : u + 2].astype(float)
    gradient = 0.5 * np.array([near[1, 2] - near[1, 0], near[2, 1] - near[0, 1]])
    uu, vv = near[1, 2] + near[1, 0] - 2 * near[1, 1], near[2, 1] + near[0, 1] - 2 * near[1, 1]
    uv = 0.25 * (near[2, 2] - near[2, 0] - near[0, 2] + near[0, 0])
    if uu >= 0 or uu * vv - uv * uv <= 0:
        return None
    inverse = np.linalg.inv([[-uu, -uv], [-uv, -vv]])
    step = inverse @ gradient
    if np.abs(step).max() > 1:
        return None
    covariance = OVERLAPPING * 2 * (1 - near[1, 1]) / size * inverse
    return float(u + step[0]), float(v + step[1]), near[1, 1], covariance[0, 0], covariance[0, 1], covariance[1, 1]


def _side(matches: StereoMatches, rig: StereoRig, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left pixels as taken (n, 2), u of the right one less that of the left one (n,), and its error (n,), of rectified
    places (n, 2). [px]"""
    disparity, sigma = _at(np.stack([matches.disparity, matches.sigma_px], axis=-1), places).T
    left = original_px(matches.rectified, rig, places)
    right = original_px(matches.rectified, rig, places - np.stack([disparity, 0 * disparity], -1), right=True)
    return left, right[:, 0] - left[:, 0], sigma


def original_px(frame: Rectified, rig: StereoRig, places: FloatArray, *, right: bool = False) -> FloatArray:
    """Pixels in the left picture as it was taken, or in the right one, of rectified ones. (..., 2) [px]"""
    flat = (places - np.array(frame.center_px)) / frame.focal_px
    rays = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1) @ frame.turn
    return rig.right.project(rays @ rig.rotation.T) if right else rig.left.project(rays)


def _at(values: FloatArray, places: FloatArray) -> FloatArray:
    """Values (h, w, k) at (u, v) (n, 2), bilinear; NaN where one of the four is unknown. (n, k)"""
    where = [np.nan_to_num(places[:, k], nan=-9.0) for k in (1, 0)]
    layers = [map_coordinates(values[..., k], where, order=1, cval=np.nan) for k in range(values.shape[-1])]
    return np.stack(layers, axis=-1)


def _nearest(values: FloatArray, places: FloatArray) -> FloatArray:
    """Values (h, w, ...) at the pixels nearest to (u, v) (n, 2). (n, ...)"""
    u, v = np.rint(places).astype(int).T
    height, width = values.shape[:2]
    return np.asarray(values[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)])


class PairReport(NamedTuple):
    """What came of two stations.

    first, second, near : their numbers, and that of the one that sees the common ground from nearer.
    overlap : share of the farther picture that the nearer one fills. [-]
    features, inliers : seen by both, wide templates included, and those of the motion that most share.
    ties, correlation : how many templates agree, and their median correlation, NaN where there are none.
    ground_m, failure : median distance of the common ground from both [m]; why there are no ties, or ''.
    """

    first: int
    second: int
    near: int
    overlap: float
    features: int
    inliers: int
    ties: int
    correlation: float
    ground_m: tuple[float, float]
    failure: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Localised:
    """Where stations were.

    Attributes
    ----------
    stations : the s stations, as they were given.
    pairs, adjusted : ties, and how they fit: all poses with their covariance.
    reports : of each pair that was tried.
    tied : whether a station is connected with the first one by ties. (s,)
    """

    stations: tuple[Station, ...]
    pairs: tuple[PairTies, ...]
    adjusted: Adjusted
    reports: tuple[PairReport, ...]
    tied: tuple[bool, ...]

    @property
    def poses(self) -> tuple[Pose, ...]:
        """Of all left cameras."""
        return self.adjusted.poses

    @property
    def covariance(self) -> FloatArray:
        """Of all poses but the first, as in `Adjusted`. (6 (s - 1), 6 (s - 1)) [rad, m]"""
        return self.adjusted.covariance

    def off_sigmas(self, number: int) -> float:
        """How far dead reckoning was off since the station before, in its own sigmas of step and direction.

        Root mean square of six.
        """
        now, before = (off_of(self.poses[k], self.stations[k].pose) for k in (number, number - 1))
        spread = apart(reckoned(self.stations), number - 1, number)
        return math.sqrt(float((now - before) @ np.linalg.pinv(spread, hermitian=True) @ (now - before)) / 6)

    def place(self, number: int) -> Pose:
        """A rover's frame, that of the left camera where the rover's is not known."""
        pose, rover = self.poses[number], self.stations[number].rover
        if rover is None:
            return pose
        return Pose(rotation=pose.rotation @ rover.rotation, center_m=pose.to_world(rover.center_m))

    def shared(self, one: int, other: int) -> FloatArray:
        """Covariance of the errors of two stations' places, rotation first. (6, 6)"""
        between = self.adjusted.of_pair(one, other)[:6, :6]
        return np.asarray(self._carried(one) @ between @ self._carried(other).T)

    def _carried(self, number: int) -> FloatArray:
        """Derivatives of the rover's pose by that of the left camera, rotation first. (6, 6)"""
        by, rover = np.eye(6), self.stations[number].rover
        if rover is not None:
            by[3:, :3] = -crossed((self.poses[number].rotation @ rover.center_m)[None])[0]
        return by


def localise(stations: Sequence[Station], *, progress: Progress | None = None) -> Localised:
    """Tie stations in pairs and adjust them all.

    Each is tied to the two before it, and to earlier ones that see the same ground: so a drive that comes back closes.

    stations : in the order of the drive, two or more; where the covariance of the first one is zero its pose is taken
        as it is.
    """
    report_progress = progress or (lambda done, total: None)
    poses, rigs, prior = [s.pose for s in stations], [s.rig for s in stations], reckoned(stations)
    pairs: list[PairTies] = []
    reports = []
    adjusted = adjust(poses, prior, rigs, pairs)
    for b in range(1, len(stations)):
        report_progress(b - 1, len(stations))
        for a in _partners(stations, adjusted.poses, b):
            report, outcome = _tied(stations, adjusted.poses, a, b, apart(adjusted.joint, a, b))
            reports.append(report)
            if outcome is None:
                continue
            pairs.append(outcome[0])
            start = [*adjusted.poses]
            start[b] = outcome[1].poses[1]
            adjusted = adjust(poses, prior, rigs, pairs, start=start)
    report_progress(len(stations), len(stations))
    together = {0}
    for _ in stations:
        together |= {k for pair in pairs if {pair.near, pair.far} & together for k in (pair.near, pair.far)}
    return Localised(
        stations=tuple(stations),
        pairs=tuple(pairs),
        adjusted=adjusted,
        reports=tuple(reports),
        tied=tuple(k in together for k in range(len(stations))),
    )


def _partners(stations: Sequence[Station], poses: Sequence[Pose], b: int) -> list[int]:
    """Stations before one that it is tied to: the next two, and those whose ground it sees most of."""
    shares = [_shared(stations[a], poses[a], poses[b], stations[b].rig) for a in range(b - 2)]
    back = [a for a in np.argsort(shares, kind="stable")[::-1] if shares[a] >= LEAST_SHARED][:MOST_CLOSED]
    return [*range(b - 1, max(b - 3, -1), -1), *map(int, back)]


def _shared(first: Station, pose: Pose, other: Pose, rig: StereoRig) -> float:
    """Share of the places that a station knows, which the other one's left camera sees; by every 16th pixel."""
    points = first.matches.rectified.points(first.matches.disparity)[::16, ::16].reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    local = other.to_camera(pose.to_world(points))
    return float(rig.left.sees(rig.left.project(local)).sum()) / max(len(points), 1)


def _tied(
    stations: Sequence[Station], poses: Sequence[Pose], a: int, b: int, covariance: FloatArray
) -> tuple[PairReport, tuple[PairTies, Adjusted] | None]:
    """Ties of two stations, the second of which is known beside the first with a covariance (6, 6), and both adjusted
    by them; None where there are none."""
    near, far, seen, ground = _nearer(stations, poses, a, b)
    report = PairReport(a, b, near, float(seen.seen.mean()), 0, 0, 0, math.nan, ground, "")
    if not seen.seen.any() or report.overlap < 0.01:
        return report._replace(failure=f"they share no ground: overlap {report.overlap:.1%} of a picture"), None
    motion, count = _by_features(stations, poses, near, far, seen, covariance)
    report = report._replace(features=count, inliers=int(motion.inliers.sum()))
    if report.inliers < FEWEST:
        return report._replace(failure=_matter(report, seen)), None
    now = _moved(poses, near, far, motion, b)
    for reach in REACHES_PX:
        seen = transfer(stations[near], now[near], stations[far], now[far])
        for least in (LEAST_CORRELATION, LOOSE_CORRELATION):
            ties = templates(seen, stations[near], stations[far], reach, size_px=TEMPLATE_PX, least=least)
            if len(ties.correlation) >= 2 * FEWEST:
                break
        report = report._replace(ties=len(ties.correlation))
        if report.ties < FEWEST:
            return report._replace(failure=_matter(report, seen)), None
        report = report._replace(correlation=float(np.median(ties.correlation)))
        fitted = adjust(
            [poses[a], now[b]],
            block_diag(np.zeros((6, 6)), covariance),
            [stations[k].rig for k in (a, b)],
            [PairTies(int(near != a), int(far != a), ties)],
        )
        now[b] = fitted.poses[1]
        off = np.linalg.norm(fitted.residual_px[0], axis=1)
        if np.median(off) > 0.5 * INLIER_PX:
            why = f"{(off < 0.5 * INLIER_PX).sum()} of {len(off)} templates agree on a motion; has the Sun moved far?"
            return report._replace(failure=why), None
    return report, (PairTies(near, far, ties), fitted)


def _nearer(
    stations: Sequence[Station], poses: Sequence[Pose], a: int, b: int
) -> tuple[int, int, Transferred, tuple[float, float]]:
    """Which station has more pixels of the common ground, as the nearer one has: numbers of both, its view in the
    other, distances."""
    tried = []
    for near, far in ((b, a), (a, b)):
        seen = transfer(stations[near], poses[near], stations[far], poses[far])
        disparities = (
            _nearest(stations[near].matches.disparity, seen.place[seen.seen]),
            stations[far].matches.disparity[seen.seen],
        )
        frames = [stations[k].matches.rectified for k in (near, far)]
        away = [frame.focal_px * frame.baseline_m / float(np.nanmedian(d)) if np.isfinite(d).any() else math.nan
                for frame, d in zip(frames, disparities, strict=True)]  # fmt: skip
        tried.append((near, far, seen, (away[0], away[1])))
    return max(tried, key=lambda t: t[2].pixels)


def _by_features(
    stations: Sequence[Station],
    poses: Sequence[Pose],
    near: int,
    far: int,
    seen: Transferred,
    covariance: FloatArray,
) -> tuple[RigidMotion, int]:
    """The motion that features and wide templates share, within reach of dead reckoning, and how many there are."""
    first, second = stations[near], stations[far]
    frame, points = second.matches.rectified, first.matches.rectified.points(first.matches.disparity)
    reach = _reach_px(covariance, _nearest(points, seen.place[seen.seen][::50]), frame.focal_px)
    there, here = features(seen, second, reach)
    local = _at(points, _nearest(seen.place, there))
    good = np.isfinite(local).all(axis=1)
    lens = second.rig.left
    rays = lens.rays(original_px(frame, second.rig, here[good] + _nearest(seen.apart, there)[good]))
    wide = templates(seen, first, second, reach, size_px=WIDE_PX, least=LOOSE_CORRELATION)
    local = np.concatenate([local[good], triangulated(first.rig, wide.near_px, wide.near_disparity)])
    return rigid_motion(local, np.concatenate([rays, lens.rays(wide.far_px)]), frame.focal_px), len(local)


def _reach_px(covariance: FloatArray, points: FloatArray, focal_px: float) -> tuple[int, int]:
    """How far an error of a pose may put points (n, 3) of a camera beside their places along u and v: 3.5 sigma, and
    across a ray that of the tilt and 0.4 of it, or that of the first `REACHES_PX` and more. [px]"""
    depth = float(np.nanmedian(np.linalg.norm(points, axis=1)))
    turn, move = covariance[2, 2], 0.5 * (covariance[3, 3] + covariance[4, 4])
    reach = max(int(3.5 * focal_px * math.sqrt(turn + move / depth**2)), REACHES_PX[0][0])
    tilt = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]))
    return reach, max(int(0.4 * reach), int(3.5 * focal_px * tilt), 8)


def _moved(poses: Sequence[Pose], near: int, far: int, motion: RigidMotion, second: int) -> list[Pose]:
    """All poses, the second station's as the motion from the nearer to the farther camera says."""
    now = list(poses)
    if second == near:
        turned = poses[far].rotation @ motion.rotation
        now[near] = Pose(rotation=turned, center_m=poses[far].to_world(motion.translation_m))
    else:
        turned = poses[near].rotation @ motion.rotation.T
        now[far] = Pose(rotation=turned, center_m=poses[near].center_m - turned @ motion.translation_m)
    return now


def _matter(report: PairReport, seen: Transferred) -> str:
    """Why two stations could not be tied."""
    light = seen.light[seen.seen]
    contrast = float(light.std() / max(float(light.mean()), 1e-9))
    seems = "; the ground shows too little texture" if contrast < 0.05 else "; has the Sun moved far?"
    if report.ties:
        return f"only {report.ties} templates agree by {LOOSE_CORRELATION:g} or more{seems}"
    return f"{report.features} features in common, {report.inliers} of one motion{seems}"
