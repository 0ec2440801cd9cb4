"""Stations by ties: all poses, points and the rigs' own errors at once.

Bundle adjustment (Triggs et al. 2000, 10.1007/3-540-44480-7_21): a point is where the nearer station sees it, with that
error, the rig moves within its covariance, dead reckoning is a prior, and what does not fit counts less (Huber 1964,
10.1214/aoms/1177703732). The rig's baseline is the scale.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, block_diag, cho_factor, cho_solve

from lunarsci.arrays import FloatArray, huber_weights
from lunarsci.errors import DataError
from lunarsci.images.camera import PARAMETERS, Pose, StereoRig, rotation_of, vector_of

OVERLAPPING = 4.0
"""How many templates see each pixel, half of one apart each way (as `TEMPLATE_PX`): by this the variance of one is
larger, since their errors are correlated."""
STEPS = 30
"""Gauss-Newton steps of the adjustment, at most."""
EXACT = 1e-12
"""Share of the largest variance below which a direction is given, by rounding."""
SMALL = 1e-6
"""Step of poses [rad, m] and rig that ends the adjustment."""
SMALLEST_PX = 0.1
"""Error of a template's place, and of the pixel that defines a point, that is left where light says none. Measured
(`tests/benchmarks/image_numbers.py`, 30 November 2026, one rendered scene): of 0.05, 0.1 and 0.2 px NEES is 0.7, 0.5
and 0.3 of what is expected. [px]"""
SHIFTED_PX = 0.25
"""Error that a pair's templates share, in u and in v, and by how much it changes over half a picture each way: light
and shadows lie elsewhere when the Sun has moved. Measured: the templates of three rendered pairs were off by 0 to 0.4
px, and of five pairs without such a change by 0.01 to 0.06 px and 0 to 0.2 px over half a picture."""


class TiePoints(NamedTuple):
    """Points that two stations see.

    near_px, far_px : (u, v) in the left pictures. (n, 2) [px]
    near_disparity, far_disparity : u of the right picture less that of the left one, both as taken: of the other sign
        than `StereoMatches.disparity`; NaN where unknown. (n,) [px]
    near_sigma, far_sigma : their random errors. (n,) [px]
    covariance : of `far_px`, as the templates say. (n, 2, 2) [px^2]
    correlation : of the templates. (n,) [-]
    """

    near_px: FloatArray
    near_disparity: FloatArray
    near_sigma: FloatArray
    far_px: FloatArray
    far_disparity: FloatArray
    far_sigma: FloatArray
    covariance: FloatArray
    correlation: FloatArray


class PairTies(NamedTuple):
    """Points that two stations see, and their numbers: `near` sees the common ground from nearer."""

    near: int
    far: int
    ties: TiePoints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjusted:
    """Poses that explain the ties best.

    Attributes
    ----------
    poses : of the left cameras, of all s stations.
    joint : covariance of all poses, rotation about x, y, z of the world [rad] and place [m], one after the other, and
        then of the `PARAMETERS` of each of the r rigs. (6 s + 24 r, 6 s + 24 r)
    rigs : of each station, moved within its covariance.
    rig_of : number of the rig of each station. (s,)
    inflation : for each of the p pairs, by which errors of its templates were multiplied, 1 or more. (p,) [-]
    residual_px : by pair, measured less computed (u, v) of its n ties in the farther left picture. (n, 2) each [px]
    weights : by pair, of its ties, 0 to 1. (n,) each
    """

    poses: tuple[Pose, ...]
    joint: FloatArray
    rigs: tuple[StereoRig, ...]
    rig_of: tuple[int, ...]
    inflation: tuple[float, ...]
    residual_px: tuple[FloatArray, ...]
    weights: tuple[FloatArray, ...]

    @property
    def covariance(self) -> FloatArray:
        """Of all poses but the first; the rig's error is in it. (6 (s - 1), 6 (s - 1))"""
        end = 6 * len(self.poses)
        return self.joint[6:end, 6:end]

    def of_pair(self, one: int, other: int) -> FloatArray:
        """Covariance of the errors of two stations, pose first, then those of their rigs. (30, 30)"""
        count, size = len(self.poses), len(PARAMETERS)
        rows, columns = (
            np.r_[6 * k : 6 * k + 6, 6 * count + size * self.rig_of[k] : 6 * count + size * (self.rig_of[k] + 1)]
            for k in (one, other)
        )
        return np.asarray(self.joint[np.ix_(rows, columns)])


