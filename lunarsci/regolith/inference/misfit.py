"""How a law misses forces, as a smooth function of slip and side slip: a Gaussian process of what a fit leaves over.

A law of wheel and soil is wrong by what it leaves out, and wrong in the same way at like slips and side slips. What is
left over in the states that taught it, as shares of the load, is a part that changes smoothly and a part of its own in
each state (Kennedy & O'Hagan 2001, 10.1111/1467-9868.00294). How large and how smooth the first is, is weighed by its
marginal likelihood (Rasmussen & Williams 2006, ch. 5). Away from the states that taught it the mean goes to 0 and the
error to that of a law that nothing taught there.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.inference.problem import forces_of_many, shares_at
from lunarsci.regolith.wheel import ContactModel, Wheel

SLIPS, ANGLES_DEG = (0.15, 0.4, 1.0), (8.0, 20.0, 50.0)
"""Candidates for the differences of slip and side slip over which what is missed changes; assumed."""
SMOOTH = (0.0, 0.3, 0.6, 0.9)
"""Candidates for the share of its variance that is smooth; assumed."""
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


def _predicted(values: FloatArray, taught: FloatArray, asked: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights of values of unit variance in the mean (n, m), and what is left of their variance (n,), averaged over how
    smooth they may be."""
    ln_likely, weights, left = [], [], []
    for slip, angle, smooth in itertools.product(SLIPS, ANGLES_DEG, SMOOTH):
        scale = np.array([slip, angle])
        covariance = smooth * _alike(taught / scale, taught / scale) + (1.0 - smooth) * np.eye(len(values))
        across = smooth * _alike(asked / scale, taught / scale)
        root = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(values)))
        white = np.linalg.solve(root, np.column_stack([values, across.T]))
        ln_likely.append(-0.5 * white[:, 0] @ white[:, 0] - np.log(np.diag(root)).sum())
        weights.append(np.linalg.solve(root.T, white[:, 1:]).T)
        left.append(1.0 - (white[:, 1:] ** 2).sum(axis=0))
    likely = np.exp(np.array(ln_likely) - max(ln_likely))
    likely /= likely.sum()
    means = np.array([weight @ values for weight in weights])
    variance = likely @ (np.array(left) + (means - likely @ means) ** 2)
    return np.einsum("h,hnm->nm", likely, np.array(weights)), np.asarray(variance)


def _alike(one: FloatArray, other: FloatArray) -> FloatArray:
    """Matern 3/2: how alike two places are. (n, m)"""
    apart = np.sqrt(3.0 * ((one[:, None] - other) ** 2).sum(axis=2))
    return np.asarray((1.0 + apart) * np.exp(-apart))
