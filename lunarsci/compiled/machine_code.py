"""Machine code of numba's: made once, and the same wherever it comes from.

**Parts.** Numba optimises every function, and again all that it calls, and writes machine code for each with what calls
it from Python, though Python calls few of them. Here all is a part of an `entry`, which reads its arguments as `kept`
lays them out: it is optimised and written once.

**The same digits.** A function that numba compiles carries copies of the functions it calls, and every copy is
optimised where it stands, so that two copies may round differently. As numba makes them, the copies are weak symbols:
the process that compiles uses whichever copy it loaded first. Here each entry keeps its own copies to itself, and
whoever compiles runs what later processes read.

It is our own since numba promises neither.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba.core import types
from numba.core.cgutils import create_struct_proxy, get_or_insert_function
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import as_dtype

from lunarsci.compiled.formulas import DOUBLE, INTEGER
from lunarsci.compiled.instructions import offer_all

POINTER, STATUS, WORD = ir.IntType(8).as_pointer(), ir.IntType(32), 8
"""LLVM's types of any place and of a status, and bytes of a slot."""
ROOM = 6 * WORD
"""Bytes of what numba keeps of an array in front of its numbers: count of uses, how it ends (2), place, size,
allocator; `numba/core/runtime/nrt.h`."""
DRAWS = types.NumPyRandomBitGeneratorType("bit_generator")
"""Numba's type of what a generator of NumPy's draws with."""


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that runs as a part of its callers alone: neither optimised nor translated by itself."""

    def finalize(self) -> None:
        """End it as it is."""
        self._raise_if_finalized()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Nowhere: nothing calls it from Python."""
        return 0

    @property
    def codegen(self) -> Any:
        """Itself, on which numba calls `set_env`."""
        return self

    def set_env(self, env_name: str, env: Any) -> None:
        """Only what Python calls has an environment."""


