"""Predicted values at the times and wheels of what was measured."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.comparison.forecast import Forecast
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS
from lunarsci.twin.inference.misfit import FIX_ERROR_M, LATE, MODEL_ERRORS

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
    if strange := set(record.wheel) - set(forecast.wheels):
        raise ParameterError(
            f"'{min(strange)}' is no wheel of {forecast.rover}, for which the drive was predicted; "
            f"it has {', '.join(forecast.wheels)}"
        )
    members = np.flatnonzero(forecast.finished)
    if not members.size:
        raise ParameterError("no predicted drive came to its end, so there is nothing to compare with")
    wheel = np.array([forecast.wheels.index(name) for name in record.wheel], dtype=np.int64)
    low, share = _between(forecast.time_s, record.time_s)
    columns = [STATE_COLUMNS.index(name) for name in OBSERVED]
    states = forecast.states[members][..., columns]
    predicted = _mixed(states[:, low, wheel], states[:, low + 1, wheel], share[:, None])
    moving = ~(forecast.halted[low] | forecast.halted[low + 1])
    timely = moving & (record.time_s > forecast.time_s[1]) & (record.time_s <= forecast.time_s[-1])
    _check_clock(forecast, record)
    known = np.isfinite(record.values) & timely[:, None]
    floor = np.array([MODEL_ERRORS[name] for name in OBSERVED])
    if not known.any() and not len(record.fix_time_s):
        raise ParameterError("no measured value falls into the time of the predicted drive; compare the clocks")
    low_fix, share_fix = _between(forecast.time_s, record.fix_time_s)
    paths = forecast.paths[members][..., :2]
    return Meeting(
        forecast=forecast,
        record=record,
        members=members,
        predicted=predicted,
        sigma=np.where(known, np.hypot(record.sigmas, floor), np.nan),
        known=known,
        independent=np.ones(known.shape, dtype=bool) if independent is None else independent,
        distance_m=np.interp(record.time_s, forecast.time_s, forecast.distance_m),
        places=_mixed(paths[:, low_fix], paths[:, low_fix + 1], share_fix[:, None]),
        place_error_m2=record.fix_covariance_m2 + FIX_ERROR_M**2 * np.eye(2),
        fix_distance_m=np.interp(record.fix_time_s, forecast.time_s, forecast.distance_m),
        planned=_mixed(forecast.planned[low_fix, :2], forecast.planned[low_fix + 1, :2], share_fix[:, None]),
    )


def _between(times: FloatArray, wanted: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sample before each wanted time, and the share of the way to the next; beyond the ends it is the end."""
    place = np.interp(wanted, times, np.arange(len(times)))
    low = np.minimum(place.astype(np.int64), len(times) - 2)
    return low, place - low


def _mixed(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    return np.asarray((1.0 - share) * before + share * after)


def _check_clock(forecast: Forecast, record: DriveRecord) -> None:
    end = forecast.time_s[-1] + forecast.time_s[1]
    for what, times in (("states", record.time_s), ("positions", record.fix_time_s)):
        late = int((times > end).sum())
        if late > LATE * len(times):
            raise ParameterError(
                f"{late} of {len(times)} {what} are later than the end of the predicted drive at "
                f"{forecast.time_s[-1]:.0f} s; is it the plan that was driven, and time_s in seconds from its start?"
            )
