"""Grids of heights as files: NumPy archives, GeoTIFF, netCDF, ESRI ASCII grids, and tables with a row for each node.

Soil and errors are layers beside the heights, under their own names.
"""

import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.heights.grid import ERROR_LAYERS, USUALLY, HeightGrid, far_ends, metres_in, spacing_of
from lunarsci.heights.projections import NO_RASTERIO
from lunarsci.heights.rasters import DRIVERS, check_count, grid_of_raster, read_height_raster
from lunarsci.heights.texts import (
    AXES,
    NODE,
    TEXTS,
    are_angles,
    grid_of_nodes,
    in_degrees,
    is_ascii_grid,
    plain_name,
    read_ascii,
    read_nodes,
    read_table,
)
from lunarsci.io.inputs import read_input
from lunarsci.names import one_of
from lunarsci.printable import shortened
from lunarsci.ranges import refuse

HIGHEST_M = 2e4
"""No height is farther from the median: the Moon's span 19.9 km (Smith et al. 2017, Icarus 283, 70,
10.1016/j.icarus.2016.06.006)."""
STEEPEST_DEG = 50.0
"""Median slope: no lunar soil rests steeper than its friction angle, 30 to 50 deg (Mitchell et al. 1974, Apollo Soil
Mechanics Experiment S-200, NASA CR-134306). [deg]"""
LONE_STEP, LARGEST_STEP, FILLED = 10.0, 100.0, 4
"""From a node to both neighbours of its row or column, on the same side: a slope of 84 deg up and down; to a neighbour,
as walls may be steep, but not so high [spacings]; nodes of one height that may be a fill. Assumed."""
_SLOPES_OF = 1_000_000
"""Nodes at most that the median slope is taken of."""


