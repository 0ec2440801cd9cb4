"""Where a wheel meets the terrain, the wrench of the soil on it, and its part in the equations of a step.

The interaction plane is the terrain's tangent plane below the wheel centre. The wheel rolls along the line in which
its own plane cuts the interaction plane; lateral and normal complete the contact frame.

F_DP and F_N act at the wheel centre and M_R about the lateral axis, as in Eqs 21-24 of Ding et al. (2024),
10.1038/s41467-024-46233-8; about the axle itself, 10 m over a bump of 8 cm would end 8 mm off.
F_L acts where the shear stress is centred, r_s below and ahead of the axle, which gives the overturning and steering
torques M_O and M_S their leading parts.
"""

import math
from typing import Any

from lunarsci.compiled import in_lanes, joined, pasted
from lunarsci.elementary import arcsin, cosine, sine
from lunarsci.regolith.forces import slip_ratio, wheel_forces_and_slopes
from lunarsci.twin.simulation.lanes import (
    ACCELERATION,
    ACROSS,
    ALONG,
    ARM,
    AXES,
    AXLE,
    BOGIE_SWING,
    CENTER,
    COEFFICIENT,
    DRAWBAR,
    DRIVE,
    FIRST,
    FORCE,
    GROUND,
    LANES,
    LEVER,
    MATRIX,
    MOMENT,
    NORMAL,
    RIGHT,
    RIM,
    ROTATION,
    SINKAGE,
    SOIL,
    SPEED,
    STIFF,
    SWING,
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

__all__ = [
    "AT_REST",
    "DEEPEST",
    "DRIVEN",
    "HELD",
    "NORMAL_DAMPING",
    "SHALLOWEST",
    "VALID_SLIP",
    "add_wheel",
    "contact_frame",
]

# Assumed, for a calm touch-down: half of critical for a sixth of 135 kg on 7 kN/m; the soil's own is not published.
NORMAL_DAMPING = 400.0
# The closed form has no meaning once the wheel is buried to its axle; beyond this share of r the force stays constant.
DEEPEST = 0.9
# Range of |s| that the source states for the model.
VALID_SLIP = 0.6
AT_REST, DRIVEN, HELD = rows(0, 1, 2)
# Speeds [m/s] below this are none.
SLOWEST = 1e-9
# Below this sinkage [m] the contact angles round to nothing.
SHALLOWEST = 1e-9


@pasted
def contact_frame(slope_x: Any, slope_y: Any, axle: Any) -> Any:
    """Forward, left and normal axis of the contact frame, from the terrain's gradient and the wheel's axle. [-]"""
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    normal = (-slope_x * scale, -slope_y * scale, scale)
    x = cross(axle, normal)
    forward = times(x, 1.0 / (math.sqrt(dot(x, x)) + 1e-300))
    return forward, cross(normal, forward), normal


@pasted
def shear_center(sinkage: Any, slip: Any, tyre: Any) -> Any:
    """How far ahead of and below the axle the shear stress is centred. [m]"""
    r, _, _, r_s, c1, c2, c3 = tyre
    theta_1 = 2.0 * arcsin(math.sqrt(sinkage / (2.0 * r)))
    middle = (1.0 + c3 + c1 + c2 * slip) * theta_1 / 3.0
    return r_s * sine(middle), r_s * cosine(middle)


@pasted
def seen_from(axes: Any, v: Any) -> Any:
    """Components of a world vector along the three axes."""
    return (dot(axes[0], v), dot(axes[1], v), dot(axes[2], v))


@pasted
def chosen(on: Any, values: Any) -> Any:
    """The four values, or zeros in the air, where those of an absurd soil may be no numbers."""
    return (
        values[0] if on > 0.0 else 0.0,
        values[1] if on > 0.0 else 0.0,
        values[2] if on > 0.0 else 0.0,
        values[3] if on > 0.0 else 0.0,
    )


@in_lanes
def meet_ground(
    body: Any, wheel: Any, tyre: Any, kg: float, gravity: float, bogie: int, dt: float, shear: bool, free: float,
) -> None:  # fmt: skip
    """Contact frame, motion, wrench and its derivatives of one wheel.

    The derivatives only steady the implicit step: those of the shear, and the stiffness of F_N ~ z^(n0 + 1/2). The
    normal force never pulls.
    """
    for lane in range(LANES):
        arm, ground, rim = get3(wheel, ARM, lane), get3(wheel, GROUND, lane), abs(get(wheel, RIM, lane))
        axes = contact_frame(ground[1], ground[2], get3(wheel, AXLE, lane))
        v_world = plus(get3(body, SPEED, lane), cross(get3(body, SPEED + 3, lane), arm))
        v_world = plus(v_world, times(get3(wheel, SWING, lane), get(body, SPEED + 6, lane)))
        v_world = plus(v_world, times(get3(wheel, BOGIE_SWING, lane), get(body, bogie, lane)))
        v = seen_from(axes, v_world)
        sinkage = tyre[0] - (get(wheel, CENTER + 2, lane) - ground[0]) * axes[2][2]
        z = min(max(sinkage, SHALLOWEST), DEEPEST * tyre[0])
        on = 1.0 if sinkage > SHALLOWEST else 0.0
        slid = on if shear else 0.0
        soil = (
            get(wheel, SOIL, lane), get(wheel, SOIL + 1, lane), get(wheel, SOIL + 2, lane), get(wheel, SOIL + 3, lane),
            get(wheel, SOIL + 4, lane), get(wheel, SOIL + 5, lane), get(wheel, SOIL + 6, lane),
            get(wheel, SOIL + 7, lane),
        )  # fmt: skip
        travel, lateral = (v[0] / rim, v[1] / rim) if shear else (1.0, 0.0)
        forces, slopes = wheel_forces_and_slopes(z, travel, lateral, tyre, soil, 0)
        f_n, f_dp, f_l, m_r = chosen(on, forces)
        slopes = chosen(on, slopes)
        ahead, below = shear_center(z, slip_ratio(travel), tyre)
        damping = free * NORMAL_DAMPING * v[2] * slid
        pressed = max(f_n - damping, 0.0) * on
        bearing = 1.0 if pressed > 0.0 else 0.0
        per = slid / rim
        # A step must not pass the speed at which nothing slips: from far away the force is taken to fall to 0 there.
        brake = min(max(10.0 * abs(slip_ratio(travel)) - 2.0, 0.0), slid) / max(abs(rim - v[0]), SLOWEST)
        skew = min(max(10.0 * abs(v[1]) / max(abs(v[0]), rim) - 3.0, 0.0), slid) / max(abs(v[1]), SLOWEST)
        along = per * slopes[1] - brake * abs(f_dp)
        d_l = -per * slopes[2] - skew * abs(f_l)
        stiffness = on * (soil[1] + 0.5) * pressed / z
        remaining = seen_from(axes, get3(wheel, ACCELERATION, lane))
        put3(wheel, AXES, lane, axes[0])
        put3(wheel, AXES + 3, lane, axes[1])
        put3(wheel, AXES + 6, lane, axes[2])
        put(wheel, FORCE, lane, slid * f_dp - kg * (gravity * axes[0][2] + remaining[0]))
        put(wheel, FORCE + 1, lane, -slid * f_l - kg * (gravity * axes[1][2] + remaining[1]))
        put(wheel, FORCE + 2, lane, pressed - kg * (gravity * axes[2][2] + remaining[2]))
        put3(wheel, MOMENT, lane, (-slid * below * f_l, -slid * m_r, -slid * ahead * f_l))
        put3(wheel, ALONG, lane, (along, per * bearing * slopes[0], brake * abs(m_r) - per * slopes[3]))
        put3(wheel, ACROSS, lane, (d_l, below * d_l, ahead * d_l))
        put(wheel, STIFF, lane, dt * slid * bearing * NORMAL_DAMPING + 0.5 * dt * dt * stiffness)
        put(wheel, STIFF + 1, lane, free * dt * dt * stiffness * v[2])
        put(wheel, SINKAGE, lane, sinkage)
        put3(wheel, VELOCITY, lane, v)
        put(wheel, NORMAL, lane, pressed + damping * bearing)
        put3(wheel, DRAWBAR, lane, (slid * f_dp, slid * f_l, slid * m_r))


@pasted
def put_row(wheel: Any, levers: Any, lane: Any, i: Any, own: Any, turn: Any, kg: Any, dt: Any) -> None:
    """Levers, coefficients and right side of coordinate i, whose rate moves the centre by `own`, turns it by `turn`."""
    along, across = get3(wheel, ALONG, lane), get3(wheel, ACROSS, lane)
    put3(levers, LEVER + 3 * i, lane, own)
    put3(
        levers,
        COEFFICIENT + 3 * i,
        lane,
        (
            kg * own[0] - dt * (own[0] * along[0] + own[2] * along[1] + turn[1] * along[2]),
            kg * own[1] - dt * (own[1] * across[0] + turn[0] * across[1] + turn[2] * across[2]),
            (kg + get(wheel, STIFF, lane)) * own[2],
        ),
    )
    work = dot(own, get3(wheel, FORCE, lane)) + dot(turn, get3(wheel, MOMENT, lane))
    put(levers, DRIVE + i, lane, dt * work - own[2] * get(wheel, STIFF + 1, lane))


@in_lanes
def find_levers(body: Any, wheel: Any, levers: Any, hung: float, side: float, kg: float, dt: float) -> None:
    """How each coordinate moves the wheel along the contact axes, and what its row of the matrix follows from."""
    for lane in range(LANES):
        e, d, n = get3(wheel, AXES, lane), get3(wheel, AXES + 3, lane), get3(wheel, AXES + 6, lane)
        arm, axes, still = get3(wheel, ARM, lane), (e, d, n), (0.0, 0.0, 0.0)
        upright = (get(body, ROTATION + 1, lane), get(body, ROTATION + 4, lane), get(body, ROTATION + 7, lane))
        turn, r_e, r_d, r_n = seen_from(axes, upright), cross(arm, e), cross(arm, d), cross(arm, n)
        x, y, z = (e[0], d[0], n[0]), (e[1], d[1], n[1]), (e[2], d[2], n[2])
        put_row(wheel, levers, lane, FIRST + 0, x, still, kg, dt)
        put_row(wheel, levers, lane, FIRST + 1, y, still, kg, dt)
        put_row(wheel, levers, lane, FIRST + 2, z, still, kg, dt)
        put_row(wheel, levers, lane, FIRST + 3, (r_e[0], r_d[0], r_n[0]), x, kg, dt)
        put_row(wheel, levers, lane, FIRST + 4, (r_e[1], r_d[1], r_n[1]), y, kg, dt)
        put_row(wheel, levers, lane, FIRST + 5, (r_e[2], r_d[2], r_n[2]), z, kg, dt)
        put_row(wheel, levers, lane, FIRST + 6, seen_from(axes, get3(wheel, SWING, lane)), times(turn, side), kg, dt)
        swing = seen_from(axes, get3(wheel, BOGIE_SWING, lane))
        put_row(wheel, levers, lane, FIRST + 7, swing, times(turn, hung), kg, dt)


@pasted
def raise_by(rows: Any, k: Any, lane: Any, value: Any) -> None:
    """Add to one number."""
    rows[k * LANES + lane] += value


@pasted
def add_row(levers: Any, system: Any, lane: Any, i: Any) -> None:
    """Add row i of the wheel to its side of the system."""
    row, c = MATRIX + 8 * i, get3(levers, COEFFICIENT + 3 * i, lane)
    raise_by(system, row, lane, dot(c, get3(levers, LEVER, lane)))
    raise_by(system, row + 1, lane, dot(c, get3(levers, LEVER + 3, lane)))
    raise_by(system, row + 2, lane, dot(c, get3(levers, LEVER + 6, lane)))
    raise_by(system, row + 3, lane, dot(c, get3(levers, LEVER + 9, lane)))
    raise_by(system, row + 4, lane, dot(c, get3(levers, LEVER + 12, lane)))
    raise_by(system, row + 5, lane, dot(c, get3(levers, LEVER + 15, lane)))
    raise_by(system, row + 6, lane, dot(c, get3(levers, LEVER + 18, lane)))
    raise_by(system, row + 7, lane, dot(c, get3(levers, LEVER + 21, lane)))
    raise_by(system, RIGHT + i, lane, get(levers, DRIVE + i, lane))


@in_lanes
def add_rows(levers: Any, system: Any) -> None:
    """Add a wheel to its side of the system."""
    for lane in range(LANES):
        add_row(levers, system, lane, FIRST + 0)
        add_row(levers, system, lane, FIRST + 1)
        add_row(levers, system, lane, FIRST + 2)
        add_row(levers, system, lane, FIRST + 3)
    for lane in range(LANES):
        add_row(levers, system, lane, FIRST + 4)
        add_row(levers, system, lane, FIRST + 5)
        add_row(levers, system, lane, FIRST + 6)
        add_row(levers, system, lane, FIRST + 7)


@joined
def add_wheel(work: Any, w: int, rover: Any, tyre: Any, dt: float, mode: int) -> None:
    """Add wheel `w`, its mass and the soil's wrench, to the system of a step, and keep what the contact found.

    Parameters
    ----------
    work : with kinematics, ground and commands of the wheel in place; its rim must move.
    rover, tyre : `Rover.vector()`, `Wheel.vector()`.
    dt : step. [s]
    mode : `DRIVEN`; `AT_REST` leaves only the normal force; `HELD` has the forces of the motion, but the step does not
        take the rover along, so touch-down damping and the change of sinkage along the step are left out.
    """
    side, kg = w % 2, rover.wheel_kg
    wheel, system = work.wheels[w], work.sides[side]
    meet_ground(
        work.body, wheel, tyre, kg, rover.gravity, SPEED + 7 + side, dt, mode != AT_REST, 0.0 if mode == HELD else 1.0
    )
    find_levers(work.body, wheel, work.levers, rover.hung[w], 1.0 - 2.0 * side, kg, dt)
    add_rows(work.levers, system)
