"""Many records of one kind, kept as columns: read like a list of dicts, written as JSON and CSV without making them.

What a job found of a thousand spectra is a thousand objects with the same keys. Here each key has an array, and the
text of all objects is a template whose numbers `numerals` fills in.

Records of so many things that their columns are made block by block, when they are read or written.

Texts with gaps that are the same for many records, the gaps filled with numbers from columns.

Numbers as text by the million: the shortest decimal that is the same float64, as Python's `repr` writes it.

A 128-bit product finds each end of the range of decimals that round to a float64: Giulietti (2020), The Schubfach way
to render doubles.
"""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import islice
from typing import Any, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, IntArray, spans
from lunarsci.compiled import compiled
from lunarsci.printable import cell, printable
from lunarsci.provenance import plain, to_text

INDENT = "  "
BY_HAND = 20_000
"""So many values are written one by one sooner than compiled code is loaded; measured."""
BLOCK_VALUES = 2_000_000
"""Values of a block that is written at once: some 50 MB of numbers and text."""


@dataclass(frozen=True, slots=True, eq=False)
class Same:
    """One plain value that all records have."""

    value: Any


@dataclass(frozen=True, slots=True, eq=False)
class Codes:
    """One of few plain values, `values[codes]`. (n,), any number"""

    codes: npt.NDArray[np.integer[Any]]
    values: Sequence[Any]


def coded(values: Iterable[str]) -> Codes:
    """Texts of which many are alike."""
    listed = list(values)
    places = {value: place for place, value in enumerate(dict.fromkeys(listed))}
    return Codes(np.fromiter(map(places.__getitem__, listed), np.int64, len(listed)), list(places))


@dataclass(frozen=True, slots=True, eq=False)
class Where:
    """A column in the records where `present`, in the others a plain value; an empty cell of a table. (n,)"""

    present: BoolArray
    column: "Column"
    otherwise: Any = None


@dataclass(frozen=True, slots=True, eq=False)
class Listed:
    """A list of the first `count` of some columns, most often of mappings; of all where `count` is left out. (n,)"""

    columns: Sequence["Column"]
    count: IntArray | None = None


Column: TypeAlias = "npt.NDArray[Any] | Sequence[Any] | Mapping[str, Column] | Same | Codes | Where | Listed | None"
"""(n,) numbers or booleans, (n, k) numbers; a list or tuple of n plain values; None and text are the same for all."""


