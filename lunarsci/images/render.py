"""SYNTHETIC pictures of a landscape, and the truth about each pixel: for tests and for planning where to look from."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import each_in_threads
from lunarsci.errors import ParameterError
from lunarsci.images.camera import Camera, Pose
from lunarsci.images.landscape import Landscape
from lunarsci.images.rays import World, clear, seen_by
from lunarsci.images.rig import StereoRig

Law = Literal["lommel-seeliger", "hapke"]
SKY, GROUND, ROCK = 0, 1, 2
SUN_RADIUS_RAD = math.radians(0.2666)
"""Half the angle of the Sun's disk at 1 au: 959.63 arc seconds, Auwers (1891), Astron. Nachr. 128, 361. The nominal
radius of the Sun (Prsa et al. 2016, 10.3847/0004-6256/152/2/41) gives 0.2665 deg. [rad]"""
EXPOSURE = 0.8
"""Share of the full well that the brightest half percent of the left picture reaches: assumed. [-]"""
OFFSET = 8.0
"""Number that darkness gives: assumed."""
ROWS = 32
"""Rows of pixels that a thread takes at a time."""
Progress = Callable[[int, int], None]


class PixelTruth(NamedTuple):
    """What a picture shows, pixel by pixel of the left camera.

    `points_m` (h, w, 3) where the middle of a pixel looks, in the world, NaN in the sky [m]; `kind` (h, w) 0 sky, 1
    ground, 2 rock; `lit` (h, w) share of the Sun's disk that reaches it; `seen` (h, w) whether the right camera sees
    it.
    """

    points_m: FloatArray
    kind: npt.NDArray[np.uint8]
    lit: FloatArray
    seen: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedPair:
    """Two SYNTHETIC pictures (h, w), the rig and poses they were really taken with, and the truth of the left one."""

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
    count = 2 * (math.ceil(rig.left.height_px / ROWS) + 1)
    told = _Counted(progress, count)
    cameras = true.left, true.right
    lights = [
        _light(world, c, p, rig.sensor.lens_sigma_px, samples, law, random, told)
        for c, p in zip(cameras, poses, strict=True)
    ]
    gain = EXPOSURE * rig.sensor.full_well_e / max(float(np.percentile(lights[0], 99.5)), 1e-12)
    left, right = (_numbers(light, c, rig, gain, random, noise) for light, c in zip(lights, cameras, strict=True))
    truth = _truth(world, landscape, true, poses)
    return RenderedPair(left=left, right=right, rig=true, left_pose=poses[0], right_pose=poses[1], truth=truth)


class _Counted:
    """Calls `progress` once for every part that is done, in whatever thread."""

    def __init__(self, progress: Progress | None, count: int) -> None:
        self._progress, self._count, self._done = progress, count, 0

    def __call__(self, *_: int) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(min(self._done, self._count), self._count)


def _light(
    world: World,
    camera: Camera,
    pose: Pose,
    blur_px: float,
    samples: int,
    law: Law,
    random: np.random.Generator,
    told: Callable[[int, int], None],
) -> FloatArray:
    """Radiance factor of each pixel through lens and pixel. (h, w)"""
    from scipy.ndimage import gaussian_filter

    width, height = camera.size
    fine = np.empty((height * samples, width * samples))
    across = (np.arange(width * samples) + 0.5) / samples - 0.5
    blocks = [slice(row, min(row + ROWS * samples, len(fine))) for row in range(0, len(fine), ROWS * samples)]
    seeds = random.integers(2**62, size=len(blocks))

    def look(number: int) -> None:
        block, own = blocks[number], np.random.default_rng(int(seeds[number]))
        rows = (np.arange(block.start, block.stop) + 0.5) / samples - 0.5
        rays = camera.rays(np.stack(np.meshgrid(across, rows), axis=-1).reshape(-1, 2))
        ways = rays @ pose.rotation.T
        ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
        suns = _disk(world.sun, own.random((2, len(ways))))
        near = _rocks_in(world, camera, pose, rows[0] - 2, rows[-1] + 2)
        seen = seen_by(world, pose.center_m, ways, suns, law == "hapke", near)
        fine[block] = seen.light.reshape(len(rows), -1)

    each_in_threads(look, len(blocks), told)
    return fine_to_pixels(gaussian_filter(fine, blur_px * samples, mode="nearest"), samples)


def _rocks_in(world: World, camera: Camera, pose: Pose, first: float, last: float) -> npt.NDArray[np.int64]:
    """Numbers of the rocks that may show between two rows; all where a lens bends too much to say."""
    middle = pose.to_camera(world.rocks[:, :3])
    reach = world.rocks[:, 3:6].max(axis=1, initial=0.0)
    depth = np.maximum(middle[:, 2], 1e-9)
    row = camera.project(np.column_stack([middle[:, :2], depth]))[:, 1]
    spread = 2 * camera.fy_px * reach / np.maximum(depth - reach, 1e-3)
    apart = (depth > 3 * reach) & ((row + spread < first) | (row - spread > last))
    return np.flatnonzero(~apart & (middle[:, 2] > -reach))


def fine_to_pixels(fine: FloatArray, samples: int) -> FloatArray:
    """Means over the rays of each pixel. (h samples, w samples) to (h, w)"""
    height, width = (count // samples for count in fine.shape)
    return np.asarray(fine.reshape(height, samples, width, samples).mean(axis=(1, 3)))


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
    """Numbers of a sensor: vignetting by the fourth power of the cosine, electrons, rounding."""
    sensor = rig.sensor
    rays = camera.rays(np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in camera.size)), axis=-1))
    electrons = light * gain / np.linalg.norm(rays, axis=-1) ** 4
    if noise:
        read = sensor.read_noise_e * random.standard_normal(light.shape)
        electrons = random.poisson(np.maximum(electrons, 0.0)) + read
    numbers = np.clip(np.rint(electrons / sensor.full_well_e * sensor.top + OFFSET), 0, sensor.top)
    return np.asarray(numbers, dtype=np.uint16)


def _truth(world: World, landscape: Landscape, rig: StereoRig, poses: tuple[Pose, Pose]) -> PixelTruth:
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
