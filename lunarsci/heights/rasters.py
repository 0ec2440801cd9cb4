"""Rasters of heights: what GDAL reads of them, and the same ground on square cells of metres.

Nodes are looked up one by one: the warp of GDAL puts them off by up to an eighth of a cell, which are steps in heights
that are otherwise smooth, and closes holes.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.heights.grid import ERROR_LAYERS, EVEN, HeightGrid, without_markers
from lunarsci.heights.projections import LARGEST_STRETCH, MapProjection, local_projection, moved, name_of
from lunarsci.io.inputs import unheard

MOST_NODES = 40_000_000
"""More are refused: maps of these take 1.8 GB."""
MOST_BLOCK_BYTES = 8 * MOST_NODES
"""Of a raster's blocks, each of which is unpacked whole."""
DRIVERS = {
    **{".tif": "GTiff", ".tiff": "GTiff", ".lbl": "PDS", ".img": "PDS", ".xml": "PDS4", ".cub": "ISIS3"},
    **{".jp2": "JP2OpenJPEG", ".grd": "GSAG", ".flt": "EHdr", ".bil": "EHdr"},
    **{".vrt": "VRT", ".bsq": "ENVI", ".raw": "ENVI"},
}
"""GDAL's readers by the ending of a file."""
OTHERS = {b"EHFA": "HFA", b"DSBB": "GSBG", b"DSRB": "GS7BG"}
"""Those of other files with such endings, by how they begin."""
KINDS = {
    **{"GTiff": "GeoTIFF", "PDS": "PDS3 image or label of one", "PDS4": "PDS4 label", "ISIS3": "ISIS cube"},
    **{"ENVI": "raw grid with its header of ENVI", "VRT": "virtual raster of GDAL"},
    **{"JP2OpenJPEG": "JPEG 2000", "EHdr": "raw grid with its .hdr", "HFA": "image of Erdas Imagine"},
    **dict.fromkeys(("GSAG", "GSBG", "GS7BG"), "grid of Surfer"),
}
"""What GDAL's readers read, in words."""
HEIGHT = "height_m"
"""Name of the heights among the `bands` of a `HeightRaster`."""
_AT_ONCE = 500_000
"""Nodes that are looked up at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightRaster:
    """What a raster says.

    Attributes
    ----------
    path : its file, for messages.
    bands : by name, `height_m` among them, with scale and offset; NaN where they have no data. (rows, columns)
    transform : from column and row, of corners of cells, to x and y.
    crs : the coordinate system of x and y as well-known text; empty where none is named.
    unit : of the heights, as the file states it; empty where it states none.
    synthetic : True for made-up ground.
    beside : files beside this one that were read, such as the numbers of a label.
    note : which numbers were taken for none.
    """

    path: str
    bands: Mapping[str, npt.NDArray[Any]]
    transform: Any
    crs: str = ""
    unit: str = ""
    synthetic: bool = False
    beside: tuple[str, ...] = ()
    note: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.bands[HEIGHT].shape
        return rows, columns

    @property
    def square(self) -> bool:
        """Whether columns point along x, and cells are as wide as high."""
        across = self.transform
        upright = across.b == 0 and across.d == 0 and across.a > 0
        return bool(upright and np.isclose(across.a, abs(across.e), rtol=EVEN))

    def in_metres(self, onto: str = "", *, nearest: bool = False) -> tuple["HeightRaster", str]:
        """The raster on square cells of metres, and what was done for that, '' where nothing was.

        Metres of the map must be those of the ground: systems in degrees, in another unit and with a stretch of more
        than 2 % go over to a stereographic one about the middle of the raster, and any other one to `onto`, where this
        is given. Values between nodes are bilinear, `nearest` takes those of the nearest one. A node has a value where
        all around it have one. The spacing is that of the file, the wider one where it has two. Raises DataError.
        """
        try:
            if not (np.isfinite(self.transform).all() and self.transform.determinant):
                raise ParameterError("its cells have no size; is its transform damaged?")
            crs, why = self._target(onto)
            there = self._resampled(crs, nearest=nearest) if why else self
            return there, "; ".join(filter(None, (why and self._how(why, there), there._stretch_left(crs))))
        except (ParameterError, OverflowError) as error:
            raise DataError(f"{self.path}: {error}") from error

    def _target(self, onto: str) -> tuple[str, str]:
        """The system to be on, and why its nodes are not those of the file; '' where they are."""
        if self.crs and onto and onto != self.crs:
            return onto, "it is not that of the terrain"
        if self.crs and not onto:
            places = self._places(3)
            local = local_projection(self.crs, *places)
            try:
                stretch = MapProjection(self.crs).worst_stretch(*places)
            except ParameterError as error:
                return local.wkt, str(error).partition(";")[0]
            if stretch - self._local_stretch(local, places) > LARGEST_STRETCH:
                return local.wkt, f"its metres differ by up to {stretch:.0%} from those on the ground"
        return self.crs, "" if self.square else "its cells are not square, or turned"

    def _local_stretch(self, local: MapProjection, places: FloatArray) -> float:
        """Largest stretch of the local projection at places (2, n) of the raster, infinite where it has none. [-]"""
        try:
            return local.worst_stretch(*moved(self.crs, local.wkt, *places).T)
        except ParameterError:  # one of the places is that opposite to its middle
            return np.inf

    def _places(self, count: int) -> FloatArray:
        """x and y of `count` by `count` places from edge to edge. (2, count^2)"""
        rows, columns = (np.linspace(0.5, size - 0.5, count) for size in self.shape)
        column, row = np.meshgrid(columns, rows)
        return np.array(self.transform @ (column.ravel(), row.ravel()))

    def _resampled(self, crs: str, *, nearest: bool) -> "HeightRaster":
        """The raster on square cells of another system, or its own; north is up."""
        from rasterio.transform import from_origin

        try:
            spacing, there = self._spacing(crs), moved(self.crs, crs, *self._places(101)).T
        except ParameterError as error:
            raise ParameterError(f"no one map has all of it: {error}; cut out the part around the drive") from error
        low = there.min(axis=1)
        columns, rows = (1 + math.floor(span / spacing + EVEN) for span in there.max(axis=1) - low)
        check_count(columns * rows)
        if min(columns, rows) < 3:
            raise ParameterError(f"has {columns} x {rows} nodes every {spacing:g} m; give at least 3 x 3")
        transform = from_origin(low[0] - 0.5 * spacing, low[1] + (rows - 0.5) * spacing, spacing, spacing)
        bands = self._looked_up(transform, (rows, columns), crs, nearest=nearest)
        return replace(self, bands=bands, transform=transform, crs=crs)

    def _spacing(self, crs: str) -> float:
        """The wider side of a cell in the middle, in metres of a system, to four digits. [m]"""
        rows, columns = np.array(self.shape) / 2.0
        x, y = self.transform @ (columns + np.array([0.0, 1.0, 0.0]), rows + np.array([0.0, 0.0, 1.0]))
        corner, *sides = moved(self.crs, crs, x, y)
        return float(f"{max(np.linalg.norm(side - corner) for side in sides):.4g}")

    def _looked_up(
        self, transform: Any, shape: tuple[int, int], crs: str, *, nearest: bool
    ) -> dict[str, npt.NDArray[Any]]:
        from scipy.ndimage import map_coordinates

        bands = {name: np.full(shape, np.nan) for name in self.bands}
        step, turn = max(1, _AT_ONCE // shape[1]), self._turn(crs)
        for first in range(0, shape[0], step):
            last = min(first + step, shape[0])
            column, row = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(first, last) + 0.5)
            x, y = moved(crs, self.crs, *(transform @ (column.ravel(), row.ravel()))).T
            columns, rows = ~self.transform @ (x - turn * np.rint((x - self._places(1)[0]) / (turn or 1.0)), y)
            # Rounded, as a node on the edge must not fall out by the last digit.
            at = np.round(np.array([rows, columns]) - 0.5, 9)
            for name, band in self.bands.items():
                values = map_coordinates(band, at, order=0 if nearest else 1, cval=np.nan)
                bands[name][first:last] = values.reshape(last - first, -1)
        return bands

    def _turn(self, crs: str) -> float:
        """What x differs by once round the body, 360 in degrees, where the raster reaches beyond it; else 0."""
        places = self._places(101)
        again = moved(crs, self.crs, *moved(self.crs, crs, *places).T).T
        turn = float(np.abs(again[0] - places[0]).max())
        return turn if turn > abs(self.transform.a) else 0.0

    def _how(self, why: str, there: "HeightRaster") -> str:
        spacing = f"nodes every {there.transform.a:g} m"
        if there.crs == self.crs:
            return f"heights are interpolated to {spacing}: {why}"
        return f"reprojected from '{name_of(self.crs)}': {why}; x and y are of '{name_of(there.crs)}', {spacing}"

    def _stretch_left(self, crs: str) -> str:
        if not crs or (stretch := MapProjection(crs).worst_stretch(*self._places(3))) <= LARGEST_STRETCH:
            return ""
        return f"metres of the map differ by up to {stretch:.0%} from those on the ground, at its edge"


def read_height_raster(path: Path, layers: tuple[str, ...] = ()) -> HeightRaster:
    """The first band of a raster as `height_m`, and those that are described as one of `layers`.

    GeoTIFF, PDS3 with a label attached or beside it, PDS4 labels, ISIS cubes; needs rasterio. Raises DataError.
    """
    import rasterio
    from rasterio.errors import RasterioIOError

    driver = _driver_of(path)
    try:
        with unheard(), rasterio.open(_label_of(path), driver=driver) as raster:
            check_count(raster.width * raster.height)
            check_blocks(raster, str(path))
            beside = _beside(path, raster.files)
            others = enumerate(raster.descriptions[1:], start=2)
            numbers = {HEIGHT: 1} | {str(text): k for k, text in others if text in layers}
            read = {name: _band(raster, k) for name, k in numbers.items()}
            return HeightRaster(
                path=str(path),
                bands={name: band for name, (band, _) in read.items()},
                note=read[HEIGHT][1],
                transform=raster.transform,
                crs=raster.crs.to_wkt() if raster.crs and (raster.crs.is_geographic or raster.crs.is_projected) else "",
                unit=_unit(raster),
                synthetic=raster.tags().get("SYNTHETIC", "").lower() in ("true", "1", "yes"),
                beside=beside,
            )
    except (RasterioIOError, UnicodeDecodeError) as error:
        raise DataError(f"not a {KINDS[driver]} that can be read: {error}") from error


def _driver_of(path: Path) -> str:
    """GDAL's reader of a file, by its begin or its ending. Raises OSError."""
    with path.open("rb") as stream:
        begin, end = stream.read(4), path.suffix.lower()
    header = path.with_suffix(".hdr")
    if DRIVERS[end] in ("PDS", "EHdr") and header.is_file() and header.read_bytes()[:4] == b"ENVI":
        return "ENVI"
    return OTHERS.get(begin, DRIVERS[end])


