"""Fit the Modified Gaussian Model to spectra: maximum a posteriori, several starts, one kernel for all.

Fits of many spectra are arrays, of which a fit is made when it is asked for (`SpectraFits`). The same spectra under
several continua say what the choice of the continuum does to a fit.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.compiled import each_in_threads, threads
from lunarsci.compiled.formulas import LANES
from lunarsci.errors import DataError, ParameterError
from lunarsci.parallel.blocks import arrays_in_blocks, rows_in_memory, saved_rows
from lunarsci.provenance import sha256
from lunarsci.spectra.collection import SpectrumCollection
from lunarsci.spectra.mgm import MgmContinuum
from lunarsci.spectra.mgm.batch import MOST_ROWS, FitBatch, channels_of, describe_rows, joined, problem_of
from lunarsci.spectra.mgm.data import MgmData, MgmRows, SpectraRows, prepare_rows
from lunarsci.spectra.mgm.levenberg_marquardt import Channels, FitProblem
from lunarsci.spectra.mgm.model import MGM_CONTINUA, MgmModel
from lunarsci.spectra.mgm.multistart import KernelFits, Multistart
from lunarsci.spectra.mgm.result import FittedBand, MgmFailure, MgmFit, StrengthRatio
from lunarsci.spectra.spectrum import Spectrum


class SpectraFits(Sequence[MgmFit | MgmFailure]):
    """A fit, or a stated reason, for each of n spectra, in their order.

    Attributes
    ----------
    names : of the spectra.
    model : that all were fitted to.
    parts : positions, what was fitted, and the fits, of spectra on the same channels; a fit is made of its row when it
        is asked for.
    failures : by position.
    """

    def __init__(
        self,
        names: Sequence[str],
        model: MgmModel,
        parts: Sequence[tuple[IndexArray, SpectraRows, FitBatch]],
        failures: Mapping[int, MgmFailure],
    ) -> None:
        self.names, self.model, self.parts, self.failures = names, model, parts, failures
        self._seen: dict[int, MgmFit | MgmFailure] = dict(failures)
        self._place = np.full((len(names), 2), -1)
        for number, (positions, _, _) in enumerate(parts):
            self._place[positions, 0], self._place[positions, 1] = number, np.arange(len(positions))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        position = range(len(self))[index]
        if position not in self._seen:
            number, row = self._place[position].tolist()
            _, rows, batch = self.parts[number]
            self._seen[position] = batch.fit(row, rows.at(row, self.names[position]))
        return self._seen[position]

    def part(self, block: range) -> "SpectraFits":
        """Those of some spectra, next to each other."""
        parts = []
        for positions, rows, batch in self.parts:
            rows_here = slice(*np.searchsorted(positions, (block.start, block.stop)).tolist())
            if rows_here.stop > rows_here.start:
                parts.append((positions[rows_here] - block.start, rows.part(rows_here), batch.part(rows_here)))
        failures = {k - block.start: failure for k, failure in self.failures.items() if k in block}
        return SpectraFits(self.names[block.start : block.stop], self.model, parts, failures)

    @property
    def there(self) -> BoolArray:
        """(n,) whether there is a fit."""
        return np.asarray(self._place[:, 0] >= 0)

    @property
    def statuses(self) -> list[str]:
        """A sentence about each."""
        result = [self.failures[k].status if k in self.failures else "" for k in range(len(self))]
        for positions, _, batch in self.parts:
            for position, text in zip(positions.tolist(), batch.statuses(), strict=True):
                result[position] = text
        return result

    def gathered(self, column: Callable[[FitBatch], Any]) -> FloatArray:
        """What `column` makes of each batch, (n, ...), in the order of the spectra; NaN without a fit."""
        parts = [(positions, np.asarray(column(batch))) for positions, _, batch in self.parts]
        result = np.full((len(self), *(parts[0][1].shape[1:] if parts else ())), np.nan)
        for positions, values in parts:
            result[positions] = values
        return result


DEFAULT_MODEL_ERROR = 0.02
"""Of ln R in the chi-square of fits by damping unless another is given; it moves no fit, chi-square by its square;
assumed."""
DEFAULT_STARTS = 4
START_SIGMAS = 2.0
"""Farthest that a start lies from the prior's centre or width, in standard deviations of it."""
START_SEED = 0
FIRST_STRENGTH = -0.1
"""Of every band of a start. [ln R]"""
HOP_SIGMAS = 4.0
"""Length of a hop, in posterior standard deviations (`hops_of`)."""
CONTINUUM_QUANTILE = 0.95
"""Of a spectrum's reflectance, which stands for its continuum in a start."""
TOLERANCE = 1e-4
"""Decrease of chi-square to be expected at which a fit has converged."""
MAX_ITERATIONS = 1000
CHUNK = 512
"""Spectra between two reports of progress."""
NO_HOPS: FloatArray = np.empty((0, 2))
"""For `fit_batch`."""


