"""The planned drive: legs, speed, limits of safety and uncertain soil parameters; plans as TOML files."""

import json
import math
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from lunarsci.errors import ParameterError, within_file
from lunarsci.io.documents import check_keys, number_of, record_of, records_of, toml_of
from lunarsci.io.inputs import Source, read_input
from lunarsci.ranges import FINITE, NOT_NEGATIVE, POSITIVE, check_range, check_ranges, refuse
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.ground.terrain import OVERRIDES, soil_override
from lunarsci.twin.plans.risk import AcceptedRisk
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
VALUES = {
    "slip_ratio": ("(0, 1]", "write a share, 0.3 for 30 %"),
    "side_slip_deg": ("(0, 90]", "is it in another unit than degrees?"),
    "tilt_deg": ("(0, 90]", "is it in another unit than degrees?"),
    "clearance_m": (NOT_NEGATIVE, ""),
    "keep_out_m": (NOT_NEGATIVE, ""),
    "battery_charge": ("[0, 1]", "write a share, 0.3 for 30 %"),
}
"""That limits can have, where any number above 0 cannot, and what another one was meant to be."""
LIMITS_RULE = "sinkage a third of its wheel radius, tilt its max_slope_deg, the others as in the embedded plan"
"""What a plan without [limits] is judged by."""
_KEYS = ("name", "crs", "made_for", "start", "drive", "leg", "fixes", "limits", "sweep", "keep_out")
LENGTHS_M, STOPS_S, HALTS_S = "[0, 10000]", "[1, 3600]", "[0, 3600]"  # assumed, to tell a slip of the pen
SLOWEST_M_S = 0.001
"""Slower, the creep of a halt is not small, and shear follows the wheel faster than any step; assumed. [m/s]"""


@dataclass(frozen=True, slots=True)
class Limit:
    """What counts as safe of a quantity.

    Attributes
    ----------
    quantity, unit : what is limited.
    limit : the largest safe value, or the smallest of the quantities in `AT_LEAST`; `sense` says which.
    source, assumed : where the number comes from, and whether it is a guess.

    Raises ParameterError for a value that the quantity cannot have.
    """

    quantity: str
    unit: str
    limit: float
    source: str
    assumed: bool

    def __post_init__(self) -> None:
        interval, meant = VALUES.get(self.quantity, (POSITIVE, ""))
        check_range(f"limit {self.quantity}", self.limit, interval, meant)

    @property
    def sense(self) -> Literal["at most", "at least"]:
        """Whether values up to the limit are safe, or values from it on."""
        return "at least" if self.quantity in AT_LEAST else "at most"


@cache
def default_limits() -> tuple[Limit, ...]:
    """The [limits] of the embedded plan."""
    return tuple(parse_limit(*entry) for entry in tomllib.loads(_embedded_plan())["limits"].items())


def _embedded_plan() -> str:
    return (files(__package__) / "plan.toml").read_text("utf-8")


def rover_limits(rover: Rover) -> tuple[Limit, ...]:
    """What is safe of a rover where a plan does not say: slip, side slip, sinkage, tilt and clearance.

    Tilt is the steepest slope of the rover file, assumed where the file says so. Sinkage a third of the wheel's radius,
    and the others as in the embedded plan, are assumed, as no mission published its thresholds.
    """
    slope = rover.max_slope_source
    of_rover = {
        "sinkage_m": (SINKAGE_IN_RADII * rover.wheel.radius_m, "a third of the wheel radius", True),
        "tilt_deg": (rover.max_slope_deg, f"the rover's max_slope_deg ({slope or 'assumed'})", not slope),
    }
    limits = []
    for limit in default_limits():
        value, source, assumed = of_rover.get(limit.quantity, (limit.limit, limit.source, limit.assumed))
        limits.append(replace(limit, limit=value, source=source, assumed=assumed))
    return tuple(limit for limit in limits if limit.quantity != "endpoint_miss_m")


