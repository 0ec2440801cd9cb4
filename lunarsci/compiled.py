"""The one door to compiled code: numba with its on-disk cache where the disk allows it."""

from collections.abc import Callable
from typing import Any

import numba

__all__ = ["compiled"]


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile `function` with numba, caching the machine code on disk when some folder is writable.

    On a read-only installation without a writable home numba refuses `cache=True`; the function is then compiled
    anew in each process, which is slower to start and gives the same numbers.

    The cache of a function is renewed when its own file changes, not when the file of a function it calls does: after
    such an edit remove the `__pycache__` folders (`make clean` does).
    """
    if function is None:
        return lambda f: compiled(f, **options)
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:
        return numba.njit(**options)(function)
