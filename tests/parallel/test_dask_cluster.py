"""The same bytes from the workers of a real dask scheduler on this machine, also when one of them is killed."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lunarsci.cli import main

from lunarsci.arrays import spans
from lunarsci.errors import ParameterError, SchedulerError
from lunarsci.parallel.blocks import computing, run_blocks
from lunarsci.parallel.dask_cluster import _Crew

distributed = pytest.importorskip("distributed")
TOTAL, ROWS = 1000, 25
SHORT = """name = "short"
[drive]
speed_m_s = 0.05
[[leg]]
length_m = 0.6
"""


def squares(block: range) -> Any:
    time.sleep(0.02)
    return np.array([k * k for k in block], dtype=float)


def failing_at(block: range) -> Any:
    if 500 in block:
        raise ParameterError("row 500 is wrong")
    return squares(block)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as made:
        yield made


def same_files(one: Path, other: Path) -> None:
    """Two folders, byte by byte."""
    files = sorted(path.name for path in one.iterdir())
    assert files == sorted(path.name for path in other.iterdir())
    for name in files:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def run(folder: Path, line: str, *where: str) -> None:
    """A command, its result as JSON into a folder."""
    folder.mkdir()
    arguments = [part.format(folder=folder) for part in line.split()]
    assert main([*arguments, *where, "--no-time", "-q"]) in (0, 3)


def test_a_worker_is_killed_under_way_and_drives_have_the_same_bytes(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of more groups than there are workers, the last of them not full; the worker dies when a first block is back."""
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(SHORT)
    line = ("twin predict short.toml --members 70 --sweep friction_angle_deg=30:50:3 --seed 3 --sample 0.5 --json "
            "-o {folder}/made")  # fmt: skip
    run(tmp_path / "here", line)
    victim, real, killed = next(iter(cluster.workers.values())).pid, _Crew.finished, []

    def finished(self: _Crew, running: Any) -> list[Any]:
        found = real(self, running)
        if found and not killed:
            assert len(running) > len(found), "or nothing is under way"
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)
        return found

    monkeypatch.setattr(_Crew, "finished", finished)
    run(tmp_path / "there", line, "--scheduler", cluster.scheduler_address)
    assert killed == [victim]
    same_files(tmp_path / "here/made", tmp_path / "there/made")


def test_an_update_of_a_cluster_has_the_same_bytes(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(SHORT)
    for line in ("simulate short.toml --seed 5 -o drive",
                 "states drive/telemetry.csv short.toml --track drive/track.csv -o states"):  # fmt: skip
        assert main(["twin", *line.split(), "-q"]) in (0, 3)
    line = ("twin update states/states.csv --plan short.toml --positions states/positions.csv --seed 1 --particles 32 "
            "--no-ruts --save {folder}/belief.json --json -o {folder}/update.json")  # fmt: skip
    run(tmp_path / "here", line)
    run(tmp_path / "there", line, "--scheduler", cluster.scheduler_address)
    for name in ("belief.json", "update.json"):
        one, other = ((tmp_path / where / name).read_text() for where in ("here", "there"))
        assert one.replace("/here/", "/there/") == other, name


def test_an_error_of_a_block_comes_back_as_it_was(cluster: Any) -> None:
    with computing(scheduler=cluster.scheduler_address), pytest.raises(ParameterError, match="row 500"):
        list(run_blocks(failing_at, spans(TOTAL, ROWS)))


def test_a_scheduler_that_is_not_there_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.parallel.dask_cluster.CONNECT_S", 0.5)
    with computing(scheduler="tcp://127.0.0.1:9"), pytest.raises(SchedulerError, match="does not answer"):
        list(run_blocks(squares, spans(TOTAL, ROWS)))


def test_a_scheduler_without_workers_is_left_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.parallel.dask_cluster.LONELY_S", 0.5)
    monkeypatch.setattr("lunarsci.parallel.dask_cluster.LOOK_S", 0.1)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as empty,
        computing(scheduler=empty.scheduler_address),
        pytest.raises(SchedulerError, match="no worker for"),
    ):
        list(run_blocks(squares, spans(TOTAL, ROWS)))


def test_another_version_of_a_worker_is_refused(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.parallel.dask_cluster.build", lambda: ("0.0.9", "a processor"))
    with (
        computing(scheduler=cluster.scheduler_address),
        pytest.raises(SchedulerError, match=r"here is 0\.0\.9; install"),
    ):
        list(run_blocks(squares, spans(TOTAL, ROWS)))


def test_a_cluster_by_hand_as_the_page_has_it(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/howto/cluster.md").read_text("utf-8")
    script = page.split("```sh\n")[1].split("```")[0].replace("--members 64", "--members 4")
    assert "--members 4" in script
    for name, module in (("dask", "dask"), ("lunarsci", "lunarsci.cli")):
        script = re.sub(rf"^{name} ", f"{sys.executable} -m {module} ", script, flags=re.MULTILINE)
    assert script.count(sys.executable) == 3
    script += "code=$?\nkill $(jobs -p)\nexit $code\n"
    found = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert found.returncode in (0, 3), found.stderr
    assert found.stdout.startswith(("GO: ", "NO-GO: "))


def test_the_notebook_of_the_page_runs(cluster: Any) -> None:
    page = (Path(__file__).parents[2] / "docs/howto/cluster.md").read_text("utf-8")
    cell = page.split("```python\n")[1].split("```")[0]
    for shown, used in {"tcp://10.0.0.1:8786": cluster.scheduler_address, "4096": "4", "(1, 2, 3)": "(1,)"}.items():
        assert shown in cell
        cell = cell.replace(shown, used)
    found: dict[str, Any] = {}
    exec(cell, found)
    assert len(found["drives"][1].prediction.paths) == 4


def test_drives_that_are_compared_on_a_cluster_have_the_same_bytes(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    line = ("twin plan --target 2,0.3 --risk 0.3 --members 16 --candidates 4 --fixes 0.05,0.5 --seed 2 "
            "--sweep friction_angle_deg=30:50:3 --json -o {folder}/made")  # fmt: skip
    run(tmp_path / "here", line)
    run(tmp_path / "there", line, "--scheduler", cluster.scheduler_address)
    same_files(tmp_path / "here/made", tmp_path / "there/made")
