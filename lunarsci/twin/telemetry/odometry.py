"""Dead reckoning, and how the ground moves a rover that does not slip, or slips as it slopes.

Wheels that follow waves go further than the rover seen from above, and lag or lead as it pitches. On a slope the wheels
must carry a part of the weight, and slip for it. A wheel's pull grows with its slip, and its side force with its side
slip, both as its load; so the three velocities of a rigid rover are those that fit all wheels best, weighed by their
loads, and those across by how much stiffer the ground is against side slip than against slip. This is the balance of
forces where slips are small, and inertia is none.
"""

from dataclasses import replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.telemetry.reading import Findings
from lunarsci.twin.telemetry.wheel_motion import WheelMotion


def mean_speed(rim_m_s: FloatArray) -> FloatArray:
    """Root mean square of the known rims. (n,)"""
    known = np.isfinite(rim_m_s)
    squares = np.where(known, np.nan_to_num(rim_m_s) ** 2, 0.0).sum(axis=1)
    return np.asarray(np.sqrt(squares / np.maximum(known.sum(axis=1), 1)))


def wheel_rows(rover: Rover, steering_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Speed of each wheel along and across its own plane for unit velocities of the rover's origin.

    Parameters
    ----------
    steering_rad : steering angle of each wheel. (n, wheels) [rad]

    Returns
    -------
    Rows for (ahead [m/s], left [m/s], turn [rad/s]); the speed along is that of the rim if nothing slips, so that the
    steering offset, whose wheel rolls about its axis, counts with it. (n, wheels, 3), (n, wheels, 3)
    """
    position, side = rover.wheel_positions_m, np.tile([1.0, -1.0], len(rover.pairs))
    offset = np.where(rover.steered_mask, rover.steering_offset_m * side, 0.0)
    x, y = position[:, 0], position[:, 1] - offset
    cos, sin = np.cos(steering_rad), np.sin(steering_rad)
    along = np.stack([cos, sin, x * sin - y * cos - offset], axis=-1)
    across = np.stack([-sin, cos, x * cos + y * sin], axis=-1)
    return along, across


def body_twist(rover: Rover, rim_m_s: FloatArray, steering_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity of the rover's origin that fits all rims best, with neither slip nor side slip.

    Parameters
    ----------
    rim_m_s : r_s omega, NaN where unknown: such a wheel still does not move sideways. (n, wheels) [m/s]
    steering_rad : (n, wheels) [rad]

    Returns
    -------
    Ahead [m/s], left [m/s], turn [rad/s] (n, 3), and root mean square of what the wheels differ from it. (n,) [m/s]
    """
    along, across = wheel_rows(rover, steering_rad)
    known = np.isfinite(rim_m_s)
    rows = np.where(known[..., None], along, 0.0)
    right = np.nan_to_num(rim_m_s)
    twist = fitted_twist(rows, across, right, np.zeros_like(right))
    off = np.concatenate([right - np.einsum("nki,ni->nk", rows, twist), np.einsum("nki,ni->nk", across, twist)], axis=1)
    return twist, np.sqrt((off**2).mean(axis=1))


def fitted_twist(
    along: FloatArray,
    across: FloatArray,
    v_x_m_s: FloatArray,
    v_y_m_s: FloatArray,
    weight: tuple[FloatArray, FloatArray] | None = None,
) -> FloatArray:
    """Velocity of the rover's origin that fits speeds of the wheels along and across their planes best.

    Parameters
    ----------
    along, across : rows of `wheel_rows`, zeros for what is not known. (n, wheels, 3)
    v_x_m_s, v_y_m_s : speeds along and across. (n, wheels) [m/s]
    weight : of each of these, positive; None takes all alike. (n, wheels), (n, wheels)

    Returns
    -------
    Ahead [m/s], left [m/s], turn [rad/s]. (n, 3)
    """
    rows = np.concatenate([along, across], axis=1)
    right = np.concatenate([v_x_m_s, v_y_m_s], axis=1)
    weights = np.ones_like(right) if weight is None else np.concatenate(weight, axis=1)
    normal = np.einsum("nk,nki,nkj->nij", weights, rows, rows)
    return np.asarray(np.linalg.solve(normal, np.einsum("nk,nki,nk->ni", weights, rows, right)[..., None])[..., 0])


DISAGREE = 0.03
"""Median share of the usual rim speed by which wheels may differ from one motion; assumed."""
SAID, UNDER_WAY = 0.01, 0.3
"""How far an encoder's scale must be off to be said, and share of the highest speed from which a wheel tells it;
assumed."""
MOST_SCALE, TURNED_RAD = 1.5, 0.1
"""Farthest that an encoder's scale is off, as by another wheel or gear; change of steering beyond which steps are of
two motions; assumed."""
BLOCK_M = 0.5
"""Way over which rims are averaged: the last digits of encoders count less in it; assumed."""


def of_one_motion(
    wheels: WheelMotion, rover: Rover, steering_rad: FloatArray, step_s: FloatArray, findings: Findings
) -> WheelMotion:
    """Wheels whose rims tell of the motions of one rigid rover, with the encoder mended that fits the others least.

    It is the wheel without which all others agree best; it turned as they say, times a scale, which is 1 where nothing
    is wrong. What all wheels have in common does not show here, nor which wheel of a side it is where none is steered.

    Parameters
    ----------
    steering_rad, step_s : between rows. (n - 1, wheels) [rad], (n - 1,) [s]
    """
    known = np.isfinite(wheels.rim_m_s).all(axis=1) & wheels.moving
    if not known.any() or not rover.steered_mask.any():
        return wheels
    # Steps without a halt between, or a change of steering as before a turn, that make a block.
    way = np.cumsum(np.where(known, mean_speed(wheels.rim_m_s) * step_s, 0.0)) // BLOCK_M
    turned = np.append(False, (np.abs(np.diff(steering_rad, axis=0)) > TURNED_RAD).any(axis=1))
    block = np.cumsum(np.append(True, (np.diff(way) > 0) | ~known[:-1]) | turned)[known]
    begins, weight = np.flatnonzero(np.append(True, np.diff(block) > 0)), step_s[known, None]

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(weight * values[known], begins) / np.add.reduceat(weight, begins))

    rims, steering = means(wheels.rim_m_s), means(steering_rad)
    along, _ = wheel_rows(rover, steering)
    left = []
    for k in range(len(rover.wheels)):
        others = rims.copy()
        others[:, k] = np.nan
        twist, off = body_twist(rover, others, steering)
        left.append((float(np.mean(off**2)), k, np.einsum("ni,ni->n", along[:, k], twist)))
    _, k, expected = min(left)
    turning = np.abs(expected) > UNDER_WAY * np.abs(expected).max()
    scale, trusted = float(np.median(rims[turning, k] / expected[turning])), wheels.trusted.copy()
    # A wheel that stands, or turns otherwise altogether, is no encoder that counts in another scale.
    counts = 1.0 / MOST_SCALE < scale < MOST_SCALE
    mended = np.where(np.arange(len(rover.wheels)) == k, scale if counts else np.nan, 1.0)
    trusted[:, k] &= counts
    off_m_s = float(np.median(body_twist(rover, rims / mended, steering)[1])) / wheels.usual_m_s
    if off_m_s > DISAGREE:
        what = f"rims and steering of the wheels differ by {100 * off_m_s:.2g} % from any one motion"
        done = "their best fit is taken; are the wheels named as they should be?"
        findings.add("wheels disagree", what, done, doubt=True)
        return wheels
    if abs(scale - 1.0) > SAID:
        what = f"wheel {rover.wheels[k]} turns {scale:.3f} times as far as the others say"
        done = "its angles and rates are taken to be in that scale" if trusted[:, k].any() else "it is left out"
        findings.add("encoder scale", what, done)
    return replace(wheels, rim_m_s=wheels.rim_m_s / mended, trusted=trusted)


