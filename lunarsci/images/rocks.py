"""Rocks in a pair of pictures: what stands out of the ground's disparity and looks like a rock in this light.

The picture teaches what a rock is. Polyhedra of known size are rendered into both pictures, under the same Sun and on
the ground that is there; what tells these from bumps of the ground is learned from them (Fisher's discriminant, then
logistic regression), how many are found again is the completeness, and what they are measured as corrects the measures
and gives their errors. What the ground looks like, and how many finds are false, tells the same search with the ground
upside down, where there are no rocks (Elias & Gygi 2007, 10.1038/nmeth1019).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, robust_fit, robust_scatter
from lunarsci.errors import DataError
from lunarsci.images.camera import Pose
from lunarsci.images.matching import DARK, StereoMatches
from lunarsci.images.pictures import open_cv
from lunarsci.images.stones import FLATNESS, SMALLEST_M, Image, StonePair, put_stone, spots
from lunarsci.result import Progress

ROCK_PX, HALF_PX, RATIO, LEVELS = 7.0, 6, 1.3, 13
"""A rock is so wide on the level of the pyramid that looks for its size [px], templates are 2 HALF_PX + 1 px wide, and
levels are apart by this ratio: a Gaussian between two of them loses 1 - 2 r^0.5 / (1 + r) = 1 % of its contrast."""
RANGES_M = (0.0, 2.5, 3.5, 5.0, 7.0)
"""Ends of the ranges that completeness is told by. [m]"""
FEWEST = 12
"""Rocks put in and found, and decoys, without which nothing is learned; assumed."""
LEAST = 2.8
"""Deviations of the ground's own scatter below which nothing is looked at: a search's beginning, not a decision."""
RINGS = np.array([0.0, 0.2, 0.4, 0.65, 0.9, 1.2])
"""Radii of the circles about a candidate on which pictures are looked at, in its widths."""


class Level(NamedTuple):
    """One level of the pyramid.

    Attributes
    ----------
    width_px : of the rocks that it looks for, in the picture. [px]
    scale : its pixels over the picture's. [-]
    images : disparity over the ground's in widths, logarithm of the light, and of its gradient. (3, y, x)
    stands_out : by how much the middle is over the highest, the second and the third of eight places about it, and over
        the higher end of the lowest of four lines through it. (4, y, x) [widths]
    """

    width_px: float
    scale: float
    images: Image
    stands_out: Image


class RockCandidates(NamedTuple):
    """What may be rocks.

    Attributes
    ----------
    places : u, v and width. (n, 3) [px]
    features : what tells rocks from ground. (n, k)
    stands_out : by how many deviations of the ground's own scatter. (n,)
    raised_px, disparity : over what is about it, and in all. (n,) [px]
    """

    places: FloatArray
    features: FloatArray
    stands_out: FloatArray
    raised_px: FloatArray
    disparity: FloatArray

    def only(self, which: npt.NDArray[np.intp]) -> "RockCandidates":
        """Some of them."""
        return RockCandidates(*(part[which] for part in self))


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedRock:
    """One rock, with what to keep away from.

    Attributes
    ----------
    x_m, y_m : its middle. [m]
    diameter_m, diameter_m_sigma : its width, and the standard error. [m]
    height_m, height_m_sigma : of its top over the ground, and the standard error. [m]
    significance : by how many standard deviations of the ground's relief and errors it stands out. [-]
    probability : that it is a rock. [-]
    range_m : distance from the left camera. [m]
    keepout_m : radius about the middle in which no wheel should go. [m]
    """

    x_m: float
    y_m: float
    diameter_m: float
    diameter_m_sigma: float
    height_m: float
    height_m_sigma: float
    significance: float
    probability: float
    range_m: float
    keepout_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Completeness:
    """Share of rocks of a diameter that are found at some range, where they are in view.

    Attributes
    ----------
    diameter_m, height_m : of the rocks. [m]
    range_from_m, range_to_m : ends of the range. [m]
    trials : how many rocks of up to half as large again, or less by that, were put in there.
    share : of these, those that are found: by logistic regression on size and range over all that were put in. [-]
    share_low, share_high : ends of its interval of 68 %. [-]
    """

    diameter_m: float
    height_m: float
    range_from_m: float
    range_to_m: float
    trials: int
    share: float
    share_low: float
    share_high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RockSurvey:
    """Rocks of a pair.

    Attributes
    ----------
    rocks : the likeliest first.
    threshold : least probability of a rock that is listed. [-]
    false_share : expected share of false ones. [-]
    completeness : by diameter and range.
    searched_m2 : area of the ground that was searched. [m2]
    sun_deg : azimuth, from x towards y, and elevation of the Sun, given or found. [deg]
    """

    rocks: tuple[DetectedRock, ...]
    threshold: float
    false_share: float
    completeness: tuple[Completeness, ...]
    searched_m2: float
    sun_deg: tuple[float, float]


def find_rocks(
    matches: StereoMatches,
    pose: Pose,
    *,
    sun_deg: tuple[float, float] | None = None,
    largest_m: float = 0.3,
    false_share: float = 0.05,
    sizes_m: tuple[float, ...] = (0.05, 0.07, 0.1, 0.2),
    seed: int = 0,
    progress: Progress | None = None,
) -> RockSurvey:
    """Rocks up to a diameter, so few of them false, and how many of `sizes_m` would be found.

    `sun_deg` is azimuth, from x towards y, and elevation; without it that under which the ground's slopes look most as
    they do is taken. Raises DataError where too little ground is seen.
    """
    report, rng = progress or (lambda *_: None), np.random.default_rng(seed)
    scene, sun_deg = _scene(matches, pose, sun_deg)
    report(1, 4)
    search = _Search(scene, largest_m, rng)
    upright, decoys = search.candidates(scene), search.candidates(scene, upside_down=True)
    report(2, 4)
    trials = [search.trial() for _ in range(2)]
    put, chosen = (np.concatenate([trial[k] for trial in trials]) for k in (0, 2))
    again = RockCandidates(
        *(np.concatenate([part[k[k >= 0]] for _, c, k in trials for part in [c[n]]]) for n in range(len(upright)))
    )
    report(3, 4)
    sure, chances, threshold, again_scores = _sure(upright, decoys, again, false_share, rng)
    detected = np.zeros(len(put), dtype=bool)
    detected[chosen >= 0] = again_scores >= threshold
    rocks: Iterator[DetectedRock] = iter(())
    if len(sure):
        measures = _Measures.learned(scene, put[chosen >= 0], again)
        rocks = measures.rocks(upright.only(sure), chances, pose, matches.rectified.turn)
    return RockSurvey(
        rocks=tuple(rocks),
        threshold=float(chances.min(initial=1.0)),
        false_share=float(1.0 - chances.mean()) if len(chances) else 0.0,
        completeness=tuple(_completeness(scene, put, detected, sizes_m)),
        searched_m2=_area_m2(scene),
        sun_deg=sun_deg,
    )


def _sure(
    upright: RockCandidates, decoys: RockCandidates, again: RockCandidates, false_share: float, rng: np.random.Generator
) -> tuple[npt.NDArray[np.intp], FloatArray, float, FloatArray]:
    """Numbers of the candidates that are rocks, their probabilities, the least score of these, and that of `again`.

    No candidate is one where hardly a rock that was put in became one: `again` are those.
    """
    if len(again.places) < FEWEST or len(decoys.places) < FEWEST:
        return np.empty(0, dtype=np.intp), np.empty(0), math.inf, np.zeros(len(again.places))
    for _ in range(2):
        scores = _scored(upright.features, decoys.features, again.features, rng)
        alone, mirrored = (_alone(c.places, z) for c, z in zip((upright, decoys), scores, strict=False))
        mirrored = mirrored[~_beside(decoys.only(mirrored), scores[1][mirrored], upright.only(alone), scores[0][alone])]
        false, rest = scores[1][mirrored], decoys.only(mirrored)
        if len(mirrored) < FEWEST:
            break
        decoys = rest
    doubt, threshold = _false_rate(scores[0][alone], false, scores[2], false_share)
    sure = alone[scores[0][alone] >= threshold]
    return sure, 1.0 - doubt(scores[0][sure]), threshold, scores[2]


def _blurred(values: Image, sigma: float) -> Image:
    """Under a Gaussian; under three squares of its variance where it is wide. (h, w)"""
    cv2 = open_cv()
    if sigma < 4:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), dtype=np.float32)
    side = round(math.sqrt(4 * sigma**2 + 1)) | 1
    for _ in range(3):
        values = cv2.blur(values, (side, side))
    return values


def _scene(
    matches: StereoMatches, pose: Pose, sun_deg: tuple[float, float] | None
) -> tuple[StonePair, tuple[float, float]]:
    """The pair with its ground, and azimuth and elevation of the Sun [deg], found where they are not given."""
    frame, ground = matches.rectified, _ground(matches.disparity)
    left, right = (np.asarray(p, dtype=np.float32) for p in (matches.left, matches.right))
    near = _blurred(np.isfinite(matches.disparity).astype(np.float32), 4.0) > 0.01
    lit = _blurred(left, 15.0) > DARK * np.percentile(left, 90)
    depth = frame.focal_px * frame.baseline_m / np.maximum(ground, 1.0)
    shown = np.arange(left.shape[1]) - ground > HALF_PX
    searched = near & lit & shown & (depth < RANGES_M[-1])
    if searched.sum() < 1e4:
        raise DataError(f"less than 10,000 pixels of lit ground within {RANGES_M[-1]:g} m are seen by both cameras")
    turn = frame.turn @ pose.rotation.T
    above = _parallax(ground, left, right)
    lens = frame.focal_px, frame.center_px, frame.baseline_m
    scene = StonePair(left, right, ground, above, searched, *lens, turn[:, 2], turn[:, 2])
    sun_deg = sun_deg or _likeliest_sun(scene, turn)
    return scene._replace(sun=turn @ _direction(*sun_deg)), sun_deg


def _direction(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """Unit vector of an azimuth, from x towards y, and an elevation. (3,)"""
    turn, rise = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise)])


def _likeliest_sun(scene: StonePair, turn: FloatArray) -> tuple[float, float]:
    """Azimuth and elevation [deg], in steps of 15, whose light on the slopes goes best with that of the picture.

    Light is that of Lommel and Seeliger; compared are logarithms less their means about, by their correlation.
    `turn` turns a direction of the world into the frame.
    """
    cv2 = open_cv()
    disparity, small = scene.ground + scene.above, 0.125
    d, light, part = (
        cv2.resize(_blurred(a, 4.0), None, fx=small, fy=small, interpolation=cv2.INTER_LINEAR)
        for a in (disparity, scene.left, scene.searched.astype(np.float32))
    )
    v, u = np.mgrid[: d.shape[0], : d.shape[1]] + 0.5
    pixels = np.column_stack([u.ravel(), v.ravel()]) / small - 0.5
    points = scene.points(pixels, np.maximum(d.ravel(), 1.0)).reshape(*d.shape, 3)
    down, across = np.gradient(points, axis=0), np.gradient(points, axis=1)
    normal, view = np.cross(across, down), -points / np.linalg.norm(points, axis=-1, keepdims=True)
    normal *= np.sign((normal * view).sum(-1, keepdims=True)) / np.linalg.norm(normal, axis=-1, keepdims=True)
    good = part > 0.99

    def about(values: FloatArray) -> FloatArray:
        logs = np.log(np.maximum(values, 0.0) + 0.05).astype(np.float32)
        return np.asarray((logs - _blurred(logs, 8.0))[good], dtype=float)

    seen, best, detected = about(light / np.percentile(light, 90)), -2.0, (0.0, 30.0)
    for azimuth in range(0, 360, 15):
        for rise in (15, 30, 45, 60):
            mu0 = np.maximum(normal @ (turn @ _direction(azimuth, rise)), 0.0)
            mu = np.maximum((normal * view).sum(-1), 0.02)
            alike = float(np.corrcoef(about(mu0 / (mu0 + mu)), seen)[0, 1])
            if alike > best:
                best, detected = alike, (float(azimuth), float(rise))
    return detected


def _ground(disparity: FloatArray) -> Image:
    """Disparity of the smooth ground: a quadric, and what is left of it under a wide Gaussian, robustly. (h, w) [px]"""
    height, width = disparity.shape
    v, u = np.mgrid[:height, :width] / np.array([height, width])[:, None, None] - 0.5
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    valid = np.isfinite(disparity)
    part = valid
    for _ in range(4):
        plane = np.linalg.lstsq(terms[part][::37], disparity[part][::37], rcond=None)[0]
        rest = disparity - terms @ plane
        part = valid & (np.abs(rest) < 4 * robust_scatter(rest[valid], 0.0))
    part = valid
    for _ in range(4):
        weight = _blurred(part.astype(np.float32), 30.0)
        mean = _blurred(np.where(part, rest, 0.0).astype(np.float32), 30.0)
        mean = np.where(weight > 1e-3, mean / np.maximum(weight, 1e-3), 0.0)
        part = valid & (np.abs(rest - mean) < 3 * robust_scatter((rest - mean)[valid], 0.0))
    return np.asarray(terms @ plane + mean, dtype=np.float32)


def _parallax(ground: Image, left: Image, right: Image) -> Image:
    """Disparity over that of the smooth ground, first in a quarter of the size, then about that. (h, w) [px]

    Each is that of the least sum of squares under a Gaussian, a mean by how sharp its minima are: in the dark and on
    what is plain the surroundings decide.
    """
    cv2, top = open_cv(), 0.06 * np.percentile(left, 90)
    left, right = (p / (_blurred(p, 12.0) + top) for p in (left, right))
    quarter = [cv2.resize(p, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) for p in (left, right, ground)]
    coarse, sharp = _least_squares(quarter[0], quarter[1], quarter[2] / 4, np.arange(-2.0, 6.1, 0.5), 1.5)
    coarse = _weighted(cv2.medianBlur(coarse, 3), sharp, 0.05, (1.5,))
    base = _blurred(4 * cv2.resize(coarse, left.shape[::-1], interpolation=cv2.INTER_LINEAR), 3.0)
    fine, sharp = _least_squares(left, right, ground + base, np.arange(-2.5, 3.6, 0.5), 2.0)
    return _weighted(cv2.medianBlur(base + fine, 3), sharp, 0.5, (1.0, 3.0, 9.0))


def _least_squares(left: Image, right: Image, base: Image, steps: FloatArray, sigma: float) -> tuple[Image, Image]:
    """Disparity over a base (h, w) at the least sum of squares, and the curvature there, of even steps [px]."""
    cv2 = open_cv()
    v, u = np.mgrid[: left.shape[0], : left.shape[1]].astype(np.float32)
    sums = np.empty((len(steps), *left.shape), dtype=np.float32)
    for layer, step in zip(sums, steps, strict=True):
        moved = cv2.remap(right, u - base - np.float32(step), v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        layer[:] = _blurred((moved - left) ** 2, sigma)
    least = np.clip(sums.argmin(axis=0), 1, len(steps) - 2)[None]
    low, middle, high = (np.take_along_axis(sums, least + k, 0)[0] for k in (-1, 0, 1))
    bend = np.maximum(low - 2 * middle + high, 1e-12)
    off = np.clip(0.5 * (low - high) / bend, -0.5, 0.5)
    return (steps[least[0]] + (steps[1] - steps[0]) * off).astype(np.float32), bend


def _weighted(values: Image, sharp: Image, floor: float, sigmas: tuple[float, ...]) -> Image:
    """Means under Gaussians, the wide ones where all that is near is blunt: below `floor` of the median. (h, w)"""
    weight = np.asarray((sharp / (sharp + floor * np.median(sharp))) ** 2 + 1e-6, dtype=np.float32)
    total, sums = np.zeros_like(values), np.zeros_like(values)
    for sigma in sigmas:
        share = 1.0 if sigma == sigmas[0] else 0.03
        total, sums = total + share * _blurred(weight * values, sigma), sums + share * _blurred(weight, sigma)
    return np.asarray(total / sums)


def _pyramid(scene: StonePair) -> list[Level]:
    """What a pair shows, level by level."""
    cv2, left = open_cv(), scene.left
    above = np.where(scene.searched, scene.above, 0.0).astype(np.float32)
    light = np.log(np.maximum(left, 0.0) / np.percentile(left, 90) + 0.03).astype(np.float32)
    slope = cv2.Sobel(light, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(light, cv2.CV_32F, 0, 1) ** 2
    images = above, light, np.log(_blurred(slope, 1.0) + 0.01)
    levels = []
    for width in ROCK_PX * RATIO ** np.arange(LEVELS):
        scale, shape = ROCK_PX / width, tuple(round(n * ROCK_PX / width) for n in left.shape[::-1])
        small = np.stack(
            [
                cv2.resize(_blurred(i, 0.25 / scale) if scale < 1 else i, shape, interpolation=cv2.INTER_LINEAR)
                for i in images
            ]
        )
        small[0] /= width
        levels.append(Level(float(width), scale, small, _stands_out(small[0])))
    return levels


def _stands_out(above: Image) -> Image:
    """`Level.stands_out` of a level's disparity (y, x) [widths]."""
    cv2, outer = open_cv(), _blurred(above, 0.2 * ROCK_PX)
    about, ranked = [], [np.full_like(above, -np.inf) for _ in range(3)]
    for turn in np.arange(8) * math.pi / 4:
        way = 0.9 * ROCK_PX * math.cos(turn), 0.8 * ROCK_PX * math.sin(turn)
        moved = np.array([[1, 0, -way[0]], [0, 1, -way[1]]], dtype=np.float32)
        lower = cv2.warpAffine(outer, moved, above.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
        about.append(lower)
        for k, high in enumerate(ranked):
            ranked[k], lower = np.maximum(high, lower), np.minimum(high, lower)
    lines = np.maximum.reduce([np.minimum(a, b) for a, b in zip(about[:4], about[4:], strict=True)])
    return np.asarray(_blurred(above, 0.25 * ROCK_PX) - np.stack([*ranked, lines]))


class _Search:
    """A search for rocks in one picture, with the templates and the scatter that it has from this picture."""

    def __init__(self, scene: StonePair, largest_m: float, rng: np.random.Generator) -> None:
        self.scene, self.largest_m, self.rng = scene, largest_m, rng
        self.levels = _pyramid(scene)
        _, changed, shown = self._put()
        taught = _pyramid(changed)
        patches = []
        for place in shown:
            number = round(math.log(max(place[2], 1.0) / ROCK_PX) / math.log(RATIO))
            if 0 <= number < LEVELS:
                patches.append(self._patch(taught[number], place))
        self.templates = [self._template(level, np.array(patches)) for level in self.levels]
        self.scatter: list[list[tuple[Image, Image]]] = []
        self.scatter = [
            [_by_range(layer, self.mask(level)) for layer in self._layers(k, level)]
            for k, level in enumerate(self.levels)
        ]

    def mask(self, level: Level) -> tuple[BoolArray, Image]:
        """Where a level looks, and the logarithm of the ground's disparity. (y, x) each"""
        cv2, shape = open_cv(), level.images.shape[:0:-1]
        ground = cv2.resize(self.scene.ground, shape, interpolation=cv2.INTER_LINEAR)
        part = cv2.resize(self.scene.searched.astype(np.uint8), shape, interpolation=cv2.INTER_NEAREST) > 0
        across = level.width_px * self.scene.baseline_m / np.maximum(ground, 1.0)
        part &= (across > SMALLEST_M / RATIO) & (across < 1.5 * self.largest_m)
        part[:4] = part[-4:] = part[:, :4] = part[:, -4:] = False
        return part, np.log(np.maximum(ground, 1.0))

    @staticmethod
    def _patch(level: Level, place: FloatArray) -> FloatArray:
        """Light and gradient about a place of the picture, less their means. (2, n)"""
        cv2, side = open_cv(), 2 * HALF_PX + 1
        u, v = (place[:2] + 0.5) * level.scale - 0.5
        rows = np.stack([cv2.getRectSubPix(i, (side, side), (float(u), float(v))).ravel() for i in level.images[1:]])
        return np.asarray(rows - rows.mean(axis=1, keepdims=True), dtype=float)

    def _template(self, level: Level, patches: FloatArray) -> Image | None:
        """Fisher's discriminant of light and gradient, rocks (n, 2, m) from the ground of a level. (2, y, x)"""
        part = self.mask(level)[0][HALF_PX:-HALF_PX, HALF_PX:-HALF_PX]
        places = np.argwhere(part)
        if len(places) < 600:
            return None
        side = 2 * HALF_PX + 1
        windows = np.lib.stride_tricks.sliding_window_view(level.images[1:], (side, side), axis=(1, 2))
        chosen = places[self.rng.permutation(len(places))[:2000]]
        ground = windows[:, chosen[:, 0], chosen[:, 1]].reshape(2, len(chosen), -1).swapaxes(0, 1).astype(float)
        ground -= ground.mean(axis=2, keepdims=True)
        unit = np.median(np.sqrt((ground**2).mean(axis=2)), axis=0)[:, None]
        rows = (ground / unit).reshape(len(ground), -1)
        apart = ((rows - rows.mean(axis=0)) ** 2).sum(axis=1)
        rows = rows[apart < np.quantile(apart, 0.95)]
        spread = np.cov(rows.T)
        spread += 0.2 * np.trace(spread) / len(spread) * np.eye(len(spread))
        mean = (patches / unit).reshape(len(patches), -1).mean(axis=0) - rows.mean(axis=0)
        weights = np.linalg.solve(spread, mean)
        weights = (weights / math.sqrt(weights @ spread @ weights)).reshape(2, -1)
        weights = (weights - weights.mean(axis=1, keepdims=True)) / unit
        return np.asarray(weights.reshape(2, side, side), dtype=np.float32)

    def _layers(self, number: int, level: Level) -> list[Image]:
        """How far each place of a level stands out, and how much it looks like a rock. 5 of (y, x)"""
        cv2, template = open_cv(), self.templates[number]
        if template is None:
            return []
        pairs = zip(level.images[1:], template, strict=True)
        looks = sum(cv2.filter2D(i, cv2.CV_32F, t, borderType=cv2.BORDER_REFLECT) for i, t in pairs)
        return [*level.stands_out, looks]

    def candidates(self, scene: StonePair, upside_down: bool = False) -> RockCandidates:
        """What stands out or looks like a rock, more than all within 0.6 of its width."""
        levels = self.levels if scene is self.scene else _pyramid(scene)
        if upside_down:
            levels = [_turned(level) for level in levels]
        places, features, sigmas, raised = [], [], [], []
        for number, level in enumerate(levels):
            layers = self._layers(number, level)
            if not layers:
                continue
            part, _ = self.mask(level)
            z = np.stack([(a - m) / s for a, (m, s) in zip(layers, self.scatter[number], strict=True)])
            total = 0.5 * np.clip(z[2:4], -3, 12).sum(axis=0) + 0.3 * np.clip(z[4], -4, 20)
            peak = (total == open_cv().dilate(total, np.ones((5, 5), np.uint8))) & part & (total > LEAST)
            y, x = np.nonzero(peak)
            place = np.column_stack([x + 0.5, y + 0.5]) / level.scale - 0.5
            about = _features(level, np.column_stack([x, y]).astype(np.float32))
            at = z[:, y, x].T
            places.append(np.column_stack([place, np.full(len(x), level.width_px)]))
            features.append(np.column_stack([np.sign(at) * np.log1p(np.abs(at)), about]))
            sigmas.append(total[y, x])
            raised.append(level.width_px * np.sinh(about[:, 1]) / 20)
        if not places:
            raise DataError("too little lit ground is seen near enough for rocks")
        where = np.concatenate(places)
        parts = [np.concatenate(part) for part in (features, sigmas, raised)]
        detected = RockCandidates(where, parts[0], parts[1], parts[2], scene.feet(where)[1])
        return detected.only(_alone(detected.places, detected.stands_out, 0.6))

    def _put(self) -> tuple[FloatArray, StonePair, FloatArray]:
        """Rocks put in (n, 4): u, v, diameter, height [m]; the scene then; what shows of each, u, v, width, height."""
        scene = self.scene
        put = spots(scene, self.largest_m, self.rng)
        pictures = scene.left.copy(), scene.right.copy()
        noise = 0.004 * float(np.percentile(scene.left, 90))
        shown = np.array([put_stone(scene, pictures, spot, noise, self.rng) for spot in put])
        seen = np.isfinite(shown).all(axis=1)
        changed = scene._replace(left=pictures[0], right=pictures[1], above=_parallax(scene.ground, *pictures))
        return put[seen], changed, shown[seen]

    def trial(self) -> tuple[FloatArray, RockCandidates, npt.NDArray[np.intp]]:
        """Rocks put in, candidates of that picture, and which of these is each of those; -1 for none. (n, 4), (n,)"""
        put, changed, shown = self._put()
        detected = self.candidates(changed)
        chosen = np.full(len(put), -1, dtype=np.intp)
        for k, (u, v, width, height) in enumerate(shown):
            apart = np.abs(detected.places[:, :2] - (u, v))
            on = np.flatnonzero((apart[:, 0] < 0.5 * width + 1) & (apart[:, 1] < 0.5 * height + 1))
            if len(on):
                chosen[k] = on[detected.stands_out[on].argmax()]
        return put, detected, chosen


def _turned(level: Level) -> Level:
    """A level with the ground upside down."""
    images = level.images * np.array([-1, 1, 1], dtype=np.float32)[:, None, None]
    return level._replace(images=images, stands_out=_stands_out(images[0]))


def _by_range(layer: Image, where: tuple[BoolArray, Image]) -> tuple[Image, Image]:
    """Median and robust scatter of a layer at the disparity of each place: of six classes, between them linear."""
    part, ground = where
    if part.sum() < 600:
        return np.zeros_like(layer), np.full_like(layer, np.inf)
    values, at = layer[part], ground[part]
    edges = np.quantile(at, np.linspace(0, 1, 7))
    classes = [values[(at >= low) & (at <= high)] for low, high in pairwise(edges)]
    middles = 0.5 * (edges[1:] + edges[:-1])
    numbers = [np.median(c) for c in classes], [max(robust_scatter(c), 1e-9) for c in classes]
    return tuple(np.interp(ground, middles, n).astype(np.float32) for n in numbers)  # type: ignore[return-value]


def _features(level: Level, places: Image) -> FloatArray:
    """What eight rays from places x, y (n, 2) of a level meet: of disparity, light, gradient, and size. (n, 15)"""
    turns = np.arange(8) * math.pi / 4
    x = places[:, :1, None] + ROCK_PX * RINGS[:, None] * np.cos(turns)
    y = places[:, 1:, None] + 0.8 * ROCK_PX * RINGS[:, None] * np.sin(turns)
    if not len(places):
        return np.empty((0, 15))
    flat = [a.reshape(len(places), -1).astype(np.float32) for a in (x, y)]
    above, light, slope = (
        open_cv()
        .remap(np.ascontiguousarray(i), *flat, open_cv().INTER_LINEAR, borderMode=open_cv().BORDER_REPLICATE)
        .reshape(x.shape)
        for i in level.images
    )
    out = [part[:, 4:].mean(axis=1) for part in (above, light, slope)]
    height, bright, rough = (np.sort(part, axis=1) for part in out)
    inner = np.sort(above[:, :4].reshape(len(x), -1), axis=1), np.sort(light[:, :4].reshape(len(x), -1), axis=1)
    middle, dark, grain = above[:, :3].mean(axis=(1, 2)), inner[1][:, :6].mean(axis=1), slope[:, :4].mean(axis=(1, 2))
    lines = [(np.maximum(o[:, :4], o[:, 4:]), np.minimum(o[:, :4], o[:, 4:])) for o in out]
    stretched = np.arcsinh(
        20
        * np.column_stack(
            [
                middle - height[:, -2],
                middle - np.median(height, axis=1),
                middle - out[0][:, 1:4].max(axis=1),
                inner[0][:, -8:].mean(axis=1) - np.median(height, axis=1),
                above[:, :4].std(axis=(1, 2)),
            ]
        )
    )
    rest = [
        dark - bright[:, 2],
        inner[1][:, -5:].mean(axis=1) - bright[:, -3],
        bright[:, 2] - bright[:, -2],
        dark - lines[1][0].min(axis=1),
        dark - lines[1][1].min(axis=1),
        grain - rough[:, 3],
        grain - rough[:, 6],
        grain - lines[2][1].max(axis=1),
        grain - lines[2][0].max(axis=1),
        np.full(len(x), math.log(level.width_px)),
    ]
    return np.column_stack([stretched, *rest])


def _alone(places: FloatArray, rank: FloatArray, reach: float = 0.9) -> npt.NDArray[np.intp]:
    """Numbers of places (n, 3) [px] that lie within `reach` widths of none of a higher rank, the highest first."""
    chosen: list[int] = []
    for k in np.argsort(-rank, kind="stable"):
        apart = np.abs(places[chosen, :2] - places[k, :2])
        wide = reach * np.maximum(places[chosen, 2], places[k, 2])
        if not ((apart[:, 0] < wide) & (apart[:, 1] < 0.85 * wide)).any():
            chosen.append(int(k))
    return np.array(chosen, dtype=np.intp)


def _beside(decoys: RockCandidates, low: FloatArray, upright: RockCandidates, high: FloatArray) -> BoolArray:
    """Decoys (n,) that are but the shadow or the dip beside a candidate of a higher score, within two widths of it."""
    apart = np.abs(decoys.places[:, None, :2] - upright.places[:, :2]).max(axis=-1)
    wide = np.maximum(decoys.places[:, None, 2], upright.places[:, 2])
    return np.asarray(((apart < 1.3 * wide) & (high > low[:, None])).any(axis=1))


def _logistic(rows: FloatArray, true: FloatArray, weight: FloatArray, ridge: float) -> tuple[FloatArray, FloatArray]:
    """Coefficients (k + 1,), the constant first, and their covariance, of a logistic regression on rows (n, k).

    `true` (n,) is 0 or 1, `ridge` the inverse variance that all but the constant have beforehand.
    """
    design = np.column_stack([np.ones(len(rows)), rows])
    values, prior = np.zeros(design.shape[1]), ridge * np.eye(design.shape[1])
    prior[0, 0] = 1e-3
    for _ in range(40):
        chance = 1.0 / (1.0 + np.exp(-np.clip(design @ values, -30, 30)))
        normal = (design * (weight * chance * (1 - chance))[:, None]).T @ design + prior
        step = np.linalg.solve(normal, design.T @ (weight * (true - chance)) - prior @ values)
        values += step
        if np.abs(step).max() < 1e-6:
            break
    return values, np.linalg.inv(normal)


def _scored(
    upright: FloatArray, decoys: FloatArray, rocks: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithm of how much likelier features (n, k) are a rock's than the ground's, of each of the three kinds.

    Rocks put in and decoys are told apart by what the other four fifths of them taught.
    """
    middle = np.median(decoys, axis=0)
    unit = np.array([max(robust_scatter(c), 1e-3 * float(c.std()) + 1e-9) for c in decoys.T])
    upright, decoys, rocks = (np.clip((part - middle) / unit, -5, 5) for part in (upright, decoys, rocks))
    scores = np.zeros(len(upright)), np.zeros(len(decoys)), np.zeros(len(rocks))
    folds = [rng.permutation(len(part)) % 5 for part in (decoys, rocks)]
    for k in range(5):
        ground, stones = (part[fold != k] for part, fold in zip((decoys, rocks), folds, strict=True))
        true = np.repeat([0.0, 1.0], [len(ground), len(stones)])
        weight = np.where(true > 0, len(ground) / max(len(stones), 1), 1.0)
        values, _ = _logistic(np.vstack([ground, stones]), true, weight, 10.0)
        scores[0][:] += (values[0] + upright @ values[1:]) / 5
        for score, part, fold in zip(scores[1:], (decoys, rocks), folds, strict=True):
            score[fold == k] = values[0] + part[fold == k] @ values[1:]
    return scores


def _false_rate(
    upright: FloatArray, decoys: FloatArray, rocks: FloatArray, false_share: float
) -> tuple[Callable[[FloatArray], FloatArray], float]:
    """The chance that a find of a score is none, and the least score at which such a share of all is expected false.

    Candidates are a mixture: of the scores of rocks put in, and of those of decoys (local false discovery rate: Efron
    2008, 10.1214/07-STS236). Their ratio is a logistic regression on max(score, 0), made smooth; the share of rocks has
    the prior of half a rock, and is the most probable one.
    """
    scores, true = np.concatenate([rocks, decoys]), np.repeat([1.0, 0.0], [len(rocks), len(decoys)])
    weight = np.where(true > 0, len(decoys) / len(rocks), 1.0)
    values, _ = _logistic(np.logaddexp(0.0, scores)[:, None], true, weight, 0.01)

    def odds(at: FloatArray) -> FloatArray:
        return np.asarray(np.exp(np.clip(values[0] + values[1] * np.logaddexp(0.0, at), -50, 50)))

    share = 0.5 / (len(upright) + 1)
    for _ in range(200):
        rock = share * odds(upright)
        share = float((rock / (rock + 1 - share)).sum() + 0.5) / (len(upright) + 1)

    def doubt(at: FloatArray) -> FloatArray:
        return np.asarray((1 - share) / (1 - share + share * odds(at)))

    ranked = np.sort(upright)[::-1]
    passing = ranked[np.cumsum(doubt(ranked)) / np.arange(1, len(ranked) + 1) <= false_share]
    every = np.linspace(0, 60, 601)
    alone = every[doubt(every) <= false_share]
    return doubt, min(passing.min(initial=math.inf), alone.min(initial=math.inf))


class _Measures(NamedTuple):
    """What is measured of candidates, and what that of rocks put in was off by: median and scatter.

    Attributes
    ----------
    scene : that they are in.
    size : of the logarithm of the true diameter over that of the level.
    flatness : height over diameter as a line in that which the disparity says, and the scatter about it.
    ahead, aside : how far the middle is behind, and to the right of, what was seen of it, in diameters.
    """

    scene: StonePair
    size: tuple[float, float]
    flatness: tuple[float, float, float]
    ahead: tuple[float, float]
    aside: tuple[float, float]

    @classmethod
    def learned(cls, scene: StonePair, put: FloatArray, detected: RockCandidates) -> "_Measures":
        """From rocks put in (n, 4) and the candidates that they are."""
        start = cls(scene, (0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
        across, rise, middle, ways = start._raw(detected)
        logs = np.log(put[:, 2] / across)
        size = float(np.median(logs)), robust_scatter(logs)
        across *= math.exp(size[0])
        lie = np.column_stack([np.ones(len(put)), np.clip(rise / across, 0.0, 1.5)])
        line, _ = robust_fit(lie, put[:, 3] / across)
        off = ((scene.feet(put)[0] - middle) / across[:, None])[:, None] @ ways.swapaxes(1, 2)
        ahead, aside = off[:, 0].T
        scatters = [(float(np.median(a)), robust_scatter(a)) for a in (ahead, aside)]
        return cls(
            scene,
            size,
            (float(line[0]), float(line[1]), robust_scatter(put[:, 3] / across - lie @ line, 0.0)),
            *scatters,
        )

    def _raw(self, detected: RockCandidates) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Width of the level (n,), rise over the ground about (n,), place of what is seen (n, 3) [m], and the level
        directions ahead and to the right (n, 2, 3)."""
        scene = self.scene
        points = scene.points(detected.places, detected.disparity)
        across = detected.places[:, 2] * scene.baseline_m / detected.disparity
        rise = detected.raised_px / detected.disparity * -(points @ scene.up)
        ahead = points - (points @ scene.up)[:, None] * scene.up
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        return across, rise, points, np.stack([ahead, np.cross(ahead, scene.up)], axis=1)

    def rocks(
        self, detected: RockCandidates, chances: FloatArray, pose: Pose, turn: FloatArray
    ) -> Iterator[DetectedRock]:
        """The rocks that candidates are; `turn` turns a direction of the left camera's frame into the scene's."""
        if not len(chances):
            return
        across, rise, middle, ways = self._raw(detected)
        across = across * math.exp(self.size[0])
        flat = np.clip(self.flatness[0] + self.flatness[1] * np.clip(rise / across, 0.0, 1.5), 0.1, 1.5)
        off = np.array([self.ahead[0], self.aside[0]])
        middle = middle + across[:, None] * np.einsum("k,nkc->nc", off, ways)
        world = pose.to_world(middle @ turn)
        spread = math.hypot(self.ahead[1], self.aside[1])
        for k, (wide, place) in enumerate(zip(across, world, strict=True)):
            sigma = float(wide) * self.size[1]
            yield DetectedRock(
                x_m=float(place[0]),
                y_m=float(place[1]),
                diameter_m=float(wide),
                diameter_m_sigma=sigma,
                height_m=float(wide * flat[k]),
                height_m_sigma=float(wide) * math.hypot(self.flatness[2], flat[k] * self.size[1]),
                significance=float(detected.stands_out[k]),
                probability=float(chances[k]),
                range_m=float(np.linalg.norm(middle[k])),
                keepout_m=0.5 * float(wide) + math.hypot(spread * float(wide), 0.5 * sigma),
            )


def _completeness(
    scene: StonePair, put: FloatArray, detected: BoolArray, sizes_m: tuple[float, ...]
) -> Iterator[Completeness]:
    """Shares by size and range, from rocks put in (n, 4) and whether they were found (n,)."""
    from scipy.special import expit

    away = np.linalg.norm(scene.feet(put)[0], axis=1)

    def rows(diameter: npt.ArrayLike, reach: npt.ArrayLike) -> FloatArray:
        return np.column_stack([np.log(np.asarray(diameter) / 0.1), np.log(np.asarray(reach) / 4.0)])

    values, covariance = _logistic(rows(put[:, 2], away), detected.astype(float), np.ones(len(put)), 0.1)
    for size in sizes_m:
        for low, high in pairwise(RANGES_M):
            there = (away >= low) & (away < high)
            if not there.any():
                continue
            design = np.array([1.0, *rows([size], [float(np.median(away[there]))])[0]])
            middle, sigma = float(design @ values), math.sqrt(design @ covariance @ design)
            yield Completeness(
                diameter_m=size,
                height_m=0.5 * sum(FLATNESS) * size,
                range_from_m=low,
                range_to_m=high,
                trials=int((there & (np.abs(np.log(put[:, 2] / size)) < math.log(1.5))).sum()),
                share=float(expit(middle)),
                share_low=float(expit(middle - sigma)),
                share_high=float(expit(middle + sigma)),
            )


def _area_m2(scene: StonePair) -> float:
    """Area of the level ground that the searched pixels show. [m2]"""
    v, u = np.nonzero(scene.searched)
    pixels = np.column_stack([u, v]).astype(float)
    points = scene.points(pixels, scene.at(pixels))
    area = points[:, 2] ** 3 / scene.focal_px**2 / np.maximum(-(points @ scene.up), 0.05 * points[:, 2])
    return float(area.sum())
