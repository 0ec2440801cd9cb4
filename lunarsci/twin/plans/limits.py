"""What counts as safe of a drive: limits of its quantities, as a plan has them or as they follow from the rover."""

import math
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from lunarsci.errors import ParameterError
from lunarsci.names import one_of
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
