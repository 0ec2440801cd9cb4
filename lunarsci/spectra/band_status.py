"""The 1 um and 2 um bands, what is measured of each, and the sentences about those that are not there.

Numbers and codes of both bands of many spectra are arrays (`BandArrays`); `NUMBER` and `CODE` name their places,
`STATUS` the codes.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.spectra.band_shape import BandGrid
from lunarsci.spectra.continuum import CONTINUA, HULL, LINEAR
from lunarsci.spectra.spectrum import reaches_over, wide_gap


@dataclass(frozen=True, slots=True)
class Band:
    """Where an absorption band lies.

    Attributes
    ----------
    window_nm, center_range_nm, reach_nm : its window, where its centre may lie, what a spectrum must reach. [nm]
    key : of its names in JSON, such as `bc1000_nm`.
    others : what else absorbs nearby.
    bias : standard deviation of the bias of a minimum in the wide window, in half widths of that. [-]
    least : least standard error of a centre, times the relative error of the depth and the standard width (area over
        depth of a Gaussian): a dip that noise makes is sharp, and its curvature alone promises too much. [-]
    """

    key: str
    window_nm: tuple[float, float]
    center_range_nm: tuple[float, float]
    reach_nm: tuple[float, float]
    others: str
    bias: float
    least: float


BANDS = (
    Band(
        "1000", (700.0, 1580.0), (870.0, 1200.0), (850.0, 1200.0),
        "iron oxides have theirs below 870, feldspar at 1250, water at 1400 nm", 0.02, 2.0,
    ),
    Band("2000", (1580.0, 2500.0), (1700.0, 2400.0), (1750.0, 2150.0), "hydroxyl has its beyond 2200 nm", 0.04, 1.5),
)  # fmt: skip
"""The windows meet at the 1580 nm tie of the paper's continuum. Centres are those that mafic silicates have, with a
margin: pyroxenes 900-1060 and 1800-2380 nm (Adams 1974, 10.1029/JB079i032p04829; Cloutis & Gaffey 1991,
10.1029/91JE02512, whose type A has a second minimum near 1150 nm), olivines 1040-1090 nm (King & Ridley 1987,
10.1029/JB092iB11p11457). Water and hydroxyl absorb at 1400 nm (Hunt 1977, 10.1190/1.1440721), feldspar at 1250 nm
(Adams & Goullaud 1978, Proc. Lunar Planet. Sci. Conf. 9, 2901). Biases are those measured on every second of 409
laboratory spectra of minerals, mixtures and meteorites: 68 and 90 % of the minima are off by less than 0.016 and 0.038
at 1 um, 0.037 and 0.069 at 2 um. Least errors were chosen on the smoothed spectra of every second target of Chang'E-4
with their own noise, 100 draws each, and measured on the other 44 (seen before the choice at 2 um): at 1 um 68 %
intervals hold 72 % of the centres (66 without), 95 % ones 94 (91), those of the smallest tenth of the errors 66 and 93
(57 and 83); at 2 um 72 and 92 (63 and 86), of the smallest tenth 58 and 80 (32 and 59):
`tests/benchmarks/bench_bands.py --rover`. At 2 um 2 would be twice the scatter of clean bands, so it stays 1.5.
"""
MIN_SIGNIFICANCE = 4.5
"""Depth over its standard error below which there is no band. Measured: the deepest of many channels of pure noise
exceeds 3 in a quarter and 4.5 in 0.4 % of the windows of 400 simulated flat spectra."""
END_CHANNELS, RUNAWAY_SHARE = 8, 0.5
"""An extrapolated continuum that is this share of the band's depth above the last channels is not used; assumed: on
172 laboratory and 88 rover spectra it parts the centres that agree with the hull's from those that do not."""
MAX_CENTER_SIGMA_NM = 100.0
"""A centre known no better than this says nothing about a mineral; it is not reported. Assumed."""
DEPENDS_NM, DEPENDS_SIGMA = 20.0, 3.0
"""A centre depends on the method where methods differ by more than both: so many nm, and so many standard errors;
assumed."""
CROSSING_SHARE = 0.25
"""A continuum may run below the smoothed spectrum by this share of the band's depth, no more; assumed."""
WIDTHS_NM = ((1900.0, 570.0), (2200.0, 690.0))
"""Centres of 2 um bands and their widths at half depth: those of OPX 2 and CPX 2 in `mgm_bands.csv`; widths between
are interpolated. [nm]"""


