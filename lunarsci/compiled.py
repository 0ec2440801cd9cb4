"""The one door to compiled code: numba with its on-disk cache where the disk allows it."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba

from lunarsci.machine_code import keep_copies_apart, tend_cache

VECTORS = {"reassoc", "contract", "nsz", "arcp"}
"""`fastmath` that lets sums become vector instructions and still knows infinity and NaN."""
LANE_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
"""Options of `in_lanes`."""


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile `function` with numba, caching the machine code on disk when some folder is writable.

    On a read-only installation without a writable home numba refuses `cache=True`; the function is then compiled
    anew in each process, which is slower to start and gives the same numbers.

    The cache of a function is renewed when its own file changes, or any that it imports; see `machine_code`.
    """
    if function is None:
        return lambda f: compiled(f, **options)
    keep_copies_apart()
    try:
        made = numba.njit(cache=True, **options)(function)
    except RuntimeError:
        return numba.njit(**options)(function)
    tend_cache(made)
    return made


def in_lanes(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a loop that may work on several arguments at once: divisions unchecked, products fused, sums in order."""
    return compiled(function, nogil=True, **LANE_OPTIONS, **options)


def joined(function: Callable[..., Any]) -> Any:
    """Compile a function that only calls others as a part of its callers: each of them would optimise it all anew."""
    return compiled(function, nogil=True, inline="always")


def each_in_threads(
    task: Callable[[int], object], count: int, progress: Callable[[int, int], None] | None = None
) -> None:
    """Call `task(0)` to `task(count - 1)` in as many threads as numba has; each must be its own computation.

    Gives two cores to functions compiled with `nogil=True`. `progress` is called with (done, count). An error, and
    Ctrl-C, drops the tasks that have not begun; Ctrl-C does not wait for the others.
    """
    pool = ThreadPoolExecutor(numba.get_num_threads())
    try:
        for done, _ in enumerate(pool.map(task, range(count)), start=1):
            if progress is not None:
                progress(done, count)
    except BaseException as error:
        pool.shutdown(wait=not isinstance(error, KeyboardInterrupt), cancel_futures=True)
        raise
    pool.shutdown()
