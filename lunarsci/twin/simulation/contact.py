"""Where a wheel meets the terrain, the wrench of the soil on it, and its part in the equations of a step.

The interaction plane is the terrain's tangent plane below the wheel centre. The wheel rolls along the line in which
its own plane cuts the interaction plane; lateral and normal complete the contact frame.

F_DP and F_N act at the wheel centre and M_R about the lateral axis, as in Eqs 21-24 of Ding et al. (2024),
10.1038/s41467-024-46233-8; about the axle itself, 10 m over a bump of 8 cm would end 8 mm off.
F_L acts where the shear stress is centred, r_s below and ahead of the axle, which gives the overturning and steering
torques M_O and M_S their leading parts.

The frame of a wheel on the ground, and a rim that stands on it.

The ground that wheels leave behind, and what the next wheel meets in it, for a group of rovers.

Every rover presses its own ruts into a grid of nodes: how deep below the undisturbed ground a wheel has been. When the
wheel has gone the soil springs back, and a wheel that follows loads it again along a line that meets the first loading
where that ended (Wong 2008, Theory of Ground Vehicles, 4th ed., ch. 2):

    p = p_u - (k_0 + A_u z_u) (z_u - z),   k_0 = p_u / z_u.

A rut changes height and bearing of the ground, not its shear strength. Beside a track a wheel meets the share of it
that both widths have in common, so that one that is partly on the wall is carried partly by the undisturbed ground.
That the wall also pushes against the side of a wheel is left out.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled, joined
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import arcsin, choose, cosine, exponential, highest, logarithm, lowest, root, sine
from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import contact_forces, slip_ratio
from lunarsci.twin.lanes import BODY, FINISHED, GROUP, SANK, SYSTEM, WHEEL, Work, cross, dot, plus, seen_from, times

DEEPEST = 0.9
"""The closed form has no meaning once the wheel is buried to its axle; beyond this share of r the force stays constant:
assumed."""
SHALLOWEST = 1e-9
"""Below this sinkage the contact angles round to nothing. [m]"""
VALID_SLIP = 0.6
"""Range of the slip ratio, to either side: see `MAX_VALID_SLIP`."""
SLOWEST = 1e-9
"""Speeds below this are none; a rim as slow as that stands still. [m/s]"""
STAND_STIFFNESS, STAND_DAMPING = 1e5, 1500.0
"""Of the ground under a wheel that stands, along its surface [N/m, N s/m]: stiff, so that it gives by less than a
millimetre before it yields, and about half of critical; for 22.5 kg on the wheel, and for another mass in proportion.
Assumed: no unloading of regolith along the surface is published."""
CAUGHT = 0.01
"""A wheel that yields comes to rest when it moves by less than this share of what the stiffness gives in a step."""
RISE_N_M4 = 503e6
"""A_u of a dry sand (LETE sand, Wong 2008, table 2.4, not checked against the book), assumed for regolith, of which
none is published. [N m^-4]"""
SPACING_M = 0.0353
"""Of the nodes: a quarter of a wheel's width, and no whole part of anything on a rover. Measured: half of it moves the
end of the embedded plan by 0.5 mm. [m]"""
BEHIND = 2.0 + 1.0
"""How far behind the axle a rut is left, in spacings: its strip reaches 2 ahead, and a wheel meets nodes 1 off."""
MOST_NODES = 2e7
"""Of one rover's grid; memory is taken only where a wheel rolls."""
AXLE, CENTER, GROUND, RIM, RUT, SINKAGE, SOIL = (
    WHEEL.first[name] for name in ("axle", "center", "ground", "rim", "rut", "sinkage", "soil")
)
"""Rows of a wheel in `Work.wheels`: the number of one lane in row k lies at k * GROUP + lane."""
NORMAL_DAMPING, MASS_ON_WHEEL = 400.0, 22.5
"""Assumed, for a calm touch-down: half of critical for this mass on a wheel on 7 kN/m, and for another in proportion;
the soil's own is not published. [N s/m, kg]"""
AT_REST, DRIVEN, HELD = 0, 1, 2
"""Modes of `find_contact`: a rover at rest, one that drives, and one that is held to a motion."""
TAKE_UP_M = 1e-3
"""Travel over which the bearing takes up a change of slip: at a creep it does not follow at once. Assumed, short
against the contact, so that a step under way passes it. [m]"""
STEADY = 0.02
"""A rim whose speed changes by less than this share in a step is under way; assumed."""
RIM_ROW = WHEEL.first["rim"] * GROUP
"""Where the speeds of the rims begin in a wheel's array."""


