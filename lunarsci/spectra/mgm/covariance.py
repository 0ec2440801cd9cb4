"""Laplace's covariance of a fit, with bounds taken into account."""

import math

import numpy as np

from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["bounded_covariance"]


def bounded_covariance(
    curvature: FloatArray, gradient: FloatArray | None, point: FloatArray, model: MgmModel
) -> FloatArray:
    """Inverse curvature of the parameters that are free, shape (p, p), as far as those on a bound let them.

    A parameter that the data press against a bound has a one-sided density, exp(-g t - h t^2 / 2) in the distance t
    from the bound, g the slope there and h the curvature with the free ones following; its variance is the mean of
    t^2, and the free ones follow it. Without `gradient` such parameters do not move at all. Fixed ones have variance 0.
    """
    held = ((point <= model.lower) | (point >= model.upper)) & ~model.fixed
    free = ~held & ~model.fixed
    covariance = np.zeros_like(curvature)
    inverse = _inverse(curvature[np.ix_(free, free)])
    covariance[np.ix_(free, free)] = inverse
    if gradient is None:
        return covariance
    for k in np.flatnonzero(held):
        follow = -inverse @ curvature[free, k]
        bend = float(curvature[k, k] + curvature[k, free] @ follow)
        variance = _one_sided(abs(float(gradient[k])), bend)
        move = np.zeros(point.size)
        move[k], move[free] = 1.0, follow
        covariance += variance * np.outer(move, move)
    return covariance


def _inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def _one_sided(slope: float, bend: float) -> float:
    """Mean of t^2 under exp(-slope t - bend t^2 / 2), t >= 0: normal law truncated at 0."""
    if not bend > 0:
        return math.nan
    root = math.sqrt(bend)
    a = slope / root
    if a > TAIL:
        return 2.0 / slope**2 * (1.0 - 5.0 / a**2)
    ratio = math.exp(-0.5 * a * a) * math.sqrt(2.0 / math.pi) / math.erfc(a / math.sqrt(2.0))
    return (1.0 + a * a - a * ratio) / bend


TAIL = 30.0
"""From here on the law is an exponential one with a first correction, to 1e-4, and the error function runs out."""
