"""Rocks in a pair of pictures: what stands out of the ground's disparity and looks like a rock in this light.

A network says what looks like a rock (`rock_network`). The picture says how far that is to be trusted here: stones of
known size are rendered into both pictures, under the same Sun and on the ground that is there. How many of them are
found again is the completeness, and what they are measured as corrects the measures and gives their errors.
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
from lunarsci.images.pictures import cv2
from lunarsci.images.rock_network import WIDTH_PX, RockCandidates, blurred, embedded_network, rock_candidates
from lunarsci.images.stones import FLATNESS, Image, StonePair, put_stone, spots
from lunarsci.result import Progress
from lunarsci.sun import upward

RANGES_M = (0.0, 2.5, 3.5, 5.0, 7.0)
"""Ends of the ranges that completeness is told by. [m]"""
FEWEST = 12
"""Rocks put in and found without which measures are not corrected; assumed."""
BEFORE = 10, 1000
"""Rocks among candidates that are counted before a picture is seen; assumed. Without them 6.5 instead of 5.3 % of finds
were false on 13 scenes that the network had not seen."""
ASSUMED = (0.0, 0.25), (0.45, 0.0, 0.1), (0.2, 0.2), (0.0, 0.2)
"""Those of `_Measures` then; assumed."""


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
    false_share : expected share of false ones, by the taught network or by what its ground alone makes here. [-]
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
    upright = rock_candidates(scene, largest_m)
    report(2, 4)
    trials = [_trial(scene, largest_m, rng) for _ in range(2)]
    put, chosen = (np.concatenate([trial[k] for trial in trials]) for k in (0, 2))
    parts = zip(*(c.only(k[k >= 0]) for _, c, k in trials), strict=True)
    again = RockCandidates(*(np.concatenate(part) for part in parts))
    report(3, 4)
    doubt, threshold = _false_rate(upright.scores, embedded_network().ratio, false_share)
    sure = np.flatnonzero(upright.scores >= threshold)
    chances = 1.0 - doubt(upright.scores[sure])
    pits = _pits(scene, largest_m, upright.only(sure), threshold)
    chances = _with_false_share(chances, _share_of_bumps(pits, len(sure)))
    detected = np.zeros(len(put), dtype=bool)
    detected[chosen >= 0] = again.scores >= threshold
    measures = _Measures.learned(scene, put[chosen >= 0], again)
    return RockSurvey(
        rocks=tuple(measures.rocks(upright.only(sure), chances, pose, matches.rectified.turn)),
        threshold=float(chances.min(initial=1.0)),
        false_share=float(1.0 - chances.mean()) if len(sure) else 0.0,
        completeness=tuple(_completeness(scene, put, detected, sizes_m)),
        searched_m2=_area_m2(scene),
        sun_deg=sun_deg,
    )


def _share_of_bumps(pits: int, finds: int) -> float:
    """Expected share of finds that are bumps of the ground, where so many pits look as much like rocks. [-]

    Both are counts of one rate, whose prior is that of Jeffreys (1961, Theory of Probability, ISBN 978-0-19-850368-2);
    no number of rocks among the finds is likelier than another beforehand.
    """
    from scipy.special import gammaln

    bumps = np.arange(finds + 1)
    ln_weight = gammaln(bumps + pits + 0.5) - gammaln(bumps + 1) - bumps * math.log(2.0)
    return float(np.average(bumps, weights=np.exp(ln_weight - ln_weight.max()))) / max(finds, 1)


def _pits(scene: StonePair, largest_m: float, rocks: RockCandidates, threshold: float) -> int:
    """How many pits of the ground look like rocks, seen as bumps under a reversed Sun; bumps do as often.

    Ground that rises as it falls makes as many of either, and rocks make none away from themselves (competition with
    decoys: Elias & Gygi 2007, 10.1038/nmeth1019).
    """
    upwards = scene.up * (scene.up @ scene.sun)
    turned = scene._replace(above=-scene.above, sun=2.0 * upwards - scene.sun)
    decoys = rock_candidates(turned, largest_m)
    places = decoys.places[decoys.scores >= threshold]
    apart = np.linalg.norm(places[:, None, :2] - rocks.places[None, :, :2], axis=-1)
    near = apart <= np.maximum(places[:, None, 2], rocks.places[None, :, 2])
    return int((~near.any(axis=1)).sum())


def _with_false_share(chances: FloatArray, share: float) -> FloatArray:
    """Probabilities of which `share` are false, where more are than they say: the odds of all less by one factor. (n,)

    What the ground makes here is odds beforehand, which differ from those of the scenes that taught the network.
    """
    from scipy.optimize import brentq
    from scipy.special import expit, logit

    if not len(chances) or share <= 1.0 - chances.mean():
        return chances
    least = float(np.finfo(float).eps)
    ln_odds = logit(np.clip(chances, least, 1.0 - least))
    most = ln_odds.max() - logit(least)
    less = brentq(lambda less: float(1.0 - expit(ln_odds - less).mean()) - min(share, 1.0 - least), 0.0, most)
    return np.asarray(expit(ln_odds - less))


def _trial(
    scene: StonePair, largest_m: float, rng: np.random.Generator
) -> tuple[FloatArray, RockCandidates, npt.NDArray[np.intp]]:
    """Rocks put in: u, v, diameter, height [m]; candidates of that picture, and which of these each is; -1 for none.

    (n, 4), (n,). A candidate is a rock if it lies within what shows of it.
    """
    put = spots(scene, largest_m, rng)
    pictures = scene.left.copy(), scene.right.copy()
    noise = 0.004 * float(np.percentile(scene.left, 90))
    shown = np.array([put_stone(scene, pictures, spot, noise, rng) for spot in put])
    seen = np.isfinite(shown).all(axis=1)
    changed = scene._replace(left=pictures[0], right=pictures[1], above=_parallax(scene.ground, *pictures))
    detected = rock_candidates(changed, largest_m)
    apart = np.abs(detected.places[:, :2] - shown[seen][:, None, :2])
    on = (apart < 0.5 * shown[seen][:, None, 2:] + 1).all(axis=2)
    best = np.where(on, detected.scores, -np.inf).argmax(axis=1)
    return put[seen], detected, np.where(on.any(axis=1), best, -1)


def _scene(
    matches: StereoMatches, pose: Pose, sun_deg: tuple[float, float] | None
) -> tuple[StonePair, tuple[float, float]]:
    """The pair with its ground, and azimuth and elevation of the Sun [deg], found where they are not given."""
    frame, ground = matches.rectified, _ground(matches.disparity)
    left, right = (np.asarray(p, dtype=np.float32) for p in (matches.left, matches.right))
    near = blurred(np.isfinite(matches.disparity).astype(np.float32), 4.0) > 0.01
    lit = blurred(left, 15.0) > DARK * np.percentile(left, 90)
    depth = frame.focal_px * frame.baseline_m / np.maximum(ground, 1.0)
    shown = np.arange(left.shape[1]) - ground > 0.5 * WIDTH_PX
    searched = near & lit & shown & (depth < RANGES_M[-1])
    if searched.sum() < 1e4:
        raise DataError(f"less than 10,000 pixels of lit ground within {RANGES_M[-1]:g} m are seen by both cameras")
    turn = frame.turn @ pose.rotation.T
    above = _parallax(ground, left, right)
    lens = frame.focal_px, frame.center_px, frame.baseline_m
    scene = StonePair(left, right, ground, above, searched, *lens, turn[:, 2], turn[:, 2])
    sun_deg = sun_deg or _likeliest_sun(scene, turn)
    return scene._replace(sun=turn @ upward(*sun_deg)), sun_deg


def _likeliest_sun(scene: StonePair, turn: FloatArray) -> tuple[float, float]:
    """Azimuth and elevation [deg], in steps of 15, whose light on the slopes goes best with that of the picture.

    Light is that of Lommel and Seeliger; compared are logarithms less their means about, by their correlation.
    `turn` turns a direction of the world into the frame.
    """
    disparity, small = scene.ground + scene.above, 0.125
    d, light, part = (
        cv2.resize(blurred(a, 4.0), None, fx=small, fy=small, interpolation=cv2.INTER_LINEAR)
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
        return np.asarray((logs - blurred(logs, 8.0))[good], dtype=float)

    seen, best, detected = about(light / np.percentile(light, 90)), -2.0, (0.0, 30.0)
    for azimuth in range(0, 360, 15):
        for rise in (15, 30, 45, 60):
            mu0 = np.maximum(normal @ (turn @ upward(azimuth, rise)), 0.0)
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
        weight = blurred(part.astype(np.float32), 30.0)
        mean = blurred(np.where(part, rest, 0.0).astype(np.float32), 30.0)
        mean = np.where(weight > 1e-3, mean / np.maximum(weight, 1e-3), 0.0)
        part = valid & (np.abs(rest - mean) < 3 * robust_scatter((rest - mean)[valid], 0.0))
    return np.asarray(terms @ plane + mean, dtype=np.float32)


def _parallax(ground: Image, left: Image, right: Image) -> Image:
    """Disparity over that of the smooth ground, first in a quarter of the size, then about that. (h, w) [px]

    Each is that of the least sum of squares under a Gaussian, a mean by how sharp its minima are: in the dark and on
    what is plain the surroundings decide.
    """
    top = 0.06 * np.percentile(left, 90)
    left, right = (p / (blurred(p, 12.0) + top) for p in (left, right))
    quarter = [cv2.resize(p, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) for p in (left, right, ground)]
    coarse, sharp = _least_squares(quarter[0], quarter[1], quarter[2] / 4, np.arange(-2.0, 6.1, 0.5), 1.5)
    coarse = _weighted(cv2.medianBlur(coarse, 3), sharp, 0.05, (1.5,))
    base = blurred(4 * cv2.resize(coarse, left.shape[::-1], interpolation=cv2.INTER_LINEAR), 3.0)
    fine, sharp = _least_squares(left, right, ground + base, np.arange(-2.5, 3.6, 0.5), 2.0)
    return _weighted(cv2.medianBlur(base + fine, 3), sharp, 0.5, (1.0, 3.0, 9.0))


def _least_squares(left: Image, right: Image, base: Image, steps: FloatArray, sigma: float) -> tuple[Image, Image]:
    """Disparity over a base (h, w) at the least sum of squares, and the curvature there, of even steps [px]."""
    v, u = np.mgrid[: left.shape[0], : left.shape[1]].astype(np.float32)
    sums = np.empty((len(steps), *left.shape), dtype=np.float32)
    for layer, step in zip(sums, steps, strict=True):
        moved = cv2.remap(right, u - base - np.float32(step), v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        layer[:] = blurred((moved - left) ** 2, sigma)
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
        total, sums = total + share * blurred(weight * values, sigma), sums + share * blurred(weight, sigma)
    return np.asarray(total / sums)


def _logistic(rows: FloatArray, true: FloatArray, ridge: float) -> tuple[FloatArray, FloatArray]:
    """Coefficients (k + 1,), the constant first, and their covariance, of a logistic regression on rows (n, k).

    `true` (n,) is 0 or 1, `ridge` the inverse variance that all but the constant have beforehand.
    """
    design = np.column_stack([np.ones(len(rows)), rows])
    values, prior = np.zeros(design.shape[1]), ridge * np.eye(design.shape[1])
    prior[0, 0] = 1e-3
    for _ in range(40):
        chance = 1.0 / (1.0 + np.exp(-np.clip(design @ values, -30, 30)))
        normal = (design * (chance * (1 - chance))[:, None]).T @ design + prior
        step = np.linalg.solve(normal, design.T @ (true - chance) - prior @ values)
        values += step
        if np.abs(step).max() < 1e-6:
            break
    return values, np.linalg.inv(normal)


def _false_rate(
    upright: FloatArray, odds: Callable[[FloatArray], FloatArray], false_share: float
) -> tuple[Callable[[FloatArray], FloatArray], float]:
    """The chance that a find of a score is none, and the least score at which such a share of all is expected false.

    Candidates are a mixture (local false discovery rate: Efron 2008, 10.1214/07-STS236): `odds` is the ratio of the
    densities of scores of rocks and of ground; the share of rocks has the prior of `BEFORE`, and is the most probable.
    """
    rocks, number = BEFORE[0] + 0.5, BEFORE[1] + len(upright) + 1
    share = rocks / number
    for _ in range(200):
        rock = share * odds(upright)
        share = float((rock / (rock + 1 - share)).sum() + rocks) / number

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
        start = cls(scene, *ASSUMED)
        if len(put) < FEWEST:
            return start
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

    values, covariance = _logistic(rows(put[:, 2], away), detected.astype(float), 0.1)
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
