"""What an answer is, and what sentences of several things alike have in common."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from lunarsci.figure import FIRST_PAGE
from lunarsci.pages.words import counted

GO, STOP, DOUBT, PLAIN = "go", "no-go", "doubt", "plain"
MOST = 4
"""Spectra, rocks or designs that are answered one by one; of more the kinds of answers are counted."""
Result: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ResultAnswer:
    """What was found.

    Attributes
    ----------
    text : sentences.
    tone : `go`, `no-go`, `doubt` where the command says that it should not be trusted, else `plain`.
    trust : a sentence on that, in the command's own words.
    """

    text: str
    tone: str = PLAIN
    trust: str = ""


def each(
    items: Sequence[Result], sentence: Callable[[Result], str], thing: str, short: Callable[[Result], str] | None = None
) -> str:
    """A sentence for each; of more than a few how many have which `short` answer, or the sentences of the first."""
    if len(items) > MOST and short is not None:
        counts = Counter(short(item) for item in items)
        told = "; ".join(f"{count}: {text}" for text, count in counts.most_common(MOST))
        more = (
            f"; {sum(counts.values()) - sum(c for _, c in counts.most_common(MOST))}: others"
            if len(counts) > MOST
            else ""
        )
        return f"Of {counted(len(items), thing)} {told}{more}."
    told_one_by_one = [sentence(item) for item in items[:MOST]]
    rest = [f"{counted(len(items), thing)} in all, those after the first {MOST} below."] if len(items) > MOST else []
    return " ".join([*told_one_by_one, *rest]) or f"No {thing}."


def sentence(text: str) -> str:
    """Text of a command with a capital letter and a full stop.

    >>> sentence("no-go: too steep")
    'No-go: too steep.'
    """
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


FORMER_PAGE = "holds the first page only; a .pdf holds all"
"""What results of former versions say in place of `FIRST_PAGE`."""


def of_first_page(text: object) -> bool:
    """Whether a warning is about a picture that has the first of several pages."""
    return FIRST_PAGE in str(text) or str(text).endswith(FORMER_PAGE)


def heard_of(record: Mapping[str, Any]) -> list[str]:
    """Warnings about a result: those about the pages of its picture say nothing of it."""
    return [str(text) for text in record.get("warnings") or () if not of_first_page(text)]


def trust(record: Mapping[str, Any], caution: str = "") -> tuple[bool, str]:
    """Whether the command that made a result trusts it, and what it says, from its provenance and a `caution`.

    Inputs that gave no result are said, and are nothing against the results of the others.
    """
    lines = [sentence(str(record["untrusted"]))] if record.get("untrusted") else []
    failed = record.get("failures") or []
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        lines.append(f"{counted(len(failed), 'input')} gave no result: {str(failed[0]).rstrip('.')}{more}.")
    if lines:
        return not record.get("untrusted"), " ".join(lines)
    if "untrusted" not in record:
        return True, "The file does not say whether its command trusts it, as it is of an older version; make it anew."
    heard = heard_of(record)
    warned = f", but gave {counted(len(heard), 'warning')}, below" if heard else ""
    if caution:
        return True, f"The command found nothing that forbids to use it, but warns: {caution.rstrip('.')}."
    return True, f"The command found nothing against this result{warned}."
