"""Fits as the MGM program distributed by RELAB makes them: least squares, with the prior only shortening the steps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.mgm.fit import CONTINUUM_QUANTILE, DEFAULT_MODEL_ERROR, FIRST_STRENGTH
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import TIE_SIGMA, MgmData, MgmModel, prepare
from lunarsci.spectra.mgm.result import FittedBand, MgmFailure, MgmFit, StrengthRatio, band_strength_ratios
from lunarsci.spectra.spectrum import Spectrum

MAX_ITERATIONS = 2000
"""The program has no such limit; of 40 fits of laboratory spectra the slowest took 1918 to fall by less than 1e-6."""
HALVINGS = 15
MEANINGLESS_NM = 2000.0
"""Standard error of a centre or width as wide as the spectrum."""
STIFF = 1e-2 / TIE_SIGMA**2
"""A prior at least this narrow is a tie: no step goes along it."""
RANK_TOLERANCE = 1e-13
"""Smallest share of a derivative that the others do not reproduce, for the parameter to count as determined."""


def fit_damping(
    spectra: Sequence[Spectrum],
    model: MgmModel,
    *,
    rms_limit: float = 2e-3,
    improvement_limit: float = 1e-6,
    start: FloatArray | None = None,
    model_error: float = DEFAULT_MODEL_ERROR,
    progress: Callable[[int, int], None] | None = None,
) -> list[MgmFit | MgmFailure]:
    """Fit every spectrum as the reference program does; one result or one stated reason each, in the order given.

    Each iteration moves the parameters by (G'G + P)^-1 G'r, where r = ln R - model, G its derivatives and P the inverse
    covariance of the prior, whose mean is put where the fit stands: the prior damps and does not pull. A step that
    does not lower the rms of r is halved, 15 times at most. A fit ends when an iteration lowers the rms by
    `improvement_limit` or less, or brings it to `rms_limit`. All channels weigh the same. The covariance is
    (G'G)^-1 rms^2, without the prior and without regard to the number of parameters; 1.96 standard deviations are the
    95 % errors of the program.

    Strengths of either sign are allowed, and a positive one is said in the status; bounds of the model do not count,
    except equal ones, which fix a value, and widths stay above 0. The program moves centres in wavenumber, this in
    wavelength: the paths differ, a common minimum does not.

    Chi-square, its reduced value, the objective and BIC have the weights of `fit_spectra`, so that they compare with
    its fits; they play no part here. Shrinkage is 0.

    Parameters
    ----------
    spectra : as in `fit_spectra`.
    model : as `mgm_model` or `model_of` makes it.
    rms_limit, improvement_limit : of ln R, 0 or above. [-]
    start : (p,) or (n_spectra, p), in the units of `MgmModel`; by default the prior's mean, with strengths of -0.1
        where that is 0, and a level continuum at the upper end of the spectrum where its prior is flat.
    model_error : of ln R, in the weights of chi-square, above 0 and below 1. [-]
    progress : called with (done, total).

    Raises
    ------
    ParameterError for limits, a model error or a start out of range.

    References
    ----------
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955 (model and program);
    Tarantola & Valette (1982), Rev. Geophys. 20, 219, 10.1029/RG020i002p00219 (step).
    """
    _check(model_error, rms_limit, improvement_limit)
    starts = None if start is None else _given(start, len(spectra), model)
    anchor, directions = _free_directions(model)
    results: list[MgmFit | MgmFailure] = []
    for index, spectrum in enumerate(spectra):
        try:
            data = prepare(spectrum, model_error)
            first = _first(model, data) if starts is None else starts[index]
            problem = _DampedProblem(data, model, model.basis(data.wavelength_nm), directions)
            first = anchor + directions @ (directions.T @ (first - anchor))
            results.append(_described(problem, *_descent(problem, first, rms_limit, improvement_limit)))
        except DataError as error:
            results.append(MgmFailure(spectrum.id, model.assemblage.name, model.continuum, f"no result: {error}"))
        if progress:
            progress(index + 1, len(spectra))
    return results


def _check(model_error: float, rms_limit: float, improvement_limit: float) -> None:
    if not 0 < model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a number above 0 and below 1, such as 0.01")
    for name, limit in (("rms limit", rms_limit), ("improvement limit", improvement_limit)):
        if not 0 <= limit < math.inf:
            raise ParameterError(f"{name} is {limit:g}; give a number of 0 or above, such as 1e-6")


def _given(start: FloatArray, n_spectra: int, model: MgmModel) -> FloatArray:
    start = np.asarray(start, dtype=np.float64)
    if start.shape not in {(model.prior.size,), (n_spectra, model.prior.size)}:
        raise ParameterError(f"start has shape {start.shape}; give ({model.prior.size},) or one such row per spectrum")
    if not np.isfinite(start).all() or not (start[..., model.degrees + 1 :: 3] > 0).all():
        raise ParameterError("a start is not finite, or a width in it not above 0; correct it")
    return np.broadcast_to(start, (n_spectra, model.prior.size))


def _free_directions(model: MgmModel) -> tuple[FloatArray, FloatArray]:
    """A point, (p,), that keeps what is fixed and tied, and orthonormal directions, (p, q), that keep it so."""
    anchor, free = model.prior.copy(), ~model.fixed
    anchor[model.fixed] = model.lower[model.fixed]
    stiffness, vectors = np.linalg.eigh(model.precision[np.ix_(free, free)])
    stiff = stiffness > STIFF
    if not stiff.any():
        return anchor, np.eye(anchor.size)[:, free]
    ties = vectors[:, stiff]
    pull = model.precision[np.ix_(free, model.fixed)] @ (anchor - model.prior)[model.fixed]
    anchor[free] -= ties @ (ties.T @ pull / stiffness[stiff])
    directions = np.zeros((anchor.size, int((~stiff).sum())))
    directions[free] = vectors[:, ~stiff]
    return anchor, directions


def _first(model: MgmModel, data: MgmData) -> FloatArray:
    """The prior's mean, with a strength where it has none and a continuum where it is flat."""
    m, point = model.degrees, model.prior.copy()
    strengths = point[m + 2 :: 3]
    strengths[strengths == 0] = FIRST_STRENGTH
    if m and not model.precision[:m].any():
        level = np.quantile(np.log(data.reflectance), CONTINUUM_QUANTILE)
        point[:m] = 0.0
        point[0] = level if model.logarithmic else np.exp(level)
    return point


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A point, the residuals there, (n,), and the derivatives of the model, (p, n)."""

    point: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class _DampedProblem:
    """One spectrum and the directions, (p, q), in which its parameters may move."""

    data: MgmData
    model: MgmModel
    basis: FloatArray
    directions: FloatArray

    def at(self, point: FloatArray) -> _State | None:
        """None where the continuum or a width is not above 0."""
        if not (point[self.model.degrees + 1 :: 3] > 0).all():
            return None
        found = model_and_jacobian(point, self.data.wavelength_nm / 1e3, self.basis, self.model.logarithmic)
        if found is None or not np.isfinite(found[1]).all():
            return None
        residual = np.log(self.data.reflectance) - found[0]
        return _State(point, residual, found[1], float(np.sqrt(np.mean(residual**2))))

    def step(self, here: _State) -> FloatArray:
        """(G'G + P)^-1 G'r along the free directions."""
        slopes = self.directions.T @ here.jacobian
        matrix = slopes @ slopes.T + self.directions.T @ self.model.precision @ self.directions
        return np.asarray(self.directions @ _solved(matrix, slopes @ here.residual), dtype=np.float64)

    def covariance(self, here: _State) -> FloatArray:
        """(G'G)^-1, with the fixed and tied as they are; NaN where the data leave a direction undetermined."""
        slopes = (self.directions.T @ here.jacobian).T
        scale = np.linalg.norm(slopes, axis=0)
        scale[scale == 0] = 1.0
        _, singular, vectors = np.linalg.svd(slopes / scale, full_matrices=False)
        if len(singular) < scale.size or not singular.min(initial=1.0) > RANK_TOLERANCE:
            return np.full((self.model.prior.size, self.model.prior.size), np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            root = self.directions @ ((vectors / singular[:, None]).T / scale[:, None])
            inverse = root @ root.T
        return inverse if np.isfinite(inverse).all() else np.full_like(inverse, np.nan)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a symmetric system, that of least norm where there are many."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0] = 1.0
    scaled = matrix / np.outer(scale, scale)
    try:
        solution = cho_solve(cho_factor(scaled), right / scale)
    except LinAlgError:
        solution = np.linalg.lstsq(scaled, right / scale, rcond=None)[0]
    return np.asarray(solution / scale, dtype=np.float64)


def _descent(
    problem: _DampedProblem, first: FloatArray, rms_limit: float, improvement_limit: float
) -> tuple[_State, bool, str]:
    """Where the steps lead, whether a rule of convergence ended them, and which."""
    here = problem.at(first)
    if here is None:
        raise DataError("the continuum of the start is not above 0 in every channel; start from another")
    for _ in range(MAX_ITERATIONS):
        if here.rms <= rms_limit:
            return here, True, f"converged: the rms is at most {rms_limit:g}"
        there, off_limits = _shortened(problem, here)
        if there is None and off_limits:
            return here, False, "not converged: continuum or width fell to zero; try another continuum or start"
        if there is None:
            return here, True, "converged: no part of a step lowers the rms"
        improvement, here = here.rms - there.rms, there
        if improvement <= improvement_limit:
            return here, True, f"converged: the rms fell by at most {improvement_limit:g}"
    return here, False, f"not converged after {MAX_ITERATIONS} iterations; try another start or a looser prior"


def _shortened(problem: _DampedProblem, here: _State) -> tuple[_State | None, bool]:
    """The longest of the step, its half, ... that lowers the rms; if none, whether the shortest was off limits."""
    step, there = problem.step(here), None
    for halving in range(HALVINGS + 1):
        there = problem.at(here.point + step / 2**halving)
        if there is not None and there.rms < here.rms:
            return there, False
    return None, there is None


def _described(problem: _DampedProblem, end: _State, converged: bool, status: str) -> MgmFit:
    data, model, m = problem.data, problem.model, problem.model.degrees
    inverse = problem.covariance(end)
    covariance = inverse * end.rms**2
    shared = data.shifts @ end.jacobian.T @ inverse
    bands = _bands(model, end.point[m:], covariance[m:, m:], shared[:, m:])
    chi2, count = float(data.weight @ end.residual**2), problem.directions.shape[1]
    return MgmFit(
        id=data.id,
        assemblage=model.assemblage.name,
        continuum=model.continuum,
        prior="damping",
        converged=converged,
        status="; ".join([status, *_remarks(bands, covariance)]),
        rms_ln=end.rms,
        reduced_chi2=chi2 / max(1, data.reflectance.size - count),
        bic=chi2 + count * math.log(data.reflectance.size),
        continuum_coefficients=tuple(end.point[:m].tolist()),
        bands=bands,
        nbsr=_ratios(bands, covariance[m:, m:], shared[:, m:], data),
        model=model,
        data=data,
        parameters=end.point,
        covariance=covariance,
        objective=chi2,
    )


def _bands(model: MgmModel, point: FloatArray, covariance: FloatArray, shared: FloatArray) -> tuple[FittedBand, ...]:
    together = np.sqrt((shared**2).sum(axis=0)) if len(shared) else np.full(point.size, np.nan)
    values, errors, calibration = (v.reshape(-1, 3) for v in (point, np.sqrt(np.diag(covariance)), together))
    return tuple(
        FittedBand.from_kernel(band, value, error, shift, np.zeros(3), (False, False, False))
        for band, value, error, shift in zip(model.assemblage.bands, values, errors, calibration, strict=True)
    )


def _remarks(bands: Sequence[FittedBand], covariance: FloatArray) -> list[str]:
    remarks = []
    if positive := [band.name for band in bands if band.strength > 0]:
        remarks.append(f"positive strength, which is no absorption: {', '.join(positive)}")
    if beyond := [band.name for band in bands if band.center_nm <= 0]:
        remarks.append(f"centre not above 0 nm, the wing of something else: {', '.join(beyond)}")
    if np.isnan(covariance).any():
        remarks.append("no errors: the data leave a parameter undetermined")
    elif loose := [band.name for band in bands if max(band.center_sigma_nm, band.fwhm_sigma_nm) > MEANINGLESS_NM]:
        remarks.append(f"undetermined, the errors span the spectrum: {', '.join(loose)}; true priors hold them")
    return remarks


def _ratios(
    bands: Sequence[FittedBand], covariance: FloatArray, shared: FloatArray, data: MgmData
) -> dict[str, StrengthRatio | None]:
    """As everywhere, and None where a pyroxene band of the region is positive."""
    ratios = band_strength_ratios(bands, covariance, shared, data.wavelength_nm)
    positive = {band.region for band in bands if band.strength > 0 and band.mineral.endswith("pyroxene")}
    return {region: None if region in positive else ratio for region, ratio in ratios.items()}
