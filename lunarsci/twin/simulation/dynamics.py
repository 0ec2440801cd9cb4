"""The rover's equations of motion, nine degrees of freedom, and one time step of a group of rovers on the ground.

Configuration (10): position of the origin in the world [m], unit quaternion body-to-world (w, x, y, z), differential
angle rho, left and right bogie angle [rad]. Velocity (9): world velocity of the origin [m/s], world angular velocity of
the chassis [rad/s], rates of rho and of the two bogies [rad/s]. A rover without bogies keeps their rows at rest.

The tree is one rigid chassis and point masses at the wheel centres, so the mass matrix is a sum of J^T m J and the
inertial forces follow from the accelerations that remain at u-dot = 0; nothing is linearised. The wheels' own spin
(0.02 N m s each at 0.05 m/s, gyroscopic torques of 1e-4 N m) is left out. Wheels enter the equations in `contact`.

A step is linearly implicit. With forces f, C = df/dv and K = df/dp at the start of the step,

    (M - time_step_s C - time_step_s^2/2 K) du = time_step_s (f + time_step_s K u0),    positions move with (u0 + u1)/2,

so free fall is exact, and the stiff parts (shear: 12-18 ms at 0.05 m/s, less when slower; sinkage: 60 ms) are damped
at any time_step_s. First order in time_step_s.
"""

import math
from typing import Any

from lunarsci.compiled import compiled, joined
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, cosine, highest, lowest, root, signed, sine
from lunarsci.twin.ground.terrain import read_ground
from lunarsci.twin.lanes import (
    BODY,
    DIVERGED,
    FELL,
    FINISHED,
    GROUP,
    OVERTURNED,
    STEEPEST_DEG,
    SYSTEM,
    WHEEL,
    cross,
    dot,
    plus,
    seen_from,
    times,
)
from lunarsci.twin.simulation.contact import add_rows, find_contact, read_ruts

COS_OVERTURNED = math.cos(math.radians(STEEPEST_DEG))
"""Cosine of the tilt from which on a rover has overturned."""
FASTEST = 10.0
"""No part of a rover that drives at cm/s comes near this speed while the drive has a meaning; assumed. [m/s, rad/s]"""
FALLING = 1.0
"""Speed beyond what is commanded that no drive reaches: a drop of 0.3 m on the Moon; assumed. [m/s]"""
MOST_LOAD, IMPACT = 2.0, 0.1
"""Wheel load as a share of the weight beyond which a run has lost its meaning, but in an impact: a wheel that comes
down at more than this speed [m/s], 3 mm of free fall on the Moon; assumed."""
MOST_EXCESS = 0.2
"""Energy from nowhere, as a share of what lifts the rover by a wheel's radius, beyond which a drive has lost its
meaning; assumed: 3 cm for a wheel of 15 cm, more than any rounding and less than a jump."""
MOST_ERROR, MEMORY = 0.25, 0.1
"""Forces along the wheels under way that the steps miss, as a share of the weight, beyond which a drive has lost its
meaning, and the share of the last step in their mean (assumed: some ten steps). With shear moduli of 0.05-18 mm, on
four grounds, drives of 1.5 m with more than this were 1-80 cm off at their ends, those with less within 1 cm."""
OUTCOME = BODY.first["outcome"] * GROUP
"""Where the outcomes begin in `Work.body`."""
JOINTS = (7, 8)
"""Coordinates of the bogies, which do not meet each other in the system."""


