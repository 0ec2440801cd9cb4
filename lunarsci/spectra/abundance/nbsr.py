"""Modes from the normalised band strength ratio of the pyroxenes, by lines made on mixtures of known modes."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.kinds import find_kind
from lunarsci.spectra.abundance.result import Abundance, MineralFraction, refused
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM
from lunarsci.spectra.mgm.assemblages import MINERALS
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit, MineralComposition, StrengthRatio, compositions
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.tables import table_rows

TABLE, LIKENESS = "nbsr_calibrations.csv", "nbsr_likeness.csv"
NORMAL_95 = 1.96
SEEN_SIGMAS, APART_SIGMAS = 3.0, 2.0
"""Standard errors from which another mineral absorbs, and a composition lies outside; assumed."""
UNLIKE_SIGMAS = 2.5
"""Scatter of the line's own powders by which bands may differ from theirs; 16 of 20 of these, each left out of what it
is compared with, are within in every number."""
DEPTH_MARGIN = 1.25
"""Factor by which the 1 um band may be shallower or deeper than in any of the line's powders; assumed."""
OTHER_MINERALS = {*MINERALS.values()} - {"orthopyroxene", "clinopyroxene"}
GRID_NM = np.arange(750.0, 2451.0, 5.0)
RANGES_NM = {"um1": (850.0, 1150.0), "um2": (1600.0, 2450.0)}
"""Where the deepest absorption of a region is looked for."""
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


def nbsr_abundance(fit: MgmFit, calibration: str = "opx-cpx") -> Abundance | None:
    """Orthopyroxene and clinopyroxene as shares by weight of all pyroxene; None where the ratio is not determined.

    The line is OPX = slope * NBSR + offset, one for each assemblage it was made with; its scatter and the error of the
    ratio add in quadrature, and shares are kept within 0 and 1. A line belongs to the powders it was made on, and
    elsewhere errs by tens of per cent: shares are not determined, and `in_domain` is false, where

    - assemblage or continuum are not those of the line,
    - the minerals' bands together (`band_features`) are not those of the line's powders at this ratio and depth,
    - the 1 um band is shallower or deeper than in any of them: dark rocks, weathered soils,
    - the spectrum is of another kind of target than mixed powders (`find_kind`),
    - the compositions that the centres tell are not theirs, or olivine or plagioclase absorb as well.

    Fits with bands of a start file, or by damping, have none: no line was made with such.

    Raises ParameterError for an unknown calibration.

    References
    ----------
    Sunshine & Pieters (1993), J. Geophys. Res. 98, 9075, 10.1029/93JE00677; Kanner, Mustard & Gendrin (2007), Icarus
    187, 442, 10.1016/j.icarus.2006.10.025 (ratio).
    """
    if calibration not in calibrations():
        raise ParameterError(f"calibration '{calibration}'; give one of {', '.join(calibrations())}")
    own = [row for row in table_rows(TABLE) if row["name"] == calibration]
    row = next((row for row in own if row["assemblage"] == fit.assemblage), own[0])
    ratio = fit.nbsr.get(row["region"])
    if ratio is None or fit.prior == "damping" or fit.model.whole:
        return None
    if reasons := _reasons(fit, ratio, row):
        why = f"the powders of line {calibration} are no measure for it: {'; '.join(reasons)}"
        return refused(fit.id, "nbsr", ("orthopyroxene", "clinopyroxene"), why)
    slope, offset, scatter = (float(row[key]) / 100 for key in ("slope_percent", "offset_percent", "sd_percent"))
    share = float(np.clip(slope * ratio.opx + offset, 0.0, 1.0))
    sigma = float(np.hypot(slope * ratio.sigma, scatter))
    fractions = (_share("orthopyroxene", share, sigma), _share("clinopyroxene", 1.0 - share, sigma))
    correlation = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Abundance(fit.id, "nbsr", fractions, correlation, True, f"line {calibration}, by weight", fit.rms_ln)


def nbsr_abundances(fits: Sequence[MgmFit | MgmFailure]) -> dict[int, list[Abundance]]:
    """`nbsr_abundance` of those that converged, by position: one, or none where the ratio is not determined."""
    settled = {index: fit for index, fit in enumerate(fits) if isinstance(fit, MgmFit) and fit.converged}
    return {index: [one] if (one := nbsr_abundance(fit)) else [] for index, fit in settled.items()}


def _share(mineral: str, share: float, sigma: float) -> MineralFraction:
    ends = [float(np.clip(share + z * sigma, 0.0, 1.0)) for z in (-1.0, 1.0, -NORMAL_95, NORMAL_95)]
    return MineralFraction(mineral, share, *ends)


