"""The frame of a wheel on the ground, and a rim that stands on it."""

import math
from typing import Any

from lunarsci.compiled import compiled, in_lanes, pasted
from lunarsci.elementary import arcsin, cosine, sine
from lunarsci.regolith.forces import contact_forces
from lunarsci.twin.lanes import (
    ACROSS,
    ALONG,
    AXES,
    BOGIE_SWING,
    DRAWBAR,
    FORCE,
    HOLD,
    LANES,
    LAST,
    MOMENT,
    NORMAL,
    RATE,
    RIM,
    RUT,
    SINKAGE,
    SLIP,
    SOIL,
    SPEED,
    SWING,
    TWIST,
    VELOCITY,
    cross,
    dot,
    get,
    get3,
    plus,
    put,
    put3,
    times,
)

# The closed form has no meaning once the wheel is buried to its axle; beyond this share of r the force stays constant.
DEEPEST = 0.9
# Below this sinkage [m] the contact angles round to nothing.
SHALLOWEST = 1e-9
# Range of |s| that the source states for the model.
VALID_SLIP = 0.6
# Speeds [m/s] below this are none; a rim as slow as that stands still.
SLOWEST = 1e-9


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
def velocity_of(body: Any, wheel: Any, arm: Any, bogie: Any, lane: Any) -> Any:
    """Velocity of a wheel's centre in the world. [m/s]"""
    v = plus(get3(body, SPEED, lane), cross(get3(body, SPEED + 3, lane), arm))
    v = plus(v, times(get3(wheel, SWING, lane), get(body, SPEED + 6, lane)))
    return plus(v, times(get3(wheel, BOGIE_SWING, lane), get(body, bogie, lane)))


@pasted
def soil_below(wheel: Any, lane: Any) -> Any:
    """The soil under a wheel, as `Soil.vector()`."""
    return (
        get(wheel, SOIL, lane), get(wheel, SOIL + 1, lane), get(wheel, SOIL + 2, lane), get(wheel, SOIL + 3, lane),
        get(wheel, SOIL + 4, lane), get(wheel, SOIL + 5, lane), get(wheel, SOIL + 6, lane), get(wheel, SOIL + 7, lane),
    )  # fmt: skip


# Of the ground under a wheel that stands, along its surface [N/m, N s/m]: stiff, so that it gives by less than a
# millimetre before it yields, and about half of critical; for 22.5 kg on the wheel, and for another mass in proportion.
# Assumed: no unloading of regolith along the surface is published.
STAND_STIFFNESS, STAND_DAMPING = 1e5, 1500.0
# A wheel that yields comes to rest when it moves by less than this share of what the stiffness gives in a step.
CAUGHT = 0.01


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def any_stands(wheel: Any) -> bool:
    """Whether a rim of the group stands still."""
    slowest = abs(wheel[RIM * LANES])
    for lane in range(1, LANES):
        slowest = min(slowest, abs(wheel[RIM * LANES + lane]))
    return bool(slowest < SLOWEST)


@in_lanes
def keep_hold(wheel: Any) -> None:
    """Keep what the soil did to the wheel along its surface in the step before, as it stood in the world.

    A step that rolled ended with the force of its own end: what it began with, and the change by its derivatives.
    """
    for lane in range(LANES):
        e, d, v = get3(wheel, AXES, lane), get3(wheel, AXES + 3, lane), get3(wheel, VELOCITY, lane)
        f_dp, f_l, m_r = get3(wheel, DRAWBAR, lane)
        rolled = 1.0 if get(wheel, LAST, lane) >= SLOWEST else 0.0
        along, across = rolled * get(wheel, ALONG, lane), rolled * get(wheel, ACROSS, lane)
        torque = -rolled * get(wheel, ALONG + 2, lane)
        put3(wheel, HOLD, lane, plus(times(e, f_dp - along * v[0]), times(d, -f_l - across * v[1])))
        put3(wheel, TWIST, lane, times(d, m_r - torque * v[0]))
        put3(wheel, RATE, lane, (along, across, torque))


@pasted
def yielding(before: Any, speed: Any, low: Any, high: Any, time_step_s: Any, load: Any) -> Any:
    """Force that holds along one direction, and the viscous share of an implicit step. [N, N s/m]

    A spring that gives by the way of the last step, from `before`, within what the soil can hold: Cundall & Strack
    (1979), 10.1680/geot.1979.29.1.47. Beyond, the force stays and is taken to fall to 0 where the wheel stops.
    """
    step = load * STAND_STIFFNESS * time_step_s
    wanted = before - step * speed
    force = min(max(wanted, low), high)
    caught = abs(speed) * step < CAUGHT * (high - low)
    rate = load * STAND_DAMPING + step if force == wanted or caught else abs(force) / max(abs(speed), SLOWEST)
    return force, rate, (rate * speed if force == wanted or caught else 0.0)