def rotation_of(w: Any, x: Any, y: Any, z: Any) -> Any:
    """Rows of the rotation matrix body-to-world of a unit quaternion."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def rotate_y(cos: Any, sin: Any, v: Any) -> Any:
    """`v` turned about the y axis."""
    return (cos * v[0] + sin * v[2], v[1], cos * v[2] - sin * v[0])


def turning(rate: Any, spin: Any, segment: Any) -> Any:
    """Acceleration along a segment that turns at `rate`, when only `spin` (joint rate, about y) changes direction.

    rate x (rate x d) + (omega x spin) x d, where omega x spin = rate x spin as both differ by a multiple of spin.
    """
    return plus(cross(rate, cross(rate, segment)), cross(cross(rate, (0.0, spin, 0.0)), segment))


@formula
def orient(bodies: Any, lane: Any) -> None:
    """Fill the rotation of the chassis and the angular velocity in the body frame."""
    body = BODY.of(bodies, lane)
    body.x_row, body.y_row, body.z_row = rotation_of(*body.quaternion)
    body.omega = plus(*map(times, (body.x_row, body.y_row, body.z_row), body.spin))


@formula
def place_wheel(work: Any, rover: Any, w: Any, side: Any, lane: Any) -> None:
    """Fill centre, arm, swings, axle and remaining acceleration of wheel `w`, steered as its rows say.

    A steered wheel stands `steering_offset` outboard of its steering axis. The axle of a wheel that turns backwards
    points the other way, so that it rolls ahead along its contact frame like any other; at rest the sign of the zero
    tells. `side` is 1 on the left, -1 on the right.
    """
    body, wheel = BODY.of(work.body, lane), WHEEL.of(work.wheels, w, lane)
    hung, offset, axes, omega = (
        rover.hung[w],
        side * rover.steering_offset,
        (body.x_row, body.y_row, body.z_row),
        body.omega,
    )
    rocker, rocker_spin = side * body.joints[0], side * body.rates[0]
    angle = rocker + hung * choose(side > 0.0, body.joints[1], body.joints[2])
    spin = rocker_spin + hung * choose(side > 0.0, body.rates[1], body.rates[2])
    cos_s, sin_s = cosine(wheel.steer), sine(wheel.steer)
    first = rotate_y(cosine(rocker), sine(rocker), times((rover.bogie[0], side * rover.bogie[1], rover.bogie[2]), hung))
    last = (rover.arms[w, 0] - offset * sin_s, rover.arms[w, 1] + offset * (cos_s - 1.0), rover.arms[w, 2])
    last = rotate_y(cosine(angle), sine(angle), last)
    pivot, hang = (0.0, side * rover.pivot_y, 0.0), plus(first, last)
    wheel.arm = seen_from(axes, plus(pivot, hang))
    wheel.center = plus(body.position, wheel.arm)
    wheel.swing = seen_from(axes, (side * hang[2], 0.0, -side * hang[0]))
    wheel.bogie_swing = seen_from(axes, (hung * last[2], 0.0, -hung * last[0]))
    forward = signed(1.0, wheel.rim)
    wheel.axle = seen_from(axes, rotate_y(cosine(angle), sine(angle), (-forward * sin_s, forward * cos_s, 0.0)))
    by_rocker = turning((omega[0], omega[1] + rocker_spin, omega[2]), rocker_spin, first)
    by_bogie = turning((omega[0], omega[1] + spin, omega[2]), spin, last)
    wheel.acceleration = seen_from(axes, plus(cross(omega, cross(omega, pivot)), by_rocker, by_bogie))


@formula
def begin_system(work: Any, rover: Any, time_step_s: Any, lane: Any) -> None:
    """Fill matrix and right side of a step with the chassis: mass, moments, gyroscopic torque, joint friction.

    Equations of motion: mass u-dot = force; the matrix is the mass so far, the right side time_step_s times the force.
    A row of a bogie that is not there is kept at rest.
    """
    body, friction = BODY.of(work.body, lane), time_step_s * rover.joint_damping
    idle = choose(rover.bogies, 0.0, 1.0)
    for side in range(2):
        system, matrix, right = SYSTEM.of(work.sides, side, lane), [0.0] * 64, [0.0] * 8
        if side == 0:
            add_chassis(body, rover, time_step_s, matrix, right)
        matrix[54], matrix[63] = friction, friction + idle
        right[6], right[7] = -friction * body.rates[0], -friction * body.rates[1 + side]
        system.matrix, system.right = tuple(matrix), tuple(right)
    body.outcome = 0.0


def add_chassis(body: Any, rover: Any, time_step_s: Any, matrix: Any, right: Any) -> None:
    """The chassis' mass at its centre, its principal moments and gyroscopic torque."""
    axes, omega, kg = (body.x_row, body.y_row, body.z_row), body.omega, rover.body_kg
    center, inertia = ([triple[k] for k in range(3)] for triple in (rover.center, rover.inertia))
    arm, remaining = seen_from(axes, center), seen_from(axes, cross(omega, cross(omega, center)))
    pull = (-kg * remaining[0], -kg * remaining[1], -kg * (rover.gravity + remaining[2]))
    torque = seen_from(axes, cross(tuple(map(_product, inertia, omega)), omega))
    right[:6] = (*times(pull, time_step_s), *times(plus(torque, cross(arm, pull)), time_step_s))
    square = dot(arm, arm)
    skew = ((0.0, arm[2], -arm[1]), (-arm[2], 0.0, arm[0]), (arm[1], -arm[0], 0.0))
    for i in range(3):
        matrix[9 * i] = kg
        for j in range(3):
            moment = dot(tuple(map(_product, axes[i], inertia)), axes[j])
            matrix[27 + 8 * i + j] = moment + kg * ((square if i == j else 0.0) - arm[i] * arm[j])
            if i != j:
                matrix[8 * i + 3 + j] = matrix[24 + 8 * j + i] = kg * skew[i][j]


