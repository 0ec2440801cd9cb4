"""Elementary functions of numbers, of arrays, and of eight numbers in the lanes of vector instructions.

Calls into the C library hold a loop to one argument at a time. These are sums without branches instead, exact to a few
units in the last place within their ranges. Series: Abramowitz & Stegun (1964), 4.1.24, 4.2.1, 4.3.65, 4.3.66, 4.4.40;
arguments are reduced as by Cody & Waite (1980), Software Manual for the Elementary Functions, ch. 5 and 6.
"""

import math
from typing import Any

import numpy as np

from lunarsci.lanes import choose, exponent_of, formula, highest, lowest, mantissa_of, nearest, root, two_to

LN_2_HIGH, LN_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""ln 2 in two parts, the first with trailing zeros, so that whole multiples of it are exact."""
PER_LN_2 = 1 / math.log(2)
LARGEST = 700.0
"""Beyond this an exponential is 0 or infinite."""
ROOT_2 = math.sqrt(2)
LOGARITHM_ORDER = 21
"""Power to which its series goes; the next one is below the last digit."""
_HALF_LN_2 = math.log(2) / 2


def _rest_of_exponential(y: Any) -> Any:
    return sum(y**n / math.factorial(n + 3) for n in range(20))


_REST = np.polynomial.Chebyshev.interpolate(_rest_of_exponential, 8, [-_HALF_LN_2, _HALF_LN_2])
REST_OF_EXPONENTIAL = tuple(_REST.convert(kind=np.polynomial.Polynomial).coef.tolist())
"""Of (exp(y) - 1 - y - y^2/2) / y^3 within half ln 2, from its series at Chebyshev's points; leaves 3e-17 of exp(y)."""


@formula
def sine(x: Any) -> Any:
    """sin x for |x| up to 1.7."""
    q = x * x
    inner = 1 - q * (1 / 210) * (1 - q * (1 / 272) * (1 - q * (1 / 342) * (1 - q * (1 / 420))))
    return x * (
        1
        - q
        * (1 / 6)
        * (
            1
            - q * (1 / 20) * (1 - q * (1 / 42) * (1 - q * (1 / 72) * (1 - q * (1 / 110) * (1 - q * (1 / 156) * inner))))
        )
    )


@formula
def cosine(x: Any) -> Any:
    """cos x for |x| up to 1.7."""
    q = x * x
    inner = 1 - q * (1 / 182) * (1 - q * (1 / 240) * (1 - q * (1 / 306) * (1 - q * (1 / 380) * (1 - q * (1 / 462)))))
    return 1 - q * (1 / 2) * (
        1 - q * (1 / 12) * (1 - q * (1 / 30) * (1 - q * (1 / 56) * (1 - q * (1 / 90) * (1 - q * (1 / 132) * inner))))
    )


@formula
def arcsin(x: Any) -> Any:
    """arcsin x for 0 to sqrt(1/2); its argument is halved twice."""
    q = x * x
    q = 0.5 * q / (1 + root(1 - q))
    q = 0.5 * q / (1 + root(1 - q))
    inner = 1 + q * (121 / 156) * (
        1 + q * (169 / 210) * (1 + q * (225 / 272) * (1 + q * (289 / 342) * (1 + q * (361 / 420))))
    )
    series = 1 + q * (1 / 6) * (
        1 + q * (9 / 20) * (1 + q * (25 / 42) * (1 + q * (49 / 72) * (1 + q * (81 / 110) * inner)))
    )
    return 4 * root(q) * series


def _exponential(x: Any) -> Any:
    """2^k, and what exp(x) / 2^k is more than 1, with k the whole number nearest to x / ln 2."""
    x = lowest(LARGEST, highest(-LARGEST, x))
    k = nearest(x * PER_LN_2)
    y = (x - k * LN_2_HIGH) - k * LN_2_LOW
    series = y * REST_OF_EXPONENTIAL[-1] + REST_OF_EXPONENTIAL[-2]
    for coefficient in (*REST_OF_EXPONENTIAL[-3::-1], 0.5, 1.0):
        series = series * y + coefficient
    return two_to(k), series * y


@formula
def exp_minus_one(x: Any) -> Any:
    """exp(x) - 1; x beyond +-700 is taken as that."""
    power, rest = _exponential(x)
    return power * rest + (power - 1)


@formula
def exponential(x: Any) -> Any:
    """exp(x); x beyond +-700 is taken as that."""
    power, rest = _exponential(x)
    return power * rest + power


@formula
def logarithm(x: Any) -> Any:
    """ln x for normal numbers x > 0; a number without meaning for others.

    x = 2^k m with m between 0.7 and 1.4, ln m = 2 artanh((m - 1) / (m + 1)).
    """
    k, m = exponent_of(x), mantissa_of(x)
    above = m > ROOT_2
    k, m = choose(above, k + 1.0, k), choose(above, m * 0.5, m)
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = q * (2 / LOGARITHM_ORDER) + 2 / (LOGARITHM_ORDER - 2)
    for power in range(LOGARITHM_ORDER - 4, 1, -2):
        series = series * q + 2 / power
    return k * LN_2_HIGH + (k * LN_2_LOW + (series * q * s + s * 2))
