"""Machine code that is kept on disk, and called without numba.

Numba and what it imports take half a second to start. What it has made is needed alone where it is kept: llvmlite
brings it to memory in milliseconds, and Python hands it numbers and the places of arrays.

**By content.** The name of a file of machine code is a digest of all that it depends on: the sources of the function
and of everything that its module imports, the kinds of its arguments, the processor, and the versions of what made it.
Checkouts, users and machines alike share what one has compiled; nothing is ever out of date, only no longer used.

**Whom it trusts.** Whoever may write the folder runs what he likes: one that others can write is not used. An entry
that is cut off or was changed is compiled again.

It is our own since numba's cache needs numba, and is renewed when a function's own file changes, but not one that this
imports.
"""

import contextlib
import ctypes
import hashlib
import json
import os
import re
import stat
import struct
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from lunarsci.compiled.began import BEGAN
from lunarsci.errors import LunarSciWarning

PACKAGE = Path(__file__).parents[1]
"""Folder of lunarsci, whose files are followed."""
IMPORTS = re.compile(r"^\s*from\s+(lunarsci[\w.]*)\s+import\s+(\([^)]*\)|[^#\n]*)|^\s*import\s+(lunarsci[\w.]*)", re.M)
"""An import statement of this package: of names from a module, or of a module."""
DIGEST_BYTES = 32
"""Of SHA-256, in front of a kept entry."""
UNUSED_DAYS = 30
"""Machine code that no process has read for so long is taken away; assumed."""
ROOT = 0
"""Number of the user who may write everywhere."""
ROWS_FIRST, COLUMNS_FIRST, ALIGNED, WRITEABLE = 0x1, 0x2, 0x100, 0x400
"""Flags of an array that machine code depends on, the second where it has not the first; `ndarraytypes.h` of NumPy."""
SAME: Mapping[type, type] = {np.float64: float, np.int64: int, np.bool_: bool}
"""Types of NumPy's whose numbers are to machine code what those of Python are."""


def kind_of(value: Any) -> Any:
    """What machine code depends on of an argument: its type; of an array numbers, dimensions, order; of a tuple all."""
    if isinstance(value, np.ndarray):
        flags = value.flags.num
        order = flags & ROWS_FIRST or flags & COLUMNS_FIRST
        about = value.dtype, value.ndim, order | flags & (ALIGNED | WRITEABLE)
        return about if type(value) is np.ndarray else (type(value), *about)
    if isinstance(value, tuple):
        return (type(value), *map(kind_of, value))
    return SAME.get(type(value), type(value))


def _named(kind: Any) -> str:
    """A `kind_of` an argument in words, the same in every process."""
    if isinstance(kind, tuple):
        return f"({', '.join(map(_named, kind))})"
    if isinstance(kind, type):
        return f"{kind.__module__}.{kind.__qualname__}{getattr(kind, '_fields', '')}"
    return repr(kind)


def _put(value: Any, slots: list[Any]) -> None:
    """Add numbers that stand for an argument: of an array its place, lengths, strides, of a generator what draws."""
    if isinstance(value, np.ndarray):
        slots += (value.ctypes.data, *value.shape, *value.strides)
    elif isinstance(value, tuple):
        for part in value:
            _put(part, slots)
    elif hasattr(value, "bit_generator"):
        draws = value.bit_generator.ctypes
        functions = (draws.next_uint64, draws.next_double, draws.next_uint32)
        slots += (
            draws.state_address,
            draws.state.value,
            *(ctypes.cast(one, ctypes.c_void_p).value for one in functions),
        )
    elif value is not None:
        slots.append(value.item() if isinstance(value, np.generic) else value)


