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

from lunarsci.blocks import computing, run_blocks
from lunarsci.errors import ParameterError, SchedulerError
from lunarsci.kept_blocks import spans

distributed = pytest.importorskip("distributed")
TOTAL, ROWS = 1000, 25


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


def test_a_worker_is_killed_and_the_answer_is_the_same(cluster: Any) -> None:
    victim = next(iter(cluster.workers.values())).pid
    told: list[int] = []

    def kill_once(done: int, _: int) -> None:
        if done > 200 and not told:
            os.kill(victim, signal.SIGKILL)
            told.append(done)

    blocks = spans(TOTAL, ROWS)
    with computing(scheduler=cluster.scheduler_address):
        found = dict(run_blocks(squares, blocks, progress=kill_once))
    assert told
    assert sorted(found, key=lambda block: block.start) == blocks
    assert np.array_equal(np.concatenate([found[block] for block in blocks]), np.arange(TOTAL, dtype=float) ** 2)


def test_an_error_of_a_block_comes_back_as_it_was(cluster: Any) -> None:
    with computing(scheduler=cluster.scheduler_address), pytest.raises(ParameterError, match="row 500"):
        list(run_blocks(failing_at, spans(TOTAL, ROWS)))


def test_a_scheduler_that_is_not_there_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.cluster.CONNECT_S", 0.5)
    with computing(scheduler="tcp://127.0.0.1:9"), pytest.raises(SchedulerError, match="does not answer"):
        list(run_blocks(squares, spans(TOTAL, ROWS)))


def test_a_scheduler_without_workers_is_left_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.cluster.LONELY_S", 0.5)
    monkeypatch.setattr("lunarsci.cluster.LOOK_S", 0.1)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as empty,
        computing(scheduler=empty.scheduler_address),
        pytest.raises(SchedulerError, match="no worker for"),
    ):
        list(run_blocks(squares, spans(TOTAL, ROWS)))


def test_another_version_of_a_worker_is_refused(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.cluster.build", lambda: ("0.0.9", "a processor"))
    with (
        computing(scheduler=cluster.scheduler_address),
        pytest.raises(SchedulerError, match=r"here is 0\.0\.9; install"),
    ):
        list(run_blocks(squares, spans(TOTAL, ROWS)))


def test_drives_of_a_cluster_have_the_same_bytes(cluster: Any, tmp_path: Path) -> None:
    """Of more groups than there are blocks, the last of them not full."""
    command = ["twin", "predict", "--members", "150", "--seed", "3", "--sample", "0.5", "--no-time", "--json"]
    for name, where in (("here", []), ("there", ["--scheduler", cluster.scheduler_address])):
        assert main([*command, *where, "-o", str(tmp_path / name)]) in (0, 3)
    files = sorted(path.name for path in (tmp_path / "here").iterdir())
    assert "states.csv" in files
    assert sorted(path.name for path in (tmp_path / "there").iterdir()) == files
    for name in files:
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes(), name


def test_a_cluster_by_hand_as_the_page_has_it(tmp_path: Path) -> None:
    page = (Path(__file__).parents[1] / "docs/cluster.md").read_text("utf-8")
    script = page.split("```sh\n")[1].split("```")[0]
    for name, module in (("dask", "dask"), ("lunarsci", "lunarsci.cli")):
        script = re.sub(rf"^{name} ", f"{sys.executable} -m {module} ", script, flags=re.MULTILINE)
    assert script.count(sys.executable) == 3
    script += "code=$?\nkill $(jobs -p)\nexit $code\n"
    found = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert found.returncode in (0, 3), found.stderr
    assert found.stdout.startswith(("GO: ", "NO-GO: "))
