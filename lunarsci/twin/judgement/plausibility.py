"""What no Moon and no rover of this size has: questions about the heights of a terrain and the numbers of a rover."""

import math

import numpy as np

from lunarsci.regolith.prior import LOAD_PRESSURE_PA, Law
from lunarsci.regolith.questions import Question, question
from lunarsci.regolith.soil import known_soils, read_soil, unusual
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.ground.unresolved import lunar_relief
from lunarsci.twin.rover import Rover

SLOPE_SD = 1.0
"""Standard deviation of the logarithm of median slopes of maps about that of the law: assumed, flat maria to crater
walls."""
HEIGHT_UNITS = {"km": 1e3, "cm": 1e-2, "mm": 1e-3}
"""In metres, by definition; feet and decimetres make slopes that the Moon has, too."""
BELLY_RADII = Law("ln", 2.1, 0.3, "1.5 to 2.4 of Lunokhod, Sojourner, MER, Curiosity and Yutu-2; assumed")
"""Height of the belly above level ground, in radii of the wheels; assumed."""
MASS_UNITS = {"g": 1e-3, "t": 1e3}
"""In kilograms, by definition."""


def terrain_questions(terrain: Terrain) -> list[Question]:
    """Whether its median slope is one of the Moon at its spacing, or would be in another unit of heights."""
    height = terrain.height_m
    slope = np.hypot(np.diff(height, axis=0)[:, :-1], np.diff(height, axis=1)[:-1]) / terrain.spacing_m
    known = slope[np.isfinite(slope)]
    if not known.size:
        return []
    relief, _ = lunar_relief()
    usual = math.sqrt(relief.at_one_m * 2.0 * math.log(2.0)) * terrain.spacing_m ** (relief.hurst - 1.0)
    law, median = Law("ln", usual, SLOPE_SD), float(np.median(known))
    asked = question("median slope of the terrain [m/m]", median, law, HEIGHT_UNITS, "--height-unit m")
    # Ground may be as level as it will: only another unit makes it doubtful.
    return [asked] if asked is not None and asked.likely_unit else []


def rover_questions(rover: Rover) -> list[Question]:
    """Whether its belly is as high, and its wheels as loaded, as those of rovers are."""
    wheel, asked = rover.wheel, []
    pressure = rover.mass_kg * rover.gravity_m_s2 / len(rover.wheels) / (wheel.radius_m * wheel.width_m)
    asked.append(question("weight over the wheels' radius x width [Pa]", pressure, LOAD_PRESSURE_PA, MASS_UNITS))
    if rover.body is not None:
        level = rover.body.belly_z_m - float(rover.wheel_positions_m[:, 2].min()) + wheel.radius_m
        if level > 0:
            asked.append(question("belly over the ground [wheel radii]", level / wheel.radius_m, BELLY_RADII, {}))
    return [one for one in asked if one is not None]


def questions_of(terrain: Terrain | None, rover: Rover, soil: str | None) -> tuple[Question, ...]:
    """What to ask of a drive's terrain, rover and soil, none of those that come with lunarsci.

    `terrain` is None where the unit of its heights is known, `soil` where each drive has its own.
    """
    found = rover_questions(rover) + ([] if terrain is None else terrain_questions(terrain))
    if soil is not None and soil not in known_soils():
        found += unusual(read_soil(soil), soil)
    return tuple(found)
