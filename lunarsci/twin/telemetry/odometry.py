"""Dead reckoning: how the rover would move if no wheel slipped."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.rover import Rover

__all__ = ["body_twist", "fitted_twist", "wheel_rows"]

FloatArray = npt.NDArray[np.float64]


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
