"""The same bytes from the same input, seed and version, whatever the threads, hashes, language and time zone."""

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

HERE = {"NUMBA_NUM_THREADS": "2", "PYTHONHASHSEED": "1", "TZ": "UTC", "LC_ALL": "C.UTF-8", "COLUMNS": "80"}
ELSEWHERE = {
    "NUMBA_NUM_THREADS": "1", "PYTHONHASHSEED": "2", "TZ": "Pacific/Apia", "LC_ALL": "tr_TR.UTF-8", "COLUMNS": "200"
}  # fmt: skip
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
PROGRAM = """
import contextlib, locale, sys
with contextlib.suppress(locale.Error):  # of a system without that language
    locale.setlocale(locale.LC_ALL, "")  # as programs with windows do: C's reading and writing of numbers follows it
assert locale.localeconv()["decimal_point"] in sys.argv[1]
from lunarsci.cli import main
for command in (["regolith", "forces", "--sinkage", "0.01"], ["spectra", "indices", sys.argv[2]],
                ["spectra", "fit", sys.argv[2], "--assemblage", "OPX-CPX"],
                ["twin", "predict", "--members", "20", "--seed", "3", "--sweep", "cohesion_pa=200:1000:3"]):
    assert main([*command, "--json", "--no-time", "-q"]) in (0, 3)
"""
"""Arguments: the sign before the decimals, and a file of spectra."""


def write_spectra(file: Path) -> None:
    """Twenty made-up spectra with two bands each."""
    nm = np.arange(500.0, 2500.0, 20.0)
    rng = np.random.default_rng(5)
    columns = [nm]
    for _ in range(20):
        deep, shallow = rng.uniform(0.1, 0.3, 2)
        bands = deep * np.exp(-(((nm - 960) / 110) ** 2)) + shallow * np.exp(-(((nm - 2050) / 240) ** 2))
        columns.append((0.1 + 2e-5 * nm) * np.exp(-bands) * (1 + 0.002 * rng.standard_normal(nm.size)))
    names = ",".join(["wavelength_nm", *(f"rock{k:02d}" for k in range(20))])
    np.savetxt(file, np.column_stack(columns), "%.6f", ",", header=names, comments="")


MOVED = {
    "both": {"bands": 1e-11, "fit": 1e-10},
    "all": {"identify": 1e-10, "forces": 1e-13, "predict sweep": 1e-10},
}
"""By setting of `tests/benchmarks/processors.py`, how far an answer may move as a share of its numbers: three to twenty
times as far as they did. Of the second, whose machine code is made anew, only what is made in a few seconds."""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="settings are those of x86-64")
@pytest.mark.parametrize(
    ("setting", "names"),
    [("both", [*MOVED["both"]]), ("all", ["forces"]), pytest.param("all", [*MOVED["all"]], marks=pytest.mark.study)],
)
def test_on_other_processors_only_last_digits_move(
    setting: str, names: list[str], load_benchmark: Callable[[str], ModuleType], tmp_path: Path
) -> None:
    """numpy without vector instructions, BLAS of an old processor, machine code for any x86-64."""
    processors = load_benchmark("processors")
    bounds, cache = MOVED[setting], Path(os.environ["NUMBA_CACHE_DIR"])
    here = processors.answers_in("here", names, tmp_path, cache)
    other = cache if setting == "both" else cache.with_name(f"{cache.name}-generic")
    there = processors.answers_in(setting, names, tmp_path, other)
    moved = {name: sorted(processors.moves(here[name], there[name]), reverse=True)[:1] for name in names}
    assert {name: most for name, most in moved.items() if most and most[0][0] > bounds[name]} == {}
    assert any(moved.values()), "not a digit moved: is the setting taken?"


def answers(spectra: Path, environment: dict[str, str], point: str = ".,") -> bytes:
    """What four commands print in a process that took its language from the environment."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, point, str(spectra)],
        env={**os.environ, **environment}, capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    return done.stdout


def with_decimal_commas(folder: Path) -> dict[str, str]:
    """An environment with them, made from the system's sources of German."""
    german = ["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / "de_DE.UTF-8")]
    if shutil.which("localedef") is None or subprocess.run(german, capture_output=True, check=False).returncode:
        pytest.skip("this system cannot make a locale with decimal commas")
    return {"LC_ALL": "de_DE.UTF-8", "LOCPATH": str(folder)}


@pytest.fixture(scope="module")
def spectra(tmp_path_factory: pytest.TempPathFactory) -> Path:
    write_spectra(file := tmp_path_factory.mktemp("spectra") / "SYNTHETIC.csv")
    return file


@pytest.fixture(scope="module")
def expected(spectra: Path) -> bytes:
    return answers(spectra, HERE)


@pytest.mark.parametrize("environment", [ELSEWHERE, ASCII])
def test_the_same_bytes_everywhere(environment: dict[str, str], spectra: Path, expected: bytes) -> None:
    assert answers(spectra, environment) == expected != b""


def test_the_same_bytes_with_decimal_commas(spectra: Path, expected: bytes, tmp_path: Path) -> None:
    assert answers(spectra, with_decimal_commas(tmp_path), ",") == expected
