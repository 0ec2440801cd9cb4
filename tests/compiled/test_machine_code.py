"""Compiled code: the same digits from whoever compiles, and a cache that notices changed sources and damage."""

import importlib.util
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
import pytest

from lunarsci.compiled import compiled, machine_code
from lunarsci.compiled.kept import DIGEST_BYTES, _content, _imported, _tell, sources, sources_digest
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


def test_an_entry_keeps_its_copies_of_others_to_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A weak copy gives way to any other of its name that is loaded already, and that may round differently."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    linkages: dict[str, object] = {}
    emit = llvm.TargetMachine.emit_object

    def noting(machine: Any, module: Any) -> bytes:
        linkages.update((one.name, one.linkage) for one in module.functions if not one.is_declaration)
        return bytes(emit(machine, module))

    monkeypatch.setattr(llvm.TargetMachine, "emit_object", noting)
    expected = steps(5) + steps(6)
    linkages.clear()
    assert compiled(total)(5) == pytest.approx(expected)
    assert any("steps" in name for name in linkages), "the copy is not inlined, or this test shows nothing"
    [exported] = [name for name, linkage in linkages.items() if linkage != llvm.Linkage.internal]
    assert exported.startswith("total-")


@compiled
def halved(x: float, times: int) -> float:
    return x / 2.0**times


def by_constants(x: float) -> float:
    return halved(x, 1) + halved(x, 2)


def test_a_part_is_made_once_for_all_constants_and_has_no_code_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert compiled(by_constants)(8.0) == 6.0
    [part] = halved.part().overloads.values()
    assert part.library.get_pointer_to_function(part.fndesc.mangled_name) == 0
    assert halved(8.0, 3) == 1.0


class Two(NamedTuple):
    whole: np.ndarray
    flag: bool


@compiled
def all_kinds(two: Two, x: float, n: int, nothing: None, table: np.ndarray) -> tuple[float, bool, int, np.ndarray]:
    out = np.empty((2, n))
    for k in range(n):
        out[0, k] = two.whole[k] + table[k, 1]
        out[1, k] = k if two.flag and nothing is None else x
    return x + two.whole[0], two.flag, n - 1, out.T


@pytest.mark.parametrize("flag", [True, np.False_])
@pytest.mark.parametrize("order", ["C", "F", "A"])
def test_what_goes_in_and_comes_out_is_what_python_has(flag: bool, order: str) -> None:
    """Single numbers, short whole ones, tables of every order, and arrays that the function makes."""
    table = np.arange(12, dtype=np.float32).reshape(3, 4).T if order == "F" else np.arange(24.0).reshape(4, 6)
    table = table[::-1, ::2] if order == "A" else table
    given = Two(np.array([5, 7, 9], dtype=np.int16), flag), np.float32(0.5), np.int64(3), None, table
    found, expected = all_kinds(*given), all_kinds.__wrapped__(*given)
    assert [type(one) for one in found] == [float, bool, int, np.ndarray] and found[:3] == expected[:3]
    assert found[3].tolist() == expected[3].tolist() and found[3].flags.f_contiguous


@compiled
def drawn(generator: np.random.Generator) -> tuple[float, float]:
    return generator.standard_normal(), generator.uniform(2.0, 3.0)


def test_generators_draw_as_in_python_and_go_on_there() -> None:
    ours, theirs = np.random.default_rng(3), np.random.default_rng(3)
    assert drawn(ours) == drawn.__wrapped__(theirs) and ours.random() == theirs.random()


@compiled
def share(x: float, y: float) -> float:
    return x / y


def test_a_division_by_zero_is_an_error_of_python() -> None:
    assert share(1.0, 2.0) == 0.5
    with pytest.raises(ArithmeticError, match="share"):
        share(1.0, 0.0)


@compiled
def refusing(n: int) -> int:
    if n > 0:
        raise ValueError(f"{n} is above 0")
    return n


