"""Where a wheel meets the terrain, the wrench of the soil on it, and its part in the equations of a step.

The interaction plane is the terrain's tangent plane below the wheel centre. The wheel rolls along the line in which
its own plane cuts the interaction plane; lateral and normal complete the contact frame.

F_DP and F_N act at the wheel centre and M_R about the lateral axis, as in Eqs 21-24 of Ding et al. (2024),
10.1038/s41467-024-46233-8; about the axle itself, 10 m over a bump of 8 cm would end 8 mm off.
F_L acts where the shear stress is centred, r_s below and ahead of the axle, which gives the overturning and steering
torques M_O and M_S their leading parts.
"""

from typing import Any

from lunarsci.compiled import in_lanes, joined, pasted
from lunarsci.regolith.forces import contact_forces, slip_ratio
from lunarsci.twin.lanes import (
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
    LAST,
    LEVER,
    MATRIX,
    MISSED,
    MOMENT,
    NORMAL,
    RIGHT,
    RIM,
    ROTATION,
    RUT,
    SINKAGE,
    SLIP,
    SPEED,
    STIFF,
    SWING,
    TRAVEL,
    VELOCITY,
    cross,
    dot,
    get,
    get3,
    put,
    put3,
    rows,
    times,
)
from lunarsci.twin.simulation.contact_frame import (
    DEEPEST,
    SHALLOWEST,
    SLOWEST,
    any_stands,
    contact_frame,
    keep_hold,
    lean,
    seen_from,
    shear_center,
    soil_below,
    stand,
    velocity_of,
)

# Assumed, for a calm touch-down: half of critical for this mass on a wheel [kg] on 7 kN/m, and for another in
# proportion; the soil's own is not published. [N s/m]
NORMAL_DAMPING, MASS_ON_WHEEL = 400.0, 22.5
AT_REST, DRIVEN, HELD = rows(0, 1, 2)
# Travel over which the bearing takes up a change of slip [m]: at a creep it does not follow at once. Assumed, short
# against the contact, so that a step under way passes it.
TAKE_UP_M = 1e-3
# A rim whose speed changes by less than this share in a step is under way.
STEADY = 0.02


@pasted
def chosen(on: Any, values: Any) -> Any:
    """The four values, or zeros in the air, where those of an absurd soil may be no numbers."""
    return (
        values[0] if on > 0.0 else 0.0,
        values[1] if on > 0.0 else 0.0,
        values[2] if on > 0.0 else 0.0,
        values[3] if on > 0.0 else 0.0,
    )


@pasted
def put_axes(wheel: Any, lane: Any, axes: Any) -> None:
    """Store the axes of the contact frame."""
    put3(wheel, AXES, lane, axes[0])
    put3(wheel, AXES + 3, lane, axes[1])
    put3(wheel, AXES + 6, lane, axes[2])


@pasted
def steadied(v: Any, rim: Any, travel: Any, slid: Any, forces: Any, slopes: Any) -> Any:
    """Derivatives of the forces ahead and to the left by the velocity there, and the share that stops the slip.

    A step must not pass the speed at which nothing slips: from far away the force is taken to fall to 0 there.
    """
    brake = min(max(10.0 * abs(slip_ratio(travel)) - 2.0, 0.0), slid) / max(abs(rim - v[0]), SLOWEST)
    skew = min(max(10.0 * abs(v[1]) / max(abs(v[0]), rim) - 3.0, 0.0), slid) / max(abs(v[1]), SLOWEST)
    per = slid / rim
    return per * slopes[0] - brake * abs(forces[0]), -per * slopes[1] - skew * abs(forces[1]), brake


