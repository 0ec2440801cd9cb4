"""Grids of heights as files: NumPy archives, GeoTIFF, ESRI ASCII grids, and tables with a row for each node.

Soil and errors are layers beside the heights, under their own names.
"""

import math
import zipfile
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.projections import NO_RASTERIO, check_scale, ellipsoid_of, remedy
from lunarsci.tables import numbers_of, read_csv_table

HEADER = ("ncols", "nrows", "cellsize", "nodata_value", "xllcorner", "yllcorner", "xllcenter", "yllcenter")
EVEN = 1e-4
"""How evenly nodes must be spaced, as a share of the spacing."""
ERROR_LAYERS = ("height_m_sigma", "height_m_common_sigma", "count", "height_by_disparity_m_px", "resolution_m")
"""What an elevation model made of pictures has beside its heights."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightGrid:
    """What a file of heights says.

    Attributes
    ----------
    name : what the ground is.
    x0_m, y0_m, spacing_m : position of node [0, 0] and distance of the nodes. [m]
    height_m : NaN where unknown; row is y, column is x. (ny, nx) [m]
    layers : further numbers, one or one for each node, by name.
    synthetic : True for made-up ground.
    made_for : what else the file says, None where it says nothing.
    crs : the coordinate system of x and y as well-known text; empty where none is named.
    """

    name: str
    x0_m: float
    y0_m: float
    spacing_m: float
    height_m: FloatArray
    layers: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    synthetic: bool = False
    made_for: str | None = None
    crs: str = ""


def read_grid(path: str | Path, layers: Collection[str] = (), unread: Collection[str] = ERROR_LAYERS) -> HeightGrid:
    """Read a grid, by the ending of its file.

    * `.npz`, NumPy archive: `x_m` (nx,) and `y_m` (ny,), ascending and evenly spaced with one spacing; `height_m`
      (ny, nx) with NaN where unknown; optionally `layers`, a number or (ny, nx), `name`, `synthetic`, `made_for` and
      `crs`.
    * `.tif`, `.tiff`, GeoTIFF: first band, heights in m on square cells of a projection in m whose metres are within
      2 % of those on the ground, and bands whose description is one of `layers`; scale, offset and nodata of a band are
      applied; needs the extra `cubes`.
    * `.asc`, ESRI ASCII grid, heights and cells in m.
    * `.csv`, a row for each node: `x_m`, `y_m`, `height_m`, and optionally `layers`; nodes that are not in the table
      are holes.

    Names in `unread` may be there, and are left. Heights stand for the centres of cells. Raises DataError.
    """
    file = Path(path)
    readers = {".tif": _read_geotiff, ".tiff": _read_geotiff, ".asc": _read_ascii, ".csv": _read_table}
    try:
        return readers.get(file.suffix.lower(), _read_archive)(file, tuple(layers), tuple(unread))
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except (TypeError, ValueError, MemoryError) as error:
        raise DataError(f"{path}: {error}") from error


def _read_archive(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    arrays = _load(path)
    known = {"x_m", "y_m", "height_m", "name", "synthetic", "made_for", "crs", *layers}
    arrays = {key: array for key, array in arrays.items() if key in known or key not in unread}
    if unknown := set(arrays) - known:
        raise DataError(f"{path}: '{min(unknown)}' is not a key of a terrain; these are: {', '.join(sorted(known))}")
    for key in ("x_m", "y_m", "height_m"):
        if key not in arrays:
            raise DataError(f"{path}: no '{key}'; a terrain needs x_m, y_m and height_m")
    x, y, height = (np.asarray(arrays[key], dtype=np.float64) for key in ("x_m", "y_m", "height_m"))
    if height.shape != (y.size, x.size):
        raise DataError(f"{path}: height_m has shape {height.shape}; y_m and x_m say {(y.size, x.size)}")
    spacing = _spacing(x, y)
    return HeightGrid(
        name=str(arrays.get("name", path.stem)),
        x0_m=float(x[0]),
        y0_m=float(y[0]),
        spacing_m=spacing,
        height_m=height,
        layers={key: arrays[key] for key in layers if key in arrays},
        synthetic=bool(arrays.get("synthetic", False)),
        made_for=str(arrays["made_for"]) if "made_for" in arrays else None,
        crs=str(arrays.get("crs", "")),
    )


def _read_geotiff(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    try:
        import rasterio
        from rasterio.errors import RasterioIOError
    except ImportError as error:
        raise DataError(f"{path}: {NO_RASTERIO}") from error
    try:
        with rasterio.open(path) as raster:
            transform, crs = raster.transform, raster.crs
            numbers = {1: "height_m"} | {
                k: str(text) for k, text in enumerate(raster.descriptions, start=1) if k > 1 and text in layers
            }
            found = {name: _band(raster, k) for k, name in numbers.items()}
            synthetic = raster.tags().get("SYNTHETIC", "").lower() in ("true", "1", "yes")
    except RasterioIOError as error:
        raise DataError(f"{path}: not a GeoTIFF that can be read: {error}") from error
    wkt = "" if crs is None else crs.to_wkt()
    middle = transform @ (0.5 * found["height_m"].shape[1], 0.5 * found["height_m"].shape[0])
    if crs is not None and crs.is_geographic:
        metres = math.radians(abs(transform.e)) * ellipsoid_of(wkt)[0]
        raise DataError(
            f"{path}: heights on degrees of longitude and latitude; {remedy(wkt, middle[0], middle[1], metres)}"
        )
    if wkt:
        check_scale(wkt, str(path), middle, transform.a)
    if transform.b != 0 or transform.d != 0 or not transform.a > 0:
        raise DataError(f"{path}: rotated; warp it so that columns point along x")
    if not np.isclose(transform.a, abs(transform.e), rtol=EVEN):
        raise DataError(f"{path}: cells of {transform.a:g} x {abs(transform.e):g} m; resample them to squares")
    y0 = transform.f + 0.5 * transform.e
    if transform.e < 0:
        found = {name: values[::-1] for name, values in found.items()}
        y0 += transform.e * (len(found["height_m"]) - 1)
    height = found.pop("height_m")
    return HeightGrid(
        name=path.stem,
        x0_m=transform.c + 0.5 * transform.a,
        y0_m=y0,
        spacing_m=float(transform.a),
        height_m=height,
        layers=found,
        synthetic=synthetic,
        crs=wkt,
    )


def _band(raster: Any, number: int) -> FloatArray:
    """A band in its unit, NaN where it has no data. (ny, nx)"""
    values = raster.read(number, masked=True).astype(float).filled(np.nan)
    scale, offset = raster.scales[number - 1], raster.offsets[number - 1]
    return np.asarray(values if (scale, offset) == (1.0, 0.0) else scale * values + offset)


def _read_ascii(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
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
    height = heights.reshape(shape)[::-1]
    return HeightGrid(name=path.stem, x0_m=x0, y0_m=y0, spacing_m=header["cellsize"], height_m=height)


def _read_table(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    import pandas as pd

    table = read_csv_table(path)
    table = table[[name for name in table if name in layers or name not in unread]]
    known = ("x_m", "y_m", "height_m", *layers)
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
    found = {}
    for name in (name for name in known[2:] if name in values):
        empty = np.nan if name in ("height_m", *ERROR_LAYERS) else values[name].median()
        found[name] = np.full((y.size, x.size), empty)
        found[name][row, column] = values[name]
    height = found.pop("height_m")
    return HeightGrid(
        name=path.stem, x0_m=float(x[0]), y0_m=float(y[0]), spacing_m=spacing, height_m=height, layers=found
    )


def geotiff_bytes(
    layers: Mapping[str, npt.NDArray[Any]],
    place: tuple[float, float, float],
    *,
    synthetic: bool = False,
    crs: str = "",
) -> bytes:
    """GeoTIFF with a band for each layer (ny, nx), its name as description; rows of y from the south.

    `place` is x and y of node [0, 0] and the spacing, `crs` their coordinate system as well-known text, if they have
    one. Raises ParameterError without rasterio.
    """
    try:
        from rasterio.io import MemoryFile
        from rasterio.transform import from_origin
    except ImportError as error:
        raise ParameterError(NO_RASTERIO) from error
    x0, y0, spacing = place
    ny, nx = next(iter(layers.values())).shape
    west, north = x0 - 0.5 * spacing, y0 + spacing * (ny - 1) + 0.5 * spacing
    shape = {"driver": "GTiff", "count": len(layers), "dtype": "float32", "height": ny, "width": nx}
    where = {"transform": from_origin(west, north, spacing, spacing), "nodata": np.nan}
    where |= {"crs": crs} if crs else {}
    with MemoryFile() as memory:
        with memory.open(**shape, **where, compress="deflate") as raster:
            if synthetic:
                raster.update_tags(SYNTHETIC="true")
            for band, (name, values) in enumerate(layers.items(), start=1):
                raster.write(values[::-1].astype(np.float32), band)
                raster.set_band_description(band, name)
        content: bytes = memory.read()
    return content


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