def short_by(center_nm: FloatArray, last_nm: float) -> FloatArray:
    """By how much centres of 2 um bands may be short, as the bands go on beyond the last channel. [nm]

    A continuum through that channel lies below the true one there by what a Gaussian band of the usual width absorbs,
    and its slope moves the minimum by that over the curvature of the band. Laboratory spectra that go on to 2450 nm,
    cut at 2350 nm: of 55 centres beyond 2150 nm these errors hold 85 and 95 % within one and two (15 and 42 % without),
    of 254 below 2000 nm 98 and 100 % (74 and 86): `tests/benchmarks/bench_bands.py FOLDER --cut`.
    """
    centre, off = np.asarray(center_nm, float), np.zeros(np.shape(center_nm))
    first = BANDS[1].window_nm[0]
    for _ in range(3):
        width = np.interp(centre + off, *np.array(WIDTHS_NM).T)
        beyond = np.maximum(last_nm - centre - off, 0.0) / width
        off = np.exp(-4.0 * math.log(2.0) * beyond**2) * width**2 / (8.0 * math.log(2.0) * (last_nm - first))
    return off


WATER_MOST_NM = 2100.0
"""Longest wavelength of the absorption of water near 1900 nm, with a margin (Hunt 1977, 10.1190/1.1440721). [nm]"""
DEPENDS = "centre depends on the method"
"""What the status says of a band whose centre does (`depends_on_method`)."""


class Statuses(NamedTuple):
    """Codes that say why there is no band, or why the wanted continuum was not used."""

    ok: int = 0
    continuum_falls_to_zero: int = 1
    continuum_below_spectrum: int = 2
    continuum_runs_away: int = 3
    too_few_deep_channels: int = 4
    deepest_elsewhere: int = 5
    no_minimum: int = 6
    depth_within_noise: int = 7
    center_uncertain: int = 8
    too_few_channels_in_window: int = 9
    window_not_covered: int = 10
    no_tie_points: int = 11
    spectrum_unusable: int = 12
    too_narrow: int = 13


class Numbers(NamedTuple):
    """Places of the numbers of a band: those of a `BandResult`, and those that sentences on it need (`BandColumns`)."""

    center_nm: int = 0
    center_sigma_nm: int = 1
    center_systematic_nm: int = 2
    center_gaussian_nm: int = 3
    center_method_nm: int = 4
    depth: int = 5
    depth_sigma: int = 6
    area_nm: int = 7
    area_sigma_nm: int = 8
    asymmetry: int = 9
    asymmetry_sigma: int = 10
    center_calibration_nm: int = 11
    depth_calibration: int = 12
    area_calibration_nm: int = 13
    deepest_nm: int = 14
    note_deepest_nm: int = 15
    narrow_nm: int = 16
    narrow_width_nm: int = 17


class CodeRows(NamedTuple):
    """Places of the codes of a band; `BandColumns` says what they are."""

    continuum: int = 0
    status: int = 1
    note: int = 2


STATUS, NUMBER, CODE = Statuses(), Numbers(), CodeRows()
STATUSES, QUANTITIES, CODES = Statuses._fields, Numbers._fields, CodeRows._fields
"""Names of codes of a status, of numbers and of codes, in their order."""
NO_BAND = (STATUS.too_few_deep_channels, STATUS.deepest_elsewhere, STATUS.no_minimum, STATUS.depth_within_noise)
"""Codes that say that there is none."""
ABSENT_NM = 2300.0
"""A spectrum that ends before this does not show that there is no band at 2 um: assumed, as clinopyroxenes have minima
up to 2380 nm (Cloutis & Gaffey 1991, 10.1029/91JE02512) and bands far wider than what would be missing. [nm]"""
Codes = npt.NDArray[np.int8]
"""Places in `STATUSES`, or in `CONTINUA`."""
JSON_KEYS = {
    "center_nm": "bc{}_nm",
    "center_sigma_nm": "bc{}_sigma_nm",
    "center_systematic_nm": "bc{}_systematic_nm",
    "center_gaussian_nm": "bc{}_gaussian_nm",
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
    "too_narrow": "no band of a pyroxene",
}
"""What the codes of `STATUSES` say."""


