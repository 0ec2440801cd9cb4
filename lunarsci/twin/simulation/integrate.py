"""One time step of LANES rovers on the ground, linearly implicit.

With forces f, C = df/dv and K = df/dp at the start of the step,

    (M - time_step_s C - time_step_s^2/2 K) du = time_step_s (f + time_step_s K u0),    positions move with (u0 + u1)/2,

so free fall is exact, and the stiff parts (shear: 12-18 ms at 0.05 m/s, less when slower; sinkage: 60 ms) are damped
at any time_step_s. First order in time_step_s.
"""

import math
from typing import Any

from lunarsci.compiled import compiled, in_lanes, joined, pasted
from lunarsci.elementary import cosine, sine
from lunarsci.twin.ground.terrain import read_ground
from lunarsci.twin.lanes import (
    CENTER,
    CHANGE,
    ENERGY,
    ERROR,
    EXCESS,
    LANES,
    LEVER,
    MATRIX,
    MISSED,
    NORMAL,
    OMEGA,
    POSE,
    POWER,
    RESISTANCE,
    RIGHT,
    RIM,
    ROTATION,
    RUT,
    SINKAGE,
    SOIL,
    SPEED,
    VELOCITY,
    cross,
    dot,
    get,
    get3,
    plus,
    put,
    put3,
    rows,
    times,
)
from lunarsci.twin.outcomes import DIVERGED, FELL, FINISHED, OVERTURNED, SANK
from lunarsci.twin.simulation.contact import add_wheel
from lunarsci.twin.simulation.dynamics import begin_system, place_wheels
from lunarsci.twin.simulation.ruts import read_ruts

COS_OVERTURNED = 0.5
THREE, EIGHT = rows(3, 8)
# Assumed: no part of a rover that drives at cm/s comes near this speed [m/s or rad/s] while the run has a meaning.
FASTEST = 10.0
# Speed of the rover that no drive reaches: a drop of 0.3 m on the Moon. [m/s]
FALLING = 1.0
# Wheel load as a share of the weight beyond which a run has lost its meaning, but in an impact: a wheel that comes down
# at more than this speed [m/s], 3 mm of free fall on the Moon.
MOST_LOAD, IMPACT = 2.0, 0.1
# Energy from nowhere, as a share of what lifts the rover by a wheel's radius, beyond which a run has lost its meaning;
# assumed: 3 cm for a wheel of 15 cm, more than any rounding and less than a jump.
MOST_EXCESS = 0.2
# Forces along the wheels under way that the steps miss, as a share of the weight, beyond which a run has lost its
# meaning, and the share of the last step in their mean (assumed: some ten steps). With shear moduli of 0.05-18 mm, on
# four grounds, drives of 1.5 m with more than this were 1-80 cm off at their ends, those with less within 1 cm.
MOST_ERROR, MEMORY = 0.25, 0.1


@joined
def assemble(rover: Any, tyre: Any, grid: Any, override: Any, time_step_s: float, mode: int, work: Any) -> None:
    """Kinematics, ground contact and the linear system of a step at the pose, velocity and commands in `work`.

    `mode` as in `add_wheel`.
    `work.code` takes the outcome of lanes that were still FINISHED.
    """
    place_wheels(rover, work)
    begin_system(rover, work, time_step_s)
    for w in range(len(rover.arms)):
        read_ground(grid, override, work.wheels[w], work.code)
        if work.ruts.shape[1] > 1:
            read_ruts(work, w)
        add_wheel(work, w, rover, tyre, time_step_s, mode)
    for w in range(len(rover.arms)):
        for lane in range(LANES):
            deep = work.wheels[w][SINKAGE * LANES + lane] + work.wheels[w][(RUT + 1) * LANES + lane]
            if work.code[lane] == FINISHED and deep > tyre[0]:
                work.code[lane] = SANK


@pasted
def product(a: Any, b: Any) -> Any:
    """Of two 3 x 3 matrices, each three rows."""
    return (
        plus(plus(times(b[0], a[0][0]), times(b[1], a[0][1])), times(b[2], a[0][2])),
        plus(plus(times(b[0], a[1][0]), times(b[1], a[1][1])), times(b[2], a[1][2])),
        plus(plus(times(b[0], a[2][0]), times(b[1], a[2][1])), times(b[2], a[2][2])),
    )


