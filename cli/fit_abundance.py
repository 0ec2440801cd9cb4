"""Shares of minerals for fitted spectra, as the options of `lunarsci spectra fit` ask for them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import FAMILY_OF, OPAQUE
from lunarsci.spectra.abundance.estimate import SUM_TOLERANCE
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

from .fit_run import FitRequest, FitRun
from .progress import progress

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
    options: dict[str, Any] = {
        "method": request.abundance,
        "end_members": _end_members(request, run),
        "iron": request.iron,
    }
    if request.together:
        _together(spectra, fits, request, run, options, quiet)
    else:
        _one_by_one(spectra, fits, request, run, options, quiet)


def _one_by_one(
    spectra: Sequence[Spectrum],
    fits: Mapping[int, MgmFit],
    request: FitRequest,
    run: FitRun,
    options: Mapping[str, Any],
    quiet: bool,
) -> None:
    from lunarsci.spectra.abundance.estimate import estimate_abundance

    with progress("unmixing", quiet=quiet) as update:
        for done, (index, fit) in enumerate(fits.items(), start=1):
            minerals = _minerals([fit], request)
            if len(minerals) >= LEAST_MINERALS:
                run.abundances[index].insert(0, estimate_abundance(spectra[index], minerals, **options))
            update(done, len(fits))


def _together(
    spectra: Sequence[Spectrum],
    fits: Mapping[int, MgmFit],
    request: FitRequest,
    run: FitRun,
    options: Mapping[str, Any],
    quiet: bool,
) -> None:
    from lunarsci.spectra.abundance.estimate import estimate_suite

    minerals = _minerals(list(fits.values()), request)
    if len(minerals) < LEAST_MINERALS:
        return
    # Two files may name their spectra alike; their positions tell them apart.
    suite = [replace(spectra[index], id=str(index)) for index in fits]
    present = {str(index): _minerals([fit], request) for index, fit in fits.items()}
    known = _known({index: spectra[index].id for index in fits}, minerals, request, run, present)
    with progress("unmixing", quiet=quiet) as update:
        found = estimate_suite(suite, minerals, present=present, known=known, **options)
        update(1, 1)
    for index, item in zip(fits, found, strict=True):
        named = replace(item, id=spectra[index].id)
        run.abundances[index].insert(0, replace(named, status="modes as stated") if str(index) in known else named)


def _known(
    names: Mapping[int, str],
    minerals: Sequence[str],
    request: FitRequest,
    run: FitRun,
    present: dict[str, list[str]],
) -> dict[str, Mapping[str, float]]:
    """Modes stated for some spectra, by position; takes minerals stated as absent out of `present`."""
    if request.known is None:
        return {}
    from lunarsci.spectra.abundance.stated import read_modes

    run.known_file = read_input(request.known)
    stated = read_modes(run.known_file)
    place: dict[str, str] = {}
    for index, name in names.items():
        if name in place and (name in stated.known or name in stated.absent):
            raise ParameterError(f"{request.known}: '{name}' is the id of two spectra; give each its own")
        place[name] = str(index)
    if not {*stated.known, *stated.absent} & set(place):
        raise ParameterError(f"{request.known}: none of its ids is that of a spectrum, such as '{next(iter(place))}'")
    known = {place[name]: modes for name, modes in stated.known.items() if name in place}
    for name, modes in stated.known.items():
        beyond = [mineral for mineral, share in modes.items() if share > 0 and mineral not in minerals]
        if name in place and beyond:
            raise ParameterError(f"{request.known}: {name} holds {beyond[0]}; add it to --assemblage")
        if name in place and abs(sum(modes.values()) - 1) > SUM_TOLERANCE:
            raise ParameterError(f"{request.known}: shares of {name} sum to {sum(modes.values()):g}; give shares of 1")
    present |= {index: list(minerals) for index in known}
    for name, absent in stated.absent.items():
        if name in place:
            present[place[name]] = [mineral for mineral in present[place[name]] if mineral not in absent]
    return known


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
