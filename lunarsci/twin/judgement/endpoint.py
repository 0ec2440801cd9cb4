"""Where drives end: bias, circles, error ellipse, and what the end owes to each soil parameter and the time step.

What errors of the terrain make of drives: some of them again, on ground as it is likely to be.
"""

import dataclasses
import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.twin.judgement.keeping import extremes
from lunarsci.twin.plans.plan import Fixes
from lunarsci.twin.simulation.discrepancy import turn_matrix, way_matrix
from lunarsci.twin.simulation.ensemble import LONGEST_SAMPLE_M, LONGEST_STEP_S, Prediction, predict

SHORTEST_STEP_S = 0.01
"""Below, the error is a tenth of a millimetre, and half the step would take long."""
MOST_PAIRS = 64
"""Drives that are driven again, evenly from all; of so many pairs a share is known within a fifth of itself."""
ABOVE_ROUNDING = 1 + 1e-9
"""Factor of a step of a drive that is asked for again. `predict` shortens steps to fit the drive; asked for exactly
these, rounding might have it cut the drive into one step more. Assumed: far above rounding, far below any step."""


@dataclass(frozen=True, slots=True)
class ErrorEllipse:
    """The ellipse of a covariance, about the mean.

    Attributes
    ----------
    semi_major_m, semi_minor_m : semi-axes at one standard deviation, roots of the covariance's eigenvalues. [m]
    azimuth_deg : direction of the major axis from x towards y, as a plan's heading, 0 <= azimuth < 180; 0 for a circle.
    factor_95 : sqrt(chi2.ppf(0.95, 2)) = 2.4477, by which the semi-axes grow to the ellipse that holds 95 % of a plane
        normal distribution. [-]
    semi_major_95_m, semi_minor_95_m : semi-axes of that ellipse. [m]
    share_inside_95 : share of the ends that lie in it, which tells how far from normal they are. [-]
    """

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float
    factor_95: float
    semi_major_95_m: float
    semi_minor_95_m: float
    share_inside_95: float


def scale_of(probability: float) -> float:
    """Standard deviations from the mean to the edge of the ellipse that holds `probability` of a plane normal law.

    The square of that distance has the chi-squared law with two degrees of freedom, whose quantile is
    -2 ln(1 - probability). [-]
    """
    return math.sqrt(-2.0 * math.log1p(-probability))


def error_ellipse(points_m: FloatArray) -> ErrorEllipse | None:
    """Ellipse of points (n, 2) about their mean, covariance with n - 1; None for fewer than two points. [m]"""
    if len(points_m) < 2:
        return None
    offsets = points_m - points_m.mean(axis=0)
    values, vectors = np.linalg.eigh(offsets.T @ offsets / (len(points_m) - 1))
    minor, major = np.sqrt(np.maximum(values, 0.0))
    across, along = offsets @ vectors[:, 0], offsets @ vectors[:, 1]
    factor = scale_of(0.95)
    # Points on a line have no minor axis, and rounding must not put them outside of the major one.
    inside = np.abs(along) <= factor * major * (1 + 1e-9)
    if minor > 1e-9 * major:
        inside = (along / major) ** 2 + (across / minor) ** 2 <= factor**2
    azimuth = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1])) % 180.0
    return ErrorEllipse(
        semi_major_m=float(major),
        semi_minor_m=float(minor),
        azimuth_deg=azimuth if major - minor > 1e-12 * major else 0.0,
        factor_95=factor,
        semi_major_95_m=factor * float(major),
        semi_minor_95_m=factor * float(minor),
        share_inside_95=float(inside.mean()),
    )


