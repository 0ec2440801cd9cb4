"""Grids of heights as files: NumPy archives, GeoTIFF, ESRI ASCII grids, and tables with a row for each node.

Soil and errors are layers beside the heights, under their own names.
"""

import math
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.height_rasters import DRIVERS, EVEN, HEIGHT, HeightRaster, check_count, read_height_raster
from lunarsci.height_units import metres_in
from lunarsci.inputs import read_input, text
from lunarsci.names import one_of
from lunarsci.printable import shortened
from lunarsci.projections import NO_RASTERIO
from lunarsci.tables import numbers_of, read_csv_table

HEADER = ("ncols", "nrows", "cellsize", "dx", "dy", "nodata_value", "xllcorner", "yllcorner", "xllcenter", "yllcenter")
HIGHEST_M = 2e4
"""No height is farther from the median: the Moon's span 19.9 km (Smith et al. 2017, Icarus 283, 70,
10.1016/j.icarus.2016.06.006)."""
STEEPEST_DEG = 45.0
"""Median slope; loose lunar soil rests at 35 to 40 deg at most, the walls of craters included. Assumed. [deg]"""
LONE_STEP = 10.0
"""From a node to both neighbours of its row or column, on the same side: a slope of 84 deg up and down. Assumed.
[spacings]"""
LARGEST_STEP = 100.0
"""From a node to a neighbour; walls may be steep, but not so high. Assumed. [spacings]"""
_SLOPES_OF = 1_000_000
"""Nodes at most that the median slope is taken of."""
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
    crs_of_file : that of the file, which may be another one.
    unit : of the heights, as the file states it; empty where it states none.
    read_as : how the file was read, where there was a choice.
    beside : files beside this one that were read.
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
    crs_of_file: str = ""
    unit: str = "m"
    read_as: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


def read_grid(
    path: str | Path,
    layers: Collection[str] = (),
    unread: Collection[str] = ERROR_LAYERS,
    *,
    unit: str | None = None,
    onto: str = "",
    values: bool = False,
) -> HeightGrid:
    """Read a grid, by the ending of its file.

    * `.npz`, NumPy archive: `x_m` (nx,) and `y_m` (ny,), ascending and evenly spaced with one spacing; `height_m`
      (ny, nx) with NaN where unknown; optionally `layers`, a number or (ny, nx), `name`, `synthetic`, `made_for` and
      `crs`.
    * `.tif`, `.tiff`, GeoTIFF; `.lbl`, `.img`, PDS3; `.xml`, label of PDS4; `.cub`, ISIS: first band, and bands whose
      description is one of `layers`, with scale, offset and nodata; needs the extra `cubes`. What does not lie on
      square cells of metres is brought onto such, see `HeightRaster.in_metres`.
    * `.asc`, ESRI ASCII grid, cells in m.
    * `.csv`, a row for each node: `x_m`, `y_m`, `height_m`, and optionally `layers`; nodes that are not in the table
      are holes.

    Names in `unread` may be there, and are left. Heights stand for the centres of cells. They are in `unit`, one of
    `HeightUnit`, or in that which the file states, or in m; `values` are no heights, and have no unit. Rasters of
    another coordinate system than `onto` are brought onto that. Raises DataError, ParameterError for another `unit`.
    """
    file, end = Path(path), Path(path).suffix.lower()
    asked, how = (file, tuple(layers), tuple(unread)), dict[str, Any](onto=onto, values=values)
    try:
        if end in (".asc", *DRIVERS):
            grid = (_read_ascii if end == ".asc" else _read_raster)(*asked, **how)
        else:
            grid = (_read_table if end == ".csv" else _read_archive)(*asked)
        grid = grid if values else _in_metres(str(path), grid, unit)
        _check_heights(str(path), grid.height_m)
        return grid
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except (TypeError, ValueError, MemoryError) as error:
        raise DataError(f"{path}: {error}") from error


