"""Tables of what a drive's telemetry says: states, positions and motion, which other commands read."""

from typing import TYPE_CHECKING

import numpy as np

from lunarsci.twin.telemetry.checks import FAST, MOST_FAST
from lunarsci.twin.telemetry.plan_checks import HALT
from lunarsci.twin.telemetry.reading import SHARED
from lunarsci.twin.telemetry.states import DriveStates

if TYPE_CHECKING:
    import pandas as pd


BASIS = "positions"
"""What slip and side slip rest on: the positions of `position_table`."""


def wheel_table(drive: DriveStates) -> "pd.DataFrame":
    """A row for each time and wheel: what `lunarsci twin update` reads as states.

    Columns time_s, distance_m, wheel, x_m, y_m, sinkage_m, sinkage_m_sigma, slip_ratio, slip_ratio_sigma,
    side_slip_deg, side_slip_deg_sigma, slip_ratio_shared, valid, slip_basis, rim_m_s, rover, ground, and doubt where
    there is some.
    """
    import pandas as pd

    rows, names, each = drive.rows, drive.rover.wheels, len(drive.rover.wheels)
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
    columns["slip_ratio_shared"] = rows.slip_ratio_shared.ravel()
    columns["valid"] = rows.valid.ravel()
    return _named(pd.DataFrame(columns).assign(slip_basis=BASIS, rim_m_s=rows.rim_m_s.ravel()), drive, _learned(drive))


def _learned(drive: DriveStates) -> tuple[str, ...]:
    """Kinds of findings that leave the states right, and not a soil learned from them with the plan."""
    many = drive.rows.fast.sum() > MOST_FAST * drive.rows.measured.sum()
    return (HALT, FAST) if many else (HALT,)


def _named(table: "pd.DataFrame", drive: DriveStates, kinds: tuple[str, ...] = ()) -> "pd.DataFrame":
    """With the rover, its ground, and why the table is doubtful, by findings that are a doubt or of some kinds."""
    doubts = [
        f"{one.kind}: {one.what}" if one.doubt else f"{one.kind}: {one.what}; {one.done}"
        for one in drive.findings.entries
        if one.doubt or one.kind in kinds
    ]
    table = table.assign(rover=drive.rover.written, ground=drive.held.terrain.written)
    return table.assign(doubt="; ".join(doubts)) if doubts else table


def position_table(drive: DriveStates) -> "pd.DataFrame":
    """`DriveStates.positions`: time_s, x_m, y_m, xx_m2, xy_m2, yy_m2, and `SHARED` where it is known."""
    import pandas as pd

    used = drive.positions
    columns = {
        "time_s": used.time_s,
        "x_m": used.place_m[:, 0],
        "y_m": used.place_m[:, 1],
        "xx_m2": used.covariance_m2[:, 0, 0],
        "xy_m2": used.covariance_m2[:, 0, 1],
        "yy_m2": used.covariance_m2[:, 1, 1],
    }
    if used.shared_m2 is not None:
        columns |= dict(zip(SHARED, used.shared_m2.reshape(-1, 4).T, strict=True))
    return pd.DataFrame(columns)


def motion_table(drive: DriveStates) -> "pd.DataFrame":
    """The smoothed motion with the wheels' measured commands: what `lunarsci twin loads` reads.

    Columns time_s, x_m, y_m, yaw_deg, their NAME_sigma, steering_W_deg, speed_W_m_s of each wheel W, rover,
    ground, and doubt where there is some.
    """
    import pandas as pd

    motion, covariance = drive.motion, drive.smoothed.covariance
    columns = {name: getattr(motion, name) for name in ("time_s", "x_m", "y_m", "yaw_deg")}
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :3])
    columns |= {"x_m_sigma": errors[:, 0], "y_m_sigma": errors[:, 1], "yaw_deg_sigma": np.degrees(errors[:, 2])}
    for k, wheel in enumerate(drive.rover.wheels):
        columns[f"steering_{wheel}_deg"] = motion.steering_deg[:, k]
        columns[f"speed_{wheel}_m_s"] = motion.speed_m_s[:, k]
    return _named(pd.DataFrame(columns), drive)
