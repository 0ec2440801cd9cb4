"""LANES rovers over the ground: settle them, drive them, record them."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import compiled
from lunarsci.regolith.forces import slip_ratio
from lunarsci.twin.lanes import (
    CENTER,
    DRAWBAR,
    LANES,
    NORMAL,
    RESISTANCE,
    RIM,
    ROTATION,
    RUT,
    SIDE,
    SINKAGE,
    SPEED,
    STEER,
    VELOCITY,
    Work,
)
from lunarsci.twin.outcomes import FINISHED, LEFT
from lunarsci.twin.simulation.contact import DRIVEN
from lunarsci.twin.simulation.contact_frame import DEEPEST, SHALLOWEST, SLOWEST, VALID_SLIP
from lunarsci.twin.simulation.dynamics import orient
from lunarsci.twin.simulation.integrate import assemble, check_health, check_sense, eliminate, move
from lunarsci.twin.simulation.ruts import press_ruts
from lunarsci.twin.simulation.settle import settle

__all__ = ["begin", "drive"]

FloatArray = npt.NDArray[np.float64]

# Into how many parts a step is cut as the rover starts and stops, assumed. In whole steps wheels on slopes swing as
# they start, and dig 4 mm deeper than in short ones.
SLOW_PARTS = 4


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def take_commands(work: Any, steering: Any, speed: Any, step: int) -> None:
    """Steering angle and rim speed of every wheel in a step; (rovers, steps, wheels), one rover stands for all."""
    last = len(steering) - 1
    for w in range(len(work.wheels)):
        for lane in range(LANES):
            work.wheels[w, STEER * LANES + lane] = steering[min(lane, last), step, w]
            work.wheels[w, RIM * LANES + lane] = speed[min(lane, last), step, w]


def roll_on(work: Work, ahead: float, left: float, turn: float) -> None:
    """Start velocity: as commanded, along the chassis' x and y axes [m/s] and about its z axis [rad/s]."""
    orient(work.body)
    rows = work.body.reshape(-1, LANES)
    axes = rows[ROTATION : ROTATION + 9].reshape(3, 3, LANES)
    rows[SPEED : SPEED + 3] = ahead * axes[:, 0] + left * axes[:, 1]
    rows[SPEED + 3 : SPEED + 6] = turn * axes[:, 2]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def record(work: Any, lane: int, tyre: Any, path: Any, states: Any) -> None:
    """Pose (x, y, z, roll, pitch, yaw [rad]) and wheel states of one rover at this instant, one row of the results.

    State: x, y, sinkage below the undisturbed ground, slip ratio, side slip [rad], F_N, F_DP, F_L, M_R, valid (1 or 0).
    A wheel that turns backwards is seen along its own direction of travel.
    """
    body = work.body
    path[0], path[1], path[2] = body[lane], body[LANES + lane], body[2 * LANES + lane]
    path[3] = math.atan2(body[(ROTATION + 7) * LANES + lane], body[(ROTATION + 8) * LANES + lane])
    path[4] = -math.asin(max(-1.0, min(1.0, body[(ROTATION + 6) * LANES + lane])))
    path[5] = math.atan2(body[(ROTATION + 3) * LANES + lane], body[ROTATION * LANES + lane])
    for w in range(len(states)):
        wheel, state = work.wheels[w], states[w]
        sinkage = wheel[SINKAGE * LANES + lane] + wheel[(RUT + 1) * LANES + lane]
        forward, across = wheel[VELOCITY * LANES + lane], wheel[(VELOCITY + 1) * LANES + lane]
        rim = abs(wheel[RIM * LANES + lane])
        slip = slip_ratio(forward / rim) if rim >= SLOWEST else 0.0
        state[0], state[1] = wheel[CENTER * LANES + lane], wheel[(CENTER + 1) * LANES + lane]
        state[2], state[3], state[4] = max(sinkage, 0.0), slip, math.atan2(across, abs(forward))
        state[5], state[6] = wheel[NORMAL * LANES + lane], wheel[DRAWBAR * LANES + lane]
        state[7], state[8] = wheel[SIDE * LANES + lane], wheel[RESISTANCE * LANES + lane]
        state[9] = 1.0 if SHALLOWEST < sinkage <= DEEPEST * tyre[0] and abs(slip) <= VALID_SLIP else 0.0


def begin(
    rover: Any,
    tyre: Any,
    grid: Any,
    override: Any,
    start: FloatArray,
    motion: FloatArray,
    steering: Any,
    speed: Any,
    work: Work,
) -> None:
    """Settle the rovers at `start` (LANES, 3), steered by their first commands, and give them `motion` (3)."""
    take_commands(work, steering, speed, 0)
    settle(rover, tyre, grid, override, start, work)
    roll_on(work, *motion)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def drive(
    rover: Any,
    tyre: Any,
    grid: Any,
    override: Any,
    steering: Any,
    speed: Any,
    dt: float,
    first: int,
    every: int,
    last: bool,
    pressing: int,
    slow: Any,
    work: Any,
    paths: Any,
    states: Any,
    results: Any,
) -> None:
    """Drive up to LANES rovers on from where they are.

    Parameters
    ----------
    override : (LANES, 8) soil of each; lanes beyond the members repeat one of them.
    steering, speed : (rovers, steps, wheels) commanded angles and ground speeds; one rover stands for all.
    dt, first : step [s], and number of the first one since the drive began.
    every : steps between records.
    last : whether the drive ends here, which is recorded too.
    pressing : steps between marks in the ruts of `work`; 0 where it has none.
    slow : steps of the whole drive in which the rover starts or stops. (all steps + 1,)
    paths, states : (members, samples, 6) and (members, samples, wheels, 10), filled on.
    results : (members, 2) outcome, and number of samples recorded so far.
    """
    members, steps = len(paths), steering.shape[1]
    # Lanes beyond the members need no ground; what becomes of them is not looked at.
    work.code[members:] = LEFT
    for i in range(steps + (1 if last else 0)):
        if not (work.code[:members] == FINISHED).any():
            break
        take_commands(work, steering, speed, min(i, steps - 1))
        # The ground of a rut changes over a spacing, of which three steps are less than a half.
        work.frame[6] = 0.0 if pressing > 8 and (first + i) % 3 else 1.0
        parts = SLOW_PARTS if slow[first + i] and i < steps else 1
        step = dt / parts
        for part in range(parts):
            assemble(rover, tyre, grid, override, step, DRIVEN, work)
            if part == 0:
                check_sense(work, rover, tyre, dt, first + i == 0)
                if pressing > 0 and (first + i) % pressing == 0:
                    press_ruts(work, tyre[1])
                if (first + i) % every == 0:
                    for m in range(members):
                        if work.code[m] == FINISHED:
                            record(work, m, tyre, paths[m, results[m, 1]], states[m, results[m, 1]])
                            results[m, 1] += 1
            if i < steps:
                eliminate(work)
                move(work.body, step)
                check_health(work, rover.gravity * step)
    work.frame[6] = 1.0
    for m in range(members):
        results[m, 0] = work.code[m]
