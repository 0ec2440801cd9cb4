"""Numbers as text by the million: the shortest decimal that is the same float64, as Python's `repr` writes it.

A 128-bit product finds each end of the range of decimals that round to a float64: Giulietti (2020), The Schubfach way
to render doubles.
"""

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import compiled

Words: Any = npt.NDArray[np.uint64]
Bytes: Any = npt.NDArray[np.uint8]

LOWEST_POWER, HIGHEST_POWER = -292, 324
WIDEST = 25
"""Bytes of the longest float64: -2.2250738585072014e-308; of an int64: 20."""
ONE, TWO, FOUR, TEN, FORTY, THIRTY_TWO, LOW_HALF = (np.uint64(number) for number in (1, 2, 4, 10, 40, 32, 0xFFFFFFFF))
FRACTION, HIDDEN = np.uint64((1 << 52) - 1), np.uint64(1 << 52)


@cache
def powers_of_ten() -> Words:
    """Upper 128 bits of 10^k, rounded up, for k from -292 to 324. (617, 2), high and low word"""
    rows = []
    for power in range(LOWEST_POWER, HIGHEST_POWER + 1):
        size = _floor_log2_power(power)
        shift = 127 - size
        if power >= 0:
            bits = 10**power << shift if shift >= 0 else -((-(10**power)) >> -shift)
        else:
            bits = -((-1 << shift) // 10**-power)
        rows.append((bits >> 64, bits & (1 << 64) - 1))
    return np.array(rows, np.uint64)


def _floor_log2_power(power: int) -> int:
    return (power * 1741647) >> 19


@compiled
def _high_word(a: Any, b: Any) -> Any:
    """Upper 64 bits of a product of 64-bit words."""
    a_low, a_high = a & LOW_HALF, a >> THIRTY_TWO
    b_low, b_high = b & LOW_HALF, b >> THIRTY_TWO
    cross = a_high * b_low + ((a_low * b_low) >> THIRTY_TWO)
    other = a_low * b_high + (cross & LOW_HALF)
    return a_high * b_high + (cross >> THIRTY_TWO) + (other >> THIRTY_TWO)


@compiled
def _rounded_to_odd(high: Any, low: Any, factor: Any) -> Any:
    """Upper word of the product of a power of ten and a factor; its last bit says whether anything follows."""
    carried = _high_word(low, factor)
    middle = high * factor + carried
    upper = _high_word(high, factor)
    if middle < carried:
        upper += ONE
    return upper | (ONE if middle > ONE else np.uint64(0))


@compiled
def shortest_digits(bits: Any, powers: Any) -> Any:
    """Digits and power of ten of a positive finite float64, given as its bits: the value is digits 10^power."""
    fraction, biased = bits & FRACTION, np.int64(bits >> np.uint64(52)) & 0x7FF
    significand, exponent = (fraction | HIDDEN, biased - 1075) if biased else (fraction, np.int64(-1074))
    if -52 <= exponent <= 0 and (significand & ((ONE << np.uint64(-exponent)) - ONE)) == 0:
        return significand >> np.uint64(-exponent), 0
    closer = fraction == 0 and biased > 1
    power = (exponent * 1262611 - (524031 if closer else 0)) >> 22
    shift = np.uint64(exponent + ((-power * 1741647) >> 19) + 1)
    high, low = powers[-power - LOWEST_POWER, 0], powers[-power - LOWEST_POWER, 1]
    outside = significand & ONE
    middle = FOUR * significand
    lowest = _rounded_to_odd(high, low, (middle - (ONE if closer else TWO)) << shift) + outside
    value = _rounded_to_odd(high, low, middle << shift)
    highest = _rounded_to_odd(high, low, (middle + TWO) << shift) - outside
    digits = value >> TWO
    if digits >= TEN:
        shorter = digits // TEN
        below, above = lowest <= FORTY * shorter, FORTY * shorter + FORTY <= highest
        if below != above:
            return shorter + (ONE if above else np.uint64(0)), power + 1
    below, above = lowest <= FOUR * digits, FOUR * digits + FOUR <= highest
    if below == above:
        half = FOUR * digits + TWO
        above = value > half or (value == half and (digits & ONE) == ONE)
    return digits + (ONE if above else np.uint64(0)), power


@compiled
def write_whole(out: Any, at: int, number: Any) -> int:
    """A whole number, 0 or more; where it ends."""
    width, rest = 1, number
    while rest >= TEN:
        rest //= TEN
        width += 1
    for place in range(at + width - 1, at - 1, -1):
        rest = number // TEN
        out[place] = np.uint8(48) + np.uint8(number - TEN * rest)
        number = rest
    return at + width


@compiled
def write_float(out: Any, at: int, bits: Any, powers: Any) -> Any:
    """A finite float64 as `repr` has it; where it ends."""
    if bits >> np.uint64(63):
        out[at] = 45
        at += 1
    bits &= np.uint64(0x7FFFFFFFFFFFFFFF)
    digits, power = (np.uint64(0), np.int64(0)) if bits == 0 else shortest_digits(bits, powers)
    while digits >= TEN and digits % TEN == 0:
        digits //= TEN
        power += 1
    end = write_whole(out, at, digits)
    count = end - at
    point = count + power
    if -4 < point <= 16:
        return _with_point(out, at, count, point)
    return _with_exponent(out, at, count, point - 1)


@compiled
def _with_point(out: Any, at: int, count: int, point: int) -> int:
    """Digits that stand at `at` with a decimal point behind the first `point` of them."""
    if point <= 0:
        for place in range(at + count - 1, at - 1, -1):
            out[place + 2 - point] = out[place]
        out[at : at + 2 - point] = 48
        out[at + 1] = 46
        return at + 2 - point + count
    if point >= count:
        out[at + count : at + point + 2] = 48
        out[at + point] = 46
        return at + point + 2
    for place in range(at + count - 1, at + point - 1, -1):
        out[place + 1] = out[place]
    out[at + point] = 46
    return at + count + 1


@compiled
def _with_exponent(out: Any, at: int, count: int, exponent: int) -> Any:
    """Digits that stand at `at` as 1.5e+17."""
    if count > 1:
        for place in range(at + count - 1, at, -1):
            out[place + 1] = out[place]
        out[at + 1] = 46
        count += 1
    end = at + count
    out[end] = 101
    out[end + 1] = 45 if exponent < 0 else 43
    exponent = abs(exponent)
    if exponent < 10:
        out[end + 2] = 48
        end += 1
    return write_whole(out, end + 2, np.uint64(exponent))
