"""Kinematics, mass matrix and free forces of the rover: nine degrees of freedom, exact.

Configuration (10): position of the origin in the world [m], unit quaternion body-to-world (w, x, y, z), differential
angle rho, left and right bogie angle [rad]. Velocity (9): world velocity of the origin [m/s], world angular velocity of
the chassis [rad/s], rates of rho and of the two bogies [rad/s]. A rover without bogies keeps their rows at rest.

The tree is one rigid chassis and point masses at the wheel centres, so the mass matrix is a sum of J^T m J and the
inertial forces follow from the accelerations that remain at u-dot = 0; nothing is linearised. The wheels' own spin
(0.02 N m s each at 0.05 m/s, gyroscopic torques of 1e-4 N m) is left out. Wheels enter the equations in `contact`.
"""

from typing import Any

from lunarsci.elementary import cosine, sine
from lunarsci.lanes import choose, formula, signed
from lunarsci.twin.lanes import BODY, SYSTEM, WHEEL, cross, dot, plus, seen_from, times


def rotation_of(w: Any, x: Any, y: Any, z: Any) -> Any:
    """Rows of the rotation matrix body-to-world of a unit quaternion."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def swung(cos: Any, sin: Any, v: Any) -> Any:
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
    first = swung(cosine(rocker), sine(rocker), times((rover.bogie[0], side * rover.bogie[1], rover.bogie[2]), hung))
    last = (rover.arms[w, 0] - offset * sin_s, rover.arms[w, 1] + offset * (cos_s - 1.0), rover.arms[w, 2])
    last = swung(cosine(angle), sine(angle), last)
    pivot, hang = (0.0, side * rover.pivot_y, 0.0), plus(first, last)
    wheel.arm = seen_from(axes, plus(pivot, hang))
    wheel.center = plus(body.position, wheel.arm)
    wheel.swing = seen_from(axes, (side * hang[2], 0.0, -side * hang[0]))
    wheel.bogie_swing = seen_from(axes, (hung * last[2], 0.0, -hung * last[0]))
    forward = signed(1.0, wheel.rim)
    wheel.axle = seen_from(axes, swung(cosine(angle), sine(angle), (-forward * sin_s, forward * cos_s, 0.0)))
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
    center, own = ([triple[k] for k in range(3)] for triple in (rover.center, rover.inertia))
    arm, remaining = seen_from(axes, center), seen_from(axes, cross(omega, cross(omega, center)))
    pull = (-kg * remaining[0], -kg * remaining[1], -kg * (rover.gravity + remaining[2]))
    torque = seen_from(axes, cross(tuple(map(_product, own, omega)), omega))
    right[:6] = (*times(pull, time_step_s), *times(plus(torque, cross(arm, pull)), time_step_s))
    square = dot(arm, arm)
    skew = ((0.0, arm[2], -arm[1]), (-arm[2], 0.0, arm[0]), (arm[1], -arm[0], 0.0))
    for i in range(3):
        matrix[9 * i] = kg
        for j in range(3):
            moment = dot(tuple(map(_product, axes[i], own)), axes[j])
            matrix[27 + 8 * i + j] = moment + kg * ((square if i == j else 0.0) - arm[i] * arm[j])
            if i != j:
                matrix[8 * i + 3 + j] = matrix[24 + 8 * j + i] = kg * skew[i][j]


def _product(one: Any, two: Any) -> Any:
    return one * two
