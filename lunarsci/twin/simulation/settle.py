"""The rovers at rest on the ground, before they drive."""

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import Fields, choose, highest, lowest
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, lay_soil, read_ground
from lunarsci.twin.lanes import (
    BODY,
    CLIFF,
    DIVERGED,
    FINISHED,
    GROUP,
    HOLE,
    LEFT,
    OVERTURNED,
    SANK,
    SYSTEM,
    UNSETTLED,
    WHEEL,
    Work,
    dot,
    plus,
    times,
)
from lunarsci.twin.simulation.contact import AT_REST
from lunarsci.twin.simulation.dynamics import assemble, eliminate, is_upright, move, note_outcomes

SETTLE_ROUNDS = 300
"""After which a rover counts as one that did not settle; assumed."""
SETTLE_TOLERANCE = 1e-9
"""Largest force that is left in equilibrium, as a share of the weight."""
LONGEST_MOVE = 0.02
"""Longest move of a settling round [m, rad]: less than it takes to lift a wheel off its neighbour's plane."""
CALM = 0.4
"""Share of a change of the forces along the surface that a round makes: with all of it loads and forces chase each
other on steep ground."""
INFINITE = math.inf
REST = Fields(GROUP, done=1, leaning=1, left=3, pull=3, share=9)
"""Rows of what a search for rest keeps: 1 where it has found it, 1 where the ground begins to hold the rover (see
`lean_on`), the force in x and y and the moment about the vertical that hold it beside the wheels, the way in which it
would start to slide and turn, and the loads of the wheels times their ways along it."""
REST_SIZE, LEFT_AT = REST.rows * GROUP, REST.first["left"] * GROUP
"""Length of such an array, and where `left` begins in it."""
VELOCITY = Fields(GROUP, all=9)
"""Rows of the nine velocities of `lunarsci.twin.simulation.dynamics`."""


def tread(tyre: Any, override: FloatArray, work: Work) -> None:
    """Contact angles and r_s of each rover's wheels: those of `override` (GROUP, 12), else of the stated wheel."""
    angles, ratio = override[:, len(SOIL_COLUMNS) : -1], np.nan_to_num(override[:, -1], nan=1.0)
    contact = np.where(np.isnan(angles), tyre[4:], angles)
    WHEEL.view(work.wheels, "tread")[:] = np.column_stack([ratio * tyre[3], contact, ratio]).T


def place(rover: Any, tyre: Any, grid: Any, override: Any, start: FloatArray, work: Work) -> None:
    """Put the rovers above the plane through the ground under their wheels, 1 cm deep.

    `start` (GROUP, 3) is x, y, heading [m, m, rad]; others as in `balance`. Done once for a drive, and so not compiled.
    """
    side = np.where(np.arange(len(rover.arms)) % 2 == 0, 1.0, -1.0)
    x = rover.arms[:, 0] + rover.hung * rover.bogie[0]
    y = rover.arms[:, 1] + side * (rover.pivot_y + rover.hung * rover.bogie[1])
    z = rover.arms[:, 2] + rover.hung * rover.bogie[2]
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    center = WHEEL.view(work.wheels, "center")
    center[:, 0] = start[:, 0] + np.multiply.outer(x, c) - np.multiply.outer(y, s)
    center[:, 1] = start[:, 1] + np.multiply.outer(x, s) + np.multiply.outer(y, c)
    tread(tyre, override, work)
    for wheel in work.wheels:
        lay_soil(grid, override, wheel)
        read_ground(grid, override, wheel, work.code)
    ground, ahead = WHEEL.view(work.wheels, "ground")[:, 0], x - x.mean()
    rise, bank = ahead @ ground / (1e-12 + ahead @ ahead), y @ ground / (1e-12 + y @ y)
    height = ground.mean(axis=0) - rise * x.mean() - z.mean() + (tyre[0] - 0.01) * np.sqrt(1.0 + rise**2 + bank**2)
    turned = Rotation.from_euler("ZYX", np.column_stack([start[:, 2], -np.arctan(rise), np.arctan(bank)]))
    work.body[:] = 0.0
    BODY.view(work.body, "position")[:] = np.column_stack([start[:, :2], height]).T
    BODY.view(work.body, "quaternion")[:] = turned.as_quat(scalar_first=True).T


