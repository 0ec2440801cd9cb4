"""Rocks in an elevation model: what stands out of the ground by more than the heights' own errors can.

How many finds are false is told by the same search in the model upside down, where there are no rocks; how many rocks
are missed, by rocks of known size that are put into the model and looked for.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, robust_scatter
from lunarsci.errors import ParameterError
from lunarsci.images.elevation import ElevationModel

SCALES_M = (0.03, 0.05, 0.08, 0.13, 0.2, 0.32, 0.5)
"""Diameters that are looked for; assumed. [m]"""
FLATNESS = 0.5
"""Height over diameter of rocks that are put in for trial, as half ellipsoids; assumed, after a mean of 0.4 to 0.6 at
landing sites (Golombek & Rapp 1997, 10.1029/96JE03319)."""
FLATTEST = 0.15
"""Height over diameter below which a bump is ground, such as a berm beside a track; assumed, below most of the rocks of
Golombek & Rapp (1997)."""
SURELY, STEEP = 10.0, 0.3
"""Standard errors above which something is a rock or an edge, and the share of a dip that the rock beside it stands out
by at least; assumed."""
AROUND = (2.0, 3.0)
"""From where to where the ground about a rock is looked at, in the scale at which it stands out most; assumed."""
LEAST = 3.5
"""Standard errors below which nothing is a rock; assumed."""
GROUND_SHARE = 2.5
"""Scale of the ground that rocks stand out of, in diameters of the largest rock; assumed."""
ERROR_CLASSES = 8
"""Classes of errors from which relief and errors are told apart; assumed."""
TRIALS = 60
"""Rocks of a size put in at a time; assumed."""


class Found(NamedTuple):
    """Nodes (n,) at which something stands out, by how many standard errors, and at which scale [m]."""

    rows: npt.NDArray[np.intp]
    columns: npt.NDArray[np.intp]
    significance: FloatArray
    scale_m: FloatArray

    def kept(self, which: list[int] | BoolArray) -> "Found":
        """Those of some places."""
        return Found(self.rows[which], self.columns[which], self.significance[which], self.scale_m[which])


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundRock:
    """One rock: its middle, diameter and height with errors, and what to keep away from. [m]

    `significance` is in standard errors, `keepout_m` the radius about the middle.
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

    `share_low`, `share_high` end the interval of 68 % (Wilson 1927, 10.1080/01621459.1927.10502953).
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
    threshold : significance from which something is a rock.
    false_share : expected share of false ones, from the search upside down.
    completeness : by diameter and error of the heights.
    above_m : height over the ground. (ny, nx) [m]
    """

    rocks: tuple[FoundRock, ...]
    threshold: float
    false_share: float
    completeness: tuple[Completeness, ...]
    above_m: FloatArray


def height_over_ground(model: ElevationModel, largest_m: float) -> FloatArray:
    """Heights less the ground's, which is smooth over `GROUND_SHARE` times the largest rock. (ny, nx) [m]

    The ground is the mean under a Gaussian, of what does not stand out of it, after a plane is taken off.
    """
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(model.height_m)
    y, x = np.mgrid[: known.shape[0], : known.shape[1]]
    design = np.column_stack([np.ones(int(known.sum())), x[known], y[known]])
    plane = np.linalg.lstsq(design, model.height_m[known], rcond=None)[0]
    rest = np.where(known, model.height_m - (plane[0] + plane[1] * x + plane[2] * y), 0.0)
    width = 0.5 * GROUND_SHARE * largest_m / model.spacing_m
    weight = known.astype(float)
    above = rest
    for _ in range(4):
        ground = gaussian_filter(weight * rest, width) / np.maximum(gaussian_filter(weight, width), 1e-9)
        above = rest - ground
        scatter = robust_scatter(above[known])
        weight = known & (np.abs(above) < 2.5 * max(scatter, 1e-12))
        weight = weight.astype(float)
    return np.where(known, above, np.nan)


def _standing_out(model: ElevationModel, above: FloatArray, largest_m: float) -> tuple[FloatArray, FloatArray]:
    """Largest significance over the scales at each node, and its scale. (ny, nx), (ny, nx) [m]

    At each scale heights are averaged under a Gaussian less a ring about it. What they scatter by is the ground's own
    relief, the same everywhere, and the model's errors, where these are larger: both of the whole map, robustly.
    """
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(above)
    values = np.where(known, above, 0.0)
    sigma = model.layer("height_m_sigma")
    error = np.where(np.isfinite(sigma) & (sigma > 0), sigma, 1.0)
    best, scale = np.full(above.shape, -np.inf), np.zeros(above.shape)
    for size in SCALES_M:
        width = 0.3 * max(size, float(np.nanmedian(model.layer("resolution_m"))) or 0.0) / model.spacing_m
        if size > largest_m or width < 0.4:
            continue
        inner, outer = (_mean_under(values, known, gaussian_filter, w) for w in (width, 2.5 * width))
        relief, share = _scatter(inner[known] - outer[known], error[known])
        spread = np.sqrt(relief**2 + (share * error) ** 2)
        significance = np.where(known, (inner - outer) / np.maximum(spread, 1e-12), -np.inf)
        better = significance > best
        best[better], scale[better] = significance[better], size
    return best, scale


def _scatter(values: FloatArray, error: FloatArray) -> tuple[float, float]:
    """The part of the scatter of values (n,) that is the same everywhere, and what there is of it for each error."""
    from scipy.optimize import nnls

    classes = np.searchsorted(np.quantile(error, np.linspace(0, 1, ERROR_CLASSES + 1)[1:-1]), error)
    squares = [
        (robust_scatter(values[classes == k], 0.0) ** 2, float(np.median(error[classes == k])) ** 2)
        for k in np.unique(classes)
    ]
    scatter, of_errors = np.array(squares).T
    design = np.column_stack([np.ones(len(scatter)), of_errors])
    weight = 1.0 / np.maximum(scatter, 1e-12)
    relief, share = nnls(design * weight[:, None], scatter * weight)[0]
    return math.sqrt(relief), math.sqrt(share)


def _mean_under(values: FloatArray, known: BoolArray, smooth: Callable[..., FloatArray], width: float) -> FloatArray:
    return np.asarray(smooth(values * known, width) / np.maximum(smooth(known.astype(float), width), 0.05))


def _peaks(model: ElevationModel, above: FloatArray, largest_m: float, least: float) -> Found:
    """Nodes that stand out most among those within their own scale."""
    from scipy.ndimage import maximum_filter

    significance, scale = _standing_out(model, above, largest_m)
    alone = max(3, round(0.06 / model.spacing_m)) | 1
    top = (significance >= least) & (significance == maximum_filter(significance, alone))
    rows, columns = np.nonzero(top)
    rows, columns = np.array([rows, columns])[:, np.argsort(-significance[rows, columns], kind="stable")]
    kept: list[int] = []
    for k, (row, column) in enumerate(zip(rows, columns, strict=True)):
        reach = 0.7 * max(scale[row, column], 0.05) / model.spacing_m
        apart = [
            math.hypot(row - rows[j], column - columns[j])
            > max(reach, 0.7 * scale[rows[j], columns[j]] / model.spacing_m)
            for j in kept
        ]
        if all(apart):
            kept.append(k)
    return Found(rows, columns, significance[rows, columns], scale[rows, columns]).kept(kept)


def _alone(decoys: Found, finds: Found, spacing_m: float) -> Found:
    """Decoys that are not the dip that a rock beside them makes in its surroundings.

    What stands out more than they do may be one, and what stands out as errors never do, even where the dip at its
    steep side is deeper.
    """
    kept = np.ones(len(decoys.rows), dtype=bool)
    for k, (row, column, z, scale) in enumerate(zip(*decoys, strict=True)):
        reach = 1.5 * (np.maximum(finds.scale_m, 0.05) + max(scale, 0.05)) / spacing_m
        beside = np.hypot(finds.rows - row, finds.columns - column) <= reach
        rock = (finds.significance >= z) | (finds.significance >= max(SURELY, STEEP * z))
        kept[k] = not (beside & rock).any()
    return decoys.kept(kept)


def _threshold(true: FloatArray, false: FloatArray, false_share: float) -> tuple[float, float]:
    """Least significance at which at most such a share of the finds is false, and that share.

    The number of false ones is that of the search upside down, and half a one more.
    """
    for level in np.sort(np.append(true, LEAST)):
        finds, decoys = int((true >= level).sum()), int((false >= level).sum())
        if level >= LEAST and (finds == 0 or (decoys + 0.5) / finds <= false_share or decoys == 0):
            return float(level), decoys / finds if finds else 0.0
    return float(true.max()) + 1.0, 0.0


def _gain(diameter_m: float, resolution_m: float) -> float:
    """Height of the top of a half ellipsoid's mean under a square window, over its own. [-]"""
    if resolution_m <= 0:
        return 1.0
    across = np.linspace(-0.5, 0.5, 41) * resolution_m
    distance = np.hypot(*np.meshgrid(across, across)) / (0.5 * diameter_m)
    return float(np.sqrt(np.clip(1.0 - distance**2, 0.0, None)).mean())