def contact_frame(slope_x: Any, slope_y: Any, axle: Any) -> Any:
    """Forward, left and normal axis of the contact frame, from the terrain's gradient and the wheel's axle. [-]"""
    scale = 1.0 / root(1.0 + slope_x * slope_x + slope_y * slope_y)
    normal = (-slope_x * scale, -slope_y * scale, scale)
    x = cross(axle, normal)
    forward = times(x, 1.0 / (root(dot(x, x)) + 1e-300))
    return forward, cross(normal, forward), normal


def lane_tyre(tyre: Any, wheel: Any) -> Any:
    """`Wheel.vector()` with what the wheel of each rover has for itself: r_s, c1, c2 and c3."""
    return (*tyre[:3], *wheel.tread[:4])


def shear_center(sinkage: Any, slip: Any, tyre: Any) -> Any:
    """How far ahead of and below the axle the shear stress is centred, at a sinkage [m] and slip ratio. [m]"""
    r, _, _, r_s, c1, c2, c3 = tyre
    theta_1 = 2.0 * arcsin(root(sinkage / (2.0 * r)))
    middle = (1.0 + c3 + c1 + c2 * slip) * theta_1 / 3.0
    return r_s * sine(middle), r_s * cosine(middle)


def pressed_depth(sinkage: Any, tyre: Any) -> Any:
    """Sinkage within what the forces know: from `SHALLOWEST` to `DEEPEST`. [m]"""
    return lowest(DEEPEST * tyre[0], highest(SHALLOWEST, sinkage))


@formula
def keep_hold(wheels: Any, w: Any, lane: Any) -> None:
    """Keep what the soil did to the wheel along its surface in the step before, as it stood in the world.

    A step that rolled ended with the force of its own end: what it began with, and the change by its derivatives.
    """
    wheel = WHEEL.of(wheels, w, lane)
    e, d, v = wheel.forward, wheel.across, wheel.velocity
    rolled = choose(wheel.last >= SLOWEST, 1.0, 0.0)
    along, across = rolled * wheel.by_forward[0], rolled * wheel.by_across[0]
    torque = -rolled * wheel.by_forward[2]
    wheel.hold = plus(times(e, wheel.drawbar - along * v[0]), times(d, -wheel.side - across * v[1]))
    wheel.twist = times(d, wheel.resistance - torque * v[0])
    wheel.rate = (along, across, torque)


def yielding(before: Any, speed: Any, low: Any, high: Any, time_step_s: Any, load: Any) -> Any:
    """Force that holds along one direction, and the viscous share of an implicit step. [N, N s/m]

    A spring that gives by the way of the last step, from `before`, within what the soil can hold: Cundall & Strack
    (1979), 10.1680/geot.1979.29.1.47. Beyond, the force stays and is taken to fall to 0 where the wheel stops.
    """
    step = load * STAND_STIFFNESS * time_step_s
    wanted = before - step * speed
    force = lowest(high, highest(low, wanted))
    holds = (force == wanted) | (abs(speed) * step < CAUGHT * (high - low))
    rate = choose(holds, load * STAND_DAMPING + step, abs(force) / highest(SLOWEST, abs(speed)))
    return force, rate, choose(holds, rate * speed, 0.0)


