"""Fits of many spectra as arrays: values, errors, ratios, flags and compositions, row by row, and a view of each.

Errors that channels share move the minimum of a fit (`follow_shifts`); those of a fit go into the compositions that its
band centres speak for (`composition_moments`).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.compiled import each_in_threads
from lunarsci.result import AS_PRIOR, doubt_about, from_prior
from lunarsci.spectra.mgm import TREND_SIGMA
from lunarsci.spectra.mgm.assemblages import PYROXENES, Assemblage
from lunarsci.spectra.mgm.data import MgmData, MgmRows
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, model_and_jacobian
from lunarsci.spectra.mgm.laplace import LaplaceErrors, laplace_errors
from lunarsci.spectra.mgm.levenberg_marquardt import (
    CONVERGED,
    ITERATION_LIMIT,
    Channels,
    FitProblem,
)
from lunarsci.spectra.mgm.model import NM_PER_UM, MgmModel, center_slopes, prior_covariance
from lunarsci.spectra.mgm.multistart import SIGNIFICANT, KernelFits
from lunarsci.spectra.mgm.result import REACH_NM, UNDETERMINED, FittedBand, MgmFit, StrengthRatio, pyroxene_pair
from lunarsci.spectra.spectrum import reaches_over

LEAST_CURVATURE = 0.1
"""Share of the curvature that must be left for the first order to be believed; assumed."""


def follow_shifts(
    data: MgmData, model: MgmModel, point: FloatArray, ln_model: FloatArray, jacobian: FloatArray
) -> FloatArray:
    """First-order moves of the minimum at `point` under each of the data's `shifts`, shape (n_shifts, p).

    `point` (p,) is in the order and units of `MgmModel`; `ln_model` (n,) and `jacobian` (p, n) are the model's there.

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
    if not _is_mostly_left(curvature[np.ix_(free, free)], fisher[np.ix_(free, free)]):
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
    bend = np.zeros((point.size, point.size))
    m = model.degrees
    if not model.logarithmic:
        slopes = jacobian[:m]
        bend[:m, :m] = -(slopes * pull) @ slopes.T
    wavelength = data.wavelength_nm / 1e3
    for row in range(m, point.size, 3):
        centre, fwhm, strength = point[row : row + 3]
        sigma = fwhm / FWHM_OVER_SIGMA
        x = (wavelength - centre) / sigma
        sums = np.vander(x, 5, increasing=True).T @ (pull * jacobian[row + 2])
        block = bend[row : row + 3, row : row + 3]
        block[0, 0] = strength / sigma**2 * (sums[2] - sums[0])
        block[0, 1] = block[1, 0] = strength / (sigma * fwhm) * (sums[3] - 2 * sums[1])
        block[1, 1] = strength / fwhm**2 * (sums[4] - 3 * sums[2])
        block[0, 2] = block[2, 0] = sums[1] / sigma
        block[1, 2] = block[2, 1] = sums[2] / fwhm
    return bend


def _is_mostly_left(curvature: FloatArray, fisher: FloatArray) -> bool:
    """Whether `curvature` exceeds `LEAST_CURVATURE` times `fisher` in every direction."""
    try:
        np.linalg.cholesky(curvature - LEAST_CURVATURE * fisher)
    except np.linalg.LinAlgError:
        return False
    return True


def _inverse(matrix: FloatArray) -> FloatArray:
    """NaN where there is none."""
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
    result = np.empty((len(values), len(items), 2))
    if items:
        centres, gain, first = _composition_law(model.assemblage)
        result[:, :, 0] = first[0] + (values[:, m::3] - centres) @ gain[:, ::3].T
        result[:, :, 1] = first[1] + np.einsum("kp,npq,kq->nk", gain, covariance[:, m:, m:], gain, optimize=True)
    return result


@lru_cache(maxsize=32)
def _composition_law(assemblage: Assemblage) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """c0, G, and x0 with the diagonal of P - G S P. [um, mol % / um, mol %, mol %^2]"""
    items = assemblage.compositions
    slopes, spread = center_slopes(assemblage), np.diag([item.sigma**2 for item in items])
    gain = np.asarray(np.linalg.solve(prior_covariance(assemblage), slopes @ spread).T, dtype=np.float64)
    centres = np.array([band.center_nm / NM_PER_UM for band in assemblage.bands])
    return centres, gain, (np.array([item.mean for item in items]), np.diag(spread - gain @ slopes @ spread))


