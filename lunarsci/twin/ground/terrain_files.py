"""Terrain files: NumPy archives, GeoTIFF, ESRI ASCII grids, and tables with a row for each node.

Maps of a terrain as files: a NumPy archive, and a GeoTIFF with a band for each map.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, OutputError, ParameterError
from lunarsci.regolith.soil import Soil
from lunarsci.rovers import MadeFor
from lunarsci.tables import numbers_of, read_csv_table
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
    try:
        from rasterio.io import MemoryFile
        from rasterio.transform import from_origin
    except ImportError as error:
        raise ParameterError("GeoTIFF needs rasterio; pip install 'lunarsci[cubes]'") from error
    terrain, layers = surface.terrain, _layers(surface)
    half, (ny, nx) = 0.5 * terrain.spacing_m, terrain.height_m.shape
    west, north = terrain.x0_m - half, float(terrain.y_m[-1]) + half
    shape = {"driver": "GTiff", "count": len(layers), "dtype": "float32", "height": ny, "width": nx}
    place = {"transform": from_origin(west, north, terrain.spacing_m, terrain.spacing_m), "nodata": np.nan}
    with MemoryFile() as memory:
        with memory.open(**shape, **place, compress="deflate") as raster:
            for band, (name, values) in enumerate(layers.items(), start=1):
                raster.write(values[::-1], band)
                raster.set_band_description(band, name)
        content: bytes = memory.read()
    return content


HEADER = ("ncols", "nrows", "cellsize", "nodata_value", "xllcorner", "yllcorner", "xllcenter", "yllcenter")
LEFT = "_left_of_prior"
EVEN = 1e-4
"""How evenly nodes must be spaced, as a share of the spacing."""


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

    * `.npz`, NumPy archive: `x_m` (nx,) and `y_m` (ny,), ascending and evenly spaced with one spacing; `height_m`
      (ny, nx) with NaN where unknown; optionally any field of `Soil` under its own name and unit, a number or (ny, nx);
      optionally `name` and `synthetic`, and `made_for`, the JSON of a rover. Layers `PARAMETER_left_of_prior` of a soil
      map may be there, and are not read.
    * `.tif`, `.tiff`, GeoTIFF: first band, heights in m on square cells of a projection in m; needs the extra `cubes`.
    * `.asc`, ESRI ASCII grid, heights and cells in m.
    * `.csv`, a row for each node: `x_m`, `y_m`, `height_m`, and optionally fields of `Soil`; nodes that are not in the
      table are holes.

    Heights stand for the centres of cells. Parameters the file lacks come from `soil`. Raises DataError.
    """
    file = Path(path)
    readers = {".tif": _read_geotiff, ".tiff": _read_geotiff, ".asc": _read_ascii, ".csv": _read_table}
    try:
        return readers.get(file.suffix.lower(), _read_archive)(file, soil)
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except (TypeError, ValueError, MemoryError) as error:
        raise DataError(f"{path}: {error}") from error


def _read_archive(path: Path, soil: Soil) -> TerrainFile:
    arrays = _load(path)
    known = {"x_m", "y_m", "height_m", "name", "synthetic", "made_for", *SOIL_COLUMNS}
    arrays = {key: array for key, array in arrays.items() if key.removesuffix(LEFT) not in SOIL_COLUMNS or key in known}
    if unknown := set(arrays) - known:
        raise DataError(f"{path}: '{min(unknown)}' is not a key of a terrain; these are: {', '.join(sorted(known))}")
    for key in ("x_m", "y_m", "height_m"):
        if key not in arrays:
            raise DataError(f"{path}: no '{key}'; a terrain needs x_m, y_m and height_m")
    try:
        x, y, height = (np.asarray(arrays[key], dtype=np.float64) for key in ("x_m", "y_m", "height_m"))
        if height.shape != (y.size, x.size):
            raise DataError(f"height_m has shape {height.shape}; y_m and x_m say {(y.size, x.size)}")
        spacing = _spacing(x, y)
        name = str(arrays.get("name", path.stem))
        synthetic = bool(arrays.get("synthetic", False))
        terrain = build_terrain(name, float(x[0]), float(y[0]), spacing, height, soil, synthetic=synthetic)
        carried = {key: arrays[key] for key in SOIL_COLUMNS if key in arrays}
        maker = MadeFor.from_table(json.loads(str(arrays["made_for"]))) if "made_for" in arrays else None
        return TerrainFile(terrain.with_soil(**carried), tuple(carried), maker)
    except (TypeError, ValueError) as error:
        raise DataError(f"{path}: {error}") from error


