"""Where stations were, from points that they see in pairs: all poses, points and the rig's own error at once.

Bundle adjustment (Triggs et al. 2000, 10.1007/3-540-44480-7_21): points are eliminated (Schur's complement), the rig
moves within its covariance, dead reckoning is a prior, and what does not fit counts less (Huber 1964,
10.1214/aoms/1177703732). The rig's baseline is the scale.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import DataError
from lunarsci.images.camera import Pose, rotation_of, vector_of
from lunarsci.images.rig import PARAMETERS, StereoRig
from lunarsci.images.ties import OVERLAPPING, TiePoints

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