class _PartCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, whose code goes into a `_PartLibrary` where no library is given."""

    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        super().__init__(typing, target, library or _PartLibrary(target.codegen(), "part"), *others)


def part_of_others(function: Callable[..., Any], options: Mapping[str, Any]) -> Any:
    """What numba makes of a function that compiled functions call, whose machine code it becomes a part of."""
    offer_all()
    bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _PartCompiler}
    part = numba.njit(**options, **bare)(function)
    if hasattr(part, "get_call_template"):  # numba would compile it anew for every constant that it is called with
        original = part.get_call_template
        part.get_call_template = lambda args, kws: original(tuple(map(numba.types.unliteral, args)), kws)
    return part


@global_compiler_lock  # type: ignore[untyped-decorator]
def entry(name: str, part: Any, arguments: Sequence[Any]) -> tuple[bytes, dict[str, Any]]:
    """An object file with what Python calls for arguments like these, and what `Entry` has to know of it.

    Parameters
    ----------
    name : symbol of the entry.
    part : of `part_of_others`.
    arguments : examples of what it is called with.
    """
    kinds = tuple(part.typeof_pyval(value) for value in arguments)
    part.compile(kinds)
    made = part.overloads[kinds]
    module, context = ir.Module(name), made.target_context
    called = ir.Function(module, ir.FunctionType(STATUS, [INTEGER.as_pointer()] * 2), name)
    builder = ir.IRBuilder(called.append_basic_block())
    given, room = (_places(builder, slots) for slots in called.args)
    values = [_read(context, builder, kind, given) for kind in kinds]
    native, kind = context.declare_function(module, made.fndesc), made.signature.return_type
    status, value = context.call_conv.call_function(builder, native, kind, kinds, values)
    with builder.if_then(builder.not_(status.is_error)):
        result = _write(context, builder, kind, value, room)
    builder.ret(builder.zext(status.is_error, STATUS))
    if '"dimensions"' in json.dumps(result):
        release = ir.Function(module, ir.FunctionType(ir.VoidType(), [POINTER]), f"{name}_release")
        builder = ir.IRBuilder(release.append_basic_block())
        builder.call(get_or_insert_function(module, release.function_type, "NRT_decref"), release.args)
        builder.ret_void()
    code, symbols = _translated(context.codegen(), made.library, module)
    return code, {"result": result, "symbols": symbols}


def _places(builder: ir.IRBuilder, slots: ir.Value) -> Iterator[ir.Value]:
    """Of one slot after the other, each written where the builder is by then."""
    return (builder.gep(slots, [INTEGER(number)]) for number in count())


def _read(context: Any, builder: ir.IRBuilder, kind: Any, places: Iterator[ir.Value]) -> ir.Value:
    """An argument, as numba has it, of as many slots as `kept` lays it out in."""
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        return context.make_tuple(builder, kind, [_read(context, builder, part, places) for part in kind])
    if isinstance(kind, types.NoneType):  # type: ignore[attr-defined]
        return context.get_dummy_value()
    if isinstance(kind, types.NumPyRandomGeneratorType):
        generator, draws = (create_struct_proxy(one)(context, builder) for one in (kind, DRAWS))
        for name in ("state_address", "state", "fnptr_next_uint64", "fnptr_next_double", "fnptr_next_uint32"):
            setattr(draws, name, builder.load(next(places)))
        generator.bit_generator = draws._getvalue()
        return generator._getvalue()
    number = builder.load(next(places))
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder)
        shape, strides = ([builder.load(next(places)) for _ in range(kind.ndim)] for _ in range(2))
        size = INTEGER(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
        place = builder.inttoptr(number, array.data.type)
        populate_array(array, data=place, shape=shape, strides=strides, itemsize=size, meminfo=None)
        return array._getvalue()
    if isinstance(kind, types.Float):
        return context.cast(builder, builder.bitcast(number, DOUBLE), types.float64, kind)
    if isinstance(kind, types.Boolean):
        return builder.icmp_unsigned("!=", number, INTEGER(0))
    if isinstance(kind, types.Integer):
        return context.cast(builder, number, types.int64, kind)
    raise TypeError(f"compiled code cannot be called with {kind} from Python")


def _write(context: Any, builder: ir.IRBuilder, kind: Any, value: ir.Value, places: Iterator[ir.Value]) -> Any:
    """Put what a function gave into slots; what `Entry` has to know of it."""
    if isinstance(kind, types.NoneType):  # type: ignore[attr-defined]
        return None
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        parts = [builder.extract_value(value, number) for number in range(len(kind))]
        return [_write(context, builder, part, one, places) for part, one in zip(kind, parts, strict=True)]
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        sizes = [builder.extract_value(part, k) for part in (array.shape, array.strides) for k in range(kind.ndim)]
        for slot in (*(builder.ptrtoint(one, INTEGER) for one in (array.meminfo, array.data)), *sizes):
            builder.store(slot, next(places))
        return {"numbers": as_dtype(kind.dtype).str, "dimensions": kind.ndim}
    if isinstance(kind, types.Float):
        builder.store(builder.bitcast(context.cast(builder, value, kind, types.float64), INTEGER), next(places))
        return "d"
    if isinstance(kind, types.Boolean):
        builder.store(builder.zext(value, INTEGER), next(places))
        return "?"
    if isinstance(kind, types.Integer):
        builder.store(context.cast(builder, value, kind, types.int64), next(places))
        return "q" if kind.signed else "Q"  # type: ignore[attr-defined]
    raise TypeError(f"compiled code cannot give {kind} to Python")


def _translated(codegen: Any, part: Any, entry: ir.Module) -> tuple[bytes, list[str]]:
    """An entry with all of its parts as an object file, and names of what it calls elsewhere."""
    library = _PartLibrary(codegen, entry.name)
    library.add_ir_module(entry)
    module, wanted, exported = library._final_module, [part], {one.name for one in entry.functions if one.blocks}
    for one in wanted:
        module.link_in(one._get_module_for_linking(), preserve=True)
        callees = one._linking_libraries if isinstance(one, _PartLibrary) else ()
        wanted += [callee for callee in dict.fromkeys(callees) if callee not in wanted]
    if any(function.name.startswith("NRT_") for function in module.functions):
        module.link_in(llvm.parse_assembly(str(_runtime())))
        CPUCodeLibrary._optimize_final_module(library)
    else:  # numba optimises everything twice so that few uses are left to be counted
        made = codegen._module_pass_manager()
        manager, *options = made if isinstance(made, tuple) else (made,)  # older numba gives a manager alone
        manager.run(module, *options)
    for function in module.functions:
        if not function.is_declaration and function.name not in exported:
            function.linkage = llvm.Linkage.internal
    outside = {one.name for one in module.functions if one.is_declaration and not one.name.startswith("llvm.")}
    if foreign := sorted(one for one in outside if one.startswith("NRT_")):
        raise TypeError(
            f"{entry.name}: {', '.join(foreign)}, which `_runtime` has not; take no lists or sets that grow"
        )
    return codegen._tm.emit_object(module), sorted(outside)


def _runtime() -> ir.Module:
    """What code of numba's calls to make and end arrays, of the system's own memory."""
    module, size, nothing = ir.Module("runtime"), INTEGER, ir.VoidType()
    malloc = ir.Function(module, ir.FunctionType(POINTER, [size]), "malloc")
    free = ir.Function(module, ir.FunctionType(nothing, [POINTER]), "free")
    for name, system in (("NRT_Allocate", malloc), ("NRT_Free", free)):
        plain = ir.Function(module, system.function_type, name)
        builder = ir.IRBuilder(plain.append_basic_block())
        made = builder.call(system, plain.args)
        builder.ret(made) if system is malloc else builder.ret_void()
    ending = ir.Function(module, free.function_type, "NRT_MemInfo_call_dtor")
    builder = ir.IRBuilder(ending.append_basic_block())
    words = builder.bitcast(ending.args[0], size.as_pointer())
    apart, last, data = (builder.load(builder.gep(words, [size(number)])) for number in (1, 2, 3))
    with builder.if_then(builder.icmp_unsigned("!=", apart, size(0))):
        with builder.if_then(builder.icmp_unsigned("!=", last, size(0))):
            builder.call(builder.inttoptr(last, free.function_type.as_pointer()), [builder.inttoptr(data, POINTER)])
        builder.call(free, [builder.inttoptr(data, POINTER)])
    builder.call(free, ending.args)
    builder.ret_void()
    _add_list_maker(module, malloc)
    making = ir.Function(module, ir.FunctionType(POINTER, [size, ir.IntType(32)]), "NRT_MemInfo_alloc_aligned")
    builder = ir.IRBuilder(making.append_basic_block())
    alignment = builder.zext(making.args[1], size)
    place = builder.call(malloc, [builder.add(builder.add(making.args[0], alignment), size(ROOM))])
    with builder.if_then(builder.icmp_unsigned("!=", place, POINTER(None))):
        first = builder.add(builder.ptrtoint(place, size), builder.add(alignment, size(ROOM - 1)))
        words = builder.bitcast(place, size.as_pointer())
        builder.store(size(1), words)
        data = builder.and_(first, builder.neg(alignment))
        for number, value in ((1, size(0)), (2, size(0)), (3, data), (4, making.args[0]), (5, size(0))):
            builder.store(value, builder.gep(words, [size(number)]))
    builder.ret(place)
    unaligned = ir.Function(module, malloc.function_type, "NRT_MemInfo_alloc")
    builder = ir.IRBuilder(unaligned.append_basic_block())
    builder.ret(builder.call(making, [*unaligned.args, ir.IntType(32)(WORD)]))
    return module


def _add_list_maker(module: ir.Module, malloc: ir.Function) -> None:
    """What makes a list, whose entries lie apart: word 1 says so, word 2 is what ends them."""
    size = INTEGER
    making = ir.Function(module, ir.FunctionType(POINTER, [size, POINTER]), "NRT_MemInfo_new_varsize_dtor")
    builder = ir.IRBuilder(making.append_basic_block())
    place, entries = builder.call(malloc, [size(ROOM)]), builder.call(malloc, [making.args[0]])
    there = builder.and_(*(builder.icmp_unsigned("!=", one, POINTER(None)) for one in (place, entries)))
    with builder.if_then(builder.not_(there)):
        builder.ret(POINTER(None))
    words = builder.bitcast(place, size.as_pointer())
    values = (size(1), size(1), making.args[1], entries, making.args[0], size(0))
    for number, value in enumerate(values):
        whole = builder.ptrtoint(value, size) if value.type == POINTER else value
        builder.store(whole, builder.gep(words, [size(number)]))
    builder.ret(place)
