"""From the options of `lunarsci spectra fit` to fitted spectra."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from lunarsci.errors import ParameterError
from lunarsci.inputs import InputFile, read_input
from lunarsci.spectra.abundance.end_members import FAMILY_OF, OPAQUE
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.abundance.result import Abundance
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.mgm.constraints import constrained, parse_compositions
from lunarsci.spectra.mgm.continuum import MgmContinuum
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import DEFAULT_CONTINUUM, MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.spectrum import Spectrum

from ..shared.progress import progress

if TYPE_CHECKING:
    from lunarsci.spectra.abundance.stated import StatedModes

__all__ = ["FitRequest", "FitRun", "run_fit"]

Result = MgmFit | MgmFailure
DEFAULT_ASSEMBLAGE = "OL-OPX-CPX"
Update = Callable[[int, int], None]
LIMITS = (2e-3, 1e-6)
"""Rms of ln R, and its improvement, at which `--prior damping` stops where no start file says so."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FitRequest:
    """The options, as they were given."""

    assemblage: str
    continuum: MgmContinuum
    composition: str | None
    start: str | None
    prior: str
    model_error: float
    starts: int
    fixed: Sequence[str]
    bounds: Sequence[str]
    ties: Sequence[str]
    errors: str
    continuum_spread: bool
    seed: int
    to_fit_file: bool
    abundance: str
    library: str | None
    together: bool
    known: str | None
    opaque: bool
    iron: bool

    @property
    def automatic(self) -> bool:
        """Whether the assemblage is to be chosen."""
        return self.assemblage.lower() == "auto"

    def check(self) -> None:
        """Raise ParameterError for options that exclude each other."""
        faults = (
            (self.automatic and (self.fixed or self.bounds or self.ties), "--fix, --bound and --tie name bands of one "
             "assemblage; give it instead of auto"),
            (self.to_fit_file and self.continuum == "log-quadratic", "-o FILE.fit has no letter for log-quadratic; "
             "take another --continuum"),
            (self.automatic and self.prior == "damping", "--assemblage auto compares evidence, which --prior damping "
             "does not have; use --prior map"),
            (self.prior == "damping" and self.errors != "laplace", "--prior damping has no posterior; use --errors "
             "laplace, or --prior map"),
            (self.prior == "damping" and self.bounds, "--prior damping knows no bounds; use --fix or --tie, or --prior "
             "map"),
            (self.prior == "damping" and self.continuum_spread, "--continuum-spread needs --prior map"),
            (self.library and self.abundance == "nbsr", "--library serves --abundance unmix, hapke or absorbance; "
             "give one of them"),
            (self.abundance == "nbsr" and (self.together or self.known or self.opaque or self.iron), "--together, "
             "--known, --opaque and --iron serve --abundance unmix, hapke or absorbance; give one of them"),
            (self.abundance == "absorbance" and self.iron, "--iron needs --abundance hapke or unmix"),
            (self.start and self.automatic, "--start brings its own bands; leave --assemblage auto out"),
            (self.start and self.composition, "--start brings its own bands; leave --composition out"),
            (self.start and self.continuum_spread, "--start brings its own continuum; leave --continuum-spread out"),
            (self.start and self.assemblage != DEFAULT_ASSEMBLAGE, "--start brings its own bands; leave --assemblage "
             "out"),
            (self.start and self.continuum != DEFAULT_CONTINUUM, "--start brings its own continuum; leave --continuum "
             "out"),
        )  # fmt: skip
        for wrong, text in faults:
            if wrong:
                raise ParameterError(text)

    @property
    def compositions(self) -> dict[str, tuple[float, float]] | None:
        """Stated mean and standard deviation by key. [mol %]"""
        return parse_compositions(self.composition) if self.composition else None

    def model(self, assemblage: str, continuum: MgmContinuum) -> MgmModel:
        """The model of an assemblage under a continuum, with composition and constraints."""
        stated: Mapping[str, tuple[float, float]] | None = self.compositions
        if self.automatic:
            from lunarsci.spectra.mgm.selection import stated_for

            stated = stated_for(assemblage, stated)
        return self.held(mgm_model(assemblage, continuum, stated))

    def held(self, model: MgmModel) -> MgmModel:
        """The model with the constraints."""
        return constrained(model, fixed=self.fixed, bounds=self.bounds, ties=self.ties)


