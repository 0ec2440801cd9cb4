"""Eight numbers side by side as one: where they lie, what chooses among them, and elementary functions of them.

Vector instructions work on eight spectra, or eight rovers, at once: `load` and `store` move eight neighbouring numbers
of an array, `Fields` names the rows of a table of them, and +, -, *, / and the functions here work on them, also
together with a plain number. Where the processor has shorter registers the compiler uses several.

Calls into the C library would hold a loop to one argument at a time. Sines, exponentials and logarithms are sums
without branches instead, exact to a few units in the last place within their ranges. Series: Abramowitz & Stegun
(1964), 4.1.24, 4.2.1, 4.3.65, 4.3.66, 4.4.34, 4.4.42; arguments are reduced as by Cody & Waite (1980), Software Manual
for the Elementary Functions, ch. 5 and 6.

It is our own since numba has no type for eight numbers side by side; fits and drives in lanes were measured several
times as fast as one after the other.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from lunarsci.arrays import FloatArray
from lunarsci.compiled.formulas import (
    DOUBLE,
    DOUBLES,
    INTEGER,
    LANES,
    SINGLES,
    Traced,
    TracedMask,
    TracedNumber,
    alike,
    formula,
    in_every_lane,
    rounded,
)

LINE = 64
"""Bytes of a cache line: a row of eight that lies across two of them costs two reads."""


class FloatLayout(NamedTuple):
    """How numbers are stored (IEEE 754), and how exponentials of them are made.

    Attributes
    ----------
    mantissa_bits, bias : bits of the mantissa, and by how much the exponent is stored too large.
    largest : beyond it, to either side, an exponential is taken as there.
    ln_2 : in two parts, the first with trailing zeros, so that whole multiples of it are exact.
    rest : coefficients of (exp(y) - 1 - y - y^2/2) / y^3 within half ln 2.
    """

    mantissa_bits: int
    bias: int
    largest: float
    ln_2: tuple[float, float]
    rest: tuple[float, ...]

    @property
    def rounding(self) -> float:
        """Added to a small integer, leaves that integer in the lowest bits of the sum."""
        return 1.5 * 2.0**self.mantissa_bits


@formula
def load(array: Any, row: Any) -> Any:
    """Row `row` of an array of eight columns."""
    if isinstance(array, np.ndarray):
        return array[row].copy()
    return TracedNumber(array.builder, array.builder.load(array.row(row), align=8))


@formula
def store(array: Any, row: Any, value: Any) -> None:
    """Write row `row` of an array of eight columns."""
    if isinstance(array, np.ndarray):
        array[row] = value
    else:
        made = rounded(array.builder, value.value) if array.eight == SINGLES else value.value
        array.builder.store(made, array.row(row), align=8)


@formula
def spread(number: Any) -> Any:
    """A plain number in every lane."""
    if not isinstance(number, TracedNumber):
        return np.full(LANES, float(number))
    return TracedNumber(number.builder, in_every_lane(number.builder, number.value))


@formula
def filled(array: Any, number: Any) -> Any:
    """A plain number in every lane, as exact as the numbers of an array are."""
    if isinstance(array, np.ndarray):
        return np.full(LANES, number, array.dtype)
    every = in_every_lane(array.builder, number.value)
    return TracedNumber(array.builder, rounded(array.builder, every) if array.eight == SINGLES else every)


@formula
def negligible(array: Any) -> Any:
    """The x of which exp(-x) is some units in the last place of 1, for numbers of an array's kind."""
    double = array.dtype == np.float64 if isinstance(array, np.ndarray) else array.eight == DOUBLES
    return LN_2_HIGH * (DOUBLES_LAYOUT if double else SINGLES_LAYOUT).mantissa_bits


@formula
def choose(condition: Any, one: Any, other: Any) -> Any:
    """`one` in lanes where a condition holds, or a number is above 0, else `other`."""
    if isinstance(condition, bool):
        return one if condition else other
    if not isinstance(condition, Traced):
        return np.where(np.asarray(condition) > 0, one, other)[()]
    condition = condition > 0.0 if isinstance(condition, TracedNumber) else condition
    builder = condition.builder
    plain = TracedNumber(builder, DOUBLE(0.0))
    first, second = plain.like(one), plain.like(other)
    if isinstance(condition.value.type, ir.VectorType):
        return TracedNumber(builder, builder.select(*alike(condition, first, second)))
    return TracedNumber(builder, builder.select(condition.value, *alike(first, second)))


