"""Whether the wheels of a prediction carry what wheels of a slow rover can carry."""

from dataclasses import dataclass

import numpy as np

from lunarsci.twin.ensemble import STATE_COLUMNS, Prediction

__all__ = ["MOST_IN_WEIGHTS", "LoadCheck", "check_loads", "load_notes"]

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
