"""Long computations in blocks of rows: here in threads or on a cluster, and saved on disk as they are done.

Rows are spectra, lines of a cube, or members of an ensemble. What a block gives must depend on its rows alone; then the
results are the same however many workers there are, wherever they are, and however often the computation was stopped.

Where blocks are computed is said once, around whatever computes::

    with lunarsci.computing(scheduler="tcp://10.0.0.1:8786"):
        drives = lunarsci.predict("plan.toml", members=4096)
"""

import contextlib
import json
import os
import re
import shutil
import zipfile
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from lunarsci.arrays import spans
from lunarsci.compiled import set_threads, threads
from lunarsci.errors import OutputError, RequestError, TakenError
from lunarsci.parallel.dask_cluster import build, connect, on_cluster
from lunarsci.result import Progress

Arrays: TypeAlias = "Mapping[str, np.ndarray[Any, Any]]"

BLOCKS_EACH = 4
"""Blocks for each thread of a cluster: so few are light to send, so many end together, and a dead worker loses one."""
LEAST_SAVED = 16
"""Rows of a block that is saved; fewer are computed as soon as written. Assumed."""
HEADER = "header.json"
"""File of a folder of blocks that says of which computation they are."""
UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
"""Bytes of a unit, in lower case without its b."""
_SIZE = re.compile(r"\s*(\d+(?:\.\d*)?)\s*([kmgt]i?)?b?\s*", re.IGNORECASE)


def bytes_of(text: str) -> int:
    """Bytes that a text such as `1.5GB`, `800 MB` or `2GiB` names. Raises RequestError.

    >>> bytes_of("1.5GB"), bytes_of("2KiB")
    (1500000000, 2048)
    """
    size = _SIZE.fullmatch(text)
    if not size or (count := float(size[1]) * UNITS[(size[2] or "").lower()]) < 1:
        raise RequestError(f"`memory` '{text}': give a number of bytes such as 1.5GB or 800MB")
    return int(count)