@formula
def stand(wheels: Any, w: Any, tyre: Any, time_step_s: Any, load: Any, lane: Any) -> None:
    """What holds a wheel whose rim stands still: static friction, in the place of what `meet_ground` found.

    The force along the surface and the torque about the axle are those of the moment when the rim came to rest, and
    change as the wheel moves against the ground. They stay within the shear strength at the wheel's sinkage, and ahead
    the resistance of the ground that the wheel has piled up is added: the ends of the law of a wheel that rolls.
    """
    wheel = WHEEL.of(wheels, w, lane)
    tyre = lane_tyre(tyre, wheel)
    d, v, rate = wheel.across, wheel.velocity, wheel.rate
    held_x, held_y = dot(wheel.hold, wheel.forward) + rate[0] * v[0], dot(wheel.hold, d) + rate[1] * v[1]
    still, on = abs(wheel.rim) < SLOWEST, wheel.normal > 0.0
    z = pressed_depth(wheel.sinkage, tyre)
    _, _, reach = contact_forces(z, wheel.slip, 1.0, 0.0, 1.0, wheel.rut, tyre, wheel.soil, 0)
    ahead, below = shear_center(z, wheel.slip, tyre)
    shear, piled, side = (choose(on, part, 0.0) for part in reach[:3])
    along = yielding(held_x, v[0], -shear - piled, highest(0.0, shear - piled), time_step_s, load)
    across = yielding(held_y, v[1], -side, side, time_step_s, load)
    torque = choose(on, dot(wheel.twist, d) + rate[2] * v[0] + below * (along[0] - held_x), 0.0)
    force = (
        wheel.force[0] + (along[0] - along[2] - wheel.drawbar),
        wheel.force[1] + (across[0] - across[2] + wheel.side),
        wheel.force[2],
    )
    push = across[0] - across[2]
    standing = {
        "force": force,
        "moment": (below * push, below * along[2] - torque, ahead * push),
        "by_forward": (-along[1], 0.0, below * along[1]),
        "by_across": (-across[1], -below * across[1], -ahead * across[1]),
        "drawbar": along[0],
        "side": -across[0],
        "resistance": torque,
    }
    for name, values in standing.items():
        old = getattr(wheel, name)
        one = not isinstance(values, tuple)
        new = choose(still, values, old) if one else tuple(map(choose, (still,) * 3, values, old))
        setattr(wheel, name, new)


@formula
def lean(wheels: Any, w: Any, tyre: Any, lane: Any) -> None:
    """Put the force of `hold`, as far as it lies along the surface, on a wheel that rests."""
    wheel = WHEEL.of(wheels, w, lane)
    ahead, below = shear_center(pressed_depth(wheel.sinkage, tyre), 0.0, lane_tyre(tyre, wheel))
    x, y = dot(wheel.hold, wheel.forward), dot(wheel.hold, wheel.across)
    wheel.force = plus(wheel.force, (x, y, 0.0))
    wheel.moment = (below * y, -below * x, ahead * y)
    wheel.drawbar, wheel.side, wheel.resistance = x, -y, below * x


class RutGrid(NamedTuple):
    """Where ruts are kept: how many nodes (rows, columns), and `Work.frame` (7,)."""

    shape: tuple[int, int]
    frame: FloatArray


def rut_grid(start: FloatArray, places: FloatArray, margin_m: float) -> RutGrid:
    """The nodes about a way.

    Parameters
    ----------
    start : x, y, heading, along which the grid lies. (3,) [m, m, rad]
    places : x, y that the rover's origin is to pass. (n, 2) [m]
    margin_m : how far from these it is covered; beyond there are no ruts. [m]

    Raises ParameterError for more than 20 million nodes.
    """
    c, s = math.cos(start[2]), math.sin(start[2])
    off = places - start[:2]
    along, aside = c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0]
    # Alike on both sides of the start, so that a mirrored drive has mirrored nodes.
    wide = math.ceil((float(np.abs(aside).max()) + margin_m) / SPACING_M)
    back = math.ceil((margin_m - float(along.min())) / SPACING_M)
    ahead = math.ceil((margin_m + float(along.max())) / SPACING_M)
    shape = (2 * wide + 1, back + ahead + 1)
    if shape[0] * shape[1] > MOST_NODES:
        raise ParameterError("the plan is too long for ruts; leave them out, or drive it in parts")
    return RutGrid(shape, np.array([start[0], start[1], c / SPACING_M, s / SPACING_M, back, wide, 1.0]))


def with_ruts(work: Work, grid: RutGrid) -> Work:
    """`work` with undisturbed ground for ruts."""
    return work._replace(ruts=np.zeros((GROUP, *grid.shape, 2)), frame=grid.frame.copy())


