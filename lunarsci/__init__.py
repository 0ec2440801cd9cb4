"""lunarsci: what the rock is, what the ground is, and whether the next drive is safe.

Every main job of the command line is a function here, with the same defaults, refusals and answers:

* spectra: `calibrate`, `bands`, `indices`, `fit`, `unmix`, `match`;
* regolith: `wheel_forces`, `identify`, `infer`;
* images: `cameras`, `calibrate_cameras`, `render`, `dem`, `locate`, `merge`, `track`, `rocks`;
* twin: `plan`, `predict`, `sweep`, `states`, `loads`, `update`, `compare`.

Each takes paths, open files, tables or arrays, and options by name or as a request, such as `FitRequest`. Each gives a
`Result`: `.to_table()` is an astropy QTable, `.plot()` a matplotlib Figure, `.to_dict()` the `result` of `--json`.
Jobs are imported when they are first named. `computing` says where long ones are computed.
"""

from importlib import import_module
from typing import Any

JOBS = {
    "spectra": ("calibrate", "bands", "indices", "fit", "unmix", "match"),
    "regolith": ("wheel_forces", "identify", "infer"),
    "images": ("cameras", "calibrate_cameras", "render", "dem", "locate", "merge", "track", "rocks"),
    "twin": ("plan", "predict", "sweep", "states", "loads", "update", "compare"),
}
"""What each part offers; `__init__.pyi` has the same for type checkers."""
_AREAS = {job: area for area, jobs in JOBS.items() for job in jobs}

__all__ = ["__version__", "computing", *_AREAS]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name == "computing":
        return import_module("lunarsci.blocks").computing
    if name not in _AREAS:
        raise AttributeError(f"module 'lunarsci' has no attribute '{name}'")
    return getattr(import_module(f"lunarsci.{_AREAS[name]}.jobs.{name}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
