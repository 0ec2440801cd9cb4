"""Input files: reading them whole, decoding them as text, and expanding folders and patterns.

Everything that can go wrong here is a `DataError` of one line: the file, what is wrong, what to do. It is our own since
one source may be a path, standard input, an open file or a table in memory, and each is hashed for the provenance.
"""

import codecs
import contextlib
import csv
import glob
import hashlib
import io
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, TypeAlias, TypeVar

from lunarsci.errors import DataError, NoFilesError, ParameterError, warn
from lunarsci.io.documents import json_document
from lunarsci.memory import FORMS, AsFiles, content_of, is_open
from lunarsci.names import meant, some_of

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd
    from astropy.table import Table
    from xarray import DataArray, Dataset


Source: TypeAlias = (
    "str | os.PathLike[str] | InputFile | IO[Any] | bytes | pd.DataFrame | pd.Series[Any] | Table | Dataset | DataArray"
    " | Mapping[str, Any] | Sequence[Mapping[str, Any]] | AsFiles"
)
"""What can be read: a path, - for standard input, an open file, bytes, a table, grid or dict in memory, a result of a
job, or what was read already."""
Ground: TypeAlias = "Source | tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]"
"""The same, or x (nx,), y (ny,) and heights (ny, nx) of nodes in metres."""

Made = TypeVar("Made")
_UNPRINTABLE = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f-\x9f]")
_UNPRINTABLE_ASCII = bytes([*range(9), *range(0x0E, 0x1A), *range(0x1B, 0x20), 0x7F])
_UNPRINTABLE_SHARE = 59 / 256 / 2
"""Share of characters that are no text, beyond which a file is taken for a binary one: half that of random bytes."""
PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
"""How compressed files begin, which no command unpacks; archives of zip are formats of their own (.npz, .xlsx)."""
BEGINNING = 1 << 16
"""Bytes by which the format of a file is told."""
_ENDING = 200
_SCHEMA = re.compile(rb'"schema": ?"lunarsci/[a-z0-9-]+/\d+"\s*\}\s*\Z')
_PIECE = 1 << 20
_BETWEEN = re.compile(r"[\s,;]+")
_NUMBER = re.compile(r"[+-]?\d+(?:\.(\d*))?(?:[eEdD][+-]?(\d+))?")
UNREADABLE = {
    FileNotFoundError: "no such file; check the path",
    IsADirectoryError: "is a folder, not a file; name the files in it",
    PermissionError: "no permission to read it; check its access rights",
}
NO_DATA = (
    *(".md", ".rst", ".html", ".htm", ".pdf", ".png", ".jpg", ".jpeg", ".gif", ".svg"),
    *(".toml", ".py", ".sh", ".log", ".failed"),
)
"""Ends of names in a folder of inputs that are left out."""
ABOUT_OTHERS = ("readme", "license", "licence", "changelog", "makefile")
RESULT_COLUMNS = {
    *("source", "status", "assemblage", "sure", "open", "log_bayes_factor"),
    *("bc1000_nm", "bc2000_nm", "bd1000", "bd2000"),
}
"""Columns of results, one of which stands beside `id` or `rock` in a table of them."""
NAMED_LEFT = 10
_ROWS = 3
"""From so many rows on the last number of a table is set beside those above it; assumed."""


@dataclass(frozen=True, slots=True)
class InputFile:
    """The bytes of one input, and where they came from.

    Attributes
    ----------
    name : path as the user gave it, or '<stdin>'.
    data : the whole content.
    sha256 : hexadecimal digest of `data`; computed, not given.
    """

    name: str
    data: bytes = field(repr=False)
    sha256: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sha256", hashlib.sha256(self.data).hexdigest())

    @property
    def stem(self) -> str:
        """File name without folder and last suffix; 'stdin' for standard input."""
        return "stdin" if self.name == "<stdin>" else Path(self.name).stem


