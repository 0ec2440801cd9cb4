"""Shared fixtures: the measured reference data, where present, and a cache of compiled code beside that of users."""

import fcntl
import gc
import importlib.util
import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import settings

CHECKOUT = Path(__file__).with_name("checkout")
"""What makes processes import the lunarsci of this checkout, whichever is installed."""

if str(CHECKOUT) not in os.environ.get("PYTHONPATH", "").split(os.pathsep):  # else Python has run it already
    runpy.run_path(str(CHECKOUT / "sitecustomize.py"))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(CHECKOUT), os.environ.get("PYTHONPATH", "")]))
    for _name in [name for name in sys.modules if name.split(".")[0] == "lunarsci"]:
        del sys.modules[_name]  # of the installed one: pytest has looked there for the class of a warning

pytest.register_assert_rewrite("former")  # a module of benchmarks, with tests that two files have together

os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(tempfile.gettempdir()) / "lunarsci-numba"))

for _library in ("OPENBLAS", "OMP", "MKL"):  # several workers share the cores already
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

settings.register_profile("lunarsci", deadline=None)  # a busy machine is no fault
settings.load_profile("lunarsci")

os.environ.pop("COLUMNS", None)  # as a pipe has none; pytest-xdist gives one to its workers

FIRST = (
    *("test_former_rocks.py", "test_former_drives.py", "test_readme.py", "test_help.py", "test_pictures.py"),
    *("test_dask_cluster.py", "test_examples.py", "test_update.py", "test_atomic.py", "test_prescribed_motion.py"),
    *("test_twin_update.py", "test_repeatable.py", "test_wheel.py", "test_faults.py", "test_pictures_page.py"),
    *("test_page.py", "test_calibration.py", "test_states.py", "test_fuzz.py", "test_calibrate.py"),
    *("test_intervals.py", "test_orbital_grids.py", "test_chosen_drive.py", "test_laboratory.py", "test_startup.py"),
)
"""Files that start first: two that compile nearly everything, each another half; then those that take longest, so that
no worker is left with one at the end."""


QUICK = {
    "tests": "tempering",
    "io": "inputs tables",
    "regolith": "belief compare forces identify integrals inversion physics_discrepancy states",
    "inference": "problem",
    "rovers": "rovers",
    "spectra": "continuum noise photometry photometry_experiment solar spectrum",
    "mgm": "covariance lanes",
    "abundance": "mixing",
    "chemistry": "bands",
    "cubes": "rasters regions",
    "vnis": "channels detector observation splice",
    "simulation": "instrument",
    "origin": "catalogue composition ejecta exposure likelihood match mineral_map prior rock sphere",
    "readers": "astropy_tables dispatch envi libraries library likely reference solar_table table text",
    "twin": "",
    "ground": "illumination synthetic terrain",
    "mission": "mission",
    "plans": "plan",
    "telemetry": "smoother",
    "assimilation": "residuals",
    "comparison": "scores",
    "judgement": "endpoint",
    "images": "cameras",
}
"""Files of `make quick` by their folder, but for what is marked slow: truths by hand of every part, in plain Python,
since to compile takes longer than they do."""


def is_quick(path: Path) -> bool:
    return path.stem.removeprefix("test_") in QUICK.get(path.parent.name, "").split()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `-m quick` other files are not even imported."""
    if config.getoption("markexpr") == "quick" and collection_path.name.startswith("test_"):
        return True if collection_path.is_file() and not is_quick(collection_path) else None
    return None


def pytest_addoption(parser: pytest.Parser) -> None:
    help_text = "fail if more tests than these are skipped: on a machine that should have all that they need"
    parser.addoption("--most-skipped", type=int, default=None, help=help_text)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays to the end: Python need not look through it for garbage, again and again.

    That took a third of the time of collecting, and a tenth of that of the tests.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the longest files first; mark the quick ones; leave studies to those who ask for them."""
    if "study" not in config.getoption("markexpr"):
        studies = [item for item in items if item.get_closest_marker("study")]
        config.hook.pytest_deselected(items=studies)
        items[:] = [item for item in items if item not in studies]
    rank = {name: number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(FIRST)))
    for item in items:
        if is_quick(item.path) and item.get_closest_marker("slow") is None:
            item.add_marker("quick")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where more tests were skipped than may be; workers of a run leave that to the one that began them."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped, most = len(reporter.stats.get("skipped", ())), session.config.getoption("--most-skipped")
    if most is not None and skipped > most and not hasattr(session.config, "workerinput"):
        reporter.write_line(f"\n{skipped} tests were skipped, {most} at most may be here", red=True)
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers of one run have together."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session")
def program(shared: Path) -> Iterator[Path]:
    """A folder with a `lunarsci` that starts at once, see forked_program.py; for PATH.

    Workers of one run share it: the first that needs it begins it, and it ends when all of them have ended.
    """
    server = Path(__file__).with_name("forked_program.py")
    spec = importlib.util.spec_from_file_location("forked_program", server)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with module.begun(shared) as folder:
        yield folder


@pytest.fixture(scope="session")
def demo(shared: Path, program: Path) -> Path:
    """A folder with what `lunarsci demo` wrote, once for all workers, and what it printed as `printed.txt`; to read."""
    folder = shared / "demo"
    environment = os.environ | {
        "PATH": os.pathsep.join([str(program), os.environ["PATH"]]),
        **{"PYTHONUTF8": "1", "MPLBACKEND": "Agg", "COLUMNS": "100"},
    }
    with (shared / "demo.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "printed.txt").exists():
            folder.mkdir()
            done = subprocess.run(["lunarsci", "demo"], cwd=folder, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, f"{done.stdout[-2000:]}{done.stderr}"
            assert "Traceback" not in done.stderr
            (folder / "printed.txt").write_text(done.stdout, "utf-8")
    return folder


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder of real measurements, named by LUNARSCI_REFERENCE_DATA."""
    folder = os.environ.get("LUNARSCI_REFERENCE_DATA")
    if not folder:
        pytest.skip("LUNARSCI_REFERENCE_DATA is not set: no measured data to check against")
    path = Path(folder).resolve()
    if not path.is_dir():
        pytest.fail(f"LUNARSCI_REFERENCE_DATA names {path}, which is no folder")
    return path


@pytest.fixture(scope="session")
def load_benchmark() -> Callable[[str], ModuleType]:
    """`load_benchmark("wheels")`: a module of `tests/benchmarks`, loaded once."""

    @cache
    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / f"benchmarks/{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def answered() -> Callable[..., str]:
    """The sentence of a page for a result, and its trust."""

    def said(result: Any) -> str:
        from lunarsci.pages.answers import answer
        from lunarsci.pages.documents import document_of

        record = {"untrusted": result.untrusted, "failures": result.failures}
        made = answer(document_of(result.schema, result.to_dict(), record))
        return f"{made.text} {made.trust}"

    return said
