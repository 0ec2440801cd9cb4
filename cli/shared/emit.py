"""What a command hands over, and how it is written: pictures and files before anything is printed."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lunarsci.errors import DataError, Failure, OutputError, RequestError
from lunarsci.io.atomic import write_files
from lunarsci.names import meant, some_of
from lunarsci.printable import printable
from lunarsci.provenance import Provenance, document, json_chunks, plain

from .options import FORM_OF, Output
from .table import (
    FORMATS,
    MOST_VERDICTS,
    SAYS,
    TextTable,
    chosen,
    chosen_csv,
    first_screen,
    names_of,
    render,
    terminal_width,
    to_csv,
)  # fmt: skip
from .talk import FAILED, UNTRUSTED, say

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.result import Result

NAMED = 5
"""Failed inputs that are named at the end."""
MOST_ANSWERED = 1000
"""Spectra or rocks of a result that is answered in a sentence; of more, all records would have to be made for it."""

NAMES = ("id", "name", "quantity", "parameter", "law", "assemblage")
"""Keys of which one names a record of a list: `--field limits.tilt_deg.margin`."""
MOST_STEPS = 20
"""Names of records that are listed where one is wrong."""

FORMS_BY_NAME = f"{', '.join(FORM_OF)} at the end of its name give other forms"
"""Beside a file whose name has another end."""
OF_SPECTRA = {
    "lunarsci/spectra-bands/1": "bands_doubt",
    "lunarsci/spectra-fit/1": "fit_doubt",
    "lunarsci/spectra-unmix/1": "shares_doubt",
}
"""Results of which each spectrum says itself whether it is to be trusted, and what in `verdicts` tells it."""


@dataclass(frozen=True)
class Report:
    """A job's result, and what its command has beside it, before it is known how it will be shown.

    Attributes
    ----------
    result : of the job.
    tables : the same for people, or what makes it, where that takes time that a file need not wait for.
    pictures : further pictures that were asked for, by the file that takes them.
    extras : further files that were asked for, such as films, by name.
    formats : file suffixes of `--output` beyond .json and .csv, with what makes such a file from the provenance.
    files : for commands that fill a folder: file name to what makes its content.
    written : files that the job wrote itself, since they may not fit into memory; the result then goes to stdout.
    raw : makes a text that is the result itself, such as a file to begin with, and is shown as it is.
    stored : document of a result that is there, which paths of `--field` lead into that begin with `result`.
    worded : how reasons are worded: options as they are typed.
    """

    result: "Result"
    tables: Sequence[TextTable] | Callable[[], Sequence[TextTable]]
    pictures: "Mapping[Path, Callable[[], Iterable[Figure]]]" = field(default_factory=dict)
    extras: Mapping[Path, Callable[[], bytes]] = field(default_factory=dict)
    formats: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = field(default_factory=dict)
    files: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)
    written: Sequence[Path] = ()
    raw: Callable[[], str] | None = None
    stored: Mapping[str, Any] | None = None
    worded: Callable[[str], str] = str

    @cached_property
    def content(self) -> Mapping[str, Any]:
        """The result, keys with their units; in plain Python, but that long lists may be `Records`."""
        content = self.result.content()
        lines = content.get("read_as")
        return {**content, "read_as": [*map(self.worded, lines)]} if isinstance(lines, list | tuple) else content

    @cached_property
    def untrusted(self) -> str:
        return self.worded(str(self.result.doubt))

    @cached_property
    def failures(self) -> Sequence[Failure]:
        return [one.worded(self.worded) for one in self.result.failures]

    @cached_property
    def shown(self) -> Sequence[TextTable]:
        """The tables, made."""
        made = self.tables() if callable(self.tables) else self.tables
        return [replace(table, notes=[*map(self.worded, table.notes)]) for table in made]

    def rows_with(self, columns: Sequence[str]) -> Sequence[Mapping[str, Any]]:
        """The rows for some columns of `--csv`: one of each thing, unless one of them is a column of its parts."""
        each = self.result.rows_each() if columns else ()
        names = {name.casefold() for name in names_of(each)}
        return each if columns and names.issuperset(name.casefold() for name in columns) else self.result.rows()

    @property
    def exit_code(self) -> int:
        """0 done, 1 some input failed, 3 finished but not to be trusted or not safe."""
        if self.failures:
            return FAILED
        return UNTRUSTED if self.untrusted else 0


def emit(report: Report, output: Output, provenance: Provenance) -> int:
    """Write the pictures and the result, then say what was written and what to know about it; the exit code.

    Where a picture fails, the other files that were asked for are written before the error is passed on.
    """
    result = report.content  # first: what it warns of belongs into the record
    contents: dict[Path, bytes | Iterable[bytes]] = {}
    failed: Exception | None = None
    try:
        if output.plot:
            contents[output.plot] = _plot(report.result, output.plot)
        contents |= {target: _picture(draw, target) for target, draw in report.pictures.items()}
    except Exception as error:
        failed = error
    contents |= {target: make() for target, make in report.extras.items()}
    if output.failed:
        contents[output.failed] = _listed(report.failures)
    record = provenance.to_dict(time=not output.no_time)
    whole = {"provenance": record, "schema": f"lunarsci/{report.result.schema}"}
    value, doubt = ("", "") if output.field_path is None else field_of(report, output.field_path, whole)
    made = _as_file(report, output, record)
    text: Iterable[bytes] = [value.encode()] if value else () if made else _as_text(report, output, record)
    if output.path and output.folder:
        contents.update({output.path / name: make() for name, make in report.files.items()})
        contents[output.path / "result.json"] = json_chunks(document(report.result.schema, result, record))
    elif output.path and not report.written:
        contents[output.path] = made or text
    write_files(contents, force=output.force, folder=output.path if output.folder else None)
    as_text = (
        output.path if output.wanted == "text" and not (made or value or output.folder or report.written) else None
    )
    for path in (*report.written, *contents):
        guessed = path == as_text and path.suffix.lower() not in ("", ".txt", ".log")
        say(f"written: {path}{f' as text; {FORMS_BY_NAME}' if guessed else ''}", quiet=output.quiet)
    if failed is not None:
        raise failed
    if output.folder or not output.path or report.written:
        _print(text)
    else:
        for remark in () if output.quiet else chain(*answers_of(report.result, report.content, report.shown, record)):
            say(remark)
    for failure in report.failures:
        say(f"error: {failure}")
    if report.failures:
        say(_counted(report, output.failed))
    for remark in filter(None, (beyond(_first_answers(report, output, record), report.untrusted), doubt)):
        say(remark)
    return report.exit_code or (UNTRUSTED if doubt else 0)


def emit_failed(failures: Sequence[Failure], output: Output) -> None:
    """Write the list of failed inputs where these are all, and nothing else is written."""
    if output.failed:
        write_files({output.failed: _listed(failures)}, force=output.force)
        say(f"written: {output.failed}", quiet=output.quiet)


def _listed(failures: Sequence[Failure]) -> bytes:
    """A line for each failed input: its name, the reason, and the spectrum, if only that one; tabs between."""
    lines = (
        "\t".join(printable(part).replace("\t", r"\x09") for part in (one.input, one.reason, one.spectrum))
        for one in failures
    )
    return "".join(f"{line}\n" for line in lines).encode()


def on_terminal() -> bool:
    """Whether somebody reads what is printed, and no program."""
    return sys.stdout is not None and sys.stdout.isatty()


def _print(text: Iterable[bytes]) -> None:
    if sys.stdout is None:
        raise OutputError("stdout is closed; use -o FILE")
    terminal = on_terminal()
    try:
        for piece in text:
            sys.stdout.write("\n".join(map(printable, piece.decode().split("\n"))) if terminal else piece.decode())
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"stdout: {error.strerror}; the result was not printed") from error


def answers_of(
    result: "Result", content: Mapping[str, Any], tables: Sequence[TextTable], record: Mapping[str, Any]
) -> tuple[list[str], list[str]]:
    """What a result says in a sentence each, of few spectra; else its answer on a page.

    And, where nothing else is said of it, whether its command trusts it. `content` is of the result, `tables` are its
    own for people, `record` its provenance.
    """
    from lunarsci.pages.answers import answer, answered
    from lunarsci.pages.documents import Document

    many = max(len(content.get(name, ())) for name in ("spectra", "rocks"))
    made = Document("", result.schema, {} if many > MOST_ANSWERED else plain(content), record)
    if not made.result or answered(made.kind) is None:
        return [], []
    verdicts: list[str] = []
    if 0 < len(content.get("spectra", ())) <= MOST_VERDICTS:
        verdicts = [note for table in tables if table.title == SAYS for note in table.notes]
    try:
        summary = answer(made)
    except DataError:  # the result is written: a sentence that cannot be made is no failure
        return verdicts, []
    trusted = [] if result.untrusted or result.failures else [summary.trust]
    return verdicts or [summary.text], trusted


def _counted(report: Report, failed: str | Path | None) -> str:
    """How many spectra of a batch have a result, and how many inputs, or single spectra of them, have none."""
    names = list(dict.fromkeys(failure.input for failure in report.failures))
    key = next((key for key in ("spectra", "rocks") if key in report.content), "")
    lost = {(one.input, one.spectrum) for one in report.failures}
    named = ((one.get("source"), one.get("id")) for one in report.content.get(key, ()))
    count = sum(lost.isdisjoint({(source, ""), (source, name)}) for source, name in named)
    noun = {"spectra": "spectrum", "rocks": "rock"}[key] if count == 1 else key
    results = f"{count} {noun} with a result, " if key else ""
    single = sum(bool(one.spectrum) for one in report.failures)
    whole = len({one.input for one in report.failures if not one.spectrum})
    counts = [f"{whole} input{'s' if whole > 1 else ''}"] if whole else []
    counts += [f"{single} single spectr{'a' if single > 1 else 'um'}"] if single else []
    without = f"{' and '.join(counts)} without"
    listed = f"{failed} lists them" if failed else "--failed FILE lists them"
    return f"{results}{without}: {some_of(names, NAMED)} ({listed})"


def _as_file(report: Report, output: Output, record: Mapping[str, Any]) -> bytes | None:
    """The content of a file in one of the report's own formats; None where the result is wanted as text."""
    asked = output.asked != "text" or output.chosen or output.field_path is not None
    if asked or output.folder or not output.path:
        return None
    make = report.formats.get(output.path.suffix.lower())
    return make(record) if make else None