@dataclass(frozen=True, eq=False)
class Records(Sequence[dict[str, Any]]):
    """Records of one kind by their columns; a list of dicts to whoever reads it.

    Attributes
    ----------
    columns : by key; a mapping is a nested object. Numbers that are not finite are None, null, or an empty cell.
    size : how many records there are; found from the columns where left out.

    Raises
    ------
    ValueError where columns differ in length, or none of them tells it.
    """

    columns: Mapping[str, Column]
    size: int = -1

    def __post_init__(self) -> None:
        sizes = set(_sizes(self.columns))
        if len(sizes | ({self.size} if self.size >= 0 else set())) != 1:
            raise ValueError(f"records of {sorted(sizes) or 'no'} lengths, {self.size} stated; give columns of one")
        object.__setattr__(self, "size", max(self.size, *sizes) if sizes else self.size)

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> "Records": ...
    def __getitem__(self, index: int | slice) -> "dict[str, Any] | Records":
        if isinstance(index, slice):
            return Records(_sliced(self.columns, index), len(range(*index.indices(self.size))))
        if not -self.size <= index < self.size:
            raise IndexError(f"record {index} of {self.size}")
        record: dict[str, Any] = _at(self.columns, index % self.size)
        return record

    def taken(self, rows: IntArray) -> "Records":
        """The records at some positions, (n,), of which one may come more than once."""
        return Records(_sliced(self.columns, rows), len(rows))

    def tolist(self) -> list[dict[str, Any]]:
        """All records in plain Python."""
        return [_at(self.columns, index) for index in range(self.size)]

    @cached_property
    def names(self) -> list[str]:
        """Names of the columns of its CSV, those of nested objects joined: `nbsr_um1_opx`."""
        return [name for name, _ in _leaves(self.columns)]

    def json_chunks(self, depth: int) -> Iterator[bytes]:
        """Its objects as JSON with a comma and a line between them, indented `depth` times, block by block."""
        for number, block in enumerate(self._blocks()):
            text = _json_by_hand(block, depth) if self._few else _json_template(block, depth).filled()
            yield text if number == 0 else b",\n" + text

    def csv_chunks(self) -> Iterator[bytes]:
        """Its rows as CSV without a header, block by block."""
        for block in self._blocks():
            yield _csv_by_hand(block) if self._few else _csv_template(block).filled()

    @property
    def _few(self) -> bool:
        return self.size * _width(self.columns) < BY_HAND

    def _blocks(self) -> "Iterator[Records]":
        rows = max(1, BLOCK_VALUES // max(1, _width(self.columns)))
        return (self[start : start + rows] for start in range(0, self.size, rows))


def _width(column: Any) -> int:
    """How many values a record has in a column, in a list as many as it may have."""
    if isinstance(column, Mapping):
        return sum(map(_width, column.values()))
    if isinstance(column, Listed):
        return sum(map(_width, column.columns))
    if isinstance(column, Where):
        return _width(column.column)
    return column.shape[1] if isinstance(column, np.ndarray) and column.ndim == 2 else 1


def _sizes(column: Any) -> Iterator[int]:
    """Lengths of all columns within one."""
    if isinstance(column, Mapping):
        for item in column.values():
            yield from _sizes(item)
    elif isinstance(column, Where):
        yield len(column.present)
        yield from _sizes(column.column)
    elif isinstance(column, Listed):
        yield from () if column.count is None else (len(column.count),)
        for item in column.columns:
            yield from _sizes(item)
    elif isinstance(column, Codes):
        yield len(column.codes)
    elif not isinstance(column, Same | str | None):
        yield len(column)


def _sliced(column: Any, rows: Any) -> Any:
    """Rows of a column, by a slice or by an array of positions."""
    if isinstance(column, Mapping):
        return {key: _sliced(item, rows) for key, item in column.items()}
    if isinstance(column, Where):
        return Where(column.present[rows], _sliced(column.column, rows), column.otherwise)
    if isinstance(column, Listed):
        count = None if column.count is None else column.count[rows]
        return Listed([_sliced(item, rows) for item in column.columns], count)
    if isinstance(column, Codes):
        return Codes(column.codes[rows], column.values)
    if isinstance(column, Same | str | None):
        return column
    by_position = isinstance(rows, np.ndarray) and not isinstance(column, np.ndarray)
    return Codes(rows, column) if by_position else column[rows]


def _at(column: Any, index: int) -> Any:
    """The value of a column in one record, in plain Python."""
    if isinstance(column, Mapping):
        return {key: _at(item, index) for key, item in column.items()}
    if isinstance(column, Where):
        return _at(column.column, index) if column.present[index] else plain(column.otherwise)
    if isinstance(column, Listed):
        shown = column.columns if column.count is None else column.columns[: column.count[index]]
        return [_at(item, index) for item in shown]
    if isinstance(column, Codes):
        return plain(column.values[column.codes[index]])
    if isinstance(column, Same):
        return plain(column.value)
    return column if isinstance(column, str | None) else plain(column[index])


def _leaves(column: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Columns of the table by joined names; where a nested object is missing, its cells are empty."""
    if isinstance(column, Mapping):
        for key, item in column.items():
            yield from _leaves(item, f"{name}_{key}" if name else key)
    elif isinstance(column, Where) and isinstance(column.column, Mapping):
        for inner, item in _leaves(column.column, name):
            yield inner, Where(column.present, item)
    else:
        yield name, column


def _json_by_hand(records: Records, depth: int) -> bytes:
    lines = to_text(records.tolist()).split("\n")
    return "\n".join(INDENT * (depth - 1) + line for line in lines[1:-1]).encode()


def _csv_by_hand(records: Records) -> bytes:
    text = io.StringIO()
    leaves = [column for _, column in _leaves(records.columns)]
    rows = ([_cell(_at(column, index)) for column in leaves] for index in range(len(records)))
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _cell(value: Any) -> str:
    """A plain value as a cell that is not quoted yet."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return " ".join(printable(str(item)) for item in value)
    if isinstance(value, str):
        return cell(value)
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def _quoted(value: Any) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow([_cell(plain(value)), ""])
    return text.getvalue()[:-1]


def _json_template(records: Records, depth: int) -> "Template":

    made = Template(len(records), "null")
    made.say(INDENT * depth)
    _json_object(made, records.columns, depth)
    step = made.unless(np.arange(len(records)) < len(records) - 1)
    made.say(",\n")
    made.instead(step, "")
    return made


def _json_object(made: "Template", columns: Mapping[str, Any], depth: int) -> None:
    between = "{\n"
    for key in sorted(columns):
        made.say(f"{between}{INDENT * (depth + 1)}{to_text(key)}: ")
        _json_value(made, columns[key], depth + 1)
        between = ",\n"
    made.say(f"\n{INDENT * depth}}}" if columns else "{}")


def _json_value(made: "Template", column: Any, depth: int) -> None:
    if isinstance(column, Mapping):
        _json_object(made, column, depth)
    elif isinstance(column, Where):
        step = made.unless(column.present)
        _json_value(made, column.column, depth)
        made.instead(step, to_text(column.otherwise))
    elif isinstance(column, Listed):
        _json_list(made, column, depth)
    elif isinstance(column, np.ndarray) and column.ndim == 2:
        _json_list(made, Listed(list(column.T)), depth)
    else:
        _json_leaf(made, column, depth)


def _json_list(made: "Template", column: Listed, depth: int) -> None:
    count = np.full(made.records, len(column.columns)) if column.count is None else column.count
    some = made.unless(count > 0)
    made.say("[")
    for place, item in enumerate(column.columns):
        step = made.unless(count > place)
        made.say(f"{',' if place else ''}\n{INDENT * (depth + 1)}")
        _json_value(made, item, depth + 1)
        made.instead(step, "")
    made.say(f"\n{INDENT * depth}]")
    made.instead(some, "[]")


def _json_leaf(made: "Template", column: Any, depth: int) -> None:
    def text(value: Any) -> str:
        return to_text(value).replace("\n", f"\n{INDENT * depth}")

    _leaf(made, column, text)


def _leaf(made: "Template", column: Any, text: Any) -> None:
    """A column without others in it, `text` making one value's text."""
    if isinstance(column, str | None):
        made.say(text(column))
    elif isinstance(column, Same):
        made.say(text(column.value))
    elif isinstance(column, Codes):
        made.one_of(column.codes, [text(value) for value in column.values])
    elif isinstance(column, np.ndarray) and column.dtype.kind == "b":
        made.one_of(column.astype(np.int64), [text(False), text(True)])
    elif isinstance(column, np.ndarray) and column.dtype.kind in "iuf":
        made.numbers(column)
    else:
        codes: dict[str, int] = {}
        written = cache(text)
        texts = (written(value) if isinstance(value, str) else text(value) for value in column)
        made.one_of(np.array([codes.setdefault(own, len(codes)) for own in texts], int), list(codes))


def _csv_template(records: Records) -> "Template":

    made = Template(len(records), "")
    for place, (_, column) in enumerate(_leaves(records.columns)):
        made.say("," if place else "")
        _csv_value(made, column)
    made.say("\n")
    return made


def _csv_value(made: "Template", column: Any) -> None:
    if isinstance(column, Where):
        step = made.unless(column.present)
        _csv_value(made, column.column)
        made.instead(step, "")
    elif isinstance(column, Listed) or (isinstance(column, np.ndarray) and column.ndim == 2):
        _leaf(made, [_at(column, index) for index in range(made.records)], _quoted)
    else:
        _leaf(made, column, _quoted)


Words: Any = npt.NDArray[np.uint64]
Bytes: Any = npt.NDArray[np.uint8]

LOWEST_POWER, HIGHEST_POWER = -292, 324
WIDEST = 25
"""Bytes of the longest float64: -2.2250738585072014e-308; of an int64: 20."""
ONE, TWO, FOUR, TEN, FORTY, THIRTY_TWO, LOW_HALF = (np.uint64(number) for number in (1, 2, 4, 10, 40, 32, 0xFFFFFFFF))
FRACTION, HIDDEN = np.uint64((1 << 52) - 1), np.uint64(1 << 52)


@cache
def powers_of_ten() -> Words:
    """Upper 128 bits of 10^k, rounded up, for k from -292 to 324. (617, 2), high and low word"""
    rows = []
    for power in range(LOWEST_POWER, HIGHEST_POWER + 1):
        size = _floor_log2_power(power)
        shift = 127 - size
        if power >= 0:
            bits = 10**power << shift if shift >= 0 else -((-(10**power)) >> -shift)
        else:
            bits = -((-1 << shift) // 10**-power)
        rows.append((bits >> 64, bits & (1 << 64) - 1))
    return np.array(rows, np.uint64)


def _floor_log2_power(power: int) -> int:
    return (power * 1741647) >> 19


@compiled
def _high_word(a: Any, b: Any) -> Any:
    """Upper 64 bits of a product of 64-bit words."""
    a_low, a_high = a & LOW_HALF, a >> THIRTY_TWO
    b_low, b_high = b & LOW_HALF, b >> THIRTY_TWO
    cross = a_high * b_low + ((a_low * b_low) >> THIRTY_TWO)
    other = a_low * b_high + (cross & LOW_HALF)
    return a_high * b_high + (cross >> THIRTY_TWO) + (other >> THIRTY_TWO)


@compiled
def _rounded_to_odd(high: Any, low: Any, factor: Any) -> Any:
    """Upper word of the product of a power of ten and a factor; its last bit says whether anything follows."""
    carried = _high_word(low, factor)
    middle = high * factor + carried
    upper = _high_word(high, factor)
    if middle < carried:
        upper += ONE
    return upper | (ONE if middle > ONE else np.uint64(0))


@compiled
def shortest_digits(bits: Any, powers: Any) -> Any:
    """Digits and power of ten of a positive finite float64, given as its bits: the value is digits 10^power."""
    fraction, biased = bits & FRACTION, np.int64(bits >> np.uint64(52)) & 0x7FF
    significand, exponent = (fraction | HIDDEN, biased - 1075) if biased else (fraction, np.int64(-1074))
    if -52 <= exponent <= 0 and (significand & ((ONE << np.uint64(-exponent)) - ONE)) == 0:
        return significand >> np.uint64(-exponent), 0
    closer = fraction == 0 and biased > 1
    power = (exponent * 1262611 - (524031 if closer else 0)) >> 22
    shift = np.uint64(exponent + ((-power * 1741647) >> 19) + 1)
    high, low = powers[-power - LOWEST_POWER, 0], powers[-power - LOWEST_POWER, 1]
    outside = significand & ONE
    middle = FOUR * significand
    lowest = _rounded_to_odd(high, low, (middle - (ONE if closer else TWO)) << shift) + outside
    value = _rounded_to_odd(high, low, middle << shift)
    highest = _rounded_to_odd(high, low, (middle + TWO) << shift) - outside
    digits = value >> TWO
    if digits >= TEN:
        shorter = digits // TEN
        below, above = lowest <= FORTY * shorter, FORTY * shorter + FORTY <= highest
        if below != above:
            return shorter + (ONE if above else np.uint64(0)), power + 1
    below, above = lowest <= FOUR * digits, FOUR * digits + FOUR <= highest
    if below == above:
        half = FOUR * digits + TWO
        above = value > half or (value == half and (digits & ONE) == ONE)
    return digits + (ONE if above else np.uint64(0)), power


@compiled
def write_whole(out: Any, at: int, number: Any) -> int:
    """A whole number, 0 or more; where it ends."""
    width, rest = 1, number
    while rest >= TEN:
        rest //= TEN
        width += 1
    for place in range(at + width - 1, at - 1, -1):
        rest = number // TEN
        out[place] = np.uint8(48) + np.uint8(number - TEN * rest)
        number = rest
    return at + width


@compiled
def write_float(out: Any, at: int, bits: Any, powers: Any) -> Any:
    """A finite float64 as `repr` has it; where it ends."""
    if bits >> np.uint64(63):
        out[at] = 45
        at += 1
    bits &= np.uint64(0x7FFFFFFFFFFFFFFF)
    digits, power = (np.uint64(0), np.int64(0)) if bits == 0 else shortest_digits(bits, powers)
    while digits >= TEN and digits % TEN == 0:
        digits //= TEN
        power += 1
    end = write_whole(out, at, digits)
    count = end - at
    point = count + power
    if -4 < point <= 16:
        return _with_point(out, at, count, point)
    return _with_exponent(out, at, count, point - 1)


@compiled
def _with_point(out: Any, at: int, count: int, point: int) -> int:
    """Digits that stand at `at` with a decimal point behind the first `point` of them."""
    if point <= 0:
        for place in range(at + count - 1, at - 1, -1):
            out[place + 2 - point] = out[place]
        out[at : at + 2 - point] = 48
        out[at + 1] = 46
        return at + 2 - point + count
    if point >= count:
        out[at + count : at + point + 2] = 48
        out[at + point] = 46
        return at + point + 2
    for place in range(at + count - 1, at + point - 1, -1):
        out[place + 1] = out[place]
    out[at + point] = 46
    return at + count + 1


@compiled
def _with_exponent(out: Any, at: int, count: int, exponent: int) -> Any:
    """Digits that stand at `at` as 1.5e+17."""
    if count > 1:
        for place in range(at + count - 1, at, -1):
            out[place + 1] = out[place]
        out[at + 1] = 46
        count += 1
    end = at + count
    out[end] = 101
    out[end + 1] = 45 if exponent < 0 else 43
    exponent = abs(exponent)
    if exponent < 10:
        out[end + 2] = 48
        end += 1
    return write_whole(out, end + 2, np.uint64(exponent))


BLOCK_THINGS = 4096
"""Things of which columns are made at once where there are more."""


class RecordsInBlocks(Sequence[dict[str, Any]]):
    """As `Records` to whoever reads or writes them, but their columns are never there of all.

    Parameters
    ----------
    things : what records are of, one or more records each.
    make : the records of some things, next to each other, under the same names whichever these are.
    size : how many records there are; as many as things where left out.
    rows : things of a block.
    """

    def __init__(self, things: int, make: Callable[[range], Records], size: int, rows: int) -> None:
        self.make, self.size = make, size
        self.blocks = spans(things, rows)

    def __len__(self) -> int:
        return self.size

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for block in self.blocks:
            yield from self.make(block)

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> list[dict[str, Any]]: ...
    def __getitem__(self, index: int | slice) -> dict[str, Any] | list[dict[str, Any]]:
        wanted = range(self.size)[index]
        if isinstance(wanted, range):
            return list(islice(self, wanted.start, wanted.stop, wanted.step)) if wanted.step > 0 else list(self)[index]
        for block in self.blocks:
            if len(records := self.make(block)) > wanted:
                return records[wanted]
            wanted -= len(records)
        raise IndexError(f"record {index} of {self.size}")

    @property
    def names(self) -> list[str]:
        """Names of the columns of its CSV."""
        return self.make(range(1)).names

    def tolist(self) -> list[dict[str, Any]]:
        """All records in plain Python."""
        return list(self)

    def json_chunks(self, depth: int) -> Iterator[bytes]:
        """As of `Records`."""
        for number, block in enumerate(self.blocks):
            yield b",\n" if number else b""
            yield from self.make(block).json_chunks(depth)

    def csv_chunks(self) -> Iterator[bytes]:
        """As of `Records`."""
        for block in self.blocks:
            yield from self.make(block).csv_chunks()


def in_blocks(
    things: int, make: Callable[[range], Records], size: int | None = None, rows: int = BLOCK_THINGS
) -> Records | RecordsInBlocks:
    """Records as `RecordsInBlocks` has them, or as they are where one block holds them all."""
    if things <= rows:
        return make(range(things))
    return RecordsInBlocks(things, make, things if size is None else size, rows)


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