def by_steps(covariances: Sequence[FloatArray]) -> FloatArray:
    """Covariance of s poses, from those of their directions and of the steps from the ones before (6, 6).
    (6 s, 6 s)"""
    step = np.kron(np.tri(len(covariances)), np.diag([0.0] * 3 + [1.0] * 3))
    step += np.kron(np.eye(len(covariances)), np.diag([1.0] * 3 + [0.0] * 3))
    return np.asarray(step @ block_diag(*covariances) @ step.T)


def apart(covariance: FloatArray, one: int, other: int) -> FloatArray:
    """Covariance of a pose less another one, from that of all. (6, 6)"""
    by = np.zeros((6, len(covariance)))
    by[:, 6 * one : 6 * one + 6] -= np.eye(6)
    by[:, 6 * other : 6 * other + 6] += np.eye(6)
    return np.asarray(by @ covariance @ by.T)


def root_of(covariance: FloatArray) -> FloatArray:
    """Columns whose outer products add up to a covariance; as many as it has directions. (n, m)"""
    scale = np.sqrt(np.diag(covariance))
    over = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(over, over))
    used = values > EXACT
    return np.asarray(scale[:, None] * vectors[:, used] * np.sqrt(values[used]))


def adjust(
    poses: Sequence[Pose],
    covariance: FloatArray,
    rigs: Sequence[StereoRig],
    pairs: Sequence[PairTies],
    *,
    start: Sequence[Pose] | None = None,
) -> Adjusted:
    """Adjust stations by what they see in pairs.

    poses, covariance : where dead reckoning puts left cameras, and how well: all directions and places; zero for what
        is given. (6 s, 6 s)
    rigs : of the stations, as their files have them, with their covariances; the same object is one rig.
    pairs : may be none; then poses stay, and their covariance is that of dead reckoning.
    start : poses to begin with; where dead reckoning puts them if None.

    Raises DataError where the equations have no answer.
    """
    unique = list({id(rig): rig for rig in rigs}.values())
    numbers = tuple(next(k for k, one in enumerate(unique) if one is rig) for rig in rigs)
    bundle = _Bundle(tuple(poses), tuple(unique), numbers, tuple(pairs))
    shifts = SHIFTED_PX * np.eye(6 * len(pairs))
    root = block_diag(root_of(covariance), *(root_of(rig.covariance) for rig in unique), shifts)
    first = np.zeros(len(root))
    for k, (pose, reckoned) in enumerate(zip(start or poses, poses, strict=True)):
        first[6 * k : 6 * k + 6] = off_of(pose, reckoned)
    z, inflation = np.linalg.lstsq(root, first, rcond=None)[0], (1.0,) * len(pairs)
    for _ in range(STEPS):
        normal, rhs, parts = bundle.equations(root @ z, inflation)
        try:
            change = cho_solve(cho_factor(root.T @ normal @ root + np.eye(len(z))), root.T @ rhs - z)
        except LinAlgError as error:
            raise DataError("the stations' poses do not follow from their ties; give better poses") from error
        z, inflation = z + change, tuple(part.inflation for part in parts)
        if np.abs(root @ change).max(initial=0.0) < SMALL:
            break
    normal, _, parts = bundle.equations(root @ z, inflation)
    by = bundle.turned(root @ z) @ root
    end, size = 6 * len(poses), 6 * len(poses) + len(unique) * len(PARAMETERS)
    delta = (root @ z)[end:size].reshape(len(unique), -1)
    joint = by @ np.linalg.solve(root.T @ normal @ root + np.eye(len(z)), by.T)
    return Adjusted(
        poses=tuple(bundle.poses(root @ z)),
        joint=np.asarray(joint[:size, :size]),
        rigs=tuple(unique[k].moved(delta[k]) for k in numbers),
        rig_of=numbers,
        inflation=inflation,
        residual_px=tuple(part.off_px for part in parts),
        weights=tuple(part.weight for part in parts),
    )


def off_of(pose: Pose, reckoned: Pose) -> FloatArray:
    """What a pose is off by: rotation about x, y, z of the world [rad], place [m]. (6,)"""
    return np.concatenate([vector_of(pose.rotation @ reckoned.rotation.T), pose.center_m - reckoned.center_m])


class _Residuals(NamedTuple):
    """Residuals of the n ties of a pair.

    residual : of u, v and disparity in the farther picture, whitened, times the root of the weight. (n, 3) [-]
    slopes : derivatives of what is computed by all unknowns, whitened and weighted alike. (n, 3, size)
    off_px, weight : plain residuals of u and v (n, 2) [px]; Huber's weights, 0 to 1 (n,).
    inflation : by which errors of templates should be multiplied for these residuals, 1 or more. [-]
    """

    residual: FloatArray
    slopes: FloatArray
    off_px: FloatArray
    weight: FloatArray
    inflation: float


