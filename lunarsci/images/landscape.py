"""What a rover's cameras look at: ground as triangles on a grid, rocks as ellipsoids, and the Sun."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.tables import numbers_of, read_csv_table

ROCK_COLUMNS = ("x_m", "y_m", "z_m", "a_m", "b_m", "c_m", "turn_deg")
"""Columns of a landscape's rocks: middle, half axes along and across, half height, direction of the first axis."""
HURST = 0.8
"""Roughness exponent of regolith: Helfenstein & Shepard (1999), Icarus 141, 107, 10.1006/icar.1999.6160 (0.5-0.7 at
millimetres; 0.8 assumed between)."""
RMS_AT_METRE_M = 0.02
"""Rms height of wavelengths up to a metre: assumed. [m]"""
MOTTLING = 0.05
"""Rms of the reflectance over its mean from place to place: assumed. [-]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Landscape:
    """Ground, rocks and Sun.

    Attributes
    ----------
    name : what it is.
    x0_m, y0_m, spacing_m : position of node [0, 0], and distance of nodes. [m]
    height_m : heights of the nodes, finite; each cell is two triangles, split from its lowest x and y. (ny, nx) [m]
    albedo : reflectance over its mean at the nodes, > 0. (ny, nx) [-]
    rocks : one row for each, `ROCK_COLUMNS`. (n, 7)
    sun_azimuth_deg, sun_elevation_deg : where the Sun is, from x towards y, and over the horizon. [deg]

    Raises ParameterError for what cannot be.
    """

    name: str
    x0_m: float
    y0_m: float
    spacing_m: float
    height_m: FloatArray
    albedo: FloatArray
    rocks: FloatArray
    sun_azimuth_deg: float = 60.0
    sun_elevation_deg: float = 30.0

    def __post_init__(self) -> None:
        if self.height_m.ndim != 2 or min(self.height_m.shape) < 3 or not np.isfinite(self.height_m).all():
            raise ParameterError(f"{self.name}: heights must be a grid of 3 x 3 or more finite numbers; fill its holes")
        if self.albedo.shape != self.height_m.shape or not (self.albedo > 0).all():
            raise ParameterError(f"{self.name}: reflectance must be above 0 at every node")
        if self.rocks.shape[1:] != (len(ROCK_COLUMNS),) or not (self.rocks[:, 3:6] > 0).all():
            raise ParameterError(f"{self.name}: rocks need {', '.join(ROCK_COLUMNS)}, with half axes above 0")
        if not (0 < self.spacing_m < math.inf and 0 < self.sun_elevation_deg <= 90):
            raise ParameterError(f"{self.name}: spacing must be above 0, and the Sun over the horizon: 0 to 90 deg")

    @property
    def sun(self) -> FloatArray:
        """Direction to the Sun. (3,)"""
        azimuth, elevation = math.radians(self.sun_azimuth_deg), math.radians(self.sun_elevation_deg)
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])

    def ground(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Height of the triangles without rocks; NaN beyond the grid. [m]"""
        x, y = np.asarray(x_m, dtype=float), np.asarray(y_m, dtype=float)
        column, row = (x - self.x0_m) / self.spacing_m, (y - self.y0_m) / self.spacing_m
        inside = (
            (column >= 0) & (row >= 0) & (column <= self.height_m.shape[1] - 1) & (row <= self.height_m.shape[0] - 1)
        )
        i = np.clip(np.nan_to_num(column).astype(int), 0, self.height_m.shape[1] - 2)
        j = np.clip(np.nan_to_num(row).astype(int), 0, self.height_m.shape[0] - 2)
        u, v, h = column - i, row - j, self.height_m
        low, high = h[j, i], h[j + 1, i + 1]
        first = low + u * (h[j, i + 1] - low) + v * (high - h[j, i + 1])
        second = low + v * (h[j + 1, i] - low) + u * (high - h[j + 1, i])
        return np.where(inside, np.where(u >= v, first, second), np.nan)

    def surface(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Height of ground or rock, whichever is higher, as seen from above. [m]"""
        x, y = np.asarray(x_m, dtype=float), np.asarray(y_m, dtype=float)
        found = self.ground(x, y)
        for row in self.rocks:
            along, across = _turned(x - row[0], y - row[1], math.radians(row[6]))
            left = 1 - (along / row[3]) ** 2 - (across / row[4]) ** 2
            top = row[2] + row[5] * np.sqrt(np.maximum(left, 0.0))
            found = np.where((left > 0) & (top > found), top, found)
        return found


def _turned(x: FloatArray, y: FloatArray, angle: float) -> tuple[FloatArray, FloatArray]:
    return x * math.cos(angle) + y * math.sin(angle), -x * math.sin(angle) + y * math.cos(angle)


def landscape_on(
    heights: tuple[float, float, float, FloatArray],
    *,
    name: str,
    seed: int,
    rocks_per_m2: float = 0.5,
    roughness: float = 1.0,
    sun_azimuth_deg: float = 60.0,
    sun_elevation_deg: float = 30.0,
    spacing_m: float | None = None,
) -> Landscape:
    """A landscape on given ground: x0, y0, spacing [m], heights (ny, nx) [m], with fractal roughness and rocks.

    Parameters
    ----------
    seed : of roughness, mottling and rocks.
    rocks_per_m2 : rocks of 4 cm and more on a square metre; their number falls as width^-2, up to 40 cm (assumed).
    roughness : over that assumed of regolith; 0 leaves the ground as it is.
    spacing_m : of the refined grid; the ground's own where it is None.

    What the ground cannot hold, wavelengths below four of its spacings, is added: power k^-(2 H + 2). Raises
    ParameterError.
    """
    x0, y0, coarse, height = heights
    fine = coarse if spacing_m is None else spacing_m
    if not 0 < fine <= coarse:
        raise ParameterError(
            f"the landscape's spacing is {fine:g} m, and the heights it is made from lie {coarse:g} m apart; give a "
            f"spacing above 0, at most {coarse:g} m, for detail is added to the ground and none is taken away"
        )
    if not (rocks_per_m2 >= 0 and roughness >= 0):
        raise ParameterError(f"rocks are {rocks_per_m2:g} a square metre and roughness {roughness:g}; give 0 or more")
    random = np.random.default_rng(seed)
    ground = _refined(height, coarse / fine)
    longest = min(max(4 * coarse, 8 * fine), 1.0)
    scale = roughness * RMS_AT_METRE_M * longest**HURST
    ground = ground + scale * _fractal(ground.shape, fine, longest, random)
    albedo = np.exp(MOTTLING * _fractal(ground.shape, fine, max(0.3, 8 * fine), random))
    extent = (ground.shape[1] - 1) * fine, (ground.shape[0] - 1) * fine
    bare = Landscape(
        name=name,
        x0_m=x0,
        y0_m=y0,
        spacing_m=fine,
        height_m=ground,
        albedo=albedo,
        rocks=np.empty((0, len(ROCK_COLUMNS))),
        sun_azimuth_deg=sun_azimuth_deg,
        sun_elevation_deg=sun_elevation_deg,
    )
    places = random.uniform(
        (x0, y0), (x0 + extent[0], y0 + extent[1]), (random.poisson(rocks_per_m2 * np.prod(extent)), 2)
    )
    return _with_rocks(bare, places, random)


def _with_rocks(bare: Landscape, places: FloatArray, random: np.random.Generator) -> Landscape:

    count = len(places)
    width = np.minimum(0.04 / np.sqrt(np.maximum(random.random(count), 0.01)), 0.4)
    flat = random.uniform(0.6, 1.0, (count, 2))
    half = 0.5 * width
    sunk = bare.ground(places[:, 0], places[:, 1]) + random.uniform(-0.3, 0.5, count) * half * flat[:, 1]
    rows = np.column_stack([places, sunk, half, half * flat[:, 0], half * flat[:, 1], random.uniform(0, 180, count)])
    return dataclasses.replace(bare, rocks=rows)


def with_track(landscape: Landscape, places_m: FloatArray, depth_m: FloatArray, width_m: float) -> Landscape:
    """The landscape after wheels went over it: within half a width of places (p, 2) its ground is lower by the largest
    of their depths (p,), as the deepest wheel left it, with upright walls. [m]

    Rocks stay as they are. Raises ParameterError where no place is on the ground.
    """

    nodes, reach = np.zeros(landscape.height_m.shape), 0.5 * width_m / landscape.spacing_m
    columns, rows = (np.asarray(places_m, dtype=float) - (landscape.x0_m, landscape.y0_m)).T / landscape.spacing_m
    for row, column, depth in zip(rows, columns, depth_m, strict=True):
        low, left = max(math.ceil(row - reach), 0), max(math.ceil(column - reach), 0)
        near = nodes[low : max(math.floor(row + reach) + 1, 0), left : max(math.floor(column + reach) + 1, 0)]
        v, u = np.ogrid[low : low + near.shape[0], left : left + near.shape[1]]
        inside = (v - row) ** 2 + (u - column) ** 2 <= reach**2
        near[inside] = np.maximum(near[inside], depth)
    if not nodes.any():
        raise ParameterError("no place of the track is on the ground; is it in the terrain's coordinates, in m?")
    return dataclasses.replace(landscape, height_m=landscape.height_m - nodes)


def read_track(source: str) -> tuple[FloatArray, FloatArray]:
    """Places (p, 2) and depths (p,) of a track from CSV: x_m, y_m, and rut_m or sinkage_m. [m] Raises DataError."""
    table = read_csv_table(source)
    depth = next((name for name in ("rut_m", "sinkage_m") if name in table), None)
    if depth is None or not {"x_m", "y_m"} <= set(table.columns):
        raise DataError(f"{source}: a track needs the columns x_m, y_m, and rut_m or sinkage_m")
    x, y, z = (numbers_of(source, name, table[name]) for name in ("x_m", "y_m", depth))
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    return np.column_stack([x, y])[known], z[known]


def _refined(height: FloatArray, times: float) -> FloatArray:
    from scipy.ndimage import map_coordinates

    if times == 1:
        return height
    rows, columns = (np.arange(0, count - 1 + 1e-9, 1 / times) for count in height.shape)
    grid = np.meshgrid(rows, columns, indexing="ij")
    return np.asarray(map_coordinates(height, grid, order=3, mode="nearest"))


def _fractal(shape: tuple[int, int], spacing_m: float, longest_m: float, random: np.random.Generator) -> FloatArray:
    """Waves of up to `longest_m`, power k^-(2 H + 2), rms 1. (ny, nx)"""
    k = np.hypot(np.fft.fftfreq(shape[0], spacing_m)[:, None], np.fft.rfftfreq(shape[1], spacing_m)[None, :])
    with np.errstate(divide="ignore"):
        weight = np.where(k >= 1 / longest_m, k ** -(HURST + 1), 0.0)
    waves = np.fft.irfft2(weight * np.fft.rfft2(random.standard_normal(shape)), s=shape)
    spread = float(waves.std())
    return np.asarray(waves / spread if spread > 0 else waves)