FEWEST_IN_WINDOW = 14
"""Usable channels in a band's window below which it is not measured; assumed."""


class Places(NamedTuple):
    """Where the bands lie among the channels.

    Attributes
    ----------
    bands : of each, its first channel and the one behind its last, and the same of where its deepest may lie, (2, 4).
    limits_nm, bias, least : where its centre may lie, (2, 2); see `Band`, (2,), (2,). [nm, -, -]
    wanted : place of the wanted continuum in `CONTINUA`.
    missing : a code of `STATUSES` where the channels cannot show it, else 0, (2,).
    order : continua in the order in which they are tried, (3,), -1 for none.
    low, high : first channel of all bands, and the one behind the last.
    """

    bands: IntArray
    limits_nm: FloatArray
    bias: FloatArray
    least: FloatArray
    wanted: int
    missing: IntArray
    order: IntArray
    low: int
    high: int


def places_of(grid: BandGrid, wanted: int) -> Places:
    """Where the bands lie among these channels, and the continua to try, the wanted one first."""
    wavelength = grid.wavelength_nm
    bands = [
        [*channels_within(wavelength, band.window_nm), *channels_within(wavelength, band.center_range_nm)]
        for band in BANDS
    ]
    missing = [_missing(wavelength[low:high], band) for (low, high, _, _), band in zip(bands, BANDS, strict=True)]
    order = [which for which in dict.fromkeys((wanted, HULL, LINEAR)) if grid.ties.available[which]]
    order += [-1] * (len(CONTINUA) - len(order))
    limits = np.array([band.center_range_nm for band in BANDS])
    bias, least = np.array([(band.bias, band.least) for band in BANDS]).T.copy()
    codes = np.array(missing, np.int64), np.array(order, np.int64)
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return Places(np.array(bands, np.int64), limits, bias, least, wanted, *codes, low, high)


def channels_within(wavelength_nm: FloatArray, limits_nm: tuple[float, float]) -> tuple[int, int]:
    """First channel within limits, and the one behind the last."""
    low, high = limits_nm
    return int(np.searchsorted(wavelength_nm, low)), int(np.searchsorted(wavelength_nm, high, side="right"))


def _missing(inside_nm: FloatArray, band: Band) -> int:
    """Code of why these channels of a window cannot show its band; 0 where they can."""
    if inside_nm.size < FEWEST_IN_WINDOW:
        return STATUS.too_few_channels_in_window
    return STATUS.ok if reaches_over(inside_nm, *band.reach_nm) else STATUS.window_not_covered


def sentence(code: int, band: Band, deepest_nm: float, wavelength_nm: FloatArray) -> str:
    """What a code says of a band of a spectrum with these usable channels (n,), deepest there. [nm, nm]"""
    low, high = band.window_nm
    inside = (
        wavelength_nm[(wavelength_nm >= low) & (wavelength_nm <= high)]
        if code == STATUS.window_not_covered
        else wavelength_nm[:0]
    )
    first, last = (inside[0], inside[-1]) if inside.size else (np.nan, np.nan)
    if inside.size and (gap := wide_gap(inside, first, last)):
        return "no result: no usable channel from {:g} to {:g} nm".format(*gap)
    return SENTENCES[STATUSES[code]].format(
        deepest=deepest_nm,
        low=band.center_range_nm[0],
        high=band.center_range_nm[1],
        others=band.others,
        first=first,
        last=last,
    )


NARROW_TEXT = "a narrow absorption at"


def narrow_text(center_nm: float, width_nm: float) -> str:
    """A narrow absorption, and what makes such ones.

    >>> narrow_text(1920.0, 105.0)
    'a narrow absorption at 1920 nm, 105 nm wide: water or hydroxyl'
    """
    cause = "water or hydroxyl" if center_nm < WATER_MOST_NM else "hydroxyl or a carbonate"
    return f"{NARROW_TEXT} {center_nm:.0f} nm, {width_nm:.0f} nm wide: {cause}"