NOT_FITTED = 3
"""Status of a row without a fit, beside those of the kernel."""
AMBIGUOUS_CHI2 = SIGNIFICANT**2
"""Rise of the objective within which another minimum competes, odds of 7 to 1 at most."""
STRAINED_SIGMAS = 3.0
"""Standard deviations of its prior beyond which a band is strained: in 5 % of fits one of 20 centres and widths,
were they normal; assumed."""
RATIO_MISS = 0.1
"""Standard deviation of what the method misses of a mixture, between NBSR at 1 and at 2 um; with it 3 % of spectra of
pyroxenes alone are flagged (`FitBatch.ratios_differ`); assumed."""
MOST_ROWS = 256
"""Rows worked on together in one thread: enough to keep the lanes busy, few enough to fit into its memory."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitBatch:
    """Fits of n spectra to one model, row by row; NaN where there is none.

    Attributes
    ----------
    model : of p parameters and k compositions, in the order and units of which numbers are.
    values, sigma : (n, p), and their standard errors, those of a parameter on a bound from it. [-, um, um, -]
    calibration : (n, p) standard deviation from the errors that all channels share; NaN where none is known.
    rms_ln, chi2, reduced_chi2, bic, objective, model_error : (n,), see `MgmFit`. [-]
    iterations : (n,) of the last descent.
    status : (n,) 0 where it converged, 1 where it reached the limit of iterations, 2 where nothing is finite, 3 where
        there is no fit.
    ambiguous : (n,) whether another minimum fits almost as well.
    um1, um2 : (n, 4) NBSR of orthopyroxene, of clinopyroxene, sigma and calibration error; NaN where undetermined. [-]
    compositions : (n, k, 2) as `composition_moments` has them.
    """

    model: MgmModel
    values: FloatArray
    sigma: FloatArray
    calibration: FloatArray
    rms_ln: FloatArray
    chi2: FloatArray
    reduced_chi2: FloatArray
    bic: FloatArray
    objective: FloatArray
    model_error: FloatArray
    iterations: FloatArray
    status: IndexArray
    ambiguous: BoolArray
    um1: FloatArray
    um2: FloatArray
    compositions: FloatArray

    def __len__(self) -> int:
        return len(self.values)

    @property
    def converged(self) -> BoolArray:
        """(n,) whether the minimum was reached."""
        return np.asarray(self.status == CONVERGED)

    @property
    def shrinkage(self) -> FloatArray:
        """(n, p) 1 where the data decide a parameter, 0 where its prior does. [-]"""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.nan_to_num(1 - (self.sigma / self.model.sigma) ** 2, nan=0.0).clip(0, 1)

    @property
    def at_bound(self) -> BoolArray:
        """(n, p) whether a parameter that is not fixed ended on a bound."""
        model = self.model
        return ~model.fixed & ((self.values <= model.lower) | (self.values >= model.upper))

    @property
    def strained(self) -> BoolArray:
        """(n, bands) whether a band absorbs and its centre or width is more than three prior sigma off."""
        m, model = self.model.degrees, self.model
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.nan_to_num(np.abs((self.values - model.prior) / model.sigma))[:, m:]
        far = off.reshape(len(self), -1, 3)[:, :, :2].max(axis=2, initial=0.0) > STRAINED_SIGMAS
        return np.asarray(far & (self.values[:, m + 2 :: 3] < 0))

    def present(self, mineral: str) -> BoolArray:
        """(n,) whether a band of the mineral is really there."""
        of_mineral = np.flatnonzero([band.mineral == mineral for band in self.model.assemblage.bands])
        at = self.model.degrees + 2 + 3 * of_mineral
        with np.errstate(invalid="ignore"):
            deep = -self.values[:, at] > SIGNIFICANT * self.sigma[:, at]
        return np.asarray((deep & ~self.at_bound[:, at]).any(axis=1))

    @property
    def beyond_trend(self) -> BoolArray:
        """(n, k) whether a composition that the centres ask for is one that there is not.

        Of fits of OL-OPX-CPX to 326 laboratory spectra (RELAB) the mineral was absent in 48 of 60 such cases, and in
        184 of 513 others.
        """
        items = self.model.assemblage.compositions
        mean = self.compositions[:, :, 0]
        with np.errstate(invalid="ignore"):
            off = [(mean[:, k] < item.lowest) | (mean[:, k] > item.highest) for k, item in enumerate(items)]
        there = [self.present(item.mineral) for item in items]
        both = np.array(off, bool).reshape(-1, len(self)) & np.array(there, bool).reshape(-1, len(self))
        return np.asarray(both.T, dtype=np.bool_)

    @property
    def ratios_differ(self) -> BoolArray:
        """(n,) whether NBSR at 1 and 2 um are farther apart than errors and `RATIO_MISS` allow.

        Of fits of OPX-CPX they are in 5 of 156 laboratory spectra of pyroxenes alone, and in 56 of 146 of others.
        """
        sigma = np.sqrt(self.um1[:, 2] ** 2 + self.um2[:, 2] ** 2 + RATIO_MISS**2)
        with np.errstate(invalid="ignore"):
            far = np.abs(self.um1[:, 0] - self.um2[:, 0]) > SIGNIFICANT * sigma
        return np.asarray(far, dtype=np.bool_)

    def statuses(self) -> list[str]:
        """A sentence about each."""
        odd = (self.ambiguous, self.ratios_differ, self.beyond_trend, self.strained)
        flags = np.column_stack([self.status, self.iterations * ~self.converged, *odd])
        kinds, which = np.unique(flags, axis=0, return_inverse=True)
        texts = [self._sentence(int(kind[0]), int(kind[1]), kind[2:] > 0) for kind in kinds]
        return [texts[k] for k in which.ravel().tolist()]

    def _sentence(self, status: int, iterations: int, flags: BoolArray) -> str:
        """The status of a row; `flags` are `ambiguous`, `ratios_differ`, `beyond_trend` (k) and `strained` (bands)."""
        ambiguous, differ, far = flags[0], flags[1], flags[2:]
        if status != CONVERGED:
            return f"not converged after {iterations} iterations; try other bands, priors or another continuum"
        remarks = ["converged"]
        if ambiguous:
            remarks.append("ambiguous: another start ends in a different minimum that fits almost as well")
        items = self.model.assemblage.compositions
        minerals = list(dict.fromkeys(item.mineral for item, off in zip(items, far, strict=False) if off))
        names = [band.name for band, off in zip(self.model.assemblage.bands, far[len(items) :], strict=True) if off]
        lie = "lies" if len(names) == 1 else "lie"
        strains = [f"{', '.join(names)} {lie} far from where such bands are usual"] if names else []
        strains += [f"centres beyond those of any {', '.join(minerals)}: bands of another mineral?"] if minerals else []
        strains += ["NBSR at 1 and 2 µm contradict each other: is a mineral missing?"] if differ else []
        remarks += [f"strained: {'; '.join(strains)}"] if strains else []
        return "; ".join(remarks)

    def part(self, rows: Any) -> "FitBatch":
        """Some of the rows."""
        return FitBatch(**{name: column[rows] for name, column in self.columns().items()}, model=self.model)

    def columns(self) -> dict[str, Any]:
        """The arrays by name."""
        return {name: getattr(self, name) for name in COLUMNS}

    def fit(self, row: int, data: MgmData) -> MgmFit:
        """One row with the data that it was made of, of which its covariance is made again."""
        one, m = self.part([row]), self.model.degrees
        covariance = _errors(MgmRows.together([data]), self.model, one.values, one.chi2).covariance
        point = one.values[0]
        return MgmFit(
            id=data.id,
            assemblage=self.model.assemblage.name,
            continuum=self.model.continuum,
            prior="map",
            converged=bool(one.converged[0]),
            status=one.statuses()[0],
            rms_ln=float(one.rms_ln[0]),
            reduced_chi2=float(one.reduced_chi2[0]),
            bic=float(one.bic[0]),
            continuum_coefficients=tuple(point[:m].tolist()),
            bands=one.bands(),
            nbsr={region: ratio_of(getattr(one, region)[0]) for region in ("um1", "um2")},
            model=self.model,
            data=data,
            parameters=point,
            covariance=covariance[0],
            objective=float(one.objective[0]),
        )

    def bands(self, row: int = 0) -> tuple[FittedBand, ...]:
        """The bands of one row."""
        m = self.model.degrees
        columns = (self.values, self.sigma, self.calibration, self.shrinkage, self.at_bound)
        parts = (column[row, m:].reshape(-1, 3) for column in columns)
        return tuple(
            FittedBand.from_kernel(band, *numbers)
            for band, *numbers in zip(self.model.assemblage.bands, *parts, strict=True)
        )


def problem_of(model: MgmModel) -> FitProblem:
    """The model as the kernel takes it."""
    parts = (model.prior, model.precision, model.lower, model.upper)
    return FitProblem(model.degrees, model.logarithmic, *(np.ascontiguousarray(part) for part in parts))


def channels_of(rows: MgmRows, model: MgmModel, ln_reflectance: FloatArray | None = None) -> Channels:
    """Spectra as the kernel takes them, with ln R as it is or as given, (n, c)."""
    return Channels(
        np.ascontiguousarray(rows.wavelength_nm / 1e3)[None],
        np.ascontiguousarray(model.basis(rows.wavelength_nm).T)[None],
        np.log(rows.reflectance) if ln_reflectance is None else ln_reflectance,
        np.sqrt(rows.weight),
    )


COLUMNS = tuple(item.name for item in fields(FitBatch) if item.name != "model")
"""Names of the arrays of a `FitBatch`."""


def ratio_of(numbers: FloatArray) -> StrengthRatio | None:
    """A row of `FitBatch.um1` or `um2`, (4,), as a ratio; None where it is NaN."""
    opx, cpx, sigma, calibration = numbers.tolist()
    return None if opx != opx else StrengthRatio(opx, cpx, sigma, None if calibration != calibration else calibration)


def batch_of(fit: MgmFit) -> FitBatch:
    """A fit as the only row of a batch; what is known of other minima is not."""
    empty = {name: np.full(1, np.nan) for name in COLUMNS}
    ratios = {region: np.array([_numbers(fit.nbsr.get(region))]) for region in REACH_NM}
    columns: dict[str, Any] = {
        "values": fit.parameters[None],
        "sigma": np.sqrt(np.diag(fit.covariance))[None],
        "compositions": composition_moments(fit.model, fit.parameters[None], fit.covariance[None]),
        "calibration": np.full((1, fit.parameters.size), np.nan),
        "status": np.array([CONVERGED if fit.converged else ITERATION_LIMIT]),
        "ambiguous": np.zeros(1, dtype=bool),
    }
    return FitBatch(**(empty | columns | ratios), model=fit.model)


def _numbers(ratio: StrengthRatio | None) -> list[float]:
    """A ratio as a row of `FitBatch.um1` or `um2`."""
    if ratio is None:
        return [np.nan] * 4
    return [ratio.opx, ratio.cpx, ratio.sigma, np.nan if ratio.calibration is None else ratio.calibration]


def joined(count: int, parts: Sequence[tuple[IndexArray, FitBatch]], model: MgmModel) -> FitBatch:
    """Batches of one model at their rows of `count`; the others without a fit."""
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("values", "sigma", "calibration"), (model.prior.size,))
    shapes |= {"um1": (4,), "um2": (4,), "compositions": (len(model.assemblage.compositions), 2)}
    columns: dict[str, Any] = {name: np.full((count, *shapes.get(name, ())), np.nan) for name in COLUMNS}
    columns["status"], columns["ambiguous"] = np.full(count, NOT_FITTED), np.zeros(count, dtype=bool)
    for rows, batch in parts:
        for name in COLUMNS:
            columns[name][rows] = getattr(batch, name)
    return FitBatch(**columns, model=model)


def describe_rows(rows: MgmRows, model: MgmModel, solved: KernelFits, points: FloatArray) -> FitBatch:
    """Errors, ratios and flags of fits `solved` of `rows`, whose parameters on reflectance as it is are `points`.

    In all threads, so many rows at a time that covariances, the bulk of it all, are few.
    """
    result: list[Any] = [None] * -(-len(rows) // MOST_ROWS)

    def some(part: int) -> None:
        some_rows = slice(part * MOST_ROWS, (part + 1) * MOST_ROWS)
        ended = KernelFits(*(getattr(solved, name)[some_rows] for name in KernelFits.__dataclass_fields__))
        result[part] = _described(rows.part(some_rows), model, ended, points[some_rows])

    each_in_threads(some, len(result))
    return FitBatch(model=model, **{name: np.concatenate([one[name] for one in result]) for name in COLUMNS})


def _described(rows: MgmRows, model: MgmModel, solved: KernelFits, points: FloatArray) -> dict[str, Any]:
    """The columns of a `FitBatch`."""
    rms, reduced, covariance = _errors(rows, model, points, solved.chi2)
    moved = _moved(rows, model, points)
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        calibration = np.sqrt((moved**2).sum(axis=1)) if moved.shape[1] else np.full(points.shape, np.nan)
    return {
        "values": points,
        "sigma": sigma,
        "calibration": calibration,
        "rms_ln": rms,
        "chi2": solved.chi2,
        "reduced_chi2": reduced,
        "bic": solved.chi2 + int((~model.fixed).sum()) * np.log(rows.wavelength_nm.size),
        "objective": solved.objective,
        "model_error": np.asarray(rows.model_error),
        "iterations": solved.iterations,
        "status": solved.status.astype(np.int64),
        "ambiguous": (solved.competing < AMBIGUOUS_CHI2) & (solved.competing_sigmas > SIGNIFICANT),
        "compositions": composition_moments(model, points, covariance),
        **{region: strength_ratios(rows, model, points, covariance, moved, region) for region in REACH_NM},
    }


def _errors(rows: MgmRows, model: MgmModel, points: FloatArray, chi2: FloatArray) -> LaplaceErrors:
    """Errors at minima, (n, p), of this chi-square, (n,)."""
    return laplace_errors(channels_of(rows, model), problem_of(model), points, chi2)


def _moved(rows: MgmRows, model: MgmModel, points: FloatArray) -> FloatArray:
    """Moves of the minima by each error that all channels share, (n, k, p); NaN without a continuum."""
    count = rows.shifts.shape[1]
    result = np.full((len(points), count, points.shape[1]), np.nan)
    wavelength_um, basis = rows.wavelength_nm / 1e3, model.basis(rows.wavelength_nm)
    for row, point in enumerate(points if count else ()):
        at = model_and_jacobian(point, wavelength_um, basis, model.logarithmic)
        if at is not None:
            result[row] = follow_shifts(rows.at(row, ""), model, point, *at)
    return result


def strength_ratios(
    rows: MgmRows, model: MgmModel, points: FloatArray, covariance: FloatArray, moved: FloatArray, region: str,
    undetermined: float = UNDETERMINED,
) -> FloatArray:  # fmt: skip
    """NBSR of a region, (n, 4), as in `FitBatch`; NaN where its sigma reaches `undetermined`.

    `moved` are the shifts of the parameters by errors that all channels share, (n, k, p).
    """
    result = np.full((len(points), 4), np.nan)
    pair, (low, high) = pyroxene_pair(model.assemblage.bands, region), REACH_NM[region]
    if pair is None or not reaches_over(rows.wavelength_nm, low, high):
        return result
    one, other = (model.degrees + 3 * position + 2 for position in pair)
    opx, cpx = points[:, one], points[:, other]
    total = opx + cpx
    with np.errstate(divide="ignore", invalid="ignore"):
        by_opx, by_cpx = cpx / total**2, -opx / total**2
        variance = by_opx**2 * covariance[:, one, one] + by_cpx**2 * covariance[:, other, other]
        sigma = np.sqrt(variance + 2 * by_opx * by_cpx * covariance[:, one, other])
        determined = sigma < undetermined
        result[determined, 0], result[determined, 1] = np.abs(opx / total)[determined], np.abs(cpx / total)[determined]
        shared = moved[:, :, one] * by_opx[:, None] + moved[:, :, other] * by_cpx[:, None]
    result[determined, 2] = sigma[determined]
    if moved.shape[1]:
        result[determined, 3] = np.sqrt((shared**2).sum(axis=1))[determined]
    return result


FO_HIDDEN = 60.0
"""Error of Fo where pyroxene alone absorbs at 1 um; it grows with pyroxene's share of the strengths of bands there.
Measured: 47 to 70 with one of 31 sample series of known composition left out, 157 spectra, beside the fit's own error
and the trend's (`tests/benchmarks/compositions.py`). [mol %]"""


