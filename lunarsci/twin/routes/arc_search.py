"""Search for a path of arcs over a map: a lattice of arcs, a local refinement, and arcs that end it on the target.

`search_ground` makes the map: at each node the distance from the nearest obstacle and the cost of a metre.
`drive_arc` integrates both along an arc.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_erosion, distance_transform_edt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.compiled import compiled
from lunarsci.twin.ground.hazards import COST_CAP, RoverFootprint, Traversability
from lunarsci.twin.plans.path import arc_end

LARGEST_TURN = 0.75 * np.pi
"""No closing arc turns further than this: where the search of these ends; assumed. [rad]"""
MOST_ARCS = 4
"""Of a course."""
LENGTHS = 8
"""Free arcs are 1/8, 2/8 ... 8/8 of the distance of the target long."""
HALVINGS = 5
"""and as curved as the tightest turn, half of it, ... a sixteenth, to the left and to the right, or straight."""
LONGEST = 2.5
"""A course is at most this many distances of the target long, and two tightest turns, and costs at most as many times
what the cheapest one does: where the search ends; assumed."""
TURNING_M2 = 0.5
"""Cost of a change of curvature by 1/m: assumed. [m2]"""
ARC_M = 0.1
"""Cost of each arc: assumed. [m]"""
BEST, NEARLY = 5, 8
"""How many courses of each number of arcs are refined, and how many that do not keep the clearance if none does."""
SHORTEST_M, FINEST_M, COARSEST_M = 0.1, 0.1, 0.4
"""Shortest arc of a course, and steps along it that are looked at: about a footprint's error; assumed."""
SAME_PER_M = 1e-5
"""Arcs whose curvatures differ by less are one."""
PENALTY = 1e3
"""Cost of a metre driven a metre too near to an obstacle [1/m], and floor of the cost of arcs that cannot be driven
[m]: far above that of a course, so that a search leaves both first. Courses that cost as much are not taken."""


class Window(NamedTuple):
    """What `drive_arc` reads of the map.

    Attributes
    ----------
    x0, y0, spacing : place of the first node, and distance of the nodes. [m]
    values : distance from the nearest obstacle [m], and cost of a metre [-], at each node. (ny, nx, 2)
    """

    x0: float
    y0: float
    spacing: float
    values: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchGround:
    """A rectangle of the map about start and target.

    Attributes
    ----------
    window : distance from the nearest obstacle, negative inside one, and cost of a metre.
    rows, columns : which part of the map it is.
    border : nodes of obstacles next to free ones, as rows and columns of the whole map. (n, 2)
    """

    window: Window
    rows: slice
    columns: slice
    border: IntArray


def search_ground(surface: Traversability, points_m: FloatArray, margin_m: float) -> SearchGround:
    """Distances and costs in a box about some points (n, 2) [m] and a margin about them.

    Obstacles are nodes whose height is unknown or where a limit is exceeded; beyond the edge of the map all is unknown.
    """
    terrain = surface.terrain
    rows, columns = terrain.window(points_m, margin_m)
    blocked = surface.hazard[rows, columns] | np.isnan(terrain.height_m[rows, columns])
    # The frame of the box is a wall, so that nothing beyond it can come near the path.
    walled = np.pad(blocked, 1, constant_values=True)
    free, inside = (distance_transform_edt(mask, terrain.spacing_m)[1:-1, 1:-1] for mask in (~walled, walled))
    values = np.empty((*blocked.shape, 2), dtype=np.float32)
    values[..., 0] = np.where(blocked, -inside, free)
    values[..., 1] = np.where(surface.unknown[rows, columns], np.inf, surface.travel_cost(rows, columns))
    border = np.argwhere(walled & ~binary_erosion(walled, border_value=1))
    border += np.array([rows.start - 1, columns.start - 1])
    return SearchGround(
        window=Window(float(terrain.x_m[columns.start]), float(terrain.y_m[rows.start]), terrain.spacing_m, values),
        rows=rows,
        columns=columns,
        border=border[_real(border, surface.demand.shape, rows, columns)],
    )


