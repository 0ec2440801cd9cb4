"""Eight numbers side by side as one, and formulas that are written once for them, for plain numbers and for arrays.

Vector instructions work on eight spectra, or eight rovers, at once: `load` and `store` move eight neighbouring numbers
of an array, and +, -, *, / and the functions here work on them, also together with a plain number. Where the processor
has shorter registers the compiler uses several.

A `formula` is a plain Python function of such numbers. As compiled code that calls it is made, it is run once, with
stand-ins that note every operation as an instruction: no types have to be found and no loops be turned into vectors, so
that it costs little to compile. Loops and conditions in it are therefore those of Python and cannot depend on a number;
`choose` can. Called from Python it works on floats and NumPy arrays.
"""

import inspect
import operator
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types, typing
from numba.core.cgutils import get_or_insert_function
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import models, register_model

from lunarsci.arrays import FloatArray

LANES = 8
LINE = 64
"""Bytes of a cache line: a row of eight that lies across two of them costs two reads."""
FUSED = ("contract",)
"""a * b + c may be one instruction; nothing else is changed, so that a lane gives what the formula says."""
MANTISSA_BITS, BIAS = 52, 1023
ROUNDING = 1.5 * 2.0**MANTISSA_BITS
"""Added to an integer below 2^51, leaves that integer in the lowest bits of the sum."""

DOUBLE, INTEGER = ir.DoubleType(), ir.IntType(64)
DOUBLES = ir.VectorType(DOUBLE, LANES)
Function = TypeVar("Function", bound=Callable[..., Any])


class Lanes(types.Type):
    """Numba's type of eight doubles."""

    def __init__(self) -> None:
        super().__init__(name="eight doubles")


EIGHT = Lanes()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, DOUBLES)


class Traced:
    """A value that code being made will have: of an LLVM type, from the instruction `value`."""

    __slots__ = ("builder", "value")
    __array_ufunc__ = None

    def __init__(self, builder: ir.IRBuilder, value: ir.Value) -> None:
        self.builder, self.value = builder, value

    def __bool__(self) -> bool:
        raise TypeError("a formula cannot branch on a number; take `choose`, `lowest` or `highest`")

    def called(self, name: str, *others: "Traced") -> "Traced":
        """What an intrinsic function of LLVM makes of this and others."""
        kind, short = self.value.type, "f64" if self.value.type == DOUBLE else f"v{LANES}f64"
        known = ir.FunctionType(kind, [kind] * (1 + len(others)))
        function = get_or_insert_function(self.builder.module, known, f"llvm.{name}.{short}")
        return type(self)(self.builder, self.builder.call(function, [self.value, *(other.value for other in others)]))


class Mask(Traced):
    """Yes or no, in every lane."""

    def __and__(self, other: Any) -> Any:
        return Mask(self.builder, self.builder.and_(*_alike(self, self._like(other))))

    def __or__(self, other: Any) -> Any:
        return Mask(self.builder, self.builder.or_(*_alike(self, self._like(other))))

    def __invert__(self) -> Any:
        return Mask(self.builder, self.builder.xor(*_alike(self, self._like(True))))

    __rand__, __ror__ = __and__, __or__

    def _like(self, other: Any) -> "Mask":
        return other if isinstance(other, Mask) else Mask(self.builder, ir.IntType(1)(bool(other)))


class Whole(Traced):
    """A plain whole number: an index, or one of a few choices."""

    def __eq__(self, other: object) -> Any:
        value = other.value if isinstance(other, Whole) else INTEGER(other)
        return Mask(self.builder, self.builder.icmp_signed("==", self.value, value))

    def __ne__(self, other: object) -> Any:
        return ~(self == other)

    __hash__ = None  # type: ignore[assignment]


