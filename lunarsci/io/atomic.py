"""Write files whole or not at all: temporary file beside the target, fsync, rename.

Signals that stop a program wait while names change. Files of one folder change in one step: a new folder with all of
them, and with whatever else the old one has, takes its name. What a killed process left is taken away by the next that
writes to the same name.

It is our own since libraries replace one file at a time, and `docs/promises.md` promises whole folders, also of a
process that is killed.
"""

import contextlib
import errno
import glob
import os
import shutil
import signal
import stat
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from lunarsci.errors import OutputError, TakenError

Content = bytes | Iterable[bytes]
STOPPING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_AT_FDCWD, _RENAME_NOREPLACE, _RENAME_EXCHANGE = -100, 1, 2
"""Of Linux, <fcntl.h> and renameat2(2)."""
_written: list[Path] = []


def check_target(path: Path, *, force: bool) -> None:
    """Raise OutputError when a file cannot be written to `path`: call it before a long computation."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; give a file name")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: not a regular file; give another name")
    if path.exists() and not force:
        raise TakenError(f"{path}: exists already; give `force` to replace it, or another name")
    _check_parent(path, path.parent)


def check_folder(folder: Path, *, force: bool) -> None:
    """Raise OutputError when files cannot be written into `folder`, which need not exist yet."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is not a folder; give another name")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise TakenError(f"{folder}: holds files already; give `force` to replace those of the same name")
    _check_parent(folder, folder if folder.is_dir() else folder.parent)


def _check_parent(path: Path, parent: Path) -> None:
    if not parent.is_dir():
        raise OutputError(f"{path}: there is no folder {parent}; create it first")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write in {parent}; choose another folder")


def write_files(contents: Mapping[Path, Content], *, force: bool = False, folder: Path | None = None) -> None:
    """Write several files, whole or in pieces, so that all of them appear, or none.

    Parameters
    ----------
    contents : bytes, or pieces of them, by path; those in `folder` by a path in it.
    force : replace files that exist; without it none is replaced, even one that appeared in the meantime.
    folder : whose files change in one step, even for a process that is killed meanwhile. It is made if it is missing,
        its parent must exist. File by file, each one whole, where the folder has folders in it, is the one that the
        process or its shell is in, is a mount, or lies on a system that cannot swap two names.

    Every file is first written in full beside its target; only then do names change, and an error or a signal puts back
    what was there. Modes of files that are replaced stay, and links stay links. Raises OutputError.
    """
    staged: list[tuple[Path, Path]] = []
    whole: _StagedFolder | None = None
    path = Path()
    try:
        try:
            for path, data in contents.items():
                if folder is not None and path.is_relative_to(folder):
                    with undisturbed():
                        whole = whole or _StagedFolder(folder, force=force)
                    whole.add(path, data)
                else:
                    check_target(path, force=force)
                    with undisturbed():
                        handle, temporary = _new_beside(path.resolve())
                        staged.append((temporary, path.resolve()))
                    _write(handle, data, _mode(path.resolve()))
            with undisturbed():
                _publish(staged, whole, force=force)
                _written.extend(contents)
        finally:
            with undisturbed():
                for temporary, _ in staged:
                    temporary.unlink(missing_ok=True)
                if whole is not None:
                    shutil.rmtree(whole.path, ignore_errors=True)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{path}: {error.strerror or error}; nothing was written") from error


