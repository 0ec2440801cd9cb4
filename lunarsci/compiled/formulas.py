"""Formulas that are written once, for plain numbers, for arrays and for the lanes of vector instructions.

A `formula` is a plain Python function of numbers. As compiled code that calls it is made, it is run once, with
stand-ins that note every operation as an instruction: no types have to be found and no loops be turned into vectors,
so that it costs little to compile. Loops and conditions in it are therefore those of Python and cannot depend on a
number; `lanes.choose` can. Tuples of numbers are taken apart by their entries; of an array, whose length is not known
while code is made, entries are read by index, or, in `lanes.Fields`, rows by name. Called from Python a formula works
on floats and NumPy arrays.

It is our own since numba finds types and unrolls loops of the same code some seven times as slowly, and does not write
it for eight numbers side by side.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

from llvmlite import ir

LANES = 8
"""Numbers side by side."""
FUSED = ("contract",)
"""a * b + c may be one instruction; nothing else is changed, so that a lane gives what the formula says."""

DOUBLE, SINGLE, INTEGER = ir.DoubleType(), ir.FloatType(), ir.IntType(64)
"""LLVM's types of a plain double, a plain single and a plain whole number."""
DOUBLES, SINGLES = ir.VectorType(DOUBLE, LANES), ir.VectorType(SINGLE, LANES)
"""LLVM's types of eight doubles and of eight singles side by side."""
SINGLE_BITS = 32
"""Of a single (IEEE 754)."""
Function = TypeVar("Function", bound=Callable[..., Any])


class Traced:
    """A value that code being made will have.

    builder : writes instructions at the place where code is being made.
    value : the instruction, or the constant, that gives it; its type is LLVM's.
    """

    __slots__ = ("builder", "value")
    __array_ufunc__ = None

    def __init__(self, builder: ir.IRBuilder, value: ir.Value) -> None:
        self.builder, self.value = builder, value

    def __bool__(self) -> bool:
        raise TypeError("a formula cannot branch on a number; take `choose`, `lowest` or `highest`")

    def called(self, name: str, *others: "Traced") -> "Traced":
        """What an intrinsic function of LLVM, such as `sqrt`, makes of this and others of the same type."""
        kind = self.value.type
        short = {DOUBLE: "f64", DOUBLES: f"v{LANES}f64", SINGLES: f"v{LANES}f32"}[kind]
        signature = ir.FunctionType(kind, [kind] * (1 + len(others)))
        full = f"llvm.{name}.{short}"
        function = self.builder.module.globals.get(full) or ir.Function(self.builder.module, signature, full)
        return type(self)(self.builder, self.builder.call(function, [self.value, *(other.value for other in others)]))


class TracedMask(Traced):
    """Yes or no, in every lane."""

    def __and__(self, other: Any) -> Any:
        return TracedMask(self.builder, self.builder.and_(*alike(self, self._like(other))))

    def __or__(self, other: Any) -> Any:
        return TracedMask(self.builder, self.builder.or_(*alike(self, self._like(other))))

    def __invert__(self) -> Any:
        return TracedMask(self.builder, self.builder.xor(*alike(self, self._like(True))))

    __rand__, __ror__ = __and__, __or__

    def _like(self, other: Any) -> "TracedMask":
        return other if isinstance(other, TracedMask) else TracedMask(self.builder, ir.IntType(1)(bool(other)))


class TracedReal(Traced, ABC):
    """What calculates: a double, eight of them, or a whole number that stands for one."""

    @property
    @abstractmethod
    def number(self) -> "TracedNumber":
        """The same as doubles."""

    def __add__(self, other: Any) -> Any:
        return self.number.combined("fadd", other)

    def __sub__(self, other: Any) -> Any:
        return self.number.combined("fsub", other)

    def __mul__(self, other: Any) -> Any:
        return self.number.combined("fmul", other)

    def __truediv__(self, other: Any) -> Any:
        return self.number.combined("fdiv", other)

    def __radd__(self, other: Any) -> Any:
        return self.number.like(other) + self

    def __rsub__(self, other: Any) -> Any:
        return self.number.like(other) - self

    def __rmul__(self, other: Any) -> Any:
        return self.number.like(other) * self

    def __rtruediv__(self, other: Any) -> Any:
        return self.number.like(other) / self

    def __neg__(self) -> Any:
        return TracedNumber(self.builder, self.builder.fneg(self.number.value))

    def __abs__(self) -> Any:
        return self.number.called("fabs")

    def __lt__(self, other: Any) -> Any:
        return self.number.compared("<", other)

    def __gt__(self, other: Any) -> Any:
        return self.number.compared(">", other)

    def __le__(self, other: Any) -> Any:
        return self.number.compared("<=", other)

    def __ge__(self, other: Any) -> Any:
        return self.number.compared(">=", other)

    def __eq__(self, other: object) -> Any:
        return self.number.compared("==", other)

    def __ne__(self, other: object) -> Any:
        return ~(self == other)

    __hash__ = None  # type: ignore[assignment]


class TracedWhole(TracedReal):
    """A plain whole number: an index, or one of a few choices."""

    @property
    def number(self) -> "TracedNumber":
        """The same as a double."""
        return TracedNumber(self.builder, self.builder.sitofp(self.value, DOUBLE))


