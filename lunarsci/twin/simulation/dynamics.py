"""Kinematics, mass matrix and free forces of the rover: nine degrees of freedom, exact.

Configuration (10): position of the origin in the world [m], unit quaternion body-to-world (w, x, y, z), differential
angle rho, left and right bogie angle [rad]. Velocity (9): world velocity of the origin [m/s], world angular velocity of
the chassis [rad/s], rates of rho and of the two bogies [rad/s]. A rover without bogies keeps their rows at rest.

The tree is one rigid chassis and point masses at the wheel centres, so the mass matrix is a sum of J^T m J and the
inertial forces follow from the accelerations that remain at u-dot = 0; nothing is linearised. The wheels' own spin
(0.02 N m s each at 0.05 m/s, gyroscopic torques of 1e-4 N m) is left out. Wheels enter the equations in `contact`.
"""

import math
from typing import Any

from lunarsci.compiled import in_lanes, joined, pasted
from lunarsci.elementary import cosine, sine
from lunarsci.twin.lanes import (
    ACCELERATION,
    ARM,
    AXLE,
    BOGIE_SWING,
    CENTER,
    LANES,
    MATRIX,
    OMEGA,
    POSE,
    RIGHT,
    RIM,
    ROTATION,
    SPEED,
    STEER,
    SWING,
    cross,
    dot,
    get,
    get3,
    plus,
    put,
    put3,
    times,
)


