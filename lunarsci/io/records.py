"""Many records of one kind, kept as columns: read like a list of dicts, written as JSON and CSV without making them.

What a job found of a thousand spectra is a thousand objects with the same keys. Here each key has an array, and the
text of all objects is a template whose numbers `numerals` fills in.
"""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, IntArray
from lunarsci.io.printable import cell, printable
from lunarsci.provenance import plain, to_text

if TYPE_CHECKING:
    from lunarsci.io.templates import Template

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
    from lunarsci.io.templates import Template

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
    from lunarsci.io.templates import Template

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
