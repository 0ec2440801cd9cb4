"""The choice among drives: all are driven on the same soils, hopeless ones stop early, the best are driven again."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

from lunarsci.errors import ParameterError
from lunarsci.twin.choice.chances import Verdicts, Weakest, verdicts
from lunarsci.twin.choice.conditions import Conditions, drive_candidates, joined
from lunarsci.twin.judgement.energy import expected_energy_j
from lunarsci.twin.judgement.keeping import Chance, extremes, least_drives, least_of_95
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.ensemble import Prediction

Progress = Callable[[int, int], None]
Preference: TypeAlias = Literal["energy", "length", "time", "risk"]

ROUNDS = (0.25, 0.5, 1.0)
"""Shares of the soils after which hopeless candidates stop; a quarter of 64 is a group of the simulation. Assumed."""
LEAST_LEFT = 8
"""So many candidates are driven on all soils, where there are so many."""
ALIKE = 0.01
"""Drives whose energy, length or time differ by this share are alike; assumed."""
CHECKED = 4
"""So many of the best are driven again on fresh soils at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveCandidate:
    """A drive among others.

    Attributes
    ----------
    number : in the order in which candidates were given, from 1.
    plan, prediction : what is driven, and the drives on the soils that all candidates share.
    chance : of failing on these.
    promise : of failing on fresh soils, which had no part in choosing it; None where it was not driven on these.
    weakest : where it comes nearest to a limit, on the fresh soils where it was driven on these.
    broken : each limit that its drives break, on the same soils, that which most of them break first.
    energy_j : work of all wheels, the mean of the drives that ended; NaN where none did. [J]
    duration_s : of the plan. [s]
    stopped : whether it was given up before it had been driven on all soils.
    pareto : whether no other candidate has less risk, length and energy at once.
    """

    number: int
    plan: Plan
    prediction: Prediction = field(repr=False)
    chance: Chance
    promise: Chance | None = None
    weakest: Weakest
    broken: tuple[Weakest, ...] = ()
    energy_j: float
    duration_s: float
    stopped: bool = False
    pareto: bool = False

    @property
    def length_m(self) -> float:
        """Of the plan. [m]"""
        return self.plan.length_m

    @property
    def said(self) -> Chance:
        """The chance to go by: that on fresh soils, where there is one."""
        return self.chance if self.promise is None else self.promise

    @property
    def least_charge(self) -> float | None:
        """Of the battery, what 95 % of the drives keep, below 0 where it runs empty; None where it does not count."""
        if self.prediction.power is None:
            return None
        return least_of_95(extremes(self.prediction, "battery_charge"))

    def dominates(self, other: "DriveCandidate") -> bool:
        """Whether it has no more risk, length and energy than another, and less of one."""
        own, others = self._aims, other._aims
        return all(a <= b for a, b in zip(own, others, strict=True)) and own != others

    @property
    def _aims(self) -> tuple[float, float, float]:
        return self.said.risk, round(self.length_m, 3), math.inf if math.isnan(self.energy_j) else self.energy_j

    def to_dict(self) -> dict[str, Any]:
        """For a result."""
        worst = self.weakest
        return {
            "number": self.number,
            "name": self.plan.name,
            "length_m": self.length_m,
            "duration_s": self.duration_s,
            "energy_j": self.energy_j,
            "localisation_updates": 0 if self.plan.fixes is None else len(self.plan.legs) - 1,
            "screened": self.chance.to_dict(),
            "promised": None if self.promise is None else self.promise.to_dict(),
            "worst": {
                "quantity": worst.quantity, "unit": worst.unit, "value": worst.value, "limit": worst.limit,
                "failed": worst.failed, "x_m": worst.x_m, "y_m": worst.y_m, "distance_m": worst.distance_m,
                "why": worst.why,
            },
            "least_charge": self.least_charge,
            "stopped_early": self.stopped,
            "pareto": self.pareto,
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveChoice:
    """Candidates, the best first.

    Attributes
    ----------
    candidates : first those that keep the risk on fresh soils, by what is preferred; then those that seem to on the
        soils that all share; then the others, by their risk.
    risk : chance of failing that is accepted. [-]
    prefer : what decides among those that keep it.
    fresh : whether the promises are of soils that had no part in the choice.
    """

    candidates: tuple[DriveCandidate, ...]
    risk: float
    prefer: Preference
    fresh: bool

    @property
    def best(self) -> DriveCandidate:
        """The one to take, or the safest where none is feasible."""
        return self.candidates[0]

    @property
    def feasible(self) -> bool:
        """Whether a candidate keeps the risk on soils that it was not chosen by."""
        return self.best.promise is not None and self.best.promise.risk <= self.risk

    @property
    def front(self) -> tuple[DriveCandidate, ...]:
        """Those that no other candidate beats in risk, length and energy at once."""
        return tuple(one for one in self.candidates if one.pareto)

    @property
    def obstacles(self) -> tuple[tuple[str, int], ...]:
        """Where none is feasible, what the candidates break most, and how many of them do, the most frequent first."""
        counts: dict[str, int] = {}
        for one in self.candidates:
            if one.said.risk > self.risk:
                counts[one.weakest.quantity] = counts.get(one.weakest.quantity, 0) + 1
        return tuple(sorted(counts.items(), key=lambda pair: -pair[1]))


def choose(
    plans: Sequence[Plan],
    conditions: Conditions,
    *,
    risk: float,
    prefer: Preference = "energy",
    members: int | None = None,
    racing: bool = True,
    progress: Progress | None = None,
) -> DriveChoice:
    """Drive all plans over the same soils, and rank them under a limit of the chance of failing.

    Parameters
    ----------
    plans : each with its limits, to the same target; a limit on `endpoint_miss_m` is the tolerance of its end.
    conditions : soils and grounds; the first `members` are those by which plans are chosen, the others fresh ones on
        which the chosen are driven again.
    risk : chance of failing that is accepted, 0 to 1. [-]
    prefer : among plans that keep it that with the least energy, length, time or risk is the best. Of those that are
        alike, see `ALIKE`, that with the least risk is better.
    members : soils by which plans are chosen; None for all, and then promises are of these same soils.
    racing : stop hopeless candidates after a quarter and half of the soils.
    progress : called with drives done and drives at most, but for those that only a failure of the best asks for.

    The chance of the best of many looks better than it is, so it is counted again on fresh soils, and promised only
    then. Raises ParameterError.
    """
    if not plans:
        raise ParameterError("no plans to choose from; give one or more")
    least = least_drives(risk)
    count = conditions.members if members is None else members
    if not least <= count <= conditions.members:
        raise ParameterError(f"members is {count}; a risk of {risk:g} needs {least} or more, of {conditions.members}")
    again = min(CHECKED, len(plans)) * (conditions.members - count)
    race = _Race(conditions, risk, prefer, count, progress, len(plans) * count + again)
    checked = race.checked(race.run(plans, racing=racing))
    if progress is not None:
        progress(race.total, race.total)
    ordered = ranked(_with_front(checked), risk, prefer)
    return DriveChoice(candidates=tuple(ordered), risk=risk, prefer=prefer, fresh=conditions.members > count)


@dataclass(slots=True)
class _Race:
    """Drives of candidates in rounds, and how many of them were done."""

    conditions: Conditions
    risk: float
    prefer: Preference
    members: int
    progress: Progress | None
    total: int
    done: int = 0

    def run(self, plans: Sequence[Plan], *, racing: bool) -> list[DriveCandidate]:
        """All candidates, those given up with the drives that they had."""
        alive, out = list(range(len(plans))), list[DriveCandidate]()
        parts: dict[int, list[Prediction]] = {number: [] for number in alive}
        stops = [math.ceil(share * self.members) for share in (ROUNDS if racing else ROUNDS[-1:])]
        first = 0
        found: list[DriveCandidate] = []
        for last in dict.fromkeys(stops):
            driven = self._drive([plans[number] for number in alive], range(first, last))
            for number, part in zip(alive, driven, strict=True):
                parts[number].append(part)
            found = [self._candidate(number, joined(parts[number])) for number in alive]
            first = last
            if last < self.members:
                left, stopped = self._left(found)
                out += [replace(one, stopped=True) for one in stopped]
                alive = [one.number - 1 for one in left]
        return sorted([*found, *out], key=lambda one: one.number)

    def checked(self, found: list[DriveCandidate]) -> list[DriveCandidate]:
        """The same, the best of them driven on fresh soils, as many as it takes for one that keeps the risk."""
        order = ranked((one for one in found if not one.stopped), self.risk, self.prefer)
        fresh = range(self.members, self.conditions.members)
        done: dict[int, DriveCandidate] = {}
        for first in range(0, len(order), CHECKED):
            batch = order[first : first + CHECKED]
            if first and batch[0].chance.risk > self.risk:
                break
            for one in self._on_fresh(batch, fresh):
                done[one.number] = one
            if any(one.said.risk <= self.risk for one in done.values()):
                break
        return [done.get(one.number, one) for one in found]

    def _on_fresh(self, batch: list[DriveCandidate], fresh: range) -> list[DriveCandidate]:
        if not fresh:
            return [replace(one, promise=one.chance) for one in batch]
        driven = self._drive([one.plan for one in batch], fresh)
        held = [verdicts(prediction) for prediction in driven]
        return [
            replace(one, promise=own.chance, weakest=own.weakest, broken=own.broken)
            for one, own in zip(batch, held, strict=True)
        ]

    def _drive(self, plans: list[Plan], members: range) -> list[Prediction]:
        begun = self.done

        def on(done: int, _: int) -> None:
            self.done = begun + done * len(members)
            if self.progress is not None:
                self.progress(min(self.done, self.total), self.total)

        return drive_candidates(self.conditions, plans, members, on)

    def _candidate(self, number: int, prediction: Prediction) -> DriveCandidate:
        held: Verdicts = verdicts(prediction)
        return DriveCandidate(
            number=number + 1,
            plan=prediction.plan,
            prediction=prediction,
            chance=held.chance,
            weakest=held.weakest,
            broken=held.broken,
            energy_j=expected_energy_j(prediction),
            duration_s=make_schedule(prediction.plan, prediction.rover).duration_s,
        )

    def _left(self, found: list[DriveCandidate]) -> tuple[list[DriveCandidate], list[DriveCandidate]]:
        """Candidates that go on, and those that stop.

        One stops whose risk is surely, with 95 % each, above what is accepted and above that of the safest. Of the
        others the better half goes on, and no less than eight; and those of the worse half that no better one beats in
        risk, length and energy.
        """
        bound = max(self.risk, min(one.chance.high for one in found))
        order = ranked(found, self.risk, self.prefer)
        hopeful = [one for one in order if one.chance.low <= bound]
        half = max(LEAST_LEFT, math.ceil(len(found) / 2))
        left = hopeful[:half]
        left += [one for one in hopeful[half:] if not any(other.dominates(one) for other in left)]
        going = {one.number for one in left}
        return sorted(left, key=lambda one: one.number), [one for one in found if one.number not in going]


def ranked(found: Iterable[DriveCandidate], risk: float, prefer: Preference) -> list[DriveCandidate]:
    """The best first: promised, then likely to keep the risk, then the others by their risk; NaN energies last.

    Of those that keep it, what is alike is told apart by risk, and then by time: what lies within `ALIKE` of the best,
    and then each further step of that size.
    """
    candidates = list(found)
    stages = {one.number: int(one.promise is None) if one.said.risk <= risk else 2 + one.stopped for one in candidates}
    least = dict[int, float]()
    for one in candidates:
        stage = stages[one.number]
        least[stage] = min(least.get(stage, math.inf), _wanted(one, prefer))

    def order(one: DriveCandidate) -> tuple[int, float, float, float, float, int]:
        stage = stages[one.number]
        steps = _steps(_wanted(one, prefer), least[stage])
        beyond = one.said.risk if stage > 1 else 0.0
        return stage, beyond, steps, one.said.risk, one.duration_s, one.number

    return sorted(candidates, key=order)


def _wanted(one: DriveCandidate, prefer: Preference) -> float:
    """What shall be least; infinite where it is not known."""
    wanted = {"energy": one.energy_j, "length": one.length_m, "time": one.duration_s, "risk": one.said.risk}[prefer]
    return math.inf if math.isnan(wanted) else wanted


def _steps(wanted: float, least: float) -> float:
    """Whole steps of `ALIKE` from the least to what is wanted; the number itself where the least is nothing."""
    if least <= 0 or math.isinf(wanted):
        return wanted
    return math.floor(math.log(wanted / least) / math.log1p(ALIKE))


def _with_front(found: list[DriveCandidate]) -> list[DriveCandidate]:
    """The candidates, with those marked that no other one driven on all soils beats."""
    whole = [one for one in found if not one.stopped]
    return [replace(one, pareto=not one.stopped and not any(other.dominates(one) for other in whole)) for one in found]
