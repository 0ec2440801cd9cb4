"""The planned drive: legs, speed, limits of safety and uncertain soil parameters; plans as TOML files."""

import json
import math
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from lunarsci.errors import DataError, OutputError, ParameterError
from lunarsci.io.documents import toml_of
from lunarsci.io.inputs import Source, read_input
from lunarsci.names import one_of
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.ground.terrain import soil_override
from lunarsci.twin.rover import Rover

# Quantities that can be limited, and their units.
QUANTITIES = {
    "slip_ratio": "-",
    "side_slip_deg": "deg",
    "sinkage_m": "m",
    "tilt_deg": "deg",
    "endpoint_miss_m": "m",
    "clearance_m": "m",
    "keep_out_m": "m",
    "motor_torque_nm": "N m",
    "motor_load": "-",
    "battery_charge": "-",
}
SINKAGE_IN_RADII = 1.0 / 3.0
"""Assumed, as in the embedded plan."""
AT_LEAST = ("clearance_m", "keep_out_m", "battery_charge")
"""Of these small values are the dangerous ones: their limit is the smallest value that counts as safe."""
MOST = {
    "slip_ratio": (1.0, "write a share, 0.3 for 30 %"),
    "side_slip_deg": (90.0, "is it in another unit than degrees?"),
    "tilt_deg": (90.0, "is it in another unit than degrees?"),
    "battery_charge": (1.0, "write a share, 0.3 for 30 %"),
}
"""The largest values that limits can have, and what a larger one was meant to be."""


@dataclass(frozen=True, slots=True)
class Limit:
    """What counts as safe of a quantity, its unit, where the number comes from, whether it is a guess.

    It is the largest safe value, or the smallest of the quantities in `AT_LEAST`; `sense` says which. Raises
    ParameterError for a value that the quantity cannot have.
    """

    quantity: str
    unit: str
    limit: float
    source: str
    assumed: bool

    def __post_init__(self) -> None:
        lowest_fits = self.quantity in AT_LEAST and self.limit == 0
        if not (0 < self.limit < math.inf or lowest_fits):
            raise ParameterError(f"limit {self.quantity} is {self.limit}; give a number above 0")
        most, meant = MOST.get(self.quantity, (math.inf, ""))
        if self.limit > most:
            raise ParameterError(f"limit {self.quantity} is {self.limit:g}, and it can be {most:g} at most; {meant}")

    @property
    def sense(self) -> Literal["at most", "at least"]:
        """Whether values up to the limit are safe, or values from it on."""
        return "at least" if self.quantity in AT_LEAST else "at most"


@cache
def _embedded_limits() -> tuple[Limit, ...]:
    return tuple(parse_limit(quantity, entry) for quantity, entry in default_limits().items())


def own_limits(rover: Rover) -> tuple[Limit, ...]:
    """What is safe of a rover where a plan does not say: slip, side slip, sinkage, tilt and clearance.

    Sinkage a third of the wheel's radius, tilt the steepest slope of the rover file, the others as in the embedded
    plan: all assumed, as no mission published its thresholds.
    """
    changed = {
        "sinkage_m": (SINKAGE_IN_RADII * rover.wheel.radius_m, "a third of the wheel radius"),
        "tilt_deg": (rover.max_slope_deg, "the steepest slope of the rover's limits, taken as a limit of the tilt"),
    }
    return tuple(
        replaced(limit, *changed[limit.quantity]) if limit.quantity in changed else limit
        for limit in _embedded_limits()
        if limit.quantity != "endpoint_miss_m"
    )


def replaced(limit: Limit, value: float, source: str) -> Limit:
    """The limit with another value, assumed; itself where it has this value already."""
    if math.isclose(limit.limit, value, rel_tol=1e-9):
        return limit
    return replace(limit, limit=value, source=source, assumed=True)


def check_limits(limits: Iterable[Limit], rover: Rover, origin: str = "") -> None:
    """Raises ParameterError for limits that say nothing of this rover: in another unit, as it seems."""
    where = f"{origin}: " if origin else ""
    radius, body = rover.wheel.radius_m, rover.body
    for limit in limits:
        if limit.quantity == "sinkage_m" and limit.limit > radius:
            raise ParameterError(
                f"{where}limit sinkage_m is {limit.limit:g}, and the wheels of {rover.name} have a radius of "
                f"{radius:g} m; is it in mm?"
            )
        belly = math.inf if body is None else body.belly_z_m - rover.wheel_positions_m[:, 2].min() + radius
        if limit.quantity == "clearance_m" and limit.limit > belly + rover.wheel.grouser_height_m:
            raise ParameterError(
                f"{where}limit clearance_m is {limit.limit:g}, and {rover.name} has {belly:.3g} m on level ground; is "
                "it in mm?"
            )


