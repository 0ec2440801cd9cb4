"""Elevation models of several stations as one map, by the inverse of their variances.

Random errors of the nodes shrink where models overlap. Common errors do not: each model has an offset in units of its
common error, and a shift of its position, which the overlaps tell together (generalised least squares, Aitken 1936,
10.1017/S0370164600014346); what is left unknown of them stays in the merged map as its common error.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import ParameterError
from lunarsci.images.elevation import ElevationModel

HUBER = 2.5
"""Standard errors beyond which a height counts less (Huber 1964, 10.1214/aoms/1177703732); assumed."""
ROUNDS, RELAID = 5, 3
BETWEEN_NODES = 0.1
"""Error of a position that heights on a grid tell, as a share of its spacing; assumed."""
BLOCK = 12
"""Nodes along a side of the blocks whose gradients are compared; assumed."""
LEAST_OVERLAP = 50
"""Nodes that two models must share to say anything of each other; assumed."""
COLUMNS = ("offset", "x_m", "y_m")
"""What a model may be off by: its common error, in units of it, and its position."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StationPosition:
    """Where a model belongs: x, y are added to its coordinates, z to its heights; covariance of x, y, z. [m], [m2]"""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    covariance_m2: FloatArray

    @classmethod
    def known(cls) -> "StationPosition":
        """No shift and no error."""
        return cls(covariance_m2=np.zeros((3, 3)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """What two models say of each other, numbered from 0, once all are corrected.

    `mean_m` is the mean difference of the second less the first, `rms_z` its rms in standard errors, `odd_share` the
    share beyond three.
    """

    first: int
    second: int
    nodes: int
    mean_m: float
    rms_z: float
    odd_share: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MergedMap:
    """One map of several models.

    Attributes
    ----------
    model : heights with random and common error; `count` is the number of models.
    corrections, covariance : of each model in `COLUMNS` [-], [m], [m], and of all of them. (k, 3), (3 k, 3 k)
    z_score : largest disagreement of a node with the merged height, signed, NaN where there is one model. (ny, nx)
    overlaps : of pairs of models.
    """

    model: ElevationModel
    corrections: FloatArray
    covariance: FloatArray
    z_score: FloatArray
    overlaps: tuple[Overlap, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Stack:
    """Models on one grid: heights, random variances, and derivatives by `COLUMNS`. (k, n), (k, n), (k, n, 3)

    `block` is the number of the block that a node lies in. (n,)
    """

    height: FloatArray
    variance: FloatArray
    by: FloatArray
    prior: FloatArray
    alike: float
    block: IndexArray

    @property
    def known(self) -> BoolArray:
        """Which model knows which node. (k, n)"""
        return np.asarray(np.isfinite(self.height))


def merge(
    models: Sequence[ElevationModel],
    positions: Sequence[StationPosition] | None = None,
    *,
    spacing_m: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MergedMap:
    """One map of two or more models, every `spacing_m`, by default that of the finest.

    Raises ParameterError where errors are missing, where there are not as many positions as models, and where nothing
    overlaps.
    """
    if len(models) < 2:
        raise ParameterError("one elevation model is merged already; give two or more")
    places = list(positions) if positions is not None else [StationPosition.known()] * len(models)
    if len(places) != len(models):
        raise ParameterError(f"{len(places)} positions for {len(models)} models; give one for each")
    for model in models:
        if model.height_m_sigma is None:
            raise ParameterError(f"{model.name}: no height_m_sigma; inverse variances need the errors of the heights")
    steps = progress or (lambda *_: None)
    step = spacing_m or min(model.spacing_m for model in models)
    x, y = _grid(models, places, step)
    done = np.zeros((len(models), len(COLUMNS)))
    for k in range(RELAID):
        stack = _stacked(models, places, (x, y, step), done)
        if int((stack.known.sum(axis=0) > 1).sum()) < LEAST_OVERLAP:
            raise ParameterError(
                f"the models share fewer than {LEAST_OVERLAP} nodes: nothing to compare; check their positions"
            )
        corrections, covariance, weight = _robust(stack)
        covariance += (
            np.diag(np.tile([0.0, 1.0, 1.0], len(models)) * (np.diag(stack.prior) > 0)) * (BETWEEN_NODES * step) ** 2
        )
        done = corrections * [0.0, 1.0, 1.0]
        steps(1 + k, RELAID + 1)
    return _result(models, stack, weight, corrections, covariance, (x, y, step))


def _robust(stack: _Stack) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What models are off by, its covariance, and the weights of heights that do not fit the others."""
    weight = stack.known.astype(float)
    for _ in range(ROUNDS):
        corrections, covariance = _corrections(stack, weight)
        z = _z_scores(stack, _merged(stack, weight, corrections), corrections)
        huber = np.where(np.abs(z) > HUBER, HUBER / np.maximum(np.abs(z), 1e-9), 1.0)
        weight = np.where(stack.known, np.nan_to_num(huber, nan=1.0), 0.0)
    return corrections, _sandwich(stack, weight, corrections, covariance), weight


def _sandwich(stack: _Stack, weight: FloatArray, corrections: FloatArray, covariance: FloatArray) -> FloatArray:
    """The covariance of what models are off by, from how differently blocks of the map would have it.

    C (S + P^-1) C with S the sum of squares of the blocks' gradients (White 1982, 10.2307/1912526), where it is larger
    than C: heights scatter more than they say, and alike over more than the resolution, on rough ground.
    """
    count, nodes, columns = stack.by.shape
    inverse = np.where(stack.known, weight / stack.variance, 0.0) / stack.alike
    inverse[:, stack.known.sum(axis=0) < 2] = 0.0
    off = np.nan_to_num(_corrected(stack, corrections) - _merged(stack, weight, corrections))
    by_node = (stack.by * (inverse * off)[..., None]).transpose(1, 0, 2).reshape(nodes, count * columns)
    gradients = np.zeros((int(stack.block.max()) + 1, count * columns))
    np.add.at(gradients, stack.block, by_node)
    spread = covariance @ (gradients.T @ gradients) @ covariance + covariance @ np.linalg.pinv(stack.prior) @ covariance
    larger = np.sqrt(np.maximum(np.diag(spread) / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * np.outer(larger, larger))


def _grid(
    models: Sequence[ElevationModel], places: Sequence[StationPosition], step: float
) -> tuple[FloatArray, FloatArray]:
    axes = []
    for name in ("x_m", "y_m"):
        shifted = [getattr(m, name) + getattr(p, name) for m, p in zip(models, places, strict=True)]
        low, high = min(v[0] for v in shifted), max(v[-1] for v in shifted)
        count = math.ceil((high - low) / step - 1e-6) + 1
        if count > 20_000:
            raise ParameterError(f"a map of {high - low:.3g} m every {step:g} m is too large; give a larger spacing")
        axes.append(np.asarray(low + step * np.arange(count)))
    return axes[0], axes[1]


def _stacked(
    models: Sequence[ElevationModel],
    places: Sequence[StationPosition],
    grid_m: tuple[FloatArray, FloatArray, float],
    done: FloatArray,
) -> _Stack:
    """Models on one grid, laid where they are thought to be: shifted by `done` (k, 3), about which slopes are taken."""
    from scipy.linalg import block_diag

    x, y, step = grid_m
    grid = np.meshgrid(x, y)
    heights, variances, derivatives, priors, alike = [], [], [], [], 1.0
    for model, place, moved in zip(models, places, done, strict=True):
        at = grid[0].ravel() - place.x_m + moved[1], grid[1].ravel() - place.y_m + moved[2]
        height = model.at("height_m", *at) + place.z_m
        slopes = _slopes(height.reshape(grid[0].shape), step)
        common = (
            model.at("height_m_common_sigma", *at) if model.height_m_common_sigma is not None else np.zeros_like(height)
        )
        common = np.hypot(np.nan_to_num(common), math.sqrt(place.covariance_m2[2, 2]))
        sigma = model.at("height_m_sigma", *at)
        variances.append(sigma**2)
        # A shift to the east moves the height of a place by less the slope.
        derivatives.append(np.nan_to_num(np.stack([common, -slopes[0].ravel(), -slopes[1].ravel()], axis=-1)))
        heights.append(np.where(np.isfinite(sigma) & (sigma > 0), height + derivatives[-1] @ moved, np.nan))
        priors.append(block_diag(np.eye(1), place.covariance_m2[:2, :2]))
        width = float(np.nan_to_num(np.nanmedian(model.layer("resolution_m"))))
        alike = max(alike, (width / step) ** 2)
    by = np.nan_to_num(np.array(derivatives))
    return _Stack(
        height=np.array(heights),
        variance=np.array(variances),
        by=by,
        prior=block_diag(*priors),
        alike=alike,
        block=_blocks(len(y), len(x)),
    )


def _blocks(ny: int, nx: int) -> IndexArray:
    rows, columns = np.arange(ny) // BLOCK, np.arange(nx) // BLOCK
    return np.asarray((rows[:, None] * (columns[-1] + 1) + columns).ravel(), dtype=np.intp)


def _slopes(height: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Slopes along x and y of heights smoothed over five nodes, 0 where unknown."""
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(height)
    smooth = gaussian_filter(np.where(known, height, 0.0), 2.0) / np.maximum(
        gaussian_filter(known.astype(float), 2.0), 1e-6
    )
    down, right = np.gradient(np.where(known, smooth, np.nan), step)
    return np.nan_to_num(right), np.nan_to_num(down)


def _corrections(stack: _Stack, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What each model is off by (k, 3), and the covariance of all of it, with the heights themselves solved for.

    Where models overlap, each node's height is the weighted mean of what they say, so that only differences count.
    Neighbouring nodes within the resolution are one measurement.
    """
    count, _, columns = stack.by.shape
    inverse = np.where(stack.known, weight / stack.variance, 0.0) / stack.alike
    shared = stack.known.sum(axis=0) > 1
    inverse, by, height = inverse[:, shared], stack.by[:, shared], np.nan_to_num(stack.height[:, shared])
    total = inverse.sum(axis=0)
    normal = np.zeros((count, columns, count, columns))
    right = np.zeros((count, columns))
    mean = (inverse * height).sum(axis=0) / total
    for i in range(count):
        weighted = by[i] * inverse[i][:, None]
        right[i] = weighted.T @ (height[i] - mean)
        normal[i, :, i, :] += weighted.T @ by[i]
        for j in range(count):
            normal[i, :, j, :] -= (weighted / total[:, None]).T @ (by[j] * inverse[j][:, None])
    size = count * columns
    # What is known beforehand may be known exactly: columns without a prior variance are left at zero.
    root = _root(stack.prior)
    inner = root.T @ normal.reshape(size, size) @ root + np.eye(size)
    solved = np.linalg.solve(inner, root.T @ right.reshape(size))
    return (root @ solved).reshape(count, columns), root @ np.linalg.inv(inner) @ root.T


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _corrected(stack: _Stack, corrections: FloatArray) -> FloatArray:
    return np.asarray(stack.height - np.einsum("knc,kc->kn", stack.by, corrections))


def _merged(stack: _Stack, weight: FloatArray, corrections: FloatArray) -> FloatArray:
    inverse = np.where(stack.known, weight / stack.variance, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((inverse * np.nan_to_num(_corrected(stack, corrections))).sum(axis=0) / inverse.sum(axis=0))


def _z_scores(stack: _Stack, merged: FloatArray, corrections: FloatArray) -> FloatArray:
    """What each model is off from the merged height, over the standard error of that difference. (k, n)"""
    total = np.where(stack.known, 1.0 / stack.variance, 0.0).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        left = np.maximum(stack.variance - 1.0 / total, 0.0)
        return np.asarray(
            np.where(left > 1e-6 * stack.variance, (_corrected(stack, corrections) - merged) / np.sqrt(left), np.nan)
        )


def _result(
    models: Sequence[ElevationModel],
    stack: _Stack,
    weight: FloatArray,
    corrections: FloatArray,
    covariance: FloatArray,
    grid: tuple[FloatArray, FloatArray, float],
) -> MergedMap:
    x, y, step = grid
    shape = len(y), len(x)
    merged = _merged(stack, weight, corrections)
    inverse = np.where(stack.known, weight / stack.variance, 0.0)
    total = inverse.sum(axis=0)
    z = _z_scores(stack, merged, corrections)
    worst = np.where(np.isnan(z), -1.0, np.abs(z)).argmax(axis=0)
    shown = np.take_along_axis(z, worst[None], axis=0)[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(total > 0, inverse / total, 0.0)
        # Weights of doubtful heights are lower, which is no reason to believe in less of an error.
        random = np.sqrt((share**2 * np.where(stack.known, stack.variance, 0.0)).sum(axis=0))
    parts = (share[..., None] * stack.by).transpose(1, 0, 2).reshape(len(merged), -1)
    common = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", parts, covariance, parts), 0.0))
    known = total > 0
    width = max(float(np.nan_to_num(np.nanmedian(model.layer("resolution_m")))) for model in models)
    model = ElevationModel(
        name=" + ".join(model.name for model in models),
        x0_m=float(x[0]),
        y0_m=float(y[0]),
        spacing_m=step,
        height_m=np.where(known, merged, np.nan).reshape(shape),
        height_m_sigma=np.where(known, random, np.nan).reshape(shape),
        height_m_common_sigma=np.where(known, common, np.nan).reshape(shape),
        count=stack.known.sum(axis=0).astype(float).reshape(shape),
        resolution_m=np.array(width),
        synthetic=any(model.synthetic for model in models),
    )
    return MergedMap(
        model=model,
        corrections=corrections,
        covariance=covariance,
        z_score=shown.reshape(shape),
        overlaps=tuple(_overlaps(stack, corrections)),
    )


def _overlaps(stack: _Stack, corrections: FloatArray) -> list[Overlap]:
    height, found = _corrected(stack, corrections), []
    for i in range(len(height)):
        for j in range(i + 1, len(height)):
            both = stack.known[i] & stack.known[j]
            if not both.any():
                continue
            off = height[j, both] - height[i, both]
            z = off / np.sqrt(stack.variance[i, both] + stack.variance[j, both])
            found.append(
                Overlap(
                    first=i,
                    second=j,
                    nodes=int(both.sum()),
                    mean_m=float(np.median(off)),
                    rms_z=float(np.sqrt(np.mean(z**2))),
                    odd_share=float((np.abs(z) > 3).mean()),
                )
            )
    return found
