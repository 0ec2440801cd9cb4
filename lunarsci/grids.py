"""Grids of heights as files: NumPy archives, GeoTIFF, ESRI ASCII grids, and tables with a row for each node.

Soil and errors are layers beside the heights, under their own names.
"""

import math
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.inputs import read_input, text, unheard
from lunarsci.names import one_of
from lunarsci.printable import shortened
from lunarsci.projections import NO_RASTERIO, check_scale, ellipsoid_of, remedy
from lunarsci.tables import numbers_of, read_csv_table

HEADER = ("ncols", "nrows", "cellsize", "nodata_value", "xllcorner", "yllcorner", "xllcenter", "yllcenter")
HIGHEST_M = 2e4
"""No height is farther from the median: the Moon's span 19.9 km (Smith et al. 2017, Icarus 283, 70,
10.1016/j.icarus.2016.06.006)."""
MOST_NODES = 40_000_000
"""More are refused: maps of these take 1.8 GB."""
MOST_BLOCK_BYTES = 8 * MOST_NODES
"""Of a raster's blocks, each of which is unpacked whole."""
STEEPEST_DEG = 45.0
"""Median slope; loose lunar soil rests at 35 to 40 deg at most, the walls of craters included. Assumed. [deg]"""
LONE_STEP = 10.0
"""From a node to both neighbours of its row or column, on the same side: a slope of 84 deg up and down. Assumed.
[spacings]"""
LARGEST_STEP = 100.0
"""From a node to a neighbour; walls may be steep, but not so high. Assumed. [spacings]"""
_SLOPES_OF = 1_000_000
"""Nodes at most that the median slope is taken of."""
EVEN = 1e-4
"""How evenly nodes must be spaced, as a share of the spacing; assumed."""
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
        grid = readers.get(file.suffix.lower(), _read_archive)(file, tuple(layers), tuple(unread))
        _check_heights(str(path), grid.height_m)
        return grid
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except (TypeError, ValueError, MemoryError) as error:
        raise DataError(f"{path}: {error}") from error


def _check_heights(path: str, height_m: FloatArray) -> None:
    known = height_m[np.isfinite(height_m)]
    off = np.abs(known - np.median(known)) if known.size else known
    if off.size and off.max() > HIGHEST_M:
        wrong = known[int(off.argmax())]
        raise DataError(
            f"{path}: a height of {wrong:g} m, {off.max() / 1e3:.0f} km from the median; the whole Moon spans 20 km; "
            "name the value that stands for no data (NODATA_value, nodata), or give heights in m"
        )


def check_relief(path: str | Path, height_m: FloatArray, spacing_m: float) -> None:
    """Heights that are likely in another unit, or none: DataError where more than half of the ground is steeper than
    any that is loose, a warning where nodes lie far off their neighbours."""
    skip = 1 + height_m.size // _SLOPES_OF
    rows = height_m[:-1:skip]
    along, across = np.diff(rows, axis=1), (height_m[1::skip] - rows)[:, :-1]
    slope = np.degrees(np.arctan(np.hypot(along, across) / spacing_m))
    known = slope[np.isfinite(slope)]
    if known.size and np.median(known) > STEEPEST_DEG:
        raise DataError(
            f"{path}: a median slope of {np.median(known):.0f} deg at a spacing of {spacing_m:g} m, "
            "steeper than soil can lie; are heights in another unit?"
        )
    if steep := steep_nodes(height_m, spacing_m):
        warnings.warn(
            f"{path}: nodes {LONE_STEP:g} spacings and more off both neighbours, or {LARGEST_STEP:g} off one: {steep}; "
            "are they without data, or in another unit?",
            LunarSciWarning,
            stacklevel=3,
        )


def steep_nodes(height_m: FloatArray, spacing_m: float) -> int:
    """How many nodes lie `LONE_STEP` off both neighbours of a row or column, or `LARGEST_STEP` off one. [-]"""
    steep = np.zeros(height_m.shape, dtype=bool)
    for heights, found in ((height_m, steep), (height_m.T, steep.T)):
        step = np.diff(heights, axis=0) / spacing_m
        with np.errstate(invalid="ignore"):
            far, beyond = np.abs(step) > LONE_STEP, np.abs(step) > LARGEST_STEP
            found[1:-1] |= far[:-1] & far[1:] & (step[:-1] * step[1:] < 0)
        found[:-1] |= beyond
        found[1:] |= beyond
    return int(steep.sum())


def _check_count(path: Path, nodes: int) -> None:
    if nodes > MOST_NODES:
        raise DataError(
            f"{path}: {nodes / 1e6:,.0f} million nodes, and at most {MOST_NODES / 1e6:.0f} million are read; cut out "
            "the part around the drive, or take wider nodes"
        )


