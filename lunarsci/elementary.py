"""Elementary functions that the compiler can put into vector lanes, four or eight arguments at once.

Calls into the C library hold a loop to one argument at a time. These are sums without branches instead, exact to a few
units in the last place within their ranges; they are pasted into the loop that calls them. Series: Abramowitz & Stegun
(1964), 4.1.24, 4.2.1, 4.3.65, 4.3.66, 4.4.40.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import pasted

LN_2_HIGH, LN_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""ln 2 in two parts, the first with trailing zeros, so that whole multiples of it are exact."""
PER_LN_2 = 1 / math.log(2)
LARGEST = 700.0
"""Beyond this an exponential is 0 or infinite."""
ROOT_HALF_BITS = 0x3FE6A09E667F3BCD
"""The bits of sqrt(1/2)."""


@pasted
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


@pasted
def cosine(x: Any) -> Any:
    """cos x for |x| up to 1.7."""
    q = x * x
    inner = 1 - q * (1 / 182) * (1 - q * (1 / 240) * (1 - q * (1 / 306) * (1 - q * (1 / 380) * (1 - q * (1 / 462)))))
    return 1 - q * (1 / 2) * (
        1 - q * (1 / 12) * (1 - q * (1 / 30) * (1 - q * (1 / 56) * (1 - q * (1 / 90) * (1 - q * (1 / 132) * inner))))
    )


@pasted
def arcsin(x: Any) -> Any:
    """arcsin x for 0 to sqrt(1/2); its argument is halved twice."""
    q = x * x
    q = 0.5 * q / (1 + math.sqrt(1 - q))
    q = 0.5 * q / (1 + math.sqrt(1 - q))
    inner = 1 + q * (121 / 156) * (
        1 + q * (169 / 210) * (1 + q * (225 / 272) * (1 + q * (289 / 342) * (1 + q * (361 / 420))))
    )
    series = 1 + q * (1 / 6) * (
        1 + q * (9 / 20) * (1 + q * (25 / 42) * (1 + q * (49 / 72) * (1 + q * (81 / 110) * inner)))
    )
    return 4 * math.sqrt(q) * series


@pasted
def exp_minus_one(x: Any) -> Any:
    """exp(x) - 1; x beyond +-700 is taken as that."""
    x = min(max(x, -LARGEST), LARGEST)
    whole = np.floor(x * PER_LN_2 + 0.5)
    y = (x - whole * LN_2_HIGH) - whole * LN_2_LOW
    inner = 1 + y * (1 / 8) * (
        1 + y * (1 / 9) * (1 + y * (1 / 10) * (1 + y * (1 / 11) * (1 + y * (1 / 12) * (1 + y * (1 / 13)))))
    )
    rest = y * (
        1
        + y
        * (1 / 2)
        * (1 + y * (1 / 3) * (1 + y * (1 / 4) * (1 + y * (1 / 5) * (1 + y * (1 / 6) * (1 + y * (1 / 7) * inner)))))
    )
    power = np.int64((np.int64(whole) + 1023) << 52).view(np.float64)
    return power * rest + (power - 1)


@pasted
def exponential(x: Any) -> Any:
    """exp(x); x beyond +-700 is taken as that."""
    return exp_minus_one(x) + 1


@pasted
def logarithm(x: Any) -> Any:
    """ln x for normal numbers x > 0; a number without meaning for others."""
    bits = np.float64(x).view(np.int64)
    power = (bits - ROOT_HALF_BITS) >> 52
    rest = np.int64(bits - (power << 52)).view(np.float64)
    s = (rest - 1) / (rest + 1)
    q = s * s
    inner = 1 / 11 + q * (1 / 13 + q * (1 / 15 + q * (1 / 17 + q * (1 / 19 + q * (1 / 21)))))
    series = 1 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * inner))))
    whole = np.float64(power)
    return whole * LN_2_HIGH + (2 * s * series + whole * LN_2_LOW)
