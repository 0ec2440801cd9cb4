"""Blocks of rows: the same bytes however they are computed, stopped, and gone on with."""

import errno
import multiprocessing
import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.arrays import spans
from lunarsci.errors import OutputError, ParameterError
from lunarsci.io.atomic import write_files, written_whole
from lunarsci.parallel.blocks import (
    Computing,
    SavedBlocks,
    blocks_in_order,
    bytes_of,
    computing,
    memory_in_use,
    rows_in_memory,
    run_blocks,
    what_is_saved,
)

TOTAL, ROWS = 4000, 50
ABOUT = {"input": "made up here", "option slope": "3"}


def squares(block: range) -> dict[str, Any]:
    return {"square": np.array([k * k for k in block], dtype=float), "name": np.array([f"row {k}" for k in block])}


def slow_squares(block: range) -> dict[str, Any]:
    time.sleep(0.02)
    return squares(block)


def failing_at(block: range) -> dict[str, Any]:
    if 500 in block:
        raise ParameterError("row 500 is wrong")
    return squares(block)


def collected(work: Any = squares, **about: str) -> np.ndarray[Any, Any]:
    found = list(blocks_in_order(work, TOTAL, ROWS, stage="squares", about=lambda: ABOUT | about))
    assert [block for block, _ in found] == spans(TOTAL, ROWS)
    return np.concatenate([arrays["square"] for _, arrays in found])


EXPECTED = np.arange(TOTAL, dtype=float) ** 2


def test_each_block_comes_once_and_in_order() -> None:
    blocks = spans(TOTAL, ROWS)
    found = dict(run_blocks(squares, blocks))
    assert sorted(found, key=lambda block: block.start) == blocks
    assert np.array_equal(collected(), EXPECTED)


def test_no_more_is_held_than_workers_and_one() -> None:
    under_way, most = 0, 0

    def fetch(block: range) -> range:
        nonlocal under_way, most
        under_way += 1
        most = max(most, under_way)
        return block

    with computing(workers=3):
        for _ in run_blocks(slow_squares, spans(TOTAL, ROWS), fetch=fetch):
            under_way -= 1
    assert 2 <= most <= 4


def test_progress_counts_rows() -> None:
    told: list[tuple[int, int]] = []
    list(run_blocks(squares, spans(100, 30), progress=lambda done, total: told.append((done, total)), done=50))
    assert told[-1] == (150, 150)
    assert told[0] == (50, 150)
    assert len(told) == 5


def test_an_error_of_a_block_is_passed_on_and_says_what_was_kept(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="row 500") as caught, computing(keep=tmp_path / "out.csv"):
        collected(failing_at)
    assert "blocks are kept in" in caught.value.__notes__[0]
    kept, _, of = caught.value.__notes__[0].split(" blocks")[0].split()
    told: list[str] = []
    with computing(keep=tmp_path / "out.csv", notify=told.append):
        assert np.array_equal(collected(), EXPECTED)
    assert told == [f"squares: going on after {kept} of {of} blocks kept from an earlier run"]
    assert list(tmp_path.iterdir()) == []
    with computing(keep=tmp_path / "out.csv", notify=told.append):
        collected()
    assert len(told) == 1, "nothing of a run that begins"


def test_nothing_is_left_of_what_had_no_block_yet(tmp_path: Path) -> None:
    """Then `interrupted; nothing was written` is true, also where the process ends without unwinding."""

    def at_once(block: range) -> dict[str, Any]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught, computing(keep=tmp_path / "out.csv"):
        collected(at_once)
    assert getattr(caught.value, "__notes__", []) == [] and list(tmp_path.iterdir()) == []
    with computing(keep=tmp_path / "out.csv") as here:
        here._saved.append(SavedBlocks(here.folder_of("squares"), ABOUT, TOTAL, ROWS))
        assert (tmp_path / "out.csv.partial").is_dir()
        assert what_is_saved() == [] and list(tmp_path.iterdir()) == []


def test_blocks_for_other_options_are_refused_with_what_differs(tmp_path: Path) -> None:
    with pytest.raises(ParameterError), computing(keep=tmp_path / "out.csv"):
        collected(failing_at)
    with pytest.raises(OutputError, match="option slope: 3, not 4"), computing(keep=tmp_path / "out.csv"):
        collected(**{"option slope": "4"})
    with computing(keep=tmp_path / "out.csv", force=True):
        collected(**{"option slope": "4"})
    assert list(tmp_path.iterdir()) == []


