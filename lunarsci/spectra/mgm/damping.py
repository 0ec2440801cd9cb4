"""Fits along the path of the MGM program distributed by RELAB: least squares, the prior only shortening the steps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.mgm.batch import ratio_of, strength_ratios
from lunarsci.spectra.mgm.data import MgmData, MgmRows, prepare
from lunarsci.spectra.mgm.fit import CONTINUUM_QUANTILE, DEFAULT_MODEL_ERROR, FIRST_STRENGTH, check_options
from lunarsci.spectra.mgm.fit_file import LIMITS, WAVENUMBER_NM, FitFile, ProgramParameters, parameters_of, raw_basis
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import NM_PER_UM, MgmModel
from lunarsci.spectra.mgm.result import REACH_NM, FittedBand, MgmFailure, MgmFit, StrengthRatio, pyroxene_pair
from lunarsci.spectra.spectrum import Spectrum

MAX_ITERATIONS = 100_000
"""The program has no limit; the slowest of 25 fits of laboratory spectra took it 4179."""
HALVINGS = 15
"""Times that a step is halved before it counts as one that does not lower the rms."""
STEEPEST = 1e100
"""Derivative, in the kernel's units, that belongs to no spectrum; its square must be a number."""
RANK_TOLERANCE = 1e-13
"""Smallest share of a derivative that the others do not reproduce, for the parameter to count as determined."""


def fit_damping(
    spectra: Sequence[Spectrum],
    model: MgmModel,
    *,
    file: FitFile | None = None,
    rms_limit: float = LIMITS[0],
    improvement_limit: float = LIMITS[1],
    start: FloatArray | None = None,
    model_error: float = DEFAULT_MODEL_ERROR,
    progress: Callable[[int, int], None] | None = None,
) -> list[MgmFit | MgmFailure]:
    """Fit every spectrum along the path of the reference program; one result or one stated reason each, in order.

    The parameters that step are the program's (`ProgramParameters`): continuum coefficients of powers of wavenumber
    [cm^-1] or wavelength [nm], then centre [cm^-1], FWHM [nm] and strength [ln R] of each band. An iteration moves them
    by (G'G + P)^-1 G'r, where r = ln R - model, G its derivatives and P the inverse covariance of the prior, diagonal,
    whose mean is put where the fit stands: the prior damps and does not pull. For a centre c with the uncertainty u,
    1.96 standard deviations are the full width between the wavenumbers of c - u and c + u. A step that does not lower
    the rms of r is halved, 15 times at most. A fit ends after an iteration that lowers the rms by `improvement_limit`
    or less, or brings it to `rms_limit`. All channels weigh the same. The covariance is (G'G)^-1 rms^2, without the
    prior and without regard to the number of parameters; 1.96 standard deviations are the 95 % errors of the program.

    Strengths of either sign are allowed, and a positive one is said in the status; bounds of the model do not count,
    except equal ones, which fix a value. A step may take a width through 0, since the model is even in it; what comes
    out is its amount. Where parameters are tied, widths stay above 0.

    Chi-square, its reduced value, the objective and BIC have the weights of `fit_spectra`, so that they compare with
    its fits; they play no part here. Shrinkage is 0.

    Parameters
    ----------
    spectra : as in `fit_spectra`.
    model : as `mgm_model` makes it, or `model_of` the file.
    file : start file whose uncertainties damp; without one, the standard deviations of the model's prior do, as if
        they were written to a file.
    rms_limit, improvement_limit : of ln R, 0 or above. [-]
    start : (p,) in the units of `MgmModel`, with widths above 0; by default the values of the file, or the prior's mean
        with strengths of -0.1 where that is 0 and a level continuum at the upper end of the spectrum.
    model_error : of ln R, in the weights of chi-square, above 0 and below 1. [-]
    progress : called with (done, total).

    Raises
    ------
    ParameterError for limits or a model error out of range.

    References
    ----------
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955 (model and program);
    Tarantola & Valette (1982), Rev. Geophys. 20, 219, 10.1029/RG020i002p00219 (step).
    """
    check_options(model_error)
    if not (0 <= rms_limit < math.inf and 0 <= improvement_limit < math.inf):
        raise ParameterError(f"limits of the rms are {rms_limit:g} and {improvement_limit:g}; give 0 or above")
    parameters = parameters_of(model, file)
    results: list[MgmFit | MgmFailure] = []
    for index, spectrum in enumerate(spectra):
        try:
            data = prepare(spectrum, model_error, whole=model.whole)
            first = parameters.of_kernel(_first(model, data) if start is None else start)
            if file is not None and start is None:
                first = parameters.obeying_ties(parameters.values)
            problem = _DampedProblem(data, parameters, raw_basis(model.continuum, data.wavelength_nm))
            results.append(_described(problem, _descent(problem, first, rms_limit, improvement_limit)))
        except DataError as error:
            results.append(MgmFailure(spectrum.id, model.assemblage.name, model.continuum, f"no result: {error}"))
        if progress:
            progress(index + 1, len(spectra))
    return results


