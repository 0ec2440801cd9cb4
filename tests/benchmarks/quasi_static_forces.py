"""Wheel forces and equilibrium of the rover of `quasi_static.py`, compiled."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

SLOWEST_RIM_M_S = 1e-4
"""A rim that stands still is taken to turn so fast, that its shear is finite; assumed."""


class Law(NamedTuple):
    """What the kernels read: the wheel, the soil (SI, tangents of angles), the choices, Gauss points on 0 to 1."""

    radius: float
    shearing_radius: float
    width: float
    soil: FloatArray
    c1: float
    c2: float
    rebound: float
    entry_radius: float
    side: float
    weight_n_m3: float
    footprint: float
    nodes: FloatArray
    weights: FloatArray


class Ground(NamedTuple):
    """Heights on a grid; `triangles` for two planes a cell, else cubic convolution (Keys 1981)."""

    x0: float
    y0: float
    spacing: float
    height: FloatArray
    triangles: bool


@njit(cache=True, error_model="numpy")
def slip_of(ahead: float, rim: float) -> float:
    """Slip ratio (Ding et al. 2024, Eq. 8) at a velocity and a rim speed."""
    way = 1.0 if rim >= 0.0 else -1.0
    v, rim = way * ahead, max(way * rim, SLOWEST_RIM_M_S)
    return 1.0 - v / rim if rim >= v else rim / v - 1.0


@njit(cache=True, error_model="numpy")
def wheel_forces(law: Law, z: float, ahead: float, left: float, rim: float, dug: float) -> Any:
    """Normal, drawbar and lateral force [N], moments about axle, travel and normal [N m].

    For sinkage z, velocity ahead and to the left, and rim speed r_s omega. Forces act at the axle. `dug` is
    the slip ratio that has dug the wheel in: of the steady motion, as slip sinkage takes travel to build up.
    """
    way = 1.0 if rim >= 0.0 else -1.0
    v, rim = way * ahead, max(way * rim, SLOWEST_RIM_M_S)
    if z <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    r, rs, z = law.radius, law.shearing_radius, min(z, 0.9 * law.radius)
    stiff, n0, n1, c, tan_phi, kx, tan_y, ky = law.soil
    bounded = min(max(dug, -1.0), 1.0)
    exponent = max(n0 + n1 * bounded, 0.05)
    first, last = math.acos(1.0 - z / r), -math.acos(1.0 - law.rebound * z / r)
    shear_from = math.acos((r - z) / law.entry_radius)
    peak = min(max(law.c1 + law.c2 * bounded, 0.05), 0.95) * first
    cos_first, stretch = math.cos(first), (first - peak) / (peak - last)
    ratio_x, ratio_y = v * rs / rim, -left * rs / rim
    fn, fx, fy, torque, over, steer = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    chi = 0.25 * math.pi - 0.5 * math.atan(tan_phi)
    cot = 1.0 / math.tan(chi)
    d1 = cot + math.tan(0.5 * math.pi - chi)
    d2 = cot + cot * cot / max(tan_phi, 1e-9) if tan_phi > 0.0 else cot
    d2 = min(d2, 1e3)
    speed = math.sqrt(v * v + left * left)
    against = -law.side * left / speed if speed > 0.0 else 0.0
    for part in range(2):
        low, high = (peak, first) if part == 0 else (last, peak)
        for k in range(len(law.nodes)):
            t, w = low + (high - low) * law.nodes[k], (high - low) * law.weights[k]
            like = t if part == 0 else first - (t - last) * stretch
            cos_t, sin_t = math.cos(t), math.sin(t)
            sigma = stiff * (r * max(math.cos(like) - cos_first, 0.0)) ** exponent
            jx = (rs * (shear_from - t) - ratio_x * (math.sin(shear_from) - sin_t)) / kx
            jy = ratio_y * (shear_from - t) / ky
            e = math.sqrt(jx * jx + jy * jy)
            share = -math.expm1(-e) / e if e > 1e-12 else 1.0
            tx, ty = (c + sigma * tan_phi) * jx * share, (c + sigma * tan_y) * jy * share
            depth = max(r * (cos_t - cos_first), 0.0)
            side = against * d1 * (c * depth + 0.5 * d2 * law.weight_n_m3 * depth * depth) * (r - depth * cos_t) * w
            n_area, t_area = r * law.width * w, rs * law.width * w
            fn += n_area * sigma * cos_t + t_area * tx * sin_t
            fx += t_area * tx * cos_t - n_area * sigma * sin_t
            torque += t_area * rs * tx
            fy += t_area * ty + side
            over += (t_area * rs * ty + side * r) * cos_t
            steer += (t_area * rs * ty + side * r) * sin_t
    return fn, way * fx, fy, way * torque, over, way * steer


@njit(cache=True, error_model="numpy")
def height_of(ground: Ground, x: float, y: float) -> float:
    """Height of the ground, NaN outside the map."""
    ny, nx = ground.height.shape
    column, row = (x - ground.x0) / ground.spacing, (y - ground.y0) / ground.spacing
    if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
        return math.nan
    j, i = min(int(column), nx - 2), min(int(row), ny - 2)
    a, b, h = column - j, row - i, ground.height
    if ground.triangles:
        east = h[i, j + 1] - h[i, j] if a >= b else h[i + 1, j + 1] - h[i + 1, j]
        north = h[i + 1, j + 1] - h[i, j + 1] if a >= b else h[i + 1, j] - h[i, j]
        return float(h[i, j] + a * east + b * north)
    if not (1 <= j < nx - 2 and 1 <= i < ny - 2):
        low, high = h[i, j] + a * (h[i, j + 1] - h[i, j]), h[i + 1, j] + a * (h[i + 1, j + 1] - h[i + 1, j])
        return float(low + b * (high - low))
    total = 0.0
    for k in range(4):
        q = h[i + k - 1]
        slope, next_slope = 0.5 * (q[j + 1] - q[j - 1]), 0.5 * (q[j + 2] - q[j])
        drop = q[j] - q[j + 1]
        line = q[j] + a * (slope + a * (-3 * drop - 2 * slope - next_slope + a * (2 * drop + slope + next_slope)))
        weight = (0.5 * b * (-1 + b * (2 - b)), 1 + b * b * (1.5 * b - 2.5), 0.5 * b * (1 + b * (4 - 3 * b)),
                  0.5 * b * b * (b - 1))[k]  # fmt: skip
        total += weight * line
    return float(total)


@njit(cache=True, error_model="numpy")
def plane_at(ground: Ground, x: float, y: float, d: float) -> Any:
    """Mean height and slopes along x and y of four points about one."""
    mean, east, north = 0.0, 0.0, 0.0
    for k in range(4):
        to_x, to_y = (1.0, -1.0, 0.0, 0.0)[k], (0.0, 0.0, 1.0, -1.0)[k]
        height = height_of(ground, x + d * to_x, y + d * to_y)
        mean, east, north = mean + 0.25 * height, east + 0.5 * to_x * height / d, north + 0.5 * to_y * height / d
    return mean, east, north


@njit(cache=True, error_model="numpy")
def pitched(angle: float, v: Any) -> Any:
    """A vector turned about y."""
    return math.cos(angle) * v[0] + math.sin(angle) * v[2], v[1], math.cos(angle) * v[2] - math.sin(angle) * v[0]


@njit(cache=True, error_model="numpy")
def tilted(q: FloatArray, v: Any) -> Any:
    """A vector of the chassis in the frame that only follows the heading; q[4] is roll, q[5] pitch."""
    rolled = v[0], math.cos(q[4]) * v[1] - math.sin(q[4]) * v[2], math.sin(q[4]) * v[1] + math.cos(q[4]) * v[2]
    return pitched(q[5], rolled)


@njit(cache=True, error_model="numpy")
def cross(a: Any, b: Any) -> Any:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy")
def dot(a: Any, b: Any) -> float:
    """Scalar product."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@njit(cache=True, error_model="numpy")
