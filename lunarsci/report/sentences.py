"""What an answer is, and what sentences of several things alike have in common."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from lunarsci.report.words import counted

GO, STOP, DOUBT, PLAIN = "go", "no-go", "doubt", "plain"
MOST = 4
"""Spectra, rocks or designs that are answered one by one; of more the first are, and how many there are is said."""
Result: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ResultAnswer:
    """What was found.

    Attributes
    ----------
    text : sentences.
    tone : `go`, `no-go`, `doubt` where it should not be trusted, else `plain`.
    """

    text: str
    tone: str = PLAIN


def each(items: Sequence[Result], sentence: Callable[[Result], str], thing: str) -> str:
    """A sentence for each of the first, and how many there are; `thing` in the singular."""
    told = [sentence(item) for item in items[:MOST]]
    more = [f"{counted(len(items), thing)} in all, those after the first {MOST} below."] if len(items) > MOST else []
    return " ".join([*told, *more]) or f"No {thing}."
