"""What the choice of the continuum does to a fit: the same spectra under several of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lunarsci.spectra.mgm.continuum import MGM_CONTINUA, MgmContinuum
from lunarsci.spectra.mgm.fit import DEFAULT_MODEL_ERROR, DEFAULT_STARTS, fit_spectra
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.result import FittedBand, MgmFailure, MgmFit, StrengthRatio
from lunarsci.spectra.spectrum import Spectrum

__all__ = ["SPREAD_CONTINUA", "fit_continua", "with_continuum_spread"]

SPREAD_CONTINUA: tuple[MgmContinuum, ...] = tuple(name for name in MGM_CONTINUA if name != "none")
"""All that can follow a spectrum; `none` fits only what had its continuum removed before."""


def fit_continua(
    spectra: Sequence[Spectrum],
    build: Callable[[MgmContinuum], MgmModel],
    *,
    continua: Sequence[MgmContinuum] = SPREAD_CONTINUA,
    model_error: float = DEFAULT_MODEL_ERROR,
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


def with_continuum_spread(fit: MgmFit, others: Mapping[MgmContinuum, MgmFit | MgmFailure]) -> MgmFit:
    """`fit` with the standard deviation of its bands and ratios over the continua that converged, its own among them.

    Continua are no sample of anything: the spread says what the choice does, not how likely a value is. Han et al.
    (2020), arXiv:2003.07856, report it for olivine and orthopyroxene.
    """
    fits = [other for other in others.values() if isinstance(other, MgmFit) and other.converged]
    if len(fits) < 2:
        return fit
    bands = tuple(_spread_band(band, [other.bands[k] for other in fits]) for k, band in enumerate(fit.bands))
    ratios = {key: _spread_ratio(ratio, [other.nbsr.get(key) for other in fits]) for key, ratio in fit.nbsr.items()}
    return replace(fit, bands=bands, nbsr=ratios)


def _spread_band(band: FittedBand, others: Sequence[FittedBand]) -> FittedBand:
    return replace(
        band,
        center_continuum_nm=float(np.std([other.center_nm for other in others])),
        fwhm_continuum_nm=float(np.std([other.fwhm_nm for other in others])),
        strength_continuum=float(np.std([other.strength for other in others])),
    )


def _spread_ratio(ratio: StrengthRatio | None, others: Sequence[StrengthRatio | None]) -> StrengthRatio | None:
    known = [other.opx for other in others if other]
    return replace(ratio, continuum=float(np.std(known))) if ratio and len(known) > 1 else ratio