def _as_text(report: Report, output: Output, record: Mapping[str, Any]) -> Iterable[bytes]:
    """The result as it is wanted, in pieces."""
    if output.wanted == "json":
        return json_chunks(document(report.result.schema, report.content, record))
    if output.wanted == "csv":
        rows = report.rows_with(output.chosen)
        return chosen_csv(rows, output.chosen) if output.chosen else to_csv(rows)
    if report.raw is not None and output.wanted == "text" and not output.chosen:
        return [report.raw().encode()]
    tables = report.shown
    tables = chosen(tables, report.rows_with(output.chosen), output.chosen) if output.chosen else tables
    if output.wanted != "text":
        return [FORMATS[output.wanted](tables).encode()]
    if (answers := _first_answers(report, output, record)) is not None:
        return [first_screen(answers, tables, terminal_width()).encode()]
    to_file = output.path is not None and not output.folder and not report.written
    return [render(tables, 0 if to_file else terminal_width(), keep=bool(output.chosen)).encode()]


def _first_answers(report: Report, output: Output, record: Mapping[str, Any]) -> list[str] | None:
    """What a first screen begins with; None where all is shown, or something else than text."""
    to_file = output.path is not None and not output.folder and not report.written
    other = output.wanted != "text" or output.field_path is not None or report.raw is not None
    if not on_terminal() or to_file or other or output.verbose or output.chosen:
        return None
    return answers_of(report.result, report.content, report.shown, record)[0]


