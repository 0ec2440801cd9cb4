"""The contract of every command: where a result goes, in which form, and with which exit code.

A command parses its options, calls the library and returns a `Report`. `command` adds the shared options to it and
hands the report to `emit`, the only place that writes to stdout or to a result file.
"""

import dataclasses
import functools
import inspect
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import typer

from lunarsci.errors import BatchError, DataError, LunarSciError, LunarSciWarning, RequestError
from lunarsci.io.atomic import written
from lunarsci.provenance import Provenance, plain

from .emit import Report, emit, emit_failed
from .misplaced import hint_at_kind
from .options import (
    CONFIG,
    FORM_OF,
    Output,
    RequestOption,
    computing_options,
    request_parameters,
    shared_options,
    target_of,
)
from .talk import interrupted, say

Declared = TypeVar("Declared", bound=Callable[..., Report])


def command(
    name: str,
    examples: Sequence[str] = (),
    options: Mapping[str, RequestOption] | None = None,
    *,
    folder: bool = False,
    default_path: str | None = None,
    blocks: Sequence[str] = (),
    batch: bool = False,
) -> Callable[[Declared], Declared]:
    """Declare a function that returns a `Report` as a command with the shared output options, which its
    `add_to` adds to an application.

    A function with a parameter `output` is handed the `Output`, for its progress bar. With `folder`, `--output` names a
    folder that takes the report's `files`, and the result itself goes to stdout too; a name with the end of a result,
    such as .json, is a file for it alone.

    A function with a parameter `request`, a frozen dataclass of a job, is handed one made of `options`: what the
    command line says of its fields, whose names, types and defaults are those of the dataclass. What it refuses is
    wrong usage. `blocks` names options for where it computes blocks of rows, and in how much memory: `SPREAD` or
    `BLOCKS`. A command of a `batch` of inputs, which goes on past a bad one, can list these in a file. `examples` stand
    below the help; a line that ends in a backslash goes on in the next one, as in a shell.
    """
    shared = shared_options(folder, default_path, batch) | computing_options(blocks)

    def register(function: Callable[..., Report], app: typer.Typer) -> None:
        signature = inspect.signature(function, eval_str=True)
        request: Any = signature.parameters["request"].annotation if "request" in signature.parameters else None
        asked = [] if request is None else request_parameters(request, options or {})
        wants_output = "output" in signature.parameters
        fields = [parameter.name for parameter in asked]

        @functools.wraps(function)
        def run(context: typer.Context, config: Path | None = None, **options: Any) -> None:
            chosen = {key: options.pop(key) for key in shared}
            path = chosen["path"] = target_of(chosen["path"], wanted=default_path is not None)
            named = folder and (path is None or path.is_dir() or path.suffix.lower() not in FORM_OF)
            where = {key: chosen.pop(key) for key in blocks}
            output, worded = Output(**chosen, folder=named), partial(_with_flags, context=context)
            try:
                output.check()
                with _earlier_runs_named(output), heard_warnings(output, worded) as heard, _computing(output, where):
                    handed = {key: value for key, value in options.items() if key not in fields}
                    if request is not None:
                        handed["request"] = request(**_fields(request, {key: options[key] for key in fields}))
                    with output.bars:
                        report = function(**handed, **({"output": output} if wants_output else {}))
                    report = dataclasses.replace(report, worded=worded)
                    code = emit(report, output, _provenance(context, report, options, heard))
            except LunarSciError as error:
                text = worded(_noted(error))
                text += hint_at_kind(context, text) if isinstance(error, DataError) else ""
                if isinstance(error, BatchError):
                    emit_failed([one.worded(worded) for one in error.failures], output)
                    raise BatchError(text, error.failures) from error
                raise (typer.BadParameter if isinstance(error, RequestError) else type(error))(text) from error
            except KeyboardInterrupt as error:
                say("; ".join(["interrupted", *getattr(error, "__notes__", [written()])]))
                raise typer.Exit(interrupted()) from None
            raise typer.Exit(code)

        extended = _extended(signature, asked, shared)
        run.__signature__ = extended  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in extended.parameters.values()}
        epilog = "\n  ".join(["Examples:", *examples]).replace("\n  --", "\n      --") if examples else ""
        app.command(name, help=paragraphs(function), epilog=epilog)(run)

    def declare(function: Declared) -> Declared:
        function.add_to = partial(register, function)  # type: ignore[attr-defined]
        return function

    return declare