@pasted
def rotation_of(w: Any, x: Any, y: Any, z: Any) -> Any:
    """Rows of the rotation matrix body-to-world of a unit quaternion."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@pasted
def to_world(a: Any, b: Any, c: Any, v: Any) -> Any:
    """R v, from the rows of R."""
    return (dot(a, v), dot(b, v), dot(c, v))


@pasted
def to_body(a: Any, b: Any, c: Any, v: Any) -> Any:
    """R^T v, from the rows of R."""
    return (
        a[0] * v[0] + b[0] * v[1] + c[0] * v[2],
        a[1] * v[0] + b[1] * v[1] + c[1] * v[2],
        a[2] * v[0] + b[2] * v[1] + c[2] * v[2],
    )


@pasted
def swung(cos: Any, sin: Any, v: Any) -> Any:
    """`v` turned about the y axis."""
    return (cos * v[0] + sin * v[2], v[1], cos * v[2] - sin * v[0])


@pasted
def turning(rate: Any, spin: Any, segment: Any) -> Any:
    """Acceleration along a segment that turns at `rate`, when only `spin` (joint rate, about y) changes direction.

    rate x (rate x d) + (omega x spin) x d, where omega x spin = rate x spin as both differ by a multiple of spin.
    """
    return plus(cross(rate, cross(rate, segment)), cross(cross(rate, (0.0, spin, 0.0)), segment))


@in_lanes
def orient(body: Any) -> None:
    """Fill the rotation and the angular velocity in the body frame."""
    for lane in range(LANES):
        w, x, y, z = (
            get(body, POSE + 3, lane),
            get(body, POSE + 4, lane),
            get(body, POSE + 5, lane),
            get(body, POSE + 6, lane),
        )
        a, b, c = rotation_of(w, x, y, z)
        put3(body, ROTATION, lane, a)
        put3(body, ROTATION + 3, lane, b)
        put3(body, ROTATION + 6, lane, c)
        put3(body, OMEGA, lane, to_body(a, b, c, get3(body, SPEED + 3, lane)))


@in_lanes
def place_wheel(body: Any, wheel: Any, rover: Any, w: int) -> None:
    """Fill centre, arm, swings, axle and remaining acceleration of wheel `w`, steered as its rows say.

    A steered wheel stands `steering_offset` outboard of its steering axis. The axle of a wheel that turns backwards
    points the other way, so that it rolls ahead along its contact frame like any other; at rest the sign of the zero
    tells.
    """
    side = 1.0 if w % 2 == 0 else -1.0
    hung = rover.hung[w]
    offset = side * rover.steering_offset
    own_x, own_y, own_z = rover.arms[w, 0], rover.arms[w, 1], rover.arms[w, 2]
    pivot_y = side * rover.pivot_y
    bogie_x, bogie_y, bogie_z = hung * rover.bogie[0], hung * side * rover.bogie[1], hung * rover.bogie[2]
    joint = 8 if w % 2 == 0 else 9
    for lane in range(LANES):
        a, b, c = get3(body, ROTATION, lane), get3(body, ROTATION + 3, lane), get3(body, ROTATION + 6, lane)
        omega = get3(body, OMEGA, lane)
        rocker, rocker_spin = side * get(body, POSE + 7, lane), side * get(body, SPEED + 6, lane)
        angle = rocker + hung * get(body, joint, lane)
        spin = rocker_spin + hung * get(body, SPEED + joint - 1, lane)
        cos_r, sin_r, cos_b, sin_b = cosine(rocker), sine(rocker), cosine(angle), sine(angle)
        cos_s, sin_s = cosine(get(wheel, STEER, lane)), sine(get(wheel, STEER, lane))
        ahead = math.copysign(1.0, get(wheel, RIM, lane))
        first = swung(cos_r, sin_r, (bogie_x, bogie_y, bogie_z))
        last = swung(cos_b, sin_b, (own_x - offset * sin_s, own_y + offset * (cos_s - 1.0), own_z))
        pivot = (0.0, pivot_y, 0.0)
        hang = plus(first, last)
        arm = to_world(a, b, c, plus(pivot, hang))
        centripetal = cross(omega, cross(omega, pivot))
        by_rocker = turning((omega[0], omega[1] + rocker_spin, omega[2]), rocker_spin, first)
        by_bogie = turning((omega[0], omega[1] + spin, omega[2]), spin, last)
        put3(wheel, CENTER, lane, plus(get3(body, POSE, lane), arm))
        put3(wheel, ARM, lane, arm)
        put3(wheel, SWING, lane, to_world(a, b, c, (side * hang[2], 0.0, -side * hang[0])))
        put3(wheel, BOGIE_SWING, lane, to_world(a, b, c, (hung * last[2], 0.0, -hung * last[0])))
        put3(wheel, AXLE, lane, to_world(a, b, c, swung(cos_b, sin_b, (-ahead * sin_s, ahead * cos_s, 0.0))))
        put3(wheel, ACCELERATION, lane, to_world(a, b, c, plus(centripetal, plus(by_rocker, by_bogie))))


@joined
def place_wheels(rover: Any, work: Any) -> None:
    """Kinematics of all wheels at the pose and velocity in `work`."""
    orient(work.body)
    for w in range(len(rover.arms)):
        place_wheel(work.body, work.wheels[w], rover, w)


@joined
def begin_system(rover: Any, work: Any, time_step_s: float) -> None:
    """Fill matrix and right side of a step with the chassis: mass, moments, gyroscopic torque, joint friction.

    Equations of motion: mass u-dot = force; the matrix is the mass so far, the right side time_step_s times the force.
    """
    work.sides[:] = 0.0
    idle = 0.0 if rover.bogies else 1.0
    add_chassis(work.body, work.sides[0], rover, time_step_s)
    for side in range(2):
        add_friction(work.body, work.sides[side], rover.joint_damping, idle, time_step_s, SPEED + 7 + side)


@in_lanes
def add_friction(body: Any, system: Any, friction: float, idle: float, time_step_s: float, bogie: int) -> None:
    """Joint friction of one rocker and its bogie; `idle` keeps the row of a bogie that is not there."""
    for lane in range(LANES):
        put(system, MATRIX + 54, lane, time_step_s * friction)
        put(system, MATRIX + 63, lane, time_step_s * friction + idle)
        put(system, RIGHT + 6, lane, -time_step_s * friction * get(body, SPEED + 6, lane))
        put(system, RIGHT + 7, lane, -time_step_s * friction * get(body, bogie, lane))


@in_lanes
def add_chassis(body: Any, system: Any, rover: Any, time_step_s: float) -> None:
    """The chassis' mass at its centre, its principal moments and gyroscopic torque."""
    kg, gravity = rover.body_kg, rover.gravity
    center_x, center_y, center_z = rover.center[0], rover.center[1], rover.center[2]
    i_x, i_y, i_z = rover.inertia[0], rover.inertia[1], rover.inertia[2]
    for lane in range(LANES):
        a, b, c = get3(body, ROTATION, lane), get3(body, ROTATION + 3, lane), get3(body, ROTATION + 6, lane)
        omega, center = get3(body, OMEGA, lane), (center_x, center_y, center_z)
        x, y, z = to_world(a, b, c, center)
        remaining = to_world(a, b, c, cross(omega, cross(omega, center)))
        pull = (-kg * remaining[0], -kg * remaining[1], -kg * (gravity + remaining[2]))
        torque = to_world(a, b, c, cross((i_x * omega[0], i_y * omega[1], i_z * omega[2]), omega))
        put3(system, RIGHT, lane, times(pull, time_step_s))
        put3(system, RIGHT + 3, lane, times(plus(torque, cross((x, y, z), pull)), time_step_s))
        put_mass(system, lane, kg, x, y, z)
        a_i, b_i = (a[0] * i_x, a[1] * i_y, a[2] * i_z), (b[0] * i_x, b[1] * i_y, b[2] * i_z)
        c_i = (c[0] * i_x, c[1] * i_y, c[2] * i_z)
        put_moments(
            system, lane,
            (
                dot(a_i, a) + kg * (y * y + z * z), dot(b_i, b) + kg * (x * x + z * z),
                dot(c_i, c) + kg * (x * x + y * y),
            ),
            (dot(a_i, b) - kg * x * y, dot(a_i, c) - kg * x * z, dot(b_i, c) - kg * y * z),
        )  # fmt: skip


