"""Ground to keep out of: circles, of a plan or of a file such as the rocks that `images rocks` finds."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.heights.projections import MapProjection
from lunarsci.io.inputs import InputFile, read_json
from lunarsci.twin.ground.terrain import Terrain

ROUND = 0.6
"""Share of the circle about a polygon that it must fill to be taken for that circle; assumed."""
FINEST = 64
"""Squares along the longer side of a polygon, at most, that circles stand for."""
NEAR_M = 3.0
"""Circles farther from a way than this, and a rover, are of no account for it; assumed. [m]"""


FARTHEST_M = 1.1e7
"""Once round the Moon, of 1737.4 km radius (Archinal et al. 2018, 10.1007/s10569-017-9805-5). [m]"""


@dataclass(frozen=True, slots=True)
class ExclusionZone:
    """A circle that no part of the rover may enter: name, centre [m] and radius > 0 [m]. Raises ParameterError."""

    name: str
    x_m: float
    y_m: float
    radius_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x_m) and math.isfinite(self.y_m)):
            raise ParameterError(f"keep_out '{self.name}' needs finite x_m and y_m")
        if not 0 < self.radius_m < math.inf:
            raise ParameterError(f"keep_out '{self.name}' has radius_m {self.radius_m}; give a radius above 0 m")


Zones = tuple[ExclusionZone, ...]


def read_keep_outs(source: InputFile, crs: str = "") -> Zones:
    """Circles of a GeoJSON file, in the coordinates of the terrain, in m.

    Coordinates are those of the terrain. Where this has a coordinate system (`crs`, well-known text) they are longitude
    and latitude on its body, as RFC 7946 has them, unless the file has a member `crs`.

    A feature with `x_m`, `y_m` and `keepout_m`, as `images rocks` writes it, is that circle; a point needs
    `keepout_m` or `radius_m`. A round polygon is the circle about it, another one is covered with circles. Raises
    DataError.
    """
    return read_json(source, "a GeoJSON file of ground to keep out of", lambda document: _zones(document, crs))


def _zones(document: Any, crs: str) -> Zones:
    features = document.get("features") if isinstance(document, Mapping) else None
    if not isinstance(features, Sequence) or isinstance(features, str):
        raise ParameterError("no FeatureCollection; `lunarsci images rocks -o rocks.geojson` writes one")
    projection = MapProjection(crs) if crs and "crs" not in document else None
    return tuple(zone for number, feature in enumerate(features, 1) for zone in _zones_of(feature, number, projection))


def _on_map(coordinates: Any, projection: MapProjection | None) -> FloatArray:
    """Places (n, 2) in m, from such or from longitude and latitude."""
    places = np.array(coordinates, dtype=float).reshape(-1, np.shape(coordinates)[-1])[:, :2]
    try:
        return places if projection is None else projection.metres(*places.T)
    except ParameterError as error:
        raise ParameterError(f"{error}; or say with a member 'crs' that coordinates are m of the map") from error


def _zones_of(feature: Any, number: int, projection: MapProjection | None) -> Iterator[ExclusionZone]:
    if not isinstance(feature, Mapping) or not isinstance(feature.get("geometry"), Mapping):
        raise ParameterError(f"feature {number} has no geometry")
    own, shape = feature.get("properties") or {}, feature["geometry"]
    name = str(own.get("name", f"rock {own['id']}" if "id" in own else f"keep-out {number}"))
    try:
        if {"x_m", "y_m", "keepout_m"} <= set(own):
            yield ExclusionZone(name, *(float(own[key]) for key in ("x_m", "y_m", "keepout_m")))
        elif shape["type"] == "Point":
            x, y = _on_map([shape["coordinates"]], projection)[0]
            yield ExclusionZone(
                name, float(x), float(y), float(own["keepout_m"] if "keepout_m" in own else own["radius_m"])
            )
        elif shape["type"] in ("Polygon", "MultiPolygon"):
            for part in [shape["coordinates"]] if shape["type"] == "Polygon" else shape["coordinates"]:
                yield from _covering(name, _on_map(part[0], projection))
        else:
            raise ParameterError(f"feature {number} is a {shape['type']}; give points with keepout_m, or polygons")
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"feature {number} ('{name}'): {error}") from error


def _covering(name: str, ring: FloatArray) -> Iterator[ExclusionZone]:
    """Circles that together hold a polygon (n, 2). [m]"""
    corners = ring[:-1] if len(ring) > 1 and (ring[0] == ring[-1]).all() else ring
    if len(corners) < 3 or not np.isfinite(corners).all():
        raise ParameterError("a polygon needs three corners or more, in m")
    if np.abs(corners).max() > FARTHEST_M:
        raise ParameterError(f"a polygon has a corner at {np.abs(corners).max():g} m, farther than the Moon goes round")
    x, y = corners.T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = 0.5 * (low + high)
    reach = float(np.hypot(*(corners - middle).T).max())
    if area > ROUND * math.pi * reach**2:
        yield ExclusionZone(name, float(middle[0]), float(middle[1]), reach)
        return
    side = max(math.sqrt(area) / 8, float((high - low).max()) / FINEST)
    counts = np.ceil((high - low) / side).astype(int) + 1
    places = low + side * np.stack(np.meshgrid(*(np.arange(n) for n in counts)), axis=-1).reshape(-1, 2)
    # A square with a point of the polygon has its middle inside, or within half a diagonal of an edge.
    near = _inside(places, corners) | (_off_edges(places, corners) <= side / math.sqrt(2))
    for place in places[near]:
        yield ExclusionZone(name, float(place[0]), float(place[1]), side / math.sqrt(2))


def _inside(places: FloatArray, corners: FloatArray) -> BoolArray:
    odd = np.zeros(len(places), dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if ay != by:
            crosses = (ay > places[:, 1]) != (by > places[:, 1])
            odd ^= crosses & (places[:, 0] < ax + (places[:, 1] - ay) * (bx - ax) / (by - ay))
    return odd


def _off_edges(places: FloatArray, corners: FloatArray) -> FloatArray:
    found = np.full(len(places), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        way = b - a
        share = np.clip((places - a) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(places - a - share[:, None] * way, axis=1))
    return found


def within(zones: Zones, terrain: Terrain) -> BoolArray:
    """Nodes of a terrain that lie in a circle. (ny, nx)"""
    inside = np.zeros(terrain.height_m.shape, dtype=bool)
    x, y = terrain.x_m, terrain.y_m
    for zone in zones:
        columns, rows = (
            slice(*np.searchsorted(axis, (at - zone.radius_m, at + zone.radius_m)))
            for axis, at in ((x, zone.x_m), (y, zone.y_m))
        )
        inside[rows, columns] |= np.hypot(x[None, columns] - zone.x_m, y[rows, None] - zone.y_m) <= zone.radius_m
    return inside


def near_way(zones: Zones, places_m: FloatArray) -> Zones:
    """The circles that a rover may come near to whose origin passes places (n, 2). [m]"""
    return tuple(
        zone for zone in zones if np.hypot(*(places_m - (zone.x_m, zone.y_m)).T).min() <= NEAR_M + zone.radius_m
    )
