"""The options that every command shares, and the file that can hold any of them."""

import dataclasses
import inspect
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

import typer

from lunarsci.io.atomic import check_folder, check_target
from lunarsci.io.documents import toml_document
from lunarsci.names import meant, one_of
from lunarsci.options import choices_of, meanings

from .talk import progress

PLOT_SUFFIXES = (".png", ".svg", ".pdf")
"""Ends of names of pictures."""
PANEL = "Output"
"""Of the help, for options that commands share."""
FORMS = ("text", "md", "tsv", "latex", "csv", "json")
"""Forms of a result; the last two as --csv and --json."""
FORM_OF = {".txt": "text", ".md": "md", ".tsv": "tsv", ".tex": "latex", ".csv": "csv", ".json": "json"}
"""The form of a file of --output whose name ends so, where none is asked for."""
OF_FOLDERS = (".npz", ".tif", ".tiff", ".asc", ".toml", ".ecsv", ".html", ".geojson", *PLOT_SUFFIXES)
"""Ends of names that files in a folder of --output have, and no folder."""
FAILED_TEXT = (
    "File for the inputs that gave no result, a line each: name, reason, and the spectrum where only one gave none, "
    "with tabs between; empty where there are none."
)
WIDEST = 24
"""Characters of choices in the help's column of types; more would leave no room for what an option means."""
STDOUT = ("-", "/dev/stdout")
"""Names of stdout, where the result goes without --output."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """The shared options of a command, as given.

    Attributes
    ----------
    as_json, as_csv, form : whether --json or --csv was given, and the form of --format.
    field_path : key of the result whose value alone is wanted; None for all.
    path, folder : --output, and whether it is a folder.
    plot, failed : files for the picture, and for the inputs that gave no result.
    force : whether files may be overwritten.
    no_time : whether the time is left out of the provenance.
    quiet, verbose : without progress and warnings; a failure with its traceback.
    columns : names of the wanted columns, with commas between; None for all.
    bars : progress that ends with the command's function.
    """

    as_json: bool
    as_csv: bool
    field_path: str | None
    path: Path | None
    plot: Path | None
    force: bool
    no_time: bool
    quiet: bool
    verbose: bool
    form: str = "text"
    columns: str | None = None
    folder: bool = False
    failed: Path | None = None
    bars: ExitStack = field(default_factory=ExitStack, repr=False)

    def progress(self, description: str) -> Callable[[int, int], None]:
        """`update(done, total)` of a bar that is there until the command's function has ended."""
        return self.bars.enter_context(progress(description, quiet=self.quiet))

    @property
    def asked(self) -> str:
        """The form that options ask for; text where none does."""
        return "json" if self.as_json else "csv" if self.as_csv else self.form

    @property
    def wanted(self) -> str:
        """The form of the result on stdout or in a file: as asked for, or else as the file is called."""
        by_name = FORM_OF.get(self.path.suffix.lower(), "text") if self.path and not self.folder else "text"
        return by_name if self.asked == "text" and self.field_path is None else self.asked

    @property
    def chosen(self) -> list[str]:
        """Names of the columns that are wanted; none for all."""
        return [name.strip() for name in (self.columns or "").split(",") if name.strip()]

    def check(self) -> None:
        """Refuse contradictory or impossible requests before anything is computed."""
        self._check_form()
        if self.path is not None and str(self.path) in ("", "."):
            raise typer.BadParameter("--output is empty; give a name")
        if self.path and self.folder:
            if self.path.suffix.lower() in OF_FOLDERS and not self.path.is_dir():
                raise typer.BadParameter(
                    f"--output {self.path}: this command fills a folder; give a name without a suffix, or a file for "
                    f"the result alone ({', '.join(FORM_OF)})"
                )
            check_folder(self.path, force=self.force)
        elif self.path:
            check_target(self.path, force=self.force)
        self.check_extra("--plot", self.plot)
        self.check_extra("--failed", self.failed, ())

    def _check_form(self) -> None:
        given = {
            "--json": self.as_json,
            "--csv": self.as_csv,
            "--format": self.form != "text",
            "--field": self.field_path,
        }
        chosen = [name for name, on in given.items() if on]
        if len(chosen) > 1:
            raise typer.BadParameter(f"{' and '.join(chosen)} exclude each other; give one")
        if self.form not in FORMS:
            raise typer.BadParameter(f"--format {self.form}: {meant(self.form, FORMS)}choose from {', '.join(FORMS)}")
        if self.columns is not None and (self.wanted == "json" or self.field_path or not self.chosen):
            raise typer.BadParameter("--columns names columns of a table; give some, and no --json or --field")

    def check_extra(self, name: str, path: Path | None, suffixes: Sequence[str] = PLOT_SUFFIXES) -> None:
        """The same for the file of another option, beside those of --output and --plot."""
        if path is None:
            return
        if str(path) in STDOUT:
            raise typer.BadParameter(f"{name} {path}: stdout is for the result; give the name of a file")
        if suffixes and path.suffix.lower() not in suffixes:
            raise typer.BadParameter(f"{name} {path}: the name must end in {', '.join(suffixes)}")
        for other, taken in (("--output", self.path), ("--plot", self.plot)):
            if other != name and taken and taken.resolve() == path.resolve():
                raise typer.BadParameter(f"{other} and {name} both name {path}; give two names")
        check_target(path, force=self.force)