def test_errors_with_texts_need_nothing_of_numba(
    made: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    again = compiled(refusing.__wrapped__)
    with pytest.raises(ArithmeticError, match="an error of its own"):
        again(1)
    assert again(-1) == -1 and len(made) == 1
    [kept] = tmp_path.rglob("refusing-*")
    about = kept.read_bytes()[DIGEST_BYTES:].partition(b"\n")[0]
    assert b"symbols" in about and b"NRT_" not in about


@compiled
def grown(n: int) -> int:
    numbers = [0]
    for k in range(n):
        numbers.append(k)
    return len(numbers)


def test_lists_that_grow_are_refused_and_end_no_process() -> None:
    with pytest.raises(TypeError, match="that grow"):
        grown(100)


@compiled
def largest(values: np.ndarray) -> np.uint64:
    return values.max()


def test_whole_numbers_without_a_sign_come_back_whole() -> None:
    assert largest(np.array([3, 2**64 - 1], dtype=np.uint64)) == 2**64 - 1


def test_what_no_machine_code_takes_is_refused() -> None:
    with pytest.raises(TypeError, match="complex128"):
        share(1j, 2.0)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of what was compiled."""
    names: list[str] = []
    make = machine_code.entry

    def noting(name: str, *others: Any) -> Any:
        names.append(name)
        return make(name, *others)

    monkeypatch.setattr(machine_code, "entry", noting)
    return names


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: list[str]) -> Callable[..., bool]:
    """Import a small module with a compiled function anew, its code kept in `tmp_path / "cache"`, and call that."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))

    def again(x: float = 1.5, folder: Path = tmp_path) -> bool:
        """Whether it was compiled."""
        file = folder / "small.py"
        if not file.exists():
            file.write_text(MODULE)
            os.utime(file, (0, 0))  # older than this process
        spec = importlib.util.spec_from_file_location("small", file)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        before = len(made)
        assert module.twice(x) == 2 * x
        return len(made) > before

    return again


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[: len(b) // 2], lambda b: b[:-9] + b"123456789"])
def test_damaged_code_is_made_anew(load: Callable[..., bool], tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    assert load() and not load()
    [file] = (tmp_path / "cache").rglob("twice-*")
    file.write_bytes(damage(file.read_bytes()))
    assert load() and not load()


def test_the_same_sources_elsewhere_have_the_same_code(load: Callable[..., bool], tmp_path: Path) -> None:
    """Another checkout, of another time; another source has its own."""
    (tmp_path / "other").mkdir()
    assert load() and not load(folder=tmp_path / "other")
    (tmp_path / "other" / "small.py").write_text(MODULE.replace("2.0 * x", "x + x"))
    os.utime(tmp_path / "other" / "small.py", (0, 0))
    for kept_in_process in (_content, sources_digest):
        kept_in_process.cache_clear()
    assert load(folder=tmp_path / "other") and not load()


def test_code_that_nobody_reads_for_long_is_taken_away(load: Callable[..., bool], tmp_path: Path) -> None:
    assert load()
    [old] = (tmp_path / "cache").rglob("twice-*")
    weeks_ago = time.time() - 20 * 86400
    os.utime(old, (weeks_ago, weeks_ago))
    assert not load() and old.stat().st_mtime > weeks_ago + 86400, "what is read is young again"
    os.utime(old, (0, 0))
    assert load(2) and not old.exists()


def test_sources_that_changed_while_a_process_runs_leave_what_is_kept_alone(
    load: Callable[..., bool], tmp_path: Path
) -> None:
    """What it has in memory need not be what the file says now: neither kept for later processes, nor read."""
    assert load()
    kept = {path: path.read_bytes() for path in (tmp_path / "cache").rglob("twice-*")}
    os.utime(tmp_path / "small.py")
    assert load() and load(2)
    assert kept == {path: path.read_bytes() for path in (tmp_path / "cache").rglob("twice-*")}


def test_sources_that_changed_before_the_first_call_are_not_kept_for_others(tmp_path: Path) -> None:
    """The process has what the file said when it was imported."""
    file = tmp_path / "small.py"
    line = "import small, time; {}; print(small.twice(1.5))"
    change = f"time.sleep(0.05); open(small.__file__, 'w').write({MODULE.replace('2.0', '3.0')!r})"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    file.write_text(MODULE)
    os.utime(file, (0, 0))

    def printed(between: str) -> str:
        program = [sys.executable, "-c", line.format(between)]
        return subprocess.run(program, cwd=tmp_path, env=environment, capture_output=True, check=True, text=True).stdout

    assert printed(change).strip() == "3.0"
    os.utime(file, (0, 0))
    assert printed("pass").strip() == "4.5"


def test_a_disk_that_takes_nothing_is_no_failure(load: Callable[..., bool], monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    (Path(os.environ["NUMBA_CACHE_DIR"]).parent / "small.py").write_text(MODULE)
    os.utime(Path(os.environ["NUMBA_CACHE_DIR"]).parent / "small.py", (0, 0))
    assert load()


@pytest.mark.parametrize(("place", "mode"), [("cache", 0o775), ("cache/*", 0o757)])
def test_a_folder_that_others_can_write_is_said_and_not_used(
    load: Callable[..., bool], tmp_path: Path, place: str, mode: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lunarsci.compiled.kept._is_private_group", lambda number: False)
    _tell.cache_clear()
    load()
    [folder] = tmp_path.glob(place)
    folder.chmod(mode)
    with pytest.warns(LunarSciWarning, match="can be written by others: compiled code is not kept there") as told:
        assert load() and load()
    assert len(told) == 1 and str(folder) in str(told[0].message)
    folder.chmod(0o755)
    assert not load()


def test_a_folder_of_another_user_is_said_and_not_used(
    load: Callable[..., bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    _tell.cache_clear()
    monkeypatch.setattr("lunarsci.compiled.kept.os.getuid", lambda: 12345)
    monkeypatch.setattr("lunarsci.compiled.kept.ROOT", 54321)
    with pytest.warns(LunarSciWarning, match="belongs to another user: compiled code is not kept there"):
        assert load()


def test_a_shared_folder_may_hold_code_where_only_owners_delete(load: Callable[..., bool], tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o1777)
    assert load() and not load()


def test_code_is_stale_when_a_file_changes_that_its_file_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lunarsci.compiled.kept.PACKAGE", tmp_path)

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
    assert list((tmp_path / "cache").rglob("*-*"))
    assert len(cold) > 1000 and cold == warm


def test_what_is_kept_runs_without_numba() -> None:
    """Which takes half a second to start."""
    line = "import sys; from lunarsci.cli import main; main({}.split()); print('numba' in sys.modules)"
    program = [sys.executable, "-c", line.format("'regolith forces --sinkage 0.01 --quiet'")]
    subprocess.run(program, capture_output=True, check=True)
    again = subprocess.run(program, capture_output=True, check=True, text=True)
    assert "drawbar pull" in again.stdout and again.stdout.endswith("False\n")


def test_compiled_functions_run_as_plain_python_for_a_debugger() -> None:
    line = "regolith forces --sinkage 0.01 --field drawbar_pull_n"
    command = [sys.executable, "-m", "lunarsci.cli", *line.split()]
    compiled_pull, plain_pull = (
        subprocess.run(command, env=os.environ | extra, capture_output=True, text=True, check=True).stdout
        for extra in ({}, {"NUMBA_DISABLE_JIT": "1"})
    )
    assert float(plain_pull) == pytest.approx(float(compiled_pull), rel=1e-12)


@compiled
def _ranked(count: int, values: Any) -> int:
    total = 0
    for _ in range(count):
        total += np.argsort(values)[0] + len([values[0]] * 100)
    return total


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system does not say what a process holds")
def test_what_compiled_code_makes_for_itself_is_given_back() -> None:
    """Arrays, and lists, such as sorting makes, whose entries lie apart."""

    def held_mb() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6

    values = np.random.default_rng(1).random(20)
    least = int(values.argmin())
    assert _ranked(1000, values) == 1000 * (least + 100)
    before = held_mb()
    assert _ranked(20_000, values) == 20_000 * (least + 100)
    assert held_mb() - before < 5.0
