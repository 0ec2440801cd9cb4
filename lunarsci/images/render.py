"""SYNTHETIC pictures of a landscape, and the truth about each pixel: for tests and for planning where to look from.

A landscape is ground as triangles on a grid, rocks as ellipsoids, and the Sun. Rays are followed through the triangles,
with the highest of larger and larger squares to skip what they fly over (Tevs, Ihrke & Seidel 2008,
10.1145/1342250.1342279), and to ellipsoids in closed form.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, get_args

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, map_coordinates

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled, each_in_threads
from lunarsci.errors import DataError, ParameterError
from lunarsci.images import Law
from lunarsci.images.camera import Camera, Pose, StereoRig
from lunarsci.io.tables import in_units, numbers_of, read_csv_table
from lunarsci.ranges import refuse
from lunarsci.result import Progress
from lunarsci.sun import upward

ROCK_COLUMNS = ("x_m", "y_m", "z_m", "a_m", "b_m", "c_m", "turn_deg")
"""Columns of a landscape's rocks: middle, half axes along and across, half height, direction of the first axis."""
HURST = 0.8
"""Roughness exponent of regolith: between 0.5 to 0.7 at millimetres (Helfenstein & Shepard 1999, Icarus 141, 107,
10.1006/icar.1999.6160) and 0.76 of maria to 0.95 of highlands from 17 m on (Rosenburg et al. 2011, J. Geophys. Res.
116, E02001, 10.1029/2010JE003716)."""
RMS_AT_METRE_M, MOTTLING = 0.02, 0.05
"""Rms height of wavelengths up to a metre [m], on which `roughness` is a factor, and of the reflectance over its mean
from place to place [-]: assumed."""
SKYLIGHT = 0.0015
"""Radiance factor of what is in shadow, lit by ground about it: assumed. [-]"""
SINGLE_SCATTERING = 0.33
"""w of Hapke's law; with HG -0.3, B0 1.5, h 0.06, near Hapke's (1981, 10.1029/JB086iB04p03039) Moon: assumed."""
ROCK_ALBEDO = 1.15
"""Reflectance of rocks over the ground's: assumed. [-]"""
LIFT_M = 1e-5
"""How far over a surface a ray begins that leaves it. [m]"""
SKY, GROUND, ROCK = 0, 1, 2
"""What a ray meets, as numbers of `Seen.kind` and `PixelTruth.kind`."""
SUN_RADIUS_RAD = math.radians(0.2666)
"""Half the angle of the Sun's disk at 1 au: 959.63 arc seconds, Auwers (1891), Astron. Nachr. 128, 361. The nominal
radius of the Sun (Prsa et al. 2016, 10.3847/0004-6256/152/2/41) gives 0.2665 deg. [rad]"""
EXPOSURE = 0.8
"""Share of the full well that the brightest half percent of the left picture reaches: assumed. [-]"""
OFFSET = 8.0
"""Number that darkness gives: assumed."""
ROWS = 32
"""Rows of pixels that a thread takes at a time."""


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
        whole = self.height_m.ndim == 2 and min(self.height_m.shape) >= 3 and np.isfinite(self.height_m).all()
        bright = self.albedo.shape == self.height_m.shape and (self.albedo > 0).all()
        rocky = self.rocks.shape[1:] == (len(ROCK_COLUMNS),) and (self.rocks[:, 3:6] > 0).all()
        placed = 0 < self.spacing_m < math.inf and 0 < self.sun_elevation_deg <= 90
        reasons = {
            "heights must be a grid of 3 x 3 or more finite numbers; fill its holes": not whole,
            f"needs reflectance above 0 at every node, {', '.join(ROCK_COLUMNS)} of rocks with half axes above 0, a "
            "spacing above 0, and the Sun 0 to 90 deg over the horizon": not (bright and rocky and placed),
        }
        refuse(reasons, self.name)

    @property
    def sun(self) -> FloatArray:
        """Direction to the Sun. (3,)"""
        return upward(self.sun_azimuth_deg, self.sun_elevation_deg)

    def ground(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Height of the triangles without rocks at places of any one shape; NaN beyond the grid. [m]"""
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
        height = self.ground(x, y)
        for row in self.rocks:
            turned = ((x - row[0]) + 1j * (y - row[1])) * np.exp(-1j * math.radians(row[6]))
            squared = 1 - (turned.real / row[3]) ** 2 - (turned.imag / row[4]) ** 2
            top = row[2] + row[5] * np.sqrt(np.maximum(squared, 0.0))
            height = np.where((squared > 0) & (top > height), top, height)
        return height


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
    count = random.poisson(rocks_per_m2 * np.prod(extent))
    places = random.uniform((x0, y0), (x0 + extent[0], y0 + extent[1]), (count, 2))
    half = 0.5 * np.minimum(0.04 / np.sqrt(np.maximum(random.random(count), 0.01)), 0.4)
    flat = random.uniform(0.6, 1.0, (count, 2))
    sunk = bare.ground(*places.T) + random.uniform(-0.3, 0.5, count) * half * flat[:, 1]
    rows = np.column_stack([places, sunk, half, half[:, None] * flat, random.uniform(0, 180, count)])
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
    table = in_units(source, read_csv_table(source))
    depth = next((name for name in ("rut_m", "sinkage_m") if name in table), None)
    if depth is None or not {"x_m", "y_m"} <= set(table.columns):
        raise DataError(f"{source}: a track needs the columns x_m, y_m, and rut_m or sinkage_m")
    x, y, z = (numbers_of(source, name, table[name]) for name in ("x_m", "y_m", depth))
    valid = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    return np.column_stack([x, y])[valid], z[valid]


def _refined(height: FloatArray, times: float) -> FloatArray:
    """Heights on a grid `times` as fine, by cubic splines between the nodes. [m]"""
    if times == 1:
        return height
    rows, columns = (np.arange(0, count - 1 + 1e-9, 1 / times) for count in height.shape)
    grid = np.meshgrid(rows, columns, indexing="ij")
    return np.asarray(map_coordinates(height, grid, order=3, mode="nearest"))


def _fractal(shape: tuple[int, int], spacing_m: float, longest_m: float, random: np.random.Generator) -> FloatArray:
    """Waves of up to `longest_m`, power k^-(2 H + 2), with an rms of 1. (ny, nx) [-]"""
    k = np.hypot(np.fft.fftfreq(shape[0], spacing_m)[:, None], np.fft.rfftfreq(shape[1], spacing_m)[None, :])
    with np.errstate(divide="ignore"):
        weight = np.where(k >= 1 / longest_m, k ** -(HURST + 1), 0.0)
    waves = np.fft.irfft2(weight * np.fft.rfft2(random.standard_normal(shape)), s=shape)
    return np.asarray(waves / (waves.std() or 1.0))


class World(NamedTuple):
    """What the compiled functions read of a landscape. Arrays are contiguous; nodes are (row of y, column of x).

    Attributes
    ----------
    place : x and y of node [0, 0], and the distance of the nodes. (3,) [m]
    heights : of the nodes. (ny, nx) [m]
    normals : unit normals of the ground at the nodes, upwards. (ny, nx, 3)
    albedo : reflectance over its mean at the nodes. (ny, nx) [-]
    peaks : highest corner of each cell, then of squares of 2, 4, ... cells, all in one row. (p,) [m]
    levels : first place in `peaks` of each size of squares, and their rows and columns. (levels, 3)
    rocks : middle x, y, z, half axes a, b, c [m], cosine and sine of the first axis's direction. (n, 8)
    sun : unit direction to the middle of the Sun. (3,)
    """

    place: FloatArray
    heights: FloatArray
    normals: FloatArray
    albedo: FloatArray
    peaks: FloatArray
    levels: npt.NDArray[np.int64]
    rocks: FloatArray
    sun: FloatArray

    @classmethod
    def of(cls, landscape: Landscape) -> "World":
        height = np.ascontiguousarray(landscape.height_m)
        slope_y, slope_x = np.gradient(height, landscape.spacing_m)
        normals = np.stack([-slope_x, -slope_y, np.ones_like(height)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        peaks, levels = _peaks(height)
        turns = np.radians(landscape.rocks[:, 6])
        rocks = np.column_stack([landscape.rocks[:, :6], np.cos(turns), np.sin(turns)])
        place = np.array([landscape.x0_m, landscape.y0_m, landscape.spacing_m])
        return cls(place, height, normals, np.ascontiguousarray(landscape.albedo), peaks, levels, rocks, landscape.sun)


def _peaks(height: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Highest corner of each cell, and of squares of 2, 4, … cells; rows of `levels` are (start, ny, nx)."""
    level = np.maximum(np.maximum(height[:-1, :-1], height[1:, :-1]), np.maximum(height[:-1, 1:], height[1:, 1:]))
    peaks, levels, start = [], [], 0
    while True:
        peaks.append(level.ravel())
        levels.append((start, *level.shape))
        start += level.size
        if max(level.shape) == 1:
            return np.concatenate(peaks), np.array(levels, dtype=np.int64)
        padded = np.pad(level, [(0, n % 2) for n in level.shape], constant_values=-np.inf)
        level = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2).max(axis=(1, 3))