def read_input(source: Source) -> InputFile:
    """Read a file, standard input for `-`, an open file, or what is in memory, as `content_of` makes it a file.

    Quantities of a table are taken in the unit that their column's name ends in.

    Raises DataError when there is nothing to read and for a compressed file, ParameterError for what is none of these.
    """
    if isinstance(source, InputFile):
        return source
    if isinstance(source, str | os.PathLike):
        return _read_path(os.fspath(source))
    content = content_of(source)
    if content is None:
        raise ParameterError(f"{type(source).__name__} cannot be read; give {FORMS}")
    data, ending = content
    kind = type(source).__name__ if isinstance(source, bytes) or ending != ".csv" else "table"
    return _filled(str(getattr(source, "name", "<file>")) if is_open(source) else f"<{kind}>", data)


def named_input(path: str, what: str, names: Iterable[str]) -> bytes:
    """The content of a file that stands for one of some names, which are of `what`. Raises DataError."""
    try:
        return read_input(path).data
    except DataError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        raise DataError(f"{path}: {meant(path, names)}neither {what} nor a file that is there") from error


class InputStream:
    """An input that is read in pieces: its name, its file, and the SHA-256 of what `pieces` gave so far."""

    def __init__(self, name: str, file: BinaryIO) -> None:
        self.name, self.file, self._digest, self._empty = name, file, hashlib.sha256(), True

    @property
    def sha256(self) -> str:
        """Hexadecimal digest."""
        return self._digest.hexdigest()

    def pieces(self, size: int = 1 << 22) -> Iterator[bytes]:
        """So many bytes at a time. Raises DataError for a file that cannot be read on, and for an empty one."""
        while True:
            with _named_errors(self.name):
                piece = self.file.read(size)
            if self._empty:
                _filled(self.name, piece)
            if not piece:
                return
            self._empty = False
            self._digest.update(piece)
            yield piece


@contextlib.contextmanager
def open_input(source: "Source | InputStream") -> Iterator[InputStream]:
    """The same as `read_input` takes, to be read in pieces; a path and standard input are not read whole."""
    if isinstance(source, InputStream):
        yield source
    elif isinstance(source, str | os.PathLike):
        path = os.fspath(source)
        with contextlib.ExitStack() as opened:
            with _named_errors(_name_of(path)):
                file = _stdin() if path == "-" else opened.enter_context(Path(path).open("rb"))
            yield InputStream(_name_of(path), file)
    else:
        whole = read_input(source)
        yield InputStream(whole.name, io.BytesIO(whole.data))


def _name_of(path: str) -> str:
    return "<stdin>" if path == "-" else path


@contextlib.contextmanager
def _named_errors(name: str) -> Iterator[None]:
    """What the system says of a file, as a DataError."""
    try:
        yield
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        other = f"{name!r}: cannot be read ({reason}); check the path and the disk"
        wrong = next((f"{name}: {text}" for kind, text in UNREADABLE.items() if isinstance(error, kind)), other)
        raise DataError(wrong) from error


def _read_path(path: str) -> InputFile:
    with _named_errors(_name_of(path)):
        data = _stdin().read() if path == "-" else Path(path).read_bytes()
    return _filled(_name_of(path), data)


def _filled(name: str, data: bytes) -> InputFile:
    if not data:
        raise DataError(f"{name}: is empty; check how it was made or downloaded")
    if packed := next((kind for magic, kind in PACKED.items() if data.startswith(magic)), ""):
        raise DataError(f"{name}: is compressed ({packed}); unpack it first")
    return InputFile(name, data)


def _stdin() -> BinaryIO:
    # A detached process has no standard input at all, and then Python sets it to None.
    if sys.stdin is None:
        raise OSError("standard input is closed")
    return sys.stdin.buffer


def csv_rows(place: str, lines: Iterable[str], **dialect: Any) -> Iterator[list[str]]:
    """Cells of each line. Raises DataError naming `place` for broken quotes and cells over 131,072 characters."""
    try:
        yield from csv.reader(lines, **dialect)
    except csv.Error as error:
        raise DataError(f"{place}: cannot be split into fields ({error}); check its quotes and its length") from error


