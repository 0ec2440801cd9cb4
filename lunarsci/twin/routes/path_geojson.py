"""Planned paths as GeoJSON, for maps of other programs."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.heights.projections import MapProjection, projection_or_none
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.routes.planner import PlannedPath

EVERY_M, NEAR_M = 0.5, 10.0
LOCAL = "local frame of the terrain, x and y in m"


def path_geojson(path: PlannedPath, surface: Traversability) -> bytes:
    """A FeatureCollection: path, start, target, what is kept out of, and the hazards near the path as polygons.

    Coordinates are longitude and latitude, as RFC 7946 has them, where the terrain has a coordinate system (and
    rasterio is there); these are on the body that the member `body` names, not on WGS 84. Elsewhere they are m, and a
    member `crs` says so. Each feature also has `x_m` and `y_m` of its first place.
    """
    plan = path.plan
    projection = projection_or_none(plan.crs)
    places = planned_pose(plan, np.linspace(0.0, plan.length_m, max(2, math.ceil(plan.length_m / EVERY_M) + 1)))[:, :2]
    line = {"name": plan.name, "length_m": plan.length_m, "speed_m_s": plan.speed_m_s, "arcs": len(plan.legs)}
    line |= {"max_slope_deg": path.max_slope_deg, "cost_m": path.cost_m}
    features = [
        _feature("LineString", places, {"role": "path"} | line, projection),
        _feature("Point", places[:1], {"role": "start", "heading_deg": plan.heading_deg}, projection),
        _feature("Point", np.array([path.target_m]), {"role": "target"}, projection),
        *(
            _feature("Point", np.array([(zone.x_m, zone.y_m)]),
                     {"role": "keep_out", "name": zone.name, "radius_m": zone.radius_m}, projection)
            for zone in plan.exclusion_zones
        ),
    ]  # fmt: skip
    if rings := hazard_rings(path, surface):
        shown = [[_shown(ring, projection).tolist()] for ring in rings]
        shape = {"type": "MultiPolygon", "coordinates": shown}
        features.append({"type": "Feature", "geometry": shape, "properties": {"role": "hazards"}})
    where: dict[str, Any] = {"crs": {"type": "name", "properties": {"name": LOCAL}}}
    if projection is not None:
        radius, flattening = projection.ellipsoid
        where = {"body": {"equatorial_radius_m": radius, "flattening": flattening, "map": projection.name}}
    document = {"type": "FeatureCollection", "features": features} | where
    return (json.dumps(document, sort_keys=True, allow_nan=False) + "\n").encode()


def hazard_rings(path: PlannedPath, surface: Traversability) -> list[FloatArray]:
    """Rectangles that hold the hazards within 10 m of the box about a path: one for each run of nodes in a row. [m]

    Each node stands for its square; rings are closed and go to the left. (5, 2)
    """
    terrain, plan = surface.terrain, path.plan
    places = planned_pose(plan, np.linspace(0.0, plan.length_m, 1000))[:, :2]
    low, high = places.min(axis=0) - NEAR_M, places.max(axis=0) + NEAR_M
    columns, rows = (
        slice(*np.searchsorted(axis, (first, last)))
        for axis, first, last in zip((terrain.x_m, terrain.y_m), low, high, strict=True)
    )
    hazard, half = surface.hazard[rows, columns].astype(np.int8), 0.5 * terrain.spacing_m
    steps = np.diff(hazard, axis=1, prepend=0, append=0)
    (row, first), (_, last) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    south = terrain.y_m[rows][row] - half
    west, east = (terrain.x_m[columns.start] - half + terrain.spacing_m * column for column in (first, last))
    north = south + terrain.spacing_m
    corners = ((west, south), (east, south), (east, north), (west, north), (west, south))
    return list(np.stack([np.stack(pair, axis=-1) for pair in corners], axis=1))


def _shown(places_m: FloatArray, projection: MapProjection | None) -> FloatArray:
    return places_m if projection is None else projection.lonlat(*places_m.T)


def _feature(
    kind: str, places_m: FloatArray, properties: Mapping[str, Any], projection: MapProjection | None
) -> dict[str, Any]:
    shown = _shown(places_m, projection)
    coordinates = shown.tolist() if kind == "LineString" else shown[0].tolist()
    own = {name: None if isinstance(value, float) and not math.isfinite(value) else value
           for name, value in properties.items()}  # fmt: skip
    place = {"x_m": float(places_m[0, 0]), "y_m": float(places_m[0, 1])}
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": own | place}
