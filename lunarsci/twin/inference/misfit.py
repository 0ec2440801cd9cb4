"""How far simulated drives are from a measured one."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS, UNDER_WAY, Prediction, predict
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.inference.discrepancy import Discrepancy, Removed
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import make_schedule
from lunarsci.twin.rover import Rover

__all__ = ["FIX_ERROR_M", "HUBER", "LATE", "MODEL_ERRORS", "POSITION", "Misfit", "robust_cost"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MODEL_ERRORS = {
    "sinkage_m": 5e-5,
    "slip_ratio": 0.002,
    "side_slip_deg": 0.1,
    "normal_force_n": 0.2,
    "drawbar_pull_n": 0.1,
    "lateral_force_n": 0.1,
}
"""Assumed, beside the measured errors: what the twin may be off by where a measured error is next to nothing.
Side slip in bends is off by 0.04 deg at a time step of 0.1 s."""
FIX_ERROR_M = 0.0015
"""What the time step of 0.1 s puts ends off by, and more than the interpolation between samples does. [m]"""
STEP_S, SAMPLE_M = 0.1, 0.1
"""Of the simulated drives: ends are off by 0.8 mm, states are interpolated in time."""
FARTHEST = 4.0
"""Standard deviations of the first laws that a soil may be from their centre; assumed."""
POSITION = "position"
LATE = 0.05
"""Share of states or positions after the end of the plan beyond which the clock is not the plan's; assumed."""
HUBER = 4.0
"""Whitened residual beyond which a value counts by size, not square, and as an outlier: 1 in 16 000 by chance."""