def _product(one: Any, two: Any) -> Any:
    return one * two


@joined
def assemble(rover: Any, tyre: Any, grid: Any, override: Any, time_step_s: float, mode: int, work: Any) -> None:
    """Kinematics, ground contact and the linear system of a step at the pose, velocity and commands in `work`.

    `mode` as in `find_contact`.
    `work.code` takes the outcome of members that were still FINISHED.
    """
    for lane in range(0, GROUP, LANES):
        orient(work.body, lane)
        begin_system(work, rover, time_step_s, lane)
        for w in range(len(rover.arms)):
            place_wheel(work, rover, w, 1.0 - 2.0 * (w % 2), lane)
    for w in range(len(rover.arms)):
        read_ground(grid, override, work.wheels[w], work.code)
        if work.ruts.shape[1] > 1:
            read_ruts(work, w)
        find_contact(work, w, rover, tyre, time_step_s, mode)
    for lane in range(0, GROUP, LANES):
        if len(rover.arms) == 6:
            add_rows(work, 0, 3, rover, 1.0, time_step_s, lane)
            add_rows(work, 1, 3, rover, -1.0, time_step_s, lane)
        else:
            add_rows(work, 0, 2, rover, 1.0, time_step_s, lane)
            add_rows(work, 1, 2, rover, -1.0, time_step_s, lane)
    note_outcomes(work.body, work.code)


@compiled
def note_outcomes(body: Any, code: Any) -> None:
    """Take over what the step found of members that were still FINISHED."""
    for lane in range(GROUP):
        if code[lane] == FINISHED:
            code[lane] = int(body[OUTCOME + lane])


@formula
def eliminate(work: Any, lane: Any) -> None:
    """Solve the systems of a step for the changes of velocity; the mass keeps them far from singular.

    Both sides add up where they share coordinates. The bogies are eliminated first.
    """
    sides = [SYSTEM.of(work.sides, k, lane) for k in range(2)]
    order = (*JOINTS, *range(7))
    matrix = {(i, j): sides[0].matrix[8 * i + j] + sides[1].matrix[8 * i + j] for i in range(7) for j in range(7)}
    right = {i: sides[0].right[i] + sides[1].right[i] for i in range(7)}
    for bogie, side in zip(JOINTS, sides, strict=True):
        right[bogie], matrix[bogie, bogie] = side.right[7], side.matrix[63]
        matrix |= {(i, bogie): side.matrix[8 * i + 7] for i in range(7)}
        matrix |= {(bogie, j): side.matrix[56 + j] for j in range(7)}
    later = {k: [i for i in order[n + 1 :] if (k, i) in matrix] for n, k in enumerate(order)}
    inverse: dict[int, Any] = {}
    change: dict[int, Any] = {}
    for k in order:
        inverse[k] = 1.0 / matrix[k, k]
        for i in later[k]:
            share = matrix[i, k] * inverse[k]
            right[i] = right[i] - share * right[k]
            for j in later[k]:
                matrix[i, j] = matrix[i, j] - share * matrix[k, j]
    for k in reversed(order):
        rest = right[k]
        for j in later[k]:
            rest = rest - matrix[k, j] * change[j]
        change[k] = rest * inverse[k]
    BODY.of(work.body, lane).change = tuple(change[k] for k in range(9))


@formula
def move(bodies: Any, time_step_s: Any, lane: Any) -> None:
    """Advance the poses with the mean of old and new velocity, and the velocities to the new one."""
    body = BODY.of(bodies, lane)
    change, spin = body.change, plus(body.spin, times(body.change[3:6], 0.5))
    body.position = plus(body.position, times(plus(body.speed, times(change[:3], 0.5)), time_step_s))
    body.joints = plus(body.joints, times(plus(body.rates, times(change[6:], 0.5)), time_step_s))
    rate = root(dot(spin, spin))
    half = lowest(1.6, 0.5 * time_step_s * rate)
    a, (b, c, d) = cosine(half), times(spin, choose(rate > 1e-12, sine(half) / rate, 0.5 * time_step_s))
    w, x, y, z = body.quaternion
    turned = (
        a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
    )  # fmt: skip
    size = dot(turned[:3], turned[:3]) + turned[3] * turned[3]
    body.quaternion = times(turned, 1.0 / root(size))
    body.speed, body.spin = plus(body.speed, change[:3]), plus(body.spin, change[3:6])
    body.rates = plus(body.rates, change[6:])


