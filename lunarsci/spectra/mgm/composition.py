"""Fo of olivine, Fs of orthopyroxene and Wo of clinopyroxene from fitted band centres."""

from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.mgm.assemblages import CompositionPrior
from lunarsci.spectra.mgm.model import center_slopes, prior_covariance
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["MineralComposition", "compositions"]

PRESENT_SIGMAS = 2.0
"""A mineral has a composition to speak of where a band of it is this many standard errors deep."""
NM_PER_UM = 1e3


@dataclass(frozen=True, slots=True)
class MineralComposition:
    """Composition of one mineral.

    Attributes
    ----------
    key : `fo`, `fs`, `wo`, or `fs_cpx` for the iron of clinopyroxene.
    mean, sigma : posterior mean and standard deviation; None where the mineral's bands are not there. [mol %]
    prior_sigma : before the spectrum was seen; a `sigma` close to it means that the spectrum says nothing. [mol %]
    lowest, highest : range over which the trend is known. [mol %]
    in_range : whether the mean lies there; beyond, the trend is only extended.
    """

    key: str
    mineral: str
    mean: float | None
    sigma: float | None
    prior_sigma: float
    lowest: float
    highest: float
    in_range: bool


def compositions(fit: MgmFit) -> tuple[MineralComposition, ...]:
    """Compositions that the fitted centres speak for, one per composition of the fit's assemblage. [mol %]

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
    items = fit.model.assemblage.compositions
    if not items:
        return ()
    mean, covariance = _posterior(fit, items)
    present = _present(fit)
    return tuple(
        _composition(item, mean[k], float(np.sqrt(max(covariance[k, k], 0.0))), item.mineral in present)
        for k, item in enumerate(items)
    )


def _posterior(fit: MgmFit, items: tuple[CompositionPrior, ...]) -> tuple[FloatArray, FloatArray]:
    m, assemblage = fit.model.degrees, fit.model.assemblage
    slopes = center_slopes(assemblage)
    spread = np.diag([item.sigma**2 for item in items])
    gain = np.linalg.solve(prior_covariance(assemblage), slopes @ spread).T
    centres = np.array([band.center_nm / NM_PER_UM for band in assemblage.bands])
    offset = np.zeros(slopes.shape[0])
    offset[::3] = fit.parameters[m::3] - centres
    mean = np.array([item.mean for item in items]) + gain @ offset
    return mean, spread - gain @ slopes @ spread + gain @ fit.covariance[m:, m:] @ gain.T


def _present(fit: MgmFit) -> set[str]:
    """Minerals with a band that is really there."""
    return {
        band.mineral
        for band in fit.bands
        if "strength" not in band.at_bound and -band.strength > PRESENT_SIGMAS * band.strength_sigma
    }


def _composition(item: CompositionPrior, mean: float, sigma: float, present: bool) -> MineralComposition:
    shown = present and bool(np.isfinite([mean, sigma]).all())
    return MineralComposition(
        item.key,
        item.mineral,
        float(mean) if shown else None,
        sigma if shown else None,
        item.sigma,
        item.lowest,
        item.highest,
        shown and item.lowest <= mean <= item.highest,
    )
