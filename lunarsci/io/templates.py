"""Texts with gaps that are the same for many records, the gaps filled with numbers from columns."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.io.numerals import WIDEST, powers_of_ten, write_float, write_whole

FLOAT, INTEGER, TEXT, PRESENT, END = range(5)
"""What a step of a template writes after its words: a number of a column, a text of the table, or what is there."""


@compiled
def _copy(out: Any, at: int, data: Any, start: int, stop: int) -> int:
    for place in range(start, stop):
        out[at + place - start] = data[place]
    return at + stop - start


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def fill_template(
    steps: Any, words: Any, texts: Any, ends: Any, missing: Any, floats: Any, whole: Any, powers: Any, out: Any
) -> int:
    """Write one record after the other; the number of bytes.

    Parameters
    ----------
    steps : each its kind, start and end of its words, its column, and for `PRESENT` start and end of the words that
        stand instead, and the step that follows then. (s, 7)
    words, texts, ends : the template's text; all texts, and where each of them ends. bytes, bytes, (t + 1,)
    missing : what stands for a number that is none. bytes
    floats, whole : columns of numbers, as bits; of whole numbers, of numbers of texts, of 0 and 1. (f, n), (i, n)
    powers : `powers_of_ten`.
    out : takes the text, long enough for all of it. bytes
    """
    at, infinite = 0, np.uint64(0x7FF)
    for record in range(whole.shape[1]):
        step = 0
        while step < steps.shape[0]:
            at = _copy(out, at, words, steps[step, 1], steps[step, 2])
            kind, column = steps[step, 0], steps[step, 3]
            step += 1
            if kind == FLOAT:
                bits = floats[column, record]
                if (bits >> np.uint64(52)) & infinite == infinite:
                    at = _copy(out, at, missing, 0, missing.size)
                else:
                    at = write_float(out, at, bits, powers)
            elif kind == INTEGER:
                number = whole[column, record]
                if number < 0:
                    out[at] = 45
                    at += 1
                at = write_whole(out, at, np.uint64(-number) if number < 0 else np.uint64(number))
            elif kind == TEXT:
                at = _copy(out, at, texts, ends[whole[column, record]], ends[whole[column, record] + 1])
            elif kind == PRESENT and not whole[column, record]:
                at = _copy(out, at, words, steps[step - 1, 4], steps[step - 1, 5])
                step = steps[step - 1, 6]
    return at


@dataclass(slots=True, eq=False)
class Template:
    """A text with gaps that is the same for many records, and the columns that fill the gaps.

    Attributes
    ----------
    records : how many there are.
    missing : what stands for a number that is not finite.
    said, length, begun : words so far, how long they are, and where those begin that no step writes yet.
    floats, whole : columns of numbers; of whole ones, of numbers of `texts`, and of what is there.
    texts, widest : what stands for values that are no numbers, and how long those of a record are at most.
    """

    records: int
    missing: str
    said: list[bytes] = field(default_factory=list)
    steps: list[list[int]] = field(default_factory=list)
    floats: list[Any] = field(default_factory=list)
    whole: list[Any] = field(default_factory=list)
    texts: list[bytes] = field(default_factory=list)
    widest: int = 0
    length: int = 0
    begun: int = 0

    def say(self, text: str) -> tuple[int, int]:
        """Words that every record has; where they are."""
        self.said.append(text.encode())
        start, self.length = self.length, self.length + len(self.said[-1])
        return start, self.length

    def step(self, kind: int, column: int = 0) -> list[int]:
        """A step after the words that were said since the last one."""
        self.steps.append([kind, self.begun, self.length, column, 0, 0, 0])
        self.begun = self.length
        return self.steps[-1]

    def numbers(self, values: Any) -> None:
        if values.dtype.kind in "iu":
            self.step(INTEGER, self._column(self.whole, values))
        else:
            self.step(FLOAT, self._column(self.floats, values))

    def one_of(self, codes: Any, texts: Sequence[str]) -> None:
        self.step(TEXT, self._column(self.whole, np.asarray(codes) + len(self.texts)))
        self.texts += (encoded := [text.encode() for text in texts])
        self.widest += max(map(len, encoded), default=0)

    def unless(self, present: Any) -> list[int]:
        """A step that goes on where `present`; for the others `instead` says what they have."""
        return self.step(PRESENT, self._column(self.whole, present))

    def instead(self, step: list[int], text: str) -> None:
        if self.begun < self.length:
            self.step(END)
        step[4:] = [*self.say(text), len(self.steps)]
        self.begun = self.length

    @staticmethod
    def _column(columns: list[Any], values: Any) -> int:
        columns.append(values)
        return len(columns) - 1

    def filled(self) -> bytes:
        """The text of all records."""
        if self.begun < self.length:
            self.step(END)
        ends = np.cumsum([0, *map(len, self.texts)])
        space = self.records * (self.length + self.widest + WIDEST * len(self.steps))
        return _text_of(
            fill_template,
            np.array(self.steps, np.int64).reshape(-1, 7),
            _as_bytes(b"".join(self.said)),
            _as_bytes(b"".join(self.texts)),
            ends.astype(np.int64),
            _as_bytes(self.missing.encode()),
            np.array(self.floats, float).reshape(-1, self.records).view(np.uint64),
            np.array(self.whole, np.int64).reshape(-1, self.records),
            powers_of_ten(),
            np.empty(space, np.uint8),
        )


def _text_of(fill: Any, *parts: Any) -> bytes:
    return parts[-1][: fill(*parts)].tobytes()  # type: ignore[no-any-return]


def _as_bytes(data: bytes) -> Any:
    return np.frombuffer(data, np.uint8)
