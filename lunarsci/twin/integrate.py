"""One time step of a rover on the ground, linearly implicit.

With forces f, C = df/dv and K = df/dp at the start of the step,

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
from lunarsci.twin.dynamics import inertia_and_free_force, wheel_jacobians
from lunarsci.twin.outcomes import DIVERGED, FINISHED, OVERTURNED, SANK
from lunarsci.twin.terrain import read_node

__all__ = ["Work", "assemble", "eliminate", "evaluate", "health", "move", "new_work", "step"]

COS_OVERTURNED = 0.5
# Assumed: no part of a rover that drives at cm/s comes near this speed [m/s or rad/s] while the run has a meaning.
FASTEST = 10.0
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


@compiled
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


@compiled
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


@compiled
def evaluate(
    rover: Any,
    wheel: Any,
    grid: Any,
    override: Any,
    pose: Any,
    u: Any,
    steering: Any,
    speed: Any,
    work: Any,
    shear: float,
) -> int:
    """Kinematics and ground contact of all wheels at `pose`, `u`; returns an outcome, FINISHED when all is well."""
    wheel_jacobians(rover, pose, u, steering, work)
    code = FINISHED
    for w in range(6):
        found: int = read_node(grid, work.center[w, 0], work.center[w, 1], override, work.node)
        if found != FINISHED:
            return found
        if wheel_contact(w, u, speed[w], wheel, work, shear) > wheel[0]:
            code = SANK
    return code


@compiled
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


@compiled
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


@compiled
def health(pose: Any, u: Any) -> int:
    """FINISHED, or why the state cannot be driven on."""
    for i in range(9):
        if not abs(u[i]) < FASTEST:
            return DIVERGED
    upright = 1.0 - 2.0 * (pose[4] * pose[4] + pose[5] * pose[5])
    return FINISHED if upright > COS_OVERTURNED else OVERTURNED


@compiled
def step(rover: Any, pose: Any, u: Any, dt: float, work: Any) -> int:
    """Advance `pose` and `u` by dt with the contacts that `evaluate` left in `work`; returns an outcome."""
    assemble(rover, pose, u, dt, work)
    eliminate(work.system, work.change)
    move(pose, u, work.change, dt)
    code: int = health(pose, u)
    return code