@dataclass(slots=True)
class FitRun:
    """What came out: one result per spectrum, and by position what else was asked for."""

    results: list[Result]
    choices: dict[int, Any] = field(default_factory=dict)
    intervals: dict[int, Any] = field(default_factory=dict)
    abundances: dict[int, list[Abundance]] = field(default_factory=dict)
    start_file: InputFile | None = None
    library_file: InputFile | None = None
    known_file: InputFile | None = None


def run_fit(spectra: Sequence[Spectrum], request: FitRequest, quiet: bool) -> FitRun:
    """Fit all spectra as the options say."""
    if request.to_fit_file and len(spectra) != 1:
        raise ParameterError(f"a .fit file holds one spectrum, not {len(spectra)}; fit one at a time, or use --json")
    run = _fitted(spectra, request, quiet)
    if request.continuum_spread:
        _add_spread(spectra, request, run, quiet)
    if request.errors != "laplace":
        _add_intervals(request, run, quiet)
    add_abundances(spectra, request, run, quiet)
    return run


def _fitted(spectra: Sequence[Spectrum], request: FitRequest, quiet: bool) -> FitRun:
    with progress("fitting", quiet=quiet) as update:
        if request.automatic:
            return _chosen(spectra, request, update)
        if request.start:
            return _from_file(spectra, request, update)
        return FitRun(_by_prior(spectra, request.model(request.assemblage, request.continuum), request, LIMITS, update))


def _by_prior(
    spectra: Sequence[Spectrum], model: MgmModel, request: FitRequest, limits: tuple[float, float], update: Update
) -> list[Result]:
    if request.prior == "damping":
        from lunarsci.spectra.mgm.damping import fit_damping

        return fit_damping(
            spectra,
            model,
            rms_limit=limits[0],
            improvement_limit=limits[1],
            model_error=request.model_error,
            progress=update,
        )
    return fit_spectra(spectra, model, model_error=request.model_error, starts=request.starts, progress=update)


def _from_file(spectra: Sequence[Spectrum], request: FitRequest, update: Update) -> FitRun:
    from lunarsci.spectra.mgm.fitfile import read_fit_file
    from lunarsci.spectra.mgm.fitfile_model import model_of, spectrum_within

    source = read_input(str(request.start))
    file = read_fit_file(source)
    limits = (file.rms_limit, file.improvement_limit)
    within = [spectrum_within(spectrum, file) for spectrum in spectra]
    return FitRun(_by_prior(within, request.held(model_of(file)), request, limits, update), start_file=source)


def _chosen(spectra: Sequence[Spectrum], request: FitRequest, update: Update) -> FitRun:
    """Compare all assemblages, then fit each spectrum with its own."""
    from lunarsci.spectra.mgm.selection import Choice, choose

    found = choose(spectra, continuum=request.continuum, compositions=request.compositions, progress=update)
    choices = {index: item for index, item in enumerate(found) if isinstance(item, Choice)}
    results: dict[int, Result] = {index: item for index, item in enumerate(found) if isinstance(item, MgmFailure)}
    for name, members in _groups({index: choice.assemblage for index, choice in choices.items()}).items():
        model = request.model(name, request.continuum)
        fits = fit_spectra(
            [spectra[index] for index in members], model, model_error=request.model_error, starts=request.starts
        )
        results |= zip(members, fits, strict=True)
    return FitRun([results[index] for index in range(len(spectra))], choices=choices)


def _groups(names: Mapping[int, str]) -> dict[str, list[int]]:
    """Positions by name."""
    groups: dict[str, list[int]] = {}
    for index, name in names.items():
        groups.setdefault(name, []).append(index)
    return groups


def _add_spread(spectra: Sequence[Spectrum], request: FitRequest, run: FitRun, quiet: bool) -> None:
    from lunarsci.spectra.mgm.continua import fit_continua, with_continuum_spread

    groups = _groups({index: fit.assemblage for index, fit in enumerate(run.results) if isinstance(fit, MgmFit)})
    with progress("continua", quiet=quiet) as update:
        for number, (name, members) in enumerate(groups.items()):
            others = fit_continua(
                [spectra[index] for index in members],
                lambda continuum, name=name: request.model(name, continuum),  # type: ignore[misc]
                model_error=request.model_error,
                starts=request.starts,
                progress=lambda done, total, before=number: update(before * total + done, len(groups) * total),  # type: ignore[misc]
            )
            for index, other in zip(members, others, strict=True):
                run.results[index] = with_continuum_spread(run.results[index], other)  # type: ignore[arg-type]


