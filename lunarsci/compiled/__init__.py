"""Functions that numba compiles when they are first called: the one door to compiled code.

Importing a module of compiled functions costs nothing of numba, which takes a third of a second to import and is not
needed by the help of a command. `machine_code` says how the code is kept, and why all processes get the same digits.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import update_wrapper
from threading import RLock, local
from types import CellType, CodeType, FunctionType
from typing import Any

from lunarsci.compiled.began import BEGAN as BEGAN

VECTORS = {"reassoc", "contract", "nsz", "arcp"}
"""`fastmath` that lets sums become vector instructions and still knows infinity and NaN."""
LANE_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
"""Options of `in_lanes`."""
PLAIN = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
"""Whether functions run as plain Python."""
_MAKING = RLock()
"""Held while code is made or loaded: threads may call a function for the first time together."""


class _Threads(local):
    """Of each thread of Python's: how many it computes in; 0: as many as there are processors for this process."""

    count = int(os.environ.get("NUMBA_NUM_THREADS") or 0)


_THREADS = _Threads()


class Compiled:
    """A function that is compiled with numba when it is first called, and not already kept for such arguments.

    The compiled functions that it names are parts of its machine code: numba finds their types once, and code is
    optimised once, for the function that Python calls.

    Parameters
    ----------
    function : plain Python that numba can compile.
    options : of `numba.njit`.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function, self._options, self._part = function, options, None
        self.entries: dict[Any, Callable[[Sequence[Any]], Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        if PLAIN:
            return self._function(*arguments)
        return self._entry(arguments)(arguments)

    def __reduce__(self) -> str:
        return self._function.__qualname__

    def _entry(self, arguments: Sequence[Any]) -> Callable[[Sequence[Any]], Any]:
        """Machine code for arguments like these."""
        from lunarsci.compiled.kept import Entry, entry_name, kind_of, load, save

        kinds = tuple(map(kind_of, arguments))
        if entry := self.entries.get(kinds):
            return entry
        with _MAKING:
            if kinds not in self.entries:
                source, name = self._function.__code__.co_filename, entry_name(self._function, self._options, kinds)
                source = "" if self._function.__closure__ else source  # what it holds is in no file
                entry = load(name, source)
                if entry is None:
                    from lunarsci.compiled import machine_code

                    code, about = machine_code.entry(name, self.part(), arguments)
                    save(name, source, code, about)
                    entry = Entry(name, code, about)
                self.entries[kinds] = entry
        return self.entries[kinds]

    def part(self) -> Any:
        """What numba makes a part of other functions."""
        from lunarsci.compiled.machine_code import part_of_others

        with _MAKING:
            if self._part is None:
                function, put_callees = _with_places(self._function)
                self._part = part_of_others(function, self._options)
                put_callees()
        return self._part


def _with_places(function: Callable[..., Any]) -> tuple[Callable[..., Any], Callable[[], None]]:
    """A copy of a function with its own namespace, and what puts dispatchers in place of the compiled functions in it.

    Numba compiles calls of its own dispatchers alone; one that calls itself has to be there before.
    """
    namespace, names = dict(function.__globals__), _names(function.__code__)
    cells = tuple(CellType(cell.cell_contents) for cell in function.__closure__ or ())
    copy = FunctionType(function.__code__, namespace, function.__name__, function.__defaults__, cells or None)

    def put_callees() -> None:
        for name in names & namespace.keys():
            if isinstance(namespace[name], Compiled):
                namespace[name] = namespace[name].part()
        for cell in cells:
            if isinstance(cell.cell_contents, Compiled):
                cell.cell_contents = cell.cell_contents.part()

    return update_wrapper(copy, function), put_callees


def _names(code: CodeType) -> set[str]:
    """Global names in a function and in those inside of it."""
    return set(code.co_names).union(*(_names(part) for part in code.co_consts if isinstance(part, CodeType)))


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile `function` with numba when it is first called; its machine code is cached where a folder can be written.

    On a read-only installation without a writable home, or where others can write to the folder, the function is
    compiled anew in each process, which is slower to start and gives the same numbers.

    The cache of a function is renewed when its own file changes, or any that it imports. A process whose sources were
    changed after it began, as by an update of lunarsci, neither reads nor keeps anything there.
    """
    return Compiled(function, options) if function is not None else lambda one: Compiled(one, options)


def threads() -> int:
    """Threads that compiled code computes in."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return _THREADS.count or usable


def set_threads(count: int) -> None:
    """Let compiled code that this thread calls compute in so many; 0: as many as it has processors."""
    _THREADS.count = count


def in_lanes(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a loop that may work on several arguments at once: divisions unchecked, products fused, sums in order."""
    return compiled(function, **LANE_OPTIONS, **options)


def uncounted(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function without counts of who uses an array, which cost more than short loops.

    It can neither make arrays nor return any: a caller that counts would give them away.
    """
    return compiled(function, error_model="numpy", _nrt=False, **options)


def joined(function: Callable[..., Any]) -> Any:
    """Compile a function that only calls others as a part of its callers: each of them would optimise it all anew."""
    return compiled(function, inline="always")


def each_in_threads(
    task: Callable[[int], object], count: int, progress: Callable[[int, int], None] | None = None
) -> None:
    """Call `task(0)` to `task(count - 1)` in as many threads as numba has; each must be its own computation.

    Gives two cores to functions compiled with `nogil=True`. `progress` is called with (done, count). An error, and
    Ctrl-C, drops the tasks that have not begun; Ctrl-C does not wait for the others.
    """
    pool = ThreadPoolExecutor(threads())
    try:
        for done, _ in enumerate(pool.map(task, range(count)), start=1):
            if progress is not None:
                progress(done, count)
    except BaseException as error:
        pool.shutdown(wait=not isinstance(error, KeyboardInterrupt), cancel_futures=True)
        raise
    pool.shutdown()
