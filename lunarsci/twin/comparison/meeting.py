"""Predicted values at the times and wheels of what was measured."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.interpolation import at_times, samples_about
from lunarsci.twin.comparison.forecast import Forecast
from lunarsci.twin.inference.drive_record import (
    OBSERVED,
    DriveRecord,
    check_clock,
    check_wheels,
    states_at,
)
from lunarsci.twin.inference.misfit import FIX_ERROR_M, MODEL_ERRORS

__all__ = ["Meeting", "meet"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meeting:
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


def meet(forecast: Forecast, record: DriveRecord, independent: BoolArray | None = None) -> Meeting:
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
    return Meeting(
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
