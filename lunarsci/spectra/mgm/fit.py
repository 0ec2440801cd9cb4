"""Fit the Modified Gaussian Model to spectra: maximum a posteriori, several starts, covariance, shrinkage, NBSR."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.mgm.assemblages import Assemblage, BandPrior
from lunarsci.spectra.mgm.continuum import MgmContinuum, continuum_basis
from lunarsci.spectra.mgm.result import FittedBand, MgmFailure, MgmFit, band_strength_ratios
from lunarsci.spectra.noise import channel_noise
from lunarsci.spectra.spectrum import FloatArray, Spectrum

__all__ = ["FIT_RANGE_NM", "fit_spectra"]

FIT_RANGE_NM = (400.0, 2600.0)
REQUIRED_NM = (800.0, 1300.0)
"""Without the 1 um region there is nothing that tells the three minerals apart."""
MIN_CHANNELS = 40

DEFAULT_MODEL_ERROR = 0.02
"""Share of ln R that Gaussians on a smooth continuum cannot explain, added to the channel noise; assumed. Pyroxene
bands depart from Gaussians at this level: on the orthopyroxene-clinopyroxene powders of RELAB half of it lets the band
of the absent mineral fill the wing of the present one, and under some continua the order of the mixtures is lost."""
DEFAULT_CONTINUUM: MgmContinuum = "wavelength-quadratic"
"""Second-order continua served best in comparisons on mafic minerals: Clenet et al. (2011), Icarus 213, 404,
10.1016/j.icarus.2011.03.002; Han et al. (2020), arXiv:2003.07856."""
DEFAULT_STARTS = 24
"""Enough that NBSR(2 um) of none of 172 laboratory and 88 rover spectra lies more than two standard errors from that of
160 starts."""
START_SIGMAS = 2.0
TOLERANCE = 1e-4
MAX_ITERATIONS = 1000
BOUND_SIGMAS = 4.0
MIN_FWHM_UM = 0.05
AMBIGUOUS_CHI2 = 4.0
AMBIGUOUS_SHIFT = 2.0
STRAINED_SIGMAS = 3.0
CHUNK = 64


def fit_spectra(
    spectra: Sequence[Spectrum],
    assemblage: Assemblage,
    *,
    continuum: MgmContinuum = DEFAULT_CONTINUUM,
    model_error: float = DEFAULT_MODEL_ERROR,
    starts: int = DEFAULT_STARTS,
    progress: Callable[[int, int], None] | None = None,
) -> list[MgmFit | MgmFailure]:
    """Fit every spectrum; one result or one stated reason each, in the order given.

    The objective is chi-square of ln R plus, for each centre, width and strength, its squared distance from the prior
    in units of the prior's standard deviation; strengths stay at or below 0. Each fit starts from the prior's centres
    and widths and from `starts` - 1 fixed displacements of them, strengths solved first; the lowest minimum counts.

    Parameters
    ----------
    spectra : on any channels between 400 and 2600 nm; at least 40 usable ones, reaching over 800-1300 nm.
    assemblage : the bands and their priors.
    continuum : polynomial inside the logarithm.
    model_error : standard deviation of ln R that is added to the channel noise in quadrature, above 0. [-]
    starts : number of starting points, 1 or more.
    progress : called with (done, total).

    Raises
    ------
    ParameterError for a model error or a number of starts outside these ranges.

    References
    ----------
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955 (model); Tarantola & Valette
    (1982), Rev. Geophys. 20, 219, 10.1029/RG020i002p00219 (prior).
    """
    if not 0 < model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a number above 0 and below 1, such as 0.01")
    if starts < 1:
        raise ParameterError(f"{starts} starts; give 1 or more")
    results: list[MgmFit | MgmFailure | None] = [None] * len(spectra)
    prepared: dict[int, _Data] = {}
    for index, spectrum in enumerate(spectra):
        try:
            prepared[index] = _prepare(spectrum, model_error)
        except DataError as error:
            results[index] = MgmFailure(spectrum.id, assemblage.name, continuum, f"no result: {error}")
    done = len(spectra) - len(prepared)
    for chunk in _chunks(prepared):
        problem = _Problem(assemblage, continuum, chunk[0][1].wavelength_nm)
        fits = problem.fit([data for _, data in chunk], starts)
        for (index, _), fit in zip(chunk, fits, strict=True):
            results[index] = fit
        done += len(chunk)
        if progress:
            progress(done, len(spectra))
    return [result for result in results if result is not None]


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """One spectrum in ln R with its weights, and the shifts of ln R by errors that all channels share, shape (k, n)."""

    id: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    weight: FloatArray
    shifts: FloatArray


def _prepare(spectrum: Spectrum, model_error: float) -> _Data:
    low, high = FIT_RANGE_NM
    wavelength = spectrum.wavelength_nm
    keep = spectrum.usable & (wavelength >= low) & (wavelength <= high)
    if keep.sum() < MIN_CHANNELS:
        raise DataError(f"{keep.sum()} usable channels between {low:g} and {high:g} nm; {MIN_CHANNELS} are needed")
    if wavelength[keep][0] > REQUIRED_NM[0] or wavelength[keep][-1] < REQUIRED_NM[1]:
        raise DataError(f"the channels do not reach over {REQUIRED_NM[0]:g}-{REQUIRED_NM[1]:g} nm")
    reflectance = spectrum.reflectance[keep]
    relative = channel_noise(spectrum)[keep] / reflectance
    shifts = np.array([shift[keep] / reflectance for shift in spectrum.systematic.values()])
    return _Data(
        spectrum.id,
        wavelength[keep],
        reflectance,
        1 / (relative**2 + model_error**2),
        shifts.reshape(-1, reflectance.size),
    )


def _chunks(prepared: dict[int, _Data]) -> Iterator[list[tuple[int, _Data]]]:
    """Spectra on the same channels together, a limited number at a time."""
    groups: dict[bytes, list[tuple[int, _Data]]] = {}
    for index, data in prepared.items():
        groups.setdefault(data.wavelength_nm.tobytes(), []).append((index, data))
    for group in groups.values():
        for first in range(0, len(group), CHUNK):
            yield group[first : first + CHUNK]


class _Problem:
    """Priors, bounds and starts of one assemblage on one set of channels, in the units of the kernel."""

    def __init__(self, assemblage: Assemblage, continuum: MgmContinuum, wavelength_nm: FloatArray) -> None:
        self.assemblage, self.continuum, self.wavelength_nm = assemblage, continuum, wavelength_nm
        self.basis = continuum_basis(continuum, wavelength_nm)
        self.degrees = self.basis.shape[1]
        bands = assemblage.bands
        self.prior = self._vector([(b.center_nm / 1e3, b.fwhm_nm / 1e3, 0.0) for b in bands], 0.0)
        sigma = [(b.center_sigma_nm / 1e3, b.fwhm_sigma_nm / 1e3, b.strength_sigma) for b in bands]
        self.sigma = self._vector(sigma, np.inf)
        self.precision = self.sigma**-2.0
        self.lower = self._vector([_lower(b) for b in bands], -np.inf)
        self.upper = self._vector([_upper(b) for b in bands], np.inf)

    def _vector(self, bands: Sequence[tuple[float, float, float]], continuum: float) -> FloatArray:
        return np.concatenate([np.full(self.degrees, continuum), np.asarray(bands, dtype=float).ravel()])

    def fit(self, batch: Sequence[_Data], starts: int) -> list[MgmFit]:
        ln_reflectance = np.log([data.reflectance for data in batch])
        weight = np.array([data.weight for data in batch])
        first = np.stack([self._solve_strengths(ln_reflectance, weight, number) for number in range(starts)])
        solved = self._run(ln_reflectance, weight, first, self.lower, self.upper, TOLERANCE, MAX_ITERATIONS)
        return [self._result(data, *(part[row] for part in solved)) for row, data in enumerate(batch)]

    def _run(self, data: FloatArray, weight: FloatArray, starts: FloatArray, lower: FloatArray, upper: FloatArray,
             tolerance: float, limit: int) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        from lunarsci.spectra.mgm.kernel import fit_batch

        found: tuple[FloatArray, FloatArray, FloatArray] = fit_batch(
            data, weight, self.wavelength_nm / 1e3, self.basis, self.prior, self.precision, lower, upper, starts,
            tolerance, limit,
        )  # fmt: skip
        return found

    def _solve_strengths(self, data: FloatArray, weight: FloatArray, number: int) -> FloatArray:
        """Start `number`: centres and widths displaced, strengths and continuum solved with both locked."""
        start = np.tile(self._displaced(number), (len(data), 1))
        start[:, 0] = np.exp(np.quantile(data, 0.95, axis=1))
        start[:, self.degrees + 2 :: 3] = -0.1
        lower, upper = self.lower.copy(), self.upper.copy()
        for offset in (0, 1):
            locked = slice(self.degrees + offset, None, 3)
            lower[locked] = upper[locked] = start[0, locked]
        solved, _, _ = self._run(data, weight, start[None], lower, upper, 1e-2, 100)
        strengths: FloatArray = solved[:, 0]
        return strengths

    def _displaced(self, number: int) -> FloatArray:
        """The prior's mean with centres and widths moved by up to two prior sigmas; number 0 is not moved."""
        from scipy.stats import qmc

        point = self.prior.copy()
        if number:
            count = len(self.assemblage.bands)
            pattern = 2 * qmc.Halton(2 * count, scramble=False).random(number + 1)[number] - 1
            for moved, shift in (
                (slice(self.degrees, None, 3), pattern[:count]),
                (slice(self.degrees + 1, None, 3), pattern[count:]),
            ):
                point[moved] += START_SIGMAS * shift * self.sigma[moved]
        return np.clip(point, self.lower, self.upper)

    def _result(self, data: _Data, parameters: FloatArray, covariance: FloatArray, statistics: FloatArray) -> MgmFit:
        from lunarsci.spectra.mgm.kernel import CONVERGED, model_and_jacobian

        best = int(np.nanargmin(np.where(np.isfinite(statistics[:, 1]), statistics[:, 1], np.inf)))
        point, chi2 = parameters[best], float(statistics[best, 0])
        model, jacobian = np.empty(data.reflectance.size), np.empty((point.size, data.reflectance.size))
        model_and_jacobian(point, self.wavelength_nm / 1e3, self.basis, model, jacobian)
        reduced = chi2 / max(1.0, data.reflectance.size - self._parameters_used(covariance[best]))
        spread = self._widened(covariance[best], reduced)
        shared = data.shifts @ (jacobian * data.weight).T @ self._response(point, covariance[best])
        bands = self._bands(point, spread, shared)
        converged = statistics[best, 3] == CONVERGED
        return MgmFit(
            id=data.id,
            assemblage=self.assemblage.name,
            continuum=self.continuum,
            converged=bool(converged),
            status=self._status(bool(converged), parameters, statistics, best, spread),
            rms_ln=float(np.sqrt(np.mean((np.log(data.reflectance) - model) ** 2))),
            reduced_chi2=reduced,
            bic=chi2 + point.size * float(np.log(data.reflectance.size)),
            continuum_coefficients=tuple(point[: self.degrees].tolist()),
            bands=bands,
            nbsr=band_strength_ratios(
                bands, spread[self.degrees :, self.degrees :], shared[:, self.degrees :], self.wavelength_nm
            ),
            covariance=spread,
            wavelength_nm=self.wavelength_nm,
            reflectance=data.reflectance,
            continuum_reflectance=self.basis @ point[: self.degrees],
        )

    def _response(self, point: FloatArray, covariance: FloatArray) -> FloatArray:
        """Covariance of the parameters that are free to follow a shift of the data; 0 for those on a bound."""
        free = (point > self.lower) & (point < self.upper)
        block = np.ix_(free, free)
        response = np.zeros_like(covariance)
        response[block] = np.linalg.inv(np.linalg.inv(covariance)[block])
        return response

    def _parameters_used(self, covariance: FloatArray) -> float:
        """Effective number of parameters that the data determine: the continuum's, and the shrinkage of the others."""
        variance = np.diag(covariance)[self.degrees :]
        return float(self.degrees + np.sum(1 - variance / self.sigma[self.degrees :] ** 2))

    def _widened(self, covariance: FloatArray, reduced_chi2: float) -> FloatArray:
        """Posterior covariance with the data's share widened where the model misses them by more than their errors."""
        if reduced_chi2 <= 1:
            return covariance
        prior = np.diag(self.precision)
        return np.asarray(np.linalg.inv((np.linalg.inv(covariance) - prior) / reduced_chi2 + prior), dtype=np.float64)

    def _bands(self, point: FloatArray, covariance: FloatArray, shared: FloatArray) -> tuple[FittedBand, ...]:
        sigma = np.sqrt(np.diag(covariance))
        shrinkage = 1 - (sigma[self.degrees :] / self.sigma[self.degrees :]) ** 2
        together = np.sqrt((shared**2).sum(axis=0)) if len(shared) else np.full(point.size, np.nan)
        values, errors, calibration = (v[self.degrees :].reshape(-1, 3) for v in (point, sigma, together))
        at_bound = ((point <= self.lower) | (point >= self.upper))[self.degrees :].reshape(-1, 3)
        return tuple(
            FittedBand.from_kernel(band, *row)
            for band, *row in zip(
                self.assemblage.bands,
                values,
                errors,
                calibration,
                shrinkage.reshape(-1, 3).clip(0, 1),
                at_bound,
                strict=True,
            )
        )

    def _status(
        self, converged: bool, parameters: FloatArray, statistics: FloatArray, best: int, covariance: FloatArray
    ) -> str:
        if not converged:
            return f"not converged after {MAX_ITERATIONS} iterations; try another continuum or assemblage"
        sigma = np.sqrt(np.diag(covariance))
        with np.errstate(invalid="ignore"):
            near = statistics[:, 1] - statistics[best, 1] < AMBIGUOUS_CHI2
            apart = (np.abs(parameters - parameters[best]) > AMBIGUOUS_SHIFT * sigma).any(axis=1)
        remarks = ["converged"]
        if (near & apart).any():
            remarks.append("ambiguous: another start ends in a different minimum that fits almost as well")
        if strained := self._strained(parameters[best]):
            remarks.append(f"strained: {', '.join(strained)} lie far from where these minerals have them")
        return "; ".join(remarks)

    def _strained(self, point: FloatArray) -> list[str]:
        """Bands that absorb and whose centre or width is more than three prior standard deviations off."""
        values = (point[self.degrees :]).reshape(-1, 3)
        off = np.abs((point - self.prior) / self.sigma)[self.degrees :].reshape(-1, 3)[:, :2].max(axis=1)
        far = (off > STRAINED_SIGMAS) & (values[:, 2] < 0)
        return [band.name for band, flagged in zip(self.assemblage.bands, far, strict=True) if flagged]


def _lower(band: BandPrior) -> tuple[float, float, float]:
    centre = band.center_nm - BOUND_SIGMAS * band.center_sigma_nm
    fwhm = band.fwhm_nm - BOUND_SIGMAS * band.fwhm_sigma_nm
    return centre / 1e3, max(MIN_FWHM_UM, fwhm / 1e3), -np.inf


def _upper(band: BandPrior) -> tuple[float, float, float]:
    centre = band.center_nm + BOUND_SIGMAS * band.center_sigma_nm
    return centre / 1e3, (band.fwhm_nm + BOUND_SIGMAS * band.fwhm_sigma_nm) / 1e3, 0.0
