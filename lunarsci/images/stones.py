"""Stones rendered into a pair of pictures: polyhedra on the ground that is there, under its Sun, with their shadows."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.images.pictures import cv2

Image = npt.NDArray[np.float32]
SMALLEST_M = 0.03
"""Least diameter that is looked for: 10 px of a NavCam at 3.5 m. [m]"""
FLATNESS = (0.3, 0.6)
"""Height over diameter of rocks put in: means at landing sites are 0.4 to 0.6, and half buried ones are flatter
(Golombek & Rapp 1997, 10.1029/96JE03319)."""
ALBEDO, PATTERNS, BUMPS, WAVES = (0.1, 0.3), (0.0, 0.05, 0.12), (0.0, 0.08, 0.2), (0.15, 0.8)
"""Of rocks put in, all assumed: mean and scatter of the logarithm of their albedo over the ground's, of waves across
them the heights in albedo and in slope, and the lengths in diameters."""
INJECTED = 75
"""Rocks put in at a time; of twice as many a share is known to 0.5 / sqrt(150) = 0.04."""


class StonePair(NamedTuple):
    """A pair, its ground and its light.

    Attributes
    ----------
    left, right : light. (h, w) each
    ground : disparity of the smooth ground. (h, w) [px]
    above : disparity over that, of all that is there. (h, w) [px]
    searched : what both pictures show and is not dark all about. (h, w)
    focal_px, center_px, baseline_m : of the rectified frame.
    up, sun : directions in that frame. (3,)
    """

    left: Image
    right: Image
    ground: Image
    above: Image
    searched: BoolArray
    focal_px: float
    center_px: tuple[float, float]
    baseline_m: float
    up: FloatArray
    sun: FloatArray

    def at(self, places: FloatArray) -> FloatArray:
        """The ground's disparity at pixels, of which u and v come first. (n, 2 or more) to (n,) [px]"""
        last = np.array(self.ground.shape[::-1]) - 1
        u, v = np.clip(np.rint(places[:, :2]), 0, last).astype(int).T
        return np.asarray(self.ground[v, u], dtype=float)

    def feet(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points of the ground that is there at pixels (n, 2 or more) (n, 3) [m], and their disparity (n,) [px]."""
        disparity = self.at(places) + self._replace(ground=self.above).at(places)
        return self.points(places, disparity), disparity

    def points(self, places: FloatArray, disparity: FloatArray) -> FloatArray:
        """Points of the frame at pixels (n, 2 or more) of a disparity (n,) [px]. (n, 3) [m]"""
        rays = np.column_stack([(places[:, :2] - self.center_px) / self.focal_px, np.ones(len(places))])
        return np.asarray(rays * (self.focal_px * self.baseline_m / disparity)[:, None])


def spots(scene: StonePair, largest_m: float, rng: np.random.Generator) -> FloatArray:
    """Where rocks are put in, evenly over the ground, clear of each other: u, v, diameter, height. (n, 4) [px, m]"""
    v, u = np.nonzero(scene.searched)
    weight = scene.ground[v, u].astype(float) ** -3
    order = rng.choice(len(u), size=min(4 * INJECTED, len(u)), p=weight / weight.sum(), replace=False)
    chosen: list[FloatArray] = []
    boxes = np.empty((0, 3))
    for k in order:
        diameter = SMALLEST_M * (largest_m / SMALLEST_M) ** rng.random()
        box = np.array([u[k], v[k], diameter * scene.ground[v[k], u[k]] / scene.baseline_m])
        apart = np.abs(boxes[:, :2] - box[:2])
        wide = boxes[:, 2] + box[2]
        if not ((apart[:, 0] < 1.6 * wide + 8) & (apart[:, 1] < 1.2 * wide + 8)).any():
            boxes = np.vstack([boxes, box])
            chosen.append(np.array([box[0], box[1], diameter, diameter * rng.uniform(*FLATNESS)]))
        if len(chosen) == INJECTED:
            break
    return np.array(chosen)


class _Stone(NamedTuple):
    """A polyhedron: |p| <= reach along each normal, of p = shape @ (point - middle). (n, 3), (n,), (3, 3), (3,)

    `albedo` is over the ground's; it and the normals wave along `waves` (m, 4), whose last column is a phase, by
    `pattern` and by `bumps`.
    """

    normals: FloatArray
    reach: FloatArray
    shape: FloatArray
    middle: FloatArray
    albedo: float
    waves: FloatArray
    pattern: float
    bumps: float

    def met(self, start: FloatArray, ways: FloatArray) -> tuple[BoolArray, FloatArray, npt.NDArray[np.intp]]:
        """Whether rays from (3,) or (n, 3) along ways (n, 3) meet it, at what length, and which face. (n,) each"""
        along = (ways @ self.shape.T) @ self.normals.T
        left = self.reach - ((start - self.middle) @ self.shape.T) @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            length = left / along
        enter, leave = np.where(along < 0, length, -np.inf), np.where(along > 0, length, np.inf)
        face = enter.argmax(axis=1)
        first = enter.max(axis=1)
        return (first < leave.min(axis=1)) & (leave.min(axis=1) > 0), first, face

    def looks(self, points: FloatArray, face: npt.NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Albedo over the ground's, and the normal, at points (n, 3) of faces (n,). (n,), (n, 3)"""
        normals = self.normals @ self.shape
        normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True))[face]
        phases = (points - self.middle) @ self.waves[:, :3].T + self.waves[:, 3]
        tint = self.albedo * np.prod(1 + self.pattern * np.sin(phases), axis=1)
        ways = self.waves[:, :3] / np.linalg.norm(self.waves[:, :3], axis=1, keepdims=True)
        normals = normals + self.bumps * np.cos(phases) @ ways
        return tint, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _stone(scene: StonePair, foot: FloatArray, diameter: float, height: float, rng: np.random.Generator) -> _Stone:
    """A stone of twelve faces on the ground at a point (3,), of this width and height above it [m]."""
    normals = rng.standard_normal((12, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Within a box, since twelve planes at random may leave a way out.
    normals, reach = (
        np.vstack([normals, np.eye(3), -np.eye(3)]),
        np.concatenate([rng.uniform(0.75, 1.0, 12), np.ones(6)]),
    )
    ways = rng.standard_normal((400, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    surface = ways * (reach / np.maximum(ways @ normals.T, 1e-3)).min(axis=1)[:, None]
    widest = np.abs(surface[:, 0]).max(), np.abs(surface[:, 1]).max(), surface[:, 2].max()
    side = np.cross(scene.up, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    turn = rng.uniform(0, 2 * math.pi)
    level = np.stack([side, np.cross(scene.up, side)])
    level = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) @ level
    # Three tenths of it are below the ground.
    half = np.array([0.5 * diameter, 0.5 * diameter * rng.uniform(0.7, 1.0), 0.5 * height / 0.7])
    shape = np.diag(np.array(widest) / half) @ np.vstack([level, scene.up])
    lengths = rng.uniform(*WAVES, 10)[:, None] * diameter
    waves = rng.standard_normal((10, 3))
    waves *= 2 * math.pi / lengths / np.linalg.norm(waves, axis=1, keepdims=True)
    return _Stone(
        normals,
        reach,
        shape,
        foot + scene.up * (height - half[2]),
        math.exp(rng.normal(*ALBEDO)),
        np.column_stack([waves, rng.uniform(0, 2 * math.pi, 10)]),
        float(rng.choice(PATTERNS)),
        float(rng.choice(BUMPS)),
    )


def put_stone(
    scene: StonePair, pictures: tuple[Image, Image], spot: FloatArray, noise: float, rng: np.random.Generator
) -> FloatArray:
    """Put a stone into both pictures, with its shadow; u, v, width and height of what the left one shows. (4,) [px]

    `spot` (4,) is a row of `_spots`, `noise` that of the light.
    """
    u, v, diameter, height = spot
    foot, disparity = scene.feet(spot[None])
    foot = foot[0]
    stone = _stone(scene, foot, diameter, height, rng)
    reach = round(2.6 * diameter * float(disparity[0]) / scene.baseline_m) + 6
    about = scene.left[max(int(v) - 20, 0) : int(v) + 21, max(int(u) - 20, 0) : int(u) + 21]
    shown = np.full(4, np.nan)
    for number, picture in enumerate(pictures):
        middle = u - number * float(disparity[0])
        left, right = max(round(middle) - reach, 0), min(round(middle) + reach, picture.shape[1])
        top, low = max(round(v) - reach, 0), min(round(v) + reach, picture.shape[0])
        if right - left < 8 or low - top < 8:
            return np.full(4, np.nan)
        window = (slice(top, low), slice(left, right))
        fine = min(2.0, 200 / (right - left))
        shape = max(round((low - top) * fine), 8), max(round((right - left) * fine), 8)
        x = left - 0.5 + (np.arange(shape[1]) + 0.5) * (right - left) / shape[1]
        y = top - 0.5 + (np.arange(shape[0]) + 0.5) * (low - top) / shape[0]
        under = cv2.resize(picture[window], shape[::-1], interpolation=cv2.INTER_LINEAR)
        eye = np.array([number * scene.baseline_m, 0.0, 0.0])
        light, on, touched = _lit(scene, stone, foot, eye, (x, y), under.ravel(), float(np.median(about)))
        if fine > 1:
            light = cv2.GaussianBlur(light, (0, 0), 0.45 * fine)
        size, how = (right - left, low - top), cv2.INTER_AREA if fine >= 1 else cv2.INTER_LINEAR
        grown = cv2.dilate(touched.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.float32)
        changed = cv2.resize(grown, size, interpolation=how) > 0.3
        new = cv2.resize(np.where(grown > 0, light, under), size, interpolation=how)
        new += noise * rng.standard_normal(changed.shape)
        picture[window] = np.where(changed, new, picture[window])
        if number == 0 and on.any():
            rows, columns = np.nonzero(on)
            shown = np.array([x[columns].mean(), y[rows].mean(), np.ptp(x[columns]) + 1, np.ptp(y[rows]) + 1])
    return shown


def _lit(
    scene: StonePair,
    stone: _Stone,
    foot: FloatArray,
    eye: FloatArray,
    grid: tuple[FloatArray, FloatArray],
    under: FloatArray,
    ground: float,
) -> tuple[Image, BoolArray, BoolArray]:
    """Light of a stone, its shadow and the ground; where the stone is, and where it or its shadow. (y, x) each

    By Lommel and Seeliger, beside the level ground's light `ground` about it; in the shadow a twenty-fifth is left.
    `eye` (3,) [m] is the camera, `grid` its columns and rows [px], `under` the light of what was there (y x,).
    """
    x, y = np.meshgrid(*grid)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    ways = np.column_stack([(pixels - scene.center_px) / scene.focal_px, np.ones(x.size)])
    hit, length, face = stone.met(eye, ways)
    floor = ((foot - eye) @ scene.up) / np.minimum(ways @ scene.up, -1e-6)
    on = hit & (length > 0) & (length < floor)
    dark, *_ = stone.met(eye + ways * floor[:, None], np.broadcast_to(scene.sun, ways.shape))
    view = -ways / np.linalg.norm(ways, axis=1, keepdims=True)
    tint, normals = stone.looks(eye + ways * np.where(on, length, 0.0)[:, None], face)
    mu0 = np.maximum(normals @ scene.sun, 0.0)
    mu, level, seen = (
        np.maximum(a, 0.02) for a in ((normals * view).sum(axis=1), scene.up @ scene.sun, view @ scene.up)
    )
    bright = ground * tint * np.minimum(mu0 / (mu0 + mu) * (level + seen) / level, 3.0)
    light = np.where(on, np.maximum(bright, 0.04 * ground), np.where(dark, np.minimum(under, 0.04 * ground), under))
    return light.reshape(x.shape).astype(np.float32), on.reshape(x.shape), (on | dark).reshape(x.shape)
