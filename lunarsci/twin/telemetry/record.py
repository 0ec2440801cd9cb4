"""Telemetry of a drive as numbers: when, where, which way, and what each wheel did."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["POSE_COLUMNS", "WHEEL_COLUMNS", "Telemetry"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
POSE_COLUMNS = ("yaw_deg", "yaw_deg_sigma", "roll_deg", "pitch_deg")
WHEEL_COLUMNS = {
    "speed_m_s": "speed_{}_m_s",
    "steering_deg": "steering_{}_deg",
    "angle_deg": "angle_{}_deg",
    "rate_deg_s": "rate_{}_deg_s",
    "steered_deg": "steered_{}_deg",
}
"""Commanded rim speed and steering; measured angle since some start, rate and steering. Name to column of a wheel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Telemetry:
    """Rows of telemetry, in the order of time; NaN where a row lacks a value.

    Attributes
    ----------
    file : where it comes from.
    time_s : since the start of the plan, ascending. (n,) [s]
    fix_m, fix_covariance_m2 : localised positions of the rover's origin and their errors. (n, 2), (n, 2, 2)
    yaw_deg, yaw_deg_sigma : heading from x to the left and its error. (n,) [deg]
    roll_deg, pitch_deg : attitude, pitch positive nose down. (n,) [deg]
    speed_m_s, steering_deg : commanded rim speed r_s omega and steering of each wheel. (n, wheels) [m/s, deg]
    angle_deg, rate_deg_s, steered_deg : measured angle, rate and steering of each wheel. (n, wheels)
    synthetic : whether the file says that it is made up.
    """

    file: str
    time_s: FloatArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray
    yaw_deg: FloatArray
    yaw_deg_sigma: FloatArray
    roll_deg: FloatArray
    pitch_deg: FloatArray
    speed_m_s: FloatArray
    steering_deg: FloatArray
    angle_deg: FloatArray
    rate_deg_s: FloatArray
    steered_deg: FloatArray
    synthetic: bool

    @property
    def fixed(self) -> BoolArray:
        """Rows with a localised position. (n,)"""
        return np.asarray(np.isfinite(self.fix_m).all(axis=1))

    @property
    def turned_deg(self) -> FloatArray:
        """Steering as measured, else as commanded. (n, wheels) [deg]"""
        return np.where(np.isfinite(self.steered_deg), self.steered_deg, self.steering_deg)