@formula
def lock(work: Any, rest: Any, time_step_s: Any, tolerance: Any, lane: Any) -> None:
    """Hold x, y and yaw; mark members as done whose largest force on the free coordinates is below tolerance [N, N m].

    `left` takes the forces on what is held.
    """
    sides, search = [SYSTEM.of(work.sides, k, lane) for k in range(2)], REST.of(rest, lane)
    force = [sides[0].right[i] + sides[1].right[i] for i in range(7)] + [side.right[7] for side in sides]
    largest = 0.0
    for i in (2, 3, 4, 6, 7, 8):
        largest = highest(abs(force[i]) / time_step_s, largest)
    search.left = tuple(-force[i] / time_step_s for i in (0, 1, 5))
    search.done = choose(search.leaning, 0.0, search.done)
    search.done = choose(largest < tolerance, 1.0, search.done)
    for side in sides:
        matrix, right = list(side.matrix), list(side.right)
        for i in (0, 1, 5):
            matrix[8 * i : 8 * i + 8], right[i] = [0.0] * 8, 0.0
            matrix[9 * i] = 0.5
        side.matrix, side.right = tuple(matrix), tuple(right)


@formula
def shorten(work: Any, rest: Any, most: Any, lane: Any) -> None:
    """Scale the changes so that no entry exceeds `most`; members that are done or lost stay."""
    body, done, largest = BODY.of(work.body, lane), REST.of(rest, lane).done > 0.0, 0.0
    for change in body.change:
        largest = highest(abs(change), largest)
    goes = ~done & (largest < INFINITE)
    share = choose(goes, lowest(1.0, most / (largest + 1e-300)), 0.0)
    body.change = tuple(choose(goes, share * change, 0.0) for change in body.change)
    body.outcome = choose(largest < INFINITE, FINISHED, UNSETTLED)


def slide_along(wheel: Any) -> Any:
    """Way of a wheel's centre along the surface as the rover moves in x, in y and turns about the vertical."""
    normal = wheel.upward
    ways = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-wheel.arm[1], wheel.arm[0], 0.0))
    return [plus(way, times(normal, -(way[0] * normal[0] + way[1] * normal[1]))) for way in ways]


@formula
def add_load(work: Any, w: Any, rest: Any, lane: Any) -> None:
    """Add a wheel's load times its ways along the surface to `share`."""
    wheel, search = WHEEL.of(work.wheels, w, lane), REST.of(rest, lane)
    moved = slide_along(wheel)
    search.share = plus(search.share, tuple(wheel.normal * dot(a, b) for a in moved for b in moved))


@formula
def find_pull(rest: Any, tolerance: Any, lane: Any) -> None:
    """Change `pull` so that the ground holds what is left; members where more than `tolerance` is left are not done."""
    search = REST.of(rest, lane)
    finite, left = abs(search.left[0]) + abs(search.left[1]) + abs(search.left[2]) < INFINITE, search.left
    begins = ~(search.leaning > 0.0)
    search.leaning, done = choose(begins, search.done, search.leaning), choose(begins, 0.0, search.done)
    active = (search.leaning > 0.0) & finite
    for part in left:
        done = choose(active & (abs(part) > tolerance), 0.0, done)
    wanted, search.done = solved(search.share, left), done
    goes = active & ~(done > 0.0)
    search.pull = tuple(choose(goes, old + CALM * more, old) for old, more in zip(search.pull, wanted, strict=True))


@formula
def hold(work: Any, w: Any, rest: Any, lane: Any) -> None:
    """Let the ground hold a wheel with its share of the pull, more of it in each round."""
    wheel, search = WHEEL.of(work.wheels, w, lane), REST.of(rest, lane)
    finite = abs(search.left[0]) + abs(search.left[1]) + abs(search.left[2]) < INFINITE
    moved, active = slide_along(wheel), (search.leaning > 0.0) & finite
    along = plus(*map(times, moved, search.pull))
    wheel.hold = tuple(
        choose(active, old + CALM * (wheel.normal * new - old), old) for old, new in zip(wheel.hold, along, strict=True)
    )


def solved(matrix: Any, side: Any) -> Any:
    """Solution of a symmetric system of three, its matrix by rows (9,), zeros where it has none."""
    a, b, c, _, d, e, _, _, f = matrix
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    whole = a * aa + b * ab + c * ac
    rows = ((aa, ab, ac), (ab, bb, bc), (ac, bc, cc))
    return tuple(choose(whole > 0.0, dot(row, side) / whole, 0.0) for row in rows)


@formula
def clear_share(rest: Any, lane: Any) -> None:
    """No load as yet."""
    REST.of(rest, lane).share = (0.0,) * 9


