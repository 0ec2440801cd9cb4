"""Long computations in blocks of rows: here in threads or on a cluster, and kept on disk as they are done.

Rows are spectra, lines of a cube, or members of an ensemble. What a block gives must depend on its rows alone; then the
results are the same however many workers there are, wherever they are, and however often the computation was stopped.

Where blocks are computed is said once, around whatever computes::

    with lunarsci.computing(scheduler="tcp://10.0.0.1:8786"):
        found = lunarsci.predict("plan.toml", members=4096)
"""

import contextlib
import os
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from lunarsci.compiled import threads
from lunarsci.errors import RequestError
from lunarsci.parallel.checkpoint import Arrays, KeptBlocks, spans
from lunarsci.parallel.dask_cluster import connect, on_cluster

Progress: TypeAlias = Callable[[int, int], None]

BLOCKS_EACH = 4
"""Blocks for each thread of a cluster: so few are light to send, so many end together, and a dead worker loses one."""
LEAST_KEPT = 16
"""Rows of a block that is kept; fewer are computed as soon as written. Assumed."""
UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_SIZE = re.compile(r"\s*(\d+(?:\.\d*)?)\s*([kmgt]i?)?b?\s*", re.IGNORECASE)


def bytes_of(text: str) -> int:
    """Bytes that a text such as `1.5GB`, `800 MB` or `2GiB` names. Raises RequestError.

    >>> bytes_of("1.5GB"), bytes_of("2KiB")
    (1500000000, 2048)
    """
    found = _SIZE.fullmatch(text)
    if not found or (count := float(found[1]) * UNITS[(found[2] or "").lower()]) < 1:
        raise RequestError(f"`memory` '{text}': give a number of bytes such as 1.5GB or 800MB")
    return int(count)


