"""Where a wheel meets the terrain, the wrench of the soil on it, and its part in the equations of a step.

The interaction plane is the terrain's tangent plane below the wheel centre. The wheel rolls along the line in which
its own plane cuts the interaction plane; lateral and normal complete the contact frame.

F_DP and F_N act at the wheel centre and M_R about the lateral axis, as in Eqs 21-24 of Ding et al. (2024),
10.1038/s41467-024-46233-8; about the axle itself, 10 m over a bump of 8 cm would end 8 mm off.
F_L acts where the shear stress is centred, r_s below and ahead of the axle, which gives the overturning and steering
torques M_O and M_S their leading parts.
"""

from typing import Any

from lunarsci.compiled import compiled, joined
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, highest, lowest
from lunarsci.regolith.forces import contact_forces, slip_ratio
from lunarsci.twin.lanes import BODY, GROUP, SANK, SYSTEM, WHEEL, cross, dot, plus, seen_from, times
from lunarsci.twin.simulation.contact_frame import (
    SHALLOWEST,
    SLOWEST,
    contact_frame,
    keep_hold,
    lean,
    own_tyre,
    pressed_depth,
    shear_center,
    stand,
)

# Assumed, for a calm touch-down: half of critical for this mass on a wheel [kg] on 7 kN/m, and for another in
# proportion; the soil's own is not published. [N s/m]
NORMAL_DAMPING, MASS_ON_WHEEL = 400.0, 22.5
AT_REST, DRIVEN, HELD = 0, 1, 2
# Travel over which the bearing takes up a change of slip [m]: at a creep it does not follow at once. Assumed, short
# against the contact, so that a step under way passes it.
TAKE_UP_M = 1e-3
STEADY = 0.02
"""A rim whose speed changes by less than this share in a step is under way; assumed."""


def steadied(v: Any, rim: Any, travel: Any, slid: Any, forces: Any, slopes: Any) -> Any:
    """Derivatives of the forces ahead and to the left by the velocity there, and the share that stops the slip.

    A step must not pass the speed at which nothing slips: from far away the force is taken to fall to 0 there.
    """
    brake = lowest(slid, highest(0.0, 10.0 * abs(slip_ratio(travel)) - 2.0)) / highest(SLOWEST, abs(rim - v[0]))
    sliding = 10.0 * abs(v[1]) / highest(rim, abs(v[0])) - 3.0
    skew = lowest(slid, highest(0.0, sliding)) / highest(SLOWEST, abs(v[1]))
    per = slid / rim
    return per * slopes[0] - brake * abs(forces[0]), -per * slopes[1] - skew * abs(forces[1]), brake


def motion_of(body: Any, wheel: Any, axes: Any, side: Any) -> Any:
    """Velocity of a wheel's centre along the axes of its contact. [m/s]"""
    v = plus(body.speed, cross(body.spin, wheel.arm), times(wheel.swing, body.rates[0]))
    return seen_from(axes, plus(v, times(wheel.bogie_swing, choose(side > 0.0, body.rates[1], body.rates[2]))))


def slipping(wheel: Any, v: Any, time_step_s: Any, shear: Any, driven: Any) -> Any:
    """Ratios of travel, that of the shear stress that helps to carry, of lateral motion, and the slip of the bearing.

    Below a rim that stands still the stress along the wheel stays as it was.
    """
    rim = highest(SLOWEST, abs(wheel.rim))
    # Speed and rim of the same instant, the end of the step before; the rim may be faster now.
    ended = choose(wheel.last >= SLOWEST, v[0] / wheel.last, wheel.travel)
    travel = choose(driven & (abs(wheel.rim) < SLOWEST), ended, choose(shear, v[0] / rim, 1.0))
    taken_up = lowest(1.0, wheel.last * time_step_s / TAKE_UP_M)
    lagging = wheel.slip + taken_up * (lowest(1.0, slip_ratio(ended)) - wheel.slip)
    slip = choose(driven, lagging, lowest(1.0, slip_ratio(travel)))
    return travel, choose(driven, ended, travel), choose(shear, v[1] / rim, 0.0), slip


