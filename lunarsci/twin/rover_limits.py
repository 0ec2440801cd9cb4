"""What no rover can be, and what none is: finds files whose numbers are in another unit than they should be."""

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.errors import LunarSciWarning, ParameterError, RequestError
from lunarsci.regolith.prior import LOAD_PRESSURE_PA, Law
from lunarsci.regolith.questions import Question, question

if TYPE_CHECKING:
    from lunarsci.twin.rover import Rover

DENSEST_KG_M3 = 22_600.0
"""Osmium, 22.59 g/cm3: CRC Handbook of Chemistry and Physics, 97th ed., Haynes (2016). [kg/m3]"""
BELLY_RADII = Law("ln", 2.1, 0.6, "1.5 to 2.4 of Lunokhod, MER, Curiosity and Yutu-2, 0.5 of RoSEy; width assumed")
"""Height of the belly above level ground, in radii of the wheels; assumed."""
AXLE_RADII = Law("ln", 4.0, 0.4, "2.5 to 6 of rovers that drove on the Moon and Mars; width assumed")
"""From one axle to the next, in radii of the wheels; assumed."""
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2}
"""In metres, by definition."""
MASS_UNITS = {"g": 1e-3, "t": 1e3}
"""In kilograms, by definition."""


def rover_questions(rover: "Rover") -> list[Question]:
    """Whether its belly is as high, its axles as far apart and its wheels as loaded as those of rovers are."""
    wheel, asked = rover.wheel, []
    apart = np.linalg.norm(np.diff(rover.wheel_positions_m[::2], axis=0), axis=1).max() / wheel.radius_m
    asked.append(question("axle to axle [wheel radii]", float(apart), AXLE_RADII, LENGTH_UNITS))
    pressure = rover.mass_kg * rover.gravity_m_s2 / len(rover.wheels) / (wheel.radius_m * wheel.width_m)
    asked.append(question("weight over the wheels' radius x width [Pa]", pressure, LOAD_PRESSURE_PA, MASS_UNITS))
    if rover.body is not None:
        level = rover.body.belly_z_m - float(rover.wheel_positions_m[:, 2].min()) + wheel.radius_m
        if level > 0:
            asked.append(question("belly over the ground [wheel radii]", level / wheel.radius_m, BELLY_RADII, {}))
    return [one for one in asked if one is not None]


def warn_of_unusual(rover: "Rover", called: str) -> None:
    """Warn of numbers that would be likely in another unit, or that no rover has."""
    for asked in rover_questions(rover):
        warnings.warn(f"{called}: {asked.doubt}", LunarSciWarning, stacklevel=3)


def check_limits(rover: "Rover") -> None:
    """Raises ParameterError for a rover that cannot be built, with the unit that is likely."""
    check_wheels(rover)
    _check_center(rover)
    _check_inertia(rover)
    _check_density(rover)


def check_wheels(rover: "Rover") -> None:
    """Raises ParameterError for wheels that overlap."""
    wheel, places = rover.wheel, rover.wheel_positions_m[::2]
    outer = wheel.radius_m + wheel.grouser_height_m
    gaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if 2.0 * outer > gaps.min():
        raise ParameterError(
            f"wheels of {2 * outer:.3g} m across do not fit {gaps.min():.3g} m from one axle to the next; they meet "
            "(is wheel.radius_m a diameter, or in mm?)"
        )
    if wheel.width_m > 2.0 * (rover.rocker_pivot_y_m + rover.steering_offset_m):
        raise ParameterError(
            f"wheels {wheel.width_m:.3g} m wide meet in the middle of the rover; is wheel.width_m in mm?"
        )


def check_speed(rover: "Rover") -> None:
    """Raises ParameterError for a top speed beyond that of wheels that turn without load."""
    if rover.motors is None:
        return
    reached = rover.motors.no_load_rate_rad_s * (rover.wheel.radius_m + rover.wheel.grouser_height_m)
    if rover.max_speed_m_s > reached:
        raise ParameterError(
            f"max_speed_m_s is {rover.max_speed_m_s:g}, but motors without load reach {reached:.3g} m/s; is it in mm/s?"
        )


def check_turning(rover: "Rover", radius_m: float | None) -> None:
    """Raises RequestError for arcs that a rover cannot drive: their centre would lie between its wheels."""
    least = 1.0 / rover.tightest_curvature_per_m
    if radius_m is not None and not radius_m >= least * (1 - 1e-9):
        raise RequestError(
            f"`turning_radius` is {radius_m:g} m, and the smallest arc of {rover.name} has {least:.3g} m: within it "
            f"the turning centre lies between the wheels; give {math.ceil(100 * least) / 100:g} m or more"
        )


def _size_m(rover: "Rover") -> tuple[float, float]:
    """Length and width over the outer edges of the wheels. [m]"""
    span = np.ptp(rover.wheel_positions_m, axis=0)
    outer = 2.0 * (rover.wheel.radius_m + rover.wheel.grouser_height_m)
    return float(span[0]) + outer, float(span[1]) + rover.wheel.width_m


def _height_m(rover: "Rover") -> float:
    """Height of the chassis' centre of mass above the ground that the wheels stand on. [m]"""
    outer = rover.wheel.radius_m + rover.wheel.grouser_height_m
    return float(rover.body_center_m[2] - rover.wheel_positions_m[:, 2].min() + outer)


def _check_center(rover: "Rover") -> None:
    """The rover stands: its centre of mass lies between the wheels, no higher than the rover is long or wide."""
    places, shares = rover.wheel_positions_m, (rover.body_kg, rover.wheel_kg)
    center = (shares[0] * np.array(rover.body_center_m) + shares[1] * places.sum(axis=0)) / rover.mass_kg
    low, high = places.min(axis=0)[:2], places.max(axis=0)[:2]
    given = f"body_center_m is {list(rover.body_center_m)}"
    if (center[:2] < low).any() or (center[:2] > high).any():
        raise ParameterError(f"{given}: the rover falls over, its centre of mass is not between its wheels; in mm?")
    if not 0 < _height_m(rover) <= max(_size_m(rover)):
        raise ParameterError(
            f"{given}: {_height_m(rover):.3g} m above the ground, for a rover {max(_size_m(rover)):.3g} m long or wide;"
            " is it in mm?"
        )


def _check_inertia(rover: "Rover") -> None:
    """Moments of a body obey I1 + I2 >= I3; its mass is not further from its centre than the rover is large."""
    moments = sorted(rover.body_inertia_kg_m2)
    given = f"body_inertia_kg_m2 is {list(rover.body_inertia_kg_m2)}"
    if moments[0] + moments[1] < moments[2] * (1 - 1e-6):
        raise ParameterError(f"{given}; of no body is one moment more than the sum of the others")
    largest = math.hypot(*_size_m(rover))
    if moments[2] > rover.body_kg * largest**2:
        raise ParameterError(f"{given}: more than {rover.body_kg:g} kg have {largest:.3g} m away; is it in g cm2?")


def _check_density(rover: "Rover") -> None:
    """Neither a wheel nor the box about the rover is denser than osmium."""
    wheel, (length, width) = rover.wheel, _size_m(rover)
    disc = math.pi * (wheel.radius_m + wheel.grouser_height_m) ** 2 * wheel.width_m
    box = length * width * 2.0 * _height_m(rover)
    for name, mass, volume in (("wheel_kg", rover.wheel_kg, disc), ("body_kg", rover.body_kg, box)):
        if mass > DENSEST_KG_M3 * volume:
            raise ParameterError(f"{name} is {mass:g} in {volume:.3g} m3, denser than osmium; is it in g?")
