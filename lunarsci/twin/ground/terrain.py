"""Terrain: a regular grid of heights with soil parameters at every node, and its files."""

import dataclasses
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose
from lunarsci.errors import DataError, ParameterError, within_file
from lunarsci.heights.grid import ERROR_LAYERS, HeightGrid
from lunarsci.heights.grids import check_relief, read_grid
from lunarsci.heights.projections import projection_or_none
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import read_input
from lunarsci.names import one_of
from lunarsci.ranges import refuse
from lunarsci.regolith.columns import ground_written
from lunarsci.regolith.prior import ROLLING
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.height_errors import EXACT, GRAIN_NODES, HeightErrors, likely_ground
from lunarsci.twin.lanes import CLIFF, FINISHED, GROUP, HOLE, LEFT, SANK, STEEPEST_DEG, WHEEL

SOIL_COLUMNS = {
    "stiffness_kpa_m_n": 0,
    "sinkage_exponent": 1,
    "sinkage_exponent_slip": 2,
    "cohesion_pa": 3,
    "friction_angle_deg": 4,
    "shear_modulus_mm": 5,
    "external_friction_angle_deg": 6,
    "lateral_modulus_mm": 7,
}
"""Column of `Soil.vector()` that holds each parameter."""
OVERRIDES = SOIL_COLUMNS | {name: len(SOIL_COLUMNS) + k for k, name in enumerate(ROLLING)}
"""Columns of what a member has for itself: 8 of its soil, then 4 of its wheels."""
STEEPEST = math.tan(math.radians(STEEPEST_DEG))
"""Slope of the ground beyond which it is a cliff. [-]"""
INTERPOLATIONS = ("smooth", "triangles")
"""See `Terrain.interpolation`."""
CELL, CENTER, GROUND, SOIL = (WHEEL.first[name] for name in ("cell", "center", "ground", "soil"))
"""Rows of a wheel in `Work.wheels`: the number of one lane in row k lies at k * GROUP + lane."""
LEFT_OF_PRIOR = "_left_of_prior"
"""Ends the names of layers with how much of a parameter's prior width is left, which a soil map writes."""


