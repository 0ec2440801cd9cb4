"""The soil that explains a drive: the twin drives the same plan on many soils and keeps those that meet what was
measured.

Every simulated drive obeys the balance of forces, so that sinkage, slip and side slip along the whole path, and where
it led, speak of the soil together, with or without measured forces. Soils that explain a drive lie along curves
(cohesion, friction and shear modulus make up for each other), so the posterior is carried as a population, not taken
for normal.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.joint_sampler import carry_population
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover

__all__ = ["MODEL_ERRORS", "Rectified", "rectify"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MODEL_ERRORS = {
    "sinkage_m": 5e-5,
    "slip_ratio": 0.002,
    "side_slip_deg": 0.05,
    "normal_force_n": 0.2,
    "drawbar_pull_n": 0.1,
    "lateral_force_n": 0.1,
}
"""Assumed, beside the measured errors: what the twin may be off by where a measured error is next to nothing."""
PARTICLES = 128
STEP_S, SAMPLE_M = 0.2, 0.1
"""Of the simulated drives: ends are off by 1.4 mm, states are interpolated in time."""
FIRST_S = 1.0
"""The first second is left out, assumed enough for the simulated rover to find its speed."""
FARTHEST = 4.0
"""Standard deviations of the first laws that a soil may be from their centre; assumed."""
HUBER = 4.0
"""Whitened residual beyond which a value counts by size, not square, and as an outlier: 1 in 16 000 by chance."""
MOST_OUTLIERS, WORST_REDUCED = 0.05, 1.5
"""Share of outliers, and reduced chi-square, beyond which the twin does not explain a drive; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rectified:
    """What a drive says of the soil.

    Attributes
    ----------
    belief : after the drive; the one before it where `refused` says why nothing was learned.
    prediction : the drive on the soil that explains it best.
    residuals : whitened, simulated less measured: states (n, 6), columns `OBSERVED`, NaN where not measured.
    outliers : values of states that count as such. (n, 6)
    chi_square, values : of the values that do not, and their number, positions included.
    surprise : distance of the new mean from the old one in standard deviations of the old belief, root mean square over
        the parameters: about 1 or less where the ground is the one that was believed, above 2 it is not. [-]
    persistence : largest correlation of the population with where it was before its last moves; above 0.3 it has not
        spread out, and intervals are too narrow. [-]
    refused : empty, or why the belief was not moved.
    """

    belief: SoilBelief
    prediction: Prediction
    residuals: FloatArray
    outliers: BoolArray
    chi_square: float
    values: int
    surprise: float
    persistence: float
    refused: str

    @property
    def reduced(self) -> float:
        """Chi-square for each value kept. [-]"""
        return self.chi_square / max(self.values, 1)