def place(rover: Any, q: FloatArray, i: int, steer: float, points: FloatArray) -> float:
    """Wheel centre, its axle, its rocker pivot and its bogie pivot in the heading's frame, (4, 3); the arm's angle.

    q is velocity ahead, left, turning; height, roll, pitch; differential; left and right bogie.
    """
    side = 1.0 if i % 2 == 0 else -1.0
    rocker = side * q[6]
    angle = rocker + (q[7 + i % 2] if rover.hung[i] > 0.0 else 0.0)
    out = side * rover.steering_offset
    arm = rover.arms[i]
    wheel = pitched(angle, (arm[0] - math.sin(steer) * out, arm[1] + (math.cos(steer) - 1.0) * out, arm[2]))
    hang = pitched(rocker, (rover.bogie[0], side * rover.bogie[1], rover.bogie[2]))
    pivot = (0.0, side * rover.pivot_y, 0.0)
    bogie = (hang[0], pivot[1] + hang[1], hang[2])
    base = bogie if rover.hung[i] > 0.0 else pivot
    center = tilted(q, (base[0] + wheel[0], base[1] + wheel[1], base[2] + wheel[2]))
    axle = tilted(q, pitched(angle, (-math.sin(steer), math.cos(steer), 0.0)))
    hinge, lower = tilted(q, pivot), tilted(q, bogie)
    for k in range(3):
        points[0, k], points[1, k], points[2, k], points[3, k] = center[k], axle[k], hinge[k], lower[k]
    return float(angle + q[5])


