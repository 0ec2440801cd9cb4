"""Where a rover's stations were: pairs of them that see the same ground, and all at once.

Where stations were, from points that they see in pairs: all poses, points and the rig's own error at once.

Bundle adjustment (Triggs et al. 2000, 10.1007/3-540-44480-7_21): points are eliminated (Schur's complement), the rig
moves within its covariance, dead reckoning is a prior, and what does not fit counts less (Huber 1964,
10.1214/aoms/1177703732). The rig's baseline is the scale.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import DataError
from lunarsci.images.camera import PARAMETERS, Pose, StereoRig, rotation_of, vector_of
from lunarsci.images.ties import (
    ENOUGH,
    FARTHEST_M,
    FEWEST,
    FEWEST_OF_ONE_MOTION,
    LOOSE_CORRELATION,
    OVERLAPPING,
    WIDE_PX,
    WIDE_STEP_PX,
    RigidMotion,
    Station,
    TiePoints,
    Transferred,
    features,
    original_px,
    reach_of,
    rigid_motion,
    templates,
    transfer,
)

STEPS = 30
SMALL = 1e-6
"""Step of poses [rad, m] and rig that ends the adjustment."""
HUBER = 2.0
"""Residuals above so many sigmas count by their size, not its square; assumed."""
DEFINED_PX = 0.05
"""Error of the pixel that defines a point: of the interpolation between pixels; assumed."""
SMALLEST_PX = 0.1
"""Error of a template's place that is left where light says none; assumed."""


SHIFTED_PX = 0.25
"""Error that a pair's templates share, in u and in v: light and shadows lie elsewhere when the Sun has moved. Assumed;
the templates of three rendered pairs were off by 0 to 0.4 px."""


class PairTies(NamedTuple):
    """Ties of two stations by their numbers."""

    near: int
    far: int
    ties: TiePoints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjusted:
    """Poses that explain the ties best.

    Attributes
    ----------
    poses : of the left cameras.
    covariance : of all poses but the first, which is given: rotation about x, y, z of the world [rad], place [m], one
        after the other; the rig's error is in it. (6 (s - 1), 6 (s - 1))
    rig : moved within its covariance.
    inflation : by which errors of a pair's templates were multiplied, as they fit. (p,)
    residual_px : of the farther left pictures, a pair. (n, 2) [px]
    weights : of a pair's ties, 0 to 1. (n,)
    """

    poses: tuple[Pose, ...]
    covariance: FloatArray
    rig: StereoRig
    inflation: tuple[float, ...]
    residual_px: tuple[FloatArray, ...]
    weights: tuple[FloatArray, ...]


class _Side(NamedTuple):
    """What one station's rig shows of points: (u, v, u_right - u_left), and derivatives by point, pose and rig."""

    seen: FloatArray
    by_point: FloatArray
    by_pose: FloatArray
    by_rig: FloatArray


def adjust(
    poses: Sequence[Pose],
    covariances: Sequence[FloatArray],
    rig: StereoRig,
    pairs: Sequence[PairTies],
    *,
    start: Sequence[Pose] | None = None,
) -> Adjusted:
    """Adjust stations by what they see in pairs; the first pose is kept.

    poses, covariances : where dead reckoning puts left cameras, and how well: direction, and the step from the one
        before (6, 6); that of the first one is not used.
    rig : as it is told, with its covariance.
    pairs : may be none; then poses stay, and their covariance is that of dead reckoning.
    start : poses to begin with; where dead reckoning puts them if None.

    Raises DataError where the equations have no answer.
    """
    problem = _Bundle(tuple(poses), tuple(covariances), rig, tuple(pairs))
    state = problem.begun(tuple(start or poses))
    for _ in range(STEPS):
        step = problem.step(state)
        state = problem.moved(state, step)
        if np.abs(step[0]).max(initial=0.0) < SMALL:
            break
    return problem.finished(state)


