"""Drives as rover teams plan them today: the way of least cost over a map of slope, steps and roughness.

A baseline for `chosen_drives.py`. The map is that of `twin terrain`; nodes nearer to a hazard than the rover's outer
radius are closed; the cheapest way over the eight neighbours of every node (what A* finds is what Dijkstra's algorithm
finds, so that SciPy's is taken) is pulled straight where that costs no more, and driven as straight lines with spot
turns between them. Nothing is known of the soil.
"""

import math
from itertools import pairwise

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from lunarsci.twin.ground.hazards import Traversability, rover_footprint, travel_cost
from lunarsci.twin.plans.plan import Leg
from lunarsci.twin.rover import Rover

NODE_M = 0.1
"""Distance of the nodes of the search. [m]"""
DEARER = 1.02
"""A straight line may cost this much more than the way that it replaces."""
LEAST_TURN_DEG, LEAST_M = 1.0, 0.05


def cost_map_legs(
    surface: Traversability, rover: Rover, start: tuple[float, float, float], target: tuple[float, float]
) -> tuple[Leg, ...] | None:
    """Spot turns and straight lines to the target; None where the map has no way."""
    stride = max(1, round(NODE_M / surface.terrain.spacing_m))
    spacing, closed = surface.terrain.spacing_m, surface.hazard | surface.unknown
    clear = distance_transform_edt(np.pad(~closed, 1))[1:-1, 1:-1] * spacing
    far = rover_footprint(rover).half_width_m + surface.mobility.hazard_distance_m
    cost = np.where(clear < far, np.inf, travel_cost(surface.demand))[::stride, ::stride]
    origin, step = np.array([surface.terrain.x0_m, surface.terrain.y0_m]), stride * spacing
    ends = [tuple(np.rint((np.array(place) - origin) / step).astype(int)[::-1]) for place in (start[:2], target)]
    way = _cheapest(cost, *ends)
    if way is None:
        return None
    corners = _pulled_straight(cost, way) * step
    points = np.vstack([start[:2], corners[1:-1, ::-1] + origin, target])
    return _lines(points, start[2])


def _cheapest(cost: np.ndarray, begin: tuple[int, int], end: tuple[int, int]) -> np.ndarray | None:
    """Rows and columns of the nodes of the way. (n, 2)"""
    ny, nx = cost.shape
    number = np.arange(ny * nx).reshape(ny, nx)
    edges = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = number[: ny - down, max(0, -right) : nx - max(0, right)].ravel()
        there = here + down * nx + right
        price = 0.5 * math.hypot(down, right) * (cost.ravel()[here] + cost.ravel()[there])
        open_ = np.isfinite(price)
        edges.append((price[open_], here[open_], there[open_]))
    price, here, there = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = coo_array((price, (here, there)), shape=(ny * nx, ny * nx)).tocsr()
    _, before = dijkstra(graph, directed=False, indices=number[begin], return_predecessors=True)
    way, last = [number[end]], number[begin]
    while way[-1] != last:
        if before[way[-1]] < 0:
            return None
        way.append(before[way[-1]])
    return np.column_stack(np.divmod(np.array(way[::-1]), nx))


def _pulled_straight(cost: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Corners of the way, as few as straight lines that cost no more leave."""
    corners, here = [way[0]], 0
    while here < len(way) - 1:
        reach = here + 1
        paid = 0.0
        for there in range(here + 1, len(way)):
            paid += _line_cost(cost, way[there - 1], way[there])
            if _line_cost(cost, way[here], way[there]) <= DEARER * paid:
                reach = there
        corners.append(way[reach])
        here = reach
    return np.array(corners, dtype=float)


def _line_cost(cost: np.ndarray, begin: np.ndarray, end: np.ndarray) -> float:
    length = math.dist(begin, end)
    places = np.linspace(begin, end, max(2, math.ceil(2 * length) + 1)).T
    return length * float(map_coordinates(cost, places, order=0, mode="nearest").mean())


def _lines(points: np.ndarray, heading_deg: float) -> tuple[Leg, ...]:
    legs: list[Leg] = []
    for begin, end in pairwise(points):
        length = math.dist(begin, end)
        if length < LEAST_M:
            continue
        toward = math.degrees(math.atan2(end[1] - begin[1], end[0] - begin[0]))
        turn = (toward - heading_deg + 180.0) % 360.0 - 180.0
        if abs(turn) >= LEAST_TURN_DEG:
            legs.append(Leg(turn_deg=turn))
            heading_deg = toward
        legs.append(Leg(length))
    return tuple(legs)
