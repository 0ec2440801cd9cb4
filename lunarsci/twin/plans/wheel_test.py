"""One wheel that is made to slip on purpose while the rover drives on."""

from dataclasses import dataclass

from lunarsci.errors import ParameterError
from lunarsci.twin.rover import Rover

LEAST_RATIO, MOST_RATIO = 0.2, 3.0
"""Of a wheel test: a slip ratio between -0.8 and 0.67 where the rover keeps its speed; assumed."""


@dataclass(frozen=True, slots=True)
class WheelTest:
    """One wheel that turns slower or faster than it would without slip, while the others drive on: it slips on purpose.

    Attributes
    ----------
    wheel : FL, FR, ML, MR, RL or RR, as `Rover.wheels` has them.
    rate_ratio : its rate over the one with which it would not slip, 0.2 to 3, not 1. [-]
    """

    wheel: str
    rate_ratio: float

    def __post_init__(self) -> None:
        if not LEAST_RATIO <= self.rate_ratio <= MOST_RATIO or self.rate_ratio == 1:
            raise ParameterError(
                f"wheel_test rate_ratio is {self.rate_ratio}; give {LEAST_RATIO:g} to {MOST_RATIO:g}, and not 1"
            )


def check_wheel_test(test: WheelTest, speed_m_s: float, rover: Rover, where: str) -> None:
    """Raises ParameterError, beginning with `where`, for a wheel that the rover has not, or that cannot turn so fast.

    `speed_m_s` is the rover's.
    """
    if test.wheel not in rover.wheels:
        raise ParameterError(
            f"{where}wheel_test wheel is '{test.wheel}'; the wheels of {rover.name} are {', '.join(rover.wheels)}"
        )
    fastest = rover.max_speed_m_s
    if rover.motors is not None:
        fastest = max(fastest, rover.motors.no_load_rate_rad_s * rover.wheel.shearing_radius_m)
    if (rim := test.rate_ratio * speed_m_s) > fastest:
        raise ParameterError(
            f"{where}wheel_test lets wheel {test.wheel} roll at {rim:.3g} m/s; those of {rover.name} reach "
            f"{fastest:.3g} m/s, so give a smaller rate_ratio or a slower plan"
        )
