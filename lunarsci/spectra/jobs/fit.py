"""`lunarsci.fit`: the Modified Gaussian Model of spectra, with errors and ratios of band strengths."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.constants import MGM, NBSR
from lunarsci.errors import Failure, ParameterError, RequestError
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.records import Records, in_blocks
from lunarsci.io.tables import table_hashes
from lunarsci.minerals import MINERALS
from lunarsci.options import request_of
from lunarsci.result import NOT_TO_BE_TRUSTED, Doubt, MadeFrom, Progress, Result, job
from lunarsci.spectra.abundance.kinds import TABLE as KINDS_TABLE
from lunarsci.spectra.abundance.nbsr import TABLE as NBSR_TABLE
from lunarsci.spectra.abundance.nbsr import PyroxeneAbundances, nbsr_abundances
from lunarsci.spectra.abundance.result import Abundance
from lunarsci.spectra.collection import Picked
from lunarsci.spectra.jobs.requests import FitRequest, ModelRequest
from lunarsci.spectra.jobs.verdicts import with_causes
from lunarsci.spectra.mgm import PERCENT_OF, MgmContinuum
from lunarsci.spectra.mgm.assemblages import TABLES as BAND_TABLES
from lunarsci.spectra.mgm.batch import beyond_any, compositions
from lunarsci.spectra.mgm.columns import FitColumns, rows_of, rows_one_by_one
from lunarsci.spectra.mgm.damping import fit_damping
from lunarsci.spectra.mgm.fit import (
    DEFAULT_MODEL_ERROR,
    SpectraFits,
    check_continuum_removed,
    fit_spectra,
    spread_over_continua,
)
from lunarsci.spectra.mgm.fit_file import fit_file_of, fit_file_text, read_fit_file, read_start
from lunarsci.spectra.mgm.intervals import Intervals, intervals_of
from lunarsci.spectra.mgm.model import MgmModel, constrained, mgm_model, parse_compositions, stated_for
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.mgm.selection import Choice, choose, doubts_about
from lunarsci.spectra.readers.batch import SpectraBatch, SpectraSource, read_batch
from lunarsci.spectra.spectrum import Spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def model_of(request: ModelRequest, assemblage: str, continuum: MgmContinuum) -> MgmModel:
    """The model of an assemblage under a continuum, with composition and constraints."""
    stated = parse_compositions(request.composition) if request.composition else None
    return constrained_by(
        request, mgm_model(assemblage, continuum, stated_for(assemblage, stated) if request.automatic else stated)
    )


def constrained_by(request: ModelRequest, model: MgmModel) -> MgmModel:
    """A model with the constraints."""
    return constrained(model, fixed=request.fix, bounds=request.bound, ties=request.tie)


@dataclass(frozen=True, kw_only=True, eq=False)
class MgmFits(Result):
    """Fits of the Modified Gaussian Model to spectra.

    Attributes
    ----------
    batch, request : the spectra, and what was asked.
    fits : one fit, or one stated reason, for each spectrum.
    choices, intervals : by position, where they were asked for.
    abundances : shares of pyroxenes by NBSR, by position: one, or none where there is no ratio.
    failures, files : what gave no fit, one sentence each; the start, and what else was read beside the spectra.
    """

    schema: ClassVar[str] = "spectra-fit/1"
    batch: SpectraBatch
    request: ModelRequest
    fits: Sequence[MgmFit | MgmFailure]
    choices: Mapping[int, Choice] = field(default_factory=dict)
    intervals: Mapping[int, Intervals] = field(default_factory=dict)
    abundances: Mapping[int, Sequence[Abundance]] = field(default_factory=dict)
    failures: Sequence[Failure] = ()
    files: Sequence[InputFile] = ()

    @property
    def good(self) -> Sequence[MgmFit]:
        """The fits without the failures, each made when it is asked for."""
        failed = self.fits.failures if isinstance(self.fits, SpectraFits) else None
        bad = failed if failed is not None else {k for k, one in enumerate(self.fits) if isinstance(one, MgmFailure)}
        return Picked(self.fits, [k for k in range(len(self.fits)) if k not in bad])

    @property
    def made_from(self) -> MadeFrom:
        tables, sources = self._tables_and_sources()
        return MadeFrom(
            inputs=self.batch.inputs | {file.name: file.sha256 for file in self.files},
            tables=self.batch.tables | table_hashes(*tables),
            sources=sources,
            seed=getattr(self.request, "seed", None) if getattr(self.request, "errors", "") == "sample" else None,
        )

    def _tables_and_sources(self) -> tuple[list[str], list[str]]:
        tables, sources = [*BAND_TABLES, NBSR_TABLE, KINDS_TABLE], [MGM, NBSR]
        if self.choices:
            from lunarsci.spectra.abundance import learned, shares
            from lunarsci.spectra.jobs.unmix import LEARNED

            tables, sources = [*tables, learned.TABLE, shares.TABLE], [*sources, LEARNED]
        return tables, sources

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(*doubts_about(self.fits, self.choices), verdict=NOT_TO_BE_TRUSTED)

    def content(self) -> dict[str, Any]:
        return {**self.batch.remarks, "spectra": self.records}

    @property
    def _as_arrays(self) -> bool:
        """Whether records and rows are made of columns; with choices or intervals they are made one by one.

        Then `fits` are `SpectraFits`, of which alone `nbsr_abundances` makes `PyroxeneAbundances`: what is used below
        where this holds, and no type says.
        """
        return isinstance(self.abundances, PyroxeneAbundances) and not (self.choices or self.intervals)

    @cached_property
    def _columns(self) -> Callable[[range], tuple[FitColumns, PyroxeneAbundances]]:
        """`_columns_of`, which remembers the last block."""
        return lru_cache(maxsize=1)(self._columns_of)

    def _columns_of(self, block: range) -> tuple[FitColumns, PyroxeneAbundances]:
        """Columns of some of the fits and their shares of pyroxenes, where they are `_as_arrays`."""
        fits: SpectraFits = self.fits.part(block)  # type: ignore[attr-defined]
        return FitColumns(fits, self.batch.origins[block.start : block.stop]), PyroxeneAbundances(fits)

    @cached_property
    def records(self) -> Sequence[dict[str, Any]]:
        """The keys of each spectrum in `--json`."""

        def of_some(block: range) -> Records:
            columns, shares = self._columns(block)
            return columns.records(shares.record_columns())

        if self._as_arrays:
            return in_blocks(len(self.fits), of_some)
        return [self._record(index, origin) for index, origin in enumerate(self.batch.origins)]

    def _record(self, index: int, origin: str) -> dict[str, Any]:
        """The keys of one spectrum, made from what there is of it."""
        item, choice, intervals = self.fits[index], self.choices.get(index), self.intervals.get(index)
        result = self.abundances.get(index, ())
        return item.to_dict() | {
            "source": origin,
            "compositions": {one.key: asdict(one) for one in compositions(item)} if isinstance(item, MgmFit) else {},
            "choice": choice.to_dict() if choice else None,
            "intervals": intervals.to_dict() if intervals else None,
            "abundance": result[0].to_dict() if result else None,
        }

    def may_have(self, key: str) -> Collection[str]:
        """`compositions` has some keys of `PERCENT_OF` (Fo, Fs, Wo, in mol %), `abundance` some minerals."""
        return PERCENT_OF if key == "compositions" else MINERALS.values() if key == "abundance" else ()

    def rows_each(self) -> Sequence[dict[str, Any]]:
        return self.rows(bands=False)

    def rows(self, *, bands: bool = True) -> Sequence[dict[str, Any]]:
        if not self._as_arrays:
            return rows_one_by_one(self.records, self.abundances, bands=bands)
        shown = self.abundances.any_determined  # type: ignore[attr-defined]

        def of_some(block: range) -> Records:
            columns, shares = self._columns(block)
            return columns.rows(shares.table_columns() if shown else {}, bands=bands)

        size = int(rows_of(self.fits).sum()) if bands else None  # type: ignore[arg-type]
        return in_blocks(len(self.fits), of_some, size=size)

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.spectra.mgm.figure import fit_pages

        weak = [self.fits[index] for index, choice in self.choices.items() if not choice.strong]
        return fit_pages(self.good, weak)  # type: ignore[arg-type]

    def fit_file(self) -> str:
        """A result file of the RELAB MGM program of the first fit; other header lines are those of the start file.

        Raises ParameterError for a continuum that it has no letter for.
        """
        header = read_fit_file(self.files[0]) if self.request.start else None
        return fit_file_text(fit_file_of(self.good[0], header))


@job
def fit(
    spectra: "SpectraSource", request: FitRequest | None = None, *, progress: Progress | None = None, **options: Any
) -> MgmFits:
    """Fit the Modified Gaussian Model: absorption bands of olivine, pyroxenes and plagioclase, with errors and NBSR.

    Parameters
    ----------
    spectra : files, patterns, tables, `Spectrum`s or (wavelength_nm (n,), reflectance (n,) or (spectra, n)[, sigma]),
        one or a list; reflectance and its standard deviation sigma are fractions of 1.
    request, options : options as below, and a `FitRequest` whose own they replace.
    progress : called with (done, total) of each step.

    Raises RequestError for options that exclude each other; DataError where no spectrum can be read and fitted.

    Examples
    --------
    >>> minerals = lunarsci.fit("lunarsci-demo/rock.ecsv", assemblage="OPX-CPX")
    >>> of_bands, of_spectra = minerals.to_table(), minerals.to_table(parts=False)
    """
    asked = request_of(FitRequest, request, options)
    batch = read_batch(spectra, asked.wavelength_unit, asked.reflectance_unit, asked.id)
    if asked.to_fit_file and (count := len(batch.spectra)) != 1:
        raise ParameterError(f"a .fit file holds one spectrum, not {count}; fit one at a time, or take JSON")
    result = fit_batch_of(batch, asked, progress)
    if asked.continuum_spread:
        how: dict[str, Any] = {"model_error": asked.model_error, "starts": asked.starts, "progress": progress}
        result["fits"] = spread_over_continua(batch.spectra, result["fits"], partial(model_of, asked), **how)
    more = {
        "intervals": intervals_of(result["fits"], asked.errors, asked.seed, progress),
        "abundances": nbsr_abundances(result["fits"]),
    }
    return MgmFits(batch=batch, request=asked, **(result | more))


def fit_batch_of(batch: SpectraBatch, request: ModelRequest, progress: Progress | None) -> dict[str, Any]:
    """Fits of all spectra as asked: the attributes `fits`, `choices`, `failures` and `files` of `MgmFits`."""
    result: dict[str, Any]
    if request.continuum == "none":
        check_continuum_removed(batch.spectra)
    try:
        if request.automatic:
            result = _chosen(batch.spectra, request, progress)
        elif request.start:
            result = _from_file(batch.spectra, request, progress)
        else:
            model = model_of(request, request.assemblage, request.continuum)
            result = {"fits": _by_prior(batch.spectra, model, request, progress)}
    except ParameterError as error:  # of a model that these options cannot make
        raise RequestError(str(error)) from error
    fits = result["fits"]
    missing = fits.failures.items() if isinstance(fits, SpectraFits) else enumerate(fits)
    reasons = {index: item.status for index, item in missing if isinstance(item, MgmFailure)}
    return result | {"failures": batch.failures_among(reasons)}


def _by_prior(
    spectra: Sequence[Spectrum], model: MgmModel, request: ModelRequest, progress: Progress | None, **start: Any
) -> Sequence[MgmFit | MgmFailure]:
    if request.prior == "damping":
        error = DEFAULT_MODEL_ERROR if request.model_error is None else request.model_error
        return fit_damping(spectra, model, model_error=error, progress=progress, **start)
    return fit_spectra(spectra, model, model_error=request.model_error, starts=request.starts, progress=progress)


def _from_file(spectra: Sequence[Spectrum], request: ModelRequest, progress: Progress | None) -> dict[str, Any]:
    source = read_input(str(request.start))
    model, file = read_start(source, request.band_minerals)
    start = {"file": file, "rms_limit": file.rms_limit, "improvement_limit": file.improvement_limit}
    return {"fits": _by_prior(spectra, constrained_by(request, model), request, progress, **start), "files": [source]}


def _chosen(spectra: Sequence[Spectrum], request: ModelRequest, progress: Progress | None) -> dict[str, Any]:
    """Compare all assemblages, then fit each spectrum with its own."""
    from lunarsci.spectra.jobs.unmix import presence

    stated = parse_compositions(request.composition) if request.composition else None
    result = choose(spectra, continuum=request.continuum, compositions=stated, progress=progress)
    choices = with_causes(spectra, {index: item for index, item in enumerate(result) if isinstance(item, Choice)})
    there = presence([spectra[index] for index in choices])
    choices = {index: replace(one, present=shares) for (index, one), shares in zip(choices.items(), there, strict=True)}
    fits: list[Any] = list(result)
    for name in dict.fromkeys(choice.assemblage for choice in choices.values()):
        subset = [index for index, choice in choices.items() if choice.assemblage == name]
        model = model_of(request, name, request.continuum)
        for index, item in zip(subset, _by_prior([spectra[k] for k in subset], model, request, None), strict=True):
            fits[index] = item
            if isinstance(item, MgmFit) and item.converged:
                choices[index] = replace(choices[index], beyond=beyond_any(item))
    return {"fits": fits, "choices": choices}