def fit_spectra(
    spectra: Sequence[Spectrum],
    model: MgmModel,
    *,
    model_error: float | None = None,
    starts: int = DEFAULT_STARTS,
    progress: Callable[[int, int], None] | None = None,
) -> "SpectraFits":
    """Fit every spectrum; one result or one stated reason each, in the order given.

    The objective is chi-square of ln R plus the squared distance of centres, widths and strengths from the prior, in
    units of the prior's covariance; strengths stay at or below 0. Fits start from the prior's centres and widths and
    from `starts` - 1 fixed displacements of them; the lowest minimum counts.

    Parameters
    ----------
    spectra : on any channels between 400 and 2600 nm; at least 40 usable ones, reaching over 800-1300 nm. All their
        channels count where the model is `whole`.
    model : as `mgm_model` makes it.
    model_error : standard deviation of ln R that is added to the channel noise in quadrature, above 0; without it,
        `expected_misfit` of each spectrum. [-]
    starts : number of starting points, 1 or more; 0 for one descent from the prior without a search around it.
    progress : called with (done, total).

    Raises
    ------
    ParameterError for a model error or a number of starts outside these ranges.

    References
    ----------
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955 (model); Tarantola & Valette
    (1982), Rev. Geophys. 20, 219, 10.1029/RG020i002p00219 (prior).
    """
    check_options(model_error, starts)
    collection = SpectrumCollection.of(spectra)
    names = collection.ids
    parts: list[tuple[IndexArray, SpectraRows, FitBatch]] = []
    failures: dict[int, MgmFailure] = {}
    for group in collection.alike():
        before = len(failures) + sum(len(part[0]) for part in parts)
        report = None if progress is None else lambda done, _, before=before: progress(before + done, len(spectra))
        rows = SpectraRows(collection.taken(group), model_error, model.whole)
        try:
            rows.at(0, "")
        except DataError as error:
            name, why = model.assemblage.name, f"no result: {error}"
            failures |= {k: MgmFailure(names[k], name, model.continuum, why) for k in group.tolist()}
            if report:
                report(len(group), 0)
        else:
            parts.append((group, rows, _fit_in_blocks(rows, model, starts, report)))
    return SpectraFits(names, model, parts, failures)


def _fit_in_blocks(
    rows: SpectraRows, model: MgmModel, starts: int, progress: Callable[[int, int], None] | None
) -> FitBatch:
    channels = len(rows.spectra[0].wavelength_nm)
    result = arrays_in_blocks(
        partial(_columns_of_fits, model=model, starts=starts),
        len(rows.spectra),
        rows_in_memory(8.0 * (12 * channels + 3 * len(model.prior) ** 2), most=saved_rows(len(rows.spectra), CHUNK)),
        stage=f"fit {model.assemblage.name} {model.continuum}",
        about=lambda: {
            "spectra": rows.spectra.digest(),
            "model": model_digest(model),
            "model error": str(rows.model_error),
            "starts": str(starts),
        },
        fetch=lambda block: rows.part(slice(block.start, block.stop)).arguments(),
        progress=progress,
    )
    return FitBatch(model=model, **result)


def model_digest(model: MgmModel) -> str:
    """SHA-256 of what a fit by a model depends on."""
    numbers = (model.prior, model.precision, model.lower, model.upper)
    words = (model.assemblage.name, model.continuum, model.names, model.whole)
    return sha256(repr(words).encode() + b"".join(array.tobytes() for array in numbers))


def _columns_of_fits(spectra: dict[str, Any], *, model: MgmModel, starts: int) -> dict[str, Any]:
    """Arrays of a `FitBatch` of the spectra of a block (`SpectraRows.arguments`)."""
    return fit_rows(prepare_rows(**spectra), model, starts).columns()


