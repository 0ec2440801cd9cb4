"""What errors do: those that channels share to the minimum of a fit, those of a fit to the compositions it tells."""

from functools import lru_cache
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.assemblages import Assemblage
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.mgm.model import NM_PER_UM, MgmModel, center_slopes, prior_covariance

LEAST_KEPT = 0.1
"""Share of the curvature that must be left for the first order to be believed; assumed."""


def follow_shifts(
    data: MgmData, model: MgmModel, point: FloatArray, ln_model: FloatArray, jacobian: FloatArray
) -> FloatArray:
    """First-order moves of the minimum at `point` under each of the data's `shifts`, shape (n_shifts, p).

    Half the objective's second derivatives decide them, the share of the misfit included: along the flat valleys of
    this model even a small misfit bends the objective as much as the prior. Where the misfit takes away most of the
    curvature in some direction, the minimum is about to jump and no first order tells how far; the misfit's share is
    left out there. Parameters on a bound stay on it.
    """
    if not len(data.shifts):
        return np.empty((0, point.size))
    fisher = (jacobian * data.weight) @ jacobian.T + model.precision
    pull = data.weight * (ln_model - np.log(data.reflectance))
    curvature = fisher + misfit_curvature(data, model, point, jacobian, pull)
    free = (point > model.lower) & (point < model.upper)
    if not _mostly_kept(curvature[np.ix_(free, free)], fisher[np.ix_(free, free)]):
        curvature = fisher
    response = np.zeros_like(curvature)
    response[np.ix_(free, free)] = _inverse(curvature[np.ix_(free, free)])
    return np.asarray(data.shifts @ (jacobian * data.weight).T @ response, dtype=np.float64)


def misfit_curvature(
    data: MgmData, model: MgmModel, point: FloatArray, jacobian: FloatArray, pull: FloatArray
) -> FloatArray:
    """Sum over channels of `pull` (n,) times the second derivatives of ln R with respect to parameters, shape (p, p).

    Bands do not bend each other, nor the continuum; its coefficients bend ln R only where they are of C, not of ln C.
    """
    found = np.zeros((point.size, point.size))
    m = model.degrees
    if not model.logarithmic:
        slopes = jacobian[:m]
        found[:m, :m] = -(slopes * pull) @ slopes.T
    wavelength = data.wavelength_nm / 1e3
    for row in range(m, point.size, 3):
        centre, fwhm, strength = point[row : row + 3]
        sigma = fwhm / FWHM_OVER_SIGMA
        x = (wavelength - centre) / sigma
        sums = np.vander(x, 5, increasing=True).T @ (pull * jacobian[row + 2])
        block = found[row : row + 3, row : row + 3]
        block[0, 0] = strength / sigma**2 * (sums[2] - sums[0])
        block[0, 1] = block[1, 0] = strength / (sigma * fwhm) * (sums[3] - 2 * sums[1])
        block[1, 1] = strength / fwhm**2 * (sums[4] - 3 * sums[2])
        block[0, 2] = block[2, 0] = sums[1] / sigma
        block[1, 2] = block[2, 1] = sums[2] / fwhm
    return found


def _mostly_kept(curvature: FloatArray, fisher: FloatArray) -> bool:
    """Whether `curvature` exceeds `LEAST_KEPT` times `fisher` in every direction."""
    try:
        np.linalg.cholesky(curvature - LEAST_KEPT * fisher)
    except np.linalg.LinAlgError:
        return False
    return True


def _inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def composition_moments(model: MgmModel, values: FloatArray, covariance: FloatArray) -> FloatArray:
    """Mean and variance, (n, k, 2), of the assemblage's compositions at centres of fits, whatever minerals are there.

    `values` and `covariance` are (n, p) and (n, p, p). [mol %, mol %^2]

    A priori, centres and compositions x are jointly normal: centre = trend(x) + scatter. Given the centres alone,

        x | c  ~  N(x0 + G (c - c0),  P - G S P),   G = P S' C^-1,   C = S P S' + scatter

    with P the prior covariance of x, S the slopes of the trends and C the prior covariance of the centres. The fit is
    already the posterior of c under the prior C, into which the spread of x went; averaging x | c over it adds
    G V G', V the covariance of the fit, and counts no prior twice. Scatter about the trends is in the result, a
    mineral that the trends do not describe (manganese in olivine, zoning) is not.

    References
    ----------
    Sunshine & Pieters (1998), J. Geophys. Res. 103, 13675, 10.1029/98JE01217 (olivine); Klima, Pieters & Dyar (2007),
    Meteorit. Planet. Sci. 42, 235, 10.1111/j.1945-5100.2007.tb00230.x (pyroxene).
    """
    m, items = model.degrees, model.assemblage.compositions
    found = np.empty((len(values), len(items), 2))
    if items:
        centres, gain, first = _composition_law(model.assemblage)
        _average(values[:, m::3] - centres, covariance[:, m:, m:], gain, first, found[:, :, 0], found[:, :, 1])
    return found


@lru_cache(maxsize=32)
def _composition_law(assemblage: Assemblage) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """c0, G, and x0 with the diagonal of P - G S P. [um, mol % / um, mol %, mol %^2]"""
    items = assemblage.compositions
    slopes, spread = center_slopes(assemblage), np.diag([item.sigma**2 for item in items])
    gain = np.asarray(np.linalg.solve(prior_covariance(assemblage), slopes @ spread).T, dtype=np.float64)
    centres = np.array([band.center_nm / NM_PER_UM for band in assemblage.bands])
    return centres, gain, (np.array([item.mean for item in items]), np.diag(spread - gain @ slopes @ spread))


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _average(offset: Any, covariance: Any, gain: Any, first: Any, mean: Any, variance: Any) -> None:
    """x0 + G (c - c0) and the diagonal of P - G S P + G V G', row by row."""
    compositions, size = gain.shape
    for row in range(mean.shape[0]):
        for k in range(compositions):
            total, spread = first[0][k], first[1][k]
            for p in range(0, size, 3):
                total += gain[k, p] * offset[row, p // 3]
            for p in range(size):
                for q in range(size if gain[k, p] != 0.0 else 0):
                    spread += gain[k, p] * covariance[row, p, q] * gain[k, q]
            mean[row, k], variance[row, k] = total, spread
