"""Heights as text: ESRI ASCII grids, and tables with a row for each node, under usual names of columns or none.

GDAL's reader of such tables wants them sorted, and an extra; pandas reads the numbers, and this puts them on a grid.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import DataError
from lunarsci.heights.grid import ERROR_LAYERS, EVEN, HeightGrid, metres_in, spacing_of, without_markers
from lunarsci.heights.rasters import HEIGHT, HeightRaster, check_count, grid_of_raster
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.names import one_of
from lunarsci.ranges import refuse

HEADER = ("ncols", "nrows", "cellsize", "dx", "dy", "nodata_value", "xllcorner", "yllcorner", "xllcenter", "yllcenter")
"""Keys of the header of an ESRI ASCII grid, in lower case."""
TEXTS = (".asc", ".csv", ".xyz", ".txt", ".dat", ".grd", ".agr")
"""Ends of names of text."""
SPARSE = 4.0
"""Nodes of a grid for each row of a table without names, that may be holes; assumed."""
NODE = ("x_m", "y_m", "height_m")
"""Columns of a table of nodes."""
AXES = {
    **dict.fromkeys(("x", "east", "easting", "eastings", "xcoord", "xcoordinate", "lon", "longitude"), "x_m"),
    **dict.fromkeys(("y", "north", "northing", "northings", "ycoord", "ycoordinate", "lat", "latitude"), "y_m"),
    **dict.fromkeys(
        ("z", "height", "heights", "elevation", "elev", "alt", "altitude", "zcoord", "dem", "dtm"), "height_m"
    ),
}
"""What others call the columns of a table of nodes, without units."""
BESIDE = {
    *("", "fid", "id", "index", "n", "no", "point", "unnamed", "r", "g", "b", "red", "green", "blue", "rgb", "alpha"),
    *("intensity", "nx", "ny", "nz", "scalarfield", "class", "classification"),
}
"""Columns beside nodes that leave a table one of them: numbers of points, colours and normals of point clouds."""
REMARKS = ("#", "//", "%", "!")
"""Beginnings of lines that are no data."""
ROUNDED = 0.04
"""By how much steps may differ where places are rounded, as a share of one; assumed."""


def is_ascii_grid(path: Path) -> bool:
    """Whether a file begins as an ESRI ASCII grid does, or is named as one. Raises OSError."""
    with path.open("rb") as stream:
        start = stream.read(64).lstrip().lower()
    return path.suffix.lower() == ".asc" or start.startswith((b"ncols", b"nrows"))


def read_ascii(path: Path, layers: tuple[str, ...], unread: tuple[str, ...], **how: Any) -> HeightGrid:
    """An ESRI ASCII grid, its cells in m. Raises DataError."""
    content = text(read_input(path))
    if "," in content:
        content = content.replace(",", " " if "." in content else ".")
    lines = content.splitlines()
    words: list[list[str]] = []
    while len(words) < len(lines) and len(cells := lines[len(words)].split()) == 2 and cells[0].lower() in HEADER:
        words.append(cells)
    if not words and node_columns(InputFile(str(path), content.encode()), content):
        return read_nodes(path, layers, unread, **how)
    header = _checked_header([(name.lower(), float(number)) for name, number in words])
    shape, (dx, dy) = (int(header["nrows"]), int(header["ncols"])), (header["dx"], header["dy"])
    heights = np.array(" ".join(lines[len(words) :]).split(), dtype=np.float64)
    if heights.size != shape[0] * shape[1]:
        raise DataError(f"{heights.size} heights, {shape[0]} rows of {shape[1]} announced; is it cut short?")
    heights[heights == header.get("nodata_value", -9999.0)] = np.nan
    heights, note = without_markers(heights)
    height = heights.reshape(shape)
    x0, y0 = (
        header.get(f"{axis}llcenter", header.get(f"{axis}llcorner", 0.0) + 0.5 * header[f"d{axis}"]) for axis in "xy"
    )
    crs, beside = _system_beside(path)
    if crs or not np.isclose(dx, dy, rtol=EVEN):
        from rasterio.transform import from_origin

        west_north = from_origin(x0 - 0.5 * dx, y0 + (shape[0] - 0.5) * dy, dx, dy)
        raster = HeightRaster(
            path=str(path), bands={HEIGHT: height}, transform=west_north, note=note, crs=crs, beside=beside
        )
        return grid_of_raster(raster, **how)
    return HeightGrid(
        name=path.stem, x0_m=x0, y0_m=y0, spacing_m=dx, height_m=height[::-1], unit="", read_as=(note,) if note else ()
    )


def _system_beside(path: Path) -> tuple[str, tuple[str, ...]]:
    """The coordinate system of a `.prj` beside a grid, and that file; nothing where there is none.

    Raises ImportError for one in degrees where rasterio is not installed, DataError for text that is no system.
    """
    beside = path.with_suffix(".prj")
    if not beside.is_file():
        return "", ()
    content = text(read_input(beside))
    try:
        from rasterio.crs import CRS
        from rasterio.errors import CRSError
    except ImportError:
        if content.lstrip().upper().startswith("PROJCS"):
            return "", ()
        raise
    try:
        return CRS.from_user_input(content).to_wkt(), (str(beside),)
    except CRSError as error:
        raise DataError(f"{beside}: not a coordinate system: {error}; correct it or take it away") from error


def _checked_header(stated: Sequence[tuple[str, float]]) -> dict[str, float]:
    """The header of an ESRI ASCII grid, when nothing in it contradicts itself; `cellsize` is in it as `dx` and `dy`.

    Raises DataError.
    """
    counted, header = Counter(name for name, _ in stated), dict(stated)
    sides = {name: header.get(name, header.get("cellsize", math.nan)) for name in ("dx", "dy")}
    counts = [header.get(name, math.nan) for name in ("ncols", "nrows")]
    missing = [name for name, value in zip(("ncols", "nrows"), counts, strict=True) if name not in header]
    missing += ["cellsize" if name == "dx" else name for name in sides if not {name, "cellsize"} & {*header}]
    corner = {name for name in header if name[1:3] == "ll"}
    mixed = corner - {"xllcorner", "yllcorner"} and corner - {"xllcenter", "yllcenter"}
    twice, wrong = [name for name in counted if counted[name] > 1], [v for v in sides.values() if not 0 < v < math.inf]
    faults = {
        f"{', '.join(twice)} is there twice; keep the right one": twice,
        "cellsize and dx, dy; keep what is right": "cellsize" in header and {"dx", "dy"} & {*header},
        f"no {', '.join(missing)}; an ESRI ASCII grid begins with ncols, nrows, xllcorner, yllcorner, cellsize (or dx, "
        "dy)": missing,
        f"ncols {counts[0]:g}, nrows {counts[1]:g}; give counts of 1 or more":
            not all(count >= 1 and count.is_integer() for count in counts),
        f"a cellsize of {', '.join(f'{value:g}' for value in wrong)}; give the side of a cell in m": wrong,
        f"{' and '.join(sorted(corner))}; name the corner of the first cell, or its centre": mixed,
    }  # fmt: skip
    refuse(faults, "", DataError)
    check_count(counts[0] * counts[1])
    return header | sides


def read_table(path: Path, layers: tuple[str, ...], unread: tuple[str, ...], **how: Any) -> HeightGrid:
    """A table of nodes with the columns `x_m`, `y_m` and `height_m`, or others that mean these. Raises DataError."""
    table = read_csv_table(path)
    named = {str(name): AXES.get(plain_name(name), str(name)) for name in table}
    if not {*NODE} <= {*named} and ({*named.values()} >= {*NODE} or _node_table(path)):
        return read_nodes(path, layers, unread, **how)
    table = table[[name for name in table if name in layers or name not in unread]]
    missing, unknown = {*NODE} - {*table}, {str(name) for name in table} - {*NODE, *layers}
    reasons = [f"no column {name}; a terrain needs x_m, y_m and height_m" for name in sorted(missing)]
    reasons += [f"'{n}' is no column of a terrain; {one_of(n, (*NODE, *layers))}" for n in sorted(unknown)]
    refuse(reasons, "", DataError)
    return _grid_of(path, {str(name): numbers_of(str(path), str(name), cells) for name, cells in table.items()})


def _node_table(path: Path) -> tuple[list[str], FloatArray] | None:
    """Names and numbers of a file's columns x, y and height, as `node_columns` gives them; None for other files."""
    content = text(read_input(path))
    return node_columns(InputFile(str(path), content.encode()), content)