def _in_metres(path: str, grid: HeightGrid, unit: str | None) -> HeightGrid:
    """Heights in m: of the unit that was asked for, or that the file states. Raises DataError."""
    try:
        stated = metres_in(grid.unit)
    except ParameterError as error:
        if unit is None:
            raise DataError(f"{path}: unit of heights: {error}; say which it is by `height_unit`") from error
        stated = None
    if unit is not None:
        factor = metres_in(unit)
        told = f"heights are in {unit}, as asked" + (f"; the file says {grid.unit}" if grid.unit else "")
    elif stated is None:
        factor, told = 1.0, "heights are in m, as the file states no unit (--height-unit)"
    else:
        factor, told = stated, "" if stated == 1.0 else f"heights are in {grid.unit}, as the file states"
    return replace(grid, height_m=(factor or 1.0) * grid.height_m, read_as=tuple(filter(None, (told, *grid.read_as))))


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
    """Warn of heights that are likely in another unit, or none: where more than half of the ground is steeper than any
    that is loose, and where nodes lie far off their neighbours."""
    skip = 1 + height_m.size // _SLOPES_OF
    rows = height_m[:-1:skip]
    along, across = np.diff(rows, axis=1), (height_m[1::skip] - rows)[:, :-1]
    slope = np.degrees(np.arctan(np.hypot(along, across) / spacing_m))
    known = slope[np.isfinite(slope)]
    if known.size and np.median(known) > STEEPEST_DEG:
        warnings.warn(
            f"{path}: a median slope of {np.median(known):.0f} deg at a spacing of {spacing_m:g} m, "
            "steeper than soil can lie; are heights in another unit?",
            LunarSciWarning,
            stacklevel=3,
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


def _read_raster(path: Path, layers: tuple[str, ...], unread: tuple[str, ...], **how: Any) -> HeightGrid:
    return _of_raster(read_height_raster(path, layers), **how)


def _of_raster(found: HeightRaster, *, onto: str, values: bool) -> HeightGrid:
    """The grid of a raster, on square cells of metres; `values` that are no heights are not interpolated."""
    raster, done = found.in_metres(onto, nearest=values)
    bands, across = dict(raster.bands), raster.transform
    y0 = across.f + 0.5 * across.e
    if across.e < 0:
        bands = {name: band[::-1] for name, band in bands.items()}
        y0 += across.e * (raster.shape[0] - 1)
    height = bands.pop(HEIGHT)
    for name in bands if raster is not found else ():
        if name not in ERROR_LAYERS:
            bands[name] = np.where(np.isnan(height), np.nanmedian(bands[name]), bands[name])
    return HeightGrid(
        name=Path(raster.path).stem,
        x0_m=across.c + 0.5 * across.a,
        y0_m=y0,
        spacing_m=float(across.a),
        height_m=height,
        layers=bands,
        synthetic=raster.synthetic,
        crs=raster.crs,
        crs_of_file=found.crs,
        unit=raster.unit,
        read_as=(done,) if done else (),
        beside=raster.beside,
    )


def _read_ascii(path: Path, layers: tuple[str, ...], unread: tuple[str, ...], **how: Any) -> HeightGrid:
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
    x0, y0 = (
        header.get(f"{axis}llcenter", header.get(f"{axis}llcorner", 0.0) + 0.5 * header[f"d{axis}"]) for axis in "xy"
    )
    height, (dx, dy) = heights.reshape(shape), (header["dx"], header["dy"])
    if not np.isclose(dx, dy, rtol=EVEN):
        return _of_raster(_oblong(path, height, (x0, y0), (dx, dy)), **how)
    return HeightGrid(name=path.stem, x0_m=x0, y0_m=y0, spacing_m=dx, height_m=height[::-1], unit="")


def _oblong(path: Path, height: FloatArray, first: tuple[float, float], sides: tuple[float, float]) -> HeightRaster:
    """Heights on cells that are not square, the northern row first; `first` is the centre of the south-western one."""
    try:
        from rasterio.transform import from_origin
    except ImportError as error:
        raise DataError(f"{path}: cells of {sides[0]:g} x {sides[1]:g} m; {NO_RASTERIO}") from error
    west, north = first[0] - 0.5 * sides[0], first[1] + (len(height) - 0.5) * sides[1]
    return HeightRaster(path=str(path), bands={HEIGHT: height}, transform=from_origin(west, north, *sides))


def _checked_header(path: Path, header: dict[str, float]) -> tuple[int, int]:
    """Rows and columns that the header of an ESRI ASCII grid announces, when nothing in it contradicts itself.

    `cellsize` is in it as `dx` and `dy`, too, afterwards.
    """
    if "cellsize" in header and {"dx", "dy"} & {*header}:
        raise DataError(f"{path}: cellsize and dx, dy; keep what is right")
    header |= {name: header["cellsize"] for name in ("dx", "dy") if "cellsize" in header}
    for name in ("ncols", "nrows", "dx", "dy"):
        if name not in header:
            raise DataError(
                f"{path}: no {'cellsize' if name == 'dx' else name}; an ESRI ASCII grid begins with ncols, nrows, "
                "xllcorner, yllcorner, cellsize (or dx, dy)"
            )
    if not all(header[name] >= 1 and header[name].is_integer() for name in ("ncols", "nrows")):
        raise DataError(f"{path}: ncols {header['ncols']:g}, nrows {header['nrows']:g}; give counts of 1 or more")
    if wrong := [header[name] for name in ("dx", "dy") if not 0 < header[name] < math.inf]:
        raise DataError(f"{path}: a cellsize of {wrong[0]:g}; give the side of a cell in m")
    given = {name for name in header if name[1:3] == "ll"}
    if given - {"xllcorner", "yllcorner"} and given - {"xllcenter", "yllcenter"}:
        raise DataError(f"{path}: {' and '.join(sorted(given))}; name the corner of the first cell, or its centre")
    check_count(str(path), int(header["nrows"] * header["ncols"]))
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
                check_count(str(path), entry.file_size // 8)
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