class Number(Traced):
    """A double, or eight of them."""

    def __add__(self, other: Any) -> Any:
        return self._with(other, "fadd")

    def __sub__(self, other: Any) -> Any:
        return self._with(other, "fsub")

    def __mul__(self, other: Any) -> Any:
        return self._with(other, "fmul")

    def __truediv__(self, other: Any) -> Any:
        return self._with(other, "fdiv")

    def __radd__(self, other: Any) -> Any:
        return self.like(other) + self

    def __rsub__(self, other: Any) -> Any:
        return self.like(other) - self

    def __rmul__(self, other: Any) -> Any:
        return self.like(other) * self

    def __rtruediv__(self, other: Any) -> Any:
        return self.like(other) / self

    def __neg__(self) -> Any:
        return Number(self.builder, self.builder.fneg(self.value))

    def __abs__(self) -> Any:
        return self.called("fabs")

    def __lt__(self, other: Any) -> Any:
        return self._compared(other, "<")

    def __gt__(self, other: Any) -> Any:
        return self._compared(other, ">")

    def __le__(self, other: Any) -> Any:
        return self._compared(other, "<=")

    def __ge__(self, other: Any) -> Any:
        return self._compared(other, ">=")

    def __eq__(self, other: object) -> Any:
        return self._compared(other, "==")

    __hash__ = None  # type: ignore[assignment]

    def like(self, other: Any) -> "Number":
        """A plain number beside this one."""
        return other if isinstance(other, Number) else Number(self.builder, ir.Constant(DOUBLE, float(other)))

    def _with(self, other: Any, instruction: str) -> Any:
        return Number(self.builder, getattr(self.builder, instruction)(*_alike(self, self.like(other)), flags=FUSED))

    def _compared(self, other: Any, how: str) -> Any:
        return Mask(self.builder, self.builder.fcmp_ordered(how, *_alike(self, self.like(other))))

    @property
    def bits(self) -> ir.Value:
        """The same bits as whole numbers."""
        return self.builder.bitcast(self.value, INTEGER if self.value.type == DOUBLE else ir.VectorType(INTEGER, LANES))

    def whole(self, number: int) -> ir.Constant:
        """A whole number for `bits`."""
        one = INTEGER(number)
        return one if self.value.type == DOUBLE else ir.Constant(ir.VectorType(INTEGER, LANES), [number] * LANES)

    def from_bits(self, bits: ir.Value) -> "Number":
        return Number(self.builder, self.builder.bitcast(bits, self.value.type))


def _same(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """A plain value in every lane."""
    if isinstance(value, ir.Constant) and value.type == DOUBLE:
        return ir.Constant(DOUBLES, [value.constant] * LANES)
    one = builder.insert_element(ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def _alike(*values: Traced) -> list[ir.Value]:
    """Values of one shape: all plain, or all of eight."""
    wide = any(isinstance(value.value.type, ir.VectorType) for value in values)
    return [
        _same(value.builder, value.value) if wide and not isinstance(value.value.type, ir.VectorType) else value.value
        for value in values
    ]


class Table(Traced):
    """An array; its numbers are read by whole indices."""

    __slots__ = ("context", "kind")

    def __init__(self, context: Any, builder: ir.IRBuilder, kind: types.Array, value: ir.Value) -> None:
        super().__init__(builder, value)
        self.context, self.kind = context, kind

    def at(self, *index: "Whole | int") -> ir.Value:
        """Where an entry lies."""
        array = self.context.make_array(self.kind)(self.context, self.builder, self.value)
        places = [i.value if isinstance(i, Whole) else INTEGER(i) for i in index]
        return cgutils.get_item_pointer(self.context, self.builder, self.kind, array, places)

    def __getitem__(self, index: Any) -> Number:
        return Number(self.builder, self.builder.load(self.at(*(index if isinstance(index, tuple) else (index,)))))

    def lanes(self, *index: "Whole | int") -> ir.Value:
        """Where eight neighbouring numbers lie, from an entry on."""
        return self.builder.bitcast(self.at(*index), DOUBLES.as_pointer())


def _plain_tuple(*entries: Any) -> tuple[Any, ...]:
    return entries


def _traced(context: Any, builder: ir.IRBuilder, kind: Any, value: ir.Value) -> Any:
    """The stand-in of an argument."""
    if isinstance(kind, types.Literal):
        return kind.literal_value
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        entries = (_traced(context, builder, part, builder.extract_value(value, k)) for k, part in enumerate(kind))
        return getattr(kind, "instance_class", _plain_tuple)(*entries)
    if isinstance(kind, types.Array):
        return Table(context, builder, kind, value)
    if kind == types.boolean:
        return Mask(builder, value)
    if isinstance(kind, types.Integer):
        return Whole(builder, context.cast(builder, value, kind, types.int64))
    if kind == EIGHT:
        return Number(builder, value)
    return Number(builder, context.cast(builder, value, kind, types.float64))


def _kind(result: Any) -> Any:
    """Numba's type of what a formula gave."""
    if isinstance(result, tuple):
        return types.Tuple([_kind(part) for part in result])  # type: ignore[attr-defined]
    if result is None:
        return types.none
    if isinstance(result, Number):
        return types.float64 if result.value.type == DOUBLE else EIGHT
    return types.boolean if isinstance(result, Mask) else types.float64


def _value(context: Any, builder: ir.IRBuilder, result: Any) -> ir.Value:
    """What a formula gave, as a value of numba's."""
    if isinstance(result, tuple):
        return context.make_tuple(builder, _kind(result), [_value(context, builder, part) for part in result])
    if result is None:
        return context.get_dummy_value()
    return result.value if isinstance(result, Traced) else ir.Constant(DOUBLE, float(result))


def _result_kind(function: Callable[..., Any], kinds: Sequence[Any]) -> Any:
    """Numba's type of what a formula gives for arguments of these types: it is run, and its code thrown away."""
    context = cpu_target.target_context
    scratch = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "scratch")
    builder = ir.IRBuilder(scratch.append_basic_block())
    unknown = [ir.Constant(context.get_value_type(kind), ir.Undefined) for kind in kinds]
    return _kind(function(*map(partial(_traced, context, builder), kinds, unknown)))


def _offer(
    symbol: Any,
    function: Callable[..., Any],
    allowed: Callable[[Sequence[Any]], bool],
    forms: Sequence[Sequence[Any]] = ((types.VarArg(types.Any),),),  # type: ignore[attr-defined]
) -> None:
    """Let compiled code that calls `symbol` have the instructions of `function`."""
    known: dict[Any, Any] = {}

    class Written(AbstractTemplate):  # type: ignore[misc]
        key = symbol
        prefer_literal = True

        def generic(self, args: Any, kws: Any) -> Any:
            if kws:
                raise TypingError("a formula takes its arguments by their places")
            if not allowed(args):
                return None
            if args not in known:
                known[args] = typing.signature(_result_kind(function, args), *args)
            return known[args]

    def lowered(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _value(context, builder, function(*map(partial(_traced, context, builder), signature.args, arguments)))

    infer_global(symbol, types.Function(Written))
    for form in forms:
        lower_builtin(symbol, *form)(lowered)


def formula(function: Function) -> Function:
    """Let compiled code call a function of numbers; see the text of this module."""
    count = len(inspect.signature(function).parameters)
    _offer(function, function, lambda args: len(args) == count)
    return function


def _eight_or_plain(kinds: Sequence[Any]) -> bool:
    return EIGHT in kinds and all(kind == EIGHT or isinstance(kind, types.Float) for kind in kinds)


for _symbol, _inplace in (
    (operator.add, operator.iadd),
    (operator.sub, operator.isub),
    (operator.mul, operator.imul),
    (operator.truediv, operator.itruediv),
):
    for _name in (_symbol, _inplace):
        _offer(_name, _symbol, _eight_or_plain, ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)))


