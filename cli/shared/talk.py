"""Exit codes, and the one place that talks to people: single lines on stderr."""

import contextlib
import sys

from lunarsci.errors import LunarSciError
from lunarsci.printable import printable, shortened

FAILED, UNTRUSTED, INTERRUPTED = 1, 3, 130


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
