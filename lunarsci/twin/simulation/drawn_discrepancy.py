"""What each member of an ensemble was moved by, as the twin's physics is off."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy

__all__ = ["DrawnDiscrepancy"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnDiscrepancy:
    """Draws of a discrepancy.

    Attributes
    ----------
    law : they were drawn from.
    offsets_m : how far from its path each member is taken to be. (members, samples, 2) [m]
    shares : of wheel states, by quantity: what each member's were multiplied by, less 1. (members,) [-]
    """

    law: PhysicsDiscrepancy
    offsets_m: FloatArray
    shares: Mapping[str, FloatArray]
