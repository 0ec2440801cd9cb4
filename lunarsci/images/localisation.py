"""Where a rover's stations were: pairs of them that see the same ground, and all at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.images.adjustment import Adjusted, PairTies, adjust, crossed, triangulated
from lunarsci.images.camera import Pose, vector_of
from lunarsci.images.rig import StereoRig
from lunarsci.images.ties import (
    ENOUGH,
    FARTHEST_M,
    FEWEST,
    FEWEST_OF_ONE_MOTION,
    LOOSE_CORRELATION,
    WIDE_PX,
    WIDE_STEP_PX,
    RigidMotion,
    Station,
    Transferred,
    features,
    original_px,
    reach_of,
    rigid_motion,
    templates,
    transfer,
)

LEAST_OVERLAP = 0.01
"""Share of the farther picture that the nearer one must fill; assumed."""
REACHES_PX = ((12, 6), (6, 4))
"""Half sides of where templates are looked for, a round; assumed."""
AGREE_PX, AGREEING = 2.0, 0.6
"""Share of the templates that must be so near to where the pose has them: by chance, few are; assumed."""
ODD_SIGMAS = 5.0
"""Dead reckoning that is off by more is doubted: it, or the ties, are wrong; assumed."""
LEAST_SHARED, MOST_CLOSED, NEAREST_M = 0.05, 4, 0.5
"""Share of a station's ground that a much later one must see to be tied to it, to how many at most, and from how near;
assumed. [-], [-], [m]"""
Progress = Callable[[int, int], None]


class PairReport(NamedTuple):
    """What came of two stations.

    first, second : their numbers. near : number of the one that sees the common ground from nearer.
    overlap : share of the farther picture that the nearer one fills.
    features, inliers : found in both, and those of the motion that most share.
    ties : of templates. correlation : their median, nan where there are none.
    ground_m : median distance of the common ground from both. failure : '' or why there are no ties.
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
    stations : as they were given.
    poses, covariance : of all left cameras; of the first nothing is in the covariance. See `Adjusted`.
    pairs, adjusted : ties, and how they fit.
    reports : of each pair that was tried.
    tied : whether a station hangs together with the first one by ties. (s,)
    """

    stations: tuple[Station, ...]
    poses: tuple[Pose, ...]
    covariance: FloatArray
    pairs: tuple[PairTies, ...]
    adjusted: Adjusted
    reports: tuple[PairReport, ...]
    tied: tuple[bool, ...]

    def off_sigmas(self, number: int) -> float:
        """How far dead reckoning was off since the station before, in its own sigmas of step and direction.

        Root mean square of six.
        """
        station, pose = self.stations[number], self.poses[number]
        step = pose.center_m - self.poses[number - 1].center_m
        told = station.pose.center_m - self.stations[number - 1].pose.center_m
        off = np.concatenate([vector_of(pose.rotation @ station.pose.rotation.T), step - told])
        return math.sqrt(float(off @ np.linalg.solve(station.covariance, off)) / 6)

    def place(self, number: int) -> Pose:
        """A rover's frame, that of the left camera where the rover's is not known."""
        pose, rover = self.poses[number], self.stations[number].rover
        if rover is None:
            return pose
        return Pose(rotation=pose.rotation @ rover.rotation, center_m=pose.to_world(rover.center_m))

    def shared(self, one: int, other: int) -> FloatArray:
        """Covariance of the errors of two stations' places, rotation first; nothing with the first one. (6, 6)"""
        if not one or not other:
            return np.zeros((6, 6))
        rows, columns = (slice(6 * number - 6, 6 * number) for number in (one, other))
        return np.asarray(self._carried(one) @ self.covariance[rows, columns] @ self._carried(other).T)

    def _carried(self, number: int) -> FloatArray:
        """Errors of a place by those of the camera's pose. (6, 6)"""
        by, rover = np.eye(6), self.stations[number].rover
        if rover is not None:
            by[3:, :3] = -crossed((self.poses[number].rotation @ rover.center_m)[None])[0]
        return by


