"""Published numbers, what is found for them, and the verdict."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from lunarsci.io.tables import table_hashes, table_rows

TABLE = "published.csv"
"""File beside this one: published numbers, each with its place in the paper."""
REPRODUCED, NAMED = "reproduced", "reproduced under a named reading"
CONSISTENT = "consistent with one free force"
DIFFERS, OPEN = "differs", "not determined by what is published"
VERDICTS = (REPRODUCED, NAMED, CONSISTENT, DIFFERS, OPEN)
"""On a published number, the best first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What is found for a published number.

    Attributes
    ----------
    value : None where nothing can be computed; an example where `determined` is False.
    determined : whether what is published determines the value. An example rests on an assumption that is as good as
        any other, and is not judged.
    set_by_itself : whether a force that the value rests on, and that is not published, was set so that the published
        value comes out. That shows that such a force exists, and no more.
    low, high : 95 % interval, or the range over what is not published; None where there is none.
    reading : an interpretation or assumption the value rests on, empty where none is needed.
    reason : the evidence, or why it differs or is not determined.
    """

    value: float | None
    determined: bool = True
    set_by_itself: bool = False
    low: float | None = None
    high: float | None = None
    reading: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A published number beside ours.

    Attributes
    ----------
    id, part, quantity, unit, passage : what it is, and where it stands in Ding et al. (2024).
    published, within : its value, and the largest difference that still counts as the same: its rounding, and three
        sampling errors of 1024 draws where it is a standard deviation.
    ours, low, high, reading, reason : see `Answer`; `ours` is an example where the verdict is `not determined ...`.
    verdict : `reproduced`, `reproduced under a named reading`, `consistent with one free force` (see `set_by_itself`),
        `differs`, or `not determined by what is published`. Outside its own range no value is reproduced.
    """

    id: str
    part: str
    quantity: str
    unit: str
    passage: str
    published: float
    within: float
    ours: float | None
    low: float | None
    high: float | None
    reading: str
    reason: str
    verdict: str

    @property
    def is_open(self) -> bool:
        """Whether what is published does not determine it."""
        return self.verdict == OPEN

    def to_dict(self) -> dict[str, object]:
        """Plain Python."""
        return asdict(self)


def published_numbers(part: str) -> tuple[Mapping[str, str], ...]:
    """Rows of the table that belong to a part."""
    return tuple(row for row in table_rows(TABLE, __package__) if row["part"] == part)


def published_value(name: str) -> float:
    """The published value of a number, by its id."""
    return next(float(row["published"]) for row in table_rows(TABLE, __package__) if row["id"] == name)


def published_hash() -> dict[str, str]:
    """Name and SHA-256 of the table."""
    return table_hashes(TABLE, package=__package__)


def judged(part: str, answers: Mapping[str, Answer]) -> list[Number]:
    """Every number of a part beside what is found for it, in the order of the table."""
    return [judge(row, answers[row["id"]]) for row in published_numbers(part)]


def judge(row: Mapping[str, str], answer: Answer) -> Number:
    """A row of the table and what was found for it."""
    published, within = float(row["published"]), float(row["within"])
    return Number(
        **{name: row[name] for name in ("id", "part", "quantity", "unit", "passage")},
        published=published,
        within=within,
        ours=answer.value,
        low=answer.low,
        high=answer.high,
        reading=answer.reading,
        reason=answer.reason,
        verdict=_verdict(answer, published, within),
    )


def _verdict(answer: Answer, published: float, within: float) -> str:
    if answer.value is None or not answer.determined:
        return OPEN
    below, above = (-math.inf if answer.low is None else answer.low), (math.inf if answer.high is None else answer.high)
    if abs(answer.value - published) > within or not below <= published <= above:
        return DIFFERS
    if answer.set_by_itself:
        return CONSISTENT
    return NAMED if answer.reading else REPRODUCED