class _Unknowns(NamedTuple):
    poses: tuple[Pose, ...]
    delta: FloatArray
    points: tuple[FloatArray, ...]
    inflation: tuple[float, ...]
    shifts: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Bundle:
    priors: tuple[Pose, ...]
    covariances: tuple[FloatArray, ...]
    rig: StereoRig
    pairs: tuple[PairTies, ...]

    @property
    def loose(self) -> IntArray:
        """Numbers of the rig's parameters that have an error."""
        return np.flatnonzero(np.diag(self.rig.covariance) > 0)

    @property
    def size(self) -> int:
        """Numbers of all unknowns but the points: poses, rig, shifts of templates."""
        return self.free + len(self.loose) + 2 * len(self.pairs)

    @property
    def free(self) -> int:
        """Numbers of all poses but the first."""
        return 6 * (len(self.priors) - 1)

    def begun(self, poses: tuple[Pose, ...]) -> _Unknowns:
        points = []
        for near, _, ties in self.pairs:
            local = triangulated(self.rig, ties.near_px, ties.near_disparity)
            points.append(poses[near].to_world(local))
        count = len(self.pairs)
        return _Unknowns(poses, np.zeros(len(PARAMETERS)), tuple(points), (1.0,) * count, np.zeros((count, 2)))

    def moved(self, state: _Unknowns, step: tuple[FloatArray, list[FloatArray], tuple[float, ...]]) -> _Unknowns:
        change, points, inflation = step
        poses = [state.poses[0]]
        for k, pose in enumerate(state.poses[1:]):
            part = change[6 * k : 6 * k + 6]
            turned = rotation_of(part[:3]) @ pose.rotation
            poses.append(Pose(rotation=turned, center_m=pose.center_m + part[3:]))
        delta = state.delta.copy()
        delta[self.loose] += change[self.free : self.free + len(self.loose)]
        moved = tuple(a + b for a, b in zip(state.points, points, strict=True))
        shifts = state.shifts + change[self.free + len(self.loose) :].reshape(-1, 2)
        return _Unknowns(tuple(poses), delta, moved, inflation, shifts)

    def step(self, state: _Unknowns) -> tuple[FloatArray, list[FloatArray], tuple[float, ...]]:
        """The Gauss-Newton step of poses and rig, of points, and how errors are to be inflated after it."""
        from scipy.linalg import LinAlgError, cho_factor, cho_solve

        normal, goal = self._priors(state)
        kept = []
        for index, pair in enumerate(self.pairs):
            part = self._reduced(state, index, pair)
            normal += part.normal
            goal += part.goal
            kept.append(part)
        try:
            change = cho_solve(cho_factor(normal), goal)
        except LinAlgError as error:
            raise DataError("the stations' poses do not follow from their ties; give better poses") from error
        points = [part.own - np.einsum("nij,j->ni", part.by_common, change) for part in kept]
        return change, points, tuple(part.inflation for part in kept)

    def _priors(self, state: _Unknowns) -> tuple[FloatArray, FloatArray]:
        size = self.size
        normal, goal = np.zeros((size, size)), np.zeros(size)
        moved = np.array([now.center_m - prior.center_m for now, prior in zip(state.poses, self.priors, strict=True)])
        for k in range(1, len(self.priors)):
            weight = np.linalg.inv(self.covariances[k])
            turned = vector_of(state.poses[k].rotation @ self.priors[k].rotation.T)
            off = np.concatenate([turned, moved[k] - moved[k - 1]])
            by = np.zeros((6, size))
            by[:, 6 * k - 6 : 6 * k] = np.eye(6)
            if k > 1:
                by[3:, 6 * k - 9 : 6 * k - 6] = -np.eye(3)
            normal += by.T @ weight @ by
            goal -= by.T @ weight @ off
        weight = np.linalg.inv(self.rig.covariance[np.ix_(self.loose, self.loose)])
        rig = slice(self.free, self.free + len(self.loose))
        normal[rig, rig] += weight
        goal[rig] -= weight @ state.delta[self.loose]
        shifts = np.arange(rig.stop, size)
        normal[shifts, shifts] += SHIFTED_PX**-2
        goal[shifts] -= SHIFTED_PX**-2 * state.shifts.ravel()
        return normal, goal

    def _reduced(self, state: _Unknowns, index: int, pair: PairTies) -> "_Reduced":
        """A pair's part of the equations of poses and rig, its points eliminated."""
        residual, by_point, by_common = self._whitened(state, index, pair)
        weight = _weights(residual)
        root = np.sqrt(weight)[:, None]
        residual, by_point, by_common = residual * root, by_point * root[..., None], by_common * root[..., None]
        own = by_point.transpose(0, 2, 1) @ by_point
        cross = by_point.transpose(0, 2, 1) @ by_common
        inverse = np.linalg.inv(own + 1e-12 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(3))
        pull = np.einsum("nki,nk->ni", by_point, residual)
        solved = inverse @ cross
        flat = by_common.reshape(-1, self.size)
        normal = flat.T @ flat - cross.reshape(-1, self.size).T @ solved.reshape(-1, self.size)
        goal = flat.T @ residual.ravel() - solved.reshape(-1, self.size).T @ pull.ravel()
        return _Reduced(
            normal, goal, np.einsum("nij,nj->ni", inverse, pull), solved, self._inflation(state, index, pair)
        )

    def _whitened(self, state: _Unknowns, index: int, pair: PairTies) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of both stations over their errors (n, 6), and derivatives by points and by poses and rig."""
        ties, rig = pair.ties, self.rig.moved(state.delta)
        first = self.free + len(self.loose) + 2 * index
        residuals, points, commons = [], [], []
        for station, seen, whiten in (
            (pair.near, np.column_stack([ties.near_px, ties.near_disparity]), _near_whitening(ties)),
            (
                pair.far,
                np.column_stack([ties.far_px, ties.far_disparity]),
                _far_whitening(ties, state.inflation[index]),
            ),
        ):
            side = _seen_by(rig, state.poses[station], state.points[index], self.loose)
            common = np.zeros((len(seen), 3, self.size))
            if station > 0:
                common[:, :, 6 * station - 6 : 6 * station] = side.by_pose
            common[:, :, self.free : self.free + len(self.loose)] = side.by_rig
            off = np.nan_to_num(seen - side.seen)
            if station == pair.far:
                common[:, :2, first : first + 2] = np.eye(2)
                off[:, :2] -= state.shifts[index]
            residuals.append(np.einsum("nij,nj->ni", whiten, off))
            points.append(whiten @ side.by_point)
            commons.append(whiten @ common)
        return np.concatenate(residuals, 1), np.concatenate(points, 1), np.concatenate(commons, 1)

    def _off(self, state: _Unknowns, index: int, pair: PairTies) -> FloatArray:
        """How far ties are from their places in the farther left picture. (n, 2) [px]"""
        local = state.poses[pair.far].to_camera(state.points[index])
        return np.asarray(pair.ties.far_px - state.shifts[index] - self.rig.moved(state.delta).left.project(local))

    def _inflation(self, state: _Unknowns, index: int, pair: PairTies) -> float:
        """By how much errors of templates are to be larger for residuals to fit these.

        Residuals are those of points as the nearer station alone has them, with its errors; single templates scatter by
        `OVERLAPPING` less in variance than they count. Medians: that of chi-square of two is 1.386.
        """
        ties, rig = pair.ties, self.rig.moved(state.delta)
        points = state.poses[pair.near].to_world(triangulated(rig, ties.near_px, ties.near_disparity))
        near, far = (_seen_by(rig, state.poses[k], points, self.loose) for k in (pair.near, pair.far))
        whiten = math.sqrt(OVERLAPPING) * _far_whitening(ties, 1.0)[:, :2, :2]
        off = np.einsum("nij,nj->ni", whiten, ties.far_px - state.shifts[index] - far.seen[:, :2])
        by = whiten @ far.by_point[:, :2] @ np.linalg.inv(_near_whitening(ties) @ near.by_point)
        left = np.median((off**2).sum(axis=1)) / 1.386 - 0.5 * np.median((by**2).sum(axis=(1, 2)))
        return math.sqrt(max(1.0, float(left)))

    def finished(self, state: _Unknowns) -> Adjusted:
        normal, _ = self._priors(state)
        residuals, weights = [], []
        for index, pair in enumerate(self.pairs):
            normal += self._reduced(state, index, pair).normal
            residuals.append(self._off(state, index, pair))
            weights.append(_weights(self._whitened(state, index, pair)[0]))
        covariance = np.asarray(np.linalg.inv(normal)[: self.free, : self.free], dtype=float)
        return Adjusted(
            poses=state.poses,
            covariance=covariance,
            rig=self.rig.moved(state.delta),
            inflation=state.inflation,
            residual_px=tuple(residuals),
            weights=tuple(weights),
        )


class _Reduced(NamedTuple):
    normal: FloatArray
    goal: FloatArray
    own: FloatArray
    by_common: FloatArray
    inflation: float


def _weights(residual: FloatArray) -> FloatArray:
    """Huber's, of a tie by its whole residual, whose square is 3 without error (six seen, three unknown). (n,)"""
    size = np.sqrt((residual**2).sum(axis=1) / 3)
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(size, 1e-9)))


