"""Errors and warnings a user of lunarsci can meet.

    LunarSciError
    ├── DataError         an input file or table cannot be used as it is
    ├── ParameterError    a value lies outside what the formula or the command accepts
    │   └── RequestError  options of a job that are impossible, alone or together
    ├── OutputError       a result cannot be written where it was asked for
    │   └── TakenError    something is there that only `force` may replace
    └── SchedulerError    a cluster cannot compute what it was given

Each also inherits the builtin a caller would expect. The message is one line: what, where, and what to do.
"""


class LunarSciError(Exception):
    """Root of every error that lunarsci raises on purpose; its text is one line, whatever a file names in it."""

    def __str__(self) -> str:
        return " ".join(super().__str__().split())


class DataError(LunarSciError, ValueError):
    """An input file or table cannot be used as it is."""


class ParameterError(LunarSciError, ValueError):
    """A value lies outside what the formula or the command accepts."""


class RequestError(ParameterError):
    """Options of a job that are impossible, alone or together; the message names them in backticks, as in Python.

    The command line shows `model_error` as --model-error and leaves with exit code 2.
    """


class OutputError(LunarSciError, OSError):
    """A result cannot be written where it was asked for."""


class TakenError(OutputError):
    """Something is there already that only `force` may replace; the command line leaves with exit code 2."""


class SchedulerError(LunarSciError, RuntimeError):
    """A cluster cannot compute what it was given."""


class LunarSciWarning(UserWarning):
    """A result that stands, with something the reader should know about it."""
