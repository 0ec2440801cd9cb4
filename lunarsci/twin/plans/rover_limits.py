"""What counts as safe for a rover, where its plan does not say so."""

import math
from collections.abc import Iterable
from dataclasses import replace

from lunarsci.rovers.description import RoverDescription
from lunarsci.twin.ground.mobility import read_mobility
from lunarsci.twin.plans.plan import Limit
from lunarsci.twin.rover import Rover

__all__ = ["laxer", "limits_of_rover"]

SINKAGE_IN_RADII = 1.0 / 3.0
"""Assumed, as in the embedded plan."""


def limits_of_rover(limits: Iterable[Limit], description: RoverDescription, rover: Rover) -> tuple[Limit, ...]:
    """Limits with those of the rover in place: sinkage a third of the wheel radius, tilt its steepest slope.

    A limit that has this value already stays as it is. Both are assumed of the twin: no rover file has them.
    """
    own = _own(description, rover)
    return tuple(_replaced(limit, *own[limit.quantity]) if limit.quantity in own else limit for limit in limits)


def laxer(limits: Iterable[Limit], description: RoverDescription, rover: Rover) -> list[str]:
    """Where limits allow more than those of the rover do: `sinkage_m 0.05 > 0.025`."""
    own = _own(description, rover)
    return [
        f"{limit.quantity} {limit.limit:g} > {own[limit.quantity][0]:g}"
        for limit in limits
        if limit.quantity in own and limit.limit > own[limit.quantity][0] * (1 + 1e-9)
    ]


def _own(description: RoverDescription, rover: Rover) -> dict[str, tuple[float, str]]:
    return {
        "sinkage_m": (SINKAGE_IN_RADII * rover.wheel.radius_m, "a third of the wheel radius"),
        "tilt_deg": (
            read_mobility(description, rover).max_slope_deg,
            "the steepest slope of the rover's limits, taken as a limit of the tilt",
        ),
    }


def _replaced(limit: Limit, value: float, source: str) -> Limit:
    if math.isclose(limit.limit, value, rel_tol=1e-9):
        return limit
    return replace(limit, limit=value, source=source, assumed=True)
