"""Modes from the normalised band strength ratio of the pyroxenes, by lines made on mixtures of known modes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.records import Column, Same, Where
from lunarsci.spectra.abundance.kinds import dark_or_weathered, features_of_rows
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM
from lunarsci.spectra.mgm.assemblages import MINERALS
from lunarsci.spectra.mgm.batch import FitBatch, batch_of
from lunarsci.spectra.mgm.compositions import compositions_of
from lunarsci.spectra.mgm.data import MgmRows, SpectraRows
from lunarsci.spectra.mgm.fits import SpectraFits
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.mgm.model import NM_PER_UM
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.tables import table_rows

PYROXENES = ("orthopyroxene", "clinopyroxene")
DEFAULT_LINE = "opx-cpx"
TABLE, LIKENESS = "nbsr_calibrations.csv", "nbsr_likeness.csv"
NORMAL_95 = 1.96
SEEN_SIGMAS, APART_SIGMAS = 3.0, 2.0
"""Standard errors from which another mineral absorbs, and a composition lies outside; assumed."""
UNLIKE_SIGMAS = 2.5
"""Scatter of the line's own powders by which bands may differ from theirs; measured: 16 of 20 of these, each left out
of what it is compared with, are within in every number."""
DEPTH_MARGIN = 1.25
"""Factor by which the 1 um band may be shallower or deeper than in any of the line's powders; assumed."""
OTHER_MINERALS = {*MINERALS.values()} - {*PYROXENES}
GRID_NM = np.arange(750.0, 2451.0, 5.0)
RANGES_NM = {"um1": (850.0, 1150.0), "um2": (1600.0, 2450.0)}
"""Where the deepest absorption of a region is looked for; assumed."""
NAMES = {
    "um1_centroid_nm": "centroid at 1 um",
    "um2_centroid_nm": "centroid at 2 um",
    "um1_left_nm": "short edge of the 1 um band",
    "um1_right_nm": "long edge of the 1 um band",
    "um2_left_nm": "short edge of the 2 um band",
    "ln_depth_ratio": "ln of the depth at 2 um over that at 1 um",
    "share_1200": "depth at 1200 nm over that at 1 um",
    "share_1450": "depth at 1450 nm over that at 1 um",
}


def calibrations() -> tuple[str, ...]:
    """Names of the lines that are known."""
    return tuple(dict.fromkeys(row["name"] for row in table_rows(TABLE)))


