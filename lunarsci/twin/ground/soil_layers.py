"""A soil map laid over a terrain: median soil and what is known of it at every node, and grounds drawn from it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.twin.ground.soil_map import Blend, SoilMap, zone_roots
from lunarsci.twin.ground.terrain import Terrain

PAIRED_AT_ONCE = 256
"""Draws of a population that are paired with others at a time."""


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
        own = slice(member, member + 1)
        parameters = {name: values[own] for name, values in self.parameters.items()}
        return replace(self, zones=self.zones[own], elsewhere=self.elsewhere[own], parameters=parameters)


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
    if members < 1:
        raise ParameterError(f"{members} members; give 1 or more")
    random = np.random.default_rng(seed)
    zones = _zone_draws(soil_map, members, random)
    elsewhere = random.standard_normal((members, len(PARAMETERS)))
    along = soil_map.blend(along_m)
    middle = np.array(
        [_fields(soil_map, along, own, left).mean(axis=0) for own, left in zip(zones, elsewhere, strict=True)]
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
    from scipy.spatial import cKDTree

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
    from scipy.spatial.distance import cdist

    drawn = population[np.resize(random.permutation(len(population)), len(normal))]
    white = np.linalg.pinv(root).T
    result = np.empty_like(normal)
    for k in range(0, len(normal), PAIRED_AT_ONCE):
        part = slice(k, k + PAIRED_AT_ONCE)
        rows, columns = linear_sum_assignment(cdist(normal[part] @ white, drawn[part] @ white, "sqeuclidean"))
        result[part][rows] = drawn[part][columns]
    return result