def localise(stations: Sequence[Station], rig: StereoRig, *, progress: Progress | None = None) -> Localised:
    """Tie stations in pairs and adjust them all.

    Each is tied to the two before it, and to earlier ones that see the same ground: so a drive that comes back closes.

    stations : in the order of the drive, two or more; the first one's pose is taken as it is.
    rig : of all pairs.
    """
    told = progress or (lambda done, total: None)
    poses = [stations[0].pose]
    steps = [station.covariance for station in stations]
    found: list[PairTies] = []
    reports = []
    for b in range(1, len(stations)):
        told(b - 1, len(stations))
        reckoned = stations[b].pose.center_m - stations[b - 1].pose.center_m
        poses.append(Pose(rotation=stations[b].pose.rotation, center_m=poses[-1].center_m + reckoned))
        tied = False
        for a in _partners(stations, poses, rig, b):
            outcome = _tied(stations, poses, a, b, rig, np.asarray(sum(steps[a + 1 : b + 1])))
            reports.append(outcome.report)
            if outcome.pair is None or outcome.pose is None:
                continue
            found.append(outcome.pair)
            if not tied:
                poses[b] = outcome.pose
            if a == b - 1:
                steps[b] = outcome.covariance
            tied = True
    told(len(stations) - 1, len(stations))
    adjusted = adjust([s.pose for s in stations], [s.covariance for s in stations], rig, found, start=poses)
    told(len(stations), len(stations))
    return Localised(
        stations=tuple(stations),
        poses=adjusted.poses,
        covariance=adjusted.covariance,
        pairs=tuple(found),
        adjusted=adjusted,
        reports=tuple(reports),
        tied=_together(len(stations), found),
    )


def _partners(stations: Sequence[Station], poses: Sequence[Pose], rig: StereoRig, b: int) -> list[int]:
    """Stations before one that it is tied to: the next two, and those whose ground it sees most of."""
    shares = [_shared(stations[a], poses[a], poses[b], rig) for a in range(b - 2)]
    back = [a for a in np.argsort(shares, kind="stable")[::-1] if shares[a] >= LEAST_SHARED][:MOST_CLOSED]
    return [*range(b - 1, max(b - 3, -1), -1), *map(int, back)]


def _shared(first: Station, pose: Pose, other: Pose, rig: StereoRig) -> float:
    """Share of the places that a station knows, which the other one's left camera sees; by every 16th pixel."""
    points = first.matches.rectified.points(first.matches.disparity)[::16, ::16].reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1) & (np.linalg.norm(points, axis=1) < FARTHEST_M)]
    local = other.to_camera(pose.to_world(points))
    ahead = local[local[:, 2] > NEAREST_M]
    return float(rig.left.sees(rig.left.project(ahead)).sum()) / max(len(points), 1)


def _together(count: int, pairs: Sequence[PairTies]) -> tuple[bool, ...]:
    tied = {0}
    for _ in range(count):
        tied |= {k for pair in pairs if {pair.near, pair.far} & tied for k in (pair.near, pair.far)}
    return tuple(k in tied for k in range(count))


class _Outcome(NamedTuple):
    """Ties of two stations, what came of them, and the second one's pose with its covariance beside the first one's."""

    pair: PairTies | None
    report: PairReport
    pose: Pose | None
    covariance: FloatArray


def _tied(
    stations: Sequence[Station], poses: Sequence[Pose], a: int, b: int, rig: StereoRig, covariance: FloatArray
) -> _Outcome:
    """Ties of two stations, the second of which is known beside the first with a covariance (6, 6)."""
    near, far, seen, ground = _nearer(stations, poses, a, b)
    report = PairReport(a, b, near, float(seen.seen.mean()), 0, 0, 0, math.nan, ground, "")

    def failed(why: str) -> _Outcome:
        return _Outcome(None, report._replace(failure=why), None, covariance)

    if report.overlap < LEAST_OVERLAP:
        return failed(f"they share no ground: overlap {report.overlap:.1%} of a picture")
    motion, report = _by_features(stations, poses, near, far, seen, rig, report, covariance)
    if motion is None:
        return failed(report.failure)
    now = _moved(poses, near, far, motion, b)
    for reach in REACHES_PX:
        seen = transfer(stations[near], now[near], stations[far], now[far])
        ties = templates(seen, stations[near], stations[far], rig, reach)
        if len(ties.correlation) < ENOUGH:
            ties = templates(seen, stations[near], stations[far], rig, reach, least=LOOSE_CORRELATION)
        report = report._replace(ties=len(ties.correlation))
        if report.ties < FEWEST:
            return failed(_matter(report, seen))
        report = report._replace(correlation=float(np.median(ties.correlation)))
        pair = PairTies(int(near != a), int(far != a), ties)
        fitted = adjust([poses[a], now[b]], [np.eye(6), covariance], rig, [pair])
        now[b] = fitted.poses[1]
        # What is many times farther off than the rest is no tie.
        off = np.linalg.norm(fitted.residual_px[0], axis=1)
        good = off < max(AGREE_PX, 4 * float(np.median(off)))
        if (off < AGREE_PX).mean() < AGREEING or good.sum() < FEWEST:
            return failed(f"{(off < AGREE_PX).sum()} of {len(off)} templates agree on a motion; has the Sun moved far?")
        ties = ties.kept(good)
    report = report._replace(ties=len(ties.correlation))
    return _Outcome(PairTies(near, far, ties), report, now[b], fitted.covariance)


