"""The rover at rest on the ground, before it drives."""

import math
from typing import Any

from lunarsci.compiled import compiled
from lunarsci.twin.integrate import assemble, eliminate, evaluate, health, move
from lunarsci.twin.outcomes import FINISHED, HOLE, LEFT, UNSETTLED
from lunarsci.twin.terrain import read_node

__all__ = ["place", "settle"]

SETTLE_ROUNDS = 300
SETTLE_TOLERANCE = 1e-9
# Longest move of a settling round [m or rad]: less than it takes to lift a wheel off its neighbour's plane.
LONGEST_MOVE = 0.02


@compiled
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
        found: int = read_node(grid, start[0] + c * x - s * y, start[1] + s * x + c * y, override, work.node)
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
    cy, sy, cp, sp, cr, sr = (
        math.cos(yaw),
        math.sin(yaw),
        math.cos(pitch),
        math.sin(pitch),
        math.cos(roll),
        math.sin(roll),
    )
    pose[3], pose[4] = cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr
    pose[5], pose[6] = cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr
    return FINISHED


@compiled
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


@compiled
def shorten(change: Any, most: float) -> None:
    """Scale `change` so that no entry exceeds `most`."""
    largest = 0.0
    for i in range(9):
        largest = max(largest, abs(change[i]))
    if largest > most:
        for i in range(9):
            change[i] *= most / largest


@compiled
def settle(
    rover: Any,
    wheel: Any,
    grid: Any,
    override: Any,
    start: Any,
    steering: Any,
    speed: Any,
    pose: Any,
    u: Any,
    work: Any,
) -> int:
    """Bring `pose` to static equilibrium at x, y, heading of `start`: normal forces only, x, y and yaw held.

    Each round is a step from rest with a growing dt, which turns from damped dynamics into a Newton iteration.
    Converged at 1e-9 of the weight. `u` is left at rest.
    """
    code: int = place(rover, wheel, grid, override, start, pose, work)
    if code != FINISHED:
        return code
    weight = (rover.body_kg + 6.0 * rover.wheel_kg) * rover.gravity
    dt = 0.05
    for _ in range(SETTLE_ROUNDS):
        for i in range(9):
            u[i] = 0.0
        code = evaluate(rover, wheel, grid, override, pose, u, steering, speed, work, 0.0)
        if code in (LEFT, HOLE):
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
