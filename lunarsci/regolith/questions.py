"""Numbers that would be likely in another unit: what to ask of whoever wrote them, and where the answer goes.

A number is set against the law of what such numbers are, as it is written and as it would be in other units. Another
reading is held for as likely beforehand as one file in a hundred. Where it is the likelier after all, a question is
asked. A number that no unit explains is asked about where it is rarer than a slip of any size would be.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lunarsci.regolith.prior import Law

SLIPS = 0.01
"""Odds of another unit, or of a digit too many or too few, before a number is looked at; assumed."""
AS_WRITTEN = "--as-written"
"""The option that takes all numbers as they are."""
DECADES = 6.0
"""Over which a slip of any size is taken to be even, in the logarithm; assumed."""


@dataclass(frozen=True, slots=True)
class Question:
    """A doubt about a number that its user can settle.

    Attributes
    ----------
    quantity, value : as it is written.
    usual : the middle of what such numbers are.
    likely_unit : in which it would be likely; '' where none explains it.
    option : what settles it.
    """

    quantity: str
    value: float
    usual: float
    likely_unit: str
    option: str

    @property
    def doubt(self) -> str:
        """What to ask, without what settles it."""
        likely = f"is it in {self.likely_unit}?" if self.likely_unit else "is it meant so?"
        return f"{self.quantity} is {self.value:.3g}, where about {self.usual:.3g} is usual; {likely}"

    def __str__(self) -> str:
        return f"{self.doubt} ({self.option})"


def asked_in(questions: "Sequence[Question]") -> dict[str, Any]:
    """The key `questions` of a result; nothing where nothing is asked."""
    return {"questions": [asdict(one) for one in questions]} if questions else {}


def question(
    quantity: str, value: float, law: Law, units: Mapping[str, float], option: str = AS_WRITTEN
) -> Question | None:
    """What to ask of a number; None where it is most likely as it is written. 0 has no unit.

    Parameters
    ----------
    law : of what such numbers are.
    units : the others by name, each with the size of one of them in the unit that is meant.
    option : what settles it.
    """
    if not value:
        return None
    own, readings = law.ln_density(value), {name: law.ln_density(value * size) for name, size in units.items()}
    likely = max(readings, key=lambda name: readings[name], default="")
    explained = bool(likely) and math.log(SLIPS) + readings[likely] > own
    if not explained and own > math.log(SLIPS) - math.log(DECADES * math.log(10.0)):
        return None
    return Question(quantity, value, law.median, likely if explained else "", option)
