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
from lunarsci.spectra.mgm.normal import damped, prior_share, products
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["CONVERGED", "ITERATION_LIMIT", "NOT_FINITE", "KernelFits", "fit_batch"]

ROWS_PER_TASK = 8
COARSE_TOLERANCE, POLISHED = 1.0, 1e-2
"""Decrease to be expected, in chi-square, at which a descent on the coarse spectrum ends; at first, and at its end."""
HOP_TOLERANCE, SAME_BASIN = 0.3, 1.5
"""In one parabolic basin the square of the distance, in standard deviations, is at most the rise of the objective; a
point that is not farther than this factor allows is on its way back."""
COARSE_DOUBT = 0.5
"""By how much the order of two minima may differ between coarse and full spectrum."""
MAX_ROUNDS = 4
FIRST_DAMPING, LATER_DAMPING = 1e-3, 1e-6
RIVAL_CHI2 = 5.0
"""A minimum higher by this or more is no rival of the best."""
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
    curvature, matrix, free = solver[0], solver[1], solver[6]
    _evaluate(channels, logarithmic, best, room)
    products(room[0], curvature)
    free[:] = True
    damped(curvature, 1.0, precision, free, 0.0, matrix)
    if not invert(matrix, covariance):
        covariance[:, :] = math.nan


@compiled
def _finish(
    fine: Any, coarse: Any, used: Any, together: int, task: Any, tolerance: float, max_iterations: int, rooms: Any,
    solver: Any, best: Any, outcome: Any,
) -> None:  # fmt: skip
    """From a coarse minimum to that of all channels: the coarse data corrected there, the descent repeated, then ended
    on all channels."""
    logarithmic, prior, precision, lower, upper = task
    if together > 1 and math.isfinite(_evaluate(fine, logarithmic, best, rooms[0])):
        _evaluate(coarse, logarithmic, best, rooms[1])
        correct(fine, together, coarse, rooms[0][1], rooms[1][1])
        descend(
            coarse, used[1], logarithmic, prior, precision, lower, upper, False, LATER_DAMPING, tolerance,
            max_iterations, best, rooms[1], solver, outcome,
        )  # fmt: skip
    descend(
        fine, used[0], logarithmic, prior, precision, lower, upper, False, LATER_DAMPING, tolerance, max_iterations,
        best, rooms[0], solver, outcome,
    )  # fmt: skip


@compiled
def _challenge(
    fine: Any, used: Any, task: Any, tolerance: float, max_iterations: int, rooms: Any, solver: Any, trial: Any,
    best: Any, covariance: Any, statistics: Any,
) -> bool:  # fmt: skip
    """Finish a coarse minimum on all channels and keep the lower of it and `best`; whether it took the place."""
    logarithmic, prior, precision, lower, upper = task
    other = np.empty(4)
    descend(
        fine, used[0], logarithmic, prior, precision, lower, upper, False, LATER_DAMPING, tolerance, max_iterations,
        trial, rooms[0], solver, other,
    )  # fmt: skip
    apart = _distance(trial, best, covariance)
    if not apart > SAME_SIGMAS or not math.isfinite(other[1]):
        return False
    difference = other[1] - statistics[1]
    if difference < 0.0 or difference < statistics[4]:
        statistics[4], statistics[5] = abs(difference), apart
    if not difference < 0.0:
        return False
    best[:] = trial
    statistics[:4] = other
    _covariance(fine, logarithmic, precision, best, rooms[0], solver, covariance)
    return True


@compiled
def _coarse_objective(coarse: Any, task: Any, point: Any, rooms: Any) -> float:
    objective: float = _evaluate(coarse, task[0], point, rooms[1]) + prior_share(point, task[1], task[2])
    return objective


@compiled
def _hop(
    fine: Any, coarse: Any, used: Any, task: Any, hops: Any, tolerance: float, max_iterations: int, rooms: Any,
    solver: Any, trial: Any, outcome: Any, best: Any, covariance: Any, statistics: Any,
) -> bool:  # fmt: skip
    """Descend on the coarse spectrum from every hop away from `best`; whether a lower minimum was found."""
    logarithmic, prior, precision, lower, upper = task
    floor, lower_found = _coarse_objective(coarse, task, best, rooms), False
    for h in range(hops.shape[0]):
        k = int(hops[h, 0])
        if not covariance[k, k] > 0.0:
            continue
        for p in range(best.size):
            trial[p] = best[p] + hops[h, 1] * covariance[p, k] / math.sqrt(covariance[k, k])
        descend(
            coarse, used[1], logarithmic, prior, precision, lower, upper, True, FIRST_DAMPING, HOP_TOLERANCE,
            max_iterations, trial, rooms[1], solver, outcome,
        )  # fmt: skip
        higher, apart = outcome[1] - floor, _distance(trial, best, covariance)
        if not higher < RIVAL_CHI2 + COARSE_TOLERANCE or apart * apart < SAME_BASIN * (
            max(higher, 0.0) + HOP_TOLERANCE
        ):
            continue
        descend(
            coarse, used[1], logarithmic, prior, precision, lower, upper, False, LATER_DAMPING, POLISHED,
            max_iterations, trial, rooms[1], solver, outcome,
        )  # fmt: skip
        higher, apart = outcome[1] - floor, _distance(trial, best, covariance)
        if not higher < RIVAL_CHI2 or apart < SAME_SIGMAS:
            continue
        if higher > COARSE_DOUBT:
            if higher < statistics[4]:
                statistics[4], statistics[5] = higher, apart
        elif _challenge(
            fine, used, task, tolerance, max_iterations, rooms, solver, trial, best, covariance, statistics
        ):  # fmt: skip
            floor, lower_found = _coarse_objective(coarse, task, best, rooms), True
    return lower_found


