"""Residuals of eight spectra at once and the sums of which their normal equations are made, compiled.

The derivatives of a band are its Gaussian times a polynomial of second degree in wavelength, so what the normal
equations need of two bands are five moments of the product of their Gaussians, not nine products of derivatives. The
sums are taken over a few channels at a time, which stay in the fastest memory.
"""

from typing import Any

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, bell, logarithm
from lunarsci.spectra.mgm.lanes import choose, load, lowest, spread, store

__all__ = ["BLOCK", "MOMENTS", "ORIGIN", "evaluate", "rows_of_sums", "rows_of_work"]

BLOCK = 8
"""Channels worked on together; their number is a multiple of it."""
ORIGIN = 1.4
"""Wavelengths are counted from here, near the middle of the range, so that fourth powers lose few digits. [um]"""
MOMENTS = 5
LEAST = 1e-9
"""A continuum below this, in a trial that will be refused, is replaced by it."""


def rows_of_work(degrees: int, bands: int) -> int:
    """Of the room that `evaluate` works in."""
    return (degrees + 1 + 3 * bands) * BLOCK


def rows_of_sums(degrees: int, bands: int) -> int:
    """Of the sums of `evaluate`: (m + 1)^2 of the plain rows among themselves, 3 of each with each band, 5 of each pair
    of bands, and the lowest value of the continuum."""
    plain = degrees + 1
    return plain * plain + 3 * plain * bands + MOMENTS * bands * bands + 1


@compiled
def _continuum(channels: Any, first: int, point: Any, degrees: int, logarithmic: bool, work: Any) -> Any:
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
def _gaussians(channels: Any, first: int, point: Any, degrees: int, work: Any) -> None:
    """Weighted Gaussians times the powers 0, 1, 2 of wavelength, and the residual without the bands, of one block."""
    places, _, _, roots = channels
    at = degrees * BLOCK
    row = at + BLOCK
    for band in range(degrees, point.shape[0], 3):
        centre, inverse = load(point, band) - ORIGIN, FWHM_OVER_SIGMA / load(point, band + 1)
        strength = load(point, band + 2)
        for i in range(BLOCK):
            place = load(places, first + i)
            shape = bell((place - centre) * inverse)
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
        least = lowest(least, _continuum(channels, first, point, degrees, logarithmic, work))
        _gaussians(channels, first, point, degrees, work)
        _add_plain(work, degrees, bands, sums)
        if curved > 0:
            _add_bands(work, degrees, bands, sums)
        for i in range(BLOCK):
            store(residuals, first + i, load(work, degrees * BLOCK + i))
    store(sums, last, least)