@compiled
def depth_at(ruts: Any, lane: int, column: float, row: float) -> tuple[float, float]:
    """How deep the ground was pressed at a place between nodes, and how deep it is still; 0 beyond them. [m]

    `ruts` is `Work.ruts`, the place in its columns and rows.
    """
    ny, nx = ruts.shape[1], ruts.shape[2]
    if not (0.0 <= column < nx - 1 and 0.0 <= row < ny - 1):
        return 0.0, 0.0
    j, i = int(column), int(row)
    a, b = column - j, row - i
    w_0, w_1, w_2, w_3 = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    k, m = i + 1, j + 1
    return (
        w_0 * ruts[lane, i, j, 0] + w_1 * ruts[lane, i, m, 0] + w_2 * ruts[lane, k, j, 0] + w_3 * ruts[lane, k, m, 0],
        w_0 * ruts[lane, i, j, 1] + w_1 * ruts[lane, i, m, 1] + w_2 * ruts[lane, k, j, 1] + w_3 * ruts[lane, k, m, 1],
    )


@compiled
def still_deep(pressed: float, stiffness: float, exponent: float) -> float:
    """Depth of a rut when the wheel has gone, of how deep it was `pressed`, on soil of that K_s and n0. [m]"""
    if not pressed > SHALLOWEST:
        return 0.0
    load = stiffness * exponential(exponent * logarithm(pressed))
    return float(pressed - pressed * load / (load + RISE_N_M4 * pressed * pressed))


@compiled
def read_ruts(work: Any, w: int) -> None:
    """Lower the ground of wheel `w` by what is left of the ruts below it, looked up anew where `frame` says so."""
    frame, wheel = work.frame, work.wheels[w]
    for lane in range(GROUP):
        if work.code[lane] != FINISHED:
            continue
        if frame[6] > 0.0:
            x, y = wheel[CENTER * GROUP + lane] - frame[0], wheel[(CENTER + 1) * GROUP + lane] - frame[1]
            column, row = frame[2] * x + frame[3] * y + frame[4], frame[2] * y - frame[3] * x + frame[5]
            depths = depth_at(work.ruts, lane, column, row)
            wheel[RUT * GROUP + lane], wheel[(RUT + 1) * GROUP + lane] = depths
        left = wheel[(RUT + 1) * GROUP + lane]
        if left > 0.0:
            slope_x, slope_y = wheel[(GROUND + 1) * GROUP + lane], wheel[(GROUND + 2) * GROUP + lane]
            # Sinkage counts along the normal.
            wheel[GROUND * GROUP + lane] -= left * math.sqrt(1.0 + slope_x**2 + slope_y**2)


@compiled
def press_ruts(work: Any, width: float) -> None:
    """Leave the ruts of all wheels that roll, as wide [m], two spacings long, with ends that run out over another."""
    frame = work.frame
    wide = width * math.sqrt(frame[2] ** 2 + frame[3] ** 2)
    for w in range(len(work.wheels)):
        wheel = work.wheels[w]
        for lane in range(GROUP):
            sinkage = wheel[SINKAGE * GROUP + lane]
            if work.code[lane] != FINISHED or not sinkage > 0.0 or wheel[RIM * GROUP + lane] == 0.0:
                continue
            axle_x, axle_y = wheel[AXLE * GROUP + lane], wheel[(AXLE + 1) * GROUP + lane]
            across, up = frame[2] * axle_x + frame[3] * axle_y, frame[2] * axle_y - frame[3] * axle_x
            scale = 1.0 / math.sqrt(across * across + up * up + 1e-300)
            across, up = scale * across, scale * up
            x, y = wheel[CENTER * GROUP + lane] - frame[0], wheel[(CENTER + 1) * GROUP + lane] - frame[1]
            # Ahead is a quarter turn from the axle to the right.
            column = frame[2] * x + frame[3] * y + frame[4] - BEHIND * up
            row = frame[2] * y - frame[3] * x + frame[5] + BEHIND * across
            depth = sinkage + wheel[(RUT + 1) * GROUP + lane]
            still = still_deep(depth, wheel[SOIL * GROUP + lane], wheel[(SOIL + 1) * GROUP + lane])
            press(work.ruts, lane, column, row, across, up, wide, depth, still)