@njit(cache=True, error_model="numpy")
def frame(law: Law, ground: Ground, pose: Any, c: Any, axle: Any) -> Any:
    """World x and y of a wheel centre, sinkage, slopes ahead and across, travel direction, left direction, normal.

    `pose` is x, y, cosine and sine of the heading, z; all vectors are in the heading's frame.
    """
    x0, y0, cos_yaw, sin_yaw, z0 = pose
    x, y = x0 + cos_yaw * c[0] - sin_yaw * c[1], y0 + sin_yaw * c[0] + cos_yaw * c[1]
    height, east, north, foot_x, foot_y = 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(2):
        height, east, north = plane_at(ground, x + foot_x, y + foot_y, law.footprint)
        height -= east * foot_x + north * foot_y
        drop = law.radius / math.sqrt(1.0 + east * east + north * north)
        foot_x, foot_y = drop * east, drop * north
    along, across = cos_yaw * east + sin_yaw * north, cos_yaw * north - sin_yaw * east
    size = math.sqrt(1.0 + along * along + across * across)
    normal = (-along / size, -across / size, 1.0 / size)
    ex = cross(axle, normal)
    long = math.sqrt(dot(ex, ex))
    ex = (ex[0] / long, ex[1] / long, ex[2] / long)
    return x, y, law.radius - (z0 + c[2] - height) * normal[2], along, across, ex, cross(normal, ex), normal


