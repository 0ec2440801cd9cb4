"""The chance that a drive keeps all its limits, counted over soils, and where it comes nearest to breaking one."""

import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.twin.judgement.keeping import broken, limited, limits_judged
from lunarsci.twin.plans.plan import Limit
from lunarsci.twin.simulation.ensemble import Prediction

CONFIDENCE = 0.95
"""Of each of the two bounds of a chance; assumed."""
UNFINISHED = "unfinished"


@dataclass(frozen=True, slots=True)
class Chance:
    """Chance of failing, of so many drives that did.

    Attributes
    ----------
    failed, drives : how many of how many broke a limit or did not end.

    With the law of Jeffreys, Beta(failed + 1/2, drives - failed + 1/2): its mean is what is promised, its quantiles 5 %
    and 95 % are the bounds (Brown, Cai & DasGupta 2001, Statist. Sci. 16, 101, 10.1214/ss/1009213286). These hold the
    number of drives alone, not what soils, ground and physics of the twin are wrong about beyond what was drawn.
    """

    failed: int
    drives: int

    def __post_init__(self) -> None:
        if not 0 <= self.failed <= self.drives or self.drives < 1:
            raise ParameterError(f"{self.failed} of {self.drives} drives failed; give at least one, and no more failed")

    @property
    def risk(self) -> float:
        """Chance of failing, the mean of its law. [-]"""
        return (self.failed + 0.5) / (self.drives + 1.0)

    @property
    def low(self) -> float:
        """It is above this with 95 %. [-]"""
        return self._quantile(1.0 - CONFIDENCE) if self.failed else 0.0

    @property
    def high(self) -> float:
        """It is below this with 95 %. [-]"""
        return self._quantile(CONFIDENCE) if self.failed < self.drives else 1.0

    def _quantile(self, share: float) -> float:
        from scipy.special import betaincinv

        return float(betaincinv(self.failed + 0.5, self.drives - self.failed + 0.5, share))

    def to_dict(self) -> dict[str, float]:
        """For a result."""
        return {
            "drives": self.drives, "failed": self.failed, "probability": 1.0 - self.risk, "risk": self.risk,
            "risk_low": self.low, "risk_high": self.high,
        }  # fmt: skip


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
        return f"95 % of the drives keep {self.quantity} {self.value:.3g}{unit}, limit {self.limit:g}{unit}"


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Each drive of a prediction held against the limits of its plan.

    Attributes
    ----------
    kept : drives that ended and kept every limit. (members,)
    weakest : where they come nearest to a limit.
    """

    kept: BoolArray
    weakest: Weakest

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
    return Verdicts(kept, max(places, key=lambda pair: pair[0])[1])


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
