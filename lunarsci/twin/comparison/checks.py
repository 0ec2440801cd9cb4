"""What was predicted beside what was measured of it: the end, the path, and the bands of the wheel states."""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.assimilation.drive_record import OBSERVED
from lunarsci.twin.assimilation.residuals import MODEL_ERRORS
from lunarsci.twin.comparison.matched import MatchedObservations
from lunarsci.twin.comparison.scores import (
    Standing,
    correlation_length,
    crps,
    energy_score,
    inside,
    predictive_rank,
    region_edge,
    spread_of,
    standing,
)
from lunarsci.twin.judgement.endpoint import ErrorEllipse

REGIONS = (0.5, 0.9, 0.95, 0.99)
"""Shares of a prediction that regions hold; assumed."""
LATE_S = 1.0
"""A position this long before the plan ends still counts as one of its end: the rover slows down there. Assumed."""


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


def check_end(matched: MatchedObservations, seed: int = 0) -> EndCheck | None:
    """The last position that falls into the drive or after it; None without positions."""
    times = matched.record.fix_time_s
    if not len(times):
        return None
    last = int(times.argmax())
    measured, members = matched.record.fix_m[last], matched.places[:, last]
    mean, planned, error = members.mean(axis=0), matched.planned[last], matched.place_error_m2[last]
    off = measured - mean
    enough = len(members) > len(off) + 2
    return EndCheck(
        time_s=float(times[last]),
        at_end=bool(times[last] >= matched.forecast.time_s[-1] - LATE_S),
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


def check_path(matched: MatchedObservations) -> PathCheck | None:
    """Every position; None without any."""
    if not len(matched.record.fix_time_s):
        return None
    fixes = tuple(_check_fix(matched, int(number)) for number in np.argsort(matched.record.fix_time_s, kind="stable"))
    errors = np.array([fix.error_m for fix in fixes])
    held = [fix.inside_90 for fix in fixes if fix.inside_90 is not None]
    return PathCheck(
        fixes=fixes,
        rms_m=float(np.sqrt((errors**2).mean())),
        max_m=float(errors.max()),
        worst=fixes[int(errors.argmax())],
        inside_90=float(np.mean(held)) if held else None,
    )


def _check_fix(matched: MatchedObservations, number: int) -> FixCheck:
    members, error = matched.places[:, number], matched.place_error_m2[number]
    off = matched.record.fix_m[number] - members.mean(axis=0)
    standard = None
    if len(members) > len(off) + 2:
        standard = float(np.sqrt(off @ np.linalg.solve(spread_of(members, error), off)))
    return FixCheck(
        time_s=float(matched.record.fix_time_s[number]),
        distance_m=float(matched.fix_distance_m[number]),
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


ALL = "all"
NOMINAL = 0.9
"""Share of drives that the region of a check should hold; assumed."""


@dataclass(frozen=True, slots=True)
class BandCheck:
    """One quantity of one wheel, or of all.

    Attributes
    ----------
    quantity, wheel : which; the wheel is `all` for all together.
    n, effective : values, and how many independent ones they are worth. [-]
    bias, rms : mean and root mean square of measured less predicted mean, in the quantity's unit.
    bias_standard : bias over the standard deviation that the prediction and the errors of measurement give it. [-]
    rms_standard : root mean square of the differences, each over its own standard deviation; 1 if all is right. [-]
    coverage_90 : share of the values in their predicted 90 % band, errors of measurement included. [-]
    crps : mean continuous ranked probability score, in the quantity's unit.
    """

    quantity: str
    wheel: str
    n: int
    effective: float
    bias: float
    rms: float
    bias_standard: float | None
    rms_standard: float | None
    coverage_90: float | None
    crps: float


def standardised(matched: MatchedObservations, column: int, rows: BoolArray) -> FloatArray:
    """Measured less predicted mean, over the root of the members' variance (1 + 1/M) and that of the error. (n,)"""
    members, sigma = matched.predicted[:, rows, column], matched.sigma[rows, column]
    count = len(members)
    variance = members.var(axis=0, ddof=1) * (1.0 + 1.0 / count) if count > 1 else 0.0
    off = matched.record.values[rows, column] - members.mean(axis=0)
    return np.asarray(off / np.sqrt(variance + sigma**2))


def check_bands(matched: MatchedObservations) -> list[BandCheck]:
    """Each quantity that was measured, of all wheels together and of each that has values."""
    wheel = np.array(matched.record.wheel)
    found = []
    for name in matched.measured_quantities():
        known = matched.known[:, OBSERVED.index(name)]
        found.append(_check(matched, name, ALL, known))
        wheels = (w for w in matched.forecast.wheels if known[wheel == w].any())
        found += [_check(matched, name, w, known & (wheel == w)) for w in wheels]
    return found


def _check(matched: MatchedObservations, name: str, wheel: str, rows: BoolArray) -> BandCheck:
    column = OBSERVED.index(name)
    members, measured = matched.predicted[:, rows, column], matched.record.values[rows, column]
    off, several = measured - members.mean(axis=0), len(members) > 2
    bias = float(off.mean())
    own = members.mean(axis=1).var(ddof=1) * (1.0 + 1.0 / len(members)) if several else 0.0
    error = float((matched.sigma[rows, column] ** 2).mean()) / len(off) + MODEL_ERRORS[name] ** 2
    standard = standardised(matched, column, rows)
    return BandCheck(
        quantity=name,
        wheel=wheel,
        n=int(rows.sum()),
        effective=effective_values(matched, column, rows) if several else float(len(off)),
        bias=bias,
        rms=float(np.sqrt((off**2).mean())),
        bias_standard=bias / float(np.sqrt(own + error)) if several else None,
        rms_standard=float(np.sqrt((standard**2).mean())) if several else None,
        coverage_90=float((np.abs(standard) <= half_band(len(members))).mean()) if several else None,
        crps=float(crps(measured, members).mean()),
    )


def half_band(members: int) -> float:
    """Half the 90 % band of a normal law whose mean and deviation are known from so many members. [sd]"""
    from scipy.special import stdtrit

    return float(stdtrit(members - 1, 0.5 + NOMINAL / 2))


def effective_values(matched: MatchedObservations, column: int, rows: BoolArray) -> float:
    """Independent values among standardised differences: those of each wheel over their correlation length, summed.

    Wheels count as independent of each other, as far as the length along each tells nothing else. [-]
    """
    total, wheel = 0.0, np.array(matched.record.wheel)
    for one in sorted(set(wheel[rows])):
        own = rows & (wheel == one)
        order = np.argsort(matched.record.time_s[own], kind="stable")
        series = standardised(matched, column, own)[order]
        total += len(series) / correlation_length(series)
    return total


def ranks(matched: MatchedObservations, name: str) -> FloatArray:
    """Predictive rank of each value of a quantity, 0 to 1. (n,)"""
    column = OBSERVED.index(name)
    rows = matched.known[:, column]
    return predictive_rank(
        matched.record.values[rows, column], matched.sigma[rows, column], matched.predicted[:, rows, column]
    )
