"""How numba's compiled code calls a `formula`, and what eight numbers side by side are to it.

A module apart, since it imports numba: what is written with `formulas` does without until a compiled function
is called.
"""

import inspect
import operator
from collections.abc import Callable, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

from llvmlite import ir
from numba.core import types, typing
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import models, register_model

from lunarsci.compiled.formulas import (
    DOUBLE,
    DOUBLES,
    OFFERED,
    SINGLES,
    Traced,
    TracedMask,
    TracedNumber,
    TracedReal,
    TracedTable,
    TracedWhole,
)


class Lanes(types.Type):
    """Numba's type of eight numbers side by side: a vector of LLVM."""

    def __init__(self, vector: ir.VectorType) -> None:
        super().__init__(name=f"lanes {vector}")
        self.vector = vector


EIGHT = {vector: Lanes(vector) for vector in (DOUBLES, SINGLES)}
"""Of doubles and of singles."""


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    """How numba stores `Lanes`: as the vector that it is."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


def _plain_tuple(*entries: Any) -> tuple[Any, ...]:
    """As a NamedTuple is made of its entries."""
    return entries


def _traced(context: Any, builder: ir.IRBuilder, kind: Any, value: ir.Value) -> Any:
    """The stand-in of an argument: `kind` is numba's type, `value` LLVM's value; a literal stands for itself."""
    if isinstance(kind, types.Literal):
        return kind.literal_value
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        entries = (_traced(context, builder, part, builder.extract_value(value, k)) for k, part in enumerate(kind))
        return getattr(kind, "instance_class", _plain_tuple)(*entries)
    if isinstance(kind, types.Array):
        return TracedTable(context, builder, kind, value)
    if kind == types.boolean:
        return TracedMask(builder, value)
    if isinstance(kind, types.Integer):
        return TracedWhole(builder, context.cast(builder, value, kind, types.int64))
    if isinstance(kind, Lanes):
        return TracedNumber(builder, value)
    return TracedNumber(builder, context.cast(builder, value, kind, types.float64))


def _kind(result: Any) -> Any:
    """Numba's type of what a formula gave."""
    if isinstance(result, tuple):
        return types.Tuple([_kind(part) for part in result])  # type: ignore[attr-defined]
    if result is None:
        return types.none
    if isinstance(result, TracedNumber):
        return types.float64 if result.value.type == DOUBLE else EIGHT[result.value.type]
    return types.boolean if isinstance(result, TracedMask) else types.float64


def _value(context: Any, builder: ir.IRBuilder, result: Any) -> ir.Value:
    """What a formula gave, as a value of numba's."""
    if isinstance(result, tuple):
        return context.make_tuple(builder, _kind(result), [_value(context, builder, part) for part in result])
    if result is None:
        return context.get_dummy_value()
    if isinstance(result, TracedReal):
        return result.number.value
    return result.value if isinstance(result, Traced) else DOUBLE(float(result))


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
    """Let compiled code that calls `symbol` have the instructions of `function`.

    Parameters
    ----------
    symbol : the function or operator that compiled code names.
    function : formula that is run with stand-ins.
    allowed : whether it takes arguments of these types of numba's.
    forms : types of arguments that numba looks its code up by.
    """
    signatures: dict[Any, Any] = {}

    class Written(AbstractTemplate):  # type: ignore[misc]
        key = symbol
        prefer_literal = True
        metadata = MappingProxyType({"target": "cpu"})  # so that numba asks it before its dozens of others

        def generic(self, args: Any, kws: Any) -> Any:
            if kws:
                raise TypingError("a formula takes its arguments by their places")
            if not allowed(args):
                return None
            if args not in signatures:
                signatures[args] = typing.signature(_result_kind(function, args), *args)
            return signatures[args]

    def lowered(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _value(context, builder, function(*map(partial(_traced, context, builder), signature.args, arguments)))

    infer_global(symbol, types.Function(Written))
    for form in forms:
        lower_builtin(symbol, *form)(lowered)


def offer_all() -> None:
    """Let compiled code call every formula that there is by now."""
    while OFFERED:
        function = OFFERED.pop()
        count = len(inspect.signature(function).parameters)
        _offer(function, function, partial(_takes, count))


def _takes(count: int, arguments: Sequence[Any]) -> bool:
    """Whether there are as many arguments."""
    return len(arguments) == count


def _eight_or_plain(kinds: Sequence[Any]) -> bool:
    """Whether operands are eight numbers, or one is and the other is a plain float: numba has operators of others."""
    eight = [isinstance(kind, Lanes) for kind in kinds]
    return any(eight) and all(one or isinstance(kind, types.Float) for one, kind in zip(eight, kinds, strict=True))


for _symbol, _inplace in (
    (operator.add, operator.iadd),
    (operator.sub, operator.isub),
    (operator.mul, operator.imul),
    (operator.truediv, operator.itruediv),
):
    for _name in (_symbol, _inplace):
        _offer(_name, _symbol, _eight_or_plain, ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)))
