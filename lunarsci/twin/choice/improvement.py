"""Drives made better by what their ensemble tells: aimed off against the drift, or halted before the tightest place."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.choice.chances import UNFINISHED, Weakest
from lunarsci.twin.plans.path import planned_pose, poses_along
from lunarsci.twin.plans.plan import Fixes, Plan
from lunarsci.twin.routes.aiming import bent_plan, halting_at
from lunarsci.twin.routes.planner import PLACES_M, RouteSearch
from lunarsci.twin.simulation.ensemble import Prediction

PLACES = 8
"""Along a way, at which its drift is looked at; assumed."""
LEAST_DRIFT_M = 0.05
"""A smaller mean drift is left alone; assumed. [m]"""
AHEAD_M, REST_M = 1.0, 1.0
"""A halt lies so far before the tightest place, and before the end; assumed: a rover's length. [m]"""
LEAST_LEG_M, LEAST_IN_ERRORS = 0.5, 5.0
"""No leg after a halt is shorter, also in errors of the place; assumed."""
ELSEWHERE = ("slip_ratio", "side_slip_deg", "sinkage_m", "motor_torque_nm", "motor_load", "battery_charge")
"""Limits that knowing its place does not help a rover to keep."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Improvement:
    """How plans may be made better.

    Attributes
    ----------
    fits : whether a plan keeps what it must on the maps.
    most_curvature_per_m : of its arcs. [1/m]
    fixes : of halts for localisation; None without.
    """

    fits: Callable[[Plan], bool]
    most_curvature_per_m: float
    fixes: Fixes | None = None

    @classmethod
    def on(cls, search: RouteSearch, fixes: Fixes | None = None) -> "Improvement":
        """Of plans that shall keep the clearance and the radius that the search keeps."""
        mobility = search.surface.mobility

        def fits(plan: Plan) -> bool:
            return search.clear_m(poses_along(plan, PLACES_M))[0] >= mobility.hazard_distance_m

        return cls(fits=fits, most_curvature_per_m=1.0 / mobility.min_turning_radius_m, fixes=fixes)

    def plans(self, prediction: Prediction, weakest: Weakest, way: Plan) -> list[Plan]:
        """Up to two plans in place of one without fixes: aimed off, and with a halt before its weakest place.

        Where it is aimed off already, `way` is the plan that it shall follow, and else the plan itself.
        """
        plan = prediction.plan
        if plan.fixes is not None:
            return []
        aimed = self._aimed(prediction, way)
        halted = None if plan.target_m is not None else self._halted(plan, weakest)
        return [one for one in (aimed, halted) if one is not None and self.fits(one)]

    def _aimed(self, prediction: Prediction, way: Plan) -> Plan | None:
        """A plan from which drives are expected to drift to where another one leads."""
        plan, shares = prediction.plan, np.arange(1, PLACES + 1) / PLACES
        drift = mean_drift(prediction, way, shares)
        if drift is None or np.hypot(*drift.T).max() < LEAST_DRIFT_M:
            return None
        wanted = planned_pose(plan, shares * plan.length_m)[:, :2] - drift
        bent = bent_plan(plan, shares, wanted, self.most_curvature_per_m)
        if bent is None:
            return None
        x, y = prediction.destination_m
        bent = replace(bent, target_m=(float(x), float(y)))
        return replace(bent, name=f"{way.name}, aimed off")

    def _halted(self, plan: Plan, weakest: Weakest) -> Plan | None:
        """With halts at the joints of its legs, and one before the weakest place."""
        if self.fixes is None or weakest.quantity in (*ELSEWHERE, UNFINISHED):
            return None
        at_end = weakest.distance_m > plan.length_m - REST_M
        place = plan.length_m - REST_M if at_end else weakest.distance_m - AHEAD_M
        legs = halting_at(plan, place, max(LEAST_LEG_M, LEAST_IN_ERRORS * self.fixes.position_sigma_m))
        if len(legs) == 1:
            return None
        said = "1 fix" if len(legs) == 2 else f"{len(legs) - 1} fixes"
        return replace(plan, legs=legs, fixes=self.fixes, name=f"{plan.name}, {said}")


def mean_drift(prediction: Prediction, way: Plan, shares: FloatArray) -> FloatArray | None:
    """How far the mean of the drives is off a way at shares of its length; None where none ended. (n, 2) [m]"""
    done = prediction.finished
    if not done.any():
        return None
    length = prediction.plan.length_m
    samples = np.searchsorted(prediction.distance_m, shares * length - 1e-6).clip(max=len(prediction.distance_m) - 1)
    mean = prediction.places_m[done][:, samples].mean(axis=0)
    return np.asarray(mean - planned_pose(way, shares * way.length_m)[:, :2])