def _nearer(
    stations: Sequence[Station], poses: Sequence[Pose], a: int, b: int
) -> tuple[int, int, Transferred, tuple[float, float]]:
    """Which station sees the common ground from nearer: numbers of both, its view in the other, distances."""
    tried = []
    for near, far in ((b, a), (a, b)):
        seen = transfer(stations[near], poses[near], stations[far], poses[far])
        distances = tuple(_distance(stations[k], seen, k == near) for k in (near, far))
        tried.append((near, far, seen, distances))
    best = min(tried, key=lambda t: t[3][0] / t[3][1] if t[2].seen.any() else math.inf)
    return best  # type: ignore[return-value]


def _distance(station: Station, seen: Transferred, near: bool) -> float:
    """Median distance of the common ground, nan where there is none. [m]"""
    disparity = station.matches.disparity
    if near:
        at = np.rint(seen.place[seen.seen]).astype(int)
        size = disparity.shape
        disparity = disparity[np.clip(at[:, 1], 0, size[0] - 1), np.clip(at[:, 0], 0, size[1] - 1)]
    else:
        disparity = disparity[seen.seen]
    frame = station.matches.rectified
    known = disparity[np.isfinite(disparity)]
    return frame.focal_px * frame.baseline_m / float(np.median(known)) if len(known) else math.nan


def _by_features(
    stations: Sequence[Station],
    poses: Sequence[Pose],
    near: int,
    far: int,
    seen: Transferred,
    rig: StereoRig,
    report: PairReport,
    covariance: FloatArray,
) -> tuple[RigidMotion | None, PairReport]:
    """The motion that features share, within reach of dead reckoning; None, and why, where they share none."""
    frame = stations[far].matches.rectified
    points = poses[near].to_world(stations[near].matches.rectified.points(stations[near].matches.disparity))
    at = np.rint(seen.place[seen.seen][::50]).astype(int)
    common = points[np.clip(at[:, 1], 0, points.shape[0] - 1), np.clip(at[:, 0], 0, points.shape[1] - 1)]
    common = common[np.isfinite(common).all(axis=1)]
    reach = reach_of(covariance, poses[far], common, frame.focal_px)
    first, second = features(seen, stations[far], reach)
    local = _at(stations[near].matches.rectified.points(stations[near].matches.disparity), _nearest(seen.place, first))
    good = np.isfinite(local).all(axis=1)
    rays = rig.left.rays(original_px(frame, rig, second[good] + _nearest(seen.apart, first)[good]))
    wide = templates(
        seen,
        stations[near],
        stations[far],
        rig,
        (int(reach), max(int(0.4 * reach), 8)),
        size_px=WIDE_PX,
        step_px=WIDE_STEP_PX,
        least=LOOSE_CORRELATION,
    )
    local = np.concatenate([local[good], triangulated(rig, wide.near_px, wide.near_disparity)])
    rays = np.concatenate([rays, rig.left.rays(wide.far_px)])
    turn = poses[far].rotation.T @ poses[near].rotation
    guess = RigidMotion(turn, poses[far].to_camera(poses[near].center_m), np.zeros(len(local), dtype=bool))
    motion = rigid_motion(local, rays, frame.focal_px, guess, seed=17)
    report = report._replace(features=len(local), inliers=int(motion.inliers.sum()))
    if report.inliers < FEWEST_OF_ONE_MOTION:
        return None, report._replace(failure=_matter(report, seen))
    return motion, report


def _at(values: FloatArray, places: FloatArray) -> FloatArray:
    """Values (h, w, k) at (u, v) (n, 2), bilinear; NaN where one of the four is unknown. (n, k)"""
    from scipy.ndimage import map_coordinates

    where = [np.nan_to_num(places[:, k], nan=-9.0) for k in (1, 0)]
    layers = [map_coordinates(values[..., k], where, order=1, cval=np.nan) for k in range(values.shape[-1])]
    return np.stack(layers, axis=-1)


def _nearest(values: FloatArray, places: FloatArray) -> FloatArray:
    """Values (h, w, k) at the pixels nearest to (u, v) (n, 2). (n, k)"""
    at = np.rint(places).astype(int)
    return np.asarray(values[at[:, 1], at[:, 0]])


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
    if report.features < 5 * FEWEST and report.ties == 0:
        return f"{report.features} features in common, {report.inliers} of one motion{seems}"
    if report.ties == 0:
        return f"only {report.inliers} of {report.features} features share a motion{seems}"
    return f"only {report.ties} templates agree by {LOOSE_CORRELATION:g} or more{seems}"
