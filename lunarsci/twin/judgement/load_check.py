"""Whether the wheels of a prediction carry what wheels of a slow rover can carry.

What each wheel carried and pulled along a drive, as a few numbers.

Forces with their uncertainty as a table: the input of the joint identification of a soil.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import FloatArray, at_times
from lunarsci.regolith.states import FROM_MOTION
from lunarsci.twin.loads.load_ensemble import LoadEnsemble
from lunarsci.twin.loads.prescribed_motion import FORCES, PoseStates
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

if TYPE_CHECKING:
    import pandas as pd


def force_table(found: LoadEnsemble, states: PoseStates | None = None) -> "pd.DataFrame":
    """Forces of each wheel after the balance: one row for each measured state, or for each pose and wheel.

    The columns of the measured states stay as they were read; normal_force_n, drawbar_pull_n, lateral_force_n, each
    with `_sigma`, are those of their times, between the poses of the motion. Without measured states there are time_s,
    distance_m (rolled by the rims), wheel, x_m, y_m, sinkage_m, slip_ratio, side_slip_deg as the held motion has them
    on the middle one of the soils. `valid` is false for states that were not valid, at and beside halts and gaps, and
    where there are no forces. `forces_from` says that these were computed of a motion, so that their errors are alike,
    `rover` whose wheels they are, `ground` where they were.
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
        at_times(states.time_s, poses, part, beyond=False)[rows, states.wheel]
        for part in (found.after, found.after_sigma)
    )
    for k, name in enumerate(FORCES):
        table[name], table[f"{name}_sigma"] = mean[:, k], sigma[:, k]
    table["forces_from"] = FROM_MOTION
    table["valid"] = states.valid & np.isfinite(mean).all(axis=1) & (mean[:, 0] > 0)
    return pd.DataFrame(table).assign(rover=found.held.rover.written, ground=found.held.terrain.written)


def _of_the_motion(found: LoadEnsemble) -> "pd.DataFrame":
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
    columns["forces_from"] = np.full(len(mean), FROM_MOTION)
    marked = flat[:, STATE_COLUMNS.index("valid")] > 0.5
    columns["valid"] = marked & np.isfinite(mean).all(axis=1) & (mean[:, 0] > 0)
    return pd.DataFrame(columns).assign(rover=held.rover.written, ground=held.terrain.written)


QUANTITIES = (
    "normal_force_n",
    "drawbar_pull_n",
    "lateral_force_n",
    "resistance_torque_nm",
    "sinkage_m",
    "slip_ratio",
    "side_slip_deg",
)


@dataclass(frozen=True, slots=True)
class Spread:
    """Of one quantity over the poses of a drive, and over the members of an ensemble, all counted alike."""

    mean: float
    min: float
    p05: float
    p50: float
    p95: float
    max: float


@dataclass(frozen=True, slots=True)
class WheelLoads:
    """One wheel: quantity, with its unit, to its spread; and in how many of its states the wheel model holds. [-]"""

    wheel: str
    quantities: dict[str, Spread]
    valid_share: float


def wheel_loads(wheels: Sequence[str], states: FloatArray) -> list[WheelLoads]:
    """Summaries of wheel states (..., wheels, 10), columns `STATE_COLUMNS`; states that are no numbers are left out.

    Empty where no state is a number.
    """
    flat = states.reshape(-1, len(wheels), states.shape[-1])
    flat = flat[np.isfinite(flat).all(axis=(1, 2))]
    if not len(flat):
        return []
    valid = flat[..., STATE_COLUMNS.index("valid")].mean(axis=0)
    return [
        WheelLoads(
            wheel, {name: _spread(flat[:, k, STATE_COLUMNS.index(name)]) for name in QUANTITIES}, float(valid[k])
        )
        for k, wheel in enumerate(wheels)
    ]


def _spread(values: FloatArray) -> Spread:
    p05, p50, p95 = np.percentile(values, (5, 50, 95))
    return Spread(float(values.mean()), float(values.min()), float(p05), float(p50), float(p95), float(values.max()))


MOST_IN_WEIGHTS = 2.0
"""Times the rover's weight that one wheel carries at most unless it falls or hits something; assumed."""


@dataclass(frozen=True, slots=True)
class LoadCheck:
    """Wheel loads over every member, sample and wheel that was driven.

    Attributes
    ----------
    weight_n : of the rover. [N]
    least_n, most_n : of any wheel, None where nothing was driven. [N]
    hanging_share, overloaded_share : of the wheel states, without any load and beyond twice the weight. [-]
    hanging_members, overloaded_members : drives that have such states.
    """

    weight_n: float
    least_n: float | None
    most_n: float | None
    hanging_share: float
    hanging_members: int
    overloaded_share: float
    overloaded_members: int


def check_loads(prediction: Prediction) -> LoadCheck:
    """Look for wheels at 0 N, and above twice the weight."""
    loads = prediction.states[..., STATE_COLUMNS.index("normal_force_n")]
    driven = np.broadcast_to(prediction.reached[..., None], loads.shape)
    weight = prediction.rover.mass_kg * prediction.rover.gravity_m_s2
    hanging, over = driven & (loads <= 0.0), driven & (loads > MOST_IN_WEIGHTS * weight)
    count = max(int(driven.sum()), 1)
    return LoadCheck(
        weight_n=float(weight),
        least_n=float(loads[driven].min()) if driven.any() else None,
        most_n=float(loads[driven].max()) if driven.any() else None,
        hanging_share=float(hanging.sum() / count),
        hanging_members=int(hanging.any(axis=(1, 2)).sum()),
        overloaded_share=float(over.sum() / count),
        overloaded_members=int(over.any(axis=(1, 2)).sum()),
    )


def load_notes(found: LoadCheck) -> list[str]:
    """One sentence for each kind that occurs."""
    notes = []
    if found.hanging_members:
        notes.append(f"in {found.hanging_members} drive(s) a wheel carries nothing, and others carry its load")
    if found.overloaded_members:
        notes.append(
            f"in {found.overloaded_members} drive(s) a wheel carries up to {found.most_n:.0f} N, more than twice the "
            f"rover's weight of {found.weight_n:.0f} N: a fall, a hit, or a computation that lost its meaning"
        )
    return notes
