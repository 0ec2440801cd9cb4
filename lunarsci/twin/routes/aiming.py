"""Plans bent so that a drive which is expected to drift comes where it shall: they aim off against the drift."""

from dataclasses import replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.plans.plan import Leg, Plan

END_COUNTS = 3.0
"""Weight of the end among the places of a way; assumed."""
STIFF_M = 0.02
"""Off a place that a change of an arc by a tenth of its length, or by 0.1 / m, is worth; assumed. [m]"""
LONGER = 1.5
"""Times that an arc may get longer or shorter; assumed."""


def bent_plan(plan: Plan, shares: FloatArray, places_m: FloatArray, most_curvature_per_m: float) -> Plan | None:
    """The plan with its arcs changed so that it passes near to places; None where that is not possible.

    Parameters
    ----------
    shares : of the length of the plan, ascending, the last one 1. (n,) [-]
    places_m : where it shall be by then; spot turns and stops stay as they are. (n, 2) [m]
    most_curvature_per_m : of any arc. [1/m]

    Least squares over length and curvature of every arc; one that is the only one counts as two.
    """
    from scipy.optimize import least_squares

    legs = _with_two_arcs(plan.legs)
    arcs = [number for number, leg in enumerate(legs) if leg.length_m]
    start = np.array([[legs[k].length_m, legs[k].curvature_per_m] for k in arcs]).ravel()
    weight = np.ones(len(shares))
    weight[-1] = END_COUNTS

    def changed(values: FloatArray) -> Plan:
        new = list(legs)
        for number, (length, curvature) in zip(arcs, values.reshape(-1, 2), strict=True):
            new[number] = replace(legs[number], length_m=float(length), curvature_per_m=float(curvature))
        return replace(plan, legs=tuple(new))

    def residuals(values: FloatArray) -> FloatArray:
        bent = changed(values)
        off = planned_pose(bent, shares * bent.length_m)[:, :2] - places_m
        change = (values - start).reshape(-1, 2) / np.column_stack([0.1 * start[::2], np.full(len(arcs), 0.1)])
        return np.concatenate([(weight[:, None] * off).ravel(), STIFF_M * change.ravel()])

    bend = np.full(len(arcs), max(most_curvature_per_m, float(np.abs(start[1::2]).max())))
    low, high = (
        np.column_stack([start[::2] * factor, sign * bend]).ravel()
        for factor, sign in ((1.0 / LONGER, -1.0), (LONGER, 1.0))
    )
    inside = np.clip(start, low + 1e-9, high - 1e-9)
    found = least_squares(residuals, inside, bounds=(low, high))
    return changed(found.x) if found.success else None


def _with_two_arcs(legs: tuple[Leg, ...]) -> tuple[Leg, ...]:
    if sum(leg.length_m > 0 for leg in legs) > 1:
        return legs
    halves = (replace(leg, length_m=0.5 * leg.length_m) if leg.length_m else leg for leg in legs)
    return tuple(half for leg in halves for half in ([leg, leg] if leg.length_m else [leg]))


def halting_at(plan: Plan, distance_m: float, least_m: float) -> tuple[Leg, ...]:
    """The legs with one more joint at a distance along the plan; as they are where a joint or an end is as near as
    `least_m`.
    """
    legs, done = list[Leg](), 0.0
    for leg in plan.legs:
        before, after = distance_m - done, done + leg.length_m - distance_m
        if leg.length_m and before > least_m and after > least_m:
            legs += [replace(leg, length_m=before), replace(leg, length_m=after)]
        else:
            legs.append(leg)
        done += leg.length_m
    return tuple(legs)