def parse_limit(quantity: str, entry: Any, source: str = "the plan") -> Limit:
    """A limit from a number, or a table with value, source, and whether it is assumed. Raises ParameterError."""
    check_keys({quantity: entry}, QUANTITIES, "[limits]")
    table = entry if isinstance(entry, dict) else {"value": entry, "source": source}
    check_keys(table, ("value", "source", "assumed"), f"limit {quantity}")
    value = number_of(table.get("value"), quantity)
    return Limit(quantity, QUANTITIES[quantity], value, str(table.get("source", "")), bool(table.get("assumed", False)))


def default_limits() -> dict[str, Any]:
    """The [limits] of the embedded plan."""
    return dict(tomllib.loads((files(__package__) / "plan.toml").read_text("utf-8"))["limits"])


def check_keys(table: Any, known: Iterable[str], where: str) -> None:
    """Raises ParameterError for what is no table, and for a key that is not known."""
    if not isinstance(table, dict):
        raise ParameterError(f"{where} must be a table")
    for key in table:
        if key not in known:
            raise ParameterError(f"'{key}' is not a key of {where}; {one_of(key, known)}")


def number_of(value: Any, name: str) -> float:
    """A number of a file. Raises ParameterError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{name} is {value!r}; give a number")
    return float(value)


_KEYS = ("name", "crs", "made_for", "start", "drive", "leg", "fixes", "limits", "sweep", "keep_out")
LONGEST_M, LONGEST_STOP_S = 10_000.0, 3600.0  # assumed, to tell a slip of the pen
SLOWEST_M_S = 0.001
"""Slower, the creep of a halt is not small, and shear follows the wheel faster than any step; assumed. [m/s]"""
LEAST_RATIO, MOST_RATIO = 0.2, 3.0
"""Of a wheel test: a slip ratio between -0.8 and 0.67 where the rover keeps its speed; assumed."""


@dataclass(frozen=True, slots=True)
class WheelTest:
    """One wheel that turns slower or faster than it would without slip, while the others drive on: it slips on purpose.

    Attributes
    ----------
    wheel : FL, FR, ML, MR, RL or RR, as `Rover.wheels` has them.
    rate_ratio : its rate over the one with which it would not slip, 0.2 to 3, not 1. [-]
    """

    wheel: str
    rate_ratio: float

    def __post_init__(self) -> None:
        if not LEAST_RATIO <= self.rate_ratio <= MOST_RATIO or self.rate_ratio == 1:
            raise ParameterError(
                f"wheel_test rate_ratio is {self.rate_ratio}; give {LEAST_RATIO:g} to {MOST_RATIO:g}, and not 1"
            )


@dataclass(frozen=True, slots=True)
class Leg:
    """A piece of the drive: an arc, a spot turn, or a stop.

    Attributes
    ----------
    length_m : length of an arc as it is commanded, rim speed times time, which the ground has without slip, > 0; 0 for
        a turn or a stop. [m]
    curvature_per_m : constant curvature of the arc, positive to the left; 0 is straight ahead. [1/m]
    crab_deg : direction of the arc's travel seen from the heading, positive to the left, -180 to 180: 90 is sideways,
        180 backwards. [deg]
    turn_deg : spot turn, positive to the left, -360 to 360. [deg]
    stop_s : time at a standstill, 1 s to an hour. [s]
    wheel_test : a wheel that slips on purpose along an arc; left out where none does.

    Raises ParameterError unless exactly one of length_m, turn_deg and stop_s is given.
    """

    length_m: float = 0.0
    curvature_per_m: float = 0.0
    crab_deg: float = 0.0
    turn_deg: float = 0.0
    stop_s: float = 0.0
    wheel_test: WheelTest | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.length_m <= LONGEST_M:
            raise ParameterError(f"length_m is {self.length_m}; give more than 0, at most {LONGEST_M:g} m")
        if not (self.stop_s == 0 or 1 <= self.stop_s <= LONGEST_STOP_S):
            raise ParameterError(f"stop_s is {self.stop_s}; give 1 to {LONGEST_STOP_S:g} s")
        for name, most in (("crab_deg", 180.0), ("turn_deg", 360.0)):
            if not abs(getattr(self, name)) <= most:
                raise ParameterError(f"{name} is {getattr(self, name)}; give -{most:g} to {most:g}")
        if not math.isfinite(self.curvature_per_m):
            raise ParameterError(f"curvature_per_m is {self.curvature_per_m}; give a finite number")
        if sum(value != 0 for value in (self.length_m, self.turn_deg, self.stop_s)) != 1:
            raise ParameterError("a leg needs exactly one of length_m, turn_deg and stop_s, and not 0")
        if self.length_m == 0 and (self.curvature_per_m != 0 or self.crab_deg != 0):
            raise ParameterError("curvature_per_m and crab_deg belong to a leg with length_m")
        if self.length_m == 0 and self.wheel_test is not None:
            raise ParameterError("wheel_test belongs to a leg with length_m")


@dataclass(frozen=True, slots=True)
class Fixes:
    """Position fixes at the end of each leg, as by visual localisation: the rover stops, learns where it is, and steers
    the next leg from there to its planned end.

    Attributes
    ----------
    position_sigma_m, heading_sigma_deg : standard errors of a fix in x and y, and in heading, >= 0. [m, deg]
    halt_s : standstill that each takes, 0 s to an hour. [s]
    """

    position_sigma_m: float
    heading_sigma_deg: float
    halt_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position_sigma_m", "heading_sigma_deg", "halt_s"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ParameterError(f"fixes {name} is {getattr(self, name)}; give 0 or more")
        if self.halt_s > LONGEST_STOP_S:
            raise ParameterError(f"fixes halt_s is {self.halt_s:g}; give at most {LONGEST_STOP_S:g} s")


@dataclass(frozen=True, slots=True)
class Sweep:
    """Range of one soil parameter, with the number of grid points; the unit is in the name, as in `Soil`."""

    name: str
    low: float
    high: float
    count: int

    def __post_init__(self) -> None:
        for value in (self.low, self.high):
            soil_override({self.name: value})
        fixed = self.low == self.high and self.count == 1
        if not (fixed or (self.low < self.high and self.count >= 2)):
            raise ParameterError(f"sweep {self.name}={self}: give LOW < HIGH and at least 2 values")

    def __str__(self) -> str:
        return f"{self.low:g}:{self.high:g}:{self.count}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A planned drive.

    Attributes
    ----------
    name, origin : what it is, and the file it comes from.
    x_m, y_m, heading_deg : start pose of the rover's origin; heading from x to the left. [m, m, deg]
    legs : the pieces of the drive, in order. They are planned for the rover's origin; where the wheels that do not
        steer stand a distance before or behind it, the wheels can only make the point between those follow, and the
        origin ends up to that distance times the angle turned off the plan.
    speed_m_s : commanded speed of the rover's origin, at least 0.001. [m/s]
    blend_m : length over which the curvature goes over from arc to arc, half before their join, half behind, >= 0. [m]
    fixes : position fixes between legs; None drives without.
    limits : what counts as safe.
    sweep : uncertain soil parameters.
    exclusion_zones : circles that the rover must not enter.
    made_for : the rover that it was planned for, where that is known.
    own_limits : whether its file has limits; without, they are those of the rover that drives it (`MadeForCheck`).
    crs : the coordinate system of x and y as well-known text; empty for a local frame.
    accepted_risk : chance of failing that it was chosen with, above 0 and below 1; None for the rule of `judge`. [-]
    """

    name: str
    legs: tuple[Leg, ...]
    speed_m_s: float
    x_m: float = 0.0
    y_m: float = 0.0
    heading_deg: float = 0.0
    blend_m: float = 0.2
    fixes: Fixes | None = None
    limits: tuple[Limit, ...] = ()
    sweep: tuple[Sweep, ...] = ()
    exclusion_zones: tuple[ExclusionZone, ...] = ()
    origin: str = ""
    made_for: MadeFor | None = None
    own_limits: bool = field(default=True, compare=False)
    crs: str = ""
    accepted_risk: float | None = None

    def __post_init__(self) -> None:
        if self.accepted_risk is not None and not 0 < self.accepted_risk < 1:
            raise ParameterError(f"the plan's accepted_risk is {self.accepted_risk:g}; give more than 0, less than 1")
        if not self.legs:
            raise ParameterError("the plan has no leg; its length is zero, so there is nothing to drive")
        if self.length_m > LONGEST_M:
            raise ParameterError(f"the plan is {self.length_m:g} m long; give at most {LONGEST_M:g} m")
        if not 0 < self.speed_m_s < math.inf:
            raise ParameterError(f"the plan's speed_m_s is {self.speed_m_s}; give a speed above 0 m/s")
        if self.speed_m_s < SLOWEST_M_S:
            raise ParameterError(f"the plan's speed_m_s is {self.speed_m_s:g}; give at least {SLOWEST_M_S:g} m/s")
        if not 0 <= self.blend_m < math.inf:
            raise ParameterError(f"the plan's blend_m is {self.blend_m}; give 0 m or more")
        if not all(map(math.isfinite, (self.x_m, self.y_m, self.heading_deg))):
            raise ParameterError("the plan's start needs finite x_m, y_m and heading_deg")
        if not self.exclusion_zones and any(limit.quantity == "keep_out_m" for limit in self.limits):
            raise ParameterError("limit keep_out_m without a [[keep_out]]; give the circles to keep out of")

    @property
    def length_m(self) -> float:
        """Length of the path. [m]"""
        return math.fsum(leg.length_m for leg in self.legs)