NETCDF = (b"CDF", b"\x89HDF")
"""How files of netCDF 3 and 4 begin."""


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
    * `.nc`, `.grd`, netCDF: a variable on x and y, or on longitude and latitude of the Moon; needs the extra `cubes`.
    * `.asc`, or any text that begins with its header: ESRI ASCII grid, cells in m.
    * `.csv`, a row for each node: `x_m`, `y_m`, `height_m`, and optionally `layers`; nodes that are not in the table
      are holes. `.xyz`, `.txt` and `.dat`, the same of x, y and height alone, with or without names.

    Numbers that usually stand for none, and lie far outside the others, are holes, and said.

    Names in `unread` may be there, and are left. Heights stand for the centres of cells. They are in `unit`, one of
    `HeightUnit`, or in that which the file states, or in m; `values` are no heights, and have no unit. Rasters of
    another coordinate system than `onto` are brought onto that. Raises DataError, ParameterError for another `unit`.
    """
    file, end = Path(path), Path(path).suffix.lower()
    arguments, how = (file, tuple(layers), tuple(unread)), dict[str, Any](onto=onto, values=values)
    if str(path) == "-":
        raise DataError("-: heights are not read from stdin; give a file, whose name says how, such as site.asc")
    try:
        if is_netcdf(file):
            grid = read_netcdf(file, **how)
        elif (end in TEXTS or end not in (".npz", *DRIVERS)) and is_ascii_grid(file):
            grid = read_ascii(*arguments, **how)
        elif end in DRIVERS:
            grid = grid_of_raster(read_height_raster(file, arguments[1]), **how)
        elif end not in TEXTS:
            grid = _read_archive(*arguments)
        else:
            grid = (read_table if end == ".csv" else read_nodes)(*arguments, **how)
        grid = grid if values else _without_fill(_in_metres(grid, unit))
        _check_heights(grid.height_m)
    except ImportError as error:
        raise DataError(f"{path}: needs {error.name}; pip install 'lunarsci[cubes]'") from error
    except (OSError, TypeError, ValueError, MemoryError) as error:
        if isinstance(error, DataError) and str(path) in str(error):
            raise
        raise DataError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    for note in (one for one in grid.read_as if USUALLY in one):
        warnings.warn(f"{path}: {note}", LunarSciWarning, stacklevel=2)
    return grid


def _in_metres(grid: HeightGrid, unit: str | None) -> HeightGrid:
    """Heights in m: of the unit that was asked for, or that the file states. Raises DataError."""
    try:
        factor = metres_in(grid.unit if unit is None else unit)
    except ParameterError as error:
        raise DataError(f"unit of heights: {error}; say which it is by `height_unit`") from error
    if unit is not None:
        note = f"heights are in {unit}, as asked" + (f"; the file says {grid.unit}" if grid.unit else "")
    elif factor is None:
        note = "heights are in m, as the file states no unit (--height-unit)"
    else:
        note = "" if factor == 1.0 else f"heights are in {grid.unit}, as the file states"
    return replace(grid, height_m=(factor or 1.0) * grid.height_m, read_as=tuple(filter(None, (note, *grid.read_as))))


def _without_fill(grid: HeightGrid) -> HeightGrid:
    """A grid without a height that several nodes have, and that no wall leads to: a fill where there are no data."""
    for end in far_ends(grid.height_m.reshape(1, -1), times=1.0, from_zero=False):
        others = np.abs(grid.height_m[np.isfinite(grid.height_m) & (grid.height_m != end.value)] - end.value)
        if min(end.repeats, end.others) >= FILLED and others.min() > LARGEST_STEP * grid.spacing_m:
            note = f"{end.repeats} nodes of {end.value:g} m {USUALLY}: {others.min():.3g} m from all others"
            height = np.where(grid.height_m == end.value, np.nan, grid.height_m)
            return replace(grid, height_m=height, read_as=(*grid.read_as, note))
    return grid


def _check_heights(height_m: FloatArray) -> None:
    """Raise DataError where a height is farther from the median than any on a body that rovers are on."""
    heights = height_m[np.isfinite(height_m)]
    off = np.abs(heights - np.median(heights)) if heights.size else heights
    if off.size and off.max() > HIGHEST_M:
        raise DataError(
            f"a height of {heights[int(off.argmax())]:g} m, {off.max() / 1e3:.0f} km from the median; the whole Moon "
            "spans 20 km; name the value that stands for no data (NODATA_value, nodata), or give heights in m"
        )


def check_relief(path: str | Path, height_m: FloatArray, spacing_m: float) -> None:
    """Warn of heights that are likely in another unit, or none: where more than half of the ground is steeper than any
    that is loose, and where nodes lie far off their neighbours."""
    skip = 1 + height_m.size // _SLOPES_OF
    rows = height_m[:-1:skip]
    along, across = np.diff(rows, axis=1), (height_m[1::skip] - rows)[:, :-1]
    slope = np.degrees(np.arctan(np.hypot(along, across) / spacing_m))
    slope = slope[np.isfinite(slope)]
    if slope.size and np.median(slope) > STEEPEST_DEG:
        warnings.warn(
            f"{path}: a median slope of {np.median(slope):.0f} deg at a spacing of {spacing_m:g} m, "
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
    for heights, marks in ((height_m, steep), (height_m.T, steep.T)):
        step = np.diff(heights, axis=0) / spacing_m
        with np.errstate(invalid="ignore"):
            far, beyond = np.abs(step) > LONE_STEP, np.abs(step) > LARGEST_STEP
            marks[1:-1] |= far[:-1] & far[1:] & (step[:-1] * step[1:] < 0)
        marks[:-1] |= beyond
        marks[1:] |= beyond
    return int(steep.sum())


def _read_archive(path: Path, layers: tuple[str, ...], unread: tuple[str, ...]) -> HeightGrid:
    arrays = _load(path, {*NODE, "name", "synthetic", "made_for", "crs", *layers}, unread)
    refuse((f"no '{key}'; a terrain needs x_m, y_m and height_m" for key in NODE if key not in arrays), "", DataError)
    x, y, height = (np.asarray(arrays[key], dtype=np.float64) for key in NODE)
    if x.ndim == y.ndim == 2 and x.shape == y.shape and (x == x[:1]).all() and (y == y[:, :1]).all():
        x, y = x[0], y[:, 0]
    if height.shape != (y.size, x.size):
        raise DataError(f"height_m has shape {height.shape}; y_m and x_m say {(y.size, x.size)}")
    spacing_m = spacing_of(x, y)
    return HeightGrid(
        name=str(arrays.get("name", path.stem)),
        x0_m=float(x[0]),
        y0_m=float(y[0]),
        spacing_m=spacing_m,
        height_m=height,
        layers={key: arrays[key] for key in layers if key in arrays},
        synthetic=bool(arrays.get("synthetic", False)),
        made_for=str(arrays["made_for"]) if "made_for" in arrays else None,
        crs=str(arrays.get("crs", "")),
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


def _load(path: Path, keys: set[str], unread: tuple[str, ...]) -> dict[str, Any]:
    """The arrays of an archive, none of which is unpacked before its name and its size are known to be sound."""
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise DataError("a single array, not a NumPy archive; write it with numpy.savez")
        with archive:
            named = {key: AXES.get(plain_name(key), key) for key in archive.files}
            if {*NODE} & {*archive.files} or len({*named.values()}) < len(named):
                named = {key: key for key in archive.files}
            unknown = map(shortened, sorted({*named.values()} - keys - {*unread}))
            refuse((f"'{k}' is not a key of a terrain; {one_of(k, sorted(keys))}" for k in unknown), "", DataError)
            for entry in archive.zip.infolist() if archive.zip else ():
                check_count(entry.file_size // 8)
            arrays = {name: archive[key] for key, name in named.items() if name in keys}
    except (DataError, OSError):
        raise
    except Exception as error:  # whatever NumPy raises of a damaged archive: each part of it has its own
        read_input(path)  # says of a compressed file that it is one
        what = "not a NumPy archive that can be read; write it with numpy.savez"
        ends = ", ".join(sorted({".npz", ".nc", ".grd", ".asc", *TEXTS, *DRIVERS}))
        raise DataError(what if path.suffix == ".npz" else f"no heights; give a grid of them in {ends}") from error
    complex_ones = (key for key, array in arrays.items() if np.iscomplexobj(array))
    refuse((f"{key} has complex numbers; write real ones" for key in complex_ones), "", DataError)
    return arrays


def is_netcdf(path: Path) -> bool:
    """Whether a file begins as netCDF does. Raises OSError."""
    with path.open("rb") as stream:
        return stream.read(4).startswith(NETCDF)


def read_netcdf(path: Path, *, onto: str, values: bool) -> HeightGrid:
    """The one variable on two coordinates, its scale, offset, unit and marks taken. Raises DataError."""
    with _opened(path) as data:
        grids = {str(name): one for name, one in data.data_vars.items() if _axes(one)}
        heights = [name for name in grids if AXES.get(plain_name(name)) == "height_m"]
        names = heights if len(heights) == 1 else [*grids]
        if len(names) != 1:
            raise DataError(f"variables on x and y are {', '.join(names[:5]) or 'none'}; keep one, named height_m")
        height = grids[names[0]]
        axes = _axes(height)
        check_count(height.size)
        y, x = (np.asarray(data[axes[name]], dtype=float) for name in ("y_m", "x_m"))
        numbers = np.asarray(height.transpose(axes["y_m"], axes["x_m"]), dtype=float)
        units = {name: str(data[axes[name]].attrs.get("units", "")) for name in axes}
        unit, body = str(height.attrs.get("units", "")), _body_in(data)
    nodes = {"x_m": np.tile(x, y.size), "y_m": np.repeat(y, x.size), "height_m": numbers.ravel()}
    note = f"variable {names[0]} on {axes['x_m']} and {axes['y_m']}"
    if any(one.lower().startswith("degree") for one in units.values()) or are_angles([*axes.values()]):
        return grid_of_raster(in_degrees(path, nodes, unit, note, body), onto=onto, values=values)
    for name in axes:
        nodes[name] = nodes[name] * (metres_in(units[name]) or 1.0)
    return grid_of_nodes(path, nodes, unit, (note,))


def _opened(path: Path) -> Any:
    import xarray

    with path.open("rb") as stream:
        engine = "scipy" if stream.read(3) == NETCDF[0] else "h5netcdf"
    try:
        return xarray.open_dataset(path, engine=engine)
    # Whatever xarray and its engines raise of a damaged file: each has its own.
    except Exception as error:
        text = f"not a netCDF file that can be read ({' '.join(str(error).split())[:80]}); fetch it again"
        raise DataError(text) from error


def _body_in(data: Any) -> str:
    """The ellipsoid that a variable of a mapping names (CF conventions, appendix F), in PROJ's words; '' for none."""
    for one in data.variables.values():
        axis = one.attrs.get("semi_major_axis", one.attrs.get("earth_radius"))
        if axis is not None:
            minor, flat = one.attrs.get("semi_minor_axis"), one.attrs.get("inverse_flattening")
            shape = f" +b={float(minor)}" if minor is not None else f" +rf={float(flat)}" if flat else ""
            return f"+a={float(axis)}{shape or f' +b={float(axis)}'}"
    return ""


def _axes(variable: Any) -> dict[str, str]:
    """The dimensions of x and y of a variable with just these two; none of any other."""
    named = {AXES.get(plain_name(str(name)), ""): str(name) for name in variable.dims}
    return named if len(variable.dims) == 2 and {*named} == {"x_m", "y_m"} else {}


def holds_heights(path: Path) -> bool:
    """Whether a netCDF file has a grid of heights and no cube; a damaged one has neither."""
    try:
        with _opened(path) as data:
            every = [*data.data_vars.values()]
            return any(map(_axes, every)) and all(one.ndim < 3 for one in every)
    except (DataError, ImportError):
        return False
