"""A mission: targets in order, ground to keep out of, hours of communication; and how it is driven leg by leg."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError, within_file
from lunarsci.io.documents import check_keys, number_of, record_of, records_of, toml_of
from lunarsci.io.inputs import Source, read_input
from lunarsci.ranges import FINITE, NOT_NEGATIVE, POSITIVE, check_ranges, refuse
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.judgement.energy import charge_left, stood
from lunarsci.twin.judgement.keeping import broken, in_the_way, limits_judged
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Fixes, Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import PowerState, Prediction

MOST_TARGETS = 100
NUMBERS = ("leg_m", "localisation_s", "time_budget_s", "speed_m_s")
REST_SHARE = 0.3
"""A rest of the way shorter than this share of a leg is driven with the leg before it; assumed."""
MOST_LEGS = 500
CORRECTIONS = 3
"""Legs beyond those of the way, at most, that bring the rover nearer to a target that it has missed; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionTarget:
    """A place to be reached.

    Attributes
    ----------
    name, x_m, y_m : what and where. [m]
    tolerance_m : as near as this is there, > 0. [m]
    stay_s : time that is needed there, >= 0. [s]
    """

    name: str
    x_m: float
    y_m: float
    tolerance_m: float = 0.5
    stay_s: float = 0.0

    def __post_init__(self) -> None:
        names = {FINITE: "x_m y_m", POSITIVE: "tolerance_m", NOT_NEGATIVE: "stay_s"}
        check_ranges(self, names, f"target '{self.name}'")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommWindow:
    """Hours of communication.

    Attributes
    ----------
    begin_s, end_s : from the start of the mission, 0 <= begin < end. [s]
    """

    begin_s: float
    end_s: float

    def __post_init__(self) -> None:
        if not 0 <= self.begin_s < self.end_s < math.inf:
            raise ParameterError(f"a [[window]] from {self.begin_s:g} to {self.end_s:g} s; give 0 <= begin_s < end_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionStart:
    """Pose of the rover's origin at the begin, which is exact.

    Attributes
    ----------
    x_m, y_m : place. [m]
    heading_deg : from x towards y. [deg]
    """

    x_m: float
    y_m: float
    heading_deg: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, {FINITE: "x_m y_m heading_deg"}, "[start]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """Targets in order, and what binds the way to them.

    Attributes
    ----------
    name : what it is.
    start, targets : where it begins, and where it leads.
    keep_outs : circles that no part of the rover may enter.
    fixes : standard errors of the localisation at the end of each leg; the ground is taken as looked at anew.
    leg_m : longest leg, above 0. [m]
    localisation_s : standstill at the end of each leg, >= 0: pictures, their way home, and the next plan. [s]
    time_budget_s : of all legs, halts, waits and stays, > 0; infinite where there is none. [s]
    windows : each leg with its localisation lies within one of these; none for always, else one after the other.
    speed_m_s : None for the rover's highest. [m/s]

    Raises ParameterError.
    """

    name: str
    start: MissionStart
    targets: tuple[MissionTarget, ...]
    fixes: Fixes
    keep_outs: tuple[ExclusionZone, ...] = ()
    windows: tuple[CommWindow, ...] = ()
    leg_m: float = 5.0
    localisation_s: float = 0.0
    time_budget_s: float = math.inf
    speed_m_s: float | None = None

    def __post_init__(self) -> None:
        ranges = {POSITIVE: "leg_m speed_m_s", NOT_NEGATIVE: "localisation_s", "(0, inf]": "time_budget_s"}
        refuse(self._faults())
        check_ranges(self, ranges)

    def _faults(self) -> Iterator[str]:
        """What makes it no mission."""
        if not 1 <= len(self.targets) <= MOST_TARGETS:
            yield f"the mission has {len(self.targets)} [[target]]; give 1 to {MOST_TARGETS}"
        if len({target.name for target in self.targets}) < len(self.targets):
            yield "two targets have one name; name each of them differently"
        if self.fixes.halt_s:
            yield "[fixes] halt_s has no use in a mission; its standstill at a leg's end is localisation_s"
        for one, after in pairwise(self.windows):
            if after.begin_s < one.end_s:
                yield f"the [[window]] from {after.begin_s:g} s begins before the one before it ends"

    def begin_of(self, clock_s: float, needed_s: float) -> float | None:
        """When something of this length can begin, from a time on: None where no window has room for it. [s]"""
        if not self.windows:
            return clock_s
        for window in self.windows:
            begin = max(clock_s, window.begin_s)
            if begin + needed_s <= window.end_s:
                return begin
        return None


def read_mission(source: Source) -> Mission:
    """Read a mission from a TOML file. Raises DataError.

    Keys `name`, `leg_m`, `localisation_s`, `time_budget_s` and `speed_m_s`; tables [start], [fixes], [[target]],
    [[keep_out]] and [[window]], with the attributes of the classes above as keys.
    """
    file = read_input(source)
    with within_file(file.name):
        document = toml_of(file.name, file.data)
        check_keys(document, ("name", *NUMBERS, "start", "fixes", "target", "keep_out", "window"), "a mission")
        return Mission(
            name=str(document.get("name", file.name)),
            start=record_of(MissionStart, document.get("start", {"x_m": 0.0, "y_m": 0.0}), "[start]"),
            fixes=record_of(Fixes, document.get("fixes"), "[fixes]"),
            targets=records_of(MissionTarget, document.get("target", []), "target"),
            keep_outs=records_of(ExclusionZone, document.get("keep_out", []), "keep_out"),
            windows=records_of(CommWindow, document.get("window", []), "window"),
            **{name: number_of(document[name], name) for name in NUMBERS if name in document},
        )


Pose = tuple[float, float, float]
"""x, y and heading of the rover's origin."""
Way = Callable[[Pose, tuple[float, float]], Plan]
"""Finds a plan from a pose to a place, x and y. [m] Raises ParameterError where there is none."""
Drive = Callable[[Plan], Prediction]
"""Drives a plan on all soils."""
Safe = Callable[[Prediction], BoolArray]
"""Which members keep the limits of their plan. (members,)"""
Fate = Literal["reached", "horizon", "no way", "no time", "no window", "no drive", "not tried"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MissionLeg:
    """One leg, as it is expected where the mission goes on as it was drawn.

    Attributes
    ----------
    number, target : of the leg, from 1, and the name of the target that it leads to.
    plan : from where the rover believes to be.
    begin_s, waited_s, drive_s : when it begins, how long was waited for a window before, and how long it takes. [s]
    safe : members that keep all limits on it. (members,)
    ends_m : where members end, with the error of localisation at the begin. (members, 2) [m]
    charge : of the battery at its end; None where that does not count. (members,) [-]
    fixed : pose that the rover believes in after the localisation, of the drawn member. [m, m, deg]
    """

    number: int
    target: str
    plan: Plan
    begin_s: float
    waited_s: float
    drive_s: float
    safe: BoolArray
    ends_m: FloatArray
    fixed: Pose
    charge: FloatArray | None = None

    @property
    def covariance_m2(self) -> FloatArray:
        """Of the ends, before the rover finds out where it is. (2, 2) [m2]"""
        return np.asarray(np.cov(self.ends_m.T)) if len(self.ends_m) > 1 else np.zeros((2, 2))

    @property
    def spread_m(self) -> float:
        """Standard deviation of the ends along the longer axis of their ellipse. [m]"""
        return math.sqrt(max(float(np.linalg.eigvalsh(self.covariance_m2)[-1]), 0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetFate:
    """What becomes of a target.

    Attributes
    ----------
    target, fate : which, and what becomes of it; `why` in a sentence where it is not reached.
    arrival_s : when the rover is there, NaN where it never is. [s]
    safe : members that keep all limits up to there, and end within the tolerance. (members,)
    """

    target: MissionTarget
    fate: Fate
    why: str = ""
    arrival_s: float = math.nan
    safe: BoolArray = field(repr=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrivenMission:
    """A mission as driven.

    Attributes
    ----------
    mission : as given.
    legs : that were driven, in order.
    targets : what became of each target, in order.
    """

    mission: Mission
    legs: tuple[MissionLeg, ...]
    targets: tuple[TargetFate, ...]

    @property
    def reached(self) -> int:
        """How many targets are reached, in order."""
        return sum(one.fate == "reached" for one in self.targets)

    @property
    def safe(self) -> BoolArray:
        """Members that keep the whole mission; none where a target is not reached. (members,)"""
        return self.targets[-1].safe & (self.reached == len(self.targets))

    @property
    def end_s(self) -> float:
        """When the last leg that was driven is over, with the stay at a target. [s]"""
        over = [leg.begin_s + leg.drive_s + self.mission.localisation_s for leg in self.legs]
        over += [one.arrival_s + one.target.stay_s for one in self.targets if one.fate == "reached"]
        return max(over, default=0.0)

    @property
    def waited_s(self) -> float:
        """Time lost in waiting for windows. [s]"""
        return math.fsum(leg.waited_s for leg in self.legs)


def drive_mission(
    mission: Mission,
    rover: Rover,
    way: Way,
    drive: Drive,
    is_safe: Safe,
    *,
    seed: int = 0,
    goal_of: Callable[[MissionTarget], tuple[float, float] | None] = lambda target: None,
    power: PowerState | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DrivenMission:
    """Drive a mission leg by leg.

    Parameters
    ----------
    mission, rover : what to do, and who does it.
    way : a plan from a pose [m, m, deg] to a place. Raises ParameterError where there is none.
    drive : a plan over the same soils each time, so that a member has one soil throughout.
    is_safe : members of such a prediction that keep all limits.
    seed : of the errors of localisation, and of which member goes on.
    power : battery and light at the begin; each member has a battery of its own, which legs, waits and stays draw from.
        None where it does not count.
    goal_of : the place to drive to instead of a target beyond the horizon of known ground; None where it is within.
    progress : called with targets done and targets.

    At the end of each leg the place of one member, drawn from those that have kept all limits so far, with an error of
    localisation, is where the next leg is planned from. All members then go on from there: what they do later does not
    depend on where each of them had come to, only on its soil. Members that broke a limit stay counted as failed. A
    leg is driven whose end the localisation follows at once; both lie within one window of communication.
    """
    state = _Driven(mission, rover, way, drive, is_safe, np.random.default_rng([seed, 31]))
    state.power = power
    fates: list[TargetFate] = []
    for number, target in enumerate(mission.targets):
        if progress is not None:
            progress(number, len(mission.targets))
        if fates and fates[-1].fate != "reached":
            fates.append(TargetFate(target=target, fate="not tried", why="the one before is not reached",
                                    safe=fates[-1].safe & False))  # fmt: skip
            continue
        fates.append(state.to_target(target, goal_of(target)))
    if progress is not None:
        progress(len(mission.targets), len(mission.targets))
    return DrivenMission(mission=mission, legs=tuple(state.legs), targets=tuple(fates))


def first_leg(plan: Plan, leg_m: float) -> tuple[Plan, bool]:
    """The begin of a plan, at most a leg long or with a short rest all of it, and whether that is its end."""
    if plan.length_m <= (1.0 + REST_SHARE) * leg_m:
        return plan, True
    left, legs = leg_m, list[Leg]()
    for leg in plan.legs:
        legs.append(replace(leg, length_m=min(leg.length_m, left)) if leg.length_m else leg)
        left -= leg.length_m
        if left <= 0:
            break
    return replace(plan, legs=tuple(legs)), False


class _Stopped(Exception):
    """The mission ends here: fate and why."""

    def __init__(self, fate: Fate, why: str) -> None:
        super().__init__(why)
        self.fate: Fate = fate


class _Driven:
    """Where a mission is: the pose that the rover believes in, the clock, and members that have kept all limits."""

    def __init__(
        self, mission: Mission, rover: Rover, way: Way, drive: Drive, is_safe: Safe, random: np.random.Generator
    ) -> None:
        self.mission, self.rover, self.random = mission, rover, random
        self.way, self.drive, self.is_safe = way, drive, is_safe
        start = mission.start
        self.pose: Pose = (start.x_m, start.y_m, start.heading_deg)
        self.clock_s, self.legs = 0.0, list[MissionLeg]()
        self.alive: BoolArray | None = None
        self.power: PowerState | None = None
        self.stands: tuple[Prediction, float] | None = None

    def to_target(self, target: MissionTarget, instead: tuple[float, float] | None) -> TargetFate:
        """Legs until the rover believes to be there."""
        goal = (target.x_m, target.y_m) if instead is None else instead
        try:
            self._legs_to(target, goal)
        except _Stopped as stopped:
            return TargetFate(target=target, fate=stopped.fate, why=str(stopped), safe=self._nobody())
        self._stand_until(self.clock_s + target.stay_s)
        arrival, safe = self.clock_s, self._those_there(target, goal)
        if instead is not None:
            far = math.dist(self.pose[:2], (target.x_m, target.y_m))
            why = f"the ground is not known farther; the rover stands {far:.1f} m from it and has to look from there"
            return TargetFate(target=target, fate="horizon", why=why, safe=safe & False)
        if arrival + target.stay_s > self.mission.time_budget_s:
            why = f"its stay would end after {arrival + target.stay_s:.0f} s"
            return TargetFate(target=target, fate="no time", why=why, safe=safe & False)
        self.clock_s += target.stay_s
        return TargetFate(target=target, fate="reached", arrival_s=arrival, safe=safe)

    def _legs_to(self, target: MissionTarget, goal: tuple[float, float]) -> None:
        corrections = 0
        while math.dist(self.pose[:2], goal) > target.tolerance_m:
            if len(self.legs) >= MOST_LEGS:
                raise _Stopped("no way", f"more than {MOST_LEGS} legs; give a longer leg_m")
            try:
                way = self.way(self.pose, goal)
            except ParameterError as error:
                raise _Stopped("no way", str(error)) from error
            plan, last = first_leg(way, self.mission.leg_m)
            corrections += last
            if corrections > 1 + CORRECTIONS:
                raise _Stopped("no drive", f"the rover misses it by more than {target.tolerance_m:g} m again and again")
            self._one_leg(target, plan)

    def _one_leg(self, target: MissionTarget, plan: Plan) -> None:
        begin, needed = self._when(plan)
        prediction = self._powered(self.drive(plan), begin)
        safe = self.is_safe(prediction)
        before = np.ones_like(safe) if self.alive is None else self.alive
        self.alive = before & safe
        self.stands = (prediction, begin + needed - self.mission.localisation_s)
        self._stand_until(begin + needed)
        ends = self._moved_ends(prediction)
        if not self.alive.any():
            why = in_the_way(prediction) or "the battery gets too low while the rover stands after it"
            number = len(self.legs) + 1
            raise _Stopped("no drive", f"no soil is left on which all limits are kept up to leg {number}: {why}")
        member = int(self.random.choice(np.flatnonzero(self.alive)))
        fix = self.random.normal(size=3) * self._fix_sigma
        heading = float(prediction.paths[member, -1, 5]) + float(fix[2])
        fixed = (float(ends[member, 0] + fix[0]), float(ends[member, 1] + fix[1]), (heading + 180.0) % 360.0 - 180.0)
        self.legs.append(
            MissionLeg(
                number=len(self.legs) + 1,
                target=target.name,
                plan=plan,
                begin_s=begin,
                waited_s=begin - self.clock_s,
                drive_s=needed - self.mission.localisation_s,
                safe=safe,
                ends_m=ends,
                fixed=fixed,
                charge=None if self.power is None else charge_left(prediction),
            )
        )
        self.pose, self.clock_s = fixed, begin + needed

    def _powered(self, prediction: Prediction, begin_s: float) -> Prediction:
        """A leg with what is left in the batteries after standing since the one before, where that counts."""
        if self.power is None:
            return prediction
        prediction = replace(prediction, power=self.power)
        charge = np.broadcast_to(np.asarray(self.power.charge, dtype=float), (prediction.members,))
        since = 0.0
        if self.stands is not None:
            charge, since = charge_left(self.stands[0]), self.stands[1]
        return replace(prediction, power=replace(self.power, charge=stood(prediction, charge, begin_s - since, 0)))

    def _stand_until(self, time_s: float) -> None:
        """Members whose battery falls too low while they stand, after a leg, have failed."""
        if self.power is None or self.stands is None or self.alive is None:
            return
        prediction, since = self.stands
        charge = stood(prediction, charge_left(prediction), time_s - since, -1)
        for limit in limits_judged(prediction):
            if limit.quantity == "battery_charge":
                self.alive = self.alive & ~broken(limit, charge)

    def _when(self, plan: Plan) -> tuple[float, float]:
        """When a leg begins, and how long it takes with its localisation. [s]"""
        mission, number = self.mission, len(self.legs) + 1
        needed = make_schedule(plan, self.rover).duration_s + mission.localisation_s
        begin = mission.begin_of(self.clock_s, needed)
        if begin is None:
            raise _Stopped("no window", f"leg {number} takes {needed:.0f} s with its localisation, and no window after "
                                        f"{self.clock_s:.0f} s has room for it")  # fmt: skip
        if begin + needed > mission.time_budget_s:
            raise _Stopped("no time", f"leg {number} would end after {begin + needed:.0f} s, and "
                                      f"{mission.time_budget_s:.0f} s are given")  # fmt: skip
        return begin, needed

    @property
    def _fix_sigma(self) -> FloatArray:
        fixes = self.mission.fixes
        return np.array([fixes.position_sigma_m, fixes.position_sigma_m, fixes.heading_sigma_deg])

    def _moved_ends(self, prediction: Prediction) -> FloatArray:
        """Ends as they are where the rover stood off the plan's start by an error of its localisation. (members, 2)"""
        ends = prediction.endpoints_m
        if not self.legs:
            return ends
        off = self.random.normal(size=(len(ends), 3)) * self._fix_sigma
        start = np.array([prediction.plan.x_m, prediction.plan.y_m])
        turn, way = np.radians(off[:, 2]), ends - start
        turned = np.stack([way[:, 0] * np.cos(turn) - way[:, 1] * np.sin(turn),
                           way[:, 0] * np.sin(turn) + way[:, 1] * np.cos(turn)], axis=-1)  # fmt: skip
        return np.asarray(start + off[:, :2] + turned)

    def _those_there(self, target: MissionTarget, goal: tuple[float, float]) -> BoolArray:
        if not self.legs or self.alive is None:
            raise ParameterError(f"the rover stands at target '{target.name}' already; leave it out")
        near = np.hypot(*(self.legs[-1].ends_m - goal).T) <= target.tolerance_m
        return np.asarray(self.alive & near)

    def _nobody(self) -> BoolArray:
        return np.zeros(1 if self.alive is None else len(self.alive), dtype=bool)