@in_lanes
def stand(wheel: Any, tyre: Any, time_step_s: float, load: float) -> None:
    """What holds a wheel whose rim stands still: static friction, in the place of what `meet_ground` found.

    The force along the surface and the torque about the axle are those of the moment when the rim came to rest, and
    change as the wheel moves against the ground. They stay within the shear strength at the wheel's sinkage, and ahead
    the resistance of the ground that the wheel has piled up is added: the ends of the law of a wheel that rolls.
    """
    for lane in range(LANES):
        e, d, v = get3(wheel, AXES, lane), get3(wheel, AXES + 3, lane), get3(wheel, VELOCITY, lane)
        held, twist, rate = get3(wheel, HOLD, lane), get3(wheel, TWIST, lane), get3(wheel, RATE, lane)
        held_x, held_y = dot(held, e) + rate[0] * v[0], dot(held, d) + rate[1] * v[1]
        still = abs(get(wheel, RIM, lane)) < SLOWEST
        on = get(wheel, NORMAL, lane) > 0.0
        z = min(max(get(wheel, SINKAGE, lane), SHALLOWEST), DEEPEST * tyre[0])
        soil = soil_below(wheel, lane)
        slip, rut = get(wheel, SLIP, lane), (get(wheel, RUT, lane), get(wheel, RUT + 1, lane))
        _, _, reach = contact_forces(z, slip, 1.0, 0.0, 1.0, rut, tyre, soil, 0)
        ahead, below = shear_center(z, slip, tyre)
        shear, piled, side = (reach[0], reach[1], reach[2]) if on else (0.0, 0.0, 0.0)
        along = yielding(held_x, v[0], -shear - piled, max(shear - piled, 0.0), time_step_s, load)
        across = yielding(held_y, v[1], -side, side, time_step_s, load)
        torque = dot(twist, d) + rate[2] * v[0] + below * (along[0] - held_x) if on else 0.0
        old = get3(wheel, DRAWBAR, lane)
        put(wheel, FORCE, lane, get(wheel, FORCE, lane) + (along[0] - along[2] - old[0] if still else 0.0))
        put(wheel, FORCE + 1, lane, get(wheel, FORCE + 1, lane) + (across[0] - across[2] + old[1] if still else 0.0))
        moment, a, c = get3(wheel, MOMENT, lane), get3(wheel, ALONG, lane), get3(wheel, ACROSS, lane)
        put3(wheel, MOMENT, lane, (
            below * (across[0] - across[2]) if still else moment[0],
            below * along[2] - torque if still else moment[1],
            ahead * (across[0] - across[2]) if still else moment[2],
        ))  # fmt: skip
        put3(wheel, ALONG, lane, (
            -along[1] if still else a[0], 0.0 if still else a[1], below * along[1] if still else a[2],
        ))  # fmt: skip
        put3(wheel, ACROSS, lane, (
            -across[1] if still else c[0], -below * across[1] if still else c[1],
            -ahead * across[1] if still else c[2],
        ))  # fmt: skip
        put3(wheel, DRAWBAR, lane, (
            along[0] if still else old[0], -across[0] if still else old[1], torque if still else old[2],
        ))  # fmt: skip


@in_lanes
def lean(wheel: Any, tyre: Any) -> None:
    """Put the force of `HOLD`, as far as it lies along the surface, on a wheel that rests."""
    for lane in range(LANES):
        e, d, held = get3(wheel, AXES, lane), get3(wheel, AXES + 3, lane), get3(wheel, HOLD, lane)
        z = min(max(get(wheel, SINKAGE, lane), SHALLOWEST), DEEPEST * tyre[0])
        ahead, below = shear_center(z, 0.0, tyre)
        x, y = dot(held, e), dot(held, d)
        put(wheel, FORCE, lane, get(wheel, FORCE, lane) + x)
        put(wheel, FORCE + 1, lane, get(wheel, FORCE + 1, lane) + y)
        put3(wheel, MOMENT, lane, (below * y, -below * x, ahead * y))
        put3(wheel, DRAWBAR, lane, (x, -y, below * x))
