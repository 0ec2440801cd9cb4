"""Eight numbers side by side as one, for compiled code: the same formula for eight spectra at once.

Loops over the entries of small matrices are too short for vector instructions; with one spectrum per lane every
operation is one. Arrays of such numbers have eight columns, `load` and `store` count their rows. The operators +, -, *
and / work on them, also together with a plain number. Where the processor has shorter registers the compiler uses
several.
"""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from lunarsci.arrays import FloatArray

__all__ = [
    "LANES", "aligned", "choose", "exponent_of", "highest", "load", "lowest", "mantissa_of", "nearest", "root",
    "spread", "store", "two_to",
]  # fmt: skip

LANES = 8
LINE = 64
"""Bytes of a cache line: a row of eight that lies across two of them costs two reads."""
FUSED = ("contract",)
"""a * b + c may be one instruction; nothing else is changed, so that a lane gives what the formula says."""

DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
INTEGERS = ir.VectorType(ir.IntType(64), LANES)
MANTISSA_BITS, BIAS = 52, 1023
ROUNDING = 1.5 * 2.0**MANTISSA_BITS
"""Added to an integer below 2^51, leaves that integer in the lowest bits of the sum."""


def aligned(rows: int) -> FloatArray:
    """Zeros, (rows, 8), each row in a cache line of its own."""
    room = np.zeros(rows * LANES + LINE // 8)
    first = -room.ctypes.data % LINE // 8
    return room[first : first + rows * LANES].reshape(rows, LANES)


class Lanes(types.Type):
    """Numba's type of eight doubles."""

    def __init__(self) -> None:
        super().__init__(name="eight doubles")


EIGHT = Lanes()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, DOUBLES)


def _same(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    """A plain number in every lane."""
    one = builder.insert_element(ir.Constant(DOUBLES, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def _define(symbol: Callable[[Any, Any], Any], instruction: str) -> None:
    """One arithmetic operator: between eights, and between an eight and a plain number."""

    @type_callable(symbol)  # type: ignore[untyped-decorator]
    def typed(_: Any) -> Callable[[Any, Any], Any]:
        def result(left: Any, right: Any) -> Any:
            kinds = (left, right)
            if EIGHT in kinds and all(kind == EIGHT or isinstance(kind, types.Float) for kind in kinds):
                return EIGHT
            return None

        return result

    def lowered(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        left, right = (
            value if kind == EIGHT else _same(builder, context.cast(builder, value, kind, types.float64))
            for value, kind in zip(arguments, signature.args, strict=True)
        )
        return getattr(builder, instruction)(left, right, flags=FUSED)

    for kinds in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(symbol, *kinds)(lowered)


for _symbol, _inplace, _instruction in (
    (operator.add, operator.iadd, "fadd"),
    (operator.sub, operator.isub, "fsub"),
    (operator.mul, operator.imul, "fmul"),
    (operator.truediv, operator.itruediv, "fdiv"),
):
    _define(_symbol, _instruction)
    _define(_inplace, _instruction)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, row: Any) -> Any:
    first = context.make_array(kind)(context, builder, array).data
    return builder.gep(builder.bitcast(first, DOUBLES.as_pointer()), [row])


@intrinsic  # type: ignore[untyped-decorator]
def load(_: Any, array: Any, row: Any) -> Any:
    """Row `row` of an array of eight columns."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_pointer(context, builder, signature.args[0], *arguments), align=8)

    return EIGHT(array, types.intp), code


@intrinsic  # type: ignore[untyped-decorator]
def store(_: Any, array: Any, row: Any, value: Any) -> Any:
    """Write row `row` of an array of eight columns."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
        builder.store(arguments[2], pointer, align=8)
        return context.get_dummy_value()

    return types.none(array, types.intp, EIGHT), code


@intrinsic  # type: ignore[untyped-decorator]
def spread(_: Any, number: Any) -> Any:
    """A plain number in every lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _same(builder, arguments[0])

    return EIGHT(types.float64), code


@intrinsic  # type: ignore[untyped-decorator]
def choose(_: Any, condition: Any, where_above_zero: Any, elsewhere: Any) -> Any:
    """`where_above_zero` in lanes in which `condition` is above 0, else `elsewhere`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        above = builder.fcmp_ordered(">", arguments[0], ir.Constant(DOUBLES, [0.0] * LANES))
        return builder.select(above, arguments[1], arguments[2])

    return EIGHT(EIGHT, EIGHT, EIGHT), code


def _extreme(comparison: str) -> Any:
    def chosen(_: Any, first: Any, second: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.select(builder.fcmp_ordered(comparison, *arguments), *arguments)

        return EIGHT(EIGHT, EIGHT), code

    return chosen


lowest, highest = intrinsic(_extreme("<")), intrinsic(_extreme(">"))


def _library(name: str) -> Any:
    def called(_: Any, value: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kind = ir.FunctionType(DOUBLES, [DOUBLES])
            return builder.call(get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), arguments)

        return EIGHT(EIGHT), code

    return called


root, nearest = intrinsic(_library("sqrt")), intrinsic(_library("rint"))


def _integers(number: int) -> ir.Constant:
    return ir.Constant(INTEGERS, [number] * LANES)


@intrinsic  # type: ignore[untyped-decorator]
def two_to(_: Any, power: Any) -> Any:
    """2^k of whole numbers k between -1022 and 1023."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        low = builder.fadd(arguments[0], ir.Constant(DOUBLES, [ROUNDING + BIAS] * LANES))
        bits = builder.shl(builder.bitcast(low, INTEGERS), _integers(MANTISSA_BITS))
        return builder.bitcast(bits, DOUBLES)

    return EIGHT(EIGHT), code


@intrinsic  # type: ignore[untyped-decorator]
def exponent_of(_: Any, value: Any) -> Any:
    """The whole k of value = 2^k m with m from 1 to 2; for positive numbers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.lshr(builder.bitcast(arguments[0], INTEGERS), _integers(MANTISSA_BITS))
        high = builder.or_(bits, _integers((BIAS + MANTISSA_BITS) << MANTISSA_BITS))
        shift = ir.Constant(DOUBLES, [2.0**MANTISSA_BITS + BIAS] * LANES)
        return builder.fsub(builder.bitcast(high, DOUBLES), shift)

    return EIGHT(EIGHT), code


@intrinsic  # type: ignore[untyped-decorator]
def mantissa_of(_: Any, value: Any) -> Any:
    """The m of value = 2^k m with m from 1 to 2; for positive numbers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.and_(builder.bitcast(arguments[0], INTEGERS), _integers((1 << MANTISSA_BITS) - 1))
        one = builder.or_(bits, _integers(BIAS << MANTISSA_BITS))
        return builder.bitcast(one, DOUBLES)

    return EIGHT(EIGHT), code
