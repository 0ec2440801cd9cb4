"""Compiled code: the same digits from whoever compiles, and a cache that notices changed sources and damage."""

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import llvmlite.binding as llvm
import pytest

from lunarsci.compiled import compiled
from lunarsci.compiled.machine_code import _content, _imported, _tell, sources, sources_digest
from lunarsci.errors import LunarSciWarning

MODULE = """
from lunarsci.compiled import compiled

@compiled
def twice(x):
    return 2.0 * x
"""


def steps(n: int) -> float:
    return 1.0 if n < 2 else 1.1 * steps(n - 1) + 0.9 * steps(n - 2)


def total(n: int) -> float:
    return counted(n) + counted(n + 1)


steps = compiled(steps)
counted = steps


def test_a_function_keeps_its_copies_of_others_to_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A weak copy gives way to any other of its name that is loaded already, and that may round differently."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))  # code from a cache no longer names its parts
    caller = compiled(total)
    assert caller(5) == pytest.approx(steps.py_func(5) + steps.py_func(6))
    [found] = caller.overloads.values()
    linkages = {f.name: f.linkage for f in found.library._final_module.functions if not f.is_declaration}
    assert any("steps" in name for name in linkages), "the copy is not inlined, or this test shows nothing"
    assert [name for name, linkage in linkages.items() if linkage == llvm.Linkage.linkonce_odr] == []


@compiled
def halved(x: float, times: int) -> float:
    return x / 2.0**times


def by_constants(x: float) -> float:
    return halved(x, 1) + halved(x, 2)


