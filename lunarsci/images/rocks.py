"""Rocks in an elevation model: what stands out of the ground by more than the heights' own errors can.

How many finds are false follows from the same search in the model upside down, where there are no rocks; how many rocks
are missed, from rocks of known size that are put into the model and looked for.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label, maximum_filter, uniform_filter

from lunarsci.arrays import BoolArray, FloatArray, IndexArray, robust_scatter
from lunarsci.errors import ParameterError
from lunarsci.images.elevation import ElevationModel, mean_about

SCALES_M = (0.03, 0.05, 0.08, 0.13, 0.2, 0.32, 0.5)
"""Diameters that are looked for: a Gaussian of a size between two of them, which are apart by a factor r = 1.6, loses
1 - 2 r^0.5 / (1 + r) = 3 % of its significance. [m]"""
FLATNESS = 0.5
"""Height over diameter of rocks that are put in for trial, as half ellipsoids: the middle of means of 0.4 to 0.6 at
landing sites (Golombek & Rapp 1997, 10.1029/96JE03319)."""
FLATTEST = 0.15
"""Height over diameter below which a bump is ground, such as a berm beside a track; assumed, below most of the rocks of
Golombek & Rapp (1997)."""
AROUND = (2.0, 3.0)
"""From where to where the ground about a rock is looked at, in the scale at which it stands out most; assumed."""
LEAST = 3.5
"""Standard errors below which nothing is a rock; assumed."""
GROUND_SHARE = 2.5
"""Scale of the ground that rocks stand out of, in diameters of the largest rock; assumed."""
ERROR_CLASSES = 8
"""Classes of errors by which relief and errors are separated; assumed."""
TRIALS = 60
"""Rocks of a size put in at a time: their share is known to 0.5 / sqrt(60) = 0.06 or better."""


class Peaks(NamedTuple):
    """Nodes at which something stands out. (n,) each

    Attributes
    ----------
    rows, columns : of the nodes in the grid: y and x.
    significance : height over the ground in standard errors, the largest over the scales. [-]
    scale_m : one of `SCALES_M`, at which it is the largest. [m]
    """

    rows: IndexArray
    columns: IndexArray
    significance: FloatArray
    scale_m: FloatArray

    def only(self, which: list[int] | BoolArray) -> "Peaks":
        """Some of them."""
        return Peaks(self.rows[which], self.columns[which], self.significance[which], self.scale_m[which])


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedRock:
    """One rock, with what to keep away from.

    Attributes
    ----------
    x_m, y_m : its middle. [m]
    diameter_m, diameter_m_sigma : at the ground, from its area at half its height, and the standard error. [m]
    height_m, height_m_sigma : of its top over the ground, without the blur of matching, and the standard error. [m]
    significance : height over its standard error, at the scale at which that is largest. [-]
    keepout_m : radius about the middle in which no wheel should go. [m]
    """

    x_m: float
    y_m: float
    diameter_m: float
    diameter_m_sigma: float
    height_m: float
    height_m_sigma: float
    significance: float
    keepout_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Completeness:
    """Share of rocks of a diameter that are found where the random error of a node lies in a range.

    Attributes
    ----------
    diameter_m, height_m : of the rocks that were put in for trial. [m]
    sigma_from_m, sigma_to_m : ends of that range; NaN where the heights state no errors. [m]
    trials : how many rocks were put in.
    share : of these, those that were found again. [-]
    share_low, share_high : ends of the interval of 68 % (Wilson 1927, 10.1080/01621459.1927.10502953). [-]
    """

    diameter_m: float
    height_m: float
    sigma_from_m: float
    sigma_to_m: float
    trials: int
    share: float
    share_low: float
    share_high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RockSurvey:
    """Rocks of an elevation model.

    Attributes
    ----------
    rocks : the highest significance first.
    threshold : significance from which something is a rock, in standard errors. [-]
    false_share : expected share of false ones, from the search upside down. [-]
    completeness : by diameter and error of the heights.
    above_m : height over the ground. (ny, nx) [m]
    """

    rocks: tuple[DetectedRock, ...]
    threshold: float
    false_share: float
    completeness: tuple[Completeness, ...]
    above_m: FloatArray


def find_rocks(
    model: ElevationModel,
    *,
    largest_m: float = 0.5,
    false_share: float = 0.05,
    sizes_m: tuple[float, ...] = (0.05, 0.1, 0.2),
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> RockSurvey:
    """Rocks up to a diameter, so few of them false, and how many of `sizes_m` would be found.

    Raises ParameterError for a grid too coarse for any of the scales.
    """
    if model.spacing_m > 0.25 * largest_m:
        raise ParameterError(f"{model.name}: nodes every {model.spacing_m:g} m show no rocks of {largest_m:g} m")
    steps = progress or (lambda *_: None)
    above = height_over_ground(model, largest_m)
    finds, rocks = _rocks_of(model, above, _peaks(model, above, largest_m, LEAST))
    decoys, _ = _rocks_of(model, -above, _alone(_peaks(model, -above, largest_m, LEAST), finds, model.spacing_m))
    steps(1, 1 + len(sizes_m))
    threshold, share = _threshold(finds.significance, decoys.significance, false_share)
    rng = np.random.default_rng(seed)
    trials: list[Completeness] = []
    for k, size in enumerate(sizes_m):
        trials += _tried(model, above, size, largest_m, threshold, rng)
        steps(2 + k, 1 + len(sizes_m))
    return RockSurvey(
        rocks=tuple(rock for rock in rocks if rock.significance >= threshold),
        threshold=threshold,
        false_share=share,
        completeness=tuple(trials),
        above_m=above,
    )


def height_over_ground(model: ElevationModel, largest_m: float) -> FloatArray:
    """Heights less the ground's, which is smooth over `GROUND_SHARE` times the largest rock. (ny, nx) [m]

    The ground is the mean under a Gaussian, of what does not stand out of it, after a plane is taken off.
    """
    rest = above = model.less_plane()
    part = valid = np.isfinite(rest)
    for _ in range(4):
        above = rest - mean_about(np.where(part, rest, np.nan), 0.5 * GROUND_SHARE * largest_m / model.spacing_m)
        part = valid & (np.abs(above) < 2.5 * max(robust_scatter(above[valid]), 1e-12))
    return above


def _peaks(model: ElevationModel, above: FloatArray, largest_m: float, least: float) -> Peaks:
    """Nodes that stand out most among those within their own scale, by `least` standard errors, the surest first.

    `above` is the height over the ground (ny, nx) [m], as in what follows.
    """
    significance, scale = _standing_out(model, above, largest_m)
    alone = max(3, round(0.06 / model.spacing_m)) | 1
    rows, columns = np.nonzero((significance >= least) & (significance == maximum_filter(significance, alone)))
    order = np.argsort(-significance[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    peaks = Peaks(rows, columns, significance[rows, columns], scale[rows, columns])
    return peaks.only(_apart(rows, columns, 0.7 * np.maximum(peaks.scale_m, 0.05) / model.spacing_m))


def _apart(rows: IndexArray, columns: IndexArray, reach: FloatArray, most: float = math.inf) -> list[int]:
    """Numbers of the nodes that lie beyond the reach of all those taken before them, and these beyond theirs.

    Rows, columns and reach (n,) are in nodes; at most `most` are taken.
    """
    chosen: list[int] = []
    for k in range(len(rows)):
        away = np.hypot(rows[chosen] - rows[k], columns[chosen] - columns[k])
        if (away > np.maximum(reach[k], reach[chosen])).all():
            chosen.append(k)
        if len(chosen) == most:
            break
    return chosen


def _standing_out(model: ElevationModel, above: FloatArray, largest_m: float) -> tuple[FloatArray, FloatArray]:
    """Largest significance over the scales at each node, and its scale. (ny, nx), (ny, nx) [m]

    At each scale heights are averaged under a Gaussian less a ring about it. What they scatter by is the ground's own
    relief, the same everywhere, and the model's errors, where these are larger: both of the whole map, robustly.
    """
    valid = np.isfinite(above)
    sigma = model.layer("height_m_sigma")
    error = np.where(np.isfinite(sigma) & (sigma > 0), sigma, 1.0)
    best, scale = np.full(above.shape, -np.inf), np.zeros(above.shape)
    for size in SCALES_M:
        width = 0.3 * max(size, float(np.nanmedian(model.layer("resolution_m"))) or 0.0) / model.spacing_m
        if size > largest_m or width < 0.4:
            continue
        rise = mean_about(above, width) - mean_about(above, 2.5 * width)
        relief, share = _scatter(rise[valid], error[valid])
        significance = np.where(valid, rise / np.maximum(np.hypot(relief, share * error), 1e-12), -np.inf)
        better = significance > best
        best[better], scale[better] = significance[better], size
    return best, scale


def _scatter(values: FloatArray, error: FloatArray) -> tuple[float, float]:
    """The part of the scatter of values (n,) that is the same everywhere, in their unit, and the factor by which errors
    (n,) add to it [-]."""
    from scipy.optimize import nnls

    classes = np.searchsorted(np.quantile(error, np.linspace(0, 1, ERROR_CLASSES + 1)[1:-1]), error)
    members = [classes == k for k in np.unique(classes)]
    scatter = np.array([robust_scatter(values[part], 0.0) ** 2 for part in members])
    design = np.array([[1.0, float(np.median(error[part])) ** 2] for part in members])
    weight = 1.0 / np.maximum(scatter, 1e-12)
    relief, share = np.sqrt(nnls(design * weight[:, None], scatter * weight)[0])
    return float(relief), float(share)


def _alone(decoys: Peaks, finds: Peaks, spacing_m: float) -> Peaks:
    """Decoys that are not the dip that a rock beside them, which stands out more, makes in its surroundings."""
    reach = 1.5 * (np.maximum(finds.scale_m, 0.05) + np.maximum(decoys.scale_m, 0.05)[:, None]) / spacing_m
    away = np.hypot(finds.rows - decoys.rows[:, None], finds.columns - decoys.columns[:, None])
    return decoys.only(~((away <= reach) & (finds.significance >= decoys.significance[:, None])).any(axis=1))


def _threshold(true: FloatArray, false: FloatArray, false_share: float) -> tuple[float, float]:
    """Least significance at which at most such a share of the finds is false, and that share.

    `true` are the significances of the finds (n,), `false` those of the search upside down (m,). The number of false
    ones is that of the search upside down, and half a one more.
    """
    for level in np.sort(np.append(true, LEAST)):
        finds, decoys = int((true >= level).sum()), int((false >= level).sum())
        if level >= LEAST and (finds == 0 or (decoys + 0.5) / finds <= false_share or decoys == 0):
            return float(level), decoys / finds if finds else 0.0
    return float(true.max()) + 1.0, 0.0


def _rocks_of(model: ElevationModel, above: FloatArray, peaks: Peaks) -> tuple[Peaks, list[DetectedRock]]:
    """Peaks that are as high as rocks of their diameter are, the surest first, each rock once; and their rocks."""
    chosen: list[int] = []
    rocks: list[DetectedRock] = []
    for k in range(len(peaks.rows)):
        rock = _measured(model, above, peaks, k)
        again = any(math.hypot(rock.x_m - r.x_m, rock.y_m - r.y_m) < 0.5 * r.diameter_m for r in rocks)
        if rock.height_m >= FLATTEST * rock.diameter_m and not again:
            chosen.append(k)
            rocks.append(rock)
    return peaks.only(chosen), rocks


def _measured(model: ElevationModel, above: FloatArray, peaks: Peaks, number: int) -> DetectedRock:
    """Middle, diameter and height of what stands out at the node of a peak, by its `number`."""
    row, column, z = int(peaks.rows[number]), int(peaks.columns[number]), float(peaks.significance[number])
    inner, outer = (share * max(float(peaks.scale_m[number]), 0.05) / model.spacing_m for share in AROUND)
    reach = math.ceil(outer) + 1
    top, left = max(row - reach, 0), max(column - reach, 0)
    patch = above[top : row + reach + 1, left : column + reach + 1]
    row, column = row - top, column - left
    away = np.hypot(*np.ogrid[-row : patch.shape[0] - row, -column : patch.shape[1] - column])
    around = patch[np.isfinite(patch) & (away > inner)]
    patch = patch - (float(np.median(around)) if len(around) else 0.0)
    peak = float(np.nanmean(patch[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]))
    labels, _ = label(np.nan_to_num(patch, nan=-1.0) > 0.5 * peak)
    part = (labels == labels[row, column]) & (labels > 0)
    part[row, column] = True
    rows, columns = np.nonzero(part)
    resolution, sigma = (
        float(np.nan_to_num(model.layer(key)[top + row, left + column])) for key in ("resolution_m", "height_m_sigma")
    )
    across = 2.0 * math.sqrt(part.sum() / math.pi) * model.spacing_m
    # Half the height of a half ellipsoid is where its radius is 0.87 of that at the ground; matching widens it.
    diameter = max(math.sqrt(max((across / 0.87) ** 2 - resolution**2, 0.0)), model.spacing_m)
    gain = max(_gain(diameter, resolution), 0.15)
    sigma = max(sigma, abs(peak) / max(z, 1.0)) / gain
    blur = abs(peak) / gain * min(1.0, 0.3 * (1.0 - gain) / gain)
    error = math.hypot(model.spacing_m, 0.5 * resolution)
    return DetectedRock(
        x_m=float(model.x0_m + model.spacing_m * (left + columns.mean())),
        y_m=float(model.y0_m + model.spacing_m * (top + rows.mean())),
        diameter_m=diameter,
        diameter_m_sigma=error,
        height_m=peak / gain,
        height_m_sigma=math.hypot(sigma, blur),
        significance=z,
        keepout_m=0.5 * across + error,
    )


def _gain(diameter_m: float, resolution_m: float) -> float:
    """Height of the top of a half ellipsoid's mean under a square window, over its own. [-]"""
    across = np.linspace(-0.5, 0.5, 41) * resolution_m
    distance = np.hypot(*np.meshgrid(across, across)) / (0.5 * diameter_m)
    return float(np.sqrt(np.clip(1.0 - distance**2, 0.0, None)).mean())


