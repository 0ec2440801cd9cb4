"""Whether states of a wheel, each solved by itself, tell one soil."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.identify import Estimate

LABELS = {
    "stiffness_kpa_m_n": "stiffness K_s",
    "exponent": "sinkage exponent N",
    "friction_angle_deg": "internal friction angle φ",
    "cohesion_pa": "cohesion c",
    "external_friction_angle_deg": "external friction angle φ_y",
    "lateral_modulus_mm": "lateral shear modulus K_y",
}
"""Parameters of the site in words."""
CONTRADICT, BY_CHANCE = 4.0, 0.001
"""States contradict each other where a parameter scatters twice as widely between them as its errors allow, and such
scatter has a smaller probability; assumed. Measured curves over slip have 6 to 200, states of one simulated soil 0."""
TREND, LEAST_STATES = 0.8, 4
"""Rank correlation with slip that is called a trend, from so many states on; assumed."""


@dataclass(frozen=True, slots=True)
class StatesAgreement:
    """Whether single states tell one value of a parameter.

    Attributes
    ----------
    parameter : its key.
    states : how many of them give a value.
    reduced_chi_square : of these values about their weighted mean, each with its own error.
    probability : of a larger one by chance.
    first, last : values at the least and the largest slip.
    trend : `falls` or `rises` with slip, '' for neither or where it cannot be told.
    """

    parameter: str
    states: int
    reduced_chi_square: float
    probability: float
    first: float
    last: float
    trend: str

    @property
    def agree(self) -> bool:
        """Whether one soil may have given them."""
        return self.reduced_chi_square < CONTRADICT or self.probability > BY_CHANCE

    @property
    def text(self) -> str:
        """In words, for those that do not agree."""
        how = f" {self.trend} with slip from" if self.trend else " from"
        first, last = (float(f"{value:.3g}") for value in (self.first, self.last))
        symbol = LABELS[self.parameter].rpartition(" ")[2]
        return f"{symbol}{how} {first:g} to {last:g}, chi-square {self.reduced_chi_square:.0f} a state"


def agreement(parameter: str, estimates: Sequence[Estimate], slip: FloatArray) -> StatesAgreement | None:
    """Of single states, with their slip, (n,); None where fewer than two have a value and an error."""
    from scipy.special import gammaincc

    pairs = [(e.value, e.sigma) if e.value is not None and e.sigma else (np.nan, np.nan) for e in estimates]
    value, sigma = np.array(pairs, float).reshape(-1, 2).T
    known = np.isfinite(value)
    value, weight, slip = value[known], 1 / sigma[known] ** 2, slip[known]
    degrees = len(value) - 1
    if degrees < 1:
        return None
    chi_square = float(np.sum(weight * (value - np.average(value, weights=weight)) ** 2))
    told = degrees + 1 >= LEAST_STATES and np.isfinite(slip).all() and np.ptp(slip) > 0 and np.ptp(value) > 0
    rank = float(np.corrcoef(slip.argsort().argsort(), value.argsort().argsort())[0, 1]) if told else 0.0
    trend = "" if abs(rank) < TREND else "rises" if rank > 0 else "falls"
    order = np.argsort(slip, kind="stable")
    ends = float(value[order[0]]), float(value[order[-1]])
    chance = float(gammaincc(degrees / 2, chi_square / 2))
    return StatesAgreement(parameter, degrees + 1, chi_square / degrees, chance, *ends, trend)
