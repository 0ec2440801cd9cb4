"""Elevation models made of pictures: heights on a grid, and two kinds of error beside them; several as one map.

Random errors average over nodes, as far as these are independent. Common errors, of the rig and of the place of the
cameras, do not. Models are merged by the inverse of their variances: each has an offset in units of its common error,
and a shift of its position, which the overlaps determine together (generalised least squares, Aitken 1936,
10.1017/S0370164600014346); what is left unknown of them stays in the merged map as its common error.
"""

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import ParameterError
from lunarsci.heights.grid import ERROR_LAYERS
from lunarsci.heights.grids import check_relief, geotiff_bytes, read_grid


class KnownNodes(NamedTuple):
    """Nodes of a grid within a rectangle: positions, heights and random errors. (n,) [m]"""

    x: FloatArray
    y: FloatArray
    height: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ElevationModel:
    """Heights on a regular grid, x to the east, y to the north, with their errors.

    Attributes
    ----------
    name : what it shows.
    x0_m, y0_m, spacing_m : position of node [0, 0] and distance of the nodes. [m]
    height_m : NaN where unknown; row is y, column is x. (ny, nx) [m]
    height_m_sigma : random error of a node, one standard deviation; None where the file says nothing. (ny, nx) [m]
    height_m_common_sigma : error that nodes share. (ny, nx) [m]
    count : matched pixels by node. (ny, nx)
    height_by_disparity_m_px : by how much a height changes with the disparity. (ny, nx) [m/px]
    resolution_m : width over which matching averages heights, and over which random errors hang together; 0 for nodes
        that are independent points. (ny, nx) [m]
    synthetic : True for a made-up one.
    """

    name: str
    x0_m: float
    y0_m: float
    spacing_m: float
    height_m: FloatArray
    height_m_sigma: FloatArray | None = None
    height_m_common_sigma: FloatArray | None = None
    count: FloatArray | None = None
    height_by_disparity_m_px: FloatArray | None = None
    resolution_m: FloatArray = field(default_factory=lambda: np.zeros(()))
    synthetic: bool = False

    def __post_init__(self) -> None:
        shape = self.height_m.shape
        if len(shape) != 2 or min(shape) < 3:
            raise ParameterError(f"{self.name}: heights of shape {shape}; give a grid of at least 3 x 3 nodes")
        if not (0 < self.spacing_m < math.inf and math.isfinite(self.x0_m) and math.isfinite(self.y0_m)):
            raise ParameterError(f"{self.name}: x0_m, y0_m and spacing_m must be finite, spacing_m above 0")
        if not np.isfinite(self.height_m).any():
            raise ParameterError(f"{self.name}: no height is known")
        for key in ERROR_LAYERS:
            values = getattr(self, key)
            if values is None:
                continue
            if values.shape not in (shape, ()):
                raise ParameterError(f"{self.name}: {key} has shape {values.shape}; give one number, or {shape}")
            if key != "height_by_disparity_m_px" and (values[np.isfinite(values)] < 0).any():
                raise ParameterError(f"{self.name}: {key} is negative somewhere; give 0 or more, NaN where unknown")

    @property
    def x_m(self) -> FloatArray:
        """Columns. (nx,) [m]"""
        return np.asarray(self.x0_m + self.spacing_m * np.arange(self.height_m.shape[1]))

    @property
    def y_m(self) -> FloatArray:
        """Rows. (ny,) [m]"""
        return np.asarray(self.y0_m + self.spacing_m * np.arange(self.height_m.shape[0]))

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Edges of the outer cells: x from, x to, y from, y to. [m]"""
        half = 0.5 * self.spacing_m
        x, y = self.x_m, self.y_m
        return float(x[0]) - half, float(x[-1]) + half, float(y[0]) - half, float(y[-1]) + half

    def layer(self, key: str) -> FloatArray:
        """A layer at each node, NaN where nothing is known of it. (ny, nx)"""
        values = getattr(self, key)
        return np.array(np.broadcast_to(np.nan if values is None else values, self.height_m.shape), dtype=float)

    def independent(self, count: npt.ArrayLike, resolution_m: npt.ArrayLike) -> FloatArray:
        """How many independent heights so many neighbouring nodes are worth: those that lie `resolution_m` apart."""
        nodes = np.maximum(1.0, (np.asarray(resolution_m, dtype=float) / self.spacing_m) ** 2)
        return np.asarray(np.maximum(np.asarray(count) / nodes, 1.0))

    def near(self, place_m: npt.ArrayLike, reach_m: float) -> KnownNodes:
        """Known nodes within a square of half side `reach_m` about a place."""
        x, y = np.asarray(place_m, dtype=float)
        left, low = (math.ceil((v - reach_m - start) / self.spacing_m) for v, start in ((x, self.x0_m), (y, self.y0_m)))
        size = math.floor(2 * reach_m / self.spacing_m) + 1
        rows, columns = slice(max(low, 0), max(low + size, 0)), slice(max(left, 0), max(left + size, 0))
        height = self.height_m[rows, columns]
        grid = np.meshgrid(self.x_m[columns], self.y_m[rows])
        known = np.isfinite(height)
        sigma = self.height_m_sigma
        errors = (
            np.full(height.shape, np.nan)
            if sigma is None
            else np.broadcast_to(sigma, self.height_m.shape)[rows, columns]
        )
        return KnownNodes(grid[0][known], grid[1][known], height[known], errors[known])

    def at(self, key: str, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """A layer between its nodes, bilinear; NaN outside and where one of the four is unknown."""
        from scipy.ndimage import map_coordinates

        rows = (np.asarray(y_m, dtype=float) - self.y0_m) / self.spacing_m
        columns = (np.asarray(x_m, dtype=float) - self.x0_m) / self.spacing_m
        # A place on the last node, or a rounding beyond it, is on the map.
        for axis, values in enumerate((rows, columns)):
            last = self.height_m.shape[axis] - 1
            values[np.abs(values) < 1e-9] = 0.0
            values[np.abs(values - last) < 1e-9] = last
        found = map_coordinates(self.layer(key), [rows, columns], order=1, mode="constant", cval=np.nan)
        return np.asarray(found)

    def summary(self) -> dict[str, Any]:
        """Name, extent, nodes and share of holes, and medians of its errors, for a result."""
        known = np.isfinite(self.height_m)
        medians = {}
        for key in ("height_m_sigma", "height_m_common_sigma", "resolution_m"):
            values = self.layer(key)[known]
            medians[f"median_{key}"] = float(np.nanmedian(values)) if np.isfinite(values).any() else None
        return {
            "name": self.name,
            "synthetic": self.synthetic,
            "x_m": [float(self.x_m[0]), float(self.x_m[-1])],
            "y_m": [float(self.y_m[0]), float(self.y_m[-1])],
            "spacing_m": self.spacing_m,
            "nodes": [self.height_m.shape[1], self.height_m.shape[0]],
            "hole_share": float(1.0 - known.mean()),
            **medians,
        }


def read_elevation(path: str | Path) -> ElevationModel:
    """An elevation model from .npz, GeoTIFF, ESRI ASCII or CSV, as `lunarsci.heights.grids.read_grid` says.

    Errors are layers under the names that `ElevationModel` has. Heights are looked at by `check_relief`. Raises
    DataError.
    """
    soils = tuple(f"{name}{end}" for name in SOIL for end in ("", "_left_of_prior"))
    grid = read_grid(path, ERROR_LAYERS, soils)
    check_relief(path, grid.height_m, grid.spacing_m)
    layers: dict[str, Any] = {key: np.asarray(values, dtype=float) for key, values in grid.layers.items()}
    return ElevationModel(
        name=grid.name,
        x0_m=grid.x0_m,
        y0_m=grid.y0_m,
        spacing_m=grid.spacing_m,
        height_m=grid.height_m,
        synthetic=grid.synthetic,
        **layers,
    )


SOIL = (
    "stiffness_kpa_m_n", "sinkage_exponent", "sinkage_exponent_slip", "cohesion_pa", "friction_angle_deg",
    "shear_modulus_mm", "external_friction_angle_deg", "lateral_modulus_mm",
)  # fmt: skip
"""Soil that a terrain may carry beside its heights, and which is not read here."""


def _layers(model: ElevationModel) -> dict[str, FloatArray]:
    return {key: model.layer(key) for key in ("height_m", *ERROR_LAYERS) if getattr(model, key) is not None}


def elevation_bytes(model: ElevationModel) -> bytes:
    """The model as a NumPy archive that `read_elevation` and the twin read."""
    archive = io.BytesIO()
    content: dict[str, Any] = {key: values.astype(np.float32) for key, values in _layers(model).items()}
    content |= {"x_m": model.x_m, "y_m": model.y_m, "height_m": model.height_m}
    content |= {"name": np.array(model.name), "synthetic": np.array(model.synthetic)}
    np.savez_compressed(archive, **content)
    return archive.getvalue()


def elevation_geotiff(model: ElevationModel) -> bytes:
    """The model as GeoTIFF, heights first. Raises ParameterError without rasterio."""
    place = model.x0_m, model.y0_m, model.spacing_m
    return geotiff_bytes(_layers(model), place, synthetic=model.synthetic)


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
