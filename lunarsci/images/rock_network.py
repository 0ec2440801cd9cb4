"""What rocks look like in a pair of pictures: a small convolutional network, taught on scenes whose rocks are known.

It sees the pair level by level of a pyramid, on each of which rocks are 10 px wide: their disparity over the ground's,
light, its change along the Sun's shadows and across them, how coarse it is, and what differs in the right picture at
that disparity. `tests/benchmarks/rock_scenes.py` made the scenes (SYNTHETIC, by Mitsuba) and taught it; it has seen no
others. Layers of this kind: LeCun et al. (1998), 10.1109/5.726791; Yu & Koltun (2016), arXiv 1511.07122.
"""

import math
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, robust_scatter
from lunarsci.errors import DataError
from lunarsci.images.pictures import cv2
from lunarsci.images.stones import SMALLEST_M, Image, StonePair

TABLE = "rock_network.npz"
WIDTH_PX, RATIO, LEVELS = 10.0, 1.35, 11
"""Rocks are so wide on the level that looks for their size [px], and levels, the finest for rocks of 7.4 px, are apart
by this ratio: it was taught with these."""
DILATIONS, SEEN_PX, STEP_PX = (1, 1, 2, 3, 1, 1), 14, 2
"""Of the layers' windows, what they see about a place, and between places that are scored [px]: as it was taught."""
KNEE = 3.0
"""Score at which `RockNetwork.odds` bends: these are fitted with it (`tests/benchmarks/rock_scenes.py`)."""
STRIP = 64
"""Rows of scores that are reckoned together."""


def blurred(values: Image, sigma: float) -> Image:
    """Under a Gaussian; under three squares of its variance where it is wide. (h, w)"""
    if sigma < 4:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), dtype=np.float32)
    side = round(math.sqrt(4 * sigma**2 + 1)) | 1
    for _ in range(3):
        values = cv2.blur(values, (side, side))
    return values


class RockCandidates(NamedTuple):
    """What may be rocks.

    Attributes
    ----------
    places : u, v and width. (n, 3) [px]
    scores : the network's. (n,)
    stands_out : over what is about it, in deviations of the ground's own scatter. (n,)
    raised_px, disparity : over what is about it, and in all. (n,) [px]
    """

    places: FloatArray
    scores: FloatArray
    stands_out: FloatArray
    raised_px: FloatArray
    disparity: FloatArray

    def only(self, which: npt.NDArray[np.intp]) -> "RockCandidates":
        """Some of them."""
        return RockCandidates(*(part[which] for part in self))


class RockNetwork(NamedTuple):
    """Weights (out, in, side, side) and offsets (out,) of each layer, and what its scores are worth.

    `odds` (3,): the logarithm of how much likelier a score is a rock's than the ground's, at 0, its slope, and by how
    much this is more beyond `KNEE`.
    """

    layers: tuple[tuple[Image, Image], ...]
    odds: FloatArray

    def ratio(self, scores: FloatArray) -> FloatArray:
        """How much likelier scores (n,) are a rock's than the ground's. (n,)"""
        terms = np.stack([np.ones_like(scores), scores, np.logaddexp(0.0, scores - KNEE)])
        return np.asarray(np.exp(np.clip(self.odds @ terms, -50, 50)))


@cache
def embedded_network() -> RockNetwork:
    """That of `rock_network.npz`."""
    with (files("lunarsci.images") / TABLE).open("rb") as file, np.load(file) as arrays:
        pairs = [[arrays[f"{name}{k}"].astype(np.float32) for name in "wb"] for k in range(len(DILATIONS))]
        return RockNetwork(tuple((w, b) for w, b in pairs), arrays["odds"].astype(float))


def rock_candidates(scene: StonePair, largest_m: float, network: RockNetwork | None = None) -> RockCandidates:
    """Places that look more like a rock than all that is near, up to a diameter; the likeliest first.

    Raises DataError where no ground is near enough.
    """
    network = network or embedded_network()
    scored, rows = [], []
    for width, images in levels(scene):
        part = looked_at(scene, width, images.shape[1:], largest_m)
        scored.append((width, images, scores(network, images, part)))
    grown = [cv2.dilate(score, np.ones((3, 3), np.uint8)) for _, _, score in scored]
    for k, (width, images, score) in enumerate(scored):
        y, x = np.nonzero((score == grown[k]) & (score > -5.0))
        at = STEP_PX * np.column_stack([x, y]).astype(np.float64)
        place = (at + 0.5) * (width / WIDTH_PX) - 0.5
        sides = [_near(grown, k + way, place, scored) for way in (-1, 1)]
        both = [np.where(np.isfinite(side), side, score[y, x] - 1.0) for side in sides]
        bend = np.minimum(both[0] - 2 * score[y, x] + both[1], -1e-3)
        wide = width * RATIO ** np.clip(0.5 * (both[0] - both[1]) / bend, -0.5, 0.5)
        height, over, scatter = _raised(images[-1], at, score)
        rows.append(np.column_stack([place, wide, score[y, x], height / scatter, height, over + scene.at(place)]))
    table = np.concatenate(rows)
    if not any(np.isfinite(score).any() for _, _, score in scored):
        raise DataError("too little lit ground is seen near enough for rocks")
    places = table[:, :3]
    every = RockCandidates(places, *table[:, 3:].T)
    return every.only(_alone(places, every.scores))


