"""Errors of a fit: Laplace's covariance with bounds taken into account, and what errors that channels share add.

From the kernel's numbers to an `MgmFit`: errors, shrinkage, bounds, calibration errors, remarks.
"""

import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, model_and_jacobian
from lunarsci.spectra.mgm.levenberg_marquardt import CONVERGED, KernelFits
from lunarsci.spectra.mgm.model import MgmData, MgmModel
from lunarsci.spectra.mgm.result import FittedBand, MgmFit, band_strength_ratios


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
    response = bounded_covariance(curvature, None, point, model)
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


AMBIGUOUS_CHI2 = 4.0
AMBIGUOUS_SIGMAS = 2.0
STRAINED_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """A point, what the model is there, and its covariance with the model's misfit in it."""

    point: FloatArray
    ln_model: FloatArray
    jacobian: FloatArray
    covariance: FloatArray
    reduced_chi2: float


def build_result(data: MgmData, model: MgmModel, solved: KernelFits, row: int, level: float) -> MgmFit:
    """The fit of row `row`, whose ln R was shifted by -`level` before it was fitted."""
    converged = solved.status[row] == CONVERGED
    point, chi2 = _shifted_back(model, solved.parameters[row], level), float(solved.chi2[row])
    solution = _solution(data, model, point, chi2)
    shared = follow_shifts(data, model, point, solution.ln_model, solution.jacobian)
    bands = _bands(model, solution, shared)
    m = model.degrees
    return MgmFit(
        id=data.id,
        assemblage=model.assemblage.name,
        continuum=model.continuum,
        prior="map",
        converged=bool(converged),
        status=_status(model, solved, row, point, solution.covariance),
        rms_ln=float(np.sqrt(np.mean((np.log(data.reflectance) - solution.ln_model) ** 2))),
        reduced_chi2=solution.reduced_chi2,
        bic=chi2 + int((~model.fixed).sum()) * float(np.log(data.reflectance.size)),
        continuum_coefficients=tuple(point[:m].tolist()),
        bands=bands,
        nbsr=band_strength_ratios(bands, solution.covariance[m:, m:], shared[:, m:], data.wavelength_nm),
        model=model,
        data=data,
        parameters=point,
        covariance=solution.covariance,
        objective=float(solved.objective[row]),
    )


def _shifted_back(model: MgmModel, parameters: FloatArray, level: float) -> FloatArray:
    point, m = parameters.copy(), model.degrees
    if model.logarithmic:
        point[:1] += level if m else 0.0
    else:
        point[:m] *= np.exp(level)
    return point


def _solution(data: MgmData, model: MgmModel, point: FloatArray, chi2: float) -> _Solution:
    found = model_and_jacobian(point, data.wavelength_nm / 1e3, model.basis(data.wavelength_nm), model.logarithmic)
    if found is None:
        shape = (point.size, data.wavelength_nm.size)
        nothing = np.full((point.size, point.size), np.nan)
        return _Solution(point, np.full(shape[1], np.nan), np.zeros(shape), nothing, np.nan)
    ln_model, jacobian = found
    fisher = (jacobian * data.weight) @ jacobian.T
    free = np.ix_(~model.fixed, ~model.fixed)
    used = float(np.trace(np.linalg.pinv((fisher + model.precision)[free], hermitian=True) @ fisher[free]))
    reduced = chi2 / max(1.0, ln_model.size - used)
    wide = max(1.0, reduced)
    pull = model.precision @ (point - model.prior)
    gradient = jacobian @ (data.weight * (np.log(data.reflectance) - ln_model)) / wide - pull
    covariance = bounded_covariance(fisher / wide + model.precision, gradient, point, model)
    return _Solution(point, ln_model, jacobian, covariance, reduced)


def _bands(model: MgmModel, solution: _Solution, shared: FloatArray) -> tuple[FittedBand, ...]:
    m, point = model.degrees, solution.point
    sigma = np.sqrt(np.diag(solution.covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        shrinkage = np.nan_to_num(1 - (sigma[m:] / model.sigma[m:]) ** 2, nan=0.0).clip(0, 1)
    together = np.sqrt((shared**2).sum(axis=0)) if len(shared) else np.full(point.size, np.nan)
    values, errors, calibration = (v[m:].reshape(-1, 3) for v in (point, sigma, together))
    at_bound = (~model.fixed & ((point <= model.lower) | (point >= model.upper)))[m:].reshape(-1, 3)
    return tuple(
        FittedBand.from_kernel(band, *row)
        for band, *row in zip(
            model.assemblage.bands, values, errors, calibration, shrinkage.reshape(-1, 3), at_bound, strict=True
        )
    )


def _status(model: MgmModel, solved: KernelFits, row: int, point: FloatArray, covariance: FloatArray) -> str:
    if solved.status[row] != CONVERGED:
        return (
            f"not converged after {solved.iterations[row]:.0f} iterations; try other bands, priors or another continuum"
        )
    remarks = ["converged"]
    if solved.competing[row] < AMBIGUOUS_CHI2 and solved.competing_sigmas[row] > AMBIGUOUS_SIGMAS:
        remarks.append("ambiguous: another start ends in a different minimum that fits almost as well")
    if strained := _strained(model, point):
        remarks.append(f"strained: {', '.join(strained)} lie far from where these minerals have them")
    return "; ".join(remarks)


def _strained(model: MgmModel, point: FloatArray) -> list[str]:
    """Bands that absorb and whose centre or width is more than three prior standard deviations off."""
    m = model.degrees
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.nan_to_num(np.abs((point - model.prior) / model.sigma))[m:].reshape(-1, 3)[:, :2].max(axis=1)
    far = (off > STRAINED_SIGMAS) & (point[m + 2 :: 3] < 0)
    return [band.name for band, flagged in zip(model.assemblage.bands, far, strict=True) if flagged]
