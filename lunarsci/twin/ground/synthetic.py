"""Made-up ground of stated slope, craters, rocks and roughness.

A synthetic stand-in for the terrain at Longji, whose elevation model is not public.
"""

import math

import numpy as np
import numpy.typing as npt
from scipy.special import exp1

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.ranges import NOT_NEGATIVE, check_range
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain

SCALE_M = 0.2
"""Decay length of the covered area with diameter: assumed. [m]"""
CLEAR_M = 1.5
"""About the start of a drive, without rocks, as this ground is made; assumed. [m]"""
SMALLEST_M, LARGEST_M = 0.1, 2.0
"""Diameters that are laid, as this ground is made: smaller ones are roughness; assumed. [m]"""
HEIGHT_TO_DIAMETER = 0.5
"""A rock is half an ellipsoid of this height to diameter: assumed."""
LARGEST_SHARE = 0.1
"""Of the ground that rocks may cover, some fifty times that of the site, as this ground is made; assumed."""
ROUGHNESSES_M = "[0, 0.05]"
STAND_IN = "synthetic stand-in for the Longji site"
"""Name of the terrain that is driven where none is named."""
# x, y of the centre and diameter [m]. The diameters are published (Ding et al. 2024, Fig. 1c, d); the places are chosen
# to match the description: 6.1 m on the left, 11.2 m on the right, the drive ends just inside the rim of the 7.5 m one.
CRATERS = ((4.72, 4.6, 6.1), (4.63, -5.98, 11.2), (12.44, 0.27, 7.5))
# Wu et al. (2021), EPSL 553, 116666: mean depth/diameter 0.061 of the small craters at the landing site.
DEPTH_TO_DIAMETER = 0.06
# Regional gradient dh/dx, dh/dy, and a gentle step down across the passage (x, half width, half height [m]): chosen
# with the places of the craters for the slopes of the route in Ding et al. (2024), 8.86 deg at most and 5.38 deg at the
# end, as the tilt of the plane through 1 m x 1 m of ground, downhill and nearly without side slope.
REGIONAL = (-0.04, 0.0064)
STEP = (6.895, 1.5, 0.1877)
MOST_NODES = 4_000_000
SMALLEST_CRATER_M = 1.0
"""Diameter of the smallest craters that are laid, as this ground is made: smaller ones are roughness; assumed. [m]"""


def rocks_per_m2(share: float, diameter_m: npt.ArrayLike) -> FloatArray:
    """Number of rocks of at least a diameter on a square metre, up to 2 m. [1/m2]

    The area share covered by rocks of diameter >= D is F(D) = share exp(-D / 0.2 m), the exponential form of Golombek
    & Rapp (1997), JGR 102, 4117, 10.1029/96JE03319, which also holds at the landing site of Chang'E-3 (Di et al. 2016,
    Planet. Space Sci. 120, 103, 10.1016/j.pss.2015.11.012). The decay length is assumed: theirs, 1 / (1.79 + 0.152 /
    share) m, is for Mars at shares of 0.05 to 0.4 and would leave next to no rock above 10 cm at a share of 0.002. The
    number is the integral of -F'(D) / (pi D^2 / 4).
    """

    def below(diameter: FloatArray) -> FloatArray:
        # The integral of exp(-x) / x^2 from x up is exp(-x) / x - E1(x).
        x = diameter / SCALE_M
        return np.asarray(np.exp(-x) / x - exp1(x))

    diameter = np.minimum(np.asarray(diameter_m, dtype=float), LARGEST_M)
    return 4.0 * share / (math.pi * SCALE_M**2) * (below(diameter) - below(np.asarray(LARGEST_M)))


def scatter_rocks(x_m: FloatArray, y_m: FloatArray, height_m: FloatArray, share: float, seed: int) -> FloatArray:
    """The ground with rocks of 0.1 to 2 m on it; none within 1.5 m of the origin, where a drive begins.

    Parameters
    ----------
    x_m, y_m, height_m : columns (nx,), rows (ny,) and heights (ny, nx) of the ground. [m]
    share : of the ground that rocks of any size would cover, 0 to 0.1; 0.0021 at the site of Chang'E-4 (Wu et al. 2021,
        EPSL 553, 116666).
    seed : of places and sizes; the same rocks come on any grid of the same extent.

    Rocks are round, stand on their middle and may overlap. A grid coarser than a rock may miss it. Raises
    ParameterError outside the range.
    """
    check_range("the share of rocks", share, f"[0, {LARGEST_SHARE}]")
    random = np.random.default_rng((seed, 1))
    width, depth = float(x_m[-1] - x_m[0]), float(y_m[-1] - y_m[0])
    sizes = np.geomspace(SMALLEST_M, LARGEST_M, 400)
    numbers = rocks_per_m2(share, sizes)
    count = random.poisson(numbers[0] * width * depth)
    diameters = np.interp(random.random(count) * numbers[0], numbers[::-1], sizes[::-1])
    places = random.random((count, 2)) * (width, depth) + (x_m[0], y_m[0])
    height = height_m.copy()
    for (x, y), diameter in zip(places, diameters, strict=True):
        if math.hypot(x, y) > CLEAR_M + 0.5 * diameter:
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


