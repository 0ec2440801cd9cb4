"""lunarsci: what the rock is, what the ground is, and whether the next drive is safe.

Every main job of the command line is a function here, with the same defaults, refusals and answers:

* spectra: `calibrate`, `bands`, `fit`, `unmix`, `match`;
* regolith: `wheel_forces`, `identify`, `infer`;
* twin: `plan`, `predict`, `states`, `loads`, `update`, `compare`.

Each takes paths, open files, tables or arrays, and options by name or as a request, such as `FitRequest`. Each gives a
`Result`: `.to_table()` is an astropy QTable, `.plot()` a matplotlib Figure, `.to_dict()` the `result` of `--json`.
Jobs are imported when they are first named.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lunarsci.regolith.jobs.identify import identify
    from lunarsci.regolith.jobs.infer import infer
    from lunarsci.regolith.jobs.wheel_forces import wheel_forces
    from lunarsci.spectra.jobs.bands import bands
    from lunarsci.spectra.jobs.calibrate import calibrate
    from lunarsci.spectra.jobs.fit import fit
    from lunarsci.spectra.jobs.match import match
    from lunarsci.spectra.jobs.unmix import unmix
    from lunarsci.twin.jobs.compare import compare
    from lunarsci.twin.jobs.loads import loads
    from lunarsci.twin.jobs.plan import plan
    from lunarsci.twin.jobs.predict import predict
    from lunarsci.twin.jobs.states import states
    from lunarsci.twin.jobs.update import update

__all__ = [
    "__version__",
    "bands",
    "calibrate",
    "compare",
    "fit",
    "identify",
    "infer",
    "loads",
    "match",
    "plan",
    "predict",
    "states",
    "unmix",
    "update",
    "wheel_forces",
]

__version__ = "0.1.0"

_AREAS = {
    "spectra": ("calibrate", "bands", "fit", "unmix", "match"),
    "regolith": ("wheel_forces", "identify", "infer"),
    "twin": ("plan", "predict", "states", "loads", "update", "compare"),
}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    for area, jobs in _AREAS.items():
        if name in jobs:
            return getattr(import_module(f"lunarsci.{area}.jobs.{name}"), name)
    raise AttributeError(f"module 'lunarsci' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