def _label_of(path: Path) -> Path:
    """The label beside an image that has one."""
    beside = [path.with_suffix(end) for end in (".lbl", ".LBL")] if path.suffix.lower() == ".img" else []
    return next((label for label in beside if label.is_file()), path)


def _beside(path: Path, read: list[str]) -> tuple[str, ...]:
    """Files of a raster but its own. Raises DataError where one lies in another folder: labels name any."""
    others = [Path(name) for name in read if Path(name) != path]
    if far := next((name for name in others if name.resolve().parent != path.resolve().parent), None):
        raise DataError(f"{path}: names {far}, which is not in its folder; put the files of an image together")
    return tuple(map(str, others))


def _unit(raster: Any) -> str:
    """Unit of the first band: of its metadata, its label, its vertical coordinate system or its name."""
    if raster.units[0]:
        return str(raster.units[0])
    if raster.driver == "PDS":
        label = ":".join(next(iter(raster.tags(ns="json:PDS").items()), ("{}",)))
        return str(json.loads(label).get("IMAGE", {}).get("UNIT", "")).strip('"')
    return "m" if str(raster.descriptions[0]).endswith("_m") else ""


def check_count(nodes: float) -> None:
    """Raise DataError for more nodes than are read."""
    if nodes > MOST_NODES:
        raise DataError(
            f"{nodes / 1e6:,.0f} million nodes, and at most {MOST_NODES / 1e6:.0f} million are read; cut out the part "
            "around the drive, or take wider nodes"
        )


