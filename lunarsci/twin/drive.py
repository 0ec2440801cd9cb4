"""One rover over the ground: settle it, drive it, record it."""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.twin.dynamics import rotation_of
from lunarsci.twin.integrate import evaluate, new_work, step
from lunarsci.twin.outcomes import FINISHED
from lunarsci.twin.settle import settle

__all__ = ["drive"]


@compiled
def roll_on(pose: Any, u: Any, speed: float, curvature: float) -> None:
    """Start velocity: as commanded, along the chassis' x axis and about its z axis."""
    rotation = rotation_of(pose)
    for i in range(3):
        u[6 + i] = 0.0
        u[i] = speed * rotation[i][0]
        u[3 + i] = speed * curvature * rotation[i][2]


@compiled
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


def _drive(
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


# Without the interpreter's lock, so that members run side by side in threads.
drive: Any = compiled(_drive, nogil=True)
