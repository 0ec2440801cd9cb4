"""Terrain files: NumPy archives, GeoTIFF, ESRI ASCII grids, and tables with a row for each node.

Maps of a terrain as files: a NumPy archive, and a GeoTIFF with a band for each map.
"""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, OutputError
from lunarsci.grids import ERROR_LAYERS, HeightGrid, geotiff_bytes, read_grid
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, build_terrain, from_si


def _layers(surface: Traversability) -> dict[str, npt.NDArray[np.float32]]:
    maps = surface.maps
    return {
        "slope_deg": maps.slope_deg,
        "roughness_m": maps.roughness_m,
        "step_m": maps.step_m,
        "demand": surface.demand,
    }


def maps_bytes(surface: Traversability) -> bytes:
    """NumPy archive: x_m (nx,), y_m (ny,), and slope_deg, roughness_m, step_m, demand (ny, nx), NaN where unknown."""
    archive = io.BytesIO()
    np.savez_compressed(archive, x_m=surface.terrain.x_m, y_m=surface.terrain.y_m, **_layers(surface))  # type: ignore[arg-type]
    return archive.getvalue()


def maps_geotiff(surface: Traversability) -> bytes:
    """GeoTIFF with the bands slope_deg, roughness_m, step_m and demand, in the coordinates of the terrain.

    It names no projection, because a terrain has none. Raises ParameterError without rasterio.
    """
    terrain = surface.terrain
    return geotiff_bytes(_layers(surface), (terrain.x0_m, terrain.y0_m, terrain.spacing_m))


LEFT = "_left_of_prior"


@dataclass(frozen=True, slots=True, eq=False)
class TerrainFile:
    """What a terrain file says.

    Attributes
    ----------
    terrain : with a soil everywhere.
    carries : soil parameters that the file itself has; the others are of the soil that was laid under them.
    made_for : the rover in whose sight it was written, where the file says so.
    """

    terrain: Terrain
    carries: tuple[str, ...] = ()
    made_for: MadeFor | None = None


def read_terrain(path: str | Path, soil: Soil) -> Terrain:
    """The terrain of `read_terrain_file`."""
    return read_terrain_file(path, soil).terrain


def read_terrain_file(path: str | Path, soil: Soil) -> TerrainFile:
    """Read a terrain, by the ending of its file.

    As `lunarsci.grids.read_grid` says; layers are the fields of `Soil` under their own names and units. `made_for` is
    the JSON of a rover. Layers `PARAMETER_left_of_prior` of a soil map and the errors of an elevation model may be
    there, and are not read.

    Heights stand for the centres of cells. Parameters the file lacks come from `soil`. Raises DataError.
    """
    unread = (*ERROR_LAYERS, *(f"{name}{LEFT}" for name in SOIL_COLUMNS))
    grid = read_grid(path, tuple(SOIL_COLUMNS), unread)
    try:
        return _read_terrain(grid, soil)
    except (TypeError, ValueError, MemoryError) as error:
        raise DataError(f"{path}: {error}") from error


def _read_terrain(grid: HeightGrid, soil: Soil) -> TerrainFile:
    place = (grid.name, grid.x0_m, grid.y0_m, grid.spacing_m)
    terrain = build_terrain(*place, grid.height_m, soil, synthetic=grid.synthetic)
    maker = None if grid.made_for is None else MadeFor.from_table(json.loads(grid.made_for))
    return TerrainFile(terrain.with_soil(**grid.layers), tuple(grid.layers), maker)


def terrain_bytes(
    terrain: Terrain, *, sd_ratio: Mapping[str, FloatArray] | None = None, made_for: MadeFor | None = None
) -> bytes:
    """A terrain as the NumPy archive that `read_terrain` reads; `made_for` names the rover that it was looked at for.

    `sd_ratio` (ny, nx) of each parameter, of a soil map, goes to layers `PARAMETER_left_of_prior`, for people.
    """
    shape = terrain.height_m.shape if terrain.soil.shape[0] > 1 else ()
    layers = {name: from_si(name, terrain.soil[..., k]).reshape(shape) for name, k in SOIL_COLUMNS.items()}
    content: dict[str, Any] = {
        "x_m": terrain.x_m,
        "y_m": terrain.y_m,
        "height_m": terrain.height_m,
        "name": np.array(terrain.name),
        "synthetic": np.array(terrain.synthetic),
        **({} if made_for is None else {"made_for": np.array(made_for.to_json())}),
        **layers,
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