def check_plan(plan: Plan, rover: Rover) -> None:
    """Raises ParameterError for a plan that the rover cannot follow, or with limits that no rover of its size has."""
    check_limits(plan.limits, rover, plan.origin)
    where = f"{plan.origin}: " if plan.origin else ""
    if plan.speed_m_s > rover.max_speed_m_s:
        raise ParameterError(
            f"{where}the plan's speed_m_s is {plan.speed_m_s:g}; {rover.name} drives at most "
            f"{rover.max_speed_m_s:g} m/s"
        )
    rate = plan.speed_m_s / rover.wheel.shearing_radius_m
    if rover.motors is not None and rover.motors.torque_nm(rate) <= 0:
        raise ParameterError(
            f"{where}the plan's speed_m_s is {plan.speed_m_s:g}, {rate:.3g} rad/s of a wheel; the motors of "
            f"{rover.name} turn at most at {rover.motors.no_load_rate_rad_s:g} rad/s"
        )
    tightest = rover.tightest_curvature_per_m
    for number, leg in enumerate(plan.legs, 1):
        if leg.wheel_test is not None:
            _check_wheel_test(leg.wheel_test, plan.speed_m_s, rover, f"{where}leg {number}: ")
        if abs(leg.curvature_per_m) > tightest:
            raise ParameterError(
                f"{where}leg {number}: curvature_per_m is {leg.curvature_per_m:g}; the turning centre must lie "
                f"outside the wheels, so give at most {tightest:.3g} 1/m, or turn on the spot with turn_deg"
            )


