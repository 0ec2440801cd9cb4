"""Tests use the lunarsci of their own checkout."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import lunarsci

ROOT = Path(__file__).parents[1]
LOOK = (
    "import lunarsci, lunarsci.cli as c, lunarsci.spectra_data as s; print(lunarsci.__file__, c.__file__, s.__file__)"
)


def test_a_checkout_beside_another_installed_one_tests_itself(tmp_path: Path) -> None:
    """In this process, and in those that it starts, wherever another lunarsci comes first."""
    for name in ("lunarsci", "lunarsci/cli", "lunarsci/spectra_data"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    assert Path(lunarsci.__file__) == ROOT / "lunarsci/__init__.py"
    own = os.environ["PYTHONPATH"]
    for path, top in ((str(tmp_path), tmp_path / "lunarsci"), (f"{own}{os.pathsep}{tmp_path}", ROOT)):
        done = subprocess.run(
            [sys.executable, "-c", LOOK],
            env=os.environ | {"PYTHONPATH": path},
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert all(Path(file).is_relative_to(top) for file in done.stdout.split()), done
        assert len(done.stdout.split()) == 3


@pytest.mark.parametrize(("most", "workers", "code"), [("0", "0", 1), ("0", "1", 1), ("1", "1", 0)])
def test_more_skipped_tests_than_may_be_are_a_failure(tmp_path: Path, most: str, workers: str, code: int) -> None:
    """Also of workers, whose tests the process that began them counts."""
    (tmp_path / "test_x.py").write_text(
        "import pytest\n\ndef test_x():\n    pytest.skip('no browser')\n\ndef test_y():\n    pass\n"
    )
    line = [sys.executable, "-m", "pytest", "-p", "conftest", "-q", f"--most-skipped={most}", "test_x.py"]
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'tests'}{os.pathsep}{os.environ['PYTHONPATH']}"}
    line.append(f"--numprocesses={workers}")
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    assert ("1 tests were skipped, 0 at most may be here" in done.stdout) == (code == 1)
