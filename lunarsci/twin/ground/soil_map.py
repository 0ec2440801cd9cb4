"""What is believed of the soil at every place: beliefs of the zones that were driven, blended over the ground.

The transforms of the soil parameters are a Gaussian process over the plane: by the first laws everywhere, with the
correlation exp(-d / L) between places d apart. Zones are data whose values are known as well as their beliefs say. The
blend is simple kriging (Rasmussen & Williams 2006, Gaussian Processes for Machine Learning, ch. 2, eq. 2.23-2.24, with
the exponential kernel, eq. 4.18) with, as in a moving neighbourhood, the few zones nearest to a node, each taken at
its place nearest to the node. Within the track of the rover the belief is the zone's own; far from all zones it is
that of the first laws: in space, this is how a belief is forgotten.

A map is kept as JSON with the beliefs of the zones and their places. Laid over a terrain it is the median soil and what
is known of it at every node, and grounds drawn from it.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile, read_json
from lunarsci.ranges import NOT_NEGATIVE, POSITIVE, check_range, check_ranges
from lunarsci.regolith.belief import SoilBelief, belief_of, effective_rows
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, values_of
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain

CORRELATION_M = 5.0
"""Distance over which soils resemble each other, where none is given; assumed."""
REACH_M = 0.6
"""Half the width of ground that a drive of Yutu-2 speaks of: 0.45 m to a wheel's middle, and the wheel's 0.15 m. With
another rover `update` takes that of its wheels. [m]"""
NEIGHBOURS = 4
"""Zones that a node looks at, the nearest ones. Of ten zones in a row means at places about them are off by 0.04 of the
first laws' widths from those by all of them, rms, as measured (`test_the_nearest_zones_stand_for_all`)."""
MARGIN_M, NODES_ABOUT = 3.0, 120
"""Ground that pictures show about the zones [m], and nodes of its longer side."""
NUGGET = 1e-9
NEAREST_M = 1e-9
NODES_AT_ONCE = 16_384
HISTORY_SHARE = 0.05
"""Share of a zone in a blend from which on its drives are named in the history of it; assumed."""
SCHEMA = "lunarsci/soil-map/1"
PAIRED_AT_ONCE = 256
"""Draws of a population that are paired with others at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Zone:
    """Ground of one soil that was driven.

    Attributes
    ----------
    name : of the drive, and of the stretch.
    place_m : places of the rover's origin, some decimetres apart at most. (k, 2) [m]
    belief : of the soil there.

    Raises ParameterError for places that are not finite, or none.
    """

    name: str
    place_m: FloatArray
    belief: SoilBelief

    def __post_init__(self) -> None:
        shape = self.place_m.shape
        if shape[1:] != (2,) or not shape[0] or not np.isfinite(self.place_m).all():
            raise ParameterError(f"zone '{self.name}' has places of shape {shape}; give finite x and y of each")


@dataclass(frozen=True, slots=True, eq=False)
class Blend:
    """How the soil at some nodes follows from zones.

    Attributes
    ----------
    zone : which zones each node looks at. (n, j)
    share : of each of them in the mean, 1 where the node lies in its track. (n, j)
    correlation : of the places at which they are taken. (n, j, j)
    unknown : share of the first laws' variance that no zone takes away, 0 to 1. (n,)
    """

    zone: IntArray
    share: FloatArray
    correlation: FloatArray
    unknown: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoilMap:
    """Beliefs with places.

    Attributes
    ----------
    laws : the first laws, which hold where nothing was driven; those of every zone.
    correlation_m : distance L of the kernel exp(-d / L), above 0. [m]
    reach_m : half the width of ground that a zone's belief holds for as it is, 0 or more. [m]
    zones : oldest first.

    Raises ParameterError.
    """

    laws: Mapping[str, Law] = field(default_factory=default_prior)
    correlation_m: float = CORRELATION_M
    reach_m: float = REACH_M
    zones: tuple[Zone, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self, {POSITIVE: "correlation_m", NOT_NEGATIVE: "reach_m"}, "the map's")
        for zone in self.zones:
            if dict(zone.belief.laws) != dict(self.laws):
                raise ParameterError(f"zone '{zone.name}' began with other first priors than the map's")

    @property
    def center(self) -> FloatArray:
        """Mean of the first laws. (8,)"""
        return np.array([self.laws[name].center for name in PARAMETERS])

    @property
    def width(self) -> FloatArray:
        """Standard deviations of the first laws. (8,)"""
        return np.array([self.laws[name].width for name in PARAMETERS])

    def blend(self, place_m: FloatArray) -> Blend:
        """How the soil at places (n, 2) follows from the zones."""
        parts = [self._blend(place_m[k : k + NODES_AT_ONCE]) for k in range(0, max(len(place_m), 1), NODES_AT_ONCE)]
        columns = zip(*((part.zone, part.share, part.correlation, part.unknown) for part in parts), strict=True)
        return Blend(*(np.concatenate(column) for column in columns))

    def _blend(self, place_m: FloatArray) -> Blend:
        n, j = len(place_m), min(len(self.zones), NEIGHBOURS)
        if not j:
            return Blend(np.zeros((n, 0), dtype=np.int64), np.zeros((n, 0)), np.zeros((n, 0, 0)), np.ones(n))
        distance, nearest = self._nearest(place_m)
        # Of zones equally near the latest counts.
        zone = np.lexsort((np.broadcast_to(-np.arange(len(self.zones)), distance.shape), distance), axis=1)[:, :j]
        distance = np.take_along_axis(distance, zone, axis=1)
        nearest = np.take_along_axis(nearest, zone[..., None], axis=1)
        within = np.minimum(1.0, self.reach_m / np.maximum(distance, NEAREST_M))
        taken = nearest + within[..., None] * (place_m[:, None] - nearest)
        gap = np.linalg.norm(taken[:, :, None] - taken[:, None], axis=-1)
        correlation = np.exp(-gap / self.correlation_m)
        to_place = np.exp(-np.maximum(distance - self.reach_m, 0.0) / self.correlation_m)
        share = np.linalg.solve(correlation + NUGGET * np.eye(j), to_place[..., None])[..., 0]
        inside = distance[:, 0] <= self.reach_m
        share[inside] = np.eye(j)[0]
        unknown = np.where(inside, 0.0, np.clip(1.0 - (to_place * share).sum(axis=1), 0.0, 1.0))
        return Blend(zone, share, correlation, unknown)

    def _nearest(self, place_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance to every zone, (n, zones), and its nearest place, (n, zones, 2)."""
        by_zone = [(zone.place_m, *cKDTree(zone.place_m).query(place_m)) for zone in self.zones]
        distance = np.column_stack([distance for _, distance, _ in by_zone])
        return distance, np.stack([places[index] for places, _, index in by_zone], axis=1)

    def moments(self, place_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n, 8) and covariance (n, 8, 8) of the transforms at places (n, 2).

        The covariance is sum_ij share_i share_j correlation_ij R_i R_j^T, plus `unknown` times that of the first laws,
        with R the root of a zone's covariance: what two zones do not know they do not know together.
        """
        blend = self.blend(place_m)
        first = np.diag(self.width**2)
        if not self.zones:
            return np.tile(self.center, (len(place_m), 1)), np.tile(first, (len(place_m), 1, 1))
        means = np.array([zone.belief.mean for zone in self.zones]) - self.center
        mean = self.center + np.einsum("nj,njp->np", blend.share, means[blend.zone])
        roots = zone_roots(self)[blend.zone] * blend.share[..., None, None]
        covariance = np.einsum("nij,nipr,njqr->npq", blend.correlation, roots, roots, optimize=True)
        return mean, covariance + blend.unknown[:, None, None] * first

    def spread(self, place_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n, 8) and standard deviation (n, 8) of the transforms at places (n, 2)."""
        mean, deviation = np.empty((len(place_m), len(PARAMETERS))), np.empty((len(place_m), len(PARAMETERS)))
        for k in range(0, len(place_m), NODES_AT_ONCE):
            part = slice(k, k + NODES_AT_ONCE)
            mean[part], covariance = self.moments(place_m[part])
            deviation[part] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        return mean, deviation

    def belief_along(self, place_m: FloatArray) -> SoilBelief:
        """Of the soil at a place picked from these (n, 2) at random: mean and covariance of the mixture over them.

        The discrepancy is that of the zone which counts most there, forgotten as far as none is known.
        """
        mean, covariance = self.moments(place_m)
        off = mean - mean.mean(axis=0)
        mixed = covariance.mean(axis=0) + off.T @ off / len(off)
        blend = self.blend(place_m)
        history, discrepancy = self._history(blend), self._discrepancy(blend)
        return SoilBelief(self.laws, mean.mean(axis=0), 0.5 * (mixed + mixed.T), history, discrepancy=discrepancy)

    def _discrepancy(self, blend: Blend) -> PhysicsDiscrepancy:
        if not self.zones:
            return FIRST
        first = self.zones[int(self._zone_shares(blend).argmax())].belief.discrepancy
        return first.forgotten(float(np.clip(blend.unknown.mean(), 0.0, 1.0)))

    def _zone_shares(self, blend: Blend) -> FloatArray:
        """What each zone counts for, on average over the places. (zones,) [-]"""
        share = np.zeros(len(self.zones))
        np.add.at(share, blend.zone, blend.share / max(len(blend.share), 1))
        return share

    def _history(self, blend: Blend) -> tuple[Mapping[str, Any], ...]:
        share = self._zone_shares(blend)
        entries: list[Mapping[str, Any]] = []
        for zone in (zone for zone, part in zip(self.zones, share, strict=True) if part > HISTORY_SHARE):
            entries.extend(entry for entry in zone.belief.history if entry not in entries)
        return tuple(entries)

    def with_zones(self, zones: Sequence[Zone]) -> "SoilMap":
        """The map after a drive: older zones end within the reach of new ones, whose beliefs rest on theirs."""
        if not zones:
            return self

        tree = cKDTree(np.concatenate([zone.place_m for zone in zones]))
        remaining = []
        for zone in self.zones:
            outside = np.asarray(tree.query(zone.place_m)[0] > self.reach_m)
            if outside.any():
                remaining.append(zone if outside.all() else replace(zone, place_m=zone.place_m[outside]))
        return replace(self, zones=(*remaining, *zones))


