"""The slip at which a rover rolls steadily down a slope: six equal wheels, no terrain, no rover between them."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from lunarsci.errors import ParameterError
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

        Raises ParameterError where no slip within 0.6 balances the weight.
        """
        text = f"no slip within {SLIPS[1]} lets {self.weight_n:.1f} N a wheel roll steadily down {slope_deg:g} deg"
        return _root(lambda slip: self.surplus_n(soil, slope_deg, slip), SLIPS, text)

    def slope_deg(self, soil: Soil, slip_ratio: float) -> float:
        """Slope down which a wheel rolls steadily at a slip ratio; negative is uphill. [deg]

        Raises ParameterError where none within 30 deg does.
        """
        text = f"on no slope within {STEEPEST_DEG:g} deg {self.weight_n:.1f} N a wheel roll at a slip of {slip_ratio:g}"
        return _root(lambda slope: self.surplus_n(soil, slope, slip_ratio), (-STEEPEST_DEG, STEEPEST_DEG), text)


def _root(function: Callable[[float], float], span: tuple[float, float], text: str) -> float:
    from scipy.optimize import brentq

    if function(span[0]) * function(span[1]) > 0:
        raise ParameterError(f"{text}; take another rover or soil")
    return float(brentq(function, *span, xtol=1e-9))