@dataclass(frozen=True, slots=True)
class MineralComposition:
    """Composition of one mineral.

    Attributes
    ----------
    key : `fo`, `fs`, `wo`, or `fs_cpx` for the iron of clinopyroxene.
    mean, sigma : posterior mean and standard deviation; None where the mineral's bands are not there. [mol %]
    trend_sigma : what the trend itself misses, which `sigma` does not include. [mol %]
    prior_sigma : before the spectrum was seen; a `sigma` close to it means that the spectrum says nothing. [mol %]
    lowest, highest : range over which the trend is known. [mol %]
    in_range : whether the mean lies there; beyond, the trend is only extended.
    domain : what must hold beside, '' for nothing: of a pyroxene fitted alone, that there is no second one.
    """

    key: str
    mineral: str
    mean: float | None
    sigma: float | None
    trend_sigma: float
    prior_sigma: float
    lowest: float
    highest: float
    in_range: bool
    domain: str = ""

    @property
    def determined(self) -> bool:
        """Whether the spectrum, and not the prior alone, says what it is."""
        return not from_prior(self.sigma, self.prior_sigma)

    @property
    def doubt(self) -> str:
        """Why it should not be used, or that it is the prior's; '' where it may be."""
        return doubt_about(asdict(self)) or ("" if self.determined else AS_PRIOR)