def check_options(model_error: Any, starts: Any = 1) -> None:
    """Raises ParameterError for a model error, or one of several, or a number of starts out of range."""
    if model_error is not None and not ((np.asarray(model_error) > 0) & (np.asarray(model_error) < 1)).all():
        raise ParameterError(f"model error is {model_error:g}; give a number above 0 and below 1, such as 0.01")
    if isinstance(starts, int) and starts < 0:
        raise ParameterError(f"{starts} starts; give 1 or more, or 0 for one descent without a search")


def fit_arrays(
    wavelength_nm: FloatArray,
    reflectance: FloatArray,
    model: MgmModel,
    *,
    sigma: FloatArray | None = None,
    model_error: float | FloatArray | None = None,
    starts: int | FloatArray = DEFAULT_STARTS,
) -> FitBatch:
    """Fits of spectra in arrays, the same as `fit_spectra` gives of each of them alone.

    Parameters
    ----------
    wavelength_nm, reflectance : (c,), ascending, and (n, c); a channel that is not finite and above 0 is left out of
        its row. [nm, -]
    sigma : (n, c) standard deviation of the reflectance, above 0 where that is used; without it, the scatter from
        channel to channel. [-]
    model_error : as in `fit_spectra`, one for all or one a row. [-]
    starts : number of starting points, as in `fit_spectra`; or starting points of the rows, (n, p), in the order and
        units of `model`, from each of which one descent is made and no other minimum looked for.

    Returns
    -------
    A batch of n rows; those with fewer than 40 channels, or none over 800-1300 nm, have `status` 3 and NaN.

    Raises
    ------
    ParameterError as `fit_spectra`.
    """
    check_options(model_error, starts)
    usable = np.isfinite(reflectance) & (reflectance > 0)
    parts = []
    for rows in same_channels(usable):
        keep = usable[rows[0]]
        errors = model_error if model_error is None or np.ndim(model_error) == 0 else np.asarray(model_error)[rows]
        noise = None if sigma is None else sigma[np.ix_(rows, keep)]
        try:
            prepared = prepare_rows(
                wavelength_nm[keep], reflectance[np.ix_(rows, keep)], sigma=noise, model_error=errors, whole=model.whole
            )
        except DataError:
            continue
        parts.append((rows, fit_rows(prepared, model, starts if isinstance(starts, int) else starts[rows])))
    return joined(len(reflectance), parts, model)