@dataclass(frozen=True, slots=True, eq=False)
class PyroxeneShares:
    """Orthopyroxene and clinopyroxene as shares by weight of all pyroxene, of n fits.

    Attributes
    ----------
    told : (n,) whether there is a ratio of which shares could be made.
    in_domain : (n,) whether the line's powders are a measure for it.
    shares : (n, 2) of orthopyroxene and clinopyroxene; NaN where they are not determined. [-]
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
        inside = bool(self.in_domain[row])
        return Abundance(name, "nbsr", fractions, inside, self.statuses[row], rms_ln if inside else None)


def pyroxene_shares(batch: FitBatch, rows: MgmRows | SpectraRows, calibration: str = DEFAULT_LINE) -> PyroxeneShares:
    """Shares of the pyroxenes of fits `batch` of the spectra `rows`; none where the ratio is not determined.

    The line is OPX = slope * NBSR + offset, one for each assemblage it was made with; its scatter and the error of the
    ratio add in quadrature, and shares are kept within 0 and 1. A line belongs to the powders it was made on, and
    elsewhere errs by tens of per cent: shares are not determined, and `in_domain` is false, where

    - assemblage or continuum are not those of the line,
    - the minerals' bands together (`band_features`) are not those of the line's powders at this ratio and depth,
    - the 1 um band is shallower or deeper than in any of them: dark rocks, weathered soils,
    - the spectrum is of another kind of target than mixed powders (`find_kind`),
    - the compositions that the centres tell are not theirs, or olivine or plagioclase absorb as well.

    Fits with bands of a start file have none: no line was made with such.

    Raises ParameterError for an unknown calibration.

    References
    ----------
    Sunshine & Pieters (1993), J. Geophys. Res. 98, 9075, 10.1029/93JE00677; Kanner, Mustard & Gendrin (2007), Icarus
    187, 442, 10.1016/j.icarus.2006.10.025 (ratio).
    """
    if calibration not in calibrations():
        raise ParameterError(f"calibration '{calibration}'; give one of {', '.join(calibrations())}")
    line = _line_of(batch, calibration)
    (ratio, sigma), told = _ratio_of(batch, line)
    reasons = _reasons(batch, rows, ratio, told, line)
    inside = told & np.array([not found for found in reasons], dtype=bool)
    slope, offset, scatter = (float(line[key]) / 100 for key in ("slope_percent", "offset_percent", "sd_percent"))
    opx = np.where(inside, np.clip(slope * ratio + offset, 0.0, 1.0), np.nan)
    error = np.hypot(slope * sigma, scatter)
    shares = np.column_stack([opx, 1.0 - opx])
    ends = np.clip(shares[:, :, None] + error[:, None, None] * np.array([-1.0, 1.0, -NORMAL_95, NORMAL_95]), 0.0, 1.0)
    ends[~inside] = [0.0, 1.0, 0.0, 1.0]
    why = f"not determined: the powders of the calibration {calibration} are unlike it: "
    statuses = [why + "; ".join(found) if found else f"calibration {calibration}, by weight" for found in reasons]
    return PyroxeneShares(told, inside, shares, ends, statuses)


def _line_of(batch: FitBatch, calibration: str) -> Mapping[str, str]:
    lines = [line for line in table_rows(TABLE) if line["name"] == calibration]
    return next((line for line in lines if line["assemblage"] == batch.model.assemblage.name), lines[0])


def _ratio_of(batch: FitBatch, line: Mapping[str, str]) -> tuple[FloatArray, BoolArray]:
    """The ratio of a line with its error, (2, n), and whether there is one of which shares could be made."""
    numbers: FloatArray = (batch.um1 if line["region"] == "um1" else batch.um2)[:, [0, 2]].T
    return numbers, np.isfinite(numbers[0]) & (not batch.model.whole)


def nbsr_abundance(fit: MgmFit, calibration: str = DEFAULT_LINE) -> Abundance | None:
    """`pyroxene_shares` of one fit; None where the ratio is not determined, and of fits by damping."""
    found = pyroxene_shares(batch_of(fit), MgmRows.together([fit.data]), calibration)
    return None if fit.prior == "damping" else found.abundance(0, fit.id, fit.rms_ln)


class PyroxeneAbundances(Mapping[int, list[Abundance]]):
    """`nbsr_abundance` of the fits that converged, by position: one, or none where the ratio is not determined."""

    def __init__(self, fits: SpectraFits) -> None:
        self._fits, self._names, self._rms = fits, fits.names, fits.gathered(lambda batch: batch.rms_ln)
        self._converged = fits.gathered(lambda batch: batch.converged) > 0

    @property
    def any_told(self) -> bool:
        """Whether of any of them shares could be made."""
        found = self._fits.gathered(lambda batch: _ratio_of(batch, _line_of(batch, DEFAULT_LINE))[1])
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
        from lunarsci.spectra.library.end_member import CHEMISTRY

        own, keys = self.shares, ("low", "high", "low95", "high95")
        one: dict[str, Column] = {
            "method": "nbsr",
            "in_domain": own.in_domain,
            "not_weighed": Same([mineral for mineral in CHEMISTRY if mineral not in PYROXENES]),
            "status": own.statuses,
            "rms_ln": np.where(own.in_domain, self._rms, np.nan),
            "learned": None,
            "ratios": Same({}),
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
            columns[f"nbsr_{mineral}_low"] = Where(own.told, own.ends[:, k, 0])
            columns[f"nbsr_{mineral}_high"] = Where(own.told, own.ends[:, k, 1])
        return columns


def nbsr_abundances(fits: Sequence[MgmFit | MgmFailure]) -> Mapping[int, Sequence[Abundance]]:
    """`nbsr_abundance` of those that converged, by position: one, or none where the ratio is not determined."""
    if isinstance(fits, SpectraFits):
        return PyroxeneAbundances(fits)
    settled = {index: fit for index, fit in enumerate(fits) if isinstance(fit, MgmFit) and fit.converged}
    return {index: [one] if (one := nbsr_abundance(fit)) else [] for index, fit in settled.items()}


def _reasons(
    batch: FitBatch, rows: MgmRows | SpectraRows, ratio: FloatArray, told: BoolArray, line: Mapping[str, str]
) -> list[list[str]]:
    """Why the line is no measure for a fit; nothing where it is, and where there is no ratio."""
    if batch.model.assemblage.name != line["assemblage"] or batch.model.continuum != DEFAULT_CONTINUUM:
        made = ", ".join(one["assemblage"] for one in table_rows(TABLE) if one["name"] == line["name"])
        return [[f"made with {made} under continuum {DEFAULT_CONTINUUM}"] if one else [] for one in told.tolist()]
    found: list[list[str]] = [[] for _ in told]
    own = np.flatnonzero(told)
    if not own.size:
        return found
    part = batch.part(own)
    kinds = dark_or_weathered(*features_of_rows(*rows.seen(own)))
    texts = (
        ["it looks dark or weathered, no mixture of powders" if other else "" for other in kinds.tolist()],
        _unlike(part, ratio[own], line),
        *_other_compositions(part, line),
        *_other_minerals(part),
    )
    for row, reasons in zip(own.tolist(), zip(*texts, strict=True), strict=True):
        found[row] = [reason for reason in reasons if reason]
    return found


def _other_compositions(batch: FitBatch, line: Mapping[str, str]) -> Iterator[list[str]]:
    for column in compositions_of(batch):
        key = column.prior.key
        low, high = line.get(f"{key}_low", ""), line.get(f"{key}_high", "")
        if low:
            reach = APART_SIGMAS * column.sigma
            outside = (column.mean < float(low) - reach) | (column.mean > float(high) + reach)
            numbers = zip(column.mean.tolist(), column.sigma.tolist(), outside.tolist(), strict=True)
            yield [
                f"{key} {mean:.0f} +- {sigma:.0f} mol % (calibrated for {low} to {high})" if apart else ""
                for mean, sigma, apart in numbers
            ]


def _other_minerals(batch: FitBatch) -> Iterator[list[str]]:
    bands, m = batch.model.assemblage.bands, batch.model.degrees
    seen = np.asarray(batch.values[:, m + 2 :: 3] < -SEEN_SIGMAS * batch.sigma[:, m + 2 :: 3])
    for mineral in sorted({band.mineral for band in bands} & OTHER_MINERALS):
        own = [band.mineral == mineral for band in bands]
        absorbs: list[bool] = np.any(seen[:, own], axis=1).tolist()
        yield [f"{mineral} absorbs as well" if one else "" for one in absorbs]


def _unlike(batch: FitBatch, ratio: FloatArray, line: Mapping[str, str]) -> list[str]:
    """What tells the bands from those of the line's powders, the worst of it; '' where nothing does."""
    features = features_of_bands(batch)
    depth, ends = features["um1_depth"], (line["depth_low"], line["depth_high"])
    deep = (float(ends[0]) / DEPTH_MARGIN <= depth) & (depth <= float(ends[1]) * DEPTH_MARGIN)
    key = (line["name"], line["assemblage"])
    laws = [law for law in table_rows(LIKENESS) if (law["name"], law["assemblage"]) == key]
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = likeness_terms(ratio, depth)
    off = np.empty((len(laws), len(batch)))
    for k, law in enumerate(laws):
        mean = sum(terms[:, n] * float(law[f"c{n}"]) for n in range(terms.shape[1]))
        off[k] = np.abs((features[law["feature"]] - mean) / float(law["sd"]))
    worst = np.where(np.isnan(off), np.inf, off).argmax(axis=0)
    farthest = np.take_along_axis(off, worst[None], axis=0)[0]
    texts = []
    for how, far, apart, inside in zip(worst.tolist(), farthest.tolist(), depth.tolist(), deep.tolist(), strict=True):
        if not inside:
            calibrated = " to ".join(f"{float(end):.2g}" for end in ends)
            texts.append(f"its 1 um band is {apart:.2f} deep in ln R (calibrated for {calibrated})")
        elif far <= UNLIKE_SIGMAS:
            texts.append("")
        else:
            name = NAMES[laws[how]["feature"]]
            away = f"is {far:.0f} times the powders' scatter away" if np.isfinite(far) else "could not be measured"
            texts.append(f"other pyroxenes: {name} {away}")
    return texts