def read_nodes(path: Path, layers: tuple[str, ...], unread: tuple[str, ...], **how: Any) -> HeightGrid:
    """A table of x, y and height, with or without names, with commas, semicolons or blanks. Raises DataError.

    Longitude and latitude are of the Moon, and projected as those of a raster.
    """
    table = _node_table(path)
    if table is None:
        raise DataError("no table of x, y and height; name three columns x_m, y_m and height_m")
    names, values = table
    units = [_unit_in(name) for name in names]
    nodes = dict(zip(NODE, values, strict=True))
    note = f"columns {', '.join(names)} as x, y and height"
    if are_angles(names[:2]):
        return grid_of_raster(in_degrees(path, nodes, units[2], note), **how)
    for name, unit in zip(NODE[:2], units, strict=False):
        nodes[name] = nodes[name] * (metres_in(unit) or 1.0)
    return grid_of_nodes(path, nodes, units[2], (note,))


def grid_of_nodes(path: Path, nodes: dict[str, FloatArray], unit: str, notes: tuple[str, ...]) -> HeightGrid:
    """Heights in a unit on their grid, without those that stand for none."""
    height, lost = without_markers(nodes["height_m"])
    grid = _grid_of(path, {**nodes, "height_m": height})
    return replace(grid, unit=unit, read_as=(*notes, lost) if lost else notes)


