"""Shares of the pyroxenes from their normalised band strength ratio at 2 um (NBSR), with the error that it has.

Orthopyroxene's share of all pyroxene, by volume, is the ratio r itself. Its error follows Student's law with 4 degrees
of freedom and a scale that grows from end members, r = 0 or 1, to pairs:

    ln scale = c0 + 4 c1 r (1 - r),

to which the error of the ratio itself is added in quadrature. One pyroxene between both, such as pigeonite, has the
bands of a pair. `nbsr_calibrations.csv` has c0 and c1, learned from powders, mixtures and meteorites of known modes,
and how often intervals hold of sample series left out.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.io.records import Column, Same, Where
from lunarsci.io.tables import table_rows
from lunarsci.minerals import WITH_BANDS
from lunarsci.spectra.abundance.kinds import kinds_of_rows
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.abundance.shares import GOOD, LIKELY, UNTESTED
from lunarsci.spectra.mgm.batch import FitBatch, batch_of
from lunarsci.spectra.mgm.data import MgmRows, SpectraRows
from lunarsci.spectra.mgm.fit import SpectraFits
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit

PYROXENES = ("orthopyroxene", "clinopyroxene")
TABLE = "nbsr_calibrations.csv"
FREEDOM = 4.0
"""Degrees of freedom of the error; assumed, with tails as long as those of single pyroxenes that look like a pair."""


@dataclass(frozen=True, slots=True, eq=False)
class PyroxeneShares:
    """Orthopyroxene and clinopyroxene as shares by volume of all pyroxene, of n fits.

    Attributes
    ----------
    determined : (n,) whether there is a ratio.
    in_domain : (n,) whether both shares are likely within `GOOD`, and the kind of target is one that was tested.
    shares : (n, 2) of orthopyroxene and clinopyroxene; NaN without a ratio. [-]
    ends : (n, 2, 4) low, high, low95, high95 of each. [-]
    statuses : n sentences.
    """

    determined: BoolArray
    in_domain: BoolArray
    shares: FloatArray
    ends: FloatArray
    statuses: list[str]

    def abundance(self, row: int, name: str, rms_ln: float) -> Abundance | None:
        """What is found of one fit; None without a ratio."""
        if not self.determined[row]:
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

    determined, weathered = _has_ratio(batch), np.zeros(len(batch), dtype=bool)
    if determined.any():
        rows_here = np.flatnonzero(determined)
        weathered[rows_here] = kinds_of_rows(*rows.seen(rows_here))[2]
    ratio, sigma = batch.um2[:, 0], np.nan_to_num(batch.um2[:, 2])
    spread = np.where(weathered, 1.0, 4.0 * ratio * (1.0 - ratio))
    law = _law_of(batch.model.assemblage.name)
    scale = np.hypot(np.exp(float(law["ln_scale"]) + float(law["ln_scale_of_pairs"]) * spread), sigma)
    near = 2.0 * stdtr(FREEDOM, GOOD / scale) - 1.0
    reach = stdtrit(FREEDOM, np.array([0.16, 0.84, 0.025, 0.975]))
    shares = np.column_stack([ratio, 1.0 - ratio])
    ends = np.clip(shares[:, :, None] + scale[:, None, None] * reach, 0.0, 1.0)
    doubted = batch.strained.any(axis=1) | batch.beyond_trend.any(axis=1) | batch.ratios_differ
    inside = determined & ~weathered & ~doubted & (near >= LIKELY)
    return PyroxeneShares(determined, inside, shares, ends, list(map(_status, near, weathered, doubted, inside)))


def _law_of(assemblage: str) -> Mapping[str, str]:
    laws = table_rows(TABLE)
    return next((law for law in laws if law["assemblage"] == assemblage), laws[0])


def _status(near: float, weathered: bool, doubted: bool, inside: bool) -> str:
    within = f"the share is within {100 * GOOD:.0f} % of the truth with a probability of {near:.2f}"
    if weathered:
        return f"out of domain: {UNTESTED}"
    if doubted:
        return "out of domain: the fit is strained, so that its bands may be those of other minerals"
    return within if inside else f"out of domain: {within}; one pyroxene may have the bands of two"


def _has_ratio(batch: FitBatch) -> BoolArray:
    """(n,) whether there is a ratio of which shares could be made."""
    return np.asarray(np.isfinite(batch.um2[:, 0]) & (not batch.model.whole))


def nbsr_abundance(fit: MgmFit) -> Abundance | None:
    """`pyroxene_shares` of one fit; None without a ratio, and of fits by damping."""
    result = pyroxene_shares(batch_of(fit), MgmRows.together([fit.data]))
    return None if fit.prior == "damping" else result.abundance(0, fit.id, fit.rms_ln)


class PyroxeneAbundances(Mapping[int, list[Abundance]]):
    """`nbsr_abundance` of the fits that converged, by position: one, or none where the ratio is not determined."""

    def __init__(self, fits: SpectraFits) -> None:
        self._fits, self._names, self._rms = fits, fits.names, fits.gathered(lambda batch: batch.rms_ln)
        self._converged = fits.gathered(lambda batch: batch.converged) > 0

    @property
    def any_determined(self) -> bool:
        """Whether of any of them shares could be made."""
        result = self._fits.gathered(lambda batch: _has_ratio(batch))
        return bool(((result > 0) & self._converged).any())

    @cached_property
    def shares(self) -> PyroxeneShares:
        """Of all spectra."""
        count = len(self._fits)
        whole = PyroxeneShares(
            np.zeros(count, dtype=bool), np.zeros(count, dtype=bool), np.full((count, 2), np.nan),
            np.full((count, 2, 4), np.nan), [""] * count,
        )  # fmt: skip
        for positions, rows, batch in self._fits.parts:
            part = pyroxene_shares(batch, rows)
            whole.determined[positions], whole.in_domain[positions] = part.determined, part.in_domain
            whole.shares[positions], whole.ends[positions] = part.shares, part.ends
            for position, status in zip(positions.tolist(), part.statuses, strict=True):
                whole.statuses[position] = status
        whole.determined[~self._converged] = False
        return whole

    def __len__(self) -> int:
        return int(self._converged.sum())

    def __iter__(self) -> Iterator[int]:
        return iter(np.flatnonzero(self._converged).tolist())

    def __getitem__(self, position: int) -> list[Abundance]:
        if not (0 <= position < self._converged.size and self._converged[position]):
            raise KeyError(position)
        result = self.shares.abundance(position, self._names[position], float(self._rms[position]))
        return [result] if result else []

    def record_columns(self) -> dict[str, Column]:
        """The key `abundance` of records."""
        shares, keys = self.shares, ("low", "high", "low95", "high95")
        one: dict[str, Column] = {
            "method": "nbsr",
            "in_domain": shares.in_domain,
            "not_weighed": Same([mineral for mineral in WITH_BANDS if mineral not in PYROXENES]),
            "status": shares.statuses,
            "rms_ln": self._rms,
            "learned": None,
            "ratios": Same({}),
            "prior": None,
            "returned": None,
            "published": None,
        }
        for k, mineral in enumerate(PYROXENES):
            one[mineral] = {
                "fraction": shares.shares[:, k],
                **dict(zip(keys, shares.ends[:, k].T, strict=True)),
                "present": None,
                "median": shares.shares[:, k],
            }
        return {"abundance": Where(shares.determined, one)}

    def table_columns(self) -> dict[str, Column]:
        """`nbsr_in_domain`, `nbsr_orthopyroxene` and the like."""
        shares = self.shares
        columns: dict[str, Column] = {"nbsr_in_domain": Where(shares.determined, shares.in_domain)}
        for k, mineral in enumerate(PYROXENES):
            columns[f"nbsr_{mineral}"] = Where(shares.determined, shares.shares[:, k])
            for number, end in enumerate(("low", "high", "low95", "high95")):
                columns[f"nbsr_{mineral}_{end}"] = Where(shares.determined, shares.ends[:, k, number])
        return columns


def nbsr_abundances(fits: Sequence[MgmFit | MgmFailure]) -> Mapping[int, Sequence[Abundance]]:
    """`nbsr_abundance` of those that converged, by position: one, or none where the ratio is not determined."""
    if isinstance(fits, SpectraFits):
        return PyroxeneAbundances(fits)
    settled = {index: fit for index, fit in enumerate(fits) if isinstance(fit, MgmFit) and fit.converged}
    return {index: [one] if (one := nbsr_abundance(fit)) else [] for index, fit in settled.items()}