def likeness_terms(ratio: FloatArray, depth: FloatArray) -> FloatArray:
    """(n, 5) terms 1, NBSR, NBSR^2, NBSR^3 and ln depth, in which the powders' features are linear. [-]"""
    return np.column_stack([ratio**0, ratio, ratio**2, ratio**3, np.log(depth)])


def band_features(fit: MgmFit) -> dict[str, float]:
    """`features_of_bands` of one fit."""
    return {name: float(values[0]) for name, values in features_of_bands(batch_of(fit)).items()}


def features_of_bands(batch: FitBatch) -> dict[str, FloatArray]:
    """Of all bands of minerals together, (n,), which is known better than any one band: depths, centroids, edges.

    Keys are those of `NAMES` and `um1_depth`, in nm, ln R or ratios. A band's edges are where it falls to half its
    depth, its centroid is of what is deeper; NaN where it does not fall so far.
    """
    curve = _absorption(batch)
    one, two = (_region(curve, *ends) for ends in RANGES_NM.values())
    at_1200, at_1450 = (curve[:, int(np.flatnonzero(place == GRID_NM)[0])] for place in (1200.0, 1450.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            "um1_depth": one[0],
            "um1_centroid_nm": one[1],
            "um2_centroid_nm": two[1],
            "um1_left_nm": one[2],
            "um1_right_nm": one[3],
            "um2_left_nm": two[2],
            "ln_depth_ratio": np.log(two[0] / one[0]),
            "share_1200": at_1200 / one[0],
            "share_1450": at_1450 / one[0],
        }


def _absorption(batch: FitBatch) -> FloatArray:
    """Bands of minerals together on `GRID_NM`, (n, grid), in -ln R."""
    curve, m = np.zeros((len(batch), GRID_NM.size)), batch.model.degrees
    for k, band in enumerate(batch.model.assemblage.bands):
        if band.mineral != "any":
            centre, fwhm, strength = batch.values[:, m + 3 * k : m + 3 * k + 3].T[:, :, None]
            x = (GRID_NM - centre * NM_PER_UM) * FWHM_OVER_SIGMA / (fwhm * NM_PER_UM)
            curve -= strength * np.exp(-0.5 * x**2)
    return curve


def _region(curve: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Depth, centroid, and both edges at half depth of the deepest absorption between `low` and `high`, (n,) each."""
    inside, places = np.flatnonzero((low <= GRID_NM) & (high >= GRID_NM)), np.arange(GRID_NM.size)
    lowest = inside[curve[:, inside].argmax(axis=1)]
    depth = np.take_along_axis(curve, lowest[:, None], axis=1)
    shallow = curve < depth / 2
    before = np.where(shallow & (places < lowest[:, None]), places, -1).max(axis=1)
    after = np.where(shallow & (places > lowest[:, None]), places, GRID_NM.size).min(axis=1)
    between = (places >= before[:, None]) & (places <= after[:, None])
    weight = np.where(between, np.maximum(curve - depth / 2, 0.0), 0.0)
    total = weight.sum(axis=1)
    left = np.where(before >= 0, GRID_NM[before], np.nan)
    right = np.where(after < GRID_NM.size, GRID_NM[np.minimum(after, GRID_NM.size - 1)], np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return depth[:, 0], (weight * GRID_NM).sum(axis=1) / total, left, right
