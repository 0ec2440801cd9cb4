"""Centre, depth, area and asymmetry of one absorption band in one spectrum, with standard errors; compiled.

The centre is the minimum of a fourth-order polynomial through the deepest part of the band, of two: a wide one, which
scatters little and is biased where the band is lopsided, and a narrow one, which is neither. They are joined with the
weights of least variance, the bias of the wide one as part of its variance: so the window widens with the noise of the
channels, not with what this noise happened to be, and its bias is in the error. Channels count by a weight that rises
smoothly with the depth of the smoothed band, so that everything from the reflectance to the result has derivatives, the
choice of the window included, and the noise of each channel is carried through to first order, smoothing and continuum
included. Only that the tie points of the continuum are chosen on noisy data is not in the errors. Errors assume noise
independent between channels.
"""

import math
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.spectra.band_polynomial import (
    AREA,
    ASYMMETRY,
    COEFFICIENTS,
    CURVE,
    HEFT,
    HEFT_SLOPE,
    NARROW_DEPTH,
    NARROW_NM,
    NOISE,
    OF_CURVE,
    OF_RATIO,
    ONTO,
    PER_LEVEL,
    POWER,
    RATIO,
    RESIDUAL,
    RIGHT,
    SHARE,
    SIZE,
    SOLVED,
    SPARE,
    STEPS,
    WAVELENGTH,
    WEIGHT,
    WIDE_DEPTH,
    WIDE_NM,
    BandWindow,
    X,
    curvature_at,
    fit,
    kernel,
    minima,
    powers,
    solve,
    value_at,
)
from lunarsci.spectra.continuum import TERMS, Indices

WIDE, NARROW = (0.6, 0.9), (0.85, 1.0)
"""Channels less deep than the first share of the band do not count, those deeper than the second count fully; assumed.
Polynomials through about the deepest third are usual for asteroids: Moskovitz et al. (2010), Icarus 208, 773,
10.1016/j.icarus.2010.03.002."""
HALF = 0.5
"""Share of the depth from which a Gaussian is fitted."""
FEWEST_CHANNELS = 8
"""Where fewer are in the wide window, shares half as large are used, and the narrow one not at all: coarse channels."""
NOTHING = (math.nan,) * 9
LEAST_DEPTH = 1e-6
TINY = float(np.finfo(float).tiny)


class Smoother(NamedTuple):
    """The smoothing of spectra on the same n channels.

    Attributes
    ----------
    first, weights : the first channel that it takes at each channel, and the weights from there, (n,), (n, w).
    """

    first: Indices
    weights: FloatArray


class Minimum(NamedTuple):
    """A minimum in a window: wavelength [nm], depth [-], their variances and common one, variance not of first order.

    `rival` is that a second minimum may be the lower one, and that the curvature is uncertain, three times the square
    of its relative error.
    """

    found: bool
    nm: float
    depth: float
    variance: float
    rival: float


class Shape(NamedTuple):
    """A band; meaningless where `found` is False. See `lunarsci.spectra.bands.BandResult`."""

    found: bool
    wide_nm: float
    center_nm: float
    center_sigma_nm: float
    depth: float
    depth_sigma: float
    area_nm: float
    area_sigma_nm: float
    asymmetry: float
    asymmetry_sigma: float


@kernel
def smooth(g: Smoother, values: FloatArray, out: FloatArray) -> None:
    """The smoothed reflectance, into `out` (n,)."""
    for j in range(values.size):
        first, total = g.first[j], 0.0
        for k in range(g.weights.shape[1]):
            total += g.weights[j, k] * values[first + k]
        out[j] = total


