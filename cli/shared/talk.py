"""Exit codes, and the one place that talks to people: single lines on stderr."""

import contextlib
import signal
import sys
from typing import Any

from lunarsci.errors import LunarSciError
from lunarsci.printable import printable, shortened

FAILED, USAGE, UNTRUSTED, NO_FILES = 1, 2, 3, 4
_heard = [int(signal.SIGINT)]


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