@pasted
def applied(a: Any, v: Any) -> Any:
    """3 x 3 matrix times vector."""
    return (dot(a[0], v), dot(a[1], v), dot(a[2], v))


@pasted
def inverse(a: Any) -> Any:
    """Of a 3 x 3 matrix, by its cofactors."""
    x, y, z = cross(a[1], a[2]), cross(a[2], a[0]), cross(a[0], a[1])
    one = 1.0 / dot(a[0], x)
    return (
        (x[0] * one, y[0] * one, z[0] * one),
        (x[1] * one, y[1] * one, z[1] * one),
        (x[2] * one, y[2] * one, z[2] * one),
    )


@pasted
def minus(a: Any, b: Any) -> Any:
    """Difference of two triples."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@pasted
def without(a: Any, b: Any) -> Any:
    """Difference of two 3 x 3 matrices."""
    return (minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2]))


@pasted
def summed(one: Any, two: Any, k: Any, lane: Any) -> Any:
    """Three successive rows of both sides added."""
    return plus(get3(one, k, lane), get3(two, k, lane))


@pasted
def joint_columns(one: Any, two: Any, i: Any, lane: Any) -> Any:
    """Row i of the three joints' columns: what both sides have of the differential, each side's own bogie."""
    k = MATRIX + 8 * i
    return (get(one, k + 6, lane) + get(two, k + 6, lane), get(one, k + 7, lane), get(two, k + 7, lane))


@in_lanes
def fold(one: Any, two: Any, scratch: Any) -> None:
    """Add the second side to the first where they share coordinates, and keep the joints' block in `scratch`."""
    for k in range(6):
        for lane in range(LANES):
            put3(one, MATRIX + 8 * k, lane, summed(one, two, MATRIX + 8 * k, lane))
            put3(one, MATRIX + 8 * k + 3, lane, summed(one, two, MATRIX + 8 * k + 3, lane))
            put3(scratch, LEVER + 3 * k, lane, joint_columns(one, two, k, lane))
    for lane in range(LANES):
        put3(one, RIGHT, lane, summed(one, two, RIGHT, lane))
        put3(one, RIGHT + 3, lane, summed(one, two, RIGHT + 3, lane))
    for lane in range(LANES):
        differential = joint_columns(one, two, LEVER + 6, lane)
        put3(scratch, LEVER + 18, lane, differential)
        put3(scratch, LEVER + 21, lane, (get(one, MATRIX + 62, lane), get(one, MATRIX + 63, lane), 0.0))
        put3(scratch, LEVER + 24, lane, (get(two, MATRIX + 62, lane), 0.0, get(two, MATRIX + 63, lane)))
        put3(scratch, LEVER + 27, lane, summed(one, two, MATRIX + 48, lane))
        put3(scratch, LEVER + 30, lane, summed(one, two, MATRIX + 51, lane))
        put(scratch, LEVER + 33, lane, get(one, RIGHT + 6, lane) + get(two, RIGHT + 6, lane))
        put(scratch, LEVER + 34, lane, get(one, RIGHT + 7, lane))
        put(scratch, LEVER + 35, lane, get(two, RIGHT + 7, lane))


@pasted
def block(rows: Any, k: Any, stride: Any, lane: Any) -> Any:
    """3 x 3 matrix whose rows begin at k, k + stride, k + 2 stride."""
    return get3(rows, k, lane), get3(rows, k + stride, lane), get3(rows, k + 2 * stride, lane)