def compositions_of(batch: FitBatch) -> FloatArray:
    """Mean and sigma, (n, k, 2), of the compositions that the fitted centres speak for. [mol %]

    Those of `composition_moments`, NaN where the mineral's bands are not there. Beside pyroxene the error of Fo is
    larger than the fit's: its bands overlap with olivine's, and hardly tell more than the prior.
    """
    result = batch.compositions.copy()
    for k, item in enumerate(batch.model.assemblage.compositions):
        result[:, k, 1] = np.sqrt(np.maximum(result[:, k, 1] + _hidden(batch, item.key) ** 2, 0.0))
        result[~(batch.present(item.mineral) & np.isfinite(result[:, k]).all(axis=1)), k] = np.nan
    return result


def _hidden(batch: FitBatch, key: str) -> FloatArray:
    """(n,) error of a composition from bands that others hide: of olivine's beside pyroxene's. [mol %]"""
    bands, m = batch.model.assemblage.bands, batch.model.degrees
    if key != "fo" or not any(band.mineral in PYROXENES for band in bands):
        return np.zeros(len(batch))
    strength = -batch.values[:, m + 2 :: 3] * [band.region == "um1" for band in bands]
    pyroxene = strength[:, [band.mineral in PYROXENES for band in bands]].sum(axis=1)
    olivine = strength[:, [band.mineral == "olivine" for band in bands]].sum(axis=1)
    return np.asarray(FO_HIDDEN * pyroxene / np.maximum(pyroxene + olivine, np.finfo(float).tiny))


def compositions(fit: MgmFit) -> tuple[MineralComposition, ...]:
    """`compositions_of` one fit."""
    assemblage = fit.model.assemblage
    result = []
    for item, (mean, sigma) in zip(assemblage.compositions, compositions_of(batch_of(fit))[0].tolist(), strict=True):
        shown = mean == mean
        result.append(
            MineralComposition(
                key=item.key,
                mineral=item.mineral,
                mean=mean if shown else None,
                sigma=sigma if shown else None,
                trend_sigma=TREND_SIGMA[item.key],
                prior_sigma=item.sigma,
                lowest=item.lowest,
                highest=item.highest,
                in_range=item.lowest <= mean <= item.highest,
                domain=assemblage.domain(item.mineral),
            )
        )
    return tuple(result)


def beyond_any(fit: MgmFit) -> tuple[str, ...]:
    """Minerals of a fit whose centres ask for a composition that there is not."""
    items = fit.model.assemblage.compositions
    far = batch_of(fit).beyond_trend[0]
    return tuple(dict.fromkeys(item.mineral for item, off in zip(items, far, strict=True) if off))
