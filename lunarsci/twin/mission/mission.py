"""A mission: targets in order, ground to keep out of, time, hours of communication, and errors of localisation."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from itertools import pairwise
from typing import Any, TypeVar

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.documents import toml_of
from lunarsci.io.inputs import Source, read_input
from lunarsci.names import one_of
from lunarsci.twin.ground.keep_out import ExclusionZone
from lunarsci.twin.plans.plan import Fixes

LONGEST_LEG_M, SHORTEST_LEG_M = 25.0, 0.5
"""Between two localisations of a rover; assumed: longer legs are not planned on what cameras show."""
MOST_TARGETS = 100
T = TypeVar("T")


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
        if not (math.isfinite(self.x_m) and math.isfinite(self.y_m)):
            raise ParameterError(f"target '{self.name}' needs finite x_m and y_m")
        if not 0 < self.tolerance_m < math.inf:
            raise ParameterError(f"target '{self.name}' has tolerance_m {self.tolerance_m:g}; give more than 0 m")
        if not 0 <= self.stay_s < math.inf:
            raise ParameterError(f"target '{self.name}' has stay_s {self.stay_s:g}; give 0 s or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommWindow:
    """Hours of communication, 0 <= begin < end, from the begin of the mission. [s]"""

    begin_s: float
    end_s: float

    def __post_init__(self) -> None:
        if not 0 <= self.begin_s < self.end_s < math.inf:
            raise ParameterError(f"a [[window]] from {self.begin_s:g} to {self.end_s:g} s; give 0 <= begin_s < end_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionStart:
    """Pose at the begin, known exactly. [m, m, deg]"""

    x_m: float
    y_m: float
    heading_deg: float = 0.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x_m, self.y_m, self.heading_deg))):
            raise ParameterError("[start] needs finite x_m, y_m and heading_deg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """Targets in order, and what binds the way to them.

    Attributes
    ----------
    name : what it is.
    start, targets : where it begins, and where it leads.
    keep_outs : circles that no part of the rover may enter.
    fixes : standard errors of the localisation at the end of each leg; the ground is taken as looked at anew.
    leg_m : longest leg, 0.5 to 25. [m]
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
        if not 1 <= len(self.targets) <= MOST_TARGETS:
            raise ParameterError(f"the mission has {len(self.targets)} [[target]]; give 1 to {MOST_TARGETS}")
        names = [target.name for target in self.targets]
        if len(set(names)) < len(names):
            raise ParameterError("two targets have one name; name each of them differently")
        if not SHORTEST_LEG_M <= self.leg_m <= LONGEST_LEG_M:
            raise ParameterError(f"leg_m is {self.leg_m:g}; give {SHORTEST_LEG_M:g} to {LONGEST_LEG_M:g} m")
        if self.fixes.halt_s:
            raise ParameterError(
                "[fixes] halt_s has no use in a mission; its standstill at a leg's end is localisation_s"
            )
        if not 0 <= self.localisation_s < math.inf:
            raise ParameterError(f"localisation_s is {self.localisation_s:g}; give 0 s or more")
        if not self.time_budget_s > 0:
            raise ParameterError(f"time_budget_s is {self.time_budget_s:g}; give more than 0 s")
        if self.speed_m_s is not None and not 0 < self.speed_m_s < math.inf:
            raise ParameterError(f"speed_m_s is {self.speed_m_s:g}; give a speed above 0 m/s")
        for one, after in pairwise(self.windows):
            if after.begin_s < one.end_s:
                raise ParameterError(f"the [[window]] from {after.begin_s:g} s begins before the one before it ends")

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
    try:
        return _mission(toml_of(file.name, file.data), file.name)
    except ParameterError as error:
        raise DataError(f"{file.name}: {error}") from error


OWN = {"leg_m": float, "localisation_s": float, "time_budget_s": float, "speed_m_s": float}
TABLES = {"target": MissionTarget, "keep_out": ExclusionZone, "window": CommWindow}


def _mission(document: Mapping[str, Any], origin: str) -> Mission:
    known = ("name", *OWN, "start", "fixes", *TABLES)
    for key in document:
        if key not in known:
            raise ParameterError(f"'{key}' is not a key of a mission; {one_of(key, known)}")
    lists = {name: _records(kind, document.get(name, []), name) for name, kind in TABLES.items()}
    return Mission(
        name=_value(document.get("name", origin), str, "name"),
        start=_record(MissionStart, document.get("start", {"x_m": 0.0, "y_m": 0.0}), "[start]"),
        fixes=_record(Fixes, document.get("fixes"), "[fixes]"),
        targets=lists["target"],
        keep_outs=lists["keep_out"],
        windows=lists["window"],
        **{name: _value(document[name], kind, name) for name, kind in OWN.items() if name in document},
    )


def _records(kind: type[Any], tables: Any, name: str) -> tuple[Any, ...]:
    if not isinstance(tables, list):
        raise ParameterError(f"write each {name} as [[{name}]], in double brackets")
    return tuple(_record(kind, table, f"[[{name}]] {number}") for number, table in enumerate(tables, 1))


def _record(kind: type[T], table: Any, where: str) -> T:
    """A dataclass from a table with its fields as keys."""
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    if not isinstance(table, Mapping):
        raise ParameterError(f"{where} is missing, or no table; its keys are: {', '.join(known)}")
    for key in table:
        if key not in known:
            raise ParameterError(f"'{key}' is not a key of {where}; {one_of(key, known)}")
    for name, field in known.items():
        if name not in table and field.default is MISSING:
            raise ParameterError(f"{where} has no {name}")
    return kind(**{name: _value(value, str if name == "name" else float, name) for name, value in table.items()})


def _value(value: Any, kind: type[Any], name: str) -> Any:
    if kind is str:
        if not isinstance(value, str):
            raise ParameterError(f"{name} is {value!r}; give a text")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{name} is {value!r}; give a number")
    return float(value)