def _measured(model: ElevationModel, above: FloatArray, row: int, column: int, scale_m: float, z: float) -> FoundRock:
    """Middle, diameter and height of what stands out at a node."""
    from scipy.ndimage import label

    reach = math.ceil(AROUND[1] * max(scale_m, 0.05) / model.spacing_m) + 1
    top, left = max(row - reach, 0), max(column - reach, 0)
    patch = above[top : row + reach + 1, left : column + reach + 1]
    away = np.hypot(*np.ogrid[top - row : top - row + patch.shape[0], left - column : left - column + patch.shape[1]])
    around = patch[np.isfinite(patch) & (away * model.spacing_m > AROUND[0] * max(scale_m, 0.05))]
    patch = patch - (float(np.median(around)) if len(around) else 0.0)
    near = patch[max(row - top - 1, 0) : row - top + 2, max(column - left - 1, 0) : column - left + 2]
    peak = float(np.nanmean(near))
    labels, _ = label(np.nan_to_num(patch, nan=-1.0) > 0.5 * peak)
    own = (labels == labels[row - top, column - left]) & (labels > 0)
    own[row - top, column - left] = True
    rows, columns = np.nonzero(own)
    resolution = float(np.nan_to_num(model.layer("resolution_m")[row, column]))
    seen = 2.0 * math.sqrt(own.sum() / math.pi) * model.spacing_m
    # Half the height of a half ellipsoid is where its radius is 0.87 of that at the ground; matching widens it.
    diameter = max(math.sqrt(max((seen / 0.87) ** 2 - resolution**2, 0.0)), model.spacing_m)
    gain = max(_gain(diameter, resolution), 0.15)
    sigma = float(np.nan_to_num(model.layer("height_m_sigma")[row, column]))
    sigma = max(sigma, abs(peak) / max(z, 1.0)) / gain
    blur = abs(peak) / gain * min(1.0, 0.3 * (1.0 - gain) / gain)
    error = math.hypot(model.spacing_m, 0.5 * resolution)
    return FoundRock(
        x_m=float(model.x0_m + model.spacing_m * (left + columns.mean())),
        y_m=float(model.y0_m + model.spacing_m * (top + rows.mean())),
        diameter_m=diameter,
        diameter_m_sigma=error,
        height_m=peak / gain,
        height_m_sigma=math.hypot(sigma, blur),
        significance=z,
        keepout_m=0.5 * seen + error,
    )


