"""Predicted values matched to what was measured, by time and wheel, and what a drive teaches by its miss."""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray, at_times, samples_about
from lunarsci.errors import ParameterError
from lunarsci.regolith.physics_discrepancy import SHARED, PhysicsDiscrepancy
from lunarsci.twin.assimilation.drive_record import (
    OBSERVED,
    DriveRecord,
    check_clock,
    check_wheels,
    states_at,
)
from lunarsci.twin.assimilation.residuals import FIX_ERROR_M, MODEL_ERRORS
from lunarsci.twin.comparison.forecast import Forecast
from lunarsci.twin.simulation.discrepancy import way_matrix
from lunarsci.twin.simulation.turn_discrepancy import turn_matrix


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedObservations:
    """A forecast and a record, brought to the same times.

    Attributes
    ----------
    forecast, record : both. Only drives that finished count.
    members : their numbers. (M,)
    predicted : values of the members at the record's times and wheels, columns `OBSERVED`. (M, n, 6)
    sigma : errors of the measured values with those of the model. (n, 6)
    known : values that compare: measured, after the first second, before the plan ends, not at a halt. (n, 6)
    independent : values that are no second reading of the positions. (n, 6)
    distance_m : commanded distance of each state. (n,) [m]
    places : predicted places at the times of the positions. (M, f, 2) [m]
    place_error_m2 : covariance of the positions with the error of the time step. (f, 2, 2) [m2]
    fix_distance_m, planned : commanded distance and planned place at the positions. (f,), (f, 2) [m]
    """

    forecast: Forecast
    record: DriveRecord
    members: IntArray
    predicted: FloatArray
    sigma: FloatArray
    known: BoolArray
    independent: BoolArray
    distance_m: FloatArray
    places: FloatArray
    place_error_m2: FloatArray
    fix_distance_m: FloatArray
    planned: FloatArray

    def measured_quantities(self) -> list[str]:
        """Those with a value that compares."""
        return [name for k, name in enumerate(OBSERVED) if self.known[:, k].any()]


def match_observations(
    forecast: Forecast, record: DriveRecord, independent: BoolArray | None = None
) -> MatchedObservations:
    """Bring them together; values between samples are interpolated in time.

    `independent` (n, 6) is False where a value was derived from the positions that the record also holds. Raises
    ParameterError for wheels that the predicted rover has not, and where nothing compares.
    """
    check_wheels(record, forecast.wheels, f"{forecast.rover}, for which the drive was predicted")
    check_clock(record, float(forecast.time_s[-1]), float(forecast.time_s[1]))
    members = np.flatnonzero(forecast.finished)
    if not members.size:
        raise ParameterError("no predicted drive came to its end, so there is nothing to compare with")
    low, _ = samples_about(forecast.time_s, record.time_s)
    moving = ~(forecast.halted[low] | forecast.halted[low + 1])
    timely = moving & (record.time_s > forecast.time_s[1]) & (record.time_s <= forecast.time_s[-1])
    known = np.isfinite(record.values) & timely[:, None]
    floor = np.array([MODEL_ERRORS[name] for name in OBSERVED])
    if not known.any() and not len(record.fix_time_s):
        raise ParameterError("no measured value falls into the time of the predicted drive; compare the clocks")
    courses = np.concatenate([forecast.paths[members][..., :2], forecast.planned[None, :, :2]])
    places = at_times(record.fix_time_s, forecast.time_s, courses, axis=-2)
    return MatchedObservations(
        forecast=forecast,
        record=record,
        members=members,
        predicted=states_at(record, forecast.time_s, forecast.states[members], forecast.wheels),
        sigma=np.where(known, np.hypot(record.sigmas, floor), np.nan),
        known=known,
        independent=np.ones(known.shape, dtype=bool) if independent is None else independent,
        distance_m=np.interp(record.time_s, forecast.time_s, forecast.distance_m),
        places=places[:-1],
        place_error_m2=record.fix_covariance_m2 + FIX_ERROR_M**2 * np.eye(2),
        fix_distance_m=np.interp(record.fix_time_s, forecast.time_s, forecast.distance_m),
        planned=places[-1],
    )


NEAR = 0.5
"""Of a quantity's mean size, that its mean counts by at least: a mean force near 0 says nothing of shares; assumed."""


