"""The scripts of `examples/` as a user runs them."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from lunarsci.images.rig_files import read_rig, rig_text

EXAMPLES = Path(__file__).parents[1] / "examples"


def environment(program: Path) -> dict[str, str]:
    return os.environ | {"PATH": os.pathsep.join([str(program), os.environ["PATH"]])}


SCRIPTS = ("drive_loop.sh", "picture_loop.sh")
ENDED = re.compile(r"ended ([\d.]+) m from where it was predicted to, ([\d.]+) m from")


def drive_loop(
    folder: Path, program: Path, *further: str, script: str = SCRIPTS[0]
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", str(EXAMPLES / script), str(folder), *further],
        capture_output=True, text=True, env=environment(program), check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_the_loop_predicts_the_return(tmp_path: Path, program: Path) -> None:
    """Nothing of the hidden soil reaches the twin but telemetry, and yet it knows where the return will end."""
    done = drive_loop(tmp_path / "loop", program)
    assert done.returncode == 0, done.stderr
    found = ENDED.search(done.stdout)
    after, before = map(float, found.groups())
    assert after < 0.15 and after < 0.2 * before


@pytest.mark.slow
@pytest.mark.study
def test_the_loop_that_begins_with_pictures_predicts_the_return(tmp_path: Path, program: Path) -> None:
    """Nothing of ground, places and ruts reaches the twin but pictures: a Navcam's with half of the pixels each way."""
    pytest.importorskip("cv2")
    rig = tmp_path / "rig.toml"
    rig.write_text(rig_text(read_rig("yutu2-navcam").with_pixels(512)))
    done = drive_loop(tmp_path / "loop", program, "1", str(rig), script="picture_loop.sh")
    assert done.returncode == 0, done.stderr
    found = ENDED.search(done.stdout)
    after, before = map(float, found.groups())
    assert after < 0.1 and after < 0.4 * before
    sent = (tmp_path / "loop/5-located/positions.csv").read_text().splitlines()
    assert len(sent) == 6 and all(",True," in line for line in sent[1:])
    assert sum(line.endswith(",ok") for line in (tmp_path / "loop/ruts.csv").read_text().splitlines()) > 10


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_loop_does_not_write_into_a_folder_that_is_there(tmp_path: Path, program: Path, script: str) -> None:
    (tmp_path / "mine").mkdir()
    done = drive_loop(tmp_path / "mine", program, script=script)
    assert done.returncode == 1 and "mine" in done.stderr
    assert not list((tmp_path / "mine").iterdir())


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_script_is_no_worse_than_shells_say(script: str) -> None:
    assert subprocess.run(["bash", "-n", str(EXAMPLES / script)], check=False).returncode == 0
    assert os.access(EXAMPLES / script, os.X_OK)
