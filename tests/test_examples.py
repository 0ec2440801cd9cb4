"""The scripts of `examples/` as a user runs them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def drive_loop(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return subprocess.run(
        ["bash", str(EXAMPLES / "drive_loop.sh"), str(folder), *arguments],
        capture_output=True, text=True, env=os.environ | {"PATH": path}, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_the_loop_predicts_the_return_and_gives_the_same_bytes_again(tmp_path: Path) -> None:
    """Nothing of the hidden soil reaches the twin but telemetry, and yet it knows where the return will end."""
    first, again = tmp_path / "first", tmp_path / "again"
    done, twice = drive_loop(first), drive_loop(again)
    assert done.returncode == 0, done.stderr
    found = re.search(r"ended ([\d.]+) m from where it was predicted to, ([\d.]+) m from", done.stdout)
    assert found is not None
    after, before = map(float, found.groups())
    assert after < 0.15 and after < 0.2 * before
    assert done.stdout == twice.stdout
    names = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert len(names) > 20
    for name in names:
        assert (first / name).read_bytes() == (again / name).read_bytes(), name


def test_the_loop_does_not_write_into_a_folder_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    done = drive_loop(tmp_path / "mine")
    assert done.returncode == 1 and "mine" in done.stderr
    assert not list((tmp_path / "mine").iterdir())


def test_the_script_is_no_worse_than_shells_say(tmp_path: Path) -> None:
    assert subprocess.run(["bash", "-n", str(EXAMPLES / "drive_loop.sh")], check=False).returncode == 0
    assert os.access(EXAMPLES / "drive_loop.sh", os.X_OK)
