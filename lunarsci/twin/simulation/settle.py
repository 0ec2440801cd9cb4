"""The rovers at rest on the ground, before they drive."""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.twin.ground.terrain import lay_soil, read_ground
from lunarsci.twin.simulation.contact import AT_REST
from lunarsci.twin.simulation.integrate import assemble, eliminate, is_upright, move
from lunarsci.twin.simulation.lanes import (
    ARM,
    AXES,
    CENTER,
    CHANGE,
    GROUND,
    HOLD,
    LANES,
    LAST,
    MATRIX,
    NORMAL,
    POSE,
    RIGHT,
    SLIP,
    SPEED,
    TRAVEL,
)
from lunarsci.twin.simulation.outcomes import CLIFF, DIVERGED, FINISHED, HOLE, LEFT, OVERTURNED, SANK, UNSETTLED

__all__ = ["balance", "place", "settle"]

SETTLE_ROUNDS = 300
SETTLE_TOLERANCE = 1e-9
# Longest move of a settling round [m or rad]: less than it takes to lift a wheel off its neighbour's plane.
LONGEST_MOVE = 0.02
# Share of a change of the forces along the surface that a round makes: with all of it loads and forces chase each other
# on steep ground.
CALM = 0.4


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def place(rover: Any, tyre: Any, grid: Any, override: Any, start: Any, work: Any) -> None:
    """Put the rovers above the plane through the ground under their wheels, 1 cm deep.

    `start` (LANES, 3) is x, y, heading.
    """
    count = len(rover.arms)
    x, y, z = np.empty(count), np.empty(count), np.empty(count)
    for w in range(count):
        side, hung = 1.0 if w % 2 == 0 else -1.0, rover.hung[w]
        x[w] = rover.arms[w, 0] + hung * rover.bogie[0]
        y[w] = rover.arms[w, 1] + side * (rover.pivot_y + hung * rover.bogie[1])
        z[w] = rover.arms[w, 2] + hung * rover.bogie[2]
        for lane in range(LANES):
            c, s = math.cos(start[lane, 2]), math.sin(start[lane, 2])
            work.wheels[w, CENTER * LANES + lane] = start[lane, 0] + c * x[w] - s * y[w]
            work.wheels[w, (CENTER + 1) * LANES + lane] = start[lane, 1] + s * x[w] + c * y[w]
        lay_soil(grid, override, work.wheels[w])
        read_ground(grid, override, work.wheels[w], work.code)
    middle, height = x.mean(), z.mean()
    long_2, wide_2 = 1e-12 + ((x - middle) ** 2).sum(), 1e-12 + (y * y).sum()
    work.body[:] = 0.0
    for lane in range(LANES):
        mean, along, across = 0.0, 0.0, 0.0
        for w in range(count):
            ground = work.wheels[w, GROUND * LANES + lane]
            mean += ground / count
            along += ground * (x[w] - middle)
            across += ground * y[w]
        rise, bank = along / long_2, across / wide_2
        lift = (tyre[0] - 0.01) * math.sqrt(1.0 + rise * rise + bank * bank)
        yaw, pitch, roll = 0.5 * start[lane, 2], -0.5 * math.atan(rise), 0.5 * math.atan(bank)
        cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
        cr, sr = math.cos(roll), math.sin(roll)
        values = (
            start[lane, 0], start[lane, 1], mean - rise * middle - height + lift,
            cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr,
        )  # fmt: skip
        for k in range(7):
            work.body[(POSE + k) * LANES + lane] = values[k]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def lock(work: Any, dt: float, tolerance: float, done: Any, left: Any) -> None:
    """Hold x, y and yaw; mark lanes as done whose largest force on the free coordinates is below tolerance [N, N m].

    `left` takes the forces on what is held.
    """
    for lane in range(LANES):
        largest = 0.0
        for i in range(9):
            own, row = (1, 7) if i == 8 else (0, i)
            force = work.sides[own, (RIGHT + row) * LANES + lane]
            if i < 7:
                force += work.sides[1 - own, (RIGHT + row) * LANES + lane]
            if i == 0 or i == 1 or i == 5:
                left[lane, min(i, 2)] = -force / dt
                for side in range(2):
                    for k in range(8):
                        work.sides[side, (MATRIX + 8 * i + k) * LANES + lane] = 0.0
                    work.sides[side, (MATRIX + 9 * i) * LANES + lane] = 0.5
                    work.sides[side, (RIGHT + i) * LANES + lane] = 0.0
            else:
                largest = max(largest, abs(force) / dt)
        if largest < tolerance:
            done[lane] = True


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def shorten(work: Any, most: float, done: Any) -> None:
    """Scale the changes so that no entry of a lane exceeds `most`; lanes that are done or lost stay."""
    for lane in range(LANES):
        largest = 0.0
        for i in range(9):
            largest = max(largest, abs(work.body[(CHANGE + i) * LANES + lane]))
        share = 0.0 if done[lane] or not largest < np.inf else min(1.0, most / (largest + 1e-300))
        for i in range(9):
            work.body[(CHANGE + i) * LANES + lane] = (
                share * work.body[(CHANGE + i) * LANES + lane] if share > 0.0 else 0.0
            )
        if not largest < np.inf and work.code[lane] == FINISHED:
            work.code[lane] = UNSETTLED


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def lean_on(work: Any, left: Any, pull: Any, leaning: Any, done: Any, tolerance: float) -> None:
    """Let the ground hold what `left` (LANES, 3) says has to hold the rovers: along its surface under every wheel.

    How the forces share out among the wheels is not determined; each takes as much of its load as the others, along
    the way in which the rover would start to slide and turn, which `pull` (LANES, 3) keeps. Lanes are `leaning` from
    when they first stand; those where more than `tolerance` [N, N m] is left are not done.
    """
    share, moved = np.empty((3, 3)), np.empty((3, 3))
    for lane in range(LANES):
        if not leaning[lane]:
            leaning[lane], done[lane] = done[lane], False
        if not leaning[lane] or not abs(left[lane, 0]) + abs(left[lane, 1]) + abs(left[lane, 2]) < np.inf:
            continue
        share[:] = 0.0
        for w in range(len(work.wheels)):
            slide_along(work.wheels[w], lane, moved)
            for i in range(3):
                for k in range(3):
                    for m in range(3):
                        share[i, k] += work.wheels[w, NORMAL * LANES + lane] * moved[m, i] * moved[m, k]
        for i in range(3):
            if abs(left[lane, i]) > tolerance:
                done[lane] = False
        if not done[lane] and np.linalg.det(share) > 0.0:
            pull[lane] += CALM * np.linalg.solve(share, left[lane])
        for w in range(len(work.wheels)):
            slide_along(work.wheels[w], lane, moved)
            for m in range(3):
                along = moved[m, 0] * pull[lane, 0] + moved[m, 1] * pull[lane, 1] + moved[m, 2] * pull[lane, 2]
                row = (HOLD + m) * LANES + lane
                wanted = work.wheels[w, NORMAL * LANES + lane] * along
                work.wheels[w, row] += CALM * (wanted - work.wheels[w, row])


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def slide_along(wheel: Any, lane: int, moved: Any) -> None:
    """Way of a wheel's centre along the surface as the rover moves in x, in y and turns about the vertical. (3, 3)"""
    x, y = wheel[ARM * LANES + lane], wheel[(ARM + 1) * LANES + lane]
    n = (AXES + 6) * LANES + lane
    n_x, n_y, n_z = wheel[n], wheel[n + LANES], wheel[n + 2 * LANES]
    for i in range(3):
        v_x, v_y = (1.0, 0.0) if i == 0 else (0.0, 1.0) if i == 1 else (-y, x)
        out = v_x * n_x + v_y * n_y
        moved[0, i], moved[1, i], moved[2, i] = v_x - out * n_x, v_y - out * n_y, -out * n_z


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def balance(rover: Any, tyre: Any, grid: Any, override: Any, mode: int, velocity: Any, left: Any, work: Any) -> None:
    """Bring the rovers into equilibrium at their x, y and yaw, with the forces of `mode` at `velocity` (LANES, 9).

    Each round is a step from rest with a growing dt, which turns from damped dynamics into a Newton iteration.
    Converged at 1e-9 of the weight. `left` (LANES, 3) takes the force in x and y [N] and the moment about the vertical
    [N m] that hold the rover beside the wheels; none is left `AT_REST`, where the ground does. Outcomes in `work.code`.
    """
    weight = (rover.body_kg + len(rover.arms) * rover.wheel_kg) * rover.gravity
    done, leaning, pull = np.zeros(LANES, dtype=np.bool_), np.zeros(LANES, dtype=np.bool_), np.zeros((LANES, 3))
    dt = 0.05
    for _ in range(SETTLE_ROUNDS):
        for lane in range(LANES):
            for i in range(9):
                work.body[(SPEED + i) * LANES + lane] = velocity[lane, i]
            if work.code[lane] == SANK and not done[lane]:
                work.code[lane] = FINISHED
        assemble(rover, tyre, grid, override, dt, mode, work)
        done[leaning] = False
        lock(work, dt, SETTLE_TOLERANCE * weight, done, left)
        if mode == AT_REST:
            lean_on(work, left, pull, leaning, done, SETTLE_TOLERANCE * weight)
        for lane in range(LANES):
            if work.code[lane] in (LEFT, HOLE, CLIFF, OVERTURNED, UNSETTLED, DIVERGED):
                done[lane] = True
        if done.all():
            break
        eliminate(work)
        shorten(work, 2.0 * LONGEST_MOVE / dt, done)
        work.body[SPEED * LANES : (SPEED + 9) * LANES] = 0.0
        move(work.body, dt)
        dt = min(1.5 * dt, 30.0)
        for lane in range(LANES):
            if work.code[lane] == FINISHED and not is_upright(work.body, lane):
                work.code[lane] = UNSETTLED
    for lane in range(LANES):
        if not done[lane]:
            work.code[lane] = UNSETTLED


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def settle(rover: Any, tyre: Any, grid: Any, override: Any, start: Any, work: Any) -> None:
    """Bring the rovers, steered as `work` says, to static equilibrium at `start` (LANES, 3): x, y, heading.

    The ground holds them, along its surface too, whatever its strength. Velocities are left at rest, outcomes in
    `work.code`.
    """
    work.code[:] = FINISHED
    for w in range(len(work.wheels)):
        work.wheels[w, SLIP * LANES : (SLIP + 1) * LANES] = 0.0
        work.wheels[w, LAST * LANES : (LAST + 1) * LANES] = 0.0
        work.wheels[w, TRAVEL * LANES : (TRAVEL + 1) * LANES] = 1.0
        work.wheels[w, HOLD * LANES : (HOLD + 3) * LANES] = 0.0
    place(rover, tyre, grid, override, start, work)
    balance(rover, tyre, grid, override, AT_REST, np.zeros((LANES, 9)), np.zeros((LANES, 3)), work)
    work.body[SPEED * LANES : (SPEED + 9) * LANES] = 0.0