class Seen(NamedTuple):
    """What n rays meet. (n,) each

    Attributes
    ----------
    light : radiance factor; 0 in the sky. [-]
    far : distance along the ray, infinite in the sky. [m]
    kind : `SKY`, `GROUND` or `ROCK`.
    lit : whether its point of the Sun's disk shines on it.
    facing : whether the surface is turned to that point, whatever is between.
    """

    light: FloatArray
    far: FloatArray
    kind: npt.NDArray[np.uint8]
    lit: npt.NDArray[np.bool_]
    facing: npt.NDArray[np.bool_]


def seen_by(
    world: World,
    origin: FloatArray,
    ways: FloatArray,
    suns: FloatArray,
    hapke: bool,
    near: npt.NDArray[np.int64] | None = None,
) -> Seen:
    """What rays from a point see.

    Parameters
    ----------
    origin : of all rays. (3,) [m]
    ways : unit directions of the rays. (n, 3)
    suns : for each ray, unit direction to the point of the Sun's disk whose light is asked for. (n, 3)
    hapke : whether the ground scatters by Hapke's law.
    near : numbers of the rocks that rays can meet, None for all; shadows are cast by all in any case. (k,)
    """
    count = len(ways)
    flags = (np.empty(count, dtype=np.bool_) for _ in range(2))
    seen = Seen(np.empty(count), np.empty(count), np.empty(count, dtype=np.uint8), *flags)
    rocks = np.ascontiguousarray(world.rocks if near is None else world.rocks[near])
    rays = (np.ascontiguousarray(part, dtype=float) for part in (ways, origin, suns))
    _look(*rays, world, rocks, hapke, seen)
    return seen


