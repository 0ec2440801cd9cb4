"""Modes from the normalised band strength ratio of the pyroxenes, by lines made on mixtures of known modes."""

from collections.abc import Mapping, Sequence

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.mgm.assemblages import MINERALS
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit, MineralComposition, compositions
from lunarsci.tables import table_rows

TABLE = "nbsr_calibrations.csv"
NORMAL_95 = 1.96
SEEN_SIGMAS, APART_SIGMAS = 3.0, 2.0
"""Standard errors from which another mineral absorbs, and a composition lies outside; assumed."""
OTHER_MINERALS = {*MINERALS.values()} - {"orthopyroxene", "clinopyroxene"}


def calibrations() -> tuple[str, ...]:
    """Names of the lines that are known."""
    return tuple(row["name"] for row in table_rows(TABLE))


def nbsr_abundance(fit: MgmFit, calibration: str = "opx-cpx") -> Abundance | None:
    """Orthopyroxene and clinopyroxene as shares by weight of all pyroxene; None where the ratio is not determined.

    The line is OPX = slope * NBSR + offset; its scatter and the error of the ratio add in quadrature, and shares are
    kept within 0 and 1. A line belongs to the minerals it was made on: `in_domain` is false where the fitted
    compositions lie more than twice their error outside of those, or where olivine or plagioclase absorb as well, which
    share the bands near 1 um. Errors out of domain are tens of per cent.

    Raises ParameterError for an unknown calibration.

    References
    ----------
    Sunshine & Pieters (1993), J. Geophys. Res. 98, 9075, 10.1029/93JE00677; Kanner, Mustard & Gendrin (2007), Icarus
    187, 442, 10.1016/j.icarus.2006.10.025 (ratio).
    """
    rows = {row["name"]: row for row in table_rows(TABLE)}
    if calibration not in rows:
        raise ParameterError(f"calibration '{calibration}'; give one of {', '.join(rows)}")
    row = rows[calibration]
    ratio = fit.nbsr.get(row["region"])
    if ratio is None:
        return None
    slope, offset, scatter = (float(row[key]) / 100 for key in ("slope_percent", "offset_percent", "sd_percent"))
    share = float(np.clip(slope * ratio.opx + offset, 0.0, 1.0))
    sigma = float(np.hypot(slope * ratio.sigma, scatter))
    fractions = (_share("orthopyroxene", share, sigma), _share("clinopyroxene", 1.0 - share, sigma))
    reasons = _reasons(fit, row)
    doubt = f"; out of domain: {'; '.join(reasons)}" if reasons else ""
    status = f"line {calibration}, by weight{doubt}"
    return Abundance(fit.id, "nbsr", fractions, np.array([[1.0, -1.0], [-1.0, 1.0]]), not reasons, status, fit.rms_ln)


def nbsr_abundances(fits: Sequence[MgmFit | MgmFailure]) -> dict[int, list[Abundance]]:
    """`nbsr_abundance` of those that converged, by position: one, or none where the ratio is not determined."""
    settled = {index: fit for index, fit in enumerate(fits) if isinstance(fit, MgmFit) and fit.converged}
    return {index: [one] if (one := nbsr_abundance(fit)) else [] for index, fit in settled.items()}


def _share(mineral: str, share: float, sigma: float) -> MineralFraction:
    ends = [float(np.clip(share + z * sigma, 0.0, 1.0)) for z in (-1.0, 1.0, -NORMAL_95, NORMAL_95)]
    return MineralFraction(mineral, share, *ends)


def _reasons(fit: MgmFit, row: Mapping[str, str]) -> list[str]:
    reasons = []
    for item in compositions(fit):
        low, high = row.get(f"{item.key}_low", ""), row.get(f"{item.key}_high", "")
        if low and _outside(item, float(low), float(high)):
            reasons.append(f"{item.key} {item.mean:.0f} +- {item.sigma:.0f} mol %, made at {low}-{high}")
    strong = {
        band.mineral
        for band in fit.bands
        if band.mineral in OTHER_MINERALS and band.strength < -SEEN_SIGMAS * band.strength_sigma
    }
    return reasons + [f"{mineral} absorbs as well" for mineral in sorted(strong)]


def _outside(item: MineralComposition, low: float, high: float) -> bool:
    if item.mean is None or item.sigma is None:
        return False
    return item.mean < low - APART_SIGMAS * item.sigma or item.mean > high + APART_SIGMAS * item.sigma
