"""Modes of mixtures from their spectra and the laws of their minerals' powders: posterior by Laplace's method."""

from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.abundance.suite import Equations, Suite
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["SharesPosterior", "unmix"]

STEPS, DAMPING, HIGHEST_DAMPING = 500, 1e-3, 1e8
NEAR, CONVERGED = 0.1, 1e-5
"""Gains of a step at which starts are compared, and at which the best is done."""

LIFTED = 0.06
"""Least root at which curvature is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class SharesPosterior:
    """Normal approximation around the lowest minimum.

    Attributes
    ----------
    roots, covariance : (s, m) and (s, m, m): fractions are squares of roots over their sum.
    objective : chi-square and the prior's share together.
    ln_evidence : to a constant of the data.
    ln_residual : (s, n) data - model. [-]
    strain : (s,) the prior's share of the objective, that of the powders in equal parts: how unlike the end members the
        minerals must be taken. [-]
    """

    roots: FloatArray
    covariance: FloatArray
    objective: float
    ln_evidence: float
    ln_residual: FloatArray
    strain: FloatArray

    @property
    def shares(self) -> FloatArray:
        """Fractions at the minimum, (s, m)."""
        return shares(self.roots)

    def draws(self, count: int, seed: int) -> FloatArray:
        """Fractions drawn from the posterior, (count, s, m)."""
        rng = np.random.default_rng(seed)
        sizes, directions = np.linalg.eigh(self.covariance)
        root = directions * np.sqrt(np.maximum(sizes, 0.0))[:, None, :]
        normal = rng.standard_normal((count, *self.roots.shape))
        return shares(self.roots + np.einsum("sij,csj->csi", root, normal))


def shares(roots: FloatArray) -> FloatArray:
    """Fractions from roots along the last axis."""
    squares = roots**2
    return np.asarray(squares / squares.sum(axis=-1, keepdims=True))


def unmix(suite: Suite) -> SharesPosterior:
    """Fit all spectra of a suite with powders common to all.

    One spectrum alone is started from equal shares and from each mineral in front, and the lowest minimum counts; a
    suite from equal shares (on seven laboratory suites of 3 to 20 mixtures no other start ended lower).

    References
    ----------
    Lapotre, Ehlmann & Minson (2017), J. Geophys. Res. Planets 122, 983, 10.1002/2016JE005248 (Bayesian unmixing).
    """
    favoured = [None, *(range(suite.minerals) if len(suite.ln_reflectance) == 1 else ())]
    shared = np.zeros(suite.powders.size)
    ends = [_descend(suite, shared, suite.start(mineral), NEAR) for mineral in favoured]
    shared, own, _ = min(ends, key=lambda end: end[2].value)
    return _posterior(suite, *_descend(suite, shared, own, CONVERGED))


def _descend(
    suite: Suite, shared: FloatArray, own: FloatArray, least_gain: float
) -> tuple[FloatArray, FloatArray, Equations]:
    """Levenberg-Marquardt; parameters and the equations there."""
    damping, equations = DAMPING, suite.equations(shared, own)
    for _ in range(STEPS):
        shared_step, own_step = _solve(equations, damping)
        value = suite.value(shared + shared_step, own + own_step)
        if not value < equations.value:
            damping *= 10.0
            if damping > HIGHEST_DAMPING:
                break
            continue
        gained = equations.value - value
        shared, own, damping = shared + shared_step, own + own_step, damping / 5.0
        equations = suite.equations(shared, own)
        if gained < least_gain:
            break
    return shared, own, equations


def _solve(equations: Equations, damping: float) -> tuple[FloatArray, FloatArray]:
    """The damped step, the spectra's own parameters eliminated first."""
    own = equations.own * (1.0 + damping * np.eye(equations.own.shape[-1]))
    inverse = np.linalg.inv(own)
    folded = np.matmul(equations.across, inverse)
    across = equations.across.transpose(0, 2, 1)
    shared = equations.shared * (1.0 + damping * np.eye(len(equations.shared)))
    left = shared - np.matmul(folded, across).sum(axis=0)
    right = equations.shared_slope - np.einsum("spq,sq->p", folded, equations.own_slope)
    step = np.linalg.solve(left, right)
    return step, np.einsum("sqr,sr->sq", inverse, equations.own_slope - across @ step)


def _posterior(suite: Suite, shared: FloatArray, own: FloatArray, lowest: Equations) -> SharesPosterior:
    """At a root of 0 the model does not change to first order; its curvature is that at `LIFTED`."""
    count = suite.minerals
    raised = own.copy()
    raised[:, :count] = np.where(suite.sought * (np.abs(own[:, :count]) < LIFTED) > 0, LIFTED, own[:, :count])
    equations = suite.equations(shared, raised)
    inverse = np.linalg.inv(equations.own)
    folded = np.matmul(equations.across, inverse)
    left = equations.shared - np.matmul(folded, equations.across.transpose(0, 2, 1)).sum(axis=0)
    back = folded.transpose(0, 2, 1)
    covariance = inverse + back @ np.linalg.inv(left) @ folded
    sought = suite.sought
    volume = float(np.linalg.slogdet(left)[1] + np.linalg.slogdet(equations.own)[1].sum())
    volume += 2 * len(own) * float(np.log(suite.scale).sum())
    strain = np.sum(shared**2) / len(own) + np.sum((own / suite.scale)[:, count:] ** 2, axis=1)
    return SharesPosterior(
        own[:, :count] * suite.present,
        covariance[:, :count, :count] * sought[:, :, None] * sought[:, None, :],
        lowest.value,
        -0.5 * (lowest.value + volume),
        suite.ln_reflectance - suite.ln_model(shared, own),
        strain,
    )