@formula
def load(array: Any, row: Any) -> Any:
    """Row `row` of an array of eight columns."""
    if isinstance(array, np.ndarray):
        return array[row]
    return Number(array.builder, array.builder.load(array.lanes(row, 0), align=8))


@formula
def store(array: Any, row: Any, value: Any) -> None:
    """Write row `row` of an array of eight columns."""
    if isinstance(array, np.ndarray):
        array[row] = value
    else:
        array.builder.store(value.value, array.lanes(row, 0), align=8)


@formula
def spread(number: Any) -> Any:
    """A plain number in every lane."""
    if not isinstance(number, Number):
        return np.full(LANES, float(number))
    return Number(number.builder, _same(number.builder, number.value))


@formula
def choose(condition: Any, one: Any, other: Any) -> Any:
    """`one` in lanes where a condition holds, or a number is above 0, else `other`."""
    if isinstance(condition, bool):
        return one if condition else other
    if not isinstance(condition, Traced):
        return np.where(np.asarray(condition) > 0, one, other)[()]
    condition = condition > 0.0 if isinstance(condition, Number) else condition
    builder = condition.builder
    plain = Number(builder, ir.Constant(DOUBLE, 0.0))
    first, second = plain.like(one), plain.like(other)
    if isinstance(condition.value.type, ir.VectorType):
        return Number(builder, builder.select(*_alike(condition, first, second)))
    return Number(builder, builder.select(condition.value, *_alike(first, second)))


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
    return x.called("sqrt") if isinstance(x, Number) else np.sqrt(x)


@formula
def nearest(x: Any) -> Any:
    """The nearest whole number."""
    return x.called("rint") if isinstance(x, Number) else np.rint(x)


