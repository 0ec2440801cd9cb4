"""The frame of a wheel on the ground, and a rim that stands on it."""

from typing import Any

from lunarsci.compiled.formulas import formula
from lunarsci.compiled.lanes import arcsin, choose, cosine, highest, lowest, root, sine
from lunarsci.regolith.forces import contact_forces
from lunarsci.twin.lanes import WHEEL, cross, dot, plus, times

DEEPEST = 0.9
"""The closed form has no meaning once the wheel is buried to its axle; beyond this share of r the force stays constant:
assumed."""
# Below this sinkage [m] the contact angles round to nothing.
SHALLOWEST = 1e-9
VALID_SLIP = 0.6
"""Range of the slip ratio, to either side: see `MAX_VALID_SLIP`."""
# Speeds [m/s] below this are none; a rim as slow as that stands still.
SLOWEST = 1e-9


def contact_frame(slope_x: Any, slope_y: Any, axle: Any) -> Any:
    """Forward, left and normal axis of the contact frame, from the terrain's gradient and the wheel's axle. [-]"""
    scale = 1.0 / root(1.0 + slope_x * slope_x + slope_y * slope_y)
    normal = (-slope_x * scale, -slope_y * scale, scale)
    x = cross(axle, normal)
    forward = times(x, 1.0 / (root(dot(x, x)) + 1e-300))
    return forward, cross(normal, forward), normal


def own_tyre(tyre: Any, wheel: Any) -> Any:
    """`Wheel.vector()` with what the wheel of each rover has for itself."""
    return (*tyre[:3], *wheel.tread[:4])


def shear_center(sinkage: Any, slip: Any, tyre: Any) -> Any:
    """How far ahead of and below the axle the shear stress is centred. [m]"""
    r, _, _, r_s, c1, c2, c3 = tyre
    theta_1 = 2.0 * arcsin(root(sinkage / (2.0 * r)))
    middle = (1.0 + c3 + c1 + c2 * slip) * theta_1 / 3.0
    return r_s * sine(middle), r_s * cosine(middle)


def pressed_depth(sinkage: Any, tyre: Any) -> Any:
    """Sinkage within what the forces know. [m]"""
    return lowest(DEEPEST * tyre[0], highest(SHALLOWEST, sinkage))


# Of the ground under a wheel that stands, along its surface [N/m, N s/m]: stiff, so that it gives by less than a
# millimetre before it yields, and about half of critical; for 22.5 kg on the wheel, and for another mass in proportion.
# Assumed: no unloading of regolith along the surface is published.
STAND_STIFFNESS, STAND_DAMPING = 1e5, 1500.0
# A wheel that yields comes to rest when it moves by less than this share of what the stiffness gives in a step.
CAUGHT = 0.01


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
    tyre = own_tyre(tyre, wheel)
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
    found = {
        "force": force,
        "moment": (below * push, below * along[2] - torque, ahead * push),
        "by_forward": (-along[1], 0.0, below * along[1]),
        "by_across": (-across[1], -below * across[1], -ahead * across[1]),
        "drawbar": along[0],
        "side": -across[0],
        "resistance": torque,
    }
    for name, values in found.items():
        old = getattr(wheel, name)
        one = not isinstance(values, tuple)
        new = choose(still, values, old) if one else tuple(map(choose, (still,) * 3, values, old))
        setattr(wheel, name, new)


@formula
def lean(wheels: Any, w: Any, tyre: Any, lane: Any) -> None:
    """Put the force of `hold`, as far as it lies along the surface, on a wheel that rests."""
    wheel = WHEEL.of(wheels, w, lane)
    ahead, below = shear_center(pressed_depth(wheel.sinkage, tyre), 0.0, own_tyre(tyre, wheel))
    x, y = dot(wheel.hold, wheel.forward), dot(wheel.hold, wheel.across)
    wheel.force = plus(wheel.force, (x, y, 0.0))
    wheel.moment = (below * y, -below * x, ahead * y)
    wheel.drawbar, wheel.side, wheel.resistance = x, -y, below * x
