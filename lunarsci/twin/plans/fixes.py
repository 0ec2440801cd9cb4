"""Position fixes: where the rover believes to be at a halt, and the leg that takes it from there to its planned end."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.plans.path import leg_end
from lunarsci.twin.plans.schedule import Schedule
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.lanes import LANES, POSE

__all__ = ["fix_errors", "legs_from"]

FloatArray = npt.NDArray[np.float64]


def fix_errors(schedule: Schedule, members: int, seed: int) -> FloatArray:
    """Errors in x, y and heading of the fix before each run, zeros without fixes. (members, runs, 3) [m, m, rad]"""
    fixes = schedule.plan.fixes
    shape = (members, len(schedule.runs), 3)
    if fixes is None:
        return np.zeros(shape)
    sigma = (fixes.position_sigma_m, fixes.position_sigma_m, math.radians(fixes.heading_sigma_deg))
    return np.random.default_rng([seed, 1]).normal(size=shape) * sigma


def legs_from(schedule: Schedule, rover: Rover, number: int, work: Any, errors: FloatArray) -> FloatArray:
    """The leg of a run as each rover steers it, from its estimated pose to the planned end.

    An arc is the one that leaves in the leg's direction of travel and meets the planned end point, no tighter than the
    rover can drive and at most twice as long as planned; a goal already passed is not driven back to. A spot turn ends
    at the planned heading. Either takes the time of the planned leg, so the speed differs as the length does: the
    errors of the fixes should be small against the legs.

    Parameters
    ----------
    work : the scratch arrays with the true poses.
    errors : of the fixes. (LANES, 3) [m, m, rad]

    Returns
    -------
    Length [m], curvature [1/m] and turn [rad]. (LANES, 3)
    """
    leg = schedule.runs[number].legs[0]
    goal = leg_end(schedule.poses[number], leg)
    x, y, heading = (_poses(work) + errors).T
    if leg.length_m == 0:
        planned = math.radians(leg.turn_deg)
        off = np.remainder(goal[2] - heading - planned + math.pi, 2 * math.pi) - math.pi
        return np.stack([np.zeros(LANES), np.zeros(LANES), planned + off], axis=-1)
    travel = heading + math.radians(leg.crab_deg)
    ahead = np.cos(travel) * (goal[0] - x) + np.sin(travel) * (goal[1] - y)
    aside = np.cos(travel) * (goal[1] - y) - np.sin(travel) * (goal[0] - x)
    # The leg has its planned time: what lies further than twice its length, or behind, is left to the next one.
    chord = np.where(ahead > 0.0, np.hypot(ahead, aside), 0.0)
    half = np.where(ahead > 0.0, np.arctan2(aside, ahead), 0.0)
    tightest = rover.tightest_curvature_per_m
    curvature = np.clip(2.0 * np.sin(half) / np.maximum(chord, 1e-9), -tightest, tightest)
    length = np.minimum(chord / np.sinc(half / math.pi), 2.0 * leg.length_m)
    return np.stack([length, curvature, np.zeros(LANES)], axis=-1)


def _poses(work: Any) -> FloatArray:
    """True x, y, heading. (LANES, 3) [m, m, rad]"""
    rows = work.body.reshape(-1, LANES)[POSE : POSE + 7]
    x, y, _, w, i, j, k = rows
    return np.stack([x, y, np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))], axis=-1)
