"""Forces with their uncertainty as a table: the input of the joint identification of a soil."""

from typing import TYPE_CHECKING

import numpy as np

from lunarsci.twin.ensemble import STATE_COLUMNS
from lunarsci.twin.pose_states import PoseStates, at_times
from lunarsci.twin.totals import FORCES
from lunarsci.twin.uncertain_forces import UncertainForces

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["force_table"]


def force_table(found: UncertainForces, states: PoseStates | None = None) -> "pd.DataFrame":
    """Forces of each wheel after the balance: one row for each measured state, or for each pose and wheel.

    The columns of the measured states stay as they were read; normal_force_n, drawbar_pull_n, lateral_force_n, each
    with `_sigma`, are those of their times, between the poses of the motion. Without measured states there are time_s,
    distance_m (rolled by the rims), wheel, x_m, y_m, sinkage_m, slip_ratio, side_slip_deg as the held motion has them
    on the middle one of the soils. `valid` is false for states that were not valid, at and beside halts and gaps, and
    where there are no forces.
    """
    import pandas as pd

    if states is None:
        return _of_the_motion(found)
    table = states.table.copy()
    gone = [f"{name}{end}" for name in FORCES for end in ("", "_sigma")]
    table = table.drop(columns=[name for name in (*gone, "valid") if name in table])
    poses = found.held.motion.time_s
    rows = np.arange(len(table))
    mean, sigma = (
        at_times(states.time_s, poses, part)[rows, states.wheel] for part in (found.after, found.after_sigma)
    )
    for k, name in enumerate(FORCES):
        table[name], table[f"{name}_sigma"] = mean[:, k], sigma[:, k]
    table["valid"] = states.valid & np.isfinite(mean).all(axis=1) & (mean[:, 0] > 0)
    return pd.DataFrame(table)


def _of_the_motion(found: UncertainForces) -> "pd.DataFrame":
    import pandas as pd

    held, wheels = found.held, found.held.rover.wheels
    count = len(held.motion.time_s)
    flat = held.states.reshape(-1, len(STATE_COLUMNS))
    columns = {
        "time_s": np.repeat(held.motion.time_s, len(wheels)),
        "distance_m": np.repeat(held.motion.rolled_m, len(wheels)),
        "wheel": np.tile(wheels, count),
    }
    names = ("x_m", "y_m", "sinkage_m", "slip_ratio", "side_slip_deg")
    columns |= {name: flat[:, STATE_COLUMNS.index(name)] for name in names}
    mean, sigma = found.after.reshape(-1, 3), found.after_sigma.reshape(-1, 3)
    for k, name in enumerate(FORCES):
        columns |= {name: mean[:, k], f"{name}_sigma": sigma[:, k]}
    marked = flat[:, STATE_COLUMNS.index("valid")] > 0.5
    columns["valid"] = marked & np.isfinite(mean).all(axis=1) & (mean[:, 0] > 0)
    return pd.DataFrame(columns)