class Entry:
    """Machine code of one function for arguments of certain kinds.

    Parameters
    ----------
    name : of its symbol, unlike all others.
    code : an object file with it.
    about : `symbols` that it calls elsewhere; `result`, what it gives: None, the letter of a number in `struct`, a list
        of these, or an array's type and dimensions.

    Raises OSError where this process does not have what it calls.
    """

    def __init__(self, name: str, code: bytes, about: Mapping[str, Any]) -> None:
        engine = self._engine = _engine()  # the code lives as long as it
        if any(llvm.address_of_symbol(symbol) is None for symbol in about["symbols"]):
            _bring_numba()
        if missing := [symbol for symbol in about["symbols"] if llvm.address_of_symbol(symbol) is None]:
            raise OSError(f"{name} calls {', '.join(missing)}, which this process does not have")
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        place, release = engine.get_function_address(name), engine.get_function_address(f"{name}_release")
        self._call = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_char_p, ctypes.c_void_p)(place)
        self._release = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(release or 0)
        self._name, self._result = name, about["result"]
        self._given: struct.Struct | None = None
        self._format = "".join(_letters(self._result))

    def __call__(self, arguments: Sequence[Any]) -> Any:
        """What it gives, with the lock of Python's threads released meanwhile. Raises ArithmeticError for any error."""
        slots: list[Any] = []
        for value in arguments:
            _put(value, slots)
        if self._given is None:  # the same at every call
            self._given = struct.Struct("".join(["d" if isinstance(slot, float) else "q" for slot in slots]))
        room = ctypes.create_string_buffer(8 * len(self._format)) if self._format else None
        if self._call(self._given.pack(*slots), room):
            raise ArithmeticError(f"{self._name}: an error of its own, a division by zero, or no memory")
        return None if room is None else self._read(self._result, iter(struct.unpack(self._format, room)))

    def _read(self, result: Any, slots: Iterator[Any]) -> Any:
        if isinstance(result, list):
            return tuple(self._read(part, slots) for part in result)
        if isinstance(result, Mapping):
            owner, place = next(slots), next(slots)
            shape, strides = (tuple(next(slots) for _ in range(result["dimensions"])) for _ in range(2))
            array = np.array(_Place(place, shape, strides, result["numbers"]))
            self._release(owner)
            return array
        return bool(next(slots)) if result == "?" else next(slots) if result else None


def _bring_numba() -> None:
    """What numba's own code calls, such as products of matrices, to this process."""
    from numba.core.registry import cpu_target
    from numba.core.runtime import rtsys

    rtsys.initialize(cpu_target.target_context)


def _letters(result: Any) -> Iterator[str]:
    """Of `struct`, one for each eight bytes of a result."""
    if isinstance(result, list):
        for part in result:
            yield from _letters(part)
    elif isinstance(result, Mapping):
        yield "q" * (2 + 2 * result["dimensions"])
    elif result:
        yield result.replace("?", "q")


class _Place:
    """An array of machine code's own."""

    def __init__(self, place: int, shape: tuple[int, ...], strides: tuple[int, ...], numbers: str) -> None:
        about = {"data": (place, False), "shape": shape, "strides": strides, "typestr": numbers, "version": 3}
        self.__array_interface__ = about


def _engine() -> Any:
    """What brings an object file to memory."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(codemodel="jitdefault")
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def entry_name(function: Callable[..., Any], options: Mapping[str, Any], kinds: Sequence[Any]) -> str:
    """Name of a function's machine code, the same wherever it would be the same."""
    where = f"{function.__module__} {function.__qualname__} {function.__code__.co_firstlineno}"
    how = sorted((name, sorted(value) if isinstance(value, set) else value) for name, value in options.items())
    whole = [where, repr(how), _named(tuple(kinds)), sources_digest(function.__code__.co_filename), *_maker()]
    return f"{function.__name__}-{hashlib.sha256(chr(0).join(whole).encode()).hexdigest()[:DIGEST_BYTES]}"


@cache
def _maker() -> tuple[str, ...]:
    """What makes machine code, and for which processor: as numba has it, whose settings are in the environment."""
    apart = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")
    settings = sorted(f"{name}={value}" for name, value in os.environ.items() if name.startswith("NUMBA_"))
    processor = llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    versions = f"{sys.version_info[:2]} {version('numba')} {version('llvmlite')} {np.__version__}"
    return (*processor, versions, *(setting for setting in settings if not setting.startswith(apart)))


def load(name: str, source: str) -> Entry | None:
    """Machine code that is kept, None where there is none, or its sources have changed since this process began."""
    folder = safe_folder()
    if folder is None or not source or changed_since(source, BEGAN):
        return None
    path = folder / name
    with contextlib.suppress(OSError):
        stored = path.read_bytes()
        if time.time() - path.stat().st_mtime > UNUSED_DAYS * 86400 / 2:
            with contextlib.suppress(OSError):
                path.touch()
        head, _, code = stored[DIGEST_BYTES:].partition(b"\n")
        if stored[:DIGEST_BYTES] == hashlib.sha256(name.encode() + stored[DIGEST_BYTES:]).digest():
            return Entry(name, code, json.loads(head))
    return None


