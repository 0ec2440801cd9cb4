"""Write files whole or not at all: temporary file beside the target, fsync, rename."""

import contextlib
import glob
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from lunarsci.errors import OutputError

_BOOT = Path("/proc/sys/kernel/random/boot_id")


def check_target(path: Path, *, force: bool) -> None:
    """Raise OutputError when a file cannot be written to `path`: call it before a long computation."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; give a file name")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: not a regular file; give another name")
    if path.exists() and not force:
        raise OutputError(f"{path}: exists already; add --force to replace it or give another name")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}; create it first")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write in {path.parent}; choose another folder")


def check_folder(folder: Path, *, force: bool) -> None:
    """Raise OutputError when files cannot be written into `folder`, which need not exist yet."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is not a folder; give another name")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise OutputError(f"{folder}: holds files already; add --force to replace those of the same name")
    parent = folder if folder.is_dir() else folder.parent
    if not parent.is_dir():
        raise OutputError(f"{folder}: there is no folder {parent}; create it first")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: no permission to write in {parent}; choose another folder")


def write_files(contents: Mapping[Path, bytes | Iterable[bytes]], *, force: bool = False) -> None:
    """Write several files, whole or in pieces, so that all of them appear, or none.

    Every file is first written in full beside its target; only then are they renamed into place. Without `force` an
    existing target is never replaced, even one that appeared in the meantime. A missing folder is made, its parent must
    exist. Raises OutputError.
    """
    staged: list[tuple[Path, Path]] = []
    made: list[Path] = []
    done = False
    try:
        for path, data in contents.items():
            if not path.parent.exists() and path.parent.parent.is_dir():
                path.parent.mkdir()
                made.append(path.parent)
            check_target(path, force=force)
            staged.append((_stage(path, data), path))
        _publish(staged, force=force)
        done = True
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{path}: {error.strerror or error}; nothing was written") from error
    finally:
        for temporary, _ in staged:
            temporary.unlink(missing_ok=True)
        for folder in [] if done else made:
            folder.rmdir()


@contextlib.contextmanager
def written_whole(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Give a name beside `path` to write a large file to, bit by bit; it becomes `path` when all went well.

    The name ends as `path` does and is always the same, so that what a killed process left is overwritten; only one
    process may write it at a time. Without `force` an existing target is never replaced. Raises OutputError.
    """
    check_target(path, force=force)
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        _publish([(temporary, path)], force=force)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{path}: {error.strerror or error}; it was not written") from error
    finally:
        temporary.unlink(missing_ok=True)


def _stage(path: Path, data: bytes | Iterable[bytes]) -> Path:
    _clear_after_the_killed(path)
    handle, name = tempfile.mkstemp(
        prefix=f".{path.name}.{_this_boot()}-{os.getpid()}-", suffix=".part", dir=path.parent
    )
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines([data] if isinstance(data, bytes) else data)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o666 & ~_umask())
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    return temporary


@cache
def _this_boot() -> str:
    """A name that no other machine has, whose processes can be asked whether they live; nothing where there is none."""
    try:
        return _BOOT.read_text()[:8]
    except OSError:
        return ""


def _clear_after_the_killed(path: Path) -> None:
    """Take away what processes of this machine left beside `path` that are no more."""
    here = _this_boot()
    for left in path.parent.glob(f".{glob.escape(path.name)}.{here}-*.part") if here else ():
        with contextlib.suppress(ValueError, PermissionError):
            try:
                os.kill(int(left.name.rsplit("-", 2)[1]), 0)
            except ProcessLookupError:
                left.unlink(missing_ok=True)


def _publish(staged: list[tuple[Path, Path]], *, force: bool) -> None:
    published: list[Path] = []
    try:
        for temporary, path in staged:
            if force:
                temporary.replace(path)
            else:
                _rename_exclusively(temporary, path)
                published.append(path)
    except BaseException:
        for path in published:
            path.unlink(missing_ok=True)
        raise


def _rename_exclusively(temporary: Path, path: Path) -> None:
    try:
        os.link(temporary, path)
    except FileExistsError as error:
        raise OutputError(f"{path}: appeared while the result was computed; it was left as it is") from error
    except OSError:  # a file system without hard links
        check_target(path, force=False)
        temporary.replace(path)


def _umask() -> int:
    mask = os.umask(0)
    with contextlib.suppress(OSError):
        os.umask(mask)
    return mask