def are_angles(names: Sequence[str]) -> bool:
    """Whether names of places are those of longitude and latitude."""
    return any(plain_name(name).startswith(("lon", "lat")) for name in names)


def in_degrees(path: Path, nodes: dict[str, FloatArray], unit: str, note: str, body: str = "") -> HeightRaster:
    """Heights at longitudes and latitudes of the Moon, or of a `body` as PROJ says it: a raster. Raises DataError."""
    from rasterio.crs import CRS
    from rasterio.transform import from_origin

    lon, lat = nodes["x_m"], nodes["y_m"]
    height, lost = without_markers(nodes["height_m"])
    across, up = (_axis(axis) for axis in (lon, lat))
    sides = [float(np.ptp(axis)) / max(axis.size - 1, 1) for axis in (across, up)]
    uneven = [
        np.abs(np.diff(axis) - side).max(initial=0.0) > EVEN * side
        for axis, side in zip((across, up), sides, strict=True)
    ]
    faults = {
        "longitude or latitude beyond a circle; name columns in m x_m and y_m":
            np.abs(lon).max() > 360.0 or np.abs(lat).max() > 90.0,
        f"{across.size} longitudes and {up.size} latitudes; give at least 3 of each":
            min(across.size, up.size) < 3 or not min(sides) > 0,
        f"{'longitudes' if uneven[0] else 'latitudes'} are not in even steps; interpolate the heights to even ones":
            any(uneven),
    }  # fmt: skip
    refuse(faults, "", DataError)
    check_count(across.size * up.size)
    heights = np.full((up.size, across.size), np.nan)
    heights[np.rint((up[-1] - lat) / sides[1]).astype(int), np.rint((lon - across[0]) / sides[0]).astype(int)] = height
    transform = from_origin(across[0] - 0.5 * sides[0], up[-1] + 0.5 * sides[1], *sides)
    where = f"{note}, in degrees on " + (body or "the sphere of the Moon; a GeoTIFF names another body")
    crs = CRS.from_user_input(f"+proj=longlat {body or f'+R={1e3 * MOON_RADIUS_KM:.0f}'} +no_defs").to_wkt()
    crs = crs if body else crs.replace("unknown", "Moon", 1)
    return HeightRaster(
        path=str(path), bands={HEIGHT: heights}, transform=transform, crs=crs, unit=unit,
        note="; ".join(filter(None, (where, lost))),
    )  # fmt: skip


def node_columns(file: InputFile, content: str, *, above: float | None = None) -> tuple[list[str], FloatArray] | None:
    """Names and numbers (3, n) of the columns of a table of nodes; None for any other table.

    Where `above` is given, it must be one of nodes alone, and not of numbers from 0 to that, which are reflectances.

    Three columns without names are such a table where the first two are places on a grid. Names may stand in the
    remark above, as of point clouds. What colours or counts nodes may stand beside them.
    """
    import pandas as pd

    rows = _cells(content)
    first = rows[0] if rows else []
    bare = all(_is_number(cell) for cell in first)
    if pivot := _pivot(rows):
        likely = above is None or np.nanmin(pivot[1][2]) < 0 or np.nanmax(pivot[1][2]) > above
        return pivot if likely else None
    if len(first) < 3 or (not bare and (len(rows) < 2 or len(rows[1]) != len(first))):
        return None
    axes = [AXES.get(plain_name(cell), "") for cell in first]
    places = [0, 1, 2] if bare else [axes.index(name) for name in NODE if name in axes]
    beside = {plain_name(cell) for k, cell in enumerate(first) if k not in places}
    if len(places) < 3 or (bare and len(first) != 3) or (above is not None and not beside <= BESIDE):
        return None
    rows = rows[0 if bare else 1 :]
    if {len(row) for row in rows} != {len(first)}:
        return None
    table = pd.DataFrame(rows, dtype=str)
    names = [f"{place + 1}" if bare else first[place] for place in places]
    try:
        values = np.array([numbers_of(file.name, names[k], table[place]) for k, place in enumerate(places)])
    except DataError:
        return None
    return (names, values) if not bare or _is_grid(values) else None