def check_limits(limits: Iterable[Limit], rover: Rover, origin: str = "") -> None:
    """Raises ParameterError for limits that say nothing of this rover: in another unit, as it seems."""
    radius, body = rover.wheel.radius_m, rover.body
    belly = math.inf if body is None else body.belly_z_m - float(rover.wheel_positions_m[:, 2].min()) + radius
    largest = {
        "sinkage_m": (radius, f"the wheels of {rover.name} have a radius of {radius:g} m"),
        "clearance_m": (belly + rover.wheel.grouser_height_m, f"{rover.name} has {belly:.3g} m on level ground"),
    }
    for limit in limits:
        most, why = largest.get(limit.quantity, (math.inf, ""))
        if limit.limit > most:
            where = f"{origin}: " if origin else ""
            raise ParameterError(f"{where}limit {limit.quantity} is {limit.limit:g}, and {why}; is it in mm?")


def parse_limit(quantity: str, entry: Any, source: str = "the plan") -> Limit:
    """A limit from a number, or a table with value, source, and whether it is assumed. Raises ParameterError."""
    check_keys({quantity: entry}, QUANTITIES, "[limits]")
    table = entry if isinstance(entry, dict) else {"value": entry, "source": source}
    check_keys(table, ("value", "source", "assumed"), f"limit {quantity}")
    value = number_of(table.get("value"), quantity)
    return Limit(quantity, QUANTITIES[quantity], value, str(table.get("source", "")), bool(table.get("assumed", False)))


@dataclass(frozen=True, slots=True)
class WheelTest:
    """One wheel that turns slower or faster than it would without slip, while the others drive on: it slips on purpose.

    Attributes
    ----------
    wheel : FL, FR, ML, MR, RL or RR, as `Rover.wheels` has them.
    rate_ratio : its rate over the one with which it would not slip, above 0. [-]
    """

    wheel: str
    rate_ratio: float

    def __post_init__(self) -> None:
        check_ranges(self, {POSITIVE: "rate_ratio"}, "wheel_test")


