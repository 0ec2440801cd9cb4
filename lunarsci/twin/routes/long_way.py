"""A way of hundreds of metres: the cheapest one over the nodes of the map, and arcs from place to place along it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.twin.ground.finer_ground import laid_over, patch
from lunarsci.twin.ground.hazards import COST_CAP, Traversability, rover_footprint, swept_nodes
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Limit
from lunarsci.twin.routes.arc_search import FINEST_M, Strip, Window, clearance, search_ground
from lunarsci.twin.routes.planner import (
    FAR_MARGIN_M,
    MARGIN_SHARE,
    PATH_STEP_M,
    PlannedPath,
    check_place,
    plan_path,
    search_margin_m,
)
from lunarsci.twin.rover import Rover

LONG_M = 30.0
"""Targets farther than this are reached place by place; assumed. [m]"""
STRETCH_M, SHORTEST_M = 20.0, 8.0
"""Steps of the way: places lie at most so far apart, and no nearer than this where the way allows it; assumed. [m]"""
AS_CHEAP = 1.02
"""A straight line may cost so many times the way over the nodes that it replaces; assumed."""
MOST_NODES = 2_000_000
"""Of a larger map every second, third ... node is searched."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodeWay:
    """The cheapest way over the nodes of a map.

    Attributes
    ----------
    places_m : x and y of its nodes. (n, 2) [m]
    cost_m : length as the ground weighs it, up to each. (n,) [m]
    """

    places_m: FloatArray
    cost_m: FloatArray


def long_way(
    surface: Traversability,
    rover: Rover,
    start: tuple[float, float, float],
    target: tuple[float, float],
    *,
    final_heading_deg: float | None = None,
    speed_m_s: float | None = None,
    limits: tuple[Limit, ...] = (),
    name: str = "planned path",
    progress: Callable[[int, int], None] | None = None,
    finer: Sequence[Traversability] = (),
) -> PlannedPath:
    """A path of many arcs to a target hundreds of metres away; arguments as those of `plan_path`.

    Where `finer` grounds are known, the finest last, the way is searched over nodes that count with what lies in their
    cells, and arcs near to them are searched and checked on patches with the finest nodes.

    The cheapest way over the nodes, of steps to the eight neighbours (Dijkstra 1959, 10.1007/BF01386390), where cost is
    that of `drive_arc` and every node keeps the rover's clearance, is straightened into places at most 20 m apart; arcs
    lead from one to the next, each with the heading that the last one ended with. Where no arcs join two places the
    next ones are tried. Raises ParameterError with what is in the way where there is no way over the nodes, or no
    arcs.
    """
    reach = rover_footprint(rover).reach_m
    for what, place in (("start", start), ("target", target)):
        check_place(patch(surface, finer, np.array([place[:2]]), 2.0 * surface.terrain.spacing_m), what, place, reach)
    ends, whole = np.array([start[:2], target]), laid_over(surface, finer) if finer else surface
    strip = _strip(whole, rover, ends)
    way = way_over_nodes(whole, strip, ends)
    places = straightened(way, strip)
    pieces: list[PlannedPath] = []
    pose, number = start, 0
    while number < len(places) - 1:
        if progress is not None:
            progress(number, len(places))
        piece, number = _joined(surface, finer, rover, pose, places, number, final_heading_deg, speed_m_s)
        pieces.append(piece)
        end = piece.end
        pose = (float(end[0]), float(end[1]), math.degrees(end[2]))
    if progress is not None:
        progress(len(places), len(places))
    return _chained(pieces, start, target, limits, name)


def _strip(surface: Traversability, rover: Rover, ends_m: FloatArray) -> Strip:
    ground = search_ground(surface, ends_m, MARGIN_SHARE * math.dist(*ends_m) + FAR_MARGIN_M)
    step_m = max(FINEST_M, surface.terrain.spacing_m)
    return Strip(window=ground.window, step_m=step_m, **clearance(surface, rover_footprint(rover)))


def way_over_nodes(surface: Traversability, strip: Strip, ends_m: FloatArray) -> NodeWay:
    """The cheapest way over nodes that keep the clearance, between two places (2, 2). [m]

    Of more than 2 million nodes every second, third ... one of both directions is looked at, which may miss a passage
    that is narrower than so many spacings. Raises ParameterError where there is none.
    """
    from scipy.sparse.csgraph import dijkstra

    window = strip.window
    every = math.ceil(math.sqrt(window.values[..., 0].size / MOST_NODES))
    values, spacing = window.values[::every, ::every], every * window.spacing
    metre = _cost_of_metre(values, strip.need_m, strip.wanted_m)
    free = np.isfinite(metre)
    rows = np.array([_nearest_free(free, (end - (window.x0, window.y0)) / spacing) for end in ends_m])
    first, last = np.ravel_multi_index(rows.T, metre.shape)
    graph = _graph(metre, free, spacing)
    cost, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    if math.isinf(cost[last]):
        raise ParameterError(_no_way(surface, window, cost.reshape(metre.shape), spacing, ends_m[1]))
    nodes = [int(last)]
    while nodes[-1] != first:
        nodes.append(int(before[nodes[-1]]))
    row, column = np.unravel_index(nodes[::-1], metre.shape)
    places = np.column_stack([window.x0 + spacing * column, window.y0 + spacing * row])
    places[0], places[-1] = ends_m
    return NodeWay(places_m=places, cost_m=cost[nodes[::-1]])