def _add_intervals(request: FitRequest, run: FitRun, quiet: bool) -> None:
    fits = {index: fit for index, fit in enumerate(run.results) if isinstance(fit, MgmFit) and fit.converged}
    with progress("intervals", quiet=quiet) as update:
        if request.errors == "sample":
            from lunarsci.spectra.mgm.sample import posterior_intervals, sample_batch

            posteriors = sample_batch(list(fits.values()), seed=request.seed, progress=update)
            run.intervals = {
                index: posterior_intervals(posterior) for index, posterior in zip(fits, posteriors, strict=True)
            }
            return
        from lunarsci.spectra.mgm.profile import profile_intervals

        for done, (index, fit) in enumerate(fits.items(), start=1):
            run.intervals[index] = profile_intervals(fit)
            update(done, len(fits))


LEAST_MINERALS = 2


def add_abundances(spectra: Sequence[Spectrum], request: FitRequest, run: FitRun, quiet: bool) -> None:
    """The method asked for first, then the ratio of band strengths."""
    fits = {index: fit for index, fit in enumerate(run.results) if isinstance(fit, MgmFit) and fit.converged}
    for index, fit in fits.items():
        found = nbsr_abundance(fit)
        run.abundances[index] = [found] if found else []
    if request.abundance == "nbsr":
        return
    end_members = _end_members(request, run)
    stated = _stated([spectra[index].id for index in fits], request, run)
    suites = [list(fits)] if request.together else [[index] for index in fits]
    with progress("unmixing", quiet=quiet) as update:
        for done, suite in enumerate(suites, start=1):
            minerals = _minerals([fits[index] for index in suite], request)
            if len(minerals) >= LEAST_MINERALS:
                may = [_minerals([fits[index]], request) for index in suite]
                unmixed = _unmixed([spectra[index] for index in suite], minerals, may, stated, end_members, request)
                for index, item in zip(suite, unmixed, strict=True):
                    run.abundances[index].insert(0, item)
            update(done, len(suites))


def _unmixed(
    suite: Sequence[Spectrum],
    minerals: Sequence[str],
    may: Sequence[Sequence[str]],
    stated: "StatedModes",
    end_members: Sequence[EndMember] | None,
    request: FitRequest,
) -> list[Abundance]:
    """Shares of spectra taken together; `may` names the minerals of each fit."""
    from lunarsci.spectra.abundance.estimate import estimate_suite

    known = [stated.known.get(spectrum.id) for spectrum in suite]
    absent = [stated.absent.get(spectrum.id, ()) for spectrum in suite]
    present = [[name for name in own if name not in gone] for own, gone in zip(may, absent, strict=True)]
    found = estimate_suite(
        suite,
        minerals,
        method=request.abundance,
        end_members=end_members,
        iron=request.iron,
        present=[None if told else own for told, own in zip(known, present, strict=True)],
        known=known,
    )
    return [replace(item, status="modes as stated") if told else item for item, told in zip(found, known, strict=True)]


def _stated(names: Sequence[str], request: FitRequest, run: FitRun) -> "StatedModes":
    """Modes stated of the spectra."""
    from lunarsci.spectra.abundance.stated import StatedModes, read_modes

    if request.known is None:
        return StatedModes({}, {})
    run.known_file = read_input(request.known)
    stated = read_modes(run.known_file)
    told = {*stated.known, *stated.absent}
    doubled = [name for name in names if name in told and names.count(name) > 1]
    if doubled:
        raise ParameterError(f"{request.known}: '{doubled[0]}' is the id of two spectra; give each its own")
    if names and not told & set(names):
        raise ParameterError(f"{request.known}: none of its ids is that of a spectrum, such as '{names[0]}'")
    return stated


def _minerals(fits: Sequence[MgmFit], request: FitRequest) -> list[str]:
    """Those of the fits' assemblages, in the order of `FAMILY_OF`, then the opaque one if allowed."""
    named = {mineral for fit in fits for mineral in fit.model.assemblage.minerals}
    return [name for name in FAMILY_OF if name in named] + [OPAQUE] * request.opaque


def _end_members(request: FitRequest, run: FitRun) -> list[EndMember] | None:
    """Those of the user's library, None for the embedded ones."""
    if request.library is None:
        return None
    from lunarsci.spectra.library import read_library

    run.library_file = read_input(request.library)
    return read_library(run.library_file)
