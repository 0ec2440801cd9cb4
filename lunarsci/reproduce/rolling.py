"""The slip at which a rover rolls steadily down a slope: six equal wheels, no terrain, no rover between them."""

import math
from dataclasses import dataclass

from lunarsci.regolith.forces import wheel_forces
from lunarsci.regolith.load import sinkage_under_load
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import Wheel
from lunarsci.twin.rover import Rover

__all__ = ["Rolling"]

STEEPEST_DEG = 30.0
SLIPS = (-0.6, 0.6)


@dataclass(frozen=True, slots=True)
class Rolling:
    """A rover whose wheels share its weight equally and hold it back or push it alike, reading `signed`.

    Attributes
    ----------
    wheel : of the rover.
    weight_n : of the rover on each wheel, > 0. [N]
    """

    wheel: Wheel
    weight_n: float

    @classmethod
    def of(cls, rover: Rover) -> "Rolling":
        """The mean wheel of a rover."""
        return cls(rover.wheel, rover.mass_kg * rover.gravity_m_s2 / len(rover.wheels))

    def surplus_n(self, soil: Soil, slope_deg: float, slip_ratio: float) -> float:
        """Force along a slope, downhill positive, that speeds a wheel up at a slip ratio; 0 in steady rolling. [N]"""
        slope = math.radians(slope_deg)
        sinkage = sinkage_under_load(self.wheel, soil, self.weight_n * math.cos(slope), slip_ratio)
        pull = wheel_forces(self.wheel, soil, sinkage, slip_ratio).drawbar_pull_n
        return float(pull) + self.weight_n * math.sin(slope)

    def slip_ratio(self, soil: Soil, slope_deg: float) -> float:
        """Slip ratio of steady rolling down a slope, negative for skid. [-]

        Raises ValueError where no slip within 0.6 balances the weight.
        """
        from scipy.optimize import brentq

        return float(brentq(lambda slip: self.surplus_n(soil, slope_deg, slip), *SLIPS, xtol=1e-9))

    def slope_deg(self, soil: Soil, slip_ratio: float) -> float:
        """Slope down which a wheel rolls steadily at a slip ratio; negative is uphill. [deg]

        Raises ValueError where none within 30 deg does.
        """
        from scipy.optimize import brentq

        span = (-STEEPEST_DEG, STEEPEST_DEG)
        return float(brentq(lambda slope: self.surplus_n(soil, slope, slip_ratio), *span, xtol=1e-9))
