"""lunarsci: what the rock is, what the ground is, and whether the next drive is safe.

Every main job of the command line is a function here, with the same defaults, refusals and answers:

* spectra: `calibrate`, `bands`, `indices`, `fit`, `unmix`, `match`;
* regolith: `wheel_forces`, `identify`, `infer`, `compare_soils`;
* images: `cameras`, `calibrate_cameras`, `render`, `dem`, `locate`, `merge`, `track`, `rocks`;
* twin: `plan`, `predict`, `sweep`, `states`, `loads`, `update`, `compare` (a drive beside its prediction),
  `compare_trials` (public drives);
* `cite`: what to cite for results, as BibTeX; `report`: a page of results. `computing` says where jobs are computed.

Each takes paths, open files, tables or arrays, and options by name, which its help lists. Each gives a `Result`:
`print` shows the text of the command, `.to_table()` is an astropy QTable, `.plot()` a matplotlib Figure, `.to_dict()`
the `result` of `--json`, `.untrusted` why it should not be trusted, `.doubt` the same reason by reason. Jobs are
imported when they are first named.
On the command line alone: `info`, `spectra map`, `spectra library`, `twin simulate`.
"""

from importlib import import_module
from typing import Any

JOBS = {
    "spectra": ("calibrate", "bands", "indices", "fit", "unmix", "match"),
    "regolith": ("wheel_forces", "identify", "infer", "compare_soils"),
    "images": ("cameras", "calibrate_cameras", "render", "dem", "locate", "merge", "track", "rocks"),
    "twin": ("plan", "predict", "sweep", "states", "loads", "update", "compare"),
}
"""What each part offers; `__init__.pyi` has the same for type checkers."""
_AREAS = {job: area for area, jobs in JOBS.items() for job in jobs}

_ELSEWHERE = {
    "computing": "lunarsci.parallel.blocks",
    "cite": "lunarsci.guide.cite",
    "compare_trials": "lunarsci.twin.jobs.compare_trials",
    "report": "lunarsci.pages.job",
}

__all__ = ["__version__", *_ELSEWHERE, *_AREAS]

__version__ = "0.1.0"


def _renderer() -> Any:
    """What makes the text and the HTML of a result: it stands above the library, and is imported to show one."""
    return import_module("lunarsci.cli.shown")


def __getattr__(name: str) -> Any:
    if name in __all__:
        import_module("lunarsci.result").Result.renderer = staticmethod(_renderer)
    if name in _ELSEWHERE:
        return getattr(import_module(_ELSEWHERE[name]), name)
    if name not in _AREAS:
        raise AttributeError(f"module 'lunarsci' has no attribute '{name}'")
    return getattr(import_module(f"lunarsci.{_AREAS[name]}.jobs.{name}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
