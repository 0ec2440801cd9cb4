"""Designs of a rover on one mission and on the same soils: what each keeps, needs, and how it stands to the others.

A design varies numbers of a rover and of its plans by `Variation`s.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray
from lunarsci.errors import LunarSciError, ParameterError
from lunarsci.names import meant
from lunarsci.ranges import check_range
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.traction import LoadedWheel, Traction, traction
from lunarsci.rovers import RoverDescription
from lunarsci.twin.ground.terrain import SOIL_COLUMNS
from lunarsci.twin.judgement.energy import charge_left, energy_use, power_use
from lunarsci.twin.judgement.keeping import extremes, keeps_limits
from lunarsci.twin.judgement.quantities import least_of_95, most_of_95
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.plan import Plan, check_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction

SPEED = "plan.speed_m_s"
"""The one number of a plan that can be varied."""
AXES = ("x", "y", "z")
"""Ends of the names of a vector's numbers."""
MOST_DESIGNS = 2000
"""Each is a whole ensemble of drives; assumed."""
LUGS = (
    "the wheel-soil formulas know lugs by wheel.grouser_height_m and wheel.grouser_shear_coefficient alone, not by "
    "their number or spacing"
)
"""Why numbers of lugs are refused."""
UNUSED = {
    "limits": "it bounds where `twin plan` looks for a way; no drive of a given plan changes with it",
    "drive": f"it bounds what plans may ask for; vary {SPEED}",
    "steering.steered_wheels": "it is no number",
    "suspension.bogie": "it is no number",
}
"""Numbers that change no drive, by table or key, and why."""
CURVE = tuple(np.linspace(0.0, 0.6, 13).tolist())
"""Slips at which a wheel's pull is looked at; the wheel model holds to 0.6, see `MAX_VALID_SLIP`. [-]"""


