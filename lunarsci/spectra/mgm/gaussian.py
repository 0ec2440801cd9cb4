"""Gaussians on many channels at once, compiled to vector instructions.

The exponential of the C library is called channel by channel; this one is a polynomial that the compiler works on eight
channels at a time, four times as fast and as accurate to 1e-14.
"""

from typing import Any

import numpy as np

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.lanes import choose, exponent_of, highest, mantissa_of, nearest, spread, two_to

__all__ = ["bell", "gaussian", "logarithm"]

LOG2_E = 1.4426950408889634
LN2_HIGH, LN2_LOW = 0.693145751953125, 1.42860682030941723212e-6
"""ln 2 in two parts, so that x - k ln 2 loses no digits."""
EXPONENT_BITS, BIAS = 52, 1023
UNDERFLOW = -700.0
ROOT_2 = 1.4142135623730951


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def gaussian(wavelength: Any, centre: float, inverse_sigma: float, values: Any, powers: Any) -> None:
    """Fill `values` (n,) with exp(-(lambda - centre)^2 inverse_sigma^2 / 2); `powers` (n,) are integers to work with.

    exp(a) = 2^k exp(r) with k the integer nearest to a / ln 2 and |r| below 0.35, where the Taylor series to the
    eleventh power leaves 1e-14. Cody & Waite (1980), Software Manual for the Elementary Functions, ch. 6.
    """
    for i in range(wavelength.size):
        x = (wavelength[i] - centre) * inverse_sigma
        a = max(-0.5 * x * x, UNDERFLOW)
        k = np.floor(a * LOG2_E + 0.5)
        r = a - k * LN2_HIGH - k * LN2_LOW
        series = 1.0 / 39916800.0
        series = series * r + 1.0 / 3628800.0
        series = series * r + 1.0 / 362880.0
        series = series * r + 1.0 / 40320.0
        series = series * r + 1.0 / 5040.0
        series = series * r + 1.0 / 720.0
        series = series * r + 1.0 / 120.0
        series = series * r + 1.0 / 24.0
        series = series * r + 1.0 / 6.0
        series = series * r + 0.5
        series = series * r + 1.0
        values[i] = series * r + 1.0
        powers[i] = (np.int64(k) + BIAS) << EXPONENT_BITS
    two_to_the_k = powers.view(np.float64)
    for i in range(wavelength.size):
        values[i] *= two_to_the_k[i]


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def bell(x: Any) -> Any:
    """exp(-x^2 / 2) of eight numbers, as `gaussian` computes it."""
    a = highest(x * x * -0.5, spread(UNDERFLOW))
    k = nearest(a * LOG2_E)
    r = a - k * LN2_HIGH - k * LN2_LOW
    series = r * (1.0 / 39916800.0) + 1.0 / 3628800.0
    series = series * r + 1.0 / 362880.0
    series = series * r + 1.0 / 40320.0
    series = series * r + 1.0 / 5040.0
    series = series * r + 1.0 / 720.0
    series = series * r + 1.0 / 120.0
    series = series * r + 1.0 / 24.0
    series = series * r + 1.0 / 6.0
    series = series * r + 0.5
    series = series * r + 1.0
    return (series * r + 1.0) * two_to(k)


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def logarithm(x: Any) -> Any:
    """ln of eight positive numbers: x = 2^k m with m between 0.7 and 1.4, ln m = 2 artanh((m - 1) / (m + 1)), whose
    series to the seventeenth power leaves 1e-15. Cody & Waite (1980), ch. 5.
    """
    k, m = exponent_of(x), mantissa_of(x)
    above = m - ROOT_2
    k, m = choose(above, k + 1.0, k), choose(above, m * 0.5, m)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    series = z * (2.0 / 17.0) + 2.0 / 15.0
    series = series * z + 2.0 / 13.0
    series = series * z + 2.0 / 11.0
    series = series * z + 2.0 / 9.0
    series = series * z + 2.0 / 7.0
    series = series * z + 2.0 / 5.0
    series = series * z + 2.0 / 3.0
    return k * LN2_HIGH + (k * LN2_LOW + (series * z * s + s * 2.0))
