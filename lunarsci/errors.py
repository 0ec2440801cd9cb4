"""Errors and warnings a user of lunarsci can meet.

    LunarSciError
    ├── DataError         an input file or table cannot be used as it is
    │   ├── NoFilesError  a folder, or a pattern, has nothing in it to read
    │   └── BatchError    none of several inputs can; it has the reason of each
    ├── ParameterError    a value lies outside what the formula or the command accepts
    │   └── RequestError  options of a job that are impossible, alone or together
    ├── OutputError       a result cannot be written where it was asked for
    │   └── TakenError    something is there that only `force` may replace
    └── SchedulerError    a cluster cannot compute what it was given

Each also inherits the builtin a caller would expect. The message is one line: what, where, and what to do.
"""

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence


class LunarSciError(Exception):
    """Root of every error that lunarsci raises on purpose; its text is one line, whatever a file names in it."""

    def __str__(self) -> str:
        return " ".join(super().__str__().split())


class DataError(LunarSciError, ValueError):
    """An input file or table cannot be used as it is."""


class NoFilesError(DataError):
    """A folder, or a pattern, has nothing in it to read, as an inbox may at times."""


class Failure(str):
    """A sentence on an input that gave no result, which begins with its name.

    Attributes
    ----------
    input : its name, as it was given or found.
    reason : the sentence without the name.
    spectrum : the one of the input that gave none; empty where the whole input did not.
    no_files : whether the input is a folder or pattern with nothing in it to read.
    """

    input: str
    reason: str
    spectrum: str
    no_files: bool

    @classmethod
    def of(cls, name: str, why: object, spectrum: str = "", *, only: bool = False) -> "Failure":
        """The failure of an input by an error, or by a reason in words, whether these name the input or not.

        Where a spectrum is the `only` one of its input, the whole input gave no result.
        """
        reason = str(why)
        place = f"{name}: {spectrum}: " if spectrum else f"{name}: "
        made = cls(reason if name in reason and not spectrum else f"{place}{reason}")
        made.input, made.spectrum, made.no_files = name, "" if only else spectrum, isinstance(why, NoFilesError)
        made.reason = reason.removeprefix(name).lstrip(":, ") or reason
        return made

    def worded(self, rephrase: Callable[[str], str]) -> "Failure":
        """The same, in which `rephrase` words the sentence; names stay."""
        made = type(self)(rephrase(self))
        made.input, made.spectrum, made.reason = self.input, self.spectrum, rephrase(self.reason)
        made.no_files = self.no_files
        return made


class BatchError(DataError):
    """None of several inputs gave a result: the first reason, and how many more inputs there are without one."""

    def __init__(self, message: str, failures: Sequence[Failure] = ()) -> None:
        super().__init__(message)
        self.failures = failures

    @property
    def no_files(self) -> bool:
        """Whether there was nothing to read in any input."""
        return bool(self.failures) and all(one.no_files for one in self.failures)

    @classmethod
    def of(cls, failures: Sequence[Failure]) -> "BatchError":
        """The error of some failures, one at least."""
        more = f" (and {len(failures) - 1} more inputs without a result)" if len(failures) > 1 else ""
        return cls(failures[0] + more, failures)


class ParameterError(LunarSciError, ValueError):
    """A value lies outside what the formula or the command accepts."""


class RequestError(ParameterError):
    """Options of a job that are impossible, alone or together; the message names them in backticks, as in Python.

    The command line shows `model_error` as --model-error and leaves with exit code 2.
    """


@contextlib.contextmanager
def within_file(name: str, *others: type[Exception]) -> Iterator[None]:
    """What is wrong with values, and errors of some other kinds, as a DataError that begins with the file's name."""
    kinds: tuple[type[Exception], ...] = (ParameterError, *others)
    try:
        yield
    except kinds as error:
        raise DataError(f"{name}: {error}") from error


@contextlib.contextmanager
def within_option(name: str) -> Iterator[None]:
    """What is wrong with a value as a RequestError that begins with the option's name."""
    try:
        yield
    except ParameterError as error:
        text = str(error)
        rest = text.removeprefix(name) if text.startswith(name) else f": {text}"
        raise RequestError(f"`{name}`{rest}") from error


class OutputError(LunarSciError, OSError):
    """A result cannot be written where it was asked for."""


class TakenError(OutputError):
    """Something is there already that only `force` may replace; the command line leaves with exit code 2."""


@contextlib.contextmanager
def worded(rephrase: Callable[[str], str]) -> Iterator[None]:
    """Errors of lunarsci, and the reasons of a batch, with texts as `rephrase` words them."""
    try:
        yield
    except LunarSciError as error:
        error.args = (rephrase(str(error)), *error.args[1:])
        if isinstance(error, BatchError):
            error.failures = [one.worded(rephrase) for one in error.failures]
        raise


class SchedulerError(LunarSciError, RuntimeError):
    """A cluster cannot compute what it was given."""


class LunarSciWarning(UserWarning):
    """A result that stands, with something the reader should know about it."""


@contextlib.contextmanager
def named(where: str, kind: type[LunarSciError] = DataError) -> Iterator[None]:
    """What values within lack or have wrong, as an error of a `kind` that begins with `where` they are from."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"no {error} in it" if isinstance(error, KeyError) else error
        raise kind(f"{where}: {wrong}" if where else str(wrong)) from error


def warn(message: str) -> None:
    """Say something of a result that stands, as a LunarSciWarning where the caller was called."""
    warnings.warn(message, LunarSciWarning, stacklevel=3)