@dataclass(frozen=True, slots=True)
class Miss:
    """The last position beside the middle of the soils, as a share of the way.

    Attributes
    ----------
    way_m : commanded, to there. [m]
    along_m, across_m : how much farther, and how much to the left of the predicted middle the rover came. [m]
    along_share, across_share : of the way. [-]
    soil_m, position_m, physics_m : standard deviations, root of the trace: of the soils, of the measured place, and of
        the physics as it was believed. [m]
    """

    way_m: float
    along_m: float
    across_m: float
    along_share: float
    across_share: float
    soil_m: float
    position_m: float
    physics_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _MissParts:
    """Miss (2,) [m]; covariances of soils, of the place and of spot turns, and matrix of the way (2, 2) [m2]; number of
    the position."""

    miss: FloatArray
    soil: FloatArray
    place: FloatArray
    turns: FloatArray
    way: FloatArray
    last: int


def _miss_parts(matched: MatchedObservations) -> _MissParts | None:
    """None without positions, or with fewer than four drives."""
    times, forecast = matched.record.fix_time_s, matched.forecast
    if not len(times) or len(matched.members) < 4:
        return None
    last = int(times.argmax())
    places, paths = matched.places[:, last], forecast.paths[matched.members].copy()
    if forecast.discrepancy is not None:
        offsets = forecast.discrepancy.offsets_m[matched.members]
        paths[..., :2] -= offsets
        places = places - at_times(times[last : last + 1], forecast.time_s, offsets, axis=-2)[:, 0]
    so_far = slice(0, int(np.searchsorted(forecast.time_s, min(float(times[last]), float(forecast.time_s[-1])))) + 1)
    planned, driven = forecast.planned[so_far], paths[:, so_far]
    return _MissParts(
        miss=matched.record.fix_m[last] - np.median(places, axis=0),
        soil=np.cov(places.T),
        place=matched.place_error_m2[last],
        turns=turn_matrix(forecast.plan, planned, forecast.distance_m[so_far], driven),
        way=way_matrix(planned[:, :2], driven[..., :3]),
        last=last,
    )


def miss_of(matched: MatchedObservations) -> Miss | None:
    """How the last position was missed; None without positions, or with fewer than four drives."""
    found = _miss_parts(matched)
    if found is None:
        return None
    miss, last = found.miss, found.last
    chord = matched.planned[last] - matched.forecast.planned[0, :2]
    ahead = chord / max(float(np.hypot(*chord)), 1e-12)
    along, across = float(miss @ ahead), float(ahead[0] * miss[1] - ahead[1] * miss[0])
    way, law = float(matched.fix_distance_m[last]), matched.forecast.discrepancy
    return Miss(
        way_m=way,
        along_m=along,
        across_m=across,
        along_share=along / max(way, 1e-12),
        across_share=across / max(way, 1e-12),
        soil_m=float(np.sqrt(np.trace(found.soil))),
        position_m=float(np.sqrt(np.trace(found.place))),
        physics_m=0.0 if law is None else float(np.sqrt(np.trace(law.law.covariance_m2(found.way) + found.turns))),
    )


def taught(matched: MatchedObservations, before: PhysicsDiscrepancy) -> PhysicsDiscrepancy:
    """The discrepancy after the drive: the way's shares by the last position, those of wheel states by their means."""
    after, found = before, _miss_parts(matched)
    if found is not None:
        after = after.with_miss(found.miss, found.soil + found.place + found.turns, found.way)
    for name in SHARED:
        column = OBSERVED.index(name)
        rows = matched.known[:, column]
        if rows.any() and len(matched.members) > 3:
            after = _by_mean(matched, name, rows, after)
    return after


def _by_mean(
    matched: MatchedObservations, name: str, rows: BoolArray, before: PhysicsDiscrepancy
) -> PhysicsDiscrepancy:
    column, drawn = OBSERVED.index(name), matched.forecast.discrepancy
    members = matched.predicted[:, rows, column]
    if drawn is not None:
        members = members / np.maximum(1.0 + drawn.shares[name][matched.members], 1e-3)[:, None]
    means = members.mean(axis=1)
    size = float(np.abs(members).mean())
    if size <= 0.0 or abs(float(means.mean())) < NEAR * size:
        return before
    miss = float((matched.record.values[rows, column] - members.mean(axis=0)).mean())
    error = float((matched.sigma[rows, column] ** 2).mean()) / int(rows.sum()) + MODEL_ERRORS[name] ** 2
    return before.with_quantity(name, miss, float(means.var(ddof=1)) + error, abs(float(means.mean())))
