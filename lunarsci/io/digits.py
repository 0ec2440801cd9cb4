"""Rows of a table as text, numbers with nine significant digits.

It is our own since pandas and Arrow write the shortest text of a double, which has to be rounded before, column after
column: wheel states of a thousand drives took pandas twenty times as long, and Arrow three times.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import compiled

DIGITS = 9
LEAST_POWER, LARGEST = -324, 308
"""Powers of ten that a double can be."""
POWERS = np.array([float(f"1e{power}") for power in range(LEAST_POWER, LARGEST + 1)])
"""Of ten, each the nearest double, 0 for the least."""
DECIMAL = (-6, 9)
"""Powers of ten of the first digit, from and to, that are written without an exponent, as Arrow does."""
WIDEST = 18
"""Bytes that a number and what is behind it may take."""
ZERO, MINUS, POINT, PLUS, COMMA, LINE, EXPONENT = b"0-.+,\ne"


@compiled(nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def rounded(value: float) -> Any:
    """The first nine digits of a finite number above 0 as a whole number, and the power of ten of the first."""
    _, exponent = math.frexp(value)
    power = max(math.floor((exponent - 1) * math.log10(2.0)), LEAST_POWER)
    power += power < LARGEST and value >= POWERS[power + 1 - LEAST_POWER]
    shift = DIGITS - 1 - power
    if shift < 0:
        number = np.int64(np.rint(value / POWERS[-shift - LEAST_POWER]))
    else:
        near = min(shift, LARGEST)
        number = np.int64(np.rint(value * POWERS[near - LEAST_POWER] * POWERS[shift - near - LEAST_POWER]))
    return (number // 10, power + 1) if number >= 10**DIGITS else (number, power)


@compiled(nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def put_number(text: Any, at: int, value: float) -> int:
    """Write a number, nothing where it is not finite, and return the place behind it."""
    if not math.isfinite(value):
        return at
    if math.copysign(1.0, value) < 0.0:
        text[at] = MINUS
        at += 1
    if value == 0.0:
        text[at] = ZERO
        return at + 1
    number, power = rounded(abs(value))
    count = DIGITS
    while number % 10 == 0:
        number, count = number // 10, count - 1
    plain = DECIMAL[0] <= power <= DECIMAL[1]
    # Figures behind the point, of these zeros before the first digit, and zeros before the point after the last one.
    behind = max(0, count - 1 - power) if plain else count - 1
    before = max(0, -power) if plain else 0
    after = max(0, power + 1 - count) if plain else 0
    end = at + before + count + after + (behind > 0)
    place = end - 1
    for _ in range(after):
        text[place] = ZERO
        place -= 1
    for n in range(before + count):
        if n == behind and n:
            text[place] = POINT
            place -= 1
        text[place] = ZERO + number % 10
        number, place = number // 10, place - 1
    return end if plain else put_power(text, end, power)


@compiled(nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def put_power(text: Any, at: int, power: int) -> int:
    """Write an exponent, and return the place behind it."""
    text[at], text[at + 1] = EXPONENT, MINUS if power < 0 else PLUS
    power, at = abs(power), at + 2
    places = 1 + (power > 9) + (power > 99)
    for n in range(places - 1, -1, -1):
        text[at + n], power = ZERO + power % 10, power // 10
    return at + places


@compiled(nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def put_rows(numbers: Any, codes: Any, order: Any, pool: Any, starts: Any, text: Any) -> int:
    """Write rows with commas between their cells, and return how many bytes they are.

    Parameters
    ----------
    numbers : (columns of numbers, n).
    codes : which text a cell has. (columns of texts, n)
    order : of each column k of the table, its row in `numbers`, or -1 less its row in `codes`. (columns,)
    pool, starts : all texts behind each other, (bytes,), and where each begins, and the last ends. (texts + 1,)
    text : takes the rows. (bytes,)
    """
    at = 0
    for row in range(max(numbers.shape[1], codes.shape[1])):
        for k in range(len(order)):
            if order[k] >= 0:
                at = put_number(text, at, numbers[order[k], row])
            else:
                code = codes[-1 - order[k], row]
                for n in range(starts[code], starts[code + 1]):
                    text[at] = pool[n]
                    at += 1
            text[at] = COMMA
            at += 1
        text[at - 1] = LINE
    return at
