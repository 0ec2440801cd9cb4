"""Shares of minerals for fitted spectra, as the options of `lunarsci spectra fit` ask for them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import FAMILY_OF, OPAQUE
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.abundance.result import Abundance
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

from .fit_run import FitRequest, FitRun
from .progress import progress

if TYPE_CHECKING:
    from lunarsci.spectra.abundance.stated import StatedModes

__all__ = ["add_abundances"]

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