@compiled
def lean_on(work: Any, rest: Any, tolerance: float) -> None:
    """Let the ground hold what `left` says has to hold the rovers: along its surface under every wheel.

    How the forces share out among the wheels is not determined; each takes as much of its load as the others, along
    the way in which the rover would start to slide and turn, which `pull` keeps. Members are `leaning` from when they
    first stand; those where more than `tolerance` [N, N m] is left are not done.
    """
    for lane in range(0, GROUP, LANES):
        clear_share(rest, lane)
        for w in range(len(work.wheels)):
            add_load(work, w, rest, lane)
        find_pull(rest, tolerance, lane)
        for w in range(len(work.wheels)):
            hold(work, w, rest, lane)


@formula
def start_from(work: Any, velocity: Any, lane: Any) -> None:
    """Give the rovers a velocity, rows `VELOCITY`. (9 * GROUP,)"""
    body, given = BODY.of(work.body, lane), VELOCITY.of(velocity, lane)
    body.speed, body.spin, body.rates = given.all[:3], given.all[3:6], given.all[6:]


@formula
def judge(work: Any, lane: Any) -> None:
    """Note who has overturned on the way to rest."""
    body = BODY.of(work.body, lane)
    body.outcome = choose(is_upright(body), body.outcome, UNSETTLED)


@compiled
def balance(rover: Any, tyre: Any, grid: Any, override: Any, mode: int, velocity: Any, left: Any, work: Any) -> None:
    """Bring the rovers into equilibrium at their x, y and yaw, with the forces of `mode` at `velocity` (GROUP, 9).

    `rover`, `tyre` and `grid` are `Rover.vector()`, `Wheel.vector()` and `Terrain.grid()`, `override` (GROUP, 12) soil
    and wheels of each rover, `mode` is one of `find_contact`, and `work` a `Work` with the poses to begin with.
    Each round is a step from rest with a growing time_step_s, which turns from damped dynamics into a Newton iteration.
    Converged at 1e-9 of the weight. `left` (GROUP, 3) takes the force in x and y [N] and the moment about the vertical
    [N m] that hold the rover beside the wheels; none is left `AT_REST`, where the ground does. Outcomes in `work.code`.
    """
    tolerance = SETTLE_TOLERANCE * (rover.body_kg + len(rover.arms) * rover.wheel_kg) * rover.gravity
    rest, none, given = np.zeros(REST_SIZE), np.zeros(9 * GROUP), np.zeros(9 * GROUP)
    for lane in range(GROUP):
        for i in range(9):
            given[i * GROUP + lane] = velocity[lane, i]
    time_step_s = 0.05
    for _ in range(SETTLE_ROUNDS):
        for lane in range(GROUP):
            if work.code[lane] == SANK and rest[lane] == 0.0:
                work.code[lane] = FINISHED
        for lane in range(0, GROUP, LANES):
            start_from(work, given, lane)
        assemble(rover, tyre, grid, override, time_step_s, mode, work)
        for lane in range(0, GROUP, LANES):
            lock(work, rest, time_step_s, tolerance, lane)
        if mode == AT_REST:
            lean_on(work, rest, tolerance)
        open_members = 0
        for lane in range(GROUP):
            if work.code[lane] in (LEFT, HOLE, CLIFF, OVERTURNED, UNSETTLED, DIVERGED):
                rest[lane] = 1.0
            open_members += rest[lane] == 0.0
        if open_members == 0:
            break
        for lane in range(0, GROUP, LANES):
            eliminate(work, lane)
            shorten(work, rest, 2.0 * LONGEST_MOVE / time_step_s, lane)
            start_from(work, none, lane)
            move(work.body, time_step_s, lane)
            judge(work, lane)
        note_outcomes(work.body, work.code)
        time_step_s = min(1.5 * time_step_s, 30.0)
    for lane in range(GROUP):
        for i in range(3):
            left[lane, i] = rest[LEFT_AT + i * GROUP + lane]
        if rest[lane] == 0.0:
            work.code[lane] = UNSETTLED


def settle(rover: Any, tyre: Any, grid: Any, override: Any, start: FloatArray, work: Work) -> None:
    """Bring the rovers, steered as `work` says, to static equilibrium at `start` (GROUP, 3): x, y, heading.

    The ground holds them, along its surface too, whatever its strength. Velocities are left at rest, outcomes in
    `work.code`.
    """
    work.code[:] = FINISHED
    for name, value in {"slip": 0.0, "last": 0.0, "hold": 0.0, "travel": 1.0}.items():
        WHEEL.view(work.wheels, name)[:] = value
    place(rover, tyre, grid, override, start, work)
    balance(rover, tyre, grid, override, AT_REST, np.zeros((GROUP, 9)), np.zeros((GROUP, 3)), work)
    for name in ("speed", "spin", "rates"):
        BODY.view(work.body, name)[:] = 0.0