class Grid(NamedTuple):
    """What the compiled formulas read of a terrain, at each node.

    Attributes
    ----------
    x0, y0, spacing : position of node [0, 0], and distance of the nodes. [m]
    height : NaN where unknown; row is y, column is x. (ny, nx) [m]
    soil : `Soil.vector()` at each node, or one for all. (ny, nx, 8) or (1, 1, 8)
    triangles : True for triangles between nodes, False for a smooth surface.
    common, level, grain : those of `HeightErrors`, empty where heights are exact.
    draws : what each rover's ground is drawn by, `HeightErrors.draws`. (rovers, modes + 2)
    """

    x0: float
    y0: float
    spacing: float
    height: FloatArray
    soil: FloatArray
    triangles: bool
    common: npt.NDArray[np.float32]
    level: npt.NDArray[np.float32]
    grain: npt.NDArray[np.float32]
    draws: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Terrain:
    """Heights and soil on a regular grid, x to the east of the local frame, y to the north.

    Attributes
    ----------
    name : what the terrain is.
    x0_m, y0_m : position of node [0, 0]. [m]
    spacing_m : distance of the nodes in x and y, > 0. [m]
    height_m : height, NaN where unknown; row is y, column is x. (ny, nx) [m]
    soil : `Soil.vector()`, in Pa and m, angles as their tangents, at every node or one for all. (ny, nx, 8) or
        (1, 1, 8)
    synthetic : True for a made-up terrain.
    interpolation : the ground between nodes. `smooth` has a continuous gradient: cubic convolution (Keys 1981,
        10.1109/TASSP.1981.1163711), whose gradient at a node is the central difference of its neighbours; beyond the
        edge heights go on linearly. `triangles` is two planes a cell, split from its lowest x and y to its highest,
        as in Ding et al. (2024); the wheels feel each edge.
    errors : what is not known of the heights; None where they are taken as exact.
    crs : the coordinate system of x and y as well-known text; empty for a local frame.
    ground : how tables name it where its heights are no longer those of its file; else empty, see `written`.

    Soil is bilinear in tan phi, moduli and stiffness. On a smooth surface a hole reaches one node further than the
    missing heights. Raises ParameterError for arrays that do not fit together.
    """

    name: str
    x0_m: float
    y0_m: float
    spacing_m: float
    height_m: FloatArray
    soil: FloatArray
    synthetic: bool = False
    interpolation: str = "smooth"
    errors: HeightErrors | None = None
    crs: str = ""
    ground: str = ""

    def __post_init__(self) -> None:
        refuse(self._ill_made())

    def _ill_made(self) -> Iterator[str]:
        shape = self.height_m.shape
        if len(shape) != 2 or min(shape) < 3:
            yield f"terrain height_m has shape {shape}; give a grid of at least 3 x 3 nodes"
        if self.soil.shape not in ((*shape, 8), (1, 1, 8)):
            yield f"terrain soil has shape {self.soil.shape}; give {(*shape, 8)} or (1, 1, 8)"
        if not (0 < self.spacing_m < math.inf and math.isfinite(self.x0_m) and math.isfinite(self.y0_m)):
            yield "terrain x0_m, y0_m and spacing_m must be finite, spacing_m above 0"
        if self.interpolation not in INTERPOLATIONS:
            yield f"terrain interpolation is '{self.interpolation}'; {one_of(self.interpolation, INTERPOLATIONS)}"
        if np.isinf(self.height_m).any():
            yield "terrain height_m is infinite somewhere; use NaN where the height is unknown"
        if np.isnan(self.height_m).all():
            yield "terrain height_m has no known height"
        if not np.isfinite(self.soil).all():
            yield "terrain soil has a value that is not finite"

    @property
    def written(self) -> str:
        """The ground as tables name it: its name, and a mark of its heights to a millimetre and of where they are."""
        return self.ground or ground_written(self.name, self.height_m, (self.x0_m, self.y0_m, self.spacing_m))

    @property
    def x_m(self) -> FloatArray:
        """Columns. (nx,) [m]"""
        return self.x0_m + self.spacing_m * np.arange(self.height_m.shape[1], dtype=np.float64)

    @property
    def y_m(self) -> FloatArray:
        """Rows. (ny,) [m]"""
        return self.y0_m + self.spacing_m * np.arange(self.height_m.shape[0], dtype=np.float64)

    def window(self, points_m: FloatArray, margin_m: float = 0.0) -> tuple[slice, slice]:
        """Rows and columns of the nodes in a box about points (n, 2) and a margin about it. [m]"""
        rows, columns = (
            slice(*np.searchsorted(axis, (ends.min() - margin_m, ends.max() + margin_m)))
            for axis, ends in ((self.y_m, points_m[:, 1]), (self.x_m, points_m[:, 0]))
        )
        return rows, columns

    def nodes(self, points_m: FloatArray) -> tuple[IntArray, IntArray]:
        """Row and column of the node nearest to each of some points (..., 2) [m], which may lie beyond the edge."""
        row, column = (
            np.rint((points_m[..., k] - first) / self.spacing_m).astype(np.int64)
            for k, first in ((1, self.y0_m), (0, self.x0_m))
        )
        return row, column

    def has(self, row: IntArray, column: IntArray) -> BoolArray:
        """Whether there are such nodes."""
        ny, nx = self.height_m.shape
        return np.asarray((row >= 0) & (row < ny) & (column >= 0) & (column < nx))

    def filled_share(self, points_m: FloatArray, away_m: float) -> float:
        """Share of the nodes in squares of this half side about points (n, 2) [m] that were not seen but filled."""
        if self.errors is None or not self.errors.filled.any():
            return 0.0
        about = np.mgrid[-away_m : away_m : self.spacing_m, -away_m : away_m : self.spacing_m].reshape(2, 1, -1)
        row, column = self.nodes(np.moveaxis(points_m.T[..., None] + about, 0, -1))
        inside = self.has(row, column)
        return float(self.errors.filled[row[inside], column[inside]].mean()) if inside.any() else 0.0

    def summary(self) -> dict[str, Any]:
        """Name, extent, nodes, lowest and highest node and share of holes, for a result."""
        height = self.height_m
        return {
            "name": self.name,
            "synthetic": self.synthetic,
            "x_m": [self.x_m[0], self.x_m[-1]],
            "y_m": [self.y_m[0], self.y_m[-1]],
            "spacing_m": self.spacing_m,
            "nodes": [height.shape[1], height.shape[0]],
            "height_m": [np.nanmin(height), np.nanmax(height)],
            "hole_share": float(np.isnan(height).mean()),
            **({"crs": self.crs} if self.crs else {}),
        }

    def with_soil(self, **values: npt.ArrayLike) -> "Terrain":
        """The same ground with soil parameters changed; a number, or one value for each node (ny, nx)."""
        changed = {_column(name): _in_si(name, np.asarray(value, dtype=float)) for name, value in values.items()}
        uniform = all(value.ndim == 0 for value in changed.values())
        soil = self.soil.copy() if uniform else np.broadcast_to(self.soil, (*self.height_m.shape, 8)).copy()
        for column, value in changed.items():
            soil[..., column] = value
        return dataclasses.replace(self, soil=soil)

    def grid(self, draws: FloatArray | None = None) -> Grid:
        """The numbers that the compiled formulas take; `draws` are those of `HeightErrors.draws`, one a rover."""
        errors = EXACT if self.errors is None or draws is None else self.errors
        soil = self.soil if not (self.soil == self.soil[:1, :1]).all() else self.soil[:1, :1]
        return Grid(
            float(self.x0_m),
            float(self.y0_m),
            float(self.spacing_m),
            np.ascontiguousarray(self.height_m, dtype=float),
            np.ascontiguousarray(soil, dtype=float),
            self.interpolation == "triangles",
            errors.common,
            errors.level,
            errors.grain,
            np.zeros((1, 2)) if draws is None else draws,
        )

    def drawn_heights(self, draw: FloatArray, rows: slice, columns: slice) -> FloatArray:
        """Heights of a part of the ground that one member drives on. (rows, columns) [m]"""
        result = np.array(self.height_m[rows, columns], dtype=float)
        read_heights(self.grid(draw[None]), rows.start, columns.start, result)
        return result

    def surface_at(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Height [m] and its gradient along x and y [-] below points, NaN outside the map and in holes. (..., 3)"""
        x, y = np.broadcast_arrays(np.asarray(x_m, dtype=float), np.asarray(y_m, dtype=float))
        result = np.empty((x.size, 3))
        read_surface(self.grid(), x.ravel(), y.ravel(), result)
        return result.reshape(*x.shape, 3)

    def height_at(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Height below points, NaN outside the map and in holes. [m]"""
        return self.surface_at(x_m, y_m)[..., 0]


def cubic_weights(a: Any) -> Any:
    """Weights (4,) of the nodes about a cell for the value, and (4,) for the slope, at the share `a` of its width.

    Nodes count from the one before the cell; the slope is per cell.
    """
    q = a * a
    c = q * a
    value = (-0.5 * (a + c) + q, 1.0 - 2.5 * q + 1.5 * c, 0.5 * a + 2.0 * q - 1.5 * c, 0.5 * (c - q))
    return value, (-0.5 + 2.0 * a - 1.5 * q, -5.0 * a + 4.5 * q, 0.5 + 4.0 * a - 4.5 * q, 1.5 * q - a)


@formula
def smooth_surface(nodes: Any, a: Any, b: Any) -> Any:
    """Height [m] and its change along x and y over a cell [m], at shares a (in x) and b (in y) of it, by cubic
    convolution of the 16 `nodes` about it.
    """
    along, slope_along = cubic_weights(a)
    up, slope_up = cubic_weights(b)
    height, slope_x, slope_y = 0.0, 0.0, 0.0
    for k in range(4):
        value, slope = 0.0, 0.0
        for m in range(4):
            value, slope = value + along[m] * nodes[4 * k + m], slope + slope_along[m] * nodes[4 * k + m]
        height, slope_x, slope_y = height + up[k] * value, slope_x + up[k] * slope, slope_y + slope_up[k] * value
    return height, slope_x, slope_y


@formula
def triangle_surface(nodes: Any, a: Any, b: Any) -> Any:
    """As `smooth_surface`, on two triangles between the nodes of the cell."""
    near, aside, above, far = nodes[5], nodes[6], nodes[9], nodes[10]
    x, y = choose(a >= b, aside - near, far - above), choose(a >= b, far - aside, above - near)
    return near + a * x + b * y, x, y


@compiled
def height_of(grid: Any, lane: Any, i: int, j: int) -> Any:
    """Height of node [i, j] of a `Grid` on the ground of rover `lane`, or on the likely one where that is None. [m]"""
    height = grid.height[i, j]
    if lane is None:
        return height
    modes, side = grid.common.shape[2], GRAIN_NODES - 1
    for k in range(modes):
        height += grid.draws[lane, k] * grid.common[i, j, k]
    row, column = (i + int(grid.draws[lane, modes])) & side, (j + int(grid.draws[lane, modes + 1])) & side
    below = int(grid.level[i, j])
    share = grid.level[i, j] - below
    fine, coarse = grid.grain[row, column, below], grid.grain[row, column, below + 1]
    return height + (1.0 - share) * fine + share * coarse


@compiled
def read_heights(grid: Any, row: int, column: int, result: Any) -> None:
    """Heights of the ground of the first rover, from node [row, column] of a `Grid` on, into `result` (k, m). [m]"""
    for i in range(result.shape[0]):
        for j in range(result.shape[1]):
            result[i, j] = height_of(grid, 0, row + i, column + j)


@compiled
def nodes_about(grid: Any, i: int, j: int, nodes: Any, lane: Any = None) -> None:
    """Heights of the 4 x 4 nodes about a cell of a `Grid`, row by row, into `nodes` (16,). [m]

    The cell lies between nodes [i, j] and [i + 1, j + 1]. Beyond the edge of the map heights go on in line. `lane` is
    the rover whose ground it is, where each has its own; None compiles to a formula that knows no errors.
    """
    ny, nx = grid.height.shape
    for k in range(4):
        for m in range(4):
            row, column = min(max(i + k - 1, 0), ny - 1), min(max(j + m - 1, 0), nx - 1)
            nodes[4 * k + m] = height_of(grid, lane, row, column)
    for k in range(0, 16, 4):
        if j == 0:
            nodes[k] = 2.0 * nodes[k + 1] - nodes[k + 2]
        if j == nx - 2:
            nodes[k + 3] = 2.0 * nodes[k + 2] - nodes[k + 1]
    for m in range(4):
        if i == 0:
            nodes[m] = 2.0 * nodes[m + 4] - nodes[m + 8]
        if i == ny - 2:
            nodes[m + 12] = 2.0 * nodes[m + 8] - nodes[m + 4]


@compiled
def read_surface(grid: Any, x: Any, y: Any, result: Any) -> None:
    """Height [m] and gradient [-] of a `Grid` below points x, y (n,) [m], into `result` (n, 3); NaN outside the map."""
    (ny, nx), nodes = grid.height.shape, np.empty(16)
    for k in range(len(x)):
        column, row = (x[k] - grid.x0) / grid.spacing, (y[k] - grid.y0) / grid.spacing
        if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
            result[k] = np.nan
            continue
        j, i = min(int(column), nx - 2), min(int(row), ny - 2)
        nodes_about(grid, i, j, nodes)
        if grid.triangles:
            height, rise_x, rise_y = triangle_surface(nodes, column - j, row - i)
        else:
            height, rise_x, rise_y = smooth_surface(nodes, column - j, row - i)
        result[k, 0], result[k, 1], result[k, 2] = height, rise_x / grid.spacing, rise_y / grid.spacing


@compiled
def lay_soil(grid: Any, override: Any, wheel: Any) -> None:
    """Soil below a wheel of every lane: that of `override` where it is not NaN, else that of the `Grid`'s first node.

    `override` (GROUP, 12) has a row of `soil_overrides` for each lane. `wheel` is one of `Work.wheels`, rows by GROUP
    lanes as one array, (WHEEL.rows * GROUP,); its rows `soil` are filled, and no cell is known any more.
    """
    for lane in range(GROUP):
        wheel[(CELL + 2) * GROUP + lane] = 0.0
        for k in range(8):
            value = override[lane, k]
            wheel[(SOIL + k) * GROUP + lane] = grid.soil[0, 0, k] if np.isnan(value) else value


def shares_in_cell(grid: Any, rows: Any) -> Any:
    """Where in its cell a wheel is, in x and in y. [-]"""
    x, y, column, row = rows.center[0], rows.center[1], rows.cell[0], rows.cell[1]
    return (x - grid.x0) / grid.spacing - column, (y - grid.y0) / grid.spacing - row


@formula
def forget_cells(grid: Any, wheel: Any, lane: Any) -> None:
    """The cells that a wheel has left are not known any more."""
    rows = WHEEL.of(wheel, lane)
    a, b = shares_in_cell(grid, rows)
    column, row, known, odd = rows.cell
    rows.cell = (column, row, choose((a >= 0.0) & (a < 1.0) & (b >= 0.0) & (b < 1.0), known, 0.0), odd)


@compiled
def find_cell(grid: Any, wheel: Any, code: Any, lane: int) -> None:
    """The cell of a `Grid` below a wheel of a lane that drives, with its nodes; arguments as of `read_ground`."""
    (ny, nx), here = grid.height.shape, wheel[CELL * GROUP + lane :]
    x, y = wheel[CENTER * GROUP + lane], wheel[(CENTER + 1) * GROUP + lane]
    column, row = (x - grid.x0) / grid.spacing, (y - grid.y0) / grid.spacing
    if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
        code[lane] = LEFT
        return
    j, i = min(int(column), nx - 2), min(int(row), ny - 2)
    here[0], here[GROUP], here[2 * GROUP] = j, i, 1.0
    if grid.grain.shape[2] > 0:
        nodes_about(grid, i, j, here[4 * GROUP :: GROUP], min(lane, grid.draws.shape[0] - 1))
    else:
        nodes_about(grid, i, j, here[4 * GROUP :: GROUP])


@formula
def lay_ground(grid: Any, wheel: Any, triangles: Any, lane: Any) -> None:
    """Height [m] and gradient below a wheel of the lanes that have a cell; those are odd that nothing drives on."""
    rows = WHEEL.of(wheel, lane)
    height, rise_x, rise_y = (triangle_surface if triangles else smooth_surface)(
        rows.nodes, *shares_in_cell(grid, rows)
    )
    slope_x, slope_y, known = rise_x / grid.spacing, rise_y / grid.spacing, rows.cell[2] > 0.0
    ground = zip((height, slope_x, slope_y), rows.ground, strict=True)
    rows.ground = tuple(choose(known, new, old) for new, old in ground)
    fine = (abs(height) < math.inf) & (slope_x * slope_x + slope_y * slope_y <= STEEPEST * STEEPEST)
    rows.cell = (*rows.cell[:3], choose(known & ~fine, 1.0, 0.0))


@compiled
def read_ground(grid: Any, override: Any, wheel: Any, code: Any) -> None:
    """Height, gradient and soil of a `Grid` below a wheel, of every lane; who left the map, met a hole or a cliff.

    `override` and `wheel` as in `lay_soil`; the rows `ground` and `soil` below the rows `center` are filled. `code` is
    `Work.code` (GROUP,): a number of `OUTCOMES` for each lane, of which FINISHED also stands for one that still drives.
    Lanes with an outcome other than this or SANK keep what they had. Soil that is the same everywhere stays as
    `lay_soil` left it.
    """
    for lane in range(0, GROUP, LANES):
        forget_cells(grid, wheel, lane)
    for lane in range(GROUP):
        if code[lane] != FINISHED and code[lane] != SANK:
            wheel[(CELL + 2) * GROUP + lane] = 0.0
        elif wheel[(CELL + 2) * GROUP + lane] == 0.0:
            find_cell(grid, wheel, code, lane)
    for lane in range(0, GROUP, LANES):
        if grid.triangles:
            lay_ground(grid, wheel, True, lane)
        else:
            lay_ground(grid, wheel, False, lane)
    uniform = grid.soil.shape[0] == 1
    for lane in range(GROUP):
        if wheel[(CELL + 3) * GROUP + lane] > 0.0:
            note_ground(wheel[GROUND * GROUP + lane :], code, lane)
        if not uniform and wheel[(CELL + 2) * GROUP + lane] > 0.0 and code[lane] != HOLE:
            read_soil(grid, override, wheel, lane)


@compiled
def note_ground(ground: Any, code: Any, lane: int) -> None:
    """Note a hole, which is level, or a cliff in the `ground` of a lane, whose numbers are GROUP apart."""
    if abs(ground[0]) + abs(ground[GROUP]) + abs(ground[2 * GROUP]) < np.inf:
        code[lane] = CLIFF
    else:
        code[lane] = HOLE
        ground[0], ground[GROUP], ground[2 * GROUP] = 0.0, 0.0, 0.0


@compiled
def read_soil(grid: Any, override: Any, wheel: Any, lane: int) -> None:
    """Soil below a wheel of a lane that has a cell, but for what `override` says; arguments as of `read_ground`."""
    here = wheel[CELL * GROUP + lane :]
    x, y, j, i = wheel[CENTER * GROUP + lane], wheel[(CENTER + 1) * GROUP + lane], int(here[0]), int(here[GROUP])
    a, b = (x - grid.x0) / grid.spacing - j, (y - grid.y0) / grid.spacing - i
    for k in range(8):
        if np.isnan(override[lane, k]):
            low = (1.0 - a) * grid.soil[i, j, k] + a * grid.soil[i, j + 1, k]
            high = (1.0 - a) * grid.soil[i + 1, j, k] + a * grid.soil[i + 1, j + 1, k]
            wheel[(SOIL + k) * GROUP + lane] = (1.0 - b) * low + b * high


def build_terrain(
    name: str,
    x0_m: float,
    y0_m: float,
    spacing_m: float,
    height_m: npt.ArrayLike,
    soil: Soil,
    *,
    synthetic: bool = False,
    crs: str = "",
) -> Terrain:
    """A terrain with the same soil everywhere; arguments as in `Terrain`."""
    return Terrain(
        name=name,
        x0_m=x0_m,
        y0_m=y0_m,
        spacing_m=spacing_m,
        height_m=np.array(height_m, dtype=np.float64),
        soil=np.array(soil.vector()).reshape(1, 1, 8),
        synthetic=synthetic,
        crs=crs,
    )


def soil_override(values: dict[str, float]) -> FloatArray:
    """Soil vector with the given parameters in SI units, and those of `ROLLING`, NaN elsewhere. (12,)"""
    override = np.full(len(OVERRIDES), np.nan)
    for name, value in values.items():
        override[_column(name)] = _in_si(name, np.asarray(value, dtype=float))
    return override


def soil_overrides(parameters: Mapping[str, npt.ArrayLike], count: int) -> FloatArray:
    """`soil_override` of several members at once, from one value of each parameter for each. (count, 12)"""
    override = np.full((count, len(OVERRIDES)), np.nan)
    for name, values in parameters.items():
        override[:, _column(name)] = _in_si(name, np.asarray(values, dtype=float))
    return override


def _column(name: str) -> int:
    if name not in OVERRIDES:
        raise ParameterError(f"'{name}' is not a soil parameter; {one_of(name, OVERRIDES)}")
    return OVERRIDES[name]


def _in_si(name: str, values: FloatArray) -> FloatArray:
    """Values of a soil parameter as `Soil.vector()` has them. Raises ParameterError for one outside of its range."""
    # The allowed ranges are intervals: where both extremes are inside, so are all nodes.
    anything = Soil(**dict.fromkeys(SOIL_COLUMNS, 1.0))
    for extreme in (values.min(), values.max()):
        if not math.isfinite(extreme):
            raise ParameterError(f"soil {name} has a value that is not finite")
        if name in SOIL_COLUMNS:
            anything.replace(**{name: float(extreme)})
    return _to_si(name, values)


def _to_si(name: str, values: FloatArray) -> FloatArray:
    return np.tan(np.radians(values)) if name.endswith("_deg") else values * _factor(name)


def from_si(name: str, values: FloatArray) -> FloatArray:
    """A soil parameter of `Soil.vector()` in the unit of its name."""
    return np.degrees(np.arctan(values)) if name.endswith("_deg") else values / _factor(name)


def _factor(name: str) -> float:
    """SI units in the unit of a parameter's name, but that of an angle."""
    return 1e3 if "_kpa" in name else 1e-3 if name.endswith("_mm") else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class TerrainFile:
    """What a terrain file says.

    Attributes
    ----------
    terrain : with a soil everywhere.
    carries : soil parameters that the file itself has; the others are of the soil that was laid under them.
    made_for : the rover in whose sight it was written, where the file says so.
    crs_of_file : the coordinate system that the file has, which is not that of the terrain where it was reprojected.
    read_as : how the file was read, where there was a choice.
    beside : files beside it that were read.
    errors : what an elevation model says of its errors, by layer; empty for other terrains. (ny, nx), or () for one
        number
    """

    terrain: Terrain
    carries: tuple[str, ...] = ()
    made_for: MadeFor | None = None
    errors: Mapping[str, FloatArray] = field(default_factory=dict)
    crs_of_file: str = ""
    read_as: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()

    @property
    def hashes_beside(self) -> dict[str, str]:
        """SHA-256 of the files that were read beside it, by name. Raises DataError."""
        return {name: read_input(name).sha256 for name in self.beside}

    @property
    def states_errors(self) -> bool:
        """Whether it says how far its heights may be off."""
        return "height_m_sigma" in self.errors

    def likely(self, terrain: Terrain, footprint_m: float = 0.0) -> Terrain:
        """A terrain with these heights as they are likely to be, and with what is not known of them.

        `footprint_m` is the width over which a wheel takes their mean. Unchanged where the file states no errors.
        """
        if not self.states_errors:
            return terrain
        layers = [self.errors.get(name, 0.0) for name in ("height_m_sigma", "resolution_m", "height_m_common_sigma")]
        whole = [np.array(np.broadcast_to(layer, terrain.height_m.shape), dtype=float) for layer in layers]
        height, errors = likely_ground(terrain.height_m, terrain.spacing_m, whole[0], whole[1], whole[2], footprint_m)
        return replace(terrain, height_m=height, errors=errors, ground=terrain.written)


def read_terrain(path: str | Path, soil: Soil, *, onto: str = "") -> Terrain:
    """The terrain of `read_terrain_file`."""
    return read_terrain_file(path, soil, onto=onto).terrain


def read_terrain_file(path: str | Path, soil: Soil, height_unit: str | None = None, *, onto: str = "") -> TerrainFile:
    """Read a terrain, by the ending of its file.

    As `heights.grids.read_grid` says; layers are the fields of `Soil` under their own names and units, and the errors
    of an elevation model. `made_for` is the JSON of a rover. Layers `PARAMETER_left_of_prior` of a soil map may be
    there, and are not read. A raster is brought onto the coordinate system `onto`, where one is given.

    Heights stand for the centres of cells. Parameters the file lacks come from `soil`. Raises DataError.
    """
    unread = tuple(f"{name}{LEFT_OF_PRIOR}" for name in SOIL_COLUMNS)
    grid = read_grid(path, (*SOIL_COLUMNS, *ERROR_LAYERS), unread, unit=height_unit, onto=onto)
    with within_file(str(path), TypeError, ValueError, MemoryError):
        read = _read_terrain(grid, soil)
    check_relief(path, read.terrain.height_m, grid.spacing_m)
    return read


def _read_terrain(grid: HeightGrid, soil: Soil) -> TerrainFile:
    projection_or_none(grid.crs)
    place = (grid.name, grid.x0_m, grid.y0_m, grid.spacing_m)
    terrain = build_terrain(*place, grid.height_m, soil, synthetic=grid.synthetic, crs=grid.crs)
    maker = None if grid.made_for is None else MadeFor.from_table(json_document(grid.made_for))
    soils = {name: values for name, values in grid.layers.items() if name in SOIL_COLUMNS}
    errors = {name: _checked(name, values, grid) for name, values in grid.layers.items() if name not in soils}
    origin = (grid.crs_of_file, grid.read_as, grid.beside)
    return TerrainFile(terrain.with_soil(**soils), tuple(soils), maker, errors, *origin)


def _checked(name: str, values: npt.NDArray[Any], grid: HeightGrid) -> FloatArray:
    """A layer of errors: (ny, nx), or () where one number stands for all nodes. Raises DataError."""
    layer = np.asarray(values, dtype=float)
    if layer.shape not in (grid.height_m.shape, ()):
        raise DataError(f"{name} has shape {layer.shape}; give one number, or {grid.height_m.shape}")
    if name != "height_by_disparity_m_px" and (layer[np.isfinite(layer)] < 0).any():
        raise DataError(f"{name} is negative somewhere; give 0 or more, NaN where unknown")
    return layer


def terrain_bytes(
    terrain: Terrain,
    *,
    sd_ratio: Mapping[str, FloatArray] | None = None,
    made_for: MadeFor | None = None,
    errors: Mapping[str, FloatArray] | None = None,
) -> bytes:
    """A terrain as the NumPy archive that `read_terrain` reads; `made_for` names the rover that it was looked at for.

    `sd_ratio` (ny, nx) of each parameter, of a soil map, goes to layers `PARAMETER_left_of_prior`, for people; `errors`
    are the layers of `TerrainFile`.
    """
    shape = terrain.height_m.shape if terrain.soil.shape[0] > 1 else ()
    layers = {name: from_si(name, terrain.soil[..., k]).reshape(shape) for name, k in SOIL_COLUMNS.items()}
    content: dict[str, Any] = {
        "x_m": terrain.x_m,
        "y_m": terrain.y_m,
        "height_m": terrain.height_m,
        "name": np.array(terrain.name),
        "synthetic": np.array(terrain.synthetic),
        **({"crs": np.array(terrain.crs)} if terrain.crs else {}),
        **({} if made_for is None else {"made_for": np.array(made_for.to_json())}),
        **layers,
        **{name: values.astype(np.float32) for name, values in (errors or {}).items()},
        **{f"{name}{LEFT_OF_PRIOR}": values.astype(np.float32) for name, values in (sd_ratio or {}).items()},
    }
    archive = io.BytesIO()
    np.savez_compressed(archive, **content)
    return archive.getvalue()
