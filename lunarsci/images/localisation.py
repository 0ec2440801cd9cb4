"""Where a rover's stations were: pairs of them that see the same ground, and all at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.images.adjustment import Adjusted, PairTies, adjust, triangulated
from lunarsci.images.camera import Pose
from lunarsci.images.rig import StereoRig
from lunarsci.images.ties import (
    FEWEST,
    FEWEST_OF_ONE_MOTION,
    LEAST_CORRELATION,
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
"""Half sides of where templates are looked for, a round."""
AGREE_PX, AGREEING = 2.0, 0.6
"""Share of the templates that must be so near to where the pose has them: by chance, few are; assumed."""
ODD_SIGMAS = 5.0
"""Dead reckoning that is off by more is doubted: it, or the ties, are wrong; assumed."""
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
    pairs, adjusted : ties, and how they fit; None where no stations were tied.
    reports : of each pair that was tried.
    tied : whether a station hangs together with the first one by ties. (s,)
    """

    stations: tuple[Station, ...]
    poses: tuple[Pose, ...]
    covariance: FloatArray
    pairs: tuple[PairTies, ...]
    adjusted: Adjusted | None
    reports: tuple[PairReport, ...]
    tied: tuple[bool, ...]

    def off_sigmas(self, number: int) -> float:
        """How far dead reckoning was off, in its own sigmas of place and direction (root mean square of six)."""
        from lunarsci.images.camera import vector_of

        station, pose = self.stations[number], self.poses[number]
        off = np.concatenate(
            [vector_of(pose.rotation @ station.pose.rotation.T), pose.center_m - station.pose.center_m]
        )
        return math.sqrt(float(off @ np.linalg.solve(station.covariance, off)) / 6)


def localise(stations: Sequence[Station], rig: StereoRig, *, progress: Progress | None = None) -> Localised:
    """Tie stations in pairs, next ones and next but one, and adjust them all.

    stations : in the order of the drive, two or more; the first one's pose is taken as it is.
    rig : of all pairs.
    """
    told = progress or (lambda done, total: None)
    count = len(stations)
    todo = [(a, b) for a in range(count) for b in range(a + 1, min(a + 3, count))]
    poses = [station.pose for station in stations]
    found: list[PairTies] = []
    reports = []
    told(0, len(todo))
    for done, (a, b) in enumerate(todo):
        pair, report, relative = _tied(stations, poses, a, b, rig)
        reports.append(report)
        if pair is not None and relative is not None:
            found.append(pair)
            if b == a + 1:
                poses[b] = relative
        told(done + 1, len(todo))
    adjusted = None
    covariances = [station.covariance for station in stations]
    if found:
        adjusted = adjust([s.pose for s in stations], covariances, rig, found)
        poses = list(adjusted.poses)
    return Localised(
        stations=tuple(stations),
        poses=tuple(poses) if adjusted is not None else tuple(s.pose for s in stations),
        covariance=adjusted.covariance if adjusted is not None else _blocks(covariances[1:]),
        pairs=tuple(found),
        adjusted=adjusted,
        reports=tuple(reports),
        tied=_together(count, found),
    )


def _blocks(covariances: Sequence[FloatArray]) -> FloatArray:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*covariances))


def _together(count: int, pairs: Sequence[PairTies]) -> tuple[bool, ...]:
    tied = {0}
    for _ in range(count):
        tied |= {k for pair in pairs if {pair.near, pair.far} & tied for k in (pair.near, pair.far)}
    return tuple(k in tied for k in range(count))


def _tied(
    stations: Sequence[Station], poses: Sequence[Pose], a: int, b: int, rig: StereoRig
) -> tuple[PairTies | None, PairReport, Pose | None]:
    """Ties of two stations, what came of them, and the second one's pose."""
    near, far, seen, ground = _nearer(stations, poses, a, b)
    report = PairReport(a, b, near, float(seen.seen.mean()), 0, 0, 0, math.nan, ground, "")
    if report.overlap < LEAST_OVERLAP:
        return None, report._replace(failure=f"they share no ground: overlap {report.overlap:.1%} of a picture"), None
    motion, report = _by_features(stations, poses, near, far, seen, rig, report)
    if motion is None:
        return None, report, None
    now = _moved(poses, near, far, motion, b)
    for reach in REACHES_PX:
        seen = transfer(stations[near], now[near], stations[far], now[far])
        ties = templates(seen, stations[near], stations[far], rig, reach)
        report = report._replace(ties=len(ties.correlation))
        if report.ties < FEWEST:
            return None, report._replace(failure=_matter(report, seen)), None
        report = report._replace(correlation=float(np.median(ties.correlation)))
        pair = PairTies(int(near != a), int(far != a), ties)
        nothing = [np.eye(6), stations[b].covariance * (b - a)]
        fitted = adjust([poses[a], now[b]], nothing, rig, [pair])
        now = list(now)
        now[b] = fitted.poses[1]
        # What is many times farther off than the rest is no tie.
        off = np.linalg.norm(fitted.residual_px[0], axis=1)
        good = off < max(AGREE_PX, 4 * float(np.median(off)))
        if (off < AGREE_PX).mean() < AGREEING or good.sum() < FEWEST:
            why = f"{(off < AGREE_PX).sum()} of {len(off)} templates agree on a motion; has the Sun moved far?"
            return None, report._replace(failure=why), None
        ties = ties.kept(good)
    return PairTies(near, far, ties), report._replace(ties=len(ties.correlation)), now[b]


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
) -> tuple[RigidMotion | None, PairReport]:
    """The motion that features share, within reach of dead reckoning; None, and why, where they share none."""
    frame = stations[far].matches.rectified
    later = stations[max(near, far)]
    points = poses[near].to_world(stations[near].matches.rectified.points(stations[near].matches.disparity))
    at = np.rint(seen.place[seen.seen][::50]).astype(int)
    common = points[np.clip(at[:, 1], 0, points.shape[0] - 1), np.clip(at[:, 0], 0, points.shape[1] - 1)]
    common = common[np.isfinite(common).all(axis=1)]
    reach = reach_of(later.covariance, poses[far], common, frame.focal_px)
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
    return f"only {report.ties} templates agree by {LEAST_CORRELATION:g} or more{seems}"
