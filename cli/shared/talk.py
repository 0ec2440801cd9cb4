"""Exit codes, and the one place that talks to people: single lines on stderr, and progress where somebody watches."""

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from lunarsci.errors import LunarSciError
from lunarsci.printable import printable, shortened

FAILED = 1
"""Exit code: there is no answer, as an input is wrong or a file cannot be read or written."""
USAGE = 2
"""Exit code: the command line is wrong, or would overwrite a file."""
UNTRUSTED = 3
"""Exit code: there is an answer, which is doubtful or a no-go."""
NO_FILES = 4
"""Exit code: a pattern or folder named no file to read."""
CLOSED = 141
"""Exit code: nobody reads the answer any more (`| head`); that of other programs, 128 and SIGPIPE, 13."""
LINE_EVERY_S = 60.0
"""Between lines of progress in a log. [s]"""
_heard = [int(signal.SIGINT)]
"""The signal that came last; a list, as `interrupt` changes it."""


def interrupt(number: int, frame: Any) -> None:
    """Unwind as Ctrl-C does, whichever signal it was, and remember which."""
    _heard[:] = [number]
    signal.default_int_handler(number, frame)


def interrupted(number: int | None = None) -> int:
    """The exit code of a command that a signal ended, the last one heard if not told: 130 Ctrl-C, 143 a polite kill."""
    return 128 + (number or _heard[0])


def say(text: str, *, quiet: bool = False) -> None:
    """One line on stderr."""
    if quiet or sys.stderr is None:
        return
    with contextlib.suppress(OSError):  # nobody can be told that nobody can be told
        print(printable(text.replace("\n", " ")), file=sys.stderr)  # noqa: T201 - the one place that talks to people


def failure_line(error: BaseException) -> str:
    """The one line of an error, without a traceback."""
    text = " ".join(str(error).split()) or type(error).__name__
    return shortened(text if isinstance(error, LunarSciError) else f"unexpected {type(error).__name__}: {text}")


@contextlib.contextmanager
def progress(description: str, *, quiet: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Yield `update(done, total)`; it draws a bar on a terminal's stderr, and says a line a minute elsewhere."""
    if quiet or sys.stderr is None:
        yield lambda done, total: None
        return
    if not sys.stderr.isatty():
        yield minutely(description)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[pace]}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None, pace="")
        pace = Pace()
        yield lambda done, total: bar.update(task, completed=done, total=total, pace=pace.text(done, total))


def minutely(description: str, clock: Callable[[], float] = time.monotonic) -> Callable[[int, int], None]:
    """`update(done, total)` for a log: a plain line a minute, the first one after a minute."""
    pace, last = Pace(clock), clock()

    def update(done: int, total: int) -> None:
        nonlocal last
        text = pace.text(done, total)
        if clock() - last >= LINE_EVERY_S and done < total:
            last = clock()
            say(f"{description}: {text}")

    return update


class Pace:
    """How fast it goes since it was first heard of; what was done before, in another run, does not count."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._first = self._last = 0
        self._since_s: float | None = None

    def text(self, done: int, total: int) -> str:
        """Such as `1,200 of 100,000 · 830 a second · 2 min left`; without pace where there is none yet."""
        now = self._clock()
        if self._since_s is None or done < self._last:
            self._first, self._since_s = done, now
        self._last = done
        taken, here = now - self._since_s, done - self._first
        if taken <= 0.0 or here <= 0:
            return f"{done:,} of {total:,}"
        rate = here / taken
        speed = f"{rate:,.0f} a second" if rate >= 10 else f"{rate:.2g} a second"
        return f"{done:,} of {total:,} · {speed} · {_duration((total - done) / rate)} left"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
