"""The scripts of `examples/` as a user runs them."""

import os
import re
import subprocess
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def environment(program: Path) -> dict[str, str]:
    return os.environ | {"PATH": os.pathsep.join([str(program), os.environ["PATH"]])}


def drive_loop(folder: Path, program: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", str(EXAMPLES / "drive_loop.sh"), str(folder)],
        capture_output=True, text=True, env=environment(program), check=False,
    )  # fmt: skip


def same_files(one: Path, other: Path) -> int:
    """The number of files below two folders, each the same in both."""
    names = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(other) for path in other.rglob("*") if path.is_file())
    assert [name for name in names if (one / name).read_bytes() != (other / name).read_bytes()] == []
    return len(names)


@pytest.mark.slow
def test_the_loop_predicts_the_return_and_gives_the_same_bytes_again(tmp_path: Path, program: Path) -> None:
    """Nothing of the hidden soil reaches the twin but telemetry, and yet it knows where the return will end."""
    loop = tmp_path / "loop"
    done = drive_loop(loop, program)
    assert done.returncode == 0, done.stderr
    found = re.search(r"ended ([\d.]+) m from where it was predicted to, ([\d.]+) m from", done.stdout)
    assert found is not None
    after, before = map(float, found.groups())
    assert after < 0.15 and after < 0.2 * before
    # Every command that draws, or that computes in threads, once more; the rest of the loop reads what these write.
    states = "3-states/states.csv --positions 3-states/positions.csv"
    for command in (
        "predict -o again-1",
        f"simulate --soil {EXAMPLES}/hidden_soil.toml -o again-2",
        f"update {states} --save again.json",
        "predict return.toml --soil belief.json -o again-7",
    ):
        line = ["lunarsci", "twin", *command.split(), "--seed", "1", "--no-time", "--quiet"]
        assert subprocess.run(line, cwd=loop, env=environment(program), capture_output=True).returncode == 0
    assert same_files(loop / "1-predicted", loop / "again-1") > 4
    assert same_files(loop / "2-drive", loop / "again-2") > 2
    assert same_files(loop / "7-predicted", loop / "again-7") > 4
    assert (loop / "again.json").read_bytes() == (loop / "belief.json").read_bytes()


def test_the_loop_does_not_write_into_a_folder_that_is_there(tmp_path: Path, program: Path) -> None:
    (tmp_path / "mine").mkdir()
    done = drive_loop(tmp_path / "mine", program)
    assert done.returncode == 1 and "mine" in done.stderr
    assert not list((tmp_path / "mine").iterdir())


def test_the_script_is_no_worse_than_shells_say(tmp_path: Path) -> None:
    assert subprocess.run(["bash", "-n", str(EXAMPLES / "drive_loop.sh")], check=False).returncode == 0
    assert os.access(EXAMPLES / "drive_loop.sh", os.X_OK)
