"""Elevation models made of pictures: heights on a grid, and two kinds of error beside them; several as one map.

Random errors average over nodes, as far as these are independent. Common errors, of the rig and of the place of the
cameras, do not. Models are merged by the inverse of their variances: each has an offset in units of its common error,
and a shift of its position, which the overlaps determine together (generalised least squares, Aitken 1936,
10.1017/S0370164600014346); what is left unknown of them stays in the merged map as its common error.
"""

import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag
from scipy.ndimage import gaussian_filter, map_coordinates

from lunarsci.arrays import BoolArray, FloatArray, IndexArray, huber_weights, robust_fit
from lunarsci.errors import ParameterError
from lunarsci.heights.grid import ERROR_LAYERS, layers_on
from lunarsci.heights.grids import check_relief, geotiff_bytes, read_grid
from lunarsci.ranges import refuse

SOIL = (
    "stiffness_kpa_m_n", "sinkage_exponent", "sinkage_exponent_slip", "cohesion_pa", "friction_angle_deg",
    "shear_modulus_mm", "external_friction_angle_deg", "lateral_modulus_mm",
)  # fmt: skip
"""Soil that a terrain may carry beside its heights, and which is not read here."""
RELAID = 3
"""How often models are laid onto the grid, each time shifted by what was found before."""
REWEIGHTED = 5
"""How often Huber's weights are taken anew from what the corrections before left over."""
BETWEEN_NODES = 0.1
"""Error of a position that follows from heights on a grid, as a share of its spacing. Measured as `BLOCK`: half and
twice as much change errors of the map, over the stated ones, by 0.3 %."""
AT_ONCE = 50_000
"""Nodes whose common errors are computed at once."""
BLOCK = 12
"""Nodes along a side of the blocks whose gradients are compared. Measured (`tests/benchmarks/image_numbers.py`, 30
November 2026, two rendered stations): of 6, 12 and 24 errors of the map are 1.25, 1.24 and 1.30 of the stated ones."""
MOVED = ("x_m", "y_m", "turn_rad", "z_m", "tilt_x", "tilt_y")
"""How a model is laid on another: moved, turned from x towards y, raised, and raised along x and y."""
SMOOTHED = (8.0, 4.0, 2.0, 0.0)
"""Widths over which heights are smoothed for that, in this order. Measured (30 November 2026): four other orders, which
begin with 4 to 16 nodes, lead to the same movement to 2 micrometres. [nodes]"""
COLUMNS = ("offset", "x_m", "y_m")
"""What a model may be off by: its common error, in units of it, and its position."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ElevationModel:
    """Heights on a regular grid, x to the east, y to the north, with their errors.

    Attributes
    ----------
    name : what it shows.
    x0_m, y0_m, spacing_m : position of node [0, 0] and distance of the nodes. [m]
    height_m : NaN where unknown; row is y, column is x. (ny, nx) [m]
    height_m_sigma : random error of a node, one standard deviation; None where the file says nothing. (ny, nx) [m]
    height_m_common_sigma : error that nodes share, one standard deviation; None where it is not known. (ny, nx) [m]
    count : matched pixels by node, or models of a merged one. (ny, nx)
    height_by_disparity_m_px : by how much a height changes with the disparity. (ny, nx) [m/px]
    resolution_m : width over which matching averages heights, and over which random errors are correlated; 0 for nodes
        that are independent points. (ny, nx) [m]
    synthetic : True for a made-up one.

    A layer beside the heights may also be one number for all nodes, of shape (). Raises ParameterError for other shapes
    and negative errors.
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
        placed = 0 < self.spacing_m < math.inf and math.isfinite(self.x0_m) and math.isfinite(self.y0_m)
        if len(shape) != 2 or min(shape) < 3 or not np.isfinite(self.height_m).any() or not placed:
            raise ParameterError(
                f"{self.name}: heights of shape {shape} from {self.x0_m}, {self.y0_m} every {self.spacing_m} m; give a "
                "grid of at least 3 x 3 nodes, some of them known, at finite places, spacing_m above 0"
            )
        for key in ERROR_LAYERS:
            values = getattr(self, key)
            signed = values is None or key == "height_by_disparity_m_px"
            if values is not None and (
                values.shape not in (shape, ()) or not (signed or np.nanmin(values, initial=0) >= 0)
            ):
                raise ParameterError(
                    f"{self.name}: {key} of shape {values.shape} is not of shape {shape}, or negative somewhere; give "
                    "one number or one a node, 0 or more, NaN where unknown"
                )

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
        """A copy of a layer at each node, `height_m` or one of `ERROR_LAYERS` in its unit; NaN where it is not known.
        (ny, nx)"""
        values = getattr(self, key)
        return np.array(np.broadcast_to(np.nan if values is None else values, self.height_m.shape), dtype=float)

    def stated(self) -> dict[str, FloatArray]:
        """Heights, and those layers of errors that there are, by name. (ny, nx)"""
        return {key: self.layer(key) for key in ("height_m", *ERROR_LAYERS) if getattr(self, key) is not None}

    def layers(self) -> dict[str, tuple[tuple[str, ...], FloatArray]]:
        """Axes and what is `stated`, as `Result.layers` has them."""
        return layers_on(self.x_m, self.y_m, self.stated())

    def at(self, key: str, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """A layer between its nodes, bilinear; NaN outside and where one of the four is unknown.

        `key` as of `layer`; `x_m`, `y_m` are arrays or lists of one shape, which the answer has: (n,) or any other, but
        no single numbers. [m]
        """
        rows = (np.asarray(y_m, dtype=float) - self.y0_m) / self.spacing_m
        columns = (np.asarray(x_m, dtype=float) - self.x0_m) / self.spacing_m
        # A place on the last node, or a rounding beyond it, is on the map.
        for axis, values in enumerate((rows, columns)):
            for end in (0, self.height_m.shape[axis] - 1):
                values[np.abs(values - end) < 1e-9] = end
        return np.asarray(map_coordinates(self.layer(key), [rows, columns], order=1, mode="constant", cval=np.nan))

    def less_plane(self) -> FloatArray:
        """Heights less the plane through them. (ny, nx) [m]"""
        valid = np.isfinite(self.height_m)
        y, x = np.mgrid[: valid.shape[0], : valid.shape[1]]
        design = np.column_stack([np.ones(int(valid.sum())), x[valid], y[valid]])
        plane = np.linalg.lstsq(design, self.height_m[valid], rcond=None)[0]
        return np.asarray(self.height_m - (plane[0] + plane[1] * x + plane[2] * y))

    def summary(self) -> dict[str, Any]:
        """Name, extent, nodes and share of holes, and medians of its errors, for a result."""
        valid = np.isfinite(self.height_m)
        medians = {}
        for key in ("height_m_sigma", "height_m_common_sigma", "resolution_m"):
            values = self.layer(key)[valid]
            medians[f"median_{key}"] = float(np.nanmedian(values)) if np.isfinite(values).any() else None
        return {
            "name": self.name,
            "synthetic": self.synthetic,
            "x_m": [float(self.x_m[0]), float(self.x_m[-1])],
            "y_m": [float(self.y_m[0]), float(self.y_m[-1])],
            "spacing_m": self.spacing_m,
            "nodes": [self.height_m.shape[1], self.height_m.shape[0]],
            "hole_share": float(1.0 - valid.mean()),
            **medians,
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Change:
    """A model less an earlier one of the same ground, which is first laid on it.

    Attributes
    ----------
    model : heights less the earlier ones; what is left unknown of how it lies is its common error.
    moved : how the earlier one was moved, in `MOVED`. (6,) [m, m, rad, m, m/m, m/m]
    covariance : of these. (6, 6)
    rms_z : of what is left where nothing changed, in its standard errors. [-]
    """

    model: ElevationModel
    moved: FloatArray
    covariance: FloatArray
    rms_z: float

    def to_dict(self) -> dict[str, Any]:
        """Movement and its errors by name."""
        sigma = np.sqrt(np.diag(self.covariance))
        named = {key: float(value) for key, value in zip(MOVED, self.moved, strict=True)}
        named |= {f"{key}_sigma": float(value) for key, value in zip(MOVED, sigma, strict=True)}
        return {"before": self.model.name, "rms_z": self.rms_z, **named}


def change_of(model: ElevationModel, before: ElevationModel, same: BoolArray) -> Change:
    """A model less an earlier one, laid on it by a rigid movement and a tilt where `same` (ny, nx): nothing changed.

    Gauss-Newton from heights that are smoothed over several nodes to those as they are, with Tukey's weights. Nodes
    within the resolution are one measurement; errors are as much larger as what is left is. Raises ParameterError
    without errors of both, and where they do not overlap.
    """
    lacking = [m.name for m in (model, before) if m.height_m_sigma is None]
    refuse({f"{', '.join(lacking)}: no height_m_sigma; a difference needs the errors of both": bool(lacking)})
    x, y = np.meshgrid(model.x_m, model.y_m)
    middle = float(x[same].mean()), float(y[same].mean())
    moved = np.zeros(len(MOVED))
    for width in SMOOTHED:
        smooth = before if not width else replace(before, height_m=mean_about(before.height_m, width))
        height = mean_about(model.height_m, width) if width else model.height_m
        for _ in range(REWEIGHTED):
            laid, by, variance = _laid(smooth, moved, x, y, middle)
            sigma = np.sqrt(variance + model.layer("height_m_sigma") ** 2)
            used = same & np.isfinite(height - laid) & np.isfinite(by).all(axis=-1) & (sigma > 0)
            refuse({f"{before.name} and {model.name} share no ground beside the track": used.sum() < 100})
            design, rest = by[used] / sigma[used, None], (height - laid)[used] / sigma[used]
            step, weight = robust_fit(design, rest)
            moved = moved + step
    alike = max(1.0, (_width([model, before]) / model.spacing_m) ** 2)
    sound = weight > 0
    rms = float(np.sqrt(np.sum(weight * (rest - design @ step) ** 2) / weight.sum()))
    covariance = np.linalg.pinv(design[sound].T @ design[sound]) * alike * max(1.0, rms) ** 2
    laid, by, variance = _laid(before, moved, x, y, middle)
    difference = replace(
        model,
        name=f"{model.name} less {before.name}",
        height_m=model.height_m - laid,
        height_m_sigma=np.sqrt(variance + model.layer("height_m_sigma") ** 2),
        height_m_common_sigma=np.sqrt(np.einsum("...i,ij,...j->...", by, covariance, by)),
    )
    return Change(model=difference, moved=moved, covariance=np.asarray(covariance), rms_z=rms)


def _laid(
    before: ElevationModel, moved: FloatArray, x: FloatArray, y: FloatArray, middle: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Heights of a model moved by `moved`, at x, y (ny, nx) [m], turned and tilted about `middle` [m]; their
    derivatives by `MOVED`, and their variance. (ny, nx), (ny, nx, 6), (ny, nx) [m, m2]"""
    ahead, left = x - middle[0], y - middle[1]
    back, aside, cosine, sine = ahead - moved[0], left - moved[1], math.cos(moved[2]), math.sin(moved[2])
    places = middle[0] + cosine * back + sine * aside, middle[1] - sine * back + cosine * aside
    slopes = np.gradient(mean_about(before.height_m, 1.0), before.spacing_m)
    slope_y, slope_x = (replace(before, height_m=np.asarray(slope)).at("height_m", *places) for slope in slopes)
    turned = cosine * slope_x - sine * slope_y, sine * slope_x + cosine * slope_y
    turn = turned[0] * aside - turned[1] * back
    by = np.stack([-turned[0], -turned[1], turn, np.ones_like(x), ahead, left], axis=-1)
    height = before.at("height_m", *places) + moved[3] + moved[4] * ahead + moved[5] * left
    return height, by, before.at("height_m_sigma", *places) ** 2


def mean_about(values: FloatArray, width: float) -> FloatArray:
    """Mean of what is known under a Gaussian about each node; NaN where nothing is within four widths. (ny, nx)

    `width` is the Gaussian's standard deviation in nodes.
    """
    valid = np.isfinite(values)
    weight = gaussian_filter(valid.astype(float), width)
    with np.errstate(invalid="ignore"):
        return np.asarray(gaussian_filter(np.where(valid, values, 0.0), width) / np.where(weight > 0, weight, np.nan))


def read_elevation(path: str | Path) -> ElevationModel:
    """An elevation model from .npz, GeoTIFF, ESRI ASCII or CSV, as `lunarsci.heights.grids.read_grid` says.

    Errors are layers under the names that `ElevationModel` has. Heights are looked at by `check_relief`. Raises
    DataError.
    """
    soils = tuple(f"{name}{end}" for name in SOIL for end in ("", "_left_of_prior"))
    grid = read_grid(path, ERROR_LAYERS, soils)
    check_relief(path, grid.height_m, grid.spacing_m)
    given = {key: getattr(grid, key) for key in ("name", "x0_m", "y0_m", "spacing_m", "height_m", "synthetic")}
    given |= {key: np.asarray(values, dtype=float) for key, values in grid.layers.items()}
    return ElevationModel(**given)


def elevation_bytes(model: ElevationModel) -> bytes:
    """The model as a NumPy archive that `read_elevation` and the twin read."""
    archive = io.BytesIO()
    content: dict[str, Any] = {key: values.astype(np.float32) for key, values in model.stated().items()}
    content |= {"x_m": model.x_m, "y_m": model.y_m, "height_m": model.height_m}
    content |= {"name": np.array(model.name), "synthetic": np.array(model.synthetic)}
    np.savez_compressed(archive, **content)
    return archive.getvalue()


def elevation_geotiff(model: ElevationModel) -> bytes:
    """The model as GeoTIFF, heights first. Raises ParameterError without rasterio."""
    return geotiff_bytes(model.stated(), (model.x0_m, model.y0_m, model.spacing_m), synthetic=model.synthetic)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StationPosition:
    """Where a model belongs.

    Attributes
    ----------
    x_m, y_m : are added to its coordinates. [m]
    z_m : is added to its heights. [m]
    covariance_m2 : of x, y, z; zeros where they are exact. (3, 3) [m2]
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    covariance_m2: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """How two models differ at the nodes that both know, once all are corrected.

    Attributes
    ----------
    first, second : their numbers from 0, in the order given.
    nodes : how many both know.
    mean_m : median of the second less the first; the name is older than the median, and files have it. [m]
    rms_z : root mean square of the differences in their standard errors, from random errors alone. [-]
    odd_share : share of the nodes with more than three standard errors. [-]
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
    corrections : what each of the k models is off by, in `COLUMNS`. (k, 3) [-, m, m]
    covariance : of all corrections, model after model. (3 k, 3 k)
    z_score : largest disagreement of a node with the merged height, signed, NaN where there is one model. (ny, nx)
    overlaps : of pairs of models.
    """

    model: ElevationModel
    corrections: FloatArray
    covariance: FloatArray
    z_score: FloatArray
    overlaps: tuple[Overlap, ...]


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
    places = list(positions) if positions is not None else [StationPosition()] * len(models)
    without = [model.name for model in models if model.height_m_sigma is None]
    reasons = {
        f"{len(models)} models and {len(places)} positions; give two or more, and one for each":
            len(models) < 2 or len(places) != len(models),
        f"{', '.join(without)}: no height_m_sigma; inverse variances need the errors of the heights": bool(without),
    }  # fmt: skip
    refuse(reasons)
    steps = progress or (lambda *_: None)
    step = spacing_m or min(model.spacing_m for model in models)
    x, y = (_axis(models, places, name, step) for name in ("x_m", "y_m"))
    shift = np.zeros((len(models), len(COLUMNS)))
    for k in range(RELAID):
        stack = Stack.of(models, places, (x, y, step), shift)
        corrections, covariance, weight = reconciled(stack)
        free = np.tile([0.0, 1.0, 1.0], len(models)) * (np.diag(stack.prior) > 0)
        covariance += np.diag(free) * (BETWEEN_NODES * step) ** 2
        shift = corrections * [0.0, 1.0, 1.0]
        steps(1 + k, RELAID + 1)
    return map_of(models, stack, weight, corrections, covariance, (x, y, step))


def _axis(models: Sequence[ElevationModel], places: Sequence[StationPosition], name: str, step: float) -> FloatArray:
    """Nodes of the merged map along `x_m` or `y_m`, from the least to the largest of any model. (n,) [m]"""
    shifted = [getattr(m, name) + getattr(p, name) for m, p in zip(models, places, strict=True)]
    low, high = min(v[0] for v in shifted), max(v[-1] for v in shifted)
    count = math.ceil((high - low) / step - 1e-6) + 1
    if count > 20_000:
        raise ParameterError(f"a map of {high - low:.3g} m every {step:g} m is too large; give a larger spacing")
    return np.asarray(low + step * np.arange(count))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stack:
    """k models on the n nodes of one grid, row by row.

    Attributes
    ----------
    height : of the nodes, NaN where a model does not know one. (k, n) [m]
    variance : random, of these. (k, n) [m2]
    by : derivatives of the heights by the c ways in which each may be off, such as `COLUMNS`. (k, n, c) [m, -, -]
    prior : covariance of what the models may be off by, in these, model after model. (c k, c k)
    alike : how many nodes are one measurement, 1 or more: those within the resolution.
    block : number of the block of `BLOCK` nodes along each side that a node lies in, from 0. (n,)
    """

    height: FloatArray
    variance: FloatArray
    by: FloatArray
    prior: FloatArray
    alike: float
    block: IndexArray

    @classmethod
    def of(
        cls,
        models: Sequence[ElevationModel],
        places: Sequence[StationPosition],
        grid_m: tuple[FloatArray, FloatArray, float],
        shift: FloatArray,
    ) -> "Stack":
        """Models laid where they are thought to be.

        grid_m : its x (nx,) and y (ny,), and their step. [m]
        shift : by which each model is moved before slopes are taken, in `COLUMNS`; its offsets are 0. (k, 3)
        """
        x, y, step = grid_m
        grid = np.meshgrid(x, y)
        heights, variances, derivatives = [], [], []
        for model, place, moved in zip(models, places, shift, strict=True):
            at = grid[0].ravel() - place.x_m + moved[1], grid[1].ravel() - place.y_m + moved[2]
            height = model.at("height_m", *at) + place.z_m
            sigma, common = model.at("height_m_sigma", *at), np.nan_to_num(model.at("height_m_common_sigma", *at))
            table = height.reshape(grid[0].shape)
            slope_y, slope_x = np.gradient(np.where(np.isfinite(table), mean_about(table, 2.0), np.nan), step)
            # A shift to the east moves the height of a place by less the slope.
            by = [np.hypot(common, math.sqrt(place.covariance_m2[2, 2])), -slope_x.ravel(), -slope_y.ravel()]
            derivatives.append(np.nan_to_num(np.stack(by, axis=-1)))
            heights.append(np.where(np.isfinite(sigma) & (sigma > 0), height + derivatives[-1] @ moved, np.nan))
            variances.append(sigma**2)
        stack = cls(
            height=np.array(heights),
            variance=np.array(variances),
            by=np.array(derivatives),
            prior=block_diag(*(block_diag(np.eye(1), place.covariance_m2[:2, :2]) for place in places)),
            alike=alike_of(models, step),
            block=blocks_of(len(y), len(x)),
        )
        if not stack.shared.any():
            raise ParameterError("the models share no nodes: nothing to compare; check their positions")
        return stack

    def part(self, nodes: BoolArray) -> "Stack":
        """The same of some nodes (n,) alone."""
        arrays = {key: getattr(self, key)[:, nodes] for key in ("height", "variance", "by")}
        return replace(self, block=self.block[nodes], **arrays)

    @property
    def valid(self) -> BoolArray:
        """Which model knows which node. (k, n)"""
        return np.asarray(np.isfinite(self.height))

    @property
    def shared(self) -> BoolArray:
        """Nodes that two models know or more. (n,)"""
        return np.asarray(self.valid.sum(axis=0) > 1)

    def inverse(self, weight: FloatArray | float = 1.0) -> FloatArray:
        """Inverse variances, 0 where nothing is known. (k, n)"""
        return np.where(self.valid, weight / self.variance, 0.0)

    def corrected(self, corrections: FloatArray) -> FloatArray:
        """Heights less what models are off by (k, 3). (k, n)"""
        return np.asarray(self.height - np.einsum("knc,kc->kn", self.by, corrections))

    def merged(self, weight: FloatArray, corrections: FloatArray) -> FloatArray:
        """Weighted means of corrected heights. (n,)"""
        inverse = self.inverse(weight)
        with np.errstate(invalid="ignore", divide="ignore"):
            total = (inverse * np.nan_to_num(self.corrected(corrections))).sum(axis=0)
            return np.asarray(total / inverse.sum(axis=0))

    def z_scores(self, merged: FloatArray, corrections: FloatArray) -> FloatArray:
        """What each model is off from the merged height, over the standard error of that difference. (k, n)"""
        with np.errstate(invalid="ignore", divide="ignore"):
            spread = self.variance - 1.0 / self.inverse().sum(axis=0)
            off = (self.corrected(corrections) - merged) / np.sqrt(np.maximum(spread, 0.0))
        return np.where(spread > 1e-6 * self.variance, off, np.nan)


def alike_of(models: Sequence[ElevationModel], step: float) -> float:
    """How many nodes are one measurement, 1 or more: those within the resolution."""
    return max(1.0, (_width(models) / step) ** 2)


def blocks_of(ny: int, nx: int) -> IndexArray:
    """Number of the block of `BLOCK` nodes along each side that a node lies in, from 0. (ny nx,)"""
    rows, columns = np.arange(ny) // BLOCK, np.arange(nx) // BLOCK
    return np.asarray((rows[:, None] * (columns[-1] + 1) + columns).ravel(), dtype=np.intp)


def _width(models: Sequence[ElevationModel]) -> float:
    """The largest median resolution. [m]"""
    return max(float(np.nan_to_num(np.nanmedian(model.layer("resolution_m")))) for model in models)


def reconciled(stack: Stack) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What models are off by (k, c), its covariance (c k, c k), and Huber's weights of their heights (k, n), 0 to 1.

    The covariance is C (S + P^-1) C with S the sum of squares of the gradients of blocks of the map (White 1982,
    10.2307/1912526), where it is larger than C: heights scatter more than they say, and alike over more than the
    resolution, on rough ground.
    """
    whole, shared = stack.valid.astype(float), stack.shared
    if not shared.any():
        return np.zeros((len(whole), stack.by.shape[2])), stack.prior, whole
    stack = stack.part(shared)
    weight = stack.valid.astype(float)
    for _ in range(REWEIGHTED):
        corrections, covariance = _corrections(stack, weight)
        z = stack.z_scores(stack.merged(weight, corrections), corrections)
        weight = np.where(stack.valid, huber_weights(np.nan_to_num(z) ** 2, 1), 0.0)
    count, nodes, columns = stack.by.shape
    inverse = stack.inverse(weight) / stack.alike
    whole[:, shared] = weight
    off = np.nan_to_num(stack.corrected(corrections) - stack.merged(weight, corrections))
    by_node = (stack.by * (inverse * off)[..., None]).transpose(1, 0, 2).reshape(nodes, count * columns)
    gradients = np.zeros((int(stack.block.max()) + 1, count * columns))
    np.add.at(gradients, stack.block, by_node)
    wider = covariance @ (gradients.T @ gradients + np.linalg.pinv(stack.prior)) @ covariance
    larger = np.sqrt(np.maximum(np.diag(wider) / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return corrections, np.asarray(covariance * np.outer(larger, larger)), whole


def _corrections(stack: Stack, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What each model is off by (k, c), and the covariance of all of it, with the heights themselves solved for.

    Where models overlap, each node's height is the weighted mean of what they say, so that only differences count.
    Neighbouring nodes within the resolution are one measurement.
    """
    inverse, by, height = stack.inverse(weight) / stack.alike, stack.by, np.nan_to_num(stack.height)
    count, _, columns = by.shape
    total = inverse.sum(axis=0)
    weighted = by * inverse[..., None]
    normal = -np.einsum("inc,jnd->icjd", weighted / total[:, None], weighted, optimize=True)
    for i in range(count):
        normal[i, :, i, :] += weighted[i].T @ by[i]
    rhs = np.einsum("inc,in->ic", weighted, height - (inverse * height).sum(axis=0) / total)
    # What is given beforehand may be exact: columns without a prior variance are left at zero.
    values, vectors = np.linalg.eigh(stack.prior)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = root.T @ normal.reshape(count * columns, -1) @ root + np.eye(count * columns)
    solved = root @ np.linalg.solve(inner, root.T @ rhs.ravel())
    return solved.reshape(count, columns), root @ np.linalg.inv(inner) @ root.T


def map_of(
    models: Sequence[ElevationModel],
    stack: Stack,
    weight: FloatArray,
    corrections: FloatArray,
    covariance: FloatArray,
    grid: tuple[FloatArray, FloatArray, float],
) -> MergedMap:
    """The merged map with its errors; `grid` as of `Stack.of`, `weight` (k, n)."""
    x, y, step = grid
    shape = len(y), len(x)
    merged, inverse = stack.merged(weight, corrections), stack.inverse(weight)
    total = inverse.sum(axis=0)
    z = stack.z_scores(merged, corrections)
    worst = np.where(np.isnan(z), -1.0, np.abs(z)).argmax(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(total > 0, inverse / total, 0.0)
    # Weights of doubtful heights are lower, which is no reason to believe in less of an error.
    random = np.sqrt((share**2 * np.where(stack.valid, stack.variance, 0.0)).sum(axis=0))
    common = np.zeros(len(merged))
    for rows in np.array_split(np.arange(len(merged)), 1 + len(merged) // AT_ONCE):
        parts = (share[:, rows, None] * stack.by[:, rows]).transpose(1, 0, 2).reshape(len(rows), -1)
        common[rows] = np.sqrt(np.maximum(((parts @ covariance) * parts).sum(axis=1), 0.0))
    layers = {
        key: np.where(total > 0, values, np.nan).reshape(shape)
        for key, values in (("height_m", merged), ("height_m_sigma", random), ("height_m_common_sigma", common))
    }
    model = ElevationModel(
        name=" + ".join(model.name for model in models),
        x0_m=float(x[0]),
        y0_m=float(y[0]),
        spacing_m=step,
        count=stack.valid.sum(axis=0).astype(float).reshape(shape),
        resolution_m=np.array(_width(models)),
        synthetic=any(model.synthetic for model in models),
        **layers,
    )
    return MergedMap(
        model=model,
        corrections=corrections,
        covariance=covariance,
        z_score=np.take_along_axis(z, worst[None], axis=0)[0].reshape(shape),
        overlaps=tuple(_overlaps(stack, corrections)),
    )


def _overlaps(stack: Stack, corrections: FloatArray) -> Iterator[Overlap]:
    """Of each two models that know a node in common; `corrections` (k, 3)."""
    height = stack.corrected(corrections)
    for i, j in combinations(range(len(height)), 2):
        both = stack.valid[i] & stack.valid[j]
        if not both.any():
            continue
        off = height[j, both] - height[i, both]
        z = off / np.sqrt(stack.variance[i, both] + stack.variance[j, both])
        yield Overlap(
            first=i,
            second=j,
            nodes=int(both.sum()),
            mean_m=float(np.median(off)),
            rms_z=float(np.sqrt(np.mean(z**2))),
            odd_share=float((np.abs(z) > 3).mean()),
        )