@in_lanes
def meet_ground(
    body: Any, wheel: Any, tyre: Any, kg: float, gravity: float, bogie: int, time_step_s: float, shear: bool,
    free: float, calm: float,
) -> None:  # fmt: skip
    """Contact frame, motion, wrench and its derivatives of one wheel that rolls.

    The derivatives only steady the implicit step: those of the shear, and the stiffness of F_N ~ z^(n0 + 1/2). The
    normal force never pulls. Below a rim that stands still the stress along the wheel stays as it was; `stand` then
    puts in what holds it. `calm` is the damping of a touch-down. [N s/m]
    """
    for lane in range(LANES):
        arm, ground, turning = get3(wheel, ARM, lane), get3(wheel, GROUND, lane), abs(get(wheel, RIM, lane))
        rim = max(turning, SLOWEST)
        axes = contact_frame(ground[1], ground[2], get3(wheel, AXLE, lane))
        v = seen_from(axes, velocity_of(body, wheel, arm, bogie, lane))
        sinkage = tyre[0] - (get(wheel, CENTER + 2, lane) - ground[0]) * axes[2][2]
        z = min(max(sinkage, SHALLOWEST), DEEPEST * tyre[0])
        on = 1.0 if sinkage > SHALLOWEST else 0.0
        slid = on if shear else 0.0
        soil = soil_below(wheel, lane)
        travel, lateral = (v[0] / rim, v[1] / rim) if shear else (1.0, 0.0)
        # Speed and rim of the same instant, the end of the step before; the rim may be faster now.
        last, lags = get(wheel, LAST, lane), shear and free > 0.0
        ended = v[0] / last if last >= SLOWEST else get(wheel, TRAVEL, lane)
        travel = ended if lags and turning < SLOWEST else travel
        taken, taken_up = get(wheel, SLIP, lane), min(last * time_step_s / TAKE_UP_M, 1.0)
        slip = taken + taken_up * (min(slip_ratio(ended), 1.0) - taken) if lags else min(slip_ratio(travel), 1.0)
        rut = (get(wheel, RUT, lane), get(wheel, RUT + 1, lane))
        forces, slopes, reach = contact_forces(z, slip, travel, lateral, ended if lags else travel, rut, tyre, soil, 0)
        f_n, f_dp, f_l, m_r = chosen(on, forces)
        slopes = chosen(on, slopes)
        ahead, below = shear_center(z, slip, tyre)
        stiffness = on * (soil[1] + 0.5) * max(f_n, 0.0) / z
        # A step must not ring on ground that is stiffer than it can follow.
        rate = max(calm, 0.5 * time_step_s * stiffness)
        damping = free * rate * v[2] * slid
        pressed = max(f_n - damping, 0.0) * on
        bearing = 1.0 if pressed > 0.0 else 0.0
        stiffness = on * (soil[1] + 0.5) * pressed / z
        per = slid / rim
        along, d_l, brake = steadied(v, rim, travel, slid, (f_dp, f_l), (slopes[1], slopes[2]))
        remaining = seen_from(axes, get3(wheel, ACCELERATION, lane))
        taken_for = get(wheel, DRAWBAR, lane) + get(wheel, ALONG, lane) * (v[0] - get(wheel, VELOCITY, lane))
        steady = lags and last >= SLOWEST and abs(turning - last) < STEADY * last
        put(wheel, MISSED, lane, abs(reach[3] - taken_for) if steady and on > 0.0 else 0.0)
        put_axes(wheel, lane, axes)
        put3(wheel, FORCE, lane, (
            slid * f_dp - kg * (gravity * axes[0][2] + remaining[0]),
            -slid * f_l - kg * (gravity * axes[1][2] + remaining[1]),
            pressed - kg * (gravity * axes[2][2] + remaining[2]),
        ))  # fmt: skip
        put3(wheel, MOMENT, lane, (-slid * below * f_l, -slid * m_r, -slid * ahead * f_l))
        held = 0.0 if lags else per * bearing * slopes[0]
        put3(wheel, ALONG, lane, (along, held, brake * abs(m_r) - per * slopes[3]))
        put3(wheel, ACROSS, lane, (d_l, below * d_l, ahead * d_l))
        put(wheel, STIFF, lane, time_step_s * slid * bearing * rate + 0.5 * time_step_s * time_step_s * stiffness)
        put(wheel, STIFF + 1, lane, free * time_step_s * time_step_s * stiffness * v[2])
        put(wheel, SINKAGE, lane, sinkage)
        put3(wheel, VELOCITY, lane, v)
        put(wheel, NORMAL, lane, pressed + damping * bearing)
        put3(wheel, DRAWBAR, lane, (slid * f_dp, slid * f_l, slid * m_r))
        put(wheel, SLIP, lane, slip)
        put(wheel, TRAVEL, lane, ended if lags else travel)
        put(wheel, LAST, lane, turning)