def with_errors(value: float, *errors: float | None, most: int = 9) -> list[str]:
    """A value and its errors, to the second digit of the largest or so many places; each error keeps its first digit.

    >>> with_errors(973.031, 0.068, 5.7), with_errors(1890.2, 6.1, 131.0), with_errors(0.4193, 0.00006, most=3)
    (['973.0', '0.07', '5.7'], ['1890', '6', '130'], ['0.419', '0.001'])
    """
    largest = max((error for error in errors if error), default=1.0)
    places = min(1 - math.floor(math.log10(float(f"{largest:.1e}"))), most)

    def shown(one: float, to: int) -> str:
        return f"{round(one, to):.{max(to, 0)}f}"

    stated = [error for error in errors if error is not None]
    digits = [max(places, min(-math.floor(math.log10(float(f"{one:.0e}"))), most)) if one else places for one in stated]
    return [shown(value, places), *(shown(max(one, 10.0**-to), to) for one, to in zip(stated, digits, strict=True))]


def centre_text(center_nm: float, sigma_nm: float, spread_nm: float | None, *, named: bool = True) -> str:
    """A centre with both of its errors, that of the noise and what methods differ by.

    >>> centre_text(1976.2, 6.8, 69.0), centre_text(973.031, 0.068, 5.7, named=False)
    ('1976 ± 7 (noise) ± 69 (method) nm', '973.0 ± 0.07 ± 5.7 nm')
    """
    value, *errors = with_errors(center_nm, sigma_nm, spread_nm)
    names = (" (noise)", " (method)") if named else ("", "")
    return " ± ".join([value, *(f"{one}{name}" for one, name in zip(errors, names, strict=False))]) + " nm"


def depends_on_method(sigma_nm: FloatArray, spread_nm: FloatArray) -> BoolArray:
    """Where centres depend on how they are found more than on the noise."""
    return np.asarray((spread_nm > DEPENDS_NM) & (spread_nm > DEPENDS_SIGMA * sigma_nm))


@dataclass(frozen=True, slots=True, kw_only=True)
class BandResult:
    """One band of one spectrum; every number is None when `status` says that there is no band.

    Attributes
    ----------
    center_nm, center_sigma_nm : wavelength of the minimum after continuum removal, and its standard error: noise, and
        the bias of the window it is found from. [nm]
    center_systematic_nm : half the range of the centre over all continua under which there is one, also those not fit
        for use; None where there is one only, or where all of them rest on the same tie points. [nm]
    center_gaussian_nm : half the difference from the centre of a Gaussian through the deeper half of the band. [nm]
    center_method_nm : what methods differ by: the larger of these two, at 2 um also of what the last channel cuts off
        (`short_by`). [nm]
    depth, depth_sigma : 1 - R/continuum at the centre. [-]
    area_nm, area_sigma_nm : integral of 1 - R/continuum over the window. [nm]
    asymmetry, asymmetry_sigma : area beyond the centre less that before it, over both; -1 to 1. [-]
    center_calibration_nm, depth_calibration, area_calibration_nm : standard deviation from the errors that all channels
        share (`Spectrum.systematic`), each carried through as one shift, to first order and at the same tie points of
        the continuum: where a shift makes these jump, the band moves by more. None where none is known. [nm, -, nm]
    continuum : the continuum really used, after any fallback.
    status : `ok`, or a sentence, also that methods differ by much more than the noise does.
    note : why the wanted continuum was not used, or empty.
    """

    center_nm: float | None = None
    center_sigma_nm: float | None = None
    center_systematic_nm: float | None = None
    center_gaussian_nm: float | None = None
    center_method_nm: float | None = None
    depth: float | None = None
    depth_sigma: float | None = None
    area_nm: float | None = None
    area_sigma_nm: float | None = None
    asymmetry: float | None = None
    asymmetry_sigma: float | None = None
    center_calibration_nm: float | None = None
    depth_calibration: float | None = None
    area_calibration_nm: float | None = None
    continuum: str
    status: str = "ok"
    note: str = ""

    @property
    def centre_text(self) -> str:
        """The centre with both of its errors; '' where there is none."""
        if self.center_nm is None or self.center_sigma_nm is None:
            return ""
        return centre_text(self.center_nm, self.center_sigma_nm, self.center_method_nm, named=False)


def nothing_of(count: int) -> tuple[FloatArray, Codes]:
    """What `measure_rows` gives of so many spectra that cannot be measured."""
    codes = np.zeros((count, len(BANDS), len(CODES)), np.int8)
    codes[..., CODE.continuum], codes[..., CODE.status] = -1, STATUS.spectrum_unusable
    return np.full((count, len(BANDS), len(QUANTITIES)), np.nan), codes


