"""Lines on the ground: read from text and GeoJSON, and the nodes of an elevation model about them."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.images.elevation import ElevationModel
from lunarsci.io.inputs import read_input, read_json


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unrolled:
    """Nodes about a line, by their way along it and their distance to the left of it, in the order of the way. (n,)"""

    along: FloatArray
    across: FloatArray
    height: FloatArray
    sigma: FloatArray

    def between(self, low_m: float, high_m: float) -> "Unrolled":
        """Nodes from one place along the line to another."""
        return self.only(slice(*np.searchsorted(self.along, (low_m, high_m))))

    def only(self, part: slice | BoolArray) -> "Unrolled":
        """Some of the nodes."""
        return Unrolled(
            along=self.along[part], across=self.across[part], height=self.height[part], sigma=self.sigma[part]
        )

    def with_sigma(self) -> "Unrolled":
        """Unknown errors as the median of the known ones, 0 where none is known."""
        known = np.isfinite(self.sigma)
        middle = float(np.median(self.sigma[known])) if known.any() else 0.0
        return Unrolled(
            along=self.along, across=self.across, height=self.height, sigma=np.where(known, self.sigma, middle)
        )


def read_line(given: str) -> FloatArray:
    """Corners of a line: x1,y1,x2,y2,... as text, or a GeoJSON file with a LineString. (n, 2) [m]

    Raises ParameterError for text that is no line, DataError for a file without one.
    """

    if not given.lower().endswith((".json", ".geojson")):
        try:
            numbers = np.array([float(part) for part in given.split(",")])
        except ValueError as error:
            raise ParameterError(f"'{given}' is no line; give x1,y1,x2,y2,... in m, or a GeoJSON file") from error
        return _checked_line(given, numbers.reshape(-1, 2) if numbers.size % 2 == 0 else numbers[:, None])
    content: Any = read_json(read_input(given), "a GeoJSON line", lambda found: found)
    line = next(_line_strings(content), None)
    if line is None:
        raise DataError(f"{given}: no LineString in it; draw the track as one line")
    try:
        return _checked_line(given, np.array([point[:2] for point in line], dtype=float))
    except (TypeError, ValueError) as error:
        raise DataError(f"{given}: its LineString is no list of x, y in m ({error})") from error


def _line_strings(content: Any) -> Iterator[Any]:
    if isinstance(content, dict):
        if content.get("type") == "LineString":
            yield content.get("coordinates", [])
        for key in ("geometry", "features", "geometries"):
            yield from _line_strings(content.get(key))
    elif isinstance(content, list):
        for part in content:
            yield from _line_strings(part)


def _checked_line(name: str, points: FloatArray) -> FloatArray:
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ParameterError(f"'{name}' is no line; give two or more pairs x,y of finite numbers in m")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not (steps > 0).all():
        raise ParameterError(f"'{name}': two corners of the line are one place; leave one out")
    return points


def places_on(line: FloatArray, along: FloatArray, left: FloatArray) -> FloatArray:
    """Points by their way along a line and their distance to the left of it. (n, 2) [m]"""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    segment = np.clip(np.searchsorted(way, along, side="right") - 1, 0, len(line) - 2)
    direction = np.diff(line, axis=0)[segment] / np.diff(way)[segment, None]
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    return np.asarray(line[segment] + (along - way[segment])[:, None] * direction + left[:, None] * normal)


def unrolled(model: ElevationModel, line: FloatArray, reach_m: float) -> Unrolled:
    """Known nodes within `reach_m` of a line, each by its nearest segment."""
    x, y = np.meshgrid(model.x_m, model.y_m)
    low, high = line.min(axis=0) - reach_m, line.max(axis=0) + reach_m
    near = np.isfinite(model.height_m) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    points = np.column_stack([x[near], y[near]])
    best, along, across = (np.full(len(points), value) for value in (np.inf, np.nan, np.nan))
    way = 0.0
    for start, end in itertools.pairwise(line):
        length = float(np.linalg.norm(end - start))
        direction = (end - start) / length
        offset = points - start
        forward, left = offset @ direction, offset @ np.array([-direction[1], direction[0]])
        beyond = np.maximum(np.maximum(-forward, forward - length), 0.0)
        distance = np.hypot(beyond, left)
        # Beyond the ends of the line nodes keep their place along it, so that windows there are whole.
        nearer = distance < best
        best[nearer], along[nearer], across[nearer] = distance[nearer], way + forward[nearer], left[nearer]
        way += length
    kept = np.flatnonzero(np.abs(across) <= reach_m)
    kept = kept[np.argsort(along[kept], kind="stable")]
    sigma = model.layer("height_m_sigma")[near]
    return Unrolled(along=along[kept], across=across[kept], height=model.height_m[near][kept], sigma=sigma[kept])
