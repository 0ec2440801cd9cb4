"""Rocks for synthetic ground, with an exponential size-frequency distribution."""

import math

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError

__all__ = ["LARGEST_M", "SCALE_M", "SHARE_AT_CHANGE_4", "SMALLEST_M", "rocks_per_m2", "scatter_rocks"]

FloatArray = npt.NDArray[np.float64]

SHARE_AT_CHANGE_4 = 0.0021
"""Share of the ground that rocks cover at the landing site of Chang'E-4: Wu et al. (2021), EPSL 553, 116666."""
SCALE_M = 0.2
"""Decay length of the covered area with diameter: assumed. [m]"""
SMALLEST_M, LARGEST_M = 0.1, 2.0
"""Diameters that are laid: assumed; smaller ones are roughness. [m]"""
HEIGHT_TO_DIAMETER = 0.5
"""A rock is half an ellipsoid of this height to diameter: assumed."""
LARGEST_SHARE = 0.1


def rocks_per_m2(share: float, diameter_m: npt.ArrayLike) -> FloatArray:
    """Number of rocks of at least a diameter on a square metre, up to 2 m. [1/m2]

    The area share covered by rocks of diameter >= D is F(D) = share exp(-D / 0.2 m), the exponential form of Golombek
    & Rapp (1997), JGR 102, 4117, 10.1029/96JE03319, which also holds at the landing site of Chang'E-3 (Di et al. 2016,
    Planet. Space Sci. 120, 103, 10.1016/j.pss.2015.11.012). The decay length is assumed: theirs, 1 / (1.79 + 0.152 /
    share) m, is for Mars at shares of 0.05 to 0.4 and would leave next to no rock above 10 cm at a share of 0.002. The
    number is the integral of -F'(D) / (pi D^2 / 4).
    """
    from scipy.special import exp1

    def below(diameter: FloatArray) -> FloatArray:
        # The integral of exp(-x) / x^2 from x up is exp(-x) / x - E1(x).
        x = diameter / SCALE_M
        return np.asarray(np.exp(-x) / x - exp1(x))

    diameter = np.minimum(np.asarray(diameter_m, dtype=float), LARGEST_M)
    return 4.0 * share / (math.pi * SCALE_M**2) * (below(diameter) - below(np.asarray(LARGEST_M)))


def scatter_rocks(
    x_m: FloatArray, y_m: FloatArray, height_m: FloatArray, share: float, seed: int, clear_m: float = 1.5
) -> FloatArray:
    """The ground with rocks of 0.1 to 2 m on it; none within `clear_m` of the origin, where a drive begins.

    Parameters
    ----------
    x_m, y_m, height_m : columns (nx,), rows (ny,) and heights (ny, nx) of the ground. [m]
    share : of the ground that rocks of any size would cover, 0 to 0.1; 0.0021 at the site of Chang'E-4.
    seed : of places and sizes; the same rocks come on any grid of the same extent.

    Rocks are round, stand on their middle and may overlap. A grid coarser than a rock may miss it. Raises
    ParameterError outside the range.
    """
    if not 0 <= share <= LARGEST_SHARE:
        raise ParameterError(f"the share of rocks is {share}; give 0 to {LARGEST_SHARE} of the ground")
    random = np.random.default_rng((seed, 1))
    width, depth = float(x_m[-1] - x_m[0]), float(y_m[-1] - y_m[0])
    sizes = np.geomspace(SMALLEST_M, LARGEST_M, 400)
    numbers = rocks_per_m2(share, sizes)
    count = random.poisson(numbers[0] * width * depth)
    diameters = np.interp(random.random(count) * numbers[0], numbers[::-1], sizes[::-1])
    places = random.random((count, 2)) * (width, depth) + (x_m[0], y_m[0])
    height = height_m.copy()
    for (x, y), diameter in zip(places, diameters, strict=True):
        if math.hypot(x, y) > clear_m + 0.5 * diameter:
            _lay_rock(height, x_m, y_m, (x, y), 0.5 * diameter)
    return height


def _lay_rock(height: FloatArray, x_m: FloatArray, y_m: FloatArray, center: tuple[float, float], radius: float) -> None:
    columns, rows = (
        slice(*np.searchsorted(axis, (middle - radius, middle + radius)))
        for axis, middle in zip((x_m, y_m), center, strict=True)
    )
    square = ((x_m[columns] - center[0]) ** 2)[None, :] + ((y_m[rows] - center[1]) ** 2)[:, None]
    inside = np.maximum(1.0 - square / radius**2, 0.0)
    height[rows, columns] += 2.0 * HEIGHT_TO_DIAMETER * radius * np.sqrt(inside)
