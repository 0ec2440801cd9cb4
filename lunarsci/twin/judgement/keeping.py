"""Whether a drive is kept: the one rule that judges predictions, chooses drives, and compares missions and rovers.

A drive is kept that ends and breaks none of its limits. These are the limits of its plan, and those that hold without
being written there: circles to keep out of, what the motors give for long, and what must be left in the battery.
"""

from dataclasses import replace

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.twin.judgement.energy import power_use, wheel_turns_rad
from lunarsci.twin.judgement.quantities import along, clearance
from lunarsci.twin.plans.plan import AT_LEAST, QUANTITIES, Limit, rover_limits
from lunarsci.twin.simulation.ensemble import Prediction

NEVER_BROKEN = ("keep_out_m", "battery_charge")
"""Limits that no drive of an ensemble may break, where of others 95 % keep them: it would be lost."""
PLAN_HAS_NONE = "the rover's own, as the plan has none"
"""Begins the source of a limit that a plan leaves out."""


def limits_judged(prediction: Prediction) -> tuple[Limit, ...]:
    """The limits by which a drive is judged, in their order: those of the plan, then those that go without saying.

    The rover's own limits stand for those that a plan leaves out. Without those that cannot be judged, see
    `not_judged`.
    """
    given = {limit.quantity for limit in prediction.plan.limits}
    implied = tuple(limit for limit in _implied(prediction) if limit.quantity not in given)
    lacking = not_judged(prediction)
    return tuple(limit for limit in (*prediction.plan.limits, *implied) if limit.quantity not in lacking)


def _implied(prediction: Prediction) -> tuple[Limit, ...]:
    rover, others = prediction.rover, []
    of_rover = [replace(limit, source=f"{PLAN_HAS_NONE}: {limit.source}") for limit in rover_limits(rover)]
    if prediction.plan.exclusion_zones:
        others.append(("keep_out_m", 0.0, "circles of the plan"))
    if rover.motors is not None:
        others.append(("motor_load", 1.0, "the rover's motors, what they give for long"))
    if prediction.power is not None and rover.power is not None:
        others.append(("battery_charge", rover.power.least_charge, "the rover's battery"))
    return (*of_rover, *(Limit(name, QUANTITIES[name], value, source, False) for name, value, source in others))


def not_judged(prediction: Prediction) -> dict[str, str]:
    """Quantities of limits that cannot be judged of this rover or this drive, each with the reason."""
    rover = prediction.rover
    lacking = {
        "clearance_m": "" if rover.body is not None else "the rover file has no [body]",
        "motor_load": "" if rover.motors is not None else "the rover file has no [motors]",
        "battery_charge": "" if prediction.power is not None else "no charge of the battery is given",
    }
    return {name: why for name, why in lacking.items() if why}


def limited(prediction: Prediction, quantity: str) -> FloatArray:
    """A quantity that can be limited at every sample: its largest magnitude of all wheels, or its smallest value.

    (members, samples). `endpoint_miss_m` counts at the last sample alone, `motor_load` is the torque at a wheel over
    what its motor gives for long at the wheel's rate, `battery_charge` is below 0 by what is drawn beyond an empty
    battery. Raises ParameterError for what cannot be limited, or not of this rover.
    """
    if quantity == "endpoint_miss_m":
        values = np.zeros(prediction.reached.shape)
        values[:, -1] = prediction.miss_m
    elif quantity == "motor_load":
        values = _motor_load(prediction)
    elif quantity == "battery_charge":
        capacity = 1.0 if prediction.rover.power is None else prediction.rover.power.battery_wh
        values = power_use(prediction).balance_wh / capacity
    else:
        values = along(prediction, quantity)
    if quantity in AT_LEAST:
        return values
    return np.asarray(np.abs(values) if values.ndim == 2 else np.abs(values).max(axis=2))


def _motor_load(prediction: Prediction) -> FloatArray:
    motors = prediction.rover.motors
    if motors is None:
        raise ParameterError(f"{prediction.rover.name} has no [motors]; add the table to the rover file as in yutu2's")
    rates = wheel_turns_rad(prediction) / np.diff(prediction.time_s)[:, None]
    # A sample lies between two steps; the faster one counts.
    rates = np.maximum(np.concatenate([rates[:, :1], rates], axis=1), np.concatenate([rates, rates[:, -1:]], axis=1))
    torque = np.abs(along(prediction, "motor_torque_nm"))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(torque > 0, torque / motors.torque_nm(rates), 0.0)


def extremes(prediction: Prediction, quantity: str) -> FloatArray:
    """Worst value of a quantity over wheels and distance, as far as each member came. (members,)

    The largest magnitude, or the smallest value of a quantity in `AT_LEAST`; NaN where a member has none. Where the
    ground below some of the body is unknown, so is the clearance, and it is minus infinite: no limit is kept. Raises
    ParameterError as `limited` does.
    """
    if quantity == "endpoint_miss_m":
        return prediction.miss_m
    if quantity == "clearance_m":
        values, unknown = clearance(prediction)
        values = np.where(unknown > 0, -np.inf, values)
    else:
        values = limited(prediction, quantity)
    if quantity in AT_LEAST:
        least = np.where(prediction.reached & ~np.isnan(values), values, np.inf).min(axis=1)
        return np.asarray(np.where(least == np.inf, np.nan, least))
    return np.asarray(np.where(prediction.reached, values, 0.0).max(axis=1))


def broken(limit: Limit, values: FloatArray) -> BoolArray:
    """Where values, of a quantity as `limited` or `extremes` has it, are beyond a limit; not where they are unknown."""
    return np.asarray(values < limit.limit if limit.sense == "at least" else values > limit.limit)


def worst_values(prediction: Prediction) -> dict[Limit, FloatArray]:
    """The limits that are judged, each with the worst value of every member. (members,)"""
    return {limit: extremes(prediction, limit.quantity) for limit in limits_judged(prediction)}


def keeps_limits(prediction: Prediction, worst: dict[Limit, FloatArray] | None = None) -> BoolArray:
    """Drives that end and break none of the limits that are judged, of `worst_values`. (members,)"""
    worst = worst_values(prediction) if worst is None else worst
    kept = [~broken(limit, values) for limit, values in worst.items()]
    return np.asarray(np.all([prediction.finished, *kept], axis=0))


def in_the_way(prediction: Prediction) -> str:
    """What drives break, the most frequent first, as `slip_ratio (3 of 8 drives)`; '' where all are kept."""
    counts = {one.quantity: int(broken(one, values).sum()) for one, values in worst_values(prediction).items()}
    counts["not at the end"] = int((~prediction.finished).sum())
    order = sorted((name for name in counts if counts[name]), key=lambda name: -counts[name])
    return ", ".join(f"{name} ({counts[name]} of {prediction.members} drives)" for name in order)
