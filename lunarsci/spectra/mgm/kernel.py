"""The compiled heart of the Modified Gaussian Model: one bounded Levenberg-Marquardt for one spectrum and for a batch.

A parameter vector is [continuum coefficients (m), then centre, FWHM, strength of each band]. Wavelengths, centres and
widths are in micrometres here, so that every parameter is of order one.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled, each_in_threads
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["CONVERGED", "FWHM_OVER_SIGMA", "ITERATION_LIMIT", "NOT_FINITE", "fit_batch", "model_and_jacobian"]

FWHM_OVER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
ROWS_PER_TASK = 8
CONVERGED, ITERATION_LIMIT, NOT_FINITE = 0, 1, 2


@compiled
def model_and_jacobian(parameters: Any, wavelength: Any, basis: Any, model: Any, jacobian: Any) -> bool:
    """Fill `model` (n,) with ln R and `jacobian` (p, n) with its derivatives; False where the continuum is not above 0.

    ln R = ln C + sum_k s_k exp(-(lambda - mu_k)^2 / (2 sigma_k^2)), sigma_k = FWHM_k / 2.3548, C = basis @ c.
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955.
    """
    degrees = basis.shape[1]
    for i in range(wavelength.size):
        continuum = 0.0
        for m in range(degrees):
            continuum += basis[i, m] * parameters[m]
        if not continuum > 0.0:
            return False
        model[i] = math.log(continuum)
        for m in range(degrees):
            jacobian[m, i] = basis[i, m] / continuum
    for row in range(degrees, parameters.size, 3):
        centre, fwhm, strength = parameters[row], parameters[row + 1], parameters[row + 2]
        inverse = FWHM_OVER_SIGMA / fwhm
        for i in range(wavelength.size):
            x = (wavelength[i] - centre) * inverse
            shape = math.exp(-0.5 * x * x)
            model[i] += strength * shape
            jacobian[row, i] = strength * shape * x * inverse
            jacobian[row + 1, i] = strength * shape * x * x / fwhm
            jacobian[row + 2, i] = shape
    return True


@compiled
def _objective(data: Any, weight: Any, model: Any, parameters: Any, prior: Any, precision: Any) -> tuple[float, float]:
    """Chi-square of the data, and the same with the prior's share."""
    chi2, total = 0.0, 0.0
    for i in range(data.size):
        residual = data[i] - model[i]
        chi2 += weight[i] * residual * residual
    for p in range(parameters.size):
        shift = parameters[p] - prior[p]
        total += precision[p] * shift * shift
    return chi2, chi2 + total


@compiled
def _normal_equations(
    data: Any, weight: Any, model: Any, jacobian: Any, parameters: Any, prior: Any, precision: Any, curvature: Any,
    gradient: Any,
) -> None:  # fmt: skip
    """curvature = J W J' + prior precision, gradient = J W (data - model) - precision (p - prior)."""
    size, channels = jacobian.shape
    weighted = np.empty((size, channels))
    for p in range(size):
        slope = 0.0
        for i in range(channels):
            weighted[p, i] = jacobian[p, i] * weight[i]
            slope += weighted[p, i] * (data[i] - model[i])
        gradient[p] = slope - precision[p] * (parameters[p] - prior[p])
    np.dot(weighted, jacobian.T, curvature)
    for p in range(size):
        curvature[p, p] += precision[p]


@compiled
def _cholesky(matrix: Any, factor: Any) -> bool:
    """Lower factor L of a symmetric matrix L L'; False when it is not positive definite."""
    size = matrix.shape[0]
    for row in range(size):
        for column in range(row + 1):
            total = matrix[row, column]
            for k in range(column):
                total -= factor[row, k] * factor[column, k]
            if row == column:
                if not total > 0.0:
                    return False
                factor[row, row] = math.sqrt(total)
            else:
                factor[row, column] = total / factor[column, column]
    return True