def _pivot(rows: list[list[str]]) -> tuple[list[str], FloatArray] | None:
    """Nodes of a table with x in the names of its columns and y in its first one; None for any other table."""
    if len(rows) < 4 or len({*map(len, rows)}) != 1 or len(rows[0]) < 4 or _is_number(rows[0][0] or "x"):
        return None
    try:
        x, y = np.array(rows[0][1:], dtype=float), np.array([row[0] for row in rows[1:]], dtype=float)
        heights = np.array([[cell or "nan" for cell in row[1:]] for row in rows[1:]], dtype=float)
    except ValueError:
        return None
    steps = [np.diff(axis) / (axis[1] - axis[0] or np.nan) for axis in (x, y)]
    if not all(np.allclose(step, 1.0, atol=ROUNDED) for step in steps):
        return None
    names = ["the names of columns", "the first column", "the cells"]
    return names, np.array([np.tile(x, y.size), np.repeat(y, x.size), heights.ravel()])


def _cells(content: str) -> list[list[str]]:
    """Cells of lines that are no remarks, those of names first; with decimal points."""
    lines = [line.strip() for line in content.splitlines() if line.strip()]
    marked = [line.startswith(REMARKS) for line in lines]
    body = [line for line, remark in zip(lines, marked, strict=True) if not remark]
    if len(body) > 1 and body[0].isdigit():  # how many points there are
        body = body[1:]
    sample = body[1] if len(body) > 1 else body[0] if body else ""
    separator = next((sign for sign in "\t;," if sign in sample), None)
    if separator in (None, "\t", ";") and body:
        body = [body[0], *(line.replace(",", ".") if "." not in line else line for line in body[1:])]
    rows = [[cell.strip().strip('"') for cell in line.split(separator)] for line in body]
    above = marked.index(False) - 1 if False in marked else -1
    names = lines[above].lstrip("#/ ") if above >= 0 else ""
    named = [cell.strip() for cell in names.split(separator)] if names else []
    if rows and len(named) == len(rows[0]) and {*NODE} <= {AXES.get(plain_name(cell), "") for cell in named}:
        rows.insert(0, named)
    return rows


def _is_grid(values: FloatArray) -> bool:
    """Whether the first two of three columns (3, n) without names are places of nodes, two in each row and column."""
    rows = values.shape[1]
    across, up = (len(np.unique(axis)) for axis in values[:2])
    return min(across, up) >= 2 and 2 * max(across, up) <= rows <= across * up <= SPARSE * rows


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def plain_name(name: object) -> str:
    """A name without its unit, in small letters."""
    return re.sub(
        r"[\s_]*[\[(]?\b(?:m|km|cm|mm|ft|deg|degrees)\b[\])]?$|[^a-z]", "", str(name).lower().replace("_", " ")
    )


def _unit_in(name: str) -> str:
    return next(iter(re.findall(r"(?:_|\(|\[|\s)(k?m|cm|mm|ft)\b", name.lower())), "")


def _grid_of(path: Path, values: dict[str, FloatArray]) -> HeightGrid:
    """Nodes on their grid; those that are not there are holes."""
    blank = np.isnan(values["x_m"]) | np.isnan(values["y_m"])
    if blank.any():
        raise DataError(
            f"{path}, row {int(np.argmax(blank)) + 1}: x_m or y_m is missing; leave the row out or fill it in"
        )
    x, y = (_axis(values[name]) for name in ("x_m", "y_m"))
    spacing = spacing_of(x, y)
    check_count(x.size * y.size)
    column, row = (np.rint((values[name] - axis[0]) / spacing).astype(int) for name, axis in (("x_m", x), ("y_m", y)))
    if len(np.unique(row * x.size + column)) < len(row):
        raise DataError("a node has two rows; keep one of each x_m, y_m")
    layers = {}
    for name in (name for name in values if name not in NODE[:2]):
        empty = np.nan if name in ("height_m", *ERROR_LAYERS) else np.nanmedian(values[name])
        layers[name] = np.full((y.size, x.size), empty)
        layers[name][row, column] = values[name]
    height = layers.pop("height_m")
    return HeightGrid(
        name=path.stem, x0_m=float(x[0]), y0_m=float(y[0]), spacing_m=spacing, height_m=height, layers=layers
    )


def _axis(values: FloatArray) -> FloatArray:
    """Places of nodes along an axis, in even steps where they are even but for their last digit."""
    places = np.unique(values)
    step = np.diff(places)
    if places.size < 3 or np.ptp(step) > ROUNDED * np.median(step):
        return places
    return np.linspace(places[0], places[-1], places.size)
