"""The contract of every command: where a result goes, in which form, and with which exit code.

A command parses its options, calls the library and returns a `Report`. `command` adds the shared options to it and
hands the report to `emit`, the only place that writes to stdout or to a result file.
"""

import functools
import inspect
import json
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.atomic import check_folder, check_target, write_files
from lunarsci.errors import LunarSciError, LunarSciWarning, OutputError, ParameterError
from lunarsci.provenance import Provenance, document, plain, to_json

from .table import TextTable, render, to_csv

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FAILED", "INTERRUPTED", "Output", "Report", "command", "say"]

FAILED, UNTRUSTED, INTERRUPTED = 1, 3, 130
PLOT_SUFFIXES = (".png", ".svg", ".pdf")
PANEL = "Output"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a command found, before it is known how it will be shown.

    Attributes
    ----------
    schema : name and version of the JSON result, such as `spectra-fit/1`.
    result : the result in plain Python, keys with their units.
    tables : the same for people.
    rows : the same as one table for `--csv`; None where the result is no table.
    figures : draws the pictures of `--plot`, one per page; None where there is nothing to draw.
    inputs, data_tables, sources, seed : for the provenance.
    files : for commands that fill a folder: file name to what makes its content.
    untrusted : why the result is printed but should not be trusted, or empty.
    failures : inputs that gave no result, one sentence each.
    """

    schema: str
    result: Mapping[str, Any]
    tables: Sequence[TextTable]
    rows: Sequence[Mapping[str, Any]] | None = None
    figures: Callable[[], "Iterable[Figure]"] | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    data_tables: Mapping[str, str] = field(default_factory=dict)
    sources: Sequence[str] = ()
    seed: int | None = None
    files: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)
    untrusted: str = ""
    failures: Sequence[str] = ()

    @property
    def exit_code(self) -> int:
        """0 done, 1 some input failed, 3 finished but not to be trusted or not safe."""
        if self.failures:
            return FAILED
        return UNTRUSTED if self.untrusted else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """The shared options of a command, as given."""

    as_json: bool
    as_csv: bool
    field_path: str | None
    path: Path | None
    plot: Path | None
    force: bool
    no_time: bool
    quiet: bool
    verbose: bool
    folder: bool = False

    def check(self) -> None:
        """Refuse contradictory or impossible requests before anything is computed."""
        chosen = [n for n, on in (("--json", self.as_json), ("--csv", self.as_csv), ("--field", self.field_path)) if on]
        if len(chosen) > 1:
            raise typer.BadParameter(f"{' and '.join(chosen)} exclude each other; give one")
        if self.plot and self.plot.suffix.lower() not in PLOT_SUFFIXES:
            raise typer.BadParameter(f"--plot {self.plot}: the name must end in {', '.join(PLOT_SUFFIXES)}")
        if self.path and self.folder:
            check_folder(self.path, force=self.force)
        elif self.path:
            check_target(self.path, force=self.force)
        if self.plot:
            check_target(self.plot, force=self.force)


def _option(kind: Any, *names: str, text: str, metavar: str | None = None) -> Any:
    return Annotated[kind, typer.Option(*names, help=text, metavar=metavar, rich_help_panel=PANEL)]


def _shared_options(folder: bool, default_path: str | None) -> dict[str, tuple[Any, Any]]:
    """Name of the parameter to its annotation and default."""
    file_text, metavar = "Write the result to a file instead of stdout.", "FILE"
    if folder:
        file_text, metavar = "Folder for the tables and pictures; the result still goes to stdout.", "DIR"
    flags = {
        "as_json": ("--json", "One JSON document, with provenance."),
        "as_csv": ("--csv", "The result as one CSV table."),
        "force": ("--force", "Replace files that exist."),
        "no_time": ("--no-time", "Leave the time out: equal runs give equal bytes."),
    }
    return {
        **{key: (_option(bool, name, text=text), False) for key, (name, text) in flags.items()},
        "field_path": (
            _option(str | None, "--field", text="One bare value of the JSON result, for $(…).", metavar="A.B.C"),
            None,
        ),
        "path": (
            _option(Path | None, "--output", "-o", text=file_text, metavar=metavar),
            Path(default_path) if default_path else None,
        ),
        "plot": (
            _option(Path | None, "--plot", text="Draw the result: .png, .svg or .pdf.", metavar="FILE"),
            None,
        ),
        "quiet": (_option(bool, "--quiet", "-q", text="No progress, no warnings."), False),
        "verbose": (_option(bool, "--verbose", "-v", text="Say more; a failure shows its traceback."), False),
    }


def _load_config(context: typer.Context, value: Path | None) -> Path | None:
    """Make the keys of a TOML file the defaults of the options with the same names."""
    if value is None:
        return None
    try:
        settings = tomllib.loads(value.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise typer.BadParameter(f"{value}: not a readable TOML file: {error}") from error
    known = {_option_name(parameter): str(parameter.name) for parameter in context.command.params}
    defaults = {}
    for key, setting in settings.items():
        name = key.replace("_", "-")
        if name not in known or name == "config":
            raise typer.BadParameter(f"{value}: '{key}' is no option here; these are: {', '.join(sorted(known))}")
        defaults[known[name]] = setting
    context.default_map = defaults
    return value


def _option_name(parameter: Any) -> str:
    longest: str = max(parameter.opts, key=len)
    return longest.lstrip("-").replace("_", "-")


_CONFIG = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="TOML file with option names as keys.",
        rich_help_panel=PANEL,
        is_eager=True,
        callback=_load_config,
    ),
]


def command(
    app: typer.Typer, name: str, *, folder: bool = False, default_path: str | None = None
) -> Callable[[Callable[..., Report]], Callable[..., None]]:
    """Register a function that returns a `Report` as a command with the shared output options.

    A function with a parameter `output` is handed the `Output`, for its progress bar. With `folder`, `--output` names a
    folder that takes the report's `files`, and the result itself always goes to stdout.
    """
    shared = _shared_options(folder, default_path)

    def register(function: Callable[..., Report]) -> Callable[..., None]:
        signature = inspect.signature(function)
        wants_output = "output" in signature.parameters

        @functools.wraps(function)
        def run(context: typer.Context, config: Path | None = None, **options: Any) -> None:
            output = Output(**{key: options.pop(key) for key in shared}, folder=folder)
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
    config = inspect.Parameter("config", inspect.Parameter.KEYWORD_ONLY, annotation=_CONFIG, default=None)
    shared = [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
        for key, (annotation, default) in shared_options.items()
    ]
    return inspect.Signature([context, *own, *shared, config], return_annotation=None)


def _provenance(context: typer.Context, report: Report, options: Mapping[str, Any], heard: list[str]) -> Provenance:
    return Provenance(
        command=context.command_path,
        options={key: plain(value) for key, value in options.items()},
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


def emit(report: Report, output: Output, provenance: Provenance) -> None:
    """Write the pictures and the result; files first, so that nothing is printed when one of them cannot be written."""
    record = provenance.to_dict(time=not output.no_time)
    text = _as_text(report, output, record)
    contents: dict[Path, bytes] = {}
    if output.path and output.folder:
        contents.update({output.path / name: make() for name, make in report.files.items()})
        contents[output.path / "result.json"] = to_json(document(report.schema, report.result, record)).encode()
    elif output.path:
        contents[output.path] = text.encode()
    if output.plot:
        contents[output.plot] = _picture(report, output.plot)
    write_files(contents, force=output.force)
    for path in contents:
        say(f"written: {path}", quiet=output.quiet)
    if output.folder or not output.path:
        _print(text)
    for failure in report.failures:
        say(f"error: {failure}")
    if report.untrusted:
        say(f"not to be trusted: {report.untrusted}")


def _print(text: str) -> None:
    if sys.stdout is None:
        raise OutputError("stdout is closed; use -o FILE")
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"stdout: {error.strerror}; the result was not printed") from error


def _as_text(report: Report, output: Output, record: Mapping[str, Any]) -> str:
    suffix = output.path.suffix.lower() if output.path and not output.folder else ""
    if output.field_path is not None:
        return _field(report.result, output.field_path) + "\n"
    if output.as_json or (suffix == ".json" and not output.as_csv):
        return to_json(document(report.schema, report.result, record))
    if output.as_csv or suffix == ".csv":
        if report.rows is None:
            raise ParameterError("this result is no table; use --json")
        return to_csv(report.rows)
    return render(report.tables)


def _field(result: Any, path: str) -> str:
    value = plain(result)
    steps = path.split(".")
    for depth, step in enumerate(steps[1:] if steps[0] == "result" else steps):
        try:
            value = value[int(step)] if isinstance(value, list) else value[step]
        except (KeyError, IndexError, ValueError, TypeError):
            known = _known(value)
            raise typer.BadParameter(f"--field {path}: no '{step}' at level {depth + 1}; there is: {known}") from None
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True, ensure_ascii=False)


def _known(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(sorted(value))
    return f"0 to {len(value) - 1}" if isinstance(value, list) and value else "nothing below it"


def _picture(report: Report, target: Path) -> bytes:
    if report.figures is None:
        raise ParameterError("there is nothing to draw; leave --plot out")
    from lunarsci.figure import picture_bytes

    return picture_bytes(report.figures(), target)


def say(text: str, *, quiet: bool = False) -> None:
    """One line on stderr."""
    if not quiet and sys.stderr is not None:
        print(text.replace("\n", " "), file=sys.stderr)  # noqa: T201 - the one place that talks to people


def failure_line(error: BaseException) -> str:
    """The one line of an error, without a traceback."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if isinstance(error, LunarSciError) else f"unexpected {type(error).__name__}: {text}"