def test_blocks_of_another_version_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers of two programs do not mix."""
    with monkeypatch.context() as patch:
        patch.setattr("lunarsci.parallel.blocks.build", lambda: ("0.1.0 (0123)", ""))
        with pytest.raises(ParameterError), computing(keep=tmp_path / "out.csv"):
            collected(failing_at)
    with pytest.raises(OutputError, match=r"lunarsci: 0\.1\.0 \(0123\), not "), computing(keep=tmp_path / "out.csv"):
        collected()
    with computing(keep=tmp_path / "out.csv", force=True):
        assert np.array_equal(collected(), EXPECTED)


def test_a_damaged_block_is_computed_again(tmp_path: Path) -> None:
    kept = SavedBlocks(tmp_path / "k", ABOUT, TOTAL, ROWS)
    for block in kept.blocks[:4]:
        kept.save(block, squares(block))
    kept.close(remove=False)
    files = sorted((tmp_path / "k").glob("*.npz"))
    content = bytearray(files[0].read_bytes())
    content[200] ^= 1
    files[0].write_bytes(content)
    files[1].write_bytes(files[1].read_bytes()[:-7])
    files[2].unlink()
    again = SavedBlocks(tmp_path / "k", ABOUT, TOTAL, 999)
    assert again.done == {3 * ROWS}
    assert again.blocks == spans(TOTAL, ROWS), "blocks are those that it was begun with"
    again.close(remove=False)


def test_two_commands_are_not_at_one_output(tmp_path: Path) -> None:
    kept = SavedBlocks(tmp_path / "k", ABOUT, TOTAL, ROWS)
    with pytest.raises(OutputError, match="another command"):
        SavedBlocks(tmp_path / "k", ABOUT, TOTAL, ROWS)
    kept.close(remove=True)
    assert not (tmp_path / "k").exists()


def make_file(target: Path) -> None:
    with computing(keep=target, workers=2):
        data = collected(slow_squares).tobytes()
        with written_whole(target) as name:
            name.write_bytes(data)


def started(target: Path) -> Any:
    process = multiprocessing.get_context("fork").Process(target=make_file, args=(target,))
    process.start()
    return process


def test_killed_at_ten_random_moments_it_ends_with_the_same_bytes(tmp_path: Path) -> None:
    """A block takes 20 ms, the whole 0.8 s and more; each run is killed some blocks and up to 20 ms after its start."""
    target, moments = tmp_path / "out.bin", random.Random(7)
    kept = [0]
    for _ in range(10):
        process = started(target)
        while len(files := list(tmp_path.glob("out.bin.partial/squares/*.npz"))) <= kept[-1] and process.is_alive():
            time.sleep(0.002)
        time.sleep(moments.uniform(0.0, 0.02))
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL, "or it was not killed"
        kept.append(len(files))
        assert not target.exists()
    assert kept[0] < kept[1] < kept[-1] < TOTAL // ROWS
    finished = started(target)
    finished.join()
    assert target.read_bytes() == EXPECTED.tobytes()
    assert list(tmp_path.iterdir()) == [target]


def killed_while_it_writes(target: Path) -> None:
    def pieces() -> Any:
        yield b"half"
        os.kill(os.getpid(), signal.SIGKILL)

    write_files({target: pieces()})


def test_what_a_process_left_that_was_killed_as_it_wrote_is_taken_away(tmp_path: Path) -> None:
    target, other = tmp_path / "out.csv", tmp_path / ".out.csv.elsewhere-1-x.part"
    other.write_text("of another machine")
    process = multiprocessing.get_context("fork").Process(target=killed_while_it_writes, args=(target,))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2, "or it was not killed half-way"
    write_files({target: b"whole"})
    assert sorted(tmp_path.iterdir()) == [other, target]
    assert target.read_bytes() == b"whole"


def test_a_full_disk_keeps_what_was_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the system says it: the tenth file that is synchronised finds no room."""
    real, calls = os.fsync, 0

    def full(handle: int) -> None:
        nonlocal calls
        calls += 1
        if calls > 20:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(handle)

    monkeypatch.setattr(os, "fsync", full)
    said = "No space left on device; make it writable or make room"
    with pytest.raises(OutputError, match=said) as caught, computing(keep=tmp_path / "out.csv"):
        collected()
    kept = int(caught.value.__notes__[0].split()[0])
    assert 5 < kept < 15
    monkeypatch.setattr(os, "fsync", real)
    computed: list[range] = []

    def counted(block: range) -> dict[str, Any]:
        computed.append(block)
        return squares(block)

    with computing(keep=tmp_path / "out.csv"):
        assert np.array_equal(collected(counted), EXPECTED)
    assert len(computed) == TOTAL // ROWS - kept


def test_a_target_that_cannot_be_written_is_said_before_anything_is_computed(tmp_path: Path) -> None:
    (tmp_path / "out.csv.partial").write_text("not a folder")
    with pytest.raises(OutputError, match=r"out\.csv\.partial"), computing(keep=tmp_path / "out.csv"):
        collected(failing_at)


@pytest.mark.parametrize(("text", "count"), [("1.5GB", 1_500_000_000), ("800 mb", 800_000_000), ("2GiB", 2**31)])
def test_memory_is_read_with_its_unit(text: str, count: int) -> None:
    assert bytes_of(text) == count


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "lots", "0", "nan"])
def test_memory_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ParameterError, match="such as"):
        Computing(memory=text)


def test_blocks_become_smaller_with_less_memory() -> None:
    assert rows_in_memory(1e6, 4000) == 4000
    enough = f"{memory_in_use() / 1e6 + 3000:.0f}MB"
    with computing(memory=enough, workers=1):
        many = rows_in_memory(1e6, 10**6)
    with computing(memory=enough, workers=3):
        few = rows_in_memory(1e6, 10**6)
    assert 1000 < many < 2000
    assert few == pytest.approx(many / 2, abs=3)
    with computing(memory="1MB"), pytest.raises(ParameterError, match="too little; give"):
        rows_in_memory(1e6, 100)