def _rocks_of(model: ElevationModel, above: FloatArray, finds: Found) -> tuple[Found, list[FoundRock]]:
    """Finds that are as high as rocks of their diameter are, the surest first, each rock once; and their rocks."""
    kept: list[int] = []
    rocks: list[FoundRock] = []
    for k, (row, column, z, scale) in enumerate(zip(*finds, strict=True)):
        rock = _measured(model, above, int(row), int(column), float(scale), float(z))
        again = any(math.hypot(rock.x_m - r.x_m, rock.y_m - r.y_m) < 0.5 * r.diameter_m for r in rocks)
        if rock.height_m >= FLATTEST * rock.diameter_m and not again:
            kept.append(k)
            rocks.append(rock)
    return finds.kept(kept), rocks


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
    rng, trials = np.random.default_rng(seed), []
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


def _tried(
    model: ElevationModel,
    above: FloatArray,
    diameter_m: float,
    largest_m: float,
    threshold: float,
    rng: np.random.Generator,
) -> list[Completeness]:
    """How many rocks put into the model are found, in its better and its worse half."""
    rows, columns = _places(model, above, max(4 * diameter_m, 0.3), rng)
    if not len(rows):
        return []
    put = np.zeros(above.shape)
    y, x = np.mgrid[: above.shape[0], : above.shape[1]]
    radius = 0.5 * diameter_m / model.spacing_m
    offsets = rng.uniform(-0.5, 0.5, (len(rows), 2))
    for row, column, (dy, dx) in zip(rows, columns, offsets, strict=True):
        part = (slice(max(row - 60, 0), row + 61), slice(max(column - 60, 0), column + 61))
        distance = np.hypot(y[part] - row - dy, x[part] - column - dx) / radius
        put[part] += FLATNESS * diameter_m * np.sqrt(np.clip(1.0 - distance**2, 0.0, None))
    from scipy.ndimage import uniform_filter

    window = float(np.nan_to_num(np.nanmedian(model.layer("resolution_m")))) / model.spacing_m
    put = uniform_filter(put, max(1, round(window)))
    tried = dataclasses.replace(model, height_m=model.height_m + put)
    over = height_over_ground(tried, largest_m)
    _, finds = _rocks_of(tried, over, _peaks(tried, over, largest_m, threshold))
    places = np.array([((f.y_m - model.y0_m), (f.x_m - model.x0_m)) for f in finds]).reshape(-1, 2) / model.spacing_m
    reach = max(0.5 * diameter_m, 2 * model.spacing_m, 0.5 * window * model.spacing_m) / model.spacing_m
    hit = np.array(
        [
            bool(len(places)) and float(np.hypot(*(places - [r, c]).T).min()) <= reach
            for r, c in zip(rows, columns, strict=True)
        ]
    )
    sigma = model.layer("height_m_sigma")[rows, columns]
    everywhere = model.layer("height_m_sigma")[np.isfinite(above)]
    edges = np.nanquantile(everywhere, (0, 0.5, 1)) if np.isfinite(sigma).any() else np.array([np.nan, np.nan])
    halves = [(sigma <= edges[1]), (sigma > edges[1])] if len(edges) == 3 else [np.ones(len(hit), bool)]
    found = []
    for k, half in enumerate(halves):
        if half.any():
            low, high = _wilson(int(hit[half].sum()), int(half.sum()))
            found.append(
                Completeness(
                    diameter_m=diameter_m,
                    height_m=FLATNESS * diameter_m,
                    sigma_from_m=float(edges[k]),
                    sigma_to_m=float(edges[k + 1]),
                    trials=int(half.sum()),
                    share=float(hit[half].mean()),
                    share_low=low,
                    share_high=high,
                )
            )
    return found


def _places(
    model: ElevationModel, above: FloatArray, apart_m: float, rng: np.random.Generator
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Known nodes, so far from each other and at random."""
    known = np.flatnonzero(np.isfinite(above))
    rows, columns = np.unravel_index(rng.permutation(known)[:2000], above.shape)
    kept: list[int] = []
    for k, (row, column) in enumerate(zip(rows, columns, strict=True)):
        if all(math.hypot(row - rows[j], column - columns[j]) * model.spacing_m > apart_m for j in kept):
            kept.append(k)
        if len(kept) == TRIALS:
            break
    return rows[kept], columns[kept]


def _wilson(hits: int, trials: int) -> tuple[float, float]:
    """Interval of 68 % of a share (Wilson 1927, 10.1080/01621459.1927.10502953)."""
    share = hits / trials
    middle = (share + 0.5 / trials) / (1 + 1 / trials)
    half = math.sqrt(share * (1 - share) / trials + 0.25 / trials**2) / (1 + 1 / trials)
    return max(middle - half, 0.0), min(middle + half, 1.0)