@formula
def signed(x: Any, sign: Any) -> Any:
    """The size of one number with the sign of another, be it that of a zero."""
    if not isinstance(sign, Number):
        return np.copysign(x, sign)
    return Number(sign.builder, _alike(sign.like(x), sign)[0]).called("copysign", sign)


@formula
def two_to(power: Any) -> Any:
    """2^k of whole numbers k between -1022 and 1023."""
    low = power + (ROUNDING + BIAS)
    if not isinstance(power, Number):
        return (np.asarray(low).view(np.int64) << MANTISSA_BITS).view(np.float64)[()]
    return low.from_bits(power.builder.shl(low.bits, power.whole(MANTISSA_BITS)))


@formula
def exponent_of(value: Any) -> Any:
    """The whole k of value = 2^k m with m from 1 to 2; for positive normal numbers."""
    if not isinstance(value, Number):
        return np.frexp(value)[1] - 1.0
    bits = value.builder.lshr(value.bits, value.whole(MANTISSA_BITS))
    high = value.builder.or_(bits, value.whole((BIAS + MANTISSA_BITS) << MANTISSA_BITS))
    return value.from_bits(high) - (2.0**MANTISSA_BITS + BIAS)


@formula
def mantissa_of(value: Any) -> Any:
    """The m of value = 2^k m with m from 1 to 2; for positive normal numbers."""
    if not isinstance(value, Number):
        return 2.0 * np.frexp(value)[0]
    bits = value.builder.and_(value.bits, value.whole((1 << MANTISSA_BITS) - 1))
    return value.from_bits(value.builder.or_(bits, value.whole(BIAS << MANTISSA_BITS)))


def aligned(rows: int, columns: int = LANES) -> FloatArray:
    """Zeros, (rows, columns), each eight in a cache line of their own."""
    room = np.zeros(rows * columns + LINE // 8)
    first = -room.ctypes.data % LINE // 8
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

    def of(self, table: Any, *index: Any) -> "Row":
        """What a formula reads and writes by name: eight columns of the rows, the last of `index` the first of them."""
        return (_ArrayRow if isinstance(table, np.ndarray) else _TracedRow)(self, table, index)

    def view(self, table: FloatArray, name: str) -> FloatArray:
        """Rows of a name, (..., rows, width), or (..., width) where there is one."""
        rows = table.reshape(*table.shape[:-1], self.rows, self.width)[..., self.first[name] :, :]
        return rows[..., : self.sizes[name], :] if self.sizes[name] > 1 else rows[..., 0, :]


class Row:
    """Numbers by name, those of several rows as a tuple; see `Fields`."""

    def __init__(self, fields: Fields, table: Any, index: Any) -> None:
        self.__dict__.update(_fields=fields, _seen={})
        self._begin(table, index)

    def __getattr__(self, name: str) -> Any:
        if name not in self._seen:
            first, size = self._fields.first[name], self._fields.sizes[name]
            found = tuple(self._load(first + k) for k in range(size))
            self._seen[name] = found if size > 1 else found[0]
        return self._seen[name]

    def __setattr__(self, name: str, value: Any) -> None:
        first, size = self._fields.first[name], self._fields.sizes[name]
        values = value if isinstance(value, tuple) else (value,)
        stored = tuple(self._store(row, one) for row, one in zip(range(first, first + size), values, strict=True))
        self._seen[name] = stored if len(stored) > 1 else stored[0]


class _TracedRow(Row):
    def _begin(self, table: Any, index: Any) -> None:
        self.__dict__.update(_builder=table.builder, _first=table.lanes(*index))

    def _place(self, row: int) -> ir.Value:
        return self._builder.gep(self._first, [INTEGER(row * self._fields.width // LANES)])

    def _load(self, row: int) -> Number:
        return Number(self._builder, self._builder.load(self._place(row), align=8))

    def _store(self, row: int, value: Any) -> Number:
        zero = Number(self._builder, ir.Constant(DOUBLES, [0.0] * LANES))
        number = Number(self._builder, _alike(zero.like(value), zero)[0])
        self._builder.store(number.value, self._place(row), align=8)
        return number


class _ArrayRow(Row):
    def _begin(self, table: Any, index: Any) -> None:
        rows = table[index[:-1]].reshape(self._fields.rows, self._fields.width)
        self.__dict__.update(_rows=rows[:, index[-1] : index[-1] + LANES])

    def _load(self, row: int) -> Any:
        return self._rows[row].copy()

    def _store(self, row: int, value: Any) -> Any:
        self._rows[row] = value
        return self._load(row)