@dataclass(frozen=True, slots=True)
class Leg:
    """A piece of the drive: an arc, a spot turn, or a stop.

    Attributes
    ----------
    length_m : way of an arc over the ground where wheels slip by slip_ratio, > 0; 0 for a turn or a stop. Rims are
        commanded to roll length_m / (1 - slip_ratio). [m]
    slip_ratio : slip that the commands make up for, between -1 and 1; 0 where length_m is what the rims roll. [-]
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
    slip_ratio: float = 0.0

    def __post_init__(self) -> None:
        names = {LENGTHS_M: "length_m", "[-180, 180]": "crab_deg", "[-360, 360]": "turn_deg", "(-1, 1)": "slip_ratio"}
        check_ranges(self, names | {FINITE: "curvature_per_m"} | ({STOPS_S: "stop_s"} if self.stop_s else {}))
        if sum(value != 0 for value in (self.length_m, self.turn_deg, self.stop_s)) != 1:
            raise ParameterError("a leg needs exactly one of length_m, turn_deg and stop_s, and not 0")
        if not self.length_m and any((self.curvature_per_m, self.crab_deg, self.wheel_test, self.slip_ratio)):
            raise ParameterError("curvature_per_m, crab_deg, wheel_test and slip_ratio belong to a leg with length_m")

    @property
    def commanded_m(self) -> float:
        """How far its rims are commanded to roll. [m]"""
        return self.length_m / (1.0 - self.slip_ratio)


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
        check_ranges(self, {NOT_NEGATIVE: "position_sigma_m heading_sigma_deg", HALTS_S: "halt_s"}, "fixes")


@dataclass(frozen=True, slots=True)
class Sweep:
    """Range of one soil parameter.

    Attributes
    ----------
    name : of the parameter, as in `Soil`, with its unit.
    low, high : ends of the range, in that unit.
    count : how many values a grid has of it.

    Raises ParameterError for a range that is none, or that leaves the parameter's.
    """

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
    has_limits : whether its file has limits; without, they are those of the rover that drives it (`MadeForCheck`).
    crs : the coordinate system of x and y as well-known text; empty for a local frame.
    accepted_risk : chance of failing that it was chosen with; None for the rule of `judge`.
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
    has_limits: bool = field(default=True, compare=False)
    crs: str = ""
    accepted_risk: AcceptedRisk | None = None

    def __post_init__(self) -> None:
        if not self.legs:
            raise ParameterError("the plan has no leg; its length is zero, so there is nothing to drive")
        names = {NOT_NEGATIVE: "blend_m", FINITE: "x_m y_m heading_deg"}
        check_ranges(self, names | {f"[{SLOWEST_M_S}, inf)": "speed_m_s", LENGTHS_M: "length_m"}, "the plan's")
        if not self.exclusion_zones and any(limit.quantity == "keep_out_m" for limit in self.limits):
            raise ParameterError("limit keep_out_m without a [[keep_out]]; give the circles to keep out of")

    @property
    def length_m(self) -> float:
        """Length of the path. [m]"""
        return math.fsum(leg.length_m for leg in self.legs)

    @property
    def commanded_m(self) -> float:
        """How far the rims are commanded to roll along it. [m]"""
        return math.fsum(leg.commanded_m for leg in self.legs)


def check_plan(plan: Plan, rover: Rover) -> None:
    """Raises ParameterError for a plan that the rover cannot follow, or with limits that no rover of its size has."""
    check_limits(plan.limits, rover, plan.origin)
    refuse(_undrivable(plan, rover), plan.origin)


def _undrivable(plan: Plan, rover: Rover) -> Iterator[str]:
    """Why a rover cannot follow a plan."""
    speed, fastest = f"the plan's speed_m_s is {plan.speed_m_s:g}", rover.max_speed_m_s
    if plan.speed_m_s > fastest:
        yield f"{speed}; {rover.name} drives at most {fastest:g} m/s"
    if rover.motors is not None:
        rate, most = plan.speed_m_s / rover.wheel.shearing_radius_m, rover.motors.no_load_rate_rad_s
        fastest = max(fastest, most * rover.wheel.shearing_radius_m)
        if rate >= most:
            yield f"{speed}, {rate:.3g} rad/s of a wheel; the motors of {rover.name} turn at most at {most:g} rad/s"
    tightest = rover.tightest_curvature_per_m
    for number, leg in enumerate(plan.legs, 1):
        test = leg.wheel_test
        if test is not None and test.wheel not in rover.wheels:
            yield (f"leg {number}: wheel_test wheel is '{test.wheel}'; the wheels of {rover.name} are "
                   f"{', '.join(rover.wheels)}")  # fmt: skip
        if test is not None and (rim := test.rate_ratio * plan.speed_m_s) > fastest:
            yield (f"leg {number}: wheel_test lets wheel {test.wheel} roll at {rim:.3g} m/s; those of {rover.name} "
                   f"reach {fastest:.3g} m/s, so give a smaller rate_ratio or a slower plan")  # fmt: skip
        if abs(leg.curvature_per_m) > tightest:
            yield (f"leg {number}: curvature_per_m is {leg.curvature_per_m:g}; the turning centre must lie outside the "
                   f"wheels, so give at most {tightest:.3g} 1/m, or turn on the spot with turn_deg")  # fmt: skip


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
    if source is None:
        return parse_plan(_embedded_plan(), "the embedded plan")
    file = read_input(source)
    return parse_plan(file.data, file.name)


def parse_plan(text: str | bytes, origin: str) -> Plan:
    """The plan of a TOML text; `origin` is its file. Raises DataError."""
    with within_file(origin):
        document = toml_of(origin, text)
        check_keys(document, _KEYS, "the plan")
        start, drive, limits, sweep = (document.get(name, {}) for name in ("start", "drive", "limits", "sweep"))
        check_keys(start, ("x_m", "y_m", "heading_deg"), "[start]")
        check_keys(drive, ("speed_m_s", "blend_m", "accepted_risk"), "[drive]")
        check_keys(limits, QUANTITIES, "[limits]")
        check_keys(sweep, OVERRIDES, "[sweep]")
        if "speed_m_s" not in drive:
            raise ParameterError("[drive] has no speed_m_s")
        risk = drive.pop("accepted_risk", None)
        given_limits = tuple(parse_limit(quantity, entry) for quantity, entry in limits.items())
        return Plan(
            name=str(document.get("name", origin)),
            legs=records_of(Leg, document.get("leg", []), "leg"),
            fixes=record_of(Fixes, document["fixes"], "[fixes]") if "fixes" in document else None,
            limits=given_limits if "limits" in document else default_limits(),
            sweep=tuple(parse_sweep(f"{name}={entry}") for name, entry in sweep.items()),
            exclusion_zones=records_of(ExclusionZone, document.get("keep_out", []), "keep_out"),
            origin=origin,
            made_for=MadeFor.from_table(document["made_for"]) if "made_for" in document else None,
            has_limits="limits" in document,
            crs=str(document.get("crs", "")),
            accepted_risk=None if risk is None else AcceptedRisk(number_of(risk, "accepted_risk")),
            **{key: number_of(value, key) for key, value in (start | drive).items()},
        )


def plan_text(plan: Plan) -> str:
    """The TOML text that `read_plan` reads back as the same plan, but for `origin`."""
    lines = [f"name = {_quoted(plan.name)}", *([f"crs = {_quoted(plan.crs)}"] if plan.crs else [])]
    if plan.made_for is not None:
        made = plan.made_for.to_table().items()
        rows = (f"{name} = {_quoted(value) if isinstance(value, str) else repr(float(value))}" for name, value in made)
        lines += ["", "[made_for]", *rows]
    lines += ["", "[start]", *_numbers(plan, "x_m", "y_m", "heading_deg")]
    lines += ["", "[drive]", *_numbers(plan, "speed_m_s", "blend_m")]
    lines += [] if plan.accepted_risk is None else [f"accepted_risk = {float(plan.accepted_risk.share)!r}"]
    for leg in plan.legs:
        lines += ["", "[[leg]]"]
        lines += _numbers(leg, *(name for name in Leg.__slots__ if name != "wheel_test" and getattr(leg, name)))
        if (test := leg.wheel_test) is not None:
            lines.append(f"wheel_test = {{ wheel = {_quoted(test.wheel)}, {_numbers(test, 'rate_ratio')[0]} }}")
    if plan.fixes is not None:
        halt = ("halt_s",) if plan.fixes.halt_s else ()
        lines += ["", "[fixes]", *_numbers(plan.fixes, "position_sigma_m", "heading_sigma_deg", *halt)]
    for circle in plan.exclusion_zones:
        lines += ["", "[[keep_out]]", f"name = {_quoted(circle.name)}", *_numbers(circle, "x_m", "y_m", "radius_m")]
    lines += ["", "[limits]"]
    for limit in plan.limits:
        source, assumed = _quoted(limit.source), "true" if limit.assumed else "false"
        lines.append(f"{limit.quantity} = {{ value = {limit.limit!r}, assumed = {assumed}, source = {source} }}")
    lines += ["", "[sweep]"]
    lines += [f'{one.name} = "{float(one.low)!r}:{float(one.high)!r}:{one.count}"' for one in plan.sweep]
    return "\n".join(lines) + "\n"


def _numbers(given: object, *names: str) -> list[str]:
    return [f"{name} = {float(getattr(given, name))!r}" for name in names]


def read_limits(source: Source) -> tuple[Limit, ...]:
    """The [limits] of a TOML file, which may be a plan. Raises DataError, also for one without any."""
    file = read_input(source)
    with within_file(file.name):
        table = toml_of(file.name, file.data).get("limits")
        if not isinstance(table, dict) or not table:
            raise ParameterError("no [limits] in it; write quantities and their limits there, as endpoint_miss_m = 0.5")
        if "keep_out_m" in table:
            raise ParameterError("limit keep_out_m is of the circles of one plan; leave it out, or make these wider")
        return tuple(parse_limit(quantity, entry, file.name) for quantity, entry in table.items())


def _quoted(text: str) -> str:
    # The escapes of JSON are among those of TOML, which also forbids a bare delete character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
