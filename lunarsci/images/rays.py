"""What rays meet: ground as triangles on a grid, rocks as ellipsoids, and whether the Sun reaches it.

Rays are followed through the triangles of the ground, with the highest of larger and larger squares to skip what they
fly over (Tevs, Ihrke & Seidel 2008, 10.1145/1342250.1342279), and to ellipsoids in closed form.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.images.landscape import Landscape

SKYLIGHT = 0.0015
"""Radiance factor of what is in shadow, lit by ground about it: assumed. [-]"""
SINGLE_SCATTERING = 0.33
"""w of Hapke's law; with HG -0.3, B0 1.5, h 0.06, near Hapke's (1981, 10.1029/JB086iB04p03039) Moon: assumed."""
ROCK_ALBEDO = 1.15
"""Reflectance of rocks over the ground's: assumed. [-]"""
LIFT_M = 1e-5
"""How far over a surface a ray begins that leaves it. [m]"""


class World(NamedTuple):
    """What the compiled functions read of a landscape."""

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
        rocks = np.column_stack([landscape.rocks[:, :6], *_turns(landscape.rocks[:, 6])])
        place = np.array([landscape.x0_m, landscape.y0_m, landscape.spacing_m])
        return cls(place, height, normals, landscape.albedo, peaks, levels, np.ascontiguousarray(rocks), landscape.sun)


def _turns(angle_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))


def _peaks(height: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Highest corner of each cell, and of squares of 2, 4, … cells; rows of `levels` are (start, ny, nx)."""
    level = np.maximum(np.maximum(height[:-1, :-1], height[1:, :-1]), np.maximum(height[:-1, 1:], height[1:, 1:]))
    found, levels, start = [], [], 0
    while True:
        found.append(level.ravel())
        levels.append((start, *level.shape))
        start += level.size
        if max(level.shape) == 1:
            return np.concatenate(found), np.array(levels, dtype=np.int64)
        padded = np.pad(level, [(0, n % 2) for n in level.shape], constant_values=-np.inf)
        level = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2).max(axis=(1, 3))


class Seen(NamedTuple):
    """Light, distance (inf in the sky) [m] and kind of what rays meet, whether the Sun reaches it, or could."""

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
    """What rays from a point see; `near` are the rocks that can be among it, all where it is None.

    Unit directions (n, 3) of rays, and to the points of the Sun's disk whose light is asked for.
    """
    count = len(ways)
    flags = (np.empty(count, dtype=np.bool_) for _ in range(2))
    found = Seen(np.empty(count), np.empty(count), np.empty(count, dtype=np.uint8), *flags)
    _look(
        np.ascontiguousarray(ways),
        np.ascontiguousarray(origin, dtype=float),
        np.ascontiguousarray(suns),
        world.place,
        world.heights,
        world.normals,
        world.albedo,
        world.peaks,
        world.levels,
        world.rocks,
        np.ascontiguousarray(world.rocks if near is None else world.rocks[near]),
        hapke,
        *found,
    )
    return found


def clear(world: World, points: FloatArray, ways: FloatArray, far: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether nothing is between points and what is `far` along ways from them."""
    found = np.empty(len(points), dtype=np.bool_)
    arrays = world.place, world.heights, world.peaks, world.levels, world.rocks
    _free(np.ascontiguousarray(points), np.ascontiguousarray(ways), far, *arrays, found)
    return found


@compiled(nogil=True)
def _look(  # type: ignore[no-untyped-def]
    ways,
    origin,
    suns,
    place,
    heights,
    normals,
    albedo,
    peaks,
    levels,
    rocks,
    near,
    hapke,
    light,
    far,
    kind,
    lit,
    sunward,
):
    normal = np.empty(3)
    point = np.empty(3)
    for n in range(len(ways)):
        way, sun = ways[n], suns[n]
        distance = _to_ground(origin, way, place, heights, peaks, levels, np.inf)
        rock, nearer = _to_rocks(origin, way, near, distance)
        kind[n], far[n], light[n], lit[n], sunward[n] = 0, np.inf, 0.0, False, False
        if rock < 0 and not distance < np.inf:
            continue
        if rock >= 0:
            distance = nearer
        for axis in range(3):
            point[axis] = origin[axis] + distance * way[axis]
        tint = ROCK_ALBEDO
        if rock >= 0:
            _rock_normal(point, near[rock], normal)
        else:
            tint = _ground_normal(point, place, normals, albedo, normal)
        kind[n], far[n] = 2 if rock >= 0 else 1, distance
        light[n] = SKYLIGHT * tint
        facing = normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2]
        toward = -(normal[0] * way[0] + normal[1] * way[1] + normal[2] * way[2])
        sunward[n] = facing > 0.0
        if facing > 0.0 and _is_clear(point, sun, np.inf, place, heights, peaks, levels, rocks):
            cosine = -(way[0] * sun[0] + way[1] * sun[1] + way[2] * sun[2])
            lit[n] = True
            light[n] += _scattered(facing, max(toward, 1e-3), cosine, tint, hapke)


