"""Machine code of numba's: made once, the same wherever it comes from, and kept on disk.

**Parts.** Numba optimises every function, and again all that it calls, and writes machine code for each, though Python
calls few of them. Here what compiled functions call is optimised and written as a part of these alone.

**The same digits.** A function that numba compiles carries copies of the functions it calls, and every copy is
optimised where it stands, so that two copies may round differently. As numba makes them, the copies are weak symbols:
the process that compiles uses whichever copy it loaded first, one that reads the cache the function's own. Here each
function keeps its own copies to itself.

**The cache.** Numba renews a cached function when its own file changes. Here it is renewed when any file changes that
its own one imports, and compiled again where its entry is cut off or was changed. It is read by pickle, so that whoever
may write it runs what he likes: a folder that others can write is not used.

It is our own since numba promises neither.
"""

import contextlib
import hashlib
import os
import pickle
import re
import stat
import time
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler

from lunarsci.compiled.instructions import offer_all
from lunarsci.errors import LunarSciWarning

PACKAGE = Path(__file__).parents[1]
"""Folder of lunarsci, whose files are followed."""
IMPORTS = re.compile(r"^\s*from\s+(lunarsci[\w.]*)\s+import\s+(\([^)]*\)|[^#\n]*)|^\s*import\s+(lunarsci[\w.]*)", re.M)
"""An import statement of this package: of names from a module, or of a module."""
DIGEST_BYTES = 32
"""Of SHA-256, in front of a cached entry."""
BEGAN = time.time()
"""About when this process began to read its sources: what is newer need not be what it compiles. [s]"""
ROOT = 0
"""Number of the user who may write everywhere."""


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


def _of_plain_types(part: Any) -> Any:
    """Numba would compile a function anew for every constant that it is called with."""
    if hasattr(part, "get_call_template"):  # unless it is to stay plain Python
        original = part.get_call_template
        part.get_call_template = lambda args, kws: original(tuple(map(numba.types.unliteral, args)), kws)
    return part


def dispatcher(function: Callable[..., Any], options: dict[str, Any], part: bool = False) -> Any:
    """What numba makes of a function: compiled at its first call, from the cache where that is safe.

    A `part` can be called by compiled functions alone, whose machine code it becomes a part of.
    """
    offer_all()
    keep_copies_apart()
    if part:
        bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _PartCompiler}
        return _of_plain_types(numba.njit(**options, **bare)(function))
    try:
        made = numba.njit(cache=True, **options)(function)
    except RuntimeError:
        return numba.njit(**options)(function)
    if _is_open_to_others(made, Path(function.__code__.co_filename)):
        return numba.njit(**options)(function)
    tend_cache(made)
    return made


def _is_open_to_others(dispatcher: Any, source: Path) -> bool:
    """Whether others may have written the cache of a function; said once. Beside the sources it is as safe as these."""
    beside = source.parent / "__pycache__"
    folder = Path(getattr(getattr(dispatcher, "_cache", None), "_cache_path", beside))
    if folder == beside:
        return False
    why = why_unsafe(folder) or why_unsafe(folder.parent, shared=True)
    if why:
        _tell(f"{why}: compiled code is not kept there; set NUMBA_CACHE_DIR to a folder that only you can write")
    return bool(why)


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


def keep_copies_apart() -> None:
    """Make functions that numba compiles from now on keep their copies of others to themselves.

    Where numba's inside is another than is known here, it is left as it is; then last digits may depend on what was
    compiled or loaded before.
    """
    original = getattr(CPUCodeLibrary, "_optimize_final_module", None)
    if original is None or getattr(original, "keeps_copies_apart", False):
        return

    def optimized(library: Any) -> None:
        _link_parts(library)
        if any(function.name.startswith("NRT_") for function in library._final_module.functions):
            original(library)
        else:  # numba optimises everything twice so that few uses are left to be counted
            manager, builder = library._codegen._module_pass_manager()
            manager.run(library._final_module, builder)
        with contextlib.suppress(AttributeError):
            _keep_to_itself(library)

    optimized.keeps_copies_apart = True  # type: ignore[attr-defined]
    CPUCodeLibrary._optimize_final_module = optimized


def _link_parts(library: Any) -> None:
    """Bring in what the parts of a library call in turn."""
    wanted = list(library._linking_libraries)
    reached = set(wanted)
    while wanted:
        callee = wanted.pop()
        for other in callee._linking_libraries if isinstance(callee, _PartLibrary) else ():
            if other not in reached:
                reached.add(other)
                wanted.append(other)
                library._final_module.link_in(other._get_module_for_linking(), preserve=True)


def _keep_to_itself(library: Any) -> None:
    """Weak copies become the module's own; what other functions will copy is put aside before."""
    module = library._final_module
    shared = module.clone()
    for function in shared.functions:
        if not function.is_declaration and function.linkage == llvm.Linkage.external:
            function.linkage = llvm.Linkage.linkonce_odr
    library._shared_module = shared
    for function in module.functions:
        if not function.is_declaration and function.linkage == llvm.Linkage.linkonce_odr:
            function.linkage = llvm.Linkage.internal


def tend_cache(dispatcher: Any) -> None:
    """Give a function that numba caches a cache that knows all its sources and notices damage."""
    with contextlib.suppress(AttributeError):
        cache, base = dispatcher._cache, dispatcher._cache._impl.filename_base
        cache._cache_file = _Entries(cache._cache_path, base, dispatcher.py_func.__code__.co_filename)


class _Entries(IndexDataCacheFile):  # type: ignore[misc]
    """Index and machine code of one function, each entry with a digest."""

    def __init__(self, cache_path: str, filename_base: str, source: str) -> None:
        super().__init__(cache_path, filename_base, None)
        self._source = source

    @property
    def _source_stamp(self) -> str:
        return sources_digest(self._source)

    @_source_stamp.setter
    def _source_stamp(self, value: object) -> None:
        """Numba's own stamp, of one file, is of no use."""

    def save(self, key: Any, data: Any) -> None:
        """Keep an entry; a full disk or a folder that went read-only is no reason to fail."""
        if changed_since(self._source, BEGAN):
            return
        with contextlib.suppress(OSError):
            super().save(key, data)

    def _load_index(self) -> Any:
        if changed_since(self._source, BEGAN):
            return {}
        try:
            return super()._load_index()
        except Exception:  # whatever a damaged pickle raises, the function is compiled anew
            return {}

    def _load_data(self, name: str) -> Any:
        stored = Path(self._data_path(name)).read_bytes()
        payload = stored[DIGEST_BYTES:]
        if stored[:DIGEST_BYTES] != self._digest(payload):
            raise OSError("not as it was written")  # to numba: no such entry
        return pickle.loads(payload)

    def _save_data(self, name: str, data: Any) -> None:
        payload = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(self._digest(payload) + payload)

    def _digest(self, payload: bytes) -> bytes:
        return hashlib.sha256(self._source_stamp.encode() + payload).digest()


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
