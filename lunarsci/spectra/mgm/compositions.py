"""Compositions of minerals that the band centres of fits speak for."""

from dataclasses import asdict, dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.result import AS_PRIOR, doubt_about, from_prior
from lunarsci.spectra.mgm import TREND_SIGMA
from lunarsci.spectra.mgm.assemblages import PYROXENES, CompositionPrior
from lunarsci.spectra.mgm.batch import FitBatch, batch_of
from lunarsci.spectra.mgm.result import MgmFit

FO_HIDDEN = 60.0
"""Error of Fo where pyroxene alone absorbs at 1 um; it grows with pyroxene's share of the strengths of bands there.
Measured: 47 to 70 with one of 31 sample series of known composition left out, 157 spectra, beside the fit's own error
and the trend's (`tests/benchmarks/compositions.py`). [mol %]"""


@dataclass(frozen=True, slots=True)
class MineralComposition:
    """Composition of one mineral.

    Attributes
    ----------
    key : `fo`, `fs`, `wo`, or `fs_cpx` for the iron of clinopyroxene.
    mean, sigma : posterior mean and standard deviation; None where the mineral's bands are not there. [mol %]
    trend_sigma : what the trend itself misses, which `sigma` does not include. [mol %]
    prior_sigma : before the spectrum was seen; a `sigma` close to it means that the spectrum says nothing. [mol %]
    lowest, highest : range over which the trend is known. [mol %]
    in_range : whether the mean lies there; beyond, the trend is only extended.
    domain : what must hold beside, '' for nothing: of a pyroxene fitted alone, that there is no second one.
    """

    key: str
    mineral: str
    mean: float | None
    sigma: float | None
    trend_sigma: float
    prior_sigma: float
    lowest: float
    highest: float
    in_range: bool
    domain: str = ""

    @property
    def told(self) -> bool:
        """Whether the spectrum, and not the prior alone, says what it is."""
        return not from_prior(self.sigma, self.prior_sigma)

    @property
    def doubt(self) -> str:
        """Why it should not be used, or that it is the prior's; '' where it may be."""
        return doubt_about(asdict(self)) or ("" if self.told else AS_PRIOR)


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

    Those of `composition_moments` where the mineral's bands are there. Beside pyroxene the error of Fo is larger than
    the fit's: its bands overlap with olivine's, and hardly tell more than the prior.
    """
    items = batch.model.assemblage.compositions
    if not items:
        return ()
    mean, variance = batch.compositions[:, :, 0], batch.compositions[:, :, 1]
    there = np.column_stack([batch.present(item.mineral) for item in items])
    shown = there & np.isfinite(mean) & np.isfinite(variance)
    variance = variance + np.column_stack([_hidden(batch, item.key) for item in items]) ** 2
    mean, sigma = np.where(shown, mean, np.nan), np.where(shown, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    return tuple(CompositionColumn(item, mean[:, k], sigma[:, k]) for k, item in enumerate(items))


def _hidden(batch: FitBatch, key: str) -> FloatArray:
    """(n,) error of a composition from bands that others hide: of olivine's beside pyroxene's. [mol %]"""
    bands, m = batch.model.assemblage.bands, batch.model.degrees
    if key != "fo" or not any(band.mineral in PYROXENES for band in bands):
        return np.zeros(len(batch))
    strength = -batch.values[:, m + 2 :: 3] * [band.region == "um1" for band in bands]
    pyroxene = strength[:, [band.mineral in PYROXENES for band in bands]].sum(axis=1)
    olivine = strength[:, [band.mineral == "olivine" for band in bands]].sum(axis=1)
    return np.asarray(FO_HIDDEN * pyroxene / np.maximum(pyroxene + olivine, np.finfo(float).tiny))


def compositions(fit: MgmFit) -> tuple[MineralComposition, ...]:
    """`compositions_of` one fit."""
    batch = batch_of(fit)
    return tuple(_composition(one, batch.model.assemblage.domain(one.prior.mineral)) for one in compositions_of(batch))


def _composition(column: CompositionColumn, domain: str) -> MineralComposition:
    item, mean, sigma = column.prior, float(column.mean[0]), float(column.sigma[0])
    shown = mean == mean
    return MineralComposition(
        item.key,
        item.mineral,
        mean if shown else None,
        sigma if shown else None,
        TREND_SIGMA[item.key],
        item.sigma,
        item.lowest,
        item.highest,
        bool(column.in_range[0]),
        domain,
    )


def beyond_any(fit: MgmFit) -> tuple[str, ...]:
    """Minerals of a fit whose centres ask for a composition that there is not."""
    items = fit.model.assemblage.compositions
    far = batch_of(fit).beyond_trend[0]
    return tuple(dict.fromkeys(item.mineral for item, off in zip(items, far, strict=True) if off))
