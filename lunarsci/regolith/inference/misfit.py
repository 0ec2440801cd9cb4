"""How a law misses forces, as a smooth function of slip and side slip: a Gaussian process of what a fit leaves over.

A law of wheel and soil is wrong by what it leaves out, and wrong in the same way at like slips and side slips. What is
left over in the states that taught it, as shares of the load, is a part that changes smoothly and a part of its own in
each state (Kennedy & O'Hagan 2001, 10.1111/1467-9868.00294). How large and how smooth the first is, is weighed by its
marginal likelihood (Rasmussen & Williams 2006, ch. 5). Away from the states that taught it the mean goes to 0 and the
error to that of a law that nothing taught there.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.inference.problem import forces_of_many
from lunarsci.regolith.wheel import ContactModel, Wheel

SLIPS, ANGLES_DEG = (0.15, 0.4, 1.0), (8.0, 20.0, 50.0)
"""Candidates for the differences of slip and side slip over which what is missed changes; assumed."""
SMOOTH = (0.0, 0.3, 0.6, 0.9)
"""Candidates for the share of its variance that is smooth; assumed."""
ALIKE = (0.6, 30.0)
"""How far off in slip [-] and side slip [deg] from the states that taught it a law is as wrong as it is elsewhere;
assumed, some steps between states of wheel tests."""
LEAST_ELSEWHERE = (0.4, 0.1, 0.1)
"""Share of the load by which a law misses F_N, F_DP, F_L where nothing taught it, at least: 0.11 to 0.58 at side slips
of 15 to 75 deg where straight runs taught it, and 0.09 to 0.10 of runs that the best one has not seen (wheel of Pavlov
& Johnson 2019, `tests/benchmarks/wheel_blocks.py`)."""
MOST = 300
"""States that teach it: of more, one of each so many in a row; assumed, so that it takes no second."""


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """The states that taught a law.

    Attributes
    ----------
    wheel : that was measured.
    inputs : sinkage [m], slip ratio [-], side slip [deg]. (m, 3)
    forces : measured F_N, F_DP, F_L, NaN where they were not. (m, 3) [N]
    """

    wheel: Wheel
    inputs: FloatArray = field(repr=False)
    forces: FloatArray = field(repr=False)

    def missed(self, soil: FloatArray, model: ContactModel | None) -> FloatArray:
        """Measured less model on a soil, as shares of the load, NaN where it was not measured. (m, 3)"""
        found = forces_of_many(soil[None], self.inputs, self.wheel, model)[0].T
        return np.asarray((self.forces - found) / np.abs(self.forces[:, :1]))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """What a law misses at n states, from what it missed at those that taught it.

    Attributes
    ----------
    lesson, model : of which soil it is asked.
    weights : of what was missed, 0 where it was not measured. (3, n, m)
    sigma : standard deviation of a new state's own, as a share of the load. (n, 3)
    """

    lesson: Lesson | None
    model: ContactModel | None
    weights: FloatArray
    sigma: FloatArray

    def mean(self, soil: FloatArray) -> FloatArray:
        """Mean of measured less model where a soil is the right one, as a share of the load. (n, 3)"""
        if self.lesson is None:
            return np.zeros_like(self.sigma)
        missed = np.nan_to_num(self.lesson.missed(soil, self.model))
        return np.asarray(np.einsum("knm,mk->nk", self.weights, missed))


def misfit_at(
    model_error: tuple[float, ...],
    lesson: Lesson | None,
    best: FloatArray,
    model: ContactModel | None,
    motion: FloatArray,
) -> Misfit:
    """What a law misses at slips and side slips.

    Parameters
    ----------
    model_error : share of the load by which it misses F_N, F_DP, F_L.
    lesson : what taught it; None where it is not known.
    best : the most probable soil, in the order of `PARAMETERS` and `CONTACT`.
    motion : slips and side slips. (n, 2)
    """
    if lesson is None:
        return Misfit(None, model, np.zeros((3, len(motion), 0)), shares_at(model_error, np.empty((0, 2)), motion))
    some = slice(None, None, max(1, -(-len(lesson.inputs) // MOST)))
    few = Lesson(lesson.wheel, lesson.inputs[some], lesson.forces[some])
    share, missed = shares_at(model_error, lesson.inputs[:, 1:3], motion), few.missed(best, model)
    weights, left = np.zeros((3, len(motion), len(missed))), np.ones_like(share)
    for force in range(3):
        known = np.isfinite(missed[:, force])
        if model_error[force] > 0 and known.sum() > 1:
            values, places = missed[known, force] / model_error[force], few.inputs[known, 1:3]
            weights[force][:, known], left[:, force] = _predicted(values, places, motion)
    return Misfit(few, model, weights, share * np.sqrt(left))


def shares_at(model_error: Sequence[float], taught: FloatArray, motion: FloatArray) -> FloatArray:
    """Share of the load by which the model misses F_N, F_DP, F_L at slips and side slips (n, 2 or more). (n, 3)

    Near states that taught it (m, 2) that is the model error found there. Far from them the largest of the three comes
    to it, as straight drives say nothing of how well the law knows lateral forces.
    """
    share = np.broadcast_to(np.array(model_error), (len(motion), 3))
    if not len(taught):
        return share
    nearest = (((motion[:, None, :2] - taught[None]) / ALIKE) ** 2).sum(axis=2).min(axis=1)
    elsewhere = np.maximum(share.max(), LEAST_ELSEWHERE)
    return np.asarray(np.sqrt(share**2 + (-np.expm1(-nearest))[:, None] * elsewhere**2))


def _predicted(values: FloatArray, taught: FloatArray, asked: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights of values of unit variance in the mean (n, m), and what is left of their variance (n,), averaged over how
    smooth they may be."""
    tried, roots, ln_likely = list(itertools.product(SLIPS, ANGLES_DEG, SMOOTH)), list[FloatArray](), list[float]()
    for slip, angle, smooth in tried:
        places = taught / [slip, angle]
        covariance = smooth * _alike(places, places) + (1.0 - smooth + 1e-9) * np.eye(len(values))
        roots.append(np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))
        white = np.linalg.solve(roots[-1], values)
        ln_likely.append(float(-0.5 * white @ white - np.log(np.diag(roots[-1])).sum()))
    likely = np.exp(np.array(ln_likely) - max(ln_likely))
    weights, squares = np.zeros((len(asked), len(values))), np.zeros(len(asked))
    for share, root, (slip, angle, smooth) in zip(likely / likely.sum(), roots, tried, strict=True):
        seen = np.linalg.solve(root, smooth * _alike(taught / [slip, angle], asked / [slip, angle]))
        own = np.linalg.solve(root.T, seen).T
        weights += share * own
        squares += share * (1.0 - (seen**2).sum(axis=0) + (own @ values) ** 2)
    return weights, squares - (weights @ values) ** 2


def _alike(one: FloatArray, other: FloatArray) -> FloatArray:
    """Matern 3/2: how alike two places are. (n, m)"""
    apart = np.sqrt(3.0 * ((one[:, None] - other) ** 2).sum(axis=2))
    return np.asarray((1.0 + apart) * np.exp(-apart))
