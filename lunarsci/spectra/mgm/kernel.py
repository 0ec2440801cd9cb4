"""One kernel for one spectrum and for a million: many starts on a coarse spectrum, the best finished on all channels.

A parameter vector is [continuum coefficients (m), then centre, FWHM, strength of each band]. Wavelengths, centres and
widths are in micrometres here, so that every parameter is of order one.
"""

from dataclasses import dataclass

import numba
import numpy as np

from lunarsci.compiled import each_in_threads
from lunarsci.spectra.mgm.contest import Contest
from lunarsci.spectra.mgm.descent import CONVERGED, ITERATION_LIMIT, NOT_FINITE, Channels, Task
from lunarsci.spectra.mgm.lanes import LANES
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["CONVERGED", "ITERATION_LIMIT", "NOT_FINITE", "KernelFits", "fit_batch"]

MOST_ROWS = 256
"""Spectra worked on together in one thread: enough to keep the lanes busy, few enough to fit into its memory."""


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
    n_spectra = len(data)
    task = Task(basis.shape[1], logarithmic, *(np.ascontiguousarray(part) for part in (prior, precision, lower, upper)))
    usable = weight > 0
    spectra = Channels(
        np.ascontiguousarray(wavelength)[None],
        np.ascontiguousarray(basis.T)[None],
        np.ascontiguousarray(np.where(usable, data, 0.0)),
        np.ascontiguousarray(np.sqrt(np.where(usable, weight, 0.0))),
    )
    parts = max(1, -(-n_spectra // MOST_ROWS), min(numba.get_num_threads(), n_spectra // LANES))
    edges = np.linspace(0, n_spectra, parts + 1).astype(int)
    contests: list[Contest | None] = [None] * parts

    def some(part: int) -> None:
        rows = slice(edges[part], edges[part + 1])
        contest = Contest(spectra.part(rows), task, tolerance, max_iterations)
        contest.start(starts[:, rows])
        contest.hop(hops)
        contests[part] = contest

    each_in_threads(some, parts)
    found = [contest for contest in contests if contest is not None]
    chi2, objective, iterations, status = np.concatenate([contest.outcome for contest in found]).T
    return KernelFits(
        np.concatenate([contest.best for contest in found]),
        np.concatenate([contest.covariance for contest in found]),
        chi2,
        objective,
        iterations,
        status,
        np.concatenate([contest.rival for contest in found]),
        np.concatenate([contest.rival_sigmas for contest in found]),
    )
