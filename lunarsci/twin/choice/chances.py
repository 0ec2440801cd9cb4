"""The chance that a drive keeps all its limits, counted over soils, and where it comes nearest to breaking one."""

import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.twin.judgement.keeping import CONFIDENCE, Chance, broken, limited, limits_judged
from lunarsci.twin.plans.plan import Limit
from lunarsci.twin.simulation.ensemble import Prediction

UNFINISHED = "unfinished"


@dataclass(frozen=True, slots=True)
class Weakest:
    """Where the drives of a plan come nearest to a limit, or break it.

    Attributes
    ----------
    quantity, unit : the limit that most drives break, or else the one that they come nearest to; `unfinished`, with the
        outcome as `unit`, where most did not end.
    value, limit : what 95 % of the drives keep there, and the limit.
    failed : drives that break it anywhere.
    x_m, y_m, distance_m : where: mean place of the drives, and how far the plan then is. [m]
    """

    quantity: str
    unit: str
    value: float
    limit: float
    failed: int
    x_m: float
    y_m: float
    distance_m: float

    @property
    def why(self) -> str:
        """One sentence."""
        if self.quantity == UNFINISHED:
            return f"{self.failed} drive{'s end' if self.failed > 1 else ' ends'} early: {self.unit}"
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"95 % of the drives keep {self.quantity} {self.value:.3g}{unit}, limit {self.limit:.4g}{unit}"

    @property
    def short(self) -> str:
        """What is beyond its limit, and in how many drives."""
        if self.quantity == UNFINISHED:
            return f"{self.failed} drives end early"
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.quantity} {self.value:.3g} of {self.limit:.3g}{unit} ({self.failed} drives)"


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Each drive of a prediction held against the limits of its plan.

    Attributes
    ----------
    kept : drives that ended and kept every limit. (members,)
    weakest : where they come nearest to a limit.
    broken : each limit that drives break, that which most of them break first.
    """

    kept: BoolArray
    weakest: Weakest
    broken: tuple[Weakest, ...] = ()

    @property
    def chance(self) -> Chance:
        """Of failing."""
        return Chance(int((~self.kept).sum()), self.kept.size)


def verdicts(prediction: Prediction) -> Verdicts:
    """Whether each drive kept every limit of the plan, and where they are in danger.

    A limit on `endpoint_miss_m` is the tolerance of the end. Drives are kept as `lunarsci.twin.judgement.keeping.kept`
    has it. Raises ParameterError for a plan without limits.
    """
    if not prediction.plan.limits and not prediction.plan.exclusion_zones:
        raise ParameterError("the plan has no limits, so there is no chance of keeping them; give it some")
    kept = prediction.finished.copy()
    places = [_unfinished(prediction)] if not kept.all() else []
    for limit in limits_judged(prediction):
        values = limited(prediction, limit.quantity)
        beyond = broken(limit, values) & prediction.reached
        kept &= ~beyond.any(axis=1)
        places.append(_place(prediction, limit, _use(prediction, limit, values), values, int(beyond.any(axis=1).sum())))
    places.sort(key=lambda pair: pair[0], reverse=True)
    return Verdicts(kept, places[0][1], tuple(place for _, place in places if place.failed))


def _use(prediction: Prediction, limit: Limit, values: FloatArray) -> FloatArray:
    """Share of a limit that is used up at every sample, above 1 where it is broken. (members, samples)

    Samples that were not reached use nothing.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        if limit.sense == "at most":
            use = values / limit.limit
        else:
            use = np.where(broken(limit, values), np.inf, limit.limit / np.where(values > 0, values, np.inf))
    return np.where(prediction.reached & ~np.isnan(values), use, 0.0)


def _place(
    prediction: Prediction, limit: Limit, use: FloatArray, values: FloatArray, failed: int
) -> tuple[tuple[int, float], Weakest]:
    """How bad it is, for comparison, and the sample at which the use that 95 % of the drives keep is largest."""
    order = np.argsort(use, axis=0)
    rank = math.ceil(CONFIDENCE * len(use)) - 1
    kept = np.take_along_axis(use, order[rank : rank + 1], axis=0)[0]
    sample = int(kept.argmax())
    member = int(order[rank, sample])
    x, y = prediction.places_m[:, sample].mean(axis=0)
    weakest = Weakest(
        limit.quantity, limit.unit, float(values[member, sample]), limit.limit, failed, float(x), float(y),
        float(prediction.distance_m[sample]),
    )  # fmt: skip
    return (failed, float(kept[sample])), weakest


def _unfinished(prediction: Prediction) -> tuple[tuple[int, float], Weakest]:
    """Where drives end early, the one in the middle of them."""
    stopped: IntArray = np.flatnonzero(~prediction.finished)
    last = np.maximum(prediction.recorded[stopped], 1) - 1
    member = int(stopped[np.argsort(last)[len(last) // 2]])
    sample = int(max(prediction.recorded[member], 1) - 1)
    x, y = prediction.places_m[member, sample]
    weakest = Weakest(
        UNFINISHED, prediction.outcome_text(member), math.nan, math.nan, stopped.size, float(x), float(y),
        float(prediction.distance_m[sample]),
    )  # fmt: skip
    return (stopped.size, math.inf), weakest