def clear(world: World, points: FloatArray, ways: FloatArray, far: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether nothing is between points (n, 3) [m] and what is `far` (n,) [m] along unit `ways` (n, 3). (n,)"""
    free = np.empty(len(points), dtype=np.bool_)
    _free(np.ascontiguousarray(points), np.ascontiguousarray(ways), far, world, free)
    return free


@compiled
def _look(ways, origin, suns, world, rocks, hapke, seen):  # type: ignore[no-untyped-def]
    """Fill `seen`, a `Seen` of n rays; `rocks` are rows of `World.rocks` that rays may meet, else as `seen_by`."""
    normal = np.empty(3)
    for n in range(len(ways)):
        way, sun = ways[n], suns[n]
        seen.kind[n], seen.far[n], seen.light[n], seen.lit[n], seen.facing[n] = 0, np.inf, 0.0, False, False
        to_ground = _to_ground(origin, way, world, np.inf)
        rock, distance = _to_rocks(origin, way, rocks, to_ground)
        if rock < 0 and not distance < np.inf:
            continue
        point = origin + distance * way
        tint = ROCK_ALBEDO
        if rock >= 0:
            _rock_normal(point, rocks[rock], normal)
        else:
            tint = _ground_normal(point, world, normal)
        seen.kind[n], seen.far[n], seen.light[n] = 2 if rock >= 0 else 1, distance, SKYLIGHT * tint
        facing = normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2]
        toward = -(normal[0] * way[0] + normal[1] * way[1] + normal[2] * way[2])
        seen.facing[n] = facing > 0.0
        if facing > 0.0 and _is_clear(point, sun, np.inf, world):
            cosine = -(way[0] * sun[0] + way[1] * sun[1] + way[2] * sun[2])
            seen.lit[n] = True
            seen.light[n] += _scattered(facing, max(toward, 1e-3), cosine, tint, hapke)


@compiled
def _free(points, ways, far, world, free):  # type: ignore[no-untyped-def]
    """Fill `free` (n,) as `clear` says."""
    for n in range(len(points)):
        free[n] = _is_clear(points[n], ways[n], far[n], world)


@compiled
def _is_clear(point, way, far, world):  # type: ignore[no-untyped-def]
    """Whether a ray from `LIFT_M` over a surface's point (3,) along a unit way (3,) meets nothing up to `far` [m]."""
    start = point + LIFT_M * way
    start[2] += LIFT_M
    return _to_ground(start, way, world, far) >= far and _to_rocks(start, way, world.rocks, far)[0] < 0


@compiled
def _scattered(mu0, mu, cosine, tint, hapke):  # type: ignore[no-untyped-def]
    """Radiance factor: twice that of Lommel and Seeliger, w/4 mu0 / (mu0 + mu), or with Hapke's phase function and H.

    mu0, mu : cosines of incidence and emission, above 0.
    cosine : of the phase angle.
    tint : by which the single-scattering albedo w is multiplied. [-]
    """
    w = SINGLE_SCATTERING * tint
    plain = 0.25 * w * mu0 / (mu0 + mu)
    if not hapke:
        return 2.0 * plain
    phase = math.acos(min(max(cosine, -1.0), 1.0))
    scatter = 0.91 / (1.09 + 0.6 * math.cos(phase)) ** 1.5
    surge = 1.5 / (1.0 + math.tan(0.5 * phase) / 0.06)
    gamma = math.sqrt(1.0 - min(w, 1.0))
    both = (1 + 2 * mu0) / (1 + 2 * mu0 * gamma) * (1 + 2 * mu) / (1 + 2 * mu * gamma)
    return plain * ((1.0 + surge) * scatter + both - 1.0)


@compiled
def _ground_normal(point, world, normal):  # type: ignore[no-untyped-def]
    """Reflectance of the ground at a point (3,) [m]; fills `normal` (3,), between the nodes' normals, of length 1."""
    place, normals, albedo = world.place, world.normals, world.albedo
    x, y = (point[0] - place[0]) / place[2], (point[1] - place[1]) / place[2]
    i = min(max(int(x), 0), normals.shape[1] - 2)
    j = min(max(int(y), 0), normals.shape[0] - 2)
    u, v = x - i, y - j
    length = 0.0
    for axis in range(3):
        low = normals[j, i, axis] * (1 - u) + normals[j, i + 1, axis] * u
        high = normals[j + 1, i, axis] * (1 - u) + normals[j + 1, i + 1, axis] * u
        normal[axis] = low * (1 - v) + high * v
        length += normal[axis] ** 2
    for axis in range(3):
        normal[axis] /= math.sqrt(length)
    low = albedo[j, i] * (1 - u) + albedo[j, i + 1] * u
    high = albedo[j + 1, i] * (1 - u) + albedo[j + 1, i + 1] * u
    return low * (1 - v) + high * v


@compiled
def _rock_normal(point, rock, normal):  # type: ignore[no-untyped-def]
    """Fill `normal` (3,), of length 1, of an ellipsoid, a row (8,) of `World.rocks`, at a point (3,) [m] of it."""
    x, y, z = point[0] - rock[0], point[1] - rock[1], point[2] - rock[2]
    along = (x * rock[6] + y * rock[7]) / rock[3] ** 2
    across = (-x * rock[7] + y * rock[6]) / rock[4] ** 2
    normal[0] = along * rock[6] - across * rock[7]
    normal[1] = along * rock[7] + across * rock[6]
    normal[2] = z / rock[5] ** 2
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for axis in range(3):
        normal[axis] /= length


@compiled
def _to_rocks(origin, way, rocks, limit):  # type: ignore[no-untyped-def]
    """The first of rocks (n, 8) that a ray meets before `limit` [m], -1 for none, and how far it is [m], else `limit`.

    `origin` (3,) [m]; `way` (3,) of length 1.
    """
    best, number = limit, -1
    for n in range(len(rocks)):
        rock = rocks[n]
        x, y, z = origin[0] - rock[0], origin[1] - rock[1], origin[2] - rock[2]
        middle = -(x * way[0] + y * way[1] + z * way[2])
        reach = max(rock[3], rock[4], rock[5])
        if x * x + y * y + z * z - middle * middle > reach * reach:
            continue
        px, py, pz = (x * rock[6] + y * rock[7]) / rock[3], (-x * rock[7] + y * rock[6]) / rock[4], z / rock[5]
        qx = (way[0] * rock[6] + way[1] * rock[7]) / rock[3]
        qy = (-way[0] * rock[7] + way[1] * rock[6]) / rock[4]
        qz = way[2] / rock[5]
        a, b = qx * qx + qy * qy + qz * qz, px * qx + py * qy + pz * qz
        discriminant = b * b - a * (px * px + py * py + pz * pz - 1.0)
        if discriminant > 0.0:
            distance = (-b - math.sqrt(discriminant)) / a
            if 1e-9 < distance < best:
                best, number = distance, n
    return number, best


@compiled
def _to_ground(origin, way, world, limit):  # type: ignore[no-untyped-def]
    """Distance at which a ray meets the ground's triangles, inf where it does not before `limit`. [m]

    x, y, i, j count cells; `level` is the power of two of the squares that the ray is in, of which it skips those whose
    highest corner it flies over.
    """
    place, peaks, levels = world.place, world.peaks, world.levels
    ny, nx = levels[0, 1], levels[0, 2]
    x, y = (origin[0] - place[0]) / place[2], (origin[1] - place[1]) / place[2]
    dx, dy = way[0] / place[2], way[1] / place[2]
    start, end = _inside(x, dx, nx, 0.0, limit)
    start, end = _inside(y, dy, ny, start, end)
    if not start < end:
        return np.inf
    level, top = 0, len(levels) - 1
    t = start
    i = min(max(math.floor(x + dx * t), 0), nx - 1)
    j = min(max(math.floor(y + dy * t), 0), ny - 1)
    while True:
        size = 1 << level
        tx = ((i + (1 if dx > 0 else 0)) * size - x) / dx if dx != 0 else np.inf
        ty = ((j + (1 if dy > 0 else 0)) * size - y) / dy if dy != 0 else np.inf
        leave = max(min(tx, ty, end), t)
        low = min(origin[2] + way[2] * t, origin[2] + way[2] * leave)
        if low <= peaks[levels[level, 0] + j * levels[level, 2] + i]:
            if level > 0:
                level -= 1
                half = 1 << level
                i = min(max(math.floor((x + dx * t) / half), 2 * i), min(2 * i + 1, levels[level, 2] - 1))
                j = min(max(math.floor((y + dy * t) / half), 2 * j), min(2 * j + 1, levels[level, 1] - 1))
                continue
            hit = _in_cell(origin[2], way[2], x - i, y - j, dx, dy, t, leave, world.heights, i, j)
            if hit < np.inf:
                return hit
        if leave >= end:
            return np.inf
        t = leave
        was_i, was_j = i, j
        if tx <= ty:
            i += 1 if dx > 0 else -1
        else:
            j += 1 if dy > 0 else -1
        if i < 0 or j < 0 or i >= levels[level, 2] or j >= levels[level, 1]:
            return np.inf
        if level < top and ((i >> 1) != (was_i >> 1) or (j >> 1) != (was_j >> 1)):
            level += 1
            i >>= 1
            j >>= 1


@compiled
def _inside(x, dx, count, start, end):  # type: ignore[no-untyped-def]
    """Start and end of the part of a ray, of those between `start` and `end` [m], that is over 0 to `count` cells.

    `x` is where it begins [cells], `dx` how fast it goes [cells/m]. The start is not before the end where none is.
    """
    if dx == 0.0:
        return (start, end) if 0.0 <= x <= count else (1.0, 0.0)
    first, last = -x / dx, (count - x) / dx
    if first > last:
        first, last = last, first
    return max(start, first), min(end, last)


@compiled
def _in_cell(z, dz, u, v, du, dv, start, end, heights, i, j):  # type: ignore[no-untyped-def]
    """Distance at which a ray meets one of a cell's two triangles between `start` and `end`; inf for nowhere. [m]

    z, dz : height at distance 0 [m], and its change by distance [-].
    u, v, du, dv : the same of the place in the cell. [cells, cells/m]
    i, j : column and row of the cell.
    """
    h00, h10, h01, h11 = heights[j, i], heights[j, i + 1], heights[j + 1, i], heights[j + 1, i + 1]
    slack = 1e-9 * (1.0 + abs(end))
    best = np.inf
    for side in range(2):
        if side == 0:
            gx, gy = h10 - h00, h11 - h10
        else:
            gx, gy = h11 - h01, h01 - h00
        over = z - h00 - gx * u - gy * v
        rate = dz - gx * du - gy * dv
        if rate == 0.0:
            continue
        t = -over / rate
        across = (u + du * t) - (v + dv * t)
        if start - slack <= t <= end + slack and t < best and (across >= -1e-9 if side == 0 else across <= 1e-9):
            best = t
    return best if best > 0.0 else np.inf


class PixelTruth(NamedTuple):
    """What a picture shows, pixel by pixel of the left camera.

    Attributes
    ----------
    points_m : where the middle of a pixel looks, in the world, NaN in the sky. (h, w, 3) [m]
    kind : 0 sky, 1 ground, 2 rock. (h, w)
    lit : share of the Sun's disk that reaches it, in fifths. (h, w) [-]
    seen : whether the right camera sees it. (h, w)
    """

    points_m: FloatArray
    kind: npt.NDArray[np.uint8]
    lit: FloatArray
    seen: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedPair:
    """Two SYNTHETIC pictures, and how they were really taken.

    Attributes
    ----------
    left, right : in the numbers of the rig's sensor. (h, w)
    rig : that they were taken with: a draw from the covariance of the given one, or that itself.
    left_pose, right_pose : of its cameras in the world.
    truth : about each pixel of the left picture.
    """

    left: npt.NDArray[np.uint16]
    right: npt.NDArray[np.uint16]
    rig: StereoRig
    left_pose: Pose
    right_pose: Pose
    truth: PixelTruth


def render(
    landscape: Landscape,
    rig: StereoRig,
    pose: Pose,
    *,
    seed: int = 1,
    perturbed: bool = True,
    law: Law = "lommel-seeliger",
    samples: int = 2,
    noise: bool = True,
    progress: Progress | None = None,
) -> RenderedPair:
    """Two pictures of a landscape, by a rig whose left camera is at a pose.

    Parameters
    ----------
    seed : of noise, of the Sun's disk, and of the rig's draw.
    perturbed : take the pictures with a draw from the rig's covariance, as a real rig differs from its calibration.
    law : how the ground scatters: of Lommel and Seeliger, or Hapke's with assumed parameters.
    samples : rays along each side of a pixel, 1 to 8.
    noise : count electrons and round to whole numbers; without it light is scaled and rounded alone.

    Raises ParameterError for a law or samples that there are not, and where a camera is below the ground.
    """
    if law not in get_args(Law) or not 1 <= samples <= 8:
        raise ParameterError(f"law '{law}', {samples} samples: give one of {', '.join(get_args(Law))}, and 1 to 8")
    random = np.random.default_rng(seed)
    true = rig.drawn(random) if perturbed else rig
    poses = pose, true.right_pose(pose)
    for side in poses:
        low = landscape.ground(side.center_m[0], side.center_m[1])
        if not side.center_m[2] > np.nan_to_num(low, nan=-np.inf):
            raise ParameterError(
                f"a camera at {np.round(side.center_m, 3).tolist()} m is below the ground of {low:.3f} m"
            )
    world = World.of(landscape)
    total, done = 2 * (math.ceil(rig.left.height_px / ROWS) + 1), itertools.count(1)

    def report(*_: int) -> None:
        if progress is not None:
            progress(min(next(done), total), total)

    cameras = true.left, true.right
    lights = [
        _light(world, c, p, rig.sensor.lens_sigma_px, samples, law, random, report)
        for c, p in zip(cameras, poses, strict=True)
    ]
    gain = EXPOSURE * rig.sensor.full_well_e / max(float(np.percentile(lights[0], 99.5)), 1e-12)
    left, right = (_numbers(light, c, rig, gain, random, noise) for light, c in zip(lights, cameras, strict=True))
    truth = _truth(world, landscape, true, poses)
    return RenderedPair(left=left, right=right, rig=true, left_pose=poses[0], right_pose=poses[1], truth=truth)


def _light(
    world: World,
    camera: Camera,
    pose: Pose,
    blur_px: float,
    samples: int,
    law: Law,
    random: np.random.Generator,
    report: Callable[[int, int], None],
) -> FloatArray:
    """Radiance factor of each pixel through lens and pixel. (h, w) [-]

    blur_px : standard deviation of the lens's blur. [px]
    samples : rays along each side of a pixel.
    """
    width, height = camera.size
    fine = np.empty((height * samples, width * samples))
    across = (np.arange(width * samples) + 0.5) / samples - 0.5
    blocks = [slice(row, min(row + ROWS * samples, len(fine))) for row in range(0, len(fine), ROWS * samples)]
    seeds = random.integers(2**62, size=len(blocks))

    def look(number: int) -> None:
        block, noise = blocks[number], np.random.default_rng(int(seeds[number]))
        rows = (np.arange(block.start, block.stop) + 0.5) / samples - 0.5
        rays = camera.rays(np.stack(np.meshgrid(across, rows), axis=-1).reshape(-1, 2))
        ways = rays @ pose.rotation.T
        ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
        suns = _disk(world.sun, noise.random((2, len(ways))))
        near = _rocks_in(world, camera, pose, rows[0] - 2, rows[-1] + 2)
        seen = seen_by(world, pose.center_m, ways, suns, law == "hapke", near)
        fine[block] = seen.light.reshape(len(rows), -1)

    each_in_threads(look, len(blocks), report)
    blurred = gaussian_filter(fine, blur_px * samples, mode="nearest")
    return np.asarray(blurred.reshape(height, samples, width, samples).mean(axis=(1, 3)))


def _rocks_in(world: World, camera: Camera, pose: Pose, first: float, last: float) -> npt.NDArray[np.int64]:
    """Numbers (k,) of the rocks that may show between two rows [px]; all where a lens bends too much to say."""
    middle = pose.to_camera(world.rocks[:, :3])
    reach = world.rocks[:, 3:6].max(axis=1, initial=0.0)
    depth = np.maximum(middle[:, 2], 1e-9)
    row = camera.project(np.column_stack([middle[:, :2], depth]))[:, 1]
    margin = 2 * camera.fy_px * reach / np.maximum(depth - reach, 1e-3)
    apart = (depth > 3 * reach) & ((row + margin < first) | (row - margin > last))
    return np.flatnonzero(~apart & (middle[:, 2] > -reach))


def _disk(sun: FloatArray, uniform: FloatArray) -> FloatArray:
    """Directions to points of the Sun's disk, from two numbers of 0 to 1 each. (2, n) to (n, 3)"""
    side = np.cross(sun, [1.0, 0.0, 0.0] if abs(sun[2]) > 0.9 else [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    turn, reach = 2 * np.pi * uniform[0], SUN_RADIUS_RAD * np.sqrt(uniform[1])
    across = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(side, sun)
    ways = sun + reach[:, None] * across
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def _numbers(
    light: FloatArray, camera: Camera, rig: StereoRig, gain: float, random: np.random.Generator, noise: bool
) -> npt.NDArray[np.uint16]:
    """Numbers of a sensor: vignetting by the fourth power of the cosine, electrons, rounding. (h, w)

    `light` is the radiance factor (h, w), `gain` the electrons for one of 1.
    """
    sensor = rig.sensor
    rays = camera.rays(np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in camera.size)), axis=-1))
    electrons = light * gain / np.linalg.norm(rays, axis=-1) ** 4
    if noise:
        read = sensor.read_noise_e * random.standard_normal(light.shape)
        electrons = random.poisson(np.maximum(electrons, 0.0)) + read
    numbers = np.clip(np.rint(electrons / sensor.full_well_e * sensor.top + OFFSET), 0, sensor.top)
    return np.asarray(numbers, dtype=np.uint16)