def beyond(answers: Sequence[str] | None, doubt: str) -> str:
    """A doubt that the answers do not begin with; '' where they do."""
    verdict = doubt.partition(":")[0].casefold().replace("-", " ")
    return "" if any(one.casefold().replace("-", " ").startswith(verdict) for one in answers or ()) else doubt


def field_of(report: Report, path: str, whole: Mapping[str, Any]) -> tuple[str, str]:
    """A value of a result as a line of text, and why it should not be used; '' if it may be.

    `whole`: the parts of the document beside the result, which a path may begin with. A name that other spectra of the
    result have, or could have, is a value that is missing here; any other is wrong usage.
    """
    from lunarsci.result import doubt_about

    steps = path.split(".")
    stored = report.stored if report.stored and steps[0] in ("result", "provenance") and len(steps) > 1 else None
    result = stored["result"] if stored else report.content
    value, doubt = _opened(result), ""
    if steps[0] in whole and steps[0] not in value:
        value = stored or whole
    steps = steps[1:] if steps[0] == "result" else steps
    top = value
    for depth, step in enumerate(steps):
        if value is None and depth:
            break
        doubt = (doubt_about(value) if isinstance(value, dict) else "") or doubt
        try:
            value = _opened(_item(value, step) if _is_list(value) else value[step])
        except (KeyError, IndexError, ValueError, TypeError):
            if (isinstance(value, dict) or _is_list(value)) and depth and _could_be(step, steps[:depth], top, report):
                value, doubt = None, f"no '{step}' here; there is: {_names_in(value)}"
                break
            near = meant(step, value) if isinstance(value, dict) else ""
            if inside := _path_to(steps[-1], _opened(result)):
                # Of the entry of a list that was asked for, not of the first.
                entry = next(filter(str.isdigit, steps), "0")
                prefix = "result." if path.startswith("result.") else ""
                near = f"did you mean '{prefix}{inside.replace('.0.', f'.{entry}.', 1)}'? "
            choices = f"{near}there is: {_names_in(value)}"
            raise typer.BadParameter(f"--field {path}: no '{step}' at level {depth + 1}; {choices}") from None
    bare = plain(value)
    number = isinstance(bare, int | float) and not isinstance(bare, bool)
    if bare is None:
        doubt = f"--field {path}: no value{f': {doubt}' if doubt else ''}"
    elif doubt:
        doubt = f"--field {path}: not to be used: {doubt}" if number else ""
    text = bare if isinstance(bare, str) else json.dumps(bare, sort_keys=True, ensure_ascii=False)
    return f"{text}\n", doubt or (_stored_doubt(stored, steps) if stored and path.startswith("result") else "")


