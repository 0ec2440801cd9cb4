"""Slip and side slip of the wheels from the motion of the rover that carries them over the ground."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.held import HeldForces
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.filter import Nodes
from lunarsci.twin.telemetry.ground_effect import ground_velocities
from lunarsci.twin.telemetry.nodes import pace_at, twist_at
from lunarsci.twin.telemetry.odometry import wheel_rows
from lunarsci.twin.telemetry.smoother import Smoothed

__all__ = ["WheelVelocities", "slips_of", "wheel_velocities"]

FloatArray = npt.NDArray[np.float64]
SLIP_FLOOR, SIDE_SLIP_FLOOR_DEG = 0.001, 0.08
"""What is left where all sensors are all but perfect: 0.0005 to 0.0009 and 0.04 to 0.06 deg on six made-up drives over
ground of 0 to 5 mm roughness; the steering's own error of 0.1 deg, of which a few rows are averaged, adds 0.06 deg."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WheelVelocities:
    """Velocity of every wheel along and across its plane on the ground, at the nodes.

    Attributes
    ----------
    v_x, v_y : forward as the rover has it, and to the left. (n, wheels) [m/s]
    along, across : what they are per velocity of the rover (see `wheel_rows`). (n, wheels, 3)
    covariance : of the rover's velocities. (n, 3, 3)
    """

    v_x: FloatArray
    v_y: FloatArray
    along: FloatArray
    across: FloatArray
    covariance: FloatArray


def wheel_velocities(rover: Rover, nodes: Nodes, smoothed: Smoothed, held: HeldForces) -> WheelVelocities:
    """Velocities of the wheels where the rover moves as smoothed, held to the ground."""
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    off_x, off_y = ground_velocities(rover, held, smoothed.state[:, :2])
    twist = twist_at(nodes, smoothed)
    return WheelVelocities(
        v_x=off_x + np.einsum("nwi,ni->nw", along, twist),
        v_y=off_y + np.einsum("nwi,ni->nw", across, twist),
        along=along,
        across=across,
        covariance=smoothed.deviation_covariance * pace_at(nodes)[:, None, None] ** 2,
    )


def slips_of(velocities: WheelVelocities, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Slip ratio [-], side slip [deg], and their standard errors. (n, wheels) each"""
    rim, sign = np.abs(motion.speed_m_s), np.sign(motion.speed_m_s)
    v_x, v_y = sign * velocities.v_x, sign * velocities.v_y
    travel = v_x / rim
    slip = np.where(travel <= 1.0, 1.0 - travel, 1.0 / np.maximum(travel, 1.0) - 1.0)
    side = np.degrees(np.arctan2(v_y, np.abs(v_x)))
    along, across, covariance = velocities.along, velocities.across, velocities.covariance
    travel_sigma = np.sqrt(np.einsum("mwi,mij,mwj->mw", along, covariance, along)) / rim
    steep = np.where(slip >= 0, 1.0, (1.0 + np.minimum(slip, 0.0)) ** 2)
    squared = v_x**2 + v_y**2
    weights = (across * np.abs(v_x)[..., None] - along * (np.sign(v_x) * v_y)[..., None]) / squared[..., None]
    side_sigma = np.degrees(np.sqrt(np.einsum("mwi,mij,mwj->mw", weights, covariance, weights)))
    return slip, side, np.hypot(steep * travel_sigma, SLIP_FLOOR), np.hypot(side_sigma, SIDE_SLIP_FLOOR_DEG)