@dataclass(frozen=True, slots=True)
class Variation:
    """Range of one number of a design.

    Attributes
    ----------
    name : `TABLE.KEY` of the rover file, with `.x`, `.y` or `.z` of a vector, or `plan.speed_m_s`.
    low, high : its ends, in the unit that the name ends in.
    count : how many values a grid has of it.

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
    try:
        low, high, count = rest.split(":")
        return Variation(name.strip(), float(low), float(high), int(count))
    except ValueError as error:
        if isinstance(error, ParameterError):
            raise
        raise ParameterError(f"vary '{text}' is not NAME=LOW:HIGH:N, for example wheel.radius_m=0.10:0.20:5") from error


def check_names(variations: Sequence[Variation], description: RoverDescription, plans: Sequence[Plan]) -> None:
    """Raises ParameterError for a name that the rover does not have, or that changes no drive, with the reason."""
    names = [entry.name for entry in variations]
    if len(set(names)) < len(names):
        raise ParameterError(f"a number is varied twice: {', '.join(names)}")
    given = varied_names(description)
    body = any(plan.exclusion_zones or any(limit.quantity == "clearance_m" for limit in plan.limits) for plan in plans)
    for name in (one for one in names if one != SPEED):
        reason = UNUSED.get(name) or UNUSED.get(name.partition(".")[0])
        if any(word in name for word in ("lug", "grouser_count", "grouser_number", "grouser_spacing")):
            reason = LUGS
        elif name.startswith("body.") and name in given and not body:
            reason = "no plan limits clearance_m or has a [[keep_out]], and no force depends on it"
        if reason is not None:
            raise ParameterError(f"{name} changes nothing here: {reason}")
        if name not in given:
            raise ParameterError(
                f"{name} is no number of {description.name}; {meant(name, given)}these are: {SPEED}, {', '.join(given)}"
            )


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
    check_range("designs", count, f"[1, {MOST_DESIGNS}]")
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
    # Left and right wheels take turns; both sides are alike.
    wheel, places = rover.wheel, rover.wheel_positions_m[::2]
    outer = wheel.radius_m + wheel.grouser_height_m
    body = rover.body
    if body is None:
        return
    given = "body.width_m" not in assumed
    inner = rover.rocker_pivot_y_m - 0.5 * wheel.width_m
    reach = body.center_x_m + 0.5 * body.length_m, body.center_x_m - 0.5 * body.length_m
    beside = (places[:, 0] - outer < reach[0]) & (places[:, 0] + outer > reach[1])
    if given and inner < 0.5 * body.width_m and bool((beside & (places[:, 2] + outer > body.belly_z_m)).any()):
        raise ParameterError(
            f"wheels reach {0.5 * body.width_m - inner:.3g} m into the chassis: narrow them or the body, or set them "
            "lower"
        )
    if body.belly_z_m <= float(places[:, 2].min()) - outer:
        raise ParameterError("the chassis lies on the ground; raise body.belly_z_m or take larger wheels")


Drive = Callable[[int, dict[str, Any]], Prediction]
"""Drives plan number k of the mission, from 0, with these fields of its `DriveInputs` replaced: `rover` and `plan`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionOutcome:
    """What a design does on all plans of a mission.

    Attributes
    ----------
    drives : number of members of the ensemble; each drives every plan on its soil, and that counts as one drive.
    kept_share : share of the members that keep every plan, as `lunarsci.twin.judgement.keeping.keeps_limits` has it.
        [-]
    slip_ratio, sinkage_m, motor_torque_nm : p95 over the members of each one's largest value, of any wheel on any plan.
        [-, m, N m]
    energy_p50_j : work of the motors at the wheels on all plans together, median over the members that reach all ends;
        None where no member does. [J]
    energy_p95_j : work of the motors on all plans together that 95 % of these members do not exceed. [J]
    electrical_p50_wh : what motors and electronics draw on all plans together, median over the members that reach all
        ends; None where no member does, or without [motors] and [power]. [W h]
    least_charge : of the battery, what 95 % of the members keep on all plans, one after the other; below 0 what is
        drawn beyond an empty one; None where neither charge nor Sun is given. [-]
    duration_s : of all plans together. [s]
    bias_m : distance of the mean end from the planned destination, of several plans the largest; None where no member
        reaches the end of a plan. [m]
    scatter_m : radius of the smallest circle that holds every end, of several plans the largest; None where no member
        reaches the end of a plan. [m]
    traction : of a wheel under its share of the weight on level ground, on the median soil; None where the soil does
        not carry it.
    reasons : why plans are no-go, one sentence each.
    """

    drives: int
    kept_share: float
    slip_ratio: float
    sinkage_m: float
    motor_torque_nm: float
    energy_p50_j: float | None
    energy_p95_j: float | None
    electrical_p50_wh: float | None
    duration_s: float
    bias_m: float | None
    scatter_m: float | None
    traction: Traction | None
    reasons: tuple[str, ...]
    least_charge: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """A rover with some numbers changed.

    Attributes
    ----------
    values : name of each varied number, as in `Variation`, to its value, in the unit of the rover file.
    outcome : what came of it; None where it is impossible.
    impossible : why it cannot be built or drive, one sentence; empty where it can.
    """

    values: dict[str, float]
    outcome: MissionOutcome | None = None
    impossible: str = ""

    def row(self) -> dict[str, Any]:
        """One row of a table; what is not known is None."""
        result = self.outcome
        names = (
            "kept_share", "slip_ratio", "sinkage_m", "motor_torque_nm", "energy_p50_j", "energy_p95_j",
            "electrical_p50_wh", "least_charge", "duration_s", "bias_m", "scatter_m",
        )  # fmt: skip
        of_traction = ("pull_at_20_n", "pull_per_weight_at_20", "efficiency_at_20", "slope_at_20_deg")
        pull = None if result is None else result.traction
        return {
            **self.values,
            **{name: None if result is None else getattr(result, name) for name in names},
            **{name: None if pull is None else getattr(pull, name) for name in of_traction},
            "reasons": "" if result is None else "; ".join(result.reasons),
            "impossible": self.impossible,
        }


def try_design(inputs: Sequence[Any], values: dict[str, float], drive: Drive) -> Design:
    """Build a design and drive it on every plan; what is impossible becomes its reason.

    `inputs` are the `DriveInputs` of the plans of the mission, all with the same rover.
    """
    try:
        rover = build_rover(varied_description(inputs[0].description, values), varied=True)
        rover = replace(rover, gravity_m_s2=inputs[0].rover.gravity_m_s2)
        check_design(rover, inputs[0].description.assumed)
        plans = [varied_plan(one.plan, values) for one in inputs]
        for plan in plans:
            check_plan(plan, rover)
        predictions = [drive(k, {"rover": rover, "plan": plan}) for k, plan in enumerate(plans)]
    except LunarSciError as error:
        return Design(values=values, impossible=str(error))
    return Design(values=values, outcome=mission_outcome(rover, predictions))