@pasted
def put_mass(system: Any, lane: Any, kg: Any, x: Any, y: Any, z: Any) -> None:
    """Mass, and its product with the arm x, y, z, in the rows of translation and rotation."""
    put(system, MATRIX, lane, kg)
    put(system, MATRIX + 9, lane, kg)
    put(system, MATRIX + 18, lane, kg)
    put(system, MATRIX + 4, lane, kg * z)
    put(system, MATRIX + 5, lane, -kg * y)
    put(system, MATRIX + 11, lane, -kg * z)
    put(system, MATRIX + 13, lane, kg * x)
    put(system, MATRIX + 19, lane, kg * y)
    put(system, MATRIX + 20, lane, -kg * x)
    put(system, MATRIX + 32, lane, kg * z)
    put(system, MATRIX + 40, lane, -kg * y)
    put(system, MATRIX + 25, lane, -kg * z)
    put(system, MATRIX + 41, lane, kg * x)
    put(system, MATRIX + 26, lane, kg * y)
    put(system, MATRIX + 34, lane, -kg * x)


@pasted
def put_moments(system: Any, lane: Any, own: Any, mixed: Any) -> None:
    """Moments of inertia about the origin along the world axes, and their products xy, xz, yz."""
    put(system, MATRIX + 27, lane, own[0])
    put(system, MATRIX + 36, lane, own[1])
    put(system, MATRIX + 45, lane, own[2])
    put(system, MATRIX + 28, lane, mixed[0])
    put(system, MATRIX + 35, lane, mixed[0])
    put(system, MATRIX + 29, lane, mixed[1])
    put(system, MATRIX + 43, lane, mixed[1])
    put(system, MATRIX + 37, lane, mixed[2])
    put(system, MATRIX + 44, lane, mixed[2])