@kernel
def window_of(s: FloatArray, c: int, band: IntArray, low: float, high: float, wide: bool) -> BandWindow:
    """The channels that are connected with the deepest one and deep enough; their weights into HEFT.

    SHARE takes the depth over the deepest, X the scaled wavelength, HEFT_SLOPE the derivative of the weight
    to the share.
    """
    curve, deepest = s[CURVE + c], band[2]
    for j in range(band[2], band[3]):
        if curve[j] < curve[deepest]:
            deepest = j
    most = max(1.0 - curve[deepest], LEAST_DEPTH)
    first, last = _connected(curve, band, deepest, 1.0 - low * most)
    if wide and last - first + 1 < FEWEST_CHANNELS:
        low, high = low / 2, high / 2
        first, last = _connected(curve, band, deepest, 1.0 - low * most)
    middle = (s[WAVELENGTH, first] + s[WAVELENGTH, last]) / 2
    half = max((s[WAVELENGTH, last] - s[WAVELENGTH, first]) / 2, 1.0)
    per_depth, per_share, per_half = 1.0 / most, 1.0 / (high - low), 1.0 / half
    for j in range(first, last + 1):
        share = (1.0 - curve[j]) * per_depth
        t = min(max((share - low) * per_share, 0.0), 1.0)
        s[SHARE, j] = share
        s[HEFT, j] = t * t * (3.0 - 2.0 * t)
        s[HEFT_SLOPE, j] = 6.0 * t * (1.0 - t) * per_share
        s[X, j] = (s[WAVELENGTH, j] - middle) * per_half
    inner = band[2] < deepest < band[3] - 1 and last - first + 1 >= FEWEST_CHANNELS
    return BandWindow(first, last, deepest, most, middle, half, inner)


@kernel
def _connected(curve: FloatArray, band: IntArray, at: int, below: float) -> tuple[int, int]:
    """First and last channel of the run about one whose curve is below a level."""
    first, last = at, at
    while first > band[0] and curve[first - 1] < below:
        first -= 1
    while last < band[1] - 1 and curve[last + 1] < below:
        last += 1
    return first, last


@kernel
def _slopes(g: Smoother, tie: Indices, s: FloatArray, c: int, w: BandWindow, out: int) -> None:
    """Derivatives to each reflectance, into a row, of a quantity whose derivatives to the coefficients are in RIGHT."""
    solve(s, RIGHT, SOLVED)
    per_depth, total = 1.0 / w.depth, 0.0
    for j in range(w.first, w.last + 1):
        along = value_at(s, SOLVED, s[X, j])
        of_share = along * s[RESIDUAL, j] * s[HEFT_SLOPE, j] * per_depth
        s[OF_RATIO, j] = along * s[HEFT, j]
        s[OF_CURVE, j] = -of_share
        total += of_share * s[SHARE, j]
    s[OF_CURVE, w.deepest] += total
    per_channel(g, tie, s, c, w.first, w.last + 1, out)


@kernel
def per_channel(g: Smoother, tie: Indices, s: FloatArray, c: int, first: int, behind: int, out: int) -> None:
    """Derivatives to both ratios, OF_RATIO and OF_CURVE, into derivatives to the reflectance."""
    size = s.shape[1]
    for j in range(size):
        s[ONTO, j] = 0.0
        s[out, j] = 0.0
    for j in range(first, behind):
        per_level = s[PER_LEVEL + c, j]
        of_level = -(s[OF_RATIO, j] * s[RATIO + c, j] + s[OF_CURVE, j] * s[CURVE + c, j]) * per_level
        s[out, j] = s[OF_RATIO, j] * per_level
        s[ONTO, j] += s[OF_CURVE, j] * per_level
        for k in range(TERMS):
            s[ONTO, tie[TERMS * c + k, j]] += of_level * s[WEIGHT + TERMS * c + k, j]
    for j in range(size):
        if s[ONTO, j] != 0.0:
            begin = g.first[j]
            for k in range(g.weights.shape[1]):
                s[out, begin + k] += g.weights[j, k] * s[ONTO, j]


@kernel
def variance(s: FloatArray, row: int) -> float:
    """Variance of a quantity whose derivatives to each reflectance are in a row."""
    total = 0.0
    for j in range(s.shape[1]):
        off = s[row, j] * s[NOISE, j]
        total += off * off
    return total