def mission_outcome(rover: Rover, predictions: Sequence[Prediction]) -> MissionOutcome:
    """Put the predictions of all plans of a mission together: member m has the same soil in each of them."""
    predictions = with_battery(predictions)
    verdicts = [judge(prediction) for prediction in predictions]
    keeps = np.all([keeps_limits(prediction) for prediction in predictions], axis=0)
    done = np.all([prediction.finished for prediction in predictions], axis=0)
    work = np.sum([energy_use(prediction).total_j for prediction in predictions], axis=0)[done]
    ends = [verdict.endpoint for verdict in verdicts]
    given = [end for end in ends if end is not None]
    all_ended = len(given) == len(ends)
    return MissionOutcome(
        drives=predictions[0].members,
        kept_share=float(keeps.mean()),
        **{
            name: most_of_95(np.max([extremes(one, name) for one in predictions], axis=0))
            for name in ("slip_ratio", "sinkage_m", "motor_torque_nm")
        },
        energy_p50_j=float(np.median(work)) if work.size else None,
        energy_p95_j=most_of_95(work) if work.size else None,
        electrical_p50_wh=_electrical_wh(rover, predictions, done),
        least_charge=_least_charge(predictions),
        duration_s=math.fsum(float(prediction.time_s[-1]) for prediction in predictions),
        bias_m=max(end.bias_m for end in given) if all_ended else None,
        scatter_m=max(end.scatter_radius_m for end in given) if all_ended else None,
        traction=_traction(rover, predictions[0]),
        reasons=tuple(f"{p.plan.name}: {why}" for p, v in zip(predictions, verdicts, strict=True) for why in v.reasons),
    )


def with_battery(predictions: Sequence[Prediction]) -> list[Prediction]:
    """The predictions of plans that follow each other; where the battery counts, each begins with the charge that the
    one before left to the member."""
    result: list[Prediction] = []
    for one in predictions:
        if result and one.power is not None:
            one = replace(one, power=replace(one.power, charge=charge_left(result[-1])))
        result.append(one)
    return result


def _least_charge(predictions: Sequence[Prediction]) -> float | None:
    if any(one.power is None for one in predictions):
        return None
    return least_of_95(np.min([extremes(one, "battery_charge") for one in predictions], axis=0))


def _electrical_wh(rover: Rover, predictions: Sequence[Prediction], done: BoolArray) -> float | None:
    if rover.motors is None or rover.power is None or not done.any():
        return None
    return float(np.median(np.sum([power_use(prediction).drawn_wh for prediction in predictions], axis=0)[done]))


def median_soil(prediction: Prediction) -> Soil:
    """The soil of the middle: medians over the nodes of the terrain, and over the members of what these have."""
    middle = np.median(prediction.terrain.soil.reshape(-1, 8), axis=0)
    # Not by `from_si`, which divides where this multiplies: last digits would change.
    values = dict(zip(SOIL_COLUMNS, middle.tolist(), strict=True))
    values["stiffness_kpa_m_n"] *= 1e-3
    for name in ("shear_modulus_mm", "lateral_modulus_mm"):
        values[name] *= 1e3
    for name in ("friction_angle_deg", "external_friction_angle_deg"):
        values[name] = math.degrees(math.atan(values[name]))
    given = {name: float(np.median(values)) for name, values in prediction.parameters.items() if name in SOIL_COLUMNS}
    return Soil(**values | given)


def _traction(rover: Rover, prediction: Prediction) -> Traction | None:
    wheel = LoadedWheel(wheel=rover.wheel, soil=median_soil(prediction), load_n=rover.load_n)
    try:
        return traction(wheel, wheel.over(CURVE))
    except LunarSciError:
        return None


def pareto_front(designs: Sequence[Design]) -> list[int]:
    """Numbers of the designs that no other beats in both the share of drives kept and the median energy.

    By energy, the least first; without those that are impossible or reach no end.
    """
    given = [
        (result.energy_p50_j, -result.kept_share, number)
        for number, design in enumerate(designs)
        if (result := design.outcome) is not None and result.energy_p50_j is not None
    ]
    front: list[int] = []
    best = math.inf  # minus the largest kept share so far
    for _, lost, number in sorted(given):
        if lost < best:
            front.append(number)
            best = lost
    return front


def unchanged(designs: Sequence[Design]) -> list[str]:
    """Varied numbers with which, all others alike, no outcome changes by a digit; [] where none was tried so."""
    names = list(designs[0].values) if designs else []
    result = []
    for name in names:
        groups: dict[tuple[float, ...], list[MissionOutcome]] = {}
        for design in designs:
            if design.outcome is not None:
                rest = tuple(value for key, value in design.values.items() if key != name)
                groups.setdefault(rest, []).append(design.outcome)
        several = [group for group in groups.values() if len(group) > 1]
        if several and all(outcome == group[0] for group in several for outcome in group):
            result.append(name)
    return result
