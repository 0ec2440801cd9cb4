"""The Modified Gaussian Model itself, compiled: ln R and its derivatives with respect to every parameter."""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.gaussian import gaussian
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["FWHM_OVER_SIGMA", "model_and_jacobian", "residuals"]

FWHM_OVER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))


def model_and_jacobian(
    parameters: FloatArray, wavelength_um: FloatArray, basis: FloatArray, logarithmic: bool
) -> tuple[FloatArray, FloatArray] | None:
    """ln R, shape (n,), and its derivatives, shape (p, n); None where the continuum is not above 0.

    ln R = ln C + sum_k s_k exp(-(lambda - mu_k)^2 / (2 sigma_k^2)), sigma_k = FWHM_k / 2.3548. C = basis @ c, or
    ln C = basis @ c where `logarithmic`. Gaussians are symmetric in wavelength.

    Parameters
    ----------
    parameters : (p,) continuum coefficients c, then centre [um], FWHM [um], strength [ln reflectance] of each band.
    wavelength_um, basis : (n,) and (n, m), as `continuum_basis` gives it.

    References
    ----------
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955.
    """
    size = wavelength_um.size
    residual, work, powers = np.empty(size), np.empty(size), np.empty(size, np.int64)
    jacobian = np.empty((parameters.size, size))
    chi2 = residuals(
        parameters, wavelength_um, np.ascontiguousarray(basis.T), logarithmic, np.zeros(size), np.ones(size), residual,
        jacobian, work, powers,
    )  # fmt: skip
    return (-residual, jacobian) if math.isfinite(chi2) else None


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def residuals(
    parameters: Any, wavelength: Any, columns: Any, logarithmic: bool, data: Any, root_weight: Any, residual: Any,
    jacobian: Any, work: Any, powers: Any,
) -> float:  # fmt: skip
    """Fill `residual` (n,) with data - ln R and `jacobian` (p, n) with the derivatives of ln R, both times the root of
    the weight; return chi-square, infinite where the continuum is not above 0. `columns` is the basis, (m, n).
    """
    channels = wavelength.size
    if not _continuum(parameters, columns, logarithmic, data, root_weight, residual, jacobian, work):
        return math.inf
    for row in range(columns.shape[0], parameters.size, 3):
        centre, fwhm, strength = parameters[row], parameters[row + 1], parameters[row + 2]
        inverse = FWHM_OVER_SIGMA / fwhm
        gaussian(wavelength, centre, inverse, work, powers)
        by_centre, by_fwhm, by_strength = jacobian[row], jacobian[row + 1], jacobian[row + 2]
        slope, bend = strength * inverse, strength / fwhm
        for i in range(channels):
            x = (wavelength[i] - centre) * inverse
            residual[i] -= strength * work[i]
            shape = work[i] * root_weight[i]
            by_strength[i] = shape
            by_centre[i] = shape * x * slope
            by_fwhm[i] = shape * x * x * bend
    chi2 = 0.0
    for i in range(channels):
        residual[i] *= root_weight[i]
        chi2 += residual[i] * residual[i]
    return chi2


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _continuum(
    parameters: Any, columns: Any, logarithmic: bool, data: Any, root_weight: Any, residual: Any, jacobian: Any,
    work: Any,
) -> bool:  # fmt: skip
    """The continuum's share of `residual` and `jacobian`; False where it is not above 0."""
    degrees, channels = columns.shape
    for i in range(channels):
        work[i] = 0.0
    for m in range(degrees):
        coefficient, column = parameters[m], columns[m]
        for i in range(channels):
            work[i] += column[i] * coefficient
    if logarithmic:
        for i in range(channels):
            residual[i] = data[i] - work[i]
            work[i] = root_weight[i]
    else:
        lowest = work[0]
        for i in range(channels):
            lowest = min(lowest, work[i])
        if not lowest > 0.0:
            return False
        for i in range(channels):
            residual[i] = data[i] - math.log(work[i])
        for i in range(channels):
            work[i] = root_weight[i] / work[i]
    for m in range(degrees):
        row, column = jacobian[m], columns[m]
        for i in range(channels):
            row[i] = column[i] * work[i]
    return True