@njit(cache=True, error_model="numpy")
def push(scene: Any, command: Any, pose: Any, q: FloatArray, i: int, points: FloatArray, state: FloatArray) -> Any:
    """Force [N] and moment [N m] on wheel i by the ground; its state, and its points as `place` gives them.

    As in the twin, the state looks where the wheel rolls to, and the lateral force has the sign of the side slip.
    """
    rover, law, ground = scene
    steer, rims, before, since, _ = command
    spin, moving_x, moving_y = 0.0, 0.0, 0.0
    if since < math.inf:
        turned = place(rover, before, i, steer[i], points)
        old_x, old_y = points[0, 0], points[0, 1]
        spin = (place(rover, q, i, steer[i], points) - turned) / since
        moving_x, moving_y = (points[0, 0] - old_x) / since, (points[0, 1] - old_y) / since
    else:
        place(rover, q, i, steer[i], points)
    c = points[0]
    x, y, sinkage, along, across, ex, ey, normal = frame(law, ground, pose, c, points[1])
    vx, vy = q[0] - q[2] * c[1] + moving_x, q[1] + q[2] * c[0] + moving_y
    velocity = (vx, vy, along * vx + across * vy)
    steady = (vx - moving_x, vy - moving_y, velocity[2] - along * moving_x - across * moving_y)
    ahead, left, rim = dot(velocity, ex), dot(velocity, ey), rims[i] + law.shearing_radius * spin
    dug, slip = slip_of(dot(steady, ex), rims[i]), slip_of(ahead, rim)
    fn, fx, fy, torque, over, about = wheel_forces(law, sinkage, ahead, left, rim, dug)
    valid = 1.0 if 0.0 < sinkage < law.radius and abs(slip) <= 0.6 else 0.0
    way = 1.0 if rim >= 0.0 else -1.0
    side_slip = math.degrees(math.atan2(way * left, abs(ahead)))
    found = (x, y, sinkage, slip, side_slip, fn, way * fx, -way * fy, way * torque, valid)
    for k in range(10):
        state[k] = found[k]
    fx, fy, fn = (fx * ex[0] + fy * ey[0] + fn * normal[0], fx * ex[1] + fy * ey[1] + fn * normal[1],
                  fx * ex[2] + fy * ey[2] + fn * normal[2])  # fmt: skip
    moment = (over * ex[0] - torque * ey[0] + about * normal[0], over * ex[1] - torque * ey[1] + about * normal[1],
              over * ex[2] - torque * ey[2] + about * normal[2])  # fmt: skip
    return (fx, fy, fn), moment


@njit(cache=True, error_model="numpy")
def balance(scene: Any, command: Any, now: FloatArray, q: FloatArray, rest: FloatArray, wheels: FloatArray) -> None:
    """Sums of forces and moments that vanish in equilibrium, over the weight; states of the wheels by STATE_COLUMNS.

    `command` is steering angles, rim speeds, the q before, the time since (inf for none) and the time that the pose
    goes on from x, y, heading in `now` with the velocity in q. `rest` (9,): forces ahead and left, moment about z,
    force up, moments about x and y, of the differential, of the left and the right bogie.
    """
    rover, count, onward = scene[0], len(command[0]), command[4]
    yaw = now[2] + onward * q[2]
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    x0 = now[0] + onward * (cos_yaw * q[0] - sin_yaw * q[1])
    y0 = now[1] + onward * (sin_yaw * q[0] + cos_yaw * q[1])
    pose = (x0, y0, cos_yaw, sin_yaw, q[3])
    pull = (0.0, 0.0, -rover.body_kg * rover.gravity)
    turn = cross(tilted(q, (rover.center[0], rover.center[1], rover.center[2])), pull)
    y_axis = tilted(q, (0.0, 1.0, 0.0))
    for k in range(9):
        rest[k] = 0.0
    rest[2], rest[3], rest[4], rest[5] = turn[2], pull[2], turn[0], turn[1]
    points = np.empty((4, 3))
    for i in range(count):
        force, moment = push(scene, command, pose, q, i, points, wheels[i])
        force = (force[0], force[1], force[2] - rover.wheel_kg * rover.gravity)
        turn = cross(points[0], force)
        rest[0] += force[0]
        rest[1] += force[1]
        rest[3] += force[2]
        rest[2] += turn[2] + moment[2]
        rest[4] += turn[0] + moment[0]
        rest[5] += turn[1] + moment[1]
        joint = dot(cross(points[0] - points[2], force), y_axis) + dot(moment, y_axis)
        rest[6] += joint if i % 2 == 0 else -joint
        if rover.hung[i] > 0.0:
            rest[7 + i % 2] += dot(cross(points[0] - points[3], force), y_axis) + dot(moment, y_axis)
    weight = (rover.body_kg + count * rover.wheel_kg) * rover.gravity
    for k in range(9):
        rest[k] /= weight