@formula
def meet_ground(
    work: Any, w: Any, tyre: Any, rover: Any, side: Any, time_step_s: Any, mode: Any, calm: Any, lane: Any
) -> None:
    """Contact frame, motion, wrench and its derivatives of one wheel that rolls.

    The derivatives only steady the implicit step: those of the shear, and the stiffness of F_N ~ z^(n0 + 1/2). The
    normal force never pulls. Below a rim that stands still `stand` then puts in what holds it. `calm` is the damping of
    a touch-down. [N s/m]
    """
    body, wheel, kg = BODY.of(work.body, lane), WHEEL.of(work.wheels, w, lane), rover.wheel_kg
    tyre = own_tyre(tyre, wheel)
    driven, shear, free = mode == DRIVEN, mode != AT_REST, choose(mode == HELD, 0.0, 1.0)
    turning, ground, soil, last = abs(wheel.rim), wheel.ground, wheel.soil, wheel.last
    rim = highest(SLOWEST, turning)
    axes = contact_frame(ground[1], ground[2], wheel.axle)
    v = motion_of(body, wheel, axes, side)
    sinkage = tyre[0] - (wheel.center[2] - ground[0]) * axes[2][2]
    z, touches = pressed_depth(sinkage, tyre), sinkage > SHALLOWEST
    on = choose(touches, 1.0, 0.0)
    slid = choose(shear, on, 0.0)
    travel, before, lateral, slip = slipping(wheel, v, time_step_s, shear, driven)
    forces, slopes, reach = contact_forces(z, slip, travel, lateral, before, wheel.rut, tyre, soil, 0)
    # In the air those of an absurd soil may be no numbers.
    f_n, f_dp, f_l, m_r = (choose(touches, force, 0.0) for force in forces)
    slopes = tuple(choose(touches, slope, 0.0) for slope in slopes)
    ahead, below = shear_center(z, slip, tyre)
    # A step must not ring on ground that is stiffer than it can follow.
    rate = highest(0.5 * time_step_s * (on * (soil[1] + 0.5) * highest(0.0, f_n) / z), calm)
    damping = free * rate * v[2] * slid
    pressed = highest(0.0, f_n - damping) * on
    bearing = choose(pressed > 0.0, 1.0, 0.0)
    stiffness = on * (soil[1] + 0.5) * pressed / z
    per = slid / rim
    along, d_l, brake = steadied(v, rim, travel, slid, (f_dp, f_l), (slopes[1], slopes[2]))
    taken_for = wheel.drawbar + wheel.by_forward[0] * (v[0] - wheel.velocity[0])
    steady = driven & (last >= SLOWEST) & (abs(turning - last) < STEADY * last) & touches
    wheel.missed = choose(steady, abs(reach[3] - taken_for), 0.0)
    wheel.forward, wheel.across, wheel.upward = axes
    inertia = times(seen_from(axes, plus(wheel.acceleration, (0.0, 0.0, rover.gravity))), -kg)
    wheel.force = plus((slid * f_dp, -slid * f_l, pressed), inertia)
    wheel.moment = (-slid * below * f_l, -slid * m_r, -slid * ahead * f_l)
    held = choose(driven, 0.0, per * bearing * slopes[0])
    wheel.by_forward = (along, held, brake * abs(m_r) - per * slopes[3])
    wheel.by_across = (d_l, below * d_l, ahead * d_l)
    wheel.stiff = (
        time_step_s * slid * bearing * rate + 0.5 * time_step_s * time_step_s * stiffness,
        free * time_step_s * time_step_s * stiffness * v[2],
    )
    wheel.sinkage, wheel.velocity, wheel.normal = sinkage, v, pressed + damping * bearing
    wheel.drawbar, wheel.side, wheel.resistance = slid * f_dp, slid * f_l, slid * m_r
    wheel.slip, wheel.travel, wheel.last = slip, before, turning
    body.outcome = choose(sinkage + wheel.rut[1] > tyre[0], SANK, body.outcome)