def _real(border: IntArray, whole: tuple[int, ...], rows: slice, columns: slice) -> BoolArray:
    """Which border nodes are obstacles or lie beyond the map, and not just beyond the box."""
    row, column = border.T
    in_box = (row >= rows.start) & (row < rows.stop) & (column >= columns.start) & (column < columns.stop)
    in_map = (row >= 0) & (row < whole[0]) & (column >= 0) & (column < whole[1])
    return np.asarray(in_box | ~in_map)


@compiled
def drive_arc(
    window: Any, discs: Any, pose: Any, length: float, curvature: float, step: float, need: float, wanted: float,
    stop: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Cost of an arc, how far it falls short of the clearance, and how far it could be driven.

    Parameters
    ----------
    window : a `Window`.
    discs : places of the covering discs along the rover's x (n,). [m]
    pose : x, y, heading at its start. [m, m, rad]
    length, curvature, step : of the arc, and the distance of the places looked at. [m, 1/m, m]
    need, wanted : least distance of the disc centres from obstacles, and the one below which cost rises. [m]
    stop : leave at the first place that is too near.

    Cost is the integral of the cost of a metre times 1 + ((wanted - distance) / (wanted - need))^2 where the distance
    is below `wanted`; shortfall is the integral of need - distance where that is positive, and of 1 m where the origin
    is on unknown ground. Maps are bilinear; beyond them all is an obstacle. Returns (cost [m], shortfall [m2], length
    driven [m]).
    """
    ny, nx = window.values.shape[:2]
    pieces = max(int(np.ceil(length / step)), 1)
    ds = length / pieces
    cost, shortfall = 0.0, 0.0
    for number in range(pieces):
        s = (number + 1) * ds
        half = 0.5 * s * curvature
        chord = s if abs(half) < 1e-9 else s * np.sin(half) / half
        x = pose[0] + chord * np.cos(pose[2] + half)
        y = pose[1] + chord * np.sin(pose[2] + half)
        heading = pose[2] + 2.0 * half
        ahead, aside = np.cos(heading), np.sin(heading)
        nearest, metre = 1e9, 0.0
        for place in range(-1, len(discs)):
            along = 0.0 if place < 0 else discs[place]
            column = (x + along * ahead - window.x0) / window.spacing
            row = (y + along * aside - window.y0) / window.spacing
            if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
                nearest, metre = -1.0, np.inf
                continue
            j, i = min(int(column), nx - 2), min(int(row), ny - 2)
            a, b = column - j, row - i
            layer = 1 if place < 0 else 0
            low = (1.0 - a) * window.values[i, j, layer] + a * window.values[i, j + 1, layer]
            high = (1.0 - a) * window.values[i + 1, j, layer] + a * window.values[i + 1, j + 1, layer]
            value = (1.0 - b) * low + b * high
            if place >= 0:
                nearest = min(nearest, value)
            elif value < np.inf:
                metre = value
            else:
                nearest, metre = need - 1.0, COST_CAP
        metre = min(metre, COST_CAP)
        if nearest < wanted:
            metre *= 1.0 + ((wanted - nearest) / (wanted - need)) ** 2
        cost += metre * ds
        if nearest < need:
            if stop:
                return cost, np.inf, number * ds
            shortfall += (need - nearest) * ds
    return cost, shortfall, length


@compiled
def drive_arcs(
    window: Any, discs: Any, poses: Any, lengths: Any, curvatures: Any, step: float, need: float, wanted: float
) -> Any:
    """`drive_arc` with `stop` from each of the poses (n, 3): cost, infinite when stopped, and length driven. (n, 2)"""
    result = np.empty((len(lengths), 2))
    for n in range(len(lengths)):
        cost, shortfall, driven = drive_arc(
            window, discs, poses[n], lengths[n], curvatures[n], step, need, wanted, True
        )
        result[n, 0] = cost + shortfall
        result[n, 1] = driven
    return result


@compiled
def drive_course(
    window: Any, discs: Any, start: Any, arcs: Any, step: float, need: float, wanted: float
) -> tuple[float, float]:
    """Cost [m] and shortfall [m2], as in `drive_arc`, of arcs (n, 2) of length and curvature one after the other."""
    pose = start.copy()
    cost, shortfall = 0.0, 0.0
    for n in range(len(arcs)):
        length, curvature = arcs[n, 0], arcs[n, 1]
        more, short, _ = drive_arc(window, discs, pose, length, curvature, step, need, wanted, False)
        cost += more
        shortfall += short
        half = 0.5 * length * curvature
        chord = length if abs(half) < 1e-9 else length * np.sin(half) / half
        pose[0] += chord * np.cos(pose[2] + half)
        pose[1] += chord * np.sin(pose[2] + half)
        pose[2] += 2.0 * half
    return cost, shortfall


def close_on_point(poses: FloatArray, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The one arc from each pose to a point: length and curvature, NaN where it would turn by more than 135 deg.

    Poses (n, 3) [m, m, rad], point (2,) or (n, 2) [m]; results (n, 1) [m, 1/m]. A chord of length d at the angle a from
    the heading belongs to the curvature 2 sin(a) / d and turns by 2 a.
    """
    difference = point_m - poses[:, :2]
    distance = np.hypot(*difference.T)
    angle = np.arctan2(difference[:, 1], difference[:, 0]) - poses[:, 2]
    angle = (angle + np.pi) % (2.0 * np.pi) - np.pi
    near = (np.abs(2.0 * angle) <= LARGEST_TURN) & (distance > 0)
    length = distance / np.where(near, np.sinc(angle / np.pi), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(near, 2.0 * np.sin(angle) / distance, np.nan)
    return length[:, None], curvature[:, None]


def close_on_pose(poses: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two arcs from each pose to another pose (3,), with one tangent at their joint: lengths and curvatures. (n, 2)

    Of the family of such biarcs the one whose joint lies as far from both ends along their tangents: with the tangents
    t1, t2 and the chord v this distance d solves 2 (1 - t1 t2) d^2 + 2 v (t1 + t2) d - v^2 = 0 (Bolton 1975,
    Computer-Aided Design 7, 89, 10.1016/0010-4485(75)90086-X). NaN where an arc would turn by more than 135 deg.
    """
    first = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    last = np.array([np.cos(goal[2]), np.sin(goal[2])])
    chord = goal[:2] - poses[:, :2]
    half_a, b, square = 1.0 - first @ last, (chord * (first + last)).sum(axis=1), (chord**2).sum(axis=1)
    # This form of the root has no difference of nearly equal terms when the tangents are parallel.
    root = np.sqrt(b**2 + 2.0 * half_a * square)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = np.where(b > 0, square / (b + root), (root - b) / (2.0 * half_a))[:, None]
    # Straight behind there is no joint at any distance.
    tangent[np.isinf(tangent)] = np.nan
    joint = 0.5 * (poses[:, :2] + goal[:2] + tangent * (first - last))
    length_1, curvature_1 = close_on_point(poses, joint)
    x, y, heading = arc_end(poses[:, 0], poses[:, 1], poses[:, 2], length_1[:, 0], curvature_1[:, 0])
    length_2, curvature_2 = close_on_point(np.column_stack([x, y, heading]), goal[:2])
    return np.hstack([length_1, length_2]), np.hstack([curvature_1, curvature_2])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strip:
    """Ground about a way, and the clearance that a rover keeps on it.

    Attributes
    ----------
    window, discs : what `drive_arc` looks up, and where.
    step_m : distance of the places looked at. [m]
    need_m, wanted_m : as in `drive_arc`. [m]
    """

    window: Window
    discs: FloatArray
    step_m: float
    need_m: float
    wanted_m: float

    def drive(self, poses: FloatArray, lengths: FloatArray, curvatures: FloatArray) -> FloatArray:
        """Cost, infinite where the clearance is not kept, and length driven. (n, 2) [m]"""
        return np.asarray(
            drive_arcs(self.window, self.discs, poses, lengths, curvatures, self.step_m, self.need_m, self.wanted_m)
        )

    def drive_course(self, start: FloatArray, arcs: FloatArray) -> tuple[float, float]:
        """Cost [m] of arcs (n, 2) one after the other, and how far they fall short of the clearance. [m2]"""
        drive: tuple[float, float] = drive_course(
            self.window, self.discs, start, arcs, self.step_m, self.need_m, self.wanted_m
        )
        return drive


def clearance(surface: Traversability, footprint: RoverFootprint) -> dict[str, Any]:
    """Discs and distances of a `Strip` for a footprint that travels along its x."""
    discs, radius = footprint.discs()
    # Between nodes and between places the distance may be less by a small part of the spacing.
    need = radius + surface.mobility.hazard_distance_m + 0.25 * surface.terrain.spacing_m + 0.005
    return {"discs": discs, "need_m": need, "wanted_m": need + footprint.half_width_m}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArcProblem(Strip):
    """What a course is searched for: the places looked at lie `step_m` apart in the lattice, closer in the refinement.

    Attributes
    ----------
    start, goal : poses [m, m, rad]; the heading of the goal is NaN where any will do.
    tightest_per_m : largest curvature. [1/m]
    """

    start: FloatArray
    goal: FloatArray
    tightest_per_m: float

    @property
    def distance_m(self) -> float:
        """From start to goal. [m]"""
        return math.dist(self.start[:2], self.goal[:2])

    @property
    def closing(self) -> int:
        """Arcs that close a course: two where it ends with a heading."""
        return 1 if math.isnan(self.goal[2]) else 2

    @property
    def fine(self) -> "ArcProblem":
        """The same, looked at more closely."""
        return replace(self, step_m=min(self.step_m, max(FINEST_M, self.window.spacing)))

    def close(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lengths and curvatures of the arcs that end at the goal. (n, 1) or (n, 2) [m, 1/m]"""
        if math.isnan(self.goal[2]):
            return close_on_point(poses, self.goal[:2])
        return close_on_pose(poses, self.goal)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A way of arcs.

    Attributes
    ----------
    arcs : length and curvature of each. (n, 2) [m, 1/m]
    cost_m : length in metres of flat, clear ground, and what its curves and arcs cost. [m]
    """

    arcs: FloatArray
    cost_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Branches:
    """Beginnings of n courses, of k arcs each, that keep the clearance.

    Attributes
    ----------
    arcs : length and curvature of each arc. (n, k, 2) [m, 1/m]
    poses : x, y and heading where they end. (n, 3) [m, m, rad]
    cost, length : so far. (n,) [m]
    """

    arcs: FloatArray
    poses: FloatArray
    cost: FloatArray
    length: FloatArray


Pick = Callable[[FloatArray, FloatArray], Sequence[int]]
"""Which of the courses with as many arcs are kept, of their arcs (n, k, 2) and costs (n,), infinite where none."""


def cheapest(arcs: FloatArray, cost: FloatArray) -> Sequence[int]:
    """The numbers of the cheapest courses."""
    order = np.argsort(cost, kind="stable")[:BEST]
    return [int(number) for number in order if math.isfinite(cost[number])]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LatticeCourses:
    """What the lattice of arcs has.

    Attributes
    ----------
    complete : courses that end at the goal and keep the clearance.
    nearly : where there is none, those that fall least short of the clearance.
    nearest : the one that comes nearest to the goal.
    """

    complete: list[Course]
    nearly: list[Course]
    nearest: Course


def lattice_courses(
    problem: ArcProblem, pick: Pick = cheapest, progress: Callable[[int, int], None] | None = None
) -> LatticeCourses:
    """Courses of the lattice, of each number of arcs those that are picked.

    Up to three arcs are tried first; a fourth where these find nothing.
    """
    closing = problem.closing
    branches = _Branches(arcs=np.empty((1, 0, 2)), poses=problem.start[None], cost=np.zeros(1), length=np.zeros(1))
    complete: list[Course] = []
    nearly: list[Course] = []
    nearest = (math.inf, Course(np.empty((0, 2)), 0.0))
    for free in range(MOST_ARCS - closing + 1):
        if free:
            if free + closing == MOST_ARCS and complete:
                break
            branches = _grow(problem, branches)
        good, stopped = _closed(problem, branches, pick)
        complete += good
        nearest = min(nearest, stopped, key=lambda pair: pair[0])
        if not complete and free + closing < MOST_ARCS:
            nearly += _shortest_falls(problem, branches)
        if progress is not None:
            progress(free + 1, MOST_ARCS)
    return LatticeCourses(complete=complete, nearly=nearly, nearest=nearest[1])


def find_courses(
    problem: ArcProblem, progress: Callable[[int, int], None] | None = None
) -> tuple[list[Course], Course]:
    """Courses that end at the goal and keep the clearance, cheapest first, and the one that comes nearest to it.

    The courses of the lattice, or those that fall least short of the clearance, are refined until they keep it, if they
    can. All courses are deterministic.
    """
    lattice = lattice_courses(problem, progress=progress)
    refined = [
        course for course in (refine(problem, course) for course in lattice.complete or lattice.nearly) if course
    ]
    if progress is not None:
        progress(MOST_ARCS, MOST_ARCS)
    return sorted(refined, key=lambda course: course.cost_m), lattice.nearest


def pose_after(pose: FloatArray, arcs: FloatArray) -> FloatArray:
    """Pose at the end of arcs (n, 2). (3,) [m, m, rad]"""
    end = pose[None]
    for arc in arcs:
        end = _moved(end, arc[None, 0], arc[None, 1])
    return np.asarray(end[0])


def _moved(poses: FloatArray, length: FloatArray, curvature: FloatArray) -> FloatArray:
    """Poses (n, 3) after an arc each."""
    return np.column_stack(arc_end(poses[:, 0], poses[:, 1], poses[:, 2], length, curvature))


def _grow(problem: ArcProblem, branches: _Branches) -> _Branches:
    """Every branch with every arc of the lattice that keeps the clearance."""
    distance = problem.distance_m
    curved = problem.tightest_per_m * 0.5 ** np.arange(HALVINGS)
    curvatures = np.concatenate([-curved, [0.0], curved[::-1]])
    lengths = distance * np.arange(1, LENGTHS + 1) / LENGTHS
    curvature, length = (grid.ravel() for grid in np.meshgrid(curvatures, lengths, indexing="ij"))
    branch = np.repeat(np.arange(len(branches.poses)), curvature.size)
    curvature, length = np.tile(curvature, len(branches.poses)), np.tile(length, len(branches.poses))
    longest = LONGEST * distance + 4.0 * math.pi / problem.tightest_per_m
    wanted = branches.length[branch] + length < longest
    if branches.arcs.shape[1]:
        wanted &= branches.arcs[branch, -1, 1] != curvature
    branch, curvature, length = branch[wanted], curvature[wanted], length[wanted]
    poses = branches.poses[branch]
    cost = problem.drive(poses, length, curvature)[:, 0] + branches.cost[branch]
    clear = np.isfinite(cost)
    branch, curvature, length = branch[clear], curvature[clear], length[clear]
    arcs = np.concatenate([branches.arcs[branch], np.stack([length, curvature], axis=-1)[:, None]], axis=1)
    return _Branches(
        arcs=arcs,
        poses=_moved(poses[clear], length, curvature),
        cost=cost[clear],
        length=branches.length[branch] + length,
    )


def _with_closing_arcs(problem: ArcProblem, branches: _Branches) -> tuple[BoolArray, FloatArray]:
    """Which branches can be closed without a turn too tight, and the arcs (n, k, 2) of those with the closing ones."""
    arcs = np.stack(problem.close(branches.poses), axis=-1)
    possible = np.asarray((np.abs(arcs[..., 1]) <= problem.tightest_per_m).all(axis=1))
    return possible, np.concatenate([branches.arcs, arcs], axis=1)[possible]


def _closed(problem: ArcProblem, branches: _Branches, pick: Pick) -> tuple[list[Course], tuple[float, Course]]:
    """The picked courses with closing arcs that keep the clearance, and the one that came nearest, with how near."""
    possible, arcs = _with_closing_arcs(problem, branches)
    poses, cost = branches.poses[possible], branches.cost[possible]
    ends, driven = poses, np.zeros(len(poses))
    for length, curvature in arcs[:, -problem.closing :].transpose(1, 2, 0):
        result = problem.drive(poses, length, curvature)
        driven = np.where(np.isfinite(cost), result[:, 1], 0.0)
        ends = np.where(np.isfinite(cost)[:, None], _moved(poses, driven, curvature), ends)
        cost = cost + result[:, 0]
        poses = _moved(poses, length, curvature)
    total = cost + TURNING_M2 * _changes(arcs) + ARC_M * arcs.shape[1]
    good = [Course(arcs[number], float(total[number])) for number in pick(arcs, total)]
    return good, _nearest(problem, branches, arcs, ends, driven)


def _nearest(
    problem: ArcProblem, branches: _Branches, arcs: FloatArray, ends: FloatArray, driven: FloatArray
) -> tuple[float, Course]:
    """Of the branches, and of the courses as far as they could be driven, the one that ends nearest to the goal."""
    goal = problem.goal[:2]
    pairs = []
    if len(branches.poses):
        distance = np.hypot(*(branches.poses[:, :2] - goal).T)
        pairs.append((float(distance.min()), Course(branches.arcs[distance.argmin()], 0.0)))
    if len(ends) and math.isnan(problem.goal[2]):
        distance = np.hypot(*(ends[:, :2] - goal).T)
        number = int(distance.argmin())
        cut = arcs[number].copy()
        cut[-1, 0] = driven[number]
        pairs.append((float(distance[number]), Course(cut, 0.0)))
    return min(pairs, key=lambda pair: pair[0], default=(math.inf, Course(np.empty((0, 2)), 0.0)))


def _shortest_falls(problem: ArcProblem, branches: _Branches) -> list[Course]:
    """Courses whose closing arcs fall least short of the clearance."""
    arcs = _with_closing_arcs(problem, branches)[1]
    scores = np.array([_score(problem, course) for course in arcs])
    return [Course(arcs[number], float(scores[number])) for number in np.argsort(scores, kind="stable")[:NEARLY]]


def _score(problem: ArcProblem, arcs: FloatArray) -> float:
    """Cost with its number and changes of arcs, and a penalty on what falls short of the clearance. [m]"""
    cost, shortfall = problem.drive_course(problem.start, arcs)
    return float(cost + PENALTY * shortfall + TURNING_M2 * _changes(arcs[None])[0] + ARC_M * len(arcs))


def _changes(arcs: FloatArray) -> FloatArray:
    """Sum of the changes of curvature along each course (n, k, 2), from straight on. (n,) [1/m]"""
    return np.asarray(np.abs(np.diff(arcs[..., 1], axis=1, prepend=0.0)).sum(axis=1))


def refine(coarse: ArcProblem, course: Course) -> Course | None:
    """The course moved to the nearest least cost, None where it does not keep the clearance then."""
    from scipy.optimize import minimize

    problem = coarse.fine
    free = course.arcs[: len(course.arcs) - problem.closing]
    scale = np.array([0.1 * problem.distance_m, 0.1 * problem.tightest_per_m])

    def arcs_of(numbers: FloatArray) -> FloatArray:
        moved = free + numbers.reshape(-1, 2) * scale
        pose = pose_after(problem.start, moved)[None]
        lengths, curvatures = problem.close(pose)
        return np.concatenate([moved, np.stack([lengths[0], curvatures[0]], axis=-1)])

    def score(numbers: FloatArray) -> float:
        arcs = arcs_of(numbers)
        beyond = np.maximum(np.abs(arcs[:, 1]) - problem.tightest_per_m, 0.0).sum()
        short = np.maximum(SHORTEST_M - arcs[:, 0], 0.0).sum()
        if not np.isfinite(arcs).all() or short + beyond > 0:
            return PENALTY * (1.0 + float(np.nan_to_num(short + beyond, nan=PENALTY)))
        return _score(problem, arcs)

    best = np.zeros(free.size)
    if free.size:
        simplex = np.vstack([best, np.eye(free.size)])
        steps = 120 * free.size
        minimum = minimize(
            score, best, method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxiter": steps, "xatol": 1e-3, "fatol": 1e-4},
        )  # fmt: skip
        best = np.asarray(minimum.x)
    arcs = _merged(arcs_of(best))
    clear = np.isfinite(arcs).all() and keeps_clear(problem, arcs) and score(best) < PENALTY
    return Course(arcs, _score(problem, arcs)) if clear else None


def keeps_clear(problem: ArcProblem, arcs: FloatArray) -> bool:
    """Whether a course keeps the clearance."""
    return problem.drive_course(problem.start, arcs)[1] == 0


def _merged(arcs: FloatArray) -> FloatArray:
    """Neighbouring arcs of the same curvature as one."""
    rows = [arcs[0]]
    for length, curvature in arcs[1:]:
        if abs(curvature - rows[-1][1]) < SAME_PER_M:
            rows[-1] = np.array([rows[-1][0] + length, rows[-1][1]])
        else:
            rows.append(np.array([length, curvature]))
    return np.array(rows)