def _cost_of_metre(values: npt.NDArray[np.float32], need_m: float, wanted_m: float) -> FloatArray:
    """Cost of a metre at nodes as in `drive_arc`, infinite where the clearance is not kept. (ny, nx)"""
    near = np.clip((wanted_m - values[..., 0]) / (wanted_m - need_m), 0.0, 1.0)
    metre = np.minimum(values[..., 1], COST_CAP) * (1.0 + near**2)
    return np.where((values[..., 0] >= need_m) & np.isfinite(values[..., 1]), metre, np.inf)


def _graph(metre: FloatArray, free: BoolArray, spacing: float) -> Any:
    """Costs between neighbouring free nodes, each pair once."""
    from scipy.sparse import csr_matrix

    ny, nx = metre.shape
    number = np.arange(ny * nx, dtype=np.int32).reshape(ny, nx)
    starts, ends, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = slice(0, ny - down), slice(max(0, -right), nx - max(0, right))
        there = slice(down, ny), slice(max(0, right), nx - max(0, -right))
        both = free[here] & free[there]
        starts.append(number[here][both])
        ends.append(number[there][both])
        costs.append(0.5 * spacing * math.hypot(down, right) * (metre[here] + metre[there])[both])
    pairs = np.concatenate(starts), np.concatenate(ends)
    return csr_matrix((np.concatenate(costs), pairs), shape=(ny * nx, ny * nx))


def _nearest_free(free: BoolArray, place: FloatArray) -> tuple[int, int]:
    """Row and column of the free node nearest to x, y in spacings; of the nearest one where none is free."""
    nearest = np.clip(np.rint(place[::-1]).astype(int), 0, np.array(free.shape) - 1)
    low = np.maximum(nearest - 3, 0)
    block = free[low[0] : nearest[0] + 4, low[1] : nearest[1] + 4]
    nodes: IntArray = np.argwhere(block) + low
    if not len(nodes):
        return int(nearest[0]), int(nearest[1])
    row, column = nodes[np.hypot(*(nodes - place[::-1]).T).argmin()]
    return int(row), int(column)


def straightened(way: NodeWay, strip: Strip) -> FloatArray:
    """Places along a way, from each of which a straight drive to the next costs no more than the way. (n, 2) [m]"""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way.places_m, axis=0).T))])
    chosen, last = [0], len(along) - 1
    while chosen[-1] < last:
        here = chosen[-1]
        numbers = np.arange(here + 1, last + 1)
        cost = _straight_costs(way.places_m[here], way.places_m[numbers], strip)
        good = numbers[cost <= AS_CHEAP * (way.cost_m[numbers] - way.cost_m[here])]
        bent = numbers[min(int(np.searchsorted(along[numbers], along[here] + SHORTEST_M)), len(numbers) - 1)]
        chosen.append(max(int(good[-1]) if len(good) else 0, int(bent)))
    if len(chosen) > 2 and along[last] - along[chosen[-2]] < SHORTEST_M:
        del chosen[-2]
    corners = way.places_m[chosen]
    pieces = [corners[:1]]
    for here, there in pairwise(corners):
        count = math.ceil(math.dist(here, there) / STRETCH_M)
        pieces.append(here + np.linspace(0.0, 1.0, count + 1)[1:, None] * (there - here))
    return np.concatenate(pieces)


def _straight_costs(here_m: FloatArray, there_m: FloatArray, strip: Strip) -> FloatArray:
    """Cost of a straight drive from one place to others (n, 2), infinite where it comes too near to something. [m]"""
    chord = there_m - here_m
    poses = np.column_stack([np.tile(here_m, (len(chord), 1)), np.arctan2(chord[:, 1], chord[:, 0])])
    return strip.drive(poses, np.hypot(*chord.T), np.zeros(len(chord)))[:, 0]


