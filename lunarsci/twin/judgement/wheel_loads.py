"""What each wheel carried and pulled along a drive, as a few numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import STATE_COLUMNS

__all__ = ["QUANTITIES", "Spread", "WheelLoads", "wheel_loads"]

FloatArray = npt.NDArray[np.float64]
QUANTITIES = (
    "normal_force_n",
    "drawbar_pull_n",
    "lateral_force_n",
    "resistance_torque_nm",
    "sinkage_m",
    "slip_ratio",
    "side_slip_deg",
)


@dataclass(frozen=True, slots=True)
class Spread:
    """Of one quantity over the poses of a drive, and over the members of an ensemble, all counted alike."""

    mean: float
    min: float
    p05: float
    p50: float
    p95: float
    max: float


@dataclass(frozen=True, slots=True)
class WheelLoads:
    """One wheel: quantity, with its unit, to its spread; and in how many of its states the wheel model holds. [-]"""

    wheel: str
    quantities: dict[str, Spread]
    valid_share: float


def wheel_loads(wheels: Sequence[str], states: FloatArray) -> list[WheelLoads]:
    """Summaries of wheel states (..., wheels, 10), columns `STATE_COLUMNS`; states that are no numbers are left out.

    Empty where no state is a number.
    """
    flat = states.reshape(-1, len(wheels), states.shape[-1])
    flat = flat[np.isfinite(flat).all(axis=(1, 2))]
    if not len(flat):
        return []
    valid = flat[..., STATE_COLUMNS.index("valid")].mean(axis=0)
    return [
        WheelLoads(
            wheel, {name: _spread(flat[:, k, STATE_COLUMNS.index(name)]) for name in QUANTITIES}, float(valid[k])
        )
        for k, wheel in enumerate(wheels)
    ]


def _spread(values: FloatArray) -> Spread:
    p05, p50, p95 = np.percentile(values, (5, 50, 95))
    return Spread(float(values.mean()), float(values.min()), float(p05), float(p50), float(p95), float(values.max()))
