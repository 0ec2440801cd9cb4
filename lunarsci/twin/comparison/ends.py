"""Where the drive ended and went, beside where it was predicted to.

How well a sharp prediction met what came: continuous ranked probability score, energy score, and ranks.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.comparison.meeting import Meeting
from lunarsci.twin.comparison.tail import Standing, inside, region_edge, spread_of, standing
from lunarsci.twin.judgement.endpoint import ErrorEllipse

__all__ = [
    "REGIONS",
    "EndCheck",
    "FixCheck",
    "PathCheck",
    "check_end",
    "check_path",
    "crps",
    "energy_score",
    "predictive_rank",
    "region_ellipse",
]

FloatArray = npt.NDArray[np.float64]


def crps(observed: FloatArray, members: FloatArray) -> FloatArray:
    """Continuous ranked probability score of ensembles (M, n) for observed values (n,), in their unit; 0 is best.

    E|X - y| - E|X - X'|/2, the second without pairs of a member with itself, so that small ensembles are not punished:
    T. Gneiting & A. Raftery (2007), J. Am. Stat. Assoc. 102, 359, 10.1198/016214506000001437; C. Ferro (2014), Q. J. R.
    Meteorol. Soc. 140, 1917, 10.1002/qj.2270. For a single member it is the absolute error.
    """
    count = len(members)
    near = np.abs(members - observed).mean(axis=0)
    if count < 2:
        return np.asarray(near)
    weights = 2.0 * np.arange(1, count + 1) - count - 1.0
    pairs = (weights[:, None] * np.sort(members, axis=0)).sum(axis=0)
    return np.asarray(near - pairs / (count * (count - 1.0)))


def energy_score(observed: FloatArray, members: FloatArray) -> float:
    """The same for a place (2,) and the members' places (M, 2), with distances in the place of differences. [m]"""
    count = len(members)
    near = float(np.hypot(*(members - observed).T).mean())
    if count < 2:
        return near
    from scipy.spatial.distance import pdist

    return near - float(pdist(members).mean()) / 2.0


def predictive_rank(observed: FloatArray, sigma: FloatArray, members: FloatArray) -> FloatArray:
    """Probability that the prediction gave to less than each observed value, 0 to 1: even if the prediction is right.

    The prediction of a measured value is the mixture of the members (M, n) with normal errors sigma (n,): probability
    integral transform of A. P. Dawid (1984), J. R. Stat. Soc. A 147, 278, 10.2307/2981683. Half a rank keeps it off 0
    and 1.
    """
    from scipy.special import ndtr

    total = np.zeros(observed.shape)
    for member in members:
        total += ndtr((observed - member) / sigma)
    return np.asarray((total + 0.5) / (len(members) + 1.0))


REGIONS = (0.5, 0.9, 0.95, 0.99)
LATE_S = 1.0
"""A position this long before the plan ends still counts as one of its end: the rover slows down there."""


@dataclass(frozen=True, slots=True)
class EndCheck:
    """The last position beside the predicted ones.

    Attributes
    ----------
    time_s, at_end : when it was measured, and whether that is the end of the plan.
    x_m, y_m : measured. [m]
    predicted_x_m, predicted_y_m, planned_x_m, planned_y_m : mean of the members, and the plan, at that time. [m]
    error_m, planned_error_m : distance of the measured place from either. [m]
    standing : against the members; None where they are too few.
    regions : probability to whether the predicted region, error of the position included, holds the measured place.
    energy_score_m : as of `energy_score`. [m]
    """

    time_s: float
    at_end: bool
    x_m: float
    y_m: float
    predicted_x_m: float
    predicted_y_m: float
    planned_x_m: float
    planned_y_m: float
    error_m: float
    planned_error_m: float
    standing: Standing | None
    regions: dict[str, bool]
    energy_score_m: float