@dataclass(frozen=True, slots=True, eq=False)
class _Bundle:
    """The equations of the adjustment: `reckoned` poses, rigs and the number of that of each pose, and ties.

    Unknowns (size,) in order: of each station what it is `off_of` by, of each rig the changes of its `PARAMETERS`, of
    each pair by how much its templates are shifted together along u: at the middle, and more over half a picture along
    u and along v; and the same along v [px].
    """

    reckoned: tuple[Pose, ...]
    rigs: tuple[StereoRig, ...]
    rig_of: tuple[int, ...]
    pairs: tuple[PairTies, ...]

    def poses(self, off: FloatArray) -> list[Pose]:
        """Of all stations, from the unknowns."""
        return [
            Pose(
                rotation=rotation_of(off[6 * k : 6 * k + 3]) @ pose.rotation,
                center_m=pose.center_m + off[6 * k + 3 : 6 * k + 6],
            )
            for k, pose in enumerate(self.reckoned)
        ]

    def turned(self, off: FloatArray) -> FloatArray:
        """Derivatives of small rotations of poses, and of all else, by the unknowns, to the first order in what poses
        are off by. (size, size)"""
        by = np.eye(len(off))
        for k in range(len(self.reckoned)):
            turn = slice(6 * k, 6 * k + 3)
            by[turn, turn] += 0.5 * crossed(off[None, turn])[0]
        return by

    def equations(
        self, off: FloatArray, inflation: tuple[float, ...]
    ) -> tuple[FloatArray, FloatArray, list[_Residuals]]:
        """Normal matrix (size, size) and right-hand side (size,) of a Gauss-Newton step, without what was known
        before, and the residuals of pairs."""
        by, end, size = self.turned(off), 6 * len(self.reckoned), len(PARAMETERS)
        rigs = [rig.moved(off[end + size * k : end + size * (k + 1)]) for k, rig in enumerate(self.rigs)]
        shifts = off[end + size * len(rigs) :].reshape(-1, 2, 3)
        poses = self.poses(off)
        parts = [
            self._residuals(index, (poses, rigs), shifts[index], inflation[index], len(off))
            for index in range(len(self.pairs))
        ]
        normal, rhs = np.zeros((len(off),) * 2), np.zeros(len(off))
        for part in parts:
            flat = part.slopes.reshape(-1, len(off)) @ by
            normal += flat.T @ flat
            rhs += flat.T @ part.residual.ravel()
        return normal, rhs, parts

    def _residuals(
        self,
        index: int,
        now: tuple[Sequence[Pose], Sequence[StereoRig]],
        shift: FloatArray,
        inflation: float,
        size: int,
    ) -> _Residuals:
        """What the farther station sees of points less where these are as the nearer one sees them; `now` are poses
        and rigs.

        Weights are Huber's of a tie by its whole residual. Errors of templates are inflated for residuals to fit them:
        single ones scatter by `OVERLAPPING` less in variance than they count; medians, of which that of the chi-square
        of two is 1.386.
        """
        pair = self.pairs[index]
        ties, both = pair.ties, (pair.near, pair.far)
        poses, rigs = [now[0][k] for k in both], [now[1][self.rig_of[k]] for k in both]
        points = poses[0].to_world(triangulated(rigs[0], ties.near_px, ties.near_disparity))
        near, far = (_seen_by(rig, pose, points) for rig, pose in zip(rigs, poses, strict=True))
        by_near = far.by_point @ np.linalg.inv(near.by_point)
        of_near = by_near @ _diagonal(ties.near_sigma, SMALLEST_PX**2 * np.eye(2)) @ by_near.swapaxes(1, 2)
        template = ties.covariance + OVERLAPPING * SMALLEST_PX**2 * np.eye(2)
        # A disparity that is not known says nothing.
        sigma = np.where(np.isfinite(ties.far_disparity + ties.far_sigma), ties.far_sigma, 1e6)
        covariance = of_near + _diagonal(sigma, inflation**2 * template)
        off = np.nan_to_num(np.column_stack([ties.far_px, ties.far_disparity]) - far.pixels)
        half = 0.5 * np.array(rigs[1].left.size)
        share = np.column_stack([np.ones(len(off)), ties.far_px / half - 1.0])
        off[:, :2] -= share @ shift.T
        slopes = np.zeros((len(off), 3, size))
        first = 6 * len(self.reckoned)
        for k, by_pose, by_rig in (
            (pair.near, -by_near @ near.by_pose, -by_near @ near.by_rig),
            (pair.far, far.by_pose, far.by_rig),
        ):
            slopes[:, :, 6 * k : 6 * k + 6] += by_pose
            rig = first + len(PARAMETERS) * self.rig_of[k]
            slopes[:, :, rig : rig + len(PARAMETERS)] += by_rig
        shifts = first + len(PARAMETERS) * len(self.rigs) + 6 * index
        slopes[:, 0, shifts : shifts + 3] = slopes[:, 1, shifts + 3 : shifts + 6] = share
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        residual = np.einsum("nij,nj->ni", whiten, off)
        weight = huber_weights((residual**2).sum(axis=1), 3)
        root = np.sqrt(weight)[:, None]
        alone = math.sqrt(OVERLAPPING) * np.linalg.inv(np.linalg.cholesky(template))
        square = (np.einsum("nij,nj->ni", alone, off[:, :2]) ** 2).sum(axis=1)
        by_defined = np.trace(alone @ of_near[:, :2, :2] @ alone.swapaxes(1, 2), axis1=1, axis2=2)
        inflation = float(np.median(square)) / 1.386 - 0.5 * float(np.median(by_defined))
        return _Residuals(
            residual * root, whiten @ slopes * root[..., None], off[:, :2], weight, math.sqrt(max(1.0, inflation))
        )


