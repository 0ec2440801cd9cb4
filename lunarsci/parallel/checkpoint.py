"""Done blocks of a long computation on disk, so that it can go on after a crash, a full disk or a power cut."""

import contextlib
import io
import json
import os
import shutil
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from lunarsci.errors import OutputError, TakenError
from lunarsci.parallel.dask_cluster import build

Arrays: TypeAlias = "Mapping[str, np.ndarray[Any, Any]]"
MANIFEST = "manifest.jsonl"


def spans(total: int, rows: int) -> list[range]:
    """Rows 0 to `total` - 1 in blocks of `rows`, the last one shorter.

    >>> spans(5, 2)
    [range(0, 2), range(2, 4), range(4, 5)]
    """
    return [range(first, min(first + rows, total)) for first in range(0, total, rows)]


class KeptBlocks:
    """Done blocks in a folder: a file each, and a manifest that names a block once its file is safely on the disk.

    Attributes
    ----------
    blocks : all of them, as they were when the folder was made.
    done : first rows of those that are here.
    """

    def __init__(self, folder: Path, about: Mapping[str, str], total: int, rows: int, *, force: bool = False) -> None:

        self.folder = folder
        self.done: dict[int, int] = {}
        header: dict[str, Any] = {"about": {**about, "lunarsci": build()[0]}, "total": total, "rows": rows}
        with self._telling():
            folder.mkdir(parents=True, exist_ok=True)
            self._manifest: IO[bytes] = (folder / MANIFEST).open("a+b")
            self._lock()
            found, lines = self._read()
            if found is not None and (other := _difference(found, header)):
                if not force:
                    self._manifest.close()
                    raise TakenError(f"{folder.parent}: holds blocks of another computation ({other}); finish that, "
                                     "delete the folder, or add `force` to begin anew")  # fmt: skip
                found = None
            header["rows"] = rows if found is None else found["rows"]
            self.blocks = spans(total, header["rows"])
            if found is None:
                self._begin(header)
            else:
                self.done = {line["block"]: line["crc32"] for line in lines if self._is_whole(line)}

    @property
    def said(self) -> str:
        """How much is here, and how to go on."""
        return (
            f"{len(self.done)} of {len(self.blocks)} blocks are kept in {self.folder.parent}; the same command goes on"
        )

    def keep(self, block: range, arrays: Arrays) -> None:
        """Keep what a block gave: when this returns, a power cut does not lose it. Raises OutputError."""

        if wrong := [name for name, values in arrays.items() if np.asarray(values).dtype.hasobject]:
            raise TypeError(f"arrays of Python objects are not kept: {', '.join(wrong)}")
        content = io.BytesIO()
        np.savez(content, **dict(arrays))  # type: ignore[arg-type]
        data = content.getvalue()
        with self._telling():
            self._write(block, data)
            line = {"block": block.start, "bytes": len(data), "crc32": zlib.crc32(data)}
            self._append(line)
        self.done[block.start] = zlib.crc32(data)

    def load(self, block: range) -> Arrays:
        """What a block gave. Raises OutputError where its file has changed since."""

        with self._telling():
            data = self._file(block.start).read_bytes()
        if zlib.crc32(data) != self.done[block.start]:
            raise OutputError(f"{self._file(block.start)}: was changed; give the same command again")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}

    def close(self, *, remove: bool) -> None:
        """Let others at it, or take it away. What cannot be taken away does no harm."""
        if remove:
            shutil.rmtree(self.folder, ignore_errors=True)
            with contextlib.suppress(OSError):
                self.folder.parent.rmdir()
        self._manifest.close()

    @contextlib.contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(
                f"{self.folder.parent}: {error.strerror or error}; make it writable or make room"
            ) from error

    def _lock(self) -> None:
        with contextlib.suppress(ImportError):
            import fcntl

            try:
                fcntl.flock(self._manifest, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._manifest.close()
                raise OutputError(
                    f"{self.folder.parent}: another command is at it; wait, or give another name"
                ) from None

    def _read(self) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
        """Header and lines of the manifest; a last line that was cut off is dropped."""
        self._manifest.seek(0)
        whole = self._manifest.read()
        whole = whole[: whole.rfind(b"\n") + 1]
        self._manifest.truncate(len(whole))
        try:
            header, *lines = [json.loads(line) for line in whole.splitlines()] or [None]
        except ValueError:
            return None, []
        return header, lines

    def _begin(self, header: Mapping[str, Any]) -> None:
        for file in self.folder.glob("*.npz*"):
            file.unlink()
        self._manifest.truncate(0)
        self._append(header)
        _sync_folder(self.folder)

    def _append(self, line: Mapping[str, Any]) -> None:
        end = self._manifest.seek(0, os.SEEK_END)
        try:
            self._manifest.write(json.dumps(line).encode() + b"\n")
            self._manifest.flush()
            os.fsync(self._manifest.fileno())
        except OSError:
            with contextlib.suppress(OSError):
                self._manifest.truncate(end)
            raise

    def _file(self, first: int) -> Path:
        return self.folder / f"{first:012d}.npz"

    def _is_whole(self, line: Mapping[str, int]) -> bool:
        try:
            return zlib.crc32(self._file(line["block"]).read_bytes()) == line["crc32"]
        except OSError:
            return False

    def _write(self, block: range, data: bytes) -> None:
        target = self._file(block.start)
        part = target.with_name(f"{target.name}.part")
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
        _sync_folder(self.folder)


def _difference(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """What two computations differ in; rows of a block do not count."""
    before, now = found.get("about", {}), wanted["about"]
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    told = [f"{name}: {before.get(name, '-')}, not {now.get(name, '-')}" for name in names]
    if found.get("total") != wanted["total"]:
        told.append(f"rows: {found.get('total')}, not {wanted['total']}")
    return "; ".join(told)[:300]


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # a file system that does not do this for folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