MEASURED = QUANTITIES[: NUMBER.deepest_nm]
"""What is measured of a band: the numbers of a `BandResult`."""


@dataclass(frozen=True, slots=True, eq=False)
class BandColumns:
    """One band of m spectra; each array is (m,), a number NaN where there is none.

    Names that `BandResult` has, too, mean the same.

    Attributes
    ----------
    deepest_nm, note_deepest_nm : where the band of the reported continuum, and of the wanted one, is deepest. [nm]
    narrow_nm, narrow_width_nm : centre and width of a narrow absorption in it, or that makes it. [nm]
    continuum : place in `CONTINUA` of the one used, -1 for none.
    status, note : places in `STATUSES`: whether there is a band, and why the wanted continuum was not used.
    """

    center_nm: FloatArray
    center_sigma_nm: FloatArray
    center_systematic_nm: FloatArray
    center_gaussian_nm: FloatArray
    center_method_nm: FloatArray
    depth: FloatArray
    depth_sigma: FloatArray
    area_nm: FloatArray
    area_sigma_nm: FloatArray
    asymmetry: FloatArray
    asymmetry_sigma: FloatArray
    center_calibration_nm: FloatArray
    depth_calibration: FloatArray
    area_calibration_nm: FloatArray
    deepest_nm: FloatArray
    note_deepest_nm: FloatArray
    narrow_nm: FloatArray
    narrow_width_nm: FloatArray
    continuum: Codes
    status: Codes
    note: Codes


@dataclass(frozen=True, slots=True, eq=False)
class BandArrays:
    """Both bands of m spectra: `numbers` (m, 2, 18) in the order of `QUANTITIES`, NaN where there is none, and `codes`
    (m, 2, 3) in that of `CODES`; `bands` has them by name. Units are in the names."""

    numbers: FloatArray
    codes: Codes

    @property
    def depends(self) -> BoolArray:
        """(m, 2) whether methods differ by much more than the noise does."""
        return depends_on_method(self.numbers[..., NUMBER.center_sigma_nm], self.numbers[..., NUMBER.center_method_nm])

    @property
    def bands(self) -> dict[str, BandColumns]:
        """By key of the band, its numbers and codes."""
        return {
            band.key: BandColumns(*self.numbers[:, place].T, *self.codes[:, place].T)
            for place, band in enumerate(BANDS)
        }


NARROW_CENTRES_NM, NARROW_WIDTHS_NM = (
    np.concatenate([np.arange(1850.0, 1995.0, 10.0), np.arange(2140.0, 2405.0, 10.0)]),
    np.array([40.0, 60.0, 80.0, 105.0, 135.0, 170.0, 205.0]),
)
"""Where they are sought, and full widths at half maximum that are tried. Water absorbs at 1900-1950 nm, hydroxyl and
carbonates at 2200-2350 nm (Hunt 1977, 10.1190/1.1440721); bands of pyroxenes at 2 um are 570 nm wide and more
(`mgm_bands.csv`). [nm]"""
NARROW_WINDOW_NM, NARROW_REACH_NM, NARROW_DEGREE, NARROW_CHANNELS = 220.0, 70.0, 3, 10
"""A Gaussian on a cubic in ln R so far to both sides, or so far at least, and channels that it takes; assumed. A cubic
follows the floor of a band 500 nm wide to 2 % of its depth. [nm]"""
NARROW_WIDEST_NM = 135.0
"""Wider ones are not called narrow: what a cubic leaves of a wide band looks like a Gaussian of 170 nm and more,
on spectra of pyroxenes (RELAB); assumed. [nm]"""
EXPLAINED = 0.5
"""Least share of what the cubic leaves, sum of squares, that the Gaussian takes away; assumed: it takes 0.3 at
most in 57 Chang'E-4 spectra with a 2 um band, whose scatter makes sharp dips."""
SIGNIFICANT = 6.0
"""Least strength of the Gaussian over its standard error, which decides where channels are few; assumed, as the most of
several hundred that are tried counts."""
NEAR_NM = 80.0
"""How far from the centre of a band it may lie; assumed: smoothing over 205 nm moves the centre of a sharp one."""
BAND_SHARE, BESIDE_SHARE = 0.5, 0.15
"""Shares of the depth of a band, in ln R, from which it makes the band, and from which it is said to be beside it.

Half is where it is more of the band than anything else. Looked at on every second sample series of RELAB, counted on
the others (`tests/spectra/test_band_status.py`): of 25 such bands of olivines and plagioclases without pyroxene it
makes 15, of 80 bands with 10 vol % of pyroxene or more 1. 0.15 is assumed."""
NO_PYROXENE = "no pyroxene's in 15 of 16 laboratory spectra with such a one"
"""What a band that a narrow absorption makes means, by these counts."""


