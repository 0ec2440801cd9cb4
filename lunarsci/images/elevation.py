"""An elevation model made of pictures: heights on a grid, and two kinds of error beside them.

Random errors average over nodes, as far as these are independent. Common errors, of the rig and of the place of the
cameras, do not.
"""

import io
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
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