Matrix = tuple[tuple[float, float], tuple[float, float]]
"""Covariance of x and y: ((xx, xy), (xy, yy)). [m2]"""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where the drives end.

    Attributes
    ----------
    planned_x_m, planned_y_m : planned destination. [m]
    x_m, y_m : mean of the ends. [m]
    bias_m : distance of the mean from the planned destination. [m]
    ahead_m, left_m : how far the mean is beyond it and to its left, as the rover shall stand there. [m]
    covering_radius_m : smallest circle about the planned destination that holds every end. [m]
    scatter_radius_m : smallest circle, wherever its centre, that holds every end. [m]
    covariance_m2 : ((xx, xy), (xy, yy)) of the ends; zeros for a single member. [m2]
    ellipse : error ellipse about the mean of the ends; None for a single member.
    soil_covariance_m2 : the part of `covariance_m2` that is of the soils; None where no discrepancy was asked for. [m2]
    physics_covariance_m2 : the part of `covariance_m2` that is of errors of the twin's physics, by their law; None
        where no discrepancy was asked for. [m2]
    """

    planned_x_m: float
    planned_y_m: float
    x_m: float
    y_m: float
    bias_m: float
    ahead_m: float
    left_m: float
    covering_radius_m: float
    scatter_radius_m: float
    covariance_m2: Matrix
    ellipse: ErrorEllipse | None
    soil_covariance_m2: Matrix | None = None
    physics_covariance_m2: Matrix | None = None

    @property
    def physics_share(self) -> float | None:
        """Share of the physics in the variance of the ends, by the two parts; None where there are none. [-]"""
        if self.soil_covariance_m2 is None or self.physics_covariance_m2 is None:
            return None
        soil, physics = (part[0][0] + part[1][1] for part in (self.soil_covariance_m2, self.physics_covariance_m2))
        return physics / (soil + physics) if soil + physics > 0 else 0.0


def covering_circle(points_m: FloatArray) -> tuple[float, float, float]:
    """Centre x, y and radius of the smallest circle that holds all points. (n, 2) [m]

    It rests on two or three points of the convex hull, so all such circles are tried.
    """
    points = _hull(points_m)
    best = (float(points[0, 0]), float(points[0, 1]), 0.0 if len(points) == 1 else math.inf)
    for size in (2, 3):
        for corners in itertools.combinations(points, size):
            x, y = _circumcenter(*corners)
            radius = float(np.hypot(*(points - (x, y)).T).max())
            if radius < best[2]:
                best = (x, y, radius)
    return best


def _hull(points: FloatArray) -> FloatArray:
    """Corners of the convex hull of points (n, 2), or all that differ where three or less do. (k, 2)"""
    distinct = np.unique(points, axis=0)
    try:
        return np.asarray(distinct[ConvexHull(distinct).vertices]) if len(distinct) > 3 else distinct
    except QhullError:
        # All on a line: its ends span the circle, and lexicographic order puts them first and last.
        return distinct[[0, -1]]


def _circumcenter(a: FloatArray, b: FloatArray, c: FloatArray | None = None) -> tuple[float, float]:
    """Centre of the smallest circle through two points, or of that through three; infinite for three on a line."""
    if c is None:
        return float(a[0] + b[0]) / 2.0, float(a[1] + b[1]) / 2.0
    p, q = b - a, c - a
    area = 2.0 * float(p[0] * q[1] - p[1] * q[0])
    if area == 0.0:
        return math.inf, math.inf
    x = (q[1] * (p @ p) - p[1] * (q @ q)) / area
    y = (p[0] * (q @ q) - q[0] * (p @ p)) / area
    return float(a[0] + x), float(a[1] + y)


def endpoint_spread(prediction: Prediction) -> Endpoint:
    """Spread of the ends of the members that finished, of which there must be one."""
    ends = prediction.endpoints_m[prediction.finished]
    target = prediction.destination_m
    mean = ends.mean(axis=0)
    heading = float(prediction.planned[-1, 2])
    ahead = np.array([math.cos(heading), math.sin(heading)])
    soil, physics = _parts(prediction)
    return Endpoint(
        planned_x_m=float(target[0]),
        planned_y_m=float(target[1]),
        x_m=float(mean[0]),
        y_m=float(mean[1]),
        bias_m=float(np.hypot(*(mean - target))),
        ahead_m=float((mean - target) @ ahead),
        left_m=float((mean - target) @ [-ahead[1], ahead[0]]),
        covering_radius_m=float(np.hypot(*(ends - target).T).max()),
        scatter_radius_m=covering_circle(ends)[2],
        covariance_m2=_spread(ends),
        ellipse=error_ellipse(ends),
        soil_covariance_m2=soil,
        physics_covariance_m2=physics,
    )


def _parts(prediction: Prediction) -> tuple[Matrix | None, Matrix | None]:
    """What soils and physics each give to the covariance of the ends; None, None without a discrepancy."""
    if prediction.discrepancy is None:
        return None, None
    driven = prediction.paths[prediction.finished]
    way_m2 = way_matrix(prediction.planned[:, :2], driven[..., :3])
    turns_m2 = turn_matrix(prediction.plan, prediction.planned, prediction.distance_m, driven)
    return (
        _spread(driven[:, -1, :2]),
        _matrix(prediction.discrepancy.law.covariance_m2(way_m2) + turns_m2),
    )


def _spread(ends: FloatArray) -> Matrix:
    """Covariance of ends (n, 2), zeros for a single one."""
    return _matrix(np.cov(ends.T) if len(ends) > 1 else np.zeros((2, 2)))


def _matrix(values: FloatArray) -> Matrix:
    return (float(values[0, 0]), float(values[0, 1])), (float(values[1, 0]), float(values[1, 1]))


@dataclass(frozen=True, slots=True)
class EndpointSensitivity:
    """How the end moves with one soil parameter.

    Attributes
    ----------
    parameter : its name, with its unit.
    x_m, y_m : shift of the end from the lowest to the highest value of the ensemble, of a linear fit over all swept
        parameters. [m]
    share : of the variance of the ends that the parameter's part of that fit explains. [-]
    """

    parameter: str
    x_m: float
    y_m: float
    share: float


def endpoint_sensitivity(prediction: Prediction) -> list[EndpointSensitivity]:
    """By linear least squares over the members that finished; empty with fewer than two more than swept parameters."""
    done = prediction.finished
    names = [name for name, values in prediction.parameters.items() if np.ptp(values[done]) > 0] if done.any() else []
    if not names or done.sum() < len(names) + 2:
        return []
    columns = np.column_stack([prediction.parameters[name][done] for name in names])
    scaled = (columns - columns.mean(axis=0)) / np.ptp(columns, axis=0)
    ends = prediction.endpoints_m[done] - prediction.endpoints_m[done].mean(axis=0)
    shifts, *_ = np.linalg.lstsq(scaled, ends, rcond=None)
    total = float((ends**2).sum())
    return [
        EndpointSensitivity(
            name,
            float(shift[0]),
            float(shift[1]),
            float(((column[:, None] * shift) ** 2).sum() / total) if total > 0 else 0.0,
        )
        for name, shift, column in zip(names, shifts, scaled.T, strict=True)
    ]


def step_error_m(prediction: Prediction) -> float | None:
    """Error of the end by the time step: twice the shift that half the step makes, of the member that misses most. [m]

    The integration is of first order, so what is left at half the step is the shift once more. None where that member
    did not finish, and for steps below 0.01 s, whose error is a tenth of a millimetre. Position fixes count as exact.
    """
    member = int(np.argmax(np.where(prediction.finished, prediction.miss_m, -1.0)))
    if not prediction.finished[member] or prediction.time_step_s < SHORTEST_STEP_S:
        return None
    fixes = prediction.plan.fixes and Fixes(0.0, 0.0)
    plan = replace(prediction.plan, fixes=fixes)
    steps = (prediction.time_step_s, prediction.time_step_s / 2) if fixes else (prediction.time_step_s / 2,)
    # A member has its soil from `grounds`, a soil by place, or from `parameters`; `draws` are of its heights.
    grounds = prediction.grounds and prediction.grounds.only(member)
    sample = {name: values[member : member + 1] for name, values in prediction.parameters.items()}
    runs = [
        predict(
            prediction.rover,
            prediction.terrain,
            plan,
            samples=(sample or None) if grounds is None else None,
            grounds=grounds,
            sweep=None if prediction.parameters else (),
            time_step_s=step * ABOVE_ROUNDING,
            sample_m=float(prediction.time_s[1]) * plan.speed_m_s * ABOVE_ROUNDING,
            ruts=prediction.ruts[member],
            before=prediction.before,
            draws=None if prediction.draws is None else prediction.draws[member : member + 1],
        )
        for step in steps
    ]
    if not all(run.finished[0] for run in runs):
        return None
    whole = runs[0].endpoints_m[0] if fixes else prediction.paths[member, -1, :2]
    return float(2 * np.hypot(*(runs[-1].endpoints_m[0] - whole)))


@dataclass(frozen=True, slots=True)
class TerrainShares:
    """How much of the variance over the drives is of the terrain, by pairs of drives on the same soil.

    One drive of a pair is on a drawn ground, the other on the likely one. With S a value of the second, and D that of
    the first less S, the share is var D / (var D + var S).

    Attributes
    ----------
    pairs : how many of them ended, both drives of each.
    end_m : root mean square distance of the ends of a pair. [m]
    end, slip_ratio, tilt_deg, sinkage_m : shares, of the end and of the worst value of each drive; None where nothing
        varies. [-]
    """

    pairs: int
    end_m: float
    end: float | None
    slip_ratio: float | None
    tilt_deg: float | None
    sinkage_m: float | None


def likely_drives(prediction: Prediction) -> Prediction | None:
    """Some of the drives again, on ground as it is likely to be; None where heights are exact.

    At most `MOST_PAIRS`, but all where each member has its soil from `grounds`.
    """
    return None if prediction.draws is None else _again(prediction, _chosen(prediction))


def _chosen(prediction: Prediction) -> IntArray:
    """Numbers of the members that are driven again, ascending. (k,)"""
    count = prediction.members if prediction.grounds is not None else min(MOST_PAIRS, prediction.members)
    return np.unique(np.linspace(0, prediction.members - 1, count).astype(int))


def terrain_shares(prediction: Prediction, plain: Prediction | None) -> TerrainShares | None:
    """By pairs of a prediction with `plain`, its `likely_drives`; None without them, or if fewer than two pairs ended.

    `plain` has a drive for each member chosen, in their order, or a single one, which then is the other of every pair.
    """
    if plain is None:
        return None
    chosen = _chosen(prediction)
    if plain.members == 1:
        plain = _alike(plain, len(chosen))
    done = plain.finished & prediction.finished[chosen]
    if done.sum() < 2:
        return None
    ends = prediction.paths[chosen][done, -1, :2], plain.paths[done, -1, :2]
    worst = {
        name: _share(extremes(prediction, name)[chosen][done, None], extremes(plain, name)[done, None])
        for name in ("slip_ratio", "tilt_deg", "sinkage_m")
    }
    off = float(np.sqrt(((ends[0] - ends[1]) ** 2).sum(axis=1).mean()))
    return TerrainShares(pairs=int(done.sum()), end_m=off, end=_share(*ends), **worst)


def _alike(plain: Prediction, count: int) -> Prediction:
    """One drive, as many times as there are grounds on which its soil was driven."""
    return dataclasses.replace(
        plain,
        paths=np.repeat(plain.paths, count, axis=0),
        states=np.repeat(plain.states, count, axis=0),
        recorded=np.repeat(plain.recorded, count),
        outcome=np.repeat(plain.outcome, count),
        finer=None,
    )


def _again(prediction: Prediction, chosen: IntArray) -> Prediction:
    """Some members on the likely ground."""
    samples = {name: values[chosen] for name, values in prediction.parameters.items()}
    soils: dict[str, Any] = {"samples": samples} if samples else {"sweep": ()}
    sample_m = float(prediction.time_s[1]) * prediction.plan.speed_m_s
    return predict(
        prediction.rover,
        dataclasses.replace(prediction.terrain, errors=None),
        prediction.plan,
        time_step_s=min(prediction.time_step_s * ABOVE_ROUNDING, LONGEST_STEP_S),
        sample_m=min(sample_m * ABOVE_ROUNDING, LONGEST_SAMPLE_M),
        seed=prediction.seed,
        ruts=prediction.ruts[chosen] if samples or prediction.grounds is not None else prediction.ruts[:1],
        before=prediction.before,
        **(soils if prediction.grounds is None else {"grounds": prediction.grounds}),
    )


def _share(drawn: FloatArray, likely: FloatArray) -> float | None:
    """Share of the ground in the variance of values (n, k) of n pairs; None where nothing varies. [-]"""
    of_ground, of_soil = (float(part.var(axis=0).sum()) for part in (drawn - likely, likely))
    return of_ground / (of_ground + of_soil) if of_ground + of_soil > 0 else None