def save(name: str, source: str, code: bytes, about: Mapping[str, Any]) -> None:
    """Keep machine code for other processes; a full disk or a folder that is read-only is no reason to fail."""
    folder = safe_folder()
    if folder is None or not source or changed_since(source, BEGAN):
        return
    content = json.dumps(about).encode() + b"\n" + code
    with contextlib.suppress(OSError):
        begun = folder / f"{name}.{os.getpid()}"
        begun.write_bytes(hashlib.sha256(name.encode() + content).digest() + content)
        begun.replace(folder / name)
        for old in folder.glob("*-*"):
            with contextlib.suppress(OSError):  # of another user, or taken away by another process
                if time.time() - old.stat().st_mtime > UNUSED_DAYS * 86400:
                    old.unlink()


def cache_folder() -> Path:
    """Where machine code is kept: in NUMBA_CACHE_DIR, else where this system keeps what can be made again."""
    try:
        home = Path.home()
    except RuntimeError:  # a user without a name has no such place
        home = Path(os.devnull)
    usual = {"win32": os.environ.get("LOCALAPPDATA") or home / "AppData/Local", "darwin": home / "Library/Caches"}
    here = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    return Path(here or usual.get(sys.platform, home / ".cache")) / "lunarsci-code"


def safe_folder() -> Path | None:
    """The `cache_folder`, made where it is missing; None where it cannot be, or where others can write: said once."""
    folder = cache_folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return None
    why = why_unsafe(folder) or why_unsafe(folder.parent, shared=True)
    if why:
        _tell(f"{why}: compiled code is not kept there; set NUMBA_CACHE_DIR to a folder that only you can write")
    return None if why else folder


def why_unsafe(folder: Path, shared: bool = False) -> str:
    """What lets another user but root put files into a folder, or, where it may be `shared`, replace yours; '' if none.

    The group that bears the user's name is the user's own.
    """
    if not hasattr(os, "getuid"):
        return ""
    status = folder.stat()
    if status.st_uid not in (ROOT, os.getuid()):
        return f"{folder} belongs to another user"
    others = status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and not _is_private_group(status.st_gid))
    sticky = shared and status.st_mode & stat.S_ISVTX
    return f"{folder} can be written by others" if others and not sticky else ""


def _is_private_group(number: int) -> bool:
    """Whether a group bears the user's name and has no other member."""
    import grp
    import pwd

    with contextlib.suppress(KeyError):
        name, group = pwd.getpwuid(os.getuid()).pw_name, grp.getgrgid(number)
        return group.gr_name == name and set(group.gr_mem) <= {name}
    return False


@cache
def _tell(remark: str) -> None:
    """Warn of it, once in a process."""
    warnings.warn(remark, LunarSciWarning, stacklevel=2)


@cache
def sources_digest(source: str) -> str:
    """SHA-256 over the `sources` of a file."""
    whole = hashlib.sha256()
    for path in sources(source):
        whole.update(path.name.encode() + _content(path))
    return whole.hexdigest()


def changed_since(source: str, moment_s: float) -> bool:
    """Whether one of the `sources` of a file was changed, or taken away, after a moment of the clock."""
    try:
        return any(path.stat().st_mtime > moment_s for path in sources(source))
    except OSError:
        return True


@cache
def sources(source: str) -> tuple[Path, ...]:
    """A file of this package and all of the package that it imports, directly or not, in order."""
    reached, wanted = {Path(source)}, [Path(source)]
    while wanted:
        for path in _imported(wanted.pop()) - reached:
            reached.add(path)
            wanted.append(path)
    return tuple(sorted(reached))


@cache
def _content(path: Path) -> bytes:
    """Of a file, empty where there is none."""
    return path.read_bytes() if path.is_file() else b""


@cache
def _imported(path: Path) -> frozenset[Path]:
    """Files of this package that a file names in its import statements, wherever they stand."""
    names = set()
    for origin, what, alone in IMPORTS.findall(_content(path).decode("utf-8", errors="replace")):
        module = origin or alone
        names |= {module, *(f"{module}.{name}" for name in re.findall(r"\w+", what))}
    files = (_files_of(name.split(".")[1:]) for name in names)
    return frozenset(path for both in files for path in both if path.is_file())


def _files_of(parts: list[str]) -> tuple[Path, Path]:
    """Files that the parts of a name after `lunarsci` may stand for: a module, and a package."""
    place = PACKAGE.joinpath(*parts)
    return place.with_name(f"{place.name}.py"), place / "__init__.py"
