"""What pip would install, in an empty environment, run from an empty folder."""

import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import numpy
import pytest
import scipy
import typer

ROOT = Path(__file__).parents[1]
LEFT_BEHIND = shutil.ignore_patterns(".git", ".venv", "build", "*.egg-info", "__pycache__", ".*cache", "lunarsci-demo")


def files_of(package: Path) -> set[str]:
    """Files of a package, but for compiled ones."""
    kept = (path.relative_to(package) for path in package.rglob("*") if path.is_file())
    return {path.as_posix() for path in kept if "__pycache__" not in path.parts}


LOOK = """
import ast, importlib.metadata, importlib.util, json, pathlib, pkgutil, re, sys
import lunarsci
for module in pkgutil.walk_packages(lunarsci.__path__, "lunarsci."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
names = set()
for path in pathlib.Path(lunarsci.__file__).parent.rglob("*.py"):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names.add(node.module.split(".")[0])
asked, wanted = set(), ["lunarsci"]
while wanted:
    try:
        lines = importlib.metadata.requires(wanted.pop()) or ()
    except importlib.metadata.PackageNotFoundError:
        continue
    needed = {re.match(r"[\\w.-]+", line)[0].lower() for line in lines if "extra ==" not in line}
    wanted += needed - asked
    asked |= needed
of = importlib.metadata.packages_distributions()
other = names - sys.stdlib_module_names - {"lunarsci"}
missing = sorted(name for name in other if not {known.lower() for known in of.get(name, ())} & asked)
print(json.dumps({"missing": missing, "place": lunarsci.__file__,
                  "top": [str(importlib.util.find_spec(n)) for n in ("cli", "spectra_data")]}))
"""
"""Imports every module, and looks whether what any of them imports, now or later, is of a package that lunarsci asks
for, or one of those."""
EXTRAS = {"cv2", "distributed", "h5netcdf", "h5py", "jinja2", "markupsafe", "openpyxl", "rasterio", "xarray"}
"""What comes with extras, and is asked for only where it is used."""


@pytest.mark.slow
def test_a_wheel_installs_into_an_empty_environment_and_runs(tmp_path: Path) -> None:
    """All files are packaged, all that is imported is among the dependencies, and the program answers and draws.

    The dependencies are those of the suite, which pip has resolved and installed already.
    """
    source, wheels, empty = tmp_path / "source", tmp_path / "wheels", tmp_path / "empty"
    shutil.copytree(ROOT, source, ignore=LEFT_BEHIND)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", str(wheels), str(source)], check=True)
    [wheel] = wheels.glob("lunarsci-*.whl")
    venv.create(tmp_path / "venv")
    programs = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin")
    python = str(programs / "python")
    subprocess.run([*pip, "--python", python, "install", "--no-deps", "--no-compile", str(wheel)], check=True)
    [package] = (tmp_path / "venv").rglob("site-packages/lunarsci")
    borrowed = {str(Path(module.__file__).parents[1]) for module in (numpy, scipy, typer)}
    (package.parent / "dependencies.pth").write_text("\n".join(sorted(borrowed)))
    expected = files_of(ROOT / "lunarsci") | {
        f"{folder}/{name}" for folder in ("cli", "spectra_data") for name in files_of(ROOT / folder)
    }
    assert files_of(package) >= {name for name in expected if not name.endswith(".md")}
    empty.mkdir()
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "LUNARSCI"))}

    def said(*command: object) -> str:
        done = subprocess.run([*map(str, command)], cwd=empty, env=clean, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout

    found = json.loads(said(python, "-c", LOOK))
    assert set(found["missing"]) <= EXTRAS
    assert Path(found["place"]).parent == package
    assert found["top"] == ["None", "None"], "cli and spectra_data install inside lunarsci only"
    assert "drawbar pull" in said(programs / "lunarsci", "regolith", "forces", "--load", "36.5", "--plot", "forces.png")
    assert (empty / "forces.png").stat().st_size > 1000
    rock = "ol=0.1,opx=0.4,cpx=0.2,plg=0.3"
    said(programs / "lunarsci", "spectra", "simulate", "--rock", rock, "-o", "scene")
    said(programs / "lunarsci", "spectra", "calibrate", "scene", "-o", "rock.ecsv")
