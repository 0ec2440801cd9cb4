"""What the choice of the continuum does to a fit: the same spectra under several of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.mgm import MgmContinuum
from lunarsci.spectra.mgm.fit import CONTINUUM_QUANTILE, DEFAULT_STARTS, fit_spectra
from lunarsci.spectra.mgm.model import MGM_CONTINUA, MgmModel
from lunarsci.spectra.mgm.result import FittedBand, MgmFailure, MgmFit, StrengthRatio
from lunarsci.spectra.spectrum import Spectrum

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
    found: list[dict[MgmContinuum, MgmFit | MgmFailure]] = [{} for _ in spectra]
    for number, name in enumerate(continua):

        def report(done: int, total: int, before: int = number) -> None:
            if progress:
                progress(before * total + done, len(continua) * total)

        fits = fit_spectra(spectra, build(name), model_error=model_error, starts=starts, progress=report)
        for by_name, fit in zip(found, fits, strict=True):
            by_name[name] = fit
    return found


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
    found = list(fits)
    members = {index: item.assemblage for index, item in enumerate(fits) if isinstance(item, MgmFit)}
    for name in dict.fromkeys(members.values()):
        own = [index for index, assemblage in members.items() if assemblage == name]
        others = fit_continua(
            [spectra[index] for index in own],
            partial(build, name),
            model_error=model_error,
            starts=starts,
            progress=progress,
        )
        for index, other in zip(own, others, strict=True):
            found[index] = with_continuum_spread(found[index], other)  # type: ignore[arg-type]
    return found


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