def target_of(path: Path | None, *, wanted: bool) -> Path | None:
    """The path of --output; None where it names stdout, which does not do for a folder that is `wanted`."""
    if str(path) not in STDOUT:
        return path
    if wanted:
        raise typer.BadParameter(f"--output {path}: this command fills a folder; give its name")
    return None


def _option(kind: Any, *names: str, text: str, metavar: str | None = None) -> Any:
    return Annotated[kind, typer.Option(*names, help=text, metavar=metavar, rich_help_panel=PANEL)]


def shared_options(folder: bool, default_path: str | None, batch: bool) -> dict[str, tuple[Any, Any]]:
    """Name of the parameter to its annotation and default."""
    file_text, metavar = (
        "File for the result, instead of stdout; .json, .csv, .md, .tsv or .tex at its end gives the form.",
        "FILE",
    )
    if folder:
        file_text = (
            "Folder for the result, tables and pictures, beside the result on stdout. A name that ends in .json, .csv, "
            ".txt, .md, .tsv or .tex is a file for the result alone, instead of stdout."
        )
        metavar = "DIR|FILE"
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
        "form": (
            _option(str, "--format", text=f"Form of the result: {', '.join(FORMS)}.", metavar="FORM"),
            "text",
        ),
        "columns": (
            _option(
                str | None, "--columns", text="Only these columns of the tables, or of --csv.", metavar="NAME,NAME…"
            ),
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
        **({"failed": (_option(Path | None, "--failed", text=FAILED_TEXT, metavar="FILE"), None)} if batch else {}),
        "quiet": (_option(bool, "--quiet", "-q", text="No progress, no warnings."), False),
        "verbose": (
            _option(bool, "--verbose", "-v", text="All tables and notes on a terminal; a failure with its traceback."),
            False,
        ),
    }


SPREAD = ("scheduler", "workers")
"""Options of commands that compute in threads or on a cluster."""
BLOCKS = (*SPREAD, "memory")
"""Options of those that also work in blocks."""
_COMPUTING: dict[str, tuple[Any, str, str]] = {
    "scheduler": (
        str | None,
        "ADDRESS",
        "Compute on the workers of a dask scheduler: tcp://HOST:8786, or the JSON file that it wrote.",
    ),
    "workers": (int | None, "N", "Threads to compute in; one a core if left out."),
    "memory": (str | None, "SIZE", "Memory to stay within, such as 1.5GB: smaller blocks."),
}


def computing_options(names: Sequence[str]) -> dict[str, tuple[Any, Any]]:
    """The same for some of `BLOCKS`, for commands that compute in blocks: where, and in how much memory."""
    return {
        name: (
            Annotated[kind, typer.Option(f"--{name}", help=text, metavar=metavar, rich_help_panel="Computing")],
            None,
        )
        for name, (kind, metavar, text) in _COMPUTING.items()
        if name in names
    }


def _load_config(context: typer.Context, value: Path | None) -> Path | None:
    """Make the keys of a TOML file, and of its table of this command, the defaults of the options of these names."""
    if value is None:
        return None
    try:
        settings = toml_document(value.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise typer.BadParameter(f"{value}: not a readable TOML file: {error}") from error
    parameters = {_option_name(parameter): parameter for parameter in context.command.params}
    defaults = {}
    for key, setting in _of_this_command(settings, context, value).items():
        name = key.replace("_", "-")
        if name not in parameters or name == "config":
            others = sorted(set(parameters) - {"config"})
            message = f"'{key}' is no option here; {one_of(name, others)}"
            raise typer.BadParameter(f"{value}: {message}")
        alone = isinstance(setting, str) and getattr(parameters[name], "multiple", False)
        defaults[str(parameters[name].name)] = [setting] if alone else setting
    context.default_map = defaults
    return value


def _of_this_command(settings: Mapping[str, Any], context: typer.Context, file: Path) -> dict[str, Any]:
    """Keys outside of tables, and those of the table of this command, such as [spectra.fit], which win.

    Raises BadParameter for a table that belongs to no command, as far as the commands beside this one are known.
    """
    contexts: list[Any] = []
    above: Any = context.parent
    while above is not None:
        contexts.insert(0, above)
        above = above.parent
    shared = {key: setting for key, setting in settings.items() if not isinstance(setting, dict)}
    table: Any = settings
    for word, here in zip(context.command_path.split()[1:], contexts, strict=False):
        names = list(here.command.commands)
        if wrong := next((key for key, inner in table.items() if isinstance(inner, dict) and key not in names), None):
            raise typer.BadParameter(f"{file}: [{wrong}] is no command here; {one_of(wrong, names)}")
        table = table.get(word, {})
    return shared | {key: setting for key, setting in table.items() if not isinstance(setting, dict)}


def _option_name(parameter: Any) -> str:
    longest: str = max(parameter.opts, key=len)
    return longest.lstrip("-").replace("_", "-")


CONFIG = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="TOML file with option names as keys; a table such as spectra.fit holds those of one command.",
        rich_help_panel=PANEL,
        is_eager=True,
        callback=_load_config,
    ),
]