class TracedNumber(TracedReal):
    """A double, or eight of them, or eight singles; what meets singles is rounded to one."""

    @property
    def number(self) -> "TracedNumber":
        """Itself."""
        return self

    def like(self, other: Any) -> "TracedNumber":
        """A plain number beside this one."""
        return other.number if isinstance(other, TracedReal) else TracedNumber(self.builder, DOUBLE(float(other)))

    def combined(self, instruction: str, other: Any) -> "TracedNumber":
        """What an instruction of two numbers makes of this and another."""
        made = getattr(self.builder, instruction)(*alike(self, self.like(other)), flags=FUSED)
        return TracedNumber(self.builder, made)

    def compared(self, how: str, other: Any) -> TracedMask:
        """Whether this stands so to another; no number stands to one without meaning."""
        return TracedMask(self.builder, self.builder.fcmp_ordered(how, *alike(self, self.like(other))))

    @property
    def is_single(self) -> bool:
        """Whether these are eight singles."""
        return bool(self.value.type == SINGLES)

    @property
    def bits(self) -> ir.Value:
        """The same bits as whole numbers."""
        return self.builder.bitcast(self.value, self._bits_type)

    def whole(self, number: int) -> ir.Constant:
        """A whole number for `bits`."""
        kind = self._bits_type
        return ir.Constant(kind, [number] * LANES) if isinstance(kind, ir.VectorType) else kind(number)

    @property
    def _bits_type(self) -> ir.Type:
        if self.value.type == DOUBLE:
            return INTEGER
        return ir.VectorType(ir.IntType(32) if self.is_single else INTEGER, LANES)

    def from_bits(self, bits: ir.Value) -> "TracedNumber":
        """The number, or the eight, whose `bits` these are."""
        return TracedNumber(self.builder, self.builder.bitcast(bits, self.value.type))


def in_every_lane(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """A plain value in every lane."""
    if isinstance(value, ir.Constant) and value.type in (DOUBLE, SINGLE):
        return ir.Constant(ir.VectorType(value.type, LANES), [value.constant] * LANES)
    one = builder.insert_element(ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def alike(*values: Traced) -> list[ir.Value]:
    """Values of one shape: all plain, or all of eight; of one precision, the lower."""
    kinds = [value.value.type for value in values]
    wide = any(isinstance(kind, ir.VectorType) for kind in kinds)
    made = [rounded(value.builder, value.value) if SINGLES in kinds else value.value for value in values]
    return [
        in_every_lane(value.builder, one) if wide and not isinstance(one.type, ir.VectorType) else one
        for value, one in zip(values, made, strict=True)
    ]


def rounded(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """Doubles as singles; what else there is as it is."""
    if value.type not in (DOUBLE, DOUBLES):
        return value
    return builder.fptrunc(value, SINGLES if value.type == DOUBLES else SINGLE)


class TracedTable(Traced):
    """An array of doubles or singles; its numbers are read by whole indices.

    context, kind : numba's target context, and its type of the array.
    value : numba's structure of the array.
    """

    __slots__ = ("context", "kind")

    def __init__(self, context: Any, builder: ir.IRBuilder, kind: Any, value: ir.Value) -> None:
        super().__init__(builder, value)
        self.context, self.kind = context, kind

    @property
    def array(self) -> Any:
        """Numba's view of it: data, shape, strides."""
        return self.context.make_array(self.kind)(self.context, self.builder, self.value)

    def at(self, *index: "TracedWhole | int") -> ir.Value:
        """Pointer to an entry, by as many indices as the array has dimensions."""
        places = [i.value if isinstance(i, TracedWhole) else INTEGER(i) for i in index]
        from numba.core.cgutils import get_item_pointer

        return get_item_pointer(self.context, self.builder, self.kind, self.array, places)

    @property
    def eight(self) -> ir.VectorType:
        """LLVM's type of eight of its numbers."""
        return SINGLES if self.kind.dtype.bitwidth == SINGLE_BITS else DOUBLES

    def row(self, number: "TracedWhole | int") -> ir.Value:
        """Pointer to a row of a contiguous array of eight columns."""
        place = number.value if isinstance(number, TracedWhole) else INTEGER(number)
        return self.builder.gep(self.builder.bitcast(self.array.data, self.eight.as_pointer()), [place])

    def __iter__(self) -> Any:
        raise TypeError("a formula cannot take an array apart, whose length it does not know; give it a tuple")

    def __getitem__(self, index: Any) -> TracedNumber:
        value = self.builder.load(self.at(*(index if isinstance(index, tuple) else (index,))))
        return TracedNumber(self.builder, self.builder.fpext(value, DOUBLE) if value.type == SINGLE else value)

    def lanes(self, *index: "TracedWhole | int") -> ir.Value:
        """Pointer to eight neighbouring numbers, from an entry on."""
        return self.builder.bitcast(self.at(*index), self.eight.as_pointer())


OFFERED: list[Callable[..., Any]] = []
"""Formulas that numba does not know yet."""


def formula(function: Function) -> Function:
    """Let compiled code call a function of numbers; see the text of this module."""
    OFFERED.append(function)
    return function
