"""Residuals of eight spectra at once and the sums of which their normal equations are made, compiled.

The derivatives of a band are its Gaussian times a polynomial of second degree in wavelength, so what the normal
equations need of two bands are five moments of the product of their Gaussians, not nine products of derivatives. The
sums are taken over a few channels at a time, which stay in the fastest memory.

From the sums to the curvature and the slope of chi-square in a fit's parameters.
"""

from typing import Any

from lunarsci.compiled import compiled
from lunarsci.compiled.lanes import choose, exponential, load, logarithm, lowest, spread, store
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA

BLOCK = 8
"""Channels worked on together; their number is a multiple of it."""
ORIGIN = 1.4
"""Wavelengths are counted from here, near the middle of the range, so that fourth powers lose few digits. [um]"""
MOMENTS = 5
LEAST = 1e-9
"""A continuum below this, in a trial that will be refused, is replaced by it."""


def rows_of_work(degrees: int, bands: int) -> int:
    """Of the workspace of `evaluate`."""
    return (degrees + 1 + 3 * bands) * BLOCK


def rows_of_sums(degrees: int, bands: int) -> int:
    """Of the sums of `evaluate`: (m + 1)^2 of the plain rows among themselves, 3 of each with each band, 5 of each pair
    of bands, and the lowest value of the continuum."""
    plain = degrees + 1
    return plain * plain + 3 * plain * bands + MOMENTS * bands * bands + 1


@compiled
def continuum_rows(channels: Any, first: int, point: Any, degrees: int, logarithmic: bool, work: Any) -> Any:
    """Derivatives by the continuum's coefficients and ln R - ln C of one block; the lowest value of C."""
    places, columns, data, roots = channels
    count, least = places.shape[0], spread(1.0)
    for i in range(BLOCK):
        level = spread(0.0)
        for m in range(degrees):
            level += load(columns, m * count + first + i) * load(point, m)
        slope = load(roots, first + i)
        if logarithmic:
            store(work, degrees * BLOCK + i, load(data, first + i) - level)
        else:
            least = lowest(least, level)
            level = choose(level - LEAST, level, spread(LEAST))
            slope = slope / level
            store(work, degrees * BLOCK + i, load(data, first + i) - logarithm(level))
        for m in range(degrees):
            store(work, m * BLOCK + i, load(columns, m * count + first + i) * slope)
    return least


@compiled
def gaussian_rows(channels: Any, first: int, point: Any, degrees: int, work: Any) -> None:
    """Weighted Gaussians times the powers 0, 1, 2 of wavelength, and the residual without the bands, of one block."""
    places, _, _, roots = channels
    at = degrees * BLOCK
    row = at + BLOCK
    for band in range(degrees, point.shape[0], 3):
        centre, inverse = load(point, band) - ORIGIN, FWHM_OVER_SIGMA / load(point, band + 1)
        strength = load(point, band + 2)
        for i in range(BLOCK):
            place = load(places, first + i)
            x = (place - centre) * inverse
            shape = exponential(x * x * -0.5)
            store(work, at + i, load(work, at + i) - strength * shape)
            shape = shape * load(roots, first + i)
            store(work, row + i, shape)
            shape = shape * place
            store(work, row + BLOCK + i, shape)
            store(work, row + 2 * BLOCK + i, shape * place)
        row += 3 * BLOCK
    for i in range(BLOCK):
        store(work, at + i, load(work, at + i) * load(roots, first + i))


@compiled
def _add_plain(work: Any, degrees: int, bands: int, sums: Any) -> None:
    """Sums of the continuum's rows and the residual among themselves and with every band."""
    plain, target = degrees + 1, 0
    for c in range(plain):
        for d in range(plain):
            total = load(sums, target)
            for i in range(BLOCK):
                total += load(work, c * BLOCK + i) * load(work, d * BLOCK + i)
            store(sums, target, total)
            target += 1
    for c in range(plain):
        for band in range(bands):
            row = (plain + 3 * band) * BLOCK
            s0, s1, s2 = load(sums, target), load(sums, target + 1), load(sums, target + 2)
            for i in range(BLOCK):
                own = load(work, c * BLOCK + i)
                s0 += own * load(work, row + i)
                s1 += own * load(work, row + BLOCK + i)
                s2 += own * load(work, row + 2 * BLOCK + i)
            store(sums, target, s0)
            store(sums, target + 1, s1)
            store(sums, target + 2, s2)
            target += 3


@compiled
def _add_bands(work: Any, degrees: int, bands: int, sums: Any) -> None:
    """Moments 0 to 4 of the product of every two bands."""
    begin, start = (degrees + 1) * BLOCK, (degrees + 1) * (degrees + 1 + 3 * bands)
    for a in range(bands):
        p = begin + 3 * a * BLOCK
        for b in range(a, bands):
            q, target = begin + 3 * b * BLOCK, start + MOMENTS * (a * bands + b)
            s0, s1, s2 = load(sums, target), load(sums, target + 1), load(sums, target + 2)
            s3, s4 = load(sums, target + 3), load(sums, target + 4)
            for i in range(BLOCK):
                p0, p1, p2 = load(work, p + i), load(work, p + BLOCK + i), load(work, p + 2 * BLOCK + i)
                q0, q1, q2 = load(work, q + i), load(work, q + BLOCK + i), load(work, q + 2 * BLOCK + i)
                s0 += p0 * q0
                s1 += p0 * q1
                s2 += p1 * q1
                s3 += p1 * q2
                s4 += p2 * q2
            store(sums, target, s0)
            store(sums, target + 1, s1)
            store(sums, target + 2, s2)
            store(sums, target + 3, s3)
            store(sums, target + 4, s4)