@formula
def is_above(values: Any, limit: Any) -> Any:
    """Whether any of eight numbers is above a limit, which a number without meaning is not."""
    above = values > limit
    if not isinstance(above, TracedMask):
        return bool(np.any(above))
    bits = above.builder.bitcast(above.value, ir.IntType(LANES))
    return TracedMask(above.builder, above.builder.icmp_unsigned("!=", bits, ir.IntType(LANES)(0)))


@formula
def lowest(first: Any, second: Any) -> Any:
    """The first where it is below the second, which a number without meaning is not, else the second."""
    return choose(first < second, first, second)


@formula
def highest(first: Any, second: Any) -> Any:
    """The first where it is above the second, which a number without meaning is not, else the second."""
    return choose(first > second, first, second)


@formula
def root(x: Any) -> Any:
    """The square root."""
    return x.called("sqrt") if isinstance(x, TracedNumber) else np.sqrt(x)


@formula
def nearest(x: Any) -> Any:
    """The nearest whole number."""
    return x.called("rint") if isinstance(x, TracedNumber) else np.rint(x)


@formula
def signed(x: Any, sign: Any) -> Any:
    """The size of one number with the sign of another, be it that of a zero."""
    if not isinstance(sign, TracedNumber):
        return np.copysign(x, sign)
    return TracedNumber(sign.builder, alike(sign.like(x), sign)[0]).called("copysign", sign)


@formula
def two_to(power: Any) -> Any:
    """2^k of whole numbers k between -1022 and 1023, of singles -126 and 127."""
    layout = _layout(power)
    if not isinstance(power, TracedNumber):
        power = np.asarray(power, np.float64)
    low = power + (layout.rounding + layout.bias)
    if not isinstance(power, TracedNumber):
        return (low.view(np.int64) << layout.mantissa_bits).view(np.float64)[()]
    return low.from_bits(power.builder.shl(low.bits, power.whole(layout.mantissa_bits)))


@formula
def exponent_of(value: Any) -> Any:
    """The whole k of value = 2^k m with m from 1 to 2; for positive normal numbers."""
    if not isinstance(value, TracedNumber):
        return np.frexp(value)[1] - 1.0
    bits, bias, *_ = _layout(value)
    high = value.builder.or_(value.builder.lshr(value.bits, value.whole(bits)), value.whole((bias + bits) << bits))
    return value.from_bits(high) - (2.0**bits + bias)


@formula
def mantissa_of(value: Any) -> Any:
    """The m of value = 2^k m with m from 1 to 2; for positive normal numbers."""
    if not isinstance(value, TracedNumber):
        return 2.0 * np.frexp(value)[0]
    bits, bias, *_ = _layout(value)
    low = value.builder.and_(value.bits, value.whole((1 << bits) - 1))
    return value.from_bits(value.builder.or_(low, value.whole(bias << bits)))


def _layout(value: Any) -> FloatLayout:
    """Of a number's kind; in Python all are doubles."""
    return SINGLES_LAYOUT if isinstance(value, TracedNumber) and value.is_single else DOUBLES_LAYOUT