def text(input: InputFile) -> str:
    """Decode an input: UTF-8 or UTF-16 by its byte order mark, else UTF-8, else Latin-1 (said by a LunarSciWarning).

    Raises DataError for binary content, a NUL, or more than a tenth of the characters unprintable, and for a table that
    is cut inside its last number.
    """
    decoded = _text(input)
    if not decoded.endswith(("\n", "\r")):
        _check_end(input.name, decoded)
    return decoded


def _text(input: InputFile) -> str:
    decoded = _decoded(input)
    if "\0" in decoded or _unprintable(decoded) > _UNPRINTABLE_SHARE * len(decoded):
        raise DataError(f"{input.name}: is a binary file, not text; check that it is the file you mean")
    if not decoded.strip():
        raise DataError(f"{input.name}: holds only blanks; check how it was made or downloaded")
    return decoded


def _check_end(name: str, decoded: str) -> None:
    """Refuse a table whose last line does not end and whose last number is shorter than all above it: cut inside."""
    lines = decoded[-BEGINNING:].split("\n")[int(len(decoded) > BEGINNING) :]
    if not lines:
        return
    *above, last = ([part for part in _BETWEEN.split(line.strip()) if part] for line in lines)
    column = [_digits(row[-1]) for row in above if row and len(row) == len(last)]
    end = _digits(last[-1]) if last else None
    lengths = [digits for digits in column if digits is not None]
    if end is None or len(lengths) < max(len(column), _ROWS):
        return
    if any(mine < min(theirs) for mine, theirs in zip(end, zip(*lengths, strict=True), strict=True)):
        raise DataError(
            f"{name}: the last line has no end, and its last number, {last[-1]}, fewer digits than those above it: was "
            "the file cut there? Fetch it again, or end the line if it is whole"
        )


def _digits(cell: str) -> tuple[int, int] | None:
    """Digits after the point, and of the exponent; None for what is no number."""
    number = _NUMBER.fullmatch(cell)
    return number and (len(number[1] or ""), len(number[2] or ""))


def beginning(input: InputFile) -> str:
    """`text` of the first 64 kB, by which a format is told; of everything where these are blank, or in UTF-16."""
    first = input.data[:BEGINNING]
    whole = first == input.data or first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or not first.strip()
    return _text(input if whole else InputFile(input.name, first))


def _unprintable(decoded: str) -> int:
    """How many characters are none that a text has, counted in pieces, for the text may be large."""
    if not decoded.isascii():
        return sum(1 for _ in _UNPRINTABLE.finditer(decoded))
    pieces = (decoded[at : at + _PIECE].encode("ascii") for at in range(0, len(decoded), _PIECE))
    return sum(len(piece) - len(piece.translate(None, _UNPRINTABLE_ASCII)) for piece in pieces)


def read_json(input: InputFile, kind: str, made: Callable[[Any], Made]) -> Made:
    """What `made` makes of a JSON document; NaN and infinities are refused.

    Raises DataError for text that is no JSON, and where `made` raises ParameterError; `kind` says what it should be.
    """

    def refuse(name: str) -> float:
        raise ParameterError(f"{name} is no number that {kind} can have")

    try:
        return made(json_document(text(input), refuse))
    except json.JSONDecodeError as error:
        message = f"{input.name}, line {error.lineno}: not valid JSON: {error.msg}; is the file complete?"
        raise DataError(message) from error
    except ParameterError as error:
        raise DataError(f"{input.name}: {error}") from error


def _decoded(input: InputFile) -> str:
    utf16 = input.data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return input.data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        if utf16:
            raise DataError(f"{input.name}: broken UTF-16 text (truncated?); save it as UTF-8") from error
    decoded = input.data.decode("latin-1")
    # Binary content is about to be refused by the caller: a remark on its encoding would only distract.
    if "\0" not in decoded:
        message = f"{input.name}: is not valid UTF-8 and was read as Latin-1; save it as UTF-8 if a name looks wrong"
        warn(message)
    return decoded


