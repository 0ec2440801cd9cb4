"""Layers over a terrain: rasters of costs or of classes of ground, and shadow, as factors on the cost of a metre."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.heights.grid import HeightGrid
from lunarsci.heights.grids import read_grid
from lunarsci.heights.projections import projection_of
from lunarsci.twin.ground.terrain import Terrain

FORBIDDEN = "forbidden"
SAME_CLASS = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CostLayer:
    """How much a metre of some ground costs, in metres of other ground with the same slopes.

    Attributes
    ----------
    name : what it is, for messages.
    factor : above 0, infinite where no part of the rover may be; 1 where the layer says nothing. (ny, nx) [-]
    known_share : share of the terrain's nodes of which it says something. [-]

    Raises ParameterError for factors of 0 and below.
    """

    name: str
    factor: npt.NDArray[np.float32]
    known_share: float = 1.0

    def __post_init__(self) -> None:
        if not (self.factor > 0).all():
            raise ParameterError(
                f"layer '{self.name}' has costs of 0 or below; give factors above 0 (1 changes nothing), or classes"
            )

    @property
    def forbidden(self) -> BoolArray:
        """Nodes that no part of the rover may enter. (ny, nx)"""
        return np.isinf(self.factor)


def parse_cost(text: str) -> float:
    """A factor above 0, or infinity for `forbidden`. Raises ParameterError."""
    try:
        cost = math.inf if text.strip() == FORBIDDEN else float(text)
    except ValueError:
        cost = math.nan
    if not cost > 0 or (math.isinf(cost) and text.strip() != FORBIDDEN):
        raise ParameterError(f"'{text}' is no cost; give a factor above 0, such as 2, or {FORBIDDEN}")
    return cost


def parse_classes(texts: Sequence[str]) -> dict[float, float]:
    """Costs by class, from `VALUE=COST` each, COST a factor or `forbidden`. Raises ParameterError."""
    found: dict[float, float] = {}
    for text in texts:
        value, sign, cost = text.partition("=")
        try:
            number = float(value) if sign else math.nan
        except ValueError:
            number = math.nan
        if math.isnan(number):
            raise ParameterError(f"class '{text}' is not VALUE=COST, for example 3=forbidden or 2=1.5")
        found[number] = parse_cost(cost)
    return found


def read_cost_layer(path: str, terrain: Terrain, classes: Mapping[float, float]) -> CostLayer:
    """A raster on any grid, as `heights.grids.read_grid` reads heights, of costs; or of classes where some are given.

    A node of the terrain has the value of the raster's nearest node; beyond it, where it has no data, and of a class
    without a cost, the factor is 1. Rasters of another coordinate system are looked up by longitude and latitude.
    Raises DataError.
    """
    grid = read_grid(path, values=True)
    values = _values_at(grid, terrain, path)
    known = ~np.isnan(values)
    if not known.any():
        raise DataError(f"{path}: covers no node of the terrain; is it of the same place and coordinate system?")
    factor = np.where(known, values, 1.0)
    if classes:
        factor = np.ones(values.shape)
        for value, cost in classes.items():
            factor[np.abs(values - value) < SAME_CLASS] = cost
    try:
        return CostLayer(name=Path(path).name, factor=factor.astype(np.float32), known_share=float(known.mean()))
    except ParameterError as error:
        raise DataError(f"{path}: {error}") from error


def _values_at(grid: HeightGrid, terrain: Terrain, path: str) -> npt.NDArray[np.float64]:
    """Values of a raster at the nodes of a terrain, NaN where it has none. (ny, nx)"""
    x, y = terrain.x_m[None, :], terrain.y_m[:, None]
    if grid.crs and terrain.crs and grid.crs != terrain.crs:
        lonlat = projection_of(terrain.crs, terrain.name).lonlat(*(axis.ravel() for axis in np.broadcast_arrays(x, y)))
        places = projection_of(grid.crs, path).metres(*lonlat.T).reshape(*terrain.height_m.shape, 2)
        x, y = places[..., 0], places[..., 1]
    column, row = (np.rint((at - first) / grid.spacing_m) for at, first in ((x, grid.x0_m), (y, grid.y0_m)))
    ny, nx = grid.height_m.shape
    row, column = np.broadcast_arrays(row, column)
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    values = np.full(terrain.height_m.shape, np.nan)
    values[inside] = grid.height_m[row[inside].astype(int), column[inside].astype(int)]
    return values


def shadow_layer(lit: BoolArray, cost: float) -> CostLayer:
    """What a metre in shadow costs; infinite forbids it."""
    return CostLayer(name="shadow", factor=np.where(lit, 1.0, cost).astype(np.float32))
