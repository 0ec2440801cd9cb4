"""One self-contained page of several results: what was found, how sure it is, and what it rests on.

The package is also the function: `lunarsci.report(results, "page.html")`, which is `lunarsci.report.job.report`.
"""

import sys
from types import ModuleType
from typing import Any


class _Called(ModuleType):
    """The package, which can be called as the other jobs of `lunarsci` are."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        from lunarsci.report.job import report

        return report(*args, **options)


sys.modules[__name__].__class__ = _Called