@dataclass(frozen=True, slots=True)
class FixCheck:
    """One position beside the predicted ones: distance from their mean [m], and from it in standard deviations [-]."""

    time_s: float
    distance_m: float
    error_m: float
    standard: float | None
    inside_90: bool | None


@dataclass(frozen=True, slots=True)
class PathCheck:
    """All positions beside the predicted ones.

    Attributes
    ----------
    fixes : each, in time.
    rms_m, max_m : of the distance from the members' mean. [m]
    worst : the fix with the largest.
    inside_90 : share of the fixes in their 90 % region; None where the members are too few for one. [-]
    """

    fixes: tuple[FixCheck, ...]
    rms_m: float
    max_m: float
    worst: FixCheck
    inside_90: float | None


def check_end(meeting: Meeting, seed: int = 0) -> EndCheck | None:
    """The last position that falls into the drive or after it; None without positions."""
    times = meeting.record.fix_time_s
    if not len(times):
        return None
    last = int(times.argmax())
    measured, members = meeting.record.fix_m[last], meeting.places[:, last]
    mean, planned, error = members.mean(axis=0), meeting.planned[last], meeting.place_error_m2[last]
    off = measured - mean
    enough = len(members) > len(off) + 2
    return EndCheck(
        time_s=float(times[last]),
        at_end=bool(times[last] >= meeting.forecast.time_s[-1] - LATE_S),
        x_m=float(measured[0]),
        y_m=float(measured[1]),
        predicted_x_m=float(mean[0]),
        predicted_y_m=float(mean[1]),
        planned_x_m=float(planned[0]),
        planned_y_m=float(planned[1]),
        error_m=float(np.hypot(*off)),
        planned_error_m=float(np.hypot(*(measured - planned))),
        standing=standing(measured, members, error, seed),
        regions={f"{100 * share:g}": inside(off, members, error, share) for share in REGIONS} if enough else {},
        energy_score_m=energy_score(measured, members),
    )


def check_path(meeting: Meeting) -> PathCheck | None:
    """Every position; None without any."""
    if not len(meeting.record.fix_time_s):
        return None
    fixes = tuple(_check_fix(meeting, int(number)) for number in np.argsort(meeting.record.fix_time_s, kind="stable"))
    errors = np.array([fix.error_m for fix in fixes])
    held = [fix.inside_90 for fix in fixes if fix.inside_90 is not None]
    return PathCheck(
        fixes=fixes,
        rms_m=float(np.sqrt((errors**2).mean())),
        max_m=float(errors.max()),
        worst=fixes[int(errors.argmax())],
        inside_90=float(np.mean(held)) if held else None,
    )


def _check_fix(meeting: Meeting, number: int) -> FixCheck:
    members, error = meeting.places[:, number], meeting.place_error_m2[number]
    off = meeting.record.fix_m[number] - members.mean(axis=0)
    standard = None
    if len(members) > len(off) + 2:
        standard = float(np.sqrt(off @ np.linalg.solve(spread_of(members, error), off)))
    return FixCheck(
        time_s=float(meeting.record.fix_time_s[number]),
        distance_m=float(meeting.fix_distance_m[number]),
        error_m=float(np.hypot(*off)),
        standard=standard,
        inside_90=None if standard is None else bool(standard**2 <= region_edge(0.9, len(members), 2)),
    )


def region_ellipse(members: FloatArray, error: FloatArray, probability: float) -> ErrorEllipse | None:
    """The predicted region of a probability about the mean of places (M, 2), as an ellipse whose semi-axes at one
    standard deviation are those of the region; None for too few members. [m]
    """
    edge = region_edge(probability, len(members), 2)
    if len(members) < 4 or not np.isfinite(edge):
        return None
    values, vectors = np.linalg.eigh(spread_of(members, error))
    minor, major = np.sqrt(np.maximum(values, 0.0) * edge)
    azimuth = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))) % 180.0
    return ErrorEllipse(float(major), float(minor), azimuth, 1.0, float(major), float(minor), float("nan"))