def _check_wheel_test(test: WheelTest, speed_m_s: float, rover: Rover, where: str) -> None:
    """Raises ParameterError, beginning with `where`, for a wheel that the rover has not, or that cannot turn so fast.

    `speed_m_s` is the rover's.
    """
    if test.wheel not in rover.wheels:
        raise ParameterError(
            f"{where}wheel_test wheel is '{test.wheel}'; the wheels of {rover.name} are {', '.join(rover.wheels)}"
        )
    fastest = rover.max_speed_m_s
    if rover.motors is not None:
        fastest = max(fastest, rover.motors.no_load_rate_rad_s * rover.wheel.shearing_radius_m)
    if (rim := test.rate_ratio * speed_m_s) > fastest:
        raise ParameterError(
            f"{where}wheel_test lets wheel {test.wheel} roll at {rim:.3g} m/s; those of {rover.name} reach "
            f"{fastest:.3g} m/s, so give a smaller rate_ratio or a slower plan"
        )


def parse_sweep(text: str) -> Sweep:
    """Read `NAME=LOW:HIGH:N`, for example `friction_angle_deg=25:55:9`. Raises ParameterError."""
    name, _, rest = text.partition("=")
    try:
        low, high, count = rest.split(":")
        numbers = float(low), float(high), int(count)
    except ValueError as error:
        raise ParameterError(f"sweep '{text}' is not NAME=LOW:HIGH:N, as friction_angle_deg=25:55:9") from error
    return Sweep(name.strip(), *numbers)