def crater_height(
    radius_m: npt.ArrayLike, diameter_m: float, depth_to_diameter: float = DEPTH_TO_DIAMETER
) -> FloatArray:
    """Height over the surroundings of a smooth, degraded crater at a distance from its centre. [m]

    h = -d0 (1 - 2 u) exp(-2 u), u = (2 radius / diameter)^2: the rim crest is at the radius and stands 0.12 depths
    above the surroundings; depth is counted from crest to floor. An assumed shape, chosen for being smooth.
    """
    u = (2.0 * np.asarray(radius_m, dtype=float) / diameter_m) ** 2
    floor = depth_to_diameter * diameter_m / (1.0 + math.exp(-2.0))
    return np.asarray(-floor * (1.0 - 2.0 * u) * np.exp(-2.0 * u))


def roughness(x: FloatArray, y: FloatArray, rms_m: float, seed: int) -> FloatArray:
    """Random ground of wavelengths 0.4 to 4 m, amplitude proportional to wavelength. [m]"""
    random = np.random.default_rng(seed)
    waves = 80
    length = 0.4 * 10.0 ** random.random(waves)
    direction, phase = 2.0 * math.pi * random.random((2, waves))
    amplitude = length * rms_m / math.sqrt(0.5 * float(np.sum(length**2)))
    kx, ky = 2.0 * math.pi / length * np.cos(direction), 2.0 * math.pi / length * np.sin(direction)
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    for a, p, q, shift in zip(amplitude, kx, ky, phase, strict=True):
        total += a * np.cos(p * x + q * y + shift)
    return total


def synthetic_longji(
    soil: Soil | None = None,
    *,
    seed: int = 41,
    spacing_m: float = 0.05,
    rms_m: float = 0.004,
    rock_share: float = 0.0,
) -> Terrain:
    """Made-up ground with the published craters and slopes of the Longji site around the embedded plan.

    Parameters
    ----------
    soil : the same everywhere; `longji` by default.
    seed : of the roughness and the rocks.
    spacing_m : grid spacing, 0.01 to 0.5. [m]
    rms_m : roughness, 0 to 0.05. [m]
    rock_share : of the ground covered by rocks, 0 to 0.1; 0.0021 is what was measured there (see `scatter_rocks`).

    Raises ParameterError outside these ranges. Heights count from the start of the plan.
    """
    check_range("spacing_m", spacing_m, "[0.01, 0.5]")
    check_range("rms_m", rms_m, ROUGHNESSES_M)
    check_range("seed", seed, NOT_NEGATIVE)
    x = np.arange(-3.0, 14.0 + 0.5 * spacing_m, spacing_m)[None, :]
    y = np.arange(-7.0, 9.0 + 0.5 * spacing_m, spacing_m)[:, None]
    height = roughness(x, y, rms_m, seed) + REGIONAL[0] * x + REGIONAL[1] * y
    height = height - STEP[2] * np.tanh((x - STEP[0]) / STEP[1])
    for center_x, center_y, diameter in CRATERS:
        height += crater_height(np.hypot(x - center_x, y - center_y), diameter)
    if rock_share:
        height = scatter_rocks(x[0], y[:, 0], height, rock_share, seed)
    return build_terrain(STAND_IN, -3.0, -7.0, spacing_m, height, soil or read_soil("longji"), synthetic=True)


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
    check_range("spacing_m", spacing_m, "[0.01, 1]")
    check_range("extent_m", extent_m, "[4, 1000]")
    check_range("slope_deg", slope_deg, "[-45, 45]")
    check_range("craters", craters, "[0, 10000]")
    check_range("rms_m", rms_m, ROUGHNESSES_M)
    check_range("seed", seed, NOT_NEGATIVE)
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
