"""lunarsci: what the rock is, what the ground is, and whether the next drive is safe.

Every main job of the command line is a function here, with the same defaults, refusals and answers:

* PART: FUNCTIONS;
* `compare_trials`: public drives beside what the twin predicts, as `compare` is for a drive beside its prediction;
* `cite`: what to cite for results, as BibTeX; `report`: a page of results. `computing` says where jobs are computed.

Each takes paths, open files, tables or arrays, and options by name, which its help lists. Each gives a `Result`:
`print` shows the text of the command, a notebook its answer, table and picture; `.to_table()` is an astropy QTable,
`.to_pandas()` a DataFrame, `.to_xarray()` a grid, `.plot()` a matplotlib Figure, `.to_dict()` the `result` of `--json`,
`.untrusted` why it should not be trusted, `.doubt` the same reason by reason. Jobs are
imported when they are first named. Other commands, such as `info`, are on the command line alone.
"""

from importlib import import_module
from typing import Any

from lunarsci import errors as errors
from lunarsci.registry import COMMANDS, functions_of

JOBS = {part: functions_of(part) for part in COMMANDS}
"""What each part offers; `__init__.pyi` has the same for type checkers."""
__doc__ = (__doc__ or "").replace(
    "* PART: FUNCTIONS", ";\n".join(f"* {part}: {', '.join(f'`{one}`' for one in jobs)}" for part, jobs in JOBS.items())
)

_ELSEWHERE = {
    "computing": "lunarsci.parallel.blocks",
    "cite": "lunarsci.guide.cite",
    "compare_trials": "lunarsci.twin.jobs.compare_trials",
    "report": "lunarsci.pages.job",
}

__all__ = ["__version__", *_ELSEWHERE, *(job for jobs in JOBS.values() for job in jobs)]


def _renderer() -> Any:
    """What makes the text and the HTML of a result: it stands above the library, and is imported to show one."""
    return import_module("lunarsci.cli.shown")


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("lunarsci.provenance").installed_version("lunarsci")
    part = next((part for part in COMMANDS if name in functions_of(part)), "")
    if name not in _ELSEWHERE and not part:
        raise AttributeError(f"module 'lunarsci' has no attribute '{name}'")
    return getattr(import_module(_ELSEWHERE.get(name, f"lunarsci.{part}.jobs.{name}")), name)


def __dir__() -> list[str]:
    return sorted(__all__)