class SavedBlocks:
    """Done blocks in a folder, each a file with a checksum that has its name once it is safely on the disk.

    Attributes
    ----------
    blocks : all of them, as they were when the folder was made.
    done : first rows of those that are here.
    """

    def __init__(self, folder: Path, about: Mapping[str, str], total: int, rows: int, *, force: bool = False) -> None:
        self.folder, self.done = folder, set[int]()
        header: dict[str, Any] = {"about": {**about, "lunarsci": build()[0]}, "total": total, "rows": rows}
        with self._disk():
            folder.mkdir(parents=True, exist_ok=True)
            self._header: IO[bytes] = (folder / HEADER).open("a+b")
            self._lock()
            saved = self._saved_header()
            if saved and (other := _difference(saved, header)) and not force:
                self._header.close()
                raise TakenError(f"{folder.parent}: holds blocks of another computation ({other}); finish that, "
                                 "delete the folder, or add `force` to begin anew")  # fmt: skip
            if not saved or other:
                saved = header
                for file in folder.glob("*.npz*"):
                    file.unlink()
                self._header.truncate(0)
                self._header.write(json.dumps(header).encode())
                self._sync(self._header)
            self.blocks = spans(total, saved["rows"])
            self.done |= {block.start for block in self.blocks if _is_whole(self._file(block))}

    @property
    def note(self) -> str:
        """How much is here, and how to go on."""
        return (
            f"{len(self.done)} of {len(self.blocks)} blocks are kept in {self.folder.parent}; the same command goes on"
        )

    def save(self, block: range, arrays: Arrays) -> None:
        """Save what a block gave: when this returns, a power cut does not lose it. Raises OutputError."""
        if wrong := [name for name, values in arrays.items() if np.asarray(values).dtype.hasobject]:
            raise TypeError(f"arrays of Python objects are not saved: {', '.join(wrong)}")
        part = self._file(block).with_suffix(".npz.part")
        with self._disk():
            with part.open("wb") as file:
                np.savez(file, **dict(arrays))  # type: ignore[arg-type]
                self._sync(file)
            part.replace(self._file(block))
            self._sync_folder()
        self.done.add(block.start)

    def load(self, block: range) -> Arrays:
        """What a block gave. Raises OutputError where its file has changed since."""
        try:
            with self._disk(), np.load(self._file(block), allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
        except (ValueError, zipfile.BadZipFile) as error:
            raise OutputError(f"{self._file(block)}: was changed; give the same command again") from error

    def close(self, *, remove: bool) -> None:
        """Let others at it, or take it away, as where no block is done. What cannot be taken away does no harm."""
        if remove or not self.done:
            self.clear()
        self._header.close()

    def clear(self) -> None:
        """Take it away."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            self.folder.parent.rmdir()

    @contextlib.contextmanager
    def _disk(self) -> Iterator[None]:
        """Errors of the disk as OutputError."""
        try:
            yield
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(
                f"{self.folder.parent}: {error.strerror or error}; make it writable or make room"
            ) from error

    def _lock(self) -> None:
        with contextlib.suppress(ImportError):
            import fcntl

            try:
                fcntl.flock(self._header, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._header.close()
                raise OutputError(
                    f"{self.folder.parent}: another command is writing it; wait, or give another name"
                ) from None

    def _saved_header(self) -> dict[str, Any]:
        """Of the computation that the folder was made for; nothing where it was not written in full."""
        self._header.seek(0)
        try:
            return dict(json.loads(self._header.read()))
        except ValueError:
            return {}

    def _file(self, block: range) -> Path:
        return self.folder / f"{block.start:012d}.npz"

    def _sync(self, file: IO[bytes]) -> None:
        file.flush()
        os.fsync(file.fileno())

    def _sync_folder(self) -> None:
        with contextlib.suppress(OSError):  # a file system that does not do this for folders
            handle = os.open(self.folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)


def _is_whole(file: Path) -> bool:
    try:
        with zipfile.ZipFile(file) as archive:
            return archive.testzip() is None
    except (OSError, zipfile.BadZipFile):
        return False


def _difference(saved: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """What two computations differ in; rows of a block do not count."""
    before, now = ({**header["about"], "rows": header["total"]} for header in (saved, wanted))
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return "; ".join(f"{name}: {before.get(name, '-')}, not {now.get(name, '-')}" for name in names)[:300]


@dataclass(slots=True, kw_only=True)
class Computing:
    """Where and how blocks are computed; it never changes what they give.

    Attributes
    ----------
    scheduler : address of a dask scheduler, or the JSON file that it wrote; None for threads of this process.
    workers : threads of this process; None for one a core.
    memory : bytes that this process may take, such as `1.5GB`; None leaves the size of blocks to each computation.
    keep : the file that is being made: done blocks are saved in a folder beside it until it is there.
    force : whether blocks of another computation may be thrown away.
    notify : is called with a line that says that it goes on after blocks of an earlier run.

    `_client` is dask's, once it is needed; `_saved` the folders of blocks that were opened; `_stages` counts how often
    each name of a stage came, so that folders have names of their own.
    """

    scheduler: str | None = None
    workers: int | None = None
    memory: str | None = None
    keep: Path | None = None
    force: bool = False
    notify: Callable[[str], None] | None = None
    _client: Any = field(default=None, init=False, repr=False)
    _saved: list[SavedBlocks] = field(default_factory=list, init=False, repr=False)
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
        self._client = self._client or connect(str(self.scheduler))
        return self._client

    def folder_of(self, stage: str) -> Path:
        """Where blocks are saved; each stage of a computation has a name of its own, in the order they come."""
        name = re.sub(r"[^\w-]+", "-", stage)
        self._stages[name] += 1
        number = f"-{self._stages[name]}" if self._stages[name] > 1 else ""
        file = self.keep or Path("blocks")
        return file.with_name(f"{file.name}.partial") / f"{name}{number}"

    def notes(self) -> list[str]:
        """How many blocks are saved, one sentence for each folder that has some."""
        return [saved.note for saved in self._saved if saved.done]

    def clear_empty(self) -> None:
        """Take away folders of blocks that have none yet, as the process ends."""
        for saved in self._saved:
            if not saved.done:
                saved.clear()

    def close(self, *, done: bool) -> None:
        """Leave the scheduler, and the folders of done blocks, which are of no more use if all is `done`."""
        if self._client is not None:
            self._client.close()
        for saved in self._saved:
            saved.close(remove=done)


_HERE: ContextVar[Computing | None] = ContextVar("computing", default=None)
"""The one in force here, None outside of `computing`."""
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
    notify: Callable[[str], None] | None = None,
) -> Iterator[Computing]:
    """Say where blocks of rows are computed within; the parameters are those of `Computing`.

    An error tells, in a note, what was saved. Raises RequestError.

    Examples
    --------
    >>> with lunarsci.computing(workers=1):
    ...     bands = lunarsci.bands("lunarsci-demo/rock.ecsv")
    """
    file = None if keep is None else Path(keep)
    here = Computing(scheduler=scheduler, workers=workers, memory=memory, keep=file, force=force, notify=notify)
    before = _HERE.set(here)
    _UNDER_WAY.append(here)
    done = False
    try:
        yield here
        done = True
    except BaseException as error:
        for text in here.notes():
            error.add_note(text)
        raise
    finally:
        _UNDER_WAY.remove(here)
        _HERE.reset(before)
        here.close(done=done)


def what_is_saved() -> list[str]:
    """How many blocks of whatever this process computes are saved, one sentence a folder; others go, as it ends."""
    for here in list(_UNDER_WAY):
        here.clear_empty()
    return [text for here in list(_UNDER_WAY) for text in here.notes()]


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


def saved_rows(total: int, most: int) -> int:
    """Rows of a block of `total` rows, at most `most`: where done blocks are saved, so few that a stop loses little.

    Each thread then has several blocks, so that all cores are busy as they are without.
    """
    here = _HERE.get()
    if here is None or here.keep is None or here.scheduler is not None:
        return most
    return min(most, max(LEAST_SAVED, -(-total // (BLOCKS_EACH * here.threads))))


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
    fetch = fetch or (lambda block: block)
    if here.scheduler is None or not blocks:
        results = _in_threads(here, work, blocks, fetch)
    else:
        results = on_cluster(here.client(), here.scheduler, work, blocks, fetch)
    for block, result in results:
        done += len(block)
        if progress is not None:
            progress(done, total)
        yield block, result


def _in_threads(
    here: Computing, work: Callable[[Any], Any], blocks: Sequence[range], fetch: Callable[[range], Any]
) -> Iterator[tuple[range, Any]]:
    if len(blocks) == 1:  # its own threads are free
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
    set_threads(1)


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
    """The same for rows 0 to `total` - 1, in their order; done blocks are saved where `computing` says so.

    Parameters
    ----------
    work : gives arrays by name, none of them of Python objects.
    rows : of a block; a computation that goes on has the blocks that it began with.
    stage : what is computed, a name for a folder; the second of a name gets a number.
    about : what the answer depends on, options and digests of inputs, by name; a function of it is called where blocks
        are saved. Blocks that were saved for anything else, or by another version, are refused with what differs.

    Raises OutputError where blocks cannot be saved, or are those of another computation.
    """
    here = _HERE.get()
    if here is None or here.keep is None or total <= rows:
        yield from _in_order(run_blocks(work, spans(total, rows), fetch=fetch, progress=progress))
        return
    saved = SavedBlocks(here.folder_of(stage), about() if callable(about) else about, total, rows, force=here.force)
    here._saved.append(saved)
    if saved.done and here.notify:
        here.notify(f"{stage}: going on after {len(saved.done)} of {len(saved.blocks)} blocks kept from an earlier run")
    missing = [block for block in saved.blocks if block.start not in saved.done]
    for block, arrays in run_blocks(work, missing, fetch=fetch, progress=progress, done=total - sum(map(len, missing))):
        saved.save(block, arrays)
    for block in saved.blocks:
        yield block, saved.load(block)


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


def _in_order(results: Iterator[tuple[range, Any]]) -> Iterator[tuple[range, Any]]:
    early: dict[int, tuple[range, Any]] = {}
    due = 0
    for block, result in results:
        early[block.start] = (block, result)
        while due in early:
            yield early[due]
            due = early.pop(due)[0].stop