def _near_whitening(ties: TiePoints) -> FloatArray:
    whiten = np.zeros((len(ties.near_px), 3, 3))
    whiten[:, 0, 0] = whiten[:, 1, 1] = 1 / DEFINED_PX
    whiten[:, 2, 2] = 1 / ties.near_sigma
    return whiten


def _far_whitening(ties: TiePoints, inflation: float) -> FloatArray:
    """Of the place by the template's covariance, of the disparity by its own error; nothing where there is none."""
    covariance = inflation**2 * (ties.covariance + OVERLAPPING * SMALLEST_PX**2 * np.eye(2))
    whiten = np.zeros((len(ties.far_px), 3, 3))
    whiten[:, :2, :2] = np.linalg.inv(np.linalg.cholesky(covariance))
    whiten[:, 2, 2] = np.nan_to_num(1 / ties.far_sigma)
    return whiten


def triangulated(rig: StereoRig, left_px: FloatArray, disparity: FloatArray) -> FloatArray:
    """Points (n, 3) on the rays of left pixels (n, 2) at which u of the right pixel less that of the left is so."""
    rays = rig.left.rays(left_px)
    depth = np.full(len(rays), 5.0)
    for _ in range(20):
        pixels = rig.right.project(rays * depth[:, None] @ rig.rotation.T + rig.translation_m)
        off = pixels[:, 0] - left_px[:, 0] - disparity
        # u_right - u_left goes as a constant less f b / depth.
        if np.abs(off).max(initial=0.0) < 1e-9:
            break
        depth = 1 / np.maximum(1 / depth + off / (rig.left.fx_px * rig.baseline_m), 1e-3)
    return np.asarray(rays * depth[:, None])