@dataclass(frozen=True, slots=True)
class RequestOption:
    """What the command line adds to a field of a request.

    Attributes
    ----------
    flags : as typed, such as `--model-error`; empty for the field's name.
    settings : arguments of `typer.Option`.
    kind : type on the command line, where it is not that of the field.
    """

    flags: tuple[str, ...]
    settings: Mapping[str, Any]
    kind: Any = None

    @property
    def flag(self) -> str:
        """The longest name that is typed; '' where it is the field's."""
        return max((flag.split("/")[0] for flag in self.flags), key=len, default="")


def option(*flags: str, panel: str | None = None, kind: Any = None, **settings: Any) -> RequestOption:
    """Flags other than the field's name, panel of the help, type, and settings of `typer.Option`.

    The help is the field's entry in the docstring of its request.
    """
    return RequestOption(flags, {"rich_help_panel": panel} | settings, kind)


def _typer_option(name: str, kind: Any, given: RequestOption, text: str) -> Any:
    """Many choices stand in the help text, since the column of types is narrow."""
    choices = choices_of(kind)
    settings, flags = dict(given.settings), given.flags
    if settings.get("metavar") is None and len("|".join(map(str, choices))) > WIDEST:
        settings["metavar"] = "NAME"
        text = f"{text.rstrip('.')}. Choices: {', '.join(map(str, choices))}."
    if name in NAMES and not flags:
        settings["autocompletion"] = _completed(NAMES[name])
    if kind is bool and not flags:
        flags = (flag_of(name),)
    return typer.Option(*flags, help=text, **settings)


def flag_of(name: str) -> str:
    """The flag of a field that has no other.

    >>> flag_of("model_error")
    '--model-error'
    """
    return f"--{name.replace('_', '-')}"


def _rovers() -> list[str]:
    from lunarsci.rovers import rover_names

    return [*rover_names()]


def _soils() -> list[str]:
    from lunarsci.regolith.soil import soil_tables

    return [*soil_tables()]


def _assemblages() -> list[str]:
    from itertools import combinations

    from lunarsci.minerals import MINERALS

    return ["auto", *("-".join(some) for n in range(1, len(MINERALS) + 1) for some in combinations(MINERALS, n))]


NAMES: dict[str, Callable[[], list[str]]] = {"rover": _rovers, "soil": _soils, "assemblage": _assemblages}
"""What a shell may complete a value of an option with."""


def _completed(names: Callable[[], list[str]]) -> Callable[[str], list[str]]:
    return lambda incomplete: [name for name in names() if name.startswith(incomplete)]


def request_parameters(request: type, options: Mapping[str, RequestOption]) -> list[inspect.Parameter]:
    """The fields of a request that have an option, as parameters of a command, in the order of the options.

    A tuple is an option that may be repeated; a bool without flags of its own is a flag without --no-….
    """
    hints, texts = get_type_hints(request), meanings(request)
    defaults = {field.name: field.default for field in dataclasses.fields(request)}
    flags = {name: given.flag or flag_of(name) for name, given in options.items()}
    parameters: list[inspect.Parameter] = []
    for name, given in options.items():
        kind, default = given.kind or hints[name], defaults[name]
        if default is dataclasses.MISSING:
            raise TypeError(
                f"{request.__name__}.{name} needs a default: None, refused in __post_init__ if it must be given"
            )
        if get_origin(kind) is tuple:
            kind, default = list[str] | None, (list(default) or None)
        text = re.sub(r"`(\w+)`", lambda word: flags.get(word[1], word[0]), texts[name])
        annotation: Any = Annotated[kind, _typer_option(name, kind, given, text)]
        parameters.append(
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
        )
    return parameters
