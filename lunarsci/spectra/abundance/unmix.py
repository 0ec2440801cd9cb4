"""Modes of a mixture from its spectrum and the laws of its minerals' powders: posterior by Laplace's method.

ln R = ln R(sum_i f_i x(t_i)) + g0 + g1 u + g2 (u^2 - mean), with u the wavelength in um from 1.45, and
t_i = mean_i + z_i . shapes_i + s. Fractions f are a softmax; z and s, the level that all share, are standard normal, s
scaled by `COMMON_LEVEL`; g is a neutral darkening or brightening (opaques, photometry, packing), tilted and bent.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.abundance.mixing import MixingLaw
from lunarsci.spectra.abundance.population import MineralPopulation
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Posterior", "unmix"]

LOGIT_SIGMA = 2.0
COMMON_LEVEL = 0.8
NEUTRAL = np.array([0.3, 0.1, 0.03])
"""Standard deviations of g; assumed, like those above."""
ORIGIN_UM = 1.45
STEPS, DAMPING, CONVERGED = 60, 1e-3, 1e-4
LEADING = 2.0
"""Logit of the mineral that a start favours."""


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Normal approximation around the lowest minimum.

    Attributes
    ----------
    logits, covariance : (m,) and (m, m) of the fractions' logits.
    objective : chi-square and the prior's share together.
    ln_evidence : to a constant of the data.
    ln_residual : (n,) data - model. [-]
    strain : the prior's share of the objective: how unlike the end members the minerals must be taken. [-]
    """

    logits: FloatArray
    covariance: FloatArray
    objective: float
    ln_evidence: float
    ln_residual: FloatArray
    strain: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    law: MixingLaw
    minerals: Sequence[MineralPopulation]
    neutral: FloatArray
    ln_reflectance: FloatArray
    root_weight: FloatArray

    @property
    def size(self) -> int:
        return len(self.minerals) + sum(len(item.shapes) for item in self.minerals) + 1 + len(NEUTRAL)

    def scaled(self) -> FloatArray:
        """Prior standard deviations, (p,)."""
        plain = np.ones(self.size)
        plain[: len(self.minerals)], plain[-len(NEUTRAL) :] = LOGIT_SIGMA, NEUTRAL
        return plain

    def model(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln R, (n,), and its derivatives, (p, n)."""
        count, common = len(self.minerals), point[-len(NEUTRAL) - 1] * COMMON_LEVEL
        fractions = softmax(point[:count])
        pairs, at = [], count
        for item in self.minerals:
            pairs.append(self.law.mixing(item.mean + point[at : at + len(item.shapes)] @ item.shapes + common))
            at += len(item.shapes)
        x, slope = (np.array(part) for part in zip(*pairs, strict=True))
        mixed = fractions @ x
        ln_model, by_x = self.law.ln_reflectance(mixed)
        rows = [by_x * fractions[:, None] * (x - mixed)]
        rows += [
            by_x * share * own * item.shapes for share, own, item in zip(fractions, slope, self.minerals, strict=True)
        ]
        rows += [(by_x * (fractions @ slope) * COMMON_LEVEL)[None], self.neutral]
        return ln_model + point[-len(NEUTRAL) :] @ self.neutral, np.concatenate(rows)


def softmax(logits: FloatArray) -> FloatArray:
    """Shares that sum to 1 along the last axis."""
    raised = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=-1, keepdims=True))


def unmix(
    wavelength_nm: FloatArray,
    reflectance: FloatArray,
    sigma_ln: FloatArray,
    minerals: Sequence[MineralPopulation],
    law: MixingLaw,
) -> Posterior:
    """Fit from one start per mineral and one of equal shares; the lowest minimum counts.

    Parameters
    ----------
    wavelength_nm, reflectance : (n,) each. [nm, -]
    sigma_ln : (n,) standard deviation of ln R, errors of the model included. [-]
    minerals : two or more, on these channels.

    References
    ----------
    Lapotre, Ehlmann & Minson (2017), J. Geophys. Res. Planets 122, 983, 10.1002/2016JE005248 (Bayesian unmixing).
    """
    u = wavelength_nm / 1e3 - ORIGIN_UM
    neutral = np.array([np.ones_like(u), u, u**2 - np.mean(u**2)])
    problem = _Problem(law, minerals, neutral, np.log(reflectance), 1.0 / sigma_ln)
    starts = np.zeros((len(minerals) + 1, problem.size))
    starts[np.arange(len(minerals)), np.arange(len(minerals))] = LEADING
    point, objective, curvature = min((_descend(problem, start) for start in starts), key=lambda found: found[1])
    return _posterior(problem, point, objective, curvature)


def _objective(problem: _Problem, point: FloatArray, scale: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Chi-square and prior, half their slope and curvature (Gauss-Newton)."""
    ln_model, jacobian = problem.model(point)
    residual = (problem.ln_reflectance - ln_model) * problem.root_weight
    weighted = jacobian * problem.root_weight
    value = float(residual @ residual + np.sum((point / scale) ** 2))
    return value, weighted @ residual - point / scale**2, weighted @ weighted.T + np.diag(scale**-2)


def _descend(problem: _Problem, start: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Levenberg-Marquardt; point, objective and curvature."""
    scale, point, damping = problem.scaled(), start, DAMPING
    value, slope, curvature = _objective(problem, point, scale)
    for _ in range(STEPS):
        damped = curvature + damping * np.diag(np.diag(curvature))
        step = np.linalg.solve(damped, slope)
        trial = _objective(problem, point + step, scale)
        if not trial[0] < value:
            if slope @ step < CONVERGED:
                break
            damping = min(10.0 * damping, 1e8)
            continue
        small = value - trial[0] < CONVERGED
        point, damping = point + step, damping / 5.0
        value, slope, curvature = trial
        if small:
            break
    return point, value, curvature


def _posterior(problem: _Problem, point: FloatArray, objective: float, curvature: FloatArray) -> Posterior:
    covariance = np.linalg.inv(curvature)
    count, scale = len(problem.minerals), problem.scaled()
    volume = np.linalg.slogdet(curvature * np.outer(scale, scale))[1]
    residual = problem.ln_reflectance - problem.model(point)[0]
    return Posterior(
        point[:count],
        np.asarray(covariance[:count, :count], dtype=np.float64),
        objective,
        -0.5 * (objective + float(volume)),
        residual,
        float(np.sum((point / scale) ** 2)),
    )
