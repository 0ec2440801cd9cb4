"""One rover over the ground: settle it, drive it, record it.

The step is linearly implicit. With forces f, C = df/dv and K = df/dp at the start of the step,

    (M - dt C - dt^2/2 K) du = dt (f + dt K u0),    positions move with (u0 + u1)/2,

so free fall is exact, and the stiff parts (shear: 12-18 ms at 0.05 m/s, less when slower; sinkage: 60 ms) are damped
at any dt. First order in dt.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import compiled
from lunarsci.twin.contact import row_dot, wheel_contact
from lunarsci.twin.dynamics import inertia_and_free_force, rotation_of, wheel_jacobians
from lunarsci.twin.terrain import read_node

__all__ = ["OUTCOMES", "Work", "drive", "new_work", "settle", "step"]

OUTCOMES = (
    "finished",
    "left the terrain: a wheel passed the edge of the map",
    "hole in the terrain: no height below a wheel",
    "overturned: the chassis tilted by more than 60 deg",
    "diverged: the state is no longer finite",
    "did not settle: no static equilibrium at the start pose",
    "sank: a wheel is buried to its axle",
)
FINISHED, LEFT, HOLE, OVERTURNED, DIVERGED, UNSETTLED, SANK = range(7)
COS_OVERTURNED = 0.5
# Assumed. Ten times what a rover that drives cm/s can reach before the run has lost its meaning.
FASTEST = 10.0
SETTLE_ROUNDS = 300
SETTLE_TOLERANCE = 1e-10
# Longest move of a settling round [m or rad]: less than it takes to lift a wheel off its neighbour's plane.
LONGEST_MOVE = 0.02
FloatArray = npt.NDArray[np.float64]


class Work(NamedTuple):
    """Scratch arrays of one rover, so that a step allocates nothing."""

    jacobian: FloatArray
    chassis_jacobian: FloatArray
    center: FloatArray
    axle: FloatArray
    acceleration: FloatArray
    node: FloatArray
    rows: FloatArray
    wrench: FloatArray
    slopes: FloatArray
    state: FloatArray
    mass: FloatArray
    force: FloatArray
    system: FloatArray
    change: FloatArray


@compiled(error_model="numpy")
def new_work() -> Any:
    """Scratch arrays with the constant entries of the Jacobians in place."""
    jacobian, chassis = np.zeros((6, 6, 9)), np.zeros((3, 9))
    for i in range(3):
        chassis[i, i] = 1.0
        for w in range(6):
            jacobian[w, i, i] = 1.0
            jacobian[w, 3 + i, 3 + i] = 1.0
    return Work(
        jacobian,
        chassis,
        np.zeros((6, 3)),
        np.zeros((6, 3)),
        np.zeros((6, 3)),
        np.zeros(11),
        np.zeros((6, 6, 9)),
        np.zeros((6, 6)),
        np.zeros((6, 4, 6)),
        np.zeros((6, 10)),
        np.zeros((9, 9)),
        np.zeros(9),
        np.zeros((9, 10)),
        np.zeros(9),
    )


@compiled(error_model="numpy")
def eliminate(system: Any, solution: Any) -> None:
    """Solve the 9 x 9 system augmented by its right side, by Gaussian elimination with row pivoting."""
    n = 9
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(system[i, k]) > abs(system[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, n + 1):
                system[k, j], system[pivot, j] = system[pivot, j], system[k, j]
        inverse = 1.0 / system[k, k] if system[k, k] != 0.0 else np.inf
        for i in range(k + 1, n):
            factor = system[i, k] * inverse
            for j in range(k + 1, n + 1):
                system[i, j] -= factor * system[k, j]
    for k in range(n - 1, -1, -1):
        total = system[k, n]
        for j in range(k + 1, n):
            total -= system[k, j] * solution[j]
        solution[k] = total / system[k, k] if system[k, k] != 0.0 else np.inf


@compiled(error_model="numpy")
def evaluate(
    rover: Any, wheel: Any, grid: Any, override: Any, pose: Any, u: Any, steering: Any, speed: Any, work: Any, shear: float
) -> int:
    """Kinematics and ground contact of all wheels at `pose`, `u`; returns an outcome, FINISHED when all is well."""
    wheel_jacobians(rover, pose, u, steering, work)
    code = FINISHED
    for w in range(6):
        found = read_node(grid, work.center[w, 0], work.center[w, 1], override, work.node)
        if found != FINISHED:
            return found
        if wheel_contact(w, u, speed[w], wheel, work, shear) > wheel[0]:
            code = SANK
    return code


@compiled(error_model="numpy")
def assemble(rover: Any, pose: Any, u: Any, dt: float, work: Any) -> None:
    """Fill `work.force` (all forces) and `work.system`, the linear system of the step."""
    inertia_and_free_force(rover, pose, u, work)
    system, force = work.system, work.force
    for i in range(9):
        system[i, 9] = 0.0
        for k in range(9):
            system[i, k] = work.mass[i, k]
    system[6, 6] += 2.0 * dt * rover.joint_damping
    system[7, 7] += dt * rover.joint_damping
    system[8, 8] += dt * rover.joint_damping
    for w in range(6):
        rows, wrench, slopes = work.rows[w], work.wrench[w], work.slopes[w]
        sinking = dt * dt * row_dot(rows[2], u)
        for i in range(9):
            total, fx, fy, fn, fz = 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(6):
                lever = rows[a, i]
                total += lever * wrench[a]
                fx += lever * slopes[0, a]
                fy += lever * slopes[1, a]
                fn += lever * slopes[2, a]
                fz += lever * slopes[3, a]
            force[i] += total
            system[i, 9] -= fz * sinking
            # The sinkage falls when the centre rises along the normal: K = -fz rows[2].
            fx, fy, fn = dt * fx, dt * fy, dt * fn - 0.5 * dt * dt * fz
            for k in range(9):
                system[i, k] -= fx * rows[0, k] + fy * rows[1, k] + fn * rows[2, k]
    for i in range(9):
        system[i, 9] += dt * force[i]


@compiled(error_model="numpy")
def move(pose: Any, u: Any, change: Any, dt: float) -> None:
    """Advance `pose` with the mean of old and new velocity, and `u` to the new one."""
    turn = (0.0, 0.0, 0.0)
    for i in range(3):
        pose[i] += dt * (u[i] + 0.5 * change[i])
        pose[7 + i] += dt * (u[6 + i] + 0.5 * change[6 + i])
    turn = (u[3] + 0.5 * change[3], u[4] + 0.5 * change[4], u[5] + 0.5 * change[5])
    rate = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    half = 0.5 * dt * rate
    s = math.sin(half) / rate if rate > 1e-12 else 0.5 * dt
    a, b, c, d = math.cos(half), s * turn[0], s * turn[1], s * turn[2]
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    w, x, y, z = (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    pose[3], pose[4], pose[5], pose[6] = w / norm, x / norm, y / norm, z / norm
    for i in range(9):
        u[i] += change[i]


@compiled(error_model="numpy")
def health(pose: Any, u: Any) -> int:
    """FINISHED, or why the state cannot be driven on."""
    for i in range(9):
        if not abs(u[i]) < FASTEST:
            return DIVERGED
    upright = 1.0 - 2.0 * (pose[4] * pose[4] + pose[5] * pose[5])
    return FINISHED if upright > COS_OVERTURNED else OVERTURNED


@compiled(error_model="numpy")
def step(rover: Any, pose: Any, u: Any, dt: float, work: Any) -> int:
    """Advance `pose` and `u` by dt with the contacts that `evaluate` left in `work`; returns an outcome."""
    assemble(rover, pose, u, dt, work)
    eliminate(work.system, work.change)
    move(pose, u, work.change, dt)
    return health(pose, u)


@compiled(error_model="numpy")
def place(rover: Any, wheel: Any, grid: Any, override: Any, start: Any, pose: Any, work: Any) -> int:
    """Put the rover above the plane through the ground under its wheels, 1 cm deep, at x, y, heading of `start`."""
    for i in range(10):
        pose[i] = 0.0
    c, s = math.cos(start[2]), math.sin(start[2])
    mean, along, across, long_2, wide_2, height = 0.0, 0.0, 0.0, 1e-12, 1e-12, 0.0
    middle = (rover.arms[0, 0] + 2.0 * rover.bogie[0] + rover.arms[2, 0] + rover.arms[4, 0]) / 3.0
    for w in range(6):
        arm, inner = rover.arms[w], 1.0 if w > 1 else 0.0
        side = 1.0 if w % 2 == 0 else -1.0
        x = arm[0] + inner * rover.bogie[0]
        y = arm[1] + side * (rover.pivot_y + inner * rover.bogie[1])
        found = read_node(grid, start[0] + c * x - s * y, start[1] + s * x + c * y, override, work.node)
        if found != FINISHED:
            return found
        mean += work.node[0] / 6.0
        along += work.node[0] * (x - middle)
        long_2 += (x - middle) ** 2
        across += work.node[0] * y
        wide_2 += y * y
        height += (arm[2] + inner * rover.bogie[2]) / 6.0
    rise, bank = along / long_2, across / wide_2
    pose[0], pose[1] = start[0], start[1]
    pose[2] = mean - rise * middle - height + (wheel[0] - 0.01) * math.sqrt(1.0 + rise * rise + bank * bank)
    yaw, pitch, roll = 0.5 * start[2], -0.5 * math.atan(rise), 0.5 * math.atan(bank)
    cy, sy, cp, sp, cr, sr = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    pose[3], pose[4] = cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr
    pose[5], pose[6] = cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr
    return FINISHED


@compiled(error_model="numpy")
def lock(system: Any, force: Any) -> float:
    """Hold x, y and yaw in `system`; returns the largest force left on the free coordinates. [N or N m]"""
    largest = 0.0
    for i in range(9):
        if i == 0 or i == 1 or i == 5:
            for k in range(10):
                system[i, k] = 0.0
            system[i, i] = 1.0
        else:
            largest = max(largest, abs(force[i]))
    return largest


@compiled(error_model="numpy")
def shorten(change: Any, most: float) -> None:
    """Scale `change` so that no entry exceeds `most`."""
    largest = 0.0
    for i in range(9):
        largest = max(largest, abs(change[i]))
    if largest > most:
        for i in range(9):
            change[i] *= most / largest


@compiled(error_model="numpy")
def settle(
    rover: Any, wheel: Any, grid: Any, override: Any, start: Any, steering: Any, speed: Any, pose: Any, u: Any, work: Any
) -> int:
    """Bring `pose` to static equilibrium at x, y, heading of `start`: normal forces only, x, y and yaw held.

    Each round is a step from rest with a growing dt, which turns from damped dynamics into a Newton iteration.
    Converged at 1e-10 of the weight. `u` is left at rest.
    """
    code = place(rover, wheel, grid, override, start, pose, work)
    if code != FINISHED:
        return code
    weight = (rover.body_kg + 6.0 * rover.wheel_kg) * rover.gravity
    dt = 0.05
    for _ in range(SETTLE_ROUNDS):
        for i in range(9):
            u[i] = 0.0
        code = evaluate(rover, wheel, grid, override, pose, u, steering, speed, work, 0.0)
        if code == LEFT or code == HOLE:
            return code
        assemble(rover, pose, u, dt, work)
        residual = lock(work.system, work.force)
        if residual < SETTLE_TOLERANCE * weight:
            return code
        eliminate(work.system, work.change)
        shorten(work.change, 2.0 * LONGEST_MOVE / dt)
        move(pose, u, work.change, dt)
        dt = min(1.5 * dt, 30.0)
        if health(pose, u) != FINISHED:
            return UNSETTLED
    return UNSETTLED


@compiled(error_model="numpy")
def roll_on(pose: Any, u: Any, speed: float, curvature: float) -> None:
    """Start velocity: as commanded, along the chassis' x axis and about its z axis."""
    rotation = rotation_of(pose)
    for i in range(3):
        u[6 + i] = 0.0
        u[i] = speed * rotation[i][0]
        u[3 + i] = speed * curvature * rotation[i][2]