def narrow_absorptions(
    wavelength_nm: FloatArray, reflectance: FloatArray, center_nm: FloatArray, depth: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The narrow absorption nearest in shape to a Gaussian in ln R beside the centre of each 2 um band.

    Parameters
    ----------
    wavelength_nm, reflectance : (n,) ascending, and (m, n) above 0. [nm, -]
    center_nm, depth : of the 2 um bands, (m,). [nm, -]

    Returns
    -------
    Its centre and full width at half maximum, NaN where there is none, and its share of the depth of the band, (m,).
    [nm, nm, -]
    """
    ln, whole = np.log(reflectance), -np.log1p(-np.clip(depth, 0.0, 0.999))
    place, width, share, best = (np.full(len(ln), value) for value in (np.nan, np.nan, 0.0, EXPLAINED))
    widths = NARROW_WIDTHS_NM[2.0 * np.median(np.diff(wavelength_nm)) <= NARROW_WIDTHS_NM]
    for centre in NARROW_CENTRES_NM:
        rows = np.flatnonzero(np.abs(center_nm - centre) <= NEAR_NM)
        inside = np.abs(wavelength_nm - centre) <= NARROW_WINDOW_NM
        x = wavelength_nm[inside] - centre
        if (
            not rows.size
            or not widths.size
            or x.size < NARROW_CHANNELS
            or x[0] > -NARROW_REACH_NM
            or x[-1] < NARROW_REACH_NM
        ):
            continue
        cubic, _ = np.linalg.qr(np.vander(x / NARROW_WINDOW_NM, NARROW_DEGREE + 1))
        left = ln[np.ix_(rows, inside)]
        left -= (left @ cubic) @ cubic.T
        shapes = np.exp(-4.0 * math.log(2.0) * (x / widths[:, None]) ** 2)
        shapes -= (shapes @ cubic) @ cubic.T
        size = (shapes**2).sum(axis=1)
        strength = -(left @ shapes.T) / size
        explained = np.where(strength > 0, strength**2 * size, 0.0) / np.maximum((left**2).sum(axis=1), 1e-300)[:, None]
        k = explained.argmax(axis=1)
        most = explained[np.arange(rows.size), k]
        free = x.size - NARROW_DEGREE - 2
        better = most > np.maximum(best[rows], SIGNIFICANT**2 / (SIGNIFICANT**2 + free))
        to, k, at = rows[better], k[better], np.flatnonzero(better)
        best[to], place[to], width[to], share[to] = most[at], centre, widths[k], strength[at, k] / whole[to]
    narrow = (width <= NARROW_WIDEST_NM) & (share >= BESIDE_SHARE)
    return np.where(narrow, place, np.nan), np.where(narrow, width, np.nan), np.where(narrow, share, 0.0)


def judge_width(wavelength_nm: FloatArray, reflectance: FloatArray, numbers: FloatArray, codes: Codes) -> None:
    """Take away each 2 um band that a narrow absorption makes, and note the narrow ones within others.

    Parameters
    ----------
    wavelength_nm, reflectance : (n,) and (m, n). [nm, -]
    numbers, codes : of the 2 um bands, `QUANTITIES` (m, 18) and `CODES` (m, 3), which change.
    """
    seen = np.flatnonzero(codes[:, CODE.continuum] >= 0)
    if not seen.size:
        return
    values = np.asarray(reflectance[seen], float)
    at, width, share = narrow_absorptions(
        wavelength_nm, values, numbers[seen, NUMBER.center_nm], numbers[seen, NUMBER.depth]
    )
    numbers[seen, NUMBER.narrow_nm], numbers[seen, NUMBER.narrow_width_nm] = at, width
    gone = seen[share >= BAND_SHARE]
    numbers[gone, : NUMBER.deepest_nm], codes[gone, CODE.continuum], codes[gone, CODE.status] = (
        np.nan,
        -1,
        STATUS.too_narrow,
    )
