"""Centre, depth, area and asymmetry of one absorption band in eight spectra at once, with standard errors.

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
from typing import Any

import numpy as np

from lunarsci.arrays import IntArray
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, highest, load, logarithm, lowest, root, spread, store
from lunarsci.spectra.band_polynomial import (
    AREA,
    ASYMMETRY,
    CURVE,
    FIRST,
    FOUND,
    HALF,
    HALF_NM,
    HEFT,
    INNER,
    LAST,
    LEAST_DEPTH,
    LOWEST,
    MIDDLE_NM,
    NARROW,
    NARROW_NM,
    NOISE,
    OF_CURVE,
    OF_RATIO,
    OF_SHAPE,
    OF_TERM,
    OWN,
    RATIO,
    RIGHT,
    RIVALLED,
    SECOND,
    SIZE,
    SPARE,
    WIDE,
    WIDE_DEPTH,
    WIDE_NM,
    BandGrid,
    BandWork,
    X,
    curvature_at,
    fit,
    has_any,
    minima,
    per_channel,
    slopes,
    value_at,
    window_of,
)
from lunarsci.spectra.lane_rows import uncounted

TINY = float(np.finfo(float).tiny)


(
    MINIMUM_NM, MINIMUM_DEPTH, MINIMUM_VARIANCE, MINIMUM_RIVAL, HAS_SHAPE, WIDE_CENTER_NM, UNSAID, SHAPE_NM,
    CENTER_VARIANCE, SHAPE_DEPTH, DEPTH_VARIANCE, SHAPE_AREA, AREA_VARIANCE, SHAPE_ASYMMETRY, ASYMMETRY_VARIANCE,
    GAUSSIAN_NM
) = range(OF_SHAPE, OF_SHAPE + 16)  # fmt: skip
OF_CHOICE = GAUSSIAN_NM + 1
"""Rows, behind those of `band_polynomial`: of a minimum in a window its wavelength [nm] and depth, the variance of the
wavelength, and what is not of first order in that (that a second minimum may be the lower one, and that the curvature
is uncertain: three times the square of its relative error); whether there is a band, its centre in the wide window
[nm], variance of the centre that is not of first order; centre, depth, area [nm], asymmetry, each with its variance;
centre of a Gaussian [nm]."""


def _right_side(k: Any, x: Any, derivative: int, factor: Any) -> None:
    """Derivative of 1, x, …, x^4 at x, times a factor, into RIGHT."""
    power = x * 0.0 + factor
    for n in range(SIZE):
        own = n * (n - 1) if derivative == 2 else n if derivative == 1 else 1
        store(k, RIGHT + n, power * float(own) if n >= derivative else x * 0.0)
        power = power * x if n >= derivative else power


@formula
def _ask_curvature(k: Any, x: Any) -> None:
    _right_side(k, x, 2, 1.0)


@formula
def _ask_depth(k: Any, x: Any) -> None:
    _right_side(k, x, 0, -1.0)


@formula
def _ask_centre(k: Any, x: Any, per_slope: Any) -> None:
    _right_side(k, x, 1, -per_slope)


@formula
def _difference(k: Any, x: Any, other: Any) -> None:
    """What two points of the polynomial differ by, into RIGHT."""
    one, two = x * 0.0 + 1.0, x * 0.0 + 1.0
    for n in range(SIZE):
        store(k, RIGHT + n, two - one)
        one, two = one * x, two * other


@uncounted
def _minimum(g: BandGrid, work: BandWork, first: int, behind: int, row: int) -> None:
    """The minimum in a window; derivatives of wavelength and depth into rows from `row` on."""
    t, k = work.t, work.k
    fit(t, k, RATIO + OWN, first, behind, g.wavelength_nm.size)
    minima(k)
    x, curvature, per_x = load(k, LOWEST), curvature_at(k, load(k, LOWEST)), load(k, HALF_NM)
    _ask_curvature(k, x)
    flat = root(slopes(g, work, first, behind, SPARE)) / highest(curvature, spread(TINY))
    _ask_depth(k, x)
    slopes(g, work, first, behind, row + 1)
    _ask_centre(k, x, per_x / curvature)
    variance = slopes(g, work, first, behind, row)
    store(k, MINIMUM_NM, load(k, MIDDLE_NM) + per_x * x)
    store(k, MINIMUM_DEPTH, 1.0 - value_at(k, x))
    store(k, MINIMUM_VARIANCE, variance)
    store(k, MINIMUM_RIVAL, flat * flat * variance * 3.0)
    if has_any(k, RIVALLED):
        _add_rival(g, work, first, behind)


@uncounted
def _add_rival(g: BandGrid, work: BandWork, first: int, behind: int) -> None:
    """What it adds to the variance of the centre that the second minimum may truly be the lower one. [nm2]

    The probability of that, from the difference of their depths and its error, times the square of their distance.
    """
    k = work.k
    x, second = load(k, LOWEST), load(k, SECOND)
    _difference(k, x, second)
    sigma = highest(root(slopes(g, work, first, behind, SPARE)), spread(TINY))
    store(k, OF_TERM, (value_at(k, second) - value_at(k, x)) / sigma)
    for lane in range(LANES):
        if k[RIVALLED, lane] > 0.0:
            apart = k[HALF_NM, lane] * (k[SECOND, lane] - k[LOWEST, lane])
            k[MINIMUM_RIVAL, lane] += 0.5 * math.erfc(k[OF_TERM, lane] / math.sqrt(2.0)) * apart * apart


@uncounted
def shape(g: BandGrid, work: BandWork, band: IntArray, bias: float, least: float) -> None:
    """Measure a band under each spectrum's own continuum.

    The derivatives of centre, depth, area and asymmetry stay in rows: WIDE_NM, WIDE_DEPTH, AREA, ASYMMETRY.
    """
    t, k, count = work.t, work.k, g.wavelength_nm.size
    first, behind = window_of(g, work, OWN, band, WIDE[0], WIDE[1], True)
    _minimum(g, work, first, behind, WIDE_NM)
    store(k, HAS_SHAPE, load(k, FOUND))
    half = load(k, HALF_NM) * bias
    _remember_wide(k, half * half)
    first, behind = window_of(g, work, OWN, band, NARROW[0], NARROW[1], False)
    _minimum(g, work, first, behind, NARROW_NM)
    _join(t, k, count)
    hidden = _areas(g, work, band)
    unsaid = load(k, UNSAID)
    of_depth = _variance(t, WIDE_DEPTH, count)
    store(k, CENTER_VARIANCE, highest(_variance(t, WIDE_NM, count) + unsaid, _least_variance(k, of_depth, least)))
    store(k, DEPTH_VARIANCE, of_depth)
    store(k, ASYMMETRY_VARIANCE, load(k, ASYMMETRY_VARIANCE) + hidden * hidden * unsaid)
    store(k, GAUSSIAN_NM, _gaussian_centre(g, work, band))


@formula
def _remember_wide(k: Any, bias2: Any) -> None:
    store(k, SHAPE_NM, load(k, MINIMUM_NM))
    store(k, WIDE_CENTER_NM, load(k, MINIMUM_NM))
    store(k, SHAPE_DEPTH, load(k, MINIMUM_DEPTH))
    store(k, CENTER_VARIANCE, load(k, MINIMUM_VARIANCE))
    store(k, UNSAID, load(k, MINIMUM_RIVAL) + bias2)


@uncounted
def _variance(t: Any, row: int, count: int) -> Any:
    """Variance of a quantity whose derivatives to each reflectance are in rows."""
    total = spread(0.0)
    for j in range(count):
        off = load(t, row * count + j) * load(t, NOISE * count + j)
        total += off * off
    return total


@formula
def _least_variance(k: Any, of_depth: Any, factor: float) -> Any:
    """Of a centre: see `Band.least`. [nm2]"""
    depth = load(k, SHAPE_DEPTH)
    width = load(k, SHAPE_AREA) * (factor / math.sqrt(2.0 * math.pi))
    variance = width * width * of_depth / highest(depth * depth * depth * depth, TINY)
    return choose(depth > 0.0, variance, 0.0)


@formula
def _part_of_wide(k: Any, common: Any) -> Any:
    """Weight of the wide window for the least variance, 1 where the narrow one has no minimum."""
    of_wide = load(k, CENTER_VARIANCE) + load(k, UNSAID)
    of_narrow = load(k, MINIMUM_VARIANCE) + load(k, MINIMUM_RIVAL)
    share = (of_narrow - common) / highest(of_wide + of_narrow - common * 2.0, TINY)
    there = (load(k, INNER) > 0.0) & (load(k, FOUND) > 0.0)
    return choose(there, lowest(highest(share, 0.0), 1.0), 1.0)


@formula
def _blend(part: Any, wide: Any, narrow: Any) -> Any:
    return choose(part < 1.0, part * wide + (1.0 - part) * narrow, wide)


@uncounted
def _join(t: Any, k: Any, count: int) -> None:
    """Centre, depth, and the centre's variance that is not of first order, of the wide and the narrow window together.

    Their weights are those of the least variance. The derivatives take the place of those of the wide window.
    """
    common = spread(0.0)
    for j in range(count):
        noise = load(t, NOISE * count + j)
        common += load(t, WIDE_NM * count + j) * load(t, NARROW_NM * count + j) * noise * noise
    part = _part_of_wide(k, common)
    for j in range(2 * count):
        at = WIDE_NM * count + j
        store(t, at, _blend(part, load(t, at), load(t, NARROW_NM * count + j)))
    store(k, SHAPE_NM, _blend(part, load(k, SHAPE_NM), load(k, MINIMUM_NM)))
    store(k, SHAPE_DEPTH, _blend(part, load(k, SHAPE_DEPTH), load(k, MINIMUM_DEPTH)))
    rest = 1.0 - part
    store(k, UNSAID, _blend(part, part * load(k, UNSAID), rest * load(k, MINIMUM_RIVAL)))


@formula
def _deep(wavelength_nm: Any, steps_nm: Any, center_nm: Any, ratio: Any) -> Any:
    side = lowest(highest((wavelength_nm - center_nm) * 2.0 / steps_nm, -1.0), 1.0)
    return side, (1.0 - ratio) * steps_nm


@uncounted
def _areas(g: BandGrid, work: BandWork, band: IntArray) -> Any:
    """Area and asymmetry, and the derivatives of both to each reflectance; what 1 nm of centre does to the latter.

    It takes that from the right and gives it to the left.
    """
    t, k, count = work.t, work.k, g.wavelength_nm.size
    wavelength_nm, steps_nm = g.wavelength_nm, g.steps_nm
    center, across, area, excess = load(k, SHAPE_NM), load(k, SHAPE_DEPTH) * 2.0, spread(0.0), spread(0.0)
    for j in range(band[0], band[1]):
        side, deep = _deep(wavelength_nm[j], steps_nm[j], center, load(t, (RATIO + OWN) * count + j))
        area += deep
        excess += deep * side
        store(t, OF_RATIO * count + j, side * -steps_nm[j])
        store(t, OF_CURVE * count + j, spread(0.0))
    per_channel(g, work, band[0], band[1], ASYMMETRY, spread(0.0))
    for j in range(band[0], band[1]):
        store(t, OF_RATIO * count + j, spread(-steps_nm[j]))
    store(k, AREA_VARIANCE, per_channel(g, work, band[0], band[1], AREA, spread(0.0)))
    per_area = choose(area * area, 1.0 / area, spread(0.0))
    asymmetry, variance = excess * per_area, spread(0.0)
    for j in range(count):
        of_excess = load(t, ASYMMETRY * count + j) - across * load(t, WIDE_NM * count + j)
        own = (of_excess - asymmetry * load(t, AREA * count + j)) * per_area
        off = own * load(t, NOISE * count + j)
        variance += off * off
    store(k, SHAPE_AREA, area)
    store(k, SHAPE_ASYMMETRY, asymmetry)
    store(k, ASYMMETRY_VARIANCE, variance)
    return across * per_area


@formula
def _gaussian_terms(curve: Any, heft: Any, x: Any) -> Any:
    deep = highest(1.0 - curve, LEAST_DEPTH)
    heft = choose(heft > 0.0, deep * deep, 0.0)
    return heft, heft * x, heft * logarithm(deep)


@uncounted
def _gaussian_centre(g: BandGrid, work: BandWork, band: IntArray) -> Any:
    """Centre of a Gaussian through the deeper half of the smoothed band; NaN where there is none. [nm]

    A parabola through ln depth, weighted with the depth squared: Guo (2011), 10.1109/MSP.2011.941846.
    """
    t, k, count = work.t, work.k, g.wavelength_nm.size
    first, behind = window_of(g, work, OWN, band, HALF, HALF + 1e-9, False)
    m0, m1, m2, m3, m4 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    r0, r1, r2 = spread(0.0), spread(0.0), spread(0.0)
    for j in range(first, behind):
        x = load(t, X * count + j)
        heft, power, right = _gaussian_terms(load(t, (CURVE + OWN) * count + j), load(t, HEFT * count + j), x)
        m0, m1, r0, r1 = m0 + heft, m1 + power, r0 + right, r1 + right * x
        power = power * x
        m2, r2 = m2 + power, r2 + right * x * x
        m3, m4 = m3 + power * x, m4 + power * x * x
    return _parabola(k, m0, m1, m2, m3, m4, r0, r1, r2)


@formula
def _parabola(k: Any, m0: Any, m1: Any, m2: Any, m3: Any, m4: Any, r0: Any, r1: Any, r2: Any) -> Any:
    d11, d12, d22 = m2 - m1 * m1 / m0, m3 - m1 * m2 / m0, m4 - m2 * m2 / m0
    e1, e2 = r1 - m1 * r0 / m0, r2 - m2 * r0 / m0
    bend = (e2 * d11 - e1 * d12) / (d11 * d22 - d12 * d12)
    x = (e1 - d12 * bend) / d11 / (bend * -2.0)
    enough = load(k, LAST) - load(k, FIRST) > 1.5
    there = enough & (bend < 0.0) & (abs(x) < 1.0)
    return choose(there, load(k, MIDDLE_NM) + load(k, HALF_NM) * x, math.nan)