@compiled
def _solve(factor: Any, right: Any) -> None:
    """Overwrite `right` with the solution of L L' x = right."""
    size = right.size
    for row in range(size):
        for k in range(row):
            right[row] -= factor[row, k] * right[k]
        right[row] /= factor[row, row]
    for row in range(size - 1, -1, -1):
        for k in range(row + 1, size):
            right[row] -= factor[k, row] * right[k]
        right[row] /= factor[row, row]


@compiled
def _invert(matrix: Any, inverse: Any) -> None:
    """Inverse of a positive definite matrix; NaN where it is not."""
    size = matrix.shape[0]
    factor, column = np.zeros((size, size)), np.empty(size)
    inverse[:, :] = np.nan
    if _cholesky(matrix, factor):
        for k in range(size):
            column[:] = 0.0
            column[k] = 1.0
            _solve(factor, column)
            inverse[:, k] = column


@compiled
def _damped_step(
    curvature: Any, gradient: Any, point: Any, lower: Any, upper: Any, free: Any, damping: float, step: Any
) -> None:
    """Marquardt's step within the bounds: what would cross one stops there, and the others are solved again."""
    size = gradient.size
    matrix, factor, trial = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    step[:] = 0.0
    for _ in range(size):
        for p in range(size):
            trial[p] = gradient[p] if free[p] else step[p]
            for q in range(size):
                matrix[p, q] = curvature[p, q] if free[p] and free[q] else 0.0
                if free[p] and not free[q]:
                    trial[p] -= curvature[p, q] * step[q]
            matrix[p, p] = matrix[p, p] * (1.0 + damping) if free[p] else 1.0
        if not _cholesky(matrix, factor):
            return
        _solve(factor, trial)
        crossed = False
        for p in range(size):
            allowed = min(max(trial[p], lower[p] - point[p]), upper[p] - point[p])
            if free[p] and allowed != trial[p]:
                free[p], crossed = False, True
            step[p] = allowed
        if not crossed:
            return


@compiled
def _predicted_decrease(curvature: Any, gradient: Any, step: Any) -> float:
    """By how much the quadratic model of the objective falls along a step."""
    decrease = 0.0
    for p in range(step.size):
        bend = 0.0
        for q in range(step.size):
            bend += curvature[p, q] * step[q]
        decrease += step[p] * (2.0 * gradient[p] - bend)
    return decrease


@compiled
def _mark_free(parameters: Any, gradient: Any, lower: Any, upper: Any, free: Any) -> None:
    """A parameter on its bound is free only when the objective falls away from the bound."""
    for p in range(parameters.size):
        held_low = parameters[p] <= lower[p] and gradient[p] < 0.0
        held_high = parameters[p] >= upper[p] and gradient[p] > 0.0
        free[p] = not (held_low or held_high or lower[p] == upper[p])


