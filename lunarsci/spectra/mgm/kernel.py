"""One kernel for one spectrum and for a million: many starts on a coarse spectrum, the best finished on all channels.

A parameter vector is [continuum coefficients (m), then centre, FWHM, strength of each band]. Wavelengths, centres and
widths are in micrometres here, so that every parameter is of order one.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.compiled import compiled, each_in_threads
from lunarsci.spectra.mgm.cholesky import invert, padded
from lunarsci.spectra.mgm.coarse import coarse_size, coarsen, correct
from lunarsci.spectra.mgm.descent import CONVERGED, ITERATION_LIMIT, NOT_FINITE, descend
from lunarsci.spectra.mgm.forward import residuals
from lunarsci.spectra.mgm.normal import products
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["CONVERGED", "ITERATION_LIMIT", "NOT_FINITE", "KernelFits", "fit_batch"]

ROWS_PER_TASK = 8
COARSE_TOLERANCE = 1e-2
FIRST_DAMPING, LATER_DAMPING = 1e-3, 1e-6
RIVAL_CHI2 = 5.0
"""Coarse minima within this of the best are finished on all channels too."""
SAME_SIGMAS = 0.5
"""Coarse minima within this of a finished one, in posterior standard deviations, lead to the same place."""


@dataclass(frozen=True, slots=True, eq=False)
class KernelFits:
    """What `fit_batch` gives, row by row.

    Attributes
    ----------
    parameters, covariance : (n, p) and (n, p, p), of the lowest minimum; the inverse curvature, bounds not considered.
    chi2, objective : (n,) of the data, and with the prior's share.
    iterations, status : (n,) of the last descent on all channels; `CONVERGED`, `ITERATION_LIMIT` or `NOT_FINITE`.
    rival, rival_sigmas : (n,) by how much the objective of the next minimum is higher, infinite if there is none within
        `RIVAL_CHI2`, and how far it lies, in posterior standard deviations of the parameter that differs most.
    """

    parameters: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    objective: FloatArray
    iterations: FloatArray
    status: FloatArray
    rival: FloatArray
    rival_sigmas: FloatArray


@compiled
def _distance(first: Any, second: Any, covariance: Any) -> float:
    """Largest difference of a parameter in its standard deviations."""
    largest = 0.0
    for p in range(first.size):
        if covariance[p, p] > 0.0:
            largest = max(largest, abs(first[p] - second[p]) / math.sqrt(covariance[p, p]))
    return largest


@compiled
def _evaluate(channels: Any, logarithmic: bool, point: Any, room: Any) -> float:
    """Residuals and Jacobian of `point` into `room`; chi-square."""
    wavelength, columns, data, root_weight = channels
    jacobian, residual, work, powers = room
    chi2: float = residuals(
        point, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work, powers
    )
    return chi2


@compiled
def _covariance(
    channels: Any, logarithmic: bool, precision: Any, best: Any, room: Any, solver: Any, covariance: Any
) -> None:
    """Inverse curvature at `best`; NaN where there is none."""
    curvature, matrix = solver[0], solver[1]
    size = best.size
    _evaluate(channels, logarithmic, best, room)
    products(room[0], curvature)
    for p in range(matrix.shape[0]):
        for q in range(p, matrix.shape[0]):
            inside = p < size and q < size
            matrix[p, q] = curvature[q, p] + precision[p, q] if inside else (1.0 if p == q else 0.0)
    if not invert(matrix, covariance):
        covariance[:, :] = math.nan


@compiled
def _finish(
    fine: Any, coarse: Any, used: Any, together: int, logarithmic: bool, prior: Any, precision: Any, lower: Any,
    upper: Any, tolerance: float, max_iterations: int, fine_room: Any, coarse_room: Any, solver: Any, best: Any,
    outcome: Any,
) -> None:  # fmt: skip
    """From a coarse minimum to that of all channels: the coarse data corrected there, the descent repeated, then ended
    on all channels."""
    if together > 1:
        chi2 = residuals(
            best,
            fine[0],
            fine[1],
            logarithmic,
            fine[2],
            fine[3],
            fine_room[1],
            fine_room[0],
            fine_room[2],
            fine_room[3],
        )
        if math.isfinite(chi2):
            residuals(
                best,
                coarse[0],
                coarse[1],
                logarithmic,
                coarse[2],
                coarse[3],
                coarse_room[1],
                coarse_room[0],
                coarse_room[2],
                coarse_room[3],
            )
            correct(fine, together, coarse, fine_room[1], coarse_room[1])
            descend(
                coarse, used[1], logarithmic, prior, precision, lower, upper, False, LATER_DAMPING, tolerance,
                max_iterations, best, coarse_room, solver, outcome,
            )  # fmt: skip
    descend(
        fine, used[0], logarithmic, prior, precision, lower, upper, False, LATER_DAMPING, tolerance, max_iterations,
        best, fine_room, solver, outcome,
    )  # fmt: skip


@compiled
def _fit_row(
    fine: Any, coarse: Any, together: int, logarithmic: bool, prior: Any, precision: Any, lower: Any, upper: Any,
    starts: Any, tolerance: float, max_iterations: int, fine_room: Any, coarse_room: Any, solver: Any, found: Any,
    outcomes: Any, best: Any, covariance: Any, statistics: Any,
) -> None:  # fmt: skip
    """Fit one spectrum: `found` and `outcomes` hold what each start leads to on the coarse spectrum."""
    used = (float(np.sum(fine[3] > 0.0)), float(coarsen(fine, together, coarse)))
    lowest = 0
    for s in range(starts.shape[0]):
        found[s] = starts[s]
        descend(
            coarse, used[1], logarithmic, prior, precision, lower, upper, True, FIRST_DAMPING, COARSE_TOLERANCE,
            max_iterations, found[s], coarse_room, solver, outcomes[s],
        )  # fmt: skip
        if outcomes[s, 1] < outcomes[lowest, 1]:
            lowest = s
    other, trial = np.empty(4), np.empty(best.size)
    best[:] = found[lowest]
    covariance[:, :] = math.nan
    statistics[4], statistics[5] = math.inf, 0.0
    _finish(
        fine, coarse, used, together, logarithmic, prior, precision, lower, upper, tolerance, max_iterations, fine_room,
        coarse_room, solver, best, statistics[:4],
    )  # fmt: skip
    if statistics[3] == NOT_FINITE:
        return
    _covariance(fine, logarithmic, precision, best, fine_room, solver, covariance)
    for s in range(starts.shape[0]):
        if s == lowest or not outcomes[s, 1] < outcomes[lowest, 1] + RIVAL_CHI2:
            continue
        if not _distance(found[s], best, covariance) > SAME_SIGMAS:
            continue
        trial[:] = found[s]
        _finish(
            fine, coarse, used, together, logarithmic, prior, precision, lower, upper, tolerance, max_iterations,
            fine_room, coarse_room, solver, trial, other,
        )  # fmt: skip
        apart = _distance(trial, best, covariance)
        if not apart > SAME_SIGMAS:
            continue
        difference = other[1] - statistics[1]
        if difference < 0.0:
            best[:] = trial
            statistics[:4] = other
            _covariance(fine, logarithmic, precision, best, fine_room, solver, covariance)
        if abs(difference) < statistics[4] or difference < 0.0:
            statistics[4], statistics[5] = abs(difference), apart


@compiled
def _channels(count: int, degrees: int) -> Any:
    return np.ones(count), np.zeros((degrees, count)), np.zeros(count), np.zeros(count)


@compiled
def _room(side: int, count: int) -> Any:
    return np.zeros((side, count)), np.empty(count), np.empty(count), np.empty(count, dtype=np.int64)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def fit_rows(
    first: int, last: int, data: Any, weight: Any, wavelength: Any, columns: Any, logarithmic: bool, prior: Any,
    precision: Any, lower: Any, upper: Any, starts: Any, sizes: Any, tolerance: float, max_iterations: int,
    parameters: Any, covariance: Any, statistics: Any,
) -> None:  # fmt: skip
    """Fit the spectra `first` to `last` - 1 from every start, into arrays whose rows are those of `KernelFits`.

    `sizes` are the padded numbers of parameters, channels and coarse channels, and how many channels make a coarse one.
    """
    side, fine_count, coarse_count, together = sizes
    degrees, size, channels = columns.shape[0], prior.size, wavelength.size
    fine, coarse = _channels(fine_count, degrees), _channels(coarse_count, degrees)
    fine_room, coarse_room = _room(side, fine_count), _room(side, coarse_count)
    solver = (
        np.zeros((side, side)), np.zeros((side, side)), np.empty(size), np.empty(size), np.empty(size), np.empty(size),
        np.ones(size, dtype=np.bool_),
    )  # fmt: skip
    found, outcomes = np.empty((starts.shape[0], size)), np.empty((starts.shape[0], 4))
    for i in range(fine_count):
        j = min(i, channels - 1)
        fine[0][i] = wavelength[j]
        for m in range(degrees):
            fine[1][m, i] = columns[m, j]
    for row in range(first, last):
        for i in range(channels):
            usable = weight[row, i] > 0.0
            fine[2][i] = data[row, i] if usable else 0.0
            fine[3][i] = math.sqrt(weight[row, i]) if usable else 0.0
        _fit_row(
            fine, coarse, together, logarithmic, prior, precision, lower, upper, starts[:, row], tolerance,
            max_iterations, fine_room, coarse_room, solver, found, outcomes, parameters[row], covariance[row],
            statistics[row],
        )  # fmt: skip


def fit_batch(
    data: FloatArray, weight: FloatArray, wavelength: FloatArray, basis: FloatArray, logarithmic: bool,
    prior: FloatArray, precision: FloatArray, lower: FloatArray, upper: FloatArray, starts: FloatArray,
    tolerance: float, max_iterations: int,
) -> KernelFits:  # fmt: skip
    """Fit every row of `data` from every start, in all threads.

    Parameters
    ----------
    data, weight : (n_spectra, n) ln R and 1/sigma^2, 0 where masked; the datum there does not matter.
    wavelength, basis, logarithmic : (n,) [um]; (n, m) continuum basis, of C or of ln C.
    prior, precision : (p,) and (p, p), mean and inverse covariance (0 for a flat prior).
    lower, upper : (p,) bounds; equal for a fixed parameter.
    starts : (n_starts, n_spectra, p).
    tolerance : expected decrease of the objective, in units of chi-square, at which a fit has converged.
    """
    _, n_spectra, size = starts.shape
    parameters, covariance = np.empty((n_spectra, size)), np.empty((n_spectra, size, size))
    statistics = np.empty((n_spectra, 6))
    columns = np.ascontiguousarray(basis.T)
    together = coarse_size(wavelength.size)
    sizes = (padded(size), padded(wavelength.size), padded(-(-wavelength.size // together)), together)

    def some(part: int) -> None:
        fit_rows(
            part * ROWS_PER_TASK, min((part + 1) * ROWS_PER_TASK, n_spectra), data, weight, wavelength, columns,
            logarithmic, prior, precision, lower, upper, starts, sizes, tolerance, max_iterations, parameters,
            covariance, statistics,
        )  # fmt: skip

    each_in_threads(some, -(-n_spectra // ROWS_PER_TASK))
    return KernelFits(parameters, covariance, *statistics.T)
