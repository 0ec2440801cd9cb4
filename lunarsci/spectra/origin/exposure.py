"""How long rocks last on the surface."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["MEASURED_SIZE_M", "SURVIVAL_SOURCE", "Range", "survival", "survival_shape"]

SURVIVAL_SOURCE = "Basilevsky, Head & Hoerz (2013), Planet. Space Sci. 89, 118, 10.1016/j.pss.2013.07.011"
MEASURED_SIZE_M = 2.0
"""Boulders of this size and more were counted by Basilevsky et al. (2013). [m]"""
NEARLY_ALL_GONE = 0.99
LIFE_RATIO = 3.75
"""Time to destroy 99 % of boulders over that to destroy half: 150-300 Ma over 40-80 Ma, Basilevsky et al. (2013)."""


@dataclass(frozen=True, slots=True)
class Range:
    """A quantity of which only the range is known: uniform in its logarithm. Both ends above 0; else ParameterError."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (0 < self.low <= self.high < np.inf):
            raise ParameterError(f"range {self.low:g} to {self.high:g} must rise, from above 0")

    def quantile(self, share: npt.ArrayLike) -> FloatArray:
        """Value below which this share (0 to 1) lies."""
        return np.asarray(self.low * (self.high / self.low) ** np.asarray(share, float))


def survival_shape() -> float:
    """Exponent k of the survival law, from the two published times: ln(ln 100 / ln 2) / ln 3.75 = 1.43."""
    return float(np.log(np.log(1 / (1 - NEARLY_ALL_GONE)) / np.log(2)) / np.log(LIFE_RATIO))


def survival(
    age_ma: npt.ArrayLike,
    median_life_ma: npt.ArrayLike,
    size_m: float = MEASURED_SIZE_M,
    size_exponent: float = 0.0,
) -> FloatArray:
    """Share of rocks that are left after lying on the surface for `age_ma`. [-]

    S = 2^-(age / life)^k with k of `survival_shape`, which passes through half at the median life and 1 % at 3.75
    lives (Basilevsky, Head & Hoerz 2013, boulders of 2 m and more). For other sizes the life is `median_life_ma`
    (size / 2 m)^`size_exponent`; no count constrains that exponent below 2 m. Raises ParameterError for a size of 0 or
    below.
    """
    if not 0 < size_m < np.inf:
        raise ParameterError(f"size of the rock is {size_m:g} m; it must be above 0")
    life = np.asarray(median_life_ma, float) * (size_m / MEASURED_SIZE_M) ** size_exponent
    return np.asarray(np.exp2(-((np.asarray(age_ma, float) / life) ** survival_shape())))
