"""The rovers at rest on the ground, before they drive."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.twin.ground.terrain import lay_soil, read_ground
from lunarsci.twin.lanes import (
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
    Work,
)
from lunarsci.twin.outcomes import CLIFF, DIVERGED, FINISHED, HOLE, LEFT, OVERTURNED, SANK, UNSETTLED
from lunarsci.twin.simulation.contact import AT_REST
from lunarsci.twin.simulation.integrate import assemble, eliminate, is_upright, move

SETTLE_ROUNDS = 300
SETTLE_TOLERANCE = 1e-9
# Longest move of a settling round [m or rad]: less than it takes to lift a wheel off its neighbour's plane.
LONGEST_MOVE = 0.02
# Share of a change of the forces along the surface that a round makes: with all of it loads and forces chase each other
# on steep ground.
CALM = 0.4


def place(rover: Any, tyre: Any, grid: Any, override: Any, start: FloatArray, work: Work) -> None:
    """Put the rovers above the plane through the ground under their wheels, 1 cm deep.

    `start` (LANES, 3) is x, y, heading. Done once for a drive, and so not compiled.
    """
    side = np.where(np.arange(len(rover.arms)) % 2 == 0, 1.0, -1.0)
    x = rover.arms[:, 0] + rover.hung * rover.bogie[0]
    y = rover.arms[:, 1] + side * (rover.pivot_y + rover.hung * rover.bogie[1])
    z = rover.arms[:, 2] + rover.hung * rover.bogie[2]
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    rows = work.wheels.reshape(len(x), -1, LANES)
    rows[:, CENTER] = start[:, 0] + np.multiply.outer(x, c) - np.multiply.outer(y, s)
    rows[:, CENTER + 1] = start[:, 1] + np.multiply.outer(x, s) + np.multiply.outer(y, c)
    for wheel in work.wheels:
        lay_soil(grid, override, wheel)
        read_ground(grid, override, wheel, work.code)
    ground, ahead = rows[:, GROUND], x - x.mean()
    rise, bank = ahead @ ground / (1e-12 + ahead @ ahead), y @ ground / (1e-12 + y @ y)
    height = ground.mean(axis=0) - rise * x.mean() - z.mean() + (tyre[0] - 0.01) * np.sqrt(1.0 + rise**2 + bank**2)
    turned = Rotation.from_euler("ZYX", np.column_stack([start[:, 2], -np.arctan(rise), np.arctan(bank)]))
    work.body[:] = 0.0
    quaternion = turned.as_quat(scalar_first=True)
    work.body.reshape(-1, LANES)[POSE : POSE + 7] = np.column_stack([start[:, :2], height, quaternion]).T


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def lock(work: Any, time_step_s: float, tolerance: float, done: Any, left: Any) -> None:
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
                left[lane, min(i, 2)] = -force / time_step_s
                for side in range(2):
                    for k in range(8):
                        work.sides[side, (MATRIX + 8 * i + k) * LANES + lane] = 0.0
                    work.sides[side, (MATRIX + 9 * i) * LANES + lane] = 0.5
                    work.sides[side, (RIGHT + i) * LANES + lane] = 0.0
            else:
                largest = max(largest, abs(force) / time_step_s)
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
        for i in range(9):
            share[i // 3, i % 3] = 0.0
        for w in range(len(work.wheels)):
            slide_along(work.wheels[w], lane, moved)
            for i in range(3):
                for k in range(3):
                    for m in range(3):
                        share[i, k] += work.wheels[w, NORMAL * LANES + lane] * moved[m, i] * moved[m, k]
        for i in range(3):
            if abs(left[lane, i]) > tolerance:
                done[lane] = False
        if not done[lane]:
            found = solved(share, left[lane])
            for i in range(3):
                pull[lane, i] += CALM * found[i]
        for w in range(len(work.wheels)):
            slide_along(work.wheels[w], lane, moved)
            for m in range(3):
                along = moved[m, 0] * pull[lane, 0] + moved[m, 1] * pull[lane, 1] + moved[m, 2] * pull[lane, 2]
                row = (HOLD + m) * LANES + lane
                wanted = work.wheels[w, NORMAL * LANES + lane] * along
                work.wheels[w, row] += CALM * (wanted - work.wheels[w, row])


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def solved(matrix: Any, side: Any) -> tuple[float, float, float]:
    """Solution of a symmetric system of three, zeros where it has none; compiled sooner than the library's."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    whole = a * aa + b * ab + c * ac
    if not whole > 0.0:
        return 0.0, 0.0, 0.0
    return (
        (aa * side[0] + ab * side[1] + ac * side[2]) / whole,
        (ab * side[0] + bb * side[1] + bc * side[2]) / whole,
        (ac * side[0] + bc * side[1] + cc * side[2]) / whole,
    )


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

    Each round is a step from rest with a growing time_step_s, which turns from damped dynamics into a Newton iteration.
    Converged at 1e-9 of the weight. `left` (LANES, 3) takes the force in x and y [N] and the moment about the vertical
    [N m] that hold the rover beside the wheels; none is left `AT_REST`, where the ground does. Outcomes in `work.code`.
    """
    weight = (rover.body_kg + len(rover.arms) * rover.wheel_kg) * rover.gravity
    done, leaning, pull = np.zeros(LANES, dtype=np.bool_), np.zeros(LANES, dtype=np.bool_), np.zeros((LANES, 3))
    time_step_s = 0.05
    for _ in range(SETTLE_ROUNDS):
        for lane in range(LANES):
            for i in range(9):
                work.body[(SPEED + i) * LANES + lane] = velocity[lane, i]
            if work.code[lane] == SANK and not done[lane]:
                work.code[lane] = FINISHED
        assemble(rover, tyre, grid, override, time_step_s, mode, work)
        for lane in range(LANES):
            done[lane] = done[lane] and not leaning[lane]
        lock(work, time_step_s, SETTLE_TOLERANCE * weight, done, left)
        if mode == AT_REST:
            lean_on(work, left, pull, leaning, done, SETTLE_TOLERANCE * weight)
        open_lanes = 0
        for lane in range(LANES):
            done[lane] = done[lane] or work.code[lane] in (LEFT, HOLE, CLIFF, OVERTURNED, UNSETTLED, DIVERGED)
            open_lanes += not done[lane]
        if open_lanes == 0:
            break
        eliminate(work)
        shorten(work, 2.0 * LONGEST_MOVE / time_step_s, done)
        for k in range(SPEED * LANES, (SPEED + 9) * LANES):
            work.body[k] = 0.0
        move(work.body, time_step_s)
        time_step_s = min(1.5 * time_step_s, 30.0)
        for lane in range(LANES):
            if work.code[lane] == FINISHED and not is_upright(work.body, lane):
                work.code[lane] = UNSETTLED
    for lane in range(LANES):
        if not done[lane]:
            work.code[lane] = UNSETTLED


def settle(rover: Any, tyre: Any, grid: Any, override: Any, start: FloatArray, work: Work) -> None:
    """Bring the rovers, steered as `work` says, to static equilibrium at `start` (LANES, 3): x, y, heading.

    The ground holds them, along its surface too, whatever its strength. Velocities are left at rest, outcomes in
    `work.code`.
    """
    work.code[:] = FINISHED
    rows = work.wheels.reshape(len(work.wheels), -1, LANES)
    rows[:, [SLIP, LAST, HOLD, HOLD + 1, HOLD + 2]], rows[:, TRAVEL] = 0.0, 1.0
    place(rover, tyre, grid, override, start, work)
    balance(rover, tyre, grid, override, AT_REST, np.zeros((LANES, 9)), np.zeros((LANES, 3)), work)
    work.body[SPEED * LANES : (SPEED + 9) * LANES] = 0.0
