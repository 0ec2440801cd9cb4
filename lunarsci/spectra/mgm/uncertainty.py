"""What errors that channels share do to a fit: the moves of its minimum, to first order."""

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.mgm.model import MgmModel

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
