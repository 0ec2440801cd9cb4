"""What the twin's physics may be off by, alike for all wheels or for one of them throughout a drive."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.inference.drive_record import OBSERVED

__all__ = ["MODEL_SHARES", "Discrepancy", "Removed"]

FloatArray = npt.NDArray[np.float64]


MODEL_SHARES = {
    "sinkage_m": 0.06,
    "slip_ratio": 0.25,
    "side_slip_deg": 0.20,
    "drawbar_pull_n": 0.015,
    "lateral_force_n": 0.06,
}
"""Error that all wheels share, of each quantity, as a share of its size: what the closed form differs by from the full
stress integrals on the same soil, measured once, over nine hidden soils, with the truth of
`tests/benchmarks/other_physics.py`. Loads follow from the suspension's levers and are not concerned."""


SHARED = 0.5**0.5
"""Of an error's share for the part that is constant, and for the one that goes with the quantity."""


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Standard deviations of errors that stay the same throughout a drive.

    Attributes
    ----------
    common : by quantity, of errors that all wheels share: one constant, as a share of the quantity's mean size, and one
        that goes with the quantity. [-]
    wheels : by quantity, of one that each wheel has of its own, in the errors of its values. [-]

    Raises ParameterError for negative shares and unknown quantities.
    """

    common: Mapping[str, float] = field(default_factory=lambda: MODEL_SHARES)
    wheels: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in (*self.common.items(), *self.wheels.items()):
            if name not in OBSERVED or not 0 <= value < np.inf:
                raise ParameterError(f"model error of '{name}' is {value}; give 0 or more of {', '.join(OBSERVED)}")

    def removed(
        self,
        values: FloatArray,
        sigma: FloatArray,
        wheel: npt.NDArray[np.int64],
        way: FloatArray,
        whitening: FloatArray,
        expected: FloatArray,
    ) -> "Removed":
        """For a record.

        Parameters
        ----------
        values, sigma, wheel : measured, NaN where they do not count; their errors; number of their wheel. (n, 6), (n,)
        way, whitening : from the start to each position; its whitening. (f, 2), (f, 2, 2)
        expected : values without their noise, also of quantities that were not measured. (n, 6)

        An error of the slip that all wheels share shortens the way, one of the side slip turns it.
        """
        columns = []
        for k, name in enumerate(OBSERVED):
            known, measured = np.isfinite(values[:, k]), np.isfinite(expected[:, k])
            if self.common.get(name) and measured.any():
                sizes = SHARED * self.common[name] * np.where(measured, expected[:, k], 0.0)
                for own in (np.full(len(sizes), np.abs(sizes[measured]).mean()), sizes):
                    states = _states(values.shape, k, known * own / sigma[:, k])
                    moved = own[measured].mean() * _moved(name, way)
                    columns.append(np.append(states, np.einsum("fij,fj->fi", whitening, moved)))
            if self.wheels.get(name):
                for w in np.unique(wheel):
                    states = _states(values.shape, k, self.wheels[name] * (known & (wheel == w)))
                    columns.append(np.append(states, np.zeros(way.size)))
        if not columns:
            return Removed(np.zeros((values.size + way.size, 0)), np.zeros(0))
        left, sizes, _ = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
        return Removed(left, sizes)


def _states(shape: tuple[int, ...], k: int, own: FloatArray) -> FloatArray:
    column = np.zeros(shape)
    column[:, k] = own
    return column.ravel()


def _moved(name: str, way: FloatArray) -> FloatArray:
    """How far places move for a unit of a quantity. (f, 2) [m]"""
    if name == "slip_ratio":
        return -way
    if name == "side_slip_deg":
        return np.asarray(np.radians(1.0) * np.column_stack([-way[:, 1], way[:, 0]]))
    return np.zeros(way.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Removed:
    """Whitening of residuals whose covariance is I + B B^T, from the singular vectors and values of B. (r, c), (c,)

    Residuals along B count as much less as their errors are larger than those of single values.
    """

    vectors: FloatArray
    sizes: FloatArray

    def applied(self, rows: FloatArray) -> FloatArray:
        """(..., r)"""
        share = 1.0 - 1.0 / np.sqrt(1.0 + self.sizes**2)
        return np.asarray(rows - ((rows @ self.vectors) * share) @ self.vectors.T)

    def undone(self, rows: FloatArray) -> FloatArray:
        """The residuals that `applied` gave these of. (..., r)"""
        share = np.sqrt(1.0 + self.sizes**2) - 1.0
        return np.asarray(rows + ((rows @ self.vectors) * share) @ self.vectors.T)