def aligned(rows: int, columns: int = LANES, kind: type[np.floating[Any]] = np.float64) -> Any:
    """Zeros, (rows, columns), of doubles or singles; the first lies at the start of a cache line."""
    size = np.dtype(kind).itemsize
    room = np.zeros(rows * columns + LINE // size, kind)
    first = -room.ctypes.data % LINE // size
    return room[first : first + rows * columns].reshape(rows, columns)


class Fields:
    """Names of the rows of a table: for each its first row, and how many there are.

    Parameters
    ----------
    width : numbers of a row, a multiple of eight.
    sizes : rows of each name.
    """

    def __init__(self, width: int, **sizes: int) -> None:
        self.width, self.sizes = width, sizes
        ends = np.cumsum(list(sizes.values())).tolist()
        self.first = {name: end - size for end, (name, size) in zip(ends, sizes.items(), strict=True)}
        self.rows: int = ends[-1]

    def of(self, table: Any, *index: Any) -> "NamedRows":
        """What a formula reads and writes by name: eight columns of the rows, the last of `index` the first of them."""
        return (_ArrayRow if isinstance(table, np.ndarray) else _TracedRow)(self, table, index)

    def view(self, table: FloatArray, name: str) -> FloatArray:
        """Rows of a name, (..., rows, width), or (..., width) where there is one."""
        rows = table.reshape(*table.shape[:-1], self.rows, self.width)[..., self.first[name] :, :]
        return rows[..., : self.sizes[name], :] if self.sizes[name] > 1 else rows[..., 0, :]


class NamedRows:
    """Numbers by name, those of several rows as a tuple; see `Fields`.

    A name that is read or written is eight numbers: an array (8,) in Python, a stand-in while code is made. What was
    read is not read again; what is written is written at once.
    """

    def __init__(self, fields: Fields, table: Any, index: Any) -> None:
        self.__dict__.update(_fields=fields, _seen={})
        self._begin(table, index)

    def __getattr__(self, name: str) -> Any:
        if name not in self._seen:
            first, size = self._fields.first[name], self._fields.sizes[name]
            values = tuple(self._load(first + k) for k in range(size))
            self._seen[name] = values if size > 1 else values[0]
        return self._seen[name]

    def __setattr__(self, name: str, value: Any) -> None:
        first, size = self._fields.first[name], self._fields.sizes[name]
        values = value if isinstance(value, tuple) else (value,)
        stored = tuple(self._store(row, one) for row, one in zip(range(first, first + size), values, strict=True))
        self._seen[name] = stored if len(stored) > 1 else stored[0]


class _TracedRow(NamedRows):
    """Of a table in code that is being made."""

    def _begin(self, table: Any, index: Any) -> None:
        self.__dict__.update(_builder=table.builder, _first=table.lanes(*index))

    def _place(self, row: int) -> ir.Value:
        return self._builder.gep(self._first, [INTEGER(row * self._fields.width // LANES)])

    def _load(self, row: int) -> TracedNumber:
        return TracedNumber(self._builder, self._builder.load(self._place(row), align=8))

    def _store(self, row: int, value: Any) -> TracedNumber:
        zero = TracedNumber(self._builder, ir.Constant(DOUBLES, [0.0] * LANES))
        number = TracedNumber(self._builder, alike(zero.like(value), zero)[0])
        self._builder.store(number.value, self._place(row), align=8)
        return number


class _ArrayRow(NamedRows):
    """Of an array in Python."""

    def _begin(self, table: Any, index: Any) -> None:
        rows = table[index[:-1]].reshape(self._fields.rows, self._fields.width)
        self.__dict__.update(_rows=rows[:, index[-1] : index[-1] + LANES])

    def _load(self, row: int) -> Any:
        return self._rows[row].copy()

    def _store(self, row: int, value: Any) -> Any:
        self._rows[row] = value
        return self._load(row)


LN_2_HIGH, LN_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""ln 2 in two parts, the first with trailing zeros, so that whole multiples of it are exact."""
PER_LN_2 = 1 / math.log(2)
"""Turns a natural logarithm into one of base 2."""
ROOT_2 = math.sqrt(2)
"""Mantissa above which a logarithm is taken of its half."""
LOGARITHM_ORDER = 21
"""Power to which its series goes; the next one is below the last digit."""
WIDEST_ANGLE = 1.7
"""Up to which sines and cosines are exact; assumed, more than any angle of a wheel. [rad]"""
_HALF_LN_2 = math.log(2) / 2
"""Largest argument of the series of an exponential, beside a power of 2."""


def _interpolated(terms: Callable[[int], float], count: int, low: float, high: float) -> tuple[float, ...]:
    """Coefficients of a polynomial of `count` terms through a power series, of 40 `terms`, at Chebyshev's points."""

    def series(x: FloatArray) -> FloatArray:
        return np.asarray(sum(terms(n) * x**n for n in range(40)))

    polynomial = np.polynomial.Chebyshev.interpolate(series, count - 1, [low, high])
    return tuple(polynomial.convert(kind=np.polynomial.Polynomial).coef.tolist())


REST_OF_SINE = _interpolated(lambda n: (-1) ** (n + 1) / math.factorial(2 * n + 3), 8, 0.0, WIDEST_ANGLE**2)
"""Of (sin(x) - x) / x^3 by x^2 (Abramowitz & Stegun 1964, 4.3.65)."""
REST_OF_COSINE = _interpolated(lambda n: (-1) ** n / math.factorial(2 * n + 4), 8, 0.0, WIDEST_ANGLE**2)
"""Of (cos(x) - 1 + x^2/2) / x^4 by x^2 (Abramowitz & Stegun 1964, 4.3.66)."""
REST_OF_ARCTANGENT = _interpolated(lambda n: (-1) ** (n + 1) / (2 * n + 3), 12, 0.0, math.tan(math.pi / 8) ** 2)
"""Of (arctan(t) - t) / t^3 by t^2, for t up to tan(pi/8) (Abramowitz & Stegun 1964, 4.4.42)."""


def _rest_of_exponential(count: int) -> tuple[float, ...]:
    """Of (exp(y) - 1 - y - y^2/2) / y^3 within half ln 2."""
    return _interpolated(lambda n: 1 / math.factorial(n + 3), count, -_HALF_LN_2, _HALF_LN_2)


DOUBLES_LAYOUT = FloatLayout(52, 1023, 700.0, (LN_2_HIGH, LN_2_LOW), _rest_of_exponential(9))
"""Leaves 3e-17 of an exponential."""
SINGLES_LAYOUT = FloatLayout(23, 127, 86.0, (0.693359375, math.log(2) - 0.693359375), _rest_of_exponential(4))
"""Leaves 2e-8 of an exponential."""


def _polynomial(coefficients: tuple[float, ...], x: Any) -> Any:
    """The sum of coefficients times powers of x, the lowest first."""
    *others, value = coefficients
    for coefficient in reversed(others):
        value = value * x + coefficient
    return value


@formula
def sine(x: Any) -> Any:
    """sin x for |x| up to 1.7, to 6e-16 of it."""
    q = x * x
    return x + x * (q * _polynomial(REST_OF_SINE, q))


@formula
def cosine(x: Any) -> Any:
    """cos x for |x| up to 1.7, to 3e-16."""
    q = x * x
    return 1.0 - (0.5 * q - q * q * _polynomial(REST_OF_COSINE, q))


@formula
def arcsin(x: Any) -> Any:
    """arcsin x for 0 to sqrt(1/2), to 4e-16 of it: twice the arcus tangent of x / (1 + sqrt(1 - x^2))."""
    t = x / (1.0 + root(1.0 - x * x))
    q = t * t
    return 2.0 * (t + t * (q * _polynomial(REST_OF_ARCTANGENT, q)))


def _exponential(x: Any) -> Any:
    """2^k, and what exp(x) / 2^k is more than 1, with k the whole number nearest to x / ln 2."""
    layout = _layout(x)
    x = lowest(layout.largest, highest(-layout.largest, x))
    k = nearest(x * PER_LN_2)
    y = (x - k * layout.ln_2[0]) - k * layout.ln_2[1]
    return two_to(k), _polynomial((1.0, 0.5, *layout.rest), y) * y


@formula
def exp_minus_one(x: Any) -> Any:
    """exp(x) - 1; x beyond +-700, of singles +-86, is taken as that."""
    power, rest = _exponential(x)
    return power * rest + (power - 1)


@formula
def exponential(x: Any) -> Any:
    """exp(x); x beyond +-700, of singles +-86, is taken as that."""
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
    series = _polynomial(tuple(2 / power for power in range(3, LOGARITHM_ORDER + 1, 2)), q)
    return k * LN_2_HIGH + (k * LN_2_LOW + (series * q * s + s * 2))