def paragraphs(function: Callable[..., Any]) -> str:
    """The docstring of a function, each of its paragraphs in one line, for a terminal to break."""
    return "\n\n".join(" ".join(part.split()) for part in (inspect.getdoc(function) or "").split("\n\n"))


@contextmanager
def _earlier_runs_named(output: Output) -> Iterator[None]:
    """Where a command fails, say which of its files are of an earlier run: they could be taken for its own."""
    before = {path: _state(path) for path in (output.path, output.plot, output.failed) if path}
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        new = [output.failed] if isinstance(error, BatchError) else []
        left = [str(path) for path, state in before.items() if state and state == _state(path) and path not in new]
        for path in left:
            say(f"{path} is of an earlier run and was left as it is")
        raise


def _state(path: Path) -> tuple[int, int] | None:
    """What changes of a file or folder when it is written anew; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


@contextmanager
def _computing(output: Output, where: Mapping[str, Any]) -> Iterator[None]:
    if not where:
        yield
        return
    from lunarsci.parallel.blocks import computing

    with computing(keep=output.path, force=output.force, notify=partial(say, quiet=output.quiet), **where):
        yield


def _noted(error: Exception) -> str:
    """The message of an error, and what its notes add, such as which blocks were kept."""
    return "; ".join([str(error), *getattr(error, "__notes__", ())])


def _fields(request: type, options: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a request: options that may be repeated are a tuple there, an empty one where they are not given."""
    repeated = {item.name for item in dataclasses.fields(request) if isinstance(item.default, tuple)}
    return {key: tuple(value or ()) if key in repeated else value for key, value in options.items()}


def _with_flags(message: str, context: typer.Context) -> str:
    """The message with names of options in backticks as they are typed."""
    flags = {str(item.name): max(item.opts, key=len) for item in context.command.params}
    return re.sub(r"`(\w+)`", lambda name: flags.get(name[1], name[0]), message)


def _extended(
    signature: inspect.Signature,
    asked: Sequence[inspect.Parameter],
    shared_options: Mapping[str, tuple[Any, Any]],
) -> inspect.Signature:
    taken = ("output", "request") if asked else ("output",)
    positional = [p.replace(kind=p.KEYWORD_ONLY) for p in signature.parameters.values() if p.name not in taken]
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    config = inspect.Parameter("config", inspect.Parameter.KEYWORD_ONLY, annotation=CONFIG, default=None)
    shared = [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
        for key, (annotation, default) in shared_options.items()
    ]
    return inspect.Signature([context, *positional, *asked, *shared, config], return_annotation=None)


def _provenance(context: typer.Context, report: Report, options: Mapping[str, Any], heard: list[str]) -> Provenance:
    made = report.result.made_from
    return Provenance(
        command=context.command_path,
        options={key: plain(value) for key, value in options.items()} | dict(made.options),
        inputs=made.inputs,
        tables=made.tables,
        sources=made.sources,
        seed=made.seed,
        warnings=heard,
        untrusted=report.untrusted,
        failures=report.failures,
    )


@contextmanager
def heard_warnings(output: Output, worded: Callable[[str], str] = str) -> Iterator[list[str]]:
    """Collect lunarsci's warnings, each once and as `worded` has it, and say them on stderr as they come."""
    heard: list[str] = []

    def hear(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        text = worded(str(message))
        if issubclass(category, LunarSciWarning) and text not in heard:
            heard.append(text)
            say(f"warning: {text}", quiet=output.quiet)
        elif output.verbose and not issubclass(category, LunarSciWarning):
            say(f"note: {category.__name__}: {text}")

    with warnings.catch_warnings():
        warnings.simplefilter("always" if output.verbose else "ignore")
        warnings.simplefilter("always", LunarSciWarning)
        warnings.showwarning = hear
        yield heard
