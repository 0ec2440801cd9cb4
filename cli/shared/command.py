"""The contract of every command: where a result goes, in which form, and with which exit code.

A command parses its options, calls the library and returns a `Report`. `command` adds the shared options to it and
hands the report to `emit`, the only place that writes to stdout or to a result file.
"""

import functools
import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from lunarsci.errors import LunarSciWarning
from lunarsci.provenance import Provenance, plain

from .emit import emit
from .options import CONFIG, Output, shared_options
from .report import Report
from .talk import INTERRUPTED, say

__all__ = ["command"]


def command(
    app: typer.Typer, name: str, *, folder: bool | None = False, default_path: str | None = None
) -> Callable[[Callable[..., Report]], Callable[..., None]]:
    """Register a function that returns a `Report` as a command with the shared output options.

    A function with a parameter `output` is handed the `Output`, for its progress bar. With `folder`, `--output` names a
    folder that takes the report's `files`, and the result itself always goes to stdout; with None this is so where the
    name has no suffix.
    """
    shared = shared_options(folder, default_path)

    def register(function: Callable[..., Report]) -> Callable[..., None]:
        signature = inspect.signature(function)
        wants_output = "output" in signature.parameters

        @functools.wraps(function)
        def run(context: typer.Context, config: Path | None = None, **options: Any) -> None:
            chosen = {key: options.pop(key) for key in shared}
            path = chosen["path"]
            named = path is not None and not path.suffix if folder is None else folder
            output = Output(**chosen, folder=named)
            output.check()
            try:
                with heard_warnings(output) as heard:
                    report = function(**options, **({"output": output} if wants_output else {}))
                    emit(report, output, _provenance(context, report, options, heard))
            except KeyboardInterrupt:
                say("interrupted; nothing was written")
                raise typer.Exit(INTERRUPTED) from None
            raise typer.Exit(report.exit_code)

        extended = _extended(signature, shared)
        run.__signature__ = extended  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in extended.parameters.values()}
        app.command(name)(run)
        return run

    return register


def _extended(signature: inspect.Signature, shared_options: Mapping[str, tuple[Any, Any]]) -> inspect.Signature:
    own = [p.replace(kind=p.KEYWORD_ONLY) for p in signature.parameters.values() if p.name != "output"]
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    config = inspect.Parameter("config", inspect.Parameter.KEYWORD_ONLY, annotation=CONFIG, default=None)
    shared = [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
        for key, (annotation, default) in shared_options.items()
    ]
    return inspect.Signature([context, *own, *shared, config], return_annotation=None)


def _provenance(context: typer.Context, report: Report, options: Mapping[str, Any], heard: list[str]) -> Provenance:
    return Provenance(
        command=context.command_path,
        options={key: plain(value) for key, value in options.items()} | dict(report.options),
        inputs=report.inputs,
        tables=report.data_tables,
        sources=report.sources,
        seed=report.seed,
        warnings=heard,
    )


@contextmanager
def heard_warnings(output: Output) -> Iterator[list[str]]:
    """Collect lunarsci's warnings, each once, and say them on stderr as they come."""
    heard: list[str] = []

    def hear(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        text = str(message)
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