def _diagonal(sigma: FloatArray, places: FloatArray) -> FloatArray:
    """Covariances of (u, v, disparity) (n, 3, 3), from errors of disparities (n,) and covariances of (u, v), one each
    or one for all: (n, 2, 2) or (2, 2). [px^2], [px], [px^2]"""
    covariance = np.zeros((len(sigma), 3, 3))
    covariance[:, :2, :2], covariance[:, 2, 2] = places, sigma**2
    return covariance


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


class _Side(NamedTuple):
    """What one station's rig shows of n points: u, v and disparity (n, 3) [px], and their derivatives by the point in
    the world (n, 3, 3), the left camera's rotation [rad] and place [m] (n, 3, 6), the rig's `PARAMETERS` (n, 3, 24)."""

    pixels: FloatArray
    by_point: FloatArray
    by_pose: FloatArray
    by_rig: FloatArray


def _seen_by(rig: StereoRig, pose: Pose, points: FloatArray) -> _Side:
    """Pixels and disparities of points (n, 3) of the world [m] with their derivatives; `pose` of the left camera."""
    local = pose.to_camera(points)
    left = rig.left.project_with_derivatives(local)
    right = rig.right.project_with_derivatives(local @ rig.rotation.T + rig.translation_m)
    by_left, by_right = left.by_pose[..., 3:], right.by_pose[..., 3:]
    by_local = np.concatenate([by_left, (by_right @ rig.rotation - by_left)[:, :1]], axis=1)
    by_point = by_local @ pose.rotation.T
    by_turn = by_point @ crossed(points - pose.center_m)
    by_rig = np.zeros((len(points), 3, len(PARAMETERS)))
    by_rig[:, :2, :9], by_rig[:, 2, :9] = left.by_intrinsics, -left.by_intrinsics[:, 0]
    by_rig[:, 2, 9:18], by_rig[:, 2, 21:] = right.by_intrinsics[:, 0], by_right[:, 0]
    by_rig[:, 2, 18:21] = (by_right[:, :1] @ -crossed(local @ rig.rotation.T))[:, 0]
    pixels = np.column_stack([left.pixels, right.pixels[:, 0] - left.pixels[:, 0]])
    return _Side(pixels, by_point, np.concatenate([by_turn, -by_point], axis=2), by_rig)


def leaning(tilt_rad: float, height_m: float) -> FloatArray:
    """Covariance of direction and place of a camera at `height_m` over ground, or a rover, whose level is not known.

    `tilt_rad` is the standard deviation of either tilt. Rotation first, about the axes of the world; (6, 6).
    """
    level = np.diag([tilt_rad, tilt_rad, 0.0])
    leant = np.concatenate([level, crossed(np.array([[0.0, 0.0, -height_m]]))[0] @ level])
    return np.asarray(leant @ leant.T)


def crossed(vectors: FloatArray) -> FloatArray:
    """Matrices of the cross product from the left. (n, 3) to (n, 3, 3)"""
    return np.asarray(np.cross(vectors[:, None], np.eye(3)).swapaxes(1, 2))