@joined
def advance(work: Any, time_step_s: float, fall: float, falling: float) -> None:
    """End a step that is assembled; `work.code` takes the outcome. `fall` and `falling` as in `check_health`."""
    for lane in range(0, GROUP, LANES):
        eliminate(work, lane)
        move(work.body, time_step_s, lane)
        check_health(work.body, fall, falling, lane)
    note_outcomes(work.body, work.code)


def is_upright(body: Any) -> Any:
    """Whether the chassis has not overturned; not for a pose that is no number."""
    _, x, y, _ = body.quaternion
    return 1.0 - 2.0 * (x * x + y * y) > COS_OVERTURNED


@formula
def weigh_chassis(work: Any, rover: Any, lane: Any) -> None:
    """Put the energy of the chassis into `energy`, 0 into `power`."""
    body = BODY.of(work.body, lane)
    axes, kg, turning = (body.x_row, body.y_row, body.z_row), rover.body_kg, 0.0
    arm = seen_from(axes, tuple(rover.center[k] for k in range(3)))
    v = plus(body.speed, cross(body.spin, arm))
    for k in range(3):
        turning = turning + rover.inertia[k] * body.omega[k] * body.omega[k]
    body.energy = 0.5 * kg * dot(v, v) + 0.5 * turning + kg * rover.gravity * (body.position[2] + arm[2])
    body.power = body.error = 0.0


@formula
def weigh(work: Any, w: Any, tyre: Any, rover: Any, weight: Any, lane: Any) -> None:
    """Add a wheel's energy, with that of the ground it has pressed, and what its rim gives; note a load too high.

    A load is an impact's where the wheel comes down or the rover falls.
    """
    body, wheel = BODY.of(work.body, lane), WHEEL.of(work.wheels, w, lane)
    pressed = wheel.normal * highest(0.0, wheel.sinkage) / (wheel.soil[1] + 1.5)
    of_wheel = rover.wheel_kg * (0.5 * dot(wheel.velocity, wheel.velocity) + rover.gravity * wheel.center[2])
    body.energy = body.energy + of_wheel + pressed
    body.power = body.power + highest(0.0, wheel.resistance) * (abs(wheel.rim) / wheel.tread[0])
    body.error = body.error + wheel.missed
    falls = highest(abs(body.speed[2]), -wheel.velocity[2]) > IMPACT
    body.outcome = choose((wheel.normal > MOST_LOAD * weight) & ~falls, DIVERGED, body.outcome)


@formula
def gained(work: Any, before: Any, tyre: Any, weight: Any, time_step_s: Any, begins: Any, lane: Any) -> None:
    """Sum up energy that came from nowhere and what the steps miss; note where either is too much. Energy comes from
    the rims alone."""
    body, was = BODY.of(work.body, lane), BODY.of(before, lane)
    excess = was.excess + (body.energy - was.energy - time_step_s * was.power)
    body.excess = choose(begins, 0.0, highest(excess, 0.0))
    body.error = choose(begins, 0.0, was.error + MEMORY * (body.error - was.error))
    too_much = (body.error > MOST_ERROR * weight) | (body.excess > MOST_EXCESS * weight * tyre[0])
    body.outcome = choose(too_much, DIVERGED, body.outcome)


@compiled
def check_sense(work: Any, rover: Any, tyre: Any, time_step_s: float, begins: bool) -> None:
    """Note in `work.code` whose loads or energy no drive has, and whose steps miss the soil's law.

    Called when a step is assembled.
    """
    before, wheels = work.body.copy(), len(work.wheels)
    weight = (rover.body_kg + wheels * rover.wheel_kg) * rover.gravity
    for lane in range(0, GROUP, LANES):
        weigh_chassis(work, rover, lane)
        for w in range(wheels):
            weigh(work, w, tyre, rover, weight, lane)
        gained(work, before, tyre, weight, time_step_s, begins, lane)
    note_outcomes(work.body, work.code)


@formula
def check_health(bodies: Any, fall: Any, falling: Any, lane: Any) -> None:
    """Note the members whose state cannot be driven on.

    `fall` is the speed gained in a step of free fall [m/s]: what gains twice that comes from the step, not from a fall.
    A rover that moves at `falling` is not driven any more. [m/s]
    """
    body = BODY.of(bodies, lane)
    fastest, most = 0.0, 0.0
    for speed, change in zip(body.speed, body.change, strict=False):
        fastest, most = highest(abs(speed), fastest), highest(abs(change), most)
    outcome = choose(fastest >= falling, choose(most < 2.0 * fall, FELL, DIVERGED), FINISHED)
    for speed in (*body.speed, *body.spin, *body.rates):
        outcome = choose(abs(speed) < FASTEST, outcome, DIVERGED)
    body.outcome = choose((outcome == FINISHED) & ~is_upright(body), OVERTURNED, outcome)