def parse_fixes(text: str) -> Fixes:
    """Read `POSITION,HEADING[,HALT]`, standard errors in m and deg and the standstill of each in s, as `0.1,0.5,60`.

    Raises ParameterError.
    """
    try:
        position, heading, *halt = map(float, text.split(","))
        return Fixes(position, heading, *halt)
    except (TypeError, ValueError) as error:
        if isinstance(error, ParameterError):
            raise
        raise ParameterError(f"fixes '{text}' are not M,DEG or M,DEG,S, for example 0.1,0.5") from error


def read_plan(source: "Source | None" = None) -> Plan:
    """Read a plan from a TOML file, or the embedded one. Raises DataError.

    A file without [limits] gets those of the embedded plan; one without [sweep] sweeps nothing.
    """
    embedded = (files(__package__) / "plan.toml").read_text("utf-8")
    if source is None:
        return parse_plan(embedded, "the embedded plan")
    file = read_input(source)
    return parse_plan(file.data, file.name)


def parse_plan(text: str | bytes, origin: str) -> Plan:
    """The plan of a TOML text; `origin` is its file. Raises DataError."""
    try:
        document = toml_of(origin, text)
        check_keys(document, _KEYS, "the plan")
        start, drive = _table(document, "start"), _table(document, "drive")
        check_keys(start, ("x_m", "y_m", "heading_deg"), "[start]")
        check_keys(drive, ("speed_m_s", "blend_m", "accepted_risk"), "[drive]")
        if "speed_m_s" not in drive:
            raise ParameterError("[drive] has no speed_m_s")
        limits = _table(document, "limits") if "limits" in document else default_limits()
        return Plan(
            name=str(document.get("name", origin)),
            legs=_legs(_list(document, "leg")),
            fixes=_fixes(document),
            limits=tuple(parse_limit(quantity, entry) for quantity, entry in limits.items()),
            sweep=tuple(parse_sweep(f"{name}={entry}") for name, entry in _table(document, "sweep").items()),
            exclusion_zones=tuple(_exclusion_zone(table) for table in _list(document, "keep_out")),
            origin=origin,
            made_for=MadeFor.from_table(document["made_for"]) if "made_for" in document else None,
            own_limits="limits" in document,
            crs=str(document.get("crs", "")),
            **{key: number_of(value, key) for key, value in (start | drive).items()},
        )
    except ParameterError as error:
        raise DataError(f"{origin}: {error}") from error


def _list(document: dict[str, Any], name: str) -> list[Any]:
    tables = document.get(name, [])
    if not isinstance(tables, list):
        raise ParameterError(f"write each {name} as [[{name}]], in double brackets")
    return tables


def _legs(tables: list[Any]) -> tuple[Leg, ...]:
    legs = []
    for number, table in enumerate(tables, 1):
        try:
            legs.append(_leg(table))
        except ParameterError as error:
            raise ParameterError(f"leg {number}: {error}") from error
    return tuple(legs)


def _leg(table: Any) -> Leg:
    check_keys(table, Leg.__slots__, "[[leg]]")
    numbers = {name: number_of(value, name) for name, value in table.items() if name != "wheel_test"}
    return Leg(**numbers, wheel_test=_wheel_test(table["wheel_test"]) if "wheel_test" in table else None)


def _wheel_test(table: Any) -> WheelTest:
    _check_complete(table, WheelTest.__slots__, 'wheel_test, as { wheel = "FL", rate_ratio = 0.6 },')
    return WheelTest(str(table["wheel"]), number_of(table["rate_ratio"], "rate_ratio"))


def _fixes(document: dict[str, Any]) -> Fixes | None:
    if "fixes" not in document:
        return None
    table, known = _table(document, "fixes"), ("position_sigma_m", "heading_sigma_deg")
    _check_complete(table, known, "[fixes]", "halt_s")
    return Fixes(*(number_of(table[name], name) for name in (*known, "halt_s") if name in table))


