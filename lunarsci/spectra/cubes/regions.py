"""Which pixels of a cube are wanted: a box, a polygon on the ground, a mask, every n-th."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import DataError, RequestError
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import read_input, text
from lunarsci.spectra.cubes.cube import Cube, PixelFrame, Source
from lunarsci.spectra.cubes.rasters import plane_of

MOON_LONGLAT = f"+proj=longlat +R={1e3 * MOON_RADIUS_KM:.0f} +no_defs"
_BOX = re.compile(r"\s*(\d*)\s*:\s*(\d*)\s*,\s*(\d*)\s*:\s*(\d*)\s*")
_LINES_AT_ONCE = 512
_EDGE_PARTS = 64
_TOUCHED = 1e-6
_JUMP = 30.0
"""Times the usual step along an edge that is a jump from one end of a map to the other; assumed."""

Ring = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Region:
    """Lines and samples from `first` up to `last` of each, every `step`-th, less what polygon and mask leave out.

    `polygons` : rings of each, in samples and lines where the cube has a frame, else in longitude and latitude, which
    may count from any meridian.
    `mask` : numbers of the cube's size, 0 or missing where a pixel is left out.
    """

    lines: tuple[int, int]
    samples: tuple[int, int]
    step: int = 1
    polygons: tuple[tuple[Ring, ...], ...] = ()
    mask: Source | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples of a map of it."""
        return tuple(-(-(last - first) // self.step) for first, last in (self.lines, self.samples))  # type: ignore[return-value]

    def part(self, rows: range) -> tuple[slice, slice]:
        """Lines and samples of the cube that some rows of the map are from, to be thinned by `step`."""
        first = self.lines[0] + rows.start * self.step
        last = min(self.lines[0] + (rows.stop - 1) * self.step + 1, self.lines[1])
        return slice(first, last), slice(*self.samples)

    def wanted(self, cube: Cube, rows: range) -> BoolArray:
        """Whether each pixel of some rows of the map is wanted, (rows, samples)."""
        lines, samples = self.part(rows)
        retained = np.ones((lines.stop - lines.start, samples.stop - samples.start), bool)
        if self.mask is not None:
            values = np.asarray(self.mask.read(lines, samples)[..., 0], float)
            retained &= np.isfinite(values) & (values != 0)
        if self.polygons:
            retained &= self._inside(cube, lines, samples)
        return retained[:: self.step, :: self.step]

    def _inside(self, cube: Cube, lines: slice, samples: slice) -> BoolArray:
        """Pixels within the polygons, (lines, samples); a ring within a ring is a hole."""
        from matplotlib.path import Path as Outline

        points = _places(cube, lines, samples)
        result = np.zeros(len(points), bool)
        for rings in self.polygons:
            parity = np.zeros(len(points), bool)
            for ring in rings:
                outline = np.array(ring)
                about = points if cube.frame is not None else _turned(points, outline)
                parity ^= Outline(outline).contains_points(about)
            result |= parity
        return result.reshape(lines.stop - lines.start, -1)


def _places(cube: Cube, lines: slice, samples: slice) -> FloatArray:
    """Middles of pixels in the coordinates of polygons, (p, 2)."""
    if cube.frame is not None:
        s, row = np.meshgrid(np.arange(samples.start, samples.stop) + 0.5, np.arange(lines.start, lines.stop) + 0.5)
        return np.stack([s.ravel(), row.ravel()], axis=1)
    planes = [cube.backplanes[name].read(lines, samples).ravel() for name in ("longitude", "latitude")]
    return np.stack(planes, axis=1)


def _turned(places: FloatArray, ring: FloatArray) -> FloatArray:
    """Longitude, less whole turns, within half a turn of the middle of a ring, and latitude. (p, 2) [deg]"""
    west = 0.5 * (ring[:, 0].min() + ring[:, 0].max()) - 180.0
    return np.stack([(places[:, 0] - west) % 360.0 + west, places[:, 1]], axis=1)


def region_of(cube: Cube, roi: str | None = None, mask: str | None = None, every: int = 1) -> Region:
    """The wanted part of a cube.

    Parameters
    ----------
    roi : `x0:x1,y0:y1` in samples and lines from 0, ends not included and either left out for the edge; or a GeoJSON
        file with polygons in longitude and latitude. [deg]
    mask : image of the same size, 0 or no value where a pixel is left out.
    every : n, for every n-th line and sample.

    Raises RequestError for a box that is none, DataError for files that do not fit the cube.
    """
    source = None
    if mask is not None:
        source, shape = plane_of(mask)
        if shape != cube.shape:
            raise DataError(f"{mask}: has {_size(shape)}, the cube has {_size(cube.shape)}; a mask is of its size")
    if roi is None:
        return Region((0, cube.shape[0]), (0, cube.shape[1]), every, mask=source)
    if box := _BOX.fullmatch(roi):
        (s0, s1), (line0, line1) = _span(box.group(1, 2), cube.shape[1]), _span(box.group(3, 4), cube.shape[0])
        if 0 <= s0 < s1 <= cube.shape[1] and 0 <= line0 < line1 <= cube.shape[0]:
            return Region((line0, line1), (s0, s1), every, mask=source)
    if not Path(roi).is_file():
        raise RequestError(
            f"`roi` {roi}: is neither a box of samples and lines, at most 0:{cube.shape[1]},0:{cube.shape[0]}, nor a "
            "GeoJSON file"
        )
    polygons = _polygons(cube, roi)
    lines, samples = _bounds(cube, polygons, roi)
    return Region(lines, samples, every, polygons, source)


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[0]} lines and {shape[1]} samples"


def _span(ends: Any, size: int) -> tuple[int, int]:
    return int(ends[0] or 0), int(ends[1] or size)


def _polygons(cube: Cube, file: str) -> tuple[tuple[Ring, ...], ...]:
    """Rings of the polygons of a GeoJSON file, in the coordinates of `Region.polygons`. DataError without any."""
    try:
        result = list(_rings(json_document(text(read_input(file)))))
        rings = [[np.array(ring, float)[:, :2] for ring in polygon] for polygon in result]
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise DataError(
            f"{file}: is no GeoJSON with polygons ({error}); give one, or a box of samples and lines"
        ) from error
    corners = [ring for polygon in rings for ring in polygon]
    if not rings or any(len(ring) < 3 or not (np.abs(ring) <= (360, 90)).all() for ring in corners):
        raise DataError(f"{file}: has no polygon in degrees; a region is a Polygon or MultiPolygon on the Moon")
    if "longitude" not in cube.backplanes:
        _frame(cube)
    if cube.frame is None:
        return tuple(tuple(tuple((float(x), float(y)) for x, y in ring) for ring in polygon) for polygon in rings)
    placed = [
        tuple(_on_cube(cube, ring + turn, file) for ring in polygon) for polygon in rings for turn in _turns(cube)
    ]
    return tuple(polygon for polygon in placed if _about(cube, polygon))


def _turns(cube: Cube) -> FloatArray:
    """Whole turns by which a polygon is tried: on a map in degrees it may lie on both sides of the edge. (t, 2)"""
    turns = np.arange(-2, 3) if _system(cube).is_geographic else np.zeros(1)
    return np.stack([360.0 * turns, 0.0 * turns], axis=1)


def _rings(item: Any) -> Iterator[Any]:
    """Rings of every polygon of a GeoJSON object."""
    if item["type"] == "FeatureCollection":
        for feature in item["features"]:
            yield from _rings(feature)
    elif item["type"] == "Feature":
        yield from _rings(item["geometry"])
    elif item["type"] == "GeometryCollection":
        for geometry in item["geometries"]:
            yield from _rings(geometry)
    elif item["type"] == "Polygon":
        yield item["coordinates"]
    elif item["type"] == "MultiPolygon":
        yield from item["coordinates"]


def _on_cube(cube: Cube, ring: FloatArray, file: str) -> Ring:
    """A ring in samples and lines of a cube that has a frame."""
    closed = ring if (ring[0] == ring[-1]).all() else np.vstack([ring, ring[:1]])
    share = np.linspace(0, 1, _EDGE_PARTS, endpoint=False)[:, None]
    edges = np.vstack([a + share * (b - a) for a, b in pairwise(closed)])
    s, line = pixels_at(cube, edges[:, 0], edges[:, 1], file)
    steps = np.hypot(np.diff(s, append=s[0]), np.diff(line, append=line[0])).reshape(-1, _EDGE_PARTS)
    if (steps.max(axis=1) > np.maximum(_JUMP * np.median(steps, axis=1), 0.5 * max(cube.shape))).any():
        raise DataError(
            f"{file}: reaches over the edge of the cube's map projection; end it short of there, or give x0:x1,y0:y1"
        )
    return tuple(zip(s.tolist(), line.tolist(), strict=True))


def pixels_at(cube: Cube, longitude: FloatArray, latitude: FloatArray, file: str) -> tuple[FloatArray, FloatArray]:
    """Samples and lines, in parts of pixels from the first corner, of places on a cube that has a frame."""
    x, y = _projected(cube, longitude, latitude, file)
    a, b, c, d, e, f = _frame(cube).transform
    determinant = a * e - b * d
    return (e * (x - c) - b * (y - f)) / determinant, (a * (y - f) - d * (x - c)) / determinant


def _frame(cube: Cube) -> PixelFrame:
    """Where its pixels lie. Raises DataError for a cube that does not say."""
    if cube.frame is None or not cube.frame.crs_wkt:
        raise DataError(f"{cube.name}: has no place on the Moon that a polygon could mean; give `roi` x0:x1,y0:y1")
    return cube.frame


def _system(cube: Cube) -> Any:
    """The coordinate system of a cube's frame, of rasterio."""
    from rasterio.crs import CRS

    return CRS.from_wkt(_frame(cube).crs_wkt)


def _projected(cube: Cube, longitude: FloatArray, latitude: FloatArray, file: str) -> tuple[FloatArray, FloatArray]:
    """x and y in the system of the cube's frame, of longitudes and latitudes. [deg]"""
    from rasterio.errors import RasterioError
    from rasterio.warp import transform

    system = _system(cube)
    if system.is_geographic:
        return longitude, latitude
    try:
        x, y = transform(MOON_LONGLAT, system, longitude.tolist(), latitude.tolist())
    except (RasterioError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{file}: cannot be brought to the cube's coordinate system ({reason})") from error
    return np.asarray(x, float), np.asarray(y, float)


def _about(cube: Cube, polygon: Sequence[Ring]) -> tuple[tuple[int, int], ...]:
    """Samples and lines about a polygon, first and after the last; empty where it does not touch the cube."""
    corners = np.array([corner for ring in polygon for corner in ring])
    # Of a pixel that is touched by rounding alone the middle lies outside.
    low, high = np.floor(corners.min(axis=0) + _TOUCHED), np.ceil(corners.max(axis=0) - _TOUCHED)
    spans = [(max(int(a), 0), min(int(b), size)) for a, b, size in zip(low, high, cube.shape[::-1], strict=True)]
    return tuple(spans) if all(first < last for first, last in spans) else ()


def _bounds(cube: Cube, polygons: Sequence[Sequence[Ring]], file: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Lines and samples about the polygons. Raises DataError where none of them touches the cube."""
    if cube.frame is not None and polygons:
        spans = np.array([_about(cube, polygon) for polygon in polygons])
        (s0, line0), (s1, line1) = spans[..., 0].min(axis=0).tolist(), spans[..., 1].max(axis=0).tolist()
        return (line0, line1), (s0, s1)
    whole = Region((0, cube.shape[0]), (0, cube.shape[1]), 1, tuple(map(tuple, polygons)))
    rows, columns = np.zeros(cube.shape[0], bool), np.zeros(cube.shape[1], bool)
    for first in range(0, cube.shape[0] if polygons else 0, _LINES_AT_ONCE):
        part = range(first, min(first + _LINES_AT_ONCE, cube.shape[0]))
        inside = whole.wanted(cube, part)
        rows[part.start : part.stop] = inside.any(axis=1)
        columns |= inside.any(axis=0)
    if not rows.any():
        raise DataError(f"{file}: lies beside the cube {cube.name}")
    result = [np.flatnonzero(seen) for seen in (rows, columns)]
    return (int(result[0][0]), int(result[0][-1]) + 1), (int(result[1][0]), int(result[1][-1]) + 1)