@dataclass(slots=True, kw_only=True)
class Computing:
    """Where and how blocks are computed; it never changes what they give.

    Attributes
    ----------
    scheduler : address of a dask scheduler, or the JSON file that it wrote; None for threads of this process.
    workers : threads of this process; None for one a core.
    memory : bytes that this process may take, such as `1.5GB`; None leaves the size of blocks to each computation.
    keep : the file that is being made: done blocks are kept in a folder beside it until it is there.
    force : whether blocks kept for another computation may be thrown away.
    told : is called with a line that says that it goes on after blocks that an earlier run kept.
    """

    scheduler: str | None = None
    workers: int | None = None
    memory: str | None = None
    keep: Path | None = None
    force: bool = False
    told: Callable[[str], None] | None = None
    _client: Any = field(default=None, init=False, repr=False)
    _kept: list[KeptBlocks] = field(default_factory=list, init=False, repr=False)
    _stages: Counter[str] = field(default_factory=Counter, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise RequestError(f"`workers` is {self.workers}; give 1 or more")
        if self.scheduler is not None and self.workers is not None:
            raise RequestError("`workers` are threads of this process, a `scheduler` has its own; give one of both")
        if self.memory is not None:
            bytes_of(self.memory)

    @property
    def threads(self) -> int:
        """Threads of this process that compute."""
        return self.workers or threads()

    def client(self) -> Any:
        """The connection to the scheduler, made when it is first needed."""
        if self._client is None:
            self._client = connect(str(self.scheduler))
        return self._client

    def folder_of(self, stage: str) -> Path:
        """Where blocks are kept; each stage of a computation has a name of its own, in the order they come."""
        if self.keep is None:
            raise RequestError("blocks are kept beside a file; give `keep`")
        name = re.sub(r"[^\w-]+", "-", stage)
        self._stages[name] += 1
        number = f"-{self._stages[name]}" if self._stages[name] > 1 else ""
        return self.keep.with_name(f"{self.keep.name}.partial") / f"{name}{number}"

    @property
    def said(self) -> list[str]:
        """How many blocks are kept, one sentence for each folder that has some."""
        return [kept.said for kept in self._kept if kept.done]

    def close(self, *, done: bool) -> None:
        """Leave the scheduler, and the folders of done blocks, which are of no more use if all is `done`."""
        if self._client is not None:
            self._client.close()
        for kept in self._kept:
            kept.close(remove=done)


_HERE: ContextVar[Computing | None] = ContextVar("computing", default=None)
_UNDER_WAY: list[Computing] = []
"""All of this process, whichever thread asks."""


@contextlib.contextmanager
def computing(
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    memory: str | None = None,
    keep: str | Path | None = None,
    force: bool = False,
    told: Callable[[str], None] | None = None,
) -> Iterator[Computing]:
    """Say where blocks of rows are computed within; the parameters are those of `Computing`.

    An error tells, in a note, what was kept. Raises RequestError.
    """
    file = None if keep is None else Path(keep)
    here = Computing(scheduler=scheduler, workers=workers, memory=memory, keep=file, force=force, told=told)
    before = _HERE.set(here)
    _UNDER_WAY.append(here)
    done = False
    try:
        yield here
        done = True
    except BaseException as error:
        for text in here.said:
            error.add_note(text)
        raise
    finally:
        _UNDER_WAY.remove(here)
        _HERE.reset(before)
        here.close(done=done)


def what_is_kept() -> list[str]:
    """How many blocks of whatever this process computes are kept, one sentence a folder; of use as it ends."""
    return [text for here in list(_UNDER_WAY) for text in here.said]


def rows_in_memory(bytes_a_row: float, most: int) -> int:
    """Rows of a block, at most `most`, so that the blocks in work fit into the memory that was asked for.

    `bytes_a_row` is what a row takes at its worst, its input and its result included. Raises RequestError where
    not even one row fits beside what the process takes already.
    """
    here = _HERE.get() or Computing()
    if here.memory is None:
        return most
    left, blocks = bytes_of(here.memory) - memory_in_use(), (1 if here.scheduler else here.threads) + 1
    if (rows := int(left / (blocks * bytes_a_row))) < 1:
        need = (memory_in_use() + blocks * bytes_a_row) / 1e6
        raise RequestError(f"`memory` {here.memory} is too little; give {need * 1.1:.0f}MB or more")
    return min(rows, most)


def kept_rows(total: int, most: int) -> int:
    """Rows of a block of `total` rows, at most `most`: where done blocks are kept, so few that a stop loses little.

    Each thread then has several blocks, so that all cores are busy as they are without.
    """
    here = _HERE.get()
    if here is None or here.keep is None or here.scheduler is not None:
        return most
    return min(most, max(LEAST_KEPT, -(-total // (BLOCKS_EACH * here.threads))))


def shared_out(total: int, least: int) -> int:
    """Rows of a block that is light to send: `least` here; on a cluster as many times that as gives all some blocks."""
    here = _HERE.get() or Computing()
    if here.scheduler is None:
        return least
    threads = max(1, int(sum(here.client().ncores().values())))
    return least * max(1, total // (BLOCKS_EACH * threads * least))


def memory_in_use() -> int:
    """Bytes of memory that this process takes now; where the system does not say, the most that it ever took."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def run_blocks(
    work: Callable[[Any], Any],
    blocks: Sequence[range],
    *,
    fetch: Callable[[range], Any] | None = None,
    progress: Progress | None = None,
    done: int = 0,
) -> Iterator[tuple[range, Any]]:
    """Give each block and what `work` makes of it, as they are done, not in order.

    Parameters
    ----------
    work : picklable; called with a block, or with what `fetch` gives for it. Errors are passed on.
    fetch : called in this process, just before the block's turn: what a cluster could not read for itself.
    progress : called with (rows done, rows in all).
    done : rows that were done before, for `progress`.

    Only a few blocks more than there are workers are held at a time. In this process blocks are computed in threads,
    each of which computes alone: what is compiled should release the GIL.

    Raises
    ------
    SchedulerError where the scheduler cannot be reached, has no workers, or loses them again and again.
    """
    here = _HERE.get() or Computing()
    total = done + sum(map(len, blocks))
    if progress is not None:
        progress(done, total)
    for block, result in _found(here, work, blocks, fetch or _itself):
        done += len(block)
        if progress is not None:
            progress(done, total)
        yield block, result


def _found(
    here: Computing, work: Callable[[Any], Any], blocks: Sequence[range], fetch: Callable[[range], Any]
) -> Iterator[tuple[range, Any]]:
    if here.scheduler is None or not blocks:
        return _in_threads(here, work, blocks, fetch)

    return on_cluster(here.client(), here.scheduler, work, blocks, fetch)


def _itself(block: range) -> range:
    return block


def _in_threads(
    here: Computing, work: Callable[[Any], Any], blocks: Sequence[range], fetch: Callable[[range], Any]
) -> Iterator[tuple[range, Any]]:
    if len(blocks) == 1:  # whatever threads it has of its own are free
        yield blocks[0], work(fetch(blocks[0]))
        return
    pool = ThreadPoolExecutor(here.threads, initializer=_compute_alone)
    waiting, running = deque(blocks), dict[Future[Any], range]()
    stopped = False
    try:
        while waiting or running:
            while waiting and len(running) <= here.threads:
                block = waiting.popleft()
                running[pool.submit(lambda block: work(fetch(block)), block)] = block
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except KeyboardInterrupt:
        stopped = True
        raise
    finally:
        pool.shutdown(wait=not stopped, cancel_futures=True)


def _compute_alone() -> None:
    import numba

    numba.set_num_threads(1)


def blocks_in_order(
    work: Callable[[Any], Arrays],
    total: int,
    rows: int,
    *,
    stage: str,
    about: Mapping[str, str] | Callable[[], Mapping[str, str]],
    fetch: Callable[[range], Any] | None = None,
    progress: Progress | None = None,
) -> Iterator[tuple[range, Arrays]]:
    """The same for rows 0 to `total` - 1, in their order; done blocks are kept where `computing` says so.

    Parameters
    ----------
    work : gives arrays by name, none of them of Python objects.
    rows : of a block; a computation that goes on has the blocks that it began with.
    stage : what is computed, a name for a folder; the second of a name gets a number.
    about : what the answer depends on, options and digests of inputs, by name; a function of it is called where blocks
        are kept. Blocks that were kept for anything else, or by another version, are refused with what differs.

    Raises OutputError where blocks cannot be kept, or are those of another computation.
    """
    here = _HERE.get()
    if here is None or here.keep is None or total <= rows:
        yield from _in_order(run_blocks(work, spans(total, rows), fetch=fetch, progress=progress))
        return
    kept = KeptBlocks(here.folder_of(stage), about() if callable(about) else about, total, rows, force=here.force)
    here._kept.append(kept)
    if kept.done and here.told:
        here.told(f"{stage}: going on after {len(kept.done)} of {len(kept.blocks)} blocks kept from an earlier run")
    missing = [block for block in kept.blocks if block.start not in kept.done]
    for block, arrays in run_blocks(work, missing, fetch=fetch, progress=progress, done=total - sum(map(len, missing))):
        kept.keep(block, arrays)
    for block in kept.blocks:
        yield block, kept.load(block)


def arrays_in_blocks(
    work: Callable[[Any], Arrays], total: int, rows: int, **how: Any
) -> dict[str, np.ndarray[Any, Any]]:
    """Whole arrays of `total` rows, of what `blocks_in_order`, whose parameters these are, gives block by block."""

    whole: dict[str, np.ndarray[Any, Any]] = {}
    for block, arrays in blocks_in_order(work, total, rows, **how):
        for name, values in arrays.items():
            if name not in whole:
                whole[name] = np.empty((total, *values.shape[1:]), values.dtype)
            whole[name][block.start : block.stop] = values
    return whole


def _in_order(found: Iterator[tuple[range, Any]]) -> Iterator[tuple[range, Any]]:
    early: dict[int, tuple[range, Any]] = {}
    due = 0
    for block, result in found:
        early[block.start] = (block, result)
        while due in early:
            yield early[due]
            due = early.pop(due)[0].stop