@kernel
def centre(g: Smoother, tie: Indices, s: FloatArray, c: int, band: IntArray) -> float:
    """Centre of the wide window, without errors; NaN where there is none. [nm]"""
    w = window_of(s, c, band, WIDE[0], WIDE[1], True)
    if not (w.inner and fit(s, c, w)):
        return math.nan
    return float(w.middle_nm + w.half_nm * minima(s)[0])


@kernel
def _minimum(g: Smoother, tie: Indices, s: FloatArray, c: int, w: BandWindow, first_row: int) -> Minimum:
    """The minimum in a window; derivatives of wavelength and depth into rows from `first_row` on."""
    if not fit(s, c, w):
        return Minimum(False, math.nan, math.nan, math.nan, math.nan)
    x, second = minima(s)
    if math.isnan(x):
        return Minimum(False, math.nan, math.nan, math.nan, math.nan)
    curvature = curvature_at(s, x)
    powers(s, x, 2, 1.0)
    _slopes(g, tie, s, c, w, SPARE)
    flat = math.sqrt(variance(s, SPARE)) / max(curvature, TINY)
    powers(s, x, 0, -1.0)
    _slopes(g, tie, s, c, w, first_row + 1)
    powers(s, x, 1, -w.half_nm / curvature)
    _slopes(g, tie, s, c, w, first_row)
    first_order = variance(s, first_row)
    rival = 3.0 * flat * flat * first_order
    if not math.isnan(second):
        rival += _rival(g, tie, s, c, w, x, second)
    return Minimum(True, w.middle_nm + w.half_nm * x, 1.0 - value_at(s, COEFFICIENTS, x), first_order, rival)


@kernel
def _rival(g: Smoother, tie: Indices, s: FloatArray, c: int, w: BandWindow, x: float, second: float) -> float:
    """What it adds to the variance of the centre that the second minimum may truly be the lower one. [nm2]

    The probability of that, from the difference of their depths and its error, times the square of their distance.
    """
    for k in range(SIZE):
        s[RIGHT, k] = second**k - x**k
    _slopes(g, tie, s, c, w, SPARE)
    sigma = max(math.sqrt(variance(s, SPARE)), TINY)
    rise = value_at(s, COEFFICIENTS, second) - value_at(s, COEFFICIENTS, x)
    apart = w.half_nm * (second - x)
    return 0.5 * math.erfc(rise / sigma / math.sqrt(2.0)) * apart * apart


@kernel
def shape(g: Smoother, tie: Indices, s: FloatArray, c: int, band: IntArray, bias: float, w: BandWindow) -> Shape:
    """Measure a band under a continuum from its wide window, whose weights are there.

    The derivatives of centre, depth, area and asymmetry stay in rows: WIDE_NM, WIDE_DEPTH, AREA, ASYMMETRY.
    """
    wide = _minimum(g, tie, s, c, w, WIDE_NM)
    if not wide.found:
        return Shape(False, *NOTHING)
    center, depth, unsaid = _joined(g, tie, s, c, band, wide, (bias * w.half_nm) ** 2)
    spread = variance(s, WIDE_NM)
    area, asymmetry = _areas(g, tie, s, c, band, center, 2.0 * depth)
    hidden = 2.0 * depth / area if area != 0.0 else 0.0
    return Shape(
        True, wide.nm, center, math.sqrt(spread + unsaid), depth, math.sqrt(variance(s, WIDE_DEPTH)),
        area, math.sqrt(variance(s, AREA)),
        asymmetry, math.sqrt(variance(s, ASYMMETRY) + hidden * hidden * unsaid),
    )  # fmt: skip


