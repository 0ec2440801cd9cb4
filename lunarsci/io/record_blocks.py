"""Records of so many things that their columns are made block by block, when they are read or written."""

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, overload

from lunarsci.io.records import Records
from lunarsci.parallel.checkpoint import spans

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