@compiled
def _fit_one(
    data: Any, weight: Any, wavelength: Any, basis: Any, prior: Any, precision: Any, lower: Any, upper: Any,
    start: Any, tolerance: float, max_iterations: int, best: Any, covariance: Any, statistics: Any,
) -> None:  # fmt: skip
    size, channels = start.size, data.size
    model, jacobian = np.empty(channels), np.empty((size, channels))
    curvature, gradient = np.empty((size, size)), np.empty(size)
    step, trial = np.empty(size), np.empty(size)
    free = np.ones(size, dtype=np.bool_)
    for p in range(size):
        best[p] = min(max(start[p], lower[p]), upper[p])
    covariance[:, :] = np.nan
    statistics[0], statistics[1], statistics[2], statistics[3] = np.nan, np.nan, 0.0, NOT_FINITE
    if not model_and_jacobian(best, wavelength, basis, model, jacobian):
        return
    chi2, total = _objective(data, weight, model, best, prior, precision)
    if not math.isfinite(total):
        return
    damping, growth, status, iteration = 1e-3, 2.0, ITERATION_LIMIT, 0
    _normal_equations(data, weight, model, jacobian, best, prior, precision, curvature, gradient)
    while iteration < max_iterations:
        iteration += 1
        _mark_free(best, gradient, lower, upper, free)
        _damped_step(curvature, gradient, best, lower, upper, free, damping, step)
        predicted = _predicted_decrease(curvature, gradient, step)
        if predicted <= tolerance:
            if damping <= 1e-2:
                status = CONVERGED
                break
            damping, growth = damping * 0.1, 2.0
            continue
        gain, trial_chi2, trial_total = -1.0, chi2, total
        for p in range(size):
            trial[p] = best[p] + step[p]
        if model_and_jacobian(trial, wavelength, basis, model, jacobian):
            trial_chi2, trial_total = _objective(data, weight, model, trial, prior, precision)
            gain = total - trial_total
        if not gain > 0.0:
            if predicted <= 10.0 * tolerance:
                status = CONVERGED
                break
            damping, growth = damping * growth, growth * 2.0
            if damping > 1e12:
                break
            continue
        best[:] = trial
        chi2, total = trial_chi2, trial_total
        damping *= max(0.1, 1.0 - (2.0 * gain / predicted - 1.0) ** 3)
        growth = 2.0
        _normal_equations(data, weight, model, jacobian, best, prior, precision, curvature, gradient)
    _invert(curvature, covariance)
    statistics[0], statistics[1], statistics[2], statistics[3] = chi2, total, iteration, status


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def fit_rows(
    first: int, last: int, data: Any, weight: Any, wavelength: Any, basis: Any, prior: Any, precision: Any, lower: Any,
    upper: Any, starts: Any, tolerance: float, max_iterations: int, parameters: Any, covariance: Any, statistics: Any,
) -> None:  # fmt: skip
    """Fit the spectra `first` to `last` - 1 from every start, into the arrays that `fit_batch` returns."""
    for row in range(first, last):
        for s in range(starts.shape[0]):
            _fit_one(
                data[row], weight[row], wavelength, basis, prior, precision, lower, upper, starts[s, row],
                tolerance, max_iterations, parameters[row, s], covariance[row, s], statistics[row, s],
            )  # fmt: skip


def fit_batch(
    data: FloatArray, weight: FloatArray, wavelength: FloatArray, basis: FloatArray, prior: FloatArray,
    precision: FloatArray, lower: FloatArray, upper: FloatArray, starts: FloatArray, tolerance: float,
    max_iterations: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Fit every row of `data` from every start, in all threads.

    Parameters
    ----------
    data, weight : (n_spectra, n) ln R and 1/sigma^2 (0 where masked).
    wavelength, basis : (n,) [um] and (n, m) continuum basis.
    prior, precision, lower, upper : (p,) prior mean and 1/sigma^2 (0 for a flat prior), bounds (equal: fixed).
    starts : (n_starts, n_spectra, p).
    tolerance : expected decrease of the objective, in units of chi-square, at which a fit has converged.

    Returns
    -------
    parameters (n_spectra, n_starts, p), covariance (n_spectra, n_starts, p, p), statistics (n_spectra, n_starts, 4),
    which are chi-square, the same with the prior, iterations, status.
    """
    n_starts, n_spectra, size = starts.shape
    parameters = np.empty((n_spectra, n_starts, size))
    covariance = np.empty((n_spectra, n_starts, size, size))
    statistics = np.empty((n_spectra, n_starts, 4))

    def some(part: int) -> None:
        fit_rows(
            part * ROWS_PER_TASK, min((part + 1) * ROWS_PER_TASK, n_spectra), data, weight, wavelength, basis, prior,
            precision, lower, upper, starts, tolerance, max_iterations, parameters, covariance, statistics,
        )  # fmt: skip

    each_in_threads(some, -(-n_spectra // ROWS_PER_TASK))
    return parameters, covariance, statistics