def _seen_by(rig: StereoRig, pose: Pose, points: FloatArray, loose: IntArray) -> _Side:
    """Pixels and disparities of points (n, 3) of the world with their derivatives."""
    local = pose.to_camera(points)
    left = rig.left.project_with_derivatives(local)
    right = rig.right.project_with_derivatives(local @ rig.rotation.T + rig.translation_m)
    by_right = right.by_point @ rig.rotation
    by_local = np.concatenate([left.by_point, by_right[:, :1] - left.by_point[:, :1]], axis=1)
    by_point = by_local @ pose.rotation.T
    by_turn = by_point @ crossed(points - pose.center_m)
    turned = local @ rig.rotation.T
    move = np.concatenate([right.by_point @ -crossed(turned), right.by_point], axis=2)[:, :1]
    zero = np.zeros_like(left.by_intrinsics)
    rows = np.concatenate([left.by_intrinsics, zero, np.zeros((len(points), 2, 6))], axis=2)
    last = np.concatenate([-left.by_intrinsics[:, :1], right.by_intrinsics[:, :1], move], axis=2)
    seen = np.column_stack([left.pixels, right.pixels[:, 0] - left.pixels[:, 0]])
    return _Side(
        seen, by_point, np.concatenate([by_turn, -by_point], axis=2), np.concatenate([rows, last], axis=1)[:, :, loose]
    )


def crossed(vectors: FloatArray) -> FloatArray:
    """Matrices of the cross product from the left. (n, 3) to (n, 3, 3)"""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)


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
