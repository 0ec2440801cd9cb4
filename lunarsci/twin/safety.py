"""Is the next drive safe: each limited quantity over the ensemble, the spread of the ends, and a verdict."""

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.contact import VALID_SLIP
from lunarsci.twin.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction
from lunarsci.twin.outcomes import OUTCOMES
from lunarsci.twin.plan import Limit, Plan

__all__ = ["Endpoint", "Judgement", "Verdict", "covering_circle", "extremes", "judge", "tilt_deg"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Judgement:
    """One limited quantity: what each member reached at most, as p50, p95 and maximum over the members.

    p95 is the smallest value that at least 95 % of the members keep, so with fewer than 20 members it is the maximum.
    `margin` is limit - p95; `ok` is p95 <= limit; `exceeding` counts the members above the limit; `worst_member`
    reached the maximum. Unit in `unit`, source of the
    limit in `source`, `assumed` when the limit is a guess.
    """

    quantity: str
    unit: str
    limit: float
    p50: float
    p95: float
    max: float
    margin: float
    ok: bool
    exceeding: int
    worst_member: int
    source: str
    assumed: bool


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where the drives end.

    Attributes
    ----------
    planned_x_m, planned_y_m : planned destination. [m]
    x_m, y_m : mean of the ends. [m]
    bias_m : distance of the mean from the planned destination. [m]
    covering_radius_m : smallest circle about the planned destination that holds every end. [m]
    scatter_radius_m : smallest circle, wherever its centre, that holds every end. [m]
    covariance_m2 : ((xx, xy), (xy, yy)) of the ends; zeros for a single member. [m2]
    """

    planned_x_m: float
    planned_y_m: float
    x_m: float
    y_m: float
    bias_m: float
    covering_radius_m: float
    scatter_radius_m: float
    covariance_m2: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement of a prediction.

    Attributes
    ----------
    verdict : `go` or `no-go`.
    reasons : why not, one sentence each; empty for `go`.
    notes : what a reader should know all the same.
    limits : one entry for each limit of the plan; empty when no member finished.
    endpoint : spread of the ends of the members that finished, None when none did.
    outcomes : outcome sentence to number of members.
    invalid_share : share of wheel states outside the wheel model's validity (|s| > 0.6, unloaded, too deep).
    """

    verdict: Literal["go", "no-go"]
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    limits: tuple[Judgement, ...]
    endpoint: Endpoint | None
    outcomes: dict[str, int]
    invalid_share: float


def tilt_deg(roll_deg: npt.ArrayLike, pitch_deg: npt.ArrayLike) -> FloatArray:
    """Angle between the chassis' z axis and the vertical, cos(tilt) = cos(roll) cos(pitch). [deg]"""
    return np.asarray(np.degrees(np.arccos(np.cos(np.radians(roll_deg)) * np.cos(np.radians(pitch_deg)))))


def extremes(prediction: Prediction, quantity: str) -> FloatArray:
    """Largest magnitude of a quantity over wheels and distance, as far as each member came. (members,)"""
    if quantity == "endpoint_miss_m":
        return prediction.miss_m
    if quantity == "tilt_deg":
        roll, pitch = (prediction.paths[..., PATH_COLUMNS.index(name)] for name in ("roll_deg", "pitch_deg"))
        values = tilt_deg(roll, pitch)
    elif quantity in STATE_COLUMNS:
        values = np.abs(prediction.states[..., STATE_COLUMNS.index(quantity)]).max(axis=2)
    else:
        raise ParameterError(f"'{quantity}' cannot be limited")
    return np.asarray(np.where(prediction.reached, values, 0.0).max(axis=1))


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
    from scipy.spatial import ConvexHull, QhullError

    distinct = np.unique(points, axis=0)
    try:
        return np.asarray(distinct[ConvexHull(distinct).vertices]) if len(distinct) > 3 else distinct
    except QhullError:
        # All on a line: its ends span the circle, and lexicographic order puts them first and last.
        return distinct[[0, -1]]


def _circumcenter(a: FloatArray, b: FloatArray, c: FloatArray | None = None) -> tuple[float, float]:
    if c is None:
        return float(a[0] + b[0]) / 2.0, float(a[1] + b[1]) / 2.0
    p, q = b - a, c - a
    area = 2.0 * float(p[0] * q[1] - p[1] * q[0])
    if area == 0.0:
        return math.inf, math.inf
    x = (q[1] * (p @ p) - p[1] * (q @ q)) / area
    y = (p[0] * (q @ q) - q[0] * (p @ p)) / area
    return float(a[0] + x), float(a[1] + y)


def judge(prediction: Prediction, plan: Plan | None = None) -> Verdict:
    """Hold a prediction against the limits of its plan.

    It is `go` when every member finished and at least 95 % of them keep each limit. Members count alike: on a grid of
    soils that is a share of the grid, not a probability. Per member
    the largest value over wheels and distance counts, at the recorded samples. Percentiles are over the members that
    finished. `plan` replaces the plan that was driven, to try other limits.
    """
    finished = prediction.finished
    limits = (plan or prediction.plan).limits
    judged = tuple(_judge_limit(prediction, limit) for limit in limits) if finished.any() else ()
    outcomes = {
        OUTCOMES[int(k)]: int(n) for k, n in zip(*np.unique(prediction.outcome, return_counts=True), strict=True)
    }
    reasons = [f"{n} of {prediction.members} members: {text}" for text, n in outcomes.items() if text != OUTCOMES[0]]
    reasons += [f"{j.quantity}: p95 {j.p95:.3g} exceeds the limit {j.limit:g}" for j in judged if not j.ok]
    invalid = _invalid_share(prediction)
    return Verdict(
        verdict="no-go" if reasons else "go",
        reasons=tuple(reasons),
        notes=_notes(prediction, judged, invalid),
        limits=judged,
        endpoint=_endpoint(prediction) if finished.any() else None,
        outcomes=outcomes,
        invalid_share=invalid,
    )


def _judge_limit(prediction: Prediction, limit: Limit) -> Judgement:
    members = np.flatnonzero(prediction.finished)
    values = extremes(prediction, limit.quantity)[members]
    p50, p95 = float(np.median(values)), float(np.quantile(values, 0.95, method="inverted_cdf"))
    return Judgement(
        quantity=limit.quantity,
        unit=limit.unit,
        limit=limit.limit,
        p50=p50,
        p95=p95,
        max=float(values.max()),
        margin=limit.limit - p95,
        ok=p95 <= limit.limit,
        exceeding=int((values > limit.limit).sum()),
        worst_member=int(members[values.argmax()]),
        source=limit.source,
        assumed=limit.assumed,
    )


def _endpoint(prediction: Prediction) -> Endpoint:
    ends = prediction.endpoints_m[prediction.finished]
    target = prediction.planned[-1, :2]
    mean = ends.mean(axis=0)
    spread = np.cov(ends.T) if len(ends) > 1 else np.zeros((2, 2))
    return Endpoint(
        planned_x_m=float(target[0]),
        planned_y_m=float(target[1]),
        x_m=float(mean[0]),
        y_m=float(mean[1]),
        bias_m=float(np.hypot(*(mean - target))),
        covering_radius_m=float(np.hypot(*(ends - target).T).max()),
        scatter_radius_m=covering_circle(ends)[2],
        covariance_m2=(
            (float(spread[0, 0]), float(spread[0, 1])),
            (float(spread[1, 0]), float(spread[1, 1])),
        ),
    )


def _invalid_share(prediction: Prediction) -> float:
    valid = prediction.states[..., STATE_COLUMNS.index("valid")][prediction.reached]
    return float(1.0 - valid.mean()) if valid.size else 1.0


def _notes(prediction: Prediction, judged: tuple[Judgement, ...], invalid: float) -> tuple[str, ...]:
    notes = []
    if prediction.terrain.synthetic:
        notes.append("the terrain is synthetic; the verdict says nothing about a real site")
    if assumed := [j.quantity for j in judged if j.assumed]:
        notes.append(f"assumed limits: {', '.join(assumed)}")
    if not judged and prediction.finished.any():
        notes.append("the plan has no limits, so only the outcomes were judged")
    if invalid > 0:
        notes.append(
            f"{invalid:.1%} of the wheel states lie outside the wheel model (|s| > {VALID_SLIP}, unloaded, or too deep)"
        )
    notes += [
        f"{j.quantity}: {j.exceeding} of {prediction.members} drives exceed the limit" for j in judged if j.exceeding
    ]
    return tuple(notes)