@in_lanes
def solve(one: Any, two: Any, scratch: Any, body: Any) -> None:
    """Solve the folded systems by blocks of three coordinates; the mass keeps them far from singular."""
    for lane in range(LANES):
        a_11, a_12 = block(one, MATRIX, EIGHT, lane), block(one, MATRIX + 3, EIGHT, lane)
        a_21, a_22 = block(one, MATRIX + 24, EIGHT, lane), block(one, MATRIX + 27, EIGHT, lane)
        a_13, a_23 = block(scratch, LEVER, THREE, lane), block(scratch, LEVER + 9, THREE, lane)
        left, right = get3(one, MATRIX + 56, lane), get3(two, MATRIX + 56, lane)
        a_31 = (get3(scratch, LEVER + 27, lane), left, right)
        a_32 = (get3(scratch, LEVER + 30, lane), get3(one, MATRIX + 59, lane), get3(two, MATRIX + 59, lane))
        a_33 = block(scratch, LEVER + 18, THREE, lane)
        b_1, b_2, b_3 = get3(one, RIGHT, lane), get3(one, RIGHT + 3, lane), get3(scratch, LEVER + 33, lane)
        first = inverse(a_11)
        below, lowest = product(a_21, first), product(a_31, first)
        a_22, a_23 = without(a_22, product(below, a_12)), without(a_23, product(below, a_13))
        a_32, a_33 = without(a_32, product(lowest, a_12)), without(a_33, product(lowest, a_13))
        b_2, b_3 = minus(b_2, applied(below, b_1)), minus(b_3, applied(lowest, b_1))
        second = inverse(a_22)
        lowest = product(a_32, second)
        x_3 = applied(inverse(without(a_33, product(lowest, a_23))), minus(b_3, applied(lowest, b_2)))
        x_2 = applied(second, minus(b_2, applied(a_23, x_3)))
        x_1 = applied(first, minus(minus(b_1, applied(a_12, x_2)), applied(a_13, x_3)))
        put3(body, CHANGE, lane, x_1)
        put3(body, CHANGE + 3, lane, x_2)
        put3(body, CHANGE + 6, lane, x_3)


@joined
def eliminate(work: Any) -> None:
    """Solve the systems of a step; the changes of velocity go to the body's rows."""
    one, two = work.sides[0], work.sides[1]
    fold(one, two, work.levers)
    solve(one, two, work.levers, work.body)


@in_lanes
def move(body: Any, time_step_s: float) -> None:
    """Advance the poses with the mean of old and new velocity, and the velocities to the new one."""
    for lane in range(LANES):
        for k in range(3):
            put(body, POSE + k, lane, get(body, POSE + k, lane)
                + time_step_s * (get(body, SPEED + k, lane) + 0.5 * get(body, CHANGE + k, lane)))  # fmt: skip
            put(body, POSE + 7 + k, lane, get(body, POSE + 7 + k, lane)
                + time_step_s * (get(body, SPEED + 6 + k, lane) + 0.5 * get(body, CHANGE + 6 + k, lane)))  # fmt: skip
        x = get(body, SPEED + 3, lane) + 0.5 * get(body, CHANGE + 3, lane)
        y = get(body, SPEED + 4, lane) + 0.5 * get(body, CHANGE + 4, lane)
        z = get(body, SPEED + 5, lane) + 0.5 * get(body, CHANGE + 5, lane)
        rate = math.sqrt(x * x + y * y + z * z)
        half = min(0.5 * time_step_s * rate, 1.6)
        s = sine(half) / rate if rate > 1e-12 else 0.5 * time_step_s
        a, b, c, d = cosine(half), s * x, s * y, s * z
        w, x, y, z = (
            get(body, POSE + 3, lane),
            get(body, POSE + 4, lane),
            get(body, POSE + 5, lane),
            get(body, POSE + 6, lane),
        )
        new_w, new_x = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
        new_y, new_z = a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w
        scale = 1.0 / math.sqrt(new_w * new_w + new_x * new_x + new_y * new_y + new_z * new_z)
        put(body, POSE + 3, lane, new_w * scale)
        put(body, POSE + 4, lane, new_x * scale)
        put(body, POSE + 5, lane, new_y * scale)
        put(body, POSE + 6, lane, new_z * scale)
        for k in range(9):
            put(body, SPEED + k, lane, get(body, SPEED + k, lane) + get(body, CHANGE + k, lane))


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def is_upright(body: Any, lane: int) -> bool:
    """Whether the chassis has not overturned; False for a pose that is no number."""
    x, y = body[(POSE + 4) * LANES + lane], body[(POSE + 5) * LANES + lane]
    return bool(1.0 - 2.0 * (x * x + y * y) > COS_OVERTURNED)


@in_lanes
def weigh(body: Any, wheel: Any, tyre: Any, kg: float, gravity: float) -> None:
    """Add a wheel's energy, with that of the ground it has pressed, to `ENERGY`, and what its rim gives to `POWER`."""
    for lane in range(LANES):
        v, sinkage = get3(wheel, VELOCITY, lane), max(get(wheel, SINKAGE, lane), 0.0)
        pressed = get(wheel, NORMAL, lane) * sinkage / (get(wheel, SOIL + 1, lane) + 1.5)
        own = kg * (0.5 * dot(v, v) + gravity * get(wheel, CENTER + 2, lane))
        put(body, ENERGY, lane, get(body, ENERGY, lane) + own + pressed)
        rim = abs(get(wheel, RIM, lane)) / tyre[3]
        put(body, POWER, lane, get(body, POWER, lane) + max(get(wheel, RESISTANCE, lane), 0.0) * rim)


