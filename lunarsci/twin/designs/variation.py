"""Numbers of a rover and of its plans that a designer varies, and the rovers that come of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.names import meant
from lunarsci.rovers import RoverDescription
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover

SPEED = "plan.speed_m_s"
AXES = ("x", "y", "z")
MOST_DESIGNS = 2000
LUGS = (
    "the wheel-soil formulas know lugs by wheel.grouser_height_m and wheel.grouser_shear_coefficient alone, not by "
    "their number or spacing"
)
UNUSED = {
    "limits": "it bounds where `twin plan` looks for a way; no drive of a given plan changes with it",
    "drive": f"it bounds what plans may ask for; vary {SPEED}",
    "steering.steered_wheels": "it is no number",
    "suspension.bogie": "it is no number",
}
"""Numbers that change no drive, by table or key, and why."""


@dataclass(frozen=True, slots=True)
class Variation:
    """Range of one number of the design: `TABLE.KEY` of the rover file, with `.x`, `.y` or `.z` of a vector, or
    `plan.speed_m_s`; and how many values a grid has of it.

    Raises ParameterError for a range that is none.
    """

    name: str
    low: float
    high: float
    count: int

    def __post_init__(self) -> None:
        finite = math.isfinite(self.low) and math.isfinite(self.high)
        single = self.low == self.high and self.count == 1
        if not finite or not (single or (self.low < self.high and self.count >= 2)):
            raise ParameterError(f"vary {self.name}: give LOW < HIGH and at least 2 values")


def parse_variation(text: str) -> Variation:
    """Read `NAME=LOW:HIGH:N`, for example `wheel.radius_m=0.10:0.20:5`. Raises ParameterError."""
    name, _, rest = text.partition("=")
    parts = rest.split(":")
    try:
        low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (IndexError, ValueError) as error:
        raise ParameterError(f"vary '{text}' is not NAME=LOW:HIGH:N, for example wheel.radius_m=0.10:0.20:5") from error
    if len(parts) != 3:
        raise ParameterError(f"vary '{text}' is not NAME=LOW:HIGH:N, for example wheel.radius_m=0.10:0.20:5")
    return Variation(name.strip(), low, high, count)


def check_names(variations: Sequence[Variation], description: RoverDescription, plans: Sequence[Plan]) -> None:
    """Raises ParameterError for a name that the rover does not have, or that changes no drive, with the reason."""
    names = [entry.name for entry in variations]
    if len(set(names)) < len(names):
        raise ParameterError(f"a number is varied twice: {', '.join(names)}")
    known = varied_names(description)
    for name in names:
        if name == SPEED:
            continue
        if any(word in name for word in ("lug", "grouser_count", "grouser_number", "grouser_spacing")):
            raise ParameterError(f"{name} changes nothing here: {LUGS}")
        reason = UNUSED.get(name) or UNUSED.get(name.partition(".")[0])
        if reason is not None:
            raise ParameterError(f"{name} changes nothing here: {reason}")
        if name not in known:
            raise ParameterError(
                f"{name} is no number of {description.name}; {meant(name, known)}these are: {SPEED}, {', '.join(known)}"
            )
        if name.startswith("body.") and not any(_judges_body(plan) for plan in plans):
            raise ParameterError(
                f"{name} changes nothing here: no plan limits clearance_m or has a [[keep_out]], and no force depends "
                "on it"
            )


def _judges_body(plan: Plan) -> bool:
    return bool(plan.exclusion_zones) or any(limit.quantity == "clearance_m" for limit in plan.limits)


def varied_names(description: RoverDescription) -> list[str]:
    """Numbers of a rover file that drives depend on, vectors by `.x`, `.y`, `.z`."""
    names = []
    for table, entries in description.tables.items():
        for key, value in entries.items():
            if table in UNUSED or f"{table}.{key}" in UNUSED:
                continue
            if isinstance(value, list) and len(value) == len(AXES):
                names += [f"{table}.{key}.{axis}" for axis in AXES]
            elif isinstance(value, int | float):
                names.append(f"{table}.{key}")
    return names


def design_values(variations: Sequence[Variation], designs: int | None, seed: int) -> list[dict[str, float]]:
    """Values of each design: the grid of all ranges, or `designs` Latin-hypercube samples of them.

    Raises ParameterError for more than 2000 designs.
    """
    count = math.prod(entry.count for entry in variations) if designs is None else designs
    if not 1 <= count <= MOST_DESIGNS:
        raise ParameterError(f"{count} designs; give 1 to {MOST_DESIGNS}")
    if designs is None:
        axes = [np.linspace(entry.low, entry.high, entry.count) for entry in variations]
        rows = np.stack([mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")], axis=1)
    else:
        from scipy.stats import qmc

        share = qmc.LatinHypercube(len(variations), rng=np.random.default_rng(seed)).random(designs)
        low, high = (np.array([getattr(entry, end) for entry in variations]) for end in ("low", "high"))
        rows = low + (high - low) * share
    return [{entry.name: float(value) for entry, value in zip(variations, row, strict=True)} for row in rows]


def varied_description(description: RoverDescription, values: dict[str, float]) -> RoverDescription:
    """The rover file with some of its numbers replaced; the plan's are left out."""
    tables: dict[str, dict[str, Any]] = {name: dict(table) for name, table in description.tables.items()}
    for name, value in values.items():
        if name == SPEED:
            continue
        table, key, *axis = name.split(".")
        if axis:
            vector = list(tables[table][key])
            vector[AXES.index(axis[0])] = value
            tables[table][key] = vector
        else:
            tables[table][key] = value
    return replace(description, tables=tables)


def varied_plan(plan: Plan, values: dict[str, float]) -> Plan:
    """The plan at the speed of the design. Raises ParameterError for a speed that is none."""
    return replace(plan, speed_m_s=values[SPEED]) if SPEED in values else plan


def check_design(rover: Rover, assumed: Sequence[str] = ()) -> None:
    """Raises ParameterError for wheels that meet the chassis, and for a chassis on the ground.

    `assumed` are the numbers of the rover file that are guesses: a width of the body that is one refuses no wheel.
    """
    wheel, places = rover.wheel, rover.wheel_positions_m[::2]
    outer = wheel.radius_m + wheel.grouser_height_m
    body = rover.body
    if body is None:
        return
    known = "body.width_m" not in assumed
    inner = rover.rocker_pivot_y_m - 0.5 * wheel.width_m
    reach = body.center_x_m + 0.5 * body.length_m, body.center_x_m - 0.5 * body.length_m
    beside = (places[:, 0] - outer < reach[0]) & (places[:, 0] + outer > reach[1])
    if known and inner < 0.5 * body.width_m and bool((beside & (places[:, 2] + outer > body.belly_z_m)).any()):
        raise ParameterError(
            f"wheels reach {0.5 * body.width_m - inner:.3g} m into the chassis: narrow them or the body, or set them "
            "lower"
        )
    if body.belly_z_m <= float(places[:, 2].min()) - outer:
        raise ParameterError("the chassis lies on the ground; raise body.belly_z_m or take larger wheels")