def _exclusion_zone(table: Any) -> ExclusionZone:
    _check_complete(table, ("name", "x_m", "y_m", "radius_m"), "[[keep_out]]")
    return ExclusionZone(str(table["name"]), *(number_of(table[name], name) for name in ("x_m", "y_m", "radius_m")))


def _table(document: dict[str, Any], name: str) -> dict[str, Any]:
    table = document.get(name, {})
    if not isinstance(table, dict):
        raise ParameterError(f"[{name}] must be a table")
    return table


def _check_complete(table: Any, needed: Iterable[str], where: str, *optional: str) -> None:
    check_keys(table, (*needed, *optional), where)
    for name in needed:
        if name not in table:
            raise ParameterError(f"{where} has no {name}")


def plan_text(plan: Plan) -> str:
    """The TOML text that `read_plan` reads back as the same plan, but for `origin`."""
    lines = [
        f"name = {_quoted(plan.name)}",
        *([f"crs = {_quoted(plan.crs)}"] if plan.crs else []),
        *_maker_lines(plan),
        "",
        "[start]",
        *(f"{name} = {float(getattr(plan, name))!r}" for name in ("x_m", "y_m", "heading_deg")),
        "",
        "[drive]",
        *(f"{name} = {float(getattr(plan, name))!r}" for name in ("speed_m_s", "blend_m")),
        *([] if plan.accepted_risk is None else [f"accepted_risk = {float(plan.accepted_risk)!r}"]),
    ]
    for leg in plan.legs:
        values = ((name, float(getattr(leg, name))) for name in Leg.__slots__ if name != "wheel_test")
        lines += ["", "[[leg]]", *(f"{name} = {value!r}" for name, value in values if value)]
        if (test := leg.wheel_test) is not None:
            ratio = float(test.rate_ratio)
            lines.append(f"wheel_test = {{ wheel = {_quoted(test.wheel)}, rate_ratio = {ratio!r} }}")
    if plan.fixes is not None:
        names = ("position_sigma_m", "heading_sigma_deg", *(("halt_s",) if plan.fixes.halt_s else ()))
        lines += ["", "[fixes]", *(f"{name} = {float(getattr(plan.fixes, name))!r}" for name in names)]
    for circle in plan.exclusion_zones:
        places = (f"{name} = {float(getattr(circle, name))!r}" for name in ("x_m", "y_m", "radius_m"))
        lines += ["", "[[keep_out]]", f"name = {_quoted(circle.name)}", *places]
    lines += ["", "[limits]"]
    for limit in plan.limits:
        source, assumed = _quoted(limit.source), "true" if limit.assumed else "false"
        lines.append(f"{limit.quantity} = {{ value = {limit.limit!r}, assumed = {assumed}, source = {source} }}")
    lines += ["", "[sweep]"]
    lines += [f"{sweep.name} = {_quoted(_range(sweep.low, sweep.high, sweep.count))}" for sweep in plan.sweep]
    return "\n".join(lines) + "\n"


def read_limits(source: Source) -> tuple[Limit, ...]:
    """The [limits] of a TOML file, which may be a plan. Raises DataError, also for one without any."""
    file = read_input(source)
    try:
        table = toml_of(file.name, file.data).get("limits")
        if not isinstance(table, dict) or not table:
            raise ParameterError("no [limits] in it; write quantities and their limits there, as endpoint_miss_m = 0.5")
        if "keep_out_m" in table:
            raise ParameterError("limit keep_out_m is of the circles of one plan; leave it out, or make these wider")
        return tuple(parse_limit(quantity, entry, file.name) for quantity, entry in table.items())
    except ParameterError as error:
        raise DataError(f"{file.name}: {error}") from error


def write_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan as `read_plan` reads it. Raises OutputError."""
    try:
        Path(path).write_text(plan_text(plan), "utf-8")
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror}") from error


def _maker_lines(plan: Plan) -> list[str]:
    if plan.made_for is None:
        return []
    table = plan.made_for.to_table().items()
    rows = (f"{name} = {_quoted(value) if isinstance(value, str) else repr(float(value))}" for name, value in table)
    return ["", "[made_for]", *rows]


def _range(low: float, high: float, count: int) -> str:
    return f"{float(low)!r}:{float(high)!r}:{count}"


def _quoted(text: str) -> str:
    # The escapes of JSON are among those of TOML, which also forbids a bare delete character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
