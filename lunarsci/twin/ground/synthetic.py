"""Made-up ground of stated slope, craters, rocks and roughness."""

import math

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.twin.ground.longji import crater_height, roughness
from lunarsci.twin.ground.rocks import scatter_rocks
from lunarsci.twin.ground.terrain import Terrain, build_terrain

__all__ = ["synthetic_terrain"]

FloatArray = npt.NDArray[np.float64]
MOST_NODES = 4_000_000
SMALLEST_CRATER_M = 1.0


def synthetic_terrain(
    soil: Soil | None = None,
    *,
    seed: int = 0,
    spacing_m: float = 0.05,
    extent_m: float = 20.0,
    slope_deg: float = 0.0,
    craters: int = 8,
    rock_share: float = 0.0,
    rms_m: float = 0.004,
) -> Terrain:
    """A square of made-up ground about the origin.

    Parameters
    ----------
    soil : the same everywhere; `lunar-typical` by default.
    seed : of craters, rocks and roughness.
    spacing_m : grid spacing, 0.01 to 1; at most 4 million nodes. [m]
    extent_m : side of the square, 4 to 1000. [m]
    slope_deg : of the plain, rising along x; -45 to 45. [deg]
    craters : their number, 0 to 10000; 1 m to a third of the extent across, their cumulative number falling with the
        square of the diameter (assumed), shaped as in `crater_height`.
    rock_share : of the ground covered by rocks, 0 to 0.1 (see `scatter_rocks`).
    rms_m : roughness at wavelengths of 0.4 to 4 m, 0 to 0.05. [m]

    Raises ParameterError outside these ranges.
    """
    ranges = (
        ("spacing_m", spacing_m, 0.01, 1.0),
        ("extent_m", extent_m, 4.0, 1000.0),
        ("slope_deg", slope_deg, -45.0, 45.0),
        ("craters", craters, 0, 10_000),
        ("rms_m", rms_m, 0.0, 0.05),
        ("seed", seed, 0, math.inf),
    )
    for name, value, low, high in ranges:
        if not low <= value <= high:
            raise ParameterError(f"{name} is {value}; give {low:g} to {high:g}")
    half = math.floor(0.5 * extent_m / spacing_m + 1e-9)
    if (2 * half + 1) ** 2 > MOST_NODES:
        raise ParameterError(
            f"{2 * half + 1} x {2 * half + 1} nodes are more than {MOST_NODES}; take a wider spacing_m or less extent_m"
        )
    axis = spacing_m * np.arange(-half, half + 1, dtype=float)
    x, y = axis[None, :], axis[:, None]
    height = roughness(x, y, rms_m, seed) + math.tan(math.radians(slope_deg)) * x
    for center_x, center_y, diameter in _craters(craters, extent_m, seed):
        # Beyond three radii the crater is lower than a millionth of its depth.
        columns, rows = (
            slice(*np.searchsorted(axis, (middle - 1.5 * diameter, middle + 1.5 * diameter)))
            for middle in (center_x, center_y)
        )
        distance = np.hypot(axis[None, columns] - center_x, axis[rows, None] - center_y)
        height[rows, columns] += crater_height(distance, diameter)
    if rock_share:
        height = scatter_rocks(axis, axis, height, rock_share, seed)
    soil = soil or read_soil("lunar-typical")
    return build_terrain(
        f"synthetic ground, seed {seed}", float(axis[0]), float(axis[0]), spacing_m, height, soil, synthetic=True
    )


def _craters(count: int, extent_m: float, seed: int) -> FloatArray:
    """x, y and diameter of each crater. (count, 3) [m]"""
    random = np.random.default_rng((seed, 2))
    low, high = SMALLEST_CRATER_M**-2, (extent_m / 3.0) ** -2
    diameter = (high + (low - high) * random.random(count)) ** -0.5
    return np.column_stack([(random.random((count, 2)) - 0.5) * extent_m, diameter])