@compiled
def evaluate(
    channels: Any, point: Any, degrees: int, logarithmic: bool, curved: int, work: Any, residuals: Any, sums: Any
) -> None:
    """Fill `sums`, in the order of `rows_of_sums`, at the points (p, 8); those of pairs of bands where `curved` is 1.

    `channels` are wavelength from `ORIGIN`, basis, ln R and the root of the weight, each (n, 8), the basis (m n, 8).
    `residuals` (n, 8) become data - model, times the root of the weight.
    """
    bands, least = (point.shape[0] - degrees) // 3, spread(1.0)
    last = sums.shape[0] - 1
    for row in range(last):
        store(sums, row, spread(0.0))
    for first in range(0, channels[0].shape[0], BLOCK):
        least = lowest(least, continuum_rows(channels, first, point, degrees, logarithmic, work))
        gaussian_rows(channels, first, point, degrees, work)
        _add_plain(work, degrees, bands, sums)
        if curved > 0:
            _add_bands(work, degrees, bands, sums)
        for i in range(BLOCK):
            store(residuals, first + i, load(work, degrees * BLOCK + i))
    store(sums, last, least)


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _keep(target: Any, row: int, taken: Any, value: Any) -> None:
    store(target, row, choose(taken, value, load(target, row)))


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _shape(point: Any, band: int) -> Any:
    """A band's derivatives are g, by strength; by_centre (t - centre) g; and by_width (t - centre)^2 g."""
    centre, inverse = load(point, band) - ORIGIN, FWHM_OVER_SIGMA / load(point, band + 1)
    by_centre = load(point, band + 2) * inverse * inverse
    return centre, by_centre, by_centre / load(point, band + 1)


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _keep_band(target: Any, row: int, stride: int, taken: Any, shape: Any, s0: Any, s1: Any, s2: Any) -> None:
    """Sums of something with g, t g, t^2 g become those with a band's derivatives by centre, width and strength."""
    centre, by_centre, by_width = shape
    _keep(target, row, taken, (s1 - s0 * centre) * by_centre)
    _keep(target, row + stride, taken, (s2 - (s1 * 2.0 - s0 * centre) * centre) * by_width)
    _keep(target, row + 2 * stride, taken, s0)


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _between_bands(sums: Any, row: int, first: Any, second: Any, target: Any, at: int, side: int, taken: Any) -> None:
    """The nine products of the derivatives of two bands."""
    s0, s1, s2 = load(sums, row), load(sums, row + 1), load(sums, row + 2)
    s3, s4 = load(sums, row + 3), load(sums, row + 4)
    centre, by_centre, by_width = first
    _keep_band(
        target, at, 1, taken, second, (s1 - s0 * centre) * by_centre, (s2 - s1 * centre) * by_centre,
        (s3 - s2 * centre) * by_centre,
    )  # fmt: skip
    _keep_band(
        target, at + side, 1, taken, second, (s2 - (s1 * 2.0 - s0 * centre) * centre) * by_width,
        (s3 - (s2 * 2.0 - s1 * centre) * centre) * by_width, (s4 - (s3 * 2.0 - s2 * centre) * centre) * by_width,
    )  # fmt: skip
    _keep_band(target, at + 2 * side, 1, taken, second, s0, s1, s2)


@compiled
def update(sums: Any, point: Any, degrees: int, taken: Any, curvature: Any, slope: Any) -> None:
    """In the lanes where `taken` is above 0: the upper triangle of J J' into `curvature` (p p, 8), J r into `slope`."""
    size, plain = point.shape[0], degrees + 1
    bands = (size - degrees) // 3
    with_bands = plain * plain
    between = with_bands + 3 * plain * bands
    for c in range(degrees):
        for d in range(degrees):
            _keep(curvature, c * size + d, taken, load(sums, c * plain + d))
        _keep(slope, c, taken, load(sums, c * plain + degrees))
    for a in range(bands):
        p = degrees + 3 * a
        first = _shape(point, p)
        for c in range(plain):
            row = with_bands + 3 * (c * bands + a)
            s0, s1, s2 = load(sums, row), load(sums, row + 1), load(sums, row + 2)
            if c < degrees:
                _keep_band(curvature, c * size + p, 1, taken, first, s0, s1, s2)
            else:
                _keep_band(slope, p, 1, taken, first, s0, s1, s2)
        for b in range(a, bands):
            q = degrees + 3 * b
            _between_bands(
                sums, between + MOMENTS * (a * bands + b), first, _shape(point, q), curvature, p * size + q, size, taken
            )
