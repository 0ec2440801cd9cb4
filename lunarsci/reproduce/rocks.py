"""Measured spectra of boulders of Chang'E-4, fitted as Ding et al. (2024) fitted theirs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.bands import SpectrumBands, measure_bands
from lunarsci.spectra.mgm.continua import SPREAD_CONTINUA, fit_continua
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import DEFAULT_CONTINUUM, mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.smoothing import savitzky_golay_operator
from lunarsci.spectra.spectrum import Spectrum

__all__ = ["SMOOTHED_POINTS", "Rocks", "boulders", "fit_rocks", "olivine_share"]

SMOOTHED_POINTS = 41
"""Savitzky-Golay points of Ding et al. (2024)."""
OLIVINE, PYROXENES = "OL M1-2", ("OPX 1", "CPX 1")
NAMED = "rock"


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Boulders and what the Modified Gaussian Model (olivine and two pyroxenes) and the band centres say of them.

    Attributes
    ----------
    bands : per boulder, centres under the conic of Ding et al. (2024).
    fits : per boulder, the fit with the default continuum.
    over_continua : per continuum, the fits that converged, of any boulder.
    smoothed : per boulder, the fit to its spectrum smoothed over 41 points.
    """

    bands: tuple[SpectrumBands, ...]
    fits: tuple[MgmFit, ...]
    over_continua: dict[str, tuple[MgmFit, ...]]
    smoothed: tuple[MgmFit, ...]


def boulders(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """Those with "rock" in their name, or all where none has it. Raises DataError for none."""
    named = [spectrum for spectrum in spectra if NAMED in spectrum.id.lower()]
    if not spectra:
        raise DataError("no spectrum of a boulder; give at least one")
    return named or list(spectra)


def fit_rocks(spectra: Sequence[Spectrum], progress: Callable[[int, int], None] | None = None) -> Rocks:
    """Fit boulders, as measured under every continuum and smoothed under the default one.

    Raises DataError where not one of them can be fitted.
    """
    rounds = len(SPREAD_CONTINUA) + 1

    def report(done: int, total: int) -> None:
        if progress:
            progress(done, total // len(SPREAD_CONTINUA) * rounds)

    found = fit_continua(spectra, lambda name: mgm_model(continuum=name), progress=report)
    smoothed = fit_spectra([_smoothed(spectrum) for spectrum in spectra], mgm_model())
    by_name = {name: _good([fits[name] for fits in found]) for name in SPREAD_CONTINUA}
    if not (by_name[DEFAULT_CONTINUUM] and _good(smoothed)):
        raise DataError(f"none of the {len(spectra)} spectra of boulders can be fitted; see lunarsci spectra fit")
    return Rocks(
        bands=tuple(measure_bands(spectrum) for spectrum in spectra),
        fits=by_name[DEFAULT_CONTINUUM],
        over_continua={str(name): fits for name, fits in by_name.items()},
        smoothed=_good(smoothed),
    )


def _good(fits: Sequence[MgmFit | MgmFailure]) -> tuple[MgmFit, ...]:
    return tuple(fit for fit in fits if isinstance(fit, MgmFit) and fit.converged)


def _smoothed(spectrum: Spectrum) -> Spectrum:
    """Smoothed where it can be used; errors stay those of single channels, as a fit of the paper would have it."""
    usable = spectrum.usable
    values = np.array(spectrum.reflectance)
    values[usable] = savitzky_golay_operator(spectrum.wavelength_nm[usable], SMOOTHED_POINTS) @ values[usable]
    return replace(spectrum, reflectance=values)


def olivine_share(fit: MgmFit) -> float:
    """Strength of olivine's band near 1240 nm over that and the 1 um bands of the pyroxenes; NaN where all are 0. [-]

    Ding et al. (2024) do not say how their relative abundance of olivine is made; this one is assumed, and no fraction
    of the volume.
    """
    strength = {band.name: abs(band.strength) for band in fit.bands}
    total = strength[OLIVINE] + sum(strength[name] for name in PYROXENES)
    return strength[OLIVINE] / total if total > 0 else float("nan")
