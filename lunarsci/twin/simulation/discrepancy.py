"""Drives with what the twin's physics is off by: places and wheel states of each member, moved by a draw of it.

Where wheels hardly slip any law of the soil leads to nearly the same end; what a law is off by shows in the slip. So
the discrepancy is a share of the way lost by slipping, and of a small part of the way itself, alike over metres. Spot
turns are off by a share of their angle.

What spot turns are off by: a rover that turns on the spot drags its wheels aside, and no two laws agree how far.

An angle that is off moves the end by the way that follows, while neither slip nor sinkage of the wheels tells of it.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy, VarianceLaw
from lunarsci.twin.plans.path import turn_poses
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, DrawnDiscrepancy, Prediction

TURNS = VarianceLaw(5.0, 0.2)
"""Of the share that all turns of a drive are off by, of what they are exposed to: on 15 soils the rover of
`tests/benchmarks/spot_turns.py`, of other physics, turned farther or less far than the twin by a share of that size,
alike within a tenth for turns of 30 to 180 deg to either side."""
ALWAYS = 0.1
"""Share of a way, or of a turn, that counts like one lost, so that drives without slip are not taken for exact.
Measured by the likelihood of `ALIKE_M`, which hardly tells 0.02 from 0.08; this is the largest that keeps the errors of
`physics_discrepancy.FIRST`."""
STILL_M = 1e-9
"""A step of the planned path that is shorter is one of a turn or a halt. [m]"""
ALIKE_M = 5.0
"""Way over which the physics is off by much the same share, as measured: the likelihood of the returns that set
`physics_discrepancy.FIRST` is the same within 0.1 for 2 to 30 m."""


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


def _left(steps: FloatArray) -> FloatArray:
    return np.stack([-steps[..., 1], steps[..., 0]], axis=-1)


def _correlation(steps: FloatArray) -> FloatArray:
    """Correlation of the share of each step with that of the one before, 0 for the first. (samples - 1,)"""
    lengths = np.hypot(*steps.T)
    return np.concatenate([[0.0], np.exp(-0.5 * (lengths[1:] + lengths[:-1]) / ALIKE_M)])


def exposed(planned_m: FloatArray, paths_m: FloatArray) -> FloatArray:
    """Share of each planned step that the physics can be off in: the part lost by slipping, or gained, plus 10 %.

    `planned_m` is (samples, 2), `paths_m` x, y, z as driven (..., samples, 3); the result (..., samples - 1). [-]
    """
    planned = np.hypot(*np.diff(planned_m, axis=0).T)
    driven = np.linalg.norm(np.diff(paths_m, axis=-2), axis=-1)
    lost = np.abs(1.0 - driven / np.where(planned > 0, planned, np.inf))
    return np.asarray(ALWAYS + np.where(planned > 0, np.minimum(lost, 1.0), 0.0))


def way_matrix(planned_m: FloatArray, paths_m: FloatArray) -> FloatArray:
    """Covariance of the last place for a share along the way of variance 1. (2, 2) [m2]

    The sum over all pairs of exposed steps d_k d_l^T exp(-way between them / 5 m). Members count by the median of what
    they are exposed to. Shapes as of `exposed`.
    """
    shares = exposed(planned_m, paths_m)
    steps = np.diff(planned_m, axis=0)
    shares = np.median(shares.reshape(-1, len(steps)), axis=0)
    result, past = np.zeros((2, 2)), np.zeros(2)
    for step, alike in zip(shares[:, None] * steps, _correlation(steps), strict=True):
        past = alike * past
        cross = np.outer(step, past)
        result += np.outer(step, step) + cross + cross.T
        past = past + step
    return result


def with_discrepancy(prediction: Prediction, law: PhysicsDiscrepancy, seed: int = 0) -> Prediction:
    """Every member with a draw of the discrepancy: moved off its path, its slip, side slip, sinkage and forces changed.

    The paths, on which the chassis stood on the ground, stay as they were driven; `Prediction.places_m` is where a
    member is taken to be. At halts states stay as they are.
    """
    random = np.random.default_rng([seed, 17])
    steps, members = np.diff(prediction.planned[:, :2], axis=0), prediction.members
    size = exposed(prediction.planned[:, :2], prediction.paths[..., :3])
    along, across = (size * _shares(one.sizes(members, random), steps, random) for one in (law.along, law.across))
    moved = along[..., None] * steps + across[..., None] * _left(steps)
    moved[~prediction.reached[:, 1:]] = 0.0
    shares = {
        name: np.maximum(one.sizes(members, random) * random.standard_normal(members), -1.0)
        for name, one in sorted(law.quantities.items())
    }
    offsets = np.concatenate([np.zeros((members, 1, 2)), np.cumsum(moved, axis=1)], axis=1)
    offsets += _turned(prediction, random)
    drawn = DrawnDiscrepancy(law=law, offsets_m=offsets, shares=shares)
    return dataclasses.replace(prediction, discrepancy=drawn, states=_states(prediction, along, across, shares))


def _turned(prediction: Prediction, random: np.random.Generator) -> FloatArray:
    """How far members come off their paths by what their spot turns are off by. (members, samples, 2) [m]"""
    members = prediction.members
    share = TURNS.sizes(members, random) * random.standard_normal(members)
    share *= exposed_turns(prediction.planned, prediction.paths[..., 5])
    return turned_places(prediction.plan, prediction.distance_m, prediction.paths[..., :2], share)


def _states(
    prediction: Prediction, along: FloatArray, across: FloatArray, shares: Mapping[str, FloatArray]
) -> FloatArray:
    """A rover that comes a share of the way farther slips less by it; one that comes to the left slips sidewards.

    No draw goes beyond what a quantity can have: |slip| 1, 90 deg of side slip, and a wheel's radius of sinkage.
    """
    states, moving = prediction.states.copy(), ~prediction.halted
    ahead, left = (np.concatenate([part[:, :1], part], axis=1)[:, moving, None] for part in (along, across))
    column = {name: states[..., k] for k, name in enumerate(STATE_COLUMNS)}
    column["slip_ratio"][:, moving] -= ahead
    column["side_slip_deg"][:, moving] += np.degrees(left)
    for name, share in shares.items():
        column[name][:, moving] *= 1.0 + share[:, None, None]
    for name, low, high in (
        ("slip_ratio", -1.0, 1.0), ("side_slip_deg", -90.0, 90.0), ("sinkage_m", 0.0, prediction.rover.wheel.radius_m)
    ):  # fmt: skip
        np.clip(column[name], low, high, out=column[name])
    return states


def _shares(sizes: FloatArray, steps: FloatArray, random: np.random.Generator) -> FloatArray:
    """Of each step, alike over metres. (members, samples - 1) [-]"""
    alike, noise = _correlation(steps), random.standard_normal((len(sizes), len(steps)))
    result = noise.copy()
    for k in range(1, len(steps)):
        result[:, k] = alike[k] * result[:, k - 1] + np.sqrt(1.0 - alike[k] ** 2) * noise[:, k]
    return np.asarray(sizes[:, None] * result)