def _read_archive(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    known = {"x_m", "y_m", "height_m", "name", "synthetic", "made_for", "crs", *layers}
    arrays = _load(path, known, unread)
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
        with unheard(), rasterio.open(path, driver="GTiff") as raster:
            _check_count(path, raster.width * raster.height)
            check_blocks(raster, str(path))
            transform, crs = raster.transform, raster.crs
            numbers = {1: "height_m"} | {
                k: str(text) for k, text in enumerate(raster.descriptions, start=1) if k > 1 and text in layers
            }
            found = {name: _band(raster, k) for k, name in numbers.items()}
            synthetic = raster.tags().get("SYNTHETIC", "").lower() in ("true", "1", "yes")
    except (RasterioIOError, UnicodeDecodeError) as error:
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


def check_blocks(raster: Any, path: str) -> None:
    """Raise DataError where blocks of a raster of GDAL, which are unpacked whole, are too large."""
    for (lines, samples), kind in zip(raster.block_shapes, raster.dtypes, strict=True):
        if lines * samples * np.dtype(kind).itemsize > MOST_BLOCK_BYTES:
            raise DataError(
                f"{path}: is packed in blocks of {lines} x {samples}, too large to be read; write it anew in tiles "
                "(gdal_translate -co TILED=YES)"
            )


def _band(raster: Any, number: int) -> FloatArray:
    """A band in its unit, NaN where it has no data. (ny, nx)"""
    values = raster.read(number, masked=True).astype(float).filled(np.nan)
    scale, offset = raster.scales[number - 1], raster.offsets[number - 1]
    return np.asarray(values if (scale, offset) == (1.0, 0.0) else scale * values + offset)


def _read_ascii(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    lines = text(read_input(path)).splitlines()
    header: dict[str, float] = {}
    while lines and len(words := lines[0].split()) == 2 and (name := words[0].lower()) in HEADER:
        if name in header:
            raise DataError(f"{path}: {name} is there twice; keep the right one")
        header[name] = float(words[1])
        lines.pop(0)
    shape = _checked_header(path, header)
    heights = np.array(" ".join(lines).split(), dtype=np.float64)
    if heights.size != shape[0] * shape[1]:
        raise DataError(f"{path}: {heights.size} heights, {shape[0]} rows of {shape[1]} announced; is it cut short?")
    heights[heights == header.get("nodata_value", -9999.0)] = np.nan
    half = 0.5 * header["cellsize"]
    x0, y0 = (header.get(f"{axis}llcenter", header.get(f"{axis}llcorner", 0.0) + half) for axis in "xy")
    height = heights.reshape(shape)[::-1]
    return HeightGrid(name=path.stem, x0_m=x0, y0_m=y0, spacing_m=header["cellsize"], height_m=height)


def _checked_header(path: Path, header: Mapping[str, float]) -> tuple[int, int]:
    """Rows and columns that the header of an ESRI ASCII grid announces, when nothing in it contradicts itself."""
    for name in ("ncols", "nrows", "cellsize"):
        if name not in header:
            raise DataError(
                f"{path}: no {name}; an ESRI ASCII grid begins with ncols, nrows, xllcorner, yllcorner, cellsize"
            )
    if not all(header[name] >= 1 and header[name].is_integer() for name in ("ncols", "nrows")):
        raise DataError(f"{path}: ncols {header['ncols']:g}, nrows {header['nrows']:g}; give counts of 1 or more")
    if not 0 < header["cellsize"] < math.inf:
        raise DataError(f"{path}: a cellsize of {header['cellsize']:g}; give the side of a cell in m")
    given = {name for name in header if name[1:3] == "ll"}
    if given - {"xllcorner", "yllcorner"} and given - {"xllcenter", "yllcenter"}:
        raise DataError(f"{path}: {' and '.join(sorted(given))}; name the corner of the first cell, or its centre")
    _check_count(path, int(header["nrows"] * header["ncols"]))
    return int(header["nrows"]), int(header["ncols"])


def _read_table(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    import pandas as pd

    table = read_csv_table(path)
    table = table[[name for name in table if name in layers or name not in unread]]
    known = ("x_m", "y_m", "height_m", *layers)
    for name in known[:3]:
        if name not in table:
            raise DataError(f"{path}: no column {name}; a terrain needs x_m, y_m and height_m")
    if unknown := {str(name) for name in table} - set(known):
        raise DataError(f"{path}: '{min(unknown)}' is no column of a terrain; {one_of(min(unknown), known)}")
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


def _load(path: Path, known: set[str], unread: tuple[str, ...]) -> dict[str, Any]:
    """The arrays of an archive, none of which is unpacked before its name and its size are known to be sound."""
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise DataError(f"{path}: a single array, not a NumPy archive; write it with numpy.savez")
        with archive:
            if unknown := {*archive.files} - known - {*unread}:
                wrong = shortened(min(unknown))
                raise DataError(f"{path}: '{wrong}' is not a key of a terrain; {one_of(wrong, sorted(known))}")
            for entry in archive.zip.infolist() if archive.zip else ():
                _check_count(path, entry.file_size // 8)
            arrays = {key: archive[key] for key in archive.files if key in known}
        if wrong := next((key for key, array in arrays.items() if np.iscomplexobj(array)), ""):
            raise DataError(f"{path}: {wrong} has complex numbers; write real ones")
        return arrays
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or 'not a NumPy archive; write it with numpy.savez'}") from error
    except Exception as error:  # whatever NumPy raises of a damaged archive: each part of it has its own
        raise DataError(f"{path}: not a NumPy archive that can be read; write it with numpy.savez") from error


def _spacing(x: FloatArray, y: FloatArray) -> float:
    if x.ndim != 1 or y.ndim != 1 or min(x.size, y.size) < 3:
        raise ValueError("x_m and y_m must be lists of at least 3 numbers")
    steps = []
    for name, axis in (("x_m", x), ("y_m", y)):
        step = float(axis[-1] - axis[0]) / (axis.size - 1)
        if not (step > 0 and np.allclose(np.diff(axis), step, rtol=0, atol=1e-4 * step)):
            raise ValueError(f"{name} must ascend in even steps; sort it, or interpolate the heights to even ones")
        steps.append(step)
    if abs(steps[1] - steps[0]) > 1e-4 * steps[0]:
        told = f"cells must be square: steps are {steps[0]:g} m in x_m and {steps[1]:g} m in y_m"
        raise ValueError(f"{told}; interpolate the heights to nodes {max(steps):g} m apart in both")
    return steps[0]