def test_a_part_is_made_once_for_all_constants_and_has_no_code_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert compiled(by_constants)(8.0) == 6.0
    [part] = halved.dispatcher(part=True).overloads.values()
    assert part.library.get_pointer_to_function(part.fndesc.mangled_name) == 0
    assert halved(8.0, 3) == 1.0


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], ModuleType]:
    """Import a small module with a compiled function anew, its cache in `tmp_path / "cache"`."""
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    file = tmp_path / "small.py"
    file.write_text(MODULE)
    os.utime(file, (0, 0))  # older than this process

    def again() -> ModuleType:
        spec = importlib.util.spec_from_file_location("small", file)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return again


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [(".nbi", lambda b: b""), (".nbi", lambda b: b[: len(b) // 2]), (".nbc", lambda b: b[:-9] + b"123456789")],
)
def test_a_damaged_cache_is_made_anew(
    load: Callable[[], ModuleType], tmp_path: Path, suffix: str, damage: Callable[[bytes], bytes]
) -> None:
    assert load().twice(1.5) == 3.0
    again = load()
    assert again.twice(1.5) == 3.0 and sum(again.twice.stats.cache_hits.values()) == 1
    [file] = (tmp_path / "cache").rglob(f"*{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    found = load()
    assert found.twice(1.5) == 3.0 and sum(found.twice.stats.cache_misses.values()) == 1
    assert load().twice(1.5) == 3.0
    healed = load()
    assert healed.twice(1.5) == 3.0 and sum(healed.twice.stats.cache_hits.values()) == 1


def test_sources_that_changed_while_a_process_runs_leave_the_cache_alone(
    load: Callable[[], ModuleType], tmp_path: Path
) -> None:
    """What it has in memory need not be what the file says now: neither kept for later processes, nor read."""
    assert load().twice(1.5) == 3.0
    kept = {path: path.read_bytes() for path in (tmp_path / "cache").rglob("*.nb?")}
    os.utime(tmp_path / "small.py")
    changed = load()
    assert changed.twice(1.5) == 3.0 and not changed.twice.stats.cache_hits
    assert changed.twice(2) == 4.0
    assert kept == {path: path.read_bytes() for path in (tmp_path / "cache").rglob("*.nb?")}


def test_a_disk_that_takes_nothing_is_no_failure(
    load: Callable[[], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    module = load()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lunarsci.compiled.machine_code._Entries._open_for_write", full)
    assert module.twice(1.5) == 3.0


@pytest.mark.parametrize(("place", "mode"), [("cache", 0o775), ("cache/*", 0o757)])
def test_a_cache_that_others_can_write_is_said_and_not_used(
    load: Callable[[], ModuleType], tmp_path: Path, place: str, mode: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lunarsci.compiled.machine_code._is_private_group", lambda number: False)
    _tell.cache_clear()
    load().twice(1.5)
    [folder] = tmp_path.glob(place)
    folder.chmod(mode)
    with pytest.warns(LunarSciWarning, match="can be written by others: compiled code is not kept there") as told:
        found, again = load(), load()
        assert found.twice(1.5) == again.twice(1.5) == 3.0 and found.twice._cache.cache_path is None
    assert len(told) == 1 and str(folder) in str(told[0].message)
    folder.chmod(0o755)
    assert load().twice(1.5) == 3.0


def test_a_cache_of_another_user_is_said_and_not_used(
    load: Callable[[], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    _tell.cache_clear()
    monkeypatch.setattr("lunarsci.compiled.machine_code.os.getuid", lambda: 12345)
    monkeypatch.setattr("lunarsci.compiled.machine_code.ROOT", 54321)
    with pytest.warns(LunarSciWarning, match="belongs to another user: compiled code is not kept there"):
        assert load().twice(1.5) == 3.0


def test_a_shared_folder_may_hold_a_cache_where_only_owners_delete(
    load: Callable[[], ModuleType], tmp_path: Path
) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o1777)
    load().twice(1.5)
    again = load()
    assert again.twice(1.5) == 3.0 and sum(again.twice.stats.cache_hits.values()) == 1


def test_code_is_stale_when_a_file_changes_that_its_file_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lunarsci.compiled.machine_code.PACKAGE", tmp_path)

    def digest() -> str:
        for kept in (_imported, _content, sources, sources_digest):
            kept.cache_clear()
        return sources_digest(str(tmp_path / "top.py"))

    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "__init__.py").write_text("")
    (tmp_path / "inner" / "deep.py").write_text("X = 1\n")
    (tmp_path / "middle.py").write_text("def late():\n    from lunarsci.inner import (\n        deep,\n    )\n")
    (tmp_path / "apart.py").write_text("Y = 1\n")
    (tmp_path / "top.py").write_text("from lunarsci.middle import late\n")
    first = digest()
    (tmp_path / "apart.py").write_text("Y = 2\n")
    assert digest() == first
    (tmp_path / "inner" / "deep.py").write_text("X = 2\n")
    assert digest() != first
    (tmp_path / "inner" / "deep.py").write_text("X = 1\n")
    assert digest() == first


def test_a_time_step_depends_on_the_formulas_of_the_wheel() -> None:
    from lunarsci.twin.simulation import contact, members

    assert Path(contact.__file__) in sources(members.__file__)


@pytest.mark.slow
def test_the_process_that_compiles_gives_the_bytes_of_later_ones(tmp_path: Path) -> None:
    forces = ("regolith", "forces", "--load", "36", "--slip", "0.2", "--side-slip", "5", "--shear", "ellipse", "--json")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "lunarsci.cli", *forces, "--no-time", "--quiet"]
    cold, warm = (subprocess.run(command, capture_output=True, env=environment, check=True).stdout for _ in range(2))
    assert list((tmp_path / "cache").rglob("*.nbc"))
    assert len(cold) > 1000 and cold == warm


def test_compiled_functions_run_as_plain_python_for_a_debugger() -> None:
    line = "regolith forces --sinkage 0.01 --field drawbar_pull_n"
    command = [sys.executable, "-m", "lunarsci.cli", *line.split()]
    compiled_pull, plain_pull = (
        subprocess.run(command, env=os.environ | extra, capture_output=True, text=True, check=True).stdout
        for extra in ({}, {"NUMBA_DISABLE_JIT": "1"})
    )
    assert float(plain_pull) == pytest.approx(float(compiled_pull), rel=1e-12)
