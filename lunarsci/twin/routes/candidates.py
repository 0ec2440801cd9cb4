"""Which drives to a target are worth comparing: other ways round obstacles, ahead, backwards or crabwise.

Which courses are different ways: by the side on which each obstacle is passed, or by the ground that they sweep.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label, minimum_position

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.names import counted
from lunarsci.ranges import check_range
from lunarsci.result import Progress
from lunarsci.twin.ground.hazards import RoverFootprint, Traversability
from lunarsci.twin.plans.path import arc_end
from lunarsci.twin.plans.plan import Fixes, Leg, Limit, Plan
from lunarsci.twin.routes.arc_search import LONGEST, ArcProblem, Course, keeps_clear, lattice_courses, refine
from lunarsci.twin.routes.planner import RouteSearch, commanded_speed
from lunarsci.twin.rover import Rover

PLACES = 48
"""At which courses are compared, and turns about obstacles counted."""
LOOKED_AT = 3000
"""Courses of a number of arcs that are compared, the cheapest ones."""
WIDEST_CRAB_DEG, DRAGGED_DEG = 60.0, 5.0
"""A rover is not driven more sidewards than this where all its wheels steer, and where some are dragged; assumed."""
LEAST_TURN_DEG = 15.0
"""Manners that begin with a spot turn are tried from this turn on: arcs reach targets less far to the side as well;
assumed."""
FIX_EVERY_M = (5.0, 2.5)
"""Ways between localisation updates that are tried, where there are any; assumed. [m]"""
MOST = 50


def course_places(start: FloatArray, arcs: FloatArray) -> FloatArray:
    """x, y at equal shares of the length of courses (n, k, 2) from one pose. (n, PLACES, 2) [m]"""
    count, number = arcs.shape[:2]
    distance = np.linspace(0.0, 1.0, PLACES) * arcs[..., 0].sum(axis=1)[:, None]
    pose = [np.full((count, PLACES), start[axis]) for axis in range(3)]
    for arc in range(number):
        length, curvature = arcs[:, arc, :1], arcs[:, arc, 1:]
        last = arc == number - 1
        piece = distance if last else np.minimum(distance, length)
        pose = list(arc_end(pose[0], pose[1], pose[2], piece, np.broadcast_to(curvature, piece.shape)))
        distance = distance - piece
    return np.stack(pose[:2], axis=-1)


def obstacle_places(problem: ArcProblem) -> FloatArray:
    """A place in each obstacle that a rover's centre can be driven round on either side. (m, 2) [m]

    Obstacles are parts of the ground, apart from each other, from which the centre of the rover must keep away. Those
    at the frame of what is looked at have one side only.
    """
    window = problem.window
    distance = window.values[..., 0]
    parts, count = label(distance < problem.need_m, structure=np.ones((3, 3)))
    at_frame = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    inner = np.setdiff1d(np.arange(1, count + 1), at_frame)
    if not inner.size:
        return np.empty((0, 2))
    rows, columns = np.array(minimum_position(distance, parts, inner)).T
    return np.column_stack([window.x0 + window.spacing * columns, window.y0 + window.spacing * rows])


def sides(places_m: FloatArray, obstacles_m: FloatArray) -> IntArray:
    """On which side courses with the same ends pass each obstacle: turns about it, next to the straight way. (n, m)

    Places (n, k, 2), obstacles (m, 2) [m]. Courses of one homology class have the same numbers (Bhattacharya et al.
    2012, Auton. Robots 33, 273, 10.1007/s10514-012-9304-1): the angle swept about a point differs by whole turns.
    """
    if not len(obstacles_m):
        return np.zeros((len(places_m), 0), dtype=np.int64)
    off = places_m[:, :, None] - obstacles_m
    angle = np.arctan2(off[..., 1], off[..., 0])
    swept = _wrapped(np.diff(angle, axis=1)).sum(axis=1)
    straight = _wrapped(angle[:, -1] - angle[:, 0])
    return np.asarray(np.rint((swept - straight) / (2.0 * math.pi)).astype(np.int64))


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class DistinctWays:
    """Picks the cheapest course of each way.

    Attributes
    ----------
    problem : of the courses.
    obstacles_m : from `obstacle_places`. (m, 2) [m]
    apart_m : courses that pass all obstacles alike are two ways where they are so far apart somewhere. [m]
    most : courses picked.
    """

    problem: ArcProblem
    obstacles_m: FloatArray
    apart_m: float
    most: int

    def __call__(self, arcs: FloatArray, cost: FloatArray) -> Sequence[int]:
        """Numbers of the picked courses (n, k, 2), the cheapest first; a `Pick` of `lattice_courses`."""
        order = np.argsort(cost, kind="stable")
        order = order[np.isfinite(cost[order])][:LOOKED_AT]
        if not order.size:
            return []
        return [int(order[k]) for k in self.of_places(course_places(self.problem.start, arcs[order]))]

    def of_places(self, places_m: FloatArray) -> list[int]:
        """The same for courses by their places, the cheapest first: first all classes, then what is far apart."""
        passed = sides(places_m, self.obstacles_m)
        _, first = np.unique(passed, axis=0, return_index=True)
        picked = sorted(int(number) for number in first)[: self.most]
        left = np.setdiff1d(np.arange(len(places_m)), picked)
        for number in picked:
            left = left[self._apart(places_m, passed, left, number)]
        while left.size and len(picked) < self.most:
            picked.append(int(left[0]))
            left = left[self._apart(places_m, passed, left, picked[-1])]
        return picked

    def _apart(self, places_m: FloatArray, passed: IntArray, others: IntArray, one: int) -> FloatArray:
        far = np.hypot(*np.moveaxis(places_m[others] - places_m[one], -1, 0)).max(axis=1) > self.apart_m
        return np.asarray(far | (passed[others] != passed[one]).any(axis=1))


@dataclass(frozen=True, slots=True)
class Manner:
    """How a drive goes.

    Attributes
    ----------
    turn_deg : spot turn at the start, positive to the left. [deg]
    crab_deg : angle of travel to the heading on the arcs that follow; 180 is backwards. [deg]
    """

    turn_deg: float = 0.0
    crab_deg: float = 0.0

    @property
    def words(self) -> str:
        """For people."""
        side = "left" if self.crab_deg > 0 else "right"
        travel = {0.0: "ahead", 180.0: "back"}.get(self.crab_deg, f"crab {abs(self.crab_deg):.0f}° {side},")
        return f"turn {self.turn_deg:+.0f}° {travel}" if self.turn_deg else travel


def manners(rover: Rover, start: FloatArray, goal: FloatArray) -> tuple[Manner, ...]:
    """Ahead, backwards, crabwise to the side of the target, and after a spot turn where it lies far to the side.

    Poses [m, m, rad].
    """
    way = goal[:2] - start[:2]
    bearing = math.degrees(math.remainder(math.atan2(way[1], way[0]) - start[2], 2.0 * math.pi))
    back = math.remainder(bearing + 180.0, 360.0)
    widest = WIDEST_CRAB_DEG if rover.steered_mask.all() else DRAGGED_DEG
    crab = round(math.copysign(min(max(abs(bearing), DRAGGED_DEG), widest), bearing), 1)
    result = [Manner(), Manner(crab_deg=180.0), Manner(crab_deg=crab)]
    if abs(bearing) >= LEAST_TURN_DEG:
        result.append(Manner(turn_deg=round(bearing, 1)))
    if abs(back) >= LEAST_TURN_DEG:
        result.append(Manner(turn_deg=round(back, 1), crab_deg=180.0))
    return tuple(result)


class CandidatePlans(NamedTuple):
    """Drives to a target that differ, and why there are no more.

    Attributes
    ----------
    plans : the drives.
    blocked : manners of driving in words of which no course keeps the clearance.
    alike, costly : courses left out, as they lead along another one, or cost more than `LONGEST` times the least.
    """

    plans: tuple[Plan, ...]
    blocked: tuple[str, ...]
    alike: int
    costly: int

    @property
    def why_no_more(self) -> str:
        """One sentence."""
        names = ", ".join(f"'{words.rstrip(',')}'" for words in self.blocked)
        none = f"no way keeps clear of hazards for {names}" if names else ""
        alike = f"{counted(self.alike, 'way')} left out, alike to one of these" if self.alike else ""
        dear = (
            f"{counted(self.costly, 'way')} left out, at over {LONGEST:g} times the least cost" if self.costly else ""
        )
        return f"there are no more drives to compare: {'; '.join(filter(None, (none, alike, dear))) or 'none differs'}"


def candidate_plans(
    surface: Traversability,
    rover: Rover,
    start: tuple[float, float, float],
    target: tuple[float, float],
    *,
    final_heading_deg: float | None = None,
    speed_m_s: float | None = None,
    limits: tuple[Limit, ...] = (),
    fixes: Fixes | None = None,
    most: int = MOST,
    progress: Progress | None = None,
) -> CandidatePlans:
    """Drives to a target that differ, at most `most`; the first is the cheapest on the maps.

    Parameters
    ----------
    surface, rover, start, target, final_heading_deg, speed_m_s, limits : as for `plan_path`.
    fixes : errors of localisation updates; with them part of the drives halt for some on the way. None drives without.
    progress : called with (manners of driving searched, all of them).

    Of each manner of driving (ahead, backwards, crabwise, after a spot turn) the cheapest course round each side of the
    obstacles is refined, and courses join it that sweep other ground. All keep the clearance that `plan_path` keeps,
    and end at the target. Raises ParameterError as `plan_path` does, also where there is none.
    """
    check_range("candidates", most, "[1, inf)")
    search = RouteSearch.of(surface, rover, start, target, final_heading_deg)
    template = Plan(
        name="candidate", legs=(Leg(1.0),), speed_m_s=commanded_speed(rover, speed_m_s), x_m=start[0], y_m=start[1],
        heading_deg=start[2], limits=limits,
    )  # fmt: skip
    ahead = search.problem(search.footprint, search.start, search.goal)
    ways = DistinctWays(ahead, obstacle_places(ahead), search.footprint.half_width_m, most)
    all_manners = manners(rover, search.start, search.goal)
    by_manner: list[list[tuple[float, Plan]]] = []
    alike = 0
    for number, manner in enumerate(all_manners):
        if progress is not None:
            progress(number, len(all_manners))
        plans, same = _plans(search, ways, manner, template)
        by_manner.append(plans)
        alike += same
    if progress is not None:
        progress(len(all_manners), len(all_manners))
    if not any(by_manner):
        raise ParameterError(search.why_not(lattice_courses(ahead).nearest))
    least = min(cost for plans in by_manner for cost, _ in plans)
    near = [[one for one in plans if one[0] <= LONGEST * least] for plans in by_manner]
    first = sorted((plans[0] for plans in near if plans), key=lambda one: one[0])
    rest = sorted((one for plans in near for one in plans[1:]), key=lambda one: one[0])
    ordered = [plan for _, plan in (*first, *rest)]
    return CandidatePlans(
        plans=tuple(ordered[:most]) if fixes is None else _with_fixes(ordered, fixes, most),
        blocked=tuple(one.words for one, plans in zip(all_manners, by_manner, strict=True) if not plans),
        alike=alike,
        costly=sum(map(len, by_manner)) - len(ordered),
    )


def _plans(
    search: RouteSearch, ways: DistinctWays, manner: Manner, template: Plan
) -> tuple[list[tuple[float, Plan]], int]:
    """Plans of one manner with their costs, the cheapest first, and how many courses are like one of these.

    None where there is no room for its turn.
    """
    turned = search.start + np.array([0.0, 0.0, math.radians(manner.turn_deg)])
    if manner.turn_deg and not search.has_room_to_turn(manner.turn_deg):
        return [], 0
    crab = np.array([0.0, 0.0, math.radians(manner.crab_deg)])
    footprint = _enclosing(search.footprint, math.radians(manner.crab_deg))
    problem = search.problem(footprint, turned + crab, search.goal + crab)
    plans = []
    courses, alike = _courses(replace(ways, problem=problem))
    for course in courses:
        arcs = tuple(Leg(float(length), float(bend), manner.crab_deg) for length, bend in course.arcs)
        legs = (Leg(turn_deg=manner.turn_deg), *arcs) if manner.turn_deg else arcs
        places = course_places(problem.start, course.arcs[None])[0]
        plans.append((course.cost_m, replace(template, name=f"{manner.words} {_bend(places)}", legs=legs)))
    return plans, alike


def _courses(ways: DistinctWays) -> tuple[list[Course], int]:
    """Distinct courses of any number of arcs, the best of each class refined, cheapest first; how many are alike."""
    problem = ways.problem
    lattice = lattice_courses(problem, ways)
    if not lattice.complete:
        nearly = filter(None, (refine(problem, course) for course in lattice.nearly))
        return sorted(nearly, key=lambda one: one.cost_m), 0
    courses = sorted(lattice.complete, key=lambda course: course.cost_m)
    places = np.concatenate([course_places(problem.start, course.arcs[None]) for course in courses])
    picked, seen = [courses[number] for number in ways.of_places(places)], set()
    distinct = []
    for course in picked:
        side = tuple(sides(course_places(problem.start, course.arcs[None]), ways.obstacles_m)[0])
        better = None if side in seen else refine(problem, course)
        seen.add(side)
        if better is not None or keeps_clear(problem.fine, course.arcs):
            distinct.append(better or course)
    return sorted(distinct, key=lambda course: course.cost_m), len(courses) - len(picked)


def _enclosing(footprint: RoverFootprint, angle: float) -> RoverFootprint:
    """The smallest rectangle along the direction of travel that holds the footprint."""
    corners = footprint.corners_m(np.array([0.0, 0.0, -angle]))
    return RoverFootprint(
        rear_m=float(corners[:, 0].min()),
        front_m=float(corners[:, 0].max()),
        half_width_m=float(np.abs(corners[:, 1]).max()),
    )


def _bend(places_m: FloatArray) -> str:
    """How far to which side of the straight way a course leads."""
    way = places_m[-1] - places_m[0]
    off = places_m - places_m[0]
    aside = (way[0] * off[:, 1] - way[1] * off[:, 0]) / np.hypot(*way)
    far = float(aside[np.abs(aside).argmax()])
    return "straight" if abs(far) < 0.05 else f"{abs(far):.1f} m {'left' if far > 0 else 'right'}"


def _with_fixes(plans: list[Plan], fixes: Fixes, most: int) -> tuple[Plan, ...]:
    """Plans in turn without and with localisation updates, the cheapest first."""
    halting = [_halting(plan, fixes, every) for plan in plans for every in FIX_EVERY_M]
    fixed = list(dict.fromkeys(plan for plan in halting if plan is not None))
    free = plans[: max(1, most - len(fixed), most // 3)]
    return (*free, *fixed)[:most]


def _halting(plan: Plan, fixes: Fixes, every_m: float) -> Plan | None:
    """The plan with a halt and a localisation update so often; None where it is too short for one."""
    legs: list[Leg] = []
    for leg in plan.legs:
        pieces = max(1, math.ceil(leg.length_m / every_m - 0.25))
        legs += [replace(leg, length_m=leg.length_m / pieces)] * pieces
    updates = len(legs) - 1
    if not updates:
        return None
    label = "1 fix" if updates == 1 else f"{updates} fixes"
    return replace(plan, legs=tuple(legs), fixes=fixes, name=f"{plan.name}, {label}")
