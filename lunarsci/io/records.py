"""Many records of one kind, kept as columns: read like a list of dicts, written as JSON and CSV with numbers by orjson.

What a job finds of a thousand spectra is a thousand objects with the same keys. Here each key has an array.

Records of so many things that their columns are made block by block, when they are read or written, are
`RecordsInBlocks`.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, TypeAlias, overload

import numpy as np
import numpy.typing as npt
import orjson

from lunarsci.arrays import BoolArray, IntArray, spans
from lunarsci.printable import cell, printable
from lunarsci.provenance import JSON, plain

BLOCK_VALUES = 500_000
"""Values of a block that is written at once: some 50 MB of Python objects and text."""
AT_ONCE = 64
"""Records that are made together where one after the other is asked for: ten times as fast as one by one."""
STRUCTURE = re.compile(r'[",\r\n]')
"""Signs of a CSV table, for which a text is quoted."""
_MILLIONTHS = re.compile(rb"(\d)\.?(\d*)e-6(?!\d)")
"""Numbers that tables have without an exponent, as Arrow writes them, and JSON with one."""


@dataclass(frozen=True, slots=True, eq=False)
class Same:
    """One plain value that all records have."""

    value: Any


@dataclass(frozen=True, slots=True, eq=False)
class Codes:
    """One of few plain values, `values[codes]`. (n,), any number"""

    codes: npt.NDArray[np.integer[Any]]
    values: Sequence[Any] | npt.NDArray[Any]


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
    size : how many records there are; that of the columns where left out, or -1.

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

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for start in range(0, self.size, AT_ONCE):
            yield from self[start : start + AT_ONCE].tolist()

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
        records: list[dict[str, Any]] = _values(self.columns, self.size)
        return records

    @cached_property
    def names(self) -> list[str]:
        """Names of the columns of its CSV, those of nested objects joined: `nbsr_um1_opx`."""
        return [name for name, _ in _leaves(self.columns)]

    def json_chunks(self, depth: int) -> Iterator[bytes]:
        """Its objects as JSON with a comma and a line between them, indented `depth` times, block by block."""
        margin = b"  " * depth
        for number, block in enumerate(self._blocks()):
            objects = (b",\n" + margin).join(_json(block.columns, len(block), margin))
            yield (b",\n" if number else b"") + margin + objects

    def csv_chunks(self) -> Iterator[bytes]:
        """Its rows as CSV without a header, block by block."""
        for block in self._blocks():
            cells = (_csv(column, len(block)) for _, column in _leaves(block.columns))
            yield b"\n".join([*map(b",".join, zip(*cells, strict=True)), b""])

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
    by_position = isinstance(rows, np.ndarray) and not (isinstance(column, np.ndarray) and column.ndim > 1)
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


def _values(column: Any, size: int) -> list[Any]:
    """The values of a column in all records, in plain Python."""
    if isinstance(column, Mapping):
        if not column:
            return [{} for _ in range(size)]
        return [dict(zip(column, row, strict=True)) for row in _rows(column.values(), size)]
    if isinstance(column, Where):
        values, otherwise = _values(column.column, size), plain(column.otherwise)
        return [value if there else otherwise for value, there in zip(values, column.present.tolist(), strict=True)]
    if isinstance(column, Listed):
        rows = map(list, _rows(column.columns, size))
        return list(rows) if column.count is None else [row[:n] for row, n in zip(rows, column.count, strict=True)]
    if isinstance(column, Codes):
        values = [plain(value) for value in column.values]
        return [values[code] for code in column.codes.tolist()]
    if isinstance(column, Same | str | None):
        return [_at(column, 0)] * size
    if isinstance(column, np.ndarray) and column.dtype.kind == "f":
        finite, column = np.isfinite(column), column.astype(object)
        column[~finite] = None
    return column.tolist() if isinstance(column, np.ndarray) else [plain(value) for value in column]


def _rows(columns: Iterable[Any], size: int) -> Iterable[tuple[Any, ...]]:
    """Values of several columns, record by record."""
    return zip(*(_values(column, size) for column in columns), strict=True)


def _json(column: Any, size: int, margin: bytes) -> list[bytes]:
    """A column of all records as JSON, of which every line but the first begins with a margin."""
    inner = margin + b"  "
    if isinstance(column, Mapping) and column:
        lines = (inner + _of_value(key, inner).replace(b"%", b"%%") + b": %b" for key in sorted(column))
        form, values = b",\n".join(lines), (_json(column[key], size, inner) for key in sorted(column))
        return [*map((b"{\n%b\n%b}" % (form, margin)).__mod__, zip(*values, strict=True))]
    if isinstance(column, Where):
        return _chosen(column, _json(column.column, size, margin), _of_value(column.otherwise, margin))
    if isinstance(column, np.ndarray) and column.ndim == 2:
        column = Listed([*column.T])
    if isinstance(column, Listed):
        rows = zip(*(_json(item, size, inner) for item in column.columns), strict=True)
        counts = [len(column.columns)] * size if column.count is None else column.count.tolist()
        lists = ((b",\n" + inner).join(row[:count]) for row, count in zip(rows, counts, strict=True))
        return [b"[\n%b%b\n%b]" % (inner, items, margin) if items else b"[]" for items in lists]
    return _texts(column, size, lambda value: _of_value(value, margin), bytes)


def _of_value(value: Any, margin: bytes) -> bytes:
    """A value as JSON."""
    return orjson.dumps(plain(value), option=JSON).replace(b"\n", b"\n" + margin)


def _csv(column: Any, size: int) -> list[bytes]:
    """The cells of a column of a table; empty where a value is missing or not finite."""
    if isinstance(column, Where):
        return _chosen(column, _csv(column.column, size), b"")
    return _texts(column, size, _cell, _number_cells)


def _chosen(column: Where, texts: list[bytes], otherwise: bytes) -> list[bytes]:
    return [text if there else otherwise for text, there in zip(texts, column.present.tolist(), strict=True)]


def _number_cells(listed: bytes) -> bytes:
    """Numbers of JSON with commas between them as cells: 4 for 4.0, nothing for null, 0.000001 for 1e-6."""
    cells = (listed + b",").replace(b".0,", b",").replace(b"null", b"")[:-1]
    return _MILLIONTHS.sub(rb"0.00000\1\2", cells) if b"e-6" in cells else cells


def _texts(column: Any, size: int, text: Callable[[Any], bytes], numbers: Callable[[bytes], bytes]) -> list[bytes]:
    """A column as texts: numbers by orjson, all of them looked over by `numbers`; other values by `text`."""
    if isinstance(column, Codes):
        values, codes = column.values, column.codes
        if len(values) > len(codes):
            used, codes = np.unique(codes, return_inverse=True)
            values = values[used] if isinstance(values, np.ndarray) else [values[code] for code in used]
        return [*map(_texts(values, len(values), text, numbers).__getitem__, codes.tolist())]
    if isinstance(column, Same | str | None):
        return [text(_at(column, 0))] * size
    if isinstance(column, np.ndarray) and column.ndim == 1 and column.dtype.kind in "biuf":
        listed = orjson.dumps(np.ascontiguousarray(column), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1]
        return numbers(listed).split(b",") if size else []
    return [*map(text, _values(column, size))]


def _cell(value: Any) -> bytes:
    """A value as a cell, in quotes where it needs them."""
    value = plain(value)
    if isinstance(value, bool):
        return str(value).lower().encode()
    if isinstance(value, list | tuple):
        shown = " ".join(printable(str(item)) for item in value)
    else:
        shown = cell(value) if isinstance(value, str) else "" if value is None else str(value)
    return ('"{}"'.format(shown.replace('"', '""')) if STRUCTURE.search(shown) else shown).encode()


BLOCK_THINGS = 4096
"""Things of which columns are made at once where there are more."""


class RecordsInBlocks(Sequence[dict[str, Any]]):
    """As `Records` to whoever reads or writes them, but their columns are never there of all.

    Parameters
    ----------
    things : how many things, such as spectra, the records are of; each has one record or more.
    make : the records of things from a range of their numbers, under the same names whichever these are.
    size : how many records there are of all things.
    rows : how many things are made records of at once.
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
    """`RecordsInBlocks`, or plain `Records` where one block has room for all; `size` is `things` where left out."""
    if things <= rows:
        return make(range(things))
    return RecordsInBlocks(things, make, things if size is None else size, rows)