@formula
def add_rows(work: Any, w: Any, own_side: Any, rover: Any, side: Any, time_step_s: Any, lane: Any) -> None:
    """Add a wheel, its mass and the soil's wrench, to its side of the system.

    A coordinate whose rate moves the wheel's centre by `own` along the contact axes, and turns it by `turn`, has a row
    of coefficients by which it meets the others' levers.
    """
    body, wheel, kg, hung = BODY.of(work.body, lane), WHEEL.of(work.wheels, w, lane), rover.wheel_kg, rover.hung[w]
    axes = (wheel.forward, wheel.across, wheel.upward)
    still, arms = (0.0, 0.0, 0.0), [cross(wheel.arm, axis) for axis in axes]
    turn = seen_from(axes, (body.x_row[1], body.y_row[1], body.z_row[1]))
    moves = list(zip(*axes, strict=True)) + list(zip(*arms, strict=True))
    moves += [seen_from(axes, wheel.swing), seen_from(axes, wheel.bogie_swing)]
    turns = [still] * 3 + list(zip(*axes, strict=True)) + [times(turn, side), times(turn, hung)]
    system = SYSTEM.of(work.sides, own_side, lane)
    matrix, right = list(system.matrix), list(system.right)
    along, across = wheel.by_forward, wheel.by_across
    for i, (own, turned) in enumerate(zip(moves, turns, strict=True)):
        row = (
            kg * own[0] - time_step_s * (own[0] * along[0] + own[2] * along[1] + turned[1] * along[2]),
            kg * own[1] - time_step_s * (own[1] * across[0] + turned[0] * across[1] + turned[2] * across[2]),
            (kg + wheel.stiff[0]) * own[2],
        )
        for j, other in enumerate(moves):
            matrix[8 * i + j] = matrix[8 * i + j] + dot(row, other)
        work_done = dot(own, wheel.force) + dot(turned, wheel.moment)
        right[i] = right[i] + (time_step_s * work_done - own[2] * wheel.stiff[1])
    system.matrix, system.right = tuple(matrix), tuple(right)


RIM = WHEEL.first["rim"] * GROUP


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def any_stands(wheels: Any, w: int) -> bool:
    """Whether a rim of the group stands still."""
    slowest = abs(wheels[w, RIM])
    for lane in range(1, GROUP):
        slowest = min(slowest, abs(wheels[w, RIM + lane]))
    return bool(slowest < SLOWEST)


@joined
def add_wheel(work: Any, w: int, rover: Any, tyre: Any, time_step_s: float, mode: int) -> None:
    """Add wheel `w`, its mass and the soil's wrench, to the system of a step, and keep what the contact found.

    Parameters
    ----------
    work : with kinematics, ground and commands of the wheel in place.
    rover, tyre : `Rover.vector()`, `Wheel.vector()`.
    time_step_s : step. [s]
    mode : `DRIVEN`, where a rim that does not turn is held by static friction; `AT_REST` has the normal force and,
        along the surface, the force of `hold`; `HELD`, of rims that turn, has the forces of the motion, but the step
        does not take the rover along, so touch-down damping and the change of sinkage along the step are left out.
    """
    side = 1.0 - 2.0 * (w % 2)
    load = (rover.body_kg / len(rover.arms) + rover.wheel_kg) / MASS_ON_WHEEL
    stands = mode == DRIVEN and any_stands(work.wheels, w)
    for lane in range(0, GROUP, LANES):
        if stands:
            keep_hold(work.wheels, w, lane)
        meet_ground(work, w, tyre, rover, side, time_step_s, mode, load * NORMAL_DAMPING, lane)
        if stands:
            stand(work.wheels, w, tyre, time_step_s, load, lane)
        if mode == AT_REST:
            lean(work.wheels, w, tyre, lane)
        add_rows(work, w, w % 2, rover, side, time_step_s, lane)