def looked_at(scene: StonePair, width: float, shape: tuple[int, ...], largest_m: float) -> BoolArray:
    """Where a level's rocks are of the sizes that are looked for. (y, x)"""
    size = shape[::-1]
    ground = cv2.resize(scene.ground, size, interpolation=cv2.INTER_LINEAR)
    part = cv2.resize(scene.searched.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    across = width * scene.baseline_m / np.maximum(ground, 1.0)
    return np.asarray(part & (across > SMALLEST_M / RATIO) & (across < 1.5 * largest_m))


def levels(scene: StonePair) -> Iterator[tuple[float, Image]]:
    """Width of a level's rocks in the picture [px], what the network sees of it, and disparity over the ground's [px].

    (7, y, x): the last is for measures.
    """
    left = scene.left
    top = float(np.percentile(left, 90))

    def logs(light: Image) -> Image:
        return np.asarray(np.log(np.maximum(light, 0.0) / top + 0.03), dtype=np.float32)

    light = logs(left)
    slope = cv2.Sobel(light, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(light, cv2.CV_32F, 0, 1) ** 2
    grain = np.log(blurred(slope, 1.0) + 0.01)
    above = np.where(scene.searched, scene.above, 0.0).astype(np.float32)
    v, u = np.mgrid[: left.shape[0], : left.shape[1]].astype(np.float32)
    there = u - scene.ground - blurred(scene.above, 1.0)
    other = cv2.remap(scene.right, there, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    odd = np.minimum(np.abs(blurred(logs(other) - light, 1.0)), 1.0)
    ways = _shadow_ways(scene)
    for width in WIDTH_PX * RATIO ** np.arange(-1, LEVELS - 1):
        scale = WIDTH_PX / width
        size = round(left.shape[1] * scale), round(left.shape[0] * scale)
        small = [blurred(i, 0.3 / scale) if scale < 1 else i for i in (above, light, grain, odd)]
        small = [cv2.resize(i, size, interpolation=cv2.INTER_LINEAR) for i in (*small, *ways)]
        yield float(width), _channels(np.stack(small), float(width))


def _channels(images: Image, width: float) -> Image:
    """What the network sees of above, light, grain, oddness and the shadows' way (6, y, x), less what is about."""
    above, light, grain, odd, *way = images
    higher, brighter, coarser = (i - blurred(i, 1.5 * WIDTH_PX) for i in (above * (10 / width), light, grain))
    across, down = (cv2.Sobel(light, cv2.CV_32F, *order) / 4 for order in ((1, 0), (0, 1)))
    along, aside = across * way[0] + down * way[1], np.abs(down * way[0] - across * way[1])
    rows = [
        np.clip(higher, -4, 4),
        np.clip(brighter, -3, 3),
        np.clip(2 * along, -3, 3),
        np.clip(2 * aside, 0, 3),
        0.5 * coarser,
        2 * odd,
        above,
    ]
    return np.stack(rows).astype(np.float32)


def _shadow_ways(scene: StonePair) -> list[Image]:
    """Direction in the left picture, of unit length, that shadows on the ground fall to. Two of (h, w)"""
    step = 32
    v, u = np.mgrid[: scene.ground.shape[0] : step, : scene.ground.shape[1] : step]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    points = scene.points(pixels, np.maximum(scene.at(pixels), 1.0))
    level = scene.sun - scene.up * (scene.sun @ scene.up)
    level = level / max(float(np.linalg.norm(level)), 1e-9)
    ends = points - 0.02 * level * np.linalg.norm(points, axis=1, keepdims=True)
    way = scene.focal_px * ends[:, :2] / ends[:, 2:] + scene.center_px - pixels
    way /= np.linalg.norm(way, axis=1, keepdims=True) + 1e-9
    size = scene.ground.shape[::-1]
    return [cv2.resize(w.reshape(u.shape).astype(np.float32), size) for w in way.T]


def scores(network: RockNetwork, images: Image, part: BoolArray) -> Image:
    """Scores of every second place of a level's images (7, y, x), -inf outside a part (y, x). (y / 2, x / 2)"""
    part = part[::STEP_PX, ::STEP_PX]
    out = np.full(part.shape, -np.inf, dtype=np.float32)
    seen = images[:-1]
    padded = np.pad(seen, ((0, 0), (SEEN_PX, SEEN_PX + 1), (SEEN_PX, SEEN_PX + 1)), mode="edge")
    rows, columns = (np.flatnonzero(part.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return out
    beyond = 2 * SEEN_PX + 1 - STEP_PX
    across = slice(STEP_PX * columns[0], STEP_PX * (columns[-1] + 1) + beyond)
    for top in range(rows[0], rows[-1] + 1, STRIP):
        low = min(top + STRIP, rows[-1] + 1)
        values = padded[:, STEP_PX * top : STEP_PX * low + beyond, across]
        for k, (layer, dilation) in enumerate(zip(network.layers, DILATIONS, strict=True)):
            values = _convolved(values, *layer, dilation, STEP_PX if k == 0 else 1)
            if k < len(DILATIONS) - 1:
                values = np.maximum(values, 0.1 * values)
        out[top:low, columns[0] : columns[-1] + 1] = values[0]
    return np.where(part, out, np.float32(-np.inf))


def _convolved(values: Image, weights: Image, offsets: Image, dilation: int, step: int) -> Image:
    """A layer's sums over windows of values (c, y, x) that lie within. (out, y', x')"""
    side = weights.shape[-1]
    span = (side - 1) * dilation
    shape = [(n - span - 1) // step + 1 for n in values.shape[1:]]
    windows = [
        values[:, i * dilation :, j * dilation :][:, : step * shape[0] : step, : step * shape[1] : step]
        for i, j in product(range(side), repeat=2)
    ]
    flat = np.concatenate(windows).reshape(-1, shape[0] * shape[1])
    rows = weights.transpose(0, 2, 3, 1).reshape(len(weights), -1)
    return np.asarray(rows @ flat + offsets[:, None]).reshape(-1, *shape)


def _near(
    grown: list[Image], number: int, places: FloatArray, scored: list[tuple[float, Image, Image]]
) -> npt.NDArray[np.float32]:
    """The highest score about places (n, 2) [px] on another level; -inf where there is none. (n,)"""
    if not 0 <= number < len(grown):
        return np.full(len(places), -np.inf, dtype=np.float32)
    scale = WIDTH_PX / scored[number][0]
    at = np.rint(((places + 0.5) * scale - 0.5) / STEP_PX).astype(int)
    x, y = (np.clip(at[:, k], 0, grown[number].shape[1 - k] - 1) for k in (0, 1))
    return np.asarray(grown[number][y, x])


def _raised(above: Image, at: FloatArray, score: Image) -> tuple[FloatArray, FloatArray, float]:
    """Disparity of places (n, 2) of a level over the median of eight about them, that over the smooth ground's, (n,)
    each, and the scatter of the first where scores are finite. [px]
    """
    smooth, turns = blurred(above, 0.25 * WIDTH_PX), np.arange(8) * math.pi / 4
    about = np.vstack([[0.0, 0.0], WIDTH_PX * np.column_stack([0.9 * np.cos(turns), 0.7 * np.sin(turns)])])
    y, x = np.nonzero(np.isfinite(score))
    ground = np.column_stack([x, y])[:: max(len(x) // 2000, 1)].astype(np.float64) * STEP_PX
    u, v = np.moveaxis(np.vstack([at, ground])[:, None] + about, -1, 0).astype(np.float32)
    if not len(u):
        return np.empty(0), np.empty(0), 1.0
    values = cv2.remap(smooth, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    middle = np.median(values[:, 1:], axis=1)
    raised, number = values[:, 0] - middle, len(at)
    return raised[:number], values[:number, 0], max(robust_scatter(raised[number:]), 1e-6)


def _alone(places: FloatArray, rank: FloatArray, reach: float = 0.6) -> npt.NDArray[np.intp]:
    """Numbers of places (n, 3) [px] that lie within `reach` widths of none of a higher rank, the highest first."""
    chosen: list[int] = []
    for k in np.argsort(-rank, kind="stable"):
        apart = np.abs(places[chosen, :2] - places[k, :2])
        wide = reach * np.maximum(places[chosen, 2], places[k, 2])
        if not ((apart[:, 0] < wide) & (apart[:, 1] < 0.8 * wide)).any():
            chosen.append(int(k))
    return np.array(chosen, dtype=np.intp)
