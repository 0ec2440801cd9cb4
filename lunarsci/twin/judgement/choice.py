"""The choice among drives to a target: all are driven on the same soils, grounds and errors, each is held against its
limits, hopeless ones stop early, and the best are driven again on fresh soils.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray, spans
from lunarsci.errors import ParameterError
from lunarsci.names import counted
from lunarsci.parallel.blocks import run_blocks, shared_out
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.result import Progress
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.energy import expected_energy_j
from lunarsci.twin.judgement.keeping import broken, extremes, limited, limits_judged
from lunarsci.twin.judgement.quantities import least_of_95
from lunarsci.twin.lanes import GROUP
from lunarsci.twin.plans.path import make_schedule, planned_pose
from lunarsci.twin.plans.plan import AT_LEAST, Leg, Limit, Plan
from lunarsci.twin.plans.risk import CONFIDENCE, AcceptedRisk, Chance
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import DrawnDiscrepancy, PowerState, Prediction, predict
from lunarsci.twin.simulation.members import Grounds

SHARED = ("rover", "terrain", "plan", "grounds", "before", "power")
"""Fields of a prediction that need not come back from where it was computed."""
UNFINISHED = "unfinished"
"""Stands for a limit's quantity where drives did not end."""
ROUNDS = (0.25, 0.5, 1.0)
"""Shares of the soils after which hopeless candidates stop: as soils double, half of the candidates go on (successive
halving: Jamieson & Talwalkar 2016, Proc. Mach. Learn. Res. 51, 240)."""
LEAST_LEFT = 8
"""So many candidates are driven on all soils, where there are so many."""
ALIKE = 0.01
"""Drives whose energy, length or time differ by this share are alike; assumed."""
MOST_SLIP = 0.8
"""That commands make up for, uphill or down; assumed."""
CHECKED = 4
"""So many of the best are driven again on fresh soils at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class _SomeGrounds:
    """Some members of other `Grounds`.

    Attributes
    ----------
    whole : the grounds of all members.
    numbers : of the members here in these. (members,)
    parameters : as in `Grounds`, of the members here. (members,)
    """

    whole: Grounds
    numbers: Sequence[int]
    parameters: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(next(iter(self.parameters.values())))

    def terrain(self, member: int) -> Terrain:
        return self.whole.terrain(self.numbers[member])

    def only(self, member: int) -> "_SomeGrounds":
        some = slice(member, member + 1)
        return _SomeGrounds(self.whole, self.numbers[some], {n: v[some] for n, v in self.parameters.items()})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """What the drives of an ensemble meet, whichever plan they follow.

    Attributes
    ----------
    rover, terrain : what drives where.
    samples : soil of each member, by parameter; that of `grounds` where each has a ground of its own. (members,)
    grounds : a terrain for each member; None where samples lie everywhere.
    draws : what the ground of each member is drawn by, where heights have errors.
    discrepancy : what the twin's physics is off by; None leaves it out.
    ruts, before, time_step_s, sample_m : as for `predict`.
    power : battery and light, where these count.
    seed : of errors of position fixes and of the discrepancy.
    """

    rover: Rover
    terrain: Terrain
    samples: Mapping[str, FloatArray]
    grounds: Grounds | None = None
    draws: FloatArray | None = None
    discrepancy: PhysicsDiscrepancy | None = None
    ruts: bool | BoolArray = False
    before: Plan | None = None
    seed: int = 0
    time_step_s: float = 0.1
    sample_m: float = 0.1
    power: PowerState | None = None

    @property
    def members(self) -> int:
        """How many soils there are."""
        return len(next(iter(self.samples.values())))

    def some(self, numbers: list[int]) -> "Conditions":
        """Those of some members."""
        samples = {name: values[numbers] for name, values in self.samples.items()}
        grounds = None if self.grounds is None else _SomeGrounds(self.grounds, numbers, samples)
        draws = None if self.draws is None else self.draws[numbers]
        ruts = np.broadcast_to(self.ruts, (self.members,))[numbers]
        return replace(self, samples=samples, grounds=grounds, draws=draws, ruts=ruts)

    def drive(self, plan: Plan, members: range) -> Prediction:
        """Some members along a plan. Each such part draws its own errors of fixes and discrepancy."""
        some = slice(members.start, members.stop)
        samples = {name: values[some] for name, values in self.samples.items()}
        seed = int(np.random.SeedSequence([self.seed, members.start]).generate_state(1)[0])
        soils: dict[str, Any] = {"samples": samples}
        if self.grounds is not None:
            soils = {"grounds": _SomeGrounds(self.grounds, members, samples)}
        driven = predict(
            self.rover,
            self.terrain,
            plan,
            **soils,
            seed=seed,
            time_step_s=self.time_step_s,
            sample_m=self.sample_m,
            ruts=np.broadcast_to(self.ruts, (self.members,))[some],
            before=self.before,
            draws=None if self.draws is None else self.draws[some],
        )
        driven = driven if self.discrepancy is None else with_discrepancy(driven, self.discrepancy, seed)
        return dataclasses.replace(driven, power=self.power)


@dataclass(frozen=True, slots=True, eq=False)
class CandidateDrives:
    """Drives of some members along each of some plans: what `run_blocks` shares out, a row for each plan.

    Attributes
    ----------
    conditions : what the drives meet.
    plans : what is driven; a block is of their numbers, from 0.
    members : numbers of the members of `conditions` that drive.
    """

    conditions: Conditions
    plans: Sequence[Plan]
    members: range

    def __call__(self, block: range) -> list[dict[str, Any]]:
        """What the predictions of a block of plans do not share."""
        names = [field.name for field in dataclasses.fields(Prediction) if field.name not in SHARED]
        driven = [self.conditions.drive(self.plans[number], self.members) for number in block]
        return [{name: getattr(one, name) for name in names} for one in driven]


def drive_candidates(
    conditions: Conditions, plans: Sequence[Plan], members: range, progress: Progress | None = None
) -> list[Prediction]:
    """Some members along every plan, in threads or on a cluster; they depend on nothing else. In the order of plans."""
    work = CandidateDrives(conditions, plans, members)
    candidates: dict[int, Prediction] = {}
    some, grounds = slice(members.start, members.stop), conditions.grounds
    for block, parts in run_blocks(work, spans(len(plans), shared_out(len(plans), 1)), progress=progress):
        for number, part in zip(block, parts, strict=True):
            samples = {name: values[some] for name, values in conditions.samples.items()}
            candidates[number] = Prediction(
                rover=conditions.rover,
                terrain=conditions.terrain,
                plan=plans[number],
                grounds=None if grounds is None else _SomeGrounds(grounds, members, samples),
                before=conditions.before,
                power=conditions.power,
                **part,
            )
    return [candidates[number] for number in range(len(plans))]


def joined(parts: Sequence[Prediction]) -> Prediction:
    """Predictions of successive members along one plan as one."""
    if len(parts) == 1:
        return parts[0]

    def whole(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    first = parts[0]
    soils = {name: np.concatenate([part.parameters[name] for part in parts]) for name in first.parameters}
    arrays = {name: whole(name) for name in ("paths", "states", "recorded", "outcome", "finer", "ruts")}
    draws, steered = (None if getattr(first, name) is None else whole(name) for name in ("draws", "steered"))
    grounds = first.grounds
    if isinstance(grounds, _SomeGrounds):
        numbers = range(grounds.numbers[0], grounds.numbers[0] + len(next(iter(soils.values()))))
        grounds = _SomeGrounds(grounds.whole, numbers, soils)
    return dataclasses.replace(
        first,
        **arrays,
        parameters=soils,
        draws=draws,
        steered=steered,
        grounds=grounds,
        discrepancy=_joined_discrepancy(parts),
    )


def _joined_discrepancy(parts: Sequence[Prediction]) -> DrawnDiscrepancy | None:
    """Draws of successive members as one; None where the predictions have none."""
    drawn = [part.discrepancy for part in parts if part.discrepancy is not None]
    if not drawn:
        return None
    shares = {name: np.concatenate([one.shares[name] for one in drawn]) for name in drawn[0].shares}
    return DrawnDiscrepancy(law=drawn[0].law, offsets_m=np.concatenate([one.offsets_m for one in drawn]), shares=shares)


@dataclass(frozen=True, slots=True)
class Weakest:
    """Where the drives of a plan come nearest to a limit, or break it.

    Attributes
    ----------
    quantity, unit : the limit that most drives break, or else the one that they come nearest to; `unfinished`, with the
        outcome as `unit`, where most did not end.
    value, limit : what 95 % of the drives keep there, and the limit.
    failed : drives that break it anywhere.
    x_m, y_m, distance_m : where on the planned way, and how far along it. [m]
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
        return self.in_words(self.quantity, "" if self.unit == "-" else f" {self.unit}")

    def in_words(self, name: str, unit: str, factor: float = 1.0) -> str:
        """How far 95 % of the drives come, beside the limit, in some unit."""
        side = "above" if self.quantity in AT_LEAST else "below"
        reached, limit = f"{factor * self.value:.3g}{unit}", f"{factor * self.limit:.4g}{unit}"
        return f"{name}: 95 % of the drives stay {side} {reached}; the limit is {limit}"

    @property
    def short(self) -> str:
        """What is beyond its limit, and in how many drives."""
        if self.quantity == UNFINISHED:
            return f"{counted(self.failed, 'drive')} end{'s' * (self.failed == 1)} early"
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.quantity} {self.value:.3g}{unit}, limit {self.limit:.3g}{unit} ({counted(self.failed, 'drive')})"


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Each drive of a prediction held against the limits of its plan.

    Attributes
    ----------
    keeps : drives that ended and kept every limit. (members,)
    weakest : where they come nearest to a limit.
    broken : each limit that drives break, that which most of them break first.
    """

    keeps: BoolArray
    weakest: Weakest
    broken: tuple[Weakest, ...] = ()

    @property
    def chance(self) -> Chance:
        """Of failing."""
        return Chance(int((~self.keeps).sum()), self.keeps.size)


def verdicts(prediction: Prediction) -> Verdicts:
    """Whether each drive kept every limit of the plan, and where they are in danger.

    A limit on `endpoint_miss_m` is the tolerance of the end, others are those of `keeping.keeps_limits`.
    Raises ParameterError for a plan without limits.
    """
    if not prediction.plan.limits and not prediction.plan.exclusion_zones:
        raise ParameterError("the plan has no limits, so there is no chance of keeping them; give it some")
    keeps = prediction.finished.copy()
    places = [_unfinished(prediction)] if not keeps.all() else []
    for limit in limits_judged(prediction):
        values = limited(prediction, limit.quantity)
        beyond = broken(limit, values) & prediction.reached
        keeps &= ~beyond.any(axis=1)
        places.append(_place(prediction, limit, _use(prediction, limit, values), values, int(beyond.any(axis=1).sum())))
    places.sort(key=lambda pair: pair[0], reverse=True)
    return Verdicts(keeps, places[0][1], tuple(place for _, place in places if place.failed))


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
    """How bad it is, for comparison, and the sample at which the use that 95 % of the drives keep is largest.

    `use` is of `_use`, `values` the limited quantity (members, samples), `failed` how many drives break the limit. What
    is compared is that number, then the use.
    """
    order = np.argsort(use, axis=0)
    rank = math.ceil(CONFIDENCE * len(use)) - 1
    keeps = np.take_along_axis(use, order[rank : rank + 1], axis=0)[0]
    sample = int(keeps.argmax())
    member = int(order[rank, sample])
    weakest = Weakest(
        limit.quantity, limit.unit, float(values[member, sample]), limit.limit, failed, *_planned_at(prediction, sample)
    )
    return (failed, float(keeps[sample])), weakest


def _planned_at(prediction: Prediction, sample: int) -> tuple[float, float, float]:
    """x, y on the planned way, and the distance along it, at a sample. [m]"""
    distance = float(prediction.distance_m[sample])
    x, y, _ = planned_pose(prediction.plan, distance)
    return float(x), float(y), distance


def _unfinished(prediction: Prediction) -> tuple[tuple[int, float], Weakest]:
    """Where drives end early, the one in the middle of them."""
    stopped: IntArray = np.flatnonzero(~prediction.finished)
    last = np.maximum(prediction.recorded[stopped], 1) - 1
    member = int(stopped[np.argsort(last)[len(last) // 2]])
    sample = int(max(prediction.recorded[member], 1) - 1)
    weakest = Weakest(
        UNFINISHED, prediction.outcome_text(member), math.nan, math.nan, stopped.size, *_planned_at(prediction, sample)
    )
    return (stopped.size, math.inf), weakest


Preference: TypeAlias = Literal["energy", "length", "time", "risk"]
"""What decides among drives that keep the accepted risk: the least of it."""


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
    def stated(self) -> Chance:
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
        some, others = self._aims, other._aims
        return all(a <= b for a, b in zip(some, others, strict=True)) and some != others

    @property
    def _aims(self) -> tuple[float, float, float]:
        return self.stated.risk, round(self.length_m, 3), math.inf if math.isnan(self.energy_j) else self.energy_j

    def to_dict(self) -> dict[str, Any]:
        """For a result."""
        worst = self.weakest
        return {
            "number": self.number,
            "name": self.plan.name,
            "length_m": self.length_m,
            "commanded_m": self.plan.commanded_m,
            "duration_s": self.duration_s,
            "energy_j": self.energy_j,
            "localisation_updates": 0 if self.plan.fixes is None else len(self.plan.legs) - 1,
            "screened": self.chance.to_dict(),
            "promised": None if self.promise is None else self.promise.to_dict(),
            "worst": asdict(worst) | {"why": worst.why},
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
    risk : chance of failing that is accepted.
    prefer : what decides among those that keep it.
    fresh : whether the promises are of soils that had no part in the choice.
    """

    candidates: tuple[DriveCandidate, ...]
    risk: AcceptedRisk
    prefer: Preference
    fresh: bool

    @property
    def best(self) -> DriveCandidate:
        """The one to take, or the safest where none is feasible."""
        return self.candidates[0]

    @property
    def feasible(self) -> bool:
        """Whether a candidate keeps the risk on soils that it was not chosen by."""
        return self.best.promise is not None and self.risk.accepts(self.best.promise)

    @property
    def front(self) -> tuple[DriveCandidate, ...]:
        """Those that no other candidate beats in risk, length and energy at once."""
        return tuple(one for one in self.candidates if one.pareto)

    @property
    def obstacles(self) -> tuple[tuple[str, int], ...]:
        """Where none is feasible, what the candidates break most, and how many of them do, the most frequent first."""
        counts: dict[str, int] = {}
        for one in self.candidates:
            if not self.risk.accepts(one.stated):
                counts[one.weakest.quantity] = counts.get(one.weakest.quantity, 0) + 1
        return tuple(sorted(counts.items(), key=lambda pair: -pair[1]))