@compiled(nogil=True)
def _free(points, ways, far, place, heights, peaks, levels, rocks, found):  # type: ignore[no-untyped-def]
    for n in range(len(points)):
        found[n] = _is_clear(points[n], ways[n], far[n], place, heights, peaks, levels, rocks)


@compiled(nogil=True)
def _is_clear(point, way, far, place, heights, peaks, levels, rocks):  # type: ignore[no-untyped-def]
    """Whether a ray from just over a surface gets as far as that."""
    start = np.empty(3)
    for axis in range(3):
        start[axis] = point[axis] + LIFT_M * way[axis]
    start[2] += LIFT_M
    if _to_ground(start, way, place, heights, peaks, levels, far) < far:
        return False
    return _to_rocks(start, way, rocks, far)[0] < 0


@compiled(nogil=True)
def _scattered(mu0, mu, cosine, tint, hapke):  # type: ignore[no-untyped-def]
    """Radiance factor: of Lommel and Seeliger, w/4 mu0 / (mu0 + mu), or with Hapke's phase function and H."""
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


@compiled(nogil=True)
def _ground_normal(point, place, normals, albedo, normal):  # type: ignore[no-untyped-def]
    """Normal between the nodes' normals, and the reflectance."""
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


@compiled(nogil=True)
def _rock_normal(point, rock, normal):  # type: ignore[no-untyped-def]
    x, y, z = point[0] - rock[0], point[1] - rock[1], point[2] - rock[2]
    along = (x * rock[6] + y * rock[7]) / rock[3] ** 2
    across = (-x * rock[7] + y * rock[6]) / rock[4] ** 2
    normal[0] = along * rock[6] - across * rock[7]
    normal[1] = along * rock[7] + across * rock[6]
    normal[2] = z / rock[5] ** 2
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for axis in range(3):
        normal[axis] /= length


@compiled(nogil=True)
def _to_rocks(origin, way, rocks, limit):  # type: ignore[no-untyped-def]
    """The first rock that a ray meets before `limit`, -1 for none, and how far it is."""
    best, found = limit, -1
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
        left = b * b - a * (px * px + py * py + pz * pz - 1.0)
        if left > 0.0:
            distance = (-b - math.sqrt(left)) / a
            if 1e-9 < distance < best:
                best, found = distance, n
    return found, best


@compiled(nogil=True)
def _to_ground(origin, way, place, heights, peaks, levels, limit):  # type: ignore[no-untyped-def]
    """Distance at which a ray meets the ground's triangles, inf where it does not before `limit`."""
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
            hit = _in_cell(origin[2], way[2], x - i, y - j, dx, dy, t, leave, heights, i, j)
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


@compiled(nogil=True)
def _inside(x, dx, count, start, end):  # type: ignore[no-untyped-def]
    """The part of a ray over 0 to `count`."""
    if dx == 0.0:
        return (start, end) if 0.0 <= x <= count else (1.0, 0.0)
    first, last = -x / dx, (count - x) / dx
    if first > last:
        first, last = last, first
    return max(start, first), min(end, last)


@compiled(nogil=True)
def _in_cell(z, dz, u, v, du, dv, start, end, heights, i, j):  # type: ignore[no-untyped-def]
    """Where a ray meets one of a cell's two triangles between `start` and `end`; inf for nowhere."""
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