def zone_roots(soil_map: SoilMap) -> FloatArray:
    """Roots R of the zones' covariances R R^T, symmetric in widths of the first laws. (z, 8, 8)"""
    width = soil_map.width
    roots = []
    for zone in soil_map.zones:
        values, vectors = np.linalg.eigh(zone.belief.covariance / np.outer(width, width))
        roots.append(width[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
    return np.array(roots).reshape(-1, len(PARAMETERS), len(PARAMETERS))


def ground_about(soil_map: SoilMap, name: str) -> Terrain:
    """Flat ground about the zones, for pictures of a map without its terrain. Raises ParameterError without zones."""
    if not soil_map.zones:
        raise ParameterError("the map has no zone to draw ground about; learn from a drive")
    places = np.concatenate([zone.place_m for zone in soil_map.zones])
    low = places.min(axis=0) - MARGIN_M
    size = places.max(axis=0) + MARGIN_M - low
    spacing = float(size.max() / NODES_ABOUT)
    nx, ny = (max(2, int(np.ceil(length / spacing)) + 1) for length in size)
    flat = np.zeros((ny, nx))
    synthetic = any(bool(entry.get("synthetic")) for zone in soil_map.zones for entry in zone.belief.history)
    x0, y0 = float(low[0]), float(low[1])
    return build_terrain(name, x0, y0, spacing, flat, read_soil("longji"), synthetic=synthetic)


def map_record(soil_map: SoilMap) -> dict[str, Any]:
    """The zones of a map for a page: where they are, what is believed there, and what it rests on."""
    zones = [{"name": f"zone {k}"} | _zone_record(zone) for k, zone in enumerate(soil_map.zones, 1)]
    drives = {str(entry.get("sha256")): str(entry.get("states")) for zone in soil_map.zones
              for entry in zone.belief.history if not entry.get("refused")}  # fmt: skip
    remarks = [
        f"within {soil_map.reach_m:g} m of a zone's way its soil holds as it is; beyond, soils are taken as alike over "
        f"{soil_map.correlation_m:g} m, which is assumed, and far from all zones only the priors are known"
    ]
    synthetic = any(bool(entry.get("synthetic")) for zone in soil_map.zones for entry in zone.belief.history)
    return {
        "correlation_m": soil_map.correlation_m,
        "reach_m": soil_map.reach_m,
        "drives": len(drives),
        "remarks": remarks,
        "synthetic": synthetic,
        "zones": zones,
    }


def _zone_record(zone: Zone) -> dict[str, Any]:
    x, y = zone.place_m[len(zone.place_m) // 2]
    return {
        "stretch": zone.name,
        "x_m": round(float(x), 2),
        "y_m": round(float(y), 2),
        "doubt": zone.belief.doubt,
        "caution": zone.belief.caution,
        "parameters": effective_rows(zone.belief),
    }


def soil_map_bytes(soil_map: SoilMap) -> bytes:
    """As `read_soil_map` reads it; places to a millimetre."""
    document = {
        "schema": SCHEMA,
        "correlation_m": soil_map.correlation_m,
        "reach_m": soil_map.reach_m,
        "laws": {name: asdict(law) for name, law in soil_map.laws.items()},
        "zones": [
            {
                "name": zone.name,
                "x_m": np.round(zone.place_m[:, 0], 3).tolist(),
                "y_m": np.round(zone.place_m[:, 1], 3).tolist(),
                "belief": json.loads(zone.belief.to_json()),
            }
            for zone in soil_map.zones
        ],
    }
    return (json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read_soil_map(source: InputFile) -> SoilMap:
    """Read a soil map. Raises DataError for text that is none."""
    return read_json(source, "a soil map", _soil_map)


def _soil_map(document: Any) -> SoilMap:
    if not isinstance(document, Mapping) or document.get("schema") != SCHEMA:
        raise ParameterError(f"not a soil map; its schema must be {SCHEMA}; `twin update --save-map` writes one")
    try:
        return SoilMap(
            laws={name: Law(**document["laws"][name]) for name in PARAMETERS},
            correlation_m=float(document["correlation_m"]),
            reach_m=float(document["reach_m"]),
            zones=tuple(_zone(entry) for entry in document["zones"]),
        )
    except KeyError as error:
        raise ParameterError(f"no {error} in it") from error
    except (TypeError, ValueError) as error:
        raise ParameterError(str(error)) from error


def _zone(entry: Mapping[str, Any]) -> Zone:
    places = [np.array(entry[key], dtype=np.float64) for key in ("x_m", "y_m")]
    return Zone(name=str(entry["name"]), place_m=np.column_stack(places), belief=belief_of(entry["belief"]))


@dataclass(frozen=True, slots=True, eq=False)
class SoilLayers:
    """What is believed of the soil at the nodes of a terrain.

    Attributes
    ----------
    terrain : with the median of every soil parameter at every node.
    sd_ratio : by parameter, its standard deviation (of the transform) as a share of the first law's: 1 where
        nothing is known. (ny, nx) [-]
    """

    terrain: Terrain
    sd_ratio: Mapping[str, FloatArray]


def soil_layers(soil_map: SoilMap, terrain: Terrain) -> SoilLayers:
    """Lay a soil map over a terrain, whose own soil is not looked at."""
    mean, deviation = soil_map.spread(_nodes(terrain))
    left = deviation / soil_map.width
    shape = terrain.height_m.shape
    return SoilLayers(
        terrain.with_soil(**_by_name(soil_map, mean, shape)),
        {name: left[:, k].reshape(shape) for k, name in enumerate(PARAMETERS)},
    )


@dataclass(frozen=True, slots=True, eq=False)
class DrawnGrounds:
    """Terrains with soils drawn from a map, made when they are asked for.

    Attributes
    ----------
    base : the terrain whose heights they have.
    soil_map, blend : the map, and how the nodes of the terrain follow from it.
    zones : transforms of the zones of each member. (members, zones, 8)
    elsewhere : standard normal numbers of each member, for what no zone tells. (members, 8)
    parameters : soil of each member in the middle (mean of the transforms) of the places asked for, by name. (members,)
    """

    base: Terrain
    soil_map: SoilMap
    blend: Blend
    zones: FloatArray
    elsewhere: FloatArray
    parameters: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(self.zones)

    def terrain(self, member: int) -> Terrain:
        """The ground of one member."""
        points = _fields(self.soil_map, self.blend, self.zones[member], self.elsewhere[member])
        return self.base.with_soil(**_by_name(self.soil_map, points, self.base.height_m.shape))

    def only(self, member: int) -> "DrawnGrounds":
        """One of them alone."""
        part = slice(member, member + 1)
        parameters = {name: values[part] for name, values in self.parameters.items()}
        return replace(self, zones=self.zones[part], elsewhere=self.elsewhere[part], parameters=parameters)


def drawn_grounds(
    soil_map: SoilMap, terrain: Terrain, along_m: FloatArray, members: int, seed: int = 0
) -> DrawnGrounds:
    """Grounds to drive on, drawn from what is believed.

    Parameters
    ----------
    soil_map, terrain : the beliefs, and the heights.
    along_m : places (k, 2) whose mean soil stands for a member in tables: those of the plan.
    members : how many, 1 or more.
    seed : of the draws.

    Every member has one soil in each zone, drawn from its belief (its population, where it has one), and what no zone
    tells is the same draw from the first laws everywhere: at each node the draws have the mean and covariance that
    `SoilMap.moments` says. Raises ParameterError.
    """
    check_range("members", members, "[1, inf)")
    random = np.random.default_rng(seed)
    zones = _zone_draws(soil_map, members, random)
    elsewhere = random.standard_normal((members, len(PARAMETERS)))
    along = soil_map.blend(along_m)
    middle = np.array(
        [_fields(soil_map, along, drawn, left).mean(axis=0) for drawn, left in zip(zones, elsewhere, strict=True)]
    )
    values = values_of(soil_map.laws, middle)
    parameters = {name: values[:, k] for k, name in enumerate(PARAMETERS)}
    return DrawnGrounds(terrain, soil_map, soil_map.blend(_nodes(terrain)), zones, elsewhere, parameters)


def _nodes(terrain: Terrain) -> FloatArray:
    x, y = np.meshgrid(terrain.x_m, terrain.y_m)
    return np.column_stack([x.ravel(), y.ravel()])


def _by_name(soil_map: SoilMap, transforms: FloatArray, shape: tuple[int, ...]) -> dict[str, FloatArray]:
    values = values_of(soil_map.laws, transforms)
    return {name: values[:, k].reshape(shape) for k, name in enumerate(PARAMETERS)}


def _fields(soil_map: SoilMap, blend: Blend, zones: FloatArray, elsewhere: FloatArray) -> FloatArray:
    """Transforms at the nodes of a blend, for one draw of every zone (z, 8) and of elsewhere (8,). (n, 8)"""
    center, width = soil_map.center, soil_map.width
    points = center + np.sqrt(blend.unknown)[:, None] * (width * elsewhere)
    for k in range(blend.zone.shape[1]):
        points += blend.share[:, k, None] * (zones - center)[blend.zone[:, k]]
    return np.asarray(points)


def _zone_draws(soil_map: SoilMap, members: int, random: np.random.Generator) -> FloatArray:
    """Transforms of every zone. (members, zones, 8)"""
    count = len(soil_map.zones)
    if not count:
        return np.zeros((members, 0, len(PARAMETERS)))
    noise = random.standard_normal((members, count, len(PARAMETERS)))
    noise = np.einsum("ij,mjp->mip", _root(_together(soil_map)), noise)
    roots = zone_roots(soil_map)
    drawn = np.empty((members, count, len(PARAMETERS)))
    for k, zone in enumerate(soil_map.zones):
        normal = zone.belief.mean + noise[:, k] @ roots[k].T
        population = zone.belief.population
        drawn[:, k] = normal if population is None else _paired(population, normal, roots[k], random)
    return drawn


def _together(soil_map: SoilMap) -> FloatArray:
    """Correlation of what the zones do not know, by the gap between their tracks. (z, z)"""
    trees = [cKDTree(zone.place_m) for zone in soil_map.zones]
    gap = np.array([[np.min(one.query(other.data)[0]) for other in trees] for one in trees], dtype=np.float64)
    return np.asarray(np.exp(-np.maximum(gap - 2.0 * soil_map.reach_m, 0.0) / soil_map.correlation_m), dtype=np.float64)


def _root(correlation: FloatArray) -> FloatArray:
    """Of the nearest matrix that is one of correlations: gaps between lines keep no triangle inequality."""
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root / np.linalg.norm(root, axis=1, keepdims=True))


def _paired(population: FloatArray, normal: FloatArray, root: FloatArray, random: np.random.Generator) -> FloatArray:
    """A population in an order that follows normal draws, so that neighbouring zones are drawn together."""
    from scipy.optimize import linear_sum_assignment

    drawn = population[np.resize(random.permutation(len(population)), len(normal))]
    white = np.linalg.pinv(root).T
    result = np.empty_like(normal)
    for k in range(0, len(normal), PAIRED_AT_ONCE):
        part = slice(k, k + PAIRED_AT_ONCE)
        rows, columns = linear_sum_assignment(cdist(normal[part] @ white, drawn[part] @ white, "sqeuclidean"))
        result[part][rows] = drawn[part][columns]
    return result