def written() -> str:
    """What this process has written by `write_files`, in words."""
    return f"{len(_written)} files were written" if _written else "nothing was written"


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Signals that stop a program (Ctrl-C, a polite kill, a closed terminal) are heard when the block is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []
    before: dict[int, Any] = {}
    try:
        for number in STOPPING:
            before[number] = signal.signal(number, lambda number, _: heard.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in heard:
            signal.raise_signal(number)


@contextlib.contextmanager
def written_whole(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Give a name beside `path` to write a large file to, bit by bit; it becomes `path` when all went well.

    The name ends as `path` does and is always the same, so that what a killed process left is overwritten; only one
    process may write it at a time. Without `force` an existing target is never replaced. Raises OutputError.
    """
    check_target(path, force=force)
    _clear_after_the_killed(path, path.parent)
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        with undisturbed():
            temporary.chmod(_mode(path.resolve()))
            _publish([(temporary, path.resolve())], None, force=force)
            _written.append(path)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{path}: {error.strerror or error}; it was not written") from error
    finally:
        temporary.unlink(missing_ok=True)


class _StagedFolder:
    """A folder beside the one that it will be, or in it, with the files that are to appear there."""

    def __init__(self, folder: Path, *, force: bool) -> None:
        self.folder = folder.resolve()
        self._given, self._force = folder, force
        parent = self.folder.parent
        if not parent.is_dir():
            raise OutputError(f"{folder}: there is no folder {parent}; create it first")
        self.in_one_step = os.access(parent, os.W_OK | os.X_OK) and not self._must_stay()
        beside = parent if self.in_one_step else self.folder
        _clear_after_the_killed(self.folder, beside)
        self.path = Path(tempfile.mkdtemp(prefix=_prefix(self.folder), suffix=".part", dir=beside))
        self.path.chmod(stat.S_IMODE(self.folder.stat().st_mode) if self.folder.exists() else 0o777 & ~_umask())

    def add(self, path: Path, data: Content) -> None:
        """Write a file, in full."""
        if path.parent.is_dir():
            check_target(path, force=self._force)
        file = self.path / path.relative_to(self._given)
        file.parent.mkdir(parents=True, exist_ok=True)
        _write(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), data, _mode(path.resolve()))

    def appear(self) -> list[tuple[Path, Path]]:
        """Take the folder's name; files and their targets where that has to be done file by file."""
        held = any(self.folder.iterdir()) if self.folder.exists() else False
        if self.in_one_step and not held:
            try:
                self.path.rename(self.folder)
                return []
            except OSError as error:  # another writer's folder has come to be there
                if error.errno != errno.ENOTEMPTY or not self._force:
                    raise
        if self.in_one_step and self._force and self._with_others() and _swap(self.path, self.folder):
            self._with_others(back=True)
            return []
        files = [file for file in sorted(self.path.rglob("*")) if not file.is_dir()]
        pairs = [(file, (self.folder / file.relative_to(self.path)).resolve()) for file in files]
        for _, target in pairs:
            target.parent.mkdir(parents=True, exist_ok=True)
        return pairs

    def _must_stay(self) -> bool:
        """Whether no other folder must take its place: folders or links are in it, or somebody works in it."""
        if not self.folder.exists():
            return False
        working = any(where.is_relative_to(self.folder) for where in (Path.cwd(), Path(os.environ.get("PWD", "/"))))
        held = self.folder.iterdir()
        return working or self.folder.is_mount() or any(file.is_symlink() or not file.is_file() for file in held)

    def _with_others(self, *, back: bool = False) -> bool:
        """Give the new folder what the old one has beside the new files; False where that cannot be.

        `back`: names are swapped already, and this is what appeared in the old one meanwhile.
        """
        old, new = (self.path, self.folder) if back else (self.folder, self.path)
        try:
            for file in old.iterdir():
                if not (new / file.name).exists():
                    os.link(file, new / file.name)
        except OSError:
            return False
        return True


def _publish(staged: list[tuple[Path, Path]], whole: _StagedFolder | None, *, force: bool) -> None:
    """Give all files their names; what was there comes back where one of them cannot have its own.

    A folder is last: nothing that follows can fail when it has taken its place in one step.
    """
    aside: list[Path] = []

    def name(temporary: Path, path: Path) -> None:
        old = _put_aside(path) if force and path.exists() else None
        if old is not None:
            aside.append(old)
        if force:
            temporary.replace(path)
        else:
            _rename_exclusively(temporary, path)
        back.callback(path.unlink, missing_ok=True) if old is None else back.callback(old.replace, path)

    try:
        with contextlib.ExitStack() as back:
            for pair in staged:
                name(*pair)
            for pair in whole.appear() if whole else ():
                name(*pair)
            back.pop_all()
    finally:
        for old in aside:
            old.unlink(missing_ok=True)


def _put_aside(path: Path) -> Path:
    """A second name for a file, under which it can be brought back."""
    aside = path.with_name(f"{_prefix(path)}old.part")
    aside.unlink(missing_ok=True)
    try:
        os.link(path, aside)
    except OSError:
        shutil.copy2(path, aside)
    return aside


def _swap(one: Path, other: Path) -> bool:
    """Swap the names of two folders in one step; False where the system cannot."""
    return _rename_as(one, other, _RENAME_EXCHANGE) == 0


def _rename_as(one: Path, other: Path, how: int) -> int | None:
    """Linux's rename with a flag: 0, or the number of the error; None where the system has none."""
    import ctypes

    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return None
    names = (_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other))
    return 0 if rename(*names, how) == 0 else ctypes.get_errno()


def _new_beside(path: Path) -> tuple[int, Path]:
    _clear_after_the_killed(path, path.parent)
    handle, name = tempfile.mkstemp(prefix=_prefix(path), suffix=".part", dir=path.parent)
    return handle, Path(name)


def _write(handle: int, data: Content, mode: int) -> None:
    with os.fdopen(handle, "wb") as file:
        file.writelines([data] if isinstance(data, bytes) else data)
        file.flush()
        os.fchmod(handle, mode)
        os.fsync(handle)


def _mode(path: Path) -> int:
    """That of the file that is there, else what a new one gets."""
    return stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask()


def _prefix(path: Path) -> str:
    return f".{path.name}.{_this_boot()}-{os.getpid()}-"


@cache
def _this_boot() -> str:
    """A name that no other machine has, whose processes can be asked whether they live; nothing where there is none."""
    try:
        return _BOOT.read_text()[:8]
    except OSError:
        return ""


def _clear_after_the_killed(path: Path, beside: Path) -> None:
    """Take away what processes of this machine left for `path` in a folder that are no more."""
    here = _this_boot()
    for left in beside.glob(f".{glob.escape(path.name)}.{here}-*.part") if here else ():
        with contextlib.suppress(ValueError, PermissionError):
            try:
                os.kill(int(left.name.rsplit(f"{here}-", 1)[1].split("-")[0]), 0)
            except ProcessLookupError:
                shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)


def _rename_exclusively(temporary: Path, path: Path) -> None:
    """In one step where the system can, so that no second name is left of it."""
    if (code := _rename_as(temporary, path, _RENAME_NOREPLACE)) == 0:
        return
    try:
        if code == errno.EEXIST:
            raise FileExistsError
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