@contextlib.contextmanager
def unheard() -> Iterator[None]:
    """What libraries in C write to stderr by themselves, such as libpng of a damaged file, is not heard.

    A file is described in one line, and none of its bytes reaches a terminal. Threads that write meanwhile are not
    heard either: take it for a single call.
    """
    try:
        stderr = os.dup(2)
    except OSError:  # there is no stderr
        yield
        return
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 2)
    os.close(silence)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        sys.unraisablehook = hook


def expand_inputs(paths: Iterable[str], *, all_files: bool = False) -> list[str]:
    """Expand folders and glob patterns (`**` included) into sorted file names; each file is listed once.

    Names that exist, `-`, and plain names are kept as they are: reading them tells what is wrong with one. Hidden
    files are left out, and of a folder what is no data by its name, with a warning, unless `all_files` is set by who
    chooses by name itself. Raises NoFilesError when a folder is empty or a pattern matches no file.
    """
    return list(dict.fromkeys(name for path in paths for name in _expanded(path, all_files=all_files)))


def _expanded(path: str, *, all_files: bool) -> Iterator[str]:
    if path == "-" or not (glob.has_magic(path) or _is(Path.is_dir, path)) or _is(Path.is_file, path):
        return iter((path,))
    if _is(Path.is_dir, path):
        return iter(_files_of_folder(path, all_files=all_files))
    # Path.glob takes no absolute patterns.
    names = sorted(name for name in glob.glob(path, recursive=True) if Path(name).is_file())  # noqa: PTH207
    if not names:
        raise NoFilesError(f"{path}: matches no file; check the pattern")
    return iter(names)


def _files_of_folder(path: str, *, all_files: bool) -> list[str]:
    try:
        names = sorted(str(p) for p in Path(path).iterdir() if p.is_file() and not p.name.startswith("."))
    except OSError as error:
        raise DataError(f"{path}: folder cannot be listed ({error.strerror}); check its access rights") from error
    data = [name for name in names if all_files or not no_data(name)]
    if left := [Path(name).name for name in names if not all_files and no_data(name)]:
        warn(f"{path}: left out, no data by name: {some_of(left, NAMED_LEFT)}")
    if not data:
        raise NoFilesError(f"{path}: folder holds no files{' of data' if names else ''}; name the files or a pattern")
    return data


def no_data(name: str) -> bool:
    """Whether a file is no data by its name alone: a text about the others, a picture, a page, a script, a log.

    >>> no_data("in/readme.txt"), no_data("in/map.png"), no_data("in/rock.txt")
    (True, True, False)
    """
    path = Path(name)
    return path.suffix.lower() in NO_DATA or path.stem.casefold() in ABOUT_OTHERS


def is_result(name: str) -> bool:
    """Whether a file is a result of lunarsci: a JSON document by its end, where keys are sorted and the schema is last,
    or a table of `--csv` by its names of columns, none of which is a wavelength.
    """
    suffix = Path(name).suffix.lower()
    try:
        with Path(name).open("rb") as stream:
            if suffix == ".json":
                stream.seek(max(0, Path(name).stat().st_size - _ENDING))
                return _SCHEMA.search(stream.read()) is not None
            if suffix != ".csv":
                return False
            columns = stream.readline(BEGINNING).decode("utf-8", "replace").strip().split(",")
    except OSError:
        return False
    spectral = any("wavelength" in column or column[:1].isdigit() for column in columns)
    return not (spectral or {"id", "rock"}.isdisjoint(columns) or RESULT_COLUMNS.isdisjoint(columns))


def _is(kind: Callable[[Path], bool], path: str) -> bool:
    try:
        return kind(Path(path))
    except (OSError, ValueError):  # a name that no path can have
        return False
