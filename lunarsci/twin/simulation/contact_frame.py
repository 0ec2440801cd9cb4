"""Where a wheel meets the terrain: the axes of the contact, its limits, and what lies in the rows of a wheel."""

import math
from typing import Any

from lunarsci.compiled import pasted
from lunarsci.elementary import arcsin, cosine, sine
from lunarsci.twin.lanes import BOGIE_SWING, SOIL, SPEED, SWING, cross, dot, get, get3, plus, times

__all__ = [
    "DEEPEST",
    "SHALLOWEST",
    "SLOWEST",
    "VALID_SLIP",
    "contact_frame",
    "seen_from",
    "shear_center",
    "soil_below",
    "velocity_of",
]

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