@kernel
def _joined(
    g: Smoother, tie: Indices, s: FloatArray, c: int, band: IntArray, wide: Minimum, bias2: float
) -> tuple[float, float, float]:
    """Centre, depth, and the centre's variance that is not of first order, of the wide and the narrow window together.

    Their weights are those of the least variance. The derivatives take the place of those of the wide window.
    """
    w = window_of(s, c, band, NARROW[0], NARROW[1], False)
    narrow = Minimum(False, 0.0, 0.0, 0.0, 0.0)
    if w.inner:
        narrow = _minimum(g, tie, s, c, w, NARROW_NM)
    if not narrow.found:
        return wide.nm, wide.depth, wide.rival + bias2
    common = 0.0
    for j in range(s.shape[1]):
        common += s[WIDE_NM, j] * s[NARROW_NM, j] * s[NOISE, j] * s[NOISE, j]
    of_wide, of_narrow = wide.variance + wide.rival + bias2, narrow.variance + narrow.rival
    part = min(max((of_narrow - common) / max(of_wide + of_narrow - 2.0 * common, TINY), 0.0), 1.0)
    for j in range(s.shape[1]):
        s[WIDE_NM, j] = part * s[WIDE_NM, j] + (1.0 - part) * s[NARROW_NM, j]
        s[WIDE_DEPTH, j] = part * s[WIDE_DEPTH, j] + (1.0 - part) * s[NARROW_DEPTH, j]
    return (
        part * wide.nm + (1.0 - part) * narrow.nm,
        part * wide.depth + (1.0 - part) * narrow.depth,
        part * part * (wide.rival + bias2) + (1.0 - part) * (1.0 - part) * narrow.rival,
    )


@kernel
def _areas(
    g: Smoother, tie: Indices, s: FloatArray, c: int, band: IntArray, center_nm: float, across: float
) -> tuple[float, float]:
    """Area and asymmetry, and the derivatives of both to each reflectance.

    A shift of the centre takes `across` for each nm from the right and gives it to the left.
    """
    area, excess = 0.0, 0.0
    for j in range(band[0], band[1]):
        side = min(max(2.0 * (s[WAVELENGTH, j] - center_nm) / s[STEPS, j], -1.0), 1.0)
        deep = (1.0 - s[RATIO + c, j]) * s[STEPS, j]
        area += deep
        excess += deep * side
        s[OF_RATIO, j] = -s[STEPS, j]
        s[POWER, j] = -s[STEPS, j] * side
        s[OF_CURVE, j] = 0.0
    per_channel(g, tie, s, c, band[0], band[1], AREA)
    for j in range(band[0], band[1]):
        s[OF_RATIO, j] = s[POWER, j]
    per_channel(g, tie, s, c, band[0], band[1], ASYMMETRY)
    per_area = 1.0 / area if area != 0.0 else 0.0
    asymmetry = excess * per_area
    for j in range(s.shape[1]):
        of_excess = s[ASYMMETRY, j] - across * s[WIDE_NM, j]
        s[ASYMMETRY, j] = (of_excess - asymmetry * s[AREA, j]) * per_area
    return area, asymmetry


@kernel
def gaussian_centre(s: FloatArray, c: int, band: IntArray) -> float:
    """Centre of a Gaussian through the deeper half of the smoothed band; NaN where there is none. [nm]

    A parabola through ln depth, weighted with the depth squared: Guo (2011), 10.1109/MSP.2011.941846.
    """
    w = window_of(s, c, band, HALF, HALF + 1e-9, False)
    if w.last - w.first < 2:
        return math.nan
    m0 = m1 = m2 = m3 = m4 = r0 = r1 = r2 = 0.0
    for j in range(w.first, w.last + 1):
        deep = max(1.0 - s[CURVE + c, j], LEAST_DEPTH)
        x, heft = s[X, j], deep * deep if s[HEFT, j] > 0.0 else 0.0
        right = heft * math.log(deep)
        m0, m1, m2, m3, m4 = m0 + heft, m1 + heft * x, m2 + heft * x**2, m3 + heft * x**3, m4 + heft * x**4
        r0, r1, r2 = r0 + right, r1 + right * x, r2 + right * x**2
    d11, d12, d22 = m2 - m1 * m1 / m0, m3 - m1 * m2 / m0, m4 - m2 * m2 / m0
    e1, e2 = r1 - m1 * r0 / m0, r2 - m2 * r0 / m0
    bend = (e2 * d11 - e1 * d12) / (d11 * d22 - d12 * d12)
    slope = (e1 - d12 * bend) / d11
    x = -slope / (2.0 * bend)
    return w.middle_nm + w.half_nm * x if bend < 0.0 and abs(x) < 1.0 else math.nan