@pasted
def put_row(wheel: Any, levers: Any, lane: Any, i: Any, own: Any, turn: Any, kg: Any, time_step_s: Any) -> None:
    """Levers, coefficients and right side of coordinate i, whose rate moves the centre by `own`, turns it by `turn`."""
    along, across = get3(wheel, ALONG, lane), get3(wheel, ACROSS, lane)
    put3(levers, LEVER + 3 * i, lane, own)
    put3(
        levers,
        COEFFICIENT + 3 * i,
        lane,
        (
            kg * own[0] - time_step_s * (own[0] * along[0] + own[2] * along[1] + turn[1] * along[2]),
            kg * own[1] - time_step_s * (own[1] * across[0] + turn[0] * across[1] + turn[2] * across[2]),
            (kg + get(wheel, STIFF, lane)) * own[2],
        ),
    )
    work = dot(own, get3(wheel, FORCE, lane)) + dot(turn, get3(wheel, MOMENT, lane))
    put(levers, DRIVE + i, lane, time_step_s * work - own[2] * get(wheel, STIFF + 1, lane))


@in_lanes
def find_levers(body: Any, wheel: Any, levers: Any, hung: float, side: float, kg: float, time_step_s: float) -> None:
    """How each coordinate moves the wheel along the contact axes, and what its row of the matrix follows from."""
    for lane in range(LANES):
        e, d, n = get3(wheel, AXES, lane), get3(wheel, AXES + 3, lane), get3(wheel, AXES + 6, lane)
        arm, axes, still = get3(wheel, ARM, lane), (e, d, n), (0.0, 0.0, 0.0)
        upright = (get(body, ROTATION + 1, lane), get(body, ROTATION + 4, lane), get(body, ROTATION + 7, lane))
        turn, r_e, r_d, r_n = seen_from(axes, upright), cross(arm, e), cross(arm, d), cross(arm, n)
        x, y, z = (e[0], d[0], n[0]), (e[1], d[1], n[1]), (e[2], d[2], n[2])
        put_row(wheel, levers, lane, FIRST + 0, x, still, kg, time_step_s)
        put_row(wheel, levers, lane, FIRST + 1, y, still, kg, time_step_s)
        put_row(wheel, levers, lane, FIRST + 2, z, still, kg, time_step_s)
        put_row(wheel, levers, lane, FIRST + 3, (r_e[0], r_d[0], r_n[0]), x, kg, time_step_s)
        put_row(wheel, levers, lane, FIRST + 4, (r_e[1], r_d[1], r_n[1]), y, kg, time_step_s)
        put_row(wheel, levers, lane, FIRST + 5, (r_e[2], r_d[2], r_n[2]), z, kg, time_step_s)
        put_row(
            wheel,
            levers,
            lane,
            FIRST + 6,
            seen_from(axes, get3(wheel, SWING, lane)),
            times(turn, side),
            kg,
            time_step_s,
        )
        swing = seen_from(axes, get3(wheel, BOGIE_SWING, lane))
        put_row(wheel, levers, lane, FIRST + 7, swing, times(turn, hung), kg, time_step_s)


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
def add_wheel(work: Any, w: int, rover: Any, tyre: Any, time_step_s: float, mode: int) -> None:
    """Add wheel `w`, its mass and the soil's wrench, to the system of a step, and keep what the contact found.

    Parameters
    ----------
    work : with kinematics, ground and commands of the wheel in place.
    rover, tyre : `Rover.vector()`, `Wheel.vector()`.
    time_step_s : step. [s]
    mode : `DRIVEN`, where a rim that does not turn is held by static friction; `AT_REST` has the normal force and,
        along the surface, the force in the rows of `HOLD`; `HELD`, of rims that turn, has the forces of the motion, but
        the step does not take the rover along, so touch-down damping and the change of sinkage along the step are left
        out.
    """
    side, kg = w % 2, rover.wheel_kg
    wheel, system = work.wheels[w], work.sides[side]
    load = (rover.body_kg / len(rover.arms) + kg) / MASS_ON_WHEEL
    stands = mode == DRIVEN and any_stands(wheel)
    if stands:
        keep_hold(wheel)
    meet_ground(
        work.body, wheel, tyre, kg, rover.gravity, SPEED + 7 + side, time_step_s, mode != AT_REST,
        0.0 if mode == HELD else 1.0, load * NORMAL_DAMPING,
    )  # fmt: skip
    if stands:
        stand(wheel, tyre, time_step_s, load)
    if mode == AT_REST:
        lean(wheel, tyre)
    find_levers(work.body, wheel, work.levers, rover.hung[w], 1.0 - 2.0 * side, kg, time_step_s)
    add_rows(work.levers, system)
