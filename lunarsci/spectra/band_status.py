"""The 1 um and 2 um bands, what is measured of each, and what may be said where there is none."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Band:
    """Where an absorption band lies.

    Attributes
    ----------
    window_nm, centre_nm, reach_nm : its window, where its centre may lie, what a spectrum must reach. [nm]
    others : what else absorbs nearby.
    bias : standard deviation of the bias of a minimum in the wide window, in half widths of that. [-]
    """

    key: str
    window_nm: tuple[float, float]
    centre_nm: tuple[float, float]
    reach_nm: tuple[float, float]
    others: str
    bias: float


BANDS = (
    Band(
        "1000", (700.0, 1580.0), (870.0, 1200.0), (850.0, 1200.0),
        "iron oxides have theirs below 870, feldspar at 1250, water at 1400 nm", 0.02,
    ),
    Band("2000", (1580.0, 2500.0), (1700.0, 2400.0), (1750.0, 2150.0), "hydroxyl has its beyond 2200 nm", 0.04),
)  # fmt: skip
"""The windows meet at the 1580 nm tie of the paper's continuum. Centres are those that mafic silicates have, with a
margin: pyroxenes 900-1060 and 1800-2380 nm (Adams 1974, 10.1029/JB079i032p04829; Cloutis & Gaffey 1991,
10.1029/91JE02512, whose type A has a second minimum near 1150 nm), olivines 1040-1090 nm (King & Ridley 1987,
10.1029/JB092iB11p11457). Water and hydroxyl absorb at 1400 nm (Hunt 1977, 10.1190/1.1440721), feldspar at 1250 nm
(Adams & Goullaud 1978, Proc. Lunar Planet. Sci. Conf. 9, 2901). Biases are those measured on every second of 409
laboratory spectra of minerals, mixtures and meteorites: 68 and 90 % of the minima are off by less than 0.016 and 0.038
at 1 um, 0.037 and 0.069 at 2 um.
"""
MIN_SIGNIFICANCE = 4.5
"""Depth over its standard error below which there is no band. Measured: the deepest of many channels of pure noise
exceeds 3 in a quarter and 4.5 in 0.4 % of the windows of 400 simulated flat spectra."""
END_CHANNELS, RUNAWAY_SHARE = 8, 0.5
"""An extrapolated continuum that is this share of the band's depth above the last channels is not used; assumed. On 172
laboratory and 88 rover spectra it parts the centres that agree with the hull's from those that do not.
"""
MAX_CENTER_SIGMA_NM = 100.0
"""A centre known no better than this says nothing about a mineral; it is not reported. Assumed."""
CROSSING_SHARE = 0.25
"""A continuum may run below the smoothed spectrum by this share of the band's depth, no more; assumed."""

STATUSES = (
    "ok",
    "continuum_falls_to_zero",
    "continuum_below_spectrum",
    "continuum_runs_away",
    "too_few_deep_channels",
    "deepest_elsewhere",
    "no_minimum",
    "depth_within_noise",
    "center_uncertain",
    "too_few_channels_in_window",
    "window_not_covered",
    "no_tie_points",
    "spectrum_unusable",
)
"""Why there is no band, or why the wanted continuum was not used: names of the codes from 0."""
(
    OK, FALLS, BELOW, AWAY, FEW, ELSEWHERE, NO_MINIMUM, SHALLOW, UNCERTAIN, SPARSE, NOT_COVERED, NO_TIES, UNUSABLE
) = range(len(STATUSES))  # fmt: skip

QUANTITIES = (
    "center_nm", "center_sigma_nm", "center_systematic_nm", "center_method_nm", "depth", "depth_sigma", "area_nm",
    "area_sigma_nm", "asymmetry", "asymmetry_sigma", "center_calibration_nm", "depth_calibration",
    "area_calibration_nm", "deepest_nm", "note_deepest_nm",
)  # fmt: skip
(
    CENTER, CENTER_SIGMA, SYSTEMATIC, METHOD, DEPTH, DEPTH_SIGMA, AREA_NM, AREA_SIGMA, ASYMMETRY_SHARE,
    ASYMMETRY_SIGMA, CENTER_CALIBRATION, DEPTH_CALIBRATION, AREA_CALIBRATION, DEEPEST, NOTE_DEEPEST
) = range(len(QUANTITIES))  # fmt: skip
Codes = npt.NDArray[np.int8]
CODES = ("continuum", "status", "note")
CONTINUUM, STATUS, NOTE = range(len(CODES))


JSON_KEYS = {
    "center_nm": "bc{}_nm",
    "center_sigma_nm": "bc{}_sigma_nm",
    "center_systematic_nm": "bc{}_systematic_nm",
    "center_method_nm": "bc{}_method_nm",
    "depth": "bd{}",
    "depth_sigma": "bd{}_sigma",
    "area_nm": "ba{}_nm",
    "area_sigma_nm": "ba{}_sigma_nm",
    "asymmetry": "bas{}",
    "asymmetry_sigma": "bas{}_sigma",
    "center_calibration_nm": "bc{}_calibration_nm",
    "depth_calibration": "bd{}_calibration",
    "area_calibration_nm": "ba{}_calibration_nm",
}
"""Key of each number in JSON, in which {} is the band's."""
SENTENCES = {
    "ok": "ok",
    "continuum_falls_to_zero": "its continuum falls to zero in the window",
    "continuum_below_spectrum": "its continuum runs below the spectrum in the window",
    "continuum_runs_away": "its continuum runs away above the spectrum in the window",
    "too_few_deep_channels": "no band: too few channels as deep as its deepest",
    "deepest_elsewhere": "no band: deepest at {deepest:.0f} nm; "
    "olivine and pyroxene have theirs at {low:g}-{high:g} nm ({others})",
    "no_minimum": "no band: no minimum within the deepest channels",
    "depth_within_noise": f"no band: its depth is within {MIN_SIGNIFICANCE:g} sigma of 0",
    "center_uncertain": f"no result: its centre is known no better than ± {MAX_CENTER_SIGMA_NM:g} nm",
    "too_few_channels_in_window": "no result: too few usable channels in its window",
    "window_not_covered": "no result: the spectrum covers {first:g}-{last:g} nm of it",
    "no_tie_points": "the spectrum does not reach its tie points",
    "spectrum_unusable": "no result: too few usable channels",
}
"""What the codes of `STATUSES` say."""


def sentence(code: int, band: Band, deepest_nm: float, wavelength_nm: FloatArray) -> str:
    """What a code says of a band of a spectrum with these usable channels (n,), deepest there. [nm, nm]"""
    low, high = band.window_nm
    inside = (
        wavelength_nm[(wavelength_nm >= low) & (wavelength_nm <= high)] if code == NOT_COVERED else wavelength_nm[:0]
    )
    first, last = (inside[0], inside[-1]) if inside.size else (np.nan, np.nan)
    return SENTENCES[STATUSES[code]].format(
        deepest=deepest_nm, low=band.centre_nm[0], high=band.centre_nm[1], others=band.others, first=first, last=last
    )
