"""Laplace's covariance of a fit, with bounds taken into account.

From the sums over channels to the curvature and the slope of chi-square in a fit's parameters, eight at a time.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.mgm.lanes import choose, load, store
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.moments import MOMENTS, ORIGIN
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["bounded_covariance", "update"]


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


def bounded_covariance(
    curvature: FloatArray, gradient: FloatArray | None, point: FloatArray, model: MgmModel
) -> FloatArray:
    """Inverse curvature of the parameters that are free, shape (p, p), as far as those on a bound let them.

    A parameter that the data press against a bound has a one-sided density, exp(-g t - h t^2 / 2) in the distance t
    from the bound, g the slope there and h the curvature with the free ones following; its variance is the mean of
    t^2, and the free ones follow it. Without `gradient` such parameters do not move at all. Fixed ones have variance 0.
    """
    held = ((point <= model.lower) | (point >= model.upper)) & ~model.fixed
    free = ~held & ~model.fixed
    covariance = np.zeros_like(curvature)
    inverse = _inverse(curvature[np.ix_(free, free)])
    covariance[np.ix_(free, free)] = inverse
    if gradient is None:
        return covariance
    for k in np.flatnonzero(held):
        follow = -inverse @ curvature[free, k]
        bend = float(curvature[k, k] + curvature[k, free] @ follow)
        variance = _one_sided(abs(float(gradient[k])), bend)
        move = np.zeros(point.size)
        move[k], move[free] = 1.0, follow
        covariance += variance * np.outer(move, move)
    return covariance


def _inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def _one_sided(slope: float, bend: float) -> float:
    """Mean of t^2 under exp(-slope t - bend t^2 / 2), t >= 0: normal law truncated at 0."""
    if not bend > 0:
        return math.nan
    root = math.sqrt(bend)
    a = slope / root
    if a > TAIL:
        return 2.0 / slope**2 * (1.0 - 5.0 / a**2)
    ratio = math.exp(-0.5 * a * a) * math.sqrt(2.0 / math.pi) / math.erfc(a / math.sqrt(2.0))
    return (1.0 + a * a - a * ratio) / bend


TAIL = 30.0
"""From here on the law is an exponential one with a first correction, to 1e-4, and the error function runs out."""
