"""Blocks of rows on the workers of a dask scheduler.

Everything that a block needs goes with its task, so a worker may die at any time: another computes the block again, and
gives the same. Workers have the same version of lunarsci, which every answer says.
"""

import contextlib
import hashlib
import logging
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from lunarsci.errors import LunarSciWarning, SchedulerError
from lunarsci.provenance import installed_version

CONNECT_S, LONELY_S, LOOK_S = 30.0, 120.0, 2.0
"""How long a scheduler may take to answer, and be without workers; how often the latter is looked at. [s]"""
KINDS = {".py", ".csv", ".toml"}
"""Endings of the files of lunarsci that `build` takes into its hash."""
AHEAD = 2
"""Blocks sent for each thread of the workers: one in work and one that waits."""


def connect(address: str) -> Any:
    """A client of the scheduler at an address, or of a JSON file that it wrote. Raises SchedulerError."""
    try:
        import distributed
    except ImportError:
        raise SchedulerError("a scheduler needs dask: pip install 'lunarsci[cluster]'") from None
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters comes as a SchedulerError
    where = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
    try:
        return distributed.Client(**where, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        text = f"scheduler {address} does not answer ({reason}); start one with 'dask scheduler' and 'dask worker'"
        raise SchedulerError(text) from error


@cache
def build() -> tuple[str, str]:
    """Version of lunarsci with a digest of its code and tables, and the processor that it is compiled for."""
    import llvmlite.binding as llvm

    whole = hashlib.sha256()
    folders = [Path(__file__).parents[1], Path(str(files("lunarsci.spectra_data")))]
    paths = {path for folder in folders for path in folder.rglob("*.*") if path.suffix in KINDS}
    for path in sorted(path for path in paths if "cli" not in path.parts[-3:]):
        whole.update(path.name.encode() + path.read_bytes())
    return f"{installed_version('lunarsci')} ({whole.hexdigest()[:12]})", str(llvm.get_host_cpu_name())


def _remote(work: Callable[[Any], Any], given: Any) -> tuple[tuple[str, str], Any]:
    return build(), work(given)


def on_cluster(
    client: Any, name: str, work: Callable[[Any], Any], blocks: Sequence[range], fetch: Callable[[range], Any]
) -> Iterator[tuple[range, Any]]:
    """Each block and what `work` makes of what `fetch` gives for it, as they are done. Raises SchedulerError."""
    waiting, running = deque(blocks), dict[Any, range]()
    crew = _Crew(client, name)
    try:
        while waiting or running:
            threads = crew.threads()
            while waiting and len(running) < max(1, AHEAD * threads):
                block = waiting.popleft()
                running[client.submit(_remote, work, fetch(block), pure=False)] = block
            for future in crew.finished(running):
                yield running.pop(future), crew.result(future)
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(running), force=True)


class _Crew:
    """The workers of a scheduler, and what becomes of the blocks they are given."""

    def __init__(self, client: Any, name: str) -> None:
        self.client, self.name = client, name
        self._count, self._asked_s, self._seen_s = 0, -LOOK_S, time.monotonic()

    def threads(self) -> int:
        """Threads of all workers, as of a moment ago. Raises SchedulerError where there have been none for too long."""
        if self._count and time.monotonic() - self._asked_s < LOOK_S:
            return self._count
        try:
            self._count, self._asked_s = int(sum(self.client.ncores().values())), time.monotonic()
        except (OSError, RuntimeError, TimeoutError) as error:
            raise SchedulerError(
                f"scheduler {self.name}: went away; start it again and give the same command"
            ) from error
        self._seen_s = time.monotonic() if self._count else self._seen_s
        if time.monotonic() - self._seen_s > LONELY_S:
            raise SchedulerError(
                f"scheduler {self.name}: no worker for {LONELY_S:.0f} s; start some with 'dask worker'"
            )
        return self._count

    def finished(self, running: Any) -> list[Any]:
        """Those that are done, after a moment if there are none yet."""
        from distributed import wait

        with contextlib.suppress(TimeoutError), self.client.as_current():
            wait(list(running), timeout=LOOK_S, return_when="FIRST_COMPLETED")
        return [future for future in running if future.done()]

    def result(self, future: Any) -> Any:
        """Raises SchedulerError where some four workers died over it, one after the other, and for other versions."""
        from distributed.scheduler import KilledWorker

        if future.status in ("lost", "cancelled") or isinstance(future.exception(), KilledWorker):
            raise SchedulerError(f"scheduler {self.name}: workers died over one block; give them more memory")
        (version, processor), result = future.result()
        version_here, processor_here = build()
        if version != version_here:
            text = f"scheduler {self.name}: a worker has lunarsci {version}, here is {version_here}; install the same"
            raise SchedulerError(text)
        if processor != processor_here:
            text = f"a worker's processor is another ({processor}, here {processor_here}): last digits may differ"
            warnings.warn(text, LunarSciWarning, stacklevel=2)
        return result
