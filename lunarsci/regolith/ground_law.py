"""From the effective values that a belief holds to the ground's own: what other physics would make of the same soil.

A belief of drives holds the values that the twin's law needs to move as the rover did: effective values, good for
predictions with this law. Stress integrals, ruts, or a soil that changes move the rover alike with other values, and
so the ground's own, which another instrument would measure, are known less well.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.prior import PARAMETERS, values_of

__all__ = ["OTHER_PHYSICS", "GroundInterval", "ground_intervals", "ground_moments", "parameter_rows"]

FloatArray = npt.NDArray[np.float64]
OTHER_PHYSICS: Mapping[str, float] = MappingProxyType(
    {
        "stiffness_kpa_m_n": 0.7,
        "sinkage_exponent": 0.4,
        "sinkage_exponent_slip": 1.9,
        "cohesion_pa": 0.7,
        "friction_angle_deg": 1.0,
        "shear_modulus_mm": 0.4,
        "external_friction_angle_deg": 0.6,
        "lateral_modulus_mm": 0.5,
    }
)
"""Standard deviation between effective and own values, in widths of the first laws: the most probable of 19 updates by
stress integrals, ruts and changing soils, drawn towards their common 0.8, on the grounds and soils that
`tests/benchmarks/loop.py --training --seed 1701` drives on, which no reported number is of. [-]"""
NINETY_FIVE = 1.959964


@dataclass(frozen=True, slots=True)
class GroundInterval:
    """One parameter of the ground itself, in its unit: median, and limits at 68 and 95 %."""

    median: float
    low_68: float
    high_68: float
    low_95: float
    high_95: float


def ground_moments(belief: SoilBelief) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the transforms of the ground's own values, each by itself. (8,), (8,)

    What the drives say, which is the belief without its first law, is widened by what other physics would change, and
    joined with the first law again; so no interval is wider than before any drive.
    """
    center = np.array([belief.laws[name].center for name in PARAMETERS])
    width = np.array([belief.laws[name].width for name in PARAMETERS])
    off, variance = (belief.mean - center) / width, np.diag(belief.covariance) / width**2
    told = np.maximum(1.0 / variance - 1.0, 1e-9)
    said = off / variance / told
    other = np.array([OTHER_PHYSICS[name] for name in PARAMETERS])
    weight = 1.0 / (1.0 / told + other**2)
    own = 1.0 / (1.0 + weight)
    return center + width * own * weight * said, width * np.sqrt(own)


def ground_intervals(belief: SoilBelief) -> dict[str, GroundInterval]:
    """Median and limits of each parameter of the ground itself, in its unit."""
    mean, spread = ground_moments(belief)
    points = np.stack([mean + k * spread for k in (0.0, -1.0, 1.0, -NINETY_FIVE, NINETY_FIVE)])
    rows = values_of(belief.laws, points)
    return {name: GroundInterval(*map(float, column)) for name, column in zip(PARAMETERS, rows.T, strict=True)}


def parameter_rows(belief: SoilBelief) -> dict[str, dict[str, float]]:
    """By parameter: effective median and 68 % interval, posterior over prior standard deviation, and the ground's own.

    Keys `median`, `low`, `high`, `left_of_prior`, and `ground_` with those of `GroundInterval`.
    """
    left, ground = belief.left_of_prior, ground_intervals(belief)
    return {
        name: {"median": median, "low": low, "high": high, "left_of_prior": left[name]}
        | {f"ground_{key}": value for key, value in asdict(ground[name]).items()}
        for name, (median, low, high) in belief.intervals().items()
    }