def robust_cost(white: FloatArray) -> FloatArray:
    """Huber's (1964, 10.1214/aoms/1177703732) cost of whitened residuals, their square where they are small."""
    off = np.abs(white)
    return np.where(off < HUBER, off**2, HUBER * (2.0 * off - HUBER))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Simulated drives beside a measured one.

    Attributes
    ----------
    rover, terrain, plan, record, belief : as in `rectify`.
    inflation : by quantity, or for `position`, what its errors are multiplied by, 1 where it is not named. [-]
    discrepancy : errors that stay the same throughout a drive.
    expected : states without their noise, as of the best soil so far; None takes the measured ones. (n, 6)
    floor : multiple of `MODEL_ERRORS` that is added to the measured errors, above 0. [-]

    Raises ParameterError for a record of another rover, or with fewer values than a soil has parameters.
    """

    rover: Rover
    terrain: Terrain
    plan: Plan
    record: DriveRecord
    belief: SoilBelief
    inflation: Mapping[str, float] = field(default_factory=dict)
    discrepancy: Discrepancy = field(default_factory=Discrepancy)
    floor: float = 1.0
    expected: FloatArray | None = field(default=None, repr=False)
    known: BoolArray = field(init=False, repr=False)
    removed: Removed = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if strange := set(self.record.wheel) - set(self.rover.wheels):
            raise ParameterError(
                f"'{min(strange)}' is no wheel of {self.rover.name}; it has {', '.join(self.rover.wheels)}"
            )
        self._check_times()
        object.__setattr__(self, "known", self._comparable())
        if self.known.sum() + self.record.fix_m.size < len(PARAMETERS):
            raise ParameterError(
                f"{self.known.sum() + self.record.fix_m.size} values can be compared with a drive of the plan, fewer "
                f"than a soil has parameters, {len(PARAMETERS)}; are there states under way, and in time?"
            )
        values = np.where(self.known, self.record.values, np.nan)
        way = self.record.fix_m - (self.plan.x_m, self.plan.y_m)
        expected = values if self.expected is None else self.expected
        removed = self.discrepancy.removed(values, self.sigma, self.wheel, way, self.whitening, expected)
        object.__setattr__(self, "removed", removed)

    @property
    def wheel(self) -> npt.NDArray[np.int64]:
        """Number of the wheel of each state. (n,)"""
        return np.array([self.rover.wheels.index(name) for name in self.record.wheel], dtype=np.int64)

    def _check_times(self) -> None:
        """Refuse a clock that is not the plan's."""
        end = make_schedule(self.plan, self.rover).duration_s
        spacing = SAMPLE_M / self.plan.speed_m_s
        for what, times in (("states", self.record.time_s), ("positions", self.record.fix_time_s)):
            late = int((times > end + spacing).sum())
            if late > LATE * len(times):
                raise ParameterError(
                    f"{late} of {len(times)} {what} are later than the end of the plan at {end:.0f} s; is it the plan "
                    "that was driven, and time_s in seconds from its start?"
                )

    def _comparable(self) -> BoolArray:
        """Values that count: measured, under way, and from the second sample on. (n, 6)

        States between two samples are interpolated, and at the first one the simulated rover has not found its speed.
        """
        schedule, spacing = make_schedule(self.plan, self.rover), SAMPLE_M / self.plan.speed_m_s
        time = self.record.time_s
        about = np.stack([time - spacing, time, time + spacing]).clip(spacing, schedule.duration_s)
        moving = (schedule.pace_at(about) >= UNDER_WAY).all(axis=0)
        moving &= (time > spacing) & (time <= schedule.duration_s)
        return np.asarray(np.isfinite(self.record.values) & moving[:, None], dtype=np.bool_)

    @property
    def sigma(self) -> FloatArray:
        """Their errors, 1 elsewhere. (n, 6)"""
        floor = self.floor * np.array([MODEL_ERRORS[name] for name in OBSERVED])
        factor = np.array([self.inflation.get(name, 1.0) for name in OBSERVED])
        return np.where(self.known, factor * np.hypot(self.record.sigmas, floor), 1.0)

    @property
    def whitening(self) -> FloatArray:
        """Matrix that makes the error of each position a unit one. (f, 2, 2) [1/m]"""
        if not self.record.fix_m.size:
            return np.zeros((0, 2, 2))
        covariance = self.record.fix_covariance_m2 + (self.floor * FIX_ERROR_M) ** 2 * np.eye(2)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)) / self.inflation.get(POSITION, 1.0))

    def simulated(self, transforms: FloatArray) -> Prediction:
        """Drives on soils of these transforms. (points, 8)"""
        values = values_of(self.belief.laws, transforms)
        samples = {name: values[:, k] for k, name in enumerate(PARAMETERS)}
        return predict(self.rover, self.terrain, self.plan, samples=samples, time_step_s=STEP_S, sample_m=SAMPLE_M)

    def near(self, transforms: FloatArray) -> npt.NDArray[np.bool_]:
        """Soils that are no farther from the first laws than `FARTHEST`. (points,)"""
        laws = [self.belief.laws[name] for name in PARAMETERS]
        center, width = np.array([law.center for law in laws]), np.array([law.width for law in laws])
        with np.errstate(invalid="ignore"):
            return np.asarray((np.abs(transforms - center) < FARTHEST * width).all(axis=1))

    def residuals(self, transforms: FloatArray) -> FloatArray:
        """Whitened residuals, simulated less measured, of states, then of positions. (points, r)

        What `discrepancy` lets be the same throughout a drive is removed. Infinite for soils that are too far from the
        first laws, and drives that do not arrive.
        """
        rows = np.full((len(transforms), self.record.values.size + self.record.fix_m.size), np.inf)
        near = self.near(transforms)
        if near.any():
            rows[near] = self._of(self.simulated(transforms[near]))
        return rows

    def states_at(self, transforms: FloatArray) -> FloatArray:
        """Simulated states of one soil at the times of the measured ones. (n, 6)"""
        return np.asarray(self._states(self.simulated(transforms[None]))[0], dtype=np.float64)

    def states_as_measured(self, residual: FloatArray) -> FloatArray:
        """Those of states with nothing removed, over their errors. (n, 6)"""
        return self.parts(self.removed.undone(residual))[0]

    def parts(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those of states (n, 6), and of positions."""
        size = self.record.values.size
        return residual[:size].reshape(self.record.values.shape), residual[size:]

    def _of(self, drives: Prediction) -> FloatArray:
        record, count = self.record, len(drives.outcome)
        states = np.where(self.known, (self._states(drives) - np.nan_to_num(record.values)) / self.sigma, 0.0)
        low, share = _between(drives.time_s, record.fix_time_s)
        places = (1.0 - share) * drives.paths[:, low, :2] + share * drives.paths[:, low + 1, :2]
        white = np.einsum("fij,mfj->mfi", self.whitening, places - record.fix_m)
        rows = self.removed.applied(np.concatenate([states.reshape(count, -1), white.reshape(count, -1)], axis=1))
        rows[~drives.finished] = np.inf
        return rows

    def _states(self, drives: Prediction) -> FloatArray:
        columns = [STATE_COLUMNS.index(name) for name in OBSERVED]
        low, share = _between(drives.time_s, self.record.time_s)
        before, after = drives.states[:, low, self.wheel], drives.states[:, low + 1, self.wheel]
        return np.asarray((1.0 - share) * before[..., columns] + share * after[..., columns], dtype=np.float64)


def _between(times: FloatArray, wanted: FloatArray) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Sample before each wanted time, and the share of the way to the next. (n,), (n, 1)"""
    place = np.interp(wanted, times, np.arange(len(times)))
    low = np.minimum(place.astype(np.int64), len(times) - 2)
    return low, (place - low)[:, None]
