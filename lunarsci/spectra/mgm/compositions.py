"""Compositions of minerals that the band centres of fits speak for."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.assemblages import CompositionPrior
from lunarsci.spectra.mgm.batch import FitBatch, batch_of
from lunarsci.spectra.mgm.model import NM_PER_UM, center_slopes, prior_covariance
from lunarsci.spectra.mgm.result import MgmFit

PRESENT_SIGMAS = 2.0
"""A mineral has a composition to speak of where a band of it is this many standard errors deep."""
UNMOVED = 0.9
"""Share of the prior's standard deviation above which a composition is the prior's; assumed."""


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

    @property
    def told(self) -> bool:
        """Whether the spectrum, and not the prior alone, says what it is."""
        return self.sigma is not None and self.sigma <= UNMOVED * self.prior_sigma


@dataclass(frozen=True, slots=True, eq=False)
class CompositionColumn:
    """One composition of n fits; NaN where the mineral's bands are not there. [mol %]"""

    prior: CompositionPrior
    mean: FloatArray
    sigma: FloatArray

    @property
    def in_range(self) -> BoolArray:
        """(n,) whether the mean lies where the trend is known."""
        return np.asarray((self.prior.lowest <= self.mean) & (self.mean <= self.prior.highest))


def compositions_of(batch: FitBatch) -> tuple[CompositionColumn, ...]:
    """Compositions that the fitted centres speak for, one per composition of the assemblage. [mol %]

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
    model, m = batch.model, batch.model.degrees
    items = model.assemblage.compositions
    if not items:
        return ()
    slopes, spread = center_slopes(model.assemblage), np.diag([item.sigma**2 for item in items])
    gain = np.linalg.solve(prior_covariance(model.assemblage), slopes @ spread).T
    centres = np.array([band.center_nm / NM_PER_UM for band in model.assemblage.bands])
    first = (np.array([item.mean for item in items]), np.diag(spread - gain @ slopes @ spread))
    mean, variance = np.empty((len(batch), len(items))), np.empty((len(batch), len(items)))
    _average(batch.values[:, m::3] - centres, batch.covariance[:, m:, m:], gain, first, mean, variance)
    there = np.column_stack([_present(batch, item.mineral) for item in items])
    shown = there & np.isfinite(mean) & np.isfinite(variance)
    mean, sigma = np.where(shown, mean, np.nan), np.where(shown, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    return tuple(CompositionColumn(item, mean[:, k], sigma[:, k]) for k, item in enumerate(items))


def _present(batch: FitBatch, mineral: str) -> BoolArray:
    """(n,) whether a band of the mineral is really there."""
    bands = batch.model.assemblage.bands
    own = batch.model.degrees + 2 + 3 * np.flatnonzero([band.mineral == mineral for band in bands])
    with np.errstate(invalid="ignore"):
        deep = -batch.values[:, own] > PRESENT_SIGMAS * batch.sigma[:, own]
    return np.asarray((deep & ~batch.at_bound[:, own]).any(axis=1))


def compositions(fit: MgmFit) -> tuple[MineralComposition, ...]:
    """`compositions_of` one fit."""
    return tuple(_composition(column) for column in compositions_of(batch_of(fit)))


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _average(offset: Any, covariance: Any, gain: Any, first: Any, mean: Any, variance: Any) -> None:
    """x0 + G (c - c0) and the diagonal of P - G S P + G V G', row by row."""
    compositions, size = gain.shape
    for row in range(mean.shape[0]):
        for k in range(compositions):
            total, spread = first[0][k], first[1][k]
            for p in range(0, size, 3):
                total += gain[k, p] * offset[row, p // 3]
            for p in range(size):
                for q in range(size if gain[k, p] != 0.0 else 0):
                    spread += gain[k, p] * covariance[row, p, q] * gain[k, q]
            mean[row, k], variance[row, k] = total, spread


def _composition(column: CompositionColumn) -> MineralComposition:
    item, mean, sigma = column.prior, float(column.mean[0]), float(column.sigma[0])
    shown = mean == mean
    return MineralComposition(
        item.key,
        item.mineral,
        mean if shown else None,
        sigma if shown else None,
        item.sigma,
        item.lowest,
        item.highest,
        bool(column.in_range[0]),
    )