LEAST_LOAD = 0.05
"""Share of the mean load below which a wheel is not taken to be; assumed."""


def shape_effect(rover: Rover, held: PrescribedLoads, over_m: FloatArray, stiffness: float) -> FloatArray:
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


def slope_effect(rover: Rover, held: PrescribedLoads, stiffness: float) -> FloatArray:
    """Deviation of ahead, left and turn where a wheel slips, or slips aside, as steep as its slope is. (n, 3, 2)

    Shares of the rims' speed, the turn in 1/m; the first column is of slopes along the wheels, the second across.
    """
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    sign = np.where(held.motion.speed_m_s < 0, -1.0, 1.0)
    climb, lean = (np.nan_to_num(sign * held.axes[:, :, k, 2]) for k in (0, 1))
    still, weight = np.zeros_like(climb), _weights(held, stiffness)
    parts = (fitted_twist(along, across, -climb, still, weight), fitted_twist(along, across, still, -lean, weight))
    return np.stack(parts, axis=-1)


def _weights(held: PrescribedLoads, stiffness: float) -> tuple[FloatArray, FloatArray]:
    """Of speeds along and across: loads as shares of their mean, no less than `LEAST_LOAD`. (n, wheels) each"""
    load = held.states[..., STATE_COLUMNS.index("normal_force_n")]
    usual = float(np.nanmean(load)) if np.isfinite(load).any() else 1.0
    share = np.maximum(np.where(np.isfinite(load), load / usual, 1.0), LEAST_LOAD)
    return share, stiffness * share


def ground_velocities(rover: Rover, held: PrescribedLoads, over_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much faster wheels move along and across their planes than those of a rover on a plane. (n, wheels) [m/s]

    As of `shape_effect`; forward is as the rover has it.
    """
    motion = held.motion
    along, across = wheel_rows(rover, np.radians(motion.steering_deg))
    twist = _twist(motion.time_s, over_m, np.radians(motion.yaw_deg))
    v_x, v_y = _seen_velocities(held)
    return v_x - np.einsum("nwi,ni->nw", along, twist), v_y - np.einsum("nwi,ni->nw", across, twist)


def _twist(time_s: FloatArray, place_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Velocity ahead, to the left, and turn, by the differences that `prescribed_loads` takes. (n, 3)"""
    rate = np.gradient(np.column_stack([place_m, yaw_rad]), time_s, axis=0)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([cos * rate[:, 0] + sin * rate[:, 1], cos * rate[:, 1] - sin * rate[:, 0], rate[:, 2]])


def _seen_velocities(held: PrescribedLoads) -> tuple[FloatArray, FloatArray]:
    """Velocity of each wheel along and across its plane on the ground, forward as of the rover. (n, wheels) [m/s]"""
    slip, side = (held.states[..., STATE_COLUMNS.index(name)] for name in ("slip_ratio", "side_slip_deg"))
    speed = held.motion.speed_m_s
    travel = np.where(slip >= 0, 1.0 - slip, 1.0 / (1.0 + np.minimum(slip, 0.0)))
    v_x = travel * speed
    return v_x, np.sign(speed) * np.tan(np.radians(side)) * np.abs(v_x)