def _truth(world: World, landscape: Landscape, rig: StereoRig, poses: tuple[Pose, Pose]) -> PixelTruth:
    """The truth of the left picture, by rays through the middles of its pixels; `poses` are of both cameras."""
    width, height = rig.left.size
    pixels = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)
    ways = rig.left.rays(pixels.reshape(-1, 2)) @ poses[0].rotation.T
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    center = np.asarray(poses[0].center_m, dtype=float)
    seen = seen_by(world, center, ways, np.broadcast_to(landscape.sun, ways.shape), False)
    kind, far = seen.kind, np.where(np.isfinite(seen.far), seen.far, np.nan)
    points = center + ways * far[:, None]
    lit, sunny = seen.lit / 5, points[seen.facing]
    for turn in np.arange(4) / 4:
        suns = np.broadcast_to(_disk(landscape.sun, np.array([[turn], [0.64]])), sunny.shape)
        lit[seen.facing] += clear(world, sunny, suns, np.full(len(sunny), np.inf)) / 5
    back = np.nan_to_num(poses[1].center_m - points, nan=1.0)
    inside = rig.right.sees(np.nan_to_num(rig.right.project(poses[1].to_camera(points)), nan=-1e9))
    shown = inside & (kind > 0)
    reach = np.linalg.norm(back[shown], axis=1)
    shown[shown] = clear(world, points[shown], back[shown] / reach[:, None], reach)
    return PixelTruth(*(layer.reshape(height, width, *layer.shape[1:]) for layer in (points, kind, lit, shown)))  # type: ignore[arg-type]
