"""Exit codes, and the one place that talks to people: single lines on stderr."""

import sys

from lunarsci.errors import LunarSciError

__all__ = ["FAILED", "INTERRUPTED", "UNTRUSTED", "failure_line", "say"]

FAILED, UNTRUSTED, INTERRUPTED = 1, 3, 130


def say(text: str, *, quiet: bool = False) -> None:
    """One line on stderr."""
    if not quiet and sys.stderr is not None:
        print(text.replace("\n", " "), file=sys.stderr)  # noqa: T201 - the one place that talks to people


def failure_line(error: BaseException) -> str:
    """The one line of an error, without a traceback."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if isinstance(error, LunarSciError) else f"unexpected {type(error).__name__}: {text}"
