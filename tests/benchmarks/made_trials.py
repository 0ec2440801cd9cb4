"""Synthetic drives in the layouts of public data sets: nobody drove them, and they share no code with the twin.

A skid-steered rover as a rigid body on a plane: it goes a share of what its wheels roll, and turns a share of what
they would turn it; both waver along the way.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
EASTING_M, NORTHING_M, UNIX_S = 625438.0, 5041773.0, 1567000000.0
"""Where and when the runs of the energy-aware navigation data set are, roughly."""


@dataclass(frozen=True)
class MadeDrive:
    """What happened: times [s], poses x, y [m], yaw [rad], angles of FL, FR, RL, RR [rad], slip of the body [-]."""

    time_s: Array
    place_m: Array
    yaw_rad: Array
    angle_rad: Array
    slip: Array
    grade_rad: float

    @property
    def way_m(self) -> Array:
        """Uphill, along x."""
        return self.place_m[:, 0]


def made_drive(
    *, speed_m_s: float, turn_rad_s: float = 0.0, seconds: float = 40.0, rate_hz: float = 10.0, radius_m: float,
    track_m: float, slip: float = 0.1, turned: float = 0.6, grade_deg: float = 0.0, seed: int = 0,
) -> MadeDrive:  # fmt: skip
    """A drive of constant commands, eased in; `slip` on the level, more by half the tangent of the grade."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds + 0.5 / rate_hz, 1.0 / rate_hz)
    step = 1.0 / rate_hz
    pace = np.clip(time / 1.0, 0.0, 1.0)
    ahead, turn = speed_m_s * pace, turn_rad_s * pace
    waver = 0.02 * np.sin(2 * np.pi * time / 11.0 + random.uniform(0, 6))
    yaw = np.append(0.0, np.cumsum(turned * turn[1:] * step))
    share = slip + 0.5 * np.tan(np.radians(grade_deg)) * np.cos(yaw) + waver
    body = (1.0 - share) * ahead
    across = -0.2 * np.tan(np.radians(grade_deg)) * np.sin(-yaw) * ahead
    x = np.append(0.0, np.cumsum((np.cos(yaw) * body - np.sin(yaw) * across)[1:] * step))
    y = np.append(0.0, np.cumsum((np.sin(yaw) * body + np.cos(yaw) * across)[1:] * step))
    sides = np.stack([ahead - 0.5 * turn * track_m, ahead + 0.5 * turn * track_m], axis=1) / radius_m
    angle = np.vstack([np.zeros(2), np.cumsum(sides[1:] * step, axis=0)])
    return MadeDrive(time, np.stack([x, y], axis=1), yaw, angle[:, [0, 1, 0, 1]], share, np.radians(grade_deg))


def _quaternions(drive: MadeDrive) -> Array:
    """x, y, z, w of a body on the plane that rises along x, heading by yaw."""
    from scipy.spatial.transform import Rotation

    lean = Rotation.from_euler("y", -drive.grade_rad)
    return np.asarray((lean * Rotation.from_euler("z", drive.yaw_rad[:, None])).as_quat())


def write_captured(folder: Path, drive: MadeDrive, seed: int = 0, *, turns: bool = False) -> Path:
    """A trial of "Rover Mobility in a Lunar Analogue Dataset": `Processed_Data.csv` in the folder, marked synthetic."""
    import pandas as pd

    random, n = np.random.default_rng(seed), len(drive.time_s)
    place = drive.place_m + 0.001 * random.standard_normal((n, 2))
    z = 0.26 + np.tan(drive.grade_rad) * drive.way_m + 0.001 * random.standard_normal(n)
    columns = {"time_s": drive.time_s, "pos_x": place[:, 0], "pos_y": place[:, 1], "pos_z": z}
    columns |= {f"quat_{axis}": column for axis, column in zip("xyzw", _quaternions(drive).T, strict=True)}
    columns |= {f"ang_vel_{axis}": np.zeros(n) for axis in "xyz"} | {f"lin_acc_{axis}": np.zeros(n) for axis in "xyz"}
    for k in range(4):
        angle = drive.angle_rad[:, k]
        columns[f"enc{k + 1}"] = angle / (2 * np.pi)
        if not turns:
            columns[f"enc{k + 1}_rad"] = angle
            columns[f"vel{k + 1}_rad_s"] = np.gradient(angle, drive.time_s)
        columns[f"current{k + 1}"] = np.full(n, 100.0)
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(columns | {"synthetic": True}).to_csv(folder / "Processed_Data.csv", index=False)
    return folder


def write_run(folder: Path, drive: MadeDrive, seed: int = 0, *, gps: bool = True) -> Path:
    """A run of the energy-aware navigation data set: its tables of numbers under a comment, marked synthetic."""
    from scipy.spatial.transform import Rotation

    random, n = np.random.default_rng(seed), len(drive.time_s)
    folder.mkdir(parents=True, exist_ok=True)
    time, quaternion = UNIX_S + drive.time_s, _quaternions(drive)
    z = 50.0 + np.tan(drive.grade_rad) * drive.way_m
    place = np.column_stack([drive.place_m + np.array([EASTING_M, NORTHING_M]), z])
    rates = np.gradient(drive.angle_rad, drive.time_s, axis=0)
    wheels = ("front_left", "front_right", "rear_left", "rear_right")
    header = "time [s]," + ",".join(f"                {w}_wheel position [rad]" for w in wheels)
    header += "," + ",".join(f"                {w}_wheel velocity [rad/s]" for w in wheels) + " (synthetic)"
    encoders = np.column_stack([time, drive.angle_rad, rates])
    np.savetxt(folder / "wheel-encoder.txt", encoders, delimiter=",", header=header)
    posed = place + 0.03 * random.standard_normal((n, 3))
    header = "time [s], x_linear_position [m], y_linear_position [m], z_linear_position [m], "
    header += "x_orientation, y_orientation, z_orientation, w_orientation"
    # Poses come between the readings of the encoders, by their own clock.
    poses = np.column_stack([time[:-1] + 0.031, posed[:-1], quaternion[:-1]])
    np.savetxt(folder / "global-pose-utm.txt", poses, delimiter=",", header=header)
    if gps:
        antenna = place + Rotation.from_quat(quaternion).apply((-0.260, 0.0, 0.340))
        fixes = np.column_stack([time, antenna + 0.02 * random.standard_normal((n, 3))])[::5]
        header = "time [s], UTM easting [m, +ve = towards East] UTM northing [m, +ve = towards North] altitude [m]"
        np.savetxt(folder / "gps-utm18t.txt", fixes, delimiter=",", header=header)
    return folder


ROSEY = {"radius_m": 0.1515, "track_m": 0.3365}
HUSKY = {"radius_m": 0.1651, "track_m": 0.5708}
