"""What ground a rover may drive on: limits of slope, step, roughness, turning, and distance from hazards."""

import math
from dataclasses import dataclass, fields, replace

from lunarsci.errors import DataError, ParameterError
from lunarsci.rovers.description import RoverDescription
from lunarsci.twin.rover import Rover

__all__ = ["Mobility", "read_mobility"]

# Where a rover file has no [limits]: assumed, cautious for a rocker-bogie.
FALLBACK_SLOPE_DEG = 15.0
FALLBACK_STEP_IN_RADII = 1.0
FALLBACK_TURN_IN_TRACKS = 1.5
FALLBACK_DISTANCE_IN_TRACKS = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Mobility:
    """Limits of the ground and of the path of a rover.

    Attributes
    ----------
    max_slope_deg : steepest ground, as the tilt of a plane through the rover's footprint; 0 to 90, exclusive. [deg]
    max_step_m : highest step a wheel climbs, > 0. [m]
    max_roughness_m : largest rms residual about that plane, > 0; None where it is not limited. [m]
    min_turning_radius_m : of the path of the rover's origin, > 0. [m]
    hazard_distance_m : distance to keep between the footprint and what exceeds a limit or is unknown, >= 0. [m]
    assumed : names of the limits that are guesses.

    Raises ParameterError outside these ranges.
    """

    max_slope_deg: float
    max_step_m: float
    min_turning_radius_m: float
    hazard_distance_m: float
    max_roughness_m: float | None = None
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.max_slope_deg < 90:
            raise ParameterError(f"max_slope_deg is {self.max_slope_deg}; give a slope between 0 and 90 deg")
        for name in ("max_step_m", "min_turning_radius_m", "max_roughness_m"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ParameterError(f"{name} is {value}; give a length above 0 m")
        if not 0 <= self.hazard_distance_m < math.inf:
            raise ParameterError(f"hazard_distance_m is {self.hazard_distance_m}; give 0 m or more")

    def with_limits(self, **limits: float | None) -> "Mobility":
        """The same with some limits replaced where they are not None; these are no longer assumed."""
        stated = {name: value for name, value in limits.items() if value is not None}
        assumed = tuple(name for name in self.assumed if name not in stated)
        return replace(self, **stated, assumed=assumed)


def read_mobility(description: RoverDescription, rover: Rover) -> Mobility:
    """The [limits] table of a rover file; what it lacks is assumed from the size of the rover.

    Assumed are then a slope of 15 deg, a step of one wheel radius, a turning radius of 1.5 tracks and a distance from
    hazards of 0.2 tracks; roughness is not limited. Raises DataError.
    """
    table = description.tables.get("limits", {})
    names = [field.name for field in fields(Mobility) if field.name != "assumed"]
    if unknown := set(table) - set(names):
        raise DataError(f"{description.origin}: [limits] has no '{min(unknown)}'; these are: {', '.join(names)}")
    track = 2.0 * rover.rocker_pivot_y_m
    values: dict[str, float | None] = {
        "max_slope_deg": FALLBACK_SLOPE_DEG,
        "max_step_m": FALLBACK_STEP_IN_RADII * rover.wheel.radius_m,
        "min_turning_radius_m": FALLBACK_TURN_IN_TRACKS * track,
        "hazard_distance_m": FALLBACK_DISTANCE_IN_TRACKS * track,
    }
    assumed = {name for name in values if name not in table}
    assumed |= {key.removeprefix("limits.") for key in description.assumed if key.startswith("limits.")}
    try:
        values |= {name: float(value) for name, value in table.items()}
        return Mobility(**values, assumed=tuple(sorted(assumed)))  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise DataError(f"{description.origin}: [limits]: {error}") from error
