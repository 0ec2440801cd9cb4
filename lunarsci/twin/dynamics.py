"""Kinematics, mass matrix and free forces of the rover: nine degrees of freedom, exact.

Configuration `pose` (10): position of the origin in the world [m], unit quaternion body-to-world (w, x, y, z),
differential angle rho, left and right bogie angle [rad]. Velocity `u` (9): world velocity of the origin [m/s], world
angular velocity of the chassis [rad/s], rates of rho and of the two bogies [rad/s].

The tree is one rigid chassis and six point masses at the wheel centres, so the mass matrix is a sum of J^T m J and the
inertial forces follow from the accelerations that remain at u-dot = 0; nothing is linearised. The wheels' own spin
(0.02 N m s each at 0.05 m/s, gyroscopic torques of 1e-4 N m) is left out.
"""

import math
from typing import Any

from lunarsci.compiled import compiled

__all__ = ["cross", "dot", "inertia_and_free_force", "rotation_of", "wheel_jacobians"]


@compiled
def dot(a: Any, b: Any) -> Any:
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Any, b: Any) -> Any:
    """Vector product of two triples."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def triple(row: Any) -> Any:
    """An array of three as a triple."""
    return (row[0], row[1], row[2])


@compiled
def plus(a: Any, b: Any) -> Any:
    """Sum of two triples."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def rotation_of(pose: Any) -> Any:
    """Rows of the rotation matrix body-to-world of the quaternion in `pose`."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@compiled
def to_world(rotation: Any, v: Any) -> Any:
    """R v."""
    return (dot(rotation[0], v), dot(rotation[1], v), dot(rotation[2], v))


@compiled
def to_body(rotation: Any, v: Any) -> Any:
    """R^T v."""
    a, b, c = rotation
    return (
        a[0] * v[0] + b[0] * v[1] + c[0] * v[2],
        a[1] * v[0] + b[1] * v[1] + c[1] * v[2],
        a[2] * v[0] + b[2] * v[1] + c[2] * v[2],
    )


@compiled
def swung(angle: float, v: Any) -> Any:
    """`v` turned about the y axis."""
    c, s = math.cos(angle), math.sin(angle)
    return (c * v[0] + s * v[2], v[1], c * v[2] - s * v[0])


@compiled
def steered_arm(rover: Any, wheel: int, angle: float) -> Any:
    """Wheel centre from its pivot when steered by `angle` about an axis inboard of the wheel. [m]"""
    arm = rover.arms[wheel]
    offset = rover.steering_offset if wheel % 2 == 0 else -rover.steering_offset
    return (arm[0] - offset * math.sin(angle), arm[1] + offset * (math.cos(angle) - 1.0), arm[2])


@compiled
def segment_acceleration(rate: Any, spin: Any, segment: Any) -> Any:
    """Acceleration along a segment that turns at `rate`, when only `spin` (joint rate, chassis axis) changes direction.

    rate x (rate x d) + (omega x spin) x d, where omega x spin = rate x spin as both differ by a multiple of spin.
    """
    return plus(cross(rate, cross(rate, segment)), cross(cross(rate, spin), segment))


@compiled
def fill_jacobian(
    jacobian: Any, rotation: Any, arm: Any, from_rocker: Any, from_bogie: Any, sign: float, j: int
) -> None:
    """Jacobian (6, 9) of a wheel carrier, velocity of the wheel centre above angular velocity; arms in the body frame.

    `j` is the column of the bogie the wheel hangs on, 0 for none.
    """
    r = to_world(rotation, arm)
    swing = to_world(rotation, (from_rocker[2], 0.0, -from_rocker[0]))
    jacobian[0, 4], jacobian[0, 5] = r[2], -r[1]
    jacobian[1, 3], jacobian[1, 5] = -r[2], r[0]
    jacobian[2, 3], jacobian[2, 4] = r[1], -r[0]
    for i in range(3):
        jacobian[i, 6] = sign * swing[i]
        jacobian[3 + i, 6] = sign * rotation[i][1]
    if j > 0:
        swing = to_world(rotation, (from_bogie[2], 0.0, -from_bogie[0]))
        for i in range(3):
            jacobian[i, j] = swing[i]
            jacobian[3 + i, j] = rotation[i][1]


@compiled
def wheel_jacobians(rover: Any, pose: Any, u: Any, steering: Any, work: Any) -> None:
    """Fill centre, axle, jacobian and remaining acceleration of the six wheels (world frame) in `work`."""
    rotation = rotation_of(pose)
    omega = to_body(rotation, (u[3], u[4], u[5]))
    for w in range(6):
        side = w % 2
        sign = 1.0 - 2.0 * side
        column = 7 + side if w > 1 else 0
        rocker_angle, rocker_spin = sign * pose[7], (0.0, sign * u[6], 0.0)
        angle, spin = rocker_angle, rocker_spin
        first, last = (0.0, 0.0, 0.0), steered_arm(rover, w, steering[w])
        if column > 0:
            angle += pose[column + 1]
            spin = (0.0, rocker_spin[1] + u[column], 0.0)
            first = swung(rocker_angle, (rover.bogie[0], sign * rover.bogie[1], rover.bogie[2]))
        last = swung(angle, last)
        pivot = (0.0, sign * rover.pivot_y, 0.0)
        arm = plus(pivot, plus(first, last))
        acceleration = plus(
            cross(omega, cross(omega, pivot)),
            plus(
                segment_acceleration(plus(omega, rocker_spin), rocker_spin, first),
                segment_acceleration(plus(omega, spin), spin, last),
            ),
        )
        axle = swung(angle, (-math.sin(steering[w]), math.cos(steering[w]), 0.0))
        fill_jacobian(work.jacobian[w], rotation, arm, plus(first, last), last, sign, column)
        world_arm, world_axle = to_world(rotation, arm), to_world(rotation, axle)
        world_acceleration = to_world(rotation, acceleration)
        for i in range(3):
            work.center[w, i] = pose[i] + world_arm[i]
            work.axle[w, i] = world_axle[i]
            work.acceleration[w, i] = world_acceleration[i]


@compiled
def add_point_mass(mass: Any, force: Any, jacobian: Any, kg: float, acceleration: Any, gravity: float) -> None:
    """Add J^T m J to `mass` (lower triangle) and J^T m (g - a) to `force`."""
    a = (-acceleration[0] * kg, -acceleration[1] * kg, (-gravity - acceleration[2]) * kg)
    for i in range(9):
        x, y, z = jacobian[0, i], jacobian[1, i], jacobian[2, i]
        force[i] += x * a[0] + y * a[1] + z * a[2]
        x, y, z = x * kg, y * kg, z * kg
        for k in range(i + 1):
            mass[i, k] += x * jacobian[0, k] + y * jacobian[1, k] + z * jacobian[2, k]


@compiled
def add_chassis(mass: Any, force: Any, rover: Any, rotation: Any, u: Any, work: Any) -> None:
    """Add the chassis: its mass at its centre, its principal moments and its gyroscopic torque."""
    omega = to_body(rotation, (u[3], u[4], u[5]))
    center = triple(rover.center)
    c = to_world(rotation, center)
    jacobian = work.chassis_jacobian
    jacobian[0, 4], jacobian[0, 5] = c[2], -c[1]
    jacobian[1, 3], jacobian[1, 5] = -c[2], c[0]
    jacobian[2, 3], jacobian[2, 4] = c[1], -c[0]
    acceleration = to_world(rotation, cross(omega, cross(omega, center)))
    add_point_mass(mass, force, jacobian, rover.body_kg, acceleration, rover.gravity)
    moment = rover.inertia
    spin = (moment[0] * omega[0], moment[1] * omega[1], moment[2] * omega[2])
    torque = to_world(rotation, cross(spin, omega))
    for i in range(3):
        force[3 + i] += torque[i]
        row = rotation[i]
        for k in range(i + 1):
            other = rotation[k]
            for axis in range(3):
                mass[3 + i, 3 + k] += row[axis] * moment[axis] * other[axis]


@compiled
def inertia_and_free_force(rover: Any, pose: Any, u: Any, work: Any) -> None:
    """Fill `work.mass` (9, 9) and `work.force` (9): gravity, inertial forces and joint friction, without the ground.

    `wheel_jacobians` must have run for the same pose and velocity. Equations of motion: mass u-dot = force.
    """
    mass, force = work.mass, work.force
    for i in range(9):
        force[i] = 0.0
        for k in range(9):
            mass[i, k] = 0.0
    add_chassis(mass, force, rover, rotation_of(pose), u, work)
    for w in range(6):
        add_point_mass(mass, force, work.jacobian[w], rover.wheel_kg, work.acceleration[w], rover.gravity)
    for i in range(9):
        for k in range(i):
            mass[k, i] = mass[i, k]
    force[6] -= 2.0 * rover.joint_damping * u[6]
    force[7] -= rover.joint_damping * u[7]
    force[8] -= rover.joint_damping * u[8]
