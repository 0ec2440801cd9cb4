"""Whether the bands of the wheel states hold as many of them as they should."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.comparison.bands import ALL, NOMINAL, BandCheck, half_band
from lunarsci.twin.comparison.meeting import Meeting
from lunarsci.twin.drive_record import OBSERVED

__all__ = ["Coverage", "check_coverage"]

FloatArray = npt.NDArray[np.float64]
MOST_REFERENCES = 400
"""Members whose coverage is worked out, beside which that of the drive is held; more would add nothing."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of values in their 90 % bands, against those that members have.

    Attributes
    ----------
    p : quantity to the probability of no larger a share, were the prediction right.
    worst, worst_p : the quantity with the smallest, and the probability that any has one as small.
    """

    p: dict[str, float]
    worst: str
    worst_p: float


def check_coverage(meeting: Meeting, bands: Sequence[BandCheck], seed: int = 0) -> Coverage | None:
    """Hold the shares of all wheels against those of the members.

    Each member, with errors of measurement, is put beside the bands of the others: (1 + those with no larger share) /
    (M + 1) is the probability, whatever values share. Where no member has so small a share, it falls from there as the
    binomial law does, with the effective number of values. None with fewer than three members or without values.
    """
    checks = [band for band in bands if band.wheel == ALL and band.coverage_90 is not None]
    if not checks or len(meeting.members) < 4:
        return None
    members = np.stack([_shares(meeting, check.quantity, [seed, k]) for k, check in enumerate(checks)])
    own = np.array([check.coverage_90 for check in checks], dtype=float)
    count = members.shape[1]
    fewer = (members <= own[:, None] + 1e-12).sum(axis=1)
    falls = [_fall(check, *pair) for check, *pair in zip(checks, own, members.min(axis=1), strict=True)]
    each = (1 + fewer) / (count + 1) * np.where(fewer > 0, 1.0, falls)
    ranked = (members[:, None, :] <= members[:, :, None] + 1e-12).sum(axis=2) / (count + 1)
    worst = int(each.argmin())
    as_bad = int((ranked.min(axis=0) <= (1 + fewer[worst]) / (count + 1) - 1e-12).sum()) if fewer[worst] else 0
    together = (1 + as_bad) / (count + 1) * (1.0 if fewer[worst] else falls[worst])
    names = [check.quantity for check in checks]
    return Coverage(dict(zip(names, map(float, each), strict=True)), names[worst], float(together))


def _fall(check: BandCheck, share: float, least: float) -> float:
    """Binomial probability of the share over that of the least share of a member, at most 1. [-]"""
    from scipy.stats import binom

    values = max(int(check.effective), 1)
    own, other = (binom.cdf(np.floor(one * values), values, NOMINAL) for one in (share, least))
    return min(float(own / max(other, 1e-300)), 1.0)


def _shares(meeting: Meeting, name: str, seed: Sequence[int]) -> FloatArray:
    """Share of each member's values in the bands of the others."""
    column = OBSERVED.index(name)
    rows = meeting.known[:, column]
    members, sigma = meeting.predicted[:, rows, column], meeting.sigma[rows, column]
    count, random, mean = len(members), np.random.default_rng(seed), members.mean(axis=0)
    scatter = ((members - mean) ** 2).sum(axis=0)
    shares = []
    for m in np.unique(np.linspace(0, count - 1, min(count, MOST_REFERENCES)).astype(np.int64)):
        off = members[m] - mean
        variance = (scatter - count / (count - 1) * off**2) / (count - 2) * (1.0 + 1.0 / (count - 1)) + sigma**2
        away = members[m] + sigma * random.standard_normal(sigma.shape) - (mean - off / (count - 1))
        shares.append((np.abs(away) <= half_band(count - 1) * np.sqrt(variance)).mean())
    return np.array(shares)
