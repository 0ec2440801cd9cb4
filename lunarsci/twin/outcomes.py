"""How a drive can end."""

from collections.abc import Iterable
from typing import SupportsInt

OUTCOMES = (
    "finished",
    "left the terrain: a wheel passed the edge of the map",
    "hole in the terrain: no height below a wheel",
    "overturned: the chassis tilted by more than 60 deg",
    "diverged: loads or energy that no drive has; the time step does not hold this soil at this speed; give a shorter "
    "time_step_s",
    "did not settle: no static equilibrium at the start pose",
    "sank: a wheel is buried to its axle",
    "cliff: the ground below or before a wheel is steeper than 60 deg",
    "fell: it moved at more than 1 m/s, off a cliff or down a slope that does not hold it",
)
FINISHED, LEFT, HOLE, OVERTURNED, DIVERGED, UNSETTLED, SANK, CLIFF, FELL = range(9)


def outcome_texts(codes: Iterable[SupportsInt]) -> list[str]:
    """The outcomes among some numbers that are no end as planned, each once, in alphabetical order."""
    return sorted({OUTCOMES[int(code)] for code in codes if code != FINISHED})