def _read_geotiff(path: Path, soil: Soil) -> TerrainFile:
    try:
        import rasterio
        from rasterio.errors import RasterioIOError
    except ImportError as error:
        raise DataError(f"{path}: GeoTIFF needs rasterio; pip install 'lunarsci[cubes]'") from error
    try:
        with rasterio.open(path) as raster:
            transform, crs = raster.transform, raster.crs
            height = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
    except RasterioIOError as error:
        raise DataError(f"{path}: not a GeoTIFF that can be read: {error}") from error
    if crs is not None and crs.is_geographic:
        raise DataError(
            f"{path}: heights on degrees of longitude and latitude; project it to m, with gdalwarp for example"
        )
    if crs is not None and crs.linear_units_factor[1] != 1.0:
        raise DataError(f"{path}: its projection counts in {crs.linear_units_factor[0]}; project it to m")
    if transform.b != 0 or transform.d != 0 or not transform.a > 0:
        raise DataError(f"{path}: rotated; warp it so that columns point along x")
    if not np.isclose(transform.a, abs(transform.e), rtol=EVEN):
        raise DataError(f"{path}: cells of {transform.a:g} x {abs(transform.e):g} m; resample them to squares")
    y0 = transform.f + 0.5 * transform.e
    if transform.e < 0:
        height, y0 = height[::-1], y0 + transform.e * (len(height) - 1)
    x0 = transform.c + 0.5 * transform.a
    return TerrainFile(build_terrain(path.stem, x0, y0, float(transform.a), height, soil))


def _read_ascii(path: Path, soil: Soil) -> TerrainFile:
    with path.open("r", encoding="utf-8", errors="strict") as file:
        header: dict[str, float] = {}
        position = file.tell()
        while len(words := file.readline().split()) == 2 and words[0].lower() in HEADER:
            header[words[0].lower()] = float(words[1])
            position = file.tell()
        file.seek(position)
        for name in ("ncols", "nrows", "cellsize"):
            if name not in header:
                raise DataError(
                    f"{path}: no {name}; an ESRI ASCII grid begins with ncols, nrows, xllcorner, yllcorner, cellsize"
                )
        heights = np.array(file.read().split(), dtype=np.float64)
    if not all(1 <= header[name] < np.inf for name in ("ncols", "nrows")):
        raise DataError(f"{path}: ncols {header['ncols']:g}, nrows {header['nrows']:g}; give counts of 1 or more")
    shape = int(header["nrows"]), int(header["ncols"])
    if heights.size != shape[0] * shape[1]:
        raise DataError(f"{path}: {heights.size} heights, {shape[0]} rows of {shape[1]} announced; is it cut short?")
    heights[heights == header.get("nodata_value", -9999.0)] = np.nan
    half = 0.5 * header["cellsize"]
    x0, y0 = (header.get(f"{axis}llcenter", header.get(f"{axis}llcorner", 0.0) + half) for axis in "xy")
    return TerrainFile(build_terrain(path.stem, x0, y0, header["cellsize"], heights.reshape(shape)[::-1], soil))


def _read_table(path: Path, soil: Soil) -> TerrainFile:
    import pandas as pd

    table = read_csv_table(path)
    known = ("x_m", "y_m", "height_m", *SOIL_COLUMNS)
    for name in known[:3]:
        if name not in table:
            raise DataError(f"{path}: no column {name}; a terrain needs x_m, y_m and height_m")
    if unknown := {str(name) for name in table} - set(known):
        raise DataError(f"{path}: '{min(unknown)}' is no column of a terrain; these are: {', '.join(known)}")
    values = pd.DataFrame({name: numbers_of(str(path), str(name), cells) for name, cells in table.items()})
    if np.isnan(values[["x_m", "y_m"]]).any(axis=None):
        row = int(np.argmax(values[["x_m", "y_m"]].isna().any(axis=1)))
        raise DataError(f"{path}, row {row + 1}: x_m or y_m is missing; leave the row out or fill it in")
    x, y = (np.unique(values[name].to_numpy(np.float64)) for name in ("x_m", "y_m"))
    spacing = _spacing(x, y)
    column, row = (np.rint((values[name] - axis[0]) / spacing).astype(int) for name, axis in (("x_m", x), ("y_m", y)))
    if pd.DataFrame({"row": row, "column": column}).duplicated().any():
        raise DataError(f"{path}: a node has two rows; keep one of each x_m, y_m")
    layers = {}
    for name in (name for name in known[2:] if name in values):
        layers[name] = np.full((y.size, x.size), np.nan if name == "height_m" else values[name].median())
        layers[name][row, column] = values[name]
    height = layers.pop("height_m")
    terrain = build_terrain(path.stem, float(x[0]), float(y[0]), spacing, height, soil).with_soil(**layers)
    return TerrainFile(terrain, tuple(layers))


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


def _load(path: Path) -> dict[str, Any]:
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise DataError(f"{path}: a single array, not a NumPy archive; write it with numpy.savez")
        with archive:
            return {key: archive[key] for key in archive.files}
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or 'not a NumPy archive; write it with numpy.savez'}") from error
    except (
        AttributeError, EOFError, MemoryError, NotImplementedError, SyntaxError, ValueError, zipfile.BadZipFile,
        zlib.error,
    ) as error:  # fmt: skip
        raise DataError(f"{path}: not a NumPy archive that can be read; write it with numpy.savez") from error


def _spacing(x: FloatArray, y: FloatArray) -> float:
    if x.ndim != 1 or y.ndim != 1 or min(x.size, y.size) < 3:
        raise ValueError("x_m and y_m must be lists of at least 3 numbers")
    spacing = float(x[-1] - x[0]) / (x.size - 1)
    for name, axis in (("x_m", x), ("y_m", y)):
        if not (spacing > 0 and np.allclose(np.diff(axis), spacing, rtol=0, atol=1e-4 * spacing)):
            raise ValueError(f"{name} must ascend in even steps, the same in x and y ({spacing:g} m from x_m)")
    return spacing