def _reasons(fit: MgmFit, ratio: StrengthRatio, row: Mapping[str, str]) -> list[str]:
    if fit.assemblage != row["assemblage"] or fit.continuum != DEFAULT_CONTINUUM:
        made = ", ".join(one["assemblage"] for one in table_rows(TABLE) if one["name"] == row["name"])
        return [f"made with {made} under continuum {DEFAULT_CONTINUUM}"]
    reasons = _other_kind(fit) + _unlike(fit, ratio, row)
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


def _other_kind(fit: MgmFit) -> list[str]:
    verdict = find_kind(Spectrum(fit.id, fit.wavelength_nm, fit.reflectance))
    if verdict.is_weathered or verdict.kind in ("dark-rock-powder", "weathered-soil", "solid-rock"):
        return ["it is no mixture of powders, but dark or weathered"]
    return []


def _outside(item: MineralComposition, low: float, high: float) -> bool:
    if item.mean is None or item.sigma is None:
        return False
    return item.mean < low - APART_SIGMAS * item.sigma or item.mean > high + APART_SIGMAS * item.sigma


def _unlike(fit: MgmFit, ratio: StrengthRatio, row: Mapping[str, str]) -> list[str]:
    """What tells its bands from those of the line's powders, the worst of it."""
    features = band_features(fit)
    depth, margin = features["um1_depth"], DEPTH_MARGIN
    if not float(row["depth_low"]) / margin <= depth <= float(row["depth_high"]) * margin:
        return [f"its 1 um band is {depth:.2f} deep in ln R, made at {row['depth_low']}-{row['depth_high']}"]
    expected = likeness_terms(np.array([ratio.opx]), np.array([depth]))[0]
    off: dict[str, float] = {}
    for line in table_rows(LIKENESS):
        if (line["name"], line["assemblage"]) == (row["name"], row["assemblage"]):
            mean = float(expected @ [float(line[f"c{k}"]) for k in range(expected.size)])
            off[line["feature"]] = (features[line["feature"]] - mean) / float(line["sd"])
    worst = max(off, key=lambda name: math.inf if math.isnan(off[name]) else abs(off[name]))
    if abs(off[worst]) <= UNLIKE_SIGMAS:
        return []
    return [f"other pyroxenes: {NAMES[worst]} is {abs(off[worst]):.0f} times the powders' scatter away"]


def likeness_terms(ratio: FloatArray, depth: FloatArray) -> FloatArray:
    """(n, 5) terms 1, NBSR, NBSR^2, NBSR^3 and ln depth, in which the powders' features are linear. [-]"""
    return np.column_stack([ratio**0, ratio, ratio**2, ratio**3, np.log(depth)])


def band_features(fit: MgmFit) -> dict[str, float]:
    """Of all bands of minerals together, which is known better than any one band: depths, centroids, edges.

    Keys are those of `NAMES` and `um1_depth`, in nm, ln R or ratios. A band's edges are where it falls to half its
    depth, its centroid is of what is deeper; NaN where it does not fall so far.
    """
    curve = -np.sum([band.curve(GRID_NM) for band in fit.bands if band.mineral != "any"], axis=0)
    one, two = (_region(curve, *ends) for ends in RANGES_NM.values())
    at = np.interp([1200.0, 1450.0], GRID_NM, curve)
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            "um1_depth": one[0],
            "um1_centroid_nm": one[1],
            "um2_centroid_nm": two[1],
            "um1_left_nm": one[2],
            "um1_right_nm": one[3],
            "um2_left_nm": two[2],
            "ln_depth_ratio": float(np.log(np.divide(two[0], one[0]))),
            "share_1200": float(np.divide(at[0], one[0])),
            "share_1450": float(np.divide(at[1], one[0])),
        }


def _region(curve: FloatArray, low: float, high: float) -> tuple[float, float, float, float]:
    """Depth, centroid, and both edges at half depth of the deepest absorption between `low` and `high`."""
    inside = np.flatnonzero((low <= GRID_NM) & (high >= GRID_NM))
    lowest = inside[np.argmax(curve[inside])]
    shallow = np.flatnonzero(curve < curve[lowest] / 2)
    before, after = shallow[shallow < lowest], shallow[shallow > lowest]
    left = GRID_NM[before[-1]] if before.size else np.nan
    right = GRID_NM[after[0]] if after.size else np.nan
    part = slice(before[-1] if before.size else 0, after[0] + 1 if after.size else None)
    weight = np.maximum(curve[part] - curve[lowest] / 2, 0.0)
    total = float(weight.sum())
    centroid = float(weight @ GRID_NM[part] / total) if total > 0 else math.nan
    return float(curve[lowest]), centroid, float(left), float(right)
