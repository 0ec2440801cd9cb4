"""States, positions and motion of a drive as tables."""

from typing import TYPE_CHECKING

import numpy as np

from lunarsci.twin.telemetry.states import DriveStates

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["BASIS", "finding_rows", "motion_table", "position_table", "wheel_table"]

BASIS = "positions"
"""What slip and side slip rest on: the positions of `position_table`."""


def wheel_table(drive: DriveStates) -> "pd.DataFrame":
    """A row for each time and wheel: what `lunarsci twin update` reads as states.

    Columns time_s, distance_m, wheel, x_m, y_m, sinkage_m, sinkage_m_sigma, slip_ratio, slip_ratio_sigma,
    side_slip_deg, side_slip_deg_sigma, valid, slip_basis.
    """
    import pandas as pd

    rows, names = drive.rows, drive.rover.wheels
    each = len(names)
    columns = {
        "time_s": np.repeat(drive.nodes.time_s[rows.node], each),
        "distance_m": np.repeat(rows.distance_m, each),
        "wheel": np.tile(names, len(rows.node)),
        "x_m": rows.place_m[..., 0].ravel(),
        "y_m": rows.place_m[..., 1].ravel(),
    }
    for name in ("sinkage_m", "slip_ratio", "side_slip_deg"):
        columns[name] = getattr(rows, name).ravel()
        columns[f"{name}_sigma"] = getattr(rows, f"{name}_sigma").ravel()
    columns["valid"] = rows.valid.ravel()
    return pd.DataFrame(columns).assign(slip_basis=BASIS)


def position_table(drive: DriveStates) -> "pd.DataFrame":
    """The localised positions that were used: time_s, x_m, y_m, xx_m2, xy_m2, yy_m2."""
    import pandas as pd

    telemetry = drive.telemetry
    rows = telemetry.fixed & ~np.isin(telemetry.time_s, drive.left_out[:, 0])
    covariance = telemetry.fix_covariance_m2[rows]
    return pd.DataFrame(
        {
            "time_s": telemetry.time_s[rows],
            "x_m": telemetry.fix_m[rows, 0],
            "y_m": telemetry.fix_m[rows, 1],
            "xx_m2": covariance[:, 0, 0],
            "xy_m2": covariance[:, 0, 1],
            "yy_m2": covariance[:, 1, 1],
        }
    )


def motion_table(drive: DriveStates) -> "pd.DataFrame":
    """The smoothed motion with the wheels' measured commands: what `lunarsci twin forces --motion` reads.

    Columns time_s, x_m, y_m, yaw_deg, their NAME_sigma, and steering_W_deg, speed_W_m_s of each wheel W.
    """
    import pandas as pd

    motion, covariance = drive.motion, drive.smoothed.covariance
    columns = {name: getattr(motion, name) for name in ("time_s", "x_m", "y_m", "yaw_deg")}
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :3])
    columns |= {"x_m_sigma": errors[:, 0], "y_m_sigma": errors[:, 1], "yaw_deg_sigma": np.degrees(errors[:, 2])}
    for k, wheel in enumerate(drive.rover.wheels):
        columns[f"steering_{wheel}_deg"] = motion.steering_deg[:, k]
        columns[f"speed_{wheel}_m_s"] = motion.speed_m_s[:, k]
    return pd.DataFrame(columns)


def finding_rows(drive: DriveStates) -> list[dict[str, object]]:
    """Findings as plain rows: kind, when, how many, what, what was done, whether the result is in doubt for it."""
    return [
        {
            "kind": entry.kind,
            "time_s": entry.time_s,
            "count": entry.count,
            "what": entry.what,
            "done": entry.done,
            "doubt": entry.doubt,
        }
        for entry in drive.findings.entries
    ]