def _tried(
    model: ElevationModel,
    above: FloatArray,
    diameter_m: float,
    largest_m: float,
    threshold: float,
    rng: np.random.Generator,
) -> Iterator[Completeness]:
    """How many rocks put into the model are found, in its better and its worse half."""
    from scipy.stats import binomtest

    valid = np.isfinite(above)
    rows, columns = np.unravel_index(rng.permutation(np.flatnonzero(valid))[:2000], above.shape)
    apart = np.full(len(rows), max(4 * diameter_m, 0.3) / model.spacing_m)
    chosen = _apart(rows, columns, apart, TRIALS)
    if not chosen:
        return
    rows, columns = rows[chosen], columns[chosen]
    put = np.zeros(above.shape)
    y, x = np.mgrid[: above.shape[0], : above.shape[1]]
    for row, column, (dy, dx) in zip(rows, columns, rng.uniform(-0.5, 0.5, (len(rows), 2)), strict=True):
        part = (slice(max(row - 60, 0), row + 61), slice(max(column - 60, 0), column + 61))
        distance = np.hypot(y[part] - row - dy, x[part] - column - dx) / (0.5 * diameter_m / model.spacing_m)
        put[part] += FLATNESS * diameter_m * np.sqrt(np.clip(1.0 - distance**2, 0.0, None))
    window = float(np.nan_to_num(np.nanmedian(model.layer("resolution_m")))) / model.spacing_m
    tried = dataclasses.replace(model, height_m=model.height_m + uniform_filter(put, max(1, round(window))))
    over = height_over_ground(tried, largest_m)
    _, finds = _rocks_of(tried, over, _peaks(tried, over, largest_m, threshold))
    there = np.array([(f.y_m - model.y0_m, f.x_m - model.x0_m) for f in finds]).reshape(-1, 2) / model.spacing_m
    away = np.hypot(rows[:, None] - there[:, 0], columns[:, None] - there[:, 1]).min(axis=1, initial=np.inf)
    hit = away <= max(0.5 * diameter_m / model.spacing_m, 2, 0.5 * window)
    errors = model.layer("height_m_sigma")
    sigma = errors[rows, columns]
    edges = np.nanquantile(errors[valid], (0, 0.5, 1)) if np.isfinite(sigma).any() else np.full(2, np.nan)
    halves = [sigma <= edges[1], sigma > edges[1]] if len(edges) == 3 else [np.ones(len(hit), bool)]
    for half, low, high in zip(halves, edges, edges[1:], strict=False):
        if half.any():
            one_sigma = binomtest(int(hit[half].sum()), int(half.sum())).proportion_ci(math.erf(0.5**0.5), "wilson")
            yield Completeness(
                diameter_m=diameter_m,
                height_m=FLATNESS * diameter_m,
                sigma_from_m=float(low),
                sigma_to_m=float(high),
                trials=int(half.sum()),
                share=float(hit[half].mean()),
                share_low=float(one_sigma.low),
                share_high=float(one_sigma.high),
            )