def _first(model: MgmModel, data: MgmData) -> FloatArray:
    """The prior's mean, (p,) as in `MgmModel`, with a strength where it has none and a continuum where it is flat."""
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
    """Where a descent stands.

    Attributes
    ----------
    point : (p,) the program's parameters: coefficients, then centre, FWHM, strength of each band. [cm^-1, nm, ln R]
    residual : (n,) ln R less the model. [-]
    jacobian : (p, n) derivatives of the model's ln R by `point`.
    rms : root mean square of `residual`. [-]
    """

    point: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Where a descent ends, after how many iterations, whether a rule of convergence ended it, and a sentence."""

    state: _State
    iterations: int
    converged: bool
    status: str


@dataclass(frozen=True, slots=True, eq=False)
class _DampedProblem:
    """One spectrum, and the program's parameters; `basis`, (n, m), has powers of wavenumber or wavelength.

    It is that of `raw_basis`. `point` is everywhere as in `_State`. G of `fit_damping` is the transpose of
    `_State.jacobian`.
    """

    data: MgmData
    parameters: ProgramParameters
    basis: FloatArray

    def at(self, point: FloatArray) -> _State | None:
        """Residuals and derivatives at a point; None where the continuum is not above 0 or a width or wavenumber 0.

        A width below 0 becomes its amount, unless parameters are tied.
        """
        model, m, point = self.parameters.model, self.parameters.model.degrees, point.copy()
        if not self.parameters.tied:
            point[m + 1 :: 3] = np.abs(point[m + 1 :: 3])
        if not ((point[m + 1 :: 3] > 0).all() and point[m::3].all()):
            return None
        wavelengths = point.copy()
        wavelengths[m::3] = WAVENUMBER_NM / point[m::3] / NM_PER_UM
        wavelengths[m + 1 :: 3] /= NM_PER_UM
        modelled = model_and_jacobian(wavelengths, self.data.wavelength_nm / NM_PER_UM, self.basis, model.logarithmic)
        if modelled is None or not np.abs(modelled[1]).max(initial=0.0) < STEEPEST:
            return None
        ln, jacobian = modelled
        jacobian[m::3] *= (-wavelengths[m::3] / point[m::3])[:, None]
        jacobian[m + 1 :: 3] /= NM_PER_UM
        residual = np.log(self.data.reflectance) - ln
        return _State(point, residual, jacobian, math.sqrt(residual @ residual / residual.size))

    def step(self, here: _State) -> FloatArray:
        """(G'G + P)^-1 G'r along the directions that are free: a change of the point, (p,)."""
        directions = self.parameters.directions(here.point)
        slopes = directions.T @ here.jacobian
        matrix = slopes @ slopes.T + (directions.T * self.parameters.precision) @ directions
        return np.asarray(directions @ _solved(matrix, slopes @ here.residual), dtype=np.float64)

    def unit_covariance(self, here: _State) -> FloatArray:
        """(G'G)^-1, (p, p), in the parameters of `MgmModel`: the covariance were the errors of ln R 1.

        All NaN where the data leave a direction undetermined.
        """
        directions = self.parameters.directions(here.point)
        slopes = (directions.T @ here.jacobian).T
        scale = np.linalg.norm(slopes, axis=0)
        scale[scale == 0] = 1.0
        _, singular, vectors = np.linalg.svd(slopes / scale, full_matrices=False)
        undetermined = np.full((here.point.size, here.point.size), np.nan)
        if len(singular) < scale.size or not singular.min(initial=1.0) > RANK_TOLERANCE:
            return undetermined
        with np.errstate(over="ignore", invalid="ignore"):
            along = self.parameters.kernel_slopes(here.point) @ directions
            root = along @ ((vectors / singular[:, None]).T / scale[:, None])
            unit = root @ root.T
        return unit if np.isfinite(unit).all() else undetermined


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a symmetric system, that of least norm where there are many."""
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0] = 1.0
    scaled = matrix / np.outer(scale, scale)
    try:
        solution = cho_solve(cho_factor(scaled, check_finite=False), right / scale, check_finite=False)
    except LinAlgError:
        solution = np.linalg.lstsq(scaled, right / scale, rcond=None)[0]
    return np.asarray(solution / scale, dtype=np.float64)


def _descent(problem: _DampedProblem, first: FloatArray, rms_limit: float, improvement_limit: float) -> _End:
    """Where the steps from `first`, the program's parameters, lead. Raises DataError where they cannot begin."""
    here = problem.at(first)
    if here is None:
        raise DataError("the continuum of the start is not above 0 in every channel; start from another")
    for iteration in range(1, MAX_ITERATIONS + 1):
        there, off_limits = _shortened(problem, here)
        if there is None and off_limits:
            fault = "not converged: continuum or width fell to zero; try another continuum or start"
            return _End(here, iteration, False, fault)
        done = f"converged after {iteration} iteration{'s' * (iteration > 1)}"
        if there is None:
            return _End(here, iteration, True, f"{done}: no part of a step lowers the rms")
        improvement, here = here.rms - there.rms, there
        if here.rms <= rms_limit:
            return _End(here, iteration, True, f"{done}: the rms is at most {rms_limit:g}")
        if improvement <= improvement_limit:
            return _End(here, iteration, True, f"{done}: the rms fell by at most {improvement_limit:g}")
    fault = f"not converged after {MAX_ITERATIONS} iterations; try another start or a looser prior"
    return _End(here, MAX_ITERATIONS, False, fault)


def _shortened(problem: _DampedProblem, here: _State) -> tuple[_State | None, bool]:
    """The longest of the step, its half, ... that lowers the rms; if none, whether the shortest was off limits."""
    step, there = problem.step(here), None
    for halving in range(HALVINGS + 1):
        there = problem.at(problem.parameters.obeying_ties(here.point + step / 2**halving))
        if there is not None and there.rms < here.rms:
            return there, False
    return None, there is None


def _described(problem: _DampedProblem, end: _End) -> MgmFit:
    """The fit in the parameters of `MgmModel`, with its errors."""
    data, model, state = problem.data, problem.parameters.model, end.state
    m, unit_covariance = model.degrees, problem.unit_covariance(state)
    point = problem.parameters.to_kernel(state.point)
    covariance = unit_covariance * state.rms**2
    by_kernel = np.linalg.solve(problem.parameters.kernel_slopes(state.point).T, state.jacobian)
    shared = data.shifts @ by_kernel.T @ unit_covariance
    span_nm = float(np.ptp(data.wavelength_nm))
    shared = _where_determined(covariance, shared, m, span_nm)
    bands = _bands(model, point[m:], covariance[m:, m:], shared[:, m:])
    chi2, count = float(data.weight @ state.residual**2), problem.parameters.directions(state.point).shape[1]
    return MgmFit(
        id=data.id,
        assemblage=model.assemblage.name,
        continuum=model.continuum,
        prior="damping",
        converged=end.converged,
        status="; ".join([end.status, *_remarks(bands, covariance, span_nm, len(shared) > 0)]),
        iterations=end.iterations,
        rms_ln=state.rms,
        reduced_chi2=chi2 / max(1, data.reflectance.size - count),
        bic=chi2 + count * math.log(data.reflectance.size),
        continuum_coefficients=tuple(point[:m].tolist()),
        bands=bands,
        nbsr=_ratios(bands, model, data, point, covariance, shared),
        model=model,
        data=data,
        parameters=point,
        covariance=covariance,
        objective=chi2,
    )


def _where_determined(covariance: FloatArray, shared: FloatArray, degrees: int, span_nm: float) -> FloatArray:
    """Moves by errors that channels share, (k, p), NaN for bands whose centre or width is uncertain by the span.

    They are of first order: where the data hold a band nowhere within the spectrum, the order says nothing, and its
    digits are those of the rounding.
    """
    moves = shared.copy()
    together = np.sqrt((shared**2).sum(axis=0)) if len(shared) else np.zeros(len(covariance))
    with np.errstate(invalid="ignore"):
        widest = np.maximum(np.sqrt(np.diag(covariance)), together)[degrees:].reshape(-1, 3)[:, :2].max(axis=1)
    for band in np.flatnonzero(~(widest * NM_PER_UM <= span_nm)):
        moves[:, degrees + 3 * band : degrees + 3 * band + 3] = np.nan
    return moves


def _bands(model: MgmModel, point: FloatArray, covariance: FloatArray, shared: FloatArray) -> tuple[FittedBand, ...]:
    """The bands from their b parameters, (b,), covariance, (b, b), and moves by errors that channels share, (k, b)."""
    together = np.sqrt((shared**2).sum(axis=0)) if len(shared) else np.full(point.size, np.nan)
    values, errors, calibration = (v.reshape(-1, 3) for v in (point, np.sqrt(np.diag(covariance)), together))
    return tuple(
        FittedBand.from_kernel(band, value, error, shift, np.zeros(3), (False, False, False))
        for band, value, error, shift in zip(model.assemblage.bands, values, errors, calibration, strict=True)
    )


def _remarks(bands: Sequence[FittedBand], covariance: FloatArray, span_nm: float, shifted: bool) -> list[str]:
    """What to know of bands; `shifted` says that there are errors that all channels share."""
    remarks = []
    if positive := [band.name for band in bands if band.strength > 0]:
        remarks.append(f"positive strength, which is no absorption: {', '.join(positive)}")
    if beyond := [band.name for band in bands if band.center_nm <= 0]:
        remarks.append(f"centre not above 0 nm, the wing of something else: {', '.join(beyond)}")
    if np.isnan(covariance).any():
        remarks.append("no errors: the data leave a parameter undetermined")
    elif loose := [band.name for band in bands if max(band.center_sigma_nm, band.fwhm_sigma_nm) > span_nm]:
        remarks.append(f"undetermined, the errors span the spectrum: {', '.join(loose)}; true priors hold them")
    if shifted and any(band.center_calibration_nm is None for band in bands):
        remarks.append("what calibration errors do to undetermined bands is not determined either")
    return remarks


def _ratios(
    bands: Sequence[FittedBand], model: MgmModel, data: MgmData, point: FloatArray, covariance: FloatArray,
    shared: FloatArray,
) -> dict[str, StrengthRatio | None]:  # fmt: skip
    """Whatever their errors, which know no prior; None where one of the two bands is positive."""
    ratios: dict[str, StrengthRatio | None] = dict.fromkeys(REACH_NM)
    for region in ratios:
        pair = pyroxene_pair(bands, region)
        if pair and all(bands[position].strength <= 0 for position in pair):
            fit = (MgmRows.together([data]), model, point[None], covariance[None], shared[None])
            ratios[region] = ratio_of(strength_ratios(*fit, region, undetermined=math.inf)[0])
    return ratios