def same_channels(usable: BoolArray) -> list[IndexArray]:
    """Rows of (n, c) that use the same channels."""
    if usable.all():
        return [np.arange(len(usable))] if len(usable) else []
    _, which = np.unique(np.packbits(usable, axis=1), axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    return np.split(order, np.flatnonzero(np.diff(which.ravel()[order])) + 1)


def fit_rows(rows: MgmRows, model: MgmModel, starts: int | FloatArray) -> FitBatch:
    """Fits of prepared spectra, from so many starts or from those of each row, (n, p), as `fit_arrays`."""
    ln_reflectance = np.log(rows.reflectance)
    level = ln_reflectance.mean(axis=1) if model.scale_free else np.zeros(len(rows))
    shifted = ln_reflectance - level[:, None]
    if isinstance(starts, int):
        points, hops = search_of(model, shifted, starts)
    else:
        points, hops = scaled(model, starts, -level)[None], NO_HOPS
    spectra, problem = channels_of(rows, model, shifted), problem_of(model)
    solved = fit_batch(spectra, problem, points, hops, TOLERANCE, MAX_ITERATIONS)
    return describe_rows(rows, model, solved, scaled(model, solved.parameters, level))


def scaled(model: MgmModel, points: FloatArray, level: FloatArray) -> FloatArray:
    """Parameters, (n, p), of reflectance whose logarithm is higher by `level`, (n,)."""
    moved, m = np.array(points, dtype=np.float64), model.degrees
    if model.logarithmic:
        moved[:, : min(m, 1)] += level[:, None]
    else:
        moved[:, :m] *= np.exp(level)[:, None]
    return moved


def fit_data(batch: Sequence[MgmData], model: MgmModel, starts: int) -> list[MgmFit]:
    """Fit prepared spectra that share their channels."""
    result = fit_rows(MgmRows.together(batch), model, starts)
    return [result.fit(row, data) for row, data in enumerate(batch)]


def fit_batch(
    spectra: Channels, problem: FitProblem, starts: FloatArray, hops: FloatArray, tolerance: float, max_iterations: int
) -> KernelFits:
    """Fit all spectra from every start, in all threads.

    Parameters
    ----------
    starts : (n_starts, n_spectra, p).
    hops : (n_hops, 2) index of a parameter and by how many posterior standard deviations to move it, the others
        following their correlation, from the minimum found so far: a descent from there finds what random starts rarely
        do, the minimum in which a neighbouring band does the work. (0, 2) for none.
    tolerance : expected decrease of the objective, in units of chi-square, at which a fit has converged.
    """
    count = len(spectra.data)
    parts = max(1, -(-count // MOST_ROWS), min(threads(), count // LANES))
    edges = np.linspace(0, count, parts + 1).astype(int)
    searches: list[Any] = [None] * parts

    def some(part: int) -> None:
        rows = slice(edges[part], edges[part + 1])
        searches[part] = Multistart(spectra.part(rows), problem, tolerance, max_iterations)
        searches[part].start(starts[:, rows])
        searches[part].hop(hops)

    each_in_threads(some, parts)
    best, covariance, outcome, *others = (
        np.concatenate([getattr(search, name) for search in searches])
        for name in ("best", "covariance", "outcome", "competing", "competing_sigmas")
    )
    return KernelFits(best, covariance, *outcome.T, *others)


def search_of(model: MgmModel, ln_reflectance: FloatArray, starts: int) -> tuple[FloatArray, FloatArray]:
    """Starts and hops of so many starts, as `fit_batch` takes them; of 0 starts one, and no hops."""
    return starting_points(model, ln_reflectance, max(starts, 1)), hops_of(model) if starts else NO_HOPS


def starting_points(model: MgmModel, ln_reflectance: FloatArray, starts: int) -> FloatArray:
    """Starts, shape (starts, n_spectra, p): a level continuum and centres and widths displaced, number 0 not.

    `ln_reflectance` has shape (n_spectra, n). The displacements are uniform, up to two prior standard deviations, and
    the same in every call.
    """
    m, bands = model.degrees, len(model.assemblage.bands)
    points = np.tile(model.prior, (starts, 1))
    points[:, m + 2 :: 3] = FIRST_STRENGTH
    pattern = START_SIGMAS * np.random.default_rng(START_SEED).uniform(-1, 1, size=(starts, 2 * bands))
    sigma = model.sigma
    for offset, shift in ((0, pattern[:, :bands]), (1, pattern[:, bands:])):
        points[1:, m + offset :: 3] += shift[1:] * sigma[m + offset :: 3]
    points = np.clip(points, model.lower, model.upper)
    full = np.repeat(points[:, None], len(ln_reflectance), axis=1)
    if m:
        level = np.quantile(ln_reflectance, CONTINUUM_QUANTILE, axis=1)
        first = level if model.logarithmic else np.exp(level)
        full[:, :, 0] = np.clip(first, model.lower[0], model.upper[0])
    return full


def hops_of(model: MgmModel) -> FloatArray:
    """Hops from the minimum found, (h, 2), as `fit_batch` takes them: every band deeper, its centre to both sides.

    On simulated mixtures of three minerals the deeper bands alone find nearly all of the minima that one start misses.
    """
    m, count = model.degrees, len(model.assemblage.bands)
    deeper = [(m + 3 * band + 2, -HOP_SIGMAS) for band in range(count)]
    aside = [(m + 3 * band, far * HOP_SIGMAS) for band in range(count) for far in (-2, -1, 1, 2)]
    return np.array(deeper + aside, dtype=float)


SPREAD_CONTINUA: tuple[MgmContinuum, ...] = tuple(name for name in MGM_CONTINUA if name != "none")
"""All that can follow a spectrum; `none` fits only what had its continuum removed before."""


REMOVED = (0.7, 1.3)
"""Highest reflectance (95 % quantile) of a spectrum that was divided by its continuum, whose tops are at 1; assumed."""


def check_continuum_removed(spectra: Sequence[Spectrum]) -> None:
    """Raises DataError for the first spectrum whose continuum is still there, which `none` does not fit."""
    for spectrum in spectra:
        top = float(np.quantile(spectrum.reflectance[spectrum.usable], CONTINUUM_QUANTILE))
        if not REMOVED[0] <= top <= REMOVED[1]:
            raise DataError(
                f"{spectrum.id}: continuum none is for spectra divided by their continuum, whose highest reflectance "
                f"is near 1, not {top:.2g}; take another continuum"
            )


def fit_continua(
    spectra: Sequence[Spectrum],
    build: Callable[[MgmContinuum], MgmModel],
    *,
    continua: Sequence[MgmContinuum] = SPREAD_CONTINUA,
    model_error: float | None = None,
    starts: int = DEFAULT_STARTS,
    progress: Callable[[int, int], None] | None = None,
) -> list[dict[MgmContinuum, MgmFit | MgmFailure]]:
    """Fits of every spectrum by continuum; `build` makes the model of one. Arguments as in `fit_spectra`."""
    result: list[dict[MgmContinuum, MgmFit | MgmFailure]] = [{} for _ in spectra]
    for number, name in enumerate(continua):

        def report(done: int, total: int, before: int = number) -> None:
            if progress:
                progress(before * total + done, len(continua) * total)

        fits = fit_spectra(spectra, build(name), model_error=model_error, starts=starts, progress=report)
        for by_name, fit in zip(result, fits, strict=True):
            by_name[name] = fit
    return result


def spread_over_continua(
    spectra: Sequence[Spectrum],
    fits: Sequence[MgmFit | MgmFailure],
    build: Callable[[str, MgmContinuum], MgmModel],
    *,
    model_error: float | None = None,
    starts: int = DEFAULT_STARTS,
    progress: Callable[[int, int], None] | None = None,
) -> list[MgmFit | MgmFailure]:
    """Fits with what the choice of the continuum does; `build` makes the model of an assemblage under a continuum."""
    result = list(fits)
    members = {index: item.assemblage for index, item in enumerate(fits) if isinstance(item, MgmFit)}
    for name in dict.fromkeys(members.values()):
        indices = [index for index, assemblage in members.items() if assemblage == name]
        others = fit_continua(
            [spectra[index] for index in indices],
            partial(build, name),
            model_error=model_error,
            starts=starts,
            progress=progress,
        )
        for index, other in zip(indices, others, strict=True):
            result[index] = with_continuum_spread(result[index], other)  # type: ignore[arg-type]
    return result


def with_continuum_spread(fit: MgmFit, others: Mapping[MgmContinuum, MgmFit | MgmFailure]) -> MgmFit:
    """`fit` with how far its bands and ratios go under the continua that converged.

    Continua are no sample of anything: the spread is the largest distance of any of them, so that it covers all that
    was seen, and says what the choice does, not how likely a value is. Han et al. (2020), arXiv:2003.07856, report such
    differences for olivine and orthopyroxene.
    """
    fits = [other for other in others.values() if isinstance(other, MgmFit) and other.converged]
    if not any(other.continuum != fit.continuum for other in fits):
        return fit
    bands = tuple(_spread_band(band, [other.bands[k] for other in fits]) for k, band in enumerate(fit.bands))
    ratios = {key: _spread_ratio(ratio, [other.nbsr.get(key) for other in fits]) for key, ratio in fit.nbsr.items()}
    return replace(fit, bands=bands, nbsr=ratios)


def _spread_band(band: FittedBand, others: Sequence[FittedBand]) -> FittedBand:
    return replace(
        band,
        center_continuum_nm=max(abs(other.center_nm - band.center_nm) for other in others),
        fwhm_continuum_nm=max(abs(other.fwhm_nm - band.fwhm_nm) for other in others),
        strength_continuum=max(abs(other.strength - band.strength) for other in others),
    )


def _spread_ratio(ratio: StrengthRatio | None, others: Sequence[StrengthRatio | None]) -> StrengthRatio | None:
    if ratio is None:
        return None
    seen = [ratio.opx, *(other.opx for other in others if other)]
    low, high = (0.0, 1.0) if None in others else (min(seen), max(seen))
    return replace(ratio, continuum=max(ratio.opx - low, high - ratio.opx), continuum_low=low, continuum_high=high)
