"""Drives with what the twin's physics is off by: places and wheel states of each member, moved by a draw of it.

Where wheels hardly slip any law of the soil leads to nearly the same end; what a law is off by shows in the slip. So
the discrepancy is a share of the way lost by slipping, and of a small part of the way itself, alike over metres. Spot
turns are off by a share of their angle.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, DrawnDiscrepancy, Prediction
from lunarsci.twin.simulation.turn_discrepancy import TURNS, exposed_turns, turned_places

ALIKE_M = 5.0
"""Way over which the physics is off by much the same share; assumed, as measured: the likelihood of the returns that
set `physics_discrepancy.FIRST` is the same within 0.1 for 2 to 30 m."""
ALWAYS = 0.1
"""Share of the way that counts like a way lost, so that drives without slip are not taken for exact; assumed, as that
likelihood hardly tells 0.02 from 0.08, and this is the largest that keeps the spread named with `FIRST`."""


def _left(steps: FloatArray) -> FloatArray:
    return np.stack([-steps[..., 1], steps[..., 0]], axis=-1)


def _kept(steps: FloatArray) -> FloatArray:
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
    for step, kept in zip(shares[:, None] * steps, _kept(steps), strict=True):
        past = kept * past
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
    kept, noise = _kept(steps), random.standard_normal((len(sizes), len(steps)))
    result = noise.copy()
    for k in range(1, len(steps)):
        result[:, k] = kept[k] * result[:, k - 1] + np.sqrt(1.0 - kept[k] ** 2) * noise[:, k]
    return np.asarray(sizes[:, None] * result)