@compiled
def press(
    ruts: Any, lane: int, column: float, row: float, across: float, up: float, wide: float, depth: float, still: float
) -> None:
    """Press a strip about a place, in spacings: for a wheel as `wide` along (across, up), 1 ahead and behind.

    To the side the share falls to 0 where a wheel of that width has nothing in common with it. Where it becomes
    deepest, `depth` is how deep it is pressed, and `still` how deep it stays. [m]
    """
    ny, nx = ruts.shape[1], ruts.shape[2]
    reach_x, reach_y = wide * abs(across) + 2.0 * abs(up), wide * abs(up) + 2.0 * abs(across)
    for i in range(max(0, math.ceil(row - reach_y)), min(ny - 1, math.floor(row + reach_y)) + 1):
        for j in range(max(0, math.ceil(column - reach_x)), min(nx - 1, math.floor(column + reach_x)) + 1):
            a, b = j - column, i - row
            out = min(1.0 - abs(a * across + b * up) / wide, 2.0 - abs(a * up - b * across), 1.0)
            if out * depth > ruts[lane, i, j, 0]:
                ruts[lane, i, j, 0], ruts[lane, i, j, 1] = out * depth, out * still


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
    tyre = lane_tyre(tyre, wheel)
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


def moves_of(work: Any, w: Any, rover: Any, side: Any, lane: Any) -> Any:
    """How each of the eight coordinates moves a wheel's centre, and turns it, along its contact axes."""
    body, wheel, hung = BODY.of(work.body, lane), WHEEL.of(work.wheels, w, lane), rover.hung[w]
    axes = (wheel.forward, wheel.across, wheel.upward)
    still, arms = (0.0, 0.0, 0.0), [cross(wheel.arm, axis) for axis in axes]
    turn = seen_from(axes, (body.x_row[1], body.y_row[1], body.z_row[1]))
    moves = list(zip(*axes, strict=True)) + list(zip(*arms, strict=True))
    moves += [seen_from(axes, wheel.swing), seen_from(axes, wheel.bogie_swing)]
    return wheel, moves, [still] * 3 + list(zip(*axes, strict=True)) + [times(turn, side), times(turn, hung)]


@formula
def add_rows(work: Any, w: Any, count: Any, rover: Any, side: Any, time_step_s: Any, lane: Any) -> None:
    """Add wheels of a side, their masses and the soil's wrenches, to its part of the system.

    `w` is the first of them, 0 or 1, and `count` how many there are, plain numbers; `side` is 1 on the left. A
    coordinate whose rate moves a wheel's centre by `moved` along the contact axes, and turns it by `turned`, has a row
    of coefficients by which it meets the others' levers.
    """
    kg, number = rover.wheel_kg, w % 2
    system = SYSTEM.of(work.sides, number, lane)
    wheels = [moves_of(work, w + 2 * k, rover, side, lane) for k in range(count)]
    matrix, right = list(system.matrix), list(system.right)
    for i in range(8):
        for wheel, moves, turns in wheels:
            along, across, moved, turned = wheel.by_forward, wheel.by_across, moves[i], turns[i]
            row = (
                kg * moved[0] - time_step_s * (moved[0] * along[0] + moved[2] * along[1] + turned[1] * along[2]),
                kg * moved[1] - time_step_s * (moved[1] * across[0] + turned[0] * across[1] + turned[2] * across[2]),
                (kg + wheel.stiff[0]) * moved[2],
            )
            for j, other in enumerate(moves):
                matrix[8 * i + j] = matrix[8 * i + j] + dot(row, other)
            work_done = dot(moved, wheel.force) + dot(turned, wheel.moment)
            right[i] = right[i] + (time_step_s * work_done - moved[2] * wheel.stiff[1])
    system.matrix, system.right = tuple(matrix), tuple(right)


@compiled
def any_stands(wheels: Any, w: int) -> bool:
    """Whether a rim of the group stands still."""
    slowest = abs(wheels[w, RIM_ROW])
    for lane in range(1, GROUP):
        slowest = min(slowest, abs(wheels[w, RIM_ROW + lane]))
    return bool(slowest < SLOWEST)


@joined
def find_contact(work: Any, w: int, rover: Any, tyre: Any, time_step_s: float, mode: int) -> None:
    """Keep what the contact of wheel `w` finds.

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
