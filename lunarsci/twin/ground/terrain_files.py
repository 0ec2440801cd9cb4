"""Terrain files: NumPy archives, GeoTIFF, ESRI ASCII grids, and tables with a row for each node.

Maps of a terrain as files: a NumPy archive, and a GeoTIFF with a band for each map.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, OutputError
from lunarsci.heights.grid import ERROR_LAYERS, HeightGrid
from lunarsci.heights.grids import check_relief, geotiff_bytes, read_grid
from lunarsci.heights.projections import projection_or_none
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import read_input
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.ground.height_errors import likely_ground
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, build_terrain, from_si


def _layers(surface: Traversability) -> dict[str, npt.NDArray[np.float32]]:
    maps = surface.maps
    return {
        "slope_deg": maps.slope_deg,
        "roughness_m": maps.roughness_m,
        "step_m": maps.step_m,
        "demand": surface.demand,
        **({} if surface.sunlit is None else {"sunlit": surface.sunlit.astype(np.float32)}),
    }


def maps_bytes(surface: Traversability) -> bytes:
    """NumPy archive: x_m (nx,), y_m (ny,), and slope_deg, roughness_m, step_m, demand (ny, nx), NaN where unknown.

    `sunlit` is 1 where the Sun reaches the ground, where its direction is given; `crs` the coordinate system as
    well-known text, where the terrain has one.
    """
    archive = io.BytesIO()
    terrain = surface.terrain
    place = {"x_m": terrain.x_m, "y_m": terrain.y_m} | ({"crs": np.array(terrain.crs)} if terrain.crs else {})
    np.savez_compressed(archive, **place, **_layers(surface))  # type: ignore[arg-type]
    return archive.getvalue()


def maps_geotiff(surface: Traversability) -> bytes:
    """GeoTIFF with the bands slope_deg, roughness_m, step_m and demand, in the coordinate system of the terrain.

    Raises ParameterError without rasterio.
    """
    terrain = surface.terrain
    return geotiff_bytes(_layers(surface), (terrain.x0_m, terrain.y0_m, terrain.spacing_m), crs=terrain.crs)


LEFT = "_left_of_prior"


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
    errors : what an elevation model says of its errors, by layer; empty for other terrains. (ny, nx)
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
    unread = tuple(f"{name}{LEFT}" for name in SOIL_COLUMNS)
    grid = read_grid(path, (*SOIL_COLUMNS, *ERROR_LAYERS), unread, unit=height_unit, onto=onto)
    try:
        read = _read_terrain(grid, soil)
    except (TypeError, ValueError, MemoryError) as error:
        raise DataError(f"{path}: {error}") from error
    check_relief(path, read.terrain.height_m, grid.spacing_m)
    return read


def _read_terrain(grid: HeightGrid, soil: Soil) -> TerrainFile:
    projection_or_none(grid.crs)
    place = (grid.name, grid.x0_m, grid.y0_m, grid.spacing_m)
    terrain = build_terrain(*place, grid.height_m, soil, synthetic=grid.synthetic, crs=grid.crs)
    maker = None if grid.made_for is None else MadeFor.from_table(json_document(grid.made_for))
    soils = {name: values for name, values in grid.layers.items() if name in SOIL_COLUMNS}
    errors = {name: _checked(name, values, grid) for name, values in grid.layers.items() if name not in soils}
    said = (grid.crs_of_file, grid.read_as, grid.beside)
    return TerrainFile(terrain.with_soil(**soils), tuple(soils), maker, errors, *said)


def _checked(name: str, values: npt.NDArray[Any], grid: HeightGrid) -> FloatArray:
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
        **{f"{name}{LEFT}": values.astype(np.float32) for name, values in (sd_ratio or {}).items()},
    }
    archive = io.BytesIO()
    np.savez_compressed(archive, **content)
    return archive.getvalue()


def write_terrain(terrain: Terrain, path: str | Path) -> None:
    """Write a terrain as `read_terrain` reads it. Raises OutputError."""
    try:
        Path(path).write_bytes(terrain_bytes(terrain))
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror}") from error
