"""LANES rovers over the ground: settle them, drive them, record them."""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.regolith.forces import slip_ratio
from lunarsci.twin.contact import DEEPEST, SHALLOWEST, VALID_SLIP
from lunarsci.twin.dynamics import orient
from lunarsci.twin.integrate import assemble, check_health, eliminate, move
from lunarsci.twin.lanes import (
    CENTER,
    DRAWBAR,
    LANES,
    NORMAL,
    RESISTANCE,
    ROTATION,
    SIDE,
    SINKAGE,
    SPEED,
    VELOCITY,
    new_work,
)
from lunarsci.twin.outcomes import FINISHED
from lunarsci.twin.settle import settle

__all__ = ["drive"]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def roll_on(work: Any, speed: float, curvature: float) -> None:
    """Start velocity: as commanded, along the chassis' x axis and about its z axis."""
    body = work.body
    orient(body)
    for lane in range(LANES):
        for i in range(3):
            body[(SPEED + i) * LANES + lane] = speed * body[(ROTATION + 3 * i) * LANES + lane]
            body[(SPEED + 3 + i) * LANES + lane] = speed * curvature * body[(ROTATION + 3 * i + 2) * LANES + lane]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def record(work: Any, lane: int, tyre: Any, speed: Any, path: Any, states: Any) -> None:
    """Pose (x, y, z, roll, pitch, yaw [rad]) and wheel states of one rover at this instant, one row of the results.

    State: x, y, sinkage, slip ratio, side slip [rad], F_N, F_DP, F_L, M_R, valid (1 or 0).
    """
    body = work.body
    path[0], path[1], path[2] = body[lane], body[LANES + lane], body[2 * LANES + lane]
    path[3] = math.atan2(body[(ROTATION + 7) * LANES + lane], body[(ROTATION + 8) * LANES + lane])
    path[4] = -math.asin(max(-1.0, min(1.0, body[(ROTATION + 6) * LANES + lane])))
    path[5] = math.atan2(body[(ROTATION + 3) * LANES + lane], body[ROTATION * LANES + lane])
    for w in range(len(states)):
        wheel, state = work.wheels[w], states[w]
        sinkage = wheel[SINKAGE * LANES + lane]
        forward, across = wheel[VELOCITY * LANES + lane], wheel[(VELOCITY + 1) * LANES + lane]
        slip = slip_ratio(forward / speed[w])
        state[0], state[1] = wheel[CENTER * LANES + lane], wheel[(CENTER + 1) * LANES + lane]
        state[2], state[3], state[4] = max(sinkage, 0.0), slip, math.atan2(across, abs(forward))
        state[5], state[6] = wheel[NORMAL * LANES + lane], wheel[DRAWBAR * LANES + lane]
        state[7], state[8] = wheel[SIDE * LANES + lane], wheel[RESISTANCE * LANES + lane]
        state[9] = 1.0 if SHALLOWEST < sinkage <= DEEPEST * tyre[0] and abs(slip) <= VALID_SLIP else 0.0


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def drive(
    rover: Any,
    tyre: Any,
    grid: Any,
    override: Any,
    start: Any,
    steering: Any,
    speed: Any,
    dt: float,
    every: int,
    paths: Any,
    states: Any,
    results: Any,
) -> None:
    """Settle and drive up to LANES rovers.

    Parameters
    ----------
    override : (LANES, 8) soil of each; lanes beyond the members repeat one of them.
    start : x, y, heading, speed, curvature.
    steering, speed : (steps + 1, wheels) commanded angles and ground speeds.
    paths, states : (members, samples, 6) and (members, samples, wheels, 10), filled every `every` steps.
    results : (members, 2) outcome, and number of samples recorded.
    """
    work, members, steps = new_work(len(rover.arms)), len(paths), len(steering) - 1
    settle(rover, tyre, grid, override, start, steering[0], speed[0], work)
    roll_on(work, start[3], start[4])
    counted = np.zeros(LANES, dtype=np.int64)
    for i in range(steps + 1):
        # The velocity a step arrives at is that of its end, so its commands are: a tenth of the error in dt is left.
        now = min(i + 1, steps)
        assemble(rover, tyre, grid, override, steering[now], speed[now], dt, True, work)
        if i % every == 0:
            for m in range(members):
                if work.code[m] == FINISHED:
                    record(work, m, tyre, speed[now], paths[m, counted[m]], states[m, counted[m]])
                    counted[m] += 1
        if i < steps:
            eliminate(work)
            move(work.body, dt)
            check_health(work)
        if not (work.code[:members] == FINISHED).any():
            break
    for m in range(members):
        results[m, 0], results[m, 1] = work.code[m], counted[m]