def choose(
    plans: Sequence[Plan],
    conditions: Conditions,
    *,
    risk: AcceptedRisk,
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
    risk : chance of failing that is accepted.
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
    count = conditions.members if members is None else members
    if not risk.least_drives <= count <= conditions.members:
        raise ParameterError(
            f"members is {count}; a risk of {risk.share:g} needs {risk.least_drives} or more, of {conditions.members}"
        )
    again = min(CHECKED, len(plans)) * (conditions.members - count)
    race = _Race(conditions, risk, prefer, count, progress, len(plans) * count + again)
    checked = race.checked(race.run(plans, racing=racing))
    if progress is not None:
        progress(race.total, race.total)
    ordered = ranked(_with_front(checked), risk, prefer)
    return DriveChoice(candidates=tuple(ordered), risk=risk, prefer=prefer, fresh=conditions.members > count)


def making_up_for_slip(
    plans: Sequence[Plan], conditions: Conditions, members: int, progress: Progress | None = None
) -> list[Plan]:
    """The plans with commands so long that the median drive gets as far on each leg as the plan does.

    The first plan is driven on the first `members` soils, and all on those where it got as far as in the middle: a
    leg's slip is what the drives there fall short of what rims rolled. How they slip on the longer way is left out.
    """
    first = drive_candidates(conditions, plans[:1], range(members))[0]
    slips = leg_slips(first) @ [leg.length_m for leg in plans[0].legs]
    order = np.flatnonzero(first.finished)[np.argsort(slips, kind="stable")]
    if not order.size:
        return list(plans)
    middle = order[max(0, (order.size - GROUP) // 2) :][:GROUP].tolist()
    driven = drive_candidates(conditions.some(middle), plans, range(len(middle)), progress)
    return [
        replace(plan, legs=tuple(map(_made_up, plan.legs, _medians(prediction))))
        for plan, prediction in zip(plans, driven, strict=True)
    ]


def _made_up(leg: Leg, slip: float) -> Leg:
    return replace(leg, slip_ratio=float(np.clip(slip, -MOST_SLIP, MOST_SLIP)))


def _medians(prediction: Prediction) -> FloatArray:
    slips = leg_slips(prediction)
    return np.asarray(np.median(slips, axis=0) if len(slips) else np.zeros(slips.shape[1]))


def leg_slips(prediction: Prediction) -> FloatArray:
    """Of the drives that ended, the share of each leg's commanded length that is not gone in its direction.

    0 of turns and stops. (drives, legs)
    """
    plan, ended = prediction.plan, prediction.finished
    slips = np.zeros((int(ended.sum()), len(plan.legs)))
    yaw, step = np.radians(prediction.paths[ended, :, 5]), np.diff(prediction.places_m[ended], axis=1)
    travel = 0.5 * (yaw[:, 1:] + yaw[:, :-1])
    begin = 0.0
    for number, leg in enumerate(plan.legs):
        if leg.length_m:
            angle = travel + math.radians(leg.crab_deg)
            gone = np.cumsum(step[..., 0] * np.cos(angle) + step[..., 1] * np.sin(angle), axis=1)
            gone = np.concatenate([np.zeros((len(gone), 1)), gone], axis=1)
            ends = [[np.interp(at, prediction.distance_m, one) for at in (begin, begin + leg.length_m)] for one in gone]
            far = leg.commanded_m
            if prediction.steered is not None and number:
                far = prediction.steered[ended, number, 0] / (1.0 - leg.slip_ratio)
            slips[:, number] = 1.0 - np.reshape(ends, (-1, 2)) @ (-1.0, 1.0) / far
        begin += leg.length_m
    return slips


@dataclass(slots=True)
class _Race:
    """Drives of candidates in rounds, as `choose` has them.

    Attributes
    ----------
    conditions, risk, prefer, progress : as in `choose`.
    members : soils by which plans are chosen, the first ones of `conditions`; the others are fresh.
    total, done : drives at most, and drives so far, for `progress`.
    """

    conditions: Conditions
    risk: AcceptedRisk
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
        candidates: list[DriveCandidate] = []
        for last in dict.fromkeys(stops):
            driven = self._drive([plans[number] for number in alive], range(first, last))
            for number, part in zip(alive, driven, strict=True):
                parts[number].append(part)
            candidates = [self._candidate(number, joined(parts[number])) for number in alive]
            first = last
            if last < self.members:
                left, stopped = self._left(candidates)
                out += [replace(one, stopped=True) for one in stopped]
                alive = [one.number - 1 for one in left]
        return sorted([*candidates, *out], key=lambda one: one.number)

    def checked(self, candidates: list[DriveCandidate]) -> list[DriveCandidate]:
        """The same, the best of them driven on fresh soils, as many as it takes for one that keeps the risk."""
        order = ranked((one for one in candidates if not one.stopped), self.risk, self.prefer)
        fresh = range(self.members, self.conditions.members)
        done: dict[int, DriveCandidate] = {}
        for first in range(0, len(order), CHECKED):
            batch = order[first : first + CHECKED]
            if first and not self.risk.accepts(batch[0].chance):
                break
            for one in self._on_fresh(batch, fresh):
                done[one.number] = one
            if any(self.risk.accepts(one.stated) for one in done.values()):
                break
        return [done.get(one.number, one) for one in candidates]

    def _on_fresh(self, batch: list[DriveCandidate], fresh: range) -> list[DriveCandidate]:
        """Candidates with what they promise on fresh soils, members of that number; on those they had without any."""
        if not fresh:
            return [replace(one, promise=one.chance) for one in batch]
        driven = self._drive([one.plan for one in batch], fresh)
        judged = [verdicts(prediction) for prediction in driven]
        return [
            replace(one, promise=some.chance, weakest=some.weakest, broken=some.broken)
            for one, some in zip(batch, judged, strict=True)
        ]

    def _drive(self, plans: list[Plan], members: range) -> list[Prediction]:
        """Drives of some members along plans, counted."""
        begun = self.done

        def on(done: int, _: int) -> None:
            self.done = begun + done * len(members)
            if self.progress is not None:
                self.progress(min(self.done, self.total), self.total)

        return drive_candidates(self.conditions, plans, members, on)

    def _candidate(self, number: int, prediction: Prediction) -> DriveCandidate:
        judged: Verdicts = verdicts(prediction)
        return DriveCandidate(
            number=number + 1,
            plan=prediction.plan,
            prediction=prediction,
            chance=judged.chance,
            weakest=judged.weakest,
            broken=judged.broken,
            energy_j=expected_energy_j(prediction),
            duration_s=make_schedule(prediction.plan, prediction.rover).duration_s,
        )

    def _left(self, candidates: list[DriveCandidate]) -> tuple[list[DriveCandidate], list[DriveCandidate]]:
        """Candidates that go on, and those that stop.

        One stops whose risk is surely, with 95 % each, above what is accepted and above that of the safest. Of the
        others the better half goes on, and no less than eight; and those of the worse half that no better one beats in
        risk, length and energy.
        """
        bound = max(self.risk.share, min(one.chance.high for one in candidates))
        order = ranked(candidates, self.risk, self.prefer)
        hopeful = [one for one in order if one.chance.low <= bound]
        half = max(LEAST_LEFT, math.ceil(len(candidates) / 2))
        left = hopeful[:half]
        left += [one for one in hopeful[half:] if not any(other.dominates(one) for other in left)]
        going = {one.number for one in left}
        return sorted(left, key=lambda one: one.number), [one for one in candidates if one.number not in going]


def ranked(raced: Iterable[DriveCandidate], risk: AcceptedRisk, prefer: Preference) -> list[DriveCandidate]:
    """The best first: promised, then likely to keep the risk, then the others by their risk; NaN energies last.

    Of those that keep it, what is alike is told apart by risk, and then by time: what lies within `ALIKE` of the best,
    and then each further step of that size.
    """
    candidates = list(raced)
    stages = {
        one.number: int(one.promise is None) if risk.accepts(one.stated) else 2 + one.stopped for one in candidates
    }
    least = dict[int, float]()
    for one in candidates:
        stage = stages[one.number]
        least[stage] = min(least.get(stage, math.inf), _wanted(one, prefer))

    def order(one: DriveCandidate) -> tuple[int, float, float, float, float, int]:
        stage = stages[one.number]
        steps = _steps(_wanted(one, prefer), least[stage])
        beyond = one.stated.risk if stage > 1 else 0.0
        return stage, beyond, steps, one.stated.risk, one.duration_s, one.number

    return sorted(candidates, key=order)


def _wanted(one: DriveCandidate, prefer: Preference) -> float:
    """What shall be least; infinite where it is not known."""
    wanted = {"energy": one.energy_j, "length": one.length_m, "time": one.duration_s, "risk": one.stated.risk}[prefer]
    return math.inf if math.isnan(wanted) else wanted


def _steps(wanted: float, least: float) -> float:
    """Whole steps of `ALIKE` from the least to what is wanted; the number itself where the least is nothing."""
    if least <= 0 or math.isinf(wanted):
        return wanted
    return math.floor(math.log(wanted / least) / math.log1p(ALIKE))


def _with_front(candidates: list[DriveCandidate]) -> list[DriveCandidate]:
    """The candidates, with those marked that no other one driven on all soils beats."""
    whole = [one for one in candidates if not one.stopped]
    return [
        replace(one, pareto=not one.stopped and not any(other.dominates(one) for other in whole)) for one in candidates
    ]
