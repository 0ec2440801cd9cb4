"""How the ground moves a rover: by its shape, whatever slips, and by its slopes, which make the wheels slip.

Wheels that follow waves go further than the rover seen from above, and lag or lead as it pitches. On a slope the wheels
must carry a part of the weight, and slip for it. A wheel's pull grows with its slip, and its side force with its side
slip, both as its load; so the three velocities of a rigid rover are those that fit all wheels best, weighed by their
loads, and those across by how much stiffer the ground is against side slip than against slip. This is the balance of
forces where slips are small, and inertia is none.

"""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.loads.held import HeldForces
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.telemetry.odometry import fitted_twist, wheel_rows

__all__ = ["ground_velocities", "shape_effect", "slope_effect"]

FloatArray = npt.NDArray[np.float64]
LEAST_LOAD = 0.05
"""Share of the mean load below which a wheel is not taken to be; assumed."""


def shape_effect(rover: Rover, held: HeldForces, over_m: FloatArray, stiffness: float) -> FloatArray:
    """Change of the twist that rims and steering say, by the shape of the ground. (n, 3) [m/s, m/s, rad/s]

    Parameters
    ----------
    held : the rover along a motion that is about right.
    over_m : where the point is that the wheels stand about (see `sway_m`). (n, 2) [m]
    stiffness : of the ground against side slip, as a share of that against slip. [-]
    """
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    off_x, off_y = (np.nan_to_num(part) for part in ground_velocities(rover, held, over_m))
    rim, weight = held.motion.speed_m_s, _weights(held, stiffness)
    flat = fitted_twist(along, across, rim, np.zeros_like(rim))
    return fitted_twist(along, across, rim - off_x, -off_y, weight) - flat


def slope_effect(rover: Rover, held: HeldForces, stiffness: float) -> FloatArray:
    """Deviation of ahead, left and turn where a wheel slips, or slips aside, as steep as its slope is. (n, 3, 2)

    Shares of the rims' speed, the turn in 1/m; the first column is of slopes along the wheels, the second across.
    """
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    sign = np.where(held.motion.speed_m_s < 0, -1.0, 1.0)
    climb, lean = (np.nan_to_num(sign * held.axes[:, :, k, 2]) for k in (0, 1))
    still, weight = np.zeros_like(climb), _weights(held, stiffness)
    parts = (fitted_twist(along, across, -climb, still, weight), fitted_twist(along, across, still, -lean, weight))
    return np.stack(parts, axis=-1)


def _weights(held: HeldForces, stiffness: float) -> tuple[FloatArray, FloatArray]:
    """Of speeds along and across: loads as shares of their mean, no less than `LEAST_LOAD`. (n, wheels) each"""
    load = held.states[..., STATE_COLUMNS.index("normal_force_n")]
    usual = float(np.nanmean(load)) if np.isfinite(load).any() else 1.0
    share = np.maximum(np.where(np.isfinite(load), load / usual, 1.0), LEAST_LOAD)
    return share, stiffness * share


def ground_velocities(rover: Rover, held: HeldForces, over_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much faster wheels move along and across their planes than those of a rover on a plane. (n, wheels) [m/s]

    As of `shape_effect`; forward is as the rover has it.
    """
    motion = held.motion
    along, across = wheel_rows(rover, np.radians(motion.steering_deg))
    twist = _twist(motion.time_s, over_m, np.radians(motion.yaw_deg))
    v_x, v_y = _seen_velocities(held)
    return v_x - np.einsum("nwi,ni->nw", along, twist), v_y - np.einsum("nwi,ni->nw", across, twist)


def _twist(time_s: FloatArray, place_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Velocity ahead, to the left, and turn, by the differences that `forces_along` takes. (n, 3)"""
    rate = np.gradient(np.column_stack([place_m, yaw_rad]), time_s, axis=0)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([cos * rate[:, 0] + sin * rate[:, 1], cos * rate[:, 1] - sin * rate[:, 0], rate[:, 2]])


def _seen_velocities(held: HeldForces) -> tuple[FloatArray, FloatArray]:
    """Velocity of each wheel along and across its plane on the ground, forward as of the rover. (n, wheels) [m/s]"""
    slip, side = (held.states[..., STATE_COLUMNS.index(name)] for name in ("slip_ratio", "side_slip_deg"))
    speed = held.motion.speed_m_s
    travel = np.where(slip >= 0, 1.0 - slip, 1.0 / (1.0 + np.minimum(slip, 0.0)))
    v_x = travel * speed
    return v_x, np.sign(speed) * np.tan(np.radians(side)) * np.abs(v_x)