def _joined(
    surface: Traversability,
    finer: Sequence[Traversability],
    rover: Rover,
    pose: tuple[float, float, float],
    places: FloatArray,
    number: int,
    final_heading_deg: float | None,
    speed_m_s: float | None,
) -> tuple[PlannedPath, int]:
    """Arcs from a pose to the place after `number`, or one or two further on, and which of them they reach."""
    failed: ParameterError | None = None
    for ahead in (1, 2, 3):
        goal = number + ahead
        if goal >= len(places):
            break
        for heading in _headings(places, goal, final_heading_deg):
            try:
                x, y = places[goal]
                path = _arcs_to(
                    surface, finer, rover, pose, (float(x), float(y)), final_heading_deg=heading, speed_m_s=speed_m_s
                )
                return path, goal
            except ParameterError as error:
                failed = failed or error
    raise ParameterError(f"after place {number} of {len(places) - 1} of the way: {failed}")


def _arcs_to(
    surface: Traversability,
    finer: Sequence[Traversability],
    rover: Rover,
    start: tuple[float, float, float],
    target: tuple[float, float],
    **options: Any,
) -> PlannedPath:
    """`plan_path`, on a patch where finer ground lies near; its swept nodes are those of the surface."""
    margin = search_margin_m(rover_footprint(rover), math.dist(start[:2], target)) + surface.terrain.spacing_m
    ground = patch(surface, finer, np.array([start[:2], target]), margin)
    path = plan_path(ground, rover, start, target, **options)
    if ground is surface:
        return path
    return replace(path, swept=swept_nodes(path.footprint, surface.terrain, poses_along(path.plan, PATH_STEP_M)))


def _headings(places: FloatArray, goal: int, final_heading_deg: float | None) -> tuple[float | None, ...]:
    """Headings to arrive with: midway between the ways to and from a place, or any."""
    if goal == len(places) - 1:
        return (final_heading_deg,)
    before, after = places[goal] - places[goal - 1], places[goal + 1] - places[goal]
    middle = before / np.hypot(*before) + after / np.hypot(*after)
    return (math.degrees(math.atan2(middle[1], middle[0])), None)


def _chained(
    pieces: list[PlannedPath], start: tuple[float, float, float], target: tuple[float, float],
    limits: tuple[Limit, ...], name: str,
) -> PlannedPath:  # fmt: skip
    """Paths one after the other as one, with the extremes of all; each ends a leg, where the rover can be localised."""
    swept = np.logical_or.reduce([piece.swept for piece in pieces])
    legs = tuple(leg for piece in pieces for leg in piece.plan.legs)
    plan = replace(
        pieces[0].plan, name=name, legs=legs, limits=limits, x_m=start[0], y_m=start[1], heading_deg=start[2]
    )
    largest: dict[str, Any] = {
        field: float(np.nanmax([getattr(piece, field) for piece in pieces] + [-math.inf]))
        for field in ("max_slope_deg", "max_roughness_m", "max_slope_on_path_deg", "max_curvature_per_m")
    }
    steps = [piece.max_step_m for piece in pieces if not math.isnan(piece.max_step_m)]
    return replace(
        pieces[0],
        plan=plan,
        target_m=target,
        cost_m=math.fsum(piece.cost_m for piece in pieces),
        min_hazard_distance_m=min(piece.min_hazard_distance_m for piece in pieces),
        max_step_m=max(steps, default=math.nan),
        swept=swept,
        **largest,
    )


def _no_way(surface: Traversability, window: Window, cost: FloatArray, spacing: float, target_m: FloatArray) -> str:
    """Where the way over the nodes that comes nearest to the target ends, and what lies before it."""
    reached: IntArray = np.argwhere(np.isfinite(cost))
    places = np.array([window.x0, window.y0]) + spacing * reached[:, ::-1]
    left = np.hypot(*(places - target_m).T)
    nearest, terrain = places[left.argmin()], surface.terrain
    ahead = (target_m - nearest) / max(float(left.min()), 1e-9)
    reason = ""
    for step in terrain.spacing_m * np.arange(1, 2 + round(left.min() / terrain.spacing_m)):
        row, column = terrain.nodes(nearest + step * ahead)
        if terrain.has(row, column) and (reason := surface.reason(int(row), int(column))):
            break
    beyond = f"; beyond it {reason}" if reason else ""
    return (
        f"no way over the nodes of the map keeps the limits; the nearest place reached is x {nearest[0]:.1f} m, "
        f"y {nearest[1]:.1f} m, {left.min():.1f} m from the target{beyond}; try other limits or a nearer target"
    )


def way_to(
    surface: Traversability,
    rover: Rover,
    start: tuple[float, float, float],
    target: tuple[float, float],
    finer: Sequence[Traversability] = (),
    **options: Any,
) -> PlannedPath:
    """`plan_path` to a target that is near, `long_way` to one beyond 30 m; their arguments."""
    if math.dist(start[:2], target) > LONG_M:
        return long_way(surface, rover, start, target, finer=finer, **options)
    return _arcs_to(surface, finer, rover, start, target, **options)
