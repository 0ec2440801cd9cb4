"""Heights in netCDF: grids of GMT and others, on a coordinate of x and one of y, or of longitude and latitude.

xarray reads them; which of the variables is the height, and what its coordinates are, it does not tell.
"""

from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.errors import DataError
from lunarsci.heights.grid import HeightGrid, grid_of_raster
from lunarsci.heights.rasters import check_count
from lunarsci.heights.texts import AXES, are_angles, grid_of_nodes, in_degrees, plain_name
from lunarsci.heights.units import metres_in

NETCDF = (b"CDF", b"\x89HDF")
"""How files of netCDF 3 and 4 begin."""
NO_XARRAY = "netCDF needs xarray; pip install 'lunarsci[cubes]'"


def is_netcdf(path: Path) -> bool:
    """Whether a file begins as netCDF does. Raises OSError."""
    with path.open("rb") as stream:
        return stream.read(4).startswith(NETCDF)


def read_netcdf(path: Path, *, onto: str, values: bool) -> HeightGrid:
    """The one variable on two coordinates, its scale, offset, unit and marks taken. Raises DataError."""
    with _opened(path) as data:
        found = {str(name): one for name, one in data.data_vars.items() if _axes(one)}
        heights = [name for name in found if AXES.get(plain_name(name)) == "height_m"]
        names = heights if len(heights) == 1 else [*found]
        if len(names) != 1:
            listed = ", ".join(names[:5]) or "none"
            raise DataError(f"{path}: variables on x and y are {listed}; keep one, named height_m")
        height = found[names[0]]
        axes = _axes(height)
        check_count(str(path), height.size)
        y, x = (np.asarray(data[axes[name]], dtype=float) for name in ("y_m", "x_m"))
        numbers = np.asarray(height.transpose(axes["y_m"], axes["x_m"]), dtype=float)
        units = {name: str(data[axes[name]].attrs.get("units", "")) for name in axes}
        unit, body = str(height.attrs.get("units", "")), _body_in(data)
    nodes = {"x_m": np.tile(x, y.size), "y_m": np.repeat(y, x.size), "height_m": numbers.ravel()}
    said = f"variable {names[0]} on {axes['x_m']} and {axes['y_m']}"
    if any(one.lower().startswith("degree") for one in units.values()) or are_angles([*axes.values()]):
        return grid_of_raster(in_degrees(path, nodes, unit, said, body), onto=onto, values=values)
    for name in axes:
        nodes[name] = nodes[name] * (metres_in(units[name]) or 1.0)
    return grid_of_nodes(path, nodes, unit, (said,))


def _opened(path: Path) -> Any:
    try:
        import xarray
    except ImportError as error:
        raise DataError(f"{path}: {NO_XARRAY}") from error
    with path.open("rb") as stream:
        engine = "scipy" if stream.read(3) == NETCDF[0] else "h5netcdf"
    try:
        return xarray.open_dataset(path, engine=engine)
    # Whatever xarray and its engines raise of a damaged file: each has its own.
    except Exception as error:
        raise DataError(
            f"{path}: not a netCDF file that can be read ({' '.join(str(error).split())[:80]}); fetch it again"
        ) from error


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
    except DataError:
        return False
