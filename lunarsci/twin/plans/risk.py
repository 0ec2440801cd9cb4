"""The chance that a drive fails, counted over drives, and the chance of it that is accepted.

A drive fails that breaks a limit, misses its target or does not end.
"""

import math
from dataclasses import dataclass

from scipy.special import betaincinv

from lunarsci.errors import ParameterError
from lunarsci.ranges import CHANCE, check_range

CONFIDENCE = 0.95
"""Of each of the two bounds of a chance that are given."""


@dataclass(frozen=True, slots=True)
class Chance:
    """Chance of failing, of so many drives that did.

    Attributes
    ----------
    failed, drives : how many of how many broke a limit or did not end.

    With the law of Jeffreys, Beta(failed + 1/2, drives - failed + 1/2): its mean is what is promised, its quantiles 5 %
    and 95 % are the bounds (Brown, Cai & DasGupta 2001, Statist. Sci. 16, 101, 10.1214/ss/1009213286). These hold the
    number of drives alone, not what soils, ground and physics of the twin are wrong about beyond what was drawn.
    """

    failed: int
    drives: int

    def __post_init__(self) -> None:
        if not 0 <= self.failed <= self.drives or self.drives < 1:
            raise ParameterError(f"{self.failed} of {self.drives} drives failed; give at least one, and no more failed")

    @property
    def risk(self) -> float:
        """Chance of failing, the mean of its law. [-]"""
        return (self.failed + 0.5) / (self.drives + 1.0)

    @property
    def low(self) -> float:
        """It is above this with 95 %. [-]"""
        return self._quantile(1.0 - CONFIDENCE) if self.failed else 0.0

    @property
    def high(self) -> float:
        """It is below this with 95 %. [-]"""
        return self._quantile(CONFIDENCE) if self.failed < self.drives else 1.0

    def _quantile(self, share: float) -> float:
        return float(betaincinv(self.failed + 0.5, self.drives - self.failed + 0.5, share))

    def to_dict(self) -> dict[str, float]:
        """For a result."""
        return {
            "drives": self.drives, "failed": self.failed, "probability": 1.0 - self.risk, "risk": self.risk,
            "risk_low": self.low, "risk_high": self.high,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class AcceptedRisk:
    """Chance of failing that is accepted: what `--risk` asks for, and what the plan of a chosen drive carries.

    Attributes
    ----------
    share : above 0 and below 1, else ParameterError is raised. [-]
    """

    share: float

    def __post_init__(self) -> None:
        check_range("accepted risk", self.share, CHANCE)

    @property
    def least_drives(self) -> int:
        """Drives without a failure that are needed to promise it."""
        return max(1, math.ceil(0.5 / self.share - 1.0 - 1e-9))

    @property
    def keeping(self) -> float:
        """Share of the drives that must keep each limit. [-]"""
        return 1.0 - self.share

    def accepts(self, chance: Chance) -> bool:
        """Whether drives that fail with such a chance are safe enough."""
        return chance.risk <= self.share


USUAL = AcceptedRisk(0.05)
"""Where none is given, with --risk or in the plan: of a mission as a whole, and of each limit of a drive; assumed."""
