"""How far simulated drives are from a measured one."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.inference.discrepancy import Discrepancy, Removed
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover

__all__ = ["HUBER", "MODEL_ERRORS", "Misfit", "robust_cost"]

FloatArray = npt.NDArray[np.float64]

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
STEP_S, SAMPLE_M = 0.1, 0.1
"""Of the simulated drives: ends are off by 0.8 mm, states are interpolated in time."""
FIRST_S = 1.0
"""The first second is left out, assumed enough for the simulated rover to find its speed."""
FARTHEST = 4.0
"""Standard deviations of the first laws that a soil may be from their centre; assumed."""
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
    inflation : by quantity, what its errors are multiplied by, 1 where it is not named. [-]
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
    removed: Removed = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if strange := set(self.record.wheel) - set(self.rover.wheels):
            raise ParameterError(
                f"'{min(strange)}' is no wheel of {self.rover.name}; it has {', '.join(self.rover.wheels)}"
            )
        if self.known.sum() + self.record.fix_m.size < len(PARAMETERS):
            raise ParameterError(f"the record has fewer values than a soil has parameters, {len(PARAMETERS)}")
        values = np.where(self.known, self.record.values, np.nan)
        way = self.record.fix_m - (self.plan.x_m, self.plan.y_m)
        expected = values if self.expected is None else self.expected
        removed = self.discrepancy.removed(values, self.sigma, self.wheel, way, self.record.whitening, expected)
        object.__setattr__(self, "removed", removed)

    @property
    def wheel(self) -> npt.NDArray[np.int64]:
        """Number of the wheel of each state. (n,)"""
        return np.array([self.rover.wheels.index(name) for name in self.record.wheel], dtype=np.int64)

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """Values that count. (n, 6)"""
        return np.isfinite(self.record.values) & (self.record.time_s > FIRST_S)[:, None]

    @property
    def sigma(self) -> FloatArray:
        """Their errors, 1 elsewhere. (n, 6)"""
        floor = self.floor * np.array([MODEL_ERRORS[name] for name in OBSERVED])
        factor = np.array([self.inflation.get(name, 1.0) for name in OBSERVED])
        return np.where(self.known, factor * np.hypot(self.record.sigmas, floor), 1.0)

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

    def states_of(self, residual: FloatArray) -> FloatArray:
        """Simulated states that have these residuals, NaN where nothing counts. (n, 6)"""
        states = self.record.values + self.sigma * self.states_as_measured(residual)
        return np.where(self.known, states, np.nan)

    def states_as_measured(self, residual: FloatArray) -> FloatArray:
        """Those of states with nothing removed, over their errors. (n, 6)"""
        return self.parts(self.removed.undone(residual))[0]

    def parts(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those of states (n, 6), and of positions."""
        size = self.record.values.size
        return residual[:size].reshape(self.record.values.shape), residual[size:]

    def _of(self, drives: Prediction) -> FloatArray:
        record, count = self.record, len(drives.outcome)
        wheel = self.wheel
        columns = [STATE_COLUMNS.index(name) for name in OBSERVED]
        low, share = _between(drives.time_s, record.time_s)
        found = (1.0 - share) * drives.states[:, low, wheel][..., columns]
        found += share * drives.states[:, low + 1, wheel][..., columns]
        states = np.where(self.known, (found - np.nan_to_num(record.values)) / self.sigma, 0.0)
        low, share = _between(drives.time_s, record.fix_time_s)
        places = (1.0 - share) * drives.paths[:, low, :2] + share * drives.paths[:, low + 1, :2]
        white = np.einsum("fij,mfj->mfi", record.whitening, places - record.fix_m)
        rows = self.removed.applied(np.concatenate([states.reshape(count, -1), white.reshape(count, -1)], axis=1))
        rows[~drives.finished] = np.inf
        return rows


def _between(times: FloatArray, wanted: FloatArray) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Sample before each wanted time, and the share of the way to the next. (n,), (n, 1)"""
    place = np.interp(wanted, times, np.arange(len(times)))
    low = np.minimum(place.astype(np.int64), len(times) - 2)
    return low, (place - low)[:, None]