def check_blocks(raster: Any, path: str) -> None:
    """Raise DataError where blocks of a raster of GDAL, which are unpacked whole, are too large."""
    for (lines, samples), kind in zip(raster.block_shapes, raster.dtypes, strict=True):
        if lines * samples * np.dtype(kind).itemsize > MOST_BLOCK_BYTES:
            raise DataError(
                f"{path}: is packed in blocks of {lines} x {samples}, too large to be read; write it anew in tiles "
                "(gdal_translate -co TILED=YES)"
            )


def _band(raster: Any, number: int) -> tuple[FloatArray, str]:
    """A band in its unit, NaN where it has no data (ny, nx), and which numbers stood for that unnamed."""
    values, note = without_markers(raster.read(number, masked=True).astype(float).filled(np.nan))
    scale, offset = raster.scales[number - 1], raster.offsets[number - 1]
    return np.asarray(values if (scale, offset) == (1.0, 0.0) else scale * values + offset), note


def grid_of_raster(read: HeightRaster, *, onto: str, values: bool) -> HeightGrid:
    """The grid of a raster, on square cells of metres; `values` that are no heights are not interpolated."""
    raster, done = read.in_metres(onto, nearest=values)
    bands, across = dict(raster.bands), raster.transform
    y0 = across.f + 0.5 * across.e
    if across.e < 0:
        bands = {name: band[::-1] for name, band in bands.items()}
        y0 += across.e * (raster.shape[0] - 1)
    height = bands.pop(HEIGHT)
    for name in {*bands} - {*ERROR_LAYERS} if raster is not read else ():
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
        crs_of_file=read.crs,
        unit=raster.unit,
        read_as=tuple(filter(None, (raster.note, done))),
        beside=raster.beside,
    )