def rectify(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    record: DriveRecord,
    belief: SoilBelief,
    *,
    particles: int = PARTICLES,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Rectified:
    """Update the belief of a soil by a drive.

    Parameters
    ----------
    rover, terrain, plan : what was driven where; the belief takes the place of the terrain's soil.
    record : what was measured on the way.
    belief : before the drive; its mean and covariance count, not its population.
    particles : in the population, 32 or more.
    seed : of the population.
    progress : called with (done, total).

    Raises ParameterError for a record of another rover, or with fewer values than parameters.
    """
    if particles < 32:
        raise ParameterError(f"{particles} particles are too few; give 32 or more")
    drives = _Drives(rover, terrain, plan, record, belief)
    root = np.linalg.cholesky(belief.covariance)

    def ln_likelihood(points: FloatArray) -> FloatArray:
        return drives.ln_likelihood(belief.mean + points @ root.T)

    zeros, ones = np.zeros(len(PARAMETERS)), np.ones(len(PARAMETERS))
    drawn, left = carry_population(ln_likelihood, zeros, ones, particles, np.random.default_rng(seed), progress)
    points = belief.mean + drawn @ root.T
    best = points[int(np.argmax(drives.ln_likelihood(points)))]
    residual = drives.residuals(best[None])[0]
    states, places = drives.parts(residual)
    outliers = drives.known & (np.abs(states) > HUBER)
    kept = drives.known & ~outliers
    chi_square = float((states[kept] ** 2).sum() + (places**2).sum())
    values = int(kept.sum() + places.size)
    refused = _refusal(int(outliers.sum()), int(drives.known.sum()), chi_square / values)
    moved = points.mean(axis=0) - belief.mean
    return Rectified(
        belief=belief
        if refused
        else SoilBelief(belief.laws, points.mean(axis=0), np.cov(points.T), belief.history, points),
        prediction=drives.simulated(best[None]),
        residuals=np.where(drives.known, states, np.nan),
        outliers=outliers,
        chi_square=chi_square,
        values=values,
        surprise=float(np.sqrt(moved @ np.linalg.solve(belief.covariance, moved) / len(PARAMETERS))),
        persistence=left,
        refused=refused,
    )


def _refusal(outliers: int, values: int, reduced: float) -> str:
    look = "look for a wrong plan, terrain or clock, or begin anew with another belief"
    if outliers > MOST_OUTLIERS * values:
        return f"{outliers} of {values} values are explained by no soil of the belief; {look}"
    if reduced > WORST_REDUCED:
        return f"the best soil leaves a reduced chi-square of {reduced:.1f}; {look}"
    return ""


class _Drives:
    """Simulated drives beside the measured one."""

    def __init__(self, rover: Rover, terrain: Terrain, plan: Plan, record: DriveRecord, belief: SoilBelief) -> None:
        if strange := set(record.wheel) - set(rover.wheels):
            raise ParameterError(f"'{min(strange)}' is no wheel of {rover.name}; it has {', '.join(rover.wheels)}")
        self.rover, self.terrain, self.plan, self.record, self.belief = rover, terrain, plan, record, belief
        self.known = np.isfinite(record.values) & (record.time_s > FIRST_S)[:, None]
        if self.known.sum() + record.fix_m.size < len(PARAMETERS):
            raise ParameterError(f"the record has fewer values than a soil has parameters, {len(PARAMETERS)}")
        floor = np.array([MODEL_ERRORS[name] for name in OBSERVED])
        self.sigma = np.where(self.known, np.hypot(record.sigmas, floor), 1.0)
        self.wheel = np.array([rover.wheels.index(name) for name in record.wheel], dtype=np.int64)
        self.center = np.array([belief.laws[name].center for name in PARAMETERS])
        self.reach = FARTHEST * np.array([belief.laws[name].width for name in PARAMETERS])

    def simulated(self, points: FloatArray) -> Prediction:
        """Drives on soils of these transforms. (points, 8)"""
        values = values_of(self.belief.laws, points)
        samples = {name: values[:, k] for k, name in enumerate(PARAMETERS)}
        return predict(self.rover, self.terrain, self.plan, samples=samples, time_step_s=STEP_S, sample_m=SAMPLE_M)

    def ln_likelihood(self, points: FloatArray) -> FloatArray:
        """Of transforms (points, 8); -inf for soils too far from the first laws, or that do not carry the rover."""
        result = np.full(len(points), -np.inf)
        near = (np.abs((points - self.center) / self.reach) < 1.0).all(axis=1)
        if near.any():
            off = np.abs(self.residuals(points[near]))
            result[near] = -0.5 * np.where(off < HUBER, off**2, HUBER * (2.0 * off - HUBER)).sum(axis=1)
        return result

    def residuals(self, points: FloatArray) -> FloatArray:
        """Whitened residuals of states, then of positions; infinite for drives that do not arrive. (points, r)"""
        drives = self.simulated(points)
        states = (self._states(drives) - np.nan_to_num(self.record.values)) / self.sigma
        places = self._places(drives) - self.record.fix_m
        white = np.einsum("fij,mfj->mfi", self.record.whitening, places)
        count = len(points)
        rows = np.concatenate([np.where(self.known, states, 0.0).reshape(count, -1), white.reshape(count, -1)], axis=1)
        rows[~drives.finished] = np.inf
        return rows

    def parts(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those of states (n, 6), and of positions."""
        size = self.record.values.size
        return residual[:size].reshape(self.record.values.shape), residual[size:]

    def _states(self, drives: Prediction) -> FloatArray:
        columns = [STATE_COLUMNS.index(name) for name in OBSERVED]
        place = np.interp(self.record.time_s, drives.time_s, np.arange(len(drives.time_s)))
        low = np.minimum(place.astype(np.int64), len(drives.time_s) - 2)
        share = (place - low)[:, None]
        states = drives.states[..., columns]
        return np.asarray((1.0 - share) * states[:, low, self.wheel] + share * states[:, low + 1, self.wheel])

    def _places(self, drives: Prediction) -> FloatArray:
        place = np.interp(self.record.fix_time_s, drives.time_s, np.arange(len(drives.time_s)))
        low = np.minimum(place.astype(np.int64), len(drives.time_s) - 2)
        share = (place - low)[:, None]
        return np.asarray((1.0 - share) * drives.paths[:, low, :2] + share * drives.paths[:, low + 1, :2])