@compiled
def _fit_row(
    fine: Any, coarse: Any, together: int, task: Any, starts: Any, hops: Any, tolerance: float, max_iterations: int,
    rooms: Any, solver: Any, found: Any, outcomes: Any, best: Any, covariance: Any, statistics: Any,
) -> None:  # fmt: skip
    """Fit one spectrum: `found` and `outcomes` hold what each start leads to on the coarse spectrum."""
    logarithmic, prior, precision, lower, upper = task
    used = (float(np.sum(fine[3] > 0.0)), float(coarsen(fine, together, coarse)))
    lowest, trial = 0, np.empty(best.size)
    for s in range(starts.shape[0]):
        found[s] = starts[s]
        descend(
            coarse, used[1], logarithmic, prior, precision, lower, upper, True, FIRST_DAMPING, COARSE_TOLERANCE,
            max_iterations, found[s], rooms[1], solver, outcomes[s],
        )  # fmt: skip
        if outcomes[s, 1] < outcomes[lowest, 1]:
            lowest = s
    best[:] = found[lowest]
    covariance[:, :] = math.nan
    statistics[4], statistics[5] = math.inf, 0.0
    ceiling = outcomes[lowest, 1] + RIVAL_CHI2
    _finish(
        fine, coarse, used, together, task, tolerance, max_iterations, rooms, solver, best, statistics[:4]
    )  # fmt: skip
    if statistics[3] == NOT_FINITE:
        return
    _covariance(fine, logarithmic, precision, best, rooms[0], solver, covariance)
    for s in range(starts.shape[0]):
        if s != lowest and outcomes[s, 1] < ceiling and _distance(found[s], best, covariance) > SAME_SIGMAS:
            trial[:] = found[s]
            _challenge(
                fine, used, task, tolerance, max_iterations, rooms, solver, trial, best, covariance, statistics
            )  # fmt: skip
    for _ in range(MAX_ROUNDS):
        if not _hop(
            fine, coarse, used, task, hops, tolerance, max_iterations, rooms, solver, trial, outcomes[0], best,
            covariance, statistics,
        ):  # fmt: skip
            break


@compiled
def _channels(count: int, degrees: int) -> Any:
    return np.ones(count), np.zeros((degrees, count)), np.zeros(count), np.zeros(count)


@compiled
def _room(side: int, count: int) -> Any:
    return np.zeros((side, count)), np.empty(count), np.empty(count), np.empty(count, dtype=np.int64)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def fit_rows(
    first: int, last: int, data: Any, weight: Any, wavelength: Any, columns: Any, logarithmic: bool, prior: Any,
    precision: Any, lower: Any, upper: Any, starts: Any, hops: Any, sizes: Any, tolerance: float, max_iterations: int,
    parameters: Any, covariance: Any, statistics: Any,
) -> None:  # fmt: skip
    """Fit the spectra `first` to `last` - 1 from every start, into arrays whose rows are those of `KernelFits`.

    `sizes` are the padded numbers of parameters, channels and coarse channels, and how many channels make a coarse one.
    """
    side, fine_count, coarse_count, together = sizes
    degrees, size, channels = columns.shape[0], prior.size, wavelength.size
    fine, coarse = _channels(fine_count, degrees), _channels(coarse_count, degrees)
    rooms = (_room(side, fine_count), _room(side, coarse_count))
    task = (logarithmic, prior, precision, lower, upper)
    solver = (
        np.zeros((side, side)), np.zeros((side, side)), np.empty(size), np.empty(size), np.empty(size), np.empty(side),
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
            fine, coarse, together, task, starts[:, row], hops, tolerance, max_iterations, rooms, solver, found,
            outcomes, parameters[row], covariance[row], statistics[row],
        )  # fmt: skip


def fit_batch(
    data: FloatArray, weight: FloatArray, wavelength: FloatArray, basis: FloatArray, logarithmic: bool,
    prior: FloatArray, precision: FloatArray, lower: FloatArray, upper: FloatArray, starts: FloatArray,
    hops: FloatArray, tolerance: float, max_iterations: int,
) -> KernelFits:  # fmt: skip
    """Fit every row of `data` from every start, in all threads.

    Parameters
    ----------
    data, weight : (n_spectra, n) ln R and 1/sigma^2, 0 where masked; the datum there does not matter.
    wavelength, basis, logarithmic : (n,) [um]; (n, m) continuum basis, of C or of ln C.
    prior, precision : (p,) and (p, p), mean and inverse covariance (0 for a flat prior).
    lower, upper : (p,) bounds; equal for a fixed parameter.
    starts : (n_starts, n_spectra, p).
    hops : (n_hops, 2) index of a parameter and by how many posterior standard deviations to move it, the others
        following their correlation, from the minimum found so far: a descent from there finds what random starts rarely
        do, the minimum in which a neighbouring band does the work. (0, 2) for none.
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
            logarithmic, prior, precision, lower, upper, starts, hops, sizes, tolerance, max_iterations, parameters,
            covariance, statistics,
        )  # fmt: skip

    each_in_threads(some, -(-n_spectra // ROWS_PER_TASK))
    return KernelFits(parameters, covariance, *statistics.T)