@compiled(error_model="numpy")
def record(pose: Any, work: Any, path: Any, states: Any) -> None:
    """Copy pose (x, y, z, roll, pitch, yaw [rad]) and wheel states of this instant into one row of the results."""
    r = rotation_of(pose)
    path[0], path[1], path[2] = pose[0], pose[1], pose[2]
    path[3] = math.atan2(r[2][1], r[2][2])
    path[4] = -math.asin(max(-1.0, min(1.0, r[2][0])))
    path[5] = math.atan2(r[1][0], r[0][0])
    for w in range(6):
        for k in range(10):
            states[w, k] = work.state[w, k]


@compiled(error_model="numpy", nogil=True)
def drive(
    rover: Any,
    wheel: Any,
    grid: Any,
    override: Any,
    start: Any,
    steering: Any,
    speed: Any,
    dt: float,
    every: int,
    paths: Any,
    states: Any,
) -> Any:
    """Settle and drive one rover; returns outcome and number of samples recorded.

    `start`: x, y, heading, speed, curvature. `steering`, `speed` (steps + 1, 6): commanded angles and ground speeds.
    `paths` (samples, 6) and `states` (samples, 6, 10) are filled every `every` steps.
    """
    work, pose, u = new_work(), np.zeros(10), np.zeros(9)
    code = settle(rover, wheel, grid, override, start, steering[0], speed[0], pose, u, work)
    if code != FINISHED:
        return code, 0
    roll_on(pose, u, start[3], start[4])
    samples, steps = 0, len(steering) - 1
    for i in range(steps + 1):
        code = evaluate(rover, wheel, grid, override, pose, u, steering[i], speed[i], work, 1.0)
        if code != FINISHED:
            return code, samples
        if i % every == 0:
            record(pose, work, paths[samples], states[samples])
            samples += 1
        if i < steps:
            code = step(rover, pose, u, dt, work)
            if code != FINISHED:
                return code, samples
    return FINISHED, samples
