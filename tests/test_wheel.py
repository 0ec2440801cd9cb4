"""What pip would install, in an empty environment, run from an empty folder."""

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LEFT_BEHIND = shutil.ignore_patterns(".git", ".venv", "build", "*.egg-info", "__pycache__", ".*cache", "lunarsci-demo")


def hand_over_compiled_code(package: Path) -> None:
    """Give an installed package the machine code that the suite has compiled of the same sources so far.

    What is missing or of other sources, by numba's own stamps, the package compiles itself.
    """
    for folder in {path.parent for path in package.rglob("*.py")}:
        for cached in Path(os.environ["NUMBA_CACHE_DIR"]).glob(f"{folder.name}_*/*.nb[ci]"):
            (folder / "__pycache__").mkdir(exist_ok=True)
            shutil.copy(cached, folder / "__pycache__")


@pytest.mark.slow
def test_a_wheel_installs_into_an_empty_environment_and_runs_the_demo(tmp_path: Path) -> None:
    source, wheels, empty = tmp_path / "source", tmp_path / "wheels", tmp_path / "empty"
    shutil.copytree(ROOT, source, ignore=LEFT_BEHIND)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", str(wheels), str(source)], check=True)
    [wheel] = wheels.glob("lunarsci-*.whl")
    venv.create(tmp_path / "venv")
    programs = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin")
    python = str(programs / "python")
    subprocess.run([*pip, "--python", python, "install", "--no-compile", str(wheel)], check=True)
    [package] = (tmp_path / "venv").rglob("site-packages/lunarsci")
    hand_over_compiled_code(package)
    empty.mkdir()
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA", "LUNARSCI"))}
    done = subprocess.run([programs / "lunarsci", "demo"], cwd=empty, env=clean, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "ground: stiffness" in done.stdout
    assert "Traceback" not in done.stderr
    made = {path.name for path in (empty / "lunarsci-demo").iterdir()}
    assert {"bands.png", "fit.png", "drive.png", "soil.png", "result.json", "wheel_states.csv"} <= made
    installed = subprocess.run(
        [python, "-c", "import importlib.util as u; print(u.find_spec('cli'), u.find_spec('spectra_data'))"],
        cwd=empty, env=clean, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert installed.stdout.split() == ["None", "None"], "cli and spectra_data install inside lunarsci only"