def _stored_doubt(stored: Mapping[str, Any], steps: Sequence[str]) -> str:
    """Why a value of a stored result is not to be trusted: below one of many fits as that one is not, else as all."""
    untrusted = str((stored.get("provenance") or {}).get("untrusted") or "")
    teller = OF_SPECTRA.get(str(stored.get("schema")))
    if not untrusted or teller is None or len(steps) < 2 or steps[0] != "spectra":
        return untrusted
    from lunarsci.spectra.jobs import verdicts

    doubt: str = getattr(verdicts, teller)(_item(stored["result"]["spectra"], steps[1]))
    return doubt


def _could_be(step: str, above: Sequence[str], top: Any, report: Report) -> bool:
    """Whether a name that is lacking below a path is one of this kind of result: of other things in its lists too."""
    return step in report.result.may_have(above[-1]) or any(step in peer for peer in _peers(top, above))


def _peers(value: Any, steps: Sequence[str]) -> Iterator[Mapping[str, Any]]:
    """What a path leads to where each number in it may be any other."""
    value = _opened(value)
    if not steps:
        yield from [value] if isinstance(value, dict) else []
    elif _is_list(value):
        for item in value:
            yield from _peers(item, steps[1:])
    elif isinstance(value, dict) and steps[0] in value:
        yield from _peers(value[steps[0]], steps[1:])


def _path_to(name: str, value: Any, depth: int = 4) -> str:
    """Where a key is, looked for in the first of each list; empty where it is nowhere."""
    if not depth or not isinstance(value, dict | list):
        return ""
    inner = value.items() if isinstance(value, dict) else [(str(k), one) for k, one in enumerate(value[:1])]
    opened = [(str(key), _opened(one)) for key, one in inner]
    if any(key == name for key, _ in opened):
        return name
    paths = ((key, _path_to(name, list(one[:1]) if _is_list(one) else one, depth - 1)) for key, one in opened)
    return next((f"{key}.{path}" for key, path in paths if path), "")


def _opened(value: Any) -> Any:
    """A value that a step can lead into; what lies deeper is left as it is."""
    if isinstance(value, Mapping):
        return {str(key): item for key, item in value.items()}
    return value if _is_list(value) else plain(value)


def _item(items: Sequence[Any], step: str) -> Any:
    """One of a list, by its place or by the name that it has in it. Raises IndexError where there is none."""
    if step.removeprefix("-").isdecimal():
        return items[int(step)]
    named = (one for one in map(_opened, items) if isinstance(one, dict) and step in map(one.get, NAMES))
    if (one := next(named, None)) is None:
        raise IndexError(step)
    return one


def _is_list(value: Any) -> bool:
    """Whether a step into it is a number: a list, or records of many things alike."""
    return isinstance(value, Sequence) and not isinstance(value, str | tuple)


def _names_in(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(sorted(value))
    if not _is_list(value) or not value:
        return "nothing below it"
    first = map(_opened, value[:MOST_STEPS])
    names = [next((str(one[key]) for key in NAMES if one.get(key)), "") for one in first if isinstance(one, dict)]
    shown = ", ".join([*filter(None, names), *(["…"] if len(value) > MOST_STEPS else [])])
    return f"0 to {len(value) - 1}{f', or by name: {shown}' if any(names) else ''}"


def _plot(result: "Result", target: Path) -> bytes:
    from lunarsci.result import Result

    if type(result).figures is Result.figures:
        raise RequestError("there is nothing to draw; leave --plot out")
    return _picture(result.figures, target)


def _picture(draw: "Callable[[], Iterable[Figure]]", target: Path) -> bytes:
    from lunarsci.figure import picture_bytes

    return picture_bytes(draw(), target)
