"""Planned paths as GeoJSON, for maps of other programs."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.projections import MapProjection
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.routes.planner import PlannedPath

EVERY_M = 0.5
LOCAL = "local frame of the terrain, x and y in m"


def path_geojson(path: PlannedPath) -> bytes:
    """A FeatureCollection: the path as a line, start and target as points, and what is kept out of as points.

    Coordinates are longitude and latitude, as RFC 7946 has them, where the terrain has a coordinate system; these are
    on the body that the member `body` names, not on WGS 84. Elsewhere they are m, and a member `crs` says so. Each
    feature also has `x_m` and `y_m` of its first place.
    """
    plan = path.plan
    projection = MapProjection(plan.crs) if plan.crs else None
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
    where: dict[str, Any] = {"crs": {"type": "name", "properties": {"name": LOCAL}}}
    if projection is not None:
        radius, flattening = projection.ellipsoid
        where = {"body": {"equatorial_radius_m": radius, "flattening": flattening, "map": projection.name}}
    document = {"type": "FeatureCollection", "features": features} | where
    return (json.dumps(document, sort_keys=True, allow_nan=False) + "\n").encode()


def _feature(
    kind: str, places_m: FloatArray, properties: Mapping[str, Any], projection: MapProjection | None
) -> dict[str, Any]:
    shown = places_m if projection is None else projection.lonlat(*places_m.T)
    coordinates = shown.tolist() if kind == "LineString" else shown[0].tolist()
    own = {name: None if isinstance(value, float) and not math.isfinite(value) else value
           for name, value in properties.items()}  # fmt: skip
    place = {"x_m": float(places_m[0, 0]), "y_m": float(places_m[0, 1])}
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": own | place}