@in_lanes
def weigh_chassis(body: Any, rover: Any) -> None:
    """Put the energy of the chassis into `ENERGY`, 0 into `POWER`."""
    kg, gravity = rover.body_kg, rover.gravity
    center_x, center_y, center_z = rover.center[0], rover.center[1], rover.center[2]
    i_x, i_y, i_z = rover.inertia[0], rover.inertia[1], rover.inertia[2]
    for lane in range(LANES):
        a, b, c = get3(body, ROTATION, lane), get3(body, ROTATION + 3, lane), get3(body, ROTATION + 6, lane)
        center, spin = (center_x, center_y, center_z), get3(body, OMEGA, lane)
        arm = applied((a, b, c), center)
        v = plus(get3(body, SPEED, lane), cross(get3(body, SPEED + 3, lane), arm))
        turning = i_x * spin[0] * spin[0] + i_y * spin[1] * spin[1] + i_z * spin[2] * spin[2]
        height = get(body, POSE + 2, lane) + arm[2]
        put(body, ENERGY, lane, 0.5 * kg * dot(v, v) + 0.5 * turning + kg * gravity * height)
        put(body, POWER, lane, 0.0)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def check_sense(work: Any, rover: Any, tyre: Any, time_step_s: float, begins: bool) -> None:
    """Note in `work.code` the lanes with loads or energy that no drive has, and those whose steps miss the soil's law.

    Called when a step is assembled. Energy comes from the rims alone. A load is an impact's where the wheel comes down
    or the rover falls.
    """
    body, wheels = work.body, len(work.wheels)
    before = body[ENERGY * LANES : (ERROR + 1) * LANES].copy()
    weigh_chassis(body, rover)
    for w in range(wheels):
        weigh(body, work.wheels[w], tyre, rover.wheel_kg, rover.gravity)
    weight = (rover.body_kg + wheels * rover.wheel_kg) * rover.gravity
    for lane in range(LANES):
        gained = body[ENERGY * LANES + lane] - before[lane] - time_step_s * before[LANES + lane]
        excess = 0.0 if begins else max(0.0, before[2 * LANES + lane] + gained)
        body[EXCESS * LANES + lane] = excess
        missed = 0.0
        for w in range(wheels):
            missed += work.wheels[w, MISSED * LANES + lane]
        error = 0.0 if begins else before[3 * LANES + lane] + MEMORY * (missed - before[3 * LANES + lane])
        body[ERROR * LANES + lane] = error
        if work.code[lane] != FINISHED:
            continue
        if error > MOST_ERROR * weight:
            work.code[lane] = DIVERGED
        if excess > MOST_EXCESS * weight * tyre[0]:
            work.code[lane] = DIVERGED
        for w in range(wheels):
            if work.wheels[w, NORMAL * LANES + lane] > MOST_LOAD * weight:
                coming_down = work.wheels[w, (VELOCITY + 2) * LANES + lane]
                if not max(-coming_down, abs(body[(SPEED + 2) * LANES + lane])) > IMPACT:
                    work.code[lane] = DIVERGED


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def check_health(work: Any, fall: float) -> None:
    """Note in `work.code` the lanes whose state cannot be driven on.

    `fall` is the speed gained in a step of free fall [m/s]: what gains twice that comes from the step, not from a fall.
    """
    body = work.body
    for lane in range(LANES):
        if work.code[lane] != FINISHED:
            continue
        fastest, gained = 0.0, 0.0
        for k in range(3):
            fastest = max(fastest, abs(body[(SPEED + k) * LANES + lane]))
            gained = max(gained, abs(body[(CHANGE + k) * LANES + lane]))
        if fastest >= FALLING:
            work.code[lane] = FELL if gained < 2.0 * fall else DIVERGED
        for k in range(9):
            if not abs(body[(SPEED + k) * LANES + lane]) < FASTEST:
                work.code[lane] = DIVERGED
        if work.code[lane] == FINISHED and not is_upright(body, lane):
            work.code[lane] = OVERTURNED
