"""Fa, Fs and olivine of ordinary chondrites from the 2 um centre and the ratio of the band areas.

One normal law holds bands x and composition y of ordinary chondrites together, `chondrite_calibration.csv`. Of bands
with errors E the composition is

    y = m_y + K (x - m_x),   V = S_yy - K S_xy,   K = S_yx (S_xx + E)^-1,

so that bands that are noisy, or not there, leave the mean chondrite with its spread; and how far x lies from m_x says
whether the target may be one. The 1 um centre takes no part: olivine moves it, and between powders of one rock,
Tuxtuac, it differs by 109 nm, the 2 um centre by 30.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.io.tables import table_rows
from lunarsci.spectra.bands import BandColumns
from lunarsci.spectra.chemistry.plane import CompositionEstimate, Estimates
from lunarsci.spectra.continuum import CONIC

TABLE = "chondrite_calibration.csv"
BANDS = ("bc2000_nm", "ln_area_ratio")
COMPOSITION = ("fa", "fs", "ol_share")
"""Of olivine and of orthopyroxene [mol %]; olivine in olivine and pyroxene, by volume [-]."""
SHRINKAGE = 0.3
"""Weight of no correlation in the covariance, for 15 rocks; with it errors of sample series left out are those stated:
measured, among 0, 0.15 and 0.3."""
UNLIKE = 0.01
"""Share of ordinary chondrites that lie farther from their mean, below which a target is none; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class ChondriteLaw:
    """Mean (5,) and covariance (5, 5) of `BANDS` and `COMPOSITION`."""

    mean: FloatArray
    covariance: FloatArray

    def composition(self, bands: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of bands (m, 2) and their errors, NaN for none: `COMPOSITION` and its standard errors, (m, 3) each."""
        apart, inner = self._apart(bands, np.nan_to_num(errors))
        across = np.broadcast_to(self.covariance[:2, 2:], (len(bands), 2, len(COMPOSITION)))
        gain = np.asarray(np.linalg.solve(inner, across), np.float64).transpose(0, 2, 1)
        covariance = self.covariance[2:, 2:] - gain @ self.covariance[:2, 2:]
        value = self.mean[2:] + (gain @ apart[..., None])[..., 0]
        return value, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))

    def likeness(self, bands: FloatArray) -> FloatArray:
        """Share of ordinary chondrites whose bands lie farther from the mean than (m, 2), 1 of no bands, (m,)."""
        from scipy.special import chdtrc

        apart, inner = self._apart(bands, np.zeros_like(bands))
        square = np.sum(apart * np.linalg.solve(inner, apart[..., None])[..., 0], axis=1)
        return np.asarray(chdtrc(np.maximum(np.isfinite(bands).sum(axis=1), 1), square))

    def _apart(self, bands: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x - m_x, (m, 2), and S_xx + E, (m, 2, 2); a band that is not there has an endless error."""
        there = np.isfinite(bands)
        own = np.where(there, errors**2, 1e12)[:, None, :] * np.eye(2)
        return np.where(there, bands - self.mean[:2], 0.0), self.covariance[:2, :2] + own


def learn_law(known: FloatArray, rocks: Sequence[str], groups: Sequence[str]) -> ChondriteLaw:
    """Law of spectra (n, 5), NaN for what is not known.

    The spectra of a rock, the rocks of a group (H, L, LL) and the groups count alike: which of them a laboratory has
    measured most says nothing of the next.
    """
    weight = np.ones(len(known))
    for names in (np.array(rocks), np.array(groups)):
        for name in np.unique(names):
            weight[names == name] /= weight[names == name].sum()
    there = np.isfinite(known)
    part = weight[:, None] * there
    mean = np.sum(part * np.where(there, known, 0.0), axis=0) / part.sum(axis=0)
    apart = np.where(there, known - mean, 0.0)
    raw = (weight[:, None] * apart).T @ apart / (part.T @ there)
    return ChondriteLaw(mean, (1.0 - SHRINKAGE) * raw + SHRINKAGE * np.diag(np.diagonal(raw)))


@cache
def embedded_law() -> ChondriteLaw:
    """That of `chondrite_calibration.csv`."""
    rows = table_rows(TABLE)
    covariance = [[float(row[name]) for name in (*BANDS, *COMPOSITION)] for row in rows]
    return ChondriteLaw(np.array([float(row["mean"]) for row in rows]), np.array(covariance))


def area_ratio(one: BandColumns, two: BandColumns) -> tuple[FloatArray, FloatArray]:
    """Area of the 2 um band over that of the 1 um band, and its standard error; NaN where either is not above 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        good = (one.area_nm > 0) & (two.area_nm > 0)
        ratio = np.where(good, two.area_nm / one.area_nm, np.nan)
        parts = [np.nan_to_num(e / b.area_nm) for b in (one, two) for e in (b.area_sigma_nm, b.area_calibration_nm)]
    return ratio, ratio * np.sqrt(sum(part**2 for part in parts))


def bands_of_chondrites(bands: Mapping[str, BandColumns]) -> tuple[FloatArray, FloatArray]:
    """2 um centre [nm] and logarithm of the area ratio [-], and their standard errors, (m, 2) each; NaN for none.

    Areas under the conic are others, and count as none. What the centre differs by between continua is in the law.
    """
    one, two = bands["1000"], bands["2000"]
    ratio, error = area_ratio(one, two)
    ratio = np.where((one.continuum == CONIC) | (two.continuum == CONIC), np.nan, ratio)
    centre = np.hypot(np.nan_to_num(two.center_sigma_nm), np.nan_to_num(two.center_calibration_nm))
    return np.stack([two.center_nm, np.log(ratio)], axis=1), np.stack([centre, error / ratio], axis=1)


def chondrites(bands: Mapping[str, BandColumns]) -> dict[str, Estimates]:
    """What the law of ordinary chondrites says: `fa_chondrite`, `fs_chondrite`, `ol_chondrite`."""
    found, errors = bands_of_chondrites(bands)
    law = embedded_law()
    values, sigmas = law.composition(found, errors)
    reason = np.where(law.likeness(found) < UNLIKE, "the bands are not those of an ordinary chondrite", "")
    caveat = "not corrected for temperature: 100 K above the laboratory's add 20 nm to the 2 µm centre"
    texts = {"domain": "an ordinary chondrite", "caveat": caveat, "source": "chondrite-bands"}
    return {
        f"{key}_chondrite": Estimates(
            quantity=quantity,
            unit="-" if quantity == "ol_share" else "mol %",
            present=np.isfinite(found[:, 0]),
            value=values[:, place],
            sigma=sigmas[:, place],
            reason=reason.astype(object),
            **{name: np.full(reason.shape, text, object) for name, text in texts.items()},
        )
        for place, (key, quantity) in enumerate((("fa", "fa"), ("fs", "fs"), ("ol", "ol_share")))
    }


def chondrite_record(found: Mapping[str, Estimates], row: int) -> dict[str, Any] | None:
    """The key `chondrite` of `lunarsci spectra unmix --json`: what a spectrum says if it is an ordinary chondrite's.

    `fa`, `fs` [mol %] and `olivine_in_mafic` [-], each with intervals; None where there is no 2 um band.
    """
    first = found["fa_chondrite"]
    if not first.present[row]:
        return None
    most = {"fa": 100.0, "fs": 100.0, "olivine_in_mafic": 1.0}
    values = {name: _with_intervals(one.of(row), most[name]) for name, one in zip(most, found.values(), strict=True)}
    return values | {"in_domain": not first.reason[row], "status": first.reason[row] or "if an ordinary chondrite"}


def _with_intervals(one: CompositionEstimate, most: float) -> dict[str, float]:
    from scipy.special import ndtri

    wide = float(ndtri(0.975))
    ends = {"low": -1.0, "high": 1.0, "low95": -wide, "high95": wide}
    return {"value": one.value} | {key: min(max(one.value + k * one.sigma, 0.0), most) for key, k in ends.items()}
