"""Shares of the pyroxenes from their normalised band strength ratio at 2 um (NBSR), with the error that it has.

Orthopyroxene's share of all pyroxene, by volume, is the ratio r itself. Its error follows Student's law with 4 degrees
of freedom and a scale that grows from end members, r = 0 or 1, to pairs:

    ln scale = c0 + 4 c1 r (1 - r),

to which the error of the ratio itself is added in quadrature. One pyroxene between both, such as pigeonite, has the
bands of a pair. `nbsr_calibrations.csv` has c0 and c1, learned from powders, mixtures and meteorites of known modes,
and how often intervals hold of suites left out.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.io.records import Column, Same, Where
from lunarsci.io.tables import table_rows
from lunarsci.spectra.abundance.kinds import kinds_of_rows
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.abundance.shares import GOOD, LIKELY
from lunarsci.spectra.mgm.batch import FitBatch, batch_of
from lunarsci.spectra.mgm.data import MgmRows, SpectraRows
from lunarsci.spectra.mgm.fit import SpectraFits
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.readers.library import CHEMISTRY

PYROXENES = ("orthopyroxene", "clinopyroxene")
TABLE = "nbsr_calibrations.csv"
FREEDOM = 4.0
"""Degrees of freedom of the error; assumed, with tails as long as those of single pyroxenes that look like a pair."""


@dataclass(frozen=True, slots=True, eq=False)
class PyroxeneShares:
    """Orthopyroxene and clinopyroxene as shares by volume of all pyroxene, of n fits.

    Attributes
    ----------
    told : (n,) whether there is a ratio.
    in_domain : (n,) whether both shares are likely within `GOOD`, and the kind of target is one that was tested.
    shares : (n, 2) of orthopyroxene and clinopyroxene; NaN without a ratio. [-]
    ends : (n, 2, 4) low, high, low95, high95 of each. [-]
    statuses : n sentences.
    """

    told: BoolArray
    in_domain: BoolArray
    shares: FloatArray
    ends: FloatArray
    statuses: list[str]

    def abundance(self, row: int, name: str, rms_ln: float) -> Abundance | None:
        """What is found of one fit; None without a ratio."""
        if not self.told[row]:
            return None
        pairs = zip(PYROXENES, self.shares[row].tolist(), self.ends[row].tolist(), strict=True)
        fractions = tuple(MineralFraction(mineral, share, *ends) for mineral, share, ends in pairs)
        return Abundance(name, "nbsr", fractions, bool(self.in_domain[row]), self.statuses[row], rms_ln)


def pyroxene_shares(batch: FitBatch, rows: MgmRows | SpectraRows) -> PyroxeneShares:
    """Shares of the pyroxenes of fits `batch` of the spectra `rows`, where there is a ratio.

    A weathered surface, of which no spectrum of known modes was seen, has the widest error there is. Fits with bands of
    a start file have no shares: what their bands are of is not known.

    References
    ----------
    Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025 (ratio).
    """
    from scipy.special import stdtr, stdtrit

    told, weathered = _is_told(batch), np.zeros(len(batch), dtype=bool)
    if told.any():
        own = np.flatnonzero(told)
        weathered[own] = kinds_of_rows(*rows.seen(own))[2]
    ratio, sigma = batch.um2[:, 0], np.nan_to_num(batch.um2[:, 2])
    spread = np.where(weathered, 1.0, 4.0 * ratio * (1.0 - ratio))
    law = _law_of(batch.model.assemblage.name)
    scale = np.hypot(np.exp(float(law["ln_scale"]) + float(law["ln_scale_of_pairs"]) * spread), sigma)
    near = 2.0 * stdtr(FREEDOM, GOOD / scale) - 1.0
    reach = stdtrit(FREEDOM, np.array([0.16, 0.84, 0.025, 0.975]))
    shares = np.column_stack([ratio, 1.0 - ratio])
    ends = np.clip(shares[:, :, None] + scale[:, None, None] * reach, 0.0, 1.0)
    doubted = batch.strained.any(axis=1) | batch.beyond_trend.any(axis=1) | batch.ratios_differ
    inside = told & ~weathered & ~doubted & (near >= LIKELY)
    return PyroxeneShares(told, inside, shares, ends, list(map(_status, near, weathered, doubted, inside)))


def _law_of(assemblage: str) -> Mapping[str, str]:
    laws = table_rows(TABLE)
    return next((law for law in laws if law["assemblage"] == assemblage), laws[0])


def _status(near: float, weathered: bool, doubted: bool, inside: bool) -> str:
    within = f"with a probability of {near:.2f} within {100 * GOOD:.0f} %"
    if weathered:
        return "out of domain: it looks weathered, as no spectrum of known shares does"
    if doubted:
        return "out of domain: the fit is strained, so that its bands may be those of other minerals"
    return within if inside else f"out of domain: only {within}, as of one pyroxene that has the bands of two"


def _is_told(batch: FitBatch) -> BoolArray:
    """(n,) whether there is a ratio of which shares could be made."""
    return np.asarray(np.isfinite(batch.um2[:, 0]) & (not batch.model.whole))


def nbsr_abundance(fit: MgmFit) -> Abundance | None:
    """`pyroxene_shares` of one fit; None without a ratio, and of fits by damping."""
    found = pyroxene_shares(batch_of(fit), MgmRows.together([fit.data]))
    return None if fit.prior == "damping" else found.abundance(0, fit.id, fit.rms_ln)


class PyroxeneAbundances(Mapping[int, list[Abundance]]):
    """`nbsr_abundance` of the fits that converged, by position: one, or none where the ratio is not determined."""

    def __init__(self, fits: SpectraFits) -> None:
        self._fits, self._names, self._rms = fits, fits.names, fits.gathered(lambda batch: batch.rms_ln)
        self._converged = fits.gathered(lambda batch: batch.converged) > 0

    @property
    def any_told(self) -> bool:
        """Whether of any of them shares could be made."""
        found = self._fits.gathered(lambda batch: _is_told(batch))
        return bool(((found > 0) & self._converged).any())

    @cached_property
    def shares(self) -> PyroxeneShares:
        """Of all spectra."""
        count = len(self._fits)
        found = PyroxeneShares(
            np.zeros(count, dtype=bool), np.zeros(count, dtype=bool), np.full((count, 2), np.nan),
            np.full((count, 2, 4), np.nan), [""] * count,
        )  # fmt: skip
        for positions, rows, batch in self._fits.parts:
            own = pyroxene_shares(batch, rows)
            found.told[positions], found.in_domain[positions] = own.told, own.in_domain
            found.shares[positions], found.ends[positions] = own.shares, own.ends
            for position, status in zip(positions.tolist(), own.statuses, strict=True):
                found.statuses[position] = status
        found.told[~self._converged] = False
        return found

    def __len__(self) -> int:
        return int(self._converged.sum())

    def __iter__(self) -> Iterator[int]:
        return iter(np.flatnonzero(self._converged).tolist())

    def __getitem__(self, position: int) -> list[Abundance]:
        if not (0 <= position < self._converged.size and self._converged[position]):
            raise KeyError(position)
        found = self.shares.abundance(position, self._names[position], float(self._rms[position]))
        return [found] if found else []

    def record_columns(self) -> dict[str, Column]:
        """The key `abundance` of records."""

        own, keys = self.shares, ("low", "high", "low95", "high95")
        one: dict[str, Column] = {
            "method": "nbsr",
            "in_domain": own.in_domain,
            "not_weighed": Same([mineral for mineral in CHEMISTRY if mineral not in PYROXENES]),
            "status": own.statuses,
            "rms_ln": self._rms,
            "learned": None,
            "ratios": Same({}),
            "prior": None,
            "returned": None,
            "published": None,
        }
        for k, mineral in enumerate(PYROXENES):
            one[mineral] = {
                "fraction": own.shares[:, k],
                **dict(zip(keys, own.ends[:, k].T, strict=True)),
                "present": None,
            }
        return {"abundance": Where(own.told, one)}

    def table_columns(self) -> dict[str, Column]:
        """`nbsr_in_domain`, `nbsr_orthopyroxene` and the like."""
        own = self.shares
        columns: dict[str, Column] = {"nbsr_in_domain": Where(own.told, own.in_domain)}
        for k, mineral in enumerate(PYROXENES):
            columns[f"nbsr_{mineral}"] = Where(own.told, own.shares[:, k])
            for number, end in enumerate(("low", "high", "low95", "high95")):
                columns[f"nbsr_{mineral}_{end}"] = Where(own.told, own.ends[:, k, number])
        return columns


def nbsr_abundances(fits: Sequence[MgmFit | MgmFailure]) -> Mapping[int, Sequence[Abundance]]:
    """`nbsr_abundance` of those that converged, by position: one, or none where the ratio is not determined."""
    if isinstance(fits, SpectraFits):
        return PyroxeneAbundances(fits)
    settled = {index: fit for index, fit in enumerate(fits) if isinstance(fit, MgmFit) and fit.converged}
    return {index: [one] if (one := nbsr_abundance(fit)) else [] for index, fit in settled.items()}
