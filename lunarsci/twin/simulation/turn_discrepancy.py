"""What spot turns are off by: a rover that turns on the spot drags its wheels aside, and no two laws agree how far.

An angle that is off moves the end by the way that follows, while neither slip nor sinkage of the wheels tells of it.
"""

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.physics_discrepancy import VarianceLaw
from lunarsci.twin.plans.path import turn_poses
from lunarsci.twin.plans.plan import Plan

TURNS = VarianceLaw(5.0, 0.2)
"""Of the share that all turns of a drive are off by, of what they are exposed to: on 15 soils the rover of
`tests/benchmarks/spot_turns.py`, of other physics, turned farther or less far than the twin by a share of that size,
alike within a tenth for turns of 30 to 180 deg to either side."""
ALWAYS = 0.1
"""Share of a turn that counts like an angle lost, as for the way; assumed."""
STILL_M = 1e-9
"""A step of the planned path that is shorter is one of a turn or a halt. [m]"""


def exposed_turns(planned: FloatArray, yaw_deg: FloatArray) -> FloatArray:
    """Share of the planned turns that the physics can be off in: what is lost, or gained, plus 10 %. (...) [-]

    `planned` is (samples, 3) [m, m, rad], `yaw_deg` as driven (..., samples).
    """
    turn = np.diff(planned[:, 2]) * (np.hypot(*np.diff(planned[:, :2], axis=0).T) < STILL_M)
    total = np.abs(turn).sum()
    driven = np.radians(np.diff(np.unwrap(yaw_deg, period=360.0, axis=-1), axis=-1)) @ np.sign(turn)
    lost = np.abs(1.0 - driven / total) if total > 0 else np.zeros(driven.shape)
    return np.asarray(ALWAYS + np.minimum(lost, 1.0))


def turned_places(plan: Plan, distance_m: FloatArray, places_m: FloatArray, shares: FloatArray) -> FloatArray:
    """How far places move where all turns before them go on by a share of their angle. (..., samples, 2) [m]

    Position fixes tell the rover its heading, so that turns of a plan with these move nothing.

    Parameters
    ----------
    distance_m : commanded distance of the samples. (samples,)
    places_m : x and y. (..., samples, 2)
    shares : of each drive. (...)
    """
    moved = np.zeros(np.shape(places_m))
    if plan.fixes is not None:
        return moved
    for (x, y, _), angle, done_m in turn_poses(plan):
        off = angle * shares[..., None]
        lever = (places_m - (x, y)) * (distance_m > done_m)[:, None]
        moved[..., 0] += (np.cos(off) - 1.0) * lever[..., 0] - np.sin(off) * lever[..., 1]
        moved[..., 1] += np.sin(off) * lever[..., 0] + (np.cos(off) - 1.0) * lever[..., 1]
    return moved


def turn_lever(plan: Plan, distance_m: float, place_m: FloatArray) -> FloatArray:
    """How far a place moves for a share of 1 of the turns before it, while that is small. (2,) [m]"""
    lever = np.zeros(2)
    if plan.fixes is None:
        for (x, y, _), angle, done_m in turn_poses(plan):
            off = place_m - (x, y)
            lever += angle * (distance_m > done_m) * np.array([-off[1], off[0]])
    return lever


def turn_matrix(plan: Plan, planned: FloatArray, distance_m: FloatArray, paths: FloatArray) -> FloatArray:
    """Covariance of the last of some samples by what the turns before it are off by. (2, 2) [m2]

    Members count by the median of what they are exposed to.

    Parameters
    ----------
    planned : (samples, 3) [m, m, rad]
    distance_m : (samples,)
    paths : x, y, z, roll, pitch, yaw. (members, samples, 6) [m, deg]
    """
    lever = turn_lever(plan, float(distance_m[-1]), np.median(paths[:, -1, :2], axis=0))
    if not lever.any():
        return np.zeros((2, 2))
    lever = lever * float(np.median(exposed_turns(planned, paths[..., 5])))
    return TURNS.variance * np.outer(lever, lever)
